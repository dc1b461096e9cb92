"""What a gait costs in several worlds at once."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.optimize import optimize_gait, walking_cost
from featherstone_gait.run.simulate import simulate, simulate_stream
from featherstone_gait.search import minimize
from featherstone_gait.walking import bounds
from featherstone_gait.walking.cost import measured
from featherstone_gait.walking.cost_in_worlds import (
    BACKLASH,
    FRICTION,
    NOT_EVERYWHERE,
    SINKING,
    CostInWorlds,
    in_worlds,
    variations,
)


@pytest.fixture(scope="module")
def cost():
    return replace(walking_cost(load_robot("humanoid", locked="simplified")), warm_up=1, strides=2)


@pytest.fixture(scope="module")
def three(cost):
    return in_worlds(cost, 3)


def test_the_cost_is_the_mean_and_half_of_what_the_worst_is_above_it(cost, three):
    """Of the runs that each world alone gives."""
    x, alone = cost.gait.to_vector(), []
    for k, scene in enumerate(three.scenes):
        signal = cost.reference(x, cost.warm_up + cost.strides)
        state = three.standing(signal.values[0], k)
        run = simulate(
            scene, cost.end, state, signal, record_interval=0.04, record=("base_q", "energy"), estimate_error=False
        )
        assert run.status in ("ok", "chatter")
        alone.append(measured(scene, replace(run, status="ok"), cost.mark, cost.end, cost.strides, slip=False).cost)
    assert len(set(alone)) == 3
    mean = sum(alone) / 3
    assert three(x) == (pytest.approx(mean + 0.5 * (max(alone) - mean), rel=1e-14), "ok")
    harder = CostInWorlds(cost, three.scenes, three.offsets, penalty=1.0)
    assert harder(x)[0] == pytest.approx(max(alone), rel=1e-14)


def test_a_gait_that_falls_in_one_world_has_no_cost(cost, three):
    """On ice, here."""
    ice = cost.scene.recompiled(ground=replace(cost.scene.ground, friction=0.01))
    slippery = CostInWorlds(cost, [*three.scenes[:2], ice], three.offsets)
    x = cost.gait.to_vector()
    assert [math.isfinite(one.cost) for one in slippery.measure([x])[0]] == [True, True, False]
    assert slippery(x) == (math.inf, NOT_EVERYWHERE)


def test_lanes_that_run_ahead_find_what_one_candidate_at_a_time_finds(cost, three):
    """Also where candidates fall: with 5 degrees some do."""
    ahead = optimize_gait(three, iterations=6, amplitude=math.radians(5.0))
    one = minimize(
        three, cost.gait.to_vector(), amplitude=math.radians(5.0), max_iterations=6,
        bounds=bounds(cost.scene.model, cost.gait),
    )  # fmt: skip
    assert np.array_equal(ahead.history["x"], one.history["x"])
    assert np.array_equal(ahead.history["f"], one.history["f"])
    assert np.isinf(one.history["f"]).any()
    assert np.isfinite(one.history["f"]).any()
    assert ahead.nfev == 7 + ahead.wasted


def test_each_number_is_spread_evenly_over_its_range(cost):
    worlds, offsets = variations(cost.scene, 20, seed=3)
    ground, servos = worlds.ground, worlds.servos
    shares = {
        "penetration": np.log(ground["penetration"] / SINKING[0]) / math.log(SINKING[1] / SINKING[0]),
        "friction": (ground["friction"] - FRICTION[0]) / (FRICTION[1] - FRICTION[0]),
        "gain": (servos["Kp"][:, 0] / 61.0 - 0.9) / 0.2,
        "backlash": servos["backlash"][:, 0] / BACKLASH,
        "mass": (worlds.links["mass"][:, 0] / cost.scene.model.links[0].mass - 0.9) / 0.2,
        "start": 0.5 + offsets[:, 4] / math.radians(2.0),
    }
    for name, share in shares.items():
        assert sorted(np.floor(20.0 * share).tolist()) == list(range(20)), name
    assert (servos["coulomb_friction"] > cost.scene.model.servos[cost.gait.joint_names[0]].coulomb_friction).all()
    again, _ = variations(cost.scene, 20, seed=3)
    other, _ = variations(cost.scene, 20, seed=4)
    assert np.array_equal(again.ground["penetration"], ground["penetration"])
    assert not np.array_equal(other.ground["penetration"], ground["penetration"])


def test_what_does_not_fit_is_refused(cost, three):
    with pytest.raises(ValueError, match=r"offsets have the shape \(3, 10\); expected \(2, 10\)"):
        CostInWorlds(cost, three.scenes[:2], three.offsets)
    with pytest.raises(ValueError, match="count is 0"):
        in_worlds(cost, 0)
    with pytest.raises(ValueError, match="need ground and servos that drive motors"):
        variations(cost.scene.recompiled(load_robot("arm7"), ground=None), 2)
    other = cost.scene.recompiled(timestep=5e-4)
    with pytest.raises(ValueError, match="do not differ in numbers alone"):
        simulate_stream([cost.scene, other], 1.0, None, None, None)
