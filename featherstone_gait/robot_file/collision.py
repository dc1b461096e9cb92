"""Read the collision shapes of a URDF, and find their meshes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from xml.etree.ElementTree import Element

from ..model.checks import check_angles
from ..model.shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from .grammar import label, pass_over_paint
from .markup import children, number, vector
from .report import Report

NEAR = 4  # folders above a URDF whose folders are searched for packages, too


class MeshFinder:
    """Find the files that a URDF names: relative to it, by file://, or by package://NAME/.

    Packages are searched in `package_dirs`, in the folders above the URDF, in the subfolders of the NEAR closest of
    these, and in those of the environment variable ROS_PACKAGE_PATH.  No mesh is opened.
    """

    def __init__(self, urdf: Path, package_dirs: str | os.PathLike | Sequence[str | os.PathLike] = ()) -> None:
        self._folder = Path(os.path.abspath(urdf)).parent
        given = [package_dirs] if isinstance(package_dirs, str | os.PathLike) else package_dirs
        self.package_dirs = tuple(os.fspath(folder) for folder in given)
        self._found: dict[str, list[Path]] = {}  # package -> folders

    def find(self, name: str) -> Path | None:
        """Return the path of the file that a URDF calls by this name, or None."""
        scheme, separator, rest = name.partition("://")
        if not separator:
            candidates = [self._folder / name]
        elif scheme == "file":
            candidates = [Path(unquote(rest))]
        elif scheme in ("package", "model"):
            package, _, inner = rest.lstrip("/").partition("/")
            candidates = [folder / inner for folder in self._packages(package)]
        else:
            candidates = []
        return next((path for path in candidates if os.path.isfile(path)), None)

    def _packages(self, name: str) -> list[Path]:
        if name not in self._found:
            folders = (folder / name if folder.name != name else folder for folder in self._places())
            self._found[name] = [folder for folder in folders if name and os.path.isdir(folder)]
        return self._found[name]

    def _places(self) -> Iterator[Path]:
        """Yield folders that may hold a package, or be one."""
        above = [self._folder, *self._folder.parents]
        yield from (Path(folder) for folder in self.package_dirs)
        yield from above
        yield from (Path(place) for place in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if place)
        for folder in above[:NEAR]:
            if os.access(folder, os.R_OK):
                yield from sorted(Path(entry.path) for entry in os.scandir(folder) if entry.is_dir())


def read_shapes(link: Element, meshes: MeshFinder, frictions: Mapping[Any, float], report: Report) -> Iterator[Shape]:
    """Read the shapes of a link; frictions: by <collision>, or by the name of a link.

    A wrong one is reported and left out, since it has no effect until something touches.
    """
    what = label(link)
    for element in link.iterfind("collision"):
        pass_over_paint(element)
        try:
            shape = shape_of(element, link.get("name", "?"), what, meshes, report)
            yield replace(shape, friction=frictions.get(element, frictions.get(shape.link)))
        except ValueError as error:
            found = str(error).removeprefix(f"{what}: ")
            report.assume(element, what, found, "the shape was left out", "or remove the shape")


def shape_of(element: Element, link: str, what: str, meshes: MeshFinder, report: Report) -> Shape:
    """Read the shape of a <collision> or <visual>; raise ValueError for one that is wrong."""
    zero, origin, name = (0.0, 0.0, 0.0), element.find("origin"), element.get("name", "")
    xyz, rpy = (zero, zero) if origin is None else (vector(origin, "xyz", what), vector(origin, "rpy", what))
    check_angles(f"{what}: <origin>", "rpy", rpy)
    stated = [child for geometry in element.iterfind("geometry") for child in children(geometry, _GEOMETRIES)]
    if len(stated) != 1:
        raise ValueError(
            f"{what}: <{element.tag}> has {len(stated)} geometries; expected one of "
            f"{', '.join(f'<{tag}>' for tag in _GEOMETRIES)}: correct it"
        )
    kind, reads = _GEOMETRIES[stated[0].tag]
    geometry = kind(*(read(stated[0], name, what) for name, read in reads.items()))
    if isinstance(geometry, Mesh):
        path = meshes.find(geometry.file)
        if path is None:
            report.remark(f"mesh {geometry.file!r} of a <collision> is not there: its path is kept as written")
        geometry = replace(geometry, file=str(path or geometry.file))
    return Shape(link, geometry, xyz, rpy, name)


def _filename(element: Element, name: str, what: str) -> str:
    if not (file := element.get(name)):
        raise ValueError(f"{what}: <mesh> has no filename; it is required: add it")
    return file


_GEOMETRIES: dict[str, tuple[type, dict[str, Callable]]] = {  # and their attributes
    "box": (Box, {"size": vector}),
    "sphere": (Sphere, {"radius": number}),
    "cylinder": (Cylinder, {"radius": number, "length": number}),
    "capsule": (Capsule, {"radius": number, "length": number}),
    "mesh": (Mesh, {"filename": _filename, "scale": partial(vector, default="1 1 1")}),
}
