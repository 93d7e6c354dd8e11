"""How fast MCAP is read and written, as ratios to what rosbags needs for the same messages.

Ratios of medians over interleaved rounds of one run. The file holds as many `WrenchStamped` as
`JointState` messages, of seven joints with positions, velocities and efforts; rosbags decodes every
message and its numbers go into one array a topic. Both give the same numbers, which is checked.
`python benchmarks/bags.py --messages 200000 --rounds 5`
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from mcap.writer import Writer
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


def timed(run: Callable[[], object]) -> tuple[float, float]:
    """Return the seconds that `run` takes, on the clock and of the processor."""
    wall, cpu = time.perf_counter(), time.process_time()
    run()
    return time.perf_counter() - wall, time.process_time() - cpu


def main(arguments: Sequence[str] | None = None) -> dict[str, float]:
    """Print and return how many times as long as ftcal rosbags needs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=200_000)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as temporary:
        file = Path(temporary) / "take.mcap"
        write_mcap(file, options.messages, seed=0)
        recording, theirs = read(file), by_rosbags(file)
        for signal in (*recording.joints, *recording.channels):
            stamps, values = theirs[signal.name]
            np.testing.assert_array_equal(signal.stamps, stamps)
            np.testing.assert_array_equal(signal.values, values)
        spent = [
            (timed(lambda: read(file)), timed(lambda: by_rosbags(file)))
            for _ in range(options.rounds)
        ]
    ratios = {}
    print(f"{options.messages} messages{'ftcal ms':>16}{'rosbags ms':>14}{'ratio':>8}")
    for k, clock in enumerate(("wall", "processor")):
        a, b = (median(pair[side][k] for pair in spent) for side in (0, 1))
        ratios[clock] = b / a
        print(f"{clock:16}{a * 1e3:16.1f}{b * 1e3:14.1f}{b / a:8.1f}")
    return ratios


if __name__ == "__main__":
    main()
