"""Minimization of noisy costs: an improvement is confirmed with fresh random draws.

The least of many noisy costs is partly luck, the more so the more there are: the optimizer's curse (J.E. Smith, R.L.
Winkler, Management Science 52 (2006), doi:10.1287/mnsc.1050.0451).  A search that keeps the best keeps the luckiest.
Explicit averaging over repeated evaluations is the simple remedy (Y. Jin, J. Branke, "Evolutionary optimization in
uncertain environments - a survey", IEEE Trans. Evolutionary Computation 9 (2005), section II); here:

1. Screening: a candidate is evaluated on one draw.  It passes if its cost is less than the mean of all costs that the
   incumbent, the best so far, had in duels.
2. Duel: candidate and incumbent are evaluated on the same `repeats` fresh draws, common random numbers, so that
   noise that affects both alike cancels.  The candidate becomes the incumbent if its mean is less.
3. Belief: the new incumbent is evaluated on `repeats` draws more.  Their mean is the reported cost.

Winning a duel takes some luck, so that its mean is biased too; the draws of the belief decide nothing, hence the
reported cost is unbiased, with the standard error of its mean.  A candidate that is worse by d wins a duel
with probability Phi(-d sqrt(repeats / 2) / s), s being the noise's standard deviation where both are independent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult

from ..base.arguments import functions, truth, whole
from ..base.progress import progress_bar
from .annealing import MESSAGES
from .ask_tell import Answer, Map, Search, check_map, check_search
from .generations import MOST_CANDIDATES
from .run import costs_of

NoisyCost = Callable[[np.ndarray, tuple[int, int, int]], Answer]  # of a candidate (D,) and a draw


class Belief(NamedTuple):
    """The estimated cost of an incumbent."""

    iteration: int  # in which it became the incumbent
    x: np.ndarray  # (D,)
    f: float  # mean over fresh draws
    error: float  # its standard error


def minimize_noisy(
    fun: NoisyCost,
    search: Search,
    *,
    repeats: int = 8,
    seed: int = 0,
    map: Map = map,
    batch: int = 1,
    progress: bool = False,
) -> OptimizeResult:
    """Run a search on a noisy cost to its end.

    The search gets an order, not costs: a duel that is won is -1, -2, ... with x0 at 0, all else an infinite cost,
    which is a miss.  A cost that is not finite in one draw loses a duel, and makes a belief infinite.

    Parameters
    ----------
    fun : callable
        ``fun(x, draw)`` returns the cost, or (cost, status), with the noise of a draw, three whole numbers (seed,
        iteration, repeat), as for ``numpy.random.default_rng(draw)``.  No draw is used twice, except by the two of a
        duel.
    search : Search
        A new `AdaptiveSimulatedAnnealing`, or another search that only compares with the best.
    repeats : int
        Draws of a duel and of a belief, at least 2.
    seed : int
        Seed of the draws.
    map : callable
        ``map(fun, candidates, draws)`` evaluates many.
    batch : int
        Number of candidates screened at once; the visited states do not depend on it.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    scipy.optimize.OptimizeResult
        x, fun (the estimated cost), error (its standard error), nit, nfev, duels, success, status and message (those of
        `minimize`) and history, a list of `Belief`.  A KeyboardInterrupt ends the search with what was found.
    """
    repeats = whole("repeats", repeats, 2, "a standard error needs two", MOST_CANDIDATES)
    batch = whole("batch", batch, 1, "it is how many candidates are evaluated at once", MOST_CANDIDATES)
    seed = whole("seed", seed, 0, "any will do", 2**128 - 1)
    functions("fun", "map", fun=fun, map=map)
    check_map(fun, map)
    progress = truth("progress", progress)
    check_search("search", search)
    if np.isfinite(search.best_f):
        raise ValueError("the search has begun with other costs; give a new one")
    noisy = _NoisySearch(fun, search, repeats, seed, map)
    status = 2
    with progress_bar(progress=progress, unit="candidate") as bar, suppress(KeyboardInterrupt):
        while search.status is None:
            noisy.advance(batch)
            bar.update(noisy.iteration - bar.n)
            bar.set_postfix(believed=noisy.beliefs[-1].f, evaluations=noisy.nfev)
        status = search.status
    return noisy.result(status)


class _NoisySearch:
    """The state of a noisy search; the sums are over the incumbent's costs in duels."""

    def __init__(self, fun: NoisyCost, search: Search, repeats: int, seed: int, map: Map) -> None:
        self.fun, self.search, self.repeats, self.seed, self.map = fun, search, repeats, seed, map
        self.iteration = self.nfev = self.duels = self.wins = 0
        self.beliefs: list[Belief] = []
        self.sum, self.count = 0.0, 0

    def advance(self, batch: int) -> None:
        """Screen up to `batch` candidates and take them in order, up to the first that wins its duel."""
        candidates = self.search.ask_batch(batch if self.iteration else 1)
        screened = self._evaluate(candidates, [(self.iteration + i, 0) for i in range(len(candidates))])
        costs = [np.inf] * len(candidates)
        for i, x in enumerate(candidates):
            if self._wins(x, screened[i]):
                costs[i] = -float(self.wins)
                self.wins += 1
            self.iteration += 1
            if np.isfinite(costs[i]):
                break
        self.search.tell_batch(costs)

    def result(self, status: int) -> OptimizeResult:
        found = bool(self.beliefs) and bool(np.isfinite(self.beliefs[-1].f))
        x, f, error = self.beliefs[-1][1:] if self.beliefs else (self.search.best_x, np.inf, np.nan)
        return OptimizeResult(
            x=x.copy(), fun=f, error=error, nit=max(0, self.iteration - 1), nfev=self.nfev, duels=self.duels,
            success=found and status != 2, status=status, history=self.beliefs,
            message=MESSAGES[status] if found else "no candidate had a finite cost in all draws",
        )  # fmt: skip

    def _wins(self, x: np.ndarray, screened: float) -> bool:
        """Return whether `x` becomes the incumbent; x0 does unless its cost is infinite."""
        if not self.beliefs:
            own = self._evaluate([x] * self.repeats, self._fresh(1))
            return self._promote(x, own)
        if not screened < self.sum / self.count:
            return False
        self.duels += 1
        draws = self._fresh(1)
        costs = self._evaluate([x] * self.repeats + [self.beliefs[-1].x] * self.repeats, draws + draws)
        own, other = costs[: self.repeats], costs[self.repeats :]
        if sum(own) < sum(other):
            return self._promote(x, own)
        self.sum, self.count = self.sum + sum(other), self.count + self.repeats
        return False

    def _promote(self, x: np.ndarray, costs: Sequence[float]) -> bool:
        """Make `x`, with these costs in its duel, the incumbent; return whether they are finite."""
        self.sum, self.count = sum(costs), self.repeats
        fresh = np.array(self._evaluate([x] * self.repeats, self._fresh(1 + self.repeats)))
        error = fresh.std(ddof=1) / np.sqrt(self.repeats) if np.isfinite(fresh).all() else np.nan
        self.beliefs.append(Belief(self.iteration, x, float(fresh.mean()), float(error)))
        return bool(np.isfinite(self.sum))

    def _fresh(self, first: int) -> list[tuple[int, int]]:
        return [(self.iteration, repeat) for repeat in range(first, first + self.repeats)]

    def _evaluate(self, candidates: Sequence[np.ndarray], draws: Sequence[tuple[int, int]]) -> list[float]:
        costs = costs_of(self.map(self.fun, candidates, [(self.seed, *draw) for draw in draws]), len(candidates))
        self.nfev += len(candidates)
        return [f if np.isfinite(f) else np.inf for f in costs]
