"""What is wrong with a log or its robot description, in words: what `ftcal inspect` says of it.

A sign, swapped axes, the wrong frame, the wrong robot: `ftcal.inquiry` finds which explains the log
best, and what it cannot tell. Here it becomes a sentence a person can act on.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ftcal.contact import ContactSchedule, Interval
from ftcal.errors import DataError
from ftcal.freeparts import misfits
from ftcal.inquiry import TIE, Belief, Candidate, Inquiry
from ftcal.link_axes import Conclusion, concluded
from ftcal.misfit import Misfit
from ftcal.motion import STANDARD_GRAVITY
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.timeline import Phase, matching_signals

UNEXPLAINED = 3.0
"""Misfit that is no calibration's business any more: three times the usual."""

SIGN = 1
"""Rank of the hypothesis of the opposite sign; a log that cannot exclude it says little."""

Squares = dict[tuple[tuple[str, ...], bool], float]
"""Mean square misfits by the signals on a part's border, and whether it holds the root."""

Word = Literal["as described", "wrong reading", "wrong robot", "unexplained", "cannot tell"]


@dataclass(frozen=True, slots=True)
class SensorDiagnosis:
    """What the log says of one sensor."""

    sensor: str
    """Name in the robot description."""
    signal: str
    """Signal of the log."""
    words: str
    """The hypothesis that is believed, as in "its readings are ..."."""
    cure: str
    """What to do about it; empty where nothing."""
    ratio: float
    """Misfit as described over misfit as believed, of the parts that the sensor borders."""
    as_good: tuple[str, ...]
    """Other hypotheses about it that fit as well."""

    @property
    def told(self) -> str:
        """One line for a person."""
        gain = f"; misfit as described {self.ratio:.1f} times as large" if self.cure else ""
        more = f" and {len(self.as_good) - 3} more" if len(self.as_good) > 3 else ""
        also = f"; fits as well: {'; '.join(self.as_good[:3])}{more}" if self.as_good else ""
        return f"{self.signal}: {self.words}{gain}{also}"


@dataclass(frozen=True, slots=True)
class PartDiagnosis:
    """What is left over of one free part of the robot; in pairs: as described, as believed."""

    frame: str
    """Its first link; force and torque are in the frame of it."""
    sensors: tuple[str, ...]
    """Sensors on its border."""
    resting: tuple[str, ...]
    """Joints not logged, held at zero."""
    seconds: float
    misfit: tuple[float, float]
    """In multiples of what uncalibrated sensors leave."""
    force: tuple[float, float]
    """RMS [N]."""
    torque: tuple[float, float]
    """RMS [Nm]."""
    load: tuple[float, float]
    """RMS variation of force [N] and torque [Nm] that its sensors carry."""


