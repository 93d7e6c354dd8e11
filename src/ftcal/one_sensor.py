"""One sensor, start to end: pair, fit, hold out, judge, and put refused axes back.

Each step is a room of its own (`pairing`, `fit`, `validate`, `verdict`); here they meet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ftcal.config import Job, RecordingSection
from ftcal.cross_validation import validate_by_folds
from ftcal.errors import DataError
from ftcal.fit import Fit, fit
from ftcal.folds import Pool, about_zero, cells
from ftcal.gathering import PairedSensor
from ftcal.moments import within
from ftcal.offset import InSituOffset, in_situ_offset
from ftcal.paired import Paired, pair
from ftcal.pairing import FtChannel
from ftcal.progress import Steps
from ftcal.recording import Finding, Recording
from ftcal.ridge import Estimate
from ftcal.robot import FtSensor, Robot
from ftcal.samples import Samples
from ftcal.segments import Segment, enveloping
from ftcal.sensor import Workbench
from ftcal.takes import PairedTake
from ftcal.validate import Envelope, Scores, held_out, named, score
from ftcal.verdict import Verdict, judge

S = TypeVar("S", Samples, Segment)


@dataclass(frozen=True, slots=True)
class SensorOutcome:
    """Everything found out about one sensor."""

    sensor: FtSensor
    channel: FtChannel
    paired: tuple[PairedSensor, ...]
    """One per recording that carries the sensor, in the order of the job."""
    training: tuple[Segment, ...]
    """Offset segments trained on."""
    test: tuple[Segment, ...]
    """Offset segments held out by the job."""
    fit: Fit
    in_situ: tuple[InSituOffset, ...]
    """Raw offset of every training segment, with `offset = "in situ"`."""
    envelope: Envelope
    """Loads that training saw."""
    hold_out: Scores | None
    """Scores on the job's test windows; None where it names none."""
    k_fold: Scores | None
    """Scores of blocked K-fold over the training data; None where there is too little of it."""
    reference_temperature: float
    """T_ref [degree Celsius] of the temperature term."""
    verdicts: tuple[Verdict, ...]
    estimate: Estimate
    """The fitted estimate with refused rows put back to the Workbench: what is deployed."""
    findings: tuple[tuple[str, Finding], ...]
    """Recording and finding, for every finding of the sensor's own signals."""

    @property
    def scores(self) -> Scores | None:
        """What the verdicts rest on: the hold-out where there is one."""
        return self.hold_out or self.k_fold


def calibrate_sensor(
    job: Job,
    robot: Robot,
    channel: FtChannel,
    takes: Sequence[PairedTake],
    steps: Steps,
) -> SensorOutcome:
    """Return everything about one sensor from the recordings of a job, in its order.

    Raises `DataError` where no training (or no test) window holds a usable sample, or where the in
    situ offset is asked for and its assumption fails.
    """
    in_situ = job.fit.offset == "in situ"
    reference = reference_temperature(channel, takes)
    paired = [take.sensors[channel.sensor].moved(temperature=-reference) for take in takes]
    training = [segment for one in paired for segment in one.training]
    test = [segment for one in paired for segment in one.test]
    offsets: list[InSituOffset] = []
    fitted = training
    if in_situ:
        offsets = [raw_offset(segment, channel) for segment in training]
        fitted = [about_offset(*each) for each in zip(training, offsets, strict=True)]
    if not training:
        raise DataError(
            f"sensor {channel.sensor!r}: no usable sample in any training window; widen `train`"
        )
    if not test and any(section.test for section in job.recordings):
        raise DataError(
            f"sensor {channel.sensor!r}: no usable sample in any test window that is"
            f" {job.signals.smoothing:g} s away from training; widen `test`"
        )
    pool: Pool = about_zero if in_situ else within
    tiles = cells(fitted)
    options = job.fit.options()
    steps.begin(f"fitting {channel.sensor}")
    result = fit(tiles, channel.workbench, options, pool)
    trained = named(enveloping(training))
    pieces = [held_out(s, result.estimate.coefficients, channel.workbench) for s in test]
    hold_out = score("hold-out", pieces, trained) if pieces else None
    k_fold = validate_by_folds(tiles, channel.workbench, options, pool, steps)
    verdicts = judge(result.excitation, hold_out or k_fold, channel.workbench.full_scale)
    mine = {channel.signal, channel.temperature}
    return SensorOutcome(
        robot.sensor(channel.sensor),
        channel,
        tuple(paired),
        tuple(training),
        tuple(test),
        result,
        tuple(offsets),
        trained,
        hold_out,
        k_fold,
        reference,
        verdicts,
        deployed(result.estimate, channel.workbench, verdicts),
        tuple(
            (take.outline.name, finding)
            for take in takes
            for finding in take.findings
            if finding.signal in mine
        ),
    )


def pair_recording(
    job: Job,
    robot: Robot,
    channel: FtChannel,
    section: RecordingSection,
    recording: Recording,
    findings: Sequence[Finding],
    reference_temperature: float,
    *,
    with_attitude: bool = False,
) -> Paired:
    """Return the usable samples of one sensor in one recording of the job."""
    return pair(
        recording,
        robot,
        channel,
        section.schedule(),
        gravity=section.gravity,
        imu=section.imu,
        findings=findings,
        reference_temperature=reference_temperature,
        options=job.signals.options(),
        with_attitude=with_attitude,
    )


def reference_temperature(channel: FtChannel, takes: Sequence[PairedTake]) -> float:
    """Return T_ref [degree Celsius]: the mean over all recordings, zero where none is logged."""
    if channel.temperature is None:
        return 0.0
    readings = [take.warmth[channel.temperature] for take in takes]
    return sum(n * mean for n, mean in readings) / sum(n for n, _ in readings)


def raw_offset(segment: Segment, channel: FtChannel) -> InSituOffset:
    """Return the in situ offset of a segment, which may refuse to be used."""
    if segment.attitude is None:
        raise ValueError("pair the recording with its attitude")
    return in_situ_offset(segment.attitude, channel.workbench.scaling)


def about_offset(segment: S, offset: InSituOffset) -> S:
    """Return a segment with its in situ offset taken off its channels.

    Raises `DataError` with the figure where the assumption of a constant centre of mass fails.
    """
    if offset.refusal:
        raise DataError(
            f'in situ offset of {segment.label} refused: {offset.refusal}; use offset = "centred"'
        )
    return segment.moved(-offset.offset)


def deployed(estimate: Estimate, workbench: Workbench, verdicts: Sequence[Verdict]) -> Estimate:
    """Return the estimate with every refused row put back to the Workbench's."""
    use = np.array([verdict.use for verdict in verdicts])
    k = estimate.temperature_gain
    return Estimate(
        np.where(use[:, None], estimate.gain, workbench.gain),
        None if k is None else np.where(use, k, 0.0),
        np.where(use[:, None, None], estimate.covariance, 0.0),
    )
