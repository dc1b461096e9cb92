"""What the paper says, what comes out here, and whether that is the same."""

from __future__ import annotations

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
