"""One fit of all sensors against six separate ones: wrong newtons under load, over many seeds.

    python benchmarks/humanoid.py [--seeds 20] [--swing 30] [--mass 0.0] [--first 1]

A simulated iCub with six sensors, each bent by 3 % of full scale in its mounting, hangs, stands on
both feet, on the left (the right leg moves), on both, on the right, on both. What is judged is a
double support that no fit has seen, every sensor against the wrench that it truly felt:

* `one leg`, the protocol of the real log: both feet, the right leg in the air, judged where its
  foot is down again. Its sensors were never loaded while their limb was free, and two feet on the
  floor leave no leg sensor a free half: a fit of their own knows them from the weight of a leg;
* `rich`: a grid in the air, then all but the last double support; every leg sensor has carried the
  robot while its other half was free.

Six separate fits train on all samples of the same windows in which a half of the robot is free.
Offsets are those of training; a Workbench matrix gets the one that suits it best there.
"""

from __future__ import annotations

import argparse
import itertools
import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal import logs
from ftcal.config import Job, RecordingSection, read_job
from ftcal.law import Law
from ftcal.pipeline import Outcome, calibrate
from ftcal.scenario import read_scenario
from ftcal.sensor import AXES
from ftcal.staging import stage
from ftcal.whole_pipeline import WholeOutcome, calibrate_whole_body

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

SCENARIO = """
model = "iCubGenova04"
{sensors}
[faults]
mass = {mass}
com = {com}
joint_zero = {joint_zero}

[[takes]]
name = "grid"
motion = "grid"
contact = "root_link"
groups = [
    ["r_hip_pitch", "r_hip_roll", "r_hip_yaw"],
    ["l_hip_pitch", "l_hip_roll", "l_hip_yaw"],
    ["r_shoulder_pitch", "r_shoulder_roll", "r_elbow"],
    ["l_shoulder_pitch", "l_shoulder_roll", "l_elbow"],
]
points = 2
range_deg = 30
duration = 40

[[takes]]
name = "walk"
motion = "switching"
pole = "root_link"
hanging = 16
swing = {swing}
left = {{ frame = "l_sole", joints = [{left}] }}
right = {{ frame = "r_sole", joints = [{right}] }}
"""
PARTS = {
    f"{side}_{part}": f"{name}_{part}/analog:o"
    for side, name in (("l", "left"), ("r", "right"))
    for part in ("arm", "leg", "foot")
}
LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
GROUPS = {
    "all six": tuple(PARTS),
    "legs": ("l_leg", "l_foot", "r_leg", "r_foot"),
    "right leg": ("r_leg", "r_foot"),
}
"""Sensors over which errors are averaged."""
COMPARED = ("joint", "Workbench")
BOTH = {"l_sole", "r_sole"}
TRAINED = 0.7
"""Share of the last swing of a protocol that is trained on."""


@dataclass(frozen=True, slots=True)
class Errors:
    """What one way of calibrating leaves of one sensor where it is judged."""

    mean: tuple[float, float]
    """Mean length of the wrong force [N] and torque [Nm]."""
    axes: Float[Array, "6"]
    """Mean size of each wrong component."""

    @staticmethod
    def of(wrong: Float[Array, "N 6"]) -> Errors:
        """Return the means over samples."""
        force, torque = (np.linalg.norm(half, axis=1).mean() for half in np.hsplit(wrong, 2))
        return Errors((float(force), float(torque)), np.abs(wrong).mean(axis=0))


@dataclass(frozen=True, slots=True)
class Judged:
    """One protocol of one session: errors by way of calibrating, and by sensor."""

    errors: dict[str, dict[str, Errors]]
    accepted: tuple[tuple[str, str], ...]
    """Sensor and axis of every ACCEPT of the joint fit."""
    better: tuple[tuple[str, str], ...]
    """Those of them whose error is below the Workbench's."""
    kappa: float
    """Strength of the prior of the joint fit."""

    def mean(self, way: str, group: str, half: int) -> float:
        """Return the mean error of a group of sensors; `half` 0 is the force, 1 the torque."""
        return float(np.mean([self.errors[way][part].mean[half] for part in GROUPS[group]]))


def session(
    folder: Path,
    seed: int,
    *,
    mass: float = 0.0,
    com: float = 0.0,
    joint_zero: float = 0.0,
    swing: float = 30.0,
) -> Path:
    """Simulate a session, the robot off its description as told; return its job file."""
    sensors = "".join(f'[[sensors]]\nname = "{p}_ft"\nsignal = "{s}"\n' for p, s in PARTS.items())
    left, right = (", ".join(f'"{side}_{joint}"' for joint in LEG) for side in "lr")
    told = {"sensors": sensors, "left": left, "right": right}
    scenario = folder / "scenario.toml"
    wrong = {"mass": mass, "com": com, "joint_zero": joint_zero}
    scenario.write_text(SCENARIO.format(**told, **wrong, swing=swing))
    return stage(read_scenario(scenario), folder / "session", seed=seed)[0]


def protocols(job: Job) -> dict[str, Job]:
    """Return the job of each protocol: its recordings with their windows."""
    grid, walk = job.recordings
    contacts = walk.schedule().intervals
    doubles = [span for span in contacts if set(span.touching) == BOTH]
    first, again, last = ((span.start, span.stop) for span in doubles)
    # a part of the last swing is held out too: three seconds alone carry no verdict
    left, right = (begin + TRAINED * (end - begin) for begin, end in _swings(first, again, last))
    one_leg = {"train": ((first[0], left),), "test": ((left, again[0]), again)}
    rich = {"train": ((0.0, right),), "test": ((right, last[0]), last)}
    return {
        "one leg": _of(job, walk.model_copy(update=one_leg)),
        "rich": _of(job, grid, walk.model_copy(update=rich)),
    }


