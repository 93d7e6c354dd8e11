"""What is paired with what: sensors of a job, their contacts, and the seconds that count."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.contact import ContactSchedule, Interval
from ftcal.errors import DataError
from ftcal.firmware import estimate_full_scale
from ftcal.motion import Contact, FixedContact, MovingContact
from ftcal.recording import Recording, Signal, find
from ftcal.robot import Robot
from ftcal.sensor import Workbench
from ftcal.signals import (
    JOINT_ORDER,
    JOINT_WINDOW,
    SMOOTHING_ORDER,
    SMOOTHING_WINDOW,
    joint_motion,
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
    wrench_frame: str | None = None
    """Link in whose axes the log gives the wrench; None: in the sensor's own frame."""


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


def inertial_unit(recording: Recording, imu: str) -> Signal:
    """Return the IMU of a moving contact; `DataError` where it has not the six columns."""
    unit = find(recording.imus, imu, f"IMU of recording {recording.name!r}")
    if len(unit.columns) != 6:
        raise DataError(
            f"IMU {imu!r} has {len(unit.columns)} columns; it needs six: proper acceleration"
            " [m/s^2], then angular velocity [rad/s], in the contact frame"
        )
    return unit


def moving_contact(link: str, readings: Float[Array, "3 N 6"]) -> MovingContact:
    """Return the motion of a contact from its IMU's readings and their first derivatives."""
    value, rate = readings[0], readings[1]
    return MovingContact(
        link,
        gravity=-value[:, :3],
        angular_velocity=value[:, 3:],
        linear_acceleration=np.zeros((len(value), 3)),
        angular_acceleration=rate[:, 3:],
    )


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
    unit = inertial_unit(recording, imu)
    readings, valid = joint_motion(
        replace(recording, joints=(unit,)),
        unit.columns,
        signal.stamps,
        window=options.joint_window,
        order=options.joint_order,
        max_gap=options.max_gap,
    )
    table = np.array([readings.position, readings.velocity])
    return moving_contact(interval.link, table), valid


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
