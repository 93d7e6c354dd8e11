"""How fast MCAP is read, against rosbags on the same messages.

    python benchmarks/bags.py --messages 200000 --rounds 5

The file holds as many `WrenchStamped` as `JointState` messages, of seven joints with positions,
velocities and efforts; rosbags decodes every message and its numbers go into one array a topic.
Both give the same numbers, which is checked.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from measure import Benchmark, Record, interleaved
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from ftcal.logs import read

START = 1_700_000_000_000_000_000
JOINTS = tuple(f"panda_joint{k}" for k in range(1, 8))
STATE, WRENCH = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"


def write_mcap(file: Path, messages: int, *, seed: int) -> None:
    """Write half joint states, half wrenches, packed by rosbags, stored by mcap."""
    random = np.random.default_rng(seed)
    store = get_typestore(Stores.ROS2_HUMBLE)
    types: Any = store.types
    vector, time_of = types["geometry_msgs/msg/Vector3"], types["builtin_interfaces/msg/Time"]
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="benchmark")
        channels = {}
        for kind, topic in ((STATE, "/joint_states"), (WRENCH, "/ft")):
            text, _ = store.generate_msgdef(kind, ros_version=2)
            schema = writer.register_schema(kind, "ros2msg", text.encode())
            channels[kind] = writer.register_channel(topic, "cdr", schema)
        for n in range(messages // 2):
            stamp = START + n * 1_000_000
            header = types["std_msgs/msg/Header"](time_of(*divmod(stamp, 10**9)), "base")
            state = types[STATE](header, list(JOINTS), *random.normal(size=(3, 7)))
            six = random.normal(size=6)
            wrench = types["geometry_msgs/msg/Wrench"](vector(*six[:3]), vector(*six[3:]))
            for kind, message in ((STATE, state), (WRENCH, types[WRENCH](header, wrench))):
                packed = bytes(store.serialize_cdr(message, kind))
                writer.add_message(channels[kind], stamp, packed, stamp)
        writer.finish()  # type: ignore[no-untyped-call]


def by_rosbags(file: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return stamps and numbers of each topic as a user of rosbags would."""
    rows: dict[str, list[list[float]]] = {"/joint_states": [], "/ft": []}
    stamps: dict[str, list[int]] = {topic: [] for topic in rows}
    with AnyReader([file]) as reader:
        for connection, _, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            stamps[connection.topic].append(stamp.sec * 10**9 + stamp.nanosec)
            if connection.msgtype == STATE:
                rows[connection.topic].append(message.position)
            else:
                f, t = message.wrench.force, message.wrench.torque
                rows[connection.topic].append([f.x, f.y, f.z, t.x, t.y, t.z])
    return {topic: (np.array(stamps[topic]), np.array(rows[topic])) for topic in rows}


def measure(messages: int, rounds: int) -> list[Record]:
    """Return the ratio, once both give the same numbers."""
    with tempfile.TemporaryDirectory() as temporary:
        file = Path(temporary) / "take.mcap"
        write_mcap(file, messages, seed=0)
        recording, theirs = read(file), by_rosbags(file)
        for signal in (*recording.joints, *recording.channels):
            stamps, values = theirs[signal.name]
            np.testing.assert_array_equal(signal.stamps, stamps)
            np.testing.assert_array_equal(signal.values, values)
        calls: dict[str, Callable[[], object]] = {
            "ftcal": partial(read, file), "rosbags": partial(by_rosbags, file),
        }  # fmt: skip
        times = interleaved(calls, rounds)
    return [
        Record.of("reading MCAP", "rosbags", f"{messages} messages",
                  ours=times["ftcal"], theirs=times["rosbags"])
    ]  # fmt: skip


BENCHMARK = Benchmark(measure, {"messages": 200_000, "rounds": 5}, {"messages": 500, "rounds": 1})

if __name__ == "__main__":
    BENCHMARK.main(__doc__)
