"""CMA-ES, the evolution strategy with covariance matrix adaptation; needs the package `cma`.

Reference: N. Hansen, A. Ostermeier, "Completely derandomized self-adaptation in evolution strategies", Evolutionary
Computation 9 (2001), doi:10.1162/106365601750190398.  It uses the order of the costs alone.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import whole
from .ask_tell import check_start
from .generations import MOST_CANDIDATES, Generations, Method

# pycma's tests for the end are off, so that methods can be compared at equal numbers of evaluations.
ENDLESS = {
    "maxiter": math.inf, "tolx": 0, "tolfun": 0, "tolfunhist": 0, "tolfunrel": 0, "tolstagnation": math.inf,
    "tolflatfitness": math.inf, "verbose": -9, "verb_log": 0,
}  # fmt: skip


def cma_es(
    x0: ArrayLike,
    *,
    amplitude: ArrayLike,
    bounds: ArrayLike | None = None,
    seed: int = 0,
    population: int | None = None,
) -> Generations:
    """Create a CMA-ES search; it ends when a generation has shrunk to a point.

    First `x0` is evaluated, then normal samples about it.  Runs have the same bits with the same LAPACK.

    Parameters
    ----------
    x0 : array_like, shape (D,)
        First vector.
    amplitude : float or array_like, shape (D,)
        Amplitude of a uniform perturbation with the first standard deviation, in the units of x0.
    bounds : array_like, shape (D, 2), optional
        Lower and upper bounds.
    seed : int
        Seed.
    population : int, optional
        Size of a generation, at least 3; by default pycma's 4 + 3 log(D).

    Returns
    -------
    Generations
        The search.

    Raises
    ------
    ImportError
        Without the package `cma`.
    """
    try:
        import cma
    except ImportError as error:
        raise ImportError("CMA-ES needs the package cma: pip install 'featherstone-gait[search]'") from error
    if amplitude is None:
        raise ValueError("amplitude is None; give how far the search is to look at first, a number or (D,)")
    x0, box = check_start(x0, bounds, amplitude)
    if population is not None:
        population = whole("population", population, 3, "it must be at least 3", MOST_CANDIDATES)
    seed = whole("seed", seed, 0, "any will do", 2**128 - 1)
    rng = np.random.Generator(np.random.PCG64(seed))  # pycma's own seeding would seed all of NumPy
    options = ENDLESS | {
        "randn": lambda *shape: rng.standard_normal(shape),
        "seed": math.nan,
        "CMA_stds": np.broadcast_to(amplitude, x0.shape) / math.sqrt(3.0),
        "bounds": [[None if math.isinf(b) else b for b in side] for side in box.T.tolist()],
    }
    if population is not None:
        options["popsize"] = population
    return Generations(_generations(cma.CMAEvolutionStrategy(x0, 1.0, options), x0), x0)


def _generations(strategy: Any, x0: np.ndarray) -> Method:
    yield [x0]
    while True:
        candidates = strategy.ask()
        if all(np.array_equal(x, candidates[0]) for x in candidates):
            return
        strategy.tell(candidates, (yield candidates))
