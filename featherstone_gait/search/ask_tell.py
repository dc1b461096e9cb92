"""What searches and those who run them have in common."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

import numpy as np

Answer = float | tuple[float, str]  # a cost, or cost and status
Cost = Callable[[np.ndarray], Answer]  # of a candidate (D,)
Map = Callable[..., Iterable[Answer]]  # `map`, or what an executor has


class Search(Protocol):
    """A search by ask and tell: see `featherstone_gait.search`."""

    best_x: np.ndarray
    best_f: float

    @property
    def status(self) -> int | None:
        """None while there is more to do."""

    def ask_batch(self, k: int) -> list[np.ndarray]:
        """Up to `k` next candidates."""

    def tell_batch(self, fs: Sequence[float]) -> int:
        """Take their costs; of how many is returned."""
