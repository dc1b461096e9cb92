"""Collision shapes of links, as URDF and MJCF state them.

A shape's frame has its origin at the centre of the geometry; capsules and cylinders lie along its z axis.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Sphere:
    radius: float  # [m]

    def __post_init__(self) -> None:
        _check_length("sphere", "radius", self.radius)


@dataclass(frozen=True)
class Capsule:
    """A cylinder with half a sphere on either end."""

    radius: float  # [m]
    length: float  # between the centres of the half spheres [m]

    def __post_init__(self) -> None:
        _check_length("capsule", "radius", self.radius)
        _check_length("capsule", "length", self.length)


@dataclass(frozen=True)
class Cylinder:
    radius: float  # [m]
    length: float  # [m]

    def __post_init__(self) -> None:
        _check_length("cylinder", "radius", self.radius)
        _check_length("cylinder", "length", self.length)


@dataclass(frozen=True)
class Box:
    size: Vector  # edges [m]

    def __post_init__(self) -> None:
        for edge in self.size:
            _check_length("box", "size", edge)


@dataclass(frozen=True)
class Mesh:
    """A file of triangles (STL, OBJ, DAE), of which the convex hull counts.  Opened when its points are asked for."""

    file: str  # path
    scale: Vector = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Hull:
    """The convex hull of points."""

    points: tuple[Vector, ...]  # [m]


Geometry: TypeAlias = Sphere | Capsule | Cylinder | Box | Mesh | Hull


@dataclass(frozen=True)
class Shape:
    """A collision shape of a link."""

    link: str
    geometry: Geometry
    xyz: Vector = (0.0, 0.0, 0.0)  # centre in the link's frame [m]
    rpy: Vector = (0.0, 0.0, 0.0)  # fixed-axis roll, pitch, yaw [rad]
    name: str = ""


def _check_length(what: str, name: str, value: float) -> None:
    if not 0 <= value < math.inf:
        raise ValueError(f"{what}: {name} is {value!r} m; expected a finite length >= 0: correct it")
