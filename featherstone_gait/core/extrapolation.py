"""Extrapolation of a simple step to high order, with variable order and step: the library's reference.

The interval H is crossed in n = n_1, n_2, ... equal steps of a basic method; since the result is a polynomial in h (or
in h^2) plus a rest, Aitken and Neville's scheme extrapolates it to h = 0.  Basic methods:

    nothing stiff: the explicit midpoint rule with Gragg's last step, expansion in h^2 (Bulirsch, Stoer), n = 2, 4, ...
    servos, gearboxes, contacts: the linearly implicit Euler step of step.py, expansion in h, n = 1, 2, 3, ...

Order and step are chosen for the least work by distance: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary
Differential Equations I, 2nd edition, section II.9, and E. Hairer, G. Wanner, II, section IV.9 (ODEX and SEULEX).
What a step derives (torques, forces, accelerations) is a smooth function of h too, and is extrapolated along.

The columns of the scheme do not depend on each other and run side by side in lanes.  Column k and column K - k take
together as many steps as column K, so that K columns fill K/2 + 1 lanes without a gap, and K columns cost the time of
the longest: order pays more than it does one column at a time.
"""

from typing import NamedTuple

import numpy as np

from .advance import advance
from .derivative import derivative
from .elementary import exp
from .jit import inline, kernel
from .knots import evaluate
from .lanes import WIDTH, select
from .layout import DECAY, ENERGIES, FADE, FILTER, IND, MEAN, METER, RES
from .pace import (
    COLUMNS,
    EVALUATIONS,
    REJECTED,
    SINCE,
    STEP,
    STEPS,
    UNTIL,
    in_time,
    meters,
    root,
    scaled,
    unit_quaternion,
)
from .scene import driven
from .step import solve_step

LONGEST = 12  # columns: rounding errors grow by 2.7 a column of the linear sequence
SAFETY, TARGET = 0.94, 0.65  # step = SAFETY h (TARGET / error) ** (1 / order)
FALL, FALL_SQUARES = 10.0, 1000.0  # of the error, that one more column in powers of h or h^2 is believed to bring
INSTANT = 1e-3  # of the interval: after its start
LEFT, DONE, COLUMN = 0, 1, 2  # rows of `lanes`: steps to go, steps done, column


class Ladder(NamedTuple):
    """What the extrapolation overwrites; its lanes are seen by the kernels as `Columns`."""

    start: np.ndarray  # (length of the state,)
    best: np.ndarray  # (length of the state,)
    table: np.ndarray  # (LONGEST, length of the state): the columns, then the last row of the scheme
    lanes: np.ndarray  # (3, WIDTH): what each lane is at
    wanted: np.ndarray  # (LONGEST,): the step that each column's error asks for [s]
    y: np.ndarray  # (length of the state, WIDTH)
    h: np.ndarray  # (1, WIDTH): steps [s]
    last: np.ndarray  # (1, WIDTH): 1 where the step is the last of its column
    slope: np.ndarray  # (o.voltage, WIDTH)
    first: np.ndarray  # (o.voltage, WIDTH): slope at the start
    previous: np.ndarray  # (o.voltage, WIDTH)
    drive: np.ndarray  # (n, 2, WIDTH)
    tau: np.ndarray | None  # (n, WIDTH) [N m]
    servo: np.ndarray | None  # (n, SERVO_COLUMNS, WIDTH): servo parameters, with exponentials for each lane's step
    implicit: bool | None  # True: linearly implicit Euler, None: explicit midpoint


class Columns(NamedTuple):
    """The lanes of `Ladder` and the workspaces."""

    y: np.ndarray
    h: np.ndarray
    last: np.ndarray
    slope: np.ndarray
    first: np.ndarray
    previous: np.ndarray
    drive: np.ndarray
    tau: np.ndarray | None
    servo: np.ndarray | None
    W: np.ndarray
    Z: np.ndarray
    C: np.ndarray
    F: np.ndarray


