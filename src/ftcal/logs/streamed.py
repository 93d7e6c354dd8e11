"""A log of several clocks, a piece at a time: each file has its own clock, the cuts are common.

What is read is a source: a part of a log with one clock that can be passed through more than once,
no more of it in memory than a stretch of rows. Of every format that comes so, pieces are made here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ftcal.logs import columns, units
from ftcal.logs.columns import Note, Streams
from ftcal.logs.layout import Layout
from ftcal.logs.pieces import (
    NUMBERS,
    ROLES,
    Piece,
    Role,
    joined,
    median_period,
    named,
    signal_between,
    signal_rows,
)
from ftcal.recording import NANOSECONDS, Recording, Signal

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array


class Source(Protocol):
    """A part of a log, passed through once: its times are known, its numbers are not in memory."""

    @property
    def steps(self) -> int:
        """Steps between stamps that are not repeated."""

    @property
    def longest(self) -> int:
        """Longest of them [ns]."""

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was noticed."""

    def clock(self) -> Iterator[Int[Array, "M"]]:
        """Yield the stamps without repeated ones; each stretch begins with the last one before."""

    def streams(self) -> Iterator[Streams]:
        """Yield the signals, all on the one clock, a stretch of rows after another; or nothing."""


@dataclass(frozen=True, slots=True)
class StreamedPieces:
    """A log of some sources, opened."""

    head: Recording
    """The recording with the first sample of each signal."""
    sources: tuple[Source, ...]
    """Those that have signals."""
    owners: tuple[tuple[Role, str, Source], ...]
    """Which source has which signal."""
    layout: Layout
    periods: dict[int, float] = field(default_factory=dict, repr=False)
    """Median periods [s] that were asked for, by number of the source."""

    @classmethod
    def of(
        cls, sources: Sequence[Source], layout: Layout, *, name: str, source: str, sha256: str
    ) -> StreamedPieces:
        """Return the log that `sources` are, in their order; raises as `columns.recording`."""
        firsts = [
            each([next(s.streams(), Streams())], lambda p: signal_rows(p[0], 0, 1)) for s in sources
        ]
        noted = [replace(f, notes=s.notes) for f, s in zip(firsts, sources, strict=True)]
        head = columns.recording(
            columns.merge(noted), name=name, source=source, zero=layout.zero, sha256=sha256
        )
        owned = [(f, s) for f, s in zip(firsts, sources, strict=True) if f.signals]
        return cls(
            units.in_si(head, layout),
            tuple(s for _, s in owned),
            tuple(
                (role, signal.name, s) for f, s in owned for role in ROLES
                for signal in getattr(f, role)
            ),
            layout,
        )  # fmt: skip

    def period(self, role: Role, name: str) -> float:
        """Return `Signal.period` [s] of the whole signal; `DataError` where there is none such."""
        named(self.head, role, name)
        source = next(s for r, n, s in self.owners if (r, n) == (role, name))
        at = next(i for i, one in enumerate(self.sources) if one is source)
        if at not in self.periods:  # a few passes over the stamps, which its signals share
            self.periods[at] = median_period(source.clock, source.steps, source.longest)
        return self.periods[at]

    def pieces(self, *, rows: int | None = None, overlap: float = 0.0) -> Iterator[Piece]:
        """Yield the pieces in order, as `Pieces.pieces` has it."""
        signals = [signal for role in ROLES for signal in getattr(self.head, role)]
        most = rows or max(1, NUMBERS // sum(len(signal.columns) for signal in signals))
        margin = round(overlap * NANOSECONDS)
        readers = [_Reader(source.streams()) for source in self.sources]
        start = min(int(signal.stamps[0]) for signal in signals)
        while True:
            for reader in readers:
                reader.fill(rows=reader.row(start) + most)
            own = [reader.clock[reader.row(start) :] for reader in readers]
            if not any(len(clock) for clock in own):
                return
            full = [int(clock[most - 1]) + 1 for clock in own if len(clock) >= most]
            stop = min(full, default=max(int(clock[-1]) + 1 for clock in own if len(clock)))
            for reader in readers:
                reader.fill(beyond=stop + margin)
            shown = columns.merge(r.between(start - margin, stop + margin) for r in readers)
            logged = replace(self.head, **{role: getattr(shown, role) for role in ROLES})
            yield Piece(units.in_si(logged, self.layout), start, stop)
            for reader in readers:
                reader.drop(stop - margin)
            start = stop


@dataclass(slots=True)
class _Reader:
    """The rows of one source that are in memory."""

    parts: Iterator[Streams]
    held: Streams = field(default_factory=Streams)

    @property
    def clock(self) -> Int[Array, "N"]:
        """Stamps of the rows in memory."""
        signals = self.held.signals
        return signals[0].stamps if signals else np.empty(0, dtype=np.int64)

    def row(self, start: int) -> int:
        """Return the first row in memory that is not before `start`."""
        return int(np.searchsorted(self.clock, start))

    def fill(self, *, rows: int = 0, beyond: int = -(2**63)) -> None:
        """Read on until `rows` rows are in memory and one at `beyond` or later, or to the end."""
        parts = [self.held] if len(self.clock) else []
        clocks = [self.clock] if parts else []
        while sum(map(len, clocks)) < rows or not clocks or clocks[-1][-1] < beyond:
            part = next(self.parts, None)
            if part is None:
                break
            if len(part.signals[0]):  # of repeated stamps alone, nothing is left
                parts.append(part)
                clocks.append(part.signals[0].stamps)
        if parts:
            self.held = each(parts, joined) if len(parts) > 1 else parts[0]

    def between(self, start: int, stop: int) -> Streams:
        """Return what is in memory of [start, stop) [ns]."""
        return each([self.held], lambda parts: signal_between(parts[0], start, stop))

    def drop(self, start: int) -> None:
        """Forget what lies before `start` [ns]."""
        self.held = from_row(self.held, self.row(start))


def repeated(found: Sequence[Note], again: int, rows: int) -> tuple[Note, ...]:
    """Return one note of what each stretch of `rows` samples was found to repeat, `again` in all.

    As `columns.in_order` says it of all of them.
    """
    if not found:
        return ()
    message = f"{again} of {rows} samples repeat the stamp before them; left out"
    return (replace(found[0], stop=found[-1].stop, message=message),)


def each(parts: Sequence[Streams], change: Callable[[list[Signal]], Signal]) -> Streams:
    """Return the streams in which each signal is made of those in its place in `parts`."""

    def signals(role: Role) -> tuple[Signal, ...]:
        places = zip(*(getattr(part, role) for part in parts), strict=True)
        return tuple(change(list(same)) for same in places)

    return Streams(signals("joints"), signals("channels"), signals("temperatures"), signals("imus"))


def from_row(streams: Streams, row: int) -> Streams:
    """Return the streams without the rows before `row`."""
    return each([streams], lambda parts: signal_rows(parts[0], row, None))
