"""The data doctor: what a log does that a calibration must not believe.

Seen in the one public log of the paper's own robot: the firmware freezes all six outputs of a
sensor while one channel is beyond its range (21 % of the samples of the left hip, and a moment of
the right one just before its offset steps). Every check returns findings; those that cut are left
out of all that follows (`ftcal.signals.usable`), the others are told and change nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ftcal.firmware import (
    FirmwareMatrix,
    estimate_full_scale,
    identify,
    lattice_error,
    lattice_fit,
)
from ftcal.recording import NANOSECONDS, Finding, FindingKind, Recording, Signal
from ftcal.robot import Robot
from ftcal.signals import default_gap
from ftcal.unit_doubts import doubted_units

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from numpy import ndarray as Array

FREEZE = 0.05
"""Shortest freeze worth a finding [s]."""

FREEZE_REPEATS = 3
"""Least number of repetitions in a freeze."""

ENOUGH_HOLDS = 20
"""Distinct holds from which a log shows how long its sensor usually holds a value."""

NEAR = 0.1
"""Spans closer than this [s] are one: a sensor at the end of its range comes and goes."""

CEILING = 31_600
"""Raw reading [counts] beyond which a channel is at the end of its range."""

NEAR_CEILING = 30_000
"""Raw reading from which a repetition of all six outputs means saturation: the ceiling differs from
channel to channel (31 566 to 31 794 on iCubGenova02), and a fast one is missed by a step."""

PLATEAU_VALUES = 50
"""Distinct values a channel must show before its extreme can be called a plateau."""


def examine(
    recording: Recording,
    *,
    sensors: Mapping[str, FirmwareMatrix | None] | None = None,
    robot: Robot | None = None,
) -> tuple[Finding, ...]:
    """Return what is wrong with `recording`, and which sensors wrote it, signal by signal.

    `sensors` maps F/T signals to the matrices in their firmware, as far as known; `DataError` names
    a signal the recording lacks. With the `robot` its joint limits tell of wrong units.
    """
    matrices = dict(sensors or {})
    for name in matrices:
        recording.channel(name)
    known = {matrix.serial: matrix for matrix in matrices.values() if matrix is not None}
    found = list(clock_jumps(recording))
    for signal in (*recording.joints, *recording.channels):
        if len(signal) == 0:
            message = f"{signal.name}: no samples"
            found.append(Finding("empty", signal.name, 0.0, 0.0, False, message))
            continue
        found += gaps(recording, signal)
    for signal in recording.channels:
        if len(signal):
            matrix = matrices.get(signal.name)
            six = signal.values.shape[1] == 6
            named = serial(recording, signal, matrix, known) if six else ()
            # counts behind the matrix of another sensor say nothing of saturation
            other = any(finding.kind == "off lattice" for finding in named)
            found += frozen(recording, signal)
            found += saturated(recording, signal, None if other else matrix)
            found += named
    return (*found, *doubted_units(recording, robot))


def frozen(recording: Recording, signal: Signal) -> tuple[Finding, ...]:
    """Return where all channels of an F/T signal repeat exactly, and a summary in front.

    A sensor polled faster than it measures repeats honestly: a freeze is five times longer than
    95 % of its holds, at least 50 ms and 3 repetitions.
    """
    length = _holds(signal)
    usual = float(np.quantile(length, 0.95)) if len(length) >= ENOUGH_HOLDS else 1.0
    mask = np.repeat(length >= max(5.0 * usual, _shortest(signal)), length)
    return _report(recording, signal, "frozen", mask, "all channels repeat exactly")


def saturated(
    recording: Recording, signal: Signal, matrix: FirmwareMatrix | None = None
) -> tuple[Finding, ...]:
    """Return where a channel is at the end of its range, and a summary in front.

    With the firmware's matrix (or raw counts in the log) the readings tell: one beyond 31 600
    counts, or all six outputs repeating while one is beyond 30 000. Without it, a channel that
    stays at its largest or smallest value of the whole log.
    """
    if logs_counts(signal):
        counts = signal.values
    elif matrix is not None:
        counts = matrix.counts(signal.values)
    else:
        return _report(recording, signal, "saturated", _plateaus(signal), "a channel is clipped")
    reading = np.abs(counts).max(axis=1)
    length = _holds(signal)
    held = np.repeat(length > 1, length)
    mask = (reading >= CEILING) | (held & (reading >= NEAR_CEILING))
    peaks = np.abs(counts[mask]).max(axis=0, initial=0.0)
    why = f"raw channel {peaks.argmax() + 1} reaches {peaks.max():.0f} counts"
    return _report(recording, signal, "saturated", mask, why)


def gaps(recording: Recording, signal: Signal) -> tuple[Finding, ...]:
    """Return the holes between samples; they hold nothing to cut.

    The beginning of a session is a finding of the reader, not a hole.
    """
    seconds = recording.seconds(signal)
    pause = np.diff(seconds)
    holes = np.flatnonzero(pause > default_gap(signal))
    holes = holes[~np.isin(holes + 1, signal.breaks)]
    return tuple(
        Finding(
            "gap",
            signal.name,
            float(seconds[i]),
            float(seconds[i + 1]),
            False,
            f"{signal.name}: no samples for {pause[i]:.3g} s from {seconds[i]:.2f} s"
            f" (period {signal.period * 1e3:.3g} ms)",
        )
        for i in holes
    )


def clock_jumps(recording: Recording) -> tuple[Finding, ...]:
    """Return the holes that all signals share: the clock was set, or the logger paused.

    Sensors on different buses do not fall silent together for the same time.
    """
    signals = [s for s in (*recording.joints, *recording.channels) if len(s) > 1]
    if len(signals) < 2:
        return ()
    first, *others = [(s, gaps(recording, s)) for s in signals]
    slack = 3.0 * max(s.period for s in signals)
    return tuple(
        Finding(
            "clock jump",
            first[0].name,
            hole.start,
            hole.stop,
            False,
            f"all {len(signals)} signals pause for {hole.stop - hole.start:.3g} s at"
            f" {hole.start:.2f} s: the clock was set or the logger stopped; nothing is"
            " interpolated across",
        )
        for hole in first[1]
        if all(
            any(
                abs(other.start - hole.start) < slack and abs(other.stop - hole.stop) < slack
                for other in holes
            )
            for _, holes in others
        )
    )


def serial(
    recording: Recording,
    signal: Signal,
    matrix: FirmwareMatrix | None,
    known: Mapping[str, FirmwareMatrix],
) -> tuple[Finding, ...]:
    """Return which sensor wrote a log of calibrated values: `matrix`, or one of `known` instead."""
    if logs_counts(signal):
        return ()
    name = signal.name
    fitting = identify(signal.values, {k: v for k, v in known.items() if v is not matrix})
    fit = "undecided" if matrix is None else lattice_fit(signal.values, matrix.full_scale)
    kind: FindingKind = "serial"
    if matrix is None:
        scales = estimate_full_scale(signal.values)
        if not scales.all():
            return ()
        who = f"; {' or '.join(fitting)} fits" if fitting else ""
        message = f"{name}: readings show full scales {' '.join(map(str, scales))}{who}"
    elif fit == "fits":
        error = lattice_error(signal.values, matrix.full_scale).max()
        message = (
            f"{name}: readings lie on the lattice of {matrix.serial}, off by {error:.1g} of a step"
        )
    elif fit == "undecided":
        message = f"{name}: too few distinct readings to tell whether {matrix.serial} wrote them"
    else:
        kind = "off lattice"
        error = np.nanmax(lattice_error(signal.values, matrix.full_scale))
        instead = f"{' or '.join(fitting)} fits" if fitting else "no matrix given fits"
        message = (
            f"{name}: readings are off the lattice of {matrix.serial} by {error:.2f} of a step,"
            f" {instead}; check the serial number"
        )
    seconds = recording.seconds(signal)
    return (Finding(kind, name, float(seconds[0]), float(seconds[-1]), False, message),)


def logs_counts(signal: Signal) -> bool:
    """Return whether an F/T signal holds raw counts: whole numbers, some beyond any torque."""
    values = signal.values[np.isfinite(signal.values)]
    whole = bool((values == np.rint(values)).all())
    return whole and bool(np.abs(values).max(initial=0.0) > 3000)


def _period(signal: Signal) -> float:
    """Return the median period [s]; that of 100 Hz for a lone sample."""
    return signal.period if len(signal) > 1 else 0.01


def _shortest(signal: Signal) -> int:
    """Return the samples of the shortest freeze worth a finding."""
    return max(round(FREEZE / _period(signal)), FREEZE_REPEATS + 1)


def _holds(signal: Signal) -> Int[Array, "H"]:
    """Return the samples in every stretch of equal rows without a hole, in order."""
    fresh = np.ones(len(signal), dtype=bool)
    fresh[1:] = (signal.values[1:] != signal.values[:-1]).any(axis=1)
    fresh[1:] |= np.diff(signal.stamps) > default_gap(signal) * NANOSECONDS
    fresh[[row for row in signal.breaks if row < len(signal)]] = True
    return np.diff(np.append(np.flatnonzero(fresh), len(signal)))


def _plateaus(signal: Signal) -> Bool[Array, "N"]:
    """Return the samples where a channel rests at an extreme of its own, as a clipped one does.

    A quiet quantised channel also rests, but not at an extreme that it meets five times as often
    as the value next to it.
    """
    mask = np.zeros(len(signal), dtype=bool)
    least = _shortest(signal)
    for channel in signal.values.T:
        distinct, times = np.unique(channel[np.isfinite(channel)], return_counts=True)
        if len(distinct) < PLATEAU_VALUES:
            continue
        for extreme, own, next_one in ((0, times[0], times[1]), (-1, times[-1], times[-2])):
            if own >= least and own > 5 * next_one:
                mask |= _longer_than(channel == distinct[extreme], least)
    return mask


def _longer_than(mask: Bool[Array, "N"], least: int) -> Bool[Array, "N"]:
    """Return `mask` without its stretches of fewer than `least` samples."""
    kept = np.zeros_like(mask)
    for start, stop in _stretches(mask):
        kept[start:stop] = stop - start >= least
    return kept


def _stretches(mask: Bool[Array, "N"]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _report(
    recording: Recording, signal: Signal, kind: FindingKind, mask: Bool[Array, "N"], why: str
) -> tuple[Finding, ...]:
    """Return a summary that cuts nothing, then one finding a stretch that cuts it."""
    if not mask.any():
        return ()
    seconds: Float[Array, "N"] = recording.seconds(signal)
    # half a period: the last bad sample is within the span, the next one is not
    after = 0.5 * _period(signal)
    spans: list[tuple[float, float]] = []
    for start, stop in _stretches(mask):
        begin, end = float(seconds[start]), float(seconds[stop - 1]) + after
        if spans and begin - spans[-1][1] < NEAR:
            begin = spans.pop()[0]
        spans.append((begin, end))
    count, total = int(mask.sum()), len(signal)
    longest = max(end - begin for begin, end in spans)
    summary = (
        f"{signal.name}: {count} of {total} samples {kind} ({100 * count / total:.1f} %) in"
        f" {len(spans)} stretch{'es' if len(spans) > 1 else ''}, longest {longest:.2g} s: {why}"
    )
    return (
        Finding(kind, signal.name, spans[0][0], spans[-1][1], False, summary),
        *(
            Finding(
                kind, signal.name, begin, end, True,
                f"{signal.name}: {kind} from {begin:.2f} to {end:.2f} s",
            )
            for begin, end in spans
        ),
    )  # fmt: skip
