"""Write collision shapes and contact points as geoms."""

from __future__ import annotations

import os

from ...model import ContactPoint, Model
from ...model.shapes import Box, Capsule, Cylinder, Geometry, Hull, Mesh, Shape, Sphere
from .element import comment, element, number, numbers
from .names import unused

POINT_RADIUS = 1e-4  # of a contact point as a sphere, half the thickness of a circle [m]
READ = (".stl", ".obj", ".msh")  # mesh files
MOST_TRIANGLES = 200_000  # of an STL
FLOOR = "floor"
MASSLESS = {"mass": "0"}
TOUCHING = {"contype": "1", "conaffinity": "0"}  # a floor, and not each other
SILENT = {"contype": "0", "conaffinity": "0"}


def geom_lines(model: Model, link: str) -> list[str]:
    """Write the shapes and contact points of a link.

    A contact point is a sphere, or a flat cylinder for a circle; if the model has contact points, shapes touch no
    floor.
    """
    names, bits = geom_names(model), SILENT if model.contacts else TOUCHING
    shapes = [(k, shape) for k, shape in enumerate(model.shapes) if shape.link == link]
    points = [(name, point) for name, point in zip(names[len(model.shapes) :], model.contacts) if point.link == link]
    return [
        *(_shape_line(k, names[k], shape, bits) for k, shape in shapes),
        *(element("geom", {"name": name, **_point(point), **MASSLESS, **TOUCHING}) for name, point in points),
    ]


def geom_names(model: Model) -> list[str]:
    """Return unique names of the shapes, then of the contact points; empty for a shape without a name."""
    names: list[str] = []
    for name in (*(shape.name for shape in model.shapes), *(f"contact{k}" for k in range(len(model.contacts)))):
        names.append(unused(name, [FLOOR, *names]) if name else "")
    return names


def _shape_line(k: int, name: str, shape: Shape, bits: dict[str, str]) -> str:
    kind, size = _geometry(shape.geometry)
    if not kind:
        return comment(f"left out {name or 'a shape'}: {_described(shape.geometry)}")
    attributes = {
        "type": kind,
        "name": name or None,
        "size": numbers(size) if size else None,
        "mesh": None if size else f"mesh{k}",
        "pos": numbers(shape.xyz),
        "euler": numbers(shape.rpy),
    }
    return element("geom", {**attributes, **MASSLESS, **bits})


def _described(geometry: Geometry) -> str:
    return geometry.file if isinstance(geometry, Mesh) else f"{type(geometry).__name__} without extent"


def _geometry(geometry: Geometry) -> tuple[str, tuple[float, ...]]:
    """Return MuJoCo's type and size of a geometry; no type if MuJoCo does not accept it."""
    if isinstance(geometry, Hull):
        return "mesh", ()
    if isinstance(geometry, Mesh):
        return ("mesh" if _readable(geometry.file) else ""), ()
    kind, size = type(geometry).__name__.lower(), _size(geometry)
    return (kind if min(size) > 0 else ""), size


def _size(geometry: Sphere | Capsule | Cylinder | Box) -> tuple[float, ...]:
    if isinstance(geometry, Sphere):
        return (geometry.radius,)
    if isinstance(geometry, Box):
        x, y, z = geometry.size
        return 0.5 * x, 0.5 * y, 0.5 * z
    return geometry.radius, 0.5 * geometry.length


def _readable(file: str) -> bool:
    """Return whether MuJoCo reads a mesh file: it exists, of a known kind, as binary STL or OBJ of finite numbers."""
    kind = os.path.splitext(file)[1].lower()
    if kind not in READ or not os.path.isfile(file):
        return False
    return _is_binary_stl(file) if kind == ".stl" else kind != ".obj" or _is_finite_obj(file)


def _is_binary_stl(file: str) -> bool:
    """Check for a header of 80 bytes, the number of triangles, and 50 bytes for each."""
    with open(file, "rb") as stream:
        count = int.from_bytes(stream.read(84)[80:], "little")
    return 0 < count <= MOST_TRIANGLES and os.path.getsize(file) == 84 + 50 * count


def _is_finite_obj(file: str) -> bool:
    with open(file, encoding="utf-8", errors="replace") as stream:
        return not any("nan" in line or "inf" in line for line in stream if line.startswith("v "))


def unread_meshes(model: Model) -> list[str]:
    """Return files of shapes that do not exist, or that MuJoCo does not read."""
    meshes = [shape.geometry for shape in model.shapes if isinstance(shape.geometry, Mesh)]
    return list(dict.fromkeys(mesh.file for mesh in meshes if not _geometry(mesh)[0]))


def mesh_lines(model: Model) -> list[str]:
    """Write the hulls, and the files that shapes name."""
    return [line for k, shape in enumerate(model.shapes) for line in _mesh_lines(k, shape.geometry)]


def _mesh_lines(k: int, geometry: Geometry) -> list[str]:
    """Write a mesh with inertia="shell", since MuJoCo requires a volume even of massless meshes."""
    if isinstance(geometry, Hull):
        stated = {"vertex": numbers(x for point in geometry.points for x in point)}
    elif isinstance(geometry, Mesh) and _readable(geometry.file):
        stated = {"file": geometry.file, "scale": numbers(geometry.scale)}
    else:
        return []
    return [element("mesh", {"name": f"mesh{k}", **stated, "inertia": "shell"})]


def _point(point: ContactPoint) -> dict[str, str]:
    pos = numbers(point.position)
    if point.circle_radius > 0:
        return {
            "type": "cylinder",
            "pos": pos,
            "zaxis": numbers(point.axis),
            "size": numbers((point.circle_radius, POINT_RADIUS)),
        }
    return {"type": "sphere", "pos": pos, "size": number(point.radius or POINT_RADIUS)}
