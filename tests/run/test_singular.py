"""Robots whose mass matrix is singular in some postures: they run elsewhere, and say so where they meet one."""

import numpy as np
import pytest
from scenes import gimbal

from featherstone_gait import compile_scene, initial_state, simulate
from featherstone_gait.dynamics import forward_dynamics


def test_a_gimbal_precesses_as_a_free_top_does():
    """Without gravity a symmetric body about its center turns and precesses at constant rates, from any start."""
    across, along, tilt, momentum = 3e-3 + 0.04, 1e-3, 1.0, 5e-2
    rates = [momentum / across, 0.0, momentum * np.cos(tilt) * (1.0 / along - 1.0 / across)]
    scene = compile_scene(gimbal(), gravity=(0.0, 0.0, 0.0))
    start = np.array([0.3, tilt, -0.2])
    run = simulate(scene, 1.0, initial_state(scene, start, rates))
    assert run.ok
    np.testing.assert_allclose(run["q"], start + run["time"][:, None] * rates, atol=1e-5)


@pytest.mark.parametrize("integrator", ["dop853", pytest.param("midpoint", marks=pytest.mark.long)])
def test_a_start_in_gimbal_lock_is_refused_by_name(integrator):
    scene = compile_scene(gimbal(), integrator=integrator)
    with pytest.raises(ValueError, match=r"'yaw'.*'roll'.*pitch at 0 rad.*initial_state"):
        simulate(scene, 0.1)
    with pytest.raises(ValueError, match=r"'yaw'.*'roll'"):
        forward_dynamics(scene.model, *np.zeros((3, 3)))
    forward_dynamics(scene.model, [0.0, 1e-3, 0.0], *np.zeros((2, 3)))


def test_a_run_into_gimbal_lock_ends_there_at_once():
    """The pendulum falls through its lowest point, where the outer and the inner hinge are one."""
    scene = compile_scene(gimbal())
    run = simulate(scene, 2.0, initial_state(scene, [0.3, 1.0, -0.2]), record=("q",), record_interval=0.01)
    assert run.status == "step too small"
    ended = run["time"] > run.end_time + 1e-9
    assert 20 < ended.sum() < 180
    np.testing.assert_array_equal(run["q"][ended], np.tile(run["q"][-1], (ended.sum(), 1)))
    assert all(name in run.message for name in ("'yaw'", "'roll'", "pitch at 3.142 rad"))
    assert run.info["steps"] + run.info["rejected_steps"] < 2e4
