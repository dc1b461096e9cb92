"""The cost of walking in several worlds at once, so that a search does not fit a gait to one floor.

    cost = walking_cost(load_robot("humanoid", locked="simplified"))
    result = optimize_gait(in_worlds(cost, 8), iterations=800)

A world is a floor, servos, link masses and a starting posture that may occur.  The cost of a gait is the mean over the
worlds plus half of what the worst world exceeds it by; a gait that does not walk in all of them has an infinite cost.
Worlds are simulated in the lanes of a vector; when one fails, the others are abandoned.

The penetration of floors under the robot's weight is 0.03 to 1 mm, evenly by the logarithm: gaits that walk on soft
floors may fall on stiff ones.  Servos differ by the usual scatter (docs/servos.md) in what their manual says least
about.
"""

from __future__ import annotations

import functools
import math
import threading
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, instance, listed, real, whole
from ..base.brief import brief
from ..run.reference import Reference
from ..run.simulate import simulate_stream, standing_state
from ..run.status import Status
from ..run.trajectory import Trajectory
from ..run.worlds import Worlds
from ..scene.compile import CompiledScene
from .cost import BatchCost, Measures, WalkingCost, measured, walk_runs
from .feedback import BalancedWalk
from .gait import TICK, Gait

if TYPE_CHECKING:
    from ..search.speculation import Candidate, Speculation

SINKING = (3e-5, 1e-3)  # [m]
FRICTION = (0.5, 1.2)  # of the ground [-]
DRY = 0.025  # dry friction of a servo beyond its own: up to this share of the torque of its motor at rest [-]
GAIN, SUPPLY, MASS = 0.1, 0.1, 0.1  # more or less: position gain and supply of all servos alike, mass of each link
BACKLASH = math.radians(0.5)  # up to, of gearboxes with a spring [rad]
START = math.radians(1.0)  # of each joint's first angle, to either side [rad]
MOST_WORLDS = 10**6
PENALTY = 0.5  # of what the worst world is above the mean
NOT_EVERYWHERE = "does not walk in every world"  # which one fails first may depend on the timing
RECORD = ("base_q", "energy")


