"""Search methods of SciPy by ask and tell.

References: R. Storn, K. Price, "Differential evolution - a simple and efficient heuristic for global optimization over
continuous spaces", J. Global Optimization 11 (1997); the strategy is SciPy's default, best/1/bin.  Y. Xiang et al.,
"Generalized simulated annealing algorithm and its application to the Thomson model", Physics Letters A 233 (1997).

A minimizer that calls its cost function runs in a thread of its own (`inverted`), which waits while the caller runs and
the other way round: the two never run at once, so that nothing depends on the threads' timing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from queue import SimpleQueue
from threading import Thread

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import real, truth, whole
from .ask_tell import check_start
from .generations import MOST_CANDIDATES, Generations, Method

POPULATION = 50  # SciPy's 15 D are 600 evaluations a generation for a gait of forty angles
Evaluate = Callable[[Sequence[np.ndarray]], list[float]]
Questions = SimpleQueue[Sequence[np.ndarray] | BaseException | None]
Answers = SimpleQueue[list[float] | None]


def differential_evolution(
    x0: ArrayLike, *, amplitude: ArrayLike, bounds: ArrayLike, seed: int = 0, population: int = POPULATION
) -> Generations:
    """Create a search by differential evolution, which has no end.

    The first of the population is `x0`, but for its last bit; the others are uniform within `amplitude` of it and the
    bounds: of gaits drawn from all that the joints allow hardly one walks.

    Parameters
    ----------
    x0 : array_like, shape (D,)
        First vector.
    amplitude : float or array_like, shape (D,)
        How far from x0 the first population is, in its units.
    bounds : array_like, shape (D, 2)
        Lower and upper bounds, finite.
    seed : int
        Seed.
    population : int
        Size of a generation, at least 5.

    Returns
    -------
    Generations
        The search.

    Raises
    ------
    ValueError
        For bounds that are not finite or do not hold x0, an amplitude that is not positive and a population below 5.
    """
    from scipy import optimize  # slow to import

    if amplitude is None:
        raise ValueError("amplitude is None; give how far from x0 the first are to be, a number or (D,)")
    x0, box = _check_start("differential evolution", x0, bounds, amplitude)
    population = whole("population", population, 5, "there is too little to take differences of below", MOST_CANDIDATES)
    seed = whole("seed", seed, 0, "any will do", 2**128 - 1)
    rng = np.random.Generator(np.random.PCG64(seed))
    first = x0 + np.asarray(amplitude) * rng.uniform(-1.0, 1.0, (population, len(x0)))
    first[0] = x0
    lower, upper = box.T
    first = np.clip(first, lower, upper)

    def minimize(evaluate: Evaluate) -> None:
        optimize.differential_evolution(
            lambda x: np.array(evaluate(list(np.clip(x.T, lower, upper)))), box, init=first, rng=rng,
            maxiter=2**62, tol=0.0, atol=-np.inf, polish=False, updating="deferred", vectorized=True,
        )  # fmt: skip

    return Generations(inverted(minimize), x0)


def dual_annealing(
    x0: ArrayLike, *, bounds: ArrayLike, seed: int = 0, initial_temp: float = 5230.0, local_search: bool = False
) -> Generations:
    """Create a search by dual annealing, which has no end.

    A start whose cost is not finite is left by wandering until one is.

    Parameters
    ----------
    x0 : array_like, shape (D,)
        First vector.
    bounds : array_like, shape (D, 2)
        Lower and upper bounds, finite.
    seed : int
        Seed.
    initial_temp : float
        SciPy's; its visiting steps scale with it, not with the box.
    local_search : bool
        Turns L-BFGS-B with differences over 1e-8 on, as is SciPy's default: for costs that are smooth on that scale,
        which a gait's with its impacts is not.

    Returns
    -------
    Generations
        The search.

    Raises
    ------
    ValueError
        For bounds that are not finite or do not hold x0.
    """
    from scipy import optimize  # slow to import

    x0, box = _check_start("dual annealing", x0, bounds)
    seed = whole("seed", seed, 0, "any will do", 2**128 - 1)
    initial_temp = real("initial_temp", initial_temp, 0.01, 5e4, "SciPy's range; 5230 is usual")
    local_search = truth("local_search", local_search)

    def minimize(evaluate: Evaluate) -> None:
        optimize.dual_annealing(
            lambda x: evaluate([x])[0], box, x0=x0, rng=np.random.Generator(np.random.PCG64(seed)),
            initial_temp=initial_temp, maxiter=2**62, maxfun=np.inf, no_local_search=not local_search,
        )  # fmt: skip

    return Generations(inverted(minimize), x0)


def _check_start(
    method: str, x0: ArrayLike, bounds: ArrayLike | None, amplitude: ArrayLike | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Check as `check_start`; raise ValueError too unless all `bounds` (D, 2) are finite."""
    x0, bounds = check_start(x0, bounds, amplitude)
    infinite = ~np.isfinite(bounds).all(axis=1)
    if infinite.any():
        i = int(infinite.argmax())
        raise ValueError(f"{method} draws from the whole box: bounds[{i}] = {bounds[i].tolist()} must be finite")
    return x0, bounds


def inverted(minimize: Callable[[Evaluate], None]) -> Method:
    """Yield the candidates that ``minimize(evaluate)`` evaluates; receive their costs.

    `evaluate` takes a list of candidates and returns a list of costs.  What the minimizer raises is raised here.  When
    the generator is closed, or no longer referred to, the minimizer ends at its next evaluation.
    """
    questions: Questions = SimpleQueue()
    answers: Answers = SimpleQueue()
    Thread(target=_work, args=(minimize, questions, answers), name="minimizer", daemon=True).start()
    try:
        while (question := questions.get()) is not None:
            if isinstance(question, BaseException):
                raise question
            answers.put((yield question))
    finally:
        answers.put(None)


def _work(minimize: Callable[[Evaluate], None], questions: Questions, answers: Answers) -> None:
    def evaluate(candidates: Sequence[np.ndarray]) -> list[float]:
        questions.put(candidates)
        costs = answers.get()
        if costs is None:
            raise SystemExit  # ends the minimizer
        return costs

    try:
        minimize(evaluate)
        questions.put(None)
    except SystemExit:
        return
    except Exception as error:
        questions.put(error)
