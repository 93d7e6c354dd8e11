"""Facts about the reader and writer of YARP dumper folders."""

from __future__ import annotations

import hashlib
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ftcal.errors import FtcalError, LogError
from ftcal.logs import Layout, read, yarp
from ftcal.logs.layout import ICUB_JOINTS, WRENCH_AXES
from ftcal.recording import Recording, Signal

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
START = 1_457_614_036_921_366_000
FT_LINE = "{seq} {time} 1.5 -2 3e1 0.25 -0.5 7"


def needs(folder: str) -> pytest.MarkDecorator:
    absent = not (DATA / folder).is_dir()
    return pytest.mark.skipif(absent, reason=f"the recordings of {folder} are not here")


def seconds(stamp: int) -> str:
    return f"{stamp // 10**9}.{stamp % 10**9 // 1000:06d}"


def port(root: Path, name: str, lines: list[str] | str, info: str | None = "") -> Path:
    """Write the folder of a port by hand; `info` None: no info.log, "": a plain connection."""
    folder = root / "icub" / name
    folder.mkdir(parents=True)
    text = lines if isinstance(lines, str) else "".join(f"{line}\n" for line in lines)
    (folder / "data.log").write_text(text)
    if info is not None:
        said = info or f"Type: Bottle;\n[{seconds(START)}] /icub/{name} [connected]\n"
        (folder / "info.log").write_text(said)
    return folder


def ft_lines(count: int, *, first: int = 0, start: int = START) -> list[str]:
    """Return lines of an F/T port at 100 Hz."""
    return [
        FT_LINE.format(seq=(first + n) % 32768, time=seconds(start + n * 10_000_000))
        for n in range(count)
    ]


def kinds(recording: Recording) -> list[str]:
    return [finding.kind for finding in recording.findings]


def test_forces_stay_exactly_as_logged(tmp_path: Path) -> None:
    port(tmp_path, "right_leg/analog:o", ft_lines(3))
    recording = read(tmp_path)
    (signal,) = recording.channels
    assert signal.name == "right_leg/analog:o"
    assert signal.columns == WRENCH_AXES
    assert signal.values.tolist() == [[1.5, -2, 30, 0.25, -0.5, 7]] * 3
    assert signal.stamps.tolist() == [START, START + 10_000_000, START + 20_000_000]
    assert recording.start == START
    assert not recording.findings


@pytest.mark.parametrize("around", ["{}", "({})"])
def test_nested_measures_are_told_apart(tmp_path: Path, around: str) -> None:
    gyroscope, ft = "((1 2 3) 7.5)", "((1 2 3 4 5 6) 7.5)"
    kinds = [gyroscope, "", "", "", "((40.5) 7.5)", f"{ft} {ft}", "", "", ""]
    lists = " ".join(f"({around.format(kind) if kind else ''})" for kind in kinds)
    port(tmp_path, "leg/measures:o", [f"0 {seconds(START)} {lists}"])
    recording = read(tmp_path)
    assert [s.name for s in recording.channels] == ["leg/measures:o/0", "leg/measures:o/1"]
    assert recording.channels[1].values.tolist() == [[1, 2, 3, 4, 5, 6]]
    assert recording.temperature("leg/measures:o").values.tolist() == [[40.5]]
    (imu,) = recording.imus
    assert (imu.name, imu.columns) == ("leg/measures:o/gyroscope 0", ("gx", "gy", "gz"))


@pytest.mark.parametrize("groups", [10, 11])
def test_positions_are_the_first_group_in_radians(tmp_path: Path, groups: int) -> None:
    rest = " ".join(["(9 9 9) [ok]"] * (groups - 1))
    port(tmp_path, "torso/stateExt:o", [f"1 {seconds(START)} (180 -90 0.5) [ok] {rest}"])
    (signal,) = read(tmp_path).joints
    assert signal.columns == ("torso_yaw", "torso_roll", "torso_pitch")
    np.testing.assert_allclose(signal.values, [np.deg2rad([180, -90, 0.5])], rtol=1e-15)


