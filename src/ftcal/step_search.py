"""Where a constant changes: steps found by what they explain beyond what one more of them costs.

Searched are times t_k, sizes d_k and, where what jumped comes back as exp(-t / tau), relaxing parts
v_k in

    z(t) = E y(t) + b + c t + sum_k [d_k + v_k exp(-(t - t_k) / tau_k)] step(t - t_k) + noise

of six axes, z and y as in `ftcal.ridge.ScaledProblem`, E held by its prior. All of them are fitted
at once for every choice of times: a step cannot hide in E, nor bend it. The slow drift c t is no
step. A step is seen through the filter that smoothed the samples, so `step` is that filter's answer
to one; all is averaged in blocks, and in a hole no time is better than another.

Steps are added one by one, those that do not earn their cost are dropped, and the noise is
estimated anew each time. A step must explain more than `p log(n / g) + 2 log n` (the modified
information criterion: N. R. Zhang, D. O. Siegmund, Biometrics 63(1), 2007) of squares over their
variance: p sizes, n blocks of which g repeat one another (`ftcal.noise`); one more `log n` for tau.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import legendre

from ftcal.filters import coefficients
from ftcal.noise import inefficiency

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

KAPPA = 0.05
"""Prior standard deviation of E: a mounting bends by about 0.03 of full scale (method 4)."""

BLOCK, MOST_BLOCKS = 0.5, 600
"""Samples are averaged over this long [s]; longer in logs of more blocks than that."""

DRIFT = 3
"""Order of the polynomial in time that a warming sensor drifts by."""

FEWEST = 4
"""Blocks between two steps, and between a step and either end."""

MOST, AHEAD = 12, 2
"""Most steps looked for; and how many may fail in a row: one that reverses another shows little as
long as the other is not known."""

RELAXING = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
"""Time constants tried of what comes back [s]."""

LEAST = np.repeat([2e-4, 8e-4], 3)
"""Least standard deviation of what is left over, share of full scale: that of a good fit of a real
sensor (0.3 N and 0.03 Nm of an iCub's; method 7)."""

MEMORY = 1.0
"""Least time [s] that what is left over repeats itself for: a fit with a step too many hides it."""

ROUNDS = 3
"""Rounds of fit and noise."""

FINE, TAPS = 12, 101
"""Times tried between two blocks, and samples of the filter's window."""


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """The samples averaged over short times, and the filter that they passed."""

    start: Float[Array, "B"]
    """Time at which the block's first sample begins [s]."""
    stop: Float[Array, "B"]
    """Time at which its last sample ends [s]."""
    weight: Float[Array, "B"]
    """Root of its share of samples, about 1."""
    y: Float[Array, "B P"]
    z: Float[Array, "B 6"]
    lag: Float[Array, "L"]
    """Time since a step [s]."""
    answer: Float[Array, "L"]
    """Integral of the filter's answer to a step, at each lag [s]."""
    memory: float
    """Blocks that the filter, or the model's errors, make one."""

    @staticmethod
    def of(
        time: Float[Array, "N"],
        y: Float[Array, "N P"],
        z: Float[Array, "N 6"],
        smoothing: float,
        order: int,
    ) -> Blocks:
        """Return the blocks of samples smoothed over some seconds; none reaches across a hole."""
        period = float(np.median(np.diff(time))) if len(time) > 1 else BLOCK
        length = max(BLOCK, len(time) * period / MOST_BLOCKS)
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
            np.sqrt(counts / counts.mean()),
            np.add.reduceat(y, first, axis=0) / counts[:, None],
            np.add.reduceat(z, first, axis=0) / counts[:, None],
            tick * (np.arange(TAPS + 1) - 0.5 * TAPS),
            tick * np.concatenate([[0.0], np.cumsum(0.5 * (answer[1:] + answer[:-1]))]),
            max(MEMORY, smoothing, length) / length,
        )

    @property
    def edges(self) -> Float[Array, "B-1"]:
        """Times between two blocks; in a hole its middle [s]."""
        return np.asarray(0.5 * (self.stop[:-1] + self.start[1:]))

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
        since = np.subtract.outer(0.5 * (self.start + self.stop), times)
        return np.asarray(self.stepped(times) * np.exp(-np.maximum(since, 0.0) / tau))


@dataclass(frozen=True, slots=True)
class Event:
    """A step; `tau` [s] where a part of it relaxes."""

    time: float
    tau: float | None = None

    def columns(self, blocks: Blocks) -> Float[Array, "B M"]:
        """Return the one or two columns of its sizes."""
        at = np.array([self.time])
        parts = [blocks.stepped(at)]
        if self.tau is not None:
            parts.append(blocks.decaying(at, self.tau))
        return np.hstack(parts)


