"""The smoothing filter: a polynomial fitted to a sliding window, its value and derivatives.

A. Savitzky, M. J. E. Golay, *Smoothing and Differentiation of Data by Simplified Least Squares
Procedures*, Anal. Chem. 36 (1964). The filter is linear and of zero phase, so filtering channels
and model wrench alike leaves the law `w = C r + o` unchanged and removes the noise that would bias
`C` towards zero. Edges are dropped, `window // 2` samples on each side, and never padded.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.polynomial import legendre

from ftcal import jit
from ftcal.errors import DataError, raise_all

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy import ndarray as Array

Engine = Literal["auto", "llvm", "numpy"]
"""`auto` is machine code where llvmlite is installed, NumPy elsewhere."""

LOOK_AHEAD = 512
"""Numbers between the leading edge of the window and what is fetched into cache for it."""

CHUNK = 1 << 14
"""Numbers a NumPy pass keeps in cache."""


@functools.lru_cache(maxsize=64)
def _coefficients(window: int, order: int, derivative: int) -> Float[Array, "window"]:
    """Return the coefficients for a window that spans [-1, 1] (or one sample).

    Agrees with exact arithmetic to 1e-15; `scipy.signal.savgol_coeffs`, which fits plain powers of
    the sample number, to 3e-11 (window 81, order 4).
    """
    half = window // 2
    t = np.arange(-half, half + 1) / max(half, 1)
    # Legendre polynomials: nearly orthogonal on the window, so the condition stays near one
    basis = legendre.legvander(t, order)
    at_centre = legendre.legval(0.0, legendre.legder(np.eye(order + 1), derivative))
    c = np.linalg.lstsq(basis.T, at_centre, rcond=None)[0]
    # exactly even or odd: the pairs are folded before they are multiplied
    c = (c + (-1) ** derivative * c[::-1]) / 2.0
    c.flags.writeable = False
    return np.asarray(c)


def coefficients(
    window: int, order: int, derivative: int = 0, step: float = 1.0
) -> Float[Array, "window"]:
    """Return `c` with `sum_k c[k] x[i + k]` the derivative at the middle of the window.

    `step` is the sampling period; the result has the unit of `x` over that of `step` to the power
    `derivative`. `DataError`: even window, order not below the window, step not positive.
    """
    faults = []
    if window < 1 or window % 2 == 0:
        faults.append(
            f"window of {window} samples; take an odd number, such as {max(window, 2) | 1}"
        )
    if not 0 <= order < window:
        faults.append(
            f"polynomial order {order} in a window of {window} samples; lower the order below the"
            " window or widen the window"
        )
    if derivative < 0:
        faults.append(f"derivative {derivative}; take 0 or more")
    if not step > 0.0:
        faults.append(f"sampling step {step:g}; it must be positive")
    raise_all(DataError, "smoothing filter", faults)
    return np.asarray(
        _coefficients(window, order, derivative) / (max(window // 2, 1) * step) ** derivative
    )


def smooth(
    values: Float[Array, "N K"], window: int, order: int, *, engine: Engine = "auto"
) -> Float[Array, "M K"]:
    """Return the smoothed samples `window // 2 … N - window // 2`, so `M = N - window + 1`.

    A NaN spreads over every window that holds it. `DataError`: see `coefficients`; fewer samples
    than the window.
    """
    (smoothed,) = _apply(values, (coefficients(window, order),), engine, None)
    return smoothed


def smooth_and_derive(
    values: Float[Array, "N J"],
    window: int,
    order: int,
    step: float,
    *,
    engine: Engine = "auto",
    out: Float[Array, "3 M J"] | None = None,
) -> tuple[Float[Array, "M J"], Float[Array, "M J"], Float[Array, "M J"]]:
    """Return smoothed value, first and second derivative of samples `window // 2 …`, in one pass.

    `M = N - window + 1`; `step` is the sampling period [s], the derivatives are per second.
    `out` (float64, C order) is written and returned where given: fresh memory costs as much time
    as the filter itself.
    `DataError`: see `coefficients`; fewer samples than the window.
    """
    taps = tuple(coefficients(window, order, derivative, step) for derivative in range(3))
    value, first, second = _apply(values, taps, engine, out)
    return value, first, second


def _apply(
    values: Float[Array, "N K"],
    taps: Sequence[Float[Array, "window"]],
    engine: Engine,
    out: Float[Array, "D M K"] | None,
) -> tuple[Float[Array, "M K"], ...]:
    x = np.require(values, np.float64, ["C", "A"])
    window = len(taps[0])
    if len(x) < window:
        raise DataError(
            f"{len(x)} samples are shorter than the smoothing window of {window}; record longer"
            " or narrow the window"
        )
    shape = (len(x) - window + 1, x.shape[1])
    outputs = tuple(np.empty(shape) for _ in taps) if out is None else tuple(out)
    if any(y.shape != shape or y.dtype != float or not y.flags.c_contiguous for y in outputs):
        raise ValueError(f"out must be float64 in C order of shape {(len(taps), *shape)}")
    machine_code = engine == "llvm" or (engine == "auto" and jit.available())
    if not machine_code or window == 1 or not outputs[0].size:  # pairs are what the code loops over
        _fold_numpy(x, taps, outputs)
    else:
        _kernel(len(taps))(
            x.ctypes.data,
            *(c.ctypes.data for c in taps),
            *(out.ctypes.data for out in outputs),
            outputs[0].size,
            x.shape[1],
            window // 2,
            # from the second block on vectors are aligned to their size: one cache line each
            x.ctypes.data // 8 % jit.vector_width(),
        )
    return outputs


def _fold_numpy(
    x: Float[Array, "N K"],
    taps: Sequence[Float[Array, "window"]],
    outputs: Sequence[Float[Array, "M K"]],
) -> None:
    """Write the derivatives 0, 1, … with the given taps; the meaning of the machine code."""
    window, half = len(taps[0]), len(taps[0]) // 2
    rows = max(1, CHUNK // max(x.shape[1], 1))
    for start in range(0, len(x) - window + 1, rows):
        n = min(rows, len(x) - window + 1 - start)
        centre = x[start + half : start + half + n]
        for derivative, (c, out) in enumerate(zip(taps, outputs, strict=True)):
            out[start : start + n] = 0.0 if derivative % 2 else c[half] * centre
        for k in range(half):
            left = x[start + k : start + k + n]
            right = x[start + window - 1 - k : start + window - 1 - k + n]
            pair = (left + right, left - right)
            for derivative, (c, out) in enumerate(zip(taps, outputs, strict=True)):
                out[start : start + n] += c[k] * pair[derivative % 2]


@functools.cache
def _module(outputs: int) -> jit.Module:
    """Return the machine code for derivatives 0 … outputs - 1, compiled once in a process."""
    width = jit.vector_width()
    # accumulators fill the registers (32 of AVX-512, 16 before), a few are left for the pairs
    return jit.compile_ir(_ir(outputs, width, min(8, (18 if width == 8 else 9) // outputs)))


def _kernel(outputs: int) -> Callable[..., None]:
    pointers: list[Any] = [ctypes.c_void_p] * (1 + 2 * outputs)
    code: Callable[..., None] = _module(outputs).function(
        "filter", *pointers, *[ctypes.c_int64] * 4
    )
    return code


def _ir(outputs: int, width: int, block: int) -> str:
    """Return LLVM IR of `filter(x, taps…, outs…, size, columns, half)`.

    Row after row lies in memory, so output number p is `sum_k c[k] x[p + k columns]` whatever the
    number of columns: the code runs over p, `block` vectors of `width` at a time. The last block
    ends at the last output and may overlap the one before; fewer outputs than a block go one by
    one.
    """
    arguments = ["ptr noalias %x"]
    arguments += [f"ptr noalias %c{d}" for d in range(outputs)]
    arguments += [f"ptr noalias %y{d}" for d in range(outputs)]
    return f"""
