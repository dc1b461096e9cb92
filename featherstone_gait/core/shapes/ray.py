"""Distance along rays to the first shape.

A convex shape takes a piece of each ray: of a sphere between two roots, of a cylinder that of the endless one between
its ends, of a polytope what is behind all faces (T. Kay, J. Kajiya, "Ray tracing complex scenes", SIGGRAPH 1986).  A
capsule is a cylinder and two spheres.  One shape is met by all rays before the next: its loops have no branch on a ray,
and take eight rays at once.  A height field is followed from cell to cell (J. Amanatides, A. Woo, "A fast voxel
traversal algorithm for ray tracing", Eurographics 1987); over each of a cell's two triangles its height is linear
along the ray.
"""

from math import inf, sqrt

from ..compile.jit import entry, kernel
from ..tree.spatial import add, cross, dot, load9, scale, sub, vector
from .distance import BOX, CYLINDER, FIELD, HALF_SPACE, POINT, SEGMENT, place

X, Y, Z, DX, DY, DZ, FIRST, LAST = range(8)  # of a ray: origin, unit direction, piece in the shape at hand [m]
LEAST_DENOMINATOR = 1e-300  # of a denominator; a smaller one is parallel


@entry
def cast_rays(shapes, room, poses, carrier, mounted, reach, rays, out):
    """Fill out (n, rays) with the distance [m] along each ray to the first shape in n postures, inf beyond `reach`.

    A ray that begins within a shape has 0.

    poses: rotation (n, links, 3, 3) and position (n, links, 3) [m] of the links in the world; carrier: the link that
    carries the rays; mounted (rays, 6): origin [m] and unit direction in the frame of the carrier; rays (2, 8, rays):
    room to work in, of rays in the world and in a shape's frame.
    """
    rotation, position = poses
    for n in range(len(out)):
        place(shapes, room, rotation[n], position[n])
        _put(rotation[n, carrier], position[n, carrier], mounted, rays[0])
        for k in range(len(mounted)):
            out[n, k] = inf
        for i in range(len(shapes.table)):
            _meet(shapes, i, room, reach, rays, out[n])
        for k in range(len(mounted)):
            if out[n, k] > reach:
                out[n, k] = inf


@kernel
def _put(E, r, mounted, ray):
    """Turn rays from the frame of their link into the world."""
    for k in range(len(mounted)):
        origin, along = vector(mounted[k, 0:3]), vector(mounted[k, 3:6])
        for x in range(3):
            row = vector(E[x])
            ray[X + x, k] = r[x] + dot(row, origin)
            ray[DX + x, k] = dot(row, along)


@kernel
def _meet(shapes, i, room, reach, rays, out):
    """Shorten the rays that end at shape i."""
    shape, ray = shapes.table[i], rays[1]
    _turn(load9(room.E, i, 0), vector(room.r[i]), rays[0], ray)
    if shape.kind == FIELD:
        _meet_field(shapes, shape, reach, ray, out)
        return
    if shape.kind == POINT:
        _sphere(0.0, shape.radius, ray)
    elif shape.kind == CYLINDER:
        _cylinder(shape.half[2], shape.disc, ray)
    elif shape.kind == SEGMENT:
        _cylinder(shape.half[2], shape.radius, ray)
        _nearer(ray, out)
        _sphere(shape.half[2], shape.radius, ray)
        _nearer(ray, out)
        _sphere(-shape.half[2], shape.radius, ray)
    elif shape.kind == HALF_SPACE:
        _whole(ray)
        _behind((0.0, 0.0, 1.0), 0.0, ray)
    elif shape.kind == BOX:
        _box(shape.half, ray)
    elif shape.faces > 0:
        _hull(shapes, shape, ray)
    else:  # a line or a point, which no ray meets
        return
    _nearer(ray, out)


@kernel
def _hull(shapes, shape, ray):
    """Set the pieces to those within a hull; one that lies in a plane ends at the edges of its two faces."""
    _whole(ray)
    for j in range(shape.first_face, shape.first_face + shape.faces):
        normal = vector(shapes.planes[j, 0:3])
        _behind(normal, shapes.planes[j, 3] + shape.radius, ray)
        if shape.faces == 2:
            start, count = shapes.loops[j]
            for k in range(count):
                p = vector(shapes.corners[shape.first_vertex + shapes.around[start + k, 0]])
                after = shapes.around[start + (k + 1 if k + 1 < count else 0), 0]
                along = sub(vector(shapes.corners[shape.first_vertex + after]), p)
                side = scale(cross(along, normal), 1.0 / sqrt(dot(along, along)))
                _behind(side, dot(side, p) + shape.radius, ray)


