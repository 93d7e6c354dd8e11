"""Steps of a sensor's offset: when a cover, a cable or a knock moved its zero, and by how much.

A robot's own motion says what a sensor should read, up to how its mounting bent it and up to an
offset that holds for a recording. Where the offset steps, neither explains the reading: the search
for such times is `ftcal.step_search`. What jumped may come back little by little, as that of the
real right hip does; until then no offset holds.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.contact import ContactSchedule
from ftcal.errors import DataError, RobotError
from ftcal.motion import STANDARD_GRAVITY
from ftcal.paired import pair
from ftcal.pairing import FtChannel, SignalOptions, matched_channels
from ftcal.recording import Finding, Recording
from ftcal.ridge import scaling_map
from ftcal.robot import Robot
from ftcal.samples import Samples
from ftcal.step_blocks import Blocks, Part, Problem
from ftcal.step_search import KAPPA, LEAST, StepFit, search
from ftcal.touches import Span, touched

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A lasting change of a sensor's offset."""

    time: float
    """Seconds since the start of the recording."""
    uncertainty: float
    """Standard deviation of the time [s]; of a step in a hole that of any time in it."""
    size: Float[Array, "6"]
    """By how much the reading is larger for good [N, Nm]; o of P1 falls by as much."""
    size_sd: Float[Array, "6"]
    """Its standard deviation [N, Nm]."""
    relaxing: Float[Array, "6"]
    """By how much it is larger besides just after `time`, then returning [N, Nm]; mostly zero."""
    unsettled: tuple[float, float]
    """[start, stop) [s] in which no offset holds: the smoothing window and the uncertainty about
    the time, and until what relaxes is lost in the noise. To be left out of training."""
    message: str
    """One line for a person."""


@dataclass(frozen=True, slots=True)
class Touch:
    """A moment that leaves the offset as it was: something touched what was said to be free."""

    start: float
    """Seconds since the start of the recording."""
    stop: float
    """Seconds since the start of the recording, exclusive."""
    message: str
    """One line for a person."""


@dataclass(frozen=True, slots=True)
class Unrest:
    """What disturbed the readings of one sensor."""

    steps: tuple[Step, ...] = ()
    touches: tuple[Touch, ...] = ()
    small: tuple[Step, ...] = ()
    """Steps that are no reason for an offset of its own; they unsettle all the same."""


def all_steps(
    recording: Recording,
    robot: Robot,
    schedule: ContactSchedule,
    *,
    findings: Iterable[Finding] = (),
) -> dict[str, tuple[Step, ...]]:
    """Return the steps of every sensor that is known and free at times, by its name."""
    findings = tuple(findings)
    found = {}
    for channel in matched_channels(recording, robot):
        with suppress(DataError, RobotError):  # not free, or its joints are not logged
            found[channel.sensor] = unrest(
                recording,
                robot,
                channel,
                schedule,
                gravity=STANDARD_GRAVITY,
                findings=findings,
            ).steps
    return {name: steps for name, steps in found.items() if steps}


def unrest(
    recording: Recording,
    robot: Robot,
    channel: FtChannel,
    schedule: ContactSchedule,
    *,
    gravity: tuple[float, float, float],
    imu: str | None = None,
    findings: Iterable[Finding] = (),
    options: SignalOptions | None = None,
) -> Unrest:
    """Return what disturbed a sensor while its limb is free; arguments, errors as of `pair`."""
    options = options or SignalOptions()
    samples = pair(
        recording,
        robot,
        channel,
        schedule,
        gravity=gravity,
        imu=imu,
        findings=findings,
        options=options,
    ).samples
    return unrest_of(samples, channel, options)


def unrest_of(samples: Samples, channel: FtChannel, options: SignalOptions) -> Unrest:
    """Return what disturbed a sensor during some samples, holes or not.

    Steps nearer than 2 s of samples to another or to either end are not looked for; 4 blocks of
    `step_search` in logs of more than five minutes.
    """
    rows = samples.rows()
    inputs = rows.shape[1] - 6
    scaled = rows @ scaling_map(channel.workbench, inputs).T
    blocks = Blocks.of(samples.time, options.smoothing, options.smoothing_order)
    problem = one_sensor(blocks, samples.time, scaled[:, :inputs], scaled[:, inputs:])
    fit, touches = search_untouched(problem)
    found = unrest_in(fit, 0, channel, options.smoothing)
    where = f"{channel.signal}: touched? its free limb"
    more = touch_messages(where, touches.get("", ()))
    return Unrest(found.steps, (*found.touches, *more))


