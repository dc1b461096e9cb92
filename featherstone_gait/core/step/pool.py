"""The pool: which pairs are near, and the slots of the state in which their points keep bristles and forces.

Pairs that may touch within some steps have a block of slots, in the order of the table; for all others nothing is done
in a step.  How far apart each of these others is makes its budget: the way that its shapes may come closer until the
pool is renewed.  Each joint has a weight: the largest share that a radian or meter of it takes of the budget of a pair
that it moves.  One weighted sum of the ways of a tree's joints bounds the shares of all its pairs, so that most steps
look at no pair, and what moves no near pair counts little.

When the pool is renewed, bounds of the way of each body since the last time say how near each pair can have come to its
distance when that was last computed.  It is computed again only where that is too near.  What a pair's slots hold moves
with it; which pairs are in the pool beyond those that touch changes no bit of a step.

In lanes the pool holds the pairs that are near in any of them.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import apart, inline, kernel
from ..compile.lanes import any_lane, flat, invert, select, sqrt, width_of
from ..compile.optional import if_present
from ..compile.structure import structure
from ..effects.pair import FAR, REACH, SUDDEN, look_in_lane, put_pair, shape_pose, slots_in_use
from ..shapes.distance import HALF_SPACE
from ..shapes.separation import gap_at_least
from ..tree.ball import ball_positions
from ..tree.forest import base_of, joint_count, joints_of, rows_of
from ..tree.kinematics import pose_pass
from ..tree.spatial import add, sub

SPENDING = 12.0  # times the way of a pair's shapes in a step: below it the pair is in the pool
FARTHER = 40.0  # times that: how far away its distance is computed
LONGEST = 2e-2  # [s] for which a pool is renewed; steps with error control may be longer where nothing is near
SHORTEST = 1e-6  # step [s] that is tried before a pool is said to be too small
SEEN = 4.0  # times the resting depth
KEPT = 14  # numbers of a slot that move with its pair: pair, feature, bristle, normal force, gap, position, and
TURNING = 10  # from here on the bristles of the moment
ROUNDED = 1.001  # by how much more than the margin a gap is less
CHORD = 3.141592653589793  # an angle [rad] by the distance of its quaternions is at most this
WAY, MOVED, SPEED, PATH = 0, 1, 2, 3  # rows of `Renewal.ways`


@structure
class Renewal(NamedTuple):
    """Hold coordinates, ways and gaps of pairs from the last renewal of the pool, and scratch arrays."""

    last: np.ndarray  # (7 trees + joints,) coordinates then
    # (4, bodies + 1) bounds of the way of each body's shapes so far and since then [m], speed [m/s], way in a step [m]
    ways: np.ndarray
    weights: np.ndarray  # (trees + joints,) most that a meter of a base or a unit of a joint takes of a pair's budget
    due: np.ndarray  # (pairs,) the way of both shapes that they may have come when they must be looked at again [m]
    frames: np.ndarray  # poses, in the rows of the tree's workspace
    kept: np.ndarray  # (slots, KEPT)
    before: np.ndarray  # (length of the state,) before a step, see sweep.py
    rates: np.ndarray  # (2, coordinates) of the coordinates, before and after it
    within: np.ndarray  # (coordinates,) at an instant between
    placing: np.ndarray  # the same as in Pool, and so are the others
    poses: np.ndarray
    manifold: np.ndarray
    bench: tuple
    narrow: int

    SHARED = ("poses", "manifold", "bench", "narrow")


@if_present(True)
def renew_pool(pairs, run, y, h, begins):
    """Renew the pool if the budget does not reach for a step h [s], or if a run begins; return whether all fits in."""
    o = run.offsets[0]
    if begins or any_lane(invert(_reaches(run, y, h)) & _goes_on(o, y)):
        return _renew(pairs, run, y, h)
    return True


@inline
def _goes_on(o, y):
    """Return whether the run has not ended."""
    return invert(y[o.status] > 0.0)


@if_present(1e300)
def longest_step(pairs, run, y, h, ahead):
    """Return how long a step may be [s], at most h, for which the budget reaches; the pool is renewed if need be.

    Returns -1 where the pool has not enough slots for any step.  ahead None: the method sees no contact before it is
    there, so that while any pair is near no shape may move by more than some depths at which a contact rests.
    """
    if not _reaches(run, y, h):
        h = min(h, LONGEST)
        if not _reaches(run, y, h):
            while not _renew(pairs, run, y, h):
                h = 0.5 * h
                if h < SHORTEST:
                    return -1.0
    return _before_contact(ahead, pairs, run, y, h)


@inline
def _before_contact(ahead, pairs, run, y, h):
    if ahead is None:
        if y[run.offsets[0].pair] > 0.0:
            share = SEEN * pairs.margin / max(_way_of(_fastest(run, y), h), 1e-300)
            if run.plan.second_run:  # else both would take the same steps, and their difference be none
                share = 0.5 * share
            return min(h, h * max(share, 1e-6))
    return h


@kernel
def _reaches(run, y, h):
    """Return whether what each pair outside of the pool has moved, and may move in a step h [s], is within its budget.

    A pair has used at most the sum over its joints of reach |dq| / budget.  The weights are not less than any of these
    factors, so that the sum over all joints of its tree, of two trees the larger one, is a bound.
    """
    scene, o, last, weights = run.scene, run.offsets[0], run.renewal.last, run.renewal.weights
    trees, most = scene.trees, 0.0 * y[o.pair_budget]
    for k in range(len(trees)):
        spent = 0.0 * most
        first, end = joints_of(trees[k], scene.tree)
        for i in range(first, end):
            way = abs(y[o.q + i] - last[7 * len(trees) + i]) + 2.0 * h * abs(y[o.qd + i])
            spent = spent + weights[len(trees) + i] * way
        if scene.pairs.outside[k] > 0:
            shift, velocity = _of_base(run, y, k)
            spent = spent + weights[k] * (shift + 2.0 * h * velocity)
        most = select(spent > most, spent, most)
    return y[o.pair_budget] * (1.0 - most) > SUDDEN * (h * h)


@kernel
def _fastest(run, y):
    """Return a bound of how fast two shapes come closer [m/s]."""
    scene, o, pairs = run.scene, run.offsets[0], run.scene.pairs
    fastest = 0.0 * y[o.pair_budget]
    for k in range(len(scene.trees)):
        speed = 0.0 * fastest
        first, end = joints_of(scene.trees[k], scene.tree)
        for i in range(first, end):
            speed = speed + pairs.reach[i] * abs(y[o.qd + i])
        if pairs.outside[k] > 0:  # two such trees may come closer, else two links of one, by as much as they turn
            _, velocity = _of_base(run, y, k)
            speed = 2.0 * (speed + velocity)
        fastest = select(speed > fastest, speed, fastest)
    return fastest


@inline
def _of_base(run, y, k):
    """Return bounds of way [m] since the last time and speed [m/s] of shapes that move with a tree's base."""
    o, last, radius, part, at = run.offsets[0], run.renewal.last, run.scene.pairs.radius[k], run.scene.trees[k], 7 * k
    x, v = base_of(True, part, y, o.base_q, 7), base_of(True, part, y, o.base_qd, 6)
    shift, turn = 0.0 * x[0], 0.0 * x[0]
    for i in range(3):
        shift = shift + (x[i] - last[at + i]) * (x[i] - last[at + i])
    for i in range(3, 7):
        turn = turn + (x[i] - last[at + i]) * (x[i] - last[at + i])
    speed = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    speed = speed + radius * sqrt(v[3] * v[3] + v[4] * v[4] + v[5] * v[5])
    return sqrt(shift) + (CHORD * radius) * sqrt(turn), speed


