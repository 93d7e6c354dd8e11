"""Moves of a free limb of a robot that stands on another (the paper's balancing data sets)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError
from ftcal.limits import Pace, home_posture, reachable
from ftcal.motions.footing import Footing
from ftcal.motions.wander import Place, anywhere, wander
from ftcal.posture import Sole, poser
from ftcal.robot import Robot
from ftcal.skeleton import skeleton
from ftcal.trajectory import MinimumJerk

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


def balancing(
    robot: Robot,
    joints: Sequence[str],
    *,
    generator: np.random.Generator,
    duration: float = 60.0,
    reach: float = 0.2,
    support: Sequence[str] = (),
    sway: float = 0.02,
    sole: Sole | None = None,
    home: Mapping[str, float] | None = None,
    pace: Pace | None = None,
) -> MinimumJerk:
    """Return small moves of a free limb while the robot stands on another (contact: its sole).

    Random postures of `joints` within the share `reach` of their range about `home`, one after the
    other; the `support` joints sway by up to `sway` [rad], all others stay. With a `sole`, the
    support first brings the centre of mass over the middle of it, sways about that, and the centre
    of mass stays above the sole all the time; without, balance is not looked after.
    Raises `DataError` where the duration [s] is too short for a single move or balance cannot be
    had, `RobotError` for unknown or fixed joints.
    """
    pace = pace or Pace(speed=0.6, acceleration=2.0)
    posture = home_posture(robot, home or {}, pace)
    box = reachable(robot, joints, posture, reach, pace)
    if both := sorted(set(joints) & set(support)):
        raise DataError(f"joints {', '.join(both)} cannot both support the robot and move freely")
    place: Place = anywhere
    if sole is not None:
        footing = _footing(robot, sole, posture, joints, support, pace)
        posture, place = footing.balanced(posture), footing.swaying
    for joint, (low, high) in reachable(robot, support, posture, 1.0, pace).items():
        here = posture[robot.moving_joints.index(joint)]
        box[joint] = (max(low, here - sway), min(high, here + sway))
    return wander(
        robot, box, posture, generator=generator, duration=duration, pace=pace, place=place
    )


def extended_balancing(
    robot: Robot,
    joints: Sequence[str],
    *,
    generator: np.random.Generator,
    duration: float = 90.0,
    reach: float = 0.8,
    support: Sequence[str] = (),
    sway: float = 0.02,
    sole: Sole | None = None,
    home: Mapping[str, float] | None = None,
    pace: Pace | None = None,
) -> MinimumJerk:
    """Return wide and brisk moves of a free limb, its knee included; else like `balancing`."""
    return balancing(
        robot,
        joints,
        generator=generator,
        duration=duration,
        reach=reach,
        support=support,
        sway=sway,
        sole=sole,
        home=home,
        pace=pace or Pace(acceleration=2.5),
    )


def _footing(
    robot: Robot,
    sole: Sole,
    posture: Float[Array, "J"],
    joints: Sequence[str],
    support: Sequence[str],
    pace: Pace,
) -> Footing:
    """Return the ground under a robot that moves `joints` while `support` balances it."""
    if not support:
        raise DataError(f"balance on sole {sole.frame!r} needs support joints; name those above it")
    bones = skeleton(robot, sole.frame, posture, {*joints, *support})
    return Footing(sole, poser(bones, robot, support, pace))
