"""Contact between bodies: the law of contact.py at the points of pairs of shapes, with a bristle each.

Of a pair, body b is what the normal points away from; where one of both cannot move, it is b.  The relative velocity
u = v_a - v_b and the force on a are in the axes of the point (normal, two tangents); b takes the opposite force at the
same place, so that momentum and angular momentum are kept to rounding.

A pair's points come and go with its bodies.  What lasts from step to step, the bristles, is kept in a pool of slots in
the state, a block of slots for each pair that is near: see step/pool.py.
"""

from typing import NamedTuple

import numpy as np

from ..compile.elementary import sincos
from ..compile.jit import apart, inline, kernel
from ..compile.lanes import any_lane, flat, select, sqrt, width_of
from ..compile.optional import if_present
from ..compile.outside import call_entry
from ..compile.structure import record, structure
from ..compile.taped import noting, value_of
from ..shapes.distance import HALF_SPACE, Shapes
from ..shapes.separation import gap_at_least
from ..tree.forest import joint_count
from ..tree.layout import SF, TOUCH, R, U, V
from ..tree.rigid_body import center_velocity, point_position
from ..tree.spatial import (
    add,
    compose,
    cross,
    dot,
    load3,
    load9,
    rotate,
    rotate_back,
    scale,
    store3,
    store9,
    sub,
    vector,
)
from . import element
from .contact import (
    C1,
    CN,
    DEPTH,
    LIMIT,
    fold_moment,
    fold_point,
    friction_force,
    linearize_point,
    normal_force,
    point_force,
    solve_point,
)
from .element import FK, U0, UK, UN, XP
from .surface import add_drive_work, surface_motion
from .touch import AXES

PAIR = record(
    a=int,  # row of the shape in the table of `Shapes`
    b=int,
    tree_a=int,  # number of the tree that carries it
    tree_b=int,  # -1: fixed to the world, and E, r of its shape are those in the world
    body_a=int,  # row of the body
    body_b=int,
    row_a=int,  # workspace row in which the body's contacts are summed
    row_b=int,
    folded=int,  # 1 = b cannot move: a point of the pair touches a alone
    own_a=int,  # 1 = the body has no contact point on the ground, whose sum would clear the row
    own_b=int,
    meet=int,  # row of the last body that both hang on, one beyond the last row if there is none
    slots=int,  # points that the pair can have
    stiffness=float,  # normal, of a point [N/m]
    damping=float,  # Hunt and Crossley's d [s/m]
    friction=float,  # coefficient
    tangential_stiffness=float,  # [N/m]
    tangential_damping=float,  # [N s/m]
    deepest=float,  # depth beyond which a run ends: see step/depth.py [m]
)

TURNING = record(
    torsional=float,  # limit of the moment about the normal by the normal force [m]
    rolling=float,  # and of that across it [m]
    tangential_stiffness=float,  # [N m/rad]
    tangential_damping=float,  # [N m s/rad]
)


@structure
class Pairs(NamedTuple):
    """Shapes, and pairs of them that may touch."""

    shapes: Shapes  # E, r of a shape: in the frame of its body
    pairs: np.ndarray  # (pairs,) PAIR, by tree_a, tree_b and then bodies
    bodies: np.ndarray  # (n + 1,) BODY of what touches nothing: without workspace rows for pairs
    own_rows: np.ndarray  # (rows,) of row_a and row_b, those of bodies without a contact point on the ground
    reach: np.ndarray  # (joints,) bound of the way [m] that a shape moves by one radian or meter of a joint
    outside: np.ndarray  # (trees,) 1 = may touch what is not of the tree
    radius: np.ndarray  # (trees,) bound of the distance from a tree's base to any point of its shapes [m]
    slots: np.ndarray  # (2,) slots of the pool; points between bodies that can move, of which so many act at once
    margin: float  # the depth at which a pair rests under its load [m]: gaps below it are looked at
    turning: np.ndarray | None  # (pairs,) TURNING; None where no pair resists rolling or spinning
    surfaces: np.ndarray | None = None  # (shapes,) SURFACE; None where all are at rest


@structure
class Pool(NamedTuple):
    """Scratch arrays of the pairs."""

    # Points, and after the last slot their moments, where any pair has some: the same columns, of angles and moments.
    C: np.ndarray  # (rows, COLUMNS): of the columns of contact.py and those below
    pair: np.ndarray  # (rows,) row of the pair that has the slot
    count: np.ndarray  # (4,) points, islands, slots in use, most slots that were in use
    placed: np.ndarray  # (rows,) those of the points and moments
    # Islands: trees that touch each other, by tree_a of their points; see step/island.py.
    parent: np.ndarray  # (trees,)
    trees: np.ndarray  # (trees,) numbers of trees, one island after the other
    first_tree: np.ndarray  # (trees + 1,) of each island
    points: np.ndarray  # (rows,) points and moments at work, one island after the other
    first_point: np.ndarray  # (trees + 1,) of each island
    island: np.ndarray  # (trees + 1,) of each tree; scratch of counting before
    label: np.ndarray  # (trees,) island of each tree by lane: its first tree
    # The narrow phase, one lane after the other, and the exchange of slots.
    manifold: np.ndarray  # (8, 8)
    bench: tuple  # Bench of shapes/patch.py
    placing: np.ndarray  # (4, 12) rotation and center [m] of two shapes by lane; way between trees, gap; 1: is near
    poses: np.ndarray  # (2, 12) rotation and center [m] of two shapes
    narrow: int  # address of `contacts_at`, which is compiled once for all kinds of scenes
    old: np.ndarray  # (slots, 6)

    SHARED = (
        "pair", "count", "placed", "parent", "trees", "first_tree", "points", "first_point", "island",
        "manifold", "bench", "poses", "narrow", "old",
    )  # fmt: skip


# Columns of a point beyond those of contact.py, whose XP is the place in the frame of tree_a.
XB = AXES + 9  # 3: position in the frame of tree_b [m]
Z = XB + 3  # 2: bristle along the tangents [m]
ON = Z + 2  # 1 where the point is near enough to touch within the step
GAP = ON + 1  # distance of the surfaces where the predicted state has them [m]; FAR where there is no point
FACTOR = GAP + 1  # 4: h times the slopes as W W', W lower triangular: normal, 11, 21, 22
MOVES = FACTOR + 4  # 6: of the surfaces of a and b, velocity along the tangents [m/s], then turning [rad/s]
CLEARED = MOVES  # columns that are cleared
COLUMNS = MOVES + 6
FAR = 1e9  # [m]
SHAPE_POSE = 12  # numbers of a rotation and a center: columns of `Pool.placing`
REACH = 2 * SHAPE_POSE + 3  # number in it up to which gap points are looked for [m]
FULL = 5.0  # status of a run in which more touches than there is room for
LEAST = 1e-150  # length of a bristle below which it is none [m]
STRETCH = 2.0  # most by which a bristle is made longer that leaves the tangent plane: it is turned by up to 60 degrees
OLD = 6  # columns of `Pool.old`


