"""100 lambdas on 8 recordings from their moments, against one least squares a lambda and samples.

The reference is what an engineer writes: centre, stack, append the penalty's rows, `lstsq`. Both
run on one pinned core, in turn; medians over the rounds. Run as `python benchmarks/fitting.py`.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time

import numpy as np

from ftcal.moments import Moments, within
from ftcal.ridge import penalty_path
from ftcal.sensor import Workbench

RECORDINGS, LAMBDAS = 8, 100


def main() -> dict[str, float]:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=7500, help="of each recording")
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args()
    return measure(arguments.samples, arguments.rounds)


def measure(samples: int, rounds: int) -> dict[str, float]:
    """Print and return seconds, ratio and the largest difference relative to the gain."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    rng = np.random.default_rng(0)
    scale = np.array([1500.0, 1800.0, 2100.0, 37.0, 38.0, 24.0])
    gain = scale[:, None] * rng.normal(size=(6, 6)) / 32767
    workbench = Workbench("invented", gain, scale)
    tables = []
    for _ in range(RECORDINGS):
        channels = rng.normal(size=(samples, 6)) * 300 + rng.normal(size=6) * 1e4
        wrench = channels @ (gain * 1.03).T + rng.normal(size=(samples, 6))
        tables.append(np.concatenate([channels, wrench], axis=1))
    lambdas = np.geomspace(0.1, 1e3, LAMBDAS)

    begin = time.perf_counter()
    moments = [Moments.of(table) for table in tables]
    once = time.perf_counter() - begin

    def ours() -> np.ndarray:
        return np.array([e.gain for e in penalty_path(within(moments), workbench, lambdas)])

    def stacked() -> np.ndarray:
        rows = np.concatenate([table - table.mean(axis=0) for table in tables])
        gains = []
        for weight in lambdas:
            root = np.sqrt(6 * len(rows) * weight) * np.eye(6)
            design = np.concatenate([rows[:, :6], root])
            target = np.concatenate([rows[:, 6:], root @ gain.T])
            gains.append(np.linalg.lstsq(design, target, rcond=None)[0].T)
        return np.array(gains)

    seconds: dict[str, list[float]] = {"moments": [], "lstsq": []}
    for _ in range(rounds):
        for name, contender in (("moments", ours), ("lstsq", stacked)):
            begin = time.perf_counter()
            contender()
            seconds[name].append(time.perf_counter() - begin)
    ratios = (b / a for a, b in zip(seconds["moments"], seconds["lstsq"], strict=True))
    figures = {
        "take_moments_s": once,
        "moments_s": statistics.median(seconds["moments"]),
        "lstsq_s": statistics.median(seconds["lstsq"]),
        "ratio": statistics.median(ratios),
        "relative_error": float(np.abs(ours() - stacked()).max() / np.abs(gain).max()),
    }
    print(f"{RECORDINGS} recordings of {samples} samples, {LAMBDAS} lambdas, {rounds} rounds")
    for name, figure in figures.items():
        print(f"{name:16s} {figure:.3g}")
    return figures


if __name__ == "__main__":
    main()
