"""100 lambdas on 8 recordings, against one least squares a lambda and samples.

    python benchmarks/fitting.py --samples 7500

Two references: what an engineer writes (centre, stack, append the penalty's rows, `lstsq`), and the
normal equations as the paper's MATLAB code has them: `R'R + lambda I` against `R'W + lambda C'`,
formed anew for each lambda. Ours starts from moments or, counted in, from the samples.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from measure import Benchmark, Record, interleaved

from ftcal.moments import Moments, within
from ftcal.ridge import penalty_path
from ftcal.sensor import Workbench

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

RECORDINGS, LAMBDAS = 8, 100


def measure(samples: int, rounds: int) -> list[Record]:
    """Return the ratios by reference, moments ready or not."""
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

    moments = [Moments.of(table) for table in tables]

    def ours(ready: list[Moments]) -> Float[Array, "L 6 6"]:
        return np.array([e.gain for e in penalty_path(within(ready), workbench, lambdas)])

    def from_samples() -> Float[Array, "L 6 6"]:
        return ours([Moments.of(table) for table in tables])

    def stacked() -> Float[Array, "L 6 6"]:
        rows = np.concatenate([table - table.mean(axis=0) for table in tables])
        gains = []
        for weight in lambdas:
            root = np.sqrt(6 * len(rows) * weight) * np.eye(6)
            design = np.concatenate([rows[:, :6], root])
            target = np.concatenate([rows[:, 6:], root @ gain.T])
            gains.append(np.linalg.lstsq(design, target, rcond=None)[0].T)
        return np.array(gains)

    def normal() -> Float[Array, "L 6 6"]:
        rows = np.concatenate([table - table.mean(axis=0) for table in tables])
        gains = []
        for weight in lambdas:
            held = 6 * len(rows) * weight
            A = rows[:, :6].T @ rows[:, :6] + held * np.eye(6)
            gains.append(np.linalg.solve(A, rows[:, :6].T @ rows[:, 6:] + held * gain.T).T)
        return np.array(gains)

    found = ours(moments)
    references: dict[str, Callable[[], Float[Array, "L 6 6"]]] = {
        "lstsq, each lambda": stacked, "normal equations": normal,
    }  # fmt: skip
    for name, reference in references.items():
        if not np.allclose(found, reference(), rtol=0, atol=1e-8 * abs(gain).max()):
            raise SystemExit(f"{name} finds another matrix")
    ways: dict[str, Callable[[], object]] = {
        "from moments": partial(ours, moments),
        "from samples": from_samples,
    }
    times = interleaved({**ways, **references}, rounds)
    size = f"{RECORDINGS} recordings of {samples} samples"
    return [
        Record.of(f"{LAMBDAS} penalties, {way}", name, size, ours=times[way], theirs=times[name])
        for way in ways
        for name in references
    ]


BENCHMARK = Benchmark(measure, {"samples": 7500, "rounds": 7}, {"samples": 100, "rounds": 1})

if __name__ == "__main__":
    BENCHMARK.main(__doc__)
