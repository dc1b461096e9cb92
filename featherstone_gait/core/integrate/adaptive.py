"""A whole simulation with error control.

The steps end on controller ticks, where pushes begin and end, and on the knots of torques and of references that are
followed at every instant; in between they are free.  Those of the extrapolation also end on records, which lie anywhere
within a step of the explicit pair.
"""

from ..compile.jit import entry, inline
from ..compile.optional import any_present
from ..compile.outside import read_now
from ..effects.actuator import controller_of
from ..effects.controller import apply_delayed
from ..effects.pair import FULL
from ..effects.push import EVENT_MARGIN, next_edge
from ..step.depth import watch_depth
from ..step.pace import (
    ATTEMPTS,
    EVALUATIONS,
    EVENT,
    GRID,
    INSIDE,
    MARK,
    NEXT,
    PACE,
    REJECTED,
    SINCE,
    STEP,
    STEPS,
    UNTIL,
)
from ..step.pool import longest_step, renew_pool
from ..step.program import writes_torques
from ..step.signals import next_knot, time_of
from ..step.sweep import first_contact, keep_start, take_back
from ..step.terrain import longest_over
from ..tree.coupling import follow
from .integrator import (
    begin_interval,
    begin_run,
    ends_on_records,
    looks_ahead,
    record_within,
    take_adaptive_step,
    take_up_again,
)
from .rollout import TOO_COSTLY, TOO_SMALL, inspect, record, tick

STALLED = 5000.0  # attempts at steps ...
PROGRESS, SHARE = 5e-7, 1e-7  # ... that must bring a run on by so much [s], or by that share of its duration


