"""What a gait is worth: measured finer, disturbed, in other worlds, against what a real robot asks for, and for longer.

A search measures a gait in eight worlds for eight strides, and what is best there is partly luck.  `chosen` therefore
looks at the best few again, in worlds of their own, for longer and at a quarter of the step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from tqdm import tqdm

from ..core.effects.energies import METER
from . import limits
from .cost import SAMPLE, Measures, WalkingCost
from .cost_in_worlds import in_worlds
from .feedback import BalancedWalk
from .limits import Watch

PERTURBED, PERTURBATION = 63, math.radians(1.0)  # gaits that tell how safe one is, and how far theirs are off [rad]
UNSEEN, UNSEEN_SEED = 200, 10**6  # worlds that tell what a gait is worth elsewhere, and what they are drawn with
UNSEEN_STRIDES = 20
BEST, CHECKED, CHECKED_SEED = 6, 16, 5 * 10**5  # gaits looked at again, in how many worlds, drawn with what
FINER = 0.25  # of the step
STANDBY = 0.05  # current of a servo's electronics, of an AX-12 [A]


@dataclass(frozen=True)
class Quality:
    """A gait's measures, and how far they are to be trusted."""

    measures: Measures
    finer: Measures  # at a quarter of the step
    safe: float  # share of the gaits with all angles off by up to 1 degree that walk as many strides

    def as_dict(self) -> dict:
        """For JSON."""
        return self.measures.as_dict() | {"at_a_quarter_of_the_step": self.finer.as_dict(), "safe": self.safe}


def quality(cost: WalkingCost, x: np.ndarray) -> Quality:
    """Measure a gait vector, also at a quarter of the step and with its angles off."""
    fine = cost.scene.recompiled(timestep=FINER * cost.scene.timestep)
    off = np.random.Generator(np.random.PCG64(0)).uniform(-PERTURBATION, PERTURBATION, (PERTURBED, len(x)))
    measures, *others = cost.measure([x, *(x + off)])
    safe = sum(other.status == "ok" for other in others) / PERTURBED
    return Quality(measures, replace(cost, scene=fine).measure([x])[0], safe)


def worth_elsewhere(
    cost: WalkingCost, gaits: Sequence[np.ndarray | BalancedWalk], count: int = UNSEEN, progress: bool = False
) -> list[dict[str, Any]]:
    """What each gait vector, or gait with feedback, does in worlds that no search has seen.

    It walks 20 strides at a quarter of the step.  Of each a dict: "walks", the share of the worlds in which it gets
    through; "cost" [J/m] and "speed" [m/s], their 5th, 50th and 95th percentile where it walks; "sideways", the largest
    drift over the way [-], and "mean_sideways", their mean with its sign; None: it walks nowhere.  "each": the cost in
    each world [J/m], None where it falls.
    """
    longer = replace(cost, strides=UNSEEN_STRIDES)
    others = in_worlds(longer, count, UNSEEN_SEED, timestep=FINER * cost.scene.timestep)
    bar = tqdm(gaits, desc=f"{count} other worlds", unit="gait", disable=not progress)
    return [_spread_of(others.measure([x])[0]) | {"worlds": count, "strides": UNSEEN_STRIDES} for x in bar]


def _spread_of(measures: Sequence[Measures]) -> dict[str, Any]:
    walks = [one for one in measures if one.status == "ok"]
    each = [one.cost if one.status == "ok" else None for one in measures]
    told: dict[str, Any] = {"walks": len(walks) / len(measures), "each": each}
    told |= dict.fromkeys(("cost", "speed", "sideways", "mean_sideways"))
    if walks:
        for name in ("cost", "speed"):
            told[name] = np.percentile([getattr(one, name) for one in walks], (5, 50, 95)).tolist()
        drifts = [one.sideways / one.distance for one in walks]
        told["sideways"], told["mean_sideways"] = max(map(abs, drifts)), math.fsum(drifts) / len(drifts)
    return told


