"""The linearly implicit step of trees that touch: Newton's iteration of newton.py over all trees of an island.

Points between two bodies that can move are rows beside the fold (tree/rows.py).  With S the slopes of the points at the
iterate, f0 the linear model's forces at the predicted velocity, h S = W W' and L = J A^-1 J', the forces are

    f = f0 + W g,    (1 + W' L W) g = -W' (J a0 + L f0),

a0 the accelerations without them: a system that is symmetric and positive definite whatever the slopes, in which a
point that does not push, W = 0, is a row of the unit matrix.  A point on a body that cannot move is folded into the
other like one on the ground.

Loops are rows beside those of the points, in one system, scaled as in tree/loop.py and eliminated first: with their
factor F F' and the product X F' of points and loops, 1 + W' L W - X X' is left to the points.  The proximal iteration
goes through both.  Where no point pushes, X = 0 and the loops' forces are those that a tree alone would find.

Trees that touch nothing of each other are iterated each for itself, as if they were alone, and without the workspace
rows of pairs.  In lanes an island holds the trees that touch in any of them; those that do not touch in one lane have
labels of their own there, so that the bits of a lane do not depend on its neighbors.
"""

from ..compile.jit import apart, inline, kernel
from ..compile.lanes import any_lane, select, sqrt, width_of
from ..compile.optional import any_present, if_present
from ..compile.taped import noting
from ..effects.actuator import rotor_of
from ..effects.contact import U0, UK, linearize_contacts, model_force, place_contacts
from ..effects.fluid import place_fluid
from ..effects.pair import (
    AXES,
    FACTOR,
    FULL,
    ON,
    XB,
    XP,
    clear_own_row,
    compare_pair,
    fold_pair,
    is_moment,
    is_near,
    linearize_pair,
    pair_slope,
    place_pairs,
    shift_pair,
    solve_pair,
)
from ..effects.tendon import lines_of, release_tendons
from ..tree.aba import acceleration_pass
from ..tree.forest import loops_of
from ..tree.loop import (
    IN_STEP,
    apply_loop_row,
    backward,
    factor_rows,
    fill_loops,
    fill_system,
    forward,
    list_rows,
    respond_loop,
)
from ..tree.rank_one import unbind
from ..tree.rows import acceleration_along, add_force, add_moment, answer_root, apply_row, clear_row, common_product
from ..tree.spatial import load3, scale, sub
from .closure import held_in
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
    _place_joining(scene.loops, step)
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
    _solve_rows(n, pairs, step)
    for i in range(first, end):
        part = of_tree(step, scene.trees[pool.trees[i]])
        release_tendons(scene.tendons, part)
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


# ---------------------------------------------------------------------------------------------- rows


@apart
def _solve_rows(n, pairs, step):
    """Find the forces of loops and of the points between bodies that can move, and let them act on the solutions."""
    pool, count = step.pool, 0
    for i in range(pool.first_point[n], pool.first_point[n + 1]):
        c = pool.points[i]
        if pairs.pairs[pool.pair[c]].folded == 0:
            if count == len(pool.row_point):
                _end_full(c, step)
                break
            pool.row_point[count] = c
            count += 1
    for k in range(count):
        _respond(k, pairs, step)
    if count > 0:
        _fill_matrix(count, pairs, step)
    _solve_system(step.scene.loops, n, count, pairs, step)
    for k in range(count):
        _apply(k, pairs, step)


@inline
def _solve_system(loops, n, count, pairs, step):
    """Solve for the forces of the points; of loops, if there are any, they act already."""
    if loops is None:
        if count > 0:
            _factor(3 * count, step.pool)
            _substitute(3 * count, step.pool)
    else:
        _solve_with_loops(loops, n, count, pairs, step)


@inline
def _end_full(c, step):
    """End a run, and reject a step with error control, in lanes in which more points act than there are rows for."""
    y, o, on = step.y, step.offsets, step.pool.C[c, ON] > 0.0
    y[o.status] = select(on, FULL + 0.0 * y[o.status], y[o.status])
    y[o.newton_iterations + 1] = select(on, y[o.newton_iterations + 1] + 1.0, y[o.newton_iterations + 1])


@inline
def _pair_of(k, pairs, pool):
    return pairs.pairs[pool.pair[pool.row_point[k]]]


