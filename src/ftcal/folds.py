"""Training data in cells of about a second, and the folds that blocked cross-validation cuts.

A fold holds out neighbouring cells as one block in time; the cells beside the block are left out
of training too, because a smoothed sample knows its neighbours. Moments are taken once per cell:
every fold, every penalty is then small algebra.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError
from ftcal.moments import Moments, total, within
from ftcal.robust import huber_weights
from ftcal.samples import Samples

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

MOST_CELLS = 2000
"""More cells tell neither folds nor error bars any better: of hours of data they get longer."""

Pool = Callable[[Sequence[Moments]], Moments]
"""How the moments of offset segments are pooled, which is how their offsets are modelled."""


def about_zero(parts: Sequence[Moments]) -> Moments:
    """Pool segments whose offset was taken off beforehand (in situ offset): none is left to fit."""
    pooled = total(parts)
    return pooled.about(np.zeros_like(pooled.mean))


@dataclass(frozen=True, slots=True)
class Cell:
    """A short stretch of one offset segment."""

    segment: int
    """Index of the offset segment it belongs to."""
    index: int
    """Index of the cell in its segment."""
    samples: Samples
    moments: Moments
    """Of its samples, as often as they count."""
    weight: float = 1.0
    """What each of them counts."""

    def reweighted(self, weight: float) -> Cell:
        """Return the cell with samples that count `weight` each."""
        return replace(self, moments=self.moments.weighted(weight / self.weight), weight=weight)


@dataclass(frozen=True, slots=True)
class Fold:
    """What is trained on, and the block that is held out."""

    train: tuple[Cell, ...]
    held: tuple[Cell, ...]


def cells(segments: Sequence[Samples], length: float) -> tuple[Cell, ...]:
    """Return the non-empty cells of about `length` seconds that tile the segments, in order.

    Of segments that would make more than `MOST_CELLS` of them the cells are longer instead.
    """
    found = []
    whole = sum(float(segment.time[-1] - segment.time[0]) for segment in segments if len(segment))
    length = max(length, whole / MOST_CELLS)
    for number, segment in enumerate(segments):
        if not len(segment):
            continue
        first, last = float(segment.time[0]), float(segment.time[-1])
        edges = np.linspace(first, last, max(1, round((last - first) / length)) + 1)
        edges[-1] = np.nextafter(edges[-1], np.inf)
        pieces = [segment.between(a, b) for a, b in itertools.pairwise(edges)]
        kept = [piece for piece in pieces if len(piece)]
        ends = np.cumsum([0, *map(len, kept)])
        of_each = Moments.of_each(segment.rows(), ends)
        found += [Cell(number, i, *both) for i, both in enumerate(zip(kept, of_each, strict=True))]
    return tuple(found)


def by_segment(some: Sequence[Cell]) -> list[list[Cell]]:
    """Return the cells grouped by the offset segment they belong to."""
    return [list(group) for _, group in itertools.groupby(some, key=attrgetter("segment"))]


def segment_moments(some: Sequence[Cell]) -> list[Moments]:
    """Return the moments of every offset segment that the cells are part of."""
    return [total([cell.moments for cell in group]) for group in by_segment(some)]


def pooled(some: Sequence[Cell], pool: Pool = within) -> Moments:
    """Return the moments of all cells, the offset of each segment modelled as `pool` does."""
    return pool(segment_moments(some))


def blocked_folds(some: Sequence[Cell], count: int, guard: int = 1) -> list[Fold]:
    """Return `count` folds, each holding out one block of neighbouring cells.

    `guard` cells on either side of the block, in the same segment, are in neither part. Raises
    `DataError` where there are fewer than two cells a fold.
    """
    if len(some) < 2 * count:
        raise DataError(
            f"{len(some)} cells of training data are too few for {count} folds; record longer, or"
            f" ask for {max(len(some) // 2, 2)} folds"
        )
    ends = np.cumsum([cell.moments.count for cell in some])
    block = np.minimum((ends - 1) * count // ends[-1], count - 1)
    folds = []
    for number in range(count):
        held = tuple(cell for cell, b in zip(some, block, strict=True) if b == number)
        near = {(c.segment, c.index + d) for c in held for d in range(-guard, guard + 1)}
        train = tuple(cell for cell in some if (cell.segment, cell.index) not in near)
        if held and train:
            folds.append(Fold(train, held))
    return folds


def aligned(
    groups: Sequence[Sequence[Cell]], gain: Float[Array, "6 P"]
) -> list[Float[Array, "N 6"]]:
    """Return `w - gain x` of every group of cells about its own mean, x = `[channels, dT?]`.

    What counts less than once is less: its square counts in full.
    """
    residuals = []
    for group in groups:
        rows = np.concatenate([cell.samples.rows() for cell in group])
        weight = np.concatenate([np.full((len(cell.samples), 1), cell.weight) for cell in group])
        residual = rows[:, -6:] - rows[:, :-6] @ gain.T
        mean = (weight * residual).sum(axis=0) / weight.sum()
        residuals.append(np.sqrt(weight) * (residual - mean))
    return residuals


def aligned_means(
    groups: Sequence[Sequence[Cell]], gain: Float[Array, "6 P"]
) -> list[Float[Array, "B 6"]]:
    """Return the mean of `w - gain x` over every cell, about the mean of its group, as `aligned`.

    It comes from the moments: no sample is looked at.
    """
    residuals = []
    for group in groups:
        means = np.array([cell.moments.mean for cell in group])
        counts = np.array([[cell.moments.count] for cell in group])
        weight = np.array([[cell.weight] for cell in group])
        residual = means[:, -6:] - means[:, :-6] @ gain.T
        mean = (counts * residual).sum(axis=0) / counts.sum()
        residuals.append(np.sqrt(weight) * (residual - mean))
    return residuals


def reweighted(some: Sequence[Cell], gain: Float[Array, "6 P"]) -> tuple[Cell, ...]:
    """Return the cells with the weights that their residuals under `gain` call for."""
    found: list[Cell] = []
    for group in by_segment(some):
        means = np.array([cell.moments.mean for cell in group])
        weights = huber_weights(means[:, -6:] - means[:, :-6] @ gain.T)
        found += [cell.reweighted(float(w)) for cell, w in zip(group, weights, strict=True)]
    return tuple(found)
