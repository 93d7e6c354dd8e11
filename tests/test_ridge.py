"""The regression: the paper's theorem, its limits, and the numbers against numpy.linalg.lstsq."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal.errors import DataError
from ftcal.moments import Moments, total, within
from ftcal.noise import Noise
from ftcal.ridge import ScaledProblem, penalty_path, ridge_path
from ftcal.samples import Samples
from pretend import FULL_SCALE, bent, samples, workbench

PRIOR = workbench()
seeds = st.integers(0, 2**32 - 1)
QUIET = Noise(1e-3 * FULL_SCALE, np.ones(6))


def close(a: np.ndarray, b: np.ndarray, tolerance: float) -> None:
    """Compare gains in fractions of full scale, where every entry counts alike."""
    scaled = [np.linalg.solve(PRIOR.gain.T, (g / FULL_SCALE[:, None]).T) for g in (a, b)]
    difference = scaled[0] - scaled[1]
    np.testing.assert_allclose(difference * FULL_SCALE[:, None], 0.0, atol=tolerance)


@given(seeds, st.floats(-0.5, 0.5))
@settings(max_examples=25, deadline=None)
def test_centred_solution_is_the_joint_solution(seed: int, offset: float) -> None:
    """The theorem of the appendix: gain and offset of P2 from centred data alone."""
    rng = np.random.default_rng(seed)
    some = samples(bent(PRIOR, rng), rng, count=200, offset=offset, noise=1e-3)
    design = np.column_stack([some.channels, np.ones(len(some))])
    joint = np.linalg.lstsq(design, some.wrench, rcond=None)[0]
    moments = some.moments()
    centred = penalty_path(moments, PRIOR, np.array([0.0]))[0]
    # lstsq is solved with the offset's 1e4 counts in the design: condition about 1e5
    close(centred.gain, joint[:6].T, 1e-7)
    difference = (centred.offset(moments) - joint[6]) / FULL_SCALE
    np.testing.assert_allclose(difference, 0.0, atol=1e-7)


@given(seeds)
@settings(max_examples=10, deadline=None)
def test_recordings_with_offsets_of_their_own_share_one_gain(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gain = bent(PRIOR, rng)
    several = [samples(gain, rng, count=300, offset=o, noise=0.0) for o in (-0.4, 0.1, 0.7)]
    pooled = within([s.moments() for s in several])
    found = penalty_path(pooled, PRIOR, np.array([0.0]))[0]
    close(found.gain, gain, 1e-8)
    for some, offset in zip(several, (-0.4, 0.1, 0.7), strict=True):
        np.testing.assert_allclose(found.offset(some.moments()) / FULL_SCALE, offset, atol=1e-8)


def test_one_offset_for_all_recordings_gives_a_wrong_gain() -> None:
    rng = np.random.default_rng(1)
    gain = bent(PRIOR, rng)
    several = [samples(gain, rng, count=300, offset=o, noise=0.0) for o in (-0.4, 0.1, 0.7)]
    found = penalty_path(total([s.moments() for s in several]), PRIOR, np.array([0.0]))[0]
    assert np.abs((found.gain - gain) / gain).max() > 0.05


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_penalty_to_infinity_returns_the_prior(seed: int) -> None:
    rng = np.random.default_rng(seed)
    moments = samples(bent(PRIOR, rng), rng, count=100).moments()
    paper = penalty_path(moments, PRIOR, np.array([1e18]))[0]
    scaled = ScaledProblem.of(moments, PRIOR).posterior(np.full(6, 1e-12), QUIET)
    close(paper.gain, PRIOR.gain, 1e-9)
    close(scaled.gain, PRIOR.gain, 1e-9)


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_penalty_to_zero_returns_least_squares(seed: int) -> None:
    rng = np.random.default_rng(seed)
    some = samples(bent(PRIOR, rng), rng, count=100)
    centred = some.rows() - some.rows().mean(axis=0)
    plain = np.linalg.lstsq(centred[:, :6], centred[:, 6:], rcond=None)[0].T
    moments = some.moments()
    close(penalty_path(moments, PRIOR, np.array([1e-12]))[0].gain, plain, 1e-8)
    scaled = ScaledProblem.of(moments, PRIOR).posterior(np.full(6, 1e6), QUIET)
    close(scaled.gain, plain, 1e-8)


def test_path_equals_one_solution_a_penalty() -> None:
    rng = np.random.default_rng(3)
    A = rng.normal(size=(40, 5))
    S, b = A.T @ A, rng.normal(size=(6, 5))
    penalty = np.geomspace(1e-3, 1e3, 7)[:, None] * np.ones(6)
    path = ridge_path(S, b, penalty)
    for E, mu in zip(path, penalty[:, 0], strict=True):
        np.testing.assert_allclose(E, np.linalg.solve(S + mu * np.eye(5), b.T).T, rtol=1e-10)


def test_closed_form_of_the_paper() -> None:
    """P7: `C = (S_wr + lambda C_w)(S_rr + lambda I)^-1`, lambda over the 6N residuals."""
    rng = np.random.default_rng(4)
    some = samples(bent(PRIOR, rng), rng, count=150)
    moments, lam = some.moments(), 10.0
    S = moments.covariance() / 6.0
    closed = np.linalg.solve((S[:6, :6] + lam * np.eye(6)).T, (S[6:, :6] + lam * PRIOR.gain).T).T
    close(penalty_path(moments, PRIOR, np.array([lam]))[0].gain, closed, 1e-9)


def test_scaled_prior_is_the_ridge_of_stacked_rows() -> None:
    """The MAP estimate equals least squares with the prior as six more rows of data."""
    rng = np.random.default_rng(5)
    some = samples(bent(PRIOR, rng), rng, count=400, noise=1e-3)
    kappa, noise = 0.02, Noise(2e-3 * FULL_SCALE, np.full(6, 7.0))
    found = ScaledProblem.of(some.moments(), PRIOR).posterior(np.full(6, kappa), noise)
    rows = some.rows() - some.rows().mean(axis=0)
    y = rows[:, :6] @ PRIOR.scaling.T
    z = (rows[:, 6:] - rows[:, :6] @ PRIOR.gain.T) / FULL_SCALE
    sd = 2e-3 * np.sqrt(7.0)
    stacked = np.concatenate([y / sd, np.eye(6) / kappa])
    E = np.linalg.lstsq(stacked, np.concatenate([z / sd, np.zeros((6, 6))]), rcond=None)[0].T
    close(found.gain, PRIOR.gain + FULL_SCALE[:, None] * (E @ PRIOR.scaling), 1e-10)
    covariance = np.linalg.inv(stacked.T @ stacked)
    expected = FULL_SCALE[2] ** 2 * PRIOR.scaling.T @ covariance @ PRIOR.scaling
    np.testing.assert_allclose(found.covariance[2], expected, rtol=1e-8)


@pytest.mark.parametrize("form", ["lambda", "kappa"])
def test_a_drift_with_temperature_is_told_from_the_load(form: str) -> None:
    rng = np.random.default_rng(6)
    gain = bent(PRIOR, rng)
    cold = samples(gain, rng, count=2000, noise=1e-5)
    k = np.array([0.5, -0.3, 0.8, 0.01, 0.02, -0.005])
    temperature = 3.0 * np.sin(cold.time / 3.0) + 0.2 * cold.time
    felt = cold.wrench + np.outer(temperature, k)
    warm = Samples("warm", 0.0, 20.0, cold.time, cold.channels, felt, temperature)
    moments = warm.moments()
    if form == "lambda":
        found = penalty_path(moments, PRIOR, np.array([0.0]))[0]
    else:
        noise = Noise(1e-5 * FULL_SCALE, np.ones(6))
        found = ScaledProblem.of(moments, PRIOR).posterior(np.full(6, 0.1), noise)
    assert found.temperature_gain is not None
    np.testing.assert_allclose(found.temperature_gain, k, atol=1e-5 * FULL_SCALE.max())
    close(found.gain, gain, 1e-3)


def test_eight_channels_are_fitted_like_six() -> None:
    rng = np.random.default_rng(7)
    from ftcal.sensor import Workbench

    gain = rng.normal(size=(6, 8)) * FULL_SCALE[:, None] / 32767
    prior = Workbench("eight", gain * (1 + 0.05 * rng.normal(size=(6, 8))), FULL_SCALE, "channels")
    channels = rng.normal(size=(500, 8)) * 1000
    some = Samples("eight", 0, 5, np.arange(500) / 100, channels, channels @ gain.T)
    found = ScaledProblem.of(some.moments(), prior).posterior(
        np.full(6, 1.0), Noise(1e-6 * FULL_SCALE, np.ones(6))
    )
    np.testing.assert_allclose(found.gain, gain, rtol=1e-5)
    assert prior.secondary(found.gain) is None


def test_samples_of_another_width_are_refused() -> None:
    with pytest.raises(DataError, match="3 columns beside the wrench"):
        ScaledProblem.of(Moments.of(np.zeros((4, 9))), PRIOR)


def test_a_negative_lambda_is_refused() -> None:
    with pytest.raises(DataError, match="not negative"):
        penalty_path(Moments.of(np.ones((4, 12))), PRIOR, np.array([-1.0]))
