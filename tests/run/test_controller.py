"""Controllers of one's own, compiled into runs: what they do is what the servo's own law would do, in any lane."""

import pickle
import random
import time

import numba
import numpy as np
import pytest
from scenes import with_controller

from featherstone_gait import dynamics
from featherstone_gait.dynamics import inverse_dynamics
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.program import controller
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.session import Session
from featherstone_gait.run.simulate import initial_state, simulate, simulate_batch
from featherstone_gait.scene.compile import compile_scene

KP, KD = 40.0, 0.3


@controller(writes="voltage")
def servo_law(t, state, reference, command, memory):
    """The servo's own law of state feedback."""
    for i in range(len(state.q)):
        e, de = reference[i, 0] - state.q[i], reference[i, 1] - state.filtered_speed[i]
        u = KP * e + KD * de
        command[i, 0] = min(max(u, -9.9), 9.9)


@controller
def nothing(t, state, reference, command, memory):
    pass


@controller(memory=2, period=0.03)
def stairs(t, state, reference, command, memory):
    """A step of 0.1 rad at each call, counted in its memory; after three down again."""
    memory[0] += 1.0
    memory[1] = t
    command[0, 0] = 0.1 * (int(memory[0]) % 4)
    command[0, 1] = 0.0


@controller(memory=1)
def beyond(t, state, reference, command, memory):
    if t > 0.025:
        memory[3] = 1.0


@controller(memory=1)
def touchy(t, state, reference, command, memory):
    """A sum of what it is given, which must not be large."""
    memory[0] += reference[0, 0]
    command[0, 0] = 0.5 * memory[0]
    if reference[0, 0] > 0.5:
        memory[3] = 1.0


@controller(memory=1)
def divides(t, state, reference, command, memory):
    """A remainder by zero from the fourth tick on."""
    command[0, 0] = 7 % (3 - int(memory[0]))
    memory[0] += 1.0


@controller(memory=1)
def halves(t, state, reference, command, memory):
    command[0, 0] = 1.0 / (3.0 - memory[0])
    memory[0] += 1.0


@controller(writes="voltage")
def not_a_number(t, state, reference, command, memory):
    if t > 0.025:
        command[0, 0] = np.nan


@numba.njit
def drawn(x):
    return x + np.random.normal()  # noqa: NPY002


@controller
def opaque(t, state, reference, command, memory):
    command[0, 0] = open("file").read()


def scene_of(integrator="midpoint", gearbox="mipsd", **law):
    settings = {"law": "state", "Kp": KP, "Kd": KD, "Ki": 0.0, "Kf": 0.0, "lag": 0.013} | law
    model = with_controller(load_robot("ax12_arm"), **settings)
    return compile_scene(model, gearbox, integrator=integrator, timestep=None if integrator is None else 1e-3)


def moving(seed=0):
    return Reference([0.0, 0.03, 0.1], np.random.default_rng(seed).normal(scale=0.3, size=(3, 1)))


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["midpoint", None])
def test_the_servos_own_law_written_again_moves_alike(integrator):
    """As voltages; encoders that are exact, a supply that the law does not reach: the same to rounding."""
    scene = scene_of(integrator)
    own = simulate(scene, 0.1, reference=moving(), record=("q", "voltage"), estimate_error=False)
    again = simulate(
        scene, 0.1, reference=moving(), record=("q", "voltage"), estimate_error=False, controller=servo_law
    )
    step = max(servo.encoder_resolution for servo in scene.model.servos.values())
    assert np.abs(own["voltage"]).max() > 0.5
    assert np.abs(own["q"] - again["q"]).max() < 0.5 * step + 1e-9


@pytest.mark.long
def test_a_controller_that_does_nothing_changes_no_bit():
    scene = scene_of()
    runs = simulate_batch(scene, 0.1, references=[moving(k) for k in range(11)], estimate_error=False)
    with_it = simulate_batch(
        scene, 0.1, references=[moving(k) for k in range(11)], estimate_error=False, controller=nothing
    )
    assert [run.final.tobytes() for run in runs] == [run.final.tobytes() for run in with_it]


