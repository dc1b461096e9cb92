"""The servo chain against closed forms, published figures and its own energy balance."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait.core.effects import energies
from featherstone_gait.core.effects.mipsd_servo import MipsdServo
from featherstone_gait.dynamics import energy
from featherstone_gait.identification import MOTOR_OFF, changed
from featherstone_gait.robot_file import gearbox_presets, load_robot, load_servo
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

GK = 254 * 0.00681  # [N m/A]


def servo_arm(name="ax12_arm", **overrides):
    """A robot whose joints all have the AX-12 with some values changed."""
    model = load_robot(name)
    servo = load_servo("ax12", **overrides)
    return replace(model, servos=dict.fromkeys(model.joint_names, servo))


def hold(*angles):
    return Reference([0.0], np.array([angles], dtype=float))


def parts(scene, y, *names):
    return [y[slice(*scene.part(name))] for name in names]


# --- published figures -------------------------------------------------------------------------------------------


def test_ax12_reproduces_its_published_figures():
    servo = load_servo("ax12")
    G, K, R, B = servo.gearbox.ratio, servo.motor_constant, servo.resistance, servo.viscous_friction
    assert G * K / R == pytest.approx(0.21622, abs=5e-6)  # [N m/V]
    assert (G * K) ** 2 / R == pytest.approx(0.37400, abs=5e-6)  # [N m s/rad]
    assert servo.voltage_limit / R == pytest.approx(1.25)  # stall current at 10 V [A]
    assert G * K * servo.current_limit == pytest.approx(1.5567, abs=1e-4)  # [N m]
    assert G * K * servo.current_limit == pytest.approx(16.5 * 0.0980665, rel=0.04)  # data sheet: 16.5 kgf cm
    assert servo.inductance / R == pytest.approx(0.625e-3)
    assert math.exp(-1e-3 * R / servo.inductance) == pytest.approx(0.2019, abs=5e-5)
    assert 1e-3 / -math.log(0.95) == pytest.approx(servo.speed_filter, rel=1e-4)
    for volts, speed in ((10.0, 5.590), (12.0, 6.708)):
        assert G * K * volts / R / ((G * K) ** 2 / R + B) == pytest.approx(speed, abs=5e-4)


def test_gearbox_presets_hold_the_readings_of_the_printed_constants():
    presets = gearbox_presets("ax12")
    figures = {name: (g.stiffness, g.damping) for name, g in presets.items()}
    assert figures["paper_literal"] == (1e-5, 1e-4)
    assert figures["paper_rotor_side"] == pytest.approx((1e-5 * 254**2, 1e-4 * 254**2))
    assert figures["code_2012"] == pytest.approx((1e-5 * 254, 1e-4 * 254**2))
    assert figures["physical"] == (25.0, 0.05)
    assert presets["physical"].rotor_inertia == 1e-7
    assert presets["physical"].backlash == 0.0


@pytest.mark.long
def test_no_load_speed_and_stall_torque_are_those_of_the_motor():
    """A light link driven at full voltage: its steady speed; held by its stop: the torque of the current limit."""
    model = servo_arm(speed_filter=0.0, coulomb_friction=0.0)
    joint = replace(model.joints[-1], type="continuous", lower=-math.inf, upper=math.inf)
    free = replace(model, joints=(*model.joints[:-1], joint))
    scene = compile_scene(free, gearbox="rotor", gravity=(0, 0, 0), timestep=1e-3)
    run = simulate(scene, 1.0, reference=hold(1000.0), record=("qd", "current"))
    assert run["qd"][-1, 0] == pytest.approx(5.590, abs=5e-4)
    assert run["current"][-1, 0] == pytest.approx(0.0413, abs=5e-4)
    stopped = compile_scene(model, gearbox="rotor", gravity=(0, 0, 0), timestep=1e-3)
    run = simulate(stopped, 2.0, reference=hold(1000.0), record=("q", "torque"))
    assert run["torque"][-1, 0] == pytest.approx(1.5567, abs=1e-4)
    assert 0 < run["q"][-1, 0] - joint_limit(model) < 0.0101  # held within the stop's depth


def joint_limit(model):
    return model.moving_joints[0].upper


def test_current_follows_its_exponential_and_the_slew_limit():
    model = servo_arm(current_limit=10.0, current_slew=math.inf, coulomb_friction=0.0, rotor_inertia=1.0)
    scene = compile_scene(model, gearbox="rotor", gravity=(0, 0, 0), timestep=1e-4)
    run = simulate(scene, 5e-3, reference=hold(1000.0), record=("current",), record_interval=1e-4)
    t = run["time"]
    assert np.allclose(run["current"][:, 0], 1.25 * (1 - np.exp(-t / 0.625e-3)), atol=1e-5)
    slewed = compile_scene(servo_arm(rotor_inertia=1.0), gearbox="rotor", gravity=(0, 0, 0), timestep=1e-3)
    run = simulate(slewed, 0.01, reference=hold(1000.0), record=("current",), record_interval=1e-3)
    assert np.allclose(run["current"][:8, 0], [0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 0.9])  # 0.9 A in six steps


# --- controllers -------------------------------------------------------------------------------------------------


def first_voltage(reference, q=0.1, qd=0.0, **overrides):
    """Voltage of the first tick of a lone servo."""
    scene = compile_scene(servo_arm(**{"voltage_limit": 1e3, **overrides}), "rotor", None, "ars343", 1e-3)
    y = initial_state(scene, [q], [qd])
    run = simulate(scene, 0.01, y, reference, record=("voltage",), record_interval=1e-3, estimate_error=False)
    return run["voltage"][0, 0]


def test_state_feedback_law():
    u = first_voltage(hold(0.3), qd=0.7, Kp=61.0, Ki=5.0, Kd=2.0, Kf=0.5, lag=0.0)
    assert u == pytest.approx(61.0 * 0.2 + 5.0 * 0.2 * 0.01 + 2.0 * (0.0 - 0.7) + 0.5 * 0.3)


def test_pid_position_law_starts_without_a_kick():
    u = first_voltage(hold(0.3), law="pid_position", Kp=61.0, Ki=5.0, Kd=2.0, lag=0.0)
    assert u == pytest.approx(61.0 * 0.2 + 5.0 * 0.2 * 0.01)


def test_pid_speed_law_follows_the_rate_of_the_reference():
    ramp = Reference([0.0, 1.0], [[0.0], [2.0]])
    u = first_voltage(ramp, qd=0.5, law="pid_speed", Kp=3.0, Ki=1.0, lag=0.0)
    assert u == pytest.approx(3.0 * 1.5 + 1.0 * 1.5 * 0.01)


def test_voltage_is_clipped_and_pid_stops_integrating_there():
    model = servo_arm(law="pid_position", Kp=100.0, Ki=10.0)
    scene = compile_scene(model, gearbox="rotor", timestep=1e-3, gravity=(0, 0, 0))
    run = simulate(scene, 0.05, reference=hold(1.0), record=("voltage", "integral"))
    assert run["voltage"][1, 0] == 10.0
    assert run["integral"][3, 0] == 0.0


def test_encoder_rounds_to_its_counts():
    step = math.radians(300 / 1023)
    u = [first_voltage(hold(0.0), q=q, Kp=1.0, encoder_resolution=step) for q in (0.4 * step, 0.6 * step, 10.4 * step)]
    assert u == pytest.approx([0.0, -step, -10 * step], abs=1e-15)


def test_reference_takes_effect_after_the_lag():
    late = {lag: first_effect(lag) for lag in (0.0, 0.01, 0.03)}
    assert late == {0.0: 0.02, 0.01: 0.03, 0.03: 0.05}


def first_effect(lag):
    """Time of the first tick whose voltage answers a step of the reference at 15 ms."""
    scene = compile_scene(servo_arm(lag=lag), gearbox="rotor", timestep=1e-3, gravity=(0, 0, 0))
    step = Reference([0.0, 0.015], [[0.0], [0.1]], "hold")
    run = simulate(scene, 0.1, initial_state(scene, [0.0]), step, record=("voltage",))
    return round(float(run["time"][np.argmax(run["voltage"][:, 0] > 0)]), 6)


# --- gearbox -----------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_two_masses_on_a_spring_ring_at_their_frequency():
    """Rotor and link on the gear's spring, no friction, no motor: omega^2 = K (1/I + 1/J)."""
    model = servo_arm(damping=0.0, stiffness=25.0, viscous_friction=0.0, coulomb_friction=0.0, motor_constant=1e-12)
    scene = compile_scene(model, gearbox="mipsd", gravity=(0, 0, 0), integrator="rk4", timestep=2e-5)
    J = 254**2 * 1e-7
    I = 1.0 / (1.0 / scene.preflight.inertias[0])
    y = initial_state(scene, [0.0])
    y[scene.part("rotor")[0]] = 0.01
    run = simulate(scene, 0.05, y, hold(0.0), record=("q", "rotor"), record_interval=2e-5)
    e = run["rotor"][:, 0] - run["q"][:, 0]
    w = math.sqrt(25.0 * (1 / I + 1 / J))
    assert np.abs(e - 0.01 * np.cos(w * run["time"])).max() < 1e-8


