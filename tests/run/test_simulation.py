"""Simulations: arguments, records, torques and pushes against closed forms, joint stops, and how runs end."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scenes import NEVER_FALLEN, G, arm_scene, box, box_on, pendulum, resting, thrown, with_controller
from scipy.integrate import solve_ivp
from scipy.special import lambertw

from featherstone_gait.core.effects import energies
from featherstone_gait.core.effects.stop import STOP_DEPTH
from featherstone_gait.dynamics import energy, mass_matrix
from featherstone_gait.model import Ground
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import PARTS, Push, initial_state, simulate, simulate_batch
from featherstone_gait.run.trajectory import Trajectory
from featherstone_gait.scene.compile import compile_scene
from featherstone_gait.scene.stop import CRITICAL_DEPTH

NOWHERE = Ground(height=-100.0)
ZERO = (0.0,)


def hinge(integrator="implicit_euler", timestep=1e-3, gravity=True, **joint):
    return compile_scene(
        pendulum(**joint), integrator=integrator, timestep=timestep, gravity=(0.0, 0.0, -G if gravity else 0.0)
    )


# Arguments.

BAD_CALLS = {
    "duration zero": (dict(duration=0.0), "duration is 0.0 s; it must be positive"),
    "duration without end": (dict(duration=math.inf), "positive and finite"),
    "duration not a number": (dict(duration=math.nan), "positive and finite"),
    "an unknown channel": (dict(record=("q", "speed")), "no channel or sensor 'speed'; there are .*qd"),
    "half a step between samples": (dict(record_interval=1.5e-3), "record_interval is 0.0015 s; .* steps of 0.001 s"),
    "no time between samples": (dict(record_interval=0.0), "whole number of steps"),
    "a state too short": (dict(state=np.zeros(3)), r"state must be \d+ finite numbers; its shape is \(3,\)"),
    "a state that is not finite": (dict(state="nan"), "state must be"),
    "a reference too narrow": (
        dict(reference=Reference([0.0], [[0.0]])),
        "reference has 1 columns; the robot has 7",
    ),
    "a reference that is an array": (dict(reference=np.zeros(7)), "reference is a ndarray; give Reference"),
    "torques too few": (dict(tau=[0.0, 1.0]), "tau must be 7 finite numbers"),
    "an infinite torque": (dict(tau=[math.inf] + [0.0] * 6), "tau must be 7 finite"),
    "torques over time too few": (dict(tau=Reference([0.0], [[0.0, 1.0]])), "tau has 2 columns"),
    "a push on nothing": (dict(pushes=[Push("tail")]), "no link 'tail'; links: "),
    "an endless force": (dict(pushes=[Push("base", (math.inf, 0.0, 0.0))]), "finite numbers"),
    "a push that ends first": (dict(pushes=[Push("base", start=1.0, end=0.5)]), "start before the end"),
}


@pytest.mark.nojit
@pytest.mark.parametrize("case", BAD_CALLS)
def test_arguments_that_do_not_fit_are_refused(case):
    arguments, message = BAD_CALLS[case]
    scene = arm_scene()
    if isinstance(arguments.get("state"), str):
        arguments = {"state": np.where(np.arange(len(initial_state(scene))) == 3, np.nan, 0.0)}
    with pytest.raises(ValueError, match=message):
        simulate(scene, **{"duration": 0.1, **arguments})


@pytest.mark.nojit
def test_what_a_scene_has_no_use_for_is_refused():
    with pytest.raises(ValueError, match="a reference needs servos"):
        simulate(hinge(), 0.1, reference=Reference([0.0], [[0.0]]))
    with pytest.raises(ValueError, match="simtwo takes its torques from the servos"):
        simulate(arm_scene(gearbox="standard", integrator="simtwo"), 0.1, tau=np.zeros(7))
    with pytest.raises(ValueError, match=r"\[2, 3, 3, 3\] entries"):
        simulate_batch(arm_scene(), 0.1, [None] * 2, [None] * 3, [None] * 3)


@pytest.mark.nojit
@pytest.mark.parametrize(
    ("q", "qd", "message"),
    [
        (np.zeros(7), None, "quaternion"),
        (np.zeros(6), None, "q must be 7 finite numbers"),
        (None, [np.nan] * 6, "qd must be 6 finite numbers"),
    ],
)
def test_states_that_are_none_are_refused(q, qd, message):
    with pytest.raises(ValueError, match=message):
        initial_state(box_on(Ground()), q, qd)


# Records.


@pytest.mark.nojit
def test_every_channel_has_its_shape():
    scene, n = arm_scene(), 7
    run = simulate(scene, 0.02, record=PARTS, record_interval=2e-3)
    one_a_joint = "q qd current rotor rotor_speed filtered_speed voltage integral qdd torque power velocity_change"
    one_a_joint += " chatter worst_chatter"
    shapes = dict.fromkeys(one_a_joint.split(), (11, n))
    shapes |= {
        "time": (11,),
        "energy": (11, n, energies.ENERGIES),
        "contact_work": (11, 1),
        "newton_iterations": (11, 2),
    }
    absent = (
        "tangential_deflection",
        "contact_force",
        "clearance",
        "profiled_reference",
        "duty",
        "bus_voltage",
        "source_loss",
    )
    for name in run:
        none = ("base", "ball", "pair", "tendon", "loop", "fluid", "immersed", "surface", "rolling")
        nothing = name.startswith(none) or name in absent
        assert run[name].size == 0 if nothing else run[name].shape == shapes[name], name
    np.testing.assert_allclose(run["time"], np.arange(11) * 2e-3, rtol=0, atol=1e-15)


@pytest.mark.nojit
def test_channels_of_a_floating_robot_on_the_ground():
    scene = box_on(Ground())
    run = simulate(scene, 0.02, record=("base_q", "base_qd", "base_qdd", "tangential_deflection", "contact_force"))
    shapes = {name: values.shape for name, values in run.items()}
    assert shapes == {
        "time": (3,),
        "base_q": (3, 7),
        "base_qd": (3, 6),
        "base_qdd": (3, 6),
        "tangential_deflection": (3, 4, 2),
        "contact_force": (3, 4, 3),
    }


def test_where_no_channels_are_named_positions_and_velocities_are_recorded():
    """Of a base that floats too, or nobody could show where the robot is; among others that do not, the joints'."""
    arm, thing = arm_scene(), compile_scene(load_robot("humanoid"), "mipsd", Ground())
    recorded = [{*run.channels} - {"time"} for run in (simulate(arm, 0.02), simulate(thing, 0.02))]
    assert recorded == [{"q", "qd"}, {"q", "qd", "base_q", "base_qd"}]
    for run in simulate_batch([arm, thing], 0.02):
        assert {*run.channels} == {"time", "q", "qd"}
    assert all("base_q" in run for run in simulate_batch(thing, 0.02, [None, None]))


