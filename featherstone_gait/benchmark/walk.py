"""Measure rollouts of a walking humanoid a second and core, with their error, next to MuJoCo's threaded rollout.

The robot, simplified (10 joints) and complete (19), walks 4 s from standing with a planned gait.  Each rollout's
references get a seeded noise of 0.06 deg.  Ours: motor inertia plus spring-damper (MIPSD) servos, bristle friction, the
midpoint rule at 1 ms, eight rollouts a vector.  A lane whose robot has fallen or arrived takes the next rollout, until
there is none; the table has the share of lane-steps that are occupied.  A gait search, whose candidates fall or are
given up, is measured separately, and so is what refilling lanes saves.

MuJoCo's: the same URDF with position servos of the same stiffness, damping and reflected inertia, four spheres a sole,
elliptic cones, implicitfast at 1 ms.  The clock of its Python package, which would cost these rollouts 5 %, is switched
off.  It has no gearbox spring, motor current or energy meter, so it does less.  The walks differ, so each engine's
error is counted from its own run: the trunk's path against the same engine at a quarter of the step.

    featherstone-gait benchmark walk        three minutes
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..model import Ground, Model
from ..robot_file import load_robot
from ..run.lane_engine import Queue
from ..run.reference import Reference
from ..run.simulate import simulate_batch, simulate_stream, standing_state
from ..run.trajectory import Trajectory
from ..scene.compile import compile_scene
from ..view.style import look, subplots
from .engines import humanoid_of, mujoco, quick_mujoco, rollout, standing_on
from .table import in_turn, installed, machine, save_figure, tabulate

Paths = dict[float, list[np.ndarray | None]]  # of the trunk by step [s]; None of those that fell

DURATION = 4.0  # [s]
STEP = 1e-3  # [s]
NOISE = 1e-3  # [rad]


class Row(NamedTuple):
    """One line of the table."""

    robot: Annotated[str, "robot", "<10"]
    engine: Annotated[str, "engine", "<28"]
    threads: Annotated[int, "threads", "7"]
    rate: Annotated[float, "1/s", "8.1f"]  # rollouts a second
    per_core: Annotated[float, "1/s/core", "8.1f"]  # rollouts a second and thread
    steps: Annotated[float, "k steps/s", "9.0f"]  # thousand steps a second and thread
    upright: Annotated[float, "upright", "7.0%"]  # share of the rollouts that did not fall
    # Median over the upright of the trunk's largest deviation from a quarter of the step.
    error: Annotated[float, "error [m]", "9.1e"]
    occupancy: Annotated[float, "lanes", "6.1%"]  # share of the lane-steps that a rollout was in; nan without lanes


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the table; write walk.csv and walk.png into `out_dir`."""
    robots = (load_robot("humanoid", locked=locked) for locked in ("simplified", None))
    measured = (row for robot in robots for row in _robot_rows(robot, 256 if full else 64))
    rows = tabulate(out_dir / "walk.csv", Row, measured, machine())
    for robot in dict.fromkeys(r.robot for r in rows):
        ours, *theirs = (r for r in rows if r.robot == robot and r.threads == 1)
        for other in theirs:
            fell = f", which falls in {1.0 - other.upright:.0%} of them" * (other.upright < 1.0)
            print(f"{robot}: {ours.per_core / other.per_core:.1f} times the rate of {other.engine} per core{fell}")
    print(_search_line(800 if full else 100))
    print(handed_over(9 if full else 3))
    _plot(out_dir / "walk.png", rows)
    return rows


def _search_line(iterations: int) -> str:
    """Describe how a gait search uses its lanes."""
    from ..optimize.planning import walking_cost
    from ..optimize.search import optimize_gait

    result = optimize_gait(walking_cost(load_robot("humanoid", locked="simplified")), iterations=iterations)
    failed = np.mean(~np.isfinite(result.history["f"]))
    return (
        f"search of {result.nit} gaits, of which {failed:.1%} fell: lanes occupied {result.occupancy:.1%}, "
        f"{result.nfev} evaluations begun, {result.wasted} of them wasted by speculation"
    )


