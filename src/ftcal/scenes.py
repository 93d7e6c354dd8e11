"""The takes of a scenario file, and how each becomes a motion with what carries it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from ftcal.config import NotNegative, Positive, Section, Three
from ftcal.limits import Pace, home_posture
from ftcal.motion import STANDARD_GRAVITY, FixedContact
from ftcal.motions import Leg, balancing, extended_balancing, grid, switching
from ftcal.posture import Sole
from ftcal.robot import Robot
from ftcal.support import Support, standing_on
from ftcal.synthetic import SideBySide, Take
from ftcal.trajectory import Trajectory

Joints = Annotated[tuple[str, ...], Field(min_length=1)]
Pair = tuple[float, float]
Whole = Annotated[int, Field(gt=0)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Share = Annotated[float, Field(gt=0, le=1)]

PACE = ("speed", "acceleration", "margin")
"""Keys of a take that are its `Pace`."""

STANDING = {"balancing": balancing, "extended balancing": extended_balancing}
"""Motions of a robot that stands on one frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """One take, ready to be recorded."""

    take: Take
    soles: tuple[Sole, ...]
    """Where balance is kept."""


class SoleSection(Section):
    """The rectangle in the contact frame over which the centre of mass must stay [m]."""

    x: Pair | None = None
    y: Pair | None = None

    def sole(self, frame: str) -> Sole:
        """Return the sole in `frame`; what is not given is an iCub's."""
        return Sole(frame, **self.model_dump(exclude_none=True))


class LegSection(Section):
    """One leg of a run that switches contacts."""

    frame: str
    """Sole frame."""
    joints: Joints
    """Joints from the trunk to the sole, in any order."""
    sole: SoleSection = SoleSection()

    def leg(self) -> Leg:
        """Return the leg."""
        return Leg(self.sole.sole(self.frame), self.joints)


class TakeSection(Section):
    """What every take has."""

    name: str
    """Its name, and that of its folder."""
    duration: Positive | None = None
    """Seconds; default: that of the motion."""
    speed: Positive | None = None
    """Greatest joint speed [rad/s]; default: that of the motion."""
    acceleration: Positive | None = None
    """Greatest joint acceleration [rad/s^2]; default: that of the motion."""
    margin: NotNegative | None = None
    """Distance kept from joint limits [rad]; default: that of the motion."""
    home: dict[str, Finite] = Field(default_factory=dict)
    """Joint → position where it stays, or about which it moves [rad]; default: zero."""
    held_out: bool = False
    """Whether the job keeps it for validation alone."""
    temperature: Finite | None = None
    """Of the sensors when it begins [degree Celsius]."""
    warming: Finite | None = None
    """How much they warm up during it [K]; default: that of `[conditions]`."""

    @abstractmethod
    def scene(self, robot: Robot, generator: np.random.Generator) -> Scene:
        """Return the take as `robot` makes it; errors are those of `ftcal.motions`."""

    def told(self, *keys: str) -> dict[str, Any]:
        """Return those of `keys`, and of home and pace, that the file gives: no other default."""
        pace = self.model_dump(include=set(PACE), exclude_none=True)
        given = self.model_dump(include={*keys, "home"}, exclude_none=True)
        return {**given, "pace": Pace(**pace)} if pace else given

    def take(self, trajectory: Trajectory, support: Support) -> Take:
        """Return the take with this motion, carried like this."""
        said = self.model_dump(include={"name", "held_out", "temperature", "warming"})
        return Take(trajectory=trajectory, support=support, **said)


class OneContact(TakeSection):
    """A take in which one frame carries the robot."""

    contact: str
    """Link or frame that stands still."""
    gravity: Three = STANDARD_GRAVITY
    """Gravity acceleration in it [m/s^2]; default: level, z up."""
    reach: Share | None = None
    """Share of the range of each joint about home; default: that of the motion."""
    range_deg: Positive | None = None
    """Or: degrees either way from home, as far as limits allow."""

    @model_validator(mode="after")
    def _one_reach(self) -> OneContact:
        if self.reach is not None and self.range_deg is not None:
            raise ValueError("give reach or range_deg, not both")
        return self

    def standing(self) -> Support:
        """Return the one frame that carries all."""
        return standing_on(FixedContact(self.contact, self.gravity))

    def within(self, robot: Robot, joints: Sequence[str]) -> tuple[Robot, dict[str, Any]]:
        """Return the robot with its joints kept to `range_deg`, and which share of it to use."""
        if self.range_deg is None:
            return robot, self.told("duration", "reach")
        told = self.told("duration")
        pace = told.get("pace", Pace())
        here = dict(zip(robot.moving_joints, home_posture(robot, self.home, pace), strict=True))
        room = np.deg2rad(self.range_deg) + pace.margin
        narrowed = {
            name: replace(
                robot.joint(name),
                lower=max(robot.joint(name).lower, here[name] - room),
                upper=min(robot.joint(name).upper, here[name] + room),
            )
            for name in joints
        }
        return replace(robot, joints={**robot.joints, **narrowed}), {**told, "reach": 1.0}


