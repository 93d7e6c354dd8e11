"""Expected wrenches: ftcal against per-sample loops over iDynTree and Pinocchio, one core.

    python benchmarks/wrenches.py --samples 400000 --rounds 7

Engines take turns within a round, so that a noisy neighbour slows all of them; figures are medians
over the rounds. The scalar loops run over a few thousand samples and are scaled.
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
from xml.etree import ElementTree

import icub_models
import idyntree.bindings as idyn
import numpy as np
import pinocchio as pin

from ftcal.dynamics import expected_wrenches
from ftcal.kernel import compile_wrenches
from ftcal.motion import STANDARD_GRAVITY, FixedContact, Motion
from ftcal.tree import grow
from ftcal.urdf import read_robot

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

MODEL = "iCubGazeboV2_7"
LEGS = ["l_leg_ft", "r_leg_ft"]
SCALAR_SAMPLES = 3000

Loop = Callable[[Motion], "dict[str, Float[Array, 'N 6']]"]


def idyntree_loop(path: Path, frame_name: str, sensors: list[str], joints: tuple[str, ...]) -> Loop:
    loader = idyn.ModelLoader()
    loader.loadModelFromFile(str(path))
    estimator = idyn.ExtWrenchesAndJointTorquesEstimator()
    estimator.setModel(loader.model())
    model = estimator.model()
    frame = model.getFrameIndex(frame_name)
    gravity = idyn.Vector3.FromPython(list(STANDARD_GRAVITY))
    unknowns = idyn.LinkUnknownWrenchContacts(model)
    unknowns.addNewUnknownFullWrenchInFrameOrigin(model, frame)
    readings = idyn.SensorsMeasurements(model.sensors())
    contacts = idyn.LinkContactWrenches(model)
    torques = idyn.JointDOFsDoubleArray(model)
    kind = idyn.SIX_AXIS_FORCE_TORQUE
    indices = [model.sensors().getSensorIndex(kind, name) for name in sensors]
    wrench = idyn.Wrench()
    order = [joints.index(model.getJointName(k)) for k in range(model.getNrOfDOFs())]

    def run(motion: Motion) -> dict[str, Float[Array, "N 6"]]:
        q, dq, ddq = (
            np.ascontiguousarray(signal[:, order])
            for signal in (motion.position, motion.velocity, motion.acceleration)
        )
        results = {name: np.empty((len(motion), 6)) for name in sensors}
        for n in range(len(motion)):
            estimator.updateKinematicsFromFixedBase(
                idyn.JointPosDoubleArray.FromPython(q[n]),
                idyn.JointDOFsDoubleArray.FromPython(dq[n]),
                idyn.JointDOFsDoubleArray.FromPython(ddq[n]),
                frame,
                gravity,
            )
            estimator.computeExpectedFTSensorsMeasurements(unknowns, readings, contacts, torques)
            for name, index in zip(sensors, indices, strict=True):
                readings.getMeasurement(kind, index, wrench)
                results[name][n] = wrench.toNumPy()
        return results

    return run


def pinocchio_loop(path: Path, sensors: list[str], joints: tuple[str, ...]) -> Loop:
    """Return rnea with the root fixed; each F/T joint has a degree of freedom that rests."""
    root = ElementTree.parse(path).getroot()
    fixed = {
        sensor.get("name"): parent.get("joint")
        for sensor in root.findall("sensor")
        for parent in sensor.findall("parent")
        if sensor.get("type") == "force_torque"
    }
    for joint in root.findall("joint"):
        if joint.get("name") in fixed.values():
            joint.set("type", "revolute")
            limits = {"lower": "-1", "upper": "1", "velocity": "1", "effort": "1"}
            ElementTree.SubElement(joint, "limit", limits)
    model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
    model.gravity.linear = np.array(STANDARD_GRAVITY)
    memory = model.createData()
    order = [(k, joints.index(n)) for k, n in enumerate(list(model.names)[1:]) if n in joints]
    to, of = [k for k, _ in order], [column for _, column in order]
    indices = {name: model.getJointId(fixed[name]) for name in sensors}

    def run(motion: Motion) -> dict[str, Float[Array, "N 6"]]:
        q, dq, ddq = np.zeros((3, len(motion), model.nv))
        q[:, to], dq[:, to] = motion.position[:, of], motion.velocity[:, of]
        ddq[:, to] = motion.acceleration[:, of]
        results = {name: np.empty((len(motion), 6)) for name in sensors}
        for n in range(len(motion)):
            pin.rnea(model, memory, q[n], dq[n], ddq[n])
            for name, index in indices.items():
                results[name][n] = memory.f[index].vector
        return results

    return run


def seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main(samples: int = 400_000, rounds: int = 7) -> dict[str, float]:
    """Print the table and return the ratios by name."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    path = Path(icub_models.get_model_file(MODEL))
    robot = read_robot(path)
    joints = robot.moving_joints
    rng = np.random.default_rng(0)
    motion = Motion(
        np.arange(samples) * 0.01, joints, *(rng.normal(size=(samples, len(joints))) for _ in "qva")
    )
    few = motion.rows(slice(SCALAR_SAMPLES))
    every = list(robot.sensors)
    ratios: dict[str, float] = {}
    print(f"{'case':<28}{'engine':<12}{'ksamples/s':>12}{'ftcal is x faster':>20}")
    for case, link, sensors in (
        ("both legs", "root_link", LEGS),
        ("all six", "root_link", every),
        ("all six, on the sole", "l_sole", every),
    ):
        contact = FixedContact(link)
        tree = grow(robot, link, sensors)
        compiling = partial(compile_wrenches, tree, STANDARD_GRAVITY)
        ratios[f"{case}: compile [s]"] = seconds(compiling)
        loops = {"iDynTree": idyntree_loop(path, link, sensors, joints)}
        if link == robot.root:
            loops["Pinocchio"] = pinocchio_loop(path, sensors, joints)
        ours = partial(expected_wrenches, robot, contact=contact, sensors=sensors)
        reference = ours(few)
        for name, loop in loops.items():
            for sensor, wrench in loop(few.rows(slice(50))).items():
                agrees = np.allclose(abs(wrench), abs(reference[sensor][:50]), 1e-6, 1e-6)
                if name == "iDynTree" and not agrees:
                    raise SystemExit(f"{name} disagrees on {sensor}")
        each: dict[str, list[float]] = {name: [] for name in ("ftcal", "NumPy", *loops)}
        for _ in range(rounds):
            each["ftcal"].append(seconds(partial(ours, motion)) / samples)
            each["NumPy"].append(seconds(partial(ours, few, engine="numpy")) / len(few))
            for name, loop in loops.items():
                each[name].append(seconds(partial(loop, few)) / len(few))
        for name, times in each.items():
            ratio = median(t / own for t, own in zip(times, each["ftcal"], strict=True))
            if name != "ftcal":
                ratios[f"{case}: {name}"] = ratio
            print(f"{case:<28}{name:<12}{1e-3 / median(times):>12.0f}{ratio:>20.1f}")
        print(f"{case:<28}{'compile':<12}{ratios[f'{case}: compile [s]']:>10.2f} s")
    return ratios


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=400_000)
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args()
    main(arguments.samples, arguments.rounds)
