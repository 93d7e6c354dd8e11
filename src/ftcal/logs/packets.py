"""What the packets of a YARP port tell as they pass by: lost ones, and where a session began.

Nothing here needs more of a log in memory than a stretch of it. Each stretch shows the last packet
of the one before, as steps from packet to packet are what is looked at.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.logs.dump import SEQUENCE_SIZE, Connection
from ftcal.recording import NANOSECONDS

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array

_SLACK = NANOSECONDS // 10  # the sender's clock and the dumper's are not the same


@dataclass(slots=True)
class _Hole:
    """The time between a disconnection and the connection after it."""

    left: int
    """Nanoseconds since the Unix epoch, less the slack."""
    right: int
    """Nanoseconds since the Unix epoch, plus the slack."""
    covered: int = -1
    """Nanoseconds of it that the longest step across it covers."""
    after: int = 0
    """Stamp of the packet after that step."""


class Sessions:
    """Where a port was connected again.

    Packets are stamped by the sender before the dumper notes the connection, so the packet is the
    one after the step that covers most of the hole between disconnection and connection.
    """

    def __init__(self, link: Connection) -> None:
        self._holes = [
            _Hole(max((t for t in link.closed if t <= again), default=again) - _SLACK,
                  again + _SLACK)
            for again in link.opened[1:]
        ]  # fmt: skip

    def see(self, stamps: Int[Array, "M"]) -> None:
        """Look at a stretch of strictly increasing stamps [ns]."""
        for hole in self._holes:
            first = max(int(np.searchsorted(stamps, hole.left)), 1)
            last = min(int(np.searchsorted(stamps, hole.right)) + 1, len(stamps))
            if first < last:
                before, after = stamps[first - 1 : last - 1], stamps[first:last]
                covered = np.minimum(after, hole.right) - np.maximum(before, hole.left)
                best = int(np.argmax(covered))
                if covered[best] > hole.covered:
                    hole.covered, hole.after = int(covered[best]), int(after[best])

    @property
    def opening(self) -> tuple[int, ...]:
        """Stamps [ns] of the packets that open a new connection, in order."""
        return tuple(sorted({hole.after for hole in self._holes if hole.covered >= 0}))


@dataclass(slots=True)
class Counter:
    """Steps of the packet counter, which starts again after 32767.

    A dump that keeps each n-th packet steps by n; a step of half its range or more is a sender that
    started again; and the counter says nothing across the hole before a session.
    """

    counts: Int[Array, "32768"] = field(
        default_factory=lambda: np.zeros(SEQUENCE_SIZE, dtype=np.int64)
    )
    """How often each step was seen."""

    def see(self, sequence: Int[Array, "M"]) -> None:
        """Look at the counters of a stretch of packets."""
        self.counts += np.bincount(_steps(sequence), minlength=SEQUENCE_SIZE)

    @property
    def usual(self) -> int:
        """The median step, at least 1."""
        below = np.cumsum(self.counts)
        steps = int(below[-1])
        middle = np.searchsorted(below, [(steps - 1) // 2, steps // 2], side="right")
        return max(int(middle.sum()) // 2, 1) if steps else 1

    @property
    def skips(self) -> bool:
        """Whether any step is that of a loss, holes between sessions included."""
        return bool(self.counts[self.usual + 1 : SEQUENCE_SIZE // 2].any())

    def lost(
        self,
        stretches: Iterable[tuple[Int[Array, "M"], Int[Array, "M"]]],
        opening: tuple[int, ...],
    ) -> tuple[int, int, int] | None:
        """Return how many packets are lost, the stamp before the first and after the last loss.

        `stretches` are counters and stamps [ns] of all that `see` saw, to be looked at once more;
        `opening` are the stamps that open sessions. None where nothing is lost.
        """
        lost, start, stop = 0, 0, 0
        for sequence, stamps in stretches if self.skips else ():
            step = _steps(sequence)
            skips = (step > self.usual) & (step < SEQUENCE_SIZE // 2)
            # of a repeated stamp the first packet is the one that opens
            skips &= ~(np.isin(stamps[1:], opening) & (np.diff(stamps) > 0))
            rows = np.flatnonzero(skips)
            if len(rows):
                start = start if lost else int(stamps[rows[0]])
                stop = int(stamps[rows[-1] + 1])
                lost += int((step[rows] // self.usual - 1).sum())
        return (lost, start, stop) if lost else None


def _steps(sequence: Int[Array, "M"]) -> Int[Array, "M-1"]:
    return np.diff(sequence) % SEQUENCE_SIZE
