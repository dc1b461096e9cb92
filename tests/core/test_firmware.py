"""Firmware of servos against closed forms: dead band and punch, duty cycle, profile speed, delay; files; bits."""

import hashlib
import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import pendulum, with_controller

from featherstone_gait import Reference, Supply, Trajectory, Worlds, compile_scene, load_robot, save_robot
from featherstone_gait.model import FIRMWARE, Controller
from featherstone_gait.robot_file import load_servo
from featherstone_gait.run.simulate import initial_state, simulate, simulate_batch

IDEAL = {  # a motor whose torque is K V / R at rest
    "inductance": 0.0, "speed_filter": 0.0, "current_limit": math.inf, "current_slew": math.inf,
    "viscous_friction": 0.0, "coulomb_friction": 0.0, "lag": 0.0,
}  # fmt: skip
LOCKED = IDEAL | {"rotor_inertia": 1e10}  # no torque moves it by the last bit of an angle
WEIGHTLESS = (0.0, 0.0, 0.0)
ONCE = {"estimate_error": False}
FULL = {  # all of it
    "compliance_margin": 0.005, "punch": 0.3, "pwm_steps": 1023.0, "duty_limit": 0.95, "profile_speed": 1.0,
    "delay": 0.013,
}  # fmt: skip


def rod(integrator="implicit_euler", gearbox="rotor", timestep=1e-3, gravity=WEIGHTLESS, **changes):
    """A rod with one servo at its joint."""
    model = replace(pendulum(damping=0.0), servos={"hinge": load_servo("ax12", **{**LOCKED, **changes})})
    return compile_scene(model, gearbox, integrator=integrator, timestep=timestep, gravity=gravity)


def still(angle=0.0):
    return Reference([0.0], [[angle]])


def held(scene, errors, name):
    """A channel at the end of a tick, of locked servos with these errors of position (n,) [rad]."""
    states = [initial_state(scene, [-e]) for e in errors]
    runs = simulate_batch(scene, 0.01, states, [still()] * len(errors), record=(name,), record_interval=1e-3, **ONCE)
    return np.array([run[name][-1, 0] for run in runs])


# ---------------------------------------------------------------------------------------------- the law


@pytest.mark.long
@pytest.mark.bounds
@pytest.mark.nojit
def test_torque_over_error_is_that_of_the_ax12s_manual():
    """Nothing within the margin, the punch at its edge, full output a slope further on."""
    margin, slope, punch = math.radians(0.29), math.radians(9.4), 32 / 1023 * 10.0
    Kp = (10.0 - punch) / slope
    scene = rod(compliance_margin=margin, punch=punch, Kp=Kp)
    servo = scene.model.servos["hinge"]
    errors = np.array([0.0, 0.5 * margin, margin, 1.0001 * margin, 0.3 * slope, margin + slope, 2.0 * slope])
    errors = np.concatenate([-errors[::-1], errors])
    beyond = np.abs(errors) - margin
    volts = np.where(beyond > 0.0, np.sign(errors) * np.minimum(punch + Kp * beyond, 10.0), 0.0)
    assert volts[-4] == pytest.approx(punch, rel=1e-2)
    assert volts[-2] == pytest.approx(10.0, rel=1e-12)
    torque = held(scene, errors, "torque")
    expected = servo.gearbox.ratio * servo.motor_constant / servo.resistance * volts
    np.testing.assert_allclose(torque, expected, rtol=1e-11, atol=0.0)


@pytest.mark.long
@pytest.mark.bounds
@pytest.mark.nojit
def test_the_dead_band_of_a_speed_law_is_one_of_speed():
    scene = rod(law="pid_speed", Kp=3.0, compliance_margin=0.2, punch=0.5)
    ramp = Reference([0.0, 1.0], [[0.0], [1.5]])
    run = simulate(scene, 0.01, None, ramp, record=("voltage",), **ONCE)
    assert run["voltage"][0, 0] == pytest.approx(3.0 * (1.5 - 0.2) + 0.5, rel=1e-12)


