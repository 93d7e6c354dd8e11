"""One port of a YARP dumper: `data.log` (samples) and `info.log` (what was connected, when).

A line of `data.log` is `seq time v1 … vn`; a dumper started with `--txTime --rxTime` writes both
stamps, sender first (yarpdatadumper, `DumpTimeStamp::getString`). The sender's stamp is the one
kept: it does not contain the network. Values may be grouped, `(v1 … vn) [ok] (…) [ok]`; a motor
board's first group is the joint positions. The last line is often cut where the dumper was killed.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from os import SEEK_END
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from pyarrow import compute, csv

from ftcal.errors import LogError
from ftcal.logs.columns import SECONDS, decimal_nanoseconds, matrix

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

SAMPLES, CONNECTION = "data.log", "info.log"
"""The two files in the folder of a port."""

BLOCK = 4 << 20
"""Bytes of text that are read at a time where the log comes in pieces."""

SEQUENCE_SIZE = 32768
"""The packet counter of a YARP envelope runs from 0 to 32767 and starts again."""

_MARKS = b"()[]ok"
_EVENT = re.compile(r"^\[(\d+(?:\.\d+)?)\]\s+(\S+)\s+\[(connected|disconnected)\]\s*$")
_UNIX_TIME = re.compile(rb"^[1-9]\d{8,9}\.\d{6,9}$")
_TAIL = 1 << 16  # bytes, more than any line
_AHEAD = 2  # blocks that are parsed while one is used
_PARSED = 4 << 20  # bytes a thread parses at once: 1 MiB, the default, is a quarter slower


@dataclass(frozen=True, slots=True)
class Connection:
    """What `info.log` says."""

    port: str = ""
    """Full name of the port, such as `/icub/right_leg/analog:o`; "" where nothing says."""
    bottle: bool = True
    """Whether the port carried text; pictures and sound do not."""
    both_stamps: bool | None = None
    """Whether each line has the sender's and the receiver's stamp; None: `info.log` is silent."""
    opened: tuple[int, ...] = ()
    """Nanoseconds since the Unix epoch of each connection."""
    closed: tuple[int, ...] = ()
    """Nanoseconds since the Unix epoch of each disconnection."""


def connection(text: bytes, where: str) -> Connection:
    """Return what the `info.log` with content `text` says; lines of no known form are skipped."""
    lines = text.decode(errors="replace").splitlines()
    heads = dict(line.split(":", 1) for line in lines if line.startswith(("Type:", "Stamp:")))
    events = [found.groups() for line in lines if (found := _EVENT.match(line))]
    ports = sorted({port for _, port, _ in events})
    if len(ports) > 1:
        raise LogError(f"{where}: ports {', '.join(ports)} are mixed in one log; dump them apart")
    stamps = [(round(float(t) * 1_000_000) * 1000, kind) for t, _, kind in events if len(t) < 30]
    return Connection(
        port=ports[0] if ports else "",
        bottle="Type" not in heads or "bottle" in heads["Type"].lower(),
        both_stamps="tx+rx" in heads["Stamp"] if "Stamp" in heads else None,
        opened=tuple(stamp for stamp, kind in stamps if kind == "connected"),
        closed=tuple(stamp for stamp, kind in stamps if kind == "disconnected"),
    )


@dataclass(frozen=True, slots=True)
class Samples:
    """What `data.log` holds, unaltered but for its unit."""

    sequence: Int[Array, "N"]
    """Packet counter of each line, as logged."""
    stamps: Int[Array, "N"]
    """Nanoseconds since the Unix epoch, as logged: repeated or disordered ones included."""
    values: Float[Array, "N K"]
    """The fields asked for, by column."""


NOTHING = Samples(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 0)))
"""What a port logs that nobody wrote to."""


@dataclass(frozen=True, slots=True)
class Form:
    """What the ends of a `data.log` say of all its lines."""

    used: tuple[int, ...] = ()
    """Fields of a line that are values."""
    status: tuple[int, ...] = ()
    """Fields that say whether the values are good."""
    width: int = 0
    """Fields of a line."""
    grouped: bool = False
    """Whether values stand in brackets."""
    size: int = 0
    """Bytes of all whole lines."""
    truncated: bool = False
    """Whether an incomplete last line follows them."""


def form(file: Path, *, both_stamps: bool | None, fields: Collection[int] | None = None) -> Form:
    """Return the form of the lines of a `data.log`; without fields where no line is whole.

    `fields` are the fields of a line that are values; None: the first group, or all after the
    stamps where nothing is grouped. Raises `LogError` where the first line is no sample.
    """
    first, spare = _ends(file)
    size = file.stat().st_size
    if not first and not spare and size:
        raise LogError(f"{file}, line 1: it is empty; cut the line")
    if not first or spare == size:
        return Form(truncated=spare > 0)
    used, status, width = _used_columns(first, both_stamps)
    if fields is not None:
        used, status = list(fields), []
    if not used:
        raise LogError(f"{file}, line 1: no counter, time and values; is this a YARP log?")
    return Form(tuple(used), tuple(status), width, b"(" in first, size - spare, spare > 0)


def first_line(file: Path) -> bytes:
    """Return the first line of a `data.log`, b"" where not even that is whole."""
    return _ends(file)[0]


def numeric(file: Path) -> bool:
    """Return whether the first line of a `data.log` looks like numbers."""
    fields = first_line(file).translate(None, _MARKS).split()
    return len(fields) > 2 and all(_is_number(field) for field in fields)


def parse(file: Path, lines: Form, *, scale: float = 1.0) -> Samples:
    """Return the samples in the `data.log` at `file`, with values times `scale`.

    Raises `LogError` naming the first line that is not like the others, or not a number.
    """
    if not lines.width:
        return NOTHING
    if lines.grouped or lines.truncated:
        with file.open("rb") as log:
            return _block(log.read(lines.size), 0, lines, file, scale)
    # Arrow reads plain numbers from disk with fewest copies
    return _samples(str(file), lines, file, scale, file.read_bytes, 0)


def blocks(file: Path, lines: Form, *, size: int, scale: float = 1.0) -> Iterator[Samples]:
    """Yield what `parse` returns, about `size` bytes of whole lines at a time.

    While one is used the next are parsed. Raises `LogError` as `parse` does, and where the file is
    no longer what it was.
    """
    waiting: deque[Future[Samples]] = deque()
    if not lines.size:
        return
    try:
        with file.open("rb") as log, ThreadPoolExecutor(_AHEAD) as beside:
            start = 0
            while start < lines.size:
                text = log.read(min(size, lines.size - start))
                if not text.endswith(b"\n"):
                    text += log.readline(lines.size - start - len(text))
                if not text.endswith(b"\n"):
                    raise LogError(f"{file}: it was changed while it was read; read it again")
                if text.strip(b"\r\n"):
                    waiting.append(beside.submit(_block, text, start, lines, file, scale))
                start += len(text)
                if len(waiting) > _AHEAD:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
    except OSError as error:
        raise LogError(f"{file}: {error.strerror or error}") from error


def _block(text: bytes, start: int, lines: Form, file: Path, scale: float) -> Samples:
    """Return the samples in the `text` of whole lines that begins at byte `start` of `file`."""
    if lines.grouped:
        text = text.translate(None, _MARKS)  # a large file is not held twice
    return _samples(pa.BufferReader(text), lines, file, scale, lambda: text, start)


def _samples(
    source: Any, lines: Form, file: Path, scale: float, clean: Callable[[], bytes], start: int
) -> Samples:
    """Return the samples in a `source` of lines without marks, whose text `clean` returns."""
    names = [str(column) for column in range(lines.width)]
    kinds = {0: pa.int64(), 1: SECONDS} | dict.fromkeys(lines.used, pa.float64())
    kinds |= dict.fromkeys(lines.status, pa.string())
    try:
        table = csv.read_csv(
            source,
            read_options=csv.ReadOptions(column_names=names, block_size=_PARSED),
            parse_options=csv.ParseOptions(delimiter=" ", quote_char=False),
            convert_options=csv.ConvertOptions(
                column_types={names[column]: kind for column, kind in kinds.items()},
                include_columns=[names[column] for column in kinds],
                null_values=[],
            ),
        )
    except pa.ArrowException as error:
        raise _culprit(clean(), lines, file, error, start) from error
    for column in lines.status:
        failed = compute.not_equal(table.column(names[column]), "")
        if compute.any(failed).as_py():
            row = compute.index(failed, True).as_py()
            filled = (n for n, line in enumerate(clean().split(b"\n")) if line.strip(b"\r"))
            line = _lines_before(file, start) + next(islice(filled, row, None)) + 1
            raise LogError(f"{file}, line {line}: the motor board marks the positions as failed;"
                           " cut these lines")  # fmt: skip
    return Samples(
        table.column("0").to_numpy(),
        decimal_nanoseconds(table.column("1"), str(file)),
        matrix([table.column(names[column]) for column in lines.used], scale=scale),
    )


def _ends(file: Path) -> tuple[bytes, int]:
    """Return the first line of `file`, and how many bytes at its end are no whole line.

    A last line is whole that ends, and has as many fields as the first.
    """
    with file.open("rb") as log:
        first = log.readline()
        size = log.seek(0, SEEK_END)
        log.seek(max(0, size - _TAIL))
        tail = log.read()
    if not first.endswith(b"\n"):
        return b"", size
    end = tail.rfind(b"\n") + 1
    last = tail.rfind(b"\n", 0, max(end - 1, 0)) + 1
    if tail.count(b" ", last, end) < first.count(b" "):
        end = last
    return first.rstrip(b"\r\n"), len(tail) - end


def _used_columns(first: bytes, both_stamps: bool | None) -> tuple[list[int], list[int], int]:
    """Return which fields of a line hold values, which the status of their group; the count."""
    fields = first.translate(None, _MARKS).split(b" ")
    if both_stamps is None:
        both_stamps = len(fields) > 3 and all(_UNIX_TIME.match(f) for f in fields[1:3])
    begin = 3 if both_stamps else 2
    group, mark, rest = first.partition(b")")
    stop = len(group.translate(None, _MARKS).split(b" "))
    status = [stop] if mark and rest.startswith(b" [") else []
    return [i for i in range(begin, stop) if fields[i]], status, len(fields)


def _is_number(field: bytes) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _lines_before(file: Path, byte: int) -> int:
    with file.open("rb") as log:
        return sum(log.read(min(BLOCK, byte - at)).count(b"\n") for at in range(0, byte, BLOCK))


def _culprit(clean: bytes, lines: Form, file: Path, error: Exception, start: int) -> LogError:
    """Return the error that names the first line Arrow could not read; slow, but only then."""
    for number, line in enumerate(clean.split(b"\n")[:-1], start=_lines_before(file, start) + 1):
        fields = line.rstrip(b"\r").split(b" ")
        if line and len(fields) != lines.width:
            return LogError(
                f"{file}, line {number}: {len(fields)} fields where the first line has"
                f" {lines.width}; cut the line, or the log there"
            )
        if bad := [fields[i] for i in (0, 1, *lines.used) if line and not _is_number(fields[i])]:
            text = bad[0][:40].decode(errors="replace")
            return LogError(f"{file}, line {number}: {text!r} is no number; cut the line")
    reason = str(error).splitlines()[0][:200]
    return LogError(f"{file}: not a YARP log ({reason}); give the folder that the dumper wrote")
