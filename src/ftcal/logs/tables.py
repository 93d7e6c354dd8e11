"""CSV, Parquet, `.npz`: a table with named columns and one of time, or a folder of such tables.

Every table has its own clock. Columns are claimed in this order: time; what the layout names; the
groups `<prefix>fx … tz` of an F/T sensor. All numbers left over are joints, in one signal called
like its file: columns that are no joints do no harm there. Text columns are ignored.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from ftcal.errors import LogError, unknown
from ftcal.logs import columns
from ftcal.logs.arrays import load_npz
from ftcal.logs.columns import Streams
from ftcal.logs.layout import Layout
from ftcal.logs.tables_csv import load_csv
from ftcal.logs.tables_time import nanoseconds
from ftcal.logs.tables_writer import write
from ftcal.recording import Recording, Signal

__all__ = ["SUFFIXES", "files", "read", "write"]

SUFFIXES = frozenset({".csv", ".tsv", ".parquet", ".npz"})
"""File names that are read as tables."""

_AXIS = re.compile(r"^(?P<prefix>.*?)(?P<separator>[._/]?)(?P<axis>[ftm][xyz])$", re.IGNORECASE)
_AXES = (("fx", "fy", "fz", "tx", "ty", "tz"), ("fx", "fy", "fz", "mx", "my", "mz"))


@dataclass(frozen=True, slots=True)
class Table:
    """One file: named columns of Arrow, and where its rows begin."""

    file: Path
    columns: Mapping[str, Any]
    first_row: int
    """Number of the first sample as a person counts rows in the file."""
    sha256: bytes

    @property
    def title(self) -> str:
        """What signals are called that have no name of their own."""
        return unquote(self.file.stem)


def files(folder: Path) -> list[Path]:
    """Return the tables in `folder`, in the order of their names."""
    return sorted(f for f in folder.iterdir() if f.suffix.lower() in SUFFIXES and f.is_file())


def read(path: Path, layout: Layout, *, name: str | None = None) -> Recording:
    """Return the recording in the table or the folder of tables `path`.

    Raises `LogError` where there is no time column, a column is missing or twice, time goes back,
    or a number is not finite.
    """
    tables = [_load(file, layout) for file in (files(path) if path.is_dir() else [path])]
    claims = claimed(path, tables, layout)
    streams = columns.merge(signals_of(t, claims[t.file], layout) for t in tables)
    return columns.recording(
        streams,
        name=name or (path.resolve().name if path.is_dir() else tables[0].title),
        source=str(path),
        zero=layout.zero,
        sha256=columns.digest(table.sha256 for table in tables),
    )


def _load(file: Path, layout: Layout) -> Table:
    try:
        with ThreadPoolExecutor(1) as beside:
            digest = beside.submit(columns.file_sha256, file)
            if file.suffix.lower() == ".parquet":
                table, first_row = parquet.read_table(str(file), partitioning=None), 1
            elif file.suffix.lower() == ".npz":
                table, first_row = load_npz(file, layout), 1
            else:
                table, first_row = load_csv(file, layout), 2
            names = table.column_names  # decodes them
    except (pa.ArrowException, OSError, ValueError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise LogError(f"{file}: not a readable table: {reason}") from error
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise LogError(f"{file}: column {twice[0]!r} appears {names.count(twice[0])} times; rename")
    if layout.time not in names:
        raise LogError(f"{file}: {unknown('time column', layout.time, names)}; say time = COLUMN")
    if not table.num_rows:
        raise LogError(f"{file}: a header but no rows; leave the file out")
    by_name = dict(zip(names, table.columns, strict=True))
    return Table(file, by_name, first_row, digest.result())


@dataclass(frozen=True, slots=True)
class Claims:
    """What the columns of one table are: signal → its columns, by role."""

    channels: dict[str, tuple[str, ...]]
    temperatures: dict[str, tuple[str, ...]]
    imus: dict[str, tuple[str, ...]]
    joints: tuple[str, ...]


def claimed(path: Path, tables: list[Table], layout: Layout) -> dict[Path, Claims]:
    """Return who owns which column of every table; `LogError` where the layout names none."""
    temperatures = {signal: (column,) for signal, column in layout.temperatures.items()}
    known = [column for table in tables for column in table.columns]
    said: dict[Path, list[dict[str, tuple[str, ...]]]] = {t.file: [{}, {}, {}] for t in tables}
    for role, signals in enumerate((layout.channels, temperatures, layout.imus)):
        for signal, said_names in signals.items():
            names = [column for name in said_names for column in _columns_called(name, known)]
            if absent := [name for name in names if name not in known]:
                raise LogError(f"{path}: {unknown('column', absent[0], known)}, as {signal!r} asks")
            homes = [table for table in tables if all(name in table.columns for name in names)]
            if len(homes) != 1:
                what = f"{len(homes)} tables hold" if homes else "no single table holds"
                raise LogError(f"{path}: {what} the columns of {signal!r}; give one table")
            said[homes[0].file][role][signal] = tuple(names)
    if absent := [name for name in layout.joints if name not in known]:
        raise LogError(f"{path}: {unknown('column', absent[0], known)} to name as a joint")
    return {table.file: claims_of(table, layout, *said[table.file]) for table in tables}


def _columns_called(name: str, known: list[str]) -> list[str]:
    """Return the column `name`, or else the columns `name.…` of an array so called."""
    whole = [] if name in known else [c for c in known if c.startswith(f"{name}.")]
    return whole or [name]


def claims_of(
    table: Table,
    layout: Layout,
    channels: dict[str, tuple[str, ...]],
    temperatures: dict[str, tuple[str, ...]],
    imus: dict[str, tuple[str, ...]],
) -> Claims:
    taken = {layout.time, *layout.joints}
    for said in (channels, temperatures, imus):
        taken |= {column for names in said.values() for column in names}
    numbers = [n for n, c in table.columns.items() if is_number(c.type) and n not in taken]
    groups: dict[tuple[str, str], dict[str, str]] = {}
    for column in numbers:
        if found := _AXIS.match(column):
            key = (found["prefix"], found["separator"])
            groups.setdefault(key, {})[found["axis"].lower()] = column
    guessed = {
        prefix or table.title: tuple(group[axis] for axis in axes)
        for (prefix, _), group in groups.items()
        for axes in _AXES
        if all(axis in group for axis in axes)
    }
    taken = {column for names in guessed.values() for column in names}
    joints = [n for n in numbers if n not in taken]
    joints += [n for n, new in layout.joints.items() if new and n in table.columns]
    order = list(table.columns)
    return Claims(
        {**guessed, **channels}, temperatures, imus, tuple(sorted(joints, key=order.index))
    )


def is_number(kind: Any) -> bool:
    tests = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal)
    return any(test(kind) for test in tests)


def signals_of(table: Table, claims: Claims, layout: Layout) -> Streams:
    """Return the signals of one table, all on its clock."""
    where = str(table.file)
    stamps = nanoseconds(
        table.columns[layout.time], layout.time_unit, f"{where}, column {layout.time!r}",
        first_row=table.first_row,
    )  # fmt: skip
    clock = Signal(table.title, (), stamps, np.empty((len(stamps), 0)))
    clock, kept, notes = columns.in_order(clock, where, first_row=table.first_row)
    rows = slice(None) if kept.all() else kept

    def signal(name: str, names: tuple[str, ...], titles: tuple[str, ...], scale: float) -> Signal:
        for column in names:
            if not is_number(table.columns[column].type):
                kind = table.columns[column].type
                raise LogError(f"{where}: column {column!r} of {name!r} is {kind}, not numbers")
        # whole numbers beyond 2^53 (a second stamp in ns) are rounded: no joint is that far
        doubles = [table.columns[column].cast(pa.float64(), safe=False) for column in names]
        values = columns.matrix(doubles, scale=scale)
        columns.require_finite(values, names, where, first_row=table.first_row)
        return Signal(name, titles, clock.stamps, values[rows])

    radians = np.pi / 180 if layout.angle == "deg" else 1.0
    joints = tuple(layout.joints.get(name, (name,))[0] for name in claims.joints)
    return Streams(
        joints=(signal(table.title, claims.joints, joints, radians),) if joints else (),
        channels=tuple(signal(s, n, _short(s, n), 1.0) for s, n in claims.channels.items()),
        temperatures=tuple(signal(s, n, ("temperature",), 1.0)
                           for s, n in claims.temperatures.items()),
        imus=tuple(signal(s, n, _short(s, n), 1.0) for s, n in claims.imus.items()),
        notes=notes,
    )  # fmt: skip


def _short(signal: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the columns' names without the signal's in front: `l_leg.fx` is `fx` of `l_leg`."""
    return tuple(
        name[len(signal) :].lstrip("._/") if name.startswith(signal) else name for name in names
    )
