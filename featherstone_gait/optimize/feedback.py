"""Search for the feedback of a gait: its gains, and its poses with them, in worlds and under pushes.

    found = search_feedback(in_worlds(cost, 8), iterations=400)
    scene, walk = cost.scene, found.walk
    simulate(scene, walk.begin(20), reference=walk.reference(20), controller=walk.controller(scene))

`walking/feedback.py` has the control law, `walking/feedback_cost.py` the cost.
"""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import Any

from scipy.optimize import OptimizeResult

from ..base.arguments import instance, whole
from ..search import minimize
from ..walking.cost import WalkingCost
from ..walking.cost_in_worlds import CostInWorlds
from ..walking.disturbed import pushes_survived
from ..walking.feedback import NONE, SENSORS, BalancedWalk, Feedback, Imu, generic_feedback
from ..walking.feedback_cost import FeedbackCost

POSES = math.radians(0.3)  # amplitude of the poses, which a search without feedback has found before [rad]
BATCH = 16


def search_feedback(
    cost: CostInWorlds,
    *,
    first: Feedback | None = None,
    imu: Imu = SENSORS,
    poses: bool = True,
    iterations: int = 400,
    seed: int = 0,
    **how: Any,
) -> OptimizeResult:
    """Search for feedback gains, and with `poses` for key poses too, by annealing.

    Parameters
    ----------
    cost : CostInWorlds
        The cost of the gait that the search starts from.
    first : Feedback, optional
        Gains that the search starts from; by default those of `generic_feedback`.  Where no feedback but that of the
        heading does better, it starts there.
    imu : Imu
        The sensors.
    poses : bool
        Whether the key poses are searched too.
    iterations : int
        Number of candidates.
    seed : int
        Seed of the search.
    **how
        Further arguments of `search.minimize`: history, resume, progress.

    Returns
    -------
    scipy.optimize.OptimizeResult
        Of `search.minimize`; added are walk, the `BalancedWalk` that was found, and x_poses (D,), its poses as a gait
        vector [rad].

    Raises
    ------
    ValueError
        If neither the gait with `first` nor a candidate walks in all worlds.
    """
    instance("cost", cost, CostInWorlds, "give what in_worlds returns")
    iterations = whole("iterations", iterations, 0, "it is a number of candidates")
    first = generic_feedback(cost.scene.model) if first is None else first
    instance("first", first, Feedback, "give Feedback(...), or None")
    price = FeedbackCost(cost, imu, poses)
    starts = [price.vector(one) for one in (first, replace(NONE, heading=first.heading))]
    costs = [value for value, _ in price.costs(starts)]
    result = minimize(
        price, starts[costs.index(min(costs))], amplitude=price.amplitude(POSES), max_iterations=iterations, seed=seed,
        bounds=price.bounds, map=FeedbackCost.costs, batch=BATCH, **how,
    )  # fmt: skip
    (walk,) = price.walks([result.x])
    if walk is None or not math.isfinite(result.fun):
        raise ValueError(f"{cost.scene.model.name}: no gait with feedback walks in all worlds; search the gait longer")
    result.walk = walk
    result.x_poses = result.x[: len(cost.gait.to_vector())] if poses else cost.gait.to_vector()
    return result


def report_feedback(cost: WalkingCost, walk: BalancedWalk, worlds: int) -> dict[str, Any]:
    """Report the gains, the sensors, and the pushes that the gait survives with feedback and without [N s]."""
    with_it, without = (pushes_survived(cost.scene, walk, worlds, feedback=on) for on in (True, False))
    return {
        "gains": asdict(walk.feedback), "imu": asdict(walk.imu),
        "pushes": {"with": with_it.tolist(), "without": without.tolist()},
    }  # fmt: skip
