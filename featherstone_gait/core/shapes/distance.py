"""Distance between convex shapes, and the least of many pairs.

A shape is the sum of a core and a ball: of a point, a segment or a box, of a disc about z, and of a sphere's radius; or
it is the hull of corners.  Distances of cores are those of E. G. Gilbert, D. W. Johnson, S. S. Keerthi, "A fast
procedure for computing the distance between complex objects in three-dimensional space", IEEE J. Robotics and
Automation 4 (1988).  The nearest point of its simplex is sought among the faces of all dimensions, at most 15: slower
than taking the simplex apart by signs, but there is no flat simplex that it takes the wrong way.

Where cores overlap, the depth is the least overlap along candidates of the direction in which they part: face normals,
products of edges, and the line of centers with its parts across the axes.  Of polytopes, segments and points the first
two are all that can be least (C. Ericson, "Real-Time Collision Detection", Elsevier 2005, section 5.2.1); of cylinders
the depth so found is at least the true one.
"""

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from ..compile.jit import entry, kernel
from ..compile.structure import record, structure
from ..tree.spatial import add, cross, dot, load3, load9, rotate, rotate_back, scale, store3, sub, vector

SHAPE = record(
    link=int,  # index of the link that carries it
    first=int,  # of its corners; it has none unless it is a hull
    corners=int,
    first_normal=int,  # of its faces; a box has none in the table
    normals=int,
    first_edge=int,  # of the directions of its edges, likewise
    edges=int,
    E=(float, 9),  # rotation shape -> link, row by row
    r=(float, 3),  # center in the link's frame [m]
    half=(float, 3),  # half edges of the box in the core [m]
    disc=float,  # radius of the disc about z in the core [m]
    radius=float,  # of the ball [m]
    bound=float,  # radius of a sphere about the center that holds all of the shape [m]; inf of a half space
    extent=(float, 3),  # of a box about the center, in the shape's axes, that holds all of the shape: half edges [m]
    kind=int,  # one of those below
    first_vertex=int,  # of a point, segment, box or hull, among the corners
    vertices=int,
    first_face=int,
    faces=int,
    first_side=int,  # of its edges from vertex to vertex
    sides=int,
    first_node=int,  # of a height field, among the heights
    nodes=(int, 2),  # along x and y
    spacing=(float, 2),  # of the nodes [m]
)
# The core; a half space is what lies below z = 0, a height field what lies below triangles between nodes.
POINT, SEGMENT, BOX, HULL, CYLINDER, HALF_SPACE, FIELD = range(7)


@structure
class Shapes(NamedTuple):
    """The shapes of a robot."""

    table: np.ndarray  # (shapes,) SHAPE
    corners: np.ndarray  # (all, 3) of the hulls and vertices of the others, about the center of each, in its axes [m]
    normals: np.ndarray  # (all, 3) of the faces of the hulls
    edges: np.ndarray  # (all, 3) directions of the edges of the hulls
    planes: np.ndarray  # (all, 4) outward unit normal of each face and its distance from the center [m]
    loops: np.ndarray  # (all, 2) of each face: its first row in `around`, and how many it has
    around: np.ndarray  # (all, 2) vertices of a face, counterclockwise from outside, and the side from each to the next
    sides: np.ndarray  # (all, 4) two vertices of each, the face that goes from one to the other, and back; or -1
    heights: np.ndarray  # (all,) of the nodes of height fields, row by row along x, about the center of each [m]


@structure
class Room(NamedTuple):
    """Scratch arrays, which each call overwrites."""

    E: np.ndarray  # (shapes, 9) rotations shape -> world
    r: np.ndarray  # (shapes, 3) centers in the world [m]
    simplex: np.ndarray  # (4, 3) [m]


PASSES = 100  # at most; polytopes take some ten, cylinders some thirty
GAP = 1e-15  # relative difference of the bounds of the squared distance at which it is known
TOUCH = 1e-12  # cores closer than this, relative to their sizes, overlap
LEAST_SQUARE = 1e-24  # of a direction's length; shorter ones are none


@kernel
def support(shape, corners, u):
    """Return the core's farthest point (3) in a direction u (3), both in the shape's frame [m]."""
    if shape.corners > 0:
        best = shape.first
        most = dot(vector(corners[best]), u)
        for k in range(shape.first + 1, shape.first + shape.corners):
            height = dot(vector(corners[k]), u)
            if height > most:
                most, best = height, k
        return vector(corners[best])
    x = shape.half[0] if u[0] >= 0.0 else -shape.half[0]
    y = shape.half[1] if u[1] >= 0.0 else -shape.half[1]
    z = shape.half[2] if u[2] >= 0.0 else -shape.half[2]
    across = sqrt(u[0] * u[0] + u[1] * u[1])
    if shape.disc > 0.0 and across > 0.0:
        return (x + shape.disc * (u[0] / across), y + shape.disc * (u[1] / across), z)
    return (x, y, z)