@pytest.mark.long
def test_lanes_have_their_own_memory_and_period():
    """One call in three ticks: the reference climbs a stair at each, also where lanes go on in the next segment."""
    scene = scene_of()
    stair = 0.1 * (np.arange(1, 21) % 4)
    climbing = Reference(0.03 * np.arange(20), stair[:, None], "hold")
    plain = with_controller(scene.model, lag=0.0)
    expected = simulate(scene.recompiled(plain), 0.6, reference=climbing, estimate_error=False)
    start = initial_state(scene)
    runs = simulate_batch(scene, 0.6, [start] * 11, estimate_error=False, controller=stairs)
    alone = simulate(scene, 0.6, start, estimate_error=False, controller=stairs)
    assert np.array_equal(alone["q"], expected["q"])
    assert alone["q"].max() > 0.1
    assert len({run.final.tobytes() for run in (*runs, alone)}) == 1


@pytest.mark.long
@pytest.mark.bounds
@pytest.mark.nojit
def test_sessions_keep_its_memory():
    scene, actions = scene_of(), np.random.default_rng(1).normal(scale=0.2, size=(8, 9, 1))
    for program in (stairs, servo_law):
        session = Session(scene, 9, controller=program)
        for k, action in enumerate(actions):
            if k == 4:
                session = pickle.loads(pickle.dumps(session)) if k % 2 else session.copy()
            session.step(action)
        times = np.arange(len(actions)) * session.tick
        references = [Reference(times, actions[:, robot], "hold") for robot in range(9)]
        runs = simulate_batch(scene, 0.08, references=references, estimate_error=False, controller=program)
        assert [run.final.tobytes() for run in runs] == [y.tobytes() for y in session.state]
    session = Session(scene, 9, controller=stairs)
    session.step(ticks=4)
    late = np.arange(9) == 4
    session.reset(late)
    session.step(ticks=4)
    alone = Session(scene, 9, controller=stairs)
    alone.step(ticks=4)
    assert np.array_equal(session.state[late], alone.state[late])
    assert not np.array_equal(session.state[~late], alone.state[~late])


@pytest.mark.long
@pytest.mark.parametrize("n", [1, 9])
@pytest.mark.parametrize("at", [0, 3])
def test_a_step_in_which_it_raises_does_nothing(n, at):
    """A controller that fails changes no robot, record, second run or noise: stepped again, all have the same bits."""
    settings = {"controller": touchy, "record": ("q",), "estimate_error": True, "noise": (1e-3, 0.05)}
    session, other = (Session(scene_of(), n, **settings) for _ in range(2))
    actions = np.random.default_rng(2).uniform(-0.2, 0.2, size=(6, n, 1))
    for k, action in enumerate(actions):
        if k == at:
            before, wrong = session.state, action.copy()
            wrong[-1] = 0.7
            with pytest.raises(ValueError, match="touchy failed"):
                session.step(wrong, ticks=5)
            assert np.array_equal(session.state, before)
            assert session.trajectory(0)["time"][-1] == session.time[0]
        for one in (session, other):
            one.step(action, ticks=2)
    assert session.state.tobytes() == other.state.tobytes()
    assert session.error("q").tobytes() == other.error("q").tobytes()
    for name in ("time", "q"):
        assert np.array_equal(session.trajectory(n - 1)[name], other.trajectory(n - 1)[name])


@pytest.mark.long
def test_the_error_is_told_with_it():
    run = simulate(scene_of(lag=0.0), 0.1, reference=moving(), controller=stairs)
    assert run.error is not None
    assert 0.0 < run.error["q"].max() < 1e-2


