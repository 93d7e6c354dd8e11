"""Logs whose wrench a driver turned into the axes of another link: turned back, nothing is lost.

The arm of `small_world` moves on one sensor between its base and its stand; its driver turns what
the board sends into the axes of a link that the joints move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal import logs, takes
from ftcal.applying import apply
from ftcal.calibration import SensorCalibration, read_calibration, to_json
from ftcal.cli import main
from ftcal.config import read_job
from ftcal.contact import ContactSchedule, Interval
from ftcal.diagnosis import diagnose
from ftcal.errors import DataError, JobError, RobotError
from ftcal.export import export
from ftcal.kinematics import sensor_pose
from ftcal.live import WrenchReader
from ftcal.logs.pieces import Pieces, WholeLog, cut
from ftcal.motion import Motion
from ftcal.pairing import FtChannel
from ftcal.pipeline import Outcome, calibrate, described, score_calibration
from ftcal.preparation import ingredients, prepare
from ftcal.progress import Steps, silent
from ftcal.recording import Recording, Signal
from ftcal.robot import Robot
from ftcal.sensor import AXES, Workbench
from ftcal.turning import TurnedPieces, Turning, recording_turned_back, turned_back
from ftcal.urdf import parse_robot
from ftcal.whole_pipeline import calibrate_whole_body
from piecewise import assert_same, put_together
from small_world import JOINTS, PRIOR, robot_text, take, write_log, write_world

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

LINK = "wrist_link"
START = 1_700_000_000_000_000_000
BELIEVED = Workbench("as logged", np.eye(6), np.ones(6), "channels")
CHANNEL = FtChannel("ft_sensor", "ft", BELIEVED, wrench_frame=LINK)


@cache
def arm() -> Robot:
    return parse_robot(robot_text(), name="arm")


def driven(
    joints: Float[Array, "N 3"], wrench: Float[Array, "N 6"], link: str = LINK
) -> Float[Array, "N 6"]:
    """Return what a driver logs that turns wrenches of the sensor into the axes of a link."""
    motion = Motion(np.zeros(len(joints)), JOINTS, joints, joints, joints)
    L_R_S = sensor_pose(arm(), motion, link, "ft_sensor")[:, :3, :3]
    halves = wrench.reshape(-1, 2, 3)
    return np.asarray(np.einsum("nij,nhj->nhi", L_R_S, halves).reshape(-1, 6))


def stamps(seconds: Float[Array, "N"]) -> Array:
    return np.asarray(START + np.round(seconds * 1e9).astype(np.int64))


def recorded(
    at: Float[Array, "N"], joints: Signal, wrench: Float[Array, "N 6"], breaks: Sequence[int] = ()
) -> Recording:
    ft = Signal("ft", AXES, stamps(at), wrench, tuple(breaks))
    return Recording("take", "memory", START, (joints,), (ft,))


def swinging(rate: float, seconds: float = 10.0) -> tuple[Array, Array]:
    """Return time [s] and the joints [rad] of an arm that swings a radian to and fro in 6 s."""
    time = np.arange(round(rate * seconds)) / rate
    return time, np.sin(1.0472 * time[:, None] + [0.0, 1.0, 2.0])


WRENCH = np.array([10.0, -20.0, 80.0, 2.0, -1.0, 0.5])


def test_a_still_robot_gives_back_what_the_sensor_felt() -> None:
    time = np.arange(500) / 100.0
    joints = np.broadcast_to([0.3, -0.7, 1.1], (500, 3))
    felt = WRENCH + np.random.default_rng(0).normal(size=(500, 6))
    log = recorded(time, Signal("joints", JOINTS, stamps(time), joints), driven(joints, felt))
    back = recording_turned_back(log, arm(), [CHANNEL]).channel("ft")
    # there and back are two rotations: a few roundings of 80 N
    np.testing.assert_allclose(back.values, felt, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(back.stamps, log.channels[0].stamps)
    assert back.breaks == ()


def test_between_two_samples_of_the_joints_the_error_is_that_of_a_straight_line() -> None:
    rate = 100.0
    time, joints = swinging(rate)
    at = time[:-1] + 0.5 / rate
    there = np.sin(1.0472 * at[:, None] + [0.0, 1.0, 2.0])
    felt = np.broadcast_to(WRENCH, (len(at), 6))
    log = recorded(at, Signal("joints", JOINTS, stamps(time), joints), driven(there, felt))
    error = recording_turned_back(log, arm(), [CHANNEL]).channel("ft").values - felt
    # a straight line misses a sine of 1.05 rad/s by w^2 dt^2 / 8 rad at most, three joints add up
    angle = 3 * 1.0472**2 / rate**2 / 8
    assert np.abs(error[:, :3]).max() < angle * np.linalg.norm(WRENCH[:3])
    assert np.abs(error[:, 3:]).max() < angle * np.linalg.norm(WRENCH[3:])
    assert np.abs(error).max() > 1e-6  # and it is not nothing


def test_axes_that_do_not_move_against_the_sensor_need_no_joints() -> None:
    felt = np.broadcast_to(WRENCH, (50, 6))
    at = np.arange(50) / 100.0
    nothing = Signal("joints", (), stamps(at), np.empty((50, 0)))
    log = recorded(at, nothing, driven(np.zeros((50, 3)), felt, "base"))
    assert not np.allclose(log.channels[0].values, felt)
    back = recording_turned_back(log, arm(), [replace(CHANNEL, wrench_frame="base")])
    np.testing.assert_allclose(back.channels[0].values, felt, rtol=0, atol=1e-12)


def test_samples_at_which_a_joint_is_not_known_are_left_out_and_part_the_log() -> None:
    time, joints = swinging(100.0)
    hole = (time > 3.0) & (time < 4.0)
    signal = Signal("joints", JOINTS, stamps(time[~hole]), joints[~hole])
    at = np.arange(-100, 1100) / 100.0  # a second before the joints, and two after
    log = recorded(at, signal, np.broadcast_to(WRENCH, (len(at), 6)), [150])
    back = recording_turned_back(log, arm(), [CHANNEL]).channel("ft")
    known = (at >= 0.0) & (at <= time[-1]) & ~((at > 3.0) & (at < 4.0))
    np.testing.assert_array_equal(back.stamps, stamps(at[known]))
    # the first sample after those left out, the session of the log itself, and after the hole
    assert back.breaks == (0, 50, 301)


def test_other_sensors_and_other_signals_are_let_alone() -> None:
    time, joints = swinging(50.0)
    log = recorded(time, Signal("joints", JOINTS, stamps(time), joints), np.ones((len(time), 6)))
    more = replace(log, channels=(*log.channels, replace(log.channels[0], name="other")))
    back = recording_turned_back(more, arm(), [CHANNEL])
    assert back.channels[1] is more.channels[1]
    assert back.joints is more.joints
    own = replace(CHANNEL, wrench_frame=None)
    assert recording_turned_back(more, arm(), [own]) is more
    whole = WholeLog(more)
    assert turned_back(whole, arm(), [own]) is whole


def ragged(seed: int) -> Recording:
    """Return a log of two joint signals of unlike rates, with holes, sessions and lone samples."""
    rng = np.random.default_rng(seed)

    def clock(count: int, period: float) -> Array:
        step = period * rng.uniform(0.6, 1.4, count)
        step[rng.integers(0, count, 6)] += rng.uniform(0.2, 0.7, 6)
        return stamps(np.cumsum(step))

    def signal(name: str, columns: tuple[str, ...], count: int, period: float) -> Signal:
        values = rng.normal(size=(count, len(columns)))
        breaks = sorted({*rng.integers(1, count, 3).tolist()})
        return Signal(name, columns, clock(count, period), values, tuple(breaks))

    joints = (signal("arm", JOINTS[:2], 700, 0.01), signal("hand", JOINTS[2:], 300, 0.02))
    return Recording("take", "memory", START, joints, (signal("ft", AXES, 1200, 0.005),))


@given(st.integers(0, 50), st.integers(30, 700), st.sampled_from([0.0, 0.013, 1.5]))
@settings(max_examples=12, deadline=None)
def test_pieces_put_together_are_the_whole_bit_for_bit(
    seed: int, rows: int, overlap: float
) -> None:
    log = ragged(seed)
    expected = recording_turned_back(log, arm(), [CHANNEL])
    assert 0 < len(expected.channels[0]) < len(log.channels[0])
    turned = TurnedPieces.of(WholeLog(log), Turning.of(WholeLog(log), arm(), [CHANNEL]))
    pieces = list(turned.pieces(rows=rows, overlap=overlap))
    assert_same(put_together(pieces), expected)
    for piece in pieces:  # and so is what a piece shows of its neighbours
        assert_same(piece.recording, shown(expected, piece.start, piece.stop, overlap))
    assert_same(turned.head, WholeLog(expected).head)


def shown(whole: Recording, start: int, stop: int, overlap: float) -> Recording:
    margin = round(overlap * 1e9)
    return cut(whole, start - margin, stop + margin)


def test_all_that_cannot_be_turned_is_told_at_once() -> None:
    time, joints = swinging(50.0, 1.0)
    logged = Signal("joints", JOINTS[:1], stamps(time), joints[:, :1])
    log = recorded(time, logged, np.ones((50, 6)))
    eight = Signal("raw", tuple("abcdefgh"), stamps(time), np.ones((50, 8)))
    log = replace(log, channels=(*log.channels, eight))
    raw = replace(CHANNEL, signal="raw", wrench_frame="base")
    with pytest.raises(DataError) as caught:
        recording_turned_back(log, arm(), [CHANNEL, raw])
    told = str(caught.value)
    assert "\n" not in told
    assert "'raw' has 8 channels; a wrench in the axes of 'base' has six" in told
    assert "'wrist_link' needs joints that are not logged (wrist, elbow)" in told


@pytest.mark.parametrize("pieces", [False, True])
def test_a_sensor_never_logged_together_with_its_joints_is_refused(pieces: bool) -> None:
    time, joints = swinging(50.0, 1.0)
    signal = Signal("joints", JOINTS, stamps(time), joints)
    log = recorded(time + 7.0, signal, np.ones((50, 6)))
    opened: Pieces = InPieces(WholeLog(log)) if pieces else WholeLog(log)
    with pytest.raises(DataError, match=r"known at no sample of 'ft'.*; log both at once"):
        turned_back(opened, arm(), [CHANNEL])


class InPieces:
    """A log that does not say that it is in memory as a whole."""

    def __init__(self, log: WholeLog) -> None:
        self.head, self.period, self.pieces = log.head, log.period, log.pieces


def test_a_log_in_pieces_is_turned_in_pieces() -> None:
    log = ragged(3)
    turned = turned_back(InPieces(WholeLog(log)), arm(), [CHANNEL])
    assert isinstance(turned, TurnedPieces)
    expected = recording_turned_back(log, arm(), [CHANNEL])
    assert_same(put_together(list(turned.pieces(rows=100))), expected)
    assert turned.period("joints", "hand") == log.joints[1].period


def write_wrenches(folder: Path, link: str | None, scope: str = "each sensor") -> Path:
    """Write the world of `small_world` as wrenches in N and Nm, of a link's axes; the job says so.

    The second recording trains too, in its first half.
    """
    folder.mkdir()
    file = write_world(folder)
    for name, seed in (("one", 1), ("two", 2)):
        time, joints, channels = take(seed)
        wrench = channels @ PRIOR.gain.T
        logged = wrench if link is None else driven(joints, wrench, link)
        write_log(folder / f"{name}.csv", time, joints, logged)
    said = "" if link is None else f'\nwrench_frame = "{link}"'
    text = file.read_text().replace('logged = "channels"', f'logged = "wrench"{said}')
    text = text.replace("train = []\ntest = [[0, 40]]", "train = [[0, 18]]\ntest = [[20, 40]]")
    file.write_text(f'{text}\n[fit]\nscope = "{scope}"\n')
    return file


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_wrenches(tmp_path_factory.mktemp("worlds") / "plain", None)


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_wrenches(tmp_path_factory.mktemp("worlds") / "turned", LINK)


@pytest.fixture(scope="module")
def expected(plain: Path) -> Outcome:
    return calibrate(read_job(plain))


@pytest.fixture(scope="module")
def found(turned: Path) -> Outcome:
    return calibrate(read_job(turned))


def assert_alike(
    ours: SensorCalibration, theirs: SensorCalibration, *, tolerance: float = 1e-9
) -> None:
    """One clock for joints and sensor: the log was turned back but for the rounding of numbers.

    Roundings of 1e-16 of a load go through normal equations of condition 1e4. Gains in the largest
    entry of their row, offsets in N and Nm.
    """
    scale = np.abs(np.array(theirs.fitted_gain)).max(axis=1, keepdims=True)
    change = np.array(ours.fitted_gain) - np.array(theirs.fitted_gain)
    assert np.abs(change / scale).max() < tolerance
    for one, other in zip(ours.offsets, theirs.offsets, strict=True):
        assert np.abs(np.array(one.offset) - np.array(other.offset)).max() < 1e3 * tolerance
        assert (one.start, one.stop) == (other.start, other.stop)
    assert [v.verdict for v in ours.verdicts] == [v.verdict for v in theirs.verdicts]


def test_a_calibration_with_the_key_is_that_of_the_log_not_turned(
    found: Outcome, expected: Outcome
) -> None:
    (ours,), (theirs,) = found.calibration.sensors, expected.calibration.sensors
    assert_alike(ours, theirs)
    assert (ours.frame, ours.wrench_frame) == (theirs.frame, LINK)
    assert [v.verdict for v in ours.verdicts] == ["ACCEPT"] * 6


def test_without_the_key_the_calibration_is_no_good(turned: Path, tmp_path: Path) -> None:
    job = read_job(turned)
    silent = job.sensors[0].model_copy(update={"wrench_frame": None})
    (sensor,) = calibrate(job.model_copy(update={"sensors": (silent,)})).calibration.sensors
    assert {v.verdict for v in sensor.verdicts} != {"ACCEPT"}


def test_a_calibration_from_pieces_is_the_same_bit_for_bit(
    turned: Path, found: Outcome, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(takes, "IN_MEMORY", 0)
    job = read_job(turned)
    assert not isinstance(takes.opened(job, job.recordings[0]), WholeLog)
    again = calibrate(job)
    assert again.calibration.sensors == found.calibration.sensors


def test_scores_on_a_turned_log_are_those_of_the_log_not_turned(
    found: Outcome, turned: Path, plain: Path
) -> None:
    known = found.calibration
    ours, theirs = (
        score_calibration(known, read_job(file))["ft_sensor"] for file in (turned, plain)
    )
    for name, score in theirs.by_name.items():
        assert ours.by_name[name].rms == pytest.approx(score.rms, abs=1e-6)


def test_the_report_looks_at_the_turned_log(found: Outcome, expected: Outcome) -> None:
    ours, theirs = (one.logs.between("one", 3.0, 5.0).channels[0] for one in (found, expected))
    assert len(ours) == 200
    np.testing.assert_allclose(ours.values, theirs.values, rtol=0, atol=1e-9)


def test_the_doctor_sees_the_numbers_as_they_were_logged(turned: Path, tmp_path: Path) -> None:
    (tmp_path / "w").mkdir()
    for file in turned.parent.iterdir():
        (tmp_path / "w" / file.name).write_bytes(file.read_bytes())
    lines = (tmp_path / "w" / "one.csv").read_text().splitlines()
    stuck = lines[1000].split(",")[4:]
    for row in range(1000, 1300):  # three seconds, in which the arm moves on
        lines[row] = ",".join([*lines[row].split(",")[:4], *stuck])
    (tmp_path / "w" / "one.csv").write_text("\n".join(lines) + "\n")
    findings = calibrate(read_job(tmp_path / "w" / "job.toml")).findings
    (frozen,) = [finding for _, finding in findings if finding.cut]
    assert (frozen.kind, frozen.signal) == ("frozen", "ft")
    np.testing.assert_allclose([frozen.start, frozen.stop], [9.99, 12.99], atol=0.02)


def test_a_recording_searched_for_steps_is_turned_as_well(turned: Path, plain: Path) -> None:
    both = []
    for file in (turned, plain):
        job = read_job(file)
        auto = tuple(s.model_copy(update={"breaks": "auto"}) for s in job.recordings)
        both.append(calibrate(job.model_copy(update={"recordings": auto})).calibration.sensors[0])
    assert_alike(*both)


def test_all_sensors_at_once_are_turned_as_well(tmp_path: Path) -> None:
    ours, theirs = (
        calibrate_whole_body(read_job(write_wrenches(tmp_path / name, link, "whole body")))
        for name, link in (("turned", LINK), ("plain", None))
    )
    (one,), (other,) = ours.calibration.sensors, theirs.calibration.sensors
    # noise and strength are agreed upon in rounds, each of which magnifies the roundings: 5e-7
    assert_alike(one, other, tolerance=1e-5)
    assert one.wrench_frame == LINK


def test_a_fit_of_all_sensors_without_the_key_is_refused_by_its_name(tmp_path: Path) -> None:
    file = write_wrenches(tmp_path / "silent", LINK, "whole body")
    file.write_text(file.read_text().replace(f'wrench_frame = "{LINK}"\n', ""))
    with pytest.raises(DataError, match=f'for ft_sensor say wrench_frame = "{LINK}" in the job'):
        calibrate_whole_body(read_job(file))


def test_a_recording_of_a_study_is_turned_and_kept_apart(turned: Path, plain: Path) -> None:
    made = []
    for file in (turned, plain):
        job = read_job(file)
        robot, channels = described(job)
        made.append(prepare(job, robot, channels, job.recordings[0]))
        elsewhere = [replace(channels[0], wrench_frame="elbow_link")]
        kept = [ingredients(job, robot, some, job.recordings[0]) for some in (channels, elsewhere)]
        assert kept[0] != kept[1]
    (ours,), (theirs,) = (one.sensors["ft_sensor"].segments for one in made)
    np.testing.assert_allclose(ours.channels, theirs.channels, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(ours.wrench, theirs.wrench)


def test_recordings_read_again_are_turned_again(turned: Path) -> None:
    job = read_job(turned)
    robot, channels = described(job)
    kept, again = (
        takes.Takes.read(job, robot, channels, Steps(silent, 9), m) for m in (1 << 30, 0)
    )
    for one, other in zip(kept, again, strict=True):
        assert_same(one, other)


@pytest.mark.parametrize("link", ["base", "shoulder_link", "elbow_link", "wrist_link"])
def test_the_diagnosis_names_the_link_and_the_key(link: str) -> None:
    time, joints, channels = take(1)
    wrench = driven(joints, channels @ PRIOR.gain.T, link)
    log = recorded(time, Signal("joints", JOINTS, stamps(time), joints), wrench)
    schedule = ContactSchedule((Interval(0.0, 40.0, "base"),))
    told = diagnose(log, arm(), schedule, signals={"ft_sensor": "ft"})
    assert told.word == "wrong reading"
    assert told.sentence.startswith(f'for ft_sensor say wrench_frame = "{link}" in the job')
    assert told.sensors[0].words == f"in the axes of {link}"
    before, after = told.parts[0].misfit
    assert before > 1.0 > after


def ran(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_inspect_names_the_key(turned: Path) -> None:
    log, robot = turned.parent / "one.csv", turned.parent / "arm.urdf"
    told = ran("inspect", log, "--robot", robot, "--contact", "base", "--diagnose")
    assert told.exit_code == 0, told.output
    assert f'say wrench_frame = "{LINK}"' in " ".join(told.output.split())


@pytest.fixture(scope="module")
def written(found: Outcome, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("calibration") / "calibration.json"
    file.write_bytes(to_json(found.calibration))
    return file


def test_the_file_keeps_the_link_and_says_nothing_where_there_is_none(
    written: Path, found: Outcome, expected: Outcome
) -> None:
    assert read_calibration(written) == found.calibration
    assert b'"wrench_frame"' not in to_json(expected.calibration)


def test_apply_turns_the_log_back_and_says_so(
    written: Path, turned: Path, plain: Path, expected: Outcome, tmp_path: Path
) -> None:
    out, log = tmp_path / "out.parquet", turned.parent / "two.csv"
    done = ran("apply", written, log, "-o", out, "--robot", turned.parent / "arm.urdf")
    assert done.exit_code == 0, done.output
    assert f"turned from the axes of {LINK} into the sensor's, stand" in done.output
    apply(expected.calibration, logs.in_pieces(plain.parent / "two.csv"), tmp_path / "in.parquet")
    ours, theirs = (logs.read(tmp_path / f"{name}.parquet").channels[0] for name in ("out", "in"))
    np.testing.assert_array_equal(ours.stamps, theirs.stamps)
    # the two calibrations agree to 1e-9 of loads of a few hundred N
    np.testing.assert_allclose(ours.values, theirs.values, rtol=0, atol=1e-5)


def test_apply_gives_the_same_bits_however_long_the_pieces_are(
    written: Path, turned: Path, tmp_path: Path
) -> None:
    known, log = read_calibration(written), logs.in_pieces(turned.parent / "two.csv")
    made = []
    for name, rows in (("a", 37), ("b", None)):
        apply(known, log, tmp_path / f"{name}.parquet", rows=rows, robot=arm())
        made.append(logs.read(tmp_path / f"{name}.parquet").channels[0].values.tobytes())
    assert made[0] == made[1]


def test_apply_without_the_robot_is_refused(written: Path, turned: Path, tmp_path: Path) -> None:
    refused = ran("apply", written, turned.parent / "two.csv", "-o", tmp_path / "out.csv")
    assert refused.exit_code == 1
    assert f"'ft' is in the axes of '{LINK}'" in refused.output
    assert "give --robot URDF" in refused.output
    assert not (tmp_path / "out.csv").exists()


def test_a_control_loop_must_turn_the_sample_itself(found: Outcome, expected: Outcome) -> None:
    (ours,), (theirs,) = found.calibration.sensors, expected.calibration.sensors
    with pytest.raises(DataError, match=r"axes of 'wrist_link'.*in_own_frame"):
        WrenchReader(ours)
    own, other = WrenchReader(ours.in_own_frame()), WrenchReader(theirs)
    np.testing.assert_allclose(own.read(WRENCH), other.read(WRENCH), rtol=1e-7)


def test_an_export_says_where_the_driver_may_turn(written: Path, tmp_path: Path) -> None:
    (remarks,) = export(written, "c", tmp_path / "ft.h", offset="auto").remarks.values()
    assert any("into the axes of wrist_link comes after it" in remark for remark in remarks)


def test_the_loads_of_such_a_log_cannot_be_compared(written: Path, turned: Path) -> None:
    refused = ran("diff", written, written, "--log", turned.parent / "two.csv")
    assert refused.exit_code == 1
    assert f"'ft' is in the axes of '{LINK}'" in " ".join(refused.output.split())
    assert ran("diff", written, written).exit_code == 0


def changed(file: Path, folder: Path, old: str, new: str) -> Path:
    """Copy the job beside the files that it names, changed in one place."""
    text = file.read_text()
    assert old in text
    job = file.parent / f"{folder.name}.toml"
    job.write_text(text.replace(old, new))
    return job


def test_an_unknown_link_is_offered_the_near_name(turned: Path, tmp_path: Path) -> None:
    job = changed(turned, tmp_path, f'"{LINK}"', '"wrist_lnk"')
    with pytest.raises(
        RobotError, match=r"'ft_sensor': wrench_frame: no link 'wrist_lnk'.*wrist_link"
    ):
        calibrate(read_job(job))


def test_raw_channels_have_no_axes(turned: Path, tmp_path: Path) -> None:
    job = changed(turned, tmp_path, 'logged = "wrench"', 'logged = "channels"')
    with pytest.raises(JobError, match=r"'ft_sensor': wrench_frame = 'wrist_link'.*raw channels"):
        read_job(job)
