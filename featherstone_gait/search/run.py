"""Run ask-and-tell searches for a given number of evaluations, alone or several in one batch."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from itertools import islice

import numpy as np
from scipy.optimize import OptimizeResult

from ..base.arguments import functions, listed, truth, whole
from ..base.progress import progress_bar
from .ask_tell import Answer, Cost, Map, Search, check_map, check_search

MESSAGES = {
    0: "all evaluations made",
    1: "the search ended before all evaluations were made",
    2: "interrupted; the best so far is returned",
}


def run(
    search: Search, fun: Cost, *, evaluations: int, map: Map = map, batch: int = 1, progress: bool = False
) -> OptimizeResult:
    """Evaluate a number of candidates of a search.

    Parameters
    ----------
    search : Search
        An ask-and-tell search; see `featherstone_gait.search`.  One with an end of its own, such as the paper's, may
        end before.
    fun, map
        As of `minimize`.
    evaluations : int
        Number of candidates that are visited.
    batch : int
        Largest number of candidates evaluated at once; the visited candidates do not depend on it.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    scipy.optimize.OptimizeResult
        x, fun, nit (candidates after the first), nfev (evaluations), wasted (those of candidates that were not
        visited), success, status (a key of `run.MESSAGES`), message, and history: arrays x (nit + 1, D), f and best,
        the least of f so far.  A KeyboardInterrupt ends the search with what was found.
    """
    return run_together([search], fun, evaluations=evaluations, map=map, batch=batch, progress=progress).results[0]


def run_together(
    searches: Iterable[Search], fun: Cost, *, evaluations: int, map: Map = map, batch: int = 1, progress: bool = False
) -> OptimizeResult:
    """Run several searches side by side, such as restarts with several seeds; each visits what it visits alone.

    Parameters
    ----------
    searches : iterable of Search
        Ask-and-tell searches.
    fun, map
        As of `minimize`.
    evaluations : int
        Number of candidates of each search.
    batch : int
        Number of candidates evaluated at once, shared out evenly, at least one for each search.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    scipy.optimize.OptimizeResult
        That of the best search, as of `run`.  Added are results, those of all searches in their order, and best, the
        index of the best one; nfev and wasted are sums.
    """
    searches = listed("searches", searches, "give a list of searches")
    for name, value in (("searches", len(searches)), ("evaluations", evaluations), ("batch", batch)):
        whole(name, value, 1, "there must be at least 1")
    for search in searches:
        check_search("searches", search)
    functions("fun", "map", fun=fun, map=map)
    check_map(fun, map)
    progress, evaluations, batch = truth("progress", progress), int(evaluations), int(batch)
    runs = [_Run(search, evaluations) for search in searches]
    bar = progress_bar(total=len(runs) * evaluations, progress=progress, unit="candidate")
    with bar, suppress(KeyboardInterrupt):
        while active := [one for one in runs if one.status is None]:
            share, rest = divmod(batch, len(active))  # of the candidates evaluated at once
            asked = [one.ask(max(1, share + (i < rest))) for i, one in enumerate(active)]
            candidates = [x for part in asked for x in part]
            costs = iter(costs_of(map(fun, candidates), len(candidates)))
            for one, part in zip(active, asked):
                one.tell(part, [*islice(costs, len(part))])
            bar.update(sum(len(one.f) for one in runs) - bar.n)
            bar.set_postfix(best=min(one.search.best_f for one in runs))
    results = [one.result() for one in runs]
    best = min(range(len(results)), key=lambda i: results[i].fun)
    total = {name: sum(result[name] for result in results) for name in ("nfev", "wasted")}
    status = max(result.status for result in results)
    together = OptimizeResult({**results[best], **total}, results=results, best=best, status=status)
    if np.isfinite(together.fun):
        together.success, together.message = status != 2, MESSAGES[status]
    return together


class _Run:
    """A search and its visited candidates."""

    def __init__(self, search: Search, evaluations: int) -> None:
        self.search, self.evaluations = search, evaluations
        self.x: list[np.ndarray] = []
        self.f: list[float] = []
        self.nfev = 0

    @property
    def status(self) -> int | None:
        if len(self.f) == self.evaluations:
            return 0
        return None if self.search.status is None else 1

    def ask(self, k: int) -> list[np.ndarray]:
        return self.search.ask_batch(min(k, self.evaluations - len(self.f)))

    def tell(self, x: list[np.ndarray], f: list[float]) -> None:
        taken = self.search.tell_batch(f)
        self.x += x[:taken]
        self.f += f[:taken]
        self.nfev += len(f)

    def result(self) -> OptimizeResult:
        search, n = self.search, len(self.f)
        status = 2 if self.status is None else self.status  # without one it was interrupted
        found = bool(np.isfinite(search.best_f))
        f = np.array(self.f, dtype=float)
        best = np.minimum.accumulate(np.where(np.isfinite(f), f, np.inf))
        history = {"x": np.array(self.x).reshape(n, -1), "f": f, "best": best}
        return OptimizeResult(
            x=search.best_x.copy(), fun=search.best_f, nit=max(0, n - 1), nfev=self.nfev, wasted=self.nfev - n,
            success=found and status != 2, status=status, history=history,
            message=MESSAGES[status] if found else "no candidate had a finite cost",
        )  # fmt: skip


def costs_of(answers: Iterable[Answer], n: int) -> list[float]:
    """Return the `n` costs of answers that are costs or (cost, status).  Raises ValueError if there are not as many."""
    costs = [float(answer[0] if isinstance(answer, tuple) else answer) for answer in answers]
    if len(costs) != n:
        raise ValueError(f"map returned {len(costs)} costs for {n} candidates")
    return costs