def test_hand_joints_of_an_arm_are_left_out(tmp_path: Path) -> None:
    angles = " ".join(str(n) for n in range(16))
    port(tmp_path, "left_arm/state:o", [f"1 {seconds(START)} {angles}"])
    (signal,) = read(tmp_path).joints
    assert signal.columns == ICUB_JOINTS["left_arm"]
    assert signal.values.shape == (1, 7)


def test_extended_state_makes_plain_state_redundant(tmp_path: Path) -> None:
    port(tmp_path, "torso/state:o", [f"1 {seconds(START)} 1 2 3"])
    port(tmp_path, "torso/stateExt:o", [f"1 {seconds(START)} (1 2 3) [ok] (0 0 0) [ok]"])
    assert [s.name for s in read(tmp_path).joints] == ["torso/stateExt:o"]


def test_plain_state_serves_where_extended_state_is_empty(tmp_path: Path) -> None:
    port(tmp_path, "torso/state:o", [f"1 {seconds(START)} 1 2 3"])
    port(tmp_path, "torso/stateExt:o", "")
    assert [s.name for s in read(tmp_path).joints] == ["torso/state:o"]


def test_failed_group_of_no_interest_is_read_over(tmp_path: Path) -> None:
    lines = [f"{n} {seconds(START + n * 10**7)} (1 2 3) [ok] (0 0 0) [{mark}]"
             for n, mark in enumerate(["ok", "fail"])]  # fmt: skip
    port(tmp_path, "torso/stateExt:o", lines)
    assert len(read(tmp_path).joints[0]) == 2


def test_failed_positions_are_refused(tmp_path: Path) -> None:
    lines = [f"{n} {seconds(START + n * 10**7)} (1 2 3) [{mark}] (0 0 0) [ok]"
             for n, mark in enumerate(["ok", "fail"])]  # fmt: skip
    port(tmp_path, "torso/stateExt:o", lines)
    with pytest.raises(LogError, match=r"data\.log, line 2: the motor board marks"):
        read(tmp_path)


@pytest.mark.parametrize("below", ["", "icub", "icub/right_leg", "icub/right_leg/analog:o"])
def test_root_robot_part_and_port_give_the_same_names(tmp_path: Path, below: str) -> None:
    port(tmp_path, "right_leg/analog:o", ft_lines(2))
    assert read(tmp_path / below).channels[0].name == "right_leg/analog:o"


def test_data_log_itself_can_be_named(tmp_path: Path) -> None:
    folder = port(tmp_path, "right_leg/analog:o", ft_lines(2))
    assert len(read(folder / "data.log").channels[0]) == 2


def test_folder_names_the_port_where_info_log_is_missing(tmp_path: Path) -> None:
    port(tmp_path, "right_leg/analog:o", ft_lines(2), info=None)
    assert read(tmp_path).channels[0].name == "right_leg/analog:o"


def test_flat_folder_that_nothing_names_is_refused_until_the_layout_does(tmp_path: Path) -> None:
    port(tmp_path, "leg_ft", ft_lines(2), info=None)
    with pytest.raises(LogError, match=r"no info\.log says what port 'leg_ft' is"):
        read(tmp_path)
    assert read(tmp_path, Layout(channels={"leg_ft": WRENCH_AXES})).channels[0].name == "leg_ft"


def test_pictures_are_ignored(tmp_path: Path) -> None:
    port(tmp_path, "right_leg/analog:o", ft_lines(2))
    line = f"0 {seconds(START)} 00000000.ppm [bgr]"
    port(tmp_path, "cam/left", [line], info=f"Type: Image;\n[{seconds(START)}] /cam [connected]\n")
    port(tmp_path, "cam/right", [line], info=None)
    assert len(read(tmp_path).channels) == 1


