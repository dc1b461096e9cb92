"""Views of the present channels and sensors of a session's robots, and the log of what it records."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from ..base.arguments import shown
from ..core.integrate.rollout import OK
from ..core.step.state import BY_NAME, RECORDABLE, shaped
from ..scene.channels import current_name
from . import sensors
from .classify import to_trajectory
from .compiled_run import CompiledRun
from .fleet import Fleet
from .prepare import each_once, prepare
from .range_sensor import RangeSensor, ranges
from .trajectory import Trajectory

SENSORS: dict[str, tuple[Callable[..., Any] | None, tuple[str, ...]]] = {
    "encoders": (sensors.encoders, ("q",)),
    "gyroscope": (sensors.gyroscope, ("base_qd",)),
    "accelerometer": (sensors.accelerometer, ("base_q", "base_qd", "base_qdd")),
    "sole_forces": (sensors.sole_forces, ("contact_force", "q", "base_q")),
    "center_of_pressure": (sensors.center_of_pressure, ("contact_force", "q", "base_q")),
    "contact_positions": (sensors.contact_positions, ("q", "base_q")),
}


class View:
    """Read a channel or sensor of all robots, into an array that is used again."""

    def __init__(self, fleet: Fleet, tick: float, what: str | RangeSensor) -> None:
        self.name: str = what.name if isinstance(what, RangeSensor) else what
        name = current_name(self.name)
        if isinstance(what, RangeSensor):
            self._sensor: Callable[..., Any] | None = functools.partial(ranges, sensor=what)
            needed: tuple[str, ...] = ("base_q", "q")
        elif isinstance(name, str) and name in (*RECORDABLE, *SENSORS):
            self._sensor, needed = SENSORS.get(name, (None, (name,)))
        else:
            known = ", ".join((*RECORDABLE, *SENSORS))
            raise ValueError(f"observe: there is no channel or sensor {shown(name)}; there are {known}")
        self._channel = name
        if not fleet.runs[0].scene.tree.floating:
            needed = tuple(need for need in needed if self._sensor is None or not need.startswith("base"))
        self._runs = each_once(lambda run: prepare(run.scene, tick, needed), fleet.runs)
        self._values = np.zeros((len(fleet.runs), len(self._runs[0].channels)))
        self._copies = []
        for group in fleet.groups:
            part = self._runs[group.robots[0]].channels
            if len(part) and (np.diff(part) == 1).all():  # a view costs less than a choice
                part = slice(int(part[0]), int(part[-1]) + 1)
            self._copies.append(group.reader(part, self._values))
        turning = name == "q" and fleet.runs[0].scene.tree.balls is not None  # quaternions stand elsewhere
        plain = self._sensor is None and BY_NAME[name].kind != "computed" and not turning
        self._shaped = shaped(BY_NAME[name], self._values) if plain else None
        self._result: Any = None

    def __call__(self) -> Any:
        """Return the present values."""
        for copy_part in self._copies:
            copy_part()
        if self._shaped is not None:
            return self._shaped
        found = self._computed()
        if self._result is None:
            self._result = copy.deepcopy(found)
        elif isinstance(found, dict):
            for link, values in found.items():
                np.copyto(self._result[link], values)
        else:
            np.copyto(self._result, found)
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
        named = run.named(values)
        return named[self._channel] if self._sensor is None else self._sensor(run.scene, named)


class Log:
    """Keep what is recorded of all robots, a row for each sample, and where in it each robot has begun."""

    def __init__(self, runs: list[CompiledRun], record: tuple[str, ...]) -> None:
        self.runs, self.record = runs, record
        self._rows = np.zeros((0, len(runs), len(runs[0].channels)))
        self.count = 0
        self._begun = np.zeros(len(runs), int)

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

    def take(self, fleet: Fleet) -> None:
        """Append the records of a tick except for the last one, which is the first of the next tick."""
        more = self.runs[0].samples - 1
        if self.count + more > len(self._rows):
            grown = np.zeros((2 * len(self._rows) + 64 * more, *self._rows.shape[1:]))
            grown[: self.count] = self._rows[: self.count]
            self._rows = grown
        part = self._rows[self.count : self.count + more]
        for group in fleet.groups:
            for k in range(more):
                group.read(group.out[:, k, : part.shape[2]], part[k])
        self.count += more

    def trajectory(self, robot: int, fleet: Fleet) -> Trajectory:
        """Return the trajectory of one robot."""
        run = self.runs[robot]
        group = next(group for group in fleet.groups if robot in group.robots)
        at = divmod(int(np.flatnonzero(group.robots == robot)[0]), group.lanes)
        y = group.y[at[0], :, at[1]].copy()
        out = np.concatenate([self._rows[self._begun[robot] : self.count, robot], y[None, run.channels]])
        steps = (len(out) - 1) * run.plan.per_sample
        if int(y[run.scene.layout["status"]]) == OK:
            steps = int(group.steps[at] - group.begun[at])
        schedule = run.plan._replace(first=int(group.begun[at]), offset=float(group.offset[at]), steps=steps)
        return to_trajectory(run, y, out, schedule)
