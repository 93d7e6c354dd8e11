"""All sensors of a humanoid at once: seconds and memory for a million samples.

    python benchmarks/whole_body.py [--samples 1000000]

A simulated iCub with six sensors; one balanced motion of a minute and a half is told again and
again, with stamps that go on, in recordings of a hundred thousand samples.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from ftcal import logs
from ftcal.all_sensors import calibrate_all
from ftcal.config import read_job
from ftcal.pipeline import ft_channel
from ftcal.progress import Steps, silent
from ftcal.recording import NANOSECONDS, Recording, Signal
from ftcal.scenario import read_scenario
from ftcal.staging import stage
from ftcal.urdf import read_robot

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1_000_000)
    wanted = parser.parse_args().samples
    sensors = "".join(
        f'[[sensors]]\nname = "{part}_ft"\nsignal = "{part}/analog:o"\n' for part in PARTS
    )
    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / "scenario.toml"
        scenario.write_text(SCENARIO.format(sensors=sensors))
        file, _ = stage(read_scenario(scenario), Path(folder) / "session")
        job = read_job(file)
        section = job.recordings[0]
        recording = logs.read(job.path(section.log), section.layout(), name="wide")
        robot = read_robot(job.path(job.robot))
        channels = [ft_channel(job, robot, sensor) for sensor in job.sensors]
    each = min(wanted, LONGEST)
    count = max(1, wanted // each)
    length = len(recording.channels[0])
    takes = [told_again(recording, -(-each // length), f"wide {k}") for k in range(count)]
    windows = {"train": ((60.0, 1e9),), "test": ((0.0, 50.0),)}
    sections = tuple(section.model_copy(update={"name": t.name, **windows}) for t in takes)
    job = job.model_copy(update={"recordings": sections})
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    begun = time.perf_counter()
    nothing: list[tuple[()]] = [() for _ in takes]
    steps = Steps(silent, 2 * len(takes) + 3)
    fit = calibrate_all(job, robot, channels, takes, nothing, steps)
    seconds = time.perf_counter() - begun
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    total = sum(len(take.channels[0]) for take in takes)
    print(f"{total} samples of {len(channels)} sensors in {count} recordings")
    print(
        f"{seconds:.1f} s, {seconds / total * 1e6:.1f} us a sample; kappa {fit.posterior.kappa:.3g}"
    )
    print(f"peak memory {after:.0f} MB, of which {before:.0f} MB before the fit (the logs)")


if __name__ == "__main__":
    main()
