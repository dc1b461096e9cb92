"""Figs. 9, 10, 11, 13, Table 3: the paper's figures, entered a second time, and ours as in the stored report."""

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from setups import planned_walk

from featherstone_gait.reproduction import energy_repeatability, posture, seven_joint_arm
from featherstone_gait.reproduction import solver_scatter as solver

REPORT = Path(__file__).parents[2] / "docs" / "reproduction" / "reproduction.csv"
SHORT = replace(solver.FULL, seeds=1)  # of what comes to rest
CHATTER = replace(solver.FULL, seeds=2, duration=10.0, dropped=5.0)


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
    for module in (energy_repeatability, solver):
        assert module.PAPER == {"standard": 0.1462, "mipsd": 0.039}
    assert posture.TABLE_3 == {
        "left_lateral_shoulder": (-45, {"standard": (-45.06, -47.21, 0.39), "mipsd": (-44.96, -45.04, 0.01)}),
        "right_front_shoulder": (25, {"standard": (25.00, 24.13, 0.16), "mipsd": (25.04, 24.97, 0.01)}),
        "right_lateral_shoulder": (25, {"standard": (26.60, 24.15, 0.50), "mipsd": (25.03, 24.96, 0.01)}),
        "left_elbow": (45, {"standard": (48.40, 44.19, 0.84), "mipsd": (45.05, 44.95, 0.01)}),  # Fig. 13
    }


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


@pytest.mark.long
def test_fig_10_with_mipsd_the_arm_comes_to_rest_as_the_report_says():
    """In the paper's kind of program; the seeds differ by less than the printed digits, 2 %."""
    found = solver.hold_arm(SHORT, "mipsd", solver.SolverCase.iterations, seven_joint_arm.LARGE)
    assert found.typical == pytest.approx(stored("solver_scatter", "Fig. 10", "mipsd")[0], rel=0.03)


@pytest.mark.quick("standard")
@pytest.mark.parametrize("gearbox", solver.GEARBOXES)
def test_table_3_and_fig_13_the_joints_move_by_as_much_as_the_report_says(gearbox):
    """The deviations of seeds differ by up to 15 % with the standard model, by 3 % with MIPSD; rounding is 2 %."""
    settings, rtol = {"standard": (CHATTER, 0.25), "mipsd": (SHORT, 0.05)}[gearbox]
    found = solver.hold_posture(settings, gearbox, solver.SolverCase.iterations, 1.0)
    np.testing.assert_allclose(found.typical, stored("solver_scatter", "Table 3", gearbox), rtol=rtol)


@pytest.fixture(scope="module")
def planned():
    return planned_walk()


@pytest.mark.quick("standard")
@pytest.mark.parametrize("gearbox", solver.GEARBOXES)
def test_fig_11_the_energy_scatters_by_as_much_as_the_report_says(planned, gearbox):
    """Deviations of 16 walks differ by some 14 %; the rule's factor of 1.3 is two of these."""
    _, row = solver.walk(SHORT, planned, solver.SolverCase(gearbox), 16)
    assert solver.near(row.cycle, stored("solver_scatter", "Fig. 11", gearbox)[0] / 100.0)
    assert row.fell == 0
