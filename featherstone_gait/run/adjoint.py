"""A run with its derivatives: what it records, and the adjoint and tangents of that by all that it starts from.

The inputs are the state at the start, the cubics of reference and torques, and those numbers of the scene that differ
between given scenes, as in lanes (lane_constants.py).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ..core.compile.jit import CompilationError
from ..core.compile.lanes import aligned
from ..core.compile.taped import ADJOINT, COLUMNS, ENTRY, SPAN, Tape
from ..core.compile.varying import Varying, varying_fields
from ..core.integrate.adjoint import (
    Noted,
    pull_back,
    pull_back_controlled,
    push_forward,
    push_forward_controlled,
)
from ..core.integrate.rollout import rollout_one
from ..core.tree.residual import ROOM
from .compiled_run import CompiledRun, RunInput, Vector
from .lane_constants import has_varying, merge

FIXED_STEPS = ("implicit_euler", "midpoint", "rk4")
ENTRIES = 2**16  # of a tape at first: a step of a humanoid takes 20 000
MOST_ENTRIES = SPAN // ENTRY - 2
MOST_STATES = 5 * 2**20  # numbers of states that are kept at once (40 MB); longer runs are cut into segments


class Slot(NamedTuple):
    """Numbers that are inputs."""

    path: tuple[str, ...]  # of fields, from the run
    name: str | None  # of a field of records
    first: int  # their first entry
    shape: tuple[int, ...]


class Adjoint:
    """Derivatives of one run.

    compiled: the run; start: what it starts from; others: runs of scenes of the same structure, whose numbers that
    differ from the run's are inputs too.
    """

    def __init__(self, compiled: CompiledRun, start: RunInput, others: Sequence[CompiledRun] = ()) -> None:
        check(compiled)
        self.compiled, self.start = compiled, start
        constants = [compiled.scene.constants, *(other.scene.constants for other in others)]
        self.merged = merge(constants, 2) if others else constants[0]
        self.length, self.room = len(start.y), ENTRIES
        self._make()

    def _make(self) -> None:
        """Lay out the run on a tape that holds all inputs and `room` entries beside them."""
        one = Vector.of(self.compiled, [self.start], 1)
        knots = [each for each in (one.run.signals.reference, one.run.signals.torques) if each is not None]
        inputs = sum(each.cubics.size for each in knots) + _varying_numbers(self.merged)
        if inputs > MOST_ENTRIES // 2:
            raise ValueError(
                f"{self.compiled.scene.model.name}: {inputs} numbers of signals and of the scene are inputs of the "
                f"gradient; at most {MOST_ENTRIES // 2}: give signals fewer knots, four numbers each"
            )
        kept = one.run.signals.program
        inputs += self.length + (0 if kept is None else kept.memory.size + kept.command.size)
        self.tape = Tape(min(inputs + self.room, MOST_ENTRIES))
        self.slots: list[Slot] = []
        run = _with_memory(one.run)
        signals = one.run.signals
        for name in ("reference", "torques"):
            knots = getattr(signals, name)
            if knots is not None:
                cubics = self._inputs(("signals", name), None, knots.cubics, taped_zeros(knots.cubics.shape))
                run = run._replace(signals=run.signals._replace(**{name: knots._replace(cubics=cubics)}))
        if self.compiled.controller is not None:
            run = run._replace(signals=run.signals._replace(program=self._program(run.signals.program)))
        scene = self._of_constants(("scene",), self.merged, self.compiled.scene.constants)
        self.taped, self.first = run._replace(scene=scene), self.tape.first
        self.plain, self.y = one.run, taped_zeros(self.length)

    def _program(self, program: Any) -> Any:
        """Return a controller that is compiled into the kernels."""
        assert self.compiled.controller is not None
        return program._replace(function=self.compiled.controller.taped())

    def _inputs(self, path: tuple[str, ...], name: str | None, values: np.ndarray, memory: np.ndarray) -> np.ndarray:
        memory[..., 0] = values
        self.slots.append(Slot(path, name, self.tape.inputs(memory), np.shape(values)))
        return memory

    def _of_constants(self, path: tuple[str, ...], merged: Any, own: Any) -> Any:
        """Return constants whose `Varying` numbers are inputs."""
        if isinstance(merged, Varying):
            names = merged.values.dtype.names
            if names is None:
                return Varying(self._inputs(path, None, own, merged.values))
            for name in varying_fields(merged.values.dtype):
                memory = taped_zeros(own[name].shape)
                self._inputs(path, name, own[name], memory)
                merged.values[name] = memory
            return merged
        if isinstance(merged, tuple) and has_varying(merged):
            fields = zip(merged._fields, merged, own)  # type: ignore[attr-defined]
            return type(merged)(*(self._of_constants((*path, name), each, one) for name, each, one in fields))
        return own

    @functools.cached_property
    def segments(self) -> list[tuple[int, int]]:
        """First step and number of steps of the pieces whose states are kept at once, each whole ticks and records."""
        plan = self.plain.plan
        whole = int(np.lcm(plan.per_tick, plan.per_sample))
        kept = max(MOST_STATES // self.length // whole * whole, whole)
        return [(first, min(kept, plan.steps - first)) for first in range(0, max(plan.steps, 1), kept)]

    def run(self) -> np.ndarray:
        """Run forwards: return what is recorded (records, channels), and keep the states at which segments start."""
        plan, pieces = self.plain.plan, []
        y, self.starts = self.start.y.copy(), []
        self.kept_starts = [self._first_kept()]
        for n, (_, steps) in enumerate(self.segments):
            self.starts.append(y.copy())
            states = self._states(n, y)
            self.kept_starts.append(self.kept[-1].copy())
            last = n == len(self.segments) - 1
            pieces.append(states[:: plan.per_sample][: None if last else steps // plan.per_sample, self.plain.channels])
        self.final, self.states, self.kept_last = y, states, self.kept
        return np.concatenate(pieces)

    def _first_kept(self) -> np.ndarray:
        """Return the numbers that a controller keeps besides the state, as they are at the start."""
        if self.compiled.controller is None:
            return np.zeros(0)
        program = self.plain.signals.program
        memory = np.broadcast_to(self.compiled.controller.first_memory, program.memory.shape)
        return np.concatenate([memory, np.zeros(program.command.size)])

    def _states(self, n: int, y: np.ndarray) -> np.ndarray:
        """Advance y over a segment; return its states after the ticks at each step (steps + 1, length).

        What a controller keeps is left in `kept`: before the first tick, and after each.
        """
        (first, steps), states = self.segments[n], np.zeros((self.segments[n][1] + 1, self.length))
        run = self._segment(self.plain, first, steps)
        run = run._replace(channels=np.arange(self.length), plan=run.plan._replace(per_sample=1))
        kept = [self.kept_starts[n]]
        if self.compiled.controller is None:
            self.compiled.call(rollout_one, run, y, states)
        else:
            program, tick = run.signals.program, run.plan.per_tick
            program.memory[...] = kept[0][: len(program.memory)]
            program.command[...] = kept[0][len(program.memory) :].reshape(-1, 2)
            for at in range(0, steps, tick):
                count = min(tick, steps - at)
                plan = run.plan._replace(first=run.plan.first + at, steps=count)
                self._set_clock(program, first + at)
                self.compiled.call(rollout_one, run._replace(plan=plan), y, states[at : at + count + 1])
                kept.append(np.concatenate([program.memory, program.command.ravel()]))
        self.kept = np.array(kept)
        return states

    def _set_clock(self, program: Any, done: int) -> None:
        """Set the clock of a controller to a step of the run."""
        program.clock.reshape(3, -1)[:, 0] = done, self.plain.plan.first, self.plain.plan.offset

    @staticmethod
    def _segment(run: Any, first: int, steps: int) -> Any:
        return run._replace(plan=run.plan._replace(first=run.plan.first + first, steps=steps))

    def pull(self, seeds: np.ndarray, final: np.ndarray | None = None) -> np.ndarray:
        """Return the derivative of a result by the state at the start (length,), and keep those by other inputs.

        seeds (records, channels): derivatives of the result by what `run` has returned; final (length,): by the state
        at the end, if it depends on that.
        """
        while True:
            adjoint = np.zeros(self.length + len(self.kept_starts[0]))
            if final is not None:
                adjoint[: self.length] = final
            self.tape.numbers[: self.first, ADJOINT] = 0.0
            if all(self._pull(n, seeds, adjoint) for n in reversed(range(len(self.segments)))):
                self.adjoints = self.tape.numbers[: self.first, ADJOINT].copy()
                self.by_kept = adjoint[self.length :]
                return adjoint[: self.length]
            self._grow()

    def _pull(self, n: int, seeds: np.ndarray, adjoint: np.ndarray) -> bool:
        """Take the adjoint over a segment; return whether the tape was large enough."""
        (first, steps), every = self.segments[n], self.plain.plan.per_sample
        states = self._kept(n)
        own = np.array(seeds[first // every : (first + steps) // every + 1], dtype=float)
        if n < len(self.segments) - 1:
            own[-1] = 0.0  # which the next segment begins with
        kernel = pull_back if self.compiled.controller is None else pull_back_controlled
        return self._fits(self._call(kernel, *self._arguments(n, states), own, adjoint))

    def _call(self, kernel: Any, *arguments: Any) -> int:
        """Call a kernel; ValueError where a controller cannot be compiled into it."""
        try:
            return kernel(*arguments)
        except CompilationError as error:
            if self.compiled.controller is None:
                raise
            raise ValueError(
                f"controller {self.compiled.controller.name}: it has no gradients, for it does not compile for numbers "
                "that note how they came about: write it as arithmetic, comparisons and functions of math on numbers, "
                "without new arrays, operations on whole arrays, % and round; Numba's message is above"
            ) from error

    def push(self, tangents: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the tangents of what is recorded (records, channels, count) and of the final state (length, count).

        tangents (length, count): of the state at the start, and of a controller's memory after it, if that moves;
        directions (entries, count): of the other inputs, see `entries`.
        """
        kernel = push_forward if self.compiled.controller is None else push_forward_controlled
        count, every = tangents.shape[1], self.plain.plan.per_sample
        whole = max(-(-count // COLUMNS), 1) * COLUMNS
        while True:
            along, given = np.zeros((self.length + len(self.kept_starts[0]), whole)), np.zeros((self.first, whole))
            along[: len(tangents), :count], given[:, :count] = tangents, directions
            out = np.zeros((self.compiled.samples, len(self.compiled.channels), whole))
            room = np.empty((len(self.tape.numbers), COLUMNS))
            for n, (first, steps) in enumerate(self.segments):
                part = out[first // every : (first + steps) // every + 1]
                if not self._fits(self._call(kernel, *self._arguments(n, self._kept(n)), given, along, room, part)):
                    break
            else:
                return out[..., :count], along[: self.length, :count]
            self._grow()

    def _kept(self, n: int) -> np.ndarray:
        """Return the states of a segment, computed again but for the last."""
        if n == len(self.segments) - 1:
            self.kept = self.kept_last
            return self.states
        return self._states(n, self.starts[n].copy())

    def _arguments(self, n: int, states: np.ndarray) -> tuple[Any, ...]:
        tape, (first, steps) = self.tape, self.segments[n]
        start = np.zeros(self.length)
        bodies = len(self.plain.scene.tree)
        given, found, room = np.zeros(bodies + 6), np.zeros(bodies + 6), np.zeros((bodies, ROOM))
        noted = Noted(
            tape.numbers, tape.links, tape.words, self.first, self.starts[n], states, start, given, found, room,
            self.kept,
        )  # fmt: skip
        if self.compiled.controller is not None:
            self._set_clock(self.taped.signals.program, first)
        self.y[...] = 0.0
        return self._segment(self.taped, first, steps), self.y, self._segment(self.plain, first, steps), noted

    def _fits(self, used: int) -> bool:
        return used < len(self.tape.numbers) - 1

    def _grow(self) -> None:
        if len(self.tape.numbers) > MOST_ENTRIES:
            name = self.compiled.scene.model.name
            raise ValueError(f"{name}: a step takes more than {self.room} operations: split the scene")
        self.room *= 4
        self._make()

    @property
    def entries(self) -> int:
        """How many rows the directions of `push` have: two of no input, and one for each input but the state."""
        return self.first

    def values(self, slot: Slot, run: Any = None) -> np.ndarray:
        """Return the numbers of a slot in a run, by default in this one."""
        found = self.plain if run is None else run
        for name in slot.path:
            found = getattr(found, name)
        if slot.path[0] == "signals":
            found = found.cubics
        return np.asarray(found if slot.name is None else found[slot.name])

    def derivative(self, slot: Slot) -> np.ndarray:
        """Return the derivative of the last `pull` by the numbers of a slot, in their shape."""
        return self.adjoints[slot.first : slot.first + int(np.prod(slot.shape))].reshape(slot.shape)


def check(compiled: CompiledRun) -> None:
    """Raise ValueError for runs without derivatives."""
    scene = compiled.scene
    if scene.integrator not in FIXED_STEPS:
        raise ValueError(
            f"{scene.model.name}: gradients need fixed steps, by {', '.join(FIXED_STEPS)}; its integrator is "
            f"{scene.integrator}: compile_scene(..., integrator='midpoint')"
        )
    if compiled.controller is not None and scene.surface_drives:
        raise ValueError(
            f"{scene.model.name}: there are no gradients through a compiled controller that may command surfaces: "
            "leave one of both out"
        )


def _varying_numbers(merged: Any) -> int:
    """Return how many numbers of merged constants vary."""
    if isinstance(merged, Varying):
        names = merged.values.dtype.names
        arrays = [merged.values] if names is None else [merged.values[n] for n in varying_fields(merged.values.dtype)]
        return sum(array.size // 2 for array in arrays)
    return sum(map(_varying_numbers, merged)) if isinstance(merged, tuple) else 0


def taped_zeros(shape: int | tuple[int, ...]) -> np.ndarray:
    """Return memory of taped numbers, all constants 0."""
    return aligned((*((shape,) if isinstance(shape, int) else shape), 2))


def _with_memory(x: Any) -> Any:
    """Return what a kernel reads with memory of taped numbers in place of that of numbers, but for what is shared."""
    if isinstance(x, tuple):
        shared = getattr(x, "SHARED", ())
        fields = zip(x._fields, x)  # type: ignore[attr-defined]
        return type(x)(*(each if name in shared else _with_memory(each) for name, each in fields))
    if isinstance(x, np.ndarray) and x.dtype == float:
        memory = taped_zeros(x.shape)
        memory[..., 0] = x
        return memory
    return x
