"""Training data in cells of about a second, and the folds that blocked cross-validation cuts.

A fold holds out neighbouring cells as one block in time; the cells beside the block are left out
of training too, because a smoothed sample knows its neighbours. Moments are taken once per cell,
and summed once up to every cell: what any run of cells adds up to is the difference of two sums,
so that folds, and folds inside folds, cost next to nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError
from ftcal.moments import Moments, Stacked, total, within
from ftcal.robust import huber_weights
from ftcal.running_sums import RunningSums
from ftcal.segments import MOST_CELLS, Segment, covered

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array

Pool = Callable[[Sequence[Moments]], Moments]
"""How the moments of offset segments are pooled, which is how their offsets are modelled."""


def about_zero(parts: Sequence[Moments]) -> Moments:
    """Pool segments whose offset was taken off beforehand (in situ offset): none is left to fit."""
    pooled = total(parts)
    return pooled.about(np.zeros_like(pooled.mean))


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Cells of some segments, or some of these: the tables are of all B, `chosen` says which."""

    segments: tuple[Segment, ...]
    """What they are cells of."""
    segment: Int[Array, "B"]
    """Index of the segment that each belongs to; in order."""
    index: Int[Array, "B"]
    """Index of each in its segment."""
    moments: Stacked
    """Of `Samples.rows`, every sample counting once."""
    spans: Float[Array, "B 2"]
    """Times of the first and the last sample of each [s]."""
    weight: Float[Array, "B"]
    """What each of their samples counts."""
    chosen: Bool[Array, "B"]
    """Those that are in."""
    sums: RunningSums
    """Of all, as often as their samples count."""

    def __len__(self) -> int:
        return int(np.count_nonzero(self.chosen))

    @property
    def rows(self) -> Int[Array, "C"]:
        """Rows of the tables that are in."""
        return np.flatnonzero(self.chosen)

    @property
    def whole(self) -> bool:
        """Whether their segments keep all samples."""
        return all(self.segments[i].whole for i in np.unique(self.segment[self.chosen]))

    @property
    def samples(self) -> int:
        """Number of samples."""
        return round(float(self.moments.count[self.chosen].sum()))

    @property
    def down_weighted(self) -> int:
        """Number of samples that count less than once."""
        return round(float(self.moments.count[self.chosen & (self.weight < 1.0)].sum()))

    def some(self, chosen: Bool[Array, "B"]) -> Cells:
        """Return those of all cells that `chosen` says."""
        return replace(self, chosen=chosen)

    def weighing(self, weight: Float[Array, "B"]) -> Cells:
        """Return the cells with samples that count `weight` each."""
        sums = RunningSums.of(self.moments, self.segment, weight)
        return replace(self, weight=weight, sums=sums)


@dataclass(frozen=True, slots=True, eq=False)
class Fold:
    """What is trained on, and the block that is held out."""

    train: Cells
    held: Cells


