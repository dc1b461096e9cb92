"""Closed loops beside other robots and contact between bodies: the bits of each alone, rigid bodies, a gripper."""

import math
from dataclasses import replace

import numpy as np
import pytest
from touching import G

from featherstone_gait import (
    Box,
    Ground,
    Joint,
    Link,
    Loop,
    Model,
    PairContact,
    Placed,
    Shape,
    Sphere,
    body,
    close_loops,
    compile_scene,
    initial_state,
    loop_gaps,
    simulate,
    simulate_batch,
    switch_loop,
)

pytestmark = pytest.mark.long
ONCE = {"estimate_error": False}
Y, INERTIA = (0.0, 1.0, 0.0), (0.01, 0.001, 0.0, 0.012, 0.0, 0.009)


def four_bar(base="fixed"):
    """A crank of 0.2 m, a coupler of 0.5 m and a rocker of 0.4 m on a frame of 0.5 m."""
    bars = {"crank": 0.2, "coupler": 0.5, "rocker": 0.4}
    made = [Link(name, 1.0, (0.5 * x, 0.0, 0.0), (1e-4, 0.0, 0.0, 0.01, 0.0, 0.01)) for name, x in bars.items()]
    hinges = (("crank", "frame", 0.0), ("coupler", "crank", 0.2), ("rocker", "frame", 0.5))
    joints = tuple(Joint(name, "continuous", parent, name, (x, 0.0, 0.0), axis=Y) for name, parent, x in hinges)
    pin = Loop("pin", "connect", "coupler", "rocker", (0.5, 0.0, 0.0), (0.4, 0.0, 0.0))
    return Model("linkage", (Link("frame", 2.0, inertia=INERTIA), *made), joints, base=base, loops=(pin,))


@pytest.mark.parametrize("integrator", ["midpoint", "rk4", "ars343"])
def test_a_four_bar_beside_other_robots_moves_to_the_bits_of_one_alone(integrator):
    model, plain = four_bar(), replace(four_bar("floating"), name="open", loops=())
    q = close_loops(model, [0.8, -1.2, -1.0], joints=["coupler", "rocker"])
    how = {"record": ("q", "qd", "loop_force"), **ONCE}
    if integrator == "ars343":  # which chooses its steps for all robots
        how["rtol"] = 1e-10
    alone = compile_scene(model, integrator=integrator, timestep=1e-3)
    members = [Placed(plain, "open"), Placed(model, "left", (1.0, 2.0, 0.5)), Placed(model, "right")]
    scene = compile_scene(members, integrator=integrator, timestep=1e-3)
    assert [loop.name for loop in scene.model.loops] == ["left/pin", "right/pin"]
    expected = simulate(alone, 0.2, initial_state(alone, q), **how)
    run = simulate(scene, 0.2, initial_state(scene, {"left": q, "right": q}), **how)
    assert (expected.status, run.status) == ("ok", "ok")
    for name in ("left", "right"):
        own = run[name]
        assert np.abs(loop_gaps(model, own["q"])).max() < 1e-12
        assert own.info["loop_rows"] == ["pin.x", "pin.y", "pin.z"]
        for channel in ("q", "qd", "loop_force"):
            if integrator != "ars343":
                assert own[channel].tobytes() == expected[channel].tobytes(), channel
            else:
                np.testing.assert_allclose(own[channel], expected[channel], rtol=0, atol=2e-7)
    assert "loop_force" not in run["open"].channels
    again = compile_scene(members, integrator=integrator, timestep=1e-3)
    broken = switch_loop(again, run, "left/pin", False)
    assert again.state_view(broken).loop_closed.tolist() == [0.0, 1.0]


# ---------------------------------------------------------------------------------------------- contact


