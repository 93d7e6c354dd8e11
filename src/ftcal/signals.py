"""From signals on their own clocks, with holes, to one motion on one clock.

A *run* is a stretch without a hole. Nothing is filtered, interpolated or guessed across the end of
a run: what lies beyond is NaN, never clamped. Joints are smoothed on the regular grid of their own
clock and then interpolated; smoothing after interpolation would smooth the interpolation.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, raise_all
from ftcal.filters import smooth, smooth_and_derive
from ftcal.motion import Motion
from ftcal.recording import NANOSECONDS, Finding, Recording, Signal

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array

JOINT_WINDOW, JOINT_ORDER = 0.81, 4
"""Default filter of joints: span [s] and polynomial order (81 samples at 100 Hz)."""

SMOOTHING_WINDOW, SMOOTHING_ORDER = 1.01, 2
"""Default filter of channels and model wrenches (101 samples at 100 Hz)."""

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


def default_gap(signal: Signal) -> float:
    """Return the longest pause [s] that is not a hole: 5 median periods, at least 0.05 s."""
    return longest_pause(signal.period)


def longest_pause(period: float) -> float:
    """Return `default_gap` [s] of a signal from its median period [s]; NaN is of one sample."""
    return max(0.05, 5.0 * period)


def runs(
    signal: Signal, *, max_gap: float | None = None, usable: Bool[Array, "N"] | None = None
) -> list[slice]:
    """Return the gapless stretches of `signal` in order.

    A stretch ends at a session break, where two stamps are more than `max_gap` seconds apart
    (default `default_gap`), and where `usable` is false.
    """
    n = len(signal)
    if n == 0:
        return []
    gap = default_gap(signal) if max_gap is None else max_gap
    keep = np.ones(n, dtype=bool) if usable is None else np.asarray(usable, dtype=bool)
    opens = np.ones(n, dtype=bool)  # rows that cannot continue the row before
    opens[1:] = np.diff(signal.stamps) > round(gap * NANOSECONDS)
    opens[[row for row in signal.breaks if row < n]] = True
    opens[1:] |= ~keep[:-1]
    starts = np.flatnonzero(opens & keep)
    closes = np.flatnonzero(np.append(opens[1:] | ~keep[1:], True) & keep)
    return [slice(int(a), int(b) + 1) for a, b in zip(starts, closes, strict=True)]


def usable(
    recording: Recording, signal: Signal, findings: Iterable[Finding], *, halo: float = 0.0
) -> Bool[Array, "N"]:
    """Return which samples of `signal` no finding of it cuts.

    Cut spans grow by `halo` seconds on both sides. Given to `runs` they need no halo: a window
    never reaches beyond its run.
    """
    seconds = recording.seconds(signal)
    mask = np.ones(len(signal), dtype=bool)
    for finding in findings:
        if finding.cut and finding.signal == signal.name:
            mask &= (seconds < finding.start - halo) | (seconds >= finding.stop + halo)
    return mask


def smooth_runs(
    values: Float[Array, "N K"], stretches: Iterable[slice], window: int, order: int
) -> Float[Array, "N K"]:
    """Return `values` smoothed within each stretch; NaN at its edges, outside, and in short ones.

    Channels and model wrench pass through it with the same stretches, window and order.
    """
    values = np.asarray(values, dtype=np.float64)
    smoothed = np.full(values.shape, np.nan)
    half = window // 2
    for stretch in stretches:
        if stretch.stop - stretch.start >= window:
            inner = slice(stretch.start + half, stretch.stop - half)
            smoothed[inner] = smooth(values[stretch], window, order)
    return smoothed


def interpolate(
    signal: Signal,
    clock: Int[Array, "N"],
    *,
    max_gap: float | None = None,
    usable: Bool[Array, "M"] | None = None,
) -> Float[Array, "N K"]:
    """Return `signal` on the stamps `clock` [ns], linear within a run; NaN in holes and outside.

    A lone sample between two holes supports nothing.
    """
    values = np.full((len(clock), len(signal.columns)), np.nan)
    for run in runs(signal, max_gap=max_gap, usable=usable):
        stamps = signal.stamps[run]
        begin, end = np.searchsorted(clock, [stamps[0], stamps[-1] + 1])
        if len(stamps) > 1:
            t, at = _since(stamps, int(stamps[0])), _since(clock[begin:end], int(stamps[0]))
            values[begin:end] = _linear(t, signal.values[run], at)
    return values


def temperature_at(thermometer: Signal, clock: Int[Array, "N"], gap: float) -> Float[Array, "N"]:
    """Return the temperature on the stamps `clock` [ns]; NaN in holes and outside.

    As `signals.interpolate`, but the two samples about a stamp alone decide, to the last bit: it
    counts time from the first sample of a run, which a piece does not know.
    """
    stamps, values = thermometer.stamps, thermometer.values[:, 0]
    if not len(stamps):
        return np.full(len(clock), np.nan)
    # whether a sample continues the one before it; none before the first, none after the last
    linked = np.zeros(len(stamps) + 1, dtype=bool)
    linked[1:-1] = np.diff(stamps) <= round(gap * NANOSECONDS)
    linked[list(thermometer.breaks)] = False
    before = np.searchsorted(stamps, clock, side="right") - 1
    row = np.maximum(before, 0)
    following = np.minimum(row + 1, len(stamps) - 1)
    sampled = stamps[row] == clock
    share = (clock - stamps[row]) / np.maximum(stamps[following] - stamps[row], 1)
    between = values[row] + share * (values[following] - values[row])
    supported = (before >= 0) & (linked[row + 1] | (sampled & linked[row]))
    return np.where(supported, between, np.nan)


def joint_motion(
    recording: Recording,
    joints: Sequence[str],
    clock: Int[Array, "N"],
    *,
    window: float = JOINT_WINDOW,
    order: int = JOINT_ORDER,
    max_gap: float | None = None,
    findings: Iterable[Finding] = (),
) -> tuple[Motion, Bool[Array, "N"]]:
    """Return the motion of `joints` on the stamps `clock` [ns], and which of its rows are valid.

    Each run of each joint signal is placed on a regular grid of its own mean period, smoothed and
    derived by a filter that spans `window` seconds, and interpolated to the clock. A row is valid
    where every joint lies within the support of its filter; elsewhere the joints that do not are
    NaN. Spans that `findings` cut end a run like a hole.

    `DataError` names all joints not logged, joints logged twice, and signals without a run as
    long as the filter.
    """
    owners = joint_owners(recording, joints)
    cuts = tuple(findings)
    table = np.full((3, len(clock), len(joints)), np.nan)
    valid = np.ones(len(clock), dtype=bool)
    faults = []
    for signal in recording.joints:
        wanted = [column for column, joint in enumerate(joints) if owners[joint] is signal]
        if not wanted:
            continue
        if wanted == list(range(wanted[0], wanted[0] + len(wanted))):
            columns: slice | list[int] = slice(wanted[0], wanted[0] + len(wanted))  # faster
        else:
            columns = wanted
        source = [signal.columns.index(joints[column]) for column in wanted]
        stretches = runs(signal, max_gap=max_gap, usable=usable(recording, signal, cuts))
        filters = [run_filter(signal.stamps[run], window, order) for run in stretches]
        if not any(filters):
            spans = [_span(signal.stamps[run]) for run in stretches]
            faults.append(too_short(signal.name, max(spans, default=0.0), window))
        supported = np.zeros(len(clock), dtype=bool)
        for run, found in zip(stretches, filters, strict=True):
            if found is not None:
                rows = found.rows(clock)
                values = np.ascontiguousarray(signal.values[run][:, source])
                table[:, rows, columns] = found.derive(signal.stamps[run], values, clock[rows])
                supported[rows] = True
        valid &= supported
    raise_all(DataError, f"recording {recording.name!r}", faults)
    time = _since(clock, recording.start)
    return Motion(time, tuple(joints), table[0], table[1], table[2]), valid


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
        return _since(clock, self.start) / self.period - self.window // 2

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
        t = _since(stamps, self.start)
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
            regular = _linear(t, values, grid)
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


def joint_owners(recording: Recording, joints: Sequence[str]) -> dict[str, Signal]:
    """Return the signal that logs each of `joints`, or raise `DataError` with all faults."""
    logged = tuple(joint for signal in recording.joints for joint in signal.columns)
    empty = np.empty((0, len(logged)))
    try:
        Motion(np.empty(0), logged, empty, empty, empty).columns(joints)
    except DataError as error:
        raise DataError(f"recording {recording.name!r}: {error}") from error
    owners: dict[str, Signal] = {}
    faults = []
    for signal in recording.joints:
        for joint in signal.columns:
            if joint in owners:
                first = owners[joint].name
                faults.append(f"joint {joint!r} is logged twice, in {first!r} and {signal.name!r}")
            owners[joint] = signal
    if faults:
        faults.append("leave one of the signals out")
    raise_all(DataError, f"recording {recording.name!r}", faults)
    return owners


def too_short(signal: str, longest: float, window: float) -> str:
    """Return what to say of a signal whose longest run [s] is shorter than the filter's window."""
    return (
        f"longest stretch of {signal!r} without a hole lasts {longest:.3g} s,"
        f" less than the smoothing window of {window:g} s; record longer or narrow the window"
    )


def _span(stamps: Int[Array, "N"]) -> float:
    return float(stamps[-1] - stamps[0]) / NANOSECONDS


def _since(stamps: Int[Array, "N"], origin: int) -> Float[Array, "N"]:
    """Return seconds; the difference is taken in integers, so nothing is rounded away."""
    return np.asarray((stamps - origin) / NANOSECONDS)


def _linear(
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