@kernel
def _respond(k, pairs, step):
    """Fill the responses of the trees to unit forces along the axes of a point."""
    pool, scene, W, r = step.pool, step.scene, step.W, 3 * k
    pair, c = _pair_of(k, pairs, pool), pool.row_point[k]
    tree, a = scene.tree, scene.trees[pair.tree_a]
    b = scene.trees[pair.tree_b]
    side = 0 if pair.tree_b == pair.tree_a else 1
    for m in range(3):
        d = load3(pool.C, c, AXES + 3 * m)
        clear_row(a, tree, r + m, 0, pool.responses, pool.roots)
        if side == 1:
            clear_row(b, tree, r + m, 1, pool.responses, pool.roots)
        back = scale(d, -1.0)
        if is_moment(pairs.turning, pool, c):
            add_moment(tree, a, pair.body_a, d, r + m, 0, W, pool.responses, pool.roots)
            add_moment(tree, b, pair.body_b, back, r + m, side, W, pool.responses, pool.roots)
        else:
            add_force(tree, a, pair.body_a, load3(pool.C, c, XP), d, r + m, 0, W, pool.responses, pool.roots)
            add_force(tree, b, pair.body_b, load3(pool.C, c, XB), back, r + m, side, W, pool.responses, pool.roots)
    answer_root(scene, a, True, r, 3, 0, W, pool.responses, pool.roots)
    lines = lines_of(scene.tendons)
    unbind(lines, tree, a, r, 3, 0, W, pool.responses, pool.roots)
    if side == 1:
        answer_root(scene, b, True, r, 3, 1, W, pool.responses, pool.roots)
        unbind(lines, tree, b, r, 3, 1, W, pool.responses, pool.roots)


@kernel
def _fill_matrix(count, pairs, step):
    """Fill the lower triangle of 1 + W' L W within its envelope, and W' (J a0 + L f0)."""
    pool = step.pool
    for k in range(count):
        _fill_right(k, pairs, step)
    for i in range(count):
        p = _pair_of(i, pairs, pool)
        pool.envelope[i] = i
        for j in range(i + 1):
            q = _pair_of(j, pairs, pool)
            if _touch(p, q) or _linked(step.scene.loops, p, q, pool):
                pool.envelope[i] = min(pool.envelope[i], j)
                _fill_block(i, j, p, q, step)
            elif pool.envelope[i] < j:
                _clear_block(i, j, pool)
    for i in range(count):
        _scale_right(i, pool)


@inline
def _touch(p, q):
    """Return whether two pairs have a tree in common."""
    return p.tree_a == q.tree_a or p.tree_a == q.tree_b or p.tree_b == q.tree_a or p.tree_b == q.tree_b


@if_present(False)
def _linked(loops, p, q, pool):
    """Return whether loops may couple two pairs of one island that have no tree in common."""
    return loops.joined is not None


@inline
def _clear_block(i, j, pool):
    for m in range(3):
        for l in range(3):
            pool.matrix[3 * i + m, 3 * j + l] = 0.0


@inline
def _fill_right(k, pairs, step):
    """Fill J a0 and the linear model's force f0 at the predicted velocity, both along the axes of a point."""
    pool, scene, pair, c = step.pool, step.scene, _pair_of(k, pairs, step.pool), step.pool.row_point[k]
    tree, a, b = scene.tree, scene.trees[pair.tree_a], scene.trees[pair.tree_b]
    f = model_force(sub(load3(pool.C, c, U0), load3(pool.C, c, UK)), c, pool.C)
    for m in range(3):
        e = acceleration_along(a, tree, 3 * k + m, 0, step.W, pool.responses, pool.roots)
        if pair.tree_b != pair.tree_a:
            e = e + acceleration_along(b, tree, 3 * k + m, 1, step.W, pool.responses, pool.roots)
        pool.force[0, 3 * k + m] = e
        pool.force[1, 3 * k + m] = f[m]


