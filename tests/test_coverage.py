"""How often the true wrench lies in the interval that `apply --sd` predicts, over 50 sessions.

Every session is a new sensor in the wrist of an arm, its gain bent as mounting bends one; two takes
logged to files, the whole pipeline, and then loads inside the training envelope that neither take
held. Noise on the channels remembers a third of a second. The masses are known, or wrong by 3 %.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from ftcal.applying import corrected
from ftcal.calibration import Calibration, SensorCalibration
from ftcal.config import read_job
from ftcal.dynamics import expected_wrenches
from ftcal.motion import FixedContact, Motion
from ftcal.pipeline import calibrate
from ftcal.recording import NANOSECONDS, Recording, Signal
from ftcal.sensor import AXES
from ftcal.urdf import parse_robot
from pretend import FULL_SCALE, bent
from small_world import JOB, JOINTS, PRIOR, write_log

pytestmark = pytest.mark.slow

SESSIONS = 50
LOADS = 100
MEMORY = 30
"""Samples, at 100 Hz, over which the noise is averaged: its inefficiency."""
NOISE = 1e-4
"""Standard deviation of the noise, in fractions of full scale."""
NINETY = 1.6448536
"""Standard deviations on either side of 90 % of a normal distribution."""
WRONG = 0.03
"""Standard deviation of the masses in the robot's description, as a fraction."""
MASSES = (4.0, 8.0)
"""What hand and tool of the arm weigh [kg]."""


