"""How fast gravity turns about an imu, over what its gyroscope says: 1 where both are in SI.

The direction u of a vector that is constant in the world obeys du/dt = -omega x u in a turning
frame; the ratio is the regression of its turn within `LAG` on that of omega, through zero.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.blocks import SPAN
from ftcal.recording import NANOSECONDS

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

ALIGNED = 0.8
"""Least correlation of both turns from which their ratio is believed."""

LAG = 0.2
"""Time over which gravity's turn is taken [s]: longer than vibration, shorter than a motion."""

LEAST_TURN = 0.02
"""Root mean square turn within LAG [rad] that a gyroscope can be judged by."""


@dataclass(slots=True)
class Turns:
    """The turns of one imu, summed up while it passes by, `blocks.SPAN` samples at a time.

    No turn is taken from one such span into the next.
    """

    accelerations: list[int]
    """Columns of the acceleration."""
    velocities: list[int]
    """Columns of the angular velocity."""
    period: float
    """Median time between two samples [s]."""
    sums: Float[Array, "4"] = field(default_factory=lambda: np.zeros(4))
    """Of all spans that are over: turns, squares of gravity's, of the gyroscope's, products."""
    held: list[tuple[Int[Array, "M"], Float[Array, "6 M"]]] = field(default_factory=list)
    """Stamps, accelerations and velocities of the span that is not over."""
    count: int = 0
    """Samples in it."""

    def see(self, stamps: Int[Array, "B"], columns: Float[Array, "K B"]) -> None:
        """Take note of the next samples; a block of `ftcal.blocks` lies within one span."""
        self.held.append((stamps.copy(), columns[[*self.accelerations, *self.velocities]]))
        self.count += len(stamps)
        if self.count == SPAN:
            self.sums = self.sums + self._of_span()
            self.held, self.count = [], 0

    def ratio(self) -> float:
        """Return how fast gravity turns over what the gyroscope says; NaN: undecided."""
        turns, squares, said, common = (self.sums + self._of_span()).tolist()
        if turns == 0 or squares < turns * LEAST_TURN**2 or said == 0.0:
            return float("nan")
        return common / said if common > ALIGNED * np.sqrt(squares * said) else float("nan")

    def _of_span(self) -> Float[Array, "4"]:
        lag = max(round(LAG / self.period), 1) if self.count > 1 else 1
        if self.count <= lag:
            return np.zeros(4)
        stamps = np.concatenate([stamps for stamps, _ in self.held])
        values = np.concatenate([columns.T for _, columns in self.held])
        felt, velocity = values[:, :3], values[:, 3:]
        length = np.linalg.norm(felt, axis=1, keepdims=True)
        u = felt / np.where(length > 0.0, length, 1.0)
        seconds = (stamps - stamps[0]) / NANOSECONDS
        step = seconds[lag:] - seconds[:-lag]
        whole = step < 1.5 * lag * self.period  # no hole in between
        total = np.vstack([np.zeros(3), np.cumsum(velocity, axis=0)])
        mean = (total[lag:-1] - total[: -lag - 1]) / lag
        turn = (u[lag:] - u[:-lag])[whole]
        said = (-step[:, None] * np.cross(mean, 0.5 * (u[lag:] + u[:-lag])))[whole]
        sums = len(turn), (turn**2).sum(), (said**2).sum(), (turn * said).sum()
        return np.array(sums, dtype=np.float64)