def chosen(
    cost: WalkingCost, watch: Watch, history: Mapping[str, np.ndarray], best: int = BEST, progress: bool = False
) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """Of the gaits that a descent tried the one that keeps most limits and does best in other worlds, and its rivals.

    Looked at are those that keep most limits on the robot's own floor, among equals those that cost least in the worlds
    of the search.  Of these counts first whether a gait walks in all of the worlds but one, then the limits, then the
    share of the worlds, then its cost there, as a search is told it.
    """
    walking = [k for k, searched in enumerate(history["f"]) if math.isfinite(searched)]
    kept = {k: _kept(cost, history["x"][k], watch) for k in walking}
    order = sorted(kept, key=lambda k: (-kept[k], history["f"][k]))[:best]
    longer = replace(cost, strides=UNSEEN_STRIDES)
    others = in_worlds(longer, CHECKED, CHECKED_SEED, timestep=FINER * cost.scene.timestep)
    rows: list[dict[str, Any]] = []
    for k in tqdm(order, desc=f"{CHECKED} worlds to choose in", unit="gait", disable=not progress):
        walks, price = others.verified(history["x"][k])
        rows.append(
            {"candidate": k, "searched": float(history["f"][k]), "kept": kept[k], "walks": walks, "cost": price}
        )
    first = min(rows, key=lambda row: (row["walks"] < 1.0 - 1.0 / CHECKED, -row["kept"], -row["walks"], row["cost"]))
    return history["x"][int(first["candidate"])], rows


def _kept(cost: WalkingCost, x: np.ndarray, watch: Watch) -> int:
    """How many limits a gait keeps on the robot's own floor; none if it falls."""
    return sum(one["kept"] for one in plausible(cost, x, watch)["limits"] or [])


def plausible(cost: WalkingCost, x: np.ndarray, watch: Watch) -> dict[str, Any]:
    """The worst value of each limit on the robot's own floor, where and when; and the currents there.

    "current": peak [A] of a motor, with its joint and time [s], root mean square of that motor, and mean and peak of
    what all servos together draw from their supply [A]; None for servos without motors.
    """
    run = cost.simulate([x], record=(*limits.RECORD, "voltage"), sample=SAMPLE)[0]
    if not run.ok:
        return {"status": run.message, "limits": None, "current": None}
    first, last = np.searchsorted(run["time"], [cost.mark - 1e-9, cost.end - 1e-9])
    window = slice(first, last + 1)
    found = watch.worst(cost.scene, run, window)
    told: dict[str, Any] = {"status": "ok", "limits": [one.as_dict() for one in found], "current": None}
    names = [name for name in cost.scene.model.joint_names if name in cost.scene.model.servos]
    if any(one.name == "line" for one in found):
        I, times = np.abs(run["current"][window]), run["time"][window]
        row, joint = np.unravel_index(I.argmax(), I.shape)
        volts = np.array([cost.scene.model.servos[name].voltage_limit for name in names])
        drawn = np.maximum(run["voltage"][window] * run["current"][window], 0.0) / volts
        told["current"] = {
            "peak": float(I[row, joint]), "where": names[joint], "time": float(times[row]),
            "rms": float(np.sqrt((I[:, joint] ** 2).mean())), "drawn_mean": float(drawn.sum(axis=1).mean()),
            "drawn_peak": float(drawn.sum(axis=1).max()),
            "energy_by_joint": dict(zip(names, _energy(run, first, last, cost))),
        }  # fmt: skip
    return told


def _energy(run: Any, first: int, last: int, cost: WalkingCost) -> list[float]:
    meter = run["energy"][last, :, METER] - run["energy"][first, :, METER]
    names = cost.scene.model.joint_names
    return [float(meter[names.index(name)]) for name in names if name in cost.scene.model.servos]


def with_standby(measures: Mapping[str, Any], watts: Mapping[str, float]) -> dict[str, float | None]:
    """Energy per distance [J/m] with each of some powers [W] that are drawn all the time."""
    told: dict[str, float | None] = {"motors": measures["cost"]}
    total = 0.0
    for name, power in watts.items():
        total += power
        known = measures["cost"] is not None and measures["speed"]
        told[name] = measures["cost"] + total / measures["speed"] if known else None
    return told
