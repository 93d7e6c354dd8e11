"""Who carries the robot: shares of its weight over time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ftcal.contact import Interval
from ftcal.errors import DataError
from ftcal.motion import FixedContact
from ftcal.support import Support, standing_on

FRAMES = ("pole", "l_sole", "r_sole")
WALK = Support(
    FRAMES,
    np.array([0.0, 5.0, 6.0, 9.0, 10.0, 12.0, 13.0]),
    np.array(
        [[1, 0, 0], [1, 0, 0], [0, 0.5, 0.5], [0, 1, 0], [0, 1, 0], [0, 0.5, 0.5], [0, 0.5, 0.5]]
    ),
)


@st.composite
def supports(draw: st.DrawFn) -> Support:
    rows = draw(
        st.lists(st.lists(st.integers(0, 2), min_size=3, max_size=3).filter(any), min_size=1)
    )
    gaps = draw(st.lists(st.floats(0.01, 10.0), min_size=len(rows) - 1, max_size=len(rows) - 1))
    shares = np.array(rows, dtype=np.float64)
    return Support(FRAMES, np.cumsum([0.0, *gaps]), shares / shares.sum(axis=1, keepdims=True))


@given(support=supports())
def test_shares_are_shares_at_any_time(support: Support) -> None:
    shares = support.at(np.linspace(-1.0, support.times[-1] + 1.0, 101))
    # a blend of two rows rounds like three numbers of size one
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-14)
    assert shares.min() >= -1e-15


@given(support=supports())
def test_rows_are_reached_on_time_and_kept_beyond(support: Support) -> None:
    np.testing.assert_allclose(support.at(support.times), support.shares, atol=1e-15)
    beyond = support.at(np.array([-3.0, support.times[-1] + 3.0]))
    np.testing.assert_array_equal(beyond, support.shares[[0, -1]])


@given(support=supports())
def test_who_is_not_in_an_interval_carries_nothing_in_it(support: Support) -> None:
    intervals = support.schedule().intervals
    assert intervals[0].start == 0.0
    assert intervals[-1].stop == np.inf
    for interval in intervals:
        time = np.linspace(interval.start, min(interval.stop, interval.start + 20.0), 50)[1:-1]
        carries = (support.at(time) > 0.0).any(axis=0)
        touches = [name in (interval.link, *interval.others) for name in FRAMES]
        np.testing.assert_array_equal(carries, touches)


def test_load_moves_as_smoothly_as_a_joint() -> None:
    shares = WALK.at(np.array([6.0, 6.75, 7.5, 8.25, 9.0]))[:, 1]
    # minimum jerk: 10 s^3 - 15 s^4 + 6 s^5 at a quarter is 0.103515625
    np.testing.assert_allclose(
        shares, [0.5, 0.5 + 0.103515625 / 2, 0.75, 1 - 0.103515625 / 2, 1.0], rtol=1e-14
    )


def test_schedule_is_the_longest_spans_with_the_same_frames() -> None:
    assert WALK.schedule().intervals == (
        Interval(0.0, 5.0, "pole"),
        Interval(5.0, 6.0, "pole", ("l_sole", "r_sole")),
        Interval(6.0, 9.0, "l_sole", ("r_sole",)),
        Interval(9.0, 10.0, "l_sole"),
        Interval(10.0, np.inf, "l_sole", ("r_sole",)),
    )


def test_one_contact_carries_all_for_ever() -> None:
    support = standing_on(FixedContact("base", (0.0, 9.0, 0.0)))
    assert support.gravity == (0.0, 9.0, 0.0)
    assert support.schedule().intervals == (Interval(0.0, np.inf, "base"),)
    np.testing.assert_array_equal(support.at(np.array([-1.0, 0.0, 1e6])), np.ones((3, 1)))


@pytest.mark.parametrize(
    ("frames", "times", "shares", "words"),
    [
        (
            ("a", "b"),
            [0, 1],
            [[1, 0], [0.5, 0.6]],
            r"\[0.5, 0.6\] at 1 s must be 0 or more and sum",
        ),
        (("a", "b"), [0, 1], [[1, 0], [1.5, -0.5]], "at 1 s must be 0 or more"),
        (("a",), [0], [[np.nan]], "sum to one"),
        (("a",), [1, 2], [[1], [1]], "from 0 s"),
        (("a",), [0, 2, 2], [[1], [1], [1]], "increase strictly"),
        (("a",), [], np.zeros((0, 1)), "from 0 s"),
        (("a",), [0, np.inf], [[1], [1]], "increase strictly"),
        (("a", "a"), [0], [[1, 0]], "'a' appears twice"),
        ((), [0], [[]], "there is no frame"),
        (("a",), [0], [[1, 0]], r"shape \(1, 2\) for \(1,\) times and 1 frames"),
    ],
)
def test_what_is_no_support_is_refused(
    frames: tuple[str, ...], times: list[float], shares: list[list[float]], words: str
) -> None:
    with pytest.raises(DataError, match=words):
        Support(frames, np.array(times, dtype=np.float64), np.array(shares, dtype=np.float64))


def test_all_faults_are_told_at_once() -> None:
    with pytest.raises(DataError, match=r"from 0 s.*sum to one.*gravity"):
        Support(("a",), np.ones(1), np.zeros((1, 1)), (np.inf, 0.0, 0.0))