@pytest.mark.long
def test_backlash_lets_the_link_fall_through_the_gap():
    """With the rotor held by its inertia the link moves freely for the gap, then meets the teeth."""
    gap = math.radians(2.0)
    model = servo_arm(backlash=gap, rotor_inertia=1.0, Kp=0.0, viscous_friction=0.0, coulomb_friction=0.0)
    scene = compile_scene(model, gearbox="mipsd", gravity=(0, 0, 0), integrator="implicit_euler", timestep=1e-4)
    y = initial_state(scene, [0.0], [0.5])
    y[scene.part("rotor_speed")[0]] = 0.0
    run = simulate(scene, 0.08, y, hold(0.0), record=("q", "qd", "torque"), record_interval=1e-4)
    e = np.abs(run["q"][:, 0])
    inside = e[:-1] < 0.5 * gap - 1e-4
    inside &= run["time"][:-1] < 0.03
    assert np.abs(run["torque"][1:, 0][inside]).max() == 0.0
    assert run["qd"][:, 0].min() < -0.1  # it came back from the teeth
    assert e.max() < 0.5 * gap + 0.02


def test_physical_gearbox_winds_up_by_load_over_stiffness():
    model = servo_arm()
    scene = compile_scene(model, gearbox="mipsd", timestep=1e-3)
    run = simulate(scene, 3.0, reference=hold(1.0), record=("q", "rotor", "torque"))
    assert run["rotor"][-1, 0] - run["q"][-1, 0] == pytest.approx(run["torque"][-1, 0] / 25.0, rel=1e-6)
    assert abs(run["torque"][-1, 0]) > 0.01


