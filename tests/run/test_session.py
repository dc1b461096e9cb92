"""Sessions: the same bits as a run in one call, whatever they are stepped by; each robot for itself; misuse refused."""

import multiprocessing
import pickle
import resource
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scenes import G, pendulum, with_controller

from featherstone_gait.core.step import state
from featherstone_gait.model import Ground
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run import sensors
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.session import Session
from featherstone_gait.run.simulate import Push, initial_state, reset_time, simulate, simulate_batch
from featherstone_gait.run.worlds import Distribution, Worlds
from featherstone_gait.scene.channels import channel_table
from featherstone_gait.scene.compile import compile_scene

LAW = {"law": "pid_position", "Kp": 40.0, "Ki": 20.0, "Kd": 0.3, "lag": 0.013, "delay": 0.003}
RECORD = ("q", "qd", "voltage", "current", "energy")


def servo_arm(integrator="midpoint", model=None, **law):
    arm = with_controller(load_robot("ax12_arm") if model is None else model, **(LAW | law))
    return compile_scene(arm, "mipsd", integrator=integrator, timestep=None if integrator is None else 1e-3)


def moves(n, ticks=12, seed=0):
    """Actions (ticks, n, 1), steps of some tenths of a radian."""
    return np.random.default_rng(seed).normal(scale=0.3, size=(ticks, n, 1)).cumsum(axis=0) * 0.3


def held(session, actions):
    """The references that hold each action until the next."""
    times = np.arange(len(actions)) * session.tick
    return [Reference(times, actions[:, robot], "hold") for robot in range(session.n)]


def whole(session, actions, **how):
    """The same runs in one call."""
    how = {"record": RECORD, "estimate_error": False} | how
    duration = len(actions) * session.tick
    return simulate_batch(session.scene, duration, references=held(session, actions), **how)


def assert_same(session, runs, recorded=True):
    assert [run.final.tobytes() for run in runs] == [y.tobytes() for y in session.state]
    assert session.time.tolist() == [run.final[session.scene.layout["end_time"]] for run in runs]
    assert session.status == [run.status for run in runs]
    for robot, run in enumerate(runs if recorded else ()):
        found = session.trajectory(robot)
        assert {*found} == {*run}
        for name in run:
            assert np.array_equal(found[name], run[name]), name


@pytest.mark.long
@pytest.mark.parametrize("n", [1, 9, 11])
@pytest.mark.parametrize("integrator", ["midpoint", None])
def test_a_session_has_the_bits_of_one_run(integrator, n):
    """Alone, in lanes and with robots left over; lag, delay and the derivative's last error go on from tick to tick."""
    n = min(n, 3) if integrator is None else n
    session = Session(servo_arm(integrator), n, record=RECORD, record_interval=0.002)
    actions = moves(n)
    for action in actions:
        session.step(action)
    assert np.abs(session.state[:, slice(*session.scene.part("q"))]).max() > 0.05
    assert_same(session, whole(session, actions, record_interval=0.002))


@pytest.mark.long
def test_steps_of_several_ticks_hold_their_action():
    session = Session(servo_arm(), 3, record=RECORD)
    actions = moves(3, 4)
    for action in actions:
        session.step(action, ticks=3)
    assert_same(session, whole(session, actions.repeat(3, axis=0)))
    session.step(actions[0], ticks=1.0)
    assert session.time.tolist() == [13 * session.tick] * 3


@pytest.mark.long
@pytest.mark.nojit
def test_an_action_of_none_holds_the_robots_where_they_are():
    scene = servo_arm()
    session, start = Session(scene, 1, record=RECORD), initial_state(scene, [0.4])
    session.reset(state=start)
    session.step(ticks=5)
    assert_same(session, [simulate(scene, 0.05, start, record=RECORD, estimate_error=False)])


@pytest.mark.bounds
@pytest.mark.long
@pytest.mark.nojit
def test_worlds_differ_in_each_robot():
    scene, worlds = servo_arm(), Worlds(runs=11, servos={"resistance": Distribution("normal", 0.1)}, seed=3)
    session, actions = Session(scene, worlds=worlds, record=RECORD), moves(11, 6)
    for action in actions:
        session.step(action)
    runs = simulate_batch(
        scene, 0.06, references=held(session, actions), worlds=worlds, record=RECORD, estimate_error=False
    )
    assert_same(session, runs)
    assert len({run.final.tobytes() for run in runs}) == 11


