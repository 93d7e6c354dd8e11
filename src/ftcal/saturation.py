"""Saturation: a raw channel at the end of its range, as its counts tell.

The counts are in the log, or behind it where the matrix in the firmware is known. Firmware stops
all six outputs while one channel is beyond its range, so that a repetition tells before the ceiling
does.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.blocks import Block
from ftcal.recording import Signal
from ftcal.stretches import Runs, stretches_of

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

CEILING = 31_600
"""Raw reading [counts] beyond which a channel is at the end of its range."""

NEAR_CEILING = 30_000
"""Raw reading from which a repetition of all six outputs means saturation: the ceiling differs from
channel to channel (31 566 to 31 794 on iCubGenova02), and a fast one is missed by a step."""

BEYOND_TORQUE = 3000.0
"""Magnitude that no channel in N or Nm reaches."""


def logs_counts(signal: Signal) -> bool:
    """Return whether an F/T signal holds raw counts: whole numbers, some beyond any torque."""
    whole = Whole()
    whole.see(signal.values.T)
    return whole.counts


@dataclass(slots=True)
class Whole:
    """Whether the numbers of a signal are whole, as counts are."""

    so_far: bool = True
    """Whether all finite ones are."""
    largest: float = 0.0
    """Magnitude of the largest finite one."""

    def see(self, columns: Float[Array, "K B"]) -> None:
        """Take note of the next samples; nothing is news after the first that is not whole."""
        start = columns[:, :1]
        self.so_far &= bool((~np.isfinite(start) | (start == np.rint(start))).all())
        if self.so_far:
            finite = columns[np.isfinite(columns)]
            self.so_far = bool((finite == np.rint(finite)).all())
            self.largest = max(self.largest, float(np.abs(finite).max(initial=0.0)))

    @property
    def counts(self) -> bool:
        """Whether they are whole, and some beyond any torque."""
        return self.so_far and self.largest > BEYOND_TORQUE


def may_saturate(
    to_counts: Float[Array, "6 6"], low: Float[Array, "6"], high: Float[Array, "6"]
) -> bool:
    """Return whether a wrench between `low` and `high` [N, Nm] may lie behind a near ceiling.

    `to_counts` is the inverse of the firmware's matrix; NaN says that anything may be.
    """
    with np.errstate(invalid="ignore"):  # infinity less infinity
        middle = np.abs(to_counts @ (0.5 * (low + high)))
        farthest = middle + np.abs(to_counts) @ (0.5 * (high - low))
    return not (farthest < NEAR_CEILING - 1).all()  # a count is more than any rounding


def counts_behind(
    to_counts: Float[Array, "6 6"], columns: Float[Array, "6 B"]
) -> Float[Array, "6 B"]:
    """Return the raw readings behind wrenches [N, Nm], the same however many there are."""
    counts = np.zeros(columns.shape)
    with np.errstate(invalid="ignore"):  # infinity less infinity
        for share, column in zip(to_counts.T, columns, strict=True):
            counts += share[:, None] * column
    return counts


@dataclass(slots=True)
class Ceiling:
    """Where a raw channel is at the end of its range."""

    channels: int
    peaks: Float[Array, "K"] = field(init=False)
    """Largest magnitude of each raw channel while one is at its end [counts]."""
    runs: Runs = field(default_factory=lambda: Runs(1))

    def __post_init__(self) -> None:
        self.peaks = np.zeros(self.channels)

    def see(self, block: Block, places: Int[Array, "R"], counts: Float[Array, "K B"]) -> None:
        """Take note of the raw readings of a block; those at `places` repeat the one before.

        At the end of the range are readings beyond `CEILING`, and those beyond `NEAR_CEILING` that
        repeat or are repeated.
        """
        size = np.abs(counts)
        reading = size.max(axis=0)
        held = places[reading[places] >= NEAR_CEILING]
        top = np.flatnonzero(reading[block.before :] >= CEILING) + block.before
        at_end = np.union1d(np.union1d(top, held), held - 1)
        self.peaks = np.maximum(self.peaks, size[:, at_end].max(axis=1, initial=0.0))
        self.runs.add(stretches_of(block, at_end))

    @property
    def why(self) -> str:
        """Which channel went farthest, and how far."""
        return f"raw channel {self.peaks.argmax() + 1} reaches {self.peaks.max():.0f} counts"
