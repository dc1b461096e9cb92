"""Read what MuJoCo's viewer shows of a compiled MJCF file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...geometry.mesh import Color
from ...model.shapes import Geometry
from .names import names_of
from .read import compiled
from .shapes import ELLIPSOID, MESH, geometry_of

SHOWN = 3  # groups 0, 1 and 2 are shown by default; collision geoms beside visual ones have 3 or more
GREY = (0.5, 0.5, 0.5, 1.0)  # a geom's rgba where the file says nothing


class Triangles(NamedTuple):
    """A mesh of the file."""

    points: np.ndarray  # (n, 3) [m]
    triangles: np.ndarray  # (m, 3)


class Ellipsoid(NamedTuple):
    """An ellipsoid about its origin."""

    radii: np.ndarray  # (3,) [m]


class Geom(NamedTuple):
    """A visible geom."""

    link: str
    geometry: Geometry | Triangles | Ellipsoid
    position: np.ndarray  # (3,) in the link's frame [m]
    quaternion: np.ndarray  # (4,) w x y z
    color: Color | None  # None where the file gives none
    opacity: float


def read_geoms(path: Path) -> list[Geom]:
    """Read the geoms in the visible groups, except planes and height fields; raises as `read_mjcf`."""
    m, _ = compiled(path)
    bodies, found = names_of(m, "body", m.nbody), []
    for g in np.flatnonzero(m.geom_group < SHOWN):
        geometry, (color, opacity) = _geometry(m, int(g)), _color(m, int(g))
        if geometry is not None and opacity > 0.0:
            placed = (m.geom_pos[g].copy(), m.geom_quat[g].copy())
            found.append(Geom(bodies[m.geom_bodyid[g]], geometry, *placed, color, opacity))
    return found


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
