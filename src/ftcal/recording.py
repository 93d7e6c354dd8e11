"""What the robot logged, unaltered, each signal on its own clock.

Readers (`ftcal.logs`) make recordings; nothing here resamples, filters or cuts.
Units are SI: the one conversion has happened in the reader.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from ftcal.errors import DataError, unknown

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from numpy import ndarray as Array

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second; stamps are integers of them since the Unix epoch."""

FindingKind = Literal[
    "frozen", "saturated", "gap", "session", "clock jump", "duplicate stamps", "truncated",
    "lost packets", "empty", "off lattice", "serial", "unit",
    "offset step", "touch",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that a log does which a calibration must not believe."""

    kind: FindingKind
    signal: str
    """Name of the signal that shows it."""
    start: float
    """Seconds since the start of the recording."""
    stop: float
    """Seconds since the start of the recording, exclusive."""
    cut: bool
    """Whether the samples in [start, stop) are left out of everything that follows."""
    message: str
    """One line for a person, with the figure that shows it."""


@dataclass(frozen=True, slots=True)
class Signal:
    """One stream of a log on its own clock."""

    name: str
    """The stream as the log calls it, such as `right_leg/analog:o`."""
    columns: tuple[str, ...]
    """Name of each column: a joint of the URDF, or a channel."""
    stamps: Int[Array, "N"]
    """Nanoseconds since the Unix epoch, strictly increasing."""
    values: Float[Array, "N K"]
    """SI: rad, N, Nm, kelvin or degree Celsius; raw channels in counts."""
    breaks: tuple[int, ...] = ()
    """Rows that open a new session: nothing is ever interpolated across one."""

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def period(self) -> float:
        """Median time between two samples [s]; NaN with fewer than two."""
        if len(self.stamps) < 2:
            return float("nan")
        return float(np.median(np.diff(self.stamps))) / NANOSECONDS

    def outline(self) -> Signal:
        """Return the signal with its first and last sample only."""
        ends = sorted({0, len(self) - 1}) if len(self) else []
        return replace(self, stamps=self.stamps[ends], values=self.values[ends], breaks=())


@dataclass(frozen=True, slots=True)
class Recording:
    """All signals of one take, with what the reader noticed about them."""

    name: str
    source: str
    """Where it was read from, as the user named it."""
    start: int
    """Nanoseconds since the Unix epoch of second zero."""
    joints: tuple[Signal, ...]
    """Joint positions [rad]; the columns are joint names of the URDF."""
    channels: tuple[Signal, ...]
    """One per F/T sensor: the logged channels, calibrated [N, Nm] or raw [counts]."""
    temperatures: tuple[Signal, ...] = ()
    """One per thermometer [degree Celsius], one column each."""
    imus: tuple[Signal, ...] = ()
    """Base motion or inertial units, columns as the reader documents."""
    findings: tuple[Finding, ...] = ()
    digest: str = ""
    """SHA-256 of the files read."""

    def seconds(self, signal: Signal) -> Float[Array, "N"]:
        """Return the stamps of `signal` in seconds since the start of the recording."""
        return (signal.stamps - self.start) / NANOSECONDS

    @property
    def duration(self) -> float:
        """Seconds from second zero to the last sample of any signal."""
        last = max((int(s.stamps[-1]) for s in self.signals if len(s)), default=self.start)
        return (last - self.start) / NANOSECONDS

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Every signal once."""
        return (*self.joints, *self.channels, *self.temperatures, *self.imus)

    @property
    def size(self) -> int:
        """Bytes of all samples."""
        return sum(signal.stamps.nbytes + signal.values.nbytes for signal in self.signals)

    def outline(self) -> Recording:
        """Return the recording with the first and last sample of every signal only."""
        joints, channels, temperatures, imus = (
            tuple(signal.outline() for signal in role)
            for role in (self.joints, self.channels, self.temperatures, self.imus)
        )
        return replace(self, joints=joints, channels=channels, temperatures=temperatures, imus=imus)

    def channel(self, name: str) -> Signal:
        """Return the F/T signal `name`, or raise `DataError` with the near names."""
        return find(self.channels, name, f"F/T signal of recording {self.name!r}")

    def temperature(self, name: str) -> Signal:
        """Return the temperature signal `name`, or raise `DataError` with the near names."""
        return find(self.temperatures, name, f"temperature of recording {self.name!r}")


def find(signals: Iterable[Signal], name: str, kind: str) -> Signal:
    """Return the signal called `name`, or raise `DataError` with the near names."""
    by_name = {signal.name: signal for signal in signals}
    if name not in by_name:
        raise DataError(unknown(kind, name, by_name))
    return by_name[name]
