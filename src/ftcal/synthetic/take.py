"""One recording to be made: how the robot moves, what carries it, how warm it is."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, raise_all
from ftcal.support import Support
from ftcal.synthetic.conditions import REFERENCE_TEMPERATURE, Conditions
from ftcal.trajectory import Trajectory

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

WARMEST_START = 5.0
"""How much warmer than T_ref a sensor may be when a take begins [K]."""


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """One recording to be made."""

    name: str
    """Its name, and that of its folder."""
    trajectory: Trajectory
    """How the robot moves: of `ftcal.motions`, or a user's own."""
    support: Support
    """What carries it, and which way gravity points there."""
    held_out: bool = False
    """Whether the job keeps it for validation alone."""
    temperature: float | None = None
    """Of every sensor when it begins [degree Celsius]; None: random, T_ref if none ever warms."""
    warming: float | None = None
    """How much the sensors warm up during it [K]; None: as the conditions say."""

    @property
    def warm(self) -> bool:
        """Whether its sensors are at another temperature than T_ref by its own words."""
        return bool(self.warming) or self.temperature not in (None, REFERENCE_TEMPERATURE)


@dataclass(frozen=True, slots=True)
class Warmth:
    """Temperature of a sensor during a take."""

    start: float
    """Above T_ref when the take begins [K]."""
    rate: float
    """K/s."""

    def above_reference(self, time: Float[Array, "N"]) -> Float[Array, "N"]:
        """Return T - T_ref [K] at `time` [s]."""
        return np.asarray(self.start + self.rate * time)


COLD = Warmth(0.0, 0.0)
"""Of a session in which no sensor ever warms up."""


def warmth(take: Take, conditions: Conditions, generator: np.random.Generator) -> Warmth:
    """Return how warm one sensor is during a take."""
    warming = conditions.warming if take.warming is None else take.warming
    drawn = generator.uniform(0.0, WARMEST_START)
    above = drawn if take.temperature is None else take.temperature - REFERENCE_TEMPERATURE
    return Warmth(above, warming / take.trajectory.duration)


def check(takes: Sequence[Take]) -> None:
    """Raise `DataError` unless every take can have a folder of its own, and a temperature."""
    names = [take.name for take in takes]
    faults = [f"{n!r} is no folder name; use letters, digits, _ and -" for n in names
              if not re.fullmatch(r"[\w-]+", n)]  # fmt: skip
    faults += [f"{n!r} appears twice" for n in sorted(set(names)) if names.count(n) > 1]
    faults += [
        f"{what} of {take.name!r} is {value:g}; it must be finite"
        for take in takes
        for what, value in (("temperature", take.temperature), ("warming", take.warming))
        if value is not None and not np.isfinite(value)
    ]
    if not names:
        faults.append("there is none")
    raise_all(DataError, "takes", faults)
