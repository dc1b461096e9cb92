"""Convert a robot to faces: its <visual> shapes, else its collision shapes, else boxes of link inertia.

All faces are convex or flat, in the axes of their links.  Meshes are simplified: vertices in cells of a grid are merged
(J. Rossignac and P. Borrel, 1993); the size of the cells keeps the faces of a robot within a budget.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..base.rotation import rotation_from_rpy
from ..geometry.mesh import Color, mesh_parts
from ..geometry.mesh import Part as MeshPart
from ..model import Link, Model, inertia_matrix
from ..model.shapes import Box, Capsule, Cylinder, Geometry, Hull, Mesh, Sphere
from ..robot_file.visuals import Ellipsoid, Triangles, Visual, read_visuals

FACES = 5000  # of the meshes of a robot
LEAST = 40  # faces that a mesh may always have
ROUND = 16  # corners of a circle
LEFT, RIGHT, MIDDLE = (74, 144, 226), (240, 140, 60), (158, 166, 176)  # colors of links that have none, by name
SIDES_OF = {"left": {"l", "lf", "lh", "fl", "rl", "hl"}, "right": {"r", "rf", "rh", "fr", "rr", "hr"}}
EXACT = 4096  # cells along the longest side that leave a mesh as it is
SMOOTH = (Mesh, Triangles, Ellipsoid, Hull, Sphere, Capsule)  # whose edges are not drawn
CREASE = math.cos(math.radians(35.0))  # sharper edges of a mesh are seen as such


class Body(NamedTuple):
    """A link as faces."""

    link: str
    points: np.ndarray  # (n, 3) [m], link axes
    faces: tuple[tuple[int, ...], ...]  # corners of each, counterclockwise seen from outside
    colors: tuple[Color, ...]  # of each face
    smooth: bool  # a mesh: edges are not drawn


class Piece(NamedTuple):
    """Triangles of one color on a link."""

    link: str
    points: np.ndarray  # (n, 3) [m], link axes
    triangles: np.ndarray  # (m, 3), counterclockwise seen from outside
    color: Color
    opacity: float


def bodies(model: Model, most: int = FACES) -> tuple[list[Body], list[str]]:
    """Convert each visible link to faces; return them and notes about what could not be read.

    most: approximate number of triangles of all meshes together.  Raises ValueError for a robot none of whose links has
    a shape or an inertia.
    """
    found, notes = _found(model, most, ROUND)
    return [_joined(name, parts) for name, parts in found], notes


def pieces(model: Model, most: int, corners: int) -> tuple[list[Piece], list[str]]:
    """Convert each visible link to triangles, whose vertices are shared on smooth surfaces and not at sharp edges.

    most: as in `bodies`; corners: number of corners of a circle.
    """
    found, notes = _found(model, most, corners)
    made = [
        Piece(name, *creased(part.points, fans(part.faces)), part.color, part.opacity)
        for name, parts in found
        for part in parts
    ]
    return made, notes


def _found(model: Model, most: int, corners: int) -> tuple[list[tuple[str, list[_Part]]], list[str]]:
    """Find the parts of each visible link, and notes: visuals, else collision shapes, else the box of its inertia."""
    seen, notes = read_visuals(model)
    solid: dict[str, list[Visual]] = {}
    for shape in model.shapes:
        visual = Visual(shape.geometry, rotation_from_rpy(shape.rpy), np.array(shape.xyz))
        solid.setdefault(shape.link, []).append(visual)
    found, read = [], dict[str, list[MeshPart]]()  # mesh files, which several links may have
    for link in model.links:
        if seen and link.name not in seen:
            continue  # a file that says what is seen says it of all links
        shapes = (each.get(link.name, ()) for each in (seen, solid))
        parts = next(filter(None, (_parts(own, link.name, corners, read, notes) for own in shapes)), [])
        if not parts and max(link.inertia, default=0.0) > 0.0:
            parts = [_Part(*_box(link), sided(link.name), False)]
        if parts:
            found.append((link.name, parts))
    if not found:
        raise ValueError(f"{model.name}: no link has a shape or an inertia; there is nothing to draw")
    size = sum(_size(part.points) for _, parts in found for part in parts if isinstance(part.faces, np.ndarray))
    return [(name, [_simplified(part, most, size) for part in parts]) for name, parts in found], [*dict.fromkeys(notes)]


def _parts(
    visuals: Iterable[Visual], link: str, corners: int, read: dict[str, list[MeshPart]], notes: list[str]
) -> list[_Part]:
    """Convert some visuals; add a note for each that cannot be read."""
    found = []
    for visual in visuals:
        try:
            several = list(_faceted(visual.geometry, corners, read))
        except (ValueError, ImportError) as error:
            notes.append(str(error))
            continue
        smooth = isinstance(visual.geometry, SMOOTH)
        for points, faces, own in several:
            points = points @ visual.rotation.T + visual.position
            found.append(_Part(points, faces, own or visual.color or sided(link), smooth, visual.opacity))
    return found


def _simplified(part: _Part, most: int, size: float) -> _Part:
    """Simplify a mesh to its share of a number of faces, by its size among all meshes; leave other shapes."""
    if not isinstance(part.faces, np.ndarray):
        return part
    points, faces = thinned(part.points, part.faces, max(LEAST, int(most * _size(part.points) / size)))
    return part._replace(points=points, faces=faces)


def sided(name: str) -> Color:
    """Choose the color of a link by the side that its name states."""
    return {"left": LEFT, "right": RIGHT, "": MIDDLE}[side_of(name)]


def side_of(name: str) -> str:
    """Find "left" or "right" in a name, in full or as a letter between underscores; "" if there is neither."""
    words = name.lower().replace("-", "_").split("_")
    sides = (side for side, letters in SIDES_OF.items() if side in name.lower() or {words[0], words[-1]} & letters)
    return next(sides, "")


class _Part(NamedTuple):
    """A shape as faces, or as a mesh that is still to be simplified."""

    points: np.ndarray  # (n, 3) [m]
    faces: list[tuple[int, ...]] | np.ndarray  # an array (m, 3) of a mesh
    color: Color
    smooth: bool
    opacity: float = 1.0


def round_up(x: float) -> float:
    """Round up to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(max(x, 1e-9)))
    return next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= x)


