"""One sensor's calibration from cells of training data: noise, prior strength, gain, offsets.

The order is the method's: what is left over by a weakly held fit is the noise; with it the
directions that the data see (`excitation`), in all others the prior stays; then the strength of
the prior by blocked cross-validation inside the training data; then the posterior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError
from ftcal.excitation import Excitation, excitation
from ftcal.folds import (
    Cells,
    Pool,
    aligned,
    aligned_means,
    blocked_folds,
    by_segment,
    pooled,
    reweighted,
)
from ftcal.moments import within
from ftcal.noise import Noise, inefficiency
from ftcal.ridge import Estimate, ScaledProblem, penalty_path
from ftcal.sandwich import robust_posterior
from ftcal.segments import Segment
from ftcal.sensor import Workbench

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

WEAK_KAPPA = 0.1
"""Prior held while the noise is measured: a tenth of full scale, weaker than any mounting bends."""

NOISE_ROUNDS = 4
"""Rounds of fit and residual; the noise moves by less than a percent after the third."""

KAPPAS = np.geomspace(3e-4, 0.3, 31)
"""Prior strengths tried, in fractions of full scale."""

MANY = 2**15
"""Samples beyond which the means of cells say how many of them count as one: smoothed samples
remember about a cell, so the means tell it as well."""

ROBUST_ROUNDS = 2
"""Rounds of fit and weights; a third moves the entries by less than their error."""

TIE = 0.002
"""Strengths whose held-out errors differ by less (relative) are equally good."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FitOptions:
    """How strongly the Workbench matrix is believed, and of what the errors are."""

    kappa: float | None = None
    """Prior standard deviation of the secondary matrix; None chooses it by blocked CV."""
    penalty: float | None = None
    """The paper's lambda instead of the scaled prior (0 is plain least squares)."""
    noise: tuple[float, ...] | None = None
    """Residual standard deviation per axis [N, Nm]; None measures it."""
    samples_per_independent: float | None = None
    """Samples that count as one; None measures it."""
    folds: int = 5
    """Blocks of the cross-validation that chooses kappa."""
    robust: bool = False
    """Whether seconds that do not fit count less (never with the paper's lambda)."""


@dataclass(frozen=True, slots=True)
class SegmentOffset:
    """The offset of one sensor during one stretch of one recording."""

    recording: str
    start: float
    """Seconds since the start of the recording."""
    stop: float
    """Seconds since the start of the recording, exclusive."""
    offset: Float[Array, "6"]
    """o of `w = C r + o` [N, Nm]."""
    sd: Float[Array, "6"]
    """Posterior standard deviation [N, Nm]."""


@dataclass(frozen=True, slots=True)
class PriorChoice:
    """What blocked cross-validation inside the training data saw."""

    kappas: Float[Array, "L"]
    """Prior standard deviations tried."""
    error: Float[Array, "L 6"]
    """Held-out RMS error per axis [N, Nm]."""
    workbench: Float[Array, "6"]
    """Held-out RMS error of the Workbench matrix per axis [N, Nm]."""
    chosen: float
    """The weakest of the best kappas, every axis weighing the same."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted sensor with what was believed and seen on the way."""

    estimate: Estimate
    noise: Noise
    excitation: Excitation
    kappa: Float[Array, "6"] | None
    """Prior standard deviation per axis, or None with the paper's lambda."""
    penalty: float | None
    """The paper's lambda, or None with the scaled prior."""
    choice: PriorChoice | None
    """How kappa was chosen, or None where it was given."""
    samples: int
    """Samples trained on."""
    down_weighted: float
    """Share of them that count less than once."""

    @property
    def independent(self) -> Float[Array, "6"]:
        """Effective number of independent samples per axis."""
        return np.asarray(self.samples / self.noise.inefficiency)


def fit(
    cells: Cells,
    workbench: Workbench,
    options: FitOptions | None = None,
    pool: Pool = within,
) -> Fit:
    """Return the fit of the training `cells`, offsets modelled as `pool` does.

    Raises `DataError` where there is nothing to fit.
    """
    options = options or FitOptions()
    if not len(cells):
        raise DataError("no usable sample is left to train on; see the data-health findings")
    found = _fit(cells, workbench, options, pool)
    if not options.robust or found.kappa is None:
        return found
    # data that were weighed by a fit would approve of a prior that lets it follow them
    held = replace(options, kappa=float(found.kappa[0]))
    robust = found
    for _ in range(ROBUST_ROUNDS):
        cells = reweighted(cells, robust.estimate.coefficients)
        robust = _fit(cells, workbench, held, pool)
    return replace(robust, choice=found.choice)


def _fit(cells: Cells, workbench: Workbench, options: FitOptions, pool: Pool) -> Fit:
    """Return the fit of cells that count as they do."""
    moments = pooled(cells, pool)
    problem = ScaledProblem.of(moments, workbench)
    noise = measured_noise(cells, problem, options)
    if options.penalty is not None:
        estimate = penalty_path(moments, workbench, np.array([options.penalty]))[0]
        kappa, choice = None, None
    else:
        choice = None
        directions = excitation(problem, noise).seen
        if options.kappa is None:
            choice = choose_kappa(
                cells, workbench, noise, directions, pool=pool, folds=options.folds
            )
        kappa = np.full(6, options.kappa if choice is None else choice.chosen)
        estimate = robust_posterior(problem.along(directions), cells, kappa, noise)
    seen = excitation(problem, noise, kappa)
    less = cells.down_weighted / cells.samples
    return Fit(estimate, noise, seen, kappa, options.penalty, choice, cells.samples, less)


