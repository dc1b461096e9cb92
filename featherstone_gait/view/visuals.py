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
from ..model import HeightField, Link, Model, inertia_matrix
from ..model.shapes import Box, Capsule, Cylinder, Geometry, Hull, Mesh, Sphere
from ..robot_file.visuals import Ellipsoid, Triangles, Visual, read_visuals

FACES = 8000  # of the meshes of a robot
LEAST_FACES = 40  # faces that a mesh may always have
ROUND = 16  # corners of a circle
LEFT, RIGHT, MIDDLE = (74, 144, 226), (240, 140, 60), (158, 166, 176)  # colors of links that have none, by name
SIDES_OF = {"left": {"l", "lf", "lh", "fl", "rl", "hl"}, "right": {"r", "rf", "rh", "fr", "rr", "hr"}}
FINER, FREE = 0.93, 1e-3  # steps of the number of cells; weight of the mean of vertices beside their planes
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
    open: bool  # a mesh with a boundary, whose faces are seen from behind too


class Piece(NamedTuple):
    """Triangles of one color on a link."""

    link: str
    points: np.ndarray  # (n, 3) [m], link axes
    triangles: np.ndarray  # (m, 3), counterclockwise seen from outside
    color: Color
    opacity: float


class Read(NamedTuple):
    """The parts of each visible link, before any mesh is simplified."""

    name: str
    source: str
    links: list[tuple[str, list[_Part]]]
    notes: list[str]  # what could not be read

    @property
    def triangles(self) -> int:
        """Number of triangles of all meshes."""
        return sum(len(part.faces) for _, parts in self.links for part in parts if part.mesh >= 0)


def bodies(model: Model, most: int = FACES) -> tuple[list[Body], list[str]]:
    """Convert each visible link to faces; return them and notes about what could not be read.

    most: approximate number of triangles of all meshes together.  Raises ValueError for a robot none of whose links has
    a shape or an inertia.
    """
    found = read(model, ROUND)
    return bodies_of(found, most), found.notes


def bodies_of(found: Read, most: int) -> list[Body]:
    """Convert each link that was read to faces."""
    return [_joined(name, parts) for name, parts in _simple(found, most)]


def pieces(model: Model, most: int, corners: int) -> tuple[list[Piece], list[str]]:
    """Convert each visible link to triangles, whose vertices are shared on smooth surfaces and not at sharp edges.

    most: as in `bodies`; corners: number of corners of a circle.
    """
    found = read(model, corners)
    return pieces_of(found, most), found.notes


def pieces_of(found: Read, most: int) -> list[Piece]:
    """Convert each link that was read to triangles."""
    return [
        Piece(name, *creased(part.points, fans(part.faces)), part.color, part.opacity)
        for name, parts in _simple(found, most)
        for part in parts
    ]


def read(model: Model, corners: int) -> Read:
    """Read the parts of each visible link: its visuals, else its collision shapes, else the box of its inertia."""
    seen, notes = read_visuals(model)
    solid: dict[str, list[Visual]] = {}
    for shape in model.shapes:
        visual = Visual(shape.geometry, rotation_from_rpy(shape.rpy), np.array(shape.xyz))
        solid.setdefault(shape.link, []).append(visual)
    found, meshes = [], dict[str, list[MeshPart]]()  # mesh files, which several links may have
    for link in model.links:
        if seen and link.name not in seen:
            continue  # a file that says what is seen says it of all links
        shapes = (each.get(link.name, ()) for each in (seen, solid))
        parts = next(filter(None, (_parts(own, link.name, corners, meshes, notes) for own in shapes)), [])
        if not parts and max(link.inertia, default=0.0) > 0.0:
            parts = [_Part(*_box(link), sided(link.name), False)]
        if parts:
            found.append((link.name, parts))
    return Read(model.name, str(model.source), found, [*dict.fromkeys(notes)])


def _simple(found: Read, most: int) -> list[tuple[str, list[_Part]]]:
    """Simplify the meshes of all links to about as many triangles; leave them as they are if they have no more."""
    if found.triangles <= most:
        most = found.triangles * 10**6  # so that no mesh has less than it needs
    size = sum(_size(np.concatenate([p.points for p in mesh])) for _, parts in found.links for mesh in _meshes(parts))
    simple = [(name, [*_simplified(parts, most, size)]) for name, parts in found.links]
    if not any(parts for _, parts in simple):
        raise ValueError(f"{found.name}: no link has a shape or an inertia; there is nothing to draw")
    return [(name, parts) for name, parts in simple if parts]


def _parts(
    visuals: Iterable[Visual], link: str, corners: int, read: dict[str, list[MeshPart]], notes: list[str]
) -> list[_Part]:
    """Convert some visuals; add a note for each that cannot be read."""
    found = []
    for k, visual in enumerate(visuals):
        try:
            several = list(_faceted(visual.geometry, corners, read))
        except (ValueError, ImportError) as error:
            notes.append(str(error))
            continue
        smooth = isinstance(visual.geometry, SMOOTH)
        for points, faces, own in several:
            points = points @ visual.rotation.T + visual.position
            mesh = k if isinstance(faces, np.ndarray) else -1
            found.append(_Part(points, faces, own or visual.color or sided(link), smooth, visual.opacity, mesh))
    return found


def _meshes(parts: list[_Part]) -> list[list[_Part]]:
    """Group the parts of each mesh of a link."""
    return [[part for part in parts if part.mesh == k] for k in sorted({part.mesh for part in parts} - {-1})]


