"""Contact manifolds: up to eight points at which two convex shapes touch, or will soon.

Spheres and capsules have the closest points, a half space the vertices, ends and rims that lie in it, polytopes
(polytope.py) and cylinders (cylinder.py) the ends of the patch in which they touch, and height fields
(field.py) corners, edges and nodes.
"""

from math import inf, sqrt

from ..compile.jit import entry, kernel
from ..compile.lanes import clamp
from ..tree.spatial import compose, cross, dot, load3, load9, rotate, rotate_back, scale, store3, sub, vector
from .closest import capsules
from .cylinder import cylinder_points, rim_rows
from .distance import BOX, CYLINDER, FIELD, HALF_SPACE, POINT, SEGMENT, TOUCH, column, place
from .field import field_points
from .patch import Pair, keep_deep, put_nearest, put_rows, unit, up, write_row
from .polytope import polytope_points


@kernel
def contact_points(a, b, pose_a, pose_b, shapes, margin, bench, out):
    """Fill out (8, 8) with the points where shapes a and b (SHAPE) touch; return their count.

    pose_a, pose_b: rotation shape -> common frame (9) and center in it (3) [m].  A row of out: position midway between
    the surfaces (3) [m], unit normal from b to a (3), depth [m], negative where there is a gap, and feature, a whole
    number below 2**20 that stays while the same features touch.  Points whose depth is above -margin [m] are given.
    """
    (Ea, ra), (Eb, rb) = pose_a, pose_b
    if a.kind == POINT and b.kind == POINT:
        return _spheres(a, b, ra, rb, margin, out)
    swapped = a.kind > b.kind
    p, q, E, F = (b, a, Eb, Ea) if swapped else (a, b, Ea, Eb)
    r, s = (rb, ra) if swapped else (ra, rb)
    d = sub(s, r)
    reach = p.bound + q.bound + margin
    if not dot(d, d) <= reach * reach:
        return 0
    back = (E[0], E[3], E[6], E[1], E[4], E[7], E[2], E[5], E[8])
    R, side = compose(back, F), -1.0 if swapped else 1.0
    size = p.bound if q.kind == HALF_SPACE else p.bound + q.bound
    pair = Pair(p, q, R, rotate(back, d), E, r, side, margin, p.radius + q.radius, size)
    return _points(pair, shapes, bench, out)


@kernel
def _points(pair, shapes, bench, out):
    """Choose by the kinds of the shapes, of which the first's is not the greater."""
    a, b = pair.a.kind, pair.b.kind
    if b == HALF_SPACE:
        return _over_half_space(pair, shapes, bench, out)
    if b == FIELD:
        return field_points(bench.field, pair, shapes, bench, out)
    if a == POINT:
        return _sphere(pair, shapes, out)
    if b == CYLINDER:
        return cylinder_points(bench.ends, pair, shapes, bench, out)
    if b == SEGMENT:
        return capsules(pair, out)
    return polytope_points(bench.near, pair, shapes, bench, out)


@kernel
def _spheres(a, b, ra, rb, margin, out):
    """Give out the contact of two spheres, which needs no frame."""
    d = sub(ra, rb)
    distance = sqrt(dot(d, d))
    depth = a.radius + b.radius - distance
    if not depth > -margin:
        return 0
    n = unit(d, (0.0, 0.0, 1.0))
    store3(out, 0, 0, sub(ra, scale(n, a.radius - 0.5 * depth)))
    store3(out, 0, 3, n)
    out[0, 6] = depth
    out[0, 7] = 0.0
    return 1


@kernel
def _over_half_space(pair, shapes, bench, out):
    """Give out what lies lowest over a plane: vertices, or points of rims."""
    m = column(pair.R, 2)
    offset, P, count = dot(m, pair.c), bench.rows[0], 0
    if pair.a.kind == CYLINDER:
        for end in range(1 if pair.a.half[2] > 0.0 else 0, -1, -1):
            count = rim_rows(pair, P, count, False, end, m)
    elif pair.a.kind != HALF_SPACE:
        count = pair.a.vertices
        for k in range(count):
            write_row(P, k, vector(shapes.corners[pair.a.first_vertex + k]), float(k), 0.0)
    count = keep_deep(pair, P, count, m, offset, 1.0)
    return put_rows(pair, out, P, count, m, True)


@kernel
def _sphere(pair, shapes, out):
    """Give out the contact of a sphere with what is no sphere: one point, whose feature stays wherever it rolls."""
    p, b = rotate_back(pair.R, scale(pair.c, -1.0)), pair.b
    touch = TOUCH * pair.size
    if b.kind == SEGMENT:
        v = (p[0], p[1], p[2] - clamp(p[2], -b.half[2], b.half[2]))
        n, gap = _direction(v, touch, rotate_back(pair.R, up(pair)), 0.0)
    elif b.kind == BOX:
        n, gap = _from_box(p, b.half, touch)
    elif b.kind == CYLINDER:
        n, gap = _from_cylinder(p, b.disc, b.half[2], touch)
    else:
        n, gap = _from_hull(p, b, shapes, touch, rotate_back(pair.R, up(pair)))
    return put_nearest(pair, out, 0, (0.0, 0.0, 0.0), rotate(pair.R, n), gap, 0.0)


