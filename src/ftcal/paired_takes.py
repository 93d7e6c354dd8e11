"""Every recording of a job beside its model, one by one, wherever there is a processor for it.

What a recording says of single sensors depends on no other recording: it can be read, examined,
searched for steps of offsets and paired on any machine that sees its log. On a shelf the result is
found again as long as nothing that made it has changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

from ftcal.archive import Shelf
from ftcal.compute import Executor, Failure
from ftcal.config import Job, RecordingSection
from ftcal.errors import DataError, FtcalError, LogError
from ftcal.gathering import Gathering, PairedSensor
from ftcal.logs.pieces import Pieces, WholeLog
from ftcal.moments import Moments, Stacked
from ftcal.overview import Overview, overview
from ftcal.pairing import FtChannel
from ftcal.piece_pairing import Pairing
from ftcal.preparation import ingredients, shelved
from ftcal.progress import Steps, silent
from ftcal.recording import Finding, Recording, Signal
from ftcal.robot import Robot
from ftcal.samples import Samples
from ftcal.segmentation import segmented
from ftcal.segments import Segment
from ftcal.takes import PairedTake, Takes, in_sensor_frames, opened, read_log
from ftcal.urdf import read_robot

PIECE_ROWS = 8192
"""Samples of a signal that are paired at a time: what six sensors make of them stays in cache."""

MOST_SAMPLES, LEAST_SAMPLES = 1 << 17, 1 << 11
"""Samples that are kept for eyes, of each sensor in all recordings; and of one at least."""

KINDS = {kind.__name__: kind for kind in (PairedTake, Recording, Signal, Finding, PairedSensor,
                                          Samples, Segment, Stacked, Moments)}  # fmt: skip
"""What a shelf of paired recordings may hold."""


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    """One recording that is to be paired; small, for it travels."""

    job: Job
    """With this recording alone."""
    robot: str
    """Digest of the robot description that the job names."""
    channels: tuple[FtChannel, ...]

    @property
    def section(self) -> RecordingSection:
        """What the job says of the recording."""
        return self.job.recordings[0]

    def place(self, shelf: Shelf) -> Path:
        """Return where on a shelf the result lies or will lie; `LogError` without a log to read."""
        robot = known_robot(self.job.path(self.job.robot), self.robot)
        try:
            made_from = ingredients(self.job, robot, self.channels, self.section)
        except OSError as error:
            raise LogError(f"{error.filename}: cannot be read ({error.strerror})") from error
        return shelf.place({**made_from, "paired": self.job.fit.offset})


def work_of(job: Job, robot: Robot, channels: Sequence[FtChannel]) -> dict[str, Work]:
    """Return the recordings of a job as work, by name."""
    # another process may have another working directory
    rooted = job.model_copy(update={"file": job.file.absolute()})
    return {
        section.label: Work(
            rooted.model_copy(update={"recordings": (section,)}),
            robot.digest,
            tuple(channels),
        )
        for section in job.recordings
    }


@lru_cache(maxsize=8)
def known_robot(path: Path, digest: str) -> Robot:
    """Return a robot, read once in a process: a kernel is compiled for each that is read."""
    robot = read_robot(path)
    if robot.digest != digest:
        raise DataError(f"{path}: changed while its recordings were being paired; start again")
    return robot


def paired_take(work: Work, shelf: Shelf | None = None) -> PairedTake:
    """Return one recording as a calibration needs it, kept on the shelf and found again there.

    Raises `FtcalError` where the log cannot be read or a sensor's wrench cannot be known in it.
    """
    return _made(work) if shelf is None else take_at(work.place(shelf), work, shelf)


def take_at(place: Path, work: Work, shelf: Shelf) -> PairedTake:
    """Return the recording whose place on the shelf is known already; raises as `paired_take`."""
    return shelved(shelf, place, PairedTake, lambda: _made(work))


def _made(work: Work) -> PairedTake:
    channels, job = work.channels, work.job
    robot = known_robot(job.path(job.robot), work.robot)
    names = {c.sensor: given.name for c, given in zip(channels, job.sensors, strict=True)}
    log, in_situ = logged(work), job.fit.offset == "in situ"
    seen = overview(log, robot, channels, max_gap=job.signals.max_gap)
    # the doctor has seen the numbers as they were logged; all that follows, in the sensor's frame
    log = in_sensor_frames(log, job=job, robot=robot, channels=channels)
    section, findings = unrest_found(work, robot, log, seen)
    pairing = Pairing.of(
        log,
        robot,
        channels,
        section.schedule(),
        gravity=section.gravity,
        imu=section.imu,
        findings=findings,
        clocks=seen.clocks,
        options=job.signals.options(),
        with_attitude=in_situ,
    )
    gathering = {
        channel.sensor: Gathering.of(
            section,
            names[channel.sensor],
            channel,
            log.head.start,
            smoothing=job.signals.smoothing,
            in_situ=in_situ,
        )
        for channel in channels
    }
    for piece in log.pieces(rows=PIECE_ROWS, overlap=pairing.overlap):
        for channel, rows in pairing.rows(piece):
            gathering[channel.sensor].add(rows)
    pairing.check()
    return PairedTake(
        seen.outline,
        findings,
        dict(section.known_breaks),
        dict(section.leave_out),
        dict(seen.warmth),
        {sensor: one.gathered(pairing.logged[sensor]) for sensor, one in gathering.items()},
    )


def logged(work: Work) -> Pieces:
    """Return the log of a recording, opened.

    In memory as a whole where offsets are searched for steps: any stretch is compared with others.
    """
    if work.section.breaks == "auto":
        return WholeLog(read_log(work.job, work.section))
    return opened(work.job, work.section)


def unrest_found(
    work: Work, robot: Robot, log: Pieces, seen: Overview
) -> tuple[RecordingSection, tuple[Finding, ...]]:
    """Return the section of a recording with breaks in place of "auto", and its findings."""
    match log:
        case WholeLog(recording) if work.section.breaks == "auto":
            only = Takes(
                work.job, robot, work.channels, (seen.outline,), (seen.findings,), {0: recording}
            )
            job, takes = segmented(work.job, robot, work.channels, only, Steps(silent, 1))
            return job.recordings[0], takes.findings[0]
    return work.section, seen.findings


def told(work: Work, shelf: Shelf | None) -> PairedTake | FtcalError:
    """Return `paired_take(work, shelf)`, or the error: as a value it travels and keeps its kind."""
    try:
        return paired_take(work, shelf)
    except FtcalError as error:
        return error


def paired_takes(
    job: Job,
    robot: Robot,
    channels: Sequence[FtChannel],
    *,
    where: Executor,
    shelf: Shelf | None,
    steps: Steps,
) -> list[PairedTake]:
    """Return the recordings of a job in order.

    All are tried before any fault is raised: one error, of the kind of the first, names every
    fault.
    """
    steps.begin("pairing recordings")
    most = max(LEAST_SAMPLES, MOST_SAMPLES // len(job.recordings))
    found: dict[str, PairedTake] = {}
    faults: dict[str, FtcalError] = {}
    task = partial(told, shelf=shelf)
    for label, result in where.run(task, work_of(job, robot, channels)):
        steps.begin(f"paired {label}")
        match result:
            case PairedTake():
                found[label] = result.thinned(most)
            case Failure():
                faults[label] = DataError(f"recording {label!r}: {result.reason}")
            case _:
                faults[label] = result
    in_order = [section.label for section in job.recordings]
    raise_first(faults, in_order)
    return [found[label] for label in in_order]


def raise_first(faults: Mapping[str, FtcalError], in_order: Sequence[str]) -> None:
    """Raise all faults as one error of the kind of the first; nothing where there is none."""
    some = [faults[label] for label in in_order if label in faults]
    if some:
        raise type(some[0])("; ".join(map(str, some)))
