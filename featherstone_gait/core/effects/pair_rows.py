"""Rows of the contacts between bodies that can move, in the system of a step (tree/rows.py).

A pair that has one point has three rows, the forces along the point's axes.  Any other has six: the forces along the
world's axes and the moments about them, at one of its points, to which all its points and their moments add.  With the
velocity u and the angular velocity w of body a against b there, a point at the arm r moves with u + w x r, so that its
slopes S are

    [ S    -S r ]
    [ r S  -r S r ]

of the six (r: as a matrix of the cross product), in sum a matrix of a rank of six or less: W is its Cholesky factor.
"""

from ..compile.jit import inline, kernel
from ..compile.lanes import any_lane, select, sqrt
from ..compile.optional import item
from ..tree.forest import LARGEST, rows_of
from ..tree.rows import (
    FIRST,
    KIND,
    RIGHT,
    ROW,
    SIZE,
    SOURCE,
    TOUCHING,
    add_block,
    answer_base,
    clear_block,
    entry_of,
    push_body,
)
from ..tree.spatial import add, choose, cross, load3, scale, sub
from .contact import C1, C3, CN, model_force
from .element import FK, U0, UK, XP
from .pair import AXES, FACTOR, FULL, ON, XB, is_moment

DEPENDENT = 1e-13  # of a diagonal of the slopes: what is left of it below this is rounding


@inline
def list_pairs(pairs, n, end, step):
    """Add the pairs of an island of which a point pushes to the blocks of a system, and return its end."""
    pool, rows, i = step.pool, step.rows, step.pool.first_point[n]
    while i < pool.first_point[n + 1]:
        pair, last, pushes = pairs.pairs[pool.pair[pool.points[i]]], _last_of(i, pool), False
        for j in range(i, last):
            pushes = pushes or any_lane(_pushes(pool.points[j], pool.C))
        if pair.folded == 0 and pushes:
            size = 3 if pair.slots == 1 and last - i == 1 else 6
            if end[1] + size > len(rows.first):
                for j in range(i, last):
                    _end_full(pool.points[j], step)
                break
            end = add_block(rows, end, TOUCHING, i, size, (pair.tree_a, pair.tree_b))
        i = last
    return end


@inline
def _last_of(i, pool):
    """Return the end of the points that belong to the same pair as the i-th of all islands."""
    j, whole = i + 1, pool.first_point[pool.count[1]]
    while j < whole and pool.pair[pool.points[j]] == pool.pair[pool.points[i]]:
        j += 1
    return j


@inline
def _pushes(c, C):
    """Return where a point or moment has a force or a slope."""
    return (abs(C[c, FK]) + abs(C[c, FK + 1]) + abs(C[c, FK + 2]) + C[c, CN] + C[c, C1] + C[c, C3]) > 0.0


@inline
def _end_full(c, step):
    """End a run, and reject a step with error control, in lanes in which more touches than there are rows for."""
    y, o, on = step.y, step.offsets, step.pool.C[c, ON] > 0.0
    y[o.status] = select(on, FULL + 0.0 * y[o.status], y[o.status])
    y[o.newton_iterations + 1] = select(on, y[o.newton_iterations + 1] + 1.0, y[o.newton_iterations + 1])


@kernel
def respond_pairs(pairs, system, step):
    """Fill what unit forces of the pairs of a system leave in the factors, their first forces and their slopes."""
    rows, pool = step.rows, step.pool
    for b in range(system[0] & LARGEST, system[1] & LARGEST):
        if rows.block[b, KIND] == TOUCHING:
            i = entry_of(b, SOURCE, rows)
            pair = pairs.pairs[pool.pair[pool.points[i]]]
            clear_block(step.scene, b, step.W, rows)
            if entry_of(b, SIZE, rows) == 3:
                _respond_point(pair, b, pool.points[i], step)
            else:
                _respond_face(pairs.turning, pair, b, i, step)
            answer_base(step.scene, b, True, step.W, rows)


@inline
def _push_both(pair, b, r, m, d, back, step):
    """Add a force d of moment m on body a to row r, and -d of moment `back` on body b."""
    scene, W, rows = step.scene, step.W, step.rows
    root_a, _ = rows_of(item(scene.trees, pair.tree_a), scene.tree)
    root_b, _ = rows_of(item(scene.trees, pair.tree_b), scene.tree)
    side = 0 if pair.tree_a == pair.tree_b else 1
    push_body(scene.tree, root_a, pair.body_a, m, d, (b, r, 0), W, rows)
    push_body(scene.tree, root_b, pair.body_b, back, scale(d, -1.0), (b, r, side), W, rows)


