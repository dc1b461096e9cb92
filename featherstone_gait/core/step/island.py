"""Islands: trees that touch, which Newton's iteration of newton.py solves together, and the points between them.

What works on an island, by its number, works on one tree alone where that is None: a constant of compilation.  Points
between two bodies that can move, and loops, are rows beside the fold: see row_solver.py.

In lanes an island holds the trees that touch in any of them; those that do not touch in one lane have labels of their
own there, so that the bits of a lane do not depend on its neighbors.
"""

from ..compile.jit import apart, inline, kernel
from ..compile.lanes import select, width_of
from ..compile.optional import if_present, only_if
from ..effects.element import AT_WORK, FRACTION, SHARED, SLOPE, WRONG, shift_element, with_element
from ..effects.pair import ON, clear_own_row, fold_pair, is_near, linearize_pair, solve_pair
from ..tree.forest import base_index
from .context import of_tree

# ---------------------------------------------------------------------------------------------- who touches whom


@apart
def find_islands(pairs, step):
    """Sort trees and points at work by island: sets of trees that touch in any lane."""
    pool, count = step.pool, len(step.scene.trees)
    for k in range(count):
        pool.parent[k] = k
    for i in range(pool.count[0]):
        c = pool.placed[i]
        pair = pairs.pairs[pool.pair[c]]
        if pair.folded == 0 and is_near(pool, c):
            a, b = _root_of(pool.parent, pair.tree_a), _root_of(pool.parent, pair.tree_b)
            pool.parent[max(a, b)] = min(a, b)
    _join_trees(step.scene.loops, pool)
    islands = 0
    for k in range(count):  # a root comes before what hangs on it
        if pool.parent[k] == k:
            pool.island[k] = islands
            pool.first_tree[islands], pool.first_point[islands] = 0, 0
            islands += 1
        else:
            pool.island[k] = pool.island[_root_of(pool.parent, k)]
    pool.count[1] = islands
    for k in range(count):
        pool.first_tree[pool.island[k]] += 1
    for i in range(pool.count[0]):
        c = pool.placed[i]
        if is_near(pool, c):
            pool.first_point[pool.island[pairs.pairs[pool.pair[c]].tree_a]] += 1
    _ends(pool.first_tree, islands)
    _ends(pool.first_point, islands)
    for i in range(count):  # backwards, so that the order within an island stays
        k = count - 1 - i
        pool.first_tree[pool.island[k]] -= 1
        pool.trees[pool.first_tree[pool.island[k]]] = k
    for i in range(pool.count[0]):
        c = pool.placed[pool.count[0] - 1 - i]
        if is_near(pool, c):
            n = pool.island[pairs.pairs[pool.pair[c]].tree_a]
            pool.first_point[n] -= 1
            pool.points[pool.first_point[n]] = c
    _label(pairs, step.scene.loops, pool, width_of(step.y))


@inline
def _root_of(parent, k):
    while parent[k] != k:
        k = parent[k]
    return k


@if_present()
def _join_trees(loops, pool):
    """Put trees that loops join into one island, whether a loop is closed or not."""
    for c in range(len(loops.table)):
        a, b = _root_of(pool.parent, loops.table[c].tree_a), _root_of(pool.parent, loops.table[c].tree_b)
        pool.parent[max(a, b)] = min(a, b)


@inline
def _ends(counts, islands):
    """Turn counts into the index after the last of each."""
    total = 0
    for n in range(islands):
        total += counts[n]
        counts[n] = total
    counts[islands] = total


@inline
def _label(pairs, loops, pool, width):
    """Label trees by the island that they belong to in each lane, the number of its first tree."""
    if width > 1:
        for n in range(pool.count[1]):
            for i in range(pool.first_tree[n], pool.first_tree[n + 1]):
                pool.label[pool.trees[i]] = pool.trees[i]
            for _ in range(pool.first_tree[n], pool.first_tree[n + 1]):
                for i in range(pool.first_point[n], pool.first_point[n + 1]):
                    pair = pairs.pairs[pool.pair[pool.points[i]]]
                    if pair.folded == 0:
                        a, b = pool.label[pair.tree_a], pool.label[pair.tree_b]
                        on, least = pool.C[pool.points[i], ON] > 0.0, select(a < b, a, b)
                        pool.label[pair.tree_a] = select(on, least, a)
                        pool.label[pair.tree_b] = select(on, least, b)
                _label_joined(loops, pool)


