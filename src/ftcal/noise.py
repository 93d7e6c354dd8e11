"""What a fit leaves over: how large, and how many samples repeat the same information.

Neighbouring samples of a smoothed log are not independent. Their statistical inefficiency
`1 + 2 sum rho_k` (A. Sokal, "Monte Carlo methods in statistical mechanics", 1997, section 3) says
how many of them count as one; standard errors use the number of independent samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

SOKAL_WINDOW = 5.0
"""Lags are summed up to this many autocorrelation times."""

LONGEST = 32768
"""Samples that are transformed at a time: they stay in the cache."""


@dataclass(frozen=True, slots=True)
class Noise:
    """What a good fit leaves over, per axis."""

    sd: Float[Array, "6"]
    """Standard deviation of the residual [N, Nm]."""
    inefficiency: Float[Array, "6"]
    """How many samples carry the information of one independent sample (>= 1)."""


def autocovariance(series: Float[Array, "N D"]) -> Float[Array, "N D"]:
    """Return the sum of `x_t x_(t+k)` over t for every lag k, per column (not centred)."""
    length = len(series)
    size = 1 << (2 * length - 1).bit_length()
    spectrum = np.fft.rfft(series, size, axis=0)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, size, axis=0)[:length])


def inefficiency(pieces: Sequence[Float[Array, "N D"]]) -> Float[Array, "D"]:
    """Return `1 + 2 sum rho_k` per column of residuals that come in several stretches.

    The autocovariances of the stretches are pooled; lags are summed in Sokal's window. Long
    stretches are taken in parts of `LONGEST` samples, far longer than any residual remembers.
    """
    width = pieces[0].shape[1] if len(pieces) else 6
    pieces = [part[i : i + LONGEST] for part in pieces for i in range(0, len(part), LONGEST)]
    longest = max((len(piece) for piece in pieces), default=0)
    if longest < 2:
        return np.ones(width)
    pooled = np.zeros((longest, width))
    for piece in pieces:
        if len(piece):
            pooled[: len(piece)] += autocovariance(piece)
    rho = pooled / np.where(pooled[0] > 0, pooled[0], 1.0)
    times = 2.0 * np.cumsum(rho, axis=0) - 1.0
    enough = np.arange(longest)[:, None] >= SOKAL_WINDOW * times
    last = np.where(enough.any(axis=0), enough.argmax(axis=0), longest - 1)
    return np.asarray(np.maximum(np.take_along_axis(times, last[None], axis=0)[0], 1.0))
