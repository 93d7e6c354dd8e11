"""Whether a sensor has changed since it was last calibrated, or only the estimate of it.

Compared are the gains as fitted, so that a row which one calibration refused and the other took is
no change of the sensor. With `d` the change of a row and `A`, `B` its covariances in both fits

    sd^2 = d' (A + B)^-1 d / K

is 1 on average where nothing but the errors of both fits tells them apart: K of it are
chi-square with K degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.applying import ZERO
from ftcal.calibration import SensorCalibration
from ftcal.comparison import change
from ftcal.export.installed import Installed, installed

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

UNLIKELY = 4.0
"""Normal deviate beyond which a row has drifted: one in thirty thousand by chance."""


@dataclass(frozen=True, slots=True)
class Drift:
    """How a sensor's gain changed from one calibration to the next."""

    force: float
    """Largest change of a force at full scale (of `ftcal.comparison`) [N]."""
    torque: float
    """Largest change of a torque at full scale [Nm]."""
    share: float
    """Largest change of any axis at full scale, as a share of its full scale."""
    sd: float
    """Change of the row that changed most, in standard deviations of it."""
    drifted: bool
    """Whether that is more than the errors of both fits explain."""


def drift(old: SensorCalibration, new: SensorCalibration) -> Drift | None:
    """Return how a sensor changed; None where it was exchanged, which is told by its Workbench."""
    if not np.array_equal(old.prior.gain, new.prior.gain):
        return None
    moved = change(as_fitted(old), as_fitted(new)).full_scale
    if moved is None:
        raise ValueError("a calibration always knows its Workbench")
    sd = deviations(old, new)
    inputs = len(new.gain[0])
    return Drift(
        float(moved[:3].max()),
        float(moved[3:].max()),
        float((moved / np.array(new.prior.full_scale)).max()),
        float(sd.max()),
        bool(sd.max() > limit(inputs)),
    )


def as_fitted(sensor: SensorCalibration) -> Installed:
    """Return the law of a sensor with every row as fitted, the refused ones too."""
    return replace(installed(sensor, ZERO), matrix=np.array(sensor.fitted_gain))


def deviations(old: SensorCalibration, new: SensorCalibration) -> Float[Array, "6"]:
    """Return the change of each row of the fitted gain in standard deviations of it."""
    moved = np.array(new.fitted_gain) - np.array(old.fitted_gain)
    inputs = moved.shape[1]
    error = sum(np.array(one.covariance)[:, :inputs, :inputs] for one in (old, new))
    # singular where a fit holds a direction to be known: it cannot have moved there
    weight = np.linalg.pinv(error, hermitian=True)
    return np.asarray(np.sqrt(np.einsum("ip,ipq,iq->i", moved, weight, moved) / inputs))


def limit(inputs: int) -> float:
    """Return the `sd` of a row of K = `inputs` that chance exceeds as rarely as `UNLIKELY`.

    The cube root of chi-square is nearly normal: Wilson and Hilferty, PNAS 17 (1931) 684.
    """
    spread = 2.0 / (9.0 * inputs)
    return float((1.0 - spread + UNLIKELY * np.sqrt(spread)) ** 1.5)