# ---------------------------------------------------------------------------------------------- place


@apart
def place_pairs(pairs, predicted, step, lookahead_time):
    """Fill position, axes, penetration and predicted velocity of the points of all pairs in the pool.

    W is that of a time [s] after the step's start: what the gap has changed since then is taken back.  What is not near
    and has been found so before stays as it is, without a point.
    """
    y, offsets, pool, width = step.y, step.offsets, step.pool, width_of(step.y)
    numbers, slots, c, placed, lane = flat(y), len(pool.old), 0, 0, _lane_that_goes_on(y, offsets.status)
    while c < slots:
        k = int(value_of(numbers[(offsets.pair + c) * width + lane])) - 1
        if k < 0:
            break
        pair = pairs.pairs[k]
        near = _approach(pairs, pair, predicted, step)
        for j in range(c, c + pair.slots):
            near = near or _is_known(pairs.turning, y, offsets, j)
        if near:
            _clear(noting(y), pool.C, c, pair.slots)
            _clear_moments(pairs.turning, pool, c, pair.slots)
            _place_points(noting(y), pairs, pair, step, c, width)
            for j in range(c, c + pair.slots):
                if any_lane(pool.C[j, GAP] < FAR) or _is_known(pairs.turning, y, offsets, j):
                    pool.pair[j], pool.placed[placed] = k, j
                    _finish(pairs.surfaces, pair, step, j, lookahead_time, pairs.margin)
                    placed = _finish_moment(pairs.turning, pairs.surfaces, pair, step, j, placed + 1)
        c += pair.slots
    pool.count[0] = placed
    pool.count[2] = c


@inline
def _lane_that_goes_on(y, status):
    """Return a lane whose run has not ended: one that has keeps the pool that it had then."""
    ended, lane = flat(y), 0
    while lane < width_of(y) - 1 and ended[status * width_of(y) + lane] > 0.0:
        lane += 1
    return lane


@inline
def _is_known(turning, y, offsets, c):
    """Return whether the state holds a point in the slot c, in any lane, or what one has left there."""
    z = _deflection(y, offsets, c)
    left = (y[offsets.pair_feature + c] > 0.0) | (y[offsets.pair_gap + c] < FAR)
    left = left | (abs(z[0]) + abs(z[1]) + abs(z[2]) > 0.0)
    if turning is not None:
        for k in range(4):
            left = left | (abs(y[offsets.pair_turning + 4 * c + k]) > 0.0)
    return any_lane(left)


@inline
def _clear(noted, C, c, count):
    """Set points to none, of finite numbers, but for the velocities of a solution that is noted (taped.py)."""
    for j in range(c, c + count):
        for k in range(CLEARED):
            if noted is None or k < UN or k > UN + 2:
                C[j, k] = 0.0
        C[j, GAP] = FAR
        C[j, AXES] = 1.0
        C[j, AXES + 4] = 1.0
        C[j, AXES + 8] = 1.0


@inline
def shape_pose(shape, tree, body, W):
    """Return rotation (9) and center (3) [m] of a shape in the frame of its tree, in the world where tree < 0."""
    E, r = load9_of(shape.E), vector(shape.r)
    if tree < 0:
        zero = 0.0 * W[0, R]
        return (
            (E[0] + zero, E[1] + zero, E[2] + zero, E[3] + zero, E[4] + zero, E[5] + zero, E[6] + zero, E[7] + zero,
             E[8] + zero), (r[0] + zero, r[1] + zero, r[2] + zero),
        )  # fmt: skip
    return compose(load9(W, body, R), E), point_position(body, r, W)


@inline
def load9_of(a):
    """Return the nine numbers of an array."""
    return (a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8])


@inline
def _base_position(predicted, step, tree):
    """Return the origin of a tree's frame in the world [m]; that of the world for tree < 0."""
    if tree < 0:
        zero = 0.0 * step.W[0, R]
        return (zero, zero, zero)
    return _position(predicted, step, tree)


@inline
def _position(predicted, step, tree):
    y, at = step.y, step.offsets.base_q + 7 * tree
    if predicted is not None:
        y, at = predicted, 2 * joint_count(step.scene.trees, step.scene.tree) + 7 * tree
    return (y[at], y[at + 1], y[at + 2])


@inline
def _approach(pairs, pair, predicted, step):
    """Fill poses and distance to be looked at of two shapes; return whether they are nearer than that, in any lane."""
    W, placing = step.W, step.pool.placing
    a, b = pairs.shapes.table[pair.a], pairs.shapes.table[pair.b]
    Ea, ra = shape_pose(a, pair.tree_a, pair.body_a, W)
    Eb, rb = shape_pose(b, pair.tree_b, pair.body_b, W)
    zero = 0.0 + 0.0 * ra[0]
    shift = (zero, zero, zero)  # from the frame of tree_b to that of tree_a
    if pair.tree_b != pair.tree_a:
        shift = sub(_base_position(predicted, step, pair.tree_b), _base_position(predicted, step, pair.tree_a))
    h, span = zero + step.h_implicit, zero + step.span
    speed = _speed(pair, (a, b), (ra, rb), step)
    far = 2.0 * h * speed + SUDDEN * (h * h) + pairs.margin
    blind = select(h < span, span * speed, zero)
    rb = add(rb, shift)
    gap = gap_at_least(a, b, Ea, Eb, sub(ra, rb), select(far > blind, far, blind))
    _jump((gap < blind) & (blind > thickness(a, b)), step)
    near = gap < far
    put_pair(placing, (Ea, ra), (Eb, rb), far, near)
    store3(placing, 2, 0, shift)
    return any_lane(near)


@inline
def put_pair(placing, a, b, far, near):
    """Store the poses of two shapes for `look_in_lane`, how far apart their points are looked for, and where at all."""
    store9(placing, 0, 0, a[0])
    store3(placing, 0, 9, a[1])
    store9(placing, 1, 0, b[0])
    store3(placing, 1, 9, b[1])
    placing[2, 3] = far
    placing[3, 0] = select(near, 1.0 + 0.0 * far, 0.0 * far)


