"""A whole simulation in one call: controller ticks, steps, watching for failure, recording."""

from typing import NamedTuple

import numpy as np
from numba import types
from numba.extending import overload

from .advance import advance
from .contact import ground_height
from .controller import control_tick
from .extrapolation import Ladder
from .jit import entry, inline, kernel
from .knots import AHEAD, Knots, Signals, evaluate, inputs
from .lanes import any_lane, as_lanes, invert, select
from .layout import GN, GT
from .optional import item, viewed
from .runge_kutta import rk4_step
from .simtwo import simtwo_step
from .spatial import dot, load3
from .step import solve_step

OK, FELL, DIVERGED, TOO_SMALL = 0, 1, 2, 3
TOO_FAST = 1e8  # sum of the sizes of positions and velocities beyond which a run has diverged


class Plan(NamedTuple):
    """The course of a run in whole steps."""

    h: float  # step [s]
    theta: float  # 1: Euler, 1/2: midpoint, but for its first step
    steps: int
    per_tick: int  # steps of a controller tick
    per_sample: int  # steps between records
    lag: float  # from a reference to its effect [s]
    min_height: float  # of the base over the ground, along its normal [m]; below it the robot has fallen
    min_upright: float  # cosine of the base's tilt; below it the robot has fallen
    # Of integrators with error control, for which h is only the grid on which ticks and records lie:
    rtol: float = 0.0  # error allowed of a step, relative ...
    atol: float = 0.0  # ... and absolute [rad, m, and their rates; A]
    least_step: float = 0.0  # [s]
    integrated: int = 0  # how much of the state changes between ticks


class Scratch(NamedTuple):
    """What a step overwrites; None for what the integrator does not use."""

    W: np.ndarray  # workspace of the tree
    Z: np.ndarray  # joints
    C: np.ndarray  # contact points
    F: np.ndarray  # pushes and springs
    predicted: np.ndarray | None  # midpoint
    stages: np.ndarray | None  # rk4
    torques: np.ndarray | None  # simtwo
    good: np.ndarray  # the state at the last tick that was found sound
    ladder: Ladder | None = None  # extrapolation
    pace: np.ndarray | None = None  # integrators with error control