@kernel
def difference(a, b, Ea, Eb, c, corners, u):
    """Return the farthest point of core a less core b in the direction u; c from a's center to b's, world axes."""
    pa = rotate(Ea, support(a, corners, rotate_back(Ea, u)))
    pb = rotate(Eb, support(b, corners, rotate_back(Eb, scale(u, -1.0))))
    return sub(sub(pa, pb), c)


@kernel
def on_edge(p, q):
    """Return the weight of the point of an edge nearest to the origin, and whether it lies between the ends."""
    d = sub(q, p)
    length = dot(d, d)
    if not length > 0.0:
        return 0.0, False
    t = -dot(p, d) / length
    return t, 0.0 < t < 1.0


@kernel
def _inside(p, q, r, s):
    """Return whether the origin lies in a tetrahedron."""
    d, e, f = sub(q, p), sub(r, p), sub(s, p)
    volume = dot(d, cross(e, f))
    if volume == 0.0:
        return False
    x = -dot(p, cross(e, f)) / volume
    y = -dot(p, cross(f, d)) / volume
    z = -dot(p, cross(d, e)) / volume
    return x >= 0.0 and y >= 0.0 and z >= 0.0 and x + y + z <= 1.0


@kernel
def nearest_in_simplex(S, count):
    """Return the point (3) of the simplex S (count of 4 rows) nearest to the origin, and its rows, as bits."""
    v, least, used = (0.0, 0.0, 0.0), inf, 0
    for i in range(count):
        p = vector(S[i])
        if dot(p, p) < least:
            v, least, used = p, dot(p, p), 1 << i
    for i in range(count):
        for j in range(i + 1, count):
            t, between = on_edge(vector(S[i]), vector(S[j]))
            p = add(vector(S[i]), scale(sub(vector(S[j]), vector(S[i])), t))
            if between and dot(p, p) < least:
                v, least, used = p, dot(p, p), (1 << i) | (1 << j)
    for k in range(count if count >= 3 else 0):
        if count == 4 or k == 0:
            v, least, used = _nearer_face(S, k if count == 4 else 3, v, least, used)
    if count == 4 and _inside(vector(S[0]), vector(S[1]), vector(S[2]), vector(S[3])):
        v, used = (0.0, 0.0, 0.0), 15
    return v, used


@kernel
def _nearer_face(S, without, v, least, used):
    """Return the better of the point found so far and that of the face of all rows but one."""
    i = 1 if without == 0 else 0
    j = 2 if without <= 1 else 1
    k = 3 if without <= 2 else 2
    p = vector(S[i])
    d, e = sub(vector(S[j]), p), sub(vector(S[k]), p)
    n = cross(d, e)
    area = dot(n, n)
    if area > 0.0:
        s, t = -dot(cross(p, e), n) / area, -dot(cross(d, p), n) / area
        p = add(p, add(scale(d, s), scale(e, t)))
        if s > 0.0 and t > 0.0 and s + t < 1.0 and dot(p, p) < least:
            return p, dot(p, p), (1 << i) | (1 << j) | (1 << k)
    return v, least, used


@kernel
def keep_rows(S, used):
    """Move the rows of S that are used to its beginning; return how many they are."""
    count = 0
    for i in range(4):
        if used >> i & 1:
            store3(S, count, 0, load3(S, i, 0))
            count += 1
    return count


@kernel
def core_distance(a, b, Ea, Eb, c, corners, S):
    """Return the distance of two cores [m], 0 where they overlap; S (4, 3) is overwritten.

    Ea, Eb: rotations shape -> world; c: from the center of a to that of b, world axes [m].
    """
    size = a.bound + b.bound
    v = difference(a, b, Ea, Eb, c, corners, c)
    store3(S, 0, 0, v)
    count = 1
    for _ in range(PASSES):
        square = dot(v, v)
        if count == 4 or square <= (TOUCH * size) ** 2:
            return 0.0
        w = difference(a, b, Ea, Eb, c, corners, scale(v, -1.0))
        if square - dot(v, w) <= GAP * square:
            break
        store3(S, count, 0, w)
        nearer, used = nearest_in_simplex(S, count + 1)
        if not (dot(nearer, nearer) < square):
            break
        v, count = nearer, keep_rows(S, used)
    return sqrt(dot(v, v))


