"""Compare rollouts of a walking humanoid a second and core at equal error with MuJoCo, MJX and MotrixSim.

The robot of `benchmark walk`, simplified, walks 4 s from standing; the references differ by a little noise.  Ours has
MIPSD servos and runs eight rollouts a vector.  MuJoCo (`mujoco.rollout`), MJX (MuJoCo in JAX, float32, vectorised over
the rollouts) and MotrixSim (float32, batches of worlds) have the same robot with position servos of the same stiffness,
damping and reflected inertia, four spheres a sole: no gearbox spring, motor current and energy meter.

The walks differ, so each error is counted within one program: the largest deviation of the trunk's path from that
program's at 1/16 ms, the median of the rollouts that stay upright.  MJX is MuJoCo's model, and is compared with
MuJoCo's path, integrator by integrator.  The rate at an error is interpolated between steps on logarithmic scales.

All programs are timed in turn, round by round, in processor time: what else runs slows all alike.  With two threads
the rows state the processor time of a rollout over that with one, and how much faster the two were by the wall clock,
which counts only where nothing else runs.

Last, where the time goes in ours: instructions of a step of eight robots, counted exactly, while the scene grows from a
free body to what walks.

MJX and MotrixSim are measured where they are installed: pip install mujoco-mjx jax motrixsim

    featherstone-gait benchmark rollouts        ten minutes
"""

from __future__ import annotations

import math
import os
import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..base.progress import progress_bar
from ..model import Ground, Model
from ..robot_file import load_robot
from ..run.lane_engine import Queue
from ..run.reference import Reference
from ..run.simulate import simulate_stream, standing_state
from ..run.worlds import Distribution, Worlds
from ..scene.compile import IntegratorName, compile_scene
from .costs import Point, cheapest
from .engines import Lazy, humanoid_spec, integrators, mujoco, quick_mujoco, rollout, standing_on
from .skip import executed, free_arm
from .skip import rollout as prepared
from .table import installed, machine, tabulate
from .walk import DURATION, planned

Paths = np.ndarray  # of the trunk (rollouts, samples, 3) [m], every `EVERY`

COUNT, ROUNDS, ROUNDS_FULL = 16, 3, 9
EVERY = 0.01  # [s]
FINEST = 1e-3 / 16.0  # step of the references [s]
STEPS = (2e-3, 1e-3, 5e-4, 2.5e-4)
OURS: dict[IntegratorName, tuple[float, ...]] = {"midpoint": STEPS, "implicit_euler": STEPS}
THEIRS = (5e-3, 2e-3, 1e-3, 5e-4, 2.5e-4)
COARSE = (5e-3, 2e-3, 1e-3)  # of slower programs
ERRORS = (3e-3, 1e-3, 3e-4, 1e-4)  # [m]
FALLEN = 0.6  # of the height at the start
jax, mjx, motrix = Lazy("jax"), Lazy("mujoco.mjx"), Lazy("motrixsim")


class Engine(NamedTuple):
    """A program with one of its integrators."""

    name: str
    steps: Sequence[float]  # [s]
    walk: Callable[[float, int], Paths]  # of step and threads
    threads: Sequence[int]
    reference: str  # the engine whose path at the finest step is the right one, "" for none


class Row(NamedTuple):
    """One line of the table."""

    engine: Annotated[str, "engine", "<25"]
    step: Annotated[float, "ms", "7.3g"]  # [ms]
    error: Annotated[float, "error [m]", "9.1e"]
    upright: Annotated[float, "upright", "7.0%"]  # share of the rollouts that did not fall
    time: Annotated[float, "CPU ms", "9.4g"]  # of a rollout, one thread [ms]
    rate: Annotated[float, "1/s/core", "9.4g"]  # rollouts a second and core
    two: Annotated[float, "2 threads", "9.3f"]  # processor time of a rollout over that with one thread
    faster: Annotated[float, "faster", "7.2f"]  # by the wall clock


