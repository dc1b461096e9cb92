"""Views of the present channels and sensors of a session's robots, and the log of what it records."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from ..core.integrate.rollout import OK
from ..core.step.state import BY_NAME, shaped
from ..model.sensor import SampledSensor
from .classify import to_trajectory
from .compiled_run import CompiledRun
from .fleet import Fleet
from .measure import Pace, What, found, here, name_of, noise_of
from .prepare import each_once, prepare
from .trajectory import Trajectory


class View:
    """Read a channel or sensor of all robots, into an array that is used again."""

    def __init__(self, fleet: Fleet, tick: float, what: What) -> None:
        self.name: str = name_of(what)
        inner = what.sensor if isinstance(what, SampledSensor) else what
        self._reading, needed = found(what)[0], here(fleet.runs[0].scene, what)
        name = inner if isinstance(inner, str) else ""
        self._runs = each_once(lambda run: prepare(run.scene, tick, needed), fleet.runs)
        self._values = np.zeros((len(fleet.runs), len(self._runs[0].channels)))
        self._copies, self._fleet, self.late = [], fleet, self._runs[0].late
        for group in fleet.groups:
            part = self._runs[group.robots[0]].channels
            if len(part) and (np.diff(part) == 1).all():  # a view costs less than a choice
                part = slice(int(part[0]), int(part[-1]) + 1)
            self._copies.append(group.reader(part, self._values))
        turning = name == "q" and fleet.runs[0].scene.tree.balls is not None  # quaternions stand elsewhere
        plain = name in BY_NAME and BY_NAME[name].kind != "computed" and not turning
        self._shaped = shaped(BY_NAME[name], self._values) if plain else None
        self._result: Any = None

    def __call__(self) -> Any:
        """Return the present values."""
        for copy_part in self._copies:
            copy_part()
        if self._fleet.seen is not None:
            _put_first(self._fleet.seen, self._runs[0], self._values)
        if self._shaped is not None:
            return self._shaped
        computed = self._computed()
        if self._result is None:
            self._result = copy.deepcopy(computed)
        elif isinstance(computed, dict):
            for link, values in computed.items():
                np.copyto(self._result[link], values)
        else:
            np.copyto(self._result, computed)
        return self._result

    def _computed(self) -> Any:
        """Compute the values of each robot as of a sample of a trajectory; in worlds one after the other."""
        if all(run is self._runs[0] for run in self._runs):
            return self._of(self._runs[0], self._values)
        each = [self._of(run, row[None]) for run, row in zip(self._runs, self._values)]
        if isinstance(each[0], dict):
            return {link: np.concatenate([one[link] for one in each]) for link in each[0]}
        return np.concatenate(each)

    def _of(self, run: CompiledRun, values: np.ndarray) -> Any:
        return self._reading(run.scene, run.named(values))


def _put_first(seen: tuple[np.ndarray, np.ndarray], run: CompiledRun, values: np.ndarray) -> None:
    """Overwrite what no step has computed yet in numbers (n, all) of a run's channels, of robots at their start."""
    (robots, states), late = seen, run.late
    values[np.ix_(robots, late)] = states[np.ix_(robots, run.channels[late])]


