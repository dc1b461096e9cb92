"""Simulate a compiled scene: one run, many runs at once, or a stream of runs.

    scene = compile_scene(model, gearbox="mipsd", ground=Ground())
    trajectory = simulate(scene, 2.0, reference=Reference(times, angles))

A scene fixes robot, servos, ground, integrator and step; a simulation is then one call of compiled code.
"""

from __future__ import annotations

import dataclasses
import functools
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from textwrap import indent
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import instance, listed, shown, truth
from ..core.step.state import RECORDABLE
from ..scene.channels import channel_table
from ..scene.compile import CompiledScene
from ..scene.external import Push
from .batch import drive_lanes, family, run_all, streams
from .classify import to_trajectory
from .compiled_run import CompiledRun, RunInput
from .error_estimate import (
    SecondRun,
    edges_on_steps,
    second_run,
    share_by_steps,
    share_of_third,
    with_accuracy,
    with_channels,
    with_error_estimate,
)
from .lane_engine import Source
from .measure import What, split, with_readings
from .parts import check_switches, in_parts
from .prepare import coordinates, each_once, prepare, recorded, with_tolerance
from .program import CompiledController, with_ticks
from .reference import Reference
from .start import check_scene, initial_state, reset_time, standing_state
from .trajectory import Trajectory, of_second_run, with_error
from .worlds import Worlds

__all__ = [
    "PARTS", "Push", "initial_state", "reset_time", "simulate", "simulate_batch", "simulate_stream", "standing_state"
]  # fmt: skip

PARTS = RECORDABLE  # channels that can be recorded


def simulate(
    scene: CompiledScene,
    duration: float,
    state: ArrayLike | Trajectory | None = None,
    reference: Reference | None = None,
    tau: Reference | ArrayLike | None = None,
    pushes: Sequence[Push] = (),
    record: Iterable[What] | None = None,
    record_interval: float | None = None,
    *,
    noise: ArrayLike | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    estimate_error: bool | None = None,
    controller: CompiledController | None = None,
    switches: Sequence[tuple[float, str, float] | tuple[float, str, bool, float]] = (),
) -> Trajectory:
    """Simulate a scene, by default twice: a second, coarser run estimates the global error of each channel.

    The estimate is in `Trajectory.error`, and a run whose error is too large has the status "inaccurate".  It costs
    about as much time again with error control, half as much at fixed steps; ``estimate_error=False`` leaves it out.

    Parameters
    ----------
    scene
        The robot with its servos and ground, as `compile_scene` returns it; it fixes the integrator and the step.
    duration
        Time to simulate [s], rounded up to whole controller ticks.
    state
        Where the run starts: a state (size,) as `initial_state` returns it, or an earlier `Trajectory` to go on from.
        Time goes on too: references, torques and pushes are functions of the time since the first start
        (``reset_time(scene, state)`` sets it to zero).  None: `initial_state(scene)`.
    reference
        Joint positions for servos or controller over time [rad or m], then the lengths for drives of tendons, in the
        order of `Model.tendons`, which may be left out.  None: they are to hold the positions in `state`.
    tau
        Torques on the joints from outside, constant (joints,) or a `Reference` [N m or N]; after them the forces along
        tendons that have a drive, which may be left out.
    pushes
        External forces.
    record
        Channels to record, see below, and sensors, each under its name: objects such as a `RangeSensor` or a
        `SampledSensor`, encoders, gyroscope, accelerometer, center_of_pressure and contact_positions.  None: "q" and
        "qd", and of a floating base "base_q" and "base_qd".
    record_interval
        Time between records [s], a whole number of steps.  None: a controller tick.
    noise
        Array (ticks, joints, 2), added at each controller tick to the measured angle [rad] and to the voltage [V].
    rtol, atol
        Relative and absolute error allowed in a step [rad, m, and their rates; A; J], of an integrator that chooses
        its steps; atol is rtol if None, or 0.03 rtol where bodies touch each other and rtol is 1e-4 or less.  Given
        for a scene of fixed steps, they choose such an integrator for this run: "extrapolation" if the scene is
        stiff, else "dop853".
    estimate_error
        None: run again at ten times the tolerances, or at twice the fixed step.  The run is "inaccurate" if its error
        is larger than 1e-3 rad or m, or 1e-2 of the largest speed (1 at least; of a body that touches others its
        own, 0.03 m/s at least), ten times as much at a fixed step,
        or, with "energy" recorded, than 1e-2 of the largest energy (1 mJ at least) up to the end;
        at fixed steps a third run in half the steps must confirm it.  Where torques, pushes or followed references
        change within fixed steps, the second run has error control, whose steps end there.
        True: run again with half the step, or at a tenth of the tolerances, for a closer estimate.
        False: run once; `Trajectory.error` is None.
    controller
        A function made by `controller`, which turns the reference into what the servos follow, or into torques.  Its
        memory is zero at the start of each run, even of one that goes on from another; a `Session` keeps it.
    switches
        Loops that are made and broken during the run: (time since the first start [s], name, whether to close it), and
        as a fourth `within` of `switch_loop`, which says what happens; and surfaces that are commanded: (time [s], name
        of the drive, command), as by `command_surface`.  Times are those of controller ticks, of scenes
        without sampled servos of steps; those before the run or from its end on have no effect.  A record at such a
        time is that after it.

    Returns
    -------
    Trajectory
        Recorded channels by name, the status, the final state and the estimated errors.  A run that fails says so in
        its `status` and `message`; `success` is True only for "ok".

    Raises
    ------
    ValueError
        If arguments do not fit the scene or each other.

    See Also
    --------
    simulate_batch : many runs at once, eight to a vector and over all cores.
    Session : step from Python, tick by tick.

    Examples
    --------
    >>> scene = compile_scene(load_robot("arm7"))
    >>> run = simulate(scene, 2.0, record=("q", "energy"))
    >>> run["q"][-1], run.error["q"].max(), run.success
    """
    return simulate_batch(
        scene, duration, [state], [reference], [tau], pushes, record, record_interval,
        noises=[noise], rtol=rtol, atol=atol, estimate_error=estimate_error, controller=controller,
        switches=switches,
    )[0]  # fmt: skip


