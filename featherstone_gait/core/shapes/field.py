"""Contact of shapes with a height field: triangles between the nodes of a grid, with solid ground below.

Each cell is two triangles, divided from its first node to the opposite one.  Three kinds of points are found:

- Of a ball (a sphere, an end of a capsule) the closest point of each triangle.  Where several are left, those that lie
  in the tangent plane of another count for nothing: so a ball rolls over the edges of a flat field as over a plane, and
  in a valley the second point comes in from nothing.
- Corners and rim points, over the triangle below them.
- Edges and nodes of the field that stand out, against the whole shape, as a segment without thickness.  No
  triangle beside may rise over the plane of contact, and a node does not count along a straight line of contact.
"""

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from ..compile.jit import kernel
from ..compile.optional import if_present
from ..compile.structure import structure
from ..tree.spatial import add, compose, cross, dot, load3, rotate, rotate_back, scale, store3, sub, vector
from .closest import capsules
from .cylinder import cylinder_points, rim_rows
from .distance import CYLINDER, HALF_SPACE, POINT, SEGMENT, TOUCH, Shapes
from .patch import MOST_POINTS, PARALLEL, Pair, across, lessened, put, unit
from .polytope import polytope_points

MANY = 64  # points among which the eight are chosen
CLOSE, LOCAL = 16, 4  # triangles near a ball that are looked at, and points that it keeps
X, N, DEPTH, FEATURE, WEIGHT = 0, 3, 6, 7, 8  # columns of `found`: place on the field (3), normal (3) of the field
ALONG = 9  # of a node: bits of the ways to its neighbors along which the shape touches too
COLUMNS = 10
ROUNDING = 1e-9  # weight of an edge that is none; of a patch, a way that is none
LEAST_SHARE = 1e-6  # of the force of a point; less is none
SAME_PLACE = 1e-7  # of the radius
AT_END = 1e-6  # of an edge, within which a point is at its node
EDGE, NODE = 1 << 18, 1 << 19  # features


@structure
class FieldBench(NamedTuple):
    """Scratch arrays."""

    edge: Shapes  # all shapes, and an edge of a field as the last
    out: np.ndarray  # (8, 8)
    found: np.ndarray  # (MANY, COLUMNS)


@if_present(0)
def field_points(field, pair, shapes, bench, out):
    """Fill out with the contact points of a shape and a height field; return their count.  field: that of the bench."""
    a, found, count = pair.a, field.found, 0
    if a.kind >= HALF_SPACE:
        return 0
    p = rotate_back(pair.R, scale(pair.c, -1.0))
    if a.kind == POINT:
        count = _ball(pair, shapes, found, 0, p, 0)
    elif a.kind == SEGMENT:
        half = rotate_back(pair.R, (0.0, 0.0, a.half[2]))
        count = _ball(pair, shapes, found, 0, sub(p, half), 0)
        count = _ball(pair, shapes, found, count, add(p, half), 1)
    elif a.kind == CYLINDER:
        count = _rims(pair, shapes, bench, found)
    else:
        for k in range(a.vertices):
            v = sub(vector(shapes.corners[a.first_vertex + k]), pair.c)
            count = _corner(pair, shapes, found, count, rotate_back(pair.R, v), float(k))
    if a.kind != POINT:
        count = _edges(field, pair, shapes, bench, p, count)
    return _give_out(pair, found, count, out)


# ---------------------------------------------------------------------------------------------- the field


@kernel
def _node(shapes, b, i, j):
    """Return the place of a node in the axes of the field, about its center [m]."""
    z = shapes.heights[b.first_node + i * b.nodes[1] + j]
    return (i * b.spacing[0] - b.half[0], j * b.spacing[1] - b.half[1], z)


@kernel
def _cell(x, half, spacing, nodes):
    """Return the number of the cell at the coordinate x along an axis, that of the nearest cell beyond the field."""
    at = (x + half) / spacing
    return min(int(at), nodes - 2) if 0.0 < at < nodes else (nodes - 2 if at > 0.0 else 0)