class Line(NamedTuple):
    """The rates of ours and of the best peer at an error."""

    error: Annotated[float, "at error [m]", "12.0e"]
    ours: Annotated[float, "ours 1/s/core", "13.4g"]
    peer: Annotated[float, "best peer", "9.4g"]
    ratio: Annotated[float, "ratio", "6.3g"]
    note: Annotated[str, "", "<2"]


class Part(NamedTuple):
    """Instructions of a step of eight robots."""

    part: Annotated[str, "a step of eight humanoids", "<52"]
    executed: Annotated[float, "instructions", "13.0f"]
    share: Annotated[float, "added", "7.1%"]  # of the last line's


def run(out_dir: Path, full: bool = False) -> list[Line]:
    """Print the tables; write rollouts.csv, rollouts_lines.csv and rollouts_parts.csv into `out_dir`."""
    model, host = load_robot("humanoid", locked="simplified"), machine()
    print(host)
    tabulate(out_dir / "rollouts_parts.csv", Part, parts(model), host)
    with quick_mujoco():
        rows = measured([*engines(model)], ROUNDS_FULL if full else ROUNDS)
    tabulate(out_dir / "rollouts.csv", Row, rows, host)
    return tabulate(out_dir / "rollouts_lines.csv", Line, lines(rows), host)


def measured(found: Sequence[Engine], rounds: int) -> list[Row]:
    """Find errors, and time all steps of all programs in turn."""
    exact = {one.name: one.walk(FINEST, 1) for one in progress_bar(found, "references") if one.reference == one.name}
    cases = [(one, step) for one in found for step in one.steps]
    paths = [one.walk(step, 1) for one, step in progress_bar(cases, "errors")]  # compiled by now
    turns = [[(one, step, threads) for one, step in cases for threads in one.threads] for _ in range(rounds)]
    spent: dict[tuple, list[tuple[float, float]]] = {}
    for one, step, threads in progress_bar([each for turn in turns for each in turn], "times"):
        cpu, wall = time.process_time(), time.perf_counter()
        one.walk(step, threads)
        took = time.process_time() - cpu, time.perf_counter() - wall
        spent.setdefault((one.name, step, threads), []).append(took)
    rows = []
    for (one, step), path in zip(cases, paths):
        upright = stands(path)
        error = deviation(path, exact.get(one.reference), upright)
        alone, both = (np.array(spent.get((one.name, step, n), [(math.nan, math.nan)])) for n in (1, 2))
        cpu = 1e3 * float(np.median(alone[:, 0])) / COUNT
        two, wall = (float(np.median(ratio)) for ratio in ((both / alone)[:, 0], (alone / both)[:, 1]))
        rows.append(Row(one.name, 1e3 * step, error, float(upright.mean()), cpu, 1e3 / cpu, two, wall))
    return rows


def stands(path: Paths) -> np.ndarray:
    """Return which rollouts (n,) stay upright."""
    return np.asarray((path[:, :, 2] > FALLEN * path[:, :1, 2]).all(axis=1))


def deviation(path: Paths, exact: Paths | None, upright: np.ndarray) -> float:
    """Return the median of the largest deviations [m] where both stay upright; NaN if less than half do."""
    if exact is None or (both := upright & stands(exact)).mean() < 0.5:
        return math.nan
    return float(np.median(np.abs(path - exact)[both].max(axis=(1, 2))))


def lines(rows: Sequence[Row]) -> list[Line]:
    """Compare ours with the best peer at each error."""
    points = [Point("", row.engine, row.step, row.error, row.time) for row in rows if row.upright == 1.0]
    found = []
    for error in ERRORS:
        ours, method = cheapest(error, points, "", lambda name: name in OURS)
        theirs, peer = cheapest(error, points, "", lambda name: name not in OURS)
        ratio = theirs / ours if math.isfinite(ours) else math.nan
        found.append(Line(error, 1e3 / ours, 1e3 / theirs, ratio, f"{method}, {peer}"))
    return found


# ---------------------------------------------------------------------------------------------- programs


