"""Runs in pieces: references, torques, pushes, noise and time go on, and all is as in one run, to the bit."""

import numpy as np
import pytest
from scenes import NEVER_FALLEN, arm_scene, box, pendulum, thrown, with_controller

from featherstone_gait.model import Ground
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.prepare import prepare
from featherstone_gait.run.reference import Reference
from featherstone_gait.run.simulate import PARTS, Push, initial_state, reset_time, simulate, simulate_batch
from featherstone_gait.scene.compile import compile_scene

END = (0.0, 0.0, -0.5)  # of the rod [m]
RECORD = tuple(part for part in PARTS if part != "clearance")


def joined(pieces):
    """The channels of runs that follow each other, the seams once."""
    return {name: np.concatenate([*(p[name][:-1] for p in pieces[:-1]), pieces[-1][name]]) for name in pieces[0]}


def assert_pieces_equal_the_whole(scene, start, lengths, noise=None, **how):
    """Each piece goes on from the last one's trajectory, or from its final state."""
    how["estimate_error"] = False  # tests/run/test_error_estimate.py has the errors
    whole = simulate(scene, sum(lengths), start, record=RECORD, noise=noise, **how)
    assert np.abs(whole["qd"]).max(initial=0.0) + np.abs(whole["base_qd"]).max(initial=0.0) > 0.01
    for of in (lambda run: run, lambda run: run.final):
        pieces, state, ticks = [], start, 0
        for length in lengths:
            count = round(length / (scene.tick_steps * scene.timestep))
            part = None if noise is None else noise[ticks : ticks + count]
            pieces.append(simulate(scene, length, state, record=RECORD, noise=part, **how))
            state, ticks = of(pieces[-1]), ticks + count
        for name, values in joined(pieces).items():
            assert np.array_equal(values, whole[name]), name
        last = pieces[-1]
        assert last.final.tobytes() == whole.final.tobytes()
        assert (last.status, last.message, last.end_time) == (whole.status, whole.message, whole.end_time)


def moving(kind="linear", cyclic=False):
    values = np.random.default_rng(1).normal(scale=0.3, size=(4, 7))
    values[-1] = values[0]
    return Reference([0.0, 0.013, 0.032, 0.05], values, kind, cyclic)


SERVOS = {
    "implicit_euler": ("mipsd", 1e-3),
    "midpoint": ("rotor", 1e-3),
    "rk4": ("rotor", 2e-4),
    "simtwo": ("rotor", 1e-3),
    "extrapolation": ("rotor", 1e-3),
    "ars343": ("rotor", 1e-3),
}


@pytest.mark.quick("*-ars343", "*-implicit_euler")
@pytest.mark.parametrize("integrator", SERVOS)
@pytest.mark.parametrize("signal", [moving(), moving("cubic", cyclic=True)], ids=["linear", "cyclic"])
def test_sampled_servos_with_a_lag_go_on_along_their_reference(integrator, signal):
    arm = with_controller(load_robot("arm7"), law="pid_position", Ki=20.0, Kd=0.3, lag=0.013)
    servos, h = SERVOS[integrator]
    scene = arm_scene(arm, servos, integrator, h)
    tolerance = {"rtol": 1e-4} if scene.adaptive else {}
    start = initial_state(scene, np.full(7, 0.05))
    assert_pieces_equal_the_whole(scene, start, (0.02, 0.01, 0.03), reference=signal, **tolerance)


@pytest.mark.long
def test_noise_is_that_of_each_piece():
    scene = arm_scene(gearbox="rotor")
    noise = np.random.default_rng(2).normal(scale=0.01, size=(6, 7, 2))
    assert_pieces_equal_the_whole(scene, initial_state(scene), (0.02, 0.04), noise, reference=moving())


