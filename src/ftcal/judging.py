"""The fit of all sensors, judged sensor by sensor on stretches that it never saw.

Matrices that were fitted beside each other stand or fall together; what is known of each is what
its neighbours and the model imply for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.balanced_take import BalancedTake
from ftcal.balances import Balance, Leftover
from ftcal.errors import DataError
from ftcal.law import Law
from ftcal.noise import inefficiency
from ftcal.pairing import FtChannel
from ftcal.ridge import Estimate
from ftcal.robot import FtSensor, Robot
from ftcal.sensor import AXES, Workbench
from ftcal.solution import Solution
from ftcal.terms import Frame, Terms
from ftcal.unknowns import SCALE_SD, Normal, Posterior, Unknowns, offsets_alone, solve
from ftcal.validate import GROUPS, Envelope, HeldOut, Scores, load_envelope, score
from ftcal.verdict import Verdict, weigh
from ftcal.whole_body import stretches_of

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

LEAST_SHARE = 0.5
"""Share of the data in a direction below which the prior has the say there."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorResult:
    """What the fit of all found out about one sensor."""

    sensor: FtSensor
    channel: FtChannel
    fitted: Estimate
    estimate: Estimate
    """What is deployed: all fitted rows, or the Workbench where nothing is gained together."""
    share: Float[Array, "6 P"]
    """Per row of C and direction of the channels (fractions of full scale): how much of the entry
    is the data's, the rest is the prior's."""
    scores: Scores
    """On held-out stretches, against what its neighbours and the model imply."""
    envelope: Envelope
    """Wrenches that it read in training."""
    verdicts: tuple[Verdict, ...]
    noise: Float[Array, "6"]
    """What its judging sub-models leave over on held-out stretches [N, Nm], RMS."""
    inefficiency: Float[Array, "6"]
    """Samples that count as one there."""


@dataclass(frozen=True, slots=True)
class Residual:
    """What is left over of one sub-model in one stretch, as a controller would see it."""

    sub_model: str
    sensors: tuple[str, ...]
    recording: str
    start: float
    stop: float
    held_out: bool
    samples: int
    equations: int
    """Six, or three where the sub-model enters by its mass."""
    workbench: Leftover
    """With the Workbench matrices and the offsets that suit them best."""
    whole_body: Leftover


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """A held-out stretch of a sub-model, read by laws that never saw it."""

    take: BalancedTake
    balance: Balance
    workbench: dict[str, Law]
    whole_body: dict[str, Law]


def predictions(
    takes: Sequence[BalancedTake],
    frames: Mapping[str, Frame],
    terms: Sequence[Terms],
    posterior: Posterior,
    workbench: Solution,
    fitted: Solution,
) -> Iterator[Prediction]:
    """Yield the test windows read by the fit; without any, every stretch read by the others."""
    if any(take.test for take in takes):
        for take in takes:
            for stretch in take.test:
                laws = [take.laws(one, frames, stretch) for one in (workbench, fitted)]
                yield from _within(take, stretch, *laws)
        return
    by_name = {take.recording: take for take in takes}
    for (name, _), held in stretches_of(terms).items():
        rest = [one for one in terms if all(one is not other for other in held)]
        if not rest:
            continue
        unknowns = Unknowns.of(rest, frames)
        normal = Normal.of(rest, unknowns)
        noise = {group: posterior.noise[group] for group in normal.products}
        stretch = (held[0].stretch.start, max(one.stretch.stop for one in held))
        laws = [
            by_name[name].laws(
                Solution.of(unknowns, theta).completed(held, frames, noise), frames, stretch
            )
            for theta in (
                offsets_alone(normal, noise),
                solve(normal, noise, posterior.kappa)[0],
            )
        ]
        yield from _within(by_name[name], stretch, *laws)


def _within(
    take: BalancedTake,
    stretch: tuple[float, float],
    workbench: dict[str, Law],
    whole_body: dict[str, Law],
) -> Iterator[Prediction]:
    for balance in take.balances:
        first, last = np.searchsorted(balance.time, stretch)
        if last - first > 1 and set(balance.inputs) <= workbench.keys() & whole_body.keys():
            part = balance.rows(slice(int(first), int(last)))
            yield Prediction(take, part, workbench, whole_body)


