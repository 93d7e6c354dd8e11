"""Expected wrenches: ftcal against per-sample loops over iDynTree and Pinocchio, one core.

    python benchmarks/wrenches.py --samples 400000 --rounds 7

Engines take turns within a round, so that a noisy neighbour slows all of them; figures are medians
over the rounds. The scalar loops run over a few thousand samples and are scaled.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import icub_models
import numpy as np
import pinocchio as pin
from loops import ExpectedLoop, Wrenches, expected_loop
from measure import Benchmark, Record, interleaved, seconds_of

from ftcal.dynamics import expected_wrenches
from ftcal.kernel import compile_wrenches
from ftcal.motion import STANDARD_GRAVITY, FixedContact, Motion
from ftcal.tree import grow
from ftcal.urdf import read_robot

MODEL = "iCubGazeboV2_7"
LEGS = ["l_leg_ft", "r_leg_ft"]
SCALAR_SAMPLES = 3000


def pinocchio_loop(path: Path, sensors: list[str], joints: tuple[str, ...]) -> ExpectedLoop:
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

    def run(motion: Motion) -> Wrenches:
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


def measure(samples: int, rounds: int) -> list[Record]:
    """Return the ratios by sensors, contact and engine."""
    path = Path(icub_models.get_model_file(MODEL))
    robot = read_robot(path)
    joints = robot.moving_joints
    rng = np.random.default_rng(0)
    motion = Motion(
        np.arange(samples) * 0.01, joints, *(rng.normal(size=(samples, len(joints))) for _ in "qva")
    )
    few = motion.rows(slice(min(samples, SCALAR_SAMPLES)))
    every = list(robot.sensors)
    records = []
    for case, link, sensors in (
        ("wrenches of both legs", "root_link", LEGS),
        ("wrenches of all six", "root_link", every),
        ("wrenches of all six, on the sole", "l_sole", every),
    ):
        tree = grow(robot, link, sensors)
        compiling = seconds_of(partial(compile_wrenches, tree, STANDARD_GRAVITY))
        print(f"{case}: the kernel is compiled in {compiling:.2f} s")
        loops = {"iDynTree, loop": expected_loop(path, link, sensors, joints)}
        if link == robot.root:
            loops["Pinocchio, loop"] = pinocchio_loop(path, sensors, joints)
        ours = partial(expected_wrenches, robot, contact=FixedContact(link), sensors=sensors)
        reference = ours(few)
        for name, loop in loops.items():
            for sensor, wrench in loop(few.rows(slice(50))).items():
                # Pinocchio's frame of a sensor is its joint's: lengths agree, not components
                both = (wrench, reference[sensor][:50])
                if name.startswith("Pinocchio"):
                    both = tuple(np.linalg.norm(one[:, :3], axis=1) for one in both)
                if not np.allclose(*both, rtol=1e-6, atol=1e-6):
                    raise SystemExit(f"{name} disagrees on {sensor}")
        times = interleaved(
            {"ftcal": partial(ours, motion)}
            | {name: partial(loop, few) for name, loop in loops.items()},
            rounds,
        )
        records += [
            Record.of(case, name, f"{samples} samples", ours=times["ftcal"], theirs=times[name],
                      times=samples / len(few))
            for name in loops
        ]  # fmt: skip
    return records


BENCHMARK = Benchmark(measure, {"samples": 400_000, "rounds": 7}, {"samples": 200, "rounds": 1})

if __name__ == "__main__":
    BENCHMARK.main(__doc__)
