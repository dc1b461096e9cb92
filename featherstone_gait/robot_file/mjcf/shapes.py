"""Read the collision shapes of a compiled MJCF file."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from ...base.rotation import rotation_from_quaternion, rpy_from_rotation
from ...model.shapes import Box, Capsule, Cylinder, Geometry, Hull, Shape, Sphere
from .names import names_of
from .tree import Tree, vector

PLANE, HFIELD, SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH, SDF = range(9)  # mjtGeom
NAMES = ("plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh", "sdf")


def read_shapes(m: Any, tree: Tree) -> tuple[tuple[Shape, ...], list[str]]:
    """Read shapes of the geoms that would touch a floor, and what is ignored."""
    names, floor = names_of(m, "geom", m.ngeom), _floor(m)
    shapes, left, silent = [], Counter[str](), 0
    for g in range(m.ngeom):
        if not tree.holds(m, int(m.geom_bodyid[g])):
            continue
        geometry = geometry_of(m, g)
        if not _touches(m, g, floor):
            silent += 1
        elif geometry is None:
            left[NAMES[m.geom_type[g]]] += 1
        else:
            shapes.append(_shape(m, g, geometry, tree, names[g]))
    notes = [f"skipped {silent} geoms that touch no floor"] if silent else []
    notes += [f"ignored {count} geoms of type {kind}, which is not supported" for kind, count in left.items()]
    return tuple(shapes), notes


def _floor(m: Any) -> tuple[int, int]:
    """Return contype and conaffinity of the world's first plane or height field, else the defaults of a geom."""
    for g in np.flatnonzero(m.geom_bodyid == 0):
        if m.geom_type[g] in (PLANE, HFIELD):
            return int(m.geom_contype[g]), int(m.geom_conaffinity[g])
    return 1, 1


def _touches(m: Any, g: int, floor: tuple[int, int]) -> bool:
    contype, conaffinity = floor
    return bool(m.geom_contype[g] & conaffinity or m.geom_conaffinity[g] & contype)


def geometry_of(m: Any, g: int) -> Geometry | None:
    """Return the geometry of a geom; None if it is not supported."""
    kind, size = m.geom_type[g], m.geom_size[g].tolist()
    if kind == SPHERE:
        return Sphere(size[0])
    if kind in (CAPSULE, CYLINDER):
        return (Capsule if kind == CAPSULE else Cylinder)(size[0], 2.0 * size[1])
    if kind == BOX:
        return Box((2.0 * size[0], 2.0 * size[1], 2.0 * size[2]))
    if kind == MESH:
        return Hull(tuple(vector(point) for point in _corners(m, int(m.geom_dataid[g]))))
    return None


def _corners(m: Any, mesh: int) -> np.ndarray:
    """Return the vertices (n, 3) of a mesh's convex hull if MuJoCo has computed it, else all vertices."""
    start = m.mesh_vertadr[mesh]
    points = m.mesh_vert[start : start + m.mesh_vertnum[mesh]]
    if m.mesh_graphadr[mesh] < 0:
        return points
    graph = m.mesh_graph[m.mesh_graphadr[mesh] :]
    count = graph[0]
    return points[graph[2 + count : 2 + 2 * count]]


def _shape(m: Any, g: int, geometry: Geometry, tree: Tree, name: str) -> Shape:
    rpy = rpy_from_rotation(rotation_from_quaternion(m.geom_quat[g]))
    return Shape(tree.bodies[m.geom_bodyid[g]], geometry, vector(m.geom_pos[g]), rpy, name)
