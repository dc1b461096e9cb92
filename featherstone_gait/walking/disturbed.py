"""Gaits under disturbance, with feedback or without: pushes in several worlds, slopes and rough ground.

A push acts on the trunk for 0.1 s at one of four phases of the stride; measured is the impulse at which half of the
robots fall, in each of eight directions.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from os import cpu_count
from types import NoneType

import numpy as np

from ..base.arguments import instance, real, truth, whole
from ..base.brief import brief
from ..core.effects.energies import METER
from ..model import Ground, HeightField
from ..run.simulate import Push, simulate, standing_state
from ..run.start import check_scene
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from .cost import walk_runs
from .cost_in_worlds import MOST_WORLDS, variations, with_chatter
from .feedback import BalancedWalk

PUSHED_FOR = 0.1  # [s]
BEFORE, AFTER = 1, 4  # strides before a push, and from it on
DIRECTIONS = 8
PHASES = 4
RATIO = 2.0**0.125  # of successive impulses
LEAST_IMPULSE, LEVELS = 0.05, 200  # the smallest impulse [N s], and how many there are
SEED = 3 * 10**5  # of the worlds


def push_of_trunk(scene: CompiledScene, impulse: float, direction: float, begin: float) -> Push:
    """Return a push of the root link with an impulse [N s] toward `direction` [rad] from x, from `begin` [s] on."""
    force = impulse / PUSHED_FOR
    along = (force * math.cos(direction), force * math.sin(direction), 0.0)
    return Push(scene.model.root, along, (0.0,) * 3, (0.0,) * 3, begin, begin + PUSHED_FOR)


def pushes_survived(
    scene: CompiledScene, walk: BalancedWalk, worlds: int = 8, *, feedback: bool = True, seed: int = SEED
) -> np.ndarray:
    """Find the pushes that a gait survives in half of the cases: four phases of the stride in each world.

    Bisection between impulses that differ by 9 % finds the largest one at which fewer than half fall.

    Parameters
    ----------
    scene : CompiledScene
        The robot on its own ground.
    walk : BalancedWalk
        The gait.
    worlds : int
        Number of worlds, drawn like those of a search.
    feedback : bool
        Whether the gait is played with its feedback.
    seed : int
        Seed of the worlds.

    Returns
    -------
    ndarray, shape (8,)
        Impulses [N s]: ahead, then in steps of 45 degrees to the left.
    """
    check_scene(scene)
    instance("walk", walk, BalancedWalk, "give what balanced returns")
    seed, feedback = whole("seed", seed, 0, "any number will do"), truth("feedback", feedback)
    worlds = whole("worlds", worlds, 1, "it is a number of worlds", MOST_WORLDS)
    drawn, offsets = variations(scene, worlds, seed)
    motion, scenes, tick = walk.motion, drawn.scenes(scene), scene.tick_steps * scene.timestep
    acts = [walk.controller(one, k) for k, one in enumerate(scenes)] if feedback else None

    def fall(impulse: float, direction: float) -> float:
        """Return the share of worlds and phases in which the robot falls; chatter on stiff floors is no fall."""
        runs: list[Trajectory] = []
        for k in range(PHASES):
            begin = motion.begin(BEFORE) + round(k / PHASES * motion.period / tick) * tick
            runs += walk_runs(
                scenes, begin + AFTER * motion.period, [motion.reference(BEFORE + AFTER + 1)] * worlds, offsets,
                pushes=[push_of_trunk(scene, impulse, direction, begin)], record=("base_q",),
                record_interval=motion.tick, controller=acts,
            )  # fmt: skip
        return sum(not with_chatter(run).ok for run in runs) / len(runs)

    def found(k: int) -> float:
        good, bad = -1, LEVELS
        middle = 24
        while bad - good > 1:
            stands = fall(LEAST_IMPULSE * RATIO**middle, 2.0 * math.pi * k / DIRECTIONS) < 0.5
            good, bad = (middle, bad) if stands else (good, middle)
            middle = min(good + 8, (good + bad + 1) // 2) if good >= 0 else bad // 2
        return LEAST_IMPULSE * RATIO**good if good >= 0 else 0.0

    with ThreadPoolExecutor(cpu_count()) as pool:
        return np.array([*pool.map(found, range(DIRECTIONS))])


def rough_field(
    height: float, seed: int = 0, *, length: float = 14.0, width: float = 6.0, spacing: float = 0.05
) -> HeightField:
    """Make rough ground, whose nodes have random heights between 0 and `height`.

    Parameters
    ----------
    height : float
        Largest height [m]; heights are uniform.
    seed : int
        Seed of the draws.
    length : float
        Extent along x, from a meter behind the origin [m]; beyond it the ground is level.
    width : float
        Extent along y, about the origin [m].
    spacing : float
        Distance between nodes [m].

    Returns
    -------
    HeightField
        The field, for `Ground`.
    """
    height = real("height", height, 0.0, 10.0, "0.003 is 3 mm")
    spacing = real("spacing", spacing, 1e-3, 10.0, "0.05 is half of a small robot's foot")
    nodes = [round(real(name, value, spacing, 1e4 * spacing, "give meters") / spacing) + 1
             for name, value in (("length", length), ("width", width))]  # fmt: skip
    draws = np.random.default_rng([whole("seed", seed, 0, "it is the seed of the heights"), *nodes])
    return HeightField(draws.uniform(0.0, height, nodes), (spacing, spacing), (-1.0, -0.5 * spacing * (nodes[1] - 1)))


@dataclass(frozen=True)
class LongWalk:
    """Measures of a long walk.

    Attributes
    ----------
    status : str
        "ok", or why it ended.
    strides : float
        Number of strides that were walked.
    distance : float
        Straight distance from the first stride to the last [m].
    energy : float
        Energy of the motors after the first two strides, per distance along the path of the strides [J/m].
    heading : float
        Largest deviation of a stride's mean heading from x [rad].
    path : ndarray, shape (strides, 3)
        Mean x, y [m] and heading [rad] of each stride.
    """

    status: str
    strides: float
    distance: float
    energy: float
    heading: float
    path: np.ndarray

    __repr__ = brief

    @property
    def walked(self) -> bool:
        """True if all strides were walked."""
        return self.status == "ok"


def walk_far(
    scene: CompiledScene,
    walk: BalancedWalk,
    ground: Ground | None = None,
    strides: int = 100,
    *,
    feedback: bool = True,
    seed: int = 0,
) -> LongWalk:
    """Walk many strides, on the scene's ground or another.

    Parameters
    ----------
    scene : CompiledScene
        The robot on its own ground.
    walk : BalancedWalk
        The gait.
    ground : Ground, optional
        Ground in place of the scene's.
    strides : int
        Number of strides.
    feedback : bool
        Whether the gait is played with its feedback.
    seed : int
        Seed of the sensors' noise.

    Returns
    -------
    LongWalk
        Its measures.
    """
    check_scene(scene)
    instance("walk", walk, BalancedWalk, "give what balanced returns")
    instance("ground", ground, (Ground, NoneType), "give Ground(...), or None for the scene's own")
    strides = whole("strides", strides, 1, "it is a number of strides", 10**6)
    seed, feedback = whole("seed", seed, 0, "any number will do"), truth("feedback", feedback)
    scene = scene if ground is None else scene.recompiled(ground=ground)
    motion, reference = walk.motion, walk.reference(strides)
    run = simulate(
        scene, motion.begin(strides), standing_state(scene, reference.values[0], allow_limit_violation=True), reference,
        record=("base_q", "energy"), record_interval=motion.tick, estimate_error=False,
        controller=walk.controller(scene, seed) if feedback else None,
    )  # fmt: skip
    n, first = len(motion.stride), len(motion.start)
    fallen = not with_chatter(run).ok
    done = (run.end_time - motion.begin(0)) / motion.period if fallen else float(strides)
    whole_strides = max(int(done), 0)
    q = run["base_q"][first : first + whole_strides * n]
    w, x, y, z = q[:, 3:].T
    turned = np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    path = np.stack([q[:, 0], q[:, 1], turned], axis=1).reshape(whole_strides, n, 3).mean(axis=1)
    meter = run["energy"][first : first + whole_strides * n, :, METER].sum(axis=1).reshape(whole_strides, n)[:, 0]
    way = float(np.linalg.norm(np.diff(path[2:, :2], axis=0), axis=1).sum()) if whole_strides > 3 else math.nan
    return LongWalk(
        run.message or "fell" if fallen else "ok", done,
        float(np.linalg.norm(path[-1, :2] - path[0, :2])) if whole_strides else 0.0,
        float(meter[-1] - meter[2]) / way if whole_strides > 3 else math.nan,
        float(np.abs(path[:, 2]).max()) if whole_strides else math.nan, path,
    )  # fmt: skip
