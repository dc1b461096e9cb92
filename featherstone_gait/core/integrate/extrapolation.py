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
chance.  Each step therefore notes its branches (step/branch.py).  An interval in which they change, or at whose end
they are others than any column has seen, is cut before the discontinuity, and the next one behind it, until the
error of the first two columns, which is of one order and never small by chance, meets the tolerance too.

The scheme multiplies rounding errors: of nine columns in powers of h by up to 11 000.  What a column changes is
therefore summed apart from where it starts, and the scheme extrapolates these changes: rounding is then that of the
change in a step, and falls with the step.

The columns of the scheme do not depend on each other and run side by side in lanes (columns.py).
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import inline
from ..compile.lanes import WIDTH, aligned, any_lane
from ..compile.optional import any_present, if_present, in_lanes
from ..compile.structure import structure
from ..effects.actuator import motor_of
from ..effects.decay import DECAYS
from ..effects.energies import ENERGIES, METER
from ..effects.friction import stops_at_once
from ..effects.tendon import tendons_stop
from ..step.branch import branch_count
from ..step.closure import factor_at, project
from ..step.depth import TOO_DEEP, too_deep, watch_depth
from ..step.pace import COLUMNS, REJECTED, SINCE, SIZE, STEP, STEPS, UNTIL, in_time, meters, root, scaled
from ..step.terrain import last_stage
from ..tree.ball import unit_balls
from ..tree.kinematics import unit_quaternions
from .columns import (
    BEFORE,
    BEHIND,
    INSTANT,
    LOCATED,
    ROUGH,
    Columns,
    compare_branches,
    euler_in_lanes,
    extrapolated,
    first_slope,
    lane_inputs,
    set_decays,
    steps_of,
    sweep,
)
from .integrator import Integrator, begin_interval, begin_run, scratch, take_adaptive_step, take_up_again

LONGEST, LONGEST_LINEAR = 12, 9  # columns in powers of h^2 and h; one more multiplies rounding by 2.2 and 3.4
SAFETY, TARGET = 0.94, 0.65  # step = SAFETY h (TARGET / error) ** (1 / order)
FALL, FALL_SQUARES = 10.0, 1000.0  # of the error, that one more column in powers of h or h^2 is believed to bring
MOST_REJECTED = 1000.0  # attempts at one step
DISCONTINUOUS = 0.3  # of the error of two columns, assumed for an interval with a discontinuity
# Columns that agree so much better than later ones have all stepped over what these see: a contact that ends within
# their first step, or a joint that friction stops there.
HIDDEN, HIDDEN_STOP = 10.0, 1e4
PASSED = 1e3  # error over the tolerance with which a discontinuity is passed at the least step


@structure
class Ladder(NamedTuple):
    """Workspace."""

    start: np.ndarray  # (length of the state,)
    best: np.ndarray  # (length of the state,)
    table: np.ndarray  # (LONGEST, length of the state): changes by the columns, then the scheme's last row
    lanes: np.ndarray  # (3, WIDTH): what each lane is at
    wanted: np.ndarray  # (LONGEST,): the step that each column's error asks for [s]
    discontinuity: np.ndarray  # (3,): what is known of a discontinuity in the interval
    branch: np.ndarray  # (branches,): of the forces an instant after the interval's start
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
        error, skipped = 1e300, sweep(implicit, run, t, h, count)
        if skipped <= 1.0:
            error = _combine(implicit, run, h, count)
            if error <= 1.0 and _ends_elsewhere(implicit, run, h):
                error = max(error, _error_of_discontinuity(run, h))
            nearest = 1.5 if _sticks(run) else LOCATED
            if work.discontinuity[BEFORE] >= 0.0 and h < nearest * run.plan.least_step and error < PASSED:
                error = min(error, 1.0)
        if error <= 1.0:
            for i in range(extrapolated(implicit, run)):  # the watch on chatter stays
                y[i] = work.best[i]
            y[offsets.newton_iterations] = work.columns.y[offsets.newton_iterations, 0]  # those of the last column
            unit_quaternions(run.scene.floating, run.scene.trees, offsets.base_q, y)
            unit_balls(run.scene.balls, offsets.ball_q, y)
            _close(run.scene.loops, run, y)
            _keep_features(run.scene.pairs, run, y)
            first_slope(implicit, run, y, t + h)
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
    for i in range(extrapolated(True, run)):
        columns.y[i] = ladder.best[i]
    columns.h[0] = h * INSTANT
    set_decays(columns.decay, run.scene.actuator, columns)
    euler_in_lanes(True, run, columns)
    compare_branches(ladder, columns)
    if ladder.columns.elsewhere[0, 0] == 0.0:
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
def _most_columns(implicit):
    if implicit is None:
        return LONGEST
    return LONGEST_LINEAR


begin_interval.of(Ladder)(lambda work, run, y, t: first_slope(work.implicit, run, y, t))
take_up_again.of(Ladder)(lambda work, run, y, t: first_slope(work.implicit, run, y, t))


@begin_run.of(Ladder)
def _begin_inputs(work, run):
    for lane in range(WIDTH):
        lane_inputs(run, lane, 0.0, True)


# ---------------------------------------------------------------------------------------------- extrapolation


@inline
def _combine(implicit, run, h, count):
    """Extrapolate; return the smallest error, whose value `best` takes, and fill `wanted`.

    A column's error is what it changes, but no less than a share of the column's before: where the solution is smooth
    the errors fall by some such factor from column to column, while a discontinuity keeps them all alike, and
    then one of them is small by chance.
    """
    ladder, m, least, error = run.work, extrapolated(implicit, run), 1e300, 0.0
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
        ratio = steps_of(implicit, j) / steps_of(implicit, l - 1)
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
    size, rates, made = int(offsets["length"]), int(offsets["after_integrated"]), scratch(sizes, in_eight)
    slots = 0 if made.pool is None else len(made.pool.C)
    branches = max(1, branch_count(sizes.n, sizes.tendons, sizes.points, slots)) if sizes.stiff else 1
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
        branch=in_eight(branches),
        elsewhere=in_eight(1),
        moved=in_eight(rates),
        **made._asdict(),
    )
    return Ladder(
        start=zeros(size),
        best=zeros(size),
        table=zeros((LONGEST, size)),
        lanes=np.zeros((3, WIDTH), np.int64),
        wanted=zeros(LONGEST),
        discontinuity=zeros(3),
        branch=zeros(branches),
        columns=columns,
        pace=zeros(SIZE),
        implicit=True if sizes.stiff else None,
    )


EXTRAPOLATION = Integrator(
    "extrapolation", LONGEST, _workspace, adaptive=True, folds_spring=True, least_step=1e-9
)  # it locates discontinuities by the least step
