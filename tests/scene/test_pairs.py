"""Which bodies of a scene may touch each other, and how their contact gives way."""

import math
from dataclasses import replace

import numpy as np
import published
import pytest
from touching import far

from featherstone_gait.geometry.body import body
from featherstone_gait.geometry.distance import meeting_shapes
from featherstone_gait.model import Ground, Joint, Link, Model
from featherstone_gait.model.numpy_dynamics import link_poses
from featherstone_gait.model.pair_contact import PairContact
from featherstone_gait.model.placed import Placed, SceneModel
from featherstone_gait.model.rest_posture import nearest_posture
from featherstone_gait.model.shapes import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from featherstone_gait.robot_file import load_robot
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

G = 9.81
CUBE = Box((0.1, 0.1, 0.1))
TURNED = (math.cos(0.4), 0.0, math.sin(0.4), 0.0)


def obstacle(geometry, name, position=(0.0, 0.0, 0.0), friction=None, orientation=(1.0, 0.0, 0.0, 0.0)):
    model = body(geometry, name=name, base="fixed", friction=friction)
    return Placed(model, position=position, orientation=orientation)


def table_of(scene):
    return scene.touching.table.pairs


def names(scene):
    return {frozenset(pair) for pair in scene.pairs}


def slider():
    """A rail on which a cart slides between -0.5 and 2 m, with a pole that turns on it."""
    links = [Link(name, 1.0, inertia=(0.1, 0.0, 0.0, 0.1, 0.0, 0.1)) for name in ("rail", "cart", "pole")]
    joints = [
        Joint("slide", "prismatic", "rail", "cart", xyz=(0.0, 0.0, 0.3), axis=(1.0, 0.0, 0.0), lower=-0.5, upper=2.0),
        Joint("turn", "revolute", "cart", "pole", xyz=(0.0, 0.2, 0.0), axis=(0.0, 1.0, 0.0)),
    ]
    shapes = (Shape("cart", CUBE), Shape("pole", Capsule(0.02, 0.4), xyz=(0.0, 0.0, 0.25), rpy=(0.3, 0.0, 0.0)))
    return Model("slider", tuple(links), tuple(joints), shapes=shapes)


# ---------------------------------------------------------------------------------------------- which


def test_links_of_one_robot_touch_unless_neighbors_or_overlapping_at_rest():
    robot = load_robot("humanoid")
    scene = compile_scene(robot, pairs="all")
    links = [shape.link for shape in robot.shapes]
    allowed = {frozenset(f"humanoid/{links[k]}" for k in pair) for pair in meeting_shapes(robot).pairs}
    assert names(scene) == allowed
    assert frozenset({"humanoid/left_thigh", "humanoid/right_thigh"}) in allowed
    assert frozenset({"humanoid/left_thigh", "humanoid/left_shank"}) not in allowed
    assert any("left_hip_bracket" in note and "overlap" in note for note in scene.touching.notes)


def test_what_cannot_move_touches_only_what_can():
    arm, ball = load_robot("arm7"), body(Sphere(0.05), 1.0, name="ball")
    scene = SceneModel(
        "bench",
        [Placed(arm, "arm"), Placed(ball, position=(1.0, 0.0, 1.0))],
        [obstacle(CUBE, "one", (2.0, 0.0, 0.0)), obstacle(CUBE, "two", (2.05, 0.0, 0.0))],
        pairs="all",
    )
    found = names(compile_scene(scene))
    assert frozenset({"one/body", "two/body"}) not in found
    assert frozenset({"ball/body", "one/body"}) in found
    assert frozenset({f"arm/{arm.root}", "one/body"}) not in found
    for pair in table_of(compile_scene(scene)):
        assert pair.folded == (pair.tree_b == -1 or (pair.tree_b == 0 and pair.body_b == 0))
        assert pair.tree_a >= 0


def test_excluded_links_do_not_touch():
    ball = body(Sphere(0.05), 1.0)
    balls = [Placed(ball, name, position=(k, 0.0, 1.0)) for k, name in enumerate("abc")]
    scene = SceneModel("balls", balls, excluded=[("c/body", "a/body")], pairs="all")
    assert names(compile_scene(scene)) == {frozenset({"a/body", "b/body"}), frozenset({"b/body", "c/body"})}
    assert names(compile_scene(scene).recompiled()) == names(compile_scene(scene))


