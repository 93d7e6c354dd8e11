"""A table read a stretch of rows at a time, with the types that the whole table would have.

Parquet says its types beforehand. A CSV file does not: they are those of its head, and where a
later row does not fit them, whoever reads must take the table as a whole.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import pyarrow as pa
from pyarrow import csv, parquet

from ftcal.errors import LogError
from ftcal.logs.layout import Layout
from ftcal.logs.tables_csv import load_csv

BLOCK = 1 << 20
"""Bytes of a CSV file that are parsed at a time; Arrow reads 32 of them ahead."""
_HEAD = 1 << 18  # bytes from which the types of a CSV file are told, as `tables_csv` does
_BUFFER = 1 << 17  # bytes of each column that are read ahead: else a row group comes whole


class Batched(Protocol):
    """A table on disk that can be read more than once, from its first row."""

    @property
    def file(self) -> Path:
        """Where it lies."""

    @property
    def schema(self) -> Any:
        """Arrow names and types of all columns."""

    @property
    def first_row(self) -> int:
        """Number of the first sample as a person counts rows in the file."""

    @property
    def certain(self) -> bool:
        """Whether every row is known to fit the schema before it was read."""

    def batches(self, names: Sequence[str], rows: int) -> Iterator[Any]:
        """Yield the columns `names` as Arrow tables of about `rows` rows; raises as Arrow does."""


@dataclass(frozen=True, slots=True)
class ParquetBatches:
    """A Parquet file; a batch has `rows` rows whatever its row groups are."""

    file: Path
    schema: Any
    first_row: int = 1
    certain: bool = True

    @classmethod
    def of(cls, file: Path, layout: Layout) -> ParquetBatches | None:
        """Return the Parquet `file`, or None where it is none, or has no rows in the time asked."""
        try:
            with parquet.ParquetFile(str(file)) as opened:
                rows, schema = opened.metadata.num_rows, opened.schema_arrow
        except (pa.ArrowException, OSError, ValueError):
            return None
        return cls(file, schema) if rows and _sound(schema, layout) else None

    def batches(self, names: Sequence[str], rows: int) -> Iterator[Any]:
        """Yield the columns `names` as Arrow tables of `rows` rows."""
        with parquet.ParquetFile(str(self.file), buffer_size=_BUFFER, pre_buffer=False) as opened:
            for batch in opened.iter_batches(
                rows,
                columns=list(names),
                use_threads=False,  # an arena of memory a thread
            ):
                yield pa.Table.from_batches([batch])


@dataclass(frozen=True, slots=True)
class CsvBatches:
    """A CSV file; a batch is what `BLOCK` bytes hold."""

    file: Path
    schema: Any
    delimiter: str
    first_row: int = 2
    certain: bool = False

    @classmethod
    def of(cls, file: Path, layout: Layout) -> CsvBatches | None:
        """Return the CSV `file`, or None where its head is no table in the time asked."""
        with file.open("rb") as content:
            head = content.read(_HEAD)
        head = head[: head.rfind(b"\n") + 1] or head
        with tempfile.TemporaryDirectory() as scratch:
            copied = Path(scratch) / file.name
            copied.write_bytes(head)
            try:
                table = load_csv(copied, layout)
            except (LogError, pa.ArrowException, ValueError):
                return None
        if not (table.num_rows and _sound(table.schema, layout)):
            return None
        titles = head.decode("utf-8-sig", errors="replace").splitlines()[0]
        return cls(file, table.schema, max(",;\t", key=titles.count))

    def batches(self, names: Sequence[str], rows: int) -> Iterator[Any]:
        """Yield the columns `names` as Arrow tables; a block is a block, whatever `rows` says."""
        del rows
        types = {name: self.schema.field(name).type for name in names}
        with csv.open_csv(
            str(self.file),
            read_options=csv.ReadOptions(block_size=BLOCK),
            parse_options=csv.ParseOptions(delimiter=self.delimiter),
            convert_options=csv.ConvertOptions(column_types=types, include_columns=list(names)),
        ) as opened:
            for batch in opened:
                yield pa.Table.from_batches([batch])


_OPENED_BY = {".parquet": ParquetBatches.of, ".csv": CsvBatches.of, ".tsv": CsvBatches.of}


def batched(file: Path, layout: Layout) -> Batched | None:
    """Return `file` to be read in batches; None where only the reader of whole tables can judge."""
    opener = _OPENED_BY.get(file.suffix.lower())
    return opener(file, layout) if opener else None


def _sound(schema: Any, layout: Layout) -> bool:
    return len(set(schema.names)) == len(schema.names) and layout.time in schema.names