def hull_and_arm(kind):
    """A hull and an arm of one rigid body, or with a hinge between them that a weld locks."""
    links = Link("hull", 1.0, (0.0, 0.0, 0.01), INERTIA), Link("arm", 0.7, (0.1, 0.0, 0.0), INERTIA)
    at = (0.1, 0.0, 0.02)
    hinge = Joint("hinge", "revolute", "hull", "arm", at, axis=(0.0, 0.6, 0.8), lower=-3.0, upper=3.0)
    shapes = Shape("hull", Box((0.2, 0.2, 0.1))), Shape("arm", Sphere(0.04), xyz=(0.1, 0.0, 0.0))
    lock = Loop("lock", "weld", "arm", "hull", point_b=at)
    rigid = kind == "rigid"
    return Model(
        kind, links, (Joint("hinge", "fixed", "hull", "arm", at) if rigid else hinge,), base="floating",
        shapes=shapes, loops=() if rigid else (lock,),
    )  # fmt: skip


def on_a_box(model, integrator, timestep=1e-3):
    """The robot over a box that lies on the ground, near enough to fall on it."""
    box = Placed(body(Box((0.3, 0.3, 0.1)), 2.0), "box", (0.0, 0.0, 0.05))
    members = [Placed(model, "robot", (0.05, 0.02, 0.1502)), box]
    return compile_scene(members, None, Ground(), integrator, timestep, pairs=PairContact(load=2.0))


@pytest.mark.nojit
@pytest.mark.parametrize("integrator", ["midpoint", "rk4"])
def test_a_locked_robot_that_slides_on_a_box_moves_as_one_rigid_body(integrator):
    """The loop has five rows that depend on the hinge's bearings, and its forces bear a part of the contact."""
    runs = []
    for kind in ("rigid", "locked"):
        scene = on_a_box(hull_and_arm(kind), integrator)
        start = initial_state(scene, qd={"robot": [0.3, 0.1, -0.2, 0.1, 0.5, -0.3] + [0.0] * (kind == "locked")})
        record = ["base_q", "base_qd", "pair_force", "pair_work"] + ["loop_force"] * (kind == "locked")
        runs.append(simulate(scene, 0.03, start, record=record, **ONCE))
        assert runs[-1].status == "ok"
    rigid, locked = runs
    assert np.abs(rigid["pair_force"]).max() > 10.0
    assert np.abs(locked["loop_force"]).max() > 10.0
    for channel, atol in (("base_q", 1e-13), ("base_qd", 1e-12), ("pair_force", 1e-9), ("pair_work", 1e-12)):
        np.testing.assert_allclose(locked[channel], rigid[channel], rtol=0, atol=atol)
    assert np.abs(locked.state.q).max() < 1e-12


@pytest.mark.parametrize("integrator", ["ars343", "dop853"])
def test_error_control_sees_a_locked_robot_on_a_box_as_one_rigid_body(integrator):
    ends = []
    for kind in ("rigid", "locked"):
        scene = on_a_box(hull_and_arm(kind), integrator)
        start = initial_state(scene, qd={"robot": [0.3, 0.1, -0.2, 0.1, 0.5, -0.3] + [0.0] * (kind == "locked")})
        run = simulate(scene, 0.05, start, rtol=1e-8, **ONCE)
        assert run.status == "ok"
        ends.append(run.state.base_q)
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-7)


def test_robots_with_loops_in_lanes_have_the_bits_of_each_alone():
    """Some touch the box, some fall beside it, so that trees are solved together in a lane and alone in another."""
    model = hull_and_arm("locked")
    scene = on_a_box(model, "midpoint")
    starts = []
    for k in range(9):
        q = [0.05 + 0.1 * k, 0.02, 0.1502 + 0.01 * k, 1.0, 0.0, 0.0, 0.0, 0.0]
        starts.append(initial_state(scene, {"robot": q}, {"robot": [0.3, 0.1, -0.2, 0.1, 0.5, -0.3, 0.0]}))
    how = {"record": ("base_q", "base_qd", "q", "loop_force", "pair_work"), **ONCE}
    runs = simulate_batch(scene, 0.15, states=starts, **how)
    for run, start in zip(runs, starts):
        assert run.status == "ok"
        alone = simulate(scene, 0.15, start, **how)
        for channel in how["record"]:
            assert alone[channel].tobytes() == run[channel].tobytes(), channel
    assert len({run.final.tobytes() for run in runs}) == len(runs)


