"""Equilibria: statics by hand, the weight on the ground, and that the simulation stays where they are."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import arm_scene, box, box_on, pendulum, with_controller

from featherstone_gait import (
    Ground,
    Reference,
    Sphere,
    Spring,
    body,
    compile_scene,
    jacobian,
    load_robot,
    simulate,
    trim,
)
from featherstone_gait.model import Controller, Mimic, Servo, Supply

G = 9.81


def moved(scene, found, duration=1.0):
    """The farthest that base and joints get from the equilibrium in a run that begins there."""
    held = None if found.reference is None else Reference([0.0], found.reference[None])
    run = simulate(scene, duration, found.state, held, found.tau, record=("q", "base_q"), estimate_error=False)
    assert run.status == "ok", run.message
    return max(np.abs(run[name] - run[name][0]).max(initial=0.0) for name in ("q", "base_q"))


@pytest.mark.long
@pytest.mark.nojit
@pytest.mark.parametrize("angle", [0.0, 0.7, -1.3])
def test_a_pendulum_takes_m_g_l_sin_q(angle):
    found = trim(compile_scene(pendulum(length=0.5, mass=1.0), integrator="implicit_euler", timestep=1e-3), [angle])
    assert found.ok
    assert found.tau == pytest.approx([1.0 * G * 0.25 * math.sin(angle)], abs=1e-14)
    assert found.residual < 1e-12


@pytest.mark.quick("mipsd")
@pytest.mark.parametrize("servos", ["mipsd", "rotor"])
def test_a_humanoid_stands_and_stays(servos):
    scene = compile_scene(load_robot("humanoid"), servos, Ground(), "midpoint", 1e-3)
    found = trim(scene)
    assert found.ok, found.message
    assert found.contact_force[:, 0].sum() == pytest.approx(scene.model.mass * G, rel=1e-9)
    assert np.abs(found.contact_force[:, 1:].sum(axis=0)).max() < 1e-9
    assert (found.contact_force[:, 0] > 0.1).all()
    assert found.residual < 1e-8
    assert moved(scene, found) < 1e-6


@pytest.mark.long
def test_a_ball_rests_on_a_slope_by_its_rolling_friction():
    """It rolls where the slope exceeds the coefficient by the radius."""
    r, rho = 0.1, 0.02
    ball = body(Sphere(r), 1.0, rolling_friction=rho)
    for share, status in ((0.0, "ok"), (0.5, "ok"), (0.99, "ok"), (1.01, "slips")):
        slope = Ground(slope=-math.atan(share * rho / r), heading=0.7)
        scene = compile_scene(ball, None, slope, "implicit_euler", 1e-3, fall_height=-1e6, fall_tilt=math.pi)
        found = trim(scene)
        assert found.status == status, found.message
        assert found.contact_force.shape == (1, 3)
        assert (moved(scene, found) < 1e-12) == found.ok
    assert "against rolling" in found.message


@pytest.mark.long
def test_feet_squeeze_the_ground_by_what_asks_least_of_joints_and_friction():
    """|tau|^2 + |r f|^2 does not fall if the feet push apart by a little more, which keeps the base in balance."""
    scene = compile_scene(load_robot("humanoid"), None, Ground(), "implicit_euler", 1e-3)
    model, found = scene.model, trim(scene)
    pulled, apart = np.zeros(model.nv), np.zeros(len(model.contacts))
    for k, point in enumerate(model.contacts):
        apart[k] = 1.0 if point.link.startswith("left") else -1.0
        pulled += apart[k] * jacobian(model, found.q, point.link, point.position)[4]
    assert np.abs(pulled[:6]).max() < 1e-3
    by_torque, by_friction = -2.0 * found.torque @ pulled[6:], 2.0 * 0.01**2 * found.contact_force[:, 2] @ apart
    assert abs(by_friction) > 1e-8
    assert abs(by_torque + by_friction) < 1e-2 * abs(by_friction)


@pytest.mark.long
def test_on_one_foot_the_other_is_in_the_air():
    model = load_robot("humanoid")
    scene = compile_scene(model, "mipsd", Ground(), "implicit_euler", 1e-3)
    q = np.zeros(model.nq)
    q[3] = 1.0
    names = list(model.joint_names)
    q[7 + names.index("right_hip_front")], q[7 + names.index("right_knee")] = 0.4, 0.4
    found = trim(scene, q, contacts=["left_foot"])
    assert found.status == "tips"  # its center of mass is between the feet
    assert "center of mass" in found.message
    with pytest.raises(ValueError, match="link 'neck' has no contact points; those with: left_foot, right_foot"):
        trim(scene, q, contacts=["neck"])


@pytest.mark.long
def test_a_box_on_a_slope_leans_on_friction_or_slips():
    """Along the slope m g sin a, across it m g cos a; beyond friction tan a it slips."""
    slope = 0.2
    scene = box_on(Ground(slope=slope, friction=0.3))
    found = trim(scene, contacts=["box"])
    assert found.ok, found.message
    assert found.contact_force[:, 0].sum() == pytest.approx(G * math.cos(slope), rel=1e-9)
    assert found.contact_force[:, 1].sum() == pytest.approx(G * math.sin(slope), rel=1e-9)
    assert found.q[3:7] @ [math.cos(slope / 2), 0.0, -math.sin(slope / 2), 0.0] == pytest.approx(1.0, abs=1e-6)
    assert moved(scene, found) < 1e-6
    slippery = trim(box_on(Ground(slope=slope, friction=0.1)), contacts=["box"])
    assert slippery.status == "slips"
    assert "N of friction" in slippery.message


@pytest.mark.long
@pytest.mark.parametrize("edge", [(0.4, 0.4, 0.4), (0.4, 0.3, 0.1)])
@pytest.mark.parametrize("friction", [0.3, 1.5])
def test_a_box_stands_up_to_the_angles_of_friction_and_tipping(edge, friction):
    """It slips from tan a = mu on, however its corners share the load, and tips from where its center is over an edge.

    Where it tips depends on how far the ground gives way, by less than 2 %.  Runs from what is found stay there.
    Given level, or turned in its plane, it is laid on the slope.
    """
    slides, tips = math.atan(friction), math.atan(edge[0] / edge[2])
    for slope in (0.0, 0.2, 0.4, 0.7, 0.98 * tips, 1.02 * tips, *(slides * k for k in (0.98, 0.999, 1.001, 1.02))):
        scene = box_on(Ground(slope=slope, friction=friction), model=box(size=edge))
        for turned in (0.0, 0.5) if slope < 0.6 * tips else (0.0,):
            q = [0.0, 0.0, 0.5, math.cos(turned / 2), 0.0, 0.0, math.sin(turned / 2)]
            found = trim(scene, q)
            if slope > tips:
                assert found.status == "tips", (slope, found.message)
            else:
                assert found.status == ("ok" if slope < slides else "slips"), (slope, found.message)
            shares = np.hypot(*found.contact_force[:, 1:].T) - friction * found.contact_force[:, 0]
            assert not found.ok or shares.max() <= 1e-9 * G
            assert not found.ok or moved(scene, found, 0.2) < 1e-6


@pytest.mark.long
def test_a_humanoid_stands_on_a_slope_up_to_the_angle_of_friction():
    """Its feet share the friction by their load, beyond what the least torques would ask of them."""
    model, slope = load_robot("humanoid"), 0.15
    for share, status in ((1.01, "ok"), (0.99, "slips")):
        ground = Ground(slope=slope, friction=share * math.tan(slope))
        scene = compile_scene(model, None, ground, "implicit_euler", 1e-3)
        found = trim(scene)
        assert found.status == status, found.message


@pytest.mark.long
def test_a_spring_carries_its_share():
    """One from the ceiling to the rod's end: its moment about the hinge adds to that of gravity."""
    model = pendulum(length=0.5, mass=1.0)
    spring = Spring("base", "rod", point_a=(0.5, 0.0, -0.5), point_b=(0.0, 0.0, -0.5), stiffness=30.0, length=0.1)
    scene = compile_scene(model, integrator="implicit_euler", timestep=1e-3, springs=[spring])
    angle = 0.3
    end = -0.5 * np.array([math.sin(angle), math.cos(angle)])  # x, z
    way = np.array([0.5, -0.5]) - end
    pull = 30.0 * (np.linalg.norm(way) - 0.1) * way / np.linalg.norm(way)
    moment = end[1] * pull[0] - end[0] * pull[1]  # about y
    found = trim(scene, [angle])
    assert found.tau == pytest.approx([G * 0.25 * math.sin(angle) - moment], abs=1e-12)
    assert moved(scene, found) < 1e-6


