"""What `ftcal inspect` finds in a log, and its contents as plain records for machines."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ftcal import delay, diagnosis, logs, steps
from ftcal.contact import ContactSchedule
from ftcal.delay import Delay
from ftcal.diagnosis import Diagnosis
from ftcal.errors import DataError
from ftcal.extents import Extent, Extents
from ftcal.logs import Layout
from ftcal.logs.pieces import WholeLog
from ftcal.overview import overview
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.steps import Step
from ftcal.timeline import Phase, Timeline, propose_timeline
from ftcal.urdf import read_robot


@dataclass(frozen=True, slots=True, eq=False)
class Inspection:
    """What a log shows."""

    recording: Recording
    """Whole where it is small, or was asked for; else the ends of its signals alone."""
    extents: tuple[Extent, ...]
    """Its signals."""
    robot: Robot | None
    findings: tuple[Finding, ...]
    timeline: Timeline | None
    """Who stood when, where two feet were named."""
    contacts: ContactSchedule | None
    """What touched the world, as told or as the feet show."""
    diagnosis: Diagnosis | None = None
    delays: tuple[Delay, ...] = ()
    steps: Mapping[str, tuple[Step, ...]] | None = None

    @property
    def phases(self) -> tuple[Phase, ...]:
        """Phases of the timeline."""
        return () if self.timeline is None else self.timeline.phases


def inspected(
    log: Path,
    layout: Layout,
    *,
    robot: Path | None = None,
    feet: tuple[str, str] | None = None,
    contacts: Sequence[str] = (),
    whole: bool = False,
) -> Inspection:
    """Return what a log shows of itself, and with a robot of who stood when.

    `feet` are two soles that tell it; `contacts` are links that touch throughout. For them, and
    where `whole` says so, the log is read as a whole; else it may be of any length.
    """
    model = None if robot is None else read_robot(robot)
    whole = whole or feet is not None or bool(contacts)
    opened = logs.opened(log, layout, most=sys.maxsize if whole else logs.IN_MEMORY)
    extents = Extents.of(opened)
    seen = overview(opened, model, (), onlookers=(extents,))
    match opened:
        case WholeLog(recording):
            pass
        case _:
            recording = seen.outline
    findings = seen.findings
    timeline = None
    schedule = diagnosis.throughout(recording, contacts) if contacts else None
    if feet is not None and model is not None:
        timeline = propose_timeline(recording, model, feet, findings=findings)
        shown = diagnosis.touching(timeline.phases)
        if schedule is None and shown.intervals:
            schedule = shown
    signals = tuple(extents.of_each.values())
    return Inspection(recording, signals, model, findings, timeline, schedule)


def diagnosed(seen: Inspection, rivals: Sequence[Path]) -> Inspection:
    """Return an inspection with what is wrong with its log or its robot.

    `rivals` are other descriptions that may be the log's robot. Raises `DataError` where robot or
    contacts are not known.
    """
    recording, robot, schedule = seen.recording, seen.robot, seen.contacts
    if robot is None or schedule is None:
        raise DataError("a diagnosis needs the robot and who touched the world: --robot, --contact")
    return replace(
        seen,
        diagnosis=diagnosis.diagnose(
            recording,
            robot,
            schedule,
            rivals={str(path): read_robot(path) for path in rivals},
            findings=seen.findings,
        ),
        delays=delay.delays(recording, robot, schedule, findings=seen.findings),
        steps=steps.all_steps(recording, robot, schedule, findings=seen.findings),
    )


def as_record(seen: Inspection) -> dict[str, Any]:
    """Return signals, findings, contact phases and, with a robot, what of it is logged.

    And the diagnosis with delays and steps, where there is one.
    """
    recording, robot = seen.recording, seen.robot
    record: dict[str, Any] = {
        "name": recording.name,
        "duration": recording.duration,
        "sha256": recording.digest,
        "signals": [described(extent) for extent in seen.extents],
        "findings": [asdict(finding) for finding in seen.findings],
        "phases": [asdict(phase) for phase in seen.phases],
    }
    if seen.diagnosis is not None:
        record["diagnosis"] = asdict(seen.diagnosis)
        record |= as_noticed(seen.delays, seen.steps or {})
    if robot is not None:
        logged = {column for signal in recording.joints for column in signal.columns}
        record["robot"] = {
            "name": robot.name,
            "mass": robot.mass,
            "sensors": list(robot.sensors),
            "joints_logged": [joint for joint in robot.moving_joints if joint in logged],
            "joints_missing": [joint for joint in robot.moving_joints if joint not in logged],
            "columns_unknown": sorted(logged - set(robot.joints)),
        }
    return record


def as_noticed(delays: Iterable[Delay], steps: Mapping[str, Iterable[Step]]) -> dict[str, Any]:
    """Return delays of the F/T signals and steps of their offsets as plain records."""
    return {
        "delays": [
            {
                "seconds": finite(delay.seconds),
                "sd": finite(delay.sd),
                "determined": delay.determined,
                "message": delay.message,
            }
            for delay in delays
        ],
        "steps": {
            sensor: [
                {
                    "time": step.time,
                    "uncertainty": step.uncertainty,
                    "size": step.size.tolist(),
                    "unsettled": list(step.unsettled),
                    "message": step.message,
                }
                for step in some
            ]
            for sensor, some in steps.items()
        },
    }


def finite(value: float) -> float | None:
    """Return a number that JSON can hold."""
    return value if math.isfinite(value) else None


def described(extent: Extent) -> dict[str, Any]:
    """Return kind, name, size, rate [Hz], span [s] and ranges of one signal."""
    return {
        "kind": extent.role,
        "name": extent.name,
        "columns": list(extent.columns),
        "samples": extent.samples,
        "rate": extent.rate,
        "start": extent.start,
        "stop": extent.stop,
        "least": [] if extent.least is None else extent.least.tolist(),
        "greatest": [] if extent.greatest is None else extent.greatest.tolist(),
    }