if simulate.__doc__:  # python -OO leaves it out
    simulate.__doc__ += f"\n    Channels, with units and labels:\n\n{indent(channel_table(), 8 * ' ')}\n"


def simulate_batch(
    scene: CompiledScene | Sequence[CompiledScene],
    duration: float,
    states: Sequence[ArrayLike | Trajectory | None] | None = None,
    references: Sequence[Reference | None] | None = None,
    taus: Sequence[Reference | ArrayLike | None] | None = None,
    pushes: Sequence[Push] = (),
    record: Iterable[What] | None = None,
    record_interval: float | None = None,
    *,
    worlds: Worlds | None = None,
    executor: Executor | None = None,
    noises: Sequence[ArrayLike | None] | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    estimate_error: bool | None = None,
    controller: CompiledController | Sequence[CompiledController | None] | None = None,
    switches: Sequence[tuple[float, str, float] | tuple[float, str, bool, float]] = (),
) -> list[Trajectory]:
    """Simulate many states, references, torques or worlds at once, each by default twice, as `simulate` does.

    Each run has the same bits as alone in its own scene.  Eight runs share a vector, and vectors run on all cores.
    Where controllers are sampled, a lane whose run has ended takes the next one.  Runs with continuous servos, torques
    or pushes share a vector if their references have the same knot times.  Scenes that differ in more than numbers
    (steps, integrators, kinds of parts) share no vector; with error control each run has its own steps, and none do.

    Parameters
    ----------
    scene
        One for all runs, or a list with one for each.
    duration
        Time to simulate [s], rounded up to whole controller ticks.
    states, references, taus, noises
        Lists of equal length with an entry for each run, as in `simulate`, or None.
    pushes, record, record_interval, rtol, atol, estimate_error, switches
        As in `simulate`, for all runs.
    worlds
        Physical numbers in which the runs differ.
    executor
        Any `concurrent.futures.Executor`, used in place of threads.
    controller
        One for all runs, or a list with one for each.  Those of one function share vectors, whatever their memories
        begin with.

    Returns
    -------
    list of Trajectory
        One for each run, in the order of the lists.

    Raises
    ------
    ValueError
        If arguments do not fit the scene or each other, or lists differ in length.
    """
    if executor is not None and not callable(getattr(executor, "map", None)):
        raise TypeError(f"executor is {shown(executor)}; give a concurrent.futures.Executor, or None")
    estimate = None if estimate_error is None else truth("estimate_error", estimate_error)
    each = {"states": states, "references": references, "taus": taus, "noises": noises}
    several = controller if isinstance(controller, Iterable) else None
    runs = _runs(scene, worlds, each | {"controller": several})
    chosen = split(runs["scenes"], record)
    if chosen.sensors:
        found = simulate_batch(
            runs["scenes"], duration, runs["states"], runs["references"], runs["taus"], pushes, chosen.channels,
            record_interval, executor=executor, noises=runs["noises"], rtol=rtol, atol=atol, switches=switches,
            estimate_error=estimate_error, controller=controller if several is None else runs["controller"],
        )  # fmt: skip
        pushed = [one.pushed(pushes) for one in runs["scenes"]]
        return [with_readings(*one, chosen, k) for k, one in enumerate(zip(pushed, found))]
    if switched := check_switches(runs["scenes"], switches):
        if controller is not None:
            raise ValueError("switches: a controller would begin anew where a loop is switched; step a Session instead")
        part = functools.partial(
            simulate_batch, pushes=pushes, record=chosen.channels, executor=executor, rtol=rtol, atol=atol,
            estimate_error=estimate_error,
        )  # fmt: skip
        return in_parts(runs, duration, record_interval, switched, part)
    acts = runs["controller"] if several is not None else [controller] * len(runs["scenes"])
    columns = zip(runs["scenes"], acts, *(runs[name] for name in each))
    jobs = [Job(one, rtol, atol, record_interval, act, *given) for one, act, *given in columns]
    how, record = How(duration, pushes, executor), _recorded(runs["scenes"], chosen.channels)
    if estimate is False:
        return _simulate(jobs, record, how)
    jobs = _changed(_explicit, jobs)
    return (_with_finer_runs if estimate else _with_second_runs)(jobs, record, how)