def engines(model: Model, vectors: bool = True) -> Iterator[Engine]:
    """Yield the programs that are installed, ours first; vectors: also those that step all rollouts in a vector."""
    times, references = planned(model, COUNT)
    threads = (1, 2) if (os.cpu_count() or 1) > 1 else (1,)
    for own, steps in OURS.items():
        yield Engine(own, steps, our_walk(model, own, times, references), threads, own)
    if not installed("mujoco"):
        return
    for label, kind in integrators("Euler", "implicitfast", "discrete"):
        spec = humanoid_spec(model)
        spec.option.integrator = kind
        name = f"MuJoCo {label}"
        yield Engine(name, THEIRS, mujoco_walk(spec.compile(), times, references), threads, name)
    if not vectors:
        return
    spec = humanoid_spec(model)
    if installed("mujoco.mjx") and installed("jax"):
        walk = mjx_walk(spec.compile(), times, references)
        yield Engine("MJX implicitfast", COARSE, walk, (1,), "MuJoCo implicitfast")
    else:
        print("MJX is not installed")
    if installed("motrixsim"):
        yield Engine("MotrixSim", COARSE, motrix_walk(spec, times, references), (1,), "")
    else:
        print("MotrixSim is not installed")


def our_walk(
    model: Model, integrator: IntegratorName, times: np.ndarray, references: Sequence[np.ndarray]
) -> Callable[[float, int], Paths]:
    """Walk in this package."""
    scene_of = cache(lambda h: compile_scene(model, "mipsd", Ground(), integrator, h))
    knots = [Reference(times, values) for values in references]

    def walk(h: float, threads: int) -> Paths:
        scene, queue = scene_of(h), Queue(len(knots))
        state = standing_state(scene, references[0][0])
        simulate_stream(
            scene, DURATION, queue, lambda k: (state, knots[k]), lambda r: r["base_q"][1:, :3], record=("base_q",),
            record_interval=EVERY, threads=threads,
        )  # fmt: skip
        fallen = np.zeros((round(DURATION / EVERY), 3))
        return np.array([fallen if len(path) < len(fallen) else path for path in queue.answers])

    return walk


def interpolated(times: np.ndarray, references: Sequence[np.ndarray], h: float) -> np.ndarray:
    """Return the references (rollouts, steps, nj) at each step."""
    at = h * np.arange(round(DURATION / h))
    return np.stack([np.stack([np.interp(at, times, c) for c in one.T], axis=1) for one in references])


def mujoco_walk(m: Any, times: np.ndarray, references: Sequence[np.ndarray]) -> Callable[[float, int], Paths]:
    """Walk in MuJoCo's threaded rollout."""
    data = [mujoco.MjData(m) for _ in range(2)]
    begin = standing_on(m, data[0], references[0][0])
    control = cache(lambda h: interpolated(times, references, h))

    def walk(h: float, threads: int) -> Paths:
        m.opt.timestep = h
        starts = np.repeat(begin[None], len(references), axis=0)
        states, _ = rollout.rollout(m, data[:threads], initial_state=starts, control=control(h))
        every = round(EVERY / h)
        return np.asarray(states[:, every - 1 :: every, 1:4])

    return walk