@pytest.mark.parametrize("stamp_line", ["", "Stamp: tx+rx;\n"])
def test_with_both_stamps_the_senders_is_kept(tmp_path: Path, stamp_line: str) -> None:
    lines = [f"{n} {seconds(START + n * 10**7)} {seconds(START + n * 10**7 + 2**20)} 1 2 3 4 5 6"
             for n in range(3)]  # fmt: skip
    connected = f"[{seconds(START)}] /icub/left_leg/analog:o [connected]\n"
    port(tmp_path, "left_leg/analog:o", lines, info=f"Type: Bottle;\n{stamp_line}{connected}")
    (signal,) = read(tmp_path).channels
    assert signal.stamps[0] == START
    assert signal.values.tolist() == [[1, 2, 3, 4, 5, 6]] * 3


def test_counter_that_wraps_loses_nothing(tmp_path: Path) -> None:
    port(tmp_path, "left_leg/analog:o", ft_lines(10, first=32763))
    assert not read(tmp_path).findings


def test_dump_of_each_second_packet_loses_nothing(tmp_path: Path) -> None:
    port(tmp_path, "left_leg/analog:o", ft_lines(10, first=32763)[::2])
    assert not read(tmp_path).findings


def test_skipped_packets_are_counted(tmp_path: Path) -> None:
    lines = ft_lines(10, first=32764)
    port(tmp_path, "left_leg/analog:o", [*lines[:3], *lines[5:8], lines[9]])
    recording = read(tmp_path)
    (finding,) = recording.findings
    assert finding.kind == "lost packets"
    assert "skips 3 of 10 packets" in finding.message
    assert (finding.start, finding.stop) == pytest.approx((0.02, 0.09))
    assert not finding.cut


@pytest.mark.parametrize("cut", [1, 5, 20, 40])
def test_truncated_last_line_is_dropped_and_told(tmp_path: Path, cut: int) -> None:
    port(tmp_path, "left_leg/analog:o", "\n".join([*ft_lines(4), ""])[:-cut])
    recording = read(tmp_path)
    assert len(recording.channels[0]) == 3
    assert kinds(recording) == ["truncated"]


def test_last_line_that_ends_but_lacks_fields_is_dropped(tmp_path: Path) -> None:
    port(tmp_path, "left_leg/analog:o", [*ft_lines(3), f"3 {seconds(START + 10**9)} 1 2"])
    recording = read(tmp_path)
    assert len(recording.channels[0]) == 3
    assert kinds(recording) == ["truncated"]


def test_port_that_logged_nothing_is_a_finding(tmp_path: Path) -> None:
    port(tmp_path, "left_leg/analog:o", ft_lines(2))
    silent = port(tmp_path, "left_arm/stateExt:o", "", info=(
        f"Type: Bottle;\n[{seconds(START)}] /icub/left_arm/stateExt:o [connected]\n"
        f"[{seconds(START + 75 * 10**9)}] /icub/left_arm/stateExt:o [disconnected]\n"))  # fmt: skip
    for _ in range(2):
        recording = read(tmp_path)
        (finding,) = recording.findings
        assert (finding.kind, finding.signal) == ("empty", "left_arm/stateExt:o")
        assert finding.stop == pytest.approx(75.0)
        (silent / "data.log").unlink(missing_ok=True)


def test_hole_between_connections_is_a_break(tmp_path: Path) -> None:
    again = START + 30 * 10**9
    name = "/icub/left_leg/analog:o"
    events = [(START, "connected"), (START + 10**8, "disconnected"), (again, "connected")]
    info = "Type: Bottle;\n" + "".join(f"[{seconds(t)}] {name} [{what}]\n" for t, what in events)
    # the first packet is stamped before the dumper notes the connection; the counter went on
    lines = [*ft_lines(10), *ft_lines(5, first=3000, start=again - 2_000_000)]
    port(tmp_path, "left_leg/analog:o", lines, info=info)
    recording = read(tmp_path)
    assert recording.channels[0].breaks == (10,)
    assert not recording.findings


def test_numbered_folders_are_sessions_of_one_port(tmp_path: Path) -> None:
    port(tmp_path, "left_leg/analog:o", ft_lines(4))
    info = f"Type: Bottle;\n[{seconds(START)}] /icub/left_leg/analog:o [connected]\n"
    port(tmp_path, "left_leg/analog:o_00001", ft_lines(3, start=START + 10**10), info=info)
    port(tmp_path, "left_leg/analog:o_00002", ft_lines(2, start=START + 10**9), info=None)
    (signal,) = read(tmp_path).channels
    assert signal.breaks == (4, 6)
    assert len(signal) == 9
    assert (np.diff(signal.stamps) > 0).all()


