"""Rollouts of a walking humanoid: how many a second and core, with their error, next to MuJoCo's threaded rollout.

The robot, simplified (10 joints) and complete (19), walks 4 s from standing with a planned gait, each rollout with
references changed by a seeded noise of 0.06 deg.  Ours: MIPSD servos, bristle friction, the midpoint rule at 1 ms,
eight rollouts a vector, of whose lane-steps a share is occupied: a lane whose robot has fallen or arrived takes the
next rollout, until there is none.  A gait search, whose candidates fall or are given up, is measured for itself.
MuJoCo's: the same URDF with position servos of the same stiffness, damping and reflected inertia, four spheres a sole,
elliptic cones, implicitfast at 1 ms.  The clock of its Python package, which would cost these rollouts 5 %, is switched
off.  It has no gearbox spring, no motor current and no energy meter, so it does less; the walks differ, and each
engine's error is its own: the trunk's path against the same engine at a quarter of the step.
"""

from __future__ import annotations

import importlib.util
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..base.files import complete
from ..model import Ground, Model
from ..robot_file import load_robot, save_robot
from ..run.lane_engine import Queue
from ..run.reference import Reference
from ..run.simulate import simulate_stream, standing_state
from ..scene.compile import compile_scene
from ..view.style import look
from .machine import machine
from .mujoco_clock import quick_mujoco
from .table import write_table

Paths = dict[float, list[np.ndarray | None]]  # of the trunk by step [s]; None of those that fell

DURATION = 4.0  # [s]
STEP = 1e-3  # [s]
NOISE = 1e-3  # [rad]