@kernel
def extrapolate(scene, o, plan, y, t, length, ladder, columns, signals, pace):
    """Take one step of at most `length` [s] from t; y moves on, as does columns.first, the slope there.

    Returns the step, 0 if the error control asks for one too small.
    """
    start = ladder.start
    for i in range(o.pace):
        start[i] = y[i]
    rejected = False
    while True:
        h = in_time(pace[STEP], length)
        count = min(max(int(pace[COLUMNS]), 2), LONGEST)
        error, skipped = 1e300, _sweep(ladder.implicit, scene, o, plan, t, h, count, signals, ladder, columns, pace)
        if skipped <= 1.0:
            error = _combine(ladder.implicit, scene.servo, o, plan, h, count, ladder)
        if error <= 1.0:
            _accept(ladder.implicit, o, plan, y, ladder)
            unit_quaternion(scene.floating, o, y)
            first_slope(ladder.implicit, scene, o, y, t + h, signals, ladder, columns, pace)
            pace[STEPS] += 1.0
            _choose(ladder, pace, count - 1, h, length, rejected)
            return h
        rejected = True
        pace[REJECTED] += 1.0
        pace[STEP] = h * max(0.1, 0.8 / root(skipped, 3))
        if error < 1e300:
            best = _cheapest(ladder, count - 1, h)
            pace[COLUMNS] = best + 2
            pace[STEP] = min(0.7 * h, max(0.05 * h, ladder.wanted[best]))
        if not pace[STEP] > plan.least_step:
            return 0.0


@inline
def _steps(implicit, j):
    """Steps of column j = 0, 1, ..."""
    if implicit is None:
        return 2 * (j + 1)
    return j + 1


@inline
def _power(implicit, count):
    """1 / exponent of the step in the local error of `count` columns."""
    if implicit is None:
        return 2 * count - 1
    return count


# ---------------------------------------------------------------------------------------------- columns


@inline
def _sweep(implicit, scene, o, plan, t, h, count, signals, ladder, columns, pace):
    """Cross the interval in `count` columns, which fill the rows of the table.

    Lane l takes the column l from the last one, then column l - 1, if there is one: together they are as long as the
    last.  Of the lanes left over the last tells what the interval's start hides from the columns: see `_skipped`.
    Returns that error by the tolerance, and 1e60 if Newton's iteration failed.
    """
    half, sound = count // 2, True
    for lane in range(WIDTH):
        column = count - 1
        if lane <= half:
            column = count - 1 - lane
        _assign(implicit, ladder, lane, column, h)
    if implicit is not None:
        ladder.h[0, WIDTH - 1] = h * INSTANT
    _begin(implicit, o, plan, ladder, columns)
    _set_exponentials(scene.servo, columns)
    total = _steps(implicit, count - 1)
    for k in range(total):
        for lane in range(WIDTH):
            _lane_inputs(signals, ladder, lane, min(t + _time(ladder, lane, implicit), pace[UNTIL]))
        _step(implicit, scene, o, plan, signals, columns, pace)
        if implicit is not None and k == 0:
            skipped = _skipped(scene.floating, o, plan, len(scene.tree) - 1, min(half, 3), ladder)
            if skipped > 1.0:
                return skipped
        fresh = False
        for lane in range(half + 1):
            ladder.lanes[LEFT, lane] -= 1
            ladder.lanes[DONE, lane] += 1
            if ladder.lanes[LEFT, lane] == 0:
                sound = sound & _harvest(implicit, o, plan, ladder, lane)
                pace[EVALUATIONS] += ladder.lanes[DONE, lane]
                if k < total - 1:
                    _assign(implicit, ladder, lane, max(lane - 1, 0), h)
                    _begin_again(implicit, o, plan, ladder, lane)
                    fresh = True
            if implicit is None:
                ladder.last[0, lane] = 1.0 if ladder.lanes[LEFT, lane] == 1 else 0.0
        if implicit is None:
            for lane in range(half + 1, WIDTH):
                ladder.last[0, lane] = ladder.last[0, 0]
        if fresh:
            _set_exponentials(scene.servo, columns)
    return 0.0 if sound else 1e60


