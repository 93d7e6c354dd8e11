"""The balances of a recording: ftcal against scipy and iDynTree asked sample by sample, one core.

    python benchmarks/balances.py --samples 100000 --rounds 5

A balance of a sub-model needs, for every sample, what the readings on its border must add up to and
the transform of each reading. Ours is `ftcal.balances.balances`, from joint positions. Theirs:
`savgol_filter` with its derivatives, the estimator of external wrenches with readings of zero, and
`KinDynComputations` for the transforms; over a few thousand samples, scaled.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import icub_models
import numpy as np
from loops import external_loop, transform_loop
from measure import Benchmark, Record, interleaved
from scipy.signal import savgol_filter

from ftcal.balances import Balance, balances, free_sub_models
from ftcal.contact import ContactSchedule, Interval
from ftcal.motion import STANDARD_GRAVITY, Motion
from ftcal.pairing import FtChannel, SignalOptions
from ftcal.recording import Recording, Signal
from ftcal.run_filter import odd_window
from ftcal.sensor import AXES, Workbench
from ftcal.urdf import read_robot

MODEL = "iCubGazeboV2_7"
CONTACT = "l_sole"
PERIOD = 0.01
SCALAR_SAMPLES = 2000
CHECKED = 300
ROUNDING = 1e-8
"""Largest difference relative to the largest number: second derivatives of two filters' taps."""


def recorded(joints: tuple[str, ...], sensors: list[str], samples: int) -> Recording:
    """Return slow waves of every joint beside noise of every sensor."""
    rng = np.random.default_rng(0)
    stamps = 1_700_000_000_000_000_000 + round(PERIOD * 1e9) * np.arange(samples)
    waves = rng.uniform(0.1, 1.5, (2, len(joints)))
    q = 0.3 * np.sin(np.arange(samples)[:, None] * PERIOD * waves[0] + waves[1])
    channels = (Signal(name, AXES, stamps, rng.normal(size=(samples, 6))) for name in sensors)
    whole = (Signal("state", joints, stamps, q),)
    return Recording("waves", "", int(stamps[0]), whole, tuple(channels))


def cut(recording: Recording, samples: int) -> Recording:
    """Return the first samples of a recording."""

    def some(signal: Signal) -> Signal:
        return Signal(signal.name, signal.columns, signal.stamps[:samples], signal.values[:samples])

    joints, channels = (tuple(map(some, s)) for s in (recording.joints, recording.channels))
    return Recording(recording.name, "", recording.start, joints, channels)


def measure(samples: int, rounds: int) -> list[Record]:
    """Return the ratio for all sub-models that are free on one foot."""
    path = Path(icub_models.get_model_file(MODEL))
    robot = read_robot(path)
    joints, sensors = robot.moving_joints, list(robot.sensors)
    free = free_sub_models(robot, sensors, [CONTACT])
    borders = [
        (model.name, robot.sensor(name).child, robot.sensor(name).child_H_sensor)
        for model in free
        for name in model.sensors
    ]
    wrenches = external_loop(
        path, CONTACT, sensors, [model.name for model in robot.sub_models()], joints
    )
    transforms = transform_loop(path, borders, joints)
    options = SignalOptions()
    window = odd_window(options.joint_window, PERIOD)
    inner = slice(window // 2, -(window // 2))
    workbench = Workbench("as logged", np.eye(6), np.full(6, 1000.0), "channels")
    channels = [FtChannel(name, name, workbench) for name in sensors]
    schedule = ContactSchedule((Interval(-np.inf, np.inf, CONTACT),))

    def ours(recording: Recording) -> tuple[Balance, ...]:
        return balances(recording, robot, channels, schedule, gravity=STANDARD_GRAVITY)

    def theirs(recording: Recording) -> tuple[dict[str, np.ndarray], list[np.ndarray]]:
        (signal,) = recording.joints
        moved = [
            savgol_filter(signal.values, window, options.joint_order, order, PERIOD, axis=0)[inner]
            for order in range(3)
        ]
        motion = Motion(recording.seconds(signal)[inner], joints, *moved)
        silent = {name: np.zeros((len(motion), 6)) for name in sensors}
        return wrenches(motion, silent)[0], transforms(motion)

    recording = recorded(joints, sensors, samples)
    short = cut(recording, CHECKED)
    found, (required, moves) = ours(short), theirs(short)
    own = {(one.sub_model, name): X for one in found for name, X in one.transforms.items()}
    keys = [(model.name, name) for model in free for name in model.sensors]
    pairs = [(one.required, required[one.sub_model]) for one in found]
    pairs += [(abs(own[key]), abs(X)) for key, X in zip(keys, moves, strict=True)]
    for one, other in pairs:
        if not np.allclose(one, other, rtol=0, atol=ROUNDING * abs(other).max()):
            raise SystemExit(f"iDynTree disagrees by {abs(one - other).max():.1e}")
    few = cut(recording, SCALAR_SAMPLES)
    calls: dict[str, Callable[[], object]] = {
        "ftcal": partial(ours, recording),
        "theirs": partial(theirs, few),
    }
    times = interleaved(calls, rounds)
    scale = samples / len(few.joints[0])
    name, size = f"balances of {len(free)} free sub-models", f"{samples} samples"
    return [Record.of(name, "scipy, iDynTree loop", size, ours=times["ftcal"],
                      theirs=times["theirs"], times=scale)]  # fmt: skip


BENCHMARK = Benchmark(measure, {"samples": 100_000, "rounds": 5}, {"samples": 400, "rounds": 1})

if __name__ == "__main__":
    BENCHMARK.main(__doc__)