@kernel
def _triangle(shapes, b, i, j, upper):
    """Return the corners of a triangle of a cell, counterclockwise from above [m]."""
    first, last = _node(shapes, b, i, j), _node(shapes, b, i + 1, j + 1)
    if upper > 0:
        return first, last, _node(shapes, b, i, j + 1)
    return first, _node(shapes, b, i + 1, j), last


@kernel
def _normal(corners):
    p, q, r = corners
    return unit(cross(sub(q, p), sub(r, p)), (0.0, 0.0, 1.0))


@kernel
def _below(shapes, b, p):
    """Return whether a triangle lies below or above the point p, its normal, and one of its corners [m]."""
    i = _cell(p[0], b.half[0], b.spacing[0], b.nodes[0])
    j = _cell(p[1], b.half[1], b.spacing[1], b.nodes[1])
    x = (p[0] + b.half[0]) / b.spacing[0] - i
    y = (p[1] + b.half[1]) / b.spacing[1] - j
    corners = _triangle(shapes, b, i, j, 1 if y > x else 0)
    return 0.0 <= x <= 1.0 and 0.0 <= y <= 1.0, _normal(corners), corners[0]


@kernel
def _closest(p, corners):
    """Return the point of a triangle closest to p (C. Ericson, Real-Time Collision Detection, section 5.1.5)."""
    a, b, c = corners
    ab, ac, ap = sub(b, a), sub(c, a), sub(p, a)
    d1, d2 = dot(ab, ap), dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return a
    bp = sub(p, b)
    d3, d4 = dot(ab, bp), dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return b
    w = d1 * d4 - d3 * d2
    if w <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return add(a, scale(ab, d1 / (d1 - d3)))
    cp = sub(p, c)
    d5, d6 = dot(ab, cp), dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return c
    v = d5 * d2 - d1 * d6
    if v <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return add(a, scale(ac, d2 / (d2 - d6)))
    u = d3 * d6 - d5 * d4
    if u <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        return add(b, scale(sub(c, b), (d4 - d3) / ((d4 - d3) + (d5 - d6))))
    total = 1.0 / (u + v + w)
    return add(a, add(scale(ab, v * total), scale(ac, w * total)))


# ---------------------------------------------------------------------------------------------- balls


@kernel
def _on_triangle(pair, p, corners):
    """Return the depth of a ball in a triangle [m], -inf if its center p lies below that, the point and the normal."""
    x, m = _closest(p, corners), _normal(corners)
    v, over = sub(p, x), dot(m, sub(p, corners[0]))
    square = dot(v, v)
    touch = TOUCH * pair.size
    if over < 0.0:
        return -inf, x, m
    if square <= touch * touch:
        return pair.a.radius, x, m
    distance = sqrt(square)
    return pair.a.radius - distance, x, scale(v, 1.0 / distance)


@kernel
def _ball(pair, shapes, found, start, p, end):
    """Add the points of a ball about p; return the count of rows."""
    inside, m, at = _below(shapes, pair.b, p)
    if inside and dot(m, sub(p, at)) < 0.0:  # the center is below the surface
        return _corner(pair, shapes, found, start, p, float(end))
    deepest, at, m = _deepest(pair, shapes, p)
    if not deepest > -pair.margin:
        return start
    b, reach = pair.b, pair.a.radius + pair.margin
    i0, j0, i1, j1 = _cells(b, p, (reach, reach))
    patch = max(sqrt(2.0 * pair.a.radius * max(deepest, 0.0)), PARALLEL * pair.a.radius)
    count, there = start, False
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            for upper in range(2):
                depth, x, n = _on_triangle(pair, p, _triangle(shapes, b, i, j, upper))
                first = not there and depth == deepest and _same(x, at, pair.a.radius)
                room = min(start + CLOSE, MANY) - (0 if there or first else 1)  # one is left for the deepest
                if depth > -pair.margin and count < room:
                    if first or _above(x, n, at, m) > ROUNDING * patch:
                        again = False
                        for k in range(start, count):
                            again = again or _same(x, load3(found, k, X), pair.a.radius)
                        if not again:
                            there = there or first
                            _write(found, count, x, n, depth, 0.0)
                            count += 1
    return _shared(found, start, count, patch, end)