@inline
def look_in_lane(pairs, pair, room, lane, width):
    """Fill the manifold of a pair in one lane; return the count of its points.  room: Pool or Renewal."""
    placing, found = flat(room.placing), 0
    if placing[3 * SHAPE_POSE * width + lane] > 0.0:
        for k in range(2 * SHAPE_POSE):
            room.poses[k // SHAPE_POSE, k % SHAPE_POSE] = placing[k * width + lane]
        far = placing[REACH * width + lane]
        found = call_entry(room.narrow, (pairs.shapes, pair.a, pair.b, room.poses, far, room.bench, room.manifold))
    return found


@inline
def _place_points(noted, pairs, pair, step, c, width):
    """Find the points of a pair, lane by lane or with their derivatives."""
    if noted is None:
        for lane in range(width):
            _place_in_lane(pairs, pair, step, c, lane, width)
    else:
        place_noted(pairs, pair, step, c)


@inline
def _place_in_lane(pairs, pair, step, c, lane, width):
    """Find the points of a pair in one lane, and put each into the slot that its features had."""
    pool, placing, found = step.pool, flat(step.pool.placing), look_in_lane(pairs, pair, step.pool, lane, width)
    _keep_features(pairs.turning, pair, step, c, lane, width, found)
    C, at = flat(pool.C), 2 * SHAPE_POSE * width + lane
    shift = (placing[at], placing[at + width], placing[at + 2 * width])
    for m in range(found):
        j = int(pool.old[m, 0])
        if j >= 0:
            x, n = load3(pool.manifold, m, 0), load3(pool.manifold, m, 3)
            t = _tangent(n)
            _store(C, c + j, XP, x, lane, width)
            _store(C, c + j, XB, sub(x, shift), lane, width)
            _store(C, c + j, AXES, n, lane, width)
            _store(C, c + j, AXES + 3, t, lane, width)
            _store(C, c + j, AXES + 6, cross(n, t), lane, width)
            C[((c + j) * COLUMNS + GAP) * width + lane] = -pool.manifold[m, 6]


NEAR_BY = 1e-4  # of the size of a pair: largest motion of its first shape by which derivatives are taken
FEW = 1e-6  # [m] size of a pair that is a point


@apart
def place_noted(pairs, pair, step, c):
    """Find the points of a pair, and how they move with its shapes (taped.py).

    The narrow phase tells the points alone: how they change when the first shape moves relative to the second is taken
    by central differences of fourth order, with an error of some 1e-11; the rest is a motion of the whole.
    """
    pool, placing, poses = step.pool, step.pool.placing, step.pool.poses
    for k in range(2):
        for i in range(SHAPE_POSE):
            poses[k, i] = value_of(placing[k, i])
    found = 0
    if value_of(placing[3, 0]) > 0.0:
        found = _look(pairs, pair, pool, value_of(placing[2, 3]))
    _keep_features(pairs.turning, pair, step, c, 0, 1, found)
    if found == 0:
        return
    turn_a, way_a, turn_b, way_b = _small_motion(placing, poses, 0) + _small_motion(placing, poses, 1)
    between = sub(load3(poses, 0, 9), load3(poses, 1, 9))
    way = sub(way_a, add(way_b, cross(turn_b, between)))
    turn, shift = sub(turn_a, turn_b), load3(placing, 2, 0)
    for m in range(found):
        j = int(pool.old[m, 0])
        if j >= 0:
            x, n = load3(pool.manifold, m, 0), load3(pool.manifold, m, 3)
            store3(pool.C, c + j, XP, add(x, add(way_b, cross(turn_b, sub(x, load3(poses, 1, 9))))))
            store3(pool.C, c + j, AXES, add(n, cross(turn_b, n)))
            pool.C[c + j, GAP] = -pool.manifold[m, 6]
    a, b = pairs.shapes.table[pair.a], pairs.shapes.table[pair.b]
    size = max(a.bound, FEW) if b.kind >= HALF_SPACE else max(a.bound + b.bound, FEW)
    for k in range(6):
        by = turn[k % 3] if k < 3 else way[k % 3]
        h = NEAR_BY * (1.0 if k < 3 else size)
        for step_of in range(4):
            to, weight = h * (1.0 - 2.0 * (step_of % 2)), 4.0 / 3.0
            if step_of < 2:
                to, weight = 2.0 * to, -1.0 / 3.0
            _add_difference(pairs, pair, step, c, (k, to, weight / (2.0 * to)), by)
    for i in range(SHAPE_POSE):
        poses[0, i] = value_of(placing[0, i])
    for j in range(c, c + pair.slots):
        if value_of(pool.C[j, GAP]) < FAR:
            x, n = load3(pool.C, j, XP), load3(pool.C, j, AXES)
            t = _tangent(n)
            store3(pool.C, j, XB, sub(x, shift))
            store3(pool.C, j, AXES + 3, t)
            store3(pool.C, j, AXES + 6, cross(n, t))


@inline
def _look(pairs, pair, pool, far):
    arguments = (pairs.shapes, pair.a, pair.b, pool.poses, far, pool.bench, pool.manifold)
    return call_entry(pool.narrow, arguments)


@inline
def _small_motion(placing, poses, k):
    """Return the rotation (3) and the way (3) of a shape, zero but for their derivatives."""
    E, r, F, s = load9(placing, k, 0), load3(placing, k, 9), load9(poses, k, 0), load3(poses, k, 9)
    M = compose(E, (F[0], F[3], F[6], F[1], F[4], F[7], F[2], F[5], F[8]))
    return (0.5 * (M[7] - M[5]), 0.5 * (M[2] - M[6]), 0.5 * (M[3] - M[1])), sub(r, s)


@kernel
def _add_difference(pairs, pair, step, c, change, by):
    """Add what the points found with a moved first shape say of their derivative; by: the number that moves it."""
    pool, (k, to, weight) = step.pool, change
    for i in range(SHAPE_POSE):
        pool.poses[0, i] = value_of(step.pool.placing[0, i])
    if k < 3:
        _turn_shape(pool.poses, k, to)
    else:
        pool.poses[0, 9 + k - 3] += to
    found = _look(pairs, pair, pool, value_of(pool.placing[2, 3]))
    for m in range(found):
        for j in range(c, c + pair.slots):
            if value_of(step.y[step.offsets.pair_feature + j]) == pool.manifold[m, 7] + 1.0:
                for i in range(3):
                    at_x, at_n = value_of(pool.C[j, XP + i]), value_of(pool.C[j, AXES + i])
                    pool.C[j, XP + i] = pool.C[j, XP + i] + (weight * (pool.manifold[m, i] - at_x)) * by
                    pool.C[j, AXES + i] = pool.C[j, AXES + i] + (weight * (pool.manifold[m, 3 + i] - at_n)) * by
                depth = pool.manifold[m, 6] + value_of(pool.C[j, GAP])
                pool.C[j, GAP] = pool.C[j, GAP] - (weight * depth) * by


@inline
def _turn_shape(poses, k, angle):
    """Turn the first shape about an axis of the world."""
    s, c = sincos(angle)
    i, j = (k + 1) % 3, (k + 2) % 3
    for column in range(3):
        y, z = poses[0, 3 * i + column], poses[0, 3 * j + column]
        poses[0, 3 * i + column] = c * y - s * z
        poses[0, 3 * j + column] = s * y + c * z


@inline
def _speed(pair, shapes, centers, step):
    """Return how fast points of two shapes can move towards each other [m/s]."""
    (a, b), (ra, rb) = shapes, centers
    va, wa = _motion(pair.tree_a, pair.body_a, ra, step.W)
    vb, wb = _motion(pair.tree_b, pair.body_b, rb, step.W)
    v, turn = sub(va, vb), sqrt(dot(wa, wa)) * a.bound
    if pair.folded == 0:
        turn = turn + sqrt(dot(wb, wb)) * b.bound
    return sqrt(dot(v, v)) + turn


SUDDEN = 100.0  # acceleration for which there is room [m/s^2]; twice the way of a step is looked ahead


@inline
def _jump(mask, step):
    """Count a step in which a body may jump over another as one that has not converged."""
    y, at = step.y, step.offsets.newton_iterations + 1
    if any_lane(mask):
        y[at] = select(mask, y[at] + 1.0, y[at])


@inline
def thickness(a, b):
    """Return a way [m] on which a body does not pass the middle of another."""
    if b.kind >= HALF_SPACE:
        return FAR
    least_a = min(a.extent[0], min(a.extent[1], a.extent[2]))
    return least_a + min(b.extent[0], min(b.extent[1], b.extent[2]))


@inline
def _motion(tree, body, r, W):
    """Return the velocities of the point r and of the body [m/s, rad/s]."""
    if tree < 0:
        zero = 0.0 * r[0]
        return (zero, zero, zero), (zero, zero, zero)
    return center_velocity(body, r, W), load3(W, body, V)


@inline
def _store(C, c, column, a, lane, width):
    at = (c * COLUMNS + column) * width + lane
    C[at] = a[0]
    C[at + width] = a[1]
    C[at + 2 * width] = a[2]


@inline
def _tangent(n):
    """Return a unit vector across the unit vector n."""
    if abs(n[0]) < 0.6:
        r = 1.0 / sqrt(n[1] * n[1] + n[2] * n[2])
        return (0.0, n[2] * r, -n[1] * r)
    r = 1.0 / sqrt(n[0] * n[0] + n[1] * n[1])
    return (n[1] * r, -n[0] * r, 0.0)


@kernel
def _keep_features(turning, pair, step, c, lane, width, found):
    """Give each of the points found a slot of the pair, old[m, 0]: that of its feature, else one that is free.

    Where features change, as from a face to its edge, points that have gone go on, with force and bristle, as the new
    ones that are nearest to them.  What has gone otherwise leaves its slot, with its bristle.
    """
    y, o, pool = flat(step.y), step.offsets, step.pool
    new = found
    for m in range(found):
        pool.old[m, 0] = -1.0
    for j in range(pair.slots):
        at, kept = (o.pair_feature + c + j) * width + lane, False
        for m in range(found):
            if y[at] == pool.manifold[m, 7] + 1.0:
                pool.old[m, 0], kept = j, True
                new -= 1
        if not kept:
            y[at] = 0.0
    while new > 0:
        m, j, heir = _next_point(pair, step, c, lane, width, found)
        if j < 0:
            break
        new -= 1
        pool.old[m, 0] = j
        y[(o.pair_feature + c + j) * width + lane] = pool.manifold[m, 7] + 1.0
        if not heir:
            y[(o.pair_normal_force + c + j) * width + lane] = 0.0  # that of what had the slot before
            for k in range(3):
                y[(o.pair_deflection + 3 * (c + j) + k) * width + lane] = 0.0
            if turning is not None:
                for k in range(4):
                    y[(o.pair_turning + 4 * (c + j) + k) * width + lane] = 0.0


@inline
def _next_point(pair, step, c, lane, width, found):
    """Return a new point, its slot (-1: there is none), and whether what was pressed there goes on as this point."""
    y, o, pool = flat(step.y), step.offsets, step.pool
    point, slot, least, heir = 0, -1, 1e300, False
    for m in range(found):
        if pool.old[m, 0] < 0.0:
            for j in range(pair.slots):
                if y[(o.pair_feature + c + j) * width + lane] == 0.0:
                    if value_of(y[(o.pair_gap + c + j) * width + lane]) < 0.0:
                        way = 0.0
                        for k in range(3):
                            at = value_of(y[(o.base_q + 7 * pair.tree_a + k) * width + lane]) + pool.manifold[m, k]
                            d = at - value_of(y[(o.pair_position + 3 * (c + j) + k) * width + lane])
                            way += d * d
                        if way < least:
                            point, slot, least, heir = m, j, way, True
                    elif slot < 0:
                        point, slot = m, j
    return point, slot, heir


@inline
def _frame_b(pair, W):
    """Return the rotation of the body in whose frame the bristle is kept."""
    if pair.tree_b < 0:
        one, zero = 1.0 + 0.0 * W[0, R], 0.0 * W[0, R]
        return (one, zero, zero, zero, one, zero, zero, zero, one)
    return load9(W, pair.body_b, R)


@inline
def _velocity_of_b(pair, x, W):
    if pair.tree_b < 0:
        zero = 0.0 * x[0]
        return (zero, zero, zero)
    return center_velocity(pair.body_b, x, W)


@inline
def _finish(surfaces, pair, step, c, lookahead_time, margin):
    """Fill velocity, depth, bristle and friction limit of a point, in all lanes."""
    W, C, y, o, h = step.W, step.pool.C, step.y, step.offsets, step.h_implicit
    n, t, s = load3(C, c, AXES), load3(C, c, AXES + 3), load3(C, c, AXES + 6)
    v = sub(center_velocity(pair.body_a, load3(C, c, XP), W), _velocity_of_b(pair, load3(C, c, XB), W))
    u = _with_surfaces(surfaces, pair, step, c, (dot(n, v), dot(t, v), dot(s, v)))
    store3(C, c, U0, u)
    store3(C, c, UK, u)
    gap, zero = C[c, GAP], 0.0 * C[c, GAP]
    near = gap < margin + 2.0 * (h * sqrt(dot(v, v)))
    C[c, ON] = select(near, 1.0 + zero, zero)
    C[c, DEPTH] = select(near, lookahead_time * u[0] - gap, zero - FAR)
    z = _in_plane(_deflection(y, o, c), _frame_b(pair, W), t, s, near)
    C[c, Z], C[c, Z + 1] = _with_surface_of_b(surfaces, z, c, h, C)
    predicted_force, _ = normal_force(pair, C[c, DEPTH], u[0], h)
    last = y[o.pair_normal_force + c]
    C[c, LIMIT] = select(near, pair.friction * select(last > 0.0, last, predicted_force), zero)


@inline
def _with_surfaces(surfaces, pair, step, c, u):
    """Return the velocity u of the point c, to which the surfaces' on both bodies are added."""
    if surfaces is None:
        return u
    C = step.pool.C
    n, t, s = load3(C, c, AXES), load3(C, c, AXES + 3), load3(C, c, AXES + 6)
    va, ra = surface_motion(surfaces[pair.a], pair.tree_a, pair.body_a, load3(C, c, XP), n, step)
    vb, rb = surface_motion(surfaces[pair.b], pair.tree_b, pair.body_b, load3(C, c, XB), n, step)
    C[c, MOVES], C[c, MOVES + 1], C[c, MOVES + 4] = dot(t, va), dot(s, va), ra
    C[c, MOVES + 2], C[c, MOVES + 3], C[c, MOVES + 5] = dot(t, vb), dot(s, vb), rb
    return (u[0], u[1] + (C[c, MOVES] - C[c, MOVES + 2]), u[2] + (C[c, MOVES + 1] - C[c, MOVES + 3]))


@inline
def _with_surface_of_b(surfaces, z, c, h, C):
    """Return a bristle as the surface of body b has turned it by the end of a step h [s]."""
    if surfaces is None:
        return z
    turn = h * C[c, MOVES + 5]
    k = 1.0 / (1.0 + turn * turn)
    return (k * (z[0] - turn * z[1]), k * (z[1] + turn * z[0]))


@inline
def _before_turning(surfaces, z, c, h, C):
    """Return the bristle of which `_with_surface_of_b` has made z."""
    if surfaces is None:
        return z
    turn = h * C[c, MOVES + 5]
    return (z[0] + turn * z[1], z[1] - turn * z[0])


@inline
def _turning_rate(surfaces, z, m1, m2, c, C):
    """Return the rates m1, m2 of a bristle z with that by which the surface of body b turns it."""
    if surfaces is None:
        return m1, m2
    return m1 - C[c, MOVES + 5] * z[1], m2 + C[c, MOVES + 5] * z[0]


@inline
def _drives_power(surfaces, pair, f, c, h, step, work):
    """Return what drives give to the point c under its force f [W], and add h times that to theirs."""
    if surfaces is None:
        return 0.0
    C = step.pool.C
    on, zero = C[c, ON] > 0.0, 0.0 * C[c, ON]
    a = select(on, -(f[1] * C[c, MOVES] + f[2] * C[c, MOVES + 1]), zero)
    b = select(on, f[1] * C[c, MOVES + 2] + f[2] * C[c, MOVES + 3], zero)
    add_drive_work(surfaces[pair.a], a, h, step, work)
    add_drive_work(surfaces[pair.b], b, h, step, work)
    return a + b


@inline
def _spinning_power(surfaces, pair, m, c, h, step, work):
    """Do as `_drives_power` for the moment c, whose part about the normal is m [N m]."""
    if surfaces is None:
        return 0.0
    C = step.pool.C
    on, zero = C[c, ON] > 0.0, 0.0 * C[c, ON]
    a, b = select(on, -m * C[c, MOVES + 4], zero), select(on, m * C[c, MOVES + 5], zero)
    add_drive_work(surfaces[pair.a], a, h, step, work)
    add_drive_work(surfaces[pair.b], b, h, step, work)
    return a + b


@inline
def _spun(surfaces, u, c, row, C):
    """Return the angular velocity u of the moment in a row of C with those of the surfaces at its point c."""
    if surfaces is None:
        return u
    C[row, MOVES + 4], C[row, MOVES + 5] = C[c, MOVES + 4], C[c, MOVES + 5]
    return (u[0] + (C[c, MOVES + 4] - C[c, MOVES + 5]), u[1], u[2])


@inline
def _clear_moments(turning, pool, c, count):
    """Set the moments of points to none."""
    if turning is not None:
        _clear(noting(pool.C), pool.C, len(pool.old) + c, count)


@inline
def _finish_moment(turning, surfaces, pair, step, c, placed):
    """Fill the angular velocity, bristle and limits of the moment of the point c; return the count of what is placed.

    Of a moment Z is the bristle of rolling, XB that of spinning, and DEPTH the limit of spinning.
    """
    if turning is not None:
        pool, C, W, y, at = step.pool, step.pool.C, step.W, step.y, step.offsets.pair_turning + 4 * c
        row = len(pool.old) + c
        pool.pair[row], pool.placed[placed] = pool.pair[c], row
        placed += 1
        law, pair_frame = turning[pool.pair[c]], _frame_b(pair, W)
        for k in range(9):
            C[row, AXES + k] = C[c, AXES + k]
        n, t, s = load3(C, c, AXES), load3(C, c, AXES + 3), load3(C, c, AXES + 6)
        w = sub(load3(W, pair.body_a, V), _turning_of_b(pair, W))
        u = _spun(surfaces, (dot(n, w), dot(t, w), dot(s, w)), c, row, C)
        store3(C, row, U0, u)
        store3(C, row, UK, u)
        zero, on = 0.0 * C[c, ON], C[c, ON] > 0.0
        C[row, ON] = C[c, ON]
        z = _in_plane((y[at], y[at + 1], y[at + 2]), pair_frame, t, s, on)
        C[row, Z], C[row, Z + 1] = _with_surface_of_b(surfaces, z, row, step.h_implicit, C)
        C[row, XB] = select(on, y[at + 3], zero)
        predicted_force, _ = normal_force(pair, C[c, DEPTH], C[c, U0], step.h_implicit)
        last = y[step.offsets.pair_normal_force + c]
        load = select(on, select(last > 0.0, last, predicted_force), zero)
        C[row, LIMIT], C[row, DEPTH] = law.rolling * load, law.torsional * load
    return placed


@inline
def _turning_of_b(pair, W):
    """Return the angular velocity of body b [rad/s]."""
    if pair.tree_b < 0:
        zero = 0.0 * W[0, R]
        return (zero, zero, zero)
    return load3(W, pair.body_b, V)


@inline
def _in_plane(m, frame, t, s, on):
    """Return a bristle m, kept in the frame of body b, turned into the tangent plane with its length."""
    z = rotate(frame, m)
    size, z1, z2 = sqrt(dot(z, z)), dot(t, z), dot(s, z)
    zero, flat_size = 0.0 * size, sqrt(z1 * z1 + z2 * z2)
    turns, most = STRETCH * flat_size > size, select(size > 0.0, STRETCH + zero, 1.0 + zero)  # none keeps its slope
    ratio = select(turns, size / select(turns, flat_size, 1.0 + zero), most)
    return select(on, z1 * ratio, zero), select(on, z2 * ratio, zero)


@inline
def is_moment(turning, pool, c):
    """Return whether c is not a point but the moment of one."""
    if turning is None:
        return False
    return c >= len(pool.old)


@inline
def _deflection(y, o, c):
    at = o.pair_deflection + 3 * c
    return (y[at], y[at + 1], y[at + 2])


@inline
def bristle(C, c):
    """Return the bristle along the tangents [m]."""
    return C[c, Z], C[c, Z + 1]


@inline
def is_near(pool, c):
    """Return whether the point c may touch within the step, in any lane."""
    return any_lane(pool.C[c, ON] > 0.0)


# ---------------------------------------------------------------------------------------------- in the implicit step


@inline
def moment(law, u, c, h, C):
    """Return the moment (3) of the law at the angular velocity u, in its axes [N m], and its slopes (4) [N m s].

    Also whether it spins and rolls at the limits.
    """
    stiffness, zero, limit = h * law.tangential_stiffness + law.tangential_damping, 0.0 * u[0], C[c, DEPTH]
    m = -law.tangential_stiffness * C[c, XB] - stiffness * u[0]
    spins = abs(m) > limit
    m = select(spins, select(m > 0.0, limit, -limit), m)
    cn = select(spins | (limit <= 0.0), zero, stiffness + zero)
    f, slope, rolls = friction_force(law, bristle(C, c), u, C[c, LIMIT], h)
    some = C[c, LIMIT] > 0.0
    slope = (select(some, slope[0], zero), select(some, slope[1], zero), select(some, slope[2], zero))
    return (m, f[0], f[1]), (cn, slope[0], slope[1], slope[2]), spins, rolls


@inline
def linearize_pair(turning, pair, step, c):
    """Fill force, slopes and their factor of the point or moment c, zero in lanes where it is far."""
    C, h = step.pool.C, step.h_implicit
    if turning is None:
        linearize_point(None, pair, bristle(C, c), c, h, C)
    else:
        if is_moment(turning, step.pool, c):
            m, slopes, _, _ = moment(turning[step.pool.pair[c]], load3(C, c, UK), c, h, C)
            store3(C, c, FK, m)
            for k in range(4):
                C[c, CN + k] = slopes[k]
        else:
            linearize_point(None, pair, bristle(C, c), c, h, C)
    on = C[c, ON] > 0.0
    zero = 0.0 * C[c, ON]
    for k in range(3):
        C[c, FK + k] = select(on, C[c, FK + k], zero)
    for k in range(4):
        C[c, CN + k] = select(on, C[c, CN + k], zero)
    c11, c12, c22 = h * C[c, C1], h * C[c, C1 + 1], h * C[c, C1 + 2]
    one = 1.0 + zero
    w11 = sqrt(c11)
    w21 = select(c11 > 0.0, c12 / select(c11 > 0.0, w11, one), zero)
    rest = c22 - w21 * w21
    C[c, FACTOR] = sqrt(h * C[c, CN])
    C[c, FACTOR + 1] = w11
    C[c, FACTOR + 2] = w21
    C[c, FACTOR + 3] = sqrt(select(rest > 0.0, rest, zero))


@inline
def clear_own_row(pair, W):
    """Clear the contact row of body a where no contact point on the ground does."""
    if pair.own_a > 0:
        for k in range(TOUCH + 1):
            W[pair.row_a, k] = 0.0


@inline
def fold_pair(turning, pair, step, c):
    """Sum h J' C J and the force of a point, or a moment, on a body that cannot move into the row of body a."""
    C, W = step.pool.C, step.W
    axes = load3(C, c, AXES), load3(C, c, AXES + 3), load3(C, c, AXES + 6)
    if is_moment(turning, step.pool, c):
        fold_moment(c, pair.row_a, C[c, ON] > 0.0, axes, step.h_implicit, W, C)
    else:
        fold_point(c, pair.row_a, C[c, ON] > 0.0, axes, step.h_implicit, W, C)


@inline
def solve_pair(turning, pair, step, c):
    """Fill velocity and the linear model's force of the point or moment c at the solution's dA."""
    C = step.pool.C
    axes = load3(C, c, AXES), load3(C, c, AXES + 3), load3(C, c, AXES + 6)
    solve_point(axes, _change_of(turning, pair, step, c), c, step.h_implicit, C)


@inline
def _change_of(turning, pair, step, c):
    """Return what dA adds to the relative acceleration of the point c, of a moment to the angular one."""
    W, C = step.W, step.pool.C
    if is_moment(turning, step.pool, c):
        turn = load3(W, pair.body_a, U)
        if pair.folded == 0:
            turn = sub(turn, load3(W, pair.body_b, U))
        return turn
    a = add(load3(W, pair.body_a, U + 3), cross(load3(W, pair.body_a, U), load3(C, c, XP)))
    if pair.folded == 0:
        xb = load3(C, c, XB)
        a = sub(a, add(load3(W, pair.body_b, U + 3), cross(load3(W, pair.body_b, U), xb)))
    return a


@element.load.of(Pairs)
def _load(pairs, c, which, step):
    return load3(step.pool.C, c, UK + 3 * which)


@element.keep.of(Pairs)
def _keep(pairs, c, which, x, step):
    store3(step.pool.C, c, UK + 3 * which, x)


@element.force_at.of(Pairs)
def _force_at(pairs, c, u, step):
    return _point_or_moment(pairs.turning, pairs.pairs[step.pool.pair[c]], c, u, step)


@inline
def _point_or_moment(turning, pair, c, u, step):
    C, h = step.pool.C, step.h_implicit
    if turning is not None:
        if is_moment(turning, step.pool, c):
            m, _, _, _ = moment(turning[step.pool.pair[c]], u, c, h, C)
            return m
    return point_force(None, pair, bristle(C, c), u, c, h, C)


@if_present()
def move_pairs(pairs, step):
    """Move bristles and forces of all pairs, and their work, to the end of the step."""
    for i in range(step.pool.count[0]):
        c = step.pool.placed[i]
        pair = pairs.pairs[step.pool.pair[c]]
        if is_moment(pairs.turning, step.pool, c):
            _move_moment(pairs.turning, pairs.surfaces, pair, step, c)
        else:
            _move_point(pairs.surfaces, pair, step, c)


@inline
def _move_point(surfaces, pair, step, c):
    """Move the bristle of the point c, its force and its work."""
    y, o, C, h = step.y, step.offsets, step.pool.C, step.h_implicit
    u, z = load3(C, c, UN), bristle(C, c)
    f = point_force(None, pair, z, u, c, h, C)
    on, zero = C[c, ON] > 0.0, 0.0 * C[c, ON]
    drives = _drives_power(surfaces, pair, f, c, step.h, step, y)
    y[o.pair_work] += step.h * (select(on, dot(f, u), zero) + drives)
    _, _, slips = friction_force(pair, z, u, C[c, LIMIT], h)
    m = _moved(surfaces, pair, pair, slips, (f[1], f[2]), step, c)
    for k in range(3):
        y[o.pair_deflection + 3 * c + k] = select(on, m[k], zero)
    _record(pair, step, c, f)


@inline
def _moved(surfaces, law, pair, slips, f, step, c):
    """Return the bristle of the point or moment c at the end of the step, in the frame of body b; f: its force (2)."""
    C, h, z = step.pool.C, step.h_implicit, bristle(step.pool.C, c)
    kt, dt = law.tangential_stiffness, law.tangential_damping
    kappa = 1.0 / (h * kt + dt)
    m1 = select(slips, (dt * z[0] - h * f[0]) * kappa, z[0] + h * C[c, UN + 1])
    m2 = select(slips, (dt * z[1] - h * f[1]) * kappa, z[1] + h * C[c, UN + 2])
    z = _before_turning(surfaces, z, c, h, C)
    m1, m2 = z[0] + (m1 - z[0]) * (1.0 / step.theta), z[1] + (m2 - z[1]) * (1.0 / step.theta)
    t, s = load3(C, c, AXES + 3), load3(C, c, AXES + 6)
    return rotate_back(_frame_b(pair, step.W), add(scale(t, m1), scale(s, m2)))


@inline
def _move_moment(turning, surfaces, pair, step, c):
    """Move the bristles of the moment c, and its work."""
    if turning is not None:
        y, C, h, law = step.y, step.pool.C, step.h_implicit, turning[step.pool.pair[c]]
        at, u = step.offsets.pair_turning + 4 * (c - len(step.pool.old)), load3(C, c, UN)
        m, _, spins, rolls = moment(law, u, c, h, C)
        on, zero, x = C[c, ON] > 0.0, 0.0 * C[c, ON], C[c, XB]
        drives = _spinning_power(surfaces, pair, m[0], c, step.h, step, y)
        y[step.offsets.pair_work] += step.h * (select(on, dot(m, u), zero) + drives)
        z = _moved(surfaces, law, pair, rolls, (m[1], m[2]), step, c)
        for k in range(3):
            y[at + k] = select(on, z[k], zero)
        kt, dt = law.tangential_stiffness, law.tangential_damping
        moved = select(spins, (dt * x - h * m[0]) * (1.0 / (h * kt + dt)), x + h * u[0])
        y[at + 3] = select(on, x + (moved - x) * (1.0 / step.theta), zero)


@inline
def _record(pair, step, c, f):
    """Write force, normal force, gap and place of the point c into the state; f in its axes [N]."""
    y, o, C = step.y, step.offsets, step.pool.C
    n, t, s = load3(C, c, AXES), load3(C, c, AXES + 3), load3(C, c, AXES + 6)
    world = add(scale(n, f[0]), add(scale(t, f[1]), scale(s, f[2])))
    at, found, zero = o.base_q + 7 * pair.tree_a, C[c, GAP] < FAR, 0.0 * C[c, ON]
    for k in range(3):
        y[o.pair_force + 3 * c + k] = select(found, world[k], zero)
        y[o.pair_position + 3 * c + k] = select(found, C[c, XP + k] + y[at + k], zero)
    y[o.pair_normal_force + c] = select(found, f[0], zero)
    y[o.pair_gap + c] = C[c, GAP]


# ---------------------------------------------------------------------------------------------- as an equation


@apart
def pair_rates(pairs, step, dy):
    """Fill forces and rates of the bristles of all pairs, and add the forces to the contact rows of the bodies."""
    y, o, pool, C, W = step.y, step.offsets, step.pool, step.pool.C, step.W
    for k in range(len(pairs.own_rows)):
        for j in range(TOUCH + 1):
            W[pairs.own_rows[k], j] = 0.0
    dy[o.pair_work] = 0.0 * y[o.pair_work]
    place_pairs(pairs, None, step, 0.0)
    pool.count[3] = max(pool.count[2], pool.count[3])
    for c in range(3 * pool.count[3]):  # rates of before
        dy[o.pair_deflection + c] = 0.0 * y[o.pair_deflection + c]
    _still_moments(pairs.turning, step, dy)
    for i in range(pool.count[0]):
        c = pool.placed[i]
        if is_moment(pairs.turning, pool, c):
            continue
        pair, u, z = pairs.pairs[pool.pair[c]], load3(C, c, U0), bristle(C, c)
        fn, _ = normal_force(pair, C[c, DEPTH], u[0], 0.0)
        f, _, slips = friction_force(pair, z, u, pair.friction * fn, 0.0)
        kt, dt, on = pair.tangential_stiffness, pair.tangential_damping, fn > 0.0
        m1 = select(slips, -(f[0] + kt * z[0]) / dt, u[1])  # what slips keeps -kt z - dt dz/dt at the force
        m2 = select(slips, -(f[1] + kt * z[1]) / dt, u[2])
        zero = 0.0 * fn
        m1, m2 = _turning_rate(pairs.surfaces, z, m1, m2, c, C)
        C[c, FK + 1], C[c, FK + 2] = m1, m2
        m = _turned_rate(rotate(_frame_b(pair, W), _deflection(y, o, c)), z, m1, m2, c, C)
        m = rotate_back(_frame_b(pair, W), m)
        for k in range(3):  # what does not push lets its bristle go
            dy[o.pair_deflection + 3 * c + k] = select(C[c, ON] > 0.0, m[k], zero)
        f = (select(on, fn, zero), select(on, f[0], zero), select(on, f[1], zero))
        dy[o.pair_work] += dot(f, u) + _drives_power(pairs.surfaces, pair, f, c, 1.0, step, dy)
        _record(pair, step, c, f)
        force = (y[o.pair_force + 3 * c], y[o.pair_force + 3 * c + 1], y[o.pair_force + 3 * c + 2])
        if any_lane(on):
            _press(pair.row_a, on, load3(C, c, XP), force, W)
            if pair.row_b > 0:
                _press(pair.row_b, on, load3(C, c, XB), scale(force, -1.0), W)
        _moment_rates(pairs.turning, pairs.surfaces, pair, step, dy, c, fn)


@inline
def _still_moments(turning, step, dy):
    """Clear the rates of the bristles of moments."""
    if turning is not None:
        for c in range(4 * step.pool.count[3]):
            dy[step.offsets.pair_turning + c] = 0.0 * step.y[step.offsets.pair_turning + c]


@inline
def _moment_rates(turning, surfaces, pair, step, dy, point, fn):
    """Fill the rates of the bristles of the moment of a point, its power, and add it to the rows of the bodies."""
    if turning is not None:
        y, C, W, law = step.y, step.pool.C, step.W, turning[step.pool.pair[point]]
        c, at = len(step.pool.old) + point, step.offsets.pair_turning + 4 * point
        C[c, LIMIT], C[c, DEPTH] = law.rolling * fn, law.torsional * fn
        u, z, x = load3(C, c, U0), bristle(C, c), C[c, XB]
        m, _, spins, rolls = moment(law, u, c, 0.0, C)
        kt, dt, zero, near = law.tangential_stiffness, law.tangential_damping, 0.0 * fn, C[c, ON] > 0.0
        m1 = select(rolls, -(m[1] + kt * z[0]) / dt, u[1])
        m2 = select(rolls, -(m[2] + kt * z[1]) / dt, u[2])
        m1, m2 = _turning_rate(surfaces, z, m1, m2, c, C)
        C[c, FK + 1], C[c, FK + 2] = m1, m2
        kept = (y[at], y[at + 1], y[at + 2])
        rate = rotate_back(_frame_b(pair, W), _turned_rate(rotate(_frame_b(pair, W), kept), z, m1, m2, c, C))
        for k in range(3):
            dy[at + k] = select(near, rate[k], zero)
        dy[at + 3] = select(near, select(spins, -(m[0] + kt * x) / dt, u[0]), zero)
        on = fn > 0.0
        drives = _spinning_power(surfaces, pair, select(on, m[0], zero), c, 1.0, step, dy)
        dy[step.offsets.pair_work] += select(on, dot(m, u), zero) + drives
        n, t, s = load3(C, c, AXES), load3(C, c, AXES + 3), load3(C, c, AXES + 6)
        world = add(scale(n, m[0]), add(scale(t, m[1]), scale(s, m[2])))
        if any_lane(on):
            _turn(pair.row_a, on, world, W)
            if pair.row_b > 0:
                _turn(pair.row_b, on, scale(world, -1.0), W)


@inline
def _turn(k, on, m, W):
    """Add a moment to a contact row, in the lanes where it acts."""
    for j in range(3):
        W[k, SF + j] = select(on, W[k, SF + j] + m[j], W[k, SF + j])


@inline
def _turned_rate(m, z, m1, m2, c, C):
    """Return dm/dt of a bristle m (3) that has left the tangent plane, in which z (2) of its length changes by m1, m2.

    Along m as z along itself, and across as much less as m is longer than its part in the plane.
    """
    t, s = load3(C, c, AXES + 3), load3(C, c, AXES + 6)
    size, part = sqrt(z[0] * z[0] + z[1] * z[1]), sqrt(dot(t, m) * dot(t, m) + dot(s, m) * dot(s, m))
    long, one = size > LEAST, 1.0 + 0.0 * size
    by = select(long, size, one)
    along = select(long, (z[0] * m1 + z[1] * m2) / by, 0.0 * size)
    less = select(long, part / by, one)
    across = (less * (m1 - along * (z[0] / by)), less * (m2 - along * (z[1] / by)))
    return add(scale(m, along / by), add(scale(t, across[0]), scale(s, across[1])))


@if_present()
def flatten_bristles(pairs, scratch, offsets, y, dy):
    """Turn bristles and their rates into the tangent planes, at the state whose rates have just been found.

    Between steps the planes turn in the bodies; a bristle far out of its plane would be turned the other way.  What a
    point has left behind in its slot goes: within a step the next one there would begin with it.
    """
    pool = scratch.pool
    for i in range(pool.count[0]):
        c = pool.placed[i]
        pair, at, feature = pairs.pairs[pool.pair[c]], offsets.pair_deflection + 3 * c, offsets.pair_feature + c
        if is_moment(pairs.turning, pool, c):
            feature = feature - len(pool.old)
            at = offsets.pair_turning + 4 * (c - len(pool.old))
        _flatten(pair, scratch, at, c, (y, dy), y[feature] == 0.0)
        if is_moment(pairs.turning, pool, c):
            y[at + 3] = select(y[feature] == 0.0, 0.0 * y[at + 3], y[at + 3])


@inline
def _flatten(pair, scratch, at, c, both, gone):
    """Turn a bristle, three numbers of the state from `at` on, and its rate; gone: whether its point has left."""
    C, (y, dy) = scratch.pool.C, both
    on, z = C[c, ON] > 0.0, bristle(C, c)
    t, s, frame = load3(C, c, AXES + 3), load3(C, c, AXES + 6), _frame_b(pair, scratch.W)
    m = rotate_back(frame, add(scale(t, z[0]), scale(s, z[1])))
    rate = rotate_back(frame, add(scale(t, C[c, FK + 1]), scale(s, C[c, FK + 2])))
    for k in range(3):
        y[at + k] = select(on, m[k], select(gone, 0.0 * m[k], y[at + k]))
        dy[at + k] = select(on, rate[k], dy[at + k])


@inline
def _press(k, on, x, f, W):
    """Add a force at x to a contact row, in the lanes where it acts."""
    m = cross(x, f)
    for j in range(3):
        W[k, SF + j] = select(on, W[k, SF + j] + m[j], W[k, SF + j])
        W[k, SF + 3 + j] = select(on, W[k, SF + 3 + j] + f[j], W[k, SF + 3 + j])
    W[k, TOUCH] = select(on, 1.0, W[k, TOUCH])


@inline
def pair_branch(turning, pair, step, c):
    """Return whether the point c pushes: 0 no, 1 it sticks, 2 it slips; of a moment those of both."""
    C, u = step.pool.C, load3(step.pool.C, c, UN)
    if turning is not None:
        if is_moment(turning, step.pool, c):
            _, _, spins, rolls = moment(turning[step.pool.pair[c]], u, c, step.h_implicit, C)
            no = 0.0 * u[0]
            return select(spins, 1.0 + no, no) + select(rolls, 2.0 + no, no)
    fn, _ = normal_force(pair, C[c, DEPTH], u[0], step.h_implicit)
    _, _, slips = friction_force(pair, bristle(C, c), u, C[c, LIMIT], step.h_implicit)
    one = 1.0 + 0.0 * fn
    return select(fn > 0.0, select(slips, 2.0 * one, one), 0.0 * fn)


# ---------------------------------------------------------------------------------------------- copies of the state


@inline
def slots_in_use(o, y, slots):
    """Return how many of the slots have a pair, in any lane."""
    used = 0
    while used < slots and any_lane(y[o.pair + used] > 0.0):
        used += 1
    return used


@inline
def copy_where(mask, pairs, o, source, y):
    """Copy the state where the mask holds; slots that neither of both uses are left out."""
    at = 0
    if pairs is not None:
        slots = pairs.slots[0]
        used = max(slots_in_use(o, source, slots), slots_in_use(o, y, slots))
        for start, width in (
            (o.pair_deflection, 3), (o.pair, 1), (o.pair_feature, 1), (o.pair_force, 3), (o.pair_normal_force, 1),
            (o.pair_gap, 1), (o.pair_position, 3),
        ):  # fmt: skip
            _copy(mask, at, start + width * used, source, y)
            at = start + width * slots
    _copy(mask, at, len(y), source, y)


@inline
def _copy(mask, first, end, source, y):
    if mask is None:
        for i in range(first, end):
            y[i] = source[i]
    else:
        for i in range(first, end):
            y[i] = select(mask, source[i], y[i])
