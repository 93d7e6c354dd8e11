"""A recording → one ROS 2 MCAP file that Foxglove, PlotJuggler and `ros2 bag` open.

| signal | message | topic |
|---|---|---|
| joints | `sensor_msgs/JointState`, positions | its name |
| channels `fx … tz` | `geometry_msgs/WrenchStamped` | its name |
| their standard deviations, columns `…_sd` | the same | `<name>/sd` |
| other channels, or fewer `…_sd` | `sensor_msgs/JointState`: names and numbers | as above |
| temperatures, IMUs of six columns | `sensor_msgs/Temperature`, `sensor_msgs/Imu` | its name |

Header, log and publish time are the sample's stamp. Bytes of one message are made by `rosbags`;
the others are copies of it with their numbers put in place, a chunk at once.
"""

from __future__ import annotations

import importlib.util
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from ftcal.errors import OutputError
from ftcal.logs.layout import WRENCH_AXES, Layout
from ftcal.logs.mcap_chunks import ChunkedFile, Messages
from ftcal.logs.ros_layout import ByteLayout, learn
from ftcal.logs.ros_messages import KINDS
from ftcal.recording import NANOSECONDS, Recording, Signal

if TYPE_CHECKING:
    from jaxtyping import Float, Int, UInt8
    from numpy import ndarray as Array

_SD = "_sd"
_JOINTS, _WRENCH = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"
_IMU, _TEMPERATURE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Temperature"

_LAST = 2**31 * NANOSECONDS
"""Stamps count seconds in 32 bits."""


def write(recording: Recording, path: Path) -> Layout:
    """Write `recording` at `path`, whole or not at all; return the layout that reads it back.

    Signals without samples are left out, and so are breaks and findings. Raises `OutputError`.
    """
    with Writer(path) as writer:
        writer.add(recording)
    return writer.layout()


@dataclass(frozen=True, slots=True)
class _Stream:
    """One topic: samples and the message type that carries them."""

    topic: str
    role: str
    """Field of `Recording` that it comes from."""
    kind: str
    columns: tuple[str, ...]
    stamps: Int[Array, "N"]
    values: Float[Array, "N K"]


@dataclass(frozen=True, slots=True)
class _Channel:
    """A topic that has been declared in the file."""

    stream: _Stream
    number: int
    layout: ByteLayout
    """Learnt from a message with zeros for numbers."""


