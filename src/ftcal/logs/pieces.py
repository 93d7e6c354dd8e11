"""A log a span of time at a time, for recordings larger than memory.

A piece is the recording itself with its signals cut to a span: same second zero, same findings,
same digest, and the pieces put together are what `logs.read` returns, bit for bit. A session that
opens with a piece is a break at row 0 of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from ftcal.recording import NANOSECONDS, Recording, Signal, find

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array

NUMBERS = 1 << 20
"""Numbers of a piece where its rows are not said: 8 MB."""

Role = Literal["joints", "channels", "temperatures", "imus"]
ROLES: tuple[Role, ...] = ("joints", "channels", "temperatures", "imus")
"""The fields of a recording that hold signals."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A span of a recording, with what lies within the overlap on both sides of it."""

    recording: Recording
    """Signals from `start` less the overlap to `stop` plus the overlap."""
    start: int
    """Nanoseconds since the Unix epoch; the span before ends there."""
    stop: int
    """Nanoseconds since the Unix epoch, exclusive; the next span begins there."""

    @property
    def own(self) -> Recording:
        """The recording without the overlap: every sample of a log is in one piece's own."""
        return cut(self.recording, self.start, self.stop)


class Pieces(Protocol):
    """A log that was opened and can be read a piece at a time, more than once."""

    @property
    def head(self) -> Recording:
        """The recording with the first sample of each signal: what there is to read."""

    def period(self, role: Role, name: str) -> float:
        """Return `Signal.period` [s] of the whole signal; `DataError` where there is none such."""

    def pieces(self, *, rows: int | None = None, overlap: float = 0.0) -> Iterator[Piece]:
        """Yield the pieces in order; no signal has more than `rows` samples of its own in one.

        Their default is what `NUMBERS` allow. `overlap` [s] widens what each piece shows on both
        sides. Raises `LogError` where a number is not finite.
        """


@dataclass(frozen=True, slots=True)
class WholeLog:
    """A log that is in memory as a whole."""

    recording: Recording

    @property
    def head(self) -> Recording:
        """The recording with the first sample of each signal."""
        return mapped(self.recording, lambda signal: signal_rows(signal, 0, min(1, len(signal))))

    def period(self, role: Role, name: str) -> float:
        """Return `Signal.period` [s] of a signal; `DataError` where there is none such."""
        return named(self.recording, role, name).period

    def pieces(self, *, rows: int | None = None, overlap: float = 0.0) -> Iterator[Piece]:
        """Yield the pieces in order, views of the recording, as `Pieces.pieces` has it."""
        signals = [s for role in ROLES for s in getattr(self.recording, role) if len(s)]
        if not signals:
            return
        most = rows or max(1, NUMBERS // sum(len(signal.columns) for signal in signals))
        margin = round(overlap * NANOSECONDS)
        start = min(int(signal.stamps[0]) for signal in signals)
        end = max(int(signal.stamps[-1]) for signal in signals) + 1
        while start < end:
            last = [int(np.searchsorted(s.stamps, start)) + most - 1 for s in signals]
            full = [int(s.stamps[row]) + 1 for s, row in zip(signals, last, strict=True)
                    if row < len(s)]  # fmt: skip
            stop = min(full, default=end)
            yield Piece(cut(self.recording, start - margin, stop + margin), start, stop)
            start = stop


def named(recording: Recording, role: Role, name: str) -> Signal:
    """Return the signal `name` of a role; `DataError` with the near names where there is none."""
    return find(getattr(recording, role), name, f"{role} signal of recording {recording.name!r}")


def cut(recording: Recording, start: int, stop: int) -> Recording:
    """Return the recording with the samples of [start, stop) [ns since the epoch] alone.

    Rows that open a session (`Signal.breaks`) are counted anew; row 0 is one where a session opens
    with the cut.
    """
    return mapped(recording, lambda signal: signal_between(signal, start, stop))


def mapped(recording: Recording, change: Callable[[Signal], Signal]) -> Recording:
    """Return the recording with every signal changed."""

    def signals(role: Role) -> tuple[Signal, ...]:
        return tuple(change(signal) for signal in getattr(recording, role))

    return replace(
        recording,
        joints=signals("joints"),
        channels=signals("channels"),
        temperatures=signals("temperatures"),
        imus=signals("imus"),
    )


def signal_between(signal: Signal, start: int, stop: int) -> Signal:
    """Return the samples of a signal in [start, stop) [ns since the epoch], as a view."""
    begin, end = (int(row) for row in np.searchsorted(signal.stamps, [start, stop]))
    return signal_rows(signal, begin, end)


def signal_rows(signal: Signal, begin: int, end: int | None) -> Signal:
    """Return the rows [begin, end) of a signal, to its end where that is None, as a view."""
    last = len(signal) if end is None else end
    breaks = tuple(row - begin for row in signal.breaks if begin <= row < last)
    return replace(
        signal, stamps=signal.stamps[begin:last], values=signal.values[begin:last], breaks=breaks
    )


def joined(signals: Sequence[Signal]) -> Signal:
    """Return stretches of one signal, put together in their order."""
    starts = accumulate((len(signal) for signal in signals), initial=0)
    return replace(
        signals[0],
        stamps=np.concatenate([signal.stamps for signal in signals]),
        values=np.concatenate([signal.values for signal in signals]),
        breaks=tuple(start + row for signal, start in zip(signals, starts, strict=False)
                     for row in signal.breaks),
    )  # fmt: skip


def span(log: Pieces, start: float, stop: float) -> Recording:
    """Return the samples of a log in [start, stop) seconds since its start, and read no further."""
    first, last = (log.head.start + round(second * NANOSECONDS) for second in (start, stop))
    parts = [cut(log.head, first, first)]
    for piece in log.pieces():
        if piece.start >= last:
            break
        if piece.stop > first:
            parts.append(cut(piece.own, first, last))
    shown = {
        (role, signal.name): joined([named(part, role, signal.name) for part in parts])
        for role in ROLES
        for signal in getattr(log.head, role)
    }

    def signals(role: Role) -> tuple[Signal, ...]:
        return tuple(shown[role, signal.name] for signal in getattr(log.head, role))

    return replace(
        log.head,
        joints=signals("joints"),
        channels=signals("channels"),
        temperatures=signals("temperatures"),
        imus=signals("imus"),
    )


def median_period(
    clock: Callable[[], Iterator[Int[Array, "M"]]], steps: int, longest: int
) -> float:
    """Return the median step [s] between stamps [ns] that come in stretches, NaN of no step.

    Each stretch begins with the last stamp of the one before. Exact in constant memory, by radix:
    each pass over `clock` counts 16 bits of the `steps` steps, the `longest` of which says how many
    passes there are.
    """
    if not steps:
        return float("nan")
    middle = [[(steps - 1) // 2, 0], [steps // 2, 0]]  # rank left within the bits known, bits known
    for shift in range((max(longest.bit_length(), 1) - 1) // 16 * 16, -1, -16):
        counts = np.zeros((2, 1 << 16), dtype=np.int64)
        for stamps in clock():
            digits = np.diff(stamps) >> shift
            for row, (_, known) in enumerate(middle):
                low = digits[digits >> 16 == known] & 0xFFFF
                counts[row] += np.bincount(low, minlength=1 << 16)
        for count, place in zip(counts, middle, strict=True):
            below = np.cumsum(count)
            digit = int(np.searchsorted(below, place[0], side="right"))
            place[:] = place[0] - int(below[digit] - count[digit]), place[1] << 16 | digit
    return (middle[0][1] + middle[1][1]) / 2 / NANOSECONDS
