"""SciPy's differential evolution by ask and tell, a generation at a time.

Reference: R. Storn, K. Price, "Differential evolution - a simple and efficient heuristic for global optimization over
continuous spaces", J. Global Optimization 11 (1997).  The strategy is SciPy's default, best/1/bin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from featherstone_gait.base.arguments import whole
from featherstone_gait.search.generations import MOST, Generations, check_finite, check_start
from featherstone_gait.search.inverted import Evaluate, inverted

POPULATION = 50  # SciPy's 15 D are 600 evaluations a generation for a gait of forty angles


def differential_evolution(
    x0: ArrayLike, *, amplitude: ArrayLike, bounds: ArrayLike, seed: int = 0, population: int = POPULATION
) -> Generations:
    """Return the search, which has no end, within finite `bounds` (D, 2).

    The first of the population is `x0` (D,), but for its last bit; the others are uniform within `amplitude` of it, a
    number or (D,), and the bounds: of gaits drawn from all that the joints allow hardly one walks.  Raises ValueError
    for bounds that are not finite or do not hold x0, an amplitude that is not positive and a population below 5.
    """
    if amplitude is None:
        raise ValueError("amplitude is None; give how far from x0 the first are to be, a number or (D,)")
    x0, box = check_start(x0, bounds, amplitude)
    check_finite(box, "differential evolution")
    population = whole("population", population, 5, "there is too little to take differences of below", MOST)
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