@pytest.mark.long
@pytest.mark.parametrize("pushed", [False, True])
def test_robots_reset_at_different_times_have_their_own(pushed):
    """Where pushes depend on the time lanes go on one after the other."""
    scene = servo_arm()
    pushes = [Push(scene.model.links[-1].name, moment=(0.1, 0.1, 0.1), start=0.013, end=0.03)] if pushed else []
    session, actions = Session(scene, 9, pushes=pushes, record=RECORD), moves(9, 12)
    late = np.arange(9) % 3 == 1
    for action in actions[:4]:
        session.step(action)
    start = initial_state(scene, [0.3])
    session.reset(late, start)
    assert session.time.tolist() == np.where(late, 0.0, 0.04).tolist()
    for action in actions[4:]:
        session.step(action)
    ran = whole(session, actions, pushes=pushes)
    again = whole(session, actions[4:], pushes=pushes, states=[start] * 9)
    assert_same(session, [other if new else run for new, run, other in zip(late, ran, again)])
    if pushed:
        alone = whole(session, actions)
        assert all(run.final.tobytes() != other.final.tobytes() for run, other in zip(ran, alone))


@pytest.mark.long
def test_a_state_that_a_run_has_come_to_goes_on():
    scene, actions = servo_arm(lag=0.0), moves(3, 8)
    session = Session(scene, 3)
    runs = whole(session, actions[:4])
    session.reset(state=runs)
    for action in actions[4:]:
        session.step(action)
    assert_same(session, whole(session, actions), recorded=False)
    session.reset(state=[reset_time(scene, run.final) for run in runs])
    assert session.time.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.long
def test_the_estimate_is_that_of_simulate():
    for integrator in ("midpoint", None):
        session, actions = Session(servo_arm(integrator, delay=0.0), 3, estimate_error=True), moves(3)
        for action in actions:
            session.step(action)
        runs = whole(session, actions, estimate_error=None, record=("q",))
        assert np.array_equal(session.error("q"), [run.error["q"][-1] for run in runs])
        assert 0.0 < session.error("q").max() < 1e-2
        assert session.status == [run.status for run in runs]


@pytest.mark.long
def test_noise_is_drawn_for_each_robot():
    """In the order of ticks: a run is given the same."""
    scene, actions = servo_arm(), moves(3, 5)
    session = Session(scene, 3, noise=(1e-3, 0.1), seed=7, record=RECORD)
    for action in actions:
        session.step(action)
    noises = [
        np.random.default_rng([7, robot]).standard_normal((5, 1, 2)) * np.array([1e-3, 0.1]) for robot in range(3)
    ]
    assert_same(session, whole(session, actions, noises=noises))


# ------------------------------------------------------------------------------------------------ inputs


@pytest.mark.long
def test_a_voltage_reaches_the_motor_as_it_is():
    """But for the supply's limit; the current of a motor that stands is V/R."""
    scene = servo_arm(lag=0.0, delay=0.0, Kf=1.0)
    servo = next(iter(scene.model.servos.values()))
    session = Session(scene, 3, "voltage", observe=("voltage", "current", "rotor_speed"))
    seen = session.step([[0.3], [-0.5], [100.0]])
    assert seen["voltage"].ravel().tolist() == [0.3, -0.5, servo.voltage_limit]
    seen = session.step([[0.3], [-0.5], [0.0]], ticks=100)
    constant = servo.motor_constant * servo.gearbox.ratio
    steady = (seen["voltage"] - constant * seen["rotor_speed"]) / servo.resistance
    assert np.allclose(seen["current"][:2], steady[:2], atol=1e-3)


@pytest.mark.long
def test_a_duty_cycle_is_a_share_of_the_supply():
    scene = servo_arm(lag=0.0, delay=0.0)
    limit = next(iter(scene.model.servos.values())).voltage_limit
    session = Session(scene, 2, "pwm", observe=("voltage",))
    assert session.step([[0.25], [-1.0]])["voltage"].ravel().tolist() == [0.25 * limit, -limit]


