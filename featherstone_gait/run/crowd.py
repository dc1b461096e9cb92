"""Robots of one scene, or of its worlds, that go on from one controller tick to the next: what a session steps.

Those of one structure share vectors of eight; with error control, and where at most two are left over, each goes alone.
Inputs stand in the arrays that the kernels read, so that a tick is one call of compiled code a vector.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal, NamedTuple

import numpy as np

from ..core.compile.jit import direct
from ..core.compile.lanes import WIDTH, aligned
from ..core.integrate.rollout import OK, rollout_lanes
from ..core.step import pace
from ..core.step.context import Run
from ..core.step.program import DONE, FIRST, OFFSET, Program
from ..core.step.signals import Knots, Signals
from .batch import family
from .prepared import BUDGET, BUDGET_RATE, Prepared, Start, lane_zeros
from .reference import LATEST

Input = Literal["samples", "reference", "torques"]  # what a command is to the kernels
ALONE = 2  # robots left over that are not worth a vector


class _Unit(NamedTuple):
    """A vector, or a robot for itself."""

    number: int  # in its lot
    run: Run
    y: np.ndarray  # (length,) or (length, WIDTH)
    out: np.ndarray  # (records, numbers) likewise
    call: Callable[[Run, np.ndarray, np.ndarray], None]


class Lot:
    """Robots of one structure: of their units all that Python writes and reads in one piece.

    places: units times lanes, robots in a row; lanes left over repeat the first of their unit.
    """

    def __init__(
        self, ready: Prepared, worlds: Sequence[Prepared], robots: np.ndarray, width: int, noisy: bool
    ) -> None:
        scene, n = ready.scene, ready.scene.tree.n
        self.ready, self.robots, self.width, self.length = ready, robots, width, int(scene.layout["length"])
        units, o = -(-len(robots) // width), scene.layout
        zeros = aligned if width > 1 else np.zeros
        lanes = (width,) if width > 1 else ()
        self.worlds = worlds
        self.shape = (units, width)
        places = np.arange(units * width)
        self.of = robots[np.where(places < len(robots), places, places - places % width)]  # robot of each place
        self.whole = np.array_equal(self.of, np.arange(len(self.of)))  # robots in a row, none left over
        self._y = zeros((units, self.length, *lanes))
        self._out = zeros((units, ready.samples, max(len(ready.channels), 1), *lanes))
        self._noise = zeros((units, 1, n, 2, *lanes)) if noisy else None
        self.y = self._y.reshape(units, self.length, width)
        self.out = self._out.reshape(units, ready.samples, -1, width)
        self.noise = None if self._noise is None else self._noise.reshape(units, n, 2, width)
        self.kind: Input = "torques" if scene.constants.actuator is None else "reference"
        if scene.sampled and width > 1:
            self.kind = "samples"
        self._input = zeros((units, 1, n, 2 if self.kind == "samples" else 4, *lanes))
        self.command = self._input[:, 0, :, 0].reshape(units, n, width)  # a view
        self.timed = scene.adaptive or scene.constants.push is not None
        self.begun = np.zeros(self.shape)  # steps before the start
        self.steps = np.zeros(self.shape)  # since time was zero, whole numbers
        self.offset = np.zeros(self.shape)  # of the time from these [s]
        self.status, self.end = self.y[:, int(o["status"])], self.y[:, int(o["end_time"])]  # views
        self._time, self._tick, self._shifted = np.zeros(self.shape), float(ready.plan.steps), False
        self.write_command = self.writer(self.command)
        self.write_noise = None if self.noise is None else self.writer(self.noise)
        self._pace = self.y[:, scene.part("step_control")[0] :]
        self.units = [self._unit(k) for k in range(units)]

    def _unit(self, k: int) -> _Unit:
        ready, width = self.ready, self.width
        held = Knots(np.array([-LATEST, LATEST]), self._input[k], 0.0)
        zeros = lane_zeros if width > 1 else np.zeros
        if self.kind == "samples":
            drive = lane_zeros((ready.scene.tree.n, 2))
            signals = Signals(None, drive, None, None, None, self._input[k], None, None)
        else:
            one, other = (None, held) if self.kind == "torques" else (held, None)
            signals = ready.signals(one, other, zeros)
        if self._noise is not None:
            signals = signals._replace(noise=self._noise[k])
        if width == 1:
            run = self.worlds[self.of[k]].bound(signals, np.zeros)
        else:
            run = ready.bound_in_lanes(signals)
            for lane in range(width):
                world = self.worlds[self.of[k * width + lane]]
                ready.put(run, lane, Start(self._y[k], None, None, None, world))
        y, out, kernel = self._y[k], self._out[k], rollout_lanes if width > 1 else ready.kernel
        return _Unit(k, run, y, out, direct(kernel, run, y, out))

    def begin(self, robots: np.ndarray, states: np.ndarray) -> None:
        """Put robots (n,) bool at states (n, length)."""
        places = np.flatnonzero(robots[self.of])
        if not len(places):
            return
        u, lane = np.divmod(places, self.width)
        rows = states[self.of[places]]
        self.y[u, :, lane] = rows
        self.begun[u, lane] = self.offset[u, lane] = 0.0
        for k in np.flatnonzero(rows[:, int(self.ready.scene.layout["end_time"])]).tolist():
            found = self.ready.course(Start(rows[k], None, None, None, self.ready))
            self.begun[u[k], lane[k]], self.offset[u[k], lane[k]] = found.first, found.offset
        self.steps[u, lane] = self.begun[u, lane]
        for unit, k in zip(u.tolist(), lane.tolist()):
            program = self.units[unit].run.signals.program
            if program is not None:
                at = k if self.width > 1 else None
                _of_lane(program.command, at)[...] = 0.0
                _of_lane(program.memory, at)[...] = self.worlds[0].controller.first_memory  # type: ignore[union-attr]
        self._shifted = bool(self.offset.any())

    def change(self, robots: np.ndarray, states: np.ndarray, part: slice) -> None:
        """Give robots (n,) bool a part of other states (n, length)."""
        places = np.flatnonzero(robots[self.of])
        u, lane = np.divmod(places, self.width)
        self.y[u, part, lane] = states[self.of[places], part]

    def marked(self) -> list[np.ndarray]:
        """Copies of all that a tick changes and a later one reads."""
        return [x.copy() for x in self._changing()]

    def back(self, marked: list[np.ndarray]) -> None:
        """Be again as `marked` was told."""
        for x, before in zip(self._changing(), marked):
            x[...] = before

    def _changing(self) -> list[np.ndarray]:
        programs = [unit.run.signals.program for unit in self.units]
        return [self._y, self.steps, *(x for one in programs if one is not None for x in (one.command, one.memory))]

    def writer(self, into: np.ndarray) -> Callable[[np.ndarray], None]:
        """What writes values (n, ...) of all robots into places (units, ..., width)."""
        target = np.moveaxis(into, -1, 1)
        if self.whole:
            count, shape = len(self.of), target.shape
            return lambda values: np.copyto(target, values[:count].reshape(shape))
        return lambda values: np.copyto(target, values[self.of].reshape(target.shape))

    def reader(self, parts: np.ndarray, into: np.ndarray) -> Callable[[], None]:
        """What copies from places (units, ..., width) into values (n, ...) of all robots."""
        source = np.moveaxis(parts, -1, 1)
        if self.whole:
            target = into[: len(self.of)].reshape(source.shape)
            return lambda: np.copyto(target, source)
        count, shape = len(self.robots), into.shape[1:]

        def read() -> None:
            into[self.robots] = source.reshape(-1, *shape)[:count]

        return read

    def tick(self, unit: _Unit) -> None:
        """Let the robots of a unit go on to the next tick."""
        program = unit.run.signals.program
        if program is not None:
            k, lanes = unit.number, slice(None) if self.width > 1 else 0
            program.clock[DONE] = (self.steps - self.begun)[k, lanes]
            program.clock[FIRST], program.clock[OFFSET] = self.begun[k, lanes], self.offset[k, lanes]
        self._call(unit)
        if program is not None:
            self.worlds[0].controller.check(program)  # type: ignore[union-attr]

    def _call(self, unit: _Unit) -> None:
        if not self.timed:
            unit.call(unit.run, unit.y, unit.out)
        elif self.width == 1:
            unit.call(self._at(unit, 0), unit.y, unit.out)
        else:
            self._tick_apart(unit)

    def _at(self, unit: _Unit, lane: int) -> Run:
        """The run at the time of a lane."""
        steps, plan = int(self.steps[unit.number, lane]), unit.run.plan
        plan = plan._replace(first=steps, offset=float(self.offset[unit.number, lane]))
        if self.ready.scene.adaptive:  # of all that the session has gone on, as of one run
            taken = self._pace[unit.number, [pace.STEPS, pace.REJECTED], 0].sum()
            allowed = BUDGET + BUDGET_RATE * (steps + plan.steps) * plan.h
            plan = plan._replace(budget=max(allowed - float(taken), 1.0))
        return unit.run._replace(plan=plan)

    def _tick_apart(self, unit: _Unit) -> None:
        """Lanes of different times one after the other, where something depends on the time."""
        k = unit.number
        courses = [*zip(self.steps[k].tolist(), self.offset[k].tolist())]
        first = {found: lane for lane, found in reversed([*enumerate(courses)])}
        if len(first) == 1:
            unit.call(self._at(unit, 0), unit.y, unit.out)
            return
        before, after, out = unit.y.copy(), unit.y.copy(), unit.out.copy()
        for found, lane in first.items():
            unit.y[...] = before
            unit.call(self._at(unit, lane), unit.y, unit.out)
            mine = [other == found for other in courses]
            after[:, mine], out[..., mine] = unit.y[:, mine], unit.out[..., mine]
        unit.y[...], unit.out[...] = after, out

    def ticked(self, alive: np.ndarray) -> None:
        """Count the tick of those robots (units, width) that were in motion before."""
        plan = self.ready.plan
        np.add(self.steps, self._tick, out=self.steps, where=alive)
        if not self.timed:
            np.multiply(self.steps, plan.h, out=self._time)
            if self._shifted:
                self._time += self.offset
            np.copyto(self.end, self._time, where=alive)


class Crowd:
    """All of them, whatever their structure."""

    def __init__(self, worlds: Sequence[Prepared], noisy: bool = False, threads: int | None = None) -> None:
        self.worlds, self.lots = list(worlds), []
        for ready, robots in _families(self.worlds):
            rest = len(robots) if ready.scene.adaptive else len(robots) % WIDTH
            rest = rest if ready.scene.adaptive or rest <= ALONE else 0
            for part, width in ((robots[: len(robots) - rest], WIDTH), (robots[len(robots) - rest :], 1)):
                if len(part):
                    self.lots.append(Lot(ready, self.worlds, part, width, noisy))
        self._work = [(lot, unit) for lot in self.lots for unit in lot.units]
        self._threads = min(len(self._work), threads or os.cpu_count() or 1)
        self._pool: ThreadPoolExecutor | None = None
        self._pid = os.getpid()

    def tick(self) -> None:
        """Let all go on to the next tick; Ctrl-C waits until they are there, and what a controller raises too."""
        alive = [lot.status == OK for lot in self.lots]
        failures: list[BaseException] = []
        try:
            if len(self._work) == 1:
                lot, unit = self._work[0]
                lot.tick(unit)
            else:
                self._tick_all(failures)
        finally:
            for lot, those in zip(self.lots, alive):
                lot.ticked(those)
            if failures:  # rather than an interrupt, for what has failed has to be undone
                raise failures[0]

    def _tick_all(self, failures: list[BaseException]) -> None:
        todo = iter(self._work)
        futures = [self._workers().submit(_go_on, todo, failures) for _ in range(self._threads - 1)]
        try:
            _go_on(todo, failures)
        finally:
            _go_on(todo, failures)  # what an interrupt has left
            for future in futures:
                if not future.cancel():
                    future.result()

    def begun(self) -> np.ndarray:
        """Steps before the start of each robot (n,)."""
        found = np.zeros(len(self.worlds))
        for lot in self.lots:
            lot.reader(lot.begun, found)()
        return found

    def controllers(self) -> np.ndarray:
        """What controllers of one's own keep of each robot (n, numbers): what they have written, and their memory."""
        found = np.zeros((len(self.worlds), 0))
        for robot, program, lane in self._programs():
            own = np.concatenate([_of_lane(x, lane).ravel() for x in (program.command, program.memory)])
            if not found.shape[1]:
                found = np.zeros((len(self.worlds), len(own)))
            found[robot] = own
        return found

    def keep(self, numbers: np.ndarray) -> None:
        """Give controllers what `controllers` has returned."""
        for robot, program, lane in self._programs():
            command, memory = _of_lane(program.command, lane), _of_lane(program.memory, lane)
            command[...] = numbers[robot, : command.size].reshape(command.shape)
            memory[...] = numbers[robot, command.size :]

    def _programs(self) -> Iterator[tuple[int, Program, int | None]]:
        """Robot, controller and lane."""
        for lot in self.lots:
            for place, robot in enumerate(lot.of.tolist()):
                program = lot.units[place // lot.width].run.signals.program
                if program is not None:
                    yield robot, program, place % lot.width if lot.width > 1 else None

    def _workers(self) -> ThreadPoolExecutor:
        if self._pool is None or self._pid != os.getpid():  # threads do not survive a fork
            self._pool, self._pid = ThreadPoolExecutor(self._threads - 1), os.getpid()
        return self._pool

    def close(self) -> None:
        """End its threads."""
        if self._pool is not None and self._pid == os.getpid():
            self._pool.shutdown()
        self._pool = None


def _of_lane(numbers: np.ndarray, lane: int | None) -> np.ndarray:
    """A view of a lane's numbers, of all where there are no lanes."""
    return numbers if lane is None else numbers[..., lane]


_LOCK = threading.Lock()


def _go_on(todo: Iterator[Any], failures: list[BaseException]) -> None:
    """Take units until there are no more; the iterator of a list hands each out once."""
    while True:
        with _LOCK:
            found = next(todo, None)
        if found is None:
            return
        lot, unit = found
        try:
            lot.tick(unit)
        except Exception as failure:
            failures.append(failure)


def _families(worlds: Sequence[Prepared]) -> list[tuple[Prepared, np.ndarray]]:
    """Robots that can share lanes, and what is ready for them."""
    found: dict[Any, list[int]] = {}
    keys: dict[int, Any] = {}
    for robot, world in enumerate(worlds):
        if id(world) not in keys:
            keys[id(world)] = (family(world), world.scene.layout.tobytes(), world.scene.lag)
        found.setdefault(keys[id(world)], []).append(robot)
    parts = []
    for robots in found.values():
        own = list({id(worlds[r]): worlds[r] for r in robots}.values())
        ready = own[0] if own[0].scene.adaptive else own[0].among(own)
        parts.append((ready, np.array(robots)))
    return parts


