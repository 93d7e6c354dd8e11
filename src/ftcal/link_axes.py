"""Whether a driver logged the wrench of a sensor in the axes of another link.

No relabelling mends that: those axes turn against the sensor's while the robot moves. Here the
wrench is turned back from the axes of one link after the other (`ftcal.turning`), and the balance
of what hangs on the sensor alone says in which it makes sense. A link is no free number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.contact import ContactSchedule
from ftcal.errors import DataError
from ftcal.freeparts import AS_LOGGED
from ftcal.hypotheses import NEGLIGIBLE, fixed_hypotheses
from ftcal.inquiry import ALARM, MARGIN, TIE, Belief, Candidate, Inquiry
from ftcal.kinematics import sensor_pose
from ftcal.misfit import Misfit
from ftcal.motion import Motion
from ftcal.pairing import FtChannel
from ftcal.recording import Recording
from ftcal.robot import Robot
from ftcal.turning import recording_turned_back

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

FREE = 6
"""Rank from which on a constant reading of the log has free numbers: a link that explains as much
is less far-fetched."""

Closed = Callable[[Recording, Mapping[str, str]], Sequence[Misfit]]
"""`freeparts.misfits` of a recording and its signals by sensor, all else being told."""


@dataclass(frozen=True, slots=True)
class LinkAxes:
    """A sensor whose log makes sense in the axes of another link."""

    sensor: str
    """Name in the robot description."""
    signal: str
    """Signal of the log."""
    link: str
    """In whose axes the log gives the wrench."""
    ratio: float
    """Misfit as described over misfit in those axes, of the parts behind the sensor."""
    others: tuple[str, ...]
    """Links whose axes fit as well."""

    @property
    def channel(self) -> FtChannel:
        """The sensor as a job would have it that knows of those axes."""
        return FtChannel(self.sensor, self.signal, AS_LOGGED, wrench_frame=self.link)

    @property
    def words(self) -> str:
        """The hypothesis, a phrase that follows "the readings are"."""
        return f"in the axes of {self.link}"

    @property
    def cure(self) -> str:
        """What the user does about it, as an order."""
        return f'for {self.sensor} say wrench_frame = "{self.link}" in the job'

    @property
    def as_good(self) -> tuple[str, ...]:
        """Other hypotheses that fit as well."""
        return tuple(f"in the axes of {link}" for link in self.others)


@dataclass(frozen=True, slots=True, eq=False)
class Conclusion:
    """What is believed of a log, its wrenches turned back from the axes of other links."""

    turned: tuple[LinkAxes, ...]
    """Sensors that were logged in such axes; what follows is of the log without them."""
    recording: Recording
    inquiry: Inquiry
    belief: Belief
    hint: Candidate | None
    """What would be better still, though not clearly."""


def concluded(
    recording: Recording,
    robot: Robot,
    schedule: ContactSchedule,
    signals: Mapping[str, str],
    parts: Sequence[Misfit],
    closed: Closed,
) -> Conclusion:
    """Return what is to be believed of a log, of which `parts` are what `closed` makes."""
    inquiry = inquiry_of(robot, signals, parts)
    belief, hint = inquiry.conclude()
    turned = in_axes_of_links(
        recording, robot, schedule, signals, inquiry=inquiry, belief=belief, closed=closed
    )
    if turned:
        recording = recording_turned_back(recording, robot, [one.channel for one in turned])
        inquiry = inquiry_of(robot, signals, closed(recording, signals))
        belief, hint = inquiry.conclude()
    return Conclusion(turned, recording, inquiry, belief, hint)


def inquiry_of(robot: Robot, signals: Mapping[str, str], parts: Sequence[Misfit]) -> Inquiry:
    """Return the inquiry into the sensors of which some part says something."""
    judged = [name for name in signals if any(name in part.sensors for part in parts)]
    return Inquiry(tuple(parts), {name: fixed_hypotheses(robot, name) for name in judged})


def in_axes_of_links(
    recording: Recording,
    robot: Robot,
    schedule: ContactSchedule,
    signals: Mapping[str, str],
    *,
    inquiry: Inquiry,
    belief: Belief,
    closed: Closed,
) -> tuple[LinkAxes, ...]:
    """Return the sensors whose log is in the axes of another link, where that is clear.

    A link must divide an alarming misfit of the parts behind the sensor alone by `MARGIN`, do
    better than what is believed of the log as it stands, and harm no other part. `signals` maps
    F/T sensors to signals in N and Nm, of which `inquiry` concluded `belief`.
    """
    described = inquiry.squares(inquiry.described())
    believed = inquiry.squares(belief)
    found = []
    for name in inquiry.fixed:
        before = behind(inquiry.parts, described, name)
        if not before > ALARM**2:
            continue
        free = belief.masses is not None or belief.sensors[name].rank >= FREE
        rival = behind(inquiry.parts, believed, name) * TIE ** (2 if free else -2)
        left = {}
        for link in candidates(recording, robot, name, schedule):
            channel = FtChannel(name, signals[name], AS_LOGGED, wrench_frame=link)
            with suppress(DataError):  # its joints were not logged together with the sensor
                turned = recording_turned_back(recording, robot, [channel])
                parts = closed(turned, {name: signals[name]})
                square = behind(parts, as_described(parts), name)
                if square * MARGIN**2 < before and square <= rival:
                    left[link] = square
        alike = [link for link, square in left.items() if square <= TIE**2 * min(left.values())]
        if alike:
            # the first of those that fit alike: the root, what touches, those near the root
            first, *others = alike
            ratio = float(np.sqrt(before / left[first]))
            found.append(LinkAxes(name, signals[name], first, ratio, tuple(others)))
    if not found:
        return ()
    turned = recording_turned_back(recording, robot, [one.channel for one in found])
    parts = closed(turned, signals)
    limits = {(p.frame, p.sensors): s for p, s in zip(inquiry.parts, described, strict=True)}
    harmed = any(
        square > TIE**2 * limits.get((part.frame, part.sensors), np.inf)
        for part, square in zip(parts, as_described(parts), strict=True)
    )
    return () if harmed else tuple(found)


def as_described(parts: Sequence[Misfit]) -> Float[Array, "P"]:
    """Return the mean square misfit of parts whose sensors are read as they were logged."""
    return np.array([part.square(dict.fromkeys(part.sensors, np.eye(6))) for part in parts])


def behind(parts: Sequence[Misfit], squares: Float[Array, "P"], sensor: str) -> float:
    """Return the mean square misfit of the parts behind one sensor alone; NaN where none is."""
    seconds = np.array([part.seconds * (part.sensors == (sensor,)) for part in parts])
    return float(squares @ seconds / seconds.sum()) if seconds.any() else float("nan")


def candidates(
    recording: Recording, robot: Robot, sensor: str, schedule: ContactSchedule
) -> Iterator[str]:
    """Yield links whose axes are not the sensor's, and are known in the log; of like axes, one.

    The root, what touches the world, then every link with mass, from the root outwards.
    """
    logged = {joint for signal in recording.joints for joint in signal.columns}
    still = np.zeros((1, len(robot.moving_joints)))
    rest = Motion(np.zeros(1), robot.moving_joints, still, still, still)
    seen: list[tuple[set[str], Float[Array, "3 3"]]] = [(set(), np.eye(3))]
    touching = [link for interval in schedule.intervals for link in interval.touching]
    massive = [name for name, link in robot.links.items() if link.mass > 0.0]
    for link in dict.fromkeys([robot.root, *touching, *massive]):
        way = robot.path(link, robot.sensor(sensor).child)
        moving = {joint.name for joint in way if joint.kind != "fixed"}
        L_R_S = sensor_pose(robot, rest, link, sensor)[0, :3, :3]
        alike = any(
            moving == other and np.allclose(L_R_S, R, rtol=0.0, atol=NEGLIGIBLE)
            for other, R in seen
        )
        if moving <= logged and not alike:
            seen.append((moving, L_R_S))
            yield link
