"""DOP853, the explicit Runge-Kutta pair of order 8 by Dormand and Prince, with error control and dense output.

Coefficients, error estimate, interpolation and step size after E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary
Differential Equations I, 2nd edition, sections II.4, II.6 and II.10.  The step follows the error by a PI controller
(E. Hairer, G. Wanner, II, section IV.2): without its integral part a quarter of a chaotic arm's steps are rejected,
with it a tenth.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import apart, inline
from ..compile.lanes import sqrt
from ..compile.optional import if_present
from ..compile.structure import structure
from ..effects.actuator import motor_of
from ..effects.energies import ENERGIES, METER
from ..effects.pair import flatten_bristles
from ..step.closure import project
from ..step.context import NEWTON_TOLERANCE, Scratch, Step
from ..step.derivative import derivative
from ..step.pace import EVALUATIONS, LAST, REJECTED, SINCE, SIZE, STEP, STEPS, UNTIL, in_time, meters, root, scaled
from ..step.signals import inputs, time_of
from ..tree.ball import unit_balls
from ..tree.coupling import follow
from ..tree.kinematics import unit_quaternions
from .integrator import (
    Integrator,
    begin_interval,
    ends_on_records,
    looks_ahead,
    record_within,
    scratch,
    take_adaptive_step,
    take_up_again,
)
from .rollout import record as write_record
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
SAFETY, LEAST_FACTOR, LARGEST_FACTOR = 0.8, 0.333, 6.0  # of the step's factor
BETA = 0.04  # share of the last error in it


@structure
class DormandPrince(NamedTuple):
    """Workspace."""

    scratch: Scratch
    stages: np.ndarray  # (ROWS, length up to the watched part)
    pace: np.ndarray  # (SIZE,)


@apart
def _evaluate(first, last, run, y, t, h):
    """Evaluate the slopes of stages first ... last of a step h from t, and what is derived at the last, in y.

    A stage's state is the step's start and a weighted sum of the slopes before it, at END the step's end, at SPARE
    y.  One loop for all of them, since the derivative, which is large, is merged into it.
    """
    scene, u, offsets, stages, pace = run.scene, run.signals, run.offsets[0], run.work.stages, run.work.pace
    n, start, scratch = run.plan.integrated, stages[START], run.work.scratch
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
                unit_quaternions(scene.floating, scene.trees, offsets.base_q, y)
                unit_balls(scene.balls, offsets.ball_q, y)
                project(scene.loops, scene, offsets, scratch, y)
        inputs(u, min(t + NODES[k] * h, pace[UNTIL]))
        since, act = pace[SINCE], scene.actuator
        at = Step(
            scene=scene, actuator=act, decay=None, offsets=offsets, y=y, tau=u.tau, drive=u.drive, predicted=None,
            t=since, span=0.0, h=0.0, h_implicit=0.0, theta=1.0, extrapolation_ratio=None,
            tolerance=NEWTON_TOLERANCE, W=scratch.W, Z=scratch.Z, C=scratch.C, F=scratch.F, N=scratch.N,
            pool=scratch.pool, part=None, rows=scratch.rows, closing=scratch.closing,
        )  # fmt: skip
        derivative(at, stages[k])
        pace[EVALUATIONS] += 1.0


@begin_interval.of(DormandPrince)
def _renew_slope(work, run, y, t):
    """Evaluate the slope at the start of the next step, after an event."""
    _renew(run, y, t)


take_up_again.of(DormandPrince)(lambda work, run, y, t: _renew(run, y, t))

@inline
def _renew(run, y, t):
    _evaluate(SPARE, SPARE, run, y, t, 0.0)
    for i in range(run.offsets[0].after_integrated):
        run.work.stages[END, i] = run.work.stages[SPARE, i]


@if_present()
def _flatten(pairs, run, y, t):
    """Turn bristles into the planes in which bodies touch, and find the slope at y again."""
    if run.work.scratch.pool.count[0] > 0:
        _renew(run, y, t)
        flatten_bristles(pairs, run.work.scratch, run.offsets[0], y, run.work.stages[END])


@take_adaptive_step.of(DormandPrince)
def dop853(work, run, y, t, length):
    """Take a step that meets the tolerance; stages[END] holds the slope at y before and after."""
    stages, pace, n = work.stages, work.pace, run.offsets[0].after_integrated
    rejected = False
    start = stages[START]
    _flatten(run.scene.pairs, run, y, t)
    for i in range(n):
        start[i] = y[i]
        stages[0, i] = stages[END, i]
    while True:
        h = in_time(min(pace[STEP], _longest(run.plan.second_run, pace)), length)
        _evaluate(1, END, run, y, t, h)
        error = max(h * _error(run, start, y), _left_open(run.scene.loops, run, y))
        if error <= 1.0:
            pace[STEPS] += 1.0
            factor = SAFETY * root(pace[LAST], 1.0 / BETA) / root(error, 1.0 / (0.125 - 0.2 * BETA))
            factor = max(LEAST_FACTOR, min(1.0 if rejected else LARGEST_FACTOR, factor))
            pace[LAST] = max(error, 1e-4)
            if h < length or factor < 1.0:
                pace[STEP] = h * factor
            return h
        rejected = True
        pace[REJECTED] += 1.0
        pace[STEP] = h * max(LEAST_FACTOR, min(1.0, SAFETY / root(error, 8)))
        if not pace[STEP] > run.plan.least_step:
            for i in range(n):
                y[i] = start[i]
            return 0.0


@if_present(0.0)
def _left_open(loops, run, y):
    """Return an infinite error of a step whose loops stay open, and do not count it."""
    missed = run.offsets[0].newton_iterations + 1
    error = 1e60 if y[missed] > 0.0 else 0.0
    y[missed] = 0.0
    return error


@inline
def _longest(second_run, pace):
    """Return the longest step [s]: a second run takes two where ticks let the first take one, or both were alike."""
    interval = pace[UNTIL] - pace[SINCE]
    return 0.5 * interval if second_run else interval


ends_on_records.of(DormandPrince)(lambda work: None)
looks_ahead.of(DormandPrince)(lambda work: None)


@record_within.of(DormandPrince)
def _record_within(work, run, y, interval, record, out):
    """Record states between the ends, by interpolation."""
    (t, h, end), plan, offsets = interval, run.plan, run.offsets[0]
    if record * plan.per_sample >= end or time_of(plan, record * plan.per_sample) >= t + h:
        return record
    stages, derived = work.stages, False
    for i in range(offsets.after_derived):
        stages[STOP, i] = y[i]  # the step's end
    _evaluate(DENSE, DENSE + 2, run, y, t, h)
    for k in range(4):
        for i in range(plan.integrated):
            total = 0.0
            for j in range(SPARE):
                total += D[k, j] * stages[j, i]
            stages[COEFFICIENTS + k, i] = h * total
    for j in range(len(run.channels)):
        derived = derived | (run.channels[j] >= offsets.after_integrated)
    while record * plan.per_sample < end and time_of(plan, record * plan.per_sample) < t + h:
        at = time_of(plan, record * plan.per_sample)
        _interpolate(run, y, h, (at - t) / h)
        _close(run.scene.loops, run, y, at)
        if derived:
            _evaluate(SPARE, SPARE, run, y, at, 0.0)
        follow(run.scene.coupling, offsets, y)
        write_record(run, y, record, out)
        record += 1
    for i in range(offsets.after_derived):
        y[i] = stages[STOP, i]
    return record


@if_present()
def _close(loops, run, y, t):
    """Close loops between the ends of a step, in factors that are found there."""
    _evaluate(SPARE, SPARE, run, y, t, 0.0)
    project(loops, run.scene, run.offsets[0], run.work.scratch, y)


@inline
def _interpolate(run, y, h, x):
    """Fill y with the state at the fraction x of the last step, of order 7."""
    stages, u = run.work.stages, 1.0 - x
    for i in range(run.plan.integrated):
        a = stages[START, i]
        d = stages[STOP, i] - a
        b = h * stages[0, i] - d
        c = d + (d - h * (stages[END, i] + stages[0, i]))
        e = stages[COEFFICIENTS, i]
        f = stages[COEFFICIENTS + 1, i] + u * (stages[COEFFICIENTS + 2, i] + x * stages[COEFFICIENTS + 3, i])
        y[i] = a + x * (d + u * (b + x * (c + u * (e + x * f))))
    unit_quaternions(run.scene.floating, run.scene.trees, run.offsets[0].base_q, y)
    unit_balls(run.scene.balls, run.offsets[0].ball_q, y)


@inline
def _error(run, start, y):
    """Return the combined estimate of both embedded methods over the tolerance, of the worst component, by the step."""
    stages, offsets = run.work.stages, run.offsets[0]
    worst5 = worst3 = 0.0
    for k in range(offsets.after_controlled + meters(motor_of(run.scene.actuator))):
        i = k
        if k >= offsets.after_controlled:
            i = offsets.energy + ENERGIES * (k - offsets.after_controlled) + METER
        e5 = e3 = 0.0
        for j in range(STAGES):
            e5 += E5[j] * stages[j, i]
            e3 += E3[j] * stages[j, i]
        if not abs(e5) < 1e300:
            return 1e300
        worst5 = max(worst5, scaled(run.plan, e5, start[i], y[i]))
        worst3 = max(worst3, scaled(run.plan, e3, start[i], y[i]))
    if worst5 == 0.0:
        return 0.0
    return worst5 * worst5 / sqrt(worst5 * worst5 + 0.01 * worst3 * worst3)


def _workspace(sizes, zeros):
    stages = zeros((ROWS, int(sizes.offsets["after_derived"])))
    return DormandPrince(scratch(sizes, zeros), stages, zeros(SIZE))


DOP853 = Integrator("dop853", 8, _workspace, adaptive=True, rtol=1e-7, soft=True)