@inline
def _way_of(speed, h):
    """Return how much closer shapes come in a step h [s] at a speed [m/s], and as much again for its changes [m]."""
    return 2.0 * h * speed + SUDDEN * (h * h)


@apart
def _renew(pairs, run, y, h):
    """Give the pairs that may touch in the next steps h [s] slots, and set the budget; return whether there are enough.

    If the pool has not enough slots, it holds those that may touch in this step.
    """
    o, room = run.offsets[0], run.renewal
    slots, going = len(room.kept), _goes_on(o, y)
    _move_on(pairs, run, y)
    posed, wide, least = False, 0, 0
    for k in range(len(pairs.pairs)):
        pair = pairs.pairs[k]
        way, step = way_between(pair, room.ways, WAY), _way_of(way_between(pair, room.ways, SPEED), h)
        if any_lane((room.due[k] - way < SPENDING * step) & going):
            if not posed:
                pose_all(run, y)
                posed = True
            room.due[k] = way + _least_gap(pairs, pair, o, y, room, FARTHER * step)
            if any_lane((room.due[k] - way < SPENDING * step) & going):
                wide += pair.slots
            if any_lane((room.due[k] - way < step) & going):
                least += pair.slots
    fits = min(wide, least) <= slots
    if fits:
        _deal_out(pairs, y, h, run, SPENDING if wide <= slots else 1.0)
    return fits


