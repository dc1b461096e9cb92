"""Put judgments beside each other: several policies, or one on several servos."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np

from .judgment import LINE, Judgment


def compare(records: Sequence[Judgment]) -> str:
    """Put judgments beside each other as text.

    Parameters
    ----------
    records
        What `judge` has returned.  Of the same robot, seed and number of worlds, the worlds are the same ones, and it
        is counted in how many only one of two policies walks.

    Returns
    -------
    str
        A row for each, why each fails, and for each two the worlds in which only one walks.

    Raises
    ------
    ValueError
        For fewer than two.
    """
    if len(records) < 2:
        raise ValueError(f"records has {len(records)}; give two judgments or more")
    names = [f"{k + 1} {one.policy}" for k, one in enumerate(records)]
    lines = [f"{'policy':24}{'verdict':>11}{'walks':>7}{'95 %':>14}{'m/s':>9}{'W':>7}{'J/m':>7}"]
    for name, one in zip(names, records):
        low, high = one.interval
        speed, power, cost = (one.spread(figure)[0] for figure in ("speed", "power", "energy_per_way"))
        share = f"{100 * low:.0f} to {100 * high:.0f} %"
        walks = f"{100 * one.share:.0f} %"
        lines.append(f"{name[:23]:24}{one.verdict:>11}{walks:>7}{share:>14}{speed:9.3g}{power:7.3g}{cost:7.3g}")
    lines.append("")
    for name, one in zip(names, records):
        lines.append(textwrap.fill(f"{name} on {one.servo}: {one.why()}", LINE, subsequent_indent="  "))
    for a, first in enumerate(records):
        for b, second in enumerate(records[:a]):
            if _same_worlds(first, second):
                one, other = first.verdicts == "walks", second.verdicts == "walks"
                only = int(np.sum(one & ~other)), int(np.sum(other & ~one))
                lines.append(f"{a + 1} walks in {only[0]} worlds in which {b + 1} does not, {b + 1} in {only[1]}")
    return "\n".join(lines)


def _same_worlds(a: Judgment, b: Judgment) -> bool:
    """Return whether two judgments have the same worlds; what is drawn about the numbers of a servo may differ."""
    if (len(a.verdicts), a.robot, a.settings["seed"]) != (len(b.verdicts), b.robot, b.settings["seed"]):
        return False
    both = [name for name in a.factors.keys() & b.factors.keys() if "servos." not in name]
    return all(np.array_equal(a.factors[name], b.factors[name]) for name in both)
