"""ROS bags, of ROS 1 and ROS 2, with sqlite3 or MCAP inside: topics → signals called like them.

`ros_messages` says which message types are read. Time is that of the header: when the driver
measured, not when the recorder got the message. A topic on which several publishers send different
joints becomes a signal for each set of joints, `<topic>/<first joint>`; one that sensors of
different frames share, a signal for each, `<topic>/<frame>`.

Poses (`tf`, `tf_static`) are left out: a recording holds what was measured, and the proper
acceleration that a moving contact needs would be a second derivative of them, made by a filter that
belongs to the job (`[signals]`), not to a reader.
"""

from __future__ import annotations

import importlib.util
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import LogError, raise_all, unknown
from ftcal.logs import columns, ros_files
from ftcal.logs.columns import Note, Streams
from ftcal.logs.layout import Layout
from ftcal.logs.ros_files import SUFFIXES, RosbagsFile, holds
from ftcal.logs.ros_mcap import McapFile
from ftcal.logs.ros_messages import JOINTS, KINDS, ON_REQUEST, Decoder, Kind, Piece
from ftcal.logs.ros_topic import Topic, no_foreign_errors
from ftcal.logs.ros_zstd import unfold
from ftcal.recording import Recording, Signal

if TYPE_CHECKING:
    from jaxtyping import Bool, Int
    from numpy import ndarray as Array

__all__ = ["SUFFIXES", "holds", "read"]

TOLD = 12
"""Topics that a finding lists by name."""


def read(path: Path, layout: Layout, *, name: str | None = None) -> Recording:
    """Return the recording in the bag `path`: a file, or the folder of a ROS 2 bag.

    Units are those of the message types: rad, N, Nm, m/s^2, rad/s, degree Celsius. Topics that are
    not read, that hold nothing, or whose stamps cannot be used throughout, are findings. Raises
    `LogError` where the bag is damaged, the layout names a topic that is not there, header stamps
    are missing or go back, or a number is not finite.
    """
    if missing := [n for n in ("mcap", "rosbags") if importlib.util.find_spec(n) is None]:
        raise LogError(
            f'{path}: reading bags needs {" and ".join(missing)}; pip install "ftcal[ros]"'
        )
    try:
        bag = ros_files.find(path)
        files = (*bag.files, *((bag.metadata,) if bag.metadata else ()))
        with ThreadPoolExecutor(1) as beside:
            digests = beside.map(columns.file_sha256, files)
            content = _content(path, bag, layout)
        sha256 = columns.digest(digests)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from error
    return columns.recording(
        _streams(path, content, layout),
        name=name or ros_files.title(path.resolve()),
        source=str(path),
        zero=layout.zero,
        sha256=sha256,
    )


@dataclass(frozen=True, slots=True)
class _Content:
    """What a bag holds."""

    counts: Mapping[Topic, int]
    """Messages of every topic."""
    pieces: Mapping[Topic, Sequence[Piece]]
    """Those of the topics that are read."""
    faults: tuple[str, ...]
    """What is missing from the files."""


def _content(path: Path, bag: ros_files.Bag, layout: Layout) -> _Content:
    """Return the decoded messages of all files."""
    counts: Counter[Topic] = Counter()
    faults: list[str] = []
    decoders: dict[Topic, Decoder] = {}
    pieces: dict[Topic, list[Piece]] = {}
    for file in bag.files:
        with tempfile.TemporaryDirectory() as scratch:
            plain = file
            if file.suffix.lower() == ".zstd":
                plain = Path(scratch) / file.stem
                with no_foreign_errors(str(file)):
                    unfold(file, plain, str(file))
            reader = McapFile if ros_files.kind_of(file) == ".mcap" else RosbagsFile
            opened = reader(plain, str(file), squeezed=bag.squeezed)
            for batch in opened.batches(lambda topic: _kind(topic, layout) is not None):
                topic = batch.topic
                if topic not in decoders and (kind := _kind(topic, layout)) is not None:
                    decoders[topic] = Decoder(topic, kind, f"{path}: topic {topic.name!r}")
                pieces.setdefault(topic, []).extend(decoders[topic].pieces(batch))
            counts.update(opened.counts)
            faults += [f"{file.name}: {fault}" for fault in opened.faults]
    return _Content(counts, pieces, tuple(faults))


