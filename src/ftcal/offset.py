"""In situ offset estimation: the offset in raw space, independent of any calibration matrix.

On quasi-static data with a constant centre of mass the raw channels are an affine image of gravity
in the sensor frame; the centre of that ellipsoid is the offset (section IV-A of the paper, after
S. Traversaro, D. Pucci, F. Nori, "In situ calibration of six-axis force-torque sensors using
accelerometer measurements", ICRA 2015). It is wrong by 100 N where the centre of mass moves, so
the assumption is tested before the number is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.moments import Moments

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

MOST_OUTSIDE = 0.01
"""Share of the raw variance outside three directions above which the offset is refused."""
MOST_RESIDUAL = 0.1
"""Residual of the affine fit, share of the raw signal, above which it is refused."""
MOST_SPREAD = 0.01
"""Distance [m] that the centre of mass may move (RMS) before it is refused."""
LEAST_SPHERE = 0.1
"""Least to largest spread of the gravity directions below which the centre is not determined."""


@dataclass(frozen=True, slots=True)
class InSituOffset:
    """The raw offset and how well its assumption holds."""

    offset: Float[Array, "K"]
    """o_r in channel units: subtract it from r."""
    outside: float
    """Share of the raw variance outside three directions."""
    residual: float
    """RMS residual of the affine fit over the RMS of the raw signal, in three directions."""
    spread: float
    """RMS distance of the model's centre of mass from its mean [m]."""
    sphere: float
    """Least over largest standard deviation of gravity's direction: 1 is a full sphere."""

    @property
    def refusal(self) -> str | None:
        """Why the offset must not be used, or None where the assumption holds."""
        reasons = [
            (self.spread > MOST_SPREAD, f"the centre of mass moves by {1e3 * self.spread:.0f} mm"),
            (
                self.outside > MOST_OUTSIDE,
                f"{100 * self.outside:.1f} % of the raw variance is outside three directions",
            ),
            (
                self.residual > MOST_RESIDUAL,
                f"the affine fit leaves {100 * self.residual:.0f} % of the raw signal",
            ),
            (
                self.sphere < LEAST_SPHERE,
                "gravity turns in a plane of the sensor: the centre is not determined",
            ),
        ]
        return "; ".join(reason for found, reason in reasons if found) or None


def in_situ_offset(attitude: Moments, scaling: Float[Array, "K K"]) -> InSituOffset:
    """Return the centre of the ellipsoid that the raw channels draw as gravity turns.

    `attitude` are the moments of `[channels, gravity, centre of mass]`: gravity [m/s^2] and centre
    of mass [m] of the free half come from the model, in the sensor frame; `scaling`
    (`Workbench.scaling`) makes the channels comparable. Minimises `sum |A g + b - r3|^2` over A
    (3x3) and b, with `r3` the centred channels on their three principal directions; b mapped back
    is the offset.
    """
    K = len(scaling)
    S = attitude.scatter
    S_gg = S[K : K + 3, K : K + 3]
    d, V = np.linalg.eigh(scaling @ S[:K, :K] @ scaling.T)
    power, directions = np.maximum(d[::-1], 0.0), V[:, ::-1].T
    S_3g = directions[:3] @ scaling @ S[:K, K : K + 3]
    A = S_3g @ np.linalg.pinv(S_gg, hermitian=True)
    whole = float(power[:3].sum())
    left = max(whole - float(np.sum(A * S_3g)), 0.0)
    turning = np.sqrt(np.maximum(np.linalg.eigvalsh(S_gg), 0.0))
    # gravity of zero is as far from its mean as the channels are from their offset
    centre = np.linalg.solve(scaling, directions[:3].T @ (-A @ attitude.mean[K : K + 3]))
    return InSituOffset(
        attitude.mean[:K] + centre,
        float(power[3:].sum() / power.sum()) if power.sum() > 0 else 1.0,
        float(np.sqrt(left / max(whole, np.finfo(float).tiny))),
        float(np.sqrt(np.trace(S[K + 3 :, K + 3 :]) / max(attitude.count, 1))),
        float(turning[0] / turning[-1]) if turning[-1] > 0 else 0.0,
    )
