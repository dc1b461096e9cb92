"""Descent along measured slopes: makes a gait cheaper and keeps it within limits.

    result = descend(in_worlds(cost, 8), Watch(cost.scene.model, cost.start[0]), steps=20)

Near a gait that walks, the energy per distance and the violation of a limit at a moment of the stride change nearly in
proportion to small changes of its angles.  A step of the descent therefore

1. walks gaits around the present one, with all angles off by `WIDTH` to either side as the rows of a Hadamard matrix
   say (R. L. Plackett, J. P. Burman, "The design of optimum multifactorial experiments", Biometrika 33 (1946)), so that
   each gait informs about every angle; each walks in one of the worlds, or on the robot's own ground;
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

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult
from tqdm import tqdm

from ..base.arguments import instance, whole
from ..base.fixed_order import applied, product, solve, total
from ..base.line_file import LineFile
from ..run.simulate import simulate_batch, standing_state
from ..run.status import Status
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from . import limits
from .cost import Measures, WalkingCost, measured, window_of
from .cost_in_worlds import CostInWorlds
from .gait import TICK, bounds
from .limits import BY_NAME, Watch

WIDTH = math.radians(0.3)  # of the changes that slopes are measured with [rad]
RADIUS, LEAST_RADIUS, LARGEST_RADIUS = math.radians(1.0), math.radians(0.3), math.radians(1.5)  # of a step [rad]
TRIALS = (1.0, 0.5, 2.0)  # of a step
RADII = {0.0: 0.5, 0.5: 0.7, 1.0: 1.0, 2.0: 1.5}  # factor of the radius, by the best trial; 0: no trial was better
PRICE, GROWS, LARGEST_PRICE = 0.5, 1.35, 30.0
ROWS_PER_NUMBER = 2  # gaits for each of the angles at least, that slopes are measured with
SAMPLE = 0.02  # [s] between records
SHORT = {"warm_up": 1, "strides": 4}  # of the walks that slopes are fitted to
FAR = 2.0  # scales inside a limit from which it is ignored
FINER = 0.25  # of the time step, where speeds chatter
MEMORY = 3  # gaits of which the next has to be better than the worst
SPREAD = 1.0  # standard deviations between strides that are added to their mean
WORK = 24  # candidates of a search that take as long as a step
HISTORY = "descent along measured slopes"


class _Outcome(NamedTuple):
    """How a gait walks in a world."""

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
        self.short = replace(self.walking, **{name: min(n, getattr(self.walking, name)) for name, n in SHORT.items()})
        self.box = bounds(cost.scene.model, cost.gait)
        self.unit = 1.0  # [J/m]
        self.price = PRICE
        self.walks = 0
        self._finer: dict[int, CompiledScene] = {}

    def simulate(self, walking: WalkingCost, vectors: Sequence[np.ndarray], worlds: Sequence[int]) -> list[Trajectory]:
        """Simulate each gait vector in the world of that number."""
        signals = [walking.reference(x, walking.warm_up + walking.strides) for x in vectors]
        states = [self._standing(signal.values[0], k) for signal, k in zip(signals, worlds)]
        self.walks += len(signals)
        return simulate_batch(
            [self.scenes[k] for k in worlds], walking.end, states, signals,
            record=limits.RECORD, record_interval=SAMPLE, estimate_error=False,
        )  # fmt: skip

    def _standing(self, angles: np.ndarray, k: int) -> np.ndarray:
        if k < len(self.cost.scenes):
            return self.cost.standing(angles, k)
        return standing_state(self.scenes[k], angles, allow_limit_violation=True)

    def outcome(self, run: Trajectory, walking: WalkingCost, k: int) -> _Outcome | None:
        """Measure a run in world k; return None if it does not walk."""
        if run.status == "chatter":
            run = replace(run, status=Status.OK, message="")
        scene = self.scenes[k]
        found: Measures = measured(scene, run, walking.mark, walking.end, walking.strides, slip=False)
        if not math.isfinite(found.cost):
            return None
        window = window_of(run, walking.mark, walking.end)
        violations = self.watch.beyond(scene, run, window, walking.strides)
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
        ring = [k for k, run in enumerate(point.runs) if run.status == "chatter"]
        if not ring or not math.isfinite(point.objective):
            return point
        for k in ring:
            if k not in self._finer:
                self._finer[k] = self.scenes[k].recompiled(timestep=FINER * self.scenes[k].timestep)
        walking = self.walking
        signal = walking.reference(point.x, walking.warm_up + walking.strides)
        states = [self._standing(signal.values[0], k) for k in ring]
        again = simulate_batch(
            [self._finer[k] for k in ring], walking.end, states, [signal] * len(ring),
            record=limits.RECORD, record_interval=SAMPLE, estimate_error=False,
        )  # fmt: skip
        runs = list(point.runs)
        for k, run in zip(ring, again):
            runs[k] = replace(run, status=Status.FELL, message="speeds ring") if run.status == "chatter" else run
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

    def step(self, point: _Point, radius: float, seed: Sequence[int]) -> np.ndarray:
        """Return the best change (D,) of a gait by the linear model, no larger than `radius`."""
        slope, slopes, violations = self._slopes(point, seed)
        near = violations > -FAR
        return _best(slope, slopes[:, near], violations[near], self.price, radius)

    def _slopes(self, point: _Point, seed: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Fit slopes (D,) of the cost in its unit and (D, m) of the violations; return them and the violations (m,)."""
        x, D, n = point.x, len(point.x), len(self.scenes)
        generator = np.random.Generator(np.random.PCG64([*seed]))
        signs = _hadamard(ROWS_PER_NUMBER * D)[:, 1 : D + 1] * generator.choice([-1.0, 1.0], D)
        vectors = np.clip(x + WIDTH * signs, *self.box.T)
        worlds = [int(k) % n for k in generator.permutation(len(vectors))]
        runs = self.simulate(self.short, [*vectors], worlds)
        centers = [self.outcome(run, self.short, k) for k, run in enumerate(point.runs)]
        A, Y = [], []
        for vector, k, run in zip(vectors, worlds, runs):
            found, center = self.outcome(run, self.short, k), centers[k]
            if found is not None and center is not None:
                A.append(np.append(vector - x, WIDTH))
                there, here = _typical(found.violations), _typical(center.violations)
                Y.append(np.concatenate([[found.cost - center.cost, found.drift - center.drift], there - here]))
        M = np.array(A).reshape(-1, D + 1)
        normal = product(M.T, M) + 1e-9 * WIDTH * WIDTH * np.eye(D + 1)
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
    descent, path = _Descent(cost, watch), _Path()
    starts = [cost.gait.to_vector()] if starts is None else list(starts)
    log = _History(history, {"search": HISTORY, "version": 1, "seed": seed, "x0": starts[0].tolist()}, resume)
    interrupted = False
    bar = tqdm(total=steps, disable=not progress, unit="step", desc="within limits")
    try:
        point, radius = _begin(descent, starts, log, path)
        for k in range(len(path.steps) - 1, steps if math.isfinite(point.cost) else 0):
            point, radius = _advance(descent, point, radius, (seed, k), log, path)
            bar.update(len(path.steps) - 1 - bar.n)
            bar.set_postfix({"cost": point.cost, "limit violation": point.violation})
    except KeyboardInterrupt:
        interrupted = True
    finally:
        bar.close()
        log.close()
    return path.result(starts[0], descent.walks, interrupted)


