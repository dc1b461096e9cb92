"""Read what a robot looks like: the <visual> elements of a URDF, or the geoms that MuJoCo's viewer shows.

They are read from the model's file when it is displayed; loading a robot does not read them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from ..base.rotation import rotation_from_quaternion, rotation_from_rpy
from ..geometry.mesh import Color
from ..model import Model
from ..model.shapes import Geometry
from .collision import MeshFinder, shape_of
from .grammar import label, look_through, pass_over_paint, tidy
from .markup import Markup, read_markup
from .mjcf.read import compiled
from .mjcf.sizes import documents_of
from .mjcf.tree import ELLIPSOID, MESH, geometry_of, names_of
from .report import Report, RobotFileError

SHOWN = 3  # groups 0, 1 and 2 are shown by default; collision geoms beside visual ones have 3 or more
GREY = (0.5, 0.5, 0.5, 1.0)  # a geom's rgba where the file says nothing


class Triangles(NamedTuple):
    """A mesh of the file."""

    points: np.ndarray  # (n, 3) [m]
    triangles: np.ndarray  # (m, 3)


class Ellipsoid(NamedTuple):
    """An ellipsoid about its origin."""

    radii: np.ndarray  # (3,) [m]


@dataclass(frozen=True, eq=False)
class Visual:
    """A visible shape of a link."""

    geometry: Geometry | Triangles | Ellipsoid
    rotation: np.ndarray  # (3, 3) from its axes to the link's
    position: np.ndarray  # (3,) of its origin, in the link's frame [m]
    color: Color | None = None  # None where the file gives none
    opacity: float = 1.0


class Visuals(NamedTuple):
    """Visible shapes by link, and sentences about what could not be read."""

    of: dict[str, list[Visual]]
    notes: list[str]


def read_visuals(model: Model) -> Visuals:
    """Read the visible shapes from the file of a model; none without a file, or if the file is gone.

    Meshes of a URDF are not opened, and may be missing.
    """
    path = Path(model.source) if model.source else None
    if path is None or not path.is_file():
        return Visuals({}, [])
    try:
        markup = read_markup(path)
        if markup.root.tag == "mujoco":
            return _of_mjcf(path, model)
    except (ValueError, ImportError) as error:
        return Visuals({}, [f"{path.name} {error}"])
    return _of_urdf(path, markup, model) if markup.root.tag == "robot" else Visuals({}, [])


def _of_mjcf(path: Path, model: Model) -> Visuals:
    """Read the geoms in the visible groups, except planes and height fields."""
    m, _ = compiled(path, documents_of(path))
    bodies, links = names_of(m, "body", m.nbody), {link.name for link in model.links}
    seen: dict[str, list[Visual]] = {}
    for g in np.flatnonzero(m.geom_group < SHOWN):
        link, geometry, (color, opacity) = bodies[m.geom_bodyid[g]], _geometry(m, int(g)), _color(m, int(g))
        if geometry is not None and opacity > 0.0 and link in links:
            placed = (rotation_from_quaternion(m.geom_quat[g]), m.geom_pos[g].copy())
            seen.setdefault(link, []).append(Visual(geometry, *placed, color, opacity))
    return Visuals(seen, [])


def _geometry(m: Any, g: int) -> Geometry | Triangles | Ellipsoid | None:
    if m.geom_type[g] == MESH:
        k = m.geom_dataid[g]
        points = m.mesh_vert[m.mesh_vertadr[k] :][: m.mesh_vertnum[k]].astype(float)
        return Triangles(points, m.mesh_face[m.mesh_faceadr[k] :][: m.mesh_facenum[k]].astype(int))
    return Ellipsoid(m.geom_size[g].copy()) if m.geom_type[g] == ELLIPSOID else geometry_of(m, g)


def _color(m: Any, g: int) -> tuple[Color | None, float]:
    """Return color and opacity: the geom's own if they differ from the default, else those of its material."""
    rgba = m.geom_rgba[g].tolist()
    if np.allclose(rgba, GREY):
        if m.geom_matid[g] < 0:
            return None, 1.0
        rgba = m.mat_rgba[m.geom_matid[g]].tolist()
    red, green, blue = (round(255 * x) for x in rgba[:3])
    return (red, green, blue), rgba[3]


def _of_urdf(path: Path, markup: Markup, model: Model) -> Visuals:
    report, meshes = Report(markup.lines, strict=True), MeshFinder(path, model.package_dirs)
    named = {m.get("name", ""): _rgba(m) for m in markup.root.iterfind("material")}
    links = {link.name for link in model.links}
    seen: dict[str, list[Visual]] = {}
    notes: list[str] = []
    for element in markup.root.iterfind("link"):
        name = element.get("name", "")
        for visual in element.iterfind("visual") if name in links else ():
            tidy(visual, f"{label(element)} <visual>", report)
            pass_over_paint(visual)
            try:
                shape = shape_of(visual, name, label(element), meshes, report)
            except ValueError as error:
                notes.append(str(error))
                continue
            finally:
                look_through(visual, f"{label(element)} <visual>", report)
            material = visual.find("material")
            painted = material is not None and (_rgba(material) or named.get(material.get("name", "")))
            color, opacity = painted or (None, 1.0)
            placed = (rotation_from_rpy(shape.rpy), np.array(shape.xyz))
            seen.setdefault(name, []).append(Visual(shape.geometry, *placed, color, opacity))
    try:
        report.raise_problems(path)
    except RobotFileError as error:
        notes += error.problems
    return Visuals(seen, notes)


def _rgba(material: Element) -> tuple[Color, float] | None:
    color = material.find("color")
    try:
        r, g, b, *rest = (float(x) for x in color.get("rgba", "").split())  # type: ignore[union-attr]
        red, green, blue = (min(255, max(0, round(255 * x))) for x in (r, g, b))
    except (AttributeError, ValueError, OverflowError):
        return None
    return (red, green, blue), min(1.0, max(0.0, rest[0])) if rest else 1.0
