"""A study → `calibration.json`: the mixed matrix of every sensor, and how far to trust it.

A row was chosen because it leaves least where nothing touches. Whether it may be used is asked of
pieces of the switching run that did not choose it, and of what its training data could say at all:
a row that rests on directions which nothing excited keeps the Workbench.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ftcal.calibration import Calibration, Offset, SensorCalibration
from ftcal.evidence import centre, provenance, sensor_record
from ftcal.excitation import excitation
from ftcal.first_validation import TrainingSet
from ftcal.noise import Noise, inefficiency
from ftcal.preparation import Prepared
from ftcal.ridge import Estimate, ScaledProblem
from ftcal.samples import Samples
from ftcal.second_validation import MIXED, WORKBENCH, Candidate, SecondValidation
from ftcal.sensor import AXES, UNITS
from ftcal.study import SensorStudy, StudyOutcome
from ftcal.validate import Envelope, held_out_samples
from ftcal.verdict import Verdict, identifiable

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


def study_calibration(outcome: StudyOutcome) -> Calibration | None:
    """Return the mixed matrices of a study to deploy; None where it had no second validation.

    An axis that is no better on pieces that did not choose it keeps its Workbench row.
    """
    sensors = [
        _sensor(study, study.second, outcome.recordings)
        for study in outcome.sensors
        if study.second is not None
    ]
    if not sensors:
        return None
    digests = [recording.digest for recording in outcome.recordings]
    return Calibration(
        robot=outcome.robot.name,
        sensors=sensors,
        provenance=provenance(outcome.job, outcome.robot, digests),
    )


def _sensor(
    study: SensorStudy, second: SecondValidation, recordings: Sequence[Prepared]
) -> SensorCalibration:
    """Return the part of one sensor."""
    channel, ft = study.channel, study.sensor
    workbench = channel.workbench
    segments = [s for r in recordings for s in r.sensors[channel.sensor].segments]
    chosen = [second.candidates[k] for k in second.best_per_axis]
    noise = residual_noise(second.mixed.coefficients, segments, study)
    verdicts = mixed_verdicts(study, second, recordings)
    mixed, width = second.mixed.coefficients, second.mixed.coefficients.shape[1]
    covariance = np.zeros((6, width, width))
    for axis, one in enumerate(chosen):
        size = one.covariance.shape[1]
        covariance[axis, :size, :size] = one.covariance[axis]
    keep = np.array([not verdict.use for verdict in verdicts])
    deployed = mixed.copy()
    deployed[keep] = 0.0
    deployed[keep, : workbench.gain.shape[1]] = workbench.gain[keep]
    k = workbench.gain.shape[1]
    estimate = Estimate(deployed[:, :k], deployed[:, k] if width > k else None, covariance)
    offsets = []
    for segment in segments:
        moments = segment.moments()
        offsets.append(
            Offset(
                recording=segment.recording,
                start=segment.start,
                stop=segment.stop,
                offset=estimate.offset(moments).tolist(),
                sd=estimate.offset_error(moments, noise).tolist(),
                centre=centre(moments, estimate, noise),
            )
        )
    trained = [one for one in study.first.sets if one.name in {c.training for c in chosen}]
    return sensor_record(
        channel,
        ft,
        estimate,
        fitted=Estimate(mixed[:, :k], None, covariance),
        offsets=offsets,
        envelope=widest([one.envelope for one in trained or study.first.sets]),
        noise=noise,
        form="lambda",
        strength=[one.penalty for one in chosen],
        chosen_by="second validation",
        verdicts=verdicts,
        findings=((r.name, finding) for r in recordings for finding in r.findings),
    )


def mixed_verdicts(
    study: SensorStudy, second: SecondValidation, recordings: Sequence[Prepared]
) -> tuple[Verdict, ...]:
    """Return the verdict on every row of the mixed matrix."""
    by_name = {one.name: one for one in study.first.sets}
    verdicts = []
    for axis, (name, unit) in enumerate(zip(AXES, UNITS, strict=True)):
        chosen = second.candidates[second.best_per_axis[axis]]
        where = f"in {second.sub_chain}"
        own = second.left[0].axes[axis]
        if chosen.training == WORKBENCH:
            reason = f"the Workbench leaves least {where}: {own:.3g} {unit}"
            verdicts.append(Verdict(name, "REFUSE", reason))
            continue
        if not second.unseen:
            reason = f"not validated: the switching run is too short to hold any of it out {where}"
            verdicts.append(Verdict(name, "REFUSE", reason))
            continue
        mine, workbench = (second.unseen[m].axes[axis] for m in (MIXED, WORKBENCH))
        figure = (
            f"{mine:.3g} {unit} left of the Workbench's {workbench:.3g} {unit} {where}, on pieces"
            " that did not choose it"
        )
        known = _identifiable(by_name[chosen.training], chosen, study, recordings, axis)
        if not mine < workbench:
            verdicts.append(Verdict(name, "REFUSE", f"{figure}; no better than the Workbench"))
        elif known.word == "ACCEPT":
            verdicts.append(Verdict(name, "ACCEPT", figure, figure))
        else:
            # no penalty of the paper's grid holds what is not excited: noise fills it
            verdicts.append(Verdict(name, "REFUSE", f"{figure}; {known.reason}", figure))
    return tuple(verdicts)


def _identifiable(
    one: TrainingSet,
    chosen: Candidate,
    study: SensorStudy,
    recordings: Sequence[Prepared],
    axis: int,
) -> Verdict:
    """Return what a training set could say of an axis at all, by the noise that it left itself."""
    own = [
        segment
        for recording in recordings
        if recording.name == one.recording
        for segment in recording.sensors[study.channel.sensor].segments
    ]
    noise = residual_noise(chosen.law.coefficients, own, study)
    problem = ScaledProblem.of(one.moments, study.channel.workbench)
    return identifiable(excitation(problem, noise), axis)


def residual_noise(
    coefficients: Float[Array, "6 P"], segments: Sequence[Samples], study: SensorStudy
) -> Noise:
    """Return what a matrix leaves over on all recordings, aligned on each: size and memory."""
    read = [held_out_samples(s, coefficients, study.channel.workbench) for s in segments]
    left = [piece.in_situ - piece.model for piece in read]
    sd = np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0))
    least = 1e-12 * study.channel.workbench.full_scale
    return Noise(np.maximum(sd, least), inefficiency(left))


def widest(envelopes: Sequence[Envelope]) -> Envelope:
    """Return the loads that any of the training sets saw."""
    return {
        name: (min(e[name][0] for e in envelopes), max(e[name][1] for e in envelopes))
        for name in envelopes[0]
    }
