"""The branches of their laws on which the forces of a step are: where one changes, their slope is discontinuous."""

from ..compile.jit import inline, kernel
from ..effects.actuator import actuator_branch, rotor_of
from ..effects.contact import contact_branch
from ..effects.element import ITERATE, SOLUTION, keep, load
from ..effects.friction import friction_branch
from ..effects.gear_friction import GearFriction, gear_branch
from ..effects.joint import VN, VP, WN, loads, rotor_speed
from ..effects.pair import pair_branch, place_pairs
from ..effects.predicted import lookahead
from ..effects.stop import stop_branch
from ..effects.tendon import UN as TENDON_UN
from ..effects.tendon import tendon_branch
from ..tree.forest import joint_count, joints_of
from .context import of_tree
from .newton import predict, rest_all


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
    _begin(step.scene.trees, step)
    if pairs is not None:
        place_pairs(pairs, step.predicted, step, lookahead(step.predicted, step.h_implicit))
        for i in range(step.pool.count[0]):
            c = step.pool.placed[i]
            keep(pairs, c, SOLUTION, load(pairs, c, ITERATE, step), step)
    note_branches(contact, pairs, step, found)


@inline
def _begin(trees, step):
    if trees is None:
        _begin_tree(step)
    else:
        for k in range(len(trees)):
            _begin_tree(of_tree(step, trees[k]))


@inline
def _begin_tree(step):
    """Take the predicted velocities of a tree for those of the solution."""
    predict(step.predicted, step)
    rest_all(step)
    first, end = joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        before = step.h_implicit * step.y[step.offsets.qdd + i]
        step.Z[VP, i] = step.Z[VP, i] - before  # loads depend on the last acceleration
