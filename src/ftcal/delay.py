"""How late an F/T sensor is behind the joints, and how well the motion shows it.

Boards filter, buses queue and computers stamp on arrival: a reading stamped t may have been felt at
t - tau. The wrench that the joints ask for explains the readings best when shifted by that tau:

    min over tau, G, b   sum_kt e_k(t)^2 / (g_k s_k^2) + sum_kj G_kj^2 / kappa^2
    e(t) = u(t) - (I + G) w(t - tau) - b

in fractions of full scale: u the Workbench wrench of the reading, w the model's, s_k the residual
noise of an axis, g_k how many samples count as one. G, how the mounting bent the sensor, and an
offset b for every few seconds are not wanted: they are minimised for every tau. The *reading* is
regressed on the model, not the other way round: it is the same for every tau, so none wins because
the wrench varies less over the rows compared. Errors of either side that do not know which way time
runs bend G, not tau. Both sides pass the same zero-phase filter (`ftcal.pairing`): neither is
delayed by it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.contact import ContactSchedule
from ftcal.errors import DataError, RobotError
from ftcal.moments import Moments
from ftcal.motion import STANDARD_GRAVITY
from ftcal.noise import inefficiency
from ftcal.paired import pair
from ftcal.pairing import FtChannel, SignalOptions, matched_channels
from ftcal.recording import NANOSECONDS, Finding, Recording, Signal
from ftcal.ridge import ridge_path
from ftcal.robot import Robot
from ftcal.samples import Samples
from ftcal.sensor import AXES, Workbench
from ftcal.signals import default_gap, interpolate, runs

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

REACH = 0.25
"""Largest delay looked for, either way [s]."""

STEP = 0.01
"""Between the delays tried [s], and between the samples of the common clock: little against a
period of any motion that passes the filters."""

KAPPA = 0.1
"""Prior standard deviation of G: a tenth of full scale, weaker than any mounting bends. It decides
only where a periodic motion would let G turn the phase, as a delay does."""

ROUNDS = 4
"""Rounds of delay and residual noise; the noise moves by less than a percent after the third."""

BLOCK = 4.0
"""Longest stretch [s] with one offset: drift and steps slower or rarer than that cost nothing, and
a delay shows in what is faster."""

FEWEST = 4
"""Blocks below which their spread says nothing."""

EVERY = 5
"""One in so many steps is compared: a smoothing window repeats what is nearer."""

PLAUSIBLE = 9.0
"""How far a sum of squares over their variances may be above its least (three standard deviations)
and still be believed."""

LEAST_POWER = 1e-12
"""Least variance of a reading: a millionth of full scale, below what any board resolves."""

WORST = 0.02
"""Standard deviation [s] beyond which a delay counts as unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class Delay:
    """How late an F/T signal is behind the joints of its recording."""

    seconds: float
    """tau [s]: the reading stamped t was felt at t - tau. Best of those tried; NaN where too little
    was left to compare."""
    sd: float
    """Its standard deviation [s]; infinite where no delay within those tried is a minimum."""
    determined: bool
    """Whether the motion shows it: `sd` is at most 20 ms."""
    tried: Float[Array, "L"]
    """Delays of the curve [s]."""
    rms: Float[Array, "L"]
    """Force that each of them leaves unexplained [N], root mean square."""
    message: str
    """One line for a person."""


def delays(
    recording: Recording,
    robot: Robot,
    schedule: ContactSchedule,
    *,
    findings: Iterable[Finding] = (),
) -> tuple[Delay, ...]:
    """Return the delay of every F/T signal whose sensor is known and free at times."""
    findings = tuple(findings)
    found = []
    for channel in matched_channels(recording, robot):
        with suppress(DataError, RobotError):  # not free, or its joints are not logged
            found.append(
                estimate_delay(
                    recording,
                    robot,
                    channel,
                    schedule,
                    gravity=STANDARD_GRAVITY,
                    findings=findings,
                )
            )
    return tuple(found)


