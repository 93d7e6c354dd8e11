"""The pretend robot: motions a robot may make, a sensor that obeys its law, logs that read back."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal import logs
from ftcal.config import read_job
from ftcal.dynamics import expected_wrenches
from ftcal.errors import DataError, JobError, OutputError, RobotError, SensorError
from ftcal.health import CEILING, examine
from ftcal.motion import FixedContact, Motion
from ftcal.motions import MinimumJerk, Pace, balancing, extended_balancing, grid
from ftcal.robot import Robot
from ftcal.sensor import SensorModel
from ftcal.support import standing_on
from ftcal.synthetic import (
    TRUTH,
    Conditions,
    SensorTruth,
    Session,
    Take,
    invent_firmware,
    mount,
    read_truth,
    simulate,
    write_session,
)
from ftcal.urdf import parse_robot, read_robot
from ftcal.workbench import read_workbench
from small_world import robot_text

IDEAL = Conditions(noise=0.0, digital=False, encoder=0.0, flicker=0.0)
"""A session that is the law and nothing else."""

POLE = standing_on(FixedContact("base"))
FT = {"ft_sensor": "ft"}
MASS = 1.0
"""Of each moving link [kg]: an arm light enough for a sensor of an iCub's size."""

ARM = ("shoulder", "elbow", "wrist")
LEG = ("r_hip_pitch", "r_hip_roll", "r_hip_yaw", "r_knee", "r_ankle_pitch", "r_ankle_roll")
SUPPORT = tuple(name.replace("r_", "l_", 1) for name in LEG)


@functools.cache
def arm() -> Robot:
    return parse_robot(robot_text(MASS))


@functools.cache
def icub() -> Robot:
    pytest.importorskip("icub_models", reason="the iCub's models are an extra: ftcal[demo]")
    from ftcal.demonstration import icub_path

    return read_robot(icub_path())


def robot_named(name: str) -> tuple[Robot, tuple[str, ...], tuple[str, ...]]:
    return (arm(), ARM, ()) if name == "arm" else (icub(), LEG, SUPPORT)


def motion_named(kind: str, robot: str, seed: int = 0) -> tuple[Robot, MinimumJerk]:
    model, joints, support = robot_named(robot)
    if kind == "grid":
        return model, grid(model, joints[:2], points=(3, 4), duration=120.0)
    rng = np.random.default_rng(seed)
    make = balancing if kind == "balancing" else extended_balancing
    return model, make(model, joints, generator=rng, support=support, duration=30.0)


KINDS = pytest.mark.parametrize("kind", ["grid", "balancing", "extended"])
ROBOTS = pytest.mark.parametrize("robot", ["arm", "icub"])


@KINDS
@ROBOTS
def test_limits_are_respected(kind: str, robot: str) -> None:
    model, trajectory = motion_named(kind, robot)
    moved = trajectory.sampled(200.0)
    # the widest pace of the three motions
    pace = Pace()
    for column, name in enumerate(moved.joints):
        joint = model.joint(name)
        assert moved.position[:, column].min() >= joint.lower + pace.margin - 1e-9
        assert moved.position[:, column].max() <= joint.upper - pace.margin + 1e-9
        assert np.abs(moved.velocity[:, column]).max() <= min(joint.velocity, pace.speed) + 1e-9
    assert np.abs(moved.acceleration).max() <= pace.acceleration + 1e-9


@KINDS
@ROBOTS
def test_derivatives_are_those_of_the_position(kind: str, robot: str) -> None:
    _, trajectory = motion_named(kind, robot)
    h = 1e-4
    time = np.linspace(0.0, trajectory.duration, 2000)
    before, here, after = (trajectory.at(time + shift) for shift in (-h, 0.0, h))
    velocity = (after.position - before.position) / (2 * h)
    acceleration = (after.velocity - before.velocity) / (2 * h)
    # central differences err by the next derivatives, here at most 1e3 h^2, and by h times the
    # jump of the jerk at a waypoint, at most 1e2 h
    np.testing.assert_allclose(here.velocity, velocity, atol=1e-5)
    np.testing.assert_allclose(here.acceleration, acceleration, atol=1e-2)


@KINDS
def test_acceleration_is_continuous_at_every_waypoint(kind: str) -> None:
    _, trajectory = motion_named(kind, "arm")
    before = trajectory.at(trajectory.times - 1e-9)
    after = trajectory.at(trajectory.times + 1e-9)
    np.testing.assert_allclose(before.acceleration, after.acceleration, atol=1e-6)
    np.testing.assert_allclose(after.acceleration, 0.0, atol=1e-6)


