"""The filter of one stretch of joint positions without a hole, and what lies between samples.

Joints are smoothed on a regular grid of the stretch's own mean period, and then interpolated: a
part of the stretch is filtered as the whole is.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError
from ftcal.filters import smooth_and_derive
from ftcal.recording import NANOSECONDS

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array

CHUNK_ROWS = 2048
"""Rows filtered at a time: grid, filtered and interpolated values stay in cache."""

ALIKE = 1e-9
"""Share of a step by which two clocks may differ and still be one: rounding of times."""

SLACK = 1e-6
"""Share of a period by which a stamp may miss the end of a run: rounding, not extrapolation."""


def odd_window(seconds: float, period: float) -> int:
    """Return the odd count of samples nearest to `seconds`, at least 3; `period` in seconds."""
    if not (seconds > 0.0 and period > 0.0):
        raise DataError(
            f"smoothing window of {seconds:g} s at a sampling period of {period:g} s; both must be"
            " positive"
        )
    return max(3, 2 * int(seconds / period / 2.0) + 1)


@dataclass(frozen=True, slots=True)
class RunFilter:
    """The joint filter of one run, on the regular grid of its mean period.

    It knows when the run began, ended and how many samples it has, so that a part of the run can
    be filtered as the whole is.
    """

    start: int
    """Stamp of the first sample of the run [ns]; the grid begins there."""
    stop: int
    """Stamp of its last sample [ns]; the grid ends there."""
    count: int
    """Samples of the run."""
    window: int
    """Samples."""
    order: int

    @staticmethod
    def of(start: int, stop: int, count: int, window: float, order: int) -> RunFilter | None:
        """Return the filter that spans `window` seconds, or None where the run is shorter."""
        if count < 2:
            return None
        samples = odd_window(window, (stop - start) / NANOSECONDS / (count - 1))
        return RunFilter(start, stop, count, samples, order) if samples <= count else None

    @property
    def period(self) -> float:
        """Step of the grid [s]."""
        return (self.stop - self.start) / NANOSECONDS / (self.count - 1)

    @property
    def reach(self) -> float:
        """How far from a stamp samples are asked for [s], but for the pause they may stand in."""
        return (self.window // 2 + 1) * self.period

    def position(self, clock: Int[Array, "M"]) -> Float[Array, "M"]:
        """Return where `clock` lies among the filtered samples; 0 is the first."""
        return since(clock, self.start) / self.period - self.window // 2

    def rows(self, clock: Int[Array, "M"]) -> slice:
        """Return the stamps of `clock` within the support of the filter."""
        last = self.count - self.window
        begin, end = np.searchsorted(self.position(clock), [-SLACK, last + SLACK])
        return slice(int(begin), int(end))

    def derive(
        self, stamps: Int[Array, "N"], values: Float[Array, "N J"], clock: Int[Array, "M"]
    ) -> Float[Array, "3 M J"]:
        """Return value, first and second derivative on `clock`, all within the support.

        `stamps` and `values` are the run, or as much of it as lies within `reach` and a pause.
        """
        t = since(stamps, self.start)
        end_of_grid = (self.stop - self.start) / NANOSECONDS
        last = self.count - self.window
        at = np.clip(self.position(clock), 0.0, last)
        joints = values.shape[1]
        derived = np.empty((3, len(clock), joints))
        if not len(clock):
            return derived
        # filtered samples that are asked for: the first, and the one after the last
        first = min(int(at[0]), max(last - 1, 0))
        final = min(int(at[-1]) + 1, last)
        scratch = np.empty(3 * (min(CHUNK_ROWS, final - first) + 1) * joints)
        for start in range(first, max(final, first + 1), CHUNK_ROWS):
            stop = min(start + CHUNK_ROWS, final)  # filtered samples start … stop, both needed
            count = stop - start + 1
            grid = np.minimum(np.arange(start, stop + self.window) * self.period, end_of_grid)
            filtered = scratch[: 3 * count * joints].reshape(3, count, joints)
            regular = linear(t, values, grid)
            smooth_and_derive(regular, self.window, self.order, self.period, out=filtered)
            begin = np.searchsorted(at, start)
            end = len(at) if stop == final else np.searchsorted(at, stop)
            before = np.minimum(at[begin:end].astype(np.intp), max(last - 1, 0)) - start
            share = at[begin:end] - (before + start)
            for order, samples in enumerate(filtered):
                _between(samples, before, share, derived[order, begin:end])
        return derived


def run_filter(stamps: Int[Array, "N"], window: float, order: int) -> RunFilter | None:
    """Return the filter of a run, or None where it is shorter than `window` seconds."""
    return RunFilter.of(int(stamps[0]), int(stamps[-1]), len(stamps), window, order)


def motion_of(
    filters: Iterable[RunFilter],
    stamps: Int[Array, "N"],
    values: Float[Array, "N K"],
    columns: Sequence[int],
    clock: Int[Array, "M"],
) -> tuple[Float[Array, "3 M J"], Bool[Array, "M"]]:
    """Return value and both derivatives of J columns on the stamps `clock` [ns], and where.

    Elsewhere they are NaN. `stamps` and `values` are the signal whose runs are filtered, or as much
    of it as lies within `reach` and a pause of the clock.
    """
    every = list(columns) == list(range(values.shape[1]))
    parts = []
    first, last = (clock[0], clock[-1]) if len(clock) else (1, 0)
    near = [one for one in filters if one.start <= last and one.stop >= first]
    for one in near:
        rows = one.rows(clock)
        if rows.start >= rows.stop:
            continue
        begin, end = np.searchsorted(stamps, [one.start, one.stop + 1])
        run = values[begin:end] if every else np.ascontiguousarray(values[begin:end][:, columns])
        parts.append((rows, one.derive(stamps[begin:end], run, clock[rows])))
    if len(parts) == 1 and parts[0][0] == slice(0, len(clock)):
        return parts[0][1], np.ones(len(clock), dtype=bool)
    table = np.full((3, len(clock), len(columns)), np.nan)
    known = np.zeros(len(clock), dtype=bool)
    for rows, derived in parts:
        table[:, rows] = derived
        known[rows] = True
    return table, known


def too_short(signal: str, longest: float, window: float) -> str:
    """Return what to say of a signal whose longest run [s] is shorter than the filter's window."""
    return (
        f"longest stretch of {signal!r} without a hole lasts {longest:.3g} s,"
        f" less than the smoothing window of {window:g} s; record longer or narrow the window"
    )


