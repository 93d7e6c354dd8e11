"""One port of a YARP dump in two passes, no more of it in memory than a block of lines.

The first looks at every line, so that what a reader must refuse or tell of a port (order, repeated
stamps, lost packets, numbers that are none) is known before the first number is used; where packets
are lost, one more says when. After that its numbers can be read as often as wanted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import LogError
from ftcal.logs import columns, dump, port
from ftcal.logs.columns import Note, Streams
from ftcal.logs.layout import Layout
from ftcal.logs.packets import Counter, Sessions
from ftcal.logs.port import Port, Reading
from ftcal.logs.streamed import repeated
from ftcal.recording import Signal

if TYPE_CHECKING:
    from jaxtyping import Bool, Int
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True)
class StreamedSession:
    """One folder of a port, passed through; it has samples."""

    reading: Reading
    columns: tuple[str, ...]
    first: int
    """Its first stamp [ns]."""
    last: int
    """Its last stamp [ns]."""
    steps: int
    """Steps between stamps that are not repeated."""
    longest: int
    """Longest of them [ns]."""
    opening: tuple[int, ...]
    """Stamps [ns] that open a new connection."""


@dataclass(frozen=True, slots=True)
class StreamedPort:
    """All sessions of one port that have samples, in the order of time."""

    port: Port
    sessions: tuple[StreamedSession, ...]
    notes: tuple[Note, ...]
    block: int
    """Bytes of text that are read at a time, where all ports are read at once."""

    @property
    def steps(self) -> int:
        """Steps between stamps that are not repeated, those between sessions included."""
        return sum(s.steps for s in self.sessions) + len(self.sessions) - 1

    @property
    def longest(self) -> int:
        """Longest of them [ns]."""
        between = (later.first - earlier.last for earlier, later in pairwise(self.sessions))
        return max(*between, *(s.longest for s in self.sessions), 0)

    def clock(self) -> Iterator[Int[Array, "M"]]:
        """Yield the stamps without repeated ones; each stretch begins with the last one before."""
        before = np.empty(0, dtype=np.int64)
        for session in self.sessions:
            for block in _blocks(session.reading.clock, dump.BLOCK):
                stamps = np.concatenate([before, block.samples.stamps[block.fresh]])
                before = stamps[-1:]
                yield stamps

    def streams(self) -> Iterator[Streams]:
        """Yield the signals of one block of lines after another."""
        for number, session in enumerate(self.sessions):
            opening = (*session.opening, *([session.first] if number else ()))
            for block in _blocks(session.reading, self.block):
                stamps = block.samples.stamps[block.fresh]
                signal = Signal(
                    session.reading.name,
                    self.sessions[0].columns,
                    stamps,
                    session.reading.signal(block.samples).values[block.fresh],
                    tuple(np.flatnonzero(np.isin(stamps, opening)).tolist()),
                )
                yield port.streams(signal, self.port)


def passed_through(
    root: Path, ports: Sequence[Port], layout: Layout, *, block: int
) -> tuple[StreamedPort, list[bytes]]:
    """Return the sessions of one port, and the SHA-256 of each file; raises as `port.read` does.

    `block` bytes of text are read at a time when the port is read beside others.
    """
    port.same(root, ports)
    notes: list[Note] = []
    sums: list[bytes] = []
    sessions: list[StreamedSession] = []
    for one in ports:
        with ThreadPoolExecutor(1) as beside:
            digests = beside.map(columns.file_sha256, one.files)
            session, noticed = _session(Reading.of(one, layout))
        notes += noticed
        sums += digests
        sessions += session
    sessions.sort(key=lambda s: s.first)
    port.apart([(s.first, s.last, len(s.columns)) for s in sessions], ports)
    return StreamedPort(ports[0], tuple(sessions), tuple(notes), block), sums


def _session(reading: Reading) -> tuple[list[StreamedSession], list[Note]]:
    """Return one folder of a port, nothing where it has no samples, and what was noticed."""
    where = str(reading.port.samples)
    sessions, counter = Sessions(reading.port.link), Counter()
    rows, steps, longest = 0, -1, 0
    ends: tuple[int, int] | None = None
    found: list[Note] = []
    titles: tuple[str, ...] = ()
    strange: list[tuple[int, str, float]] = []
    strangers = 0
    disorder: LogError | None = None
    for block in _blocks(reading, dump.BLOCK):
        signal = reading.signal(block.samples)
        titles = signal.columns
        bad = np.argwhere(~np.isfinite(signal.values))
        strange += [(rows + 1 + int(r), titles[c], signal.values[r, c]) for r, c in bad[:1]]
        strangers += len(bad)
        rows += len(signal)
        try:
            clock = Signal(reading.name, (), block.stamps, np.empty((len(block.stamps), 0)))
            clock, _, noticed = columns.in_order(clock, where, first_row=block.first_row)
        except LogError as error:
            disorder = disorder or error
            continue
        found += noticed
        sessions.see(clock.stamps)
        counter.see(block.sequence)
        steps += int(block.fresh.sum())
        longest = max(longest, int(np.diff(clock.stamps).max(initial=0)))
        ends = (ends or (int(clock.stamps[0]), 0))[0], int(clock.stamps[-1])
    if strange:
        raise columns.not_finite(where, *strange[0], strangers)
    if disorder:
        raise disorder
    again = _blocks(reading.clock, dump.BLOCK) if counter.skips else ()
    lost = counter.lost(((block.sequence, block.stamps) for block in again), sessions.opening)
    notes = [*repeated(found, rows - steps - 1, rows), *reading.notes(ends, rows, lost)]
    if ends is None:
        return [], notes
    return [StreamedSession(reading, titles, *ends, steps, longest, sessions.opening)], notes


@dataclass(frozen=True, slots=True)
class _Block:
    """Some lines of a `data.log`."""

    samples: dump.Samples
    sequence: Int[Array, "M"]
    """Their counters, after that of the last line before."""
    stamps: Int[Array, "M"]
    """Their stamps [ns], after that of the last line before."""
    first_row: int
    """Number of the first of `stamps` as a person counts lines."""

    @property
    def fresh(self) -> Bool[Array, "N"]:
        """Which samples do not repeat the stamp before them."""
        first = np.ones(len(self.samples.stamps) + 1 - len(self.stamps), dtype=bool)
        return np.concatenate([first, np.diff(self.stamps) > 0])


def _blocks(reading: Reading, size: int) -> Iterator[_Block]:
    """Yield the lines of a folder, about `size` bytes of them at a time."""
    sequence = stamps = np.empty(0, dtype=np.int64)
    row = 1
    for samples in dump.blocks(reading.port.samples, reading.lines, size=size, scale=reading.scale):
        again = len(stamps[-1:])
        sequence = np.concatenate([sequence[-1:], samples.sequence])
        stamps = np.concatenate([stamps[-1:], samples.stamps])
        yield _Block(samples, sequence, stamps, row - again)
        row += len(samples.stamps)
