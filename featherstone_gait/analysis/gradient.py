"""Differentiate the cost of whole runs by what they start from: states, references, torques and physical numbers.

    result = gradient(scene, 2.0, cost, ["reference", "ground.friction"], reference=reference)
    result.value, result["ground.friction"]

The run is computed forwards and its adjoint backwards, at the cost of a few runs however many parameters there are
(core/integrate/adjoint.py).  The derivatives are exact, to rounding, of the run as it was computed, in its steps, with
all contacts, clips and choices as they were: see `Gradient.check` for what that means where contacts are made.
"""

from __future__ import annotations

import functools
import math
import os
import sys
import warnings
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, floats, functions, instance, listed, real, shown, texts, truth, whole
from ..base.brief import brief
from ..run.adjoint import Adjoint
from ..run.classify import to_trajectory
from ..run.compiled_run import CompiledRun
from ..run.prepare import prepare
from ..run.program import CompiledController
from ..run.reference import Reference
from ..run.simulate import one_a_run, simulate
from ..run.start import check_scene
from ..run.status import Status
from ..run.trajectory import Trajectory
from ..run.worlds import Worlds
from ..scene.compile import CompiledScene
from ..scene.external import Push
from .gradient_check import Given, GradientCheck, How, compare, in_shape, moved_by, scale_of, values_of
from .gradient_doubts import doubts
from .run_cost import Cost, check_derivatives, record_of, seeds_of
from .run_events import Event, channels_of, events_in
from .run_inputs import (
    CENTRAL,
    WIDTH,
    Pulled,
    check_names,
    is_number,
    moved,
    number_of,
    numbers_of,
    scenes_with,
    shape_of,
    slope,
    table_of,
)

T = TypeVar("T")
U = TypeVar("U")


class Along(NamedTuple):
    """Parameters that move: derivatives of the cost by each (n,), and what a run is given at a step (n,)."""

    slopes: np.ndarray
    moved: Callable[[np.ndarray], Given]


