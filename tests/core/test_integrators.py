"""The integrators against closed forms, against each other and against their own orders and tolerances."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mpmath import mp
from scenes import NEVER_FALLEN, box, box_on, pendulum, resting, thrown, with_controller
from scipy.special import ellipj, ellipk

from featherstone_gait.core.effects import energies
from featherstone_gait.model import Ground, Joint, Link, Model
from featherstone_gait.robot_file import load_robot, load_servo
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import Push, initial_state, simulate, simulate_batch
from featherstone_gait.run.trajectory import Trajectory
from featherstone_gait.scene.compile import compile_scene

UNCLIPPED = {"coulomb_friction": 0.0, "current_limit": 1e3, "current_slew": 1e9, "voltage_limit": 1e3}
ORDERS = {"implicit_euler": 1, "midpoint": 2, "rk4": 4, "dop853": 8}


def unlimited(model):
    """The robot without joint stops."""
    free = {"type": "continuous", "lower": -math.inf, "upper": math.inf}
    return replace(model, joints=tuple(replace(joint, **free) for joint in model.joints))


def pd_arm():
    """The arm in space with stiff continuous servos and no rotor inertia: explicit steps are limited to 0.2 ms."""
    model = unlimited(load_robot("arm7_spatial"))
    servo = load_servo("ax12", law="pd", Kp=12.97, Kd=0.374, viscous_friction=0.0, coulomb_friction=0.0)
    return replace(model, servos=dict.fromkeys(model.joint_names, servo))


def smooth_arm():
    """The seven-joint arm of servos whose limits do not act, with controllers of 10 ms."""
    model = unlimited(load_robot("arm7"))
    return replace(model, servos=dict.fromkeys(model.joint_names, load_servo("ax12", **UNCLIPPED)))


# --- closed forms ------------------------------------------------------------------------------------------------


BOB = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)  # [kg m^2]


def point_pendulum():
    """1 kg at 1 m, hanging down at zero: IFToMM benchmark A01, the bob given an inertia."""
    links = (Link("base", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6), Link("bob", 1.0, (0.0, 0.0, -1.0), BOB))
    return Model("pendulum", links, (Joint("hinge", "continuous", "base", "bob", axis=(0.0, 1.0, 0.0)),))


@pytest.mark.quick("dop853")
@pytest.mark.parametrize("integrator", ["dop853", "extrapolation"])
def test_pendulum_follows_the_elliptic_functions(integrator):
    """Released from rest at 90 degrees: sin(q/2) = k sn(K - w t), k = sin(45 degrees), for ten seconds."""
    scene = compile_scene(point_pendulum(), integrator=integrator)
    run = simulate(scene, 10.0, initial_state(scene, [math.pi / 2]), rtol=1e-13, record_interval=0.1)
    w, k = math.sqrt(9.81 / 1.01), math.sin(math.pi / 4)
    sn = ellipj(ellipk(k * k) - w * run["time"], k * k)[0]
    # 64 bits hold w t to 4e-15; the pendulum's phase error grows with t, 1e-13 of 30 rad allowed a few times over.
    assert np.abs(run["q"][:, 0] - 2.0 * np.arcsin(k * sn)).max() < 2e-11


def double_pendulum():
    """Two rods whose equations are written out below."""
    links = [Link("base", 0.0, (0.0, 0.0, 0.0), (0.0,) * 6)]
    links += [Link(name, 1.0, (0.0, 0.0, -1.0), BOB) for name in ("upper", "lower")]
    return Model(
        "double pendulum",
        tuple(links),
        (
            Joint("a", "continuous", "base", "upper", axis=(0.0, 1.0, 0.0)),
            Joint("b", "continuous", "upper", "lower", xyz=(0.0, 0.0, -1.0), axis=(0.0, 1.0, 0.0)),
        ),
    )


@pytest.fixture(scope="module")
def double_pendulum_at_one_second():
    """Angles after 1 s from (1, 1) at rest, to 20 digits: Taylor series of Lagrange's equations, 1 kg, 1 m, g 9.81."""
    with mp.workdps(25):
        g, i = mp.mpf("9.81"), mp.mpf("0.01")

        def rates(t, y):
            a, b, u, v = y  # absolute angles and rates
            d = a - b
            m = mp.matrix([[2 + i, mp.cos(d)], [mp.cos(d), 1 + i]])
            f = mp.matrix([-mp.sin(d) * v * v - 2 * g * mp.sin(a), mp.sin(d) * u * u - g * mp.sin(b)])
            acc = mp.lu_solve(m, f)
            return [u, v, acc[0], acc[1]]

        y = mp.odefun(rates, 0, [mp.mpf(1), mp.mpf(2), mp.mpf(0), mp.mpf(0)], tol=mp.mpf("1e-20"))(1)
        return np.array([float(y[0]), float(y[1] - y[0])])


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "extrapolation"])
def test_double_pendulum_to_1e_10(integrator, double_pendulum_at_one_second):
    scene = compile_scene(double_pendulum(), integrator=integrator)
    run = simulate(scene, 1.0, initial_state(scene, [1.0, 1.0]), rtol=1e-13)
    assert np.abs(run["q"][-1] - double_pendulum_at_one_second).max() < 1e-11


