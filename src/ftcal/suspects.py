"""What may be wrong with the model of the robot: joint zeros, the floor, a payload.

Every suspect changes equation (B): its transforms, or what the readings must add up to. The change
by one standard deviation of its prior is a column beside those of the sensors. It comes from the
balances themselves, of a log with another zero, with gravity turned, of a robot that carries more;
there is no second dynamics. Readings are those of a fit.

A joint zero bends (B): balances are built with what is believed of it. Weight is linear in the
tilt, to its square, and in the mass and first moments of a body: these are added to h.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ftcal.bench import Bench
from ftcal.config import Job, PayloadSection
from ftcal.errors import RobotError, raise_all, unknown
from ftcal.recording import Recording
from ftcal.robot import Joint, Link, Robot

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

STEP = 1e-5
"""Shift of a joint's zero [rad] for its difference: bent by as little, far above rounding."""

LEVER = 1e-3
"""Distance [m] of the point mass whose first moment is asked for: its second is nothing there."""

BODY = "a suspected payload"
"""Imaginary link; the blanks keep it apart from names of a description."""

Changes = dict[str, dict[str, "Float[Array, 'N 6']"]]
"""By error and sub-model: what one standard deviation adds to the readings' sum less h [N, Nm]."""


@dataclass(frozen=True, slots=True)
class ModelError:
    """One number of the model that may be wrong."""

    name: str
    """Of all the numbers of a job, none other has it."""
    unit: str
    sd: float
    """Standard deviation of its prior about zero, in its unit."""


class Suspect(Protocol):
    """One way in which the model may be wrong, of one number or several."""

    @property
    def words(self) -> str:
        """What is suspected, as a noun."""
        ...

    @property
    def errors(self) -> tuple[ModelError, ...]:
        """Its numbers."""
        ...

    @property
    def zeros(self) -> dict[str, str]:
        """Joints whose logged positions lack one of its errors, with the name of that."""
        ...

    def changes(self, bench: Bench) -> Changes:
        """Return the columns of its errors, those that a recording knows."""
        ...


@dataclass(frozen=True, slots=True)
class JointZero:
    """The zero of an encoder: what is to be added to its log [rad]."""

    joint: str
    sd: float

    @property
    def words(self) -> str:
        """What is suspected."""
        return f"zero of {self.joint}"

    @property
    def errors(self) -> tuple[ModelError, ...]:
        """One angle."""
        return (ModelError(self.words, "rad", self.sd),)

    @property
    def zeros(self) -> dict[str, str]:
        """The joint itself."""
        return {self.joint: self.words}

    def changes(self, bench: Bench) -> Changes:
        """Return the difference of the whole balance, transforms and h."""
        moved = bench.sums_with(recording=shifted(bench.recording, {self.joint: STEP}))
        change = {name: self.sd / STEP * (moved[name] - old) for name, old in bench.sums.items()}
        return {self.words: change}


@dataclass(frozen=True, slots=True)
class Tilt:
    """What a link stands on in a recording is not level: gravity turns in the link's frame."""

    link: str
    recording: str
    sd: float

    @property
    def words(self) -> str:
        """What is suspected."""
        return f"tilt under {self.link} in {self.recording}"

    @property
    def errors(self) -> tuple[ModelError, ...]:
        """Two angles."""
        return tuple(ModelError(f"{self.words}, {k}", "rad", self.sd) for k in ("first", "second"))

    @property
    def zeros(self) -> dict[str, str]:
        """No joint."""
        return {}

    def changes(self, bench: Bench) -> Changes:
        """Return what a turn of gravity about either axis changes while the link stands."""
        if bench.section.label != self.recording:
            return {}
        found: Changes = {}
        gravity = np.array(bench.section.gravity)
        spans = [(i.start, i.stop) for i in bench.section.schedule().intervals
                 if i.link == self.link]  # fmt: skip
        for error, axis in zip(self.errors, level_axes(gravity), strict=True):
            turned = gravity + np.cross(axis, gravity)
            section = bench.section.model_copy(update={"gravity": tuple(turned.tolist())})
            sums = bench.sums_with(section=section)
            found[error.name] = {}
            for one in bench.take.balances:
                inside = np.any([(one.time >= a) & (one.time < b) for a, b in spans], axis=0)
                change = sums[one.sub_model] - bench.sums[one.sub_model]
                found[error.name][one.sub_model] = self.sd * change * inside[:, None]
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Payload:
    """A body on a link that the description does not know: its mass and first moments."""

    link: str
    mass: float
    """Standard deviation [kg]."""
    com: float
    """Standard deviation of each coordinate of its centre of mass [m]."""
    robots: tuple[Robot, ...]
    """The robot with a kilogram in the origin of the link, and off it along x, y and z."""

    @property
    def words(self) -> str:
        """What is suspected."""
        return f"payload at {self.link}"

    @property
    def errors(self) -> tuple[ModelError, ...]:
        """Mass, then mass times the coordinates of its centre in the frame of the link."""
        moments = (
            ModelError(f"{self.words}, mass x {axis}", "kg m", self.mass * self.com)
            for axis in "xyz"
        )
        return (ModelError(f"{self.words}, mass", "kg", self.mass), *moments)

    @property
    def zeros(self) -> dict[str, str]:
        """No joint."""
        return {}

    def changes(self, bench: Bench) -> Changes:
        """Return what a point mass changes, and what moving it changes."""
        at, *off = (bench.sums_with(robot=robot) for robot in self.robots)
        pairs = [(at, bench.sums, 1.0), *((one, at, LEVER) for one in off)]
        return {
            error.name: {name: error.sd / size * (new[name] - old[name]) for name in old}
            for error, (new, old, size) in zip(self.errors, pairs, strict=True)
        }


