"""The columns of an extrapolation, which run side by side in lanes.

Column k and column K - k take together as many steps as column K, so that K columns fill K/2 + 1 lanes without a gap,
and K columns cost the time of the longest: order pays more than it does one column at a time.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import apart, inline, kernel
from ..compile.lanes import WIDTH, select
from ..compile.optional import in_lanes
from ..compile.structure import structure
from ..effects.actuator import controller_of, motor_of
from ..effects.decay import set_decay
from ..step.advance import advance_trees, solve_trees
from ..step.branch import note_branches, note_branches_at_start
from ..step.context import NEWTON_TOLERANCE, Step
from ..step.derivative import derivative
from ..step.pace import EVALUATIONS, SINCE, UNTIL, scaled
from ..step.signals import evaluate
from ..tree.forest import base_count, joint_count

INSTANT = 1e-3  # of the interval: after its start
LOCATED = 4.0  # least steps: a discontinuity is located no more precisely
LEFT, DONE, COLUMN = 0, 1, 2  # rows of `lanes`: steps to go, steps done, column
# What is known of a discontinuity: the share of the interval before it, negative if there is none; the step that would
# end behind it after one to there [s]; the error of two columns.
BEFORE, BEHIND, ROUGH = 0, 1, 2


@structure
class Columns(NamedTuple):
    """Columns that run side by side: arrays with a last axis of lanes, which kernels also see as such."""

    y: np.ndarray  # (length of the state,)
    h: np.ndarray  # (1,): steps [s]
    last: np.ndarray  # (1,): 1 where the step is the last of its column
    slope: np.ndarray  # (what is integrated,)
    first: np.ndarray  # (what is integrated,): slope at the start
    previous: np.ndarray  # (what is integrated,)
    drive: np.ndarray  # (n, 2)
    tau: np.ndarray | None  # (n,) [N m]
    decay: np.ndarray | None  # (n, DECAYS): what each lane's step leaves
    branch: np.ndarray  # (branches,): of the forces of each lane's last step
    elsewhere: np.ndarray  # (1,): 1 where any of them is another than an instant after the interval's start
    moved: np.ndarray  # (what is integrated,): changes since the start, of the implicit step those of coordinates
    W: np.ndarray
    Z: np.ndarray
    C: np.ndarray
    F: np.ndarray
    N: np.ndarray
    pool: tuple | None
    rows: tuple | None
    closing: tuple | None


@inline
def steps_of(implicit, j):
    """Return the number of steps of column j = 0, 1, ..."""
    if implicit is None:
        return 2 * (j + 1)
    return j + 1


@inline
def extrapolated(implicit, run):
    """Return how much of the state is extrapolated: what is integrated and, of the implicit step, derived."""
    if implicit is None:
        return run.plan.integrated
    return run.offsets[0].after_derived


@inline
def summed_apart(implicit, run):
    """Return how much of the state has its changes summed apart."""
    if implicit is None:
        return run.plan.integrated
    return run.offsets[0].after_coordinates


@inline
def sweep(implicit, run, t, h, count):
    """Cross the interval in `count` columns, which fill the rows of the table.

    Lane l takes the column l from the last one, then column l - 1, if there is one: together they are as long as the
    last.  Of the lanes left over the last measures what the interval's start hides from the columns: see `_skipped`.
    Returns that error by the tolerance, and 1e60 if Newton's iteration failed.
    """
    half, sound, ladder, pace = count // 2, True, run.work, run.work.pace
    columns = in_lanes(ladder.columns)
    for lane in range(WIDTH):
        _begin(implicit, run, lane, count - 1 - (lane if lane <= half else 0), h)
    if implicit is not None:
        ladder.columns.h[0, WIDTH - 1] = h * INSTANT
    set_decays(columns.decay, run.scene.actuator, columns)
    total = steps_of(implicit, count - 1)
    ladder.discontinuity[BEFORE] = -1.0
    for k in range(total):
        for lane in range(WIDTH):
            ahead = (ladder.lanes[DONE, lane] + 1) * ladder.columns.h[0, lane]  # the first evaluation lies a step ahead
            lane_inputs(run, lane, min(t + ahead, pace[UNTIL]), False)
        if implicit is None:
            _midpoint(run, columns)
        else:
            euler_in_lanes(None, run, columns)
        _look_for_discontinuity(implicit, ladder, columns, k, total, half)
        if implicit is not None and k == 0:
            skipped = _skipped(run, min(half, 3), h)
            if skipped > 1.0:
                return skipped
        fresh = False
        for lane in range(half + 1):
            ladder.lanes[LEFT, lane] -= 1
            ladder.lanes[DONE, lane] += 1
            if ladder.lanes[LEFT, lane] == 0:
                sound = sound & _harvest(implicit, run, lane)
                pace[EVALUATIONS] += ladder.lanes[DONE, lane]
                if k < total - 1:
                    _begin(implicit, run, lane, max(lane - 1, 0), h)
                    fresh = True
            if implicit is None:
                ladder.columns.last[0, lane] = 1.0 if ladder.lanes[LEFT, lane] == 1 else 0.0
        if implicit is None:
            for lane in range(half + 1, WIDTH):
                ladder.columns.last[0, lane] = ladder.columns.last[0, 0]
        if fresh:
            set_decays(columns.decay, run.scene.actuator, columns)
    return 0.0 if sound else 1e60


@inline
def _look_for_discontinuity(implicit, ladder, columns, k, total, half):
    """Note after the k-th steps whether a lane is on other branches than an instant after the interval's start.

    The longest column, of `total` steps, shows where; if only others have seen it, the end is as good a guess.
    """
    if implicit is not None:
        elsewhere, discontinuity = ladder.columns.elsewhere[0], ladder.discontinuity
        if k == 0:
            for r in range(len(ladder.branch)):
                ladder.branch[r] = ladder.columns.branch[r, WIDTH - 1]
        compare_branches(ladder, columns)
        if elsewhere[0] > 0.0 and not 0.0 <= discontinuity[BEFORE] < 1.0:
            discontinuity[BEFORE] = k / total
        for lane in range(1, half + 1):
            if elsewhere[lane] > 0.0 and discontinuity[BEFORE] < 0.0:
                discontinuity[BEFORE] = 1.0


@inline
def compare_branches(ladder, columns):
    """Note which lanes are on other branches than an instant after the interval's start."""
    elsewhere, one = columns.h[0] < 0.0, 1.0 + 0.0 * columns.h[0]  # nowhere yet
    for r in range(len(ladder.branch)):
        elsewhere = elsewhere | (columns.branch[r] != ladder.branch[r])
    columns.elsewhere[0] = select(elsewhere, one, 0.0 * one)


