"""A first job file for a log: what can be read off it is filled in, the rest is marked "# ?".

Names that match, full scales that readings show, who stood when: nobody should type these. Where
the manufacturer's matrices are, and who touched the world where no foot tells it, only a person
knows.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from ftcal.contact import ContactSchedule
from ftcal.firmware import estimate_full_scale
from ftcal.health import logs_counts
from ftcal.recording import Recording, Signal
from ftcal.robot import Robot
from ftcal.timeline import inwards, matching_signals, to_toml

HELD_OUT = 0.25
"""Share of an interval that is proposed as test, at its end."""

WORTH_SPLITTING = 20.0
"""Seconds of an interval below which all of it trains."""

WIDTH = 100
"""Columns of a terminal and of a line."""


def draft(
    recording: Recording,
    log: Path,
    robot: Robot | None,
    urdf: Path | None,
    schedule: ContactSchedule | None,
    options: dict[str, str],
) -> str:
    """Return the text of a job file for one log, ready to be edited.

    `log` and `urdf` are written as given; `schedule` says who touched the world, as far as known;
    `options` are further keys of the recording (`time`, `zero`) that the log was read with.
    """
    matches = {} if robot is None else matching_signals(recording, robot)
    lines = [
        f"# Drafted from {recording.name}, {recording.duration:.1f} s. Lines with ? want a person;",
        "# then: ftcal calibrate JOB.toml. Paths count from this file; docs/job.md tells all keys.",
        f"robot = {quoted(str(urdf or 'robot.urdf'))}" + ("" if urdf else "  # ? URDF or xacro"),
        "",
    ]
    if len(matches) > 1 and schedule is not None:
        lines += ["[fit]", 'scope = "whole body"  # all sensors at once; or "each sensor"', ""]
    for name, matched in matches.items():
        lines += [*sensor_lines(name, recording.channel(matched)), ""]
    taken = set(matches.values())
    strangers = [signal for signal in recording.channels if signal.name not in taken]
    for signal in strangers if not matches else ():
        known = "" if robot is None else f" of {', '.join(robot.sensors) or 'none in the URDF'}"
        lines += [*sensor_lines("", signal, f"F/T sensor{known}, or its fixed joint"), ""]
    if not recording.channels:
        lines += ["# ? no F/T signal in this log: [[sensors]] needs one, of a log that has it", ""]
    if matches and strangers:
        lines += [f"# not matched: {', '.join(signal.name for signal in strangers)}", ""]
    lines += ["[[recordings]]", f"log = {quoted(str(log))}"]
    lines += [f"{key} = {quoted(value)}" for key, value in options.items()]
    lines += contact_lines(recording, robot, schedule)
    lines += window_lines(recording, schedule)
    return "\n".join(lines) + "\n"


def sensor_lines(name: str, signal: Signal, question: str = "") -> Iterator[str]:
    """Yield the section of one sensor."""
    yield "[[sensors]]"
    yield f"name = {quoted(name)}" + (f"  # ? {question}" if question else "")
    yield f"signal = {quoted(signal.name)}"
    raw = signal.values.shape[1] != 6 or logs_counts(signal)
    if raw:
        yield 'logged = "channels"'
        yield 'workbench = "matrix.csv"  # ? its calibration matrix: 6 rows, N and Nm per count'
        yield "# ? full_scale = [fx, fy, fz, tx, ty, tz]  # N and Nm; a firmware file has its own"
        return
    yield '# ? workbench = "matrix_SN….txt"  # of its manufacturer; without it the log is believed'
    shown = estimate_full_scale(signal.values)
    if shown.min() > 0:
        scale = ", ".join(str(int(value)) for value in shown)
        yield f"full_scale = [{scale}]  # N and Nm, as its readings show"
    else:
        yield "full_scale = [1000, 1000, 1000, 50, 50, 50]  # ? N and Nm, from its data sheet"


def contact_lines(
    recording: Recording, robot: Robot | None, schedule: ContactSchedule | None
) -> Iterator[str]:
    """Yield who touches the world."""
    if schedule is None:
        link = "base_link" if robot is None else robot.root
        yield f"contact = {quoted(link)}  # ? link that touches the world; or ask with --feet"
        return
    yield to_toml(schedule, duration=recording.duration)


def window_lines(recording: Recording, schedule: ContactSchedule | None) -> Iterator[str]:
    """Yield windows to train on and, at the end of long intervals, to hold out."""
    spans = [(0.0, recording.duration)]
    if schedule is not None:
        spans = [
            inwards(max(i.start, 0.0), min(i.stop, recording.duration)) for i in schedule.intervals
        ]
    train, test = [], []
    for start, stop in spans:
        cut = stop - HELD_OUT * (stop - start) if stop - start >= WORTH_SPLITTING else stop
        train.append((start, cut))
        if cut < stop:
            test.append((cut, stop))
    yield from listed("train", train)
    if test:
        yield from listed("test", test)


def listed(key: str, spans: Iterable[tuple[float, float]]) -> list[str]:
    """Return windows as TOML: on a line where they find room, else a line each."""
    windows = [f"[{a:.2f}, {b:.2f}]" for a, b in spans]
    line = f"{key} = [{', '.join(windows)}]"
    return [line] if len(line) <= WIDTH else [f"{key} = [", *(f"  {w}," for w in windows), "]"]


def quoted(text: str) -> str:
    """Return a TOML basic string."""
    return json.dumps(text, ensure_ascii=False)
