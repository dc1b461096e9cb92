"""Selection of a gait: the best candidates of a search are measured again, in worlds of their own.

A search measures a gait in eight worlds for eight strides, and what is best there is partly luck.  The best few are
therefore measured in 16 other worlds, for 20 strides and at a quarter of the time step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult

from ..base.progress import progress_bar
from ..walking.cost import WalkingCost
from ..walking.cost_in_worlds import in_worlds
from ..walking.feedback import BalancedWalk
from ..walking.limits import Watch
from .feedback import search_feedback
from .planning import Start
from .preparation import Job, beside
from .quality import FINER, TEST_STRIDES, measure_limits_of_each

BEST, WORLDS, SEED = 6, 16, 5 * 10**5  # gaits measured again, in how many worlds, drawn with which seed


class Selected(NamedTuple):
    """The gait that a search ends with."""

    x: np.ndarray  # (D,) [rad]
    walk: BalancedWalk | None  # the gait with feedback, if that was searched
    candidates: list[dict[str, Any]]  # those that were measured again


def select(job: Job, start: Start, result: OptimizeResult) -> Selected:
    """Select the gait of a search that was not interrupted and, if asked for, search its feedback."""
    options, cost, x = job.options, start.cost, result.x
    candidates: list[dict[str, Any]] = []
    if result.status == 2:
        return Selected(x, None, candidates)
    if "limited" in result:
        x, candidates = choose_gait(cost, start.watch, result.limited.tried, progress=options.progress)
    if not options.feedback:
        return Selected(x, None, candidates)
    worlds = in_worlds(replace(cost, gait=cost.gait.from_vector(x)), options.worlds)
    found = search_feedback(
        worlds, iterations=options.iterations // 2, seed=options.seed, history=beside(job.history, "feedback"),
        resume=options.resume, progress=options.progress,
    )  # fmt: skip
    return Selected(found.x_poses, found.walk, candidates)


def choose_gait(
    cost: WalkingCost, watch: Watch, tried: Mapping[str, np.ndarray], best: int = BEST, progress: bool = False
) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """Choose among the gaits that a descent tried; return the gait vector and the candidates that were compared.

    Compared are the `best` gaits that meet the most limits on the robot's own ground, among equals those with the least
    cost in the worlds of the search.  Among gaits that fail in at most one of the 16 worlds, the one that meets the
    most limits is chosen; among equals the one that walks in more worlds, then the one with the least cost there.
    """
    walking = [k for k, value in enumerate(tried["f"]) if math.isfinite(value)]
    limits = measure_limits_of_each(cost, [tried["x"][k] for k in walking], watch)
    met = {k: sum(one["kept"] for one in found["limits"] or []) for k, found in zip(walking, limits)}  # 0 if it falls
    order = sorted(met, key=lambda k: (-met[k], tried["f"][k]))[:best]
    worlds = in_worlds(replace(cost, strides=TEST_STRIDES), WORLDS, SEED, timestep=FINER * cost.scene.timestep)
    rows: list[dict[str, Any]] = []
    for k in progress_bar(order, desc=f"selection in {WORLDS} worlds", unit="gait", progress=progress):
        walks, price = worlds.verified(tried["x"][k])
        rows.append({"candidate": k, "searched": float(tried["f"][k]), "kept": met[k], "walks": walks, "cost": price})
    first = min(rows, key=lambda row: (row["walks"] < 1.0 - 1.0 / WORLDS, -row["kept"], -row["walks"], row["cost"]))
    return tried["x"][int(first["candidate"])], rows
