"""All sensors of a robot at once, on one page: logs → balances → fit → calibration.

`calibrate_whole_body(job)` is what `ftcal calibrate` runs with `[fit] scope = "whole body"`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ftcal.all_sensors import WholeBody
from ftcal.balanced_take import both
from ftcal.calibration import Calibration, Centre, ChosenBy, Offset, SensorCalibration
from ftcal.config import Job
from ftcal.contact import ContactSchedule
from ftcal.diagnosis import Diagnosis, diagnose
from ftcal.errors import DataError, RobotError
from ftcal.evidence import provenance, sensor_record
from ftcal.judging import SensorResult
from ftcal.model_errors import Tried, calibrate_suspecting
from ftcal.noise import Noise
from ftcal.pairing import FtChannel
from ftcal.pipeline import ft_channel
from ftcal.progress import Progress, Steps, silent
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.segmentation import segmented
from ftcal.takes import Takes
from ftcal.urdf import read_robot
from ftcal.weighing import Weighing, weighed

WORST_BEND = 0.1
"""Entry of E (fraction of full scale) beyond which logs are looked into: mountings bend by 0.03."""

LOOKED_AT = 3
"""Recordings that are searched."""

LOOKED_INTO = 60.0
"""Seconds of every interval that are searched."""


@dataclass(frozen=True, slots=True, eq=False)
class WholeOutcome:
    """What one job gave, all sensors at once."""

    job: Job
    robot: Robot
    recordings: tuple[Recording, ...]
    """Their outlines."""
    findings: tuple[tuple[str, Finding], ...]
    """Recording and finding, in order."""
    fit: WholeBody
    weighings: tuple[Weighing, ...]
    calibration: Calibration
    tried: tuple[Tried, ...] = ()
    """What became of every suspected error of the model; empty where the job suspects nothing."""

    @property
    def improved(self) -> bool:
        """Whether any axis of any sensor beats its Workbench on held-out stretches."""
        return any(verdict.use for sensor in self.fit.sensors for verdict in sensor.verdicts)


def calibrate_whole_body(job: Job, *, progress: Progress = silent) -> WholeOutcome:
    """Return the calibration of all sensors of the job from one fit.

    Raises `FtcalError` with one line that a user can act on; nothing is written.
    """
    robot = read_robot(job.path(job.robot))
    channels = [ft_channel(job, robot, section) for section in job.sensors]
    steps = Steps(progress, 2 * len(job.recordings) + 3)
    recordings = Takes.read(job, robot, channels, steps)
    job, recordings = segmented(job, robot, channels, recordings, steps)
    findings = recordings.findings
    fit, tried = calibrate_suspecting(job, robot, channels, recordings, findings, steps)
    if job.whole_body.diagnose and suspicious(fit):
        worst = worst_left(fit)
        some = [i for i, section in enumerate(job.recordings) if section.label in worst]
        refuse_misread(
            job.model_copy(update={"recordings": tuple(job.recordings[i] for i in some)}),
            robot,
            channels,
            [recordings[i] for i in some],
            [findings[i] for i in some],
        )
    steps.begin("writing")
    flat = recordings.flat
    calibration = Calibration(
        robot=robot.name,
        sensors=[result_record(job, fit, sensor, flat) for sensor in fit.sensors],
        provenance=provenance(job, robot, [recording.digest for recording in recordings.outlines]),
    )
    weighings = tuple(weighings_of(job, robot, channels, fit))
    return WholeOutcome(job, robot, recordings.outlines, flat, fit, weighings, calibration, tried)


def suspicious(fit: WholeBody) -> bool:
    """Return whether the fit looks as if a log were not what the job says.

    Nothing is gained together, or a matrix is bent more than any mounting bends it.
    """
    bent = max(
        float(np.abs(fit.posterior.entries(sensor.sensor.name)).max()) for sensor in fit.sensors
    )
    gained = any(verdict.use for sensor in fit.sensors for verdict in sensor.verdicts)
    return not gained or bent > WORST_BEND


def worst_left(fit: WholeBody) -> list[str]:
    """Return the recordings in which most force is left over, those that are worth a look."""
    left: dict[str, float] = {}
    for one in fit.residuals:
        left[one.recording] = max(left.get(one.recording, 0.0), one.whole_body.force)
    return sorted(left, key=lambda name: -left[name])[:LOOKED_AT]


def refuse_misread(
    job: Job,
    robot: Robot,
    channels: Sequence[FtChannel],
    recordings: Sequence[Recording],
    findings: Sequence[Sequence[Finding]],
) -> None:
    """Raise `DataError` where a recording says that a sensor or the robot is not as described.

    A frame, a sign, swapped axes, another robot (`ftcal.diagnosis`): no regression mends it.
    """
    by_signal = {channel.signal: channel.workbench for channel in channels}
    for section, recording, found in zip(job.recordings, recordings, findings, strict=True):
        wrenches = tuple(
            replace(signal, values=workbench.channels(signal.values) @ workbench.gain.T)
            for signal in recording.channels
            if (workbench := by_signal.get(signal.name)) is not None
        )
        told: Diagnosis | None = None
        with suppress(DataError, RobotError):  # nothing in it moves freely: it says nothing
            told = diagnose(
                replace(recording, channels=wrenches),
                robot,
                beginnings(section.schedule()),
                signals={channel.sensor: channel.signal for channel in channels},
                gravity=section.gravity,
                findings=found,
            )
        if told is not None and told.word in {"wrong reading", "wrong robot"}:
            raise DataError(
                f"recording {recording.name!r}: {told.sentence}; if it is right all the same, say"
                " diagnose = false in [whole_body]"
            )


def beginnings(schedule: ContactSchedule) -> ContactSchedule:
    """Return a schedule of the first minute of every interval: a wrong frame shows early."""
    return ContactSchedule(
        tuple(
            replace(i, stop=min(i.stop, max(i.start, 0.0) + LOOKED_INTO))
            for i in schedule.intervals
        )
    )


def weighings_of(
    job: Job, robot: Robot, channels: Sequence[FtChannel], fit: WholeBody
) -> Iterator[Weighing]:
    """Yield the mass of the robot in every interval of every schedule, before and after."""
    sensors = [channel.sensor for channel in channels]
    for section, take in zip(job.recordings, fit.takes, strict=True):
        for interval in section.schedule().intervals:
            for start, stop in both([(interval.start, interval.stop)], [*take.train, *take.test]):
                parts = []
                for balance in take.balances:
                    first, last = np.searchsorted(balance.time, [start, stop])
                    if last - first > 1:
                        parts.append(balance.rows(slice(int(first), int(last))))
                read = []
                for solution in (fit.workbench, fit.whole_body):
                    laws = take.laws(solution, fit.frames, (start, stop))
                    known = all(name in laws for part in parts for name in part.inputs)
                    read.append(weighed(robot, sensors, interval.touching, parts, laws)
                                if known else None)  # fmt: skip
                old, new = read
                if old is not None and new is not None:
                    times = [t for part in parts for t in (part.time[0], part.time[-1])]
                    yield Weighing(take.recording, float(min(times)), float(max(times)),
                                   interval.touching, robot.mass, old, new)  # fmt: skip


def result_record(
    job: Job, fit: WholeBody, result: SensorResult, findings: Sequence[tuple[str, Finding]]
) -> SensorCalibration:
    """Return the part of `calibration.json` for one sensor."""
    chosen_by: ChosenBy = "evidence" if fit.choice is None else "held-out stretches"
    return sensor_record(
        result.channel,
        result.sensor,
        result.estimate,
        fitted=result.fitted,
        offsets=offset_records(fit, result),
        envelope=result.envelope,
        noise=Noise(result.noise, result.inefficiency),
        form="kappa",
        strength=fit.posterior.kappa,
        chosen_by=chosen_by if job.fit.strength is None else "job",
        verdicts=result.verdicts,
        findings=findings,
    )


def offset_records(fit: WholeBody, result: SensorResult) -> list[Offset]:
    """Return the offset of every segment for the deployed rows, with its standard deviation."""
    name = result.channel.sensor
    unknowns, scale = fit.posterior.unknowns, fit.frames[name].workbench.full_scale
    keep = np.array([not verdict.use for verdict in result.verdicts])
    covariance = np.diag(fit.posterior.error)
    records = []
    for take in fit.takes:
        for segment in take.segments.get(name, ()):
            key = (name, segment)
            if key not in fit.whole_body.offsets:
                continue
            old, new = fit.workbench.offsets[key], fit.whole_body.offsets[key]
            at_mean = np.where(keep, old, new) * scale
            offset = at_mean - result.estimate.coefficients @ take.references[name]
            trained = key in unknowns.places
            # of a recording held out whole the offset is only as good as its residual
            sd = np.sqrt(covariance[unknowns.places[key]]) * scale if trained else result.noise
            r0 = take.references[name]
            of_gain = np.einsum("p,ipq,q->i", r0, result.fitted.covariance, r0)
            start, stop = take.span(segment)
            records.append(
                Offset(
                    recording=take.recording,
                    start=start,
                    stop=stop,
                    offset=offset.tolist(),
                    sd=np.sqrt(sd**2 + of_gain).tolist(),
                    centre=Centre(inputs=r0.tolist(), sd=sd.tolist()),
                )
            )
    return records
