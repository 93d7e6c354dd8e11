"""An MCAP bag a piece at a time: any file of it may be larger than memory, no chunk of it is.

The first pass looks at every message, so that what a reader must refuse or tell of a topic is known
before the first number is used; it keeps where the chunks of each signal begin. Then chunks are
read again as they are needed; topics that go on at the same rate share them.

Where messages of one signal lie out of the order of arrival, or are packed in several ways, as
where the bag is none of MCAP files, the reader of whole bags has the word.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import LogError
from ftcal.logs import columns, ros, ros_files
from ftcal.logs.columns import Note, Streams
from ftcal.logs.layout import Layout
from ftcal.logs.pieces import NUMBERS
from ftcal.logs.ros_mcap import McapFile
from ftcal.logs.ros_messages import Decoder, Kind, Piece
from ftcal.logs.ros_signals import Key, Seen, renamed
from ftcal.logs.ros_topic import Batch, Topic
from ftcal.logs.streamed import StreamedPieces, repeated
from ftcal.recording import Signal

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

KEPT = 4 * NUMBERS
"""Numbers of chunks that are kept for the next topic that needs them."""

_Place = tuple[int, int]
"""Number of the file, and the byte at which a chunk begins."""


def ros_pieces(path: Path, layout: Layout, *, name: str | None = None) -> StreamedPieces | None:
    """Return the bag `path`, opened, or None where it must be read whole.

    Raises `LogError` as `ros.read` does.
    """
    bag = ros.opened(path)
    if any(file.suffix.lower() != ".mcap" for file in bag.files):
        return None
    files = [McapFile(file, str(file), squeezed=bag.squeezed) for file in bag.files]
    with ThreadPoolExecutor(1) as beside:
        digests = beside.map(
            columns.file_sha256, (*bag.files, *((bag.metadata,) if bag.metadata else ()))
        )
        chunks = _Chunks(path, files, layout)
        groups = _passed_through(chunks)
        if groups is None:
            return None
        counts = Counter[Topic]()
        for one in files:
            counts.update(one.counts)
        faults = tuple(
            f"{file.name}: {fault}"
            for file, one in zip(bag.files, files, strict=True)
            for fault in one.faults
        )
        found, notes = ros.found(path, ros.Content(counts, groups, faults), layout)
        passed = [group for same in groups.values() for group in same.values()]
        sources = [
            StreamedSignal(one.title, group, layout, chunks)
            for one in found for group in passed if group is one.group
        ]  # fmt: skip
        return StreamedPieces.of(
            (*sources, _Told(notes)),
            layout,
            name=name or ros_files.title(path.resolve()),
            source=str(path),
            sha256=columns.digest(digests),
        )


@dataclass(slots=True)
class _Chunks:
    """The chunks of a bag, decoded when they are asked for, the last of them kept."""

    path: Path
    """As the user named the bag."""
    files: list[McapFile]
    layout: Layout
    decoders: dict[Topic, Decoder] = field(default_factory=dict)
    kept: dict[_Place, list[tuple[Topic, Piece]]] = field(default_factory=dict)
    """Those used longest ago first."""
    numbers: int = 0
    """Numbers in them."""

    def wanted(self, topic: Topic) -> bool:
        """Return whether `topic` is read."""
        return ros.kind_of(topic, self.layout) is not None

    def where(self, topic: Topic) -> str:
        """Return what errors call `topic`."""
        return f"{self.path}: topic {topic.name!r}"

    def decoded(self, batches: list[Batch]) -> list[tuple[Topic, Piece]]:
        """Return the messages of one chunk."""
        found = []
        for batch in batches:
            topic = batch.topic
            if topic not in self.decoders and (kind := ros.kind_of(topic, self.layout)):
                self.decoders[topic] = Decoder(topic, kind, self.where(topic))
            found += [(topic, piece) for piece in self.decoders[topic].pieces(batch)]
        return found

    def at(self, place: _Place, topic: Topic, key: Key) -> Piece:
        """Return the messages of one signal in one chunk."""
        chunk = self.kept.pop(place, None)
        if chunk is None:
            number, byte = place
            chunk = self.decoded(self.files[number].section(byte, self.wanted))
            self.numbers += _numbers(chunk)
            while self.kept and self.numbers > KEPT:
                self.numbers -= _numbers(self.kept.pop(next(iter(self.kept))))
        self.kept[place] = chunk
        for other, piece in chunk:
            if (other, piece.key) == (topic, key):
                return piece
        raise LogError(f"{self.where(topic)}: has changed while it was read; read it again")


def _numbers(chunk: list[tuple[Topic, Piece]]) -> int:
    return sum(piece.values.size + 2 * len(piece.stamps) for _, piece in chunk)


@dataclass(slots=True)
class _Passed:
    """The messages of one signal, passed through once."""

    topic: Topic
    key: Key
    seen: Seen
    places: list[_Place] = field(default_factory=list)
    """Chunks that have some of them."""
    arrival: int = -(2**63)
    """Of the last message [ns]."""
    ends: list[tuple[Int[Array, "1"], Float[Array, "1 K"]]] = field(default_factory=list)
    """The first sample and the last."""

    @property
    def names(self) -> tuple[str, ...]:
        """What the first message names the numbers."""
        return self.seen.names

    @property
    def frame(self) -> str:
        """Frame of the header; "" without one."""
        return self.key[0]

    def follows(self, place: _Place, topic: Topic, piece: Piece) -> bool:
        """Return whether `piece` goes on with what was seen, one piece a chunk."""
        return (
            (topic, piece.names) == (self.topic, self.seen.names)
            and self.places[-1:] != [place]
            and (not self.places or piece.values.shape[1] == self.seen.width)
            and int(piece.arrival[0]) >= self.arrival
            and not (np.diff(piece.arrival) < 0).any()
        )

    def see(self, place: _Place, piece: Piece) -> None:
        """Look at the next messages."""
        stamps, values = self.seen.see(piece)
        self.places.append(place)
        self.arrival = int(piece.arrival[-1])
        if len(stamps):
            first = self.ends[:1] or [(stamps[:1].copy(), values[:1].copy())]
            self.ends = [*first, (stamps[-1:].copy(), values[-1:].copy())]

    def signal(self, where: str, title: str, kind: Kind) -> tuple[Signal, list[Note]]:
        """Return the first and the last sample, as `Group.signal` has it."""
        del where, kind  # known from the first message on
        seen = self.seen
        samples, notes = seen.judged(title)
        if not samples:
            return Signal(title, (), np.empty(0, dtype=np.int64), np.empty((0, 0))), notes
        again = repeated(seen.repeats, seen.kept - seen.fresh, seen.kept)
        notes += [replace(note, signal=title) for note in again]
        ends = self.ends[: seen.fresh]  # of one sample both are the same
        stamps, values = (np.concatenate(parts) for parts in zip(*ends, strict=True))
        return Signal(title, seen.titles, stamps, values), notes


def _passed_through(chunks: _Chunks) -> dict[str, dict[Key, _Passed]] | None:
    """Return what all messages say, by topic, or None where they must be read whole."""
    groups: dict[str, dict[Key, _Passed]] = {}
    for number, file in enumerate(chunks.files):
        for byte, batches in file.sections(chunks.wanted):
            for topic, piece in chunks.decoded(batches):
                same, kind = groups.setdefault(topic.name, {}), ros.kind_of(topic, chunks.layout)
                if piece.key not in same and kind:
                    seen = Seen(chunks.where(topic), kind, piece.names)
                    same[piece.key] = _Passed(topic, piece.key, seen)
                if not same[piece.key].follows((number, byte), topic, piece):
                    return None
                same[piece.key].see((number, byte), piece)
    return groups


@dataclass(frozen=True, slots=True)
class StreamedSignal:
    """One signal, its messages passed through; a `Source`."""

    title: str
    passed: _Passed
    layout: Layout
    chunks: _Chunks
    notes: tuple[Note, ...] = ()
    """None: they are told after all signals."""

    @property
    def steps(self) -> int:
        """Steps between stamps that are not repeated."""
        return self.passed.seen.fresh - 1

    @property
    def longest(self) -> int:
        """Longest of them [ns]."""
        return self.passed.seen.longest

    def clock(self) -> Iterator[Int[Array, "M"]]:
        """Yield the stamps without repeated ones; each stretch begins with the last one before."""
        before = np.empty(0, dtype=np.int64)
        for stamps, _ in self._samples():
            yield np.concatenate([before, stamps])
            before = stamps[-1:]

    def streams(self) -> Iterator[Streams]:
        """Yield the signal chunk after chunk."""
        kind, titles = self.passed.seen.kind, self.passed.seen.titles
        for stamps, values in self._samples():
            signal = Signal(self.title, titles, stamps, values)
            found = renamed(self.passed.seen.where, kind, signal, self.layout)
            yield Streams(notes=(), **{kind.role: (found,)})

    def _samples(self) -> Iterator[tuple[Int[Array, "M"], Float[Array, "M K"]]]:
        passed = self.passed
        seen = Seen(passed.seen.where, passed.seen.kind, passed.seen.names)
        for place in passed.places:
            stamps, values = seen.see(self.chunks.at(place, passed.topic, passed.key))
            if len(stamps):
                yield stamps, values


@dataclass(frozen=True, slots=True)
class _Told:
    """What was noticed of a bag: a `Source` of no signal."""

    notes: tuple[Note, ...]
    steps: int = 0
    longest: int = 0

    def clock(self) -> Iterator[Int[Array, "M"]]:
        """Yield nothing."""
        return iter(())

    def streams(self) -> Iterator[Streams]:
        """Yield nothing."""
        return iter(())
