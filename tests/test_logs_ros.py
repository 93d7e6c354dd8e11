"""Facts about the reader of ROS bags and the writer of MCAP files."""

from __future__ import annotations

import hashlib
import re
import resource
import runpy
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ftcal.config import RecordingSection, read_toml
from ftcal.errors import FtcalError, LogError, OutputError
from ftcal.logs import Layout, mcap_writer, read, ros
from ftcal.logs.layout import WRENCH_AXES
from ftcal.logs.ros_messages import IMU_AXES, KINDS, Decoder, Piece
from ftcal.logs.ros_topic import Topic, batch
from ftcal.recording import Recording, Signal
from ros_bags import (
    ARRIVAL,
    START,
    Bytes,
    Message,
    array,
    definition,
    imu,
    joint_state,
    ros2,
    temperature,
    wrench,
    write_bag,
    write_db3,
    write_mcap,
    write_mcap_objects,
    write_metadata,
)

JOINTS, WRENCH = "sensor_msgs/JointState", "geometry_msgs/WrenchStamped"
IMU, HEAT = "sensor_msgs/Imu", "sensor_msgs/Temperature"
ARRAY, TEXT = "std_msgs/Float64MultiArray", "std_msgs/String"
STEP = 10_000_000


def robot(*, ros1: bool = False, rows: int = 5) -> list[Message]:
    """Return what a robot with one leg logs; forces come at twice the rate of joints."""
    out: list[Message] = []
    for n in range(rows):
        t = START + n * STEP
        q = {"knee": 0.1 * n, "ankle": -0.2 * n}
        out.append(("/joint_states", JOINTS, t + ARRIVAL, joint_state(t, q, ros1=ros1)))
        for half in (0, STEP // 2):
            f = wrench(t + half, [n, 1.5, -2, 0.25, half / STEP, 6], ros1=ros1)
            out.append(("/leg/ft", WRENCH, t + half + ARRIVAL, f))
        out.append(("/imu", IMU, t + ARRIVAL, imu(t, [n, 0, 9.8], [0, n, 0.1], ros1=ros1)))
        out.append(("/heat", HEAT, t + ARRIVAL, temperature(t, 40 + n, ros1=ros1)))
    return out


def mcap(path: Path) -> Path:
    return write_mcap(path / "take.mcap", robot())


def db3(path: Path) -> Path:
    return write_db3(path / "take.db3", robot())


def bag(path: Path) -> Path:
    return write_bag(path / "take.bag", robot(ros1=True))


def folder(storage: str, mode: str = "") -> Callable[[Path], Path]:
    """Return what writes a ROS 2 bag in two files, with metadata."""

    def write(path: Path) -> Path:
        home = path / "take"
        home.mkdir()
        half = len(robot()) // 2
        names = []
        for k, part in enumerate((robot()[:half], robot()[half:])):
            messages = part
            if mode == "message":
                messages = [(*m[:3], zstandard.compress(m[3])) for m in messages]
            suffix = {"sqlite3": ".db3", "mcap": ".mcap"}[storage]
            file = home / f"take_{k}{suffix}"
            (write_db3 if storage == "sqlite3" else write_mcap)(file, messages)
            if mode == "file":
                (home / f"{file.name}.zstd").write_bytes(zstandard.compress(file.read_bytes()))
                file.unlink()
                file = home / f"{file.name}.zstd"
            names.append(file.name)
        return write_metadata(home, names, storage, mode)

    return write


FORMS = {
    "mcap": mcap, "db3": db3, "bag": bag, "mcap folder": folder("mcap"),
    "db3 folder": folder("sqlite3"), "db3 zstd": folder("sqlite3", "file"),
    "mcap zstd": folder("mcap", "file"), "db3 zstd messages": folder("sqlite3", "message"),
    "mcap zstd messages": folder("mcap", "message"),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_every_container_gives_the_same_recording(tmp_path: Path, form: str) -> None:
    recording = read(FORMS[form](tmp_path))
    (joints,), (force,) = recording.joints, recording.channels
    (heat,), (unit,) = recording.temperatures, recording.imus
    n = np.arange(5)
    assert (recording.name, recording.start, recording.findings) == ("take", START, ())
    assert (joints.name, joints.columns) == ("/joint_states", ("knee", "ankle"))
    np.testing.assert_array_equal(joints.values, np.column_stack([0.1 * n, -0.2 * n]))
    np.testing.assert_array_equal(joints.stamps, START + n * STEP)
    assert (force.name, force.columns, len(force)) == ("/leg/ft", WRENCH_AXES, 10)
    assert force.values[3].tolist() == [1, 1.5, -2, 0.25, 0.5, 6]
    assert (unit.name, unit.columns) == ("/imu", IMU_AXES)
    assert unit.values[2].tolist() == [2, 0, 9.8, 0, 2, 0.1]
    assert (heat.columns, heat.values[:, 0].tolist()) == (("temperature",), [40, 41, 42, 43, 44])


def test_messages_of_mcap_ros2_are_read(tmp_path: Path) -> None:
    stamp = {"sec": START // 10**9, "nanosec": 17}
    state = {"header": {"stamp": stamp, "frame_id": ""}, "name": ["knee"], "position": [0.25],
             "velocity": [1.0], "effort": []}  # fmt: skip
    file = write_mcap_objects(tmp_path / "a.mcap", [("/j", JOINTS, START, state)])
    (joints,) = read(file).joints
    assert (joints.columns, joints.values.tolist()) == (("knee",), [[0.25]])
    assert joints.stamps.tolist() == [START + 17]


def test_digest_is_of_all_files(tmp_path: Path) -> None:
    home = folder("mcap")(tmp_path)
    total = hashlib.sha256()
    for name in ("take_0.mcap", "take_1.mcap", "metadata.yaml"):
        total.update(hashlib.sha256((home / name).read_bytes()).digest())
    assert read(home).digest == total.hexdigest()


def test_files_of_a_recorder_that_did_not_end_are_read_in_the_order_of_their_numbers(
    tmp_path: Path,
) -> None:
    for k in (10, 9):
        messages = [("/t", HEAT, START + k, temperature(START + k, k))]
        write_mcap(tmp_path / f"take_{k}.mcap", messages)
    assert read(tmp_path).temperatures[0].values[:, 0].tolist() == [9, 10]


def test_bags_of_two_kinds_in_one_folder_are_refused(tmp_path: Path) -> None:
    mcap(tmp_path)
    db3(tmp_path)
    with pytest.raises(LogError, match=r"bags of 2 kinds \.db3 \.mcap"):
        read(tmp_path)


def states(*rows: tuple[int, dict[str, float]]) -> list[Message]:
    """Return joint states at the given steps."""
    return [("/j", JOINTS, START + n * STEP + ARRIVAL, joint_state(START + n * STEP, q))
            for n, q in rows]  # fmt: skip


def test_names_in_another_order_are_mapped(tmp_path: Path) -> None:
    rows = states((0, {"a": 1, "b": 2}), (1, {"b": 3, "a": 4}), (2, {"a": 5, "b": 6}))
    (joints,) = read(write_mcap(tmp_path / "a.mcap", rows)).joints
    assert (joints.columns, joints.values.tolist()) == (("a", "b"), [[1, 2], [4, 3], [5, 6]])


def test_two_publishers_of_one_topic_become_two_signals(tmp_path: Path) -> None:
    rows = states((0, {"a": 1, "b": 2}), (0, {"c": 7}), (1, {"a": 3, "b": 4}), (1, {"c": 8}))
    arm, hand = read(write_mcap(tmp_path / "a.mcap", rows)).joints
    assert (arm.name, arm.values.tolist()) == ("/j/a", [[1, 2], [3, 4]])
    assert (hand.name, hand.columns, hand.values.tolist()) == ("/j/c", ("c",), [[7], [8]])


def test_joint_of_two_publishers_is_refused(tmp_path: Path) -> None:
    rows = states((0, {"a": 1, "b": 2}), (1, {"b": 7}))
    with pytest.raises(LogError, match="joint 'b' comes in messages with different joints"):
        read(write_mcap(tmp_path / "a.mcap", rows))


def test_layout_renames_and_leaves_out(tmp_path: Path) -> None:
    layout = Layout(
        joints={"/joint_states": ("", "l_ankle")}, imus={"/imu": ()}, angle="deg",
        channels={"/leg/ft": tuple("abcdef")}, temperatures={"leg": "/heat"},
    )  # fmt: skip
    recording = read(mcap(tmp_path), layout)
    assert recording.joints[0].columns == ("l_ankle",)
    np.testing.assert_allclose(recording.joints[0].values[4], np.radians(-0.8), rtol=1e-15)
    assert recording.channels[0].columns == tuple("abcdef")
    assert recording.temperature("leg").values[0, 0] == 40
    assert not recording.imus
    assert [f.message for f in recording.findings] == [f"not read: /imu ({ros2(IMU)}, 5)"]


@pytest.mark.parametrize(
    ("layout", "message"),
    [
        (Layout(joints={"/joint_state": ("a",)}), "no topic '/joint_state'; did you mean"),
        (Layout(channels={"/leg/ft": ("a",)}), "6 columns but 1 names"),
        (Layout(joints={"/joint_states": ("a", "b", "c")}), "2 columns but 3 names"),
        (Layout(temperatures={"t": "/cold"}), "no topic '/cold'"),
    ],
)
def test_layout_that_does_not_fit_is_refused(tmp_path: Path, layout: Layout, message: str) -> None:
    with pytest.raises(LogError, match=message):
        read(mcap(tmp_path), layout)


def test_raw_channels_are_read_where_named_with_the_times_of_arrival(tmp_path: Path) -> None:
    rows = [("/raw", ARRAY, START + n, array([n, 2, 3, 4, 5, 6, 7, 8])) for n in range(3)]
    file = write_mcap(
        tmp_path / "a.mcap", [*rows, ("/j", JOINTS, START, joint_state(START, {"a": 1}))]
    )
    names = tuple(f"c{k}" for k in range(8))
    recording = read(file, Layout(channels={"/raw": names}))
    (raw,) = recording.channels
    assert (raw.columns, raw.values[2, 0]) == (names, 2.0)
    assert raw.stamps.tolist() == [START, START + 1, START + 2]
    assert "the times of their arrival are used" in recording.findings[0].message
    assert "not read: /raw" in read(file).findings[0].message


def test_joint_state_can_carry_raw_channels(tmp_path: Path) -> None:
    recording = read(mcap(tmp_path), Layout(channels={"/joint_states": ("x", "y")}))
    assert [signal.columns for signal in recording.channels] == [("x", "y"), WRENCH_AXES]
    assert not recording.joints


def test_unknown_types_are_a_finding(tmp_path: Path) -> None:
    text = ("/rosout", TEXT, START, Bytes().text("hello").done())
    alien = ("/x", TEXT, START, b"not a message")
    recording = read(write_mcap(tmp_path / "a.mcap", [*robot(), text, alien]))
    (finding,) = recording.findings
    assert finding.kind == "empty"
    assert finding.message == f"not read: /rosout ({ros2(TEXT)}, 1), /x ({ros2(TEXT)}, 1)"


def test_topic_without_messages_is_a_finding(tmp_path: Path) -> None:
    from mcap.writer import Writer

    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        schema = writer.register_schema(ros2(HEAT), "ros2msg", definition(HEAT).encode())
        for name in ("/t", "/silent"):
            channel = writer.register_channel(name, "cdr", schema)
            if name == "/t":
                writer.add_message(channel, START, temperature(START, 1), START)
        writer.finish()  # type: ignore[no-untyped-call]
    (finding,) = read(tmp_path / "a.mcap").findings
    assert (finding.signal, finding.message) == ("/silent", "no message on this topic")


def test_bag_of_unknown_types_alone_is_refused(tmp_path: Path) -> None:
    text = ("/rosout", TEXT, START, Bytes().text("hello").done())
    with pytest.raises(LogError, match=r"no joint, F/T.*topics: /rosout"):
        read(write_mcap(tmp_path / "a.mcap", [text]))


@pytest.mark.parametrize("write", [write_mcap, write_db3])
def test_topic_of_two_types_is_refused(
    tmp_path: Path, write: Callable[[Path, list[Message]], Path]
) -> None:
    twice = [
        ("/x", HEAT, START, temperature(START, 1)),
        ("/x", WRENCH, START, wrench(START, [0] * 6)),
    ]
    suffix = ".mcap" if write is write_mcap else ".db3"
    with pytest.raises(LogError, match="'/x' carries geometry_msgs/msg/WrenchStamped and sensor"):
        read(write(tmp_path / f"a{suffix}", twice))


def heat(*stamps: int, values: Sequence[float] = ()) -> list[Message]:
    """Return temperatures that arrive in this order, whatever their stamps."""
    return [("/t", HEAT, START + n, temperature(stamp, values[n] if values else n))
            for n, stamp in enumerate(stamps)]  # fmt: skip


def test_clock_that_jumps_back_is_refused(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "a.mcap", heat(START, START + STEP, START))
    with pytest.raises(LogError, match=r"topic '/t', row 3: time goes back by 0\.010000 s"):
        read(file)


def test_repeated_stamps_are_left_out_and_told(tmp_path: Path) -> None:
    recording = read(write_mcap(tmp_path / "a.mcap", heat(START, START, START + 1)))
    assert recording.temperatures[0].values[:, 0].tolist() == [0, 2]
    assert recording.findings[0].kind == "duplicate stamps"


def test_zero_stamps_are_left_out_and_told(tmp_path: Path) -> None:
    recording = read(write_mcap(tmp_path / "a.mcap", heat(0, START, START + 1)))
    assert recording.temperatures[0].stamps.tolist() == [START, START + 1]
    (finding,) = recording.findings
    assert finding.message == "1 of 3 messages have a header stamp of zero; left out"


def test_topic_without_any_stamp_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="the header stamp of all 2 messages is zero"):
        read(write_mcap(tmp_path / "a.mcap", heat(0, 0)))


def test_nan_is_refused_by_name(tmp_path: Path) -> None:
    rows = heat(START, START + 1, values=[1.0, float("nan")])
    with pytest.raises(LogError, match="topic '/t', row 2: column 'temperature' is nan"):
        read(write_mcap(tmp_path / "a.mcap", rows))


def test_imu_without_acceleration_is_told(tmp_path: Path) -> None:
    none = ("/imu", IMU, START, imu(START, [0, 0, 0], [0, 0, 0], known=-1.0))
    recording = read(write_mcap(tmp_path / "a.mcap", [none, *heat(START)]))
    assert not recording.imus
    assert "covariance says -1" in recording.findings[0].message


def test_joint_states_without_positions_are_told(tmp_path: Path) -> None:
    packed = Bytes().header(START).pack("I", 1).text("a").numbers([]).numbers([1.0]).numbers([])
    rows = [("/j", JOINTS, START, packed.done()), *heat(START)]
    recording = read(write_mcap(tmp_path / "a.mcap", rows))
    assert not recording.joints
    assert "without positions" in recording.findings[0].message


def test_names_and_positions_of_different_count_are_refused(tmp_path: Path) -> None:
    packed = Bytes().header(START).pack("I", 1).text("a").numbers([1.0, 2.0]).numbers([])
    with pytest.raises(LogError, match=r"different counts of numbers \(1 with 2; 1 names\)"):
        read(write_mcap(tmp_path / "a.mcap", [("/j", JOINTS, START, packed.numbers([]).done())]))


def test_mcap_cut_short_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "a.mcap", robot(rows=100))
    whole = read(file)
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    part = read(file)
    assert 0 < len(part.joints[0]) < 100
    np.testing.assert_array_equal(
        part.joints[0].values, whole.joints[0].values[: len(part.joints[0])]
    )
    assert [f.kind for f in part.findings] == ["truncated"]


def test_bag_without_index_is_refused_with_a_remedy(tmp_path: Path) -> None:
    file = write_bag(tmp_path / "a.bag", robot(ros1=True), indexed=False)
    with pytest.raises(LogError, match=r"not indexed.*rosbag reindex"):
        read(file)


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3"])
@pytest.mark.parametrize("content", [b"", b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"x" * 999])
def test_empty_or_alien_files_are_refused(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=name):
        read(tmp_path / name)


def test_metadata_that_lists_missing_files_is_refused(tmp_path: Path) -> None:
    home = folder("mcap")(tmp_path)
    (home / "take_1.mcap").unlink()
    with pytest.raises(LogError, match=r"lists take_1\.mcap, which is not there"):
        read(home)


def test_chunk_with_a_flipped_bit_is_refused(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "a.mcap", robot())
    raw = bytearray(file.read_bytes())
    raw[raw.index(b"\x28\xb5\x2f\xfd") + 400] ^= 1
    file.write_bytes(bytes(raw))
    with pytest.raises(LogError, match=r"a\.mcap"):
        read(file)


def test_index_that_leaves_messages_out_is_not_believed(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "a.mcap", heat(START, START + 1, START + 2))
    raw = file.read_bytes()
    at = raw.index(b"\x07" + struct.pack("<Q", 6 + 48))
    shorter = b"\x07" + struct.pack("<QHI", 6 + 32, 1, 32) + raw[at + 15 : at + 47]
    file.write_bytes(raw[:at] + shorter + raw[at + 9 + 54 :])
    assert len(read(file).temperatures[0]) == 3


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
def test_chunks_of_every_compression_are_read(tmp_path: Path, compression: str) -> None:
    from mcap.writer import CompressionType, Writer

    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream, compression=CompressionType[compression])
        writer.start(profile="ros2")
        schema = writer.register_schema(ros2(HEAT), "ros2msg", definition(HEAT).encode())
        channel = writer.register_channel("/t", "cdr", schema)
        for _, _, arrival, data in heat(*range(START, START + 2000)):
            writer.add_message(channel, arrival, data, arrival)
        writer.finish()  # type: ignore[no-untyped-call]
    assert read(tmp_path / "a.mcap").temperatures[0].values[:, 0].tolist() == list(range(2000))


