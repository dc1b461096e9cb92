"""A source with a resistance, which all servos share: its voltage, its energy, what holding it for a tick leaves."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import pendulum, with_controller

from featherstone_gait import Reference, Supply, Worlds, compile_scene, load_robot, simulate, simulate_batch
from featherstone_gait.cli.info import _servo_table
from featherstone_gait.core.effects import energies
from featherstone_gait.core.effects.mipsd_servo import MipsdServo
from featherstone_gait.dynamics import energy, forward_dynamics
from featherstone_gait.robot_file import load_servo
from featherstone_gait.run.simulate import initial_state

IDEAL = {  # currents are (V - K w) / R at once
    "inductance": 0.0, "speed_filter": 0.0, "current_limit": math.inf, "current_slew": math.inf,
    "viscous_friction": 0.0, "coulomb_friction": 0.0, "lag": 0.0,
}  # fmt: skip
WEIGHTLESS = (0.0, 0.0, 0.0)
ONCE = {"estimate_error": False}
V0 = 11.1  # [V]
R, GK = 8.0, 254 * 0.00681  # of the AX-12 [Ohm, N m/A]


def arm(resistance=0.5, voltage=V0, integrator="implicit_euler", servos="rotor", timestep=1e-3, **changes):
    """The arm of seven servos on one source."""
    robot = load_robot("arm7")
    servo = load_servo("ax12", **{**IDEAL, **changes})
    robot = replace(robot, servos=dict.fromkeys(robot.joint_names, servo), supply=Supply(voltage, resistance))
    return compile_scene(robot, servos, integrator=integrator, timestep=timestep, gravity=WEIGHTLESS)


def first_tick(scene, errors, speeds=0.0, name="bus_voltage"):
    """A channel as the first tick leaves it, of servos with these errors [rad] and speeds [rad/s]."""
    state = initial_state(scene, -np.asarray(errors), np.broadcast_to(speeds, 7))
    path = Reference([0.0], np.zeros((1, 7)))
    return simulate(scene, 0.01, state, path, record=(name,), **ONCE)[name][0]


# ---------------------------------------------------------------------------------------------- voltage


@pytest.mark.long
@pytest.mark.bounds
@pytest.mark.nojit
def test_stalled_servos_share_what_the_source_gives():
    """V = V0 / (1 + R_s sum d^2 / R), and the currents of a tick are d V / R."""
    errors = np.array([0.0, 0.01, -0.02, 0.05, 0.1, -0.1, 0.2])
    duty = np.clip(61.0 * errors / 10.0, -1.0, 1.0)
    scene = arm(rotor_inertia=1e10)
    V = V0 / (1.0 + 0.5 / R * (duty**2).sum())
    assert V < 0.9 * V0
    np.testing.assert_allclose(first_tick(scene, errors), V, rtol=1e-14)
    np.testing.assert_allclose(first_tick(scene, errors, name="duty"), duty, rtol=1e-15)
    np.testing.assert_allclose(first_tick(scene, errors, name="voltage"), duty * V, rtol=1e-13)


@pytest.mark.long
@pytest.mark.nojit
def test_a_source_without_resistance_is_only_another_voltage():
    scene, path = arm(resistance=0.0, voltage=9.0), Reference([0.0, 0.1], [[0.0] * 7, [0.2] * 7])
    run = simulate(scene, 0.1, None, path, record=("q", "bus_voltage", "source_loss"), **ONCE)
    assert run["bus_voltage"].tolist() == [[9.0]] * 11
    assert run["source_loss"].tolist() == [[0.0]] * 11
    own = with_controller(scene.model, Kp=61.0 * 0.9)
    own = replace(own, supply=None, servos={k: replace(s, voltage_limit=9.0) for k, s in own.servos.items()})
    own = compile_scene(own, "rotor", integrator="implicit_euler", timestep=1e-3, gravity=WEIGHTLESS)
    np.testing.assert_allclose(simulate(own, 0.1, None, path, **ONCE)["q"], run["q"], rtol=0, atol=1e-13)


@pytest.mark.long
@pytest.mark.nojit
def test_servos_at_their_current_limit_draw_that():
    """V = V0 - R_s sum |d| I_max: six of seven at 0.3 A, the seventh idle."""
    errors = np.array([0.2, 0.2, 0.2, 0.1, 0.1, 0.1, 0.0])
    duty = np.minimum(6.1 * errors, 1.0)
    V = first_tick(arm(rotor_inertia=1e10, current_limit=0.3), errors)
    np.testing.assert_allclose(V, V0 - 0.5 * 0.3 * duty.sum(), rtol=1e-13)


@pytest.mark.long
@pytest.mark.nojit
def test_what_servos_drive_back_charges_the_source():
    """All turn faster than their voltage lets them: V > V0 by R_s times the current that comes back."""
    speeds, errors = np.full(7, 9.0), np.full(7, 0.1)
    d = 0.61
    V = first_tick(arm(), errors, speeds)[0]
    assert V == pytest.approx((V0 + 0.5 * 7 * d * GK * 9.0 / R) / (1.0 + 0.5 * 7 * d * d / R), rel=1e-13)
    assert V > V0 + 1.0
    assert d * V < GK * 9.0


@pytest.mark.long
@pytest.mark.nojit
def test_a_source_that_braking_servos_short_gives_nothing():
    """Duty cycles against fast motors, at a resistance as large as theirs: V is not below 0."""
    assert first_tick(arm(resistance=8.0), np.full(7, 0.2), np.full(7, -9.0)).tolist() == [0.0]


def missing(V, d, w, R_s, full):
    """What the equation of the bus misses [V]."""
    return V - full + R_s * d @ np.clip((d * V - GK * w) / R, -0.4, 0.4)


@pytest.mark.long
def test_voltage_is_the_root_of_its_equation():
    """Random duty cycles and speeds, some currents at their limit, against a bisection; eight worlds at once."""
    from scipy.optimize import brentq

    rng = np.random.default_rng(0)
    scene, runs = arm(current_limit=0.4), 40
    worlds = Worlds(supply={"resistance": rng.uniform(0.0, 4.0, runs), "voltage": rng.uniform(6.0, 13.0, runs)})
    errors, speeds = rng.normal(scale=0.1, size=(runs, 7)), rng.normal(scale=4.0, size=(runs, 7))
    states = [initial_state(scene, -e, w) for e, w in zip(errors, speeds)]
    path = [Reference([0.0], np.zeros((1, 7)))] * runs
    found = simulate_batch(scene, 0.01, states, path, record=("bus_voltage", "duty"), worlds=worlds, **ONCE)
    limited = 0
    for run, w, R_s, full in zip(found, speeds, worlds.supply["resistance"], worlds.supply["voltage"]):
        d = run["duty"][0]
        V = brentq(missing, -100.0, 200.0, (d, w, R_s, full), xtol=1e-14, rtol=1e-15)
        np.testing.assert_allclose(run["bus_voltage"][0, 0], max(V, 0.0), rtol=0, atol=1e-11)
        limited += (np.abs(d * V - GK * w) / R > 0.4).sum()
    assert 40 < limited < 240


# ---------------------------------------------------------------------------------------------- energy


FIRMWARE = {
    "compliance_margin": 0.005, "punch": 0.3, "pwm_steps": 1023.0, "duty_limit": 0.95, "profile_speed": 2.0,
    "delay": 3e-3,
}  # fmt: skip


def moved_arm(servos, integrator, h, record=(), record_interval=None):
    """Scene, start and run of the arm with friction, limits, firmware and source, through a motion of 0.5 s."""
    robot = with_controller(load_robot("arm7"), **FIRMWARE)
    scene = compile_scene(replace(robot, supply=Supply(V0, 0.5)), servos, integrator=integrator, timestep=h)
    start = initial_state(scene, np.full(7, 0.3))
    path = Reference([0.0, 0.25, 0.5], np.outer([0.3, 0.0, 0.2], np.ones(7)))
    run = simulate(
        scene,
        0.5,
        start,
        path,
        record=("energy", "source_loss", "bus_voltage", *record),
        record_interval=record_interval,
        **ONCE,
    )
    assert run.status in ("ok", "chatter"), run.message
    return scene, start, run


def stored(scene, y):
    """Energy in currents, rotors, springs and bodies [J]."""
    c, part = scene.constants, {name: y[slice(*place)] for name, place in scene.parts.items()}
    total = 0.5 * c.actuator.motor.inductance @ part["current"] ** 2
    if isinstance(c.actuator, MipsdServo):
        wind = part["rotor"] - part["q"]
        total += 0.5 * (c.actuator.gear.inertia @ part["rotor_speed"] ** 2 + c.actuator.gear.stiffness @ wind**2)
    return total + energy(scene.model, part["q"], part["qd"], armature=c.armature).sum()


@pytest.mark.long
@pytest.mark.parametrize(
    ("servos", "h"),
    [("rotor", 1e-4), *(pytest.param(*case, marks=pytest.mark.long) for case in (("mipsd", 1e-4), ("standard", 2e-5)))],
)
def test_every_joule_of_the_source_is_accounted_for(servos, h):
    """What it gives, V0 times its current, is lost in it, in the servos and in friction, or stored.

    What it gives is summed here from duty cycles and currents, by Simpson's rule over two steps, each within a tick.
    """
    scene, start, run = moved_arm(servos, "rk4", h, record=("duty", "current"), record_interval=h)
    E = run["energy"][-1].sum(axis=0)
    lost = E[[energies.COPPER, energies.DRIVER, energies.FRICTION, energies.GEAR, energies.STOPS]].sum()
    gained = stored(scene, run.final) - stored(scene, start)
    loss = run["source_loss"][-1, 0]
    given = E[energies.SUPPLY] + loss
    turned_over = E[energies.METER] + abs(gained)
    assert loss > 0.01 * turned_over
    assert abs(given - loss - lost - gained) < 1e-6 * turned_over
    current = (run["duty"][:-1:2] * run["current"][:-1:2]).sum(axis=1)
    middle = (run["duty"][:-1:2] * run["current"][1::2]).sum(axis=1)
    after = (run["duty"][:-1:2] * run["current"][2::2]).sum(axis=1)
    drawn = V0 * h / 3.0 * (current + 4.0 * middle + after).sum()
    assert given == pytest.approx(drawn, rel=1e-4)


@pytest.mark.quick("*-implicit_euler-*")
@pytest.mark.parametrize(
    ("servos", "integrator", "rounding"),
    [
        ("rotor", "ars343", 1e-13),
        ("rotor", "implicit_euler", 1e-13),
        pytest.param("mipsd", "midpoint", 1e-13, marks=pytest.mark.long),
        pytest.param("standard", "simtwo", 1e-13, marks=pytest.mark.long),
        pytest.param("mipsd", "ars343", 1e-13, marks=pytest.mark.long),
        pytest.param("rotor", "extrapolation", 2.7**12 * 1e-16, marks=pytest.mark.long),  # its growth of rounding
    ],
)
def test_the_source_loses_its_share_of_what_it_gives_in_each_tick(servos, integrator, rounding):
    """While V stands, the loss is V0 / V - 1 times what the servos take, whatever the integrator: to rounding."""
    _, _, run = moved_arm(servos, integrator, 1e-3, record_interval=1e-3)
    taken = np.diff(run["energy"][..., energies.SUPPLY].sum(axis=1))
    lost = np.diff(run["source_loss"][:, 0])
    assert run["bus_voltage"].min() < V0 - 0.5
    share = V0 / run["bus_voltage"][:-1, 0] - 1.0
    np.testing.assert_allclose(lost, share * taken, rtol=0, atol=rounding * np.abs(taken).sum())


# ---------------------------------------------------------------------------------------------- what holding it leaves


def final_speed(period):
    """Of a rod that a servo accelerates at full duty cycle for 60 ms [rad/s]."""
    servo = load_servo("ax12", **IDEAL, rotor_inertia=1e-6, period=period)
    model = replace(pendulum(damping=0.0), servos={"hinge": servo}, supply=Supply(V0, 2.0))
    scene = compile_scene(model, "rotor", integrator="midpoint", timestep=1e-4, gravity=WEIGHTLESS)
    run = simulate(scene, 0.06, None, Reference([0.0], [[50.0]]), record=("qd",), **ONCE)
    return run["qd"][-1, 0], scene.preflight.inertias[0]


@pytest.mark.long
def test_a_voltage_held_for_a_tick_tends_to_that_of_a_continuous_bus():
    """A motor at a steady duty cycle on a source is one with both resistances: held, V lags by half a tick."""
    periods, errors = np.array([0.01, 0.005, 0.0025]), []
    for period in periods:
        w, inertia = final_speed(period)
        exact = V0 / GK * -math.expm1(-0.06 * GK**2 / ((R + 2.0) * inertia))
        errors.append(abs(w / exact - 1.0))
    assert errors[0] < 0.02
    assert np.polyfit(np.log(periods), np.log(errors), 1)[0] == pytest.approx(1.0, abs=0.1)


def swung(period, resistance=0.3, duration=0.5):
    """Arm of seven AX-12 that all go 0.5 rad at once, its bus held for each tick, and the run to 1e-8."""
    robot = load_robot("arm7")
    servo = load_servo("ax12", current_slew=math.inf, coulomb_friction=0.0, speed_filter=0.0, lag=0.0, period=period)
    robot = replace(robot, servos=dict.fromkeys(robot.joint_names, servo), supply=Supply(V0, resistance))
    scene = compile_scene(robot, "rotor", timestep=0.1 * period)
    path, how = Reference([0.0], np.full((1, 7), 0.5)), {"record_interval": 0.01, "rtol": 1e-8, "atol": 1e-8}
    start = initial_state(scene, np.zeros(7))
    return scene, simulate(scene, duration, start, path, record=("q", "energy", "source_loss"), **how, **ONCE)


def continuous(scene, duration):
    """The same by SciPy, V = V0 - R_s sum d I at every instant: angles (samples, 7), energy given by the source [J]."""
    from scipy.integrate import solve_ivp

    servo, source = scene.model.servos["joint1"], scene.model.supply
    armature, period = scene.constants.armature, servo.controller.period

    def rates(t, y, d):
        q, qd, I = y[:7], y[7:14], y[14:21]
        V = source.voltage - source.resistance * (d @ I)
        rate = (d * V - GK * qd - R * I) / servo.inductance
        held = (np.abs(I) >= servo.current_limit) & (rate * I > 0.0)
        I = np.clip(I, -servo.current_limit, servo.current_limit)
        tau = GK * I - servo.viscous_friction * qd
        qdd = forward_dynamics(scene.model, q, qd, tau, armature=armature)
        return np.concatenate([qd, qdd, np.where(held, 0.0, rate), [source.voltage * (d @ I)]])

    y, angles = np.zeros(22), [np.zeros(7)]
    for k in range(round(duration / period)):
        d = np.clip(servo.controller.Kp * (0.5 - y[:7]) / servo.voltage_limit, -1.0, 1.0)
        y = solve_ivp(rates, (0.0, period), y, "DOP853", rtol=1e-8, atol=1e-8, args=(d,)).y[:, -1]
        if (k + 1) % round(0.01 / period) == 0:
            angles.append(y[:7])
    return np.array(angles), y[21]


@pytest.mark.long
def test_a_bus_held_for_a_tick_is_a_continuous_one_to_two_milliradians():
    """Without resistance SciPy's motion is ours; with it, which is worth 50 mrad, the difference goes with the tick."""
    scene, run = swung(0.01, resistance=0.0)
    angles, given = continuous(scene, 0.5)
    np.testing.assert_allclose(run["q"], angles, rtol=0, atol=2e-8)
    assert run["energy"][-1, :, energies.SUPPLY].sum() == pytest.approx(given, rel=1e-8)
    errors = []
    for period in (0.01, 0.005):
        scene, fed = swung(period)
        angles, given = continuous(scene, 0.5)
        errors.append(np.abs(fed["q"] - angles).max())
        loss = fed["source_loss"][-1, 0]
        assert fed["energy"][-1, :, energies.SUPPLY].sum() + loss == pytest.approx(given, rel=1e-3)
    assert errors[0] < 2e-3
    assert 1.6 < errors[0] / errors[1] < 2.4
    assert 0.04 < np.abs(run["q"] - swung(0.01)[1]["q"]).max() < 0.06


