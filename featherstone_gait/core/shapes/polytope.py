"""Contact of polytopes: points, segments, boxes and hulls, each with a ball about it.

The direction of least overlap is sought among face normals and products of edges (C. Ericson, "Real-Time Collision
Detection", Elsevier 2005, section 5.2.1); where the cores are apart and their nearest points lie neither on a face nor
inside of two edges, it is that of these points.  Along a face the other shape's face is clipped by the planes through
its sides (I. E. Sutherland, G. W. Hodgman, "Reentrant polygon clipping", Communications of the ACM 17 (1974)).
"""

from math import inf, sqrt

from ..compile.jit import kernel
from ..compile.lanes import clamp
from ..compile.optional import if_present
from ..tree.spatial import add, cross, dot, load3, rotate, rotate_back, scale, sub, vector
from .closest import closest_on_lines, nearest_points, put_lines
from .patch import (
    NEAREST,
    ODD,
    PARALLEL,
    SAME,
    SHORT,
    SIDES,
    TINY,
    VERTEX,
    aligned,
    deepest_row,
    fade,
    keep_deep,
    lay_vertices,
    lessened,
    lowest,
    plane_of,
    put_nearest,
    put_rows,
    unit,
    up,
    with_nearest,
    write_row,
)


@if_present(0)
def polytope_points(near, pair, shapes, bench, out):
    """Fill out with the contact points of two polytopes; return their count.  near: that of the bench."""
    lay_vertices(pair, shapes, bench)
    most = pair.radii + pair.margin
    sa, fa = best_face(pair, shapes, bench, False)
    if sa > most:
        return 0
    sb, fb = best_face(pair, shapes, bench, True)
    if sb > most:
        return 0
    # Faces before edges, and those of a before those of b, by what rounding may be: parallel edges give no new
    # direction, and two parallel faces the same points whichever is clipped by the other.
    second = sb > sa + SAME * pair.size
    gap, face = (sb, fb) if second else (sa, fa)
    if face < 0:
        return _by_nearest(pair, shapes, bench, out, up(pair))
    if gap <= 0.0:
        edge, n, i, j = _best_edges(near, pair, shapes, bench, gap)
        if edge > 0.0:
            return _by_nearest(pair, shapes, bench, out, n) if edge <= most else 0
        if edge > gap:
            return _edge_points(pair, shapes, bench, out, n, i, j)
    count = _clipped(pair, shapes, bench, second, face)
    m, offset = plane_of(pair, shapes, second, face)
    P, n = bench.rows[0], (m if second else scale(m, -1.0))
    count = keep_deep(pair, P, count, m, offset, 1.0)
    at = deepest_row(P, count)
    if gap > 0.0 and (at < 0 or P[at, 5] < pair.radii - gap - SAME * pair.size):
        return _by_nearest(pair, shapes, bench, out, n)
    if gap <= 0.0:
        if at < 0 or P[at, 5] < pair.radii:  # no point of both was found: edges that are far apart were left out
            v, _ = nearest_points(pair, pair.c, shapes.corners, bench)
            if dot(v, v) > SAME * SAME * pair.size * pair.size:
                return _by_nearest(pair, shapes, bench, out, n)
        V, vertices = bench.vertices[0 if second else 1], (pair.a.vertices if second else pair.b.vertices)
        low, _ = lowest(V, vertices, m)
        count = with_nearest(pair, P, count, load3(V, low, 0), gap)
    _share_corners(P, count, 1.0)
    return put_rows(pair, out, P, count, n, second)


@kernel
def best_face(pair, shapes, bench, second):
    """Return the largest gap over a face of either polytope [m] and the face; -inf and -1 if it has none."""
    best, at = -inf, -1
    V = bench.vertices[0 if second else 1]
    vertices, faces = (pair.a.vertices, pair.b.faces) if second else (pair.b.vertices, pair.a.faces)
    for face in range(faces):
        m, offset = plane_of(pair, shapes, second, face)
        least = inf
        for k in range(vertices):
            least = min(least, dot(m, load3(V, k, 0)))
            if least - offset <= best:
                break
        if least - offset > best:
            best, at = least - offset, face
    return best, at


@kernel
def _near_sides(near, pair, shapes, bench, second, reach):
    """Write which sides of a polytope come as close as `reach` [m] to the other; return their count."""
    shape = pair.b if second else pair.a
    V = bench.vertices[1 if second else 0]
    faces, count = (pair.a.faces if second else pair.b.faces), 0
    for k in range(shape.sides):
        p, q = _ends(shapes, shape, V, k)
        apart = False
        for face in range(faces):
            m, offset = plane_of(pair, shapes, not second, face)
            if min(dot(m, p), dot(m, q)) - offset > reach:
                apart = True
                break
        if not apart:
            near[count] = k
            count += 1
    return count


