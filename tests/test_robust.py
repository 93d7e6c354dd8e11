"""Weights: what does not fit counts less, what fits counts in full, and the fit is the better."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal.balances import Balance
from ftcal.config import FitSection, read_job
from ftcal.errors import JobError
from ftcal.fit import FitOptions, fit
from ftcal.folds import pooled
from ftcal.ridge import scaling_map
from ftcal.robust import FEWEST, huber_weights
from ftcal.samples import Samples
from ftcal.terms import Terms, Weights, summed
from ftcal.whole_body import fit_all, robust_weights
from pretend import FULL_SCALE, bent, samples, tiled, workbench
from test_whole_body import ALWAYS, EXACT, SPANS, frames_of, raw_balances, world

PRIOR = workbench()


@given(st.integers(0, 1000), st.sampled_from([3, 6]))
@settings(max_examples=30, deadline=None)
def test_good_seconds_count_in_full_but_for_one_in_a_hundred(seed: int, axes: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = rng.uniform(0.1, 10.0, axes)
    weights = huber_weights(5.0 + sizes * rng.normal(size=(400, axes)))
    # binomial: 4 of 400 expected, 3 standard deviations are 6 more; the spread is estimated too
    assert np.mean(weights < 1.0) < 0.04
    assert weights.min() > 0.5


@given(st.floats(10.0, 1e6), st.integers(0, 5))
@settings(max_examples=30, deadline=None)
def test_weight_falls_with_the_distance(distance: float, axis: int) -> None:
    means = np.random.default_rng(3).normal(size=(40, 6))
    means[7] = 0.0
    means[7, axis] = distance
    weights = huber_weights(means)
    # 4.1 spreads are within reach; the spread of 40 cells is known to a third
    assert weights[7] == pytest.approx(4.1 / distance, rel=0.35)
    assert (np.delete(weights, 7) > 0.6).all()


def test_a_stretch_that_is_off_as_a_whole_has_no_outliers() -> None:
    rng = np.random.default_rng(4)
    assert huber_weights(100.0 + rng.normal(size=(30, 6))).min() > 0.6


def test_few_cells_have_no_outliers() -> None:
    means = np.zeros((FEWEST - 1, 6))
    means[0] = 1e9
    assert (huber_weights(means) == 1.0).all()


def test_exact_cells_count_in_full() -> None:
    assert (huber_weights(np.zeros((20, 6))) == 1.0).all()


def knocked(sample: Samples, starts: tuple[float, ...], push: np.ndarray) -> Samples:
    """Return samples whose sensor felt a `push` [N, Nm] of two seconds that no model knows."""
    during = np.any([(sample.time >= t) & (sample.time < t + 2.0) for t in starts], axis=0)
    return replace(sample, wrench=sample.wrench - during[:, None] * push)


def distance(gain: np.ndarray, truth: np.ndarray) -> float:
    basis = scaling_map(PRIOR, 6)[:6, :6]
    return float(np.abs((gain - truth) / FULL_SCALE[:, None] @ np.linalg.inv(basis)).max())


@pytest.mark.parametrize("seed", range(4))
def test_a_hand_on_the_robot_moves_a_robust_fit_less(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = bent(PRIOR, rng)
    good = samples(truth, rng, count=3000, seconds=60.0, share=0.02)
    pushed = knocked(good, (11.0, 35.0), 0.02 * FULL_SCALE * rng.normal(size=6))
    tiles = tiled(pushed)
    plain, robust = (fit(tiles, PRIOR, FitOptions(robust=r)) for r in (False, True))
    assert plain.down_weighted == 0.0
    # four seconds of sixty, and the cells that their edges share
    assert 3.0 / 60.0 < robust.down_weighted < 0.25
    assert distance(robust.estimate.gain, truth) < 0.6 * distance(plain.estimate.gain, truth)


def test_good_data_are_fitted_alike() -> None:
    rng = np.random.default_rng(9)
    truth = bent(PRIOR, rng)
    tiles = tiled(samples(truth, rng, count=3000, seconds=60.0))
    plain, robust = (fit(tiles, PRIOR, FitOptions(robust=r)) for r in (False, True))
    assert robust.down_weighted < 0.05
    sd = np.sqrt(np.einsum("ijj->ij", plain.estimate.covariance))
    # what a cell or two less of sixty may do: a part of the error bar
    assert np.max(np.abs(robust.estimate.gain - plain.estimate.gain) / sd) < 1.0


def test_weights_of_cells_count_as_samples_do() -> None:
    rng = np.random.default_rng(2)
    some = samples(PRIOR.gain, rng, count=400, seconds=4.0)
    tiles = tiled(some)
    weights = np.array([1.0, 0.5, 0.25, 1.0])
    rows, each = some.rows(), np.repeat(weights, 100)
    mean = np.average(rows, axis=0, weights=each)
    found = pooled(tiles.weighing(weights))
    assert found.count == each.sum()
    np.testing.assert_allclose(found.mean, mean)
    scatter = (rows - mean).T @ (each[:, None] * (rows - mean))
    sizes = np.sqrt(np.outer(np.diag(scatter), np.diag(scatter)))
    np.testing.assert_allclose(found.scatter / sizes, scatter / sizes, atol=1e-12)
    assert tiles.weighing(weights).down_weighted == 200


def test_whole_body_weights_find_the_seconds_in_which_the_left_foot_was_held() -> None:
    one = world()
    frames = frames_of(one)
    references = {
        name: np.concatenate([p.inputs[name] for p in raw_balances(one) if name in p.inputs]).mean(
            0
        )
        for name in frames
    }
    segments = dict.fromkeys(references, (ALWAYS,))
    rng = np.random.default_rng(0)
    sd = np.repeat([0.03, 0.003], 3)
    clean, held = [], []
    for part in raw_balances(one):
        noisy = replace(part, required=part.required + sd * rng.normal(size=part.required.shape))
        touched = (part.time >= 38.0) & (part.time < 40.0) & (part.sub_model == "l_foot")
        push = touched[:, None] * np.array([30.0, -20.0, 40.0, 2.0, 3.0, -1.0])
        clean.append(noisy)
        held.append(replace(noisy, required=noisy.required + push))

    def terms(parts: list[Balance], weights: Weights) -> list[Terms]:
        return [
            term
            for part in parts
            for start, stop, _ in SPANS
            for term in summed(
                part,
                "take",
                frames,
                references,
                segments,
                (start, stop),
                EXACT,
                weights=weights,
            )
        ]

    plain, _ = fit_all(terms(held, {}), frames, kappa=0.03)
    weights = robust_weights(terms(held, {}), plain)
    (low,) = (w for (name, where), w in weights.items() if (name, where.start) == ("l_foot", 31.0))
    # cells last a second
    assert {6, 7, 8, 9} >= set(np.flatnonzero(low < 0.5)) >= {7, 8}
    assert np.mean(np.concatenate(list(weights.values())) < 0.5) < 0.1
    robust, _ = fit_all(terms(held, weights), frames, kappa=0.03)
    untouched, _ = fit_all(terms(clean, {}), frames, kappa=0.03)
    moved = [
        np.linalg.norm(one.entries("l_foot_ft_sensor") - untouched.entries("l_foot_ft_sensor"))
        for one in (plain, robust)
    ]
    # Huber bounds the pull of what does not fit, and does not cut it; measured 0.76
    assert moved[1] < 0.85 * moved[0]


def test_robust_weights_and_the_papers_penalty_exclude_each_other(tmp_path: Path) -> None:
    job = tmp_path / "job.toml"
    job.write_text(
        'robot = "r.urdf"\n[[sensors]]\nname = "a"\nsignal = "b"\n[[recordings]]\nlog = "c"\n'
        'contact = "base"\n[fit]\nlambda = 1.0\nrobust = true\n'
    )
    with pytest.raises(JobError, match="robust weights need kappa"):
        read_job(job)
    assert not FitSection().robust
