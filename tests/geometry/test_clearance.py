"""Distances between shapes: against MuJoCo, brute force and closed forms; which pairs count; channel and penalty."""

import hashlib
import math
from dataclasses import replace

import numpy as np
import pytest
from mujoco_oracle import mujoco
from scipy.optimize import minimize_scalar

from featherstone_gait import (
    Box,
    Capsule,
    Cylinder,
    Hull,
    Joint,
    Link,
    Model,
    Shape,
    Sphere,
    clearance,
    compile_scene,
    initial_state,
    simulate,
)
from featherstone_gait.base.rotation import rotation_from_rpy
from featherstone_gait.geometry.distance import meeting_shapes, shape_distances
from featherstone_gait.walking import Constraints

BODY = (1.0, (0.0, 0.0, 0.0), (1e-2, 0.0, 0.0, 1e-2, 0.0, 1e-2))  # mass, center, inertia
KINDS = {
    "sphere": lambda size: Sphere(size()),
    "capsule": lambda size: Capsule(size() / 3.0, size()),
    "box": lambda size: Box((size(), size(), size())),
    "cylinder": lambda size: Cylinder(size(), size()),
}


def chain(*shapes, fixed=()):
    """Links w, x, y, z, one after the other, of which `fixed` are fixed to the one before; all frames at the origin."""
    joints = [
        Joint(f"to_{child}", "fixed" if child in fixed else "prismatic", parent, child, lower=-9.0, upper=9.0)
        for parent, child in zip("wxy", "xyz")
    ]
    return Model("chain", tuple(Link(name, *BODY) for name in "wxyz"), tuple(joints), shapes=shapes)


def distance(a, b):
    """Signed distance of two shapes of the links w and y [m]."""
    return shape_distances(chain(a, b), np.zeros(3), np.array([[0, 1]]))[0]


def placed(rng, link, geometry, spread):
    """A shape somewhere; every third one square to the axes."""
    turn = rng.uniform(-3.0, 3.0, 3) if rng.random() < 0.7 else 0.5 * math.pi * rng.integers(0, 4, 3)
    return Shape(link, geometry, tuple(rng.uniform(-spread, spread, 3).tolist()), tuple(turn.tolist()))


def pairs(*kinds, n, spread):
    """Pairs of shapes of these kinds in random places."""
    rng = np.random.default_rng(len("".join(kinds)))
    for _ in range(n):
        geometries = [KINDS[kind](lambda: float(rng.uniform(0.02, 0.3))) for kind in kinds]
        yield [placed(rng, link, geometry, spread) for link, geometry in zip("wy", geometries)]


def mujoco_geom(shape):
    """As MJCF."""
    match shape.geometry:
        case Sphere(radius):
            size = f'type="sphere" size="{radius!r}"'
        case Capsule(radius, length):
            size = f'type="capsule" size="{radius!r} {0.5 * length!r}"'
        case Cylinder(radius, length):
            size = f'type="cylinder" size="{radius!r} {0.5 * length!r}"'
        case Box((x, y, z)):
            size = f'type="box" size="{0.5 * x!r} {0.5 * y!r} {0.5 * z!r}"'
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation_from_rpy(shape.rpy).ravel())
    place = f'pos="{" ".join(map(repr, shape.xyz))}" quat="{" ".join(map(repr, quaternion.tolist()))}"'
    return f'<geom {size} {place} mass="1"/>'


def mujoco_distance(a, b):
    """The same by MuJoCo."""
    bodies = "".join(f"<body><freejoint/>{mujoco_geom(shape)}</body>" for shape in (a, b))
    option = '<option ccd_tolerance="1e-12" ccd_iterations="200"/>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{option}<worldbody>{bodies}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return mujoco.mj_geomDistance(model, data, 0, 1, 100.0, np.zeros(6))


def both(*kinds, n=60, spread=0.3):
    """Our distances and MuJoCo's."""
    return np.array([(distance(a, b), mujoco_distance(a, b)) for a, b in pairs(*kinds, n=n, spread=spread)]).T


EXACT = [("sphere", "sphere"), ("sphere", "capsule"), ("sphere", "box"), ("capsule", "capsule"), ("box", "box")]