@dataclass(frozen=True, slots=True)
class RivalDiagnosis:
    """How another robot description does on the same log, both as described."""

    robot: str
    """Name of the description."""
    ratios: tuple[float, float] | None
    """Least and greatest of its misfit over that of the robot diagnosed, part by part; None where
    no free part has the same sensors on its border."""
    words: str
    """What follows, as a phrase behind its name."""
    better: bool
    """Whether it fits better in some part and worse in none."""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Which hypothesis explains a log best."""

    robot: str
    """Name of the description."""
    word: Word
    sentence: str
    """What to do, for a person."""
    sensors: tuple[SensorDiagnosis, ...]
    parts: tuple[PartDiagnosis, ...]
    rivals: tuple[RivalDiagnosis, ...]


def diagnose(
    recording: Recording,
    robot: Robot,
    schedule: ContactSchedule,
    *,
    signals: Mapping[str, str] | None = None,
    rivals: Mapping[str, Robot] | None = None,
    gravity: tuple[float, float, float] = STANDARD_GRAVITY,
    findings: Iterable[Finding] = (),
) -> Diagnosis:
    """Return which hypothesis about sensors and robot explains a recording best.

    All that touches the robot must be in `schedule`. `signals` maps F/T sensors to signals in N and
    Nm (default: `matching_signals`); samples that `findings` cut are left out. `rivals` are other
    descriptions to be compared, their sensors matched by name. `DataError` where no signal bears
    the name of a sensor, or no part of the robot is free, moved and known; `RobotError` for unknown
    links.
    """
    findings = tuple(findings)
    known = matching_signals(recording, robot) if signals is None else dict(signals)
    if not known:
        raise DataError(
            f"recording {recording.name!r}: no F/T signal"
            f" ({', '.join(s.name for s in recording.channels) or 'none logged'}) bears the name of"
            f" a sensor of robot {robot.name!r} ({', '.join(robot.sensors) or 'it has none'});"
            " the description is of another robot, or the signals want other names"
        )

    def closed(log: Recording, some: Mapping[str, str]) -> tuple[Misfit, ...]:
        return misfits(log, robot, schedule, some, gravity=gravity, findings=findings)

    logged = closed(recording, known)
    seen = concluded(recording, robot, schedule, known, logged, closed)
    recording, inquiry, belief = seen.recording, seen.inquiry, seen.belief
    sensors = tuple(_sensor(seen, name, known[name]) for name in inquiry.fixed)
    ours = _as_described(inquiry.parts, robot, known)
    compared = []
    for title, rival in (rivals or {}).items():
        others = matching_signals(recording, rival)
        theirs = (
            misfits(recording, rival, schedule, others, gravity=gravity, findings=findings)
            if others
            else ()
        )
        compared.append(_rival(title, robot, ours, _as_described(theirs, rival, others)))
    word, sentence = _conclusion(robot, inquiry, belief, seen.hint, sensors)
    fitter = [(rival.ratios[0], rival.robot) for rival in compared if rival.ratios and rival.better]
    if fitter and word in {"as described", "cannot tell"}:
        share, best = min(fitter)
        word = "wrong robot"
        sentence = (
            f"{best} fits better than {robot.name}: it leaves {100 * share:.0f} % of some misfit"
            " and adds to none; take that description"
        )
    before = {(part.frame, part.sensors): part for part in logged}
    told = tuple(
        _part(before.get((part.frame, part.sensors), part), part, belief) for part in inquiry.parts
    )
    return Diagnosis(robot.name, word, sentence, sensors, told, tuple(compared))


def throughout(recording: Recording, links: Sequence[str]) -> ContactSchedule:
    """Return the schedule of links that touch the world all the time; the first stands still."""
    return ContactSchedule((Interval(0.0, recording.duration, links[0], tuple(links[1:])),))


def touching(phases: Iterable[Phase]) -> ContactSchedule:
    """Return the phases of a timeline in which it is known what touches, with all that does."""
    return ContactSchedule(
        tuple(
            Interval(phase.start, phase.stop, phase.feet[0], phase.feet[1:])
            for phase in phases
            if phase.feet
        )
    )


def _sensor(seen: Conclusion, name: str, signal: str) -> SensorDiagnosis:
    """Return what is believed of a sensor, and what else would fit."""
    inquiry, belief = seen.inquiry, seen.belief
    where = inquiry.borders([name])
    left = inquiry.total(inquiry.squares(belief), where)
    described = inquiry.total(inquiry.squares(inquiry.described()), where)
    believed = belief.sensors[name]
    others = (inquiry.read_as(belief, {name: h}) for h in inquiry.fixed[name] if h != believed)
    told = SensorDiagnosis(
        name,
        signal,
        believed.words,
        believed.cure.format(name),
        float(np.sqrt(described / left)),
        tuple(
            other.belief.sensors[name].words
            for other in others
            if inquiry.total(other.squares, where) <= TIE**2 * left
        ),
    )
    for axes in seen.turned:
        if axes.sensor == name:
            # what else is believed is so of the wrench turned back
            return replace(
                told,
                words=", ".join([axes.words, *([told.words] if told.cure else [])]),
                cure=", and ".join([axes.cure, *([told.cure] if told.cure else [])]),
                ratio=axes.ratio * told.ratio,
                as_good=(*axes.as_good, *told.as_good),
            )
    return told


def _part(logged: Misfit, part: Misfit, belief: Belief) -> PartDiagnosis:
    """Return what is left over of a part as it was logged, and as it is believed to be meant."""
    still = dict.fromkeys(logged.sensors, np.eye(6))
    left = [logged.left_over(still), part.left_over(belief.maps, belief.masses)]
    misfit = [
        float(np.sqrt(square))
        for square in (logged.square(still), part.square(belief.maps, belief.masses))
    ]
    return PartDiagnosis(
        part.frame,
        part.sensors,
        part.resting,
        part.seconds,
        (misfit[0], misfit[1]),
        (left[0][0], left[1][0]),
        (left[0][1], left[1][1]),
        part.load,
    )


def _conclusion(
    robot: Robot,
    inquiry: Inquiry,
    belief: Belief,
    hint: Candidate | None,
    sensors: Iterable[SensorDiagnosis],
) -> tuple[Word, str]:
    """Return the verdict on a log and its sentence."""
    sensors = tuple(sensors)
    cures = [sensor.cure for sensor in sensors if sensor.cure]
    others = "; ".join(belief.instead[:3])
    instead = f" (or else, the log does not tell which: {others})" if others else ""
    if belief.masses is not None:
        also = f"; besides, {'; '.join(cures)}" if cures else ""
        return "wrong robot", f"{_unlike(robot, inquiry, belief)}{also}"
    if cures:
        gain = max(sensor.ratio for sensor in sensors)
        order = "; ".join(_merged(sensors))
        return "wrong reading", f"{order}{instead}: the misfit falls {gain:.1f} times"
    squares = inquiry.squares(belief)
    worst = int(squares.argmax())
    likely = f"; most likely, though not clearly: {hint.words}" if hint else ""
    if squares[worst] > UNEXPLAINED**2:
        part = inquiry.parts[worst]
        return "unexplained", (
            f"no hypothesis about the sensors explains what is left of the part at {part.frame}"
            f" ({squares[worst] ** 0.5:.1f} times the usual): look for a contact that was not"
            f" named, or another robot than {robot.name}{likely}"
        )
    if hint:
        return "cannot tell", f"nothing explains the log clearly better than as described{likely}"
    if unsure := list(_signs(inquiry, belief)):
        return "cannot tell", (
            f"the log does not tell the sign of {', '.join(unsure)}: as described fits as well as"
            " reversed; record a free limb, or wider motion"
        )
    return "as described", f"nothing in the log speaks against {robot.name} and its sensors"


def _signs(inquiry: Inquiry, belief: Belief) -> Iterable[str]:
    """Yield the sensors whose sign the log does not tell, then all of them together."""
    now = inquiry.squares(belief)
    common = {}
    for name, hypotheses in inquiry.fixed.items():
        common[name] = next(h for h in hypotheses if h.rank == SIGN)
        where = inquiry.borders([name])
        other = inquiry.read_as(belief, {name: common[name]})
        if inquiry.total(other.squares, where) <= TIE**2 * inquiry.total(now, where):
            yield name
    together = inquiry.read_as(belief, common)
    # a part that tells the sign is enough, however many others do not
    if len(common) > 1 and not (together.squares > TIE**2 * now).any():
        yield "all sensors together"


def _merged(sensors: Iterable[SensorDiagnosis]) -> Iterable[str]:
    """Yield the cures, sensors that share one named together."""
    names: dict[str, list[str]] = {}
    for sensor in sensors:
        if sensor.cure:
            names.setdefault(sensor.cure.replace(sensor.sensor, "{}", 1), []).append(sensor.sensor)
    for cure, some in names.items():
        yield cure.format(", ".join(some))


def _unlike(robot: Robot, inquiry: Inquiry, belief: Belief) -> str:
    """Return how the masses of the log's robot differ from the description's."""
    masses = belief.masses or {}
    share, part = max(((p.unlike(masses), p) for p in inquiry.parts), key=lambda pair: pair[0])
    before, after = (
        float(np.sqrt(part.square(b.maps, b.masses))) for b in (inquiry.described(), belief)
    )
    return (
        f"{robot.name} is not the robot of the log: with other masses, which change the load of the"
        f" part at {part.frame} by {100 * share:.0f} %, its misfit falls from {before:.1f} to"
        f" {after:.1f} times the usual, and no hypothesis about the sensors does as much"
    )


def _rival(title: str, robot: Robot, ours: Squares, theirs: Squares) -> RivalDiagnosis:
    """Return how a rival's misfits compare, part by part."""
    ratios = [float(np.sqrt(theirs[key] / ours[key])) for key in ours.keys() & theirs.keys()]
    if not ratios:
        return RivalDiagnosis(title, None, f"has no sensors in common with {robot.name}", False)
    better, worse = min(ratios) * TIE < 1.0, max(ratios) > TIE
    words = {
        (True, False): f"fits better than {robot.name}",
        (False, True): f"fits worse than {robot.name}",
        (True, True): f"fits better than {robot.name} in one part and worse in another",
        (False, False): f"cannot be told from {robot.name} by this log",
    }
    spread = min(ratios), max(ratios)
    return RivalDiagnosis(title, spread, words[better, worse], better and not worse)


def _as_described(parts: Iterable[Misfit], robot: Robot, signals: Mapping[str, str]) -> Squares:
    """Return the mean square misfit of each part by what other robots know of it."""
    return {
        (tuple(sorted(signals[name] for name in part.sensors)), part.frame == robot.root): (
            part.square(dict.fromkeys(part.sensors, np.eye(6)))
        )
        for part in parts
    }