@pytest.mark.long
def test_stiff_spring_and_damper_to_1e_10():
    """A rod without gravity on a servo of 13 N m/rad and 0.37 N m s/rad: two real modes, 5 and 995 1/s."""
    model = pendulum(damping=0.0, lower=-math.inf, upper=math.inf)
    inertia = model.links[1].inertia[0] + model.links[1].mass * 0.25**2
    Kp, Kd = 5000.0 * inertia, 1000.0 * inertia
    servo = load_servo("ax12", law="pd", Kp=Kp, Kd=Kd, viscous_friction=0.0, coulomb_friction=0.0)
    scene = compile_scene(replace(model, servos={"hinge": servo}), "standard", None, "extrapolation", gravity=(0, 0, 0))
    assert scene.stiff
    run = simulate(scene, 0.5, initial_state(scene, [0.1]), Reference([0.0], [[0.0]]), rtol=1e-12)
    s = np.roots([inertia, Kd, Kp])
    exact = 0.1 * (s[0] * np.exp(s[1] * run["time"]) - s[1] * np.exp(s[0] * run["time"])) / (s[0] - s[1])
    assert np.abs(run["q"][:, 0] - exact).max() < 1e-11


def hunting_servo(integrator=None):
    """A rod without gravity on a servo that no limit of the current disturbs, sampled so rarely that it hunts."""
    free = {"inductance": 0.0, "current_limit": math.inf, "current_slew": math.inf, "coulomb_friction": 0.0}
    model = replace(pendulum(), servos={"hinge": load_servo("ax12", Kp=300.0, period=0.02, **free)})
    return compile_scene(model, "rotor", None, integrator, gravity=(0, 0, 0))


def angles_at_ticks(model, goal, ticks):
    """The angle at each tick, from the exponential by which speeds approach that of a constant voltage."""
    servo, (_, rod), hinge = model.servos["hinge"], model.links, model.joints[0]
    K, R, period = servo.gearbox.ratio * servo.motor_constant, servo.resistance, servo.controller.period
    rotor = servo.gearbox.ratio**2 * servo.gearbox.rotor_inertia
    inertia = rod.inertia[0] + rod.mass * rod.center_of_mass[2] ** 2 + rotor
    damping = K * K / R + servo.viscous_friction + hinge.damping
    lost, angles, q, v = -math.expm1(-period * damping / inertia), [0.0], 0.0, 0.0
    for _ in range(ticks):
        voltage = max(-servo.voltage_limit, min(servo.controller.Kp * (goal - q), servo.voltage_limit))
        full = K * voltage / R / damping
        q += full * period + (v - full) * lost * inertia / damping
        v = full + (v - full) * (1.0 - lost)
        angles.append(q)
    return np.array(angles)


def test_servos_without_limits_are_smooth_between_ticks():
    assert not hunting_servo().stiff
    assert compile_scene(load_robot("ax12_arm"), "rotor").stiff


@pytest.mark.long
@pytest.mark.parametrize(("integrator", "linear"), [(None, False), ("extrapolation", False), ("extrapolation", True)])
def test_a_servo_that_hunts_for_six_seconds_to_1e_11(integrator, linear):
    """Each tick hands on what the one before has rounded; linear: by implicit Euler steps."""
    scene = hunting_servo(integrator)
    if linear:
        scene = replace(scene, stiff=True)
    run = simulate(scene, 6.0, reference=Reference([0.0], [[0.7]]), rtol=1e-9, record_interval=0.02)
    exact = angles_at_ticks(scene.model, 0.7, 300)
    assert np.ptp(exact[-50:]) > 0.05
    assert np.abs(run["q"][:, 0] - exact).max() < 1e-11