@inline
def _skipped(run, last, h):
    """Return what the implicit step does not see of the interval's start, as an error of positions or speeds.

    It takes forces at the end of a step only.  A discontinuity within the first step of all columns is the same for all
    of them, as if it had been at the start, and the scheme does not show it.  But the accelerations of the columns'
    first steps, extrapolated to a step of length 0, then differ from those an instant after the start.  Where forces
    are on other branches there than in the shortest first step, they have acted too long by half of it on average.
    """
    offsets, worst = run.offsets[0], 0.0
    changes = run.work.discontinuity[BEFORE] == 0.0 and h > LOCATED * run.plan.least_step
    for i in range(joint_count(run.scene.trees, run.scene.tree)):
        a = _skipped_by(run, last, offsets.qdd + i)
        worst = max(worst, _scaled_at(run, a, offsets.q + i))
        if changes:
            worst = max(worst, _scaled_speed(run, a, offsets.qd + i))
    return _skipped_by_base(run.scene.floating, run, last, worst, changes)


@inline
def _skipped_by_base(floating, run, last, worst, changes):
    if floating is not None:
        offsets = run.offsets[0]
        for k in range(6 * base_count(run.scene.trees)):
            base, i = k // 6, k % 6
            a = _skipped_by(run, last, offsets.base_qdd + k)
            # the quaternion's vector is half the turn
            worst = max(worst, _scaled_at(run, a, offsets.base_q + 7 * base + i + i // 3))
            if changes:
                worst = max(worst, _scaled_speed(run, a, offsets.base_qd + k))
    return worst


@inline
def _skipped_by(run, last, acceleration):
    """Return the difference of the accelerations at this index of the state."""
    ladder, a = run.work, 0.0
    h, y = ladder.columns.h[0], ladder.columns.y
    for j in range(last + 1):
        weight = 1.0
        for k in range(last + 1):
            if k != j:
                weight *= h[k] / (h[k] - h[j])
        a += weight * y[acceleration, j]
    return y[acceleration, WIDTH - 1] - a


@inline
def _scaled_at(run, a, position):
    """Return the error of a position by an acceleration that differs by a, over the tolerance."""
    start, h = run.work.start, run.work.columns.h[0, 0]
    return scaled(run.plan, a * h * h / 6.0, start[position], start[position])


@inline
def _scaled_speed(run, a, speed):
    """Return the error of a speed by an acceleration that differs by a, over the tolerance."""
    start, h = run.work.start, run.work.columns.h[0, 0]
    return scaled(run.plan, 0.5 * a * h, start[speed], start[speed])


@inline
def _begin(implicit, run, lane, column, h):
    """Give a lane a column, and move it to the start."""
    start, lanes, columns, n = run.work.start, run.work.lanes, run.work.columns, steps_of(implicit, column)
    lanes[LEFT, lane], lanes[DONE, lane], lanes[COLUMN, lane] = n, 0, column
    columns.h[0, lane] = h / n
    for i in range(run.offsets[0].step_control):
        columns.y[i, lane] = start[i]
    if implicit is not None:
        for i in range(run.offsets[0].after_coordinates):
            columns.moved[i, lane] = 0.0
    else:
        columns.last[0, lane] = 0.0
        for i in range(run.plan.integrated):
            columns.previous[i, lane] = 0.0
            columns.moved[i, lane] = (h / n) * columns.first[i, lane]
            columns.y[i, lane] = start[i] + columns.moved[i, lane]


@inline
def _harvest(implicit, run, lane):
    """Put a lane's column into the table; return whether Newton's iteration converged in all of its steps."""
    ladder, offsets = run.work, run.offsets[0]
    column = ladder.lanes[COLUMN, lane]
    summed = summed_apart(implicit, run)
    for i in range(summed):
        ladder.table[column, i] = ladder.columns.moved[i, lane]
    for i in range(summed, extrapolated(implicit, run)):
        ladder.table[column, i] = ladder.columns.y[i, lane] - ladder.start[i]
    return not ladder.columns.y[offsets.newton_iterations + 1, lane] > ladder.start[offsets.newton_iterations + 1]


@kernel
def _midpoint(run, columns):
    """Step y_{k+1} = y_{k-1} + 2 h f(y_k); in the end Gragg's mean (y_{n-1} + 2 y_n + y_{n+1}) / 4."""
    moved, previous, slope, start = columns.moved, columns.previous, columns.slope, run.work.start
    _slope(run, columns, slope)
    h, last = columns.h[0], columns.last[0] > 0.0
    for i in range(run.plan.integrated):
        here, step = moved[i], h * slope[i]
        moved[i] = select(last, 0.5 * (here + (previous[i] + step)), previous[i] + 2.0 * step)
        previous[i] = here
        columns.y[i] = start[i] + moved[i]


@apart
def _slope(run, columns, slope):
    scene, x, offsets, t = run.scene, columns, run.offsets[0], run.work.pace[SINCE]
    at = Step(
        scene=scene, actuator=scene.actuator, decay=x.decay, offsets=offsets, y=x.y, tau=x.tau, drive=x.drive,
        predicted=None, t=t, span=0.0, h=0.0, h_implicit=0.0, theta=1.0, extrapolation_ratio=None,
        tolerance=NEWTON_TOLERANCE, W=x.W, Z=x.Z, C=x.C, F=x.F, N=x.N, pool=x.pool, part=None,
        rows=x.rows, closing=x.closing,
    )  # fmt: skip
    derivative(at, slope)


@apart
def euler_in_lanes(ended, run, columns):
    """Take a linearly implicit Euler step; once the interval has ended, find the branches on which one would start."""
    scene, x, offsets, t, h = run.scene, columns, run.offsets[0], run.work.pace[SINCE], columns.h[0]
    at = Step(
        scene=scene, actuator=scene.actuator, decay=x.decay, offsets=offsets, y=x.y, tau=x.tau, drive=x.drive,
        predicted=None, t=t, span=0.0, h=h, h_implicit=h, theta=1.0, extrapolation_ratio=None,
        tolerance=NEWTON_TOLERANCE, W=x.W, Z=x.Z, C=x.C, F=x.F, N=x.N, pool=x.pool, part=None,
        rows=x.rows, closing=x.closing,
    )  # fmt: skip
    if ended is None:
        solve_trees(scene.trees, scene.pairs, at)
        note_branches(scene.contact, scene.pairs, at, x.branch)
        advance_trees(scene.trees, at)
        _sum_apart(scene.floating, run, x, h)
    else:
        note_branches_at_start(scene.contact, scene.pairs, at, x.branch)


@inline
def _sum_apart(floating, run, x, h):
    """Sum what a step has changed of the coordinates, and take these as that beyond the start."""
    offsets, start = run.offsets[0], run.work.start
    for i in range(joint_count(run.scene.trees, run.scene.tree)):
        _add(start, x, offsets.qd + i, h * x.y[offsets.qdd + i])
        _add(start, x, offsets.q + i, h * x.y[offsets.qd + i])
    if floating is not None:
        for base in range(base_count(run.scene.trees)):
            position, speed = offsets.base_q + 7 * base, offsets.base_qd + 6 * base
            for i in range(6):
                _add(start, x, speed + i, h * x.y[offsets.base_qdd + 6 * base + i])
            for i in range(3):
                _add(start, x, position + i, h * x.y[speed + i])
            for i in range(position + 3, position + 7):
                x.moved[i] = x.y[i] - start[i]
    _balls_apart(run.scene.balls, offsets, start, x)


@inline
def _balls_apart(balls, offsets, start, x):
    if balls is not None:
        for i in range(offsets.ball_q, offsets.ball_q + 4 * len(balls)):
            x.moved[i] = x.y[i] - start[i]


@inline
def _add(start, x, i, change):
    x.moved[i] = x.moved[i] + change
    x.y[i] = start[i] + x.moved[i]


@inline
def first_slope(implicit, run, y, t):
    """Fill the explicit rule's slope at the start of the next step, and what is derived there, in y too."""
    if implicit is None:
        columns, offsets = in_lanes(run.work.columns), run.offsets[0]
        for i in range(offsets.step_control):
            columns.y[i] = y[i]
        for lane in range(WIDTH):
            lane_inputs(run, lane, t, False)
        _slope(run, columns, columns.first)
        run.work.pace[EVALUATIONS] += 1.0
        for i in range(offsets.before_derived, offsets.after_derived):
            y[i] = run.work.columns.y[i, 0]


@inline
def set_decays(decay, actuator, columns):
    """Fill what is left of currents and filtered speeds after each lane's step, and the currents' mean."""
    if decay is not None:
        set_decay(motor_of(actuator), controller_of(actuator), columns.h[0], decay)


@inline
def lane_inputs(run, lane, t, constant):
    """Bring a lane's torques and references of continuous servos to the time t; `constant`: also those of one knot."""
    u = run.signals
    _fill_lane(u.torques, u.continuous, u.reference, u, run.work.columns, lane, t, constant)


@inline
def _fill_lane(torques, continuous, reference, u, columns, lane, t, constant):
    if torques is not None:
        if constant or len(torques.times) > 1:
            evaluate(torques, t, u.torque_values)
            for i in range(len(columns.tau)):
                columns.tau[i, lane] = u.torque_values[i, 0]
    if continuous is not None and reference is not None:
        if constant or len(reference.times) > 1:
            evaluate(reference, t, u.drive)
            for i in range(len(u.drive)):
                columns.drive[i, 0, lane] = u.drive[i, 0]
                columns.drive[i, 1, lane] = u.drive[i, 1]