def _swings(*doubles: tuple[float, float]) -> list[tuple[float, float]]:
    """Return when one foot alone carries: between double supports."""
    return [(before[1], after[0]) for before, after in itertools.pairwise(doubles)]


def _of(job: Job, *recordings: RecordingSection) -> Job:
    return job.model_copy(update={"recordings": recordings})


def together(job: Job) -> WholeOutcome:
    """Return the joint fit of a protocol."""
    fit = job.fit.model_copy(update={"scope": "whole body"})
    return calibrate_whole_body(job.model_copy(update={"fit": fit}))


def one_by_one(job: Job) -> Outcome:
    """Return the six separate fits; what the protocol judges on says nothing of one sensor."""
    *others, walk = job.recordings
    return calibrate(_of(job, *others, walk.model_copy(update={"test": ()})))


def _part(sensor: str) -> str:
    return sensor.removesuffix("_sensor").removesuffix("_ft")


def judged(job: Job, truth: Mapping[str, Any]) -> Judged:
    """Return the errors of all ways of calibrating in the test window of the last recording."""
    outcome, separate = together(job), one_by_one(job)
    by_part = {_part(one.sensor.name): one for one in separate.sensors}
    walk = job.recordings[-1]
    recording = logs.read(job.path(walk.log), walk.layout(), name=walk.label)
    errors: dict[str, dict[str, Errors]] = {
        way: {} for way in ("Workbench", "separate", "separate, deployed", "joint")
    }
    accepted, better = [], []
    for result, record in zip(outcome.fit.sensors, outcome.calibration.sensors, strict=True):
        part = _part(result.sensor.name)
        known = truth["sensors"][record.sensor]
        true = Law(np.array(known["gain"]), np.array(known["offsets"][walk.label]))
        signal = recording.channel(record.signal)
        seconds = recording.seconds(signal)
        start, stop = walk.test[-1]
        inside = (seconds >= start) & (seconds < stop)
        raw = result.channel.workbench.channels(signal.values[inside])
        alone = by_part[part]
        (segment,) = (s for s in alone.training if s.samples.recording == walk.label)
        ways = {
            "Workbench": alone.channel.workbench.gain,
            "separate": alone.fit.estimate.gain,
            "separate, deployed": alone.estimate.gain,
        }
        centre = segment.moments().mean
        laws = {way: Law(C, centre[-6:] - C @ centre[:6]) for way, C in ways.items()}
        offset = next(o.offset for o in record.offsets if o.recording == walk.label)
        laws["joint"] = Law(record.coefficients, np.array(offset))
        for way, law in laws.items():
            errors[way][part] = Errors.of(law.read(raw) - true.read(raw))
        for axis, verdict in enumerate(result.verdicts):
            if verdict.word == "ACCEPT":
                accepted.append((part, AXES[axis]))
                own, old = (errors[way][part].axes[axis] for way in COMPARED)
                better += [(part, AXES[axis])] if own < old else []
    kappa = outcome.fit.posterior.kappa
    return Judged(errors, tuple(accepted), tuple(better), kappa)


def run(seed: int, **how: float) -> dict[str, Judged]:
    """Return both protocols of one session."""
    with tempfile.TemporaryDirectory() as folder:
        file = session(Path(folder), seed, **how)
        truth = json.loads((file.parent / "truth.json").read_text(encoding="utf-8"))
        return {name: judged(job, truth) for name, job in protocols(read_job(file)).items()}


def line(some: Sequence[Judged], group: str, half: int) -> str:
    """Return mean and spread over the seeds of every way, and of the ratio that is asked for."""
    ways = list(some[0].errors)
    means = {way: np.array([one.mean(way, group, half) for one in some]) for way in ways}
    cells = [f"{way} {found.mean():.3g} ± {found.std():.2g}" for way, found in means.items()]
    ratio = means["separate"] / means["joint"]
    low, middle, high = np.quantile(ratio, (0.0, 0.5, 1.0))
    total = means["separate"].mean() / means["joint"].mean()
    unit = ("N ", "Nm")[half]
    return (
        f"  {group:<9} {unit}  {',  '.join(cells)};  separate over joint {total:.2f}"
        f" (by seed {low:.2f} to {high:.2f}, median {middle:.2f})"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--swing", type=float, default=30.0, help="seconds on each foot")
    parser.add_argument("--mass", type=float, default=0.0, help="share by which links weigh wrong")
    parser.add_argument("--com", type=float, default=0.0, help="wrong centres of mass [m]")
    told = parser.parse_args()
    how = {"mass": told.mass, "com": told.com, "swing": told.swing}
    found = []
    for seed in range(told.first, told.first + told.seeds):
        found.append(run(seed, **how))
        each = {
            name: [round(one.mean(way, "right leg", 0), 2) for way in one.errors]
            for name, one in found[-1].items()
        }
        print(f"seed {seed}: right leg [N] {each}", flush=True)
    for name in found[0]:
        some = [one[name] for one in found]
        accepted = sum(len(one.accepted) for one in some)
        better = sum(len(one.better) for one in some)
        strengths = sorted(one.kappa for one in some)
        print(
            f"\n{name}: {better} of {accepted} accepted axes beat the Workbench; kappa"
            f" {strengths[0]:.2g} to {strengths[-1]:.2g}"
        )
        for seed, one in enumerate(some, told.first):
            for part, axis in sorted({*one.accepted} - {*one.better}):
                own, old = (one.errors[way][part].axes[AXES.index(axis)] for way in COMPARED)
                print(f"  seed {seed}: {part} {axis} {own:.3g}, Workbench {old:.3g}")
        for group in GROUPS:
            for half in (0, 1):
                print(line(some, group, half))


if __name__ == "__main__":
    main()
