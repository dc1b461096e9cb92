"""The linearly implicit step of trees that touch: Newton's iteration of newton.py over all trees of an island.

Points between two bodies that can move, and loops, are rows beside the fold: see row_solver.py.

Trees that touch nothing of each other are iterated each for itself, as if they were alone, and without the workspace
rows of pairs.  In lanes an island holds the trees that touch in any of them; those that do not touch in one lane have
labels of their own there, so that the bits of a lane do not depend on its neighbors.
"""

from ..compile.jit import apart, inline, kernel
from ..compile.lanes import any_lane, select, width_of
from ..compile.optional import any_present, if_present
from ..compile.taped import noting
from ..effects.actuator import rotor_of
from ..effects.contact import linearize_contacts, place_contacts
from ..effects.fluid import place_fluid
from ..effects.pair import (
    ON,
    clear_own_row,
    compare_pair,
    fold_pair,
    is_near,
    linearize_pair,
    pair_slope,
    place_pairs,
    shift_pair,
    solve_pair,
)
from ..tree.aba import acceleration_pass
from .closure import joined_by, place_joined
from .context import of_tree, with_bodies
from .newton import (
    BISECTIONS,
    DA,
    DIAGONAL,
    MAX_PASSES,
    VP,
    acting,
    articulate,
    ask_again,
    bases_at,
    compare,
    descent_slope,
    external_forces,
    fill_solution,
    find_velocities,
    linearize,
    lookahead,
    move_iterate,
    place_tendons_at,
    predict,
    prepare,
)
from .row_solver import act_together


@kernel
def solve_islands(pairs, step):
    """Solve the step of all trees, those together that touch."""
    scene, pool, trees = step.scene, step.pool, step.scene.trees
    for k in range(len(trees)):
        part = of_tree(step, trees[k])
        predict(step.predicted, rotor_of(step.actuator), part)
        place_contacts(scene.contact, step.predicted, part)
        place_tendons_at(part)
        place_fluid(scene.fluid, step.predicted, part)
    external_forces(scene.push, scene.lifts, scene.propellers, step, step.Z[VP])
    place_joined(joined_by(scene.loops), scene.loops, bases_at(step.predicted, step), step)
    if any_lane(step.y[step.offsets.pair] > 0.0) or _joins(scene.loops):
        place_pairs(pairs, step.predicted, step, lookahead(step.predicted, step.h_implicit))
        find_islands(pairs, step)
    else:
        _each_alone(pool, len(trees))
    forces = any_present(any_present(acting(step), step.tau), scene.contact)
    alone = with_bodies(step, pairs.bodies)
    for n in range(pool.count[1]):
        first = pool.first_tree[n]
        if pool.first_point[n + 1] > pool.first_point[n] or _joins(scene.loops):
            _solve_island(n, rotor_of(step.actuator), scene.contact, pairs, step)
        else:
            find_velocities(forces, rotor_of(step.actuator), scene.contact, of_tree(alone, trees[pool.trees[first]]))


@inline
def _each_alone(pool, count):
    """Make an island of each tree where the pool holds no pair."""
    pool.count[0], pool.count[1], pool.count[2] = 0, count, 0
    for k in range(count):
        pool.island[k], pool.trees[k], pool.first_tree[k], pool.first_point[k] = k, k, k, 0
    pool.first_tree[count], pool.first_point[count] = count, 0


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


@if_present(False)
def _joins(loops):
    """Return whether loops join trees."""
    return loops.joined is not None


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


@kernel
def _share(n, values, step):
    """Give each tree of an island the sum over all trees that it touches in the same lane."""
    pool, first, end = step.pool, step.pool.first_tree[n], step.pool.first_tree[n + 1]
    if width_of(step.y) == 1:
        total = 0.0 * values[0]
        for i in range(first, end):
            total = total + values[pool.trees[i]]
        for i in range(first, end):
            values[pool.trees[i]] = total
    else:
        for i in range(first, end):
            k = pool.trees[i]
            total = 0.0 * values[k]
            for j in range(first, end):
                other = pool.trees[j]
                total = total + select(pool.label[other] == pool.label[k], values[other], 0.0 * total)
            pool.shared[k] = total
        for i in range(first, end):
            values[pool.trees[i]] = pool.shared[pool.trees[i]]