@kernel
def _turn(E, r, world, ray):
    """Turn rays from the world into the frame of a shape."""
    for k in range(world.shape[1]):
        x, y, z = world[X, k] - r[0], world[Y, k] - r[1], world[Z, k] - r[2]
        dx, dy, dz = world[DX, k], world[DY, k], world[DZ, k]
        ray[X, k] = E[0] * x + E[3] * y + E[6] * z
        ray[Y, k] = E[1] * x + E[4] * y + E[7] * z
        ray[Z, k] = E[2] * x + E[5] * y + E[8] * z
        ray[DX, k] = E[0] * dx + E[3] * dy + E[6] * dz
        ray[DY, k] = E[1] * dx + E[4] * dy + E[7] * dz
        ray[DZ, k] = E[2] * dx + E[5] * dy + E[8] * dz


@kernel
def _nearer(ray, out):
    """Shorten the rays whose piece begins sooner and is not behind them."""
    for k in range(len(out)):
        at = ray[FIRST, k] if ray[FIRST, k] > 0.0 else 0.0
        hit = (ray[FIRST, k] <= ray[LAST, k]) & (ray[LAST, k] >= 0.0) & (at < out[k])
        out[k] = at if hit else out[k]


@kernel
def _whole(ray):
    for k in range(ray.shape[1]):
        ray[FIRST, k] = -inf
        ray[LAST, k] = inf


@kernel
def _behind(normal, distance, ray):
    """Keep what of the pieces is behind a plane."""
    for k in range(ray.shape[1]):
        speed = normal[0] * ray[DX, k] + normal[1] * ray[DY, k] + normal[2] * ray[DZ, k]
        room = distance - (normal[0] * ray[X, k] + normal[1] * ray[Y, k] + normal[2] * ray[Z, k])
        along = abs(speed) < LEAST_DENOMINATOR
        at = room / (1.0 if along else speed)
        first, last = ray[FIRST, k], ray[LAST, k]
        enters = at if (speed < 0.0) & (at > first) else first
        leaves = at if (speed > 0.0) & (at < last) else last
        ray[FIRST, k] = (inf if room < 0.0 else first) if along else enters
        ray[LAST, k] = last if along else leaves


@kernel
def _sphere(height, radius, ray):
    """Set the pieces to those within a sphere about (0, 0, height), by the distance of its center from the ray."""
    for k in range(ray.shape[1]):
        x, y, z = ray[X, k], ray[Y, k], ray[Z, k] - height
        dx, dy, dz = ray[DX, k], ray[DY, k], ray[DZ, k]
        middle = -(x * dx + y * dy + z * dz)
        x, y, z = x + middle * dx, y + middle * dy, z + middle * dz
        square = radius * radius - (x * x + y * y + z * z)
        half = sqrt(square if square > 0.0 else 0.0)
        ray[FIRST, k] = middle - half if square >= 0.0 else inf
        ray[LAST, k] = middle + half


@kernel
def _cylinder(half, radius, ray):
    """Set the pieces to those within a cylinder about z."""
    for k in range(ray.shape[1]):
        x, y, dx, dy = ray[X, k], ray[Y, k], ray[DX, k], ray[DY, k]
        square = dx * dx + dy * dy
        along = square < LEAST_DENOMINATOR
        middle = -(x * dx + y * dy) / (1.0 if along else square)
        middle = 0.0 if along else middle
        x, y = x + middle * dx, y + middle * dy
        free = radius * radius - (x * x + y * y)
        reach = sqrt((free if free > 0.0 else 0.0) / (1.0 if along else square))
        reach = inf if along else reach
        ray[FIRST, k] = middle - reach if free >= 0.0 else inf
        ray[LAST, k] = middle + reach
    _between(Z, half, ray)


@kernel
def _box(half, ray):
    """Set the pieces to those within a box."""
    _whole(ray)
    for axis in range(3):
        _between(axis, half[axis], ray)