@kernel
def rollout(scene, o, plan, signals, y, scratch, channels, out):
    """Run the scene; out (samples, channels) takes y[channels] every per_sample steps."""
    good, (theta, steady) = scratch.good, _thetas(scratch.predicted, plan.theta, y[o.end])
    dead = y[o.status] > 0.0
    for i in range(len(good)):
        good[i] = y[i]
    for k in range(plan.steps + 1):
        t = k * plan.h
        if k % plan.per_tick == 0 or k == plan.steps:
            dead = inspect(scene, o, plan, t, y, good)
            if k < plan.steps:  # the tick at the very end is the first of what goes on from here
                tick(scene.servo, signals.reference, signals.samples, signals.noise, scene, o, signals, plan, k, t, y)
                keep(dead, good, y)
        if k % plan.per_sample == 0:
            for j in range(len(channels)):
                out[k // plan.per_sample, j] = y[channels[j]]
        if k == plan.steps or not any_lane(invert(dead)):
            break
        _step(scene, o, plan, theta, t, signals, y, scratch.predicted, scratch.stages, scratch.torques, scratch)
        keep(dead, good, y)
        theta = steady
    for j in range(len(channels)):  # a run that ended early stays at its last state
        for m in range(k // plan.per_sample + 1, len(out)):
            out[m, j] = y[channels[j]]


@inline
def _thetas(predicted, theta, end):
    """Of a run's first step and of the others: the midpoint rule begins with Euler's.

    By itself it would leave the stiff modes ringing of a start off their equilibrium; one step of first order damps
    them and costs no order (R. Rannacher, Finite element solution of diffusion problems with irregular data, Numerische
    Mathematik 43 (1984)).  A run that goes on where another ended, at a time `end` > 0 after its start, needs none.
    """
    if predicted is None:
        return theta, theta
    steady = theta + 0.0 * end
    return select(end > 0.0, steady, 1.0 + 0.0 * end), steady


@inline
def keep(dead, good, y):
    """A run that has ended stays at its last sound state."""
    if any_lane(dead):
        for i in range(len(good)):
            y[i] = select(dead, good[i], y[i])


@inline
def tick(servo, reference, samples, noise, scene, o, signals, plan, k, t, y):
    """The sampled controllers see the reference as it was a lag ago; it comes as knots or as samples at each tick."""
    if servo is not None:
        tick, period = k // plan.per_tick, plan.per_tick * plan.h
        if samples is not None:
            control_tick(o, scene.law, servo, samples[tick], item(noise, tick), y, period)
        if reference is not None:
            evaluate(reference, t - plan.lag + AHEAD, signals.drive)
            control_tick(o, scene.law, servo, signals.drive, item(noise, tick), y, period)


@inline
def _step(scene, o, plan, theta, t, signals, y, predicted, stages, torques, s):
    if stages is not None:
        rk4_step(scene, scene.floating, o, y, t, plan.h, stages, signals, s.W, s.Z, s.C, s.F)
    else:
        if torques is not None:
            simtwo_step(scene, o, y, t, plan.h, torques, s.W, s.Z, s.C, s.F)
        else:
            sub = theta * plan.h
            inputs(signals, t + plan.theta * plan.h)
            solve_step(
                scene,
                scene.points,
                scene.push,
                o,
                y,
                t,
                plan.h,
                predicted,
                signals.tau,
                signals.drive,
                plan.h,
                sub,
                s.W,
                s.Z,
                s.C,
                s.F,
            )
            advance(
                scene,
                scene.servo,
                scene.gear,
                scene.points,
                scene.floating,
                o,
                y,
                predicted,
                signals.tau,
                signals.drive,
                plan.h,
                sub,
                theta,
                s.W,
                s.Z,
                s.C,
            )


@kernel
def inspect(scene, o, plan, t, y, good):
    """Give runs that failed their status and their last sound state; return which have."""
    size = 0.0 * y[o.status]
    for i in range(o.current):
        size = size + abs(y[i])
    failed = select(size < TOO_FAST, OK + 0.0 * size, DIVERGED + 0.0 * size)
    failed = select(_fell(scene.floating, scene.ground, o, plan, y) & (size < TOO_FAST), FELL + 0.0 * size, failed)
    failed = select(size == size, failed, DIVERGED + 0.0 * y[o.status])
    dead = y[o.status] > 0.0
    new = invert(dead) & (failed > 0.0)
    if any_lane(new & (failed == DIVERGED)):
        for i in range(len(good)):
            y[i] = select(new & (failed == DIVERGED), good[i], y[i])
    y[o.status] = select(new, failed, y[o.status])
    y[o.end] = select(dead, y[o.end], t + 0.0 * y[o.end])
    for i in range(len(good)):
        good[i] = y[i]
    return dead | new


@inline
def _fell(floating, ground, o, plan, y):
    """Whether a floating base is too low over the ground or tilted too far; False where there is no ground."""
    fell = y[o.status] != y[o.status]
    if ground is not None:
        if floating is not None:
            k = o.base_q
            x, n, t = (y[k], y[k + 1], y[k + 2]), load3(ground, 0, GN), load3(ground, 0, GT)
            height = dot(n, x) - ground_height(ground, dot(t, x))
            lean = 1.0 - 2.0 * (y[k + 4] * y[k + 4] + y[k + 5] * y[k + 5])
            fell = (height < plan.min_height) | (lean < plan.min_upright)
    return fell


@entry
def rollout_one(scene, o, plan, signals, y, scratch, channels, out):
    rollout(scene, o[0], plan, signals, y, scratch, channels, out)


def _viewed_knots(knots):
    return None if knots is None else Knots(knots.times, as_lanes(knots.cubics), knots.period)


@overload(_viewed_knots)
def _overload_viewed_knots(knots):
    if isinstance(knots, types.NoneType):
        return lambda knots: None
    return lambda knots: Knots(knots.times, as_lanes(knots.cubics), knots.period)


@entry
def rollout_lanes(scene, o, plan, signals, y, scratch, channels, out):
    """Eight runs at once: signals, y, scratch and out have a last axis of lanes."""
    seen = Signals(
        _viewed_knots(signals.reference),
        as_lanes(signals.drive),
        _viewed_knots(signals.torques),
        viewed(signals.torque_values),
        viewed(signals.tau),
        viewed(signals.samples),
        viewed(signals.noise),
        signals.continuous,
    )
    s = scratch
    work = Scratch(
        as_lanes(s.W),
        as_lanes(s.Z),
        as_lanes(s.C),
        as_lanes(s.F),
        viewed(s.predicted),
        viewed(s.stages),
        viewed(s.torques),
        as_lanes(s.good),
    )
    rollout(scene, o[0], plan, seen, as_lanes(y), work, channels, as_lanes(out))
