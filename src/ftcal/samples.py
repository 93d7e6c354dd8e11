"""Channels of one sensor paired with the wrench its model says it should have felt.

A `Samples` is one stretch of one recording during which the offset is one unknown (the paper's
assumption "the offset does not change during the experiment"): an offset segment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError
from ftcal.moments import Moments
from ftcal.thinning import thinning_step

if TYPE_CHECKING:
    from jaxtyping import Bool, Float
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True)
class Samples:
    """One offset segment of one sensor, usable samples only."""

    recording: str
    start: float
    """Seconds since the start of the recording."""
    stop: float
    """Seconds since the start of the recording, exclusive."""
    time: Float[Array, "N"]
    """Seconds since the start of the recording, increasing; holes are simply absent."""
    channels: Float[Array, "N K"]
    """r, smoothed as the wrench is."""
    wrench: Float[Array, "N 6"]
    """Model wrench at the sensor [N, Nm], smoothed as the channels are."""
    temperature: Float[Array, "N"] | None = None
    """T - T_ref [K], or None where none was logged."""

    def __post_init__(self) -> None:
        finite = np.isfinite(self.channels).all() and np.isfinite(self.wrench).all()
        if self.temperature is not None:
            finite = finite and bool(np.isfinite(self.temperature).all())
        if not finite:
            raise DataError(
                f"recording {self.recording!r}, {self.start:g}-{self.stop:g} s: channels, wrench"
                " or temperature are not finite; cut those samples"
            )

    def __len__(self) -> int:
        return len(self.time)

    @property
    def label(self) -> str:
        """Name for tables and messages."""
        return f"{self.recording} {self.start:g}-{self.stop:g} s"

    def rows(self) -> Float[Array, "N D"]:
        """Return the table `[channels, temperature, wrench]` whose moments a fit needs."""
        inputs = [self.channels]
        if self.temperature is not None:
            inputs.append(self.temperature[:, None])
        return np.concatenate([*inputs, self.wrench], axis=1)

    def moments(self) -> Moments:
        """Return the moments of `rows`."""
        return Moments.of(self.rows())

    def between(self, start: float, stop: float) -> Samples:
        """Return the samples in [start, stop)."""
        first, last = np.searchsorted(self.time, [start, stop])
        some = slice(int(first), int(last))
        return Samples(
            self.recording,
            start,
            stop,
            self.time[some],
            self.channels[some],
            self.wrench[some],
            None if self.temperature is None else self.temperature[some],
        )

    def moved(self, channels: Float[Array, "K"], temperature: float = 0.0) -> Samples:
        """Return the samples with something added to the channels and the temperature [K]."""
        warm = self.temperature
        return replace(
            self,
            channels=self.channels + channels,
            temperature=None if warm is None else warm + temperature,
        )

    def thinned(self, most: int) -> Samples:
        """Return every so-manieth sample, at most `most` of them."""
        return self.where(slice(None, None, thinning_step(len(self), most)))

    def where(self, some: slice | Bool[Array, "N"]) -> Samples:
        """Return some of the samples of the same stretch."""
        warm = self.temperature
        return replace(
            self,
            time=self.time[some],
            channels=self.channels[some],
            wrench=self.wrench[some],
            temperature=None if warm is None else warm[some],
        )


def sample_count(segments: Sequence[Samples]) -> int:
    """Return the number of samples of all segments."""
    return sum(len(segment) for segment in segments)
