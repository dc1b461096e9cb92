"""A whole simulation with error control.

The steps end on controller ticks and are free in between; those of the extrapolation also end on records, which lie
anywhere within a step of the explicit pair.
"""

from .dormand_prince import END, STOP, dop853, interpolate, prepare_dense, slope_at
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
        end = _end(scene.servo, s.ladder, plan, k)
        dead = _cross(scene, o, plan, signals, y, k, end, s.stages, s.ladder, channels, out, s)
        k = end
    for i in range(PACE):
        y[o.pace + i] = s.pace[i]
    for j in range(len(channels)):  # a run that ended early stays at its last state
        for m in range(k // plan.per_sample + 1, len(out)):
            out[m, j] = y[channels[j]]


@inline
def _end(servo, ladder, plan, k):
    """Grid step at which the next interval ends."""
    end = plan.steps
    if ladder is not None:
        end = min(end, (k // plan.per_sample + 1) * plan.per_sample)
    if servo is not None:
        end = min(end, (k // plan.per_tick + 1) * plan.per_tick)
    return end


@inline
def _cross(scene, o, plan, signals, y, k, end, stages, ladder, channels, out, s):
    """Step from grid step k to `end`; return whether the run has ended."""
    t, done = k * plan.h, 0.0
    length = end * plan.h - t
    record = k // plan.per_sample + 1
    if stages is not None:
        slope_at(scene, o, y, t, signals, stages[END], s)
    if ladder is not None:
        first_slope(ladder.implicit, scene, o, y, t, signals, ladder, s)
    while done < length:
        h = 0.0
        if stages is not None:
            h = dop853(scene, o, plan, y, t + done, length - done, stages, signals, s.pace, s)
            record = _record_within(scene, o, plan, signals, y, t + done, h, end, record, stages, channels, out, s)
        if ladder is not None:
            h = extrapolate(scene, o, plan, y, t + done, length - done, ladder, signals, s.pace, s)
        done = length if h >= length - done else done + h
        if inspect(scene, o, plan, t + done, y, s.good):
            return True
        if h == 0.0:
            y[o.status] = TOO_SMALL
            return True
    return False


@inline
def _record_within(scene, o, plan, signals, y, t, h, end, record, stages, channels, out, s):
    """Record what lies within the step from t over h, before grid step `end`; return the next record."""
    if record * plan.per_sample >= end or record * plan.per_sample * plan.h >= t + h:
        return record
    prepare_dense(scene, o, plan, y, t, h, stages, signals, s.pace, s)
    derived = False
    for j in range(len(channels)):
        derived = derived | (channels[j] >= o.voltage)
    while record * plan.per_sample < end and record * plan.per_sample * plan.h < t + h:
        at = record * plan.per_sample * plan.h
        interpolate(scene, o, plan, y, h, (at - t) / h, stages)
        if derived:
            slope_at(scene, o, y, at, signals, stages[1], s)
        for j in range(len(channels)):
            out[record, j] = y[channels[j]]
        record += 1
    for i in range(o.voltage):
        y[i] = stages[STOP, i]
    slope_at(scene, o, y, t + h, signals, stages[END], s)
    return record


@entry
def rollout_adaptive(scene, o, plan, signals, y, scratch, channels, out):
    rollout(scene, o[0], plan, signals, y, scratch, channels, out)
