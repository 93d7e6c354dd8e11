"""Orientations and wrenches of a bag: `tf`, `tf_static`, poses, and wrist sensors.

| type | becomes |
|---|---|
| `tf2_msgs/TFMessage` | how each child frame turned in its parent; a topic `tf_static` is fixed |
| `geometry_msgs/PoseStamped` | how something turned in the frame of the header |
| `geometry_msgs/WrenchStamped` | as `ros` reads it |

Time is that of each header. Messages are not judged here but for their bytes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ftcal.errors import LogError
from ftcal.logs import ros
from ftcal.logs.layout import PLAIN
from ftcal.logs.ros_layout import ByteLayout, UnfitError, learn
from ftcal.logs.ros_messages import FORMS, Decoder, Kind
from ftcal.logs.ros_signals import Held, Key
from ftcal.logs.ros_topic import Batch, Topic, definitions, no_foreign_errors, typestore
from ftcal.recording import NANOSECONDS, Signal

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

QUATERNION = ("x", "y", "z", "w")
"""The order of the numbers in a message."""

WRENCH = "geometry_msgs/msg/WrenchStamped"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = frozenset({"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"})
"""Of ROS 2 and ROS 1; of ROS 1 before 2013."""

_POSE = Kind("joints", tuple(f"pose.orientation.{axis}" for axis in QUATERNION), QUATERNION)


@dataclass(frozen=True, slots=True)
class Orientations:
    """Orientations of one frame in another, in the order of arrival."""

    topic: str
    parent: str
    child: str
    """"" of a pose: messages do not say whose it is."""
    quaternions: Signal
    """Quaternion x y z w as logged; stamps as logged, which may repeat or go back."""

    @property
    def fixed(self) -> bool:
        """Whether the topic says what never changes."""
        return self.topic.rpartition("/")[2] == "tf_static"


@dataclass(frozen=True, slots=True)
class PoseBag:
    """What a bag says of wrists."""

    wrenches: tuple[tuple[Signal, str], ...]
    """Six-axis signals, each with the frame of its header."""
    transforms: tuple[Orientations, ...]
    poses: tuple[Orientations, ...]
    notes: tuple[str, ...]
    """What was noticed of wrenches."""


def read_pose_bag(path: Path) -> PoseBag:
    """Return orientations and wrenches of the bag at `path`.

    Raises `LogError` as `ros.read` does, of these topics alone.
    """
    bag = ros.opened(path)
    counts: Counter[Topic] = Counter()
    faults: list[str] = []
    decoders: dict[Topic, Decoder] = {}
    listeners: dict[Topic, Listener] = {}
    wrenches: dict[str, dict[Key, Held]] = {}
    poses: dict[tuple[str, str], list[_Some]] = {}
    try:
        for file, reader in ros.readers(bag):
            for batch in reader.batches(_wanted):
                topic = batch.topic
                where = f"{path}: topic {topic.name!r}"
                if topic.kind in TRANSFORMS:
                    if topic not in listeners:
                        listeners[topic] = Listener(topic, where)
                    listeners[topic].hear(batch)
                    continue
                if topic not in decoders:
                    kind = ros.kind_of(topic, PLAIN) or _POSE
                    decoders[topic] = Decoder(topic, kind, where)
                for piece in decoders[topic].pieces(batch):
                    if topic.kind == WRENCH:
                        same = wrenches.setdefault(topic.name, {})
                        same.setdefault(piece.key, Held()).pieces.append(piece)
                    else:
                        pose = poses.setdefault((topic.name, piece.frame), [])
                        pose.append((piece.arrival, piece.stamps, piece.values))
            counts.update({t: n for t, n in reader.counts.items() if t.kind == WRENCH})
            faults += [f"{file.name}: {fault}" for fault in reader.faults]
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from error
    if not wrenches:
        raise LogError(f"{path}: no WrenchStamped message in it; record the wrist's sensor")
    found, notes = ros.found(path, ros.Content(counts, wrenches, tuple(faults)), PLAIN)
    transforms: dict[tuple[str, str, str], list[_Some]] = {}
    for topic, listener in listeners.items():
        for (parent, child), parts in listener.heard.items():
            transforms.setdefault((topic.name, parent, child), []).extend(parts)
    return PoseBag(
        tuple((one.signal, _plain(one.group.frame)) for one in found),
        tuple(
            Orientations(topic, parent, child, _together(f"{parent} -> {child}", parts))
            for (topic, parent, child), parts in transforms.items()
        ),
        tuple(
            Orientations(topic, _plain(frame), "", _together(topic, parts))
            for (topic, frame), parts in poses.items()
        ),
        tuple(f"{note.signal}: {note.message}" for note in notes),
    )


_Some = tuple["Int[Array, 'N']", "Int[Array, 'N']", "Float[Array, 'N 4']"]
"""Arrival [ns], stamps [ns] and quaternions."""


def _wanted(topic: Topic) -> bool:
    return topic.wire in ("cdr", "ros1") and topic.kind in {WRENCH, POSE, *TRANSFORMS}


def _plain(frame: str) -> str:
    """Return a frame's name without the slash that ROS 1 put before it."""
    return frame.removeprefix("/")


