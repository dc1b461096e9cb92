"""Extrapolation of a simple step to high order, with variable order and step: the library's reference.

The interval H is crossed in n = n_1, n_2, ... equal steps of a basic method; since the result is a polynomial in h (or
in h^2) plus a rest, Aitken and Neville's scheme extrapolates it to h = 0.  Basic methods:

    nothing stiff: the explicit midpoint rule with Gragg's last step, expansion in h^2 (Bulirsch, Stoer), n = 2, 4, ...
    servos, gearboxes, contacts: the linearly implicit Euler step of newton.py, expansion in h, n = 1, 2, 3, ...

Order and step are chosen for the least work by distance: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary
Differential Equations I, 2nd edition, section II.9, and E. Hairer, G. Wanner, II, section IV.9 (ODEX and SEULEX).
What a step derives (torques, forces, accelerations) is a smooth function of h too, and is extrapolated along.

That holds where the forces are smooth.  A force that changes to another branch of its law (a stop touched, a limit met,
teeth apart, a foot that slips) makes a discontinuity.  The errors of all columns are then alike, and one is small by
chance.  Each step therefore identifies its branches (step/branch.py).  An interval in which they change, or at whose
end they are others than any column has seen, is cut before the discontinuity, and the next one behind it, until the
error of the first two columns, which is of one order and never small by chance, meets the tolerance too.

The scheme multiplies rounding errors: of nine columns in powers of h by up to 11 000.  What a column changes is
therefore summed apart from where it starts, and the scheme extrapolates these changes: rounding is then that of the
change in a step, and falls with the step.

The columns of the scheme do not depend on each other and run side by side in lanes.  Column k and column K - k take
together as many steps as column K, so that K columns fill K/2 + 1 lanes without a gap, and K columns cost the time of
the longest: order pays more than it does one column at a time.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import apart, inline, kernel
from ..compile.lanes import WIDTH, aligned, any_lane, select
from ..compile.optional import any_present, if_present, in_lanes
from ..compile.structure import structure
from ..effects.actuator import controller_of, motor_of
from ..effects.decay import DECAYS, set_decay
from ..effects.energies import ENERGIES, METER
from ..effects.friction import stops_at_once
from ..effects.tendon import tendons_stop
from ..step.advance import advance_trees, solve_trees
from ..step.branch import branches, branches_at_start
from ..step.closure import factor_at, project
from ..step.context import NEWTON_TOLERANCE, Step
from ..step.depth import TOO_DEEP, too_deep, watch_depth
from ..step.derivative import derivative
from ..step.pace import COLUMNS, EVALUATIONS, REJECTED, SINCE, SIZE, STEP, STEPS, UNTIL, in_time, meters, root, scaled
from ..step.signals import evaluate
from ..step.terrain import last_stage
from ..tree.ball import unit_balls
from ..tree.forest import base_count, joint_count
from ..tree.kinematics import unit_quaternions
from .integrator import Integrator, begin_interval, begin_run, scratch, take_adaptive_step, take_up_again

LONGEST, LONGEST_LINEAR = 12, 9  # columns in powers of h^2 and h; one more multiplies rounding by 2.2 and 3.4
SAFETY, TARGET = 0.94, 0.65  # step = SAFETY h (TARGET / error) ** (1 / order)
FALL, FALL_SQUARES = 10.0, 1000.0  # of the error, that one more column in powers of h or h^2 is believed to bring
MOST_REJECTED = 1000.0  # attempts at one step
INSTANT = 1e-3  # of the interval: after its start
DISCONTINUOUS = 0.3  # of the error of two columns, assumed for an interval with a discontinuity
# Columns that agree so much better than later ones have all stepped over what these see: a contact that ends within
# their first step, or a joint that friction stops there.
HIDDEN, HIDDEN_STOP = 10.0, 1e4
PASSED = 1e3  # error over the tolerance with which a discontinuity is passed at the least step
LOCATED = 4.0  # least steps: a discontinuity is located no more precisely
LEFT, DONE, COLUMN = 0, 1, 2  # rows of `lanes`: steps to go, steps done, column
# What is known of a discontinuity: the share of the interval before it, negative if there is none; the step that would
# end behind it after one to there [s]; the branches of the forces at the interval's start; the error of two columns.
BEFORE, BEHIND, BRANCH, ROUGH = 0, 1, 2, 3


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
    branch: np.ndarray  # (1,): of the forces of each lane's last step
    moved: np.ndarray  # (what is integrated,): changes since the start, of the implicit step those of coordinates
    W: np.ndarray
    Z: np.ndarray
    C: np.ndarray
    F: np.ndarray
    N: np.ndarray
    pool: tuple | None
    rows: tuple | None
    closing: tuple | None


@structure
class Ladder(NamedTuple):
    """Workspace."""

    start: np.ndarray  # (length of the state,)
    best: np.ndarray  # (length of the state,)
    table: np.ndarray  # (LONGEST, length of the state): changes by the columns, then the scheme's last row
    lanes: np.ndarray  # (3, WIDTH): what each lane is at
    wanted: np.ndarray  # (LONGEST,): the step that each column's error asks for [s]
    discontinuity: np.ndarray  # (4,): what is known of a discontinuity in the interval
    columns: Columns
    pace: np.ndarray  # (SIZE,)
    implicit: bool | None  # True: linearly implicit Euler, None: explicit midpoint


@take_adaptive_step.of(Ladder)
def extrapolate(work, run, y, t, length):
    """Take a step that meets the tolerance; columns.first, the slope at y, moves on with it."""
    offsets, pace, start, implicit = run.offsets[0], work.pace, work.start, work.implicit
    for i in range(offsets.step_control):
        start[i] = y[i]
    rejected, until = False, pace[REJECTED] + MOST_REJECTED
    while pace[REJECTED] < until:
        h = in_time(min(pace[STEP], _longest(run.plan.second_run, pace)), length)
        count = min(max(int(pace[COLUMNS]), 2), _most_columns(implicit))
        error, skipped = 1e300, _sweep(implicit, run, t, h, count)
        if skipped <= 1.0:
            error = _combine(implicit, run, h, count)
            if error <= 1.0 and _ends_elsewhere(implicit, run, h):
                error = max(error, _error_of_discontinuity(run, h))
            nearest = 1.5 if _sticks(run) else LOCATED
            if work.discontinuity[BEFORE] >= 0.0 and h < nearest * run.plan.least_step and error < PASSED:
                error = min(error, 1.0)
        if error <= 1.0:
            for i in range(_smooth(implicit, run)):  # the watch on chatter stays
                y[i] = work.best[i]
            y[offsets.newton_iterations] = work.columns.y[offsets.newton_iterations, 0]  # those of the last column
            unit_quaternions(run.scene.floating, run.scene.trees, offsets.base_q, y)
            unit_balls(run.scene.balls, offsets.ball_q, y)
            _close(run.scene.loops, run, y)
            _keep_features(run.scene.pairs, run, y)
            _first_slope(implicit, run, y, t + h)
            pace[STEPS] += 1.0
            _choose(work, count - 1, h, length, rejected)
            if work.discontinuity[BEHIND] > 0.0:
                pace[STEP] = min(pace[STEP], work.discontinuity[BEHIND])
            work.discontinuity[BEHIND] = 0.0
            return h
        rejected = True
        pace[REJECTED] += 1.0
        pace[STEP] = h * max(0.1, 0.8 / root(skipped, 3))
        if error < 1e300:
            best = _cheapest(work, count - 1, h)
            pace[COLUMNS] = best + 2
            pace[STEP] = min(0.7 * h, max(0.05 * h, work.wanted[best]))
        if work.discontinuity[BEFORE] >= 0.0:
            least = run.plan.least_step
            if skipped <= 1.0 and (h > LOCATED * least or not _sticks(run)):
                pace[STEP] = max(_narrow(work, h, count, error), 0.8 * LOCATED * least)
            elif h > 1.5 * least:
                pace[STEP] = max(pace[STEP], 1.2 * least)
        if not pace[STEP] > run.plan.least_step:
            return 0.0
    return 0.0


@if_present()
def _close(loops, run, y):
    """Close loops at the end of the step, in factors that are found there."""
    columns, offsets = in_lanes(run.work.columns), run.offsets[0]
    for i in range(offsets.step_control):
        columns.y[i] = y[i]
    factor_at(loops, run.scene, offsets, columns, columns.y)
    project(loops, run.scene, offsets, columns, columns.y)
    for i in range(offsets.after_coordinates):
        y[i] = run.work.columns.y[i, 0]
    y[offsets.newton_iterations + 1] = run.work.columns.y[offsets.newton_iterations + 1, 0]


@if_present()
def _keep_features(pairs, run, y):
    """Take over which features of pairs have which slots, as the last column found them."""
    start = run.offsets[0].pair_feature
    for i in range(start, start + len(run.work.columns.pool.old)):
        y[i] = run.work.columns.y[i, 0]


@inline
def _longest(second_run, pace):
    """Return the longest step [s]: a second run takes two where events let the first take one, or both were alike."""
    interval = pace[UNTIL] - pace[SINCE]
    return 0.5 * interval if second_run else 2.0 * interval


@inline
def _sticks(run):
    """Return whether friction may stop a joint at once: a jump of slope that can hide from all columns."""
    return stops_at_once(run.scene.friction) or tendons_stop(run.scene.tendons)


@inline
def _ends_elsewhere(implicit, run, h):
    """Return whether there is a discontinuity at the interval's end that no column has noticed.

    It changes the branches an instant after the best values.
    """
    if implicit is None:
        return False
    ladder = run.work
    if ladder.discontinuity[BEFORE] >= 0.0:
        return False
    columns = in_lanes(ladder.columns)
    for i in range(_smooth(True, run)):
        columns.y[i] = ladder.best[i]
    columns.h[0] = h * INSTANT
    _set_decay(columns.decay, run.scene.actuator, columns)
    _euler(True, run, columns)
    if ladder.columns.branch[0, 0] == ladder.discontinuity[BRANCH]:
        return False
    ladder.discontinuity[BEFORE] = 1.0
    return True


last_stage.of(Ladder)(lambda work: (work.columns.W, work.columns.C))


@watch_depth.of(Ladder)
def _watch_depth(work, run, y, t, dead):
    """Do so where any column's last step was too deep."""
    columns = in_lanes(work.columns)
    return _watch(any_present(run.scene.pairs, run.scene.contact), columns, run, y, t, dead)


