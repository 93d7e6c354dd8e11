"""When the signals of a recording were logged: their runs, whatever they said.

A filter must know how long a run is before it meets its first sample, for its grid has the mean
period of the run. Runs are found while a recording passes by piece by piece, and are few.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.logs.pieces import ROLES, Pieces, Role
from ftcal.recording import NANOSECONDS, Finding, Recording, Signal
from ftcal.run_filter import RunFilter, too_short
from ftcal.signals import longest_pause, runs, usable

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True)
class Clock:
    """The runs of one signal, in order."""

    name: str
    """Of the signal."""
    period: float
    """Median time between two samples [s]; NaN with fewer than two."""
    gap: float
    """Longest time between two samples of a run [s]."""
    runs: Int[Array, "R 3"]
    """Stamp of the first sample and of the last [ns], and how many they are."""

    @property
    def count(self) -> int:
        """Samples of the signal that are in any run."""
        return int(self.runs[:, 2].sum())

    def filters(self, window: float, order: int) -> tuple[list[RunFilter], str]:
        """Return the filters of the runs that are long enough, or what is wrong if none is."""
        made = [RunFilter.of(a, b, n, window, order) for a, b, n in self.runs.tolist()]
        found = [one for one in made if one is not None]
        longest = max(((b - a) / NANOSECONDS for a, b, _ in self.runs.tolist()), default=0.0)
        return found, "" if found else too_short(self.name, longest, window)


@dataclass(slots=True)
class GrowingClock:
    """The runs of one signal while its samples pass by, in order."""

    name: str
    period: float
    """Median time between two samples of the whole signal [s]."""
    gap: float
    """Longest time between two samples of a run [s]."""
    closed: list[tuple[int, int, int]] = field(default_factory=list)
    """Runs that have ended."""
    latest: tuple[int, int, int] | None = None
    """The run that may go on."""

    @staticmethod
    def of(signal: Signal, period: float, max_gap: float | None) -> GrowingClock:
        """Return that of a signal with this median period [s]; `max_gap` None is the default."""
        return GrowingClock(
            signal.name, period, longest_pause(period) if max_gap is None else max_gap
        )

    def see(self, signal: Signal, findings: Iterable[Finding], recording: Recording) -> None:
        """Take in the next samples; those that `findings` cut are in no run."""
        if not len(signal):
            return
        keep = usable(recording, signal, findings)
        for run in runs(signal, max_gap=self.gap, usable=keep):
            first, last = int(signal.stamps[run.start]), int(signal.stamps[run.stop - 1])
            before = self.latest if run.start == 0 and 0 not in signal.breaks else None
            if before is not None and first - before[1] <= round(self.gap * NANOSECONDS):
                self.latest = (before[0], last, before[2] + run.stop - run.start)
            else:
                self._close()
                self.latest = (first, last, run.stop - run.start)
        if not keep[-1]:
            self._close()

    def _close(self) -> None:
        if self.latest is not None:
            self.closed.append(self.latest)
            self.latest = None

    def clock(self) -> Clock:
        """Return the clock that has been seen."""
        found = [*self.closed, *([] if self.latest is None else [self.latest])]
        return Clock(
            self.name, self.period, self.gap, np.array(found, dtype=np.int64).reshape(-1, 3)
        )


Clocks = Mapping[tuple[Role, str], Clock]
"""By what a signal is and its name."""


@dataclass(slots=True)
class GrowingClocks:
    """The runs of all signals of a recording while it passes by."""

    findings: tuple[Finding, ...]
    """What they cut is in no run."""
    growing: dict[tuple[Role, str], GrowingClock]

    @staticmethod
    def of(log: Pieces, findings: Iterable[Finding], max_gap: float | None = None) -> GrowingClocks:
        """Return those of a log that was opened; `max_gap` [s], None: that of each signal."""
        return GrowingClocks(
            tuple(findings),
            {
                (role, signal.name): GrowingClock.of(signal, log.period(role, signal.name), max_gap)
                for role in ROLES
                for signal in getattr(log.head, role)
            },
        )

    @property
    def periods(self) -> dict[str, float]:
        """Median time between two samples [s] of every signal, by its name."""
        return {name: one.period for (_, name), one in self.growing.items()}

    def see(self, own: Recording) -> None:
        """Take in the next samples of every signal."""
        for role in ROLES:
            for signal in getattr(own, role):
                self.growing[role, signal.name].see(signal, self.findings, own)

    def clocks(self) -> Clocks:
        """Return the clocks that have been seen."""
        return {key: one.clock() for key, one in self.growing.items()}


def clocks_of(log: Pieces, findings: Iterable[Finding], max_gap: float | None = None) -> Clocks:
    """Return the clocks of a log, which passes by once for it; what `findings` cut is left out."""
    growing = GrowingClocks.of(log, findings, max_gap)
    for piece in log.pieces():
        growing.see(piece.own)
    return growing.clocks()
