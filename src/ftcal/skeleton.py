"""The robot as few bodies that hang on the frame it stands on: where they are, where its mass is.

Search for a posture asks for poses and the centre of mass again and again. Here all joints but a
few are held, what they join is one body, and each body is placed once.
`ftcal.kinematics` gives the same for any two links and any motion, without the preparation.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.kinematics import joint_pose
from ftcal.robot import Joint, Robot
from ftcal.spatial import inverse

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True, eq=False)
class Hinge:
    """What connects a body to the one before it, nearer the ground."""

    before: int
    """Index of the body before."""
    before_H_near: Float[Array, "4 4"]
    """Pose, in the body before, of the link on its side of the joint."""
    joint: Joint
    """The joint between them."""
    column: int
    """Its place among the robot's moving joints."""
    downward: bool
    """Whether the body is on the child's side; its frame is the link there."""

    def crossed(self, position: Float[Array, "N"]) -> Float[Array, "N 4 4"]:
        """Return the pose of the body in the one before it at `position` [rad or m]."""
        parent_H_child = joint_pose(self.joint, position)
        near_H_far = parent_H_child if self.downward else inverse(parent_H_child)
        return np.asarray(self.before_H_near @ near_H_far)


@dataclass(frozen=True, slots=True, eq=False)
class Figure:
    """Postures of a skeleton, seen from the frame it stands on (G)."""

    G_H_bodies: tuple[Float[Array, "N 4 4"], ...]
    """Pose of every body."""
    frames: Mapping[str, tuple[int, Float[Array, "4 4"]]]
    """Body of every link, and the link's pose in it."""
    com: Float[Array, "N 3"]
    """Centre of mass [m]."""

    def pose(self, frame: str) -> Float[Array, "N 4 4"]:
        """Return the pose of a link or frame in the frame the robot stands on."""
        body, body_H_frame = self.frames[frame]
        return np.asarray(self.G_H_bodies[body] @ body_H_frame)


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """Bodies in an order in which each comes after the one before it; the first is the ground's."""

    hinges: tuple[Hinge, ...]
    """How each body but the first hangs on another."""
    frames: Mapping[str, tuple[int, Float[Array, "4 4"]]]
    """Body of every link, and the link's pose in it."""
    masses: Float[Array, "B"]
    """kg."""
    moments: Float[Array, "B 3"]
    """Mass times centre of mass in the body frame [kg m]."""

    def figure(self, postures: Float[Array, "N J"]) -> Figure:
        """Return where everything is in `postures`, one column per moving joint of the robot.

        The columns of held joints are not read.
        """
        G_H_bodies = [np.broadcast_to(np.eye(4), (len(postures), 4, 4))]
        for hinge in self.hinges:
            before_H_body = hinge.crossed(postures[:, hinge.column])
            G_H_bodies.append(G_H_bodies[hinge.before] @ before_H_body)
        weighed = sum(
            mass * G_H_B[:, :3, 3] + G_H_B[:, :3, :3] @ moment
            for mass, moment, G_H_B in zip(self.masses, self.moments, G_H_bodies, strict=True)
        )
        return Figure(tuple(G_H_bodies), self.frames, np.asarray(weighed / self.masses.sum()))


def skeleton(
    robot: Robot, ground: str, posture: Float[Array, "J"], moving: Collection[str]
) -> Skeleton:
    """Return the robot as it stands on frame `ground`, all but the `moving` joints held.

    `posture` has a column per moving joint of the robot [rad or m].
    """
    columns = {name: column for column, name in enumerate(robot.moving_joints)}
    beside: dict[str, list[Joint]] = {name: [] for name in robot.links}
    for joint in robot.joints.values():
        beside[joint.parent].append(joint)
        beside[joint.child].append(joint)
    hinges: list[Hinge] = []
    frames = {robot.link(ground).name: (0, np.eye(4))}
    order = [ground]
    for here in order:
        body, body_H_here = frames[here]
        for joint in beside[here]:
            downward = joint.parent == here
            there = joint.child if downward else joint.parent
            if there in frames:
                continue
            order.append(there)
            column = columns.get(joint.name, 0)
            hinge = Hinge(body, body_H_here, joint, column, downward)
            if joint.name in moving:
                hinges.append(hinge)
                frames[there] = (len(hinges), np.eye(4))
            else:
                frames[there] = (body, hinge.crossed(posture[[column]])[0])
    masses, moments = np.zeros(len(hinges) + 1), np.zeros((len(hinges) + 1, 3))
    for name, (body, body_H_link) in frames.items():
        link = robot.links[name]
        masses[body] += link.mass
        moments[body] += link.mass * (body_H_link[:3, :3] @ link.com + body_H_link[:3, 3])
    return Skeleton(tuple(hinges), frames, masses, moments)