def test_what_is_recorded_and_how_often_does_not_change_the_run():
    scene, state = arm_scene(), initial_state(arm_scene(), np.full(7, 0.2))
    reference = Reference([0.0], np.zeros((1, 7)))
    runs = [
        simulate(scene, 0.1, state, reference, record=record, record_interval=sample)
        for record, sample in [(("q",), 1e-3), (("energy", "q"), 5e-3), ((), 0.1), (("q",), None)]
    ]
    assert len({run.final.tobytes() for run in runs}) == 1
    assert np.array_equal(runs[0]["q"][::5], runs[1]["q"])
    assert np.array_equal(runs[0]["q"][::10], runs[3]["q"])
    assert np.array_equal(runs[0]["q"][0], np.full(7, 0.2))
    o = scene.layout
    assert np.array_equal(runs[0]["q"][-1], runs[0].final[o["q"] : o["q"] + 7])


@pytest.mark.nojit
def test_the_duration_is_rounded_up_to_ticks_and_samples_need_not_divide_it():
    scene = arm_scene()
    run = simulate(scene, 0.021, record_interval=7e-3)
    assert run.end_time == pytest.approx(0.03, abs=1e-12)
    np.testing.assert_allclose(run["time"], [0.0, 0.007, 0.014, 0.021, 0.028], rtol=0, atol=1e-15)


def test_a_state_is_left_as_it_was():
    scene = arm_scene()
    state = initial_state(scene, np.full(7, 0.2))
    kept = state.copy()
    simulate(scene, 0.05, state)
    assert np.array_equal(state, kept)