@given(seed=st.integers(0, 2**32), seconds=st.floats(25.0, 100.0), reach=st.floats(0.05, 1.0))
@settings(max_examples=25, deadline=None)
def test_random_motions_last_as_long_as_asked_and_end_where_they_began(
    seed: int, seconds: float, reach: float
) -> None:
    rng = np.random.default_rng(seed)
    trajectory = balancing(arm(), ARM, generator=rng, duration=seconds, reach=reach)
    assert trajectory.duration == seconds
    assert (np.diff(trajectory.times) > 0).all()
    np.testing.assert_array_equal(trajectory.waypoints[0], trajectory.waypoints[-1])


def test_grid_visits_every_point_and_settles() -> None:
    trajectory = grid(arm(), ARM[:2], points=(3, 4), duration=120.0, settle=1.5)
    moved = trajectory.sampled()
    still = (moved.velocity == 0.0).all(axis=1)
    places = np.unique(moved.position[still], axis=0)
    assert len(places) == 3 * 4 + 1  # and home
    assert still.sum() >= 1.5 * 12 * 100
    assert trajectory.duration == pytest.approx(120.0)


def test_grid_moves_one_level_at_a_time() -> None:
    nodes = grid(arm(), ARM[:2], points=4, duration=200.0).waypoints[2:-2:2, :2]
    level = (nodes.max(axis=0) - nodes.min(axis=0)) / 3
    moves = np.rint(np.abs(np.diff(nodes, axis=0)) / level)
    np.testing.assert_array_equal(moves.sum(axis=1), 1)


def test_grid_rests_nowhere_twice() -> None:
    # a place that comes again repeats the rounding error of its encoder
    nodes = grid(arm(), ARM[:2], points=4, duration=200.0).waypoints[2:-2:2, :2]
    assert all(len(np.unique(column)) == 16 for column in nodes.T)


def test_other_joints_stay_and_the_support_sways_little() -> None:
    rng = np.random.default_rng(0)
    trajectory = balancing(icub(), LEG, generator=rng, support=SUPPORT, sway=0.02)
    moved = dict(zip(trajectory.joints, np.ptp(trajectory.waypoints, axis=0), strict=True))
    assert all(moved[name] > 0.05 for name in LEG)
    assert all(0.0 < moved[name] <= 0.04 for name in SUPPORT)
    assert not any(span for name, span in moved.items() if name not in (*LEG, *SUPPORT))


def test_extended_balancing_bends_the_knee() -> None:
    trajectory = extended_balancing(icub(), LEG, generator=np.random.default_rng(0))
    knee = trajectory.waypoints[:, trajectory.joints.index("r_knee")]
    assert np.ptp(knee) > 1.0


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: grid(arm(), ["sholder"]), RobotError, "did you mean shoulder"),
        (lambda: grid(arm(), ["ft"]), RobotError, "'ft' is fixed"),
        (lambda: grid(arm(), ["elbow"], duration=5.0), DataError, "take 25 s or fewer points"),
        (lambda: grid(arm(), ["elbow"], points=[2, 3]), DataError, "for 1 joints"),
        (lambda: grid(arm(), ["elbow"], settle=0.0), DataError, "settle"),
        (lambda: grid(arm(), ["elbow"], reach=1.5), DataError, "reach = 1.5"),
        (lambda: grid(arm(), ["elbow"], home={"elbow": 3.0}), RobotError, "outside"),
        (lambda: Pace(speed=0.0), DataError, "speed = 0"),
        (
            lambda: balancing(arm(), ARM, generator=np.random.default_rng(0), duration=2.0),
            DataError,
            "too short",
        ),
        (
            lambda: balancing(arm(), ARM, generator=np.random.default_rng(0), support=["wrist"]),
            DataError,
            "wrist cannot both",
        ),
    ],
)
def test_what_no_robot_can_do_is_refused(make: object, error: type, words: str) -> None:
    assert callable(make)
    with pytest.raises(error, match=words):
        make()


def test_joint_without_limits_goes_a_quarter_turn() -> None:
    wrist = dataclasses.replace(arm().joint("wrist"), lower=-np.inf, upper=np.inf)
    free = dataclasses.replace(arm(), joints={**arm().joints, "wrist": wrist})
    span = grid(free, ["wrist"], reach=1.0).waypoints[:, 2]
    assert (span.min(), span.max()) == pytest.approx((-np.pi / 2, np.pi / 2), rel=0.05)
    slide = dataclasses.replace(wrist, kind="prismatic")
    endless = dataclasses.replace(arm(), joints={**arm().joints, "wrist": slide})
    with pytest.raises(RobotError, match="prismatic joint 'wrist' has no limits"):
        grid(endless, ["wrist"])