def test_a_rotors_damper_brakes_g_squared_as_strongly():
    """As one at the output, but for the gearbox between; and Table 2's number there would hold an arm for hours."""
    arm, count = changed(load_robot("ax12_arm"), **MOTOR_OFF), math.radians(300 / 1023)
    (servo,) = arm.servos.values()
    B, G = servo.viscous_friction, servo.gearbox.ratio

    def fallen(viscous_friction, rotor_damping):
        model = changed(arm, viscous_friction=viscous_friction, rotor_damping=rotor_damping)
        scene = compile_scene(model, "mipsd", integrator="implicit_euler", timestep=5e-4)
        return simulate(scene, 2.0, initial_state(scene, [0.5 * math.pi]), hold(0.0), estimate_error=False)["q"]

    output = fallen(B, 0.0)
    assert 0.0 < np.abs(fallen(0.0, B / G**2) - output).max() < count
    assert output.min() < 0.0
    assert math.degrees(np.ptp(fallen(0.0, B))) < 0.2


def test_the_speed_error_damps_until_filter_and_ticks_let_it_rattle():
    """Overshoots of a step of 60 degrees, and its last fifth of a second."""
    arm, goal, count = load_robot("ax12_arm"), math.radians(60.0), math.radians(300 / 1023)

    def step(Kd):
        scene = compile_scene(changed(arm, Kd=Kd), "mipsd", integrator="implicit_euler", timestep=5e-4)
        return simulate(scene, 1.0, reference=hold(goal), record_interval=5e-4, estimate_error=False)["q"][:, 0]

    none, some, quiet, rattling = map(step, (0.0, 0.5, 4.0, 8.0))
    assert none.max() > 1.02 * goal
    assert some.max() - goal < 0.2 * (none.max() - goal)
    last = -len(none) // 5
    assert np.ptp(rattling[last:]) > count > np.ptp(quiet[last:])