def _kind(topic: Topic, layout: Layout) -> Kind | None:
    """Return how `topic` is read, or None where it is not."""
    said = {**layout.joints, **layout.imus, **layout.channels}
    if topic.wire not in ("cdr", "ros1") or not said.get(topic.name, ("",)):
        return None
    kind = KINDS.get(topic.kind)
    if topic.name in layout.channels:
        kind = kind or ON_REQUEST.get(topic.kind)
        return replace(kind, role="channels") if kind else None
    return kind


def _streams(path: Path, content: _Content, layout: Layout) -> Streams:
    """Return the signals of all topics, and what was noticed."""
    topics: dict[str, list[Topic]] = {}
    for topic in content.counts:
        topics.setdefault(topic.name, []).append(topic)
    parts, notes, unread = [], list[tuple[str, str]](), list[str]()
    for name, same in topics.items():
        kinds = {topic.kind: _kind(topic, layout) for topic in same}
        read = [topic for topic in same if kinds[topic.kind] is not None]
        if not read:
            counted = sum(content.counts[topic] for topic in same)
            unread.append(f"{name} ({', '.join(kinds)}, {counted})")
        elif len(kinds) > 1:
            raise LogError(f"{path}: topic {name!r} carries {' and '.join(sorted(kinds))};"
                           " record them under two names")  # fmt: skip
        elif kind := kinds[read[0].kind]:
            pieces = [piece for topic in read for piece in content.pieces.get(topic, ())]
            signals, noticed = _signals(f"{path}: topic {name!r}", name, kind, pieces, layout)
            parts.append(Streams(notes=noticed, **{kind.role: signals}))
            if not pieces:
                notes.append((name, "no message on this topic"))
    _check_names(path, content, {s.name for part in parts for s in part.signals}, layout)
    if not any(part.signals for part in parts):
        seen = "; ".join((*content.faults, f"topics: {_some(unread) or 'none'}"))
        raise LogError(f"{path}: no joint, F/T, temperature or inertial sample in it ({seen});"
                       " name those to use as channels")  # fmt: skip
    if unread:
        notes.append((path.name, f"not read: {_some(unread)}"))
    stamps = [s.stamps for part in parts for s in part.signals if len(s)]
    start, stop = (min(int(s[0]) for s in stamps), max(int(s[-1]) for s in stamps) + 1)
    left_out = [Note("empty", signal, start, stop, message) for signal, message in notes]
    cut = [Note("truncated", path.name, stop - 1, stop, fault) for fault in content.faults]
    return columns.merge([*parts, Streams(notes=(*left_out, *cut))])


def _some(titles: Sequence[str]) -> str:
    more = f" and {len(titles) - TOLD} more" if len(titles) > TOLD else ""
    return ", ".join(sorted(titles)[:TOLD]) + more


def _check_names(path: Path, content: _Content, signals: set[str], layout: Layout) -> None:
    """Raise `LogError` where the layout names topics that are not there, or are not read."""
    kinds = {topic.name: topic for topic in content.counts}
    said = {**layout.joints, **layout.channels, **layout.imus,
            **{topic: (signal,) for signal, topic in layout.temperatures.items()}}  # fmt: skip
    known = {*kinds, *signals}
    faults = [unknown("topic", name, known) for name in said if name not in known]
    faults += [
        f"topic {name!r} is {kinds[name].kind}, which is not read; leave it out of the job"
        for name, titles in said.items()
        if name in kinds and titles and _kind(kinds[name], layout) is None
    ]
    raise_all(LogError, str(path), faults)


