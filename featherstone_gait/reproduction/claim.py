"""Claims: what the paper says, what comes out here, and whether the two agree."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import numpy as np

Verdict = Literal["reproduced", "reproduced in direction", "not reproduced", "undecided"]
ANSWERS: dict[Verdict, str] = {  # of a finding of our own, which no one has to reproduce
    "reproduced": "yes",
    "reproduced in direction": "in part",
    "not reproduced": "no",
    "undecided": "undecided",
}


@dataclass(frozen=True)
class Claim:
    """A statement of the paper with its figure and ours, or a question of our own.

    Attributes
    ----------
    claim : str
        The statement.
    paper : str
        The paper's value with its unit; empty if it gives none.
    ours : str
        Our value with its unit and spread.
    verdict : str
        "reproduced", "reproduced in direction", "not reproduced" or "undecided".
    why : str
        The rule of the verdict, then the most likely reason.
    item : str
        The item of the paper that it answers, a key of `items.ITEMS`; empty for a question of our own.
    factor : float or None
        Our value over the paper's, if both are one number.
    """

    claim: str
    paper: str
    ours: str
    verdict: Verdict
    why: str
    item: str = ""
    factor: float | None = None

    @property
    def word(self) -> str:
        """The verdict as the report shows it."""
        return self.verdict if self.item else ANSWERS[self.verdict]


def question(claim: str, ours: str, verdict: Verdict, why: str) -> Claim:
    """Return a claim of our own, on which the paper says nothing."""
    return Claim(claim, "", ours, verdict, why)


def format_claims(claims: Iterable[Claim]) -> str:
    """Return claims as text: statement, the paper's figure, ours, the verdict and its reason.

    Parameters
    ----------
    claims : iterable of Claim

    Returns
    -------
    str
    """
    return "\n\n".join(map(_text, claims))


def _text(claim: Claim) -> str:
    lines = [f"{claim.item}: {claim.claim}" if claim.item else claim.claim]
    if claim.item:
        lines.append(f"  paper: {claim.paper or 'no number'}")
    factor = "" if claim.factor is None else f" (factor {claim.factor:.2g})"
    lines += [f"  ours:  {claim.ours}{factor}", f"  {claim.word.upper()}"]
    return "\n".join([*lines, fill(claim.why, 110, initial_indent="  ", subsequent_indent="  ")])


def classify(same: bool | np.bool, alike: bool | np.bool = False, enough: bool = True) -> Verdict:
    """Return the verdict: the same figure, at least the same direction, or neither; undecided without `enough` runs."""
    if not enough:
        return "undecided"
    return "reproduced" if same else "reproduced in direction" if alike else "not reproduced"


def plus_minus(value: float, finer: float, form: str) -> str:
    """Return a figure and how far half the step moves it, unless that is less than half of the last digit."""
    text, error = f"{value:{form}}", abs(value - finer)
    digits = len(text.partition(".")[2]) if "e" not in text else 15
    return text if error < 0.5 * 10.0**-digits else f"{text} ± {error:.1g}"


def span(values: Collection[float], form: str) -> str:
    """Return the smallest to the largest finite value, and how many are not finite."""
    finite = [x for x in values if math.isfinite(x)]
    falls = len(values) - len(finite)
    if not finite:
        return "all fall" if falls > 1 else "falls"
    low, high = min(finite), max(finite)
    text = f"{low:{form}} to {high:{form}}" if high > low else f"{low:{form}}"
    return text + (f" ({falls} of {len(values)} fall)" if falls else "")
