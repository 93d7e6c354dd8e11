"""A recording → one table, or a folder of tables, with named columns and one of time.

Parquet stores the bytes of float64 by significance, compressed with zstd and without a
dictionary: smaller and twice as fast to read as the defaults for logged numbers. CSV keeps every
bit too: shortest decimals that read back the same, and seconds with nine decimals.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import quote

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from ftcal.errors import OutputError
from ftcal.logs.layout import Layout
from ftcal.recording import NANOSECONDS, Recording, Signal

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array

TIME = "time"


def write(
    recording: Recording, path: Path, *, suffix: Literal[".parquet", ".csv"] = ".parquet"
) -> Layout:
    """Write `recording` at `path` and return the layout that reads it back.

    `path` with the suffix .parquet or .csv is one table, for signals that share one clock, else
    `OutputError`; its joint signals come back as one. Any other `path` is a folder with a table of
    type `suffix` for each signal. Signals without samples are left out, and so are breaks, for
    which tables have no place.
    """
    alone = path.suffix.lower() in {".parquet", ".csv"}
    joints = [(s, {c: c for c in s.columns}) for s in recording.joints if len(s)]
    others = [
        (s, {f"{s.name}.{c}": c for c in s.columns})
        for s in (*recording.channels, *recording.temperatures, *recording.imus)
        if len(s)
    ]
    every = [*joints, *others]
    if not every:
        raise OutputError(f"{path}: recording {recording.name!r} has no sample to write")
    if alone:
        clock = every[0][0]
        for signal, _ in every[1:]:
            if not np.array_equal(signal.stamps, clock.stamps):
                raise OutputError(f"{path}: signals {clock.name!r} and {signal.name!r} have clocks"
                                  " of their own; give a folder")  # fmt: skip
        _write(every, path)
    else:
        if twice := [n for n, k in Counter(s.name for s, _ in every).items() if k > 1]:
            raise OutputError(f"{path}: two signals are called {twice[0]!r}; rename one")
        path.mkdir(parents=True, exist_ok=True)
        for signal, titles in every:
            _write([(signal, titles)], path / (quote(signal.name, safe="") + suffix))
    columns = {signal.name: tuple(titles) for signal, titles in others}
    firsts = [s.name for s, _ in every if s.stamps[0] == recording.start and not alone]
    return Layout(
        time=TIME,
        channels={s.name: columns[s.name] for s in recording.channels if len(s)},
        temperatures={s.name: columns[s.name][0] for s in recording.temperatures if len(s)},
        imus={s.name: columns[s.name] for s in recording.imus if len(s)},
        zero=firsts[0] if firsts else None,
    )


def _write(signals: Sequence[tuple[Signal, dict[str, str]]], file: Path) -> None:
    """Write signals of one clock as one table."""
    names = [TIME, *(title for _, titles in signals for title in titles)]
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise OutputError(f"{file}: two columns would be called {twice[0]!r}; rename the signal")
    values = [s.values[:, k] for s, titles in signals for k in range(len(titles))]
    stamps = np.ascontiguousarray(signals[0][0].stamps, dtype=np.int64)
    numbers = [pa.array(np.ascontiguousarray(column)) for column in values]
    if file.suffix.lower() == ".csv":
        table = pa.table([pa.array(decimal_seconds(stamps)), *numbers], names=names)
        csv.write_csv(table, file, csv.WriteOptions(quoting_style="needed"))
    else:
        moments = pa.array(stamps).cast(pa.timestamp("ns", "UTC"))
        table = pa.table([moments, *numbers], names=names)
        parquet.write_table(
            table, file, compression="zstd", use_dictionary=False, use_byte_stream_split=names[1:]
        )


def decimal_seconds(stamps: Int[Array, "N"]) -> list[str]:
    """Return nanoseconds as text of seconds, exactly."""
    return [f"{n // NANOSECONDS}.{n % NANOSECONDS:09d}" for n in stamps.tolist()]
