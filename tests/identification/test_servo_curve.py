"""Torque against speed in steady state: as simulated, with every friction model; limits of what is asked for."""

import math

import numpy as np
import pytest
from servo_wheel import driven
from test_gear_friction import MODELS, OWN

from featherstone_gait import Controller, Gearbox, Servo, load_servo
from featherstone_gait.identification.curve import plot_curves, torque_speed


def servo(name, **more):
    """A motor of 200:1 with a friction model that loses up to a third of its torque."""
    p = dict(MODELS[name])
    own = {key: p.pop(key) for key in OWN}
    gear = Gearbox(200.0, 2.7e-7, **{**p, **more})
    return Servo(Controller("state", 1.0, period=1e-3, lag=0.0), gear, 3.0, 0.0, 0.0083, 12.0, **own)


def agrees(servo, kind):
    """Steady speeds and currents under the loads of the curve, both ways, to 1e-6."""
    curve = torque_speed(servo, points=41)
    some = np.array([20, 26, 32, 38])  # where the torque falls with the speed in all models
    assert (np.diff(curve.torque[19:]) < 0.0).all()
    loads = np.concatenate([-curve.torque[some], curve.torque[some]])
    starts = 0.9 * np.concatenate([curve.speed[some], -curve.speed[some]])
    runs = driven(servo, servo.voltage_limit, loads, starts, kind)
    for k, run in zip([*some, *some], runs):
        assert run.status == "ok"
        assert abs(run["qd"][-1, 0]) == pytest.approx(curve.speed[k], rel=1e-6)
        assert abs(run["current"][-1, 0]) == pytest.approx(curve.current[k], rel=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("name", MODELS)
def test_steady_states_are_those_of_the_simulation(name):
    agrees(servo(name), "rotor")


@pytest.mark.quick("rotor")
@pytest.mark.parametrize("kind", ["rotor", "standard", "mipsd"])
def test_with_the_rotors_damping_too(kind):
    """At 5e-7 N m s/rad it takes 0.02 N m s/rad at the output, a tenth of what back-EMF does."""
    model = "M6" if kind == "mipsd" else "M2"  # behind a rigid gear it is no part of the load on which friction depends
    geared = servo(model, stiffness=50.0, damping=0.1, rotor_damping=5e-7)
    assert torque_speed(geared).no_load_speed < 0.99 * torque_speed(servo(model)).no_load_speed
    agrees(geared, kind)


def test_of_a_gear_that_no_load_drives_backwards():
    """A budget that outgrows the load counts by 0.95 of it while the gear slides."""
    locking = servo("M3", external_load_friction=1.2, motor_load_friction=0.0)
    curve = torque_speed(locking)
    drives = 200.0 * 0.0083 * 12.0 / 3.0 - locking.coulomb_friction
    assert curve.stall_torque == pytest.approx(drives / 1.95, rel=1e-12)
    agrees(locking, "rotor")


@pytest.mark.quick("M[2-6]", "K_p")
@pytest.mark.parametrize("name", MODELS)
def test_it_lifts_up_to_its_stall_torque(name):
    curve = torque_speed(servo(name))
    limits = np.array([1.0 - 1e-6, 1.0 + 1e-6, 1.0 - 1e-6, 1.0 + 1e-6]) * curve.stall_torque
    runs = driven(servo(name), 12.0, limits * np.array([-1.0, -1.0, 1.0, 1.0]))
    moved = [abs(run["q"][-1, 0]) for run in runs]
    assert min(moved[::2]) > 1e-7
    assert max(moved[1::2]) < 1e-9
    assert [run["current"][-1, 0] for run in runs[1::2]] == pytest.approx([curve.stall_current, -curve.stall_current])


def test_a_servo_without_friction_has_the_straight_line_of_a_motor():
    """T = k (V - k v) / R, and half of the power reaches the load at half of the speed."""
    plain = Servo(Controller("state", 1.0), Gearbox(200.0), 3.0, 0.0, 0.0083, 12.0)
    curve, k = torque_speed(plain), 200.0 * 0.0083
    assert curve.torque == pytest.approx(k * (12.0 - k * curve.speed) / 3.0, rel=1e-12, abs=1e-12)
    assert curve.no_load_speed == pytest.approx(12.0 / k, rel=1e-12)
    assert curve.efficiency[100] == pytest.approx(0.5, rel=1e-12)


def test_coulomb_friction_leaves_the_efficiency_of_the_textbook():
    """At best (1 - sqrt(I_0 / I_s))^2, I_0 the current that friction takes and I_s that at rest."""
    k, R, c = 200.0 * 0.0083, 3.0, 0.1
    rubs = Servo(Controller("state", 1.0), Gearbox(200.0), R, 0.0, 0.0083, 12.0, coulomb_friction=c)
    best = (1.0 - math.sqrt((c / k) / (12.0 / R))) ** 2
    assert torque_speed(rubs, points=7).peak_efficiency == pytest.approx(best, rel=1e-9)


def test_a_limit_of_current_holds_the_torque_at_low_speeds():
    curve = torque_speed(load_servo("ax12"))
    k = 254 * 0.00681
    assert curve.stall_torque == pytest.approx(0.9 * k - 1.71e-5, rel=1e-12)
    slow = curve.speed < (10.0 - 0.9 * 8.0) / k
    assert curve.current[slow] == pytest.approx(0.9)
    assert curve.current[~slow].max() < 0.9


def test_a_servo_that_cannot_turn_has_neither_speed_nor_torque():
    stuck = Servo(Controller("state", 1.0), Gearbox(200.0), 3.0, 0.0, 0.0083, 12.0, coulomb_friction=100.0)
    curve = torque_speed(stuck)
    assert (curve.no_load_speed, curve.stall_torque, curve.peak_efficiency) == (0.0, 0.0, 0.0)
    assert curve.stall_current == pytest.approx(4.0)


def test_what_has_no_curve_is_refused():
    with pytest.raises(ValueError, match="its law 'pd' has no motor"):
        torque_speed(Servo(Controller("pd", 1.0)))
    for voltage in (0.0, -1.0, math.nan, "12"):
        with pytest.raises(ValueError, match="voltage"):
            torque_speed(load_servo("ax12"), voltage)
    with pytest.raises(ValueError, match="points"):
        torque_speed(load_servo("ax12"), points=1)
    with pytest.raises(TypeError, match="servo is 'ax12'; give a Servo"):
        torque_speed("ax12")


def test_the_picture_has_each_servo_and_its_manuals_points():
    from featherstone_gait.robot_file.servos import servo_sheet

    figure = plot_curves({"a": torque_speed(load_servo("mx64"), 12.0)}, {"a": servo_sheet("mx64").manual})
    dots = [line for panel in figure.axes[:2] for line in panel.lines if line.get_marker() == "o"]
    assert [line.get_ydata()[0] for line in dots] == [6.0, 4.1]
