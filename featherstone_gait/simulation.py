"""From a model to a trajectory.

    scene = compile_scene(model, servos="mipsd", ground=Ground())
    trajectory = simulate(scene, 2.0, reference=Reference(times, angles))

A scene fixes robot, servos, ground, integrator and step; a simulation is then one call of compiled code.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from .core import layout, pace, rollout
from .core.adaptive import rollout_adaptive
from .core.contact import SCRATCH as CONTACT_SCRATCH
from .core.controller import PID_SPEED
from .core.dormand_prince import ROWS
from .core.extrapolation import LONGEST, Ladder
from .core.knots import Knots, Signals
from .core.lanes import WIDTH, aligned
from .core.push import END, PUSH_COLUMNS
from .core.step import SCRATCH as JOINT_SCRATCH
from .dynamics import forward_kinematics
from .lane_engine import Queue, Source, run_lanes
from .reference import Reference
from .scene import CompiledScene
from .trajectory import Trajectory, with_error

# Channel -> part of the state; those of one number a joint, contact point, ... in the model's order.
PARTS = tuple(name for name in layout.STATE.names if name not in ("length", "pace", "status", "end", "last_error"))
STATUS = {
    rollout.OK: "ok",
    rollout.FELL: "fell",
    rollout.DIVERGED: "diverged",
    rollout.TOO_SMALL: "step too small",
}
RTOL = 1e-8  # of integrators with error control
LEAST_STEP = 1e-9  # [s]
FIRST_STEP, FIRST_COLUMNS = 1e-3, 5  # where error control begins [s]
RK4_LIMIT = 1.39  # of the explicit limit 2 / lambda: RK4's stability interval is 2.785 / lambda
BATCH = 32  # runs that an executor is given at a time
CHATTER_LIMIT = 0.05  # [rad/s or m/s]; see `worst_chatter` in core/layout.py
# The midpoint rule rings about the right mean after an impact; there the limit is the angle that this moves a joint to
# and fro, half of what counts as a wrong result [rad or m].
RINGING_LIMIT = 5e-4


class Push(NamedTuple):
    """An external force on a link from `start` to `end`."""

    link: str
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)  # world axes [N]
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)  # world axes [N m]
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)  # where it acts, link frame [m]
    start: float = 0.0  # [s]
    end: float = math.inf  # [s]


def initial_state(scene: CompiledScene, q=None, qd=None) -> np.ndarray:
    """The whole state (size,) of a robot at positions q and velocities qd; zero where None.

    A floating robot over ground whose q is None stands with its lowest contact point sunk in by the ground's
    `sinking`.  Rotors turn with their joints, currents and bristles are zero.
    """
    model, o, n = scene.model, scene.layout, scene.tree.n
    y = np.zeros(int(o["length"]))
    y[o["pace"] + np.array([pace.STEP, pace.COLUMNS, pace.LAST])] = FIRST_STEP, FIRST_COLUMNS, 1e-4
    default = np.zeros(model.nq)
    if model.base == "floating":
        default[3] = 1.0
        if scene.ground is not None and q is None:
            default[2] = _standing_height(scene, default)
    q = _vector("q", default if q is None else q, model.nq)
    qd = _vector("qd", np.zeros(model.nv) if qd is None else qd, model.nv)
    if model.base == "floating" and not np.linalg.norm(q[3:7]) > 1e-6:
        raise ValueError(f"{model.name}: the base's quaternion q[3:7] is {q[3:7]}; [1, 0, 0, 0] is no rotation")
    y[o["q"] : o["q"] + n] = q[-n:] if n else ()
    y[o["qd"] : o["qd"] + n] = qd[-n:] if n else ()
    if model.base == "floating":
        y[o["base_q"] : o["base_q"] + 7], y[o["base_qd"] : o["base_qd"] + 6] = q[:7], qd[:6]
        y[o["base_q"] + 3 : o["base_q"] + 7] /= np.linalg.norm(q[3:7])
    if scene.constants.servo is not None:
        y[o["filtered"] : o["filtered"] + n] = qd[-n:]
    if scene.constants.gear is not None:
        y[o["rotor"] : o["rotor"] + n], y[o["rotor_speed"] : o["rotor_speed"] + n] = q[-n:], qd[-n:]
    return y


def standing_state(scene: CompiledScene, angles) -> np.ndarray:
    """The whole state of a floating robot at rest over the origin: base upright, joints at `angles`, on the ground.

    Raises ValueError for a fixed base, without ground and for angles that do not fit.
    """
    model = scene.model
    if model.base != "floating" or scene.ground is None:
        raise ValueError(f"{model.name}: only a floating robot over ground stands; its base is {model.base}")
    q = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, *_vector("angles", angles, scene.tree.n)])
    q[2] = _standing_height(scene, q)
    return initial_state(scene, q)


def _vector(name: str, value, width: int) -> np.ndarray:
    a = np.array(value, dtype=float)
    if a.shape != (width,) or not np.isfinite(a).all():
        shown = np.array2string(a, threshold=20)
        raise ValueError(f"{name} must be {width} finite numbers; its shape is {a.shape}: {shown}")
    return a


def _standing_height(scene: CompiledScene, q: np.ndarray) -> float:
    """Height of the base at which the lowest contact point has sunk in as far as the ground allows."""
    poses = forward_kinematics(scene.model, q)
    names = [link.name for link in scene.model.links]
    ground = scene.ground
    clearances = []
    for point in scene.model.contacts:
        k = names.index(point.link)
        x = poses.position[k] + poses.rotation[k] @ np.array(point.position)
        surface = ground.height + math.tan(ground.slope) * x[0]
        along = math.cos(ground.slope) * x[0] + math.sin(ground.slope) * surface
        rises = sum(rise for start, rise in ground.steps if along > start)
        clearances.append(x[2] - surface - rises / math.cos(ground.slope))
    return -min(clearances) - ground.sinking / math.cos(ground.slope)


def simulate(
    scene: CompiledScene,
    duration: float,
    state=None,
    reference: Reference | None = None,
    tau=None,
    pushes: Sequence[Push] = (),
    record: Iterable[str] = ("q", "qd"),
    sample: float | None = None,
    noise=None,
    rtol: float | None = None,
    atol: float | None = None,
    estimate_error: bool = False,
) -> Trajectory:
    """Run the scene for `duration` [s], rounded up to whole controller ticks.

    state: what `initial_state` or an earlier `Trajectory.final` gave; reference: joint angles for the servos, None
    holds the initial ones; tau: (joints,) constant torques or a `Reference` of torques [N m]; pushes: external forces;
    record: channels, any of `PARTS`; sample: time between records [s], a multiple of the step (a tick if None);
    noise: (ticks, joints, 2), added at each controller tick to the measured angle [rad] and to the voltage [V];
    rtol, atol: error allowed in a step, relative and absolute [rad, m, and their rates; A; J], of an integrator that
    chooses its steps (atol is rtol if None); given for a scene of fixed steps, they choose such an integrator for this
    run: "extrapolation" if it is stiff, else "dop853";
    estimate_error: simulate again with half the step, or a tenth of the tolerances, for `Trajectory.error`.
    Raises ValueError on arguments that do not fit.  A run that fails says so in its status.
    """
    return simulate_batch(
        scene, duration, [state], [reference], [tau], pushes, record, sample, None, [noise], rtol, atol, estimate_error
    )[0]


def simulate_batch(
    scene: CompiledScene,
    duration: float,
    states=None,
    references=None,
    taus=None,
    pushes: Sequence[Push] = (),
    record: Iterable[str] = ("q", "qd"),
    sample: float | None = None,
    executor: Executor | None = None,
    noises=None,
    rtol: float | None = None,
    atol: float | None = None,
    estimate_error: bool = False,
) -> list[Trajectory]:
    """`simulate` for many states, references or torques at once: eight to a vector, vectors over threads.

    The lists must be equally long, or None.  Each run has the same bits as alone.  Where the controllers are sampled, a
    lane whose run has ended takes the next; runs with continuous servos, torques or pushes share a vector if their
    references have the same knot times; with error control each run has its own steps, and none share a vector.
    executor: any `concurrent.futures.Executor` in place of the threads.
    """
    scene, rtol, atol = _accuracy(scene, rtol, atol)
    if estimate_error:
        given = (states, references, taus, pushes, record)
        return _with_errors(scene, duration, given, sample, executor, noises, rtol, atol)
    given = (states, references, taus, noises)
    n = max((len(x) for x in given if x is not None), default=1)
    columns = [[None] * n if x is None else list(x) for x in given]
    if any(len(column) != n for column in columns):
        lengths = [len(column) for column in columns]
        raise ValueError(f"states, references, taus and noises have {lengths} entries; give as many of each")
    driven = any(tau is not None for tau in columns[2])
    course = _course(scene, duration, sample, driven)._replace(rtol=rtol or 0.0, atol=atol or 0.0)
    runs = [_Run.prepared(scene, course, *row) for row in zip(*columns)]
    if len({run.noise is None for run in runs}) > 1:
        raise ValueError("noises: some runs have noise and some have none; give all of them an array, or none")
    channels, slices = _channels(scene, tuple(record))
    scene = scene.pushed(_push_arrays(scene, pushes))
    if executor is None and _refills(scene, runs):
        results = _run_refilled(scene, course, channels, runs, os.cpu_count() or 1)
    else:
        results = _run_grouped(scene, course, channels, runs, executor)
    return [_trajectory(scene, course, slices, y, out) for y, out in results]


def _with_errors(scene, duration, given, sample, executor, noises, rtol, atol) -> list[Trajectory]:
    """The runs, and the same in half the steps: of integrators with error control also to a tenth of the tolerance."""
    sample = scene.tick_steps * scene.timestep if sample is None else sample
    runs = simulate_batch(scene, duration, *given, sample, executor, noises, rtol, atol)
    if not scene.adaptive:
        finer = scene.recompiled(timestep=0.5 * scene.timestep)
        better = simulate_batch(finer, duration, *given, sample, executor, noises)
        return [with_error(run, fine, 2.0) for run, fine in zip(runs, better)]
    finer = scene.recompiled(timestep=0.5 * scene.timestep)  # steps end on records: twice as many
    better = simulate_batch(finer, duration, *given, 0.5 * sample, executor, noises, 0.1 * rtol, 0.1 * atol)
    return [with_error(run, _each(fine, 2), 1.1) for run, fine in zip(runs, better)]


def _each(run: Trajectory, count: int) -> Trajectory:
    """The run with only each so many-th record."""
    return dataclasses.replace(run, channels={name: values[::count] for name, values in run.channels.items()})


def _accuracy(scene: CompiledScene, rtol: float | None, atol: float | None):
    """The scene with an integrator that can meet the tolerances, and these; None for fixed steps."""
    if rtol is None and atol is not None:
        raise ValueError(f"atol is {atol!r} but rtol is not given; give rtol too")
    for name, value in (("rtol", rtol), ("atol", atol)):
        if value is not None and not 1e-14 <= value <= 1.0:
            raise ValueError(f"{name} is {value!r}; it must lie between 1e-14 and 1")
    if rtol is not None and not scene.adaptive:
        if scene.integrator == "simtwo":
            raise ValueError(
                "simtwo is an order of updates at a fixed step, not a differential equation; without rtol and atol"
            )
        scene = scene.recompiled(integrator="extrapolation" if scene.stiff else "dop853")
    if not scene.adaptive:
        return scene, None, None
    rtol = RTOL if rtol is None else rtol
    return scene, rtol, rtol if atol is None else atol


def simulate_stream(
    scene: CompiledScene,
    duration: float,
    source: Source,
    begin: Callable[[Any], tuple[np.ndarray, Reference]],
    end: Callable[[Trajectory], Any],
    record: Iterable[str] = ("q", "qd"),
    sample: float | None = None,
    threads: int | None = None,
) -> float:
    """Simulate what `source` hands out, in all lanes of all cores, until there is no more.

    `begin(key)` returns the state and the reference of a run, `end(trajectory)` the answer that the source is given.  A
    run that it wants no longer is given up within `lane_engine.SEGMENT` ticks.  Each run has the bits that `simulate`
    gives it.  Duration, record and sample are those of `simulate`; threads: one a core if None.  Returns the share of
    the lane-steps that a run was in.  Raises ValueError for a scene without sampled servos.
    """
    if not streams(scene):
        raise ValueError(
            f"{scene.model.name}: a stream needs sampled servos, fixed steps and no pushes; use simulate_batch"
        )
    course = _course(scene, duration, sample)
    channels, slices = _channels(scene, tuple(record))

    def prepared(key):
        return _Run.prepared(scene, course, *begin(key), None, None)

    def ended(y, out):
        return end(_trajectory(scene, course, slices, y, out))

    return _drive_lanes(scene, course, channels, source, prepared, ended, threads or os.cpu_count() or 1)


def streams(scene: CompiledScene) -> bool:
    """Whether lanes may be at different times: nothing but the controllers' ticks depends on the time."""
    return scene.constants.push is None and scene.constants.servo is not None and not scene.adaptive