@pytest.mark.quick("*-0.001")
@pytest.mark.parametrize(
    ("servos", "integrator", "timestep"),
    [("mipsd", "implicit_euler", 1e-3), ("rotor", "rk4", 1e-4), ("standard", "simtwo", 1e-3)],
)
@pytest.mark.parametrize("law", ["state", "pid_position", "pid_speed"])
def test_a_run_in_two_parts_has_the_bits_of_one(law, servos, integrator, timestep):
    arm = with_controller(load_robot("arm7"), law=law, Ki=20.0, Kd=0.3)
    scene, reference = arm_scene(arm, servos, integrator, timestep), Reference([0.0], [[0.1] * 7])
    start = initial_state(scene, np.full(7, 0.05), np.full(7, -0.3))
    whole = simulate(scene, 0.1, start, reference, record=PARTS)
    first = simulate(scene, 0.04, start, reference, record=PARTS)
    second = simulate(scene, 0.06, first.final, reference, record=PARTS)
    for part in PARTS:
        joined = np.concatenate([first[part][:-1], second[part]])
        assert np.array_equal(joined, whole[part]), part
    assert np.abs(whole["qd"]).max() > 0.01


def test_a_walk_on_the_ground_in_two_parts_has_the_bits_of_one():
    scene = box_on(Ground(), "midpoint")
    state = thrown(scene, 0.01, 0.2, (0.2, 0.1, 0.0))
    whole, first = (simulate(scene, t, state, record=PARTS) for t in (0.4, 0.13))
    second = simulate(scene, 0.27, first, record=PARTS)
    for part in PARTS:
        assert np.array_equal(np.concatenate([first[part][:-1], second[part]]), whole[part]), part


def test_a_run_goes_on_only_in_a_scene_whose_state_has_the_same_parts(tmp_path):
    """A trajectory knows the names of its state's parts, also one from a file."""
    run = simulate(arm_scene(gearbox="mipsd"), 0.02)
    run.save(tmp_path / "run")
    for trajectory in (run, Trajectory.load(tmp_path / "run")):
        assert simulate(arm_scene(gearbox="mipsd"), 0.02, trajectory).ok
        with pytest.raises(ValueError, match=r"rotor 7.*this scene of arm7 has .*same servos and contacts"):
            simulate(arm_scene(gearbox="rotor"), 0.02, trajectory)


@pytest.mark.long
def test_an_actuator_put_in_by_hand_is_not_lost():
    scene, other = arm_scene(gearbox="rotor"), arm_scene(gearbox="mipsd")
    changed = replace(scene, constants=scene.constants._replace(actuator=other.constants.actuator))
    for how in ({"estimate_error": True}, {"rtol": 1e-6}):
        with pytest.raises(ValueError, match="arm7: actuator of the scene's constants were put in by hand"):
            simulate(changed, 0.02, **how)


@pytest.mark.long
def test_pushes_of_a_scene_stay_with_it():
    push = Push("link7", (1.0, 1.0, 0.0), end=0.01)
    scene = arm_scene(gearbox=None)
    for how in ({"estimate_error": True}, {"rtol": 1e-8}):
        runs = [simulate(scene.pushed([push]), 0.02, **how), simulate(scene, 0.02, pushes=[push], **how)]
        assert np.array_equal(runs[0]["q"], runs[1]["q"])
        assert np.abs(runs[0]["q"] - simulate(scene, 0.02, **how)["q"]).max() > 1e-3


@pytest.mark.quick("mipsd")
@pytest.mark.parametrize("servos", [None, "rotor", "mipsd"])
def test_power_is_torque_times_velocity(servos):
    scene = arm_scene(gearbox=servos)
    run = simulate(scene, 0.05, initial_state(scene, np.full(7, 0.2)), record=("power", "qd"), record_interval=1e-3)
    torque = simulate(scene, 0.05, initial_state(scene, np.full(7, 0.2)), record=("torque",), record_interval=1e-3)[
        "torque"
    ]
    assert np.array_equal(run["power"], torque * run["qd"])
    assert list(run) == ["time", "power", "qd"]