# --- orders ------------------------------------------------------------------------------------------------------


def free_chain(integrator, h):
    scene = compile_scene(unlimited(load_robot("arm7_spatial")), integrator=integrator, timestep=h)
    return scene, initial_state(scene, np.full(7, 0.5)), None


def floating_tree(integrator, h):
    scene = compile_scene(unlimited(load_robot("humanoid")), integrator=integrator, timestep=h)
    rng = np.random.default_rng(2)
    q = np.concatenate([[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], 0.3 * rng.normal(size=scene.tree.n)])
    return scene, initial_state(scene, q, 3.0 * rng.normal(size=scene.tree.n + 6)), None


def servo(integrator, h):
    scene = compile_scene(smooth_arm(), "rotor", None, integrator, h)
    return scene, initial_state(scene, np.full(7, 0.02)), Reference([0.0], np.zeros((1, 7)))


def mipsd(integrator, h):
    scene = compile_scene(smooth_arm(), "mipsd", None, integrator, h)
    return scene, initial_state(scene, np.full(7, 0.02)), Reference([0.0], np.zeros((1, 7)))


def contact(integrator, h):
    """A box that lies on its corners and is pushed down and along: it sticks, and stays in touch."""
    ground = Ground(friction=1.0, penetration=1e-3, damping_ratio=0.5)
    scene = box_on(ground, integrator, h)
    return scene, resting(scene, (0.02, 0.01, -0.02)), None