def test_pairs_of_names_are_those_of_all_their_links_or_of_two_links():
    robot, ball = load_robot("humanoid"), body(Sphere(0.05), 1.0, name="ball")
    placed = [Placed(robot, "robot"), Placed(ball, position=(2.0, 0.0, 1.0))]
    links = {shape.link for shape in robot.shapes}
    scene = compile_scene(placed, pairs=[("ball", "robot")])
    assert names(scene) == {frozenset({"ball/body", f"robot/{link}"}) for link in links}
    scene = compile_scene(placed, pairs=[("robot/left_thigh", "robot/left_shank")])
    assert names(scene) == {frozenset({"robot/left_thigh", "robot/left_shank"})}
    assert names(compile_scene(placed, pairs="none")) == names(compile_scene(placed)) == set()
    own = compile_scene(placed, pairs=[("robot", "robot")])
    assert names(own) == names(compile_scene([placed[0]], pairs="all"))


def test_a_scene_says_itself_what_touches_unless_told_otherwise():
    ball = body(Sphere(0.05), 1.0)
    scene = SceneModel("balls", [Placed(ball, "a"), Placed(ball, "b", position=(1.0, 0.0, 0.0))], pairs=[("a", "b")])
    assert len(compile_scene(scene).pairs) == 1
    assert len(compile_scene(scene, pairs="none").pairs) == 0
    assert compile_scene(scene, pairs="none").touching.table is None


@pytest.mark.parametrize(
    ("pairs", "words"),
    [
        ("some", ["'some'", '"all"']),
        ([("ball", "nobody")], ["'nobody'", "'wall'"]),
        ([("ball",)], ["('ball',)", "two names"]),
        ([("wall", "wall")], ["'wall'", "cannot touch"]),
        ([("ball", "wall")], ["excluded"]),
        (3, ["3", '"all"']),
    ],
)
def test_pairs_that_are_none_are_refused(pairs, words):
    ball = Placed(body(Sphere(0.05), 1.0, name="ball"))
    scene = SceneModel("x", [ball], [obstacle(CUBE, "wall")], excluded=[("ball/body", "wall/body")])
    with pytest.raises(ValueError, match="pairs") as error:
        compile_scene(scene, pairs=pairs)
    assert all(word in str(error.value) for word in words)
    if pairs in ([("ball", "nobody")], "some", 3):
        with pytest.raises(ValueError, match="pairs"):
            replace(scene, pairs=pairs)


def test_a_concave_mesh_tells_how_much_larger_its_hull_is(tmp_path):
    """A square of 9 with a notch of 1, drawn out, has a hull of 9 / 8 times its volume."""
    trimesh = pytest.importorskip("trimesh")
    outline = np.array([(0, 0), (3, 0), (3, 1), (2, 1), (2, 2), (3, 2), (3, 3), (0, 3)], float)
    points = 0.1 * np.vstack([np.column_stack([outline, np.full(8, z)]) for z in (0.0, 2.0)])
    below = [(0, 3, 1), (1, 3, 2), (0, 7, 3), (3, 7, 4), (4, 7, 6), (4, 6, 5)]
    sides = [(k, (k + 1) % 8, (k + 1) % 8 + 8) for k in range(8)] + [(k, (k + 1) % 8 + 8, k + 8) for k in range(8)]
    faces = [*below, *((a + 8, c + 8, b + 8) for a, b, c in below), *sides]
    notes = {}
    for name, kept in (("notch", faces), ("open", faces[:-1]), ("box", None)):
        mesh = trimesh.Trimesh(points, kept or faces)
        (mesh if kept else mesh.convex_hull).export(tmp_path / f"{name}.obj")
        thing = body(Mesh(str(tmp_path / f"{name}.obj")), 1.0, name=name)
        scene = SceneModel("one", [Placed(thing, position=(0.0, 0.0, 1.0))], [obstacle(CUBE, "cube")], pairs="all")
        notes[name] = " ".join(compile_scene(scene).touching.notes)
    assert notes["box"] == ""
    assert "not closed" in notes["open"]
    for words in ("notch/body", "notch.obj", "1.12 times its volume", "several convex shapes"):
        assert words in notes["notch"]


