"""A signal that passes by: block after block of its samples, each with the one before it.

What is noted in a block must not depend on where a reader cut the log into pieces; the sample
before joins them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.recording import Signal

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

BLOCK = 1 << 14
"""Most samples of a block: six channels of them stay in cache."""

SPAN = 1 << 17
"""At each multiple of so many samples a block ends, wherever the pieces do."""


@dataclass(frozen=True, slots=True)
class Block:
    """Some samples of a signal, after the one before them where there is one."""

    first: int
    """Row of the first sample shown, counted from the beginning of the signal."""
    before: int
    """How many of the samples shown were in the block before: 1, or 0 in the first."""
    stamps: Int[Array, "B"]
    """Nanoseconds since the Unix epoch."""
    columns: Float[Array, "K B"]
    """Values of each column, contiguous."""
    breaks: Int[Array, "S"]
    """Places among the samples shown at which a session opens."""

    @property
    def own(self) -> Float[Array, "K M"]:
        """The values without the sample before."""
        return self.columns[:, self.before :]

    @property
    def stop(self) -> int:
        """Row after the last sample."""
        return self.first + len(self.stamps)


@dataclass(slots=True)
class Passage:
    """How far a signal has passed."""

    rows: int = 0
    """Samples seen."""
    last: tuple[Int[Array, "1"], Float[Array, "K 1"]] | None = None
    """Stamp and values of the latest."""

    def blocks(self, signal: Signal) -> Iterator[Block]:
        """Yield the next samples of the signal, which are all those of `signal`."""
        start, breaks = 0, np.asarray(signal.breaks, dtype=np.int64)
        while start < len(signal):
            stop = min(start + BLOCK, start + SPAN - self.rows % SPAN, len(signal))
            before = int(self.last is not None)
            begin = start - before if start else 0
            stamps, columns = signal.stamps[begin:stop], signal.values[begin:stop].T
            if self.last is not None and not start:
                stamps = np.concatenate([self.last[0], stamps])
                columns = np.concatenate([self.last[1], columns], axis=1)
            opening = breaks[(breaks >= start) & (breaks < stop)] - start + before
            if columns.strides[1] != columns.itemsize:
                columns = np.ascontiguousarray(columns)
            yield Block(self.rows - before, before, stamps, columns, opening)
            self.rows += stop - start
            # copies: a view would keep the whole piece in memory
            self.last = stamps[-1:].copy(), columns[:, -1:].copy()
            start = stop


@dataclass(slots=True)
class Selection:
    """Samples at regular steps: all while they fit, else every second, every fourth, and so on.

    Which are kept depends on how many there were, not on the pieces they came in.
    """

    room: int
    """Most samples kept."""
    seen: int = 0
    step: int = 1
    """Rows from one sample kept to the next."""
    kept: list[Float[Array, "K M"]] = field(default_factory=list)

    def see(self, columns: Float[Array, "K B"]) -> None:
        """Take note of the next samples."""
        self.kept.append(columns[:, -self.seen % self.step :: self.step].copy())
        self.seen += columns.shape[1]
        while self.seen > self.room * self.step:
            self.step *= 2
            self.kept = [self.columns[:, ::2].copy()]

    @property
    def columns(self) -> Float[Array, "K M"]:
        """The samples kept, in order; one block at least must have been seen."""
        return np.concatenate(self.kept, axis=1)
