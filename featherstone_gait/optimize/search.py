"""The search of a gait: annealing for energy, then a descent that also meets the limits of a real robot.

The search is that of J. Lima et al., "Humanoid gait optimization resorting to an improved simulation model", Int. J.
Advanced Robotic Systems 10 (2013), section 4: forty joint angles, energy per distance.  Its perturbations are 1 degree
wide.  On seeds 0 to 3, 800 candidates of 0.7, 1, 1.5 and 2 degrees cut the humanoid's 65 J/m to 24, 24, 23 and 25 in
the mean (implicit Euler at 1 ms), but of the gaits found with 1 degree 83 % still walk with all angles off by up to a
degree, with 2 degrees 64 %; those of 3 degrees wander off sideways, those of 5 may fall at a finer step.  Gaits are
measured over 8 strides after 2: of 16 gaits that were optimized over 4 strides after 1, seven fall in the next.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import OptimizeResult

from ..run.simulate import streams
from ..search import minimize
from ..walking.cost import WalkingCost
from ..walking.cost_in_worlds import CostInWorlds
from ..walking.descent import WORK, descend
from ..walking.gait import bounds
from ..walking.limits import Watch
from .planning import Start
from .preparation import Job, beside
from .quality import measure_limits_of_each

AMPLITUDE = math.radians(1.0)  # of the search [rad]; see above
MAX_MISS = 20
BATCH = 16  # candidates evaluated at once where lanes cannot be at different times
MOST_MORE = 2  # times that a descent is prolonged by half of its steps while no gait keeps all limits
STARTS = 8  # of the cheapest candidates, that a descent may begin with
_log = logging.getLogger(__name__)


def search(job: Job, start: Start) -> OptimizeResult:
    """Search for a cheaper gait as the options say; raise ValueError if none walks."""
    options = job.options
    how: dict[str, Any] = {"seed": options.seed, "resume": options.resume, "progress": options.progress}
    if isinstance(start.searched, CostInWorlds) and options.limits:
        result = optimize_with_limits(start.searched, start.watch, job.history, iterations=options.iterations, **how)
    else:
        result = optimize_gait(start.searched, iterations=options.iterations, history=job.history, **how)
        _set_aside(job.history, result)
    if not np.isfinite(result.fun):
        cheapest = start.plan == "cheapest"
        other = "other numbers of the walk (--walk), or stronger servos if these are weak (--servo generic:4)"
        remedy = other if cheapest else "the cheapest plan (--plan cheapest)"
        raise ValueError(
            f"{job.model.name}: none of {result.nit + 1} gaits walked; the first: {start.failure}; "
            f"{start.unplanned or f'try {remedy}'}"
        )
    if result.status == 2:
        job.print("interrupted: measuring the best so far and writing the files; Ctrl-C again keeps only the history")
    return result


def optimize_gait(
    cost: WalkingCost | CostInWorlds,
    *,
    iterations: int = 800,
    seed: int = 0,
    amplitude: float = AMPLITUDE,
    max_miss: int = MAX_MISS,
    **how: Any,
) -> OptimizeResult:
    """Search for a cheaper gait by adaptive simulated annealing, within the joints' limits.

    Parameters
    ----------
    cost : WalkingCost or CostInWorlds
        The cost of gait vectors, in one world or in several at once (`walking.in_worlds`).
    iterations : int
        Number of candidates.
    seed : int
        Seed of the search.  The result depends on seed and settings alone, not on the number of cores or their load.
    amplitude : float
        Amplitude of the perturbations [rad].
    max_miss : int
        Misses after which the search widens again.
    **how
        Further arguments of `search.minimize`: history, resume, progress, callback.

    Returns
    -------
    scipy.optimize.OptimizeResult
        Of `search.minimize`: x (D,), the best gait vector [rad], for `cost.gait.from_vector`, and fun, its cost [J/m],
        infinite if no gait walks.  Added is occupancy, the share of the lane-steps that a candidate was in (nan with
        servos that are not sampled).  It depends on the machine, as do nfev and wasted.

    Raises
    ------
    ValueError, FileExistsError, OSError
        As `search.minimize`.
    """
    occupancy = [math.nan]
    if streams(cost.scene):
        how["evaluate"] = lambda candidates: occupancy.append(cost.evaluate(candidates))
    result = minimize(
        cost, cost.gait.to_vector(), amplitude=amplitude, max_miss=max_miss, max_iterations=iterations, seed=seed,
        bounds=bounds(cost.scene.model, cost.gait), map=type(cost).costs, batch=BATCH, **how,
    )  # fmt: skip
    result.occupancy = occupancy[-1]
    return result


def optimize_with_limits(
    cost: CostInWorlds, watch: Watch, history: Path, *, iterations: int = 800, **how: Any
) -> OptimizeResult:
    """Search half of the candidates for energy alone, then spend as much work on a descent that meets the limits.

    The descent (`walking.descent`) begins with the cheapest candidate that walks where runs with chatter are repeated.
    While none of the gaits that it tries keeps all limits on the robot's own ground, it makes half as many steps more,
    at most `MOST_MORE` times.  A search that is resumed with more iterations goes on to their half; the descent begins
    anew, from the gait that is the cheapest then, and the history of the old one is kept beside it as *.old.

    Parameters
    ----------
    cost : CostInWorlds
        The cost of gait vectors in several worlds.
    watch : Watch
        Measures the limited quantities.
    history : Path
        File of JSON lines of the first half; that of the second half is beside it.
    iterations : int
        Number of candidates; a step of the descent counts as 24.
    **how
        Further arguments of `optimize_gait`: seed, resume, progress.

    Returns
    -------
    scipy.optimize.OptimizeResult
        As of `optimize_gait`, with the gaits that the steps end with in history.  Added are limited, the result of the
        descent, and since, the index of its first gait; both are missing if the first half was interrupted or found
        nothing that walks, and if `iterations` is 0.

    Raises
    ------
    ValueError, FileExistsError, OSError
        As `optimize_gait`.
    """
    first = optimize_gait(cost, iterations=iterations // 2, history=history, **how)
    _set_aside(history, first)
    steps = (iterations - first.nit - 1) // WORK
    if steps < 0 or not first.success:
        return first
    order = np.argsort(first.history["f"], kind="stable")[:STARTS]
    starts = [first.history["x"][k] for k in order if np.isfinite(first.history["f"][k])]
    limited = beside(history, "limits")
    result = descend(cost, watch, starts, steps=steps, history=limited, **how)
    how["resume"], checked = True, 0
    for more in range(1, MOST_MORE + 1):
        tried = {key: values[checked:] for key, values in result.tried.items()}
        if not result.success or _keeps_all(cost, watch, tried):
            break
        checked += len(tried["f"])
        result = descend(cost, watch, starts, steps=steps + more * (steps // 2), history=limited, **how)
    both = {key: np.concatenate([first.history[key], result.history[key]]) for key in ("x", "f")}
    counts = {"nit": first.nit + WORK * result.nit, "nfev": first.nfev + -(-result.nfev // len(cost.scenes))}
    kept = {key: first[key] for key in ("wasted", "occupancy")} | {"since": first.nit + 1}
    return OptimizeResult({**result, **counts, **kept, "history": both, "limited": result})


def _set_aside(history: Path, result: OptimizeResult) -> None:
    """Set histories aside that began where a shorter search had ended, if this one has gone on from there."""
    if 0 < result.resumed < result.nit + 1:
        for old in (beside(history, "limits"), beside(history, "feedback")):
            if old.exists():
                kept = old.replace(old.with_name(f"{old.name}.old"))
                _log.warning(
                    "%s: it began where %d candidates had ended; the search is longer now, it begins anew, and the old "
                    "one is kept as %s", old, result.resumed - 1, kept.name,
                )  # fmt: skip


def _keeps_all(cost: CostInWorlds, watch: Watch, tried: Mapping[str, np.ndarray]) -> bool:
    """Check whether one of the gaits walks in all worlds and keeps all limits on the robot's own ground."""
    walking = tried["x"][np.isfinite(tried["f"])]
    measured = measure_limits_of_each(cost.cost, [*walking], watch)
    return any(found["limits"] is not None and all(one["kept"] for one in found["limits"]) for found in measured)
