"""Steps beyond which servos chatter: bisection and linear theory against closed forms, and both against simulation."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait.benchmark.linear_stability import growth, linearized
from featherstone_gait.benchmark.stability import IDEAL, PERIOD, Point, arm, linear_step
from featherstone_gait.dynamics import mass_matrix
from featherstone_gait.robot_file import load_servo, save_robot
from featherstone_gait.scene.preflight import Mobility, coupled_limit
from featherstone_gait.study import read_study
from featherstone_gait.study.bisection import largest
from featherstone_gait.study.measures import run_batch


def damper(model, servo):
    """Back-EMF and viscous friction at the joint [N m s/rad]."""
    torque = servo.gearbox.ratio * servo.motor_constant
    return torque**2 / servo.resistance + servo.viscous_friction


def test_bisection_encloses_the_boundary_within_its_width():
    for boundary in (3e-5, 1.234e-3, 0.07):
        good, bad = largest(lambda x, b=boundary: x <= b, 1e-5, 0.1, width=1.01)
        assert good <= boundary < bad <= 1.01 * good


def test_bisection_says_where_there_is_no_boundary():
    assert largest(lambda x: True, 1e-5, 0.1)[0] == 0.1
    assert math.isnan(largest(lambda x: True, 1e-5, 0.1)[1])
    assert math.isnan(largest(lambda x: False, 1e-5, 0.1)[0])


@pytest.mark.long
def test_one_joint_is_stable_up_to_the_limit_of_its_explicit_damper(tmp_path):
    """A joint of inertia I with a damper c moves on by v (1 - h c / I): stable while h < 2 I / c.

    Measured by bisection on simulations.  The gain is small, so that the spring of the sampled control moves the limit
    by less than 1e-4 of it: a share of h times its damping of Kp T / 2 by that of the back-EMF.
    """
    model = arm(1)
    servo = load_servo("ax12", **IDEAL)
    limit = 2.0 * mass_matrix(model, np.zeros(1))[0, 0] / damper(model, servo)
    row = measured(tmp_path, 1, "standard", "simtwo", 1.0)
    assert row["stable_step_s"] < limit < row["unstable_step_s"] < 1.04 * row["stable_step_s"]


def measured(folder, joints, servos, integrator, gain):
    """Row of a study of one run."""
    save_robot(arm(joints), folder / "arm.urdf")
    lines = ['robot = "arm.urdf"', 'experiment = "stable_step"', "duration = 2.0", "[servo]", 'type = "ax12"']
    lines += [f"{key} = {value!r}" for key, value in IDEAL.items()]
    lines += ["[vary]", f'scene.gearbox = ["{servos}"]', f'scene.integrator = ["{integrator}"]']
    lines += [f"servo.Kp = [{gain}]", "posture.tilt = [0.05]"]
    (folder / "study.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    study = read_study(folder / "study.toml")
    (row,) = run_batch(study.setup, [study.values(0)])
    return row


@pytest.mark.long
@pytest.mark.parametrize(
    ("joints", "servos", "integrator"),
    [(3, "rotor", "implicit_euler"), (3, "mipsd", "simtwo")],
)
def test_simulation_and_linear_theory_break_at_the_same_step(tmp_path, joints, servos, integrator):
    """Of small motions the theory leaves nothing out; one bisection's width, 3 %, and what a slow growth hides."""
    row = measured(tmp_path, joints, servos, integrator, 61.0)
    expected = linear_step(Point(joints, 254.0, 1e-7, 61.0, servos, integrator, 0.05))
    assert 0.96 * expected < row["stable_step_s"] < 1.01 * expected


@pytest.mark.parametrize("joints", [1, 3, 7])
def test_linear_theory_of_a_rigid_gearbox_is_that_of_coupled_dampers(joints):
    model, servo = arm(joints), load_servo("ax12", **IDEAL)
    linear = linearized(model, servo, "standard")
    mobility = np.linalg.inv(mass_matrix(model, np.zeros(joints)))
    limit = coupled_limit(
        Mobility(np.eye(len(mobility)), mobility), np.full(joints, damper(model, servo)), np.zeros(joints)
    )
    assert growth("simtwo", linear, 1e-3, 0.998 * limit, PERIOD) < 1.0
    assert growth("simtwo", linear, 1e-3, 1.002 * limit, PERIOD) > 1.0


@pytest.mark.parametrize("integrator", ["simtwo", "rk4", "midpoint", "implicit_euler"])
@pytest.mark.parametrize("kind", ["standard", "rotor", "mipsd"])
def test_all_integrators_approach_the_same_decay(integrator, kind):
    """Growth over 10 ms by steps of 10 us; first-order methods are wrong by some h times the fastest rate, squared."""
    linear = linearized(arm(1), load_servo("ax12", **IDEAL), kind)
    fine = growth("rk4", linear, 61.0, 1e-5, PERIOD)
    assert growth(integrator, linear, 61.0, 1e-5, PERIOD) == pytest.approx(fine, abs=3e-3)


def test_too_high_a_gain_leaves_no_stable_step():
    """Held for the period T a voltage Kp q acts T / 2 late: it takes Kp T / 2 off the damping G K of the back-EMF."""
    servo = load_servo("ax12", **IDEAL, viscous_friction=0.0)
    torque = servo.gearbox.ratio * servo.motor_constant
    slow = replace(arm(1))
    linear = linearized(slow, servo, "rotor")
    heavy = linear._replace(M=1e3 * linear.M)  # so that motion is slow by the period, as the formula needs
    critical = 2.0 * torque / PERIOD
    assert growth("rk4", heavy, 0.9 * critical, 1e-3, PERIOD) < 1.0
    assert growth("rk4", heavy, 1.1 * critical, 1e-3, PERIOD) > 1.0