@pytest.mark.parametrize(
    "numbers", [{"penetration": 0.0}, {"friction": -1.0}, {"load": 0.0}, {"max_points": 0}, {"damping_ratio": math.nan}]
)
def test_numbers_out_of_range_are_refused(numbers):
    with pytest.raises(ValueError, match=next(iter(numbers))):
        PairContact(**numbers)


def in_pinocchio(model, urdf, srdf):
    """Pairs of links that collide in Pinocchio, without those of the SRDF, their distance at rest; the neighbors."""
    pin, coal = pytest.importorskip("pinocchio"), pytest.importorskip("coal")
    theirs, folders = pin.buildModelFromUrdf(str(urdf)), [str(urdf.parents[3]), str(urdf.parents[4])]
    geometry = pin.buildGeomFromUrdf(theirs, str(urdf), pin.GeometryType.COLLISION, folders)
    geometry.addAllCollisionPairs()
    pin.removeCollisionPairs(theirs, geometry, str(srdf))
    q = pin.neutral(theirs)
    for name, position in zip(model.joint_names, nearest_posture(model)[-len(model.joint_names) :]):
        q[theirs.joints[theirs.getJointId(name)].idx_q] = position
    data, placed = theirs.createData(), geometry.createData()
    pin.updateGeometryPlacements(theirs, data, geometry, placed, q)
    shapes, apart, near = [], {}, set()
    for one in geometry.geometryObjects:
        convex = one.geometry
        if isinstance(convex, coal.BVHModelBase):
            convex.buildConvexRepresentation(False)
            convex = convex.convex
        shapes.append(convex)
    for pair in geometry.collisionPairs:
        both = (pair.first, pair.second)
        parts = [geometry.geometryObjects[k] for k in both]
        links = frozenset(theirs.frames[part.parentFrame].name for part in parts)
        places = [coal.Transform3s(placed.oMg[k].rotation, placed.oMg[k].translation) for k in both]
        (one, two), how, found = (shapes[k] for k in both), coal.DistanceRequest(), coal.DistanceResult()
        apart[links] = min(coal.distance(one, places[0], two, places[1], how, found), apart.get(links, math.inf))
        low, high = sorted(part.parentJoint for part in parts)
        near |= {links} if theirs.parents[high] == low else set()
    return apart, near


@pytest.mark.parametrize(
    ("urdf", "srdf"),
    [
        ("panda_description/urdf/panda.urdf", "panda_description/srdf/panda.srdf"),
        ("ur_description/urdf/ur5_robot.urdf", "ur_description/srdf/ur5.srdf"),
        ("go1_description/urdf/go1.urdf", "go1_description/srdf/go1.srdf"),
    ],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_links_that_touch_are_those_of_pinocchio_without_neighbors_and_overlaps(urdf, srdf):
    urdf, srdf = published.folder("example-robot-data") / urdf, published.folder("example-robot-data") / srdf
    model = load_robot(urdf, srdf=srdf)
    ours = {frozenset(link.partition("/")[2] for link in pair) for pair in compile_scene(model, pairs="all").pairs}
    apart, near = in_pinocchio(model, urdf, srdf)
    assert ours
    assert ours <= {*apart} - near
    left = {*apart} - near - ours
    assert [sorted(links) for links in left if not apart[links] < 2e-3] == []
    assert [sorted(links) for links in ours if not apart[links] > -1e-6] == []


def test_a_robot_that_falls_on_its_arms_touches_with_its_arms():
    """Links without contact points touch the ground with their shapes, as hard as points of the ground would."""
    robot, ball = load_robot("humanoid"), body(Sphere(0.05), 1.0, name="ball")
    ground = Ground(friction=0.6, penetration=1e-3, damping_ratio=0.3, height=0.2, slope=0.1, heading=0.4)
    placed = [Placed(robot, "robot"), Placed(ball, position=(2.0, 0.0))]
    scene = compile_scene(placed, ground=ground, pairs="all")
    pointed = {f"robot/{point.link}" for point in robot.contacts}
    shaped = {f"robot/{shape.link}" for shape in robot.shapes}
    low = {pair[0]: row for pair, row in zip(scene.pairs, table_of(scene)) if pair[1] == "ground"}
    assert {*low} == shaped - pointed
    assert pointed
    hand = low["robot/left_forearm"]
    assert (hand.tree_b, hand.folded, hand.row_b, hand.friction) == (-1, 1, 0, 0.6)
    points = 2 if hand.slots == 2 else 4
    assert hand.stiffness == pytest.approx(robot.mass * G / (points * 1e-3))
    assert hand.damping == pytest.approx(0.6 / math.sqrt(G * 1e-3))
    assert scene.touching.table.margin == 1e-3
    plane = scene.touching.table.shapes.table[hand.b]
    on_plane = np.array([0.3, -0.7, 0.0])
    on_plane[2] = 0.2 + math.tan(0.1) * (0.3 * math.cos(0.4) - 0.7 * math.sin(0.4))
    assert (on_plane - plane.r) @ plane.E.reshape(3, 3)[:, 2] == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.det(plane.E.reshape(3, 3)) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="contact points"):
        compile_scene(placed, ground=ground, pairs=[("ball/body", "ground")])
    high = [replace(one, ground_contact=False) for one in placed]
    for other in (compile_scene(high, ground=ground, pairs="all"), compile_scene(placed, pairs="all")):
        assert not any("ground" in pair for pair in other.pairs)
    stairs = compile_scene(placed, ground=Ground(steps=((1.0, 0.1),)), pairs="all")
    assert sum("ground" in pair for pair in stairs.pairs) == 2 * sum("ground" in pair for pair in scene.pairs)
    out = SceneModel("x", placed, ground=ground, excluded=[("ground", "robot/left_forearm")], pairs="all")
    assert ("robot/left_forearm", "ground") not in compile_scene(out).pairs


