"""ARS(3,4,3): its order, its damping, what it conserves, and the motor's exact current in its stages."""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from featherstone_gait import (
    ContactPoint,
    Ground,
    Link,
    Model,
    Push,
    Reference,
    compile_scene,
    initial_state,
    load_robot,
    momentum,
    simulate,
)
from featherstone_gait.benchmark.scenes import humanoids, stiff_arm
from featherstone_gait.core.effects.motor import MOTOR
from featherstone_gait.core.effects.motor_stage import course
from featherstone_gait.core.integrate.ars343 import ERROR, EXPLICIT, IMPLICIT, NODES, G

HOW = {"integrator": "ars343"}


@numba.njit
def courses(motors, V, w0, I0, w, T, left, mean):
    return course(motors[0], V, w0, I0, w, T, left, mean)


@pytest.mark.nojit
def test_coefficients_meet_the_conditions_of_order_3():
    A = np.zeros((4, 4))
    A[:, :3] = IMPLICIT
    A[1:, 1:] += G * np.eye(3)
    E = np.hstack([EXPLICIT, np.zeros((4, 1))])
    b = A[3]
    assert np.abs(A.sum(axis=1) - NODES).max() < 1e-15
    assert np.abs(E.sum(axis=1) - NODES).max() < 1e-15
    for power in (0, 1, 2):
        assert abs(b @ NODES**power - 1.0 / (power + 1)) < 1e-15
    for tableau in (A, E):
        assert abs(b @ (tableau @ NODES) - 1.0 / 6.0) < 1e-15
    assert np.abs([ERROR.sum(), ERROR @ NODES, ERROR @ NODES**2 - 1.0 / 6.0]).max() < 1e-14


@pytest.mark.nojit
def test_what_is_infinitely_stiff_is_gone_after_a_step():
    A = np.zeros((3, 3))
    A[:, 1:] = 0.0
    A += G * np.eye(3)
    A[1, 0], A[2, :2] = IMPLICIT[2, 1], IMPLICIT[3, 1:]
    for z in (-1e8, 1e8j):
        grown = 1.0 + z * A[2] @ np.linalg.solve(np.eye(3) - z * A, np.ones(3))
        assert abs(grown) < 1e-7


@pytest.mark.nojit
@pytest.mark.parametrize(("voltage", "start"), [(10.0, 0.0), (0.5, 0.2), (-3.0, -0.1), (10.0, 0.85), (0.02, 0.0)])
def test_the_current_is_that_of_the_differential_equation(voltage, start):
    motors = np.zeros(1, MOTOR).view(np.recarray)
    m = motors[0]
    m.torque_constant, m.resistance, m.inductance, m.current_limit, m.current_slew = 1.73, 8.0, 5e-3, 5.0, 150.0
    w0, w, T = 1.0, 2.5, 4e-3

    def rate(t, I):
        back = m.torque_constant * (w0 + (w - w0) * t / T)
        return np.clip((voltage - back - m.resistance * I) / m.inductance, -150.0, 150.0)

    exact = solve_ivp(lambda t, x: [*rate(t, x[:1]), x[0]], (0.0, T), [start, 0.0], "LSODA", rtol=1e-12, atol=1e-14)
    z = T * m.resistance / m.inductance
    left = math.exp(-z)
    end, mean, slope_end, slope = courses(motors, voltage, w0, start, w, T, left, (1.0 - left) / z)
    assert abs(end - exact.y[0, -1]) < 1e-7
    assert abs(mean - exact.y[1, -1] / T) < 1e-7
    more = courses(motors, voltage, w0, start, w + 1e-6, T, left, (1.0 - left) / z)
    assert abs(slope_end + (more[0] - end) / 1e-6) < 1e-5
    assert abs(slope + (more[1] - mean) / 1e-6) < 1e-5


