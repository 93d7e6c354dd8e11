"""The robot as its contact sees it: a tree of bodies that grows from the touching link.

Everything that is constant is done here, once: the tree is re-rooted at the contact, links joined
by fixed joints become one body, requested F/T sensors cut bodies in two, what no sensor needs is
left out, and the frames are chosen so that most of the constants are 0 or 1:

* z of a body is the axis on which it hangs, x is normal to that axis and to the one before, and
  the origin lies on their common normal (Denavit and Hartenberg 1955).
* Mass on a revolute axis does not feel its joint: `m`, `m c_z` and the second moment about z = 0
  move to the body before, never through a sensor (Khalil and Dombre, *Modeling, Identification and
  Control of Robots*, 2002, section 9.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal.robot import Joint, Link, Robot
from ftcal.spatial import inverse

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

ROUNDING = 1e-14
"""Constants closer than this to 0 or ±1 (rad, m) are printing noise of the description."""
PARALLEL = 1e-3
"""Axes closer than this [rad] have no common normal worth the distance to it."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A rigid body and how it hangs on the one before it, nearer the contact."""

    before: int
    """Index of the body it hangs on; -1 for the body that touches the world."""
    joint: str
    """Moving joint on which it hangs; empty for the touching body and behind a sensor."""
    kind: Literal["revolute", "prismatic", "fixed"]
    """Motion about or along its z axis; the first body behind a sensor has the frame before it."""
    before_H_body: Float[Array, "4 4"]
    """Pose in the body before, at joint position zero."""
    moments: Float[Array, "4 4"]
    """Integral of (x, 1) (x, 1)^T dm in the body frame [kg m^2, kg m, kg]."""
    behind: bool = False
    """Whether it lies behind a sensor; if not, its mass is left out: only its motion matters."""


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """A requested sensor: the wrench on `body` from the side of the contact, times `sign`."""

    sensor: str
    """Name it was asked for by."""
    body: int
    """First body behind the sensor."""
    sensor_H_body: Float[Array, "4 4"]
    """Pose of that body's frame in the measurement frame."""
    sign: float
    """+1 where the measured wrench acts on the free half, -1 where it acts on the other."""


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """Bodies in an order in which each comes after the one it hangs on; body 0 touches."""

    bodies: tuple[Body, ...]
    """Bodies some sensor needs; the frame of the first is that of the touching link."""
    cuts: tuple[Cut, ...]
    """Requested sensors, in the order of the request."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Moving joints whose motion is needed."""
        return tuple(body.joint for body in self.bodies if body.joint)


def grow(robot: Robot, contact: str, sensors: Sequence[str]) -> Tree:
    """Return the tree of `robot` from the link `contact` to all `sensors` need; `RobotError`."""
    asked = {name: robot.sensor(name) for name in sensors}
    halves = {name: robot.free_half(name, [contact]) for name in asked}
    edges: dict[str, list[Joint]] = {name: [] for name in robot.links}
    for joint in robot.joints.values():
        edges[joint.parent].append(joint)
        edges[joint.child].append(joint)
    cut_joints = {sensor.joint for sensor in asked.values()}

    bodies = [Body(-1, "", "fixed", np.eye(4), np.zeros((4, 4)))]
    pose_of: dict[str, tuple[int, Array]] = {robot.link(contact).name: (0, np.eye(4))}
    way = [contact]
    for near in way:
        index, body_H_near = pose_of[near]
        moments = bodies[index].moments + _moments(robot.links[near], body_H_near)
        bodies[index] = replace(bodies[index], moments=moments)
        for joint in edges[near]:
            outwards = joint.parent == near
            far = joint.child if outwards else joint.parent
            if far in pose_of:
                continue
            way.append(far)
            near_H_far = joint.parent_H_child if outwards else inverse(joint.parent_H_child)
            if joint.kind == "fixed" and joint.name not in cut_joints:
                pose_of[far] = (index, body_H_near @ near_H_far)
            elif joint.kind == "fixed":
                bodies.append(Body(index, "", "fixed", np.eye(4), np.zeros((4, 4))))
                pose_of[far] = (len(bodies) - 1, body_H_near @ near_H_far)
            else:
                near_H_axis = _axis_frame(joint, outwards, body_H_near)
                bodies.append(
                    Body(
                        index,
                        joint.name,
                        joint.kind,
                        _clean(body_H_near @ near_H_axis),
                        np.zeros((4, 4)),
                    )
                )
                pose_of[far] = (len(bodies) - 1, inverse(near_H_axis) @ near_H_far)
    cuts = []
    for name, sensor in asked.items():
        far = sensor.child if halves[name].side == "child" else sensor.parent
        index, _ = pose_of[far]
        _, body_H_child = pose_of[sensor.child]  # the body before a sensor has the same frame
        sensor_H_body = inverse(body_H_child @ sensor.child_H_sensor)
        sign = 1.0 if sensor.acts_on == halves[name].side else -1.0
        cuts.append(Cut(name, index, _clean(sensor_H_body), sign))
    return _prune(bodies, cuts)