def arm_takes(seed: int) -> list[Take]:
    rng = np.random.default_rng(seed)
    return [
        Take("balancing", balancing(arm(), ARM, generator=rng, duration=25.0), POLE),
        Take("wide", extended_balancing(arm(), ARM, generator=rng, duration=25.0), POLE, True),
    ]


def arm_session(seed: int = 1, conditions: Conditions | None = None) -> Session:
    rng = np.random.default_rng(seed)
    return simulate(arm(), arm_takes(seed), sensors=FT, generator=rng, conditions=conditions)


@functools.cache
def icub_session(seed: int, conditions: Conditions | None = None) -> Session:
    robot = icub()
    from ftcal.demonstration import demo_session

    return demo_session(robot, np.random.default_rng(seed), conditions)


def residual(session: Session, number: int) -> np.ndarray:
    """Return `C r + o + k (T - T_ref) - w` of a recording, w by the motion that was simulated."""
    take, recording = session.takes[number], session.recordings[number]
    ((name, truth),) = session.truth.items()
    signal = recording.channels[0]
    time = recording.seconds(signal)
    motion = take.trajectory.at(time)
    (frame,) = take.support.frames
    wrench = expected_wrenches(session.robot, motion, FixedContact(frame), [name])
    counts = truth.firmware.counts(signal.values)
    temperature = None
    if recording.temperatures:
        warm = recording.temperatures[0]
        temperature = np.interp(time, recording.seconds(warm), warm.values[:, 0])
    said = truth.model(recording.name).wrench(counts, temperature)
    return np.asarray(said - wrench[name])


def only_truth(session: Session) -> SensorTruth:
    (truth,) = session.truth.values()
    return truth


@pytest.mark.parametrize("warming", [0.0, 3.0])
def test_ideal_session_obeys_the_law(warming: float) -> None:
    session = arm_session(conditions=dataclasses.replace(IDEAL, warming=warming))
    for number in range(2):
        # counts of 1e4 times a matrix of condition 100 leave some 1e-10 N
        np.testing.assert_allclose(residual(session, number), 0.0, atol=1e-9)


def test_ideal_icub_obeys_the_law_on_pole_and_sole() -> None:
    session = icub_session(0, IDEAL)
    assert [take.support.frames for take in session.takes[:2]] == [("root_link",), ("l_sole",)]
    for number in range(2):
        np.testing.assert_allclose(residual(session, number), 0.0, atol=1e-9)


def test_noise_is_as_large_as_asked() -> None:
    session = arm_session(conditions=dataclasses.replace(IDEAL, noise=5.0))
    noise = np.linalg.solve(only_truth(session).gain, residual(session, 0).T)
    # 6 x 2500 samples: a standard deviation known to 1 %
    assert noise.std() == pytest.approx(5.0, rel=0.05)


def test_digital_readings_are_steps_of_full_scale_and_encoders_have_twelve_bits() -> None:
    session = arm_session()
    recording = session.recordings[0]
    sent = recording.channels[0].values / (only_truth(session).firmware.full_scale / 32768)
    np.testing.assert_allclose(sent, np.rint(sent), atol=1e-6)
    turned = recording.joints[0].values / (2 * np.pi / 4096)
    np.testing.assert_allclose(turned, np.rint(turned), atol=1e-9)
    true = session.takes[0].trajectory.at(recording.seconds(recording.joints[0])).position
    # half a step, and flicker of a fifth of a step seldom beyond one more
    assert np.abs(recording.joints[0].values - true).max() < 1.6 * 2 * np.pi / 4096


def test_every_signal_has_a_clock_of_its_own() -> None:
    recording = icub_session(0).recordings[0]
    signals = (*recording.channels, *recording.joints)
    assert min(int(signal.stamps[0]) for signal in signals) == recording.start
    assert len({int(signal.stamps[0]) for signal in signals}) > 1
    for signal in signals:
        periods = np.diff(signal.stamps) / 1e9
        assert periods.min() > 0
        assert periods.mean() == pytest.approx(0.01, rel=1e-3)
        # two jitters of 0.2 ms apart
        assert periods.std() == pytest.approx(0.2e-3 * np.sqrt(2), rel=0.1)
        assert recording.seconds(signal)[-1] <= icub_session(0).takes[0].trajectory.duration


def test_every_recording_has_an_offset_of_its_own() -> None:
    first, second = only_truth(arm_session()).offsets.values()
    assert np.abs(first - second).min() > 0.01


