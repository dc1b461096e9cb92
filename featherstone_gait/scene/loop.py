"""Lay loops out for the kernels."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..base.fixed_order import applied, product
from ..base.rotation import rotation_from_rpy, rotation_z_to
from ..core.tree.loop import CONNECT, DISTANCE, FRAME, HINGE, LENGTH, LOOP, PLACE, POINT, WELD, WORLD
from ..model import Loop, Model
from .records import records
from .tree import Tree, compile_tree

if TYPE_CHECKING:
    from .forest import Member

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
    table, places, rows = _records(model.loops, tree, WORLD if tree.floating else 0)
    return Loops(table, rows, (np.ones(len(table)), places.ravel()))


def joined_loops(members: Sequence[Member], tree: Tree, between: Sequence[Loop]) -> Loops | None:
    """Return the loops of all members and then those between links of the scene, "name/link"; None of none."""
    tables, places, rows = [], [], 0
    trees: Any = tree.trees
    for number, member in enumerate(members):
        if member.model.loops:
            own = build_loops(member.model)
            table = own.table.copy()
            table.tree_a = table.tree_b = number
            table.a += trees[number].root
            table.b = np.where(table.b == WORLD, WORLD, table.b + trees[number].root)
            table.first += rows
            rows += own.rows
            tables.append(table)
            places.append(own.held[1].reshape(-1, PLACE))
    if between:
        table, place, count = _records(between, tree, WORLD)
        table.tree_a = np.searchsorted(trees.end, table.a, side="right")
        table.tree_b = np.where(table.b == WORLD, table.tree_a, np.searchsorted(trees.end, table.b, side="right"))
        table.first += rows
        rows += count
        tables.append(table)
        places.append(place)
    if not tables:
        return None
    whole = np.concatenate(tables).view(np.recarray)
    return Loops(whole, rows, (np.ones(len(whole)), np.concatenate(places).ravel()))


def _records(loops: Sequence[Loop], tree: Tree, world: int) -> tuple[np.recarray, np.ndarray, int]:
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
