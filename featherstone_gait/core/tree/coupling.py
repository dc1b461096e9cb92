"""Joints that follow others: q_follower = multiplier * q_leader + offset, within the articulated-body algorithm.

Of a coupling the row e (follower: 1, leader: -multiplier) asks e' x = 0 of the accelerations x.  Its force is a torque
in the direction of e: a torque t on the joints turns x by A^-1 t, where A is the mass matrix, with what the step has
folded into it.  The first pass of the ABA has factorised A: with the u and the force p on the root that a torque
leaves on its way to the root, and the articulated inertia IA of the root,

    e' A^-1 t = sum over joints u_e u_t / D + p_e' IA^-1 p_t,

so that e' x of the solution is known before the second pass.  The couplings are made orthogonal in this product one
after the other (Gram-Schmidt, modified), and each takes its part from the solution's u and from dA of the root.  What
the second pass then finds is, for all accelerations at once, that of the projected equations

    G' A G a = G' b,    x = G a,

where G leads from independent accelerations to all: exact, without a stiffness, and without drift but by rounding,
which `follow` takes away.  Couplings are no loops (loop.py) because they are linear: no step opens them, whereas loops
have a compliance and are closed after each step, in the space that couplings leave, also on the same joints.
"""

from ..compile.jit import inline, kernel
from ..compile.structure import record
from .forest import couplings_of, is_fixed, rows_of
from .joint import along
from .layout import COLUMNS, DINV, UU, U
from .spatial import add, load3, scale, solve6, store3

COUPLING = record(
    body=int,  # row of the follower's body
    dof=int,  # index of its coordinate among the joints
    leader=int,  # row of the leader's body
    leader_dof=int,
    row=int,  # of the workspace: what the coupling does to the root
    multiplier=float,  # [-, m/rad or rad/m]
    offset=float,  # [rad or m]
)

# Columns of a coupling's row; its u of the joint of body i stands in that body's row, column COLUMNS + coupling.
ROOT = 0  # 6: force on the root as moment and force [N m; N]
DA = 6  # 6: acceleration that this gives the root [rad/s^2; m/s^2]; zero of the world
SIZE = 12  # its product with itself


@inline
def couple(inertia, coupling, part, tree, W):
    """Let u and dA of the root, which `articulated_pass` has left, lead to accelerations that meet a tree's couplings.

    inertia: the articulated one (J, H, M) of a floating base, None of a fixed one.
    """
    rows, (first, end) = rows_of(part, tree), couplings_of(part, coupling)
    for c in range(first, end):
        _respond(inertia, coupling[c], COLUMNS + c, part, tree, W)
        row = coupling[c].row
        for j in range(first, c):
            other = coupling[j].row
            a = product(rows, (other, COLUMNS + j), (row, DA, COLUMNS + c), W) / W[other, SIZE]
            take(rows, a, (other, COLUMNS + j), (row, DA, COLUMNS + c), W)
            for k in range(6):
                W[row, ROOT + k] -= a * W[other, ROOT + k]
        W[row, SIZE] = product(rows, (row, COLUMNS + c), (row, DA, COLUMNS + c), W)
        a = product(rows, (row, COLUMNS + c), (rows[0], U, UU), W) / W[row, SIZE]
        take(rows, a, (row, COLUMNS + c), (rows[0], U, UU), W)


@inline
def _respond(inertia, k, column, part, tree, W):
    """Fill what a torque of the coupling k leaves: u of the joints, and force and acceleration of the root."""
    root, end = rows_of(part, tree)
    for i in range(root + 1, end):
        W[i, column] = 0.0
    for i in range(DA + 6):
        W[k.row, i] = 0.0
    push_torque(tree, root, k.body, 1.0, column, k.row, W)
    push_torque(tree, root, k.leader, -k.multiplier, column, k.row, W)
    if inertia is not None:
        J, H, M = inertia
        if not is_fixed(part):
            a = solve6(J, H, M, load3(W, k.row, ROOT), load3(W, k.row, ROOT + 3))
            store3(W, k.row, DA, (-a[0], -a[1], -a[2]))
            store3(W, k.row, DA + 3, (-a[3], -a[4], -a[5]))


@kernel
def push_torque(tree, root, i, torque, column, row, W):
    """Add what a torque on the joint of body i leaves on its way to the root."""
    u = torque + 0.0 * W[i, DINV]
    n, f = (0.0 * u, 0.0 * u, 0.0 * u), (0.0 * u, 0.0 * u, 0.0 * u)
    while i > root:
        W[i, column] += u
        x = u * W[i, DINV]
        n, f = add(n, scale(load3(W, i, U), x)), add(f, scale(load3(W, i, U + 3), x))
        i = tree[i].parent
        if i > root:
            u = -along(tree[i], i, n, f, W)
    for k in range(3):
        W[row, ROOT + k] += n[k]
        W[row, ROOT + 3 + k] += f[k]


@kernel
def product(rows, coupling, other, W):
    """Return e' A^-1 t of a coupling (row, column) and of what left u in a column and dA in (row, first)."""
    (row, column), (other_row, first, u) = coupling, other
    total = 0.0 * W[row, ROOT]
    for i in range(rows[0] + 1, rows[1]):
        total = total + W[i, column] * W[i, u] * W[i, DINV]
    for k in range(6):
        total = total - W[row, ROOT + k] * W[other_row, first + k]
    return total


@kernel
def take(rows, a, coupling, other, W):
    """Take `a` times a coupling from what left u and dA: arguments as of `_product`."""
    (row, column), (other_row, first, u) = coupling, other
    for i in range(rows[0] + 1, rows[1]):
        W[i, u] -= a * W[i, column]
    for k in range(6):
        W[other_row, first + k] -= a * W[row, DA + k]


@inline
def follow(coupling, offsets, y):
    """Set the followers' coordinates in the state y from their leaders', which removes rounding errors."""
    if coupling is not None:
        for c in range(len(coupling)):
            k = coupling[c]
            y[offsets.q + k.dof] = k.multiplier * y[offsets.q + k.leader_dof] + k.offset
            y[offsets.qd + k.dof] = k.multiplier * y[offsets.qd + k.leader_dof]
            y[offsets.qdd + k.dof] = k.multiplier * y[offsets.qdd + k.leader_dof]
