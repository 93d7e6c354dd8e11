"""A job whose offset steps and touches are found by themselves, as if they had been given by hand.

With `breaks = "auto"` every sensor is looked at while its own limb is free (`ftcal.steps`) and, in
a fit of all sensors, in all balances at once (`ftcal.balance_steps`). What is found is written
into the job: `breaks` where an offset steps, `leave_out` until it has settled and while something
touches. Searched is what the job trains on or holds out, nothing else: what it does not name may
not be free at all. Held-out samples stay, but an offset that steps among them is aligned anew.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.balance_steps import unrest_in_balances
from ftcal.balanced_take import balanced
from ftcal.balances import Balance
from ftcal.config import Job, RecordingSection
from ftcal.errors import DataError, RobotError
from ftcal.one_sensor import pair_recording
from ftcal.pairing import FtChannel, Windows
from ftcal.progress import Steps
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.step_search import KAPPA
from ftcal.steps import Unrest, unrest_of
from ftcal.takes import Takes
from ftcal.terms import Frame, ModelPrior

if TYPE_CHECKING:
    from jaxtyping import Bool, Float
    from numpy import ndarray as Array

DIGITS = 3
"""Times are written to the millisecond."""


def segmented(
    job: Job, robot: Robot, channels: Sequence[FtChannel], recordings: Takes, steps: Steps
) -> tuple[Job, Takes]:
    """Return the job with breaks in place of "auto", and its recordings with what was found."""
    if all(section.breaks != "auto" for section in job.recordings):
        return job, recordings
    sections, findings = [], []
    for section, recording, found in zip(
        job.recordings, recordings, recordings.findings, strict=True
    ):
        given: tuple[RecordingSection, tuple[Finding, ...]] = (section, ())
        if section.breaks == "auto":
            steps.begin(f"searching {section.label} for steps of offsets")
            given = _resolved(job, robot, channels, section, recording, found)
        sections.append(given[0])
        findings.append((*found, *given[1]))
    return (
        job.model_copy(update={"recordings": tuple(sections)}),
        replace(recordings, findings=tuple(findings)),
    )


def _resolved(
    job: Job,
    robot: Robot,
    channels: Sequence[FtChannel],
    section: RecordingSection,
    recording: Recording,
    findings: Sequence[Finding],
) -> tuple[RecordingSection, tuple[Finding, ...]]:
    """Return a section with what was found in its recording, and that as findings."""
    names = {c.sensor: named.name for c, named in zip(channels, job.sensors, strict=True)}
    named = windows_of(section)
    unrest: dict[str, list[Unrest]] = {}
    for channel in channels:
        with suppress(DataError, RobotError):  # its limb is never free
            both = pair_recording(job, robot, channel, section, recording, findings, 0.0)
            samples = both.samples.where(within(both.samples.time, named))
            if len(samples):
                unrest[channel.sensor] = [unrest_of(samples, channel, job.signals.options())]
    known = with_unrest(section, unrest, names)
    if job.fit.scope == "whole body":
        take = balanced(job, robot, channels, known, recording, findings)
        parts = [
            one.rows(rows)
            for one in take.balances
            if len(rows := np.flatnonzero(within(one.time, named)))
        ]
        frames = {c.sensor: Frame.of(c.workbench, c.workbench.gain.shape[1]
                                     + (c.temperature is not None)) for c in channels}  # fmt: skip
        model = ModelPrior(mass=job.whole_body.mass, com=job.whole_body.com)
        breaks = {s: known.known_breaks.get(name, ()) for s, name in names.items()}
        smoothing = job.whole_body.smoothing
        more = (
            unrest_in_balances(
                parts, channels, frames, smoothing=smoothing, model=model, breaks=breaks
            )
            if parts
            else {}
        )
        for sensor, found in more.items():
            so_far = unrest.setdefault(sensor, [])
            so_far.append(found)
            unrest[sensor] = [settling(one, load_range(parts, frames, sensor)) for one in so_far]
    signals = {channel.sensor: channel.signal for channel in channels}
    return with_unrest(section, unrest, names), tuple(as_findings(unrest, signals))


def load_range(
    balances: Iterable[Balance], frames: Mapping[str, Frame], sensor: str
) -> tuple[float, float]:
    """Return the range of the forces [N] and the torques [Nm] that a sensor carries."""
    gain = frames[sensor].workbench.gain
    inputs = [one.inputs[sensor][:, : gain.shape[1]] for one in balances if sensor in one.inputs]
    force, torque = np.split(np.ptp(np.concatenate(inputs) @ gain.T, axis=0), 2)
    return float(np.linalg.norm(force)), float(np.linalg.norm(torque))


def settling(unrest: Unrest, load: tuple[float, float]) -> Unrest:
    """Return what disturbed a sensor, with small steps apart: left out, but with no new offset.

    An offset wrong by d over a range of loads L bends the matrix by d / L. Where that is less than
    a mounting bends it, what one offset says of light and heavy loads together is worth more.
    """
    steps, small = [], list(unrest.small)
    for step in unrest.steps:
        size = [float(np.linalg.norm(half)) for half in np.split(step.size, 2)]
        if any(d > KAPPA * whole for d, whole in zip(size, load, strict=True)):
            steps.append(step)
        else:
            message = f"{step.message}; little beside its load: no offset of its own"
            small.append(replace(step, message=message))
    return Unrest(tuple(steps), unrest.touches, tuple(small))


def windows_of(section: RecordingSection) -> Windows:
    """Return what a recording trains on or holds out."""
    if section.train is None and not section.test:
        return [(-np.inf, np.inf)]
    return [*(section.train or ()), *section.test]


def within(time: Float[Array, "N"], windows: Windows) -> Bool[Array, "N"]:
    """Return which times [s] lie in any of the windows."""
    found = np.zeros(len(time), dtype=bool)
    for start, stop in windows:
        found |= (time >= start) & (time < stop)
    return found


def with_unrest(
    section: RecordingSection,
    unrest: Mapping[str, Iterable[Unrest]],
    names: Mapping[str, str],
) -> RecordingSection:
    """Return a section with what disturbed its sensors as breaks and windows left out.

    `names` are those of the sensors in the job.
    """
    breaks: dict[str, tuple[float, ...]] = {}
    left_out = dict(section.leave_out)
    for sensor, some in unrest.items():
        name = names[sensor]
        times = sorted({round(step.time, DIGITS) for one in some for step in one.steps})
        spans = [step.unsettled for one in some for step in (*one.steps, *one.small)]
        spans += [(touch.start, touch.stop) for one in some for touch in one.touches]
        if times:
            breaks[name] = tuple(times)
        if spans:
            rounded = ((round(a, DIGITS), round(b, DIGITS)) for a, b in spans)
            left_out[name] = tuple(sorted((*left_out.get(name, ()), *rounded)))
    return section.model_copy(update={"breaks": breaks, "leave_out": left_out})


def as_findings(
    unrest: Mapping[str, Iterable[Unrest]], signals: Mapping[str, str]
) -> Iterator[Finding]:
    """Yield what disturbed the sensors as findings of their signals.

    They are notes: what is held out is not cut.
    """
    for sensor, some in unrest.items():
        signal = signals[sensor]
        for one in some:
            for step in (*one.steps, *one.small):
                yield Finding("offset step", signal, *step.unsettled, False, step.message)
            for touch in one.touches:
                yield Finding("touch", signal, touch.start, touch.stop, False, touch.message)
