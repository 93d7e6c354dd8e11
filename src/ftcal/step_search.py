"""Where a constant changes: steps found by what they explain beyond what one more of them costs.

Searched are times t_k, sizes d_k and, where what jumped comes back as exp(-t / tau), relaxing parts
v_k in

    z(t) = E y(t) + b + c t + sum_k [d_k + v_k exp(-(t - t_k) / tau_k)] step(t - t_k) + noise

of six axes, z and y as in `ftcal.ridge.ScaledProblem`, E held by its prior; or in all balances of a
robot at once, where d_k is what one sensor adds to every balance that it is part of. All of them
are fitted at once for every choice of times: a step cannot hide in E, nor bend it. The slow drift
c t is no step. In a hole no time is better than another.

Steps are added one by one, those that do not earn their cost are dropped, and the noise is
estimated anew each time. A step must explain more than `p log(n / g) + 2 log n` (the modified
information criterion: N. R. Zhang, D. O. Siegmund, Biometrics 63(1), 2007) of squares over their
variance: p sizes, n places (blocks times sensors), of n blocks g repeat one another
(`ftcal.noise`); one more `log n` for tau.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.noise import inefficiency
from ftcal.step_blocks import Event, Part, Problem

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

KAPPA = 0.05
"""Prior standard deviation of E: a mounting bends by about 0.03 of full scale (method 4)."""

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

ROUNDS = 3
"""Rounds of fit and noise."""

FINE = 12
"""Times tried between two blocks."""

CLEAR = 0.01
"""Share of a block in which a step must be told from all other unknowns."""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """A part with all that some events explain taken away, in standard deviations of its noise."""

    part: Part
    basis: Float[Array, "R Q"]
    """Orthonormal columns of what is known; the rows of the prior are left away."""
    left: Float[Array, "R"]
    """What the target has beyond them."""
    white: Float[Array, "R"]
    """One over the standard deviation of each row."""


@dataclass(frozen=True, slots=True, eq=False)
class StepFit:
    """All sizes and other unknowns for some events, with the noise that they leave."""

    problem: Problem
    events: tuple[Event, ...]
    power: Float[Array, "G"]
    """Variance that counts against one block of a group of rows: `g s^2`."""
    sd: Float[Array, "G"]
    """s, of a block."""
    repeat: Float[Array, "G"]
    """g, blocks that count as one."""

    @staticmethod
    def of(problem: Problem, events: Iterable[Event], sd: Float[Array, "G"]) -> StepFit:
        """Return the fit with its noise, starting from that of another."""
        sorted_events = tuple(sorted(events, key=lambda e: e.time))
        fit = StepFit(problem, sorted_events, sd**2, sd, np.ones_like(sd))
        for _ in range(ROUNDS):
            repeat, variance = np.ones_like(sd), np.zeros_like(sd)
            for part in problem.parts:
                _, left, basis = fit.solved(part)
                spent = (basis**2).sum(axis=1)
                for group in np.unique(part.group):
                    mine = part.group == group
                    count = int(mine.sum())
                    repeats = inefficiency([left[mine, None]])[0]
                    repeat[group] = max(float(repeats), problem.blocks.memory)
                    independent = count / repeat[group]
                    free = max(independent - float(spent[mine].sum()), 0.25 * independent)
                    variance[group] = float((left[mine] ** 2).mean()) * independent / free
            sd = np.sqrt(np.maximum(variance, problem.least**2))
            fit = replace(fit, power=repeat * sd**2, sd=sd, repeat=repeat)
        return fit

    def held(self, part: Part, columns: Float[Array, "R Q"]) -> Float[Array, "R+P Q"]:
        """Return columns in standard deviations of the noise, the rows of the prior below them."""
        prior = np.zeros((int((part.prior > 0).sum()), columns.shape[1]))
        prior[np.arange(len(prior)), np.flatnonzero(part.prior)] = part.prior[part.prior > 0]
        return np.vstack([columns / np.sqrt(self.power[part.group])[:, None], prior])

    def solved(
        self, part: Part
    ) -> tuple[Float[Array, "Q"], Float[Array, "R"], Float[Array, "R Q"]]:
        """Return the unknowns of one part, what they leave over, and the basis of their columns."""
        columns = self.problem.columns(part, self.events)
        basis, triangle = np.linalg.qr(self.held(part, columns))
        basis = basis[: len(columns)]
        seen = basis.T @ (part.target / np.sqrt(self.power[part.group]))
        found = np.linalg.lstsq(triangle, seen, rcond=None)[0]
        return found, part.target - columns @ found, basis

    def known(self, events: Iterable[Event]) -> list[Known]:
        """Return every part without what some events explain."""
        events = tuple(events)
        found = []
        for part in self.problem.parts:
            white = 1.0 / np.sqrt(self.power[part.group])
            basis = np.linalg.qr(self.held(part, self.problem.columns(part, events)))[0]
            basis = basis[: len(white)]
            target = part.target * white
            found.append(Known(part, basis, target - basis @ (basis.T @ target), white))
        return found

    def cost(self, sensor: int, sizes: int) -> float:
        """Return what an event of a sensor with one or two times six sizes must explain."""
        own = 0.0
        for part in self.problem.parts:
            lever = part.levers[sensor]
            groups, counts = np.unique(part.group[lever.any(axis=1)], return_counts=True)
            independent = np.log(np.maximum(counts / self.repeat[groups], 2.0))
            own += lever.shape[1] * float(independent.mean()) if len(groups) else 0.0
        places = len(self.problem.blocks.start) * self.problem.sensors
        return sizes * own + (1 + sizes) * float(np.log(places))

    def gain(
        self,
        known: Iterable[Known],
        sensor: int,
        times: Float[Array, "M"],
        tau: float | None,
    ) -> Float[Array, "M"]:
        """Return what one more event at each of these times explains, less its cost."""
        shapes = self.problem.blocks.shapes(times, tau)
        total = np.full(len(times), -self.cost(sensor, len(shapes)))
        for one in known:
            lever = one.part.levers[sensor] * one.white[:, None]
            rows = np.flatnonzero(lever.any(axis=1))
            block = one.part.block[rows]
            # in units of what a step adds to a block, so that CLEAR is a share
            lever = lever[rows] / usual(lever[rows], block)
            # row, time, size
            fresh = np.concatenate(
                [shape[block][:, :, None] * lever[:, None] for shape in shapes], axis=2
            )
            flat = fresh.reshape(len(rows), -1)
            along = (one.left[rows] @ flat).reshape(fresh.shape[1:])
            seen = (one.basis[rows].T @ flat).reshape(-1, *fresh.shape[1:])
            value, way = np.linalg.eigh(squared(fresh) - squared(seen))
            along = np.einsum("mkj,mk->mj", way, along)
            # what the others nearly say already cannot be told from them
            clear = value > CLEAR
            squares = np.divide(along**2, value, out=np.zeros_like(along), where=clear)
            total += squares.sum(axis=1)
        return total

    def best(
        self, known: Sequence[Known], places: Iterable[tuple[int, Float[Array, "M"]]]
    ) -> tuple[float, Event]:
        """Return the event that explains most, and how much, of sensors and times to try.

        Which sensor it is, lasting steps decide; what relaxes is tried of that one alone.
        """
        tried = []
        where = {}
        for sensor, times in places:
            where[sensor] = times
            tried.append(self._best_time(known, sensor, times, None))
        sensor = max(tried, key=lambda pair: pair[0])[1].sensor
        tried += [self._best_time(known, sensor, where[sensor], tau) for tau in RELAXING]
        return max(tried, key=lambda pair: pair[0])

    def _best_time(
        self, known: Sequence[Known], sensor: int, times: Float[Array, "M"], tau: float | None
    ) -> tuple[float, Event]:
        gains = self.gain(known, sensor, times, tau)
        at = int(np.argmax(gains))
        return float(gains[at]), Event(float(times[at]), tau, sensor)

    def sizes(self) -> tuple[Float[Array, "K 6"], Float[Array, "K 6"], Float[Array, "6 K K"]]:
        """Return what stays and what relaxes of each event, and the covariance of what stays."""
        count = len(self.events)
        owns = [1 if event.tau is None else 2 for event in self.events]
        stays, relaxes, covariance = [], [], []
        for part in self.problem.parts:
            unknowns = self.solved(part)[0]
            held = self.held(part, self.problem.columns(part, self.events))
            inverse = np.linalg.pinv(held.T @ held, hermitian=True)
            width = part.levers[0].shape[1]
            at = part.rows.shape[1] + width * np.cumsum([0, *owns])[:count].astype(int)
            place = at[:, None] + np.arange(width)
            relaxing = np.array(owns)[:, None] == 2
            after = np.minimum(place + width, len(unknowns) - 1)
            stays.append(unknowns[place])
            relaxes.append(np.where(relaxing, unknowns[after], 0.0))
            covariance += [inverse[np.ix_(at + k, at + k)] for k in range(width)]
        return np.hstack(stays), np.hstack(relaxes), np.stack(covariance)

    def resolution(self, sensor: int) -> Float[Array, "6"]:
        """Return the standard deviation with which one block alone says each size of a sensor."""
        found = []
        for part in self.problem.parts:
            lever = part.levers[sensor] / self.sd[part.group][:, None]
            found.append(1.0 / usual(lever, part.block))
        return np.concatenate(found)

    def dated(self, k: int) -> tuple[float, float]:
        """Return mean and standard deviation of the time of an event, given all others.

        Every time is as likely beforehand: a hole weighs as long as it lasts.
        """
        event = self.events[k]
        others = self.events[:k] + self.events[k + 1 :]
        times = self.near(event.time, FEWEST)
        gains = self.gain(self.known(others), event.sensor, times, event.tau)
        weight = np.exp(0.5 * (gains - gains.max())) * np.gradient(times)
        weight /= weight.sum()
        mean = float(weight @ times)
        between = np.diff(times, prepend=times[0]).max(initial=0.0, where=weight > 0.01)
        return mean, float(np.sqrt(weight @ (times - mean) ** 2 + between**2 / 12.0))

    def rivals(self, k: int) -> Float[Array, "S"]:
        """Return what each sensor's step at the time of an event would explain, less its cost."""
        event = self.events[k]
        known = self.known(self.events[:k] + self.events[k + 1 :])
        times = self.near(event.time, 1.5)
        return np.array(
            [
                max(float(self.gain(known, sensor, times, tau).max()) for tau in {None, event.tau})
                for sensor in range(self.problem.sensors)
            ]
        )

    def vacant(self) -> list[tuple[int, Float[Array, "M"]]]:
        """Return sensors and times at which one more step may be: far from ends and its others."""
        found = []
        edges = self.problem.blocks.edges
        for sensor in range(self.problem.sensors):
            before = np.cumsum(self.problem.active(sensor))
            number = before[:-1]
            far = (number >= FEWEST) & (before[-1] - number >= FEWEST)
            for event in self.events:
                if event.sensor == sensor:
                    taken = np.interp(event.time, edges, number)
                    far &= np.abs(number - np.round(taken)) >= FEWEST
            if far.any():
                found.append((sensor, edges[far]))
        return found

    def refined(self) -> StepFit:
        """Return the fit with each event moved to the best time near by."""
        events = list(self.events)
        for k, event in enumerate(events):
            known = self.known(events[:k] + events[k + 1 :])
            events[k] = self.best(known, [(event.sensor, self.near(event.time, 1.5))])[1]
        return StepFit.of(self.problem, events, self.sd)

    def near(self, time: float, reach: float) -> Float[Array, "M"]:
        """Return times within so many blocks, finer than blocks; a hole is one more block."""
        edges = self.problem.blocks.edges
        at = float(np.interp(time, edges, np.arange(len(edges))))
        places = np.arange(-reach, reach + 1e-9, 1.0 / FINE) + at
        inside = (places >= 0) & (places <= len(edges) - 1)
        return np.asarray(np.interp(places[inside], np.arange(len(edges)), edges))

    def pruned(self) -> StepFit:
        """Return the fit without the events that do not earn their cost."""
        fit = self
        while fit.events:
            gains = [
                float(fit.gain(fit.known(o for o in fit.events if o is not e), e.sensor,
                               np.array([e.time]), e.tau)[0])
                for e in fit.events
            ]  # fmt: skip
            worst = int(np.argmin(gains))
            if gains[worst] > 0.0:
                break
            fit = StepFit.of(fit.problem, fit.events[:worst] + fit.events[worst + 1 :], fit.sd)
        return fit


def usual(lever: Float[Array, "R M"], block: Int[Array, "R"]) -> Float[Array, "M"]:
    """Return the root mean square of what each size adds to a block, over all its rows."""
    blocks = max(len(np.unique(block[lever.any(axis=1)])), 1)
    return np.asarray(np.sqrt(np.maximum((lever**2).sum(axis=0) / blocks, np.finfo(float).tiny)))


def squared(table: Float[Array, "R M K"]) -> Float[Array, "M K K"]:
    """Return the products of the columns at every time."""
    at_times = table.transpose(1, 2, 0)
    return np.asarray(at_times @ at_times.transpose(0, 2, 1))


def search(problem: Problem) -> StepFit:
    """Return the fit with all events that earn their cost."""
    found = tried = StepFit.of(problem, (), 10.0 * problem.least)
    failed = 0
    while failed <= AHEAD and len(tried.events) < MOST and (vacant := tried.vacant()):
        event = tried.best(tried.known(tried.events), vacant)[1]
        tried = StepFit.of(problem, (*tried.events, event), tried.sd).refined()
        kept = tried.pruned()
        if len(kept.events) > len(found.events):
            found = tried = kept
            failed = 0
        else:
            failed += 1
    return found