@entry
def rollout_adaptive(run, y, out):
    """Run the scene; out (samples, channels) takes y[run.channels] every plan.per_sample grid steps of plan.h.

    Returns whether the run has ended; one that has paused goes on, to the same bits, when called with the same again.
    """
    plan, offsets, pace = run.plan, run.offsets[0], run.work.pace
    most = y[offsets.step_control + STEPS] + y[offsets.step_control + REJECTED] + plan.budget
    k, dead, paused = int(pace[GRID]) - 1, False, pace[GRID] > 0.0
    if not paused:
        k, dead = 0, _begin(run, y)
    elif pace[INSIDE] < 0.0:  # between two intervals
        paused, pace[GRID] = False, 0.0
    while True:
        if not paused:
            if k % plan.per_tick == 0 and k < plan.steps:
                tick(run, k, time_of(plan, k), y)
            elif k < plan.steps:
                apply_delayed(run.scene.firmware.delay, run.scene, offsets, y, k % plan.per_tick)
            if k % plan.per_sample == 0:
                record(run, y, k // plan.per_sample, out)
            if k == plan.steps or dead:
                break
        sampled = any_present(controller_of(run.scene.actuator), writes_torques(run.signals.program))
        end = _end(sampled, run.scene.firmware.delay, ends_on_records(run.work), plan, k)
        dead = _cross(run, y, k, end, most, out)
        if pace[GRID] > 0.0:
            return False
        k, paused = end, False
        if pace[EVALUATIONS] >= plan.pause and k < plan.steps and not dead:
            pace[GRID], pace[INSIDE] = k + 1.0, -1.0
            return False
    for i in range(PACE):
        y[offsets.step_control + i] = pace[i]
    first = k // plan.per_sample + 1
    if dead and k > 0:
        first = min(first, int(pace[NEXT]))
    for m in range(first, len(out)):  # a run that ended early stays at its last state
        record(run, y, m, out)
    return True


@inline
def _begin(run, y):
    """Take up the state; return whether it is none to begin from."""
    for i in range(len(run.good)):
        run.good[i] = y[i]
    for i in range(PACE):
        run.work.pace[i] = y[run.offsets[0].step_control + i]
    run.work.pace[ATTEMPTS], run.work.pace[MARK] = 0.0, -1e300
    renew_pool(run.scene.pairs, run, y, run.plan.h, True)
    begin_run(run.work, run)
    return inspect(run, time_of(run.plan, 0), y)


@inline
def _end(sampled, delay, ends, plan, k):
    """Return the grid step at which the next interval ends."""
    end = plan.steps
    if ends is not None:
        end = min(end, (k // plan.per_sample + 1) * plan.per_sample)
    if sampled is not None:
        end = min(end, (k // plan.per_tick + 1) * plan.per_tick)
    if delay is not None:  # the next step at which delayed voltages are applied
        due = k - k % plan.per_tick + delay.shift
        if due > k:
            end = min(end, due)
    return end


@inline
def _cross(run, y, k, end, most, out):
    """Step from grid step k to `end`, but not beyond `most` steps; return whether the run has ended."""
    plan, pace, u = run.plan, run.work.pace, run.signals
    t = time_of(plan, k)
    length = time_of(plan, end) - t
    done, until, next_record = 0.0, 0.0, k // plan.per_sample + 1
    if pace[GRID] > 0.0:
        done, until, next_record = pace[INSIDE], pace[EVENT], int(pace[NEXT])
        pace[GRID] = 0.0
    pace[NEXT] = next_record
    while done < length:
        if done >= until:
            event = _next_event(run.scene.push, u.torques, u.continuous, u.reference, t + done)
            until = min(length, event - t)
            if until - done < 4.0 * EVENT_MARGIN:  # what rounding leaves here would end before it begins
                done = until
                y[run.offsets[0].end_time] = t + done
                continue
            pace[SINCE], pace[UNTIL] = t + done + EVENT_MARGIN, t + until - 2.0 * EVENT_MARGIN
            begin_interval(run.work, run, y, t + done)
        longest = longest_step(run.scene.pairs, run, y, until - done, looks_ahead(run.work))
        if longest < 0.0:
            y[run.offsets[0].status] = FULL
            return True
        longest = min(longest, longest_over(run.scene.contact, run, y, until - done, 4.0 * plan.least_step))
        keep_start(run.scene.pairs, run, y)
        h = take_adaptive_step(run.work, run, y, t + done, min(longest, until - done))
        follow(run.scene.coupling, run.offsets[0], y)
        met = first_contact(run.scene.pairs, run, y, h)
        if met < 1.0 and met * h > plan.least_step:  # a contact lies within the step: end it there
            take_back(run.scene.pairs, run, y)
            take_up_again(run.work, run, y, t + done)
            pace[STEP] = met * h
            pace[REJECTED] += 1.0
            if pace[STEPS] + pace[REJECTED] >= most:
                y[run.offsets[0].status] = TOO_COSTLY
                return True
            continue
        next_record = record_within(run.work, run, y, (t + done, h, end), next_record, out)
        pace[NEXT] = next_record
        done = until if h >= until - done else done + h
        y[run.offsets[0].end_time] = t + done
        if watch_depth(run.work, run, y, t + done, False):
            return True
        if ends_on_records(run.work) is None or done >= length:  # no error is accepted that is not finite
            if inspect(run, t + done, y):
                return True
        if h == 0.0 or not _gets_on(plan, pace, t + done):
            y[run.offsets[0].status] = TOO_SMALL
            return True
        if pace[STEPS] + pace[REJECTED] >= most:
            y[run.offsets[0].status] = TOO_COSTLY
            return True
        if read_now(run.stop) != 0:
            return True
        if pace[EVALUATIONS] >= plan.pause and done < length:
            pace[GRID], pace[INSIDE], pace[EVENT] = k + 1.0, done, until
            return False
    return False


@inline
def _gets_on(plan, pace, now):
    """Return False if the last `STALLED` attempts have brought a run to almost no later time than before.

    That is how steps end before a posture in which the mass matrix is singular: they shrink with the distance to it.
    """
    attempts = pace[STEPS] + pace[REJECTED]
    if attempts < pace[ATTEMPTS]:
        return True
    since, pace[ATTEMPTS], pace[MARK] = pace[MARK], attempts + STALLED, now
    return now - since > min(PROGRESS, SHARE * plan.steps * plan.h)


@inline
def _next_event(push, torques, continuous, reference, now):
    """Return the time of the next edge of a push or knot of a continuous signal [s]."""
    event = 1e300
    if push is not None:
        event = min(event, next_edge(push, now))
    if torques is not None:
        event = min(event, next_knot(torques, now))
    if continuous is not None and reference is not None:
        event = min(event, next_knot(reference, now))
    return event