# ---------------------------------------------------------------------------------------------- Newton's iteration


@apart
def _solve_island(n, rotor, contact, pairs, step):
    """Iterate by Newton's method, all trees of the island together."""
    pool, zero = step.pool, 0.0 * step.y[step.offsets.newton_iterations]
    for i in range(pool.first_tree[n], pool.first_tree[n + 1]):
        pool.at_work[pool.trees[i]] = 1.0 + zero
    _by_newton(noting(step.y), n, rotor, contact, pairs, step)


@inline
def _pass(n, rotor, contact, pairs, step):
    """Linearize all forces, and solve."""
    pool, trees = step.pool, step.scene.trees
    for i in range(pool.first_tree[n], pool.first_tree[n + 1]):
        part = of_tree(step, trees[pool.trees[i]])
        linearize(rotor, part)
        linearize_contacts(contact, part)
    _solve_linear(n, rotor, contact, pairs, step)


@inline
def _by_newton(noted, n, rotor, contact, pairs, step):
    """Iterate; for gradients, whose scratch holds a solution, take one pass from there, as newton.py does."""
    pool, y, counter = step.pool, step.y, step.offsets.newton_iterations
    first, end, zero = pool.first_tree[n], pool.first_tree[n + 1], 0.0 * y[counter]
    if noted is not None:
        for i in range(first, end):
            pool.fraction[pool.trees[i]] = 1.0 + zero
        _advance(n, rotor, contact, pairs, step)
        _pass(n, rotor, contact, pairs, step)
        for i in range(first, end):
            ask_again(step.scene.friction, rotor, of_tree(step, step.scene.trees[pool.trees[i]]))
        return
    for k in range(MAX_PASSES):
        _pass(n, rotor, contact, pairs, step)
        _compare(n, rotor, contact, pairs, step)
        going, rising = False, False
        for i in range(first, end):
            t = pool.trees[i]
            at_work = pool.at_work[t]
            y[counter] = select(at_work > 0.0, y[counter] + 1.0, y[counter])
            pool.at_work[t] = select(pool.wrong[t] > 0.0, at_work, zero)
            going = going | any_lane(pool.at_work[t] > 0.0)
            rising = rising | any_lane((pool.at_work[t] > 0.0) & (pool.slope[t] > 0.0))
            pool.fraction[t] = 1.0 + zero
        if not going or k == MAX_PASSES - 1:  # the forces asked for last are those at the solution
            break
        if k > 0 and rising:
            _line_search(n, rotor, contact, pairs, step)
        _advance(n, rotor, contact, pairs, step)
    for i in range(first, end):
        failed = pool.at_work[pool.trees[i]] > 0.0
        y[counter + 1] = select(failed, y[counter + 1] + 1.0, y[counter + 1])


@kernel
def _solve_linear(n, rotor, contact, pairs, step):
    """Solve the linear model; fill velocities and the model's forces at its solution."""
    pool, scene = step.pool, step.scene
    first, end = pool.first_tree[n], pool.first_tree[n + 1]
    for i in range(first, end):
        prepare(scene.armature, step.predicted, of_tree(step, scene.trees[pool.trees[i]]))
    _fold_points(n, pairs, step)
    for i in range(first, end):
        articulate(step.Z[DIAGONAL], True, of_tree(step, scene.trees[pool.trees[i]]))
    act_together(n, pairs, step)
    for i in range(first, end):
        part = of_tree(step, scene.trees[pool.trees[i]])
        acceleration_pass(scene.tree, part.part, step.W, step.Z[DA])
        fill_solution(rotor, part)
    for i in range(pool.first_point[n], pool.first_point[n + 1]):
        solve_pair(pairs.turning, pairs.pairs[pool.pair[pool.points[i]]], step, pool.points[i])


