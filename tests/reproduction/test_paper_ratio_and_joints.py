"""Gear ratio and number of joints as causes of instability: the linear map against runs, and where chatter begins."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import Reference, compile_scene, initial_state, simulate
from featherstone_gait.reproduction.ratio_and_joints import (
    QUICK,
    STEP,
    _step_map,
    check,
    growth,
    hold,
    plot,
    robot,
    run,
)

GEARBOXES = ("standard", "rotor", "mipsd")


@pytest.mark.long
@pytest.mark.parametrize("gearbox", GEARBOXES)
@pytest.mark.parametrize(("ratio", "joints", "ticks"), [(100.0, 2, 20), (254.0, 1, 20), (150.0, 4, 1)])
def test_small_motions_are_those_of_the_linear_map(gearbox, ratio, joints, ticks):
    """Without dry friction, of which the map has none: 1e-8 is left for rounding."""
    model = robot((gearbox, ratio, joints))
    servo = replace(next(iter(model.servos.values())), coulomb_friction=0.0)
    model = replace(model, servos=dict.fromkeys(model.joint_names, servo))
    scene = compile_scene(model, gearbox=gearbox, integrator="simtwo", timestep=STEP)
    start = 1e-7 * np.arange(1.0, joints + 1.0)
    upright = Reference([0.0], np.zeros((1, joints)))
    found = simulate(scene, 0.01 * ticks, initial_state(scene, start), upright, record=("q",), estimate_error=False)
    x = np.zeros(7 * joints)
    x[:joints] = start
    if gearbox == "mipsd":
        x[4 * joints : 5 * joints] = start  # the gear begins unwound
    tick = np.linalg.matrix_power(_step_map(model, gearbox, STEP), 10)
    for k in range(ticks):
        x[-joints:] = -servo.controller.Kp * x[:joints]
        x = tick @ x
        np.testing.assert_allclose(found["q"][k + 1], x[:joints], rtol=1e-8, atol=1e-15)


def test_where_linear_theory_puts_the_onset():
    """From h B / 2 > I, with B = (G K)^2 / R and the least inertia I of the chain, but for the current's lag."""
    assert growth(robot(("standard", 254.0, 1)), "standard", STEP) < 1.0
    assert growth(robot(("standard", 254.0, 2)), "standard", STEP) > 100.0
    assert growth(robot(("standard", 100.0, 4)), "standard", STEP) < 1.0
    assert growth(robot(("standard", 150.0, 4)), "standard", STEP) > 100.0
    for gearbox in ("rotor", "mipsd"):
        assert growth(robot((gearbox, 254.0, 7)), gearbox, STEP) < 1.0


@pytest.mark.long
def test_chatter_begins_where_the_onset_is_and_a_rotor_takes_it_away():
    settings = replace(QUICK, duration=4.0)
    tilts = 0.01 * np.random.default_rng(1).standard_normal((2, 4))
    found = {place: hold(place, settings, tilts) for place in (("standard", 100.0, 4), ("standard", 150.0, 4))}
    assert [one.chatters for one in found.values()] == [one.unstable for one in found.values()] == [False, True]
    for gearbox in ("rotor", "mipsd"):
        assert not hold((gearbox, 150.0, 4), settings, tilts).chatters


@pytest.mark.long
def test_verdicts_and_figures():
    """Both of the paper's causes hold, and linear theory is right for every arm."""
    result = run(replace(QUICK, ratios=(100.0, 254.0), joints=(1, 4, 7)))
    claims = check(result)
    assert [claim.item for claim in claims] == ["Section 3", "Abstract", "", ""]
    assert [claim.word for claim in claims] == ["reproduced", "reproduced", "yes", "yes"]
    assert len(plot(result)) == 2
