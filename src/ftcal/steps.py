"""Steps of a sensor's offset: when a cover, a cable or a knock moved its zero, and by how much.

A robot's own motion says what a sensor should read, up to how its mounting bent it and up to an
offset that holds for a recording. Where the offset steps, neither explains the reading. Searched
are times t_k, sizes d_k and, where what jumped comes back as exp(-t / tau), relaxing parts v_k in

    z(t) = E y(t) + b + c t + sum_k [d_k + v_k exp(-(t - t_k) / tau_k)] step(t - t_k) + noise

of every axis, z and y as in `ftcal.ridge.ScaledProblem`, E held by the scaled prior. All of them
are fitted at once for every choice of times: a step cannot hide in C, nor bend it. The slow drift
c t is no step. A step is seen through the filter that smoothed the samples, so `step` is that
filter's answer to one; all is averaged in blocks, and in a hole no time is better than another.

Steps are added one by one, those that no longer earn their cost are dropped, and the noise is
estimated anew each time. A step must explain more than `p log(n / g) + 2 log n` (the modified
information criterion: N. R. Zhang, D. O. Siegmund, Biometrics 63(1), 2007) of squares over their
variance: p sizes, n blocks of which g repeat one another (`ftcal.noise`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.balances import Balance
from ftcal.contact import ContactSchedule
from ftcal.filters import smooth
from ftcal.noise import inefficiency
from ftcal.pairing import FtChannel, SignalOptions, pair
from ftcal.recording import Finding, Recording
from ftcal.ridge import scaling_map
from ftcal.robot import Robot

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

KAPPA = 0.05
"""Prior standard deviation of E: a mounting bends by about 0.03 of full scale (method 4)."""

BLOCK, MOST_BLOCKS = 0.5, 600
"""Samples are averaged over this long [s]; longer in logs of more blocks than that."""

FEWEST = 4
"""Blocks between two steps, and between a step and either end."""

MOST, AHEAD = 12, 2
"""Most steps looked for; and how many may fail in a row: one that reverses another shows little as
long as the other is not known."""

RELAXING = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Time constants tried of what comes back [s]."""

LEAST = 2e-4
"""Least standard deviation of what is left over, share of full scale: that of the best fits of a
real sensor (0.3 N, 0.02 Nm of an iCub's; method 7)."""

ROUNDS = 3
"""Rounds of fit and noise."""

FINE = 12
"""Times tried between two blocks."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A lasting change of a sensor's offset."""

    time: float
    """Seconds since the start of the recording."""
    uncertainty: float
    """Standard deviation of the time [s]; of a step in a hole that of any time in it."""
    size: Float[Array, "6"]
    """By how much the reading is larger for good [N, Nm]; o of P1 falls by as much."""
    size_sd: Float[Array, "6"]
    """Its standard deviation [N, Nm]."""
    relaxing: Float[Array, "6"]
    """By how much it is larger besides just after `time`, then returning [N, Nm]; mostly zero."""
    unsettled: tuple[float, float]
    """[start, stop) [s] in which no offset holds: the smoothing window and the uncertainty about
    the time, and until what relaxes is lost in the noise. To be left out of training."""
    message: str
    """One line for a person."""


def offset_steps(
    recording: Recording,
    robot: Robot,
    channel: FtChannel,
    schedule: ContactSchedule,
    *,
    gravity: tuple[float, float, float],
    findings: Iterable[Finding] = (),
    options: SignalOptions | None = None,
) -> tuple[Step, ...]:
    """Return the steps of a sensor's offset while its limb is free; arguments, errors as of `pair`.

    Steps nearer than 2 s of samples to another or to either end are not looked for.
    """
    options = options or SignalOptions()
    samples = pair(
        recording, robot, channel, schedule, gravity=gravity, findings=findings, options=options
    ).samples
    rows = samples.rows()
    inputs = rows.shape[1] - 6
    scaled = rows @ scaling_map(channel.workbench, inputs).T
    return _steps(
        samples.time, scaled[:, :inputs], scaled[:, inputs:], channel, options.smoothing
    )


def balance_steps(
    balance: Balance, sensor: str, channels: Sequence[FtChannel], options: SignalOptions
) -> tuple[Step, ...]:
    """Return the steps of what one sensor reads against its neighbours' Workbench readings.

    For sensors that are never free. `balance` is `smoothed` with the same options; how the
    neighbours are bent is fitted in the frame of `sensor`. Whether its own offset stepped or a
    neighbour's, one balance cannot tell: a step found on two sides of a sensor is that sensor's.
    """
    by_name = {channel.sensor: channel for channel in channels if channel.sensor in balance.inputs}
    own = by_name[sensor]
    gains = {name: channel.workbench.gain for name, channel in by_name.items()}
    readings = {
        name: values[:, : gains[name].shape[1]] @ gains[name].T
        for name, values in balance.inputs.items()
    }
    rows = np.hstack([balance.inputs[sensor], balance.implied(sensor, readings)])
    inputs = rows.shape[1] - 6
    scaled = rows @ scaling_map(own.workbench, inputs).T
    back = np.linalg.inv(balance.transforms[sensor])
    others = [
        np.einsum("nij,njk,nk->ni", back, X, readings[name]) / own.workbench.full_scale
        for name, X in balance.transforms.items()
        if name != sensor
    ]
    y = np.hstack([scaled[:, :inputs], *others])
    return _steps(balance.time, y, scaled[:, inputs:], own, options.smoothing)


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
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

    @property
    def edges(self) -> Float[Array, "B-1"]:
        """Times between two blocks; in a hole its middle [s]."""
        return np.asarray(0.5 * (self.stop[:-1] + self.start[1:]))

    def stepped(self, times: Float[Array, "M"]) -> Float[Array, "B M"]:
        """Return what steps at these times leave in each block."""
        a, b = (np.subtract.outer(edge, times) for edge in (self.start, self.stop))

        def integral(t: Float[Array, "B M"]) -> Float[Array, "B M"]:
            # beyond the window the answer is one
            return np.interp(t, self.lag, self.answer) + np.maximum(t - self.lag[-1], 0.0)

        return np.asarray((integral(b) - integral(a)) / (b - a))

    def decaying(self, times: Float[Array, "M"], tau: float) -> Float[Array, "B M"]:
        """Return what parts that relax from these times on leave in each block."""
        since = np.subtract.outer(0.5 * (self.start + self.stop), times)
        return np.asarray(self.stepped(times) * np.exp(-np.maximum(since, 0.0) / tau))


