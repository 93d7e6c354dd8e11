"""Which sensor wrote a log of calibrated values, as the lattice of its readings says."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ftcal.blocks import Selection
from ftcal.firmware import FirmwareMatrix
from ftcal.lattice import Readings
from ftcal.recording import FindingKind

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

ROOM = 1 << 15
"""Samples whose readings are looked at: of more, those at regular steps (`Selection`)."""


class Serial:
    """The readings of a signal of six channels, and the matrices that may be behind them."""

    def __init__(
        self, name: str, matrix: FirmwareMatrix | None, known: Mapping[str, FirmwareMatrix]
    ) -> None:
        """Expect `matrix` behind the signal `name`, or one of `known` by serial number instead."""
        self.name = name
        self.matrix = matrix
        self.others = {k: m.full_scale for k, m in known.items() if m is not matrix}
        self.selection = Selection(ROOM)

    def see(self, columns: Float[Array, "6 B"]) -> None:
        """Take note of the next samples."""
        self.selection.see(columns)

    def verdict(self) -> tuple[FindingKind, str] | None:
        """Return what a finding says of the serial number; None where there is nothing to say."""
        readings, name = Readings.of(self.selection.columns), self.name
        if self.matrix is None:
            scales = readings.full_scale()
            if not scales.all():
                return None
            fitting = readings.fitting(self.others)
            who = f"; {' or '.join(fitting)} fits" if fitting else ""
            return "serial", f"{name}: readings show full scales {' '.join(map(str, scales))}{who}"
        serial, scale = self.matrix.serial, self.matrix.full_scale
        fit = readings.fit(scale)
        if fit == "undecided":
            few = f"{name}: too few distinct readings to tell whether {serial} wrote them"
            return "serial", few
        error = np.nanmax(readings.error(scale))
        if fit == "fits":
            on = f"{name}: readings lie on the lattice of {serial}, off by {error:.1g} of a step"
            return "serial", on
        fitting = readings.fitting(self.others)
        instead = f"{' or '.join(fitting)} fits" if fitting else "no matrix given fits"
        return "off lattice", (
            f"{name}: readings are off the lattice of {serial} by {error:.2f} of a step,"
            f" {instead}; check the serial number"
        )
