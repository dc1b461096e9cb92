"""Intervals of shares, and by how much two groups differ."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

Z = 1.959963984540054  # of 95 %
DOUBT = 0.05  # chance at which one of all factors tried stands out by itself
FEWEST = 5  # in the smaller group, below which nothing is said


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927))."""
    if not count:
        return 0.0, 1.0
    share, spread = hits / count, Z * Z / count
    middle = (share + 0.5 * spread) / (1.0 + spread)
    half = Z * math.sqrt(share * (1.0 - share) / count + 0.25 * spread / count) / (1.0 + spread)
    return max(0.0, middle - half), min(1.0, middle + half)


class Cause(NamedTuple):
    """A number that differs between worlds that fail and others."""

    name: str
    effect: float  # Cliff's delta: the chance that it is larger where it fails less the chance that it is smaller
    failing: float  # its medians in both groups
    others: float
    chance: float  # of so large an effect if nothing mattered, by all factors that were tried (Bonferroni)


def cliffs_delta(a: np.ndarray, b: np.ndarray) -> float:
    """Return the share of pairs in which a (m,) is larger than b (n,), less the share in which it is smaller."""
    ordered = np.sort(b)
    below, upto = (np.searchsorted(ordered, a, side) for side in ("left", "right"))
    return float((below.sum() - (len(b) - upto).sum()) / (len(a) * len(b)))


def causes(factors: dict[str, np.ndarray], failing: np.ndarray) -> list[Cause]:
    """Rank factors (n,) by how much they differ between the worlds that fail (n,) bool and the others.

    The chance is that of the test of H. B. Mann and D. R. Whitney, Ann. Math. Stat. 18 (1947), by its normal limit.
    """
    m, n = int(failing.sum()), int((~failing).sum())
    if min(m, n) < FEWEST:
        return []
    found = []
    deviation = math.sqrt((m + n + 1) / (3.0 * m * n))  # of delta where nothing matters
    for name, values in factors.items():
        effect = cliffs_delta(values[failing], values[~failing])
        chance = min(1.0, len(factors) * math.erfc(abs(effect) / deviation / math.sqrt(2.0)))
        found.append(Cause(name, effect, float(np.median(values[failing])), float(np.median(values[~failing])), chance))
    return sorted(found, key=lambda cause: -abs(cause.effect))
