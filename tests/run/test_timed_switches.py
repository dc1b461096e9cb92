"""Loops made and broken at times within a run: the bits of runs in parts, of resumed runs and of lanes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from test_loop_switches import sliders

from featherstone_gait import (
    Box,
    ContactPoint,
    Ground,
    Loop,
    Surface,
    body,
    compile_scene,
    initial_state,
    load_robot,
    simulate,
    simulate_batch,
    switch_loop,
)
from featherstone_gait.run.parts import check_switches

ONCE = {"estimate_error": False}
RECORD = ("q", "qd", "loop_closed", "loop_loss")


def start_of(scene, speed=2.0):
    return initial_state(scene, [0.0, 0.5], [speed, 0.0], open_loops=["lock"])


@pytest.mark.nojit
@pytest.mark.quick("rk4")
@pytest.mark.parametrize("integrator", ["rk4", "implicit_euler", "dop853"])
def test_carts_that_lock_at_a_time_move_on_with_their_common_speed_until_they_part(integrator):
    """They meet 0.5 m apart at 0.25 s; between two locks one of them is pushed."""
    scene = compile_scene(sliders(), integrator=integrator, timestep=1e-3)
    start = initial_state(scene, [-0.5, 0.5], [2.0, 0.0], open_loops=["lock"])
    switches = [(0.25, "lock", True), (0.405, "lock", False)]
    run = simulate(scene, 0.5, start, record=RECORD, switches=switches, **ONCE)
    assert run.status == "ok"
    t, q, qd = run["time"], run["q"], run["qd"]
    np.testing.assert_allclose(t, 0.01 * np.arange(51), rtol=0, atol=1e-15)
    assert run["loop_closed"][:, 0].tolist() == [float(0.25 <= x < 0.405) for x in t.round(9)]
    np.testing.assert_allclose(qd[t < 0.2499], np.broadcast_to([2.0, 0.0], (25, 2)), rtol=0, atol=1e-13)
    np.testing.assert_allclose(qd[t > 0.2499], 0.5, rtol=0, atol=1e-13)
    np.testing.assert_allclose(q[-1], [0.125, 0.625], rtol=0, atol=1e-12)
    np.testing.assert_allclose(run["loop_loss"][-1], 1.5, rtol=1e-12)


@pytest.mark.long
def test_a_run_that_switches_has_the_bits_of_its_parts_resumed_runs_and_lanes():
    scene = compile_scene(sliders(), integrator="rk4", timestep=1e-3)
    switches = [(0.1, "lock", True, math.inf), (0.203, "lock", False)]
    how = {"record": RECORD, **ONCE}
    starts = [start_of(scene, 0.1 + 0.2 * k) for k in range(9)]
    runs = simulate_batch(scene, 0.3, states=starts, switches=switches, **how)
    for run, start in zip(runs, starts):
        alone = simulate(scene, 0.3, start, switches=switches, **how)
        assert alone.final.tobytes() == run.final.tobytes()
        assert all(alone[name].tobytes() == run[name].tobytes() for name in ("time", *RECORD))
    half = simulate(scene, 0.1, starts[3], switches=switches, **how)  # a switch at its end is that of what goes on
    assert half.state.loop_closed[0] == 0.0
    rest = simulate(scene, 0.2, half, switches=switches, **how)
    assert rest.final.tobytes() == runs[3].final.tobytes()
    assert rest["qd"].tobytes() == runs[3]["qd"][10:].tobytes()
    by_hand = simulate(scene, 0.1, switch_loop(scene, half, "lock", True, math.inf), **how)
    assert by_hand["qd"].tobytes() == runs[3]["qd"][10:21].tobytes()


def test_errors_of_a_run_that_switches_are_those_from_its_start():
    scene = compile_scene(sliders(), integrator="rk4", timestep=1e-3)
    run = simulate(scene, 0.3, start_of(scene), record=("q",), switches=[(0.1, "lock", True, math.inf)])
    assert run.status == "ok"
    assert run.error["q"].shape == run["q"].shape
    assert run.error["q"].max() < 1e-9
    assert run.second_final is not None
    assert run.second_final[scene.part("loop_closed")[0]] == 1.0


def test_wrong_switches_are_refused():
    scene = compile_scene(sliders(), integrator="rk4", timestep=1e-3)
    start = start_of(scene)
    for switches, error, message in (
        ([(0.1, "look", True)], ValueError, r"switches: there is no loop 'look'.*'lock'"),
        ([(0.1, "lock")], TypeError, r"three or four"),
        ([(0.1, "lock", 1.5)], TypeError, "closed"),
        ([(-0.1, "lock", True)], ValueError, "time"),
        ([(0.1005, "lock", True)], ValueError, r"0\.1005 s of loop 'lock'.*steps of 0\.001 s.*take 0\.1 s"),
        ([(0.1, "lock", True)], ValueError, r"'lock' is open by 0\.2 m.*allow more"),
    ):
        with pytest.raises(error, match=message):
            simulate(scene, 0.2, start, switches=switches, **ONCE)


def test_switches_of_surfaces_have_a_command_and_no_gap():
    track = ContactPoint("body", (0.0, 0.0, 0.0), surface=Surface((1.0, 0.0, 0.0), drive="belt"))
    model = replace(body(Box((0.2, 0.2, 0.2)), 1.0), contacts=(track,))
    scene = compile_scene(model, ground=Ground())
    assert check_switches([scene], [(0.1, "belt", 0.5)]) == [(0.1, "belt", 0.5, 1e-3)]
    for switch, error, message in (
        ((0.1, "belt", 0.5, 1e-3), ValueError, r"drive 'belt'.*no gap 0\.001.*fourth"),
        ((0.1, "belt", True), TypeError, r"'belt' is a drive of surfaces.*True.*command"),
        ((0.1, "left", 0.5), ValueError, r"no drive of surfaces 'left'.*'belt'"),
    ):
        with pytest.raises(error, match=message):
            check_switches([scene], [switch])


@pytest.mark.long
@pytest.mark.nojit
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "ars343"])
def test_a_switch_that_changes_nothing_changes_no_bit_of_robots_with_servos(integrator):
    """They hold their first positions, with noise, and a loop that is open is broken where the run is cut."""
    arm = load_robot("arm7")
    model = replace(arm, loops=(Loop("latch", "weld", arm.links[-1].name, arm.root),))
    scene = compile_scene(model, "mipsd", integrator=integrator, timestep=1e-3)
    start = initial_state(scene, np.linspace(0.1, 0.4, 7), open_loops=["latch"])
    tick, ticks = scene.tick_steps * scene.timestep, 3
    noise = 1e-3 * np.random.default_rng(4).normal(size=(ticks, 7, 2))
    how = {"record": ("q", "qd", "current"), "noise": noise, **ONCE}
    whole = simulate(scene, ticks * tick, start, **how)
    cut = simulate(scene, ticks * tick, start, switches=[(tick, "latch", False)], **how)
    assert (whole.status, cut.status) == ("ok", "ok")
    assert whole.final.tobytes() == cut.final.tobytes()
    for name in how["record"]:
        assert whole[name].tobytes() == cut[name].tobytes(), name
    with pytest.raises(ValueError, match=r"between controller ticks of"):
        simulate(scene, ticks * tick, start, switches=[(0.5 * tick, "latch", False)], **how)
