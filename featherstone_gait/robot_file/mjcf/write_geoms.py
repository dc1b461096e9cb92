"""Collision shapes, contact points and a floor as geoms."""

from __future__ import annotations

from ...model import ContactPoint, Model
from ...shape import Box, Capsule, Cylinder, Geometry, Hull, Mesh, Shape, Sphere
from .element import element, number, numbers

POINT_RADIUS = 1e-4  # of a contact point as a sphere, half the thickness of a circle [m]
READ = (".stl", ".obj", ".msh")  # mesh files
MASSLESS = {"mass": "0"}
TOUCHING = {"contype": "1", "conaffinity": "0"}  # a floor, and not each other
SILENT = {"contype": "0", "conaffinity": "0"}


def shape_lines(model: Model, link: str) -> list[str]:
    """The shapes of a link; where the model has contact points these touch the floor in their stead."""
    bits = SILENT if model.contacts else TOUCHING
    shapes = [(k, shape) for k, shape in enumerate(model.shapes) if shape.link == link]
    return [line for k, shape in shapes for line in _shape_lines(k, shape, bits)]


def _shape_lines(k: int, shape: Shape, bits: dict[str, str]) -> list[str]:
    kind, size = _geometry(shape.geometry)
    if not kind:
        return (
            [f"<!-- a shape of {shape.geometry.file.replace('--', '- -')} -->"]
            if isinstance(shape.geometry, Mesh)
            else []
        )
    attributes = {
        "type": kind,
        "name": shape.name or None,
        "size": numbers(size) if size else None,
        "mesh": None if size else f"mesh{k}",
        "pos": numbers(shape.xyz),
        "euler": numbers(shape.rpy),
    }
    return [element("geom", {**attributes, **MASSLESS, **bits})]


def _geometry(geometry: Geometry) -> tuple[str, tuple[float, ...]]:
    """MuJoCo's type and size of a geometry; no type where it has none."""
    if isinstance(geometry, Sphere):
        return "sphere", (geometry.radius,)
    if isinstance(geometry, Capsule | Cylinder):
        return type(geometry).__name__.lower(), (geometry.radius, 0.5 * geometry.length)
    if isinstance(geometry, Box):
        x, y, z = geometry.size
        return "box", (0.5 * x, 0.5 * y, 0.5 * z)
    return ("mesh", ()) if isinstance(geometry, Hull) or geometry.file.lower().endswith(READ) else ("", ())


def unread_meshes(model: Model) -> list[str]:
    """Files of shapes in a format that MuJoCo does not read."""
    meshes = [shape.geometry for shape in model.shapes if isinstance(shape.geometry, Mesh)]
    return list(dict.fromkeys(mesh.file for mesh in meshes if not _geometry(mesh)[0]))


def mesh_lines(model: Model) -> list[str]:
    """The hulls and files that shapes name."""
    return [line for k, shape in enumerate(model.shapes) for line in _mesh_lines(k, shape.geometry)]


def _mesh_lines(k: int, geometry: Geometry) -> list[str]:
    if isinstance(geometry, Hull):
        return [element("mesh", {"name": f"mesh{k}", "vertex": numbers(x for point in geometry.points for x in point)})]
    if isinstance(geometry, Mesh) and _geometry(geometry)[0]:
        return [element("mesh", {"name": f"mesh{k}", "file": geometry.file, "scale": numbers(geometry.scale)})]
    return []


def contact_lines(model: Model, link: str) -> list[str]:
    """The contact points of a link: spheres, and flat cylinders for circles."""
    points = [(k, point) for k, point in enumerate(model.contacts) if point.link == link]
    return [element("geom", {"name": f"contact{k}", **_point(point), **MASSLESS, **TOUCHING}) for k, point in points]


def _point(point: ContactPoint) -> dict[str, str]:
    pos = numbers(point.position)
    if point.rim > 0:
        return {
            "type": "cylinder",
            "pos": pos,
            "zaxis": numbers(point.axis),
            "size": numbers((point.rim, POINT_RADIUS)),
        }
    return {"type": "sphere", "pos": pos, "size": number(point.radius or POINT_RADIUS)}
