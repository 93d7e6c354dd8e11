"""A fit beside the truth that a simulation knows, entry by entry, in fractions of full scale.

Entries of C mix N and Nm per count; `E = F^-1 (C - C_w) T^-1` (method 4) makes them comparable:
the Workbench is 0, and an entry of 0.01 bends the reading by one percent of full scale.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal.errors import SensorError
from ftcal.one_sensor import SensorOutcome
from ftcal.sensor import Workbench

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


def check_shape(sensor: str, gain: Float[Array, "6 K"], workbench: Workbench) -> None:
    """Raise `SensorError` where a true gain is not of the shape of the Workbench matrix."""
    if gain.shape != workbench.gain.shape:
        raise SensorError(
            f"truth of sensor {sensor!r} has shape {gain.shape}, its Workbench"
            f" {workbench.gain.shape}; give the gain C of `w = C r + o`"
        )


def departure(
    gain: Float[Array, "6 K"], reference: Float[Array, "6 K"], workbench: Workbench
) -> Float[Array, "6 K"]:
    """Return `E = F^-1 (C - C_ref) T^-1`: how far C is from C_ref, fractions of full scale."""
    scaled = (gain - reference) / workbench.full_scale[:, None]
    return np.asarray(scaled @ np.linalg.inv(workbench.scaling))


@dataclass(frozen=True, slots=True)
class Truth:
    """Truth and estimate as departures from the Workbench, fractions of full scale."""

    truth: Float[Array, "6 K"]
    """E of the true gain."""
    estimate: Float[Array, "6 K"]
    """E of the fitted gain, all rows."""
    sd: Float[Array, "6 K"]
    """Posterior standard deviation of every entry."""

    @staticmethod
    def of(outcome: SensorOutcome, gain: Float[Array, "6 K"]) -> Truth:
        """Return the fit of a sensor beside its true gain; `SensorError` where shapes differ."""
        workbench, fitted = outcome.channel.workbench, outcome.fit.estimate
        check_shape(outcome.sensor.name, gain, workbench)
        channels = gain.shape[1]
        scale = workbench.full_scale
        back = np.linalg.inv(workbench.scaling)
        covariance = back.T @ fitted.covariance[:, :channels, :channels] @ back
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        return Truth(
            departure(gain, workbench.gain, workbench),
            departure(fitted.gain, workbench.gain, workbench),
            np.sqrt(np.maximum(variance, 0.0)) / scale[:, None],
        )

    @property
    def z(self) -> Float[Array, "6 K"]:
        """Error of every entry over its standard deviation; NaN where that is zero."""
        error = self.estimate - self.truth
        return np.asarray(np.divide(error, self.sd, np.full_like(error, np.nan), where=self.sd > 0))

    @property
    def rms(self) -> float:
        """RMS error of the estimate's entries."""
        return float(np.sqrt(np.mean((self.estimate - self.truth) ** 2)))

    @property
    def workbench_rms(self) -> float:
        """RMS error of the Workbench's entries."""
        return float(np.sqrt(np.mean(self.truth**2)))

    @property
    def within(self) -> float:
        """Share of the entries less than two standard deviations off; NaN counts as off."""
        return float(np.mean(np.abs(self.z) < 2.0))

    def metrics(self) -> dict[str, Any]:
        """Return the comparison for `metrics.json`."""
        return {
            "unit": "fraction of full scale, departure from the Workbench",
            "truth": self.truth.tolist(),
            "estimate": self.estimate.tolist(),
            "sd": self.sd.tolist(),
            "z": self.z.tolist(),
            "rms": self.rms,
            "workbench_rms": self.workbench_rms,
            "within_two_sd": self.within,
        }
