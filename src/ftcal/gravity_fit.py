"""Least squares of a weight: mass, lever and offset from the moments of (gravity, wrench).

    w = s [m g; m c x g] + o

is linear in (s m, s m c, o), and the offsets drop out with the mean: what the fit needs of any
number of rows is a 9x9 scatter, and leaving an attitude out is a sum of the others' moments.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ftcal.moments import Moments, total
from ftcal.spatial import skew

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

MOST_FOLDS = 200
"""Poses beyond share folds: leaving out one of a thousand changes nothing."""

PRIOR_POSES = 10.0
"""Poses' worth of belief that the three axes of a force are equally noisy, when weighing them."""

SINGULAR = 1e-10
"""Share of the largest eigenvalue below which a direction is rounding."""

ZERO = 1e-9
"""Noise below this share of the readings is rounding."""

TINY = float(np.finfo(np.float64).tiny)
"""What is divided by where there is nothing."""

NOTHING = 1e-12
"""A mass [kg] that has no centre, a noise [N, Nm] that no sensor has."""

EFFECT = np.stack(
    [np.block([[e[:, None], np.zeros((3, 3))], [np.zeros((3, 1)), -skew(e)]]) for e in np.eye(3)]
)
"""`EFFECT[k]` is what one m/s^2 of gravity along axis k makes of (m, m c): a 6x4 matrix."""


@dataclass(frozen=True, slots=True, eq=False)
class GravityFit:
    """Weighted least squares of (s m, s m c) from moments, the offsets eliminated."""

    mean: Float[Array, "9"]
    """Of gravity [m/s^2] and wrench [N, Nm]."""
    theta: Float[Array, "4"]
    """(s m, s m c) [kg, kg m]."""
    normal: Float[Array, "6 4 4"]
    """Normal matrix of each axis, unweighted."""
    bread: Float[Array, "4 4"]
    """Inverse of the weighted sum of the normal matrices; zero along what is not determined."""

    @classmethod
    def of(cls, moments: Moments, weight: Float[Array, "6"]) -> GravityFit:
        """Return the fit to rows (gravity, wrench) with these moments, `weight` per axis."""
        S = moments.scatter
        normal = np.einsum("kia,kl,lib->iab", EFFECT, S[:3, :3], EFFECT)
        right = np.einsum("kia,ki,i->a", EFFECT, S[:3, 3:], weight)
        weighted = np.einsum("iab,i->ab", normal, weight)
        # mass and lever have units apart: what is singular is judged in equal scales
        size = np.array([weighted[0, 0], *[np.trace(weighted[1:, 1:])] * 3])
        scale = 1.0 / np.sqrt(np.maximum(size, TINY))
        scaled = scale[:, None] * weighted * scale
        bread = np.linalg.pinv(scaled, rcond=SINGULAR, hermitian=True)
        bread = scale[:, None] * bread * scale
        return cls(moments.mean, bread @ right, normal, bread)

    def figures(self) -> tuple[Float[Array, "10"], Float[Array, "10 4"]]:
        """Return (s m, centre of mass, offset), and their slope in (s m, s m c)."""
        at_mean = np.einsum("k,kia->ia", self.mean[:3], EFFECT)
        mass = self.theta[0] if abs(self.theta[0]) > NOTHING else np.nan
        centre = self.theta[1:] / mass
        slope = np.zeros((10, 4))
        slope[0, 0], slope[4:] = 1.0, -at_mean
        slope[1:4, 0], slope[1:4, 1:] = -centre / mass, np.eye(3) / mass
        offset = self.mean[3:] - at_mean @ self.theta
        return np.concatenate([[self.theta[0]], centre, offset]), slope

    def left(self, moments: Moments) -> Float[Array, "6"]:
        """Return the sum of squared residuals per axis, from the moments of the rows.

        It is good to the rounding of the scatter; exact small residuals come from the rows.
        """
        S = moments.scatter
        together = np.einsum("kia,ki,a->i", EFFECT, S[:3, 3:], self.theta)
        model = np.einsum("iab,a,b->i", self.normal, self.theta, self.theta)
        return np.asarray(np.diag(S)[3:] - 2.0 * together + model)

    def sd(self, residual: Float[Array, "N 6"], weight: Float[Array, "6"]) -> Float[Array, "6"]:
        """Return the standard deviation per axis, less the unknowns that the axis carried."""
        spent = 1.0 + np.einsum("ab,iab->i", self.bread, self.normal) * weight
        free = np.maximum(len(residual) - spent, 1.0)
        return np.asarray(np.sqrt((residual**2).sum(axis=0) / free))

    def residual(
        self, gravity: Float[Array, "N 3"], wrench: Float[Array, "N 6"]
    ) -> Float[Array, "N 6"]:
        """Return reading minus model, the offset that makes the mean fit included."""
        model = np.einsum("nk,kia,a->ni", gravity - self.mean[:3], EFFECT, self.theta)
        return np.asarray(wrench - self.mean[3:] - model)


def rounding(wrench: Float[Array, "N 6"]) -> Float[Array, "6"]:
    """Return the residual per axis below which nothing but rounding is left [N, Nm]."""
    size = np.sqrt(np.mean(wrench.reshape(-1, 2, 3) ** 2, axis=(0, 2))).repeat(3)
    return np.asarray(np.maximum(ZERO * size, NOTHING))


def weights(moments: Moments, rows: Float[Array, "N 9"]) -> Float[Array, "6"]:
    """Return the inverse variance per axis under equal weights; few poses say little of it.

    Each axis is drawn towards the mean of its kind, force or torque.
    """
    residual = GravityFit.of(moments, np.ones(6)).residual(rows[:, :3], rows[:, 3:])
    square = (residual**2).reshape(-1, 2, 3)
    pooled = square.mean(axis=(0, 2))[:, None]
    drawn = (square.sum(axis=0) + PRIOR_POSES * pooled) / (len(square) + PRIOR_POSES)
    return np.asarray(1.0 / np.maximum(drawn.ravel(), rounding(rows[:, 3:]) ** 2))


def held_out(
    number: Int[Array, "N"], rows: Float[Array, "N 9"], weight: Float[Array, "6"]
) -> tuple[Float[Array, "N 6"], Float[Array, "10"]]:
    """Return residuals under the fit of all other attitudes, and the jackknife variance of figures.

    Leaving whole attitudes out counts what all samples of an attitude share: hysteresis, a cable.
    B. Efron and C. Stein, "The jackknife estimate of variance", 1981.
    """
    count = int(number[-1]) + 1
    folds = number * min(count, MOST_FOLDS) // count
    edges = np.flatnonzero(np.diff(folds, prepend=-1, append=folds[-1] + 1))
    spans = [slice(int(a), int(b)) for a, b in pairwise(edges)]
    parts = [Moments.of(rows[span]) for span in spans]
    left = np.empty((len(rows), 6))
    found = []
    for k, span in enumerate(spans):
        others = GravityFit.of(total(parts[:k] + parts[k + 1 :]), weight)
        left[span] = others.residual(rows[span, :3], rows[span, 3:])
        found.append(others.figures()[0])
    return left, (len(spans) - 1) * np.var(found, axis=0)
