"""Lay out a fluid, the shapes that it acts on, and propellers.

Lengths of a shape of volume V: r is the radius of the ball of that volume, A_i the outline along the axis i.  MuJoCo's
added mass of an ellipsoid is an integral over the outside, which MuJoCo sums by the same 15 points (Kronrod's) as here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ..base.fixed_order import applied, product, total
from ..base.portable_math import power
from ..base.records import records
from ..base.rotation import rotation_from_rpy
from ..core.effects.fluid import ADDED, ELLIPSOID, IMMERSED, MEDIUM, Fluid
from ..core.effects.propeller import PROPELLER, Propellers
from ..core.shapes.immersion import CAPSULE, CYLINDER, POLYHEDRON, SPHERE
from ..dynamics.tree import Tree
from ..geometry.hull import hull_triangles
from ..geometry.mesh import mesh_hull
from ..geometry.polytope import BOX_LOOPS, box
from ..geometry.solid import solid_of
from ..model import Fluid as Medium
from ..model import Immersed, Model, rigid_bodies
from ..model.shapes import Box, Capsule, Cylinder, Hull, Mesh, Sphere

UP = (0.0, 0.0, 1.0)
# Kronrod's rule of 15 points on 0 ... 1, those up to 1/2, to the eight digits that MuJoCo has.
KRONROD = (
    (0.00427231, 0.01146766), (0.02544604, 0.03154605), (0.06756779, 0.05239501), (0.12923441, 0.07032663),
    (0.20695638, 0.08450236), (0.29707742, 0.09517529), (0.39610752, 0.10221647), (0.5, 0.10474107),
)  # fmt: skip


def build_fluid(model: Model, tree: Tree, medium: Medium | None, gravity: np.ndarray, points: int) -> Fluid | None:
    """Lay out the shapes of a model in a fluid, None if it acts on nothing; points: contact points of the scene."""
    shapes = [one for one in model.immersed if tree.floating or tree.placements[one.link].row > 0]
    if medium is None or not shapes:
        return None
    table, added, ellipsoids = (records(len(shapes), kind) for kind in (IMMERSED, ADDED, ELLIPSOID))
    triangles: list[np.ndarray] = []
    touching = {tree.placements[point.link].row for point in model.contacts} if points else set()
    for row, extra, oval, shape in zip(table, added, ellipsoids, shapes):
        place, E = tree.placements[shape.link], rotation_from_rpy(shape.rpy)
        row.body, row.contact = place.row, tree.bodies.contact[place.row]
        row.clears = place.row not in touching
        touching.add(place.row)
        row.position = place.r + applied(place.E, np.array(shape.xyz))
        row.E = product(place.E, E).ravel()
        _fill_geometry(row, shape, triangles)
        _fill_drag(row, shape, medium)
        _fill_added(extra, row, shape, medium)
        if shape.law == "ellipsoid":
            _fill_ellipsoid(oval, extra, shape, medium)
    world, g = records(1, MEDIUM), math.sqrt(float(total(gravity * gravity)))
    world[0].up = -gravity / g if g > 0 else UP
    world[0].level, world[0].current = medium.level or 0.0, medium.current
    world[0].weight = medium.density * gravity
    corners = np.concatenate([np.zeros((0, 9)), *triangles])
    heavy = any(extra.J.any() or extra.M.any() or extra.H.any() for extra in added)
    return Fluid(
        world,
        None if medium.level is None else True,
        table,
        corners,
        added if heavy else None,
        ellipsoids if any(shape.law == "ellipsoid" for shape in shapes) else None,
        np.array([points]),
    )


def triangles_of(shape: Immersed) -> np.ndarray:
    """Return the corners (n, 9) of the triangles of a polyhedron [m], none of other shapes."""
    match shape.geometry:
        case Box(size):
            corners = box(0.5 * np.array(size)).vertices
            rings = [ring for a, b, c, d in BOX_LOOPS for ring in ((a, b, c), (a, c, d))]
            return corners[np.array(rings)].reshape(-1, 9)
        case Hull(points):
            return _outward(np.array(points))
        case Mesh():
            return _outward(mesh_hull(shape.geometry))
    return np.zeros((0, 9))


def _outward(points: np.ndarray) -> np.ndarray:
    """Return the triangles of the convex hull of points (n, 3), counterclockwise from outside."""
    corners, middle = points[hull_triangles(points)], total(points.T) / len(points)
    a, b, c = (corners - middle).transpose(1, 0, 2)
    inward = total(a * np.cross(b, c)) < 0
    corners[inward] = corners[inward][:, ::-1]
    return corners.reshape(-1, 9)


def _fill_geometry(row: np.record, shape: Immersed, triangles: list[np.ndarray]) -> None:
    solid, geometry = solid_of(shape.geometry), shape.geometry
    if not solid.volume > 0:
        raise ValueError(
            f"immersed shape on link {shape.link!r}: {geometry!r} has no volume; give it an extent in all directions"
        )
    kinds = {Sphere: SPHERE, Cylinder: CYLINDER, Capsule: CAPSULE}
    row.kind = kinds.get(type(geometry), POLYHEDRON)
    if isinstance(geometry, (Sphere, Cylinder, Capsule)):
        row.radius, row.length = geometry.radius, getattr(geometry, "length", 0.0)
    row.first = sum(len(part) for part in triangles)
    triangles.append(triangles_of(shape))
    row.end = row.first + len(triangles[-1])
    row.volume, row.center, row.floats = solid.volume, solid.center, shape.buoyant


def outlines(shape: Immersed) -> np.ndarray:
    """Compute the areas (3,) of the outlines of a convex shape, seen along its axes [m^2]."""
    match shape.geometry:
        case Sphere(r):
            return np.full(3, math.pi * r * r)
        case Cylinder(r, h):
            return np.array([2.0 * r * h, 2.0 * r * h, math.pi * r * r])
        case Capsule(r, h):
            return np.array([2.0 * r * h, 2.0 * r * h, 0.0]) + math.pi * r * r
    a, b, c = triangles_of(shape).reshape(-1, 3, 3).transpose(1, 0, 2)
    return 0.25 * total(np.abs(np.cross(b - a, c - a)).T)


def _radius(volume: float) -> float:
    """Return the radius of the ball of a volume [m]."""
    return power(0.75 / math.pi * volume, 1.0 / 3.0)


def _fill_drag(row: np.record, shape: Immersed, medium: Medium) -> None:
    mu, rho = medium.viscosity, medium.density
    if isinstance(shape.geometry, Box) and shape.law != "smooth":
        edges = np.array(shape.geometry.size)
        d = float(total(edges)) / 3.0  # of the sphere whose viscous drag it has
        row.linear, row.turning_linear = 3.0 * math.pi * mu * d, math.pi * mu * d * d * d
        row.separate = shape.law == "box"
        row.strength = row.turning_strength = 1.0
        row.quadratic = row.turning_quadratic = 1.0
        if row.separate:
            x, y, z = edges
            row.quadratic = 0.5 * rho * np.array([y * z, z * x, x * y])
            row.turning_quadratic = rho / 64.0 * np.array([x * (y**4 + z**4), y * (z**4 + x**4), z * (x**4 + y**4)])
        return
    r, areas = _radius(row.volume), outlines(shape)
    row.linear = np.array(shape.along_axes("linear_damping")) + 6.0 * math.pi * mu * r * shape.stokes
    row.turning_linear = np.array(shape.along_axes("turning_damping")) + 8.0 * math.pi * mu * r * r * r * shape.stokes
    row.strength, row.quadratic = _norm(0.5 * rho * areas * shape.along_axes("drag"))
    row.turning_strength, row.turning_quadratic = _norm(0.5 * rho * r**5 * np.array(shape.along_axes("turning_drag")))


def _norm(each: np.ndarray) -> tuple[float, list[float]]:
    """Return Q and q of the law -Q N q u, N = sqrt(sum q u^2), which is -each u |u| along the axes."""
    size = float(each.max())
    return size, [power(float(one) / size, 2.0 / 3.0) if size > 0 else 0.0 for one in each]


def _fill_added(extra: np.record, row: np.record, shape: Immersed, medium: Medium) -> None:
    extra.inertial = 1.0
    if shape.added_matrix is not None:
        matrix = np.array(shape.added_matrix)
        extra.M, extra.J, extra.H = _six(matrix[:3, :3]), _six(matrix[3:, 3:]), matrix[3:, :3].ravel()
        return
    mass, r = medium.density * row.volume, _radius(row.volume)
    M = np.diag(mass * np.array(shape.along_axes("added_mass")))
    J = np.diag(mass * r * r * np.array(shape.along_axes("added_inertia")))
    x, y, z = row.center  # coefficients are those about the center of the volume
    P = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    H = product(P, M)
    extra.M, extra.H, extra.J = _six(M), H.ravel(), _six(J + product(H, P.T))


def _six(matrix: np.ndarray) -> np.ndarray:
    return matrix[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


def _fill_ellipsoid(oval: np.record, extra: np.record, shape: Immersed, medium: Medium) -> None:
    rho, (blunt, slender, angular, kutta, magnus) = medium.density, shape.fluidcoef
    oval.semiaxes = a, b, c = 0.5 * np.array(shape.geometry.size)  # type: ignore[union-attr]
    oval.blunt, oval.slender, oval.angular = rho * blunt, rho * slender, rho * angular
    oval.kutta, oval.magnus = rho * kutta, rho * magnus
    volume = 4.0 / 3.0 * math.pi * a * b * c
    x, y, z = _kappa(a, b, c), _kappa(b, c, a), _kappa(c, a, b)
    extra.inertial = 0.0
    extra.M = [rho * volume * x / (2.0 - x), 0.0, 0.0, rho * volume * y / (2.0 - y), 0.0, rho * volume * z / (2.0 - z)]
    turning = [_turned(volume, *pair) for pair in ((b, c, y, z), (c, a, z, x), (a, b, x, y))]
    extra.J = [rho * turning[0], 0.0, 0.0, rho * turning[1], 0.0, rho * turning[2]]


def _kappa(a: float, b: float, c: float) -> float:
    """Return the integral from 0 to infinity of a b c / ((a^2 + x) sqrt((a^2 + x) (b^2 + x) (c^2 + x))) by x."""
    scale, found = power(a * a * a * b * c, 0.4), 0.0
    for node, weight in KRONROD:
        for t in dict.fromkeys((node, 1.0 - node)):
            x, dx = scale * t**3 / (1.0 - t) ** 2, scale * t * t * (3.0 - t) / (1.0 - t) ** 3
            p, q, r = 1.0 + x / (a * a), 1.0 + x / (b * b), 1.0 + x / (c * c)
            found += weight * dx / (p * math.sqrt(p * q * r))
    return found / (a * a)


def _turned(volume: float, p: float, q: float, x: float, y: float) -> float:
    """Return the added inertia about the axis across the semiaxes p and q, of which x and y are kappa [m^5]."""
    gap = p * p - q * q
    if gap == 0.0:
        return 0.0
    return volume / 5.0 * gap * gap * (y - x) / (2.0 * gap + (p * p + q * q) * (x - y))


def build_propellers(model: Model, tree: Tree) -> Propellers | None:
    """Build the records of propellers, None without."""
    given = [one for one in model.propellers if one.joint in model.joint_rows]
    if not given:
        return None
    table, torque = records(len(given), PROPELLER), np.zeros(tree.n)
    rows = {body.frame.joint.name: k for k, body in enumerate(rigid_bodies(model)[0]) if body.frame.joint is not None}
    for row, one in zip(table, given):
        row.body, row.dof = rows[one.joint], model.joint_rows[one.joint]
        row.parent, row.thrust, row.torque = tree.bodies.parent[row.body], one.thrust, one.torque
        row.linear_thrust = one.linear_thrust
        torque[row.dof] = one.torque
    return Propellers(table, torque)


def fluid_limits(model: Model, medium: Medium | None, g: float) -> Iterator[tuple[str, float, str]]:
    """Yield name, largest explicit step [s] and cause of each shape that floats or feels viscosity."""
    if medium is not None:
        bodies, placements = rigid_bodies(model)
        for shape in model.immersed:
            name, mass = shape.name or shape.link, bodies[placements[shape.link].row].mass
            if medium.level is not None and shape.buoyant and mass > 0:
                pull = medium.density * g * float(total(outlines(shape)))  # its sections are below the sum of outlines
                if pull > 0:
                    yield name, 2.0 * math.sqrt(mass / pull), "buoyancy"


def joined_fluid(fluids: Sequence[Fluid | None], moved: Sequence, points: int) -> Fluid | None:
    """Return the shapes of all members in one fluid, which is the same for all; moved: their `Shift`."""
    found = [(k, one, at) for k, (one, at) in enumerate(zip(fluids, moved)) if one is not None]
    if not found:
        return None
    tables, start = [], 0
    for k, one, at in found:
        table = one.table.copy()
        table.tree, table.body = k, table.body + at.body
        table.contact = at.workspace(table.contact)
        table.first, table.end = table.first + start, table.end + start
        start += len(one.triangles)
        tables.append(table)
    first = found[0][1]
    return Fluid(
        first.medium,
        first.surface,
        np.concatenate(tables).view(np.recarray),
        np.concatenate([one.triangles for _, one, _ in found]),
        _of_all([(one.added, len(one.table)) for _, one, _ in found], ADDED),
        _of_all([(one.ellipsoids, len(one.table)) for _, one, _ in found], ELLIPSOID),
        np.array([points]),
    )


def _of_all(parts: list[tuple[np.recarray | None, int]], dtype: np.dtype) -> np.recarray | None:
    if all(part is None for part, _ in parts):
        return None
    tables = [records(count, dtype) if part is None else part for part, count in parts]
    return np.concatenate(tables).view(np.recarray)


def joined_propellers(given: Sequence[Propellers | None], moved: Sequence, joints: Sequence[int]) -> Propellers | None:
    """Return the propellers of all members."""
    if all(one is None for one in given):
        return None
    tables, torques = [], []
    for k, (one, at, n) in enumerate(zip(given, moved, joints)):
        torques.append(np.zeros(n) if one is None else one.torque)
        if one is not None:
            table = one.table.copy()
            table.tree, table.body, table.parent = k, table.body + at.body, table.parent + at.body
            table.dof += at.joint
            tables.append(table)
    return Propellers(np.concatenate(tables).view(np.recarray), np.concatenate(torques))
