"""Hours of data cost no more algebra than minutes, and say the same of their noise."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal import fit
from ftcal.folds import cells
from ftcal.moments import Moments, Stacked
from ftcal.samples import Samples
from ftcal.segments import MOST_CELLS, Segment
from pretend import tiled, workbench

GAIN = workbench().gain
RATE = 100


def remembering(count: int, memory: int, seed: int) -> Samples:
    """Return samples whose residual is unit noise averaged over `memory` samples."""
    rng = np.random.default_rng(seed)
    kernel = np.full(memory, memory**-0.5)
    white = rng.normal(size=(count + memory - 1, 6))
    noise = np.stack([np.convolve(column, kernel, "valid") for column in white.T], axis=1)
    channels = rng.normal(size=(count, 6))
    time = np.arange(count) / RATE
    wrench = channels @ GAIN.T + noise + 5.0
    return Samples("pretend", 0.0, float(time[-1]), time, channels, wrench)


@pytest.mark.parametrize("memory", [1, 10, 100])
def test_means_of_cells_say_how_many_samples_count_as_one(
    monkeypatch: pytest.MonkeyPatch, memory: int
) -> None:
    segments = [remembering(30_000, memory, seed) for seed in range(2)]
    tiles = tiled(*segments, length=0.5)
    monkeypatch.setattr(fit, "MANY", 60_000)
    by_samples = fit.repetition(tiles, GAIN)
    monkeypatch.setattr(fit, "MANY", 59_999)
    by_means = fit.repetition(tiles, GAIN)
    # three standard errors of both: sqrt(2 (2 M + 1) / N), M = 5 memory lags (Sokal); of the 1200
    # means M is at least 5 as well
    count = sum(map(len, segments))
    for found, lags, terms in ((by_samples, 5.0 * memory, count), (by_means, 10.0, count / 50)):
        error = 3.0 * np.sqrt(2.0 * (2.0 * lags + 1.0) / terms)
        np.testing.assert_allclose(found, memory, rtol=error)


def test_a_perfect_fit_of_long_data_repeats_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    some = remembering(2_000, 1, 0)
    perfect = Samples("pretend", 0.0, 20.0, some.time, some.channels, np.zeros((2_000, 6)))
    monkeypatch.setattr(fit, "MANY", 0)
    found = fit.repetition(tiled(perfect, length=0.5), np.zeros((6, 6)))
    np.testing.assert_array_equal(found, np.ones(6))


def test_cells_of_hours_are_longer_and_lose_nothing() -> None:
    time = np.arange(200_000) * 0.1  # five and a half hours in all
    table = np.random.default_rng(0).normal(size=(len(time), 6))
    halves = [slice(None, 120_000), slice(120_000, None)]
    segments = [
        Samples("pretend", float(time[some][0]), float(time[some][-1]), time[some], table[some],
                table[some])
        for some in halves
    ]  # fmt: skip
    parts = [Segment.of(segment, 0.5) for segment in segments]
    assert max(len(part.cells) for part in parts) <= MOST_CELLS < sum(len(p.cells) for p in parts)
    tiles = cells(parts)
    assert MOST_CELLS // 2 <= len(tiles) <= MOST_CELLS
    assert tiles.samples == len(time)
    # but for the last of a segment, which may be half as long, they are of one length
    assert tiles.moments.count.min() > 0.45 * tiles.moments.count.max()
    assert (tiles.spans[1:, 0] > tiles.spans[:-1, 1]).all()


@given(st.lists(st.integers(1, 9), min_size=1, max_size=1200), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_moments_of_pieces_are_those_of_each(counts: list[int], seed: int) -> None:
    edges = np.cumsum([0, *counts])
    rows = 3e4 + 100.0 * np.random.default_rng(seed).normal(size=(edges[-1], 3))
    found = Stacked.of_each(rows, edges)
    for i, (start, stop) in enumerate(itertools.pairwise(edges)):
        piece, alone = found.one(i), Moments.of(rows[start:stop])
        assert piece.count == alone.count
        np.testing.assert_allclose(piece.mean, alone.mean, rtol=1e-14)
        # nine rows of a spread of 100: a scatter of 1e5 at most, each term rounded from 3e4
        np.testing.assert_allclose(piece.scatter, alone.scatter, rtol=1e-12, atol=1e-9)
