"""Bags written by other hands than those that read them: bytes by `struct`, files by format."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from mcap_ros2.writer import Writer as Mcap

START = 1_700_000_000_000_000_000
ARRIVAL = 250_000
"""Nanoseconds by which the recorder gets messages late."""

HEADER = "std_msgs/Header header\n"
PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\n"
    "geometry_msgs/Quaternion rotation\n",
    "geometry_msgs/TransformStamped": HEADER
    + "string child_frame_id\ngeometry_msgs/Transform transform\n",
}
TYPES = {
    "sensor_msgs/JointState":
        HEADER + "string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    "geometry_msgs/WrenchStamped": HEADER + "geometry_msgs/Wrench wrench\n",
    "sensor_msgs/Temperature": HEADER + "float64 temperature\nfloat64 variance\n",
    "sensor_msgs/Imu": HEADER + "geometry_msgs/Quaternion orientation\n"
        "float64[9] orientation_covariance\ngeometry_msgs/Vector3 angular_velocity\n"
        "float64[9] angular_velocity_covariance\ngeometry_msgs/Vector3 linear_acceleration\n"
        "float64[9] linear_acceleration_covariance\n",
    "std_msgs/Float64MultiArray": "MultiArrayLayout layout\nfloat64[] data\n" + "=" * 80 +
        "\nMSG: std_msgs/MultiArrayLayout\nMultiArrayDimension[] dim\nuint32 data_offset\n" +
        "=" * 80 + "\nMSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\n"
        "uint32 stride\n",
    "std_msgs/String": "string data\n",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "geometry_msgs/PoseStamped": HEADER + "geometry_msgs/Pose pose\n",
}  # fmt: skip


def definition(kind: str, *, ros1: bool = False) -> str:
    """Return the text of a type and all it is made of."""
    parts = dict(PARTS)
    if ros1:
        parts["std_msgs/Header"] = "uint32 seq\ntime stamp\nstring frame_id\n"
        del parts["builtin_interfaces/Time"]
    texts = [TYPES[kind], *(f"MSG: {name}\n{text}" for name, text in parts.items())]
    return ("=" * 80 + "\n").join(texts)


class Bytes:
    """Packs one message: CDR with padding and a head, or ROS 1 with neither."""

    def __init__(self, *, ros1: bool = False) -> None:
        self.ros1, self.body = ros1, b""

    def pack(self, form: str, *values: object) -> Bytes:
        for value in values:
            if not self.ros1:
                self.body += bytes(-len(self.body) % struct.calcsize(f"<{form}"))
            self.body += struct.pack(f"<{form}", value)
        return self

    def text(self, text: str) -> Bytes:
        raw = text.encode() + (b"" if self.ros1 else b"\0")
        self.pack("I", len(raw)).body += raw
        return self

    def header(self, stamp: int, frame: str = "") -> Bytes:
        if self.ros1:
            self.pack("I", 7)
        return self.pack("I", stamp // 10**9, stamp % 10**9).text(frame)

    def numbers(self, values: Sequence[float]) -> Bytes:
        return self.pack("I", len(values)).pack("d", *values)

    def done(self) -> bytes:
        return self.body if self.ros1 else b"\0\1\0\0" + self.body


def joint_state(
    stamp: int, joints: dict[str, float], *, ros1: bool = False, frame: str = "",
    velocity: Sequence[float] = (),
) -> bytes:  # fmt: skip
    packed = Bytes(ros1=ros1).header(stamp, frame).pack("I", len(joints))
    for name in joints:
        packed.text(name)
    return packed.numbers(list(joints.values())).numbers(velocity).numbers([]).done()


def wrench(stamp: int, values: Sequence[float], *, ros1: bool = False, frame: str = "ft") -> bytes:
    return Bytes(ros1=ros1).header(stamp, frame).pack("d", *values).done()


def temperature(stamp: int, value: float, *, ros1: bool = False) -> bytes:
    return Bytes(ros1=ros1).header(stamp).pack("d", value, 0.0).done()


def imu(
    stamp: int, accel: Sequence[float], gyro: Sequence[float], *, ros1: bool = False,
    known: float = 0.0,
) -> bytes:  # fmt: skip
    nine = (known, *(0.0,) * 8)
    packed = Bytes(ros1=ros1).header(stamp, "imu").pack("d", 0.0, 0.0, 0.0, 1.0, *nine)
    return packed.pack("d", *gyro, *(0.0,) * 9, *accel, *nine).done()


def transforms(*some: tuple[int, str, str, Sequence[float]], ros1: bool = False) -> bytes:
    """Pack stamp, parent, child and quaternion x y z w of each transform."""
    packed = Bytes(ros1=ros1).pack("I", len(some))
    for stamp, parent, child, quaternion in some:
        packed.header(stamp, parent).text(child).pack("d", 0.1, 0.2, 0.3, *quaternion)
    return packed.done()


def pose(stamp: int, quaternion: Sequence[float], *, frame: str = "base_link") -> bytes:
    return Bytes().header(stamp, frame).pack("d", 0.1, 0.2, 0.3, *quaternion).done()


def array(values: Sequence[float], *, ros1: bool = False) -> bytes:
    return Bytes(ros1=ros1).pack("I", 0, 0).numbers(values).done()


Message = tuple[str, str, int, bytes]
"""Topic, type as ROS 1 spells it, time of arrival [ns], bytes."""


def ros2(kind: str) -> str:
    return kind.replace("/", "/msg/")


def write_mcap(path: Path, messages: Iterable[Message], *, definitions: bool = True) -> Path:
    """Write raw messages with the `mcap` library."""
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=2000)
        writer.start(profile="ros2", library="test")
        channels: dict[tuple[str, str], int] = {}
        for topic, kind, arrival, data in messages:
            if (topic, kind) not in channels:
                text = definition(kind).encode() if definitions else b""
                schema = writer.register_schema(ros2(kind), "ros2msg", text)
                channels[topic, kind] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic, kind], arrival, data, arrival)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_mcap_objects(
    path: Path, messages: Iterable[tuple[str, str, int, dict[str, Any]]]
) -> Path:
    """Write messages given as dictionaries with `mcap_ros2`, which packs them itself."""
    with path.open("wb") as stream:
        writer = Mcap(stream)
        schemas: dict[str, Any] = {}
        for topic, kind, arrival, message in messages:
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(ros2(kind), definition(kind))
            writer.write_message(topic, schemas[kind], message, arrival, arrival)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_db3(path: Path, messages: Iterable[Message]) -> Path:
    """Write a sqlite3 bag as ROS 2 Foxy and Humble do: no definitions in it."""
    with sqlite3.connect(path) as base:
        base.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
            " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
        )
        base.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
            " timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
        )
        topics: dict[tuple[str, str], int] = {}
        for topic, kind, arrival, data in messages:
            if (topic, kind) not in topics:
                topics[topic, kind] = len(topics) + 1
                row = (topics[topic, kind], topic, ros2(kind), "cdr", "")
                base.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?)", row)
            sample = (topics[topic, kind], arrival, data)
            base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", sample)
    base.close()
    return path


def write_metadata(folder: Path, files: Sequence[str], storage: str, mode: str = "") -> Path:
    """Write the metadata.yaml of a ROS 2 bag by hand."""
    lines = [
        "rosbag2_bagfile_information:",
        "  version: 5",
        f"  storage_identifier: {storage}",
        f"  compression_format: {'zstd' if mode else chr(34) * 2}",
        f"  compression_mode: {mode or chr(34) * 2}",
        "  relative_file_paths:",
        *(f"    - {name}" for name in files),
    ]
    (folder / "metadata.yaml").write_text("\n".join(lines) + "\n")
    return folder


def write_bag(path: Path, messages: Sequence[Message], *, indexed: bool = True) -> Path:
    """Write a ROS 1 bag, format 2.0, with one chunk."""
    connections: dict[tuple[str, str], int] = {}
    chunk, entries = b"", dict[int, list[tuple[int, int]]]()
    for topic, kind, arrival, data in messages:
        number = connections.setdefault((topic, kind), len(connections))
        if number not in entries:
            chunk += _connection(number, topic, kind)
            entries[number] = []
        entries[number].append((arrival, len(chunk)))
        chunk += _record(data, op=b"\x02", conn=_u32(number), time=_time(arrival))
    head = b"#ROSBAG V2.0\n"
    at = len(head) + 4096
    body = _record(chunk, op=b"\x05", compression=b"none", size=_u32(len(chunk)))
    for number, found in entries.items():
        index = b"".join(_time(arrival) + _u32(offset) for arrival, offset in found)
        body += _record(index, op=b"\x04", ver=_u32(1), conn=_u32(number), count=_u32(len(found)))
    position = at + len(body)
    body += b"".join(_connection(number, *names) for names, number in connections.items())
    counts = b"".join(_u32(number) + _u32(len(found)) for number, found in entries.items())
    arrivals = [arrival for _, _, arrival, _ in messages]
    body += _record(
        counts, op=b"\x06", ver=_u32(1), chunk_pos=struct.pack("<Q", at),
        start_time=_time(min(arrivals)), end_time=_time(max(arrivals)), count=_u32(len(entries)),
    )  # fmt: skip
    fields = {"op": b"\x03", "index_pos": struct.pack("<Q", position if indexed else 0),
              "conn_count": _u32(len(connections)), "chunk_count": _u32(1)}  # fmt: skip
    bare = len(_record(b"", **fields))
    path.write_bytes(head + _record(b" " * (4096 - bare), **fields) + body)
    return path


def _u32(number: int) -> bytes:
    return struct.pack("<I", number)


def _time(stamp: int) -> bytes:
    return struct.pack("<II", stamp // 10**9, stamp % 10**9)


def _fields(**fields: bytes) -> bytes:
    parts = [name.encode() + b"=" + value for name, value in fields.items()]
    return b"".join(_u32(len(part)) + part for part in parts)


def _record(data: bytes, **fields: bytes) -> bytes:
    head = _fields(**fields)
    return _u32(len(head)) + head + _u32(len(data)) + data


def _connection(number: int, topic: str, kind: str) -> bytes:
    data = _fields(
        topic=topic.encode(), type=kind.encode(), md5sum=b"0" * 32,
        message_definition=definition(kind, ros1=True).encode(),
    )  # fmt: skip
    return _record(data, op=b"\x07", conn=_u32(number), topic=topic.encode())