@pytest.mark.parametrize("kinds", EXACT, ids="-".join)
def test_distance_and_depth_are_those_of_mujoco(kinds):
    ours, theirs = both(*kinds)
    assert (ours < 0.0).any()
    assert (ours > 0.1).any()
    assert ours == pytest.approx(theirs, abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_cylinders_have_the_distance_of_mujoco_and_at_least_its_depth(kind):
    ours, theirs = both("cylinder", kind)
    apart = theirs > 0.0
    assert 10 < apart.sum() < len(ours)
    assert ours[apart] == pytest.approx(theirs[apart], abs=1e-9)
    assert (ours[~apart] < theirs[~apart] + 1e-9).all()


def to_box(shape, point):
    """Distance of a point in the world from a box."""
    p = rotation_from_rpy(shape.rpy).T @ (point - np.array(shape.xyz))
    return np.linalg.norm(np.maximum(np.abs(p) - 0.5 * np.array(shape.geometry.size), 0.0))


def test_box_and_capsule_have_the_distance_of_the_nearest_point_of_the_axis():
    """The distance of a point on a line from a convex body has one minimum; MuJoCo misses it in places."""
    found = []
    for box, capsule in pairs("box", "capsule", n=100, spread=0.3):
        along, half = rotation_from_rpy(capsule.rpy)[:, 2], 0.5 * capsule.geometry.length

        def to_axis(t, box=box, center=capsule.xyz, along=along):
            return to_box(box, center + t * along)

        between = minimize_scalar(to_axis, bounds=(-half, half), method="bounded", options={"xatol": 1e-11}).fun
        least = min(between, to_axis(-half), to_axis(half))
        found.append((distance(box, capsule) + capsule.geometry.radius, least))
    ours, least = np.array(found).T
    apart = least > 1e-6
    assert 20 < apart.sum() < 100
    assert ours[apart] == pytest.approx(least[apart], abs=1e-9)
    assert (ours[~apart] <= 1e-9).all()


def nearest_of_segments(p, d, q, e):
    """Distance of two segments p + s d, q + t e, s and t from 0 to 1: the ends, or inside where they cross."""
    ends = [np.linalg.norm(x - y - np.clip((x - y) @ f / (f @ f), 0, 1) * f) for x, y, f in _ends(p, d, q, e)]
    A = np.array([[d @ d, -d @ e], [-d @ e, e @ e]])
    s, t = np.linalg.solve(A, [d @ (q - p), -e @ (q - p)])
    inside = 0 < s < 1 and 0 < t < 1
    return min(*ends, np.linalg.norm(p + s * d - q - t * e) if inside else math.inf)


def _ends(p, d, q, e):
    return [(p, q, e), (p + d, q, e), (q, p, d), (q + e, p, d)]


def nearest_of_triangle(x, a, b, c):
    """Distance of a point from the inside of a triangle; infinite beside it."""
    s, t = np.linalg.lstsq(np.column_stack([b - a, c - a]), x - a, rcond=None)[0]
    return np.linalg.norm(x - a - s * (b - a) - t * (c - a)) if s >= 0 and t >= 0 and s + t <= 1 else math.inf


def brute_force(x, y):
    """Distance of the surfaces of two tetrahedra (4, 3): all edges with all edges, all corners with all faces."""
    edges = [(i, j) for j in range(4) for i in range(j)]
    faces = [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
    found = [nearest_of_segments(x[i], x[j] - x[i], y[k], y[m] - y[k]) for i, j in edges for k, m in edges]
    found += [nearest_of_triangle(p, *b[list(face)]) for a, b in ((x, y), (y, x)) for p in a for face in faces]
    return min(found)


def parted(x, y):
    """Whether a plane through a face, or along an edge of each, lies between two tetrahedra."""
    edges = [(i, j) for j in range(4) for i in range(j)]
    d, e = ([z[j] - z[i] for i, j in edges] for z in (x, y))
    normals = [np.cross(a, b) for f in (d, e) for k, a in enumerate(f) for b in f[:k]]
    axes = normals + [np.cross(a, b) for a in d for b in e]
    return any((x @ u).max() < (y @ u).min() or (y @ u).max() < (x @ u).min() for u in axes)


def test_hulls_have_the_distance_of_their_nearest_features():
    rng = np.random.default_rng(0)
    apart = 0
    for _ in range(50):
        x, y = rng.uniform(-0.3, 0.3, (2, 4, 3)) + rng.uniform(-0.2, 0.2, (2, 1, 3))
        d = distance(*(Shape(link, Hull(tuple(map(tuple, z.tolist())))) for link, z in zip("wy", (x, y))))
        assert (d > 0.0) == parted(x, y)
        if d > 0.0:
            assert d == pytest.approx(brute_force(x, y), abs=1e-9)
            apart += 1
    assert 10 < apart < 43


def test_the_hull_of_a_box_is_the_box():
    rng = np.random.default_rng(0)
    depths = []
    for a, b in pairs("box", "box", n=80, spread=0.1):
        size = np.array(b.geometry.size)
        corners = [tuple((0.5 * size * (x, y, z)).tolist()) for x in (1, -1) for y in (1, -1) for z in (1, -1)]
        rng.shuffle(corners)
        depths.append((distance(a, replace(b, geometry=Hull(tuple(map(tuple, corners))))), distance(a, b)))
    hull, box = np.array(depths).T
    assert (box < 0.0).sum() > 40
    assert hull == pytest.approx(box, abs=1e-11)


def test_a_thinned_hull_is_never_nearer_than_it_seems():
    """A ball of many corners: what is taken away by thinning is put around it again."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(2000, 3))
    points *= 0.1 / np.linalg.norm(points, axis=1)[:, None]
    ball = Shape("w", Hull(tuple(map(tuple, points.tolist()))))
    for _ in range(20):
        x = rng.normal(size=3)
        other = Shape("y", Sphere(0.05), tuple((0.4 * x / np.linalg.norm(x)).tolist()))
        exact = distance(ball, replace(other, geometry=Sphere(0.05)))
        assert 0.25 - 0.03 < exact <= 0.4 - 0.05 - (points @ x).max() / np.linalg.norm(x) + 1e-12


@pytest.mark.quick("kinds[02]")
@pytest.mark.parametrize("kinds", [("box", "capsule"), ("capsule", "box"), ("box", "box"), ("capsule", "capsule")])
def test_a_distance_changes_no_faster_than_its_shapes_move(kinds):
    """Through touching to the middle of the other: a signed distance has a slope of 1 at most."""
    for a, b in pairs(*kinds, n=3, spread=0.2):
        path = [replace(b, xyz=tuple((np.array(b.xyz) * (1.0 - k * 0.02)).tolist())) for k in range(100)]
        step = 0.02 * np.linalg.norm(b.xyz)
        values = np.array([distance(replace(a, xyz=(0.0, 0.0, 0.0)), moved) for moved in path])
        assert np.abs(np.diff(values)).max() <= step * (1.0 + 1e-9)


# --- which pairs ---


def at(link, x, name=""):
    """A small ball on the axis along which all joints slide."""
    return Shape(link, Sphere(0.1), (x, 0.0, 0.0), name=name)


def test_neighbors_and_what_is_attached_to_them_are_left_out():
    robot = chain(at("w", 0.0), at("x", 1.0), at("y", 2.0), at("z", 3.0))
    assert meeting_shapes(robot).pairs.tolist() == [[0, 2], [0, 3], [1, 3]]
    welded = chain(*robot.shapes, fixed="y")
    assert meeting_shapes(welded).pairs.tolist() == [[0, 3]]
    assert meeting_shapes(replace(robot, locked={"to_y": 0.5})).pairs.tolist() == [[0, 3]]


def test_links_that_the_model_excludes_are_left_out():
    shapes = [Shape(link, Sphere(0.1), (k, 0.0, 0.0)) for k, link in enumerate("wxyz")]
    model = chain(*shapes)
    assert {(0, 2), (0, 3), (1, 3)} == set(map(tuple, meeting_shapes(model).pairs.tolist()))
    less = replace(model, excluded=(("y", "w"),))
    assert {(0, 3), (1, 3)} == set(map(tuple, meeting_shapes(less).pairs.tolist()))


def test_what_overlaps_at_rest_is_left_out_and_said():
    robot = chain(at("w", 0.0), at("y", 0.15), at("z", 1.0))
    assert meeting_shapes(robot).pairs.tolist() == [[0, 2]]
    assert meeting_shapes(robot).notes == ("links 'w' and 'y' overlap at rest: not checked",)
    shifted = replace(robot, joints=tuple(replace(joint, lower=0.3) for joint in robot.joints))
    assert meeting_shapes(shifted).notes == ()


def test_the_least_distance_is_that_of_the_closest_pair():
    robot = chain(at("w", 0.0), at("x", 1.0), at("y", 2.0), at("z", 3.0))
    q = np.array([[0.0, 0.0, 0.0], [0.0, -1.5, 0.0], [0.0, 0.0, -1.8], [1.0, 1.0, -5.0], [1.0, 1.0, -5.15]])
    distances, shapes = clearance(robot, q)
    assert distances == pytest.approx([1.8, 0.3, 0.0, -0.2, -0.05], abs=1e-12)
    assert shapes.tolist() == [[0, 2], [0, 2], [1, 3], [0, 3], [0, 3]]
    for row, d, pair in zip(q, distances, shapes):
        one = clearance(robot, row)
        assert (one.distance, one.shapes.tolist()) == (d, pair.tolist())


def test_without_a_pair_there_is_no_clearance():
    with pytest.raises(ValueError, match="chain: no two shapes that could meet, of 2; give links"):
        clearance(chain(at("w", 0.0), at("x", 1.0)), np.zeros(3))


def crowd():
    """A chain of shapes of all kinds."""
    rng = np.random.default_rng(5)
    kinds = [*KINDS.values(), lambda size: Hull(tuple(map(tuple, rng.uniform(-0.2, 0.2, (9, 3)).tolist())))]
    shapes = [
        replace(placed(rng, link, kind(lambda: float(rng.uniform(0.05, 0.3))), 0.2), name=link)
        for link in "wxyz"
        for kind in kinds
    ]
    shapes = [replace(shape, xyz=(shape.xyz[0] + "wxyz".index(shape.link), *shape.xyz[1:])) for shape in shapes]
    return chain(*shapes)


def test_spheres_around_shapes_hide_no_pair():
    robot, rng = crowd(), np.random.default_rng(0)
    candidates = meeting_shapes(robot).pairs
    q = rng.uniform(-1.5, 1.5, (20, 3))
    every = np.array([shape_distances(robot, row, candidates) for row in q])
    assert clearance(robot, q).distance.tolist() == every.min(axis=1).tolist()
    assert (every.min(axis=1) < 0.0).any()


@pytest.mark.bounds
@pytest.mark.nojit
def test_distances_have_the_same_bits_compiled_or_not():
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (10, 3))
    bits = hashlib.sha256(clearance(crowd(), q).distance.tobytes()).hexdigest()[:16]
    assert bits == "6b7bae13328d8c0a"


# --- where it is used ---


def two_arms():
    """Two pendulums beside each other that swing into each other."""
    links = tuple(Link(name, *BODY) for name in ("stand", "left", "right"))
    joints = tuple(
        Joint(name, "revolute", "stand", name, (0.0, y, 0.0), axis=(1.0, 0.0, 0.0), lower=-2.0, upper=2.0)
        for name, y in (("left", 0.3), ("right", -0.3))
    )
    shapes = tuple(Shape(name, Capsule(0.05, 0.5), (0.0, 0.0, -0.25)) for name in ("left", "right"))
    return Model("two arms", links, joints, shapes=shapes)


def test_a_run_records_its_clearance():
    robot = two_arms()
    scene = compile_scene(robot)
    run = simulate(scene, 0.2, initial_state(scene, qd=[1.0, -1.5]), record=("q", "clearance"))
    assert run["clearance"].shape == (len(run["time"]), 1)
    assert run["clearance"][:, 0].tolist() == clearance(robot, run["q"]).distance.tolist()
    assert run["clearance"][0, 0] == pytest.approx(0.5)
    bare = simulate(compile_scene(replace(robot, shapes=())), 0.2, record=("clearance",))
    assert bare["clearance"].shape == (len(bare["time"]), 0)


def test_too_little_clearance_is_a_penalty():
    robot, q = two_arms(), np.array([[0.0, 0.0], [-0.5, 0.3]])
    run = {"base_q": np.zeros((2, 0)), "q": q}
    limits = Constraints(clearance=0.45, clearance_weight=3.0)
    assert limits.weights == {"clearance": 3.0}
    found = limits.violations(robot, run, slice(None), 0.0)
    assert list(found) == ["clearance"]
    assert found["clearance"][:, 0].tolist() == (0.45 - clearance(robot, q).distance).tolist()
    assert found["clearance"][0, 0] == pytest.approx(-0.05)
    assert Constraints().violations(robot, {}, slice(None), 0.0) == {}
