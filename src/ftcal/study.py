"""The experimental section of the paper on one page: both validations, for every sensor of a job.

`study(job)` is what `ftcal study` runs; `report.write_study` puts its outcome on disk.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ftcal.archive import Shelf
from ftcal.config import Job
from ftcal.errors import JobError, raise_all
from ftcal.first_validation import FirstValidation, first_validation
from ftcal.law import Law, aligned
from ftcal.pairing import FtChannel
from ftcal.pipeline import check_contacts, ft_channel
from ftcal.preparation import KINDS, Prepared, prepare
from ftcal.progress import Progress, Steps, silent
from ftcal.robot import FtSensor, Robot
from ftcal.second_validation import (
    BEST,
    MIXED,
    TRUTH,
    WORKBENCH,
    SecondValidation,
    SubChain,
    judging_balance,
    second_validation,
    sub_chains,
)
from ftcal.synthetic import read_truth
from ftcal.urdf import read_robot

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


OCTAVE = 0.015
"""Distance of the ratio of two full scales from a power of two, in octaves: one percent."""

UNLIKE_AXES = 3
"""Axes that must disagree for two recordings to be of different boards."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorStudy:
    """Both validations of one sensor."""

    sensor: FtSensor
    channel: FtChannel
    first: FirstValidation
    second: SecondValidation | None
    """None where the job has no switching recording."""


@dataclass(frozen=True, slots=True, eq=False)
class StudyOutcome:
    """What one study gave."""

    job: Job
    robot: Robot
    recordings: tuple[Prepared, ...]
    sensors: tuple[SensorStudy, ...]
    sub_chains: tuple[SubChain, ...]
    """Contact-free sub-models of the switching run, all sensors read alike."""
    truth: dict[str, Float[Array, "6 K"]]
    """True gains where a simulation knows them."""

    @property
    def improved(self) -> bool:
        """Whether any training set of any sensor beats the Workbench on data it did not see."""
        return any(study.first.surviving for study in self.sensors)


def study(
    job: Job, *, shelf: Path | None = None, workers: int = 1, progress: Progress = silent
) -> StudyOutcome:
    """Return both validations of every sensor of a job.

    Prepared recordings are kept in the folder `shelf` and found again as long as nothing that made
    them changes. `workers` processes share the recordings. Raises `FtcalError`, one line.
    """
    robot = read_robot(job.path(job.robot))
    channels = [ft_channel(job, robot, section) for section in job.sensors]
    check_contacts(job, robot, channels)
    truth = {} if job.study.truth is None else read_truth(job.path(job.study.truth))
    steps = Steps(progress, len(job.recordings) + len(channels))
    kept = None if shelf is None else Shelf(shelf, KINDS)
    takes = prepared(job, robot, channels, kept, workers, steps)
    same_sensors(takes, channels)
    by_name = {take.name: take for take in takes}
    judging = [take.name for take in takes if take.name != job.study.switching]
    training = job.study.training or [
        section.label for section in job.recordings if section.label in judging and section.trains
    ]
    if not training:
        raise JobError(f"{job.file}: the study has no recording to train on; add one")
    run = by_name.get(job.study.switching or "")
    own = {} if run is None else run_laws(run, channels)
    studies = []
    for channel in channels:
        steps.begin(f"validating {channel.sensor}")
        mine = {name: take.sensors[channel.sensor] for name, take in by_name.items()}
        first = first_validation(mine, training, judging, channel.workbench)
        second = None
        if run is not None:
            second = second_validation(
                channel.sensor,
                first,
                judging_balance(channel.sensor, run.balances),
                own,
                run.sensors[channel.sensor].aligning,
                channel.workbench,
                job.study.lambdas,
            )
        studies.append(SensorStudy(robot.sensor(channel.sensor), channel, first, second))
    chains = () if run is None else in_all_chains(run, studies, truth)
    steps.begin("writing")
    return StudyOutcome(job, robot, tuple(takes), tuple(studies), chains, truth)


def prepared(
    job: Job,
    robot: Robot,
    channels: Sequence[FtChannel],
    shelf: Shelf | None,
    workers: int,
    steps: Steps,
) -> list[Prepared]:
    """Return the recordings of the job in order, `workers` of them made at a time."""
    work = [(job, robot, channels, section, shelf) for section in job.recordings]
    if workers < 2 or len(work) < 2:
        takes = []
        for item, section in zip(work, job.recordings, strict=True):
            steps.begin(f"preparing {section.label}")
            takes.append(prepare(*item))
        return takes
    # spawned, not forked: a fork copies the locks of the kernel's threads
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(work)), mp_context=context) as pool:
        futures = [pool.submit(prepare, *item) for item in work]
        for _ in as_completed(futures):
            steps.begin("preparing recordings")
        return [future.result() for future in futures]


def same_sensors(takes: Sequence[Prepared], channels: Sequence[FtChannel]) -> None:
    """Raise `JobError` where the readings of one sensor come from boards of unlike full scale.

    One robot's recordings share their sensors; another robot's do not.
    """
    faults = []
    for channel in channels:
        shown = [(take.name, take.sensors[channel.sensor].full_scale) for take in takes]
        # what shows least is compared with what shows most
        first, *others = sorted(shown, key=lambda one: -np.count_nonzero(one[1]))
        faults += [
            f"{channel.sensor} shows full scales {' '.join(map(str, scale))} in {name!r} but"
            f" {' '.join(map(str, first[1]))} in {first[0]!r}"
            for name, scale in others
            if unlike(scale, first[1])
        ]
    raise_all(JobError, "recordings of different robots, or a sensor was exchanged", faults)


def unlike(one: Sequence[int], other: Sequence[int]) -> bool:
    """Return whether two estimates of full scales cannot be of one board: three axes disagree.

    A few readings leave an estimate off by a thousandth, or twice what it should be.
    """
    both = np.array([one, other], dtype=np.float64)
    known = (both > 0.0).all(axis=0)
    octaves = np.log2(both[0, known] / both[1, known])
    return bool(np.sum(np.abs(octaves - np.rint(octaves)) > OCTAVE) >= UNLIKE_AXES)


def run_laws(run: Prepared, channels: Sequence[FtChannel]) -> dict[str, Law]:
    """Return the Workbench law of every sensor in the switching run."""
    return {
        channel.sensor: aligned(channel.workbench.gain, run.sensors[channel.sensor].aligning)
        for channel in channels
    }


def in_all_chains(
    run: Prepared, studies: Sequence[SensorStudy], truth: Mapping[str, Float[Array, "6 K"]]
) -> tuple[SubChain, ...]:
    """Return what every sub-chain leaves over when all its sensors read by the same rule."""
    by_matrix: dict[str, dict[str, Law]] = {WORKBENCH: {}, BEST: {}, MIXED: {}}
    for one in studies:
        if one.second is not None:
            name = one.channel.sensor
            by_matrix[WORKBENCH][name] = one.second.candidates[0].law
            by_matrix[BEST][name] = one.second.candidates[one.second.best].law
            by_matrix[MIXED][name] = one.second.mixed
    if truth.keys() >= by_matrix[WORKBENCH].keys():
        by_matrix[TRUTH] = {
            name: aligned(truth[name], run.sensors[name].aligning) for name in by_matrix[WORKBENCH]
        }
    return sub_chains(run.balances, by_matrix)