def gripper():
    """A palm with two fingers, each the coupler of a parallelogram of two cranks of 0.1 m that hang down."""
    inertia = (1e-5, 0.0, 0.0, 1e-5, 0.0, 1e-5)
    links, joints, loops, shapes = [Link("palm")], [], [], []
    for side, s in (("left", -1.0), ("right", 1.0)):
        inner, outer, finger = f"{side} inner", f"{side} outer", f"{side} finger"
        links += [Link(name, 0.02, (0.0, 0.0, -0.05), inertia) for name in (inner, outer)]
        links.append(Link(finger, 0.05, (0.0, 0.0, -0.03), inertia))
        joints += [
            Joint(inner, "continuous", "palm", inner, (0.06 * s, 0.0, 0.0), axis=Y),
            Joint(outer, "continuous", "palm", outer, (0.1 * s, 0.0, 0.0), axis=Y),
            Joint(finger, "continuous", inner, finger, (0.0, 0.0, -0.1), axis=Y),
        ]
        loops.append(Loop(f"{side} pin", "connect", finger, outer, (0.04 * s, 0.0, 0.0), (0.0, 0.0, -0.1)))
        shapes.append(Shape(finger, Box((0.02, 0.04, 0.06)), xyz=(0.0, 0.0, -0.03)))
    return Model("gripper", tuple(links), tuple(joints), loops=tuple(loops), shapes=tuple(shapes))


def test_a_gripper_of_two_parallelograms_holds_a_box_by_friction_and_lets_it_fall():
    """Each crank presses with its torque by the length of the crank; friction bears half of the weight."""
    mass, pressed = 0.1, 4.0
    hand = Placed(gripper(), "hand", (0.0, 0.0, 1.0))
    box = Placed(body(Box((0.1, 0.04, 0.04)), mass), "box", (0.0, 0.0, 0.87))
    scene = compile_scene(
        [hand, box], integrator="ars343", timestep=1e-3, pairs=PairContact(friction=0.8, load=mass)
    )
    names = list(scene.model.joint_names)
    tau = np.zeros(len(names))
    tau[names.index("hand/left inner")], tau[names.index("hand/right inner")] = -0.1 * pressed, 0.1 * pressed
    how = {"record": ("q", "base_q", "pair_normal_force", "pair_force", "loop_force"), **ONCE}
    held = simulate(scene, 0.5, tau=tau, **how)
    assert held.status == "ok"
    height = held["box"]["base_q"][:, 2]
    assert abs(height[-1] - height[20]) < 1e-5
    assert abs(height[-1] - 0.87) < 1e-3
    assert np.abs(loop_gaps(hand.model, held["hand"]["q"])).max() < 1e-12
    q = held["hand"]["q"][-1]  # fingers stay upright
    np.testing.assert_allclose(q[2] + q[0], 0.0, atol=1e-11)
    lift = held["pair_force"][-1].sum(axis=0)
    assert abs(abs(lift[2]) - mass * G) < 1e-3 * mass * G
    sums = held["pair_normal_force"][-1].sum()
    assert abs(sums - 2.0 * pressed) < 0.05 * 2.0 * pressed
    free = simulate(scene, 0.1, held, tau=-tau, **how)
    fallen = height[-1] - free["box"]["base_q"][:, 2]
    assert free.status == "ok"
    assert math.isclose(fallen[-1], 0.5 * G * 0.1**2, rel_tol=0.2)
    np.testing.assert_allclose(np.diff(free["box"]["base_q"][:, 2], 2)[-3:], -1e-4 * G, rtol=1e-9)  # freely at the end