@inline
def _fold_points(n, pairs, step):
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


@kernel
def _compare(n, rotor, contact, pairs, step):
    """Fill for each tree where the forces at the solution are not the linear model's, and the slope of the descent."""
    pool, trees, zero = step.pool, step.scene.trees, 0.0 * step.y[step.offsets.newton_iterations]
    first, end = pool.first_tree[n], pool.first_tree[n + 1]
    for i in range(first, end):
        t = pool.trees[i]
        wrong, slope = compare(rotor, contact, of_tree(step, trees[t]))
        pool.wrong[t], pool.slope[t] = select(wrong, 1.0 + zero, zero), slope
    for i in range(pool.first_point[n], pool.first_point[n + 1]):
        c = pool.points[i]
        pair = pairs.pairs[pool.pair[c]]
        t = pair.tree_a
        wrong, slope = compare_pair(pairs.turning, pair, step, c, zero > 1.0, pool.slope[t])
        on = pool.C[c, ON] > 0.0
        pool.wrong[t] = select(on & wrong, 1.0 + zero, pool.wrong[t])
        pool.slope[t] = select(on, slope, pool.slope[t])
    _share(n, pool.wrong, step)
    _share(n, pool.slope, step)


@apart
def _line_search(n, rotor, contact, pairs, step):
    """Fill the fraction of the pass at which the descent of each tree ends, by bisection, where it rises at the end."""
    pool, trees, zero = step.pool, step.scene.trees, 0.0 * step.y[step.offsets.newton_iterations]
    first, end = pool.first_tree[n], pool.first_tree[n + 1]
    size = 1.0
    for i in range(first, end):
        t = pool.trees[i]
        pool.wrong[t] = select(pool.slope[t] > 0.0, 1.0 + zero, zero)  # where it rises
        pool.fraction[t] = zero
    for _ in range(BISECTIONS):
        size = 0.5 * size
        for i in range(first, end):
            t = pool.trees[i]
            pool.fraction[t] = pool.fraction[t] + size
            pool.slope[t] = descent_slope(rotor, contact, of_tree(step, trees[t]), pool.fraction[t])
        for i in range(pool.first_point[n], pool.first_point[n + 1]):
            c = pool.points[i]
            pair = pairs.pairs[pool.pair[c]]
            t = pair.tree_a
            more = pool.slope[t] + pair_slope(pairs.turning, pair, step, c, pool.fraction[t])
            pool.slope[t] = select(pool.C[c, ON] > 0.0, more, pool.slope[t])
        _share(n, pool.slope, step)
        for i in range(first, end):
            t = pool.trees[i]
            pool.fraction[t] = select(pool.slope[t] > 0.0, pool.fraction[t] - size, pool.fraction[t])
    for i in range(first, end):
        t = pool.trees[i]
        found = pool.fraction[t] + 0.5 * size
        pool.fraction[t] = select(pool.wrong[t] > 0.0, found, 1.0 + zero)


@kernel
def _advance(n, rotor, contact, pairs, step):
    """Move the iterate of each tree, in the lanes still at work."""
    pool, trees = step.pool, step.scene.trees
    for i in range(pool.first_tree[n], pool.first_tree[n + 1]):
        t = pool.trees[i]
        move_iterate(rotor, contact, of_tree(step, trees[t]), pool.fraction[t], pool.at_work[t] > 0.0)
    for i in range(pool.first_point[n], pool.first_point[n + 1]):
        c = pool.points[i]
        t = pairs.pairs[pool.pair[c]].tree_a
        shift_pair(pool, c, pool.fraction[t], pool.at_work[t] > 0.0)
