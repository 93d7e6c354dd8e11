"""Judging a calibration on samples it never saw, against the Workbench matrix.

Every held-out piece is re-aligned first: both matrices get the offset that fits the piece best, as
the paper's first validation does. Residuals are sensor minus model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from ftcal.samples import Samples
from ftcal.sensor import AXES, UNITS, Workbench

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

BLOCK = 2.0
"""Length [s] of the blocks that the bootstrap resamples: longer than the smoothing remembers."""

MOST_BLOCKS = 500
"""More blocks tell the interval no better: they get longer instead."""

RESAMPLES = 2000
"""Bootstrap resamples: the ends of a 90 % interval then move by about 1 % of its width."""

GROUPS: dict[str, slice] = {
    **{axis: slice(i, i + 1) for i, axis in enumerate(AXES)},
    "force": slice(0, 3),
    "torque": slice(3, 6),
}
"""What is scored: every axis, and force and torque together."""


@dataclass(frozen=True, slots=True)
class HeldOut:
    """A piece of a recording read by both matrices, each aligned to the model's mean."""

    recording: str
    start: float
    stop: float
    time: Float[Array, "N"]
    """Seconds since the start of the recording."""
    model: Float[Array, "N 6"]
    """Model wrench [N, Nm]."""
    workbench: Float[Array, "N 6"]
    """What the Workbench matrix reads [N, Nm]."""
    in_situ: Float[Array, "N 6"]
    """What the new matrix reads [N, Nm]."""


def held_out(samples: Samples, coefficients: Float[Array, "6 P"], workbench: Workbench) -> HeldOut:
    """Return `samples` read by `coefficients` (`[C, k]`) and by the Workbench matrix."""
    inputs = samples.rows()[:, :-6]

    def read(gain: Float[Array, "6 P"]) -> Float[Array, "N 6"]:
        wrench = inputs[:, : gain.shape[1]] @ gain.T
        return np.asarray(wrench + column_means(samples.wrench - wrench))

    return HeldOut(
        samples.recording,
        samples.start,
        samples.stop,
        samples.time,
        samples.wrench,
        read(workbench.gain),
        read(coefficients),
    )


@dataclass(frozen=True, slots=True)
class Score:
    """How one axis, or force or torque together, does on held-out samples."""

    name: str
    """Axis, `force` or `torque`."""
    unit: str
    rms: float
    """RMS residual of the new matrix [N or Nm]; of several axes, of the vector's length."""
    workbench_rms: float
    """RMS residual of the Workbench matrix [N or Nm]."""
    percent: float
    """`rms` in percent of `workbench_rms`."""
    interval: tuple[float, float]
    """90 % block-bootstrap interval of `percent`; (0, inf) with fewer than three blocks."""
    percent_absolute: float
    """The paper's norm: `sum |e|` in percent of the Workbench's."""
    amplitude: float
    """RMS of the new reading about its mean over the Workbench's: 0 is a vanished sensor."""
    trained: tuple[float, float]
    """Smallest and largest model wrench in training (magnitude for force and torque) [N or Nm]."""
    tested: tuple[float, float]
    """The same on the held-out samples."""
    beyond: float
    """Share of the held-out samples that lie outside `trained`."""


@dataclass(frozen=True, slots=True)
class Scores:
    """All scores of one validation."""

    kind: str
    """`hold-out` or `5-fold`, as tables call it."""
    pieces: tuple[HeldOut, ...]
    by_name: dict[str, Score]
    """Keyed by axis, `force` and `torque`."""
    samples: int
    seconds: float
    """Length of the held-out pieces together."""
    blocks: int
    """Blocks that the bootstrap resampled."""


def column_sums(table: Float[Array, "N D"]) -> Float[Array, "D"]:
    """Return the sum of each column; of a few long ones four times as fast as `sum(axis=0)`."""
    return np.asarray(np.ones(len(table)) @ table)


def column_means(table: Float[Array, "N D"]) -> Float[Array, "D"]:
    """Return the mean of each column."""
    return column_sums(table) / len(table)


def magnitude(values: Float[Array, "N D"]) -> Float[Array, "N"]:
    """Return one column as it is, the length of several."""
    if values.shape[1] == 1:
        return np.asarray(values[:, 0])
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", values, values)))  # thrice as fast as `norm`


