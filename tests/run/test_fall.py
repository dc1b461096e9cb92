"""A robot has fallen by its center of mass and its posture, whichever link is its root and however that is turned."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait.model import ContactPoint, Ground, Joint, Link, Model
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.simulate import initial_state, simulate, simulate_batch
from featherstone_gait.scene.compile import compile_scene
from featherstone_gait.scene.contact import standing_posture

pytestmark = pytest.mark.nojit

BALL = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)  # [kg m^2]
TALL = 0.8  # [m]
CORNERS = [(x, y) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]


def lift(root):
    """A foot of 1 kg that carries 3 kg on a column of 0.8 m, which slide down; the root is either of both."""
    foot, load = Link("foot", 1.0, (0.0, 0.0, 0.0), BALL), Link("load", 3.0, (0.0, 0.0, 0.0), BALL)
    contacts = tuple(ContactPoint("foot", (x, y, 0.0)) for x, y in CORNERS)
    down = root == "load"
    links = (load, foot) if down else (foot, load)
    xyz, axis = ((0.0, 0.0, -TALL), (0.0, 0.0, -1.0)) if down else ((0.0, 0.0, TALL), (0.0, 0.0, 1.0))
    joint = Joint("column", "prismatic", links[0].name, links[1].name, xyz=xyz, axis=axis, lower=-1.0, upper=1.0)
    return Model("lift", links, (joint,), "floating", contacts=contacts)


def fallen(scene, slide, tilt=0.0):
    """Whether it has fallen at once, the load so far from the top [m], all turned about y [rad]."""
    q = np.array([0.0, 0.0, 0.0, math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0, slide])
    q[2] = TALL + slide if scene.model.links[0].name == "load" else 0.0
    run = simulate(scene, scene.timestep, initial_state(scene, q))
    assert (run.status == "fell") == (run.end_time == 0.0)
    return run.status == "fell"


@pytest.mark.long
@pytest.mark.parametrize("root", ["foot", "load"])
def test_the_center_of_mass_tells_and_not_the_root(root):
    """It stands at 0.75 x 0.8 m, and is at 60 % of that when the load has come down by 0.32 m."""
    scene = compile_scene(lift(root), ground=Ground())
    assert scene.fall_height == pytest.approx(0.6 * 0.75 * TALL, rel=1e-12)
    assert [fallen(scene, slide) for slide in (0.0, -0.319, -0.321)] == [False, False, True]
    assert [fallen(scene, 0.0, tilt) for tilt in (0.77, -0.77, 0.8, -0.8)] == [False, False, True, True]
    deep = compile_scene(lift(root), ground=Ground(), fall_height=0.2)
    assert [fallen(deep, slide) for slide in (-0.63, -0.65)] == [False, True]


@pytest.mark.long
def test_a_robot_falls_no_more_where_that_is_off():
    scene = compile_scene(lift("load"), ground=Ground(), fall_height=-1.0, fall_tilt=math.pi)
    assert not fallen(scene, -0.7)
    assert not fallen(scene, 0.0, 3.1)


def turned_box(down):
    """A tall box whose long axis is one of its root's; `down` points to the end with the contacts."""
    down, size = np.array(down, dtype=float), np.where(np.array(down) != 0, 1.0, 0.2)
    inertia = (size @ size - size**2) / 12
    contacts = []
    for corner in CORNERS:
        point = 0.5 * down * size
        point[down == 0] = 0.5 * np.array(corner)
        contacts.append(ContactPoint("box", tuple(point)))
    link = Link("box", 1.0, (0.0, 0.0, 0.0), (inertia[0], 0.0, 0.0, inertia[1], 0.0, inertia[2]))
    return Model("box", (link,), (), "floating", contacts=tuple(contacts))


# Of each direction down in the root's frame the quaternion that stands it up.
HALF = math.sqrt(0.5)
STANDS = {
    (0, 0, -1): (1.0, 0.0, 0.0, 0.0),
    (-1, 0, 0): (HALF, 0.0, -HALF, 0.0),
    (1, 0, 0): (HALF, 0.0, HALF, 0.0),
    (0, -1, 0): (HALF, HALF, 0.0, 0.0),
    (0, 1, 0): (HALF, -HALF, 0.0, 0.0),
    (0, 0, 1): (0.0, 1.0, 0.0, 0.0),
}


@pytest.mark.parametrize("down", STANDS)
def test_a_root_mounted_turned_stands_with_its_own_axis_up(down):
    model = turned_box(down)
    height, up = standing_posture(model)
    assert (height, up) == (0.5, tuple(-float(x) for x in down))
    scene = compile_scene(model, ground=Ground(), integrator="implicit_euler", timestep=1e-3)
    statuses = {}
    for other, quaternion in STANDS.items():
        run = simulate(scene, scene.timestep, initial_state(scene, [0.0, 0.0, 0.5, *quaternion]))
        statuses[other] = run.status
    assert statuses.pop(down) == "ok"
    assert set(statuses.values()) == {"fell"}


def test_a_keyframe_says_how_a_robot_stands():
    """Lowered by half, and its root turned by a quarter about x."""
    model = lift("foot")
    low = replace(model, keyframes={"home": (0.0, 0.0, 0.4, HALF, HALF, 0.0, 0.0, -0.4)})
    height, up = standing_posture(low)
    assert up == pytest.approx((0.0, 1.0, 0.0), abs=1e-15)
    assert height == pytest.approx(0.2, rel=1e-12)  # lying, over the contacts at its side
    plain = replace(model, keyframes={"home": (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -0.4)})
    assert standing_posture(plain) == (pytest.approx(0.75 * 0.4), (0.0, 0.0, 1.0))


@pytest.mark.bounds
@pytest.mark.long
def test_lanes_fall_and_sink_as_one_alone_does():
    scene = compile_scene(load_robot("humanoid"), "mipsd", Ground(), "implicit_euler", 1e-3)
    states = [initial_state(scene) for _ in range(4)]
    for k, state in enumerate(states):
        state[scene.layout["base_q"] + 2] -= 0.04 * k
    alone = [simulate(scene, 0.01, state) for state in states]
    assert [run.status for run in alone] == ["ok", "too deep", "too deep", "fell"]
    for run, other in zip(simulate_batch(scene, 0.01, states), alone):
        assert (run.status, run.end_time, run.final.tobytes()) == (other.status, other.end_time, other.final.tobytes())