def _moments(link: Link, body_H_link: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """Return the pseudo-inertia of `link` in the body frame (Wensing et al. 2018, eq. 8)."""
    if link.mass == 0.0 and not link.inertia.any():
        return np.zeros((4, 4))
    about_com = np.zeros((4, 4))
    about_com[:3, :3] = 0.5 * np.trace(link.inertia) * np.eye(3) - link.inertia
    about_com[3, 3] = link.mass
    body_H_com = body_H_link @ np.block(
        [[np.eye(3), link.com[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]
    )
    return np.asarray(body_H_com @ about_com @ body_H_com.T)


def _axis_frame(
    joint: Joint, outwards: bool, body_H_near: Float[Array, "4 4"]
) -> Float[Array, "4 4"]:
    """Return `near_H_axis`: z on the axis of `joint`, x and origin on the common normal.

    Seen from the child the joint turns the other way: its z axis is then opposed, not its position.
    """
    near_R_child = joint.parent_H_child[:3, :3] if outwards else np.eye(3)
    near_p_child = joint.parent_H_child[:3, 3] if outwards else np.zeros(3)
    R, p = body_H_near[:3, :3], body_H_near[:3, 3]
    z = R @ near_R_child @ joint.axis * (1.0 if outwards else -1.0)
    origin = R @ near_p_child + p
    x = np.array([-z[1], z[0], 0.0])  # z of the body × z of the axis
    if np.hypot(x[0], x[1]) > PARALLEL:
        x /= np.linalg.norm(x)
        # the point of this axis that is nearest to the z axis of the body
        slide = -(z[:2] @ origin[:2]) / (z[:2] @ z[:2])
    else:
        x, slide = np.array([1.0, 0.0, 0.0]), -origin[2] / z[2]
    x -= (x @ z) * z
    x /= np.linalg.norm(x)
    body_H_axis = np.eye(4)
    body_H_axis[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    body_H_axis[:3, 3] = origin + slide * z
    return np.asarray(inverse(body_H_near) @ body_H_axis)


def _clean(H: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """Return `H` with entries within `ROUNDING` of 0 and ±1 made exact."""
    nearest = np.round(H)
    return np.where((abs(H - nearest) < ROUNDING) & (abs(nearest) <= 1.0), nearest, H)


def _prune(bodies: Sequence[Body], cuts: Sequence[Cut]) -> Tree:
    """Return the tree of what the cuts need: what lies behind them, and the way to them."""
    behind: set[int] = set()
    for index, body in enumerate(bodies):
        if body.before in behind or any(cut.body == index for cut in cuts):
            behind.add(index)
    kept: set[int] = {0}
    moments = [b.moments if i in behind else np.zeros((4, 4)) for i, b in enumerate(bodies)]
    for index in range(len(bodies) - 1, 0, -1):
        body, here = bodies[index], moments[index]
        if here.any() or index in kept or any(c.body == index for c in cuts):
            kept |= {index, body.before}
        if body.kind == "revolute" and body.before in behind:
            on_axis = np.zeros((4, 4))
            on_axis[2:, 2:] = here[2:, 2:]
            moments[index] = here - on_axis
            H = body.before_H_body
            moments[body.before] = moments[body.before] + H @ on_axis @ H.T
    number = {old: new for new, old in enumerate(sorted(kept))}
    number[-1] = -1
    return Tree(
        tuple(
            replace(
                bodies[old],
                before=number[bodies[old].before],
                moments=moments[old],
                behind=old in behind,
            )
            for old in sorted(kept)
        ),
        tuple(replace(cut, body=number[cut.body]) for cut in cuts),
    )
