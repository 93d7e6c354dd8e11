"""How imperfect a pretend robot's sensors, encoders and clocks always are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ftcal.errors import DataError, raise_all

REFERENCE_TEMPERATURE = 25.0
"""T_ref of every pretend sensor [degree Celsius]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """How imperfect the pretend sensors, encoders and clocks are; the defaults are an iCub's."""

    kappa: float = 0.03
    """Expected bend of the secondary matrix by mounting, fraction of full scale."""
    noise: float = 8.0
    """Standard deviation of the white noise on every raw channel [counts]: the sensors of the real
    iCubGenova02 show 2 to 14."""
    offset: float = 8000.0
    """Largest raw offset of a channel [counts]; every recording draws its own."""
    digital: bool = True
    """Whether counts are whole and the board sends steps of full scale / 32768."""
    encoder: float = 2.0 * np.pi / 4096.0
    """Step of the joint encoders [rad]; 0 for none. Default: 12 bits, 0.0879 degrees."""
    flicker: float = 0.2
    """Standard deviation of the noise of the joint encoders, share of their step: of the joints of
    the real iCubGenova02 at rest, two in five keep changing between two readings."""
    rate: float = 100.0
    """Samples of every signal per second."""
    jitter: float = 2e-4
    """Standard deviation of the time between samples about its mean [s]."""
    stagger: float = 1.0
    """How far apart the signals begin, in periods; 0: all on one clock but for jitter."""
    warming: float = 0.0
    """How much the sensors warm up during a take that does not say itself [K]."""
    thermometer: bool = True
    """Whether temperatures are logged where sensors warm up; else their drift goes unseen."""

    def __post_init__(self) -> None:
        faults = [
            f"{name} = {value:g} must be zero or more and finite"
            for name, value in (
                ("kappa", self.kappa),
                ("noise", self.noise),
                ("offset", self.offset),
                ("encoder", self.encoder),
                ("flicker", self.flicker),
                ("jitter", self.jitter),
                ("stagger", self.stagger),
                ("warming", abs(self.warming)),
            )
            if not 0.0 <= value < np.inf
        ]
        if not 0.0 < self.rate < np.inf:
            faults.append(f"rate = {self.rate:g} must be positive and finite")
        raise_all(DataError, "conditions", faults)
