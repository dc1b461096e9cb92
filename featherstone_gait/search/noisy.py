"""Search where the cost is noisy: an improvement is believed only after fresh draws.

Of many noisy costs the least is lucky, the more so the more there are: the optimizer's curse (J.E. Smith, R.L. Winkler,
Management Science 52 (2006), doi:10.1287/mnsc.1050.0451).  A search that keeps the best so far then keeps the luckiest.
Explicit averaging over repeated evaluations is the plain remedy (Y. Jin, J. Branke, "Evolutionary optimization in
uncertain environments - a survey", IEEE Trans. Evolutionary Computation 9 (2005), section II); here:

1. Screening: a candidate is evaluated on one draw.  It goes on if that is less than the mean of all costs that the
   incumbent, the best so far, has had in duels.
2. Duel: candidate and incumbent are evaluated on the same `repeats` fresh draws, common random numbers, so that what
   the noise does to both alike cancels.  The candidate becomes the incumbent if its mean is less.
3. Belief: the new incumbent is evaluated on `repeats` draws more.  Their mean is the cost that is claimed.

Winning a duel takes some luck, so that its mean is biased, too; the draws of the belief decide nothing, hence the
claimed cost is unbiased, and the standard error of their mean is its own.  A candidate that is worse by d wins a duel
with probability Phi(-d sqrt(repeats / 2) / s), s being the noise's standard deviation where both are independent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult
from tqdm import tqdm

from featherstone_gait.base.arguments import functions, truth, whole
from featherstone_gait.search.annealing import MESSAGES
from featherstone_gait.search.ask_tell import Answer, Map, Search, check_map, check_search
from featherstone_gait.search.run import costs_of

NoisyCost = Callable[[np.ndarray, tuple[int, int, int]], Answer]  # of a candidate (D,) and a draw


class Belief(NamedTuple):
    """What an incumbent is believed to cost."""

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
    """Run an `AdaptiveSimulatedAnnealing` on a noisy cost to its end; return a `scipy.optimize.OptimizeResult`.

    ``fun(x, draw)`` returns the cost, or (cost, status), with the noise of `draw`, three whole numbers (seed,
    iteration, repeat): ``numpy.random.default_rng(draw)`` makes the noise from it.  No draw is used twice, but for the
    two of a duel.  ``map(fun, candidates, draws)`` evaluates many, up to `batch` candidates in screening; what is
    visited does not depend on it.  A cost that is not finite in one draw loses a duel, and one among the draws of a
    belief is an infinite claim.

    The search is told an order, not costs: a duel won is -1, -2, ... with x0 at 0, all else an infinite cost, which is
    a miss; its best_x is the incumbent.  It must be one that only compares with the best so far.

    The result has x, fun (the believed cost), error (its standard error), nit, nfev, duels, success, status and message
    (those of `minimize`) and history, a list of `Belief`.  KeyboardInterrupt ends the search with what was
    found.  Raises ValueError for fewer than 2 repeats, a batch below 1 and a search that has begun.
    """
    repeats = whole("repeats", repeats, 2, "a standard error needs two")
    batch = whole("batch", batch, 1, "it is how many candidates are evaluated at once")
    seed = whole("seed", seed, 0, "any will do", 2**128 - 1)
    functions(fun=fun, map=map)
    check_map(fun, map)
    progress = truth("progress", progress)
    check_search("search", search)
    if np.isfinite(search.best_f):
        raise ValueError("the search has begun: what it was told are other costs; give a new one")
    noisy = _NoisySearch(fun, search, repeats, seed, map)
    bar = tqdm(disable=not progress, unit="candidate")
    try:
        while search.status is None:
            noisy.advance(batch)
            bar.update(noisy.iteration - bar.n)
            bar.set_postfix(believed=noisy.beliefs[-1].f, evaluations=noisy.nfev)
        status = search.status
    except KeyboardInterrupt:
        status = 2
    finally:
        bar.close()
    return noisy.result(status)


class _NoisySearch:
    """The state of a noisy search; the sums are over the incumbent's costs in duels."""

    def __init__(self, fun: NoisyCost, search: Search, repeats: int, seed: int, map: Map) -> None:
        self.fun, self.search, self.repeats, self.seed, self.map = fun, search, repeats, seed, map
        self.iteration = self.nfev = self.duels = self.wins = 0
        self.beliefs: list[Belief] = []
        self.sum, self.count = 0.0, 0

    def advance(self, batch: int) -> None:
        """Screen up to `batch` candidates and take them in turn, up to the first that wins its duel."""
        candidates = self.search.ask_batch(batch if self.iteration else 1)
        screened = self._evaluate(candidates, [(self.iteration + i, 0) for i in range(len(candidates))])
        told = [np.inf] * len(candidates)
        for i, x in enumerate(candidates):
            if self._wins(x, screened[i]):
                told[i] = -float(self.wins)
                self.wins += 1
            self.iteration += 1
            if np.isfinite(told[i]):
                break
        self.search.tell_batch(told)

    def result(self, status: int) -> OptimizeResult:
        found = bool(self.beliefs) and bool(np.isfinite(self.beliefs[-1].f))
        x, f, error = self.beliefs[-1][1:] if self.beliefs else (self.search.best_x, np.inf, np.nan)
        return OptimizeResult(
            x=x.copy(), fun=f, error=error, nit=max(0, self.iteration - 1), nfev=self.nfev, duels=self.duels,
            success=found and status != 2, status=status, history=self.beliefs,
            message=MESSAGES[status] if found else "no candidate had a finite cost in all draws",
        )  # fmt: skip

    def _wins(self, x: np.ndarray, screened: float) -> bool:
        """Whether `x` takes the incumbent's place; x0 does unless its cost is infinite."""
        if not self.beliefs:
            own = self._evaluate([x] * self.repeats, self._fresh(1))
            return self._enthrone(x, own)
        if not screened < self.sum / self.count:
            return False
        self.duels += 1
        draws = self._fresh(1)
        costs = self._evaluate([x] * self.repeats + [self.beliefs[-1].x] * self.repeats, draws + draws)
        own, other = costs[: self.repeats], costs[self.repeats :]
        if sum(own) < sum(other):
            return self._enthrone(x, own)
        self.sum, self.count = self.sum + sum(other), self.count + self.repeats
        return False

    def _enthrone(self, x: np.ndarray, costs: Sequence[float]) -> bool:
        """Make `x`, with these costs in its duel, the incumbent."""
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