def remembering(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return unit noise, six columns, that remembers `MEMORY` samples."""
    kernel = np.full(MEMORY, MEMORY**-0.5)
    white = rng.normal(size=(count + MEMORY - 1, 6))
    return np.stack([np.convolve(column, kernel, "valid") for column in white.T], axis=1)


def wave(rng: np.random.Generator, time: np.ndarray) -> Motion:
    """Return joints that swing at three rates each."""
    rate = rng.uniform(0.4, 1.1, size=(3, 3))
    angle = time[:, None, None] * rate + rng.uniform(0, 2 * np.pi, size=(3, 3))
    return Motion(
        time,
        JOINTS,
        0.45 * np.sin(angle).sum(axis=2),
        0.45 * (rate * np.cos(angle)).sum(axis=2),
        -0.45 * (rate**2 * np.sin(angle)).sum(axis=2),
    )


def loads(rng: np.random.Generator, sensor: SensorCalibration) -> np.ndarray:
    """Return wrenches inside the training envelope, of every axis and of force and torque."""
    low, high = np.array([sensor.envelope[axis] for axis in AXES]).T
    some = rng.uniform(low, high, size=(50 * LOADS, 6))
    inside = np.ones(len(some), dtype=bool)
    for name, part in (("force", some[:, :3]), ("torque", some[:, 3:])):
        least, most = sensor.envelope[name]
        size = np.linalg.norm(part, axis=1)
        inside &= (size >= least) & (size <= most)
    return some[inside][:LOADS]


def errors(calibration: Calibration, gain: np.ndarray, offset: np.ndarray, take: str) -> np.ndarray:
    """Return errors over their predicted standard deviation, (LOADS, 6); NaN where refused."""
    (sensor,) = calibration.sensors
    true = loads(np.random.default_rng(0), sensor)
    stamps = np.arange(len(true)) * NANOSECONDS
    channels = np.linalg.solve(gain, (true - offset).T).T
    log = Recording(take, take, 0, (), (Signal("ft", AXES, stamps, channels),))
    (read,) = corrected(calibration, log, sd=True)[0].channels
    columns = dict(zip(read.columns, read.values.T, strict=True))
    unknown = np.full(len(true), np.nan)
    sd = np.column_stack([columns.get(f"{axis}_sd", unknown) for axis in AXES])
    return np.asarray((read.values[:, :6] - true) / sd)


def arm(masses: Iterable[float]) -> str:
    """Return a URDF: two joints that turn the sensor in gravity, one beyond it that moves a tool.

    `masses` [kg] are those of the hand, beyond the sensor, and of the tool.
    """
    hand, tool = masses
    return f"""<robot name="arm"><link name="base"/><link name="upper"/><link name="lower"/>
  {link("hand", hand, "0.02 -0.03 0.06")}{link("tool", tool, "0.08 0.05 0.15")}
  {joint("shoulder", "base", "upper", "1 0 0")}{joint("elbow", "upper", "lower", "0 1 0")}
  <joint name="ft" type="fixed"><parent link="lower"/><child link="hand"/>
    <origin xyz="0 0 0.1" rpy="0.1 -0.2 0.3"/></joint>
  {joint("wrist", "hand", "tool", "0.6 0 0.8")}
  <sensor name="ft_sensor" type="force_torque"><parent joint="ft"/>
    <force_torque><frame>child</frame><measure_direction>child_to_parent</measure_direction>
    </force_torque></sensor></robot>"""


def link(name: str, mass: float, centre: str) -> str:
    """Return a link of `mass` [kg] about `centre` [m]."""
    return (
        f'<link name="{name}"><inertial><origin xyz="{centre}"/><mass value="{float(mass)!r}"/>'
        '<inertia ixx="0.01" iyy="0.02" izz="0.015" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def joint(name: str, parent: str, child: str, axis: str) -> str:
    """Return a joint that turns about `axis`."""
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0.05 0.3"/><axis xyz="{axis}"/>'
        '<limit lower="-3" upper="3" velocity="5" effort="1"/></joint>'
    )


def session(folder: Path, seed: int) -> dict[str, np.ndarray]:
    """Return the errors of one session, (2 takes, LOADS, 6), with each description of the robot."""
    rng = np.random.default_rng(seed)
    gain = bent(PRIOR, rng)
    motion = wave(rng, np.arange(16000) / 100.0)
    robot = parse_robot(arm(MASSES), name="arm")
    wrench = expected_wrenches(robot, motion, FixedContact("base"), ["ft_sensor"])["ft_sensor"]
    noisy = wrench + NOISE * FULL_SCALE * remembering(rng, len(wrench))
    job = folder / "job.toml"
    job.write_text(JOB.format(full_scale=", ".join(map(str, FULL_SCALE))))
    np.savetxt(folder / "workbench.csv", PRIOR.gain, delimiter=",")
    offsets = {}
    for take, half in (("one", slice(0, 12000)), ("two", slice(12000, 16000))):
        offsets[take] = rng.uniform(-0.1, 0.1, 6) * FULL_SCALE
        channels = np.linalg.solve(gain, (noisy[half] - offsets[take]).T).T
        write_log(folder / f"{take}.csv", motion.time[half], motion.position[half], channels)
    found = {}
    wrong = np.array(MASSES) * (1.0 + WRONG * rng.normal(size=2))
    for kind, masses in (("right", MASSES), ("wrong", wrong)):
        (folder / "arm.urdf").write_text(arm(masses))
        made = calibrate(read_job(job)).calibration
        found[kind] = np.array([errors(made, gain, offsets[take], take) for take in offsets])
    return found


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """Return the errors of all sessions, (SESSIONS, 2, LOADS, 6), by description of the robot."""
    every = [session(tmp_path_factory.mktemp("session"), seed) for seed in range(SESSIONS)]
    return {kind: np.array([one[kind] for one in every]) for kind in ("right", "wrong")}


def coverage(some: np.ndarray) -> float:
    """Return the share of the errors, where predicted, that a nominal 90 % interval holds."""
    known = np.isfinite(some)
    return float((np.abs(some[known]) < NINETY).mean())


def test_ninety_percent_intervals_hold_85_to_95_percent_of_the_true_wrenches(
    sessions: dict[str, np.ndarray],
) -> None:
    """91 %, with a standard error of 1.3 % between sessions, from a trained and a held-out take.

    Single axes hold 88 to 94 %. Noise on a channel draws its gain towards zero in the direction
    that moves least (8 times its noise): that is in the covariance, as large as it can be. With a
    tenth of the noise all axes together hold 90 %, with three times as much 93 %.
    """
    right = sessions["right"]
    assert np.isfinite(right).all()
    for take in (0, 1):
        assert 0.85 <= coverage(right[:, take]) <= 0.95
    for axis in range(6):
        # 50 sessions know the share of one axis within about 3 %
        assert 0.8 <= coverage(right[..., axis]) <= 1.0


def test_wrong_masses_are_the_exception(sessions: dict[str, np.ndarray]) -> None:
    """28 %: a gain that reads all loads as too heavy leaves no residual that would show it."""
    assert coverage(sessions["wrong"]) < 0.5
