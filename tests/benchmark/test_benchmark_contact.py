"""Contact beside other engines: the truths of the tests, and that every engine comes near them."""

import math

import numpy as np
import pytest

from featherstone_gait.benchmark import contact
from featherstone_gait.benchmark.contact import Motion, Row, lines, measured, steady, trials


def row(method, setting, error, time=1.0):
    return Row("hard", method, setting, error, math.nan, time)


def test_a_lucky_step_counts_for_nothing():
    rows = [row("ours a", h, error) for h, error in ((4.0, 1e-9), (2.0, 1e-2), (1.0, 1e-3), (0.5, math.nan))]
    assert [point.error for point in steady(rows)] == [math.inf] * 4
    assert [point.error for point in steady(rows[:3])] == [1e-3, 1e-2, 1e-2]


def test_engines_are_compared_at_the_error_that_each_reaches():
    rows = [row("ours a", 1.0, 1e-7, 2.0), row("MuJoCo Euler", 1.0, 1e-5, 3.0), row("Bullet 10", 1.0, 1e-3, 1.0)]
    found = {line.error: line for line in lines(contact.hard(), rows)}
    assert (found[1e-2].ours, found[1e-2].mujoco, found[1e-2].bullet) == (2.0, 1.5, 0.5)
    assert (found[1e-6].ours, found[1e-6].mujoco, found[1e-6].bullet) == (2.0, math.inf, math.inf)
    assert found[1e-6].note == "ours a; none; none"


def test_rigid_motion_has_no_error():
    """Boxes at rest do not move, and in the row the last ball gets the speed of the first."""
    for trial in (contact.hard(), contact.stack()):
        at = np.array([piece.position for piece in trial.pieces])
        assert trial.error(Motion(np.stack([at, at]), np.zeros((2, len(at), 6)))) == 0.0
    velocity = np.zeros((2, 6, 6))
    velocity[0, 0, 0] = velocity[1, 5, 0] = 1.0
    assert contact.elastic().error(Motion(np.zeros((2, 6, 3)), velocity)) == 0.0


def test_a_heap_that_gains_energy_counts_for_nothing():
    trial = contact.heap(2)
    at = np.array([piece.position for piece in trial.pieces])
    still = Motion(np.stack([at, at]), np.zeros((2, len(at), 6)))
    assert trial.error(still) == pytest.approx(0.0, abs=1e-12)
    still.velocity[1, 0, 0] = 100.0
    assert math.isnan(trial.error(still))


# Error that both keep, a method of ours with its setting, and one of MuJoCo.
NEAR = {
    "hard": (1e-4, ("ours implicit_euler, 1e-05 m", 5e-3), ("MuJoCo Euler, stiff", 5e-3)),
    "stack": (1e-4, ("ours implicit_euler, 1e-05 m", 5e-3), ("MuJoCo Euler, stiff", 5e-3)),
    "rolling": (1e-4, ("ours implicit_euler, 1e-05 m", 5e-3)),
    "elastic": (2e-3, ("ours extrapolation", 1e-4), ("MuJoCo Euler", 5e-5)),
    "bouncing": (1e-2, ("ours extrapolation", 1e-4), ("MuJoCo Euler", 5e-5)),
    "222": (2e-3, ("ours implicit_euler, 1e-03 m", 1e-3), ("MuJoCo Euler, stiff", 1e-3)),
}


@pytest.mark.long
@pytest.mark.parametrize("name", NEAR)
def test_engines_come_near_the_truth(name, monkeypatch):
    """With the smallest cube of balls."""
    pytest.importorskip("mujoco")
    error, *wanted = NEAR[name]
    (trial,) = (each for each in trials(2) if each.name == name)
    found = [m._replace(settings=(dict(wanted)[m.name],)) for m in contact.methods(trial) if m.name in dict(wanted)]
    monkeypatch.setattr(contact, "methods", lambda trial: found)
    rows = measured(trial, 1)
    assert len(rows) == len(wanted)
    for each in rows:
        assert each.error < error, each
        assert not each.momentum > 1e-9
