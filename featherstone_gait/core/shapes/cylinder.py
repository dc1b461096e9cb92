"""Contact of cylinders with polytopes and with each other.

A face or an end is tried first: if the deepest point of the other shape lies over it, it is where they touch.  Else the
direction is that of the nearest points.  Where the cores overlap, the best of some candidates is improved: moved apart
along it, the cores have nearest points, whose direction overlaps no more; the next direction errs by the depth over the
radius of curvature times as much (compare Y. J. Kim, M. C. Lin, D. Manocha, "Incremental penetration depth estimation
between convex polytopes using dual-space expansion", IEEE Trans. Visualization and Computer Graphics 10 (2004)).
"""

from math import inf, sqrt

from ..compile.jit import kernel
from ..compile.optional import if_present
from ..tree.spatial import add, cross, dot, load3, scale, sub, vector
from .closest import closest_on_lines, common_part, difference_towards, nearest_points, put_lines
from .distance import CYLINDER, SEGMENT, column
from .patch import (
    NEAREST,
    PARALLEL,
    SAME,
    SIDES,
    VERTEX,
    aligned,
    deepest_row,
    fade,
    keep_deep,
    lay_vertices,
    lowest,
    plane_of,
    put_nearest,
    put_rows,
    unit,
    with_nearest,
    write_row,
)
from .polytope import incident_rows, line_of, moved, side_height

STANDING = 1e-5  # sine of a cylinder's tilt below which its rim points turn towards axes of its own
EDGE_ON = 0.05  # cosine of the angle of an end and a face beyond which their borders do not cross
PASSES = 20  # at most, of better directions
APART = 1e-3  # of the sizes: as far cores are moved apart to compare directions
RIM = 2 * VERTEX  # feature: + 8 if it is of the second shape + 4 at the upper end + quarter
CROSSING = 8  # feature of a rim on a side of a face, or + 1, beside the side's; + 4 of the line along a cylinder


@kernel
def rim_rows(pair, P, count, second, end, m):
    """Add four points of a rim (0 lower end, 1 upper) of a cylinder to the rows; return their count.

    The first is the lowest along m, the others follow by quarters.  Four points of equal springs resist tilting about
    every axis alike, so that the forces are the same wherever the first one is.  A cylinder that stands has no lowest
    point: the four turn into its own axes as its tilt falls below `STANDING`, and their features are those of the axes.
    """
    (x, y, top), disc = _frame(pair, second, end), _disc(pair, second)
    p, q = -dot(m, x), -dot(m, y)
    sine = sqrt(p * p + q * q)
    share = min(1.0, sine / STANDING)
    quarter = (0 if p >= 0.0 else 2) if abs(p) >= abs(q) else (1 if q >= 0.0 else 3)
    f, g = 1.0, 0.0
    if sine > 0.0:
        f = (1.0 - share) * (1.0 if quarter == 0 else -1.0 if quarter == 2 else 0.0) + share * (p / sine)
        g = (1.0 - share) * (1.0 if quarter == 1 else -1.0 if quarter == 3 else 0.0) + share * (q / sine)
        length = sqrt(f * f + g * g)
        f, g = f / length, g / length
    first = RIM + (8 if second else 0) + 4 * end
    for k in range(4):
        at = add(top, add(scale(x, disc * f), scale(y, disc * g)))
        write_row(P, count + k, at, float(first + ((0 if share >= 1.0 else quarter) + k) % 4), 0.0)
        f, g = -g, f
    return count + 4


@kernel
def _frame(pair, second, end):
    """Return a cylinder's x and y axes, and the center of an end [m]."""
    h = 1.0 if end else -1.0
    if second:
        return column(pair.R, 0), column(pair.R, 1), add(pair.c, scale(column(pair.R, 2), h * pair.b.half[2]))
    return (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, h * pair.a.half[2])


@kernel
def _disc(pair, second):
    """Return the radius of a cylinder [m]."""
    return pair.b.disc if second else pair.a.disc


@kernel
def _axis(pair, second):
    """Return the axis of a cylinder."""
    return column(pair.R, 2) if second else (0.0, 0.0, 1.0)