@pytest.mark.parametrize("seed", range(3))
def test_demo_never_saturates_and_the_data_doctor_finds_nothing_to_cut(seed: int) -> None:
    session = icub_session(seed)
    firmware = only_truth(session).firmware
    for recording in session.recordings:
        counts = firmware.counts(recording.channels[0].values)
        assert np.abs(counts).max() < CEILING
        found = examine(recording, sensors={"right_leg/analog:o": firmware})
        assert not [finding for finding in found if finding.cut]
        assert [finding.kind for finding in found] == ["serial"]


def test_sensor_too_weak_for_the_robot_is_refused() -> None:
    rng = np.random.default_rng(0)
    weak = invent_firmware(rng, full_scale=[100, 100, 100, 5, 5, 5])
    with pytest.raises(DataError, match=r"'SN900' saturates: .* larger full scale"):
        simulate(arm(), arm_takes(0), sensors=FT, generator=rng, firmware={"ft": weak})


@given(seed=st.integers(0, 2**32))
@settings(max_examples=50, deadline=None)
def test_invented_sensors_are_like_real_ones(seed: int) -> None:
    firmware = invent_firmware(np.random.default_rng(seed))
    assert 30 < np.linalg.cond(firmware.matrix) < 150  # SN026: 90
    assert np.linalg.cond(firmware.words / 32768) < 4  # SN026: 2.1
    assert (firmware.full_scale[:3] >= 1500).all()
    assert (firmware.full_scale[3:] <= 40).all()
    needed = np.ceil(32767 * np.abs(firmware.matrix).sum(axis=1))
    np.testing.assert_array_equal(needed, firmware.full_scale)


def test_full_scales_must_be_six_whole_numbers() -> None:
    with pytest.raises(SensorError, match="5 entries"):
        invent_firmware(np.random.default_rng(0), full_scale=[1, 1, 1, 1, 1])


def test_mounting_bends_as_the_scaled_prior_says() -> None:
    firmware = invent_firmware(np.random.default_rng(0))
    rng = np.random.default_rng(1)
    F = firmware.full_scale.astype(float)
    bends = []
    for _ in range(200):
        sensor = mount(firmware, rng, kappa=0.03)
        np.testing.assert_allclose(sensor.gain, sensor.secondary @ firmware.matrix, rtol=1e-12)
        bends.append((sensor.secondary - np.eye(6)) / F[:, None] * F)
    # 7200 entries: a standard deviation known to 1 %
    assert np.std(bends) == pytest.approx(0.03, rel=0.05)


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def written(folder: Path, session: Session) -> Path:
    urdf = folder.parent / "arm.urdf"
    urdf.write_text(robot_text(MASS))
    return write_session(session, folder, urdf=urdf)


def test_written_session_reads_back(tmp_path: Path) -> None:
    session = arm_session(conditions=Conditions(warming=2.0))
    job = read_job(written(tmp_path / "session", session))
    for section, recording in zip(job.recordings, session.recordings, strict=True):
        back = logs.read(job.path(section.log), section.layout())
        assert back.name == recording.name
        assert back.start == recording.start
        assert not back.findings
        for ours, theirs in (
            (recording.joints, back.joints),
            (recording.channels, back.channels),
            (recording.temperatures, back.temperatures),
        ):
            assert [signal.name for signal in ours] == [signal.name for signal in theirs]
            for mine, yours in zip(ours, theirs, strict=True):
                assert mine.columns == yours.columns
                np.testing.assert_array_equal(mine.stamps, yours.stamps)
                # six decimals of N, Nm and degrees
                np.testing.assert_allclose(mine.values, yours.values, atol=6e-7)


def test_job_names_everything_beside_it(tmp_path: Path) -> None:
    session = arm_session()
    job = read_job(written(tmp_path / "session", session))
    assert read_robot(job.path(job.robot)).digest == session.robot.digest
    (sensor,) = job.sensors
    assert sensor.name == "ft_sensor"
    assert sensor.workbench is not None
    workbench = read_workbench(job.path(sensor.workbench), logged=sensor.logged)
    np.testing.assert_array_equal(workbench.gain, only_truth(session).firmware.matrix)
    first, held = job.recordings
    assert first.train is None
    assert held.train == ()
    assert held.test[0][1] > session.recordings[1].duration
    assert first.contact == held.contact == "base"
    np.testing.assert_array_equal(
        read_truth(job.file.with_name(TRUTH))["ft_sensor"], only_truth(session).gain
    )