# Torques, friction and pushes.


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "tolerance"), [("implicit_euler", 2e-3), ("rk4", 1e-9)])
def test_a_constant_torque_turns_a_damped_joint_as_it_must(integrator, tolerance):
    scene = hinge(integrator, gravity=False)
    I, b, T, t = 1.0 * 0.5**2 / 3, 0.05, 0.2, 1.0
    run = simulate(scene, t, tau=[T])
    decay = math.exp(-b * t / I)
    assert run["qd"][-1, 0] == pytest.approx(T / b * (1 - decay), rel=tolerance)
    assert run["q"][-1, 0] == pytest.approx(T / b * (t - I / b * (1 - decay)), rel=tolerance)


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "tolerance"), [("implicit_euler", 2e-3), ("rk4", 1e-8)])
@pytest.mark.parametrize("kind", ["hold", "linear", "cubic"])
def test_torques_over_time_swing_a_pendulum_as_they_must(integrator, tolerance, kind):
    times, values = np.array([0.0, 0.3, 0.5, 1.0]), np.array([[0.0], [0.4], [-0.3], [0.2]])
    tau = Reference(times, values, kind)
    run = simulate(hinge(integrator), 1.0, tau=tau)
    coefficients = tau.knots().cubics[:, 0]
    q, qd = 0.0, 0.0
    for k, (start, end) in enumerate(pairwise(times)):

        def rates(t, x, k=k, start=start):
            s = t - start
            torque = coefficients[k] @ [1.0, s, s**2, s**3]
            return [x[1], (torque - 0.05 * x[1] - 0.25 * G * math.sin(x[0])) / (0.25 / 3)]

        q, qd = solve_ivp(rates, (start, end), [q, qd], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    assert run["q"][-1, 0] == pytest.approx(q, abs=tolerance)
    assert run["qd"][-1, 0] == pytest.approx(qd, abs=5 * tolerance)


@pytest.mark.long
def test_dry_friction_stops_a_joint_after_its_momentum_over_its_torque():
    scene = hinge(gravity=False, damping=0.0, friction=0.1)
    run = simulate(
        scene, 1.0, initial_state(scene, ZERO, [0.5]), tau=ZERO, record=("q", "qd", "energy"), record_interval=1e-3
    )
    stop = 0.5 * (0.25 / 3) / 0.1
    assert run["qd"][int(stop * 1000) - 5, 0] > 0.0
    assert abs(run["qd"][int(stop * 1000) + 20, 0]) < 1e-6
    assert run["q"][-1, 0] == pytest.approx(0.5 * stop / 2, rel=5e-3)
    assert run["energy"][-1, 0, energies.FRICTION] == pytest.approx(0.5 * (0.25 / 3) * 0.5**2, rel=5e-3)


@pytest.mark.long
def test_dry_friction_holds_below_its_torque_and_gives_above():
    scene = hinge(gravity=False, damping=0.0, friction=0.1)
    held, moved = (simulate(scene, 1.0, tau=[T])["qd"][-1, 0] for T in (0.099, 0.11))
    assert abs(held) < 1.1e-3  # it creeps below the speed at which friction is in full force
    assert moved == pytest.approx(0.01 / (0.25 / 3), rel=0.02)


@pytest.mark.long
@pytest.mark.nojit
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "rk4"])
def test_a_push_changes_momentum_by_force_times_time(integrator):
    """Also where it begins and ends between steps, and where it is shorter than one."""
    scene = box_on(NOWHERE, integrator, 2e-3, model=box(mass=2.0))
    pushes = [
        Push("box", (3.0, -1.0, 0.5), start=0.01, end=0.06),
        Push("box", (1.0, 0.0, 0.0), start=0.0503, end=0.1511),
        Push("box", (0.0, 500.0, 0.0), start=0.0705, end=0.0712),
        Push("box", (9.0, 9.0, 9.0), start=1.0),
    ]
    run = simulate(scene, 0.2, initial_state(scene, np.eye(7)[3]), pushes=pushes, record=("base_q", "base_qd"))
    impulse = np.array([3.0, -1.0, 0.5]) * 0.05 + [0.1008, 0.35, 0.0]
    np.testing.assert_allclose(run["base_qd"][-1, :3], impulse / 2.0 + [0.0, 0.0, -G * 0.2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(run["base_qd"][-1, 3:], 0.0, atol=1e-12)


@pytest.mark.long
def test_a_force_beside_the_center_turns_like_its_moment():
    scene, model = box_on(NOWHERE), box()
    state = initial_state(scene, np.eye(7)[3])
    beside = simulate(
        scene, 0.01, state, pushes=[Push("box", (0.0, 0.0, 2.0), point=(0.1, 0.05, 0.0))], record=("base_qd",)
    )
    couple = simulate(
        scene, 0.01, state, pushes=[Push("box", (0.0, 0.0, 2.0), moment=(0.1, -0.2, 0.0))], record=("base_qd",)
    )
    np.testing.assert_allclose(beside["base_qd"], couple["base_qd"], rtol=0, atol=1e-4)
    turning = np.array([0.1, -0.2, 0.0]) / np.array(model.links[0].inertia)[[0, 3, 5]] * 0.01
    np.testing.assert_allclose(couple["base_qd"][-1, 3:], turning, rtol=1e-3, atol=1e-6)


# Joint stops.


@pytest.mark.long
@pytest.mark.parametrize(
    ("integrator", "timestep", "tolerance"),
    [("implicit_euler", 1e-4, 0.1), ("midpoint", 1e-3, 1e-4), ("rk4", 1e-4, 1e-3)],
)
@pytest.mark.parametrize("speed", [0.0, 0.25, 0.5, 0.75, 1.0])
def test_a_stop_catches_a_swinging_link_and_takes_its_energy(integrator, timestep, tolerance, speed):
    limit, torque = 0.4, 1.0
    scene = hinge(integrator, timestep, lower=-limit, upper=limit)
    run = simulate(scene, 5.0, initial_state(scene, [-0.3], [speed]), tau=[torque], record=("q", "qd", "energy"))
    assert run.status == ("inaccurate" if tolerance > 0.01 else "ok"), run.message  # a balance open by 3 % says so
    end, E = run["q"][-1, 0], run["energy"][:, 0]
    assert limit < run["q"].max() < limit + STOP_DEPTH
    push = scene.constants.stops[0].stiffness * (end - limit)
    assert push == pytest.approx(torque - 0.25 * G * math.sin(end), rel=1e-4)
    stored = energy(scene.model, run["q"], run["qd"]).sum(axis=1)
    balance = stored - stored[0] - E[:, energies.WORK] + E[:, energies.FRICTION] + E[:, energies.STOPS]
    assert E[-1, energies.STOPS] > 0.1
    assert np.abs(balance).max() < tolerance * E[-1, energies.STOPS]


def rebound(d, speed):
    """Speed at which J dv/dt = -K x (1 + d v) lets go what came in at `speed`, whatever K and J are.

    v dv / (1 + d v) = -K/J x dx: the left side's integral from the speed to rest is that from rest to the speed u back,
    -d u - log(1 - d u) = d v - log(1 + d v), whose solution is Lambert's function.
    """
    turned = d * speed - math.log1p(d * speed)
    return (1.0 + lambertw(-math.exp(-1.0 - turned)).real) / d


@pytest.mark.long
@pytest.mark.parametrize("speed", [0.5, 5.0])
def test_a_stop_lets_go_as_the_scalar_equation_does(speed):
    scene = hinge("rk4", 1e-5, lower=-0.4, upper=0.4, gravity=False, damping=0.0)
    run = simulate(scene, 0.5, initial_state(scene, [0.39], [speed]), record=("q", "qd"))
    assert run["q"][-1, 0] < 0.4
    assert -run["qd"][-1, 0] == pytest.approx(rebound(scene.constants.stops[0].damping, speed), rel=1e-6)


@pytest.mark.parametrize("servos", ["standard", "rotor", "mipsd"])
def test_a_stop_is_critically_damped_at_its_depth_with_the_inertia_of_the_joint(servos):
    """The gear's spring keeps the rotor of "mipsd" from the stop; "standard" has none."""
    arm = load_robot("ax12_arm")
    joint, servo = arm.moving_joints[0], arm.servos[arm.joint_names[0]]
    model = replace(arm, joints=tuple(replace(j, lower=-1.0, upper=1.0) if j == joint else j for j in arm.joints))
    stop = compile_scene(model, servos).constants.stops[0]
    inertia = mass_matrix(model, [0.0])[0, 0]
    if servos == "rotor":
        inertia += servo.gearbox.ratio**2 * servo.gearbox.rotor_inertia
    critical = 2.0 * math.sqrt(stop.stiffness * inertia)
    assert stop.stiffness * stop.damping * CRITICAL_DEPTH == pytest.approx(critical, rel=1e-12)


@pytest.mark.long
def test_a_stop_pushes_only_back():
    """A joint that leaves its stop is not held by it."""
    scene = hinge(lower=-0.4, upper=0.4, gravity=False, damping=0.0)
    run = simulate(
        scene, 0.2, initial_state(scene, [0.399], [0.5]), tau=[-0.5], record=("q", "qd"), record_interval=1e-3
    )
    free = run["q"][:, 0] < 0.4
    after = np.flatnonzero(free & (np.arange(len(free)) > np.argmin(free)))
    acceleration = np.diff(run["qd"][after, 0]) / 1e-3
    np.testing.assert_allclose(acceleration, -0.5 / (0.25 / 3), rtol=1e-9)
    assert not free.all()


# Gravity.

MOON = 1.62  # [m/s^2]


@pytest.mark.long
def test_a_box_sinks_in_on_the_moon_as_deep_as_asked_for():
    scene = compile_scene(box(), ground=Ground(penetration=1e-3), gravity=(0.0, 0.0, -MOON), **NEVER_FALLEN)
    start = initial_state(scene)
    run = simulate(scene, 1.0, start, record=("base_q", "contact_force"))
    assert np.abs(run["base_q"][:, 2] - start[2]).max() < 1e-9  # it starts at that depth
    assert run["contact_force"][-1, :, 0].sum() == pytest.approx(scene.model.mass * MOON, rel=1e-9)
    earth = compile_scene(box(), ground=Ground(penetration=1e-3), **NEVER_FALLEN)
    stiffness = [s.constants.contact.points.stiffness[0] for s in (scene, earth)]
    assert stiffness[0] / stiffness[1] == pytest.approx(MOON / G, rel=1e-12)
    limits = [s.preflight.largest_explicit_step for s in (scene, earth)]
    assert limits[0] / limits[1] == pytest.approx(math.sqrt(G / MOON), rel=1e-12)


@pytest.mark.parametrize(("gravity", "weight"), [((0.0, 0.0, -MOON), MOON), ((0.0, 0.6, -0.8), 1.0), (ZERO * 3, G)])
def test_stops_of_joints_that_nothing_drives_carry_the_robot_at_a_tenth_of_a_meter(gravity, weight):
    """Without weight they are those of Earth."""
    model = pendulum(lower=-0.4, upper=0.4, effort=math.inf)
    stop = compile_scene(model, gravity=gravity).constants.stops[0]
    assert stop.stiffness == pytest.approx(0.1 * model.mass * weight / STOP_DEPTH, rel=1e-12)


def test_a_sliding_joint_s_stop_carries_the_robot_s_weight_a_millimeter_deep():
    """K x = m g at rest."""
    model = pendulum(lower=-0.1, upper=0.1, effort=math.inf, damping=0.0)
    model = replace(model, joints=[replace(model.joints[0], type="prismatic", axis=(0.0, 0.0, 1.0))])
    scene = compile_scene(model)
    run = simulate(scene, 1.0, initial_state(scene, [-0.1]), record=("q",))
    assert -0.1 - run["q"][-1, 0] == pytest.approx(1e-3, rel=1e-6)


@pytest.mark.parametrize("gravity", [9.81, (0.0, 0.0), (0.0, 0.0, math.nan), (0.0, 0.0, math.inf), "down", None])
def test_gravity_is_three_finite_numbers(gravity):
    with pytest.raises(ValueError, match=r"gravity .*3 finite numbers"):
        compile_scene(box(), gravity=gravity)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, G), (G, 0.0, 0.0)])