@kernel
def _ends(shapes, shape, V, side):
    """Return the ends of a side of a polytope [m]."""
    k = shape.first_side + side
    return load3(V, shapes.sides[k, 0], 0), load3(V, shapes.sides[k, 1], 0)


@kernel
def _best_edges(near, pair, shapes, bench, gap):
    """Return the largest gap along a product of edges [m], if that is more than `gap`, n, and the two sides."""
    V, W, slack = bench.vertices[0], bench.vertices[1], SAME * pair.size
    reach = max(slack - gap, pair.radii + pair.margin)
    ours = _near_sides(near[0], pair, shapes, bench, False, reach)
    theirs = _near_sides(near[1], pair, shapes, bench, True, reach) if ours > 0 else 0
    best, n, at, to = gap + slack, (0.0, 0.0, 0.0), 0, 0
    for x in range(ours):
        i = near[0, x]
        p, q = _ends(shapes, pair.a, V, i)
        u = sub(q, p)
        turned = rotate_back(pair.R, u)
        for y in range(theirs):
            j = near[1, y]
            r, s = _ends(shapes, pair.b, W, j)
            v = sub(s, r)
            w = _if_both_support(pair, shapes, (i, j), (u, v, turned))
            square = dot(w, w)
            if square > TINY * TINY * (dot(u, u) * dot(v, v)):
                m = scale(w, 1.0 / sqrt(square))
                along = dot(m, sub(p, r))
                if along > best:
                    _, low = lowest(V, pair.a.vertices, m)
                    _, high = lowest(W, pair.b.vertices, scale(m, -1.0))
                    if low + high > best:
                        best, n, at, to = low + high, m, i, j
    return (best, n, at, to) if best > gap + slack else (-inf, n, 0, 0)


@kernel
def _if_both_support(pair, shapes, edges, directions):
    """Return a vector along n if there is a plane across both edges with the shapes on its two sides, else zero.

    That is so where the arcs of normals of both edges cross, one of them taken backwards (D. Gregorius, "The separating
    axis test between convex polyhedra", Game Developers Conference 2013).  A segment's arc is a whole circle.
    """
    (i, j), (u, v, turned) = edges, directions
    ours, theirs, none = shapes.sides[pair.a.first_side + i], shapes.sides[pair.b.first_side + j], (0.0, 0.0, 0.0)
    w, b, c = cross(u, v), 0.0, 0.0
    if ours[2] >= 0:
        A, B = _normal(shapes, pair.a, ours[2]), _normal(shapes, pair.a, ours[3])
        b = dot(B, v)
        if not dot(A, v) * b < 0.0:
            return none
        w = w if dot(w, cross(u, sub(A, B))) < 0.0 else scale(w, -1.0)
    if theirs[2] >= 0:
        C, D = _normal(shapes, pair.b, theirs[2]), _normal(shapes, pair.b, theirs[3])
        c = dot(C, turned)
        if not c * dot(D, turned) < 0.0 or b * c > 0.0:
            return none
        if ours[2] < 0:
            w = w if dot(w, rotate(pair.R, cross(rotate_back(pair.R, v), sub(C, D)))) > 0.0 else scale(w, -1.0)
    return w


@kernel
def _normal(shapes, shape, face):
    return vector(shapes.planes[shape.first_face + face])


@kernel
def line_of(shapes, shape, V, side):
    """Return the middle of a side of a polytope [m], its unit direction and half its length [m]."""
    p, q = _ends(shapes, shape, V, side)
    d = sub(q, p)
    return scale(add(p, q), 0.5), unit(d, (0.0, 0.0, 1.0)), 0.5 * sqrt(dot(d, d))


@kernel
def _edge_points(pair, shapes, bench, out, n, i, j):
    """Give out the contact of two edges along n."""
    line, other = line_of(shapes, pair.a, bench.vertices[0], i), line_of(shapes, pair.b, bench.vertices[1], j)
    feature = SIDES + 128 * i + j
    count = aligned_points(pair, shapes, bench, out, n, *_between(line, other, n))
    return count if count >= 0 else put_lines(pair, out, line, other, n, feature, pair.size)


@kernel
def _between(line, other, n):
    """Return the closest points of two lines, and their gap along n [m]."""
    s, t, _ = closest_on_lines(line, other)
    xa, xb = add(line[0], scale(line[1], s)), add(other[0], scale(other[1], t))
    return xa, xb, dot(n, sub(xa, xb))


