"""One floor: whether a motion walks on it in MuJoCo, what that costs, and the same here on ground that sinks alike."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from ..model import Ground
from ..run.simulate import simulate, standing_state
from ..run.trajectory import Trajectory
from ..scene.compile import CompiledScene
from ..walking.cost import SAMPLE, Measures, measured
from ..walking.feedback import BalancedWalk
from ..walking.motion import Motion
from .in_mujoco import TIMESTEP, Floor, replay, sinking, standing

WARM_UP = 2  # strides before those that are measured
STRIDES = 20
FLOORS = {  # by name; time constants [s] from as stiff as steps of 0.5 ms and more see to MuJoCo's default
    f"{1e3 * time_constant:g}ms_{friction:g}": (time_constant, friction)
    for time_constant in (2e-3, 5e-3, 1e-2, 2e-2)
    for friction in (0.6, 0.9, 1.2)
}


@dataclass(frozen=True)
class Walk:
    """How a motion goes on one floor."""

    measures: Measures  # over the strides after the first two; without a cost if it fell
    end: float  # when it fell, or had walked all strides [s]

    @property
    def walks(self) -> bool:
        """Whether it walked all strides, forward."""
        return math.isfinite(self.measures.cost)

    def as_dict(self) -> dict[str, float | str | bool | None]:
        """For JSON."""
        keys = ("status", "cost", "speed", "stride_length", "sideways", "energy", "distance")
        found = self.measures.as_dict()
        return {"walks": self.walks, "end": round(self.end, 9)} | {key: found[key] for key in keys}


@dataclass(frozen=True)
class Outcome:
    """A motion on one floor, in MuJoCo and here."""

    floor: Floor
    sinking: float  # of the contact points under the robot's weight in MuJoCo [m], and of the ground here
    mujoco: Walk
    own: Walk

    def as_dict(self) -> dict:
        """For JSON."""
        return asdict(self.floor) | {
            "sinking": self.sinking, "mujoco": self.mujoco.as_dict(), "own": self.own.as_dict(),
        }  # fmt: skip


def walk_on(
    scene: CompiledScene,
    motion: Motion | BalancedWalk,
    floor: Floor,
    strides: int = STRIDES,
    timestep: float = TIMESTEP,
) -> Outcome:
    """Walk a motion on a floor of MuJoCo's and on ground of this package with its friction and sinking.

    Both with steps of `timestep` [s], here those of the midpoint rule, and with two strides before those measured.
    Raises as `replay`, and ValueError for a robot that does not stand.
    """
    reference = motion.reference(WARM_UP + strides)
    angles, end = reference.values[0], motion.begin(WARM_UP + strides)
    depth = sinking(scene, angles, floor, timestep=timestep)
    acts = motion.controller(scene) if isinstance(motion, BalancedWalk) else None
    run = replay(scene, end, standing(scene, angles, depth), reference, floor, timestep=timestep, controller=acts)
    ground = Ground(friction=floor.friction, penetration=depth)
    own = scene.recompiled(ground=ground, integrator="midpoint", timestep=timestep)
    state, record = standing_state(own, angles, allow_limit_violation=True), ("base_q", "energy")
    here = simulate(
        own, end, state, reference, record=record, record_interval=SAMPLE, estimate_error=False, controller=acts
    )
    return Outcome(floor, depth, *(_walk(scene, motion, each, strides) for each in (run, here)))


def _walk(scene: CompiledScene, motion: Motion | BalancedWalk, run: Trajectory, strides: int) -> Walk:
    times = motion.begin(WARM_UP), motion.begin(WARM_UP + strides)
    if run.ok:
        return Walk(measured(scene, run, *times, strides, slip=False), run.end_time)
    nan, weight = math.nan, scene.model.mass * math.hypot(*scene.gravity)
    return Walk(Measures(run.message, strides, nan, nan, nan, nan, nan, weight), run.end_time)
