"""Segments gathered while samples pass by say what all of their samples say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal import fit as fitting
from ftcal import folds as folding
from ftcal import segments as gathering
from ftcal.bootstrap import block_starts
from ftcal.cross_validation import blocks, validate_by_folds
from ftcal.fit import FitOptions, fit
from ftcal.folds import about_zero, aligned, aligned_means, blocked_folds, by_segment, cells, pooled
from ftcal.moments import Moments, within
from ftcal.progress import Steps, silent
from ftcal.report.album import one_in
from ftcal.ridge import ScaledProblem, scaling_map
from ftcal.samples import Samples
from ftcal.sandwich import products
from ftcal.segments import Growing, Segment, enveloping, loads
from ftcal.validate import (
    GROUPS,
    Scores,
    held_out,
    held_out_samples,
    load_envelope,
    named,
    score,
)
from pretend import bent, samples, tiled, workbench

PRIOR = workbench()
GAIN = PRIOR.gain


def stretches(count: int = 2, *, noise: float = 1e-3, rows: int = 3000) -> list[Samples]:
    """Return stretches of a minute whose counts ride on an offset of 10 000 and more."""
    rng = np.random.default_rng(11)
    gain = bent(PRIOR, rng)
    return [
        samples(gain, rng, count=rows, seconds=60.0, offset=0.3 + 0.1 * k, noise=noise)
        for k in range(count)
    ]


def same(found: Moments, exact: Moments) -> None:
    """Compare moments in units of the spread of each column, to rounding of 10 000 counts."""
    assert found.count == pytest.approx(exact.count, rel=1e-14)
    sd = np.sqrt(np.diag(exact.covariance()))
    np.testing.assert_allclose((found.mean - exact.mean) / sd, 0.0, atol=1e-10)
    scatter = (found.scatter - exact.scatter) / (exact.count * np.outer(sd, sd))
    np.testing.assert_allclose(scatter, 0.0, atol=1e-10)


def alike(found: Scores, exact: Scores) -> None:
    """Compare what comes from moments: errors of 1e-3 of the load lose six digits of sixteen."""
    assert (found.samples, found.blocks) == (exact.samples, exact.blocks)
    assert found.seconds == pytest.approx(exact.seconds)
    for name in GROUPS:
        one, other = found.by_name[name], exact.by_name[name]
        for figure in ("rms", "workbench_rms", "percent", "amplitude", "interval", "tested"):
            assert getattr(one, figure) == pytest.approx(getattr(other, figure), rel=1e-9)


# ------------------------------------------------------------------------------ while samples pass


@given(st.lists(st.integers(1, 2999), max_size=6), st.booleans())
@settings(max_examples=20, deadline=None)
def test_a_segment_does_not_depend_on_how_many_samples_come_at_a_time(
    cuts: list[int], warm: bool
) -> None:
    (some,) = stretches(1)
    if warm:
        some = replace(some, temperature=0.1 * some.time)
    whole = Growing("pretend", (some.start, some.stop), 1.0, most_samples=200)
    whole.add(some.time, some.rows(), 6)
    parts = Growing("pretend", (some.start, some.stop), 1.0, most_samples=200)
    for piece in np.split(np.arange(len(some)), sorted(cuts)):
        parts.add(some.time[piece], some.rows()[piece], 6)
    found, exact = parts.segment(), whole.segment()
    for field in ("time", "channels", "wrench", "temperature"):
        np.testing.assert_array_equal(
            getattr(found.samples, field), getattr(exact.samples, field), strict=True
        )
    np.testing.assert_array_equal(found.spans, exact.spans)
    np.testing.assert_array_equal(found.envelope, exact.envelope)
    for i in range(len(exact.cells)):
        same(found.cells.one(i), exact.cells.one(i))


def test_cells_add_up_to_all_samples_however_few_are_kept() -> None:
    (some,) = stretches(1)
    growing = Growing("pretend", (some.start, some.stop), 1.0, most_samples=100)
    growing.add(some.time, some.rows(), 6)
    segment = growing.segment()
    assert (len(segment), len(segment.samples), segment.step) == (3000, 94, 32)
    assert not segment.whole
    np.testing.assert_array_equal(segment.samples.time, some.time[::32])
    same(segment.moments(), some.moments())
    np.testing.assert_array_equal(segment.envelope, loads(some.wrench))


def test_spans_say_which_samples_a_cell_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gathering, "MOST_CELLS", 25)
    (some,) = stretches(1)
    segment = Segment.of(some, 1.0)
    # of sixty cells pairs of pairs are left
    assert len(segment.cells) == 15
    for i, (first, last) in enumerate(segment.spans):
        inside = some.between(first, np.nextafter(last, np.inf))
        same(segment.cells.one(i), inside.moments())


def test_a_segment_that_is_moved_is_that_of_moved_samples() -> None:
    (some,) = stretches(1)
    some = replace(some, temperature=0.1 * some.time)
    by = np.arange(6) - 3e4
    found = Segment.of(some, 1.0).moved(by, 4.0)
    moved = replace(some, channels=some.channels + by, temperature=0.1 * some.time + 4.0)
    same(found.moments(), moved.moments())
    np.testing.assert_array_equal(found.samples.rows(), moved.rows())


# ------------------------------------------------------------------------------ some of the cells


@given(st.lists(st.booleans(), min_size=120, max_size=120), st.sampled_from([within, about_zero]))
@settings(max_examples=25, deadline=None)
def test_any_cells_pool_to_the_moments_of_their_samples(
    chosen: list[bool], pool: folding.Pool
) -> None:
    both = stretches()
    tiles = tiled(*both)
    if not any(chosen):
        chosen[7] = True
    some = tiles.some(np.array(chosen))
    parts = []
    for number, stretch in enumerate(both):
        mine = (tiles.segment == number) & some.chosen
        rows = np.repeat(mine[tiles.segment == number], 50)
        if rows.any():
            parts.append(Moments.of(stretch.rows()[rows]))
    assert [len(group) for group in by_segment(some)] == [part.count / 50 for part in parts]
    same(pooled(some, pool), pool(parts))
    gain = PRIOR.gain
    for means, every in zip(aligned_means(some, gain), aligned(some, gain), strict=True):
        np.testing.assert_allclose(means, every.reshape(-1, 50, 6).mean(axis=1), atol=1e-9)


def test_products_of_cells_are_those_of_their_samples() -> None:
    (some,) = stretches(1)
    some = replace(some, temperature=np.sin(some.time))
    tiles = tiled(some)
    chosen = np.ones(60, dtype=bool)
    chosen[20:30] = False
    part = tiles.some(chosen)
    problem = ScaledProblem.of(pooled(part), PRIOR)
    E = np.random.default_rng(0).normal(size=(6, 7)) * 0.03
    rows = some.rows()[np.repeat(chosen, 50)]
    yz = (rows - rows.mean(axis=0)) @ scaling_map(PRIOR, 7).T
    left = yz[:, 7:] - yz[:, :7] @ E.T
    exact = np.einsum("bni,bnp->bip", left.reshape(50, 50, 6), yz[:, :7].reshape(50, 50, 7))
    (found,) = products(part, problem, E)
    np.testing.assert_allclose(found, exact, atol=1e-9 * abs(exact).max())


def test_cells_that_count_less_are_as_many_samples_less() -> None:
    (some,) = stretches(1)
    tiles = tiled(some)
    weight = np.where(np.arange(60) % 7 == 3, 0.25, 1.0)
    less = tiles.weighing(weight)
    assert (less.samples, less.down_weighted) == (3000, 450)
    gain = bent(PRIOR, np.random.default_rng(5), 0.01)
    each = np.repeat(weight, 50)[:, None]
    residual = some.wrench - some.channels @ gain.T
    residual -= np.average(residual, axis=0, weights=each[:, 0])
    (every,), (means,) = aligned(less, gain), aligned_means(less, gain)
    np.testing.assert_allclose(every, np.sqrt(each) * residual, atol=1e-9)
    expected = np.sqrt(weight)[:, None] * residual.reshape(60, 50, 6).mean(axis=1)
    np.testing.assert_allclose(means, expected, atol=1e-9)
    # the mean of a segment moves with the weights, and with it what is about it
    problem = ScaledProblem.of(pooled(less), PRIOR)
    E = np.linalg.solve(problem.S_yy, problem.S_zy.T).T
    (table,) = products(less, problem, E)
    scale = np.abs(table).sum(axis=0).max()
    np.testing.assert_allclose(table.sum(axis=0) / scale, 0.0, atol=1e-9)


def test_cells_of_many_segments_are_put_together_within_each(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(folding, "MOST_CELLS", 50)
    both = stretches()
    tiles = tiled(*both)
    # 120 cells in threes
    np.testing.assert_array_equal(np.bincount(tiles.segment), [20, 20])
    np.testing.assert_array_equal(tiles.moments.count, 150)
    same(pooled(tiles), within([one.moments() for one in both]))


def test_memory_of_thinned_samples_is_told_by_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    both = stretches()
    found = fitting.repetition(cells([Segment.of(one, 1.0).thinned(500) for one in both]), GAIN)
    assert not np.allclose(found, fitting.repetition(tiled(*both), GAIN), rtol=0.01)
    monkeypatch.setattr(fitting, "MANY", 0)
    np.testing.assert_array_equal(found, fitting.repetition(tiled(*both), GAIN))


def test_a_fit_of_thinned_segments_is_that_of_whole_ones() -> None:
    both = stretches(rows=30_000)  # too many for their memory to be looked up sample by sample
    whole = tiled(*both)
    thin = cells([Segment.of(one, 1.0).thinned(500) for one in both])
    assert whole.whole
    assert not thin.whole
    np.testing.assert_array_equal(
        fit(thin, PRIOR).estimate.gain, fit(whole, PRIOR).estimate.gain, strict=True
    )


# ------------------------------------------------------------------------------ scores


@pytest.mark.parametrize(("most", "kept"), [(10_000, 3000), (700, 375)])
def test_scores_of_cells_are_those_of_all_samples(most: int, kept: int) -> None:
    both = stretches()
    gain = bent(PRIOR, np.random.default_rng(5), 0.01)
    trained = load_envelope(0.8 * both[0].wrench)
    by_cells = [held_out(Segment.of(one, 1.0).thinned(most), gain, PRIOR) for one in both]
    by_samples = [held_out_samples(one, gain, PRIOR) for one in both]
    found, exact = score("hold-out", by_cells, trained), score("hold-out", by_samples, trained)
    alike(found, exact)
    assert {len(piece.time) for piece in by_cells} == {kept}
    for name in GROUPS:
        one, other = found.by_name[name], exact.by_name[name]
        # every eighth sample: 750 of errors that remember a second know a ratio to a few percent
        assert one.percent_absolute == pytest.approx(other.percent_absolute, rel=0.1)
        assert one.beyond == pytest.approx(other.beyond, abs=0.02)
        assert other.beyond > 0.0


def test_what_a_piece_reads_is_aligned_on_all_samples_of_it() -> None:
    (some,) = stretches(1)
    piece = held_out(Segment.of(some, 1.0).thinned(100), PRIOR.gain, PRIOR)
    exact = held_out_samples(some, PRIOR.gain, PRIOR)
    np.testing.assert_allclose(piece.in_situ, exact.in_situ[::32], atol=1e-9)
    np.testing.assert_allclose(piece.workbench, exact.workbench[::32], atol=1e-9)
    assert piece.step == 32


def test_a_gain_without_temperature_reads_samples_that_have_one() -> None:
    (some,) = stretches(1)
    warm = replace(some, temperature=0.1 * some.time)
    piece = held_out(Segment.of(warm, 1.0), PRIOR.gain, PRIOR)
    np.testing.assert_allclose(
        piece.in_situ, held_out(Segment.of(some, 1.0), PRIOR.gain, PRIOR).in_situ, atol=1e-9
    )


def test_a_pause_in_the_recording_is_no_block() -> None:
    time = np.concatenate([np.arange(0.0, 10.0, 0.1), np.arange(50.0, 60.0, 0.1)])
    starts = block_starts(time, time[0], time[-1], 2.0)
    assert len(starts) == 10
    assert np.diff(starts, append=len(time)).min() >= 15


# ------------------------------------------------------------------------------ K-fold


def test_every_fold_is_read_by_a_fit_that_never_saw_it() -> None:
    both = stretches()
    tiles = tiled(*both)
    options = FitOptions(kappa=0.05)
    found = validate_by_folds(tiles, PRIOR, options, within, Steps(silent, 5))
    assert found is not None
    pieces = []
    for fold in blocked_folds(tiles, 5):
        gain = fit(fold.train, PRIOR, options).estimate.coefficients
        for rows in by_segment(fold.held):
            first, last = tiles.spans[rows[0], 0], tiles.spans[rows[-1], 1]
            stretch = both[tiles.segment[rows[0]]].between(first, np.nextafter(last, np.inf))
            pieces.append(held_out_samples(stretch, gain, PRIOR))
    exact = score("5-fold", pieces, load_envelope(np.concatenate([one.wrench for one in both])))
    alike(found, exact)
    for name in GROUPS:
        assert found.by_name[name].beyond == 0.0
        assert found.by_name[name].trained == pytest.approx(exact.by_name[name].trained)


def test_blocks_of_all_folds_hold_every_sample_once() -> None:
    both = stretches()
    held = [block for fold in blocked_folds(tiled(*both), 5) for block in blocks(fold.held)]
    assert sum(map(len, held)) == 6000
    assert all(block.whole for block in held)
    times = np.concatenate([block.samples.time for block in held])
    np.testing.assert_array_equal(times, np.concatenate([one.time for one in both]))
    np.testing.assert_array_equal(enveloping(held), loads(np.concatenate([b.wrench for b in both])))


def test_blocks_of_thinned_segments_score_alike() -> None:
    both = stretches(rows=30_000)
    thin = cells([Segment.of(one, 1.0).thinned(500) for one in both])
    found, exact = (
        validate_by_folds(tiles, PRIOR, FitOptions(), within, Steps(silent, 5))
        for tiles in (thin, tiled(*both))
    )
    assert found is not None
    assert exact is not None
    alike(found, exact)
    assert sum(len(piece.time) for piece in found.pieces) < 1000
    assert named(enveloping(thin.segments))["fx"] == found.by_name["fx"].trained


def test_data_too_short_for_the_folds_are_not_validated() -> None:
    rng = np.random.default_rng(0)
    short = tiled(samples(PRIOR.gain, rng, count=50, seconds=5.0))
    assert validate_by_folds(short, PRIOR, FitOptions(), within, Steps(silent, 5)) is None


def test_captions_say_how_few_samples_are_drawn() -> None:
    assert one_in([1, 1], "sample") == ""
    assert one_in([64], "sample") == " One sample in 64 is drawn."
    assert one_in([8, 1, 64], "smoothed sample") == " One smoothed sample in 1 to 64 is drawn."
