"""The part of a shape below a plane: its volume and first moment, for the buoyancy of what floats.

In the frame of a shape the depth below the plane is d(x) = d0 + g.x, |g| = 1.  With d+ = max(d, 0) the divergence of
d+ g is 1 below the plane and 0 above, and nothing of it passes the plane itself.  Hence of a polyhedron

    V = sum over triangles (A.g) <d+>,    int x dV = sum over triangles (A.g) (<x d+> - g <d+^2> / 2),

A the triangle's area vector out of the solid and <> means over it: exact, of a triangle that the plane cuts by the part
about the vertex that lies alone on its side.  A sphere is cut to a cap.  Slices of a cylinder are segments of a circle:
with c / (a R) = sin t, c the depth on the axis and a the part of g across it,

    area R^2 (pi/2 + t + sin t cos t),    first moment along g 2/3 R^3 cos^3 t,

entire functions of t, so that Gauss's rule of twelve points in t is exact to rounding; slices of a capsule's ends are
summed by the same rule, with nodes that make the ends of the cut smooth.  Volume and moment have continuous slopes.
"""

import math

import numpy as np

from ..compile.elementary import angle, sincos
from ..compile.jit import inline, kernel
from ..compile.lanes import clamp, select, sqrt
from ..tree.spatial import add, choose, dot, scale, sub

SPHERE, CYLINDER, CAPSULE, POLYHEDRON = range(4)
_X, _W = np.polynomial.legendre.leggauss(12)
NODES = tuple(zip((0.5 * (1.0 + _X)).tolist(), (0.5 * _W).tolist()))  # of the interval 0 ... 1
# The same after x = sin(pi u / 2), which takes roots from the ends of -1 ... 1.
SINES = tuple((math.sin(0.5 * math.pi * x), 0.5 * math.pi * w * math.cos(0.5 * math.pi * x)) for x, w in zip(_X, _W))
TINY = 1e-12


@inline
def immersed(s, triangles, d0, g):
    """Return volume [m^3] and first moment (3) about the origin [m^4] of what of the shape s is below.

    d0: depth of the shape's origin [m]; g (3): how the depth grows in the shape's frame; triangles (n, 9) of all
    polyhedra.
    """
    if s.kind == POLYHEDRON:
        return _polyhedron(triangles, s.first, s.end, d0, g)
    if s.kind == SPHERE:
        return _sphere(s.radius, d0, g)
    return _round(s, d0, g)


@kernel
def _polyhedron(triangles, first, end, d0, g):
    V, M = 0.0 * d0, (0.0 * d0, 0.0 * d0, 0.0 * d0)
    for k in range(first, end):
        t = triangles[k]
        x, y, z = (t[0], t[1], t[2]), (t[3], t[4], t[5]), (t[6], t[7], t[8])
        p, q = sub(y, x), sub(z, x)
        along = 0.5 * (
            (p[1] * q[2] - p[2] * q[1]) * g[0] + (p[2] * q[0] - p[0] * q[2]) * g[1] + (p[0] * q[1] - p[1] * q[0]) * g[2]
        )
        d, xd, dd = _means(x, y, z, d0 + dot(g, x), d0 + dot(g, y), d0 + dot(g, z))
        V = V + along * d
        M = add(M, scale(sub(xd, scale(g, 0.5 * dd)), along))
    return V, M


@inline
def _means(x, y, z, a, b, c):
    """Return the means of d+, x d+ and d+^2 over a triangle of corners x, y, z and depths a, b, c."""
    zero = 0.0 * a
    i, j, k = (select(a > 0.0, 1.0 + zero, zero), select(b > 0.0, 1.0 + zero, zero), select(c > 0.0, 1.0 + zero, zero))
    count, differ = i + j + k, abs(i - j) > 0.5
    first, second = differ & (abs(j - k) < 0.5), differ & (abs(i - k) < 0.5)
    # The corner that is alone on its side comes first: p of depth e, then the other two.
    p, e = choose(first, x, choose(second, y, z)), select(first, a, select(second, b, c))
    q, f = choose(first, y, choose(second, z, x)), select(first, b, select(second, c, a))
    r, h = choose(first, z, choose(second, x, y)), select(first, c, select(second, a, b))
    cut = (count > 0.5) & (count < 2.5)
    t = select(cut, e / select(cut, e - f, 1.0 + zero), zero)
    s = select(cut, e / select(cut, e - h, 1.0 + zero), zero)
    share = t * s * select(count > 1.5, -1.0 + zero, 1.0 + zero)
    whole = select(count > 1.5, 1.0 + zero, zero)
    total, corners = a + b + c, add(add(x, y), z)
    mean = whole * (total / 3.0) + share * (e / 3.0)
    squares = whole * ((total * total + a * a + b * b + c * c) / 12.0) + share * (e * e / 6.0)
    ends = add(scale(p, 4.0), add(scale(sub(q, p), t), scale(sub(r, p), s)))  # 2 p and both points of the cut
    each = add(add(scale(x, a), scale(y, b)), scale(z, c))
    moment = add(scale(add(scale(corners, total), each), whole / 12.0), scale(ends, share * e / 12.0))
    return mean, moment, squares


