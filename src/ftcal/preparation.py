"""One recording as a study needs it: what every sensor said beside what it should have said.

Everything that follows is small algebra on it, so it is kept on a shelf (`ftcal.archive`): a second
study of the same logs, with other penalties or other training sets, does not read them again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from ftcal import __version__
from ftcal.archive import Shelf
from ftcal.balances import Balance, balances
from ftcal.config import Job, RecordingSection
from ftcal.errors import DataError, OutputError
from ftcal.firmware import estimate_full_scale
from ftcal.health import logs_counts
from ftcal.logs.columns import digest, file_sha256
from ftcal.logs.yarp import SAMPLES
from ftcal.offset import InSituOffset, in_situ_offset
from ftcal.one_sensor import pair_recording
from ftcal.pairing import FtChannel, one_sided
from ftcal.recording import Finding, Recording, Signal
from ftcal.robot import Robot
from ftcal.samples import Samples
from ftcal.takes import examined, log_of

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class SensorTake:
    """One sensor in one recording."""

    segments: tuple[Samples, ...]
    """Its offset segments."""
    offsets: tuple[InSituOffset, ...]
    """In situ offset of each segment, which may refuse to be used."""
    aligning: Samples
    """Samples that give its offset in the switching recording; in any other, the first segment."""
    full_scale: tuple[int, ...]
    """What its readings show of its full scale [N, Nm]; zeros where they show nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """One recording, ready for any number of fits."""

    name: str
    duration: float
    """Seconds."""
    digest: str
    """SHA-256 of the files read."""
    findings: tuple[Finding, ...]
    sensors: dict[str, SensorTake]
    balances: tuple[Balance, ...]
    """Of the free sub-models, in the switching recording; none in any other."""


KINDS = {kind.__name__: kind for kind in (Prepared, SensorTake, Samples, InSituOffset, Finding,
                                          Balance)}  # fmt: skip
"""What a shelf of prepared recordings may hold."""


def prepare(
    job: Job,
    robot: Robot,
    channels: Sequence[FtChannel],
    section: RecordingSection,
    shelf: Shelf | None = None,
) -> Prepared:
    """Return one recording of a study, from the shelf where nothing that made it has changed.

    Raises `FtcalError` where the log cannot be read or a sensor's wrench cannot be known in it.
    """
    if shelf is None:
        return _made(job, robot, channels, section)
    place = shelf.place(ingredients(job, robot, channels, section))
    return shelved(shelf, place, Prepared, lambda: _made(job, robot, channels, section))


def shelved(shelf: Shelf, place: Path, kind: type[T], make: Callable[[], T]) -> T:
    """Return what lies at `place` of a shelf, made and put there where nothing of its kind does.

    Raises `OutputError` where the shelf cannot be written.
    """
    kept = shelf.find(place)
    if isinstance(kept, kind):
        return kept
    made = make()
    try:
        shelf.put(place, made)
    except OutputError as error:
        raise OutputError(
            f"{shelf.folder}: prepared recordings cannot be kept there; name another folder with"
            " --cache"
        ) from error
    return made


def ingredients(
    job: Job, robot: Robot, channels: Sequence[FtChannel], section: RecordingSection
) -> dict[str, Any]:
    """Return all that a prepared recording is made from, as plain JSON."""
    path = log_of(job, section)
    path = path.parent if path.name == SAMPLES else path
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    return {
        "ftcal": __version__,
        "robot": robot.digest,
        "log": digest([file.relative_to(path).as_posix().encode() + file_sha256(file)
                       for file in files]),
        "recording": section.model_dump(mode="json", exclude={"log"}),
        "label": section.label,
        "signals": job.signals.model_dump(mode="json"),
        "sensors": [
            {
                "channel": [channel.sensor, channel.signal, channel.temperature],
                "wrench frame": channel.wrench_frame,
                "workbench": channel.workbench.gain.tolist(),
                "full scale": channel.workbench.full_scale.tolist(),
                "logged": channel.workbench.logged,
                "firmware": channel.workbench.firmware is not None,
            }
            for channel in channels
        ],
        "switching": [
            job.study.switching == section.label,
            job.study.align if job.study.switching == section.label else None,
        ],
    }  # fmt: skip


def _made(
    job: Job, robot: Robot, channels: Sequence[FtChannel], section: RecordingSection
) -> Prepared:
    recording, findings = examined(job, robot, channels, section)
    switches = section.label == job.study.switching
    return Prepared(
        recording.name,
        recording.duration,
        recording.digest,
        findings,
        {
            channel.sensor: _sensor_take(job, robot, channel, section, recording, findings)
            for channel in channels
        },
        balances(
            recording,
            robot,
            channels,
            section.schedule(),
            gravity=section.gravity,
            imu=section.imu,
            findings=findings,
            options=job.signals.options(),
        )
        if switches
        else (),
    )


def _sensor_take(
    job: Job,
    robot: Robot,
    channel: FtChannel,
    section: RecordingSection,
    recording: Recording,
    findings: Sequence[Finding],
) -> SensorTake:
    both = pair_recording(
        job, robot, channel, section, recording, findings, 0.0, with_attitude=True
    )
    everything = ((both.samples.start, both.samples.stop + 1.0),)
    segments = both.windows(section.train or section.test or everything)
    if not segments:
        raise DataError(
            f"recording {recording.name!r}, sensor {channel.sensor!r}: no usable sample in any"
            " window of `train` or `test`; widen it"
        )
    aligning = segments[0]
    if section.label == job.study.switching:
        schedule = one_sided(robot, channel.sensor, section.schedule())
        spans = [(i.start, i.stop) for i in schedule.intervals]
        found = both.windows((job.study.align,) if job.study.align else spans)
        if not found:
            raise DataError(
                f"recording {recording.name!r}, sensor {channel.sensor!r}: no usable sample in"
                f" align = {list(job.study.align or ())}; choose seconds in which it is free"
            )
        aligning = found[0]
    return SensorTake(
        tuple(segments),
        tuple(
            in_situ_offset(both.attitude_during(segment), channel.workbench.scaling)
            for segment in segments
        ),
        aligning,
        _full_scale(recording.channel(channel.signal)),
    )


def _full_scale(signal: Signal) -> tuple[int, ...]:
    """Return the full scales that calibrated readings show [N, Nm], zeros where they do not."""
    if signal.values.shape[1] != 6 or logs_counts(signal):
        return (0,) * 6
    return tuple(int(scale) for scale in estimate_full_scale(signal.values))