def search_untouched(problem: Problem) -> tuple[StepFit, dict[str, tuple[Span, ...]]]:
    """Return the fit of all steps without the moments of touching, and those by their owner."""
    fit = search(problem)
    touches = touched(fit)
    for owner, spans in touches.items():
        problem = problem.without(owner, spans)
    return (search(problem) if touches else fit), touches


def touch_messages(where: str, spans: Iterable[Span]) -> tuple[Touch, ...]:
    """Return touches of `where` with their lines."""
    return tuple(
        Touch(a, b, f"{where} departs from its balance at {a:.1f}-{b:.1f} s only") for a, b in spans
    )


def one_sensor(
    blocks: Blocks,
    time: Float[Array, "N"],
    y: Float[Array, "N P"],
    z: Float[Array, "N 6"],
) -> Problem:
    """Return the search for steps in `z = E y + offset`, in fractions of full scale."""
    width = y.shape[1]
    block, weight, means = blocks.means(time, np.hstack([y, z]))
    weighed = means * weight[:, None]
    drift = blocks.drift()[block] * weight[:, None]
    rows = np.hstack([weighed[:, :width], drift])
    prior = np.concatenate([np.full(width, 1.0 / KAPPA), np.zeros(drift.shape[1])])
    lever = (weight[:, None],)
    parts = (
        Part(block, np.full(len(block), axis), rows, weighed[:, width + axis], prior, lever)
        for axis in range(6)
    )
    return Problem(blocks, tuple(parts), LEAST, ("",) * 6)


def unrest_in(fit: StepFit, sensor: int, channel: FtChannel, smoothing: float) -> Unrest:
    """Return what a search found of one of its sensors, in words of the sensor.

    What follows before the last has come to rest is the same disturbance; one of which too little
    stays to earn the cost of a step is a touch.
    """
    scale = channel.workbench.full_scale
    half = 0.5 * smoothing
    stays, relaxes, covariance = fit.sizes()
    resolution = fit.resolution(sensor)
    groups: list[list[int]] = []
    dates: dict[int, tuple[float, float]] = {}
    ends: list[float] = []
    for k, event in enumerate(fit.events):
        if event.sensor != sensor:
            continue
        when, sd = dates[k] = fit.dated(k)
        rest = when + 2.0 * sd + half
        if event.tau is not None:
            above = float(np.max(np.abs(relaxes[k]) / resolution))
            rest = max(rest, when + event.tau * float(np.log(max(above, 1.0))))
        if groups and when - 2.0 * sd - half < ends[-1]:
            groups[-1].append(k)
            ends[-1] = max(ends[-1], rest)
        else:
            groups.append([k])
            ends.append(rest)
    steps: list[Step] = []
    touches: list[Touch] = []
    for group, end in zip(groups, ends, strict=True):
        first, sd = dates[group[0]]
        main = max(group, key=lambda k: float(np.linalg.norm(stays[k] + relaxes[k])))
        stay = stays[group].sum(axis=0)
        stay_sd = np.sqrt(covariance[:, group][:, :, group].sum(axis=(1, 2)))
        unsettled = (first - 2.0 * sd - half, end)
        when, sd = dates[main]
        if np.sum((stay / stay_sd) ** 2) < fit.cost(sensor, 1):
            message = (
                f"{channel.signal}: touched? its offset leaves and comes back within"
                f" {unsettled[0]:.1f}-{unsettled[1]:.1f} s"
            )
            touches.append(Touch(*unsettled, message))
            continue
        force, torque = (float(np.linalg.norm(part)) for part in np.split(scale * stay, 2))
        message = (
            f"{channel.signal}: offset steps at {when:.2f} s (sd {sd:.2g} s) by {force:.3g} N and"
            f" {torque:.2g} Nm; unsettled {unsettled[0]:.1f}-{unsettled[1]:.1f} s"
        )
        relaxing = -scale * relaxes[main]
        steps.append(Step(when, sd, -scale * stay, scale * stay_sd, relaxing, unsettled, message))
    return Unrest(tuple(steps), tuple(touches))
