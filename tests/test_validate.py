"""Scores on held-out samples and the verdicts that rest on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal.bootstrap import bootstrap_intervals, resampled
from ftcal.excitation import Direction, Excitation
from ftcal.segments import Segment
from ftcal.sensor import AXES
from ftcal.validate import Score, Scores, held_out, load_envelope, score
from ftcal.verdict import Verdict, advice, judge, overall
from pretend import FULL_SCALE, bent, samples, workbench

PRIOR = workbench()


def scores_of(gain: np.ndarray, truth: np.ndarray, *, share: float = 0.05) -> Scores:
    rng = np.random.default_rng(0)
    seen = samples(truth, rng)
    test = Segment.of(samples(truth, rng, offset=0.2, share=share), 1.0)
    return score("hold-out", [held_out(test, gain, PRIOR)], load_envelope(seen.wrench))


def test_the_workbench_itself_scores_a_hundred_percent() -> None:
    found = scores_of(PRIOR.gain, bent(PRIOR, np.random.default_rng(1)))
    for item in found.by_name.values():
        assert item.percent == pytest.approx(100.0)
        assert item.percent_absolute == pytest.approx(100.0)
        assert item.amplitude == pytest.approx(1.0)
        assert item.interval == pytest.approx((100.0, 100.0))


def test_the_truth_scores_the_noise_alone() -> None:
    truth = bent(PRIOR, np.random.default_rng(1))
    found = scores_of(truth, truth)
    for i, axis in enumerate(AXES):
        assert found.by_name[axis].rms == pytest.approx(1e-4 * FULL_SCALE[i], rel=0.05)
        assert found.by_name[axis].interval[1] < 100.0


def test_a_vanished_sensor_has_no_amplitude() -> None:
    found = scores_of(1e-9 * PRIOR.gain, PRIOR.gain)
    assert all(item.amplitude < 1e-6 for item in found.by_name.values())


def test_force_together_is_the_length_of_the_residual() -> None:
    truth = bent(PRIOR, np.random.default_rng(1))
    found = scores_of(PRIOR.gain, truth)
    axes = [found.by_name[axis].rms for axis in AXES[:3]]
    assert found.by_name["force"].rms == pytest.approx(np.linalg.norm(axes))


def test_loads_beyond_training_are_reported() -> None:
    truth = bent(PRIOR, np.random.default_rng(1))
    assert scores_of(truth, truth, share=0.2).by_name["fx"].beyond > 0.3
    assert scores_of(truth, truth, share=0.01).by_name["fx"].beyond == 0.0


def test_a_held_out_piece_is_aligned_to_its_own_offset() -> None:
    rng = np.random.default_rng(0)
    piece = held_out(Segment.of(samples(PRIOR.gain, rng, offset=0.7), 1.0), PRIOR.gain, PRIOR)
    np.testing.assert_allclose((piece.in_situ - piece.model).mean(axis=0), 0.0, atol=1e-9)


@given(st.integers(3, 40), st.floats(0.1, 3.0))
@settings(max_examples=20, deadline=None)
def test_interval_covers_a_constant_ratio_exactly(blocks: int, ratio: float) -> None:
    old = np.random.default_rng(blocks).uniform(1, 2, blocks)
    both = ratio**2 * np.stack([old, 3.0 * old], axis=1), np.stack([old, old], axis=1)
    (first, second) = bootstrap_intervals(*both, resampled(blocks, 0))
    assert first == pytest.approx((100 * ratio, 100 * ratio))
    assert second == pytest.approx((173.20508 * ratio, 173.20508 * ratio))


def test_bootstrap_covers_the_truth_nine_times_in_ten() -> None:
    rng = np.random.default_rng(5)
    hits = 0
    for trial in range(300):
        new, old = rng.gamma(4.0, 1.0, (40, 1)), rng.gamma(4.0, 1.0, (40, 1))
        ((low, high),) = bootstrap_intervals(new, old, resampled(len(new), trial))
        hits += low <= 100.0 <= high
    # percentile intervals of 40 blocks run a little narrow; 300 trials know it within 2 %
    assert 0.84 <= hits / 300 <= 0.95


def test_two_blocks_say_nothing() -> None:
    ones = np.ones((2, 2))
    assert bootstrap_intervals(ones, ones, resampled(2, 0)) == [(0.0, np.inf)] * 2


UNIT = np.ones(6)


def seen(
    *, signal: float = 50.0, share: float = 1.0, amplitude: float = 1.0, anchored: bool = True
) -> Excitation:
    directions = [
        Direction(np.eye(6)[i], AXES[i], 0.1, signal if i == 5 else 50.0, np.full(6, share))
        for i in range(6)
    ]
    return Excitation(tuple(directions), anchored, amplitude)


def with_interval(low: float, high: float, amplitude: float = 1.0) -> Scores:
    item = Score("fx", "N", 1.0, 2.0, 50.0, (low, high), 50.0, amplitude, (0, 1), (0, 1), 0.0)
    return Scores("hold-out", (), dict.fromkeys(AXES, item), 10, 1.0, 5)


def test_better_and_fully_seen_is_accepted() -> None:
    assert overall(judge(seen(), with_interval(40, 60), UNIT)) == "ACCEPT"


def test_better_with_a_direction_on_the_prior_is_partial() -> None:
    verdicts = judge(seen(signal=1.0), with_interval(40, 60), UNIT)
    assert overall(verdicts) == "PARTIAL"
    assert "1 direction not excited: tz" in verdicts[0].reason
    assert overall(judge(seen(share=0.2), with_interval(40, 60), UNIT)) == "PARTIAL"


def test_an_interval_that_contains_a_hundred_keeps_the_workbench() -> None:
    verdicts = judge(seen(), with_interval(40, 110), UNIT)
    assert not any(v.use for v in verdicts)
    assert verdicts[0].reason == (
        "50 % of Workbench on hold-out [40, 110]; the interval reaches 100 %: not shown to be"
        " better than the Workbench"
    )


def test_a_matrix_like_the_workbench_is_not_called_worse() -> None:
    assert "not shown to be better" in judge(seen(), with_interval(100, 100), UNIT)[0].reason


def test_an_interval_without_an_end_says_that_too_little_is_held_out() -> None:
    reason = judge(seen(), with_interval(0, np.inf), UNIT)[0].remark
    assert reason == "too little is held out to tell: not shown to be better than the Workbench"


def test_channels_that_stay_in_their_noise_are_not_said_to_stand_still() -> None:
    still = [replace(direction, signal=2.9) for direction in seen().directions]
    verdicts = judge(replace(seen(), directions=tuple(still)), with_interval(40, 60), UNIT)
    assert {(v.word, v.reason) for v in verdicts} == {
        ("REFUSE", "no direction of the channels moved beyond its noise")
    }


def test_a_scale_that_is_free_tells_what_a_vanished_sensor_would_leave() -> None:
    reason = judge(seen(amplitude=0.05), with_interval(40, 60), UNIT)[0].reason
    assert "varies by 5.0 % of the Workbench's reading, so C -> 0 would leave no more" in reason


def test_a_matrix_trained_on_next_to_no_load_is_partial() -> None:
    verdicts = judge(seen(), with_interval(40, 60), 200.0 * UNIT)
    assert overall(verdicts) == "PARTIAL"
    assert "trained on 0.5 % of full scale" in verdicts[0].reason


def test_a_worse_axis_says_so() -> None:
    assert "worse" in judge(seen(), with_interval(120, 140), UNIT)[0].reason


def test_without_validation_nothing_is_accepted() -> None:
    assert {v.word for v in judge(seen(), None, UNIT)} == {"REFUSE"}


def test_a_reading_that_noise_shrank_is_refused() -> None:
    vanished = with_interval(1, 2, amplitude=0.05)
    loose = judge(seen(signal=1.0, anchored=False), vanished, UNIT)
    assert {v.word for v in loose} == {"REFUSE"}
    assert "shrinks to 5 %" in loose[0].reason
    # cross-talk on an axis that is never loaded may rightly vanish where the prior holds the rest
    assert overall(judge(seen(signal=1.0), vanished, UNIT)) == "PARTIAL"


def test_advice_names_what_is_kept() -> None:
    words = {"fx": "REFUSE", "fy": "PARTIAL", "fz": "ACCEPT"}
    verdicts = [Verdict(axis, word, "") for axis, word in words.items()]  # type: ignore[arg-type]
    assert advice(verdicts) == "use fy, fz; keep the Workbench for fx"
