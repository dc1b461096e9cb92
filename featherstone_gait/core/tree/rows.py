"""Rows that couple two trees, or two links of one, beside the fold: unit forces in the factors that the ABA has left.

The first pass of the ABA (`articulated_pass`) has factorised the mass matrix A of a tree, with what the step has folded
into it.  A unit force at a point of body i leaves on its way to the root

    p = -[x x d; d],   u_i = -S_i' p,   p += U_i u_i / D_i   from body to body,

and at the root p0, to which a floating base answers by dA = -IA^-1 p0.  Of two forces r and s on one tree

    J_r A^-1 J_s' = sum over joints u_r u_s / D - p0_r' dA_s,

and with what the first pass has left in u and dA of the tree itself, the same sum is J_r a of its solution a.  Forces f
then change u by f u_r and dA of the root by f dA_r, and the second pass finds the accelerations of all bodies.

A row has two sides, one for each tree that it acts on; if both ends are in one tree, both are in the first.
"""

from ..compile.jit import inline, kernel
from .aba import root_inertia
from .coupling import DA, ROOT, SIZE
from .forest import couplings_of, is_fixed, rows_of
from .joint import along
from .layout import COLUMNS, DINV, UU, U
from .spatial import add, cross, load3, scale, solve6, store3

SIDE = 12  # numbers of a side at the root: ROOT and DA of coupling.py


@inline
def clear_row(part, tree, r, side, responses, roots):
    """Set the side of row r to that of no force."""
    root, end = rows_of(part, tree)
    for i in range(end - root):
        responses[r, side, i] = 0.0
    for k in range(SIDE):
        roots[r, side, k] = 0.0


@kernel
def add_force(tree, part, i, at, d, r, side, W, responses, roots):
    """Add a force d (3) [N] at the point `at` (3) [m] of body i, common frame, to the side of row r."""
    m = cross(at, d)
    _add_wrench(tree, part, i, ((-m[0], -m[1], -m[2]), (-d[0], -d[1], -d[2])), r, side, W, responses, roots)


@kernel
def add_moment(tree, part, i, d, r, side, W, responses, roots):
    """Add a moment d (3) [N m] on body i to the side of row r."""
    zero = 0.0 * d[0]
    _add_wrench(tree, part, i, ((-d[0], -d[1], -d[2]), (zero, zero, zero)), r, side, W, responses, roots)


@inline
def _add_wrench(tree, part, i, p, r, side, W, responses, roots):
    """Take the bias force p that a force or moment on body i leaves to the root, common frame."""
    root, _ = rows_of(part, tree)
    n, f = p
    while i > root:
        u = -along(tree[i], i, n, f, W)
        responses[r, side, i - root] += u
        x = u * W[i, DINV]
        n, f = add(n, scale(load3(W, i, U), x)), add(f, scale(load3(W, i, U + 3), x))
        i = tree[i].parent
    for k in range(3):
        roots[r, side, ROOT + k] += n[k]
        roots[r, side, ROOT + 3 + k] += f[k]


@inline
def answer_root(scene, part, contact, first, count, side, W, responses, roots):
    """Fill what the base of a tree answers to `count` rows, and keep couplings of joints out of them."""
    if not is_fixed(part):
        J, H, M = root_inertia(scene.tree, part, contact, W)
        for r in range(first, first + count):
            a = solve6(J, H, M, load3(roots[r], side, ROOT), load3(roots[r], side, ROOT + 3))
            store3(roots[r], side, DA, (-a[0], -a[1], -a[2]))
            store3(roots[r], side, DA + 3, (-a[3], -a[4], -a[5]))
    _uncouple(scene.coupling, part, scene.tree, first, count, side, W, responses, roots)


@inline
def _uncouple(coupling, part, tree, first, count, side, W, responses, roots):
    """Take from rows what they would move couplings, so that followers go with their leaders (coupling.py)."""
    if coupling is not None:
        root, end = rows_of(part, tree)
        begin, stop = couplings_of(part, coupling)
        for r in range(first, first + count):
            for c in range(begin, stop):
                row, a = coupling[c].row, 0.0 * W[root, DINV]
                for i in range(root + 1, end):
                    a = a + W[i, COLUMNS + c] * responses[r, side, i - root] * W[i, DINV]
                for k in range(6):
                    a = a - W[row, ROOT + k] * roots[r, side, DA + k]
                a = a / W[row, SIZE]
                for i in range(root + 1, end):
                    responses[r, side, i - root] -= a * W[i, COLUMNS + c]
                for k in range(SIDE):
                    roots[r, side, k] -= a * W[row, ROOT + k]


@kernel
def product(part, tree, r, a, s, b, W, found, others):
    """Return J_r A^-1 J_s' [1/kg] of the side a of row r and the side b of row s, which act on one tree.

    found, others: responses and roots of the one row and of the other.
    """
    (responses, roots), (its_responses, its_roots), (root, end) = found, others, rows_of(part, tree)
    total = 0.0 * W[root, DINV]
    for i in range(1, end - root):
        total = total + responses[r, a, i] * its_responses[s, b, i] * W[root + i, DINV]
    for k in range(6):
        total = total - roots[r, a, ROOT + k] * its_roots[s, b, DA + k]
    return total


@kernel
def common_product(tree, parts, one, found, other, others, W):
    """Return J_r A^-1 J_s' of two rows, summed over the trees that both act on.

    one, other: what a row belongs to, a record with `tree_a` and `tree_b`, and its number; parts: TREE of all trees.
    """
    (p, r), (q, s), total = one, other, 0.0 * W[0, 0]
    a = parts[p.tree_a]
    if p.tree_a == q.tree_a:
        total = total + product(a, tree, r, 0, s, 0, W, found, others)
    if q.tree_b != q.tree_a and p.tree_a == q.tree_b:
        total = total + product(a, tree, r, 0, s, 1, W, found, others)
    if p.tree_b != p.tree_a:
        b = parts[p.tree_b]
        if p.tree_b == q.tree_a:
            total = total + product(b, tree, r, 1, s, 0, W, found, others)
        if q.tree_b != q.tree_a and p.tree_b == q.tree_b:
            total = total + product(b, tree, r, 1, s, 1, W, found, others)
    return total


@kernel
def acceleration_along(part, tree, r, side, W, responses, roots):
    """Return J_r a [m/s^2] of the tree's solution, without forces of rows."""
    root, end = rows_of(part, tree)
    total = 0.0 * W[root, DINV]
    for i in range(1, end - root):
        total = total + responses[r, side, i] * W[root + i, UU] * W[root + i, DINV]
    for k in range(6):
        total = total - roots[r, side, ROOT + k] * W[root, U + k]
    return total


@kernel
def apply_row(part, tree, r, side, f, W, responses, roots):
    """Let the force f [N] of row r act on the tree's solution."""
    root, end = rows_of(part, tree)
    for i in range(1, end - root):
        W[root + i, UU] += f * responses[r, side, i]
    for k in range(6):
        W[root, U + k] += f * roots[r, side, DA + k]