def _simplified(parts: list[_Part], most: int, size: float) -> Iterator[_Part]:
    """Simplify each mesh to its share of a number of faces, by its size among all meshes; leave other shapes.

    Parts of one mesh are simplified together: there are no gaps where their colors meet.
    """
    yield from (part for part in parts if part.mesh < 0)
    for mesh in _meshes(parts):
        points, first = np.concatenate([part.points for part in mesh]), np.cumsum([0, *(len(p.points) for p in mesh)])
        faces = np.concatenate([part.faces + k for part, k in zip(mesh, first)])
        owner = np.repeat(np.arange(len(mesh)), [len(part.faces) for part in mesh])
        vertices, kept, source = thinned(points, faces, max(LEAST_FACES, int(most * _size(points) / size)))
        ajar = bool(len(kept)) and _has_boundary(points, faces)
        for k, part in enumerate(mesh):
            used, place = np.unique(kept[owner[source] == k], return_inverse=True)
            if len(used):
                yield part._replace(points=vertices[used], faces=place.reshape(-1, 3), open=ajar)


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
    mesh: int = -1  # which mesh of the link it belongs to
    open: bool = False  # whether that has a boundary


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
    smooth, ajar = any(part.smooth for part in parts), any(part.open for part in parts)
    return Body(link, points, tuple(faces), tuple(colors), smooth, ajar)


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
    elif isinstance(geometry, HeightField):
        yield *_field(geometry), None
    else:
        yield *_hull(np.array(geometry.points)), None


def _field(field: HeightField) -> Faceted:
    """Return the nodes of a height field, and two triangles for each cell."""
    (nx, ny), (x, y), (dx, dy) = field.heights.shape, field.origin, field.spacing
    first, second = np.meshgrid(x + dx * np.arange(nx), y + dy * np.arange(ny), indexing="ij")
    points = np.stack([first, second, field.heights], axis=-1).reshape(-1, 3)
    cells = (i * ny + j for i in range(nx - 1) for j in range(ny - 1))
    faces = []
    for k in cells:
        faces += [(k, k + ny, k + ny + 1), (k, k + ny + 1, k + 1)]
    return points, list[tuple[int, ...]](faces)


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


def thinned(points: np.ndarray, triangles: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Simplify a mesh (n, 3), (m, 3) to about `most` triangles by merging the vertices in each cell of a grid.

    Return vertices, triangles, and which triangle of the mesh each of them was.
    """
    size, low = float(np.ptp(points, axis=0).max()), points.min(axis=0)
    if not size > 0.0:  # a mesh may be a point
        return points[:0], triangles[:0], np.arange(0)
    cells = EXACT if len(triangles) <= most else max(4, round(1.5 * math.sqrt(most)))
    vertices, faces, source = _merged(points, triangles, size / cells, low)
    while len(faces) > most and cells > 2:
        cells = max(2, int(FINER * cells))
        vertices, faces, source = _merged(points, triangles, size / cells, low)
    used, place = np.unique(faces, return_inverse=True)
    return vertices[used], place.reshape(-1, 3), source


def _has_boundary(points: np.ndarray, triangles: np.ndarray) -> bool:
    """Return whether a mesh has an edge that its triangles do not pass as often one way as the other."""
    _, triangles, _ = _merged(points, triangles, float(np.ptp(points, axis=0).max()) / EXACT, points.min(axis=0))
    a, b = triangles[:, [0, 1, 2]].ravel(), triangles[:, [1, 2, 0]].ravel()
    edges = np.minimum(a, b) * np.int64(len(points)) + np.maximum(a, b)
    return bool(np.bincount(np.unique(edges, return_inverse=True)[1], np.sign(b - a)).any())


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


def _merged(
    points: np.ndarray, triangles: np.ndarray, cell: float, low: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Replace the vertices in a cell by one where their planes meet; drop triangles that collapse.

    Return vertices, triangles, and which of the triangles each was.
    """
    cells = np.floor((points - low) / cell).astype(np.int64)
    group = np.unique((cells[:, 0] * (2 * EXACT) + cells[:, 1]) * (2 * EXACT) + cells[:, 2], return_inverse=True)[1]
    vertices, faces = _meeting(points, triangles, group, cell), group[triangles]
    source = np.flatnonzero((faces != np.roll(faces, 1, axis=1)).all(axis=1))
    faces = faces[source]
    turned = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    a, b, c = turned.T
    pair = np.unique(a * np.int64(len(vertices)) + b, return_inverse=True)[1]
    once = np.unique(pair * np.int64(len(vertices)) + c, return_index=True)[1]
    return vertices, turned[once], source[once]  # both sides of a thin plate stay


def _meeting(points: np.ndarray, triangles: np.ndarray, group: np.ndarray, cell: float) -> np.ndarray:
    """Find for each group of vertices (n,) the place nearest to the planes of its triangles (P. Lindstrom, 2000).

    It is no farther than a cell from their mean, to which it is drawn where the planes leave it free.
    """
    count = np.bincount(group).astype(float)
    means = np.column_stack([np.bincount(group, points[:, k]) / count for k in range(3)])
    a, b, c = points[triangles].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    of = group[triangles]
    A, rhs = np.zeros((len(means), 3, 3)), np.zeros((len(means), 3))
    for k in range(3):
        away = ((a - means[of[:, k]]) * normals).sum(axis=1)
        for i in range(3):
            rhs[:, i] += np.bincount(of[:, k], normals[:, i] * away, len(means))
            for j in range(3):
                A[:, i, j] += np.bincount(of[:, k], normals[:, i] * normals[:, j], len(means))
    free = FREE * np.trace(A, axis1=1, axis2=2) + np.finfo(float).tiny
    A[:, [0, 1, 2], [0, 1, 2]] += free[:, None]
    return means + np.clip(np.linalg.solve(A, rhs[..., None])[..., 0], -0.5 * cell, 0.5 * cell)