class Job(NamedTuple):
    """One run: its scene, how it is run, and what it is given."""

    scene: CompiledScene
    rtol: float | None  # None of fixed steps
    atol: float | None
    record_interval: float | None  # between records [s], a tick if None
    controller: CompiledController | None
    state: Any
    reference: Any
    tau: Any
    noise: Any
    edges: int = 2  # see `edges_on_steps`


class How(NamedTuple):
    """Options that all runs have in common."""

    duration: float
    pushes: Sequence[Push]
    executor: Executor | None


def _simulate(jobs: list[Job], record: tuple[str, ...], how: How) -> list[Trajectory]:
    """Return the runs, without their errors."""
    driven = any(job.tau is not None for job in jobs)
    stop = np.zeros(1, np.int64)

    def compiled(job: Job) -> CompiledRun:
        scene, rtol, atol = with_tolerance(*job[:3])
        run = prepare(
            scene, how.duration, record, job.record_interval, pushes=how.pushes, rtol=rtol, atol=atol, driven=driven,
            controller=job.controller,
        )  # fmt: skip
        return dataclasses.replace(run, stop=stop)

    runs = _once(compiled, jobs)
    starts = [run.start(*job[5:9]) for run, job in zip(runs, jobs)]
    if len({start.noise is None for start in starts}) > 1:
        raise ValueError("noises: some runs have noise and some have none; give all of them an array, or none")
    results = run_all(starts, how.executor)
    return [to_trajectory(run, *found, run.schedule(s.y)) for run, s, found in zip(runs, starts, results)]


def _once(function: Callable[[Job], Any], jobs: list[Job]) -> list[Any]:
    """Return what the function makes of each job, called once for those of the same scene and ways to run it."""
    return each_once(function, jobs, lambda job: (id(job.scene), id(job.controller), repr(job[1:4]), job.edges))


def _changed(function: Callable[[Job], dict[str, Any]], jobs: list[Job]) -> list[Job]:
    """Return the jobs with fields changed to what the function returns: see `_once`."""
    return [job._replace(**fields) for job, fields in zip(jobs, _once(function, jobs))]


