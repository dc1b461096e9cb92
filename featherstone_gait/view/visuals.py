"""What of a robot is seen: its <visual> shapes, else its collision shapes, else boxes of the links' inertia.

All become convex or flat faces in the axes of their links.  Meshes are thinned: their vertices are merged in the cells
of a grid (J. Rossignac and P. Borrel, 1993), whose size is chosen so that the faces of a robot stay within a budget.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from ..mesh import mesh_triangles
from ..model import Link, Model, inertia_matrix
from ..robot_file.collision import MeshFinder, shape_of
from ..robot_file.grammar import label
from ..robot_file.markup import read_markup
from ..robot_file.report import Report
from ..rotation import rotation_from_rpy
from ..shape import Box, Capsule, Cylinder, Geometry, Hull, Mesh, Shape, Sphere

Colour = tuple[int, int, int]
FACES = 5000  # of the meshes of a robot
LEAST = 40  # faces that a mesh may always have
ROUND = 16  # corners of a circle
LEFT, RIGHT, MIDDLE = (74, 144, 226), (240, 140, 60), (158, 166, 176)  # colours of links that have none, by name
SIDES_OF = {"left": {"l", "lf", "lh", "fl", "rl", "hl"}, "right": {"r", "rf", "rh", "fr", "rr", "hr"}}
EXACT = 4096  # cells along the longest side that leave a mesh as it is


class Body(NamedTuple):
    """A link as faces."""

    link: str
    points: np.ndarray  # (n, 3) [m], link axes
    faces: tuple[tuple[int, ...], ...]  # corners of each, counterclockwise seen from outside
    colours: tuple[Colour, ...]  # of each face
    smooth: bool  # a mesh: edges are not drawn


@dataclass(frozen=True)
class _Seen:
    """A shape with its colour, None where the file gives none."""

    shape: Shape
    colour: Colour | None = None


def bodies(model: Model, most: int = FACES) -> tuple[list[Body], list[str]]:
    """What is seen of each link that has anything, and sentences about what could not be read.

    most: triangles that all meshes together become, about.

    Raises ValueError for a robot none of whose links has a shape or an inertia.
    """
    seen, notes = _visuals(model)
    solid: dict[str, list[_Seen]] = {}
    for shape in model.shapes:
        solid.setdefault(shape.link, []).append(_Seen(shape))
    found = []
    faceted = _Facets(most)
    for link in model.links:
        if seen and link.name not in seen:
            continue  # a file that says what is seen says it of all links
        parts = faceted.parts(seen.get(link.name, ()), link.name, notes) or faceted.parts(
            solid.get(link.name, ()), link.name, notes
        )
        if not parts and max(link.inertia, default=0.0) > 0.0:
            parts = [_Part(*_box(link), sided(link.name), False)]
        if parts:
            found.append((link.name, parts))
    if not found:
        raise ValueError(f"{model.name}: no link has a shape or an inertia; there is nothing to draw")
    return [_joined(name, faceted.thinned(parts)) for name, parts in found], list(dict.fromkeys(notes))


def sided(name: str) -> Colour:
    """The colour of a link by the side that its name tells."""
    return {"left": LEFT, "right": RIGHT, "": MIDDLE}[side_of(name)]


def side_of(name: str) -> str:
    """Left or right where a name says so, in full or as a letter between underscores, else ""."""
    words = name.lower().replace("-", "_").split("_")
    said = (side for side, letters in SIDES_OF.items() if side in name.lower() or {words[0], words[-1]} & letters)
    return next(said, "")


def _visuals(model: Model) -> tuple[dict[str, list[_Seen]], list[str]]:
    """The <visual> elements of the URDF that a model was read from, by link; what is wrong is left out, and told."""
    path = Path(model.source) if model.source else None
    if path is None or path.suffix != ".urdf" or not path.is_file():
        return {}, []
    try:
        markup = read_markup(path)
    except ValueError as error:
        return {}, [f"{path.name} {error}"]
    report, meshes = Report(markup.lines), MeshFinder(path)
    colours = {m.get("name", ""): _rgb(m) for m in markup.root.iterfind("material")}
    links = {link.name for link in model.links}
    seen: dict[str, list[_Seen]] = {}
    notes: list[str] = []
    for element in markup.root.iterfind("link"):
        name = element.get("name", "")
        for visual in element.iterfind("visual") if name in links else ():
            try:
                shape = shape_of(visual, name, label(element), meshes, report)
            except ValueError as error:
                notes.append(str(error))
                continue
            seen.setdefault(name, []).append(_Seen(shape, _colour(visual, colours)))
    return seen, notes


def _colour(visual: Element, named: Mapping[str, Colour | None]) -> Colour | None:
    material = visual.find("material")
    if material is None:
        return None
    return _rgb(material) or named.get(material.get("name", ""))


def _rgb(material: Element) -> Colour | None:
    color = material.find("color")
    try:
        r, g, b, *_ = (min(255, max(0, round(255 * float(x)))) for x in color.get("rgba", "").split())  # type: ignore[union-attr]
    except (AttributeError, ValueError, OverflowError):
        return None
    return r, g, b


class _Part(NamedTuple):
    """A shape as faces, or as a mesh that is still to be thinned."""

    points: np.ndarray  # (n, 3) [m]
    faces: list[tuple[int, ...]] | np.ndarray  # an array (m, 3) of a mesh
    colour: Colour
    smooth: bool


class _Facets:
    """Shapes as faces, of which meshes share a budget by their sizes."""

    def __init__(self, most: int) -> None:
        self.most, self.size = most, 0.0

    def parts(self, shapes: Iterable[_Seen], link: str, notes: list[str]) -> list[_Part]:
        """Of some shapes; those that cannot be read are told."""
        found = []
        for seen in shapes:
            shape = seen.shape
            try:
                points, faces = _faceted(shape.geometry)
            except (ValueError, ImportError) as error:
                notes.append(str(error))
                continue
            smooth = isinstance(shape.geometry, (Mesh, Hull, Sphere, Capsule))
            if isinstance(faces, np.ndarray):
                self.size += _size(points)
            points = points @ rotation_from_rpy(shape.rpy).T + np.array(shape.xyz)
            found.append(_Part(points, faces, seen.colour or sided(link), smooth))
        return found

    def thinned(self, parts: list[_Part]) -> list[_Part]:
        """The same with all meshes thinned, each to its share."""
        done = []
        for part in parts:
            if isinstance(part.faces, np.ndarray):
                share = max(LEAST, int(self.most * _size(part.points) / self.size))
                points, faces = thinned(part.points, part.faces, share)
                part = part._replace(points=points, faces=faces)
            done.append(part)
        return done


def _size(points: np.ndarray) -> float:
    """Diagonal of the box around points [m]."""
    return float(np.sqrt((np.ptp(points, axis=0) ** 2).sum()))


def _joined(link: str, parts: list[_Part]) -> Body:
    points = np.concatenate([part.points for part in parts])
    first = np.cumsum([0, *(len(part.points) for part in parts[:-1])])
    faces = [tuple(int(i + k) for i in face) for part, k in zip(parts, first) for face in part.faces]
    colours = [part.colour for part in parts for _ in part.faces]
    return Body(link, points, tuple(faces), tuple(colours), any(part.smooth for part in parts))


# ---------------------------------------------------------------------------------------------- shapes as faces

Faceted = tuple[np.ndarray, list[tuple[int, ...]]]
CORNERS = np.array([(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=float)
SIDES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]


def _box(link: Link) -> Faceted:
    """The box of uniform density that has the link's mass and inertia.

    With principal moments ``A, B, C`` and mass ``m`` its edges are ``sqrt(6 (B + C - A) / m)`` and so on in turn.
    """
    moments, axes = np.linalg.eigh(inertia_matrix(link.inertia))
    edges = np.sqrt(np.maximum(6.0 * (moments.sum() - 2.0 * moments) / link.mass, 0.0)) * axes
    edges[:, 2] *= np.sign(np.linalg.det(axes))  # right-handed, so that the faces' outside is known
    return np.array(link.center_of_mass) + (CORNERS - 0.5) @ edges.T, list(SIDES)


def _faceted(geometry: Geometry) -> tuple[np.ndarray, list[tuple[int, ...]] | np.ndarray]:
    """Corners and faces; of a mesh all triangles (n, 3)."""
    if isinstance(geometry, Box):
        return (CORNERS - 0.5) * np.array(geometry.size), list(SIDES)
    if isinstance(geometry, Sphere):
        return _turned(geometry.radius, [0.0, 0.0])
    if isinstance(geometry, Capsule):
        return _turned(geometry.radius, [-0.5 * geometry.length, 0.5 * geometry.length])
    if isinstance(geometry, Cylinder):
        return _cylinder(geometry.radius, geometry.length)
    if isinstance(geometry, Hull):
        return _hull(np.array(geometry.points))
    path = Path(geometry.file)
    if not path.is_file():
        raise ValueError(f"mesh {geometry.file!r} is not there")
    points, triangles = mesh_triangles(path)
    scale = np.array(geometry.scale)
    if scale.prod() < 0:
        triangles = triangles[:, ::-1]
    if not len(triangles) or not np.isfinite(points).all() or not _size(points * scale) > 0.0:
        raise ValueError(f"{path}: has no triangles of finite size; export the mesh again")
    return points * scale, triangles


def _cylinder(radius: float, length: float) -> Faceted:
    angle = 2.0 * math.pi * np.arange(ROUND) / ROUND
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    points = np.vstack([np.column_stack([ring, np.full(ROUND, z)]) for z in (-0.5 * length, 0.5 * length)])
    around = [(k, (k + 1) % ROUND, ROUND + (k + 1) % ROUND, ROUND + k) for k in range(ROUND)]
    return points, [*around, tuple(range(ROUND - 1, -1, -1)), tuple(range(ROUND, 2 * ROUND))]


def _turned(radius: float, centres: list[float]) -> Faceted:
    """A sphere, or a capsule with the centres of its ends along z."""
    rings = [(-60, centres[0]), (-30, centres[0]), (0, centres[0]), (0, centres[1]), (30, centres[1]), (60, centres[1])]
    rings = list(dict.fromkeys(rings))
    angle = 2.0 * math.pi * np.arange(ROUND) / ROUND
    points = [np.array([[0.0, 0.0, centres[0] - radius]])]
    for latitude, z in rings:
        s, c = math.sin(math.radians(latitude)), math.cos(math.radians(latitude))
        ring = [radius * c * np.cos(angle), radius * c * np.sin(angle), np.full(ROUND, z + radius * s)]
        points.append(np.column_stack(ring))
    points.append(np.array([[0.0, 0.0, centres[1] + radius]]))
    last, n = 1 + ROUND * len(rings), ROUND
    faces: list[tuple[int, ...]] = []
    for k in range(n):
        m = (k + 1) % n
        faces.append((0, 1 + m, 1 + k))
        for first in range(1, last - n, n):
            faces.append((first + k, first + m, first + n + m, first + n + k))
        faces.append((last, last - n + k, last - n + m))
    return np.vstack(points), faces


def _hull(points: np.ndarray) -> Faceted:
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError) as error:
        raise ValueError("a hull is flat, and not drawn") from error
    return points, _outward(points, hull.simplices, hull.equations[:, :3])


def _outward(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> list[tuple[int, ...]]:
    a, b, c = points[triangles].transpose(1, 0, 2)
    flip = (np.cross(b - a, c - a) * normals).sum(axis=1) < 0
    return [tuple(map(int, t[::-1] if f else t)) for t, f in zip(triangles, flip)]


def thinned(points: np.ndarray, triangles: np.ndarray, most: int) -> Faceted:
    """A mesh (n, 3), (m, 3) of at most about `most` triangles: vertices in a cell of a grid become their mean."""
    size, low = float(np.ptp(points, axis=0).max()), points.min(axis=0)
    cells = EXACT if len(triangles) <= most else max(4, round(math.sqrt(most)))
    vertices, faces = _merged(points, triangles, size / cells, low)
    while len(faces) > most and cells > 2:
        cells = max(2, int(0.85 * cells))
        vertices, faces = _merged(points, triangles, size / cells, low)
    used, place = np.unique(faces, return_inverse=True)
    return vertices[used], [tuple(map(int, face)) for face in place.reshape(-1, 3)]


def _merged(points: np.ndarray, triangles: np.ndarray, cell: float, low: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the vertices in a cell the one nearest to their mean stands for all; triangles that collapse are left out."""
    _, group = np.unique(np.floor((points - low) / cell).astype(int), axis=0, return_inverse=True)
    group = group.reshape(-1)
    count = np.bincount(group).astype(float)
    means = np.column_stack([np.bincount(group, points[:, k]) / count for k in range(3)])
    order = np.lexsort((((points - means[group]) ** 2).sum(axis=1), group))
    nearest = order[np.searchsorted(group[order], np.arange(len(means)))]
    faces = group[triangles]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    turned = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    return points[nearest], np.unique(turned, axis=0)  # both sides of a thin plate stay
