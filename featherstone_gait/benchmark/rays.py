"""Measure rays a second against 20 shapes, beside MuJoCo's `mj_multiRay`, and spots of line sensors a second.

All rays begin at one point and go in all directions; shapes of 0.1 to 0.8 m are spread over 4 m.  MuJoCo keeps meshes,
here hulls of 12 corners, in single precision.  Spots are discs of 5 mm within 20 mm of a line of 20 pieces; "hit" is
then the share of them that is dark.

    featherstone-gait benchmark rays        a minute
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..base.rotation import rotation_from_rpy
from ..core.shapes.distance import Room
from ..core.shapes.paint import cover
from ..core.shapes.ray import cast_rays
from ..geometry.distance import shape_tables
from ..geometry.hull import hull_triangles
from ..model import FloorLine, HeightField
from ..model.shapes import Box, Capsule, Cylinder, Geometry, Hull, Shape, Sphere
from ..run.range_sensor import strips
from .engines import mujoco
from .table import in_turn, installed, machine, tabulate

COUNT, RAYS, REPEATS, REPEATS_FULL = 20, 2000, 9, 51
Make = Callable[[np.random.Generator], Geometry]
MAKERS: dict[str, Make] = {
    "spheres": lambda rng: Sphere(rng.uniform(0.1, 0.4)),
    "boxes": lambda rng: Box(tuple(rng.uniform(0.1, 0.8, 3).tolist())),
    "capsules": lambda rng: Capsule(rng.uniform(0.05, 0.2), rng.uniform(0.1, 0.6)),
    "cylinders": lambda rng: Cylinder(rng.uniform(0.05, 0.4), rng.uniform(0.1, 0.8)),
    "hulls of 12 corners": lambda rng: Hull(tuple(map(tuple, rng.normal(scale=0.3, size=(12, 3)).tolist()))),
}
KINDS = {"spheres, boxes, capsules": tuple(MAKERS)[:3]} | {name: (name,) for name in MAKERS}
FIELD = "a height field of 100 x 100"
LINE = "pieces of a line, by spots"


class Row(NamedTuple):
    """One line of the table."""

    shapes: Annotated[str, "against 20", "<28"]
    rays: Annotated[float, "M rays/s", "9.2f"]  # a second of one core [1e6/s]
    mujoco: Annotated[float, "MuJoCo", "8.2f"]  # [1e6/s], NaN without
    hits: Annotated[float, "hit", "6.0%"]  # share of rays that meet something
    apart: Annotated[float, "apart", "9.1e"]  # largest difference of the two engines [m], NaN without


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the table; write rays.csv into `out_dir`; `full` repeats more often."""
    repeats, host = REPEATS_FULL if full else REPEATS, machine()
    print(host)
    rows = (spots(repeats) if name == LINE else measure(name, repeats) for name in (*KINDS, FIELD, LINE))
    return tabulate(out_dir / "rays.csv", Row, rows, host)


def scattered(kind: str) -> list[Shape]:
    """Return the shapes of a line of the table, always the same."""
    rng = np.random.default_rng(0)
    if kind == FIELD:
        heights = rng.uniform(-1.5, -0.5, (100, 100))
        return [Shape("world", HeightField(heights, (0.1, 0.1), (-5.0, -5.0)))]
    makers = [MAKERS[name] for name in KINDS[kind]]
    return [
        Shape("world", makers[k % len(makers)](rng), tuple(rng.uniform(-2.0, 2.0, 3)), tuple(rng.uniform(-1.5, 1.5, 3)))
        for k in range(COUNT)
    ]