@dataclass(frozen=True, slots=True)
class _Event:
    """A step; `tau` [s] where a part of it relaxes."""

    time: float
    tau: float | None = None

    def columns(self, blocks: _Blocks) -> Float[Array, "B M"]:
        """Return the one or two columns of its sizes."""
        at = np.array([self.time])
        parts = [blocks.stepped(at)]
        if self.tau is not None:
            parts.append(blocks.decaying(at, self.tau))
        return np.hstack(parts)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """All sizes and E for some events, with the noise that they leave."""

    blocks: _Blocks
    events: tuple[_Event, ...]
    power: Float[Array, "6"]
    """Variance that counts against one block: `g s^2`."""
    sd: Float[Array, "6"]
    """s, of a block."""
    repeat: Float[Array, "6"]
    """g, blocks that count as one."""

    @staticmethod
    def of(blocks: _Blocks, events: Iterable[_Event], sd: Float[Array, "6"]) -> _Fit:
        """Return the fit with its noise, starting from that of another."""
        n = len(blocks.z)
        fit = _Fit(blocks, tuple(sorted(events, key=lambda e: e.time)), sd**2, sd, np.ones(6))
        for _ in range(ROUNDS):
            left = np.stack([fit.solved(axis)[1] for axis in range(6)], axis=1)
            repeat = inefficiency([left])
            columns = fit.design(fit.events).shape[1]
            independent = n / repeat
            # the prior holds E: what is spent is at most the columns of y
            free = np.maximum(independent - columns, 0.25 * independent)
            variance = (left**2).sum(axis=0) / n * independent / free
            sd = np.sqrt(np.maximum(variance, LEAST**2))
            fit = replace(fit, power=repeat * sd**2, sd=sd, repeat=repeat)
        return fit

    def design(self, events: Iterable[_Event]) -> Float[Array, "B Q"]:
        """Return y, offset, drift and the columns of some events, weighed."""
        blocks = self.blocks
        middle = 0.5 * (blocks.start + blocks.stop)
        slow = (middle - middle.mean()) / max(np.ptp(middle), BLOCK)
        parts = [blocks.y, np.ones((len(middle), 1)), slow[:, None]]
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

    def cost(self, sizes: int) -> float:
        """Return what an event with one or two sizes an axis must explain."""
        n = len(self.blocks.z)
        own = float(np.log(np.maximum(n / self.repeat, 2.0)).sum())
        return sizes * own + (1 + sizes) * float(np.log(n))

    def gain(
        self, others: Iterable[_Event], times: Float[Array, "M"], tau: float | None
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

    def best(self, others: Sequence[_Event], times: Float[Array, "M"]) -> tuple[float, _Event]:
        """Return the event at one of these times that explains most, and how much."""
        tried = []
        for tau in (None, *RELAXING):
            gains = self.gain(others, times, tau)
            at = int(np.argmax(gains))
            tried.append((float(gains[at]), _Event(float(times[at]), tau)))
        return max(tried, key=lambda pair: pair[0])

    def open(self) -> Float[Array, "M"]:
        """Return the times at which one more step may be: far enough from ends and steps."""
        edges = self.blocks.edges
        place = np.searchsorted(edges, [event.time for event in self.events])
        number = np.arange(len(edges))
        far = (number >= FEWEST - 1) & (number <= len(edges) - FEWEST)
        for taken in place:
            far &= np.abs(number - taken) >= FEWEST
        return np.asarray(edges[far])

    def refined(self) -> _Fit:
        """Return the fit with each event moved to the best time near by."""
        events = list(self.events)
        for k, event in enumerate(events):
            others = events[:k] + events[k + 1 :]
            events[k] = self.best(others, self.near(event.time, 1.5))[1]
        return _Fit.of(self.blocks, events, self.sd)

    def near(self, time: float, reach: float) -> Float[Array, "M"]:
        """Return times within so many blocks, finer than blocks; a hole is one more block."""
        edges = self.blocks.edges
        at = float(np.interp(time, edges, np.arange(len(edges))))
        places = np.arange(-reach, reach + 1e-9, 1.0 / FINE) + at
        inside = (places >= 0) & (places <= len(edges) - 1)
        return np.interp(places[inside], np.arange(len(edges)), edges)

    def pruned(self) -> _Fit:
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
            fit = _Fit.of(fit.blocks, fit.events[:worst] + fit.events[worst + 1 :], fit.sd)
        return fit


def _searched(blocks: _Blocks) -> _Fit:
    """Return the fit with all events that earn their cost."""
    found = tried = _Fit.of(blocks, (), np.full(6, 10 * LEAST))
    failed = 0
    while failed <= AHEAD and len(tried.events) < MOST and len(tried.open()):
        event = tried.best(tried.events, tried.open())[1]
        tried = _Fit.of(blocks, (*tried.events, event), tried.sd).refined()
        kept = tried.pruned()
        if len(kept.events) > len(found.events):
            found = tried = kept
            failed = 0
        else:
            failed += 1
    return found
