"""What the contact of two shapes is computed with: their poses, scratch arrays, and how points are given out.

All is computed in the frame of the first shape, where vectors have no other name.  n is the unit normal from the second
shape to the first; a gap is measured along it.
"""

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from ..compile.jit import inline, kernel
from ..compile.structure import structure
from ..tree.spatial import add, cross, dot, load3, rotate, rotate_back, scale, store3, sub, vector
from .distance import column

MOST_POINTS = 8  # points
PARALLEL = 1e-3  # sine of the angle beyond which two lines, or a line and a face, touch in one point
SHORT = 0.1  # of the shorter one's half length: two lines that run beside each other for less come to one point
SAME = 1e-9  # relative to the sizes: a difference of lengths that decides nothing
TINY = 1e-7  # sine of the angle within which a product of directions is none
VERTEX, SIDES, ODD = 64, 1 << 14, 1 << 16  # features: vertex of a, + VERTEX of b; SIDES + 128 side of a + side of b
NEAREST = 1 << 17  # the feature of one point of whatever is nearest


@structure
class Bench(NamedTuple):
    """Scratch arrays, which each call overwrites."""

    simplex: np.ndarray  # (4, 3) [m]
    witness: np.ndarray  # (4, 3) points of the first shape [m]
    vertices: np.ndarray  # (2, most vertices of a shape, 3) of both shapes [m]
    rows: np.ndarray  # (2, 2 x the most vertices of a shape + 16, 6): point [m], feature, side to the next, depth [m]
    near: np.ndarray | None  # (2, most sides of a shape) of them, int64; None where no shape is a box or a hull
    ends: np.ndarray | None  # (0,); None where no shape is a cylinder
    field: tuple | None = None  # FieldBench of field.py; None where no shape is a height field


@structure
class Pair(NamedTuple):
    """Two shapes in the frame of the first."""

    a: np.ndarray  # SHAPE
    b: np.ndarray  # SHAPE
    R: tuple  # (9) rotation of the second
    c: tuple  # (3) center of the second [m]
    E: tuple  # (9) rotation to the common frame
    r: tuple  # (3) center of the first in the common frame [m]
    side: float  # 1, or -1 if the caller has named the second one first
    margin: float  # [m]
    radii: float  # sum of the balls' [m]
    size: float  # of both cores, to compare lengths with [m]


@inline
def put(pair, out, count, x, n, depth, feature):
    """Give out a point x midway between the surfaces [m] if it is within the margin; return the count of points."""
    if not depth > -pair.margin or count >= MOST_POINTS:
        return count
    store3(out, count, 0, add(pair.r, rotate(pair.E, x)))
    store3(out, count, 3, scale(rotate(pair.E, n), pair.side))
    out[count, 6] = depth
    out[count, 7] = feature
    return count + 1


@kernel
def put_nearest(pair, out, count, xa, n, gap, feature):
    """Give out the point of two cores that are nearest, xa on the first [m], at the gap between the cores [m]."""
    depth = pair.radii - gap
    return put(pair, out, count, sub(xa, scale(n, pair.a.radius - 0.5 * depth)), n, depth, feature)


@kernel
def put_rows(pair, out, P, count, n, first):
    """Give out the rows of P, points of the first shape's core or else the second's, at their depths along n."""
    m, radius = (n, pair.a.radius) if first else (scale(n, -1.0), pair.b.radius)
    count, placed = thin(P, count, m), 0
    for k in range(count):
        x = sub(load3(P, k, 0), scale(m, radius - 0.5 * P[k, 5]))
        placed = put(pair, out, placed, x, n, P[k, 5], P[k, 3])
    return placed


@kernel
def thin(P, count, m):
    """Keep of more than eight rows the deepest, and those farthest along directions across m; return how many."""
    if count <= MOST_POINTS:
        return count
    t = across(m)
    s = cross(m, t)
    taken = 0
    _swap(P, 0, deepest_row(P, count))
    taken = 1
    for k in range(MOST_POINTS):
        x, y = _eighth(k)
        far, at = -inf, 0
        for i in range(count):
            height = x * dot(t, load3(P, i, 0)) + y * dot(s, load3(P, i, 0))
            if height > far:
                far, at = height, i
        if at >= taken and taken < MOST_POINTS:
            _swap(P, taken, at)
            taken += 1
    return taken


@inline
def _eighth(k):
    """Return the direction of k eighths of a turn."""
    h = 0.7071067811865476
    x = (1.0, h, 0.0, -h, -1.0, -h, 0.0, h)
    y = (0.0, h, 1.0, h, 0.0, -h, -1.0, -h)
    return x[k], y[k]


