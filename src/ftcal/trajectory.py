"""Rest-to-rest moves of minimum jerk: how joints, and loads, go from one place to the next.

T. Flash, N. Hogan, "The coordination of arm movements", J. Neurosci. 5(7), 1985: position, velocity
and acceleration are continuous and known exactly at any time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ftcal.motion import Motion

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

PEAK_SPEED = 15.0 / 8.0
"""Greatest speed of a minimum-jerk move of length 1 in time 1."""

PEAK_ACCELERATION = 10.0 / np.sqrt(3.0)
"""Greatest acceleration of a minimum-jerk move of length 1 in time 1."""


def progress(s: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """Return the share of the way gone after the share `s` of the time, both from 0 to 1."""
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


class Trajectory(Protocol):
    """A motion known at any time; what `ftcal.synthetic` needs of a user's own."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that move or are held."""
        ...

    @property
    def duration(self) -> float:
        """Seconds from 0 to the end."""
        ...

    def at(self, time: Float[Array, "N"]) -> Motion:
        """Return the motion at `time` [s], increasing, within or beyond [0, duration]."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class MinimumJerk:
    """Rest-to-rest moves between waypoints; still before the first and after the last."""

    joints: tuple[str, ...]
    """Joint name of each column."""
    times: Float[Array, "K"]
    """When each waypoint is reached [s], from 0, strictly increasing."""
    waypoints: Float[Array, "K J"]
    """Joint positions [rad or m]; equal neighbours are a pause."""

    @property
    def duration(self) -> float:
        """Seconds from 0 to the last waypoint."""
        return float(self.times[-1])

    def at(self, time: Float[Array, "N"]) -> Motion:
        """Return the motion at `time` [s].

        A move by d in T seconds: `q = q0 + d (10 s^3 - 15 s^4 + 6 s^5)` with `s = (t - t0) / T`.
        """
        move = np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2)
        T = np.diff(self.times)[move, None]
        s = np.clip((time - self.times[move])[:, None] / T, 0.0, 1.0)
        d = np.diff(self.waypoints, axis=0)[move]
        return Motion(
            np.asarray(time, dtype=np.float64),
            self.joints,
            self.waypoints[move] + d * progress(s),
            d / T * (30.0 * (s * (1.0 - s)) ** 2),
            d / T**2 * (60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)),
        )

    def sampled(self, rate: float = 100.0) -> Motion:
        """Return the motion from 0 to its end at `rate` samples per second."""
        return self.at(np.arange(int(self.duration * rate) + 1) / rate)
