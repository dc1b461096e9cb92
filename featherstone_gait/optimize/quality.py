"""Quality of a gait: measured at a finer step, disturbed, in test worlds, and against the limits of a real robot."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..base.progress import progress_bar
from ..core.effects.energies import METER
from ..run.trajectory import Trajectory
from ..walking import limits
from ..walking.cost import SAMPLE, Measures, WalkingCost, window_of
from ..walking.cost_in_worlds import in_worlds
from ..walking.feedback import BalancedWalk
from ..walking.limits import Watch

PERTURBED, PERTURBATION = 63, math.radians(1.0)  # number of perturbed gaits, and by how much their angles are off [rad]
TEST_WORLDS, TEST_SEED, TEST_STRIDES = 200, 10**6, 20
FINER = 0.25  # of the time step


@dataclass(frozen=True)
class Quality:
    """Measures of a gait, and how far they can be trusted.

    Attributes
    ----------
    measures : Measures
        On the robot's own ground.
    finer : Measures
        The same at a quarter of the time step.
    safe : float
        Share of the gaits with all angles off by up to 1 degree that walk as many strides.
    """

    measures: Measures
    finer: Measures
    safe: float

    def as_dict(self) -> dict:
        """Return the values for JSON."""
        return self.measures.as_dict() | {"at_a_quarter_of_the_step": self.finer.as_dict(), "safe": self.safe}


def describe(measures: Measures) -> str:
    """Describe the measures of a gait in a line."""
    if measures.status != "ok":
        return measures.status
    return f"{measures.cost:.1f} J/m, steps of {500.0 * measures.stride_length:.0f} mm, {1e3 * measures.speed:.0f} mm/s"


def measure_quality(cost: WalkingCost, x: np.ndarray) -> Quality:
    """Measure a gait vector (D,) [rad], also at a quarter of the time step and with its angles off."""
    fine = cost.scene.recompiled(timestep=FINER * cost.scene.timestep)
    off = np.random.Generator(np.random.PCG64(0)).uniform(-PERTURBATION, PERTURBATION, (PERTURBED, len(x)))
    measures, *others = cost.measure([x, *(x + off)])
    safe = sum(other.status == "ok" for other in others) / PERTURBED
    return Quality(measures, replace(cost, scene=fine).measure([x])[0], safe)


def measure_in_test_worlds(
    cost: WalkingCost, gaits: Sequence[np.ndarray | BalancedWalk], count: int = TEST_WORLDS, progress: bool = False
) -> list[dict[str, Any]]:
    """Walk gaits in worlds that no search has seen, for 20 strides at a quarter of the time step.

    Parameters
    ----------
    cost : WalkingCost
        The cost of the gaits on the robot's own ground.
    gaits : sequence of ndarray, shape (D,), or BalancedWalk
        Gait vectors [rad], or gaits with feedback.
    count : int
        Number of worlds.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    list of dict
        Of each gait: "walks", the share of the worlds in which it walks; "cost" [J/m] and "speed" [m/s], their 5th,
        50th and 95th percentile where it walks; "sideways", the largest sideways drift per distance [-], and
        "mean_sideways", its signed mean; None if it walks nowhere.  "each": the cost in each world [J/m], None where it
        falls.
    """
    longer = replace(cost, strides=TEST_STRIDES)
    worlds = in_worlds(longer, count, TEST_SEED, timestep=FINER * cost.scene.timestep)
    rows = []
    for x in progress_bar(gaits, desc=f"{count} other worlds", unit="gait", progress=progress):
        (measures,) = worlds.measure([x])
        walks = [one for one in measures if one.status == "ok"]
        each = [one.cost if one.status == "ok" else None for one in measures]
        found: dict[str, Any] = {"walks": len(walks) / len(measures), "each": each}
        found |= dict.fromkeys(("cost", "speed", "sideways", "mean_sideways"))
        if walks:
            for name in ("cost", "speed"):
                found[name] = np.percentile([getattr(one, name) for one in walks], (5, 50, 95)).tolist()
            drifts = [one.sideways / one.distance for one in walks]
            found["sideways"], found["mean_sideways"] = max(map(abs, drifts)), math.fsum(drifts) / len(drifts)
        rows.append(found | {"worlds": count, "strides": TEST_STRIDES})
    return rows


def measure_limits(cost: WalkingCost, x: np.ndarray, watch: Watch) -> dict[str, Any]:
    """Measure the limits of a real robot and the currents of a gait vector (D,) on the robot's own ground.

    Returns
    -------
    dict
        "status"; "limits", the worst value of each limit, where and when; "current": the peak [A] of a motor, with its
        joint and time [s], the root mean square of that motor, the mean and the peak of what all servos together draw
        from their supply [A], and the energy of each joint [J]; None for servos without motors.
    """
    return measure_limits_of_each(cost, [x], watch)[0]


def measure_limits_of_each(cost: WalkingCost, vectors: Sequence[np.ndarray], watch: Watch) -> list[dict[str, Any]]:
    """Do the same for many gait vectors, which walk in lanes."""
    runs = cost.simulate(vectors, record=(*limits.RECORD, "voltage"), record_interval=SAMPLE) if len(vectors) else []
    return [_limits_in(cost, run, watch) for run in runs]


def _limits_in(cost: WalkingCost, run: Trajectory, watch: Watch) -> dict[str, Any]:
    if not run.ok:
        return {"status": run.message, "limits": None, "current": None}
    window = window_of(run, cost.mark, cost.end)
    worst = watch.worst(cost.scene, run, window)
    current = _currents(cost, run, window) if any(one.name == "line" for one in worst) else None
    return {"status": "ok", "limits": [one.as_dict() for one in worst], "current": current}


def _currents(cost: WalkingCost, run: Trajectory, window: slice) -> dict[str, Any]:
    model = cost.scene.model
    names = [name for name in model.joint_names if name in model.servos]
    driven = [model.joint_rows[name] for name in names]
    I, times = np.abs(run["current"][window][:, driven]), run["time"][window]
    row, joint = np.unravel_index(I.argmax(), I.shape)
    volts = np.array([model.servos[name].voltage_limit for name in names])
    drawn = np.maximum(run["voltage"][window] * run["current"][window], 0.0)[:, driven] / volts
    meter = run["energy"][window, :, METER][[0, -1]]
    energy = dict(zip(model.joint_names, (meter[1] - meter[0]).tolist()))
    return {
        "peak": float(I[row, joint]), "where": names[joint], "time": float(times[row]),
        "rms": float(np.sqrt((I[:, joint] ** 2).mean())), "drawn_mean": float(drawn.sum(axis=1).mean()),
        "drawn_peak": float(drawn.sum(axis=1).max()), "energy_by_joint": {name: energy[name] for name in names},
    }  # fmt: skip


def with_standby(measures: Mapping[str, Any], watts: Mapping[str, float]) -> dict[str, float | None]:
    """Return the energy per distance [J/m] when powers [W] that are drawn all the time are added one by one."""
    costs: dict[str, float | None] = {"motors": measures["cost"]}
    total = 0.0
    for name, power in watts.items():
        total += power
        known = measures["cost"] is not None and measures["speed"]
        costs[name] = measures["cost"] + total / measures["speed"] if known else None
    return costs
