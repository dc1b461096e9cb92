"""Ask-and-tell searches of methods that evaluate whole generations, written as Python generators.

    def method():
        costs = yield candidates      # lists of equal length, any number of times

The candidates of a generation may be asked for in batches of any size; the method continues when it has all costs.
Hence the visited states do not depend on the size of a batch.

A cost that is not finite, such as that of a fall, is passed to the method as `FALLEN`, which is worse than any cost.
SciPy's methods and CMA-ES need a finite number with a finite square.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence

import numpy as np
from numpy.typing import ArrayLike

from .ask_tell import AskTell

Method = Generator[Sequence[np.ndarray], list[float]]

MOST_CANDIDATES = 10**6  # candidates of a generation, or at once
FALLEN = 1e100  # [the cost's unit]


class Generations(AskTell):
    """An ask-and-tell search around a generator; the best is first `x0` (D,) with infinite cost.

    When the method returns, the search is over with status 1.
    """

    def __init__(self, method: Method, x0: ArrayLike) -> None:
        self._method = method
        self.best_x, self.best_f = np.array(x0, dtype=float), np.inf
        self.status: int | None = None
        self._costs: list[float] = []
        self._asked: list[np.ndarray] = []
        self._candidates = self._advance(None)

    def ask_batch(self, k: int) -> list[np.ndarray]:
        """Return up to `k` next candidates, no more than are left of the generation."""
        if self.status is not None:
            raise RuntimeError("the search is over: its method came to an end")
        known = len(self._costs)
        self._asked = self._candidates[known : known + k]
        return [x.copy() for x in self._asked]

    def tell_batch(self, fs: Sequence[float]) -> int:
        """Take the costs of the candidates of `ask_batch`; return how many were taken, which is all of them.

        Raises ValueError unless there is one cost a candidate.
        """
        for x, f in zip(self._told(fs), fs):
            finite = bool(np.isfinite(f))
            if finite and f < self.best_f:
                self.best_x, self.best_f = x.copy(), float(f)
            self._costs.append(min(float(f), FALLEN) if finite else FALLEN)
        if len(self._costs) == len(self._candidates):
            costs, self._costs = self._costs, []
            self._candidates = self._advance(costs)
        return len(fs)

    def _advance(self, costs: list[float] | None) -> list[np.ndarray]:
        """Let the method continue to its next generation."""
        try:
            candidates = next(self._method) if costs is None else self._method.send(costs)
            return [np.array(x, dtype=float) for x in candidates]
        except StopIteration:
            self.status = 1
            return []