class _Path:
    """The gaits that the steps end with, and all that were tried in all worlds."""

    def __init__(self) -> None:
        self.steps: list[tuple[np.ndarray, float, float]] = []  # gait vector, cost [J/m], violation
        self.tried: list[tuple[np.ndarray, float]] = []

    def result(self, first: np.ndarray, walks: int, interrupted: bool) -> OptimizeResult:
        """Return what `descend` does; first: the gait vector if not even one was evaluated."""
        steps = self.steps or [(first, math.inf, math.inf)]
        x, f, violation = (np.array(part) for part in zip(*steps))
        tried = {name: np.array(part) for name, part in zip("xf", zip(*(self.tried or [steps[0][:2]])))}
        return OptimizeResult(
            x=x[-1], fun=float(f[-1]), nit=len(f) - 1, nfev=walks,
            success=bool(np.isfinite(f[-1])) and not interrupted, status=2 if interrupted else 0,
            message="interrupted; the last gait is returned" if interrupted else "finished",
            history={"x": x, "f": f, "broken": violation}, tried=tried,
        )  # fmt: skip


def _begin(descent: _Descent, starts: Sequence[np.ndarray], log: _History, path: _Path) -> tuple[_Point, float]:
    """Evaluate the first gait, or repeat the steps of the history; return the present gait and the radius [rad]."""
    lines, radius = log.lines, RADIUS
    point = descent.evaluate(log.x(0)) if lines else _first_walking(descent, starts)
    descent.unit = point.cost if math.isfinite(point.cost) else 1.0
    path.steps.append((point.x, point.cost, point.violation))
    path.tried.append((point.x, point.cost))
    if not lines:
        log.write(point, radius, [])
    for k, line in enumerate(lines[1:], start=1):
        path.steps.append((log.x(k), line["f"], line["broken"]))
        path.tried += [(np.array(one["x"], dtype=float), one["f"] or math.inf) for one in line["trials"]]
        radius = line["radius"]
    return (descent.evaluate(path.steps[-1][0]) if len(lines) > 1 else point), radius


