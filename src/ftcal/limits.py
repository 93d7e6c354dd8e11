"""Within which limits an invented motion stays: positions, speeds, accelerations of the joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, RobotError, raise_all
from ftcal.robot import Joint, Robot
from ftcal.trajectory import PEAK_ACCELERATION, PEAK_SPEED

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

QUARTER_TURN = np.pi / 2.0
"""How far a joint without limits goes either way [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How far from its limits a motion stays."""

    speed: float = 1.0
    """Greatest joint speed [rad/s or m/s], where the robot description does not allow less."""
    acceleration: float = 4.0
    """Greatest joint acceleration [rad/s^2 or m/s^2]."""
    margin: float = 0.05
    """Distance kept from both position limits [rad or m]."""

    def __post_init__(self) -> None:
        faults = [
            f"{name} = {value:g} must be positive and finite"
            for name, value in (("speed", self.speed), ("acceleration", self.acceleration))
            if not 0.0 < value < np.inf
        ]
        if not 0.0 <= self.margin < np.inf:
            faults.append(f"margin = {self.margin:g} must be zero or more and finite")
        raise_all(DataError, "pace", faults)


def _span(joint: Joint, pace: Pace) -> tuple[float, float]:
    """Return the positions a joint may take; its middle alone where the margins meet."""
    if joint.kind == "fixed":
        raise RobotError(f"joint {joint.name!r} is fixed; it cannot move")
    unlimited = not np.isfinite([joint.lower, joint.upper]).all()
    if unlimited and joint.kind == "prismatic":
        raise RobotError(f"prismatic joint {joint.name!r} has no limits; give it some in the URDF")
    low = joint.lower + pace.margin if np.isfinite(joint.lower) else -QUARTER_TURN
    high = joint.upper - pace.margin if np.isfinite(joint.upper) else QUARTER_TURN
    return (low, high) if low <= high else ((low + high) / 2.0,) * 2


def spans(robot: Robot, pace: Pace) -> tuple[Float[Array, "J"], Float[Array, "J"]]:
    """Return least and greatest position of every moving joint [rad or m].

    Raises `RobotError` for a prismatic joint without limits.
    """
    low, high = np.array([_span(robot.joint(n), pace) for n in robot.moving_joints]).T
    return low, high


def home_posture(robot: Robot, home: Mapping[str, float], pace: Pace) -> Float[Array, "J"]:
    """Return the posture `home`, with zero moved into the limits for the joints it leaves out.

    One position per moving joint, in the robot's order [rad or m]. Raises `RobotError` for unknown
    or fixed joints and for a position outside the limits.
    """
    posture = {}
    for name in robot.moving_joints:
        low, high = _span(robot.joint(name), pace)
        posture[name] = min(max(0.0, low), high)
    for name, position in home.items():
        low, high = _span(robot.joint(name), pace)
        if not low <= position <= high:
            raise RobotError(
                f"home of joint {name!r} is {position:g}, outside [{low:.4g}, {high:.4g}] (its"
                f" limits less {pace.margin:g}); move it inside"
            )
        posture[name] = position
    return np.array(list(posture.values()))


def reachable(
    robot: Robot, joints: Sequence[str], posture: Float[Array, "J"], reach: float, pace: Pace
) -> dict[str, tuple[float, float]]:
    """Return the positions each of `joints` may take: the share `reach` of its range about home."""
    if not 0.0 < reach <= 1.0:
        raise DataError(f"reach = {reach:g} is a share of the range of a joint: above 0, up to 1")
    box = {}
    for name in joints:
        low, high = _span(robot.joint(name), pace)
        here = float(posture[robot.moving_joints.index(name)])
        box[name] = (here + reach * (low - here), here + reach * (high - here))
    return box


def least_time(robot: Robot, step: Float[Array, "J"], pace: Pace) -> float:
    """Return the least duration [s] of a minimum-jerk move by `step` within all limits."""
    allowed = [robot.joints[name].velocity for name in robot.moving_joints]
    # some descriptions leave the speed at zero
    speed = np.array([min(v, pace.speed) if v > 0.0 else pace.speed for v in allowed])
    by_speed = PEAK_SPEED * np.abs(step) / speed
    by_acceleration = np.sqrt(PEAK_ACCELERATION * np.abs(step) / pace.acceleration)
    return float(max(by_speed.max(), by_acceleration.max()))