# --- energy ------------------------------------------------------------------------------------------------------


def stored(scene, y):
    """Energy in currents, rotors, springs and bodies [J]."""
    c = scene.constants
    total = 0.0
    if c.actuator is not None:
        total += 0.5 * c.actuator.motor.inductance @ parts(scene, y, "current")[0] ** 2
    if isinstance(c.actuator, MipsdServo):
        rotor, speed, q = parts(scene, y, "rotor", "rotor_speed", "q")
        wind = np.maximum(np.abs(rotor - q) - c.actuator.gear.gap, 0.0)
        total += 0.5 * (c.actuator.gear.inertia @ speed**2 + c.actuator.gear.stiffness @ wind**2)
    base_q, q, base_qd, qd = parts(scene, y, "base_q", "q", "base_qd", "qd")
    return total + energy(scene.model, [*base_q, *q], [*base_qd, *qd], armature=c.armature).sum()


def residual(scene, y0, y1):
    """What the energy balance misses, relative to the energy turned over."""
    E = parts(scene, y1, "energy")[0].reshape(-1, energies.ENERGIES).sum(axis=0)
    losses = E[energies.COPPER] + E[energies.DRIVER] + E[energies.FRICTION] + E[energies.GEAR] + E[energies.STOPS]
    gained = stored(scene, y1) - stored(scene, y0)
    return abs(E[energies.SUPPLY] - losses - gained) / (E[energies.METER] + abs(gained))


def moved_arm(servos, integrator, h, **overrides):
    """Balance residual of the seven-joint arm driven through a motion for 0.5 s."""
    model = servo_arm("arm7", **overrides)
    scene = compile_scene(model, gearbox=servos, integrator=integrator, timestep=h)
    y = initial_state(scene, np.full(7, 0.3))
    path = Reference([0.0, 0.25, 0.5], np.outer([0.3, 0.0, 0.2], np.ones(7)))
    run = simulate(scene, 0.5, y, path, record=("energy",))
    assert run.status == "ok", run.message
    return residual(scene, y, run.final)


@pytest.mark.long
@pytest.mark.parametrize(("servos", "h"), [("mipsd", 1e-4), ("rotor", 1e-4), ("standard", 2e-5)])
def test_every_joule_is_accounted_for(servos, h):
    """Current limits, slew, saturation and friction included."""
    assert moved_arm(servos, "rk4", h) < 1e-6


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "order"), [("implicit_euler", 1), ("midpoint", 2)])
@pytest.mark.parametrize("servos", ["mipsd", "rotor", "standard"])
def test_balance_residual_falls_with_the_order(servos, integrator, order):
    coarse, fine = (moved_arm(servos, integrator, h) for h in (1e-3, 2.5e-4))
    assert math.log(coarse / fine, 4) > order - 0.25


