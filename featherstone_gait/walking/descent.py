"""Makes a gait cheaper and keeps it to limits, along slopes that are measured.

    result = descend(in_worlds(cost, 8), Watch(cost.scene.model, cost.start[0]), steps=20)

Of a gait that walks, energy per distance and what passes a limit at a moment of the stride change nearly in proportion
to small changes of its angles.  A step of the descent therefore

- walks gaits around the present one, all angles of each off by `WIDTH` to either side as the rows of a Hadamard matrix
  say (R. L. Plackett, J. P. Burman, "The design of optimum multifactorial experiments", Biometrika 33 (1946)), so that
  each of n gaits tells of each angle; each walks in one of the worlds, or on the robot's own floor;
- fits slopes to them by least squares, of the cost and of every limited quantity at every moment;
- finds the change of angles that is best if they hold, none larger than a radius: least cost + price * sum of squares
  of what is beyond the limits, of the worlds the mean, and of the own floor the worst stride;
- tries it and its half and double in all worlds.  The best is the next gait if it is better than the worst of the last
  three, since what a gait measures has noise (L. Grippo, F. Lampariello, S. Lucidi, "A nonmonotone line search
  technique for Newton's method", SIAM J. Numer. Anal. 23 (1986)); by which it was the radius grows or shrinks.

The price grows from step to step: cheap gaits that pass limits are the way to cheap ones that do not.  A trial whose
speeds ring in a world is repeated there at a quarter of the step before it counts, and has fallen if they ring again.
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
from ..base.files import parse_json
from ..base.fixed_order import applied, product, solve, total
from ..run.simulate import simulate_batch, standing_state
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from ..search.history import LineFile
from . import limits
from .cost import Measures, WalkingCost, measured
from .cost_in_worlds import CostInWorlds
from .gait import TICK, bounds
from .limits import BY_NAME, Watch

WIDTH = math.radians(0.3)  # of the changes that slopes are measured with [rad]
RADIUS, LEAST_RADIUS, LARGEST_RADIUS = math.radians(1.0), math.radians(0.3), math.radians(1.5)  # of a step [rad]
TRIALS = (1.0, 0.5, 2.0)  # of a step
RADII = {0.0: 0.5, 0.5: 0.7, 1.0: 1.0, 2.0: 1.5}  # by which the radius changes, by the trial that was best; 0 is none
PRICE, GROWS, LARGEST_PRICE = 0.5, 1.35, 30.0
ROWS_PER_NUMBER = 2  # gaits for each of the angles at least, that slopes are measured with
SAMPLE = 0.02  # [s] between records
SHORT = {"warm_up": 1, "strides": 4}  # of the walks that tell slopes
FAR = 2.0  # scales within a limit from which it plays no part
FINER = 0.25  # of the step where speeds ring
MEMORY = 3  # gaits of which the next has to be better than the worst
SPREAD = 1.0  # standard deviations between strides that are added to their mean
WORK = 24  # candidates of a search that take as long as a step
HISTORY = "descent along measured slopes"


class _Walked(NamedTuple):
    """How a gait goes in a world."""

    cost: float  # [J/m]; infinite where it does not walk
    drift: float
    beyond: np.ndarray  # (strides, m)


@dataclass(frozen=True, eq=False)
class _Point:
    """A gait in all worlds."""

    x: np.ndarray
    price: float  # cost over that of the first gait, and what it pays
    cost: float  # as a search is told it [J/m]
    broken: float  # sum of squares of what is beyond limits
    runs: Sequence[Trajectory]  # in the worlds, and on the own floor


class _Descent:
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
        """One run a vector, in the world of that number; the last is the own floor."""
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

    def walked(self, run: Trajectory, walking: WalkingCost, k: int) -> _Walked | None:
        """None where it does not walk."""
        if run.status == "chatter":
            run = replace(run, status="ok", message="")
        scene = self.scenes[k]
        found: Measures = measured(scene, run, walking.mark, walking.end, walking.strides, slip=False)
        if not math.isfinite(found.cost):
            return None
        first, last = np.searchsorted(run["time"], [walking.mark - 1e-9, walking.end - 1e-9])
        beyond = self.watch.beyond(scene, run, slice(first, last + 1), walking.strides)
        return _Walked(found.cost, found.sideways / found.distance, beyond)

    def points(self, vectors: Sequence[np.ndarray]) -> list[_Point]:
        """Gaits in all worlds and on the own floor; runs whose speeds ring are taken as they are."""
        n = len(self.scenes)
        runs = self.simulate(self.walking, [x for x in vectors for _ in range(n)], [*range(n)] * len(vectors))
        return [self._point(x, runs[k * n : (k + 1) * n]) for k, x in enumerate(vectors)]

    def judged(self, point: _Point) -> _Point:
        """The same with runs whose speeds ring repeated at a quarter of the step, where that is a fall."""
        ring = [k for k, run in enumerate(point.runs) if run.status == "chatter"]
        if not ring or not math.isfinite(point.price):
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
            runs[k] = replace(run, status="fell", message="speeds ring") if run.status == "chatter" else run
        return self._point(point.x, runs)

    def _point(self, x: np.ndarray, runs: Sequence[Trajectory]) -> _Point:
        found = [self.walked(run, self.walking, k) for k, run in enumerate(runs)]
        whole = [one for one in found if one is not None]
        if len(whole) < len(found):
            return _Point(x, math.inf, math.inf, math.inf, runs)
        cost = self.cost.told([one.cost for one in whole[:-1]])[0]
        beyond = np.maximum(self._beyond(x, whole), 0.0)
        broken = float(total(beyond * beyond))
        return _Point(x, self.priced(cost, broken), cost, broken, runs)

    def priced(self, cost: float, broken: float) -> float:
        """At today's price."""
        return cost / self.unit + self.price * broken

    def _beyond(self, x: np.ndarray, found: Sequence[_Walked]) -> np.ndarray:
        """By how much a gait is beyond limits (m,): mean of the worlds, worst stride on the own floor, drift, links."""
        worlds = total(np.array([_typical(one.beyond) for one in found[:-1]]), axis=0) / (len(found) - 1)
        return np.concatenate([worlds, found[-1].beyond.max(axis=0), self._drift_and_apart(x, found)])

    def _drift_and_apart(self, x: np.ndarray, found: Sequence[_Walked]) -> np.ndarray:
        """By how much the drift to either side is beyond, of the worlds and of the own floor, and links."""
        limit = BY_NAME["drift"]
        mean = math.fsum(one.drift for one in found[:-1]) / (len(found) - 1)
        drifts = np.array([mean, -mean, found[-1].drift, -found[-1].drift])
        return np.concatenate([(drifts - limit.bound + limit.margin) / limit.scale, self._apart(x)])

    def _apart(self, x: np.ndarray) -> np.ndarray:
        """By how much links are too close, at each reference of a stride (n,)."""
        gait = self.cost.gait.from_vector(x)
        found = self.watch.apart(gait.angles(TICK * np.arange(round(gait.period / TICK))))
        return found.beyond(BY_NAME["apart"])[:, 0]

    def step(self, point: _Point, radius: float, seed: Sequence[int]) -> np.ndarray:
        """The best change (D,) of a gait if slopes hold, none larger than `radius`."""
        slope, slopes, beyond = self._slopes(point, seed)
        near = beyond > -FAR
        return _best(slope, slopes[:, near], beyond[near], self.price, radius)

    def _slopes(self, point: _Point, seed: Sequence[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slopes (D,) of the cost in its unit and (D, m) of what is beyond, and that itself (m,)."""
        x, D, n = point.x, len(point.x), len(self.scenes)
        generator = np.random.Generator(np.random.PCG64([*seed]))
        signs = _hadamard(ROWS_PER_NUMBER * D)[:, 1 : D + 1] * generator.choice([-1.0, 1.0], D)
        vectors = np.clip(x + WIDTH * signs, *self.box.T)
        worlds = [int(k) % n for k in generator.permutation(len(vectors))]
        runs = self.simulate(self.short, [*vectors], worlds)
        centers = [self.walked(run, self.short, k) for k, run in enumerate(point.runs)]
        A, Y = [], []
        for vector, k, run in zip(vectors, worlds, runs):
            found, center = self.walked(run, self.short, k), centers[k]
            if found is not None and center is not None:
                A.append(np.append(vector - x, WIDTH))
                there, here = _typical(found.beyond), _typical(center.beyond)
                Y.append(np.concatenate([[found.cost - center.cost, found.drift - center.drift], there - here]))
        M = np.array(A).reshape(-1, D + 1)
        normal = product(M.T, M) + 1e-9 * WIDTH * WIDTH * np.eye(D + 1)
        fit = solve(normal, product(M.T, np.array(Y).reshape(len(M), -1)))[:D] if len(M) else np.zeros((D, 2))
        whole = [one for k, run in enumerate(point.runs) if (one := self.walked(run, self.walking, k)) is not None]
        beyond = self._beyond(x, whole)
        drift = fit[:, 1:2] / BY_NAME["drift"].scale * [1.0, -1.0, 1.0, -1.0]
        here = self._apart(x)
        apart = np.array([self._apart(x + e) - here for e in 1e-4 * np.eye(D)]) / 1e-4
        slopes = np.hstack([fit[:, 2:], fit[:, 2:], drift, apart])
        return fit[:, 0] / self.unit, slopes, beyond


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
    """Make a gait vector cheaper in the worlds of `cost` and keep it to limits; see the module.

    starts: vectors (D,) of which the first that walks is begun with; None: the first gait.  `history` names a file of
    JSON lines, one a step, from which `resume` goes on to the same result; as in `search.minimize`.

    The result has x, fun (J/m in the worlds), nit (steps), nfev (walks), success, status (0, or 2 when interrupted),
    message, and history: arrays x (nit + 1, D), f, its cost in the worlds [J/m], and broken, the sum of squares of what
    passes limits, of the gait that each step ends with; tried: x and f of all gaits that were tried in all worlds.
    """
    instance("cost", cost, CostInWorlds, "give what in_worlds returns")
    steps = whole("steps", steps, 0, "it is a number of steps", 10**6)
    descent = _Descent(cost, watch)
    starts = [cost.gait.to_vector()] if starts is None else list(starts)
    log = _History(history, {"search": HISTORY, "version": 1, "seed": seed, "x0": starts[0].tolist()}, resume)
    status, message, path, tried, radius = 0, "all steps made", [], [], RADIUS
    bar = tqdm(total=steps, disable=not progress, unit="step", desc="within limits")
    try:
        point = _begun(descent, starts) if not log.lines else descent.judged(descent.points([log.x(0)])[0])
        descent.unit = point.cost if math.isfinite(point.cost) else 1.0
        path, tried = [(point.x, point.cost, point.broken)], [(point.x, point.cost)]
        if not log.lines:
            log.write(point, radius, [])
        for k, line in enumerate(log.lines[1:], start=1):
            path.append((log.x(k), line["f"], line["broken"]))
            radius = line["radius"]
            tried += [(np.array(one["x"], dtype=float), one["f"] or math.inf) for one in line["trials"]]
        if len(path) > 1:
            (point,) = descent.points([path[-1][0]])
            point = descent.judged(point)
        for k in range(len(path) - 1, steps if math.isfinite(point.cost) else 0):
            descent.price = min(PRICE * GROWS**k, LARGEST_PRICE)
            most = max(descent.priced(*last) for _, *last in path[-MEMORY:])
            trials, point, best = _stepped(descent, point, most, radius, (seed, k))
            tried += [(trial.x, trial.cost) for trial in trials]
            radius = min(max(radius * RADII[best], LEAST_RADIUS), LARGEST_RADIUS)
            path.append((point.x, point.cost, point.broken))
            log.write(point, radius, trials)
            bar.update(len(path) - 1 - bar.n)
            bar.set_postfix(cost=point.cost, broken=point.broken)
    except KeyboardInterrupt:
        status, message = 2, "interrupted; the last gait is returned"
    finally:
        bar.close()
        log.close()
    path = path or [(starts[0], math.inf, math.inf)]
    x, f, broken = (np.array(part) for part in zip(*path))
    each = {name: np.array(part) for name, part in zip("xf", zip(*(tried or [path[0][:2]])))}
    found = bool(np.isfinite(f[-1]))
    return OptimizeResult(
        x=x[-1], fun=float(f[-1]), nit=len(f) - 1,
        nfev=descent.walks, success=found and status == 0, status=status, message=message,
        history={"x": x, "f": f, "broken": broken}, tried=each,
    )  # fmt: skip


def _begun(descent: _Descent, starts: Sequence[np.ndarray]) -> _Point:
    """The first that walks in all worlds; the first where none does."""
    points = (descent.judged(descent.points([x])[0]) for x in starts)
    first = next(points)
    return first if math.isfinite(first.cost) else next((p for p in points if math.isfinite(p.cost)), first)


def _stepped(
    descent: _Descent, point: _Point, most: float, radius: float, seed: Sequence[int]
) -> tuple[list[_Point], _Point, float]:
    """The trials, the next gait, and which of `TRIALS` it was; the same gait and 0 if none costs less than `most`."""
    change = descent.step(point, radius, seed)
    trials = descent.points([np.clip(point.x + share * change, *descent.box.T) for share in TRIALS])
    for share, trial in sorted(zip(TRIALS, trials), key=lambda one: one[1].price):
        if trial.price < most and (trial := descent.judged(trial)).price < most:
            return trials, trial, share
    return trials, point, 0.0


class _History:
    """The steps as JSON lines: a header, then a line for the start and each step; without a path nothing is kept."""

    def __init__(self, path: str | os.PathLike[str] | None, header: dict[str, Any], resume: bool) -> None:
        self.lines: list[dict[str, Any]] = []  # of the start and the steps that were made before
        self._file = None if path is None else LineFile(Path(path), resume)
        if self._file is None:
            return
        remedy = "resume with the settings it was begun with, or delete it"
        try:
            found = [parse_json(line, f"{path}, line {k}", remedy) for k, line in enumerate(self._file.lines, start=1)]
            if found and found[0] != header:
                raise ValueError(f"{path}, line 1: the history is of another search; {remedy}")
            self.lines = found[1:]
            if not found:
                self._file.write(header)
        except BaseException:
            self._file.close()
            raise

    def x(self, k: int) -> np.ndarray:
        """Return the gait that step k ended with."""
        return np.array(self.lines[k]["x"], dtype=float)

    def write(self, point: _Point, radius: float, trials: Sequence[_Point]) -> None:
        """Write a step."""
        if self._file is not None:
            number = lambda value: value if math.isfinite(value) else None  # noqa: E731
            each = [{"x": one.x.tolist(), "f": number(one.cost)} for one in trials]
            f, broken = number(point.cost), number(point.broken)
            self._file.write({"x": point.x.tolist(), "f": f, "broken": broken, "radius": radius, "trials": each})

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()


def _typical(beyond: np.ndarray) -> np.ndarray:
    """Of strides (strides, m) what a step counts on (m,): their mean and a standard deviation."""
    mean = total(beyond, axis=0) / len(beyond)
    off = beyond - mean
    return mean + SPREAD * np.sqrt(total(off * off, axis=0) / len(beyond))


def _hadamard(least: int) -> np.ndarray:
    """Sylvester's matrix of +1 and -1 with orthogonal columns, of at least so many rows; the first column is one."""
    H = np.ones((1, 1))
    while len(H) < least:
        H = np.block([[H, H], [H, -H]])
    return H


def _best(slope: np.ndarray, slopes: np.ndarray, beyond: np.ndarray, price: float, radius: float) -> np.ndarray:
    """Minimize slope d + price |max(0, beyond + slopes' d)|^2 + damping |d|^2, damped so that no |d_i| > radius."""
    d, damping = np.zeros(len(slope)), 1e-3
    for _ in range(40):
        for _ in range(25):
            v = beyond + applied(slopes.T, d) if len(beyond) else beyond
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
