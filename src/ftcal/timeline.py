"""Who stood on which foot, as a log shows it: a proposal that a person checks and edits.

The two feet are watched one by one (`ftcal.stance`), each by the sensor nearest to it: that one's
free half weighs least and hides least. Both stand on one level floor.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal.contact import ContactSchedule, Interval
from ftcal.errors import DataError, JobError
from ftcal.health import logs_counts
from ftcal.recording import NANOSECONDS, Finding, Recording
from ftcal.robot import Robot
from ftcal.signals import usable
from ftcal.stance import CARRYING, FREE, STATES, STEP, TOUCHING, UNKNOWN, Foot, Place, same, watch

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

UNUSABLE = 0.5
"""A sensor with more than this share of its samples cut leaves the word to the next one."""

Kind = Literal["support", "double", "brushing", "unknown"]


@dataclass(frozen=True, slots=True)
class Phase:
    """Half-open span [start, stop) with one way of standing."""

    start: float
    """Seconds since the start of the recording."""
    stop: float
    """Seconds since the start of the recording, exclusive."""
    kind: Kind
    """`support`: one foot alone touches; `brushing`: another touches and carries next to nothing;
    `double`: both carry."""
    feet: tuple[str, ...]
    """Contact frames that touch the ground, those that carry first; empty where unknown."""


@dataclass(frozen=True, slots=True)
class Timeline:
    """The proposal and what it rests on."""

    time: Float[Array, "N"]
    """Seconds since the start of the recording."""
    feet: tuple[Foot, Foot]
    phases: tuple[Phase, ...]
    """In order, without holes between them."""


def propose_timeline(
    recording: Recording,
    robot: Robot,
    feet: Sequence[str] = ("l_sole", "r_sole"),
    *,
    signals: Mapping[str, str] | None = None,
    findings: Iterable[Finding] = (),
) -> Timeline:
    """Return which of two level `feet` (contact frames) stood on the floor when.

    `signals` maps F/T sensors to signals of the log in N and Nm (default: those whose names
    agree, `matching_signals`); samples that `findings` cut are not looked at. `DataError` where a
    foot has no sensor that is logged, a leg's joint is not, or nothing overlaps; `JobError` unless
    there are two feet; `RobotError` for unknown names.
    """
    if len(feet) != 2 or feet[0] == feet[1]:
        raise JobError(f"a timeline needs two feet, not {', '.join(feet) or 'none'}")
    findings = tuple(findings)
    signals = matching_signals(recording, robot) if signals is None else signals
    places = [
        _nearest(recording, robot, signals, foot, other, findings)
        for foot, other in (feet, feet[::-1])
    ]
    streams = [recording.channel(place.signal) for place in places]
    first = max(int(stream.stamps[0]) for stream in streams)
    last = min(int(stream.stamps[-1]) for stream in streams)
    if last <= first:
        names = " and ".join(repr(stream.name) for stream in streams)
        raise DataError(f"recording {recording.name!r}: {names} have no time in common")
    clock = np.arange(first, last, round(STEP * NANOSECONDS))
    time = np.asarray((clock - recording.start) / NANOSECONDS)
    left, right = (watch(recording, robot, place, clock, findings) for place in places)
    both = _in_the_air(left, right), _in_the_air(right, left)
    return Timeline(time, both, _phases(time, *both))


def matching_signals(recording: Recording, robot: Robot) -> dict[str, str]:
    """Return the F/T signal of each sensor whose name says the same place: `r_foot`, `right_foot`.

    Sensors and signals of no match, or of more than one, are left out.
    """
    by_place: dict[frozenset[str], list[str]] = {}
    for signal in recording.channels:
        by_place.setdefault(_place(signal.name), []).append(signal.name)
    matches = {}
    for sensor in robot.sensors:
        found = by_place.get(_place(sensor), [])
        if len(found) == 1:
            matches[sensor] = found[0]
    return matches


def _place(name: str) -> frozenset[str]:
    """Return the words of a name that say where in the robot it is."""
    sides = {"l": "left", "r": "right"}
    no_place = {"ft", "sensor", "analog", "o", "icub", "measures", "fts", ""}
    words = re.split(r"[^a-z0-9]+", name.lower())
    return frozenset(sides.get(word, word) for word in words) - no_place


def schedule(phases: Iterable[Phase], *, shortest: float = 1.0) -> ContactSchedule:
    """Return the spans in which exactly one foot touches, those of at least `shortest` seconds."""
    return ContactSchedule(
        tuple(
            Interval(phase.start, phase.stop, phase.feet[0])
            for phase in phases
            if phase.kind == "support" and phase.stop - phase.start >= shortest
        )
    )


def to_toml(contacts: ContactSchedule, *, duration: float = math.inf) -> str:
    """Return the `contacts` of a job's `[[recordings]]`, rounded inwards to 10 ms.

    Where one lasts for the whole `duration` [s] of the recording, its `contact`.
    """
    match contacts.intervals:
        case [only] if only.start <= 0.0 and only.stop >= duration:
            return f"contact = {_links(only)}"
    lines = []
    for interval in contacts.intervals:
        start, stop = inwards(interval.start, interval.stop)
        lines.append(f"  {{ start = {start:.2f}, stop = {stop:.2f}, link = {_links(interval)} }},")
    return "\n".join(["contacts = [", *lines, "]"])


def inwards(start: float, stop: float) -> tuple[float, float]:
    """Return a span rounded inwards to 10 ms."""
    return math.ceil(100 * start) / 100, math.floor(100 * stop) / 100


def _links(interval: Interval) -> str:
    """Return the links that touch in an interval as TOML, the one that stands still first."""
    names = [json.dumps(name, ensure_ascii=False) for name in interval.touching]
    return names[0] if len(names) == 1 else f"[{', '.join(names)}]"


def _nearest(
    recording: Recording,
    robot: Robot,
    signals: Mapping[str, str],
    foot: str,
    other: str,
    findings: tuple[Finding, ...],
) -> Place:
    """Return the sensor between two feet that has least of the robot's mass on the first's side."""
    beyond = {}
    for sensor, name in signals.items():
        signal = recording.channel(name)
        half = robot.free_half(sensor, [other])
        if foot not in half.links or len(signal) < 2 or signal.values.shape[1] != 6:
            continue
        if logs_counts(signal) or usable(recording, signal, findings).mean() < UNUSABLE:
            continue
        mass = sum(robot.links[name].mass for name in half.links)
        if mass < robot.mass / 2:  # more is the other leg's sensor, seen from its far side
            beyond[sensor] = mass
    if not beyond:
        raise DataError(
            f"recording {recording.name!r}: no usable F/T signal in N between {foot!r} and"
            f" {other!r} (known: {', '.join(signals.values()) or 'none'}); name signals, or write"
            " the contacts by hand"
        )
    nearest = min(beyond, key=lambda sensor: beyond[sensor])
    return Place(foot, other, nearest, signals[nearest])


def _in_the_air(foot: Foot, other: Foot) -> Foot:
    """Return `foot` free where a light touch is refuted by its height above the foot that stands.

    An offset that jumps, as that of a sensor just saturated does, looks like a touch.
    """
    lifted = foot.above & (foot.state == TOUCHING)
    lifted &= (other.state == CARRYING) | (other.state == UNKNOWN)
    return replace(foot, state=np.where(lifted, FREE, foot.state))


def _phases(time: Float[Array, "N"], left: Foot, right: Foot) -> tuple[Phase, ...]:
    """Return the spans of equal standing; where one foot is free the other must carry."""
    ways = left.state * len(STATES) + right.state
    phases: list[Phase] = []
    for span in same(ways):
        kind, feet = _standing(left, right, span.start)
        start = phases[-1].stop if phases else float(time[span.start])
        stop = float(time[min(span.stop, len(time) - 1)])
        if phases and (phases[-1].kind, phases[-1].feet) == (kind, feet):
            start = phases.pop().start
        phases.append(Phase(start, stop, kind, feet))
    return tuple(phases)


def _standing(left: Foot, right: Foot, row: int) -> tuple[Kind, tuple[str, ...]]:
    """Return how the robot stands in one row: on something, so a foot unseen carries if need be."""
    by_state: dict[int, list[str]] = {}
    for foot in (left, right):
        by_state.setdefault(int(foot.state[row]), []).append(foot.place.frame)
    free, touching = by_state.get(FREE, []), by_state.get(TOUCHING, [])
    carrying, unseen = by_state.get(CARRYING, []), by_state.get(UNKNOWN, [])
    if len(carrying) == 2:
        return "double", tuple(carrying)
    if len(free) == 1 and not touching:
        return "support", (*carrying, *unseen)
    if len(touching) == 1 and not free:
        return "brushing", (*carrying, *unseen, *touching)
    return "unknown", ()
