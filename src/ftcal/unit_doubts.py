"""Which units a log was probably not in, judged by what robots and gravity do.

An accelerometer at rest feels one g; gravity turns about an imu as fast as its gyroscope says; a
joint stays within its limits; a robot is logged more than once a second. Each check tells and names
the key of the job file that mends it; none cuts anything. Joints read as degrees though they were
radians look like a robot that hardly moves, which a robot may do: not noticed here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.blocks import BLOCK, Selection
from ftcal.logs.units import STANDARD_G, inertial_columns
from ftcal.recording import Signal
from ftcal.robot import Joint, Robot
from ftcal.turns import Turns

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

ONE_G = 0.2
"""Share by which the median of an accelerometer may miss one g: mounting, calibration, motion."""

SLOWEST, FASTEST = 0.9, 1e-5
"""Median periods [s] beyond which the unit of the stamps is doubted."""

LIKE = 2.0
"""Ratio within which the turn of gravity and that of the gyroscope count as alike."""

ENOUGH = 20
"""Samples without which nothing is doubted."""

ROOM = 1 << 17
"""Samples of an imu whose median is exact."""


def doubted_stamps(count: int, period: float) -> Iterator[str]:
    """Yield what is doubtful about the clock of a signal, from its median period [s]."""
    if count < ENOUGH:
        return
    if period >= SLOWEST:
        yield (
            f"a sample every {period:.3g} s: stamps in milliseconds or microseconds? say"
            ' time_unit = "ms" or "us"'
        )
    if period <= FASTEST:
        yield f'a sample every {period:.3g} s: stamps in seconds? say time_unit = "s"'


@dataclass(slots=True)
class Angles:
    """How far the joints of a signal went."""

    columns: tuple[str, ...]
    """Joint of each column."""
    robot: Robot | None
    """Its joints are judged by their limits; without one, by whether most leave a full turn."""
    count: int = 0
    """Samples seen."""
    farthest: Float[Array, "J"] = field(init=False)
    """Greatest magnitude of each column [rad], NaN where one was."""

    def __post_init__(self) -> None:
        self.farthest = np.zeros(len(self.columns))

    def see(self, values: Float[Array, "N J"]) -> None:
        """Take note of the next samples."""
        self.count += len(values)
        for start in range(0, len(values), BLOCK):
            some = values[start : start + BLOCK]
            ends = some.max(axis=0), -some.min(axis=0)
            self.farthest = np.maximum(self.farthest, np.maximum(*ends))

    def doubts(self) -> Iterator[str]:
        """Yield what is doubtful about the unit of the joints."""
        if self.count < ENOUGH:
            return
        columns = dict(zip(self.columns, self.farthest.tolist(), strict=True))
        if self.robot is not None:
            joints = self.robot.joints
            limits = {name: 2.0 * _limit(joints[name]) for name in columns if name in joints}
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


class Inertia:
    """What an imu felt at the median, and how fast gravity turned about it.

    The median of more than `ROOM` samples is that of those at regular steps (`Selection`).
    """

    def __init__(self, signal: Signal, period: float) -> None:
        """Expect samples of `signal`, whose columns are asked for, at a median period [s]."""
        self.accelerations, velocities = inertial_columns(signal)
        self.felt = Selection(ROOM)
        self.turns = Turns(self.accelerations, velocities, period) if velocities else None

    def see(self, columns: Float[Array, "K B"], stamps: Int[Array, "B"]) -> None:
        """Take note of the next samples and their stamps [ns]."""
        if self.accelerations:
            self.felt.see(columns[self.accelerations])
            if self.turns is not None:
                self.turns.see(stamps, columns)

    def doubts(self) -> Iterator[str]:
        """Yield what is doubtful about the units of the imu."""
        if self.felt.seen < ENOUGH:
            return
        usual = float(np.median(np.linalg.norm(self.felt.columns, axis=0)))
        known = {
            1.0: 'g? say acceleration = "g"',
            STANDARD_G**2: "already m/s^2? leave acceleration out",
        }
        near = [hint for size, hint in known.items() if abs(usual / size - 1.0) < ONE_G]
        if abs(usual / STANDARD_G - 1.0) >= ONE_G:
            hint = near[0] if near else "check its unit, and which of its columns are acceleration"
            yield f"feels {usual:.4g} m/s^2 at the median, gravity is {STANDARD_G:.4g}: {hint}"
        ratio = self.turns.ratio() if self.turns is not None else float("nan")
        if 1.0 / LIKE < ratio * 180.0 / np.pi < LIKE:
            yield (
                f"its gyroscope turns {1.0 / ratio:.3g} times as fast as gravity does about it:"
                ' deg/s? say angular_velocity = "deg/s"'
            )
        if 1.0 / LIKE < ratio * np.pi / 180.0 < LIKE:
            yield (
                f"gravity turns {ratio:.3g} times as fast as its gyroscope says: already rad/s?"
                " leave angular_velocity out"
            )
