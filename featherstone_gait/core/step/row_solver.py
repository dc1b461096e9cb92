"""Rows beside the fold in an island: the forces of points between bodies that can move, and of loops.

Points between two bodies that can move are rows beside the fold (tree/rows.py).  With S the slopes of the points at the
iterate, f0 the linear model's forces at the predicted velocity, h S = W W' and L = J A^-1 J', the forces are

    f = f0 + W g,    (1 + W' L W) g = -W' (J a0 + L f0),

a0 the accelerations without them: a system that is symmetric and positive definite whatever the slopes, in which a
point that does not push, W = 0, is a row of the unit matrix.  A point on a body that cannot move is folded into the
other like one on the ground.

Loops are rows beside those of the points, in one system, scaled as in tree/loop.py and eliminated first: with their
factor F F' and the product X F' of points and loops, 1 + W' L W - X X' is left to the points.  The proximal iteration
goes through both.  Where no point pushes, X = 0 and the loops' forces are those that a tree alone would find.
"""

from ..compile.jit import apart, inline, kernel
from ..compile.lanes import select, sqrt
from ..compile.optional import if_present
from ..effects.contact import U0, UK, model_force
from ..effects.pair import AXES, FACTOR, FULL, ON, XB, XP, is_moment
from ..effects.tendon import lines_of
from ..tree.forest import loops_of
from ..tree.loop import (
    IN_STEP,
    apply_loop_row,
    backward,
    factor_rows,
    fill_system,
    forward,
    list_rows,
    respond_loop,
)
from ..tree.rank_one import unbind
from ..tree.rows import acceleration_along, add_force, add_moment, answer_root, apply_row, clear_row, common_product
from ..tree.spatial import load3, scale, sub


@apart
def solve_rows(n, pairs, step):
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
