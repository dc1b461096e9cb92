"""Loops made and broken between runs: plastic impacts, places that are taken, gaps that are refused, sessions."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import (
    Fluid,
    Immersed,
    Joint,
    Link,
    Loop,
    Model,
    Session,
    Sphere,
    compile_scene,
    energy,
    initial_state,
    loop_gaps,
    simulate,
    switch_loop,
)

ONCE = {"estimate_error": False}


def sliders(kind="weld", gap=0.0, base="fixed"):
    """Two carts of 1 and 3 kg on one rail, that a loop may join."""
    ball = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)
    links = Link("rail", 2.0, inertia=ball), Link("light", 1.0, inertia=ball), Link("heavy", 3.0, inertia=ball)
    joints = tuple(Joint(name, "prismatic", "rail", name) for name in ("light", "heavy"))
    length = {"distance": 0.5} if kind == "distance" else {}
    loop = Loop("lock", kind, "light", "heavy", (0.5 + gap, 0.0, 0.0), **length)
    return Model("sliders", links, joints, base=base, loops=(loop,))


@pytest.mark.nojit
@pytest.mark.parametrize("kind", ["connect", "weld", "hinge", "distance"])
def test_carts_that_lock_move_on_with_their_common_speed(kind):
    model = sliders(kind)
    scene = compile_scene(model, integrator="rk4", timestep=1e-3)
    q = [0.0, 1.0 if kind == "distance" else 0.5]
    start = initial_state(scene, q, [2.0, 0.0], open_loops=["lock"])
    locked = switch_loop(scene, start, "lock", True)
    view = scene.state_view(locked)
    np.testing.assert_allclose(view.qd, [0.5, 0.5], rtol=1e-14)  # momentum stays
    assert view.loop_loss[0] == pytest.approx(0.5 * 2.0**2 - 0.5 * 4.0 * 0.5**2, rel=1e-13)
    run = simulate(scene, 0.1, locked, record=("q",), **ONCE)
    np.testing.assert_allclose(run["q"][-1], [0.05, q[1] + 0.05], atol=1e-14)
    freed = switch_loop(scene, run, "lock", False)
    assert simulate(scene, 0.01, freed, record=("loop_force",), **ONCE)["loop_force"].any() == 0.0


@pytest.mark.long
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_a_loop_is_made_where_it_is_or_refused_with_its_gap(base):
    model = sliders("weld", gap=0.02, base=base)
    scene = compile_scene(model, integrator="midpoint", timestep=1e-3)
    q = np.array([*([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0] if base == "floating" else []), 0.0, 0.5])
    start = initial_state(scene, q, open_loops=["lock"])
    with pytest.raises(ValueError, match=r"'lock' is open by 0\.02 m or rad.*within=0\.001.*allow more"):
        switch_loop(scene, start, "lock", True)
    held = switch_loop(scene, start, "lock", True, within=math.inf)
    run = simulate(scene, 0.1, held, record=("q",), **ONCE)
    assert run.status == "ok"
    np.testing.assert_allclose(run["q"][-1], [0.0, 0.5], atol=1e-14)  # it does not pull the carts together
    assert np.linalg.norm(run.state.loop_place[0, :3]) == pytest.approx(0.02)
    with pytest.raises(ValueError, match="'lock' is open by"):
        initial_state(scene, q)
    with pytest.raises(ValueError, match=r"'look'.*lock"):
        switch_loop(scene, start, "look", True)
    same = switch_loop(scene, held, "lock", True)
    assert same.tobytes() == held.tobytes()


def test_a_pendulum_that_is_caught_and_let_go_keeps_account_of_its_energy():
    bars = [Link(f"bar{k}", 1.0, (0.25, 0.0, 0.0), (1e-3, 0.0, 0.0, 0.03, 0.0, 0.03)) for k in (1, 2)]
    y = (0.0, 1.0, 0.0)
    joints = (
        Joint("one", "continuous", "frame", "bar1", axis=y),
        Joint("two", "continuous", "bar1", "bar2", (0.5, 0.0, 0.0), axis=y),
    )
    catch = Loop("catch", "connect", "bar2", "frame", (0.5, 0.0, 0.0))
    model = Model("pendulum", (Link("frame"), *bars), joints, loops=(catch,))
    scene = compile_scene(model, integrator="rk4", timestep=5e-4)
    plain = {"record": ("q", "qd"), **ONCE}
    first = simulate(scene, 0.4, initial_state(scene, [0.3, 0.4], open_loops=["catch"]), **plain)
    caught = switch_loop(scene, first, "catch", True, within=math.inf)
    second = simulate(scene, 0.5, caught, **plain)
    assert second.status == "ok"
    tip = loop_gaps(model, second["q"])
    assert np.abs(tip - tip[0]).max() < 1e-13  # it turns about the point where it was caught
    third = simulate(scene, 0.5, switch_loop(scene, second, "catch", False), **plain)
    assert np.ptp(loop_gaps(model, third["q"]), axis=0).max() > 0.1
    totals = [energy(model, run["q"], run["qd"]).total for run in (first, second, third)]
    for total in totals:
        assert np.ptp(total) < 1e-8
    lost = scene.state_view(caught).loop_loss[0]
    assert lost > 0.1
    assert totals[0][-1] - totals[1][0] == pytest.approx(lost, rel=1e-9)
    assert totals[2][0] == pytest.approx(totals[1][-1], abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["implicit_euler", "ars343", "dop853"])
def test_a_hand_catches_a_falling_box_holds_it_by_its_weight_and_drops_it(integrator):
    inertia = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)
    links = Link("frame"), Link("hand", 0.3, inertia=inertia), Link("box", 0.2, inertia=inertia)
    up = Joint("up", "prismatic", "frame", "hand", axis=(0.0, 0.0, 1.0))
    loose, grip = Joint("loose", "free", "frame", "box"), Loop("grip", "weld", "hand", "box")
    model = Model("lift", links, (up, loose), loops=(grip,))
    scene = compile_scene(model, integrator=integrator, timestep=1e-3)
    start = initial_state(scene, [0.0, 0.05, 0.02, -0.1, 1.0, 0.0, 0.0, 0.0], open_loops=["grip"])

    def go(duration, state, borne):
        tau = np.array([borne * 9.81, *np.zeros(model.nv - 1)])
        run = simulate(scene, duration, state, tau=tau, record=("q", "qd", "loop_force"), **ONCE)
        assert run.status == "ok"
        return run

    fallen = go(0.1, start, 0.3)
    caught = switch_loop(scene, fallen, "grip", True, within=math.inf)
    view, v = scene.state_view(caught), -0.1 * 9.81
    assert view.qd[[0, 3]] == pytest.approx(0.4 * v, rel=1e-12)
    assert view.loop_loss[0] == pytest.approx(0.5 * 0.2 * v**2 * (1.0 - 0.4), rel=1e-12)
    held = go(0.5, caught, 0.5)
    weight = 0.2 * 9.81  # of the box, 5 cm ahead of the hand and 2 cm to its side
    force = [0.0, 0.0, -weight, -0.02 * weight, 0.05 * weight, 0.0]
    np.testing.assert_allclose(held["loop_force"][-1], force, rtol=0, atol=1e-12)
    assert held["qd"][-1, [0, 3]] == pytest.approx(0.4 * v, rel=1e-12)
    dropped = go(0.1, switch_loop(scene, held, "grip", False), 0.3)
    np.testing.assert_allclose(dropped["qd"][-1, [0, 3]], [0.4 * v, 1.4 * v], rtol=1e-12)
    assert not dropped["loop_force"][1:].any()


@pytest.mark.long
def test_each_robot_of_a_session_makes_and_breaks_its_own_loop():
    scene = compile_scene(sliders(), integrator="implicit_euler", timestep=1e-3)
    start = initial_state(scene, [0.0, 0.5], [2.0, 0.0], open_loops=["lock"])
    mask = np.arange(9) % 2 == 0
    with Session(scene, 9, record=("q", "qd"), **ONCE) as session:
        session.reset(state=[start] * 9)
        session.switch_loop("lock", True, mask)
        session.step(ticks=3)
        qd = session.state_view.qd.copy()
        np.testing.assert_allclose(qd[mask], 0.5, rtol=1e-13)
        np.testing.assert_allclose(qd[~mask], np.tile([2.0, 0.0], (4, 1)), rtol=1e-13)
        alone = simulate(scene, 3 * session.tick, switch_loop(scene, start, "lock", True), record=(), **ONCE)
        assert session.state[0].tobytes() == alone.final.tobytes()
        session.switch_loop("lock", False)
        session.step()
        assert not session.state_view.loop_closed.any()


def test_loops_that_cannot_close_together_are_refused():
    model = sliders("weld")
    other = replace(model.loops[0], name="stop", a="light", b="rail", point_a=(0.0, 0.0, 0.0))
    third = replace(other, name="block", a="heavy", point_a=(-0.5, 0.0, 0.0))
    model = replace(model, loops=(*model.loops, other, third))
    scene = compile_scene(model, integrator="rk4", timestep=1e-3)
    start = initial_state(scene, [0.0, 0.5], open_loops=["lock"])
    assert switch_loop(scene, start, "lock", True).size  # redundant, but it fits
    names = [loop.name for loop in model.loops]
    moving = initial_state(scene, [0.0, 0.5], [1.0, -1.0], open_loops=names)
    all_closed = moving
    for name in names:
        all_closed = switch_loop(scene, all_closed, name, True)
    assert np.abs(scene.state_view(all_closed).qd).max() < 1e-13
    assert scene.state_view(all_closed).loop_loss.sum() == pytest.approx(2.0, rel=1e-12)


@pytest.mark.quick("0.5")
@pytest.mark.parametrize("added", [0.0, 0.5])
def test_a_loop_is_not_made_where_a_fluid_adds_mass(added):
    drag = Immersed("light", Sphere(0.05), buoyant=False, drag=0.5, added_mass=added)
    scene = compile_scene(replace(sliders(), immersed=(drag,)), integrator="rk4", timestep=1e-3, fluid=Fluid(1000.0))
    start = initial_state(scene, [0.0, 0.5], [2.0, 0.0], open_loops=["lock"])
    if added:
        with pytest.raises(ValueError, match=r"'lock' would be made by an impact that knows no added mass"):
            switch_loop(scene, start, "lock", True)
    else:
        view = scene.state_view(switch_loop(scene, start, "lock", True))
        np.testing.assert_allclose(view.qd, [0.5, 0.5], rtol=1e-14)


def test_a_fluid_in_which_nothing_is_immersed_is_refused():
    with pytest.raises(ValueError, match=r"sliders: the fluid acts on nothing.*give Model\.immersed"):
        compile_scene(sliders(), fluid=Fluid(1000.0))
