"""The paper's search against others at equal numbers of evaluations.

The paper uses adaptive simulated annealing without comparing it.  Here it searches the same forty angles as SciPy's
dual annealing and differential evolution and, if the package `cma` is installed, CMA-ES, from the same planned gait,
each several times.  An evaluation is a candidate that a search visits, including the first gait.

The paper's search and CMA-ES have the same amplitude, as perturbation and as standard deviation.  Differential
evolution starts from a population spread by this amplitude.  Dual annealing draws from a box around the planned gait,
because hardly any gait drawn from the joints' full range walks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..optimize.search import AMPLITUDE, MAX_MISS
from ..search import AdaptiveSimulatedAnnealing, cma_es, differential_evolution, dual_annealing, run_together
from ..search.ask_tell import Search
from ..view.style import COLORS as STYLE
from ..view.style import look
from ..walking.cost import WalkingCost
from ..walking.gait import bounds
from .claim import Claim, classify, question
from .common import draw_band, draw_marks, subplots
from .walks import finished, planned_walk, recompiled

PAPERS = "adaptive simulated annealing"
METHODS = (PAPERS, "CMA-ES", "dual annealing", "differential evolution")
BATCH = 32  # candidates at least that are evaluated at once
SIGNIFICANT = 0.05  # of a one-sided rank sum test


@dataclass(frozen=True)
class MethodSettings:
    """Lengths, numbers and widths of the searches."""

    evaluations: int  # of each search
    searches: int  # of each method, by different seeds
    amplitude: float = AMPLITUDE  # of the perturbations [rad], tuned for the paper's search
    box: float = 5.0 * AMPLITUDE  # either side of the planned gait, for dual annealing [rad]


QUICK = MethodSettings(evaluations=150, searches=2)
FULL = MethodSettings(evaluations=500, searches=10)


@dataclass(frozen=True, eq=False)
class MethodResult:
    settings: MethodSettings
    best: dict[str, np.ndarray]  # by method: (searches, evaluations) least cost so far [J/m]
    finer: dict[str, np.ndarray]  # by method: (searches,) cost of the gait found at a quarter of the step [J/m]
    missing: tuple[str, ...]  # methods whose package is not installed

    def costs(self, method: str) -> np.ndarray:
        """Return the costs of the gaits found (searches,) [J/m]."""
        return self.best[method][:, -1]


def run(settings: MethodSettings = QUICK, seed: int = 0, progress: bool = False) -> MethodResult:
    """Run all searches together, seeded by `seed` and the numbers that follow."""
    cost = planned_walk()
    searches, missing = {}, []
    for method in METHODS:
        try:
            searches[method] = [_search(settings, cost, method, seed + k) for k in range(settings.searches)]
        except ImportError:
            missing.append(method)
    every = [search for each in searches.values() for search in each]
    batch = max(BATCH, 2 * len(every))
    how: Any = {"evaluations": settings.evaluations, "map": WalkingCost.costs, "batch": batch, "progress": progress}
    together = finished(run_together(every, cost, **how))
    fine = recompiled(cost, timestep=0.25 * cost.scene.timestep).measure([result.x for result in together.results])
    best = np.array([_padded(result.history["best"], settings.evaluations) for result in together.results])
    finer = np.array([measures.cost for measures in fine])
    names = [method for method, each in searches.items() for _ in each]
    mine = {method: np.array([name == method for name in names]) for method in searches}
    return MethodResult(
        settings,
        {method: best[rows] for method, rows in mine.items()},
        {method: finer[rows] for method, rows in mine.items()},
        tuple(missing),
    )


def _search(settings: MethodSettings, cost: WalkingCost, method: str, seed: int) -> Search:
    x0, limits = cost.gait.to_vector(), bounds(cost.scene.model, cost.gait)
    if method == PAPERS:
        n = settings.evaluations
        return AdaptiveSimulatedAnnealing(
            x0, amplitude=settings.amplitude, max_miss=MAX_MISS, max_iterations=n, no_progress=n, bounds=limits,
            seed=seed,
        )  # fmt: skip
    if method == "CMA-ES":
        return cma_es(x0, amplitude=settings.amplitude, bounds=limits, seed=seed)
    if method == "dual annealing":
        box = np.clip(np.stack([x0 - settings.box, x0 + settings.box], axis=1), *limits.T[:, :, None])
        return dual_annealing(x0, bounds=box, seed=seed)
    return differential_evolution(x0, amplitude=settings.amplitude, bounds=limits, seed=seed)


def _padded(best: np.ndarray, n: int) -> np.ndarray:
    """Extend a search that ended early by its best cost."""
    return np.concatenate([best, np.full(n - len(best), best[-1])])


# ---------------------------------------------------------------------------------------------- claims


def check(result: MethodResult) -> list[Claim]:
    """Return the claims about the paper's choice of method."""
    return [_best(result), *(_against(result, method) for method in METHODS if method != PAPERS), _sound(result)]


