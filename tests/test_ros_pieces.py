"""An MCAP bag in pieces is the bag that is read at once."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ftcal import logs
from ftcal.errors import LogError
from ftcal.logs import Layout, ros_pieces
from ftcal.logs.layout import PLAIN, WRENCH_AXES
from ftcal.logs.pieces import Pieces, WholeLog
from ftcal.logs.streamed import StreamedPieces
from ftcal.recording import NANOSECONDS
from piecewise import assert_are_pieces, assert_same, put_together
from ros_bags import (
    START,
    Bytes,
    Message,
    array,
    imu,
    joint_state,
    ros2,
    temperature,
    wrench,
    write_bag,
    write_db3,
    write_mcap,
    write_metadata,
)

JOINTS, WRENCH = "sensor_msgs/JointState", "geometry_msgs/WrenchStamped"
IMU, HEAT = "sensor_msgs/Imu", "sensor_msgs/Temperature"
STEP = 10_000_000  # nanoseconds

one_folder = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.fixture
def forgetful(monkeypatch: pytest.MonkeyPatch) -> None:
    """No more than a few chunks of the test's size are kept."""
    monkeypatch.setattr(ros_pieces, "KEPT", 200)


def in_chunks(path: Path, layout: Layout = PLAIN) -> StreamedPieces:
    """Return a bag opened in pieces; the test fails where it comes as a whole."""
    opened = logs.in_pieces(path, layout)
    assert isinstance(opened, StreamedPieces)
    return opened


def by_arrival(messages: Sequence[Message]) -> list[Message]:
    """Return messages as a recorder writes them."""
    return sorted(messages, key=lambda message: message[2])


def heat(stamps: Sequence[int], *, topic: str = "/heat", late: int = 0) -> list[Message]:
    """Return a thermometer's messages, one a step on arrival, whatever their stamps."""
    return [
        (topic, HEAT, START + n * STEP + late, temperature(stamp, n))
        for n, stamp in enumerate(stamps)
    ]


clocks = st.lists(st.integers(0, 3), max_size=40).map(
    lambda steps: [START + STEP + int(n) * STEP for n in np.cumsum(np.array(steps, dtype=int))]
)
"""Stamps of which some repeat the one before."""


