"""Many robots at once, and whose sensors have drifted since they were last calibrated.

A robot is a folder with a `job.toml`. All recordings of all robots are paired in one go, wherever
there are processors (`ftcal.compute`), each kept on a shelf as it is done; then every robot is
fitted from the shelf. What is finished is not done again, however a run ended: a recording lies on
the shelf under the hash of what made it, and beside a robot's results is one of theirs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from ftcal.archive import Shelf
from ftcal.calibration import read_calibration
from ftcal.compute import Executor, Failure
from ftcal.config import Job, read_job
from ftcal.drift import Drift, drift
from ftcal.errors import FtcalError, JobError
from ftcal.fleet_robot import CALIBRATION, PREVIOUS, Fitting, fit_robot
from ftcal.paired_takes import KINDS, Work, take_at, work_of
from ftcal.pairing import FtChannel
from ftcal.pipeline import described
from ftcal.progress import Progress, Steps, silent
from ftcal.remote import fetched, is_url
from ftcal.verdict import Verdict, Word, overall

JOB = "job.toml"

Changed = Literal["drifted", "steady", "exchanged", "new"]
"""What became of a sensor; `exchanged`: it has another Workbench, `new`: nothing to compare."""


@dataclass(frozen=True, slots=True)
class SensorState:
    """One sensor of one robot after a run."""

    sensor: str
    verdict: Word
    """Of its calibration."""
    changed: Changed
    drift: Drift | None
    """Since the last calibration, where it can be told."""


@dataclass(frozen=True, slots=True)
class RobotState:
    """One robot after a run."""

    name: str
    """Its folder below the fleet's."""
    reason: str
    """Why it could not be calibrated; empty where it was."""
    used: tuple[str, ...]
    """Recordings that its calibration rests on."""
    failed: dict[str, str]
    """Recordings that could not be paired, and why."""
    sensors: tuple[SensorState, ...]


