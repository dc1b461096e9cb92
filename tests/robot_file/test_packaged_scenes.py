"""The scenes that come with the package load by name, and move as their closed forms say."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

from featherstone_gait.base.rotation import rotation_from_quaternion
from featherstone_gait.robot_file import RobotFileNotFoundError, load_robot, scene_names
from featherstone_gait.robot_file.scene import load_scene
from featherstone_gait.run.program import load_controller
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

G = 9.81  # [m/s^2]
CONTROLLERS = {"balancer": "balance", "humanoid_and_ball": "kick", "line_follower": "follow"}
MASSES = {"balancer": 1.0, "blimp": 0.345, "line_follower": 1.0, "omni_robot": 2.25, "rov": 10.64}  # [kg]
TIGHT = {"rtol": 1e-8, "estimate_error": False}


def speeds(values, duration=1000.0):
    """Reference of servos that keep speeds, from zero angles."""
    return Reference([0.0, duration], [np.zeros(len(values)), duration * np.asarray(values)])


# ---------------------------------------------------------------------------------------------- files


@pytest.mark.parametrize("name", scene_names())
def test_every_scene_loads_by_its_name(name):
    scene = load_scene(name)
    assert scene.source.endswith(f"{name}_scene.toml")
    for placed in scene.members:
        assert set(placed.model.servos) >= set(placed.model.joint_names)
    assert not any("skipped <collision>" in note for placed in scene.members for note in placed.model.notes)


@pytest.mark.parametrize(("name", "mass"), MASSES.items())
def test_robots_have_the_masses_that_their_files_state(name, mass):
    assert load_robot(name).mass == pytest.approx(mass, rel=1e-12)


def test_a_scene_that_is_not_there_is_refused_with_the_names_of_those_that_are():
    with pytest.raises(RobotFileNotFoundError, match="blimp, "):
        load_scene("zeppelin")


@pytest.mark.parametrize(("name", "function"), CONTROLLERS.items())
def test_controllers_load_by_the_name_of_their_scene(name, function):
    assert load_controller(name).name == function


def test_what_has_no_controller_or_several_is_refused(tmp_path):
    with pytest.raises(ValueError, match="balancer, humanoid_and_ball, line_follower"):
        load_controller("rov")
    with pytest.raises(ValueError, match=r"x: there is no controller.*balancer.*\.py"):
        load_controller(Path("x"))
    path = tmp_path / "two.py"
    path.write_text("pass\n", "utf-8")
    with pytest.raises(ValueError, match="has 0 controllers"):
        load_controller(path)


def test_the_vehicle_and_the_blimp_weigh_what_their_files_say_of_the_fluid():
    for name, share in (("rov", 0.95), ("blimp", 0.345 / (1.2 * (math.pi * 0.09 * 0.6 + 4 / 3 * math.pi * 0.027)))):
        scene = load_scene(name)
        (placed,) = scene.members
        (immersed,) = placed.model.immersed
        shape = immersed.geometry
        volume = (
            np.prod(shape.size) if name == "rov" else math.pi * shape.radius**2 * (shape.length + 4 / 3 * shape.radius)
        )
        assert placed.model.mass / (scene.fluid.density * volume) == pytest.approx(share, rel=1e-12)


# ---------------------------------------------------------------------------------------------- omni robot

RADIUS, ARM = 0.05, 0.125  # of a wheel, and from the middle to it [m]
AXLES = np.array([0.0, 2.0, -2.0]) * math.pi / 3  # directions of the axles [rad]


def omni_wheels(vx, vy, w):
    """Speeds of the wheels [rad/s] of a robot that moves with (vx, vy) [m/s] and turns with w [rad/s]."""
    return (np.sin(AXLES) * vx - np.cos(AXLES) * vy - ARM * w) / RADIUS


@pytest.fixture(scope="module")
def omni():
    return compile_scene(load_scene("omni_robot"), "rotor")


def in_its_axes(run):
    """Velocity (3,) along the robot's x and y [m/s] and about z [rad/s], at the end."""
    turn = rotation_from_quaternion(run["base_q"].reshape(-1, 7)[-1, 3:])
    v = run["base_qd"].reshape(-1, 6)[-1]
    return np.array([*(turn.T @ v[:3])[:2], v[5]])


