"""Moments are all that least squares needs, however the table was cut."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ftcal.moments import Moments, total, within

tables = arrays(
    np.float64,
    st.tuples(st.integers(1, 30), st.just(3)),
    elements=st.floats(-1e3, 1e3, allow_subnormal=False),
)


def same(a: Moments, b: Moments) -> None:
    # relative to the size of the squared entries that went in: the scatter itself may cancel
    size = 1.0 + max(np.abs(a.mean).max(), np.abs(b.mean).max(), np.abs(b.scatter).max() ** 0.5)
    assert a.count == b.count
    np.testing.assert_allclose(a.mean, b.mean, rtol=0, atol=1e-12 * size)
    np.testing.assert_allclose(a.scatter, b.scatter, rtol=0, atol=1e-11 * size**2 * a.count)


@given(tables, tables)
def test_merge_equals_stack(a: np.ndarray, b: np.ndarray) -> None:
    same(Moments.of(a) + Moments.of(b), Moments.of(np.concatenate([a, b])))


@given(st.lists(tables, min_size=1, max_size=5))
def test_total_of_many_equals_stack(parts: list[np.ndarray]) -> None:
    same(total([Moments.of(p) for p in parts]), Moments.of(np.concatenate(parts)))


@given(tables, tables)
def test_merging_commutes(a: np.ndarray, b: np.ndarray) -> None:
    one, other = Moments.of(a), Moments.of(b)
    same(one + other, other + one)


@given(tables, tables, arrays(np.float64, 3, elements=st.floats(-1e3, 1e3)))
def test_within_forgets_an_offset_of_each_table(
    a: np.ndarray, b: np.ndarray, shift: np.ndarray
) -> None:
    before = within([Moments.of(a), Moments.of(b)]).scatter
    after = within([Moments.of(a), Moments.of(b + shift)]).scatter
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-7)  # (2e3)^2 * 30 rows * eps * 10


@given(tables)
def test_about_the_mean_changes_nothing(a: np.ndarray) -> None:
    moments = Moments.of(a)
    same(moments.about(moments.mean), moments)


@given(tables)
def test_about_zero_is_the_plain_second_moment(a: np.ndarray) -> None:
    np.testing.assert_allclose(Moments.of(a).about(np.zeros(3)).scatter, a.T @ a, rtol=0, atol=1e-7)


def test_counts_riding_on_a_large_offset_keep_their_digits() -> None:
    rng = np.random.default_rng(0)
    signal = rng.normal(size=(1000, 3))
    exact = Moments.of(signal).scatter
    shifted = total([Moments.of(chunk + 3e4) for chunk in np.array_split(signal, 7)]).scatter
    np.testing.assert_allclose(shifted, exact, rtol=0, atol=1e-7)  # 3e4 * eps * sqrt(1000 * ...)


def test_a_table_without_rows_adds_nothing() -> None:
    some = Moments.of(np.arange(6.0).reshape(2, 3))
    same(some + Moments.of(np.empty((0, 3))), some)
    same(Moments.of(np.empty((0, 3))) + some, some)
