"""The residual of a solution of the two passes of aba.py, and solutions in the factors that the first has left.

Where a solution a of A a = b is known, its derivatives are those of a + A^-1 (b - A a) with a and A^-1 held: those of
the residual, which is inverse dynamics (RBDA, section 5.3) at a third of the operations, and one solution for each
direction.  A is symmetric: the adjoint is the same solution.
"""

from ..compile.jit import inline, kernel
from ..compile.optional import plus_item
from .aba import root_inertia
from .forest import is_fixed, rows_of
from .joint import accelerate, along
from .layout import DINV, SF, SH, SJ, SM, TOUCH, UU, A, U, V
from .rigid_body import center_velocity, mass_center
from .spatial import (
    accumulate3,
    add,
    cross,
    dot,
    load3,
    load9,
    rotate,
    rotate_back,
    scale,
    solve6,
    store3,
    sub,
    symmetric,
)

ROOM = 7  # columns of the scratch of a solution


@kernel
def residual(tree, part, tau, diagonal, wrench, contact, qdd, W):
    """Fill UU of every joint with its residual [N m or N], and return the base's as moment [N m] and force [N].

    qdd (n,) and the U columns of the root: the solution; U becomes dA of all bodies.  The others: as the two passes
    have them.
    """
    root, end = rows_of(part, tree)
    for i in range(root + 1, end):
        b = tree[i]
        accelerate(b, i, load3(W, b.parent, U), load3(W, b.parent, U + 3), qdd[b.dof], W, W, U)
    for k in range(1, end - root):
        i = end - k
        b = tree[i]
        n, f = _force(b, i, wrench, contact, W)
        W[i, UU] = tau[b.dof] - along(b, i, n, f, W) - plus_item(0.0, diagonal, b.dof) * qdd[b.dof]
        accumulate3(W, tree[b.parent].slot, SF, b.last, n)
        accumulate3(W, tree[b.parent].slot, SF + 3, b.last, f)
    n, f = _force(tree[root], root, wrench, contact, W)
    return scale(n, -1.0), scale(f, -1.0)


@inline
def _force(b, i, wrench, contact, W):
    """Return what drives body i and all beyond it with its acceleration, less what acts on them, at the origin."""
    c, Jc = mass_center(b, i, W)
    w, dn, df = load3(W, i, V), load3(W, i, U), load3(W, i, U + 3)
    alpha = add(load3(W, i, A), dn)
    ac = add(add(load3(W, i, A + 3), df), add(cross(alpha, c), cross(w, center_velocity(i, c, W))))
    f = scale(ac, b.m)
    n = add(add(symmetric(Jc, alpha), cross(w, symmetric(Jc, w))), cross(c, f))
    if wrench is not None:
        n, f = sub(n, load3(wrench, i, 0)), sub(f, load3(wrench, i, 3))
    n, f = _with_contacts(b, contact, n, f, dn, df, W)
    if b.leaf:
        return n, f
    return add(n, load3(W, b.slot, SF)), add(f, load3(W, b.slot, SF + 3))


@inline
def _with_contacts(b, contact, n, f, dn, df, W):
    if contact is not None:
        k = b.contact
        if k > 0 and W[k, TOUCH] > 0.0:
            J = load3(W, k, SJ) + load3(W, k, SJ + 3)
            H, M = load9(W, k, SH), load3(W, k, SM) + load3(W, k, SM + 3)
            n = sub(add(n, add(symmetric(J, dn), rotate(H, df))), load3(W, k, SF))
            f = sub(add(f, add(rotate_back(H, dn), symmetric(M, df))), load3(W, k, SF + 3))
    return n, f


@kernel
def solve_in_factors(tree, part, base_q, contact, room, W, forces, at, out):
    """Solve A x = forces[at : at + n + 6], joints first, then the base; add the solution to out[at:].

    base_q None: there is no base.  room (bodies, ROOM): scratch.
    """
    root, end = rows_of(part, tree)
    for i in range(root, end):
        for k in range(6):
            room[i, k] = 0.0
    for k in range(1, end - root):
        i = end - k
        b = tree[i]
        n, f = load3(room, i, 0), load3(room, i, 3)
        u = forces[at + b.dof] - along(b, i, n, f, W)
        room[i, 6] = u
        n, f = add(n, scale(load3(W, i, U), u * W[i, DINV])), add(f, scale(load3(W, i, U + 3), u * W[i, DINV]))
        store3(room, b.parent, 0, add(load3(room, b.parent, 0), n))
        store3(room, b.parent, 3, add(load3(room, b.parent, 3), f))
    _solve_base(tree, part, base_q, contact, room, W, forces, at + end - root - 1, out)
    for i in range(root + 1, end):
        b = tree[i]
        dn, df = load3(room, b.parent, 0), load3(room, b.parent, 3)
        x = (room[i, 6] - (dot(load3(W, i, U), dn) + dot(load3(W, i, U + 3), df))) * W[i, DINV]
        out[at + b.dof] += x
        accelerate(b, i, dn, df, x, W, room, 0)


@inline
def _solve_base(tree, part, base_q, contact, room, W, forces, at, out):
    root, _ = rows_of(part, tree)
    n, f = load3(room, root, 0), load3(room, root, 3)
    for k in range(6):
        room[root, k] = 0.0
    if base_q is not None:
        if not is_fixed(part):
            J, H, M = root_inertia(tree, part, contact, W)
            n = sub((forces[at], forces[at + 1], forces[at + 2]), n)
            f = sub((forces[at + 3], forces[at + 4], forces[at + 5]), f)
            x = solve6(J, H, M, n, f)
            for k in range(6):
                room[root, k] = x[k]
                out[at + k] += x[k]
