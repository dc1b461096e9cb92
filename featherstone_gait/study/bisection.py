"""Where something stops to hold: bisection on a logarithmic scale."""

from __future__ import annotations

import math
from collections.abc import Callable


def largest(
    holds: Callable[[float], bool], low: float, high: float, factor: float = 4.0, width: float = 1.03
) -> tuple[float, float]:
    """The largest x that holds and the smallest that does not, next to each other: they differ by `width` at most.

    The search descends from `high` by `factor` until x holds, then halves the logarithm of the interval.  (nan, low)
    if nothing down to `low` holds, (high, nan) if `high` does.  Where x holds in several intervals one end is found,
    that of an interval which the descent hits.
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