@pytest.mark.long
@pytest.mark.bounds
@pytest.mark.nojit
@pytest.mark.parametrize(
    ("firmware", "volts"),
    [
        ({"compliance_margin": 0.01, "punch": 0.25}, 5.0 * (0.1 - 0.01) + 0.25),  # no kick of an error that stands
        ({"profile_speed": 2.0}, 5.0 * 0.02 + 0.3 * 2.0),  # the goal sets out from the joint, at its speed
    ],
)
def test_the_derivative_term_starts_with_what_the_law_sees(firmware, volts):
    scene = rod(law="pid_position", Kp=5.0, Kd=0.3, **firmware)
    run = simulate(scene, 0.01, initial_state(scene, [-0.1]), still(), record=("voltage",), **ONCE)
    assert run["voltage"][0, 0] == pytest.approx(volts, rel=1e-12)


# ---------------------------------------------------------------------------------------------- duty cycle


@pytest.mark.long
@pytest.mark.bounds
@pytest.mark.nojit
def test_voltages_are_whole_counts_of_the_supply_up_to_the_largest():
    """885 counts, of which 0.957 lets 846 through."""
    errors = np.linspace(-0.3, 0.3, 40)
    scene = rod(pwm_steps=885.0, duty_limit=0.957, Kp=61.0)
    volts = held(scene, errors, "voltage")
    counts = np.clip(np.round(61.0 * errors / 10.0 * 885), -846, 846)
    assert np.abs(counts).max() == 846
    assert volts.tobytes() == (counts / 885 * 10.0).tobytes()


@pytest.mark.long
@pytest.mark.bounds
@pytest.mark.nojit
def test_integration_stops_at_the_largest_duty_cycle():
    scene = rod(law="pid_position", Kp=100.0, Ki=10.0, duty_limit=0.5)
    run = simulate(scene, 0.05, None, still(0.06), record=("voltage", "integral"), **ONCE)
    assert run["voltage"][:, 0].tolist() == [5.0] * 6
    assert run["integral"][-1, 0] == 0.0


# ---------------------------------------------------------------------------------------------- profile


@pytest.mark.long
@pytest.mark.nojit
def test_the_goal_is_a_ramp_that_ends_on_the_reference():
    scene = rod(profile_speed=1.2, Kp=1.0)
    record = ("profiled_reference", "voltage")
    run = simulate(scene, 0.3, initial_state(scene, [0.1]), still(-0.2), record=record, **ONCE)
    ticks = np.arange(1, 31)  # each tick goes a tick's way
    expected = np.maximum(0.1 - 1.2 * 0.01 * ticks, -0.2)
    np.testing.assert_allclose(run["profiled_reference"][:-1, 0], expected, rtol=0, atol=1e-15)
    assert run["profiled_reference"][-1, 0] == -0.2
    np.testing.assert_allclose(run["voltage"][:, 0], run["profiled_reference"][:, 0] - 0.1, rtol=0, atol=1e-15)


@pytest.mark.long
@pytest.mark.nojit
def test_a_reference_slower_than_the_profile_is_followed_as_it_is():
    path = Reference([0.0, 0.1, 0.2], [[0.0], [0.1], [0.05]], "cubic")
    law = {"Kp": 20.0, "Kd": 0.5}
    plain, limited = (
        simulate(scene, 0.2, None, path, record=("q", "voltage"), **ONCE)
        for scene in (rod(rotor_inertia=1e-7, **law), rod(rotor_inertia=1e-7, profile_speed=3.0, **law))
    )
    assert np.abs(plain["q"]).max() > 0.04
    for name in ("q", "voltage"):
        assert plain[name].tobytes() == limited[name].tobytes()


