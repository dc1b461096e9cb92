"""Compile the runs of a scene: check duration, records and tolerances, and lay out what the kernels write."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..base.arguments import is_real, listed, real, shown
from ..core.step import state
from ..core.step.context import Plan
from ..scene.compile import CompiledScene
from ..scene.contact import by_body
from ..scene.external import Push
from .compiled_run import CompiledRun
from .program import CompiledController, with_ticks
from .start import check_one, check_scene

LEAST_SHARE = 1e-3  # of the limit of explicit steps, that the least step of error control is at most
BUDGET, BUDGET_RATE = 2e6, 2e4  # of its steps, with those rejected: minutes of computing, and as many a second more
MOST_STEPS = 10**9  # of a run: hours
MOST_NUMBERS = 2**28  # that a run records: 2 GiB


def prepare(
    scene: CompiledScene,
    duration: float,
    record: Iterable[str] | None = None,
    record_interval: float | None = None,
    *,
    pushes: Sequence[Push] = (),
    rtol: float | None = None,
    atol: float | None = None,
    driven: bool = False,
    controller: CompiledController | None = None,
) -> CompiledRun:
    """Compile runs of a scene; the arguments are those of `simulate`, driven: by torques from outside."""
    check_scene(scene)
    if controller is not None:
        scene = controller.driving(with_ticks(scene, controller))
        driven = driven or controller.writes == "torque"
    plan = _plan(scene, duration, record_interval)
    if scene.adaptive:
        o, acts = scene.layout, scene.constants
        acting = (acts.actuator, acts.friction, acts.stops, acts.contact, acts.pairs, acts.fluid, acts.propellers)
        works = any(part is not None for part in (*acting, acts.tendons)) or driven
        integrated = o["after_integrated" if works else "after_controlled"]
        rtol = scene.rtol if rtol is None else rtol
        atol = scene.atol(rtol) if atol is None else atol
        plan = plan._replace(rtol=rtol, atol=atol, least_step=least_step(scene), integrated=integrated)
        plan = plan._replace(second_run=scene.method.second_run, budget=budget(plan.steps * plan.h))
    record = recorded(scene, record)
    for name, what in (("clearance", "the clearance"), ("tendon_length", "the lengths of tendons")):
        if name in record:
            check_one(scene, what)
    run = CompiledRun(scene.pushed(pushes), plan, record, *_stored(scene, record), controller=controller)
    if run.samples * max(1, len(run.channels)) > MOST_NUMBERS:  # they would fill the memory
        raise ValueError(
            f"{scene.model.name}: {run.samples} records of {len(run.channels)} numbers each; at most {MOST_NUMBERS} "
            "numbers: shorten the duration, record fewer channels, or pass a longer record_interval [s]"
        )
    return run


def least_step(scene: CompiledScene) -> float:
    """Return the shortest step that error control may take [s].

    Where anything touches it is the method's: contact that asks for less would keep a run busy for hours.
    """
    least = scene.method.least_step
    touches = scene.ground is not None or scene.touching.table is not None
    return least if touches else min(least, LEAST_SHARE * scene.preflight.sliding_step)


def budget(seconds: float) -> float:
    """Return how many steps error control may take in so much simulated time [s]."""
    return BUDGET + BUDGET_RATE * seconds


def recorded(scene: CompiledScene, record: Iterable[str] | None) -> tuple[str, ...]:
    """Return the channels to record, those of the coordinates if None; ValueError for no list."""
    if record is None:
        return coordinates(scene)
    return tuple(listed("record", record, "give a list of channels, such as ('q', 'qd')"))


def coordinates(scene: CompiledScene) -> tuple[str, ...]:
    """Return the channels of positions and velocities, by whose errors a run is classified."""
    return ("q", "qd", *(("base_q", "base_qd") if scene.tree.floating else ()))


def with_tolerance(
    scene: CompiledScene, rtol: float | None, atol: float | None
) -> tuple[CompiledScene, float | None, float | None]:
    """Return the scene with an integrator that can meet the tolerances, and these; None for fixed steps.

    Raises ValueError for tolerances out of range, and where the integrator has no continuous limit.
    """
    check_scene(scene)
    if rtol is None and atol is not None:
        raise ValueError(f"atol is {atol!r} but rtol is not given; give rtol too")
    rtol, atol = (
        None if value is None else real(name, value, 1e-14, 1.0, "1e-8 is usual")
        for name, value in (("rtol", rtol), ("atol", atol))
    )
    wanted = scene.rtol if rtol is None and scene.adaptive else rtol
    strict = not scene.preflight.named and wanted is not None and wanted < scene.method.strictest
    if strict or (rtol is not None and not scene.adaptive):
        if scene.method.drives:
            raise ValueError(
                f"{scene.integrator} is an order of updates at a fixed step, not a differential equation; "
                "without rtol and atol"
            )
        taken, so = ("extrapolation", "something is") if scene.stiff else ("dop853", "nothing is")
        why = f"rtol asks for error control, and {so} stiff, limited between ticks, or on the ground"
        if rtol is None:
            why = f"controllers jump by what {scene.largest_jump:.2g} rad ask for, which asks for rtol {wanted:g}"
        why, ticks = f"{taken} in place of {scene.integrator} ({scene.preflight.reason}): {why}", scene.tick_steps
        scene = scene.recompiled(integrator=taken)
        scene = replace(scene, preflight=scene.preflight._replace(reason=why), tick_steps=ticks)
    if not scene.adaptive:
        return scene, None, None
    return scene, wanted, scene.atol(wanted) if atol is None and wanted is not None else atol


def most_ticks(scene: CompiledScene) -> int:
    """Return how many controller ticks one call may simulate."""
    return MOST_STEPS // scene.tick_steps


def whole_steps(scene: CompiledScene, duration: float) -> int:
    """Return how many steps a run takes, in whole ticks; ValueError for a duration out of range."""
    h, tick = scene.timestep, scene.tick_steps
    if not is_real(duration) or not 0 < duration < math.inf:
        raise ValueError(f"duration is {shown(duration)} s; it must be positive and finite: give seconds")
    if duration > MOST_STEPS * h:
        raise ValueError(
            f"duration is {duration!r} s, {duration / h:.3g} steps of {h:g} s; at most {MOST_STEPS:g}: simulate less, "
            "or compile the scene with a larger timestep"
        )
    return math.ceil(duration / (tick * h) - 1e-9) * tick


def _plan(scene: CompiledScene, duration: float, record_interval: float | None) -> Plan:
    """Return the plan of a run in whole steps, ticks and samples."""
    steps, every = whole_steps(scene, duration), steps_between_records(scene, record_interval)
    falls = scene.fall_height, scene.fall_upright, scene.upright
    return Plan(scene.timestep, scene.method.theta, steps, scene.tick_steps, every, scene.lag, *falls)


def steps_between_records(scene: CompiledScene, record_interval: float | None) -> int:
    """Return the time between records [s] in whole steps, those of a tick if None; ValueError if it is not whole."""
    h = scene.timestep
    if record_interval is None:
        return scene.tick_steps
    steps = record_interval / h if is_real(record_interval) else math.nan
    if not 0.5 <= steps < 2**53 or abs(round(steps) * h - record_interval) > 1e-9 * record_interval:
        raise ValueError(f"record_interval is {shown(record_interval)} s; give a whole number of steps of {h:g} s")
    return round(steps)


def _stored(scene: CompiledScene, record: tuple[str, ...]) -> tuple[dict[str, slice], np.ndarray]:
    """Return each channel's place among the recorded numbers, and their indices into the state."""
    indices: list[int] = []
    slices = {}
    for name in record:
        if not isinstance(name, str) or name not in state.RECORDABLE:
            known = ", ".join(state.RECORDABLE)
            raise ValueError(f"record: there is no channel {shown(name)}; channels: {known}: see help(simulate)")
        needed = state.BY_NAME[name].needs or (name,)
        for stored in (*needed, "ball_q") if "q" in needed and scene.tree.balls is not None else needed:
            if stored in slices:
                continue
            places = np.arange(*scene.part(stored))
            of_points = state.OWNERS[state.BY_NAME[stored].of].share == "points"
            if of_points and len(places):  # the scene keeps the points of a body together
                order = np.argsort(by_body(scene.model, scene.tree))
                places = places.reshape(len(order), -1)[order].ravel()
            slices[stored] = slice(len(indices), len(indices) + len(places))
            indices.extend(places)
    return slices, np.array(indices, dtype=np.int64)


def with_steps(run: CompiledRun, steps: int, per_sample: int) -> CompiledRun:
    """Return the run with another number of steps, which need not be whole ticks."""
    return replace(run, plan=run.plan._replace(steps=steps, per_sample=per_sample))


def each_once(function: Callable[[Any], Any], entries: Sequence[Any], key: Callable[[Any], Hashable] = id) -> list[Any]:
    """Return what the function makes of each entry, called once for those of one key, by default for one object."""
    keys = [key(entry) for entry in entries]
    made = {one: function(entry) for one, entry in dict(zip(keys, entries)).items()}
    return [made[one] for one in keys]
