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
from ftcal.pairing import FtChannel, SignalOptions, matched_channels, pair
from ftcal.recording import Finding, Recording
from ftcal.ridge import scaling_map
from ftcal.robot import Robot
from ftcal.step_search import Blocks, search

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
            found[channel.sensor] = offset_steps(
                recording,
                robot,
                channel,
                schedule,
                gravity=STANDARD_GRAVITY,
                findings=findings,
            )
    return {name: steps for name, steps in found.items() if steps}


def offset_steps(
    recording: Recording,
    robot: Robot,
    channel: FtChannel,
    schedule: ContactSchedule,
    *,
    gravity: tuple[float, float, float],
    findings: Iterable[Finding] = (),
    options: SignalOptions | None = None,
) -> tuple[Step, ...]:
    """Return the steps of a sensor's offset while its limb is free; arguments, errors as of `pair`.

    Steps nearer than 2 s of samples to another or to either end are not looked for; 4 blocks of
    `step_search` in logs of more than five minutes.
    """
    options = options or SignalOptions()
    samples = pair(
        recording, robot, channel, schedule, gravity=gravity, findings=findings, options=options
    ).samples
    rows = samples.rows()
    inputs = rows.shape[1] - 6
    scaled = rows @ scaling_map(channel.workbench, inputs).T
    blocks = Blocks.of(
        samples.time,
        scaled[:, :inputs],
        scaled[:, inputs:],
        options.smoothing,
        options.smoothing_order,
    )
    return _steps(blocks, channel, options.smoothing)


def _steps(blocks: Blocks, channel: FtChannel, smoothing: float) -> tuple[Step, ...]:
    """Return the steps in blocks of `z = E y + offset`, in words of the sensor."""
    fit = search(blocks)
    scale = channel.workbench.full_scale
    half = 0.5 * smoothing
    dates = [fit.dated(k) for k in range(len(fit.events))]
    stays, relaxes, covariance = fit.sizes()
    # what follows before the last has come to rest is the same disturbance
    groups: list[list[int]] = []
    ends: list[float] = []
    for k, (event, (when, sd)) in enumerate(zip(fit.events, dates, strict=True)):
        rest = when + 2.0 * sd + half
        if event.tau is not None:
            above = float(np.max(np.abs(relaxes[k]) / fit.sd))
            rest = max(rest, when + event.tau * float(np.log(max(above, 1.0))))
        if groups and when - 2.0 * sd - half < ends[-1]:
            groups[-1].append(k)
            ends[-1] = max(ends[-1], rest)
        else:
            groups.append([k])
            ends.append(rest)
    found = []
    for group, end in zip(groups, ends, strict=True):
        first, sd = dates[group[0]]
        main = max(group, key=lambda k: float(np.linalg.norm(stays[k] + relaxes[k])))
        size = -scale * stays[group].sum(axis=0)
        size_sd = scale * np.sqrt(covariance[:, group][:, :, group].sum(axis=(1, 2)))
        unsettled = (first - 2.0 * sd - half, end)
        when, sd = dates[main]
        force, torque = (float(np.linalg.norm(part)) for part in np.split(size, 2))
        message = (
            f"{channel.signal}: offset steps at {when:.2f} s (sd {sd:.2g} s) by {force:.3g} N and"
            f" {torque:.2g} Nm; unsettled {unsettled[0]:.1f}-{unsettled[1]:.1f} s"
        )
        found.append(Step(when, sd, size, size_sd, -scale * relaxes[main], unsettled, message))
    return tuple(found)
