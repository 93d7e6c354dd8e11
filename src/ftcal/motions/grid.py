"""The paper's grid: a limb that hangs takes every direction of gravity in turn (section IV-C)."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError
from ftcal.limits import Pace, home_posture, least_time, reachable
from ftcal.motions.wander import REST
from ftcal.robot import Robot
from ftcal.trajectory import MinimumJerk

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

SCATTER = 0.1
"""Share of a level by which the points of a grid leave their place."""


def grid(
    robot: Robot,
    joints: Sequence[str],
    *,
    points: int | Sequence[int] = 5,
    duration: float = 100.0,
    settle: float = 1.0,
    reach: float = 0.8,
    home: Mapping[str, float] | None = None,
    pace: Pace | None = None,
) -> MinimumJerk:
    """Return a walk over a grid of `joints`, `settle` seconds still at every point.

    For a limb of a robot that hangs on a pole (contact: its waist): quasi-static, every direction
    of gravity in turn. The last of `joints` moves from point to point, to and fro; the first is the
    slowest. `points` a joint cover the share `reach` of its range about `home` (default: zero,
    moved into the limits), where all other joints stay. Moves are slowed to last the duration [s].
    Raises `DataError` where it is too short, `RobotError` for unknown or fixed joints.
    """
    pace = pace or Pace()
    if not settle > 0.0:
        raise DataError(f"grid: settle = {settle:g} s must be positive")
    counts = [points] * len(joints) if isinstance(points, int) else list(points)
    if len(counts) != len(joints) or not joints or min(counts) < 1:
        raise DataError(f"grid: points = {points} for {len(joints)} joints; give one or more each")
    posture = home_posture(robot, home or {}, pace)
    box = reachable(robot, joints, posture, reach, pace)
    columns = [robot.moving_joints.index(joint) for joint in joints]
    nodes = np.tile(posture, (int(np.prod(counts)) + 2, 1))
    nodes[1:-1, columns] = _scattered(counts, np.array([box[joint] for joint in joints]))
    needed = [least_time(robot, b - a, pace) for a, b in itertools.pairwise(nodes)]
    still = 2.0 * REST + settle * (len(needed) - 1)
    stretch = (duration - still) / max(sum(needed), 1e-9)
    if stretch < 1.0:
        raise DataError(
            f"grid of {len(nodes) - 2} points: {duration:g} s are too short for moves of"
            f" {sum(needed):.0f} s and {settle:g} s to settle at each; take"
            f" {np.ceil(still + sum(needed)):.0f} s or fewer points"
        )
    moves = [max(stretch * time, 1e-3) for time in needed]  # a move to where it is takes time too
    spans = [REST, *(span for move in moves[:-1] for span in (move, settle)), moves[-1], REST]
    times = np.concatenate(([0.0], np.cumsum(spans)))
    return MinimumJerk(robot.moving_joints, times, np.repeat(nodes, 2, axis=0))


def _scattered(counts: Sequence[int], box: Float[Array, "D 2"]) -> Float[Array, "N D"]:
    """Return the points of a grid in `box`, neighbours one level of one coordinate apart.

    Each is moved by up to `SCATTER` of a level: a joint that rests at one place again and again
    repeats the rounding error of its encoder, and no length of recording averages it out.
    """
    walk: Float[Array, "N D"] = np.empty((1, 0))
    for count in counts:
        there = np.arange(count)[:, None]
        rows = [
            np.hstack([np.tile(row, (count, 1)), there if k % 2 == 0 else there[::-1]])
            for k, row in enumerate(walk)
        ]
        walk = np.concatenate(rows)
    # multiples of irrational powers of two: evenly spread, no two alike
    steps = 2.0 ** (np.arange(1, len(counts) + 1) / (len(counts) + 1))
    shift = SCATTER * (np.arange(len(walk))[:, None] * steps % 1.0)
    low, high = box.T
    return np.asarray(low + (high - low) * (walk + shift) / (np.array(counts) - 1.0 + SCATTER))
