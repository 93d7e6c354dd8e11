"""Two feet on the floor: the weight goes over one of them, the other is lifted over its place."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError
from ftcal.limits import Pace, reachable
from ftcal.motions.footing import SAFE, Footing, between
from ftcal.motions.wander import wander
from ftcal.posture import Demand, Poser, Sole, held, level, over, poser
from ftcal.robot import Robot
from ftcal.skeleton import Figure, skeleton
from ftcal.trajectory import MinimumJerk

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

LIFTS = (0.25, 0.5, 1.0)
"""Shares of the height at which a foot that is lifted or put down is level, over its place."""

UNEVEN = 1e-3
"""Greatest difference of the heights of two soles at home [m]."""

TILTED = np.radians(0.25)
"""Greatest tilt of a sole at home, and greatest turn of one that stays in a shift [rad]."""

SLIP = 1.5e-3
"""How far a planted sole may be from its place between two postures of a shift [m]."""

POSTURES = (2, 4, 8, 16, 32)
"""How many postures a shift may have; more where the planted sole would slip between them."""


@dataclass(frozen=True, slots=True)
class Leg:
    """A leg the robot can stand on."""

    sole: Sole
    """Where it touches the floor; its frame is a contact of the walk."""
    joints: tuple[str, ...]
    """Joints that move it, in any order."""


@dataclass(frozen=True, slots=True, eq=False)
class Shift:
    """Postures from both feet to one, which alone carries in the last."""

    postures: tuple[Float[Array, "J"], ...]
    """Without the one it starts from."""
    shares: tuple[float, ...]
    """Share of the weight that the foot carries in each; 1 in the last."""


@dataclass(frozen=True, slots=True, eq=False)
class Feet:
    """A robot on both soles at home, about to stand on one; all in the frame of that sole (G)."""

    robot: Robot
    one: Leg
    """The leg that will carry all."""
    other: Leg
    """The leg that will be lifted."""
    footing: Footing
    """The robot on the sole of `one`; the joints of that leg balance it."""
    poser: Poser
    """The same, balanced by the joints of both legs."""
    home: Float[Array, "J"]
    """Posture in which both stand."""
    G_H_other: Float[Array, "4 4"]
    """Where the other sole stands."""
    trunk: str
    """Frame that stays level."""

    @property
    def share(self) -> float:
        """Share of the weight that the sole carries at home."""
        return float(self._shares(self._figure(self.home[None]))[0])

    def faults(self) -> list[str]:
        """Return what is wrong with home: soles not level, not at one height, not below the weight.

        Level is at right angles to z of the trunk.
        """
        figure = self._figure(self.home[None])
        found = [
            f"sole {name!r} is tilted by {np.degrees(tilt):.2g} deg against {self.trunk!r}; give a"
            " home with level soles"
            for name, tilt in (
                (self.one.sole.frame, _tilt(figure.pose(self.trunk)[0], np.eye(4))),
                (self.other.sole.frame, _tilt(figure.pose(self.trunk)[0], self.G_H_other)),
            )
            if tilt > TILTED
        ]
        if abs(height := float(self.G_H_other[2, 3])) > UNEVEN:
            found.append(
                f"sole {self.other.sole.frame!r} is {height:.2g} m above {self.one.sole.frame!r};"
                " give a home with both at one height"
            )
        if (margin := float(self._margin(figure)[0])) < SAFE:
            found.append(
                f"the centre of mass is {SAFE - margin:.2g} m outside of what both soles span less"
                f" {SAFE:g} m; give a home in balance"
            )
        return found

    def shift(self) -> Shift:
        """Return postures that bring the centre of mass over the sole, both feet planted.

        Raises `DataError` where there is none, or the other sole slips however many there are.
        """
        aim = f"weight over sole {self.one.sole.frame!r}, {self.other.sole.frame!r} planted"
        start = self._figure(self.home[None]).com[0, :2]
        for count in POSTURES:
            gone = np.arange(1, count + 1) / count
            nodes = [self.home]
            for share in gone:
                point = start + share * (self.one.sole.middle - start)
                nodes.append(self.poser.reach(nodes[-1], self._planted(over(point)), aim=aim))
            if self._stays(nodes):
                # the last to the digit: who carries nothing does not touch
                shares = (*(self.share + (1.0 - self.share) * gone[:-1]).tolist(), 1.0)
                return Shift(tuple(nodes[1:]), shares)
        raise DataError(
            f"{aim}: it slips by more than {1e3 * SLIP:g} mm, or balance is lost, between"
            f" {POSTURES[-1]} postures; give another home"
        )

    def lifted(self, posture: Float[Array, "J"], height: float) -> list[Float[Array, "J"]]:
        """Return postures that lift the other sole straight up by `height` [m], from `posture`.

        Raises `DataError` where the joints do not allow it.
        """
        aim = f"sole {self.other.sole.frame!r} lifted by {height:g} m"
        nodes = [posture]
        for share in LIFTS:
            G_H_up = self.G_H_other.copy()
            G_H_up[2, 3] += share * height
            demands = (over(self.one.sole.middle), held(self.other.sole.frame, G_H_up))
            nodes.append(self.poser.reach(nodes[-1], (*demands, level(self.trunk)), aim=aim))
        if not self.footing.safe(nodes):
            raise DataError(
                f"{aim}: it touches the floor on its way, or balance is lost; take another height"
                " or home"
            )
        return nodes[1:]

    def swing(
        self,
        posture: Float[Array, "J"],
        *,
        reach: float,
        bend: float,
        generator: np.random.Generator,
        duration: float,
        pace: Pace,
    ) -> MinimumJerk:
        """Return moves of the lifted leg, and of the one that stands, about `posture` [s].

        Within the shares `reach` and `bend` of the range of their joints.
        """
        box = reachable(self.robot, self.other.joints, posture, reach, pace)
        box |= reachable(self.robot, self.one.joints, posture, bend, pace)
        return wander(
            self.robot,
            box,
            posture,
            generator=generator,
            duration=duration,
            pace=pace,
            place=self.footing.middle,
        )

    def _figure(self, postures: Float[Array, "N J"]) -> Figure:
        return self.poser.bones.figure(postures)

    def _planted(self, demand: Demand) -> tuple[Demand, ...]:
        return (demand, held(self.other.sole.frame, self.G_H_other), level(self.trunk))

    def _middles(self) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
        """Return the middles of both soles [m], the one that will carry first."""
        beyond = self.G_H_other[:2, :2] @ self.other.sole.middle + self.G_H_other[:2, 3]
        return self.one.sole.middle, beyond

    def _shares(self, figure: Figure) -> Float[Array, "N"]:
        """Return the share of the sole: how near the centre of mass is, along the line of both."""
        here, there = self._middles()
        line = here - there
        return np.asarray(np.clip((figure.com[:, :2] - there) @ line / (line @ line), 0.0, 1.0))

    def _margin(self, figure: Figure) -> Float[Array, "N"]:
        """Return how far [m] the point of pressure is inside each sole, at the worse of the two.

        Both are pressed at a point that is off their middle by the same vector.
        """
        here, there = self._middles()
        share = self._shares(figure)[:, None]
        off = figure.com[:, :2] - share * here - (1.0 - share) * there
        other_off = off @ self.G_H_other[:2, :2]
        return np.asarray(
            np.minimum(
                self.one.sole.inside(here + off),
                self.other.sole.inside(self.other.sole.middle + other_off),
            )
        )

    def _stays(self, nodes: Sequence[Float[Array, "J"]]) -> bool:
        """Return whether the other sole stays, and the robot in balance, from node to node."""
        postures = np.concatenate([between(a, b) for a, b in itertools.pairwise(nodes)])
        figure = self._figure(postures)
        G_H_there = figure.pose(self.other.sole.frame)
        away = np.linalg.norm(G_H_there[:, :3, 3] - self.G_H_other[:3, 3], axis=1).max()
        R = self.G_H_other[:3, :3].T @ G_H_there[:, :3, :3]
        turned = np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0)).max()
        return bool(away < SLIP and turned < TILTED and self._margin(figure).min() > SAFE)


def feet(
    robot: Robot, one: Leg, other: Leg, *, trunk: str, home: Float[Array, "J"], pace: Pace
) -> Feet:
    """Return the robot on the soles of two legs, about to stand on `one`; `trunk` stays level.

    `home` has a column per moving joint. Raises `RobotError` for unknown or fixed names.
    """
    legs = (*one.joints, *other.joints)
    bones = skeleton(robot, one.sole.frame, home, legs)
    stands = Footing(
        one.sole,
        poser(bones, robot, one.joints, pace),
        free=(other.sole,),
        demands=(level(robot.link(trunk).name),),
    )
    robot.link(other.sole.frame)
    G_H_other = bones.figure(home[None]).pose(other.sole.frame)[0]
    both = poser(bones, robot, legs, pace)
    return Feet(robot, one, other, stands, both, home, G_H_other, trunk)


def _tilt(G_H_trunk: Float[Array, "4 4"], G_H_sole: Float[Array, "4 4"]) -> float:
    """Return the angle [rad] between z of the trunk and z of a sole."""
    return float(np.arccos(np.clip(G_H_sole[:3, 2] @ G_H_trunk[:3, 2], -1.0, 1.0)))
