"""A pretend study, made in memory: two sensors or more beside one free sub-chain, truth known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import pretend
from ftcal.balances import Balance
from ftcal.config import Job
from ftcal.first_validation import first_validation
from ftcal.offset import InSituOffset
from ftcal.pairing import FtChannel
from ftcal.preparation import Prepared, SensorTake
from ftcal.recording import Finding
from ftcal.robot import FtSensor, Joint, Link, Robot
from ftcal.samples import Samples
from ftcal.second_validation import judging_balance, second_validation
from ftcal.study import SensorStudy, StudyOutcome, in_all_chains, run_laws

TRAINING = ("Balancing", "gridMin30", "ExtBal1")
SENSORS = ("r_leg_ft", "r_foot_ft")
LAMBDAS = (0.0, 1.0, 10.0)
RUN = "switching"


def take_of(samples: Samples, *, still: bool) -> SensorTake:
    """Return one sensor in one recording; its raw offset is known where the robot keeps `still`."""
    spread = 0.0 if still else 0.03
    offset = InSituOffset(np.zeros(samples.channels.shape[1]), 0.0, 0.0, spread, 1.0)
    return SensorTake((samples,), (offset,), samples, (0,) * 6)


def a_recording(
    name: str, gains: dict[str, np.ndarray], rng: np.random.Generator, *, count: int
) -> dict[str, Samples]:
    """Return what every sensor felt: little and on few axes where its name is Balancing."""
    narrow = name.startswith("Balancing")
    return {
        sensor: pretend.samples(
            gain,
            rng,
            count=count,
            recording=name,
            axes=3 if narrow else 6,
            share=0.0008 if narrow else 0.05,
            noise=1e-3,
        )
        for sensor, gain in gains.items()
    }


def a_robot(name: str, sensors: Sequence[str]) -> Robot:
    body = {n: Link(n, 1.0, np.zeros(3), np.eye(3)) for n in ("base", *sensors)}
    joints = {
        s: Joint(s, "fixed", "base", s, np.eye(4), np.array([0.0, 0.0, 1.0])) for s in sensors
    }
    return Robot(name, "base", body, joints, {}, "00" * 32)


def a_balance(run: dict[str, Samples], rng: np.random.Generator) -> Balance:
    """Return a sub-chain that all sensors border, the first pulling at it, the others leaving."""
    first, *_ = run
    sides = {name: 1.0 if name == first else -1.0 for name in run}
    wrenches = {name: samples.wrench for name, samples in run.items()}
    size = len(run[first])
    needed = sum(side * wrenches[name] for name, side in sides.items())
    model_error = 0.5 + 0.3 * rng.normal(size=(size, 6))
    return Balance(
        "shank",
        run[first].time,
        {name: samples.channels for name, samples in run.items()},
        {name: np.tile(side * np.eye(6), (size, 1, 1)) for name, side in sides.items()},
        np.asarray(needed + model_error),
    )


def an_outcome(
    name: str = "",
    *,
    training: Sequence[str] = TRAINING,
    sensors: Sequence[str] = SENSORS,
    lambdas: Sequence[float] = LAMBDAS,
    count: int = 800,
    switching: bool = True,
    known: bool = True,
) -> StudyOutcome:
    """Return what a study gives; `name` is part of every name that a log or a robot gives."""
    rng = np.random.default_rng(11)
    label = f"{RUN}{name}"
    recordings = [f"{one}{name}" for one in training]
    workbench = replace(pretend.workbench(), name=f"SN000{name}")
    sensors = [f"{sensor}{name}" for sensor in sensors]
    truth = {sensor: pretend.bent(workbench, rng) for sensor in sensors}
    felt = {one: a_recording(one, truth, rng, count=count) for one in recordings}
    found: tuple[Balance, ...] = ()
    if switching:
        felt[label] = a_recording(label, truth, rng, count=2 * count)
        found = (a_balance(felt[label], rng),)
    findings = (
        Finding("serial", f"leg{name}", 0.0, 20.0, False, f"lies on the lattice of SN000{name}"),
        Finding("frozen", f"leg{name}", 10.5, 11.0, True, f"leg{name}: frozen from 10.5 to 11 s"),
    )
    takes = tuple(
        Prepared(
            one,
            20.0,
            "ab" * 32,
            findings if one == recordings[0] else (),
            {s: take_of(samples, still=one.startswith("grid")) for s, samples in felt[one].items()},
            found if one == label else (),
        )
        for one in felt
    )
    channels = [FtChannel(sensor, f"{sensor}/analog:o", workbench) for sensor in sensors]
    contacts = [
        {"start": 0.0, "stop": 10.0, "link": f"l_sole{name}"},
        {"start": 12.0, "stop": 30.0, "link": [f"l_sole{name}", "r_sole"]},
    ]
    job = Job.model_validate(
        {
            "robot": "robot.urdf",
            "sensors": [{"name": c.sensor, "signal": c.signal} for c in channels],
            "recordings": [
                {"log": f"logs/{one}", "name": one, "contact": "base"}
                if one != label
                else {"log": f"logs/{one}", "name": one, "contacts": contacts}
                for one in felt
            ],
            "study": {"lambdas": lambdas} | ({"switching": label} if switching else {}),
        }
    )
    studies = [
        SensorStudy(
            FtSensor(c.sensor, c.sensor, "base", c.sensor, "child", "parent", np.eye(4)),
            c,
            first := first_validation(
                {take.name: take.sensors[c.sensor] for take in takes},
                recordings,
                recordings,
                workbench,
            ),
            second_validation(
                c.sensor,
                first,
                judging_balance(c.sensor, found),
                run_laws(takes[-1], channels),
                takes[-1].sensors[c.sensor].aligning,
                workbench,
                lambdas,
            )
            if switching
            else None,
        )
        for c in channels
    ]
    chains = in_all_chains(takes[-1], studies, truth if known else {}) if switching else ()
    robot = a_robot(f"walker{name}", sensors)
    return StudyOutcome(job, robot, takes, tuple(studies), chains, truth if known else {})
