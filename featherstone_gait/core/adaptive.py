"""A whole simulation with error control.

The steps end on controller ticks, where pushes begin and end, and on the knots of torques and of references that are
followed at every instant; in between they are free.  Those of the extrapolation also end on records, which lie anywhere
within a step of the explicit pair.
"""

from numba import types
from numba.extending import overload

from .dormand_prince import dop853, record_within, renew_slope
from .extrapolation import Columns, begin_inputs, extrapolate, first_slope
from .jit import entry, inline, kernel
from .knots import AHEAD, next_knot
from .lanes import as_lanes
from .optional import viewed
from .pace import PACE, SINCE, UNTIL
from .push import next_edge
from .rollout import TOO_SMALL, inspect, tick


@kernel
def rollout(scene, o, plan, signals, y, s, columns, channels, out):
    """Run the scene; out (samples, channels) takes y[channels] every plan.per_sample grid steps of plan.h."""
    for i in range(len(s.good)):
        s.good[i] = y[i]
    for i in range(PACE):
        s.pace[i] = y[o.pace + i]
    if columns is not None:
        begin_inputs(signals, s.ladder)
    k, dead = 0, y[o.status] > 0.0
    while True:
        t = k * plan.h
        if k % plan.per_tick == 0 and k < plan.steps:
            tick(scene.servo, signals.reference, signals.samples, signals.noise, scene, o, signals, plan, k, t, y)
        if k % plan.per_sample == 0:
            for j in range(len(channels)):
                out[k // plan.per_sample, j] = y[channels[j]]
        if k == plan.steps or dead:
            break
        end = _end(scene.servo, columns, plan, k)
        dead = _cross(scene, o, plan, signals, y, k, end, s.stages, columns, channels, out, s)
        k = end
    for i in range(PACE):
        y[o.pace + i] = s.pace[i]
    for j in range(len(channels)):  # a run that ended early stays at its last state
        for m in range(k // plan.per_sample + 1, len(out)):
            out[m, j] = y[channels[j]]


@inline
def _end(servo, columns, plan, k):
    """Grid step at which the next interval ends."""
    end = plan.steps
    if columns is not None:
        end = min(end, (k // plan.per_sample + 1) * plan.per_sample)
    if servo is not None:
        end = min(end, (k // plan.per_tick + 1) * plan.per_tick)
    return end


@inline
def _cross(scene, o, plan, signals, y, k, end, stages, columns, channels, out, s):
    """Step from grid step k to `end`; return whether the run has ended."""
    t, done, until = k * plan.h, 0.0, 0.0
    length = end * plan.h - t
    record = k // plan.per_sample + 1
    while done < length:
        if done >= until:
            until = _next_event(scene.push, signals, t, done, length)
            s.pace[SINCE], s.pace[UNTIL] = t + done + AHEAD, t + until - 2.0 * AHEAD
            if stages is not None:
                renew_slope(scene, o, plan, y, t + done, stages, signals, s.pace, s)
            if columns is not None:
                first_slope(s.ladder.implicit, scene, o, y, t + done, signals, s.ladder, columns, s.pace)
        h = 0.0
        if stages is not None:
            h = dop853(scene, o, plan, y, t + done, until - done, stages, signals, s.pace, s)
            record = record_within(scene, o, plan, signals, y, t + done, h, end, record, stages, channels, out, s)
        if columns is not None:
            h = extrapolate(scene, o, plan, y, t + done, until - done, s.ladder, columns, signals, s.pace)
        done = until if h >= until - done else done + h
        if inspect(scene, o, plan, t + done, y, s.good):
            return True
        if h == 0.0:
            y[o.status] = TOO_SMALL
            return True
    return False


@inline
def _next_event(push, signals, t, done, length):
    """Time since t of the next edge of a push, or knot of what changes continuously, at most `length` [s]."""
    return min(length, _event_after(push, signals.torques, signals.continuous, signals.reference, t + done) - t)


@inline
def _event_after(push, torques, continuous, reference, now):
    event = 1e300
    if push is not None:
        event = min(event, next_edge(push, now))
    if torques is not None:
        event = min(event, next_knot(torques, now))
    if continuous is not None:
        if reference is not None:
            event = min(event, next_knot(reference, now))
    return event


def _columns(s):
    """The lanes of the extrapolation, None for the explicit pair."""
    ladder = s.ladder
    if ladder is None:
        return None
    return Columns(
        *(as_lanes(a) for a in (ladder.y, ladder.h, ladder.last, ladder.slope, ladder.first, ladder.previous)),
        *(viewed(a) for a in (ladder.drive, ladder.tau, ladder.servo, s.W, s.Z, s.C, s.F)),
    )


@overload(_columns)
def _overload_columns(s):
    if isinstance(s.types[s.fields.index("ladder")], types.NoneType):
        return lambda s: None
    return lambda s: Columns(
        as_lanes(s.ladder.y),
        as_lanes(s.ladder.h),
        as_lanes(s.ladder.last),
        as_lanes(s.ladder.slope),
        as_lanes(s.ladder.first),
        as_lanes(s.ladder.previous),
        as_lanes(s.ladder.drive),
        viewed(s.ladder.tau),
        viewed(s.ladder.servo),
        as_lanes(s.W),
        as_lanes(s.Z),
        as_lanes(s.C),
        as_lanes(s.F),
    )


@entry
def rollout_adaptive(scene, o, plan, signals, y, scratch, channels, out):
    """The workspaces in `scratch` are those of lanes where its ladder is not None."""
    rollout(scene, o[0], plan, signals, y, scratch, _columns(scratch), channels, out)
