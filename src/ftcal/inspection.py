"""What `ftcal inspect --json` prints: a log's contents as plain records."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

from ftcal.delay import Delay
from ftcal.diagnosis import Diagnosis
from ftcal.recording import Finding, Recording, Signal
from ftcal.robot import Robot
from ftcal.steps import Step
from ftcal.timeline import Phase


def as_record(
    recording: Recording,
    findings: Iterable[Finding],
    robot: Robot | None,
    phases: Iterable[Phase] = (),
    diagnosis: Diagnosis | None = None,
) -> dict[str, Any]:
    """Return signals, findings, contact phases and, with a robot, what of it is logged.

    And the diagnosis, where there is one.
    """
    kinds = {
        "joints": recording.joints,
        "channels": recording.channels,
        "temperatures": recording.temperatures,
        "imus": recording.imus,
    }
    record: dict[str, Any] = {
        "name": recording.name,
        "duration": recording.duration,
        "sha256": recording.digest,
        "signals": [
            {"kind": kind, **described(recording, signal)}
            for kind, signals in kinds.items()
            for signal in signals
        ],
        "findings": [asdict(finding) for finding in findings],
        "phases": [asdict(phase) for phase in phases],
    }
    if diagnosis is not None:
        record["diagnosis"] = asdict(diagnosis)
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


def described(recording: Recording, signal: Signal) -> dict[str, Any]:
    """Return name, size, rate [Hz], span [s] and ranges of one signal."""
    seconds = recording.seconds(signal)
    some = len(signal) > 0
    return {
        "name": signal.name,
        "columns": list(signal.columns),
        "samples": len(signal),
        "rate": 1.0 / signal.period if len(signal) > 1 else None,
        "start": float(seconds[0]) if some else None,
        "stop": float(seconds[-1]) if some else None,
        "least": signal.values.min(axis=0).tolist() if some else [],
        "greatest": signal.values.max(axis=0).tolist() if some else [],
    }