def one_a_run(name: str, given: Any) -> list[Any]:
    """Return the items of a list with an entry a run; raise ValueError for others, and for the state of one run."""
    remedy = "give a list, an entry a run"
    if name == "states" and (isinstance(given, Trajectory) or getattr(given, "ndim", 2) == 1):
        raise ValueError(f"{name} is {shown(given)}; {remedy}")
    return listed(name, given, remedy)


def _runs(scene: Any, worlds: Worlds | None, each: dict[str, Any]) -> dict[str, list[Any]]:
    """Return lists of one length, `scenes` among them, from lists, None, and one scene for all."""
    lists = {name: None if x is None else one_a_run(name, x) for name, x in each.items()}
    if worlds is not None:
        instance("worlds", worlds, Worlds, "give Worlds(...)")
        check_scene(scene)
        lists["scenes"] = worlds.scenes(scene)
    elif not isinstance(scene, CompiledScene):
        lists["scenes"] = listed("scene", scene, "give what compile_scene returns, or a list of these, one a run")
    n = max((len(x) for x in lists.values() if x is not None), default=1)
    lists.setdefault("scenes", [scene] * n)
    runs = {name: [None] * n if x is None else x for name, x in lists.items()}
    if any(len(column) != n for column in runs.values()):
        names = [name for name, given in lists.items() if given is not None]
        lengths = [len(runs[name]) for name in names]
        raise ValueError(f"{', '.join(names)} have {lengths} entries; give as many of each, one a run")
    return runs


def _recorded(scenes: Sequence[CompiledScene], record: Iterable[Any] | None) -> tuple[str, ...]:
    """Return the channels that all runs record; by default those of the joints where some robots do not float."""
    each_once(check_scene, scenes)
    fixed = [one for one in scenes if not one.tree.floating]
    return recorded([*fixed, *scenes][0], record) if scenes else ()


def _explicit(job: Job) -> dict[str, Any]:
    """Return explicit tolerances and time between records, so that other runs can be compared."""
    scene, rtol, atol = with_tolerance(*job[:3])
    scene = with_ticks(scene, job.controller)
    every = scene.tick_steps * scene.timestep if job.record_interval is None else job.record_interval
    return {"scene": scene, "rtol": rtol, "atol": atol, "record_interval": every}


def _with_second_runs(jobs: list[Job], record: tuple[str, ...], how: How) -> list[Trajectory]:
    """Return the runs, each with the error that a second run estimates, or a third where the second finds it large.

    Second runs of runs that go on from others go on from where the others' second runs ended.
    """
    more = tuple(dict.fromkeys((*record, *(name for job in jobs for name in coordinates(job.scene)))))
    runs, coarse = _simulate(jobs, more, how), {}
    jobs = _with_edges(jobs, runs, how)
    seconds: dict[int, SecondRun] = {
        k: one for k, one in enumerate(_once(lambda job: second_run(*job[:4], job.edges), jobs)) if one is not None
    }
    found = [with_channels(run, record) for run in runs]
    for k, second in seconds.items():
        coarse[k] = jobs[k]._replace(state=of_second_run(jobs[k].state), **second.changes)
    others = dict(zip(coarse, _simulate([*coarse.values()], more, how)))
    for k, other in others.items():
        share = share_by_steps(runs[k], jobs[k].state, other, coarse[k].state, seconds[k].share)
        found[k] = with_error_estimate(runs[k], other, share, record)
    doubtful = {
        k: jobs[k]._replace(**second.finer.changes)
        for k, second in seconds.items()
        if second.finer is not None and found[k].message != runs[k].message and coarse[k].state is jobs[k].state
    }  # of those that go on from no second run, so that a third one may begin where they do
    for k, third in zip(doubtful, _simulate([*doubtful.values()], more, how)):
        if not third.status.complete:
            continue
        share = share_of_third(runs[k], others[k], third, jobs[k].scene.method.order)
        better = with_error_estimate(runs[k], third, share, record)
        found[k] = dataclasses.replace(better, second_final=found[k].second_final)
    return found


