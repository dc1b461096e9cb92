"""Contact between bodies: every integrator, orders and tolerances, thin plates, stacks, lanes and islands."""

import math

import numpy as np
import pytest
from test_pair_contact import ball_on_ball, on_a_drum
from touching import FIXED_STEPS, Disc, G, law_of, planar, run_of

pytestmark = pytest.mark.long


ACCURACY = [("implicit_euler", 1e-4, 1e-3), ("midpoint", 1e-4, 1e-3), ("rk4", 1e-4, 1e-6), ("ars343", 1e-6, 1e-5),
            ("dop853", 1e-8, 1e-6), ("extrapolation", 1e-8, 1e-6)]  # fmt: skip


def fixed(integrator, step):
    """The step of an integrator of fixed steps, else None."""
    return step if integrator in FIXED_STEPS else None


@pytest.mark.parametrize(("integrator", "step", "error"), ACCURACY)
def test_every_integrator_lets_a_ball_roll_off_another(integrator, step, error):
    scene, rolling = ball_on_ball(0.3, 0.3, integrator=integrator, timestep=fixed(integrator, step))
    run = run_of(scene, 0.3, rtol=step)
    end = planar(rolling, Disc(0.1, math.inf, math.inf), law_of(scene), 0.3, (0.0, -G))
    np.testing.assert_allclose(run["base_qd"][-1, [0, 2, 4]], end[2:5], rtol=error, atol=error)


@pytest.mark.parametrize(("integrator", "step", "error"), [case for case in ACCURACY if case[0] in ("rk4", "dop853")])
def test_what_turns_under_a_ball_turns_the_bristle_with_it(integrator, step, error):
    """Without implicit steps: a drum that turns by ten radians meanwhile."""
    scene, a, velocities = on_a_drum(0.2, 50.0, 1e6, integrator=integrator, timestep=fixed(integrator, step))
    run = run_of(scene, 0.2, velocities, rtol=step)
    end = planar(a, Disc(0.1, math.inf, 1e6, spin=50.0), law_of(scene), 0.2, (0.0, -G))
    np.testing.assert_allclose(run.of("ball")["base_qd"][-1, [0, 2, 4]], end[2:5], rtol=error, atol=error)
