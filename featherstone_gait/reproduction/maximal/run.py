"""A run of a scene by bodies and constraints: the kernel's loop, and what is called from Python."""

from __future__ import annotations

import os
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...base.arguments import instance, listed, whole
from ...core.compile.jit import entry, inline
from ...core.compile.optional import item_or_zero, slice_if
from ...core.compile.outside import read_now
from ...core.effects.controller import apply_delayed
from ...core.integrate.rollout import inspect, record, tick
from ...core.step.signals import time_of
from ...core.tree.kinematics import motion_pass, unit_quaternion
from ...core.tree.layout import Motion, P, V
from ...core.tree.layout import R as ROTATION
from ...core.tree.spatial import add, cross, load3, load9, rotate, rotate_back, store3, sub
from ...run.prepare import prepare
from ...run.reference import Reference
from ...run.status import OF_CODE, Status
from ...run.trajectory import Trajectory
from ...scene.compile import CompiledScene
from .bodies import load, measure, move, refresh
from .layout import PLACE, SPEED, SPIN, TURN, Engine, R
from .rows import fill_rows, show_forces
from .servo import drive_joints, filter_speeds
from .solve import solve
from .world import assembled, work_of


@entry
def rollout_bodies(run: Any, y: np.ndarray, out: np.ndarray, w: Any, x: Any) -> None:
    """Run the scene with bodies and constraints, as `core.integrate.rollout.rollout` does with joints."""
    plan, offsets = run.plan, run.offsets[0]
    forces = y[offsets.contact_force : offsets.contact_force + 3 * len(w.points)]
    _place_bodies(run, w, x, y)
    for i in range(len(run.good)):
        run.good[i] = y[i]
    dead = False
    for k in range(plan.steps + 1):
        t = time_of(plan, k)
        measure(w, x)
        _read_base(run.scene.floating, offsets, w, x.X, y)
        if k < plan.steps:
            filter_speeds(run.scene.actuator, run, w, y)
        if k % plan.per_tick == 0 or k == plan.steps:
            dead = inspect(run, t, y)
            if k < plan.steps and not dead:
                tick(run, k, t, y)
        else:
            apply_delayed(run.scene.firmware.delay, run.scene, run.offsets[0], y, k % plan.per_tick)
        if k % plan.per_sample == 0:
            record(run, y, k // plan.per_sample, out)
        if k == plan.steps or read_now(run.stop) != 0 or dead:
            break
        drive_joints(run.scene.actuator, run, w, x, y)
        load(w, x, run.scene.gravity)
        rows = fill_rows(w, x, plan.h)
        solve(w, x, rows)
        show_forces(x, rows, forces)
        move(w, x, plan.h)
    for m in range(k // plan.per_sample + 1, len(out)):
        record(run, y, m, out)


@inline
def _place_bodies(run: Any, w: Any, x: Any, y: Any) -> None:
    """Place the bodies by the joint coordinates."""
    offsets, X, W = run.offsets[0], x.X, x.tree
    base = slice_if(run.scene.floating, y, offsets.base_q, 7)
    speed = slice_if(run.scene.floating, y, offsets.base_qd, 6)
    origin = (item_or_zero(base, 0), item_or_zero(base, 1), item_or_zero(base, 2))
    motion_pass(run.scene.tree, None, run.scene.gravity, Motion(base, speed, None, x.q, x.qd, None, None), W)
    for i in range(1, len(w.bodies)):
        row = w.bodies[i].row
        E, spin = load9(W, row, ROTATION), load3(W, row, V)
        c = add(load3(W, row, P), rotate(E, w.bodies[i].center))
        store3(X, i, PLACE, add(origin, c))
        store3(X, i, SPIN, spin)
        store3(X, i, SPEED, add(load3(W, row, V + 3), cross(spin, c)))
        _store_turn(X, i, E)
    refresh(w, x)


@inline
def _store_turn(X: Any, i: int, E: Any) -> None:
    """Store the quaternion of a rotation matrix, from its largest component (S. W. Shepperd 1978)."""
    a, b, c, p, q, r = E[7] - E[5], E[2] - E[6], E[3] - E[1], E[1] + E[3], E[2] + E[6], E[5] + E[7]
    best, most = 0, E[0] + E[4] + E[8]
    choices = (
        (1.0 + most, a, b, c),
        (a, 1.0 + E[0] - E[4] - E[8], p, q),
        (b, p, 1.0 + E[4] - E[0] - E[8], r),
        (c, q, r, 1.0 + E[8] - E[0] - E[4]),
    )
    for k in range(3):
        if E[4 * k] > most:
            best, most = k + 1, E[4 * k]
    for k in range(4):
        X[i, TURN + k] = choices[best][k]
    unit_quaternion(X[i], TURN)


@inline
def _read_base(floating: Any, offsets: Any, w: Any, X: Any, y: Any) -> None:
    """Read the coordinates of a floating base from its body."""
    if floating is not None:
        E, spin = load9(X, 1, R), load3(X, 1, SPIN)
        arm = rotate(E, w.bodies[1].center)
        at, speed = sub(load3(X, 1, PLACE), arm), sub(load3(X, 1, SPEED), cross(spin, arm))
        own = rotate_back(E, spin)
        for k in range(3):
            y[offsets.base_q + k], y[offsets.base_qd + k], y[offsets.base_qd + 3 + k] = at[k], speed[k], own[k]
        for k in range(4):
            y[offsets.base_q + 3 + k] = X[1, TURN + k]


# ---------------------------------------------------------------------------------------------- from Python


def simulate(
    scene: CompiledScene,
    duration: float,
    state: ArrayLike | Trajectory | None = None,
    reference: Reference | None = None,
    *,
    engine: Engine | None = None,
    seed: int = 0,
    record: Iterable[str] = ("q", "qd"),
    record_interval: float | None = None,
) -> Trajectory:
    """Simulate a scene with free bodies and constraints, as ODE did under SimTwo.

    Parameters
    ----------
    scene : CompiledScene
        Compiled with integrator="simtwo" or another one of fixed steps, which the engine replaces.
    duration, state, reference, record, record_interval
        As for `featherstone_gait.simulate`.
    engine : Engine, optional
        Settings, by default SimTwo's.
    seed : int
        Of the shuffling of rows, the only random process: the same seed gives the same bits.

    Returns
    -------
    Trajectory
        Its status says whether the robot fell or the run diverged.  Its energies are supply, meter, copper, friction
        of the joints, gear and work.

    Raises
    ------
    ValueError
        For a scene with what this engine lacks, and for a seed that is not a whole number from 0.
    """
    how: dict[str, Any] = {"engine": engine, "record": record, "record_interval": record_interval}
    return simulate_seeds(scene, duration, state, reference, seeds=[seed], **how)[0]


def simulate_seeds(
    scene: CompiledScene,
    duration: float,
    state: ArrayLike | Trajectory | None = None,
    reference: Reference | None = None,
    *,
    seeds: Iterable[int],
    engine: Engine | None = None,
    record: Iterable[str] = ("q", "qd"),
    record_interval: float | None = None,
) -> list[Trajectory]:
    """Run `simulate` once for each of several seeds, in threads.

    Parameters
    ----------
    seeds : iterable of int
        Whole numbers from 0.
    scene, duration, state, reference, engine, record, record_interval
        As for `simulate`.

    Returns
    -------
    list of Trajectory
        In the order of the seeds; each has the bits of `simulate` with its seed.
    """
    engine = Engine() if engine is None else engine
    instance("engine", engine, Engine, "give an Engine")
    seeds = [whole("seed", seed, 0, "it begins a sequence", 2**63 - 1) for seed in listed("seeds", seeds, "a list")]
    ready = prepare(scene, duration, record, record_interval)
    start = ready.start(state, reference)
    world = assembled(scene, engine)

    def one(seed: int) -> Trajectory:
        run, y, out = ready.arguments(start)
        work = work_of(world, seed, scene, y)
        ready.call(lambda *these: rollout_bodies(*these, world, work), run, y, out)
        status, end = OF_CODE[int(y[scene.layout["status"]])], float(y[scene.layout["end_time"]])
        message = "" if status is Status.OK else f"{scene.model.name} {status} at {end:.4g} s"
        info = {
            "robot": scene.model.name,
            "joints": list(scene.model.joint_names),
            "integrator": "maximal",
            "timestep": scene.timestep,
            "servos": scene.gearbox,
            "seed": seed,
            "unsolved_steps": int(work.unsolved[0]),
        }
        return Trajectory(ready.named(out, ready.schedule(start.y)), status, message, end, y, info, parts=scene.parts)

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(one, seeds)) if len(seeds) > 1 else [one(seed) for seed in seeds]