@kernel
def _cells(b, p, reach):
    """Return the first and the last cell along both axes within a reach (2) of p [m]."""
    x, y = reach
    return (
        _cell(p[0] - x, b.half[0], b.spacing[0], b.nodes[0]), _cell(p[1] - y, b.half[1], b.spacing[1], b.nodes[1]),
        _cell(p[0] + x, b.half[0], b.spacing[0], b.nodes[0]), _cell(p[1] + y, b.half[1], b.spacing[1], b.nodes[1]),
    )  # fmt: skip


@kernel
def _deepest(pair, shapes, p):
    """Return the largest depth of a ball about p in a triangle [m], the point and the normal."""
    b, reach = pair.b, pair.a.radius + pair.margin
    i0, j0, i1, j1 = _cells(b, p, (reach, reach))
    best, at, m = -inf, p, (0.0, 0.0, 1.0)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            for upper in range(2):
                depth, x, n = _on_triangle(pair, p, _triangle(shapes, b, i, j, upper))
                if depth > best:
                    best, at, m = depth, x, n
    return best, at, m


@kernel
def _same(x, y, radius):
    d = sub(x, y)
    return dot(d, d) <= (SAME_PLACE * radius) ** 2


@kernel
def _above(x, n, at, m):
    """Return how far the point x lies from where its tangent plane, of normal n, meets that of another point [m].

    Not above 0 if it does not lie above that plane, of normal m at the point `at`.
    """
    turned = cross(n, m)
    sine = sqrt(dot(turned, turned))
    height = dot(m, sub(x, at))
    return height / sine if sine > 1e-12 else height


@kernel
def _shared(found, start, count, patch, end):
    """Share the weight of points whose patches [m] overlap, and keep those that have any; return the count of rows.

    Of two in a flat valley one takes over from the other as the ball goes across; in a steep one both count.
    """
    kept = start
    for i in range(start, count):  # what is in the tangent plane of another is the border of its own triangle
        share = 1.0
        for j in range(start, count):
            if j != i:
                share = min(share, _share(found, i, j, patch))
        found[i, WEIGHT] = share
    for i in range(start, count):
        if found[i, WEIGHT] > LEAST_SHARE:
            _copy(found, i, kept)
            kept += 1
    for i in range(start, kept):
        weight = 1.0
        for j in range(start, kept):
            if j != i:
                other = 1.0  # of j if i were not there
                for k in range(start, kept):
                    if k != i and k != j:
                        other = other * _share(found, j, k, patch)
                weight = weight * (1.0 - other * (1.0 - _share(found, i, j, patch)))
        found[i, WEIGHT] = weight
        found[i, FEATURE] = float(2 * (i - start) + end)  # one that rolls keeps its own
    return min(kept, start + LOCAL)


@kernel
def _share(found, i, j, patch):
    """Return which share of its force the point i has beside the point j."""
    xi, ni, xj, nj = load3(found, i, X), load3(found, i, N), load3(found, j, X), load3(found, j, N)
    one = min(max(_above(xi, ni, xj, nj) / patch, 0.0), 1.0)
    two = min(max(_above(xj, nj, xi, ni) / patch, 0.0), 1.0)
    return one / min(1.0, one + two) if one + two > 0.0 else 0.5


@kernel
def _copy(found, i, to):
    for k in range(COLUMNS):
        found[to, k] = found[i, k]


