"""The paper's first validation: every data set's matrix on every data set, itself included.

Each matrix is plain least squares (lambda = 0) on one recording, its offset taken out in one of two
ways (section IV-A): *centred*, by the recording's own means, or *in situ*, by the centre of the
ellipsoid that the raw channels draw. Errors are in percent of the Workbench's, in two norms: that
of the paper, `sum |e|`, and RMS; several axes together add N and Nm up, as the paper does.

Beyond the paper: what counts is what a matrix does on recordings it never saw, with an interval.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal.bootstrap import BLOCK
from ftcal.errors import DataError
from ftcal.folds import about_zero
from ftcal.moments import Moments, within
from ftcal.one_sensor import about_offset
from ftcal.preparation import SensorTake
from ftcal.ridge import Estimate, penalty_path
from ftcal.samples import sample_count
from ftcal.sensor import AXES, Workbench
from ftcal.validate import (
    GROUPS,
    Envelope,
    HeldOut,
    Scores,
    held_out_samples,
    load_envelope,
    score,
)

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

Norm = Literal["absolute", "rms"]
"""`sum |e|` as in the paper, or root mean square."""

Method = Literal["centred", "in situ"]
"""How the offset leaves the training data (section IV-A)."""

IN_SITU = " (in situ)"
"""Marks a training set with an in situ offset."""

TOGETHER: dict[str, slice] = {**GROUPS, "all": slice(0, 6)}
"""What is scored: every axis, force, torque, and all six axes."""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingSet:
    """One recording to learn from, its offset taken out in one way."""

    recording: str
    method: Method
    moments: Moments
    """Of the channels and the model wrench, about their offsets."""
    envelope: Envelope
    """Loads that it saw."""

    @property
    def name(self) -> str:
        """Name in tables."""
        return self.recording + (IN_SITU if self.method == "in situ" else "")

    def estimates(self, workbench: Workbench, lambdas: Sequence[float]) -> list[Estimate]:
        """Return the estimate (P7) for each penalty."""
        return penalty_path(self.moments, workbench, np.array(lambdas))


def training_sets(recording: str, take: SensorTake) -> tuple[list[TrainingSet], dict[str, str]]:
    """Return the training sets that one recording makes, and those refused with the reason.

    Raises `DataError` where it is shorter than two blocks of the validation.
    """
    seconds = sum(float(s.time[-1] - s.time[0]) for s in take.segments)
    if seconds < 2.0 * BLOCK:
        raise DataError(
            f"recording {recording!r}: {seconds:.1f} s of usable samples"
            f" ({sample_count(take.segments)}) are less than two blocks of {BLOCK:g} s of the"
            " cross-validation; record longer, or widen `train`"
        )
    envelope = load_envelope(np.concatenate([segment.wrench for segment in take.segments]))
    parts = [segment.moments() for segment in take.segments]
    sets = [TrainingSet(recording, "centred", within(parts), envelope)]
    refusals = [offset.refusal for offset in take.offsets if offset.refusal]
    if refusals:
        return sets, {recording + IN_SITU: refusals[0]}
    about = [
        about_offset(*both).moments() for both in zip(take.segments, take.offsets, strict=True)
    ]
    sets.append(TrainingSet(recording, "in situ", about_zero(about), envelope))
    return sets, {}


@dataclass(frozen=True, slots=True, eq=False)
class FirstValidation:
    """Errors of every training set's matrix on every recording, for one sensor."""

    sets: tuple[TrainingSet, ...]
    refused: dict[str, str]
    """In situ offsets that may not be used, with the reason."""
    estimates: tuple[Estimate, ...]
    """Least squares on each set."""
    recordings: tuple[str, ...]
    """All that were read."""
    judging: tuple[str, ...]
    """Those that tell good sets from bad ones: all but the switching run."""
    absolute: Float[Array, "S R 6"]
    """Mean |e| of each matrix on each recording, aligned there [N, Nm]."""
    rms: Float[Array, "S R 6"]
    """RMS of e [N, Nm]."""
    workbench_absolute: Float[Array, "R 6"]
    workbench_rms: Float[Array, "R 6"]
    held_out: tuple[Scores | None, ...]
    """Of each set on all data sets but its own; None where there is no other."""

    @property
    def dropped(self) -> dict[str, str]:
        """Sets that do no better than the Workbench on the other data sets, with the figure."""
        return {
            one.name: f"{mean:.0f} % of the Workbench's error on the data sets it did not see"
            for one, mean in zip(self.sets, self.elsewhere(), strict=True)
            if mean >= 100.0 * (1.0 - 1e-9)  # no better but for rounding
        }

    def percent(self, norm: Norm = "absolute", group: str = "all") -> Float[Array, "S R"]:
        """Return the errors in percent of the Workbench's, all axes of `group` together."""
        axes = TOGETHER[group]
        if norm == "absolute":
            mine = self.absolute[..., axes].sum(axis=-1)
            whole = self.workbench_absolute[:, axes].sum(axis=-1)
        else:
            mine = np.sqrt((self.rms[..., axes] ** 2).sum(axis=-1))
            whole = np.sqrt((self.workbench_rms[:, axes] ** 2).sum(axis=-1))
        return np.asarray(100.0 * mine / np.maximum(whole, np.finfo(float).tiny))

    def elsewhere(self, norm: Norm = "absolute", group: str = "all") -> Float[Array, "S"]:
        """Return the mean percentage of each set over the data sets it did not train on.

        The switching run is not one of them; NaN where there is no other.
        """
        percent = self.percent(norm, group)
        means = np.full(len(self.sets), np.nan)
        for k, one in enumerate(self.sets):
            others = [self.recordings.index(n) for n in self.judging if n != one.recording]
            if others:
                means[k] = percent[k, others].mean()
        return means

    @property
    def surviving(self) -> tuple[int, ...]:
        """Indices of the sets that go into the second validation."""
        return tuple(k for k, one in enumerate(self.sets) if one.name not in self.dropped)

    def best_per_axis(self) -> list[tuple[str, str, float]]:
        """Return axis, set and percentage of the best set elsewhere; Workbench where none is."""
        best = []
        for axis in AXES:
            mean = self.elsewhere(group=axis)
            found = int(np.nanargmin(mean)) if np.isfinite(mean).any() else -1
            if found < 0 or not mean[found] < 100.0:
                best.append((axis, "Workbench", 100.0))
            else:
                best.append((axis, self.sets[found].name, float(mean[found])))
        return best


