"""A run made ready: what the kernels are called with, for one robot or eight in lanes.

    ready = prepare(scene, 2.0, record=("q",))
    y, out = ready.run([ready.start(state, reference)])[0]

`simulate` goes this way; benchmarks and whoever wants to call the kernels as often as they please do it by hand, with
`ready.arguments(...)` and `ready.kernel`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, instance, is_real, listed, real, shown, vector
from ..core.compile.lanes import WIDTH, aligned
from ..core.compile.varying import Varying
from ..core.effects.actuator import controller_of
from ..core.effects.controller import PID_SPEED
from ..core.integrate.adaptive import rollout_adaptive
from ..core.integrate.integrator import Sizes
from ..core.integrate.rollout import DIVERGED, FELL, OK, TOO_COSTLY, TOO_SMALL, rollout_lanes, rollout_one
from ..core.step import pace, state
from ..core.step.context import Plan, Run, Scene
from ..core.step.program import DONE, FIRST, OFFSET
from ..core.step.signals import Knots, Signals
from ..geometry.distance import clearance_channel
from ..scene.compile import CompiledScene
from ..scene.contact import by_body
from ..scene.coupling import check_followers
from ..scene.external import Push
from .channels import current_name
from .differing import has_varying, of_own_lanes, put, structure, together
from .interrupt import Kernel, call_interruptibly, compiled
from .program import CompiledController
from .reference import Reference
from .start import check_quaternion, check_scene, initial_state
from .trajectory import Trajectory

Zeros = Callable[[int | tuple[int, ...]], np.ndarray]

LEAST_STEP = 1e-9  # of error control [s]
BUDGET, BUDGET_RATE = 2e6, 2e4  # of its steps, with those rejected: minutes of computing, and as many a second more
INTERRUPTIBLE = 3e5  # steps by velocities: some 0.1 s of computing, from which on a run looks for Ctrl-C
PAUSE = 3e4  # evaluations by velocities: some 10 ms, after which one with error control does
MOST_STEPS = 10**9  # of a run: hours
MOST_NUMBERS = 2**28  # that a run records: 2 GiB
MOST_KNOTS = 1e8  # of a signal, at which steps of error control end
ENDS = (OK, FELL, DIVERGED, TOO_SMALL, TOO_COSTLY)  # what the status of a state may be
OF_MODEL = {"clearance": clearance_channel}  # computed channels that take the robot too


class Start(NamedTuple):
    """What one simulation starts from."""

    y: np.ndarray
    reference: Knots | None
    torques: Knots | None
    noise: np.ndarray | None
    world: Prepared  # where it runs


class Numbers(NamedTuple):
    """What runs that share lanes may have each for themselves: `Varying` if they do."""

    constants: Scene
    min_height: float | Varying  # see `Plan`


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scene and the course of its runs; made by `prepare`."""

    scene: CompiledScene
    plan: Plan
    record: tuple[str, ...]
    stored: dict[str, slice]  # where each channel lies among the recorded numbers
    channels: np.ndarray  # indices into the state of all recorded numbers
    stop: np.ndarray = field(default_factory=lambda: np.zeros(1, np.int64))  # (1,): not 0 ends all its runs
    of_lanes: Numbers | None = None  # of all whose runs share its lanes; None where all numbers are its own
    controller: CompiledController | None = None

    @property
    def numbers(self) -> Numbers:
        """Its own."""
        return Numbers(self.scene.constants, self.plan.min_height)

    def among(self, others: Sequence[Prepared]) -> Prepared:
        """The same, whose lanes take runs of the others too: scenes of its structure (see `differing`)."""
        numbers = together([other.numbers for other in others])
        return replace(self, of_lanes=numbers) if has_varying(numbers) else self

    def start(
        self,
        state: ArrayLike | Trajectory | None = None,
        reference: Reference | None = None,
        tau: Reference | ArrayLike | None = None,
        noise: ArrayLike | None = None,
    ) -> Start:
        """What one simulation starts from: see `simulate`; ValueError on what does not fit."""
        scene, n, o = self.scene, self.scene.tree.n, self.scene.layout
        y = initial_state(scene) if state is None else _taken_up(scene, state)
        check_followers(scene.model, scene.tree.coupling, y[o["q"] : o["q"] + n], y[o["qd"] : o["qd"] + n])
        driven = scene.constants.actuator is not None
        if reference is not None and not driven:
            raise ValueError(f"{scene.model.name}: a reference needs servos; compile the scene with gearbox=...")
        if reference is None and driven:
            reference = Reference([0.0], y[None, o["q"] : o["q"] + n])
        if reference is not None and not isinstance(reference, Reference):
            raise ValueError(f"reference is a {type(reference).__name__}; give Reference(times, values)")
        if tau is not None and scene.adaptive and self.plan.integrated < int(o["after_integrated"]):
            raise ValueError(f"{scene.model.name}: torques from outside need prepare(..., driven=True)")
        if tau is not None and scene.method.drives:
            raise ValueError(
                f"{scene.integrator} takes its torques from the servos alone; use implicit_euler for scenes with tau"
            )
        if tau is not None and not isinstance(tau, Reference):
            tau = Reference([0.0], vector("tau", tau, n, "[N m or N], or a Reference")[None])
        for what, signal in (("reference", reference), ("tau", tau)):
            if signal is not None and signal.values.shape[1] != n:
                raise ValueError(
                    f"{scene.model.name}: {what} has {signal.values.shape[1]} columns; the robot has {n} joints: "
                    f"{', '.join(scene.model.joint_names)}"
                )
            if signal is not None:
                self._check_knots(what, signal)
        knots, torques = (signal.knots() if signal else None for signal in (reference, tau))
        start = Start(y, knots, torques, self._noise(noise), self)
        return start._replace(y=_with_first_error(scene, start))

    def _check_knots(self, what: str, signal: Reference) -> None:
        """Refuse a cyclic signal that would end so many steps of error control that the run takes days."""
        if not (signal.cyclic and self.scene.adaptive):
            return
        period, duration = float(signal.times[-1] - signal.times[0]), self.plan.steps * self.plan.h
        if duration / period * len(signal.times) > MOST_KNOTS:
            raise ValueError(
                f"{what}: a period of {period:g} s with {len(signal.times)} knots is passed {duration / period:.3g} "
                f"times in {duration:g} s, and steps end at each; at most {MOST_KNOTS:g}: give a longer period"
            )

    def _noise(self, noise: ArrayLike | None) -> np.ndarray | None:
        if noise is None:
            return None
        scene, plan = self.scene, self.plan
        if not scene.sampled:
            raise ValueError(f"{scene.model.name}: noise acts on sampled servos; this scene has none")
        noise, shape = np.array(floats("noise", noise)), (plan.steps // plan.per_tick, scene.tree.n, 2)
        if noise.shape != shape or not np.isfinite(noise).all():
            raise ValueError(
                f"{scene.model.name}: noise must be {shape} finite numbers, a row for each tick of the duration, "
                f"{plan.steps * plan.h:g} s; its shape is {noise.shape}"
            )
        return noise

    def course(self, start: Start) -> Plan:
        """The plan of a run from `start`, at the time to which its state has come: 0 of a new one.

        Raises ValueError for a time that is none.
        """
        h, begun = self.plan.h, float(start.y[self.scene.layout["end_time"]])
        if not 0.0 <= begun < 2.0**52 * h:
            raise ValueError(
                f"state: its time is {begun!r} s; expected >= 0 and less than 2^52 steps: see `reset_time`"
            )
        first = round(begun / h)
        if abs(first * h - begun) > 1e-6 * h:
            return self.plan._replace(offset=begun)
        return self.plan._replace(first=first)

    @property
    def samples(self) -> int:
        """Records of a run."""
        return self.plan.steps // self.plan.per_sample + 1

    @property
    def kernel(self) -> Kernel:
        """What `arguments` of one run are for."""
        return rollout_adaptive if self.scene.adaptive else rollout_one

    def arguments(self, start: Start, out: np.ndarray | None = None) -> tuple[Run, np.ndarray, np.ndarray]:
        """What the kernel takes for one run: the run, its state, which moves on, and its records."""
        signals = self.signals(start.reference, start.torques, np.zeros)._replace(noise=start.noise)
        out = np.zeros((self.samples, len(self.channels))) if out is None else out
        run = self.bound(signals, np.zeros)._replace(plan=self.course(start))
        set_clock(run, run.plan)
        return run, start.y.copy(), out

    def arguments_in_lanes(self, starts: Sequence[Start]) -> tuple[Run, np.ndarray, np.ndarray]:
        """What `rollout_lanes` takes for up to eight runs of the same time whose signals have the same knot times."""
        starts = [*starts, *[starts[-1]] * (WIDTH - len(starts))]
        alone = self.of_lanes is not None or all(start.world is self for start in starts)
        ready = self if alone else self.among([start.world for start in starts])
        y, out = aligned((len(starts[0].y), WIDTH)), aligned((self.samples, max(len(self.channels), 1), WIDTH))
        y[:] = np.stack([start.y for start in starts], axis=-1)
        references, torques = (_in_lanes(knots) for knots in zip(*(start[1:3] for start in starts)))
        signals = self.signals(references, torques, lane_zeros)
        noises = [start.noise for start in starts if start.noise is not None]  # of all or of none
        if noises:
            noise = aligned((*noises[0].shape, WIDTH))
            noise[:] = np.stack(noises, axis=-1)
            signals = signals._replace(noise=noise)
        course = starts[0].world.course(starts[0])
        run = ready.bound_in_lanes(signals)
        for lane, start in enumerate(starts):
            ready.put(run, lane, start)
        set_clock(run, course)
        return run._replace(plan=course._replace(min_height=run.plan.min_height)), y, out

    def run(self, starts: Sequence[Start]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Final state and records of up to eight runs, of more than one in step.

        Raises ValueError unless they can be: fixed steps, signals of the same knot times, states of the same time,
        noise for all or none.
        """
        if len(starts) == 1:
            world = starts[0].world
            run, y, out = world.arguments(starts[0])
            world.call(world.kernel, run, y, out)
            return [(y, out)]
        self._check_alike(starts)
        run, y, out = self.arguments_in_lanes(starts)
        self.call(rollout_lanes, run, y, out)
        return [(y[:, k].copy(), out[:, : len(self.channels), k].copy()) for k in range(len(starts))]

    def call(self, kernel: Kernel, run: Run, y: np.ndarray, out: np.ndarray) -> None:
        """Call the kernel; KeyboardInterrupt where `stop` has ended the run, as Ctrl-C in the main thread does."""
        if self.scene.adaptive:
            if not kernel(self._pausing(run, y), y, out):
                call_interruptibly(kernel, run, y, out)
        elif run.plan.steps * self.scene.model.nv > INTERRUPTIBLE:
            compiled(kernel, run, y, out)
            call_interruptibly(kernel, run, y, out)
        else:
            kernel(run, y, out)
        if self.stop[0]:
            raise KeyboardInterrupt
        if self.controller is not None:
            self.controller.check(run.signals.program)

    def _pausing(self, run: Run, y: np.ndarray) -> Run:
        """The run, up to where it pays to hand it to the thread that Ctrl-C ends."""
        done = y[self.scene.part("step_control")[0] + pace.EVALUATIONS]
        return run._replace(plan=run.plan._replace(pause=float(done) + PAUSE / max(self.scene.model.nv, 1)))

    def _check_alike(self, starts: Sequence[Start]) -> None:
        name = self.scene.model.name
        if not 1 <= len(starts) <= WIDTH or self.scene.adaptive:
            raise ValueError(f"{name}: {len(starts)} runs at once; 1 to {WIDTH} go in step, with error control one")
        if len({start.noise is None for start in starts}) > 1:
            raise ValueError(f"{name}: some runs have noise and some have none; give all of them an array, or none")
        for first, other in zip(starts[0][1:3] * len(starts), (knots for start in starts for knots in start[1:3])):
            same = (first is None) == (other is None)
            if not same or (first is not None and not _same_times(first, other)):
                raise ValueError(f"{name}: signals of other knot times do not go in step; run them one by one")
        if len({structure(world.scene.constants) for world in {id(s.world): s.world for s in starts}.values()}) > 1:
            raise ValueError(f"{name}: scenes that differ in more than numbers do not go in step; run them one by one")
        if len({start.y[self.scene.layout["end_time"]] for start in starts}) > 1:
            raise ValueError(f"{name}: states of other times do not go in step; run them one by one")

    def signals(self, reference: Knots | None, torques: Knots | None, zeros: Zeros) -> Signals:
        """What comes from outside; zeros(shape) makes the arrays for its present values."""
        n = self.scene.tree.n
        values, tau = (None, None) if torques is None else (zeros((n, 2)), zeros(n))
        continuous = True if self.scene.constants.actuator is not None and not self.scene.sampled else None
        return Signals(reference, zeros((n, 2)), torques, values, tau, None, None, continuous)

    def bound(self, signals: Signals, zeros: Zeros) -> Run:
        """The run with these signals; zeros(shape) makes the arrays that it overwrites."""
        scene, constants = self.scene, self.scene.constants
        sizes = Sizes(
            n=scene.tree.n,
            floating=scene.tree.floating,
            points=0 if constants.contact is None else len(constants.contact.points),
            workspace=scene.tree.workspace_shape(),
            places=scene.layout,
            motors=scene.tree.n if scene.sampled else 0,
            driven=signals.tau is not None,
            stiff=scene.stiff,
        )
        work, good = scene.method.workspace(sizes, zeros), zeros(int(scene.layout["length"]))
        frames = zeros(sizes.workspace) if sizes.floating and sizes.points else None
        if self.controller is not None:
            signals = signals._replace(program=self.controller.bound(scene, zeros))
        return Run(constants, scene.places, self.plan, signals, work, good, self.channels, frames, self.stop)

    def bound_in_lanes(self, signals: Signals) -> Run:
        """The same in lanes; `put` gives each of them the numbers in which its run differs."""
        run = self.bound(signals, lane_zeros)
        if self.of_lanes is None:
            return run
        constants, min_height = of_own_lanes(self.of_lanes)
        return run._replace(scene=constants, plan=run.plan._replace(min_height=min_height))

    def put(self, run: Run, lane: int, start: Start) -> None:
        """Give a lane of `bound_in_lanes` the numbers of the run's own scene, and a new memory to its controller."""
        if start.world.controller is not None:
            run.signals.program.memory[..., lane] = start.world.controller.first_memory
        if self.of_lanes is not None:
            put(Numbers(run.scene, run.plan.min_height), lane, start.world.numbers)

    def named(self, out: np.ndarray, course: Plan | None = None) -> dict[str, np.ndarray]:
        """Recorded numbers (samples, all) as channels in their natural shape; course: see `course`."""
        found = {"time": _times(self.plan if course is None else course, len(out))}
        for name in self.record:
            channel = state.BY_NAME[name]
            if channel.kind != "computed":
                found[name] = state.shaped(channel, out[:, self.stored[name]])
            else:
                needed = [state.shaped(state.BY_NAME[need], out[:, self.stored[need]]) for need in channel.needs]
                compute = channel.compute or functools.partial(OF_MODEL[name], self.scene.model)
                found[name] = compute(*needed)
        return found


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
) -> Prepared:
    """Make runs of a scene ready; the arguments are those of `simulate`, driven: by torques from outside."""
    check_scene(scene)
    if controller is not None:
        instance("controller", controller, CompiledController, "decorate its function with @controller(...)")
        scene = controller.driving(scene)
    plan = _plan(scene, duration, record_interval)
    if scene.adaptive:
        o, acts = scene.layout, scene.constants
        works = any(part is not None for part in (acts.actuator, acts.friction, acts.stops, acts.contact)) or driven
        integrated = int(o["after_integrated" if works else "after_controlled"])
        rtol = scene.rtol if rtol is None else rtol
        atol = rtol if atol is None else atol
        plan = plan._replace(rtol=rtol, atol=atol, least_step=LEAST_STEP, integrated=integrated)
        plan = plan._replace(companion=scene.method.companion, budget=BUDGET + BUDGET_RATE * plan.steps * plan.h)
    record = recorded(scene, record)
    ready = Prepared(scene.pushed(pushes), plan, record, *_stored(scene, record), controller=controller)
    _check_size(ready)
    return ready


def recorded(scene: CompiledScene, record: Iterable[str] | None) -> tuple[str, ...]:
    """The channels to record, those of the coordinates if None; TypeError for no list."""
    if record is None:
        return coordinates(scene)
    return tuple(map(current_name, listed("record", record, "give a list of channels, such as ('q', 'qd')")))


def coordinates(scene: CompiledScene) -> tuple[str, ...]:
    """The channels of positions and velocities, by which a run is judged."""
    return ("q", "qd", *(("base_q", "base_qd") if scene.tree.floating else ()))


def _check_size(ready: Prepared) -> None:
    """Raise ValueError for a run whose records would fill the memory."""
    if ready.samples * max(1, len(ready.channels)) > MOST_NUMBERS:
        raise ValueError(
            f"{ready.scene.model.name}: {ready.samples} records of {len(ready.channels)} numbers each; at most "
            f"{MOST_NUMBERS} numbers: shorten the duration, record fewer channels, or pass a longer record_interval [s]"
        )


def with_tolerance(
    scene: CompiledScene, rtol: float | None, atol: float | None
) -> tuple[CompiledScene, float | None, float | None]:
    """The scene with an integrator that can meet the tolerances, and these; None for fixed steps.

    Raises ValueError on tolerances out of range, and where the integrator has no continuous limit.
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
        why = f"rtol asks for error control, and {so} stiff, sampled or on the ground"
        if rtol is None:
            why = f"controllers jump by what {scene.largest_jump:.2g} rad ask for, which asks for rtol {wanted:g}"
        scene = scene.in_place(taken, why)
    if not scene.adaptive:
        return scene, None, None
    return scene, wanted, wanted if atol is None else atol


def _plan(scene: CompiledScene, duration: float, record_interval: float | None) -> Plan:
    """The run in whole steps, ticks and samples."""
    h, tick = scene.timestep, scene.tick_steps
    if not is_real(duration) or not 0 < duration < math.inf:
        raise ValueError(f"duration is {shown(duration)} s; it must be positive and finite: give seconds")
    if duration > MOST_STEPS * h:
        raise ValueError(
            f"duration is {duration!r} s, {duration / h:.3g} steps of {h:g} s; at most {MOST_STEPS:g}: simulate less, "
            "or compile the scene with a larger timestep"
        )
    ticks = math.ceil(duration / (tick * h) - 1e-9)
    every = steps_between_records(scene, record_interval)
    falls = scene.fall_height, scene.fall_upright, scene.upright
    return Plan(h, scene.method.theta, ticks * tick, tick, every, scene.lag, *falls)


def steps_between_records(scene: CompiledScene, record_interval: float | None) -> int:
    """The time between records [s] in whole steps, those of a tick if None; ValueError if it is none."""
    h = scene.timestep
    if record_interval is None:
        return scene.tick_steps
    if (
        not is_real(record_interval)
        or not 0.5 <= record_interval / h < 2**53
        or abs(round(record_interval / h) * h - record_interval) > 1e-9 * record_interval
    ):
        raise ValueError(
            f"record_interval is {shown(record_interval)} s; it must be a whole number of steps of {h:g} s"
        )
    return round(record_interval / h)


def _stored(scene: CompiledScene, record: tuple[str, ...]) -> tuple[dict[str, slice], np.ndarray]:
    """Each channel's place among the recorded numbers, and the indices into the state of these."""
    indices: list[int] = []
    slices = {}
    for name in record:
        if not isinstance(name, str) or name not in state.RECORDABLE:
            known = ", ".join(state.RECORDABLE)
            raise ValueError(f"record: there is no channel {shown(name)}; channels: {known}: see help(simulate)")
        for stored in state.BY_NAME[name].needs or (name,):
            if stored in slices:
                continue
            places = np.arange(*scene.part(stored))
            if state.BY_NAME[stored].of == "point" and len(places):  # the scene keeps the points of a body together
                order = np.argsort(by_body(scene.model, scene.tree))
                places = places.reshape(len(order), -1)[order].ravel()
            slices[stored] = slice(len(indices), len(indices) + len(places))
            indices.extend(places)
    return slices, np.array(indices, dtype=np.int64)


def _times(course: Plan, count: int) -> np.ndarray:
    """Of the records [s]: bits do not depend on the pieces that a run is cut into between records."""
    samples, steps = divmod(course.first, course.per_sample)
    return course.offset + steps * course.h + (samples + np.arange(count)) * (course.per_sample * course.h)


def set_clock(run: Run, course: Plan, done: float = 0.0, lane: Any = Ellipsis) -> None:
    """Tell the controller of a run, or of a lane, its time: steps since its start, and the course it has there."""
    program = run.signals.program
    if program is not None:
        for k, value in ((DONE, done), (FIRST, course.first), (OFFSET, course.offset)):
            program.clock[k, lane] = value


def with_steps(ready: Prepared, steps: int, per_sample: int) -> Prepared:
    """The same for another number of steps, which need not be whole ticks."""
    return replace(ready, plan=ready.plan._replace(steps=steps, per_sample=per_sample))


def lane_zeros(shape: int | tuple[int, ...]) -> np.ndarray:
    """Zeros with a last axis of lanes."""
    return aligned((*np.atleast_1d(shape), WIDTH))


def _same_times(a: Knots, b: Knots) -> bool:
    return a.period == b.period and np.array_equal(a.times, b.times)


def _in_lanes(knots: Sequence[Knots | None]) -> Knots | None:
    there = [k for k in knots if k is not None]  # all or none
    if not there:
        return None
    cubics = aligned((*there[0].cubics.shape, WIDTH))
    cubics[:] = np.stack([k.cubics for k in there], axis=-1)
    return there[0]._replace(cubics=cubics)


def _taken_up(scene: CompiledScene, state: ArrayLike | Trajectory) -> np.ndarray:
    """The state of a vector, or at the end of a trajectory whose state has the same parts; ValueError otherwise."""
    if not isinstance(state, Trajectory):
        return _sound(scene, state)
    robot, joints = state.info.get("robot"), state.info.get("joints")
    if robot != scene.model.name or list(joints or ()) != list(scene.model.joint_names):
        raise ValueError(
            f"state: the trajectory is of {robot} with the joints {', '.join(joints or ())}; this scene is of "
            f"{scene.model.name} with {', '.join(scene.model.joint_names)}: give its `final` if that is meant"
        )
    if state.parts is not None and state.parts != scene.parts:
        raise ValueError(
            f"state: the trajectory of {state.info.get('robot')} ended in a state of {_sizes(state.parts)}; "
            f"this scene of {scene.model.name} has {_sizes(scene.parts)}: compile it with the same servos and contacts"
        )
    return _sound(scene, state.final)


def _sound(scene: CompiledScene, values: ArrayLike) -> np.ndarray:
    """The state as a vector; ValueError where the numbers cannot be what a run has left."""
    y = vector("state", values, int(scene.layout["length"]), "what initial_state gave, or the end of a run")
    check_quaternion(scene, y[slice(*scene.part("base_q"))][3:], 0.5, 2.0)
    status, own = y[scene.layout["status"]], y[scene.part("step_control")[0] :]
    if status not in ENDS or not (own >= 0.0).all():
        raise ValueError(
            f"{scene.model.name}: state: its last {len(own)} numbers, pace, status {status:g} and time of a run, are "
            f"{own}; no run leaves these: make the state with initial_state"
        )
    return y


def _sizes(parts: dict[str, tuple[int, int]]) -> str:
    return ", ".join(f"{name} {end - first}" for name, (first, end) in parts.items() if end > first)


def _with_first_error(scene: CompiledScene, start: Start) -> np.ndarray:
    """The controllers' last error at the start, so that a derivative term sees no jump."""
    if (
        not scene.sampled or start.reference is None or start.y[scene.layout["end_time"]] > 0
    ):  # there is none, or it goes on
        return start.y
    n, o, y = scene.tree.n, scene.layout, start.y.copy()
    firmware = scene.constants.firmware
    goal = (
        start.reference.cubics[0, :, 0]
        if firmware.profile is None
        else y[o["profiled_reference"] : o["profiled_reference"] + n]
    )
    speed = controller_of(scene.constants.actuator).law == PID_SPEED
    error = np.where(speed, 0.0, goal) - np.where(speed, y[o["qd"] : o["qd"] + n], y[o["q"] : o["q"] + n])
    if firmware.band is not None:
        error -= np.clip(error, -firmware.band.compliance_margin, firmware.band.compliance_margin)
    y[o["last_error"] : o["last_error"] + n] = error
    return y


def each_once(function: Callable[[Any], Any], entries: Sequence[Any]) -> list[Any]:
    """What the function makes of each entry; of the same object it makes the same."""
    found: dict[int, Any] = {}
    for entry in entries:
        if id(entry) not in found:
            found[id(entry)] = function(entry)
    return [found[id(entry)] for entry in entries]
