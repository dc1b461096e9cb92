"""Extrapolation of a simple step to high order, with variable order and step: the library's reference.

The interval H is crossed in n = n_1, n_2, ... equal steps of a basic method; since the result is a polynomial in h (or
in h^2) plus a rest, Aitken and Neville's scheme extrapolates it to h = 0.  Basic methods:

    nothing stiff: the explicit midpoint rule, expansion in h^2 (Gragg, Bulirsch, Stoer), n = 2, 4, 6, ...
    servos, gearboxes, contacts: the linearly implicit Euler step of step.py, expansion in h, n = 1, 2, 3, ...

Order and step are chosen for the least work by distance: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary
Differential Equations I, 2nd edition, section II.9, and E. Hairer, G. Wanner, II, section IV.9 (ODEX and SEULEX).
What a step derives (torques, forces, accelerations) is a smooth function of h too, and is extrapolated along.
"""

from .advance import advance
from .dormand_prince import slope_at
from .elementary import exp
from .jit import inline, kernel
from .knots import inputs
from .layout import DECAY, ENERGIES, FADE, FILTER, IND, MEAN, METER, RES
from .pace import COLUMNS, EVALUATIONS, LONGEST, REJECTED, STEP, STEPS, in_time, meters, root, scaled, unit_quaternion
from .scene import Scene
from .step import solve_step

SAFETY, TARGET = 0.94, 0.65  # step = SAFETY h (TARGET / error) ** (1 / order)
LOWER, HIGHER = 0.8, 0.9  # work a column less or more must save to be preferred


@kernel
def extrapolate(scene, o, plan, y, t, length, ladder, signals, pace, s):
    """Take one step of at most `length` [s] from t; y moves on, as does ladder.first, the slope there.

    Returns the step, 0 if the error control asks for one too small.
    """
    start, table, wanted = ladder.start, ladder.table, ladder.wanted
    for i in range(len(start)):
        start[i] = y[i]
    rejected = False
    while True:
        h = in_time(pace[STEP], length)
        aim = min(max(int(pace[COLUMNS]), 2), LONGEST)
        error, done, j = 1e300, False, 0
        while j <= aim and not done:
            failed = _column(ladder.implicit, scene, o, plan, y, t, h, j, signals, ladder, pace, s)
            _neville(ladder.implicit, y, j, table, _smooth(ladder.implicit, o, plan))
            if failed:
                error = 1e300
                break
            j += 1
            if j > 1:
                error = _error(scene.servo, o, plan, start, table)
                wanted[j - 1] = min(SAFETY * h * root(TARGET / max(error, 1e-30), _power(ladder.implicit, j)), 20.0 * h)
                done = error <= 1.0
                if not done and j >= aim and error > _hopeless(ladder.implicit, j, aim):
                    break
        if done:
            _accept(ladder.implicit, o, plan, y, table, start)
            unit_quaternion(scene.floating, o, y)
            first_slope(ladder.implicit, scene, o, y, t + h, signals, ladder, s)
            pace[STEPS] += 1.0
            _choose(ladder, pace, j - 1, h, length, rejected)
            return h
        rejected = True
        pace[REJECTED] += 1.0
        pace[STEP] = h * 0.25
        if error < 1e300:
            pace[STEP] = min(0.7 * h, max(0.05 * h, wanted[j - 1]))
        for i in range(len(start)):
            y[i] = start[i]
        if not pace[STEP] > plan.least_step:
            return 0.0


@inline
def first_slope(implicit, scene, o, y, t, signals, ladder, s):
    """The explicit rule's slope at the start of the next step."""
    if implicit is None:
        slope_at(scene, o, y, t, signals, ladder.first, s)


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


@inline
def _hopeless(implicit, count, aim):
    """The error with `count` columns beyond which one more will not meet the tolerance."""
    ratio = (aim + 1) / 1.0
    if implicit is None:
        return ratio * ratio
    return ratio