@inline
def pose_all(run, y):
    """Fill the poses of all bodies."""
    scene, o = run.scene, run.offsets[0]
    n = joint_count(scene.trees, scene.tree)
    for k in range(len(scene.trees)):
        base_q = base_of(True, scene.trees[k], y, o.base_q, 7)
        ball_q = ball_positions(scene.balls, y, o.ball_q)
        pose_pass(scene.tree, scene.trees[k], base_q, ball_q, y[o.q : o.q + n], run.renewal.frames)


@inline
def _move_on(pairs, run, y):
    """Add up the ways of all bodies since the last time, and find their speeds."""
    scene, o, last, ways = run.scene, run.offsets[0], run.renewal.last, run.renewal.ways
    trees, sound = scene.trees, y[o.status] == y[o.status]
    for k in range(len(trees)):
        part = trees[k]
        root, end = rows_of(part, scene.tree)
        ways[MOVED, root], ways[SPEED, root] = _of_base(run, y, k)
        x = base_of(True, part, y, o.base_q, 7)
        for i in range(7):
            last[7 * k + i] = x[i]
        at = 7 * len(trees)
        for i in range(root + 1, end):
            up, j = scene.tree[i].parent, scene.tree[i].dof
            ways[MOVED, i] = ways[MOVED, up] + pairs.reach[j] * abs(y[o.q + j] - last[at + j])
            ways[SPEED, i] = ways[SPEED, up] + pairs.reach[j] * abs(y[o.qd + j])
            last[at + j] = y[o.q + j]
        for i in range(root, end):
            sound = sound & (ways[MOVED, i] < FAR)
    for i in range(len(scene.tree)):
        ways[WAY, i] = select(sound, ways[WAY, i] + ways[MOVED, i], 0.0 * y[o.pair_budget])
    if any_lane(invert(sound)):  # infinity, or what follows it
        for k in range(len(pairs.pairs)):
            run.renewal.due[k] = select(sound, run.renewal.due[k], -FAR + 0.0 * y[o.pair_budget])


@inline
def way_between(pair, ways, row):
    """Return a bound for the two shapes of a pair from those of their bodies: what both have in common is neither's."""
    b = pair.body_b if pair.tree_b >= 0 else ways.shape[1] - 1
    return ways[row, pair.body_a] + ways[row, b] - 2.0 * ways[row, pair.meet]


@inline
def _deal_out(pairs, y, h, run, spending):
    """Give slots to the pairs that are nearer than so many times their way in a step h [s], while there are any."""
    o, room = run.offsets[0], run.renewal
    kept, slots, used, old, going = room.kept, len(room.kept), 0, 0, _goes_on(o, y)
    before = slots_in_use(o, y, slots)
    for c in range(before):
        kept[c, 0], kept[c, 1] = y[o.pair + c], y[o.pair_feature + c]
        for k in range(3):
            kept[c, 2 + k] = y[o.pair_deflection + 3 * c + k]
        kept[c, 5], kept[c, 6] = y[o.pair_normal_force + c], y[o.pair_gap + c]
        for k in range(3):
            kept[c, 7 + k] = y[o.pair_position + 3 * c + k]
        _keep_moment(pairs.turning, kept, c, o, y)
        y[o.pair + c] = 0.0
        y[o.pair_feature + c] = 0.0
        y[o.pair_normal_force + c] = 0.0
        y[o.pair_gap + c] = 0.0
        for k in range(3):
            y[o.pair_deflection + 3 * c + k] = 0.0
            y[o.pair_force + 3 * c + k] = 0.0
            y[o.pair_position + 3 * c + k] = 0.0
    budget = FAR + 0.0 * y[o.pair_budget]
    for i in range(len(room.weights)):
        room.weights[i] = 0.0
    for k in range(len(pairs.pairs)):
        pair = pairs.pairs[k]
        left = room.due[k] - way_between(pair, room.ways, WAY)
        if any_lane((left < spending * _way_of(way_between(pair, room.ways, SPEED), h)) & going):
            if used + pair.slots <= slots:
                while old < before and not any_lane(kept[old, 0] > k):
                    old += 1
                _take_over(pairs.turning, k, pair.slots, used, (old, before), kept, o, y)
                used += pair.slots
        else:
            budget = select(left < budget, left, budget)
            _weigh(pairs, pair, 1.0 / left, run)
    y[o.pair_budget] = budget