@pytest.mark.usefixtures("forgetful")
@one_folder
@given(
    forces=clocks, joints=clocks, boards=clocks, unstamped=st.sets(st.integers(0, 9)),
    late=st.lists(st.integers(0, 30), min_size=3, max_size=3),
    size=st.tuples(st.integers(1, 50), st.integers(0, 12)),
)  # fmt: skip
def test_the_pieces_of_a_bag_are_the_bag(
    forces: list[int], joints: list[int], boards: list[int], unstamped: set[int],
    late: list[int], size: tuple[int, int], tmp_path: Path,
) -> None:  # fmt: skip
    """Topics lie in the file as they arrive, which their header stamps do not follow."""
    rows, overlap = size
    boards = [0 if n in unstamped else stamp for n, stamp in enumerate(boards)]
    delays = [n * STEP // 3 for n in late]
    messages: list[Message] = [
        *(("/ft", WRENCH, t + delays[0], wrench(t, np.sin(np.arange(6) + n).tolist()))
          for n, t in enumerate(forces)),
        *(("/joints", JOINTS, t + delays[1], joint_state(t, {"knee": n / 3, "hip": -n}))
          for n, t in enumerate(joints)),
        *heat([*boards, START + 99 * STEP], late=delays[2]),
        ("/note", "std_msgs/String", START, Bytes().text("hello").done()),
    ]  # fmt: skip
    layout = Layout(angle="deg", joints={"/joints": ("", "q")}, temperatures={"board": "/heat"})
    layout = layout if joints else replace(layout, joints={})
    file = write_mcap(tmp_path / "a.mcap", by_arrival(messages))
    whole = logs.read(file, layout)
    pieces = list(in_chunks(file, layout).pieces(rows=rows, overlap=overlap * STEP / NANOSECONDS))
    assert_are_pieces(pieces, whole, rows=rows, margin=overlap * STEP)


def everything(rows: int = 30) -> list[Message]:
    """Return messages of every kind, and two sensors on one topic."""
    out: list[Message] = []
    for n in range(rows):
        t = START + n * STEP
        out += [
            ("/ft", WRENCH, t, wrench(t, [n] * 6, frame="left")),
            ("/ft", WRENCH, t + 1, wrench(t + 5, [-n] * 6, frame="right")),
            ("/imu", IMU, t + 2, imu(t, [n, 0, 9.8], [0, n, 0.1])),
            ("/still", IMU, t + 2, imu(t, [0, 0, 0], [0, 0, 0], known=-1.0)),
            ("/raw", "std_msgs/Float64MultiArray", t + 3, array([n, n + 0.5])),
            ("/efforts", JOINTS, t + 4, joint_state(t, {}, velocity=[1.0])),
        ]
    return out


EVERYTHING = Layout(channels={"/raw": ("c1", "c2")}, acceleration="g", zero="/imu")


@pytest.mark.usefixtures("forgetful")
def test_every_message_type_comes_in_pieces(tmp_path: Path) -> None:
    messages = everything()
    (tmp_path / "bag").mkdir()
    write_mcap(tmp_path / "bag" / "bag_0.mcap", messages[:77])
    write_mcap(tmp_path / "bag" / "bag_1.mcap", messages[77:])
    folder = write_metadata(tmp_path / "bag", ["bag_0.mcap", "bag_1.mcap"], "mcap")
    with pytest.raises(LogError, match="name no joints"):
        in_chunks(folder, EVERYTHING)
    layout = replace(EVERYTHING, joints={"/efforts": ("a",)})
    whole = logs.read(folder, layout)
    assert {f.signal for f in whole.findings} == {"/raw", "/still", "/efforts"}
    assert_same(put_together(list(in_chunks(folder, layout).pieces(rows=7))), whole)


def test_a_period_is_that_of_the_whole_signal(tmp_path: Path) -> None:
    stamps = START + np.cumsum(np.random.default_rng(0).integers(0, 5, 200)) * STEP
    file = write_mcap(tmp_path / "a.mcap", heat(stamps.tolist()))
    opened: Pieces = in_chunks(file)
    assert opened.period("temperatures", "/heat") == logs.read(file).temperatures[0].period


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
@pytest.mark.parametrize("option", ["plain", "no chunks", "no index"])
def test_files_of_every_build_come_in_pieces(tmp_path: Path, compression: str, option: str) -> None:
    from mcap.writer import CompressionType, IndexType, Writer

    file = tmp_path / "a.mcap"
    with file.open("wb") as stream:
        writer = Writer(
            stream, chunk_size=500, compression=CompressionType[compression],
            use_chunking=option != "no chunks",
            index_types=IndexType.NONE if option == "no index" else IndexType.ALL,
        )  # fmt: skip
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(ros2(HEAT), "ros2msg", b"")
        channel = writer.register_channel("/heat", "cdr", schema)
        for _, _, arrival, data in heat([START + n for n in range(40)]):
            writer.add_message(channel, arrival, data, arrival)
        writer.finish()  # type: ignore[no-untyped-call]
    assert_same(put_together(list(in_chunks(file).pieces(rows=7))), logs.read(file))


def test_a_file_that_is_cut_short_comes_as_far_as_it_goes(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "a.mcap", heat([START + n for n in range(200)]))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    whole = logs.read(file)
    assert [f.kind for f in whole.findings] == ["truncated"]
    assert_same(put_together(list(in_chunks(file).pieces(rows=7))), whole)


def test_what_the_summary_says_again_changes_nothing(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "a.mcap", heat([START + n for n in range(200)]))
    raw = file.read_bytes()
    again = raw.rindex(b"float64 temperature")  # the definition that the summary repeats
    file.write_bytes(raw[:again] + b"float65" + raw[again + 7 :])
    assert_same(put_together(list(in_chunks(file).pieces(rows=7))), logs.read(file))


def backwards(count: int) -> list[Message]:
    """Return messages of a topic packed in two ways, whose joints change their order."""
    names = [{"a": 1.0, "b": 2.0}, {"b": 2.0, "a": 1.0}]
    return [("/j", JOINTS, START + n, joint_state(START + n, names[n % 2])) for n in range(count)]


def test_what_lies_otherwise_is_read_whole(tmp_path: Path) -> None:
    late = heat([START + n for n in range(9)])
    swapped = [late[0], late[2], late[1], *late[3:]]
    (tmp_path / "zstd").mkdir()
    for path in (
        write_mcap(tmp_path / "swapped.mcap", swapped),
        write_mcap(tmp_path / "two_ways.mcap", backwards(9)),
        write_db3(tmp_path / "a.db3", late),
    ):
        opened = logs.in_pieces(path)
        assert isinstance(opened, WholeLog)
        assert_same(put_together(list(opened.pieces(rows=3))), logs.read(path))
    write_bag(tmp_path / "a.bag", [(*m[:3], temperature(m[2], 1.0, ros1=True)) for m in late])
    assert isinstance(logs.in_pieces(tmp_path / "a.bag"), WholeLog)


@pytest.mark.parametrize("row", range(1, 23))
def test_time_that_goes_back_is_refused_across_any_edge(tmp_path: Path, row: int) -> None:
    stamps = [START + n * STEP for n in range(23)]
    stamps[row] = stamps[row - 1] - 7
    stamps[0] = 0  # left out, and rows counted without it
    if row == 1:
        stamps[1] = stamps[2] + 7
    file = write_mcap(tmp_path / "a.mcap", heat(stamps))
    assert refusal(file, "time goes back")


@pytest.mark.parametrize("rows", [[1], [9, 10, 39], [38]])
def test_a_number_that_is_none_is_refused_with_its_row_and_their_count(
    tmp_path: Path, rows: list[int]
) -> None:
    def six(n: int) -> list[float]:
        return [1.0, float("nan") if n in rows else n, 0, 0, float("inf") if n in rows else 1, 0]

    messages: list[Message] = [
        ("/ft", WRENCH, START + n * STEP, wrench(START + n * STEP, six(n))) for n in range(40)
    ]
    file = write_mcap(tmp_path / "a.mcap", messages)
    assert refusal(file, f"row {rows[0] + 1}: column 'fy' is nan ({2 * len(rows)} such values")


def refusal(file: Path, message: str) -> bool:
    """Return whether a log in pieces is refused as it is at once, and with `message`."""
    with pytest.raises(LogError) as at_once:
        logs.read(file)
    with pytest.raises(LogError) as in_pieces:
        in_chunks(file)
    return str(in_pieces.value) == str(at_once.value) and message in str(at_once.value)


def test_a_bag_that_changes_while_it_is_read_is_named(tmp_path: Path) -> None:
    file = write_mcap(tmp_path / "a.mcap", heat([START + n for n in range(300)]))
    opened = in_chunks(file)
    file.write_bytes(file.read_bytes()[:3000])
    with pytest.raises(LogError, match=r"a\.mcap: .*(changed|damaged)"):
        list(opened.pieces(rows=10))


MEMORY = """
import resource, sys
from pathlib import Path
from ftcal import logs
from ftcal.logs import ros_pieces
ros_pieces.KEPT = 100_000
seen = 0
for path in sys.argv[1:]:
    seen = sum(len(piece.own.channels[0]) for piece in logs.in_pieces(Path(path)).pieces(rows=5000))
print(seen, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def test_memory_does_not_grow_with_the_bag(tmp_path: Path) -> None:
    """Against a short bag of the same kind, for the libraries take most of the memory."""
    from ftcal.logs import mcap_writer
    from ftcal.recording import Recording, Signal

    files = []
    for count in (20_000, 400_000):
        stamps = START + STEP * np.arange(count)
        values = np.random.default_rng(0).normal(size=(count, 6))
        signal = Signal("/ft", WRENCH_AXES, stamps, values)
        files.append(str(tmp_path / f"{count}.mcap"))
        mcap_writer.write(Recording("a", "", START, (), (signal,)), Path(files[-1]))

    def peak(*paths: str) -> int:
        command = [sys.executable, "-c", MEMORY, *paths]
        run = subprocess.run(command, capture_output=True, text=True, check=True)
        seen, kilobytes = map(int, run.stdout.split())
        assert seen == (400_000 if len(paths) == 2 else 20_000)
        return kilobytes

    # the numbers of the long bag take 22 MB, 42 MB with what decoding makes of them; growing with
    # its length are but 20 bytes a chunk, and the allocator's habits
    assert peak(*files) - peak(files[0]) < 12_000
