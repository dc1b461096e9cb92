"""Contact beside other engines: the truths of the tests, and that every engine comes near them."""

import math

import numpy as np
import pytest

from featherstone_gait.benchmark import contact
from featherstone_gait.benchmark.contact import Motion, trials


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
    "hard": (1e-4, ("implicit_euler, sinks 1e-05 m", 5e-3), ("Euler, stiff", 5e-3)),
    "stack": (1e-4, ("implicit_euler, sinks 1e-05 m", 5e-3), ("Euler, stiff", 5e-3)),
    "rolling": (1e-4, ("implicit_euler, sinks 1e-05 m", 5e-3)),
    "elastic": (2e-3, ("extrapolation", 1e-4), ("Euler", 5e-5)),
    "bouncing": (1e-2, ("extrapolation", 1e-4), ("Euler", 5e-5)),
    "222": (2e-3, ("implicit_euler, sinks 1e-03 m", 1e-3), ("Euler, stiff", 1e-3)),
}


@pytest.mark.long
@pytest.mark.parametrize("name", NEAR)
def test_engines_come_near_the_truth(name):
    """With the smallest cube of balls."""
    pytest.importorskip("mujoco")
    error, *wanted = NEAR[name]
    (trial,) = (each for each in trials(2) if each.name == name)
    found = [m.ready(dict(wanted)[m.name])() for m in contact.methods(trial) if m.name in dict(wanted)]
    assert len(found) == len(wanted)
    for result in found:
        assert result.error < error, result
        if not trial.floor:
            assert float(result.note.rpartition(" ")[2]) < 1e-9  # of the momentum