@kernel
def _weigh(pairs, pair, share, run):
    """Let the joints of a pair, and the bases if it is of two trees, weigh at least what they take of its budget.

    share: 1 by the budget [1/m]; where both trees move each has half of it.
    """
    scene, weights = run.scene, run.renewal.weights
    if pair.folded == 0 and pair.tree_b != pair.tree_a:
        share = 2.0 * share
    for tree, body in ((pair.tree_a, pair.body_a), (pair.tree_b, pair.body_b)):
        if tree >= 0:
            root, i = scene.trees[tree].root, body
            while i != root and i != pair.meet:
                at = len(scene.trees) + scene.tree[i].dof
                weight = share * pairs.reach[scene.tree[i].dof]
                weights[at] = select(weight > weights[at], weight, weights[at])
                i = scene.tree[i].parent
            if pair.tree_b != pair.tree_a:
                weights[tree] = select(share > weights[tree], share, weights[tree])


@inline
def _keep_moment(turning, kept, c, o, y):
    """Move the bristles of the moment of a slot out of the state."""
    if turning is not None:
        for k in range(4):
            kept[c, TURNING + k] = y[o.pair_turning + 4 * c + k]
            y[o.pair_turning + 4 * c + k] = 0.0


@inline
def _least_gap(pairs, pair, o, y, room, least):
    """Return a lower bound of the gap of a pair beyond the margin [m]: the gap if it is less than `least`, or not much.

    As far as the first shape is large it is computed too, so that it need not be soon again.
    """
    a, b, W = pairs.shapes.table[pair.a], pairs.shapes.table[pair.b], room.frames
    Ea, ra = shape_pose(a, pair.tree_a, pair.body_a, W)
    Eb, rb = shape_pose(b, pair.tree_b, pair.body_b, W)
    c = sub(in_world(pair.tree_a, ra, o, y), in_world(pair.tree_b, rb, o, y))
    far = least + a.bound + pairs.margin
    gap = gap_at_least(a, b, Ea, Eb, c, far)
    near = gap < far
    if a.kind <= HALF_SPACE and b.kind <= HALF_SPACE and any_lane(near):  # a height field has no distances
        zero = 0.0 * c[0]
        put_pair(room.placing, (Ea, c), (Eb, (zero, zero, zero)), far, near)
        numbers, width = flat(room.placing), width_of(y)
        for lane in range(width):
            found, at = look_in_lane(pairs, pair, room, lane, width), REACH * width + lane
            for m in range(found):
                numbers[at] = min(numbers[at], -room.manifold[m, 6])
        gap = select(near, room.placing[2, 3], gap)
    return gap - ROUNDED * pairs.margin


@inline
def in_world(tree, r, o, y):
    """Return a point in the frame of a tree in that of the world."""
    if tree < 0:
        return r
    at = o.base_q + 7 * tree
    return add(r, (y[at], y[at + 1], y[at + 2]))


@inline
def _take_over(turning, k, count, used, where, kept, o, y):
    """Move what the slots of a pair held, in each lane, to those that it has now; it was within the slots `where`."""
    old, new, width, (first, end) = flat(kept), flat(y), width_of(y), where
    for j in range(count):
        y[o.pair + used + j] = k + 1.0
        y[o.pair_gap + used + j] = FAR
    for lane in range(width):
        c = first
        while c < end and 0.0 < old[c * KEPT * width + lane] <= k:
            c += 1
        if c < end and old[c * KEPT * width + lane] == k + 1.0:
            for j in range(count):
                at = (c + j) * KEPT * width + lane
                new[(o.pair_feature + used + j) * width + lane] = old[at + width]
                for i in range(3):
                    new[(o.pair_deflection + 3 * (used + j) + i) * width + lane] = old[at + (2 + i) * width]
                new[(o.pair_normal_force + used + j) * width + lane] = old[at + 5 * width]
                new[(o.pair_gap + used + j) * width + lane] = old[at + 6 * width]
                for i in range(3):
                    new[(o.pair_position + 3 * (used + j) + i) * width + lane] = old[at + (7 + i) * width]
                if turning is not None:
                    for i in range(4):
                        new[(o.pair_turning + 4 * (used + j) + i) * width + lane] = old[at + (TURNING + i) * width]