@pytest.mark.long
def test_a_torque_holds_a_pendulum_against_its_weight():
    """At sin q = tau / (m g l / 2)."""
    scene = compile_scene(pendulum(damping=1.0), integrator="implicit_euler", timestep=1e-3)
    session, lever = Session(scene, 11, observe=("q",)), 1.0 * G * 0.25
    angles = np.linspace(-1.0, 1.0, 11)
    seen = session.step((lever * np.sin(angles))[:, None], ticks=1500)
    assert np.allclose(seen["q"].ravel(), angles, atol=1e-4)


@pytest.mark.long
@pytest.mark.nojit
def test_torques_have_the_bits_of_runs_that_follow_each_other():
    scene = compile_scene(pendulum(), integrator="implicit_euler", timestep=1e-3)
    for n in (1, 3):
        session, torques, runs = Session(scene, n), moves(n, 5), [None] * n
        for torque in torques:
            session.step(torque)
            runs = simulate_batch(scene, session.tick, runs, taus=[*torque], estimate_error=False)
        assert_same(session, runs, recorded=False)


@pytest.mark.long
def test_a_servo_that_follows_its_reference_at_every_instant():
    arm = load_robot("ax12_arm")
    arm = with_controller(arm, law="pd", Kd=0.1)
    scene = compile_scene(arm, "standard", integrator="implicit_euler", timestep=1e-3)
    session, actions, run = Session(scene, 1), moves(1, 5), None
    for action in actions:
        session.step(action)
        run = simulate(scene, session.tick, run, Reference([0.0], action), estimate_error=False)
    assert_same(session, [run], recorded=False)
    with pytest.raises(ValueError, match="torque law and have no motor: give 'reference'"):
        Session(scene, 1, "voltage")


# ------------------------------------------------------------------------------------------------ observing


def test_a_channel_that_is_added_to_the_table_is_observed(monkeypatch):
    channel = state.Channel("twice", "computed", "joint", 1, "rad", "twice q", needs=("q",), compute=lambda q: 2.0 * q)
    monkeypatch.setitem(state.BY_NAME, channel.name, channel)
    state.RECORDABLE += (channel.name,)
    try:
        seen = Session(servo_arm(delay=0.0), observe=("q", "twice")).observe()
        assert np.array_equal(seen["twice"], 2.0 * seen["q"])
        assert channel.name in channel_table()
    finally:
        state.RECORDABLE.remove(channel.name)


def test_observations_are_channels_and_sensors_in_the_same_arrays():
    scene = compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)
    names = ("q", "contact_force", "power", "encoders", "accelerometer", "sole_forces", "center_of_pressure")
    session = Session(scene, 9, observe=names)
    first = session.observe()
    seen = session.step(ticks=2)
    record = ("q", "qd", "torque", "contact_force", "base_q", "base_qd", "base_qdd", "power")
    run = simulate(scene, 0.02, record=record, estimate_error=False)
    for name in ("q", "contact_force", "power"):
        assert np.array_equal(seen[name], np.broadcast_to(run[name][-1], seen[name].shape)), name
        assert seen[name] is first[name]
    for name in ("encoders", "accelerometer", "center_of_pressure"):
        assert np.allclose(seen[name], getattr(sensors, name)(scene, run)[-1], rtol=1e-12, atol=1e-12), name
    soles = sensors.sole_forces(scene, run)
    assert {*soles} == {*seen["sole_forces"]}
    assert all(np.allclose(seen["sole_forces"][link][4], force[-1]) for link, force in soles.items())


# ------------------------------------------------------------------------------------------------ reliability


@pytest.mark.long
def test_one_robot_that_fails_leaves_the_others_alone():
    scene, actions = servo_arm(), moves(11, 6)
    bad = initial_state(scene, [0.1], [1e9])
    session, other = Session(scene, 11), Session(scene, 11)
    session.reset(np.arange(11) == 3, bad)
    for action in actions:
        session.step(action)
        other.step(action)
    assert session.status == ["ok"] * 3 + ["diverged"] + ["ok"] * 7
    assert session.active.tolist() == [k != 3 for k in range(11)]
    assert "ax12" in session.messages[3]
    rest = session.active
    assert np.array_equal(session.state[rest], other.state[rest])
    session.reset(~session.active)
    assert session.active.all()


