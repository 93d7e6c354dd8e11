"""A recording and a robot → samples: what a sensor said beside what its model says it felt.

Only usable samples: inside a contact interval, with every needed joint known, without a finding of
the data doctor that cuts. Channels and model wrench then pass the *same* zero-phase filter: the
law is linear, so C is unchanged, while the noise in r, which would bias it towards zero, goes.

A moving contact's own motion comes from an `imus` signal of six columns in the contact frame:
proper acceleration [m/s^2] (what an accelerometer reads) and angular velocity [rad/s].
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.contact import ContactSchedule, Interval
from ftcal.dynamics import expected_wrenches
from ftcal.errors import DataError
from ftcal.firmware import estimate_full_scale
from ftcal.kinematics import centre_of_mass_in_sensor, gravity_in_sensor
from ftcal.motion import Contact, FixedContact, MovingContact
from ftcal.recording import Finding, Recording, Signal, find
from ftcal.robot import Robot
from ftcal.samples import Samples
from ftcal.sensor import Workbench
from ftcal.signals import (
    JOINT_ORDER,
    JOINT_WINDOW,
    SMOOTHING_ORDER,
    SMOOTHING_WINDOW,
    interpolate,
    joint_motion,
    odd_window,
    runs,
    smooth_runs,
    usable,
)
from ftcal.timeline import matching_signals

if TYPE_CHECKING:
    from jaxtyping import Bool, Float
    from numpy import ndarray as Array

Windows = Sequence[tuple[float, float]]
"""[start, stop) in seconds since the start of the recording."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalOptions:
    """Windows of the filters."""

    joint_window: float = JOINT_WINDOW
    """Savitzky-Golay window of the joint positions [s]."""
    joint_order: int = JOINT_ORDER
    """Its polynomial order."""
    smoothing: float = SMOOTHING_WINDOW
    """Window of the filter that channels and model wrench share [s]."""
    smoothing_order: int = SMOOTHING_ORDER
    """Its polynomial order."""
    max_gap: float | None = None
    """Longest time between two samples that is not a hole [s]; None: five periods."""


@dataclass(frozen=True, slots=True)
class FtChannel:
    """One sensor as a job knows it."""

    sensor: str
    """Name in the robot description."""
    signal: str
    """F/T signal of the log."""
    workbench: Workbench
    temperature: str | None = None
    """Temperature signal of the log, if any."""


@dataclass(frozen=True, slots=True)
class Attitude:
    """How the free half hangs on the sensor, in the sensor's frame."""

    gravity: Float[Array, "N 3"]
    """Gravity acceleration [m/s^2]."""
    centre_of_mass: Float[Array, "N 3"]
    """Centre of mass of the free half [m]."""


@dataclass(frozen=True, slots=True)
class Paired:
    """One sensor over one whole recording: channels beside the model wrench, smoothed alike."""

    samples: Samples
    """All usable samples of the recording."""
    logged: int
    """Samples that the log holds of this sensor."""
    attitude: Attitude | None
    """What the in situ offset needs, row by row of `samples`; None unless asked for."""

    def windows(self, windows: Windows) -> list[Samples]:
        """Return an offset segment for each window; windows without a sample are left out."""
        segments = [self.samples.between(start, stop) for start, stop in windows]
        return [segment for segment in segments if len(segment)]


def pair(
    recording: Recording,
    robot: Robot,
    channel: FtChannel,
    schedule: ContactSchedule,
    *,
    gravity: tuple[float, float, float],
    imu: str | None = None,
    findings: Iterable[Finding] = (),
    reference_temperature: float = 0.0,
    options: SignalOptions | None = None,
    with_attitude: bool = False,
) -> Paired:
    """Return the usable samples of one sensor in one recording.

    `gravity` [m/s^2] is that of the contact frame while it stands still; with `imu` its motion is
    that signal's. Intervals in which both halves touch are passed over. Raises `DataError` where a
    needed joint is not logged, where no sample is left, or where no stretch is as long as the
    filter; `RobotError` for unknown names, or where both halves touch throughout.
    """
    options = options or SignalOptions()
    findings = tuple(findings)
    signal = recording.channel(channel.signal)
    expected = channel.workbench.gain.shape[1]
    if len(signal.columns) != expected:
        raise DataError(
            f"recording {recording.name!r}: {signal.name!r} has {len(signal.columns)} channels, the"
            f" Workbench {channel.workbench.name!r} {expected}"
        )
    seconds = recording.seconds(signal)
    ok = usable(recording, signal, findings)
    if not ok.any():
        kinds = sorted({f.kind for f in findings if f.cut and f.signal == signal.name})
        raise DataError(
            f"recording {recording.name!r}: all {len(signal)} samples of {signal.name!r} are cut"
            f" ({', '.join(kinds)}); check the sensor's cable and its board"
        )
    wrench = np.full((len(signal), 6), np.nan)
    attitude = np.full((len(signal), 6), np.nan)
    stretches: list[slice] = []
    for interval in one_sided(robot, channel.sensor, schedule).intervals:
        inside = ok & (seconds >= interval.start) & (seconds < interval.stop)
        if not inside.any():
            continue
        joints = robot.required_joints(channel.sensor, interval.link)
        motion, valid = joint_motion(
            recording,
            joints,
            signal.stamps,
            window=options.joint_window,
            order=options.joint_order,
            max_gap=options.max_gap,
            findings=findings,
        )
        contact, known = contact_motion(
            recording, interval, signal, gravity=gravity, imu=imu, options=options
        )
        rows = inside & valid & known
        if not rows.any():
            continue
        moved = replace(motion.rows(rows), time=seconds[rows])
        here = contact.rows(rows)
        wrench[rows] = expected_wrenches(robot, moved, here, [channel.sensor])[channel.sensor]
        if with_attitude:
            attitude[rows, :3] = gravity_in_sensor(robot, moved, here, channel.sensor)
            attitude[rows, 3:] = centre_of_mass_in_sensor(robot, moved, here, channel.sensor)
        stretches += runs(signal, max_gap=options.max_gap, usable=rows)
    temperature = None
    if channel.temperature is not None:
        warm = recording.temperature(channel.temperature)
        temperature = interpolate(warm, signal.stamps)[:, 0] - reference_temperature
    window = odd_window(options.smoothing, signal.period)
    order = options.smoothing_order
    smoothed = smooth_runs(channel.workbench.channels(signal.values), stretches, window, order)
    felt = smooth_runs(wrench, stretches, window, order)
    kept = np.isfinite(smoothed).all(axis=1) & np.isfinite(felt).all(axis=1)
    if temperature is not None:
        kept &= np.isfinite(temperature)
    if not kept.any():
        raise DataError(
            f"recording {recording.name!r}, sensor {channel.sensor!r}: no usable stretch is as long"
            f" as the {options.smoothing:g} s smoothing window (longest"
            f" {longest(seconds, stretches):.2f} s); log longer or smooth less"
        )
    samples = Samples(
        recording.name,
        float(seconds[kept][0]),
        float(seconds[kept][-1]),
        seconds[kept],
        smoothed[kept],
        felt[kept],
        None if temperature is None else temperature[kept],
    )
    hanging = Attitude(attitude[kept, :3], attitude[kept, 3:]) if with_attitude else None
    return Paired(samples, len(signal), hanging)


