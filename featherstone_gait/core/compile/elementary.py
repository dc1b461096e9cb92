"""Sine, cosine, exponential, hyperbolic tangent and arc tangent, equal to the bit in any width and with the JIT off.

A platform's libm differs from the next one in the last bit and knows no lanes; these need only + - * /, comparisons,
`select` and `power_of_two`, and no fused multiply-add.  Each reduces its argument in extended precision (Cody and
Waite, Software Manual for the Elementary Functions, 1980) and evaluates a minimax polynomial (Remez exchange on the
relative error) in Estrin's order, which shortens the chain of dependent operations.

NaN gives NaN.  Angles are in rad.
"""

from __future__ import annotations

from math import inf, nan

from .jit import kernel
from .lanes import power_of_two, select

# Adding and subtracting 1.5 * 2**52 rounds to an integer, 1.5 * 2**54 to a multiple of four.
_ROUND = 1.5 * 2.0**52
_ROUND_4 = 1.5 * 2.0**54

# pi/2 in three parts; the first two have at most 36 bits, so that their products with n up to 2**17 are exact.
_TWO_OVER_PI = 0.6366197723675814
_HALF_PI_A = float.fromhex("0x1.921fb5444p+0")
_HALF_PI_B = float.fromhex("0x1.68c234c4cp-39")
_HALF_PI_C = float.fromhex("0x1.98a2e03707345p-77")
SINCOS_LIMIT = 2.0**17 * _HALF_PI_A

# Minimax on |r| <= pi/4: sin(r) = r + r**3 S(r**2), relative error 2**-57.9,
# and cos(r) = 1 - r**2/2 + r**4 C(r**2), relative error 2**-63.9.
_S0 = float.fromhex("-0x1.5555555555548p-3")
_S1 = float.fromhex("0x1.111111110f7d0p-7")
_S2 = float.fromhex("-0x1.a01a019bfdf06p-13")
_S3 = float.fromhex("0x1.71de3567d38f2p-19")
_S4 = float.fromhex("-0x1.ae5e5a91273b2p-26")
_S5 = float.fromhex("0x1.5d8fd17057b77p-33")
_C0 = float.fromhex("0x1.555555555554bp-5")
_C1 = float.fromhex("-0x1.6c16c16c14f92p-10")
_C2 = float.fromhex("0x1.a01a019c84599p-16")
_C3 = float.fromhex("-0x1.27e4f7eacb1d7p-22")
_C4 = float.fromhex("0x1.1ee9d7b88abbep-29")
_C5 = float.fromhex("-0x1.8fa49b972b632p-37")

# ln 2 in two parts; the first has 42 bits, so that its products with n up to 2**11 are exact.
_LOG2_E = 1.4426950408889634
_LN2_A = float.fromhex("0x1.62e42fefa38p-1")
_LN2_B = float.fromhex("0x1.ef35793c76730p-45")
# exp of less is 0, of more is inf.
_EXP_LOW = -746.0
_EXP_HIGH = 710.0

# Minimax on |r| <= ln(2)/2: exp(r) = 1 + r + r**2 E(r), relative error 2**-57.9.
_E0 = float.fromhex("0x1.000000000000ap-1")
_E1 = float.fromhex("0x1.55555555554fap-3")
_E2 = float.fromhex("0x1.555555555088cp-5")
_E3 = float.fromhex("0x1.1111111127b76p-7")
_E4 = float.fromhex("0x1.6c16c1842663ep-10")
_E5 = float.fromhex("0x1.a01a012a73b20p-13")
_E6 = float.fromhex("0x1.a0199a16eb232p-16")
_E7 = float.fromhex("0x1.71df2527d2e91p-19")
_E8 = float.fromhex("0x1.28ad68a69ef83p-22")
_E9 = float.fromhex("0x1.ad7f938c2b1b5p-26")

# Minimax on |x| <= 0.7: tanh(x) = x + x**3 P(x**2) / Q(x**2), relative error 2**-58.3.
_TANH_SMALL = 0.7
_P0 = float.fromhex("-0x1.555555555554fp-2")
_P1 = float.fromhex("-0x1.4fc0c45475df7p-6")
_P2 = float.fromhex("-0x1.a124d4d22e0e5p-13")
_Q1 = float.fromhex("0x1.d88dbe696f7f9p-2")
_Q2 = float.fromhex("0x1.7d79087670e98p-6")
_Q3 = float.fromhex("0x1.b087ace6b5a6dp-13")

# Minimax on |q| <= 1/2: atan(q) = q + q**3 A(q**2), relative error 2**-57.8.
_A0 = float.fromhex("-0x1.5555555555516p-2")
_A1 = float.fromhex("0x1.999999999114ep-3")
_A2 = float.fromhex("-0x1.249249215e189p-3")
_A3 = float.fromhex("0x1.c71c7090f7c9cp-4")
_A4 = float.fromhex("-0x1.745cf4cc7571ap-4")
_A5 = float.fromhex("0x1.3b113dd1ff86ap-4")
_A6 = float.fromhex("-0x1.10f31fb2d260fp-4")
_A7 = float.fromhex("0x1.dfe97ec129861p-5")
_A8 = float.fromhex("-0x1.a398809ebb8efp-5")
_A9 = float.fromhex("0x1.56f6064f331c2p-5")
_A10 = float.fromhex("-0x1.c18083796221ap-6")
_A11 = float.fromhex("0x1.4b84e33f582a7p-7")

