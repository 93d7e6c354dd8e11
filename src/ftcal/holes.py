"""When a signal was logged: its holes, and those that all signals share.

A hole is a pause longer than five median periods. The beginning of a session is a finding of the
reader, not a hole.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.blocks import Block
from ftcal.recording import NANOSECONDS, Finding
from ftcal.signals import longest_pause

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array

ROUNDING = 5_000
"""Nanoseconds by which a pause in float64 seconds may miss the one in stamps, at any epoch."""


@dataclass(slots=True)
class Pauses:
    """The clock of one signal."""

    name: str
    start: int
    """Nanoseconds since the Unix epoch of second zero."""
    period: float
    """Median time between two samples [s]; NaN with fewer than two."""
    count: int = 0
    """Samples seen."""
    first: int = 0
    """Stamp of the first sample [ns]."""
    last: int = 0
    """Stamp of the latest [ns]."""
    holes: list[tuple[float, float]] = field(default_factory=list)
    """Seconds since second zero of the samples on both sides."""

    def see(self, block: Block) -> Int[Array, "F"]:
        """Take note of a block; return its places that do not continue the sample before."""
        if not self.count:
            self.first = int(block.stamps[0])
        self.count, self.last = block.stop, int(block.stamps[-1])
        pause = np.diff(block.stamps)
        gap = longest_pause(self.period)
        if pause.max(initial=0) <= gap * NANOSECONDS - ROUNDING:
            return block.breaks
        places = np.flatnonzero(pause > gap * NANOSECONDS - ROUNDING) + 1
        after = (block.stamps[places] - self.start) / NANOSECONDS
        before = (block.stamps[places - 1] - self.start) / NANOSECONDS
        holed = (after - before > gap) & ~np.isin(places, block.breaks)
        self.holes += zip(before[holed].tolist(), after[holed].tolist(), strict=True)
        opening = places[pause[places - 1] > gap * NANOSECONDS]
        return np.union1d(opening, block.breaks)

    @property
    def span(self) -> tuple[float, float]:
        """Seconds since second zero of the first sample and of the last."""
        first, last = (np.array([self.first, self.last]) - self.start) / NANOSECONDS
        return float(first), float(last)

    def gaps(self) -> tuple[Finding, ...]:
        """Return the holes between samples; they hold nothing to cut."""
        return tuple(
            Finding(
                "gap",
                self.name,
                before,
                after,
                False,
                f"{self.name}: no samples for {after - before:.3g} s from {before:.2f} s"
                f" (period {self.period * 1e3:.3g} ms)",
            )
            for before, after in self.holes
        )


def clock_jumps(clocks: Sequence[Pauses]) -> tuple[Finding, ...]:
    """Return the holes that all signals share: the clock was set, or the logger paused.

    Sensors on different buses do not fall silent together for the same time.
    """
    clocks = [clock for clock in clocks if clock.count > 1]
    if len(clocks) < 2:
        return ()
    slack = 3.0 * max(clock.period for clock in clocks)
    first, *others = clocks
    return tuple(
        Finding(
            "clock jump",
            first.name,
            start,
            stop,
            False,
            f"all {len(clocks)} signals pause for {stop - start:.3g} s at"
            f" {start:.2f} s: the clock was set or the logger stopped; nothing is"
            " interpolated across",
        )
        for start, stop in first.holes
        if all(_has(other.holes, start, stop, slack) for other in others)
    )


def _has(holes: Sequence[tuple[float, float]], start: float, stop: float, slack: float) -> bool:
    """Return whether one of the holes, which are in order, begins and ends within the slack."""
    # twice: a hole at the very end of the slack may round to either side
    for i in range(bisect_left(holes, (start - 2.0 * slack,)), len(holes)):
        if holes[i][0] > start + 2.0 * slack:
            break
        if abs(holes[i][0] - start) < slack and abs(holes[i][1] - stop) < slack:
            return True
    return False
