"""Judging a calibration on samples it never saw, against the Workbench matrix.

Every held-out piece is re-aligned first: both matrices get the offset that fits the piece best, as
the paper's first validation does. Residuals are sensor minus model. What they add up to comes from
the moments of all samples; the samples that are kept draw them, and give the paper's norm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.bootstrap import BLOCK, MOST_BLOCKS, block_starts, bootstrap_intervals, resampled
from ftcal.samples import Samples
from ftcal.segments import Segment, loads
from ftcal.sensor import AXES, UNITS, Workbench

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

GROUPS: dict[str, slice] = {
    **{axis: slice(i, i + 1) for i, axis in enumerate(AXES)},
    "force": slice(0, 3),
    "torque": slice(3, 6),
}
"""What is scored: every axis, and force and torque together."""

TWICE = np.vstack([np.eye(6), np.eye(6)])
"""The model's wrench, for both readings."""


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """What all samples of a held-out piece add up to, however few of them are kept."""

    count: int
    """Samples."""
    span: tuple[float, float]
    """Times of the first and the last [s]."""
    at: Float[Array, "B"]
    """Middle of each part of it [s]: a cell, or a block of the bootstrap."""
    squares: Float[Array, "B 12"]
    """Sum of the squared residuals over each part [N^2, Nm^2]: new matrix, then Workbench."""
    spread: Float[Array, "12"]
    """Sum of the squares of each reading about its mean: new matrix, then Workbench."""
    loads: Float[Array, "2 8"]
    """Least and greatest model wrench: `GROUPS` in order [N, Nm]."""

    @property
    def seconds(self) -> float:
        """From the first sample to the last."""
        return self.span[1] - self.span[0]

    def blocks(self, block: float) -> Float[Array, "B 12"]:
        """Return the squares over blocks of about `block` seconds, neighbouring parts together."""
        return np.add.reduceat(self.squares, block_starts(self.at, *self.span, block))


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """A piece of a recording read by both matrices, each aligned to the model's mean."""

    recording: str
    start: float
    stop: float
    time: Float[Array, "N"]
    """Seconds since the start of the recording; of the samples kept."""
    model: Float[Array, "N 6"]
    """Model wrench [N, Nm]."""
    workbench: Float[Array, "N 6"]
    """What the Workbench matrix reads [N, Nm]."""
    in_situ: Float[Array, "N 6"]
    """What the new matrix reads [N, Nm]."""
    sums: Sums
    """Over all samples."""

    @property
    def each(self) -> float:
        """How many samples one that is kept stands for."""
        return self.sums.count / max(len(self.time), 1)

    @property
    def step(self) -> int:
        """One sample in so many is kept."""
        return round(self.each)

    @staticmethod
    def of_all(
        recording: str,
        start: float,
        stop: float,
        time: Float[Array, "N"],
        model: Float[Array, "N 6"],
        workbench: Float[Array, "N 6"],
        in_situ: Float[Array, "N 6"],
    ) -> HeldOut:
        """Return a piece of which all samples are there, at least one."""
        span = (float(time[0]), float(time[-1]))
        both = np.concatenate([in_situ, workbench], axis=1)
        starts = block_starts(time, *span, BLOCK)
        ends = np.append(starts[1:], len(time)) - 1
        sums = Sums(
            len(time),
            span,
            0.5 * (time[starts] + time[ends]),
            np.add.reduceat((both - np.concatenate([model, model], axis=1)) ** 2, starts),
            column_sums((both - column_means(both)) ** 2),
            loads(model),
        )
        return HeldOut(recording, start, stop, time, model, workbench, in_situ, sums)


def held_out(segment: Segment, coefficients: Float[Array, "6 P"], workbench: Workbench) -> HeldOut:
    """Return a segment read by `coefficients` (`[C, k]`) and by the Workbench matrix."""
    kept, cells = segment.samples, segment.cells
    new, old = (filled(gain, kept) for gain in (coefficients, workbench.gain))
    whole = cells.total()
    to_reading = np.hstack([np.concatenate([new, old]), np.zeros((12, 6))])
    to_residual = to_reading - np.hstack([np.zeros((12, whole.mean.size - 6)), TWICE])
    apart = (cells.mean - whole.mean) @ to_residual.T
    # the diagonal of `R S R^T` of all cells at once: one product of two matrices
    both = np.einsum("id,ie->dei", to_residual, to_residual).reshape(-1, 12)
    inside = cells.scatter.reshape(len(cells), -1) @ both
    sums = Sums(
        len(segment),
        (float(segment.spans[0, 0]), float(segment.spans[-1, 1])),
        segment.spans.mean(axis=1),
        np.maximum(inside, 0.0) + cells.count[:, None] * apart**2,
        np.maximum(np.diag(whole.map(to_reading).scatter), 0.0),
        segment.envelope,
    )
    offset = to_residual @ whole.mean
    return HeldOut(
        kept.recording,
        kept.start,
        kept.stop,
        kept.time,
        kept.wrench,
        read(kept, old) - offset[6:],
        read(kept, new) - offset[:6],
        sums,
    )


