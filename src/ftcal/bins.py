"""A balance averaged over short spans of time, and what uncalibrated sensors leave over in it.

The law is linear: readings and model averaged alike leave the same maps between them, with less
noise and fewer rows (`ftcal.pairing` smooths for the same reason).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.balances import Balance
from ftcal.contact import Interval
from ftcal.misfit import lengths

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array

KAPPA = 0.05
"""A sensor bent by its mounting is off by this share of the load in every entry (method 4: the
scaled prior of a real iCub sensor is 0.03)."""

LEVER = 0.025
"""Full scale of torque over that of force [m]: the size of a sensor (iCub 0.02, ATI Gamma 0.08)."""

MODEL = 0.05
"""Share by which masses and centres of mass of a rightful URDF are off: cables and covers."""

RESOLUTION = 1e-3
"""Drift and hysteresis of a sensor, as a share of the weight of the robot that it must carry."""

NORMAL_MEDIAN = 0.6745
"""Median distance from the mean of a normal distribution, in standard deviations."""

BIN, MOST_BINS = 0.2, 2000
"""Readings and model are averaged alike over bins of this length [s]; longer in long logs."""

LEAST_BINS = 10
"""A balance is left out of a block in which it has fewer bins."""


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """A balance averaged over short spans of time."""

    time: Float[Array, "M"]
    """Seconds since the start of the recording."""
    block: Int[Array, "M"]
    """Index of the block each lies in."""
    required: Float[Array, "M 6"]
    """What the readings must add up to [N, Nm]."""
    carried: dict[str, Float[Array, "M 6 6"]]
    """Transforms of the readings."""
    readings: dict[str, Float[Array, "M 6"]]
    """As logged [N, Nm]."""
    length: float
    """Of a bin [s]."""

    def about_mean(self, values: Float[Array, "M 6"]) -> Float[Array, "M 6"]:
        """Return values about the mean of their block."""
        centred = np.array(values)
        for number in np.unique(self.block):
            centred[self.block == number] -= values[self.block == number].mean(axis=0)
        return centred

    def enough(self, keep: Bool[Array, "M"]) -> Bool[Array, "M"]:
        """Return which bins lie in a block that keeps `LEAST_BINS`."""
        return np.asarray(np.bincount(self.block, keep)[self.block] >= LEAST_BINS)

    def rows(self, keep: Bool[Array, "M"]) -> Bins:
        """Return some of the bins."""
        return Bins(
            self.time[keep],
            self.block[keep],
            self.required[keep],
            {name: X[keep] for name, X in self.carried.items()},
            {name: y[keep] for name, y in self.readings.items()},
            self.length,
        )


def averaged(balance: Balance, blocks: Sequence[Interval], duration: float) -> Bins:
    """Return the bins of a balance; a bin lies in one block."""
    length = max(BIN, duration / MOST_BINS)
    of_row = np.searchsorted([i.start for i in blocks], balance.time, side="right") - 1
    number = np.floor(balance.time / length).astype(np.int64)
    new = np.append(True, (np.diff(number) != 0) | (np.diff(of_row) != 0))
    first = np.flatnonzero(new)
    count = np.diff(np.append(first, len(new)))

    def mean(values: Float[Array, "N *K"]) -> Float[Array, "M *K"]:
        total = np.add.reduceat(values, first, axis=0)
        return np.asarray(total / count.reshape(-1, *(1 for _ in values.shape[1:])))

    return Bins(
        mean(balance.time),
        of_row[first],
        mean(balance.required),
        {name: mean(X) for name, X in balance.transforms.items()},
        {name: mean(values) for name, values in balance.inputs.items()},
        length,
    )


def usual(balance: Balance, bins: Bins, loose: float, weight: float) -> Float[Array, "6 6"]:
    """Return the covariance [N, Nm] of what a rightly described part leaves over uncalibrated.

    That of bent sensors (`KAPPA`), of a model a little off (`MODEL`) or partly of unknown pose
    (`loose`, a share of its mass), and of noise.
    """
    scale = np.repeat([1.0, LEVER], 3)
    found = np.diag((MODEL**2 + loose**2) * spread(bins.about_mean(bins.required)) ** 2)
    for name, X in bins.carried.items():
        load = bins.about_mean(bins.readings[name]) / scale
        bend = KAPPA**2 * (load**2).sum(axis=1).mean()
        raw = balance.inputs[name] / scale
        # second differences of white noise have six times its variance
        rough = np.median(np.abs(np.diff(raw, 2, axis=0)), axis=0) / NORMAL_MEDIAN
        noise = (rough**2).mean() / 6 * len(bins.time) / len(raw)
        here = X * scale
        size = bend + noise + (RESOLUTION * weight) ** 2
        found += size * (here @ here.swapaxes(1, 2)).mean(axis=0)
    return np.asarray(found)


def spread(wrench: Float[Array, "N 6"]) -> Float[Array, "6"]:
    """Return the RMS length of force and torque, thrice each."""
    return np.repeat(lengths(wrench), 3)
