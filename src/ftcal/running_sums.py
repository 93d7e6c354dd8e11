"""Moments of cells summed once up to every cell: any run of cells is the difference of two sums.

So folds, and folds inside folds, pool their cells without going over them. Sums are taken about
the mean of each segment, never about zero: counts ride on offsets far larger than the signal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.moments import Stacked

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True, eq=False)
class RunningSums:
    """What all cells before one add up to: a run of cells is the difference of two."""

    segment: Int[Array, "B"]
    """That each cell belongs to."""
    begins: Bool[Array, "B"]
    """Whether it is the first of its segment."""
    origin: Float[Array, "S D"]
    """Mean of each segment: sums are taken about it, as counts ride on large offsets."""
    table: Float[Array, "B+1 1+D+D*D"]
    """Sums of count, distance from the origin, and outer product of that distance."""

    @staticmethod
    def of(moments: Stacked, segment: Int[Array, "B"], weight: Float[Array, "B"]) -> RunningSums:
        """Return the sums over cells of segments, in order, whose samples count `weight` each."""
        cells, D = moments.mean.shape
        begins = np.diff(segment, prepend=-1) > 0
        starts = np.flatnonzero(begins)
        count = weight * moments.count
        # about the mean of a cell first: the others are near it, zero is not
        origin = moments.mean[starts]
        apart = moments.mean - origin[segment]
        if cells:
            sums = [np.add.reduceat(terms, starts) for terms in (count[:, None] * apart, count)]
            origin = origin + sums[0] / sums[1][:, None]
            apart = moments.mean - origin[segment]
        table = np.zeros((cells + 1, 1 + D + D * D))
        terms = table[1:]
        terms[:, 0] = count
        terms[:, 1 : D + 1] = count[:, None] * apart
        np.multiply(
            terms[:, 1 : D + 1, None],
            apart[:, None, :],
            out=terms[:, D + 1 :].reshape(cells, D, D),
        )
        terms[:, D + 1 :] += weight[:, None] * moments.scatter.reshape(cells, D * D)
        np.cumsum(terms, axis=0, out=terms)
        return RunningSums(segment, begins, origin, table)

    def by_segment(self, chosen: Bool[Array, "B"]) -> Stacked:
        """Return the moments of the chosen cells, put together in every segment."""
        apart = np.ones(len(chosen) + 1, dtype=bool)
        np.logical_or(self.begins[1:], chosen[1:] != chosen[:-1], out=apart[1:-1])
        first = np.flatnonzero(chosen & apart[:-1])
        last = np.flatnonzero(chosen & apart[1:]) + 1
        segment = self.segment[first]
        own = np.flatnonzero(np.diff(segment, prepend=-1))
        sums = np.add.reduceat(self.table[last] - self.table[first], own)
        D = self.origin.shape[1]
        count, step = sums[:, 0], sums[:, 1 : D + 1]
        mean = step / count[:, None]
        scatter = sums[:, D + 1 :].reshape(-1, D, D) - step[:, :, None] * mean[:, None, :]
        return Stacked(count, self.origin[segment[own]] + mean, scatter)
