"""The first gait of a search: a planned walk, the four-pose gait fitted to it, and their costs."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, NamedTuple, get_args

import numpy as np

from ..base.arguments import one_of
from ..dynamics.tree import GRAVITY
from ..model import Ground, Model
from ..scene.actuator import servo_gearbox
from ..scene.compile import CompiledScene, GearboxKind, compile_scene
from ..walking.cheapest_plan import PlanKind, States, check_speed, first_gait, gentle_plan
from ..walking.cost import WalkingCost
from ..walking.cost_in_worlds import CostInWorlds, in_worlds
from ..walking.gait import mirror_of
from ..walking.limits import Watch
from ..walking.one_leg import check_strength
from ..walking.plan import walking_plan
from .preparation import SECONDS, Job, check_history, estimate_in_words
from .quality import describe
from .stored import CHEAPEST, is_measured, stored_rows


def walking_cost(
    model: Model,
    gearbox: GearboxKind | None = None,
    ground: Ground | None = None,
    gravity: Sequence[float] | np.ndarray = GRAVITY,
    states: States = "stride",
    plan: PlanKind = "plain",
    progress: bool = False,
    **walk: Any,
) -> WalkingCost:
    """Plan a walk of a biped, fit the four-pose gait to it and return its cost on flat ground.

    Parameters
    ----------
    model : Model
        The robot.
    gearbox : {"mipsd", "rotor", "standard"}, optional
        Gearbox model; None: "mipsd" if all gears are elastic, else "rotor".
    ground : Ground, optional
        Flat ground; by default `Ground()`.
    gravity : array_like, shape (3,)
        Acceleration of gravity [m/s^2]; it points straight down.
    states : {"stride", "step"}
        Whether the four poses are those of a stride, or of a step that the other leg mirrors.  The paper's words allow
        both ("a complete and symmetrical step can be composed of 4 states").
    plan : {"plain", "cheapest"}
        The plain plan, or a search for the cheapest one (`walking.first_gait`).
    progress : bool
        Whether to show the progress of that search.
    **walk
        Settings of `walking.WalkSettings` that differ from `BIOLOID_WALK`.

    Returns
    -------
    WalkingCost
        The cost of gait vectors, with the first gait.

    Raises
    ------
    ValueError
        For a robot that is no biped or cannot take these steps, and for states of a step where left and right are no
        mirror images.
    """
    one_of("states", states, get_args(States))
    return first_gait(_scene(model, gearbox, ground, gravity), plan, states, progress=progress, **walk)


def _scene(
    model: Model,
    gearbox: GearboxKind | None,
    ground: Ground | None = None,
    gravity: Sequence[float] | np.ndarray = GRAVITY,
) -> CompiledScene:
    return compile_scene(model, servo_gearbox(model, gearbox), ground or Ground(), "midpoint", 1e-3, gravity)


class Start(NamedTuple):
    """The gait that a search starts from."""

    plan: PlanKind
    cost: WalkingCost
    searched: WalkingCost | CostInWorlds  # the cost that the search minimizes
    value: float  # what that is for the first gait [J/m]; infinite if it does not walk
    failure: str  # why the first gait does not walk, or "ok"
    watch: Watch
    unplanned: str = ""  # why no other plan walks either, where some were tried


def plan_start(job: Job) -> Start:
    """Plan the gait that the search starts from; print its measures and how long the search takes."""
    options, first = job.options, None
    _check_strength(job)
    try:
        first = plan_first_gait(job, options.plan or "plain")
        failure = first.failure
    except ValueError as error:
        if options.plan is not None:
            raise
        failure = str(error)
    if options.plan is None and failure != "ok":
        first = _other_plan(job, first, failure)
    assert first is not None
    check_history(job.history, first.value)
    x = first.cost.gait.to_vector()
    measures, worlds = first.cost.measure([x])[0], options.worlds
    job.print(f"first gait: {describe(measures)}")
    if worlds:
        job.print(f"in {worlds} worlds: {f'{first.value:.1f} J/m' if first.failure == 'ok' else first.failure}")
    if options.progress and not job.timed:
        slower = _seconds(first, x) / (2.0 * SECONDS["candidate in a world"] * max(worlds, 1))
        job.print(f"duration: {estimate_in_words(slower * sum(job.seconds.values()))}")
    return first if measures.status == "ok" else first._replace(failure=measures.status)


def _seconds(start: Start, x: np.ndarray) -> float:
    """Time an evaluation of a gait that was evaluated before [s] of the processor: the least of three."""
    times = []
    for _ in range(3):
        began = time.process_time()
        start.searched(x)
        times.append(time.process_time() - began)
    return min(times)


def _other_plan(job: Job, plain: Start | None, failure: str) -> Start:
    """Return the first gait of another plan, where the plain one fails; print early what can be expected."""
    job.print(f"plain plan: {failure}; searching for the cheapest plan that walks")
    options = job.options
    if (cost := _stored_plan(job)) is not None:
        return _start(job, "cheapest", cost)
    scene, states, walk = _scene(job.model, options.gearbox), _states(job), options.walk or {}
    check_speed(scene, states, **walk)
    try:
        found = gentle_plan(scene, states, **walk)
        job.print(f"a plan of slow steps walks, at {found.value:.1f} J/m in its worlds")
        return _start(job, "cheapest", found.cost)
    except ValueError as error:
        job.print(f"{error}. Other plans are tried all the same")
    try:
        return plan_first_gait(job, "cheapest")
    except ValueError as error:
        if plain is None:  # the search starts from a gait that falls and may find one that walks
            raise
        return plain._replace(unplanned=str(error))


def _check_strength(job: Job) -> None:
    """Raise ValueError if servos are too weak for the robot to stand on one leg.

    A robot for which no plain walk can be planned is not checked: the planning that follows raises its own error.
    """
    try:
        plan = walking_plan(job.model, **(job.options.walk or {}))
    except ValueError:
        return
    check_strength(job.model, plan)


def plan_first_gait(job: Job, plan: PlanKind) -> Start:
    """Plan a first gait and evaluate it; raise ValueError if there is none."""
    options = job.options
    cost = _stored_plan(job) if plan == "cheapest" else None
    return _start(job, plan, cost or walking_cost(
        job.model, options.gearbox, states=_states(job), plan=plan, progress=options.progress, **(options.walk or {}),
    ))  # fmt: skip


def _start(job: Job, plan: PlanKind, cost: WalkingCost) -> Start:
    """Evaluate a first gait."""
    searched = in_worlds(cost, job.options.worlds) if job.options.worlds else cost
    return Start(plan, cost, searched, *searched(cost.gait.to_vector()), Watch(job.model, cost.start[0]))


def _stored_plan(job: Job) -> WalkingCost | None:
    """Return the cheapest plan stored for the humanoid with a servo, if its gait has the same measures today."""
    options = job.options
    if job.robot != "humanoid" or options.walk:
        return None
    for row in stored_rows().get(str(options.servo or "own"), ()):
        if row["name"] == CHEAPEST:
            cost = walking_cost(job.model, options.gearbox, states=_states(job), **row["settings"])
            if is_measured(row, cost.measure([cost.gait.to_vector()])[0]):
                return cost
    return None


def _states(job: Job) -> States:
    return job.options.states or default_states(job.model)


def default_states(model: Model) -> States:
    """Return "step" for a robot whose legs are mirror images, else "stride"."""
    try:
        mirror_of(model)
    except ValueError:
        return "stride"
    return "step"
