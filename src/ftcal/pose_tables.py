"""Poses from tables: CSV, TSV or Parquet, the wrench and the attitude in one, or joined on time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from ftcal.errors import LogError, raise_all, unknown
from ftcal.logs import columns
from ftcal.logs.layout import WRENCH_AXES, Layout
from ftcal.logs.tables_csv import load_csv
from ftcal.logs.tables_time import nanoseconds
from ftcal.pose_clocks import BROKEN, joined
from ftcal.poses import (
    SCALES,
    Attitude,
    Poses,
    Unit,
    gravity_in_sensor,
    other_conventions,
    require_rotations,
    unit_of,
    unsteady_norm,
)
from ftcal.recording import Signal

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

HABITS: Mapping[Attitude, tuple[str, ...]] = MappingProxyType({
    "gravity": ("gx", "gy", "gz"),
    "rotation": tuple(f"r{row}{column}" for row in (1, 2, 3) for column in (1, 2, 3)),
    "acceleration": ("ax", "ay", "az"),
})  # fmt: skip
"""Columns looked for where none are named, the first found wins: gravity needs no convention."""

SUFFIXES = frozenset({".csv", ".tsv", ".txt", ".parquet"})
"""File names that are read as tables of poses."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseLayout:
    """Which columns are what; a field left out is guessed from habit and told."""

    wrench: tuple[str, ...] = ()
    """Six columns, force [N] then torque [Nm]; by habit `fx … tz`."""
    attitude: Attitude | None = None
    """What the attitude is logged as; None: the first of `HABITS` that is complete."""
    columns: tuple[str, ...] = ()
    """Its columns; a rotation row by row. By habit those of `HABITS`."""
    unit: Unit | None = None
    """Of gravity or acceleration; None: the one in which the median norm is gravity's."""
    time: str = "time"
    """Column of the stamps; only two tables and `steady` need it."""
    steady: float | None = None
    """Rows in which gravity turns faster than this [rad/s] are left out; None: all are kept."""


BY_HABIT = PoseLayout()
"""A table whose columns are called as everybody calls them."""


def read_poses(tables: Sequence[Path], layout: PoseLayout = BY_HABIT) -> Poses:
    """Return the poses in one table (CSV, TSV, Parquet), or in two joined on time.

    Of two tables one holds the wrench, the other the attitude, which is interpolated to the
    wrench's clock; rows beyond it and in its holes are left out. Raises `LogError` where a table
    cannot be read, columns are missing or numbers are not finite; `DataError` where the attitude
    is none.
    """
    loaded = [_load(Path(file), layout.time) for file in tables]
    wrench_names, attitude, names = _claims(loaded, layout)
    home = _home(loaded, wrench_names, "wrench")
    attitude_home = _home(loaded, names, attitude)
    wrench, logged = home.numbers(wrench_names), attitude_home.numbers(names)
    rows = np.arange(len(wrench)) + home.first_row
    where = f"{attitude_home.file}, {attitude} from {names[0]} … {names[-1]}"
    said, scale, notes, moving = " (sensor to base, base z up)", 1.0, list[str](), ""
    if attitude == "rotation":
        require_rotations(logged, where, first_row=attitude_home.first_row)
    else:
        norms = np.linalg.norm(logged, axis=1)
        unit = unit_of(norms, layout.unit, where, first_row=attitude_home.first_row)
        said, scale = f" [{unit}]", SCALES[unit]
        notes += unsteady_norm(norms, attitude, unit)
    if layout.steady is not None or attitude_home is not home:
        kept, logged, moving, left = _joined(home, attitude_home, attitude, logged, layout.steady)
        wrench, rows, notes = wrench[kept], rows[kept], [*notes, *left]
    return Poses(
        source=", ".join(str(table.file) for table in loaded),
        attitude=attitude,
        read_as=f"wrench from {wrench_names[0]} … {wrench_names[-1]}, {attitude} from"
        f" {names[0]} … {names[-1]}{said}",
        rows=rows,
        wrench=wrench,
        gravity=gravity_in_sensor(attitude, logged * scale),
        alternatives=other_conventions(logged, wrench) if attitude == "rotation" else (),
        notes=tuple(notes),
        moving=moving,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """One file: named columns of Arrow."""

    file: Path
    columns: Mapping[str, Any]
    time: str
    first_row: int

    def numbers(self, names: Sequence[str]) -> Float[Array, "N K"]:
        """Return columns as float64; `LogError` where one is text or holds what is no number."""
        faults = [
            f"column {name!r} is {self.columns[name].type}, not numbers: mend it or name another"
            for name in names
            if not _is_number(self.columns[name].type)
        ]
        raise_all(LogError, str(self.file), faults)
        values = columns.matrix([self.columns[name].cast(pa.float64()) for name in names])
        columns.require_finite(values, names, str(self.file), first_row=self.first_row)
        row, column = np.unravel_index(np.abs(values).argmax(), values.shape)
        if abs(values[row, column]) > BROKEN:
            raise LogError(
                f"{self.file}, row {row + self.first_row}: column {names[column]!r} is"
                f" {values[row, column]:.3g}, which no sensor reads; cut the row"
            )
        return np.ascontiguousarray(values)

    def clock(self) -> Int[Array, "N"]:
        """Return the stamps [ns]; `LogError` where there are none."""
        if self.time not in self.columns:
            raise LogError(
                f"{self.file}: {unknown('time column', self.time, self.columns)}; say --time COLUMN"
            )
        where = f"{self.file}, column {self.time!r}"
        return nanoseconds(self.columns[self.time], None, where, first_row=self.first_row)


def _is_number(kind: Any) -> bool:
    tests = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal, pa.types.is_null)
    return any(test(kind) for test in tests)


