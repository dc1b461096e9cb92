"""The interface of ask-and-tell searches, and checks of their arguments."""

from __future__ import annotations

import builtins
from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

import numpy as np

from featherstone_gait.base.arguments import shown

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
