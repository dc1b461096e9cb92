"""Collision shapes of links.

A shape's frame has its origin at the center of the geometry; capsules and cylinders lie along its z axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ..base.arguments import floats, instance, is_real, shown, vector, whole
from ..base.brief import brief
from .checks import check, friction_flaws, number_flaws
from .ground import HeightField
from .surface import Surface

Vector = tuple[float, float, float]
LARGEST_PRIORITY = 2**31 - 1  # priority


class _Round:
    """A shape of lengths alone."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            _check_length(type(self).__name__.lower(), name, value)


@dataclass(frozen=True)
class Sphere(_Round):
    """A sphere about the origin of the shape.

    Attributes
    ----------
    radius : float
        Radius [m].
    """

    radius: float

    __repr__ = brief


@dataclass(frozen=True)
class Capsule(_Round):
    """A cylinder along z with half a sphere on either end.

    Attributes
    ----------
    radius : float
        Radius [m].
    length : float
        Distance between the centers of the half spheres [m].
    """

    radius: float
    length: float

    __repr__ = brief


@dataclass(frozen=True)
class Cylinder(_Round):
    """A cylinder along z, its middle at the origin of the shape.

    Attributes
    ----------
    radius : float
        Radius [m].
    length : float
        Length [m].
    """

    radius: float
    length: float

    __repr__ = brief


@dataclass(frozen=True)
class Box:
    """A box about the origin of the shape.

    Attributes
    ----------
    size : tuple of float
        Edges (3,) along x, y and z [m].
    """

    size: Vector

    __repr__ = brief

    def __post_init__(self) -> None:
        _freeze(self, "box", "size")
        for edge in self.size:
            _check_length("box", "size", edge)


@dataclass(frozen=True)
class Mesh:
    """The convex hull of a file of triangles (STL, OBJ, DAE, glTF); the file is opened when its points are needed.

    Attributes
    ----------
    file : str
        Path of the file.
    scale : tuple of float
        Factors (3,) on x, y and z.
    """

    file: str
    scale: Vector = (1.0, 1.0, 1.0)

    __repr__ = brief

    def __post_init__(self) -> None:
        instance("mesh: file", self.file, str, "give its path")
        _freeze(self, "mesh", "scale")


@dataclass(frozen=True)
class Hull:
    """The convex hull of points.

    Attributes
    ----------
    points : tuple of tuple of float
        Points (n, 3) [m].
    """

    points: tuple[Vector, ...]

    __repr__ = brief

    def __post_init__(self) -> None:
        points = floats("hull: points", self.points)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
            raise ValueError(f"hull: points have the shape {points.shape}; expected finite numbers (n, 3) [m]")
        if type(self.points) is not tuple:
            object.__setattr__(self, "points", tuple(map(tuple, points.tolist())))


Geometry: TypeAlias = Sphere | Capsule | Cylinder | Box | Mesh | Hull | HeightField


@dataclass(frozen=True)
class Shape:
    """A collision shape of a link.

    Attributes
    ----------
    link : str
        Name of the link.
    geometry : Sphere, Capsule, Cylinder, Box, Mesh, Hull or HeightField
        The geometry.  A height field consists of triangles here, two a cell, and is solid below.
    xyz : tuple of float
        Center in the link's frame [m].
    rpy : tuple of float
        Orientation in the link's frame: roll, pitch and yaw about fixed axes [rad].
    name : str
        Name; may be empty.
    friction : float or None
        Coefficient of friction [-]; None: with the ground that of the `Ground`, between bodies that of the
        `PairContact`.
    torsional_friction, rolling_friction : float or None
        Coefficients of the moments between bodies, as in `PairContact` [m]; None: those of the `PairContact`.  Contact
        points that come from a sphere, capsule or cylinder take the rolling one to the ground.
    surface : Surface or None
        How its surface moves on the link; None: it rests.
    priority : int or None
        How coefficients of two shapes combine, where both have a priority: those of the higher one count, and of
        equal ones the larger, as in MuJoCo.  None: `friction` counts as a geometric mean.
    """

    link: str
    geometry: Geometry
    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    name: str = ""
    friction: float | None = None
    torsional_friction: float | None = None
    rolling_friction: float | None = None
    surface: Surface | None = None
    priority: int | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        instance("shape: link", self.link, str, "give the name of its link")
        what = f"shape on link {self.link!r}"
        kinds = (Sphere, Capsule, Cylinder, Box, Mesh, Hull, HeightField)
        remedy = "give a Sphere, Capsule, Cylinder, Box, Mesh, Hull or HeightField"
        instance(f"{what}: geometry", self.geometry, kinds, remedy)
        instance(f"{what}: name", self.name, str, "give a text")
        check(friction_flaws(what, self.friction))
        if self.surface is not None:
            instance(f"{what}: surface", self.surface, Surface, "give Surface(velocity=...), or None")
        for name in ("torsional_friction", "rolling_friction"):
            if getattr(self, name) is not None:
                remedy = "give the largest moment by the normal force, or None"
                check(number_flaws(what, name, getattr(self, name), ">= 0", "m", remedy))
        if self.priority is not None:
            remedy = "give a whole number, or None"
            priority = whole(f"{what}: priority", self.priority, -LARGEST_PRIORITY, remedy, LARGEST_PRIORITY)
            object.__setattr__(self, "priority", priority)
        _freeze(self, what, "xyz", "rpy")


def _freeze(record: Mesh | Box | Shape, what: str, *names: str) -> None:
    """Check vectors, and keep them as tuples, which cannot be changed."""
    for name in names:
        values = vector(f"{what}: {name}", getattr(record, name), 3)
        if type(getattr(record, name)) is not tuple:
            object.__setattr__(record, name, tuple(values.tolist()))


def _check_length(what: str, name: str, value: float) -> None:
    if not is_real(value) or not 0 <= value < math.inf:
        raise ValueError(f"{what}: {name} is {shown(value)} m; expected a finite length >= 0: correct it")