def test_messages_outside_of_chunks_are_read(tmp_path: Path) -> None:
    from mcap.writer import Writer

    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2")
        schema = writer.register_schema(ros2(HEAT), "ros2msg", definition(HEAT).encode())
        channel = writer.register_channel("/t", "cdr", schema)
        for topic, _, arrival, data in heat(START, START + 1):
            assert topic == "/t"
            writer.add_message(channel, arrival, data, arrival)
        writer.finish()  # type: ignore[no-untyped-call]
    assert read(tmp_path / "a.mcap").temperatures[0].stamps.tolist() == [START, START + 1]


def topic(kind: str, *, ros1: bool = False) -> Topic:
    return Topic("/x", ros2(kind), definition(kind, ros1=ros1), "ros1msg" if ros1 else "ros2msg",
                 "ros1" if ros1 else "cdr")  # fmt: skip


def by_arrival(pieces: Sequence[Piece]) -> list[tuple[object, ...]]:
    """Return one line a message, bit for bit, in the order of arrival."""
    return sorted(
        (int(p.arrival[n]), p.names, p.frame, int(p.stamps[n]), p.values[n].tobytes(),
         bool(p.withheld[n]))
        for p in pieces for n in range(len(p.stamps))
    )  # fmt: skip


@cache
def rosbags_alone(topic: Topic) -> Decoder:
    """Return a decoder for one message after the other; kept, for `rosbags` compiles it."""
    return Decoder(topic, KINDS[topic.kind], "test")


