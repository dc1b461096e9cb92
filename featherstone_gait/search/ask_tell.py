"""The interface of ask-and-tell searches, and checks of their arguments."""

from __future__ import annotations

import builtins
from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, shown

Answer = float | tuple[float, str]  # a cost, or cost and status
Cost = Callable[[np.ndarray], Answer]  # of a candidate (D,)
Map = Callable[..., Iterable[Answer]]  # `map`, or what an executor has


class Search(Protocol):
    """An ask-and-tell search: see `featherstone_gait.search`."""

    best_x: np.ndarray
    best_f: float

    @property
    def status(self) -> int | None:
        """None while there is more to do."""

    def ask_batch(self, k: int) -> list[np.ndarray]:
        """Return up to `k` next candidates."""

    def tell_batch(self, fs: Sequence[float]) -> int:
        """Take their costs; return of how many."""


class AskTell:
    """Ask and tell, one candidate at a time, of a search that has `ask_batch` and `tell_batch`."""

    best_f: float
    ask_batch: Callable[[int], list[np.ndarray]]
    tell_batch: Callable[[Sequence[float]], int]
    _asked: list[np.ndarray]

    def ask(self) -> np.ndarray:
        """Return the next candidate (D,).  Raises RuntimeError when the search is over."""
        return self.ask_batch(1)[0]

    def tell(self, x: ArrayLike, f: float) -> bool:
        """Take the cost `f` of the candidate `x` that `ask` returned; return whether it is the new best."""
        if len(self._asked) != 1 or not np.array_equal(x, self._asked[0]):
            raise ValueError("tell: x is not the candidate that was asked for; ask first and tell it unchanged")
        before = self.best_f
        self.tell_batch([f])
        return self.best_f < before

    def _told(self, fs: Sequence[float]) -> list[np.ndarray]:
        """Return the candidates asked for; raise ValueError unless there is one cost a candidate."""
        if len(fs) != len(self._asked) or not self._asked:
            raise ValueError(f"tell_batch: {len(fs)} costs for {len(self._asked)} candidates asked for")
        asked, self._asked = self._asked, []
        return asked


def check_start(
    x0: ArrayLike, bounds: ArrayLike | None, amplitude: ArrayLike | None = None, *, room: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Return `x0` (D,) and `bounds` (D, 2), infinite where None, as arrays of numbers.

    Raises ValueError unless x0 is finite and lies in its bounds, which leave it room if `room`, and `amplitude` is None
    or finite and positive.
    """
    x0 = np.array(floats("x0", x0))
    if x0.ndim != 1 or not len(x0) or not np.isfinite(x0).all():
        raise ValueError(f"x0 must be a finite (D,) array with D > 0, got shape {x0.shape}")
    bounds = np.tile([-np.inf, np.inf], (len(x0), 1)) if bounds is None else np.array(floats("bounds", bounds))
    if bounds.shape != (len(x0), 2):
        raise ValueError(f"bounds must be ({len(x0)}, 2) as x0 is, got {bounds.shape}")
    lower, upper = bounds.T
    outside = ~((lower <= x0) & (x0 <= upper) & ((lower < upper) | (not room)))
    if outside.any():
        i = int(outside.argmax())
        text = "has no room in" if lower[i] == upper[i] else "lies outside"
        raise ValueError(f"x0[{i}] = {x0[i]} {text} its bounds {lower[i]}..{upper[i]}; give bounds around it")
    if amplitude is not None:
        size = floats("amplitude", amplitude)
        if size.shape not in ((), x0.shape) or not (np.isfinite(size) & (size > 0)).all():
            raise ValueError(f"amplitude must be finite and > 0, got {size}; give a number or {x0.shape}")
    return x0, bounds


def check_map(fun: object, map: object) -> None:
    """Raise TypeError for a map that is None, and for a missing function unless the map is not the built-in one."""
    if map is None:
        raise TypeError("map is None; leave it out, or give a function like the built-in map")
    if isinstance(map, type) and not hasattr(map, "__iter__"):
        raise TypeError(f"map is the class {map.__name__}, which gives no costs; give a function like the built-in map")
    if fun is None and map is builtins.map:
        raise TypeError("fun is None; give a function, or a `map` that needs none")


def check_search(name: str, value: object) -> None:
    """Raise TypeError for an object without the methods of a search."""
    if not (callable(getattr(value, "ask_batch", None)) and callable(getattr(value, "tell_batch", None))):
        raise TypeError(f"{name} is {shown(value)}; give a search, such as AdaptiveSimulatedAnnealing(x0, ...)")