def mjx_walk(m: Any, times: np.ndarray, references: Sequence[np.ndarray]) -> Callable[[float, int], Paths]:
    """Walk in MJX: a vector of all rollouts, on one thread."""
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    d = mujoco.MjData(m)
    begin = standing_on(m, d, references[0][0])
    mujoco.mj_setState(m, d, begin, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    mujoco.mj_forward(m, d)
    robot, start, jp = mjx.put_model(m), mjx.put_data(m, d), jax.numpy
    knots = jp.array(interpolated(times, references, EVERY))  # linear between these too

    def path(h: Any, every: Any, angles: Any) -> Any:
        stepped = robot.replace(opt=robot.opt.replace(timestep=h))

        def sample(state: Any, k: Any) -> tuple[Any, Any]:
            slope = (angles[jp.minimum(k + 1, len(angles) - 1)] - angles[k]) / every
            body = lambda i, s: mjx.step(stepped, s.replace(ctrl=angles[k] + i * slope))  # noqa: E731
            state = jax.lax.fori_loop(0, every, body, state)
            return state, state.qpos[:3]

        return jax.lax.scan(sample, start, jp.arange(len(angles)))[1]

    together = jax.jit(jax.vmap(path, in_axes=(None, None, 0)))
    return lambda h, _: np.array(together(h, round(EVERY / h), knots))


def motrix_walk(spec: Any, times: np.ndarray, references: Sequence[np.ndarray]) -> Callable[[float, int], Paths]:
    """Walk in MotrixSim: a batch of all rollouts, on one thread."""
    m = spec.compile()
    begin = standing_on(m, mujoco.MjData(m), references[0][0])[1 : 1 + m.nq]
    root = ET.fromstring(spec.to_xml())
    for drive, gain, bias in zip(root.iter("general"), m.actuator_gainprm, m.actuator_biasprm):
        drive.tag = "position"
        for name in ("input", "biastype", "gainprm", "biasprm"):
            drive.attrib.pop(name, None)
        drive.set("kp", f"{gain[0]:.9g}")
        drive.set("kv", f"{-bias[2]:.9g}")
    motrix.init_thread_pool(1)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "humanoid.xml"
        file.write_text(ET.tostring(root, encoding="unicode"), "utf-8")
        robot = motrix.load_model(str(file))
    control = cache(lambda h: interpolated(times, references, h).astype(np.float32).swapaxes(0, 1).copy())

    def walk(h: float, _: int) -> Paths:
        robot.options.timestep = h
        data, every = motrix.SceneData(robot, batch=[len(references)]), round(EVERY / h)
        data.set_dof_pos(np.tile(begin[[0, 1, 2, 4, 5, 6, 3, *range(7, m.nq)]], (len(references), 1)), robot)
        path = []
        for k, angles in enumerate(control(h)):
            data.actuator_ctrls = angles
            robot.step(data)
            if (k + 1) % every == 0:
                path.append(np.array(data.dof_pos)[:, :3])
        return np.stack(path, axis=1)

    return walk


# ---------------------------------------------------------------------------------------------- parts


def parts(model: Model) -> Iterator[Part]:
    """Count a step of eight robots, from a body in free flight to robots that stand in worlds that differ."""
    body, ground, narrow = free_arm("humanoid", "simplified"), Ground(), Distribution("uniform", 1e-13)
    grounds = dict.fromkeys(("friction", "penetration", "damping_ratio"), narrow)
    servos = dict.fromkeys(("resistance", "inductance", "motor_constant", "voltage_limit", "stiffness", "Kp"), narrow)
    links = dict.fromkeys(("mass", "center_of_mass", "inertia"), narrow)
    alike = Worlds(8)
    how: dict[str, Any] = {"integrator": "midpoint", "record": ("base_q",), "worlds": alike}
    stages = {
        "body in free flight: tree, state, energies": prepared(body, **how),
        "+ stops and friction of joints": prepared(replace(model, servos={}), **how),
        "+ servos, gears rigid": prepared(model, "rotor", **how),
        "+ elastic gears (mipsd)": prepared(model, "mipsd", **how),
        "+ ground out of reach": prepared(model, "mipsd", ground, lifted=10.0, **how),
        "+ standing on the ground": prepared(model, "mipsd", ground, **how),
        "+ worlds of servos and ground": prepared(
            model, "mipsd", ground, **how | {"worlds": Worlds(8, servos=servos, ground=grounds)}
        ),
        "+ worlds of inertias": prepared(
            model, "mipsd", ground, **how | {"worlds": Worlds(8, servos=servos, ground=grounds, links=links)}
        ),
    }  # fmt: skip
    counts = [executed(work) for work in stages.values()]
    for name, count, before in zip(stages, counts, [0.0, *counts]):
        yield Part(name, count, (count - before) / counts[-1])