@inline
def _watch(present, columns, run, y, t, dead):
    if present is None:
        return dead
    none = columns.h[0] < 0.0
    if any_lane(too_deep(run.scene.pairs, run.scene.contact, columns.pool, columns.C, none)):
        y[run.offsets[0].status] = TOO_DEEP
        return True
    return dead


@inline
def _narrow(work, h, count, error):
    """Return a step [s] that ends before the discontinuity, or if there is no room one in which it weighs less."""
    cell, discontinuity = h / count, work.discontinuity
    discontinuity[BEHIND] = 0.0
    if discontinuity[BEFORE] == 0.0:
        return max(cell, 0.7 * h / root(error, 2))
    discontinuity[BEHIND] = 1.01 * cell
    return min(discontinuity[BEFORE] * h, h - cell)


@inline
def _steps(implicit, j):
    """Return the number of steps of column j = 0, 1, ..."""
    if implicit is None:
        return 2 * (j + 1)
    return j + 1


@inline
def _most_columns(implicit):
    if implicit is None:
        return LONGEST
    return LONGEST_LINEAR


# ---------------------------------------------------------------------------------------------- columns


@inline
def _sweep(implicit, run, t, h, count):
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
    _set_decay(columns.decay, run.scene.actuator, columns)
    total = _steps(implicit, count - 1)
    ladder.discontinuity[BEFORE] = -1.0
    for k in range(total):
        for lane in range(WIDTH):
            ahead = (ladder.lanes[DONE, lane] + 1) * ladder.columns.h[0, lane]  # the first evaluation lies a step ahead
            _lane_inputs(run, lane, min(t + ahead, pace[UNTIL]), False)
        if implicit is None:
            _midpoint(run, columns)
        else:
            _euler(None, run, columns)
        _look_for_discontinuity(implicit, ladder, k, total, half)
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
            _set_decay(columns.decay, run.scene.actuator, columns)
    return 0.0 if sound else 1e60


