"""Lay the loops of a scene of several robots out for the kernels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.tree.loop import PLACE, WORLD
from ..core.tree.loop import Loops as KernelLoops
from ..dynamics.loop_table import Loops, build_loops, loop_records
from ..dynamics.tree import Tree
from ..model import Loop

if TYPE_CHECKING:
    from .forest import Member


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
        table, place, count = loop_records(between, tree, WORLD)
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


def loops_of_kernels(found: Loops | None, tree: Tree) -> KernelLoops | None:
    """Return the loops for kernels, None without."""
    if found is None:
        return None
    joined = True if tree.trees is not None and len(found.table) > tree.trees.end_loop[-1] else None
    return KernelLoops(found.table, np.array([found.rows]), joined)
