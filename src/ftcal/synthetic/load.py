"""What the sensors feel of a robot that several frames carry, and that may brush the floor.

Shares a_i of the weight, and w_i the wrench that a sensor would feel if frame i carried all:
`w = sum_i a_i w_i`. Each w_i satisfies the balance of every sub-model that touches nothing, and so
does w.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ftcal.dynamics import expected_wrenches
from ftcal.kinematics import relative_pose
from ftcal.motion import FixedContact, MovingContact
from ftcal.robot import Robot
from ftcal.support import Support
from ftcal.synthetic.faults import Brush
from ftcal.trajectory import Trajectory, progress

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

TOUCH_TIME = 0.1
"""How long a brushing frame takes to press with its share, and to let go [s]."""

STEP = 1e-3
"""Between the poses whose differences are the motion of a brushing frame [s]."""


def felt(
    robot: Robot,
    trajectory: Trajectory,
    support: Support,
    brushes: Iterable[Brush],
    sensors: Sequence[str],
    time: Float[Array, "N"],
) -> dict[str, Float[Array, "N 6"]]:
    """Return the wrench [N, Nm] on each of `sensors` at `time` [s], ascending.

    Each frame counts over the samples where it carries. `RobotError`, `DataError`: names the robot
    or the motion lacks.
    """
    motion, shares = trajectory.at(time), support.at(time)
    wrenches = {sensor: np.zeros((len(time), 6)) for sensor in sensors}
    for frame, share in zip(support.frames, shares.T, strict=True):
        rows = share > 0.0
        if rows.any():
            contact = FixedContact(frame, support.gravity)
            alone = expected_wrenches(robot, motion.rows(rows), contact, sensors)
            for sensor, wrench in alone.items():
                wrenches[sensor][rows] += share[rows, None] * wrench
    for brush in brushes:
        pressed = pressure(brush, time)
        # seen from the frame that carries most, which stands still
        for column, anchor in enumerate(support.frames):
            rows = (pressed > 0.0) & (shares.argmax(axis=1) == column)
            if rows.any() and anchor != brush.frame:
                seen = moving(robot, trajectory, anchor, brush.frame, time[rows], support)
                alone = expected_wrenches(robot, motion.rows(rows), seen, sensors)
                for sensor, wrench in alone.items():
                    part = pressed[rows, None]
                    wrenches[sensor][rows] += part * (wrench - wrenches[sensor][rows])
    return wrenches


def pressure(brush: Brush, time: Float[Array, "N"]) -> Float[Array, "N"]:
    """Return the share of the weight on a brushing frame at `time` [s]; it comes and goes."""
    comes = np.clip((time - brush.start) / TOUCH_TIME + 1.0, 0.0, 1.0)
    goes = np.clip((brush.stop - time) / TOUCH_TIME + 1.0, 0.0, 1.0)
    return np.asarray(brush.share * progress(comes) * progress(goes))


def moving(
    robot: Robot,
    trajectory: Trajectory,
    anchor: str,
    frame: str,
    time: Float[Array, "N"],
    support: Support,
) -> MovingContact:
    """Return the motion of `frame` while `anchor` stands still, both as contacts.

    With R the attitude of the frame: `[w]x = R' dR/dt`, and `[dw/dt]x` is the antisymmetric part of
    `R' d2R/dt2` (its symmetric one is `[w]x [w]x`).
    """
    before, here, after = (
        relative_pose(robot, trajectory.at(time + shift), anchor, frame)
        for shift in (-STEP, 0.0, STEP)
    )
    to_frame = np.swapaxes(here[:, :3, :3], 1, 2)
    rate = to_frame @ ((after - before)[:, :3] / (2.0 * STEP))
    change = to_frame @ ((after - 2.0 * here + before)[:, :3] / STEP**2)
    return MovingContact(
        frame,
        gravity=to_frame @ np.asarray(support.gravity),
        angular_velocity=_turn(rate),
        linear_acceleration=change[:, :, 3],
        angular_acceleration=_turn(change),
    )


def _turn(M: Float[Array, "N 3 4"]) -> Float[Array, "N 3"]:
    """Return the vector of the antisymmetric part of each matrix."""
    return np.stack(
        [M[:, i, j] - M[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1
    ) / 2.0  # fmt: skip
