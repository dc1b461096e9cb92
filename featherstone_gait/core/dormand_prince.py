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
from .pace import EVALUATIONS, LAST, REJECTED, STEP, STEPS, in_time, meters, root, scaled, unit_quaternion
from .tableau import DENSE_A, DENSE_C, E3, E5, A, B, C, D

STAGES = 12
# Rows of the scratch `stages`, each of the length of what is integrated; the twelve slopes come first.
END = 12  # slope at the end of the last step
DENSE = 13  # 3: further slopes, for the interpolation
START = 16  # state at the start of the last step
STOP = 17  # state at its end, kept while states between are recorded
COEFFICIENTS = 18  # 4: of the interpolation
ROWS = 22
SAFETY, LEAST, MOST = 0.8, 0.333, 6.0  # of the step's factor
BETA = 0.04  # share of the last error in it


@kernel
def slope_at(scene, o, y, t, signals, slope, s):
    """The derivative at y and t, with what is derived from it: torques, forces and accelerations in y."""
    inputs(signals, t)
    derivative(
        scene,
        scene.points,
        scene.push,
        scene.floating,
        o,
        y,
        t,
        slope,
        signals.tau,
        signals.drive,
        s.W,
        s.Z,
        s.C,
        s.F,
    )


@kernel
def dop853(scene, o, plan, y, t, length, stages, signals, pace, s):
    """Take one step of at most `length` [s] from t; y moves on, stages[END] holds its slope before and after.

    Returns the step, 0 if the error control asks for one too small.
    """
    n, rejected = plan.integrated, False
    start = stages[START]
    for i in range(o.voltage):
        start[i] = y[i]
        stages[0, i] = stages[END, i]
    while True:
        h = in_time(pace[STEP], length)
        for k in range(1, STAGES):
            _sum(A[k], k, h, stages, start, y, n)
            slope_at(scene, o, y, t + C[k] * h, signals, stages[k], s)
        _sum(B, STAGES, h, stages, start, y, n)
        unit_quaternion(scene.floating, o, y)
        pace[EVALUATIONS] += STAGES
        error = h * _error(scene.servo, o, plan, start, y, stages)
        if error <= 1.0:
            slope_at(scene, o, y, t + h, signals, stages[END], s)
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


@kernel
def prepare_dense(scene, o, plan, y, t, h, stages, signals, pace, s):
    """Fill what interpolates the last step, from t over h [s], and keep its end."""
    n = plan.integrated
    for i in range(o.voltage):
        stages[STOP, i] = y[i]
    for k in range(3):
        _sum(DENSE_A[k], DENSE + k, h, stages, stages[START], y, n)
        slope_at(scene, o, y, t + DENSE_C[k] * h, signals, stages[DENSE + k], s)
    for k in range(4):
        for i in range(n):
            total = 0.0
            for j in range(START):
                total += D[k, j] * stages[j, i]
            stages[COEFFICIENTS + k, i] = h * total
    pace[EVALUATIONS] += 3.0


@kernel
def interpolate(scene, o, plan, y, h, x, stages):
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
def _sum(weights, count, h, stages, start, y, n):
    """y = start + h sum of the weighted slopes."""
    for i in range(n):
        y[i] = start[i]
    for j in range(count):
        if weights[j] != 0.0:
            c = h * weights[j]
            for i in range(n):
                y[i] += c * stages[j, i]


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
