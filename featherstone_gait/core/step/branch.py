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

TENDONS = 1000000  # weights of tendons come after those of points
GOLDEN = 0.6180339887498949  # multiples of it, less whole numbers, have no sum in common


@kernel
def branches(contact, pairs, step):
    """Return a number that identifies the branches of the laws at the step's solution."""
    key = 0.0 * step.Z[VN, 0]
    n = joint_count(step.scene.trees, step.scene.tree)
    for i in range(n):
        v = step.Z[VN, i]
        w = rotor_speed(rotor_of(step.actuator), step.Z, WN, i, v)
        key = key + _weight(3 * i) * actuator_branch(step.actuator, step, i, v, w)
        angle = step.y[step.offsets.q + i]
        key = key + _weight(3 * i + 1) * stop_branch(step.scene.stops, i, angle, v, step.h_implicit)
        key = key + _weight(3 * i + 2) * friction_branch(step.scene.friction, step, i, v, w)
    key = _tendon_branches(step.scene.tendons, step, 3 * n + TENDONS, key)
    if contact is not None:
        for c in range(len(contact.points)):
            key = key + _weight(3 * n + c) * contact_branch(contact, step, c)
    if pairs is not None:
        for i in range(step.pool.count[0]):
            c = step.pool.placed[i]
            pair = pairs.pairs[step.pool.pair[c]]
            key = key + _weight(3 * n + 1000 + c) * pair_branch(pairs.turning, pair, step, c)
    return key


@inline
def _tendon_branches(tendons, step, first, key):
    if tendons is None:
        return key
    for c in range(len(tendons.table)):
        u = step.W[tendons.table[c].row, TENDON_UN]
        key = key + _weight(first + c) * tendon_branch(tendons, c, step, u)
    return key


@friction_branch.of(GearFriction)
def _and_that_of_loads(friction, step, i, v, w):
    t_m, t_e = loads(friction, step, i, v, w)
    return gear_branch(friction.table[i], v, t_m, t_e)


@kernel
def branches_at_start(contact, pairs, step):
    """Return the same for the start of a step of Euler's."""
    _begin(step.scene.trees, step)
    if pairs is not None:
        place_pairs(pairs, step.predicted, step, lookahead(step.predicted, step.h_implicit))
        for i in range(step.pool.count[0]):
            c = step.pool.placed[i]
            keep(pairs, c, SOLUTION, load(pairs, c, ITERATE, step), step)
    return branches(contact, pairs, step)


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


@inline
def _weight(k):
    x = (k + 1) * GOLDEN
    return x - int(x)