def _with_edges(jobs: list[Job], runs: list[Trajectory], how: How) -> list[Job]:
    """Return the jobs with their edges, once their runs have shown that states and signals are sound."""
    found = []
    for job, run in zip(jobs, runs):
        begin, tick = run["time"][0], job.scene.tick_steps * job.scene.timestep
        until = begin + how.duration + tick  # it is rounded up to whole ticks
        edges = edges_on_steps(job.scene, begin, how.pushes, job.tau, job.reference, until)
        found.append(job._replace(edges=edges))
    return found


def _with_finer_runs(jobs: list[Job], record: tuple[str, ...], how: How) -> list[Trajectory]:
    """Return the runs with the errors by half the step, or by a tenth of the tolerance and half the step."""
    runs = _simulate(jobs, record, how)
    jobs = _with_edges(jobs, runs, how)
    found = []
    for job, run, fine in zip(jobs, runs, _simulate(_changed(_finer, jobs), record, how)):
        if job.scene.adaptive:
            every_second = {name: values[::2] for name, values in fine.channels.items()}
            run = with_error(run, dataclasses.replace(fine, channels=every_second), 1.1)
        else:
            run = with_error(run, fine, 1.0 if "rtol" in fine.info else 2.0)
        found.append(with_accuracy(run))
    return found


def _finer(job: Job) -> dict[str, Any]:
    scene = job.scene.recompiled(timestep=0.5 * job.scene.timestep)
    if not scene.adaptive:
        second = second_run(*job[:4], job.edges) if job.edges == 0 else None
        return {"scene": scene} if second is None else second.changes
    finer = {"rtol": 0.1, "atol": 0.1, "record_interval": 0.5}  # steps end on records: twice as many
    return {"scene": scene} | {name: factor * getattr(job, name) for name, factor in finer.items()}


def simulate_stream(
    scene: CompiledScene | Sequence[CompiledScene],
    duration: float,
    source: Source,
    begin: Callable[[Any], tuple[np.ndarray, Reference] | tuple[np.ndarray, Reference, int]],
    end: Callable[[Trajectory], Any],
    record: Iterable[str] | None = None,
    record_interval: float | None = None,
    threads: int | None = None,
) -> float:
    """Simulate what a source hands out, in all lanes of all cores, until there is no more.

    Each run is simulated once and has the bits of `simulate`; no errors are estimated.

    Parameters
    ----------
    scene
        One for all runs, or several that differ in numbers alone, as `Worlds.scenes` returns them.
    duration, record, record_interval
        As in `simulate`.
    source
        Hands out keys of runs and takes their answers: see `lane_engine.Source`.  A run that it no longer wants is
        given up within `lane_engine.SEGMENT` steps.
    begin
        Called as ``begin(key)``; returns the state and the reference of a run and, of several scenes, the index of its
        scene.
    end
        Called as ``end(trajectory)``; returns the answer that the source is given.
    threads
        None: one for each core.

    Returns
    -------
    float
        Share of the lane-steps that were used.

    Raises
    ------
    ValueError
        For scenes without sampled servos, and for those that cannot share lanes.
    """
    scenes = [scene] if isinstance(scene, CompiledScene) else listed("scene", scene, "give what compile_scene returns")
    for one in scenes:
        check_scene(one)
        if not streams(one):
            raise ValueError(
                f"{one.model.name}: a stream needs sampled servos, fixed steps and no pushes: compile the scene with "
                "integrator='midpoint', or use simulate_batch"
            )
    runs = [prepare(one, duration, record, record_interval) for one in scenes]
    if len({family(one) for one in runs}) != 1:
        raise ValueError(f"scene: these {len(scenes)} do not differ in numbers alone; give what Worlds.scenes returns")

    def begin_run(key: Any) -> RunInput:
        state, reference, *which = begin(key)
        start = runs[which[0] if which else 0].start(state, reference)
        if start.y[runs[0].scene.layout["end_time"]] > 0.0:
            name = runs[0].scene.model.name
            raise ValueError(f"{name}: the runs of a stream begin at time 0: give reset_time(scene, state)")
        return start

    return drive_lanes(
        runs[0].among(runs), source, begin_run, lambda start, y, out: end(to_trajectory(start.compiled, y, out)),
        threads or os.cpu_count() or 1,
    )  # fmt: skip