def test_sessions_that_overlap_are_refused(tmp_path: Path) -> None:
    for name in ("left_leg/analog:o", "left_leg/analog:o_00001"):
        port(tmp_path, name, ft_lines(4), info=None)
    with pytest.raises(LogError, match="overlap in time"):
        read(tmp_path)


def test_two_takes_below_one_root_are_refused(tmp_path: Path) -> None:
    for take in ("monday", "tuesday"):
        port(tmp_path / take, "left_leg/analog:o", ft_lines(4))
    with pytest.raises(LogError, match="both hold port 'left_leg/analog:o'"):
        read(tmp_path)


def test_repeated_stamps_are_dropped_and_told(tmp_path: Path) -> None:
    lines = ft_lines(5)
    lines[2] = f"2 {seconds(START + 10_000_000)} 9 9 9 9 9 9"
    port(tmp_path, "left_leg/analog:o", lines)
    recording = read(tmp_path)
    assert len(recording.channels[0]) == 4
    assert 9 not in recording.channels[0].values
    assert kinds(recording) == ["duplicate stamps"]


def test_time_that_goes_back_is_refused(tmp_path: Path) -> None:
    lines = ft_lines(5)
    lines[3] = FT_LINE.format(seq=3, time=seconds(START))
    port(tmp_path, "left_leg/analog:o", lines)
    with pytest.raises(LogError, match=r"data\.log, row 4: time goes back by 0\.020000 s"):
        read(tmp_path)


@pytest.mark.parametrize("word", ["nan", "inf", "-inf"])
def test_number_that_is_not_finite_is_refused(tmp_path: Path, word: str) -> None:
    port(
        tmp_path,
        "left_leg/analog:o",
        [*ft_lines(2), f"2 {seconds(START + 10**9)} 1 2 {word} 4 5 6"],
    )
    with pytest.raises(LogError, match=r"data\.log, row 3: column 'fz' is -?(nan|inf)"):
        read(tmp_path)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("2 12.5 1 2 x 4 5 6", r"line 3: 'x' is no number"),
        ("2 12.5 1 2 3", r"line 3: 5 fields where the first line has 8"),
        ("2 now 1 2 3 4 5 6", r"line 3: 'now' is no number"),
    ],
)
def test_line_that_cannot_be_read_is_named(tmp_path: Path, line: str, message: str) -> None:
    lines = ft_lines(5)
    lines[2] = line
    port(tmp_path, "left_leg/analog:o", lines)
    with pytest.raises(LogError, match=message) as caught:
        read(tmp_path)
    assert "data.log" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_second_zero_is_the_signal_the_layout_names(tmp_path: Path) -> None:
    port(tmp_path, "left_leg/analog:o", ft_lines(2))
    port(tmp_path, "right_leg/analog:o", ft_lines(2, start=START + 5_000_000))
    assert read(tmp_path).start == START
    assert read(tmp_path, Layout(zero="right_leg/analog:o")).start == START + 5_000_000


def test_layout_names_joints_and_unit(tmp_path: Path) -> None:
    port(tmp_path, "torso/state:o", [f"1 {seconds(START)} 1 2 3"])
    layout = Layout(joints={"torso/state:o": ("pitch", "", "yaw")}, angle="rad")
    (signal,) = read(tmp_path, layout).joints
    assert signal.columns == ("pitch", "yaw")
    assert signal.values.tolist() == [[1, 3]]


def test_port_that_the_layout_names_must_be_there(tmp_path: Path) -> None:
    port(tmp_path, "torso/state:o", [f"1 {seconds(START)} 1 2 3"])
    with pytest.raises(LogError, match=r"no port 'torse/state:o'; did you mean torso/state:o\?"):
        read(tmp_path, Layout(joints={"torse/state:o": ("a",)}))


