"""One table in two passes, no more of it in memory than a stretch of rows.

The first looks at the times, so that what a reader must refuse or tell of them (order, repeated
stamps, how many) is known before the first number is used; of a CSV file it also proves that every
row has the types of the head. The second reads the numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from ftcal.errors import LogError
from ftcal.logs import columns, tables
from ftcal.logs.columns import SECONDS, Note, Streams
from ftcal.logs.layout import Layout
from ftcal.logs.streamed import from_row, repeated
from ftcal.logs.tables_batches import Batched
from ftcal.logs.tables_time import nanoseconds
from ftcal.recording import Signal

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array

_EXACT = 2**53  # nanoseconds; `tables_time` rounds fractions of seconds beyond to microseconds


@dataclass(frozen=True, slots=True)
class _Stretch:
    """Some rows of a table, after the last row of the stretch before."""

    columns: Mapping[str, Any]
    first_row: int
    """Number of its first row as a person counts rows in the file."""
    again: int
    """Rows that the stretch before ended with: 1, or 0 in the first."""


@dataclass(frozen=True, slots=True)
class StreamedTable:
    """One file, its columns claimed and its times looked through."""

    source: Batched
    claims: tables.Claims
    layout: Layout
    numbers: int
    """Numbers of a batch."""
    steps: int = 0
    """Steps between stamps that are not repeated."""
    longest: int = 0
    """Longest of them [ns]."""
    notes: tuple[Note, ...] = ()

    @property
    def used(self) -> list[str]:
        """The columns that make signals, and time."""
        claims = self.claims
        said = (claims.channels, claims.temperatures, claims.imus)
        signals = [column for role in said for names in role.values() for column in names]
        return list(dict.fromkeys([self.layout.time, *claims.joints, *signals]))

    def stretches(self, names: Sequence[str]) -> Iterator[_Stretch]:
        """Yield the table from its beginning; each stretch shows the last row of the one before."""
        before, row = None, self.source.first_row
        for batch in self.source.batches(names, max(1, self.numbers // len(names))):
            if batch.num_rows:
                again = int(before is not None)
                table = pa.concat_tables([before, batch]) if before is not None else batch
                by_name = dict(zip(table.column_names, table.columns, strict=True))
                yield _Stretch(by_name, row - again, again)
                before, row = batch.slice(batch.num_rows - 1), row + batch.num_rows

    def stamps(self, stretch: _Stretch) -> Int[Array, "N"]:
        """Return the stamps of a stretch as logged; `LogError` where they are none."""
        where = f"{self.source.file}, column {self.layout.time!r}"
        column = stretch.columns[self.layout.time]
        return nanoseconds(column, self.layout.time_unit, where, first_row=stretch.first_row)

    def clock(self) -> Iterator[Int[Array, "M"]]:
        """Yield the stamps without repeated ones; each stretch begins with the last one before."""
        for stretch in self.stretches([self.layout.time]):
            stamps = self.stamps(stretch)
            yield stamps[np.concatenate(([True], np.diff(stamps) > 0))]

    def looked_through(self) -> StreamedTable | None:
        """Return the table with what its times say, or None where a later row changes the types.

        Raises `LogError` where time is missing or goes back.
        """
        where = str(self.source.file)
        title = tables.Table(self.source.file, {}, 1, b"").title
        nearest, furthest, rows, kept, longest = 2**63, 0, 0, 0, 0
        found: list[Note] = []
        for stretch in self.stretches([self.layout.time] if self.source.certain else self.used):
            stamps = self.stamps(stretch)
            clock = Signal(title, (), stamps, np.empty((len(stamps), 0)))
            clock, keep, notes = columns.in_order(clock, where, first_row=stretch.first_row)
            found += notes
            rows += len(keep) - stretch.again
            kept += len(clock) - stretch.again
            longest = max(longest, int(np.diff(clock.stamps).max(initial=0)))
            nearest = min(nearest, int(np.abs(stamps).min()))
            furthest = max(furthest, int(np.abs(stamps).max()))
        kind = self.source.schema.field(self.layout.time).type
        fractions = not (
            pa.types.is_timestamp(kind) or pa.types.is_integer(kind) or kind == SECONDS
        )
        if fractions and nearest < _EXACT <= furthest:
            return None  # the whole column would be rounded as its largest number is
        notes = repeated(found, rows - kept, rows)
        return replace(self, steps=kept - 1, longest=longest, notes=notes)

    def streams(self) -> Iterator[Streams]:
        """Yield the signals of one batch after another."""
        stretches = self.stretches(self.used)
        for stretch in _readable(stretches, self.source.file):
            table = tables.Table(self.source.file, stretch.columns, stretch.first_row, b"")
            try:
                read = tables.signals_of(table, self.claims, self.layout)
            except LogError as error:
                raise self._not_finite(stretch, stretches) or error from error
            yield from_row(read, stretch.again)

    def _not_finite(self, first: _Stretch, rest: Iterable[_Stretch]) -> LogError | None:
        """Return the error that counts what is not finite to the end of the file, None of nothing.

        As `columns.require_finite` says it, with no more than a stretch in memory.
        """
        claims = self.claims
        said = (claims.channels, claims.temperatures, claims.imus)
        for names in (claims.joints, *(names for role in said for names in role.values())):
            bad = _bad(first, names)
            if len(bad):
                row, column = (int(place) for place in bad[0])
                value = first.columns[names[column]][row].as_py()
                count = len(bad) + sum(
                    int((_bad(stretch, names)[:, 0] >= stretch.again).sum()) for stretch in rest
                )
                where, value = str(self.source.file), np.nan if value is None else value
                return columns.not_finite(where, row + first.first_row, names[column], value, count)
        return None


def _readable(stretches: Iterator[_Stretch], file: Path) -> Iterator[_Stretch]:
    """Yield the stretches; `LogError` where the file breaks off or has changed."""
    try:
        yield from stretches
    except (pa.ArrowException, OSError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise LogError(f"{file}: not a readable table: {reason}") from error


def _bad(stretch: _Stretch, names: Sequence[str]) -> Int[Array, "M 2"]:
    """Return row and column of every number that is not finite."""
    numbers = [stretch.columns[name] for name in names]
    if not all(tables.is_number(column.type) for column in numbers):
        return np.empty((0, 2), dtype=np.int64)  # refused for that
    values = columns.matrix([column.cast(pa.float64(), safe=False) for column in numbers])
    return np.argwhere(~np.isfinite(values))