SCENES = {  # duration [s], and the steps for each integrator: within the explicit limit, above rounding
    free_chain: (
        0.16,
        {"implicit_euler": (2e-3, 1e-3, 5e-4), "midpoint": (2e-3, 1e-3, 5e-4), "rk4": (4e-3, 2e-3, 1e-3)},
    ),
    floating_tree: (
        0.16,
        {"implicit_euler": (2e-3, 1e-3, 5e-4), "midpoint": (2e-3, 1e-3, 5e-4), "rk4": (4e-3, 2e-3, 1e-3)},
    ),
    servo: (0.02, {"implicit_euler": (1e-3, 5e-4, 2.5e-4), "midpoint": (5e-4, 2.5e-4, 1.25e-4)}),
    mipsd: (0.02, {"implicit_euler": (1e-4, 5e-5, 2.5e-5), "midpoint": (2e-4, 1e-4, 5e-5)}),
    contact: (
        0.04,
        {"implicit_euler": (5e-4, 2.5e-4, 1.25e-4), "midpoint": (1e-3, 5e-4, 2.5e-4), "rk4": (1e-3, 5e-4, 2.5e-4)},
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("make", SCENES, ids=lambda make: make.__name__)
def test_each_order_shows_on_halved_steps(make):
    duration, steps = SCENES[make]
    scene, state, reference = make("extrapolation", 1e-3)
    exact = simulate(scene, duration, state, reference, record_interval=duration, rtol=1e-12)
    assert exact.ok, exact.message
    for integrator, sizes in steps.items():
        errors = []
        for h in sizes:
            scene, state, reference = make(integrator, h)
            run = simulate(scene, duration, state, reference, record_interval=duration)
            moved = slice(0, int(scene.layout["base_qd"]))  # all positions
            errors.append(np.abs(run.final[moved] - exact.final[moved]).max())
        slope = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
        assert slope == pytest.approx(ORDERS[integrator], abs=0.25), (integrator, errors)


@pytest.mark.quick("free_chain")
@pytest.mark.parametrize("make", [free_chain, floating_tree], ids=lambda make: make.__name__)
def test_the_explicit_pair_has_order_eight(make):
    """With the loosest tolerance each run is one step, from where the last one ended."""
    scene, start, _ = make("dop853", 1e-3)
    exact = simulate(scene, 0.16, start, rtol=1e-13)["q"][-1]
    sizes, errors = (4e-2, 2e-2, 1e-2), []
    for h in sizes:
        state = start.copy()
        for _ in range(round(0.16 / h)):
            state[scene.layout["step_control"]] = 1.0  # the step to try [s]
            run = simulate(scene, h, state, rtol=1.0)
            state = run.final
        assert run.info["steps"] == round(0.16 / h)
        errors.append(np.abs(run["q"][-1] - exact).max())
    # Not yet asymptotic, the tree converges even faster; below these steps rounding shows.
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] > 7.4


# --- tolerances --------------------------------------------------------------------------------------------------


@pytest.mark.quick("dop853")
@pytest.mark.parametrize("integrator", ["dop853", "extrapolation"])
def test_the_error_falls_with_the_tolerance(integrator):
    scene, state, _ = free_chain(integrator, 1e-3)
    exact = simulate(scene, 0.5, state, record_interval=0.5, rtol=1e-13)["q"][-1]
    tolerances = 10.0 ** np.arange(-4, -11, -1)
    errors = [
        np.abs(simulate(scene, 0.5, state, record_interval=0.5, rtol=e)["q"][-1] - exact).max() for e in tolerances
    ]
    # The error of a step is held, and some fifty of them add up in a motion that magnifies them a few times.
    assert (errors < 100.0 * tolerances).all()
    assert 0.8 < np.polyfit(np.log(tolerances), np.log(errors), 1)[0] < 1.5


@pytest.mark.long
def test_extrapolation_and_midpoint_agree_on_the_whole_servo_chain():
    """Sampled controllers, current, spring-damper gearbox, friction: two methods that share no step size."""
    model = load_robot("arm7")
    state, still = np.full(7, 0.01), Reference([0.0], np.zeros((1, 7)))
    scene = compile_scene(model, "mipsd", None, "midpoint", 2e-5)
    fine = simulate(scene, 0.1, initial_state(scene, state), still, record=("q", "energy"), record_interval=0.1)
    scene = compile_scene(model, "mipsd", None, "extrapolation", 1e-3)
    run = simulate(
        scene, 0.1, initial_state(scene, state), still, record=("q", "energy"), record_interval=0.1, rtol=1e-10
    )
    assert np.abs(run["q"][-1] - fine["q"][-1]).max() < 1e-9
    a, b = (r["energy"][-1, :, energies.METER].sum() for r in (run, fine))
    assert a == pytest.approx(b, rel=1e-6)


@pytest.mark.long
def test_extrapolation_and_midpoint_agree_on_a_box_that_lands_and_slides():
    """Touch-down, stick and slip are discontinuities: the tolerance is met all the same."""
    ground = Ground(friction=0.3, penetration=1e-3, damping_ratio=0.5)
    runs = []
    for integrator, h, rtol in (("midpoint", 2e-5, None), ("extrapolation", 1e-3, 1e-8)):
        scene = box_on(ground, integrator, h)
        state = thrown(scene, 0.01, 0.05, (0.5, 0.2, 0.0))
        runs.append(simulate(scene, 0.2, state, record=("base_q",), record_interval=0.2, rtol=rtol)["base_q"][-1])
    # The friction limit of fixed steps is the last step's, of first order while a corner slips.
    assert np.abs(runs[0] - runs[1]).max() < 2e-5


@pytest.mark.long
def test_records_in_between_are_as_accurate_as_the_end():
    """The explicit pair interpolates within its steps, which records do not change; the extrapolation ends on them."""
    record = ("q", "qd", "qdd", "energy")
    for integrator in ("dop853", "extrapolation"):
        scene, state, _ = free_chain(integrator, 1e-3)
        exact = simulate(scene, 0.2, state, record=record, record_interval=1e-3, rtol=1e-13)
        run = simulate(scene, 0.2, state, record=record, record_interval=1e-3, rtol=1e-9)
        for name, error in (("q", 1e-9), ("qd", 1e-7), ("qdd", 1e-5)):
            assert np.abs(run[name] - exact[name]).max() < error, (integrator, name)
    scene, state, _ = free_chain("dop853", 1e-3)
    sparse, dense = (simulate(scene, 0.2, state, record_interval=sample, rtol=1e-9) for sample in (0.2, 1e-3))
    assert sparse.info["steps"] == dense.info["steps"]
    assert sparse["q"][-1].tobytes() == dense["q"][-1].tobytes()


@pytest.mark.long
def test_outputs_belong_to_the_instant():
    """Accelerations of a record are those of its positions and velocities: the pendulum's are known."""
    for integrator in ("dop853", "extrapolation"):
        scene = compile_scene(point_pendulum(), integrator=integrator)
        run = simulate(scene, 0.5, initial_state(scene, [1.0]), record=("q", "qdd"), rtol=1e-10)
        assert np.abs(run["qdd"][1:, 0] + 9.81 / 1.01 * np.sin(run["q"][1:, 0])).max() < 1e-9
    model = with_controller(pd_arm(), Kd=0.374)
    scene = compile_scene(model, "standard", None, "extrapolation")
    run = simulate(scene, 0.2, initial_state(scene, np.full(7, 0.05)), record=("q", "qd", "torque"), rtol=1e-8)
    torque = 12.97 * (0.05 - run["q"]) - 0.374 * run["qd"]
    assert np.abs(run["torque"][5:] - torque[5:]).max() < 1e-5


@pytest.mark.long
def test_a_tolerance_picks_an_integrator_that_can_meet_it():
    free = compile_scene(unlimited(load_robot("arm7_spatial")))
    assert simulate(free, 0.01, rtol=1e-6).info["integrator"] == "dop853"
    stiff = compile_scene(pd_arm(), "standard")
    run = simulate(stiff, 0.01, rtol=1e-6)
    assert run.info["integrator"] == "extrapolation"
    assert run.info["rtol"] == run.info["atol"] == 1e-6
    assert run.info["steps"] > 0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"rtol": 0.0}, "rtol is 0.0; expected a number from 1e-14 to 1"),
        ({"rtol": math.nan}, "rtol is nan"),
        ({"rtol": 1e-6, "atol": -1.0}, "atol is -1.0"),
        ({"atol": 1e-6}, "rtol is not given"),
    ],
)
def test_tolerances_out_of_range_are_refused(given, message):
    scene = compile_scene(load_robot("arm7_spatial"))
    with pytest.raises(ValueError, match=message):
        simulate(scene, 0.01, **given)