def estimate_delay(
    recording: Recording,
    robot: Robot,
    channel: FtChannel,
    schedule: ContactSchedule,
    *,
    gravity: tuple[float, float, float],
    findings: Iterable[Finding] = (),
    options: SignalOptions | None = None,
) -> Delay:
    """Return the delay of one F/T signal behind the joints; arguments and errors as of `pair`.

    Its standard deviation is the largest of three: the curvature of the sum above; what the sum is
    at delays far away, where it has other minima; and the spread of the delays found without one
    block of time after the other (the jackknife: B. Efron, C. Stein, Ann. Statist. 9(3), 1981),
    which also sees errors of the model that a block shares.
    """
    options = options or SignalOptions()
    paired = pair(
        recording, robot, channel, schedule, gravity=gravity, findings=findings, options=options
    )
    lagged = _lagged(paired.samples, channel.workbench, options)
    reach = round(REACH / STEP)
    lags = range(-reach, reach + 1)
    tried = STEP * np.array(lags)
    name = f"delay of {channel.signal!r} behind the joints"
    if len(lagged.blocks) < FEWEST:
        message = (
            f"{name} not determined: {len(lagged.blocks)} blocks of up to {BLOCK:g} s have"
            f" {REACH:g} s without a hole on either side, {FEWEST} are needed; log longer"
        )
        blank = np.full(len(tried), np.nan)
        return Delay(float("nan"), float("inf"), False, tried, blank, message)
    curve = [lagged.scatter(lag).sum(axis=0) for lag in lags]
    weighing, best = _weighing(lagged, lags, curve)
    power = channel.workbench.full_scale[:3] ** 2
    rms = np.array([np.sqrt(power @ weighing.left(S)[:3] / len(lagged.rows)) for S in curve])
    seconds, sd = float(tried[best]), float("inf")
    if 0 < best < len(tried) - 1:
        seconds, sd = _minimum(lagged, weighing, tried, curve, best)
    if sd <= WORST:
        message = f"{name}: {1e3 * seconds:+.1f} ms, standard deviation {1e3 * sd:.1f} ms"
    elif np.isfinite(sd):
        message = (
            f"{name} not determined: standard deviation of {1e3 * sd:.0f} ms exceeds"
            f" {1e3 * WORST:g} ms; record a faster motion, or cut what is no motion: touches and"
            " steps of the offset"
        )
    else:
        message = (
            f"{name} not determined: none within {1e3 * REACH:g} ms is better than its neighbours;"
            " record a faster motion, or check the clocks of both"
        )
    return Delay(seconds, sd, sd <= WORST, tried, rms, message)


@dataclass(frozen=True, slots=True, eq=False)
class _Lagged:
    """Readings and model wrench on one regular clock, a row every `STEP`."""

    reading: Float[Array, "M 6"]
    """Workbench wrench of the reading, in fractions of full scale."""
    model: Float[Array, "M 6"]
    """Model wrench, in fractions of full scale."""
    rows: Int[Array, "N"]
    """Readings compared: the same at every delay, each with its neighbours within reach."""
    blocks: list[slice]
    """Parts of `rows` that share an offset."""

    def shifted(self, lag: int) -> Float[Array, "N 6"]:
        """Return the model wrench `lag` steps before each reading.

        Whole steps: between samples interpolation would smooth, and a delay win for that.
        """
        return np.asarray(self.model[self.rows - lag])

    def scatter(self, lag: int) -> Float[Array, "B 12 12"]:
        """Return the scatter of `[w, u - w]` about the mean of each block, w `lag` before u."""
        w = self.shifted(lag)
        table = np.hstack([w, self.reading[self.rows] - w])
        return np.stack([Moments.of(table[block]).scatter for block in self.blocks])


@dataclass(frozen=True, slots=True, eq=False)
class _Weighing:
    """What an error of each axis weighs."""

    power: Float[Array, "6"]
    """`g s^2`: variance that counts against one sample."""

    @property
    def penalty(self) -> Float[Array, "6"]:
        """What the prior adds to the squares for each unit of G squared."""
        return np.asarray(self.power / KAPPA**2)

    def bend(self, scatter: Float[Array, "12 12"]) -> Float[Array, "6 6"]:
        """Return the G that explains most."""
        return np.asarray(ridge_path(scatter[:6, :6], scatter[6:, :6], self.penalty[None])[0])

    def left(self, scatter: Float[Array, "12 12"]) -> Float[Array, "6"]:
        """Return the sum of squares per axis that no G explains."""
        G = self.bend(scatter)
        own = np.einsum("ip,pq,iq->i", G, scatter[:6, :6], G)
        cross = np.einsum("ip,ip->i", G, scatter[6:, :6])
        return np.asarray(np.maximum(np.diag(scatter)[6:] - 2.0 * cross + own, 0.0))

    def misfit(self, scatter: Float[Array, "12 12"]) -> float:
        """Return the sum that is minimised, as far as one delay goes."""
        held = self.penalty * (self.bend(scatter) ** 2).sum(axis=1)
        return float(((self.left(scatter) + held) / self.power).sum())