@kernel
def _write(found, count, x, n, depth, feature):
    store3(found, count, X, x)
    store3(found, count, N, n)
    found[count, DEPTH] = depth
    found[count, FEATURE] = feature
    found[count, WEIGHT] = 1.0


# ---------------------------------------------------------------------------------------------- corners


@kernel
def _corner(pair, shapes, found, count, p, feature):
    """Add a corner p, or a point of a rim, if it lies in the field; return the count of rows."""
    over, m, at = _below(shapes, pair.b, p)
    height = dot(m, sub(p, at))
    if over and pair.a.radius - height > -pair.margin and count < MANY:
        _write(found, count, sub(p, scale(m, height)), m, pair.a.radius - height, feature)
        return count + 1
    return count


@kernel
def _rims(pair, shapes, bench, found):
    """Add the lowest points of both rims of a cylinder, as the ground is below the middle of each end."""
    P, count = bench.rows[0], 0
    for end in range(1 if pair.a.half[2] > 0.0 else 0, -1, -1):
        middle = (0.0, 0.0, pair.a.half[2] if end > 0 else -pair.a.half[2])
        _, m, _ = _below(shapes, pair.b, rotate_back(pair.R, sub(middle, pair.c)))
        rim_rows(pair, P, 0, False, end, rotate(pair.R, m))
        for k in range(4):
            p = rotate_back(pair.R, sub(load3(P, k, 0), pair.c))
            count = _corner(pair, shapes, found, count, p, P[k, 3])
    return count


# ---------------------------------------------------------------------------------------------- edges


@kernel
def _edges(field, pair, shapes, bench, p, count):
    """Add the points of edges that stand out of the field into the shape, whose center is p; return the count."""
    b, margin, first = pair.b, pair.margin, count
    x, y, z = _half_widths(pair)
    i0, j0, i1, j1 = _cells(b, p, (x + margin, y + margin))
    least = p[2] - z - margin
    for i in range(i0, i1 + 2):
        for j in range(j0, j1 + 2):
            for kind in range(3):
                k, l = (i + 1 if kind != 1 else i), (j + 1 if kind != 0 else j)
                if k < b.nodes[0] and l < b.nodes[1]:
                    start, end = _node(shapes, b, i, j), _node(shapes, b, k, l)
                    if max(start[2], end[2]) > least and _stands_out(shapes, b, (i, j, kind), start, end):
                        count = _edge(field, pair, shapes, bench, (i, j, kind), count)
    _weigh_nodes(shapes, b, field.found, first, count)
    return count


@kernel
def _half_widths(pair):
    """Return how far the shape reaches along the axes of the field [m]."""
    e, R = pair.a.extent, pair.R
    return (
        abs(R[0]) * e[0] + abs(R[3]) * e[1] + abs(R[6]) * e[2],
        abs(R[1]) * e[0] + abs(R[4]) * e[1] + abs(R[7]) * e[2],
        abs(R[2]) * e[0] + abs(R[5]) * e[1] + abs(R[8]) * e[2],
    )


@kernel
def _beside(kind, side):
    """Return the steps from the first node of an edge to the node across it, on either side."""
    if kind == 0:
        return (0, -1) if side == 0 else (1, 1)
    if kind == 1:
        return (-1, 0) if side == 0 else (1, 1)
    return (1, 0) if side == 0 else (0, 1)


@kernel
def _is_node(b, i, j):
    return i >= 0 and j >= 0 and i < b.nodes[0] and j < b.nodes[1]


@kernel
def _across_edge(shapes, b, edge, start, u, side):
    """Return the unit vector from an edge along the triangle on one side, zero at the border of the field."""
    i, j, kind = edge
    k, l = _beside(kind, side)
    if not _is_node(b, i + k, j + l):
        return (0.0, 0.0, 0.0)
    d = sub(_node(shapes, b, i + k, j + l), start)
    return unit(sub(d, scale(u, dot(d, u))), (0.0, 0.0, 0.0))