def _size(points: np.ndarray) -> float:
    """Compute the diagonal of the box around points [m]."""
    return float(np.sqrt((np.ptp(points, axis=0) ** 2).sum()))


def _joined(link: str, parts: list[_Part]) -> Body:
    points = np.concatenate([part.points for part in parts])
    first = np.cumsum([0, *(len(part.points) for part in parts[:-1])])
    faces = [tuple(int(i + k) for i in face) for part, k in zip(parts, first) for face in part.faces]
    colors = [part.color for part in parts for _ in part.faces]
    return Body(link, points, tuple(faces), tuple(colors), any(part.smooth for part in parts))


# ---------------------------------------------------------------------------------------------- shapes as faces

Faceted = tuple[np.ndarray, list[tuple[int, ...]]]
CORNERS = np.array([(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1)], dtype=float)
SIDES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]


def _box(link: Link) -> Faceted:
    """Compute the box of uniform density that has the link's mass and inertia.

    With principal moments ``A, B, C`` and mass ``m`` its edges are ``sqrt(6 (B + C - A) / m)`` and so on in turn.
    """
    moments, axes = np.linalg.eigh(inertia_matrix(link.inertia))
    edges = np.sqrt(np.maximum(6.0 * (moments.sum() - 2.0 * moments) / link.mass, 0.0)) * axes
    edges[:, 2] *= np.sign(np.linalg.det(axes))  # right-handed, so that the faces' outside is known
    return np.array(link.center_of_mass) + (CORNERS - 0.5) @ edges.T, list(SIDES)


def _faceted(
    geometry: Geometry | Triangles | Ellipsoid, corners: int, read: dict[str, list[MeshPart]]
) -> Iterator[tuple[np.ndarray, list[tuple[int, ...]] | np.ndarray, Color | None]]:
    """Yield corners and faces of a shape (of a mesh an array of triangles), and its own color if it has one."""
    if isinstance(geometry, Mesh):
        yield from _colored(geometry, read)
    elif isinstance(geometry, Triangles):
        yield geometry.points, geometry.triangles, None
    elif isinstance(geometry, Ellipsoid):
        points, faces = _turned(1.0, [0.0, 0.0], corners)
        yield points * geometry.radii, faces, None
    elif isinstance(geometry, Box):
        yield (CORNERS - 0.5) * np.array(geometry.size), list(SIDES), None
    elif isinstance(geometry, Sphere):
        yield *_turned(geometry.radius, [0.0, 0.0], corners), None
    elif isinstance(geometry, Capsule):
        yield *_turned(geometry.radius, [-0.5 * geometry.length, 0.5 * geometry.length], corners), None
    elif isinstance(geometry, Cylinder):
        yield *_cylinder(geometry.radius, geometry.length, corners), None
    else:
        yield *_hull(np.array(geometry.points)), None


def _colored(mesh: Mesh, read: dict[str, list[MeshPart]]) -> Iterator[tuple[np.ndarray, np.ndarray, Color | None]]:
    """Yield the parts of a mesh file, each of one color."""
    path, scale = Path(mesh.file), np.array(mesh.scale)
    if not path.is_file():
        raise ValueError(f"mesh {mesh.file!r} does not exist")
    parts = read.get(mesh.file) or read.setdefault(mesh.file, mesh_parts(path))
    points = np.concatenate([part.points for part in parts]) if parts else np.empty((0, 3))
    if not len(points) or not np.isfinite(points).all() or not _size(points * scale) > 0.0:
        raise ValueError(f"{path}: has no triangles of finite size; export the mesh again")
    for part in parts:
        yield part.points * scale, part.triangles[:, ::-1] if scale.prod() < 0 else part.triangles, part.color