@dataclass(frozen=True, eq=False)
class CostInWorlds(BatchCost):
    """The cost of gait vectors (D,) [rad] in several worlds, for `search.minimize`; made by `in_worlds`.

    Attributes
    ----------
    cost : WalkingCost
        The cost on the robot's own ground.
    scenes : sequence of CompiledScene
        The worlds; they differ in numbers alone.
    offsets : ndarray, shape (worlds, nj)
        Offsets of the joints at the start [rad].
    penalty : float
        Weight of what the worst world is above the mean.
    strict : bool
        Whether a run whose joint speeds chatter counts as a fall.
    """

    cost: WalkingCost
    scenes: Sequence[CompiledScene]
    offsets: np.ndarray
    penalty: float = PENALTY
    strict: bool = False

    __repr__ = brief

    def __post_init__(self) -> None:
        instance("cost", self.cost, WalkingCost, "give a WalkingCost")
        listed("scenes", self.scenes, "give scenes, as Worlds.scenes makes them")
        offsets = floats("offsets", self.offsets, "give angles [rad]")
        if offsets.shape != (len(self.scenes), len(self.gait.joint_names)):
            raise ValueError(
                f"offsets have the shape {offsets.shape}; expected ({len(self.scenes)}, {len(self.gait.joint_names)}), "
                "a row a world and a column a joint"
            )
        object.__setattr__(self, "offsets", offsets)
        real("penalty", self.penalty, 0.0, 1e6, "0 counts the mean alone")

    @property
    def scene(self) -> CompiledScene:
        """The robot on its own ground."""
        return self.cost.scene

    @property
    def gait(self) -> Gait:
        """The first gait."""
        return self.cost.gait

    def costs(self, gaits: Iterable[ArrayLike | BalancedWalk]) -> list[tuple[float, str]]:
        """Return cost [J/m] and status of many vectors, or of gaits with feedback."""
        return [self.combined([one.cost for one in found]) for found in self.measure(gaits)]

    def measure(self, gaits: Iterable[ArrayLike | BalancedWalk]) -> list[list[Measures]]:
        """Measure each gait in each world; all have feedback or none; the seed of the sensors is the world's number."""
        cost, n, given = self.cost, len(self.scenes), [*gaits]
        strides = cost.warm_up + cost.strides
        walks = [one for one in given if isinstance(one, BalancedWalk)]
        if walks and len(walks) < len(given):
            raise ValueError("some gaits have feedback and some have not; measure them separately")
        signals = [
            one.reference(strides) if isinstance(one, BalancedWalk) else cost.reference(one, strides) for one in given
        ]
        acts = [walk.controller(scene, k) for walk in walks for k, scene in enumerate(self.scenes)]
        runs = walk_runs(
            [*self.scenes] * len(signals), cost.end, [signal for signal in signals for _ in range(n)],
            [*self.offsets] * len(signals), record=RECORD, record_interval=TICK, controller=acts or None,
        )  # fmt: skip
        found = [self._measured(run, k % n) for k, run in enumerate(runs)]
        return [found[first : first + n] for first in range(0, len(found), n)]

    def evaluate(self, candidates: Speculation) -> float:
        """Evaluate the candidates of a search as `WalkingCost.evaluate` does, a world in each lane."""
        standing = functools.cache(lambda angles, k: self.standing(np.frombuffer(angles), k))
        runs = _WorldByWorld(candidates, self)

        def begin(key: tuple[_Evaluation, int]) -> tuple[np.ndarray, Reference, int]:
            signal, k = key[0].signal, key[1]
            return standing(signal.values[0].tobytes(), k), signal, k

        end = lambda run: run  # noqa: E731
        return simulate_stream(self.scenes, self.cost.end, runs, begin, end, record=RECORD, record_interval=TICK)

    def standing(self, angles: np.ndarray, k: int) -> np.ndarray:
        """Return the standing state in world k for a posture (nj,) [rad], to which the world's offsets are added."""
        return standing_state(self.scenes[k], angles + self.offsets[k], allow_limit_violation=True)

    def _measured(self, run: Trajectory, k: int) -> Measures:
        """Measure a run; speeds that chatter on a stiff floor are no fall unless `strict`: a finer step decides."""
        cost, run = self.cost, run if self.strict else with_chatter(run)
        return measured(self.scenes[k], run, cost.mark, cost.end, cost.strides, slip=False)

    def verified(self, x: ArrayLike) -> tuple[float, float]:
        """Return the share of the worlds in which a gait walks, and its combined cost in these [J/m]."""
        costs = [one.cost for one in self.measure([x])[0]]
        through = [cost for cost in costs if math.isfinite(cost)]
        return len(through) / len(costs), self.combined(through)[0] if through else math.inf

    def combined(self, costs: Sequence[float]) -> tuple[float, str]:
        """Combine the costs in the worlds [J/m] into the one that is minimized, and a status."""
        if not all(map(math.isfinite, costs)):
            return math.inf, NOT_EVERYWHERE
        mean = math.fsum(costs) / len(costs)
        return mean + self.penalty * (max(costs) - mean), "ok"


def with_chatter(run: Trajectory) -> Trajectory:
    """Return a run, as one that went well if joint speeds chattered and nothing else failed."""
    return replace(run, status=Status.OK, message="") if run.status == "chatter" else run


@dataclass(eq=False)
class _Evaluation:
    """A candidate that is being evaluated in all worlds."""

    candidate: Candidate
    signal: Reference
    costs: list[float] = field(default_factory=list)  # in the worlds that are known
    failed: bool = False


class _WorldByWorld:
    """Hand out the worlds of candidates one by one, and answer when a candidate's cost is known."""

    def __init__(self, candidates: Speculation, cost: CostInWorlds) -> None:
        self._candidates, self._cost = candidates, cost
        self._left: deque[tuple[_Evaluation, int]] = deque()
        self._lock = threading.Lock()

    def take(self, wait: bool = True) -> tuple[_Evaluation, int] | None:
        while True:
            with self._lock:
                while self._left:
                    key = self._left.popleft()
                    if self.wanted(key):
                        return key
            candidate = self._candidates.take(wait)
            if candidate is None:
                return None
            cost = self._cost.cost
            evaluation = _Evaluation(candidate, cost.reference(candidate.x, cost.warm_up + cost.strides))
            with self._lock:
                self._left.extend((evaluation, k) for k in range(len(self._cost.scenes)))

    def wanted(self, key: tuple[_Evaluation, int]) -> bool:
        return not key[0].failed and self._candidates.wanted(key[0].candidate)

    def give(self, key: tuple[_Evaluation, int], run: Trajectory) -> None:
        evaluation, k = key
        cost = self._cost._measured(run, k).cost
        with self._lock:
            answered = evaluation.failed
            evaluation.costs.append(cost)
            evaluation.failed = answered or not math.isfinite(cost)
            done = [*evaluation.costs]
        if answered or (len(done) < len(self._cost.scenes) and not evaluation.failed):
            return
        self._candidates.give(evaluation.candidate, self._cost.combined(done))

    def close(self) -> None:
        self._candidates.close()