@pytest.mark.long
def test_copies_files_and_pickles_go_on_alike(tmp_path):
    scene, actions = servo_arm(), moves(9, 8)
    session = Session(scene, 9, noise=(1e-3, 0.1), record=("q",))
    for action in actions[:4]:
        session.step(action)
    session.save(tmp_path / "session.npz")
    others = [session.copy(), pickle.loads(pickle.dumps(session)), Session(scene, 9, noise=(1e-3, 0.1), record=("q",))]
    others[2].restore(tmp_path / "session.npz")
    for one in (session, *others):
        for action in actions[4:]:
            one.step(action)
    assert all(np.array_equal(one.state, session.state) for one in others)
    for one in others[:2]:
        assert np.array_equal(one.trajectory(8)["q"], session.trajectory(8)["q"])
    with pytest.raises(ValueError, match="another shape"):
        Session(scene, 8, noise=(1e-3, 0.1)).restore(tmp_path / "session.npz")
    (tmp_path / "session.npz").write_bytes(b"no")
    with pytest.raises(ValueError, match="damaged"):
        session.restore(tmp_path / "session.npz")


@pytest.mark.long
def test_a_file_of_another_scene_is_refused(tmp_path):
    """Shapes, names and integrators are the same; a number differs."""
    scene, how = servo_arm(), {"noise": (1e-3, 0.1), "seed": 3}
    path, pushes = tmp_path / "session.npz", [Push(scene.model.links[-1].name, force=(0.0, 1.0, 0.0))]
    session = Session(scene, 2, **how)
    session.save(path)
    softer = replace(scene.model, joints=tuple(replace(j, damping=j.damping + 1e-3) for j in scene.model.joints))
    Session(servo_arm(), 2, **how).restore(path)
    others = [
        Session(scene.recompiled(gravity=(0.0, 0.0, -3.7)), 2, **how),
        Session(scene.recompiled(softer), 2, **how),
        Session(scene, 2, noise=(1e-3, 0.1), seed=4),
        Session(scene, 2, noise=(1e-3, 0.2), seed=3),
        Session(scene, 2, pushes=pushes, **how),
    ]
    for other in others:
        before = other.state
        with pytest.raises(ValueError, match=r"session\.npz"):
            other.restore(path)
        assert np.array_equal(other.state, before)


def test_a_file_that_does_not_say_of_which_scene_it_is_is_refused(tmp_path):
    session = Session(servo_arm(delay=0.0), 2)
    session.save(tmp_path / "session.npz")
    arrays = dict(np.load(tmp_path / "session.npz"))
    del arrays["scene"]
    np.savez_compressed(tmp_path / "session.npz", **arrays)
    with pytest.raises(ValueError, match=r"session\.npz: scene is missing"):
        session.restore(tmp_path / "session.npz")


@pytest.mark.long
def test_sessions_in_threads_do_not_meet():
    scene, actions = servo_arm(), moves(9, 30)

    def stepped(_):
        with Session(scene, 9) as session:
            for action in actions:
                session.step(action)
            return session.state.tobytes()

    with ThreadPoolExecutor(4) as pool:
        assert len({*pool.map(stepped, range(8))}) == 1


def stepped_state(session):
    """In another process."""
    session.step(np.full((session.n, 1), 0.2), ticks=3)
    return session.state.tobytes()


@pytest.mark.long
def test_a_session_goes_on_in_another_process():
    session = Session(servo_arm(), 9)
    session.step(moves(9, 1)[0])
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        there = pool.submit(stepped_state, session).result()
    assert there == stepped_state(session)


@pytest.mark.long
def test_an_exception_between_or_within_steps_leaves_a_session_as_it_was():
    session, actions = Session(servo_arm(), 3), moves(3, 4)
    for action in actions[:2]:
        session.step(action)
    before = session.state
    for wrong in (np.full((3, 1), np.nan), "wrong", np.zeros((2, 1)), [[1j]] * 3):
        with pytest.raises(ValueError, match="action"):
            session.step(wrong)
    assert np.array_equal(session.state, before)
    for action in actions[2:]:
        session.step(action)
    assert_same(session, whole(session, actions), recorded=False)


