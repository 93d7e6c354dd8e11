"""The lattice that a board leaves in its readings: multiples of full scale / 32768 on every axis.

Each distinct value counts once: a frozen sensor repeats one. Zero lies on every lattice and does
not count.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

STEPS = 32768
"""Steps of the lattice in a full scale: 1.0 in Q1.15."""

TEXT_ROUNDING = 5e-7
"""Logs print six decimals [N, Nm]."""

ON_LATTICE = 0.02
"""Mean distance to the lattice, in steps, that still counts as on it (chance gives 0.25)."""

ENOUGH = 10
"""Distinct values an axis must show: ten chance ones lie on a lattice once in a million cases."""

LARGEST = 5000
"""Largest full scale that is looked for [N, Nm]."""

_TAKEN = 200  # distinct values by which a full scale is looked for, twice so many at most
_TRIED = 1024  # full scales tried at once, the largest first
_SIFTED = 32  # values at a time by which hopeless ones are sifted out

Fit = Literal["fits", "off", "undecided"]
"""Whether values lie on a lattice; undecided where they are too few or the lattice too fine."""


@dataclass(frozen=True, slots=True)
class Readings:
    """The distinct readings of each axis, in order."""

    axes: tuple[Float[Array, "D"], ...]
    """Finite, without zero [N, Nm]."""

    @classmethod
    def of(cls, columns: Float[Array, "6 N"]) -> Readings:
        """Return the distinct readings among samples, an axis a row."""
        return cls(tuple(_distinct(column) for column in columns))

    def error(self, full_scale: Float[Array, "6"]) -> Float[Array, "6"]:
        """Return the mean distance of each axis to the lattice of `full_scale`, in steps.

        Near 0 on the lattice, 0.25 by chance, NaN where no value is left.
        """
        step = np.asarray(full_scale, dtype=np.float64) / STEPS
        return np.array([_distance(d / s) for d, s in zip(self.axes, step, strict=True)])

    def fit(self, full_scale: Float[Array, "6"]) -> Fit:
        """Return whether all six axes lie on the lattice of `full_scale`.

        Undecided where an axis shows fewer than ten distinct values, or text of six decimals cannot
        show its lattice.
        """
        enough = np.array([distinct.size >= ENOUGH for distinct in self.axes])
        enough &= np.asarray(full_scale, dtype=np.float64) / STEPS * ON_LATTICE > TEXT_ROUNDING
        if (self.error(full_scale)[enough] > ON_LATTICE).any():
            return "off"
        return "fits" if enough.all() else "undecided"

    def fitting(self, full_scales: Mapping[str, Float[Array, "6"]]) -> tuple[str, ...]:
        """Return the names of those full scales that fit all six axes."""
        return tuple(name for name, scale in full_scales.items() if self.fit(scale) == "fits")

    def full_scale(self, *, largest: int = LARGEST) -> Int[Array, "6"]:
        """Return the whole full scale whose lattice each axis shows, 0 where none does.

        Every divisor of it fits as well, so the largest that fits is meant. An axis whose readings
        are all even shows twice its full scale.
        """
        # thousands of candidates: chance needs more values to be ruled out
        return np.array(
            [_largest(d, largest) if d.size >= 3 * ENOUGH else 0 for d in self.axes],
            dtype=np.int64,
        )


def _distinct(column: Float[Array, "N"]) -> Float[Array, "D"]:
    ordered = np.sort(column)  # NaN last
    start, stop = np.searchsorted(ordered, -np.inf, "right"), np.searchsorted(ordered, np.inf)
    finite = ordered[start:stop]
    distinct = finite[np.append(True, finite[1:] != finite[:-1])[: len(finite)]]
    return np.asarray(distinct[distinct != 0.0])


def _distance(steps: Float[Array, "D"]) -> float:
    return float(np.mean(np.abs(steps - np.rint(steps)))) if len(steps) else float("nan")


def _largest(distinct: Float[Array, "D"], largest: int) -> int:
    """Return the largest whole full scale that fits an axis, 0 where none does."""
    spread = distinct[:: max(1, distinct.size // _TAKEN)]
    smallest = int(TEXT_ROUNDING / ON_LATTICE * STEPS) + 1
    for top in range(largest, smallest - 1, -_TRIED):
        hopeful = np.arange(top, max(top - _TRIED, smallest - 1), -1)
        left = np.zeros(len(hopeful))
        # distances only add up: what exceeds the bound with some values does so with all
        stride = -(-len(spread) // _SIFTED)
        for i in range(stride):
            steps = spread[i::stride, None] * (STEPS / hopeful)
            steps -= np.rint(steps)
            left += np.abs(steps, out=steps).sum(axis=0)
            few = left < ON_LATTICE * len(spread) * (1.0 + 1e-9)
            hopeful, left = hopeful[few], left[few]
            if not len(hopeful):
                break
        for candidate in hopeful.tolist():
            # values at regular steps may be all even where all values are not
            if all(_distance(d * (STEPS / candidate)) < ON_LATTICE for d in (spread, distinct)):
                return int(candidate)
    return 0