@pytest.mark.long
@pytest.mark.parametrize("servos", ["mipsd", "rotor"])
def test_the_error_falls_with_the_tolerance(servos):
    """By 10 a decade where all is smooth: a step of the reference too small to meet a limit."""
    robot, step = load_robot("ax12_arm"), Reference([0.0], [[0.004]])
    exact = simulate(compile_scene(robot, servos, integrator="extrapolation"), 0.05, reference=step, rtol=1e-11)
    scene = compile_scene(robot, servos, **HOW)
    errors = []
    for rtol in (1e-3, 1e-5, 1e-7):
        run = simulate(scene, 0.05, reference=step, rtol=rtol, estimate_error=False)
        errors.append(np.abs(run["qd"] - exact["qd"]).max())
    assert errors[1] < 0.2 * errors[0]
    assert errors[2] < 0.1 * errors[1]
    assert errors[2] < 3e-6


@pytest.mark.long
def test_energies_of_the_servo_balance():
    """What the supply gave is heat, loss, magnetic and mechanical energy, as near as the run itself."""
    robot, step = load_robot("ax12_arm"), Reference([0.0], [[0.5]])
    exact = simulate(compile_scene(robot, "mipsd", integrator="extrapolation"), 0.1, reference=step, rtol=1e-10,
                     record=("energy",))  # fmt: skip
    run = simulate(compile_scene(robot, "mipsd", **HOW), 0.1, reference=step, rtol=1e-4, record=("energy",))
    assert np.abs(run["energy"] - exact["energy"]).max() < 1e-3 * exact["energy"].max()


@pytest.mark.long
def test_a_tumbling_humanoid_keeps_its_momentum():
    """At 10 rad/s for 2 s without gravity, its servos holding."""
    never = {"fall_height": -1.0, "fall_tilt": math.pi, "gravity": (0.0, 0.0, -1e-12)}
    scene = compile_scene(load_robot("humanoid"), "mipsd", Ground(), **HOW, **never)
    q = np.zeros(scene.model.nq)
    q[2], q[3] = 100.0, 1.0
    qd = np.zeros(scene.model.nv)
    qd[3:6] = 6.0, 6.0, 5.3
    start = initial_state(scene, q, qd, allow_limit_violation=True)
    run = simulate(scene, 2.0, start, record=("base_q", "q", "base_qd", "qd"), estimate_error=False)
    q, qd = (np.hstack([run["base_" + name], run[name]])[[0, -1]] for name in ("q", "qd"))
    before, after = momentum(scene.model, q, qd)[:, :3]
    assert np.abs(after - before).max() < 1e-5 * np.abs(before).max()


@pytest.mark.long
def test_a_stride_by_default_and_to_ten_micrometres():
    """With servos and soles, 0.64 s: the error, the error told, and the implicit solutions that both cost."""
    walks = humanoids()[1]

    def stride(integrator, **how):
        scene = walks.by(integrator)
        return simulate(scene, walks.duration, walks.state, walks.reference, record=("q", "base_q"),
                        record_interval=walks.record_interval, **how)  # fmt: skip

    exact = stride("extrapolation", rtol=1e-8, estimate_error=False)
    for rtol, error, dearest in ((None, 1e-3, 1200), (1e-3, 1e-5, 2100)):
        run = stride("ars343", rtol=rtol)
        wrong = {name: np.abs(run[name] - exact[name]) for name in ("q", "base_q")}
        assert run.ok
        assert run.info["evaluations"] < dearest
        assert wrong["base_q"][:, :3].max() < error
        assert all(wrong[name].max() < 10.0 * run.error[name].max() for name in wrong)


@pytest.mark.long
def test_a_box_on_the_ground_comes_to_rest_and_bears_its_weight():
    corners = tuple(ContactPoint("box", (x, y, -0.05)) for x in (-0.2, 0.2) for y in (-0.2, 0.2))
    box = Model("box", (Link("box", 1.0, (0.0,) * 3, (0.0142, 0.0, 0.0, 0.0142, 0.0, 0.0267)),), (), "floating",
                contacts=corners)  # fmt: skip
    scene = compile_scene(box, ground=Ground(friction=0.6), **HOW)
    start = initial_state(scene, [0.0, 0.0, 0.06, 1.0, 0.0, 0.0, 0.0])
    run = simulate(scene, 2.0, start, record=("contact_force", "base_qd"), rtol=1e-4)
    assert run.ok
    assert abs(run["contact_force"][-1, :, 0].sum() - 9.81) < 1e-5
    assert np.abs(run["base_qd"][-1]).max() < 1e-6