@dataclass(frozen=True, eq=False)
class Gradient(Mapping[str, np.ndarray]):
    """The cost of a run and its derivatives: a mapping from parameters to arrays, each in the parameter's shape.

    Attributes
    ----------
    value : float
        The cost; infinite of a run that ended before its time.
    derivatives : dict of ndarray
        Derivatives by each parameter; nan of a run that ended before its time.
    trajectory : Trajectory
        What the run recorded, its status and its final state, without estimated errors.
    """

    value: float
    derivatives: dict[str, np.ndarray]
    trajectory: Trajectory
    _source: Any = field(default=None, repr=False)
    _along: Along | None = field(default=None, repr=False)  # in place of the parameters, where these depend on others

    def __getitem__(self, name: str) -> np.ndarray:
        return self.derivatives[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.derivatives)

    def __len__(self) -> int:
        return len(self.derivatives)

    def __repr__(self) -> str:
        return brief(self)

    @property
    def status(self) -> Status:
        """How the run ended, as `Trajectory.status`; "doubtful" if that is "ok" and `doubts` says why."""
        return Status.DOUBTFUL if self.trajectory.ok and self.doubts else self.trajectory.status

    @functools.cached_property
    def doubts(self) -> str:
        """Why the gradient is doubtful; empty where nothing speaks against it, and without events in the run.

        It compares the gradient with differences that move the events by several steps, in some runs more.
        """
        if self.trajectory.failed or self._source is None:
            return ""
        given, how, cost = self._source
        name, along = given.scene.model.name, self._along or self._by_all()
        try:
            events = self.events
        except ValueError as error:  # its steps are too many to be kept
            return f"{name}: the gradient is doubtful, for the run's events are not known: {error}"
        run = lambda step: _cost_and_events(along.moved(step), how, cost)  # noqa: E731
        return doubts(name, along.slopes, events, run, given.scene.timestep)

    def _by_all(self) -> Along:
        """Return how the parameters move, each in its scale."""
        given, found = self._source[0], self.derivatives
        scales = np.concatenate([scale_of(given, name).ravel() for name in found])
        slopes = scales * np.concatenate([one.ravel() for one in found.values()])
        return Along(slopes, lambda step: moved_by(given, in_shape(scales * step, found)))

    @functools.cached_property
    def events(self) -> tuple[Event, ...]:
        """Changes of branches in the run: contacts made and broken, slipping and sticking, limits and stops.

        They are found when they are first asked for, by one more run that records every step.
        """
        given, how, _ = self._source
        return events_in(given.scene, _at_every_step(given, how, channels_of(given.scene)))

    def check(self, width: float = 1e-3, tolerance: float = 0.1, each: bool = False) -> GradientCheck:
        """Compare the gradient with differences of whole runs, and say which derivatives are doubtful.

        First two runs, a step along the gradient and one back: where their difference agrees, so does the gradient at
        this width, and nothing is doubtful.  Else each parameter is moved to both sides, eight runs to a vector.

        Parameters
        ----------
        width
            By how much parameters move: physical numbers by this share of theirs, states, references and torques by so
            many of their units [rad, m, N m].  Take the step that an optimizer makes.
        tolerance
            Relative difference from which a derivative is doubtful.
        each
            Move each parameter in any case.

        Returns
        -------
        GradientCheck

        Raises
        ------
        ValueError
            For widths and tolerances out of range, and of a run that ended before its time.
        """
        width = real("width", width, 1e-12, 1e6, "1e-3 is a milliradian, or a thousandth of a number")
        tolerance = real("tolerance", tolerance, 0.0, 1.0, "0.1 is a tenth")
        truth("each", each)
        if self.trajectory.failed:
            raise ValueError(f"{self.trajectory.message}: there is no gradient to check")
        given, how, cost = self._source
        return compare(given, self.derivatives, functools.partial(values_of, cost, how), width, tolerance, each)


def gradient(
    scene: CompiledScene,
    duration: float,
    cost: Cost,
    parameters: Sequence[str],
    state: ArrayLike | Trajectory | None = None,
    reference: Reference | None = None,
    tau: Reference | ArrayLike | None = None,
    pushes: Sequence[Push] = (),
    record: Sequence[str] | None = None,
    record_interval: float | None = None,
    *,
    controller: CompiledController | None = None,
) -> Gradient:
    """Simulate a scene, and differentiate a cost of what it records by any number of parameters.

    Parameters
    ----------
    scene
        The scene, with one of the integrators of fixed steps "implicit_euler", "midpoint" and "rk4".
    duration, state, reference, tau, pushes, record, record_interval, controller
        As in `simulate`; record None: the channels that a compiled cost takes.
    cost
        A function of recorded channels made by `run_cost`, or any function that is called with a dictionary of the
        channels, each (records, ...), and returns the cost and a dictionary of its derivatives by channels.
    parameters
        Names of what to differentiate by, and the shapes of the derivatives:

        - "state" (size,); "state.CHANNEL", such as "state.qd", in the channel's shape.  Those of base_q and base_qd are
          six numbers: of base_q a translation [m] and a rotation in body axes [rad].  Of coupled joints the leaders
          count.
        - "reference", "tau": values at the knots (knots, joints); of a cyclic signal without the last knot, which
          repeats the first.  "tau" given as an array (joints,) has its shape.
        - "controller": the numbers with which the memory of a compiled controller begins (memory,), such as its gains:
          `CompiledController.beginning_with`.
        - Physical numbers by the section and name that `Worlds` gives them, as "ground.friction",
          "servos.resistance" (servos,), "servos.left_knee.resistance" (), "links.mass" (links,), "gravity" (3,).

    Returns
    -------
    Gradient

    Raises
    ------
    ValueError
        If arguments do not fit, for scenes without gradients, and for parameters that are no function of numbers.

    Warns
    -----
    RuntimeWarning
        If the gradient is doubtful: events within steps, such as contacts made, make it differ from differences.

    See Also
    --------
    gradient_batch : several runs or worlds, over threads.
    RunObjective : a function of one vector, for optimizers.

    Examples
    --------
    >>> @run_cost
    ... def height(base_q):
    ...     return base_q[-1, 2]
    >>> gradient(scene, 1.0, height, ["reference", "links.mass"], reference=reference)["links.mass"]
    """
    return gradient_batch(
        scene, duration, cost, parameters, [state], [reference], [tau], pushes, record, record_interval, threads=1,
        controller=controller,
    )[0]  # fmt: skip


