"""Minimization of any function of a vector, without knowledge of robots.

All methods are ask-and-tell searches, objects with

    best_x, best_f   the best so far
    status           None while there is more to do
    ask_batch(k)     up to k next candidates, a list of (D,)
    tell_batch(fs)   takes their costs in that order and returns how many it took; the others were asked for on the
                     assumption that the first would not improve, are dropped, and are asked for again if needed
    ask(), tell(x, f)  the same for one

that depend on seed and costs alone, not on the size of the batches.  `run` evaluates one of them, `run_together`
several, such as restarts.  A cost that is not finite is worse than any other.
"""

from .annealing import AdaptiveSimulatedAnnealing
from .cma_es import cma_es
from .minimization import minimize
from .noisy import minimize_noisy
from .run import run, run_together
from .scipy_methods import differential_evolution, dual_annealing

__all__ = [
    "AdaptiveSimulatedAnnealing", "cma_es", "differential_evolution", "dual_annealing", "minimize", "minimize_noisy",
    "run", "run_together",
]  # fmt: skip
