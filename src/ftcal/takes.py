"""The recordings of a job, in memory while they are small together, else read again.

A fit needs the usable samples of a recording, a report its outline; hours of a humanoid do not fit
into memory side by side, and need not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol, overload

from ftcal import logs
from ftcal.config import Job, RecordingSection
from ftcal.errors import JobError
from ftcal.gathering import PairedSensor
from ftcal.health import examine
from ftcal.logs.pieces import Pieces, span
from ftcal.pairing import FtChannel
from ftcal.progress import Steps
from ftcal.recording import Finding, Recording
from ftcal.robot import Robot
from ftcal.turning import recording_turned_back, turned_back

KEPT = 64 * 1024**2
"""Bytes of recordings that are kept in memory."""


IN_MEMORY = logs.IN_MEMORY
"""Bytes of a log beyond which it is read in pieces."""


@dataclass(frozen=True, slots=True, eq=False)
class PairedTake:
    """One recording as a calibration of single sensors needs it, and no more."""

    outline: Recording
    """With the first and last sample of every signal only."""
    findings: tuple[Finding, ...]
    """What is wrong with it."""
    breaks: dict[str, tuple[float, ...]]
    """Seconds at which the offset of a sensor steps, given or found."""
    leave_out: dict[str, tuple[tuple[float, float], ...]]
    """Seconds in which a sensor is not trained on, given or found."""
    warmth: dict[str, tuple[int, float]]
    """Readings of every thermometer: how many, and their mean [degree Celsius]."""
    sensors: dict[str, PairedSensor]
    """Usable samples of every sensor, their temperature counted from zero."""

    def section(self, given: RecordingSection) -> RecordingSection:
        """Return the recording's section of the job with what was found in it."""
        return given.model_copy(update={"breaks": self.breaks, "leave_out": self.leave_out})

    def thinned(self, most: int) -> PairedTake:
        """Return the recording with at most so many samples of each sensor for eyes."""
        return replace(
            self, sensors={name: one.thinned(most) for name, one in self.sensors.items()}
        )


class Glimpses(Protocol):
    """Recordings by name, some seconds of which can be looked at."""

    def between(self, name: str, start: float, stop: float) -> Recording:
        """Return the samples of a recording in [start, stop) seconds."""


def as_logged(log: Pieces) -> Pieces:
    """Return a log as it is."""
    return log


@dataclass(frozen=True, slots=True, eq=False)
class Logs:
    """The recordings of a job by name, some seconds of which are read when they are looked at."""

    job: Job
    turned: Callable[[Pieces], Pieces] = as_logged
    """What is done to a log that was opened, such as `in_sensor_frames`."""
    seen: dict[tuple[str, float, float], Recording] = field(default_factory=dict, repr=False)

    def between(self, name: str, start: float, stop: float) -> Recording:
        """Return the samples of a recording in [start, stop) seconds; kept until others are asked.

        Raises `FtcalError` as `opened` does, `KeyError` for an unknown name.
        """
        if (name, start, stop) not in self.seen:
            section = {section.label: section for section in self.job.recordings}[name]
            self.seen.clear()
            log = self.turned(opened(self.job, section))
            self.seen[name, start, stop] = span(log, start, stop)
        return self.seen[name, start, stop]


@dataclass(frozen=True, slots=True, eq=False)
class Takes(Sequence[Recording]):
    """The recordings of a job in their order; one beyond `KEPT` is read at every look."""

    job: Job
    robot: Robot
    channels: tuple[FtChannel, ...]
    outlines: tuple[Recording, ...]
    """Each with the first and last sample of every signal only."""
    findings: tuple[tuple[Finding, ...], ...]
    """What is wrong with each."""
    kept: dict[int, Recording] = field(repr=False)

    @staticmethod
    def read(
        job: Job,
        robot: Robot,
        channels: Sequence[FtChannel],
        steps: Steps,
        most: int | None = None,
    ) -> Takes:
        """Return the recordings of a job, keeping `most` bytes of them (default: `KEPT`).

        Raises `JobError` where a log is missing, `LogError` where one cannot be believed.
        """
        outlines, findings, kept, size = [], [], {}, 0
        for i, section in enumerate(job.recordings):
            steps.begin(f"reading {section.label}")
            recording, found = examined(job, robot, channels, section)
            outlines.append(recording.outline())
            findings.append(found)
            size += recording.size
            if size <= (KEPT if most is None else most):
                kept[i] = recording
        return Takes(job, robot, tuple(channels), tuple(outlines), tuple(findings), kept)

    @property
    def flat(self) -> tuple[tuple[str, Finding], ...]:
        """Recording and finding, in order."""
        pairs = zip(self.outlines, self.findings, strict=True)
        return tuple((recording.name, finding) for recording, found in pairs for finding in found)

    def __len__(self) -> int:
        return len(self.outlines)

    @overload
    def __getitem__(self, which: int) -> Recording: ...
    @overload
    def __getitem__(self, which: slice) -> Sequence[Recording]: ...
    def __getitem__(self, which: int | slice) -> Recording | Sequence[Recording]:
        at = range(len(self))[which]
        if isinstance(at, range):
            return [self[i] for i in at]
        if at in self.kept:
            return self.kept[at]
        again = read_log(self.job, self.job.recordings[at])
        return read_in_sensor_frames(self.job, self.robot, self.channels, again)

    def __iter__(self) -> Iterator[Recording]:
        return (self[i] for i in range(len(self)))


def log_of(job: Job, section: RecordingSection) -> Path:
    """Return where the log of a recording lies; `JobError` where it is missing."""
    path = job.path(section.log)
    if not path.exists():
        raise JobError(f"{job.file}: no log at {section.log}; paths are relative to the job")
    return path


def opened(job: Job, section: RecordingSection) -> Pieces:
    """Return the log of a recording, opened; in memory as a whole where it is small.

    Raises `JobError` where it is missing, `LogError` where it cannot be believed.
    """
    path = log_of(job, section)
    return logs.opened(path, section.layout(), name=section.label, most=IN_MEMORY)


def examined(
    job: Job, robot: Robot, channels: Sequence[FtChannel], section: RecordingSection
) -> tuple[Recording, tuple[Finding, ...]]:
    """Return one recording of a job and what is wrong with it; raises as `Takes.read`.

    Wrenches are in the frames of their sensors; the doctor has seen them as they were logged.
    """
    recording = read_log(job, section)
    firmware = {channel.signal: channel.workbench.firmware for channel in channels}
    found = examine(recording, sensors=firmware, robot=robot)
    turned = read_in_sensor_frames(job, robot, channels, recording)
    return turned, (*recording.findings, *found)


def in_sensor_frames(
    log: Pieces, *, job: Job, robot: Robot, channels: Sequence[FtChannel]
) -> Pieces:
    """Return a log of a job with every wrench in the frame of its sensor; raises `turned_back`."""
    return turned_back(log, robot, channels, max_gap=job.signals.max_gap)


def read_in_sensor_frames(
    job: Job, robot: Robot, channels: Sequence[FtChannel], recording: Recording
) -> Recording:
    """Return a recording of a job with every wrench in the frame of its sensor."""
    return recording_turned_back(recording, robot, channels, max_gap=job.signals.max_gap)


def read_log(job: Job, section: RecordingSection) -> Recording:
    """Return one recording of a job."""
    return logs.read(log_of(job, section), section.layout(), name=section.label)