def test_gravity_must_not_pull_away_from_the_ground(gravity):
    with pytest.raises(ValueError, match=r"box: ground under gravity .* presses nothing on it.*gravity=\(0, 0, 0\)"):
        compile_scene(box(), ground=Ground(), gravity=gravity)


@pytest.mark.parametrize("penetration", [1e-3, 4e-3])
def test_without_gravity_ground_is_as_stiff_as_under_the_weight_on_earth(penetration):
    """A box that comes at v sinks in by v sqrt(x / g), where x is what its weight would sink it in by; and leaves at v.

    It does after half a period of its springs, pi sqrt(x / g).
    """
    ground = Ground(penetration=penetration, damping_ratio=0.0)
    scene = compile_scene(box(), None, ground, "rk4", 2e-4, gravity=(0.0, 0.0, 0.0), **NEVER_FALLEN)
    start, how = thrown(scene, 0.1, velocity=(0.0, 0.0, -1.0)), {"record_interval": scene.timestep}
    run = simulate(scene, 0.3, start, record=("base_q", "base_qd"), **how)
    assert run.ok
    assert run["base_qd"][-1, 2] == pytest.approx(1.0, abs=1e-3)
    deepest = math.sqrt(penetration / G)
    between = (scene.timestep / deepest) ** 2 / 8.0  # records half a step from the turning point miss so much of it
    assert 0.05 - run["base_q"][:, 2].min() == pytest.approx(deepest, rel=between + 1e-4)
    touching = run["time"][run["base_q"][:, 2] < 0.05]
    assert np.ptp(touching) == pytest.approx(math.pi * deepest, abs=2.0 * scene.timestep)


