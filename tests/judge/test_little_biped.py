"""A biped of 14 XL330 and a network of our own (`tests/support/little_policy.py` says how it was made)."""

import numpy as np
import pytest
from little_policy import answers, gaits, observations, pose_of

from featherstone_gait.benchmark.little_biped import NETWORK, little_biped
from featherstone_gait.judge import Policy, judge, load_policy

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

TILT = slice(2, 8)  # of its observations: gravity and rotation


@pytest.fixture(scope="module")
def robot():
    return little_biped()


@pytest.fixture(scope="module")
def network(robot):
    return load_policy(NETWORK, robot, NETWORK.with_suffix(".toml"))


def test_it_is_of_the_size_of_robots_that_publish_policies(robot, network):
    assert 0.5 < robot.mass < 0.8
    assert len(robot.servos) == len(network.description.joints) == 14
    assert (network.description.size, network.description.rate) == (11, 50.0)


@pytest.mark.long
def test_the_network_is_what_its_making_says(robot, network):
    found = gaits(robot)
    assert np.abs(pose_of(found) - network.description.pose).max() < 1e-4
    seen = observations(np.random.default_rng(1), 500)  # others than those of the fit
    off = network.actions(seen, 0.0) - answers(found, robot, seen)
    assert np.sqrt((off**2).mean()) < 0.02  # [rad]


@pytest.mark.long
def test_it_walks_by_what_it_sees_and_falls_downhill_because_of_the_slope(robot, network):
    """Its inertial sensor is what it walks by: blind it walks in fewer of the same worlds."""

    def blind(observations):
        upright = observations.copy()
        upright[:, TILT] = (0.0, 0.0, -1.0, 0.0, 0.0, 0.0)
        return network.act(upright)

    command = (0.1, 0.0, 0.0)
    seeing = judge(network, robot, 64, 5.0, command, again=8)
    unseeing = judge(Policy(blind, network.description, "blind"), robot, 64, 5.0, command, again=0)
    assert seeing.walking > unseeing.walking + 10
    assert seeing.walking > 50
    low, middle, high = np.quantile(seeing.worlds["energy_per_way"][seeing.verdicts == "walks"], (0.1, 0.5, 0.9))
    assert 30.0 < low < middle < high < 100.0  # [J/m]; the gait alone, on the floor for which it was planned, takes 46
    assert (seeing.agreement.same, seeing.agreement.worlds) == (8, 8)
    assert {"servos.stiffness", "servos.backlash", "supply.voltage"} <= {*seeing.left_out}  # rigid gears, no supply
    hills = {
        "worlds": {"ground": {"slope": {"kind": "uniform", "scale": 0.15, "additive": True}}},
        "sensing": {"mounting": 0.02},
    }
    hilly = judge(network, robot, 64, 5.0, command, doubts=hills, again=0)
    cause = hilly.causes[0]
    assert (cause.name, cause.chance < 1e-3) == ("ground.slope", True)
    assert cause.effect < -0.5
    assert cause.failing < -0.08 < cause.others  # it has no word for downhill
    assert hilly.why().startswith("ground.slope: median -0.1")