@pytest.mark.long
def test_backlash_and_stops_take_part_in_the_balance():
    model = servo_arm("ax12_arm", backlash=math.radians(1.0))
    scene = compile_scene(model, gearbox="mipsd", integrator="rk4", timestep=1e-5)
    y = initial_state(scene, [model.moving_joints[0].upper - 0.3])
    run = simulate(scene, 0.4, y, hold(model.moving_joints[0].upper + 0.5), record=("energy",))
    E = run["energy"][-1, 0]
    assert E[energies.STOPS] > 1e-4
    # The stop's spring is part of STOPS, so the balance closes at every instant.
    assert residual(scene, y, run.final) < 1e-6


@pytest.mark.quick("ars343-*")
@pytest.mark.parametrize(("integrator", "rounding"), [("implicit_euler", 1e-15), ("ars343", 1e-13)])
def test_meter_counts_no_regeneration(integrator, rounding):
    model = servo_arm("arm7")
    scene = compile_scene(model, gearbox="rotor", integrator=integrator, timestep=1e-3)
    run = simulate(scene, 1.0, initial_state(scene, np.full(7, 0.3)), hold(*np.zeros(7)), record=("energy",))
    supply, meter = run["energy"][..., energies.SUPPLY], run["energy"][..., energies.METER]
    assert (np.diff(meter, axis=0) >= 0).all()
    assert (meter >= supply - rounding).all()
    assert meter[-1].sum() > supply[-1].sum()


# --- order and stability -----------------------------------------------------------------------------------------

SMOOTH = {"coulomb_friction": 0.0, "current_limit": 1e3, "current_slew": 1e9, "voltage_limit": 1e3}
STEPS = {"implicit_euler": (1e-3, 5e-4, 2.5e-4), "midpoint": (1e-3, 5e-4, 2.5e-4), "rk4": (5e-4, 2.5e-4, 1.25e-4)}


def observed_order(model, servos, integrator, reference, q0, duration, exact):
    """Slope of log error over log step."""
    errors = []
    for h in STEPS[integrator]:
        scene = compile_scene(model, gearbox=servos, integrator=integrator, timestep=h)
        run = simulate(scene, duration, initial_state(scene, q0), reference, record=())
        errors.append(np.abs(parts(scene, run.final, "q")[0] - exact).max())
    return np.polyfit(np.log(STEPS[integrator]), np.log(errors), 1)[0]


def exact_angles(model, servos, reference, q0, duration, h):
    scene = compile_scene(model, gearbox=servos, integrator="rk4", timestep=h)
    return parts(scene, simulate(scene, duration, initial_state(scene, q0), reference, record=()).final, "q")[0]


def pd_arm(law="pd_clamped", rotor_inertia=0.0):
    """The peers' servo: 12.97 N m/rad, 0.374 N m s/rad, 1.5 N m, on the spatial arm."""
    servo = {"law": law, "Kp": 12.97, "Kd": 0.374, "torque_limit": 1.5, "viscous_friction": 0.0}
    return servo_arm("arm7_spatial", **servo, coulomb_friction=0.0, rotor_inertia=rotor_inertia)


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "order"), [("implicit_euler", 1), ("midpoint", 2)])
def test_order_with_stiff_continuous_servos(integrator, order):
    model, q0, still = pd_arm(), np.full(7, 0.05), hold(*np.zeros(7))
    exact = exact_angles(model, "standard", still, q0, 0.5, 2e-5)
    assert observed_order(model, "standard", integrator, still, q0, 0.5, exact) == pytest.approx(order, abs=0.15)


