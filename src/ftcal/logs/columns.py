"""From the columns of a log file to signals that can be believed.

What every reader refuses: time that goes back, numbers that are not finite. What it mends and
tells: stamps that come twice. Stamps are integers from the text on: float64 holds Unix seconds
only to 2.4e-7 s.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from ftcal.errors import LogError, unknown
from ftcal.recording import NANOSECONDS, Finding, FindingKind, Recording, Signal

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array

SECONDS = pa.decimal128(19, 9)
"""Seconds as text with up to nine decimals: the unscaled integer counts nanoseconds."""


@dataclass(frozen=True, slots=True)
class Note:
    """A finding whose times are not yet counted from second zero."""

    kind: FindingKind
    signal: str
    """Name of the signal that shows it."""
    start: int
    """Nanoseconds since the Unix epoch."""
    stop: int
    """Nanoseconds since the Unix epoch, exclusive."""
    message: str
    """One line for a person."""


@dataclass(frozen=True, slots=True)
class Streams:
    """Signals by what they are, as one file or folder gave them, with what was noticed."""

    joints: tuple[Signal, ...] = ()
    channels: tuple[Signal, ...] = ()
    temperatures: tuple[Signal, ...] = ()
    imus: tuple[Signal, ...] = ()
    notes: tuple[Note, ...] = ()

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Every signal once."""
        return (*self.joints, *self.channels, *self.temperatures, *self.imus)


def merge(parts: Iterable[Streams]) -> Streams:
    """Return the streams of all `parts` in their order."""
    every = list(parts)
    fields = ("joints", "channels", "temperatures", "imus", "notes")
    return Streams(**{f: tuple(x for part in every for x in getattr(part, f)) for f in fields})


def decimal_nanoseconds(column: Any, where: str) -> Int[Array, "N"]:
    """Return the nanoseconds in a column of type `SECONDS`, exactly; `LogError` beyond 2262."""
    words = [
        np.frombuffer(chunk.buffers()[1], np.int64).reshape(-1, 2)[chunk.offset :][: len(chunk)]
        for chunk in column.chunks
        if len(chunk)
    ]
    words_128 = np.concatenate(words) if words else np.empty((0, 2), np.int64)
    stamps = np.ascontiguousarray(words_128[:, 0])
    if (words_128[:, 1] != stamps >> 63).any():
        raise LogError(f"{where}: a time stamp lies beyond the year 2262; check the time column")
    return stamps


def matrix(columns: Sequence[Any], *, scale: float = 1.0) -> Float[Array, "N K"]:
    """Return Arrow number columns as float64 times `scale`; each column is contiguous."""
    length = len(columns[0]) if columns else 0
    values = np.empty((len(columns), length)).T
    for k, column in enumerate(columns):
        row = 0
        for chunk in column.chunks:
            block = chunk.to_numpy(zero_copy_only=False)
            with np.errstate(over="ignore"):  # infinity is refused later, by name
                np.multiply(block, scale, out=values[row : row + len(chunk), k])
            row += len(chunk)
    return values


def require_finite(
    values: Float[Array, "N K"], names: Sequence[str], where: str, *, first_row: int
) -> None:
    """Raise `LogError` naming column and row of the first NaN or infinity."""
    finite: Bool[Array, "N K"] = np.isfinite(values)
    if finite.all():
        return
    row, column = np.argwhere(~finite)[0]
    count = int(finite.size - finite.sum())
    raise not_finite(where, int(row) + first_row, names[column], values[row, column], count)


def not_finite(where: str, row: int, name: str, value: object, count: int) -> LogError:
    """Return the error that names the first of `count` values that are no finite numbers."""
    return LogError(
        f"{where}, row {row}: column {name!r} is {value} ({count} such values in all);"
        " cut these rows, or leave the column out"
    )


def in_order(
    signal: Signal, where: str, *, first_row: int
) -> tuple[Signal, Bool[Array, "N"], tuple[Note, ...]]:
    """Return `signal` without later samples of a repeated stamp, the rows kept, and a note.

    Raises `LogError` where time goes back: which of both orders is true cannot be known.
    """
    step = np.diff(signal.stamps)
    keep = np.concatenate(([True], step > 0)) if len(signal) else np.zeros(0, dtype=bool)
    if keep.all():
        return signal, keep, ()
    if (step < 0).any():
        row = int(np.flatnonzero(step < 0)[0])
        raise LogError(
            f"{where}, row {row + 1 + first_row}: time goes back by"
            f" {-int(step[row]) / NANOSECONDS:.6f} s; split the log there and read the parts"
        )
    repeated = np.flatnonzero(~keep)
    note = Note(
        "duplicate stamps",
        signal.name,
        int(signal.stamps[repeated[0]]),
        int(signal.stamps[repeated[-1]]) + 1,
        f"{len(repeated)} of {len(keep)} samples repeat the stamp before them; left out",
    )
    return replace(signal, stamps=signal.stamps[keep], values=signal.values[keep]), keep, (note,)


def file_sha256(file: Path) -> bytes:
    """Return the SHA-256 of `file`; run beside the parser, it costs a tenth of the reading."""
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").digest()


def digest(files: Iterable[bytes]) -> str:
    """Return one SHA-256 for the SHA-256 of each file, in the order given."""
    total = hashlib.sha256()
    for file in files:
        total.update(file)
    return total.hexdigest()


def recording(
    streams: Streams, *, name: str, source: str, zero: str | None, sha256: str
) -> Recording:
    """Return the recording of `streams` with second zero at the signal `zero`, or the earliest."""
    firsts = {s.name: int(s.stamps[0]) for s in streams.signals if len(s)}
    if not firsts:
        raise LogError(f"{source}: no F/T, joint, temperature or inertial sample in it")
    if zero is not None and zero not in firsts:
        raise LogError(f"{source}: {unknown('signal', zero, firsts)}; zero must name one")
    for role in (streams.joints, streams.channels, streams.temperatures, streams.imus):
        names = [s.name for s in role]
        if twice := sorted({n for n in names if names.count(n) > 1}):
            raise LogError(
                f"{source}: {len(names)} signals share the name {twice[0]!r}; read apart"
            )
    start = min(firsts.values()) if zero is None else firsts[zero]
    findings = tuple(
        Finding(
            note.kind,
            note.signal,
            (note.start - start) / NANOSECONDS,
            (note.stop - start) / NANOSECONDS,
            cut=False,
            message=note.message,
        )
        for note in streams.notes
    )
    return Recording(
        name=name,
        source=source,
        start=start,
        joints=streams.joints,
        channels=streams.channels,
        temperatures=streams.temperatures,
        imus=streams.imus,
        findings=findings,
        digest=sha256,
    )
