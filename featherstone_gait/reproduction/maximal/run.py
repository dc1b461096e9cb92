"""A run of a scene by bodies and constraints: the kernel's loop, and what is called from Python."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...base.arguments import instance, listed, whole
from ...core.compile.jit import entry, inline
from ...core.compile.optional import slice_if
from ...core.compile.outside import read_now
from ...core.effects.controller import apply_delayed
from ...core.integrate.rollout import DIVERGED, FELL, inspect, record, tick
from ...core.step.signals import time_of
from ...core.tree.kinematics import motion_pass
from ...core.tree.layout import Motion, P, V
from ...core.tree.layout import R as ROTATION
from ...core.tree.spatial import add, cross, load3, load9, rotate, rotate_back, store3, sub
from ...run.prepare import prepare
from ...run.reference import Reference
from ...run.start import check_scene
from ...run.status import Status
from ...run.trajectory import Trajectory
from ...scene.compile import CompiledScene
from .bodies import measure, refresh
from .contact import contact_forces
from .engine import Engine, step
from .layout import PLACE, SPEED, SPIN, TURN, R, Work, World
from .servo import drive_joints, filter_speeds
from .world import assembled, work_of


@entry
def rollout_bodies(run: Any, y: np.ndarray, out: np.ndarray, world: Any, work: Any) -> None:
    """Run the scene with bodies and constraints, as `core.integrate.rollout.rollout` does with joints."""
    w = World(world[0], world[1], world[2], world[3], world[4], world[5])
    x = Work(work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7], work[8], work[9], work[10])
    plan, offsets = run.plan, run.offsets[0]
    _place_bodies(run, w, x, y, work[11])
    for i in range(len(run.good)):
        run.good[i] = y[i]
    dead = False
    for k in range(plan.steps + 1):
        t = time_of(plan, k)
        _read(run, w, x, y)
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
        contacts = step(w, x, run.scene.gravity, plan.h)
        if len(w.points):
            contact_forces(
                w, x, contacts, x.counts[0], y[offsets.contact_force : offsets.contact_force + 3 * len(w.points)]
            )
    for m in range(k // plan.per_sample + 1, len(out)):
        record(run, y, m, out)


@entry
def advance(world: Any, work: Any, gravity: np.ndarray, h: float, steps: int) -> None:
    """Move bodies without a robot by a number of steps; world and work come from `assembled` and `work_of`."""
    w = World(world[0], world[1], world[2], world[3], world[4], world[5])
    x = Work(work[0], work[1], work[2], work[3], work[4], work[5], work[6], work[7], work[8], work[9], work[10])
    refresh(w, x)
    for _ in range(steps):
        measure(w, x)
        step(w, x, gravity, h)
    measure(w, x)


@inline
def _place_bodies(run: Any, w: Any, x: Any, y: Any, W: Any) -> None:
    """Place the bodies by the joint coordinates."""
    offsets, n = run.offsets[0], len(w.axes)
    base = slice_if(run.scene.floating, y, offsets.base_q, 7)
    speed = slice_if(run.scene.floating, y, offsets.base_qd, 6)
    motion = Motion(base, speed, None, y[offsets.q : offsets.q + n], y[offsets.qd : offsets.qd + n], None, None)
    motion_pass(run.scene.tree, None, run.scene.gravity, motion, W)
    origin = _origin(base)
    X = x.X
    for i in range(len(w.bodies)):
        b = w.bodies[i]
        if b.row >= 0:
            E = load9(W, b.row, ROTATION)
            c = add(load3(W, b.row, P), rotate(E, b.center))
            store3(X, i, PLACE, add(origin, c))
            store3(X, i, SPIN, load3(W, b.row, V))
            store3(X, i, SPEED, add(load3(W, b.row, V + 3), cross(load3(W, b.row, V), c)))
            _store_turn(X, i, E)
    for k in range(n):
        x.angles[k, 0] = y[offsets.q + w.axes[k].dof]
    refresh(w, x)


@inline
def _origin(base: Any) -> Any:
    if base is None:
        return (0.0, 0.0, 0.0)
    return (base[0], base[1], base[2])


@inline
def _store_turn(X: Any, i: int, E: Any) -> None:
    """Store the quaternion of a rotation matrix, from its largest component (S. W. Shepperd 1978)."""
    best, most = 0, E[0] + E[4] + E[8]
    for k in range(3):
        if E[4 * k] > most:
            best, most = k + 1, E[4 * k]
    a, b, c = E[7] - E[5], E[2] - E[6], E[3] - E[1]
    if best == 0:
        q = (1.0 + most, a, b, c)
    elif best == 1:
        q = (a, 1.0 + E[0] - E[4] - E[8], E[1] + E[3], E[2] + E[6])
    elif best == 2:
        q = (b, E[1] + E[3], 1.0 + E[4] - E[0] - E[8], E[5] + E[7])
    else:
        q = (c, E[2] + E[6], E[5] + E[7], 1.0 + E[8] - E[0] - E[4])
    s = 1.0 / np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for k in range(4):
        X[i, TURN + k] = q[k] * s


@inline
def _read(run: Any, w: Any, x: Any, y: Any) -> None:
    """Read the joint coordinates from the bodies."""
    offsets = run.offsets[0]
    measure(w, x)
    for k in range(len(w.axes)):
        i = w.axes[k].dof
        y[offsets.q + i], y[offsets.qd + i] = x.angles[k, 0], x.angles[k, 1]
    _read_base(run.scene.floating, offsets, w, x, y)


@inline
def _read_base(floating: Any, offsets: Any, w: Any, x: Any, y: Any) -> None:
    if floating is not None:
        X = x.X
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
    welded: Sequence[str] = (),
) -> Trajectory:
    """Simulate a scene with free bodies and constraints, as ODE did under SimTwo.

    Parameters
    ----------
    scene : CompiledScene
        Compiled with integrator="simtwo" or another one of fixed steps, which the engine replaces.
    duration : float
        [s]
    state, reference, record, record_interval
        As for `featherstone_gait.simulate`.
    engine : Engine, optional
        Settings, by default SimTwo's.
    seed : int
        Of the shuffling of rows, the only random process: the same seed gives the same bits.
    welded : sequence of str
        Joints that a constraint holds at their initial angle, without servo.

    Returns
    -------
    Trajectory
        Its status says whether the robot fell or the run diverged.  Its energies are supply, meter, copper, friction
        of the joints, gear and work.

    Raises
    ------
    ValueError
        For features that this engine lacks: joints that slide or follow others, rotors on rigid gearboxes and
        armature, friction that depends on load, springs, pushes, a supply, and ground with steps, height fields or
        contact circles.
    """
    return simulate_seeds(
        scene,
        duration,
        state,
        reference,
        seeds=[seed],
        engine=engine,
        record=record,
        record_interval=record_interval,
        welded=welded,
    )[0]


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
    welded: Sequence[str] = (),
) -> list[Trajectory]:
    """Run `simulate` once for each of several seeds, in threads.

    Parameters
    ----------
    scene, duration, state, reference, engine, record, record_interval, welded
        As for `simulate`.
    seeds : iterable of int
        Whole numbers from 0.

    Returns
    -------
    list of Trajectory
        In the order of the seeds; each has the bits of `simulate` with its seed.

    Raises
    ------
    ValueError
        As `simulate`, and for a seed that is not a whole number from 0.
    """
    check_scene(scene)
    engine = Engine() if engine is None else engine
    instance("engine", engine, Engine, "give an Engine")
    seeds = [whole("seed", seed, 0, "it begins a sequence", 2**63 - 1) for seed in listed("seeds", seeds, "a list")]
    ready = prepare(scene, duration, record, record_interval)
    start = ready.start(state, reference)
    world = assembled(scene, engine, welded, start.y)

    def one(seed: int) -> Trajectory:
        run, y, out = ready.arguments(start)
        work = work_of(world, seed, scene)
        ready.call(lambda *these: rollout_bodies(*these, world, work), run, y, out)
        return _trajectory(ready, start, (y, out), work, seed)

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        return list(pool.map(one, seeds)) if len(seeds) > 1 else [one(seed) for seed in seeds]


def _trajectory(ready: Any, start: Any, results: tuple[np.ndarray, np.ndarray], work: tuple, seed: int) -> Trajectory:
    """Name the channels and say how the run ended."""
    (y, out), scene, course = results, ready.scene, ready.schedule(start.y)
    code, end = int(y[scene.layout["status"]]), float(y[scene.layout["end_time"]])
    status = {FELL: "fell", DIVERGED: "diverged"}.get(code, "ok")
    end = end if code else course.offset + (course.first + course.steps) * course.h
    message = f"{scene.model.name} {status} at {end:.4g} s" if code else ""
    counts = work[10]
    info = {
        "robot": scene.model.name,
        "joints": list(scene.model.joint_names),
        "integrator": "maximal",
        "timestep": scene.timestep,
        "servos": scene.gearbox,
        "seed": seed,
        "unsolved_steps": int(counts[1]),
    }
    return Trajectory(ready.named(out, course), Status(status), message, end, y, info, parts=scene.parts)