def cells(segments: Sequence[Segment]) -> Cells:
    """Return all cells of the segments, in order.

    Of more than `MOST_CELLS` in all, neighbours of a segment are put together.
    """
    together = max(1, -(-sum(len(one.cells) for one in segments) // MOST_CELLS))
    moments, spans, counts = [], [], []
    for one in segments:
        # what is left at the end goes to the last where it is short of half a cell
        starts = together * np.arange(max(1, round(len(one.cells) / together)))
        moments.append(one.cells.merged(starts))
        spans.append(covered(one.spans, starts))
        counts.append(len(starts))
    number = np.repeat(np.arange(len(counts)), counts)
    weight = np.ones(len(number))
    stacked = Stacked.joined(moments, 0)
    return Cells(
        tuple(segments),
        number,
        np.concatenate([np.arange(0), *map(np.arange, counts)]),
        stacked,
        np.concatenate([np.zeros((0, 2)), *spans]),
        weight,
        np.ones(len(number), dtype=bool),
        RunningSums.of(stacked, number, weight),
    )


def by_segment(some: Cells) -> list[Int[Array, "C"]]:
    """Return the rows of the cells that are in, a list for every segment."""
    rows = some.rows
    return np.split(rows, np.flatnonzero(np.diff(some.segment[rows])) + 1) if len(rows) else []


def segment_moments(some: Cells) -> list[Moments]:
    """Return the moments of every offset segment that the cells are part of."""
    stacked = some.sums.by_segment(some.chosen)
    return [stacked.one(i) for i in range(len(stacked))]


def pooled(some: Cells, pool: Pool = within) -> Moments:
    """Return the moments of all cells, the offset of each segment modelled as `pool` does."""
    return pool(segment_moments(some))


def blocked_folds(some: Cells, count: int, guard: int = 1) -> list[Fold]:
    """Return `count` folds, each holding out one block of neighbouring cells.

    `guard` cells on either side of the block, in the same segment, are in neither part. Raises
    `DataError` where there are fewer than two cells a fold.
    """
    if len(some) < 2 * count:
        raise DataError(
            f"{len(some)} cells of training data are too few for {count} folds; record longer, or"
            f" ask for {max(len(some) // 2, 2)} folds"
        )
    rows = some.rows
    ends = np.cumsum(some.weight[rows] * some.moments.count[rows])
    block = np.full(len(some.chosen), -1)
    block[rows] = np.minimum((ends - 1) * count // ends[-1], count - 1)
    folds = []
    for number in range(count):
        held = block == number
        near = held.copy()
        for away in range(1, guard + 1):
            same = some.segment[away:] == some.segment[:-away]
            near[away:] |= held[:-away] & same
            near[:-away] |= held[away:] & same
        train = some.chosen & ~near
        if held.any() and train.any():
            folds.append(Fold(some.some(train), some.some(held)))
    return folds


def aligned(some: Cells, gain: Float[Array, "6 P"]) -> list[Float[Array, "N 6"]]:
    """Return `w - gain x` in every segment about its own mean, x = `[channels, dT?]`.

    What counts less than once is less: its square counts in full. The segments must keep all
    samples (`whole`).
    """
    residuals = []
    for group in by_segment(some):
        number = int(some.segment[group[0]])
        mine = some.segment == number
        counts = some.moments.count[mine].astype(np.int64)
        keep = np.repeat(some.chosen[mine], counts)
        weight = np.repeat(some.weight[mine], counts)[keep, None]
        rows = some.segments[number].samples.rows()[keep]
        residual = rows[:, -6:] - rows[:, :-6] @ gain.T
        mean = (weight * residual).sum(axis=0) / weight.sum()
        residuals.append(np.sqrt(weight) * (residual - mean))
    return residuals


def aligned_means(some: Cells, gain: Float[Array, "6 P"]) -> list[Float[Array, "C 6"]]:
    """Return the mean of `w - gain x` over every cell, about the mean of its segment, as `aligned`.

    It comes from the moments: no sample is looked at.
    """
    residuals = []
    for group in by_segment(some):
        weight = some.weight[group, None]
        counts = weight * some.moments.count[group, None]
        residual = mean_residuals(some, group, gain)
        mean = (counts * residual).sum(axis=0) / counts.sum()
        residuals.append(np.sqrt(weight) * (residual - mean))
    return residuals


def mean_residuals(
    some: Cells, rows: Int[Array, "C"], gain: Float[Array, "6 P"]
) -> Float[Array, "C 6"]:
    """Return the mean of `w - gain x` over each of the cells in `rows`."""
    means = some.moments.mean[rows]
    return np.asarray(means[:, -6:] - means[:, :-6] @ gain.T)


def reweighted(some: Cells, gain: Float[Array, "6 P"]) -> Cells:
    """Return the cells with the weights that their residuals under `gain` call for."""
    weight = some.weight.copy()
    for group in by_segment(some):
        weight[group] = huber_weights(mean_residuals(some, group, gain))
    return some.weighing(weight)
