"""DOP853, the explicit Runge-Kutta pair of order 8 by Dormand and Prince, with error control and dense output.

Coefficients, error estimate, interpolation and step size after E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary
Differential Equations I, 2nd edition, sections II.4, II.6 and II.10.  The step follows the error by a PI controller
(E. Hairer, G. Wanner, II, section IV.2): without its integral part a quarter of a chaotic arm's steps are rejected,
with it a tenth.
"""

from .derivative import derivative
from .jit import inline, kernel
from .knots import inputs
from .lanes import sqrt
from .layout import ENERGIES, METER
from .pace import EVALUATIONS, LAST, REJECTED, SINCE, STEP, STEPS, UNTIL, in_time, meters, root, scaled, unit_quaternion
from .tableau import E3, E5, NODES, WEIGHTS, D

STAGES = 12
# Rows of the scratch `stages`, as long as the state; the first sixteen are slopes.
END = 12  # slope at the end of the last step
DENSE = 13  # 3: further slopes, for the interpolation
SPARE = 16  # slope at a state between, for what is derived from it
START = 17  # state at the start of the last step
STOP = 18  # state at its end, kept while states between are recorded
COEFFICIENTS = 19  # 4: of the interpolation
ROWS = 23
SAFETY, LEAST, MOST = 0.8, 0.333, 6.0  # of the step's factor
BETA = 0.04  # share of the last error in it


@kernel
def _evaluate(first, last, scene, o, plan, y, t, h, stages, signals, pace, s):
    """Slopes of the stages first ... last of a step h from t, and what is derived at the last, in y.

    A stage's state is the step's start and a weighted sum of the slopes before it, at END the step's end, at SPARE
    y.  One loop for all of them, since the derivative, which is large, is merged into it.
    """
    n, start = plan.integrated, stages[START]
    for k in range(first, last + 1):
        if k != SPARE:
            for i in range(n):
                y[i] = start[i]
            for j in range(k):
                if WEIGHTS[k, j] != 0.0:
                    c = h * WEIGHTS[k, j]
                    for i in range(n):
                        y[i] += c * stages[j, i]
            if k == END:
                unit_quaternion(scene.floating, o, y)
        inputs(signals, min(t + NODES[k] * h, pace[UNTIL]))
        derivative(
            scene,
            scene.points,
            scene.push,
            scene.floating,
            o,
            y,
            pace[SINCE],
            0.0,
            stages[k],
            signals.tau,
            signals.drive,
            s.W,
            s.Z,
            s.C,
            s.F,
        )
        pace[EVALUATIONS] += 1.0


@inline
def renew_slope(scene, o, plan, y, t, stages, signals, pace, s):
    """The slope at the start of the next step, after an event."""
    _evaluate(SPARE, SPARE, scene, o, plan, y, t, 0.0, stages, signals, pace, s)
    for i in range(o.voltage):
        stages[END, i] = stages[SPARE, i]


@kernel
def dop853(scene, o, plan, y, t, length, stages, signals, pace, s):
    """Take one step of at most `length` [s] from t; y moves on, stages[END] holds its slope before and after.

    Returns the step, 0 if the error control asks for one too small.
    """
    rejected = False
    start = stages[START]
    for i in range(o.voltage):
        start[i] = y[i]
        stages[0, i] = stages[END, i]
    while True:
        h = in_time(pace[STEP], length)
        _evaluate(1, END, scene, o, plan, y, t, h, stages, signals, pace, s)
        error = h * _error(scene.servo, o, plan, start, y, stages)
        if error <= 1.0:
            pace[STEPS] += 1.0
            factor = SAFETY * root(pace[LAST], 1.0 / BETA) / root(error, 1.0 / (0.125 - 0.2 * BETA))
            factor = max(LEAST, min(1.0 if rejected else MOST, factor))
            pace[LAST] = max(error, 1e-4)
            if h < length or factor < 1.0:
                pace[STEP] = h * factor
            return h
        rejected = True
        pace[REJECTED] += 1.0
        pace[STEP] = h * max(LEAST, min(1.0, SAFETY / root(error, 8)))
        if not pace[STEP] > plan.least_step:
            for i in range(o.voltage):
                y[i] = start[i]
            return 0.0


@inline
def record_within(scene, o, plan, signals, y, t, h, end, record, stages, channels, out, s):
    """Record what lies within the last step, from t over h, before grid step `end`; return the next record."""
    if record * plan.per_sample >= end or record * plan.per_sample * plan.h >= t + h:
        return record
    _prepare_dense(scene, o, plan, y, t, h, stages, signals, s.pace, s)
    derived = False
    for j in range(len(channels)):
        derived = derived | (channels[j] >= o.voltage)
    while record * plan.per_sample < end and record * plan.per_sample * plan.h < t + h:
        at = record * plan.per_sample * plan.h
        _interpolate(scene, o, plan, y, h, (at - t) / h, stages)
        if derived:
            _evaluate(SPARE, SPARE, scene, o, plan, y, at, 0.0, stages, signals, s.pace, s)
        for j in range(len(channels)):
            out[record, j] = y[channels[j]]
        record += 1
    for i in range(o.increment):
        y[i] = stages[STOP, i]
    return record


@inline
def _prepare_dense(scene, o, plan, y, t, h, stages, signals, pace, s):
    """Fill what interpolates the last step, from t over h [s], and keep its end."""
    for i in range(o.increment):
        stages[STOP, i] = y[i]
    _evaluate(DENSE, DENSE + 2, scene, o, plan, y, t, h, stages, signals, pace, s)
    for k in range(4):
        for i in range(plan.integrated):
            total = 0.0
            for j in range(SPARE):
                total += D[k, j] * stages[j, i]
            stages[COEFFICIENTS + k, i] = h * total


@inline
def _interpolate(scene, o, plan, y, h, x, stages):
    """The state at the fraction x of the last step, of order 7."""
    u = 1.0 - x
    for i in range(plan.integrated):
        a = stages[START, i]
        d = stages[STOP, i] - a
        b = h * stages[0, i] - d
        c = d + (d - h * (stages[END, i] + stages[0, i]))
        e = stages[COEFFICIENTS, i]
        f = stages[COEFFICIENTS + 1, i] + u * (stages[COEFFICIENTS + 2, i] + x * stages[COEFFICIENTS + 3, i])
        y[i] = a + x * (d + u * (b + x * (c + u * (e + x * f))))
    unit_quaternion(scene.floating, o, y)


@inline
def _error(servo, o, plan, start, y, stages):
    """The combined estimate of both embedded methods over the tolerance, of the worst component, by the step."""
    worst5 = worst3 = 0.0
    for k in range(o.energy + meters(servo)):
        i = k
        if k >= o.energy:
            i = o.energy + ENERGIES * (k - o.energy) + METER
        e5 = e3 = 0.0
        for j in range(STAGES):
            e5 += E5[j] * stages[j, i]
            e3 += E3[j] * stages[j, i]
        if not abs(e5) < 1e300:
            return 1e300
        worst5 = max(worst5, scaled(plan, e5, start[i], y[i]))
        worst3 = max(worst3, scaled(plan, e3, start[i], y[i]))
    if worst5 == 0.0:
        return 0.0
    return worst5 * worst5 / sqrt(worst5 * worst5 + 0.01 * worst3 * worst3)
