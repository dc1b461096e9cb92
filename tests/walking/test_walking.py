"""The humanoid walks from four poses a stride, in simulation, on soft servos and without feedback."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import Ground, compile_scene, load_robot
from featherstone_gait.optimize import walking_cost
from featherstone_gait.walking import BIOLOID_WALK, mirror_of, walking_plan


@pytest.fixture(scope="module")
def cost():
    return walking_cost(load_robot("humanoid", locked="simplified"))


def test_the_gait_is_four_poses_of_ten_joints_over_whole_ticks(cost):
    assert cost.gait.to_vector().shape == (40,)
    assert cost.gait.period / 0.04 == pytest.approx(round(cost.gait.period / 0.04), abs=1e-12)


def test_the_planned_zmp_stays_25_mm_inside_the_support_polygon():
    plan = walking_plan(load_robot("humanoid", locked="simplified"), **BIOLOID_WALK)
    assert plan.margin().min() > 0.025


def test_forty_strides_without_a_fall_from_the_gait_alone(cost):
    (run,) = cost.simulate([cost.gait.to_vector()], strides=40)
    assert run.status == "ok"
    assert run.end_time > 40 * cost.gait.period
    x = run["base_q"][:, 0]
    per_stride = np.diff(x[:: round(cost.gait.period / 0.01)])[4:]
    assert per_stride.min() > 0.04  # every stride gets ahead: two steps of 25 mm were planned
    assert abs(run["base_q"][-1, 1]) < 0.05 * (x[-1] - x[0])


def test_all_feet_leave_the_ground_and_bear_the_weight_in_turn(cost):
    (run,) = cost.simulate([cost.gait.to_vector()])
    settled = run["time"] > cost.mark
    force = run["contact_force"][settled, :, 0].reshape(-1, 2, 4).sum(axis=2)  # of the left and the right sole
    weight = cost.scene.model.mass * 9.81
    assert ((force == 0.0).mean(axis=0) > 0.2).all()
    assert force.sum(axis=1).mean() == pytest.approx(weight, rel=0.01)


@pytest.mark.quick("midpoint-*")
@pytest.mark.parametrize(("integrator", "timestep"), [("implicit_euler", 2.5e-4), ("midpoint", 2.5e-4)])
def test_smaller_steps_and_another_integrator_walk_the_same(cost, integrator, timestep):
    model, x = cost.scene.model, cost.gait.to_vector()
    fine = replace(cost, scene=compile_scene(model, "mipsd", Ground(), integrator, timestep))
    expected, found = cost.measure([x])[0], fine.measure([x])[0]
    assert found.status == "ok"
    assert found.distance == pytest.approx(expected.distance, rel=0.02)
    assert found.cost == pytest.approx(expected.cost, rel=0.02)


def test_the_mirrored_gait_walks_the_mirrored_way(cost):
    mirror = mirror_of(cost.scene.model)
    gait = replace(cost.gait, poses=mirror(cost.gait.poses))
    here = cost.measure([cost.gait.to_vector()])[0]
    there = replace(cost, gait=gait, start=mirror(cost.start)).measure([gait.to_vector()])[0]
    assert there.distance == pytest.approx(here.distance, rel=1e-6)
    assert there.energy == pytest.approx(here.energy, rel=1e-6)
    assert there.sideways == pytest.approx(-here.sideways, abs=1e-6)


def test_most_gaits_with_all_angles_off_by_up_to_a_degree_walk_too(cost):
    x = cost.gait.to_vector()
    off = np.radians(np.random.default_rng(7).uniform(-1.0, 1.0, (32, 40)))
    walked = [measures.status == "ok" for measures in cost.measure(x + off)]
    assert sum(walked) > 0.75 * len(walked)
