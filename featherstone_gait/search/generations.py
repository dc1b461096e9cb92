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

from featherstone_gait.base.arguments import floats

Method = Generator[Sequence[np.ndarray], list[float]]

MOST = 10**6  # candidates of a generation
FALLEN = 1e100  # [the cost's unit]


class Generations:
    """An ask-and-tell search around a generator; the best is first `x0` (D,) with infinite cost.

    When the method returns, the search is over with status 1.
    """

    def __init__(self, method: Method, x0: ArrayLike) -> None:
        self._method = method
        self.best_x, self.best_f = np.array(x0, dtype=float), np.inf
        self.status: int | None = None
        self._costs: list[float] = []
        self._asked = 0
        self._candidates = self._advance(None)

    def ask(self) -> np.ndarray:
        """Return the next candidate (D,).  Raises RuntimeError when the search is over."""
        return self.ask_batch(1)[0]

    def ask_batch(self, k: int) -> list[np.ndarray]:
        """Return up to `k` next candidates, no more than are left of the generation."""
        if self.status is not None:
            raise RuntimeError("the search is over: its method came to an end")
        told = len(self._costs)
        asked = self._candidates[told : told + k]
        self._asked = len(asked)
        return [x.copy() for x in asked]

    def tell(self, x: ArrayLike, f: float) -> bool:
        """Take the cost `f` of the candidate `x` that `ask` returned; return whether it is the new best."""
        if self._asked != 1 or not np.array_equal(x, self._candidates[len(self._costs)]):
            raise ValueError("tell: x is not the candidate that was asked for; ask first and tell it unchanged")
        before = self.best_f
        self.tell_batch([f])
        return self.best_f < before

    def tell_batch(self, fs: Sequence[float]) -> int:
        """Take the costs of the candidates of `ask_batch`; return how many were taken, which is all of them.

        Raises ValueError unless there is one cost a candidate.
        """
        if len(fs) != self._asked or not self._asked:
            raise ValueError(f"tell_batch: {len(fs)} costs for {self._asked} candidates asked for")
        self._asked = 0
        for f in fs:
            finite = bool(np.isfinite(f))
            if finite and f < self.best_f:
                self.best_x, self.best_f = self._candidates[len(self._costs)].copy(), float(f)
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


def check_start(
    x0: ArrayLike, bounds: ArrayLike | None, amplitude: ArrayLike | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return `x0` (D,) and `bounds` (D, 2), infinite where None, as arrays of numbers.

    Raises ValueError unless x0 is finite and lies in its bounds and `amplitude` is None or finite and positive.
    """
    x0 = np.array(floats("x0", x0))
    if x0.ndim != 1 or not len(x0) or not np.isfinite(x0).all():
        raise ValueError(f"x0 must be a finite (D,) array with D > 0, got shape {x0.shape}")
    bounds = np.tile([-np.inf, np.inf], (len(x0), 1)) if bounds is None else np.array(floats("bounds", bounds))
    if bounds.shape != (len(x0), 2):
        raise ValueError(f"bounds must be ({len(x0)}, 2) as x0 is, got {bounds.shape}")
    outside = ~((bounds[:, 0] <= x0) & (x0 <= bounds[:, 1]) & (bounds[:, 0] < bounds[:, 1]))
    if outside.any():
        i = int(outside.argmax())
        raise ValueError(f"x0[{i}] = {x0[i]} must lie in bounds that leave it room, got {bounds[i, 0]}..{bounds[i, 1]}")
    if amplitude is not None:
        _check_amplitude(floats("amplitude", amplitude), x0.shape)
    return x0, bounds


def _check_amplitude(amplitude: np.ndarray, shape: tuple[int, ...]) -> None:
    if amplitude.shape not in ((), shape) or not (np.isfinite(amplitude) & (amplitude > 0)).all():
        raise ValueError(f"amplitude must be finite and > 0, got {amplitude}; give a number or {shape}")


def check_finite(bounds: np.ndarray, method: str) -> None:
    """Raise ValueError unless all `bounds` (D, 2) are finite, which `method` needs."""
    infinite = ~np.isfinite(bounds).all(axis=1)
    if infinite.any():
        i = int(infinite.argmax())
        raise ValueError(f"{method} draws from the whole box: bounds[{i}] = {bounds[i].tolist()} must be finite")
