"""The law of a six-axis sensor, `w = C r + o + k (T - T_ref)` (P1), and what its maker says of it.

`r` are K raw channels; C, o and k have six rows, force [N] first, torque [Nm] after.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal.errors import SensorError
from ftcal.firmware import WORST_CONDITION, FirmwareMatrix

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

AXES = ("fx", "fy", "fz", "tx", "ty", "tz")
"""Name of each row of a wrench."""
UNITS = ("N", "N", "N", "Nm", "Nm", "Nm")
"""Unit of each row of a wrench."""


@dataclass(frozen=True, slots=True)
class SensorModel:
    """One sensor that can be evaluated: gain, offset and, where fitted, a temperature term."""

    gain: Float[Array, "6 K"]
    """C [N or Nm per unit of the channel]."""
    offset: Float[Array, "6"]
    """o [N, Nm]."""
    temperature_gain: Float[Array, "6"] | None = None
    """k [N/K, Nm/K], or None where no temperature was logged."""
    reference_temperature: float = 0.0
    """T_ref [degree Celsius]."""

    def wrench(
        self, channels: Float[Array, "N K"], temperature: Float[Array, "N"] | None = None
    ) -> Float[Array, "N 6"]:
        """Return `C r + o + k (T - T_ref)`; raise `SensorError` where a needed T is missing."""
        w: Float[Array, "N 6"] = channels @ self.gain.T + self.offset
        if self.temperature_gain is not None:
            if temperature is None:
                raise SensorError("this calibration has a temperature term; give the temperature")
            w = w + np.outer(temperature - self.reference_temperature, self.temperature_gain)
        return w


@dataclass(frozen=True, slots=True)
class Workbench:
    """What is believed of a sensor before it is seen in the robot: the manufacturer's matrix."""

    name: str
    """Serial number, or where the matrix comes from."""
    gain: Float[Array, "6 K"]
    """C_w [N or Nm per unit of the channel]."""
    full_scale: Float[Array, "6"]
    """F: largest wrench of each axis [N, Nm]; scales the prior."""
    logged: Literal["wrench", "channels"] = "wrench"
    """What the log carries: C_w r in N and Nm (calibrated by the firmware), or the channels r."""
    firmware: FirmwareMatrix | None = None
    """The words in the sensor's board, where the matrix came from its file."""

    def __post_init__(self) -> None:
        gain, scale = self.gain, self.full_scale
        if gain.ndim != 2 or gain.shape[0] != 6:
            raise SensorError(
                f"Workbench {self.name!r}: matrix of shape {gain.shape}; it has six rows"
            )
        if not (np.isfinite(gain).all() and np.isfinite(scale).all() and (scale > 0).all()):
            raise SensorError(
                f"Workbench {self.name!r}: matrix and full scale must be finite, full scale > 0"
            )
        condition = self.condition
        if not condition < WORST_CONDITION:
            raise SensorError(
                f"Workbench {self.name!r} is singular (condition {condition:.1e} exceeds"
                f" {WORST_CONDITION:.0e}); check the matrix file"
            )
        if self.logged == "wrench" and gain.shape[1] != 6:
            raise SensorError(
                f"Workbench {self.name!r} has {gain.shape[1]} channels: a log of wrenches cannot be"
                " turned back into them; log the raw channels"
            )

    @property
    def condition(self) -> float:
        """Condition number of the matrix, as it stands in N and Nm per count."""
        singular = np.linalg.svd(self.gain, compute_uv=False)
        return float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")

    def channels(self, logged: Float[Array, "N K"]) -> Float[Array, "N K"]:
        """Return the raw channels r of what was logged."""
        if self.logged == "channels":
            return logged
        # a product with the inverse is six times as fast as `solve`; no Workbench is near singular
        return np.asarray(logged @ np.linalg.inv(self.gain).T)

    @property
    def scaling(self) -> Float[Array, "K K"]:
        """T of the coordinates `y = T r` in which every direction is believed equally (method 4).

        Six channels: `T = F^-1 C_w`, the Workbench wrench in fractions of full scale, so that
        `C = (I + F E F^-1) C_w`. Any other number has no secondary matrix: each channel is scaled
        by the largest share of a full scale that a unit of it makes, `C = C_w + F E T`.
        """
        shares = self.gain / self.full_scale[:, None]
        if shares.shape[1] == 6:
            return np.asarray(shares)
        return np.diag(np.abs(shares).max(axis=0))

    def secondary(self, gain: Float[Array, "6 K"]) -> Float[Array, "6 6"] | None:
        """Return `S = C C_w^-1`, what a robot applies after its firmware; None unless K is 6."""
        if self.gain.shape[1] != 6:
            return None
        return np.asarray(np.linalg.solve(self.gain.T, gain.T).T)
