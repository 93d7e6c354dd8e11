"""Postures in which a robot stands still: its centre of mass over the sole that carries it.

Balance is judged at rest: of a robot that moves slowly the ground projection of the centre of mass
is where its weight presses. A posture is found by damped Gauss-Newton steps on what is demanded of
it (a point under the centre of mass, a second sole that stays, a trunk that stays level), each the
least change from the posture given that meets the linearised demands (A. Ben-Israel, "A modified
Newton-Raphson method", Israel J. Math. 3, 1965; damping as in Y. Nakamura, H. Hanafusa, "Inverse
kinematic solutions with singularity robustness", J. Dyn. Sys. Meas. Control 108, 1986).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, raise_all
from ftcal.kinematics import centre_of_mass
from ftcal.limits import Pace, spans
from ftcal.motion import Motion
from ftcal.robot import Robot
from ftcal.skeleton import Figure, Skeleton
from ftcal.spatial import inverse

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

TOLERANCE = 1e-6
"""How well a demand is met [m, rad]: a thousandth of what anyone could see."""

STEPS = 30
"""Gauss-Newton steps before a posture is given up; half a dozen is usual."""

PULLED = 10
"""First steps that also look for the least change; the last few only meet the demands."""

LONGEST = 0.3
"""Longest step of a joint [rad or m]: the demands are not linear beyond."""

DAMPING = 1e-8
"""Added to the squares of the singular values: a straight leg has one of zero."""

NUDGE = 1e-7
"""Step of the difference quotients [rad or m]: half the digits of the poses."""

UNBENT = 0.1
"""Share of the way to the middle of its range where the search begins at each joint.

A straight leg cannot get shorter to first order; from a slightly bent one the steps see how."""


@dataclass(frozen=True, slots=True)
class Sole:
    """A rectangle under a foot, and the frame it is given in; z of the frame points up."""

    frame: str
    """Link or frame of the sole; level while it stands."""
    x: tuple[float, float] = (-0.05, 0.09)
    """Back and front edge in the frame [m].

    The defaults suit the foot of an iCub 2.5, whose metal reaches from -0.068 to 0.130 and from
    -0.045 to 0.053: at least 1.8 cm less on every side."""
    y: tuple[float, float] = (-0.025, 0.025)
    """Right and left edge in the frame [m]."""

    def __post_init__(self) -> None:
        raise_all(
            DataError,
            f"sole {self.frame!r}",
            [
                f"{axis} = ({low:g}, {high:g}) m must be finite and increase"
                for axis, (low, high) in (("x", self.x), ("y", self.y))
                if not -np.inf < low < high < np.inf
            ],
        )

    @property
    def middle(self) -> Float[Array, "2"]:
        """Middle of the rectangle [m]."""
        return np.array([sum(self.x) / 2.0, sum(self.y) / 2.0])

    @property
    def corners(self) -> Float[Array, "4 3"]:
        """Corners of the rectangle in the sole's frame [m]."""
        return np.array([[x, y, 0.0] for x in self.x for y in self.y])

    def inside(self, points: Float[Array, "N 2"]) -> Float[Array, "N"]:
        """Return the distance of points to the nearest edge [m], negative outside."""
        (back, front), (right, left) = self.x, self.y
        x, y = np.asarray(points).T
        return np.asarray(np.min([x - back, front - x, y - right, left - y], axis=0))


def balance_margin(robot: Robot, motion: Motion, sole: Sole) -> Float[Array, "N"]:
    """Return how far [m] the centre of mass is from the nearest edge of the sole that carries it.

    Negative where its ground projection is outside: there the robot would tip over, slowly.
    """
    return sole.inside(centre_of_mass(robot, motion, tuple(robot.links), sole.frame)[:, :2])


Demand = Callable[[Figure], "Float[Array, 'N E']"]
"""What is wrong with postures [m, rad]: zero where they are as they should be."""


def over(point: Float[Array, "2"]) -> Demand:
    """Demand the centre of mass over a point [m] of the frame that the robot stands on."""
    return lambda figure: figure.com[:, :2] - point


def held(frame: str, G_H_frame: Float[Array, "4 4"]) -> Demand:
    """Demand a frame at a pose in the frame that the robot stands on, as a foot that is planted."""
    frame_H_G = inverse(G_H_frame)

    def away(figure: Figure) -> Float[Array, "N 6"]:
        there_H_frame = frame_H_G @ figure.pose(frame)
        R = there_H_frame[:, :3, :3]
        turned = (R - np.swapaxes(R, 1, 2))[:, (2, 0, 1), (1, 2, 0)] / 2.0
        return np.concatenate([there_H_frame[:, :3, 3], turned], axis=1)

    return away