def _together(name: str, parts: list[_Some]) -> Signal:
    arrival, stamps, values = (np.concatenate(same) for same in zip(*parts, strict=True))
    order = np.argsort(arrival, kind="stable")
    return Signal(name, QUATERNION, stamps[order], values[order])


@dataclass(slots=True)
class Listener:
    """Hears the transforms of one topic; a message carries some of them, by turns others."""

    topic: Topic
    where: str
    heard: dict[tuple[str, str], list[_Some]] = field(default_factory=dict)
    """By parent and child."""
    layouts: list[ByteLayout] = field(default_factory=list)

    def hear(self, batch: Batch) -> None:
        """Add what messages say; `LogError` where they are not what their type says."""
        with no_foreign_errors(f"{self.where}: a message"):
            known = definitions(self.topic)
            rows = np.arange(len(batch))
            for number in range(FORMS):
                if not len(rows):
                    return
                if number == len(self.layouts):
                    try:
                        first, kind = batch.message(int(rows[0])), self.topic.kind
                        self.layouts.append(learn(first, kind, known, wire=self.topic.wire))
                    except UnfitError:
                        break
                rows = self._take(batch, rows, self.layouts[number])
            self.one_by_one(batch, rows)

    def _take(self, batch: Batch, rows: Int[Array, "M"], layout: ByteLayout) -> Int[Array, "L"]:
        """Add the transforms of the messages packed as `layout` says; return the other rows."""
        alike = batch.lengths[rows] == len(layout.first)
        alike[alike] = layout.agrees(batch.buffer, batch.starts[rows[alike]])
        starts = batch.starts[rows[alike]]
        count = sum(path.endswith(".child_frame_id") for path in layout.texts)
        for number in range(count if len(starts) else 0):
            one = f"transforms.{number}"
            sec, nanosec = (
                layout.read(batch.buffer, starts, f"{one}.header.stamp.{part}")[:, 0]
                for part in ("sec", "nanosec")
            )
            stamps = sec.astype(np.int64) * NANOSECONDS + nanosec
            paths = [f"{one}.transform.rotation.{axis}" for axis in QUATERNION]
            parent, child = (layout.texts[f"{one}.{part}"] for part in _FRAMES)
            values = layout.table(batch.buffer, starts, paths)
            self._add(parent, child, (batch.arrival[rows[alike]], stamps, values))
        others: Int[Array, "L"] = rows[~alike]
        return others

    def one_by_one(self, batch: Batch, rows: Int[Array, "M"]) -> None:
        """Add what messages say that are packed in too many ways, each decoded by `rosbags`."""
        if not len(rows):
            return
        store = typestore(definitions(self.topic))
        unpack = cast(
            "Callable[[bytes, str], Any]",
            store.deserialize_cdr if self.topic.wire == "cdr" else store.deserialize_ros1,
        )
        for row in rows.tolist():
            for one in unpack(batch.message(row), self.topic.kind).transforms:
                stamp, q = one.header.stamp, one.transform.rotation
                stamps = np.array([int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)])
                values = np.array([[q.x, q.y, q.z, q.w]], dtype=np.float64)
                some = batch.arrival[row : row + 1], stamps, values
                self._add(one.header.frame_id, one.child_frame_id, some)

    def _add(self, parent: str, child: str, some: _Some) -> None:
        self.heard.setdefault((_plain(parent), _plain(child)), []).append(some)


_FRAMES = ("header.frame_id", "child_frame_id")
