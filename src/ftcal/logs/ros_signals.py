"""Messages that carry the same names and frame → one signal that can be believed.

Left out and told: messages without a stamp, messages that say they hold no measurement, repeated
stamps. Refused: numbers that are not finite, header stamps that go back. Whether messages come all
at once or a chunk after another, the same is said of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ftcal.errors import LogError
from ftcal.logs import columns
from ftcal.logs.columns import Note
from ftcal.logs.layout import Layout
from ftcal.logs.ros_messages import JOINTS, Kind, Piece
from ftcal.recording import Signal

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

Key = tuple[str, frozenset[str]]
"""Frame and names: what parts the messages of one topic into signals."""


class Group(Protocol):
    """The messages of one topic that become one signal."""

    @property
    def names(self) -> tuple[str, ...]:
        """What its first message names the numbers."""

    @property
    def frame(self) -> str:
        """Frame of the header; "" without one."""

    def signal(self, where: str, title: str, kind: Kind) -> tuple[Signal, list[Note]]:
        """Return the signal called `title`, without samples where there is none, and notes."""


@dataclass(slots=True)
class _Some:
    """Messages that have something in common."""

    count: int = 0
    first: int = 0
    """Arrival of the first of them [ns]."""
    last: int = 0

    def see(self, arrival: Int[Array, "N"]) -> None:
        if len(arrival):
            self.first = self.first if self.count else int(arrival[0])
            self.last = int(arrival[-1])
            self.count += len(arrival)


@dataclass(slots=True)
class Seen:
    """What has been seen of one signal, in the order of arrival."""

    where: str
    """The topic, for errors."""
    kind: Kind
    names: tuple[str, ...]
    every: _Some = field(default_factory=_Some)
    unstamped: _Some = field(default_factory=_Some)
    withheld: _Some = field(default_factory=_Some)
    width: int = 0
    """Numbers of a message."""
    kept: int = 0
    """Messages that are neither unstamped nor withheld."""
    fresh: int = 0
    """Those that do not repeat a stamp."""
    last: Int[Array, "L"] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    """The last stamp, or none."""
    longest: int = 0
    """Longest step between stamps [ns]."""
    repeats: list[Note] = field(default_factory=list)
    strange: tuple[int, int, float] | None = None
    """Row, column and value of the first number that is not finite."""
    strangers: int = 0
    disorder: LogError | None = None

    def see(self, piece: Piece) -> tuple[Int[Array, "M"], Float[Array, "M K"]]:
        """Return stamps and numbers of the messages that are samples."""
        stamps, values, self.width = piece.stamps, piece.values, piece.values.shape[1]
        self.every.see(piece.arrival)
        unstamped = stamps == 0
        lost = unstamped | piece.withheld
        if lost.any():
            self.unstamped.see(piece.arrival[unstamped])
            self.withheld.see(piece.arrival[piece.withheld])
            stamps, values = stamps[~lost], values[~lost]
        finite = np.isfinite(values)
        if not finite.all():
            row, column = (int(n) for n in np.argwhere(~finite)[0])
            self.strange = self.strange or (self.kept + row, column, float(values[row, column]))
            self.strangers += int(finite.size - finite.sum())
        again = len(self.last)
        clock = np.concatenate([self.last, stamps]) if again else stamps
        signal = Signal("", (), clock, np.empty((len(clock), 0)))
        row, self.kept = self.kept + 1 - again, self.kept + len(stamps)
        try:
            signal, fresh, noted = columns.in_order(signal, self.where, first_row=row)
        except LogError as error:
            self.disorder = self.disorder or error
            return stamps, values
        self.repeats += noted
        self.longest = max(self.longest, int(np.diff(signal.stamps).max(initial=0)))
        self.fresh += int(fresh[again:].sum())
        self.last = clock[-1:]
        if not fresh.all():
            stamps, values = stamps[fresh[again:]], values[fresh[again:]]
        return stamps, values

    @property
    def titles(self) -> tuple[str, ...]:
        """Names of the columns."""
        return self.names or tuple(f"ch{k}" for k in range(self.width))

    def judged(self, title: str) -> tuple[bool, list[Note]]:
        """Return whether there are samples, and what is told of the signal but for repeats.

        Raises `LogError` where they cannot be believed.
        """
        span = self.every.first, self.every.last + 1
        if self.kind.withheld and self.withheld.count == self.every.count:
            told = "its covariance says -1: no acceleration or no angular velocity; left out"
            return False, [Note("empty", title, *span, told)]
        if not self.width:
            return False, [Note("empty", title, *span, "messages without positions; left out")]
        _require_even(self.where, {self.width: self.every.count}, self.names)
        notes = []
        if not self.kind.stamped:
            told = "messages carry no header stamp; the times of their arrival are used"
            notes.append(Note("clock jump", title, *span, told))
        notes += self._left_out(title)
        if self.strange:
            row, column, value = self.strange
            raise columns.not_finite(
                self.where, row + 1, self.titles[column], value, self.strangers
            )
        if self.disorder:
            raise self.disorder
        return True, notes

    def _left_out(self, title: str) -> Iterator[Note]:
        """Return a note for messages without a stamp and one for those without a measurement."""
        count = self.every.count
        if self.unstamped.count == count:
            raise LogError(f"{self.where}: the header stamp of all {count} messages is zero;"
                           " mend its publisher, or give the topic no columns")  # fmt: skip
        told = ("have a header stamp of zero", "say that they hold no measurement (covariance -1)")
        for some, what in zip((self.unstamped, self.withheld), told, strict=True):
            if some.count:
                message = f"{some.count} of {count} messages {what}; left out"
                yield Note("clock jump", title, some.first, some.last + 1, message)


def _require_even(where: str, widths: Mapping[int, int], names: Sequence[str]) -> None:
    """Raise `LogError` where messages differ in their counts of numbers, or from their names."""
    if len(widths) > 1 or (names and set(widths) != {len(names)}):
        counts = ", ".join(f"{count} with {width}" for width, count in widths.items())
        raise LogError(f"{where}: messages with different counts of numbers ({counts};"
                       f" {len(names)} names); mend its publisher")  # fmt: skip


@dataclass(frozen=True, slots=True)
class Held:
    """The messages of one signal, all of them in memory."""

    pieces: list[Piece] = field(default_factory=list)

    @property
    def names(self) -> tuple[str, ...]:
        """What the first message names the numbers."""
        return self.pieces[0].names

    @property
    def frame(self) -> str:
        """Frame of the header; "" without one."""
        return self.pieces[0].frame

    def signal(self, where: str, title: str, kind: Kind) -> tuple[Signal, list[Note]]:
        """Return the samples in the order of arrival, as `Group.signal` has it."""
        names = self.names
        widths = Counter[int]()
        for piece in self.pieces:
            widths[piece.values.shape[1]] += len(piece.stamps)
        if len(widths) > 1:
            _require_even(where, widths, names)
        arrival = _together([piece.arrival for piece in self.pieces])
        order: slice | Int[Array, "N"] = slice(None)  # as a rule they lie in the order of arrival
        if (np.diff(arrival) < 0).any():
            order = np.argsort(arrival, kind="stable")
        values = _together([
            piece.values[:, [piece.names.index(name) for name in names]] if piece.names != names
            else piece.values for piece in self.pieces
        ])  # fmt: skip
        stamps = _together([piece.stamps for piece in self.pieces])
        withheld = _together([piece.withheld for piece in self.pieces])
        seen = Seen(where, kind, names)
        stamps, values = seen.see(
            Piece(names, self.frame, stamps[order], arrival[order], values[order], withheld[order])
        )
        samples, notes = seen.judged(title)
        if not samples:
            return Signal(title, (), stamps[:0], np.empty((0, 0))), notes
        notes += [replace(note, signal=title) for note in seen.repeats]
        return Signal(title, seen.titles, stamps, values), notes


def _together(parts: Sequence[Array]) -> Array:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def named(
    where: str, topic: str, kind: Kind, groups: Mapping[Key, Group], layout: Layout
) -> Iterable[tuple[str, Group]]:
    """Return the groups of a topic with the names of their signals.

    Raises `LogError` where two publishers send one joint, or a name does not say which signal.
    """
    shared = Counter((frame, name) for frame, names in groups for name in names)
    if twice := sorted(name for (_, name), count in shared.items() if count > 1):
        raise LogError(f"{where}: joint {twice[0]!r} comes in messages with different joints;"
                       " record its publishers under two names")  # fmt: skip
    several = len(groups) > 1
    labels = [group.frame or (*group.names, "")[0] for group in groups.values()]
    titles = [f"{topic}/{label}" if several else topic for label in labels]
    if several and topic in {**layout.joints, **layout.channels, **layout.imus}:
        raise LogError(f"{where}: has several publishers; name {', '.join(titles)} instead")
    for title, group in zip(titles, groups.values(), strict=True):
        if kind.names and not group.names and title not in {**layout.joints, **layout.channels}:
            raise LogError(f"{where}: its messages name no joints; name them in the job")
        if len(set(group.names)) < len(group.names):
            raise LogError(f"{where}: a message names a joint twice; mend its publisher")
        yield title, group


def renamed(where: str, kind: Kind, signal: Signal, layout: Layout) -> Signal:
    """Return `signal` with the names that the layout gives to it and its columns."""
    said = {"joints": layout.joints, "channels": layout.channels, "imus": layout.imus}
    if kind.role == JOINTS.role and layout.angle == "deg":
        signal = replace(signal, values=np.radians(signal.values))
    names = said.get(kind.role, {}).get(signal.name)
    given = {there: title for title, there in layout.temperatures.items()}
    if kind.role == "temperatures":
        signal = replace(signal, name=given.get(signal.name, signal.name))
    if names is None:
        return signal
    logged = len(signal.columns)
    if kind.role == JOINTS.role:
        names = (*names, *("",) * (logged - len(names)))
    if len(names) != logged:
        raise LogError(f"{where}: {logged} columns but {len(names)} names in the job"
                       f" ({', '.join(signal.columns)} are logged)")  # fmt: skip
    used = [column for column, title in enumerate(names) if title]
    return replace(
        signal, columns=tuple(names[column] for column in used), values=signal.values[:, used]
    )
