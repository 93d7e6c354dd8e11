"""Who touches the world, and when.

The paper's data sets have one contact each (section IV-B: "there is only one contact point where
external force is applied and its location is known"); a schedule is a row of such intervals.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

from ftcal.errors import JobError, raise_all


@dataclass(frozen=True, slots=True)
class Interval:
    """Half-open span [start, stop) during which only `link` and `others` touch the world."""

    start: float
    """Seconds since the start of the recording."""
    stop: float
    """Seconds since the start of the recording, exclusive."""
    link: str
    """Link or frame that touches the world and stands still, or whose motion is known."""
    others: tuple[str, ...] = ()
    """Links that touch too. A sensor between them and `link` says nothing on its own."""

    @property
    def touching(self) -> tuple[str, ...]:
        """All links that touch."""
        return (self.link, *self.others)


@dataclass(frozen=True, slots=True)
class ContactSchedule:
    """Ordered intervals that do not overlap; what lies between them is unknown and never used."""

    intervals: tuple[Interval, ...]

    def __post_init__(self) -> None:
        faults = [
            f"interval [{i.start:g}, {i.stop:g}) s on {i.link!r} ends before it starts"
            for i in self.intervals
            if not i.stop > i.start
        ]
        faults += [
            f"intervals [{a.start:g}, {a.stop:g}) and [{b.start:g}, {b.stop:g}) s overlap or are"
            " out of order"
            for a, b in itertools.pairwise(self.intervals)
            if b.start < a.stop
        ]
        raise_all(JobError, "contact schedule", faults)