# ---------------------------------------------------------------------------------------------- the law


@pytest.mark.parametrize(("shape", "points"), [(CUBE, 4), (Sphere(0.1), 1)])
def test_points_of_an_obstacle_are_those_of_the_ground(shape, points):
    """So what rests on an obstacle lies exactly as deep as on the ground."""
    thing = Placed(body(shape, 2.0, name="thing", friction=0.4), position=(0.0, 0.0))
    scene = SceneModel("x", [thing], [obstacle(CUBE, "table", friction=0.4)], ground=Ground(), pairs="all")
    compiled = compile_scene(scene, pairs=[("thing", "table")])
    (pair,), point = table_of(compiled), compiled.constants.contact.points[0]
    for name in ("stiffness", "damping", "friction", "tangential_stiffness", "tangential_damping"):
        assert pair[name] == pytest.approx(point[name], rel=1e-14), name
    assert points * pair.stiffness * 5e-4 == pytest.approx(2.0 * G, rel=1e-14)


@pytest.mark.long
def test_a_box_rests_on_an_obstacle_exactly_as_deep_as_on_the_ground():
    cube, depth = body(CUBE, 2.0, name="cube"), 1e-3
    table = obstacle(Box((1.0, 1.0, 0.2)), "table", (0.0, 0.0, 0.1))
    bodies = [Placed(cube, "high", (0.0, 0.0, 0.25)), Placed(cube, "low", (2.0, 0.0, 0.05))]
    bodies.append(Placed(body(Cylinder(0.05, 0.1), 2.0), "can", (4.0, 0.0, 0.05)))
    touch = PairContact(penetration=depth, load=2.0)
    scene = SceneModel("x", bodies, [table], ground=Ground(penetration=depth), pairs=touch)
    run = simulate(compile_scene(scene, integrator="implicit_euler", timestep=1e-3), 1.0, estimate_error=False)
    high, low = (run[name]["base_q"][-1] for name in ("high", "low"))
    assert high[2] == pytest.approx(0.25 - depth, abs=1e-9)
    assert np.abs(high - low - [-2.0, 0.0, 0.2, *np.zeros(4)]).max() < 1e-9


