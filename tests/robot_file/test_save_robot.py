"""What `save_robot` writes is the robot: MuJoCo reads it, it moves the same, and nothing is lost without a word."""

import math
import struct
from dataclasses import replace
from xml.etree import ElementTree

import mujoco
import numpy as np
import published
import pytest
from random_tree import random_states

from featherstone_gait import (
    ContactPoint,
    Controller,
    Gearbox,
    Ground,
    HeightField,
    Joint,
    Link,
    Model,
    RobotFileError,
    Servo,
    forward_dynamics,
    load_robot,
    save_robot,
)
from featherstone_gait.model import Mimic
from featherstone_gait.model.shapes import Box, Mesh, Shape, Sphere

BODY = (0.02, 0.001, 0.0, 0.03, -0.002, 0.025)  # an inertia [kg m^2]
POINT, FLAT = (0.0,) * 6, (0.01, 0.0, 0.0, 0.02, 0.0, 0.03)
IMPOSSIBLE = (0.001, 0.0, 0.0, 0.001, 0.0, 0.01)


def link(name, inertia=BODY, mass=1.0):
    return Link(name, mass, (0.02, -0.01, 0.1), inertia)


def joint(name, parent, child, type="continuous", **options):
    return Joint(name, type, parent, child, xyz=(0.1, 0.0, 0.2), rpy=(0.3, -0.2, 0.5), axis=(0.6, 0.0, 0.8), **options)


def pair(**options):
    """Two links and a hinge."""
    options = {"links": (link("a"), link("b")), "joints": (joint("j", "a", "b"),), **options}
    return Model("pair", **options)


def again(model, tmp_path, ground=None):
    """The robot as it is read from its MJCF."""
    save_robot(model, tmp_path / "m.xml", ground)
    return load_robot(tmp_path / "m.xml")


def remarks(tmp_path):
    """The comments of the MJCF."""
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    root = ElementTree.parse(tmp_path / "m.xml", parser).getroot()
    return "\n".join(e.text for e in root.iter() if e.tag is ElementTree.Comment)


def difference(model, back):
    """Largest difference of accelerations, by the largest; the joints are in the same order."""
    assert back.joint_names == model.joint_names
    q, qd, tau = random_states(model, 5, 4)
    before, after = (forward_dynamics(robot, q, qd, tau) for robot in (model, back))
    return np.abs(after - before).max() / np.abs(before).max()


# ------------------------------------------------------------------------------------------------ inertias


@pytest.mark.parametrize("welded", [BODY, IMPOSSIBLE])
def test_borne_weights_keep_the_dynamics(welded, tmp_path):
    """Links whose inertia is written together need one share."""
    links = [link("a"), link("b"), link("c", welded, 0.3)]
    links = [replace(each, gravity_compensation=0.4) for each in links]
    joints = (joint("j", "a", "b"), joint("weld", "b", "c", "fixed"))
    assert difference(Model("m", links, joints), again(Model("m", links, joints), tmp_path)) < 1e-12
    model = Model("m", [*links[:2], replace(links[2], gravity_compensation=1.0)], joints)
    if welded is IMPOSSIBLE:
        with pytest.raises(ValueError, match="gravity_compensation"):
            again(model, tmp_path)
    else:
        assert difference(model, again(model, tmp_path)) < 1e-12


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("welded", [POINT, IMPOSSIBLE, FLAT, (1e-9, 0.0, 0.0, 1e-9, 0.0, 1e-16)])
def test_links_fixed_together_keep_the_dynamics(welded, base, tmp_path):
    links = (link("a"), link("b"), link("c", welded, 0.3), link("d"))
    joints = (joint("j", "a", "b"), joint("weld", "b", "c", "fixed"), joint("k", "c", "d"))
    model = Model("welded", links, joints, base)
    assert difference(model, again(model, tmp_path)) < 1e-12


def test_an_inertia_without_mass_keeps_the_dynamics(tmp_path):
    model = pair(
        links=(link("a"), link("b"), Link("c", 0.0, (0.0,) * 3, BODY)),
        joints=(joint("j", "a", "b"), joint("weld", "b", "c", "fixed")),
    )
    assert difference(model, again(model, tmp_path)) < 1e-12


def test_a_massless_link_with_inertia_between_joints_is_refused(tmp_path):
    links = (link("a"), Link("b", 0.0, (0.0,) * 3, BODY), link("c"))
    model = Model("m", links, (joint("j", "a", "b"), joint("k", "b", "c")))
    with pytest.raises(ValueError, match="'b' moves without mass"):
        save_robot(model, tmp_path / "m.xml")


