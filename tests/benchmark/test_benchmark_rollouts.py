"""Rollouts at equal error: errors within a program, rates between its steps."""

import math

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.benchmark import rollouts
from featherstone_gait.benchmark.rollouts import Engine, Row, deviation, lines, measured, stands


def row(engine, step, error, time, upright=1.0):
    return Row(engine, step, error, upright, time, 1e3 / time, math.nan, math.nan)


def test_the_rate_at_an_error_lies_between_those_of_the_steps_around_it():
    """A method of second order: half the step takes twice as long and has a quarter of the error."""
    rows = [row("midpoint", h, 1e-3 * h * h, 1.0 / h) for h in (2.0, 1.0, 0.5, 0.25)]
    rows += [row("MuJoCo Euler", h, 1e-3 * h, 10.0 / h) for h in (4.0, 2.0, 1.0, 0.5)]
    rows += [row("MotrixSim", 4.0, math.nan, 0.1), row("MJX implicitfast", 2.0, 1e-6, 0.1, upright=0.5)]
    for line in lines(rows):
        assert line.ours == pytest.approx(1e3 * math.sqrt(line.error / 1e-3), rel=1e-9)
        theirs = 100.0 * line.error / 1e-3 if line.error >= 0.5e-3 else 0.0  # it has no smaller step
        assert line.peer == pytest.approx(theirs, rel=1e-9)
        assert line.note == f"midpoint, {'MuJoCo Euler' if theirs else 'none'}"


def test_errors_count_those_that_stay_upright():
    exact = np.tile([0.0, 0.0, 1.0], (4, 3, 1))
    path = exact + 0.01 * np.arange(4)[:, None, None]
    path[3, 2, 2] = 0.5
    assert stands(path).tolist() == [True, True, True, False]
    assert deviation(path, exact, stands(path)) == pytest.approx(0.01)
    assert math.isnan(deviation(path, None, stands(path)))
    path[:3, 2, 2] = 0.5
    assert math.isnan(deviation(path, exact, stands(path)))


@pytest.mark.long
def test_our_error_and_mujoco_s_shrink_with_the_step(monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.setattr(rollouts, "DURATION", 1.0)
    monkeypatch.setattr(rollouts, "FINEST", 1e-3 / 8.0)
    found = [
        one._replace(steps=(1e-3, 2.5e-4), threads=(1,))
        for one in rollouts.engines(load_robot("humanoid", locked="simplified"))
        if one.name in ("midpoint", "MuJoCo implicitfast")
    ]
    assert all(isinstance(one, Engine) for one in found)
    rows = measured(found, 1)
    assert [one.upright for one in rows] == [1.0] * 4
    for coarse, fine in (rows[:2], rows[2:]):
        assert 0.0 < fine.error < 0.5 * coarse.error < 1e-3
