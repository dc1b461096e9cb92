"""Shortest ways of a tendon around a sphere or a cylinder, or through a ring.

All is in the frame of the shape, its center at the origin and a cylinder's axis along z.  Around a sphere the way lies
in the plane of its center and both ends; around a cylinder it is the one in the plane across the axis, along which it
rises evenly.  In the plane a tangent from each end touches the circle.  The way goes round the center as the straight
one does, and is the straight one where that meets no circle.  Where a side is given, it never crosses the ray from the
center away from it: where the straight one does, the way goes round on the other side.  Where the side lies within the
shape, the tendon runs through it as through a ring: where it is not straight, it bends at the point of the circle at
which the way is shortest.

The length is stationary in the points of contact, so its slope is that of the straight parts: a force along it pulls at
the ends and where it touches.  Both are continuous where it touches down.

Where the straight way comes to cross that ray, the length jumps from one side to the other, as in MuJoCo.

Source: MuJoCo's documentation of spatial tendons states which way is taken.
"""

from ..compile.elementary import PI, angle, sincos
from ..compile.jit import entry, inline, kernel
from ..compile.lanes import any_lane, invert, select, sqrt
from ..compile.structure import record
from ..tree.spatial import cross, dot, scale, vector

WRAP = record(
    cylinder=int,  # 1 = of a cylinder, 0 = of a sphere
    sided=int,  # FREE ...
    radius=float,  # [m]
    E=(float, 9),  # rotation of the shape's frame -> body
    side=(float, 3),  # point on whose side the tendon runs, in the shape's frame [m]
)
FREE, OUTSIDE, INSIDE = range(3)  # no side; a side outside of the shape; one within, of a ring
TINY = 1e-15
PASSES = 40  # at most of the iteration for a ring; five are usual


@inline
def _over(a, b):
    """Return a / b, a where b is none."""
    return a / select(abs(b) < TINY, 1.0 + 0.0 * b, b)


@inline
def _unit(a):
    return scale(a, _over(1.0, sqrt(dot(a, a))))


@inline
def _plane(wrap, p, q):
    """Return the axes of the plane in which the way turns."""
    if wrap.cylinder > 0:
        zero = 0.0 * p[0]
        return (1.0 + zero, zero, zero), (zero, 1.0 + zero, zero)
    x = _unit(p)
    return x, _unit(cross(_unit(cross(p, q)), x))


@inline
def own_frame(wrap):
    """Return the rotation of the shape's frame -> body."""
    E = wrap.E
    return (E[0], E[1], E[2], E[3], E[4], E[5], E[6], E[7], E[8])


@kernel
def way_around(wrap, p, q):
    """Return whether the way from p to q turns, the points where it leaves and ends the straight parts, and its bend.

    p, q (3) [m], in the frame of the shape.  Where it does not turn the points mean nothing.
    """
    x, y = _plane(wrap, p, q)
    a, b = (dot(p, x), dot(p, y)), (dot(q, x), dot(q, y))
    if wrap.sided == INSIDE:
        turns, c, d, arc = _through(a, b, wrap.radius)
    else:
        side = vector(wrap.side)
        turns, c, d, arc = _around(wrap.sided, a, b, (dot(side, x), dot(side, y)), wrap.radius)
    if wrap.cylinder > 0:
        first, last = _apart(a, c), _apart(d, b)
        rise = _over(q[2] - p[2], first + arc + last)
        low, high = p[2] + rise * first, p[2] + rise * (first + arc)
        return turns, (c[0], c[1], low), (d[0], d[1], high), sqrt(arc * arc + (high - low) * (high - low))
    u = (c[0] * x[0] + c[1] * y[0], c[0] * x[1] + c[1] * y[1], c[0] * x[2] + c[1] * y[2])
    v = (d[0] * x[0] + d[1] * y[0], d[0] * x[1] + d[1] * y[1], d[0] * x[2] + d[1] * y[2])
    return turns, u, v, arc


@inline
def _dot2(a, b):
    return a[0] * b[0] + a[1] * b[1]


@inline
def _cross2(a, b):
    return a[0] * b[1] - a[1] * b[0]


@inline
def _apart(a, b):
    x, y = b[0] - a[0], b[1] - a[1]
    return sqrt(x * x + y * y)


@inline
def _nearest(a, b):
    """Return the point nearest to the origin on the straight way from a to b."""
    d = (b[0] - a[0], b[1] - a[1])
    t = -_over(_dot2(d, a), _dot2(d, d))
    t = select(t < 0.0, 0.0 * t, select(t > 1.0, 1.0 + 0.0 * t, t))
    return a[0] + t * d[0], a[1] + t * d[1]