@pytest.mark.long
@pytest.mark.parametrize("h", [1e-3, 1e-2, 2e-2, 5e-2, 1e-1])
@pytest.mark.parametrize("q0", [0.05, 0.5])
@pytest.mark.parametrize("law", ["pd", "pd_clamped"])
def test_implicit_step_settles_stiff_and_clipped_servos_at_any_step(law, q0, h):
    """No rotor inertia; from 0.5 rad the torque is clipped at first."""
    scene = compile_scene(pd_arm(law), gearbox="standard", integrator="implicit_euler", timestep=h)
    run = simulate(scene, 4.0, initial_state(scene, np.full(7, q0)), hold(*np.zeros(7)), record=("q", "qd"))
    assert np.abs(run["qd"][len(run["qd"]) * 3 // 4 :]).max() < 1e-3
    assert run.info["not_converged_steps"] == 0
    # Equilibrium: the spring carries gravity.
    from featherstone_gait.dynamics import inverse_dynamics

    q = run["q"][-1]
    assert np.abs(inverse_dynamics(scene.model, q, np.zeros(7), np.zeros(7)) + 12.97 * q).max() < 1e-4


def arm_variance(servos, integrator, h):
    """Variance of the lowest joint [deg^2] over the last 10 of 20 s of holding zero, and the status."""
    scene = compile_scene(load_robot("arm7"), gearbox=servos, integrator=integrator, timestep=h)
    run = simulate(scene, 20.0, initial_state(scene, np.full(7, 0.01)), hold(*np.zeros(7)))
    angle = np.degrees(run["q"][:, 0])
    return angle[len(angle) // 2 :].var(), run.status


@pytest.mark.quick("mipsd-implicit_euler-0.001")
@pytest.mark.parametrize(
    ("servos", "integrator", "h"),
    [
        ("standard", "implicit_euler", 1e-3),
        ("standard", "implicit_euler", 5e-3),
        ("standard", "implicit_euler", 1e-2),
        ("mipsd", "implicit_euler", 1e-3),
        ("mipsd", "simtwo", 1e-3),
    ],
)
def test_arm_stands_still(servos, integrator, h):
    variance, status = arm_variance(servos, integrator, h)
    assert variance < 0.05
    assert status == "ok"


@pytest.mark.parametrize("h", [2e-3, 5e-3, 1e-2])
def test_larger_explicit_steps_are_flagged_too(h):
    """Current limit and stops keep them bounded: nothing but the status tells."""
    variance, status = arm_variance("standard", "simtwo", h)
    assert variance > 0.5
    assert status == "chatter"


@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint"])
def test_backlash_converges_under_held_steps(integrator):
    """Teeth meet and part while the reference jumps to and fro."""
    model = servo_arm("arm7", backlash=0.01)
    scene = compile_scene(model, gearbox="mipsd", integrator=integrator, timestep=1e-3)
    steps = Reference([0.0, 0.5, 1.0, 1.5], np.outer([0.0, 0.3, -0.3, 0.0], np.ones(7)), "hold")
    run = simulate(scene, 2.0, initial_state(scene, np.zeros(7)), steps)
    assert run.info["not_converged_steps"] == 0


@pytest.mark.long
def test_rk4_beyond_its_stability_interval_is_flagged():
    scene = compile_scene(load_robot("arm7"), gearbox="standard", integrator="rk4", timestep=1e-3)
    run = simulate(scene, 0.1, initial_state(scene, np.zeros(7)), hold(*np.zeros(7)))
    assert run.status in ("not converged", "diverged")


@pytest.mark.parametrize("integrator", ["dop853", "rk4"])
def test_an_explicit_integrator_refuses_a_slow_current_without_inductance(integrator):
    """It would take the current as being there at once: an AX-12 0.05 rad too far after 0.1 s of a step of 1 rad."""
    compile_scene(servo_arm(inductance=0.0, current_slew=1e9), "rotor", integrator=integrator)
    with pytest.raises(ValueError, match=f"{integrator} .* current_slew of 50 A/s"):
        compile_scene(servo_arm(inductance=0.0, current_slew=50.0), "rotor", integrator=integrator)
