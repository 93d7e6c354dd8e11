"""Both validations of the paper from moments, and what the shelf of prepared recordings saves.

    python benchmarks/study.py --seconds 100 --rounds 5

Fits: the reference is what an engineer writes, `lstsq` on the samples of a recording, for every
penalty again with its rows below. Scoring is the same in both, so the ratio of whole validations is
smaller. Logs: an iCub on its pole as YARP text, read, paired and kept; then found again.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import icub_models
import numpy as np
from measure import Benchmark, Record, interleaved

from ftcal.balances import Balance
from ftcal.config import PAPER_LAMBDAS, read_job
from ftcal.dynamics import expected_wrenches
from ftcal.first_validation import FirstValidation, first_validation
from ftcal.law import aligned
from ftcal.logs import yarp
from ftcal.motion import FixedContact, Motion
from ftcal.offset import InSituOffset
from ftcal.preparation import SensorTake
from ftcal.recording import Recording, Signal
from ftcal.ridge import penalty_path
from ftcal.samples import Samples
from ftcal.second_validation import SecondValidation, second_validation
from ftcal.sensor import Workbench
from ftcal.study import study
from ftcal.urdf import read_robot

if TYPE_CHECKING:
    from numpy import ndarray as Array

RATE = 100
RECORDINGS, SENSORS = 8, 6
MODEL = "iCubGazeboV2_7"
FULL_SCALE = np.array([1500.0, 1800.0, 2100.0, 37.0, 38.0, 24.0])
NAMES = tuple(f"take{k}" for k in range(RECORDINGS))
RUN = "run"


@dataclass(frozen=True, slots=True)
class Sensor:
    """One sensor in all recordings, as the shelf gives it."""

    workbench: Workbench
    takes: dict[str, SensorTake]
    balance: Balance
    """Of the switching run, with a neighbour that reads right."""


def invented(samples: int, rng: np.random.Generator) -> Sensor:
    """Return a sensor bent by three percent, with noise of a thousandth of full scale."""
    gain = FULL_SCALE[:, None] * np.linalg.qr(rng.normal(size=(6, 6)))[0] / 32767
    truth = gain + 0.03 * FULL_SCALE[:, None] * rng.normal(size=(6, 6)) / 32767
    seconds = np.arange(samples) / RATE
    takes = {}
    for name in (*NAMES, RUN):
        channels = rng.normal(size=(samples, 6)) * 1000
        wrench = channels @ truth.T + 1e-3 * FULL_SCALE * rng.normal(size=(samples, 6))
        segment = Samples(name, 0.0, float(seconds[-1]), seconds, channels + 1e4, wrench)
        offset = InSituOffset(np.full(6, 1e4), 0.0, 0.0, 0.0, 1.0)
        takes[name] = SensorTake((segment,), (offset,), segment, (0,) * 6)
    mine = takes[RUN].aligning
    X = np.tile(np.eye(6), (samples, 1, 1))
    other = rng.normal(size=(samples, 6)) * 100
    balance = Balance("shank", seconds, {"mine": mine.channels, "other": other},
                      {"mine": X, "other": -X}, mine.wrench - other)  # fmt: skip
    return Sensor(Workbench("invented", gain, FULL_SCALE), takes, balance)


def validations(sensors: Sequence[Sensor]) -> list[tuple[FirstValidation, SecondValidation]]:
    """Return both validations of every sensor."""
    found = []
    for sensor in sensors:
        first = first_validation(sensor.takes, NAMES, NAMES, sensor.workbench)
        aligning = sensor.takes[RUN].aligning
        believed = Workbench("other", np.eye(6), FULL_SCALE, "channels")
        laws = {
            "mine": aligned(sensor.workbench.gain, aligning),
            "other": aligned(believed.gain, Samples(RUN, 0, 1, aligning.time, aligning.channels,
                                                    aligning.channels)),
        }  # fmt: skip
        second = second_validation(
            "mine", first, sensor.balance, laws, aligning, sensor.workbench, PAPER_LAMBDAS
        )
        found.append((first, second))
    return found


def by_moments(firsts: Sequence[FirstValidation], sensors: Sequence[Sensor]) -> list[Array]:
    """Return every gain of both validations: moments are taken once a set, then small algebra."""
    gains = []
    for first, sensor in zip(firsts, sensors, strict=True):
        for one in first.sets:
            take = sensor.takes[one.recording]
            (segment,), (offset,) = take.segments, take.offsets
            moments = segment.moments()
            if one.method == "in situ":
                origin = np.concatenate([offset.offset, np.zeros(6)])
                moments = moments.about(origin)
            path = penalty_path(moments, sensor.workbench, np.array(PAPER_LAMBDAS))
            gains += [estimate.gain for estimate in path]
    return gains


def by_lstsq(firsts: Sequence[FirstValidation], sensors: Sequence[Sensor]) -> list[Array]:
    """Return the same gains, each from the samples with sqrt(lambda) rows below."""
    gains = []
    for first, sensor in zip(firsts, sensors, strict=True):
        prior = sensor.workbench.gain
        for one in first.sets:
            take = sensor.takes[one.recording]
            (segment,), (offset,) = take.segments, take.offsets
            for weight in PAPER_LAMBDAS:
                if one.method == "in situ":
                    r, w = segment.channels - offset.offset, segment.wrench
                else:
                    r = segment.channels - segment.channels.mean(axis=0)
                    w = segment.wrench - segment.wrench.mean(axis=0)
                root = np.sqrt(6 * len(r) * weight) * np.eye(6)
                rows = np.concatenate([r, root]), np.concatenate([w, root @ prior.T])
                gains.append(np.linalg.lstsq(*rows, rcond=None)[0].T)
    return gains


def write_logs(folder: Path, samples: int, rng: np.random.Generator) -> Path:
    """Write the logs of an iCub with six sensors on its pole, and the job of a study."""
    source = Path(icub_models.get_model_file(MODEL))
    shutil.copy(source, folder / "robot.urdf")
    robot = read_robot(folder / "robot.urdf")
    names = robot.moving_joints
    seconds = np.arange(samples) / RATE
    stamps = 1_700_000_000_000_000_000 + np.arange(samples) * (1_000_000_000 // RATE)
    sensors = list(robot.sensors)[:SENSORS]
    for label in (*NAMES, RUN):
        rates, phases = rng.uniform(0.1, 1.5, (2, len(names)))
        wave = seconds[:, None] * rates
        q = 0.3 * np.sin(wave + phases)
        dq, ddq = 0.3 * rates * np.cos(wave + phases), -(rates**2) * q
        motion = Motion(seconds, names, q, dq, ddq)
        felt = expected_wrenches(robot, motion, FixedContact("root_link"), sensors)
        channels = tuple(
            Signal(f"{name}/analog:o", tuple("abcdef"), stamps,
                   wrench + 1e-3 * FULL_SCALE * rng.normal(size=wrench.shape))
            for name, wrench in felt.items()
        )  # fmt: skip
        joints = (Signal("body/state:o", names, stamps, q),)
        yarp.write(Recording(label, "", int(stamps[0]), joints, channels), folder / label)
    scale = ", ".join(map(str, FULL_SCALE))
    text = ['robot = "robot.urdf"']
    text += [f'[[sensors]]\nname = "{name}"\nsignal = "{name}/analog:o"\nfull_scale = [{scale}]'
             for name in sensors]  # fmt: skip
    text += [f'[[recordings]]\nlog = "{label}"\ncontact = "root_link"\n'
             f'joints = {{"body/state:o" = {list(names)}}}'
             for label in (*NAMES, RUN)]  # fmt: skip
    text.append(f'[study]\nswitching = "{RUN}"\n')
    job = folder / "study.toml"
    job.write_text("\n".join(text))
    return job


def measure(seconds: int, rounds: int) -> list[Record]:
    """Return the ratios of fits, of whole validations, and of a study that finds its shelf."""
    rng = np.random.default_rng(0)
    sensors = [invented(seconds * RATE, rng) for _ in range(SENSORS)]
    firsts = [first for first, _ in validations(sensors)]
    ours, theirs = by_moments(firsts, sensors), by_lstsq(firsts, sensors)
    apart = max(abs(a - b).max() / abs(b).max() for a, b in zip(ours, theirs, strict=True))
    if not apart < 1e-8:
        raise SystemExit(f"the fits disagree by {apart:.1e}")
    with tempfile.TemporaryDirectory() as home:
        job = read_job(write_logs(Path(home), seconds * RATE, rng))
        shelf = Path(home) / "shelf"

        def anew() -> None:
            shutil.rmtree(shelf, ignore_errors=True)
            study(job, shelf=shelf)

        calls: dict[str, Callable[[], object]] = {
            "both validations": partial(validations, sensors),
            "fits by moments": partial(by_moments, firsts, sensors),
            "fits by lstsq": partial(by_lstsq, firsts, sensors),
            "study, first run": anew,
            "study, second run": partial(study, job, shelf=shelf),
        }
        times = interleaved(calls, rounds)
    whole, moments, lstsq, first, second = times.values()
    with_lstsq = [w - m + q for w, m, q in zip(whole, moments, lstsq, strict=True)]
    size = f"{RECORDINGS} recordings of {seconds} s"
    return [
        Record.of("study: fits of both validations", "lstsq, each penalty", size,
                  ours=moments, theirs=lstsq),
        Record.of("study: both validations", "lstsq, each penalty", size,
                  ours=whole, theirs=with_lstsq),
        Record.of("study: whole, from the shelf", "its own first run", size,
                  ours=second, theirs=first),
    ]  # fmt: skip


BENCHMARK = Benchmark(measure, {"seconds": 100, "rounds": 5}, {"seconds": 20, "rounds": 1})

if __name__ == "__main__":
    BENCHMARK.main(__doc__)
