"""The points and the colors of mesh files: STL, OBJ, DAE and glTF.

Lengths are as users of URDF see them in RViz: those of the file times the shape's scale, and of a DAE times its unit,
which Pinocchio passes over.  The `up_axis` of a DAE is passed over by both: x, y, z of the file are those of the shape.
So they are of a glTF, whose specification has y point up; its nodes are where it puts them.
"""

from __future__ import annotations

import functools
import io
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, cast
from xml.etree.ElementTree import Element, ParseError, tostring

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from ..model.shapes import Mesh
from .hull import Corners, corners_of, hull_indices, hull_volume
from .mesh_size import check_dae, check_gltf, tag_of

MAX_BYTES = 100_000_000  # of one file
OPEN = 1e-4  # largest open part of the area of a mesh whose volume is computed
KINDS = (".stl", ".obj", ".dae", ".glb", ".gltf")
WHITE = (255, 255, 255)
COLORS = ("library_images", "library_effects", "library_materials", "bind_material")  # of a DAE
LOOKS = ("KHR_materials", "KHR_texture", "EXT_texture", "KHR_lights")  # extensions of a glTF that move no point
PICTURES = ("images", "textures", "samplers")  # of a glTF
TEXTURES = ("library_images", "newparam")  # and what of an effect refers to them

Color = tuple[int, int, int]


class Part(NamedTuple):
    """Triangles of one color."""

    points: np.ndarray  # (n, 3) [m]
    triangles: np.ndarray  # (m, 3)
    color: Color | None  # red, green, blue, 0 to 255; None where the file says none


def mesh_corners(mesh: Mesh) -> Corners:
    """Return a few corners of the convex hull of a mesh, and how far it reaches beyond them [m].

    Raises as `mesh_hull`.
    """
    return _corners(*_version(mesh))


def mesh_hull(mesh: Mesh) -> np.ndarray:
    """Return all corners (n, 3) of the convex hull of a mesh [m]; a file is read again only if it has changed.

    Raises ValueError, which names the file, for one that is missing, damaged, too large or of another kind, and
    ImportError if its reader is not installed.
    """
    return _hull(*_version(mesh))


def hull_excess(mesh: Mesh) -> float:
    """Return the ratio of the volumes of a mesh's convex hull and of the mesh; NaN for a mesh that is not closed.

    Raises as `mesh_hull`.
    """
    path, _, *changed = _version(mesh)
    return _excess(path, *changed)


def _version(mesh: Mesh) -> tuple[Path, tuple[float, float, float], int, int]:
    """Return file and scale of a mesh, the time of its last change, and its size."""
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
    """Compute the hull of a version of a file; the array is read-only."""
    points = mesh_points(path) * np.array(scale)
    if not np.isfinite(points).all():
        raise ValueError(f"{path}: has points that are not finite, with scale {scale!r}; export the mesh again")
    hull = points[hull_indices(points)]
    hull.flags.writeable = False
    return hull


@functools.lru_cache(maxsize=1024)
def _excess(path: Path, *changed: int) -> float:
    points, triangles = mesh_triangles(path)
    a, b, c = (points[triangles[:, k]] - points.mean(axis=0) for k in range(3))
    areas = np.cross(b - a, c - a)
    gap = np.abs(areas.sum(axis=0)).max()  # no area is left open where triangles close
    inside, whole = abs(float((a * np.cross(b, c)).sum())) / 6.0, hull_volume(points)
    return whole / inside if gap <= OPEN * np.abs(areas).sum() and inside > OPEN * whole else math.nan


def mesh_points(path: Path) -> np.ndarray:
    """Read the vertices (n, 3) of all parts of a mesh file [m].  Raises as `mesh_hull`."""
    return mesh_triangles(path)[0]


