"""Put judgments beside each other: several policies, one on several servos, or both."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .judgment import LINE, Judgment


class Paired(NamedTuple):
    """Compare two judgments world by world."""

    first: int  # worlds in which only the first walks
    second: int  # only the second
    chance: float  # of so uneven a pair of numbers where neither is better (Q. McNemar, Psychometrika 12 (1947), exact)
    both: int  # worlds in which both walk
    ratio: tuple[float, float, float]  # median and quartiles, over these, of J/m of the first by that of the second


def compare(records: Sequence[Judgment]) -> str:
    """Put judgments beside each other as text.

    Parameters
    ----------
    records
        What `judge` has returned.  Of the same robot, seed and number of worlds, the worlds are the same ones, and each
        two are compared world by world.

    Returns
    -------
    str
        A row for each, with quartiles of the energy by way; why each fails; and for each two the worlds in which only
        one walks, and by how much the energy differs where both walk.

    Raises
    ------
    ValueError
        For fewer than two.
    """
    if len(records) < 2:
        raise ValueError(f"records has {len(records)}; give two judgments or more")
    names = _names(records)
    heads = f"{'':16}{'verdict':>10}{'walks':>7}{'95 %':>13}{'m/s':>8}{'W':>6}{'J/m':>6}{'quartiles':>13}"
    lines = [heads]
    for name, one in zip(names, records):
        low, high = one.interval
        speed, power = (one.spread(figure)[0] for figure in ("speed", "power"))
        cost, first, last = one.spread("energy_per_way")
        share, walks = f"{100 * low:.0f} to {100 * high:.0f} %", f"{100 * one.share:.0f} %"
        spread = f"{first:.3g} to {last:.3g}"
        lines.append(
            f"{name[:15]:16}{one.verdict:>10}{walks:>7}{share:>13}{speed:8.3g}{power:6.3g}{cost:6.3g}{spread:>13}"
        )
    said = [f"{name} on {one.servo}: {one.why()}" for name, one in zip(names, records)]
    for a in range(len(records)):
        for b in range(a):
            found = paired(records[a], records[b])
            if found is not None:
                said.append(_said(a + 1, b + 1, found))
    return "\n".join([*lines, "", *(textwrap.fill(text, LINE, subsequent_indent="  ") for text in said)])


def paired(first: Judgment, second: Judgment) -> Paired | None:
    """Compare two judgments world by world; None if their worlds differ in more than the numbers of servos."""
    if not _same_worlds(first, second):
        return None
    one, other = first.verdicts == "walks", second.verdicts == "walks"
    only = int((one & ~other).sum()), int((other & ~one).sum())
    costs = (record.worlds["energy_per_way"][one & other] for record in (first, second))
    ratio = np.divide(*costs)
    low, middle, high = np.quantile(ratio, (0.25, 0.5, 0.75)).tolist() if len(ratio) else (math.nan,) * 3
    return Paired(*only, _chance(*only), len(ratio), (middle, low, high))


def _said(a: int, b: int, found: Paired) -> str:
    """Say what differs between judgments of these numbers."""
    text = f"{a} walks in {found.first} worlds in which {b} does not, {b} in {found.second}"
    if found.first != found.second:
        text += f" (chance {found.chance:.2g} if neither were better)"
    if found.both:
        middle, low, high = found.ratio
        text += f"; where both walk, in {found.both}, {a} takes {middle:.3g} times the J/m ({low:.3g} to {high:.3g})"
    return text


def _chance(a: int, b: int) -> float:
    """Return the chance that of a + b worlds, each as likely to be of either kind, so few or fewer are of one."""
    n = a + b
    return min(1.0, 2.0 * sum(math.comb(n, k) for k in range(min(a, b) + 1)) / 2**n)


def _names(records: Sequence[Judgment]) -> list[str]:
    """Name judgments by what differs: their policies or their servos, else the policies; numbered."""
    policies = {one.policy for one in records}
    by_servo = len(policies) == 1 and len({one.servo for one in records}) > 1
    return [f"{k + 1} {one.servo if by_servo else one.policy}" for k, one in enumerate(records)]


def _same_worlds(a: Judgment, b: Judgment) -> bool:
    """Return whether two judgments have the same worlds; what is drawn about the numbers of a servo may differ."""
    if (len(a.verdicts), a.robot, a.settings["seed"]) != (len(b.verdicts), b.robot, b.settings["seed"]):
        return False
    both = [name for name in a.factors.keys() & b.factors.keys() if "servos." not in name]
    return all(np.array_equal(a.factors[name], b.factors[name]) for name in both)
