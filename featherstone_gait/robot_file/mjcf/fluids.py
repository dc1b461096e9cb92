"""Read and write the medium of an MJCF file, and how its bodies feel it.

MuJoCo takes a body without geoms of fluidshape="ellipsoid" for the box of its mass and inertia, one with such geoms for
their ellipsoids.  Its medium is everywhere and lifts nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...base.rotation import rotation_from_quaternion, rotation_from_rpy, rpy_from_rotation
from ...model import Fluid, Immersed, Link, Model, inertia_matrix
from ...model.shapes import Box
from ..markup import element
from .tree import Tree, unused, vector
from .write_geoms import geom_names

SAME = 1e-9  # by which inertias and places may differ, as a share and [m]
MINVAL = 1e-15  # mjMINVAL, of a mass and of the square of a box's edge
FLUID = slice(1, 6)  # of geom_fluid: blunt, slender, angular, Kutta and Magnus


def fluid_of(m: Any) -> Fluid | None:
    """Return the medium of a file, None without."""
    if not (m.opt.density or m.opt.viscosity):
        return None
    return Fluid(float(m.opt.density), float(m.opt.viscosity), None, vector(m.opt.wind))


def read_immersed(m: Any, tree: Tree, top: int | None = None) -> tuple[Immersed, ...]:
    """Return what of a tree MuJoCo's medium acts on; top: body with which a tree of several begins."""
    if fluid_of(m) is None:
        return ()
    held = [b for b in range(1, m.nbody) if (tree.holds(m, b) if top is None else m.body_rootid[b] == top)]
    return tuple(one for b in held if m.body_mass[b] >= MINVAL for one in _of_body(m, tree.bodies[b], b))


def other_fluid(m: Any) -> Iterator[str]:
    """Yield the file's medium, for a Model has none."""
    fluid = fluid_of(m)
    if fluid is not None:
        yield (
            f"the file has a fluid: give fluid=Fluid({fluid.density!r}, {fluid.viscosity!r}, "
            f"current={fluid.current!r}) to compile_scene"
        )


def _of_body(m: Any, link: str, b: int) -> Iterator[Immersed]:
    geoms = [g for g in range(m.ngeom) if m.geom_bodyid[g] == b]
    if any(m.geom_fluid[g, 0] > 0 for g in geoms):
        for g in geoms:
            if m.geom_fluid[g, 0] > 0:
                rpy, coefficients = rpy_from_rotation(rotation_from_quaternion(m.geom_quat[g])), m.geom_fluid[g, FLUID]
                edges, xyz = 2.0 * _semiaxes(m, g), vector(m.geom_pos[g])
                yield Immersed(
                    link, Box(vector(edges)), xyz, rpy, m.geom(g).name, buoyant=False, law="ellipsoid",
                    fluidcoef=tuple(coefficients.tolist()),
                )  # fmt: skip
        return
    x, y, z = (float(moment) for moment in m.body_inertia[b])
    squares = [6.0 / float(m.body_mass[b]) * s for s in (y + z - x, x + z - y, x + y - z)]
    edges = np.array([math.sqrt(max(s, MINVAL)) for s in squares])
    rpy = rpy_from_rotation(rotation_from_quaternion(m.body_iquat[b]))
    yield Immersed(link, Box(vector(edges)), vector(m.body_ipos[b]), rpy, buoyant=False, law="box")


def _semiaxes(m: Any, g: int) -> np.ndarray:
    r, half = m.geom_size[g, 0], m.geom_size[g, 1]
    match m.geom_type[g]:
        case 2:  # mjGEOM_SPHERE
            return np.array([r, r, r])
        case 3:  # mjGEOM_CAPSULE
            return np.array([r, r, half + r])
        case 5:  # mjGEOM_CYLINDER
            return np.array([r, r, half])
    return np.array(m.geom_size[g])


# ---------------------------------------------------------------------------------------------- writing


def is_mujocos(model: Model) -> bool:
    """Return whether what a fluid acts on are ellipsoids of bodies, or the boxes of their inertias, as in MuJoCo."""
    for link in model.links:
        own = [one for one in model.immersed if one.link == link.name]
        laws = {one.law for one in own}
        if link.mass < MINVAL:
            if own:
                return False
        elif laws != {"ellipsoid"} and not (laws == {"box"} and len(own) == 1 and _is_inertia(link, own[0])):
            return False
    return True


def _is_inertia(link: Link, box: Immersed) -> bool:
    """Return whether a link has the inertia of a box of its mass."""
    assert isinstance(box.geometry, Box)  # whose law takes no other
    squares = np.square(box.geometry.size)
    E = rotation_from_rpy(box.rpy)
    moments = link.mass / 12.0 * (np.sum(squares) - squares)
    turned, J = (E * moments) @ E.T, inertia_matrix(link.inertia)
    near = np.abs(turned - J).max() <= SAME * np.abs(J).max()
    return bool(near and np.allclose(box.xyz, link.center_of_mass, rtol=0.0, atol=SAME))


def immersed_geoms(model: Model, link: str) -> list[str]:
    """Write the ellipsoids of a link, which touch nothing."""
    lines, taken = [], geom_names(model)
    for one in (one for one in model.immersed if one.link == link and one.law == "ellipsoid"):
        assert isinstance(one.geometry, Box)
        size, still = tuple(0.5 * edge for edge in one.geometry.size), {"contype": "0", "conaffinity": "0", "mass": "0"}
        place = {"type": "ellipsoid", "size": size, "pos": one.xyz, "euler": one.rpy}
        fluid = {"fluidshape": "ellipsoid", "fluidcoef": one.fluidcoef}
        lines += element("geom", {"name": unused(one.name, taken) if one.name else None, **place, **still, **fluid})
    return lines
