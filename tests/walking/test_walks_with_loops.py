"""Bipeds whose joints are driven through rods: plans, standing, walks."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import (
    Link,
    Loop,
    Reference,
    compile_scene,
    initial_state,
    load_robot,
    loop_gaps,
    simulate,
    standing_state,
)
from featherstone_gait.crosscheck import replay
from featherstone_gait.model import Ground
from featherstone_gait.optimize import walking_cost
from featherstone_gait.walking import BIOLOID_WALK, walking_plan
from featherstone_gait.walking.walker import driven, with_tied

ARM, LIFT = (-0.017, 0.0, -0.011), (0.0, 0.0, 0.04)  # of the crank, far from in line; of its axis over the knee [m]
LIGHT = 1e-4  # [kg], 1e-4 kg m^2 per kg


def with_rods(model, mass=LIGHT):
    """Drive the knees by cranks on the thighs, over rods that make parallelograms with the shanks."""
    links, joints, loops, servos = [*model.links], [], [], dict(model.servos)
    inertia = {"mass": mass, "inertia": tuple(1e-4 * mass * np.array((1.0, 0.0, 0.0, 1.0, 0.0, 1.0)))}
    for joint in model.joints:
        joints.append(joint)
        if not joint.name.endswith("knee"):
            continue
        side = joint.name.removesuffix("_knee")
        crank, rod = f"{side}_crank", f"{side}_rod"
        links += [Link(crank, **inertia), Link(rod, **inertia)]
        free = {"lower": -np.inf, "upper": np.inf, "type": "continuous"}
        joints.append(replace(joint, name=crank, child=crank, xyz=tuple(np.add(joint.xyz, LIFT))))
        joints.append(replace(joint, name=rod, parent=crank, child=rod, xyz=ARM, rpy=(0.0, 0.0, 0.0), **free))
        loops.append(Loop(rod, "connect", rod, joint.child, tuple(np.negative(LIFT)), ARM))
        servos[crank] = servos.pop(joint.name)
        joints[-3] = replace(joints[-3], effort=np.inf)
    return replace(model, links=tuple(links), joints=tuple(joints), loops=tuple(loops), servos=servos)


@pytest.fixture(scope="module")
def robots():
    model = driven(load_robot("humanoid", locked="simplified"), "ax12")
    return model, with_rods(model)


@pytest.fixture(scope="module")
def plans(robots):
    return [walking_plan(model, **BIOLOID_WALK) for model in robots]


def test_a_plan_turns_the_cranks_of_parallelograms_as_far_as_the_knees(robots, plans):
    (model, rods), (direct, found) = robots, plans
    columns = rods.joint_rows
    for side in ("left", "right"):
        knee, crank, rod = (found.angles[:, columns[f"{side}_{name}"]] for name in ("knee", "crank", "rod"))
        np.testing.assert_allclose(crank, knee, rtol=0, atol=1e-8)
        np.testing.assert_allclose(rod, -knee, rtol=0, atol=1e-8)
        np.testing.assert_allclose(knee, direct.angles[:, model.joint_rows[f"{side}_knee"]], rtol=0, atol=1e-3)


def test_a_robot_with_rods_stands_closed(robots, plans):
    rods = robots[1]
    scene = compile_scene(rods, "mipsd", Ground(), "midpoint", 1e-3)
    posture = plans[1].standing + [0.01 * name.endswith("knee") for name in rods.joint_names]  # not closed
    state = scene.state_view(standing_state(scene, posture))
    assert np.abs(loop_gaps(rods, np.concatenate([state.base_q, state.q]))).max() < 1e-11
    turned = [name in rods.servos for name in rods.joint_names]
    np.testing.assert_array_equal(state.q[turned], posture[turned])  # servos are where they were asked to be


def test_legs_keep_the_joints_that_loops_tie_to_them(robots):
    rods = robots[1]
    assert with_tied(rods, ["left_knee"]) == ("left_knee", "left_crank", "left_rod")
    assert with_tied(rods, ["left_hip_front"]) == ("left_hip_front",)


@pytest.mark.long
def test_a_knee_behind_a_parallelogram_walks_at_the_cost_of_one_that_is_driven_directly(robots):
    measures = []
    for model in robots:
        cost = walking_cost(model, "mipsd")
        measures.append(cost.measure([cost.gait.to_vector()])[0])
    assert [one.status for one in measures] == ["ok", "ok"]
    direct, rods = measures
    assert rods.distance == pytest.approx(direct.distance, rel=0.02)
    assert rods.cost == pytest.approx(direct.cost, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize("gearbox", ["mipsd", "rotor"])
def test_mujoco_moves_a_knee_behind_a_parallelogram_as_this_package(robots, gearbox):
    pytest.importorskip("mujoco")
    hung = replace(with_rods(robots[0], mass=0.1), base="fixed", contacts=())  # MuJoCo's gears shake light ones
    scene, start = compile_scene(hung, gearbox), np.zeros(len(hung.joint_names))
    goal = [-0.5 * (name in hung.servos and name.endswith(("crank", "lateral"))) for name in hung.joint_names]
    reference = Reference([0.0, 0.3], np.array([start, goal]))
    ours = simulate(scene, 0.4, initial_state(scene, start), reference, record=("q",), rtol=1e-8)
    runs = [replay(scene, 0.4, start, reference, timestep=h) for h in (2e-4, 1e-4)]
    assert ours["q"][-1, hung.joint_rows["left_knee"]] < -0.3
    first, second = (np.abs(run["q"] - ours["q"]).max() for run in runs)
    assert second < 1e-3
    assert second < 0.7 * first
