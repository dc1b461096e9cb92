"""The rows of a step: couplings of joints, loops, tendons and what touches, as one system (tree/rows.py).

A tree alone has a system of its own; loops that join trees, and points between bodies that can move, put the rows of
several trees into one.  Rows without slope and force, and loops that are open, are none of the system's.
"""

from ..compile.jit import apart, inline
from ..compile.optional import any_present, if_present, item
from ..effects.pair_rows import list_pairs, respond_pairs
from ..effects.tendon import list_tendons, respond_tendons
from ..tree.constrain import list_joined, list_rigid, respond_rigid
from ..tree.forest import LARGEST, base_index, own_loops, system_of
from ..tree.loop import list_loops
from ..tree.rows import IN_STEP, RIGID, apply_forces, factor_system, fill_system, solve_system
from .closure import held_in, keep_forces, keep_system


@inline
def act_alone(contact, step):
    """Let the rows of a tree act on what the first pass of the ABA has left; `contact`: as this had it."""
    scene = step.scene
    _act_alone(any_present(any_present(scene.coupling, scene.loops), scene.tendons), contact, step)


@if_present()
def _act_alone(any_row, contact, step):
    number = base_index(step.part)
    which, start = step.rows.number[number : number + 1], system_of(step.part)
    end = _list(step.scene.coupling, step.scene.loops, which, start, step)
    system = start[0], end[0], start[1], end[1] - start[1]
    _solve(which, system, contact, step)
    keep_system(number, system, step.rows)


@if_present()
def act_joined(joined, contact, step):
    """Do the same for all trees of a scene in which loops join some; joined None: there are none."""
    scene, which = step.scene, step.rows.number
    end = _list(scene.coupling, scene.loops, which, (0, 0), step)
    held = held_in(scene.loops, step.offsets, step.y)
    end = list_joined(scene.loops, scene.trees, held, end, step.rows)
    system = 0, end[0], 0, end[1]
    _solve(which, system, contact, step)
    keep_system(0, system, step.rows)


@apart
def act_together(n, pairs, step):
    """Let the rows of an island act, those of its pairs among them."""
    scene, pool = step.scene, step.pool
    which = pool.trees[pool.first_tree[n] : pool.first_tree[n + 1]]
    end = _list(scene.coupling, scene.loops, which, (0, 0), step)
    end = _list_between(scene.loops, n, end, step)
    end = list_pairs(pairs, n, end, step)
    system = 0, end[0], 0, end[1]
    respond_pairs(pairs, system, step)
    _solve(which, system, True, step)


@inline
def _list(coupling, loops, which, end, step):
    """List the rows that trees have alone."""
    scene, rows = step.scene, step.rows
    end = list_rigid(coupling, loops, which, held_in(loops, step.offsets, step.y), scene, end, rows)
    for k in which:
        end = list_tendons(scene.tendons, item(scene.trees, k), end, rows)
    return end


@inline
def _list_between(loops, n, end, step):
    """List the loops that join trees of an island."""
    if loops is not None:
        closed, _ = held_in(loops, step.offsets, step.y)
        for c in range(own_loops(step.scene.trees, loops.table), len(loops.table)):
            if step.pool.island[loops.table[c].tree_a] == n:
                end = list_loops(loops.table, c, c + 1, closed, end, step.rows)
    return end


@apart
def _solve(which, system, contact, step):
    """Find the forces of rows and let them act."""
    scene, rows, W = step.scene, step.rows, step.W
    if system[3] > 0:
        respond_rigid(scene, system, IN_STEP, contact, W, rows)
        respond_tendons(scene.tendons, system, contact, step)
        fill_system(scene, system, W, rows)
        factor_system(system, rows)
        solve_system(system, IN_STEP[1] if _has_rigid(system, rows) else 1, rows)
        apply_forces(scene, system, W, rows)
    keep_forces(scene.loops, which, system, step)


@inline
def _has_rigid(system, rows):
    found = False
    for b in range(system[0] & LARGEST, system[1] & LARGEST):
        found = found or rows.block[b, RIGID] == 1
    return found