def _refills(scene: CompiledScene, runs: list[_Run]) -> bool:
    return streams(scene) and all(run.torques is None for run in runs) and len(runs) > 2


def _run_refilled(scene: CompiledScene, course: rollout.Plan, channels: np.ndarray, runs: list[_Run], threads: int):
    """Final state and records of each run; every thread drives one vector and takes runs from the same queue."""
    queue, threads = Queue(len(runs)), min(threads, -(-len(runs) // WIDTH))
    _drive_lanes(scene, course, channels, queue, runs.__getitem__, lambda y, out: (y, out), threads)
    return queue.answers


def _drive_lanes(scene: CompiledScene, course: rollout.Plan, channels, source: Source, begin, end, threads) -> float:
    """`run_lanes` in every thread; return the share of the lane-steps that were used."""

    def work(_=None):
        try:
            return run_lanes(scene, course, channels, source, begin, end, _scratch(scene, _lane_zeros))
        except BaseException:
            source.close()  # or the other threads would go on
            raise

    if threads == 1:
        counts = [work()]
    else:
        with ThreadPoolExecutor(threads) as pool:
            counts = list(pool.map(work, range(threads)))
    used, there = np.sum(counts, axis=0)
    return float(used / max(there, 1))


def _run_grouped(scene: CompiledScene, course: rollout.Plan, channels: np.ndarray, runs: list[_Run], executor):
    """Final state and records of each run; groups of runs go to the executor, by default to threads."""
    groups = _groups(scene, runs, _refills(scene, runs))
    work = functools.partial(_run_group, scene, course, channels)
    batches = [[runs[i] for i in group] for group in groups]
    if executor is None and len(groups) > 1:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            done = list(pool.map(work, batches))
    else:
        done = list((executor.map if executor else map)(work, batches))
    results: list = [None] * len(runs)
    for group, members in zip(groups, done):
        for i, result in zip(group, members):
            results[i] = result
    return results


class _Run(NamedTuple):
    """What one simulation starts from."""

    y: np.ndarray
    reference: Knots | None
    torques: Knots | None
    noise: np.ndarray | None

    @classmethod
    def prepared(cls, scene: CompiledScene, course: rollout.Plan, state, reference, tau, noise) -> _Run:
        n, o = scene.tree.n, scene.layout
        y = initial_state(scene) if state is None else _vector("state", state, int(o["length"]))
        driven = scene.constants.servo is not None or scene.constants.pd is not None
        if reference is not None and not driven:
            raise ValueError(f"{scene.model.name}: a reference needs servos; compile the scene with servos=...")
        if reference is None and driven:
            reference = Reference([0.0], y[None, o["q"] : o["q"] + n])
        if reference is not None and not isinstance(reference, Reference):
            raise ValueError(f"reference is a {type(reference).__name__}; give Reference(times, values)")
        if tau is not None and scene.integrator == "simtwo":
            raise ValueError("simtwo takes its torques from the servos alone; use implicit_euler for scenes with tau")
        if tau is not None and not isinstance(tau, Reference):
            tau = Reference([0.0], _vector("tau", tau, n)[None])
        for what, signal in (("reference", reference), ("tau", tau)):
            if signal is not None and signal.values.shape[1] != n:
                raise ValueError(
                    f"{scene.model.name}: {what} has {signal.values.shape[1]} columns; the robot has {n} joints: "
                    f"{', '.join(scene.model.joint_names)}"
                )
        noise = _checked_noise(scene, course, noise)
        run = cls(y, reference.knots() if reference else None, tau.knots() if tau else None, noise)
        return run._replace(y=_with_first_error(scene, run))


def _checked_noise(scene: CompiledScene, course: rollout.Plan, noise):
    if noise is None:
        return None
    if scene.constants.servo is None:
        raise ValueError(f"{scene.model.name}: noise acts on sampled servos; this scene has none")
    noise, shape = np.array(noise, dtype=float), (course.steps // course.per_tick, scene.tree.n, 2)
    if noise.shape != shape or not np.isfinite(noise).all():
        raise ValueError(f"{scene.model.name}: noise must be {shape} finite numbers; its shape is {noise.shape}")
    return noise


def _with_first_error(scene: CompiledScene, run: _Run) -> np.ndarray:
    """The controllers' last error at the start, so that a derivative term sees no jump."""
    if scene.constants.servo is None or run.y[scene.layout["end"]] > 0:  # there is none, or it goes on
        return run.y
    n, o, y = scene.tree.n, scene.layout, run.y.copy()
    speed = scene.constants.law == PID_SPEED
    error = np.where(speed, 0.0, run.reference.cubics[0, :, 0]) - np.where(
        speed, y[o["qd"] : o["qd"] + n], y[o["q"] : o["q"] + n]
    )
    y[o["last_error"] : o["last_error"] + n] = error
    return y


def _course(scene: CompiledScene, duration: float, sample: float | None, driven: bool = False) -> rollout.Plan:
    """The run in whole steps, ticks and samples; driven: by torques from outside."""
    h, tick = scene.timestep, scene.tick_steps
    if not 0 < duration < math.inf:
        raise ValueError(f"duration is {duration!r} s; it must be positive and finite")
    ticks = math.ceil(duration / (tick * h) - 1e-9)
    every = tick if sample is None else round(sample / h)
    if every < 1 or (sample is not None and abs(every * h - sample) > 1e-9 * sample):
        raise ValueError(f"sample is {sample!r} s; it must be a whole number of steps of {h:g} s")
    least = 0.0 if scene.model.base == "fixed" else scene.fall_height
    upright = -2.0 if scene.model.base == "fixed" else scene.fall_upright
    plan = rollout.Plan(h, scene.theta, ticks * tick, tick, every, scene.lag, least, upright)
    if not scene.adaptive:
        return plan
    o, acts = scene.layout, scene.constants
    works = any(part is not None for part in (acts.servo, acts.pd, acts.friction, acts.stops, acts.points)) or driven
    return plan._replace(least_step=LEAST_STEP, integrated=int(o["voltage" if works else "energy"]))


def _channels(scene: CompiledScene, record: tuple[str, ...]) -> tuple[np.ndarray, dict[str, slice]]:
    """Indices into the state of all recorded numbers, and each channel's place among them."""
    indices: list[int] = []
    slices = {}
    for name in record:
        if name not in PARTS:
            raise ValueError(f"record: there is no channel {name!r}; channels: {', '.join(PARTS)}")
        places = np.arange(*scene.part(name))
        if name in ("contact_force", "bristle") and len(places):  # the scene keeps the points of a body together
            rows = [scene.tree.placements[point.link].row for point in scene.model.contacts]
            order = np.argsort(np.argsort(rows, kind="stable"))
            places = places.reshape(len(rows), -1)[order].ravel()
        slices[name] = slice(len(indices), len(indices) + len(places))
        indices.extend(places)
    return np.array(indices, dtype=np.int64), slices


def _push_arrays(scene: CompiledScene, pushes: Sequence[Push]):
    """Rows of numbers and the body of each push, None without pushes."""
    if not pushes:
        return None
    table, rows = np.zeros((len(pushes), PUSH_COLUMNS)), np.zeros(len(pushes), np.int64)
    for k, push in enumerate(pushes):
        if push.link not in scene.tree.placements:
            raise ValueError(f"push: no link {push.link!r}; links: {', '.join(scene.tree.placements)}")
        place = scene.tree.placements[push.link]
        point = place.r + place.E @ np.array(push.point)
        table[k] = (*point, *push.moment, *push.force, push.start, push.end)
        rows[k] = place.row
        if not np.isfinite(table[k, :END]).all() or not push.start <= push.end:
            raise ValueError(f"push on {push.link}: give finite numbers, and a start before the end: {push}")
    return table, rows


def _groups(scene: CompiledScene, runs: list[_Run], refills: bool) -> list[list[int]]:
    """Indices of the runs that go together; small rests alone."""
    alike: dict[tuple, list[int]] = {}
    for i, run in enumerate(runs):
        key = () if refills else tuple(k and (k.times.tobytes(), k.period) for k in (run.reference, run.torques))
        if scene.adaptive:
            key = (i,)
        alike.setdefault(key, []).append(i)
    size = BATCH if refills else WIDTH
    groups = []
    for members in alike.values():
        for k in range(0, len(members), size):
            part = members[k : k + size]
            groups.extend([part] if len(part) > 2 else [[i] for i in part])
    return groups


def _run_group(scene: CompiledScene, course: rollout.Plan, channels: np.ndarray, runs: list[_Run]):
    """Final state and records of the runs of one group."""
    if len(runs) == 1:
        y, out = runs[0].y.copy(), np.zeros((course.steps // course.per_sample + 1, len(channels)))
        signals = _signals(scene, runs[0].reference, runs[0].torques, np.zeros)._replace(noise=runs[0].noise)
        scratch = _scratch(scene, np.zeros, signals.tau is not None)
        run = rollout_adaptive if scene.adaptive else rollout.rollout_one
        run(scene.constants, scene.offsets, course, signals, y, scratch, channels, out)
        return [(y, out)]
    if _refills(scene, runs):
        return _run_refilled(scene, course, channels, runs, 1)
    return _run_together(scene, course, channels, runs)


def _run_together(scene: CompiledScene, course: rollout.Plan, channels: np.ndarray, runs: list[_Run]):
    """Up to eight runs of references with the same knot times, in step."""
    count, samples = len(runs), course.steps // course.per_sample + 1
    runs = runs + [runs[-1]] * (WIDTH - count)
    y, out = aligned((len(runs[0].y), WIDTH)), aligned((samples, max(len(channels), 1), WIDTH))
    y[:] = np.stack([run.y for run in runs], axis=-1)
    references, torques = (_in_lanes(list(knots)) for knots in zip(*(run[1:3] for run in runs)))
    noise = None if runs[0].noise is None else aligned((*runs[0].noise.shape, WIDTH))
    if noise is not None:
        noise[:] = np.stack([run.noise for run in runs], axis=-1)
    signals = _signals(scene, references, torques, _lane_zeros)._replace(noise=noise)
    scratch = _scratch(scene, _lane_zeros)
    rollout.rollout_lanes(scene.constants, scene.offsets, course, signals, y, scratch, channels, out)
    return [(y[:, lane].copy(), out[:, : len(channels), lane].copy()) for lane in range(count)]


def _lane_zeros(shape) -> np.ndarray:
    return aligned((*np.atleast_1d(shape), WIDTH))


def _in_lanes(knots: list[Knots | None]) -> Knots | None:
    if knots[0] is None:
        return None
    cubics = aligned((*knots[0].cubics.shape, WIDTH))
    cubics[:] = np.stack([k.cubics for k in knots], axis=-1)
    return knots[0]._replace(cubics=cubics)


def _signals(scene: CompiledScene, reference, torques, zeros) -> Signals:
    n = scene.tree.n
    values, tau = (None, None) if torques is None else (zeros((n, 2)), zeros(n))
    continuous = True if scene.constants.pd is not None else None
    return Signals(reference, zeros((n, 2)), torques, values, tau, None, None, continuous)


def _scratch(scene: CompiledScene, zeros, driven: bool = False) -> rollout.Scratch:
    """What a step overwrites; driven: by torques from outside."""
    n, model, o = scene.tree.n, scene.model, scene.layout
    points = 0 if scene.constants.points is None else len(scene.constants.points)
    if scene.integrator == "extrapolation":
        zeros = _lane_zeros
    stages = {"rk4": (3, int(o["voltage"])), "dop853": (ROWS, int(o["increment"]))}.get(scene.integrator)
    return rollout.Scratch(
        zeros(scene.tree.workspace_shape()),
        zeros((JOINT_SCRATCH, max(n, 1))),
        zeros((max(points, 1), CONTACT_SCRATCH)),
        zeros((n + 1, 6)),
        zeros(model.nq + model.nv) if scene.integrator == "midpoint" else None,
        zeros(stages) if stages else None,
        zeros(n) if scene.integrator == "simtwo" else None,
        np.zeros(int(o["length"])) if scene.adaptive else zeros(int(o["length"])),
        _ladder(scene, driven) if scene.integrator == "extrapolation" else None,
        np.zeros(pace.PACE_SCRATCH) if scene.adaptive else None,
    )


def _ladder(scene: CompiledScene, driven: bool) -> Ladder:
    o, servo, n = scene.layout, scene.constants.servo, scene.tree.n
    size, rates = int(o["length"]), int(o["voltage"])
    if servo is not None:
        parameters = _lane_zeros(servo.shape)
        parameters[:] = servo[..., None]
    return Ladder(
        start=np.zeros(size),
        best=np.zeros(size),
        table=np.zeros((LONGEST, size)),
        lanes=np.zeros((3, WIDTH), np.int64),
        wanted=np.zeros(LONGEST),
        y=_lane_zeros(size),
        h=_lane_zeros(1),
        last=_lane_zeros(1),
        slope=_lane_zeros(rates),
        first=_lane_zeros(rates),
        previous=_lane_zeros(rates),
        drive=_lane_zeros((n, 2)),
        tau=_lane_zeros(n) if driven else None,
        servo=None if servo is None else parameters,
        implicit=True if scene.stiff else None,
    )


def _trajectory(scene: CompiledScene, course: rollout.Plan, slices, y: np.ndarray, out: np.ndarray) -> Trajectory:
    """Name the channels and say how the run ended."""
    o = scene.layout
    channels = {"time": np.arange(len(out)) * (course.per_sample * course.h)}
    channels.update({name: scene.shaped(name, out[:, where]) for name, where in slices.items()})
    status, message, end = _verdict(scene, course, y)
    info = {
        "robot": scene.model.name,
        "joints": list(scene.model.joint_names),
        "integrator": scene.integrator,
        "timestep": scene.timestep,
        "reason": scene.preflight.reason,
        "servos": scene.servos,
        "worst_chatter": float(max(y[slice(*scene.part("worst_chatter"))], default=0.0)),
        "newton_passes": float(y[o["passes"]]),
        "not_converged_steps": float(y[o["passes"] + 1]),
    }
    if scene.adaptive:
        taken, rejected, evaluations = y[o["pace"] + pace.STEPS : o["pace"] + pace.LAST]
        info |= {"rtol": course.rtol, "atol": course.atol}
        info |= {"steps": int(taken), "rejected_steps": int(rejected), "evaluations": int(evaluations)}
    return Trajectory(channels, status, message, end, y, info)


def _verdict(scene: CompiledScene, course: rollout.Plan, y: np.ndarray) -> tuple[str, str, float]:
    o, end = scene.layout, course.steps * course.h
    code = int(y[o["status"]])
    if code != rollout.OK:
        status, message = STATUS[code], f"{scene.model.name} {STATUS[code]} at {y[o['end']]:.4g} s"
        if code == rollout.TOO_SMALL:
            message = f"{scene.model.name}: the tolerance asks for steps below {LEAST_STEP:g} s at {y[o['end']]:.4g} s"
        speeds = np.abs(y[slice(*scene.part("qd"))])
        if code == rollout.DIVERGED and len(speeds):
            joint = scene.model.joint_names[int(speeds.argmax())]
            message += f"; in the last sound state the fastest joint was {joint} at {speeds.max():.3g} rad/s or m/s"
        return status, message, float(y[o["end"]])
    largest = RK4_LIMIT * scene.preflight.largest_explicit_step
    if scene.integrator == "rk4" and scene.timestep > largest:
        return (
            "not converged",
            f"rk4 is stable up to {largest:.2g} s in this scene; the step is {scene.timestep:g} s",
            end,
        )
    if (joint := _unresolved_stop(scene, y)) is not None:
        return (
            "not converged",
            f"{joint} ran into its stop, which {scene.integrator} does not resolve at {scene.timestep:g} s: "
            "use implicit_euler or a smaller step",
            end,
        )
    chatter = y[slice(*scene.part("worst_chatter"))]
    limit = CHATTER_LIMIT
    if scene.integrator == "midpoint":
        limit = max(limit, RINGING_LIMIT / scene.timestep)
    if len(chatter) and chatter.max() > limit:
        joint = scene.model.joint_names[int(chatter.argmax())]
        return (
            "chatter",
            f"the speed of {joint} alternated by {chatter.max():.3g} rad/s from step to step (limit {limit:.3g}): "
            f"a step of {scene.timestep:g} s is too large for {scene.integrator} in this scene",
            end,
        )
    if y[o["passes"] + 1] > 0:
        return "not converged", f"{y[o['passes'] + 1]:.0f} implicit steps missed their tolerance", end
    return "ok", "", end


def _unresolved_stop(scene: CompiledScene, y: np.ndarray) -> str | None:
    """The joint whose stop an explicit integrator has met with too large a step: RK4 needs some 40 to its period."""
    stops = scene.constants.stops
    if scene.integrator != "rk4" or stops is None:
        return None
    work = y[slice(*scene.part("energy"))].reshape(-1, layout.ENERGIES)[:, layout.STOPS]
    period = 2.0 * math.pi * np.sqrt(np.array(scene.preflight.inertias) / stops[:, layout.STOP_K])
    met = (work != 0.0) & (scene.timestep > period / 40.0)
    return scene.model.joint_names[int(met.argmax())] if met.any() else None