@inline
def _sphere(r, d0, g):
    h = clamp(r + d0, 0.0, 2.0 * r)
    V = math.pi * h * h * (r - h / 3.0)
    return V, scale(g, 0.25 * math.pi * (h * (2.0 * r - h)) * (h * (2.0 * r - h)))


@kernel
def _round(s, d0, g):
    """Sum the slices of a cylinder or capsule along z."""
    a, half = sqrt(g[0] * g[0] + g[1] * g[1]), 0.5 * s.length
    V, along, across = _slices(s.radius, half, d0, g[2], a)
    if s.kind == CAPSULE:
        for side in (-1.0, 1.0):
            v, t, m = _cap(s.radius, d0 + side * half * g[2], side * g[2], a)
            V, along, across = V + v, along + side * (half * v + t), across + m
    k = across / select(a > TINY, a, 1.0 + 0.0 * a)
    return V, (g[0] * k, g[1] * k, along)


@inline
def _slices(r, half, d0, b, a):
    """Return volume, and first moments along the axis and across it along g, of the cylinder's part below."""
    mirrored = b < 0.0
    b = abs(b)
    slope, reach = select(b > TINY, b, TINY + 0.0 * b), select(a > TINY, a * r, TINY * r + 0.0 * a)
    begin = clamp((-reach - d0) / slope, -half, half)  # of the cut; dry before
    end = clamp((reach - d0) / slope, -half, half)  # all is wet after
    low = _arcsine(clamp((d0 + b * begin) / reach, -1.0, 1.0))
    turn = _arcsine(clamp((d0 + b * end) / reach, -1.0, 1.0)) - low
    zero = 0.0 * d0
    area, along, across, weight = zero, zero, zero, zero
    chord, _ = sincos(0.5 * turn)
    _, whole = sincos(low + 0.5 * turn)
    span = chord * whole  # half of sin high - sin low
    for x, w in NODES:
        sine, cosine = sincos(low + x * turn)
        part, _ = sincos(0.5 * x * turn)
        _, between = sincos(low + 0.5 * x * turn)
        share = select(span > TINY, part * between / select(span > TINY, span, 1.0 + zero), x + zero)
        s = begin + (end - begin) * share
        w = w * (cosine + TINY)
        f = w * (r * r * (0.5 * math.pi + (low + x * turn) + sine * cosine))
        area, along, weight = area + f, along + f * s, weight + w
        across = across + w * (2.0 / 3.0 * r * r * r * (cosine * cosine * cosine))
    part, wet = (end - begin) / weight, math.pi * r * r * (half - end)
    along = along * part + wet * (0.5 * (half + end))
    return area * part + wet, select(mirrored, -along, along), across * part


@inline
def _arcsine(x):
    return angle(x, sqrt((1.0 - x) * (1.0 + x)))


@inline
def _cap(r, c0, b, a):
    """Return volume, and moments outward from its center and across along g, of the part of half a ball below.

    c0: depth of the center; b: how it grows outward.
    """
    zero = 0.0 * c0
    root = a * sqrt(select(r > abs(c0), r * r - c0 * c0, zero))
    begin, end = clamp(-c0 * b - root, 0.0, r), clamp(-c0 * b + root, 0.0, r)
    middle, width = 0.5 * (begin + end), 0.5 * (end - begin)
    V, out, across = zero, zero, zero
    for x, w in SINES:
        t = middle + width * x
        square = r * r - t * t
        square = select(square > 0.0, square, zero)
        reach = a * sqrt(square)
        sine = clamp((c0 + b * t) / select(reach > TINY * r, reach, TINY * r + zero), -1.0, 1.0)
        cosine = sqrt(select(sine * sine < 1.0, 1.0 - sine * sine, zero))
        f = (w * width) * (square * (0.5 * math.pi + _arcsine(sine) + sine * cosine))
        V, out = V + f, out + f * t
        across = across + (w * width) * (2.0 / 3.0) * (square * sqrt(square)) * (cosine * cosine * cosine)
    for low, high in ((zero, begin), (end, r + zero)):
        wet = c0 + b * (0.5 * (low + high)) > 0.0
        p, q = low * low, high * high
        v = math.pi * (r * r * (high - low) - (high * q - low * p) / 3.0)
        m = math.pi * (0.5 * r * r * (q - p) - 0.25 * (q * q - p * p))
        V, out = V + select(wet, v, zero), out + select(wet, m, zero)
    return V, out, across