def mesh_triangles(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the vertices (n, 3) of all parts of a mesh file [m] and triangles (m, 3) of their indices.

    Raises as `mesh_hull`.
    """
    kind, data, unit = _contents(path)
    vertices, triangles = _joined(_read(path, data, kind))
    return unit * vertices, triangles


def mesh_parts(path: Path) -> list[Part]:
    """Read the triangles of a mesh file by color; textures of DAE and glTF count as white.  Raises as `mesh_hull`.

    A DAE with broken materials has no colors.
    """
    kind, data, unit = _contents(path)
    found = _read(path, data, kind)
    if kind == "dae":
        found = _colored(path, sum(len(part.triangles) for part in found)) or found
    elif kind == "obj":
        found = _read(path, data, kind, _Beside(path, ".mtl"))
    alike: dict[Color | None, list[Part]] = {}
    for part in found:
        alike.setdefault(part.color, []).append(part)
    whole = [Part(*_joined(parts), color) for color, parts in alike.items()]
    return [part._replace(points=unit * part.points) for part in whole if len(part.triangles)]


def _contents(path: Path) -> tuple[str, bytes, float]:
    """Read a mesh file: return its kind, its bytes, and meters per unit."""
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise ValueError(f"{path}: is no mesh that can be read; expected one of {', '.join(KINDS)}: convert it")
    data, unit = path.read_bytes(), 1.0
    if kind == ".dae":
        data, unit = _without_colors(path, data)
    elif kind in (".glb", ".gltf"):
        data = _without_pictures(path, data)
    return kind[1:], data, unit


def _read(path: Path, data: bytes, kind: str, resolver: Any = None) -> list[Part]:
    """Parse the parts of a mesh, each where the file puts it, in the unit of the file."""
    try:
        if kind == "dae":
            import collada  # noqa: F401
        import trimesh
    except ImportError as error:
        raise ImportError(f"meshes are read by {error.name}: pip install featherstone-gait[mesh]") from error
    if kind == "gltf":
        resolver = _Beside(path, ".bin")
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False, resolver=resolver)
        parts, found = [], cast(Any, scene).dump()
        for part in found:
            points = np.asarray(part.vertices, dtype=float).reshape(-1, 3)
            faces = np.asarray(getattr(part, "faces", ()), dtype=int).reshape(-1, 3)  # points and lines have none
            parts.append(Part(points, faces, _color(part, kind)))
    except Exception as error:  # a damaged file can make the reader fail in any way
        raise ValueError(f"{path}: cannot be read as {kind.upper()}: {error!r}; export the mesh again") from error
    if not sum(len(part.points) for part in parts):
        raise ValueError(f"{path}: has no triangles; export the mesh again")
    return parts


def _joined(parts: list[Part]) -> tuple[np.ndarray, np.ndarray]:
    """Join the vertices (n, 3) and triangles (m, 3) of parts."""
    first = np.cumsum([0, *(len(part.points) for part in parts[:-1])])
    triangles = [part.triangles + k for part, k in zip(parts, first)]
    return np.concatenate([part.points for part in parts]), np.concatenate(triangles)


def _colored(path: Path, count: int) -> list[Part] | None:
    """Read the parts of a DAE with its materials; None if these make the reader drop some of the triangles."""
    try:
        found = _read(path, _without(fromstring(path.read_bytes(), forbid_dtd=True), _is_texture), "dae")
    except ValueError:
        return None
    return found if sum(len(part.triangles) for part in found) == count else None


class _Beside:
    """Files of one kind beside a mesh: the materials of an OBJ, the buffers of a glTF.  No other file is opened."""

    def __init__(self, path: Path, kind: str) -> None:
        self.folder, self.kind = path.parent, kind

    def __getitem__(self, name: str) -> bytes:
        """Read a file that the mesh names."""
        file = self.folder / Path(name.strip()).name
        if file.suffix.lower() != self.kind or not file.is_file() or file.stat().st_size > MAX_BYTES:
            raise FileNotFoundError(name)  # the reader goes on without
        return file.read_bytes()

    get = __getitem__


def _color(part: Any, kind: str) -> Color | None:
    """Return the color that the material of a part states."""
    material = getattr(getattr(part, "visual", None), "material", None)
    stated = getattr(material, "baseColorFactor", None)  # of a DAE or glTF
    if stated is None and material is not None and kind in ("glb", "gltf"):
        return WHITE  # as its specification has it
    if stated is None and getattr(material, "kwargs", None):  # it was in a file of materials
        stated = getattr(material, "diffuse", None)
    if stated is None:
        return None
    r, g, b, *_ = (int(x) for x in stated)
    return r, g, b


def _without_colors(path: Path, data: bytes) -> tuple[bytes, float]:
    """Strip a DAE of its materials, since broken ones make the reader drop triangles; also return meters per unit."""
    try:
        root = fromstring(data, forbid_dtd=True)
        stated = root.find("{*}asset/{*}unit")
        unit = 1.0 if stated is None else float(stated.get("meter", 1.0))
        check_dae(root)
    except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
        raise ValueError(f"{path}: cannot be read as DAE: {error}; export the mesh again") from error
    if not 0.0 < unit < math.inf:
        raise ValueError(f"{path}: a unit of {unit!r} m; expected > 0: correct <unit meter=...>")
    return _without(root, lambda child: tag_of(child) in COLORS), unit


def _is_texture(child: Element) -> bool:
    """Return whether an element of a DAE states a texture."""
    return tag_of(child) in TEXTURES or any(tag_of(x) == "texture" for x in child)


def _without(root: Element, drop: Callable[[Element], bool]) -> bytes:
    """Write XML without some elements."""
    for element in list(root.iter()):
        for child in [child for child in element if drop(child)]:
            element.remove(child)
    return tostring(root)


def _without_pictures(path: Path, data: bytes) -> bytes:
    """Strip a glTF of its pictures, of which the reader would unpack one for each instance.

    Raises ValueError for one that is too large, or compressed, whose numbers the reader would take for zeros.
    """
    binary = data[:4] == b"glTF"  # a header of 12 bytes, then the first chunk: length, "JSON", text
    end = 20 + int.from_bytes(data[12:16], "little") if binary else len(data)
    text = data[20:end] if binary else data
    try:
        content = json.loads(text)
        needed = [name for name in content.get("extensionsRequired", ()) if not name.startswith(LOOKS)]
        without = sum("bufferView" not in accessor for accessor in content.get("accessors", ()))
        check_gltf(content)
        for name in PICTURES:
            content.pop(name, None)
        content["materials"] = _without_textures(content.get("materials", []))
    except (ValueError, AttributeError, TypeError, LookupError, RecursionError) as error:
        raise ValueError(f"{path}: cannot be read as glTF: {error}; export the mesh again") from error
    if needed or without:
        why = f"needs {', '.join(map(str, needed))}" if needed else "has accessors without numbers"
        raise ValueError(f"{path}: {why}, which is not read; export the mesh without compression")
    text = json.dumps(content).encode()
    if not binary:
        return text
    text += b" " * (-len(text) % 4)
    rest = data[end:]
    sizes = (20 + len(text) + len(rest), len(text))
    return data[:8] + sizes[0].to_bytes(4, "little") + sizes[1].to_bytes(4, "little") + data[16:20] + text + rest


def _without_textures(content: Any) -> Any:
    """Return the materials of a glTF without what refers to textures."""
    if isinstance(content, dict):
        return {key: _without_textures(value) for key, value in content.items() if not key.endswith("Texture")}
    return [_without_textures(item) for item in content] if isinstance(content, list) else content