def test_the_2012_order_has_no_tolerance():
    scene = compile_scene(load_robot("arm7"), "standard", None, "simtwo", 1e-3)
    with pytest.raises(ValueError, match="simtwo is an order of updates"):
        simulate(scene, 0.01, rtol=1e-6)


@pytest.mark.long
def test_a_tolerance_below_rounding_ends_the_run_and_says_so():
    """A box hits ground as hard as 1e13 N/m: no step that is allowed resolves it to 14 digits."""
    scene = box_on(Ground(penetration=1e-12), "extrapolation", 1e-3)
    run = simulate(scene, 0.1, thrown(scene, 1e-4, 0.3, (0.0, 0.0, -3.0)), record=("base_q",), rtol=1e-14)
    assert run.status == "step too small"
    assert "below 1e-09 s at" in run.message
    assert run.end_time < 0.1
    assert np.isfinite(run.final).all()


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "extrapolation"])
def test_error_control_meets_both_edges_of_a_kick(integrator):
    """A rod at rest is kicked for 10 ms: it leaves with the kick's angular momentum over its inertia."""
    model = pendulum(damping=0.0, lower=-math.inf, upper=math.inf)
    inertia = model.links[1].inertia[0] + model.links[1].mass * 0.25**2
    for start in (0.0312, 0.11, 0.2345):
        kick = Push("rod", moment=(0.0, 2.0, 0.0), start=start, end=start + 0.01)
        scene = compile_scene(model, integrator=integrator, gravity=(0.0, 0.0, 0.0))
        run = simulate(scene, 0.4, pushes=[kick], rtol=1e-7)
        assert run.ok, run.message
        assert run["qd"][-1, 0] == pytest.approx(0.02 / inertia, rel=1e-10)
        assert run["q"][-1, 0] == pytest.approx(0.02 / inertia * (0.4 - start - 0.005), rel=1e-10)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["dop853", "extrapolation"])
def test_error_control_meets_the_knots_of_a_torque(integrator):
    """A torque jumps up and down again between records: held values make the rod's motion a polynomial by parts."""
    model = pendulum(damping=0.0, lower=-math.inf, upper=math.inf)
    inertia = model.links[1].inertia[0] + model.links[1].mass * 0.25**2
    scene = compile_scene(model, integrator=integrator, gravity=(0.0, 0.0, 0.0))
    torque = Reference([0.0, 0.0123, 0.0321], [[0.0], [2.0], [0.0]], "hold")
    run = simulate(scene, 0.2, tau=torque, rtol=1e-7)
    assert run["qd"][-1, 0] == pytest.approx(2.0 * 0.0198 / inertia, rel=1e-10)
    assert run["q"][-1, 0] == pytest.approx(2.0 * 0.0198 / inertia * (0.2 - 0.0222), rel=1e-10)


