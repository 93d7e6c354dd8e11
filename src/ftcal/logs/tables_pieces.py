"""A folder of tables, or one, a piece at a time: each file has its own clock, the cuts are common.

Every file is passed through twice (`tables_streamed`). Where one cannot be read so, `tables_pieces`
returns None, and the reader of whole tables has the word.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from ftcal.logs import columns, tables, units
from ftcal.logs.columns import Streams
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
from ftcal.logs.tables_batches import batched
from ftcal.logs.tables_streamed import StreamedTable, each, from_row
from ftcal.recording import NANOSECONDS, Recording

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True)
class TablePieces:
    """A table or a folder of tables, opened."""

    head: Recording
    """The recording with the first sample of each signal."""
    tables: tuple[StreamedTable, ...]
    """Those that have signals."""
    owners: tuple[tuple[Role, str, StreamedTable], ...]
    """Which table has which signal."""
    layout: Layout

    def period(self, role: Role, name: str) -> float:
        """Return `Signal.period` [s] of the whole signal; `DataError` where there is none such."""
        named(self.head, role, name)
        table = next(t for r, n, t in self.owners if (r, n) == (role, name))
        return median_period(table.clock, table.steps, table.longest)

    def pieces(self, *, rows: int | None = None, overlap: float = 0.0) -> Iterator[Piece]:
        """Yield the pieces in order, as `Pieces.pieces` has it."""
        signals = [signal for role in ROLES for signal in getattr(self.head, role)]
        most = rows or max(1, NUMBERS // sum(len(signal.columns) for signal in signals))
        margin = round(overlap * NANOSECONDS)
        readers = [_Reader(table.streams()) for table in self.tables]
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
    """The rows of one table that are in memory."""

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


def tables_pieces(path: Path, layout: Layout, *, name: str | None = None) -> TablePieces | None:
    """Return the table or the folder of tables `path`, opened, or None where it must be read whole.

    Raises `LogError` as `tables.read` does, but for what only the numbers show.
    """
    files = tables.files(path) if path.is_dir() else [path]
    sources = [batched(file, layout) for file in files]
    known = [source for source in sources if source is not None]
    if len(known) < len(files):
        return None
    empty = {s.file: s.schema.empty_table() for s in known}
    plain = [
        tables.Table(s.file, dict(zip(s.schema.names, empty[s.file].columns, strict=True)), 1, b"")
        for s in known
    ]
    claims = tables.claimed(path, plain, layout)
    with ThreadPoolExecutor(1) as beside:
        digests = beside.map(columns.file_sha256, files)
        streamed = []
        for source in known:
            try:
                table = StreamedTable(source, claims[source.file], layout, NUMBERS).looked_through()
            except pa.ArrowException:
                return None
            if table is None:
                return None
            streamed.append(table)
        firsts = [each([next(t.streams())], lambda p: signal_rows(p[0], 0, 1)) for t in streamed]
        noted = [replace(f, notes=t.notes) for f, t in zip(firsts, streamed, strict=True)]
        head = columns.recording(
            columns.merge(noted),
            name=name or (path.resolve().name if path.is_dir() else plain[0].title),
            source=str(path),
            zero=layout.zero,
            sha256=columns.digest(digests),
        )
    return TablePieces(
        units.in_si(head, layout),
        tuple(t for t, first in zip(streamed, firsts, strict=True) if first.signals),
        tuple(
            (role, signal.name, table)
            for table, first in zip(streamed, firsts, strict=True)
            for role in ROLES
            for signal in getattr(first, role)
        ),
        layout,
    )