FLOATS = st.floats(width=64, allow_nan=True)
NAMES = st.lists(st.text("abüé/_0", max_size=9), max_size=4)


@given(st.data(), st.booleans())
@settings(max_examples=40, deadline=None)
def test_reading_at_once_equals_rosbags_bit_for_bit(data: st.DataObject, ros1: bool) -> None:
    kind = data.draw(st.sampled_from([JOINTS, WRENCH, IMU, HEAT]))
    messages = []
    for _ in range(data.draw(st.integers(1, 12))):
        stamp = data.draw(st.integers(0, 2**31 - 1)) * 10**9 + data.draw(st.integers(0, 10**9 - 1))
        six = data.draw(st.lists(FLOATS, min_size=6, max_size=6))
        frame = data.draw(st.sampled_from(["", "ft", "sensor"]))
        if kind == JOINTS:
            names = dict.fromkeys(data.draw(NAMES), 0.0)
            q = dict(zip(names, six, strict=False))
            velocity = data.draw(st.lists(FLOATS, max_size=2))
            packed = joint_state(stamp, q, ros1=ros1, frame=frame, velocity=velocity)
        elif kind == WRENCH:
            packed = wrench(stamp, six, ros1=ros1, frame=frame)
        elif kind == IMU:
            known = data.draw(st.sampled_from([0.0, -1.0]))
            packed = imu(stamp, six[:3], six[3:], ros1=ros1, known=known)
        else:
            packed = temperature(stamp, six[0], ros1=ros1)
        messages.append(packed)
    same = batch(topic(kind, ros1=ros1), messages, range(len(messages)))
    decoder = Decoder(same.topic, KINDS[ros2(kind)], "test")
    at_once = by_arrival(decoder.pieces(same))
    again = by_arrival(decoder.pieces(same))  # with all layouts known
    slow = by_arrival(list(rosbags_alone(same.topic).one_by_one(same, np.arange(len(same)))))
    assert at_once == slow
    assert again == slow