# How runs end.


def explosive_arm():
    """An explicit step ten times too large, and no limit on the motors' currents that would tame it."""
    arm = load_robot("arm7")
    unlimited = {name: replace(s, current_limit=math.inf, current_slew=math.inf) for name, s in arm.servos.items()}
    return arm_scene(replace(arm, servos=unlimited), "standard", "rk4", 2e-3)


def test_a_humanoid_that_is_thrown_over_fell():
    scene = compile_scene(load_robot("humanoid"), "mipsd", Ground(), "midpoint", 1e-3)
    state = initial_state(scene)
    state[scene.layout["base_qd"]] = 2.0
    run = simulate(scene, 2.0, state, record=("base_q", "q"))
    assert run.status == "fell"
    assert 0.1 < run.end_time < 1.5
    assert f"humanoid fell at {run.end_time:.4g} s" in run.message
    last = np.searchsorted(run["time"], run.end_time - 1e-9)
    assert np.array_equal(run["base_q"][last:], np.repeat(run["base_q"][last : last + 1], len(run["time"]) - last, 0))
    assert np.isfinite(run.final).all()
    assert not np.array_equal(run["base_q"][last - 1], run["base_q"][last])


@pytest.mark.long
def test_an_explicit_step_too_large_diverges_and_says_when_and_where():
    scene = explosive_arm()
    run = simulate(scene, 1.0, initial_state(scene, np.full(7, 0.1)), record=("q", "qd"))
    assert run.status == "diverged"
    assert run.end_time < 1.0
    assert f"arm7 diverged at {run.end_time:.4g} s" in run.message
    assert any(name in run.message for name in scene.model.joint_names)
    assert np.isfinite(run["q"]).all()
    assert np.isfinite(run.final).all()
    last = np.searchsorted(run["time"], run.end_time - 1e-9)
    assert np.array_equal(run["q"][last], run["q"][-1])