def gradient_batch(
    scene: CompiledScene | Sequence[CompiledScene],
    duration: float,
    cost: Cost,
    parameters: Sequence[str],
    states: Sequence[ArrayLike | Trajectory | None] | None = None,
    references: Sequence[Reference | None] | None = None,
    taus: Sequence[Reference | ArrayLike | None] | None = None,
    pushes: Sequence[Push] = (),
    record: Sequence[str] | None = None,
    record_interval: float | None = None,
    *,
    worlds: Worlds | None = None,
    threads: int | None = None,
    controller: CompiledController | None = None,
) -> list[Gradient]:
    """Differentiate the cost of several runs, each as `gradient` does, to the same bits.

    Parameters
    ----------
    scene
        One for all runs, or a list with one for each.
    duration, cost, parameters, pushes, record, record_interval, controller
        As in `gradient`.
    states, references, taus
        Lists of equal length with an entry for each run, or None.
    worlds
        Physical numbers in which the runs differ.
    threads
        Number of threads; None: one for each core.

    Returns
    -------
    list of Gradient

    Raises
    ------
    ValueError
        As `gradient`, and for lists that differ in length.

    Warns
    -----
    RuntimeWarning
        Once, if any is doubtful.
    """
    functions(cost=cost)
    names = texts("parameters", parameters)
    several = not isinstance(scene, CompiledScene)
    remedy = "give what compile_scene returns, or a list of these"
    scenes: list[Any] = listed("scene", scene, remedy) if several else [scene]
    for one in scenes:
        check_scene(one)
        check_names(one, names)
    if worlds is not None:
        instance("worlds", worlds, Worlds, "give Worlds(...)")
        if several:
            raise ValueError(f"worlds are given, and {len(scenes)} scenes; give one scene with worlds")
        scenes = worlds.scenes(scenes[0])
    each = {"states": states, "references": references, "taus": taus}
    lists: dict[str, list[Any]] = {name: one_a_run(name, given) for name, given in each.items() if given is not None}
    count = max([len(given) for given in lists.values()], default=len(scenes))
    lists["scenes"] = scenes if several or worlds is not None else scenes * count
    if any(len(given) != count for given in lists.values()):
        found = ", ".join(f"{name} {len(given)}" for name, given in lists.items())
        raise ValueError(f"gradient_batch: the lists have {found} entries; give as many of each, one a run")
    rows = zip(lists["scenes"], *(lists.get(name, [None] * count) for name in each))
    runs = [Given(*row)._replace(controller=controller) for row in rows]
    how = How(duration, pushes, record_of(cost, record), record_interval)
    results = differentiated(runs, how, cost, names, threads)
    warn_of_doubts(results, threads)
    return results


def differentiated(
    runs: Sequence[Given], how: How, cost: Cost, names: Sequence[str], threads: int | None
) -> list[Gradient]:
    """Return the gradient of each run, without looking for doubts."""
    return _over_threads(lambda run: _differentiate(run, how, cost, names), runs, threads)