class Row(NamedTuple):
    """One line of the table."""

    robot: str
    engine: str
    threads: int
    rate: float  # rollouts a second
    per_core: float  # rollouts a second and thread
    steps: float  # thousand steps a second and thread
    upright: float  # share of the rollouts that did not fall
    error: float  # median over the upright of the trunk's largest deviation from a quarter of the step [m]
    occupancy: float  # share of the lane-steps that a rollout was in; nan without lanes


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the table; write walk.csv and walk.png into `out_dir`."""
    count = 256 if full else 64
    rows = []
    for locked in ("simplified", None):
        rows += _robot_rows(load_robot("humanoid", locked=locked), count)
    print(
        f"{'robot':12} {'engine':28} {'threads':>7} {'1/s':>8} {'1/s/core':>9} {'k steps/s':>9} "
        f"{'upright':>8} {'error':>9} {'lanes':>7}"
    )
    for r in rows:
        print(
            f"{r.robot:12} {r.engine:28} {r.threads:7} {r.rate:8.1f} {r.per_core:9.1f} {r.steps:9.0f} "
            f"{r.upright:8.0%} {r.error * 1e3:6.2f} mm {'' if math.isnan(r.occupancy) else f'{r.occupancy:.1%}':>7}"
        )
    for robot in dict.fromkeys(r.robot for r in rows):
        ours, *theirs = (r for r in rows if r.robot == robot and r.threads == 1)
        for other in theirs:
            fell = f", which falls in {1.0 - other.upright:.0%} of them" * (other.upright < 1.0)
            print(f"{robot}: {ours.per_core / other.per_core:.1f} times the rate of {other.engine} per core{fell}")
    print(_search_line(800 if full else 100))
    write_table(Path(out_dir) / "walk.csv", Row._fields, rows, machine())
    _plot(Path(out_dir) / "walk.png", rows)
    return rows


def _search_line(iterations: int) -> str:
    """What a gait search does with its lanes."""
    from ..optimize.planning import walking_cost
    from ..optimize.search import optimize_gait

    result = optimize_gait(walking_cost(load_robot("humanoid", locked="simplified")), iterations=iterations)
    failed = np.mean(~np.isfinite(result.history["f"]))
    return (
        f"search of {result.nit} gaits, of which {failed:.1%} fell: lanes occupied {result.occupancy:.1%}, "
        f"{result.nfev} evaluations begun, {result.wasted} of them wasted by speculation"
    )


def _robot_rows(model: Model, count: int) -> list[Row]:
    from ..walking.plan import walking_plan

    plan = walking_plan(load_robot("humanoid", locked="simplified"), com_height=0.205, n_steps=8)
    start = int(np.argmax((np.abs(plan.angles - plan.standing) > 1e-3).any(axis=1)))
    times, angles = plan.times[start::4] - plan.times[start], plan.angles[start::4]
    columns = [plan.joint_names.index(n) if n in plan.joint_names else -1 for n in model.joint_names]
    rng = np.random.default_rng(0)
    references = []
    for _ in range(count):
        noisy = angles + NOISE * rng.normal(size=angles.shape[1])
        references.append(np.where(np.array(columns) >= 0, noisy[:, columns], 0.0))
    name = f"{len(model.joint_names)} joints"
    rows = _our_rows(name, model, times, references)
    if importlib.util.find_spec("mujoco"):
        rows += _mujoco_rows(name, model, times, references)
    return rows


def _our_rows(name: str, model: Model, times: np.ndarray, references: Sequence[np.ndarray]) -> list[Row]:
    paths: Paths = {}

    def rollouts(h: float, threads: int) -> float:
        scene = compile_scene(model, gearbox="mipsd", ground=Ground(), integrator="midpoint", timestep=h)
        knots = [Reference(times, values) for values in references]
        state, queue = standing_state(scene, references[0][0]), Queue(len(knots))
        occupancy = simulate_stream(
            scene, DURATION, queue, lambda k: (state, knots[k]), lambda r: r["base_q"][:, :3] if r.ok else None,
            record=("base_q",), record_interval=0.01, threads=threads,
        )  # fmt: skip
        paths[h] = queue.answers
        return occupancy

    return _rows(name, "featherstone_gait", len(references), rollouts, paths)


def _rows(name: str, engine: str, count: int, rollouts: Callable[[float, int], float], paths: Paths) -> list[Row]:
    """Time one and two threads on the same work; the error from a quarter of the step."""
    measured = []
    for threads in (1, min(2, os.cpu_count() or 1)):
        occupancy = rollouts(STEP, threads)
        times = []
        for _ in range(3):
            begin = time.perf_counter()
            rollouts(STEP, threads)
            times.append(time.perf_counter() - begin)
        measured.append((threads, count / float(np.median(times)), occupancy))
        if threads == 1:
            rollouts(STEP / 4, threads)
    pairs = [(a, b) for a, b in zip(paths[STEP], paths[STEP / 4]) if a is not None and b is not None]
    error = float(np.median([np.abs(a - b).max() for a, b in pairs])) if pairs else float("nan")
    upright = float(np.mean([p is not None for p in paths[STEP]]))
    return [
        Row(name, engine, threads, rate, rate / threads, rate / threads * DURATION / STEP / 1e3, upright, error, lanes)
        for threads, rate, lanes in measured
    ]


def _mujoco_rows(name: str, model: Model, times: np.ndarray, references: Sequence[np.ndarray]) -> list[Row]:
    import mujoco
    import mujoco.rollout

    spec_model = mujoco_model(model)
    paths: Paths = {}
    data = [mujoco.MjData(spec_model) for _ in range(2)]

    def rollouts(h: float, threads: int) -> float:
        spec_model.opt.timestep = h
        steps = round(DURATION / h)
        at = h * np.arange(steps)
        control = np.stack([np.stack([np.interp(at, times, c) for c in r.T], axis=1) for r in references])
        begin = mujoco_state(spec_model, data[0], references[0][0])
        states, _ = mujoco.rollout.rollout(
            spec_model,
            data[:threads],
            initial_state=np.repeat(begin[None], len(references), axis=0),
            control=control,
        )
        every = round(0.01 / h)
        height = 0.6 * begin[3]
        paths[h] = [s[every - 1 :: every, 1:4] if (s[:, 3] > height).all() else None for s in states]
        return math.nan

    with quick_mujoco():
        return _rows(name, "mujoco rollout, implicitfast", len(references), rollouts, paths)


def mujoco_model(model: Model) -> Any:
    """The model as MuJoCo's, with a floor, spheres at the contact points, which alone collide, and position servos."""
    import tempfile

    import mujoco

    free: dict[str, Any] = {"type": "fixed", "lower": -math.inf, "upper": math.inf}
    joints = tuple(replace(j, **free) if j.name in model.locked else j for j in model.joints)
    moving = {name: model.servos[name] for name in model.joint_names}
    model = replace(model, joints=joints, locked={}, servos=moving, shapes=())
    with tempfile.TemporaryDirectory() as folder:
        save_robot(model, Path(folder) / "robot.urdf")
        spec = mujoco.MjSpec.from_file(str(Path(folder) / "robot.urdf"))
    spec.compiler.fusestatic = False
    spec.worldbody.first_body().add_freejoint()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], friction=[0.95, 0.005, 1e-4])
    for point in model.contacts:
        x, y, z = point.position
        geom = {"size": [1e-3, 0, 0], "pos": [x, y, z + 1e-3], "friction": [0.95, 0.005, 1e-4], "mass": 0.0}
        spec.body(point.link).add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, contype=0, conaffinity=1, **geom)
    for joint in model.moving_joints:
        servo = model.servos[joint.name]
        torque = servo.gearbox.ratio * servo.motor_constant
        kp = 1.0 / (1.0 / servo.gearbox.stiffness + servo.resistance / (torque * servo.controller.Kp))
        kv = torque**2 / servo.resistance + servo.viscous_friction
        spec.joint(joint.name).armature = servo.gearbox.ratio**2 * servo.gearbox.rotor_inertia
        actuator = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=kp, kv=kv)
        limit = torque * servo.current_limit
        actuator.forcelimited, actuator.forcerange = True, [-limit, limit]
    m = spec.compile()
    m.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    m.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    return m


