"""A whole simulation with error control: the steps end on controller ticks and records and are free in between."""

from .dormand_prince import dop853, slope_at
from .extrapolation import extrapolate, first_slope
from .jit import entry, inline, kernel
from .pace import PACE
from .rollout import TOO_SMALL, inspect, tick


@kernel
def rollout(scene, o, plan, signals, y, s, channels, out):
    """Run the scene; out (samples, channels) takes y[channels] every plan.per_sample grid steps of plan.h."""
    for i in range(len(s.good)):
        s.good[i] = y[i]
    for i in range(PACE):
        s.pace[i] = y[o.pace + i]
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
        end = _end(scene.servo, plan, k)
        dead = _cross(scene, o, plan, signals, y, t, end * plan.h - t, s.stages, s.ladder, s)
        k = end
    for i in range(PACE):
        y[o.pace + i] = s.pace[i]
    for j in range(len(channels)):  # a run that ended early stays at its last state
        for m in range(k // plan.per_sample + 1, len(out)):
            out[m, j] = y[channels[j]]


@inline
def _end(servo, plan, k):
    """Grid step at which the next interval ends: a record, or a tick of controllers."""
    end = min(plan.steps, (k // plan.per_sample + 1) * plan.per_sample)
    if servo is not None:
        end = min(end, (k // plan.per_tick + 1) * plan.per_tick)
    return end


@inline
def _cross(scene, o, plan, signals, y, t, length, stages, ladder, s):
    """Step through an interval; return whether the run has ended."""
    done = 0.0
    if stages is not None:
        slope_at(scene, o, y, t, signals, stages[0], s)
    if ladder is not None:
        first_slope(ladder.implicit, scene, o, y, t, signals, ladder, s)
    while done < length:
        h = 0.0
        if stages is not None:
            h = dop853(scene, o, plan, y, t + done, length - done, stages, signals, s.pace, s)
        if ladder is not None:
            h = extrapolate(scene, o, plan, y, t + done, length - done, ladder, signals, s.pace, s)
        done = length if h >= length - done else done + h
        if inspect(scene, o, plan, t + done, y, s.good):
            return True
        if h == 0.0:
            y[o.status] = TOO_SMALL
            return True
    return False


@entry
def rollout_adaptive(scene, o, plan, signals, y, scratch, channels, out):
    rollout(scene, o[0], plan, signals, y, scratch, channels, out)
