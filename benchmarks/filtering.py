"""Smoothing with two derivatives: one fused pass against three calls of scipy's `savgol_filter`.

Both run on one pinned core, in turn; figures are medians over the rounds, the ratios are medians
of the ratios of each round. `chunked` sends the rows through scratch that fits the cache, as
`ftcal.signals` does; `whole` writes one large result into memory that is reused, `fresh` allocates
it as scipy does (on a virtual machine that returns free pages to its host this costs more than the
filter). The error is that of the pass against scipy's
correlation with the same taps: the taps of scipy 1.x themselves are exact to 3e-11 only (window
81, order 4), those of ftcal to 1e-15. Run as `python benchmarks/filtering.py`.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time

import numpy as np

CHUNK = 2048
"""Rows of scratch at a time."""


def main() -> dict[str, float]:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--columns", type=int, default=32)
    parser.add_argument("--window", type=int, default=81)
    parser.add_argument("--order", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args()
    return measure(
        arguments.samples, arguments.columns, arguments.window, arguments.order, arguments.rounds
    )


def measure(samples: int, columns: int, window: int, order: int, rounds: int) -> dict[str, float]:
    """Print and return seconds, ratio and the largest difference relative to the signal."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    from scipy.ndimage import correlate1d
    from scipy.signal import savgol_filter

    from ftcal.filters import coefficients, smooth_and_derive

    step, half = 0.01, window // 2
    t = np.arange(samples)[:, None] * step
    values = np.sin(t * np.linspace(0.5, 3.0, columns))
    values += 1e-3 * np.random.default_rng(0).standard_normal(values.shape)

    begin = time.perf_counter()
    smooth_and_derive(values[:window], window, order, step)
    first = time.perf_counter() - begin

    out = np.zeros((3, samples - window + 1, columns))
    scratch = np.zeros((3, CHUNK, columns))

    def chunked() -> None:
        for at in range(0, samples - window + 1, CHUNK):
            rows = values[at : at + CHUNK + window - 1]
            if len(rows) == CHUNK + window - 1:
                smooth_and_derive(rows, window, order, step, out=scratch)
            else:
                smooth_and_derive(rows, window, order, step)

    def whole() -> None:
        smooth_and_derive(values, window, order, step, out=out)

    def fresh() -> None:
        smooth_and_derive(values, window, order, step)

    def scipy() -> None:
        for derivative in range(3):
            savgol_filter(values, window, order, derivative, step, axis=0)

    contenders = {"chunked": chunked, "whole": whole, "fresh": fresh, "scipy": scipy}
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, contender in contenders.items():
            begin = time.perf_counter()
            contender()
            seconds[name].append(time.perf_counter() - begin)
    error = 0.0
    for derivative, ours in enumerate(out):
        taps = coefficients(window, order, derivative, step)
        theirs = correlate1d(values, taps, axis=0)[half : samples - half]
        error = max(error, float(np.max(np.abs(ours - theirs)) / np.max(np.abs(theirs))))
    figures = {"first_call_s": first, "relative_error": error}
    for name, spent in seconds.items():
        figures[f"{name}_s"] = statistics.median(spent)
        ratios = (b / a for a, b in zip(spent, seconds["scipy"], strict=True))
        figures[f"{name}_ratio"] = statistics.median(ratios)
    print(f"{samples} x {columns}, window {window}, order {order}, {rounds} rounds")
    for name, figure in figures.items():
        print(f"{name:16s} {figure:.3g}")
    return figures


if __name__ == "__main__":
    main()
