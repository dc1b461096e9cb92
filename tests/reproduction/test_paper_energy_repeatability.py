"""Energy of the same gait, run after run (the paper's Fig. 11)."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.optimize import walking_cost
from featherstone_gait.reproduction.energy_repeatability import (
    ALL,
    EXPLICIT,
    IMPLICIT,
    MODELS,
    QUICK,
    SOURCES,
    check,
    disturbed,
    gait_cost,
    plot,
    run,
)

pytestmark = pytest.mark.long

SHORT = replace(QUICK, runs=16, scales=(0.1,), masses=(0.6,), steps=(2e-3,), strides=2)
CHATTERS = ("standard", EXPLICIT)


@pytest.fixture(scope="module")
def result():
    return run(SHORT)


@pytest.fixture(scope="module")
def cost():
    return gait_cost(SHORT, walking_cost(load_robot("humanoid", locked="simplified")), "mipsd", IMPLICIT)


def test_what_is_put_in_has_the_size_of_the_settings(cost):
    settings = replace(SHORT, runs=40)
    servo = cost.scene.model.servos["left_knee"]
    states, noises = disturbed(settings, cost, "contacts", 0)
    torques = noises[..., 1] * servo.gearbox.ratio * servo.motor_constant / servo.resistance
    # 40 x 500 x 10 normal numbers: their standard deviation is good to 0.2 %.
    assert torques.std() == pytest.approx(0.01 * cost.scene.model.mass * 9.81 * 0.05, rel=0.01)
    assert not noises[..., 0].any()
    assert all(np.array_equal(state, states[0]) for state in states)

    _, noises = disturbed(settings, cost, "encoder and supply", 0)
    assert 0.99 < np.abs(noises[..., 0]).max() / (0.5 * settings.encoder) < 1.0
    assert (noises[..., 1] == noises[..., :1, 1]).all()  # one supply feeds all servos

    states, noises = disturbed(settings, cost, "initial posture", 0)
    angles = np.array([state[slice(*cost.scene.part("q"))] for state in states])
    assert angles.std(axis=0).mean() == pytest.approx(settings.joint_noise, rel=0.1)
    assert not noises.any()


def test_nothing_put_in_nothing_comes_out(cost):
    states, noises = disturbed(SHORT, cost, ALL, 0, 0.0)
    assert not noises.any()
    assert all(np.array_equal(state, states[0]) for state in states)


def test_the_explicit_standard_model_is_chaotic_and_the_others_are_not(result):
    """Single precision's last place moves it by 0.4 % or more, the others by 1e-5 %: a hundred times is off both."""
    round_off = {model: result.scatter(model, "round-off").value for model in MODELS}
    others = [value for model, value in round_off.items() if model != CHATTERS]
    assert round_off[CHATTERS] > 100.0 * max(others)
    assert result.chatters == {model: SHORT.runs if model == CHATTERS else 0 for model in MODELS}


def test_a_sound_model_scatters_in_proportion_a_chaotic_one_does_not(result):
    """16 runs give a standard deviation to 20 %; the ratio of a sound one is of the same draws, better than that."""
    for model in MODELS:
        ratio = result.scatter(model, (ALL, 0.1)).value / result.scatter(model).value
        if model == CHATTERS:
            assert ratio > 0.4
        else:
            assert 0.05 < ratio < 0.2


def test_the_chatter_hangs_on_masses_and_step(result):
    """Some fourfold and more, or it falls; twofold to be safe from the spread of a ratio of 16 runs each."""
    usual = result.scatter(CHATTERS).value
    assert result.scatter(CHATTERS, ("mass", 0.6)).value > 2.0 * usual
    coarse = result.scatter(CHATTERS, ("step", 2e-3)).value
    assert result.fell(CHATTERS, ("step", 2e-3)) > 0 or coarse > 2.0 * usual
    sound = result.scatter(("mipsd", EXPLICIT), ("step", 2e-3)).value
    assert sound < 2.0 * result.scatter(("mipsd", EXPLICIT)).value


def test_implicitly_the_standard_model_repeats_at_least_as_well(result):
    assert result.scatter(("standard", IMPLICIT)).value < result.scatter(("mipsd", IMPLICIT)).value
    assert result.scatter(CHATTERS).value > result.scatter(("mipsd", EXPLICIT)).value


def test_shares_are_those_of_variances(result):
    for model in MODELS:
        shares = result.shares(model)
        assert shares.sum() == pytest.approx(1.0)
        largest = max(SOURCES, key=lambda source: result.scatter(model, source).value)
        assert SOURCES[int(np.argmax(shares))] == largest


def test_it_depends_on_the_seed_alone(cost):
    one, same, other = (disturbed(SHORT, cost, ALL, seed) for seed in (1, 1, 2))
    for a, b, c in zip(one, same, other):
        np.testing.assert_array_equal(a, b)
        assert not np.array_equal(a, c)


def test_claims_and_figures(result):
    claims = check(result)
    assert [claim.verdict for claim in claims[:1] + claims[3:]] == [
        "not reproduced",  # 0.5 % instead of 14.62 %, at our masses and 1 ms
        "not reproduced",  # it is not the servo model
        "reproduced",  # round-off alone
    ]
    assert all(claim.why and claim.ours for claim in claims)
    assert len(plot(result)) == 3
    for figure in plot(result).values():
        figure.draw_without_rendering()