def test_a_pair_is_as_stiff_as_all_that_may_rest_on_it_or_the_load_asks_for():
    heavy, light = body(CUBE, 100.0, friction=0.9), body(CUBE, 0.1, friction=0.4)
    placed = [Placed(heavy, "heavy"), Placed(light, "light", position=(1.0, 0.0, 0.0))]
    (pair,) = table_of(compile_scene(placed, pairs=PairContact(penetration=1e-3)))
    assert pair.stiffness == pytest.approx(100.1 * G / (4 * 1e-3))
    assert pair.damping == pytest.approx(2 * 0.7 / math.sqrt(G * 1e-3))
    assert pair.friction == pytest.approx(math.sqrt(0.9 * 0.4))
    reduced = 100.0 * 0.1 / 100.1
    assert pair.tangential_damping == pytest.approx(2 * 0.7 * math.sqrt(pair.stiffness * reduced / 4))
    (pair,) = table_of(compile_scene(placed, pairs=PairContact(load=3.0)))
    assert pair.stiffness == pytest.approx(3.0 * G / (4 * 5e-4))
    (pair,) = table_of(compile_scene(placed, pairs="all", gravity=(0.0, 0.0, 0.0)))
    assert pair.stiffness == pytest.approx(100.1 * G / (4 * 5e-4))


def test_what_touches_through_others_may_rest_on_a_pair_too():
    masses = {"a": 1.0, "b": 2.0, "c": 4.0, "d": 8.0, "e": 16.0}
    placed = [Placed(body(CUBE, mass), name, position=(x, 0.0, 0.0)) for x, (name, mass) in enumerate(masses.items())]
    meeting = PairContact((("a", "b"), ("b", "c"), ("d", "e"), ("c", "floor"), ("e", "floor")))
    scene = compile_scene(SceneModel("x", placed, [obstacle(CUBE, "floor")]), pairs=meeting)
    load = {tuple(sorted(link[0] for link in pair)): 4.0 * 5e-4 * row.stiffness / G
            for pair, row in zip(scene.pairs, table_of(scene))}  # fmt: skip
    expected = {("a", "b"): 7.0, ("b", "c"): 7.0, ("c", "f"): 7.0, ("d", "e"): 24.0, ("e", "f"): 24.0}
    assert load == pytest.approx(expected)


def test_a_fixed_base_weighs_nothing():
    arm = slider()
    heavy = replace(arm, links=(replace(arm.links[0], mass=1e6), *arm.links[1:]))
    scenes = [compile_scene(SceneModel("x", [Placed(m)], [obstacle(CUBE, "o")]), pairs="all") for m in (arm, heavy)]
    assert np.array_equal(*(table_of(scene).stiffness for scene in scenes))


@pytest.mark.parametrize("mass", [1.0, 0.01])
def test_contact_limits_explicit_steps_as_the_frequency_of_both_bodies(mass):
    """Two free masses on a spring: 2 / omega."""
    placed = [Placed(body(Sphere(0.1), mass, "a")), Placed(body(Sphere(0.1), 1.0, "b"), position=(1.0, 0.0, 0.0))]
    scene = compile_scene(placed, pairs="all")
    (pair,) = table_of(scene)
    step = 2.0 / math.sqrt(pair.stiffness * (1.0 + 1.0 / mass))
    assert scene.preflight.worst.joint == "b/body - a/body"
    assert scene.preflight.largest_explicit_step == pytest.approx(step)
    assert scene.integrator == "ars343"
    assert not scene.preflight.named
    assert "b/body - a/body: contact spring" in scene.preflight.reason
    assert compile_scene(placed, integrator="rk4", timestep=1e-5, pairs="all").integrator == "rk4"


# ---------------------------------------------------------------------------------------------- tables


def world_places(scene, number, q):
    """Rotations and centers in the world of all shapes of one member in a posture."""
    member, tree = scene.members[number], scene.tree
    poses, found = link_poses(member.model, q), {}
    for name, place in tree.placements.items():
        owner, link = name.split("/", 1)
        if owner == member.name:
            k = member.model.link_index(link)
            turn = poses.rotation[k] @ place.E.T
            found[place.row] = turn, poses.position[k] - turn @ place.r
    table = scene.touching.table.shapes.table
    rows = [k for k in range(len(table)) if table.link[k] in found]
    return {
        k: (found[table[k].link][0] @ table[k].E.reshape(3, 3), sum_of(found[table[k].link], table[k].r)) for k in rows
    }


def sum_of(pose, r):
    return pose[1] + pose[0] @ r


