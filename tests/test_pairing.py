"""A recording and a robot → samples: moving contacts, intervals, holes, windows."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from ftcal.config import Job, read_job
from ftcal.dynamics import expected_wrenches
from ftcal.motion import Motion, MovingContact
from ftcal.pairing import apart
from ftcal.pipeline import calibrate
from ftcal.urdf import parse_robot
from pretend import FULL_SCALE
from small_world import JOB, JOINTS, PRIOR, robot_text, take, truth

IMU = ("ax", "ay", "az", "wx", "wy", "wz")


def rocking_take(file: Path, seed: int) -> None:
    """Write a log of the arm on a platform that rocks about its x axis, with an IMU on it."""
    time, q, _ = take(seed)
    rng = np.random.default_rng(seed)
    rate, phase = rng.uniform(0.5, 0.9), rng.uniform(0, 6)
    roll = 0.4 * np.sin(rate * time + phase)
    droll = 0.4 * rate * np.cos(rate * time + phase)
    ddroll = -(rate**2) * roll
    zero = np.zeros_like(time)
    gravity = -9.80665 * np.column_stack([zero, np.sin(roll), np.cos(roll)])
    base = MovingContact(
        "base",
        gravity,
        np.column_stack([droll, zero, zero]),
        np.zeros((len(time), 3)),
        np.column_stack([ddroll, zero, zero]),
    )
    dq, ddq = np.gradient(q, time, axis=0), np.gradient(np.gradient(q, time, axis=0), time, axis=0)
    robot = parse_robot(robot_text(), name="arm")
    wrench = expected_wrenches(robot, Motion(time, JOINTS, q, dq, ddq), base, ["ft_sensor"])
    channels = np.linalg.solve(truth(), (wrench["ft_sensor"] + 0.05 * FULL_SCALE).T).T
    table = np.column_stack([q, channels, -gravity, base.angular_velocity])
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream)
        axes = [f"ft/{axis}" for axis in ("fx", "fy", "fz", "tx", "ty", "tz")]
        writer.writerow(["time", *JOINTS, *axes, *IMU])
        for t, row in zip(time, table, strict=True):
            writer.writerow([f"{1.7e9 + t:.6f}", *map(repr, row.tolist())])


@pytest.fixture(scope="module")
def rocking(tmp_path_factory: pytest.TempPathFactory) -> Job:
    folder = tmp_path_factory.mktemp("rocking")
    (folder / "arm.urdf").write_text(robot_text())
    np.savetxt(folder / "workbench.csv", PRIOR.gain, delimiter=",")
    for name, seed in (("one", 1), ("two", 2)):
        rocking_take(folder / f"{name}.csv", seed)
    text = JOB.format(full_scale=", ".join(map(str, FULL_SCALE)))
    columns = ", ".join(f'"{name}"' for name in IMU)
    job = folder / "job.toml"
    job.write_text(
        text.replace(
            'contact = "base"', f'contact = "base"\nimu = "imu"\nimus = {{imu = [{columns}]}}'
        )
    )
    return read_job(job)


def test_a_base_that_moves_is_known_from_its_imu(rocking: Job) -> None:
    (sensor,) = calibrate(rocking).sensors
    assert sensor.hold_out is not None
    for axis, score in sensor.hold_out.by_name.items():
        assert score.percent < 3.0, axis


def test_a_base_taken_for_still_is_no_better_than_the_workbench(rocking: Job) -> None:
    still = tuple(r.model_copy(update={"imu": None}) for r in rocking.recordings)
    (sensor,) = calibrate(rocking.model_copy(update={"recordings": still})).sensors
    assert sensor.hold_out is not None
    assert sensor.hold_out.by_name["force"].percent > 30.0


def test_contact_intervals_bound_what_is_used(rocking: Job) -> None:
    first = rocking.recordings[0].model_dump()
    first |= {"contact": None, "contacts": [{"start": 5.0, "stop": 20.0, "link": "base"}]}
    job = Job.model_validate({**dict(rocking), "recordings": [first, *rocking.recordings[1:]]})
    (sensor,) = calibrate(job).sensors
    time = sensor.paired[0].samples.time
    # half a smoothing window is lost at either end, and nothing lies beyond
    assert time[0] == pytest.approx(5.5, abs=0.02)
    assert time[-1] == pytest.approx(19.5, abs=0.02)


def test_windows_keep_their_distance() -> None:
    assert apart([(0.0, 10.0)], [(4.0, 5.0)], 1.0) == [(0.0, 3.0), (6.0, 10.0)]
    assert apart([(0.0, 10.0)], [(-5.0, 20.0)], 1.0) == []
    assert apart([(0.0, 10.0)], [(20.0, 30.0)], 1.0) == [(0.0, 10.0)]
    assert apart([(0.0, 10.0)], [], 1.0) == [(0.0, 10.0)]