@if_present(0)
def cylinder_points(ends, pair, shapes, bench, out):
    """Fill out with the contact points of a polytope or a cylinder, and a cylinder; return their count.

    ends: that of the bench.
    """
    lay_vertices(pair, shapes, bench)
    most, slack = pair.radii + pair.margin, SAME * pair.size
    sa, fa = _best_face(pair, shapes, bench, False)
    if sa > most:
        return 0
    sb, fb = _best_face(pair, shapes, bench, True)
    if sb > most:
        return 0
    if pair.a.kind == CYLINDER or pair.a.kind == SEGMENT:
        sides, n = _gap_of_sides(pair, shapes)
        if sides > most:
            return 0
        if sides >= max(sa, sb):
            line, other = _surface_line(pair, False, n), _surface_line(pair, True, n)
            return put_lines(pair, out, line, other, n, SIDES + CROSSING + 4, pair.size)
    second = sb > sa + slack
    gap, face = (sb, fb) if second else (sa, fa)
    m, offset = _face(pair, shapes, second, face)
    n, P = (m if second else scale(m, -1.0)), bench.rows[0]
    count = _face_rows(pair, shapes, bench, second, face, m)
    count = keep_deep(pair, P, count, m, offset, 1.0)
    at = deepest_row(P, count)
    over = at >= 0 and P[at, 5] >= pair.radii - gap - slack
    if over and gap > 0.0:
        return put_rows(pair, out, P, count, n, second)
    if not over:
        v, xa = nearest_points(pair, pair.c, shapes.corners, bench)
        apart = sqrt(dot(v, v))
        if apart > most:
            return 0
        if apart > 0.0 or gap > 0.0:
            return _along(pair, shapes, bench, out, unit(v, n), xa, apart)
    other, u = _other_directions(pair, shapes, gap, n)
    if over and not other > gap + slack:
        return put_rows(pair, out, P, count, n, second)
    n, gap, xa = _improved(pair, shapes, bench, n, gap)
    n, gap, xa = _deeper(n, gap, xa, _improved(pair, shapes, bench, u, other))
    u = unit(scale(pair.c, -1.0), n)
    n, gap, xa = _deeper(n, gap, xa, _improved(pair, shapes, bench, u, _gap_along(pair, shapes, u)))
    return _along(pair, shapes, bench, out, n, xa, gap)


@kernel
def _gap_of_sides(pair, shapes):
    """Return the gap of two round sides along the line between their axes [m], and n; -inf where ends are closer."""
    line, other = ((0.0, 0.0, 0.0), _axis(pair, False), pair.a.half[2]), (pair.c, _axis(pair, True), pair.b.half[2])
    s, t, sine = closest_on_lines(line, other)
    low, high = common_part(line, other)
    v = sub(scale(line[1], s), add(pair.c, scale(other[1], t)))
    beside = high > low if sine <= PARALLEL else abs(s) < line[2] and abs(t) < other[2]
    if not beside or dot(v, v) <= (SAME * pair.size) ** 2:
        return -inf, v
    n = unit(v, v)
    return _gap_along(pair, shapes, n), n


@kernel
def _deeper(n, gap, xa, other):
    """Return the one of two directions along which the gap is larger."""
    return other if other[1] > gap else (n, gap, xa)


@kernel
def _face(pair, shapes, second, face):
    """Return the outward normal of a face or an end of either shape, and its distance from the origin [m]."""
    shape = pair.b if second else pair.a
    if shape.kind != CYLINDER:
        return plane_of(pair, shapes, second, face)
    m = scale(_axis(pair, second), 1.0 if face else -1.0)
    return m, shape.half[2] + (dot(m, pair.c) if second else 0.0)


@kernel
def _lowest(pair, bench, second, m):
    """Return the least height of a shape along m [m]."""
    shape = pair.b if second else pair.a
    if shape.kind != CYLINDER:
        _, height = lowest(bench.vertices[1 if second else 0], shape.vertices, m)
        return height
    x, y, _ = _frame(pair, second, 0)
    p, q = dot(m, x), dot(m, y)
    middle = dot(m, pair.c) if second else 0.0
    return middle - (shape.half[2] * abs(dot(m, _axis(pair, second))) + shape.disc * sqrt(p * p + q * q))