def measure(kind: str, repeats: int) -> Row:
    """Time rays against shapes of a kind."""
    shapes, rng = scattered(kind), np.random.default_rng(1)
    directions = rng.normal(size=(RAYS, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    own, found = _own(shapes, directions)
    calls, theirs = [own], None
    if installed("mujoco") and kind != FIELD:
        peer, theirs = _of_mujoco(shapes, directions)
        calls.append(peer)
    rates = 1e-6 * RAYS / in_turn(calls, repeats, warm=2).min(axis=0)
    apart = math.nan
    if theirs is not None:
        own()
        peer()
        both = np.isfinite(found[0]) & (theirs >= 0.0) & (found[0] > 0.0)  # within a shape MuJoCo gives its far side
        apart = float(np.abs(found[0] - theirs)[both].max())
    return Row(kind, rates[0], rates[1] if theirs is not None else math.nan, np.isfinite(found).mean(), apart)


def spots(repeats: int) -> Row:
    """Time the spots of line sensors."""
    rng = np.random.default_rng(1)
    knots, bends = 0.1 * np.arange(COUNT + 1), rng.uniform(-0.05, 0.05, COUNT + 1)
    quads, out = strips([FloorLine(tuple(zip(knots.tolist(), bends.tolist())), 0.02)]), np.zeros(RAYS)
    x = rng.uniform(0.0, 0.1 * COUNT, RAYS)
    y = np.interp(x, knots, bends) + rng.uniform(-0.02, 0.02, RAYS)
    discs, near = np.column_stack([x, y, np.full(RAYS, 5e-3)]), np.zeros(len(quads), np.int64)
    taken = in_turn([lambda: cover(quads, discs, near, out)], repeats, warm=2).min()
    return Row(LINE, float(1e-6 * RAYS / taken), math.nan, float(out.mean()), math.nan)


def _own(shapes: list[Shape], directions: np.ndarray) -> tuple[Callable[[], None], np.ndarray]:
    """Return a call that fills the distances (1, rays), and these."""
    table, count = shape_tables(shapes, [0] * len(shapes)), len(shapes)
    room = Room(np.zeros((count, 9)), np.zeros((count, 3)), np.zeros((4, 3)))
    pose, rays = (np.eye(3)[None, None], np.zeros((1, 1, 3))), np.zeros((2, 8, len(directions)))
    mounted, out = np.hstack([np.zeros_like(directions), directions]), np.zeros((1, len(directions)))
    return lambda: cast_rays(table, room, pose, 0, mounted, math.inf, rays, out), out


def _of_mujoco(shapes: list[Shape], directions: np.ndarray) -> tuple[Callable[[], None], np.ndarray]:
    """Return a call that fills MuJoCo's distances (rays,), and these; -1 where nothing is met."""
    spec, kinds = mujoco.MjSpec(), mujoco.mjtGeom
    for k, shape in enumerate(shapes):
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, rotation_from_rpy(shape.rpy).ravel())
        geom: dict[str, Any] = {"pos": shape.xyz, "quat": quaternion}
        match shape.geometry:
            case Sphere(radius):
                geom |= {"type": kinds.mjGEOM_SPHERE, "size": [radius, 0.0, 0.0]}
            case Box(size):
                geom |= {"type": kinds.mjGEOM_BOX, "size": 0.5 * np.array(size)}
            case Capsule(radius, length):
                geom |= {"type": kinds.mjGEOM_CAPSULE, "size": [radius, 0.5 * length, 0.0]}
            case Cylinder(radius, length):
                geom |= {"type": kinds.mjGEOM_CYLINDER, "size": [radius, 0.5 * length, 0.0]}
            case Hull(points):
                faces = hull_triangles(np.array(points))
                spec.add_mesh(name=f"hull{k}", uservert=np.ravel(points), userface=faces.ravel())
                geom |= {"type": kinds.mjGEOM_MESH, "meshname": f"hull{k}"}
        spec.worldbody.add_geom(**geom)
    m = spec.compile()
    d, out, hit = mujoco.MjData(m), np.zeros(len(directions)), np.zeros(len(directions), np.int32)
    mujoco.mj_forward(m, d)
    along, at = directions.ravel(), np.zeros(3)
    return lambda: mujoco.mj_multiRay(m, d, at, along, None, 1, -1, hit, out, None, len(out), 1e10), out
