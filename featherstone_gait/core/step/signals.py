"""References and torques over time: piecewise cubics between knots, held before the first and after the last."""

from typing import NamedTuple

import numpy as np

from ..compile.jit import entry, inline, kernel
from ..compile.structure import structure
from ..effects.push import EVENT_MARGIN  # a tick that falls on a knot sees what begins there
from .program import Program


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
    times = knots.times
    last = len(times) - 1
    if knots.period > 0.0:
        t = t - np.floor((t - times[0]) / knots.period) * knots.period
    inside = times[0] <= t <= times[last]
    t = min(max(t, times[0]), times[last])
    k = 0
    high = last
    while high - k > 1:
        middle = (k + high) // 2
        if times[middle] <= t:
            k = middle
        else:
            high = middle
    s = t - times[k]
    for i in range(len(out)):
        a, b, c, d = knots.cubics[k, i, 0], knots.cubics[k, i, 1], knots.cubics[k, i, 2], knots.cubics[k, i, 3]
        out[i, 0] = a + s * (b + s * (c + s * d))
        rate = b + s * (2.0 * c + s * (3.0 * d))
        if inside:
            out[i, 1] = rate
        else:
            out[i, 1] = 0.0


@kernel
def next_knot(knots, t):
    """Return the time of the first knot after t [s]."""
    times = knots.times
    turns = 0.0
    if knots.period > 0.0:
        turns = np.floor((t + EVENT_MARGIN - times[0]) / knots.period) * knots.period
    for k in range(len(times)):
        if times[k] + turns > t + EVENT_MARGIN:
            return times[k] + turns
    if knots.period > 0.0:
        return times[0] + turns + knots.period
    return 1e300


@inline
def inputs(signals, t):
    """Bring torques and the references of continuous servos to the time t."""
    _inputs(signals.torques, signals.continuous, signals.reference, signals, t)


@inline
def _inputs(torques, continuous, reference, signals, t):
    if torques is not None:
        evaluate(torques, t, signals.torque_values)
        for i in range(len(signals.tau)):
            signals.tau[i] = signals.torque_values[i, 0]
    if continuous is not None and reference is not None:
        evaluate(reference, t, signals.drive)


@entry
def sample_ticks(knots, plan, done, out):
    """Fill out (ticks, n, 2) with what sampled controllers see from the grid step `done` of a run on."""
    for k in range(len(out)):
        evaluate(knots, time_of(plan, done + k * plan.per_tick) - plan.lag + EVENT_MARGIN, out[k])
