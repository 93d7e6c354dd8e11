"""A million rows of six sensors: Parquet in, calibration out, against an engineer's script.

    python benchmarks/end_to_end.py --rows 1000000 --rounds 3
    python benchmarks/end_to_end.py --profile 200000    # where our time goes

A simulated iCub on its left foot, arms and free leg moving, so that each of six sensors has a half
that touches nothing; a session of a hundred seconds is told again and again, in recordings of a
hundred thousand rows, 69 columns each. Ours is `ftcal.pipeline.calibrate`, which chooses its prior
by cross-validation, scores it and looks for faults besides. Theirs reads with pyarrow, filters with
scipy, asks iDynTree sample by sample, and fits with `lstsq`: no prior, no scores, no checks. Its
loop runs over a few thousand samples of every recording and its time is scaled to all of them.

Before the clock starts both calibrate a short recording in full, ours with lambda = 0: their
matrices must agree.
"""

from __future__ import annotations

import cProfile
import pstats
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from loops import expected_loop
from measure import Benchmark, Record, pinned, seconds_of
from pyarrow import parquet
from scipy.signal import savgol_filter

from ftcal import logs
from ftcal.config import Job, read_job
from ftcal.logs import tables
from ftcal.motion import Motion
from ftcal.pipeline import calibrate
from ftcal.recording import Recording, Signal
from ftcal.run_filter import odd_window
from ftcal.scenario import read_scenario
from ftcal.staging import stage
from ftcal.urdf import read_robot

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

SCENARIO = """
model = "iCubGenova04"
seed = 1
{sensors}
[conditions]
jitter = 0
stagger = 0

[[takes]]
name = "wide"
motion = "extended balancing"
contact = "l_sole"
joints = [
    "r_hip_pitch", "r_hip_roll", "r_hip_yaw", "r_knee", "r_ankle_pitch", "r_ankle_roll",
    "l_shoulder_pitch", "l_shoulder_roll", "l_elbow",
    "r_shoulder_pitch", "r_shoulder_roll", "r_elbow",
]
support = ["l_hip_pitch", "l_hip_roll", "l_knee", "l_ankle_pitch", "l_ankle_roll"]
sole = {{}}
duration = 100
"""
CONTACT = "l_sole"
PARTS = [f"{side}_{part}" for side in ("l", "r") for part in ("arm", "leg", "foot")]
LONGEST = 100_000
"""Rows of a recording."""
SLICE = 500
"""Samples of every recording that the loop over iDynTree runs over."""
CHECKED = 3_000
"""Rows on which both must agree."""

Wrenches = dict[str, "Float[Array, 'N 6']"]
Loop = Callable[[Motion], Wrenches]


@dataclass(frozen=True, slots=True)
class Session:
    """The logs, and the job that tells of them."""

    job: Job
    files: tuple[Path, ...]
    """Parquet, one a recording."""
    rows: int
    """Of all of them."""


def simulated(folder: Path) -> tuple[Path, Recording]:
    """Return the job file of a session of a hundred seconds, and what it logged on one clock."""
    sensors = "".join(
        f'[[sensors]]\nname = "{part}_ft"\nsignal = "{part}/analog:o"\n' for part in PARTS
    )
    scenario = folder / "scenario.toml"
    scenario.write_text(SCENARIO.format(sensors=sensors))
    file, _ = stage(read_scenario(scenario), folder / "session")
    job = read_job(file)
    section = job.recordings[0]
    return file, logs.read(job.path(section.log), section.layout(), name="wide")


def lasting(recording: Recording, rows: int, name: str) -> Recording:
    """Return the first `rows` of a recording that repeats itself without a pause."""

    def repeated(signal: Signal) -> Signal:
        period = int(signal.stamps[1] - signal.stamps[0])
        stamps = signal.stamps[0] + period * np.arange(rows)
        return replace(
            signal, stamps=stamps, values=np.resize(signal.values, (rows, signal.values.shape[1]))
        )

    joints, channels = (
        tuple(map(repeated, role)) for role in (recording.joints, recording.channels)
    )
    return replace(recording, name=name, joints=joints, channels=channels)


def written(file: Path, recording: Recording, rows: int, fit: str = "") -> Session:
    """Write logs of so many rows in all beside the job of the session, and their own job."""
    text = [file.read_text().split("[[recordings]]")[0], fit]
    files = []
    for start in range(0, rows, LONGEST):
        name = f"take {rows} {start}"
        files.append(file.with_name(f"{name}.parquet"))
        take = lasting(recording, min(LONGEST, rows - start), name)
        layout = tables.write(take, files[-1])
        channels = ", ".join(f'"{s}" = {list(c)}' for s, c in layout.channels.items())
        text.append(
            f'[[recordings]]\nlog = "{files[-1].name}"\ncontact = "{CONTACT}"\n'
            f"channels = {{ {channels} }}\n"
        )
    job = file.with_name(f"job {rows}.toml")
    job.write_text("\n".join(text))
    return Session(read_job(job), tuple(files), rows)