@pytest.mark.parametrize("turn", range(5, 10))
def test_a_flat_plate_is_written_whatever_its_rounding(turn, tmp_path):
    Q = np.linalg.qr(np.random.default_rng(turn).normal(size=(3, 3)))[0]
    J = (Q * (0.01, 0.02, 0.03)) @ Q.T
    plate = tuple(float(J[i]) for i in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    model = pair(links=(link("a"), link("b", plate)))
    assert difference(model, again(model, tmp_path)) < 1e-12


def test_a_point_mass_moves_the_same(tmp_path):
    model = pair(links=(link("a"), link("b", POINT)))
    assert difference(model, again(model, tmp_path)) < 1e-12
    assert "1e-15 kg m^2: b" in remarks(tmp_path)


def test_links_that_mujoco_takes_keep_their_own_inertia(tmp_path):
    links = (link("a"), link("b"), link("c", POINT))
    joints = (joint("j", "a", "b"), joint("weld", "b", "c", "fixed"))
    assert [one.mass for one in again(Model("m", links, joints), tmp_path).links] == [1.0, 1.0, 1.0]


def test_what_moves_with_an_inertia_that_no_body_has_is_refused(tmp_path):
    model = pair(links=(link("a"), link("b", IMPOSSIBLE)))
    with pytest.raises(ValueError, match=r"link 'b'.*0\.001, 0\.001, 0\.01 kg m\^2.*repair_inertia=True"):
        save_robot(model, tmp_path / "m.xml")
    assert list(tmp_path.iterdir()) == []


def test_a_repaired_inertia_is_written(tmp_path):
    save_robot(pair(links=(link("a"), link("b", IMPOSSIBLE))), tmp_path / "m.urdf")
    model = load_robot(tmp_path / "m.urdf", repair_inertia=True)
    assert difference(model, again(model, tmp_path)) < 1e-12


def test_a_fixed_base_may_have_any_inertia(tmp_path):
    model = pair(links=(link("a", IMPOSSIBLE), link("b")))
    assert difference(model, again(model, tmp_path)) < 1e-12
    assert "for no body has it: a" in remarks(tmp_path)


def robot(file):
    """A robot of the package example-robot-data."""
    return next(published.folder("example-robot-data").rglob(file))


@pytest.mark.filterwarnings("ignore::featherstone_gait.RobotFileWarning")
@pytest.mark.parametrize("file", ["bolt.urdf", "quadruped.urdf", "so101.urdf", "romeo_small.urdf"])
def test_published_robots_make_the_round_trip(file, tmp_path):
    model = load_robot(robot(file), repair_inertia=file == "romeo_small.urdf")
    back = again(model, tmp_path)
    order = [model.joint_names.index(name) for name in back.joint_names]
    q, qd, tau = random_states(model, 5, 4)
    before = forward_dynamics(model, q, qd, tau)[:, order]
    after = forward_dynamics(back, q[:, order], qd[:, order], tau[:, order])
    assert np.abs(after - before).max() < 1e-12 * np.abs(before).max()


@pytest.mark.filterwarnings("ignore::featherstone_gait.RobotFileWarning")
def test_a_published_robot_with_an_inertia_that_no_body_has_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"link 'RShoulderYawLink'.*repair_inertia=True"):
        save_robot(load_robot(robot("romeo_small.urdf")), tmp_path / "m.xml")


# ------------------------------------------------------------------------------------------------ meshes, shapes


def triangles(path, corners):
    """An STL in binary."""
    facets = [struct.pack("<12fH", 0.0, 0.0, 0.0, *(x for corner in facet for x in corner), 0) for facet in corners]
    path.write_bytes(b" " * 80 + struct.pack("<I", len(facets)) + b"".join(facets))
    return str(path)


def test_meshes_that_mujoco_cannot_read_are_left_out(tmp_path):
    (tmp_path / "text.stl").write_text("solid text\nendsolid text\n")
    (tmp_path / "nan.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n")
    files = [str(tmp_path / name) for name in ("absent--of.stl", "text.stl", "nan.obj")]
    model = pair(shapes=tuple(Shape("b", Mesh(file)) for file in files))
    assert again(model, tmp_path).shapes == ()
    for name in ("absent- -of.stl", "text.stl", "nan.obj"):
        assert remarks(tmp_path).count(name) == 2  # where it was, and at the head


def test_a_mesh_of_no_volume_is_kept(tmp_path):
    O, X, Y, Z = np.vstack([np.zeros(3), np.eye(3) * 1e-6]).tolist()
    file = triangles(tmp_path / "small.stl", [(O, Y, X), (O, X, Z), (O, Z, Y), (X, Y, Z)])
    back = again(pair(shapes=(Shape("b", Mesh(file)),)), tmp_path)
    assert len(back.shapes) == 1


