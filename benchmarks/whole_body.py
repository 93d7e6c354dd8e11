"""All sensors of a humanoid at once: seconds and memory for a million samples.

    python benchmarks/whole_body.py [--samples 1000000]

A simulated iCub with six sensors; one balanced motion of a minute and a half is told again and
again, with stamps that go on, in recordings of a hundred thousand samples.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from pyarrow import parquet

from ftcal import logs
from ftcal.config import read_job
from ftcal.logs import tables
from ftcal.recording import NANOSECONDS, Recording, Signal
from ftcal.scenario import read_scenario
from ftcal.staging import stage

SCENARIO = """
model = "iCubGenova04"
seed = 1
{sensors}
[[takes]]
name = "wide"
motion = "extended balancing"
contact = "l_sole"
joints = ["r_hip_pitch", "r_hip_roll", "r_hip_yaw", "r_knee", "r_ankle_pitch", "r_ankle_roll"]
support = ["l_hip_pitch", "l_hip_roll", "l_knee", "l_ankle_pitch", "l_ankle_roll"]
sole = {{}}
duration = 100
"""
TAKE = """
[[recordings]]
log = "wide {}"
contact = "l_sole"
train = [[60.0, 1e9]]
test = [[0.0, 50.0]]
"""
PARTS = [f"{side}_{part}" for side in ("l", "r") for part in ("arm", "leg", "foot")]
LONGEST = 100_000


def told_again(recording: Recording, times: int, name: str) -> Recording:
    """Return a recording that repeats itself, as long as `times` of it."""

    def repeated(signal: Signal) -> Signal:
        span = round((recording.duration + 0.02) * NANOSECONDS)
        stamps = np.concatenate([signal.stamps + k * span for k in range(times)])
        return replace(signal, stamps=stamps, values=np.tile(signal.values, (times, 1)))

    return replace(
        recording,
        name=name,
        joints=tuple(map(repeated, recording.joints)),
        channels=tuple(map(repeated, recording.channels)),
    )


def make(folder: Path, wanted: int) -> None:
    """Write a job and its recordings of `wanted` samples in all."""
    sensors = "".join(
        f'[[sensors]]\nname = "{part}_ft"\nsignal = "{part}/analog:o"\n' for part in PARTS
    )
    scenario = folder / "scenario.toml"
    scenario.write_text(SCENARIO.format(sensors=sensors))
    file, _ = stage(read_scenario(scenario), folder / "session")
    job = read_job(file)
    section = job.recordings[0]
    recording = logs.read(job.path(section.log), section.layout(), name="wide")
    each = min(wanted, LONGEST)
    count = max(1, wanted // each)
    for k in range(count):
        take = told_again(recording, -(-each // len(recording.channels[0])), f"wide {k}")
        tables.write(take, folder / f"wide {k}")
    about_robot = file.read_text().split("[[recordings]]")[0].replace('= "', '= "session/', 1)
    about_robot = about_robot.replace('workbench = "', 'workbench = "session/')
    (folder / "job.toml").write_text(
        about_robot + '[fit]\nscope = "whole body"\n' + "".join(map(TAKE.format, range(count)))
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1_000_000)
    wanted = parser.parse_args().samples
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home)
        # apart: a child's peak memory begins with that of its parent
        maker = multiprocessing.get_context("spawn").Process(target=make, args=(folder, wanted))
        maker.start()
        maker.join()
        begun = time.perf_counter()
        command = [sys.executable, "-m", "ftcal.cli", "calibrate", str(folder / "job.toml")]
        with subprocess.Popen(
            [*command, "--json", "-o", str(folder / "out")], stdout=subprocess.DEVNULL
        ) as run:
            _, _, used = os.wait4(run.pid, 0)
            run.returncode = 0
        seconds = time.perf_counter() - begun
        made = json.loads((folder / "out" / "metrics.json").read_text())
        logged = sum(
            parquet.read_metadata(file).num_rows
            for file in folder.glob(f"wide */{PARTS[0]}*.parquet")
        )
    print(f"{logged} samples of {len(PARTS)} sensors in {len(made['recordings'])} recordings")
    print(
        f"{seconds:.1f} s, {seconds / logged * 1e6:.1f} us a sample, reading and report included;"
        f" kappa {made['prior']['kappa']:.3g}"
    )
    print(f"peak memory {used.ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
