"""Facts about units: what a job declares is converted, and what it declares wrongly is noticed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ftcal.config import read_job
from ftcal.errors import LogError
from ftcal.health import examine
from ftcal.logs import Layout, read
from ftcal.logs.layout import Acceleration, Angle, AngularVelocity
from ftcal.logs.units import STANDARD_G, factor, in_si, inertial_columns
from ftcal.recording import Finding, Recording, Signal
from ftcal.robot import Robot
from ftcal.turns import Turns
from ftcal.urdf import parse_robot, read_robot
from real import DATA, GENOVA02, needs_genova02
from small_world import JOINTS, robot_text, take, write_world

ATI = DATA / "ati-gamma-lbrmed"
SIX = ("ax", "ay", "az", "gx", "gy", "gz")
ARM = parse_robot(robot_text(), name="arm")


def recording(**signals: Signal) -> Recording:
    empty: tuple[Signal, ...] = ()
    roles = {role: (signals[role],) if role in signals else empty
             for role in ("joints", "channels", "imus")}  # fmt: skip
    return Recording("take", "take.csv", 0, roles["joints"], roles["channels"], (), roles["imus"])


def clock(count: int, period: float = 0.01) -> np.ndarray:
    return (np.arange(count) * round(period * 1e9)).astype(np.int64)


def turning_imu(seed: int = 0, *, noise: float = 0.2) -> Signal:
    """Return 20 s of an imu that is turned about by hand, with noise on all six columns [SI]."""
    rng = np.random.default_rng(seed)
    time = np.arange(2000) / 100.0
    rate = np.column_stack(
        [0.8 * np.sin(rng.uniform(0.5, 2.0) * time + rng.uniform(0, 6)) for _ in range(3)]
    )
    felt = np.empty((len(time), 3))
    felt[0] = [0.0, 0.0, STANDARD_G]
    for k, w in enumerate(rate[:-1]):
        angle = np.linalg.norm(w) * 0.01
        axis = w / np.linalg.norm(w)
        # Rodrigues: what stays in the world turns the other way in the imu
        felt[k + 1] = (
            felt[k] * np.cos(angle)
            - np.cross(axis, felt[k]) * np.sin(angle)
            + axis * (axis @ felt[k]) * (1.0 - np.cos(angle))
        )
    values = np.hstack([felt, rate])
    values += noise * np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1]) * rng.normal(size=values.shape)
    return Signal("waist", SIX, clock(len(time)), values)


def logged_in(signal: Signal, linear: Acceleration, angular: AngularVelocity) -> Signal:
    """Return `signal` [SI] as a log in other units holds it."""
    scale = np.repeat([{"g": STANDARD_G, "m/s^2": 1.0}[linear],
                       {"deg/s": np.pi / 180, "rad/s": 1.0}[angular]], 3)  # fmt: skip
    return replace(signal, values=signal.values / scale)


def doubts(*findings: Finding) -> list[str]:
    units = [f for f in findings if f.kind == "unit"]
    assert not any(f.cut for f in units)
    return [f.message for f in units]


def turn_ratio(imu: Signal) -> float:
    turns = Turns([0, 1, 2], [3, 4, 5], imu.period)
    turns.see(imu.stamps, imu.values.T)
    return turns.ratio()


@pytest.mark.parametrize(
    ("unit", "expected"),
    [("rad", 1.0), ("Degrees", np.pi / 180), (" deg/s ", np.pi / 180), ("m/s2", 1.0), ("N*m", 1.0),
     ("g", STANDARD_G), ("Nm", 1.0), ("mN", 1e-3), ("furlong", None), ("", None)],
)  # fmt: skip
def test_units_are_known_in_usual_spellings(unit: str, expected: float | None) -> None:
    assert factor(unit) == expected


def test_inertial_columns_are_known_by_order_or_by_name() -> None:
    six = Signal("waist", tuple("abcdef"), clock(1), np.zeros((1, 6)))
    assert inertial_columns(six) == ([0, 1, 2], [3, 4, 5])
    yarp = ("roll", "pitch", "yaw", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")
    assert inertial_columns(replace(six, columns=yarp)) == ([3, 4, 5], [6, 7, 8])
    gyro = ("omega_x", "omega_y", "omega_z")
    assert inertial_columns(replace(six, columns=gyro)) == ([], [0, 1, 2])
    assert inertial_columns(replace(six, columns=("ax", "ay"))) == ([], [])


@given(
    linear=st.sampled_from(["g", "m/s^2"]), angular=st.sampled_from(["deg/s", "rad/s"]),
    values=st.lists(st.floats(-1e3, 1e3), min_size=6, max_size=6),
)  # fmt: skip
def test_declared_units_of_imus_come_back_as_si(
    linear: Acceleration, angular: AngularVelocity, values: list[float]
) -> None:
    si = Signal("waist", SIX, clock(1), np.array([values]))
    log = recording(imus=logged_in(si, linear, angular))
    (back,) = in_si(log, Layout(acceleration=linear, angular_velocity=angular)).imus
    np.testing.assert_allclose(
        back.values, si.values, rtol=1e-15, atol=1e-300
    )  # one rounding each way


def test_nothing_declared_changes_nothing() -> None:
    log = recording(imus=turning_imu())
    assert in_si(log, Layout()) is log


def test_unit_of_columns_that_are_not_there_is_refused() -> None:
    log = recording(imus=Signal("waist", ("c0", "c1"), clock(1), np.zeros((1, 2))))
    with pytest.raises(LogError, match="acceleration = 'g', but no imu has columns called ax, ay"):
        in_si(log, Layout(acceleration="g", angular_velocity="deg/s"))


def test_job_file_declares_units(tmp_path: Path) -> None:
    job = write_world(tmp_path)
    said = 'contact = "base"\nacceleration = "g"\nangular_velocity = "deg/s"\n'
    job.write_text(job.read_text().replace('contact = "base"\n', said, 1))
    layout = read_job(job).recordings[0].layout()
    assert (layout.acceleration, layout.angular_velocity) == ("g", "deg/s")


@pytest.mark.parametrize("seed", range(5))
def test_imu_in_si_is_not_doubted(seed: int) -> None:
    assert examine(recording(imus=turning_imu(seed))) == ()


@pytest.mark.parametrize("seed", range(3))
def test_g_and_degrees_read_as_si_are_named(seed: int) -> None:
    wrong = logged_in(turning_imu(seed), "g", "deg/s")
    linear, angular = doubts(*examine(recording(imus=wrong)))
    assert linear.startswith("waist: feels ")
    assert linear.endswith('gravity is 9.807: g? say acceleration = "g"')
    assert angular.endswith('say angular_velocity = "deg/s"')


def test_si_declared_as_g_and_degrees_is_named() -> None:
    layout = Layout(acceleration="g", angular_velocity="deg/s")
    wrong = in_si(recording(imus=turning_imu()), layout)
    linear, angular = doubts(*examine(wrong))
    assert linear.endswith("already m/s^2? leave acceleration out")
    assert angular.endswith("already rad/s? leave angular_velocity out")


def test_gyroscope_at_rest_says_nothing_of_its_unit() -> None:
    imu = turning_imu()
    still = np.tile([0.0, 0.0, STANDARD_G, 0.0, 0.0, 0.0], (len(imu), 1))
    still += 0.01 * np.random.default_rng(0).normal(size=still.shape)
    resting = replace(imu, values=still)
    assert np.isnan(turn_ratio(resting))
    assert examine(recording(imus=resting)) == ()


def test_turn_of_gravity_is_not_taken_across_a_hole() -> None:
    imu = turning_imu(noise=0.0)
    kept = np.r_[0:500, 1200:2000]
    holed = replace(imu, stamps=imu.stamps[kept], values=imu.values[kept])
    ratio = turn_ratio(holed)
    # rectangles for the integral of a smooth rate over 0.2 s, chords for the arcs
    assert ratio == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize(("angle", "doubted"), [("rad", False), ("deg", True)])
@pytest.mark.parametrize("robot", [None, ARM])
def test_degrees_read_as_radians_are_named(
    angle: Angle, doubted: bool, robot: Robot | None
) -> None:
    time, joints, _ = take(1)
    values = np.rad2deg(joints) if angle == "deg" else joints
    signal = Signal("arm", JOINTS, clock(len(time)), values)
    found = doubts(*examine(recording(joints=signal), robot=robot))
    assert bool(found) == doubted
    if doubted:
        assert "go beyond a full turn: degrees? say angle" in found[0]


def test_columns_that_are_no_joints_are_not_doubted() -> None:
    rng = np.random.default_rng(0)
    values = np.hstack([0.5 * rng.normal(size=(100, 3)), 50.0 * rng.normal(size=(100, 9))])
    names = (*JOINTS, *(f"motor_{k}" for k in range(9)))
    log = recording(joints=Signal("arm", names, clock(100), values))
    assert doubts(*examine(log, robot=ARM)) == []


@pytest.mark.parametrize(
    ("period", "hint"), [(10.0, 'time_unit = "ms"'), (1e4, '"us"'), (1e-8, 'time_unit = "s"')]
)
def test_stamps_in_a_wrong_unit_are_named(period: float, hint: str) -> None:
    count = 100
    stamps = np.arange(count) * max(round(period * 1e9), 1)
    signal = Signal("left", ("fx",), stamps, np.random.default_rng(0).normal(size=(count, 1)))
    (message,) = doubts(*examine(recording(channels=signal)))
    assert hint in message


@needs_genova02
@pytest.mark.parametrize("folder", ["icub-genova02/left_leg_support", "icub-genova01/torso_sweep"])
def test_real_robots_are_not_doubted_in_degrees_and_are_in_radians(folder: str) -> None:
    robot = read_robot(GENOVA02 / "iCubGenova02.urdf")
    log = read(DATA / folder)
    assert doubts(*examine(log), *examine(log, robot=robot)) == []
    wrong = read(DATA / folder, Layout(angle="rad"))
    assert len(doubts(*examine(wrong, robot=robot))) >= 2


@pytest.mark.skipif(not ATI.is_dir(), reason="shared/data/ati-gamma-lbrmed is not here")
def test_real_accelerometer_in_g_is_named() -> None:
    layout = Layout(time="t", imus={"tool": ("ax", "ay", "az")})
    (message,) = doubts(*examine(read(ATI / "1-baseline_accel.csv", layout)))
    assert 'say acceleration = "g"' in message
    told = replace(layout, acceleration="g")
    assert doubts(*examine(read(ATI / "1-baseline_accel.csv", told))) == []
    for name in ("wrench", "orientations"):
        assert doubts(*examine(read(ATI / f"1-baseline_{name}.csv", Layout(time="t")))) == []