@dataclass(frozen=True, slots=True, eq=False)
class StepFit:
    """All sizes and E for some events, with the noise that they leave."""

    blocks: Blocks
    events: tuple[Event, ...]
    power: Float[Array, "6"]
    """Variance that counts against one block: `g s^2`."""
    sd: Float[Array, "6"]
    """s, of a block."""
    repeat: Float[Array, "6"]
    """g, blocks that count as one."""

    @staticmethod
    def of(blocks: Blocks, events: Iterable[Event], sd: Float[Array, "6"]) -> StepFit:
        """Return the fit with its noise, starting from that of another."""
        n = len(blocks.z)
        fit = StepFit(blocks, tuple(sorted(events, key=lambda e: e.time)), sd**2, sd, np.ones(6))
        for _ in range(ROUNDS):
            left = np.stack([fit.solved(axis)[1] for axis in range(6)], axis=1)
            repeat = np.maximum(inefficiency([left]), blocks.memory)
            independent = n / repeat
            free = np.maximum(independent - fit.spent(), 0.25 * independent)
            variance = (left**2).sum(axis=0) / n * independent / free
            sd = np.sqrt(np.maximum(variance, LEAST**2))
            fit = replace(fit, power=repeat * sd**2, sd=sd, repeat=repeat)
        return fit

    def design(self, events: Iterable[Event]) -> Float[Array, "B Q"]:
        """Return y, offset, drift and the columns of some events, weighed."""
        blocks = self.blocks
        middle = 0.5 * (blocks.start + blocks.stop)
        slow = 2.0 * (middle - middle[0]) / max(np.ptp(middle), BLOCK) - 1.0
        parts = [blocks.y, legendre.legvander(slow, DRIFT)]
        parts += [event.columns(blocks) for event in events]
        return np.asarray(np.hstack(parts) * blocks.weight[:, None])

    def held(self, design: Float[Array, "B Q"], axis: int) -> Float[Array, "B+P Q"]:
        """Return a design with the rows of the prior of E below it."""
        width = self.blocks.y.shape[1]
        prior = np.zeros((width, design.shape[1]))
        np.fill_diagonal(prior, np.sqrt(self.power[axis]) / KAPPA)
        return np.vstack([design, prior])

    def target(self, axis: int) -> Float[Array, "B+P"]:
        """Return z of an axis, weighed, and the zeros that the prior asks for."""
        z = self.blocks.z[:, axis] * self.blocks.weight
        return np.concatenate([z, np.zeros(self.blocks.y.shape[1])])

    def solved(self, axis: int) -> tuple[Float[Array, "Q"], Float[Array, "B"]]:
        """Return the unknowns of one axis and what they leave over."""
        design = self.design(self.events)
        found = np.linalg.lstsq(self.held(design, axis), self.target(axis), rcond=None)[0]
        return found, self.target(axis)[: len(design)] - design @ found

    def spent(self) -> Float[Array, "6"]:
        """Return how many unknowns of each axis the blocks decide, not the prior."""
        design = self.design(self.events)
        bases = [np.linalg.qr(self.held(design, axis))[0] for axis in range(6)]
        return np.array([(basis[: len(design)] ** 2).sum() for basis in bases])

    def cost(self, sizes: int) -> float:
        """Return what an event with one or two sizes an axis must explain."""
        n = len(self.blocks.z)
        own = float(np.log(np.maximum(n / self.repeat, 2.0)).sum())
        return sizes * own + (1 + sizes) * float(np.log(n))

    def gain(
        self, others: Iterable[Event], times: Float[Array, "M"], tau: float | None
    ) -> Float[Array, "M"]:
        """Return what one more event at each of these times explains, less its cost."""
        design = self.design(others)
        weight = self.blocks.weight[:, None]
        width = self.blocks.y.shape[1]
        parts = [self.blocks.stepped(times)]
        if tau is not None:
            parts.append(self.blocks.decaying(times, tau))
        columns = [np.vstack([part * weight, np.zeros((width, len(times)))]) for part in parts]
        total = np.full(len(times), -self.cost(len(columns)))
        for axis in range(6):
            Q = np.linalg.qr(self.held(design, axis))[0]
            left = self.target(axis)
            left = left - Q @ (Q.T @ left)
            fresh: list[Float[Array, "B+P M"]] = []
            for column in columns:
                rest = column - Q @ (Q.T @ column)
                for known in fresh:
                    rest = rest - known * (known * rest).sum(axis=0)
                length = np.linalg.norm(rest, axis=0)
                # what the others nearly say already cannot be told from them
                clear = length > 0.1
                rest = rest * np.divide(1.0, length, out=np.zeros_like(length), where=clear)
                total += (left @ rest) ** 2 / self.power[axis]
                fresh.append(rest)
        return total

    def best(self, others: Sequence[Event], times: Float[Array, "M"]) -> tuple[float, Event]:
        """Return the event at one of these times that explains most, and how much."""
        tried = []
        for tau in (None, *RELAXING):
            gains = self.gain(others, times, tau)
            at = int(np.argmax(gains))
            tried.append((float(gains[at]), Event(float(times[at]), tau)))
        return max(tried, key=lambda pair: pair[0])

    def sizes(self) -> tuple[Float[Array, "K 6"], Float[Array, "K 6"], Float[Array, "6 K K"]]:
        """Return what stays and what relaxes of each event, and the covariance of what stays."""
        count = len(self.events)
        owns = [1 if event.tau is None else 2 for event in self.events]
        at = self.blocks.y.shape[1] + 1 + DRIFT + np.cumsum([0, *owns])[:count]
        stays, relaxes = np.zeros((count, 6)), np.zeros((count, 6))
        covariance = np.zeros((6, count, count))
        design = self.design(self.events)
        for axis in range(6):
            unknowns = self.solved(axis)[0]
            held = self.held(design, axis)
            inverse = np.linalg.pinv(held.T @ held, hermitian=True)
            covariance[axis] = self.power[axis] * inverse[np.ix_(at, at)]
            stays[:, axis] = unknowns[at]
            for k in np.flatnonzero(np.array(owns) == 2):
                relaxes[k, axis] = unknowns[at[k] + 1]
        return stays, relaxes, covariance

    def dated(self, k: int) -> tuple[float, float]:
        """Return mean and standard deviation of the time of an event, given all others.

        Every time is as likely beforehand: a hole weighs as long as it lasts.
        """
        event = self.events[k]
        others = self.events[:k] + self.events[k + 1 :]
        times = self.near(event.time, FEWEST)
        gains = self.gain(others, times, event.tau)
        weight = np.exp(0.5 * (gains - gains.max())) * np.gradient(times)
        weight /= weight.sum()
        mean = float(weight @ times)
        between = np.diff(times, prepend=times[0]).max(initial=0.0, where=weight > 0.01)
        return mean, float(np.sqrt(weight @ (times - mean) ** 2 + between**2 / 12.0))

    def vacant(self) -> Float[Array, "M"]:
        """Return the times at which one more step may be: far enough from ends and steps."""
        edges = self.blocks.edges
        place = np.searchsorted(edges, [event.time for event in self.events])
        number = np.arange(len(edges))
        far = (number >= FEWEST - 1) & (number <= len(edges) - FEWEST)
        for taken in place:
            far &= np.abs(number - taken) >= FEWEST
        return np.asarray(edges[far])

    def refined(self) -> StepFit:
        """Return the fit with each event moved to the best time near by."""
        events = list(self.events)
        for k, event in enumerate(events):
            others = events[:k] + events[k + 1 :]
            events[k] = self.best(others, self.near(event.time, 1.5))[1]
        return StepFit.of(self.blocks, events, self.sd)

    def near(self, time: float, reach: float) -> Float[Array, "M"]:
        """Return times within so many blocks, finer than blocks; a hole is one more block."""
        edges = self.blocks.edges
        at = float(np.interp(time, edges, np.arange(len(edges))))
        places = np.arange(-reach, reach + 1e-9, 1.0 / FINE) + at
        inside = (places >= 0) & (places <= len(edges) - 1)
        return np.asarray(np.interp(places[inside], np.arange(len(edges)), edges))

    def pruned(self) -> StepFit:
        """Return the fit without the events that do not earn their cost."""
        fit = self
        while fit.events:
            gains = [
                float(fit.gain([o for o in fit.events if o is not e], np.array([e.time]), e.tau)[0])
                for e in fit.events
            ]
            worst = int(np.argmin(gains))
            if gains[worst] > 0.0:
                break
            fit = StepFit.of(fit.blocks, fit.events[:worst] + fit.events[worst + 1 :], fit.sd)
        return fit


def search(blocks: Blocks) -> StepFit:
    """Return the fit with all events that earn their cost."""
    found = tried = StepFit.of(blocks, (), 10.0 * LEAST)
    failed = 0
    while failed <= AHEAD and len(tried.events) < MOST and len(tried.vacant()):
        event = tried.best(tried.events, tried.vacant())[1]
        tried = StepFit.of(blocks, (*tried.events, event), tried.sd).refined()
        kept = tried.pruned()
        if len(kept.events) > len(found.events):
            found = tried = kept
            failed = 0
        else:
            failed += 1
    return found
