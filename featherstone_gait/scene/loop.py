"""Lay loops out for the kernels."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.fixed_order import applied, product
from ..base.rotation import rotation_from_rpy, rotation_z_to
from ..core.tree.forest import TREE
from ..core.tree.loop import CONNECT, DISTANCE, FRAME, HINGE, LENGTH, LOOP, PLACE, POINT, WELD, WORLD
from ..model import Model
from .records import records
from .tree import Tree, compile_tree

KINDS = {"connect": CONNECT, "weld": WELD, "hinge": HINGE, "distance": DISTANCE}


class Loops(NamedTuple):
    """The loops of a robot as kernels read them."""

    table: np.recarray  # (loops,) LOOP
    trees: np.recarray  # (1,) TREE
    rows: int
    held: tuple[np.ndarray, np.ndarray]  # 1 of each (loops,), and their places (loops * PLACE,)


@functools.lru_cache(maxsize=64)
def build_loops(model: Model) -> Loops:
    """Build the LOOP records of a robot."""
    tree = compile_tree(model)
    table, places, first = records(len(model.loops), LOOP), np.zeros((len(model.loops), PLACE)), 0
    for row, place, loop in zip(table, places, model.loops):
        row.kind, row.first, place[LENGTH] = KINDS[loop.kind], first, loop.distance
        turn = rotation_z_to(loop.axis) if loop.kind == "hinge" else np.eye(3)
        turns = (product(rotation_from_rpy(rpy), turn) for rpy in (loop.rpy_a, loop.rpy_b))
        row.a, row.Ea, row.pa = _placed(tree, loop.a, next(turns), loop.point_a)
        row.b, place[FRAME:LENGTH], place[POINT:FRAME] = _placed(tree, loop.b, next(turns), loop.point_b)
        first += loop.rows
    trees = records(1, TREE)
    couplings = 0 if tree.coupling is None else len(tree.coupling)
    trees.end, trees.fixed, trees.end_joint, trees.end_coupling = tree.n + 1, not tree.floating, tree.n, couplings
    return Loops(table, trees, first, (np.ones(len(table)), places.ravel()))


def _placed(tree: Tree, link: str | None, E: np.ndarray, point: Sequence[float]) -> tuple[int, np.ndarray, np.ndarray]:
    """Return the row of a link's body, and a frame and a point of the link there."""
    if link is None:
        return (WORLD if tree.floating else 0), E.ravel(), np.array(point)
    place = tree.placements[link]
    return place.row, product(place.E, E).ravel(), place.r + applied(place.E, np.array(point))
