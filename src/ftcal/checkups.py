"""What is looked at in each signal of a recording while it passes by."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ftcal.blocks import Passage
from ftcal.freezes import Freezes, repetitions
from ftcal.holes import Pauses
from ftcal.plateaus import Plateaus
from ftcal.recording import Finding, FindingKind, Signal
from ftcal.robot import Robot
from ftcal.saturation import Ceiling, Whole, counts_behind, may_saturate
from ftcal.serials import Serial
from ftcal.stretches import reported, shortest
from ftcal.unit_doubts import Angles, Inertia

if TYPE_CHECKING:
    from jaxtyping import Int
    from numpy import ndarray as Array

LONE = 0.01
"""Period that a lone sample is taken to have [s]."""


class JointCheckup:
    """The clock and the angles of a signal of joints."""

    def __init__(self, signal: Signal, start: int, period: float, robot: Robot | None) -> None:
        """Expect samples of `signal`; second zero is `start` [ns], `period` the median one [s]."""
        self.clock = Pauses(signal.name, start, period)
        self.angles = Angles(signal.columns, robot)
        self.passage = Passage()

    def see(self, signal: Signal) -> None:
        """Take note of the next samples."""
        self.angles.see(signal.values)
        for block in self.passage.blocks(replace(signal, values=signal.values[:, :0])):
            self.clock.see(block)


class ImuCheckup:
    """The clock and the readings of an inertial signal."""

    def __init__(self, signal: Signal, start: int, period: float) -> None:
        """Expect samples of `signal`; second zero is `start` [ns], `period` the median one [s]."""
        self.clock = Pauses(signal.name, start, period)
        self.inertia = Inertia(signal, period)
        self.passage = Passage()

    def see(self, signal: Signal) -> None:
        """Take note of the next samples."""
        for block in self.passage.blocks(signal):
            self.clock.see(block)
            self.inertia.see(block.own, block.stamps[block.before :])


class FtCheckup:
    """The clock, the holds, the extremes and the readings of an F/T signal."""

    def __init__(self, signal: Signal, start: int, period: float, serial: Serial) -> None:
        """Expect samples of `signal`; second zero is `start` [ns], `period` the median one [s]."""
        width = len(signal.columns)
        self.clock = Pauses(signal.name, start, period)
        self.period = LONE if np.isnan(period) else period
        self.passage = Passage()
        self.freezes = Freezes(shortest(self.period))
        self.whole = Whole()
        self.logged = Ceiling(width)
        self.plateaus = Plateaus(shortest(self.period), width)
        six = width == 6
        self.serial = serial if six else None
        self.to_counts = np.linalg.inv(serial.matrix.matrix) if six and serial.matrix else None
        self.behind = Ceiling(width)

    def see(self, signal: Signal) -> None:
        """Take note of the next samples."""
        for block in self.passage.blocks(signal):
            repeating = repetitions(block, self.clock.see(block))
            self.freezes.see(block, repeating)
            low, high = block.own.min(axis=1), block.own.max(axis=1)
            self.plateaus.see(block, low, high)
            self.whole.see(block.own)
            if self.whole.so_far:
                self.logged.see(block, repeating, block.columns)
            if self.to_counts is not None and may_saturate(self.to_counts, low, high):
                counts = counts_behind(self.to_counts, block.columns)
                self.behind.see(block, repeating, counts)
            if self.serial is not None:
                self.serial.see(block.own)

    def findings(self) -> tuple[Finding, ...]:
        """Return freezes, saturation and the serial number."""
        # counts say nothing of a serial number
        verdict = self.serial.verdict() if self.serial and not self.whole.counts else None
        frozen = self._reported(self.freezes.stretches(), "frozen", "all channels repeat exactly")
        # counts behind the matrix of another sensor say nothing of saturation
        other = verdict is not None and verdict[0] == "off lattice"
        if self.whole.counts:
            clipped, why = self.logged.runs.stretches(), self.logged.why
        elif self.to_counts is not None and not other:
            clipped, why = self.behind.runs.stretches(), self.behind.why
        else:
            clipped, why = self.plateaus.stretches(), "a channel is clipped"
        name = self.clock.name
        named = () if verdict is None else (verdict,)
        return (
            *frozen,
            *self._reported(clipped, "saturated", why),
            *(Finding(kind, name, *self.clock.span, cut=False, message=m) for kind, m in named),
        )

    def _reported(
        self, found: Int[Array, "S 4"], kind: FindingKind, why: str
    ) -> tuple[Finding, ...]:
        clock = self.clock
        return reported(
            found, clock.name, kind, why, start=clock.start, period=self.period, total=clock.count
        )