def block_sums(
    pieces: Sequence[HeldOut], block: float
) -> tuple[Float[Array, "B 6"], Float[Array, "B 6"]]:
    """Return the sums of squared residuals per block in time: new matrix, Workbench."""
    new: list[Array] = []
    old: list[Array] = []
    spans = [float(piece.time[-1] - piece.time[0]) for piece in pieces if len(piece.time)]
    block = max(block, sum(spans) / MOST_BLOCKS)
    for piece in pieces:
        if not len(piece.time):
            continue
        span = piece.time[-1] - piece.time[0]
        count = max(1, round(span / block))
        width = max(span / count, np.finfo(float).tiny)
        index = np.minimum(((piece.time - piece.time[0]) / width).astype(int), count - 1)
        for into, reading in ((new, piece.in_situ), (old, piece.workbench)):
            squares = (reading - piece.model) ** 2
            sums = [np.bincount(index, column, minlength=count) for column in squares.T]
            into.append(np.stack(sums, axis=1))
    return np.concatenate(new), np.concatenate(old)


@lru_cache(maxsize=8)
def resampled(blocks: int, seed: int) -> Float[Array, "R B"]:
    """Return how often each block is drawn in each bootstrap resample; kept, not to be changed."""
    generator = np.random.default_rng(seed)
    drawn = generator.multinomial(blocks, np.full(blocks, 1.0 / blocks), size=RESAMPLES)
    drawn.flags.writeable = False
    return drawn


def bootstrap_interval(
    new: Float[Array, "B"], old: Float[Array, "B"], weights: Float[Array, "R B"]
) -> tuple[float, float]:
    """Return the 90 % interval of `100 sqrt(sum new / sum old)` over resampled blocks.

    B. Efron, R. Tibshirani, *An Introduction to the Bootstrap*, 1993, section 13.3 (percentile),
    blocks as in section 8.6. Fewer than three blocks say nothing: (0, inf).
    """
    if len(new) < 3:
        return (0.0, float("inf"))
    ratio = np.sqrt((weights @ new) / np.maximum(weights @ old, np.finfo(float).tiny))
    low, high = np.quantile(ratio, [0.05, 0.95])
    return (100.0 * float(low), 100.0 * float(high))


Envelope = dict[str, tuple[float, float]]
"""Smallest and largest load of each of `GROUPS` [N, Nm]."""


def load_envelope(wrench: Float[Array, "N 6"]) -> Envelope:
    """Return the range of each axis of a model wrench, and of force and torque in magnitude."""
    ranges = {name: magnitude(wrench[:, columns]) for name, columns in GROUPS.items()}
    return {name: (float(load.min()), float(load.max())) for name, load in ranges.items()}


def score(
    kind: str,
    pieces: Sequence[HeldOut],
    trained: Envelope,
    *,
    block: float = BLOCK,
    seed: int = 0,
) -> Scores:
    """Return the scores of held-out `pieces`; `trained` is the load envelope of training.

    The seed makes the bootstrap repeatable: two runs on the same data print the same interval.
    """
    new, old = block_sums(pieces, block)
    model = np.concatenate([piece.model for piece in pieces])
    absolute, spread = np.zeros((2, 6)), np.zeros((2, 6))
    for piece in pieces:
        for which, reading in enumerate((piece.in_situ, piece.workbench)):
            absolute[which] += column_sums(np.abs(reading - piece.model))
            spread[which] += column_sums((reading - column_means(reading)) ** 2)
    table = {}
    weights = resampled(len(new), seed)
    for name, columns in GROUPS.items():
        squares = new[:, columns].sum(axis=1), old[:, columns].sum(axis=1)
        rms, workbench_rms = (float(np.sqrt(s.sum() / len(model))) for s in squares)
        mine, whole = (float(one[columns].sum()) for one in absolute)
        moved, reference = (float(one[columns].sum()) for one in spread)
        met = magnitude(model[:, columns])
        low, high = trained[name]
        table[name] = Score(
            name,
            UNITS[columns.start],
            rms,
            workbench_rms,
            percentage(rms, workbench_rms),
            bootstrap_interval(*squares, weights),
            percentage(mine, whole),
            float(np.sqrt(moved / reference)) if reference > 0 else float("inf"),
            (low, high),
            (float(met.min()), float(met.max())),
            float(np.mean((met < low) | (met > high))),
        )
    seconds = sum(float(p.time[-1] - p.time[0]) for p in pieces if len(p.time))
    return Scores(kind, tuple(pieces), table, len(model), seconds, len(new))


def percentage(value: float, reference: float) -> float:
    """Return `value` in percent of `reference`; infinite where the reference is perfect."""
    if reference > 0:
        return 100.0 * value / reference
    return 100.0 if value == 0 else float("inf")