@kernel
def _direction(v, touch, inside, gap):
    """Return the direction of v and its length, or the direction and the gap of a point inside if it has none."""
    square = dot(v, v)
    if square > touch * touch:
        length = sqrt(square)
        return scale(v, 1.0 / length), length
    return inside, gap


@kernel
def _from_box(p, half, touch):
    """Return the normal of a box towards a point p, box axes, and the gap [m]."""
    q = (clamp(p[0], -half[0], half[0]), clamp(p[1], -half[1], half[1]), clamp(p[2], -half[2], half[2]))
    x, y, z = abs(p[0]) - half[0], abs(p[1]) - half[1], abs(p[2]) - half[2]
    if z >= x and z >= y:
        n, gap = (0.0, 0.0, 1.0 if p[2] >= 0.0 else -1.0), z
    elif y >= x:
        n, gap = (0.0, 1.0 if p[1] >= 0.0 else -1.0, 0.0), y
    else:
        n, gap = (1.0 if p[0] >= 0.0 else -1.0, 0.0, 0.0), x
    return _direction(sub(p, q), touch, n, gap)


@kernel
def _from_cylinder(p, disc, half, touch):
    """Return the normal of a cylinder towards a point p, cylinder axes, and the gap [m]."""
    rho = sqrt(p[0] * p[0] + p[1] * p[1])
    e = (p[0] / rho, p[1] / rho) if rho > 0.0 else (1.0, 0.0)
    out, over, sign = rho - disc, abs(p[2]) - half, (1.0 if p[2] >= 0.0 else -1.0)
    n = (0.0, 0.0, sign) if over >= out else (e[0], e[1], 0.0)
    r, z = max(out, 0.0), max(over, 0.0) * sign
    return _direction((e[0] * r, e[1] * r, z), touch, n, max(over, out))


@kernel
def _from_hull(p, b, shapes, touch, instead):
    """Return the normal of a hull towards a point p, hull axes, and the gap [m]: of faces seen from p, or of edges."""
    n, inside = instead, -inf
    v, least = (0.0, 0.0, 0.0), inf
    for face in range(b.faces):
        m = vector(shapes.planes[b.first_face + face])
        height = dot(m, p) - shapes.planes[b.first_face + face, 3]
        if height > inside:
            n, inside = m, height
        if height >= 0.0:
            u, within = scale(m, height), True
            start, count = shapes.loops[b.first_face + face]
            for k in range(count):
                x = _corner(shapes, b, shapes.around[start + k, 0])
                y = _corner(shapes, b, shapes.around[start + (k + 1 if k + 1 < count else 0), 0])
                within = within and dot(cross(sub(y, x), m), sub(p, x)) <= 0.0
            if within and dot(u, u) < least:
                v, least = u, dot(u, u)
    for k in range(b.sides if inside > 0.0 or b.faces == 0 else 0):
        ends = shapes.sides[b.first_side + k]
        x = _corner(shapes, b, ends[0])
        d, u = sub(_corner(shapes, b, ends[1]), x), sub(p, x)
        u = sub(u, scale(d, clamp(dot(d, u) / dot(d, d), 0.0, 1.0)))
        if dot(u, u) < least:
            v, least = u, dot(u, u)
    if b.sides == 0:
        v = sub(p, _corner(shapes, b, 0))
    return _direction(v, touch, n, max(inside, -1e300) if b.faces > 0 else 0.0)


@kernel
def _corner(shapes, b, k):
    return vector(shapes.corners[b.first_vertex + k])


@entry
def contacts_at(shapes, i, j, poses, margin, bench, out):
    """Do as `contact_points` with rows i and j of the table; poses (2, 12): rotation and center of each."""
    a, b = (load9(poses, 0, 0), load3(poses, 0, 9)), (load9(poses, 1, 0), load3(poses, 1, 9))
    return contact_points(shapes.table[i], shapes.table[j], a, b, shapes, margin, bench, out)


@entry
def pair_contacts(shapes, room, bench, pairs, margin, poses, out, counts):
    """Fill out (pairs, 8, 8) and counts (pairs,) with the contact points of every pair (pairs, 2) of shapes.

    poses: rotation (links, 3, 3) and position (links, 3) [m] of the links in the world; points whose depth is above
    -margin [m] are given.
    """
    rotation, position = poses
    place(shapes, room, rotation, position)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        a, b = (load9(room.E, i, 0), load3(room.r, i, 0)), (load9(room.E, j, 0), load3(room.r, j, 0))
        counts[k] = contact_points(shapes.table[i], shapes.table[j], a, b, shapes, margin, bench, out[k])
