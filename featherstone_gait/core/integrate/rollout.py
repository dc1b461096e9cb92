"""A whole simulation at fixed steps in one call: controller ticks, steps, watching for failure, recording."""

from ..compile.jit import entry, inline, kernel
from ..compile.lanes import any_lane, as_lanes, invert, select
from ..compile.optional import in_lanes, item
from ..compile.outside import read_now
from ..effects.actuator import controller_of
from ..effects.contact import above_ground
from ..effects.controller import apply_delayed, control_tick
from ..effects.pair import FULL, copy_where
from ..step.depth import watch_depth
from ..step.pool import renew_pool
from ..step.program import commanded, writes_torques
from ..step.signals import EVENT_MARGIN, evaluate, time_of
from ..tree.ball import ball_positions
from ..tree.coupling import follow
from ..tree.energy import center_of_floating
from ..tree.forest import base_of, joint_count
from ..tree.kinematics import quaternion_matrix
from .integrator import take_step, thetas

OK, FELL, DIVERGED, TOO_SMALL, TOO_COSTLY = 0, 1, 2, 3, 4
NEVER = -1e300  # a height below which no robot falls
TOO_FAST = 1e8  # sum of the sizes of speeds and of the base's position beyond which a run has diverged


def rollout(run, y, out):
    """Run the scene; out (samples, channels) takes y[run.channels] every plan.per_sample steps."""
    plan, offsets = run.plan, run.offsets[0]
    theta, steady = thetas(run.work, plan.theta, y[offsets.end_time])
    dead = y[offsets.status] > 0.0
    copy_where(None, None, offsets, y, run.good)
    for k in range(plan.steps + 1):
        t = time_of(plan, k)
        if k % plan.per_tick == 0 or k == plan.steps:
            dead = inspect(run, t, y)
            if k < plan.steps:  # the tick at the very end is the first of what goes on from here
                tick(run, k, t, y)
                _freeze_ended(dead, run, y)
        else:
            _between_ticks(run.scene.firmware.delay, dead, run, k, y)
        if k % plan.per_sample == 0:
            record(run, y, k // plan.per_sample, out)
        if k == plan.steps or read_now(run.stop) != 0 or not any_lane(invert(dead)):
            break
        if not renew_pool(run.scene.pairs, run, y, plan.h, k == 0):
            _end_full(dead, run, y)
            record(run, y, k // plan.per_sample, out)
            break
        take_step(run.work, run, y, t, theta)
        follow(run.scene.coupling, offsets, y)
        dead = watch_depth(run.work, run, y, time_of(plan, k + 1), dead)
        _freeze_ended(dead, run, y)
        theta = steady
    for m in range(k // plan.per_sample + 1, len(out)):  # a run that ended early stays at its last state
        record(run, y, m, out)


@inline
def record(run, y, m, out):
    """Fill row m of out (samples, channels) with y[run.channels]."""
    for j in range(len(run.channels)):
        out[m, j] = y[run.channels[j]]


@inline
def _end_full(dead, run, y):
    """End all runs that go on: more pairs are near than the pool has slots for."""
    status = run.offsets[0].status
    y[status] = select(dead, y[status], FULL + 0.0 * y[status])


@inline
def _freeze_ended(dead, run, y):
    """Keep a run that has ended at its last sound state."""
    if any_lane(dead):
        copy_where(dead, run.scene.pairs, run.offsets[0], run.good, y)


@inline
def tick(run, k, t, y):
    """Let sampled controllers act, at step k: they see the reference as it was a lag ago, of knots or samples."""
    _tick(controller_of(run.scene.actuator), run.signals.samples, run.signals.reference, run, k, t, y)
    _hold_torques(writes_torques(run.signals.program), run, k, t, y)


@inline
def _tick(controller, samples, reference, run, k, t, y):
    u, plan = run.signals, run.plan
    if controller is not None and (samples is not None or reference is not None):
        goal = u.drive
        if samples is not None:
            goal = samples[k // plan.per_tick]
        elif reference is not None:
            evaluate(reference, t - plan.lag + EVENT_MARGIN, goal)
        goal, noise = commanded(u.program, plan, k, y, goal), item(u.noise, k // plan.per_tick)
        period, delay = plan.per_tick * plan.h, run.scene.firmware.delay
        control_tick(controller, delay, run.scene, run.offsets[0], goal, noise, y, period)


@inline
def _hold_torques(present, run, k, t, y):
    """Let a program write the torques on the joints that stand until the next tick."""
    if present is not None:
        u = run.signals
        evaluate(u.reference, t + EVENT_MARGIN, u.drive)
        command = commanded(u.program, run.plan, k, y, u.drive)
        for i in range(len(command)):
            u.torques.cubics[0, i, 0] = command[i, 0]


@inline
def _between_ticks(delay, dead, run, k, y):
    """Apply delayed voltages that are due at step k, which is no tick."""
    if delay is not None:
        between_ticks(delay, run, k, y)
        _freeze_ended(dead, run, y)


@inline
def between_ticks(delay, run, k, y):
    """Apply delayed voltages that are due at step k, which is no tick, in runs that go on."""
    if delay is not None:
        apply_delayed(delay, run.scene, run.offsets[0], y, k % run.plan.per_tick)


@kernel
def inspect(run, t, y):
    """Give runs that failed their status and their last sound state; return which have failed."""
    offsets, good = run.offsets[0], run.good
    size = 0.0 * y[offsets.status]
    for i in range(offsets.q):
        size = size + abs(y[i])
    for i in range(offsets.q, offsets.base_qd):  # a wheel may turn for hours: only NaN and infinity count
        size = size + 0.0 * y[i]
    for i in range(offsets.base_qd, offsets.after_coordinates):
        size = size + abs(y[i])
    failed = select(size < TOO_FAST, OK + 0.0 * size, DIVERGED + 0.0 * size)
    fell = _fell(run.frames, run, offsets, y)
    failed = select(fell & (size < TOO_FAST), FELL + 0.0 * size, failed)
    failed = select(size == size, failed, DIVERGED + 0.0 * y[offsets.status])
    dead = y[offsets.status] > 0.0
    new = invert(dead) & (failed > 0.0)
    if any_lane(new & (failed == DIVERGED)):
        copy_where(new & (failed == DIVERGED), run.scene.pairs, offsets, good, y)
    y[offsets.status] = select(new, failed, y[offsets.status])
    y[offsets.end_time] = select(dead, y[offsets.end_time], t + 0.0 * y[offsets.end_time])
    copy_where(None, run.scene.pairs, offsets, y, good)
    return dead | new


@inline
def _fell(frames, run, offsets, y):
    """Return whether the center of mass is too low or the base tilted too far; False where no robot can fall."""
    fell = y[offsets.status] != y[offsets.status]
    if frames is not None:
        fell = _any_fell(run.scene.trees, frames, run, offsets, y)
    return fell


@inline
def _any_fell(trees, frames, run, offsets, y):
    if trees is None:
        plan = run.plan
        fell = _fallen(None, plan.min_height, plan.min_upright, plan.upright, frames, run.scene, offsets, y)
    else:
        fell = y[offsets.status] != y[offsets.status]
        for k in range(len(trees)):
            part = trees[k]
            if part.falls > 0:
                low = part.min_height + 0.0 * y[offsets.status]
                up = (part.upright[0], part.upright[1], part.upright[2])
                fell = fell | _fallen(part, low, part.min_upright, up, frames, run.scene, offsets, y)
    return fell


@inline
def _fallen(part, min_height, min_upright, up, frames, scene, offsets, y):
    """Return whether one robot has fallen."""
    base_q = base_of(True, part, y, offsets.base_q, 7)
    E = quaternion_matrix(base_q)
    fell = E[6] * up[0] + E[7] * up[1] + E[8] * up[2] < min_upright
    if any_lane(min_height > NEVER):
        q = y[offsets.q : offsets.q + joint_count(scene.trees, scene.tree)]
        ball_q = ball_positions(scene.balls, y, offsets.ball_q)
        center = center_of_floating(scene.tree, part, base_q, ball_q, q, frames)
        fell = fell | (above_ground(scene.contact, center) < min_height)
    return fell


rollout_one = entry(rollout)  # not by way of the kernel, which would be typed and lowered besides
_rollout = kernel(rollout)


@entry
def rollout_lanes(run, y, out):
    """Run eight at once: signals, workspace, y and out have a last axis of lanes."""
    _rollout(in_lanes(run), as_lanes(y), as_lanes(out))
