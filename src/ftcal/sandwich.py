"""Standard errors that survive model errors: residuals that remember, and differ between moves.

Encoder steps, backlash and wrong inertias leave residuals that last for seconds and are larger
where the robot moves more. What counts for a gain is how the products of channel and residual add
up over time, not how the residual alone does: H. White (Econometrica 48, 1980); with lags, W. Newey
and K. West (Econometrica 55, 1987). Both need sums over cells of a second only: moments suffice.

Noise of the channels does more than scatter: it draws a gain towards zero along directions that
move little (W. Fuller, "Measurement Error Models", 1987, section 1.1). Second moments cannot say
how much of what is left over is the channels' and how much the model's, so the gain stays, and its
covariance grows by as far as it would be drawn if all were the channels'.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ftcal.folds import Cells, by_segment
from ftcal.noise import Noise
from ftcal.ridge import Estimate, ScaledProblem, scaling_map

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

LAGS = 2
"""Cells over which products are still correlated."""

WEAKEST = 0.1
"""Prior from which the bend that the data show is looked for: weaker than any mounting bends."""

ROUNDS = 100
"""Most rounds of that; it takes ten."""


def robust_posterior(
    problem: ScaledProblem, cells: Cells, kappa: Float[Array, "6"], noise: Noise
) -> Estimate:
    """Return the maximum a posteriori estimate with a covariance that model errors do not fool.

    `problem` is pooled from `cells`. Along each principal direction j of y the estimate of axis i
    keeps the share `rho = d_j / (d_j + penalty_i)` of the truth, with d the eigenvalues of S_yy:

        variance = (1 - rho)^2 bend^2 + m_ij / (d_j + penalty_i)^2

    with m the variance of the summed products, never less than the noise alone would leave, and
    `bend` what E is expected to be: kappa, or what the data show (`shown_bend`) where that is more.
    Where both agree and products are noise it is the posterior's. The square of `drawn` is added.
    """
    kappa = np.asarray(kappa)
    E = problem.path(kappa[None], noise)[0]
    d, V = np.linalg.eigh(problem.S_yy)
    d = np.maximum(d, 0.0)
    summed = product_variance(products(cells, problem, E), V)
    power = np.maximum(problem.noise_power(noise)[:, None] * d, summed)
    penalty = problem.penalties(kappa, noise)[:, None]
    held = d + penalty
    bend = np.maximum(kappa, shown_bend(problem, noise))[:, None]
    # directions that were taken out (`along`) hold no noise either
    moves = d > d[-1] * len(d) * np.finfo(float).eps
    variance = (penalty / held * bend) ** 2 + np.where(moves, power / held**2, 0.0)
    bias = np.where(moves, drawn(problem, E) @ V / held, 0.0) @ V.T
    spread = np.einsum("pj,ij,qj->ipq", V, variance, V)
    return problem.estimate(E, spread + bias[:, :, None] * bias[:, None, :])


def shown_bend(problem: ScaledProblem, noise: Noise) -> float:
    """Return the size of the entries of E that the data tell, root mean square; 0 of none.

    It is the fixed point of `kappa^2 = |E|^2 / gamma`, gamma the number of entries determined (D.
    MacKay, Neural Computation 4, 1992). A kappa chosen by cross-validation may be much less: what
    the data do not show costs nothing there, and would narrow the error bars.
    """
    d = np.maximum(np.linalg.eigvalsh(problem.S_yy), 0.0)
    kappa = WEAKEST
    for _ in range(ROUNDS):
        E = problem.path(np.full((1, 6), kappa), noise)[0]
        determined = float((d / (d + problem.penalties(np.full(6, kappa), noise)[:, None])).sum())
        if determined < 1.0:
            return 0.0
        last, kappa = kappa, float(np.sqrt(np.sum(E**2) / determined))
        if abs(kappa - last) <= 1e-3 * last or kappa == 0.0:
            break
    return kappa


def drawn(problem: ScaledProblem, E: Float[Array, "6 P"]) -> Float[Array, "6 P"]:
    """Return what noise takes from the cross scatter of y and z, if all is left over by channels.

    With B = F^-1 C T^-1 and noise n of the K channels in y, a fit leaves `z - E y = -B n`: of
    scatter L, and `S_zy` is less by `B S_nn = L B^+T`. A temperature has no noise.
    """
    inputs = len(problem.basis)
    workbench = problem.workbench
    channels = workbench.gain.shape[1]
    to_residual = np.hstack([-E, np.eye(6)])
    left = to_residual @ problem.moments.scatter @ to_residual.T
    gain = problem.coefficients(E)[:, :channels] / workbench.full_scale[:, None]
    B = gain @ np.linalg.inv(problem.basis[:channels, :channels])
    found = np.zeros((6, inputs))
    found[:, :channels] = left @ np.linalg.pinv(B).T
    return found


def products(
    cells: Cells, problem: ScaledProblem, E: Float[Array, "6 P"]
) -> list[Float[Array, "C 6 P"]]:
    """Return the sum of `(z - E y) y^T` over each cell, a table for every offset segment.

    y and z are taken about the mean of the segment, as the offset leaves them.
    """
    n = len(problem.basis)
    to_yz = scaling_map(problem.workbench, n)
    to_residual = to_yz[n:] - E @ to_yz[:n]
    moments, P = cells.moments, len(E.T)
    # of all cells at once: one product of two matrices
    both = np.einsum("jp,id->pdij", problem.basis, to_residual).reshape(-1, 6 * P)
    inside = moments.scatter.reshape(len(moments), -1)[:, : len(both)] @ both
    means = cells.sums.by_segment(cells.chosen).mean
    tables = []
    for group, mean in zip(by_segment(cells), means, strict=True):
        apart = moments.mean[group] - mean
        left, y = apart @ to_residual.T, apart[:, :n] @ problem.basis.T
        across = (moments.count[group, None] * left)[:, :, None] * y[:, None, :]
        table = inside[group].reshape(-1, 6, P) + across
        tables.append(cells.weight[group, None, None] * table)
    return tables


def product_variance(
    tables: Sequence[Float[Array, "B 6 P"]], directions: Float[Array, "P P"]
) -> Float[Array, "6 P"]:
    """Return the variance of the summed products of each axis along each direction (columns)."""
    variance = np.zeros(tables[0].shape[1:])
    for table in tables:
        along = (table.reshape(-1, len(directions)) @ directions).reshape(table.shape)
        variance += np.sum(along**2, axis=0)
        for lag in range(1, min(LAGS, len(along) - 1) + 1):
            weight = 2.0 * (1.0 - lag / (LAGS + 1.0))
            variance += weight * np.sum(along[lag:] * along[:-lag], axis=0)
    return np.maximum(variance, 0.0)