def first_validation(
    takes: Mapping[str, SensorTake],
    training: Sequence[str],
    judging: Sequence[str],
    workbench: Workbench,
) -> FirstValidation:
    """Return the matrix of every recording in `training` on every one in `takes`.

    Those in `judging` tell good sets from bad ones. Raises `DataError` where a recording is too
    short to be one.
    """
    sets: list[TrainingSet] = []
    refused: dict[str, str] = {}
    for name in training:
        some, reasons = training_sets(name, takes[name])
        sets += some
        refused |= reasons
    estimates = [one.estimates(workbench, [0.0])[0] for one in sets]
    shape = (len(sets), len(takes), 6)
    absolute, rms = np.zeros(shape), np.zeros(shape)
    workbench_absolute, workbench_rms = np.zeros(shape[1:]), np.zeros(shape[1:])
    pieces: list[list[list[HeldOut]]] = []
    for k, estimate in enumerate(estimates):
        pieces.append([])
        for j, take in enumerate(takes.values()):
            some_read = [
                held_out_samples(s, estimate.coefficients, workbench) for s in take.segments
            ]
            pieces[k].append(some_read)
            error = np.concatenate([piece.in_situ - piece.model for piece in some_read])
            absolute[k, j], rms[k, j] = norms(error)
            error = np.concatenate([piece.workbench - piece.model for piece in some_read])
            workbench_absolute[j], workbench_rms[j] = norms(error)
    return FirstValidation(
        tuple(sets),
        refused,
        tuple(estimates),
        tuple(takes),
        tuple(judging),
        absolute,
        rms,
        workbench_absolute,
        workbench_rms,
        tuple(_held_out_scores(one, pieces[k], list(takes), judging) for k, one in enumerate(sets)),
    )


def norms(error: Float[Array, "N 6"]) -> tuple[Float[Array, "6"], Float[Array, "6"]]:
    """Return the mean and the root mean square of |e| per axis [N, Nm]."""
    return np.abs(error).mean(axis=0), np.sqrt((error**2).mean(axis=0))


def _held_out_scores(
    one: TrainingSet,
    pieces: Sequence[Sequence[HeldOut]],
    recordings: Sequence[str],
    judging: Sequence[str],
) -> Scores | None:
    """Return the scores of one set's matrix on all other data sets together."""
    unseen = [
        piece
        for name, some in zip(recordings, pieces, strict=True)
        if name in judging and name != one.recording
        for piece in some
    ]
    return score("other recordings", unseen, one.envelope) if unseen else None
