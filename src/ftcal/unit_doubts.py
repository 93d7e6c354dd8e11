"""Which units a log was probably not in, judged by what robots and gravity do.

An accelerometer at rest feels one g; gravity turns about an imu as fast as its gyroscope says; a
joint stays within its limits; a robot is logged more than once a second. Each check tells and names
the key of the job file that mends it; none cuts anything. Joints read as degrees though they were
radians look like a robot that hardly moves, which a robot may do: not noticed here.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ftcal.logs.units import STANDARD_G, inertial_columns
from ftcal.recording import NANOSECONDS, Finding, Recording, Signal
from ftcal.robot import Joint, Robot

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

ONE_G = 0.2
"""Share by which the median of an accelerometer may miss one g: mounting, calibration, motion."""

SLOWEST, FASTEST = 0.9, 1e-5
"""Median periods [s] beyond which the unit of the stamps is doubted."""

LIKE = 2.0
"""Ratio within which the turn of gravity and that of the gyroscope count as alike."""

ALIGNED = 0.8
"""Least correlation of both turns from which their ratio is believed."""

LAG = 0.2
"""Time over which gravity's turn is taken [s]: longer than vibration, shorter than a motion."""

LEAST_TURN = 0.02
"""Root mean square turn within LAG [rad] that a gyroscope can be judged by."""

ENOUGH = 20
"""Samples without which nothing is doubted."""


def doubted_units(recording: Recording, robot: Robot | None = None) -> tuple[Finding, ...]:
    """Return the signals whose values or stamps look as if read in a wrong unit.

    With a `robot` its joints are judged by their limits; without one, by whether most columns leave
    a full turn either way.
    """
    found = []
    for signal in (*recording.joints, *recording.channels):
        found += [(signal, message) for message in _stamps(signal)]
    for signal in recording.joints:
        found += [(signal, message) for message in _angles(signal, robot)]
    for signal in recording.imus:
        found += [(signal, message) for message in _inertial(signal)]
    return tuple(
        Finding("unit", s.name, float(t[0]), float(t[-1]), False, f"{s.name}: {message}")
        for s, message in found
        for t in (recording.seconds(s),)
    )


def _stamps(signal: Signal) -> Iterator[str]:
    if len(signal) < ENOUGH:
        return
    if signal.period >= SLOWEST:
        yield (
            f"a sample every {signal.period:.3g} s: stamps in milliseconds or microseconds? say"
            ' time_unit = "ms" or "us"'
        )
    if signal.period <= FASTEST:
        yield f'a sample every {signal.period:.3g} s: stamps in seconds? say time_unit = "s"'


def _angles(signal: Signal, robot: Robot | None) -> Iterator[str]:
    if len(signal) < ENOUGH:
        return
    farthest = np.abs(signal.values).max(axis=0)
    columns = dict(zip(signal.columns, farthest.tolist(), strict=True))
    if robot is not None:
        known = {name: robot.joints[name] for name in columns if name in robot.joints}
        limits = {name: 2.0 * _limit(joint) for name, joint in known.items()}
        beyond = [n for n, limit in limits.items() if columns[n] > max(limit, 2.0 * np.pi)]
        doubted = bool(beyond)
    else:
        beyond = [name for name, angle in columns.items() if angle > 2.0 * np.pi]
        doubted = 2 * len(beyond) > len(columns)
    if doubted:
        worst = max(beyond, key=columns.__getitem__)
        yield (
            f"joint {worst!r} reaches {columns[worst]:.4g} rad, {len(beyond)} of"
            f' {len(columns)} go beyond a full turn: degrees? say angle = "deg"'
        )


def _limit(joint: Joint) -> float:
    """Return the farthest position of a joint from zero; infinity for one without limits."""
    turns = joint.kind == "revolute"
    return max(abs(joint.lower), abs(joint.upper)) if turns else float("inf")


def _inertial(signal: Signal) -> Iterator[str]:
    accelerations, velocities = inertial_columns(signal)
    if len(signal) < ENOUGH or not accelerations:
        return
    acceleration = signal.values[:, accelerations]
    usual = float(np.median(np.linalg.norm(acceleration, axis=1)))
    known = {
        1.0: 'g? say acceleration = "g"',
        STANDARD_G**2: "already m/s^2? leave acceleration out",
    }
    near = [hint for size, hint in known.items() if abs(usual / size - 1.0) < ONE_G]
    if abs(usual / STANDARD_G - 1.0) >= ONE_G:
        hint = near[0] if near else "check its unit, and which of its columns are acceleration"
        yield f"feels {usual:.4g} m/s^2 at the median, gravity is {STANDARD_G:.4g}: {hint}"
    if not velocities:
        return
    ratio = turn_ratio(signal, acceleration, signal.values[:, velocities])
    if 1.0 / LIKE < ratio * 180.0 / np.pi < LIKE:
        yield (
            f"its gyroscope turns {1.0 / ratio:.3g} times as fast as gravity does about it: deg/s?"
            ' say angular_velocity = "deg/s"'
        )
    if 1.0 / LIKE < ratio * np.pi / 180.0 < LIKE:
        yield (
            f"gravity turns {ratio:.3g} times as fast as its gyroscope says: already rad/s? leave"
            " angular_velocity out"
        )


def turn_ratio(
    signal: Signal, acceleration: Float[Array, "N 3"], velocity: Float[Array, "N 3"]
) -> float:
    """Return how fast gravity turns about an imu, over what its gyroscope says; NaN: undecided.

    The direction u of a vector that is constant in the world obeys du/dt = -omega x u in a turning
    frame; the ratio is the regression of its turn within LAG on that of omega, through zero.
    """
    lag = max(round(LAG / signal.period), 1)
    if len(signal) <= lag:
        return float("nan")
    length = np.linalg.norm(acceleration, axis=1, keepdims=True)
    u = acceleration / np.where(length > 0.0, length, 1.0)
    stamps = (signal.stamps - signal.stamps[0]) / NANOSECONDS
    step = stamps[lag:] - stamps[:-lag]
    whole = step < 1.5 * lag * signal.period  # no hole in between
    total = np.vstack([np.zeros(3), np.cumsum(velocity, axis=0)])
    mean = (total[lag : len(signal)] - total[: len(signal) - lag]) / lag
    turn = (u[lag:] - u[:-lag])[whole]
    said = (-step[:, None] * np.cross(mean, 0.5 * (u[lag:] + u[:-lag])))[whole]
    sizes = float((turn**2).sum()), float((said**2).sum())
    if len(turn) == 0 or sizes[0] < len(turn) * LEAST_TURN**2 or sizes[1] == 0.0:
        return float("nan")
    common = float((turn * said).sum())
    return common / sizes[1] if common > ALIGNED * np.sqrt(sizes[0] * sizes[1]) else float("nan")