def test_digest_is_that_of_the_files_sums(tmp_path: Path) -> None:
    folder = port(tmp_path, "left_leg/analog:o", ft_lines(2))
    sums = [hashlib.sha256((folder / f).read_bytes()).digest() for f in ("data.log", "info.log")]
    assert read(tmp_path).digest == hashlib.sha256(b"".join(sums)).hexdigest()


@pytest.mark.parametrize("made", ["nothing", "folder", "info", "blank"])
def test_path_without_samples_is_refused(tmp_path: Path, made: str) -> None:
    path = tmp_path / "log"
    if made != "nothing":
        path.mkdir()
    if made in {"info", "blank"}:
        (path / "info.log").write_text("Type: Bottle;\n")
    if made == "blank":
        (path / "data.log").touch()
    with pytest.raises(LogError) as caught:
        read(path)
    assert str(path) in str(caught.value)


@settings(
    max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    content=st.binary(max_size=80)
    | st.text(alphabet="0123456789. -e()[]ok\nnaif", max_size=200).map(str.encode)
    | st.lists(
        st.sampled_from(
            [*ft_lines(6), "1 2 3", "1 1.5 (1 2) [ok] (3) [fail]", "99999999999 9e9 1"]
        ),
        max_size=5,
    ).map(lambda lines: "\n".join([*lines, ""]).encode()),
    name=st.sampled_from(["left_leg/analog:o", "torso/stateExt:o", "measures:o"]),
    info=st.none() | st.binary(max_size=40),
)
def test_any_bytes_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, name: str, info: bytes | None
) -> None:
    folder = tmp_path_factory.mktemp("fuzz") / "icub" / name
    folder.mkdir(parents=True)
    (folder / "data.log").write_bytes(content)
    if info is not None:
        (folder / "info.log").write_bytes(info)
    try:
        recording = read(folder)
    except FtcalError:
        return
    for signal in (*recording.joints, *recording.channels, *recording.imus):
        assert (np.diff(signal.stamps) > 0).all()
        assert np.isfinite(signal.values).all()


@st.composite
def signals(draw: st.DrawFn, name: str, columns: tuple[str, ...], *, scale: float) -> Signal:
    """Return a signal that the format can hold: whole microseconds, six decimals."""
    count = draw(st.integers(1, 6))
    steps = draw(st.lists(st.integers(1, 50_000), min_size=count, max_size=count))
    breaks = tuple(sorted(draw(st.sets(st.integers(1, count), max_size=2)) - {count}))
    stamps = START // 1000 + np.cumsum(steps)
    for row in breaks:
        stamps[row:] += 3_000_000
    whole = st.integers(-400_000_000, 400_000_000)
    size = count * len(columns)
    values = np.array(draw(st.lists(whole, min_size=size, max_size=size))) * 1e-6 * scale
    return Signal(name, columns, stamps * 1000, values.reshape(count, -1), breaks)


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    degree = np.pi / 180
    joints = (
        draw(signals("torso/stateExt:o", ICUB_JOINTS["torso"], scale=degree)),
        draw(signals("tail/state:o", ("tail_wag",), scale=degree)),
    )
    channels = (draw(signals("left_leg/analog:o", WRENCH_AXES, scale=1.0)),)
    warmth = (draw(signals("boards/temperature:o", ("temperature",), scale=1.0)),)
    imus = (draw(signals("waist/inertial", ("ax", "ay", "az"), scale=1.0)),)
    every = (*joints, *channels, *warmth, *imus)
    start = min(int(s.stamps[0]) for s in every)
    return Recording("take", "", start, joints, channels, warmth, imus)


@settings(max_examples=40, deadline=None)
@given(recording=recordings())
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, recording: Recording
) -> None:
    root = tmp_path_factory.mktemp("take")
    layout = yarp.write(recording, root)
    again = read(root, layout)
    assert not again.findings
    assert again.start == recording.start
    for role in ("joints", "channels", "temperatures", "imus"):
        found = {signal.name: signal for signal in getattr(again, role)}
        assert len(found) == len(getattr(recording, role))
        for wanted in getattr(recording, role):
            signal = found[wanted.name]
            assert signal.columns == wanted.columns
            assert signal.breaks == wanted.breaks
            assert signal.stamps.tolist() == wanted.stamps.tolist()
            # degrees pass through radians and back: a few units in the last place
            np.testing.assert_allclose(signal.values, wanted.values, rtol=1e-14, atol=1e-15)


