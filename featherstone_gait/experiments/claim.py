"""What the paper says, what comes out here, and whether that is the same."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["reproduced", "reproduced in direction", "not reproduced"]


@dataclass(frozen=True)
class Claim:
    """One statement of the paper beside our figure for it."""

    claim: str  # the statement, in words
    paper: str  # the paper's value with its unit; "" where it gives none
    ours: str  # our value with its unit and spread
    verdict: Verdict
    why: str  # what the verdict rests on; where it is not "reproduced", the most likely reason


def judged(same: bool, alike: bool = False) -> Verdict:
    """The verdict: the same figure, at least the same direction, or neither."""
    return "reproduced" if same else "reproduced in direction" if alike else "not reproduced"


def plus_minus(value: float, finer: float, form: str) -> str:
    """A figure and how far half the step moves it."""
    return f"{value:{form}} ± {abs(value - finer):.1g}"


def span(values: Collection[float], form: str) -> str:
    """Smallest to largest of those that are finite, and how many are not."""
    finite = [x for x in values if math.isfinite(x)]
    falls = len(values) - len(finite)
    if not finite:
        return "all fall" if falls > 1 else "falls"
    low, high = min(finite), max(finite)
    text = f"{low:{form}} to {high:{form}}" if high > low else f"{low:{form}}"
    return text + (f" ({falls} of {len(values)} fall)" if falls else "")