@pytest.mark.long
def test_stiff_servos_settle_at_large_steps():
    """Continuous servos without rotor inertia: far fewer steps than an explicit method's limit allows."""
    problem = stiff_arm("standard")
    scene = problem.scene.recompiled(**HOW)
    run = simulate(scene, problem.duration, problem.state, problem.reference, rtol=1e-2)
    assert run.ok
    assert run.info["steps"] < 0.1 * problem.duration / scene.preflight.largest_explicit_step
    best = problem.by("extrapolation")
    exact = simulate(best, problem.duration, problem.state, problem.reference, rtol=1e-9)
    assert np.abs(run["q"] - exact["q"]).max() < 2e-4


@pytest.mark.long
def test_a_limit_that_jumps_is_no_obstacle():
    """Without inductance the current jumps at each tick."""
    robot = load_robot("ax12_arm")
    servos = {name: replace(servo, inductance=0.0) for name, servo in robot.servos.items()}
    scene = compile_scene(replace(robot, servos=servos), "mipsd", **HOW)
    exact = simulate(compile_scene(replace(robot, servos=servos), "mipsd", integrator="extrapolation"), 0.1,
                     reference=Reference([0.0], [[0.5]]), rtol=1e-9)  # fmt: skip
    run = simulate(scene, 0.1, reference=Reference([0.0], [[0.5]]))
    assert run.ok
    assert np.abs(run["q"] - exact["q"]).max() < 3e-4


@pytest.mark.long
@pytest.mark.parametrize("start", [0.7, 0.7 + 2e-12, 0.7 - 2e-12])
def test_a_push_that_begins_where_a_tick_does_is_no_obstacle(start):
    """Tick 70 is at 0.7000000000000001 s: between push and tick lies a time of which nothing can be seen."""
    scene = compile_scene(load_robot("ax12_arm"), "rotor")
    push = Push("forearm", moment=(0.1, 0.1, 0.1), start=start, end=0.75)
    reference = Reference([0.0, 0.5], [[0.0], [0.5]])
    run = simulate(scene, 1.0, reference=reference, pushes=[push], estimate_error=False)
    exact = simulate(scene, 1.0, reference=reference, pushes=[push], rtol=1e-6, estimate_error=False)
    assert run.ok
    assert exact.ok
    assert np.abs(run["q"] - exact["q"]).max() < 1e-3
    spared = simulate(scene, 1.0, reference=reference, estimate_error=False)
    assert np.abs(exact["q"] - spared["q"]).max() > 1e-3


@pytest.mark.long
@pytest.mark.parametrize(("inertia", "kp", "kv"), [(1e-8, 60.0, 1.0), (1e-9, 60.0, 1.0), (1e-9, 0.04, 1e-6)])
def test_a_light_link_follows_a_stiff_drive_from_a_step(tmp_path, inertia, kp, kv):
    """The angle is that of the linear oscillator, whose fast mode lasts down to a nanosecond."""
    file = tmp_path / "finger.xml"
    file.write_text(
        f'<mujoco><worldbody><body><joint name="j"/><inertial pos="0 0 0" mass="1e-4" diaginertia="{inertia} {inertia} '
        f'{inertia}"/></body></worldbody><actuator><position joint="j" kp="{kp}" kv="{kv}"/></actuator></mujoco>'
    )
    run = simulate(compile_scene(load_robot(file), "rotor"), 0.1, reference=Reference([0.0], [[0.7]]))
    slow, fast = np.roots([inertia, kv, kp])[::-1]
    exact = 0.7 * (1.0 - (fast * np.exp(slow * run["time"]) - slow * np.exp(fast * run["time"])) / (fast - slow))
    assert run.ok
    np.testing.assert_allclose(run["q"][:, 0], exact.real, atol=1e-5)
