"""From a model to a trajectory.

    scene = compile_scene(model, servos="mipsd", ground=Ground())
    trajectory = simulate(scene, 2.0, reference=Reference(times, angles))

A scene fixes robot, servos, ground, integrator and step; a simulation is then one call of compiled code.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from textwrap import indent
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import renamed
from ..arguments import listed, shown, truth
from ..build.external import Push
from ..build.scene import CompiledScene
from ..channels import channel_table
from ..core.step.state import RECORDABLE
from ..reference import Reference
from ..trajectory import Trajectory, with_error
from .batch import drive_lanes, run_all, streams
from .companion import OF_HALF, accounted, companion, coordinates, judged
from .lane_engine import Source
from .prepared import Start, prepare, with_tolerance
from .start import initial_state, restarted, standing_state
from .verdict import trajectory

__all__ = [
    "PARTS", "Push", "initial_state", "restarted", "simulate", "simulate_batch", "simulate_stream", "standing_state"
]  # fmt: skip

PARTS = RECORDABLE  # what can be recorded


def simulate(
    scene: CompiledScene,
    duration: float,
    state: ArrayLike | Trajectory | None = None,
    reference: Reference | None = None,
    tau: Reference | ArrayLike | None = None,
    pushes: Sequence[Push] = (),
    record: Iterable[str] = ("q", "qd"),
    sample: float | None = None,
    *,
    noise: ArrayLike | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    estimate_error: bool | None = None,
) -> Trajectory:
    """Run the scene for `duration` [s], rounded up to whole controller ticks.

    state: what `initial_state` gave, or an earlier `Trajectory` or its `final` to go on from: time goes on too, and
    references, torques and pushes are functions of the time since the first start, as if the run had not been cut
    (`restarted(scene, state)` begins at zero again); reference: joint angles for the servos,
    None holds those of `state`; tau: (joints,) constant torques or a `Reference` of torques [N m]; pushes: external
    forces; record: channels, see below; sample: time between records [s], a multiple of the step (a tick if None);
    noise: (ticks, joints, 2), added at each controller tick to the measured angle [rad] and to the voltage [V];
    rtol, atol: error allowed in a step, relative and absolute [rad, m, and their rates; A; J], of an integrator that
    chooses its steps (atol is rtol if None); given for a scene of fixed steps, they choose such an integrator for this
    run: "extrapolation" if it is stiff, else "dop853";
    estimate_error: for `Trajectory.error`; None: simulate again to ten times the tolerances, or at twice the fixed
    step, and call a run `inaccurate` whose error is beyond 1e-3 rad or m, or 1e-2 of the largest speed (1 at least),
    ten times as much at a fixed step; True: simulate again with half the step, or a tenth of the tolerances; False:
    tell no error.
    Raises ValueError on arguments that do not fit.  A run that fails says so in its status.
    """
    return simulate_batch(
        scene, duration, [state], [reference], [tau], pushes, record, sample,
        noises=[noise], rtol=rtol, atol=atol, estimate_error=estimate_error,
    )[0]  # fmt: skip


if simulate.__doc__:  # python -OO leaves it out
    simulate.__doc__ += f"\n    Channels, with units and labels:\n\n{indent(channel_table(), 8 * ' ')}\n"


def simulate_batch(
    scene: CompiledScene,
    duration: float,
    states: Sequence[ArrayLike | Trajectory | None] | None = None,
    references: Sequence[Reference | None] | None = None,
    taus: Sequence[Reference | ArrayLike | None] | None = None,
    pushes: Sequence[Push] = (),
    record: Iterable[str] = ("q", "qd"),
    sample: float | None = None,
    *,
    executor: Executor | None = None,
    noises: Sequence[ArrayLike | None] | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    estimate_error: bool | None = None,
) -> list[Trajectory]:
    """`simulate` for many states, references or torques at once: eight to a vector, vectors over threads.

    The lists must be equally long, or None.  Each run has the same bits as alone.  Where the controllers are sampled, a
    lane whose run has ended takes the next; runs with continuous servos, torques or pushes share a vector if their
    references have the same knot times; with error control each run has its own steps, and none share a vector.
    executor: any `concurrent.futures.Executor` in place of the threads.
    """
    scene, rtol, atol = with_tolerance(scene, rtol, atol)
    if executor is not None and not callable(getattr(executor, "map", None)):
        raise TypeError(f"executor is {shown(executor)}; give a concurrent.futures.Executor, or None")
    estimate = None if estimate_error is None else truth("estimate_error", estimate_error)
    if estimate is not False:
        with_errors = _with_errors if estimate else _with_companions
        how = dict(references=references, taus=taus, pushes=pushes, record=record, executor=executor, noises=noises)
        return with_errors(scene, duration, states, sample, rtol, atol, **how)
    given: tuple[Sequence[Any] | None, ...] = (states, references, taus, noises)
    names = ("states", "references", "taus", "noises")
    lists = [None if x is None else listed(name, x, "give a list, an entry a run") for name, x in zip(names, given)]
    n = max((len(x) for x in lists if x is not None), default=1)
    columns: list[list[Any]] = [[None] * n if x is None else x for x in lists]
    if any(len(column) != n for column in columns):
        lengths = [len(column) for column in columns]
        raise ValueError(f"states, references, taus and noises have {lengths} entries; give as many of each")
    driven = any(tau is not None for tau in columns[2])
    ready = prepare(
        scene, duration, record, sample, pushes=pushes, rtol=rtol, atol=atol, driven=driven
    )
    starts = [ready.start(*row) for row in zip(*columns)]
    if len({start.noise is None for start in starts}) > 1:
        raise ValueError("noises: some runs have noise and some have none; give all of them an array, or none")
    results = run_all(ready, starts, executor)
    return [trajectory(ready, y, out, ready.course(start)) for start, (y, out) in zip(starts, results)]


def _with_companions(
    scene: CompiledScene,
    duration: float,
    states: Sequence[ArrayLike | Trajectory | None] | None,
    sample: float | None,
    rtol: float | None,
    atol: float | None,
    **how: Any,
) -> list[Trajectory]:
    """The runs, each with the error that a companion tells; companions go on from where companions ended."""
    record = tuple(listed("record", how["record"], "give a list of channels, such as ('q', 'qd')"))
    how |= {"sample": scene.tick_steps * scene.timestep if sample is None else sample, "estimate_error": False}
    other = companion(scene, sample, rtol, atol)
    if other is None:
        return simulate_batch(scene, duration, states, rtol=rtol, atol=atol, **how)
    how |= {"record": dict.fromkeys((*record, *coordinates(scene)))}
    runs = simulate_batch(scene, duration, states, rtol=rtol, atol=atol, **how)
    begun = None if states is None else [_companion_of(state) for state in states]
    coarse = simulate_batch(other.scene, duration, begun, rtol=other.rtol, atol=other.atol, **how)
    told = [accounted(run, less, other.share, record) for run, less in zip(runs, coarse)]
    if other.surer is None:
        return told
    doubtful = [k for k, run in enumerate(told) if run.status == "inaccurate" and _begins(states, begun, k)]
    if doubtful:
        alone = {name: how[name] and [how[name][k] for k in doubtful] for name in ("references", "taus", "noises")}
        again = None if states is None else [states[k] for k in doubtful]
        finer = simulate_batch(other.surer, duration, again, **(how | alone))
        for k, fine in zip(doubtful, finer):
            told[k] = dataclasses.replace(accounted(runs[k], fine, OF_HALF, record), companion=told[k].companion)
    return told


def _begins(states: Sequence[Any] | None, begun: Sequence[Any] | None, k: int) -> bool:
    """Whether a run goes on from no companion, so that a finer one may begin where it does."""
    return states is None or begun is None or begun[k] is states[k]


def _companion_of(state: ArrayLike | Trajectory | None) -> ArrayLike | Trajectory | None:
    if isinstance(state, Trajectory) and state.companion is not None:
        return dataclasses.replace(state, final=state.companion)
    return state


def _with_errors(
    scene: CompiledScene,
    duration: float,
    states: Sequence[ArrayLike | Trajectory | None] | None,
    sample: float | None,
    rtol: float | None,
    atol: float | None,
    **how: Any,
) -> list[Trajectory]:
    """The runs, and the same in half the steps: of integrators with error control also to a tenth of the tolerance."""
    sample = scene.tick_steps * scene.timestep if sample is None else sample
    runs = simulate_batch(scene, duration, states, sample=sample, rtol=rtol, atol=atol, estimate_error=False, **how)
    if not scene.adaptive:
        finer = scene.recompiled(timestep=0.5 * scene.timestep)
        better = simulate_batch(finer, duration, states, sample=sample, estimate_error=False, **how)
        return [judged(with_error(run, fine, 2.0)) for run, fine in zip(runs, better)]
    finer = scene.recompiled(timestep=0.5 * scene.timestep)  # steps end on records: twice as many
    rtol, atol = rtol and 0.1 * rtol, atol and 0.1 * atol
    how["estimate_error"] = False
    better = simulate_batch(finer, duration, states, sample=0.5 * sample, rtol=rtol, atol=atol, **how)
    return [judged(with_error(run, _each(fine, 2), 1.1)) for run, fine in zip(runs, better)]


def _each(run: Trajectory, count: int) -> Trajectory:
    """The run with only each so many-th record."""
    return dataclasses.replace(run, channels={name: values[::count] for name, values in run.channels.items()})


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
            f"{scene.model.name}: a stream needs sampled servos, fixed steps and no pushes: compile the scene with "
            "integrator='midpoint', or use simulate_batch"
        )
    ready = prepare(scene, duration, record, sample)

    def begin_run(key: Any) -> Start:
        start = ready.start(*begin(key))
        if start.y[scene.layout["end"]] > 0.0:
            raise ValueError(f"{scene.model.name}: the runs of a stream begin at time 0: give restarted(scene, state)")
        return start

    def end_run(y: np.ndarray, out: np.ndarray) -> Any:
        return end(trajectory(ready, y, out))

    return drive_lanes(ready, source, begin_run, end_run, threads or os.cpu_count() or 1)


def __getattr__(name: str) -> Any:
    return renamed.lookup(__name__, name)