@pytest.mark.long
def test_what_is_wrong_is_said():
    scene = scene_of()
    with pytest.raises(ValueError, match=r"beyond failed at 0.03 s: IndexError.*memory \(1,\)"):
        simulate(scene, 0.1, reference=moving(), controller=beyond)
    with pytest.raises(ValueError, match=r"beyond failed at 0\.03 s"):
        simulate_batch(scene, 0.1, references=[moving()] * 9, controller=beyond, estimate_error=False)
    session = Session(scene, 9, controller=beyond)
    session.step(ticks=3)
    with pytest.raises(ValueError, match="beyond failed"):
        session.step()
    assert session.time.tolist() == [0.03] * 9
    with pytest.raises(ValueError, match=r"takes t, state; it is called with t, state, reference, command, memory"):
        controller(lambda t, state: None)
    with pytest.raises(ValueError, match="memory is -1"):
        controller(memory=-1)(lambda t, state, reference, command, memory: None)
    with pytest.raises(ValueError, match="writes is 'force'"):
        controller(writes="force")(lambda t, state, reference, command, memory: None)
    odd = controller(period=0.013)(lambda t, state, reference, command, memory: None)
    with pytest.raises(ValueError, match=r"ticks of 0\.01 s: give a whole number"):
        simulate(scene, 0.1, controller=odd)
    with pytest.raises(TypeError, match="decorate its function"):
        simulate(scene, 0.1, controller=lambda *x: None)
    with pytest.raises(ValueError, match="no sampled servos"):
        simulate(compile_scene(scene.model, integrator="midpoint", timestep=1e-3), 0.1, controller=nothing)
    with pytest.raises(ValueError, match="a controller reads references"):
        Session(scene, 1, "voltage", controller=nothing)
    with pytest.raises(TypeError, match="must be a name of its module"):
        pickle.dumps(controller(lambda t, state, reference, command, memory: None))


@pytest.mark.long
def test_a_number_that_is_none_is_blamed_on_it():
    """With the joint, the place and the time, in a run, in a batch and in a session, which stays as it was."""
    told = r"not_a_number wrote nan as voltage of joint elbow, command\[0, 0\], at 0\.03 s"
    with pytest.raises(ValueError, match=told):
        simulate(scene_of(), 0.1, controller=not_a_number)
    with pytest.raises(ValueError, match=told):
        simulate_batch(scene_of(), 0.1, references=[moving()] * 9, controller=not_a_number, estimate_error=False)
    session = Session(scene_of(), 9, controller=not_a_number)
    session.step(ticks=2)
    session.reset(np.arange(9) != 5)
    session.step()
    before = session.state
    with pytest.raises(ValueError, match=f"{told} of robot 5:"):
        session.step()
    assert np.array_equal(session.state, before)


@pytest.mark.long
@pytest.mark.parametrize("program", [divides, halves])
def test_a_division_by_zero_is_an_error(program):
    with pytest.raises(ValueError, match=f"{program.name} failed at 0.03 s: ZeroDivisionError|FloatingPointError"):
        simulate(scene_of(), 0.1, reference=moving(), controller=program)


def test_what_differs_from_call_to_call_is_refused():
    """Random numbers and clocks, by any name, also in functions that it calls."""

    def plain(t, state, reference, command, memory):
        command[0, 0] = np.random.normal()  # noqa: NPY002

    def renamed(t, state, reference, command, memory):
        draws = np.random
        for i in range(len(state.q)):
            command[i, 0] = draws.uniform(0.0, 1.0)

    def standard(t, state, reference, command, memory):
        command[0, 0] = random.random()

    def called(t, state, reference, command, memory):
        command[0, 0] = drawn(t)

    def clock(t, state, reference, command, memory):
        command[0, 0] = time.perf_counter()

    def python(t, state, reference, command, memory):
        with numba.objmode(x="float64"):
            x = float(t)
        command[0, 0] = x

    for function in (plain, renamed, standard, called, clock, python):
        with pytest.raises(ValueError, match=f"{function.__qualname__} uses .* which differs from run to run"):
            controller(function)


def test_one_that_calls_the_dynamics_in_python_is_refused_by_their_name():
    arm = load_robot("ax12_arm")

    def computed(t, state, reference, command, memory):
        command[:, 0] = inverse_dynamics(arm, state.q, state.qd, 0.0 * state.q)

    def module(t, state, reference, command, memory):
        command[:, 0] = dynamics.mass_matrix(arm, state.q)[0]

    for function, called in ((computed, "inverse_dynamics"), (module, "mass_matrix")):
        with pytest.raises(ValueError, match=f"{function.__qualname__} calls {called}, which runs in Python"):
            controller(function)


def test_one_that_does_not_compile_is_named():
    with pytest.raises(ValueError, match=r"controller opaque \(File .*test_controller.py.*does not compile"):
        simulate(scene_of(), 0.1, controller=opaque)
