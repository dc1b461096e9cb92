"""Surfaces of links and obstacles that move: belts, turntables and tracks, against closed forms and MuJoCo."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import (
    Box,
    ContactPoint,
    Ground,
    Link,
    Model,
    PairContact,
    Placed,
    SceneModel,
    Session,
    Surface,
    body,
    command_surface,
    compile_scene,
    controller,
    initial_state,
    load_scene,
    simulate,
    simulate_batch,
)

G = 9.81
MU = 0.4


def on(surface, position=(0.0, 0.0), friction=MU, own=None, size=0.1, **contact):
    """Return a scene in which a cube of 1 kg lies on a box of a surface."""
    cube = body(Box((size, size, 0.25 * size)), 1.0, friction=friction, name="cube", surface=own)
    under = body(Box((4.0, 4.0, 0.2)), base="fixed", friction=friction, name="under", surface=surface)
    placed = Placed(cube, position=(*position, 0.2 + 0.125 * size))
    scene = SceneModel("scene", [placed], [Placed(under, position=(0.0, 0.0, 0.1))])
    return compile_scene(scene, pairs=PairContact("all", penetration=1e-5, **contact))


RECORD = ("base_q", "base_qd", "pair_work", "surface_work")


@pytest.mark.long
def test_a_box_on_a_belt_slides_until_it_moves_along():
    """Its speed is mu g t up to the belt's; the drive's work is the belt's speed times the momentum."""
    scene, v = on(Surface(velocity=(1.0, 0.0, 0.0))), 1.0
    assert scene.surface_drives == ("under/body",)
    run = simulate(scene, 0.6, record=RECORD, rtol=1e-7)
    t, speed, reached = run["time"], run["cube"]["base_qd"][:, 0], v / (MU * G)
    sliding = (t > 0.02) & (t < 0.24)
    assert np.diff(speed[sliding]) / np.diff(t[sliding]) == pytest.approx(MU * G, rel=1e-5)
    assert speed[-1] == pytest.approx(v, rel=1e-6)
    assert run["cube"]["base_q"][-1, 0] == pytest.approx(v * (0.6 - 0.5 * reached), rel=1e-4)
    assert run["pair_work"][-1] == pytest.approx(0.5 * v * v, rel=1e-3)
    assert run["surface_work"][-1] == pytest.approx(v * v, rel=1e-5)


@pytest.mark.long
def test_a_box_with_a_surface_of_its_own_drives_off():
    """What lies on its track goes the other way; the drive gives twice the kinetic energy."""
    run = simulate(on(None, own=Surface(velocity=(0.0, -0.5, 0.0), drive="track")), 0.4, record=RECORD, rtol=1e-7)
    assert run["cube"]["base_qd"][-1, 1] == pytest.approx(0.5, rel=1e-5)
    assert run["surface_work"][-1] == pytest.approx(0.25, rel=1e-5)


def turning(share, r=0.5, **contact):
    """Return a scene, a state and the speed of a turntable that takes a share of what friction can carry at r."""
    w = math.sqrt(share * 0.3 * G / r)
    scene = on(Surface(turning=(0.0, 0.0, w)), (r, 0.0), friction=0.3, size=0.02, **contact)
    y = initial_state(scene)
    view = scene.state_view(y)
    view.base_qd[1], view.base_qd[5] = r * w, w
    return scene, y, w