@kernel
def _between(axis, half, ray):
    """Keep what of the pieces is less than `half` from the origin along an axis."""
    for k in range(ray.shape[1]):
        x, dx = ray[axis, k], ray[DX + axis, k]
        along = abs(dx) < LEAST_DENOMINATOR
        inverse = 1.0 / (1.0 if along else dx)
        one, other = (-half - x) * inverse, (half - x) * inverse
        enters, leaves = (one, other) if one < other else (other, one)
        free = abs(x) <= half
        enters = (-inf if free else inf) if along else enters
        leaves = inf if along else leaves
        ray[FIRST, k] = enters if enters > ray[FIRST, k] else ray[FIRST, k]
        ray[LAST, k] = leaves if leaves < ray[LAST, k] else ray[LAST, k]


# ---------------------------------------------------------------------------------------------- height fields


@kernel
def _meet_field(shapes, field, reach, ray, out):
    """Shorten the rays that end at a height field, which is solid below its triangles down to its floor."""
    _box(field.half, ray)
    for k in range(len(out)):
        first, last = max(ray[FIRST, k], 0.0), min(ray[LAST, k], min(out[k], reach))
        if first <= last:
            at = _follow(shapes, field, ray, k, first, last)
            if at < out[k]:
                out[k] = at


@kernel
def _follow(shapes, field, ray, k, first, last):
    """Return where a ray is first below a field between two distances, inf if nowhere; it goes from cell to cell."""
    u, du = _across(field, 0, ray[X, k], ray[DX, k])
    v, dv = _across(field, 1, ray[Y, k], ray[DY, k])
    i, j = _cell_of(u, du, first, field.nodes[0]), _cell_of(v, dv, first, field.nodes[1])
    begin = first
    while begin <= last:
        next_u, next_v = _leaving(u, du, i), _leaving(v, dv, j)
        end = min(last, min(next_u, next_v))
        at = _below_cell(shapes, field, ray, k, i, j, begin, end)
        if at < inf:
            return at
        if end >= last:
            return inf
        if next_u <= next_v:
            i += 1 if du > 0.0 else -1
        else:
            j += 1 if dv > 0.0 else -1
        if i < 0 or j < 0 or i > field.nodes[0] - 2 or j > field.nodes[1] - 2:
            return inf
        begin = max(end, begin)
    return inf


@kernel
def _across(field, axis, x, dx):
    """Return place and speed of a ray along an axis of the nodes, in cells and cells a meter."""
    return (x + field.half[axis]) / field.spacing[axis], dx / field.spacing[axis]


@kernel
def _cell_of(u, du, at, nodes):
    return min(max(int(u + du * at), 0), nodes - 2)


@kernel
def _leaving(u, du, i):
    """Return the distance at which a ray leaves cell i along one axis."""
    if abs(du) < LEAST_DENOMINATOR:
        return inf
    return ((i + 1.0 if du > 0.0 else i) - u) / du


@kernel
def _below_cell(shapes, field, ray, k, i, j, begin, end):
    """Return where a ray is first below the two triangles of a cell between two distances, inf if nowhere."""
    origin, along = (ray[X, k], ray[Y, k], ray[Z, k]), (ray[DX, k], ray[DY, k], ray[DZ, k])
    u, du = _across(field, 0, origin[0], along[0])
    v, dv = _across(field, 1, origin[1], along[1])
    crossing = ((v - j) - (u - i)) / (du - dv) if abs(du - dv) > LEAST_DENOMINATOR else inf  # of the diagonal
    middle = min(max(crossing, begin), end)
    for start, stop in ((begin, middle), (middle, end)):
        at = 0.5 * (start + stop)
        upper = (v + dv * at) - j > (u + du * at) - i
        over = _over(shapes, field, origin, along, i, j, upper, start)
        if over <= 0.0:
            return start
        under = _over(shapes, field, origin, along, i, j, upper, stop)
        if under < 0.0:
            return start + (stop - start) * (over / (over - under))
    return inf


@kernel
def _over(shapes, field, origin, along, i, j, upper, at):
    """Return how far a ray is above the plane of a triangle of cell (i, j) at a distance [m]."""
    p = add(origin, scale(along, at))
    u, _ = _across(field, 0, p[0], 0.0)
    v, _ = _across(field, 1, p[1], 0.0)
    row = field.first_node + i * field.nodes[1] + j
    low, high = shapes.heights[row], shapes.heights[row + field.nodes[1] + 1]
    if upper:
        side = shapes.heights[row + 1]
        height = low + (v - j) * (side - low) + (u - i) * (high - side)
    else:
        side = shapes.heights[row + field.nodes[1]]
        height = low + (u - i) * (side - low) + (v - j) * (high - side)
    return p[2] - height
