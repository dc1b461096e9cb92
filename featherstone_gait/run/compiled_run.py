"""Arguments of the kernels: compiled runs, the inputs of one simulation, and vectors of such runs.

    compiled = prepare(scene, 2.0, record=("q",))
    y, out = compiled.run([compiled.start(state, reference)])[0]

`simulate` goes this way.  Benchmarks, which call the kernels themselves, use `compiled.arguments(...)` and
`compiled.kernel`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, vector
from ..core.compile.lanes import WIDTH, aligned
from ..core.compile.varying import Varying
from ..core.effects.decay import FILTER_DECAY, MEAN, MOTOR_DECAY
from ..core.integrate.adaptive import rollout_adaptive
from ..core.integrate.integrator import Sizes, renewal_of
from ..core.integrate.rollout import rollout_lanes, rollout_one
from ..core.step import pace, state
from ..core.step.context import Plan, Run, Scene
from ..core.step.program import DONE, FIRST, OFFSET
from ..core.step.signals import Knots, Signals
from ..dynamics.tendons import tendon_length_channel
from ..geometry.distance import clearance_channel, contact_bench
from ..model.numpy_dynamics import with_quaternions
from ..scene.compile import CompiledScene
from ..scene.forest import count, largest_tree
from ..scene.tree import check_followers
from .interrupt import Kernel, call_interruptibly, ensure_compiled
from .lane_constants import has_varying, merge, structure, with_own_memory, write_lane
from .overlap import tell_overlaps
from .program import CompiledController
from .reference import LATEST, Reference
from .start import checked_state, columns_of, driven_lengths, initial_state, what_is_loose_at, with_first_error
from .trajectory import Trajectory

Zeros = Callable[[int | tuple[int, ...]], np.ndarray]

INTERRUPTIBLE = 3e5  # steps by velocities: some 0.1 s of computing, from which on a run looks for Ctrl-C
PAUSE = 3e4  # evaluations by velocities: some 10 ms, after which a run with error control looks for it
INSTANT = 1e-9  # step that shows what a run begins with, at most twice as long [s]
MOST_KNOTS = 1e8  # of a signal that steps see at each knot
# Computed channels that take the robot too.
OF_MODEL = {"clearance": clearance_channel, "tendon_length": tendon_length_channel}


class RunInput(NamedTuple):
    """Inputs of one simulation."""

    y: np.ndarray  # (length,) state
    reference: Knots | None
    torques: Knots | None
    noise: np.ndarray | None  # (ticks, joints, 2)
    compiled: CompiledRun  # which it is an input of


class LaneNumbers(NamedTuple):
    """Numbers that runs which share lanes may have each for themselves: `Varying` if they do."""

    constants: Scene
    min_height: float | Varying  # see `Plan`


@dataclass(frozen=True, eq=False)
class CompiledRun:
    """A scene, the plan of its runs and what they record; made by `prepare`."""

    scene: CompiledScene
    plan: Plan
    record: tuple[str, ...]
    stored: dict[str, slice]  # where each channel lies among the recorded numbers
    channels: np.ndarray  # indices into the state of all recorded numbers
    stop: np.ndarray = field(default_factory=lambda: np.zeros(1, np.int64))  # (1,): not 0 ends all its runs
    of_lanes: LaneNumbers | None = None  # of all whose runs share its lanes; None where all numbers are its own
    controller: CompiledController | None = None

    @functools.cached_property
    def late(self) -> np.ndarray:
        """Which of `channels`, by index, only a step computes: forces, accelerations, pairs that touch."""
        o = self.scene.layout
        touching = [k for name in ("pair", "pair_feature") for k in range(*self.scene.part(name))]
        return np.flatnonzero(np.isin(self.channels, [*range(o["before_derived"], o["after_derived"]), *touching]))

    def begins(self, y: np.ndarray) -> bool:
        """Return whether a run from a state (length,) records what no step has computed yet."""
        return len(self.late) > 0 and y[self.scene.layout["end_time"]] == 0.0

    @property
    def numbers(self) -> LaneNumbers:
        """Numbers of the run's own scene."""
        return LaneNumbers(self.scene.constants, self.plan.min_height)

    def among(self, others: Sequence[CompiledRun]) -> CompiledRun:
        """Return the run with lanes that also take runs of others, whose scenes have its structure."""
        numbers = merge([other.numbers for other in others])
        return replace(self, of_lanes=numbers) if has_varying(numbers) else self

    def start(
        self,
        state: ArrayLike | Trajectory | None = None,
        reference: Reference | None = None,
        tau: Reference | ArrayLike | None = None,
        noise: ArrayLike | None = None,
    ) -> RunInput:
        """Check what one simulation starts from, as given to `simulate`; ValueError on what does not fit."""
        scene, n, o = self.scene, self.scene.tree.n, self.scene.layout
        y = initial_state(scene) if state is None else checked_state(scene, state)
        check_followers(scene.model, scene.tree.coupling, y[o["q"] : o["q"] + n], y[o["qd"] : o["qd"] + n])
        loose = what_is_loose_at(scene, y)
        if loose is not None:
            raise ValueError(f"{scene.model.name}: {loose}, or start in another posture: state=initial_state(scene, q)")
        tell_overlaps(scene, y)
        follows = scene.follows or self.torques_written
        if reference is not None and not follows:
            remedy = "compile the scene with gearbox=..., or give torques as tau="
            raise ValueError(f"{scene.model.name}: a reference needs servos; {remedy}")
        if reference is None and follows:
            reference = Reference([0.0], np.append(y[o["q"] : o["q"] + n], driven_lengths(scene, y))[None])
        if reference is not None and not isinstance(reference, Reference):
            raise ValueError(f"reference is a {type(reference).__name__}; give Reference(times, values)")
        if tau is not None and self.torques_written:
            raise ValueError(f"{scene.model.name}: its controller writes the torques; add tau there, or give pushes")
        if tau is not None and scene.adaptive and self.plan.integrated < o["after_integrated"]:
            raise ValueError(f"{scene.model.name}: torques from outside need prepare(..., driven=True)")
        if tau is not None and scene.method.drives:
            raise ValueError(
                f"{scene.integrator} takes its torques from the servos alone; use implicit_euler for scenes with tau"
            )
        if tau is not None and not isinstance(tau, Reference):
            tau = Reference([0.0], vector("tau", tau, columns_of(scene, tau), "[N m or N], or a Reference")[None])
        lengths = driven_lengths(scene, y)
        knots = self._knots("reference", reference, lengths)
        torques = self.held_torques(np.zeros) if self.torques_written else self._knots("tau", tau, 0.0 * lengths)
        return RunInput(with_first_error(scene, y, knots), knots, torques, self._noise(noise), self)

    def _knots(self, what: str, signal: Reference | None, of_tendons: np.ndarray) -> Knots | None:
        """Return a signal as the kernels read it; ValueError for one that does not fit.

        of_tendons: what the drives of tendons are given where the signal is one for the joints alone.  A cyclic signal
        that steps see at each knot might have so many that the run takes days.
        """
        if signal is None:
            return None
        scene, n = self.scene, self.scene.tree.n
        if signal.values.shape[1] == n < scene.inputs:
            values = np.hstack([signal.values, np.broadcast_to(of_tendons, (len(signal.values), len(of_tendons)))])
            signal = replace(signal, values=values)
        if signal.values.shape[1] != scene.inputs:
            drives = [one.name for one in scene.driven_tendons]
            tendons = f", and {len(drives)} driven tendons: {', '.join(drives)}" if drives else ""
            raise ValueError(
                f"{scene.model.name}: {what} has {signal.values.shape[1]} columns; the robot has {n} joints: "
                f"{', '.join(scene.model.joint_names)}{tendons}"
            )
        period, duration = float(signal.times[-1] - signal.times[0]), self.plan.steps * self.plan.h
        seen = scene.adaptive or what == "tau" or not scene.sampled
        if signal.cyclic and seen and duration / period * len(signal.times) > MOST_KNOTS:
            raise ValueError(
                f"{what}: a period of {period:g} s with {len(signal.times)} knots is passed {duration / period:.3g} "
                f"times in {duration:g} s, and steps see each knot; at most {MOST_KNOTS:g}: give a longer period"
            )
        return signal.knots()

    @property
    def torques_written(self) -> bool:
        """Return whether a controller writes the torques on the joints."""
        return self.controller is not None and self.controller.writes == "torque"

    def held_torques(self, zeros: Zeros) -> Knots:
        """Return the signal of torques that stand until they are written again; zeros(shape) makes its array."""
        return Knots(np.array([-LATEST, LATEST]), zeros((1, self.scene.inputs, 4)), 0.0)

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

    def schedule(self, y: np.ndarray) -> Plan:
        """Return the plan of a run from a state (length,), at the time that the state has reached: 0 of a new one.

        Raises ValueError for a time that is none.
        """
        h, begun = self.plan.h, float(y[self.scene.layout["end_time"]])
        if not 0.0 <= begun < 2.0**52 * h:
            raise ValueError(f"state: its time is {begun!r} s; expected 0 to less than 2^52 steps: see `reset_time`")
        first = round(begun / h)
        if abs(first * h - begun) > 1e-6 * h:
            return self.plan._replace(offset=begun)
        return self.plan._replace(first=first)

    @property
    def samples(self) -> int:
        """Number of records of a run."""
        return self.plan.steps // self.plan.per_sample + 1

    @property
    def kernel(self) -> Kernel:
        """The kernel that takes `arguments`."""
        return rollout_adaptive if self.scene.adaptive else rollout_one

    def arguments(self, start: RunInput, out: np.ndarray | None = None) -> tuple[Run, np.ndarray, np.ndarray]:
        """Return what the kernel takes for one run: the run, its state, which it advances, and its records."""
        one = Vector.of(self, [start], 1, out)
        return one.run, one.y, one.out

    def arguments_in_lanes(self, starts: Sequence[RunInput]) -> tuple[Run, np.ndarray, np.ndarray]:
        """Return what `rollout_lanes` takes for up to eight runs: see `Vector.of`."""
        several = Vector.of(self, starts)
        return several.run, several.y, several.out

    def run(self, starts: Sequence[RunInput]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Simulate up to eight runs, more than one in step; return the final state and the records of each.

        Raises ValueError unless they can go in step: fixed steps, signals of the same knot times, states of the same
        time, noise for all or none.
        """
        if len(starts) == 1:
            vector = Vector.of(starts[0].compiled, starts, 1)
        else:
            self._check_alike(starts)
            vector = Vector.of(self, starts)
        first = vector.at_start() if self.begins(starts[0].y) else None
        vector.step()
        if first is not None:
            vector.out[0, self.late] = first[self.channels[self.late]]
        return [vector.take(lane) for lane in range(len(starts))]

    def call(self, kernel: Kernel, run: Run, y: np.ndarray, out: np.ndarray) -> None:
        """Call the kernel; KeyboardInterrupt where `stop` has ended the run, as Ctrl-C in the main thread does."""
        if self.scene.adaptive:
            # up to where it pays to hand the run to the thread that Ctrl-C ends
            done = float(y[self.scene.part("step_control")[0] + pace.EVALUATIONS])
            pausing = run.plan._replace(pause=done + PAUSE / max(self.scene.model.nv, 1))
            if not kernel(run._replace(plan=pausing), y, out):
                call_interruptibly(kernel, run, y, out)
        elif run.plan.steps * self.scene.model.nv > INTERRUPTIBLE:
            ensure_compiled(kernel, run, y, out)
            call_interruptibly(kernel, run, y, out)
        else:
            kernel(run, y, out)
        if self.stop[0]:
            raise KeyboardInterrupt
        if self.controller is not None:
            self.controller.check(run.signals.program, self.scene.model.joint_names)

    def _check_alike(self, starts: Sequence[RunInput]) -> None:
        name = self.scene.model.name
        if not 1 <= len(starts) <= WIDTH or self.scene.adaptive:
            raise ValueError(f"{name}: {len(starts)} runs at once; 1 to {WIDTH} go in step, with error control one")
        if len({start.noise is None for start in starts}) > 1:
            raise ValueError(f"{name}: some runs have noise and some have none; give all of them an array, or none")
        for what, key in (
            ("signals of other knot times", lambda start: (_times_of(start.reference), _times_of(start.torques))),
            ("scenes that differ in more than numbers", lambda start: structure(start.compiled.scene.constants)),
            ("states of other times", lambda start: float(start.y[self.scene.layout["end_time"]])),
        ):
            if len(set(map(key, starts))) > 1:
                raise ValueError(f"{name}: {what} do not go in step; run them one by one")

    def signals(self, reference: Knots | None, torques: Knots | None, zeros: Zeros) -> Signals:
        """Return what comes from outside; zeros(shape) makes the arrays for its present values."""
        n = self.scene.inputs
        values, tau = (None, None) if torques is None else (zeros((n, 2)), zeros(n))
        continuous = True if self.scene.follows and not self.scene.sampled else None
        return Signals(reference, zeros((n, 2)), torques, values, tau, None, None, continuous)

    def bind(self, signals: Signals, zeros: Zeros) -> Run:
        """Return the run with these signals; zeros(shape) makes the arrays that it overwrites."""
        scene, constants, plan = self.scene, self.scene.constants, self.plan
        sizes = Sizes(
            n=scene.tree.n,
            inputs=scene.inputs,
            bodies=len(constants.tree),
            bases=scene.tree.bases,
            balls=0 if scene.tree.balls is None else len(scene.tree.balls),
            points=0 if constants.contact is None else len(constants.contact.points),
            rolling=int(np.ptp(scene.part("rolling_deflection"))) // 2,
            workspace=scene.tree.workspace_shape(),
            offsets=scene.layout,
            motors=scene.tree.n if scene.sampled else 0,
            driven=signals.tau is not None,
            stiff=scene.stiff,
            pairs=constants.pairs,
            bench=None if constants.pairs is None else contact_bench(constants.pairs.shapes),
            trees=0 if constants.trees is None else len(constants.trees),
            largest=largest_tree(constants),
            loops=constants.loops,
            couplings=count(constants.coupling),
            tendons=scene.tree.tendons,
            immersed=0 if constants.fluid is None else len(constants.fluid.table),
        )
        work, good = scene.method.workspace(sizes, zeros), zeros(scene.layout["length"])
        frames = zeros(sizes.workspace) if sizes.bases and sizes.points else None
        if self.controller is not None:
            signals = signals._replace(program=self.controller.bound(scene, zeros))
        if self.of_lanes is not None:
            constants, min_height = with_own_memory(self.of_lanes)
            plan = plan._replace(min_height=min_height)
        renewal = renewal_of(sizes, zeros)
        return Run(constants, scene.places, plan, signals, work, good, self.channels, frames, self.stop, renewal)

    def named(self, out: np.ndarray, schedule: Plan | None = None) -> dict[str, np.ndarray]:
        """Return recorded numbers (samples, all) as channels in their natural shape."""
        found = {"time": _times(self.plan if schedule is None else schedule, len(out))}
        for name in self.record:
            channel = state.BY_NAME[name]
            if channel.kind != "computed":
                found[name] = self._stored(name, out)
            else:
                needed = [self._stored(need, out) for need in channel.needs]
                compute = channel.compute or functools.partial(OF_MODEL[name], self.scene.model)
                found[name] = compute(*needed)
        return found

    def _stored(self, name: str, out: np.ndarray) -> np.ndarray:
        """Return a channel of the state in its natural shape; positions with the quaternions of ball joints."""
        values = state.shaped(state.BY_NAME[name], out[:, self.stored[name]])
        if name == "q" and self.scene.tree.balls is not None:
            return with_quaternions(self.scene.model, values, out[:, self.stored["ball_q"]])
        return values


class Vector:
    """Runs of one structure that one call of a kernel advances: eight in lanes, or one by itself.

    run: what the kernel reads; y (length,) and out (records, numbers) what it writes, with a last axis of eight lanes.
    """

    def __init__(
        self,
        compiled: CompiledRun,
        signals: Signals,
        lanes: int = WIDTH,
        y: np.ndarray | None = None,
        out: np.ndarray | None = None,
    ) -> None:
        zeros = zeros_for(lanes)
        self.compiled, self.lanes = compiled, lanes
        self.kernel: Kernel = rollout_lanes if lanes > 1 else compiled.kernel
        self.run = compiled.bind(signals, zeros)
        self.y = zeros(len(self.run.good)) if y is None else y
        self.out = zeros((compiled.samples, max(len(compiled.channels), 1))) if out is None else out

    @classmethod
    def of(
        cls, compiled: CompiledRun, starts: Sequence[RunInput], lanes: int = WIDTH, out: np.ndarray | None = None
    ) -> Vector:
        """Put runs of the same time, whose signals have the same knot times, into a vector; the last fills it up."""
        starts = [*starts, *[starts[-1]] * (lanes - len(starts))]
        if compiled.of_lanes is None and any(start.compiled is not compiled for start in starts):
            compiled = compiled.among([start.compiled for start in starts])
        references, torques = (knots_in_lanes(knots) for knots in zip(*(start[1:3] for start in starts)))
        signals = compiled.signals(references, torques, zeros_for(lanes))
        if starts[0].noise is not None:  # all have noise, or none
            signals = signals._replace(noise=in_lanes([start.noise for start in starts if start.noise is not None]))
        vector, schedule = cls(compiled, signals, lanes, None, out), starts[0].compiled.schedule(starts[0].y)
        for lane, start in enumerate(starts):
            vector.put(lane, start)
        vector.set_clock(schedule)
        vector.run = vector.run._replace(plan=schedule._replace(min_height=vector.run.plan.min_height))
        return vector

    def lane(self, numbers: np.ndarray, lane: int) -> np.ndarray:
        """Return a view of the numbers of a lane, of all where there are no lanes."""
        return numbers[..., lane] if self.lanes > 1 else numbers

    def put(self, lane: int, start: RunInput) -> None:
        """Put a run into a lane, with the constants of its scene."""
        if self.compiled.of_lanes is not None:
            own = LaneNumbers(self.run.scene, self.run.plan.min_height)
            write_lane(own, lane, start.compiled.numbers)
        self.begin(lane, start)

    def begin(self, lane: int, start: RunInput) -> None:
        """Put a lane at the state of a run whose scene it has, and its controller at the beginning."""
        self.lane(self.y, lane)[...] = self.lane(self.run.good, lane)[...] = start.y
        program = self.run.signals.program
        if program is not None and start.compiled.controller is not None:
            self.lane(program.command, lane)[...] = 0.0
            self.lane(program.memory, lane)[...] = start.compiled.controller.first_memory

    def repeat(self, lane: int, other: int, start: RunInput) -> None:
        """Copy another lane, in which the run of `start` is, into an idle lane."""
        self.put(lane, start)
        self.y[:, lane], self.run.good[:, lane] = self.y[:, other], self.run.good[:, other]
        if self.run.signals.program is not None:
            memory = self.run.signals.program.memory
            memory[..., lane] = memory[..., other]

    def set_clock(self, schedule: Plan, done: float = 0.0, lane: Any = Ellipsis) -> None:
        """Set the clock of a run's controller, or of a lane's: steps since its start, and the schedule of its run."""
        program = self.run.signals.program
        if program is not None:
            for k, value in ((DONE, done), (FIRST, schedule.first), (OFFSET, schedule.offset)):
                program.clock[k, lane] = value

    def step(self, out: np.ndarray | None = None, **changes: Any) -> None:
        """Run the kernel as `CompiledRun.call` does; changes: of fields of the run."""
        run = self.run._replace(**changes) if changes else self.run
        self.compiled.call(self.kernel, run, self.y, self.out if out is None else out)

    def at_start(self, **changes: Any) -> np.ndarray:
        """Return the states (length, lanes) an instant after the start, of runs at time 0; the vector stays as it is.

        They have the forces and accelerations with which runs begin.  changes: of fields of the run.
        """
        run = self.run._replace(**changes)
        halvings = max(0, int(np.log2(run.plan.h / INSTANT)))
        h, per_tick = run.plan.h / 2.0**halvings, run.plan.per_tick * 2**halvings  # a tick is as long as ever
        least = min(run.plan.least_step, 1e-3 * h)
        plan = run.plan._replace(h=h, steps=1, per_tick=per_tick, per_sample=1, first=0, offset=0.0, least_step=least)
        run = run._replace(plan=plan, scene=run.scene._replace(decay=_shorter(run.scene.decay, halvings)))
        zeros, program = zeros_for(self.lanes), run.signals.program
        y, out = zeros(len(self.y)), zeros((2, max(len(self.compiled.channels), 1)))
        y[...] = self.y
        kept = [] if program is None else [(x, x.copy()) for x in (program.command, program.memory, program.clock)]
        try:
            self.kernel(run, y, out)
        finally:
            for x, before in kept:
                x[...] = before
        return y

    def take(self, lane: int) -> tuple[np.ndarray, np.ndarray]:
        """Return copies of the state (length,) and the records (records, numbers) of a lane."""
        out = self.out[:, : len(self.compiled.channels)]
        return self.lane(self.y, lane).copy(), self.lane(out, lane).copy()


def _shorter(decay: Any, halvings: int) -> Any:
    """Return what is left of currents and speeds after a step that is halved so many times."""
    if isinstance(decay, Varying):
        return Varying(_shorter(decay.values, halvings))
    if decay is None:
        return None
    found = aligned(decay.shape)
    found[...] = decay
    for column in (MOTOR_DECAY, FILTER_DECAY):
        for _ in range(halvings):
            found[:, column] = np.sqrt(found[:, column])
    found[:, MEAN] = np.where(found[:, MEAN] > 0.0, 1.0, 0.0)
    return found


def zeros_for(lanes: int) -> Zeros:
    """Return what makes arrays of zeros, with a last axis of lanes if there are several."""
    return lane_zeros if lanes > 1 else np.zeros


def lane_zeros(shape: int | tuple[int, ...]) -> np.ndarray:
    """Return zeros with a last axis of lanes."""
    return aligned((*np.atleast_1d(shape), WIDTH))


def in_lanes(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Stack an array for each lane, along a last axis; one array stays as it is."""
    if len(arrays) == 1:
        return arrays[0]
    stacked = lane_zeros(arrays[0].shape)
    stacked[:] = np.stack(arrays, axis=-1)
    return stacked


def knots_in_lanes(knots: Sequence[Knots | None]) -> Knots | None:
    """Stack signals of the same knot times, one for each lane; None if there are none."""
    if knots[0] is None:
        return None
    return knots[0]._replace(cubics=in_lanes([k.cubics for k in knots if k is not None]))


def _times_of(knots: Knots | None) -> tuple[bytes, float] | None:
    return None if knots is None else (knots.times.tobytes(), knots.period)


def _times(schedule: Plan, count: int) -> np.ndarray:
    """Return the times of records [s]: bits do not depend on the pieces that a run is cut into between records."""
    samples, steps = divmod(schedule.first, schedule.per_sample)
    return schedule.offset + steps * schedule.h + (samples + np.arange(count)) * (schedule.per_sample * schedule.h)
