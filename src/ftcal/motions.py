"""Invented motions for any robot: where to move so that a sensor feels something.

All are minimum-jerk moves from rest to rest between waypoints (T. Flash, N. Hogan, "The
coordination of arm movements", J. Neurosci. 5(7), 1985): position, velocity and acceleration are
continuous and known exactly at any time. They keep joint limits, speed limits and a bound on the
acceleration. They know nothing of balance, of self-collision or of the floor: look at a motion in
a simulator before a robot runs it.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ftcal.errors import DataError, RobotError, raise_all
from ftcal.motion import Motion
from ftcal.robot import Joint, Robot

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

PEAK_SPEED = 15.0 / 8.0
"""Greatest speed of a minimum-jerk move of length 1 in time 1."""

PEAK_ACCELERATION = 10.0 / np.sqrt(3.0)
"""Greatest acceleration of a minimum-jerk move of length 1 in time 1."""

QUARTER_TURN = np.pi / 2.0
"""How far a joint without limits goes either way [rad]."""

SCATTER = 0.1
"""Share of a level by which the points of a grid leave their place."""

REST = 1.0
"""Stillness at both ends of every motion [s]: what a smoothing window eats."""


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


class Trajectory(Protocol):
    """A motion known at any time; what `ftcal.synthetic` needs of a user's own."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that move or are held."""
        ...

    @property
    def duration(self) -> float:
        """Seconds from 0 to the end."""
        ...

    def at(self, time: Float[Array, "N"]) -> Motion:
        """Return the motion at `time` [s], increasing, within or beyond [0, duration]."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class MinimumJerk:
    """Rest-to-rest moves between waypoints; still before the first and after the last."""

    joints: tuple[str, ...]
    """Joint name of each column."""
    times: Float[Array, "K"]
    """When each waypoint is reached [s], from 0, strictly increasing."""
    waypoints: Float[Array, "K J"]
    """Joint positions [rad or m]; equal neighbours are a pause."""

    @property
    def duration(self) -> float:
        """Seconds from 0 to the last waypoint."""
        return float(self.times[-1])

    def at(self, time: Float[Array, "N"]) -> Motion:
        """Return the motion at `time` [s].

        A move by d in T seconds: `q = q0 + d (10 s^3 - 15 s^4 + 6 s^5)` with `s = (t - t0) / T`.
        """
        move = np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2)
        T = np.diff(self.times)[move, None]
        s = np.clip((time - self.times[move])[:, None] / T, 0.0, 1.0)
        d = np.diff(self.waypoints, axis=0)[move]
        return Motion(
            np.asarray(time, dtype=np.float64),
            self.joints,
            self.waypoints[move] + d * (s**3 * (10.0 - 15.0 * s + 6.0 * s**2)),
            d / T * (30.0 * (s * (1.0 - s)) ** 2),
            d / T**2 * (60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)),
        )

    def sampled(self, rate: float = 100.0) -> Motion:
        """Return the motion from 0 to its end at `rate` samples per second."""
        return self.at(np.arange(int(self.duration * rate) + 1) / rate)


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
    posture = _home(robot, home or {}, pace)
    box = _box(robot, joints, posture, reach, pace)
    columns = [robot.moving_joints.index(joint) for joint in joints]
    nodes = np.tile(posture, (int(np.prod(counts)) + 2, 1))
    nodes[1:-1, columns] = _scattered(counts, np.array([box[joint] for joint in joints]))
    needed = [_least_time(robot, b - a, pace) for a, b in itertools.pairwise(nodes)]
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


def balancing(
    robot: Robot,
    joints: Sequence[str],
    *,
    generator: np.random.Generator,
    duration: float = 60.0,
    reach: float = 0.2,
    support: Sequence[str] = (),
    sway: float = 0.02,
    home: Mapping[str, float] | None = None,
    pace: Pace | None = None,
) -> MinimumJerk:
    """Return small moves of a free limb while the robot stands on another (contact: its sole).

    Random postures of `joints` within the share `reach` of their range about `home`, one after the
    other; the `support` joints sway by up to `sway` [rad], all others stay.
    Raises `DataError` where the duration [s] is too short for a single move, `RobotError` for
    unknown or fixed joints.
    """
    pace = pace or Pace(speed=0.6, acceleration=2.0)
    posture = _home(robot, home or {}, pace)
    box = _box(robot, joints, posture, reach, pace)
    if both := sorted(set(joints) & set(support)):
        raise DataError(f"joints {', '.join(both)} cannot both support the robot and move freely")
    for joint, (low, high) in _box(robot, support, posture, 1.0, pace).items():
        here = posture[robot.moving_joints.index(joint)]
        box[joint] = (max(low, here - sway), min(high, here + sway))
    return _wander(robot, box, posture, generator, duration, pace)


def extended_balancing(
    robot: Robot,
    joints: Sequence[str],
    *,
    generator: np.random.Generator,
    duration: float = 90.0,
    reach: float = 0.8,
    support: Sequence[str] = (),
    sway: float = 0.02,
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
        home=home,
        pace=pace or Pace(acceleration=2.5),
    )


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


def _home(robot: Robot, home: Mapping[str, float], pace: Pace) -> Float[Array, "J"]:
    """Return the posture `home`, with zero moved into the limits for the joints it leaves out."""
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


def _box(
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


def _least_time(robot: Robot, step: Float[Array, "J"], pace: Pace) -> float:
    """Return the least duration [s] of a move by `step` within all limits."""
    allowed = [robot.joints[name].velocity for name in robot.moving_joints]
    # some descriptions leave the speed at zero
    speed = np.array([min(v, pace.speed) if v > 0.0 else pace.speed for v in allowed])
    by_speed = PEAK_SPEED * np.abs(step) / speed
    by_acceleration = np.sqrt(PEAK_ACCELERATION * np.abs(step) / pace.acceleration)
    return float(max(by_speed.max(), by_acceleration.max()))


def _wander(
    robot: Robot,
    box: Mapping[str, tuple[float, float]],
    posture: Float[Array, "J"],
    generator: np.random.Generator,
    duration: float,
    pace: Pace,
) -> MinimumJerk:
    """Return moves between random postures inside `box`, from home and back to it."""
    columns = [robot.moving_joints.index(name) for name in box]
    low, high = np.array(list(box.values())).reshape(-1, 2).T
    times, nodes = [0.0, REST], [posture, posture]
    while True:
        node = posture.copy()
        node[columns] = generator.uniform(low, high)
        least = _least_time(robot, node - nodes[-1], pace)
        # not always flat out: several speeds tell momentum from weight
        arrival = times[-1] + least * generator.uniform(1.0, 1.8)
        if arrival + _least_time(robot, posture - node, pace) + REST > duration:
            break
        times.append(arrival)
        nodes.append(node)
    if len(nodes) == 2:
        raise DataError(f"{duration:g} s are too short for one move there and back; take longer")
    times += [duration - REST, duration]
    nodes += [posture, posture]
    return MinimumJerk(robot.moving_joints, np.array(times), np.array(nodes))
