import functools
from fractions import Fraction
from math import factorial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ftcal import filters, jit
from ftcal.errors import DataError
from ftcal.filters import Engine, coefficients, smooth, smooth_and_derive

ENGINES: list[Engine] = ["llvm", "numpy"] if jit.available() else ["numpy"]
SHAPES = [(81, 1), (81, 7), (83, 1), (95, 3), (300, 1), (500, 32), (2000, 6), (1200, 37)]


def signal_of(shape: tuple[int, int], seed: int = 0) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).standard_normal(shape), axis=0)


@pytest.mark.parametrize("derivative", [0, 1, 2, 3])
@pytest.mark.parametrize(("window", "order"), [(5, 2), (81, 4), (101, 2), (31, 7), (3, 2)])
def test_coefficients_equal_scipy(window: int, order: int, derivative: int) -> None:
    from scipy.signal import savgol_coeffs

    ours = coefficients(window, order, derivative, 0.01)
    theirs = savgol_coeffs(window, order, derivative, 0.01, use="dot")
    # scipy solves with plain powers of -40 … 40, whose condition costs it six digits
    scale = np.abs(theirs).max() or (2.0 / (window * 0.01)) ** derivative
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9 * scale)


@pytest.mark.parametrize(("window", "order"), [(5, 2), (81, 4), (101, 2), (31, 7)])
def test_coefficients_equal_exact_arithmetic(window: int, order: int) -> None:
    half = window // 2
    times = range(-half, half + 1)
    for derivative in range(order + 1):
        # the normal equations in fractions, by Gauss-Jordan elimination
        rows = [
            [Fraction(sum(t ** (i + j) for t in times)) for j in range(order + 1)]
            + [Fraction(int(i == derivative))]
            for i in range(order + 1)
        ]
        for i in range(order + 1):  # a Gram matrix: its pivots are positive
            rows[i] = [entry / rows[i][i] for entry in rows[i]]
            for r in range(order + 1):
                if r != i:
                    factor = rows[r][i]
                    rows[r] = [a - factor * b for a, b in zip(rows[r], rows[i], strict=True)]
        solution = [row[-1] * factorial(derivative) for row in rows]
        exact = [float(sum(a * t**p for p, a in enumerate(solution))) for t in times]
        np.testing.assert_allclose(
            coefficients(window, order, derivative), exact, rtol=0, atol=1e-14 * np.abs(exact).max()
        )


@given(
    half=st.integers(2, 60),
    order=st.integers(0, 4),
    derivative=st.integers(0, 2),
    step=st.floats(1e-3, 10.0),
)
def test_coefficients_are_exact_on_polynomials(
    half: int, order: int, derivative: int, step: float
) -> None:
    t = np.arange(-half, half + 1) / half  # the unit of time is half a window
    c = coefficients(2 * half + 1, order, derivative, step) * (half * step) ** derivative
    for power in range(order + 1):
        expected = float(np.prod(range(1, derivative + 1))) if power == derivative else 0.0
        # rounding of 2 half + 1 terms, each as large as the coefficients
        np.testing.assert_allclose(c @ t**power, expected, atol=1e-13 * (1 + np.abs(c).sum()))


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("shape", SHAPES)
def test_value_and_derivatives_equal_scipy(shape: tuple[int, int], engine: Engine) -> None:
    from scipy.ndimage import correlate1d
    from scipy.signal import savgol_filter

    x, inner = signal_of(shape), slice(40, shape[0] - 40)
    ours = smooth_and_derive(x, 81, 4, 0.01, engine=engine)
    for derivative, y in enumerate(ours):
        taps = coefficients(81, 4, derivative, 0.01)
        theirs = correlate1d(x, taps, axis=0)[inner]
        # of the largest summand: a derivative near zero is a difference of large terms
        scale = np.abs(taps).sum() * np.abs(x).max()
        np.testing.assert_allclose(y, theirs, rtol=0, atol=1e-13 * scale)
        whole = savgol_filter(x, 81, 4, derivative, 0.01, axis=0)[inner]
        np.testing.assert_allclose(y, whole, rtol=0, atol=1e-10 * scale)  # scipy's own taps


@pytest.mark.skipif("llvm" not in ENGINES, reason="llvmlite is not installed")
@settings(max_examples=60, deadline=None)
@given(
    half=st.integers(0, 12),
    extra=st.integers(0, 90),
    columns=st.integers(0, 12),
    order=st.integers(0, 4),
)
def test_engines_agree_on_every_shape(half: int, extra: int, columns: int, order: int) -> None:
    window = 2 * half + 1
    order = min(order, window - 1)
    x = signal_of((window + extra, columns), seed=extra)
    pairs = zip(
        smooth_and_derive(x, window, order, 0.1, engine="llvm"),
        smooth_and_derive(x, window, order, 0.1, engine="numpy"),
        strict=True,
    )
    for derivative, (code, reference) in enumerate(pairs):
        assert code.shape == (1 + extra, columns)
        scale = np.abs(coefficients(window, order, derivative, 0.1)).sum() * np.abs(x).max(
            initial=0
        )
        np.testing.assert_allclose(code, reference, rtol=0, atol=1e-13 * scale)