def mujoco_state(m: Any, d: Any, angles: np.ndarray) -> np.ndarray:
    """Full physics state of the robot standing at the angles, its lowest sphere on the floor."""
    import mujoco

    mujoco.mj_resetData(m, d)
    d.qpos[7:] = angles
    d.qpos[2] = 1.0
    mujoco.mj_forward(m, d)
    spheres = m.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    d.qpos[2] -= d.geom_xpos[spheres, 2].min() - 1e-3
    mujoco.mj_forward(m, d)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(m, kind))
    mujoco.mj_getState(m, d, state, kind)
    return state


@look()
def _plot(path: Path, rows: list[Row]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 0.4 * len(rows) + 1.0), layout="constrained")
    labels = [f"{r.robot}, {r.engine.split(',')[0]}, {r.threads} thread{'s' * (r.threads > 1)}" for r in rows]
    colors = ["C0" if "feather" in r.engine else "0.6" for r in rows]
    bars = axes.barh(range(len(rows)), [r.rate for r in rows], color=colors)
    axes.bar_label(bars, [f"{r.rate:.0f}, {_told(r)}" for r in rows], padding=3, fontsize=8)
    axes.set_yticks(range(len(rows)), labels, fontsize=8)
    axes.invert_yaxis()
    axes.margins(x=0.25)
    axes.set(xlabel=f"rollouts of {DURATION:g} s a second", title=f"Walking humanoid, step {1e3 * STEP:g} ms; error")
    with complete(path) as temporary:
        figure.savefig(temporary, dpi=130)
    plt.close(figure)


def _told(row: Row) -> str:
    """Error of the rollouts, or how many of them ended upright."""
    return f"±{1e3 * row.error:.2g} mm" if row.upright == 1.0 else f"{row.upright:.0%} upright"