def measured_noise(cells: Cells, problem: ScaledProblem, options: FitOptions) -> Noise:
    """Return the residual of a weakly held fit: its size and its statistical inefficiency.

    The size counts the parameters that the fit spent (an offset a segment, the data's share of
    every direction); it comes from the moments, only the inefficiency of short data needs the
    samples. What the options give is taken as given.
    """
    least = 1e-12 * problem.workbench.full_scale
    count = max(problem.moments.count, 1)
    d = np.maximum(np.linalg.eigvalsh(problem.S_yy), 0.0)
    kappas = np.full((1, 6), WEAK_KAPPA)
    E = np.zeros((6, len(d)))
    for _ in range(NOISE_ROUNDS):
        sd = np.maximum(np.sqrt(problem.squared_error(E) / count), least)
        E = problem.path(kappas, Noise(sd, np.ones(6)))[0]
    sd = np.maximum(np.sqrt(problem.squared_error(E) / count), least)
    repeat = repetition(cells, problem.coefficients(E))
    if options.samples_per_independent is not None:
        repeat = np.full(6, options.samples_per_independent)
    if options.noise is not None:
        return Noise(np.asarray(options.noise, dtype=np.float64), repeat)
    held = problem.penalties(kappas, Noise(sd, repeat))[0]
    spent = (d / (d + held[:, None])).sum(axis=1) + len(by_segment(cells))
    independent = count / repeat
    left = np.maximum(independent - spent, 0.1 * independent)
    return Noise(sd * np.sqrt(independent / left), repeat)


def repetition(cells: Cells, gain: Float[Array, "6 P"]) -> Float[Array, "6"]:
    """Return the statistical inefficiency of `w - gain x` about its mean in every segment.

    Where samples are more than `MANY`, or not all are kept, it follows from the means of cells:
    those of m samples have the variance `s_m^2` where single samples have `s^2`, and
    `g = m g_m s_m^2 / s^2` (H. Flyvbjerg, H. G. Petersen, "Error estimates on averages of
    correlated data", 1989).
    """
    samples = cells.samples
    if samples <= MANY and cells.whole:
        return inefficiency(aligned(cells, gain))
    means = aligned_means(cells, gain)
    to_residual = np.hstack([-gain, np.eye(6)])
    squares = np.diagonal(pooled(cells).map(to_residual).scatter) / samples
    of_means = np.sum([np.sum(part**2, axis=0) for part in means], axis=0) / len(cells)
    share = np.divide(of_means, squares, out=np.zeros(6), where=squares > 0)
    return np.asarray(np.maximum(samples / len(cells) * inefficiency(means) * share, 1.0))


def choose_kappa(
    cells: Cells,
    workbench: Workbench,
    noise: Noise,
    directions: Float[Array, "M P"],
    *,
    pool: Pool = within,
    folds: int = 5,
    kappas: Float[Array, "L"] = KAPPAS,
) -> PriorChoice:
    """Return the prior strength that predicts held-out blocks of the training data best.

    Only along `directions` (orthonormal rows), those that the data excite, does E leave the prior.

    A held-out block is scored about its own mean: its offset is re-estimated, as in the paper's
    validation. One strength serves all axes, the geometric mean of their errors being least: per
    axis the curves of a minute of data have several minima (decision 0004). Of equally good ones
    the weakest is taken: where data decide everything, a prior must not narrow the error bars.
    """
    grid = np.broadcast_to(kappas[:, None], (len(kappas), 6))
    squares, baseline, count = [], [], 0.0
    for fold in blocked_folds(cells, max(2, min(folds, len(cells) // 2))):
        train = ScaledProblem.of(pooled(fold.train, pool), workbench).along(directions)
        held = ScaledProblem.of(pooled(fold.held, pool), workbench)
        squares.append(held.squared_error(train.path(grid, noise)))
        baseline.append(held.squared_error(np.zeros((6, len(held.basis)))))
        count += held.moments.count
    summed = np.sum(squares, axis=0)
    floor = np.finfo(float).tiny
    score = 0.5 * np.log(np.maximum(summed, floor)).mean(axis=1)
    best = int(np.flatnonzero(score <= score.min() + TIE)[-1])
    return PriorChoice(
        np.asarray(kappas),
        np.sqrt(summed / count),
        np.sqrt(np.sum(baseline, axis=0) / count),
        float(kappas[best]),
    )


def segment_offsets(
    segments: Sequence[Segment], estimate: Estimate, noise: Noise
) -> tuple[SegmentOffset, ...]:
    """Return the offset of every segment under `estimate` (P4)."""
    offsets = []
    for segment in segments:
        moments = segment.moments()
        offsets.append(
            SegmentOffset(
                segment.samples.recording,
                float(segment.spans[0, 0]),
                float(np.nextafter(segment.spans[-1, 1], np.inf)),
                estimate.offset(moments),
                estimate.offset_error(moments, noise),
            )
        )
    return tuple(offsets)