class GridTake(OneContact):
    """A walk over a grid of joints; several groups at once, each over its own grid."""

    motion: Literal["grid"]
    joints: Joints | None = None
    groups: Annotated[tuple[Joints, ...], Field(min_length=1)] | None = None
    """Or: groups of joints that walk side by side."""
    points: Whole | tuple[Whole | tuple[Whole, ...], ...] | None = None
    """Points a joint: one number for all, or one a joint; with `groups` one entry a group."""
    settle: Positive | None = None
    """Stillness at each point [s]."""

    @model_validator(mode="after")
    def _grouped(self) -> GridTake:
        if (self.joints is None) == (self.groups is None):
            raise ValueError("give either joints = [...] or groups = [[...], [...]]")
        groups = self.groups or ((),)
        if self.groups and isinstance(self.points, tuple) and len(self.points) != len(groups):
            raise ValueError(f"{len(self.points)} entries of points for {len(groups)} groups")
        return self

    def counts(self, groups: int) -> list[dict[str, Any]]:
        """Return the points of each group as `grid` is told of them."""
        if self.points is None:
            return [{}] * groups
        each = self.points if self.groups and isinstance(self.points, tuple) else None
        return [{"points": count} for count in each or (self.points,) * groups]

    def scene(self, robot: Robot, generator: np.random.Generator) -> Scene:
        """Return the grids of all groups side by side; nothing in them is random."""
        groups = self.groups or (self.joints or (),)
        walked, told = self.within(robot, [joint for group in groups for joint in group])
        told |= self.told("settle")
        parts = [
            grid(walked, group, **told, **counted)
            for group, counted in zip(groups, self.counts(len(groups)), strict=True)
        ]
        return Scene(self.take(SideBySide(parts, groups), self.standing()), ())


class BalancingTake(OneContact):
    """Random moves of a limb while the robot stands on another."""

    motion: Literal["balancing", "extended balancing"]
    joints: Joints
    support: tuple[str, ...] = ()
    """Joints of the limb that carries: they sway, and keep the balance where there is a sole."""
    sway: NotNegative | None = None
    """How far [rad]."""
    sole: SoleSection | None = None
    """Rectangle under the contact over which the centre of mass stays; none: it is not looked at,
    `{}`: that of an iCub's foot."""

    def scene(self, robot: Robot, generator: np.random.Generator) -> Scene:
        """Return random moves, in balance where there is a sole."""
        soles = () if self.sole is None else (self.sole.sole(self.contact),)
        moved, told = self.within(robot, self.joints)
        told |= self.told("support", "sway") | {"sole": next(iter(soles), None)}
        move = STANDING[self.motion](moved, self.joints, generator=generator, **told)
        return Scene(self.take(move, self.standing()), soles)


class SwitchingTake(TakeSection):
    """Hanging, then standing on both feet, the left, the right and both."""

    motion: Literal["switching"]
    pole: str
    """Link that hangs."""
    left: LegSection
    right: LegSection
    hanging: Positive | None = None
    """Seconds."""
    swing: Positive | None = None
    """Seconds that each leg is in the air."""
    reach: Share | None = None
    """Share of the range of its joints that a free leg uses."""
    bend: Share | None = None
    """Share of the range of its joints that a leg uses while it carries."""
    lift: Positive | None = None
    """How high a foot is lifted first [m]."""

    @model_validator(mode="after")
    def _no_duration(self) -> SwitchingTake:
        if self.duration is not None:
            raise ValueError("a switching run lasts as its parts do: give hanging and swing")
        return self

    def scene(self, robot: Robot, generator: np.random.Generator) -> Scene:
        """Return the paper's validation run."""
        left, right = self.left.leg(), self.right.leg()
        told = self.told("hanging", "swing", "reach", "bend", "lift")
        walk = switching(robot, pole=self.pole, left=left, right=right, generator=generator, **told)
        return Scene(self.take(walk.trajectory, walk.support), (left.sole, right.sole))


AnyTake = Annotated[GridTake | BalancingTake | SwitchingTake, Field(discriminator="motion")]
