"""Where the parts of a robot are relative to each other along a motion.

Poses only: wrenches have their own, faster way (`ftcal.dynamics`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ftcal.motion import Contact, Motion
from ftcal.robot import Joint, Robot
from ftcal.spatial import inverse, pose, rotation_about

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


def joint_pose(joint: Joint, position: Float[Array, "N"]) -> Float[Array, "N 4 4"]:
    """Return `parent_H_child` of a joint at `position` [rad or m]."""
    if joint.kind == "fixed":
        return np.broadcast_to(joint.parent_H_child, (len(position), 4, 4))
    if joint.kind == "prismatic":
        moved = pose(np.eye(3), np.outer(position, joint.axis))
    else:
        moved = pose(rotation_about(joint.axis, position), np.zeros(3))
    return np.asarray(joint.parent_H_child @ moved)


def relative_pose(robot: Robot, motion: Motion, start: str, stop: str) -> Float[Array, "N 4 4"]:
    """Return `A_H_B` of link `stop` (B) in link `start` (A).

    Raises `DataError` naming the joints between them that the motion lacks.
    """
    path = robot.path(start, stop)
    moving = [joint.name for joint in path if joint.kind != "fixed"]
    position = dict(zip(moving, motion.position[:, motion.columns(moving)].T, strict=True))
    still = np.zeros(len(motion))
    A_H_B = np.broadcast_to(np.eye(4), (len(motion), 4, 4))
    here = start
    for joint in path:
        parent_H_child = joint_pose(joint, position.get(joint.name, still))
        downward = joint.parent == here
        A_H_B = A_H_B @ (parent_H_child if downward else inverse(parent_H_child))
        here = joint.child if downward else joint.parent
    return A_H_B


def sensor_pose(robot: Robot, motion: Motion, start: str, sensor: str) -> Float[Array, "N 4 4"]:
    """Return the pose of a sensor's measurement frame in link `start`."""
    ft = robot.sensor(sensor)
    return np.asarray(relative_pose(robot, motion, start, ft.child) @ ft.child_H_sensor)


def gravity_in_sensor(
    robot: Robot, motion: Motion, contact: Contact, sensor: str
) -> Float[Array, "N 3"]:
    """Return the gravity acceleration [m/s^2] in a sensor's frame: a simulated accelerometer's."""
    C_R_S = sensor_pose(robot, motion, contact.link, sensor)[:, :3, :3]
    C_g = np.broadcast_to(np.asarray(contact.gravity, dtype=np.float64), (len(motion), 3))
    return np.asarray(np.einsum("nji,nj->ni", C_R_S, C_g))


def centre_of_mass(
    robot: Robot, motion: Motion, links: Sequence[str], frame: str
) -> Float[Array, "N 3"]:
    """Return the centre of mass [m] of `links` in link `frame`."""
    weighed = np.zeros((len(motion), 3))
    mass = 0.0
    for name in links:
        link = robot.link(name)
        if link.mass > 0.0:
            A_H_L = relative_pose(robot, motion, frame, name)
            weighed += link.mass * (A_H_L[:, :3, :3] @ link.com + A_H_L[:, :3, 3])
            mass += link.mass
    return np.asarray(weighed / mass)


def centre_of_mass_in_sensor(
    robot: Robot, motion: Motion, contact: Contact, sensor: str
) -> Float[Array, "N 3"]:
    """Return the centre of mass [m] of the half beyond a sensor, in the sensor's frame."""
    half = robot.free_half(sensor, [contact.link])
    ft = robot.sensor(sensor)
    child_p = centre_of_mass(robot, motion, half.links, ft.child)
    S_H_child = inverse(ft.child_H_sensor)
    return np.asarray(child_p @ S_H_child[:3, :3].T + S_H_child[:3, 3])
