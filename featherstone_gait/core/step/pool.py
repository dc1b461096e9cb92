"""The pool: which pairs are near, and the slots of the state in which their points keep bristles and forces.

Pairs whose bounding spheres are closer than a radius have a block of slots, in the order of the table; for all others
nothing is done in a step.  How far apart the nearest of these others is makes a budget: the way that bodies may move
until the pool is renewed.  A bound of the speeds of all shapes spends it, so that most steps look at no pair that is
far.  What a pair's slots hold moves with it; which pairs are in the pool beyond those that touch changes no bit.

In lanes the pool holds the pairs that are near in any of them.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import inline, kernel
from ..compile.lanes import any_lane, flat, select, sqrt, width_of
from ..compile.optional import if_present
from ..compile.structure import structure
from ..effects.pair import FAR, SUDDEN, load9_of
from ..tree.forest import base_of, joints_of
from ..tree.kinematics import pose_pass
from ..tree.layout import R
from ..tree.rigid_body import point_position
from ..tree.separation import gap_at_least
from ..tree.spatial import add, compose, load9, sub, vector

SPENDING = 8.0  # times what a step may spend: the radius of the pool
LONGEST = 2e-2  # [s] for which a pool is renewed; steps with error control may be longer where nothing is near
SHORTEST = 1e-6  # step [s] that is tried before a pool is said to be too small
SEEN = 4.0  # times the resting depth
KEPT = 10  # numbers of a slot that move with its pair: pair, feature, bristle, normal force, bristles of the moment


@structure
class Renewal(NamedTuple):
    """Scratch arrays."""

    frames: np.ndarray  # poses, in the rows of the tree's workspace
    kept: np.ndarray  # (slots, KEPT)


@if_present(True)
def renew_pool(pairs, run, y, h, begins):
    """Renew the pool if the budget does not reach for a step h [s], or if a run begins; return whether all fits in."""
    o = run.offsets[0]
    fits, cost = True, spending(run, y, h)
    if begins or any_lane(y[o.pair_budget] < 2.0 * cost):
        _keep(pairs, run, y)
        fits = _renew_for(pairs, run, y, h)
    y[o.pair_budget] = y[o.pair_budget] - cost
    return fits


@if_present(1e300)
def longest_step(pairs, run, y, h, ahead):
    """Return how long a step may be [s], at most h, for which the budget reaches; the pool is renewed if need be.

    Returns -1 where the pool has not enough slots for any step.  ahead None: the method sees no contact before it is
    there, so that while any pair is near no shape may move by more than some depths at which a contact rests.
    """
    o = run.offsets[0]
    if y[o.pair_budget] < 2.0 * spending(run, y, h):
        _keep(pairs, run, y)
        while not _renew_for(pairs, run, y, h):
            h = 0.5 * h
            if h < SHORTEST:
                return -1.0
    while y[o.pair_budget] < 2.0 * spending(run, y, h):
        h = 0.5 * h
    return _before_contact(ahead, pairs, run, y, h)


@inline
def _before_contact(ahead, pairs, run, y, h):
    if ahead is None:
        if y[run.offsets[0].pair] > 0.0:
            way = spending(run, y, h)
            share = SEEN * pairs.margin / max(way, 1e-300)
            if run.plan.second_run:  # else both would take the same steps, and their difference be none
                share = 0.5 * share
            return min(h, h * max(share, 1e-6))
    return h


@if_present()
def spend(pairs, run, y, h):
    """Take from the budget what the step h [s] may have moved."""
    o = run.offsets[0]
    y[o.pair_budget] = y[o.pair_budget] - spending(run, y, h)


@kernel
def spending(run, y, h):
    """Return a bound of how much closer two shapes come in a step h [s], and as much again for changes of speed [m]."""
    scene, o = run.scene, run.offsets[0]
    trees, pairs = scene.trees, scene.pairs
    most = 0.0 * y[o.pair_budget]
    for k in range(len(trees)):
        part = trees[k]
        v = base_of(True, part, y, o.base_qd, 6)
        speed = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        speed = speed + pairs.radius[k] * sqrt(v[3] * v[3] + v[4] * v[4] + v[5] * v[5])
        first, end = joints_of(part, scene.tree)
        for i in range(first, end):
            speed = speed + pairs.reach[i] * abs(y[o.qd + i])
        most = select(speed > most, speed, most)
    return 4.0 * h * most + SUDDEN * (h * h)


@inline
def _renew_for(pairs, run, y, h):
    """Renew the pool for steps of h [s]: widely, or if that needs more slots than there are, for one step alone."""
    way = spending(run, y, min(h, LONGEST))
    return _renew(pairs, run, y, SPENDING * way) or _renew(pairs, run, y, 3.0 * way)


@kernel
def _keep(pairs, run, y):
    """Find all poses, and copy what the slots hold."""
    scene, o, kept = run.scene, run.offsets[0], run.renewal.kept
    n = scene.trees[len(scene.trees) - 1].end_joint
    for k in range(len(scene.trees)):
        base = base_of(True, scene.trees[k], y, o.base_q, 7)
        pose_pass(scene.tree, scene.trees[k], base, y[o.q : o.q + n], run.renewal.frames)
    for c in range(len(kept)):
        kept[c, 0], kept[c, 1] = y[o.pair + c], y[o.pair_feature + c]
        for k in range(3):
            kept[c, 2 + k] = y[o.pair_deflection + 3 * c + k]
        kept[c, 5] = y[o.pair_normal_force + c]
        _keep_moment(pairs.turning, kept, c, o, y)


@kernel
def _renew(pairs, run, y, radius):
    """Give the pairs within the radius [m] their slots, and set the budget; return whether there are enough."""
    o, width = run.offsets[0], width_of(y)
    frames, kept = run.renewal.frames, run.renewal.kept
    slots, used, fits = len(kept), 0, True
    for c in range(slots):
        _clear_moment(pairs.turning, c, o, y)
        y[o.pair + c] = 0.0
        y[o.pair_feature + c] = 0.0
        y[o.pair_normal_force + c] = 0.0
        y[o.pair_gap + c] = 0.0
        for k in range(3):
            y[o.pair_deflection + 3 * c + k] = 0.0
            y[o.pair_force + 3 * c + k] = 0.0
            y[o.pair_position + 3 * c + k] = 0.0
    budget = FAR + 0.0 * y[o.pair_budget]
    for k in range(len(pairs.pairs)):
        pair = pairs.pairs[k]
        gap = _least_gap(pairs, pair, o, y, frames, radius + pairs.margin) - pairs.margin
        if any_lane(gap < radius):
            if used + pair.slots > slots:
                fits = False
                budget = select(gap < budget, gap, budget)
            else:
                _take_over(pairs.turning, k, pair.slots, used, kept, o, y, width)
                used += pair.slots
        else:
            budget = select(gap < budget, gap, budget)
    y[o.pair_budget] = budget
    return fits


@inline
def _keep_moment(turning, kept, c, o, y):
    """Copy the bristles of the moment of a slot."""
    if turning is not None:
        for k in range(4):
            kept[c, 6 + k] = y[o.pair_turning + 4 * c + k]


@inline
def _clear_moment(turning, c, o, y):
    """Clear the bristles of the moment of a slot."""
    if turning is not None:
        for k in range(4):
            y[o.pair_turning + 4 * c + k] = 0.0


@inline
def _least_gap(pairs, pair, o, y, W, enough):
    """Return a lower bound of the gap of a pair [m]; one that is not below `enough` may be any other that is not."""
    a, b = pairs.shapes.table[pair.a], pairs.shapes.table[pair.b]
    Ea, ra = _pose(a, pair.tree_a, pair.body_a, o, y, W)
    Eb, rb = _pose(b, pair.tree_b, pair.body_b, o, y, W)
    return gap_at_least(a, b, Ea, Eb, sub(ra, rb), enough)


@inline
def _pose(shape, tree, body, o, y, W):
    """Return rotation and center of a shape in the world."""
    E, zero = load9_of(shape.E), 0.0 * W[0, R]
    if tree < 0:
        return (
            (E[0] + zero, E[1] + zero, E[2] + zero, E[3] + zero, E[4] + zero, E[5] + zero, E[6] + zero, E[7] + zero,
             E[8] + zero), (shape.r[0] + zero, shape.r[1] + zero, shape.r[2] + zero),
        )  # fmt: skip
    at = o.base_q + 7 * tree
    return compose(load9(W, body, R), E), add(point_position(body, vector(shape.r), W), (y[at], y[at + 1], y[at + 2]))


@inline
def _take_over(turning, k, count, used, kept, o, y, width):
    """Move what the slots of a pair held, in each lane, to those that it has now."""
    old, new = flat(kept), flat(y)
    for j in range(count):
        y[o.pair + used + j] = k + 1.0
    for lane in range(width):
        for c in range(len(kept)):
            if old[c * KEPT * width + lane] == k + 1.0:
                for j in range(count):
                    at = (c + j) * KEPT * width + lane
                    new[(o.pair_feature + used + j) * width + lane] = old[at + width]
                    for i in range(3):
                        new[(o.pair_deflection + 3 * (used + j) + i) * width + lane] = old[at + (2 + i) * width]
                    new[(o.pair_normal_force + used + j) * width + lane] = old[at + 5 * width]
                    if turning is not None:
                        for i in range(4):
                            new[(o.pair_turning + 4 * (used + j) + i) * width + lane] = old[at + (6 + i) * width]
                break