def test_written_motor_board_has_ten_groups_and_a_counter_that_wraps(tmp_path: Path) -> None:
    count = 32770
    stamps = START + 10_000_000 * np.arange(count)
    torso = Signal("torso/stateExt:o", ICUB_JOINTS["torso"], stamps, np.zeros((count, 3)))
    yarp.write(Recording("take", "", START, (torso,), ()), tmp_path)
    lines = (tmp_path / "icub/torso/stateExt:o/data.log").read_text().splitlines()
    assert lines[0].count("[ok]") == 10
    assert [lines[row].split()[0] for row in (0, 32767, 32768)] == ["0", "32767", "0"]
    assert not read(tmp_path).findings


def test_joint_names_are_those_of_the_robot_models() -> None:
    models = pytest.importorskip("icub_models", reason="the robot models are not installed")
    urdf = ElementTree.parse(models.get_model_file("iCubGenova02")).getroot()
    names = {
        joint.get("name")
        for joint in urdf.iter("joint")
        if joint.get("type") not in {None, "fixed"}
    }
    eyes = {"eyes_tilt", "eyes_version", "eyes_vergence"}
    assert {joint for part in ICUB_JOINTS.values() for joint in part} - eyes == names


@needs("icub-genova02")
def test_every_port_of_genova02_is_read() -> None:
    recording = read(DATA / "icub-genova02" / "left_leg_support")
    assert {s.name: len(s) for s in (*recording.joints, *recording.channels)} == {
        "head/stateExt:o": 7419,  # 7425 lines, 6 of which repeat a stamp
        "left_leg/stateExt:o": 7428, "right_leg/stateExt:o": 7452, "torso/stateExt:o": 7479,
        "left_arm/analog:o": 7500, "right_arm/analog:o": 7500,
        "left_leg/analog:o": 7501, "right_leg/analog:o": 7499,
        "left_foot/analog:o": 7499, "right_foot/analog:o": 7524,
    }  # fmt: skip
    assert sorted((f.kind, f.signal) for f in recording.findings) == [
        ("duplicate stamps", "head/stateExt:o"),
        ("empty", "left_arm/stateExt:o"),
        ("empty", "right_arm/stateExt:o"),
    ]
    leg = recording.channel("right_leg/analog:o")
    assert (leg.stamps[0], leg.stamps[-1]) == (1457614036921366000, 1457614112604512000)
    assert leg.values[0].tolist() == [
        23.101776, -23.477356, -200.092743, 4.283997, -1.444946, 0.083496,
    ]  # fmt: skip
    torso = next(s for s in recording.joints if s.name == "torso/stateExt:o")
    assert torso.columns == ("torso_yaw", "torso_roll", "torso_pitch")
    np.testing.assert_allclose(np.rad2deg(torso.values[0]), [-0.005493, -0.071411, -9.99209])


@needs("icub-genova01")
def test_flat_folders_of_genova01_have_the_names_of_the_tree() -> None:
    recording = read(DATA / "icub-genova01" / "torso_sweep")
    assert {s.name: len(s) for s in (*recording.joints, *recording.channels)} == {
        "left_leg/state:o": 10871, "right_leg/state:o": 10886, "torso/state:o": 10845,
        "left_leg/analog:o": 10909, "right_leg/analog:o": 10904,
        "left_foot/analog:o": 10902, "right_foot/analog:o": 10897,
    }  # fmt: skip
    assert {f.kind for f in recording.findings} == {"duplicate stamps"}
    leg = next(s for s in recording.joints if s.name == "left_leg/state:o")
    assert leg.columns == ICUB_JOINTS["left_leg"]
    assert leg.stamps[-1] == 1411729944506848000
    np.testing.assert_allclose(np.rad2deg(leg.values[-1, 4:]), [-6.428571, -9.087912])