def _best(result: MethodResult) -> Claim:
    """Return the claim: reproduced if its median is significantly the least; in direction if the least."""
    order = sorted(result.best, key=lambda method: np.median(result.costs(method)))
    least = order[0] == PAPERS
    p = _p(result, PAPERS, order[1]) if least else 1.0
    verdict = classify(least and p < SIGNIFICANT, least)
    start = result.best[PAPERS][0, 0]
    return question(
        claim="Among these methods the paper's finds the cheapest gait",
        ours=", ".join(f"{method} {_range(result.costs(method))}" for method in order)
        + f" J/m after {result.settings.evaluations} evaluations, from {start:.1f} J/m",
        verdict=verdict,
        why=f"Rule: least median, and p < {SIGNIFICANT:g} against the next (one-sided rank sum test, p = {p:.2g}); in "
        f"direction if the median is the least. Median and range of {result.settings.searches} searches each. Medians "
        f"after fewer evaluations: {_way(result)}",
    )


def _way(result: MethodResult) -> str:
    """Return the medians after a quarter, half and all of the evaluations."""
    n = result.settings.evaluations
    return "; ".join(
        f"{k}: " + ", ".join(f"{method} {np.median(best[:, k - 1]):.1f}" for method, best in result.best.items())
        for k in (n // 4, n // 2, n)
    )


def _against(result: MethodResult, method: str) -> Claim:
    """Return the claim: reproduced if the paper's is significantly better; in direction if better in the median."""
    claim = f"The paper's search beats {method} at equal numbers of evaluations"
    if method in result.missing:
        why = "CMA-ES needs the package cma: pip install 'featherstone-gait[search]'"
        return question(claim, f"{method} was not run: its package is not installed", "not reproduced", why)
    ours, other = (float(np.median(result.costs(name))) for name in (PAPERS, method))
    p, reverse = _p(result, PAPERS, method), _p(result, method, PAPERS)
    verdict = classify(p < SIGNIFICANT, ours < other)
    reached = [int(np.argmax(best <= other)) + 1 for best in result.best[PAPERS] if best[-1] <= other]
    enough = f"; {len(reached)} of its searches reach {method}'s median" + (
        f", after {np.median(reached):.0f} evaluations" if reached else ""
    )
    return question(
        claim=claim,
        ours=f"{ours:.1f} J/m against {other:.1f} J/m ({ours / other - 1.0:+.0%})",
        verdict=verdict,
        why=f"Rule: p < {SIGNIFICANT:g} (one-sided rank sum test, p = {p:.2g}, the other way round {reverse:.2g}); in "
        f"direction if the median is less{enough}"
        + (". Two searches each cannot be significant" if result.settings.searches < 3 else ""),
    )


def _sound(result: MethodResult) -> Claim:
    """Return the claim: reproduced if no cost changes by 5 % or more."""
    changes = np.concatenate([result.finer[method] / result.costs(method) - 1.0 for method in result.best])
    return question(
        claim="The gaits found are not artifacts of the time step",
        ours=f"costs change by {_percent(changes.min())} to {_percent(changes.max())} at a quarter of the step",
        verdict=classify(np.abs(changes).max() < 0.05),
        why="Rule: all change by less than 5 %; a fall counts as an infinite cost",
    )


def _p(result: MethodResult, less: str, greater: str) -> float:
    from scipy.stats import mannwhitneyu  # slow to import

    return float(mannwhitneyu(result.costs(less), result.costs(greater), alternative="less").pvalue)


def _range(values: np.ndarray) -> str:
    return f"{np.median(values):.1f} ({values.min():.1f} to {values.max():.1f})"


def _percent(x: float) -> str:
    return f"{x:+.1%}" if np.isfinite(x) else "a fall"


# ---------------------------------------------------------------------------------------------- figures

COLORS = dict(zip(METHODS, STYLE))


@look()
def plot(result: MethodResult) -> dict[str, Figure]:
    """Draw the searches over evaluations, and what each found."""
    return {
        "Energy per distance of the best gait so far against the number of evaluations (median and range), and of the "
        "gaits found in the end: each mark is a search, the line their median.": _progress(result)
    }


def _progress(result: MethodResult) -> Figure:
    figure, (left, right) = subplots(10.0, 4.2, 1, 2, sharey=True, width_ratios=(3, 1))
    for k, (method, best) in enumerate(result.best.items()):
        n = np.arange(1, best.shape[1] + 1)
        draw_band(left, n, best, COLORS[method], method)
        draw_marks(right, k, best[:, -1], COLORS[method], 0.3)
    left.set(xlabel="evaluations", ylabel="energy per distance [J/m]", xlim=(1, result.settings.evaluations))
    left.set_ylim(bottom=0.0)
    right.set(xticks=[], xlim=(-0.6, len(result.best) - 0.4), xlabel="gaits found")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure
