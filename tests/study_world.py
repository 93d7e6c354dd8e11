"""Robots, recordings and sensors whose truth is exact: what studies and balances are tested on.

Model wrenches are computed on the motion that ftcal itself finds in the logged joints, so nothing
but rounding parts a reading from the law that was planted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal.contact import ContactSchedule, Interval
from ftcal.dynamics import expected_wrenches
from ftcal.logs import yarp
from ftcal.motion import STANDARD_GRAVITY, FixedContact, Motion
from ftcal.pairing import FtChannel
from ftcal.recording import Recording, Signal
from ftcal.robot import FtSensor, Joint, Link, Robot, Side
from ftcal.sensor import Workbench
from ftcal.signals import joint_motion
from ftcal.spatial import pose, rotation_about
from pretend import FULL_SCALE, bent, workbench
from walker import SIGNALS, walker

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

Kind = Literal["revolute", "prismatic", "fixed"]
EPOCH = 1_700_000_000_000_000_000
BELIEVED = Workbench("as logged", np.eye(6), FULL_SCALE, "channels")
"""A log that carries the wrench itself."""


def random_robot(seed: int, bodies: int = 9) -> Robot:
    """Return a tree of bodies on random joints, every third of them an F/T sensor."""
    rng = np.random.default_rng(seed)
    links, joints, sensors = {}, {}, {}
    for k in range(bodies):
        half = rng.normal(size=(3, 3))
        links[f"l{k}"] = Link(f"l{k}", rng.uniform(0.5, 4.0), rng.normal(size=3) / 5, half @ half.T)
        if k == 0:
            continue
        kind: Kind = "fixed" if k % 3 == 0 else "revolute" if rng.integers(2) else "prismatic"
        turned = rotation_about(unit(rng), rng.uniform(0, 3, 1))[0]
        parent = f"l{int(rng.integers(max(0, k - 3), k))}"
        at = pose(turned, rng.normal(size=3) / 3)
        joints[f"j{k}"] = Joint(f"j{k}", kind, parent, f"l{k}", at, unit(rng))
        if kind == "fixed":
            side: Side = "parent" if rng.integers(2) else "child"
            origin = pose(rotation_about(unit(rng), np.ones(1))[0], rng.normal(size=3) / 9)
            name = f"ft{k}"
            sensors[name] = FtSensor(name, f"j{k}", parent, f"l{k}", "sensor", side, origin)
    return Robot(f"random {seed}", "l0", links, joints, sensors, digest=str(seed))


def unit(rng: np.random.Generator) -> Float[Array, "3"]:
    axis = rng.normal(size=3)
    return np.asarray(axis / np.linalg.norm(axis))


def moved(
    names: Sequence[str], rng: np.random.Generator, *, seconds: float, pace: float = 0.3
) -> Recording:
    """Return a recording of joints alone, each a sum of three sines of up to `pace` Hz."""
    time = np.arange(round(100 * seconds)) / 100
    rates, phases, sizes = (
        rng.uniform(*span, size=(3, len(names)))
        for span in ((0.2 * pace, pace), (0.0, 1.0), (0.1, 0.3))
    )
    angles = (sizes * np.sin(2 * np.pi * (time[:, None, None] * rates + phases))).sum(axis=1)
    return Recording("take", "memory", EPOCH, (signal("joints", names, angles),), ())


def signal(name: str, columns: Sequence[str], values: Float[Array, "N K"]) -> Signal:
    """Return a signal at 100 Hz from second zero."""
    return Signal(name, tuple(columns), EPOCH + 10_000_000 * np.arange(len(values)), values)


def schedule(*spans: tuple[float, float, str]) -> ContactSchedule:
    return ContactSchedule(tuple(Interval(*span) for span in spans))


def seen_motion(recording: Recording) -> Motion:
    """Return the motion that ftcal finds in the joints; nothing moves where it finds none."""
    (joints,) = recording.joints
    motion, _ = joint_motion(recording, joints.columns, joints.stamps)
    filled = (np.nan_to_num(part) for part in (motion.position, motion.velocity,
                                               motion.acceleration))  # fmt: skip
    return Motion(motion.time, motion.joints, *filled)


def ideal(
    recording: Recording,
    robot: Robot,
    sensors: Sequence[str],
    contacts: ContactSchedule,
    gravity: tuple[float, float, float] = STANDARD_GRAVITY,
) -> dict[str, Float[Array, "N 6"]]:
    """Return what each sensor should read; zero between the intervals."""
    motion = seen_motion(recording)
    felt = {name: np.zeros((len(motion), 6)) for name in sensors}
    for interval in contacts.intervals:
        rows = (motion.time >= interval.start) & (motion.time < interval.stop)
        contact = FixedContact(interval.link, gravity)
        here = expected_wrenches(robot, motion.rows(rows), contact, list(sensors))
        for name, wrench in here.items():
            felt[name][rows] = wrench
    return felt


def with_readings(
    recording: Recording, readings: Mapping[str, Float[Array, "N 6"]]
) -> tuple[Recording, list[FtChannel]]:
    """Return the recording with a signal a sensor, and the channels that read them."""
    signals = tuple(signal(f"{name}/analog:o", "abcdef", value) for name, value in readings.items())
    channels = [FtChannel(name, f"{name}/analog:o", BELIEVED) for name in readings]
    return replace(recording, channels=signals), channels


# ------------------------------------------------------------------ a study of the walker on disk


@dataclass(frozen=True, slots=True)
class Sensor:
    """The law of one sensor of the walker, and what is believed of it."""

    workbench: Workbench
    gain: Float[Array, "6 6"]
    """True C."""


def pretend_sensors() -> dict[str, Sensor]:
    """Return the sensors of the right leg, each bent a little in its mounting."""
    made = {}
    for seed, name in enumerate(RIGHT):
        prior = workbench(seed)
        made[name] = Sensor(prior, bent(prior, np.random.default_rng(100 + seed)))
    return made


def as_urdf(robot: Robot) -> str:
    """Return a URDF of a robot whose sensors measure in their child's frame."""
    parts = []
    for link in robot.links.values():
        inertia = " ".join(
            f'{name}="{float(link.inertia[i, j])!r}"'
            for name, (i, j) in {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1),
                                 "iyz": (1, 2), "izz": (2, 2)}.items()
        )  # fmt: skip
        inside = (
            f'<inertial><origin xyz="{row(link.com)}"/><mass value="{link.mass!r}"/>'
            f"<inertia {inertia}/></inertial>"
        )
        parts.append(f'<link name="{link.name}">{inside if link.mass > 0 else ""}</link>')
    for joint in robot.joints.values():
        at = joint.parent_H_child
        rpy = (
            np.arctan2(at[2, 1], at[2, 2]),
            np.arctan2(-at[2, 0], np.hypot(at[0, 0], at[1, 0])),
            np.arctan2(at[1, 0], at[0, 0]),
        )
        parts.append(
            f'<joint name="{joint.name}" type="{joint.kind}"><parent link="{joint.parent}"/>'
            f'<child link="{joint.child}"/><origin xyz="{row(at[:3, 3])}" rpy="{row(rpy)}"/>'
            f'<axis xyz="{row(joint.axis)}"/>'
            '<limit lower="-3" upper="3" velocity="9" effort="9"/></joint>'
        )
    for sensor in robot.sensors.values():
        direction = "child_to_parent" if sensor.acts_on == "parent" else "parent_to_child"
        parts.append(
            f'<sensor name="{sensor.name}" type="force_torque"><parent joint="{sensor.joint}"/>'
            f"<force_torque><frame>child</frame><measure_direction>{direction}</measure_direction>"
            "</force_torque></sensor>"
        )
    return f'<robot name="{robot.name}">{"".join(parts)}</robot>'


