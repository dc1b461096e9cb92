"""Runs in parts, between which loops are made and broken, and surfaces commanded, at given times."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..base.arguments import is_real, listed, real, shown, truth
from ..scene.compile import CompiledScene
from .prepare import steps_between_records, whole_steps
from .reference import Reference
from .start import check_scene, checked_state, driven_lengths, initial_state, loop_names
from .switch import WITHIN, checked_command, command_surface, drive_number, switch_loop
from .trajectory import Trajectory

GIVE = (
    "give a list of (time [s], name of a loop, closed), and the largest gap as a fourth if need be, or (time [s], name "
    "of a drive of surfaces, command)"
)
ON_STEP = 1e-6  # of a step: what counts as at its end


class Switch(NamedTuple):
    """A loop that is made or broken, or a surface that is commanded, during a run."""

    time: float  # since the first start [s]
    name: str
    closed: Any  # or the command of a drive of surfaces
    within: float = WITHIN  # as in `switch_loop` [m or rad]


def check_switches(scenes: Iterable[CompiledScene], switches: Sequence[Any]) -> list[Switch]:
    """Return what is switched, in order of time; raise ValueError or TypeError for what makes no sense."""
    found = []
    for given in listed("switches", switches, GIVE):
        if not isinstance(given, tuple | list) or len(given) not in (3, 4):
            raise TypeError(f"switches: {shown(given)} is no tuple of three or four; {GIVE}")
        one = Switch(*given)
        time = real("switches: time", one.time, 0.0, 1e9, "it counts from the first start [s]")
        if not isinstance(one.closed, bool | np.bool_) and is_real(one.closed):
            if len(given) == 4:
                raise ValueError(
                    f"switches: {shown(given)} commands the drive {one.name!r}, which has no gap {one.within!r}: leave "
                    "the fourth out, or write True or False for a loop"
                )
            found.append(Switch(time, one.name, checked_command(one.closed)))
            continue
        within = real("switches: within", one.within, 0.0, math.inf, "1e-3 is usual, math.inf closes it anywhere")
        found.append(Switch(time, one.name, truth("switches: closed", one.closed), within))
    for scene in {id(scene): scene for scene in scenes}.values():
        check_scene(scene)
        for one in found:
            _check_kind(scene, one)
        loop_names(scene, [one.name for one in found if isinstance(one.closed, bool)], "switches")
        for one in found:
            if not isinstance(one.closed, bool):
                drive_number(scene, one.name)
    return sorted(found, key=lambda one: one.time)


def _check_kind(scene: CompiledScene, one: Switch) -> None:
    """Raise TypeError for a drive that is opened or closed, and for a loop that is commanded."""
    loop, drive = one.name in [loop.name for loop in scene.model.loops], one.name in scene.surface_drives
    switched = isinstance(one.closed, bool)
    if loop == drive or switched == loop:
        return
    is_one, remedy = "a drive of surfaces", "give its command, 1.0 moves surfaces as stated, 0.0 holds them"
    if loop:
        is_one, remedy = "a loop", "closed is True or False"
    raise TypeError(f"switches: {one.name!r} is {is_one}, and {one.closed!r} is given: {remedy}")


class Parts(NamedTuple):
    """How a run is divided, in steps from its start."""

    ends: list[int]  # of the parts, from 0 on
    before: list[list[Switch]]  # what is switched where each part begins
    tick: int  # steps between the controller ticks of the parts
    every: int  # between records of the whole run
    record: int  # and of the parts


def divided(
    scene: CompiledScene, duration: float, record_interval: float | None, begin: float, switches: Sequence[Switch]
) -> Parts:
    """Divide a run that begins at a time [s] where loops are switched; raise ValueError for times between steps."""
    h, tick, total = scene.timestep, scene.tick_steps, whole_steps(scene, duration)
    at: dict[int, list[Switch]] = {0: [], total: []}
    grid = tick if scene.sampled else 1
    for one in switches:
        step = round((one.time - begin) / (grid * h)) * grid
        if not -ON_STEP * h <= one.time - begin < (total - ON_STEP) * h:
            continue
        if abs(one.time - begin - step * h) > ON_STEP * h:
            what = "controller ticks" if scene.sampled else "steps"
            kind = "loop" if isinstance(one.closed, bool) else "drive"
            raise ValueError(
                f"switches: {one.time:g} s of {kind} {one.name!r} is between {what} of {grid * h:g} s, where loops are "
                f"switched and surfaces commanded: take {begin + step * h:g} s, or compile the scene with a timestep "
                "that divides it"
            )
        at.setdefault(step, []).append(one)
    ends, every = sorted(at), steps_between_records(scene, record_interval)
    return Parts(ends, [at[end] for end in ends[:-1]], math.gcd(tick, *ends), every, math.gcd(every, *ends))


def in_parts(
    given: dict[str, list[Any]],
    duration: float,
    record_interval: float | None,
    switches: list[Switch],
    simulate: Callable[..., list[Trajectory]],
) -> list[Trajectory]:
    """Simulate runs part by part.

    given: scenes, states, references, taus and noises of each; simulate: `simulate_batch` with all but these, the
    duration and the time between records.
    """
    scenes = given["scenes"]
    states = [initial_state(scene) if y is None else y for scene, y in zip(scenes, given["states"])]
    starts = [checked_state(scene, y) for scene, y in zip(scenes, states)]
    plans = [
        divided(scene, duration, record_interval, float(y[scene.layout["end_time"]]), switches)
        for scene, y in zip(scenes, starts)
    ]
    if any(plan != plans[0] for plan in plans):
        raise ValueError("switches: runs of other steps, or that began earlier, do not switch together; run each alone")
    plan, h = plans[0], scenes[0].timestep
    finer = {id(scene): replace(scene, tick_steps=plan.tick) for scene in scenes if scene.tick_steps != plan.tick}
    ticked = [finer.get(id(scene), scene) for scene in scenes]
    references = [_held(*each) for each in zip(scenes, starts, given["references"])]
    done: list[list[Trajectory]] = [[] for _ in scenes]
    for part, before in enumerate(plan.before):
        first, end = plan.ends[part : part + 2]
        going = [k for k, runs in enumerate(done) if not runs or runs[-1].status.complete]
        for k in going:
            states[k] = _switched(scenes[k], states[k], before)
        noises = [given["noises"][k] for k in going]
        noises = [None if x is None else np.asarray(x)[first // plan.tick : end // plan.tick] for x in noises]
        found = simulate(
            [ticked[k] for k in going], (end - first) * h, [states[k] for k in going], [references[k] for k in going],
            [given["taus"][k] for k in going], record_interval=plan.record * h, noises=noises,
        )  # fmt: skip
        for k, run in zip(going, found):
            done[k].append(run)
            states[k] = run
    return [_whole(runs, plan, h) for runs in done]


def _held(scene: CompiledScene, y: np.ndarray, reference: Reference | None) -> Reference | None:
    """Return the reference that all parts have: where none is given, the positions at the start."""
    if reference is not None or not scene.follows:
        return reference
    first, end = scene.part("q")
    return Reference([0.0], np.append(y[first:end], driven_lengths(scene, y))[None])


def _switched(scene: CompiledScene, state: Any, switches: Sequence[Switch]) -> Any:
    """Return a state, or a run with its final state and that of its second run, after some switches."""
    for one in switches:
        if isinstance(state, Trajectory):
            second = None if state.second_final is None else _after(scene, state.second_final, one)
            state = replace(state, final=_after(scene, state.final, one), second_final=second)
        else:
            state = _after(scene, state, one)
    return state


def _after(scene: CompiledScene, y: Any, one: Switch) -> np.ndarray:
    """Return the state after a switch."""
    if isinstance(one.closed, bool):
        return switch_loop(scene, y, one.name, one.closed, one.within)
    return command_surface(scene, y, one.name, one.closed)


def _whole(runs: list[Trajectory], plan: Parts, h: float) -> Trajectory:
    """Join the parts of a run; one that ended early stays at its last record."""
    wrong = next((run for run in runs if not run.success), runs[-1])
    rows, before = [], 0  # of the records that the whole run has, among those of all parts
    for first, end in itertools.pairwise(plan.ends):
        steps = range(first, end + (end == plan.ends[-1]), plan.record)
        rows += [before + m for m, step in enumerate(steps) if step % plan.every == 0]
        before += (end - first) // plan.record + 1

    def joined(parts: list[Any]) -> dict[str, np.ndarray]:
        whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        return {name: values[np.minimum(rows, len(values) - 1)] for name, values in whole.items()}

    channels = joined([run.channels for run in runs])
    channels["time"] = runs[0]["time"][0] + np.arange(len(rows)) * (plan.every * h)
    error: Any = None if any(run.error is None for run in runs) else joined([run.error for run in runs])
    return replace(runs[-1], channels=channels, status=wrong.status, message=wrong.message, error=error)