def by_hand(session: Session, loop: Loop) -> dict[str, Float[Array, "6 6"]]:
    """Return the matrix by which an engineer corrects what each sensor logs: an offset a take."""
    settings = session.job.signals
    robot = read_robot(session.job.path(session.job.robot))
    columns_of = session.job.recordings[0].channels
    names = {robot.sensor(s.name).name: columns_of[s.signal] for s in session.job.sensors}
    pairs: dict[str, list[tuple[Array, Array]]] = {name: [] for name in names}
    for file in session.files:
        log = parquet.read_table(file)
        stamps = log["time"].to_numpy().astype(np.int64)
        period = float(np.median(np.diff(stamps))) / 1e9
        window = odd_window(settings.joint_window, period)
        joints = robot.moving_joints
        positions = np.column_stack([log[name].to_numpy() for name in joints])
        moved = [
            savgol_filter(positions, window, settings.joint_order, order, period, axis=0)
            for order in range(3)
        ]
        felt = loop(Motion(stamps / 1e9, joints, *moved))
        short = odd_window(settings.smoothing, period)
        edge = slice(window // 2 + short // 2, -(window // 2 + short // 2))
        for name, columns in names.items():
            read = np.column_stack([log[column].to_numpy() for column in columns])
            pair = [
                savgol_filter(values, short, settings.smoothing_order, axis=0)[edge]
                for values in (read, felt[name])
            ]
            pairs[name].append((pair[0] - pair[0].mean(axis=0), pair[1] - pair[1].mean(axis=0)))
    found = {}
    for name, some in pairs.items():
        read, felt_all = (np.concatenate(half) for half in zip(*some, strict=True))
        found[name] = np.linalg.lstsq(read, felt_all, rcond=None)[0].T
    return found


def sliced(loop: Loop, most: int, owed: list[float]) -> Loop:
    """Return a loop that runs over the first `most` samples and repeats their wrenches.

    What the samples left out would have taken [s] is added to `owed`.
    """

    def run(motion: Motion) -> Wrenches:
        few = motion.rows(slice(most))
        start = time.perf_counter()
        found = loop(few)
        owed.append((time.perf_counter() - start) * (len(motion) / len(few) - 1))
        return {name: np.resize(wrench, (len(motion), 6)) for name, wrench in found.items()}

    return run


def agree(file: Path, recording: Recording, loop: Loop) -> None:
    """Stop unless both find the same matrices in a short recording."""
    session = written(file, recording, CHECKED, "[fit]\nlambda = 0\n")
    theirs = by_hand(session, loop)
    for sensor in calibrate(session.job).sensors:
        workbench = sensor.channel.workbench.gain
        own = sensor.fit.estimate.gain @ np.linalg.inv(workbench)
        other = theirs[sensor.sensor.name]
        if not np.allclose(own, other, rtol=0, atol=1e-6 * abs(other).max()):
            raise SystemExit(
                f"{sensor.sensor.name}: the matrices differ by {abs(own - other).max():.1e}"
            )


def measure(rows: int, rounds: int) -> list[Record]:
    """Return the ratio of the whole way."""
    with tempfile.TemporaryDirectory() as folder:
        file, recording = simulated(Path(folder))
        job = read_job(file)
        urdf = job.path(job.robot)
        robot = read_robot(urdf)
        sensors = [robot.sensor(section.name).name for section in job.sensors]
        loop = expected_loop(urdf, CONTACT, sensors, robot.moving_joints)
        agree(file, recording, loop)
        session = written(file, recording, rows)
        calibrate(session.job)
        owed: list[float] = []
        slow = sliced(loop, SLICE, owed)
        ours, theirs = [], []
        for _ in range(rounds):
            owed.clear()
            ours.append(seconds_of(partial(calibrate, session.job)))
            theirs.append(seconds_of(partial(by_hand, session, slow)) + sum(owed))
        columns = len(parquet.read_schema(session.files[0]).names)
    size = f"{rows} rows of {columns} columns"
    name, against = "Parquet to calibration, six sensors", "scipy, iDynTree loop"
    return [Record.of(name, against, size, ours=ours, theirs=theirs)]


def profiled(rows: int) -> None:
    """Print where our time goes, kernels compiled and files in the page cache before."""
    with tempfile.TemporaryDirectory() as folder:
        file, recording = simulated(Path(folder))
        session = written(file, recording, rows)
        calibrate(session.job)
        profile = cProfile.Profile()
        profile.runcall(calibrate, session.job)
        pstats.Stats(profile).sort_stats("cumulative").print_stats("ftcal", 40)


BENCHMARK = Benchmark(measure, {"rows": 1_000_000, "rounds": 3}, {"rows": 5_000, "rounds": 1})

if __name__ == "__main__":
    if sys.argv[1:2] == ["--profile"]:
        pinned()
        profiled(int(sys.argv[2]))
    else:
        BENCHMARK.main(__doc__)