@kernel
def _by_nearest(pair, shapes, bench, out, instead):
    """Give out the contact of polytopes along the line between their nearest points, or another if that is none."""
    v, xa = nearest_points(pair, pair.c, shapes.corners, bench)
    gap = sqrt(dot(v, v))
    if gap > pair.radii + pair.margin:
        return 0
    n = unit(v, instead)
    xb = sub(xa, v)
    count = aligned_points(pair, shapes, bench, out, n, xa, xb, gap)
    if count >= 0:
        return count
    i, j, alike = _parallel_sides(pair, shapes, bench, n)
    if alike > 0.0:
        line, other = line_of(shapes, pair.a, bench.vertices[0], i), line_of(shapes, pair.b, bench.vertices[1], j)
        return put_lines(pair, out, line, other, n, SIDES + 128 * i + j, pair.size)
    return put_nearest(pair, out, 0, xa, n, gap, NEAREST)


@kernel
def aligned_points(pair, shapes, bench, out, n, xa, xb, gap):
    """Give out the points over a face whose normal is within `PARALLEL` of n, else return -1.

    So a rod that tilts over the edge of a face lifts off the face, and does not leave it at once.
    """
    best, face, second = sqrt(1.0 - PARALLEL * PARALLEL), -1, False
    for k in range(pair.a.faces):
        m, _ = plane_of(pair, shapes, False, k)
        if -dot(m, n) > best:
            best, face, second = -dot(m, n), k, False
    for k in range(pair.b.faces):
        m, _ = plane_of(pair, shapes, True, k)
        if dot(m, n) > best:
            best, face, second = dot(m, n), k, True
    if face < 0:
        return -1
    count = _clipped(pair, shapes, bench, second, face)
    m, offset = plane_of(pair, shapes, second, face)
    P = bench.rows[0]
    count = keep_deep(pair, P, count, m, offset, best)
    count = with_nearest(pair, P, count, xa if second else xb, gap)
    keep = aligned(m, n)
    fade(P, count, keep)
    _share_corners(P, count, keep)
    return put_rows(pair, out, P, count, n, second)


@kernel
def _parallel_sides(pair, shapes, bench, n):
    """Return the two most parallel sides that lie across n, nearest to the other shape, and their cosine, 0 if none."""
    V, W, back = bench.vertices[0], bench.vertices[1], scale(n, -1.0)
    _, low = lowest(V, pair.a.vertices, n)
    _, high = lowest(W, pair.b.vertices, back)
    best, at, to = sqrt(1.0 - PARALLEL * PARALLEL), 0, 0
    found = 0.0
    for i in range(pair.a.sides):
        line = line_of(shapes, pair.a, V, i)
        if side_height(line, n) - low <= 2.0 * PARALLEL * line[2]:
            for j in range(pair.b.sides):
                other = line_of(shapes, pair.b, W, j)
                if side_height(other, back) - high <= 2.0 * PARALLEL * other[2]:
                    alike = abs(dot(line[1], other[1]))
                    if alike > best:
                        best, at, to, found = alike, i, j, alike
    return at, to, found


@kernel
def side_height(line, n):
    """Return the height of the upper end of a line along n [m]."""
    return dot(n, line[0]) + abs(dot(n, line[1])) * line[2]


@kernel
def _clipped(pair, shapes, bench, second, face):
    """Write the other shape's face, clipped by the sides of a face, into the rows; return their count."""
    shape = pair.b if second else pair.a
    V = bench.vertices[1 if second else 0]
    m, _ = plane_of(pair, shapes, second, face)
    count = incident_rows(pair, shapes, bench, not second, m)
    start, loop = shapes.loops[shape.first_face + face]
    P, Q = bench.rows[0], bench.rows[1]
    for k in range(loop):
        p = load3(V, shapes.around[start + k, 0], 0)
        q = load3(V, shapes.around[start + (k + 1 if k + 1 < loop else 0), 0], 0)
        w = cross(sub(q, p), m)
        square = dot(w, w)
        if square > (SAME * pair.size) ** 2:
            w = scale(w, 1.0 / sqrt(square))
            count = _cut(pair, shapes, P, Q, count, (w, dot(w, p)), (second, start, loop, k))
            P, Q = Q, P
    count = moved(P, bench.rows[0], count)
    _weigh_corners(pair, shapes, bench, m, (second, start, loop), bench.rows[0], count)
    return count


@kernel
def _weigh_corners(pair, shapes, bench, m, by, P, count):
    """Write into the rows what each counts, in the place of the label of the side to the next.

    A corner that leaves a face over its side becomes two points, and where the next one follows it two become one.
    Points at one place therefore share what one of them would count: each side of the polygon that is shorter than
    `SHORT` of an eighth of all sides, and is cut, takes up to one from its ends; from both alike where they are as
    deep as each other, and from the less deep one beyond a slope of `PARALLEL`.  m, by: see `_clipped`, `_meeting`.
    """
    whole = 0.0
    for k in range(count):
        P[k, 5] = 0.0
        whole += _apart(P, k, k + 1 if k + 1 < count else 0)
    short = SHORT / 8.0 * whole
    for k in range(count if count > 2 else 0):
        i = k + 1 if k + 1 < count else 0
        length = _apart(P, k, i)
        if length < short and P[k, 3] != P[i, 3]:
            less = 1.0 - length / min(short, _length_of_side(pair, shapes, bench, by, int(P[k, 4])))
            rise = dot(m, sub(load3(P, i, 0), load3(P, k, 0)))  # by how much less deep the next point is
            share = clamp(0.5 - 0.5 * rise / (PARALLEL * length), 0.0, 1.0) if length > 0.0 else 0.5
            P[k, 5] += max(0.0, less * share)
            P[i, 5] += max(0.0, less * (1.0 - share))
    for k in range(count):
        P[k, 4] = max(0.0, 1.0 - P[k, 5])


