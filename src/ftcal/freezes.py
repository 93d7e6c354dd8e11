"""Freezes: all outputs of a sensor repeat exactly, because its firmware or a bus hangs.

A sensor polled faster than it measures repeats honestly: a freeze is five times longer than 95 % of
its holds. A hold is a stretch of equal samples without a hole in time.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.blocks import SPAN, Block
from ftcal.stretches import NONE, Runs, stretches_of

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array

ENOUGH_HOLDS = 20
"""Distinct holds from which a log shows how long its sensor usually holds a value."""

LONGER = 5.0
"""Times by which a freeze is longer than 95 % of the holds."""

ROOM = 8 * SPAN
"""Samples after which holds that are not five times as long as usual so far are forgotten."""


def repetitions(block: Block, opening: Int[Array, "F"]) -> Int[Array, "R"]:
    """Return the places of a block at which all columns repeat the sample before.

    Samples at `opening` places come after a hole and repeat nothing.
    """
    first, *others = block.columns
    places = np.flatnonzero(first[1:] == first[:-1]) + 1
    for column in others:
        if not len(places):  # a single lively column ends it
            break
        places = places[column[places] == column[places - 1]]
    return places[~np.isin(places, opening)] if len(opening) else places


@dataclass(slots=True)
class Freezes:
    """The holds of a signal: how long they usually are, and where the long ones lie."""

    least: int
    """Samples of the shortest freeze."""
    rows: int = 0
    repeated: int = 0
    """Samples that repeat the one before."""
    lengths: Counter[int] = field(default_factory=Counter)
    """Repetitions in a hold that is over → such holds."""
    runs: Runs = field(init=False)
    """Repetitions; the stamp is that of the sample they repeat."""

    def __post_init__(self) -> None:
        self.runs = Runs(self.least - 1)

    def see(self, block: Block, places: Int[Array, "R"]) -> None:
        """Take note of a block, in which samples at `places` repeat the one before."""
        self.rows = block.stop
        self.repeated += len(places)
        found = stretches_of(block, places)
        found[:, 2] = block.stamps[found[:, 0] - block.first - 1]
        over = self.runs.add(found)
        if len(over):
            length, times = np.unique(over[:, 1] - over[:, 0], return_counts=True)
            self.lengths.update(dict(zip(length.tolist(), times.tolist(), strict=True)))
        if self.rows % ROOM == 0:
            self.runs.kept = [self._long(np.concatenate([NONE, *self.runs.kept]))]

    def stretches(self) -> Int[Array, "S 4"]:
        """Return the freezes.

        In more than `ROOM` samples a hold is also judged by what was usual when it was forgotten.
        """
        found = self._long(self.runs.stretches())
        return np.asarray(found - np.array([1, 0, 0, 0]))

    def _long(self, found: Int[Array, "S 4"]) -> Int[Array, "L 4"]:
        """Return those of the repetitions that make a freeze, as far as is known."""
        held = found[:, 1] - found[:, 0] + 1
        return np.asarray(found[held >= max(LONGER * self._usual(), self.least)])

    def _usual(self) -> float:
        """Return the 0.95 quantile of the samples in a hold; 1 where there are too few to tell."""
        holds = self.rows - self.repeated
        if holds < ENOUGH_HOLDS:
            return 1.0
        times = self.lengths.copy()
        times.update((self.runs.latest[:, 1] - self.runs.latest[:, 0]).tolist())
        times[0] = holds - times.total()
        lengths = sorted(times)
        upto = np.cumsum([times[length] for length in lengths])
        # between two neighbours in the order of lengths, as `numpy.quantile` of them all
        place = 0.95 * (holds - 1)
        ranks = np.floor(place) + np.arange(2)
        at = np.searchsorted(upto, np.minimum(ranks, holds - 1), side="right")
        between = np.array(lengths)[at] + 1
        return float(np.quantile(between, place - ranks[0]))
