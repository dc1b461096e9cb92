"""Closest points of two shapes: of lines, and of any two cores that are apart.

Lines after V. J. Lumelsky, "On fast computation of distance between line segments", Information Processing Letters 21
(1985).
"""

from math import sqrt

from ..compile.jit import kernel
from ..compile.lanes import clamp
from ..tree.spatial import add, cross, dot, load3, rotate, rotate_back, scale, store3, sub, vector
from .distance import GAP, PASSES, TOUCH, column, keep_rows, nearest_in_simplex, on_edge, support
from .patch import PARALLEL, SHORT, TINY, lessened, put, unit, up


@kernel
def closest_on_lines(line, other):
    """Return where two lines are closest, from the middle of each [m], and the sine of their angle.

    line: (middle (3) [m], unit direction (3), half length [m]).  Of parallel ones it is the middle of the common part.
    """
    (p, u, h), (q, v, k) = line, other
    c, along, turned = sub(q, p), dot(u, v), cross(u, v)
    square = dot(turned, turned)
    low, high = common_part(line, other)
    s = clamp(0.5 * (low + high), -h, h)
    if square > 1e-24:
        s = clamp((dot(u, c) - along * dot(v, c)) / square, -h, h)
    t = along * s - dot(v, c)
    if abs(t) > k:
        t = clamp(t, -k, k)
        s = clamp(dot(u, c) + along * t, -h, h)
    return s, t, sqrt(square)


@kernel
def common_part(line, other):
    """Return from where to where another line runs beside a line, from its middle [m]."""
    (p, u, h), (q, v, k) = line, other
    middle, half = dot(u, sub(q, p)), abs(dot(u, v)) * k
    return max(-h, middle - half), min(h, middle + half)


@kernel
def put_lines(pair, out, line, other, n, feature, lift):
    """Give out the contact of two lines along n: one point, or two if they are parallel; return the count.

    lift [m]: by so much along n is the first line moved to find where they are closest; more than by what they overlap.

    The second point has feature + 1.  As two parallel lines turn against each other by `PARALLEL`, the ends of their
    common part move to the closest point, and their depths are shared out until they come to one point's.  So the sum
    of the depths is continuous, and where an end is the closest point it keeps all of its depth.
    At `PARALLEL` the ends of rods of 25 mm radius are 25 nm apart along a common part of 0.1 m; it touches as a whole
    if they are pressed together by as much.
    """
    (p, u, h), (q, v, k) = line, other
    s, t, sine = closest_on_lines((add(p, scale(n, lift)), u, h), other)
    low, high = common_part(line, other)
    keep = 0.0
    if high > low:
        keep = max(0.0, 1.0 - sine / PARALLEL) * min(1.0, (high - low) / (SHORT * min(h, k)))
    if not keep > 0.0:
        return _put_at(pair, out, 0, (add(p, scale(u, s)), add(q, scale(v, t))), n, 1.0, feature)
    part = clamp((s - low) / (high - low), 0.0, 1.0)
    count = 0
    for end in range(2):
        at = s + keep * ((high if end else low) - s)
        beside = clamp(dot(v, sub(add(p, scale(u, at)), q)), -k, k)
        weight = 1.0 - (1.0 - keep) * (1.0 - part if end else part)
        both = add(p, scale(u, at)), add(q, scale(v, beside))
        count = _put_at(pair, out, count, both, n, weight, feature + end)
    return count


@kernel
def capsules(pair, out):
    """Give out the contact of two capsules."""
    zero = (0.0, 0.0, 0.0)
    line, other = (zero, (0.0, 0.0, 1.0), pair.a.half[2]), (pair.c, column(pair.R, 2), pair.b.half[2])
    s, t, _ = closest_on_lines(line, other)
    v = sub(scale(line[1], s), add(pair.c, scale(other[1], t)))
    turned = cross(line[1], other[1])
    aside = unit(turned, up(pair)) if dot(turned, turned) > TINY * TINY else up(pair)
    aside = aside if dot(aside, pair.c) <= 0.0 else scale(aside, -1.0)
    n = unit(v, aside) if dot(v, v) > (TOUCH * pair.size) ** 2 else aside
    return put_lines(pair, out, line, other, n, 0, 0.0)


@kernel
def _put_at(pair, out, count, both, n, weight, feature):
    """Give out a point between two points of the cores, its depth weighted."""
    xa, xb = both
    depth = pair.radii - dot(n, sub(xa, xb))
    x = scale(add(sub(xa, scale(n, pair.a.radius)), add(xb, scale(n, pair.b.radius))), 0.5)
    return put(pair, out, count, x, n, lessened(depth, weight), feature)


@kernel
def difference_towards(pair, c, corners, u):
    """Return the farthest point of the first core in the direction u, and less that of the second; c: its center."""
    pa = support(pair.a, corners, u)
    pb = rotate(pair.R, support(pair.b, corners, rotate_back(pair.R, scale(u, -1.0))))
    return pa, sub(sub(pa, pb), c)


@kernel
def nearest_points(pair, c, corners, bench):
    """Return the vector (3) from the second core to the first, 0 if they overlap, and its end on the first [m].

    c: the center of the second [m], which need not be where the pair has it.
    """
    S, P = bench.simplex, bench.witness
    pa, v = difference_towards(pair, c, corners, c)
    store3(S, 0, 0, v)
    store3(P, 0, 0, pa)
    count = 1
    for _ in range(PASSES):
        square = dot(v, v)
        if count == 4 or square <= (TOUCH * pair.size) ** 2:
            return (0.0, 0.0, 0.0), pa
        pa, w = difference_towards(pair, c, corners, scale(v, -1.0))
        if square - dot(v, w) <= GAP * square:
            break
        store3(S, count, 0, w)
        store3(P, count, 0, pa)
        nearer, used = nearest_in_simplex(S, count + 1)
        if not (dot(nearer, nearer) < square):
            break
        v, count = nearer, keep_rows(S, used)
        keep_rows(P, used)
    return v, _witness(S, P, count)


@kernel
def _witness(S, P, count):
    """Return the point of the first core at the nearest point of the simplex, which lies in all of its rows."""
    x = vector(P[0])
    if count == 2:
        t, _ = on_edge(vector(S[0]), vector(S[1]))
        return add(x, scale(sub(vector(P[1]), x), t))
    if count == 3:
        p = vector(S[0])
        d, e = sub(vector(S[1]), p), sub(vector(S[2]), p)
        n = cross(d, e)
        area = dot(n, n)
        s, t = -dot(cross(p, e), n) / area, -dot(cross(d, p), n) / area
        return add(x, add(scale(sub(vector(P[1]), x), s), scale(sub(load3(P, 2, 0), x), t)))
    return x