@kernel
def _best_face(pair, shapes, bench, second):
    """Return the largest gap over a face or an end of a shape [m] and which one; -inf and -1 if it has none."""
    shape = pair.b if second else pair.a
    best, at = -inf, -1
    for k in range(2 if shape.kind == CYLINDER else shape.faces):
        m, offset = _face(pair, shapes, second, k)
        gap = _lowest(pair, bench, not second, m) - offset
        if gap > best:
            best, at = gap, k
    return best, at


@kernel
def _face_rows(pair, shapes, bench, second, face, m):
    """Write where the other shape lies over a face or an end into the rows; return their count."""
    if second and pair.a.kind != CYLINDER:
        return _polytope_over_end(pair, shapes, bench, face, m)
    if second or pair.a.kind == CYLINDER:
        return _cylinder_over_end(pair, bench, second, face, m)
    return _cylinder_over_face(pair, shapes, bench, face, m)


@kernel
def _cylinder_over_face(pair, shapes, bench, face, m):
    """Write the rim points and the line of the second shape that lie over a face of the first, and their crossings."""
    P, V = bench.rows[0], bench.vertices[0]
    v = column(pair.R, 2)
    end = 0 if dot(m, v) > 0.0 else 1
    rims = rim_rows(pair, P, rim_rows(pair, P, 0, True, end, m), True, 1 - end, m)
    first, last = load3(P, 0, 0), load3(P, rims - 4, 0)
    upper, slack, d = P[rims - 4, 3], SAME * pair.size, sub(last, first)
    start, loop = shapes.loops[pair.a.first_face + face]
    low, high, entering, leaving = 0.0, 1.0, P[0, 3], upper
    for k in range(loop):
        p = load3(V, shapes.around[start + k, 0], 0)
        w = cross(sub(load3(V, shapes.around[start + (k + 1 if k + 1 < loop else 0), 0], 0), p), m)
        if dot(w, w) > slack * slack:
            w = scale(w, 1.0 / sqrt(dot(w, w)))
            side = float(SIDES + 128 * shapes.around[start + k, 1] + CROSSING + 4)
            for j in range(4):
                P[j, 4] += 1.0 if dot(w, sub(load3(P, j, 0), p)) > slack else 0.0
            here, there = dot(w, sub(first, p)), dot(w, sub(last, p))
            if here > slack and there > slack:
                high = -1.0
            elif here > slack and here / (here - there) > low:
                low, entering = here / (here - there), side
            elif there > slack and here / (here - there) < high:
                high, leaving = here / (here - there), side
    count = 0
    for j in range(4):
        if P[j, 4] == 0.0:
            write_row(P, count, load3(P, j, 0), P[j, 3], 0.0)
            count += 1
    if low < high:
        write_row(P, count, add(first, scale(d, low)), entering, 0.0)
        write_row(P, count + 1, add(first, scale(d, high)), leaving, 0.0)
        count += 2
    if abs(dot(m, v)) > EDGE_ON:
        _, _, top = _frame(pair, True, end)
        for k in range(loop):
            i, side = shapes.around[start + k]
            j = shapes.around[start + (k + 1 if k + 1 < loop else 0), 0]
            p, q = _onto(load3(V, i, 0), top, v, m), _onto(load3(V, j, 0), top, v, m)
            count = _round_rows(P, count, (p, q), (top, v, pair.b.disc), float(i), float(SIDES + 128 * side + CROSSING))
    return count


@kernel
def _onto(p, center, v, m):
    """Move a point along m into the plane through a center across v."""
    return add(p, scale(m, dot(v, sub(center, p)) / dot(v, m)))


