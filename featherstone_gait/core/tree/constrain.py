"""The rigid rows of trees: couplings of joints and loops, in one system of rows.py."""

from ..compile.jit import inline
from ..compile.optional import if_present, item
from .coupling import list_couplings, respond_couplings
from .forest import loops_of, own_loops
from .loop import list_loops, respond_loops
from .rows import factor_system, fill_system


@inline
def list_rigid(coupling, loops, which, held, scene, end, rows):
    """Add the couplings and loops of trees to the blocks of a system, and return its end.

    which: numbers of the trees; held: of `fill_loops`.
    """
    for k in which:
        part = item(scene.trees, k)
        end = list_couplings(coupling, part, end, rows)
        end = _list_loops(loops, part, held, end, rows)
    return end


@inline
def _list_loops(loops, part, held, end, rows):
    if loops is not None:
        first, last = loops_of(part, loops.table)
        end = list_loops(loops.table, first, last, held[0], end, rows)
    return end


@inline
def list_joined(loops, trees, held, end, rows):
    """Add the loops between trees."""
    if loops is not None:
        end = list_loops(loops.table, own_loops(trees, loops.table), len(loops.table), held[0], end, rows)
    return end


@inline
def respond_rigid(scene, system, softness, contact, W, rows):
    """Fill the responses of couplings and loops."""
    respond_couplings(scene.coupling, scene, system, softness, contact, W, rows)
    _respond_loops(scene.loops, scene, system, softness, contact, W, rows)


@if_present()
def _respond_loops(loops, scene, system, softness, contact, W, rows):
    respond_loops(loops.table, scene, system, softness, contact, W, rows)


@inline
def factor_rigid(scene, system, softness, W, rows):
    """Fill the factor of a system of couplings and loops, in the factors of the first pass without contact rows."""
    respond_rigid(scene, system, softness, None, W, rows)
    fill_system(scene, system, W, rows)
    factor_system(system, rows)