class SampledView:
    """What a sampled sensor of all robots has answered last; `take` measures, once a tick."""

    def __init__(self, fleet: Fleet, tick: float, sensor: SampledSensor) -> None:
        self.name, self.sensor, self._pace = sensor.name, sensor, Pace(sensor, tick, "ticks")
        self._exact, self._tick, self._robots = View(fleet, tick, sensor), tick, np.arange(len(fleet.runs))
        self.late = self._exact.late
        depth = self._pace.delay // self._pace.period + 2
        self._answers: np.ndarray | None = None  # (depth, robots, ...), by the number of the measurement
        self._depth, self._age = depth, np.zeros(len(fleet.runs), np.int64)
        self._result: np.ndarray | None = None

    def __call__(self) -> np.ndarray:
        """Return the present answers."""
        assert self._answers is not None
        number = np.maximum((self._age - self._pace.delay) // self._pace.period, 0)
        answers = self._answers[number % self._depth, self._robots]
        if self._result is None:
            self._result = answers
        else:
            np.copyto(self._result, answers)
        return self._result

    def take(self, time: np.ndarray, begun: np.ndarray | None = None) -> None:
        """Measure where it is due at the times of the robots (n,) [s]; begun (n,) bool: those that are at a start."""
        self._age = np.rint(time / self._tick).astype(np.int64)
        begun = np.zeros(len(self._age), bool) if begun is None else begun
        due = np.flatnonzero(begun | (self._age % self._pace.period == 0))
        if not len(due):
            return
        exact, number = np.asarray(self._exact()), self._age[due] // self._pace.period
        values = exact[due] + noise_of(self.sensor, exact.shape[1:], due, number)
        if self._answers is None:
            self._answers = np.zeros((self._depth, *exact.shape))
        self._answers[number % self._depth, due] = values
        first = begun[due]
        self._answers[:, due[first]] = values[first]

    def kept(self) -> np.ndarray:
        """Return a copy of what it goes on from."""
        assert self._answers is not None
        return self._answers.copy()

    def restore(self, answers: np.ndarray, time: np.ndarray) -> None:
        """Go on from what `kept` has returned, at the times of the robots (n,) [s]."""
        self._answers, self._age = answers.copy(), np.rint(time / self._tick).astype(np.int64)


def view_of(fleet: Fleet, tick: float, what: What) -> View | SampledView:
    """Return what reads a channel or sensor of all robots."""
    return SampledView(fleet, tick, what) if isinstance(what, SampledSensor) else View(fleet, tick, what)


class Log:
    """Keep what is recorded of all robots, a row for each sample, and where in it each robot has begun."""

    def __init__(self, runs: list[CompiledRun], record: tuple[str, ...]) -> None:
        self.runs, self.record = runs, record
        self._rows = np.zeros((0, len(runs), len(runs[0].channels)))
        self.count = 0
        self._begun = np.zeros(len(runs), int)

    @property
    def late(self) -> np.ndarray:
        """Which of the recorded numbers only a step computes."""
        return self.runs[0].late if self.record else np.zeros(0, int)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"runs": None, "_rows": self._rows[: self.count]}

    def copy(self, runs: list[CompiledRun]) -> Log:
        """Return an independent log for robots of other runs."""
        other = copy.copy(self)
        other.runs, other._rows, other._begun = runs, self._rows[: self.count].copy(), self._begun.copy()
        return other

    def restart(self, who: np.ndarray) -> None:
        """Discard earlier records of these robots."""
        self._begun[who] = self.count
        oldest = int(self._begun.min())
        if oldest > self.count // 2:
            self._rows = self._rows[oldest : self.count].copy()
            self.count -= oldest
            self._begun -= oldest

    def take(self, fleet: Fleet, seen: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        """Append the records of a tick except for the last one, which is the first of the next tick.

        seen: robots that began with this tick, and the states as they began.
        """
        more = self.runs[0].samples - 1
        if self.count + more > len(self._rows):
            grown = np.zeros((2 * len(self._rows) + 64 * more, *self._rows.shape[1:]))
            grown[: self.count] = self._rows[: self.count]
            self._rows = grown
        part = self._rows[self.count : self.count + more]
        for group in fleet.groups:
            for k in range(more):
                group.read(group.out[:, k, : part.shape[2]], part[k])
        if seen is not None and more:
            _put_first(seen, self.runs[0], part[0])
        self.count += more

    def trajectory(self, robot: int, fleet: Fleet) -> Trajectory:
        """Return the trajectory of one robot."""
        run = self.runs[robot]
        group = next(group for group in fleet.groups if robot in group.robots)
        at = divmod(int(np.flatnonzero(group.robots == robot)[0]), group.lanes)
        y = group.y[at[0], :, at[1]].copy()
        last = y[None, run.channels]
        if fleet.seen is not None and robot in fleet.seen[0]:
            last[0, run.late] = fleet.seen[1][robot, run.channels[run.late]]
        out = np.concatenate([self._rows[self._begun[robot] : self.count, robot], last])
        steps = (len(out) - 1) * run.plan.per_sample
        if int(y[run.scene.layout["status"]]) == OK:
            steps = int(group.steps[at] - group.begun[at])
        schedule = run.plan._replace(first=int(group.begun[at]), offset=float(group.offset[at]), steps=steps)
        return to_trajectory(run, y, out, schedule)
