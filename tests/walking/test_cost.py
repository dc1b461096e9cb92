"""The cost of walking is the energy that the motors take by the way that the robot makes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import ContactPoint, Ground, Link, Model, Reference, Trajectory, compile_scene, load_robot
from featherstone_gait.core.effects.energies import ENERGIES, METER
from featherstone_gait.optimize import walking_cost
from featherstone_gait.run.simulate import simulate, standing_state
from featherstone_gait.walking import write_angles
from featherstone_gait.walking.cost import LOADED, Measures, _slip, cost_of_motion, measured


@pytest.fixture(scope="module")
def cost():
    return walking_cost(load_robot("humanoid", locked="simplified"))


@pytest.fixture(scope="module")
def vectors(cost):
    """The first gait and seven near it."""
    off = np.radians(np.random.default_rng(3).uniform(-1.0, 1.0, (7, 40)))
    return [cost.gait.to_vector(), *(cost.gait.to_vector() + off)]


def test_energy_is_the_integral_of_the_positive_electrical_power(cost, vectors):
    measures = cost.measure(vectors[:1])[0]
    reference = cost.reference(vectors[0], cost.warm_up + cost.strides)
    run = simulate(
        cost.scene, reference.times[-1], standing_state(cost.scene, reference.values[0]), reference,
        record=("voltage", "current"), record_interval=1e-3,
    )  # fmt: skip
    # The voltage of a tick is held over it; the current is that at the end of a step.
    power = np.maximum(run["voltage"][:-1] * run["current"][1:], 0.0).sum(axis=1)
    energy = power[round(cost.mark / 1e-3) :].sum() * 1e-3
    assert measures.energy == pytest.approx(energy, rel=0.01)


def test_cost_speed_and_stride_follow_from_energy_way_and_time():
    measures = Measures("ok", 4, 2.0, 10.0, 0.5, 0.0, 0.001, 20.0)
    assert (measures.cost, measures.speed, measures.stride_length) == (20.0, 0.25, 0.125)
    assert measures.cost_of_transport == 1.0


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (0.0, 0.0, -1.62), (1.2, -0.9, -2.0)])
def test_the_cost_of_transport_is_by_local_weight(cost, gravity):
    base, energy = np.zeros((11, 7)), np.zeros((11, 10, ENERGIES))
    base[:, 0], energy[:, 0, METER] = np.linspace(0.0, 0.5, 11), np.linspace(0.0, 3.0, 11)
    channels = {"base_q": base, "energy": energy, "time": np.linspace(0.0, 1.0, 11)}
    run = Trajectory(channels, "ok", "", 1.0, np.zeros(0))
    found = measured(cost.scene.recompiled(gravity=gravity), run, 0.0, 1.0, 1, slip=False)
    weight = cost.scene.model.mass * math.sqrt(sum(g * g for g in gravity))
    assert found.cost_of_transport == pytest.approx(3.0 / (weight * 0.5), rel=1e-12)


def test_without_weight_the_cost_of_transport_is_infinite():
    assert Measures("ok", 4, 2.0, 10.0, 0.5, 0.0, 0.001, 0.0).cost_of_transport == math.inf


def test_gravity_reaches_the_plan_and_the_scene(cost):
    model = cost.scene.model
    moon = walking_cost(model, gravity=(0.0, 0.0, -1.62), n_steps=24)
    assert moon.scene.gravity.tolist() == [0.0, 0.0, -1.62]
    assert np.abs(moon.gait.poses - walking_cost(model, n_steps=24).gait.poses).max() > 0.01
    with pytest.raises(ValueError, match=r"gravity \(1, 0, -9\.81\) m/s\^2 must point straight down"):
        walking_cost(model, gravity=(1.0, 0.0, -9.81))


def test_measured_are_whole_strides(cost, vectors):
    measures = cost.measure(vectors[:1])[0]
    assert measures.duration == pytest.approx(cost.strides * cost.gait.period, abs=1e-9)


@pytest.mark.long
def test_alone_and_among_others_a_gait_has_the_same_bits(cost, vectors):
    together = cost.measure(vectors)
    assert [cost.measure([x])[0] for x in vectors[:3]] == together[:3]
    assert cost.measure(vectors[::-1]) == together[::-1]
    assert cost.costs(vectors) == [cost(x) for x in vectors]


def test_a_gait_that_falls_costs_infinity_and_says_when(cost):
    poses = cost.gait.poses.copy()
    poses[:, cost.gait.joint_names.index("left_hip_front")] += 0.7
    (measures,) = cost.measure([poses.ravel()])
    assert measures.cost == math.inf
    assert "humanoid fell at" in measures.status
    assert math.isnan(measures.distance)


def test_standing_and_walking_backward_cost_infinity(cost):
    still = np.tile(cost.start[0], 4)
    forward = cost.gait
    backward = forward.from_vector(forward.poses[[0, 3, 2, 1]].ravel()).to_vector()  # the same poses in reverse order
    for x in (still, backward):
        (measures,) = replace(cost, start=cost.start[0], blend_strides=2, warm_up=1, strides=1).measure([x])
        assert measures.cost == math.inf
    (measures,) = replace(cost, start=cost.start[0]).measure([still])
    assert "mm/s forward" in measures.status


def test_slip_is_the_way_of_the_points_that_bear_weight():
    box = Link("box", 1.0, (0.0, 0.0, 0.0), (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3))
    corners = tuple(ContactPoint("box", (x, y, -0.1)) for x in (-0.1, 0.1) for y in (-0.1, 0.1))
    model = Model("box", (box,), (), "floating", contacts=corners)
    n = 11
    base = np.tile([0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0], (n, 1))
    base[:, 0] = np.linspace(0.0, 0.3, n)
    base[:, 1] = np.linspace(0.0, 0.4, n)
    force = np.zeros((n, 4, 3))
    force[:6, :, 0] = 3.0  # the first five of ten samples' ways are made under load
    run = Trajectory({"base_q": base, "q": np.zeros((n, 0)), "contact_force": force}, "ok", "", 1.0, np.zeros(0))
    assert _slip(model, run, slice(0, n), LOADED * 9.81) == pytest.approx(0.25, rel=1e-12)


def test_a_recorded_motion_costs_what_its_gait_costs(cost, vectors, tmp_path):
    x = vectors[0]
    reference = cost.reference(x, cost.warm_up + cost.strides)
    write_angles(tmp_path / "walk.csv", reference.times, reference.values, cost.gait.joint_names)
    found = cost_of_motion(cost.scene, tmp_path / "walk.csv", start=cost.mark, strides=cost.strides)
    expected = cost.measure([x])[0]
    assert found.status == "ok"
    assert found.cost == pytest.approx(expected.cost, rel=1e-6)
    assert found.stride_length == pytest.approx(expected.stride_length, rel=1e-6)
    with pytest.raises(ValueError, match=r"start is 99.0 s; it must lie between"):
        cost_of_motion(cost.scene, tmp_path / "walk.csv", start=99.0)


def test_a_robot_that_cannot_stand_is_refused(cost):
    model = cost.scene.model
    hanging = compile_scene(replace(model, base="fixed"), "mipsd")
    with pytest.raises(ValueError, match="only a floating robot over ground stands"):
        standing_state(hanging, np.zeros(10))


def test_ice_makes_the_feet_slip(cost, vectors):
    model = cost.scene.model
    slippery = replace(cost, scene=compile_scene(model, "mipsd", Ground(friction=0.15), "midpoint", 1e-3))
    (rough,), (smooth,) = cost.measure(vectors[:1]), slippery.measure(vectors[:1])
    assert smooth.status != "ok" or smooth.slip > 2.0 * rough.slip


def test_references_go_out_every_40_ms_joined_by_straight_lines(cost, vectors):
    reference = cost.reference(vectors[0], 3)
    assert isinstance(reference, Reference)
    assert np.diff(reference.times) == pytest.approx(0.04, abs=1e-12)
    assert reference.kind == "linear"
