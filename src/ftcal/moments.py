"""Count, mean and centred scatter of a table: all that least squares needs of it, and they merge.

Scatter is kept about the mean because counts ride on offsets of 30 000 with 100 of signal, and
merged so: T. F. Chan, G. H. Golub, R. J. LeVeque, "Updating formulae and a pairwise
algorithm for computing sample variances", Stanford 1979. How moments are pooled is how offsets are
modelled: `a + b` is one table with one offset, `within([a, b])` two tables with an offset each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array


PIECES = 500
"""Pieces of a table whose moments are taken at once: they stay in the cache."""


@dataclass(frozen=True, slots=True)
class Moments:
    """First and second moments of the rows of a table with D columns."""

    count: float
    """Number of rows N; rows that count less count as parts of one."""
    mean: Float[Array, "D"]
    """Mean of the rows; zero where there is none."""
    scatter: Float[Array, "D D"]
    """Sum over the rows of the outer product of their distance from the mean."""

    @staticmethod
    def of(rows: Float[Array, "N D"]) -> Moments:
        """Return the moments of a table; a table without rows has zero moments."""
        count, width = rows.shape
        if count == 0:
            return Moments(0, np.zeros(width), np.zeros((width, width)))
        mean = rows.mean(axis=0)
        centred = rows - mean
        # a rounded mean leaves a rest of order eps * |mean|: take it out of the scatter as well
        rest = centred.mean(axis=0)
        return Moments(count, mean + rest, centred.T @ centred - count * np.outer(rest, rest))

    def __add__(self, other: Moments) -> Moments:
        """Return the moments of both tables stacked, which share one mean."""
        count = self.count + other.count
        if count == 0:
            return self
        step = other.mean - self.mean
        return Moments(
            count,
            self.mean + step * (other.count / count),
            self.scatter
            + other.scatter
            + np.outer(step, step) * (self.count * other.count / count),
        )

    def weighted(self, weight: float) -> Moments:
        """Return the moments of the same rows, each of which counts `weight` times."""
        return Moments(self.count * weight, self.mean, self.scatter * weight)

    def map(self, matrix: Float[Array, "E D"]) -> Moments:
        """Return the moments of the rows `matrix @ row`."""
        return Moments(self.count, matrix @ self.mean, matrix @ self.scatter @ matrix.T)

    def about(self, origin: Float[Array, "D"]) -> Moments:
        """Return these moments with the scatter taken about a known `origin`, not the mean."""
        step = self.mean - origin
        return Moments(self.count, self.mean, self.scatter + self.count * np.outer(step, step))

    def covariance(self) -> Float[Array, "D D"]:
        """Return the scatter per row (zero without rows)."""
        return self.scatter / max(self.count, 1)


@dataclass(frozen=True, slots=True)
class Stacked:
    """Moments of B tables of the same columns, stacked along their first axis."""

    count: Float[Array, "B"]
    """Rows of each."""
    mean: Float[Array, "B D"]
    scatter: Float[Array, "B D D"]

    @staticmethod
    def of_each(rows: Float[Array, "N D"], edges: Int[Array, "E"]) -> Stacked:
        """Return the moments of the pieces of a table that begin and end at `edges`, none empty."""
        found = [_of_pieces(rows, edges[at : at + PIECES + 1])
                 for at in range(0, len(edges) - 1, PIECES)]  # fmt: skip
        return Stacked.joined(found, rows.shape[1])

    @staticmethod
    def joined(parts: Sequence[Stacked], width: int) -> Stacked:
        """Return stacks of D = `width` columns one after the other; of none an empty one."""
        none = Stacked(np.zeros(0), np.zeros((0, width)), np.zeros((0, width, width)))
        if len(parts) < 2:
            return parts[0] if parts else none
        return Stacked(
            np.concatenate([part.count for part in parts]),
            np.concatenate([part.mean for part in parts]),
            np.concatenate([part.scatter for part in parts]),
        )

    def __len__(self) -> int:
        return len(self.count)

    def __getitem__(self, which: slice | Array) -> Stacked:
        return Stacked(self.count[which], self.mean[which], self.scatter[which])

    def one(self, which: int) -> Moments:
        """Return the moments of one table."""
        return Moments(float(self.count[which]), self.mean[which], self.scatter[which])

    def total(self) -> Moments:
        """Return the moments of all tables stacked into one; there must be one at least."""
        count = float(self.count.sum())
        if count == 0:
            return self.one(0)
        # about one of the means: the others are near it, zero is not
        near = self.mean[int(self.count.argmax())]
        steps = self.mean - near
        step = self.count @ steps / count
        apart = steps - step
        scatter = self.scatter.sum(axis=0) + apart.T @ (self.count[:, None] * apart)
        return Moments(count, near + step, scatter)

    def merged(self, starts: Int[Array, "G"]) -> Stacked:
        """Return neighbours put together: group g is `starts[g]` to before `starts[g + 1]`."""
        sizes = np.diff(np.append(starts, len(self)))
        several = sizes > 1
        found = self[starts]
        if not several.any():
            return found
        # most are alone where cells are merged that a border of two portions has cut
        some = self[np.repeat(several, sizes)]
        counts = sizes[several]
        begin = np.cumsum(counts) - counts
        which = np.repeat(np.arange(len(counts)), counts)
        count = np.add.reduceat(some.count, begin)
        safe = np.where(count > 0, count, 1.0)
        # about one of the means: the others are near it, zero is not
        steps = some.mean - some.mean[begin][which]
        step = np.add.reduceat(some.count[:, None] * steps, begin) / safe[:, None]
        apart = steps - step[which]
        between = (some.count[:, None] * apart)[:, :, None] * apart[:, None, :]
        found.count[several] = count
        found.mean[several] += step
        found.scatter[several] = np.add.reduceat(some.scatter + between, begin)
        return found

    def moved(self, by: Float[Array, "D"]) -> Stacked:
        """Return the moments of the same rows with `by` added to each."""
        return Stacked(self.count, self.mean + by, self.scatter)


def _of_pieces(rows: Float[Array, "N D"], edges: Int[Array, "E"]) -> Stacked:
    counts = np.diff(edges)
    inside = rows[edges[0] : edges[-1]]
    starts = edges[:-1] - edges[0]
    mean = np.add.reduceat(inside, starts, axis=0) / counts[:, None]
    centred = np.repeat(mean, counts, axis=0)
    np.subtract(inside, centred, out=centred)
    # a rounded mean leaves a rest of order eps * |mean|: take it out of the scatter as well
    rest = np.add.reduceat(centred, starts, axis=0) / counts[:, None]
    scatter = np.empty((len(counts), rows.shape[1], rows.shape[1]))
    ends = (starts + counts).tolist()
    for piece, (start, end) in enumerate(zip(starts.tolist(), ends, strict=True)):
        some = centred[start:end]
        np.dot(some.T, some, out=scatter[piece])
    scatter -= counts[:, None, None] * (rest[:, :, None] * rest[:, None, :])
    return Stacked(counts.astype(np.float64), mean + rest, scatter)


def total(parts: Sequence[Moments]) -> Moments:
    """Return the moments of all tables stacked into one: one mean, so one offset for all."""
    if not parts:
        raise ValueError("no moments to add")
    if len(parts) == 1:
        return parts[0]
    return Stacked(
        np.array([part.count for part in parts], dtype=np.float64),
        np.array([part.mean for part in parts]),
        np.array([part.scatter for part in parts]),
    ).total()


def within(parts: Sequence[Moments]) -> Moments:
    """Return the pooled scatter of tables that keep a mean, so an offset, each (P4 to P6).

    The scatter between the means is dropped: this is the paper's centralised offset removal.
    """
    pooled = total(parts)
    return Moments(pooled.count, pooled.mean, np.sum([part.scatter for part in parts], axis=0))
