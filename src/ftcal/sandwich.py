"""Standard errors that survive model errors: residuals that remember, and differ between moves.

Encoder steps, backlash and wrong inertias leave residuals that last for seconds and are larger
where the robot moves more. What counts for a gain is how the products of channel and residual add
up over time, not how the residual alone does: H. White (Econometrica 48, 1980); with lags, W. Newey
and K. West (Econometrica 55, 1987). Both need sums over cells of a second only: moments suffice.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ftcal.folds import Cell, by_segment
from ftcal.moments import total
from ftcal.noise import Noise
from ftcal.ridge import Estimate, ScaledProblem, scaling_map

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

LAGS = 2
"""Cells over which products are still correlated."""


def robust_posterior(
    problem: ScaledProblem, cells: Sequence[Cell], kappa: Float[Array, "6"], noise: Noise
) -> Estimate:
    """Return the maximum a posteriori estimate with a covariance that model errors do not fool.

    `problem` is pooled from `cells`. Along each principal direction j of y the information on axis
    i is `d_j^2 / m_ij`, with `d` the eigenvalues of S_yy and `m` the variance of the summed
    products; never more than the noise alone would leave (`ScaledProblem.posterior`).
    """
    E = problem.path(np.asarray(kappa)[None], noise)[0]
    d, V = np.linalg.eigh(problem.S_yy)
    d = np.maximum(d, 0.0)
    summed = product_variance(products(cells, problem, E), V)
    power = np.maximum(problem.noise_power(noise)[:, None] * d, summed)
    information = np.divide(d**2, power, out=np.zeros_like(power), where=power > 0)
    variance = 1.0 / (information + 1.0 / np.asarray(kappa)[:, None] ** 2)
    return problem.estimate(E, np.einsum("pj,ij,qj->ipq", V, variance, V))


def products(
    cells: Sequence[Cell], problem: ScaledProblem, E: Float[Array, "6 P"]
) -> list[Float[Array, "B 6 P"]]:
    """Return the sum of `(z - E y) y^T` over each cell, a table for every offset segment.

    y and z are taken about the mean of the segment, as the offset leaves them.
    """
    n = len(problem.basis)
    to_yz = scaling_map(problem.workbench, n)
    to_residual = to_yz[n:] - E @ to_yz[:n]
    tables = []
    for group in by_segment(cells):
        mean = total([cell.moments for cell in group]).mean
        scatters = np.array([cell.moments.about(mean).scatter for cell in group])
        tables.append(to_residual @ scatters @ to_yz[:n].T)
    return tables


def product_variance(
    tables: Sequence[Float[Array, "B 6 P"]], directions: Float[Array, "P P"]
) -> Float[Array, "6 P"]:
    """Return the variance of the summed products of each axis along each direction (columns)."""
    variance = np.zeros(tables[0].shape[1:])
    for table in tables:
        along = table @ directions
        variance += np.sum(along**2, axis=0)
        for lag in range(1, min(LAGS, len(along) - 1) + 1):
            weight = 2.0 * (1.0 - lag / (LAGS + 1.0))
            variance += weight * np.sum(along[lag:] * along[:-lag], axis=0)
    return np.maximum(variance, 0.0)