def suspects(job: Job, robot: Robot, recordings: Sequence[Recording]) -> tuple[Suspect, ...]:
    """Return what the job suspects; `RobotError` names every joint and link that is not there."""
    asked = job.whole_body
    turning = () if asked.joint_zeros is None else turning_joints(robot, recordings)
    raise_all(
        RobotError,
        "[whole_body]",
        [
            *(f"zeros_of: {unknown('revolute joint in the logs', name, turning)}"
              for name in asked.zeros_of if name not in turning),
            *(f"payloads: {unknown('link', one.link, robot.links)}"
              for one in asked.payloads if one.link not in robot.links),
        ],
    )  # fmt: skip
    found: list[Suspect] = []
    if asked.joint_zeros is not None:
        found += [JointZero(name, asked.joint_zeros) for name in asked.zeros_of or turning]
    if asked.floor_tilt is not None:
        for section in job.recordings:
            # an accelerometer knows
            intervals = section.schedule().intervals if section.imu is None else ()
            links = dict.fromkeys(interval.link for interval in intervals)
            found += [Tilt(link, section.label, asked.floor_tilt) for link in links]
    found += [payload(robot, one) for one in asked.payloads]
    return tuple(found)


def turning_joints(robot: Robot, recordings: Iterable[Recording]) -> tuple[str, ...]:
    """Return the revolute joints that are logged."""
    logged = {name for one in recordings for signal in one.joints for name in signal.columns}
    joints = robot.joints.values()
    return tuple(j.name for j in joints if j.kind == "revolute" and j.name in logged)


def payload(robot: Robot, asked: PayloadSection) -> Payload:
    """Return a payload suspected on a link; kernels are kept with its robots, made once."""
    places = np.vstack([np.zeros(3), LEVER * np.eye(3)])
    robots = tuple(carrying(robot, asked.link, place) for place in places)
    return Payload(asked.link, asked.mass, asked.com, robots)


def carrying(robot: Robot, link: str, place: Float[Array, "3"], mass: float = 1.0) -> Robot:
    """Return the robot with a point `mass` [kg] at a `place` [m] in the frame of a link."""
    body = Link(BODY, mass, place, np.zeros((3, 3)))
    joint = Joint(BODY, "fixed", link, BODY, np.eye(4), np.zeros(3))
    return replace(robot, links={**robot.links, BODY: body}, joints={**robot.joints, BODY: joint})


def level_axes(gravity: Float[Array, "3"]) -> Float[Array, "2 3"]:
    """Return the two axes of a frame that lie most level, made level: x and y where z is up."""
    up = gravity / np.linalg.norm(gravity)
    least, middle, _ = sorted(range(3), key=lambda k: abs(up[k]))
    first, second = (np.eye(3)[k] for k in sorted((least, middle)))
    first = first - (first @ up) * up
    first /= np.linalg.norm(first)
    second = second - (second @ up) * up - (second @ first) * first
    return np.stack([first, second / np.linalg.norm(second)])


def shifted(recording: Recording, zeros: Mapping[str, float]) -> Recording:
    """Return a recording with angles [rad] added to the logs of some joints."""
    joints = tuple(
        replace(one, values=one.values + [zeros.get(column, 0.0) for column in one.columns])
        for one in recording.joints
    )
    return replace(recording, joints=joints)
