"""A scenario → a simulated session in a folder, ready for `ftcal calibrate`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ftcal.demonstration import icub_path
from ftcal.posture import balance_margin
from ftcal.progress import Progress, Steps, silent
from ftcal.robot import Robot
from ftcal.scenario import Scenario
from ftcal.scenes import Scene
from ftcal.synthetic import Conditions, Session, invent_firmware, simulate, write_session
from ftcal.synthetic.session import serial
from ftcal.urdf import read_robot

if TYPE_CHECKING:
    from ftcal.firmware import FirmwareMatrix

CHECKED = 20.0
"""Postures a second whose balance is looked at."""


@dataclass(frozen=True, slots=True)
class Written:
    """One recording of a session, for a person to look over."""

    name: str
    seconds: float
    samples: int
    """Of all its sensors."""
    balance: float | None
    """How near the centre of mass comes to the edge of a sole that carries all [m]; negative:
    beyond. None where no sole is given."""


def stage(
    scenario: Scenario, folder: Path, *, seed: int | None = None, progress: Progress = silent
) -> tuple[Path, tuple[Written, ...]]:
    """Simulate a scenario and write it into `folder`; return its job file and its recordings.

    `seed` overrides that of the file. Every take draws from a stream of its own: changing one
    leaves the motions of the others as they are. Errors are those of `ftcal.motions`,
    `ftcal.synthetic.simulate` and `write_session`.
    """
    steps = Steps(progress, len(scenario.takes) + 2)
    urdf = _urdf(scenario)
    robot = read_robot(urdf)
    chance = np.random.default_rng(scenario.seed if seed is None else seed)
    scenes = []
    for section, own in zip(scenario.takes, chance.spawn(len(scenario.takes)), strict=True):
        steps.begin(f"moving {section.name}")
        scenes.append(section.scene(robot, own))
    steps.begin("simulating")
    session = simulate(
        robot,
        [scene.take for scene in scenes],
        sensors={sensor.name: sensor.signal for sensor in scenario.sensors},
        generator=chance,
        firmware=_boards(scenario, chance),
        conditions=Conditions(**scenario.conditions.model_dump()),
        faults=scenario.asked(),
    )
    steps.begin("writing")
    job = write_session(session, folder, urdf=urdf, form=scenario.format)
    return job, tuple(_written(session, scenes))


def as_lines(written: Sequence[Written]) -> list[str]:
    """Return one line a recording: its name, length, samples and balance."""
    width = max(len(one.name) for one in written)
    return [
        f"{one.name:<{width}}  {one.seconds:6.1f} s  {one.samples:7d} samples"
        + ("" if one.balance is None else f"  balance {1e3 * one.balance:.0f} mm")
        for one in written
    ]


def as_record(job: Path, written: Iterable[Written]) -> dict[str, Any]:
    """Return what was written as plain records."""
    return {"job": str(job), "recordings": [asdict(one) for one in written]}


def _urdf(scenario: Scenario) -> Path:
    if scenario.robot is not None:
        return scenario.file.parent / scenario.robot
    return icub_path(scenario.model or "")


def _boards(scenario: Scenario, generator: np.random.Generator) -> dict[str, FirmwareMatrix]:
    """Return the boards of the sensors whose full scale is given."""
    return {
        sensor.name: invent_firmware(generator, serial=serial(number), full_scale=sensor.full_scale)
        for number, sensor in enumerate(scenario.sensors)
        if sensor.full_scale is not None
    }


def _written(session: Session, scenes: Iterable[Scene]) -> Iterable[Written]:
    for scene, recording in zip(scenes, session.recordings, strict=True):
        yield Written(
            recording.name,
            recording.duration,
            sum(len(signal) for signal in recording.channels),
            _balance(session.robot, scene),
        )


def _balance(robot: Robot, scene: Scene) -> float | None:
    """Return the least balance margin [m] on any sole while it carries all."""
    trajectory = scene.take.trajectory
    time = np.arange(int(trajectory.duration * CHECKED) + 1) / CHECKED
    motion, support = trajectory.at(time), scene.take.support
    shares = support.at(time)
    margins = [
        balance_margin(robot, motion.rows(alone), sole).min()
        for sole in scene.soles
        if (alone := shares[:, support.frames.index(sole.frame)] > 1.0 - 1e-9).any()
    ]
    return float(min(margins)) if margins else None
