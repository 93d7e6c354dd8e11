"""ROS bags, of ROS 1 and ROS 2, with sqlite3 or MCAP inside: topics → signals called like them.

`ros_messages` says which message types are read. Time is that of the header: when the driver
measured, not when the recorder got the message. A topic on which several publishers send different
joints becomes a signal for each set of joints, `<topic>/<first joint>`; one that sensors of
different frames share, a signal for each, `<topic>/<frame>`.

Poses (`tf`, `tf_static`) are no part of a recording, which holds what was measured: the proper
acceleration that a moving contact needs would be a second derivative of them, made by a filter that
belongs to the job (`[signals]`), not to a reader. To weigh a tool, `ros_poses` reads them.
"""

from __future__ import annotations

import importlib.util
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from ftcal.errors import LogError, raise_all, unknown
from ftcal.logs import columns, ros_files
from ftcal.logs.columns import Note, Streams
from ftcal.logs.layout import Layout
from ftcal.logs.pieces import Role
from ftcal.logs.ros_files import SUFFIXES, RosbagsFile, holds
from ftcal.logs.ros_mcap import McapFile
from ftcal.logs.ros_messages import KINDS, ON_REQUEST, Decoder, Kind
from ftcal.logs.ros_signals import Group, Held, Key, named, renamed
from ftcal.logs.ros_topic import Topic, no_foreign_errors
from ftcal.logs.ros_zstd import unfold
from ftcal.recording import Recording, Signal

__all__ = ["SUFFIXES", "Content", "Found", "found", "holds", "kind_of", "opened", "read",
           "readers"]  # fmt: skip

TOLD = 12
"""Topics that a finding lists by name."""


def read(path: Path, layout: Layout, *, name: str | None = None) -> Recording:
    """Return the recording in the bag `path`: a file, or the folder of a ROS 2 bag.

    Units are those of the message types: rad, N, Nm, m/s^2, rad/s, degree Celsius. Topics that are
    not read, that hold nothing, or whose stamps cannot be used throughout, are findings. Raises
    `LogError` where the bag is damaged, the layout names a topic that is not there, header stamps
    are missing or go back, or a number is not finite.
    """
    bag = opened(path)
    try:
        files = (*bag.files, *((bag.metadata,) if bag.metadata else ()))
        with ThreadPoolExecutor(1) as beside:
            digests = beside.map(columns.file_sha256, files)
            content = _content(path, bag, layout)
        sha256 = columns.digest(digests)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from error
    signals, notes = found(path, content, layout)
    roles: dict[Role, list[Signal]] = {}
    for one in signals:
        roles.setdefault(one.kind.role, []).append(one.signal)
    return columns.recording(
        Streams(notes=notes, **{role: tuple(same) for role, same in roles.items()}),
        name=name or ros_files.title(path.resolve()),
        source=str(path),
        zero=layout.zero,
        sha256=sha256,
    )


def opened(path: Path) -> ros_files.Bag:
    """Return the files of the bag `path`; `LogError` where they, or libraries, are missing."""
    if missing := [n for n in ("mcap", "rosbags") if importlib.util.find_spec(n) is None]:
        raise LogError(
            f'{path}: reading bags needs {" and ".join(missing)}; pip install "ftcal[ros]"'
        )
    return ros_files.find(path)


def readers(bag: ros_files.Bag) -> Iterator[tuple[Path, McapFile | RosbagsFile]]:
    """Return what reads each file of a bag, in their order, unpacked where it is packed."""
    for file in bag.files:
        with tempfile.TemporaryDirectory() as scratch:
            plain = file
            if file.suffix.lower() == ".zstd":
                plain = Path(scratch) / file.stem
                with no_foreign_errors(str(file)):
                    unfold(file, plain, str(file))
            reader = McapFile if ros_files.kind_of(file) == ".mcap" else RosbagsFile
            yield file, reader(plain, str(file), squeezed=bag.squeezed)


@dataclass(frozen=True, slots=True)
class Content:
    """What a bag holds."""

    counts: Mapping[Topic, int]
    """Messages of every topic."""
    groups: Mapping[str, Mapping[Key, Group]]
    """Those that are read, by the name of their topic."""
    faults: tuple[str, ...]
    """What is missing from the files."""


@dataclass(frozen=True, slots=True)
class Found:
    """One signal of a bag."""

    signal: Signal
    title: str
    """Its name before the layout gave it another."""
    where: str
    """Its topic, for errors."""
    kind: Kind
    group: Group


