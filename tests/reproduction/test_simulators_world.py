"""Section 2: rows are judged by the errors that they may have, and all of them are in the report."""

import math

import numpy as np
import pytest

from featherstone_gait.reproduction import simulators_world as world

ROW = world.Row("blimp", "speed", "m/s", 2.0, 2.0 * (1 + 5e-4), 2.0 * (1 - 5e-6))
COURSE = world.Course("a", "time [s]", "speed [m/s]", (np.arange(3.0), np.ones(3)), (np.arange(2.0), np.ones(2)))


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({}, "reproduced"),
        ({"default": 2.0 * (1 + 2e-3)}, "not reproduced"),
        ({"tight": 2.0 * (1 + 2e-5)}, "not reproduced"),
        ({"tight": 2.0 * (1 + 2e-5), "bar": 1e-4}, "reproduced"),
        ({"default": math.nan}, "not reproduced"),
        ({"default": 2.002, "scale": 1e3}, "reproduced"),
    ],
)
def test_a_robot_agrees_if_both_runs_are_within_what_its_row_may_have(change, verdict):
    result = world.SimulatorsWorldResult(world.QUICK, (ROW, ROW._replace(**change)), (COURSE,))
    (claim,) = world.check(result)
    assert (claim.item, claim.verdict) == ("Section 2", verdict)
    assert "5e-04, 5e-06" in claim.ours
    assert all(figure.axes for figure in world.plot(result).values())


@pytest.mark.long
@pytest.mark.parametrize("case", [world.line_follower, world.omni_robot, world.rays, world.blimp, world.vehicle])
def test_scenes_agree_with_their_closed_forms(case):
    rows, courses = case(world.QUICK)
    assert rows
    assert all(row.agrees for row in rows)
    assert courses
