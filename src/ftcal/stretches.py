"""Stretches of samples in which a signal cannot be believed, put together across blocks.

A stretch is a row of four numbers: its first row, the row after its last, both counted from the
beginning of the signal, and the stamps [ns] of its first and its last sample.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.blocks import Block
from ftcal.recording import NANOSECONDS, Finding, FindingKind

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array

NEAR = 0.1
"""Spans closer than this [s] are one: a sensor at the end of its range comes and goes."""

FREEZE = 0.05
"""Shortest freeze, or rest at the end of a range, worth a finding [s]."""

REPEATS = 3
"""Least number of repetitions in one."""

NONE = np.empty((0, 4), dtype=np.int64)
"""No stretch."""


def shortest(period: float) -> int:
    """Return the samples of the shortest stretch worth a finding, from the median period [s]."""
    return max(round(FREEZE / period), REPEATS + 1)


def stretches_of(block: Block, places: Int[Array, "F"]) -> Int[Array, "S 4"]:
    """Return the stretches that the samples at `places` of a block make, in order."""
    if not len(places):
        return NONE
    ends = np.flatnonzero(places[1:] - places[:-1] > 1)
    opening = places[np.concatenate([[0], ends + 1])]
    closing = places[np.concatenate([ends, [len(places) - 1]])]
    found = np.empty((len(opening), 4), dtype=np.int64)
    found[:, 0], found[:, 1] = block.first + opening, block.first + closing + 1
    found[:, 2], found[:, 3] = block.stamps[opening], block.stamps[closing]
    return found


@dataclass(slots=True)
class Runs:
    """Stretches that come block by block; those that touch are one."""

    least: int
    """Samples of the shortest that is kept."""
    latest: Int[Array, "L 4"] = field(default_factory=NONE.copy)
    """The last one, which may yet grow."""
    kept: list[Int[Array, "S 4"]] = field(default_factory=list)

    def add(self, found: Int[Array, "S 4"]) -> Int[Array, "C 4"]:
        """Take note of stretches after those before; return the ones that can grow no more."""
        if not len(found):
            return NONE
        if len(self.latest) and found[0, 0] <= self.latest[0, 1]:
            found = found.copy()
            found[0, [0, 2]] = self.latest[0, [0, 2]]
            found[0, [1, 3]] = np.maximum(found[0, [1, 3]], self.latest[0, [1, 3]])
        elif len(self.latest):
            found = np.concatenate([self.latest, found])
        closed, self.latest = found[:-1], found[-1:]
        if len(long := self._long(closed)):
            self.kept.append(long)
        return closed

    def stretches(self) -> Int[Array, "S 4"]:
        """Return all that are long enough, in order."""
        return np.concatenate([NONE, *self.kept, self._long(self.latest)])

    def _long(self, found: Int[Array, "S 4"]) -> Int[Array, "L 4"]:
        return np.asarray(found[found[:, 1] - found[:, 0] >= self.least])


def united(found: Int[Array, "S 4"]) -> Int[Array, "U 4"]:
    """Return stretches that lie apart, made of those that touch or overlap."""
    found = found[np.argsort(found[:, 0], kind="stable")]
    stop, last = np.maximum.accumulate(found[:, [1, 3]], axis=0).T
    apart = np.flatnonzero(found[1:, 0] > stop[:-1])
    opening, closing = np.append(0, apart + 1), np.append(apart, len(found) - 1)
    return np.column_stack([found[opening, 0], stop[closing], found[opening, 2], last[closing]])


def reported(
    found: Int[Array, "S 4"],
    name: str,
    kind: FindingKind,
    why: str,
    *,
    start: int,
    period: float,
    total: int,
) -> tuple[Finding, ...]:
    """Return a summary that cuts nothing, then one finding a span that cuts it.

    `start` is second zero of the recording [ns], `period` [s] the median one of the signal `name`,
    `total` the count of its samples.
    """
    if not len(found):
        return ()
    found = united(found)
    # half a period: the last bad sample is within the span, the next one is not
    begin = (found[:, 2] - start) / NANOSECONDS
    end = (found[:, 3] - start) / NANOSECONDS + 0.5 * period
    apart = np.flatnonzero(begin[1:] - end[:-1] >= NEAR)
    begin, end = begin[np.append(0, apart + 1)], end[np.append(apart, len(end) - 1)]
    count, longest = int((found[:, 1] - found[:, 0]).sum()), float((end - begin).max())
    summary = (
        f"{name}: {count} of {total} samples {kind} ({100 * count / total:.1f} %) in"
        f" {len(begin)} stretch{'es' if len(begin) > 1 else ''}, longest {longest:.2g} s: {why}"
    )
    return (
        Finding(kind, name, float(begin[0]), float(end[-1]), False, summary),
        *(
            Finding(kind, name, a, b, True, f"{name}: {kind} from {a:.2f} to {b:.2f} s")
            for a, b in zip(begin.tolist(), end.tolist(), strict=True)
        ),
    )
