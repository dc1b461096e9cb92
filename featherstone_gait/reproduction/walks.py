"""The humanoid's planned walk, and what several experiments do with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import OptimizeResult

from ..core.effects.energies import METER
from ..model import Model
from ..optimize.planning import walking_cost
from ..robot_file import load_robot
from ..run.trajectory import Trajectory
from ..walking.cost import WalkingCost
from ..walking.gait import TICK


def planned_walk(**how: Any) -> WalkingCost:
    """Plan the walk of the paper's ten-joint humanoid; how: options of `walking_cost`."""
    return walking_cost(load_robot("humanoid", locked="simplified"), **how)


def recompiled(cost: WalkingCost, model: Model | None = None, **arguments: Any) -> WalkingCost:
    """Return the walk with another model or other arguments of `compile_scene`."""
    return replace(cost, scene=cost.scene.recompiled(model, **arguments))


def finished(result: OptimizeResult) -> OptimizeResult:
    """Return the result of a search; raise KeyboardInterrupt if the search was interrupted."""
    if result.status == 2:
        raise KeyboardInterrupt
    return result


def cycle_marks(cost: WalkingCost) -> np.ndarray:
    """Return the samples, `TICK` apart, at which the measured gait cycles begin and end (strides + 1,)."""
    return np.round((cost.mark + np.arange(cost.strides + 1) * cost.gait.period) / TICK).astype(int)


def cycle_energies(cost: WalkingCost, runs: Sequence[Trajectory]) -> np.ndarray:
    """Return the energy of each run and measured gait cycle (runs, strides) [J]; NaN for runs that fell."""
    marks = cycle_marks(cost)
    energies = np.stack([np.diff(run["energy"][marks, :, METER].sum(axis=1)) for run in runs])
    energies[[run.status in ("fell", "diverged") for run in runs]] = np.nan
    return energies
