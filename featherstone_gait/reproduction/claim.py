"""Claims: what the paper says, what comes out here, and whether the two agree.

A number of the paper is reproduced within the factor or the interval that stands in the code, or it is not reproduced:
no other outcome is open to it.  An order or a sign (which of two is larger, whether something falls) can also be
reproduced "in direction": it holds, but not by the paper's ratio.  A curve that the paper shows as a picture only
has no verdict.  `Claim` refuses every other combination.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from html import escape
from textwrap import fill
from typing import TYPE_CHECKING, Literal

from .items import ITEMS

if TYPE_CHECKING:
    import numpy as np

Verdict = Literal[
    "reproduced", "reproduced in direction", "not reproduced", "undecided", "no curve to compare with"
]  # fmt: skip
NO_CURVE: Verdict = "no curve to compare with"
ANSWERS: dict[Verdict, str] = {  # of a finding of our own, which no one has to reproduce
    "reproduced": "yes",
    "reproduced in direction": "in part",
    "not reproduced": "no",
    "undecided": "undecided",
    NO_CURVE: NO_CURVE,
}
SHADES = {"reproduced": "#1a7f37", "yes": "#1a7f37", "reproduced in direction": "#9a6700", "in part": "#9a6700",
          "not reproduced": "#b42318", "no": "#b42318"}  # fmt: skip


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
        One of `Verdict`.
    why : str
        The rule of the verdict, then the most likely reason.
    item : str
        The item of the paper that it answers, a key of `items.ITEMS`; empty for a question of our own.
    factor : float or None
        Our value over the paper's, if both are one number.
    accepted : (2,) floats or None
        The factors between which the number counts as reproduced; needed where there is a factor.
    order : bool
        Whether the statement is an order or a sign, which alone can be reproduced in direction.
    holds : bool
        Whether it is neither that nor one number: it holds, by the rule in `why`, or it does not.

    Raises
    ------
    ValueError
        If the verdict is not one that the rules allow.
    """

    claim: str
    paper: str
    ours: str
    verdict: Verdict
    why: str
    item: str = ""
    factor: float | None = None
    accepted: tuple[float, float] | None = None
    order: bool = False
    holds: bool = False

    def __post_init__(self) -> None:
        if self.item and self.verdict == "reproduced in direction" and not self.order:
            self._refuse('only an order or a sign is reproduced "in direction"; a number is or is not: give order=True')
        if self.order and self.holds:
            self._refuse("an order can hold in direction: give either order=True or holds=True")
        judged = self.item and self.verdict not in (NO_CURVE, "undecided")
        if judged and self.factor is None and not (self.order or self.holds):
            self._refuse("a number needs its factor and those accepted; of another statement give order or holds=True")
        if self.factor is None:
            return
        if self.accepted is None:
            self._refuse("a number needs the factors between which it is accepted: give `accepted`")
        elif self.verdict == "reproduced" and not self.accepted[0] <= self.factor <= self.accepted[1]:
            self._refuse(f"its factor {self.factor:.3g} is outside of {self.accepted[0]:.3g} to {self.accepted[1]:.3g}")

    def _refuse(self, why: str) -> None:
        raise ValueError(f"the claim {self.claim!r} is {self.verdict!r}: {why}")

    @property
    def place(self) -> int:
        """Where the claim stands in the paper; questions of our own come last."""
        return list(ITEMS).index(self.item) if self.item else len(ITEMS)

    @property
    def stated(self) -> str:
        """The factor as text; empty if there is none."""
        return "" if self.factor is None else f"{self.factor:.2g}"

    @property
    def interval(self) -> str:
        """Between which factors the number is accepted; empty if there is none."""
        return "" if self.accepted is None else f"{self.accepted[0]:.2g} to {self.accepted[1]:.2g}"

    @property
    def word(self) -> str:
        """The verdict as the report shows it."""
        return self.verdict if self.item else ANSWERS[self.verdict]


def number(
    item: str, claim: str, paper: float, ours: float, factor: float, unit: str = "", order: bool = False
) -> Claim:
    """Return a claim of the paper that is a number, reproduced if ours is within a factor of it.

    Parameters
    ----------
    item, claim : str
        As of `Claim`.
    paper, ours : float
        Both numbers, in the same unit.
    factor : float
        Within which ours counts as the paper's.
    unit : str
        What is written after both numbers.
    order : bool
        Whether both are ratios of two things, which are in the same order if both are above 1, or both below.
    """
    ratio, low = ours / paper, 1.0 / factor
    here, there = (f"{x:.3g} {unit}".strip() for x in (ours, paper))
    verdict = classify(low <= ratio <= factor, order and (ours > 1.0) == (paper > 1.0))
    rule = f"Rule: within a factor {factor:g}" + ("; in direction if in the same order." if order else ".")
    return Claim(claim, there, here, verdict, rule, item, ratio, within(factor), order)


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


@dataclass(frozen=True)
class ClaimTable:
    """Claims in the paper's order, ours last: a small table in a notebook, text elsewhere."""

    claims: Iterable[Claim]

    def _repr_html_(self) -> str:
        rows = [[escape(text) for text in ("Item", "Statement", "Paper", "Here", "Factor (accepted)", "Verdict")]]
        for claim in sorted(self.claims, key=lambda claim: claim.place):
            color = SHADES.get(claim.word, "inherit")
            measure = f"{claim.stated} ({claim.interval})" if claim.interval else ""
            rows.append([
                escape(claim.item or "own"),
                f"{escape(claim.claim)}<details><summary>rule and reason</summary>{escape(claim.why)}</details>",
                *map(escape, (claim.paper, claim.ours, measure)),
                f'<b style="color: {color}">{escape(claim.word)}</b>',
            ])  # fmt: skip
        cell = '<{0} style="text-align: left; vertical-align: top; max-width: 24em; white-space: normal">{1}</{0}>'
        lines = ("".join(cell.format("td" if k else "th", text) for text in row) for k, row in enumerate(rows))
        return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"

    def __repr__(self) -> str:
        return format_claims(self.claims)


def _text(claim: Claim) -> str:
    lines = [f"{claim.item}: {claim.claim}" if claim.item else claim.claim]
    if claim.item:
        lines.append(f"  paper: {claim.paper or 'no number'}")
    factor = f" (factor {claim.stated}; accepted {claim.interval})" if claim.interval else ""
    lines += [f"  ours:  {claim.ours}{factor}", f"  {claim.word.upper()}"]
    return "\n".join([*lines, fill(claim.why, 110, initial_indent="  ", subsequent_indent="  ")])


def within(factor: float) -> tuple[float, float]:
    """Return the factors between which a number is accepted: up to `factor` times less or more."""
    return 1.0 / factor, factor


def classify(same: bool | np.bool, alike: bool | np.bool = False, enough: bool = True) -> Verdict:
    """Return the verdict: as the paper says, an order that holds otherwise, or neither; undecided without `enough`."""
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
