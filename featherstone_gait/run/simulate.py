"""From a model to a trajectory.

    scene = compile_scene(model, servos="mipsd", ground=Ground())
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
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..base import deprecated
from ..base.arguments import instance, listed, shown, truth
from ..core.step.state import RECORDABLE
from ..scene.compile import CompiledScene
from ..scene.external import Push
from .batch import drive_lanes, family, run_all, streams
from .channels import channel_table
from .companion import Companion, accounted, companion, judged, share_of_half, share_of_kinks
from .lane_engine import Source
from .prepared import Prepared, Start, coordinates, each_once, prepare, recorded, with_tolerance
from .program import CompiledController
from .reference import Reference
from .start import check_scene, initial_state, reset_time, standing_state
from .trajectory import Trajectory, with_error
from .verdict import trajectory
from .worlds import Worlds

__all__ = [
    "PARTS", "Push", "initial_state", "reset_time", "simulate", "simulate_batch", "simulate_stream", "standing_state"
]  # fmt: skip

PARTS = RECORDABLE  # what can be recorded


@deprecated.keywords(sample="record_interval")
def simulate(
    scene: CompiledScene,
    duration: float,
    state: ArrayLike | Trajectory | None = None,
    reference: Reference | None = None,
    tau: Reference | ArrayLike | None = None,
    pushes: Sequence[Push] = (),
    record: Iterable[str] | None = None,
    record_interval: float | None = None,
    *,
    noise: ArrayLike | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    estimate_error: bool | None = None,
    controller: CompiledController | None = None,
) -> Trajectory:
    """Run the scene for `duration` [s], rounded up to whole controller ticks.

    state: what `initial_state` gave, or an earlier `Trajectory` or its `final` to go on from: time goes on too, and
    references, torques and pushes are functions of the time since the first start, as if the run had not been cut
    (`reset_time(scene, state)` begins at zero again); reference: joint angles for the servos, None holds those of
    `state`; tau: (joints,) constant torques or a `Reference` of torques [N m]; pushes: external forces; record:
    channels, see below; None: "q" and "qd", and of a floating base "base_q" and "base_qd"; record_interval: time
    between records [s], a multiple of the step (a tick if None); noise: (ticks, joints, 2), added at each controller
    tick to the measured angle [rad] and to the voltage [V]; rtol, atol: error allowed in a step, relative and absolute
    [rad, m, and their rates; A; J], of an integrator that chooses its steps (atol is rtol if None); given for a scene
    of fixed steps, they choose such an integrator for this run: "extrapolation" if it is stiff, else "dop853";
    estimate_error: for `Trajectory.error`; None: simulate again to ten times the tolerances, or at twice the fixed
    step, and call a run `inaccurate` whose error is beyond 1e-3 rad or m, or 1e-2 of the largest speed (1 at least),
    ten times as much at a fixed step, if a run in half the steps says so too; True: simulate again with half the step,
    or a tenth of the tolerances; False: tell no error; controller: a function of `controller` that makes of the
    reference what the servos follow; its memory is zero at the start of each run, of one that goes on too: a `Session`
    keeps it.  Raises ValueError on arguments that do not fit.  A run that fails says so in its status.
    """
    return simulate_batch(
        scene, duration, [state], [reference], [tau], pushes, record, record_interval,
        noises=[noise], rtol=rtol, atol=atol, estimate_error=estimate_error, controller=controller,
    )[0]  # fmt: skip


if simulate.__doc__:  # python -OO leaves it out
    simulate.__doc__ += f"\n    Channels, with units and labels:\n\n{indent(channel_table(), 8 * ' ')}\n"


@deprecated.keywords(sample="record_interval")
def simulate_batch(
    scene: CompiledScene | Sequence[CompiledScene],
    duration: float,
    states: Sequence[ArrayLike | Trajectory | None] | None = None,
    references: Sequence[Reference | None] | None = None,
    taus: Sequence[Reference | ArrayLike | None] | None = None,
    pushes: Sequence[Push] = (),
    record: Iterable[str] | None = None,
    record_interval: float | None = None,
    *,
    worlds: Worlds | None = None,
    executor: Executor | None = None,
    noises: Sequence[ArrayLike | None] | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    estimate_error: bool | None = None,
    controller: CompiledController | Sequence[CompiledController | None] | None = None,
) -> list[Trajectory]:
    """`simulate` for many states, references, torques or worlds at once: eight to a vector, vectors over threads.

    scene: of all runs, or a list with one for each; worlds: the physical numbers in which the runs differ, see
    `Worlds`.  The lists must be equally long, or None.  Each run has the same bits as alone in its own scene.  Where
    the controllers are sampled, a lane whose run has ended takes the next; runs with continuous servos, torques or
    pushes share a vector if their references have the same knot times.  Scenes that differ in more than numbers (steps,
    integrators, what there is at all) share no vector; with error control each run has its own steps, and none do.
    controller: one of all runs, or a list with one for each; those of one function share vectors, whatever their
    memories begin with.
    executor: any `concurrent.futures.Executor` in place of the threads.
    """
    if executor is not None and not callable(getattr(executor, "map", None)):
        raise TypeError(f"executor is {shown(executor)}; give a concurrent.futures.Executor, or None")
    estimate = None if estimate_error is None else truth("estimate_error", estimate_error)
    each = {"states": states, "references": references, "taus": taus, "noises": noises}
    several = controller if isinstance(controller, Iterable) else None
    alike: Any = controller if several is None else None
    runs = _runs(scene, worlds, each | {"controller": several})
    acts, scenes = runs.pop("controller"), runs.pop("scenes")
    cases = each_once(lambda given: Case(given, rtol, atol, record_interval, alike), scenes)
    if several is not None:
        cases = [case._replace(controller=one) for case, one in zip(cases, acts)]
    batch = Batch(cases, **runs)
    record = _recorded(scenes, record)
    simulated = functools.partial(_simulated, duration=duration, pushes=pushes, executor=executor)
    if estimate is False:
        return simulated(batch, record)
    batch = batch.by(_judged)
    return (_with_errors if estimate else _with_companions)(batch, record, simulated)


class Case(NamedTuple):
    """The scene of a run, and what its own course is."""

    scene: CompiledScene
    rtol: float | None  # None of fixed steps
    atol: float | None
    record_interval: float | None  # between records [s], a tick if None
    controller: CompiledController | None


class Batch(NamedTuple):
    """Runs: of each its scene, and what it is given."""

    cases: list[Case]
    states: list[Any]
    references: list[Any]
    taus: list[Any]
    noises: list[Any]

    def of(self, indices: Iterable[int]) -> Batch:
        """Some of them."""
        return Batch(*([column[k] for k in indices] for column in self))

    def by(self, case: Callable[[Case], Case]) -> Batch:
        """The same in other scenes or courses."""
        return self._replace(cases=each_once(case, self.cases))


class Simulated(Protocol):
    """`_simulated` of given duration, pushes and executor."""

    def __call__(self, batch: Batch, record: tuple[str, ...]) -> list[Trajectory]: ...


def _runs(scene: Any, worlds: Worlds | None, each: dict[str, Any]) -> dict[str, list[Any]]:
    """Lists of one length, `scenes` among them, from lists, None, and one scene for all; ValueError otherwise."""
    lists = {name: None if x is None else listed(name, x, "give a list, an entry a run") for name, x in each.items()}
    if worlds is not None:
        instance("worlds", worlds, Worlds, "give Worlds(...)")
        check_scene(scene)
        lists["scenes"] = worlds.scenes(scene)
    elif not isinstance(scene, CompiledScene):
        lists["scenes"] = listed("scene", scene, "give what compile_scene returns, or a list of these, one a run")
    else:
        lists["scenes"] = None
    n = max((len(x) for x in lists.values() if x is not None), default=1)
    runs = {name: [None] * n if x is None else list(x) for name, x in lists.items()}
    if any(len(column) != n for column in runs.values()):
        names = [name for name in runs if name not in ("scenes", "controller") or lists[name] is not None]
        lengths = [len(runs[name]) for name in names]
        raise ValueError(f"{', '.join(names)} have {lengths} entries; give as many of each, one a run")
    return runs if lists["scenes"] is not None else runs | {"scenes": [scene] * n}


def _recorded(scenes: Sequence[CompiledScene], record: Iterable[str] | None) -> tuple[str, ...]:
    """The channels that all runs record: where some robots float and others do not, those of the joints if None."""
    each_once(check_scene, scenes)
    fixed = [one for one in scenes if not one.tree.floating]
    return recorded([*fixed, *scenes][0], record) if scenes else ()


def _simulated(
    batch: Batch,
    record: tuple[str, ...],
    duration: float,
    pushes: Sequence[Push],
    executor: Executor | None,
) -> list[Trajectory]:
    """The runs, without their errors."""
    if not batch.cases:
        return []
    driven = any(tau is not None for tau in batch.taus)
    stop = np.zeros(1, np.int64)

    def made_ready(case: Case) -> Prepared:
        scene, rtol, atol = with_tolerance(*case[:3])
        ready = prepare(
            scene, duration, record, case.record_interval, pushes=pushes, rtol=rtol, atol=atol,
            driven=driven, controller=case.controller,
        )  # fmt: skip
        return dataclasses.replace(ready, stop=stop)

    ready = each_once(made_ready, batch.cases)
    starts = [one.start(*row) for one, row in zip(ready, zip(*batch[1:]))]
    if len({start.noise is None for start in starts}) > 1:
        raise ValueError("noises: some runs have noise and some have none; give all of them an array, or none")
    results = run_all(starts, executor)
    return [trajectory(one, y, out, one.course(start)) for one, start, (y, out) in zip(ready, starts, results)]


def _judged(case: Case) -> Case:
    """The same, with tolerances and the time between records told, for others to be compared with."""
    scene, rtol, atol = with_tolerance(*case[:3])
    every = scene.tick_steps * scene.timestep if case.record_interval is None else case.record_interval
    return Case(scene, rtol, atol, every, case.controller)


def _with_companions(batch: Batch, record: tuple[str, ...], simulated: Simulated) -> list[Trajectory]:
    """The runs, each with the error that a companion tells; companions go on from where companions ended."""
    others = each_once(lambda case: companion(case.scene, case.record_interval, case.rtol, case.atol), batch.cases)
    alone = [k for k, other in enumerate(others) if other is None]
    told = dict(zip(alone, simulated(batch.of(alone), record)))
    rest = [k for k, other in enumerate(others) if other is not None]
    told |= zip(rest, _accompanied(batch.of(rest), [others[k] for k in rest], record, simulated))
    return [told[k] for k in range(len(others))]


def _accompanied(
    batch: Batch, others: list[Companion], record: tuple[str, ...], simulated: Simulated
) -> list[Trajectory]:
    """Runs that all have a companion."""
    more = tuple(dict.fromkeys((*record, *(name for case in batch.cases for name in coordinates(case.scene)))))
    runs = simulated(batch, more)
    begun = [_companion_of(state) for state in batch.states]
    coarse = simulated(batch._replace(states=begun, cases=_in_place(batch.cases, others)), more)
    shares = [
        share_of_kinks(run, state.final if isinstance(state, Trajectory) else state, other.share)
        for run, state, other in zip(runs, batch.states, others)
    ]
    told = [accounted(run, less, share, record) for run, less, share in zip(runs, coarse, shares)]
    doubtful = [
        k
        for k, run in enumerate(told)
        if run.message != runs[k].message and others[k].surer is not None and begun[k] is batch.states[k]
    ]  # of those that go on from no companion, so that a finer one may begin where they do
    part, surer = batch.of(doubtful), [others[k] for k in doubtful]
    finer = simulated(part._replace(cases=_in_place(part.cases, surer, True)), more)
    for k, fine in zip(doubtful, finer):
        share = share_of_half(runs[k], coarse[k], fine, batch.cases[k].scene.method.order)
        told[k] = dataclasses.replace(accounted(runs[k], fine, share, record), companion=told[k].companion)
    return told


def _in_place(cases: list[Case], others: list[Companion], surer: bool = False) -> list[Case]:
    """Cases of the companions; those of one companion are one."""
    pairs = {id(other): (case, other) for case, other in zip(cases, others)}
    made = {
        key: Case(other.surer or other.scene, None, None, case.record_interval, case.controller)
        if surer
        else Case(other.scene, other.rtol, other.atol, case.record_interval, case.controller)
        for key, (case, other) in pairs.items()
    }
    return [made[id(other)] for other in others]


def _companion_of(state: ArrayLike | Trajectory | None) -> ArrayLike | Trajectory | None:
    if isinstance(state, Trajectory) and state.companion is not None:
        return dataclasses.replace(state, final=state.companion)
    return state


def _with_errors(batch: Batch, record: tuple[str, ...], simulated: Simulated) -> list[Trajectory]:
    """The runs, and the same in half the steps: of integrators with error control also to a tenth of the tolerance."""
    runs, better = simulated(batch, record), simulated(batch.by(_finer), record)
    return [
        judged(with_error(run, _each(fine, 2), 1.1) if case.scene.adaptive else with_error(run, fine, 2.0))
        for case, run, fine in zip(batch.cases, runs, better)
    ]


def _finer(case: Case) -> Case:
    scene = case.scene.recompiled(timestep=0.5 * case.scene.timestep)
    if not scene.adaptive:
        return case._replace(scene=scene)
    rtol, atol = case.rtol and 0.1 * case.rtol, case.atol and 0.1 * case.atol
    every = case.record_interval and 0.5 * case.record_interval  # steps end on records: twice as many
    return Case(scene, rtol, atol, every, case.controller)


def _each(run: Trajectory, count: int) -> Trajectory:
    """The run with only each so many-th record."""
    return dataclasses.replace(run, channels={name: values[::count] for name, values in run.channels.items()})


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
    """Simulate what `source` hands out, in all lanes of all cores, until there is no more.

    scene: of all runs, or several that differ in numbers alone, as `Worlds.scenes` makes them.  `begin(key)` returns
    the state and the reference of a run and, of several scenes, which; `end(trajectory)` the answer that the source is
    given.  A run that it wants no longer is given up within `lane_engine.SEGMENT` steps.  Each run has the bits that
    `simulate` gives it.  Duration, record and record_interval are those of `simulate`; threads: one a core if None.
    Returns the share of the lane-steps that a run was in.  Raises ValueError for scenes without sampled servos, and for
    those that cannot share lanes.
    """
    scenes = [scene] if isinstance(scene, CompiledScene) else listed("scene", scene, "give what compile_scene returns")
    for one in scenes:
        check_scene(one)
        if not streams(one):
            raise ValueError(
                f"{one.model.name}: a stream needs sampled servos, fixed steps and no pushes: compile the scene with "
                "integrator='midpoint', or use simulate_batch"
            )
    ready = [prepare(one, duration, record, record_interval) for one in scenes]
    if len({family(one) for one in ready}) != 1:
        raise ValueError(f"scene: these {len(scenes)} do not differ in numbers alone; give what Worlds.scenes returns")

    def begin_run(key: Any) -> Start:
        state, reference, *which = begin(key)
        start = ready[which[0] if which else 0].start(state, reference)
        if start.y[ready[0].scene.layout["end_time"]] > 0.0:
            name = ready[0].scene.model.name
            raise ValueError(f"{name}: the runs of a stream begin at time 0: give reset_time(scene, state)")
        return start

    def end_run(start: Start, y: np.ndarray, out: np.ndarray) -> Any:
        return end(trajectory(start.world, y, out))

    return drive_lanes(ready[0].among(ready), source, begin_run, end_run, threads or os.cpu_count() or 1)