def row(numbers: Sequence[float] | Float[Array, "N"]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


LEGS = tuple(name for name in walker().moving_joints)
POLE = schedule((-np.inf, np.inf, "trunk"))
SWITCHING = schedule((1.0, 13.0, "trunk"), (14.0, 26.0, "l_sole"), (27.0, 39.0, "r_sole"))
RIGHT = ("r_leg_ft_sensor", "r_foot_ft_sensor")


@dataclass(frozen=True, slots=True)
class Take:
    """How one recording of the study is made."""

    seed: int
    seconds: float
    contacts: ContactSchedule
    pace: float = 0.3
    """Fastest motion [Hz]."""
    stiff: tuple[str, ...] = ()
    """Joints that rest."""


RECORDINGS = {
    "wide": Take(1, 30.0, POLE),
    # quasi-static, and no mass moves behind any sensor
    "grid": Take(2, 60.0, POLE, 0.05, ("l_knee", "l_ankle", "r_knee", "r_ankle")),
    "run": Take(3, 40.0, SWITCHING),
}


def planted_offset(name: str, sensor: str) -> Float[Array, "6"]:
    """Return the offset o [N, Nm] of a sensor in a recording of the study."""
    rng = np.random.default_rng((RECORDINGS[name].seed, RIGHT.index(sensor)))
    return np.asarray(rng.uniform(-0.1, 0.1, 6) * FULL_SCALE)


def take(
    name: str, sensors: Mapping[str, Sensor], *, steps: Float[Array, "6"] | None = None
) -> Recording:
    """Return what the walker logs [N, Nm by the Workbench matrix]."""
    how = RECORDINGS[name]
    rng = np.random.default_rng(how.seed)
    joints = moved(LEGS, rng, seconds=how.seconds, pace=how.pace)
    angles = joints.joints[0].values
    angles[:, [joint in how.stiff for joint in LEGS]] = 0.2
    channels = []
    for sensor, wrench in ideal(joints, walker(), list(sensors), how.contacts).items():
        one = sensors[sensor]
        raw = np.linalg.solve(one.gain, (wrench - planted_offset(name, sensor)).T).T
        logged = raw @ one.workbench.gain.T
        if steps is not None:
            logged = np.round(logged / steps) * steps
        channels.append(signal(SIGNALS[sensor], "abcdef", logged))
    return replace(joints, channels=tuple(channels))


STUDY = """robot = "walker.urdf"
{sensors}
[[recordings]]
name = "wide"
log = "wide"
contact = "trunk"
{joints}
[[recordings]]
name = "grid"
log = "grid"
contact = "trunk"
{joints}
[[recordings]]
name = "run"
log = "run"
contacts = [
  {{start = 1, stop = 13, link = "trunk"}},
  {{start = 14, stop = 26, link = "l_sole"}},
  {{start = 27, stop = 39, link = "r_sole"}},
]
{joints}
[study]
switching = "run"
align = [1, 13]
"""


def write_study(
    folder: Path,
    sensors: Mapping[str, Sensor],
    *,
    steps: Mapping[str, Float[Array, "6"]] | None = None,
) -> Path:
    """Write robot, Workbench matrices, three YARP logs and the job of a study; return the job.

    `steps` [N, Nm], by recording, are those of the boards' outputs.
    """
    (folder / "walker.urdf").write_text(as_urdf(walker()))
    rows = []
    for name, one in sensors.items():
        np.savetxt(folder / f"{name}.csv", one.workbench.gain, delimiter=",", fmt="%.17g")
        rows.append(
            f'[[sensors]]\nname = "{name}"\nsignal = "{SIGNALS[name]}"\nworkbench = "{name}.csv"\n'
            f"full_scale = [{', '.join(map(repr, FULL_SCALE.tolist()))}]\n"
        )
    for name in RECORDINGS:
        recording = take(name, sensors, steps=(steps or {}).get(name))
        layout = yarp.write(recording, folder / name)
    joints = ", ".join(f'"{port}" = {list(names)}' for port, names in layout.joints.items())
    job = folder / "study.toml"
    job.write_text(STUDY.format(sensors="\n".join(rows), joints=f"joints = {{{joints}}}"))
    return job
