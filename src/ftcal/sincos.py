"""Sine and cosine of a whole vector register, without branches, as LLVM IR.

The angle is reduced by the nearest multiple k of pi/2, which is carried in three parts (W. Cody and
W. Waite, *Software Manual for the Elementary Functions*, 1980), with fused multiply-adds: the first
difference is exact for |k| < 2^20. Two even polynomials follow; the last two bits of k say which is
the sine and what the signs are. Error below 1.5 units in the last place for |angle| < 1e5 rad; the
angle must stay below 1e9.
"""

from __future__ import annotations

import struct

HALF_PI = (1.5707963267948966, 6.123233995736766e-17, -1.4973849048591698e-33)
"""pi/2 in three parts."""
TWO_OVER_PI = 0.6366197723675814
SHIFTER = 6755399441055744.0
"""1.5 * 2^52: adding it rounds to an integer, whose low bits are then those of the sum."""
SINE = (
    -0.16666666666666666,
    0.008333333333330936,
    -0.00019841269836740532,
    2.7557316093198404e-06,
    -2.5051129896450185e-08,
    1.5917988979397435e-10,
)
"""`(sin r - r) / r^3` in powers of r^2, interpolated at Chebyshev nodes for |r| < pi/4."""
COSINE = (
    0.041666666666666664,
    -0.0013888888888887389,
    2.48015872987544e-05,
    -2.755731726587808e-07,
    2.087614504941318e-09,
    -1.138254464534925e-11,
)
"""`(cos r - 1 + r^2/2) / r^4`, likewise."""


def splat(number: float, width: int) -> str:
    """Return the vector constant of `width` equal float64."""
    (bits,) = struct.unpack("<Q", struct.pack("<d", number))
    return f"<{', '.join([f'double 0x{bits:016X}'] * width)}>"


def sin_cos_ir(width: int) -> str:
    """Return IR of `@sin_cos`: `width` angles [rad] to the pair (sines, cosines)."""
    vector, integers = f"<{width} x double>", f"<{width} x i64>"
    lines: list[str] = []

    def whole(number: int) -> str:
        return f"<{', '.join([f'i64 {number}'] * width)}>"

    def fused(name: str, a: str, b: str, c: str) -> str:
        call = f"call {vector} @llvm.fma.v{width}f64({vector} {a}, {vector} {b}, {vector} {c})"
        lines.append(f"  %{name} = {call}")
        return f"%{name}"

    def polynomial(name: str, coefficients: tuple[float, ...]) -> str:
        value = splat(coefficients[-1], width)
        for power, c in reversed(list(enumerate(coefficients[:-1]))):
            value = fused(f"{name}{power}", value, "%z", splat(c, width))
        return value

    shifted = fused("shifted", "%q", splat(TWO_OVER_PI, width), splat(SHIFTER, width))
    lines.append(f"  %k = fsub {vector} {shifted}, {splat(SHIFTER, width)}")
    rest = "%q"
    for part, value in enumerate(HALF_PI):
        rest = fused(f"rest{part}", "%k", splat(-value, width), rest)
    lines.append(f"  %z = fmul {vector} {rest}, {rest}")
    lines.append(f"  %cube = fmul {vector} {rest}, %z")
    sine = fused("sine", "%cube", polynomial("s", SINE), rest)
    inner = fused("inner", polynomial("c", COSINE), "%z", splat(-0.5, width))
    cosine = fused("cosine", inner, "%z", splat(1.0, width))
    lines.append(f"""\
  %bits = bitcast {vector} {shifted} to {integers}
  %odd = and {integers} %bits, {whole(1)}
  %swap = icmp ne {integers} %odd, zeroinitializer
  %sin_size = select <{width} x i1> %swap, {vector} {cosine}, {vector} {sine}
  %cos_size = select <{width} x i1> %swap, {vector} {sine}, {vector} {cosine}
  %bits_on = add {integers} %bits, {whole(1)}
  %sin_half = and {integers} %bits, {whole(2)}
  %cos_half = and {integers} %bits_on, {whole(2)}
  %sin_sign = shl {integers} %sin_half, {whole(62)}
  %cos_sign = shl {integers} %cos_half, {whole(62)}
  %sin_bits = bitcast {vector} %sin_size to {integers}
  %cos_bits = bitcast {vector} %cos_size to {integers}
  %sin_signed = xor {integers} %sin_bits, %sin_sign
  %cos_signed = xor {integers} %cos_bits, %cos_sign
  %sin = bitcast {integers} %sin_signed to {vector}
  %cos = bitcast {integers} %cos_signed to {vector}
  %pair = insertvalue {{{vector}, {vector}}} undef, {vector} %sin, 0
  %both = insertvalue {{{vector}, {vector}}} %pair, {vector} %cos, 1
  ret {{{vector}, {vector}}} %both""")
    body = "\n".join(lines)
    return f"""
declare {vector} @llvm.fma.v{width}f64({vector}, {vector}, {vector})
define internal {{{vector}, {vector}}} @sin_cos({vector} %q) alwaysinline nounwind {{
{body}
}}
"""
