"""From signals on their own clocks, with holes, to one motion on one clock.

A *run* is a stretch without a hole. Nothing is filtered, interpolated or guessed across the end of
a run: what lies beyond is NaN, never clamped. Joints are smoothed on the regular grid of their own
clock and then interpolated; smoothing after interpolation would smooth the interpolation.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ftcal.errors import DataError, raise_all
from ftcal.filters import smooth
from ftcal.motion import Motion
from ftcal.recording import NANOSECONDS, Finding, Recording, Signal
from ftcal.run_filter import linear, motion_of, run_filter, since, too_short

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array

JOINT_WINDOW, JOINT_ORDER = 0.81, 4
"""Default filter of joints: span [s] and polynomial order (81 samples at 100 Hz)."""

SMOOTHING_WINDOW, SMOOTHING_ORDER = 1.01, 2
"""Default filter of channels and model wrenches (101 samples at 100 Hz)."""


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
            t, at = since(stamps, int(stamps[0])), since(clock[begin:end], int(stamps[0]))
            values[begin:end] = linear(t, signal.values[run], at)
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
        made = [run_filter(signal.stamps[run], window, order) for run in stretches]
        filters = [one for one in made if one is not None]
        if not filters:
            spans = [_span(signal.stamps[run]) for run in stretches]
            faults.append(too_short(signal.name, max(spans, default=0.0), window))
        moved, known = motion_of(filters, signal.stamps, signal.values, source, clock)
        table[:, :, columns] = moved
        valid &= known
    raise_all(DataError, f"recording {recording.name!r}", faults)
    time = since(clock, recording.start)
    return Motion(time, tuple(joints), table[0], table[1], table[2]), valid


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


def _span(stamps: Int[Array, "N"]) -> float:
    return float(stamps[-1] - stamps[0]) / NANOSECONDS