@inline
def _skipped(floating, o, plan, n, last, ladder):
    """What the linearly implicit step does not see of the interval's start, as an error of the positions.

    It takes forces at the end of a step only.  A kink within the first step of all columns is the same for all of them,
    as if it had been at the start, and nothing in the scheme tells.  But the accelerations of the columns' first steps,
    extrapolated to a step of none, then differ from those of an instant after the start.
    """
    worst = 0.0
    for i in range(n):
        worst = max(worst, _skipped_by(plan, last, o.qdd + i, o.q + i, ladder))
    if floating is not None:
        for i in range(6):  # the quaternion's vector is half the turn
            worst = max(worst, _skipped_by(plan, last, o.base_qdd + i, o.base_q + i + i // 3, ladder))
    return worst


@inline
def _skipped_by(plan, last, acceleration, position, ladder):
    """Of one coordinate, whose acceleration and position have these places in the state."""
    h, a = ladder.h[0], 0.0
    for j in range(last + 1):
        weight = 1.0
        for k in range(last + 1):
            if k != j:
                weight *= h[k] / (h[k] - h[j])
        a += weight * ladder.y[acceleration, j]
    e = (ladder.y[acceleration, WIDTH - 1] - a) * h[0] * h[0] / 6.0
    return scaled(plan, e, ladder.start[position], ladder.start[position])


@inline
def _assign(implicit, ladder, lane, column, h):
    """Give a lane a column."""
    n = _steps(implicit, column)
    ladder.lanes[LEFT, lane] = n
    ladder.lanes[DONE, lane] = 0
    ladder.lanes[COLUMN, lane] = column
    ladder.h[0, lane] = h / n


@inline
def _time(ladder, lane, implicit):
    """Time of a lane's next evaluation since the interval's start [s]; the first of either method lies a step ahead."""
    return (ladder.lanes[DONE, lane] + 1) * ladder.h[0, lane]


@inline
def _begin(implicit, o, plan, ladder, columns):
    """All lanes to the start."""
    for i in range(o.pace):
        columns.y[i] = ladder.start[i]
    if implicit is None:
        h = columns.h[0]
        for i in range(plan.integrated):
            columns.previous[i] = ladder.start[i]
            columns.y[i] = ladder.start[i] + h * columns.first[i]
        columns.last[0] = 0.0


@inline
def _begin_again(implicit, o, plan, ladder, lane):
    """One lane to the start."""
    for i in range(o.pace):
        ladder.y[i, lane] = ladder.start[i]
    if implicit is None:
        h = ladder.h[0, lane]
        for i in range(plan.integrated):
            ladder.previous[i, lane] = ladder.start[i]
            ladder.y[i, lane] = ladder.start[i] + h * ladder.first[i, lane]


@inline
def _harvest(implicit, o, plan, ladder, lane):
    """Put a lane's column into the table; return whether Newton's iteration converged in all of its steps."""
    column = ladder.lanes[COLUMN, lane]
    for i in range(_smooth(implicit, o, plan)):
        ladder.table[column, i] = ladder.y[i, lane]
    return not ladder.y[o.passes + 1, lane] > ladder.start[o.passes + 1]


@inline
def _step(implicit, scene, o, plan, signals, columns, pace):
    """One step of every lane."""
    if implicit is None:
        _midpoint(scene, o, plan.integrated, columns, pace)
    else:
        _euler(scene, o, columns, pace)


@kernel
def _midpoint(scene, o, m, columns, pace):
    """y_{k+1} = y_{k-1} + 2 h f(y_k); in the end Gragg's mean (y_{n-1} + 2 y_n + y_{n+1}) / 4, which sees the end."""
    _slope(scene, o, columns, columns.slope, pace[SINCE])
    y, previous, slope = columns.y, columns.previous, columns.slope
    h, last = columns.h[0], columns.last[0] > 0.0
    for i in range(m):
        here, step = y[i], h * slope[i]
        y[i] = select(last, 0.5 * (here + (previous[i] + step)), previous[i] + 2.0 * step)
        previous[i] = here


@kernel
def _slope(scene, o, columns, slope, since):
    derivative(
        scene,
        scene.points,
        scene.push,
        scene.floating,
        o,
        columns.y,
        since,
        0.0,
        slope,
        columns.tau,
        columns.drive,
        columns.W,
        columns.Z,
        columns.C,
        columns.F,
    )


@inline
def first_slope(implicit, scene, o, y, t, signals, ladder, columns, pace):
    """The explicit rule's slope at the start of the next step, and what is derived there, in y too."""
    if implicit is None:
        for i in range(o.pace):
            columns.y[i] = y[i]
        for lane in range(WIDTH):
            _lane_inputs(signals, ladder, lane, t)
        _slope(scene, o, columns, columns.first, pace[SINCE])
        pace[EVALUATIONS] += 1.0
        for i in range(o.base_qdd, o.increment):
            y[i] = ladder.y[i, 0]


@kernel
def _euler(scene, o, columns, pace):
    """A linearly implicit Euler step."""
    at = driven(scene, columns.servo, scene.gear, scene.pd, scene.law)
    h = columns.h[0]
    solve_step(
        at,
        at.points,
        at.push,
        o,
        columns.y,
        pace[SINCE],
        0.0,
        None,
        columns.tau,
        columns.drive,
        h,
        h,
        columns.W,
        columns.Z,
        columns.C,
        columns.F,
    )
    advance(
        at,
        at.servo,
        at.gear,
        at.points,
        at.floating,
        o,
        columns.y,
        None,
        columns.tau,
        columns.drive,
        h,
        h,
        1.0,
        columns.W,
        columns.Z,
        columns.C,
    )


@inline
def _set_exponentials(servo, columns):
    """What is left of currents and filtered speeds after each lane's step, and the currents' mean."""
    if servo is not None:
        h = columns.h[0]
        for i in range(len(servo)):
            if servo[i, IND] > 0.0:
                z = h * (servo[i, RES] / servo[i, IND])
                decay = exp(-z)
                series = 1.0 - z * (0.5 - z * (1.0 / 6.0 - z * (1.0 / 24.0)))  # where the difference loses digits
                columns.servo[i, DECAY] = decay
                columns.servo[i, MEAN] = select(z < 1e-3, series, (1.0 - decay) / z)
            if servo[i, FILTER] > 0.0:
                columns.servo[i, FADE] = exp(-h / servo[i, FILTER])


@inline
def _lane_inputs(signals, ladder, lane, t):
    """Bring a lane's torques and references of continuous servos to the time t, if they change at all."""
    _lane_torques(signals.torques, signals.torque_values, ladder.tau, lane, t)
    _lane_drive(signals.continuous, signals.reference, signals.drive, ladder.drive, lane, t)


@inline
def _lane_torques(torques, values, tau, lane, t):
    if torques is not None:
        if len(torques.times) > 1:
            _put_torques(torques, values, tau, lane, t)


@inline
def _put_torques(torques, values, tau, lane, t):
    evaluate(torques, t, values)
    for i in range(len(tau)):
        tau[i, lane] = values[i, 0]


@inline
def _lane_drive(continuous, reference, drive, out, lane, t):
    if continuous is not None:
        if reference is not None:
            if len(reference.times) > 1:
                _put_drive(reference, drive, out, lane, t)


@inline
def _put_drive(reference, drive, out, lane, t):
    evaluate(reference, t, drive)
    for i in range(len(drive)):
        out[i, 0, lane] = drive[i, 0]
        out[i, 1, lane] = drive[i, 1]


@inline
def begin_inputs(signals, ladder):
    """Torques and references that are constant."""
    for lane in range(WIDTH):
        _begin_torques(signals.torques, signals.torque_values, ladder.tau, lane)
        _begin_drive(signals.continuous, signals.reference, signals.drive, ladder.drive, lane)


@inline
def _begin_torques(torques, values, tau, lane):
    if torques is not None:
        _put_torques(torques, values, tau, lane, 0.0)


@inline
def _begin_drive(continuous, reference, drive, out, lane):
    if continuous is not None:
        if reference is not None:
            _put_drive(reference, drive, out, lane, 0.0)


# ---------------------------------------------------------------------------------------------- extrapolation


@inline
def _combine(implicit, servo, o, plan, h, count, ladder):
    """Extrapolate; `best` takes the value of the smallest error, which is returned; `wanted` is filled.

    A column's error is what it changes, but no less than a share of the column's before: where the solution is smooth
    the errors fall by some such factor from column to column, while a kink in the interval keeps them all alike, and
    then one of them is small by chance.
    """
    m, least, error = _smooth(implicit, o, plan), 1e300, 0.0
    for j in range(1, count):
        _neville(implicit, j, ladder.table, m)
        error = max(_error(servo, o, plan, ladder.start, ladder.table), error / _largest_fall(implicit))
        ladder.wanted[j] = min(SAFETY * h * root(TARGET / max(error, 1e-30), _power(implicit, j + 1)), 20.0 * h)
        if error < least:
            least = error
            for i in range(m):
                ladder.best[i] = ladder.table[0, i]
    return least


@inline
def _largest_fall(implicit):
    """Of the error from one column to the next."""
    if implicit is None:
        return FALL_SQUARES
    return FALL


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
def _error(servo, o, plan, start, table):
    """Difference of the two best values over the tolerance, of the worst component that has one.

    These are positions, velocities, currents, rotors, filters, bristles and the energies that the meters read.
    """
    worst = 0.0
    for i in range(o.energy):
        worst = _worse(worst, plan, table, start, i)
    for i in range(meters(servo)):
        worst = _worse(worst, plan, table, start, o.energy + ENERGIES * i + METER)
    return worst


@inline
def _worse(worst, plan, table, start, i):
    e = scaled(plan, table[0, i] - table[1, i], start[i], table[0, i])
    if not e < 1e300:
        return 1e300
    return max(worst, e)


@inline
def _smooth(implicit, o, plan):
    """How much of the state is extrapolated: what is integrated and, of the implicit step, what it derives."""
    if implicit is None:
        return plan.integrated
    return o.increment


@inline
def _accept(implicit, o, plan, y, ladder):
    """The best values; the watch on chatter stays as it was, passes are those of the last column."""
    for i in range(_smooth(implicit, o, plan)):
        y[i] = ladder.best[i]
    y[o.passes] = ladder.y[o.passes, 0]


# ---------------------------------------------------------------------------------------------- order and step


@inline
def _work(count):
    """Time of a step with so many columns: their steps, and one for what comes with it."""
    return count + 1.0


@inline
def _cheapest(ladder, last, length):
    """The column up to which the work by distance is least."""
    best = 1
    for j in range(2, last + 1):
        if _work(j + 1) * min(ladder.wanted[best], length) < _work(best + 1) * min(ladder.wanted[j], length):
            best = j
    return best


@inline
def _choose(ladder, pace, last, h, length, rejected):
    """Order and step of least work by distance, after columns up to `last`.

    One column more than the step needs is taken in reserve: its error is then met almost always, where without it a
    quarter of a chaotic arm's steps are rejected.
    """
    best = _cheapest(ladder, last, length)
    step = ladder.wanted[best]
    if rejected:
        step = min(step, h)
    pace[COLUMNS] = best + 2
    if h < length or step < h:
        pace[STEP] = step