@kernel
def _stands_out(shapes, b, edge, start, end):
    """Return whether the field falls away on both sides of an edge from a plane that holds it."""
    u = unit(sub(end, start), (1.0, 0.0, 0.0))
    v, w = _across_edge(shapes, b, edge, start, u, 0), _across_edge(shapes, b, edge, start, u, 1)
    both = add(v, w)
    if dot(v, v) == 0.0 or dot(w, w) == 0.0:
        return True
    return both[2] < 0.0 and dot(both, both) > (1e-3 * PARALLEL) ** 2


@kernel
def _edge(field, pair, shapes, bench, edge, count):
    """Add the contact of a shape with an edge of the field; return the count of rows."""
    b, found, out = pair.b, field.found, field.out
    i, j, kind = edge
    start = _node(shapes, b, i, j)
    end = _node(shapes, b, i + 1 if kind != 1 else i, j + 1 if kind != 0 else j)
    d = sub(end, start)
    length = sqrt(dot(d, d))
    u = scale(d, 1.0 / length)
    made = _with_segment(field, pair, bench, start, u, length)
    for k in range(made):
        depth, n = out[k, 6], load3(out, k, 3)
        x = add(load3(out, k, 0), scale(n, 0.5 * depth))
        t, number, way = dot(sub(x, start), u) / length, 3 * (i * b.nodes[1] + j) + kind, -1
        v, w = _across_edge(shapes, b, edge, start, u, 0), _across_edge(shapes, b, edge, start, u, 1)
        weight, feature = max(_falls(v, n), _falls(w, n)) * _level(v, n) * _level(w, n), EDGE + (8 * number + k) % EDGE
        if t < AT_END:
            weight, feature, way = 1.0, NODE + (i * b.nodes[1] + j) % NODE, kind
        elif t > 1.0 - AT_END:
            k1, l1 = (i + 1 if kind != 1 else i), (j + 1 if kind != 0 else j)
            weight, feature, way = 1.0, NODE + (k1 * b.nodes[1] + l1) % NODE, 3 + kind
        if weight > ROUNDING and not _at_end_of_capsule(pair, x, n, depth):
            at = count
            for r in range(count if way >= 0 else 0):
                if found[r, FEATURE] == feature:
                    at = r
            if at == count and at < MANY:
                _write(found, at, x, n, depth, float(feature))
                found[at, WEIGHT], found[at, ALONG] = weight, 0.0
                count += 1
            elif at < count and found[at, DEPTH] < depth:
                store3(found, at, X, x)
                store3(found, at, N, n)
                found[at, DEPTH] = depth
            if at < count and way >= 0 and made > 1:
                found[at, ALONG] = float(int(found[at, ALONG]) | 1 << way)
    return count


@kernel
def _at_end_of_capsule(pair, x, n, depth):
    """Return whether a point of a capsule is one of the balls at its ends, which are looked at by themselves."""
    if pair.a.kind != SEGMENT:
        return False
    on_axis = add(x, scale(n, pair.a.radius - depth))
    z = add(rotate(pair.R, on_axis), pair.c)[2]
    return abs(z) >= pair.a.half[2] * (1.0 - AT_END)


@kernel
def _weigh_nodes(shapes, b, found, first, count):
    """Fill the weights of nodes: none where the field rises, or goes on level to two sides along which they touch."""
    for r in range(first, count):
        number = int(found[r, FEATURE]) - NODE
        if number >= 0:
            x, n, along, weight = load3(found, r, X), load3(found, r, N), int(found[r, ALONG]), 1.0
            i, j = _cell(x[0] + 0.5 * b.spacing[0], b.half[0], b.spacing[0], b.nodes[0] + 1), 0
            j = _cell(x[1] + 0.5 * b.spacing[1], b.half[1], b.spacing[1], b.nodes[1] + 1)
            node = _node(shapes, b, i, j)
            for kind in range(3):
                k, l = (1 if kind != 1 else 0), (1 if kind != 0 else 0)
                v, w = _to_node(shapes, b, node, i + k, j + l), _to_node(shapes, b, node, i - k, j - l)
                one = _falls(v, n) if along >> kind & 1 else 1.0
                two = _falls(w, n) if along >> (3 + kind) & 1 else 1.0
                weight = min(weight, max(one, two) * _level(v, n) * _level(w, n))
            found[r, WEIGHT] = weight