def _signals(
    where: str, topic: str, kind: Kind, pieces: Sequence[Piece], layout: Layout
) -> tuple[tuple[Signal, ...], tuple[Note, ...]]:
    """Return a signal for each frame and set of names that messages of a topic carry, and notes."""
    sets: dict[tuple[str, frozenset[str]], list[Piece]] = {}
    for piece in pieces:
        sets.setdefault((piece.frame, frozenset(piece.names)), []).append(piece)
    shared = Counter((frame, name) for frame, names in sets for name in names)
    if twice := sorted(name for (_, name), count in shared.items() if count > 1):
        raise LogError(f"{where}: joint {twice[0]!r} comes in messages with different joints;"
                       " record its publishers under two names")  # fmt: skip
    labels = [same[0].frame or (*same[0].names, "")[0] for same in sets.values()]
    titles = [f"{topic}/{label}" if len(sets) > 1 else topic for label in labels]
    if len(sets) > 1 and topic in {**layout.joints, **layout.channels, **layout.imus}:
        raise LogError(f"{where}: has several publishers; name {', '.join(titles)} instead")
    signals, notes = [], list[Note]()
    for title, same in zip(titles, sets.values(), strict=True):
        if kind.names and not same[0].names and title not in {**layout.joints, **layout.channels}:
            raise LogError(f"{where}: its messages name no joints; name them in the job")
        signal, noticed = _signal(where, title, kind, same)
        notes += noticed
        if len(signal):
            signals.append(_renamed(where, kind, signal, layout))
    return tuple(signals), tuple(notes)


def _signal(
    where: str, title: str, kind: Kind, pieces: Sequence[Piece]
) -> tuple[Signal, list[Note]]:
    """Return the samples of messages that carry the same names, in the order of arrival."""
    names = pieces[0].names
    if len(set(names)) < len(names):
        raise LogError(f"{where}: a message names a joint twice; mend its publisher")
    arrival = np.concatenate([piece.arrival for piece in pieces])
    order: slice | Int[Array, "N"] = slice(None)  # as a rule they lie in the order of arrival
    if (np.diff(arrival) < 0).any():
        order = np.argsort(arrival, kind="stable")
    stamps = np.concatenate([piece.stamps for piece in pieces])[order]
    withheld = np.concatenate([piece.withheld for piece in pieces])[order]
    span = (int(arrival.min()), int(arrival.max()) + 1)
    widths = Counter[int]()
    for piece in pieces:
        widths[piece.values.shape[1]] += len(piece.stamps)
    empty = Signal(title, (), stamps[:0], np.empty((0, 0)))
    if withheld.all() and kind.withheld:
        told = "its covariance says -1: no acceleration or no angular velocity; left out"
        return empty, [Note("empty", title, *span, told)]
    if set(widths) == {0}:
        return empty, [Note("empty", title, *span, "messages without positions; left out")]
    if len(widths) > 1 or (names and set(widths) != {len(names)}):
        counts = ", ".join(f"{count} with {width}" for width, count in widths.items())
        raise LogError(f"{where}: messages with different counts of numbers ({counts};"
                       f" {len(names)} names); mend its publisher")  # fmt: skip
    values = np.concatenate([
        piece.values[:, [piece.names.index(name) for name in names]] if piece.names != names
        else piece.values for piece in pieces
    ])[order]  # fmt: skip
    notes = []
    if not kind.stamped:
        told = "messages carry no header stamp; the times of their arrival are used"
        notes.append(Note("clock jump", title, *span, told))
    lost = (stamps == 0) | withheld
    if lost.any():
        notes += _lost(where, title, stamps == 0, withheld, arrival[order])
        stamps, values = stamps[~lost], values[~lost]
    signal = Signal(title, names or tuple(f"ch{k}" for k in range(values.shape[1])), stamps, values)
    columns.require_finite(values, signal.columns, where, first_row=1)
    signal, _, repeated = columns.in_order(signal, where, first_row=1)
    return signal, [*notes, *repeated]


def _lost(
    where: str,
    title: str,
    unstamped: Bool[Array, "N"],
    withheld: Bool[Array, "N"],
    arrival: Int[Array, "N"],
) -> Iterable[Note]:
    """Return a note for messages without a stamp and one for those without a measurement."""
    if unstamped.all():
        raise LogError(f"{where}: the header stamp of all {len(unstamped)} messages is zero;"
                       " mend its publisher, or give the topic no columns")  # fmt: skip
    told = ("have a header stamp of zero", "say that they hold no measurement (covariance -1)")
    for rows, what in zip((unstamped, withheld), told, strict=True):
        if rows.any():
            first, last = np.flatnonzero(rows)[[0, -1]]
            message = f"{rows.sum()} of {len(rows)} messages {what}; left out"
            yield Note("clock jump", title, int(arrival[first]), int(arrival[last]) + 1, message)


def _renamed(where: str, kind: Kind, signal: Signal, layout: Layout) -> Signal:
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
