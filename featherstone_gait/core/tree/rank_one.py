"""Slopes along rows beside the fold: the mass matrix A of a tree gets w^2 J' J for each row J.

The first pass of the ABA has factorised A.  In its factors a row is the x that a unit force along it leaves on its way
to the root (coupling.py): u of the joints and the force on the root, with the product <x, y> = J_x A^-1 J_y'.  Each row
changes all products by a rank of one.  With s = sqrt(1 + w^2 <x, x>),

    (A + w^2 J' J)^-1 = A^-1 - w^2 / s^2 A^-1 J' J A^-1,

which is that of the factors times P = 1 - beta x <x, .> on both sides, beta = w^2 / (s (s + 1)): P is symmetric in this
product, and P P is the change above.  Any w will do: P goes to the projection that keeps J a where it is.

`bind` takes P of each row, one after the other, from the solution that the first pass has left, `unbind` the same from
rows of rows.py, whose products are then those of all slopes.  `release` takes P once more, in reverse order, when all
forces are in; the second pass follows.  Slopes are then part of the factors, and no system of equations is left.
"""

from ..compile.jit import inline, kernel
from ..compile.lanes import sqrt
from .coupling import DA, ROOT, SIZE, product, take
from .forest import couplings_of, is_fixed, rows_of, tendons_of
from .joint import along
from .layout import COLUMNS, DINV, UU, U
from .spatial import add, load3, scale, solve6, store3

BETA = SIZE + 1  # column of a row of the workspace, after those of coupling.py; its u stand in a column of the bodies
FREE = BETA + 1  # first column that is not used here


@inline
def clear(tree, part, row, column, W):
    """Set a row to that of no force."""
    root, end = rows_of(part, tree)
    for i in range(root + 1, end):
        W[i, column] = 0.0
    for k in range(SIZE):
        W[row, k] = 0.0


@kernel
def push_force(tree, root, i, m, d, row, column, W):
    """Add what a force d (3) [N] of moment m (3) [N m] about the common origin, on body i, leaves on its way."""
    n, f = scale(m, -1.0), scale(d, -1.0)
    while i > root:
        u = -along(tree[i], i, n, f, W)
        W[i, column] += u
        x = u * W[i, DINV]
        n, f = add(n, scale(load3(W, i, U), x)), add(f, scale(load3(W, i, U + 3), x))
        i = tree[i].parent
    for k in range(3):
        W[row, ROOT + k] += n[k]
        W[row, ROOT + 3 + k] += f[k]


@kernel
def answer(inertia, coupling, part, tree, row, column, W):
    """Fill what a floating base answers to a row, and keep couplings of joints out of it.

    inertia: the articulated one (J, H, M) of a floating base, None of a fixed one.
    """
    if inertia is not None:
        J, H, M = inertia
        if not is_fixed(part):
            a = solve6(J, H, M, load3(W, row, ROOT), load3(W, row, ROOT + 3))
            store3(W, row, DA, (-a[0], -a[1], -a[2]))
            store3(W, row, DA + 3, (-a[3], -a[4], -a[5]))
    if coupling is not None:
        first, end = couplings_of(part, coupling)
        for c in range(first, end):
            other = coupling[c].row
            a = product(rows_of(part, tree), (other, COLUMNS + c), (row, DA, column), W) / W[other, SIZE]
            _take_row(tree, part, a, (other, COLUMNS + c), (row, column), W)


@inline
def _take_row(tree, part, a, row, other, W):
    """Take `a` times a row from another one; both (row, column)."""
    take(rows_of(part, tree), a, row, (other[0], DA, other[1]), W)
    for k in range(6):
        W[other[0], ROOT + k] -= a * W[row[0], ROOT + k]


@kernel
def bind(tree, part, own, before, slope, force, W):
    """Take P of a row from the solution, after the rows `before`, and let a force along it act.

    own, before: (row, column) each, and `before` how many rows stand before its own; slope: w^2 [kg m^2 or kg].
    """
    (row, column), rows = own, rows_of(part, tree)
    for k in range(before):
        other = row - before + k, column - before + k
        a = W[other[0], BETA] * product(rows, other, (row, DA, column), W)
        _take_row(tree, part, a, other, own, W)
    size = product(rows, own, (row, DA, column), W)
    s = sqrt(1.0 + slope * size)
    W[row, BETA] = slope / (s * (s + 1.0))
    a = W[row, BETA] * (product(rows, own, (rows[0], U, UU), W) + force * size) - force
    take(rows, a, own, (rows[0], U, UU), W)


@kernel
def release(tree, part, own, W):
    """Take P of a row from the solution once more."""
    rows = rows_of(part, tree)
    a = W[own[0], BETA] * product(rows, own, (rows[0], U, UU), W)
    take(rows, a, own, (rows[0], U, UU), W)


@inline
def unbind(lines, tree, part, first, count, side, W, responses, roots):
    """Take P of all rows from `count` rows of rows.py, in order; lines: records with `row` and `column`, or None."""
    if lines is not None:
        begin, end = tendons_of(part, lines)
        for r in range(first, first + count):
            for c in range(begin, end):
                _unbind(tree, part, (lines[c].row, lines[c].column), r, side, W, responses, roots)


@inline
def release_rows(lines, tree, part, first, count, side, W, responses, roots):
    """Take P of all rows once more from `count` rows of rows.py, in reverse order, for a solution made of them."""
    if lines is not None:
        begin, end = tendons_of(part, lines)
        for r in range(first, first + count):
            for k in range(end - begin):
                c = end - 1 - k
                _unbind(tree, part, (lines[c].row, lines[c].column), r, side, W, responses, roots)


@kernel
def _unbind(tree, part, own, r, side, W, responses, roots):
    (row, column), (root, end) = own, rows_of(part, tree)
    a = 0.0 * W[root, DINV]
    for i in range(root + 1, end):
        a = a + W[i, column] * responses[r, side, i - root] * W[i, DINV]
    for k in range(6):
        a = a - W[row, ROOT + k] * roots[r, side, DA + k]
    a = a * W[row, BETA]
    for i in range(root + 1, end):
        responses[r, side, i - root] -= a * W[i, column]
    for k in range(SIZE):
        roots[r, side, k] -= a * W[row, ROOT + k]