def sensor_result(
    robot: Robot,
    channel: FtChannel,
    frames: Mapping[str, Frame],
    takes: Sequence[BalancedTake],
    predicted: Sequence[Prediction],
    *,
    posterior: Posterior,
    solution: Solution,
    all_of_them: Scores,
) -> SensorResult:
    """Return what is known of one sensor, judged where its neighbours say what it should read.

    The matrices stand or fall together: each was fitted beside the others.
    """
    name, frame = channel.sensor, frames[channel.sensor]
    fitted, share = estimate_of(posterior, name, frame)
    envelope = load_envelope(read_in_training(takes, solution, frames, name))
    pieces = [held_out_piece(one, name) for one in predicted if judges(one.balance, name)]
    if not pieces:
        raise DataError(
            f"sensor {name!r}: no held-out stretch beside it has all six equations; name other"
            " `test` windows"
        )
    scores = with_amplitudes(score("held-out stretches", pieces, envelope), predicted, name)
    loose = loose_scales(posterior, name)
    verdicts = tuple(
        judged(known_of(axis, share[i], loose), scores, all_of_them, frame.workbench, i)
        for i, axis in enumerate(AXES)
    )
    left = np.concatenate([piece.in_situ - piece.model for piece in pieces])
    keep = np.array([not verdict.use for verdict in verdicts])
    gain = np.where(keep[:, None], frame.workbench.gain, fitted.gain)
    k = fitted.temperature_gain
    deployed = Estimate(gain, None if k is None else np.where(keep, 0.0, k), fitted.covariance)
    return SensorResult(
        robot.sensor(name),
        channel,
        fitted,
        deployed,
        share,
        scores,
        envelope,
        verdicts,
        np.sqrt(np.mean(left**2, axis=0)),
        inefficiency([piece.in_situ - piece.model for piece in pieces]),
    )


def estimate_of(
    posterior: Posterior, sensor: str, frame: Frame
) -> tuple[Estimate, Float[Array, "6 P"]]:
    """Return the estimate of one sensor with the covariance of its rows, and the data's share."""
    width = len(frame.basis)
    place = posterior.unknowns.entries[sensor]
    rows, error = (
        np.stack([all_of[place, place].reshape(6, width, 6, width)[i, :, i, :] for i in range(6)])
        for all_of in (posterior.covariance, posterior.error)
    )
    scale = frame.workbench.full_scale
    covariance = scale[:, None, None] ** 2 * (frame.basis.T @ error @ frame.basis)
    found = frame.coefficients(posterior.entries(sensor))
    channels = frame.workbench.gain.shape[1]
    k = found[:, channels] if width > channels else None
    share = 1.0 - np.diagonal(rows, axis1=1, axis2=2) / posterior.kappa**2
    return Estimate(found[:, :channels], k, covariance), np.clip(share, 0.0, 1.0)


def loose_scales(posterior: Posterior, sensor: str) -> list[str]:
    """Return what of a sensor's scale rests on the prior: balances alone do not tell it.

    Several sensors may know each other's scale and not the one they share.
    """
    before = 1.0 / (1.0 / posterior.kappa**2 + 1.0 / SCALE_SD**2)
    found = []
    for kind in ("forces", "torques"):
        scales = {w: along for w, along in posterior.unknowns.scales() if w.startswith(kind)}
        own = scales.get(f"{kind} of {sensor}")
        common = (
            sum(scales.values(), np.zeros(posterior.unknowns.count)) / max(len(scales), 1) ** 0.5
        )
        for words, along in (
            (f"the scale of its {kind}", own),
            (f"the common scale of all {kind}", common),
        ):
            if (
                along is not None
                and float(along @ posterior.covariance @ along) > (1.0 - LEAST_SHARE) * before
            ):
                found.append(words)
                break
    return found


def known_of(axis: str, share: Float[Array, "P"], loose: Sequence[str]) -> Verdict:
    """Return what the data could say of a row: the directions in which the prior has the say."""
    names: tuple[str, ...] = (*AXES, "temperature")
    if len(share) not in (6, 7):
        names = tuple(f"channel {i + 1}" for i in range(len(share)))
    weak = [n for n, s in zip(names, share, strict=False) if s < LEAST_SHARE]
    kind = "forces" if axis.startswith("f") else "torques"
    if not weak and not any(words.endswith(kind) for words in loose):
        return Verdict(axis, "ACCEPT", "the data speak in every direction")
    reasons = [f"prior outweighs the data along {', '.join(weak)}"] if weak else []
    reasons += [f"{words} rests on the Workbench" for words in loose if words.endswith(kind)]
    return Verdict(axis, "PARTIAL", "; ".join(reasons))