@pytest.mark.skipif("llvm" not in ENGINES, reason="llvmlite is not installed")
@pytest.mark.parametrize("width", [2, 4, 8])
def test_code_is_right_for_every_vector_width(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    # narrower or wider vectors than this processor has are split or joined by LLVM
    monkeypatch.setattr(jit, "vector_width", lambda: width)
    monkeypatch.setattr(filters, "_module", functools.cache(filters._module.__wrapped__))
    for shape in SHAPES:
        x = signal_of(shape)
        code = smooth_and_derive(x, 81, 4, 1.0, engine="llvm")
        for ours, reference in zip(
            code, smooth_and_derive(x, 81, 4, 1.0, engine="numpy"), strict=True
        ):
            np.testing.assert_allclose(ours, reference, rtol=0, atol=1e-13 * np.abs(x).max())


def test_numpy_takes_over_where_llvm_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jit, "available", lambda: False)
    monkeypatch.delattr(filters, "_module")
    x = signal_of((200, 3))
    np.testing.assert_array_equal(smooth(x, 31, 2), smooth(x, 31, 2, engine="numpy"))


@pytest.mark.parametrize("engine", ENGINES)
def test_smooth_is_the_first_of_the_three(engine: Engine) -> None:
    x = signal_of((400, 5))
    np.testing.assert_allclose(
        smooth(x, 31, 2, engine=engine),
        smooth_and_derive(x, 31, 2, 0.01, engine=engine)[0],
        rtol=1e-13,
        atol=1e-13,
    )


@pytest.mark.parametrize("engine", ENGINES)
def test_filter_commutes_with_the_sensor_law(engine: Engine) -> None:
    r, C = signal_of((600, 6)), np.random.default_rng(1).standard_normal((6, 6))
    wrench = r @ C.T + 3.0
    np.testing.assert_allclose(
        smooth(wrench, 101, 2, engine=engine),
        smooth(r, 101, 2, engine=engine) @ C.T + 3.0,
        atol=1e-12 * np.abs(wrench).max(),
    )


@pytest.mark.parametrize("engine", ENGINES)
def test_edges_are_dropped_and_a_hole_spreads_over_its_windows_only(engine: Engine) -> None:
    x = signal_of((200, 2))
    x[100, 0] = np.nan
    y = smooth(x, 21, 2, engine=engine)
    assert y.shape == (180, 2)
    assert np.flatnonzero(np.isnan(y[:, 0])).tolist() == list(range(80, 101))
    assert np.isfinite(y[:, 1]).all()


@pytest.mark.parametrize("engine", ENGINES)
def test_memory_given_is_written_and_returned(engine: Engine) -> None:
    x, out = signal_of((300, 4)), np.full((3, 220, 4), np.nan)
    returned = smooth_and_derive(x, 81, 4, 0.01, engine=engine, out=out)
    assert all(np.shares_memory(a, b) for a, b in zip(returned, out, strict=True))
    np.testing.assert_array_equal(out, smooth_and_derive(x, 81, 4, 0.01, engine=engine))
    with pytest.raises(ValueError, match=r"out must be float64 in C order of shape \(3, 220, 4\)"):
        smooth_and_derive(x, 81, 4, 0.01, engine=engine, out=out[:, :-1])


def test_strided_and_integer_input_is_accepted() -> None:
    x = np.arange(600).reshape(200, 3)[::2, 1:]
    np.testing.assert_allclose(smooth(x, 11, 1), x[5:-5], rtol=1e-13)


@pytest.mark.parametrize(
    ("window", "order", "step", "message"),
    [
        (80, 4, 0.01, r"window of 80 samples; take an odd number, such as 81"),
        (5, 5, 0.01, r"polynomial order 5 in a window of 5 samples; lower the order"),
        (81, 4, 0.0, r"sampling step 0; it must be positive"),
        (301, 4, 0.01, r"300 samples are shorter than the smoothing window of 301; record longer"),
    ],
)
def test_impossible_filters_are_refused(window: int, order: int, step: float, message: str) -> None:
    with pytest.raises(DataError, match=message):
        smooth_and_derive(np.zeros((300, 2)), window, order, step)