def warn_of_doubts(found: Sequence[Gradient], threads: int | None = 1) -> bool:
    """Warn if gradients are doubtful, where the package was called; return whether any is."""
    doubts = [text for text in _over_threads(lambda one: one.doubts, found, threads) if text]
    if doubts:
        more = f" ({len(doubts)} of {len(found)} gradients are doubtful)" * (len(found) > 1)
        package, frame, level = __name__.partition(".")[0], sys._getframe(), 1
        while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == package:
            frame, level = frame.f_back, level + 1
        warnings.warn(doubts[0] + more, RuntimeWarning, stacklevel=level)
    return bool(doubts)


class Doubter:
    """Looks for doubts in the gradients of a search: where events are of a kind or at a place not seen before.

    Once it has found a doubt it looks no more; `Gradient.doubts` is always there to ask.
    """

    def __init__(self) -> None:
        self.seen: set[tuple[str, str]] = set()
        self.found = False

    def fresh(self, found: Sequence[Gradient], threads: int | None) -> list[Gradient]:
        """Return the gradients of runs with such events."""
        if self.found:
            return []
        places = _over_threads(self._places, found, threads)
        fresh = [one for one, new in zip(found, places) if new - self.seen]
        self.seen.update(*places)
        return fresh

    @staticmethod
    def _places(one: Gradient) -> set[tuple[str, str]]:
        try:
            return set() if one.trajectory.failed else {(event.what, event.where) for event in one.events}
        except ValueError:  # `doubts` says why
            return {("", "")}


def _over_threads(work: Callable[[T], U], runs: Sequence[T], threads: int | None) -> list[U]:
    many = os.cpu_count() or 1 if threads is None else whole("threads", threads, 1, "give how many work at once")
    if min(many, len(runs)) <= 1:
        return [*map(work, runs)]
    with ThreadPoolExecutor(min(many, len(runs))) as pool:
        try:
            return list(pool.map(work, runs))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)  # after Ctrl-C or an error no further run begins
            raise


def _differentiate(given: Given, how: How, cost: Cost, names: Sequence[str]) -> Gradient:
    """Run forwards and backwards."""
    scene, reference, tau = given.scene, given.reference, given.tau
    shapes = {name: shape_of(scene, name, reference, tau, given.controller) for name in names}
    run = _prepared(scene, how, given.controller)
    start = run.start(given.state, reference, tau)
    adjoint = Adjoint(run, start, _others(given, how, names))
    out = adjoint.run()
    trajectory = to_trajectory(run, adjoint.final, out, run.schedule(start.y))
    if trajectory.failed:
        nothing = {name: np.full(shape, math.nan) for name, shape in shapes.items()}
        return Gradient(math.inf, nothing, trajectory, (given, how, cost))
    if not _is_checked(cost):
        check_derivatives(cost, trajectory.channels)
        with suppress(TypeError):
            _checked.add(cost)
    value, seeds = seeds_of(cost, run, out, trajectory.channels)
    pulled = Pulled(adjoint, adjoint.pull(seeds), scene)
    if reference is None or reference.values.shape[1] == scene.tree.n:
        pulled.hold(joints=reference is None)
    found = {name: pulled.by(name, reference, tau, given.state is not None) for name in names}
    return Gradient(value, found, trajectory, (given, how, cost))


def _at_every_step(given: Given, how: How, record: Sequence[str]) -> Trajectory:
    scene = given.scene
    return simulate(
        scene, how.duration, given.state, given.reference, given.tau, how.pushes, record, scene.timestep,
        estimate_error=False, controller=given.controller,
    )  # fmt: skip


def _cost_and_events(given: Given, how: How, cost: Cost) -> tuple[float, tuple[Event, ...]]:
    """Run once; return the cost, infinite of a run that ends before its time, and the events."""
    scene, prepared = given.scene, _prepared(given.scene, how, given.controller)
    run = _at_every_step(given, how, [*dict.fromkeys((*prepared.record, *channels_of(scene)))])
    if run.failed:
        return math.inf, ()
    at = {name: run[name][:: prepared.plan.per_sample] for name in ("time", *prepared.record)}
    return float(cost(at)[0]), events_in(scene, run)