@pytest.mark.long
def test_the_omni_robot_goes_along_45_degrees_while_its_rims_slip_across(omni):
    v = 0.15 * np.array([math.cos(math.pi / 4), math.sin(math.pi / 4)])
    run = simulate(omni, 3.0, None, speeds(omni_wheels(*v, 0.0)), record=("base_q", "base_qd", "contact_force", "qd"))
    assert run.ok
    assert in_its_axes(run) == pytest.approx([*v, 0.0], rel=1e-7, abs=1e-9)
    # each rim slips along its axle, where rollers turn freely, so that nothing pulls
    axles = np.column_stack([np.cos(AXLES), np.sin(AXLES)])
    along = np.column_stack([-np.sin(AXLES), np.cos(AXLES)])
    rim = v + RADIUS * run["qd"][-1][:, None] * along
    assert rim == pytest.approx((axles @ v)[:, None] * axles, rel=1e-7, abs=1e-9)
    assert np.abs(run["contact_force"][-1, :, 1:]).max() < 1e-6
    assert run["contact_force"][-1, :, 0] == pytest.approx(2.25 * G / 3, rel=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("tight", [{}, {"rtol": 1e-8}])
def test_the_omni_robot_turns_on_the_radius_of_its_wheels_speeds(omni, tight):
    v, w = 0.15, 0.5
    run = simulate(omni, 6.0, None, speeds(omni_wheels(v, 0.0, w)), record=("base_q", "base_qd"), **tight)
    assert run.ok
    end = in_its_axes(run)
    # the centripetal force bends the contacts: 1e-5 of the speed
    assert math.hypot(*end[:2]) / end[2] == pytest.approx(v / w, rel=1e-5)


# ---------------------------------------------------------------------------------------------- line follower


EYES = "line_follower/eyes"


@pytest.fixture(scope="module")
def follower():
    return compile_scene(load_scene("line_follower"), "rotor")


@pytest.mark.long
@pytest.mark.parametrize("tight", [{}, {"rtol": 1e-8}])
def test_two_wheels_turn_on_the_radius_of_their_speeds(follower, tight):
    right, left, radius, track = 4.0, 2.0, 0.033, 0.16
    run = simulate(follower, 5.0, None, speeds((left, right)), record=("base_q", "base_qd"), **tight)
    assert run.ok
    end = in_its_axes(run)
    assert end[0] / end[2] == pytest.approx(0.5 * track * (right + left) / (right - left), rel=1e-5)
    assert end[2] == pytest.approx(radius * (right - left) / track, rel=1e-4)  # the ground gives way


@pytest.mark.long
def test_the_follower_goes_round_its_track_where_its_steering_is_that_of_the_bend(follower):
    bend, ahead, v, steer = 0.4, 0.06, 0.1, 25.0
    run = simulate(follower, 45.0, None, None, record=("base_q", EYES), controller=load_controller("line_follower"))
    assert run.ok
    x, y, *_ = (base := run["base_q"].reshape(-1, 7)).T
    off = np.hypot(x - np.clip(x, -0.4, 0.4), y) - bend
    assert np.abs(off).max() < 0.007
    turned = np.unwrap(2.0 * np.arctan2(base[:, 6], base[:, 3]))
    lap = np.searchsorted(turned, 2.0 * math.pi) * 0.01
    # on a circle of radius R the line is R - sqrt(bend^2 - ahead^2) to the left of the middle spot: steer u = v / R
    near = math.sqrt(bend**2 - ahead**2)
    circle = 0.5 * (near + math.sqrt(near**2 + 4.0 * v / steer))
    assert off[np.searchsorted(turned, 0.5 * math.pi)] == pytest.approx(circle - bend, abs=1e-4)
    assert lap == pytest.approx((1.6 + 2.0 * math.pi * circle) / v, rel=0.01)
    # what its controller works out is what the sensor reads: on straights but for the tilt of the body on its contacts,
    # which it ignores, on bends but for the corners of the tape
    law, straight, own = load_controller("line_follower"), np.abs(x) < 0.3, np.zeros((len(x), 8))
    for place, memory in zip(base, own):
        law(0.0, SimpleNamespace(base_q=place), None, np.zeros((2, 2)), memory)
    assert own[straight, :7] == pytest.approx(run[EYES][straight], abs=1e-4)
    assert own[:, :7] == pytest.approx(run[EYES], abs=0.06)


# ---------------------------------------------------------------------------------------------- fluids


def turning(scene, name, base_q, base_qd, q, qd, drag):
    """State in which propellers keep speeds qd [rad/s]: their controllers' integrals hold them; drag [N m s^2]."""
    state = initial_state(scene, {name: [*base_q, 1.0, 0.0, 0.0, 0.0, *q]}, {name: [*base_qd, 0.0, 0.0, 0.0, *qd]})
    model = scene.members[0].model
    for k, (joint, w) in enumerate(zip(model.joint_names, qd)):
        servo = model.servos[joint]
        if servo.controller.law == "pid_speed":
            m = servo.motor_constant
            voltage = m * w + servo.resistance * drag * w * abs(w) / m
            scene.state_view(state).integral[k] = voltage / servo.controller.Ki
    return state


@pytest.mark.long
def test_the_vehicle_reaches_the_speed_at_which_thrust_is_drag_and_keeps_its_depth():
    scene = compile_scene(load_scene("rov"), "rotor")
    thrust, drag, w = 3.75e-4, 3.67e-6, 200.0
    down = -math.sqrt((1000.0 * 0.0112 - 10.64) * G / (2 * thrust))  # holds what the water lifts
    each = np.array([w, -w, down, -down])
    start = turning(scene, "rov", (0.0, 0.0, -2.0), (0.0, 0.0, 0.0), (0.0,) * 4, each, drag)
    run = simulate(scene, 30.0, start, speeds(each), record=("base_q", "base_qd"), record_interval=0.1)
    assert run.ok
    v = math.sqrt(2 * thrust * w * w / (0.5 * 1000.0 * 1.0 * 0.28 * 0.10))
    assert run["base_qd"].reshape(-1, 6)[-1, :3] == pytest.approx([v, 0.0, 0.0], rel=1e-7, abs=1e-7)

    # with thrusters at rest it floats at the depth of its weight, and bobs as its waterplane says
    depth, small = 0.95 * 0.10 - 0.05, 1e-4
    start = turning(scene, "rov", (0.0, 0.0, small - depth), (0.0,) * 3, (0.0,) * 4, (0.0,) * 4, drag)
    for tolerance in ({}, {"rtol": 1e-9}):
        run = simulate(scene, 6.0, start, speeds((0.0,) * 4), record=("base_q",), **tolerance)
        z, t = run["base_q"].reshape(-1, 7)[:, 2] + depth, run["time"]
        up = np.flatnonzero((z[:-1] < 0) & (z[1:] >= 0))
        crossed = t[up] - z[up] * (t[up + 1] - t[up]) / (z[up + 1] - z[up])
        period = 2 * math.pi * math.sqrt(10.64 * 1.5 / (1000.0 * G * 0.40 * 0.28))
        assert np.diff(crossed).mean() == pytest.approx(period, rel=1e-5)
        assert 0.5 * (z.max() + z.min()) == pytest.approx(0.0, abs=1e-5 * 0.095)


@pytest.mark.long
def test_the_blimp_hovers_where_thrust_is_weight_and_flies_level_at_its_tilt():
    scene = compile_scene(load_scene("blimp"), "rotor")
    thrust, drag = 9e-8, 1e-9
    weight = (0.345 - 1.2 * (math.pi * 0.09 * 0.6 + 4 / 3 * math.pi * 0.027)) * G
    w = math.sqrt(weight / (2 * thrust))
    start = turning(scene, "blimp", (0.0, 0.0, 2.0), (0.0,) * 3, (math.pi / 2, 0.0, 0.0), (0.0, w, -w), drag)
    up = Reference([0.0, 100.0], [[math.pi / 2, 0.0, 0.0], [math.pi / 2, 100.0 * w, -100.0 * w]])
    run = simulate(scene, 10.0, start, up, record=("base_q", "base_qd"))
    assert run.ok
    assert np.abs(run["base_qd"]).max() < 1e-9
    assert run["base_q"].reshape(-1, 7)[-1, 2] == pytest.approx(2.0, abs=1e-8)
    # faster, and tilted so that the thrust upward is still the weight
    w = 700.0
    tilt = math.asin(weight / (2 * thrust * w * w))
    v = math.sqrt(2 * thrust * w * w * math.cos(tilt) / (0.5 * 1.2 * 0.2 * math.pi * 0.09))
    start = turning(scene, "blimp", (0.0, 0.0, 2.0), (0.5 * v, 0.0, 0.0), (tilt, 0.0, 0.0), (0.0, w, -w), drag)
    level = Reference([0.0, 1000.0], [[tilt, 0.0, 0.0], [tilt, 1000.0 * w, -1000.0 * w]])
    run = simulate(scene, 120.0, start, level, record=("base_qd",), record_interval=1.0)
    assert run.ok
    assert run["base_qd"].reshape(-1, 6)[-1, :3] == pytest.approx([v, 0.0, 0.0], rel=1e-6, abs=1e-6)


# ---------------------------------------------------------------------------------------------- conveyor


@pytest.mark.long
def test_the_arm_takes_the_heavy_box_from_the_belt_and_leaves_the_light_one():
    scene, v, turned = compile_scene(load_scene("conveyor"), "rotor"), 0.2, 0.5 * math.pi
    start = initial_state(scene, open_loops=["suction"])
    down, up = -0.049, 0.0  # 1 mm above the box
    knots = [(0.0, 0.0, up), (1.0, 0.0, up), (2.0, 0.0, down), (3.1, 0.0, down), (3.9, 0.0, up), (5.0, turned, up)]
    knots = np.array([*knots, (5.5, turned, up), (6.3, turned, down), (6.9, turned, down), (7.7, turned, up)])
    switches = [(2.75, "belt/motor", 0.0), (3.0, "suction", True, math.inf)]
    switches += [(4.0, "belt/motor", 1.0), (6.8, "suction", False)]
    sort = Reference(knots[:, 0], knots[:, 1:])
    run = simulate(scene, 8.0, start, sort, record=("base_q", "base_qd", "loop_force"), switches=switches)
    assert run.ok
    time, heavy, light = run["time"], run["heavy"]["base_q"].reshape(-1, 7), run["light"]["base_q"].reshape(-1, 7)
    at = lambda t: np.searchsorted(time, t - 1e-9)  # noqa: E731
    # boxes slide for v / (mu g) at the start and at the stop, in which the belt moves on by twice as much as they
    slid = v / (0.5 * G)
    assert heavy[at(2.0), 0] == pytest.approx(-0.35 + v * (2.0 - 0.5 * slid), abs=2e-5)
    assert heavy[at(2.9), 0] == pytest.approx(-0.35 + v * 2.75, abs=1e-6)
    assert light[at(2.9), 0] == pytest.approx(-0.6 + v * 2.75, abs=1e-6)
    assert run["loop_force"][at(4.9)].any()
    assert heavy[-1, :3] == pytest.approx([0.5, 0.3, 0.24 - 1e-5], abs=2e-3)  # servos rest within their friction
    assert np.abs(run["heavy"]["base_qd"][-1]).max() < 1e-6
    # the light one was at rest while the belt was
    assert light[-1, :3] == pytest.approx([-0.6 + v * (8.0 - 1.25 - 0.5 * slid), 0.0, 0.23 - 1e-5], abs=1e-4)


# ---------------------------------------------------------------------------------------------- balancer


def closed_loop(period=0.005):
    """Matrix (4, 4) of way, pitch and their rates from tick to tick, by Lagrange's equations of the level robot."""
    body, wheel, spin, r, l, inertia = 0.9, 0.05, 4e-5, 0.04, 0.09, 2.7e-3
    ratio, k, R, viscous = 20.0, 0.0115, 2.5, 0.002
    rotor, geared = ratio**2 * 5e-7, ratio * 0.0115
    along = body + 2 * wheel + 2 * (spin + rotor) / r**2
    M = np.array([[along, body * l - 2 * rotor / r], [body * l - 2 * rotor / r, body * l**2 + inertia + 2 * rotor]])
    push = np.array([1.0 / r, -1.0])  # of the torque of both motors
    damping = 2 * (geared * ratio * k / R + viscous) * np.outer(push, push)
    A = np.zeros((5, 5))  # the last is the voltage, which a period holds
    A[:2, 2:4] = np.eye(2)
    A[2:4, :2] = np.linalg.solve(M, np.diag([0.0, body * G * l]))
    A[2:4, 2:4] = -np.linalg.solve(M, damping)
    A[2:4, 4] = np.linalg.solve(M, 2 * geared / R * push)
    whole = expm(period * A)
    return whole[:4, :4] + whole[:4, 4:] @ np.array([[21.2, 26.7, 19.9, 3.6]])


@pytest.mark.long
def test_the_balancer_rights_itself_with_the_poles_of_its_regulator():
    step = closed_loop()
    poles = np.log(np.linalg.eigvals(step)) / 0.005
    assert sorted(poles.real) == pytest.approx([-213.0, -3.83, -3.0, -3.0], rel=0.01)
    scene = compile_scene(load_scene("balancer"), "rotor")
    pitch = 1e-3
    half = 0.5 * pitch
    place = [0.0, 0.0, 0.04 - 1e-5, math.cos(half), 0.0, math.sin(half), 0.0]
    start = initial_state(scene, {"balancer": [*place, -pitch, -pitch]})
    upright = Reference([0.0], [[0.0, 0.0]])
    law = load_controller("balancer")
    run = simulate(scene, 2.0, start, upright, record=("base_q",), controller=law, **TIGHT)
    assert run.ok
    x = np.array([0.0, pitch, 0.0, 0.0])
    course = [x, *(x := step @ x for _ in range(len(run["time"]) - 1))]
    base = run["base_q"].reshape(-1, 7)
    found = np.column_stack([base[:, 0], 2.0 * np.arcsin(base[:, 5])])
    # the ground gives way by 10 um: 3e-4 of the motion
    assert found == pytest.approx(np.array(course)[:, :2], abs=5e-4 * pitch)
    assert np.abs(found[-1]).max() < 0.02 * pitch


# ---------------------------------------------------------------------------------------------- humanoid and ball


@pytest.mark.long
def test_the_humanoid_kicks_the_ball_which_then_rolls_as_the_impulse_says():
    scene = compile_scene(load_scene("humanoid_and_ball"), "mipsd", integrator="midpoint", timestep=1e-3)
    record = ("base_q", "base_qd", "contact_force", "pair", "pair_force", "pair_normal_force", "pair_gap")
    law = load_controller("humanoid_and_ball")
    run = simulate(scene, 1.5, record=record, record_interval=1e-3, controller=law, estimate_error=False)
    assert run.ok
    assert run.touched() == (("ball/body", "humanoid/right_foot"),)
    ball, kicked = run["ball"], run.contact("ball", "humanoid").impulse[-1]
    velocity, force = ball["base_qd"].reshape(-1, 6)[-1], ball["contact_force"].reshape(-1, 3)
    ground = np.trapezoid(force[:, 1:], run["time"], axis=0)
    assert (kicked[:2] + ground) / 0.2 == pytest.approx(velocity[:2], abs=1e-3 * velocity[0])
    assert velocity[0] > 0.8
    spin = rotation_from_quaternion(ball["base_q"].reshape(-1, 7)[-1, 3:]) @ velocity[3:]
    assert 0.05 * np.array([spin[1], -spin[0]]) == pytest.approx(velocity[:2], rel=1e-9)