@kernel
def _round_rows(P, count, line, circle, vertex, crossing):
    """Add the start of a line if it lies in a circle, and where the line crosses it; return the count of rows.

    line: its ends (3), (3) [m]; circle: (center (3) [m], unit axis (3), radius [m]), along whose axis lengths do not
    count; vertex, crossing: their features.
    """
    (p, q), (center, v, radius) = line, circle
    d, u = sub(q, p), sub(p, center)
    along, off = sub(d, scale(v, dot(v, d))), sub(u, scale(v, dot(v, u)))
    A, B, C = dot(along, along), dot(along, off), dot(off, off) - radius * radius
    if C <= 0.0:
        write_row(P, count, p, vertex, 0.0)
        count += 1
    square = B * B - A * C
    if A > 0.0 and square > 0.0:
        root = sqrt(square)
        for k in range(2):
            t = (-B + (root if k else -root)) / A
            if 0.0 < t < 1.0:
                write_row(P, count, add(p, scale(d, t)), crossing + k, 0.0)
                count += 1
    return count


@kernel
def _polytope_over_end(pair, shapes, bench, end, m):
    """Write the vertices of the first shape's lowest face that lie over an end of the second, and their crossings."""
    P, Q = bench.rows[0], bench.rows[1]
    loop = moved(P, Q, incident_rows(pair, shapes, bench, False, m))
    _, _, top = _frame(pair, True, end)
    circle, count = (top, m, pair.b.disc), 0
    for k in range(loop):
        i = k + 1 if k + 1 < loop else 0
        line = load3(Q, k, 0), load3(Q, i, 0)
        count = _round_rows(P, count, line, circle, Q[k, 3], SIDES + 128.0 * Q[k, 4] + CROSSING)
    return count


@kernel
def _cylinder_over_end(pair, bench, second, face, m):
    """Write where the other cylinder lies over an end of one: four ends of what two ends share, or a line's two."""
    P, Q = bench.rows[0], bench.rows[1]
    (_, _, center), radius = _frame(pair, second, face), _disc(pair, second)
    v = _axis(pair, not second)
    end = 0 if dot(m, v) > 0.0 else 1
    rims = rim_rows(pair, Q, rim_rows(pair, Q, 0, not second, end, m), not second, 1 - end, m)
    (_, _, top), disc = _frame(pair, not second, end), _disc(pair, not second)
    count, line = 0, (load3(Q, 0, 0), load3(Q, rims - 4, 0))
    count = _round_rows(P, count, line, (center, m, radius), Q[0, 3], float(SIDES + CROSSING + 4))
    count = _round_rows(P, count, (line[1], line[1]), (center, m, radius), Q[rims - 4, 3], 0.0)
    d = sub(top, center)
    d = sub(d, scale(m, dot(m, d)))
    off = sqrt(dot(d, d))
    low, high = max(-radius, off - disc), min(radius, off + disc)
    if abs(dot(m, v)) < 0.5 or low > high:
        return count
    middle = add(top, scale(unit(d, d), 0.5 * (low + high) - off))
    for k in range(4):
        w = scale(sub(load3(Q, k, 0), top), 1.0 / disc)
        reach = min(_exit(middle, w, (top, v, disc)), _exit(middle, w, (center, m, radius)))
        write_row(P, count, add(middle, scale(w, reach)), Q[k, 3], 0.0)
        count += 1
    return count


@kernel
def _exit(p, w, circle):
    """Return how far a point p in a circle is from it along w [m]; circle as in `_round_rows`."""
    center, v, radius = circle
    u = sub(p, center)
    along, off = sub(w, scale(v, dot(v, w))), sub(u, scale(v, dot(v, u)))
    A, B, C = dot(along, along), dot(along, off), dot(off, off) - radius * radius
    return (-B + sqrt(max(B * B - A * C, 0.0))) / A


@kernel
def _gap_along(pair, shapes, n):
    """Return the gap of two cores along n [m], negative where they overlap."""
    _, w = difference_towards(pair, pair.c, shapes.corners, scale(n, -1.0))
    return dot(n, w)


@kernel
def _better(pair, shapes, u, gap, n):
    """Return the larger of the gap along n and those along u and -u [m], and its direction."""
    if dot(u, u) > 1e-24 * pair.size * pair.size:
        u = unit(u, n)
        for _ in range(2):
            there = _gap_along(pair, shapes, u)
            if there > gap + SAME * pair.size:
                gap, n = there, u
            u = scale(u, -1.0)
    return gap, n


