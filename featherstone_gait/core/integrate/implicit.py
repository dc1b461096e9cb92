"""The linearly implicit step at fixed length: Euler's (first order) and the midpoint rule (second order)."""

from typing import NamedTuple

import numpy as np

from ..compile.jit import inline
from ..compile.lanes import select
from ..compile.optional import any_present, only_if
from ..compile.structure import structure
from ..effects.tendon import hold_tendons
from ..step.advance import step_trees
from ..step.closure import project, project_euler
from ..step.context import NEWTON_TOLERANCE, Scratch, Step
from ..step.newton import acting, factor_again, is_coupled
from ..step.signals import inputs_over_step
from ..tree.layout import U
from .integrator import Integrator, hold_solution, scratch, take_step, thetas


@structure
class Implicit(NamedTuple):
    """Workspace."""

    scratch: Scratch
    predicted: np.ndarray | None  # (nq + nv,) of the midpoint rule, None of Euler's


@take_step.of(Implicit)
def implicit_step(work, run, y, t, theta):
    """Take one step (figures 2 to 6 of the paper): solve motors, gears, joints and ground together, voltages held."""
    h = run.plan.h
    inputs_over_step(run.signals, t, h, t + run.plan.theta * h)
    step_trees(_step(work, run, y, t, theta))
    _close(work.predicted, run.scene, run.offsets[0], work.scratch, h, y)


@inline
def _step(work, run, y, t, theta):
    scene, u, scratch, h = run.scene, run.signals, work.scratch, run.plan.h
    return Step(
        scene=scene, actuator=scene.actuator, decay=scene.decay, offsets=run.offsets[0], y=y, tau=u.tau, drive=u.drive,
        predicted=work.predicted, t=t, span=h, h=h, h_implicit=theta * h, theta=theta,
        extrapolation_ratio=only_if(work.predicted, (1.0 - theta) / theta), tolerance=NEWTON_TOLERANCE,
        W=scratch.W, Z=scratch.Z, C=scratch.C, F=scratch.F, N=scratch.N, pool=scratch.pool, part=None,
        rows=scratch.rows,
        closing=scratch.closing,
    )  # fmt: skip


@inline
def _close(predicted, scene, offsets, scratch, h, y):
    """Close loops at the end of the step; factors in its middle, as the midpoint rule has them, suit both ends."""
    if predicted is None:
        project_euler(scene.loops, scene, offsets, scratch, h, y)
    else:
        project(scene.loops, scene, offsets, scratch, y)


@inline
def _thetas(predicted, theta, end):
    """Begin the midpoint rule with a step of Euler's.

    By itself it would leave the stiff modes ringing of a start off their equilibrium; one step of first order damps
    them and costs no order (R. Rannacher, Finite element solution of diffusion problems with irregular data, Numerische
    Mathematik 43 (1984)).  A run that goes on where another ended, at a time `end` > 0 after its start, needs none.
    """
    if predicted is None:
        return theta, theta
    steady = theta + 0.0 * end
    return select(end > 0.0, steady, 1.0 + 0.0 * end), steady


thetas.of(Implicit)(lambda work, theta, end: _thetas(work.predicted, theta, end))


@hold_solution.of(Implicit)
def _hold(work, run, plain, y, t, theta):
    solved, scratch = plain.work.scratch, work.scratch
    _copy(scratch.Z, solved.Z)
    _copy(scratch.C, solved.C)
    hold_tendons(plain.scene.tendons, scratch.W, solved.W)
    _hold_pairs(solved.pool, scratch)
    _hold_factors(is_coupled(plain.scene), work, plain, y, t, theta)


@inline
def _hold_factors(coupled, work, plain, y, t, theta):
    if coupled is None:
        for k in range(6):
            work.scratch.W[0, U + k] = plain.work.scratch.W[0, U + k]
        _factor(_step(plain.work, plain, y, t, theta))


@inline
def _factor(step):
    _factor_if(any_present(any_present(acting(step), step.tau), step.scene.contact), step)


@inline
def _factor_if(forces, step):
    if forces is not None:
        factor_again(step)


@inline
def _hold_pairs(pool, scratch):
    if pool is not None:
        _copy(scratch.pool.C, pool.C)


@inline
def _copy(numbers, solved):
    for i in range(len(solved)):
        for k in range(solved.shape[1]):
            numbers[i, k] = solved[i, k]


def _euler_workspace(sizes, zeros):
    return Implicit(scratch(sizes, zeros), None)


def _midpoint_workspace(sizes, zeros):
    return Implicit(scratch(sizes, zeros), zeros(2 * sizes.n + 13 * sizes.bases + 4 * sizes.balls))


IMPLICIT_EULER = Integrator("implicit_euler", 1, _euler_workspace)
MIDPOINT = Integrator("midpoint", 2, _midpoint_workspace, theta=0.5, folds_spring=True, rings=True)
