"""The procedure for one sensor: noise, prior strength, truth within its own error bars."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal.errors import DataError
from ftcal.fit import FitOptions, choose_kappa, fit, measured_noise, segment_offsets
from ftcal.folds import about_zero, blocked_folds, by_segment, cells, pooled
from ftcal.noise import Noise, inefficiency
from ftcal.ridge import ScaledProblem
from ftcal.sandwich import robust_posterior
from pretend import FULL_SCALE, bent, samples, tiled, workbench

PRIOR = workbench()


def correlated(rng: np.random.Generator, count: int, memory: int) -> np.ndarray:
    """Return unit white noise averaged over `memory` samples: its inefficiency is `memory`."""
    white = rng.normal(size=(count + memory - 1, 6))
    kernel = np.full(memory, memory**-0.5)
    return np.stack([np.convolve(column, kernel, "valid") for column in white.T], axis=1)


@pytest.mark.parametrize("memory", [1, 10, 50])
def test_inefficiency_counts_repeated_samples(memory: int) -> None:
    rng = np.random.default_rng(memory)
    pieces = [correlated(rng, 20000, memory) for _ in range(2)]
    # three standard errors of the estimator: sqrt(2 (2 M + 1) / N) with M = 5 memory lags (Sokal)
    error = 3.0 * np.sqrt(2.0 * (10.0 * memory + 1.0) / 40000)
    np.testing.assert_allclose(inefficiency(pieces), memory, rtol=error)


def test_cells_tile_every_segment_without_loss() -> None:
    rng = np.random.default_rng(0)
    segments = [samples(PRIOR.gain, rng, count=n) for n in (333, 77)]
    tiles = tiled(*segments)
    assert tiles.samples == tiles.moments.count.sum() == 333 + 77
    assert [len(group) for group in by_segment(tiles)] == [20, 20]


@given(st.integers(2, 6), st.integers(0, 2))
@settings(max_examples=15, deadline=None)
def test_folds_hold_out_every_cell_once_and_guard_it(count: int, guard: int) -> None:
    rng = np.random.default_rng(0)
    tiles = tiled(*(samples(PRIOR.gain, rng, count=200) for _ in range(2)))
    folds = blocked_folds(tiles, count, guard)
    np.testing.assert_array_equal(np.sum([fold.held.chosen for fold in folds], axis=0), 1)
    for fold in folds:
        train, held = fold.train.rows[:, None], fold.held.rows
        away = np.abs(tiles.index[train] - tiles.index[held])
        assert ((tiles.segment[train] != tiles.segment[held]) | (away > guard)).all()


def test_too_few_cells_for_the_folds_are_refused() -> None:
    rng = np.random.default_rng(0)
    tiles = tiled(samples(PRIOR.gain, rng, count=50, seconds=5.0))
    with pytest.raises(DataError, match="5 cells of training data are too few for 5 folds"):
        blocked_folds(tiles, 5)


def test_measured_noise_is_the_noise_put_in() -> None:
    rng = np.random.default_rng(2)
    some = samples(bent(PRIOR, rng), rng, count=20000, noise=0.0, seconds=200.0)
    felt = some.wrench + 1e-3 * FULL_SCALE * correlated(rng, 20000, 20)
    tiles = tiled(dataclasses.replace(some, wrench=felt))
    noise = measured_noise(tiles, ScaledProblem.of(pooled(tiles), PRIOR), FitOptions())
    np.testing.assert_allclose(noise.sd, 1e-3 * FULL_SCALE, rtol=0.1)
    # three standard errors: sqrt(2 (2 M + 1) / N), M = 100 lags
    np.testing.assert_allclose(noise.inefficiency, 20.0, rtol=0.43)


def test_truth_lies_within_three_standard_errors() -> None:
    """97 % of the entries over 20 sensors, with noise that remembers a tenth of a second."""
    inside, entries = 0, 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        gain = bent(PRIOR, rng)
        some = samples(gain, rng, count=6000, noise=0.0, seconds=60.0)
        felt = some.wrench + 5e-4 * FULL_SCALE * correlated(rng, 6000, 10)
        found = fit(tiled(dataclasses.replace(some, wrench=felt)), PRIOR)
        error = np.abs(found.estimate.gain - gain)
        inside += int((error < 3 * found.estimate.standard_error).sum())
        entries += 36
    assert inside / entries >= 0.97


def test_errors_that_follow_the_motion_widen_the_error_bars() -> None:
    """A model error proportional to the load lasts as long as the load does: count it."""
    inside = {}
    for kind in ("plain", "robust"):
        hits = []
        for seed in range(20):
            rng = np.random.default_rng(seed)
            gain = bent(PRIOR, rng)
            some = samples(gain, rng, count=6000, noise=1e-4, seconds=60.0)
            # the model is wrong by up to 2 % for stretches of 2 s
            wrong = np.repeat(rng.normal(size=(30, 6)) * 0.02, 200, axis=0)
            tiles = tiled(dataclasses.replace(some, wrench=some.wrench * (1 + wrong)))
            problem = ScaledProblem.of(pooled(tiles), PRIOR)
            noise = measured_noise(tiles, problem, FitOptions())
            kappa = np.full(6, 0.03)
            if kind == "robust":
                found = robust_posterior(problem, tiles, kappa, noise)
            else:
                found = problem.posterior(kappa, noise)
            hits.append(np.abs(found.gain - gain) < 2.0 * found.standard_error)
        inside[kind] = float(np.mean(hits))
    # nominal 95 %; 720 correlated entries know it within about 3 %
    assert inside["robust"] > max(inside["plain"], 0.88)


def test_a_bent_sensor_gets_a_wide_prior_and_a_true_one_a_tight() -> None:
    rng = np.random.default_rng(3)
    kappas = []
    for gain in (PRIOR.gain, bent(PRIOR, rng, kappa=0.1)):
        tiles = tiled(samples(gain, rng, count=200, noise=3e-3, share=0.02))
        noise = Noise(3e-3 * FULL_SCALE, np.ones(6))
        kappas.append(choose_kappa(tiles, PRIOR, noise, np.eye(6)).chosen)
    assert kappas[0] < 0.01 < kappas[1]


def test_noise_free_data_recover_the_gain() -> None:
    rng = np.random.default_rng(4)
    gain = bent(PRIOR, rng)
    several = [samples(gain, rng, offset=o, noise=0.0) for o in (-0.3, 0.2)]
    tiles = tiled(*several)
    found = fit(tiles, PRIOR, FitOptions(penalty=0.0))
    scaled = (found.estimate.gain - gain) / np.abs(gain).max()
    np.testing.assert_allclose(scaled, 0.0, atol=1e-9)
    offsets = segment_offsets(tiles.segments, found.estimate, found.noise)
    for offset, true in zip(offsets, (-0.3, 0.2), strict=True):
        np.testing.assert_allclose(offset.offset / FULL_SCALE, true, atol=1e-8)


def test_an_offset_taken_off_beforehand_is_not_fitted_again() -> None:
    rng = np.random.default_rng(5)
    gain = bent(PRIOR, rng)
    some = samples(gain, rng, offset=0.4, noise=0.0)
    raw = np.linalg.solve(gain, -0.4 * FULL_SCALE)
    tiles = tiled(dataclasses.replace(some, channels=some.channels - raw))
    found = fit(tiles, PRIOR, FitOptions(penalty=0.0), about_zero)
    np.testing.assert_allclose(found.estimate.gain, gain, atol=1e-9 * np.abs(gain).max())


def test_nothing_to_train_on_is_refused() -> None:
    with pytest.raises(DataError, match="no usable sample"):
        fit(cells(()), PRIOR)
