"""Sine, cosine, angle, exponential and logarithm, equal to the bit in any width and with the JIT off.

The libms of two platforms differ in the last bit and have no lanes.  These functions use only + - * /, comparisons,
`select` and `power_of_two`, and no fused multiply-add.  Each reduces its argument in extended precision (Cody and
Waite, Software Manual for the Elementary Functions, 1980) and evaluates a minimax polynomial (Remez exchange on the
relative error) in Estrin's order, which shortens the chain of dependent operations.

NaN gives NaN.  Angles are in rad.
"""

from __future__ import annotations

from math import nan

from numba.extending import register_jitable

from .by_type import overridable
from .jit import INNER, kernel
from .lanes import any_lane, exponent, power_of_two, select, sqrt

# Adding and subtracting 1.5 * 2**52 rounds to an integer, 1.5 * 2**54 to a multiple of four.
_ROUND = 1.5 * 2.0**52
_ROUND_4 = 1.5 * 2.0**54

# pi/2 in three parts; the first two have at most 36 bits, so that their products with n up to 2**17 are exact.
_TWO_OVER_PI = 0.6366197723675814
_HALF_PI_A = float.fromhex("0x1.921fb5444p+0")
_HALF_PI_B = float.fromhex("0x1.68c234c4cp-39")
_HALF_PI_C = float.fromhex("0x1.98a2e03707345p-77")
_QUARTER_PI = 0.7853981633974483
PI = 3.141592653589793
NEAR = 2.0**17 * _HALF_PI_A
# The same in five parts for angles beyond: four of 23 bits, whose products with n up to 2**30 are exact.
_FAR_A = float.fromhex("0x1.921fb4p+0")
_FAR_B = float.fromhex("0x1.4442dp-24")
_FAR_C = float.fromhex("0x1.846988p-48")
_FAR_D = float.fromhex("0x1.8cc514p-72")
_FAR_E = float.fromhex("0x1.80dc1cd129025p-95")
SINCOS_LIMIT = 2.0**30 * _HALF_PI_A

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
_SQRT_2 = 1.4142135623730951
_SQRT_HALF = 0.7071067811865476
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


@register_jitable(**INNER)
def _minus(r, low, part):
    """Return r + low - part as a rounded sum and the rest that rounding loses (D. Knuth's two-sum)."""
    s = r - part
    b = s - r
    return s, low + ((r - (s - b)) - (part + b))


@register_jitable(**INNER)
def _reduce_far(x):
    """Return n, r and c of x = n pi/2 + r - c for NEAR < |x| <= SINCOS_LIMIT; not inlined, as it is rarely needed."""
    n = (x * _TWO_OVER_PI + _ROUND) - _ROUND
    t, low = _minus(x, 0.0 * x, n * _FAR_A)
    t, low = _minus(t, low, n * _FAR_B)
    t, low = _minus(t, low, n * _FAR_C)
    t, low = _minus(t, low, n * _FAR_D)
    low = low - n * _FAR_E
    r, rest = _minus(t, 0.0 * x, -low)
    return n, r, -rest


@overridable
def sincos(x):
    """Return sine and cosine of x [rad], |x| <= SINCOS_LIMIT (1.69e9 rad), else NaN; error below 1 ulp."""
    return _sincos(x)


@kernel
def _sincos(x):
    x = select(abs(x) <= SINCOS_LIMIT, x, nan)
    n = (x * _TWO_OVER_PI + _ROUND) - _ROUND
    # x = n pi/2 + r - c: the subtraction of the first part is exact, c carries the rounding of the second.
    t = x - n * _HALF_PI_A
    w = n * _HALF_PI_B
    r = t - w
    c = n * _HALF_PI_C - ((t - r) - w)
    far = abs(x) > NEAR
    if any_lane(far):
        m, s, z = _reduce_far(x)
        n, r, c = select(far, m, n), select(far, s, r), select(far, z, c)
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


@overridable
def angle(y, x):
    """Return the angle of the direction (x, y) to that of x [rad], from -pi to pi, 0 of no direction; error 2 ulp of 1.

    In the first two octants the guess a0 = pi/4 + d is at most 0.004 off, and sin(a - a0) = (y cos a0 - x sin a0) / r.
    """
    return _angle(y, x)


@kernel
def _angle(y, x):
    s, c = abs(y), abs(x)
    r = sqrt(s * s + c * c)
    none = r == 0.0
    r = select(none, 1.0 + 0.0 * r, r)
    s, c = s / r, select(none, 1.0 + 0.0 * r, c / r)
    u = (s - c) / (s + c)
    d = u * (_QUARTER_PI + 0.273 * (1.0 - abs(u)))
    z = d * d
    z2 = z * z
    sine = d + (d * z) * ((_S0 + z * _S1) + z2 * ((_S2 + z * _S3) + z2 * (_S4 + z * _S5)))
    cosine = (1.0 - 0.5 * z) + z2 * ((_C0 + z * _C1) + z2 * ((_C2 + z * _C3) + z2 * (_C4 + z * _C5)))
    e = _SQRT_HALF * ((s - c) * cosine - (s + c) * sine)
    small = s < 1e-2
    e = select(small, s, e)
    z = e * e
    a = select(small, 0.0 * s, _QUARTER_PI + d) + e * (1.0 + z * (1.0 / 6.0 + z * (3.0 / 40.0 + z * (15.0 / 336.0))))
    a = select(x < 0.0, PI - a, a)
    return select(y < 0.0, -a, a)


@overridable
def exp(x):
    """Return the exponential of x: inf above 709.78, gradual underflow to 0 below -708.4; error below 1 ulp."""
    return _exp(x)


@kernel
def _exp(x):
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


@overridable
def log(x):
    """Return the natural logarithm of a normal number x > 0; error below 1.5 ulp."""
    return _log(x)


@kernel
def _log(x):
    n = exponent(x)
    m = x * power_of_two(-n)
    large = m > _SQRT_2
    m, n = select(large, 0.5 * m, m), select(large, n + 1.0, n)
    # log m = 2 artanh s = 2 s + s z L(z) with z = s^2, whose series has fallen below 2**-56 after ten terms.
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    z2 = z * z
    z4 = z2 * z2
    low = (2.0 / 3.0 + z * (2.0 / 5.0)) + z2 * (2.0 / 7.0 + z * (2.0 / 9.0))
    high = (2.0 / 11.0 + z * (2.0 / 13.0)) + z2 * (2.0 / 15.0 + z * (2.0 / 17.0))
    L = low + z4 * (high + z4 * (2.0 / 19.0 + z * (2.0 / 21.0)))
    # 2 s = f - s f, and f needs no rounding.
    return n * _LN2_A + (f - (s * (f - z * L) - n * _LN2_B))
