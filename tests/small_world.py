"""A three-joint arm on a sensor, two CSV logs and a job: the whole pipeline in a second.

Truth is known; `write_world` writes everything a user would have and returns the job file.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from ftcal.dynamics import expected_wrenches
from ftcal.motion import FixedContact, Motion
from ftcal.urdf import parse_robot
from pretend import FULL_SCALE, bent, workbench

JOINTS = ("shoulder", "elbow", "wrist")
PRIOR = workbench()

ROBOT = """<robot name="arm">
  <link name="base"><inertial><mass value="5"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link>
  <link name="stand"/>
  {links}
  <joint name="ft" type="fixed"><parent link="base"/><child link="stand"/>
    <origin xyz="0 0 0.1" rpy="0.1 -0.2 0.3"/></joint>
  {joints}
  <sensor name="ft_sensor" type="force_torque"><parent joint="ft"/>
    <force_torque><frame>child</frame><measure_direction>child_to_parent</measure_direction>
    </force_torque></sensor>
</robot>"""

AXES_OF = {"shoulder": "1 0 0", "elbow": "0 1 0", "wrist": "0.6 0 0.8"}


def robot_text(mass: float | str = 8) -> str:
    """Return the URDF of the arm; every moving link weighs `mass`."""
    links, joints, parent = "", "", "stand"
    for name, axis in AXES_OF.items():
        links += (
            f'<link name="{name}_link"><inertial><origin xyz="0.05 0.02 0.2"/>'
            f'<mass value="{mass}"/>'
            '<inertia ixx="0.1" iyy="0.2" izz="0.15" ixy="0" ixz="0" iyz="0"/></inertial></link>\n'
        )
        joints += (
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{name}_link"/><origin xyz="0 0.05 0.3"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" velocity="5" effort="1"/></joint>\n'
        )
        parent = f"{name}_link"
    return ROBOT.format(links=links, joints=joints)


def take(
    seed: int, *, seconds: float = 40.0, noise: float = 2e-4
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time [s], joints (N, 3) [rad] and raw channels (N, 6) of one take at 100 Hz."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(100 * seconds)) / 100.0
    rate = rng.uniform(0.4, 1.1, size=(3, 3))
    phase = rng.uniform(0, 2 * np.pi, size=(3, 3))
    angle = time[:, None, None] * rate + phase
    q, dq, ddq = (
        0.45 * np.sin(angle).sum(axis=2),
        0.45 * (rate * np.cos(angle)).sum(axis=2),
        -0.45 * (rate**2 * np.sin(angle)).sum(axis=2),
    )
    robot = parse_robot(robot_text(), name="arm")
    motion = Motion(time, JOINTS, q, dq, ddq)
    wrench = expected_wrenches(robot, motion, FixedContact("base"), ["ft_sensor"])["ft_sensor"]
    offset = rng.uniform(-0.1, 0.1, 6) * FULL_SCALE
    felt = wrench - offset + noise * FULL_SCALE * rng.normal(size=wrench.shape)
    return time, q, np.linalg.solve(truth(), felt.T).T


def truth() -> np.ndarray:
    """Return the true gain of the arm's sensor."""
    return bent(PRIOR, np.random.default_rng(99))


def write_log(file: Path, time: np.ndarray, joints: np.ndarray, channels: np.ndarray) -> None:
    """Write a CSV log the way a lab would: Unix seconds, joints in rad, raw counts."""
    header = ["time", *JOINTS, *(f"ft/{axis}" for axis in ("fx", "fy", "fz", "tx", "ty", "tz"))]
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        for t, row in zip(time, np.column_stack([joints, channels]), strict=True):
            writer.writerow([f"{1.7e9 + t:.6f}", *map(repr, row.tolist())])


JOB = """robot = "arm.urdf"

[[sensors]]
name = "ft_sensor"
signal = "ft"
workbench = "workbench.csv"
full_scale = [{full_scale}]
logged = "channels"

[[recordings]]
log = "one.csv"
contact = "base"

[[recordings]]
log = "two.csv"
contact = "base"
train = []
test = [[0, 40]]
"""


def write_world(folder: Path) -> Path:
    """Write robot, Workbench matrix, two logs and the job; return the job file."""
    (folder / "arm.urdf").write_text(robot_text())
    np.savetxt(folder / "workbench.csv", PRIOR.gain, delimiter=",")
    for name, seed in (("one", 1), ("two", 2)):
        write_log(folder / f"{name}.csv", *take(seed))
    job = folder / "job.toml"
    job.write_text(JOB.format(full_scale=", ".join(map(str, FULL_SCALE))))
    return job