@inline
def _look_for_discontinuity(implicit, ladder, k, total, half):
    """Note after the k-th steps whether a lane is on other branches than an instant after the interval's start.

    The longest column, of `total` steps, shows where; if only others have seen it, the end is as good a guess.
    """
    if implicit is not None:
        branch, discontinuity = ladder.columns.branch[0], ladder.discontinuity
        if k == 0:
            discontinuity[BRANCH] = branch[WIDTH - 1]
        if branch[0] != discontinuity[BRANCH] and not 0.0 <= discontinuity[BEFORE] < 1.0:
            discontinuity[BEFORE] = k / total
        for lane in range(1, half + 1):
            if branch[lane] != discontinuity[BRANCH] and discontinuity[BEFORE] < 0.0:
                discontinuity[BEFORE] = 1.0


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
    start, lanes, columns, n = run.work.start, run.work.lanes, run.work.columns, _steps(implicit, column)
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
    summed = _summed(implicit, run)
    for i in range(summed):
        ladder.table[column, i] = ladder.columns.moved[i, lane]
    for i in range(summed, _smooth(implicit, run)):
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
        tolerance=NEWTON_TOLERANCE, W=x.W, Z=x.Z, C=x.C, F=x.F, N=x.N, pool=x.pool, part=None, rows=x.rows,
        closing=x.closing,
    )  # fmt: skip
    derivative(at, slope)