def matched_channels(recording: Recording, robot: Robot) -> tuple[FtChannel, ...]:
    """Return a channel for every F/T signal whose name tells its sensor, without a matrix file.

    The log is believed; the full scale is what its steps show, or else ten times its spread.
    """
    found = []
    for name, signal in matching_signals(recording, robot).items():
        values = recording.channel(signal).values
        if values.shape[1] == 6 and len(values):
            shown = estimate_full_scale(values).astype(np.float64)
            spread = np.maximum(10.0 * values.std(axis=0), np.finfo(float).tiny)
            scale = np.where(shown > 0.0, shown, spread)
            workbench = Workbench("as logged", np.eye(6), scale, "channels")
            found.append(FtChannel(name, signal, workbench))
    return tuple(found)


def one_sided(robot: Robot, sensor: str, schedule: ContactSchedule) -> ContactSchedule:
    """Return the intervals in which one half of the robot beyond `sensor` touches nothing.

    Only these say anything of that sensor alone. `RobotError` says where both halves touch, if
    there is no other interval, and names unknown links.
    """
    kept = tuple(
        interval
        for interval in schedule.intervals
        if not all(robot.touched(sensor, interval.touching))
    )
    for interval in kept or schedule.intervals[:1]:
        robot.free_half(sensor, interval.touching)
    return ContactSchedule(kept)


def longest(seconds: Float[Array, "N"], stretches: Iterable[slice]) -> float:
    """Return the length [s] of the longest stretch, zero where there is none."""
    return max((float(seconds[s.stop - 1] - seconds[s.start]) for s in stretches), default=0.0)


def contact_motion(
    recording: Recording,
    interval: Interval,
    signal: Signal,
    *,
    gravity: tuple[float, float, float],
    imu: str | None,
    options: SignalOptions,
) -> tuple[Contact, Bool[Array, "N"]]:
    """Return the contact's motion on the clock of `signal`, and the rows on which it is known.

    The filter of the joints gives an IMU's values and, as their rate, the angular acceleration.
    """
    if imu is None:
        return FixedContact(interval.link, gravity), np.ones(len(signal), dtype=bool)
    unit = find(recording.imus, imu, f"IMU of recording {recording.name!r}")
    if len(unit.columns) != 6:
        raise DataError(
            f"IMU {imu!r} has {len(unit.columns)} columns; it needs six: proper acceleration"
            " [m/s^2], then angular velocity [rad/s], in the contact frame"
        )
    readings, valid = joint_motion(
        replace(recording, joints=(unit,)),
        unit.columns,
        signal.stamps,
        window=options.joint_window,
        order=options.joint_order,
        max_gap=options.max_gap,
    )
    contact = MovingContact(
        interval.link,
        gravity=-readings.position[:, :3],
        angular_velocity=readings.position[:, 3:],
        linear_acceleration=np.zeros((len(signal), 3)),
        angular_acceleration=readings.velocity[:, 3:],
    )
    return contact, valid


def apart(windows: Windows, others: Windows, distance: float) -> list[tuple[float, float]]:
    """Return `windows` without what is nearer than `distance` [s] to any of `others`.

    A smoothed sample knows its neighbours: held-out windows keep a window's distance from
    training.
    """
    kept = list(windows)
    for start, stop in others:
        cut: list[tuple[float, float]] = []
        for a, b in kept:
            cut += [(a, min(b, start - distance)), (max(a, stop + distance), b)]
        kept = [(a, b) for a, b in cut if b > a]
    return kept
