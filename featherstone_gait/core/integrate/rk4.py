"""The classical Runge-Kutta method of order 4 on the scene's differential equation."""

from typing import NamedTuple

import numpy as np

from ..compile.jit import inline
from ..compile.structure import structure
from ..effects.pair import flatten_bristles
from ..step.closure import project
from ..step.context import NEWTON_TOLERANCE, Scratch, Step
from ..step.derivative import derivative
from ..step.signals import inputs_over_step
from ..tree.ball import unit_balls
from ..tree.kinematics import unit_quaternions
from .integrator import Integrator, scratch, take_step


@structure
class RungeKutta4(NamedTuple):
    """Workspace."""

    scratch: Scratch
    stages: np.ndarray  # (3, what is integrated): start, slope and weighted sum


@inline
def _evaluate(run, y, t, slope):
    scene, u, h = run.scene, run.signals, run.plan.h
    scratch, offsets, act = run.work.scratch, run.offsets[0], scene.actuator
    at = Step(
        scene=scene, actuator=act, decay=None, offsets=offsets, y=y, tau=u.tau, drive=u.drive, predicted=None,
        t=t, span=h, h=0.0, h_implicit=0.0, theta=1.0, extrapolation_ratio=None,
        tolerance=NEWTON_TOLERANCE, W=scratch.W, Z=scratch.Z, C=scratch.C, F=scratch.F, N=scratch.N,
        pool=scratch.pool, part=None, rows=scratch.rows, closing=scratch.closing,
    )  # fmt: skip
    derivative(at, slope)


@take_step.of(RungeKutta4)
def rk4_step(work, run, y, t, theta):
    """Take one step; theta plays no part."""
    start, slope, total = work.stages[0], work.stages[1], work.stages[2]
    h, n = run.plan.h, run.offsets[0].after_integrated
    for k in range(4):
        inputs_over_step(run.signals, t, h, t + 0.5 * h * ((k + 1) // 2))
        _evaluate(run, y, t, slope)
        if k == 0:
            flatten_bristles(run.scene.pairs, run.work.scratch, run.offsets[0], y, slope)
        weight = 1.0
        if k == 1 or k == 2:
            weight = 2.0
        stage_step = 0.5 * h
        if k == 2:
            stage_step = h
        for i in range(n):
            if k == 0:
                start[i], total[i] = y[i], slope[i]
            else:
                total[i] = total[i] + weight * slope[i]
            y[i] = start[i] + stage_step * slope[i]
    for i in range(n):
        y[i] = start[i] + (h / 6.0) * total[i]
    unit_quaternions(run.scene.floating, run.scene.trees, run.offsets[0].base_q, y)
    unit_balls(run.scene.balls, run.offsets[0].ball_q, y)
    project(run.scene.loops, run.scene, run.offsets[0], work.scratch, y)


def _workspace(sizes, zeros):
    stages = zeros((3, int(sizes.offsets["after_integrated"])))
    return RungeKutta4(scratch(sizes, zeros), stages)


RK4 = Integrator("rk4", 4, _workspace, stages=4, stability=1.39, soft=True)  # its stability interval is 2.785 / lambda