def handed_over(repeats: int) -> str:
    """Compare refilling lanes with waiting for the last of eight, where every second candidate falls soon."""
    scene = compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "implicit_euler", STEP)
    stands = standing_state(scene, np.zeros(scene.tree.n))
    falls = stands.copy()
    falls[scene.layout["base_qd"]] = 2.0  # [m/s]
    states, still = [stands, falls] * 16, [Reference([0.0], np.zeros((1, scene.tree.n)))] * 32
    how: dict[str, Any] = dict(record=(), executor=SimpleNamespace(map=map), estimate_error=False)

    def rollouts(size: int) -> list[Trajectory]:
        parts = [slice(k, k + size) for k in range(0, len(states), size)]
        return [r for part in parts for r in simulate_batch(scene, 2.0, states[part], still[part], **how)]

    fallen = [run_.end_time for run_ in rollouts(len(states)) if run_.status == "fell"]
    whole, waiting = in_turn([partial(rollouts, len(states)), partial(rollouts, 8)], repeats).T
    return (
        f"fallen lanes handed over: {len(fallen)} of {len(states)} walkers fall after {np.median(fallen):.2f} of 2 s; "
        f"CPU time {np.median(whole / waiting):.2f} +-{0.5 * np.ptp(whole / waiting):.2f} of that without handing over"
    )


def _robot_rows(model: Model, count: int) -> list[Row]:
    times, references = planned(model, count)
    name = f"{len(model.joint_names)} joints"
    rows = _our_rows(name, model, times, references)
    if installed("mujoco"):
        rows += _mujoco_rows(name, model, times, references)
    return rows


def planned(model: Model, count: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return times (n,) [s] and references (n, nj) [rad] of rollouts, which differ by a little noise."""
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
    return times, references


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
        times = in_turn([partial(rollouts, STEP, threads)], 3, time.perf_counter)
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
    spec_model = humanoid_of(model)
    paths: Paths = {}
    data = [mujoco.MjData(spec_model) for _ in range(2)]

    def rollouts(h: float, threads: int) -> float:
        spec_model.opt.timestep = h
        steps = round(DURATION / h)
        at = h * np.arange(steps)
        control = np.stack([np.stack([np.interp(at, times, c) for c in r.T], axis=1) for r in references])
        begin = standing_on(spec_model, data[0], references[0][0])
        starts = np.repeat(begin[None], len(references), axis=0)
        states, _ = rollout.rollout(spec_model, data[:threads], initial_state=starts, control=control)
        every = round(0.01 / h)
        height = 0.6 * begin[3]
        paths[h] = [s[every - 1 :: every, 1:4] if (s[:, 3] > height).all() else None for s in states]
        return math.nan

    with quick_mujoco():
        return _rows(name, "mujoco rollout, implicitfast", len(references), rollouts, paths)


@look()
def _plot(path: Path, rows: list[Row]) -> None:
    figure, axes = subplots(7, 0.4 * len(rows) + 1.0)
    labels = [f"{r.robot}, {r.engine.split(',')[0]}, {r.threads} thread{'s' * (r.threads > 1)}" for r in rows]
    colors = ["C0" if "feather" in r.engine else "0.6" for r in rows]
    bars = axes.barh(range(len(rows)), [r.rate for r in rows], color=colors)
    ends = [f"±{1e3 * r.error:.2g} mm" if r.upright == 1.0 else f"{r.upright:.0%} upright" for r in rows]
    axes.bar_label(bars, [f"{r.rate:.0f}, {end}" for r, end in zip(rows, ends)], padding=3, fontsize=8)
    axes.set_yticks(range(len(rows)), labels, fontsize=8)
    axes.invert_yaxis()
    axes.margins(x=0.25)
    axes.set(xlabel=f"rollouts of {DURATION:g} s a second", title=f"Walking humanoid, step {1e3 * STEP:g} ms; error")
    save_figure(figure, path)
