"""Steps of a sensor's offset: when a cover, a cable or a knock moved its zero, and by how much.

A robot's own motion says what a sensor should read, up to how its mounting bent it and up to an
offset that holds for a recording. Where the offset steps, neither explains the reading: the search
for such times is `ftcal.step_search`. What jumped may come back little by little, as that of the
real right hip does; until then no offset holds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.balances import Balance
from ftcal.contact import ContactSchedule
from ftcal.errors import DataError, unknown
from ftcal.pairing import FtChannel, SignalOptions, pair
from ftcal.recording import Finding, Recording
from ftcal.ridge import scaling_map
from ftcal.robot import Robot
from ftcal.step_search import KAPPA, Blocks, search

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

NEGLIGIBLE = 1e-4
"""Part of a neighbour's offset, as a share of full scale, that may go unseen: less than noise."""


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

    Steps nearer than 2 s of samples to another or to either end are not looked for.
    """
    options = options or SignalOptions()
    samples = pair(
        recording, robot, channel, schedule, gravity=gravity, findings=findings, options=options
    ).samples
    rows = samples.rows()
    inputs = rows.shape[1] - 6
    scaled = rows @ scaling_map(channel.workbench, inputs).T
    return _steps(samples.time, scaled[:, :inputs], scaled[:, inputs:], channel, options)


def balance_steps(
    balance: Balance, sensor: str, channels: Sequence[FtChannel], options: SignalOptions
) -> tuple[Step, ...]:
    """Return the steps of what one sensor reads against its neighbours' Workbench readings.

    For sensors that are never free. `balance` is `smoothed` with the same options; how the
    neighbours are bent is fitted in the frame of `sensor`. Whether its own offset stepped or a
    neighbour's, one balance cannot tell: a step found on two sides of a sensor is that sensor's.
    Raises `DataError` where the sensor is not on the border, or the torques are not known.
    """
    if sensor not in balance.inputs:
        where = f"sensor on the border of sub-model {balance.sub_model!r}"
        raise DataError(unknown(where, sensor, balance.inputs))
    if balance.by_mass:
        raise DataError(
            f"sub-model {balance.sub_model!r} enters by its mass alone: its torques say nothing of"
            f" the offset of {sensor!r}; log its joints, or take another sub-model"
        )
    by_name = {channel.sensor: channel for channel in channels if channel.sensor in balance.inputs}
    own = by_name[sensor]
    gains = {name: channel.workbench.gain for name, channel in by_name.items()}
    readings = {
        name: values[:, : gains[name].shape[1]] @ gains[name].T
        for name, values in balance.inputs.items()
    }
    rows = np.hstack([balance.inputs[sensor], balance.implied(sensor, readings)])
    inputs = rows.shape[1] - 6
    scaled = rows @ scaling_map(own.workbench, inputs).T
    back = np.linalg.inv(balance.transforms[sensor])
    others = [
        np.einsum("nij,njk,nk->ni", back, X, readings[name]) / own.workbench.full_scale
        for name, X in balance.transforms.items()
        if name != sensor
    ]
    y = np.hstack([scaled[:, :inputs], *others, *_neighbour_offsets(balance, sensor, by_name)])
    return _steps(balance.time, y, scaled[:, inputs:], own, options)


def _neighbour_offsets(
    balance: Balance, sensor: str, channels: Mapping[str, FtChannel]
) -> list[Float[Array, "N M"]]:
    """Return what the unknown offsets of the neighbours look like from `sensor`, up to a constant.

    Scaled so that their prior standard deviation is full scale. As many columns as the relative
    pose of the sensors has to say: a few where one joint is between them.
    """
    scale = channels[sensor].workbench.full_scale
    back = np.linalg.inv(balance.transforms[sensor])
    found = []
    for name, X in balance.transforms.items():
        if name != sensor:
            seen = back @ X * channels[name].workbench.full_scale / scale[:, None]
            table = seen.reshape(len(seen), 36)
            U, d, _ = np.linalg.svd(table - table.mean(axis=0), full_matrices=False)
            kept = d > NEGLIGIBLE * np.sqrt(len(seen))
            found.append(U[:, kept] * d[kept] / KAPPA)
    return found


def _steps(
    time: Float[Array, "N"],
    y: Float[Array, "N P"],
    z: Float[Array, "N 6"],
    channel: FtChannel,
    options: SignalOptions,
) -> tuple[Step, ...]:
    """Return the steps in samples of `z = E y + offset`, in words of the sensor."""
    fit = search(Blocks.of(time, y, z, options))
    scale = channel.workbench.full_scale
    half = 0.5 * options.smoothing
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
