"""Interpolate what an error costs between the settings that were measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

JUMP = 1e3  # of the error, from which on nothing is interpolated


class Point(NamedTuple):
    """Hold a run with one setting of one method."""

    problem: str
    method: str
    setting: float  # step [s] or tolerance
    error: float
    time: float  # of the processor [ms]


def steady(points: Sequence[Point]) -> Iterator[Point]:
    """Yield points whose error is the largest of that and all finer settings: a lucky step counts for nothing."""
    for method in dict.fromkeys(point.method for point in points):
        worst = 0.0
        for point in reversed([point for point in points if point.method == method]):
            worst = max(worst, point.error if point.error == point.error else math.inf)
            yield point._replace(error=worst)


def cost_at(error: float, points: Sequence[Point]) -> float:
    """Return the CPU time [ms] at which one method first has this error; infinite if never."""
    line = sorted(points, key=lambda p: p.setting, reverse=True)
    costs = [p.time for p in line if p.error <= error]
    for a, b in pairwise(line):
        if b.error <= error < a.error < JUMP * b.error:
            share = math.log(a.error / error) / math.log(a.error / b.error)
            costs.append(a.time * (b.time / a.time) ** share)
    return min(costs, default=math.inf)


def cheapest(
    error: float, points: Sequence[Point], problem: str, which: Callable[[str], bool] = bool
) -> tuple[float, str]:
    """Return the least such cost of some methods, and the method; infinite and "none" if none has this error."""
    methods = dict.fromkeys(p.method for p in points if p.problem == problem and which(p.method))
    costs = {name: cost_at(error, [p for p in points if (p.problem, p.method) == (problem, name)]) for name in methods}
    name = min(costs, key=costs.__getitem__, default="none")
    return costs.get(name, math.inf), name if math.isfinite(costs.get(name, math.inf)) else "none"