@dataclass(frozen=True, slots=True)
class Fleet:
    """What a run gave."""

    robots: tuple[RobotState, ...]
    """In the order of their names."""
    missing: dict[str, str]
    """Files that could not be fetched, and why."""
    paired: int
    """Recordings that were paired in this run; the others were on the shelf."""
    fitted: int
    """Robots that were fitted in this run; the others had their results."""

    @property
    def whole(self) -> bool:
        """Whether every recording and every robot could be done."""
        return not self.missing and not any(one.reason or one.failed for one in self.robots)


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One robot whose job makes sense."""

    job: Job
    robot: str
    """Digest of its description."""
    channels: tuple[FtChannel, ...]
    work: dict[str, Work]
    """Its recordings by name."""


def run_fleet(
    place: str,
    output: Path,
    *,
    where: Executor,
    cache: Path | None = None,
    since: Path | None = None,
    report: bool = False,
    progress: Progress = silent,
) -> Fleet:
    """Calibrate every robot below `place`, a folder or a URL, and compare with what was before.

    Results go to `output`/ROBOT, paired recordings into `cache`. Compared is with the calibration
    that the latest one replaced, or with the results of an earlier run in the folder `since`.
    Raises `JobError` where there is no robot, `OutputError` where nothing can be written; what is
    wrong with one robot or recording is told in the result.
    """
    output = output.absolute()
    cache = (cache or output / "cache").absolute()
    shelf = Shelf(cache, KINDS)
    root, missing = Path(place).absolute(), dict[str, str]()
    if is_url(place):
        root, missing = fetched(place, cache / "fetched", progress=progress)
    if not root.is_dir():
        raise JobError(f"{place}: there is no such folder; name the one that holds the robots")
    members, reasons = joined(jobs_below(root, without=() if is_url(place) else (output, cache)))
    if not members and not reasons:
        raise JobError(f"{place}: no {JOB} below it; each robot is a folder with its job")

    pieces = {
        f"{name}: {label}": work
        for name, member in members.items()
        for label, work in member.work.items()
    }
    steps = Steps(progress, len(pieces) + len(members))
    kept: dict[str, str] = {}
    lost: dict[str, str] = {}
    paired = 0
    for piece, result in where.run(partial(keep, shelf=shelf), pieces):
        steps.begin(f"paired {piece}")
        if isinstance(result, Failure):
            lost[piece] = result.reason
        else:
            kept[piece], made = result
            paired += made
    fittings = {
        name: fitting(name, member, kept, output / name) for name, member in members.items()
    }
    done = 0
    for name, outcome in where.run(partial(fit_robot, shelf=shelf, report=report), fittings):
        steps.begin(f"fitted {name}")
        if isinstance(outcome, Failure):
            reasons[name] = outcome.reason
        else:
            done += outcome
    robots = []
    for name in sorted({*members, *reasons}):
        labels = members[name].work if name in members else {}
        failed = {one: lost[f"{name}: {one}"] for one in labels if f"{name}: {one}" in lost}
        sensors: tuple[SensorState, ...] = ()
        if name not in reasons:
            before = output / name / PREVIOUS if since is None else since / name / CALIBRATION
            try:
                sensors = tuple(states(output / name / CALIBRATION, before))
            except FtcalError as error:
                reasons[name] = str(error)
        used = tuple(label for label in labels if label not in failed)
        robots.append(RobotState(name, reasons.get(name, ""), used, failed, sensors))
    return Fleet(tuple(robots), missing, paired, done)


def jobs_below(root: Path, *, without: Iterable[Path]) -> dict[str, Path]:
    """Return the job files below a folder by the name of their robot, in its order."""
    found = {}
    for file in sorted(root.rglob(JOB)):
        if not any(file.is_relative_to(other) for other in without):
            name = file.parent.relative_to(root).as_posix()
            found[root.name if name == "." else name] = file
    return found


def joined(jobs: Mapping[str, Path]) -> tuple[dict[str, Member], dict[str, str]]:
    """Return the robots whose job makes sense, and of the others why it does not."""
    members, reasons = {}, {}
    for name, file in jobs.items():
        try:
            job = read_job(file)
            robot, channels = described(job)
        except FtcalError as error:
            reasons[name] = str(error)
        else:
            work = work_of(job, robot, channels)
            members[name] = Member(job, robot.digest, tuple(channels), work)
    return members, reasons


def keep(work: Work, shelf: Shelf) -> tuple[str, bool]:
    """Return the name of a recording on the shelf, and whether it had to be put there.

    A fit of all sensors at once reads its logs itself: of them the name tells whether any changed.
    """
    place = work.place(shelf)
    if work.job.fit.scope == "whole body" or place.exists():
        return place.name, False
    take_at(place, work, shelf)
    return place.name, True


def fitting(robot: str, member: Member, kept: Mapping[str, str], folder: Path) -> Fitting:
    """Return what is left to do for a robot once its recordings are `kept`."""
    paired = [label for label in member.work if f"{robot}: {label}" in kept]
    sections = tuple(section for section in member.job.recordings if section.label in paired)
    return Fitting(
        member.job.model_copy(update={"recordings": sections}),
        member.robot,
        member.channels,
        tuple(member.work[label] for label in paired),
        tuple(kept[f"{robot}: {label}"] for label in paired),
        folder,
    )


def states(now: Path, before: Path) -> Iterator[SensorState]:
    """Yield every sensor of a calibration, compared with that of before where there is one.

    Raises `SensorError` where one of the files is no calibration.
    """
    old = {s.sensor: s for s in read_calibration(before).sensors} if before.exists() else {}
    for sensor in read_calibration(now).sensors:
        word = overall([Verdict(v.axis, v.verdict, v.reason) for v in sensor.verdicts])
        if sensor.sensor not in old:
            yield SensorState(sensor.sensor, word, "new", None)
            continue
        found = drift(old[sensor.sensor], sensor)
        changed: Changed = "exchanged"
        if found is not None:
            changed = "drifted" if found.drifted else "steady"
        yield SensorState(sensor.sensor, word, changed, found)
