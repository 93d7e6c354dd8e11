"""Whether a driver logged the wrench of a sensor in the axes of another link.

No relabelling mends that: those axes turn against the sensor's while the robot moves. Here the
wrench is turned back from the axes of one link after the other (`ftcal.turning`), and the part
that hangs on the sensor alone says in which it makes sense. A link is no free number.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ftcal.contact import ContactSchedule
from ftcal.errors import DataError
from ftcal.freeparts import AS_LOGGED, misfits
from ftcal.hypotheses import NEGLIGIBLE
from ftcal.inquiry import ALARM, MARGIN, TIE
from ftcal.kinematics import sensor_pose
from ftcal.misfit import Misfit
from ftcal.motion import Motion
from ftcal.pairing import FtChannel
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.turning import recording_turned_back

Squares = Mapping[tuple[str, tuple[str, ...]], float]
"""Mean square misfit of every part, by its first link and the sensors on its border."""


@dataclass(frozen=True, slots=True)
class LinkAxes:
    """A sensor whose log makes sense in the axes of another link."""

    channel: FtChannel
    """With the link as its `wrench_frame`."""
    ratio: float
    """Misfit as described over misfit in those axes, of the part behind the sensor."""
    as_good: tuple[str, ...]
    """Other links whose axes fit as well."""


def as_described(parts: Iterable[Misfit]) -> dict[tuple[str, tuple[str, ...]], float]:
    """Return the mean square misfit of parts whose sensors are read as they were logged."""
    return {
        (part.frame, part.sensors): part.square(dict.fromkeys(part.sensors, np.eye(6)))
        for part in parts
    }


def in_axes_of_links(
    recording: Recording,
    robot: Robot,
    schedule: ContactSchedule,
    signals: Mapping[str, str],
    *,
    described: Squares,
    beaten: Squares,
    gravity: tuple[float, float, float],
    findings: Sequence[Finding],
) -> tuple[LinkAxes, ...]:
    """Return the sensors whose log is that of another link's axes, as far as it is clear.

    That a link divides an alarming misfit (`described`) of the part behind its sensor by `MARGIN`,
    that it does better than any constant reading of the log (`beaten`), and that with all of them
    no other part becomes worse. Arguments otherwise as `diagnosis.diagnose` has them.
    """
    found = []
    for name, signal in signals.items():
        alone = {key: square for key, square in described.items() if key[1] == (name,)}
        if not any(square > ALARM**2 for square in alone.values()):
            continue
        left: dict[str, float] = {}
        for link in candidates(recording, robot, name, schedule):
            channel = FtChannel(name, signal, AS_LOGGED, wrench_frame=link)
            try:
                turned = recording_turned_back(recording, robot, [channel])
                parts = misfits(
                    turned, robot, schedule, {name: signal}, gravity=gravity, findings=findings
                )
            except DataError:  # its joints were not logged together with the sensor
                continue
            now = as_described(parts)
            helps = all(
                square * MARGIN**2 < described[key] and square < beaten[key]
                for key, square in now.items()
                if key in alone
            )
            if helps and now.keys() >= alone.keys():
                left[link] = sum(now.values())
        if left:
            best = min(left.values())
            # the first of those that fit alike: the root, a contact, then those near the root
            first, *others = (link for link in left if left[link] <= TIE**2 * best)
            channel = FtChannel(name, signal, AS_LOGGED, wrench_frame=first)
            ratio = float(np.sqrt(sum(alone.values()) / left[first]))
            found.append(LinkAxes(channel, ratio, tuple(others)))
    if not found:
        return ()
    turned = recording_turned_back(recording, robot, [one.channel for one in found])
    together = as_described(
        misfits(turned, robot, schedule, signals, gravity=gravity, findings=findings)
    )
    harmed = any(square > TIE**2 * described.get(key, np.inf) for key, square in together.items())
    return () if harmed else tuple(found)


def candidates(
    recording: Recording, robot: Robot, sensor: str, schedule: ContactSchedule
) -> Iterator[str]:
    """Yield links whose axes are not the sensor's, and are known in the log; of like axes, one.

    The root, what touches the world, then every link with mass, from the root outwards.
    """
    logged = {joint for signal in recording.joints for joint in signal.columns}
    still = np.zeros((1, len(robot.moving_joints)))
    rest = Motion(np.zeros(1), robot.moving_joints, still, still, still)
    seen: list[tuple[frozenset[str], np.ndarray[tuple[int, int], np.dtype[np.float64]]]] = [
        (frozenset(), np.eye(3))
    ]
    touching = [link for interval in schedule.intervals for link in interval.touching]
    massive = [name for name, link in robot.links.items() if link.mass > 0.0]
    for link in dict.fromkeys([robot.root, *touching, *massive]):
        way = robot.path(link, robot.sensor(sensor).child)
        moving = frozenset(joint.name for joint in way if joint.kind != "fixed")
        L_R_S = sensor_pose(robot, rest, link, sensor)[0, :3, :3]
        alike = any(
            moving == other and np.allclose(L_R_S, R, rtol=0.0, atol=NEGLIGIBLE)
            for other, R in seen
        )
        if moving <= logged and not alike:
            seen.append((moving, L_R_S))
            yield link