@apart
def _euler(ended, run, columns):
    """Take a linearly implicit Euler step; once the interval has ended, find the branches on which one would start."""
    scene, x, offsets, t, h = run.scene, columns, run.offsets[0], run.work.pace[SINCE], columns.h[0]
    at = Step(
        scene=scene, actuator=scene.actuator, decay=x.decay, offsets=offsets, y=x.y, tau=x.tau, drive=x.drive,
        predicted=None, t=t, span=0.0, h=h, h_implicit=h, theta=1.0, extrapolation_ratio=None,
        tolerance=NEWTON_TOLERANCE, W=x.W, Z=x.Z, C=x.C, F=x.F, N=x.N, pool=x.pool, part=None, rows=x.rows,
        closing=x.closing,
    )  # fmt: skip
    if ended is None:
        solve_trees(scene.trees, scene.pairs, at)
        x.branch[0] = branches(scene.contact, scene.pairs, at)
        advance_trees(scene.trees, at)
        _sum_apart(scene.floating, run, x, h)
    else:
        x.branch[0] = branches_at_start(scene.contact, scene.pairs, at)


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
def _first_slope(implicit, run, y, t):
    """Fill the explicit rule's slope at the start of the next step, and what is derived there, in y too."""
    if implicit is None:
        columns, offsets = in_lanes(run.work.columns), run.offsets[0]
        for i in range(offsets.step_control):
            columns.y[i] = y[i]
        for lane in range(WIDTH):
            _lane_inputs(run, lane, t, False)
        _slope(run, columns, columns.first)
        run.work.pace[EVALUATIONS] += 1.0
        for i in range(offsets.before_derived, offsets.after_derived):
            y[i] = run.work.columns.y[i, 0]


begin_interval.of(Ladder)(lambda work, run, y, t: _first_slope(work.implicit, run, y, t))
take_up_again.of(Ladder)(lambda work, run, y, t: _first_slope(work.implicit, run, y, t))


@inline
def _set_decay(decay, actuator, columns):
    """Fill what is left of currents and filtered speeds after each lane's step, and the currents' mean."""
    if decay is not None:
        set_decay(motor_of(actuator), controller_of(actuator), columns.h[0], decay)


@inline
def _lane_inputs(run, lane, t, constant):
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


@begin_run.of(Ladder)
def _begin_inputs(work, run):
    for lane in range(WIDTH):
        _lane_inputs(run, lane, 0.0, True)


# ---------------------------------------------------------------------------------------------- extrapolation


@inline
def _combine(implicit, run, h, count):
    """Extrapolate; return the smallest error, whose value `best` takes, and fill `wanted`.

    A column's error is what it changes, but no less than a share of the column's before: where the solution is smooth
    the errors fall by some such factor from column to column, while a discontinuity keeps them all alike, and
    then one of them is small by chance.
    """
    ladder, m, least, error = run.work, _smooth(implicit, run), 1e300, 0.0
    fall = FALL_SQUARES if implicit is None else FALL
    hidden = HIDDEN_STOP if _sticks(run) else HIDDEN
    for j in range(1, count):
        _neville(implicit, j, ladder.table, m)
        error = max(_error(run), error / fall)
        power = 2 * j + 1 if implicit is None else j + 1  # 1 / exponent of the step in the local error
        ladder.wanted[j] = min(SAFETY * h * root(TARGET / max(error, 1e-30), power), 20.0 * h)
        if j == 1 or error > hidden * ladder.discontinuity[ROUGH]:
            ladder.discontinuity[ROUGH] = error
        if error < least:
            least = error
            for i in range(m):
                ladder.best[i] = ladder.start[i] + ladder.table[0, i]
    return max(least, _error_of_discontinuity(run, h))