def _first_walking(descent: _Descent, starts: Sequence[np.ndarray]) -> _Point:
    """Return the first start that walks in all worlds, or the first one if none does."""
    points = (descent.evaluate(x) for x in starts)
    first = next(points)
    return first if math.isfinite(first.cost) else next((p for p in points if math.isfinite(p.cost)), first)


def _advance(
    descent: _Descent, point: _Point, radius: float, seed: tuple[int, int], log: _History, path: _Path
) -> tuple[_Point, float]:
    """Make a step and write it down; return the next gait, or the same one, and the next radius [rad]."""
    descent.price = min(PRICE * GROWS ** seed[1], LARGEST_PRICE)
    worst = max(descent.objective(cost, violation) for _, cost, violation in path.steps[-MEMORY:])
    change = descent.step(point, radius, seed)
    trials = descent.points([np.clip(point.x + share * change, *descent.box.T) for share in TRIALS])
    best = 0.0
    for share, trial in sorted(zip(TRIALS, trials), key=lambda one: one[1].objective):
        if trial.objective < worst and (trial := descent.without_chatter(trial)).objective < worst:
            point, best = trial, share
            break
    path.tried += [(trial.x, trial.cost) for trial in trials]
    path.steps.append((point.x, point.cost, point.violation))
    radius = min(max(radius * RADII[best], LEAST_RADIUS), LARGEST_RADIUS)
    log.write(point, radius, trials)
    return point, radius


class _History:
    """The steps as JSON lines: a header, then a line for the start and each step; without a path nothing is kept."""

    def __init__(self, path: str | os.PathLike[str] | None, header: dict[str, Any], resume: bool) -> None:
        self.lines: list[dict[str, Any]] = []  # of the start and the steps that were made before
        remedy = "resume with the settings it was begun with, or delete it"

        def check(found: dict[str, Any], what: str) -> None:
            if found != header:
                raise ValueError(f"{what}: the history is of another search; {remedy}")

        take = lambda content, *_: self.lines.append(content)  # noqa: E731
        self._file = None if path is None else LineFile(Path(path), resume, header, check, take, remedy)

    def x(self, k: int) -> np.ndarray:
        """Return the gait that step k ended with."""
        return np.array(self.lines[k]["x"], dtype=float)

    def write(self, point: _Point, radius: float, trials: Sequence[_Point]) -> None:
        """Write a step."""
        if self._file is not None:
            number = lambda value: value if math.isfinite(value) else None  # noqa: E731
            each = [{"x": one.x.tolist(), "f": number(one.cost)} for one in trials]
            f, violation = number(point.cost), number(point.violation)
            self._file.write({"x": point.x.tolist(), "f": f, "broken": violation, "radius": radius, "trials": each})

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()


def _typical(violations: np.ndarray) -> np.ndarray:
    """Return the mean plus a standard deviation (m,) over the strides (strides, m)."""
    mean = total(violations, axis=0) / len(violations)
    off = violations - mean
    return mean + SPREAD * np.sqrt(total(off * off, axis=0) / len(violations))


def _hadamard(least: int) -> np.ndarray:
    """Return Sylvester's matrix of +1 and -1: orthogonal columns, at least so many rows; column 0 is all ones."""
    H = np.ones((1, 1))
    while len(H) < least:
        H = np.block([[H, H], [H, -H]])
    return H


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
