"""Collision shapes: what of them touches the ground, the hulls of meshes, and the feet of a robot."""

import math
import os
import re
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from featherstone_gait import (
    Box,
    Capsule,
    ContactPoint,
    Cylinder,
    Hull,
    Joint,
    Link,
    Mesh,
    Model,
    RobotFileError,
    RobotFileWarning,
    Shape,
    Sphere,
    center_of_mass,
    contact_points,
    contact_positions,
    forward_kinematics,
    load_robot,
    nearest_posture,
    save_robot,
    with_contacts,
)
from featherstone_gait.base.rotation import rotation_from_rpy
from featherstone_gait.geometry import mesh as mesh_files
from featherstone_gait.geometry.contact_choice import corner_error, lowest_levels
from featherstone_gait.geometry.hull import MOST_CORNERS, corners_of, sides
from featherstone_gait.model import Mimic
from featherstone_gait.model.rest_posture import nearest_positions
from featherstone_gait.model.tree_checks import check_locked
from featherstone_gait.robot_file.source import robots_folder
from featherstone_gait.walking.zero_moment_point import polygon_margin, support_polygon

BODY = (1.0, (0.0, 0.0, 0.0), (1e-2, 0.0, 0.0, 1e-2, 0.0, 1e-2))  # mass, center, inertia
CUBE = [(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]


def body(*geometries, **place):
    """A free body of shapes."""
    shapes = tuple(Shape("body", geometry, **place) for geometry in geometries)
    return Model("body", (Link("body", *BODY),), (), "floating", shapes=shapes)


def random_state(rng):
    """A base anywhere, turned in any way."""
    turn = rng.normal(size=4)
    return np.concatenate([rng.normal(size=3), turn / np.linalg.norm(turn)])


def ball(n, radius=0.02):
    """Points on a sphere."""
    x = np.random.default_rng(1).normal(size=(n, 3))
    return radius * x / np.linalg.norm(x, axis=1)[:, None]


# How far each shape reaches along a direction u in its frame, from its center: its support function.
REACH = [
    (Sphere(0.3), lambda u: 0.3 * math.hypot(*u)),
    (Capsule(0.1, 0.5), lambda u: 0.1 * math.hypot(*u) + 0.25 * abs(u[2])),
    # its edges are rounded over a hundredth of its radius
    (Cylinder(0.2, 0.5), lambda u: 0.2 * math.hypot(u[0], u[1], 0.01 * u[2]) + (0.25 - 0.01 * 0.2) * abs(u[2])),
    (Box((0.1, 0.2, 0.3)), lambda u: 0.05 * abs(u[0]) + 0.1 * abs(u[1]) + 0.15 * abs(u[2])),
    (Hull(tuple(CUBE)), lambda u: sum(map(abs, u))),
]


@pytest.mark.parametrize(("geometry", "reach"), REACH, ids=lambda x: type(x).__name__)
def test_the_lowest_contact_point_is_the_lowest_point_of_the_shape(geometry, reach):
    """However the shape lies in its link, and the link in the world."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        xyz, rpy = (tuple(rng.uniform(-2.0, 2.0, 3).tolist()) for _ in range(2))
        robot, q = body(geometry, xyz=xyz, rpy=rpy), random_state(rng)
        poses = forward_kinematics(robot, q)
        center = poses.position[0] + poses.rotation[0] @ xyz
        down = (poses.rotation[0] @ rotation_from_rpy(rpy)).T @ (0.0, 0.0, -1.0)
        levels = lowest_levels(robot, contact_points(robot.shapes), poses)
        assert levels.min() == pytest.approx(center[2] - reach(down), abs=1e-12)


def test_shapes_become_as_many_points_as_they_need():
    counts = [len(contact_points([Shape("body", geometry)])) for geometry, _ in REACH]
    assert counts == [1, 2, 2, 8, 8]


# --- hulls ---


def test_a_hull_has_no_points_inside():
    inside = np.random.default_rng(0).uniform(-0.9, 0.9, (500, 3))
    corners = corners_of(np.vstack([inside, CUBE, CUBE]))
    assert sorted(map(tuple, corners.points.tolist())) == sorted(CUBE)
    assert corners.error == 0.0


def test_flat_and_pointlike_hulls_keep_their_corners():
    turn = rotation_from_rpy((0.3, -0.7, 1.1))
    square = np.array([(x, y, 0.0) for x in (0.0, 0.5, 1.0) for y in (0.0, 0.5, 1.0)]) @ turn.T
    line = np.outer(np.linspace(0.0, 1.0, 7), turn[0])
    assert [len(corners_of(points).points) for points in (square, line, line[:1], line[[2, 2]])] == [4, 2, 1, 1]
    assert [[len(part) for part in sides(corners_of(points).points)] for points in (square, line)] == [[2, 2], [0, 1]]
    across = sides(corners_of(square).points).normals
    assert np.abs(across @ turn) == pytest.approx(np.array([[0.0, 0.0, 1.0]] * 2), abs=1e-12)


def test_a_cube_has_six_faces_and_its_edges_three_directions():
    normals, edges = sides(np.array(CUBE))
    assert sorted(map(tuple, normals.tolist())) == sorted(map(tuple, np.vstack([np.eye(3), -np.eye(3)]).tolist()))
    assert set(map(tuple, np.eye(3).tolist())) <= set(map(tuple, edges.tolist()))


@pytest.mark.parametrize("points", [ball(3000), ball(400) * (5.0, 1.0, 0.2)], ids=["ball", "flattened"])
def test_a_thinned_hull_misses_what_it_says(points):
    """The distance of nested convex bodies is the largest difference of how far they reach in any direction."""
    corners = corners_of(points)
    assert len(corners.points) == MOST_CORNERS
    assert set(map(tuple, corners.points.tolist())) <= set(map(tuple, points.tolist()))
    directions = ball(20_000, 1.0)
    parts = np.split(directions.T, 4, axis=1)
    missed = max(float(((points @ d).max(axis=0) - (corners.points @ d).max(axis=0)).max()) for d in parts)
    assert 0.9 * corners.error < missed <= corners.error * (1.0 + 1e-12)


def test_thinning_does_not_depend_on_the_order_of_the_points():
    points = ball(500)
    again = corners_of(points[::-1])
    assert sorted(map(tuple, again.points.tolist())) == sorted(map(tuple, corners_of(points).points.tolist()))


# --- mesh files ---


def box_file(folder, kind, size=(0.2, 0.4, 0.6)):
    """A box as a mesh file, its center at (1, 2, 3)."""
    trimesh = pytest.importorskip("trimesh")
    if kind == ".dae":
        pytest.importorskip("collada")
    mesh = trimesh.creation.box(size)
    mesh.apply_translation((1.0, 2.0, 3.0))
    path = folder / f"box{kind}"
    data = mesh.export(file_type=kind[1:])
    if kind == ".gltf":  # with its numbers in a file beside it
        for name, content in data.items():
            (folder / name).write_bytes(content)
        data = data["model.gltf"]
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def extent(path, **options):
    corners = mesh_files.mesh_corners(Mesh(str(path), **options)).points
    return corners.min(axis=0), corners.max(axis=0)


@pytest.mark.parametrize("kind", mesh_files.KINDS)
def test_a_mesh_has_the_corners_of_its_file(tmp_path, kind):
    path = box_file(tmp_path, kind)
    assert len(contact_points([Shape("body", Mesh(str(path)))])) == 8
    lower, upper = extent(path)
    assert lower == pytest.approx([0.9, 1.8, 2.7], abs=1e-6)  # STL holds 32 bits
    assert upper == pytest.approx([1.1, 2.2, 3.3], abs=1e-6)
    assert extent(path, scale=(1.0, 0.1, 1e-3))[1] == pytest.approx([1.1, 0.22, 3.3e-3], rel=1e-6)


@pytest.mark.parametrize("axis", ["X_UP", "Y_UP", "Z_UP"])
def test_a_dae_is_scaled_by_its_unit_and_not_turned(tmp_path, axis):
    path = box_file(tmp_path, ".dae")
    text = re.sub(r"<(unit|up_axis)\b.*?(/>|</\1>)", "", path.read_text("utf-8"))
    stated = f'<unit name="inch" meter="0.0254"/><up_axis>{axis}</up_axis></asset>'
    path.write_text(text.replace("</asset>", stated), "utf-8")
    assert extent(path)[1] == pytest.approx([1.1 * 0.0254, 2.2 * 0.0254, 3.3 * 0.0254])
    coal = pytest.importorskip("coal")
    seen = coal.MeshLoader().load(str(path), np.ones(3)).vertices()
    assert extent(path)[1] == pytest.approx(0.0254 * seen.max(axis=0), rel=1e-6)  # which passes over the unit too


def test_a_dae_with_a_broken_material_keeps_its_triangles(tmp_path):
    path = box_file(tmp_path, ".dae")
    text = path.read_text("utf-8")
    assert "<library_effects>" in text
    path.write_text(text.replace("<library_effects>", "<library_effects><effect id='x'><newparam/></effect>"), "utf-8")
    assert len(mesh_files.mesh_corners(Mesh(str(path))).points) == 8


def test_a_mesh_is_read_again_when_its_file_has_changed(tmp_path):
    path = box_file(tmp_path, ".stl")
    before = mesh_files.mesh_hull(Mesh(str(path)))
    assert mesh_files.mesh_hull(Mesh(str(path))) is before
    box_file(tmp_path, ".stl", (2.0, 2.0, 2.0))
    os.utime(path, ns=(0, 0))
    assert extent(path)[1] == pytest.approx([2.0, 3.0, 4.0])


DAMAGED = [
    (".stl", b"solid nothing\nendsolid nothing\n"),
    (".stl", b"\x00" * 84),
    (".stl", b"\xff" * 200),
    (".obj", b"v 0 0\nf 1 2 3\n"),
    (".obj", b""),
    (".dae", b"<COLLADA>"),
    (".dae", b"<COLLADA/>"),
    (".dae", b'<!DOCTYPE x [<!ENTITY e "e">]><COLLADA>&e;</COLLADA>'),
    (".dae", b'<COLLADA><asset><unit meter="0"/></asset></COLLADA>'),
    (".ply", b"ply\n"),
    (".gltf", b'{"nodes": [{"mesh": 0, "children": [0]}], "scenes": [{"nodes": [0]}]}'),
    (".gltf", b'{"accessors": [{"count": 1000000000, "componentType": 5126, "type": "VEC3"}]}'),  # 12 GB of nothing
    (".gltf", b'{"extensionsRequired": ["KHR_draco_mesh_compression"]}'),
    (".gltf", b"[" * 100_000),
    (".gltf", b"[]"),
    (".glb", b"glTF" + b"\xff" * 30),
]


@pytest.mark.parametrize(("kind", "data"), DAMAGED)
def test_a_damaged_mesh_is_refused_by_name(tmp_path, kind, data):
    pytest.importorskip("trimesh")
    pytest.importorskip("collada")
    path = tmp_path / f"damaged{kind}"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=rf"damaged\{kind}: .*(export|convert|correct)"):
        contact_points([Shape("body", Mesh(str(path)))])


@pytest.mark.parametrize("kind", mesh_files.KINDS)
def test_a_mesh_damaged_at_random_is_read_or_refused_by_name(tmp_path, kind):
    rng = np.random.default_rng(0)
    data, path = box_file(tmp_path, kind).read_bytes(), tmp_path / f"damaged{kind}"
    refused = []
    for _ in range(100):
        damaged = bytearray(data)
        at, many = int(rng.integers(len(data))), int(rng.integers(1, 40))
        damaged[at : at + many] = rng.bytes(int(rng.integers(0, 40)))
        path.write_bytes(damaged)
        try:
            mesh_files.mesh_points(path)
        except ValueError as error:
            refused.append(str(error))
    assert len(refused) > 10
    assert all(str(path) in text for text in refused)


def test_a_mesh_that_is_missing_or_too_large_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "part.stl"
    with pytest.raises(ValueError, match=r"part\.stl: there is no such mesh"):
        mesh_files.mesh_corners(Mesh(str(path)))
    path.write_bytes(b"x" * 11)
    monkeypatch.setattr(mesh_files, "MAX_BYTES", 10)
    with pytest.raises(ValueError, match=r"part\.stl: has 11 bytes; at most 10"):
        mesh_files.mesh_corners(Mesh(str(path)))


def test_without_the_reader_the_message_says_what_to_install(tmp_path, monkeypatch):
    path = tmp_path / "part.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ImportError, match=r"pip install featherstone-gait\[mesh\]"):
        mesh_files.mesh_corners(Mesh(str(path)))


# --- postures ---


def test_the_nearest_posture_keeps_limits_and_couplings():
    joints = (
        Joint("free", "continuous", "a", "b"),
        Joint("bent", "revolute", "b", "c", lower=-2.0, upper=-0.5),
        Joint("slide", "prismatic", "c", "d", lower=0.1, upper=0.2),
        Joint("weld", "fixed", "d", "e"),
        Joint("lead", "revolute", "e", "f", lower=-1.0, upper=1.0),
        Joint("follow", "revolute", "f", "g", lower=-3.0, upper=-0.8, mimic=Mimic("lead", -2.0, 0.2)),
        Joint("last", "revolute", "g", "h", lower=-9.0, upper=9.0, mimic=Mimic("follow", 3.0, 1.0)),
        Joint("held", "revolute", "h", "i", lower=-1.0, upper=1.0, mimic=Mimic("weld", 1.0, 0.25)),
    )
    at = nearest_positions(joints)
    assert list(at) == [joint.name for joint in joints if joint.type != "fixed"]
    assert [at[name] for name in ("free", "bent", "slide", "held")] == [0.0, -0.5, 0.1, 0.25]
    assert [at[name] for name in ("lead", "follow", "last")] == pytest.approx([0.5, -0.8, -1.4])
    assert nearest_positions(joints, {"lead": 0.9})["follow"] == pytest.approx(-1.6)
    check_locked(joints, at)  # within the limits to the last bit
    links = tuple(Link(name, *BODY) for name in "abcdefghi")
    robot = Model("chain", links, joints, "floating", locked={"bent": -1.0})
    assert nearest_posture(robot)[:7].tolist() == [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    assert nearest_posture(robot)[7:] == pytest.approx([0.0, 0.1, 0.5, -0.8, -1.4])  # "held" has no coordinate


# --- the choice ---


def boxes_of(urdf):
    """The collision boxes of a URDF."""
    for link in ElementTree.parse(urdf).getroot().iterfind("link"):
        for collision in link.iterfind("collision"):
            xyz, size = (
                tuple(map(float, collision.find(path).get(name).split()))
                for path, name in (("origin", "xyz"), ("geometry/box", "size"))
            )
            yield Shape(link.get("name"), Box(size), xyz)


@pytest.fixture(scope="module")
def humanoid():
    """With the boxes of its file, and no contact points."""
    shapes = tuple(boxes_of(robots_folder() / "humanoid" / "humanoid.urdf"))
    return replace(load_robot("humanoid"), shapes=shapes, contacts=())


def test_the_boxes_of_the_humanoid_are_those_of_its_inertias(humanoid):
    """Uniform boxes: ixx = m (y^2 + z^2) / 12."""
    boxes = {shape.link: shape for shape in humanoid.shapes}
    assert boxes.keys() == {link.name for link in humanoid.links}
    for link in humanoid.links:
        x, y, z = boxes[link.name].geometry.size
        moments = [link.mass * (a * a + b * b) / 12.0 for a, b in ((y, z), (x, z), (x, y))]
        assert [link.inertia[k] for k in (0, 3, 5)] == pytest.approx(moments, rel=1e-8)
        assert boxes[link.name].xyz == link.center_of_mass


def test_the_feet_of_the_humanoid_are_the_corners_of_its_soles(humanoid):
    """Those typed into its TOML."""
    found = {(point.link, *np.round(point.position, 12).tolist()) for point in with_contacts(humanoid, "feet").contacts}
    assert found == {(point.link, *point.position) for point in load_robot("humanoid").contacts}


def test_links_are_chosen_by_name_and_all_at_once(humanoid):
    assert len(with_contacts(humanoid, "all").contacts) == 8 * len(humanoid.links)
    hands = with_contacts(humanoid, ["left_forearm", "right_forearm"]).contacts
    assert {point.link for point in hands} == {"left_forearm", "right_forearm"}
    assert len(hands) == 16


CHOICES = [
    ("toes", r"contacts is 'toes'; expected 'all', 'feet' or a list"),
    (["left_toe"], "there is no link 'left_toe'; use some of trunk, "),
    (["head"], "link 'head' has no collision shape"),
    ([], "names no link"),
]


@pytest.mark.parametrize(("choice", "says"), CHOICES)
def test_a_choice_of_nothing_is_refused(humanoid, choice, says):
    headless = replace(humanoid, shapes=tuple(shape for shape in humanoid.shapes if shape.link != "head"))
    with pytest.raises(ValueError, match=says):
        with_contacts(headless, choice)


def test_without_shapes_there_is_nothing_to_choose():
    with pytest.raises(RobotFileError, match=r"arm7\.urdf: contacts='feet': arm7: .* no link has a collision shape"):
        load_robot("arm7", contacts="feet")


def test_what_is_fixed_to_a_foot_or_moves_before_it_does_not_hide_it():
    """A box with a sole at -0.42, a sensor fixed on top of it and a toe that moves, as low as the sole."""
    links = [Link(name, *BODY) for name in ("trunk", "foot", "sensor", "toe")]
    joints = (
        Joint("hip", "revolute", "trunk", "foot", (0.0, 0.0, -0.4), axis=(0.0, 1.0, 0.0), lower=-1.0, upper=1.0),
        Joint("weld", "fixed", "foot", "sensor", (0.0, 0.0, 0.03)),
        Joint("ball", "revolute", "foot", "toe", (0.1, 0.0, 0.0), axis=(0.0, 1.0, 0.0), lower=-1.0, upper=1.0),
    )
    foot, sensor = Shape("foot", Box((0.2, 0.1, 0.04))), Shape("sensor", Box((0.02, 0.02, 0.02)))
    toe, trunk = Shape("toe", Box((0.05, 0.1, 0.04)), (0.03, 0.0, 0.0)), Shape("trunk", Box((0.1, 0.1, 0.1)))
    robot = Model("hopper", tuple(links), joints, "floating", shapes=(trunk, foot, sensor, toe))
    for locked in ({}, {"hip": 0.0, "ball": 0.0}):
        found = with_contacts(replace(robot, locked=locked), "feet").contacts
        assert {point.link for point in found if point.load_bearing} == {"foot", "toe"}
        assert min(point.position[2] for point in found if point.link == "foot") == -0.02


def test_shapes_of_a_trunk_alone_are_no_feet():
    links = (Link("trunk", *BODY), Link("leg", *BODY))
    joint = Joint("hip", "revolute", "trunk", "leg", (0.0, 0.0, -0.5), lower=-1.0, upper=1.0)
    model = Model("bust", links, (joint,), "floating", shapes=(Shape("trunk", Box((0.2, 0.2, 0.2))),))
    with pytest.raises(ValueError, match=r"link 'leg' lies 0\.4 m below the lowest collision shape"):
        with_contacts(model, "feet")
    with pytest.raises(ValueError, match="there is no link 'arm'"):
        replace(model, shapes=(Shape("arm", Sphere(0.1)),))
    with pytest.raises(ValueError, match="contacts is 3"):
        with_contacts(model, 3)


def with_upright_soles():
    """A biped whose soles stand upright on their heels at zero, and the posture in which they lie flat."""
    sole = Box((0.04, 0.06, 0.2))
    links = tuple(Link(name, *BODY) for name in ("trunk", "left", "right"))
    joints = tuple(
        Joint(f"{side}_ankle", "revolute", "trunk", side, (0.0, y, -0.5), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), -2.0, 2.0)
        for side, y in (("left", 0.1), ("right", -0.1))
    )
    shapes = (Shape("trunk", Box((0.1, 0.3, 0.4))), *(Shape(side, sole) for side in ("left", "right")))
    standing = (0.0, 0.0, 0.52, 1.0, 0.0, 0.0, 0.0, math.pi / 2, math.pi / 2)
    return Model("biped", links, joints, "floating", shapes=shapes), standing


@pytest.mark.parametrize("keyframe", ["home", "stand"])
def test_soles_are_chosen_as_the_robot_stands(keyframe):
    """All of each sole carries the robot in the keyframe."""
    robot, standing = with_upright_soles()
    robot = with_contacts(replace(robot, keyframes={keyframe: standing}), "feet")
    assert robot.notes == ()
    found = robot.contacts
    at = contact_positions(robot, np.array(standing))
    lowest = {tuple(np.round(x, 9) + 0.0) for x in at if abs(x[2]) < 1e-9}
    assert lowest == {(x, y + z, 0.0) for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.03, 0.03)}
    assert all(point.load_bearing == (abs(x[2]) < 1e-9) for point, x in zip(found, at))


def test_soles_that_stand_upright_at_rest_are_doubted(tmp_path):
    robot, _ = with_upright_soles()
    notes = with_contacts(robot, "feet").notes
    assert [side in note for side, note in zip(("'left'", "'right'"), notes, strict=True)] == [True, True]
    save_robot(robot, tmp_path / "biped.urdf")
    with pytest.warns(RobotFileWarning, match=r"biped\.urdf: contacts='feet': .* link '(left|right)'"):
        load_robot(tmp_path / "biped.urdf", contacts="feet")
    with pytest.raises(RobotFileError, match="keyframe 'stand'"):
        load_robot(tmp_path / "biped.urdf", contacts="feet", strict=True)


def on_soles_of(geometry, places):
    """The biped with upright soles on shapes (of the feet alone) at these places of the feet."""
    robot, standing = with_upright_soles()
    shapes = tuple(Shape(side, geometry, place) for side in ("left", "right") for place in places)
    return replace(robot, shapes=shapes), standing


@pytest.mark.parametrize("kind", ["box", "spheres"])
@pytest.mark.parametrize("keyframe", ["knees_bent", "Standing"])
def test_a_keyframe_of_another_name_that_has_larger_soles_is_doubted(kind, keyframe):
    """The heels of two upright soles, far apart, look like feet; not in the keyframe where the soles lie flat."""
    box, ball = Box((0.04, 0.06, 0.2)), Sphere(0.02)
    corners = [(0.0, y, z) for y in (-0.03, 0.03) for z in (-0.1, 0.1)]
    robot, standing = on_soles_of(box, [(0.0, 0.0, 0.0)]) if kind == "box" else on_soles_of(ball, corners)
    robot = replace(robot, joints=tuple(replace(j, xyz=(3.0 * j.xyz[1], *j.xyz[1:])) for j in robot.joints))
    (note,) = with_contacts(replace(robot, keyframes={keyframe: standing}), "feet").notes
    assert repr(keyframe) in note
    assert not with_contacts(replace(robot, keyframes={"stand": standing, keyframe: standing}), "feet").notes
    flat = replace(robot, keyframes={"prone": (*standing[:7], 0.0, 0.0)})
    assert not with_contacts(flat, "feet").notes


def test_the_size_of_a_robot_whose_feet_alone_have_shapes_is_not_that_of_its_feet():
    """Upright soles 4 cm thick span less than a tenth of half a meter, and a foot 3 cm higher is a foot."""
    robot, _ = on_soles_of(Box((0.04, 0.06, 0.2)), [(0.0, 0.0, 0.0)])
    assert len(with_contacts(robot, "feet").notes) == 2
    left, right = robot.joints
    raised = replace(robot, joints=(replace(left, xyz=(0.0, 0.1, -0.47)), right))
    assert {point.link for point in with_contacts(raised, "feet").contacts} == {"left", "right"}


def test_a_robot_that_lies_on_its_belly_has_no_feet():
    links = (Link("trunk", *BODY), Link("leg", *BODY))
    joint = Joint("hip", "revolute", "trunk", "leg", (0.5, 0.0, 0.0), lower=-1.0, upper=1.0)
    shapes = (Shape("trunk", Box((1.0, 1.0, 1.0))), Shape("leg", Sphere(0.1), (1.0, 0.0, 0.0)))
    with pytest.raises(ValueError, match="no link at an end of the robot comes within 10% of its height"):
        with_contacts(Model("seal", links, (joint,), "floating", shapes=shapes), "feet")


def quadruped(foot):
    """Four legs of a shank, the foot fixed to it; the knees bend, for they may not be straight."""
    links, joints, shapes = [Link("trunk", *BODY)], [], [Shape("trunk", Box((0.4, 0.2, 0.1)))]
    for name, x, y in (("fl", 0.2, 0.1), ("fr", 0.2, -0.1), ("hl", -0.2, 0.1), ("hr", -0.2, -0.1)):
        parts = [f"{name}_{part}" for part in ("thigh", "shank", "foot")]
        links += [Link(part, *BODY) for part in parts]
        swing, bend = (dict(axis=(0.0, 1.0, 0.0), lower=a, upper=b) for a, b in ((0.4, 2.0), (-2.5, -0.8)))
        joints += [
            Joint(f"{name}_hip", "revolute", "trunk", parts[0], (x, y, 0.0), **swing),
            Joint(f"{name}_knee", "revolute", *parts[:2], (0.0, 0.0, -0.2), **bend),
            Joint(f"{name}_ankle", "fixed", *parts[1:], (0.0, 0.0, -0.2)),
        ]
        shapes += [Shape(part, Box((0.03, 0.03, 0.2)), (0.0, 0.0, -0.1)) for part in parts[:2]]
        shapes += [Shape(parts[2], foot)]
    return Model("dog", tuple(links), tuple(joints), "floating", shapes=tuple(shapes))


@pytest.mark.parametrize("foot", [Sphere(0.02), Hull(tuple(map(tuple, ball(400).tolist())))], ids=["sphere", "hull"])
def test_a_quadruped_stands_on_its_feet(foot):
    robot = with_contacts(quadruped(foot), "feet")
    assert {point.link for point in robot.contacts} == {"fl_foot", "fr_foot", "hl_foot", "hr_foot"}
    q = nearest_posture(robot)
    levels = lowest_levels(robot, robot.contacts, forward_kinematics(robot, q))
    ankle = -0.2 * math.cos(0.4) - 0.2 * math.cos(0.4)  # thigh at 0.4 rad, shank at 0.4 - 0.8 rad
    assert levels.min() == pytest.approx(ankle - 0.02, abs=2e-4)
    low = contact_positions(robot, q)[levels < levels.min() + 2e-4, :2]
    assert polygon_margin(center_of_mass(robot, q)[:2], support_polygon(low)) > 0.05


def test_the_lower_half_of_a_foot_keeps_its_lowest_corner():
    """Thinned in the axes of the world, so that a tilted foot stands where the whole one would."""
    points = ball(2000)
    robot = quadruped(Hull(tuple(map(tuple, points.tolist()))))
    poses = forward_kinematics(robot, nearest_posture(robot))
    levels = lowest_levels(robot, with_contacts(robot, "feet").contacts, poses)
    row = [link.name for link in robot.links].index("fl_foot")
    whole = poses.position[row, 2] + (points @ poses.rotation[row, 2]).min()
    assert levels.min() == pytest.approx(whole, abs=1e-12)
    assert len(levels) <= 4 * MOST_CORNERS
    assert corner_error(robot.shapes[-1]) > 1e-3  # what it would miss by


# --- from files ---

TOML = """contacts = {}
"""


def copied(folder, contacts):
    """The arm of one servo with a TOML of its own."""
    urdf = folder / "arm.urdf"
    urdf.write_bytes((robots_folder() / "ax12_arm" / "ax12_arm.urdf").read_bytes())
    urdf.with_suffix(".toml").write_text(TOML.format(contacts), "utf-8")
    return urdf


@pytest.mark.parametrize(("contacts", "choice"), [('"feet"', "'feet'"), ('["forearm"]', r"\('forearm',\)")])
def test_a_toml_may_choose_too(tmp_path, contacts, choice):
    with pytest.raises(RobotFileError, match=rf"arm\.urdf: contacts={choice}: .* no link has a collision shape"):
        load_robot(copied(tmp_path, contacts))


def test_all_joints_can_be_held():
    robot = load_robot("humanoid", locked="all")
    assert robot.nq == 7
    assert robot.locked == nearest_positions(robot.joints)


def test_points_typed_into_a_toml_may_have_a_size(tmp_path):
    link = load_robot("ax12_arm").links[-1].name
    point = f'[{{link = "{link}", position = [0, 0, 0.1], radius = 0.02}}]'
    assert load_robot(copied(tmp_path, point)).contacts == (ContactPoint(link, (0.0, 0.0, 0.1), 0.02),)
