"""Other readings of the paper's search (section 4, Fig. 14), and other values of what it does not state.

Its pseudo-code divides the perturbation by the number of misses in a row, and is read here as `search.annealing` says.
Two more readings are possible:

- the test `miss = MAXMISS` taken literally: the count 0.1, 1.1, 2.1, ... after a re-heating never meets MAXMISS, so
  that no second one comes before the next improvement, and perturbations go on shrinking;
- "the random vector size (D) depends on the number of missed iterations": not the length of the perturbation but the
  number of angles perturbed, all 40 after an improvement, 20 after one miss, one after 40.

Amplitude and MAXMISS are not stated; each is halved and doubled.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..optimize.search import AMPLITUDE, MAX_MISS
from ..search import AdaptiveSimulatedAnnealing
from ..search.annealing import REHEATED
from ..search.speculation import Speculation


class LiteralTest(AdaptiveSimulatedAnnealing):
    """The search that re-heats only where the count of misses equals MAXMISS."""

    def after(self, iteration: int, miss: float, since_progress: int, better: bool) -> tuple[int, float, int]:
        """Return iteration, miss and misses since progress after a candidate that is the new best or not."""
        place, _, since = super().after(iteration, miss, since_progress, better)
        count = 1.0 if since == 0 else miss + 1.0
        return place, REHEATED if count == self.max_miss else count, since


class FewerAngles(AdaptiveSimulatedAnnealing):
    """The search that perturbs D / miss of D components, by the whole amplitude."""

    def candidate(self, iteration: int, best_x: np.ndarray, miss: float) -> np.ndarray:
        """Return the candidate (D,) of an iteration around `best_x`; which components differ is drawn by the seed."""
        if iteration == 0:
            return self.x0.copy()
        n = len(best_x)
        chance = np.random.Philox(key=self.seed, counter=[0, iteration, 1, 0]).random_raw(n)
        chosen = chance.argsort(kind="stable")[: int(np.ceil(n / max(miss, 1.0)))]
        x = best_x.copy()
        x[chosen] = super().candidate(iteration, best_x, 1.0)[chosen]
        return x


class Rule(NamedTuple):
    """How a search perturbs."""

    search: type[AdaptiveSimulatedAnnealing] = AdaptiveSimulatedAnnealing
    amplitude: float = AMPLITUDE  # [rad]
    max_miss: int = MAX_MISS

    @property
    def settings(self) -> dict[str, Any]:
        """The arguments of the search."""
        return {"amplitude": self.amplitude, "max_miss": self.max_miss}


CORRECTED = "as corrected"
RULES = {
    CORRECTED: Rule(),
    "literal test": Rule(LiteralTest),
    "fewer angles": Rule(FewerAngles),
    "amplitude halved": Rule(amplitude=0.5 * AMPLITUDE),
    "amplitude doubled": Rule(amplitude=2.0 * AMPLITUDE),
    "MAXMISS halved": Rule(max_miss=MAX_MISS // 2),
    "MAXMISS doubled": Rule(max_miss=2 * MAX_MISS),
}


def visits(search: AdaptiveSimulatedAnnealing, evaluate: Callable[[Speculation], object]) -> dict[str, np.ndarray]:
    """Make a whole search; return x (n, D), f and accepted (n,) of all visited candidates.

    evaluate: works off the candidates, as of `search.minimize`.
    """
    candidates = Speculation(search)
    evaluate(candidates)
    for _, (f, _) in candidates.visits(wait=False):
        search.tell(search.ask(), f)
    return {name: np.array([getattr(one, name) for one in search.visited]) for name in ("x", "f", "accepted")}