def test_shapes_are_where_forward_kinematics_has_them():
    robot = load_robot("humanoid")
    q = nearest_posture(robot)
    q[7:] += np.random.default_rng(0).uniform(-0.5, 0.5, len(q) - 7)
    scene = compile_scene(SceneModel("x", [Placed(robot)], [obstacle(CUBE, "o", (5.0, 0.0, 1.0), None, TURNED)]),
                          pairs="all")  # fmt: skip
    poses, places = link_poses(robot, q), world_places(scene, 0, q)
    centers = sorted((poses.position[robot.link_index(s.link)] + poses.rotation[robot.link_index(s.link)] @ s.xyz
                      for s in robot.shapes), key=tuple)  # fmt: skip
    assert np.allclose(sorted((r for _, r in places.values()), key=tuple), centers, atol=1e-12)
    last = scene.touching.table.shapes.table[-1]
    assert np.allclose(last.r, (5.0, 0.0, 1.0))
    assert np.allclose(last.E.reshape(3, 3) @ (0.0, 0.0, 1.0), (math.sin(0.8), 0.0, math.cos(0.8)))


@pytest.mark.parametrize("robot", ["humanoid", "slider"])
def test_no_posture_takes_a_shape_beyond_its_bounds(robot):
    model = slider() if robot == "slider" else load_robot(robot)
    scene = compile_scene(SceneModel("x", [Placed(model)], [obstacle(CUBE, "o", (9.0, 0.0, 0.0))]), pairs="all")
    pairs, rng, n = scene.touching.table, np.random.default_rng(1), len(model.joint_names)
    start, farthest, fastest = nearest_posture(model), 0.0, np.zeros(n)
    for _ in range(15):
        q = start.copy()
        for k, joint in enumerate(model.moving_joints):
            q[len(q) - n + k] = rng.uniform(max(joint.lower, -4.0), min(joint.upper, 4.0))
        base = world_places(scene, 0, q)
        for k, (turn, center) in base.items():
            shape = pairs.shapes.table[k]
            farthest = max(farthest, *np.linalg.norm(center + corners(shape) @ turn.T, axis=1))
        for k in range(n):
            near = q.copy()
            near[len(q) - n + k] += 1e-6
            for row, (turn, center) in world_places(scene, 0, near).items():
                own = corners(pairs.shapes.table[row])
                moved = center + own @ turn.T - base[row][1] - own @ base[row][0].T
                fastest[k] = max(fastest[k], *np.linalg.norm(moved, axis=1) / 1e-6)
    assert farthest <= pairs.radius[0] + 1e-9
    assert (fastest <= pairs.reach + 1e-6).all()
    assert pairs.radius[0] < 2.0 * farthest + 0.1
    assert (pairs.reach <= 3.0 * fastest + 0.05).all()


def corners(shape):
    """The corners of a box around a shape, inside the sphere that bounds it."""
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    if shape.corners:
        return np.zeros((1, 3))
    return signs * (shape.half + 0.7 * shape.disc * np.array([1.0, 1.0, 0.0]))


def test_every_body_of_a_pair_has_a_row_of_its_own():
    robot, ball = load_robot("humanoid"), body(Sphere(0.05), 1.0, name="ball")
    scene = SceneModel("x", [Placed(robot), Placed(ball, position=(2.0, 0.0))], [obstacle(CUBE, "o", (5.0, 0.0, 0.0))],
                       Ground(), pairs="all")  # fmt: skip
    compiled = compile_scene(scene)
    pairs, plain = compiled.touching.table, compile_scene(scene, pairs="none")
    table, bodies = pairs.pairs, compiled.tree.bodies
    assert (bodies.contact[table.body_a] == table.row_a).all()
    both = table.tree_b >= 0
    assert (bodies.contact[table.body_b[both]] == table.row_b[both]).all()
    assert (table.row_b[~both] == 0).all()
    with_points = {plain.tree.placements[f"humanoid/{point.link}"].row for point in robot.contacts} | {len(bodies) - 1}
    touched = {*table.body_a.tolist(), *table.body_b[both].tolist()}
    assert sorted(pairs.own_rows) == sorted(bodies.contact[[*touched - with_points]])
    assert compiled.tree.rows == plain.tree.rows + len(pairs.own_rows)
    assert (compiled.tree.bodies.contact[compiled.constants.contact.points.body] != pairs.own_rows[:, None]).all()
    weightless = compile_scene(replace(scene, ground=None))
    assert {*weightless.touching.table.own_rows} == {*weightless.tree.bodies.contact[[*touched]]}
    assert [*zip(table.tree_a, table.tree_b)] == sorted(zip(table.tree_a, table.tree_b))