@pytest.mark.long
def test_an_interrupt_comes_when_all_of_a_tick_is_done(monkeypatch):
    """Ctrl-C while robots go on: records and second runs are as far as they are."""
    session, other = (Session(servo_arm(), 3, record=("q",), estimate_error=True) for _ in range(2))
    actions = moves(3, 4)
    tick = session._fleets[0].tick

    def interrupted():
        tick()
        raise KeyboardInterrupt

    for k, action in enumerate(actions):
        if k == 2:
            monkeypatch.setattr(session._fleets[0], "tick", interrupted)
            with pytest.raises(KeyboardInterrupt):
                session.step(action)
            monkeypatch.undo()
        else:
            session.step(action)
        other.step(action)
    assert np.array_equal(session.state, other.state)
    assert np.array_equal(session.error("q"), other.error("q"))
    assert np.array_equal(session.trajectory(1)["q"], other.trajectory(1)["q"])


@pytest.mark.long
def test_a_start_beyond_limits_is_told_where_a_robot_goes_on_from_it_and_nobody_chose_it():
    arm = load_robot("ax12_arm")
    session = Session(servo_arm(model=replace(arm, joints=tuple(replace(one, lower=0.2) for one in arm.joints))))
    session.reset(state=initial_state(session.scene, [0.5]))
    session.step()
    session.reset()
    with pytest.warns(UserWarning, match="is at 0 rad or m, beyond its limits 0.2 to"):
        session.step()


def test_misuse_is_refused():
    scene = servo_arm("implicit_euler", delay=0.0)
    bare = compile_scene(pendulum(), integrator="implicit_euler", timestep=1e-3)
    session = Session(scene, 3)
    for wrong, message in (
        (lambda: session.step(np.zeros((3, 1)), ticks=0), "ticks is 0"),
        (lambda: session.reset([True, False]), r"mask is .* give \(3,\)"),
        (lambda: session.reset([0, 1, 1]), "mask is"),
        (lambda: session.reset(state=np.zeros(5)), "state"),
        (lambda: session.reset(state=[initial_state(scene)] * 2), "2 entries; the mask has 3"),
        (lambda: session.trajectory(3), "robot is 3"),
        (lambda: session.error("q"), "estimate_error=True"),
        (lambda: Session(scene, 0), "n is 0"),
        (lambda: Session(scene, 1, "force"), "action is 'force'"),
        (lambda: Session(scene, 1, "torque"), "compile the scene with gearbox=None"),
        (lambda: Session(bare, 1, "voltage"), "it has no servos"),
        (lambda: Session(scene, 1, observe=("qq",)), "no channel or sensor 'qq'"),
        (lambda: Session(scene, 1, observe="q"), "give a list of names"),
        (lambda: Session(scene, 1, record=("qq",)), "there is no channel"),
        (lambda: Session(scene, 1, record_interval=0.003), "record_interval is 0.003"),
        (lambda: Session(scene, 1, noise=0.1), "noise"),
        (lambda: Session(scene, 5, worlds=Worlds(runs=3)), "n is 5"),
        (lambda: Session(scene, 1, "pwm").step([1.5]), "duty cycle of 1.5"),
    ):
        with pytest.raises(ValueError, match=message):
            wrong()
    with pytest.raises(TypeError, match="scene"):
        Session("scene")
    with pytest.raises(TypeError, match="world"):
        Session(scene, world=None)
    session.close()
    session.close()
    with pytest.raises(ValueError, match="closed"):
        session.step()


@pytest.mark.long
def test_a_session_is_stepped_by_one_thread_at_a_time():
    session = Session(servo_arm(), 1)
    with session._alone(), ThreadPoolExecutor(1) as pool, pytest.raises(RuntimeError, match="another thread"):
        pool.submit(session.step).result()


@pytest.mark.long
def test_steps_that_are_paced_take_the_time_that_they_simulate():
    session = Session(servo_arm(), 1, pace=True)
    session.step()
    session.reset()
    start = time.monotonic()
    session.step(ticks=10)
    session.step(ticks=5)
    assert time.monotonic() - start >= 0.15 - 1e-3
    assert session.lag >= 0.0
    time.sleep(0.05)
    session.step()
    assert 0.03 < session.lag


def steps_without_growth(count):
    session, action = Session(servo_arm(), 1), np.zeros((1, 1))
    for _ in range(2000):
        session.step(action)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for k in range(count):
        session.step(action)
        if k % 1000 == 0:
            session.reset(np.ones(1, bool))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before


@pytest.mark.long
def test_a_million_steps_need_no_more_memory_than_the_first():
    """8 bytes kept of each would be 8 MB."""
    assert steps_without_growth(1_000_000) < 400