def held_out_samples(
    samples: Samples, coefficients: Float[Array, "6 P"], workbench: Workbench
) -> HeldOut:
    """Return samples, all that there are, read as `held_out` reads a segment."""
    new, old = (read(samples, filled(gain, samples)) for gain in (coefficients, workbench.gain))
    model = samples.wrench
    return HeldOut.of_all(
        samples.recording,
        samples.start,
        samples.stop,
        samples.time,
        model,
        old + column_means(model - old),
        new + column_means(model - new),
    )


def filled(gain: Float[Array, "6 P"], samples: Samples) -> Float[Array, "6 Q"]:
    """Return a gain with a zero for every input of the samples that it does not know."""
    inputs = samples.channels.shape[1] + (samples.temperature is not None)
    return np.pad(gain, ((0, 0), (0, inputs - gain.shape[1])))


def read(samples: Samples, gain: Float[Array, "6 Q"]) -> Float[Array, "N 6"]:
    """Return what `[C, k]` reads, without an offset."""
    channels = samples.channels.shape[1]
    wrench = samples.channels @ gain[:, :channels].T
    if samples.temperature is not None:
        wrench += np.outer(samples.temperature, gain[:, channels])
    return np.asarray(wrench)


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


Envelope = dict[str, tuple[float, float]]
"""Smallest and largest load of each of `GROUPS` [N, Nm]."""


def load_envelope(wrench: Float[Array, "N 6"]) -> Envelope:
    """Return the range of each axis of a model wrench, and of force and torque in magnitude."""
    return named(loads(wrench))


def named(ranges: Float[Array, "2 8"]) -> Envelope:
    """Return the ranges of `segments.loads` by name."""
    return {name: (float(a), float(b)) for name, (a, b) in zip(GROUPS, ranges.T, strict=True)}


def grouped(table: Float[Array, "*N 6"]) -> Float[Array, "*N 8"]:
    """Return the sums of the columns of each of `GROUPS`."""
    sums = [table[..., columns].sum(axis=-1, keepdims=True) for columns in GROUPS.values()]
    return np.concatenate(sums, axis=-1)


def score(kind: str, pieces: Sequence[HeldOut], trained: Envelope, *, seed: int = 0) -> Scores:
    """Return the scores of held-out `pieces`; `trained` is the load envelope of training.

    The seed makes the bootstrap repeatable: two runs on the same data print the same interval.
    """
    every = [piece.sums for piece in pieces]
    seconds, samples = sum(one.seconds for one in every), sum(one.count for one in every)
    block = max(BLOCK, seconds / MOST_BLOCKS)
    squares = np.concatenate([one.blocks(block) for one in every]).reshape(-1, 2, 6)
    new, old = np.moveaxis(grouped(squares), 1, 0)
    intervals = bootstrap_intervals(new, old, resampled(len(new), seed))
    rms, workbench_rms = np.sqrt(np.stack([new, old]).sum(axis=1) / samples)
    moved, reference = grouped(np.sum([one.spread for one in every], axis=0).reshape(2, 6))
    tested = [np.array([one.loads[i] for one in every]) for i in (0, 1)]
    met = named(np.array([tested[0].min(axis=0), tested[1].max(axis=0)]))
    limits = np.array([trained[name] for name in GROUPS])
    absolute, whole, beyond = _of_kept(pieces, limits)
    table = {}
    for i, (name, columns) in enumerate(GROUPS.items()):
        table[name] = Score(
            name,
            UNITS[columns.start],
            float(rms[i]),
            float(workbench_rms[i]),
            percentage(float(rms[i]), float(workbench_rms[i])),
            intervals[i],
            percentage(float(absolute[i]), float(whole[i])),
            float(np.sqrt(moved[i] / reference[i])) if reference[i] > 0 else float("inf"),
            trained[name],
            met[name],
            float(beyond[i]) / samples,
        )
    return Scores(kind, tuple(pieces), table, samples, seconds, len(new))


def _of_kept(
    pieces: Sequence[HeldOut], limits: Float[Array, "8 2"]
) -> tuple[Float[Array, "8"], Float[Array, "8"], Float[Array, "8"]]:
    """Return `sum |e|` of both matrices, and how many samples lie beyond `limits`.

    Samples that are kept count for those that are not.
    """
    absolute, beyond = np.zeros((2, 6)), np.zeros(8)
    for piece in pieces:
        for which, reading in enumerate((piece.in_situ, piece.workbench)):
            absolute[which] += piece.each * column_sums(np.abs(reading - piece.model))
        if (piece.sums.loads[0] < limits[:, 0]).any() or (piece.sums.loads[1] > limits[:, 1]).any():
            met = np.column_stack([magnitude(piece.model[:, some]) for some in GROUPS.values()])
            beyond += piece.each * column_sums((met < limits[:, 0]) | (met > limits[:, 1]))
    mine, whole = grouped(absolute)
    return mine, whole, beyond


def percentage(value: float, reference: float) -> float:
    """Return `value` in percent of `reference`; infinite where the reference is perfect."""
    if reference > 0:
        return 100.0 * value / reference
    return 100.0 if value == 0 else float("inf")
