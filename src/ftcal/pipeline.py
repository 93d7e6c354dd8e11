"""The whole method on one page: logs → samples → fit → validation → calibration.

`calibrate(job)` is what `ftcal calibrate` runs; `report.write_outcome` puts its outcome on disk.
Recordings are paired one by one, wherever there are processors (`ftcal.compute`); what is fitted to
is the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from ftcal.archive import Shelf
from ftcal.calibration import Calibration
from ftcal.compute import Executor, Here
from ftcal.config import Job, SensorSection
from ftcal.errors import DataError, RobotError, SensorError
from ftcal.evidence import provenance, sensor_calibration
from ftcal.one_sensor import SensorOutcome, calibrate_sensor
from ftcal.paired_takes import paired_takes
from ftcal.pairing import FtChannel, one_sided
from ftcal.progress import Progress, Steps, silent
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.takes import Glimpses, Logs, PairedTake, in_sensor_frames
from ftcal.urdf import read_robot
from ftcal.validate import Scores, held_out, score
from ftcal.workbench import read_workbench


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one job gave."""

    job: Job
    robot: Robot
    recordings: tuple[Recording, ...]
    """With the first and last sample of every signal only."""
    logs: Glimpses
    """The recordings, read again where they are looked at."""
    findings: tuple[tuple[str, Finding], ...]
    """Recording and finding, in order."""
    sensors: tuple[SensorOutcome, ...]
    calibration: Calibration

    @property
    def improved(self) -> bool:
        """Whether any axis of any sensor beats its Workbench on held-out samples."""
        return any(verdict.use for sensor in self.sensors for verdict in sensor.verdicts)


def calibrate(
    job: Job,
    *,
    where: Executor | None = None,
    shelf: Shelf | None = None,
    progress: Progress = silent,
) -> Outcome:
    """Return the calibration of every sensor of the job.

    `where` pairs the recordings (default: here, one by one); on the `shelf` they are kept and found
    again. Raises `FtcalError` with one line that a user can act on.
    """
    robot, channels = described(job)
    steps = Steps(progress, 1 + len(job.recordings) + len(channels) * (1 + job.fit.folds))
    takes = paired_takes(job, robot, channels, where=where or Here(), shelf=shelf, steps=steps)
    return fitted(job, robot, channels, takes, steps)


def described(job: Job) -> tuple[Robot, list[FtChannel]]:
    """Return the robot and the sensors of a job.

    Raises `FtcalError` where they, or the contacts of a recording, make no sense.
    """
    robot = read_robot(job.path(job.robot))
    channels = [ft_channel(job, robot, section) for section in job.sensors]
    check_contacts(job, robot, channels)
    return robot, channels


def fitted(
    job: Job,
    robot: Robot,
    channels: Sequence[FtChannel],
    takes: Sequence[PairedTake],
    steps: Steps,
) -> Outcome:
    """Return the calibration of every sensor from the paired recordings of a job, in its order.

    Raises `DataError` where a sensor has nothing to train on, or nothing to be tested on.
    """
    outcomes = [calibrate_sensor(job, robot, channel, takes, steps) for channel in channels]
    steps.begin("writing")
    calibration = Calibration(
        robot=robot.name,
        sensors=[sensor_calibration(job, outcome) for outcome in outcomes],
        provenance=provenance(job, robot, [take.outline.digest for take in takes]),
    )
    together = list(zip(job.recordings, takes, strict=True))
    return Outcome(
        job.model_copy(update={"recordings": tuple(take.section(one) for one, take in together)}),
        robot,
        # on a shelf, or on another machine, the log had another path
        tuple(
            replace(take.outline, source=str(job.path(section.log))) for section, take in together
        ),
        Logs(job, partial(in_sensor_frames, job=job, robot=robot, channels=channels)),
        tuple((take.outline.name, finding) for take in takes for finding in take.findings),
        tuple(outcomes),
        calibration,
    )


def ft_channel(job: Job, robot: Robot, section: SensorSection) -> FtChannel:
    """Return a sensor of the job with its Workbench; raises `RobotError` or `SensorError`."""
    workbench = read_workbench(
        None if section.workbench is None else job.path(section.workbench),
        full_scale=section.full_scale,
        logged=section.logged,
    )
    name = robot.sensor(section.name).name
    check_wrench_frame(robot, section)
    return FtChannel(name, section.signal, workbench, section.temperature, section.wrench_frame)


def check_wrench_frame(robot: Robot, section: SensorSection) -> None:
    """Raise `RobotError` where the log of a sensor is in the axes of a link that is unknown."""
    try:
        if section.wrench_frame is not None:
            robot.link(section.wrench_frame)
    except RobotError as error:
        raise RobotError(f"sensor {section.name!r}: wrench_frame: {error}") from error


def check_contacts(job: Job, robot: Robot, channels: Sequence[FtChannel]) -> None:
    """Raise `RobotError` before a log is read.

    Where a contact is unknown, both halves of a sensor touch throughout, or its free half has no
    mass.
    """
    for section in job.recordings:
        for channel in channels:
            try:
                one_sided(robot, channel.sensor, section.schedule())
            except RobotError as error:
                raise RobotError(f"recording {section.label!r}: {error}") from error


def score_calibration(
    calibration: Calibration, job: Job, *, progress: Progress = silent
) -> dict[str, Scores]:
    """Return how a finished calibration does on the recordings of a job, by sensor.

    Test windows count; a recording without any counts whole. Sensors of the job that were not
    calibrated are a `SensorError`.
    """
    robot = read_robot(job.path(job.robot))
    channels = [calibrated_channel(calibration, robot, section) for section in job.sensors]
    check_contacts(job, robot, channels)
    steps = Steps(progress, 1 + len(job.recordings))
    # nothing is trained on: what is judged are the windows held out, or all there is
    judged = [s.model_copy(update={"train": s.test or None, "test": ()}) for s in job.recordings]
    whole = job.model_copy(update={"recordings": tuple(judged)})
    takes = paired_takes(whole, robot, channels, where=Here(), shelf=None, steps=steps)
    scores = {}
    for channel in channels:
        known = calibration.sensor(channel.sensor)
        pieces = [
            held_out(segment, known.coefficients, channel.workbench)
            for take in takes
            for segment in take.sensors[channel.sensor]
            .moved(temperature=-known.reference_temperature)
            .training
        ]
        if not pieces:
            raise DataError(f"sensor {channel.sensor!r}: no usable sample in any test window")
        scores[channel.sensor] = score("validation", pieces, known.envelope)
    return scores


def calibrated_channel(calibration: Calibration, robot: Robot, section: SensorSection) -> FtChannel:
    """Return a sensor of the job as its calibration knows it.

    Raises `SensorError` where it was not calibrated, or with a temperature that the job lacks.
    """
    known = calibration.sensor(robot.sensor(section.name).name)
    check_wrench_frame(robot, section)
    if known.temperature_gain is not None and section.temperature is None:
        raise SensorError(
            f"sensor {known.sensor!r}: its calibration has a temperature term, the job names no"
            f' thermometer; add temperature = "{known.temperature_signal}"'
        )
    return FtChannel(
        known.sensor, section.signal, known.workbench(), section.temperature, section.wrench_frame
    )
