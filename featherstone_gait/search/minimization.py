"""Minimization by adaptive simulated annealing: evaluation in batches or speculatively, history, callback."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, nullcontext, suppress
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import OptimizeResult

from ..base.arguments import functions, path, truth, whole
from ..base.progress import progress_bar
from .annealing import MESSAGES, AdaptiveSimulatedAnnealing
from .ask_tell import Cost, Map, check_map
from .generations import MOST_CANDIDATES
from .history import AnnealingHistory
from .speculation import Speculation


def minimize(
    fun: Cost | None,
    x0: ArrayLike,
    *,
    amplitude: ArrayLike,
    max_miss: int = 20,
    max_iterations: int = 3000,
    no_progress: int = 500,
    bounds: ArrayLike | None = None,
    seed: int = 0,
    map: Map = map,
    batch: int = 1,
    evaluate: Callable[[Speculation], object] | None = None,
    callback: Callable[[OptimizeResult], bool | None] | None = None,
    history: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: bool = False,
) -> OptimizeResult:
    """Minimize a function by adaptive simulated annealing.

    The states visited depend on the settings of `AdaptiveSimulatedAnnealing` alone, not on how they are evaluated.

    Parameters
    ----------
    fun : callable
        ``fun(x)`` returns the cost, or (cost, status) with a short text for the history.  A cost that is not finite is
        a miss.
    x0, amplitude, max_miss, max_iterations, no_progress, bounds, seed
        As of `AdaptiveSimulatedAnnealing`.
    map : callable
        ``map(fun, candidates)`` evaluates a batch, as the built-in or that of an executor.
    batch : int
        Number of candidates evaluated at once.
    evaluate : callable, optional
        In place of `map`: ``evaluate(candidates)`` works off a `Speculation` and returns when that is over, so that
        candidates need not wait for one another.
    callback : callable, optional
        ``callback(result)`` is called at every improvement and stops the search by returning True.
    history : path, optional
        File of JSON lines, each written before the next candidate is visited.
    resume : bool
        Whether to continue the search of `history`, if there is one, to the same states and the same file as if it had
        not been interrupted.  Only max_iterations and no_progress may differ: no candidate depends on them, so that a
        larger one makes the search longer.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    scipy.optimize.OptimizeResult
        x, fun, nit (candidates after x0), nfev (evaluations begun), wasted (those that were not visited; of a resumed
        search since then), resumed (how many visits come from the history), success, status (a key of
        `annealing.MESSAGES`), message, and history: arrays x (nit + 1, D), f, miss and accepted.  A KeyboardInterrupt
        ends the search with what was found.

    Raises
    ------
    FileExistsError
        If `history` would be overwritten.
    ValueError
        If it is damaged or of another search.
    OSError
        If it cannot be written, or another process is at work with it; the lines so far are kept.
    """
    search = AdaptiveSimulatedAnnealing(
        x0, amplitude=amplitude, max_miss=max_miss, max_iterations=max_iterations, no_progress=no_progress,
        bounds=bounds, seed=seed,
    )  # fmt: skip
    batch = whole("batch", batch, 1, "it is how many candidates are evaluated at once", MOST_CANDIDATES)
    functions("fun", "map", "evaluate", "callback", fun=fun, map=map, evaluate=evaluate, callback=callback)
    if evaluate is None:
        check_map(fun, map)
    progress, resume = truth("progress", progress), truth("resume", resume)
    history = None if history is None else path("history", history)
    log = None if history is None else AnnealingHistory(Path(history), search, resume)
    resumed = len(search.visited)
    steps = _in_batches(search, fun, map, batch) if evaluate is None else _speculating(search, evaluate)
    bar = progress_bar(total=max_iterations + 1, initial=search.iteration, progress=progress, unit="candidate")
    status: int | None = 2
    with nullcontext() if log is None else closing(log), bar, closing(steps), suppress(KeyboardInterrupt):
        for statuses in steps:
            visits = search.visited[-len(statuses) :]
            if log is not None:
                log.write(visits, statuses)
            bar.update(search.iteration - bar.n)
            if any(visit.accepted for visit in visits):
                bar.set_postfix(best=search.best_f)
                if callback is not None and callback(_result(search, None, resumed)):
                    status = 3
                    break
        else:
            status = search.status
    return _result(search, status, resumed)


def _in_batches(search: AdaptiveSimulatedAnnealing, fun: Cost | None, map: Map, batch: int) -> Generator[list[str]]:
    """Evaluate batch after batch; yield the statuses of the visited candidates."""
    while search.status is None:
        candidates = search.ask_batch(batch)
        answers = [answer if isinstance(answer, tuple) else (answer, "") for answer in map(fun, candidates)]
        taken = search.tell_batch([f for f, _ in answers])
        yield [text for _, text in answers[:taken]]


def _speculating(search: AdaptiveSimulatedAnnealing, evaluate: Callable[[Speculation], object]) -> Generator[list[str]]:
    """Let `evaluate` run in a thread of its own; yield the status of each visited candidate."""
    candidates, before = Speculation(search), search.wasted + len(search.visited)
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(evaluate, candidates)
        done.add_done_callback(lambda _: candidates.close())
        try:
            while visits := candidates.visits():
                for _, (f, text) in visits:
                    search.tell(search.ask(), f)
                    search.wasted = before + candidates.begun - len(search.visited)
                    yield [text]
        finally:
            candidates.close()
    done.result()  # raises what it raised
    if search.status is None:
        raise RuntimeError("evaluate returned before the search was over")


def _result(search: AdaptiveSimulatedAnnealing, status: int | None, resumed: int) -> OptimizeResult:
    visited = search.visited
    arrays = {
        name: np.array([getattr(visit, name) for visit in visited], dtype=bool if name == "accepted" else float)
        for name in ("x", "f", "miss", "accepted")
    }
    arrays["x"] = arrays["x"].reshape(-1, len(search.x0))
    found = bool(np.isfinite(search.best_f))
    message = ("running" if status is None else MESSAGES[status]) if found else "no candidate had a finite cost"
    return OptimizeResult(
        x=search.best_x.copy(), fun=search.best_f, nit=max(0, len(visited) - 1), nfev=len(visited) + search.wasted,
        wasted=search.wasted, resumed=resumed, success=found and status in (0, 1), status=status, message=message,
        history=arrays,
    )  # fmt: skip
