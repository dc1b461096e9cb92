"""Lay loops out for the kernels."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..base.fixed_order import applied, product
from ..base.rotation import rotation_from_rpy, rotation_z_to
from ..core.tree.forest import TREE
from ..core.tree.loop import CONNECT, DISTANCE, HINGE, LOOP, WELD, WORLD
from ..model import Model
from .records import records
from .tree import Tree, compile_tree

KINDS = {"connect": CONNECT, "weld": WELD, "hinge": HINGE, "distance": DISTANCE}


class Loops(NamedTuple):
    """The loops of a robot as kernels read them."""

    table: np.recarray  # (loops,) LOOP
    trees: np.recarray  # (1,) TREE
    rows: int


@functools.lru_cache(maxsize=64)
def build_loops(model: Model) -> Loops:
    """Build the LOOP records of a robot."""
    tree = compile_tree(model)
    table, first = records(len(model.loops), LOOP), 0
    for row, loop in zip(table, model.loops):
        row.kind, row.first, row.distance = KINDS[loop.kind], first, loop.distance
        turn = rotation_z_to(loop.axis) if loop.kind == "hinge" else np.eye(3)
        row.a, row.Ea, row.pa = _placed(tree, loop.a, product(rotation_from_rpy(loop.rpy_a), turn), loop.point_a)
        row.b, row.Eb, row.pb = _placed(tree, loop.b, product(rotation_from_rpy(loop.rpy_b), turn), loop.point_b)
        first += loop.rows
    trees = records(1, TREE)
    couplings = 0 if tree.coupling is None else len(tree.coupling)
    trees.end, trees.fixed, trees.end_joint, trees.end_coupling = tree.n + 1, not tree.floating, tree.n, couplings
    return Loops(table, trees, first)


def _placed(tree: Tree, link: str | None, E: np.ndarray, point: Sequence[float]) -> tuple[int, np.ndarray, np.ndarray]:
    """Return the row of a link's body, and a frame and a point of the link there."""
    if link is None:
        return (WORLD if tree.floating else 0), E.ravel(), np.array(point)
    place = tree.placements[link]
    return place.row, product(place.E, E).ravel(), place.r + applied(place.E, np.array(point))