@pytest.mark.quick("*K*")
@pytest.mark.parametrize(
    "settings",
    [
        {"Ki": 20.0},
        {"law": "pid_position", "Kp": 80.0, "Kd": 0.1, "Ki": 5.0},
        {"compliance_margin": 0.01, "punch": 0.05},
        {"Kf": 0.3},
        {"delay": 0.01},
        {"profile_speed": 2.0},
    ],
    ids=str,
)
def test_every_law_is_asked_backwards(settings):
    """The arm bent, on servos of that law: it stays."""
    scene = arm_scene(with_controller(load_robot("arm7"), **settings))
    found = trim(scene, 0.1 * np.arange(7))
    assert found.ok, found.message
    assert np.abs(found.torque).max() > 0.05
    assert moved(scene, found, 0.3) < 1e-6


@pytest.mark.long
def test_a_pd_servo_is_ahead_by_its_torque_over_its_gain():
    servo = Servo(Controller("pd", Kp=8.0, Kd=0.4), resistance=1.0, motor_constant=1.0, voltage_limit=10.0)
    scene = compile_scene(replace(pendulum(), servos={"hinge": servo}), "standard", None, "implicit_euler", 1e-3)
    found = trim(scene, [0.7])
    assert found.ok, found.message
    assert found.reference == pytest.approx([0.7 + G * 0.25 * math.sin(0.7) / 8.0], abs=1e-14)
    assert moved(scene, found) < 1e-6