# pi/4, pi/2, 3 pi/4 and pi: the nearest float64 and what it lacks.
_ANGLE_45 = float.fromhex("0x1.921fb54442d18p-1")
_ANGLE_90 = float.fromhex("0x1.921fb54442d18p+0")
_ANGLE_135 = float.fromhex("0x1.2d97c7f3321d2p+1")
_ANGLE_180 = float.fromhex("0x1.921fb54442d18p+1")
_REST_45 = float.fromhex("0x1.1a62633145c07p-55")
_REST_90 = float.fromhex("0x1.1a62633145c07p-54")
_REST_135 = float.fromhex("0x1.a79394c9e8a0ap-54")
_REST_180 = float.fromhex("0x1.1a62633145c07p-53")


@kernel
def sincos(x):
    """Sine and cosine of x [rad], |x| <= SINCOS_LIMIT (205887 rad), else NaN; error below 1 ulp."""
    x = select(abs(x) <= SINCOS_LIMIT, x, nan)
    n = (x * _TWO_OVER_PI + _ROUND) - _ROUND
    # x = n pi/2 + r - c: the subtraction of the first part is exact, c carries the rounding of the second.
    t = x - n * _HALF_PI_A
    w = n * _HALF_PI_B
    r = t - w
    c = n * _HALF_PI_C - ((t - r) - w)
    z = r * r
    z2 = z * z
    s = (_S0 + z * _S1) + z2 * ((_S2 + z * _S3) + z2 * (_S4 + z * _S5))
    s = r - (c - (r * z) * s)
    o = (_C0 + z * _C1) + z2 * ((_C2 + z * _C3) + z2 * (_C4 + z * _C5))
    h = 0.5 * z
    u = 1.0 - h
    o = u + (((1.0 - u) - h) + (z2 * o + r * c))
    # n modulo 4 is 0, 1, 2, 3 for g = -1/2, 1/2, 3/2, -3/2.
    a = n - 0.5
    g = a - ((a + _ROUND_4) - _ROUND_4)
    odd = abs(g + 0.5) == 1.0
    sine = select(odd, o, s)
    cosine = select(odd, s, o)
    return select(abs(g) > 1.0, -sine, sine), select(g > 0.0, -cosine, cosine)


@kernel
def exp(x):
    """Exponential of x; inf above 709.78, gradual underflow to 0 below -708.4; error below 1 ulp."""
    y = select(x > _EXP_LOW, x, _EXP_LOW)
    y = select(y < _EXP_HIGH, y, _EXP_HIGH)
    n = (y * _LOG2_E + _ROUND) - _ROUND
    # y = n ln 2 + r - c
    t = y - n * _LN2_A
    w = n * _LN2_B
    r = t - w
    c = w - (t - r)
    r2 = r * r
    r4 = r2 * r2
    low = (_E0 + r * _E1) + r2 * (_E2 + r * _E3)
    high = ((_E4 + r * _E5) + r2 * (_E6 + r * _E7)) + r4 * (_E8 + r * _E9)
    e = 1.0 + (r + (r2 * (low + r4 * high) - c))
    # Two factors: 2**n alone leaves the range before exp(x) does.
    half = (0.5 * n + _ROUND) - _ROUND
    e = (e * power_of_two(half)) * power_of_two(n - half)
    return select(x == x, e, x)


@kernel
def tanh(x):
    """Hyperbolic tangent of x, odd to the sign of zero; error below 1.25 ulp."""
    a = abs(x)
    z = a * a
    small = a <= _TANH_SMALL
    p = (a * z) * ((_P0 + z * _P1) + (z * z) * _P2)
    q = (1.0 + z * _Q1) + (z * z) * (_Q2 + z * _Q3)
    # One division for x + x**3 P/Q and for 1 - 2 / (exp(2 x) + 1).
    t = select(small, a, 1.0) + select(small, p, -2.0) / select(small, q, exp(2.0 * a) + 1.0)
    return select(x > 0.0, t, select(x < 0.0, -t, x))


@kernel
def _negative(x):
    """Whether the sign of x is minus, also of a zero."""
    return (x < 0.0) | (1.0 / x < 0.0)


@kernel
def _atan_half(q, whole, rest):
    """whole + rest + atan(q) for |q| <= 1/2."""
    z = q * q
    z2 = z * z
    z4 = z2 * z2
    low = (_A0 + z * _A1) + z2 * (_A2 + z * _A3)
    middle = (_A4 + z * _A5) + z2 * (_A6 + z * _A7)
    high = (_A8 + z * _A9) + z2 * (_A10 + z * _A11)
    return whole + (q + (rest + (q * z) * (low + z4 * (middle + z4 * high))))


@kernel
def atan2(y, x):
    """Angle of the vector (x, y) [rad] in -pi ... pi, zeros and infinities as in C99; error below 2 ulp."""
    left = _negative(x)
    # The sum of the two must not overflow.
    scale = select(abs(x) + abs(y) < inf, 1.0, 0.25)
    u = abs(x) * scale
    v = abs(y) * scale
    # Angle from the nearest multiple of pi/4 (0, 1/4, 1/2, 3/4, 1 of pi): one division, |q| <= 1/2.
    flat = (v + v < u) | (v == 0.0)
    steep = u + u < v
    across = select(u == v, 0.0, v - u)
    up = select(flat, v, select(steep, -u, across))
    along = select(flat, u, select(steep, v, u + v))
    q = up / select(along == 0.0, 1.0, along)
    q = select(left, -q, q)
    whole = select(flat, select(left, _ANGLE_180, 0.0), select(steep, _ANGLE_90, select(left, _ANGLE_135, _ANGLE_45)))
    rest = select(flat, select(left, _REST_180, 0.0), select(steep, _REST_90, select(left, _REST_135, _REST_45)))
    angle = _atan_half(q, whole, rest)
    return select(_negative(y), -angle, angle)
