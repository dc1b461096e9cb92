"""Read what a robot looks like: the <visual> elements of a URDF, or the geoms that MuJoCo's viewer shows.

They are read from the model's file when it is displayed; loading a robot does not read them.
"""

from __future__ import annotations

from collections.abc import Mapping
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
from .grammar import label
from .markup import Markup, read_markup
from .mjcf.visuals import Ellipsoid, Triangles, read_geoms
from .report import Report


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
    links = {link.name for link in model.links}
    seen: dict[str, list[Visual]] = {}
    for geom in read_geoms(path):
        if geom.link in links:
            placed = (rotation_from_quaternion(geom.quaternion), geom.position)
            seen.setdefault(geom.link, []).append(Visual(geom.geometry, *placed, geom.color, geom.opacity))
    return Visuals(seen, [])


def _of_urdf(path: Path, markup: Markup, model: Model) -> Visuals:
    report, meshes = Report(markup.lines), MeshFinder(path, model.package_dirs)
    named = {m.get("name", ""): _rgba(m) for m in markup.root.iterfind("material")}
    links = {link.name for link in model.links}
    seen: dict[str, list[Visual]] = {}
    notes: list[str] = []
    for element in markup.root.iterfind("link"):
        name = element.get("name", "")
        for visual in element.iterfind("visual") if name in links else ():
            try:
                shape = shape_of(visual, name, label(element), meshes, report)
            except ValueError as error:
                notes.append(str(error))
                continue
            color, opacity = _material(visual, named) or (None, 1.0)
            placed = (rotation_from_rpy(shape.rpy), np.array(shape.xyz))
            seen.setdefault(name, []).append(Visual(shape.geometry, *placed, color, opacity))
    return Visuals(seen, notes)


def _material(visual: Element, named: Mapping[str, Any]) -> tuple[Color, float] | None:
    material = visual.find("material")
    if material is None:
        return None
    return _rgba(material) or named.get(material.get("name", ""))


def _rgba(material: Element) -> tuple[Color, float] | None:
    color = material.find("color")
    try:
        r, g, b, *rest = (float(x) for x in color.get("rgba", "").split())  # type: ignore[union-attr]
        red, green, blue = (min(255, max(0, round(255 * x))) for x in (r, g, b))
    except (AttributeError, ValueError, OverflowError):
        return None
    return (red, green, blue), min(1.0, max(0.0, rest[0])) if rest else 1.0