@kernel
def _swap(P, i, j):
    for x in range(6):
        P[i, x], P[j, x] = P[j, x], P[i, x]


@kernel
def deepest_row(P, count):
    """Return the first of the deepest rows, -1 if there is none."""
    most, at = -inf, -1
    for k in range(count):
        if P[k, 5] > most:
            most, at = P[k, 5], k
    return at


@kernel
def keep_deep(pair, P, count, m, offset, slope):
    """Write the depths of rows over the plane m'x = offset, measured along n where slope = m'n; return how many count.

    Left out are those beyond the margin, and features that are there already.
    """
    kept = 0
    for k in range(count):
        depth = pair.radii - (dot(m, load3(P, k, 0)) - offset) / slope
        again = False
        for i in range(kept):
            again = again or P[i, 3] == P[k, 3]
        if depth > -pair.margin and not again:
            for x in range(5):
                P[kept, x] = P[k, x]
            P[kept, 5] = depth
            kept += 1
    return kept


@kernel
def with_nearest(pair, P, count, x, gap):
    """Put the nearest point x in the deepest row's place, if that is less deep than the gap of the cores says."""
    at = deepest_row(P, count)
    depth = pair.radii - gap
    if at >= 0 and P[at, 5] >= depth - SAME * pair.size:
        return count
    if at < 0:
        at = count
        P[at, 3], P[at, 4] = NEAREST, 1.0
        count += 1
    store3(P, at, 0, x)
    P[at, 5] = depth
    return count


@inline
def lessened(depth, weight):
    """Return a depth of overlap weighted; a gap stays, so that what the margin is changes no force."""
    return weight * depth if depth > 0.0 else depth


@kernel
def fade(P, count, keep):
    """Lessen the depths of all rows but the deepest to as much as `keep` says."""
    deep = deepest_row(P, count)
    for k in range(count):
        if k != deep:
            P[k, 5] = lessened(P[k, 5], keep)


@inline
def aligned(m, n):
    """Return how much lies over a face of normal m if n is not quite that: 1, falling to 0 at `PARALLEL`.

    So what lies over the face does not vanish at once when the shapes turn from touching along it.
    """
    turned = cross(m, n)
    return max(0.0, 1.0 - sqrt(dot(turned, turned)) / PARALLEL)


@inline
def write_row(P, k, x, feature, label):
    """Write a point, its feature and the label of the side that follows."""
    store3(P, k, 0, x)
    P[k, 3] = feature
    P[k, 4] = label


@inline
def up(pair):
    """Return the n that is given out as the common frame's z, which stands for a normal where there is none."""
    return rotate_back(pair.E, (0.0, 0.0, pair.side))


@inline
def unit(u, instead):
    """Return u with the length 1, or another vector if it has none."""
    length = dot(u, u)
    if length > 1e-280:
        return scale(u, 1.0 / sqrt(length))
    return instead


@kernel
def across(m):
    """Return a unit vector across the unit vector m."""
    x, y, z = abs(m[0]), abs(m[1]), abs(m[2])
    if x <= y and x <= z:
        return unit((0.0, m[2], -m[1]), m)
    if y <= z:
        return unit((-m[2], 0.0, m[0]), m)
    return unit((m[1], -m[0], 0.0), m)


@kernel
def plane_of(pair, shapes, second, face):
    """Return the outward normal of a face of either shape, and its distance from the origin [m]."""
    if second:
        row = shapes.planes[pair.b.first_face + face]
        m = rotate(pair.R, vector(row))
        return m, row[3] + dot(m, pair.c)
    row = shapes.planes[pair.a.first_face + face]
    return vector(row), row[3]


@kernel
def lay_vertices(pair, shapes, bench):
    """Write the vertices of both shapes."""
    for k in range(pair.a.vertices):
        store3(bench.vertices[0], k, 0, vector(shapes.corners[pair.a.first_vertex + k]))
    for k in range(pair.b.vertices):
        x = rotate(pair.R, vector(shapes.corners[pair.b.first_vertex + k]))
        store3(bench.vertices[1], k, 0, add(x, pair.c))


@kernel
def lowest(V, count, m):
    """Return the first of the vertices V that are lowest along m, and its height [m]."""
    least, at = inf, 0
    for k in range(count):
        height = dot(m, load3(V, k, 0))
        if height < least:
            least, at = height, k
    return at, least


@kernel
def axis(E):
    """Return the z axis of a rotation."""
    return column(E, 2)