@kernel
def _fill_block(i, j, p, q, step):
    """Fill the block of points i and j: L adds to the right side, then W_i' L W_j takes its place."""
    pool, C = step.pool, step.pool.C
    r, s, c, d = 3 * i, 3 * j, pool.row_point[i], pool.row_point[j]
    tree, trees, found = step.scene.tree, step.scene.trees, (pool.responses, pool.roots)
    for m in range(3):
        for l in range(3):
            if i == j and l > m:
                pool.matrix[r + m, s + l] = 0.0
            else:
                x = common_product(tree, trees, (p, r + m), found, (q, s + l), found, step.W)
                pool.matrix[r + m, s + l] = x
                pool.force[0, r + m] += x * pool.force[1, s + l]
                if i != j or l != m:
                    pool.force[0, s + l] += x * pool.force[1, r + m]
    if i == j:  # the whole block for a moment
        pool.matrix[r, s + 1] = pool.matrix[r + 1, s]
        pool.matrix[r, s + 2] = pool.matrix[r + 2, s]
        pool.matrix[r + 1, s + 2] = pool.matrix[r + 2, s + 1]
    for m in range(3):  # L W_j
        x, y, z = pool.matrix[r + m, s], pool.matrix[r + m, s + 1], pool.matrix[r + m, s + 2]
        pool.matrix[r + m, s] = x * C[d, FACTOR]
        pool.matrix[r + m, s + 1] = y * C[d, FACTOR + 1] + z * C[d, FACTOR + 2]
        pool.matrix[r + m, s + 2] = z * C[d, FACTOR + 3]
    for l in range(3):  # W_i' of it
        x, y, z = pool.matrix[r, s + l], pool.matrix[r + 1, s + l], pool.matrix[r + 2, s + l]
        pool.matrix[r, s + l] = C[c, FACTOR] * x
        pool.matrix[r + 1, s + l] = C[c, FACTOR + 1] * y + C[c, FACTOR + 2] * z
        pool.matrix[r + 2, s + l] = C[c, FACTOR + 3] * z
    if i == j:
        for m in range(3):
            pool.matrix[r + m, r + m] += 1.0


@inline
def _scale_right(k, pool):
    """Turn J a0 + L f0 of a point into W' of it."""
    c, r = pool.row_point[k], 3 * k
    y, z = pool.force[0, r + 1], pool.force[0, r + 2]
    pool.force[0, r] = pool.C[c, FACTOR] * pool.force[0, r]
    pool.force[0, r + 1] = pool.C[c, FACTOR + 1] * y + pool.C[c, FACTOR + 2] * z
    pool.force[0, r + 2] = pool.C[c, FACTOR + 3] * z


