"""How far a score may be chance: held-out blocks of time are drawn anew, many times.

B. Efron, R. Tibshirani, *An Introduction to the Bootstrap*, 1993: percentile intervals as in
section 13.3, blocks as in section 8.6, for a block of time repeats much of the same information.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

BLOCK = 2.0
"""Length [s] of the blocks that the bootstrap resamples: longer than the smoothing remembers."""

MOST_BLOCKS = 500
"""More blocks tell the interval no better: they get longer instead."""

RESAMPLES = 2000
"""Bootstrap resamples: the ends of a 90 % interval then move by about 1 % of its width."""


def block_starts(at: Float[Array, "N"], begin: float, stop: float, block: float) -> Int[Array, "B"]:
    """Return the rows of increasing times `at` where blocks of about `block` seconds begin.

    They divide [begin, stop]; what holds no row is no block.
    """
    count = max(1, round((stop - begin) / block))
    width = max((stop - begin) / count, np.finfo(float).tiny)
    index = np.minimum(((at - begin) / width).astype(np.int64), count - 1)
    return np.flatnonzero(np.diff(index, prepend=-1))


@lru_cache(maxsize=8)
def resampled(blocks: int, seed: int) -> Float[Array, "R B"]:
    """Return how often each block is drawn in each bootstrap resample; kept, not to be changed."""
    drawn = np.random.default_rng(seed).integers(blocks, size=(RESAMPLES, blocks))
    drawn += blocks * np.arange(RESAMPLES)[:, None]
    often = np.bincount(drawn.ravel(), minlength=drawn.size).reshape(drawn.shape).astype(np.float64)
    often.flags.writeable = False
    return often


def bootstrap_intervals(
    new: Float[Array, "B G"], old: Float[Array, "B G"], weights: Float[Array, "R B"]
) -> list[tuple[float, float]]:
    """Return the 90 % interval of `100 sqrt(sum new / sum old)` over resampled blocks, per column.

    Fewer than three blocks say nothing: (0, inf).
    """
    if len(new) < 3:
        return [(0.0, float("inf"))] * new.shape[1]
    drawn_new, drawn_old = np.split(weights @ np.concatenate([new, old], axis=1), 2, axis=1)
    ratio = np.sqrt(drawn_new / np.maximum(drawn_old, np.finfo(float).tiny))
    low, high = 100.0 * np.quantile(ratio, [0.05, 0.95], axis=0)
    return [(float(a), float(b)) for a, b in zip(low, high, strict=True)]