@kernel
def _to_node(shapes, b, x, i, j):
    """Return the unit vector from x to a node, none where there is no node."""
    if not _is_node(b, i, j):
        return (0.0, 0.0, 0.0)
    return unit(sub(_node(shapes, b, i, j), x), (0.0, 0.0, 0.0))


@kernel
def _falls(v, n):
    """Return how much the unit vector v, or none, points away from a plane of normal n: 0 to 1."""
    return min(max(-dot(v, n) / PARALLEL, 0.0), 1.0) if dot(v, v) > 0.0 else 1.0


@kernel
def _level(v, n):
    """Return how much the unit vector v, or none, does not rise over a plane of normal n: 0 to 1."""
    return min(max(1.0 - dot(v, n) / PARALLEL, 0.0), 1.0)


@kernel
def _with_segment(field, pair, bench, start, u, length):
    """Fill `field.out` with the contact of the shape and a segment, in the axes of the field; return the count."""
    shapes, a = field.edge, pair.a
    last = len(shapes.table) - 1
    e = shapes.table[last]
    e.half[2], e.bound = 0.5 * length, 0.5 * length
    shapes.corners[e.first_vertex, 2], shapes.corners[e.first_vertex + 1, 2] = -0.5 * length, 0.5 * length
    x = across(u)
    y = cross(u, x)
    E = (x[0], y[0], u[0], x[1], y[1], u[1], x[2], y[2], u[2])
    middle = add(start, scale(u, 0.5 * length))
    back = (E[0], E[3], E[6], E[1], E[4], E[7], E[2], E[5], E[8])
    R = pair.R
    turned = compose(back, (R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]))
    c = rotate(back, sub(rotate_back(R, scale(pair.c, -1.0)), middle))
    both = Pair(e, a, turned, c, E, middle, -1.0, pair.margin, a.radius, 0.5 * length + a.bound)
    if a.kind == SEGMENT:
        return capsules(both, field.out)
    if a.kind == CYLINDER:
        return cylinder_points(bench.ends, both, shapes, bench, field.out)
    return polytope_points(bench.near, both, shapes, bench, field.out)


# ---------------------------------------------------------------------------------------------- what is given out


@kernel
def _give_out(pair, found, count, out):
    """Give out the deepest of the rows, and of others those that lie farthest from what is given out already."""
    left, placed = 0, 0
    for i in range(count):
        if found[i, WEIGHT] > ROUNDING:
            _copy(found, i, left)
            left += 1
    count = left
    for k in range(MOST_POINTS):
        best, at = -inf, -1
        for i in range(left):
            near = inf
            for r in range(k):  # rows that were given out stand at the end
                d = sub(load3(found, i, X), load3(found, count - 1 - r, X))
                near = min(near, dot(d, d))
            worth = found[i, DEPTH] if k == 0 or found[i, DEPTH] <= 0.0 else near
            if worth > best:
                best, at = worth, i
        if at < 0:
            break
        x, n, depth = load3(found, at, X), rotate(pair.R, load3(found, at, N)), found[at, DEPTH]
        middle = sub(add(rotate(pair.R, x), pair.c), scale(n, 0.5 * depth))
        placed = put(pair, out, placed, middle, n, lessened(depth, found[at, WEIGHT]), found[at, FEATURE])
        left -= 1
        for column in range(COLUMNS):
            found[at, column], found[left, column] = found[left, column], found[at, column]
    return placed