def _cylinder(radius: float, length: float, corners: int) -> Faceted:
    ring = radius * _circle(corners)
    points = np.vstack([np.column_stack([ring, np.full(corners, z)]) for z in (-0.5 * length, 0.5 * length)])
    around = [(k, (k + 1) % corners, corners + (k + 1) % corners, corners + k) for k in range(corners)]
    return points, [*around, tuple(range(corners - 1, -1, -1)), tuple(range(corners, 2 * corners))]


def _circle(corners: int) -> np.ndarray:
    angle = 2.0 * math.pi * np.arange(corners) / corners
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _turned(radius: float, centers: list[float], corners: int) -> Faceted:
    """Convert a sphere, or a capsule with the centers of its ends along z."""
    up = [90.0 * k / (3 * corners // ROUND) for k in range(3 * corners // ROUND)]
    rings = [(-a, centers[0]) for a in reversed(up)] + [(a, centers[1]) for a in up]
    rings = list(dict.fromkeys((a + 0.0, z) for a, z in rings))
    points = [np.array([[0.0, 0.0, centers[0] - radius]])]
    for latitude, z in rings:
        s, c = math.sin(math.radians(latitude)), math.cos(math.radians(latitude))
        points.append(np.column_stack([radius * c * _circle(corners), np.full(corners, z + radius * s)]))
    points.append(np.array([[0.0, 0.0, centers[1] + radius]]))
    last, n = 1 + corners * len(rings), corners
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
        raise ValueError("a hull is flat and is not drawn") from error
    a, b, c = points[hull.simplices].transpose(1, 0, 2)
    flip = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0
    return points, [tuple(map(int, t[::-1] if f else t)) for t, f in zip(hull.simplices, flip)]


def thinned(points: np.ndarray, triangles: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Simplify a mesh (n, 3), (m, 3) to about `most` triangles by merging the vertices in each cell of a grid."""
    size, low = float(np.ptp(points, axis=0).max()), points.min(axis=0)
    if not size > 0.0:  # a part of a mesh may be a point
        return points[:0], triangles[:0]
    cells = EXACT if len(triangles) <= most else max(4, round(math.sqrt(most)))
    vertices, faces = _merged(points, triangles, size / cells, low)
    while len(faces) > most and cells > 2:
        cells = max(2, int(0.85 * cells))
        vertices, faces = _merged(points, triangles, size / cells, low)
    used, place = np.unique(faces, return_inverse=True)
    return vertices[used], place.reshape(-1, 3)


def fans(faces: list[tuple[int, ...]] | np.ndarray) -> np.ndarray:
    """Split convex faces into triangles (m, 3)."""
    if isinstance(faces, np.ndarray):
        return faces
    triangles = [(face[0], *pair) for face in faces for pair in pairwise(face[1:])]
    return np.array(triangles, dtype=int).reshape(-1, 3)


def creased(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Duplicate vertices of a mesh so that triangles share them only where no sharp edge is between."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(triangles):
        return points, triangles
    a, b, c = points[triangles].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.sqrt((normal * normal).sum(axis=1)), 1e-300)[:, None]
    ends = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edge = ends[:, 0] * len(points) + ends[:, 1]
    order = np.argsort(edge, kind="stable")
    face = order // 3
    one, other = face[:-1], face[1:]
    smooth = (edge[order[1:]] == edge[order[:-1]]) & ((normal[one] * normal[other]).sum(axis=1) > CREASE)
    joined = coo_array((np.ones(smooth.sum()), (one[smooth], other[smooth])), shape=(len(triangles),) * 2)
    group = connected_components(joined, directed=False)[1]
    key = triangles * np.int64(group.max() + 1) + group[:, None]
    kept, place = np.unique(key, return_inverse=True)
    return points[kept // (group.max() + 1)], place.reshape(-1, 3)


def _merged(points: np.ndarray, triangles: np.ndarray, cell: float, low: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Replace the vertices in a cell by the one nearest to their mean; drop triangles that collapse."""
    cells = np.floor((points - low) / cell).astype(np.int64)
    group = np.unique((cells[:, 0] * (2 * EXACT) + cells[:, 1]) * (2 * EXACT) + cells[:, 2], return_inverse=True)[1]
    count = np.bincount(group).astype(float)
    means = np.column_stack([np.bincount(group, points[:, k]) / count for k in range(3)])
    order = np.lexsort((((points - means[group]) ** 2).sum(axis=1), group))
    nearest = order[np.searchsorted(group[order], np.arange(len(means)))]
    faces = group[triangles]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    turned = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    a, b, c = turned.T
    pair = np.unique(a * np.int64(len(nearest)) + b, return_inverse=True)[1]
    once = np.unique(pair * np.int64(len(nearest)) + c, return_index=True)[1]
    return points[nearest], turned[once]  # both sides of a thin plate stay
