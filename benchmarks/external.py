"""External wrenches and joint torques: ftcal against a per-sample loop over iDynTree, one core.

    python benchmarks/external.py --samples 200000 --rounds 7

With readings of zero the same kernel gives the balances of a fit: `balances` of a recording spends
its time there. The loop runs over a few thousand samples and is scaled.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import icub_models
import numpy as np
from loops import external_loop
from measure import Benchmark, Record, interleaved, seconds_of

from ftcal.external import compiled, external_wrenches, staged
from ftcal.motion import STANDARD_GRAVITY, FixedContact, Motion
from ftcal.urdf import read_robot

MODEL = "iCubGazeboV2_7"
SCALAR_SAMPLES = 2000


def measure(samples: int, rounds: int) -> list[Record]:
    """Return the ratios by contact."""
    path = Path(icub_models.get_model_file(MODEL))
    robot = read_robot(path)
    joints, sensors = robot.moving_joints, list(robot.sensors)
    links = [model.name for model in robot.sub_models()]
    rng = np.random.default_rng(0)
    motion = Motion(
        np.arange(samples) * 0.01, joints, *(rng.normal(size=(samples, len(joints))) for _ in "qva")
    )
    readings = {name: 100.0 * rng.normal(size=(samples, 6)) for name in sensors}
    few = motion.rows(slice(min(samples, SCALAR_SAMPLES)))
    few_readings = {name: reading[: len(few)] for name, reading in readings.items()}
    records = []
    for link in ("root_link", "l_sole"):
        ours = partial(external_wrenches, robot, contact=FixedContact(link))
        stage = staged(robot, link, tuple(sensors), None, joints)
        compiling = seconds_of(partial(compiled, stage, STANDARD_GRAVITY))
        print(f"external wrenches, {link}: the kernel is compiled in {compiling:.2f} s")
        loop = external_loop(path, link, sensors, links, joints)
        theirs, torque = loop(few, few_readings)
        found = ours(motion=few, readings=few_readings)
        columns = [joints.index(name) for name in found.joints]
        pairs = [(found.wrench[name], theirs[name]) for name in links]
        for own, other in [*pairs, (found.torque, torque[:, columns])]:
            if not np.allclose(own, other, rtol=0, atol=1e-8 * abs(other).max()):
                raise SystemExit("iDynTree disagrees")
        calls: dict[str, Callable[[], object]] = {
            "ftcal": partial(ours, motion=motion, readings=readings),
            "iDynTree": partial(loop, few, few_readings),
        }
        times = interleaved(calls, rounds)
        name = f"external wrenches, torques, {link}"
        records.append(
            Record.of(name, "iDynTree, loop", f"{samples} samples", ours=times["ftcal"],
                      theirs=times["iDynTree"], times=samples / len(few))
        )  # fmt: skip
    return records


BENCHMARK = Benchmark(measure, {"samples": 200_000, "rounds": 7}, {"samples": 200, "rounds": 1})

if __name__ == "__main__":
    BENCHMARK.main(__doc__)