@pytest.mark.long
def test_error_control_meets_the_knots_of_a_reference_followed_at_every_instant():
    """A stiff continuous servo is told to jump between records: a run of fixed steps much finer agrees."""
    step = Reference([0.0, 0.0105], np.stack([np.zeros(7), np.full(7, 0.02)]), "hold")
    runs = []
    for integrator, h, rtol in (("extrapolation", None, 1e-9), ("midpoint", 2e-5, None)):
        scene = compile_scene(pd_arm(), "standard", None, integrator, h)
        runs.append(simulate(scene, 0.05, initial_state(scene), step, rtol=rtol)["q"][-1])
    assert np.abs(runs[0]).max() > 1e-3
    assert np.abs(runs[0] - runs[1]).max() < 1e-7


# --- error estimates ---------------------------------------------------------------------------------------------


@pytest.mark.quick("dop853")
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "rk4", "dop853", "extrapolation"])
def test_the_estimate_covers_the_error_and_not_much_more(integrator):
    scene, state, _ = free_chain(integrator, 1e-3)
    exact = simulate(free_chain("dop853", 1e-3)[0], 0.2, state, rtol=1e-13)
    tolerance = {"rtol": 1e-6} if scene.adaptive else {}
    run = simulate(scene, 0.2, state, estimate_error=True, **tolerance)
    for name in ("q", "qd"):
        true, estimate = np.abs(run[name] - exact[name]).max(), run.error[name].max()
        assert run.error[name].shape == run[name].shape
        assert 0.9 * true < estimate < (3.0 if not scene.adaptive else 100.0) * true, (name, true, estimate)


def test_the_estimate_is_infinite_where_the_finer_run_ends_otherwise():
    scene = compile_scene(load_robot("arm7"), "standard", None, "simtwo", 1e-3)
    still = Reference([0.0], np.zeros((1, 7)))
    run = simulate(scene, 1.0, initial_state(scene, np.full(7, 0.01)), still, estimate_error=True)
    finer = scene.recompiled(timestep=5e-4)
    other = simulate(finer, 1.0, initial_state(finer, np.full(7, 0.01)), still)
    assert np.isinf(run.error["q"]).all() == (run.status != other.status)


def test_the_estimate_is_saved(tmp_path):
    scene, state, _ = free_chain("dop853", 1e-3)
    run = simulate(scene, 0.1, state, estimate_error=True)
    run.save(tmp_path / "run")
    again = Trajectory.load(tmp_path / "run")
    assert set(again.error) == {"q", "qd"}
    assert np.array_equal(again.error["q"], run.error["q"])
    assert set(again) == set(run)


# --- bits --------------------------------------------------------------------------------------------------------


@pytest.mark.quick("dop853")
@pytest.mark.nojit
@pytest.mark.parametrize("integrator", ["dop853", "extrapolation"])
def test_a_continued_run_and_a_batch_have_the_same_bits(integrator):
    scene = compile_scene(pendulum(damping=0.0), integrator=integrator)
    states = [initial_state(scene, [q]) for q in (0.1, 0.2, 0.3, 0.4)]
    batch = simulate_batch(scene, 0.04, states, rtol=1e-5)
    for state, run in zip(states, batch):
        alone = simulate(scene, 0.04, state, rtol=1e-5)
        assert alone.final.tobytes() == run.final.tobytes()
        half = simulate(scene, 0.02, state, rtol=1e-5)
        assert np.abs(simulate(scene, 0.02, half.final, rtol=1e-5)["q"][-1] - alone["q"][-1]) < 1e-7


@pytest.mark.long
def test_error_control_is_not_taken_for_a_fall():
    """A free scene is watched at every step, and ends where it is told to."""
    scene = compile_scene(box(), ground=Ground(), integrator="extrapolation", **NEVER_FALLEN)
    run = simulate(scene, 0.3, thrown(scene, 0.02), record=("base_q",), rtol=1e-5)
    assert run.ok
    assert run.end_time == pytest.approx(0.3)
