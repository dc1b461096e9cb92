"""Compute volume, center and inertia of solid shapes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..base.fixed_order import total
from ..model import HeightField
from ..model.rigid_bodies import inertia_tuple
from ..model.shapes import Box, Capsule, Cylinder, Geometry, Hull, Mesh, Sphere
from .hull import hull_triangles
from .mesh import mesh_hull


class Solid(NamedTuple):
    """A solid of even density, in the shape's frame."""

    volume: float  # [m^3]
    center: tuple[float, float, float]  # [m]
    moments: tuple[float, ...]  # inertia about the center by mass: ixx, ixy, ixz, iyy, iyz, izz [m^2]


def solid_of(geometry: Geometry) -> Solid:
    """Compute the mass properties of a shape; of a mesh those of its convex hull.

    Raises ValueError for a mesh that cannot be read.
    """
    match geometry:
        case Sphere(r):
            return _round(4.0 / 3.0 * math.pi * r * r * r, 0.4 * r * r, 0.4 * r * r)
        case Cylinder(r, h):
            return _round(math.pi * r * r * h, (3.0 * r * r + h * h) / 12.0, 0.5 * r * r)
        case Capsule(r, h):
            return _capsule(r, h)
        case Box((x, y, z)):
            moments = ((y * y + z * z) / 12.0, 0.0, 0.0, (x * x + z * z) / 12.0, 0.0, (x * x + y * y) / 12.0)
            return Solid(x * y * z, (0.0, 0.0, 0.0), moments)
        case HeightField():
            return _round(0.0, 0.0, 0.0)
        case Mesh():
            return _polyhedron(mesh_hull(geometry))
        case Hull(points):
            return _polyhedron(np.array(points))


def _round(volume: float, across: float, along: float) -> Solid:
    return Solid(volume, (0.0, 0.0, 0.0), (across, 0.0, 0.0, across, 0.0, along))


def _capsule(r: float, h: float) -> Solid:
    """Add a cylinder and two half spheres, whose centers of mass are 3/8 r beyond its ends."""
    middle, caps = math.pi * r * r * h, 4.0 / 3.0 * math.pi * r * r * r
    volume = middle + caps
    if not volume > 0:
        return _round(0.0, 0.0, 0.0)
    across = middle * (3.0 * r * r + h * h) / 12.0 + caps * (0.4 * r * r + 0.25 * h * h + 0.375 * h * r)
    return _round(volume, across / volume, (middle * 0.5 * r * r + caps * 0.4 * r * r) / volume)


def _polyhedron(points: np.ndarray) -> Solid:
    """Add the tetrahedra from the middle of the corners (n, 3) of a convex hull to its triangles."""
    middle = total(points.T) / len(points)
    triangles = hull_triangles(points)
    if not len(triangles):
        return Solid(0.0, (float(middle[0]), float(middle[1]), float(middle[2])), (0.0,) * 6)
    corners = points[triangles] - middle  # (triangles, 3, 3)
    a, b, c = corners.transpose(1, 0, 2)
    volumes = np.abs(total(a * np.cross(b, c))) / 6.0
    volume = total(volumes)
    sums = total(corners, axis=1)
    offset = total((0.25 * volumes[:, None] * sums).T) / volume
    spread = total(corners[:, :, :, None] * corners[:, :, None, :], axis=1) + sums[:, :, None] * sums[:, None, :]
    second = total((volumes[:, None, None] / 20.0 * spread).transpose(1, 2, 0)) / volume
    second = second - offset[:, None] * offset
    x, y, z = (middle + offset).tolist()
    return Solid(float(volume), (x, y, z), inertia_tuple(np.eye(3) * np.trace(second) - second))