def test_what_lies_in_the_padding_does_not_matter() -> None:
    clean = [joint_state(START + n, {"a": n, "b": -n}) for n in range(3)]
    behind_a = clean[1].index(b"a\0") + 2  # the count of the next name begins two bytes later
    messages = [clean[0], clean[1][:behind_a] + b"\x55\xaa" + clean[1][behind_a + 2 :], clean[2]]
    same = batch(topic(JOINTS), messages, range(3))
    (piece,) = Decoder(same.topic, KINDS[ros2(JOINTS)], "test").pieces(same)
    assert piece.values.tolist() == [[0, 0], [1, -1], [2, -2]]


def test_sensors_that_share_a_topic_are_told_apart_by_their_frames(tmp_path: Path) -> None:
    rows: list[Message] = [
        ("/ft", WRENCH, START + n, wrench(START + n // 2, [n] * 6, frame="lr"[n % 2]))
        for n in range(6)
    ]
    left, right = read(write_mcap(tmp_path / "a.mcap", rows)).channels
    assert (left.name, left.values[:, 0].tolist()) == ("/ft/l", [0, 2, 4])
    assert (right.name, right.values[:, 0].tolist()) == ("/ft/r", [1, 3, 5])
    with pytest.raises(LogError, match="several publishers; name /ft/l, /ft/r instead"):
        read(tmp_path / "a.mcap", Layout(channels={"/ft": tuple("abcdef")}))


def test_more_layouts_than_are_learnt_are_read_one_by_one(tmp_path: Path) -> None:
    rows: list[Message] = [
        ("/j", JOINTS, START + n, joint_state(START + n, {"a": n}, frame="f" * n))
        for n in range(40)
    ]
    (joints,) = read(write_mcap(tmp_path / "a.mcap", rows)).joints
    assert joints.values[:, 0].tolist() == list(range(40))


def test_positions_without_names_need_the_layout(tmp_path: Path) -> None:
    packed = Bytes().header(START).pack("I", 0).numbers([1.0, 2.0]).numbers([]).numbers([])
    file = write_mcap(tmp_path / "a.mcap", [("/j", JOINTS, START, packed.done())])
    with pytest.raises(LogError, match="its messages name no joints; name them in the job"):
        read(file)
    (joints,) = read(file, Layout(joints={"/j": ("a", "b")})).joints
    assert (joints.columns, joints.values.tolist()) == (("a", "b"), [[1, 2]])


def one_message(file: Path, schema: tuple[str, str, str], wire: str, message: bytes) -> Path:
    """Write an MCAP with one message of topic /t."""
    from mcap.writer import Writer

    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        number = writer.register_schema(schema[0], schema[1], schema[2].encode())
        channel = writer.register_channel("/t", wire, number)
        writer.add_message(channel, START, message, START)
        writer.finish()  # type: ignore[no-untyped-call]
    return file


def test_mcap_of_ros1_messages_is_read(tmp_path: Path) -> None:
    schema = (HEAT, "ros1msg", definition(HEAT, ros1=True))
    message = temperature(START, 41.5, ros1=True)
    file = one_message(tmp_path / "a.mcap", schema, "ros1", message)
    assert read(file).temperatures[0].values.tolist() == [[41.5]]


def test_types_given_as_idl_are_read(tmp_path: Path) -> None:
    fields = {
        "sensor_msgs/msg/Temperature":
            "std_msgs::msg::Header header; double temperature; double variance;",
        "std_msgs/msg/Header": "builtin_interfaces::msg::Time stamp; string frame_id;",
        "builtin_interfaces/msg/Time": "int32 sec; uint32 nanosec;",
    }  # fmt: skip
    line = "=" * 80 + "\n"
    text = "".join(
        f"{line}IDL: {kind}\nmodule {kind.split('/')[0]} {{ module msg {{"
        f" struct {kind.split('/')[-1]} {{ {inner} }}; }}; }};\n"
        for kind, inner in fields.items()
    )
    schema = (ros2(HEAT), "ros2idl", text)
    file = one_message(tmp_path / "a.mcap", schema, "cdr", temperature(START, 41.5))
    assert read(file).temperatures[0].values.tolist() == [[41.5]]


def test_missing_library_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = mcap(tmp_path)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(LogError, match=r'pip install "ftcal\[ros\]"'):
        read(file)
    with pytest.raises(OutputError, match=r'pip install "ftcal\[ros\]"'):
        mcap_writer.write(take(), tmp_path / "b.mcap")


def test_big_endian_messages_are_read(tmp_path: Path) -> None:
    body = (
        struct.pack(">III", START // 10**9, 5, 1) + b"\0" + bytes(3) + struct.pack(">dd", 40.5, 0)
    )
    rows = [("/t", HEAT, START, b"\0\0\0\0" + body)]
    (signal,) = read(write_mcap(tmp_path / "a.mcap", rows)).temperatures
    assert (signal.values.tolist(), signal.stamps.tolist()) == ([[40.5]], [START + 5])


def flipped(raw: bytes, data: st.DataObject) -> bytes:
    """Return `raw` cut short, or with some bytes changed."""
    broken = bytearray(raw)
    if data.draw(st.booleans()):
        del broken[data.draw(st.integers(0, len(raw) - 1)) :]
    for _ in range(data.draw(st.integers(0, 3))):
        if broken:
            broken[data.draw(st.integers(0, len(broken) - 1))] = data.draw(st.integers(0, 255))
    return bytes(broken)


@cache
def files_of(form: str) -> dict[str, bytes]:
    """Return the files of a bag, by their paths."""
    with tempfile.TemporaryDirectory() as home:
        FORMS[form](Path(home))
        every = sorted(file for file in Path(home).rglob("*") if file.is_file())
        return {str(file.relative_to(home)): file.read_bytes() for file in every}


@pytest.mark.parametrize("form", ["mcap", "db3", "bag", "mcap folder", "db3 zstd messages"])
@given(data=st.data())
@settings(max_examples=50, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])  # fmt: skip
def test_broken_bytes_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, form: str, data: st.DataObject
) -> None:
    place = tmp_path_factory.mktemp("broken")
    broken = data.draw(st.sampled_from(sorted(files_of(form))))
    for name, raw in files_of(form).items():
        (place / name).parent.mkdir(exist_ok=True)
        (place / name).write_bytes(flipped(raw, data) if name == broken else raw)
    (path,) = place.iterdir()
    with suppress(FtcalError):  # anything else is a bug
        recording = ros.read(path, Layout())
        assert all(np.isfinite(signal.values).all() for signal in recording.channels)


@pytest.mark.parametrize("at", [0, 1])  # the count of names, that of positions
def test_message_that_claims_billions_of_numbers_is_refused(tmp_path: Path, at: int) -> None:
    packed = Bytes().header(START).pack("I", 2**32 - 1 if at == 0 else 0)
    rows = [("/j", JOINTS, START, packed.pack("I", 2**32 - 1).done() + bytes(99))]
    with pytest.raises(LogError, match="a message: damaged"):
        read(write_mcap(tmp_path / "a.mcap", rows))


def test_bag_that_claims_billions_of_chunks_is_refused(tmp_path: Path) -> None:
    raw = bag(tmp_path).read_bytes()
    for field in (b"chunk_count=", b"conn_count="):
        at = raw.index(field) + len(field)
        (tmp_path / "b.bag").write_bytes(raw[:at] + b"\xff" * 4 + raw[at + 4 :])
        with pytest.raises(LogError, match=r"b\.bag.*rosbag reindex"):
            read(tmp_path / "b.bag")


def claim(chunk: bytes, size: int, compression: str) -> bytes:
    """Return an MCAP with one chunk that claims `size` bytes."""
    name = compression.encode()
    body = struct.pack("<QQQI", 0, 0, size, 0) + struct.pack("<I", len(name)) + name
    body += struct.pack("<Q", len(chunk)) + chunk
    head = struct.pack("<BQII", 1, 8, 0, 0)
    return b"\x89MCAP0\r\n" + head + struct.pack("<BQ", 6, len(body)) + body


BOMBS = {
    "a.mcap": claim(zstandard.compress(bytes(10**9 // 8)), 10**9 // 8, "zstd"),
    "b.mcap": claim(
        b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 10**12) + bytes(99), 10**12, "zstd"
    ),
    "c.mcap": claim(b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 10**12) + bytes(99), 10**6, "zstd"),
    "d.mcap": claim(b"", 10**12, ""),
    "e.mcap": b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, 2**62) + bytes(999),
    "f.mcap": claim(bytes(99), 2**63, "lz4"),
    "g.mcap.zstd": zstandard.compress(bytes(10**9 // 8)),
}


@pytest.mark.parametrize("name", BOMBS)
def test_file_that_claims_gigabytes_is_refused_in_little_memory(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(BOMBS[name])
    program = (
        "import resource, sys; from pathlib import Path; from ftcal.errors import LogError\n"
        "from ftcal.logs import Layout, ros\nimport rosbags.highlevel, mcap.reader\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "try: ros.read(Path(sys.argv[1]), Layout())\n"
        "except LogError as error: print(error)\n"
        "grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before\n"
        "assert grown < 100_000, grown\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / name)],
        capture_output=True, text=True, timeout=60, check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (4 * 2**30, 4 * 2**30)),
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert name in run.stdout


def take(*, rows: int = 50, start: int = START) -> Recording:
    """Return a recording with a signal of every kind, each on its own clock."""
    random = np.random.default_rng(3)

    def signal(name: str, columns: Sequence[str], step: int, late: int = 0) -> Signal:
        stamps = start + late + np.arange(rows) * step
        return Signal(name, tuple(columns), stamps, random.normal(size=(rows, len(columns))))

    return Recording(
        "take", "", start,
        joints=(signal("/arm", ["a", "b", "c"], STEP), signal("/hand", ["d"], STEP // 2)),
        channels=(signal("/ft", WRENCH_AXES, STEP // 3, late=7),
                  signal("/raw", [f"c{k}" for k in range(8)], STEP)),
        temperatures=(signal("/heat", ["temperature"], STEP * 3),),
        imus=(signal("/imu", IMU_AXES, STEP // 2),),
    )  # fmt: skip


def same(one: Recording, other: Recording) -> None:
    """Assert that all samples of two recordings are equal, bit for bit."""
    for role in ("joints", "channels", "temperatures", "imus"):
        for a, b in zip(getattr(one, role), getattr(other, role), strict=True):
            assert (a.name, a.columns) == (b.name, b.columns)
            np.testing.assert_array_equal(a.stamps, b.stamps)
            np.testing.assert_array_equal(a.values, b.values)


def test_what_is_written_reads_back_equal(tmp_path: Path) -> None:
    layout = mcap_writer.write(take(), tmp_path / "take.mcap")
    again = read(tmp_path / "take.mcap", layout)
    same(again, take())
    assert (again.start, again.findings) == (START, ())
    assert [file.name for file in tmp_path.iterdir()] == ["take.mcap"]


def test_pieces_give_the_same_samples_as_the_whole(tmp_path: Path) -> None:
    first, second = take(), take(start=START + 50 * 3 * STEP)
    with mcap_writer.Writer(tmp_path / "take.mcap") as writer:
        writer.add(first)
        writer.add(second)
    (_, heat_twice) = first.temperatures[0], read(tmp_path / "take.mcap").temperatures[0]
    both = [take.temperatures[0].values for take in (first, second)]
    np.testing.assert_array_equal(heat_twice.values, np.concatenate(both))


def test_mcap_ros2_decodes_what_is_written(tmp_path: Path) -> None:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    mcap_writer.write(take(), tmp_path / "take.mcap")
    found: dict[str, list[tuple[int, object]]] = {}
    with (tmp_path / "take.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for decoded in reader.iter_decoded_messages():
            message = decoded.decoded_message
            stamp = message.header.stamp
            assert decoded.message.log_time == stamp.sec * 10**9 + stamp.nanosec
            found.setdefault(decoded.channel.topic, []).append((decoded.message.log_time, message))
    force = take().channels[0]
    assert [stamp for stamp, _ in found["/ft"]] == force.stamps.tolist()
    numbers = [
        [getattr(part, axis) for part in (m.wrench.force, m.wrench.torque) for axis in "xyz"]  # type: ignore[attr-defined]
        for _, m in found["/ft"]
    ]
    np.testing.assert_array_equal(numbers, force.values)
    names = [m.name for _, m in found["/arm"]]  # type: ignore[attr-defined]
    assert names[0] == ["a", "b", "c"]


def test_files_of_several_chunks_are_whole_to_the_libraries(tmp_path: Path) -> None:
    from mcap.reader import make_reader
    from mcap.records import Message as Record
    from mcap.stream_reader import StreamReader
    from rosbags.highlevel import AnyReader

    file, recording = tmp_path / "take.mcap", take(rows=9000)
    mcap_writer.write(recording, file)
    logged = {s.name: s.stamps.tolist() for role in ("joints", "channels", "temperatures", "imus")
              for s in getattr(recording, role)}  # fmt: skip
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 2
        names = {number: c.topic for number, c in summary.channels.items()}
        counts = summary.statistics.channel_message_counts
        assert {names[c]: count for c, count in counts.items()} == {
            name: len(stamps) for name, stamps in logged.items()
        }
        span = summary.statistics.message_start_time, summary.statistics.message_end_time
        every = sorted(stamp for stamps in logged.values() for stamp in stamps)
        assert span == (every[0], every[-1])
        found: dict[str, list[int]] = {}
        for _, channel, message in reader.iter_messages():  # by the indexes
            found.setdefault(channel.topic, []).append(message.log_time)
        assert found == logged
    with file.open("rb") as stream:
        records = StreamReader(stream, validate_crcs=True).records  # from end to end
        assert [r.log_time for r in records if isinstance(r, Record)] == every
    with AnyReader([file]) as bag:
        forces = [
            bag.deserialize(raw, c.msgtype).wrench.torque.z  # type: ignore[attr-defined]
            for c, _, raw in bag.messages() if c.topic == "/ft"
        ]  # fmt: skip
    assert forces == recording.channels[0].values[:, 5].tolist()


def test_standard_deviations_have_a_topic_of_their_own(tmp_path: Path) -> None:
    stamps, random = START + np.arange(4) * STEP, np.random.default_rng(1)
    some = ("fx_sd", "tz_sd")
    signals = [
        Signal(name, (*WRENCH_AXES, *sd), stamps, random.normal(size=(4, 6 + len(sd))))
        for name, sd in (("l", tuple(f"{axis}_sd" for axis in WRENCH_AXES)), ("r", some))
    ]
    file = tmp_path / "a.mcap"
    layout = mcap_writer.write(Recording("a", "", START, (), tuple(signals)), file)
    by_name = {signal.name: signal for signal in read(file, layout).channels}
    np.testing.assert_array_equal(by_name["l/sd"].values, signals[0].values[:, 6:])
    np.testing.assert_array_equal(by_name["r/sd"].values, signals[1].values[:, 6:])
    assert by_name["r/sd"].columns == some
    kinds = {signal.name for signal in read(file).channels}
    assert kinds == {"l", "l/sd", "r"}  # two numbers are no wrench: joints, without the layout


def test_nothing_is_left_where_writing_fails(tmp_path: Path) -> None:
    def interrupted() -> None:
        with mcap_writer.Writer(tmp_path / "a.mcap") as writer:
            writer.add(take())
            raise RuntimeError

    with pytest.raises(RuntimeError):
        interrupted()
    with pytest.raises(OutputError, match="no sample to write"):
        mcap_writer.write(Recording("a", "", START, (), ()), tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="cannot be written"):
        mcap_writer.write(take(), tmp_path / "file" / "a.mcap")


def alone(signal: Signal) -> Recording:
    return Recording("a", "", int(signal.stamps[0]), (signal,), ())


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        ([Signal("x", ("a",), np.array([5]), np.ones((1, 1))),
          Signal("x", ("b",), np.array([6]), np.ones((1, 1)))], "'x' changes its columns"),
        ([Signal("x", ("a",), np.array([-5]), np.ones((1, 1)))], "outside the years 1970 to 2038"),
        ([Signal("x", ("a",), np.array([2**62]), np.ones((1, 1)))], "outside the years"),
    ],
)  # fmt: skip
def test_signals_that_ros_cannot_say_are_refused(
    tmp_path: Path, signals: list[Signal], message: str
) -> None:
    *before, last = signals
    with mcap_writer.Writer(tmp_path / "a.mcap") as writer:
        writer.add(alone(Signal("first", ("a",), np.array([1]), np.ones((1, 1)))))
        for signal in before:
            writer.add(alone(signal))
        with pytest.raises(OutputError, match=message):
            writer.add(alone(last))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("mode", ["", "file", "message", "storage"])
def test_bags_of_rosbags_are_read(tmp_path: Path, storage: str, mode: str) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    if (storage, mode) == ("sqlite3", "storage"):
        pytest.skip("sqlite3 has no compression of its own")
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=plugin)
    if mode:
        writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        links = {
            name: writer.add_connection(name, ros2(kind), typestore=store)
            for name, kind in dict.fromkeys((m[0], m[1]) for m in robot())
        }
        for name, _, arrival, data in robot():
            writer.write(links[name], arrival, data)
    same(read(tmp_path / "bag"), read(mcap(tmp_path)))


def test_ros1_bags_of_rosbags_are_read(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    for compression in (None, Writer.CompressionFormat.BZ2, Writer.CompressionFormat.LZ4):
        file = tmp_path / f"{compression}.bag"
        writer = Writer(file)
        if compression:
            writer.set_compression(compression)
        messages = robot(ros1=True)
        with writer:
            links = {
                name: writer.add_connection(name, ros2(kind), typestore=store)
                for name, kind in dict.fromkeys((m[0], m[1]) for m in messages)
            }
            for name, _, arrival, data in messages:
                writer.write(links[name], arrival, data)
        same(read(file), read(bag(tmp_path)))


def blocks(language: str) -> str:
    """Return the one block of the page in `language`."""
    page = Path(__file__).resolve().parents[1] / "docs" / "formats" / "ros.md"
    (block,) = re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    return str(block)


def test_example_of_the_page_reads_a_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(blocks("python").splitlines()) <= 12
    (tmp_path / "example.py").write_text(blocks("python"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    recording = runpy.run_path("example.py")["recording"]
    assert (recording.channels[0].name, len(recording.channels[0])) == ("/leg/ft", 500)


def test_job_lines_of_the_page_are_known_to_the_job_file(tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text(blocks("toml"), encoding="utf-8")
    (table,) = read_toml(tmp_path / "job.toml")["recordings"]
    layout = RecordingSection.model_validate(table).layout()
    assert layout.channels["/odd/ft"] == ()
