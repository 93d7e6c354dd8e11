"""What the search for steps looks at: readings averaged over short times, and what a step adds.

A step is seen through the filter that smoothed the samples, so what it leaves in a block is that
filter's answer to one. Rows that share unknowns are one part of the problem: each axis of a sensor
whose limb is free; or all balances of a robot at once, where the six sizes of a step of one sensor
appear in every equation that the sensor is part of.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import legendre

from ftcal.filters import coefficients

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array

BLOCK, MOST_BLOCKS = 0.5, 600
"""Samples are averaged over this long [s]; longer in logs of more blocks than that."""

DRIFT = 3
"""Order of the polynomial in time that a warming sensor drifts by."""

MEMORY = 1.0
"""Least time [s] that what is left over repeats itself for: a fit with a step too many hides it."""

TAPS = 101
"""Samples of the filter's window."""


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """The short times that samples are averaged over, and the filter that they passed."""

    start: Float[Array, "B"]
    """Time at which the block's first sample begins [s]."""
    stop: Float[Array, "B"]
    """Time at which its last sample ends [s]."""
    lag: Float[Array, "L"]
    """Time since a step [s]."""
    answer: Float[Array, "L"]
    """Integral of the filter's answer to a step, at each lag [s]."""
    memory: float
    """Blocks that the filter, or the model's errors, make one."""

    @staticmethod
    def of(
        time: Float[Array, "N"], smoothing: float, order: int, *, most: int = MOST_BLOCKS
    ) -> Blocks:
        """Return the blocks of samples smoothed over some seconds; none reaches across a hole."""
        period = float(np.median(np.diff(time))) if len(time) > 1 else BLOCK
        length = max(BLOCK, len(time) * period / most)
        holes = np.flatnonzero(np.diff(time) > max(0.5 * smoothing, 1.5 * period)) + 1
        first: list[int] = []
        for a, b in itertools.pairwise([0, *holes.tolist(), len(time)]):
            count = max(1, round((b - a) * period / length))
            first += np.linspace(a, b, count, endpoint=False).astype(int).tolist()
        counts = np.diff([*first, len(time)])
        tick = smoothing / TAPS
        answer = np.concatenate([[0.0], np.cumsum(coefficients(TAPS, order))])
        return Blocks(
            time[first] - 0.5 * period,
            time[np.add(first, counts) - 1] + 0.5 * period,
            tick * (np.arange(TAPS + 1) - 0.5 * TAPS),
            tick * np.concatenate([[0.0], np.cumsum(0.5 * (answer[1:] + answer[:-1]))]),
            max(MEMORY, smoothing, length) / length,
        )

    @property
    def edges(self) -> Float[Array, "B-1"]:
        """Times between two blocks; in a hole its middle [s]."""
        return np.asarray(0.5 * (self.stop[:-1] + self.start[1:]))

    @property
    def middle(self) -> Float[Array, "B"]:
        """Middle of each block [s]."""
        return np.asarray(0.5 * (self.start + self.stop))

    def drift(self) -> Float[Array, "B D"]:
        """Return the polynomials in time that an offset and its slow drift consist of."""
        middle = self.middle
        slow = 2.0 * (middle - middle[0]) / max(np.ptp(middle), BLOCK) - 1.0
        return np.asarray(legendre.legvander(slow, DRIFT))

    def means(
        self, time: Float[Array, "N"], table: Float[Array, "N K"]
    ) -> tuple[Int[Array, "R"], Float[Array, "R"], Float[Array, "R K"]]:
        """Return which blocks hold some of the samples, their weights and means.

        The weight is the root of a block's share of samples, about 1.
        """
        cell = np.searchsorted(self.start, time, side="right") - 1
        opens = np.flatnonzero(np.diff(cell, prepend=-1))
        counts = np.diff([*opens, len(time)])
        means = np.add.reduceat(table, opens, axis=0) / counts[:, None]
        return cell[opens], np.sqrt(counts / counts.mean()), means

    def stepped(self, times: Float[Array, "M"]) -> Float[Array, "B M"]:
        """Return what steps at these times leave in each block."""
        a, b = (np.subtract.outer(edge, times) for edge in (self.start, self.stop))

        def integral(t: Float[Array, "B M"]) -> Float[Array, "B M"]:
            # beyond the window the answer is one
            late = np.maximum(t - self.lag[-1], 0.0)
            return np.asarray(np.interp(t, self.lag, self.answer) + late)

        return np.asarray((integral(b) - integral(a)) / (b - a))

    def decaying(self, times: Float[Array, "M"], tau: float) -> Float[Array, "B M"]:
        """Return what parts that relax from these times on leave in each block."""
        since = np.subtract.outer(self.middle, times)
        return np.asarray(self.stepped(times) * np.exp(-np.maximum(since, 0.0) / tau))

    def shapes(self, times: Float[Array, "M"], tau: float | None) -> list[Float[Array, "B M"]]:
        """Return what lasts, and where there is a tau what relaxes, of steps at these times."""
        lasting = [self.stepped(times)]
        return lasting if tau is None else [*lasting, self.decaying(times, tau)]