@pytest.mark.long
@pytest.mark.nojit
def test_a_speed_law_goes_at_the_speed_of_the_profile():
    """It follows the goal's rate, of either sign, until the goal is at the reference: then there is none."""
    for target in (0.055, -0.055):
        scene = rod(law="pid_speed", Kp=2.0, profile_speed=1.0)
        run = simulate(scene, 0.1, None, still(target), record=("voltage",), **ONCE)
        expected = np.where(np.arange(11) < 5, math.copysign(2.0, target), 0.0)
        np.testing.assert_allclose(run["voltage"][:, 0], expected, rtol=1e-12, atol=1e-12)


# ---------------------------------------------------------------------------------------------- delay


@pytest.mark.long
@pytest.mark.nojit
@pytest.mark.parametrize("integrator", ["implicit_euler", "ars343"])
def test_voltages_come_exactly_the_delay_later(integrator):
    """Of a locked servo whose reference moves: the same voltages, so many steps later, and none before."""
    path = Reference([0.0, 0.04, 0.1], [[1.1], [0.9], [1.2]])

    def volts(delay, record_interval=1e-3):
        scene = rod(integrator, delay=delay)
        start = initial_state(scene, [1.0])
        run = simulate(scene, 0.1, start, path, record=("voltage",), record_interval=record_interval, **ONCE)
        return run["voltage"][:, 0]

    at_once = volts(0.0)
    assert len(set(at_once.tolist())) > 8
    for steps in (3, 10, 23, 30):
        late = volts(1e-3 * steps)
        assert late[:steps].tolist() == [0.0] * steps
        assert late[steps:-1].tobytes() == at_once[: -steps - 1].tobytes(), steps
    assert volts(13e-3, record_interval=0.01)[2:].tobytes() == at_once[:-20:10].tobytes()  # where no record ends a step


# ---------------------------------------------------------------------------------------------- all of it


def arm(gearbox="rotor", integrator="implicit_euler", timestep=1e-3, **changes):
    """The arm of seven servos with all firmware and a source."""
    model = with_controller(load_robot("arm7"), **{**FULL, "law": "pid_position", "Ki": 5.0, "Kd": 0.1, **changes})
    return compile_scene(replace(model, supply=Supply(11.1, 0.4)), gearbox, integrator=integrator, timestep=timestep)


CHANNELS = ("q", "qd", "energy", "voltage", "profiled_reference", "duty", "bus_voltage", "source_loss")


def moves(count, duration=0.12, seed=0):
    """Starts and references that ask for more than the profile gives."""
    rng = np.random.default_rng(seed)
    paths = [Reference([0.0, 0.5 * duration, duration], rng.uniform(-0.6, 0.6, (3, 7))) for _ in range(count)]
    return rng.uniform(-0.4, 0.4, (count, 7)), paths


def assert_same(run, other):
    assert (run.status, run.message, run.end_time) == (other.status, other.message, other.end_time)
    assert run.final.tobytes() == other.final.tobytes()
    for name in CHANNELS:
        assert run[name].tobytes() == other[name].tobytes(), name



@pytest.mark.quick("implicit_euler-*")
@pytest.mark.parametrize(
    ("integrator", "timestep"),
    [("implicit_euler", 1e-3), ("ars343", 1e-3)]
    + [
        pytest.param(name, h, marks=pytest.mark.long)
        for name, h in (("midpoint", 1e-3), ("rk4", 1e-4), ("simtwo", 1e-3), ("extrapolation", 1e-3), ("dop853", 1e-3))
    ],
)
def test_a_run_in_pieces_has_the_bits_of_one(integrator, timestep, tmp_path):
    """By way of files."""
    scene = arm(integrator=integrator, timestep=timestep)
    (q,), (path,) = moves(1)
    state = initial_state(scene, q)
    whole = simulate(scene, 0.12, state, path, record=CHANNELS, **ONCE)
    assert whole["bus_voltage"].min() < 11.0
    pieces = []
    for length in (0.01, 0.05, 0.06):  # the first ends before a voltage has come through
        pieces.append(simulate(scene, length, state, path, record=CHANNELS, **ONCE))
        pieces[-1].save(tmp_path / "piece")
        state = Trajectory.load(tmp_path / "piece")
    for name in CHANNELS:
        joined = np.concatenate([*(piece[name][:-1] for piece in pieces[:-1]), pieces[-1][name]])
        assert joined.tobytes() == whole[name].tobytes(), name
    assert pieces[-1].final.tobytes() == whole.final.tobytes()


