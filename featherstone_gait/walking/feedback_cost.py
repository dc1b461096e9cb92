"""The cost of a gait with feedback, for a search of its gains and of its poses with them.

    price = cost in the worlds, with feedback and the sensors' noise,
            times 1 + WEIGHT * mean loss over the trials

A trial is a push or a slope.  Its loss is 0 if the robot stays up, else 1 less half of the share of the time for which
it did, so that a search gets credit for falling later.  Each push is in one of the worlds.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from os import cpu_count
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite
from ..base.brief import brief
from .cost import BatchCost, walk_runs
from .cost_in_worlds import NOT_EVERYWHERE, CostInWorlds, with_chatter
from .disturbed import AFTER, BEFORE, DIRECTIONS, PHASES, push_of_trunk
from .feedback import SENSORS, BalancedWalk, Feedback, Imu, feedback_of, size_of, undisturbed_of
from .gait import bounds
from .motion import motion_of

WEIGHT = 2.0
IMPULSES = (0.5, 0.7, 0.95)  # for a Bioloid; for other robots as hard [N s]
SLOPES = (-math.radians(3.5), math.radians(3.5))  # [rad]
SLOPE_STRIDES = 12
WIDEST = Feedback(100.0, 100.0, 100.0, 100.0, 100.0, 0.05, 100.0)  # largest gains, of a Bioloid
STEPS = Feedback(  # of a search; small for heading, about which ten strides say little
    ankle=1.0, foot=1.0, hip_rate=0.02, hasten=5.0, wait=5.0, quiet=0.003, heading=0.02,
)  # fmt: skip


class Trial(NamedTuple):
    """A disturbance."""

    world: int | None  # None: the robot's own ground at `slope`
    impulse: float  # for a Bioloid [N s]; 0: none
    direction: float  # [rad]
    phase: float  # of the stride
    slope: float  # [rad]


def trials() -> list[Trial]:
    """Return pushes from all sides, at all phases, of three sizes, and slopes."""
    pushes = [
        Trial(k % 8, impulse, 2.0 * math.pi * (k % DIRECTIONS) / DIRECTIONS, (k * 3 + n) % PHASES / PHASES, 0.0)
        for n, impulse in enumerate(IMPULSES)
        for k in range(8)
    ]
    return [*pushes, *(Trial(None, 0.0, 0.0, 0.0, slope) for slope in SLOPES)]


@dataclass(frozen=True, eq=False)
class FeedbackCost(BatchCost):
    """The price of vectors (D,): the poses [rad], if they are searched too, and the gains."""

    cost: CostInWorlds
    imu: Imu = SENSORS
    poses: bool = True
    weight: float = WEIGHT

    __repr__ = brief

    def vector(self, feedback: Feedback) -> np.ndarray:
        """Return the vector of the gait of `cost` with these gains."""
        poses = self.cost.gait.to_vector() if self.poses else np.empty(0)
        return np.concatenate([poses, feedback.to_vector()])

    def amplitude(self, poses: float) -> np.ndarray:
        """Return the step sizes of a search (D,); poses: that of the poses [rad]."""
        gains = STEPS.scaled(self._size[0]).to_vector()
        return np.concatenate([np.full(len(self._bounds_of_poses), poses), gains])

    @property
    def bounds(self) -> np.ndarray:
        """Lower and upper bounds (D, 2)."""
        widest = WIDEST.scaled(self._size[0]).to_vector()
        least = np.array([0.0 if one.name == "quiet" else -1.0 for one in fields(Feedback)])
        return np.concatenate([self._bounds_of_poses, np.column_stack([least * widest, widest])])

    @property
    def _size(self) -> tuple[float, float]:
        return size_of(self.cost.scene.model)

    @property
    def _bounds_of_poses(self) -> np.ndarray:
        return bounds(self.cost.scene.model, self.cost.gait) if self.poses else np.empty((0, 2))

    def walks(self, vectors: Iterable[ArrayLike]) -> list[BalancedWalk | None]:
        """Return the gait with feedback of each vector; None if it does not walk undisturbed."""
        own, gains = self.cost.cost, len(fields(Feedback))
        given = [finite("vector", x, (len(self.bounds),)) for x in vectors]
        gaits = [own.gait.from_vector(x[:-gains]) if self.poses else own.gait for x in given]
        motions = [motion_of(gait, own.start, own.blend_strides) for gait in gaits]
        if self.poses:
            tables = undisturbed_of(own.scene, motions, self.imu, own.gait.mirror is not None)
        else:
            tables = [self._undisturbed] * len(motions)
        return [
            None if table is None else BalancedWalk(motion, feedback_of(x[-gains:]), self.imu, table)
            for x, motion, table in zip(given, motions, tables)
        ]

    @functools.cached_property
    def _undisturbed(self) -> np.ndarray | None:
        own = self.cost.cost
        motion = motion_of(own.gait, own.start, own.blend_strides)
        return undisturbed_of(own.scene, [motion], self.imu, own.gait.mirror is not None)[0]

    def costs(self, vectors: Iterable[ArrayLike]) -> list[tuple[float, str]]:
        """Return price [J/m] and status of many vectors."""
        walks = self.walks(vectors)
        prices = iter(self.prices([walk for walk in walks if walk is not None]))
        return [(math.inf, "does not walk by itself") if walk is None else next(prices) for walk in walks]

    def prices(self, walks: Sequence[BalancedWalk]) -> list[tuple[float, str]]:
        """Return price [J/m] and status of each gait."""
        energy = [cost for cost, _ in self.cost.costs(walks)] if walks else []  # undisturbed
        stand = [k for k, cost in enumerate(energy) if math.isfinite(cost)]
        lost = np.zeros(len(walks))
        if stand:
            lost[stand] = self.lost([walks[k] for k in stand]).mean(axis=1)
        return [
            (cost * (1.0 + self.weight * share), "ok") if math.isfinite(cost) else (math.inf, NOT_EVERYWHERE)
            for cost, share in zip(energy, lost.tolist())
        ]

    def lost(self, walks: Sequence[BalancedWalk]) -> np.ndarray:
        """Return the loss of each gait in each trial (walks, trials), 0 to 1."""
        asked = trials()
        with ThreadPoolExecutor(cpu_count()) as pool:
            return np.stack([*pool.map(lambda k: self._lost_of(asked[k], walks, k), range(len(asked)))], axis=1)

    def _lost_of(self, trial: Trial, walks: Sequence[BalancedWalk], seed: int) -> np.ndarray:
        cost, motion = self.cost, walks[0].motion
        if trial.world is None:
            assert cost.scene.ground is not None
            ground = replace(cost.scene.ground, slope=trial.slope)
            scene, off, pushes = cost.scene.recompiled(ground=ground), 0.0 * cost.offsets[0], []
            end, strides, begin = motion.begin(SLOPE_STRIDES), SLOPE_STRIDES, motion.begin(0)
        else:
            world = trial.world % len(cost.scenes)
            scene, off = cost.scenes[world], cost.offsets[world]
            begin = motion.begin(BEFORE) + round(trial.phase * len(motion.stride)) * motion.tick
            pushes = [push_of_trunk(scene, trial.impulse * self._size[1], trial.direction, begin)]
            end, strides = begin + AFTER * motion.period, BEFORE + AFTER + 1
        runs = walk_runs(
            [scene] * len(walks), end, [walk.reference(strides) for walk in walks], off, pushes=pushes,
            record=("base_q",), record_interval=motion.tick,
            controller=[walk.controller(scene, seed) for walk in walks],
        )  # fmt: skip
        stood = [min(max((run.end_time - begin) / (end - begin), 0.0), 1.0) for run in runs]
        return np.array([0.0 if with_chatter(run).ok else 1.0 - 0.5 * share for run, share in zip(runs, stood)])