def since(stamps: Int[Array, "N"], origin: int) -> Float[Array, "N"]:
    """Return seconds; the difference is taken in integers, so nothing is rounded away."""
    return np.asarray((stamps - origin) / NANOSECONDS)


def linear(
    t: Float[Array, "N"], values: Float[Array, "N K"], at: Float[Array, "M"]
) -> Float[Array, "M K"]:
    """Return `values` between the two or more increasing times `t`, at times within them."""
    before = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    share = (at - t[before]) / (t[before + 1] - t[before])
    found = np.empty((len(at), values.shape[1]))
    _between(values, before, share, found)
    return found


def _between(
    values: Float[Array, "N K"],
    before: Int[Array, "M"],
    share: Float[Array, "M"],
    out: Float[Array, "M K"],
) -> None:
    """Write the points `share` of the way from row `before` to the next; the last has no next."""
    nearest = np.rint(share)
    rows = before + nearest.astype(np.intp)
    one_clock = len(rows) and rows[-1] - rows[0] == len(rows) - 1 and (np.diff(rows) == 1).all()
    if one_clock and np.abs(share - nearest).max() <= ALIKE:
        out[:] = values[rows[0] : rows[-1] + 1]
        return
    np.take(values, before, axis=0, out=out, mode="clip")
    step = np.take(values, before + 1, axis=0, mode="clip")
    step -= out
    step *= share[:, None]
    out += step