@dataclass(frozen=True, slots=True)
class Event:
    """A step of one sensor; `tau` [s] where a part of it relaxes."""

    time: float
    tau: float | None = None
    sensor: int = 0
    """Which of the sensors of the problem."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Rows that share unknowns, weighed by their blocks' share of samples."""

    block: Int[Array, "R"]
    """Block of each row."""
    group: Int[Array, "R"]
    """Whose noise it has: an axis, or an equation of a sub-model."""
    rows: Float[Array, "R P"]
    """What every unknown but the steps adds to it."""
    target: Float[Array, "R"]
    """What they must add up to."""
    prior: Float[Array, "P"]
    """One over the prior standard deviation of each unknown; zero: not held."""
    levers: tuple[Float[Array, "R M"], ...]
    """What a lasting change of each sensor adds to it, a column for each size."""

    def kept(self, keep: Bool[Array, "R"]) -> Part:
        """Return the part with some of its rows."""
        levers = tuple(lever[keep] for lever in self.levers)
        return Part(
            self.block[keep], self.group[keep], self.rows[keep], self.target[keep], self.prior,
            levers,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """All that a search looks at."""

    blocks: Blocks
    parts: tuple[Part, ...]
    least: Float[Array, "G"]
    """Least standard deviation of what is left over, of every group of rows."""
    owners: tuple[str, ...]
    """What each group of rows is about: equations with one owner are touched together."""

    @property
    def sensors(self) -> int:
        """How many sensors may step."""
        return len(self.parts[0].levers)

    def active(self, sensor: int) -> Bool[Array, "B"]:
        """Return the blocks in which a sensor has a say."""
        found = np.zeros(len(self.blocks.start), dtype=bool)
        for part in self.parts:
            found[part.block[part.levers[sensor].any(axis=1)]] = True
        return found

    def columns(self, part: Part, events: Iterable[Event]) -> Float[Array, "R Q"]:
        """Return the columns of a part: those always there, then those of some events."""
        found = [part.rows]
        for event in events:
            for shape in self.blocks.shapes(np.array([event.time]), event.tau):
                found.append(shape[part.block] * part.levers[event.sensor])
        return np.hstack(found)

    def without(self, owner: str, spans: Sequence[tuple[float, float]]) -> Problem:
        """Return the problem without an owner's rows whose blocks overlap some spans [s]."""
        blocks = self.blocks
        gone = np.zeros(len(blocks.start), dtype=bool)
        for start, stop in spans:
            gone |= (blocks.stop > start) & (blocks.start < stop)
        mine = np.array([name == owner for name in self.owners])
        parts = tuple(part.kept(~(gone[part.block] & mine[part.group])) for part in self.parts)
        return replace(self, parts=parts)