@kernel
def _factor(n, pool):
    """Replace the matrix by Cholesky's factor within the envelope, whose diagonal is kept inverted.

    A. George, J. W. Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981, chapter 4.
    """
    A, envelope = pool.matrix, pool.envelope
    for i in range(n):
        first = 3 * envelope[i // 3]
        for j in range(first, i + 1):
            total = A[i, j]
            for k in range(max(first, 3 * envelope[j // 3]), j):
                total = total - A[i, k] * A[j, k]
            if j < i:
                A[i, j] = total * A[j, j]
            else:
                A[i, i] = 1.0 / sqrt(total)


@kernel
def _substitute(n, pool):
    """Turn force[0] into the solution by the factor."""
    A, x, envelope = pool.matrix, pool.force[0], pool.envelope
    for i in range(n):
        total = x[i]
        for k in range(3 * envelope[i // 3], i):
            total = total - A[i, k] * x[k]
        x[i] = total * A[i, i]
    for m in range(n):
        i = n - 1 - m
        x[i] = x[i] * A[i, i]
        for k in range(3 * envelope[i // 3], i):
            x[k] = x[k] - A[i, k] * x[i]


# ---------------------------------------------------------------------------------------------- loops among the rows


@if_present()
def _place_joining(loops, step):
    """Fill the rows of loops that join trees, when the bodies of all stand in W."""
    if loops.joined is not None:
        own, count = loops.parts[len(loops.parts) - 1].end_loop, len(loops.table)
        held, bases = held_in(loops, step.offsets, step.y), bases_at(step.predicted, step)
        fill_loops(loops.table, (own, count), held, step.scene.gravity, bases, step.W, step.closing.rows)


@inline
def _list_loops(loops, n, step):
    """List the rows of the loops of an island, those of each tree and then those that join trees; return the count."""
    pool, listed, count = step.pool, step.closing.listed, 0
    for i in range(pool.first_tree[n], pool.first_tree[n + 1]):
        first, end = loops_of(loops.parts[pool.trees[i]])
        for c in range(first, end):
            count = list_rows(loops.table, c, count, listed)
    for c in range(loops.parts[len(loops.parts) - 1].end_loop, len(loops.table)):
        if pool.island[loops.table[c].tree_a] == n:
            count = list_rows(loops.table, c, count, listed)
    return count


@kernel
def _solve_with_loops(loops, n, count, pairs, step):
    """Solve for the forces of loops, which then act on the trees, and of the points."""
    pool, work, scene, W = step.pool, step.closing, step.scene, step.W
    m, listed, lines = _list_loops(loops, n, step), work.listed, lines_of(scene.tendons)
    found, L = (work.responses, work.roots), work.matrix[:m]
    for i in range(m):
        k = loops.table[listed[1, i]]
        if listed[0, i] == k.first:
            respond_loop(scene, loops.parts, True, k, lines, W, work.rows, work.responses, work.roots)
    fill_system(scene.tree, loops.parts, loops.table, m, listed, W, work.rows, found, L, work.force)
    _cross(loops, m, count, pairs, step)
    factor_rows(L, IN_STEP)
    _leave_to_points(loops, L, m, count, pairs, step)
    if count > 0:
        _factor(3 * count, pool)
    _iterate(L, m, count, step)
    for i in range(m):
        r, k = listed[0, i], loops.table[listed[1, i]]
        apply_loop_row(scene.tree, loops.parts, k, r, work.force[r], W, work.responses, work.roots)
        step.y[step.offsets.loop_force + r] = work.force[r]


@inline
def _cross(loops, m, count, pairs, step):
    """Fill the products of points and loops, of which those by the points' first forces add to the loops' motion."""
    pool, work, listed = step.pool, step.closing, step.closing.listed
    found, others = (pool.responses, pool.roots), (work.responses, work.roots)
    for i in range(count):
        p = _pair_of(i, pairs, pool)
        for l in range(m):
            k, r = loops.table[listed[1, l]], listed[0, l]
            for t in range(3):
                x = common_product(step.scene.tree, loops.parts, (p, 3 * i + t), found, (k, r), others, step.W)
                work.cross[3 * i + t, l] = x
                work.force[r] = work.force[r] + x * pool.force[1, 3 * i + t]


@inline
def _leave_to_points(loops, L, m, count, pairs, step):
    """Fill X, by the points' slopes and the inverse of the loops' factor; take X X' from the matrix of the points."""
    pool, X = step.pool, step.closing.cross
    for i in range(count):
        c, r = pool.row_point[i], 3 * i
        for l in range(m):
            x, y, z = X[r, l] * L[l, m], X[r + 1, l] * L[l, m], X[r + 2, l] * L[l, m]
            X[r, l] = pool.C[c, FACTOR] * x
            X[r + 1, l] = pool.C[c, FACTOR + 1] * y + pool.C[c, FACTOR + 2] * z
            X[r + 2, l] = pool.C[c, FACTOR + 3] * z
        for t in range(3):
            forward(L, m, X[r + t])
        for j in range(i + 1):
            if pool.envelope[i] <= j:
                for t in range(3):
                    for s in range(3 if j < i else t + 1):
                        for l in range(m):
                            pool.matrix[r + t, 3 * j + s] -= X[r + t, l] * X[3 * j + s, l]


@inline
def _iterate(L, m, count, step):
    """Solve by the proximal iteration of tree/loop.py for force[0] of the points and the forces of the loops."""
    pool, work, (compliance, rounds) = step.pool, step.closing, IN_STEP
    X, z, right = work.cross, work.push, pool.force[2]
    for l in range(m):
        L[l, m + 1] = -work.force[work.listed[0, l]] * L[l, m]
        z[l] = 0.0
    for i in range(3 * count):
        right[i] = pool.force[0, i]
    for _ in range(rounds):
        for l in range(m):
            z[l] = L[l, m + 1] + compliance * z[l]
        forward(L, m, z)
        for i in range(3 * count):  # the points' are the solution for the opposite right side
            total = right[i]
            for l in range(m):
                total = total + X[i, l] * z[l]
            pool.force[0, i] = total
        _substitute(3 * count, pool)
        for l in range(m):
            for i in range(3 * count):
                z[l] = z[l] + X[i, l] * pool.force[0, i]
        backward(L, m, z)
    for l in range(m):
        work.force[work.listed[0, l]] = z[l] * L[l, m]


# ---------------------------------------------------------------------------------------------- their forces


@kernel
def _apply(k, pairs, step):
    """Let f0 - W g of a point act on both trees; g is the solution for the opposite right side."""
    pool, scene, pair, c, r = step.pool, step.scene, _pair_of(k, pairs, step.pool), step.pool.row_point[k], 3 * k
    tree, a, b, C = scene.tree, scene.trees[pair.tree_a], scene.trees[pair.tree_b], step.pool.C
    x, y, z = pool.force[0, r], pool.force[0, r + 1], pool.force[0, r + 2]
    pool.force[1, r] -= C[c, FACTOR] * x
    pool.force[1, r + 1] -= C[c, FACTOR + 1] * y
    pool.force[1, r + 2] -= C[c, FACTOR + 2] * y + C[c, FACTOR + 3] * z
    for m in range(3):
        apply_row(a, tree, r + m, 0, pool.force[1, r + m], step.W, pool.responses, pool.roots)
        if pair.tree_b != pair.tree_a:
            apply_row(b, tree, r + m, 1, pool.force[1, r + m], step.W, pool.responses, pool.roots)