@kernel
def _other_directions(pair, shapes, gap, n):
    """Return the largest gap and its direction among that of a face and others: of centers, and across the axes."""
    v, c = column(pair.R, 2), pair.c
    gap, n = _better(pair, shapes, c, gap, n)
    gap, n = _better(pair, shapes, sub(c, scale(v, dot(v, c))), gap, n)
    if pair.a.kind == CYLINDER:
        gap, n = _better(pair, shapes, (c[0], c[1], 0.0), gap, n)
        return _better(pair, shapes, scale((v[1], -v[0], 0.0), pair.size), gap, n)
    for k in range(pair.a.sides):
        i, j = shapes.sides[pair.a.first_side + k, 0], shapes.sides[pair.a.first_side + k, 1]
        p, q = vector(shapes.corners[pair.a.first_vertex + i]), vector(shapes.corners[pair.a.first_vertex + j])
        gap, n = _better(pair, shapes, cross(sub(q, p), v), gap, n)
    return gap, n


@kernel
def _improved(pair, shapes, bench, n, gap):
    """Return a direction in which overlapping cores part at least as soon, the gap along it, and a point of the first.

    n, gap: one to begin with.
    """
    xa = (0.0, 0.0, 0.0)
    for _ in range(PASSES):
        v, xa = nearest_points(pair, sub(pair.c, scale(n, APART * pair.size - gap)), shapes.corners, bench)
        u = unit(v, n)
        there = _gap_along(pair, shapes, u)
        if not there > gap + 1e-15 * pair.size:
            break
        n, gap = u, there
    return n, gap, xa


@kernel
def _along(pair, shapes, bench, out, n, xa, gap):
    """Give out the contact along n: over a face or an end within `PARALLEL` of it, of two lines, or one point."""
    best, face, second = sqrt(1.0 - PARALLEL * PARALLEL), -1, False
    for which in range(2):
        shape = pair.b if which else pair.a
        for k in range(2 if shape.kind == CYLINDER else shape.faces):
            m, _ = _face(pair, shapes, which == 1, k)
            slope = dot(m, n) if which else -dot(m, n)
            if slope > best:
                best, face, second = slope, k, which == 1
    if face >= 0:
        m, offset = _face(pair, shapes, second, face)
        P, count = bench.rows[0], _face_rows(pair, shapes, bench, second, face, m)
        count = keep_deep(pair, P, count, m, offset, best)
        count = with_nearest(pair, P, count, xa if second else sub(xa, scale(n, gap)), gap)
        fade(P, count, aligned(m, n))
        return put_rows(pair, out, P, count, n, second)
    found, line, side = _side_line(pair, shapes, bench, n)
    if found:
        feature = SIDES + 128 * side + CROSSING + 4
        return put_lines(pair, out, line, _surface_line(pair, True, n), n, feature, pair.size)
    return put_nearest(pair, out, 0, xa, n, gap, NEAREST)


@kernel
def _surface_line(pair, second, n):
    """Return the line along a cylinder that looks towards the other shape."""
    v = _axis(pair, second)
    shape, middle, u = (pair.b, pair.c, n) if second else (pair.a, (0.0, 0.0, 0.0), scale(n, -1.0))
    e = unit(sub(u, scale(v, dot(v, u))), v)
    return add(middle, scale(e, shape.disc)), v, shape.half[2]


@kernel
def _side_line(pair, shapes, bench, n):
    """Return whether a line of the first shape touches the second's side along n, the line, and its number."""
    v = column(pair.R, 2)
    line, at, found = ((0.0, 0.0, 0.0), v, 0.0), 0, False
    if abs(dot(n, v)) > PARALLEL:
        return found, line, at
    best = sqrt(1.0 - PARALLEL * PARALLEL)
    if pair.a.kind == CYLINDER:
        line = _surface_line(pair, False, n)
        return abs(dot(line[1], v)) > best, line, at
    _, low = lowest(bench.vertices[0], pair.a.vertices, n)
    for k in range(pair.a.sides):
        each = line_of(shapes, pair.a, bench.vertices[0], k)
        if side_height(each, n) - low <= 2.0 * PARALLEL * each[2] and abs(dot(each[1], v)) > best:
            best, line, at, found = abs(dot(each[1], v)), each, k, True
    return found, line, at
