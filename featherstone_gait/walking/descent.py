"""Descent along measured slopes: makes a gait cheaper and keeps it within limits.

    result = descend(in_worlds(cost, 8), Watch(cost.scene.model, cost.start[0]), steps=20)

Near a gait that walks, the energy per distance and the violation of a limit at a moment of the stride change nearly in
proportion to small changes of its angles.  A step of the descent therefore

1. walks gaits around the present one, with all angles off by a width to either side as the rows of a Hadamard matrix
   say (R. L. Plackett, J. P. Burman, "The design of optimum multifactorial experiments", Biometrika 33 (1946)), so that
   each gait informs about every angle; each walks in one of the worlds, or on the robot's own ground.  The width is
   `WIDTH`, or two counts of the coarsest encoder: within a count a servo hardly sees a change of its angles;
2. fits slopes to them by least squares: of the cost, and of every limited quantity at every moment;
3. finds the change of angles, none larger than a radius, that minimizes the linear model of cost + price * sum of
   squared violations (the mean of the worlds; of the robot's own ground the worst stride);
4. tries that change, half of it and twice of it in all worlds.  The best trial is the next gait if it is better than
   the worst of the last three gaits, because measured costs are noisy (L. Grippo, F. Lampariello, S. Lucidi, "A
   nonmonotone line search technique for Newton's method", SIAM J. Numer. Anal. 23 (1986)); the radius grows or shrinks
   by which trial it was.

The price grows from step to step: cheap gaits that violate limits lead to cheap ones that do not.  A trial whose joint
speeds chatter in a world is repeated there at a quarter of the time step, and has fallen if it chatters again.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import hadamard
from scipy.optimize import OptimizeResult

from ..base.arguments import instance, whole
from ..base.fixed_order import applied, product, solve, total
from ..base.line_file import LineFile
from ..base.progress import progress_bar
from ..run.status import Status
from ..run.trajectory import Trajectory
from . import limits
from .cost import WalkingCost, measured, walk_runs, window_of
from .cost_in_worlds import CostInWorlds, with_chatter
from .gait import TICK, bounds
from .limits import BY_NAME, Watch

WIDTH = math.radians(0.3)  # of the changes that slopes are measured with [rad], at least ...
COUNTS = 2.0  # ... so many counts of an encoder
RADIUS, LEAST_RADIUS, LARGEST_RADIUS = math.radians(1.0), math.radians(0.3), math.radians(1.5)  # of a step [rad]
TRIALS = (1.0, 0.5, 2.0)  # of a step
RADII = {0.0: 0.5, 0.5: 0.7, 1.0: 1.0, 2.0: 1.5}  # factor of the radius, by the best trial; 0: no trial was better
PRICE, GROWS, LARGEST_PRICE = 0.5, 1.35, 30.0
ROWS_PER_NUMBER = 2  # gaits for each of the angles at least, that slopes are measured with
SAMPLE = 0.02  # [s] between records
SHORT = {"warm_up": 1, "strides": 4}  # of the walks that slopes are fitted to
IGNORED_WITHIN = 2.0  # scales inside a limit from which it is ignored
FINER = 0.25  # of the time step, where speeds chatter
MEMORY = 3  # gaits of which the next has to be better than the worst
SPREAD = 1.0  # standard deviations between strides that are added to their mean
WORK = 24  # candidates of a search that take as long as a step
HISTORY = "descent along measured slopes"


class _Outcome(NamedTuple):
    """The measures of a gait in a world."""

    cost: float  # [J/m]
    drift: float  # sideways over forward
    violations: np.ndarray  # (strides, m)


@dataclass(frozen=True, eq=False)
class _Point:
    """A gait in all worlds."""

    x: np.ndarray
    objective: float  # cost over that of the first gait, plus price times violation
    cost: float  # in the worlds [J/m]
    violation: float  # sum of squared violations
    runs: Sequence[Trajectory]  # in the worlds, and on the robot's own ground


class _Descent:
    """Measures gaits and slopes; the last of its scenes is the robot's own ground."""

    def __init__(self, cost: CostInWorlds, watch: Watch) -> None:
        self.cost, self.watch, self.walking = cost, watch, cost.cost
        self.scenes = [*cost.scenes, cost.scene]
        self.offsets = np.vstack([cost.offsets, np.zeros_like(cost.offsets[0])])
        self.short = replace(self.walking, **{name: min(n, getattr(self.walking, name)) for name, n in SHORT.items()})
        self.box = bounds(cost.scene.model, cost.gait)
        counts = [servo.encoder_resolution for servo in cost.scene.model.servos.values()]
        self.width = max([WIDTH, *(COUNTS * count for count in counts)])
        self.unit = 1.0  # [J/m]
        self.price = PRICE
        self.walks = 0
        self.finer = functools.cache(lambda k: self.scenes[k].recompiled(timestep=FINER * self.scenes[k].timestep))

    def simulate(
        self, walking: WalkingCost, vectors: Sequence[np.ndarray], worlds: Sequence[int], finer: bool = False
    ) -> list[Trajectory]:
        """Simulate each gait vector in the world of that number; finer: at a quarter of the time step."""
        self.walks += 0 if finer else len(worlds)
        scenes = [self.finer(k) if finer else self.scenes[k] for k in worlds]
        signals = [walking.reference(x, walking.warm_up + walking.strides) for x in vectors]
        offsets = self.offsets[[*worlds]]
        return walk_runs(scenes, walking.end, signals, offsets, record=limits.RECORD, record_interval=SAMPLE)

    def outcome(self, run: Trajectory, walking: WalkingCost, k: int) -> _Outcome | None:
        """Measure a run in world k; return None if it does not walk."""
        run, scene = with_chatter(run), self.scenes[k]
        found = measured(scene, run, walking.mark, walking.end, walking.strides, slip=False)
        if not math.isfinite(found.cost):
            return None
        violations = self.watch.beyond(scene, run, window_of(run, walking.mark, walking.end), walking.strides)
        return _Outcome(found.cost, found.sideways / found.distance, violations)

    def evaluate(self, x: np.ndarray) -> _Point:
        """Walk a gait in all worlds; runs with chatter are repeated."""
        return self.without_chatter(self.points([x])[0])

    def points(self, vectors: Sequence[np.ndarray]) -> list[_Point]:
        """Walk gaits in all worlds; runs with chatter count as they are."""
        n = len(self.scenes)
        runs = self.simulate(self.walking, [x for x in vectors for _ in range(n)], [*range(n)] * len(vectors))
        return [self._point(x, runs[k * n : (k + 1) * n]) for k, x in enumerate(vectors)]

    def without_chatter(self, point: _Point) -> _Point:
        """Repeat runs with chatter at a quarter of the time step; one that chatters there too has fallen."""
        chattering = [k for k, run in enumerate(point.runs) if run.status == "chatter"]
        if not chattering or not math.isfinite(point.objective):
            return point
        runs = list(point.runs)
        for k, run in zip(chattering, self.simulate(self.walking, [point.x] * len(chattering), chattering, finer=True)):
            runs[k] = (
                replace(run, status=Status.FELL, message="joint speeds chatter") if run.status == "chatter" else run
            )
        return self._point(point.x, runs)

    def _point(self, x: np.ndarray, runs: Sequence[Trajectory]) -> _Point:
        outcomes = [one for k, run in enumerate(runs) if (one := self.outcome(run, self.walking, k)) is not None]
        if len(outcomes) < len(runs):
            return _Point(x, math.inf, math.inf, math.inf, runs)
        cost = self.cost.combined([one.cost for one in outcomes[:-1]])[0]
        violations = np.maximum(self._violations(x, outcomes), 0.0)
        violation = float(total(violations * violations))
        return _Point(x, self.objective(cost, violation), cost, violation, runs)

    def objective(self, cost: float, violation: float) -> float:
        """Weigh cost [J/m] and violation at the present price."""
        return cost / self.unit + self.price * violation

    def _violations(self, x: np.ndarray, outcomes: Sequence[_Outcome]) -> np.ndarray:
        """Collect violations (m,): mean of the worlds, worst stride on the own ground, drift, clearance of links."""
        n = len(outcomes) - 1
        worlds = total(np.array([_typical(one.violations) for one in outcomes[:-1]]), axis=0) / n
        limit, mean, own = BY_NAME["drift"], math.fsum(one.drift for one in outcomes[:-1]) / n, outcomes[-1]
        drifts = (np.array([mean, -mean, own.drift, -own.drift]) - limit.bound + limit.margin) / limit.scale
        return np.concatenate([worlds, own.violations.max(axis=0), drifts, self._clearance_violations(x)])

    def _clearance_violations(self, x: np.ndarray) -> np.ndarray:
        """Measure by how much links are too close at each reference of a stride (n,)."""
        gait = self.cost.gait.from_vector(x)
        found = self.watch.apart(gait.angles(TICK * np.arange(round(gait.period / TICK))))
        return found.beyond(BY_NAME["apart"])[:, 0]

    def slopes(self, point: _Point, seed: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fit slopes (D,) of the cost in its unit and (D, m) of the violations; return them and the violations (m,)."""
        x, D, n = point.x, len(point.x), len(self.scenes)
        generator = np.random.Generator(np.random.PCG64([*seed]))
        rows = 1 << (ROWS_PER_NUMBER * D - 1).bit_length()
        signs = hadamard(rows, dtype=float)[:, 1 : D + 1] * generator.choice([-1.0, 1.0], D)
        vectors = np.clip(x + self.width * signs, *self.box.T)
        worlds = [int(k) % n for k in generator.permutation(len(vectors))]
        runs = self.simulate(self.short, [*vectors], worlds)
        centers = [self.outcome(run, self.short, k) for k, run in enumerate(point.runs)]
        A, Y = [], []
        for vector, k, run in zip(vectors, worlds, runs):
            found, center = self.outcome(run, self.short, k), centers[k]
            if found is not None and center is not None:
                A.append(np.append(vector - x, self.width))
                there, here = _typical(found.violations), _typical(center.violations)
                Y.append(np.concatenate([[found.cost - center.cost, found.drift - center.drift], there - here]))
        M = np.array(A).reshape(-1, D + 1)
        normal = product(M.T, M) + 1e-9 * self.width * self.width * np.eye(D + 1)
        fit = solve(normal, product(M.T, np.array(Y).reshape(len(M), -1)))[:D] if len(M) else np.zeros((D, 2))
        outcomes = [one for k, run in enumerate(point.runs) if (one := self.outcome(run, self.walking, k)) is not None]
        drift = fit[:, 1:2] / BY_NAME["drift"].scale * [1.0, -1.0, 1.0, -1.0]
        here = self._clearance_violations(x)
        apart = np.array([self._clearance_violations(x + e) - here for e in 1e-4 * np.eye(D)]) / 1e-4
        slopes = np.hstack([fit[:, 2:], fit[:, 2:], drift, apart])
        return fit[:, 0] / self.unit, slopes, self._violations(x, outcomes)


def descend(
    cost: CostInWorlds,
    watch: Watch,
    starts: Sequence[np.ndarray] | None = None,
    *,
    steps: int,
    seed: int = 0,
    history: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: bool = False,
) -> OptimizeResult:
    """Make a gait vector cheaper in the worlds of `cost` and keep it within limits.

    Parameters
    ----------
    cost : CostInWorlds
        The cost of gait vectors in several worlds.
    watch : Watch
        Measures the limited quantities.
    starts : sequence of ndarray, shape (D,), optional
        Gait vectors [rad], of which the descent starts from the first that walks; by default the first gait.
    steps, seed : int
        Number of steps; seed of the draws.
    history, resume, progress
        As of `search.minimize`; the history has a line a step.

    Returns
    -------
    scipy.optimize.OptimizeResult
        x, fun (cost in the worlds [J/m]), nit (steps), nfev (walks), success, status (0, or 2 if interrupted), message,
        and history: arrays x (nit + 1, D), f [J/m] and broken, the sum of squared violations, of the gait that each
        step ends with; tried: x and f of all gaits that were tried in all worlds.
    """
    instance("cost", cost, CostInWorlds, "give what in_worlds returns")
    steps = whole("steps", steps, 0, "it is a number of steps", 10**6)
    descent = _Descent(cost, watch)
    starts = [cost.gait.to_vector()] if starts is None else list(starts)
    log = _History(history, {"search": HISTORY, "version": 1, "seed": seed, "x0": starts[0].tolist()}, resume)
    interrupted = True
    bar = progress_bar(total=steps, progress=progress, unit="step", desc="within limits")
    with closing(log), bar, suppress(KeyboardInterrupt):
        point, radius = _begin(descent, starts, log)
        for k in range(len(log.lines) - 1, steps if math.isfinite(point.cost) else 0):
            point, radius = _advance(descent, point, radius, (seed, k), log)
            bar.update(len(log.lines) - 1 - bar.n)
            bar.set_postfix({"cost": point.cost, "limit violation": point.violation})
        interrupted = False
    return log.result(starts[0], descent.walks, interrupted)


def _begin(descent: _Descent, starts: Sequence[np.ndarray], log: _History) -> tuple[_Point, float]:
    """Evaluate the first start that walks, or the last gait of the history; return it and the radius [rad]."""
    points = (descent.evaluate(x) for x in ([log.x(0)] if log.lines else starts))
    first = next(points)
    point = first if math.isfinite(first.cost) else next((p for p in points if math.isfinite(p.cost)), first)
    descent.unit = point.cost if math.isfinite(point.cost) else 1.0
    if not log.lines:
        log.write(point, RADIUS, [])
    return (descent.evaluate(log.x(-1)) if len(log.lines) > 1 else point), log.lines[-1]["radius"]


def _advance(
    descent: _Descent, point: _Point, radius: float, seed: tuple[int, int], log: _History
) -> tuple[_Point, float]:
    """Make a step and write it down; return the next gait, or the same one, and the next radius [rad]."""
    descent.price = min(PRICE * GROWS ** seed[1], LARGEST_PRICE)
    worst = max(descent.objective(line["f"], line["broken"]) for line in log.lines[-MEMORY:])
    slope, slopes, violations = descent.slopes(point, seed)
    near = violations > -IGNORED_WITHIN
    change = _best(slope, slopes[:, near], violations[near], descent.price, radius)
    trials = descent.points([np.clip(point.x + share * change, *descent.box.T) for share in TRIALS])
    best = 0.0
    for share, trial in sorted(zip(TRIALS, trials), key=lambda one: one[1].objective):
        if trial.objective < worst and (trial := descent.without_chatter(trial)).objective < worst:
            point, best = trial, share
            break
    radius = min(max(radius * RADII[best], LEAST_RADIUS), LARGEST_RADIUS)
    log.write(point, radius, trials)
    return point, radius


class _History:
    """The gaits that the steps end with, and all that were tried in all worlds: a line for the start and each step.

    With a path they are lines of a file too, after a header.
    """

    def __init__(self, path: str | os.PathLike[str] | None, header: dict[str, Any], resume: bool) -> None:
        self.lines: list[dict[str, Any]] = []
        remedy = "resume with the settings it was begun with, or delete it"

        def check(found: dict[str, Any], what: str) -> None:
            other = [key for key in header if found.get(key) != header[key]]
            if found != header:
                raise ValueError(f"{what}: the history is of another search ({', '.join(other)} differs); {remedy}")

        take = lambda content, *_: self.lines.append(content)  # noqa: E731
        self._file = None if path is None else LineFile(Path(path), resume, header, check, take, remedy)

    def x(self, k: int) -> np.ndarray:
        """Return the gait that step k ended with."""
        return np.array(self.lines[k]["x"], dtype=float)

    def write(self, point: _Point, radius: float, trials: Sequence[_Point]) -> None:
        """Write a step."""
        number = lambda value: value if math.isfinite(value) else None  # noqa: E731
        each = [{"x": one.x.tolist(), "f": number(one.cost)} for one in trials]
        line = {"x": point.x.tolist(), "f": number(point.cost), "broken": number(point.violation), "radius": radius}
        self.lines.append(line | {"trials": each})
        if self._file is not None:
            self._file.write(self.lines[-1])

    def result(self, first: np.ndarray, walks: int, interrupted: bool) -> OptimizeResult:
        """Return what `descend` does; first: the gait vector if not even one was evaluated."""
        steps = self.lines or [{"x": first, "f": None, "broken": None, "trials": []}]
        tried = [steps[0], *(trial for step in steps for trial in step["trials"])]
        number = lambda value: math.inf if value is None else value  # noqa: E731
        arrays = lambda rows, *names: {  # noqa: E731
            "x": np.array([row["x"] for row in rows], dtype=float),
            **{name: np.array([number(row[name]) for row in rows], dtype=float) for name in names},
        }
        history = arrays(steps, "f", "broken")
        x, f = history["x"][-1], float(history["f"][-1])
        return OptimizeResult(
            x=x, fun=f, nit=len(steps) - 1, nfev=walks, success=math.isfinite(f) and not interrupted,
            status=2 if interrupted else 0, history=history, tried=arrays(tried, "f"),
            message="interrupted; the last gait is returned" if interrupted else "finished",
        )  # fmt: skip

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()


def _typical(violations: np.ndarray) -> np.ndarray:
    """Return the mean plus a standard deviation (m,) over the strides (strides, m)."""
    mean = total(violations, axis=0) / len(violations)
    off = violations - mean
    return mean + SPREAD * np.sqrt(total(off * off, axis=0) / len(violations))


def _best(slope: np.ndarray, slopes: np.ndarray, violations: np.ndarray, price: float, radius: float) -> np.ndarray:
    """Minimize slope d + price |max(0, violations + slopes' d)|^2 + damping |d|^2, damped so that no |d_i| > radius."""
    d, damping = np.zeros(len(slope)), 1e-3
    for _ in range(40):
        for _ in range(25):
            v = violations + applied(slopes.T, d) if len(violations) else violations
            active = slopes[:, v > 0.0]
            gradient, curvature = slope + 2.0 * damping * d, 2.0 * damping * np.eye(len(d))
            if active.size:
                gradient = gradient + 2.0 * price * applied(active, v[v > 0.0])
                curvature = curvature + 2.0 * price * product(active, active.T)
            change = solve(curvature, -gradient[:, None])[:, 0]
            d = d + change
            if np.abs(change).max() < 1e-6 * radius:
                break
        if np.abs(d).max() <= radius:
            break
        damping *= 2.0
    return d * min(1.0, radius / max(np.abs(d).max(), 1e-12))
