"""The doctor finds in pieces what it finds at once, and what the whole recording says."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from ftcal import blocks, freezes, logs, plateaus, serials, turns, unit_doubts
from ftcal.blocks import Selection
from ftcal.firmware import FirmwareMatrix, decode, read_matrix
from ftcal.health import CEILING, NEAR_CEILING, Doctor, examine, logs_counts
from ftcal.logs.pieces import cut
from ftcal.logs.units import STANDARD_G
from ftcal.recording import NANOSECONDS, Finding, Recording, Signal
from ftcal.signals import default_gap, usable
from real import DATA, GENOVA02, needs_genova02

if TYPE_CHECKING:
    from jaxtyping import Bool, Int
    from numpy import ndarray as Array

EPOCH = 1_457_614_036_659_765_000
SIX = ("fx", "fy", "fz", "tx", "ty", "tz")
FULL_SCALE = np.array([1587, 1823, 2113, 37, 38, 24])
SMALL = 8
"""Samples of a block in these tests: every fault meets a border."""


def matrix() -> FirmwareMatrix:
    words = np.where(np.eye(6, dtype=bool), 0x4000, 0x0100)
    entries = [*(f"{w:X}" for w in words.ravel()), "1", *map(str, FULL_SCALE)]
    return decode("\n".join(entries), serial="SN1")


MATRIX = matrix()


@dataclass(frozen=True)
class Fault:
    """Rows of a signal in which something is wrong."""

    kind: str
    start: int
    length: int

    def harm(self, counts: Array, rng: np.random.Generator) -> None:
        rows = slice(self.start, self.start + self.length)
        if self.kind == "freeze":
            counts[rows] = counts[self.start : self.start + 1]
        if self.kind == "near":
            counts[rows, 2] = 31_000
        if self.kind == "ceiling":
            counts[rows, 3] = -31_700 - rng.integers(0, 3)
        if self.kind == "rest":
            counts[rows, 4] = 9_999
        if self.kind == "missing":
            counts[self.start, 1] = np.nan


@st.composite
def faulty(draw: st.DrawFn) -> Recording:
    """Return a recording of joints, an F/T signal and an imu that do whatever they should not."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    channels, joints, imus = (
        signal(draw, rng, *titles) for titles in (("ft", SIX), ("leg", ("knee",)), ("imu", SIX))
    )
    counts, rows = channels.values, len(channels)
    kinds = st.sampled_from(["freeze", "freeze", "near", "ceiling", "rest", "missing"])
    spans = st.builds(Fault, kinds, st.integers(0, max(rows - 1, 0)), st.integers(1, 30))
    for fault in draw(st.lists(spans, max_size=6)):
        if rows:
            fault.harm(counts, rng)
    if draw(st.booleans()):
        counts = counts @ MATRIX.matrix.T
    channels = replace(channels, values=np.asfortranarray(counts))
    joints = replace(joints, values=draw(st.sampled_from([1e-4, 1e-2])) * joints.values[:, :1])
    turning = np.cumsum(imus.values, axis=0) / 1e5 + STANDARD_G / np.sqrt(3.0)
    imus = replace(imus, values=turning)
    return Recording("take", "here", EPOCH, (joints,), (channels,), (), (imus,))


def signal(
    draw: st.DrawFn, rng: np.random.Generator, name: str, columns: tuple[str, ...]
) -> Signal:
    """Return a signal of lively counts, with holes, sessions and honest repetitions."""
    rows = draw(st.integers(0, 150))
    held = draw(st.sampled_from([1, 1, 3]))
    wide = draw(st.sampled_from([3, 100, 9_000]))
    counts = np.repeat(rng.integers(-wide, wide, (rows, 6)), held, axis=0)[:rows].astype(float)
    step = rng.choice([10, 11, 49, 50, 51, 400], rows, p=[0.9, 0.06, 0.01, 0.01, 0.01, 0.01])
    stamps = EPOCH + np.cumsum(step) * 1_000_000
    opening = draw(st.sets(st.integers(1, max(rows - 1, 1)), max_size=2))
    breaks = tuple(sorted(row for row in opening if row < rows))
    return Signal(name, columns, stamps, counts, breaks)


def pieces(recording: Recording, cuts: Sequence[int]) -> Iterator[Recording]:
    """Yield the recording cut at some stamps [ns]."""
    for start, stop in pairwise([0, *sorted(cuts), 2**62]):
        yield cut(recording, start, stop)


