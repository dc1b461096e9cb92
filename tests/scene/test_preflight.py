"""The step limits that a scene announces, against where explicit steps really break."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import pendulum

from featherstone_gait.model import Controller, Gearbox, Servo
from featherstone_gait.robot_file import load_robot, load_servo
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene
from featherstone_gait.scene.preflight import Mobility, coupled_limit, joint_limit


def amplification(mobility, dampings, springs, h):
    """Spectral radius of one semi-implicit Euler step of dv/dt = -M^-1 (C v + K x)."""
    n = len(mobility)
    v = np.hstack([-h * mobility * springs, np.eye(n) - h * mobility * dampings])
    x = np.hstack([np.eye(n), np.zeros((n, n))]) + h * v
    return np.abs(np.linalg.eigvals(np.vstack([x, v]))).max()


@pytest.mark.parametrize(("damping", "spring"), [(0.4, 0.0), (0.0, 13.0)])
def test_coupled_limit_is_where_the_linear_step_stops_being_stable(damping, spring):
    model = load_robot("arm7")
    from featherstone_gait.dynamics import mass_matrix

    mobility = np.linalg.inv(mass_matrix(model, np.zeros(7)))
    dampings, springs = np.full(7, damping), np.full(7, spring)
    limit = coupled_limit(Mobility(np.eye(len(mobility)), mobility), dampings, springs)
    assert amplification(mobility, dampings, springs, 0.999 * limit) < 1 + 1e-9
    assert amplification(mobility, dampings, springs, 1.001 * limit) > 1 + 1e-6


def test_dry_friction_asks_for_implicit_steps():
    """Its discontinuities starve a method of high order: some robots took seconds of computing for a millisecond."""
    free = replace(load_robot("arm7"), servos={})
    dry = replace(free, joints=tuple(replace(joint, friction=1e-3, damping=0.0) for joint in free.joints))
    assert compile_scene(dry).integrator == "ars343"


@pytest.mark.nojit
def test_stuck_friction_is_a_damper_that_limits_explicit_steps():
    """10 N m up to 1e-3 rad/s on a rod of 1 kg and 0.5 m: 2 I / (F / 1e-3 rad/s)."""
    check = compile_scene(pendulum(friction=10.0, damping=0.0)).preflight
    limit = 2.0 * (0.25 / 3.0) / (10.0 / 1e-3)
    assert (check.worst.joint, check.worst.cause) == ("hinge", "Coulomb friction")
    assert check.worst.step == pytest.approx(limit, rel=1e-12)
    assert check.largest_explicit_step == pytest.approx(limit, rel=1e-12)
    assert check.sliding_step == np.inf
    assert "hinge: Coulomb friction" in check.reason


@pytest.mark.nojit
@pytest.mark.parametrize("joint", [dict(friction=10.0), dict(damping=50.0), dict(damping=0.0)])
def test_the_scene_chooses_the_integrator_and_not_the_step(joint):
    chosen = {compile_scene(pendulum(**joint), timestep=h).integrator for h in (None, 1e-2, 1e-3, 1e-4, 1e-6)}
    assert chosen == {"dop853" if joint == dict(damping=0.0) else "ars343"}


@pytest.mark.long
@pytest.mark.nojit
@pytest.mark.parametrize(("joint", "taken"), [(dict(friction=1.0), "extrapolation"), (dict(damping=0.0), "dop853")])
def test_another_integrator_than_asked_for_is_said(joint, taken):
    scene = compile_scene(pendulum(**joint), integrator="midpoint")
    info = simulate(scene, 0.01, rtol=1e-3).info
    assert info["integrator"] == taken
    assert info["reason"].startswith(f"{taken} in place of midpoint (as asked for): rtol asks for error control")
    assert simulate(scene, 0.01).info["reason"] == "as asked for"


def test_what_cannot_move_is_no_scene():
    arm = load_robot("arm7")
    with pytest.raises(ValueError, match="its base is fixed and no joint moves"):
        compile_scene(replace(arm, locked=dict.fromkeys(arm.joint_names, 0.0)))


def test_single_joint_limit_names_what_acts_first():
    assert joint_limit("elbow", 1e-4, {"back-EMF": 0.4}, {"spring": 1.0}) == ("elbow", pytest.approx(5e-4), "back-EMF")
    assert joint_limit("elbow", 1e-4, {"back-EMF": 0.0}, {"spring": 1e2}).cause == "spring"
    assert joint_limit("elbow", 1e-4, {}, {}).step == np.inf


@pytest.mark.parametrize(("factor", "status"), [(0.93, "ok"), (1.24, "chatter")])
def test_standard_servos_chatter_beyond_the_announced_step(factor, status):
    """Without inductance and filter the servo of 2012 is the linear damper of the theory, until it clips."""
    arm = load_robot("arm7")
    servo = load_servo("ax12", gearbox="standard", inductance=0.0, speed_filter=0.0)
    model = replace(arm, servos=dict.fromkeys(arm.joint_names, servo))
    limit = compile_scene(model, gearbox="standard").preflight.largest_explicit_step
    h = 0.01 / round(0.01 / (factor * limit))
    scene = compile_scene(model, gearbox="standard", integrator="simtwo", timestep=h)
    still = Reference([0.0], np.zeros((1, 7)))
    assert simulate(scene, 1.0, initial_state(scene, np.full(7, 0.01)), still).status == status


def test_scene_chooses_integrator_and_step_and_says_why():
    arm = load_robot("arm7")
    free = compile_scene(arm).preflight
    stiff = compile_scene(arm, gearbox="standard").preflight
    asked = compile_scene(arm, gearbox="standard", integrator="midpoint", timestep=5e-4).preflight
    assert (free.integrator, free.largest_explicit_step) == ("dop853", np.inf)
    assert (stiff.integrator, stiff.timestep) == ("ars343", 1e-3)
    assert "explicit step" in stiff.reason
    assert (asked.integrator, asked.timestep, asked.reason) == ("midpoint", 5e-4, "as asked for")


@pytest.mark.parametrize(
    ("period", "delay", "step"),
    [
        (7.3e-3, 0.0, 7.3e-3 / 8), (0.01, 0.0, 1e-3), (3e-4, 0.0, 3e-4), (1e-3 / 3, 0.0, 1e-3 / 3),
        (7.3e-3, 3.1e-3, 1e-4), (0.01, 2.5e-3, 0.01 / 12), (1 / 60, 0.01, 1 / 1200), (0.01, 0.013, 1e-3),
    ],
)  # fmt: skip
def test_the_step_chosen_divides_the_controllers_period_and_delay(period, delay, step):
    servo = load_servo("ax12")
    servo = replace(servo, controller=replace(servo.controller, period=period, lag=period, delay=delay))
    arm = load_robot("ax12_arm")
    scene = compile_scene(replace(arm, servos=dict.fromkeys(arm.joint_names, servo)), "rotor")
    assert scene.timestep == pytest.approx(step, rel=1e-15)
    assert scene.tick_steps * scene.timestep == pytest.approx(period, rel=1e-12)
    assert delay / scene.timestep == pytest.approx(round(delay / scene.timestep), rel=1e-12)


def test_numbers_beyond_computing_are_refused_by_name():
    with pytest.raises(ValueError, match=r"damping is 1e\+308 .* of a size from 1e-50 to 1e\+50"):
        load_servo("ax12", damping=1e308)
    robot = load_robot("arm7")
    robot = replace(robot, servos=dict.fromkeys(robot.joint_names, load_servo("ax12", stiffness=1e308)))
    with pytest.raises(ValueError, match=r"arm7: joint1: a stiffness or damping of 1e\+308 .* mind their units"):
        compile_scene(robot, "mipsd")


@pytest.mark.parametrize("gearbox", [{}, dict(stiffness=25.0), dict(rotor_inertia=1e-7)])
def test_a_gearbox_that_is_no_spring_damper_is_refused_by_name(gearbox):
    robot = load_robot("arm7")
    servo = replace(load_servo("ax12"), gearbox=Gearbox(254.0, **gearbox))
    robot = replace(robot, servos=dict.fromkeys(robot.joint_names, servo))
    with pytest.raises(ValueError, match="joint joint1: mipsd needs a finite stiffness and a rotor inertia > 0"):
        compile_scene(robot, "mipsd")
    assert compile_scene(robot, "rotor").integrator == "ars343"


@pytest.mark.long
def test_a_torque_servo_moves_the_same_without_the_numbers_of_a_motor():
    """Its stops, too, as long as its torque has a limit; without one they are as strong as the robot is heavy."""
    robot, runs = load_robot("arm7"), []
    with_motor = load_servo("ax12", law="pd", Kp=2.0, Kd=0.05, torque_limit=1.0, viscous_friction=0, coulomb_friction=0)
    for servo in (with_motor, Servo(with_motor.controller, with_motor.gearbox), Servo(Controller("pd", 2.0, Kd=0.05))):
        scene = compile_scene(replace(robot, servos=dict.fromkeys(robot.joint_names, servo)), "standard")
        assert np.isfinite([getattr(scene.constants.stops, name) for name in ("stiffness", "damping")]).all()
        runs.append(simulate(scene, 0.02, initial_state(scene, 0.3 * np.ones(7)))["q"])
    assert np.array_equal(runs[0], runs[1])
    assert np.abs(runs[2] - runs[0]).max() < 0.3
