"""Rows of a table, smoothed while they pass by: channels beside the model wrench, alike.

A stretch is rows without a hole between them. What of a stretch the filter still needs is carried
over from one portion of rows to the next, so that it makes no difference how they come.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.filters import smooth
from ftcal.recording import NANOSECONDS

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True)
class Rows:
    """Some rows on one clock."""

    stamps: Int[Array, "N"]
    """Nanoseconds since the Unix epoch, increasing."""
    values: Float[Array, "N D"]
    """What is smoothed."""
    beside: Float[Array, "N E"]
    """What is not, but goes with them."""

    def __len__(self) -> int:
        return len(self.stamps)

    def __getitem__(self, which: slice) -> Rows:
        return Rows(self.stamps[which], self.values[which], self.beside[which])


@dataclass(slots=True, eq=False)
class Smoother:
    """The filter of one sensor, with what it still needs of the rows before."""

    window: int
    """Samples, odd."""
    order: int
    """Of its polynomial."""
    gap: float
    """Longest time between two rows of a stretch [s]."""
    carried: Rows | None = None
    """The last rows of the stretch that may go on."""
    began: int = 0
    """Stamp of its first row [ns]."""
    longest: int = 0
    """Length of the longest stretch so far [ns]."""

    def feed(self, rows: Rows, keep: Bool[Array, "N"], opens: Bool[Array, "N"]) -> Iterator[Rows]:
        """Yield the rows that can be smoothed now, a portion for every stretch.

        `keep`: which of the rows belong to a stretch; `opens`: which do not continue the row
        before, whether kept or not.
        """
        pauses = np.diff(rows.stamps) > round(self.gap * NANOSECONDS)
        fresh = opens.copy()
        fresh[1:] |= pauses | ~keep[:-1]
        if self.carried is not None and len(rows):
            pause = int(rows.stamps[0] - self.carried.stamps[-1])
            fresh[0] |= pause > round(self.gap * NANOSECONDS)
        elif len(rows):
            fresh[0] = True
        starts = np.flatnonzero(fresh & keep)
        if len(rows) and keep[0] and not fresh[0]:
            starts = np.concatenate([[0], starts])
        ends = np.flatnonzero(np.append(fresh[1:] | ~keep[1:], True) & keep) + 1
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
            goes_on = start == 0 and not fresh[0]
            yield from self._smoothed(rows[start:end], goes_on=goes_on)
        if len(rows) and not keep[-1]:
            self.carried = None

    def _smoothed(self, rows: Rows, *, goes_on: bool) -> Iterator[Rows]:
        before = self.carried if goes_on else None
        if before is None:
            self.began = int(rows.stamps[0])
            whole = rows
        else:
            whole = Rows(
                np.concatenate([before.stamps, rows.stamps]),
                np.concatenate([before.values, rows.values]),
                np.concatenate([before.beside, rows.beside]),
            )
        self.longest = max(self.longest, int(rows.stamps[-1]) - self.began)
        half = self.window // 2
        count = len(whole) - 2 * half
        if count > 0:
            middle = slice(half, half + count)
            smoothed = smooth(whole.values, self.window, self.order)
            yield Rows(whole.stamps[middle], smoothed, whole.beside[middle])
        self.carried = whole[max(count, 0) :]