def _lagged(samples: Samples, workbench: Workbench, options: SignalOptions) -> _Lagged:
    """Return the samples on a regular clock that runs through each stretch without a hole."""
    scale = workbench.full_scale
    both = np.hstack([samples.channels @ workbench.gain.T / scale, samples.wrench / scale])
    stamps = np.rint(samples.time * NANOSECONDS).astype(np.int64)
    signal = Signal("readings and model", AXES * 2, stamps, both)
    # where a stretch ends, half a smoothing window is missing on either side
    gap = default_gap(signal) if options.max_gap is None else options.max_gap
    gap = min(gap, max(0.5 * options.smoothing, 1.5 * signal.period))
    step, reach = round(STEP * NANOSECONDS), round(REACH / STEP)
    clocks, rows, blocks = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.intp)], []
    before = compared = 0
    for stretch in runs(signal, max_gap=gap):
        clock = np.arange(stamps[stretch.start], stamps[stretch.stop - 1] + 1, step)
        inner = np.arange(reach, len(clock) - reach, EVERY)
        if len(inner) > 1:
            count = int(np.ceil(len(inner) * EVERY * STEP / BLOCK))
            edges = np.linspace(0, len(inner), count + 1).astype(int) + compared
            blocks += [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
            clocks.append(clock)
            rows.append(inner + before)
            before, compared = before + len(clock), compared + len(inner)
    table = interpolate(signal, np.concatenate(clocks), max_gap=gap)
    return _Lagged(table[:, :6], table[:, 6:], np.concatenate(rows), blocks)


def _weighing(
    lagged: _Lagged, lags: Sequence[int], curve: Sequence[Float[Array, "12 12"]]
) -> tuple[_Weighing, int]:
    """Return what each axis weighs and the best of the delays tried, found in turns."""
    count, offsets = len(lagged.rows), len(lagged.blocks)
    reading = lagged.reading[lagged.rows]
    weighing = _Weighing(np.maximum(np.diag(curve[len(curve) // 2])[6:] / count, LEAST_POWER))
    best = 0
    for _ in range(ROUNDS):
        best = int(np.argmin([weighing.misfit(S) for S in curve]))
        w = lagged.shifted(lags[best])
        residual = reading - w - w @ weighing.bend(curve[best]).T
        pieces = [residual[block] - residual[block].mean(axis=0) for block in lagged.blocks]
        repeat = inefficiency(pieces)
        d = np.maximum(np.linalg.eigvalsh(curve[best][:6, :6]), 0.0)
        spent = (d / (d + weighing.penalty[:, None])).sum(axis=1) + offsets
        independent = count / repeat
        left = np.maximum(independent - spent, 0.1 * independent)
        squares = np.sum([(piece**2).sum(axis=0) for piece in pieces], axis=0)
        weighing = _Weighing(np.maximum(squares / count * independent / left * repeat, LEAST_POWER))
    return weighing, best


def _minimum(
    lagged: _Lagged,
    weighing: _Weighing,
    tried: Float[Array, "L"],
    curve: Sequence[Float[Array, "12 12"]],
    best: int,
) -> tuple[float, float]:
    """Return the delay of least misfit and its standard deviation [s]."""
    lag = round(float(tried[best]) / STEP)
    scatters = np.stack([lagged.scatter(lag + step) for step in (-1, 0, 1)])
    blocks = scatters.shape[1]
    summed = scatters.sum(axis=1)
    without = [summed - scatters[:, block] for block in range(blocks)]
    steps, own = np.array([_vertex(weighing, some) for some in (summed, *without)]).T
    if not np.isfinite(own).all():
        return float(tried[best]), float("inf")
    seconds = float(tried[best] + steps[0])
    misfit = np.array([weighing.misfit(S) for S in curve])
    above = misfit - misfit[best] + (steps[0] / own[0]) ** 2
    other = (np.abs(tried - seconds) > STEP) & (above < PLAUSIBLE)
    afar = np.max(np.abs(tried - seconds)[other] / np.sqrt(above[other]), initial=0.0)
    spread = np.sqrt((blocks - 1) * np.var(steps[1:]))
    return seconds, float(max(own[0], afar, spread))


def _vertex(weighing: _Weighing, scatters: Float[Array, "3 12 12"]) -> tuple[float, float]:
    """Return how far beyond the middle the misfit is least, and its standard deviation [s].

    A sum of squares over their variances rises by 1 within a standard deviation.
    """
    before, here, after = (weighing.misfit(S) for S in scatters)
    bow = before - 2.0 * here + after
    if not bow > 0.0:
        return 0.0, float("inf")
    return float(0.5 * STEP * (before - after) / bow), float(STEP * np.sqrt(2.0 / bow))