def test_a_shape_without_extent_is_left_out(tmp_path):
    shapes = (Shape("b", Sphere(0.0), name="dot"), Shape("b", Box((0.1, 0.0, 0.2)), name="sheet"))
    assert again(pair(shapes=shapes), tmp_path).shapes == ()
    assert "left out dot: Sphere" in remarks(tmp_path)
    assert "left out sheet: Box" in remarks(tmp_path)


# ------------------------------------------------------------------------------------------------ names


@pytest.mark.parametrize("points", [(), (ContactPoint("b", (0.0, 0.0, 0.0)),)])
def test_names_that_mujoco_has_for_others_are_lengthened(points, tmp_path):
    names = ("same", "same", "contact0", "floor", "")
    model = pair(shapes=tuple(Shape("b", Sphere(0.1), name=name) for name in names), contacts=points)
    save_robot(model, tmp_path / "m.xml", Ground())
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    written = [m.geom(k).name for k in range(m.ngeom)]
    rest = ["shape4", "contact0_"] if points else [""]
    assert written == ["floor", "same", "same_", "contact0", "floor_", *rest]


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_a_link_may_be_called_world(base, tmp_path):
    links = (link("a"), link("world"), link("world_"))
    model = Model("m", links, (joint("j", "a", "world"), joint("k", "world", "world_")), base)
    back = again(model, tmp_path)
    assert difference(model, back) < 1e-12
    assert {"world__", "world_"} <= {one.name for one in back.links}
    assert "link 'world' is called 'world__'" in remarks(tmp_path)


def test_hyphens_of_names_make_no_malformed_comment(tmp_path):
    model = pair(joints=(joint("j---1-", "a", "b"),), locked={"j---1-": 0.2})
    again(model, tmp_path)
    assert "j- - -1-" in remarks(tmp_path)


# ------------------------------------------------------------------------------------------------ joints


def test_what_follows_a_locked_joint_is_welded_with_it(tmp_path):
    links = (link("a"), link("b"), link("c"), link("d"))
    follower = joint("k", "b", "c", mimic=Mimic("j", 2.0, 0.1))
    model = Model("m", links, (joint("j", "a", "b"), follower, joint("i", "c", "d")), locked={"j": 0.2})
    back = again(model, tmp_path)
    assert back.joint_names == ("i",)
    assert difference(model, back) < 1e-12


@pytest.mark.parametrize("effort", [0.0, 5.0, math.inf])
def test_the_effort_of_a_joint_is_kept(effort, tmp_path):
    back = again(pair(joints=(joint("j", "a", "b", effort=effort),)), tmp_path)
    assert back.joints[0].effort == pytest.approx(effort, abs=1e-300)
    assert ("effort of 0" in remarks(tmp_path)) == (effort == 0)


SPIN = (Link("a", 0.0, (0.0,) * 3, (0.0,) * 6), Link("b", 1.0, (0.0,) * 3, (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)))


def accelerations(servo, tmp_path):
    """MuJoCo's acceleration [rad/s^2] of a flywheel of 1 kg m^2 at rest under ctrl 1, and at 1 rad/s under 0."""
    wheel = Joint("j", "continuous", "a", "b", damping=0.3)
    save_robot(Model("m", SPIN, (wheel,), servos={"j": servo}), tmp_path / "m.xml")
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    m.dof_frictionloss[:] = 0.0  # which is looked at in the file
    d = mujoco.MjData(m)
    d.ctrl[:] = 1.0
    mujoco.mj_forward(m, d)
    driven = d.qacc[0]
    d.ctrl[:], d.qvel[:] = 0.0, 1.0
    mujoco.mj_forward(m, d)
    return m, driven, d.qacc[0]


@pytest.mark.parametrize("law", ["pd", "pd_clamped"])
def test_a_pd_servo_has_its_rotor_and_friction(law, tmp_path):
    gear = Gearbox(10.0, rotor_inertia=0.02, rotor_damping=0.005)
    servo = Servo(Controller(law, Kp=6.0, Kd=0.9), gear, viscous_friction=0.6, coulomb_friction=0.04)
    _, driven, slowed = accelerations(servo, tmp_path)
    assert 'frictionloss="0.04"' in (tmp_path / "m.xml").read_text()
    assert driven == pytest.approx(6.0 / 3.0, rel=1e-12)
    assert slowed == pytest.approx(-(0.9 + 0.6 + 0.5 + 0.3) / 3.0, rel=1e-12)
    assert "the rotor's inertia and the friction stand with the joint" in remarks(tmp_path)


