"""Joints that follow others: q_follower = multiplier * q_leader + offset, within the articulated-body algorithm.

Of a coupling the row e (follower: 1, leader: -multiplier) asks e' x = 0 of the accelerations x: a rigid row of rows.py,
whose force is a torque in the direction of e.  It is linear: no step opens it, and `follow` takes rounding away.
"""

from ..compile.jit import inline
from ..compile.optional import if_present, item
from ..compile.structure import record
from .forest import LARGEST, base_index, couplings_of, rows_of
from .rows import (
    COUPLED,
    KIND,
    ROW,
    SOURCE,
    TREE,
    add_block,
    answer_base,
    clear_block,
    entry_of,
    make_rigid,
    push_joint,
)

COUPLING = record(
    body=int,  # row of the follower's body
    dof=int,  # index of its coordinate among the joints
    leader=int,  # row of the leader's body
    leader_dof=int,
    multiplier=float,  # [-, m/rad or rad/m]
    offset=float,  # [rad or m]
)


@inline
def list_couplings(coupling, part, end, rows):
    """Add the couplings of a tree to the blocks of a system, and return its end."""
    if coupling is not None:
        first, last = couplings_of(part, coupling)
        tree = base_index(part)
        for c in range(first, last):
            end = add_block(rows, end, COUPLED, c, 1, (tree, tree))
    return end


@if_present()
def respond_couplings(coupling, scene, system, softness, contact, W, rows):
    """Fill what torques along the couplings of a system leave in the factors."""
    for b in range(system[0] & LARGEST, system[1] & LARGEST):
        if rows.block[b, KIND] == COUPLED:
            k, at = coupling[entry_of(b, SOURCE, rows)], (b, entry_of(b, ROW, rows), 0)
            root, _ = rows_of(item(scene.trees, entry_of(b, TREE, rows)), scene.tree)
            clear_block(scene, b, W, rows)
            make_rigid(b, softness, rows)
            push_joint(scene.tree, root, k.body, 1.0, at, W, rows)
            push_joint(scene.tree, root, k.leader, -k.multiplier, at, W, rows)
            answer_base(scene, b, contact, W, rows)


@inline
def follow(coupling, offsets, y):
    """Set the followers' coordinates in the state y from their leaders', which removes rounding errors."""
    if coupling is not None:
        for c in range(len(coupling)):
            k = coupling[c]
            y[offsets.q + k.dof] = k.multiplier * y[offsets.q + k.leader_dof] + k.offset
            y[offsets.qd + k.dof] = k.multiplier * y[offsets.qd + k.leader_dof]
            y[offsets.qdd + k.dof] = k.multiplier * y[offsets.qdd + k.leader_dof]
