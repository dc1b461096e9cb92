"""Figs. 9, 10, 16: the paper's figures, entered a second time, and ours as in the stored report."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from featherstone_gait.reproduction import gait_optimization, seven_joint_arm

REPORT = Path(__file__).parents[2] / "docs" / "reproduction" / "reproduction.csv"


def stored(experiment, item, model):
    """Return the numbers of ours in the row of the stored report that is of this figure and servo model."""
    with REPORT.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    (text,) = [
        row["here"]
        for row in rows
        if (row["experiment"], row["item"]) == (experiment, item)
        and re.match(rf".*\b{model} model\b|{model} in ", row["claim"], re.IGNORECASE)
        and re.search(r"\d", row["here"])
    ][:1]
    return [float(x) for x in re.findall(r"\d+\.?\d*(?:e[+-]?\d+)?", text)]


def test_the_papers_figures_are_those_that_it_prints():
    assert (seven_joint_arm.PAPER_STANDARD, seven_joint_arm.PAPER_MIPSD) == (8.14, 0.0022)
    found = gait_optimization
    assert (found.PAPER_COST, found.PAPER_STEP, found.PAPER_CONVERGED, found.PAPER_OLD) == (-0.14, 0.13, 800, 2600)


@pytest.mark.long
def test_fig_9_without_a_rotor_the_arm_chatters_by_as_much_as_the_report_says():
    """Both ends of the range over the report's 32 disturbances, to the printed digits.

    Over 32 others the ends are elsewhere: in 30 such sets the lower one between 0.75 and 1.04, the upper one between
    1.78 and 3.32 deg^2, which is within 1.35 and 1.55 times of what is printed.
    """
    printed = stored("seven_joint_arm", "Fig. 9", "standard")[:2]
    runs, others = (
        seven_joint_arm.hold(
            seven_joint_arm.Case(), seven_joint_arm.FULL, np.random.default_rng(seed).standard_normal((32, 7))
        )
        for seed in (0, 1)
    )
    ends, elsewhere = (seven_joint_arm.DEG2 * np.array([x.error.min(), x.error.max()]) for x in (runs, others))
    assert [float(f"{end:.2g}") for end in ends] == printed
    assert (abs(np.log(elsewhere / printed)) < np.log([1.35, 1.55])).all()
    assert set(runs.statuses) == {"chatter"}
