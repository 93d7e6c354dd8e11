"""Equation (B): what holds together the sensors around a part that touches nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal.balances import Balance, balances, free_sub_models
from ftcal.contact import ContactSchedule, Interval
from ftcal.dynamics import expected_wrenches
from ftcal.errors import DataError, RobotError
from ftcal.external import external_wrenches
from ftcal.kinematics import relative_pose
from ftcal.logs import read
from ftcal.motion import STANDARD_GRAVITY, FixedContact, MovingContact
from ftcal.pairing import FtChannel
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.spatial import wrench_transform
from ftcal.urdf import read_robot
from study_world import (
    BELIEVED,
    ideal,
    moved,
    random_robot,
    schedule,
    seen_motion,
    signal,
    with_readings,
)
from test_real_external import GENOVA01, magnitudes, shank_sensors
from walker import SENSORS, walker

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

TILTED = (0.4, -0.3, -9.7)
# SI units: forces of 100 N, lever arms of metres, through a solve of six unknowns at most
ROUNDING = 1e-10
SOME_ROBOTS = settings(max_examples=4, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def random_readings(robot: Robot, count: int, seed: int) -> dict[str, Float[Array, "N 6"]]:
    rng = np.random.default_rng(seed)
    scale = np.array([100, 100, 100, 10, 10, 10])
    return {name: rng.normal(size=(count, 6)) * scale for name in robot.sensors}


def within(motion_time: Float[Array, "N"], balance: Balance) -> Float[Array, "M"]:
    """Return the rows of a recording at 100 Hz that a balance holds."""
    rows = np.searchsorted(motion_time, balance.time)
    assert np.array_equal(motion_time[rows], balance.time)
    return rows


def size(values: Float[Array, "N K"]) -> float:
    return float(abs(values).max())


@given(seeds)
@SOME_ROBOTS
def test_ideal_readings_leave_nothing(seed: int) -> None:
    robot = random_robot(seed)
    log = moved(robot.moving_joints, np.random.default_rng(seed), seconds=2)
    contacts = schedule((-np.inf, np.inf, f"l{seed % 9}"))
    felt = ideal(log, robot, list(robot.sensors), contacts, TILTED)
    full, channels = with_readings(log, felt)
    found = balances(full, robot, channels, contacts, gravity=TILTED)
    assert found
    for balance in found:
        largest = max(size(balance.required), *map(size, balance.inputs.values()))
        assert size(balance.residual(balance.inputs)) < ROUNDING * largest


@given(seeds)
@SOME_ROBOTS
def test_the_residual_is_minus_the_external_wrench(seed: int) -> None:
    robot = random_robot(seed)
    log = moved(robot.moving_joints, np.random.default_rng(seed), seconds=2)
    contacts = schedule((-np.inf, np.inf, f"l{seed % 9}"))
    motion = seen_motion(log)
    readings = random_readings(robot, len(motion), seed)
    full, channels = with_readings(log, readings)
    external = external_wrenches(robot, motion, FixedContact(f"l{seed % 9}", TILTED), readings)
    for balance in balances(full, robot, channels, contacts, gravity=TILTED):
        rows = within(motion.time, balance)
        expected = -external.wrench[balance.sub_model][rows]
        residual = balance.residual({name: readings[name][rows] for name in balance.inputs})
        assert size(residual - expected) < ROUNDING * size(expected)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return walker()


@pytest.fixture(scope="module")
def log(robot: Robot) -> Recording:
    return moved(robot.moving_joints, np.random.default_rng(0), seconds=8)


ON_LEFT, ON_RIGHT = (0.0, 4.0, "l_sole"), (4.0, 8.0, "r_sole")


@pytest.fixture(scope="module")
def exact(robot: Robot, log: Recording) -> tuple[Recording, list[FtChannel]]:
    return with_readings(log, ideal(log, robot, SENSORS, schedule(ON_LEFT, ON_RIGHT)))


def by_name(found: tuple[Balance, ...]) -> dict[str, Balance]:
    return {balance.sub_model: balance for balance in found}


def on_both(
    recording: Recording,
    robot: Robot,
    channels: list[FtChannel],
    findings: tuple[Finding, ...] = (),
) -> dict[str, Balance]:
    contacts = schedule(ON_LEFT, ON_RIGHT)
    return by_name(
        balances(recording, robot, channels, contacts, gravity=STANDARD_GRAVITY, findings=findings)
    )


def test_a_touched_sub_model_is_left_out_of_that_interval_alone(
    robot: Robot, exact: tuple[Recording, list[FtChannel]]
) -> None:
    found = on_both(exact[0], robot, exact[1])
    assert set(found) == {"trunk", "l_thigh", "r_thigh", "l_foot", "r_foot"}
    assert found["l_foot"].time.min() == 4.0
    assert found["r_foot"].time.max() < 4.0
    for name in ("trunk", "l_thigh", "r_thigh"):
        assert len(found[name].time) == len(found["l_foot"].time) + len(found["r_foot"].time)
        assert (np.diff(found[name].time) > 0).all()
    for balance in found.values():
        # of the 300 N that the robot weighs
        assert size(balance.residual(balance.inputs)) < ROUNDING * 300


def test_samples_between_the_intervals_are_not_used(
    robot: Robot, exact: tuple[Recording, list[FtChannel]]
) -> None:
    contacts = schedule((1.0, 2.0, "l_sole"), (5.0, 6.0, "r_sole"))
    found = balances(exact[0], robot, exact[1], contacts, gravity=STANDARD_GRAVITY)
    time = by_name(found)["trunk"].time
    assert len(time) == 200
    assert (((time >= 1) & (time < 2)) | ((time >= 5) & (time < 6))).all()


def test_no_sub_model_that_somebody_else_touches_is_free(robot: Robot) -> None:
    free = free_sub_models(robot, SENSORS, ("l_sole", "r_shin"))
    assert {model.name for model in free} == {"trunk", "l_thigh", "r_foot"}
    with pytest.raises(RobotError, match="no link 'r_shinn'; did you mean r_shin"):
        free_sub_models(robot, SENSORS, ("r_shinn",))


@pytest.mark.parametrize("direction", ["child_to_parent", "parent_to_child"])
def test_a_leaf_implies_what_its_model_expects(log: Recording, direction: str) -> None:
    robot = walker(direction)
    motion = seen_motion(log)
    full, channels = with_readings(log, random_readings(robot, len(motion), 3))
    foot = on_both(full, robot, channels)["r_foot"]
    rows = within(motion.time, foot)
    (sensor,) = foot.inputs
    standing = FixedContact("l_sole")
    expected = expected_wrenches(robot, motion.rows(rows), standing, [sensor])[sensor]
    # whatever the sensor itself reads
    for readings in (foot.inputs, {sensor: np.zeros((len(rows), 6))}):
        implied = foot.implied(sensor, readings)
        assert size(implied - expected) < ROUNDING * size(expected)


def test_what_is_implied_of_a_sensor_does_not_depend_on_its_own_reading(
    robot: Robot, log: Recording
) -> None:
    full, channels = with_readings(log, random_readings(robot, 800, 4))
    thigh = on_both(full, robot, channels)["l_thigh"]
    for name in thigh.inputs:
        implied = thigh.implied(name, thigh.inputs)
        closed = thigh.residual({**thigh.inputs, name: implied})
        assert size(closed) < ROUNDING * size(thigh.required)
        other = thigh.implied(name, {**thigh.inputs, name: thigh.inputs[name] + 7.0})
        assert np.array_equal(implied, other)


def test_a_row_of_a_matrix_touches_its_own_axis_alone(
    robot: Robot, exact: tuple[Recording, list[FtChannel]]
) -> None:
    thigh = on_both(exact[0], robot, exact[1])["r_thigh"]
    for name, right in thigh.inputs.items():
        for axis in range(6):
            wrong = np.eye(6)
            wrong[axis] += np.linspace(-0.1, 0.1, 6)
            error = right @ wrong.T - thigh.implied(name, thigh.inputs)
            others = np.delete(error, axis, axis=1)
            assert size(error[:, axis]) > 0.1
            assert size(others) < ROUNDING * size(right)


@pytest.mark.parametrize(
    ("between", "inner", "outer"),
    [("r_foot_ft_sensor", "r_thigh", "r_foot"), ("l_leg_ft_sensor", "trunk", "l_thigh")],
)
def test_a_union_of_free_sub_models_says_nothing_new(
    robot: Robot, log: Recording, between: str, inner: str, outer: str
) -> None:
    motion = seen_motion(log)
    full, channels = with_readings(log, random_readings(robot, len(motion), 8))
    parts = on_both(full, robot, channels)
    union = on_both(full, robot, [c for c in channels if c.sensor != between])[inner]
    assert set(union.inputs) == {*parts[inner].inputs, *parts[outer].inputs} - {between}
    # where both parts are free; the sensor between them acts on each in opposite senses
    rows = np.intersect1d(within(motion.time, parts[inner]), within(motion.time, parts[outer]))
    assert len(rows) > 300
    total = np.zeros((len(rows), 6))
    for name in (inner, outer):
        some = np.isin(within(motion.time, parts[name]), rows)
        residual = parts[name].residual(parts[name].inputs)[some]
        here = relative_pose(robot, motion.rows(rows), inner, name)
        total += np.einsum("nij,nj->ni", wrench_transform(here), residual)
    some = np.isin(within(motion.time, union), rows)
    assert size(union.residual(union.inputs)[some] - total) < ROUNDING * size(total)


def test_a_frozen_sensor_drops_only_the_equations_that_use_it(
    robot: Robot, exact: tuple[Recording, list[FtChannel]]
) -> None:
    recording, channels = exact
    frozen = "l_leg_ft_sensor"
    finding = Finding("frozen", f"{frozen}/analog:o", 2.0, 3.0, True, "frozen")
    told = Finding("frozen", "r_leg_ft_sensor/analog:o", 2.0, 3.0, False, "told, not cut")
    whole = on_both(recording, robot, channels)
    cut = on_both(recording, robot, channels, (finding, told))
    assert set(cut) == set(whole)
    for name, balance in whole.items():
        lost = (balance.time >= 2.0) & (balance.time < 3.0) & (frozen in balance.inputs)
        assert np.array_equal(cut[name].time, balance.time[~lost]), name
    assert len(cut["trunk"].time) == len(whole["trunk"].time) - 100


def without_joints(recording: Recording, *names: str) -> Recording:
    (joints,) = recording.joints
    kept = [k for k, name in enumerate(joints.columns) if name not in names]
    fewer = signal("joints", [joints.columns[k] for k in kept], joints.values[:, kept])
    return replace(recording, joints=(fewer,))


def test_unlogged_joints_drop_only_the_sub_models_that_need_them(
    robot: Robot, exact: tuple[Recording, list[FtChannel]]
) -> None:
    recording, channels = exact
    whole = on_both(recording, robot, channels)
    part = on_both(without_joints(recording, "r_ankle"), robot, channels)
    # on the left sole all but the right thigh and foot are known; on the right one the foot alone,
    # which it touches
    assert set(part) == {"trunk", "l_thigh"}
    for name, balance in part.items():
        first = whole[name].time < 4.0
        assert np.array_equal(balance.time, whole[name].time[first])
        assert np.array_equal(balance.required, whole[name].required[first])


def test_an_interval_without_a_known_sub_model_does_not_spoil_the_others(
    robot: Robot, exact: tuple[Recording, list[FtChannel]]
) -> None:
    recording, channels = exact
    hip = [channel for channel in channels if channel.sensor == "r_leg_ft_sensor"]
    fewer = without_joints(recording, "r_ankle")
    held = (0.0, 4.0, "r_thigh")
    first, both = (
        by_name(balances(fewer, robot, hip, schedule(*spans), gravity=STANDARD_GRAVITY))
        for spans in ([held], [held, ON_RIGHT])
    )
    assert set(first) == {"trunk"}
    assert np.array_equal(first["trunk"].time, both["trunk"].time)


def test_a_sensor_may_be_named_by_the_joint_it_sits_in() -> None:
    robot = random_robot(1)
    log = moved(robot.moving_joints, np.random.default_rng(1), seconds=2)
    contacts = schedule((-np.inf, np.inf, "l0"))
    felt = ideal(log, robot, list(robot.sensors), contacts)
    full, channels = with_readings(log, felt)
    by_joint = [replace(c, sensor=robot.sensor(c.sensor).joint) for c in channels]
    named, plain = (
        balances(full, robot, some, contacts, gravity=STANDARD_GRAVITY)
        for some in (by_joint, channels)
    )
    assert [b.sub_model for b in named] == [b.sub_model for b in plain]


def test_no_free_sub_model_is_an_error_that_names_the_recording(
    robot: Robot, exact: tuple[Recording, list[FtChannel]]
) -> None:
    recording, channels = exact
    both = ContactSchedule((Interval(0.0, 4.0, "l_sole", ("r_sole", "trunk", "l_shin", "r_shin")),))
    with pytest.raises(DataError, match="recording 'take': no sub-model is ever free"):
        balances(recording, robot, channels, both, gravity=STANDARD_GRAVITY)


def test_an_interval_beyond_the_log_is_an_error_that_names_the_recording(
    robot: Robot, exact: tuple[Recording, list[FtChannel]]
) -> None:
    later = schedule((90.0, 95.0, "l_sole"))
    with pytest.raises(DataError, match="recording 'take': no sub-model"):
        balances(exact[0], robot, exact[1], later, gravity=STANDARD_GRAVITY)


def test_sensors_with_clocks_of_their_own_meet_on_that_of_the_first(
    robot: Robot, exact: tuple[Recording, list[FtChannel]]
) -> None:
    recording, channels = exact
    late = [s if k == 0 else replace(s, stamps=s.stamps + 4_000_000)
            for k, s in enumerate(recording.channels)]  # fmt: skip
    found = on_both(replace(recording, channels=tuple(late)), robot, channels)
    whole = on_both(recording, robot, channels)
    assert np.array_equal(found["trunk"].time, whole["trunk"].time)
    inputs, exactly = (b["r_thigh"].inputs["r_leg_ft_sensor"] for b in (found, whole))
    first, last = 100, 250
    share = 0.6 * exactly[first:last] + 0.4 * exactly[first - 1 : last - 1]
    assert size(inputs[first:last] - share) < ROUNDING * size(share)


def test_temperature_is_the_last_input(
    robot: Robot, exact: tuple[Recording, list[FtChannel]]
) -> None:
    recording, channels = exact
    warm = 30.0 + recording.seconds(recording.channels[0])
    full = replace(recording, temperatures=(signal("warm", ["T"], warm[:, None]),))
    warmed = [replace(channel, temperature="warm") if "foot" in channel.sensor else channel
              for channel in channels]  # fmt: skip
    thigh = on_both(full, robot, warmed)["l_thigh"]
    assert thigh.inputs["l_leg_ft_sensor"].shape[1] == 6
    assert np.allclose(thigh.inputs["l_foot_ft_sensor"][:, 6], 30 + thigh.time, rtol=1e-12)


def test_the_workbench_turns_logged_wrenches_back_into_channels(
    robot: Robot, exact: tuple[Recording, list[FtChannel]]
) -> None:
    gain = np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])
    logged = replace(BELIEVED, gain=gain, logged="wrench")
    raw = on_both(exact[0], robot, [replace(c, workbench=logged) for c in exact[1]])["r_foot"]
    plain = on_both(*(exact[0], robot, exact[1]))["r_foot"]
    for name, inputs in raw.inputs.items():
        assert np.allclose(inputs @ gain.T, plain.inputs[name], rtol=1e-12)


def test_a_contact_that_moves_as_an_imu_says_leaves_nothing_either(robot: Robot) -> None:
    log = moved(robot.moving_joints, np.random.default_rng(5), seconds=4)
    motion = seen_motion(log)
    rng = np.random.default_rng(6)
    time = motion.time[:, None]
    waves = np.sin(2 * np.pi * rng.uniform(0.05, 0.2, 6) * time + rng.uniform(0, 6, 6))
    unit = signal("imu", ["ax", "ay", "az", "wx", "wy", "wz"],
                  waves * 0.5 + [0, 0, 9.8, 0, 0, 0])  # fmt: skip
    # the contact's motion is what the joints' filter finds in the IMU
    smoothed = seen_motion(replace(log, joints=(unit,)))
    contact = MovingContact(
        "trunk",
        -smoothed.position[:, :3],
        smoothed.position[:, 3:],
        np.zeros((len(motion), 3)),
        smoothed.velocity[:, 3:],
    )
    felt = expected_wrenches(robot, motion, contact, SENSORS)
    full, channels = with_readings(log, felt)
    pole = schedule((-np.inf, np.inf, "trunk"))
    found = balances(
        replace(full, imus=(unit,)), robot, channels, pole, gravity=STANDARD_GRAVITY, imu="imu"
    )
    assert set(by_name(found)) == {"l_thigh", "r_thigh", "l_foot", "r_foot"}
    for balance in found:
        assert size(balance.residual(balance.inputs)) < ROUNDING * 300
    still = balances(full, robot, channels, pole, gravity=STANDARD_GRAVITY)
    # newtons: the motion of the contact matters
    assert max(size(balance.residual(balance.inputs)) for balance in still) > 1.0


@pytest.mark.skipif(not GENOVA01.is_dir(), reason="shared/data/icub-genova01 is not here")
def test_shanks_of_genova01_feel_what_its_readme_says() -> None:
    icub_models = pytest.importorskip("icub_models")
    robot = read_robot(Path(icub_models.get_model_file("iCubGenova01")))
    standing = ContactSchedule((Interval(-np.inf, np.inf, "l_sole", ("r_sole",)),))
    channels = [
        FtChannel(sensor, f"{side}_{part}/analog:o", BELIEVED)
        for side in ("left", "right")
        for sensor, part in zip(shank_sensors(robot, side), ("leg", "foot"), strict=True)
    ]
    found = by_name(balances(read(GENOVA01 / "torso_sweep"), robot, channels, standing,
                             gravity=STANDARD_GRAVITY))  # fmt: skip
    for shank, force in (("l_hip_3", 4.91), ("r_hip_3", 5.03)):
        inputs = found[shank].inputs
        wrench = found[shank].residual({name: r - r.mean(axis=0) for name, r in inputs.items()})
        # the margin is that of the issue; offsets unknown, so all is about the mean
        assert magnitudes(wrench - wrench.mean(axis=0)) == pytest.approx((force, 1.10), rel=0.05)