@pytest.mark.long
@pytest.mark.parametrize("servos", ["rotor", pytest.param("mipsd", marks=pytest.mark.long)])
def test_lanes_have_the_bits_of_runs_alone(servos):
    """More runs than lanes, some of them in other worlds, each beside others."""
    scene = arm(servos)
    starts, paths = moves(11)
    rng = np.random.default_rng(1)
    servo = {
        "compliance_margin": 0.01, "punch": 0.5, "pwm_steps": 300.0, "duty_limit": 0.1, "profile_speed": 1.0,
        "voltage_limit": 2.0,
    }  # fmt: skip
    low = {"pwm_steps": 200.0, "duty_limit": 0.8, "voltage_limit": 9.0, "profile_speed": 0.5}
    worlds = Worlds(
        servos={name: low.get(name, 0.0) + width * rng.random(11) for name, width in servo.items()},
        supply={"voltage": rng.uniform(9.0, 12.0, 11), "resistance": rng.uniform(0.0, 1.0, 11)},
    )
    states = [initial_state(one, q) for one, q in zip(worlds.scenes(scene), starts)]
    runs = simulate_batch(scene, 0.12, states, paths, record=CHANNELS, worlds=worlds, **ONCE)
    assert len({run.final.tobytes() for run in runs}) == 11
    for run, one, state, path in zip(runs, worlds.scenes(scene), states, paths):
        assert_same(run, simulate(one, 0.12, state, path, record=CHANNELS, **ONCE))


@pytest.mark.long
@pytest.mark.nojit
def test_the_bits_are_these_compiled_or_not():
    """With all of it, of a run alone and of eight in lanes."""
    scene, (starts, paths) = arm(), moves(9, 0.04)
    states = [initial_state(scene, q) for q in starts]
    runs = [simulate(scene, 0.04, states[0], paths[0], record=CHANNELS, **ONCE)]
    runs += simulate_batch(scene, 0.04, states[1:], paths[1:], record=CHANNELS, **ONCE)
    parts = (part.tobytes() for run in runs for part in (run.final, *(run[name] for name in CHANNELS)))
    assert hashlib.sha256(b"".join(parts)).hexdigest()[:16] == "dd3face14655aa90"


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("section", "name", "value"),
    [
        ("servos", "compliance_margin", 0.02), ("servos", "punch", 0.1), ("servos", "pwm_steps", 885.0),
        ("servos", "duty_limit", 0.5), ("servos", "profile_speed", math.inf), ("servos", "delay", 0.02),
        ("supply", "voltage", 9.0), ("supply", "resistance", 0.1),
    ],
)  # fmt: skip
def test_a_world_is_the_scene_compiled_with_its_number(section, name, value):
    scene = arm()
    (made,) = Worlds(runs=1, **{section: {name: value}}).scenes(scene)
    model = scene.model
    if section == "supply":
        model = replace(model, supply=replace(model.supply, **{name: value}))
    else:
        model = with_controller(model, **{name: value})
    other = compile_scene(model, "rotor", integrator="implicit_euler", timestep=1e-3)
    assert made.parts == other.parts
    assert initial_state(made).tobytes() == initial_state(other).tobytes()
    first, here, there = (repr((one.constants.firmware, one.constants.supply)) for one in (scene, made, other))
    assert here == there != first


