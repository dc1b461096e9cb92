"""References and torques over time: piecewise cubics between knots, held before the first and after the last."""

from typing import NamedTuple

import numpy as np

from ..compile.jit import entry, inline, kernel
from ..compile.structure import structure
from ..effects.push import EVENT_MARGIN  # a tick that falls on a knot sees what begins there
from .program import Program

GAUSS = 0.28867513459481287  # 1 / sqrt(12): nodes of Gauss's rule of two points, off the middle of an interval
ROUNDING = 4e-16  # of a time


@structure
class Knots(NamedTuple):
    """A signal of n components."""

    times: np.ndarray  # (k + 1,) [s], rising
    cubics: np.ndarray  # (k, n, 4): value = c0 + s (c1 + s (c2 + s c3)), s the time since the knot
    period: float  # of a cyclic signal [s], 0 otherwise

    SHARED = ("times", "period")


@structure
class Signals(NamedTuple):
    """Inputs from outside, and the arrays with their present values."""

    reference: Knots | None
    drive: np.ndarray  # (n, 2) reference and its rate
    torques: Knots | None
    torque_values: np.ndarray | None  # (n, 2)
    tau: np.ndarray | None  # (n,) [N m]
    samples: np.ndarray | None  # (ticks, n, 2) what `drive` is to be at each tick, in place of `reference`
    noise: np.ndarray | None  # (ticks, n, 2) added to measured angles [rad] and to voltages [V] at each tick
    continuous: bool | None  # True where the servo follows the reference at every instant, None where it samples it
    program: Program | None = None  # what acts on what sampled controllers follow


@inline
def time_of(plan, k):
    """Return the time of the grid step k of a run [s], counted from where the run first began."""
    return plan.offset + (plan.first + k) * plan.h


@kernel
def evaluate(knots, t, out):
    """Fill out (n, 2) with value and rate [1/s] at the time t."""
    k, turn, _, _ = _piece(knots, t)
    _fill(knots, k, t - turn, out)


@kernel
def _piece(knots, t):
    """Return which cubic is valid at t, when the cycle began, and from when until when the cubic is valid [s]."""
    times, turn = knots.times, 0.0
    last = len(times) - 1
    if knots.period > 0.0:
        turn = np.floor((t - times[0]) / knots.period) * knots.period
    t = t - turn
    k, high = 0, last
    while high - k > 1:
        middle = (k + high) // 2
        if times[middle] <= t:
            k = middle
        else:
            high = middle
    begin, end = times[k] + turn, times[k + 1] + turn
    if knots.period == 0.0 and t < times[0]:
        begin, end = -1e300, times[0]
    if knots.period == 0.0 and t >= times[last]:
        begin, end = times[last], 1e300
    return k, turn, begin, end


@inline
def _fill(knots, k, t, out):
    """Fill out (n, 2) with value and rate [1/s] of the cubic k at a time t of the first cycle; outside it is held."""
    times = knots.times
    inside = times[0] <= t <= times[len(times) - 1]
    s = _since(knots, k, t)
    for i in range(len(out)):
        b, c, d = knots.cubics[k, i, 1], knots.cubics[k, i, 2], knots.cubics[k, i, 3]
        out[i, 0] = _value(knots, k, i, s)
        rate = b + s * (2.0 * c + s * (3.0 * d))
        if inside:
            out[i, 1] = rate
        else:
            out[i, 1] = 0.0


@inline
def _since(knots, k, t):
    return min(max(t, knots.times[0]), knots.times[len(knots.times) - 1]) - knots.times[k]


@inline
def _value(knots, k, i, s):
    a, b, c, d = knots.cubics[k, i, 0], knots.cubics[k, i, 1], knots.cubics[k, i, 2], knots.cubics[k, i, 3]
    return a + s * (b + s * (c + s * d))


@kernel
def _over_step(knots, t, h, at, out):
    """Fill out (n, 2) with value and rate at the time `at` of the step h from t [s], or with the mean if it has knots.

    At a knot where the value jumps, a step that ends there takes what was before, and one that begins there what
    comes after.
    """
    k, turn, start, end = _piece(knots, t + 0.5 * h)
    _fill(knots, k, at - turn, out)
    if t + EVENT_MARGIN < start or end + EVENT_MARGIN < t + h:
        _average(knots, t, t + h, out)


@kernel
def _average(knots, start, end, out):
    """Replace the values in out (n, 2) by their means from start to end [s], by Gauss's rule between knots.

    The means are summed up from the values that are there, so that a constant stays what it is.  Rates are zero.
    """
    for i in range(len(out)):
        out[i, 1] = out[i, 0]
    t = start
    while t < end:
        least = t + EVENT_MARGIN + ROUNDING * abs(t)  # each pass gets on
        k, turn, _, until = _piece(knots, least)
        until = min(max(until, least), end)
        weight = 0.5 * (until - t) / (end - start)
        for node in (0.5 - GAUSS, 0.5 + GAUSS):
            s = _since(knots, k, t + node * (until - t) - turn)
            for i in range(len(out)):
                out[i, 0] += weight * (_value(knots, k, i, s) - out[i, 1])
        t = until
    for i in range(len(out)):
        out[i, 1] = 0.0


@kernel
def next_knot(knots, t):
    """Return the time of the first knot after t [s]."""
    times = knots.times
    turns = 0.0
    if knots.period > 0.0:
        turns = np.floor((t + EVENT_MARGIN - times[0]) / knots.period) * knots.period
    k, high = 0, len(times)
    while k < high:
        middle = (k + high) // 2
        if times[middle] + turns > t + EVENT_MARGIN:
            high = middle
        else:
            k = middle + 1
    if k < len(times):
        return times[k] + turns
    if knots.period > 0.0:
        return times[0] + turns + knots.period
    return 1e300


@inline
def inputs(signals, t):
    """Bring torques and the references of continuous servos to the time t, of a method that ends its steps at knots."""
    _inputs(signals.torques, signals.continuous, signals.reference, signals, t)


@inline
def _inputs(torques, continuous, reference, signals, t):
    if torques is not None:
        evaluate(torques, t, signals.torque_values)
        _take(signals)
    if continuous is not None and reference is not None:
        evaluate(reference, t, signals.drive)


@inline
def inputs_over_step(signals, t, h, at):
    """Bring both to the time `at` of the step h from t [s], or to their means over a step that has knots."""
    _inputs_over_step(signals.torques, signals.continuous, signals.reference, signals, t, h, at)


@inline
def _inputs_over_step(torques, continuous, reference, signals, t, h, at):
    if torques is not None:
        _over_step(torques, t, h, at, signals.torque_values)
        _take(signals)
    if continuous is not None and reference is not None:
        _over_step(reference, t, h, at, signals.drive)


@inline
def _take(signals):
    for i in range(len(signals.tau)):
        signals.tau[i] = signals.torque_values[i, 0]


@entry
def sample_ticks(knots, plan, done, out):
    """Fill out (ticks, n, 2) with what sampled controllers see from the grid step `done` of a run on."""
    for k in range(len(out)):
        evaluate(knots, time_of(plan, done + k * plan.per_tick) - plan.lag + EVENT_MARGIN, out[k])
