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


def in_situ_offset(
    channels: Float[Array, "N K"],
    gravity: Float[Array, "N 3"],
    centre_of_mass: Float[Array, "N 3"],
    scaling: Float[Array, "K K"],
) -> InSituOffset:
    """Return the centre of the ellipsoid that the raw channels draw as gravity turns.

    `gravity` [m/s^2] and `centre_of_mass` [m] of the free half come from the model, in the sensor
    frame; `scaling` (`Workbench.scaling`) makes the channels comparable. Minimises
    `sum |A g + b - r3|^2` over A (3x3) and b, with `r3` the centred channels on their three
    principal directions; b mapped back is the offset.
    """
    mean = channels.mean(axis=0)
    scaled = (channels - mean) @ scaling.T
    _, spread, directions = np.linalg.svd(scaled, full_matrices=False)
    power = spread**2
    r3 = scaled @ directions[:3].T
    design = np.column_stack([gravity, np.ones(len(gravity))])
    solution = np.linalg.lstsq(design, r3, rcond=None)[0]
    left = r3 - design @ solution
    turning = np.linalg.svd(gravity - gravity.mean(axis=0), compute_uv=False)
    moved = centre_of_mass - centre_of_mass.mean(axis=0)
    centre = np.linalg.solve(scaling, directions[:3].T @ solution[3])
    return InSituOffset(
        mean + centre,
        float(power[3:].sum() / power.sum()) if power.sum() > 0 else 1.0,
        float(np.sqrt(np.sum(left**2) / max(np.sum(r3**2), np.finfo(float).tiny))),
        float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))),
        float(turning[-1] / turning[0]) if turning[0] > 0 else 0.0,
    )
