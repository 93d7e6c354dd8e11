"""One CSV file → an Arrow table: numbers as float64, the time column to its last digit."""

from __future__ import annotations

import csv as plain_csv
import re
from pathlib import Path
from typing import Any

import pyarrow as pa
from pyarrow import csv

from ftcal.errors import LogError
from ftcal.logs.columns import SECONDS
from ftcal.logs.layout import Layout

_DECIMAL = re.compile(r"^[+-]?\d{1,10}\.\d{1,9}$")
_HEAD = 1 << 18  # bytes from which the types of the columns are guessed
_BLOCK = 4 << 20  # bytes a thread parses at once


def load_csv(file: Path, layout: Layout) -> Any:
    """Return the Arrow table of a CSV `file`; its header says which of , ; tab delimits.

    Raises `LogError` for an empty file and what Arrow raises for one that is no table.
    """
    with file.open("rb") as content:
        head = content.read(_HEAD)
    lines = head.decode("utf-8-sig", errors="replace").splitlines()[:2]
    if not lines or not lines[0].strip():
        raise LogError(f"{file}: the file is empty; leave it out")
    delimiter = max(",;\t", key=lines[0].count)
    parse = csv.ParseOptions(delimiter=delimiter)
    whole = head[: head.rfind(b"\n") + 1] or head
    schema = csv.read_csv(pa.BufferReader(whole), parse_options=parse).schema
    # counts that are whole at first would be taken for integers throughout
    types = {
        field.name: pa.float64()
        for field in schema
        if (pa.types.is_integer(field.type) or pa.types.is_null(field.type))
        and field.name != layout.time
    }
    try:
        names, *first = plain_csv.reader(lines, delimiter=delimiter)
    except plain_csv.Error as error:
        raise LogError(f"{file}: its header is none: {error}; is it a table?") from error
    moment = dict(zip(names, first[0], strict=False)).get(layout.time, "") if first else ""
    exact = dict(types)
    if _DECIMAL.match(moment) and layout.time_unit in {None, "s"}:
        exact[layout.time] = SECONDS
    failure: Exception | None = None
    # some later stamp may have more digits; and on one thread Arrow says in which row it failed
    for wanted, threads in ((exact, True), (types, True), (types, False)):
        try:
            return csv.read_csv(
                str(file),
                read_options=csv.ReadOptions(use_threads=threads, block_size=_BLOCK),
                parse_options=parse,
                convert_options=csv.ConvertOptions(column_types=wanted),
            )
        except pa.ArrowInvalid as error:
            failure = error
    assert failure is not None
    raise failure