def test_what_is_absent_has_no_place_in_state_and_code():
    plain = compile_scene(load_robot("arm7"), "rotor", integrator="implicit_euler", timestep=1e-3)
    assert set(plain.constants.firmware) == {None}
    assert plain.constants.supply is None
    names = ("profiled_reference", "duty", "bus_voltage", "delayed", "source_loss")
    assert all(len(set(plain.part(name))) == 1 for name in names)
    scene = arm()
    sizes = {name: np.ptp(scene.part(name)) for name in names}
    assert sizes == {"profiled_reference": 7, "duty": 7, "bus_voltage": 1, "delayed": 14, "source_loss": 1}


# ---------------------------------------------------------------------------------------------- files and refusals


@pytest.mark.nojit
def test_files_keep_firmware_and_supply(tmp_path):
    model = arm().model
    save_robot(model, tmp_path / "arm.urdf")
    read = load_robot(tmp_path / "arm.urdf")
    assert read.supply == model.supply
    assert dict(read.servos) == dict(model.servos)
    toml = (tmp_path / "arm.toml").read_text("utf-8")
    (tmp_path / "arm.toml").write_text(toml.replace("compliance_margin = 0.005", "compliance_margin_deg = 0.29"))
    read = load_robot(tmp_path / "arm.urdf")
    assert {servo.controller.compliance_margin for servo in read.servos.values()} == {math.radians(0.29)}


def test_mjcf_says_that_it_lacks_them(tmp_path):
    pytest.importorskip("mujoco")
    save_robot(arm().model, tmp_path / "arm.xml")
    text = (tmp_path / "arm.xml").read_text("utf-8")
    for lacking in ("no dead band", "duty cycle is continuous", "limit of the duty", "profile", "delay", "supply"):
        assert lacking in text, lacking


@pytest.mark.nojit
@pytest.mark.parametrize("name", FIRMWARE)
def test_numbers_out_of_range_and_of_continuous_laws_are_refused(name):
    with pytest.raises(ValueError, match=rf"{name} is -0\.5.*expected"):
        Controller("state", **{name: -0.5})
    with pytest.raises(ValueError, match=rf"{name} is .*law 'pd'.*sampled"):
        Controller("pd", Kp=1.0, **{name: 1.0 if name != "duty_limit" else 0.5})


@pytest.mark.nojit
def test_half_a_count_and_more_than_the_supply_are_refused():
    with pytest.raises(ValueError, match=r"pwm_steps is 0\.5.*0 or >= 1"):
        Controller("state", pwm_steps=0.5)
    with pytest.raises(ValueError, match=r"duty_limit is 1\.5.*> 0 and <= 1"):
        Controller("state", duty_limit=1.5)


@pytest.mark.nojit
def test_delays_that_fit_no_step_or_differ_are_refused():
    with pytest.raises(ValueError, match=r"timestep 0\.001 s does not divide the controllers' delay of 0\.0004 s"):
        rod(delay=4e-4)
    with pytest.raises(ValueError, match="10001 voltages wait; at most 1000"):
        rod(delay=100.01)
    robot = load_robot("arm7")
    servos = dict(robot.servos)
    first = robot.joint_names[0]
    servos[first] = replace(servos[first], controller=replace(servos[first].controller, delay=0.01))
    with pytest.raises(ValueError, match=r"controllers differ in delay: \[0\.0, 0\.01\]; give them the same"):
        compile_scene(replace(robot, servos=servos), "rotor")


@pytest.mark.long
def test_an_error_is_told_of_runs_with_a_delay_between_ticks():
    """Twice the step does not divide it, half of it does."""
    scene = rod(rotor_inertia=1e-7, delay=3e-3, Kp=10.0)
    run = simulate(scene, 0.1, None, still(0.2), record=("q",))
    assert run.ok, run.message
    assert 0.0 < run.error["q"].max() < 1e-2