def judged(
    known: Verdict, scores: Scores, all_of_them: Scores, workbench: Workbench, axis: int
) -> Verdict:
    """Return the verdict on one axis; all are refused where the sub-models together gain nothing.

    An axis that is not shown to be better by itself is deployed with the others, as PARTIAL: one
    row put back to the Workbench would no longer suit its neighbours.
    """
    whole = all_of_them.by_name["force"]
    if not whole.interval[1] < 100.0:
        low, high = whole.interval
        reason = (
            f"all sub-models together leave {whole.percent:.0f} % of the Workbench's force on"
            f" held-out stretches [{low:.0f}, {high:.0f}]; not shown to be better"
        )
        return Verdict(known.axis, "REFUSE", reason)
    found = scores.by_name[known.axis]
    verdict = weigh(known, found, scores.kind, float(workbench.full_scale[axis]), True)
    if verdict.use:
        return verdict
    return Verdict(
        known.axis, "PARTIAL", f"{verdict.reason} by itself; used with the others", verdict.figure
    )


def with_amplitudes(scores: Scores, predicted: Sequence[Prediction], sensor: str) -> Scores:
    """Return the scores with the amplitude of the sensor's own reading over its Workbench's.

    The pieces of `held_out_piece` carry the errors of the neighbours too, and so no amplitude.
    """
    moved = np.zeros((2, 6))
    for one in predicted:
        if judges(one.balance, sensor):
            for which, laws in enumerate((one.whole_body, one.workbench)):
                read = laws[sensor].read(one.balance.inputs[sensor])
                moved[which] += ((read - read.mean(axis=0)) ** 2).sum(axis=0)
    by_name = {}
    for name, columns in GROUPS.items():
        new, old = (float(one[columns].sum()) for one in moved)
        ratio = (new / old) ** 0.5 if old > 0 else float("inf")
        by_name[name] = replace(scores.by_name[name], amplitude=ratio)
    return replace(scores, by_name=by_name)


def together(one: Prediction) -> HeldOut:
    """Return a stretch as its sub-model sees it, in its own frame, about the mean."""
    time = one.balance.time
    left = []
    for laws in (one.workbench, one.whole_body):
        readings = {name: laws[name].read(inputs) for name, inputs in one.balance.inputs.items()}
        error = one.balance.residual(readings)
        left.append(one.balance.required + error - error.mean(axis=0))
    return HeldOut.of_all(
        one.take.recording, float(time[0]), float(time[-1]), time, one.balance.required, *left
    )


def judges(balance: Balance, sensor: str) -> bool:
    """Return whether a sub-model says all six components that a sensor should read."""
    return sensor in balance.inputs and not balance.by_mass


def held_out_piece(one: Prediction, sensor: str) -> HeldOut:
    """Return a stretch as the sensor and its neighbours read it, each aligned to what is implied.

    What is implied depends on the matrices of the neighbours: the errors are those of both.
    """
    time = one.balance.time
    errors = []
    for laws in (one.whole_body, one.workbench):
        readings = {name: laws[name].read(inputs) for name, inputs in one.balance.inputs.items()}
        implied = one.balance.implied(sensor, readings)
        error = readings[sensor] - implied
        errors.append((implied, error - error.mean(axis=0)))
    (model, new), (_, old) = errors
    return HeldOut.of_all(
        one.take.recording, float(time[0]), float(time[-1]), time, model, model + old, model + new
    )


def read_in_training(
    takes: Sequence[BalancedTake], solution: Solution, frames: Mapping[str, Frame], sensor: str
) -> Float[Array, "N 6"]:
    """Return what a sensor reads with its new matrix in all stretches trained on [N, Nm]."""
    parts = [np.zeros((0, 6))]
    for take in takes:
        for stretch in take.train:
            laws = take.laws(solution, frames, stretch)
            for balance in take.balances:
                if sensor in balance.inputs and sensor in laws:
                    first, last = np.searchsorted(balance.time, stretch)
                    parts.append(laws[sensor].read(balance.inputs[sensor][first:last]))
                    break
    return np.concatenate(parts)


def residuals(
    takes: Sequence[BalancedTake],
    frames: Mapping[str, Frame],
    workbench: Solution,
    fitted: Solution,
) -> Iterator[Residual]:
    """Yield what is left over of every sub-model in every stretch, before and after."""
    for take in takes:
        for held, stretches in ((False, take.train), (True, take.test)):
            for stretch in stretches:
                old, new = (take.laws(one, frames, stretch) for one in (workbench, fitted))
                for one in _within(take, stretch, old, new):
                    left = [
                        Leftover.of(one.balance.residual(
                            {n: laws[n].read(x) for n, x in one.balance.inputs.items()}
                        ))
                        for laws in (old, new)
                    ]  # fmt: skip
                    yield Residual(
                        one.balance.sub_model,
                        tuple(one.balance.inputs),
                        take.recording,
                        float(one.balance.time[0]),
                        float(one.balance.time[-1]),
                        held,
                        len(one.balance.time),
                        one.balance.equations,
                        *left,
                    )