def in_worlds(
    cost: WalkingCost, count: int, seed: int = 0, *, penalty: float = PENALTY, timestep: float | None = None
) -> CostInWorlds:
    """Return the cost in worlds drawn so that each number is spread evenly over its range (a Latin hypercube).

    Parameters
    ----------
    cost : WalkingCost
        The cost on the robot's own ground.
    count : int
        Number of worlds.
    seed : int
        Seed of the draws.
    penalty : float
        Weight of what the worst world is above the mean.
    timestep : float, optional
        Another time step than that of the cost's scene [s], at which a run with chatter counts as a fall.  On floors
        with a penetration below 0.1 mm the midpoint rule chatters at 1 ms: of three gaits in 128 worlds it finds 61 of
        the 70 falls found at a quarter of the step; implicit Euler, which damps the chatter, 47.

    Returns
    -------
    CostInWorlds
        The cost.
    """
    scene = cost.scene if timestep is None else cost.scene.recompiled(timestep=timestep)
    worlds, offsets = variations(scene, count, seed)
    return CostInWorlds(cost, worlds.scenes(scene), offsets, penalty, strict=timestep is not None)


def variations(scene: CompiledScene, count: int, seed: int = 0) -> tuple[Worlds, np.ndarray]:
    """Draw worlds and offsets of the joints at the start (count, nj) [rad].

    Each number is drawn once from each of `count` equal parts of its range.  Raises ValueError for a scene without
    ground or without servos that drive a motor.
    """
    count = whole("count", count, 1, "it is a number of worlds", MOST_WORLDS)
    generator = np.random.default_rng([whole("seed", seed, 0, "it is the seed of the draws"), count])

    def even(*shape: int) -> np.ndarray:
        ranks = generator.permuted(np.broadcast_to(np.arange(count)[:, None], (count, math.prod(shape))), axis=0)
        return ((ranks + generator.uniform(size=ranks.shape)) / count).reshape(count, *shape)

    model = scene.model
    names = [name for name in model.joint_names if name in model.servos]
    if scene.ground is None or not scene.sampled or not names:
        raise ValueError(
            f"{model.name}: worlds need ground and servos that drive motors; search without worlds (--one-world)"
        )
    servos = [model.servos[name] for name in names]
    stall = [s.gearbox.ratio * s.motor_constant * s.voltage_limit / s.resistance for s in servos]
    factor = lambda width, *shape: 1.0 + width * (2.0 * even(*shape) - 1.0)  # noqa: E731
    ground = {
        "penetration": SINKING[0] * (SINKING[1] / SINKING[0]) ** even(1)[:, 0],
        "friction": FRICTION[0] + (FRICTION[1] - FRICTION[0]) * even(1)[:, 0],
    }
    changed: dict[str, Any] = {
        "coulomb_friction": [s.coulomb_friction for s in servos] + DRY * even(1) * stall,
        "Kp": [s.controller.Kp for s in servos] * factor(GAIN, 1),
        "voltage_limit": [s.voltage_limit for s in servos] * factor(SUPPLY, 1),
    }
    if scene.gearbox == "mipsd":
        changed["backlash"] = [s.gearbox.backlash for s in servos] + BACKLASH * even(1)
    share = factor(MASS, len(model.links))
    links = {
        "mass": share * [link.mass for link in model.links],
        "inertia": share[:, :, None] * np.array([link.inertia for link in model.links]),
    }
    offsets = START * (2.0 * even(scene.tree.n) - 1.0)
    return Worlds(runs=count, ground=ground, servos=changed, links=links), offsets
