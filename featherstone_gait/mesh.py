"""The points of mesh files: STL, OBJ and DAE.

Lengths are as users of URDF see them in RViz: those of the file times the shape's scale, and of a DAE times its unit,
which Pinocchio passes over.  The `up_axis` of a DAE is passed over by both: x, y, z of the file are those of the shape.
"""

from __future__ import annotations

import functools
import io
import math
from pathlib import Path
from typing import Any

import numpy as np

from .hull import Corners, corners_of, hull_indices
from .shape import Mesh

MAX_BYTES = 100_000_000  # of one file
KINDS = (".stl", ".obj", ".dae")
COLOURS = ("library_images", "library_effects", "library_materials", "bind_material")  # of a DAE


def mesh_corners(mesh: Mesh) -> Corners:
    """A few corners of the convex hull of a mesh, and how far it reaches beyond them [m]; raises as `mesh_hull`."""
    return _corners(*_version(mesh))


def mesh_hull(mesh: Mesh) -> np.ndarray:
    """All corners (n, 3) of the convex hull of a mesh [m]; a file is read once while it stays the same.

    Raises ValueError, which names the file, for one that is missing, damaged, too large or of another kind, and
    ImportError without the reader.
    """
    return _hull(*_version(mesh))


def _version(mesh: Mesh) -> tuple[Path, tuple[float, float, float], int, int]:
    """File and scale of a mesh, when the file was changed, and its size."""
    path = Path(mesh.file)
    if not path.is_file():
        raise ValueError(f"{mesh.file}: there is no such mesh; correct the path, or say where its package is")
    about = path.stat()
    if about.st_size > MAX_BYTES:
        raise ValueError(f"{path}: has {about.st_size} bytes; at most {MAX_BYTES} are read: simplify the mesh")
    return path, mesh.scale, about.st_mtime_ns, about.st_size


@functools.lru_cache(maxsize=1024)
def _corners(*version: Any) -> Corners:
    return corners_of(_hull(*version))


@functools.lru_cache(maxsize=1024)
def _hull(path: Path, scale: tuple[float, float, float], *changed: int) -> np.ndarray:
    """The hull of a version of a file; nobody may write into it."""
    points = mesh_points(path) * np.array(scale)
    if not np.isfinite(points).all():
        raise ValueError(f"{path}: has points that are not finite, with scale {scale!r}; export the mesh again")
    hull = points[hull_indices(points)]
    hull.flags.writeable = False
    return hull


def mesh_points(path: Path) -> np.ndarray:
    """The vertices (n, 3) of all parts of a mesh file, in metres.  Raises as `mesh_hull`."""
    return mesh_triangles(path)[0]


def mesh_triangles(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (n, 3) of all parts of a mesh file [m], and triangles (m, 3) of their indices; raises likewise."""
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise ValueError(f"{path}: is no mesh that can be read; expected one of {', '.join(KINDS)}: convert it")
    data, unit = path.read_bytes(), 1.0
    if kind == ".dae":
        data, unit = _without_colours(path, data)
    vertices, triangles = _triangles(path, data, kind[1:])
    return unit * vertices, triangles


def _triangles(path: Path, data: bytes, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in the unit of the file, each part where the file puts it, and triangles."""
    trimesh = _reader(kind)
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False)
        parts = [(np.asarray(part.vertices, dtype=float).reshape(-1, 3), _faces(part)) for part in scene.dump()]
    except Exception as error:  # a damaged file can make the reader fail in any way
        raise ValueError(f"{path}: cannot be read as {kind.upper()}: {error!r}; export the mesh again") from error
    counts = [len(vertices) for vertices, _ in parts]
    if not sum(counts):
        raise ValueError(f"{path}: has no triangles; export the mesh again")
    first = np.cumsum([0, *counts[:-1]])
    return np.concatenate([v for v, _ in parts]), np.concatenate([f + k for (_, f), k in zip(parts, first)])


def _faces(part: Any) -> np.ndarray:
    """Triangles (m, 3) of a part, none of one that is points or lines only."""
    return np.asarray(getattr(part, "faces", ()), dtype=int).reshape(-1, 3)


def _reader(kind: str) -> Any:
    try:
        if kind == "dae":
            import collada  # noqa: F401
        import trimesh
    except ImportError as error:
        raise ImportError(f"meshes are read by {error.name}: pip install featherstone-gait[mesh]") from error
    return trimesh


def _without_colours(path: Path, data: bytes) -> tuple[bytes, float]:
    """A DAE without its materials, of which a broken one makes the reader drop the triangles; and metres per unit."""
    from xml.etree.ElementTree import ParseError, tostring

    from defusedxml.common import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        root = fromstring(data, forbid_dtd=True)
        stated = root.find("{*}asset/{*}unit")
        unit = 1.0 if stated is None else float(stated.get("meter", 1.0))
    except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
        raise ValueError(f"{path}: cannot be read as DAE: {error}; export the mesh again") from error
    if not 0.0 < unit < math.inf:
        raise ValueError(f"{path}: a unit of {unit!r} m; expected > 0: correct <unit meter=...>")
    for element in list(root.iter()):
        for child in [child for child in element if child.tag.rpartition("}")[2] in COLOURS]:
            element.remove(child)
    return tostring(root), unit
