"""What the data can say at all, before any number is believed.

Cross-validation does not see it: a direction of the channels that never moved is free, and the
held-out samples do not move in it either. Therefore the directions come first, in the coordinates
of the prior (`ridge.ScaledProblem`: fractions of full scale), each with its signal to noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.noise import Noise
from ftcal.ridge import ScaledProblem
from ftcal.sensor import AXES

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

LEAST_SIGNAL = 3.0
"""A direction whose standard deviation is below this many of its noise's is not excited."""

LEAST_AMPLITUDE = 0.1
"""Model wrench that varies less than this share of the Workbench's reading cannot set a scale."""


@dataclass(frozen=True, slots=True)
class Direction:
    """One principal direction of the channels in fractions of full scale."""

    vector: Float[Array, "P"]
    """Unit vector in the coordinates y."""
    words: str
    """The vector as a person reads it: `tz + 0.4 fy`."""
    sd: float
    """Standard deviation of the data along it, fraction of full scale."""
    signal: float
    """`sd` over the noise's standard deviation along it."""
    share: Float[Array, "6"]
    """Per axis: how much of the estimate along it is the data's (1), not the prior's (0).

    Zero where it is not excited: there the prior is kept (or, with the paper's penalty, noise is
    fitted).
    """

    @property
    def excited(self) -> bool:
        """Whether the data move along it at all."""
        return self.signal >= LEAST_SIGNAL


@dataclass(frozen=True, slots=True)
class Excitation:
    """All directions, the best seen first, and whether the scale can be known."""

    directions: tuple[Direction, ...]
    anchored: bool
    """Whether directions not excited stay at the prior; the paper's penalty fits noise there."""
    amplitude: float
    """RMS of the centred model wrench over that of the Workbench's, in fractions of full scale."""

    @property
    def rank(self) -> int:
        """Number of excited directions."""
        return sum(direction.excited for direction in self.directions)

    @property
    def seen(self) -> Float[Array, "M P"]:
        """The excited directions as rows."""
        vectors = [direction.vector for direction in self.directions if direction.excited]
        return np.array(vectors).reshape(len(vectors), len(self.directions))

    @property
    def condition(self) -> float:
        """Largest over smallest standard deviation (about the mean, in fractions of full scale)."""
        least = self.directions[-1].sd
        return self.directions[0].sd / least if least > 0 else float("inf")

    @property
    def unexcited(self) -> tuple[Direction, ...]:
        """Directions in which the prior alone speaks."""
        return tuple(direction for direction in self.directions if not direction.excited)

    @property
    def scale_is_free(self) -> bool:
        """Whether `C -> 0` explains the data: the model wrench stands still, the channels move."""
        return self.amplitude < LEAST_AMPLITUDE

    def weak(self, axis: int) -> tuple[Direction, ...]:
        """Return the excited directions in which the prior still outweighs the data of an axis."""
        return tuple(d for d in self.directions if d.excited and d.share[axis] < 0.5)


def in_words(vector: Float[Array, "P"], names: tuple[str, ...]) -> str:
    """Return the largest components of a direction, at most three, scaled to the first."""
    order = np.argsort(-np.abs(vector), kind="stable")
    largest = vector[order[0]]
    words = str(names[order[0]])
    for i in order[1:3]:
        share = vector[i] / largest
        if abs(share) >= 0.25:
            words += f" {'+' if share > 0 else '-'} {abs(share):.1f} {names[i]}"
    return words


def excitation(
    problem: ScaledProblem, noise: Noise, kappa: Float[Array, "6"] | None = None
) -> Excitation:
    """Return what pooled moments can say about a gain.

    The noise of a channel is taken as that of the wrench it makes. `kappa` is the prior's standard
    deviation per row; without one (least squares, the paper's lambda) an excited direction is the
    data's alone.
    """
    count = max(problem.moments.count, 1)
    n = len(problem.basis)
    variance, V = np.linalg.eigh(problem.S_yy / count)
    channels = problem.workbench.gain.shape[1]
    scaled_sd = noise.sd / problem.workbench.full_scale
    names: tuple[str, ...] = AXES
    if channels == 6:
        channel_noise = scaled_sd
    else:
        names = tuple(f"channel {i + 1}" for i in range(channels))
        channel_noise = np.full(channels, float(scaled_sd.max()))
    if n > channels:
        names = (*names, "temperature")
        channel_noise = np.append(channel_noise, 0.0)
    power = problem.noise_power(noise)
    directions = []
    for j in np.argsort(-variance, kind="stable"):
        v = V[:, j] * np.sign(V[np.argmax(np.abs(V[:, j])), j])
        sd = float(np.sqrt(max(variance[j], 0.0)))
        floor = float(np.linalg.norm(channel_noise * v))
        signal = sd / floor if floor > 0 else (np.inf if sd > 0 else 0.0)
        precision = variance[j] * count / power
        share = np.zeros(6)
        if signal >= LEAST_SIGNAL:
            share = np.ones(6) if kappa is None else precision / (precision + 1.0 / kappa**2)
        directions.append(Direction(v, in_words(v, names), sd, float(signal), share))
    return Excitation(tuple(directions), kappa is not None, amplitude_ratio(problem))


def amplitude_ratio(problem: ScaledProblem) -> float:
    """Return RMS of the centred model wrench over the Workbench's reading of it."""
    n, channels = len(problem.basis), problem.workbench.gain.shape[1]
    scale = problem.workbench.full_scale[:, None]
    to_wrench = np.zeros((6, n + 6))
    to_wrench[:, :channels] = np.linalg.solve(
        problem.basis[:channels, :channels].T, (problem.workbench.gain / scale).T
    ).T
    workbench = np.trace(problem.moments.map(to_wrench).scatter)
    to_wrench[:, n:] = np.eye(6)
    model = np.trace(problem.moments.map(to_wrench).scatter)
    return float(np.sqrt(max(model, 0.0) / workbench)) if workbench > 0 else float("inf")