declare void @llvm.prefetch.p0(ptr, i32, i32, i32)
define void @filter({", ".join(arguments)}, i64 %size, i64 %columns, i64 %half, i64 %shift) {{
entry:
  %window.less = shl i64 %half, 1
  %span = mul i64 %window.less, %columns
  %middle = mul i64 %half, %columns
  %last = sub i64 %size, {width * block}
  %final = sub i64 %size, 1
  %wide = icmp sge i64 %last, 0
  br i1 %wide, label %v.loop, label %s.loop
{_loop("v", outputs, width, block, "%last")}
{_loop("s", outputs, 1, 1, "%final")}
done:
  ret void
}}
"""


def _load(name: str, width: int, pointer: str, index: str) -> str:
    return f"""
  %{name}.p = getelementptr double, ptr {pointer}, i64 {index}
  %{name} = load {_kind(width)}, ptr %{name}.p, align 8"""


def _broadcast(name: str, width: int, pointer: str, index: str) -> str:
    kind = f"<{width} x double>"
    return f"""{_load(f"{name}.s", 1, pointer, index)}
  %{name}.i = insertelement {kind} poison, double %{name}.s, i64 0
  %{name} = shufflevector {kind} %{name}.i, {kind} poison, <{width} x i32> zeroinitializer"""


def _kind(width: int) -> str:
    return "double" if width == 1 else f"<{width} x double>"


def _loop(t: str, outputs: int, width: int, block: int, last: str) -> str:
    """Return the loop named `t` over outputs in steps of `width * block` up to the start `last`.

    Even derivatives start from the middle tap and add the sums of pairs, odd ones add differences.
    """
    kind = _kind(width)
    fma = "llvm.fmuladd." + ("f64" if width == 1 else f"v{width}f64")
    broadcast = _load if width == 1 else _broadcast
    zero = "0.0" if width == 1 else "zeroinitializer"
    lanes = [(d, b) for d in range(outputs) for b in range(block)]

    middle, folded = [], []
    for b in range(block):
        middle.append(f"\n  %{t}.mid{b} = add i64 %{t}.mid, {b * width}")
        middle.append(_load(f"{t}.x{b}", width, "%x", f"%{t}.mid{b}"))
        for side in "lr":
            folded.append(f"\n  %{t}.{side}i{b} = add i64 %{t}.{side}, {b * width}")
            folded.append(_load(f"{t}.{side}x{b}", width, "%x", f"%{t}.{side}i{b}"))
        folded.append(f"\n  %{t}.pair0.{b} = fadd {kind} %{t}.lx{b}, %{t}.rx{b}")
        folded.append(f"\n  %{t}.pair1.{b} = fsub {kind} %{t}.lx{b}, %{t}.rx{b}")
    for d, b in lanes:
        if d % 2 == 0:
            middle.append(f"\n  %{t}.first{d}.{b} = fmul {kind} %{t}.m{d}, %{t}.x{b}")
        folded.append(
            f"\n  %{t}.n{d}.{b} = call {kind} @{fma}"
            f"({kind} %{t}.c{d}, {kind} %{t}.pair{d % 2}.{b}, {kind} %{t}.a{d}.{b})"
        )
    accumulators = "".join(
        f"\n  %{t}.a{d}.{b} = phi {kind} [ {zero if d % 2 else f'%{t}.first{d}.{b}'}, %{t}.loop ],"
        f" [ %{t}.n{d}.{b}, %{t}.taps ]"
        for d, b in lanes
    )
    stores = "".join(
        f"""
  %{t}.q{d}.{b} = add i64 %{t}.at, {b * width}
  %{t}.w{d}.{b} = getelementptr double, ptr %y{d}, i64 %{t}.q{d}.{b}
  store {kind} %{t}.n{d}.{b}, ptr %{t}.w{d}.{b}, align 8"""
        for d, b in lanes
    )
    middle_taps = "".join(
        broadcast(f"{t}.m{d}", width, f"%c{d}", "%half") for d in range(0, outputs, 2)
    )
    # the window's leading edge is the only part not in cache, too many strides for the processor
    # to foresee
    ahead = "".join(
        f"""
  %{t}.f{line}.i = add i64 %{t}.end, {LOOK_AHEAD + 8 * line}
  %{t}.f{line} = getelementptr double, ptr %x, i64 %{t}.f{line}.i
  call void @llvm.prefetch.p0(ptr %{t}.f{line}, i32 0, i32 3, i32 1)"""
        for line in range(width * block // 8)
    )
    taps = "".join(broadcast(f"{t}.c{d}", width, f"%c{d}", f"%{t}.k") for d in range(outputs))
    return f"""
{t}.loop:
  %{t}.at = phi i64 [ 0, %entry ], [ %{t}.next, %{t}.store ]
  %{t}.mid = add i64 %{t}.at, %middle
  %{t}.end = add i64 %{t}.at, %span{middle_taps}{"".join(middle)}{ahead}
  br label %{t}.taps
{t}.taps:
  %{t}.k = phi i64 [ 0, %{t}.loop ], [ %{t}.k1, %{t}.taps ]
  %{t}.l = phi i64 [ %{t}.at, %{t}.loop ], [ %{t}.l1, %{t}.taps ]
  %{t}.r = phi i64 [ %{t}.end, %{t}.loop ], [ %{t}.r1, %{t}.taps ]{accumulators}{taps}
{"".join(folded)}
  %{t}.k1 = add i64 %{t}.k, 1
  %{t}.l1 = add i64 %{t}.l, %columns
  %{t}.r1 = sub i64 %{t}.r, %columns
  %{t}.more = icmp slt i64 %{t}.k1, %half
  br i1 %{t}.more, label %{t}.taps, label %{t}.store
{t}.store:{stores}
  %{t}.start = icmp eq i64 %{t}.at, 0
  %{t}.back = select i1 %{t}.start, i64 {"%shift" if width > 1 else "0"}, i64 0
  %{t}.step = sub i64 {width * block}, %{t}.back
  %{t}.ahead = add i64 %{t}.at, %{t}.step
  %{t}.fits = icmp sle i64 %{t}.ahead, {last}
  %{t}.next = select i1 %{t}.fits, i64 %{t}.ahead, i64 {last}
  %{t}.left = icmp slt i64 %{t}.at, {last}
  br i1 %{t}.left, label %{t}.loop, label %done
"""
