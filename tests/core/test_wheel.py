"""What turns for long: angles of any size."""

import math

import numpy as np
import pytest

from featherstone_gait.core.compile.elementary import NEAR
from featherstone_gait.model import Joint, Link, Model
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

pytestmark = pytest.mark.nojit

STILL = (0.0, 0.0, 0.0)


def wheel(offset=0.0):
    """A disc of 1 kg that turns without end about y, its center of mass off the axis [m]."""
    disc = Link("disc", 1.0, (0.0, 0.0, -offset), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    hub = Link("hub", 0.0, STILL, (0.0,) * 6)
    return Model("wheel", (hub, disc), (Joint("axle", "continuous", "hub", "disc", axis=(0.0, 1.0, 0.0)),))


def test_a_wheel_turns_for_an_hour():
    """3.6e6 rad at 1000 rad/s, far beyond what the short reduction of an angle takes."""
    scene = compile_scene(wheel(), gravity=STILL, integrator="dop853")
    run = simulate(scene, 3600.0, initial_state(scene, [0.0], [1000.0]), record_interval=900.0, record=("q", "qd"))
    assert run.ok
    np.testing.assert_allclose(run["q"][:, 0], 1000.0 * run["time"], rtol=1e-12)
    np.testing.assert_array_equal(run["qd"], 1000.0)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["midpoint", "extrapolation"])
@pytest.mark.parametrize("turns", [3e4, 1e6, 1.5e8])
def test_a_pendulum_swings_the_same_after_many_turns(integrator, turns):
    """To the rounding of its angle: 1.5e8 turns have a last bit of 1.2e-7 rad."""
    scene = compile_scene(wheel(0.1), integrator=integrator, timestep=1e-3)
    start = 2.0 * math.pi * turns
    near, far = (simulate(scene, 0.2, initial_state(scene, [q])) for q in (0.5, start + 0.5))
    assert abs(start) > NEAR / 2
    assert far.ok
    swing = far["q"][:, 0] - start - near["q"][:, 0]
    assert np.abs(swing).max() < 100 * math.ulp(start)
    assert np.ptp(near["q"]) > 0.1


@pytest.mark.long
def test_an_angle_beyond_all_turns_is_flagged():
    scene = compile_scene(wheel(0.1), integrator="midpoint", timestep=1e-3)
    run = simulate(scene, 0.05, initial_state(scene, [3e9]))
    assert run.status == "diverged"
    assert np.isfinite(run.final).all()