# ---------------------------------------------------------------------------------------------- refusals


@pytest.mark.nojit
def test_info_tells_of_the_source():
    assert _servo_table(arm().model)[-1] == "supply of all servos: 11.1 V, 0.5 Ohm"


@pytest.mark.nojit
@pytest.mark.parametrize("numbers", [{"voltage": 0.0}, {"voltage": math.nan}, {"voltage": 5.0, "resistance": -1.0}])
def test_a_source_of_impossible_numbers_is_refused(numbers):
    with pytest.raises(ValueError, match=r"supply: \w+ is .* \[(V|Ohm)\]; expected"):
        Supply(**numbers)


@pytest.mark.nojit
def test_what_a_source_cannot_feed_is_refused():
    robot = load_robot("arm7")
    continuous = load_servo("ax12", law="pd", Kp=1.0)
    fed = replace(robot, servos=dict.fromkeys(robot.joint_names, continuous), supply=Supply(V0))
    with pytest.raises(ValueError, match="a supply feeds motors, and pd servos have none"):
        compile_scene(fed, "rotor")
    assert compile_scene(replace(robot, supply=Supply(V0))).constants.supply is None  # without servos it feeds nothing
    with pytest.raises(TypeError, match=r"supply is 11\.1; give Supply"):
        replace(robot, supply=V0)
    scene = compile_scene(robot, "rotor")
    with pytest.raises(ValueError, match="worlds: supply: voltage is given, but the scene of arm7 has none"):
        Worlds(runs=1, supply={"voltage": 9.0}).scenes(scene)
    with pytest.raises(ValueError, match="there is no number 'capacity'; use one of voltage, resistance"):
        Worlds(runs=1, supply={"capacity": 9.0})


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("resistance = 0.1", "supply: voltage is None"),
        ("voltage = 11.1\nvolts = 3.0", "supply.*volts"),
        ("voltage = -11.1", r"supply: voltage is -11\.1 \[V\]; expected > 0"),
    ],
)
def test_a_file_with_a_wrong_supply_is_refused(tmp_path, lines, message):
    from featherstone_gait import save_robot

    save_robot(load_robot("ax12_arm"), tmp_path / "arm.urdf")
    text = (tmp_path / "arm.toml").read_text("utf-8")
    (tmp_path / "arm.toml").write_text(f"{text}\n[supply]\n{lines}\n", "utf-8")
    with pytest.raises(ValueError, match=message):
        load_robot(tmp_path / "arm.urdf")
