"""Find where a condition stops to hold, by bisection on a logarithmic scale."""

from __future__ import annotations

import math
from collections.abc import Callable


def largest(
    holds: Callable[[float], bool], low: float, high: float, factor: float = 4.0, width: float = 1.03
) -> tuple[float, float]:
    """Find the largest x that holds and the smallest that does not, whose ratio is at most `width`.

    The search descends from `high` by `factor` until x holds, then halves the logarithm of the interval.  It returns
    (nan, low) if nothing down to `low` holds, and (high, nan) if `high` holds.  If x holds in several intervals, it
    finds the end of the one that the descent meets.
    """
    if holds(high):
        return high, math.nan
    bad, good = high, high / factor
    while not holds(good):
        if good <= low:
            return math.nan, low
        bad, good = good, max(good / factor, low)
    while bad > width * good:
        middle = math.sqrt(good * bad)
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good, bad