@inline
def _respond_point(pair, b, c, step):
    """Fill the rows along the axes of a point."""
    C, rows, first = step.pool.C, step.rows, entry_of(b, ROW, step.rows)
    xa, xb = load3(C, c, XP), load3(C, c, XB)
    f = model_force(sub(load3(C, c, U0), load3(C, c, UK)), c, C)
    for m in range(3):
        d = load3(C, c, AXES + 3 * m)
        _push_both(pair, b, first + m, cross(xa, d), d, scale(cross(xb, d), -1.0), step)
        rows.numbers[first + m, FIRST] = f[m]
    F = rows.factor
    F[first, 0], F[first + 1, 1] = C[c, FACTOR], C[c, FACTOR + 1]
    F[first + 2, 1], F[first + 2, 2] = C[c, FACTOR + 2], C[c, FACTOR + 3]


@inline
def _respond_face(turning, pair, b, i, step):
    """Fill the rows of a pair that has several points, or moments."""
    pool, C, rows, first = step.pool, step.pool.C, step.rows, entry_of(b, ROW, step.rows)
    last, one = _last_of(i, pool), 1.0 + 0.0 * C[pool.points[i], XP]
    xa, xb, found = scale((one, one, one), 0.0), scale((one, one, one), 0.0), one < 0.0
    for j in range(i, last):
        c = pool.points[j]
        if not is_moment(turning, pool, c):
            here = _pushes(c, C) & ~found
            xa, xb = choose(here, load3(C, c, XP), xa), choose(here, load3(C, c, XB), xb)
            found = found | here
    zero = 0.0 * one
    for m in range(3):
        d = (one if m == 0 else zero, one if m == 1 else zero, one if m == 2 else zero)
        none = (zero, zero, zero)
        _push_both(pair, b, first + m, cross(xa, d), d, scale(cross(xb, d), -1.0), step)
        _push_both(pair, b, first + 3 + m, d, none, scale(d, -1.0), step)
    for j in range(i, last):
        _add_slopes(is_moment(turning, pool, pool.points[j]), pool.points[j], xa, first, rows, C)
    _factor(first, rows)


@inline
def _add_slopes(turns, c, xa, first, rows, C):
    """Add force and slopes of a point, or of a moment, to those of its pair at xa."""
    n, t, s = load3(C, c, AXES), load3(C, c, AXES + 3), load3(C, c, AXES + 6)
    arm = sub(load3(C, c, XP), xa)
    f = model_force(sub(load3(C, c, U0), load3(C, c, UK)), c, C)
    f = add(scale(n, f[0]), add(scale(t, f[1]), scale(s, f[2])))
    _add_wrench(turns, arm, f, FIRST, first, rows)
    _add_column(turns, arm, scale(n, C[c, FACTOR]), first, rows)
    _add_column(turns, arm, add(scale(t, C[c, FACTOR + 1]), scale(s, C[c, FACTOR + 2])), first, rows)
    _add_column(turns, arm, scale(s, C[c, FACTOR + 3]), first, rows)


@inline
def _add_wrench(turns, arm, f, column, first, rows):
    m = cross(arm, f)
    for k in range(3):
        if turns:
            rows.numbers[first + 3 + k, column] += f[k]
        else:
            rows.numbers[first + k, column] += f[k]
            rows.numbers[first + 3 + k, column] += m[k]


@inline
def _add_column(turns, arm, w, first, rows):
    """Add the product of a column of W with itself to the slopes."""
    for k in range(6):
        rows.numbers[first + k, RIGHT] = 0.0 * rows.numbers[first + k, RIGHT]
    _add_wrench(turns, arm, w, RIGHT, first, rows)
    for k in range(6):
        for l in range(k + 1):
            x = rows.numbers[first + k, RIGHT] * rows.numbers[first + l, RIGHT]
            rows.factor[first + k, l] = rows.factor[first + k, l] + x


@inline
def _factor(first, rows):
    """Replace the slopes by their Cholesky factor; a column that depends on those before it is zero."""
    F = rows.factor
    for k in range(6):
        left = F[first + k, k]
        least = DEPENDENT * left
        for l in range(k):
            left = left - F[first + k, l] * F[first + k, l]
        holds = left > least
        size = sqrt(select(holds, left, 1.0 + 0.0 * left))
        F[first + k, k] = select(holds, size, 0.0 * size)
        for m in range(k + 1, 6):
            x = F[first + m, k]
            for l in range(k):
                x = x - F[first + m, l] * F[first + k, l]
            F[first + m, k] = select(holds, x / size, 0.0 * x)
