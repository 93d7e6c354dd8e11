"""F/T signals → one table or a folder of tables, piece by piece.

What comes out is what `tables_writer` writes of the whole: the same bytes as CSV, the same columns
and numbers as Parquet (a row group a piece).
"""

from __future__ import annotations

import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import quote

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from ftcal.errors import OutputError
from ftcal.logs.tables_writer import TIME, decimal_seconds
from ftcal.recording import Recording, Signal

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array

SUFFIXES = frozenset({"", ".csv", ".parquet"})
"""Names that are written: a name without a suffix is a folder of Parquet files."""


class Writer:
    """Writes `channels` piece by piece; a context manager, what it made appears when it ends.

    Nothing appears where the block raises, nor where there was no sample.
    """

    def __init__(self, path: Path) -> None:
        """Prepare to write `path`; `OutputError` where it cannot be."""
        self._path = path
        self._files: dict[str, _File] = {}
        self._name = ""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._scratch = tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.")
        except OSError as error:
            raise self._refused(error) from error
        self._made = Path(self._scratch.name) / path.name

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            for file in self._files.values():
                file.sink.close()
            if kind is None:
                if not self._files:
                    raise OutputError(
                        f"{self._path}: recording {self._name!r} has no sample to write"
                    )
                self._made.replace(self._path)
        except OSError as fault:
            raise self._refused(fault) from fault
        finally:
            self._scratch.cleanup()

    def add(self, recording: Recording) -> None:
        """Append the samples of `recording`, which follow those written before.

        Raises `OutputError` where signals of one table have clocks of their own, or two signals or
        columns share a name.
        """
        self._name = recording.name
        signals = [signal for signal in recording.channels if len(signal)]
        if not signals:
            return
        try:
            if self._path.suffix:
                self._append(self._made, signals)
                return
            self._made.mkdir(exist_ok=True)
            if twice := [n for n, k in Counter(s.name for s in signals).items() if k > 1]:
                raise OutputError(f"{self._path}: two signals are called {twice[0]!r}; rename one")
            for signal in signals:
                self._append(self._made / (quote(signal.name, safe="") + ".parquet"), [signal])
        except (OSError, pa.ArrowException) as error:
            raise self._refused(error) from error

    def _append(self, made: Path, signals: list[Signal]) -> None:
        """Append signals of one clock to the file `made`, which the first to come opens."""
        names = tuple(signal.name for signal in signals)
        known = self._files.get(made.name)
        for signal in signals[1:]:
            if not np.array_equal(signal.stamps, signals[0].stamps):
                raise self._apart(names[0], signal.name)
        if known is not None and (odd := sorted(set(known.signals) ^ set(names))):
            raise self._apart(*odd, *known.signals, *names)
        table = self._table(made, signals)
        if known is None:
            known = self._files[made.name] = _File(
                names, _OPENERS[made.suffix.lower()](made, table.schema)
            )
        known.sink.write_table(table)

    def _table(self, made: Path, signals: list[Signal]) -> Any:
        columns = {
            f"{s.name}.{c}": s.values[:, k] for s in signals for k, c in enumerate(s.columns)
        }
        if len(columns) < sum(len(signal.columns) for signal in signals) or TIME in columns:
            raise OutputError(f"{self._path}: two columns would have one name; rename the signal")
        time = _CLOCKS[made.suffix.lower()](np.ascontiguousarray(signals[0].stamps))
        numbers = [pa.array(np.ascontiguousarray(column)) for column in columns.values()]
        return pa.table([time, *numbers], names=[TIME, *columns])

    def _apart(self, *names: str) -> OutputError:
        first, second, *_ = dict.fromkeys(names)
        return OutputError(
            f"{self._path}: signals {first!r} and {second!r} have clocks of their own;"
            " give a folder"
        )

    def _refused(self, error: Exception) -> OutputError:
        reason = getattr(error, "strerror", None) or error
        return OutputError(
            f"{self._path}: cannot be written ({reason}); name another place with -o"
        )


@dataclass(frozen=True, slots=True)
class _File:
    """A table that grows."""

    signals: tuple[str, ...]
    """Those whose columns it has."""
    sink: Any
    """Arrow's writer of it."""


def _parquet(file: Path, schema: Any) -> Any:
    # as `tables_writer` has it: by significance and without a dictionary, smaller and faster
    return parquet.ParquetWriter(
        str(file), schema, compression="zstd", use_dictionary=False,
        use_byte_stream_split=schema.names[1:],
    )  # fmt: skip


def _csv(file: Path, schema: Any) -> Any:
    options = csv.WriteOptions(quoting_style="needed")
    return csv.CSVWriter(str(file), schema, write_options=options)


def _moments(stamps: Int[Array, "N"]) -> Any:
    return pa.array(stamps).cast(pa.timestamp("ns", "UTC"))


def _texts(stamps: Int[Array, "N"]) -> Any:
    return pa.array(decimal_seconds(stamps))


_OPENERS = {".parquet": _parquet, ".csv": _csv}
_CLOCKS = {".parquet": _moments, ".csv": _texts}