@inline
def _column(implicit, scene, o, plan, y, t, h, j, signals, ladder, pace, s):
    """Cross the interval by the basic method in y; return whether it failed."""
    for i in range(len(y)):
        y[i] = ladder.start[i]
    n = _steps(implicit, j)
    pace[EVALUATIONS] += n
    if implicit is None:
        _midpoint(scene, o, plan.integrated, y, t, h / n, n, signals, ladder, s)
        return False
    _euler(scene, ladder.servo, o, y, t, h / n, n, signals, s)
    return y[o.passes + 1] > ladder.start[o.passes + 1]


@kernel
def _midpoint(scene, o, m, y, t, h, n, signals, ladder, s):
    """Gragg's explicit midpoint rule: y_{k+1} = y_{k-1} + 2 h f(y_k), begun with an Euler step."""
    start, previous, slope = ladder.start, ladder.previous, ladder.slope
    for i in range(m):
        previous[i] = start[i]
        y[i] = start[i] + h * ladder.first[i]
    for k in range(1, n):
        slope_at(scene, o, y, t + k * h, signals, slope, s)
        for i in range(m):
            after = previous[i] + 2.0 * h * slope[i]
            previous[i] = y[i]
            y[i] = after


@kernel
def _euler(scene, servo, o, y, t, h, n, signals, s):
    """n linearly implicit Euler steps."""
    if servo is not None:
        set_exponentials(servo, h)
    at = Scene(
        scene.tree,
        scene.floating,
        scene.gravity,
        servo,
        scene.gear,
        scene.pd,
        scene.law,
        scene.armature,
        scene.friction,
        scene.stops,
        scene.points,
        scene.point_bodies,
        scene.ground,
        scene.push,
        scene.push_rows,
    )
    for k in range(n):
        inputs(signals, t + (k + 1) * h)
        solve_step(
            at,
            at.points,
            at.push,
            o,
            y,
            t + k * h,
            None,
            signals.tau,
            signals.drive,
            h,
            h,
            s.W,
            s.Z,
            s.C,
            s.F,
        )
        advance(
            at,
            at.servo,
            at.gear,
            at.points,
            at.floating,
            o,
            y,
            None,
            signals.tau,
            signals.drive,
            h,
            h,
            1.0,
            s.W,
            s.Z,
            s.C,
        )


@inline
def set_exponentials(servo, h):
    """What is left of currents and filtered speeds after a step h [s], and the currents' mean."""
    for i in range(len(servo)):
        servo[i, DECAY] = servo[i, MEAN] = servo[i, FADE] = 0.0
        if servo[i, IND] > 0.0:
            z = h * servo[i, RES] / servo[i, IND]
            servo[i, DECAY] = exp(-z)
            servo[i, MEAN] = (1.0 - servo[i, DECAY]) / z
            if z < 1e-3:  # the difference loses digits
                servo[i, MEAN] = 1.0 - z * (0.5 - z * (1.0 / 6.0 - z * (1.0 / 24.0)))
        if servo[i, FILTER] > 0.0:
            servo[i, FADE] = exp(-h / servo[i, FILTER])


@inline
def _neville(implicit, y, j, table, m):
    """Add column j to the scheme: table[0] becomes the new best value, table[1] the one of an order less."""
    for i in range(m):
        table[j, i] = y[i]
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
def _accept(implicit, o, plan, y, table, start):
    """The best values; counters and the watch on chatter stay as they were."""
    for i in range(_smooth(implicit, o, plan)):
        y[i] = table[0, i]
    for i in range(o.increment, o.passes):
        y[i] = start[i]


@inline
def _choose(ladder, pace, j, h, length, rejected):
    """Order and step of least work by distance, after j + 1 columns were enough."""
    work, wanted = ladder.work, ladder.wanted
    best = j
    if j > 1 and work[j - 1] * min(wanted[j], length) < LOWER * work[j] * min(wanted[j - 1], length):
        best = j - 1
    step = wanted[best]
    if best == j and not rejected and j + 2 < LONGEST:
        if j < 2 or work[j] * min(wanted[j - 1], length) < HIGHER * work[j - 1] * min(wanted[j], length):
            best = j + 1
            step = wanted[j] * work[j + 1] / work[j]
    if rejected:
        step = min(step, h)
    pace[COLUMNS] = max(best + 1, 2)
    if h < length or step < h:
        pace[STEP] = step
