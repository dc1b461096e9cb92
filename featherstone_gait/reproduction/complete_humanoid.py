"""The gait of the complete humanoid, arms included.

The paper optimizes a simplified humanoid, ten joints of the legs, and names the complete model as future work.  Here it
is searched in the same way: four poses of all 19 joints, by adaptive simulated annealing.  The nine joints that the
simplified robot locks are servos, which the planned walk keeps at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from ..base.progress import progress_bar
from ..optimize.planning import walking_cost
from ..optimize.quality import Quality, measure_quality
from ..optimize.search import optimize_gait
from ..robot_file import load_robot
from ..view.style import ORANGE, look
from .claim import Claim, classify, span
from .common import subplots
from .walks import finished


@dataclass(frozen=True)
class CompleteHumanoidSettings:
    """Numbers of iterations and searches."""

    iterations: int  # of each search
    searches: int  # by different seeds


QUICK = CompleteHumanoidSettings(iterations=150, searches=2)
FULL = CompleteHumanoidSettings(iterations=800, searches=3)


@dataclass(frozen=True, eq=False)
class CompleteHumanoidResult:
    settings: CompleteHumanoidSettings
    joints: tuple[str, ...]
    best: np.ndarray  # (searches, iterations + 1) least cost so far [J/m]
    first: Quality  # of the planned gait
    found: tuple[Quality, ...]  # of the gaits found

    @property
    def gains(self) -> np.ndarray:
        """Return by how much each search changes the cost (searches,)."""
        return self.best[:, -1] / self.best[:, 0] - 1.0


def run(settings: CompleteHumanoidSettings = QUICK, seed: int = 0, progress: bool = False) -> CompleteHumanoidResult:
    """Run the searches, seeded by `seed` and the numbers that follow."""
    cost, n = walking_cost(load_robot("humanoid")), settings.iterations
    seeds = progress_bar(range(seed, seed + settings.searches), progress=progress, unit="search")
    results = [finished(optimize_gait(cost, iterations=n, seed=k, no_progress=n)) for k in seeds]
    first, *found = (measure_quality(cost, x) for x in (cost.gait.to_vector(), *(result.x for result in results)))
    best = np.array([np.minimum.accumulate(result.history["f"]) for result in results])
    return CompleteHumanoidResult(settings, cost.gait.joint_names, best, first, tuple(found))


def check(result: CompleteHumanoidResult) -> list[Claim]:
    """Return the claim: reproduced if all gaits walk, also at a quarter of the step, and those found are cheaper."""
    qualities = (result.first, *result.found)
    walks = all(m.status == "ok" for q in qualities for m in (q.measures, q.finer))
    fine = [q.finer.cost / q.measures.cost - 1.0 for q in qualities]
    return [
        Claim(
            claim="The complete humanoid walks and its gait can be optimized",
            item="Section 6",
            paper="",
            ours=f"{len(result.joints)} joints, {4 * len(result.joints)} angles: {result.best[0, 0]:.1f} J/m as "
            f"planned, {span(result.best[:, -1], '.1f')} J/m after {result.settings.iterations} iterations "
            f"({span(result.gains, '+.0%')})",
            holds=True,
            verdict=classify(walks and (result.gains < 0.0).all()),
            why="Rule: the planned gait and all gaits found walk, also at a quarter of the step, and all are cheaper. "
            f"A quarter of the step changes the cost by {span(fine, '+.1%')}",
        )
    ]


@look()
def plot(result: CompleteHumanoidResult) -> dict[str, Figure]:
    """Draw the searches."""
    figure, axes = subplots(7.0, 4.0)
    axes.plot(result.best.T, color=ORANGE, linewidth=0.7, alpha=0.6)
    axes.plot(np.median(result.best, axis=0), color=ORANGE, linewidth=2.2)
    axes.set(xlabel="iteration", ylabel="energy per distance [J/m]", xlim=(0, result.settings.iterations))
    axes.set_ylim(bottom=0.0)
    return {"Energy per distance of the best gait so far: each search, and their median (thick).": figure}
