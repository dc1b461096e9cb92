"""Independent coordinates, linear models and equilibria of robots with loops."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from test_loops import (
    closed_rates,
    four_bar_angles,
    piston_rate,
    rod_rate,
    rods_on_an_ankle,
    slider_crank,
    slider_crank_height,
    slider_crank_inertia,
    slope,
)
from test_loops_in_time import at_crank, servo_four_bar

from featherstone_gait import (
    Ground,
    Joint,
    Link,
    Loop,
    Model,
    Reference,
    close_loops,
    compile_scene,
    degrees_of_freedom,
    energy,
    forward_dynamics,
    forward_kinematics,
    independent_coordinates,
    initial_state,
    inverse_dynamics,
    linearize,
    load_robot,
    loop_jacobian,
    mass_matrix,
    simulate,
    trim,
)
from featherstone_gait.base.rotation import rotation_from_quaternion, rpy_from_rotation
from featherstone_gait.robot_file.servos import with_servo

G = 9.81  # [m/s^2]


def test_a_slider_crank_has_the_inertia_of_its_closed_form_by_its_crank():
    model, x, rate = slider_crank(), 0.7, 2.0
    q, ratios = at_crank(x), np.array([1.0, rod_rate(x), piston_rate(x)])
    free = independent_coordinates(model, q, rate * ratios, independent=["crank"])
    assert free.indices.tolist() == [0]
    np.testing.assert_allclose(free.matrix[:, 0], ratios, rtol=1e-14)
    np.testing.assert_allclose(free.bias, [0.0, *(rate**2 * slope(f, x) for f in (rod_rate, piston_rate))], rtol=1e-13)
    inertia = free.matrix.T @ mass_matrix(model, q) @ free.matrix
    assert inertia[0, 0] == pytest.approx(slider_crank_inertia(x), rel=1e-14)
    a = forward_dynamics(model, q, rate * ratios, [1.5, 0.0, 0.0])  # by a torque of 1.5 N m on the crank
    assert free.matrix.T @ inverse_dynamics(model, q, rate * ratios, a) == pytest.approx(1.5, rel=1e-13)
    np.testing.assert_allclose(free.matrix @ a[free.indices] + free.bias, a, rtol=1e-12)


def test_independent_coordinates_move_a_floating_robot_as_its_loops_let_it(tmp_path):
    model, q = rods_on_an_ankle(tmp_path)
    qd, tau = closed_rates(model, q, 3), np.cos(np.arange(model.nv))
    free = independent_coordinates(model, q, qd)
    assert len(free.indices) == degrees_of_freedom(model, q) == model.nv - 6
    np.testing.assert_allclose(free.matrix @ qd[free.indices], qd, rtol=0, atol=1e-12)
    assert np.abs(loop_jacobian(model, q) @ free.matrix).max() < 1e-14
    M, still = free.matrix.T @ mass_matrix(model, q) @ free.matrix, inverse_dynamics(model, q, qd, free.bias)
    a = free.matrix @ np.linalg.solve(M, free.matrix.T @ (tau - still)) + free.bias
    np.testing.assert_allclose(forward_dynamics(model, q, qd, tau), a, rtol=1e-10, atol=1e-10)


def test_joints_that_depend_on_each_other_cannot_all_be_independent():
    model = slider_crank()
    with pytest.raises(ValueError, match="velocities of 'crank', 'piston' depend on each other; leave out 'piston'"):
        independent_coordinates(model, at_crank(0.7), independent=["crank", "piston"])
    with pytest.raises(ValueError, match="no moving joint 'wheel'"):
        independent_coordinates(model, at_crank(0.7), independent=["wheel"])


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "rk4"])
def test_a_hanging_slider_crank_swings_with_the_frequency_of_its_closed_form(integrator):
    model, x = slider_crank(), np.pi / 2  # angles turn x to -z
    frequency = G * slope(lambda x: slope_of(slider_crank_height, x), x) / slider_crank_inertia(x)
    scene = compile_scene(model, integrator=integrator, timestep=1e-3)
    found = linearize(scene, initial_state(scene, at_crank(x)))
    assert found.states == ("q rod", "qd rod")  # its rate is that of the crank, backward
    exact = expm(np.array([[0.0, 1.0], [-frequency, 0.0]]) * found.period)
    np.testing.assert_allclose(found.A, exact, rtol=0, atol=1e-9)
    assert (np.abs(found.A - exact) <= found.A_error + 1e-12).all()
    by_torque = -np.array([[0.5 * found.period**2], [found.period]]) / slider_crank_inertia(x)
    np.testing.assert_allclose(found.B[:, :1], by_torque, rtol=1e-4)


def slope_of(f, x, h=1e-4):
    """Derivative of a function of one number, to the fourth order, for where complex numbers nest."""
    return (8.0 * (f(x + h) - f(x - h)) - f(x + 2 * h) + f(x - 2 * h)) / (12.0 * h)


@pytest.mark.long
def test_a_weld_leaves_a_floating_robot_the_motion_of_one_body():
    box = {"inertia": (0.02, 0.001, 0.0, 0.03, 0.002, 0.04)}
    links = Link("body", 2.0, **box), Link("arm", 1.0, (0.1, 0.0, 0.0), **box)
    hinge = Joint("hinge", "continuous", "body", "arm", (0.3, 0.1, 0.0), axis=(0.6, 0.0, 0.8))
    weld = Loop("weld", "weld", "arm", "body", (0.0, 0.0, 0.0), (0.3, 0.1, 0.0))
    welded = Model("welded", links, (hinge,), loops=(weld,), base="floating")
    whole = Model("whole", links, (replace(hinge, type="fixed"),), base="floating")
    q, qd = [0.1, 0.2, 0.3, 0.8, 0.0, 0.6, 0.0], [0.1, -0.2, 0.3, 3.0, 1.0, -2.0]
    found = []
    for model, joint in ((welded, [0.0]), (whole, [])):
        scene = compile_scene(model, integrator="dop853", timestep=1e-2)
        found.append(linearize(scene, initial_state(scene, q + joint, qd + joint), inputs=["torque"]))
    assert found[0].states == found[1].states
    assert len(found[0].states) == 12
    np.testing.assert_allclose(found[0].A, found[1].A, rtol=0, atol=1e-9)
    x = 0.1 * np.cos(np.arange(12))
    np.testing.assert_allclose(found[0].deviation(found[0].moved(x)), x, rtol=0, atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("gearbox", ["standard", "mipsd"])
def test_one_servo_holds_a_four_bar_with_the_torque_of_its_closed_form(gearbox):
    model, x = servo_four_bar(), 1.0
    gravity = (0.0, 0.0, -1.0)  # the servo is a weak one
    scene = compile_scene(model, gearbox, None, "implicit_euler", 1e-3, gravity)
    found = trim(scene, four_bar_angles(x))
    assert found.ok, found.message
    assert found.torque[1:].tolist() == [0.0, 0.0]

    by_angle = slope_of(lambda x: energy(model, four_bar_angles(x), np.zeros(3), gravity=gravity).potential, x)
    assert found.torque[0] == pytest.approx(by_angle, rel=1e-8)
    linear = linearize(scene, found.state, found.reference)
    assert [name for name in linear.states if name.startswith("q")] == ["q crank", "qd crank"]
    assert np.abs(linear.change).max() < 1e-9
    run = simulate(scene, 1.0, found.state, Reference([0.0], found.reference[None]), record=("q",))
    assert np.ptp(run["q"], axis=0).max() < 1e-9


@pytest.mark.long
def test_without_servos_the_least_torques_hold_a_robot_with_loops():
    model, q = slider_crank(), at_crank(0.7)
    found = trim(compile_scene(model, integrator="rk4", timestep=1e-3), q)
    assert found.ok, found.message
    ratios = np.array([1.0, rod_rate(0.7), piston_rate(0.7)])
    assert found.torque @ ratios == pytest.approx(G * slope(slider_crank_height, 0.7), rel=1e-12)
    np.testing.assert_allclose(np.cross(found.torque, ratios), 0.0, atol=1e-12)  # the loop's forces bear all else


@pytest.mark.long
def test_a_rod_between_its_shanks_helps_a_humanoid_to_stand():
    model = load_robot("humanoid", locked="simplified")
    alone = compile_scene(model, "mipsd", Ground(), "implicit_euler", 1e-3)
    stand = trim(alone)
    places = forward_kinematics(model, stand.q)
    ends = [places.position[model.link_index(f"{side}_shank")] for side in ("left", "right")]
    rod = Loop("rod", "distance", "left_shank", "right_shank", distance=float(np.linalg.norm(ends[0] - ends[1])))
    scene = compile_scene(replace(model, loops=(rod,)), "mipsd", Ground(), "implicit_euler", 1e-3)
    found = trim(scene, stand.q)
    assert found.ok, found.message
    assert np.linalg.norm(found.torque) < np.linalg.norm(stand.torque)
    run = simulate(scene, 0.5, found.state, Reference([0.0], found.reference[None]), record=("q", "loop_force"))
    assert np.ptp(run["q"], axis=0).max() < 1e-9
    assert np.ptp(run["loop_force"][1:], axis=0).max() < 1e-6


@pytest.mark.long
def test_joints_without_motors_that_loops_do_not_hold_are_told():
    model = servo_four_bar()
    loose = Joint("loose", "revolute", "rocker", "weight", axis=(0.0, 1.0, 0.0), lower=-9.0, upper=9.0)
    hung = replace(model, links=(*model.links, Link("weight", 0.1, (0.1, 0.0, 0.0))), joints=(*model.joints, loose))
    scene = compile_scene(hung, "mipsd", None, "implicit_euler", 1e-3)
    found = trim(scene, [*four_bar_angles(1.0), 0.0])
    assert found.status == "too weak"
    assert "loose" in found.message


@pytest.mark.long
def test_a_robot_hangs_from_the_world_by_its_feet():
    model = load_robot("humanoid", locked="simplified")
    q = np.concatenate([[0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0], np.zeros(len(model.joint_names))])  # upside down
    places = forward_kinematics(model, q)
    feet = [model.link_index(f"{side}_foot") for side in ("left", "right")]
    soles = [Loop(f"sole {k}", "weld", model.links[k].name, None, (0.0, 0.0, 0.0), tuple(places.position[k]),
                  rpy_b=tuple(rpy_from_rotation(places.rotation[k]))) for k in feet]  # fmt: skip
    found = trim(compile_scene(replace(model, loops=tuple(soles)), None, None, "implicit_euler", 1e-3), q)
    assert found.ok, found.message
    assert found.residual < 1e-10
    assert 0.0 < np.abs(found.torque).max() < 0.5


@pytest.mark.long
def test_a_ball_joint_is_held_by_the_moment_of_the_weight_in_its_axes():
    bob = Link("bob", 2.0, (0.3, 0.1, -0.2), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    hung = Model("hung", (Link("wall"), bob), (Joint("ball", "ball", "wall", "bob"),))
    q = np.array([0.5, 0.5, -0.5, 0.5])
    found = trim(compile_scene(hung, integrator="rk4", timestep=1e-3), q)
    assert found.ok, found.message
    R = rotation_from_quaternion(q)
    moment = np.cross([0.3, 0.1, -0.2], R.T @ [0.0, 0.0, 2.0 * G])
    np.testing.assert_allclose(found.torque, moment, rtol=1e-12, atol=1e-12)


@pytest.mark.long
def test_a_servo_holds_a_linkage_whose_rod_turns_on_ball_joints():
    """An RSSR linkage: crank and rocker turn about skew axes, the rod's ball joints have no motors."""
    light = {"mass": 0.1, "inertia": (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)}
    links = Link("wall"), Link("crank", **light), Link("rod", **light), Link("rocker", 0.3, (0.1, 0.0, 0.0), **{
        "inertia": (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3)})  # fmt: skip
    free = {"lower": -9.0, "upper": 9.0}
    joints = (
        Joint("crank", "revolute", "wall", "crank", axis=(0.0, 1.0, 0.0), **free),
        Joint("ball", "ball", "crank", "rod", (0.1, 0.0, 0.0)),
        Joint("rocker", "revolute", "wall", "rocker", (0.3, 0.1, 0.0), axis=(1.0, 1.0, 0.0) / np.sqrt(2.0), **free),
    )
    pin = Loop("pin", "connect", "rod", "rocker", (0.3, 0.0, 0.0), (0.1, 0.0, 0.1))
    model = with_servo(Model("RSSR", links, joints, loops=(pin,)), "ax12")
    model = replace(model, servos={"crank": model.servos["crank"]})
    q = close_loops(model, [0.3, 1.0, 0.0, 0.0, 0.0, 0.0])
    found = trim(compile_scene(model, "mipsd", None, "implicit_euler", 1e-3), q)
    assert found.ok, found.message
    named = dict(zip(model.joint_names, found.torque))
    assert [name for name, torque in named.items() if torque] == ["crank"]

    def potential(x):
        posture = close_loops(model, np.concatenate([[x], q[1:]]), joints=model.joint_names[1:])
        return energy(model, posture, np.zeros(model.nv)).potential

    assert named["crank"] == pytest.approx((potential(q[0] + 1e-4) - potential(q[0] - 1e-4)) / 2e-4, rel=1e-5)
