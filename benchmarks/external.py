"""External wrenches and joint torques: ftcal against a per-sample loop over iDynTree, one core.

    python benchmarks/external.py --samples 200000 --rounds 7

Both take turns within a round, so that a noisy neighbour slows both; figures are medians over the
rounds. The loop runs over a few thousand samples and is scaled.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import icub_models
import idyntree.bindings as idyn
import numpy as np

from ftcal.external import compiled, external_wrenches, staged
from ftcal.motion import STANDARD_GRAVITY, FixedContact, Motion
from ftcal.urdf import read_robot

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

MODEL = "iCubGazeboV2_7"
SCALAR_SAMPLES = 2000

Readings = dict[str, "Float[Array, 'N 6']"]
Loop = Callable[[Motion, Readings], "tuple[Readings, Float[Array, 'N J']]"]


def idyntree_loop(
    path: Path, contact: str, sensors: list[str], links: list[str], joints: tuple[str, ...]
) -> Loop:
    """Return its estimate of the wrench at the origin of each of `links`, and of the torques."""
    loader = idyn.ModelLoader()
    loader.loadModelFromFile(str(path))
    estimator = idyn.ExtWrenchesAndJointTorquesEstimator()
    estimator.setModel(loader.model())
    model = estimator.model()
    frame = model.getFrameIndex(contact)
    gravity = idyn.Vector3.FromPython(list(STANDARD_GRAVITY))
    unknowns = idyn.LinkUnknownWrenchContacts(model)
    indices = [model.getLinkIndex(name) for name in links]
    for name in links:
        unknowns.addNewUnknownFullWrenchInFrameOrigin(model, model.getFrameIndex(name))
    measured = idyn.SensorsMeasurements(model.sensors())
    contacts = idyn.LinkContactWrenches(model)
    torques = idyn.JointDOFsDoubleArray(model)
    kind = idyn.SIX_AXIS_FORCE_TORQUE
    channels = [model.sensors().getSensorIndex(kind, name) for name in sensors]
    order = [joints.index(model.getJointName(k)) for k in range(model.getNrOfDOFs())]
    back = np.argsort(order)

    def run(motion: Motion, readings: Readings) -> tuple[Readings, Float[Array, "N J"]]:
        q, dq, ddq = (
            np.ascontiguousarray(signal[:, order])
            for signal in (motion.position, motion.velocity, motion.acceleration)
        )
        wrenches = {name: np.empty((len(motion), 6)) for name in links}
        torque = np.empty((len(motion), len(order)))
        for n in range(len(motion)):
            estimator.updateKinematicsFromFixedBase(
                idyn.JointPosDoubleArray.FromPython(q[n]),
                idyn.JointDOFsDoubleArray.FromPython(dq[n]),
                idyn.JointDOFsDoubleArray.FromPython(ddq[n]),
                frame,
                gravity,
            )
            for name, channel in zip(sensors, channels, strict=True):
                measured.setMeasurement(kind, channel, idyn.Wrench.FromPython(readings[name][n]))
            estimator.estimateExtWrenchesAndJointTorques(unknowns, measured, contacts, torques)
            for name, index in zip(links, indices, strict=True):
                wrenches[name][n] = contacts.contactWrench(index, 0).contactWrench.toNumPy()
            torque[n] = torques.toNumPy()
        return wrenches, torque[:, back]

    return run


def seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main(samples: int = 200_000, rounds: int = 7) -> dict[str, float]:
    """Print the table and return the ratios by case."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    path = Path(icub_models.get_model_file(MODEL))
    robot = read_robot(path)
    joints, sensors = robot.moving_joints, list(robot.sensors)
    links = [model.name for model in robot.sub_models()]
    rng = np.random.default_rng(0)
    motion = Motion(
        np.arange(samples) * 0.01, joints, *(rng.normal(size=(samples, len(joints))) for _ in "qva")
    )
    readings = {name: 100.0 * rng.normal(size=(samples, 6)) for name in sensors}
    few = motion.rows(slice(SCALAR_SAMPLES))
    few_readings = {name: reading[:SCALAR_SAMPLES] for name, reading in readings.items()}
    ratios: dict[str, float] = {}
    print(f"{'contact':<12}{'engine':<12}{'ksamples/s':>12}{'ftcal is x faster':>20}")
    for link in ("root_link", "l_sole"):
        ours = partial(external_wrenches, robot, contact=FixedContact(link))
        stage = staged(robot, link, tuple(sensors), None, joints)
        compiling = seconds(partial(compiled, stage, STANDARD_GRAVITY))
        loop = idyntree_loop(path, link, sensors, links, joints)
        theirs, torque = loop(few, few_readings)
        found = ours(motion=few, readings=few_readings)
        columns = [joints.index(name) for name in found.joints]
        pairs = [(found.wrench[name], theirs[name]) for name in links]
        for own, other in [*pairs, (found.torque, torque[:, columns])]:
            if not np.allclose(own, other, rtol=0, atol=1e-8 * abs(other).max()):
                raise SystemExit("iDynTree disagrees")
        each: dict[str, list[float]] = {"ftcal": [], "NumPy": [], "iDynTree": []}
        for _ in range(rounds):
            each["ftcal"].append(seconds(partial(ours, motion=motion, readings=readings)) / samples)
            numpy = partial(ours, motion=few, readings=few_readings, engine="numpy")
            each["NumPy"].append(seconds(numpy) / len(few))
            each["iDynTree"].append(seconds(partial(loop, few, few_readings)) / len(few))
        for name, times in each.items():
            ratio = median(t / own for t, own in zip(times, each["ftcal"], strict=True))
            if name != "ftcal":
                ratios[f"{link}: {name}"] = ratio
            print(f"{link:<12}{name:<12}{1e-3 / median(times):>12.0f}{ratio:>20.1f}")
        print(f"{link:<12}{'compile':<12}{compiling:>10.2f} s")
    return ratios


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=200_000)
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args()
    main(arguments.samples, arguments.rounds)
