"""How much there is of every signal of a log: samples, rate, span and range, as it passes by."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ftcal.logs.pieces import ROLES, Pieces, Role
from ftcal.recording import NANOSECONDS, Recording, Signal

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array


@dataclass(slots=True)
class Extent:
    """One signal."""

    role: Role
    name: str
    columns: tuple[str, ...]
    period: float
    """Median time between two samples [s]; NaN with fewer than two."""
    samples: int = 0
    start: float | None = None
    """First sample, seconds since the start of the recording."""
    stop: float | None = None
    """Last sample, seconds since the start of the recording."""
    least: Float[Array, "K"] | None = None
    greatest: Float[Array, "K"] | None = None

    @property
    def rate(self) -> float | None:
        """Samples a second."""
        return 1.0 / self.period if self.samples > 1 else None

    def see(self, signal: Signal, recording: Recording) -> None:
        """Take in the next samples."""
        if not len(signal):
            return
        first, last = ((int(s) - recording.start) / NANOSECONDS for s in signal.stamps[[0, -1]])
        self.samples += len(signal)
        self.start = first if self.start is None else self.start
        self.stop = last
        low, high = signal.values.min(axis=0), signal.values.max(axis=0)
        self.least = low if self.least is None else np.minimum(self.least, low)
        self.greatest = high if self.greatest is None else np.maximum(self.greatest, high)


@dataclass(slots=True)
class Extents:
    """All signals of a log, in the order of the recording."""

    of_each: dict[tuple[Role, str], Extent] = field(default_factory=dict)

    @staticmethod
    def of(log: Pieces) -> Extents:
        """Return those of a log that was opened, before its samples pass by."""
        return Extents(
            {
                (role, s.name): Extent(role, s.name, s.columns, log.period(role, s.name))
                for role in ROLES
                for s in getattr(log.head, role)
            }
        )

    def see(self, own: Recording) -> None:
        """Take in the next samples of every signal."""
        for role in ROLES:
            for signal in getattr(own, role):
                self.of_each[role, signal.name].see(signal, own)
