"""A robot as a tree of links and joints, cut into sub-models by its F/T sensors.

An F/T sensor is a fixed joint. Cutting the robot there leaves two halves; the half that touches
nothing says, through Newton and Euler, what the sensor should have measured. Records and questions
about them only: `ftcal.urdf` makes them from a file, `ftcal.dynamics` computes with them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal.errors import RobotError, raise_all, unknown

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

Side = Literal["parent", "child"]


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """A rigid body; a frame is a link without mass."""

    name: str
    """Name in the robot description."""
    mass: float
    """kg."""
    com: Float[Array, "3"]
    """Centre of mass in the link frame [m]."""
    inertia: Float[Array, "3 3"]
    """Rotational inertia about the centre of mass, in the axes of the link frame [kg m^2]."""


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """What connects two links; the child frame moves about or along `axis`."""

    name: str
    """Name in the robot description."""
    kind: Literal["revolute", "prismatic", "fixed"]
    """A continuous joint is a revolute one without limits."""
    parent: str
    """Link nearer the root."""
    child: str
    """Link farther from the root."""
    parent_H_child: Float[Array, "4 4"]
    """Pose of the child link in the parent link at position zero."""
    axis: Float[Array, "3"]
    """Unit vector in the child frame; of no meaning for a fixed joint."""
    lower: float = -np.inf
    """Least position [rad or m]."""
    upper: float = np.inf
    """Greatest position [rad or m]."""
    velocity: float = np.inf
    """Greatest speed [rad/s or m/s]."""


@dataclass(frozen=True, slots=True, eq=False)
class FtSensor:
    """A six-axis force/torque sensor inside a fixed joint."""

    name: str
    """Name of the sensor, or of its joint where the description names no sensor."""
    joint: str
    """Fixed joint in which it sits."""
    parent: str
    """Link on the root's side."""
    child: str
    """Link on the other side."""
    frame: Literal["child", "parent", "sensor"]
    """Which frame expresses the measurement: that of a link, or one given by an origin."""
    acts_on: Side
    """Side on which the measured wrench acts: `child_to_parent` acts on the parent."""
    child_H_sensor: Float[Array, "4 4"]
    """Pose of the measurement frame in the child link."""


@dataclass(frozen=True, slots=True)
class SubModel:
    """A tree of links that the sensors cut out of the robot."""

    name: str
    """Its link nearest the root."""
    links: tuple[str, ...]
    """Links, from the root outwards."""
    sensors: tuple[str, ...]
    """Sensors on its border."""


@dataclass(frozen=True, slots=True)
class Half:
    """One of the two halves left when the robot is cut at a sensor."""

    side: Side
    """Side of the sensor on which it lies."""
    links: tuple[str, ...]
    """Its links, from the root outwards."""


def faults(links: Mapping[str, Link], joints: Mapping[str, Joint]) -> list[str]:
    """Return what is physically or topologically wrong, one phrase a fault, culprit named."""
    found = []
    for link in links.values():
        if not (np.isfinite(link.mass) and link.mass >= 0.0):
            found.append(f"mass of link {link.name!r} is {link.mass:g} kg; it must be >= 0")
        if not np.isfinite(link.com).all():
            found.append(f"centre of mass of link {link.name!r} is not finite")
        if not np.isfinite(link.inertia).all():
            found.append(f"inertia of link {link.name!r} is not finite")
            continue
        least, _, most = np.linalg.eigvalsh(link.inertia)
        # printed digits leave tiny negative eigenvalues in flat bodies
        if least < -1e-6 * abs(most) - 1e-12:
            found.append(
                f"inertia of link {link.name!r} has a negative principal moment {least:.3g} kg m^2"
            )
    above: dict[str, str] = {}
    for joint in joints.values():
        for end, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                found.append(f"{end} of joint {joint.name!r}: {unknown('link', name, links)}")
        if joint.child in above:
            other = above[joint.child]
            found.append(
                f"link {joint.child!r} is the child of two joints, {other!r} and {joint.name!r}:"
                " a kinematic loop"
            )
        above[joint.child] = joint.name
    roots = [name for name in links if name not in above]
    if len(roots) > 1:
        found.append(f"{len(roots)} root links ({', '.join(roots[:5])}); a robot is one tree")
    if not found:
        # every link has at most one parent: what the root does not reach turns in a circle
        reached = _outwards(roots[:1], joints)
        if lost := [name for name in links if name not in reached]:
            found.append(f"kinematic loop through {', '.join(lost[:5])}; a robot is one tree")
    return found