_checked: weakref.WeakSet[Cost] = weakref.WeakSet()


def _is_checked(cost: Cost) -> bool:
    """Return whether the derivatives of a cost have been checked; of one that no set can hold each time anew."""
    try:
        return cost in _checked
    except TypeError:
        return False


def _prepared(scene: CompiledScene, how: How, controller: CompiledController | None) -> CompiledRun:
    return prepare(scene, how.duration, how.record, how.record_interval, pushes=how.pushes, controller=controller)


def _others(given: Given, how: How, names: Sequence[str]) -> list[CompiledRun]:
    """Return runs of scenes that differ from the scene in all constants that depend on parameters."""
    scenes = [one for name in names if is_number(name) for one in table_of(given.scene, name).others]
    return [_prepared(one, how, given.controller) for one in scenes]


class RunObjective:
    """The cost of a run and its gradient as a function of one vector, for optimizers.

    The first doubtful gradient warns; it is looked for where a run has events of a kind or at a place that none before
    has had, and `last` names any.

    ``scipy.optimize.minimize(objective, x0, jac=True)`` takes it as it is.

    Parameters
    ----------
    scene, duration, cost, pushes, record, record_interval, controller
        As in `gradient`.
    inputs : callable
        Called with a vector (n,); returns what a run at it is given, by parameter: "state", "reference", "tau",
        "controller" (the numbers with which its memory begins), and physical numbers, as
        ``{"reference": Reference(times, x.reshape(5, 2)), "ground.friction": 0.5}``.  Knot times must not depend on the
        vector.  Its own derivatives are extrapolated central differences, of `inputs` alone.
    worlds : Worlds, optional
        Worlds over which cost and gradient are averaged.
    threads : int, optional
        As in `gradient_batch`.
    scale : array_like
        Sizes of the vector's entries, of which the differences of `inputs` take a thousandth, where an entry is
        smaller than that.

    Attributes
    ----------
    last : list of Gradient
        Results of the last call, one for each world.

    Raises
    ------
    ValueError
        As `gradient`; for inputs that are no parameters, or not smooth in the vector.

    Examples
    --------
    >>> objective = RunObjective(scene, 1.0, cost, lambda x: {"state": initial_state(scene, qd=x)})
    >>> scipy.optimize.minimize(objective, np.zeros(7), jac=True, method="BFGS")
    """

    def __init__(
        self,
        scene: CompiledScene,
        duration: float,
        cost: Cost,
        inputs: Callable[[np.ndarray], Mapping[str, Any]],
        pushes: Sequence[Push] = (),
        record: Sequence[str] | None = None,
        record_interval: float | None = None,
        *,
        worlds: Worlds | None = None,
        threads: int | None = None,
        scale: ArrayLike = 1.0,
        controller: CompiledController | None = None,
    ) -> None:
        check_scene(scene)
        functions("inputs", cost=cost, inputs=inputs)
        self.scenes = [scene] if worlds is None else worlds.scenes(scene)
        self.cost, self.inputs, self.threads, self.controller = cost, inputs, threads, controller
        self.how = How(duration, pushes, record_of(cost, record), record_interval)
        self.scale = floats("scale", scale)
        if not (np.isfinite(self.scale).all() and (self.scale > 0.0).all()):
            raise ValueError(f"scale is {shown(scale)}; give positive sizes of the vector's entries")
        self.last: list[Gradient] = []
        self._doubter = Doubter()

    def __repr__(self) -> str:
        name, count = self.scenes[0].model.name, len(self.scenes)
        return f"<objective: {self.how.duration:g} s of {name} in {count} world{'s' * (count > 1)}>"

    def __call__(self, x: ArrayLike) -> tuple[float, np.ndarray]:
        """Return the cost and its gradient (n,) at a vector (n,), means over the worlds."""
        x = np.array(finite("x", x, (None,), "a vector"))
        if self.scale.shape not in ((), x.shape):
            raise ValueError(f"scale has the shape {self.scale.shape}, x {x.shape}; give one size, or one an entry")
        given = self._given(x)
        names, runs, slopes = [*given], self._runs(given), self._slopes(x, given)
        found = differentiated(runs, self.how, self.cost, names, self.threads)
        each = [np.zeros(len(x)) for _ in found]
        for own, one in zip(each, found):
            for name in names:
                own += np.einsum("xi,i->x", slopes[name], one[name].ravel())
        self.last = [self._along(x, k, one, own) for k, (one, own) in enumerate(zip(found, each))]
        self._doubter.found |= warn_of_doubts(self._doubter.fresh(self.last, self.threads), self.threads)
        total = np.zeros(len(x))
        for own in each:
            total += own
        return float(np.mean([one.value for one in self.last])), total / len(self.last)

    def _runs(self, given: Mapping[str, Any]) -> list[Given]:
        """Return what a run in each world is given."""
        numbers = {name: number[None] for name, number in given.items() if is_number(name)}
        signals = {name: given.get(name) for name in ("state", "reference", "tau")}
        law = self._controller_at(given)
        return [Given(scenes_with(scene, numbers)[0], **signals, controller=law) for scene in self.scenes]

    def _along(self, x: np.ndarray, world: int, one: Gradient, slopes: np.ndarray) -> Gradient:
        """Return a gradient that is doubted by the vector, in its scale."""
        scale = np.broadcast_to(self.scale, x.shape)
        moved = lambda step: self._runs(self._given(x + scale * step))[world]  # noqa: E731
        return replace(one, _along=Along(scale * slopes, moved))

    def _controller_at(self, given: Mapping[str, Any]) -> CompiledController | None:
        if "controller" in given and self.controller is None:
            raise ValueError("inputs: 'controller' is one, but none is given: give controller=...")
        if self.controller is None or "controller" not in given:
            return self.controller
        return self.controller.beginning_with(given["controller"])

    def _given(self, x: np.ndarray) -> dict[str, Any]:
        """Return what a run at a vector is given, checked; numbers as arrays in their own shape."""
        given = self.inputs(x)
        instance("inputs", given, Mapping, "return a dictionary by parameter, as {'state': ...}")
        check_names(self.scenes[0], [*given])
        found = {}
        for name, value in given.items():
            if name.startswith("state."):
                raise ValueError(f"inputs: give the whole state, made by initial_state, in place of {name!r}")
            found[name] = value
            if is_number(name):
                shape = number_of(self.scenes[0], name).shape
                found[name] = np.broadcast_to(np.array(floats(f"inputs: {name}", value)), shape)
        return found

    def _slopes(self, x: np.ndarray, given: dict[str, Any]) -> dict[str, np.ndarray]:
        """Return derivatives of each input (n, numbers) by the vector."""
        widths = WIDTH * np.maximum(np.abs(x), self.scale)
        found = {name: np.zeros((len(x), numbers_of(value).size)) for name, value in given.items()}
        for k, width in enumerate(widths):
            each = [self._given(moved(x, k, share * width)) for share in CENTRAL[0]]
            for name, own in given.items():
                for one in each:
                    _check_times(name, own, one.get(name))
                found[name][k] = slope([numbers_of(one[name]).ravel() for one in each], numbers_of(own).ravel(), width)
        return found


def _check_times(name: str, own: Any, other: Any) -> None:
    """Raise ValueError for an input of another kind at a neighboring vector."""
    times = [one.times.tobytes() if isinstance(one, Reference) else b"" for one in (own, other)]
    if other is None or times[0] != times[1] or numbers_of(own).shape != numbers_of(other).shape:
        raise ValueError(f"inputs: {name} has other knots or another shape at vectors nearby: leave these as they are")