def seen(
    recording: Recording, cuts: Sequence[int], sensors: dict[str, FirmwareMatrix | None]
) -> tuple[Finding, ...]:
    """Return what a doctor finds who sees the recording cut at some stamps [ns]."""
    periods = {signal.name: signal.period for signal in recording.signals}
    doctor = Doctor(recording.outline(), periods, sensors=sensors)
    for piece in pieces(recording, cuts):
        doctor.see(piece)
        doctor.findings()  # asking between changes nothing
    return doctor.findings()


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let everything that happens beyond a size happen in recordings of a hundred samples."""
    monkeypatch.setattr(blocks, "BLOCK", SMALL)
    for module in (freezes, serials, unit_doubts):
        monkeypatch.setattr(module, "ROOM", 4 * SMALL)
    for module in (blocks, turns):
        monkeypatch.setattr(module, "SPAN", 2 * SMALL)
    monkeypatch.setattr(turns, "LAG", 0.02)
    monkeypatch.setattr(plateaus, "PLATEAU_VALUES", 5)


patched = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
some_cuts = st.lists(st.integers(EPOCH, EPOCH + 3 * NANOSECONDS), max_size=12)
some_sensors = st.sampled_from([{}, {"ft": None}, {"ft": MATRIX}])


@patched
@given(recording=faulty(), cuts=some_cuts, sensors=some_sensors)
def test_findings_do_not_depend_on_the_cuts(
    small_blocks: None,
    recording: Recording,
    cuts: list[int],
    sensors: dict[str, FirmwareMatrix | None],
) -> None:
    assert seen(recording, cuts, sensors) == examine(recording, sensors=sensors)


@patched
@given(recording=faulty(), sensors=some_sensors)
def test_findings_do_not_depend_on_the_blocks(
    recording: Recording, sensors: dict[str, FirmwareMatrix | None]
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blocks, "BLOCK", SMALL)
        in_blocks = examine(recording, sensors=sensors)
    assert in_blocks == examine(recording, sensors=sensors)


def held(ft: Signal) -> Int[Array, "H"]:
    """Return the samples in every hold of a signal, by its definition."""
    new = [
        i == 0
        or i in ft.breaks
        or ft.stamps[i] - ft.stamps[i - 1] > default_gap(ft) * NANOSECONDS
        or not np.array_equal(ft.values[i], ft.values[i - 1])
        for i in range(len(ft))
    ]
    return np.diff([*np.flatnonzero(new), len(ft)])


def frozen(ft: Signal) -> Bool[Array, "N"]:
    """Return which samples are frozen, from the whole of a signal."""
    length = held(ft)
    usual = float(np.quantile(length, 0.95)) if len(length) >= freezes.ENOUGH_HOLDS else 1.0
    least = max(round(0.05 / ft.period), 4)
    return np.repeat(length >= max(5.0 * usual, least), length)


def at_ceiling(ft: Signal, counts: Array) -> Bool[Array, "N"]:
    """Return which samples are at the end of the range, from the whole of a signal."""
    reading = np.abs(counts).max(axis=1)
    repeats = np.repeat(held(ft) > 1, held(ft))
    return np.asarray((reading >= CEILING) | (repeats & (reading >= NEAR_CEILING)))


def at_rest(ft: Signal) -> Bool[Array, "N"]:
    """Return which samples rest at an extreme of a channel, from the whole of a signal."""
    mask = np.zeros(len(ft), dtype=bool)
    least = max(round(0.05 / ft.period), 4)
    for channel in ft.values.T:
        distinct, times = np.unique(channel[np.isfinite(channel)], return_counts=True)
        if len(distinct) < plateaus.PLATEAU_VALUES:
            continue
        for end, beside in ((0, 1), (-1, -2)):
            if times[end] >= least and times[end] > 5 * times[beside]:
                rests = [list(run) for _, run in groupby(range(len(ft)), channel.__getitem__)]
                long = [r for r in rests if channel[r[0]] == distinct[end] and len(r) >= least]
                mask[[row for run in long for row in run]] = True
    return mask


def told(findings: Sequence[Finding], kind: str) -> int:
    """Return how many samples the summary of a kind counts."""
    summary = [f.message for f in findings if f.kind == kind and not f.cut]
    return int(summary[0].split(": ")[1].split()[0]) if summary else 0


@patched
@given(recording=faulty(), known=st.booleans())
def test_freezes_and_saturation_are_those_of_the_whole_signal(
    recording: Recording, known: bool
) -> None:
    (ft,) = recording.channels
    assume(len(ft) > 1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(blocks, "BLOCK", SMALL)
        findings = examine(recording, sensors={"ft": MATRIX if known else None})
    if logs_counts(ft):
        clipped = at_ceiling(ft, ft.values)
    elif known and not any(f.kind == "off lattice" for f in findings):
        # readings within the rounding of the product of a threshold may fall on either side
        counts = np.round(MATRIX.counts(ft.values), 6)
        clipped = at_ceiling(ft, counts)
    else:
        clipped = at_rest(ft)
    assert told(findings, "frozen") == frozen(ft).sum()
    assert told(findings, "saturated") == clipped.sum()
    left = usable(recording, ft, findings)
    assert not left[frozen(ft) | clipped].any()
    # spans grow by half a period at their end, and join where they are 0.1 s apart
    bad = recording.seconds(ft)[frozen(ft) | clipped]
    lost = recording.seconds(ft)[~left]
    assert all(np.abs(bad - second).min() < 0.1 for second in lost)


@given(
    rows=st.integers(1, 300),
    room=st.integers(1, 40),
    cuts=st.lists(st.integers(0, 300), max_size=8),
)
def test_selection_is_regular_and_fits(rows: int, room: int, cuts: list[int]) -> None:
    selection = Selection(room)
    everything = np.arange(rows)[None, :]
    for start, stop in pairwise([0, *sorted(min(c, rows) for c in cuts), rows]):
        selection.see(everything[:, start:stop])
    kept = selection.columns[0]
    step = next(2**k for k in range(10) if rows <= room * 2**k)
    np.testing.assert_array_equal(kept, np.arange(0, rows, step))


def lively(rows: int, seed: int = 0, name: str = "ft") -> Signal:
    counts = np.random.default_rng(seed).integers(-8000, 8000, (rows, 6))
    stamps = EPOCH + np.arange(rows) * 1_000_000
    return Signal(name, SIX, stamps, np.round(counts * FULL_SCALE / 32768, 6))


def test_serial_number_of_a_long_log_is_told_from_some_of_its_samples(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(serials, "ROOM", 256)
    recording = Recording("take", "here", EPOCH, (), (lively(5000),))
    (right,) = examine(recording, sensors={"ft": MATRIX})
    assert "lie on the lattice of SN1" in right.message
    (guess,) = examine(recording)
    assert guess.message == "ft: readings show full scales 1587 1823 2113 37 38 24"


def test_unusual_holds_of_a_long_log_are_still_frozen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "SPAN", 64)
    monkeypatch.setattr(freezes, "ROOM", 128)
    ft = lively(6000)
    values = np.repeat(ft.values[:600], 10, axis=0)  # each held for ten samples
    values[40:140] = values[40]  # crosses the sample at which short holds are first forgotten
    values[3000:3100] = values[3000]
    slow = replace(ft, values=values)
    stuck = examine(Recording("take", "here", EPOCH, (), (slow,)))
    spans = [(f.start, f.stop) for f in stuck if f.kind == "frozen" and f.cut]
    np.testing.assert_allclose(spans, [(0.04, 0.1395), (3.0, 3.0995)], rtol=1e-12)


def test_turn_of_a_long_log_is_that_of_its_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.arange(4096)
    angle = 0.8 * np.sin(rows / 300.0)
    felt = STANDARD_G * np.stack([np.sin(angle), np.zeros(4096), np.cos(angle)])
    rate = np.stack([np.zeros(4096), -np.gradient(angle, 0.01), np.zeros(4096)])
    stamps = EPOCH + rows * 10_000_000
    ratios = []
    for span in (4096, 512):
        monkeypatch.setattr(turns, "SPAN", span)
        imu = turns.Turns([0, 1, 2], [3, 4, 5], 0.01)
        for start in range(0, 4096, 256):
            part = slice(start, start + 256)
            imu.see(stamps[part], np.concatenate([felt, rate])[:, part])
        ratios.append(imu.ratio())
    # no turn is taken across the spans' ends: a few in a hundred, of a ratio that is 1 everywhere
    assert ratios == pytest.approx([1.0, 1.0], rel=1e-2)


def test_memory_does_not_grow_with_the_recording() -> None:
    rows = 1 << 16
    part = lively(rows)
    doctor = Doctor(Recording("take", "here", EPOCH, (), (part,)), {"ft": 1e-3})
    peaks = []
    tracemalloc.start()
    for k in range(16):
        late = replace(part, stamps=part.stamps + k * rows * 1_000_000)
        doctor.see(Recording("take", "here", EPOCH, (), (late,)))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.reset_peak()
    tracemalloc.stop()
    # of 50 MB: 2^15 samples of six channels are 1.6 MB, a block more, both twice for a moment
    assert max(peaks) < 10e6
    assert max(peaks[8:]) <= max(peaks[:8])


@needs_genova02
@pytest.mark.parametrize("folder", ["icub-genova02/left_leg_support", "icub-genova01/torso_sweep"])
def test_real_logs_are_examined_in_pieces_as_at_once(folder: str) -> None:
    recording = logs.read(DATA / folder)
    matrix_of_leg = read_matrix(GENOVA02 / "matrices" / "matrix_SN026.txt")
    name = next(s.name for s in recording.channels if "right_leg" in s.name)
    sensors: dict[str, FirmwareMatrix | None] = {name: matrix_of_leg}
    first, last = recording.start, recording.start + round(recording.duration * NANOSECONDS)
    cuts = np.random.default_rng(0).integers(first, last, 40).tolist()
    assert seen(recording, cuts, sensors) == examine(recording, sensors=sensors)