def _load(file: Path, time: str) -> _Table:
    if file.suffix.lower() not in SUFFIXES:
        known = ", ".join(sorted(SUFFIXES))
        raise LogError(f"{file}: no table of poses ends in {file.suffix!r}; give {known}")
    try:
        if file.suffix.lower() == ".parquet":
            table, first_row = parquet.read_table(str(file), partitioning=None), 1
        else:
            table, first_row = load_csv(file, Layout(time=time)), 2
        names = table.column_names  # decoded only here: a ValueError where they are no text
    except (pa.ArrowException, OSError, ValueError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise LogError(f"{file}: not a readable table: {reason}") from error
    if not table.num_rows:
        raise LogError(f"{file}: a header but no rows; log the wrench in at least four attitudes")
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise LogError(f"{file}: column {twice[0]!r} appears {names.count(twice[0])} times; rename")
    return _Table(file, dict(zip(names, table.columns, strict=True)), time, first_row)


def _claims(
    tables: Sequence[_Table], layout: PoseLayout
) -> tuple[tuple[str, ...], Attitude, tuple[str, ...]]:
    """Return the wrench's columns, what the attitude is, and its columns; all faults at once."""
    where = ", ".join(str(table.file) for table in tables)
    known = {name for table in tables for name in table.columns}
    wrench = layout.wrench or WRENCH_AXES
    attitude = layout.attitude
    faults = [unknown("column", name, known) for name in wrench if name not in known]
    if attitude is None:
        complete = [kind for kind, names in HABITS.items() if known.issuperset(names)]
        if not complete:
            habits = ", ".join(f"{names[0]} … {names[-1]}" for names in HABITS.values())
            faults.append(
                f"no attitude: none of {habits}; say --rotation, --gravity or --acceleration"
            )
        attitude = complete[0] if complete else "gravity"
        names = HABITS[attitude] if complete else ()
    else:
        names = layout.columns or HABITS[attitude]
        faults += [unknown("column", name, known) for name in names if name not in known]
    sizes = ((wrench, 6, "the wrench"), (names, len(HABITS[attitude]), f"the {attitude}"))
    faults += [
        f"{what} has {size} columns, {len(asked)} are named"
        for asked, size, what in sizes
        if asked and len(asked) != size
    ]
    raise_all(LogError, where, faults)
    return tuple(wrench), attitude, tuple(names)


def _home(tables: Sequence[_Table], names: Sequence[str], what: str) -> _Table:
    homes = [table for table in tables if all(name in table.columns for name in names)]
    if len(homes) != 1:
        count = f"{len(homes)} tables hold" if homes else "no single table holds"
        raise LogError(f"{count} the {what} columns {', '.join(names)}; give one table that does")
    return homes[0]


def _joined(
    home: _Table,
    other: _Table,
    attitude: Attitude,
    logged: Float[Array, "M K"],
    steady: float | None,
) -> tuple[Int[Array, "N"], Float[Array, "L K"], str, list[str]]:
    """Return rows, attitude, motion and notes as `pose_clocks.joined` does, of two tables."""
    stamps = home.clock()
    wrench = Signal("wrench", (), stamps, np.empty((len(stamps), 0)))
    wrench, kept, _ = columns.in_order(wrench, str(home.file), first_row=home.first_row)
    signal = Signal(attitude, tuple(map(str, range(logged.shape[1]))), other.clock(), logged)
    signal, _, _ = columns.in_order(signal, str(other.file), first_row=other.first_row)
    where = ", ".join(dict.fromkeys((str(home.file), str(other.file))))
    rows, values, moving, notes = joined(
        wrench, signal, attitude, steady=steady, where=where, cure="check --time"
    )
    return np.flatnonzero(kept)[rows], values, moving, notes