def _outwards(roots: Sequence[str], joints: Mapping[str, Joint]) -> list[str]:
    """Return `roots` and every link that `joints` hang from them, parents before children."""
    children: dict[str, list[str]] = {}
    for joint in joints.values():
        children.setdefault(joint.parent, []).append(joint.child)
    order = list(roots)
    for name in order:
        order += children.get(name, [])
    return order


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Robot:
    """Links, joints and F/T sensors by name; one tree, checked when made (`RobotError`)."""

    name: str
    """Name in the robot description."""
    root: str
    """Link that has no parent."""
    links: Mapping[str, Link]
    """Links and frames."""
    joints: Mapping[str, Joint]
    """Joints; one logged position each, also where the description says `mimic`."""
    sensors: Mapping[str, FtSensor]
    """Sensors the description names."""
    digest: str
    """SHA-256 of the robot description, for provenance."""

    def __post_init__(self) -> None:
        raise_all(RobotError, f"robot {self.name!r}", faults(self.links, self.joints))

    def __repr__(self) -> str:
        return f"Robot({self.name!r}, {len(self.links)} links, {len(self.sensors)} F/T sensors)"

    @property
    def mass(self) -> float:
        """Mass of all links [kg]."""
        return sum(link.mass for link in self.links.values())

    @property
    def moving_joints(self) -> tuple[str, ...]:
        """Revolute and prismatic joints, in the order of the description."""
        return tuple(joint.name for joint in self.joints.values() if joint.kind != "fixed")

    def link(self, name: str) -> Link:
        """Return the link or frame `name`; `RobotError` offers near names."""
        if name not in self.links:
            raise RobotError(unknown("link", name, self.links))
        return self.links[name]

    def joint(self, name: str) -> Joint:
        """Return the joint `name`; `RobotError` offers near names."""
        if name not in self.joints:
            raise RobotError(unknown("joint", name, self.joints))
        return self.joints[name]

    def sensor(self, name: str) -> FtSensor:
        """Return the sensor of that name, or the one in the fixed joint of that name.

        A fixed joint without a sensor in the description measures what is usual: in the child
        frame, what the child does to the parent.
        """
        if name in self.sensors:
            return self.sensors[name]
        inside = [sensor for sensor in self.sensors.values() if sensor.joint == name]
        if inside:
            return inside[0]
        joint = self.joints.get(name)
        if joint is None:
            raise RobotError(unknown("F/T sensor", name, self.sensors or self.joints))
        if joint.kind != "fixed":
            raise RobotError(f"joint {name!r} is {joint.kind}; an F/T sensor sits in a fixed joint")
        return FtSensor(name, name, joint.parent, joint.child, "child", "parent", np.eye(4))

    def stiffened(self, joints: Iterable[str]) -> Robot:
        """Return the robot with `joints` fixed at zero."""
        stiff = {name: replace(self.joint(name), kind="fixed") for name in joints}
        return replace(self, joints={**self.joints, **stiff})

    def path(self, start: str, stop: str) -> tuple[Joint, ...]:
        """Return the joints between two links, in order of travel."""
        above = {joint.child: joint for joint in self.joints.values()}

        def climb(name: str) -> list[Joint]:
            way = []
            while name in above:
                way.append(above[name])
                name = way[-1].parent
            return way

        up, down = climb(self.link(start).name), climb(self.link(stop).name)
        while up and down and up[-1] is down[-1]:  # the common stretch below the root
            up.pop()
            down.pop()
        return (*up, *reversed(down))

    def sub_models(self, sensors: Sequence[str] | None = None) -> tuple[SubModel, ...]:
        """Return the trees left when the robot is cut at `sensors` (default: at every sensor)."""
        cuts = [self.sensor(name) for name in (self.sensors if sensors is None else sensors)]
        cut_joints = {sensor.joint for sensor in cuts}
        kept = {name: joint for name, joint in self.joints.items() if name not in cut_joints}
        below = {joint.child for joint in kept.values()}
        models = []
        for base in _outwards([self.root], self.joints):
            if base not in below:
                links = tuple(_outwards([base], kept))
                border = tuple(s.name for s in cuts if s.parent in links or s.child in links)
                models.append(SubModel(base, links, border))
        return tuple(models)

    def touched(
        self, sensor: str, contacts: Sequence[str]
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return which of the `contacts` lie on the parent's side of a sensor, and on the child's.

        Where both are touched, the sample says nothing of that sensor alone.
        """
        inside = set(_outwards([self.sensor(sensor).child], self.joints))
        beyond = tuple(name for name in contacts if self.link(name).name in inside)
        return tuple(name for name in contacts if name not in inside), beyond

    def free_half(self, sensor: str, contacts: Sequence[str]) -> Half:
        """Return the half of the robot beyond `sensor`, which holds none of the `contacts`.

        `RobotError` where both halves are touched, or where the free half has no mass. Without
        contacts both are free, and it is the child's.
        """
        cut = self.sensor(sensor)
        child_links = tuple(_outwards([cut.child], self.joints))
        inside = set(child_links)
        parent_links = tuple(n for n in _outwards([self.root], self.joints) if n not in inside)
        before, beyond = self.touched(sensor, contacts)
        if beyond and before:
            raise RobotError(
                f"both halves at sensor {sensor!r} touch the world: {', '.join(before)} on the"
                f" parent side, {', '.join(beyond)} on the child side; use whole-body balances,"
                " or intervals with one contact"
            )
        half = Half("parent", parent_links) if beyond else Half("child", child_links)
        if not any(self.links[name].mass > 0.0 for name in half.links):
            raise RobotError(
                f"the {half.side} side of sensor {sensor!r} has no mass (contact"
                f" {', '.join(contacts)}): its wrench is always zero; give its links an inertial"
            )
        return half

    def required_joints(self, sensor: str, contact: str) -> tuple[str, ...]:
        """Return the moving joints a log must contain to know the wrench at `sensor`.

        Those between `contact` and the sensor, and those that move mass inside the free half.
        """
        half = self.free_half(sensor, [contact])
        needed = {
            joint.name
            for name in half.links
            if self.links[name].mass > 0.0 or self.links[name].inertia.any()
            for joint in self.path(contact, name)
        }
        return tuple(name for name in self.moving_joints if name in needed)
