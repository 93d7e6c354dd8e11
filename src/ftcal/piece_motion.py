"""The motion of joints, or of an IMU, in a piece of a recording: filtered as the whole would be.

The grid of the filter belongs to a run, and a run is known before its samples pass by
(`ftcal.clocks`): a piece needs of it what the filter reaches beyond the piece, and no more.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ftcal.clocks import Clocks
from ftcal.errors import DataError, raise_all
from ftcal.logs.pieces import Role, named
from ftcal.recording import Recording
from ftcal.run_filter import RunFilter, motion_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array


@dataclass(frozen=True, slots=True)
class Source:
    """The filters of one signal, for some of its columns."""

    role: Role
    signal: str
    columns: tuple[int, ...]
    """Wanted of the signal."""
    filters: tuple[RunFilter, ...]
    """Of its runs, in order."""

    def motion(
        self, piece: Recording, clock: Int[Array, "N"]
    ) -> tuple[Float[Array, "3 N J"], Bool[Array, "N"]]:
        """Return value and both derivatives on the stamps `clock` [ns], and where they are known.

        Elsewhere they are NaN. `piece` holds what lies within `overlap` of the clock.
        """
        signal = named(piece, self.role, self.signal)
        return motion_of(self.filters, signal.stamps, signal.values, self.columns, clock)


def sources(
    clocks: Clocks,
    wanted: Iterable[tuple[Role, str, Sequence[int]]],
    *,
    window: float,
    order: int,
    where: str,
) -> list[Source]:
    """Return the filters [window in s] of signals, each with the columns wanted of it.

    Raises `DataError`, which begins with `where`, and names all signals without a run as long as
    the filter.
    """
    found, faults = [], []
    for role, name, columns in wanted:
        filters, fault = clocks[role, name].filters(window, order)
        found.append(Source(role, name, tuple(columns), tuple(filters)))
        faults += [fault] if fault else []
    raise_all(DataError, where, faults)
    return found


def reach(clocks: Clocks, some: Iterable[Source]) -> float:
    """Return how far from a clock the samples lie that its motion asks for [s]."""
    return max(
        (one.reach + clocks[source.role, source.signal].gap
         for source in some for one in source.filters),
        default=0.0,
    )  # fmt: skip
