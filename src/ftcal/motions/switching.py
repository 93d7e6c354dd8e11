"""The paper's validation run: in the air, then on one foot, then on the other (section IV-C).

The robot hangs on a pole and moves its legs; it is lowered onto both soles; its weight goes over
the left foot, the right leg is lifted, stretched and bent while the left knee bends; the foot comes
back to where it stood, and the same follows on the other side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, raise_all
from ftcal.limits import Pace, home_posture, least_time, reachable
from ftcal.motions.feet import Leg, feet
from ftcal.motions.wander import REST, wander
from ftcal.robot import Robot
from ftcal.support import Support
from ftcal.trajectory import MinimumJerk

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

CALM_SPEED, CALM_ACCELERATION = 0.4, 1.0
"""Of moves with both feet planted and the first ones in the air [rad/s, rad/s^2]: near statics."""

LOWERING = 3.0
"""How long the pole takes to give the weight to the feet [s]; the joints stay."""

SHORTEST = 0.5
"""Shortest move [s] of a shift or a lift."""

IN_THE_AIR = (0.12, 0.35)
"""Shares of the range of their joints in which the legs move in the air: first calm, then wide."""


@dataclass(frozen=True, slots=True, eq=False)
class Walk:
    """A motion, and who carries the robot meanwhile."""

    trajectory: MinimumJerk
    """How the joints move."""
    support: Support
    """Which of the pole and the soles carry, and how much."""


@dataclass(frozen=True, slots=True, eq=False)
class _Script:
    """Waypoints, and who carries at each, as they are written one after the other."""

    robot: Robot
    calm: Pace
    times: list[float] = field(default_factory=list)
    nodes: list[Float[Array, "J"]] = field(default_factory=list)
    shares: list[Sequence[float]] = field(default_factory=list)

    def stay(self, seconds: float, shares: Sequence[float]) -> None:
        """Stand still while the weight moves to where `shares` say."""
        self._add(self.times[-1] + seconds, self.nodes[-1], shares)

    def move(self, node: Float[Array, "J"], shares: Sequence[float]) -> None:
        """Move calmly to a posture, the weight to where `shares` say."""
        seconds = max(least_time(self.robot, node - self.nodes[-1], self.calm), SHORTEST)
        self._add(self.times[-1] + seconds, node, shares)

    def play(self, part: MinimumJerk, shares: Sequence[float]) -> None:
        """Move as `part` does, from where the last move ended or from the very beginning."""
        start = self.times[-1] if self.times else 0.0
        for time, node in list(zip(part.times, part.waypoints, strict=True))[bool(self.times) :]:
            self._add(start + float(time), node, shares)

    def _add(self, time: float, node: Float[Array, "J"], shares: Sequence[float]) -> None:
        self.times.append(time)
        self.nodes.append(node)
        self.shares.append(shares)

    def walk(self, frames: tuple[str, ...]) -> Walk:
        """Return what was written; `frames` are those the shares belong to."""
        times = np.array(self.times)
        trajectory = MinimumJerk(self.robot.moving_joints, times, np.array(self.nodes))
        return Walk(trajectory, Support(frames, times, np.array(self.shares)))


def switching(
    robot: Robot,
    *,
    pole: str,
    left: Leg,
    right: Leg,
    generator: np.random.Generator,
    hanging: float = 15.0,
    swing: float = 35.0,
    reach: float = 0.6,
    bend: float = 0.3,
    lift: float = 0.04,
    home: Mapping[str, float] | None = None,
    pace: Pace | None = None,
) -> Walk:
    """Return the walk from `pole` to both feet, the left foot, both, the right foot, both.

    In the air the legs move for `hanging` seconds, small and slow, then wide. For `swing` seconds
    on each foot the free leg moves within the share `reach` of the range of its joints, the leg
    that stands within `bend`, after the free foot was lifted by `lift` [m]. The frame `pole` stays
    level, the robot in balance wherever it stands, a free sole above the floor. Where both feet
    stand, their shares of the weight follow from where the centre of mass lies between them.
    Raises `DataError` where the soles at `home` (default: zero, moved into the limits) are not
    level, at one height and below the robot's weight, or a posture or the time does not suffice;
    `RobotError` for unknown names.
    """
    pace = pace or Pace(acceleration=2.5)
    faults = []
    if not 0.0 < lift < np.inf:
        faults.append(f"lift = {lift:g} m must be positive and finite")
    if both := sorted(set(left.joints) & set(right.joints)):
        faults.append(f"joints {', '.join(both)} are in both legs; give each its own")
    raise_all(DataError, "switching", faults)
    posture = home_posture(robot, home or {}, pace)
    calm = replace(
        pace,
        speed=min(pace.speed, CALM_SPEED),
        acceleration=min(pace.acceleration, CALM_ACCELERATION),
    )
    on_left = feet(robot, left, right, trunk=pole, home=posture, pace=pace)
    on_right = feet(robot, right, left, trunk=pole, home=posture, pace=pace)
    raise_all(DataError, "home", on_left.faults())
    script = _Script(robot, calm)
    for share, how in zip(IN_THE_AIR, (calm, pace), strict=True):
        box = reachable(robot, (*left.joints, *right.joints), posture, share, pace)
        part = wander(robot, box, posture, generator=generator, duration=hanging / 2.0, pace=how)
        script.play(part, (1.0, 0.0, 0.0))
    script.stay(LOWERING, (0.0, on_left.share, 1.0 - on_left.share))
    script.stay(REST, script.shares[-1])

    for stands, own in ((on_left, 1), (on_right, 2)):
        shift = stands.shift()
        lifts = stands.lifted(shift.postures[-1], lift)
        air = stands.swing(
            lifts[-1], reach=reach, bend=bend, generator=generator, duration=swing, pace=pace
        )
        shifting = list(zip(shift.postures, (_row(own, a) for a in shift.shares), strict=True))
        lifting = [(node, _row(own, 1.0)) for node in lifts]
        home_again = (posture, _row(own, stands.share))
        for node, shares in (*shifting, *lifting):
            script.move(node, shares)
        script.play(air, _row(own, 1.0))
        for node, shares in (*reversed((home_again, *shifting, *lifting[:-1])),):
            script.move(node, shares)
    script.stay(REST, script.shares[-1])
    return script.walk((pole, left.sole.frame, right.sole.frame))


def _row(own: int, share: float) -> tuple[float, ...]:
    """Return the shares of pole, left and right sole where sole `own` carries `share`."""
    return (0.0, share, 1.0 - share) if own == 1 else (0.0, 1.0 - share, share)