def _content(path: Path, bag: ros_files.Bag, layout: Layout) -> Content:
    """Return the decoded messages of all files."""
    counts: Counter[Topic] = Counter()
    faults: list[str] = []
    decoders: dict[Topic, Decoder] = {}
    groups: dict[str, dict[Key, Held]] = {}
    for file, reader in readers(bag):
        for batch in reader.batches(lambda topic: kind_of(topic, layout) is not None):
            topic = batch.topic
            if topic not in decoders and (kind := kind_of(topic, layout)) is not None:
                decoders[topic] = Decoder(topic, kind, f"{path}: topic {topic.name!r}")
            same = groups.setdefault(topic.name, {})
            for piece in decoders[topic].pieces(batch):
                same.setdefault(piece.key, Held()).pieces.append(piece)
        counts.update(reader.counts)
        faults += [f"{file.name}: {fault}" for fault in reader.faults]
    return Content(counts, groups, tuple(faults))


def kind_of(topic: Topic, layout: Layout) -> Kind | None:
    """Return how `topic` is read, or None where it is not."""
    said = {**layout.joints, **layout.imus, **layout.channels}
    if topic.wire not in ("cdr", "ros1") or not said.get(topic.name, ("",)):
        return None
    kind = KINDS.get(topic.kind)
    if topic.name in layout.channels:
        kind = kind or ON_REQUEST.get(topic.kind)
        return replace(kind, role="channels") if kind else None
    return kind


def found(path: Path, content: Content, layout: Layout) -> tuple[list[Found], tuple[Note, ...]]:
    """Return the signals of all topics, and what was noticed."""
    topics: dict[str, list[Topic]] = {}
    for topic in content.counts:
        topics.setdefault(topic.name, []).append(topic)
    signals: list[Found] = []
    told: list[Note] = []
    notes: list[tuple[str, str]] = []
    unread: list[str] = []
    for name, same in topics.items():
        kinds = {topic.kind: kind_of(topic, layout) for topic in same}
        read = [topic for topic in same if kinds[topic.kind] is not None]
        if not read:
            counted = sum(content.counts[topic] for topic in same)
            unread.append(f"{name} ({', '.join(kinds)}, {counted})")
        elif len(kinds) > 1:
            raise LogError(f"{path}: topic {name!r} carries {' and '.join(sorted(kinds))};"
                           " record them under two names")  # fmt: skip
        elif kind := kinds[read[0].kind]:
            where, groups = f"{path}: topic {name!r}", content.groups.get(name, {})
            for title, group in named(where, name, kind, groups, layout):
                signal, noticed = group.signal(where, title, kind)
                told += noticed
                if len(signal):
                    signal = renamed(where, kind, signal, layout)
                    signals.append(Found(signal, title, where, kind, group))
            if not groups:
                notes.append((name, "no message on this topic"))
    _check_names(path, content, {one.signal.name for one in signals}, layout)
    if not signals:
        seen = "; ".join((*content.faults, f"topics: {_some(unread) or 'none'}"))
        raise LogError(f"{path}: no joint, F/T, temperature or inertial sample in it ({seen});"
                       " name those to use as channels")  # fmt: skip
    if unread:
        notes.append((path.name, f"not read: {_some(unread)}"))
    stamps = [one.signal.stamps for one in signals]
    start, stop = (min(int(s[0]) for s in stamps), max(int(s[-1]) for s in stamps) + 1)
    left_out = [Note("empty", signal, start, stop, message) for signal, message in notes]
    cut = [Note("truncated", path.name, stop - 1, stop, fault) for fault in content.faults]
    return signals, (*told, *left_out, *cut)


def _some(titles: Sequence[str]) -> str:
    more = f" and {len(titles) - TOLD} more" if len(titles) > TOLD else ""
    return ", ".join(sorted(titles)[:TOLD]) + more


def _check_names(path: Path, content: Content, signals: set[str], layout: Layout) -> None:
    """Raise `LogError` where the layout names topics that are not there, or are not read."""
    kinds = {topic.name: topic for topic in content.counts}
    said = {**layout.joints, **layout.channels, **layout.imus,
            **{topic: (signal,) for signal, topic in layout.temperatures.items()}}  # fmt: skip
    known = {*kinds, *signals}
    faults = [unknown("topic", name, known) for name in said if name not in known]
    faults += [
        f"topic {name!r} is {kinds[name].kind}, which is not read; leave it out of the job"
        for name, titles in said.items()
        if name in kinds and titles and kind_of(kinds[name], layout) is None
    ]
    raise_all(LogError, str(path), faults)