def test_a_servo_of_speeds_is_an_actuator_of_speeds(tmp_path):
    """Its motor gives K/R (Kp (u - w) - K w), K = 10 * 0.01, besides the damping that it had."""
    gear = Gearbox(10.0, rotor_inertia=0.02, rotor_damping=0.005)
    motor = {"resistance": 2.0, "motor_constant": 0.01, "voltage_limit": 12.0}
    servo = Servo(Controller("pid_speed", Kp=1.0), gear, **motor, viscous_friction=0.4)
    m, _, slowed = accelerations(servo, tmp_path)
    assert m.nu == 1
    assert slowed == pytest.approx(-(0.4 + 0.5 + 0.3 + 0.05 * (1.0 + 0.1)) / 3.0, rel=1e-12)
    assert m.actuator_forcerange[0].tolist() == pytest.approx([-0.6, 0.6])  # K V / R


# ------------------------------------------------------------------------------------------------ the ground


def heights(ground, points, tmp_path):
    """Height [m] of MuJoCo's ground at each x, y."""
    save_robot(pair(base="floating"), tmp_path / "m.xml", ground)
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    d, geom = mujoco.MjData(m), np.zeros(1, np.int32)
    mujoco.mj_forward(m, d)
    down = np.array([0.0, 0.0, -1.0])
    return [9.0 - mujoco.mj_ray(m, d, np.array([x, y, 9.0]), down, None, 1, -1, geom) for x, y in points]


def test_the_written_slope_has_its_heading(tmp_path):
    ground = Ground(slope=0.2, heading=2.5, height=0.3)
    points = [(1.0, 0.0), (0.0, 1.0), (-0.7, 0.4)]
    rise = [0.3 + math.tan(0.2) * (x * math.cos(2.5) + y * math.sin(2.5)) for x, y in points]
    assert heights(ground, points, tmp_path) == pytest.approx(rise, abs=1e-12)


@pytest.mark.parametrize("scale", [0.4, 0.0])
def test_the_written_height_field_is_the_ground(scale, tmp_path):
    nodes = scale * np.random.default_rng(2).normal(size=(3, 4))
    field = HeightField(nodes, spacing=(0.5, 0.3), origin=(2.0, -1.0))
    inside = [(i, j) for i in range(3) for j in range(4)]
    points = [(2.0 + 0.5 * i + 1e-9 * (1 - i), -1.0 + 0.3 * j + 1e-9 * (1.5 - j)) for i, j in inside]
    assert heights(Ground(height=0.2, field=field), points, tmp_path) == pytest.approx(
        [0.2 + nodes[at] for at in inside], abs=1e-6
    )
    assert "ends at the edge of its field" in remarks(tmp_path)


# ------------------------------------------------------------------------------------------------ keyframes


def fork(**options):
    """A robot whose joints MJCF lists in another order."""
    links = tuple(link(name) for name in "abcd")
    joints = (joint("left", "a", "b"), joint("right", "a", "c"), joint("tip", "b", "d"))
    return Model("fork", links, joints, **options)


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_keyframes_beside_a_urdf_hold_for_the_mjcf_of_the_same_stem(base, tmp_path):
    free = (0.1, 0.2, 0.3, 0.6, 0.0, 0.8, 0.0) if base == "floating" else ()
    model = fork(base=base, keyframes={"a pose": (*free, 1.0, 2.0, 3.0)})
    save_robot(model, tmp_path / "m.urdf")
    assert load_robot(tmp_path / "m.urdf").keyframes == model.keyframes
    back = again(model, tmp_path)
    assert back.joint_names == ("left", "tip", "right")
    assert back.keyframes == {"a pose": (*free, 1.0, 3.0, 2.0)}


def test_keyframes_in_a_toml_may_be_lists_or_tables(tmp_path):
    save_robot(fork(), tmp_path / "m.urdf")
    (tmp_path / "m.toml").write_text("[keyframes]\nlist = [1.0, 2.0, 3.0]\ntable.joints = {tip = 4}")
    assert load_robot(tmp_path / "m.urdf").keyframes == {"list": (1.0, 2.0, 3.0), "table": (0.0, 0.0, 4.0)}


@pytest.mark.parametrize(
    ("toml", "word"),
    [
        ("joints.knee = 1.0", "home.joints: unknown key 'knee'"),
        ("joints.tip = 'up'", "home.joints.tip is 'up'"),
        ("joints = 1.0", "home.joints is 1.0"),
        ("base = [0.0, 1.0]", "home.base has 2 numbers"),
        ("pose = 1.0", "home: unknown key 'pose'"),
    ],
)
def test_a_wrong_keyframe_in_the_toml_is_refused(toml, word, tmp_path):
    save_robot(fork(), tmp_path / "m.urdf")
    (tmp_path / "m.toml").write_text(f"[keyframes.home]\n{toml}")
    with pytest.raises(RobotFileError, match=word):
        load_robot(tmp_path / "m.urdf")