def test_tilted_contact_tells_the_job_its_gravity(tmp_path: Path) -> None:
    tilted = standing_on(FixedContact("base", (0.0, 9.80665, 0.0)))
    take = dataclasses.replace(arm_takes(0)[0], support=tilted)
    rng = np.random.default_rng(0)
    session = simulate(arm(), [take], sensors=FT, generator=rng)
    job = read_job(written(tmp_path / "session", session))
    assert job.recordings[0].gravity == tilted.gravity


def test_same_seed_writes_the_same_bytes(tmp_path: Path) -> None:
    first, again, other = (
        files_of(written(tmp_path / name, arm_session(seed)).parent)
        for name, seed in (("a", 1), ("b", 1), ("c", 2))
    )
    assert first == again
    assert first.keys() == other.keys()
    changed = {name for name in first if first[name] != other[name]}
    assert "truth.json" in changed
    assert any(name.endswith("data.log") for name in changed)


def test_session_replaces_a_session_but_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    written(folder, arm_session(1))
    job = written(folder, arm_session(2))
    np.testing.assert_array_equal(
        read_truth(job.with_name(TRUTH))["ft_sensor"], only_truth(arm_session(2)).gain
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["arm.urdf", "session"]
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").touch()
    with pytest.raises(OutputError, match="holds other files"):
        written(tmp_path / "mine", arm_session(1))


def test_another_robots_urdf_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.urdf"
    other.write_text(robot_text(mass=9))
    with pytest.raises(RobotError, match="not the file"):
        write_session(arm_session(), tmp_path / "session", urdf=other)
    with pytest.raises(RobotError, match=r"missing\.urdf"):
        write_session(arm_session(), tmp_path / "session", urdf=tmp_path / "missing.urdf")
    assert not (tmp_path / "session").exists()


def test_folder_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written"):
        written(tmp_path / "file", arm_session())
    assert sorted(p.name for p in tmp_path.iterdir()) == ["arm.urdf", "file"]


def test_truth_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(JobError, match=r"truth\.json: not the truth"):
        read_truth(tmp_path / TRUTH)


@pytest.mark.parametrize(
    ("names", "words"),
    [(["a", "a"], "'a' appears twice"), (["../a"], "no folder name"), ([], "there is none")],
)
def test_takes_need_names_of_their_own(names: list[str], words: str) -> None:
    takes = [dataclasses.replace(arm_takes(0)[0], name=name) for name in names]
    with pytest.raises(DataError, match=words):
        simulate(arm(), takes, sensors=FT, generator=np.random.default_rng(0))


def test_signal_becomes_a_port() -> None:
    rng = np.random.default_rng(0)
    take = arm_takes(0)[:1]
    session = simulate(arm(), take, sensors={"ft": "hand"}, generator=rng)
    assert session.sensors == {"ft_sensor": "hand/analog:o"}
    with pytest.raises(DataError, match=r"'\.\./hand' is no port"):
        simulate(arm(), take, sensors={"ft": "../hand"}, generator=rng)


def test_conditions_must_make_sense() -> None:
    with pytest.raises(DataError, match=r"noise = -1 .*; rate = 0"):
        Conditions(noise=-1.0, rate=0.0)


def test_a_users_own_trajectory_will_do() -> None:
    class Swing:
        joints = ("elbow", "shoulder", "wrist")
        duration = 10.0

        def at(self, time: np.ndarray) -> Motion:
            turn = np.outer(np.sin(time), [1.0, 0.5, 0.2])
            rate = np.outer(np.cos(time), [1.0, 0.5, 0.2])
            return Motion(time, self.joints, turn, rate, -turn)

    session = simulate(
        arm(),
        [Take("swing", Swing(), POLE)],
        sensors=FT,
        generator=np.random.default_rng(0),
        conditions=IDEAL,
    )
    np.testing.assert_allclose(residual(session, 0), 0.0, atol=1e-9)


def test_icub_logs_its_parts_in_the_order_of_its_boards() -> None:
    recording = icub_session(0).recordings[0]
    parts = {signal.name: signal.columns for signal in recording.joints}
    assert parts["torso/stateExt:o"] == ("torso_yaw", "torso_roll", "torso_pitch")
    assert parts["right_leg/stateExt:o"] == LEG
    assert sorted(joint for columns in parts.values() for joint in columns) == sorted(
        icub().moving_joints
    )
    assert recording.channels[0].name == "right_leg/analog:o"


def test_model_of_the_truth_is_the_law() -> None:
    session = arm_session()
    model = only_truth(session).model("wide")
    assert isinstance(model, SensorModel)
    np.testing.assert_array_equal(
        model.gain, only_truth(session).secondary @ only_truth(session).firmware.matrix
    )
    assert model.temperature_gain is None