def level(frame: str) -> Demand:
    """Demand z of a frame upright, as a trunk that is carried level."""
    return lambda figure: figure.pose(frame)[:, :2, 2]


@dataclass(frozen=True, slots=True, eq=False)
class Approach:
    """The posture nearest to what was demanded."""

    posture: Float[Array, "J"]
    """Position of every moving joint of the robot [rad or m]."""
    miss: float
    """Greatest error of a demand [m, rad]."""

    @property
    def reached(self) -> bool:
        """Whether all demands are met."""
        return self.miss < TOLERANCE


@dataclass(frozen=True, slots=True, eq=False)
class Poser:
    """A robot on a frame, and the joints by which it takes its posture."""

    bones: Skeleton
    """The robot on the frame that carries it; `joints` are among those that move."""
    columns: Int[Array, "V"]
    """Place of the joints that may be changed among the robot's moving joints."""
    low: Float[Array, "J"]
    """Least position of every moving joint [rad or m]."""
    high: Float[Array, "J"]
    """Greatest position of every moving joint [rad or m]."""

    def approach(self, posture: Float[Array, "J"], demands: Sequence[Demand]) -> Approach:
        """Return the posture nearest to `posture` that meets `demands`, within the limits.

        Minimises `|q - posture|^2` subject to `demands(q) = 0`; each of the first steps solves it
        with the demands made linear. The change is the least one as far as these steps come.
        """
        c = self.columns
        low, high, given = self.low[c], self.high[c], posture[c]
        q = np.clip(given + UNBENT * ((low + high) / 2.0 - given), low, high)
        best = Approach(posture, np.inf)
        for count in range(STEPS):
            wrong, slope = self._linear(posture, q, demands)
            miss = float(np.abs(wrong).max())
            if miss < best.miss or miss < TOLERANCE:
                best = Approach(_changed(posture, c, q), miss)
            back = (given - q) * (count < PULLED)
            step = _least_change(back, -wrong, slope, low - q, high - q)
            if best.reached and np.abs(step).max() < 1e-3:
                break
            q = np.clip(q + step * (LONGEST / max(LONGEST, np.abs(step).max())), low, high)
        return best

    def reach(
        self, posture: Float[Array, "J"], demands: Sequence[Demand], *, aim: str
    ) -> Float[Array, "J"]:
        """Return the posture nearest to `posture` that meets `demands`, within the limits.

        Raises `DataError` with what is missing to the `aim` where there is none.
        """
        found = self.approach(posture, demands)
        if not found.reached:
            raise DataError(
                f"{aim}: out of reach of the joints by {found.miss:.2g} m or rad; ask for less, or"
                " give another home or more joints"
            )
        return found.posture

    def _linear(
        self, posture: Float[Array, "J"], q: Float[Array, "V"], demands: Sequence[Demand]
    ) -> tuple[Float[Array, "E"], Float[Array, "E V"]]:
        """Return the errors of a posture and their slope along each joint."""
        rows = np.tile(_changed(posture, self.columns, q), (len(q) + 1, 1))
        rows[np.arange(1, len(q) + 1), self.columns] += NUDGE
        figure = self.bones.figure(rows)
        wrong = np.concatenate([demand(figure) for demand in demands], axis=1)
        return wrong[0], (wrong[1:] - wrong[0]).T / NUDGE


def poser(bones: Skeleton, robot: Robot, joints: Sequence[str], pace: Pace) -> Poser:
    """Return what takes postures by `joints`, within their limits less the margin of `pace`."""
    columns = np.array([robot.moving_joints.index(robot.joint(name).name) for name in joints])
    return Poser(bones, columns, *spans(robot, pace))


def _changed(
    posture: Float[Array, "J"], columns: Int[Array, "V"], q: Float[Array, "V"]
) -> Float[Array, "J"]:
    posture = posture.copy()
    posture[columns] = q
    return posture


def _least_change(
    back: Float[Array, "V"],
    wanted: Float[Array, "E"],
    slope: Float[Array, "E V"],
    low: Float[Array, "V"],
    high: Float[Array, "V"],
) -> Float[Array, "V"]:
    """Return the step nearest to `back` with `slope @ step = wanted`, between `low` and `high`.

    A joint that the step would take beyond a limit is stopped there, the others do its part.
    """
    step, free = np.clip(back, low, high), np.ones(len(back), dtype=np.bool_)
    while free.any():
        rest = wanted - slope[:, ~free] @ step[~free]
        J = slope[:, free]
        push = np.linalg.solve(J @ J.T + DAMPING * np.eye(len(J)), rest - J @ back[free])
        step[free] = back[free] + J.T @ push
        beyond = free & ((step < low) | (step > high))
        if not beyond.any():
            break
        step = np.clip(step, low, high)
        free &= ~beyond
    return np.asarray(step)
