"""Lay the loops of a robot out for the kernels."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.fixed_order import applied, product
from ..base.records import records
from ..base.rotation import rotation_from_rpy, rotation_z_to
from ..core.tree.loop import CONNECT, DISTANCE, FRAME, HINGE, LENGTH, LOOP, PLACE, POINT, WELD, WORLD
from ..model import Loop, Model
from .tree import Tree, compile_tree

KINDS = {"connect": CONNECT, "weld": WELD, "hinge": HINGE, "distance": DISTANCE}


class Loops(NamedTuple):
    """The loops of a robot or a scene as kernels read them."""

    table: np.recarray  # (loops,) LOOP
    rows: int
    held: tuple[np.ndarray, np.ndarray]  # 1 of each (loops,), and their places (loops * PLACE,)


@functools.lru_cache(maxsize=64)
def build_loops(model: Model) -> Loops:
    """Build the LOOP records of a robot."""
    tree = compile_tree(model)
    table, places, rows = loop_records(model.loops, tree, WORLD if tree.floating else 0)
    return Loops(table, rows, (np.ones(len(table)), places.ravel()))


def loop_records(loops: Sequence[Loop], tree: Tree, world: int) -> tuple[np.recarray, np.ndarray, int]:
    """Return LOOP records, places (loops, PLACE) and the number of rows; world: row of the world's body."""
    table, places, first = records(len(loops), LOOP), np.zeros((len(loops), PLACE)), 0
    for row, place, loop in zip(table, places, loops):
        row.kind, row.first, place[LENGTH] = KINDS[loop.kind], first, loop.distance
        turn = rotation_z_to(loop.axis) if loop.kind == "hinge" else np.eye(3)
        turns = (product(rotation_from_rpy(rpy), turn) for rpy in (loop.rpy_a, loop.rpy_b))
        row.a, row.Ea, row.pa = _placed(tree, loop.a, next(turns), loop.point_a, world)
        row.b, place[FRAME:LENGTH], place[POINT:FRAME] = _placed(tree, loop.b, next(turns), loop.point_b, world)
        first += loop.rows
    return table, places, first


def _placed(
    tree: Tree, link: str | None, E: np.ndarray, point: Sequence[float], world: int
) -> tuple[int, np.ndarray, np.ndarray]:
    """Return the row of a link's body, and a frame and a point of the link there."""
    if link is None:
        return world, E.ravel(), np.array(point)
    place = tree.placements[link]
    return place.row, product(place.E, E).ravel(), place.r + applied(place.E, np.array(point))