@pytest.mark.long
def test_the_state_before_a_divergence_is_the_sound_one_of_that_time():
    scene = explosive_arm()
    state = initial_state(scene, np.full(7, 0.1))
    whole = simulate(scene, 1.0, state)
    before = whole.end_time - scene.tick_steps * scene.timestep
    if before > 0:
        short = simulate(scene, before, state)
        assert short.ok
        state = short.final
    o = scene.layout
    assert whole.final[: o["status"]].tobytes() == state[: o["status"]].tobytes()


@pytest.mark.long
def test_a_failed_run_stays_failed():
    scene = explosive_arm()
    failed = simulate(scene, 1.0, initial_state(scene, np.full(7, 0.1)))
    again = simulate(scene, 1.0, failed.final)
    assert (again.status, again.end_time) == (failed.status, failed.end_time)
    assert again.final.tobytes() == failed.final.tobytes()


def test_the_2012_order_chatters_with_rigid_gearboxes_and_names_joint_and_step():
    scene = arm_scene(gearbox="standard", integrator="simtwo")
    run = simulate(scene, 2.0, initial_state(scene, np.full(7, 0.1)))
    assert run.status in ("chatter", "diverged")
    assert any(name in run.message for name in scene.model.joint_names)
    assert run.status == "diverged" or "0.001 s is too large for simtwo" in run.message


@pytest.mark.parametrize("integrator", ["implicit_euler"])
def test_a_servo_that_works_is_not_said_to_chatter(integrator):
    scene = arm_scene(integrator=integrator)
    steps = Reference([0.0, 0.5, 1.0], [[0.0] * 7, [0.3] * 7, [-0.3] * 7], "hold")
    run = simulate(scene, 2.0, reference=steps, estimate_error=False)
    assert (run.status, run.message, run.end_time) == ("ok", "", pytest.approx(2.0))


def test_a_run_says_how_it_was_made():
    scene = box_on(Ground(), "midpoint", 2e-3)
    info = simulate(scene, 0.1, resting(scene)).info
    assert (info["robot"], info["integrator"], info["timestep"], info["servos"]) == ("box", "midpoint", 2e-3, None)
    assert info["not_converged_steps"] == 0
    assert info["newton_passes"] >= 50