def test_a_pair_has_as_many_points_as_its_shapes_can_have():
    shapes = [CUBE, Sphere(0.1), Capsule(0.1, 0.2), Cylinder(0.1, 0.2)]
    placed = [Placed(body(shape, 1.0, name=type(shape).__name__), position=(k, 0, 0)) for k, shape in enumerate(shapes)]
    scene = compile_scene(placed, pairs="all")
    slots = {
        frozenset(name.split("/")[0] for name in pair): row.slots for pair, row in zip(scene.pairs, table_of(scene))
    }
    assert slots == {
        frozenset({"Box", "Sphere"}): 1, frozenset({"Capsule", "Sphere"}): 1, frozenset({"Cylinder", "Sphere"}): 1,
        frozenset({"Box", "Capsule"}): 2, frozenset({"Capsule", "Cylinder"}): 3, frozenset({"Box", "Cylinder"}): 8,
    }  # fmt: skip
    assert scene.touching.table.slots[0] == 16
    few = compile_scene(placed, pairs=PairContact(max_points=9))
    assert few.touching.table.slots[0] == 9
    with pytest.raises(ValueError, match="max_points is 7; expected 8 or more"):
        compile_scene(placed, pairs=PairContact(max_points=7))


def test_the_pool_has_room_for_what_is_near_at_the_start_and_for_piles():
    cube = body(CUBE, 1.0)
    apart = [Placed(cube, f"c{k}", (0.3 * k, 0.0, 0.3)) for k in range(30)]
    assert compile_scene(apart, pairs="all").touching.table.slots[0] == 32 + 30 * 3 * 8
    close = [Placed(cube, f"c{k}", (0.12 * k, 0.0, 0.3)) for k in range(30)]  # 0.02 m apart
    assert compile_scene(close, pairs="all").touching.table.slots[0] == 32 + 30 * 3 * 8 + 2 * 29 * 8
    robot = load_robot("humanoid")
    for ground in (None, Ground()):
        scene = compile_scene([Placed(robot, orientation=TURNED)], ground=ground, pairs="all")
        assert 32 + 2 * 200 < scene.touching.table.slots[0] < scene.touching.table.pairs.slots.sum()


def test_a_box_that_slides_over_an_edge_rests_with_its_weight_until_it_tips():
    """Its corners leave the table one by one; what carries it and what brakes it stay, and no contact gives energy."""
    yaw, friction = 0.35, 0.1
    start = 0.5 - 0.1 * (math.cos(yaw) + math.sin(yaw)) - 2e-3
    turned = (math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw))
    box = Placed(body(Box((0.2, 0.2, 0.2)), 1.0), "box", (start, 0.0, 0.1 - 1e-4), turned)
    table = obstacle(Box((1.0, 1.0, 0.1)), "table", (0.0, 0.0, -0.05))
    contact = PairContact(penetration=1e-4, friction=friction, load=1.0)
    how = {"pairs": contact, "integrator": "extrapolation", "timestep": 1e-3}
    scene = compile_scene(SceneModel("edge", [box], [table, *far()]), **how)
    state = initial_state(scene, None, {"box": (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)})
    record = ("base_q", "pair_force", "pair_normal_force", "pair_work")
    run = simulate(scene, 0.4, state, record=record, record_interval=1e-3, estimate_error=False)
    normal = run["pair_normal_force"].sum(axis=1)
    braking = -run["pair_force"].reshape(len(normal), -1, 3).sum(axis=1)[:, 0]
    way = run["box"]["base_q"]
    on = (way[:, 0] < 0.495) & (run["time"] > 2e-3)
    assert on.sum() > 100
    assert normal[on] == pytest.approx(9.81, rel=0.1)
    assert braking[on] == pytest.approx(friction * normal[on], rel=0.07)
    assert np.diff(run["pair_work"][:, 0]).max() <= 0.0
    assert way[-1, 2] < -0.05  # it falls past the table
