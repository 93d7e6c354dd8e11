"""One sensor, start to end: pair, fit, hold out, judge, and put refused axes back.

Each step is a room of its own (`pairing`, `fit`, `validate`, `verdict`); here they meet.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.config import Job, RecordingSection
from ftcal.errors import DataError
from ftcal.fit import Fit, FitOptions, fit
from ftcal.folds import Cell, Pool, about_zero, blocked_folds, by_segment, cells
from ftcal.moments import within
from ftcal.offset import InSituOffset, in_situ_offset
from ftcal.pairing import Attitude, FtChannel, Paired, Windows, apart, pair
from ftcal.progress import Steps
from ftcal.recording import Finding, Recording
from ftcal.ridge import Estimate
from ftcal.robot import FtSensor, Robot
from ftcal.samples import Samples
from ftcal.sensor import Workbench
from ftcal.takes import PairedTake
from ftcal.validate import Envelope, HeldOut, Scores, held_out, load_envelope, score
from ftcal.verdict import Verdict, judge

if TYPE_CHECKING:
    from jaxtyping import Bool
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True)
class SensorOutcome:
    """Everything found out about one sensor."""

    sensor: FtSensor
    channel: FtChannel
    paired: tuple[Paired, ...]
    """One per recording that carries the sensor, in the order of the job."""
    training: tuple[Samples, ...]
    """Offset segments trained on."""
    test: tuple[Samples, ...]
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
    name = next(s.name for s in job.sensors if robot.sensor(s.name).name == channel.sensor)
    paired: list[Paired] = []
    training: list[Samples] = []
    fitted: list[Samples] = []
    test: list[Samples] = []
    offsets: list[InSituOffset] = []
    for given, take in zip(job.recordings, takes, strict=True):
        section = take.section(given)
        both = settled(section, name, counted_from(reference, take.sensors[channel.sensor]))
        train, held = split(section, name, both, job.signals.smoothing)
        if in_situ:
            taken = [raw_offset(both, segment, channel) for segment in train]
            fitted += [about_offset(*pair) for pair in zip(train, taken, strict=True)]
            offsets += taken
        else:
            fitted += train
        paired.append(both)
        training += train
        test += held
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
    tiles = cells(fitted, job.signals.smoothing)
    options = job.fit.options()
    steps.begin(f"fitting {channel.sensor}")
    result = fit(tiles, channel.workbench, options, pool)
    trained = load_envelope(np.concatenate([segment.wrench for segment in training]))
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
    return float(np.concatenate([take.temperatures[channel.sensor] for take in takes]).mean())


def counted_from(reference: float, both: Paired) -> Paired:
    """Return the samples with their temperature counted from `reference` [degree Celsius]."""
    warm = both.samples.temperature
    if warm is None:
        return both
    return replace(both, samples=replace(both.samples, temperature=warm - reference))


def settled(section: RecordingSection, sensor: str, both: Paired) -> Paired:
    """Return the samples without those that the job leaves out of a sensor's training."""
    if not section.leave_out.get(sensor):
        return both
    return chosen(both, section.trained_on(sensor, both.samples.time))


def chosen(both: Paired, keep: Bool[Array, "N"]) -> Paired:
    """Return some of the samples."""
    samples, attitude = both.samples, both.attitude
    warm = samples.temperature
    return replace(
        both,
        samples=replace(
            samples,
            time=samples.time[keep],
            channels=samples.channels[keep],
            wrench=samples.wrench[keep],
            temperature=None if warm is None else warm[keep],
        ),
        attitude=attitude and Attitude(attitude.gravity[keep], attitude.centre_of_mass[keep]),
    )


def split(
    section: RecordingSection, sensor: str, both: Paired, smoothing: float
) -> tuple[list[Samples], list[Samples]]:
    """Return the training and the held-out segments of one recording, cut where offsets step.

    Held-out windows give up what lies within one smoothing window of a training window.
    """
    everything: Windows = [(both.samples.start, np.nextafter(both.samples.stop, np.inf))]
    train: Windows = section.train if section.train is not None else everything
    if section.train is None and section.test:
        train = []
    held = apart(section.test, train, smoothing)
    return both.windows(cut(section, sensor, train)), both.windows(cut(section, sensor, held))


def cut(section: RecordingSection, sensor: str, windows: Windows) -> list[tuple[float, float]]:
    """Return windows cut where the offset of a sensor steps."""
    found: list[tuple[float, float]] = []
    for start, stop in windows:
        inside = [t for t in section.known_breaks.get(sensor, ()) if start < t < stop]
        found += itertools.pairwise([start, *inside, stop])
    return found


def raw_offset(both: Paired, segment: Samples, channel: FtChannel) -> InSituOffset:
    """Return the in situ offset of a segment, which may refuse to be used."""
    if both.attitude is None:
        raise ValueError("pair the recording with its attitude")
    first, last = np.searchsorted(both.samples.time, [segment.time[0], segment.time[-1]])
    rows = slice(int(first), int(last) + 1)
    return in_situ_offset(
        segment.channels,
        both.attitude.gravity[rows],
        both.attitude.centre_of_mass[rows],
        channel.workbench.scaling,
    )


def about_offset(segment: Samples, offset: InSituOffset) -> Samples:
    """Return a segment with its in situ offset taken off its channels.

    Raises `DataError` with the figure where the assumption of a constant centre of mass fails.
    """
    if offset.refusal:
        raise DataError(
            f'in situ offset of {segment.label} refused: {offset.refusal}; use offset = "centred"'
        )
    return replace(segment, channels=segment.channels - offset.offset)


def validate_by_folds(
    tiles: Sequence[Cell], workbench: Workbench, options: FitOptions, pool: Pool, steps: Steps
) -> Scores | None:
    """Return the scores of blocked K-fold: each block read by a fit that never saw it.

    The prior's strength is chosen anew inside every fold (nested). None where the data are too
    short for the folds.
    """
    try:
        folds = blocked_folds(tiles, options.folds)
    except DataError:
        return None
    pieces: list[HeldOut] = []
    for fold in folds:
        steps.begin("validating on blocks it never saw")
        try:
            estimate = fit(fold.train, workbench, options, pool).estimate
        except DataError:
            return None
        for group in by_segment(fold.held):
            merged = merge([cell.samples for cell in group])
            pieces.append(held_out(merged, estimate.coefficients, workbench))
    trained = load_envelope(np.concatenate([cell.samples.wrench for cell in tiles]))
    return score(f"{options.folds}-fold", pieces, trained)


def merge(parts: Sequence[Samples]) -> Samples:
    """Return neighbouring pieces of one segment as one."""
    first, last = parts[0], parts[-1]
    warm = [part.temperature for part in parts if part.temperature is not None]
    return Samples(
        first.recording,
        first.start,
        last.stop,
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.channels for part in parts]),
        np.concatenate([part.wrench for part in parts]),
        np.concatenate(warm) if warm else None,
    )


def deployed(estimate: Estimate, workbench: Workbench, verdicts: Sequence[Verdict]) -> Estimate:
    """Return the estimate with every refused row put back to the Workbench's."""
    use = np.array([verdict.use for verdict in verdicts])
    k = estimate.temperature_gain
    return Estimate(
        np.where(use[:, None], estimate.gain, workbench.gain),
        None if k is None else np.where(use, k, 0.0),
        np.where(use[:, None, None], estimate.covariance, 0.0),
    )