@pytest.mark.long
@pytest.mark.parametrize("share", [0.98, 1.02])
def test_a_turntable_carries_a_box_while_friction_can(share):
    scene, y, w = turning(share)
    place = simulate(scene, 2.0, y, record=RECORD, rtol=1e-7)["cube"]["base_q"]
    away = np.hypot(place[:, 0], place[:, 1])
    if share < 1.0:
        assert away == pytest.approx(0.5, abs=1e-5)  # friction deflects the contact by less than it sinks in
        assert np.ptp(away[len(away) // 2 :]) < 1e-9
        turned = np.unwrap(np.arctan2(place[:, 1], place[:, 0]))
        assert turned[-1] == pytest.approx(2.0 * w, rel=1e-5)
    else:
        assert away[-1] > 0.6


def both_turn(integrator, **step):
    """Return a scene of a cube whose surface turns on a table whose surface turns the other way and moves."""
    cube = body(Box((0.1, 0.1, 0.02)), 1.0, friction=0.3, name="cube", surface=Surface(turning=(0.0, 0.0, -2.0)))
    table = body(Box((2.0, 2.0, 0.2)), base="fixed", surface=Surface((0.1, 0.0, 0.0), (0.0, 0.0, 3.0)))
    scene = SceneModel("two", [Placed(cube, position=(0.2, 0.0, 0.21))], [Placed(table, position=(0.0, 0.0, 0.1))])
    pairs = PairContact("all", penetration=1e-3, torsional_friction=0.01)
    return compile_scene(scene, pairs=pairs, integrator=integrator, **step)


@pytest.mark.long
def test_explicit_and_implicit_integrators_agree_on_a_turntable():
    """That holds with friction of spinning too: its drive gives what pairs and friction take."""
    runs = []
    for integrator in ("ars343", "dop853"):
        compiled = both_turn(integrator)
        runs.append(simulate(compiled, 0.1, record=RECORD, rtol=1e-9, estimate_error=False))
    for name in RECORD:
        np.testing.assert_allclose(runs[0][name][-1], runs[1][name][-1], rtol=1e-5, atol=1e-7, err_msg=name)
    assert (runs[0]["surface_work"][-1] > 0.0).all()


LONG, WIDE = 0.2, 0.15


def vehicle(speed=0.5, friction=0.6):
    """Return a vehicle on two tracks, of two contact points each."""
    hull = Link("hull", 2.0, (0.0, 0.0, 0.0), (0.02, 0.0, 0.0, 0.03, 0.0, 0.04))
    sides = ((WIDE, "left"), (-WIDE, "right"))
    tracks = [(y, Surface((-1.0, 0.0, 0.0), drive=drive, command=speed)) for y, drive in sides]
    ends = [((x, y, 0.0), track) for x in (-LONG, LONG) for y, track in tracks]
    points = tuple(ContactPoint("hull", at, friction=friction, surface=track) for at, track in ends)
    return Model("vehicle", (hull,), (), "floating", contacts=points)


@pytest.mark.long
def test_a_tracked_vehicle_drives_at_the_speed_of_its_tracks_and_turns_in_place():
    """In place all points slip under one load, and their moments about the center vanish: w = v b / (b^2 + l^2)."""
    scene = compile_scene(vehicle(), ground=Ground(penetration=1e-5), fall_height=-1e6)
    assert scene.surface_drives == ("left", "right")
    record = ("base_qd", "contact_work", "surface_work", "surface_command")
    run = simulate(scene, 0.5, record=record, rtol=1e-8)
    assert run["base_qd"][-1] == pytest.approx([0.5, 0.0, 0.0, 0.0, 0.0, 0.0], abs=1e-6)
    assert run["contact_work"][-1, 0] == pytest.approx(0.5 * 2.0 * 0.25, rel=1e-5)
    assert run["surface_work"][-1] == pytest.approx([0.25, 0.25], rel=1e-5)
    run = simulate(scene, 1.0, command_surface(scene, initial_state(scene), "left", -0.5), record=record, rtol=1e-8)
    rate = 0.5 * WIDE / (WIDE**2 + LONG**2)
    assert run["base_qd"][-1] == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.0, rate], abs=1e-6)
    switches = [(0.0, "left", -0.5), (0.5, "left", 0.5), (0.5, "right", 0.2)]
    run = simulate(scene, 1.0, record=record, switches=switches, estimate_error=False)
    half = len(run["time"]) // 2
    np.testing.assert_array_equal(run["surface_command"][half - 1 :: half // 2][:2], [[-0.5, 0.5], [0.5, 0.2]])


@controller(memory=0, writes="torque")
def steer(t, state, reference, command, memory):
    command[0, 0] = -0.5 if t < 0.1 else 0.5
    command[1, 0] = 0.3 - command[1, 0]


@pytest.mark.long
def test_sessions_switches_controllers_and_lanes_give_the_same_bits():
    scene = compile_scene(
        vehicle(), ground=Ground(penetration=1e-4), fall_height=-1e6, integrator="implicit_euler", timestep=1e-3
    )
    speeds = np.linspace(-1.0, 1.0, 9)
    session = Session(scene, n=9, observe=("base_qd", "surface_command"))
    session.command_surface("left", speeds)
    for _ in range(10):
        session.step()
    seen = session.command_surface("right", 0.0, mask=speeds > 0.0)
    assert seen["surface_command"][:, 1].tolist() == [0.5] * 5 + [0.0] * 4
    for _ in range(10):
        session.step()
    states = [command_surface(scene, initial_state(scene), "left", speed) for speed in speeds]
    together = simulate_batch(
        scene, 20 * session.tick, states, switches=[(10 * session.tick, "right", 0.0)], estimate_error=False
    )
    for k in range(5, 9):
        alone = simulate(
            scene, 20 * session.tick, states[k], switches=[(10 * session.tick, "right", 0.0)], estimate_error=False
        )
        assert alone.final.tobytes() == together[k].final.tobytes() == session.state[k].tobytes()
    run = simulate(scene, 0.2, controller=steer, record=("surface_command",), estimate_error=False)
    left, right = run["surface_command"].T
    assert left[[0, -1]].tolist() == [-0.5, 0.5]
    assert sorted(set(np.round(right, 12))) == [-0.2, 0.5]


@pytest.mark.long
def test_belts_and_grounds_of_mjcf_move_bodies_as_in_mujoco(tmp_path):
    """A crate on a belt that lies askew, and one on the ground, come to move with these; both turn.

    MuJoCo's soft contacts settle in another way at first, so that paths differ by a hundredth.
    """
    mujoco = pytest.importorskip("mujoco")
    text = """<mujoco><option timestep="1e-4" cone="elliptic" impratio="100"/><worldbody>
      <geom name="floor" type="plane" size="5 5 .1" pos="0.3 0.2 0" surfacevel="0.2 -0.1 0 0 0 0.7"/>
      <body pos="1 0.5 0.2"><geom name="belt" type="box" size="1 0.4 0.05" euler="0 0 30"
        friction="0.4" surfacevel="0.7 0.1 0 0 0 0.5"/></body>
      <body name="crate" pos="1.1 0.45 0.275"><freejoint/><geom name="c" type="box" size="0.1 0.1 0.025" mass="1"
        friction="0.4"/></body>
      <body name="other" pos="-1 0.5 0.025"><freejoint/><geom name="d" type="box" size="0.1 0.1 0.025" mass="1"
        friction="0.4"/></body></worldbody></mujoco>"""
    (tmp_path / "belts.xml").write_text(text)
    scene = load_scene(tmp_path / "belts.xml")
    assert scene.ground == Ground(1.0, velocity=(0.2, -0.1), turning=0.7, center=(0.3, 0.2))
    compiled = compile_scene(scene, pairs="all")
    run = simulate(compiled, 0.5, record=("base_q", "base_qd"), rtol=1e-7, estimate_error=False)
    machine = mujoco.MjModel.from_xml_path(str(tmp_path / "belts.xml"))
    data = mujoco.MjData(machine)
    for _ in range(5000):
        mujoco.mj_step(machine, data)
    ours, theirs = run["base_qd"][-1].reshape(2, 6), data.qvel.reshape(2, 6)
    assert np.abs(theirs[:, [0, 1, 5]]).max() > 0.4
    np.testing.assert_allclose(ours[:, [0, 1, 5]], theirs[:, [0, 1, 5]], atol=1e-2)
    place = run["base_q"][-1].reshape(2, 7)[:, :2]
    turn, lean = np.array([0.5, 0.7]), math.radians(30)
    first = [0.7 * math.cos(lean) - 0.1 * math.sin(lean), 0.7 * math.sin(lean) + 0.1 * math.cos(lean)]
    arm = place - [[1.0, 0.5], [0.3, 0.2]]
    field = np.array([first, [0.2, -0.1]]) + turn[:, None] * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
    np.testing.assert_allclose(ours[:, :2], field, atol=1e-4)


@pytest.mark.parametrize(
    ("given", "word"),
    [({"velocity": (1.0,)}, "velocity"), ({"command": math.nan}, "command"), ({"drive": "a\n"}, "drive")],
)
def test_surfaces_that_make_no_sense_are_refused(given, word):
    with pytest.raises(ValueError, match=word):
        Surface(**given)


def test_a_drive_has_one_command_and_a_name():
    points = vehicle().contacts
    odd = replace(points[0], surface=replace(points[0].surface, command=2.0))
    with pytest.raises(ValueError, match="drive 'left'"):
        compile_scene(replace(vehicle(), contacts=(odd, *points[1:])), ground=Ground())
    scene = compile_scene(vehicle(), ground=Ground())
    y = command_surface(scene, initial_state(scene), "right", 2.0)
    assert scene.state_view(y).surface_command.tolist() == [0.5, 2.0]
    with pytest.raises(ValueError, match="'left', 'right'"):
        command_surface(scene, y, "middle", 1.0)
    with pytest.raises(ValueError, match="command"):
        command_surface(scene, y, "left", math.inf)
    with pytest.raises(ValueError, match="drive of surfaces 'loop'"):
        simulate(scene, 0.1, switches=[(0.0, "loop", 1.0)])