@pytest.mark.long
def test_of_coupled_joints_the_leader_holds_both():
    """Virtual work: its torque is its own, and the follower's by the multiplier."""
    free = load_robot("arm7_spatial")
    joints = [j if j.name != "joint3" else replace(j, mimic=Mimic("joint2", 0.5)) for j in free.joints]
    scene = compile_scene(replace(free, joints=tuple(joints)), integrator="implicit_euler", timestep=1e-3)
    q = [0.1, 0.4, 0.2, 0.3, -0.2, 0.5, 0.1]
    found, alone = trim(scene, q), trim(compile_scene(free, integrator="implicit_euler", timestep=1e-3), q)
    assert found.ok, found.message
    assert found.torque[1] == pytest.approx(alone.torque[1] + 0.5 * alone.torque[2], abs=1e-12)
    assert found.torque[2] == 0.0
    assert found.residual < 1e-8


@pytest.mark.long
def test_the_supply_sags_and_holds():
    model = replace(load_robot("arm7"), supply=Supply(voltage=11.0, resistance=2.0))
    scene = arm_scene(model)
    found = trim(scene, 0.1 * np.arange(7))
    assert found.ok, found.message
    bus = float(found.state[scene.part("bus_voltage")[0]])
    assert 9.0 < bus < 11.0 - 1e-4
    assert moved(scene, found, 0.3) < 1e-6


def test_a_servo_that_is_too_weak_is_named():
    model = load_robot("arm7")
    servos = {name: replace(servo, current_limit=0.01) for name, servo in model.servos.items()}
    found = trim(arm_scene(replace(model, servos=servos)), 0.1 * np.arange(7))
    assert found.status == "too weak"
    assert "joint1" in found.message


@pytest.mark.long
def test_voltages_in_counts_do_not_hold_exactly_and_that_is_said():
    found = trim(arm_scene(with_controller(load_robot("arm7"), pwm_steps=40.0)), 0.1 * np.arange(7))
    assert found.status == "moves"


def test_a_floating_robot_needs_ground():
    with pytest.raises(ValueError, match="without ground falls"):
        trim(compile_scene(box()))