@kernel
def _length_of_side(pair, shapes, bench, by, label):
    """Return the whole length of a side of which the clipped polygon has a part [m]; label and by as in `_meeting`."""
    second, start, loop = by
    if label >= 0:
        p, q = _ends(shapes, pair.a if second else pair.b, bench.vertices[0 if second else 1], label)
    else:
        V, k = bench.vertices[1 if second else 0], -1 - label
        p = load3(V, shapes.around[start + k, 0], 0)
        q = load3(V, shapes.around[start + (k + 1 if k + 1 < loop else 0), 0], 0)
    d = sub(q, p)
    return sqrt(dot(d, d))


@kernel
def _apart(P, k, i):
    d = sub(load3(P, k, 0), load3(P, i, 0))
    return sqrt(dot(d, d))


@kernel
def _share_corners(P, count, keep):
    """Lessen the depths of rows that share a corner, as much as `keep` says."""
    for k in range(count):
        P[k, 5] = lessened(P[k, 5], 1.0 - keep * (1.0 - P[k, 4]))


@kernel
def moved(P, Q, count):
    """Copy rows, which may be in their place."""
    for k in range(count):
        for x in range(5):
            Q[k, x] = P[k, x]
    return count


@kernel
def incident_rows(pair, shapes, bench, second, m):
    """Write the loop of a shape's face that looks against m most, of those at its lowest vertex; return its length."""
    shape = pair.b if second else pair.a
    V, P, first = bench.vertices[1 if second else 0], bench.rows[0], VERTEX if second else 0
    low, _ = lowest(V, shape.vertices, m)
    x, least, face = load3(V, low, 0), inf, -1
    for k in range(shape.faces):
        outward, offset = plane_of(pair, shapes, second, k)
        if dot(outward, m) < least and offset - dot(outward, x) <= SAME * pair.size:
            least, face = dot(outward, m), k
    if face < 0:
        for k in range(shape.vertices):
            write_row(P, k, load3(V, k, 0), float(first + k), 0.0)
        return shape.vertices
    start, loop = shapes.loops[shape.first_face + face]
    for k in range(loop):
        vertex, side = shapes.around[start + k]
        write_row(P, k, load3(V, vertex, 0), float(first + vertex), float(side))
    return loop


@kernel
def _cut(pair, shapes, P, Q, count, plane, by):
    """Write what of the polygon P lies below a plane into Q; return the count of its rows.

    plane: (outward unit normal, distance [m]); by: what `_meeting` takes.  A row within rounding of the plane stays.
    """
    w, offset = plane
    slack, made = SAME * pair.size, 0
    for k in range(count):
        i = k + 1 if k + 1 < count else 0
        p, q = load3(P, k, 0), load3(P, i, 0)
        here, there = dot(w, p) - offset, dot(w, q) - offset
        if here <= slack:
            leaves = there > slack and not here < -slack
            write_row(Q, made, p, P[k, 3], -1.0 - by[3] if leaves else P[k, 4])
            made += 1
        if (here < -slack and there > slack) or (there < -slack and here > slack):
            x = add(p, scale(sub(q, p), here / (here - there)))
            label = -1.0 - by[3] if there > slack else P[k, 4]
            write_row(Q, made, x, _meeting(shapes, int(P[k, 4]), by), label)
            made += 1
    return made


@kernel
def _meeting(shapes, label, by):
    """Return the feature of the point where a side of the polygon meets the plane through a side of the face.

    label: the number of a side of the incident face, or -1 - k where the plane k has cut before; by: (whether the face
    is the second shape's, its first row in `around`, its length, the number of the side in it).
    """
    second, start, loop, k = by
    if label >= 0:
        side = shapes.around[start + k, 1]
        return float(SIDES + (128 * label + side if second else 128 * side + label))
    other = -1 - label
    first = VERTEX if second else 0
    if other + 1 == k or (other + 1 == loop and k == 0):
        return float(first + shapes.around[start + k, 0])
    if k + 1 == other or (k + 1 == loop and other == 0):
        return float(first + shapes.around[start + other, 0])
    return float(ODD + 128 * other + k)