@if_present()
def _label_joined(loops, pool):
    for c in range(len(loops.table)):
        a, b = pool.label[loops.table[c].tree_a], pool.label[loops.table[c].tree_b]
        least = select(a < b, a, b)
        pool.label[loops.table[c].tree_a], pool.label[loops.table[c].tree_b] = least, least


# ---------------------------------------------------------------------------------------------- its trees


def each_tree(function):
    """Make a function (island, step) that calls `function` with the step of each tree of an island, or of one alone."""

    @inline
    def of_each(island, step):
        if island is None:
            function(step)
        else:
            for i in range(step.pool.first_tree[island], step.pool.first_tree[island + 1]):
                function(of_tree(step, step.scene.trees[step.pool.trees[i]]))

    return of_each


@inline
def trees_of(island, step):
    """Return the index of an island's first tree, and the one after the last."""
    if island is None:
        return 0, 1
    return step.pool.first_tree[island], step.pool.first_tree[island + 1]


@inline
def tree_number(island, step, i):
    """Return the number of the tree of this index."""
    if island is None:
        return base_index(step.part)
    return step.pool.trees[i]


@kernel
def _share(n, column, step):
    """Give each tree of an island the sum of a column of N over all trees that it touches in the same lane."""
    pool, N, first, end = step.pool, step.N, step.pool.first_tree[n], step.pool.first_tree[n + 1]
    if width_of(step.y) == 1:
        total = 0.0 * N[0, column]
        for i in range(first, end):
            total = total + N[pool.trees[i], column]
        for i in range(first, end):
            N[pool.trees[i], column] = total
    else:
        for i in range(first, end):
            k = pool.trees[i]
            total = 0.0 * N[k, column]
            for j in range(first, end):
                other = pool.trees[j]
                total = total + select(pool.label[other] == pool.label[k], N[other, column], 0.0 * total)
            N[k, SHARED] = total
        for i in range(first, end):
            N[pool.trees[i], column] = N[pool.trees[i], SHARED]


# ---------------------------------------------------------------------------------------------- its points


@inline
def fold_points(n, pairs, step):
    """Linearize all points, and fold those on bodies that cannot move."""
    pool, first, end = step.pool, step.pool.first_point[n], step.pool.first_point[n + 1]
    for i in range(first, end):
        pair = pairs.pairs[pool.pair[pool.points[i]]]
        linearize_pair(pairs.turning, pair, step, pool.points[i])
        clear_own_row(pair, step.W)
    for i in range(first, end):
        pair = pairs.pairs[pool.pair[pool.points[i]]]
        if pair.folded > 0:
            fold_pair(pairs.turning, pair, step, pool.points[i])


@inline
def solve_points(n, pairs, step):
    """Fill velocities and the linear model's forces of all points at the solution."""
    pool = step.pool
    for i in range(pool.first_point[n], pool.first_point[n + 1]):
        solve_pair(pairs.turning, pairs.pairs[pool.pair[pool.points[i]]], step, pool.points[i])


@inline
def descend_points(n, searching, pairs, step):
    """Add the points to WRONG and SLOPE of their first tree, of which then each tree that it touches has the sum."""
    pool, N, zero = step.pool, step.N, 0.0 * step.y[step.offsets.newton_iterations]
    for i in range(pool.first_point[n], pool.first_point[n + 1]):
        c = pool.points[i]
        t = pairs.pairs[pool.pair[c]].tree_a
        fraction = only_if(searching, N[t, FRACTION])
        wrong, slope = with_element(fraction, pairs, c, step, N[t, WRONG] > 0.0, N[t, SLOPE])
        N[t, WRONG], N[t, SLOPE] = select(wrong, 1.0 + zero, zero), slope
    if searching is None:
        _share(n, WRONG, step)
    _share(n, SLOPE, step)


@inline
def shift_points(n, pairs, step):
    """Move the iterate of all points, in the lanes in which their first tree is at work."""
    pool, N = step.pool, step.N
    for i in range(pool.first_point[n], pool.first_point[n + 1]):
        c = pool.points[i]
        t = pairs.pairs[pool.pair[c]].tree_a
        shift_element(pairs, c, N[t, FRACTION], N[t, AT_WORK] > 0.0, step)