@pytest.mark.bounds
@pytest.mark.long
@pytest.mark.nojit
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "rk4", "extrapolation"])
def test_torques_and_pushes_go_on_across_the_seam(integrator):
    scene = compile_scene(pendulum(), integrator=integrator, timestep=1e-3)
    torques = Reference([0.0, 0.007, 0.025], [[0.0], [3.0], [0.0]], cyclic=True)
    pushes = [Push("rod", (5.0, 0.0, 0.0), point=END, start=0.0155, end=0.0331)]
    pushes += [Push("rod", (0.0, 0.0, 9.0), point=END, start=0.041)]
    tolerance = {"rtol": 1e-4} if scene.adaptive else {}
    assert_pieces_equal_the_whole(
        scene, initial_state(scene, [0.3]), (0.02, 0.01, 0.03), tau=torques, pushes=pushes, **tolerance
    )


@pytest.mark.long
def test_error_control_goes_on_on_the_ground():
    scene = compile_scene(box(), ground=Ground(), integrator="extrapolation", timestep=1e-3, **NEVER_FALLEN)
    assert_pieces_equal_the_whole(scene, thrown(scene, 1e-3, 0.1), (0.01, 0.02), rtol=1e-3)


@pytest.mark.bounds
@pytest.mark.long
@pytest.mark.nojit
def test_runs_of_different_times_have_the_bits_of_each_alone():
    """In lanes that take the next run, and in groups of those that can go in step."""
    scene, signal = arm_scene(), moving()
    states = [simulate(scene, t, reference=signal) for t in (0.01, 0.02, 0.02, 0.02)] + [initial_state(scene)]
    alone = [simulate(scene, 0.03, state, signal) for state in states]
    for how in ({}, {"pushes": [Push("link7", (1.0, 0.0, 0.0), start=0.035)]}):
        alone = [simulate(scene, 0.03, state, signal, **how) for state in states]
        together = simulate_batch(scene, 0.03, states, [signal] * 5, **how)
        for run, other in zip(together, alone):
            assert run.final.tobytes() == other.final.tobytes()
            assert np.array_equal(run["time"], other["time"])
            assert run.end_time == other.end_time
    ready = prepare(scene, 0.03)
    with pytest.raises(ValueError, match="arm7: states of other times do not go in step"):
        ready.run([ready.start(state, signal) for state in states[:2]])


@pytest.mark.long
@pytest.mark.nojit
def test_a_state_whose_time_is_off_the_grid_goes_on_at_its_time():
    """Of another step: the push at 31 ms finds it, and the times of the records say so."""
    first = simulate(compile_scene(pendulum(), integrator="rk4", timestep=1e-3), 0.03, record=("q",))
    scene = compile_scene(pendulum(), integrator="rk4", timestep=0.7e-3)
    pushes = [Push("rod", (9.0, 0.0, 0.0), point=END, start=0.031)]
    run = simulate(scene, 0.007, first.final, pushes=pushes, record_interval=0.7e-3)
    np.testing.assert_allclose(run["time"], 0.03 + 0.7e-3 * np.arange(len(run["time"])), rtol=0, atol=1e-15)
    assert np.flatnonzero(run["q"][:, 0])[0] == 2
    assert run.end_time == pytest.approx(0.03 + 0.7e-3 * (len(run["time"]) - 1), abs=1e-15)


@pytest.mark.long
def test_a_restarted_state_begins_at_zero():
    scene = compile_scene(pendulum(), integrator="rk4", timestep=1e-3)
    push = [Push("rod", (9.0, 0.0, 0.0), point=END, end=0.01)]
    first = simulate(scene, 0.03, initial_state(scene, [0.1]))
    anew, on = (simulate(scene, 0.02, s, pushes=push) for s in (reset_time(scene, first.final), first))
    assert (anew["time"][0], anew.end_time) == (0.0, 0.02)
    assert on["time"][0] == 0.03
    assert anew["qd"][-1, 0] - on["qd"][-1, 0] < -0.1


@pytest.mark.nojit
def test_a_state_whose_time_is_none_is_refused():
    scene = compile_scene(pendulum())
    state = initial_state(scene)
    state[scene.layout["end_time"]] = -1.0
    with pytest.raises(ValueError, match=r"time of a run.*make it with initial_state"):
        simulate(scene, 0.01, state)