@inline
def _root(x):
    """Return the square root, 0 of a negative number."""
    return sqrt(select(x > 0.0, x, 0.0 * x))


@inline
def _tangent(a, size, radius, sign):
    """Return the point of the circle that a tangent from a touches; size: |a|^2."""
    s = sign * radius * _root(size - radius * radius)
    r2 = radius * radius
    return _over(a[0] * r2 + s * a[1], size), _over(a[1] * r2 - s * a[0], size)


@inline
def _behind(a, b, side):
    """Return whether the straight way from a to b passes the origin opposite to the side."""
    u, v = _cross2(side, a), _cross2(side, b)
    t = _over(u, u - v)
    at = _dot2(side, a) + t * (_dot2(side, b) - _dot2(side, a))
    return (u * v < 0.0) & (at < 0.0)


@inline
def _around(sided, a, b, side, radius):
    """Return whether the way around a circle turns, where it touches, and how long its bend is."""
    sa, sb, r2, near = _dot2(a, a), _dot2(b, b), radius * radius, _nearest(a, b)
    meets = _dot2(near, near) <= r2
    left = _cross2(a, b) > 0.0  # the short way turns counterclockwise
    if sided == FREE:
        far = left & invert(left)
    else:
        far = _behind(a, b, side)
    turns = (sa >= r2) & (sb >= r2) & (meets | far)
    sign = select((left & far) | invert(left | far), 1.0 + 0.0 * sa, -1.0 + 0.0 * sa)  # clockwise
    c, d = _tangent(a, sa, radius, sign), _tangent(b, sb, radius, -sign)
    turned = -sign * angle(_cross2(c, d), _dot2(c, d))
    turned = select(far & (turned < 0.0), turned + 2.0 * PI, abs(turned))
    return turns, c, d, radius * turned


@inline
def _through(a, b, radius):
    """Return the same of the way through a ring, which bends at one point.

    Its length by the angle t of that point from a, of g between both, has the slope
    |a| r sin t / |a - p| - |b| r sin(g - t) / |b - p|, which rises from a negative number to a positive one.
    """
    la, lb, near = sqrt(_dot2(a, a)), sqrt(_dot2(b, b)), _nearest(a, b)
    turns = (la > radius) & (lb > radius) & (_dot2(near, near) > radius * radius)
    g = angle(_cross2(a, b), _dot2(a, b))
    sign = select(g < 0.0, -1.0 + 0.0 * g, 1.0 + 0.0 * g)
    g = abs(g)
    low, high, t, done = 0.0 * g, g, 0.5 * g, invert(turns)
    sg, cg = sincos(g)
    for _ in range(PASSES):
        s, c = sincos(t)
        z, x = sg * c - cg * s, cg * c + sg * s  # sine and cosine of g - t
        pa, pb = la * radius, lb * radius
        da = sqrt(_positive(la * la + radius * radius - 2.0 * pa * c))
        db = sqrt(_positive(lb * lb + radius * radius - 2.0 * pb * x))
        slope = pa * s / da - pb * z / db
        bend = pa * (c - pa * s * s / (da * da)) / da + pb * (x - pb * z * z / (db * db)) / db
        low, high = select(slope < 0.0, t, low), select(slope < 0.0, high, t)
        next_t = t - _over(slope, bend)
        next_t = select((next_t > low) & (next_t < high), next_t, 0.5 * (low + high))
        settled = abs(next_t - t) <= 4e-16 * (1.0 + g)
        t = select(done, t, next_t)
        done = done | settled
        if not any_lane(invert(done)):
            break
    s, c = sincos(sign * t)
    f = _over(radius + 0.0 * la, la)
    point = f * (c * a[0] - s * a[1]), f * (s * a[0] + c * a[1])
    return turns, point, point, 0.0 * g


@inline
def _positive(x):
    return select(x > TINY, x, TINY + 0.0 * x)


@entry
def ways_around(table, p, q, out):
    """Fill out (n, 8): whether the ways from p to q (n, 3) turn, their points of contact and bends; table (1,) WRAP."""
    for i in range(len(p)):
        turns, c, d, arc = way_around(table[0], (p[i, 0], p[i, 1], p[i, 2]), (q[i, 0], q[i, 1], q[i, 2]))
        out[i, 0] = 1.0 if turns else 0.0
        for k in range(3):
            out[i, 1 + k], out[i, 4 + k] = c[k], d[k]
        out[i, 7] = arc
