"""One floor: a motion in MuJoCo, and here on ground with the same penetration and friction."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

from ..model import Ground
from ..run.simulate import simulate, standing_state
from ..scene.compile import CompiledScene
from ..walking.cost import SAMPLE, Measures, measured
from ..walking.feedback import BalancedWalk
from ..walking.motion import Motion
from .in_mujoco import TIMESTEP, Floor, replay, sinking, standing

WARM_UP = 2  # strides before those that are measured
STRIDES = 20
FLOORS = {  # by name; time constants [s] from the stiffest that steps of 0.5 ms allow to MuJoCo's default
    f"{1e3 * time_constant:g}ms_{friction:g}": (time_constant, friction)
    for time_constant in (2e-3, 5e-3, 1e-2, 2e-2)
    for friction in (0.6, 0.9, 1.2)
}


@dataclass(frozen=True)
class WalkResult:
    """A motion's walk on one floor.

    Attributes
    ----------
    measures : Measures
        Measures of the strides after the first two; without a cost if the robot fell.
    end : float
        Time at which it fell, or had walked all strides [s].
    """

    measures: Measures
    end: float

    @property
    def walks(self) -> bool:
        """True if it walked all strides forward."""
        return math.isfinite(self.measures.cost)

    def as_dict(self) -> dict[str, float | str | bool | None]:
        """Return the values for JSON."""
        keys = ("status", "cost", "speed", "stride_length", "sideways", "energy", "distance")
        found = self.measures.as_dict()
        return {"walks": self.walks, "end": round(self.end, 9)} | {key: found[key] for key in keys}


@dataclass(frozen=True)
class Outcome:
    """A motion's walks on one floor, in MuJoCo and here.

    Attributes
    ----------
    floor : Floor
        The floor.
    sinking : float
        Penetration of the contact points under the robot's weight, in MuJoCo and here [m].
    mujoco, own : WalkResult
        The walks in MuJoCo and here.
    """

    floor: Floor
    sinking: float
    mujoco: WalkResult
    own: WalkResult

    def as_dict(self) -> dict:
        """Return the values for JSON."""
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
    """Walk a motion on a floor in MuJoCo, and here on ground with the same friction and penetration.

    Parameters
    ----------
    scene : CompiledScene
        The robot with its servos.
    motion : Motion or BalancedWalk
        The gait.
    floor : Floor
        The floor.
    strides : int
        Number of measured strides, after two others.
    timestep : float
        Time step of both engines [s]; here that of the midpoint rule.

    Returns
    -------
    Outcome
        The walks.

    Raises
    ------
    ImportError, ValueError
        As `replay`; ValueError for a robot that does not stand.
    """
    reference = motion.reference(WARM_UP + strides)
    angles, end = reference.values[0], motion.begin(WARM_UP + strides)
    depth = sinking(scene, angles, floor, timestep=timestep)
    acts = motion.controller(scene) if isinstance(motion, BalancedWalk) else None
    run = replay(scene, end, standing(scene, angles, depth), reference, floor, timestep=timestep, controller=acts)
    ground = replace(scene.ground or Ground(), friction=floor.friction, penetration=depth)
    own = scene.recompiled(ground=ground, integrator="midpoint", timestep=timestep)
    state, record = standing_state(own, angles, allow_limit_violation=True), ("base_q", "energy")
    here = simulate(
        own, end, state, reference, record=record, record_interval=SAMPLE, estimate_error=False, controller=acts
    )
    start = motion.begin(WARM_UP)
    walks = (WalkResult(measured(scene, each, start, end, strides, slip=False), each.end_time) for each in (run, here))
    return Outcome(floor, depth, *walks)
