"""Adaptive simulated annealing: a random search around the best point so far, with re-heating.

The candidate of iteration ``k`` is ``best + amplitude * u_k / miss`` with ``u_k`` uniform in [-1, 1) per component.
A lower cost is accepted and sets ``miss`` to 1; any other adds 1 to it, so that the search narrows; when it reaches
``max_miss`` it drops to 0.1, which throws the next candidate ten amplitudes wide.  Despite the name there is no
temperature, and nothing worse is ever accepted.

Reference: J. Lima et al., "Humanoid gait optimization resorting to an improved simulation model", Int. J. Advanced
Robotic Systems 10 (2013), figure 14.  Corrections of the printed pseudo-code:

- ``neighbor(s) / miss`` would shrink the state itself: only the perturbation is divided;
- ``s`` is never updated: candidates are drawn around the best state;
- the best cost is never initialized: the initial state is evaluated first, as iteration 0;
- ``miss = MAXMISS`` is tested for equality, which 0.1, 1.1, 2.1, ... never meet, so that re-heating happens once:
  ``>=`` is used;
- ``MISS`` and ``miss`` are the same variable;
- the loop ends at KMAX where the text ends "after a predetermined number of iterations without progress": both;
- ``return`` stands inside the loop;
- a cost that is not a number compares as neither better nor worse: not a number and infinity are misses.

The noise ``u_k`` is a function of (seed, k) alone and ``miss`` of the history of misses.  Hence the candidates that may
come are known in advance and can be evaluated at once, in batches that assume that all miss or as `speculation` orders
them, and the sequence of visited states does not depend on which are.  The cost is taken to be deterministic: one lucky
noisy value would stay the best for ever.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, is_whole, shown
from .ask_tell import AskTell, check_start

SEEDS = 2**128  # of Philox
REHEATED = 0.1  # miss count after max_miss misses (figure 14)
MESSAGES = {
    0: "max_iterations reached",
    1: "no progress for no_progress iterations",
    2: "interrupted; the best so far is returned",
    3: "stopped by the callback",
}


class Visit(NamedTuple):
    """A visited state of the search."""

    iteration: int
    x: np.ndarray  # (D,)
    f: float
    miss: float  # that divided its perturbation
    accepted: bool


class AdaptiveSimulatedAnnealing(AskTell):
    """Adaptive simulated annealing as an ask-and-tell search, one candidate or a speculative batch at a time.

    Candidates beyond a bound are reflected at it: clipping would collect them on the bounds, where half of all later
    perturbations of that component are lost.

    Parameters
    ----------
    x0 : array_like, shape (D,)
        First vector.
    amplitude : float or array_like, shape (D,)
        Amplitude of the perturbation, in the units of x0.
    max_miss : int
        Misses in a row after which the search widens.
    max_iterations : int
        Number of candidates after x0.
    no_progress : int
        Misses in a row after which the search ends.
    bounds : array_like, shape (D, 2), optional
        Lower and upper bounds.
    seed : int
        Seed, below 2**128.

    Attributes
    ----------
    best_x : ndarray, shape (D,)
        The best vector.
    best_f : float
        Its cost.
    visited : list of Visit
        All visited states.
    wasted : int
        Evaluations of candidates that were not visited.
    """

    def __init__(
        self,
        x0: ArrayLike,
        *,
        amplitude: ArrayLike,
        max_miss: int = 20,
        max_iterations: int = 3000,
        no_progress: int = 500,
        bounds: ArrayLike | None = None,
        seed: int = 0,
    ) -> None:
        self.x0, box = check_start(x0, bounds, amplitude, room=False)
        self.bounds = None if bounds is None else box
        self.amplitude = np.array(np.broadcast_to(floats("amplitude", amplitude), self.x0.shape))
        self.max_miss, self.max_iterations, self.no_progress, self.seed = max_miss, max_iterations, no_progress, seed
        for name, least in (("max_miss", 2), ("max_iterations", 0), ("no_progress", 1), ("seed", 0)):
            value = getattr(self, name)
            if not is_whole(value) or not least <= value < SEEDS:
                raise ValueError(f"{name} = {shown(value)} must be a whole number >= {least} and below 2**128")
            setattr(self, name, int(value))
        self.best_x, self.best_f = self.x0.copy(), np.inf
        self.iteration = 0  # of the next candidate; 0 is x0
        self.miss = 1.0
        self.since_progress = 0
        self.wasted = 0  # evaluations begun for candidates that were not visited
        self.visited: list[Visit] = []  # every Visit so far
        self._asked: list[np.ndarray] = []

    @property
    def status(self) -> int | None:
        """None while there is more to do, else the key of `MESSAGES`."""
        return self.ends(self.iteration, self.since_progress)

    def ends(self, iteration: int, since_progress: int) -> int | None:
        """Return the `status` before a candidate of an iteration, so many misses after the last improvement."""
        if iteration > self.max_iterations:
            return 0
        return 1 if since_progress >= self.no_progress else None

    def candidate(self, iteration: int, best_x: np.ndarray, miss: float) -> np.ndarray:
        """Return the candidate (D,) of an iteration around `best_x`."""
        if iteration == 0:
            return self.x0.copy()
        x = best_x + self.amplitude * _noise(self.seed, iteration, len(self.x0)) / miss
        return x if self.bounds is None else _reflect(x, *self.bounds.T)

    def after(self, iteration: int, miss: float, since_progress: int, better: bool) -> tuple[int, float, int]:
        """Return iteration, miss and misses since progress after a candidate that is the new best or not."""
        if better or iteration == 0:
            return iteration + 1, 1.0, 0
        return iteration + 1, REHEATED if miss + 1.0 >= self.max_miss else miss + 1.0, since_progress + 1

    def ask_batch(self, k: int) -> list[np.ndarray]:
        """Return up to `k` next candidates as they will be if all miss; fewer if the search would end before."""
        if self.status is not None:
            raise RuntimeError(f"the search is over: {MESSAGES[self.status]}")
        place, self._asked = (self.iteration, self.miss, self.since_progress), []
        while len(self._asked) < k and self.ends(place[0], place[2]) is None:
            self._asked.append(self.candidate(place[0], self.best_x, place[1]))
            place = self.after(*place, False)
        return [x.copy() for x in self._asked]

    def tell_batch(self, fs: Sequence[float]) -> int:
        """Take the costs of the candidates of `ask_batch`, up to the first improvement; return how many were taken.

        The others were drawn around a state that is no longer the best; they are dropped and counted as wasted.
        Raises ValueError unless there is one cost a candidate.
        """
        asked, taken = self._told(fs), 0
        for x, f in zip(asked, fs):
            first, better = self.iteration == 0, bool(np.isfinite(f) and f < self.best_f)
            if better:
                self.best_x, self.best_f = x, float(f)
            self.visited.append(Visit(self.iteration, x, float(f), self.miss, better))
            place = self.after(self.iteration, self.miss, self.since_progress, better)
            self.iteration, self.miss, self.since_progress = place
            taken += 1
            if better and not first:
                break
        self.wasted += len(asked) - taken
        return taken


def _noise(seed: int, iteration: int, n: int) -> np.ndarray:
    """Return n numbers uniform in [-1, 1) that depend on seed and iteration alone.

    They come from Philox's raw 64 bits, which NumPy guarantees to keep, unlike the results of its distributions.
    """
    raw = np.random.Philox(key=seed, counter=[0, iteration, 0, 0]).random_raw(n)
    return (raw >> np.uint64(11)) * 2.0**-52 - 1.0


def _reflect(x: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Fold `x` back between its bounds, as often as it takes; infinite bounds fold nothing."""
    x = np.where(x < lower, 2.0 * lower - x, x)
    x = np.where(x > upper, 2.0 * upper - x, x)
    outside = (x < lower) | (x > upper)
    if outside.any():
        a, width = lower[outside], (upper - lower)[outside]
        turn = np.mod(x[outside] - a, 2.0 * width, where=width > 0.0, out=np.zeros_like(a))
        x[outside] = a + np.minimum(turn, 2.0 * width - turn)
    return np.clip(x, lower, upper)  # against the last bit