@kernel
def overlap(a, b, Ea, Eb, c, corners, u):
    """Return the lesser overlap of cores a and b along u or -u [m]; inf if u is no direction."""
    square = dot(u, u)
    if not square > LEAST_SQUARE:
        return inf
    u = scale(u, 1.0 / sqrt(square))
    back = scale(u, -1.0)
    there = dot(difference(a, b, Ea, Eb, c, corners, u), u)
    return min(there, dot(difference(a, b, Ea, Eb, c, corners, back), back))


@kernel
def column(E, k):
    """Return axis k of a rotation."""
    return (E[k], E[3 + k], E[6 + k])


@kernel
def _direction(E, directions, first, count, k):
    """Return direction k of a hull's faces or edges, world axes; of other shapes an axis of the frame."""
    return rotate(E, vector(directions[first + k])) if count > 0 else column(E, k)


@kernel
def core_depth(a, b, Ea, Eb, c, shapes, enough):
    """Return the depth by which two cores overlap [m], that is, how far they must move to part.

    Of discs it is at least that.  A result that is not above `enough` may be any other that is not.
    """
    corners, normals, edges = shapes.corners, shapes.normals, shapes.edges
    p, q = column(Ea, 2), column(Eb, 2)
    least = overlap(a, b, Ea, Eb, c, corners, c)
    least = min(least, overlap(a, b, Ea, Eb, c, corners, sub(c, scale(p, dot(p, c)))))
    least = min(least, overlap(a, b, Ea, Eb, c, corners, sub(c, scale(q, dot(q, c)))))
    for k in range(a.normals if a.normals > 0 else 3):
        u = _direction(Ea, normals, a.first_normal, a.normals, k)
        least = min(least, overlap(a, b, Ea, Eb, c, corners, u))
    for k in range(b.normals if b.normals > 0 else 3):
        u = _direction(Eb, normals, b.first_normal, b.normals, k)
        least = min(least, overlap(a, b, Ea, Eb, c, corners, u))
    for i in range(a.edges if a.edges > 0 else 3):
        if least <= enough:
            break
        u = _direction(Ea, edges, a.first_edge, a.edges, i)
        for j in range(b.edges if b.edges > 0 else 3):
            v = _direction(Eb, edges, b.first_edge, b.edges, j)
            least = min(least, overlap(a, b, Ea, Eb, c, corners, cross(u, v)))
    return max(least, 0.0)


@kernel
def place(shapes, room, rotation, position):
    """Put all shapes where the rotations (links, 3, 3) and positions (links, 3) of the links have them."""
    for i in range(len(shapes.table)):
        at = shapes.table[i]
        for x in range(3):
            row = vector(rotation[at.link, x])
            room.r[i, x] = position[at.link, x] + dot(row, vector(at.r))
            for y in range(3):
                room.E[i, 3 * x + y] = dot(row, column(at.E, y))


@kernel
def _distance(shapes, room, i, j, most):
    """Return the signed distance of shapes i and j where they have been placed [m], negative where they overlap.

    One that is not below `most` may be any other that is not.
    """
    a, b, Ea, Eb = shapes.table[i], shapes.table[j], load9(room.E, i, 0), load9(room.E, j, 0)
    c = sub(vector(room.r[j]), vector(room.r[i]))
    distance = core_distance(a, b, Ea, Eb, c, shapes.corners, room.simplex)
    if not distance > 0.0:
        distance = -core_depth(a, b, Ea, Eb, c, shapes, -most - a.radius - b.radius)
    return distance - a.radius - b.radius


@kernel
def _least(shapes, room, i, j):
    """Return a lower bound of the distance of shapes i and j, that of spheres around them [m]."""
    c = sub(vector(room.r[j]), vector(room.r[i]))
    return sqrt(dot(c, c)) - shapes.table[i].bound - shapes.table[j].bound


@entry
def pair_distances(shapes, room, pairs, rotation, position, out):
    """Fill out (pairs,) with the signed distance [m] of every pair (pairs, 2) of shapes in one posture.

    rotation (links, 3, 3) and position (links, 3) [m] of the links in the world.
    """
    place(shapes, room, rotation, position)
    for k in range(len(pairs)):
        out[k] = _distance(shapes, room, pairs[k, 0], pairs[k, 1], inf)


@entry
def least_distances(shapes, room, pairs, rotation, position, out, closest):
    """Fill out (n,) with the least signed distance [m] of pairs (p, 2) in each of n postures, `closest` with its row.

    rotation (n, links, 3, 3) and position (n, links, 3) [m] of the links in the world.
    """
    for n in range(len(out)):
        place(shapes, room, rotation[n], position[n])
        out[n] = inf
        for k in range(len(pairs)):
            i, j = pairs[k, 0], pairs[k, 1]
            if _least(shapes, room, i, j) < out[n]:
                d = _distance(shapes, room, i, j, out[n])
                if d < out[n]:
                    out[n] = d
                    closest[n] = k