class Writer:
    """Writes one MCAP file piece by piece; a context manager, the file appears when it ends."""

    def __init__(self, path: Path) -> None:
        """Prepare to write `path`; `OutputError` where it cannot be."""
        if any(importlib.util.find_spec(name) is None for name in ("mcap", "rosbags")):
            raise OutputError(f'{path}: writing MCAP needs more; pip install "ftcal[ros]"')
        from rosbags.typesys import Stores, get_typestore

        self._path = Path(path)
        self._store: Any = get_typestore(Stores.ROS2_HUMBLE)
        self._channels: dict[str, _Channel] = {}
        self._schemas: dict[str, int] = {}
        self._firsts: dict[str, int] = {}
        self._start: int | None = None
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._scratch = tempfile.TemporaryDirectory(
                dir=self._path.parent, prefix=f".{self._path.name}."
            )
            self._made = Path(self._scratch.name) / self._path.name
            self._file = self._made.open("wb")
        except OSError as error:
            raise self._refused(error) from error
        self._mcap = ChunkedFile(self._file, profile="ros2", library="ftcal")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        try:
            if kind is None:
                if not self._channels:
                    raise OutputError(f"{self._path}: no sample to write")
                self._mcap.finish()
                self._file.close()
                self._made.replace(self._path)
        except OSError as fault:
            raise self._refused(fault) from fault
        finally:
            self._file.close()
            self._scratch.cleanup()

    def add(self, recording: Recording) -> None:
        """Write the samples of `recording`, which follow those written before.

        Raises `OutputError` where two signals share a name, or one changes its columns.
        """
        streams = [stream for stream in _streams(recording, self._path) if len(stream.stamps)]
        topics = [stream.topic for stream in streams]
        if twice := sorted({topic for topic in topics if topics.count(topic) > 1}):
            raise OutputError(f"{self._path}: two signals are called {twice[0]!r}; rename one")
        if not streams:
            return
        self._start = recording.start if self._start is None else self._start
        channels = [self._channel(stream) for stream in streams]
        stamps = [stream.stamps for stream in streams]
        if min(int(s.min()) for s in stamps) < 0 or max(int(s.max()) for s in stamps) >= _LAST:
            raise OutputError(f"{self._path}: a stamp lies outside the years 1970 to 2038 that ROS"
                              " knows; check the unit of the time")  # fmt: skip
        try:
            self._mcap.add([
                Messages(c.number, s.stamps, len(c.layout.first), partial(_packed, c.layout, s))
                for c, s in zip(channels, streams, strict=True)
            ])  # fmt: skip
        except OSError as error:
            raise self._refused(error) from error

    def layout(self) -> Layout:
        """Return the layout that reads the signals written back as what they were."""
        streams = [channel.stream for channel in self._channels.values()]
        firsts = [topic for topic, first in self._firsts.items() if first == self._start]
        return Layout(
            channels={s.topic: s.columns for s in streams if s.role == "channels"},
            imus={s.topic: s.columns for s in streams if s.kind == _IMU},
            zero=firsts[0] if firsts else None,
        )

    def _channel(self, stream: _Stream) -> _Channel:
        """Return the declaration of the topic of `stream`, made when it is first met."""
        known = self._channels.get(stream.topic)
        if known is None:
            self._firsts[stream.topic] = int(stream.stamps[0])
            known = self._channels[stream.topic] = self._declared(stream)
        elif (known.stream.kind, known.stream.columns) != (stream.kind, stream.columns):
            raise OutputError(f"{self._path}: signal {stream.topic!r} changes its columns; write"
                              " two files")  # fmt: skip
        return known

    def _declared(self, stream: _Stream) -> _Channel:
        kind = stream.kind
        if kind not in self._schemas:
            text, _ = self._store.generate_msgdef(kind, ros_version=2)
            self._schemas[kind] = self._mcap.schema(kind, "ros2msg", text.encode())
        number = self._mcap.channel(stream.topic, "cdr", self._schemas[kind])
        message = bytes(self._store.serialize_cdr(self._zero(kind, stream.columns), kind))
        layout = learn(message, kind, self._store.fielddefs, wire="cdr")
        return _Channel(stream, number, layout)

    def _zero(self, kind: str, columns: tuple[str, ...]) -> Any:
        """Return a message of type `kind` whose numbers are zero."""
        types = self._store.types
        vector, stamp = types["geometry_msgs/msg/Vector3"], types["builtin_interfaces/msg/Time"]
        header = types["std_msgs/msg/Header"](stamp(0, 0), "")
        none, unknown = np.zeros(0), np.zeros(9)
        if kind == _JOINTS:
            return types[kind](header, list(columns), np.zeros(len(columns)), none, none)
        if kind == _WRENCH:
            wrench = types["geometry_msgs/msg/Wrench"](vector(0, 0, 0), vector(0, 0, 0))
            return types[kind](header, wrench)
        if kind == _TEMPERATURE:
            return types[kind](header, 0.0, 0.0)
        nowhere = np.array([-1.0, *unknown[1:]])  # an orientation that is not measured
        turned = types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1)
        return types[kind](
            header, turned, nowhere, vector(0, 0, 0), unknown, vector(0, 0, 0), unknown
        )

    def _refused(self, error: OSError) -> OutputError:
        return OutputError(
            f"{self._path}: cannot be written ({error.strerror or error}); name another place"
        )


def _packed(layout: ByteLayout, stream: _Stream, rows: slice) -> UInt8[Array, "M B"]:
    """Return the messages of some samples, one a row."""
    stamps, values = stream.stamps[rows], stream.values[rows]
    packed = np.tile(np.frombuffer(layout.first, np.uint8), (len(stamps), 1))
    sec, nanosec = np.divmod(stamps, NANOSECONDS)
    numbers = [("header.stamp.sec", sec[:, None]), ("header.stamp.nanosec", nanosec[:, None])]
    paths, done = KINDS[stream.kind].values, 0
    for path in paths:
        count = layout.places[path].count
        numbers.append((path, values[:, done : done + count]))
        done += count
    for path, columns in numbers:
        place = layout.places[path]
        code = np.ascontiguousarray(columns, dtype=place.code).view(np.uint8)
        packed[:, place.offset : place.offset + place.size] = code
    return packed


def _streams(recording: Recording, path: Path) -> Iterator[_Stream]:
    """Return what becomes a topic."""
    for signal in recording.joints:
        yield _stream(signal, "joints", _JOINTS)
    for signal in recording.channels:
        sd = [k for k, column in enumerate(signal.columns) if column.endswith(_SD)]
        plain = [k for k in range(len(signal.columns)) if k not in sd]
        for part, ending, axes in ((plain, "", WRENCH_AXES), (sd, "/sd", _WRENCH_SD)):
            if part:
                columns = tuple(signal.columns[k] for k in part)
                kind = _WRENCH if columns == axes else _JOINTS
                topic = f"{signal.name}{ending}"
                yield _Stream(
                    topic, "channels", kind, columns, signal.stamps, signal.values[:, part]
                )
    for signal in recording.temperatures:
        yield _stream(signal, "temperatures", _TEMPERATURE)
    for signal in recording.imus:
        if len(signal.columns) != 6:
            raise OutputError(f"{path}: {signal.name!r} has {len(signal.columns)} columns; an Imu"
                              " message has acceleration and angular velocity")  # fmt: skip
        yield _stream(signal, "imus", _IMU)


_WRENCH_SD = tuple(f"{axis}{_SD}" for axis in WRENCH_AXES)


def _stream(signal: Signal, role: str, kind: str) -> _Stream:
    return _Stream(signal.name, role, kind, signal.columns, signal.stamps, signal.values)