@inline
def _error_of_discontinuity(run, h):
    """Return the least error of an interval with a discontinuity over the tolerance.

    A discontinuity within the first or last step of all columns shows only in the largest of their differences, that of
    the first two, in proportion to the change of slope.  If it lies within the first step of some columns, the
    differences of these are all alike, and the largest is the first of the others.
    """
    if run.work.discontinuity[BEFORE] < 0.0 or h < LOCATED * run.plan.least_step:
        return 0.0
    return DISCONTINUOUS * run.work.discontinuity[ROUGH]


@inline
def _neville(implicit, j, table, m):
    """Add column j to the scheme: table[0] becomes the new best value, table[1] the one of an order less."""
    for l in range(j, 0, -1):
        ratio = _steps(implicit, j) / _steps(implicit, l - 1)
        if implicit is None:
            ratio = ratio * ratio
        c = 1.0 / (ratio - 1.0)
        for i in range(m):
            table[l - 1, i] = table[l, i] + c * (table[l, i] - table[l - 1, i])


@inline
def _error(run):
    """Return the difference of the two best values over the tolerance, of the worst component that has one.

    These are positions, velocities, currents, rotors, filters, bristles and the energies that the meters read.
    """
    offsets, worst = run.offsets[0], 0.0
    for i in range(offsets.after_controlled):
        worst = _worse(worst, run, i)
    for i in range(meters(motor_of(run.scene.actuator))):
        worst = _worse(worst, run, offsets.energy + ENERGIES * i + METER)
    return worst


@inline
def _worse(worst, run, i):
    table, start = run.work.table, run.work.start
    e = scaled(run.plan, table[0, i] - table[1, i], start[i], start[i] + table[0, i])
    if not e < 1e300:
        return 1e300
    return max(worst, e)


@inline
def _smooth(implicit, run):
    """Return how much of the state is extrapolated: what is integrated and, of the implicit step, derived."""
    if implicit is None:
        return run.plan.integrated
    return run.offsets[0].after_derived


@inline
def _summed(implicit, run):
    """Return how much of the state has its changes summed apart."""
    if implicit is None:
        return run.plan.integrated
    return run.offsets[0].after_coordinates


# ---------------------------------------------------------------------------------------------- order and step


@inline
def _cheapest(ladder, last, length):
    """Return the column up to which the work by distance is least: its steps, and one for what comes with it."""
    best = 1
    for j in range(2, last + 1):
        if (j + 2.0) * min(ladder.wanted[best], length) < (best + 2.0) * min(ladder.wanted[j], length):
            best = j
    return best


@inline
def _choose(ladder, last, h, length, rejected):
    """Choose order and step of least work by distance, after columns up to `last`.

    One column more than the step needs is taken in reserve: its error is then met almost always, where without it a
    quarter of a chaotic arm's steps are rejected.
    """
    best, pace = _cheapest(ladder, last, length), ladder.pace
    step = ladder.wanted[best]
    if rejected:
        step = min(step, h)
    pace[COLUMNS] = best + 2
    if h < length or step < h:
        pace[STEP] = step


def _workspace(sizes, zeros):
    """Make the workspace; its lanes are its own, while `zeros` makes arrays of one run."""

    def in_eight(shape):
        return aligned((*np.atleast_1d(shape), WIDTH))

    offsets = sizes.offsets
    size, rates = int(offsets["length"]), int(offsets["after_integrated"])
    columns = Columns(
        y=in_eight(size),
        h=in_eight(1),
        last=in_eight(1),
        slope=in_eight(rates),
        first=in_eight(rates),
        previous=in_eight(rates),
        drive=in_eight((sizes.inputs, 2)),
        tau=in_eight(sizes.inputs) if sizes.driven else None,
        decay=in_eight((sizes.motors, DECAYS)) if sizes.motors else None,
        branch=in_eight(1),
        moved=in_eight(rates),
        **scratch(sizes, in_eight)._asdict(),
    )
    return Ladder(
        start=zeros(size),
        best=zeros(size),
        table=zeros((LONGEST, size)),
        lanes=np.zeros((3, WIDTH), np.int64),
        wanted=zeros(LONGEST),
        discontinuity=zeros(4),
        columns=columns,
        pace=zeros(SIZE),
        implicit=True if sizes.stiff else None,
    )


EXTRAPOLATION = Integrator(
    "extrapolation", LONGEST, _workspace, adaptive=True, folds_spring=True, least_step=1e-9
)  # it locates discontinuities by the least step
