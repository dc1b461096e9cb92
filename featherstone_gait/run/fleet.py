"""Robots of one scene, or of its worlds, that a session steps from one controller tick to the next.

Robots of one structure share vectors of eight.  With error control, and where at most two are left over, each robot
has a vector of its own.  Inputs stand in the arrays that the kernels read, so that a tick is one call of compiled code
for each vector.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np

from ..core.compile.jit import direct
from ..core.compile.lanes import WIDTH
from ..core.integrate.rollout import OK
from ..core.step import pace
from ..core.step.context import Run
from ..core.step.program import DONE, FIRST, OFFSET, Program
from ..core.step.signals import Knots, Signals
from .batch import families
from .compiled_run import CompiledRun, RunInput, Vector, zeros_for
from .prepare import budget
from .reference import LATEST

ALONE = 2  # robots left over that are not worth a vector


class Group:
    """Robots of one structure, in vectors whose arrays Python reads and writes all at once.

    Places are vectors times lanes, robots in a row; lanes left over repeat the first robot of their vector.
    """

    def __init__(
        self, compiled: CompiledRun, runs: Sequence[CompiledRun], robots: np.ndarray, lanes: int, noisy: bool
    ) -> None:
        scene, n = compiled.scene, compiled.scene.tree.n
        self.compiled, self.runs, self.robots, self.lanes = compiled, runs, robots, lanes
        self.length, o = scene.layout["length"], scene.layout
        count, zeros = -(-len(robots) // lanes), zeros_for(lanes)
        self.shape = (count, lanes)
        places = np.arange(count * lanes)
        self.of = robots[np.where(places < len(robots), places, places - places % lanes)]  # robot of each place
        self.in_order = np.array_equal(self.of, np.arange(len(self.of)))  # all robots in a row, none left over
        numbers = max(len(compiled.channels), 1)
        self._y, self._out = zeros((count, self.length)), zeros((count, compiled.samples, numbers))
        self.y, self.out = self._with_lanes(self._y), self._with_lanes(self._out)
        self._noise = zeros((count, 1, n, 2)) if noisy else None
        self.noise = None if self._noise is None else _by_lane(self._with_lanes(self._noise)[:, 0])
        self._samples = scene.sampled and lanes > 1  # what a command is to the kernels, else knots
        self._input = zeros((count, 1, scene.commanded, 2 if self._samples else 4))
        self.command = _by_lane(self._with_lanes(self._input)[:, 0, :, 0])  # a view (vectors, lanes, commands)
        self.timed = scene.adaptive or scene.constants.push is not None
        self.begun, self.steps, self.offset = (np.zeros(self.shape) for _ in range(3))  # see `Plan`, of first and steps
        self.status, self.end = self.y[:, o["status"]], self.y[:, o["end_time"]]  # views
        self._pace = self.y[:, scene.part("step_control")[0] :]
        self.vectors = [self._vector(k) for k in range(count)]

    def _with_lanes(self, numbers: np.ndarray) -> np.ndarray:
        """Return a view with a last axis of lanes, of one where there are none."""
        return numbers if self.lanes > 1 else numbers[..., None]

    def _vector(self, k: int) -> Vector:
        compiled = self.compiled if self.lanes > 1 else self.runs[self.of[k]]
        held, zeros = Knots(np.array([-LATEST, LATEST]), self._input[k], 0.0), zeros_for(self.lanes)
        if self._samples:
            drive = zeros((compiled.scene.inputs, 2))
            signals = Signals(None, drive, None, None, None, self._input[k], None, None)
        else:
            if compiled.torques_written:
                signals = compiled.signals(held, compiled.held_torques(zeros), zeros)
            else:
                follows = compiled.scene.follows
                signals = compiled.signals(held if follows else None, None if follows else held, zeros)
        if self._noise is not None:
            signals = signals._replace(noise=self._noise[k])
        vector = Vector(compiled, signals, self.lanes, self._y[k], self._out[k])
        for lane in range(self.lanes):
            own = self.runs[self.of[k * self.lanes + lane]]
            vector.put(lane, RunInput(vector.lane(vector.y, lane), None, None, None, own))
        vector.kernel = direct(vector.kernel, vector.run, vector.y, vector.out)
        return vector

    def begin(self, robots: np.ndarray, states: np.ndarray) -> None:
        """Put robots (n,) bool at states (n, length)."""
        for place in np.flatnonzero(robots[self.of]).tolist():
            (k, lane), robot = divmod(place, self.lanes), self.of[place]
            schedule = self.compiled.schedule(states[robot])
            self.vectors[k].begin(lane, RunInput(states[robot], None, None, None, self.runs[robot]))
            self.begun[k, lane] = self.steps[k, lane] = schedule.first
            self.offset[k, lane] = schedule.offset

    def at_start(self, robots: np.ndarray, into: np.ndarray) -> None:
        """Fill rows (n, length) of robots (n,) bool with their states an instant after their start."""
        for k, vector in enumerate(self.vectors):
            of = self.of[k * self.lanes : (k + 1) * self.lanes]
            if robots[of].any():
                found = vector.at_start().reshape(self.length, self.lanes)
                into[of] = np.where(robots[of, None], found.T, into[of])

    def write_state(self, robots: np.ndarray, states: np.ndarray, part: slice) -> None:
        """Overwrite a part of the states of robots (n,) bool by that of other states (n, length)."""
        places = np.flatnonzero(robots[self.of])
        k, lane = np.divmod(places, self.lanes)
        self.y[k, part, lane] = states[self.of[places], part]

    def changing(self) -> list[np.ndarray]:
        """Return all arrays that a tick changes and a later one reads."""
        programs = [vector.run.signals.program for vector in self.vectors]
        return [self._y, self.steps, *(x for one in programs if one is not None for x in (one.command, one.memory))]

    def write(self, into: np.ndarray, values: np.ndarray) -> None:
        """Write values (n, ...) of all robots into places (vectors, lanes, ...)."""
        np.copyto(into, (values[: len(self.of)] if self.in_order else values[self.of]).reshape(into.shape))

    def read(self, parts: np.ndarray, into: np.ndarray) -> None:
        """Copy from places (vectors, ..., lanes) into values (n, ...) of all robots."""
        source = _by_lane(parts)
        if self.in_order:
            np.copyto(into[: len(self.of)].reshape(source.shape), source)
        else:
            into[self.robots] = source.reshape(-1, *into.shape[1:])[: len(self.robots)]

    def reader(self, part: slice | np.ndarray, into: np.ndarray) -> Callable[[], None]:
        """Return a function that copies a part of the states into values (n, ...) of all robots."""
        if isinstance(part, slice) and self.in_order:  # views, made once
            source = _by_lane(self.y[:, part])
            return partial(np.copyto, into[: len(self.of)].reshape(source.shape), source)
        return lambda: self.read(self.y[:, part], into)

    def tick(self, k: int) -> None:
        """Advance the robots of a vector to the next tick."""
        program = self.vectors[k].run.signals.program
        if program is not None:
            lanes = slice(None) if self.lanes > 1 else 0
            program.clock[DONE] = (self.steps - self.begun)[k, lanes]
            program.clock[FIRST], program.clock[OFFSET] = self.begun[k, lanes], self.offset[k, lanes]
        if self.timed:
            self._tick_at_times(k)
        else:
            vector = self.vectors[k]
            vector.kernel(vector.run, vector.y, vector.out)
        if program is not None:
            joints = self.compiled.scene.model.joint_names
            robots = self.of[k * self.lanes :] if len(self.runs) > 1 else ()
            self.runs[0].controller.check(program, joints, robots)  # type: ignore[union-attr]

    def _at(self, k: int, lane: int) -> Run:
        """Return the run of a vector at the time of a lane."""
        steps, run = int(self.steps[k, lane]), self.vectors[k].run
        plan = run.plan._replace(first=steps, offset=float(self.offset[k, lane]))
        if self.compiled.scene.adaptive:  # of all that the session has gone on, as of one run
            taken = self._pace[k, [pace.STEPS, pace.REJECTED], 0].sum()
            plan = plan._replace(budget=max(budget((steps + plan.steps) * plan.h) - float(taken), 1.0))
        return run._replace(plan=plan)

    def _tick_at_times(self, k: int) -> None:
        """Advance lanes of different times one after the other, where something depends on the time."""
        vector = self.vectors[k]
        times = [*zip(self.steps[k].tolist(), self.offset[k].tolist())]
        first = {found: lane for lane, found in reversed([*enumerate(times)])}
        if len(first) == 1:
            vector.kernel(self._at(k, 0), vector.y, vector.out)
            return
        before, after, out = vector.y.copy(), vector.y.copy(), vector.out.copy()
        for found, lane in first.items():
            vector.y[...] = before
            vector.kernel(self._at(k, lane), vector.y, vector.out)
            mine = [other == found for other in times]
            after[:, mine], out[..., mine] = vector.y[:, mine], vector.out[..., mine]
        vector.y[...], vector.out[...] = after, out

    def count_tick(self, alive: np.ndarray) -> None:
        """Count the tick of those robots (vectors, lanes) that were in motion before."""
        plan = self.compiled.plan
        np.add(self.steps, float(plan.steps), out=self.steps, where=alive)
        if not self.timed:
            np.copyto(self.end, self.steps * plan.h + self.offset, where=alive)


class Fleet:
    """All robots of a session, whatever their structure."""

    def __init__(self, runs: Sequence[CompiledRun], noisy: bool = False, threads: int | None = None) -> None:
        self.runs, self.groups = list(runs), []
        for compiled, members in families(self.runs):
            rest = len(members) % WIDTH
            rest = len(members) if compiled.scene.adaptive else rest if rest <= ALONE else 0
            robots, together = np.array(members), len(members) - rest
            for part, lanes in ((robots[:together], WIDTH), (robots[together:], 1)):
                if len(part):
                    self.groups.append(Group(compiled, self.runs, part, lanes, noisy))
        self._work = [(group, k) for group in self.groups for k in range(len(group.vectors))]
        self._threads = min(len(self._work), threads or os.cpu_count() or 1)
        self.seen: tuple[np.ndarray, np.ndarray] | None = None  # robots at their start, and all states as they see them
        self._pool: ThreadPoolExecutor | None = None
        self._pid = os.getpid()

    def tick(self) -> None:
        """Advance all robots to the next tick; only then raise Ctrl-C, or what a controller has raised."""
        alive = [group.status == OK for group in self.groups]
        failures: list[BaseException] = []
        try:
            if len(self._work) == 1:
                group, k = self._work[0]
                group.tick(k)
            else:
                self._tick_all(failures)
        finally:
            for group, those in zip(self.groups, alive):
                group.count_tick(those)
            if failures:  # rather than an interrupt, for what has failed has to be undone
                raise failures[0]

    def _tick_all(self, failures: list[BaseException]) -> None:
        if self._pool is None or self._pid != os.getpid():  # threads do not survive a fork
            self._pool, self._pid = ThreadPoolExecutor(max(self._threads - 1, 1)), os.getpid()
        todo = iter(self._work)
        futures = [self._pool.submit(_work_off, todo, failures) for _ in range(self._threads - 1)]
        try:
            _work_off(todo, failures)
        finally:
            _work_off(todo, failures)  # what an interrupt has left
            for future in futures:
                if not future.cancel():
                    future.result()

    def at_start(self, robots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the robots at time 0 of those given (n,) bool, and all states (n, length), theirs an instant later."""
        states = self.states()
        robots = robots & (self.of_each("end") == 0.0)
        for group in self.groups:
            group.at_start(robots, states)
        return np.flatnonzero(robots), states

    def states(self) -> np.ndarray:
        """Return copies of the states (n, length)."""
        return self.of_each("y", (self.groups[0].length,))

    def of_each(self, name: str, shape: tuple[int, ...] = ()) -> np.ndarray:
        """Return numbers of a name that groups have in their places, of all robots (n, *shape)."""
        found = np.empty((len(self.runs), *shape))
        for group in self.groups:
            group.read(getattr(group, name), found)
        return found

    def controllers(self) -> np.ndarray:
        """Return what the controller of each robot keeps (n, numbers): what it has written, and its memory."""
        own = [(robot, np.r_[command.ravel(), memory.ravel()]) for robot, command, memory in self._programs()]
        found = np.zeros((len(self.runs), len(own[0][1]) if own else 0))
        for robot, numbers in own:
            found[robot] = numbers
        return found

    def write_controllers(self, numbers: np.ndarray) -> None:
        """Restore what `controllers` returned."""
        for robot, command, memory in self._programs():
            command[...] = numbers[robot, : command.size].reshape(command.shape)
            memory[...] = numbers[robot, command.size :]

    def _programs(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield the robot, the command and the memory of each controller."""
        for group in self.groups:
            for place, robot in enumerate(group.of.tolist()):
                vector, lane = group.vectors[place // group.lanes], place % group.lanes
                program: Program | None = vector.run.signals.program
                if program is not None:
                    yield robot, vector.lane(program.command, lane), vector.lane(program.memory, lane)

    def close(self) -> None:
        """End its threads."""
        if self._pool is not None and self._pid == os.getpid():
            self._pool.shutdown()
        self._pool = None


def _by_lane(numbers: np.ndarray) -> np.ndarray:
    """Return a view (vectors, lanes, ...) of numbers (vectors, ..., lanes), sooner than `numpy.moveaxis` does."""
    return numbers.transpose(0, numbers.ndim - 1, *range(1, numbers.ndim - 1))


_LOCK = threading.Lock()


def _work_off(todo: Iterator[Any], failures: list[BaseException]) -> None:
    """Advance vectors until none is left; the iterator hands each out once."""
    while True:
        with _LOCK:
            found = next(todo, None)
        if found is None:
            return
        group, k = found
        try:
            group.tick(k)
        except Exception as failure:
            failures.append(failure)
