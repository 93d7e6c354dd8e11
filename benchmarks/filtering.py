"""Smoothing with two derivatives: one fused pass against three calls of scipy's `savgol_filter`.

    python benchmarks/filtering.py --samples 1000000 --columns 32 --window 81 --order 4

`in chunks` sends the rows through scratch that fits the cache, as `ftcal.signals` does; `whole`
writes one large result into memory that is reused, `fresh` allocates it as scipy does (on a virtual
machine that returns free pages to its host this costs more than the filter). The numbers must be
those of scipy's correlation with the same taps: the taps of scipy 1.x themselves are exact to 3e-11
only (window 81, order 4), those of ftcal to 1e-15.
"""

from __future__ import annotations

import numpy as np
from measure import Benchmark, Record, interleaved
from scipy.ndimage import correlate1d
from scipy.signal import savgol_filter

from ftcal.filters import coefficients, smooth_and_derive

CHUNK = 2048
"""Rows of scratch at a time."""
STEP = 0.01
"""Period [s]."""
ROUNDING = 1e-12
"""Largest difference from scipy's correlation, relative to the largest number."""


def measure(samples: int, columns: int, window: int, order: int, rounds: int) -> list[Record]:
    """Return the ratios of the three ways to run the filter."""
    t = np.arange(samples)[:, None] * STEP
    values = np.sin(t * np.linspace(0.5, 3.0, columns))
    values += 1e-3 * np.random.default_rng(0).standard_normal(values.shape)
    last = samples - window + 1
    out = np.zeros((3, last, columns))
    scratch = np.zeros((3, CHUNK, columns))

    def chunked() -> None:
        for at in range(0, last, CHUNK):
            count = min(CHUNK, last - at)
            rows = values[at : at + count + window - 1]
            filtered = scratch.reshape(-1)[: 3 * count * columns].reshape(3, count, columns)
            smooth_and_derive(rows, window, order, STEP, out=filtered)

    def whole() -> None:
        smooth_and_derive(values, window, order, STEP, out=out)

    def fresh() -> None:
        smooth_and_derive(values, window, order, STEP)

    def scipy() -> None:
        for derivative in range(3):
            savgol_filter(values, window, order, derivative, STEP, axis=0)

    whole()
    half = window // 2
    for derivative, ours in enumerate(out):
        taps = coefficients(window, order, derivative, STEP)
        theirs = correlate1d(values, taps, axis=0)[half : samples - half]
        if not np.allclose(ours, theirs, rtol=0, atol=ROUNDING * abs(theirs).max()):
            raise SystemExit(f"derivative {derivative} is not that of scipy")
    ways = {"in chunks": chunked, "whole": whole, "fresh": fresh}
    times = interleaved({**ways, "scipy": scipy}, rounds)
    size = f"{samples} x {columns}, window {window}, order {order}"
    return [
        Record.of(f"smoothing, two derivatives, {way}", "scipy, three calls", size,
                  ours=times[way], theirs=times["scipy"])
        for way in ways
    ]  # fmt: skip


BENCHMARK = Benchmark(
    measure,
    {"samples": 1_000_000, "columns": 32, "window": 81, "order": 4, "rounds": 7},
    {"samples": 5_000, "columns": 4, "window": 81, "order": 4, "rounds": 1},
)

if __name__ == "__main__":
    BENCHMARK.main(__doc__)
