"""The branches of their laws on which the forces of a step are: where one changes, their slope is discontinuous."""

from ..compile.jit import inline, kernel
from ..effects.actuator import actuator_branch, rotor_of
from ..effects.contact import U0, UN, begin_contact, contact_branch, place_contacts
from ..effects.friction import friction_branch
from ..effects.gear_friction import GearFriction, gear_branch
from ..effects.pair import pair_branch, place_pairs
from ..effects.stop import stop_branch
from ..effects.tendon import U0 as TENDON_U0
from ..effects.tendon import UN as TENDON_UN
from ..effects.tendon import tendon_branch
from ..tree.forest import joint_count, joints_of, points_of, tendons_of
from .context import of_tree
from .newton import VN, VP, WK, WN, loads, lookahead, place_tendons_at, predict, rotor_speed


def branch_count(joints: int, tendons: int, points: int, slots: int) -> int:
    """Return how many laws have a branch: three of each joint, and one of each tendon, contact point and slot."""
    return 3 * joints + tendons + points + slots


@kernel
def note_branches(contact, pairs, step, found):
    """Fill found (branches,) with numbers of the branches on which the laws are at the step's solution."""
    n = joint_count(step.scene.trees, step.scene.tree)
    for i in range(n):
        v = step.Z[VN, i]
        w = rotor_speed(rotor_of(step.actuator), step.Z, WN, i, v)
        found[3 * i] = actuator_branch(step.actuator, step, i, v, w)
        angle = step.y[step.offsets.q + i]
        found[3 * i + 1] = stop_branch(step.scene.stops, i, angle, v, step.h_implicit)
        found[3 * i + 2] = friction_branch(step.scene.friction, step, i, v, w)
    at = _note_tendons(step.scene.tendons, step, 3 * n, found)
    if contact is not None:
        for c in range(len(contact.points)):
            found[at + c] = contact_branch(contact, step, c)
        at += len(contact.points)
    if pairs is not None:
        for c in range(at, len(found)):
            found[c] = 0.0
        for i in range(step.pool.count[0]):
            c = step.pool.placed[i]
            pair = pairs.pairs[step.pool.pair[c]]
            found[at + c] = pair_branch(pairs.turning, pair, step, c)


@inline
def _note_tendons(tendons, step, first, found):
    """Note the branches of tendons from the index `first` on; return the next index."""
    if tendons is None:
        return first
    for c in range(len(tendons.table)):
        u = step.W[tendons.table[c].row, TENDON_UN]
        found[first + c] = tendon_branch(tendons, c, step, u)
    return first + len(tendons.table)


@friction_branch.of(GearFriction)
def _and_that_of_loads(friction, step, i, v, w):
    t_m, t_e = loads(friction, step, i, v, w)
    return gear_branch(friction.table[i], v, t_m, t_e)


@kernel
def note_branches_at_start(contact, pairs, step, found):
    """Do the same for the start of a step of Euler's."""
    _begin(step.scene.trees, contact, step)
    if pairs is not None:
        place_pairs(pairs, step.predicted, step, lookahead(step.predicted, step.h_implicit))
        for i in range(step.pool.count[0]):
            c = step.pool.placed[i]
            for k in range(3):
                step.pool.C[c, UN + k] = step.pool.C[c, U0 + k]
    note_branches(contact, pairs, step, found)


@inline
def _begin(trees, contact, step):
    if trees is None:
        _begin_tree(contact, step)
    else:
        for k in range(len(trees)):
            _begin_tree(contact, of_tree(step, trees[k]))


@inline
def _begin_tree(contact, step):
    """Take the predicted velocities of a tree for those of the solution."""
    predict(step.predicted, rotor_of(step.actuator), step)
    place_contacts(contact, step.predicted, step)
    place_tendons_at(step)
    _hold_tendons(step.scene.tendons, step)
    first, end = joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        step.Z[VN, i], step.Z[WN, i] = step.Z[VP, i], step.Z[WK, i]
        before = step.h_implicit * step.y[step.offsets.qdd + i]
        step.Z[VP, i] = step.Z[VP, i] - before  # loads depend on the last acceleration
    if contact is not None:
        point, end_point = points_of(step.part, contact.points)
        for c in range(point, end_point):
            begin_contact(contact, c, step.C)


@inline
def _hold_tendons(tendons, step):
    if tendons is not None:
        first, end = tendons_of(step.part, tendons.table)
        for c in range(first, end):
            row = tendons.table[c].row
            step.W[row, TENDON_UN] = step.W[row, TENDON_U0]
