"""SciPy's dual annealing by ask and tell: generalized simulated annealing over the whole box of the bounds.

Reference: Y. Xiang et al., "Generalized simulated annealing algorithm and its application to the Thomson model",
Physics Letters A 233 (1997).  It asks for one candidate at a time, each depending on the cost of the last; several
searches with different seeds fill a batch (`run_together`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from featherstone_gait.base.arguments import real, truth, whole
from featherstone_gait.search.generations import Generations, check_finite, check_start
from featherstone_gait.search.inverted import Evaluate, inverted


def dual_annealing(
    x0: ArrayLike, *, bounds: ArrayLike, seed: int = 0, initial_temp: float = 5230.0, local_search: bool = False
) -> Generations:
    """Return the search, from `x0` (D,) within finite `bounds` (D, 2); it has no end.

    `initial_temp` is SciPy's; SciPy's visiting steps scale with it, not with the box.  `local_search` turns L-BFGS-B
    with differences over 1e-8 on, as is SciPy's default: for costs that are smooth on that scale, which a gait's with
    its impacts is not.  A start whose cost is not finite is left by wandering until one is.  Raises ValueError for
    bounds that are not finite or do not hold x0.
    """
    x0, box = check_start(x0, bounds)
    check_finite(box, "dual annealing")
    seed = whole("seed", seed, 0, "any will do", 2**128 - 1)
    initial_temp = real("initial_temp", initial_temp, 0.01, 5e4, "SciPy's range; 5230 is usual")
    local_search = truth("local_search", local_search)

    def minimize(evaluate: Evaluate) -> None:
        optimize.dual_annealing(
            lambda x: evaluate([x])[0], box, x0=x0, rng=np.random.Generator(np.random.PCG64(seed)),
            initial_temp=initial_temp, maxiter=2**62, maxfun=np.inf, no_local_search=not local_search,
        )  # fmt: skip

    return Generations(inverted(minimize), x0)
