"""Range sensors: closed forms, MuJoCo's rays on the same shapes, mountings, sessions, wrong input."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from featherstone_gait import (
    Box,
    Capsule,
    Cylinder,
    Ground,
    HeightField,
    Hull,
    Joint,
    Link,
    Model,
    Placed,
    RangeSensor,
    Reference,
    SceneModel,
    Session,
    Shape,
    Sphere,
    body,
    compile_scene,
    forward_kinematics,
    load_robot,
    ranges,
    simulate,
)
from featherstone_gait.scene.contact import plane_axes

AHEAD = [[1.0, 0.0, 0.0]]
STILL = {"q": np.zeros((1, 7))}  # of an arm


def wall(geometry, position=(2.0, 0.0, 0.0), orientation=(1.0, 0.0, 0.0, 0.0), ground=None):
    """Return a scene of an arm and an obstacle, and its start."""
    things = [Placed(load_robot("arm7"), "arm", (0.0, 0.0, 5.0))]
    obstacle = Placed(body(geometry, 1.0, base="fixed"), "wall", position, orientation)
    scene = compile_scene(SceneModel("room", things, [obstacle]), ground=ground)
    return scene, STILL


def measured(geometry, sensor, **where):
    return ranges(*wall(geometry, **where), sensor)[-1]


@pytest.mark.nojit
@pytest.mark.parametrize("angle", [-1.2, -0.4, 0.0, 0.9])
def test_a_wall_at_an_angle_is_as_far_as_trigonometry_has_it(angle):
    """Measure the distance of a wall of 0.2 m, 2 m ahead, which is turned by the angle about the vertical."""
    turned = (math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2))
    found = measured(Box((0.2, 8.0, 8.0)), RangeSensor("world", AHEAD), orientation=turned)
    assert found[0] == pytest.approx(2.0 - 0.1 / math.cos(angle), rel=1e-14)


@pytest.mark.nojit
def test_spheres_cylinders_and_capsules_are_met_where_their_equations_have_it():
    offset, r = 0.3, 0.5
    beside = RangeSensor("world", AHEAD, position=(0.0, offset, 0.0))
    reach = 2.0 - math.sqrt(r * r - offset * offset)
    lying = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)  # axis along x
    for geometry in (Sphere(r), Cylinder(r, 1.0), Capsule(r, 1.0)):
        assert measured(geometry, beside)[0] == pytest.approx(reach, rel=1e-14)
    assert measured(Cylinder(r, 1.0), beside, orientation=lying)[0] == pytest.approx(1.5, rel=1e-14)
    assert measured(Capsule(r, 1.0), beside, orientation=lying)[0] == pytest.approx(reach - 0.5, rel=1e-14)
    above = RangeSensor("world", AHEAD, position=(0.0, 0.0, 0.8))
    on_the_end = 2.0 - math.sqrt(r * r - 0.3 * 0.3)
    assert measured(Capsule(r, 1.0), above)[0] == pytest.approx(on_the_end, rel=1e-14)
    assert measured(Cylinder(r, 1.0), above)[0] == math.inf


def test_a_far_ball_is_met_to_rounding():
    """Measure a ball of 1 mm at 100 km; the discriminant of the quadratic equation would lose ten digits."""
    found = measured(Sphere(1e-3), RangeSensor("world", AHEAD, position=(0.0, 6e-4, 0.0)), position=(1e5, 0.0, 0.0))
    assert found[0] == pytest.approx(1e5 - 8e-4, abs=2e-11)


@pytest.mark.nojit
def test_the_reach_the_inside_and_parallel_rays():
    box = Box((1.0, 1.0, 1.0))
    assert measured(box, RangeSensor("world", AHEAD, reach=1.4))[0] == math.inf
    assert measured(box, RangeSensor("world", AHEAD, reach=1.6))[0] == 1.5
    for geometry in (box, Sphere(0.5), Cylinder(0.5, 1.0), Capsule(0.5, 1.0)):
        assert measured(geometry, RangeSensor("world", AHEAD, position=(2.1, 0.1, 0.1)))[0] == 0.0
        assert measured(geometry, RangeSensor("world", AHEAD, position=(3.0, 0.0, 0.0)))[0] == math.inf
    beside = RangeSensor("world", [*AHEAD, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], position=(2.0, 0.6, 0.0))
    assert (measured(box, beside) == math.inf).all()
    up = RangeSensor("world", [[0.0, 0.0, 1.0]], position=(2.0, 0.2, -3.0))  # along the axis of a cylinder
    assert measured(Cylinder(0.5, 1.0), up)[0] == 2.5
    assert measured(Capsule(0.5, 1.0), up)[0] == pytest.approx(2.5 - math.sqrt(0.25 - 0.04), rel=1e-14)


def test_grounds_slopes_steps_and_fields():
    ball, down = Sphere(0.1), [[0.0, 0.0, -1.0]]
    far = {"position": (0.0, 50.0, 0.0)}
    above = RangeSensor("world", down, position=(0.3, 0.1, 2.0))
    assert measured(ball, above, ground=Ground(height=0.4), **far)[0] == pytest.approx(1.6, rel=1e-15)
    normal = plane_axes(Ground(slope=0.2))[0]
    on_slope = normal @ (0.3, 0.1, 2.0) / normal[2]
    assert measured(ball, above, ground=Ground(slope=0.2), **far)[0] == pytest.approx(on_slope, rel=1e-14)
    steps = Ground(steps=((0.2, 0.15), (0.6, -0.4)))
    for x, level in ((0.1, 0.0), (0.3, 0.15), (0.7, -0.25)):
        over = RangeSensor("world", down, position=(x, 0.0, 2.0))
        assert measured(ball, over, ground=steps, **far)[0] == pytest.approx(2.0 - level, rel=1e-14)
    x = np.arange(-1.0, 1.0, 0.1)
    rough = HeightField(np.random.default_rng(0).uniform(0.0, 0.2, (20, 20)), (0.1, 0.1), (-1.0, -1.0))
    nodes = [(0.1 * i - 1.0, 0.1 * j - 1.0) for i in (3, 8) for j in (1, 15)]
    for a, b in nodes:
        found = measured(ball, RangeSensor("world", down, position=(a, b, 3.0)), ground=Ground(field=rough), **far)
        i, j = round(10 * (a + 1.0)), round(10 * (b + 1.0))
        assert found[0] == pytest.approx(3.0 - rough.heights[i, j], rel=1e-12)
    plane = HeightField(np.add.outer(0.3 * x, -0.2 * x), (0.1, 0.1), (-1.0, -1.0))
    for direction in ([0.3, 0.2, -1.0], [-0.7, 0.4, -1.0], [0.0, -0.5, -1.0], [0.5, 0.5, -1.0]):
        d = np.array(direction) / np.linalg.norm(direction)
        found = measured(ball, RangeSensor("world", [direction], position=(0.05, 0.02, 0.5)),
                         ground=Ground(field=plane), **far)  # fmt: skip
        wanted = (0.5 - 0.3 * 0.05 + 0.2 * 0.02) / (0.3 * d[0] - 0.2 * d[1] - d[2])
        assert found[0] == pytest.approx(wanted, rel=1e-12)


def test_flat_hulls_end_at_their_edges_and_lines_are_not_met():
    plate = Hull(((0.0, -0.3, -0.3), (0.0, 0.3, -0.3), (0.0, 0.3, 0.3), (0.0, -0.3, 0.3)))
    rays = [(0.0, 0.29), (0.29, 0.0), (0.0, 0.31), (0.31, 0.0), (5.0, 0.0)]
    for (y, z), wanted in zip(rays, (2.0, 2.0, math.inf, math.inf, math.inf)):
        for direction, origin in (([1.0, 0.0, 0.0], 0.0), ([-1.0, 0.0, 0.0], 4.0)):
            sensor = RangeSensor("world", [direction], position=(origin, y, z))
            assert measured(plate, sensor)[0] == pytest.approx(wanted, abs=1e-12)
    for line in (Hull(((0.0, 0.0, -1.0), (0.0, 0.0, 1.0))), Hull(((0.0, 0.0, 0.0),))):
        assert measured(line, RangeSensor("world", AHEAD, position=(0.0, 1e-9, 0.0)))[0] == math.inf


# ------------------------------------------------------------------------------------------------ MuJoCo


def solids(rng, count, hulls):
    """Yield random shapes with random positions and orientations."""
    makers = (
        lambda: Sphere(rng.uniform(0.1, 0.5)),
        lambda: Box(tuple(rng.uniform(0.1, 0.8, 3))),
        lambda: Capsule(rng.uniform(0.05, 0.3), rng.uniform(0.1, 0.8)),
        lambda: Cylinder(rng.uniform(0.05, 0.4), rng.uniform(0.1, 0.8)),
    )
    for k in range(count):
        turn = rng.normal(size=4)
        geometry = Hull(rng.normal(scale=0.3, size=(12, 3))) if hulls else makers[k % len(makers)]()
        yield geometry, tuple(rng.uniform(-2, 2, 3)), tuple(turn / np.linalg.norm(turn))


def in_mujoco(things):
    """Build a MuJoCo model in which each shape is the only geom of a body."""
    spec = mujoco.MjSpec()
    kinds = mujoco.mjtGeom
    for k, (geometry, position, orientation) in enumerate(things):
        at = spec.worldbody.add_body(pos=position, quat=orientation)
        match geometry:
            case Sphere(radius):
                at.add_geom(type=kinds.mjGEOM_SPHERE, size=[radius, 0, 0])
            case Box(size):
                at.add_geom(type=kinds.mjGEOM_BOX, size=[0.5 * x for x in size])
            case Capsule(radius, length):
                at.add_geom(type=kinds.mjGEOM_CAPSULE, size=[radius, 0.5 * length, 0])
            case Cylinder(radius, length):
                at.add_geom(type=kinds.mjGEOM_CYLINDER, size=[radius, 0.5 * length, 0])
            case _:
                from scipy.spatial import ConvexHull

                points = np.array(geometry.points)
                faces = ConvexHull(points).simplices
                center = points.mean(axis=0)
                outward = [np.dot(np.cross(*(points[f[1:]] - points[f[0]])), points[f[0]] - center) > 0 for f in faces]
                faces = np.array([f if out else f[::-1] for f, out in zip(faces, outward)])
                spec.add_mesh(name=f"mesh{k}", uservert=points.ravel(), userface=faces.ravel())
                at.add_geom(type=kinds.mjGEOM_MESH, meshname=f"mesh{k}")
    m = spec.compile()
    d = mujoco.MjData(m)
    mujoco.mj_kinematics(m, d)
    return m, d


@pytest.mark.parametrize(("hulls", "tolerance"), [(False, 1e-10), (True, 3e-7)])  # its meshes have single precision
def test_random_shapes_are_met_where_mujoco_meets_them(hulls, tolerance):
    rng = np.random.default_rng(1)
    things = list(solids(rng, 24, hulls))
    obstacles = [Placed(body(one, 1.0, base="fixed"), f"thing{k}", *place) for k, (one, *place) in enumerate(things)]
    robots = [Placed(load_robot("arm7"), "arm", (0.0, 0.0, 9.0))]
    scene = compile_scene(SceneModel("room", robots, obstacles))
    (m, d), hits = in_mujoco(things), 0
    for _ in range(20):
        origin, directions = rng.uniform(-3, 3, 3), rng.normal(size=(200, 3))
        found = ranges(scene, STILL, RangeSensor("world", directions, position=tuple(origin)))[-1]
        for along, own in zip(directions / np.linalg.norm(directions, axis=1)[:, None], found):
            far = mujoco.mj_ray(m, d, origin, along, None, 1, -1, np.zeros(1, np.int32))
            if own == 0.0:
                continue  # it begins within a shape, whose far side MuJoCo gives
            assert own == (math.inf if far < 0 else pytest.approx(far, abs=tolerance))
            hits += far > 0
    assert hits > 300


# ------------------------------------------------------------------------------------------------ mounting


def test_a_scanner_on_a_link_turns_with_it_and_does_not_see_the_link():
    arm = load_robot("arm7")
    tip = arm.links[-1].name
    arm = replace(arm, shapes=(Shape(tip, Sphere(0.05)),))
    obstacle = Placed(body(Box((0.2, 40.0, 40.0)), 1.0, base="fixed"), "wall", (3.0, 0.0, 0.0))
    scene = compile_scene(SceneModel("room", [Placed(arm, "arm", (0.0, 0.0, 0.0))], [obstacle]))
    q = np.linspace(0.0, 0.3, 31)[:, None] * np.linspace(1.0, -0.5, 7)
    scanner = RangeSensor.fan(f"arm/{tip}", 0.5, 5)
    found = ranges(scene, {"q": q}, scanner)
    poses = forward_kinematics(arm, q, tip)
    for k, direction in enumerate(scanner.directions):
        along = poses.rotation @ direction
        wanted = (2.9 - poses.position[:, 0]) / along[:, 0]
        ahead = along[:, 0] > 0.1
        np.testing.assert_allclose(found[ahead, k], wanted[ahead], rtol=1e-12)
    assert ahead.any()


def test_a_lidar_sees_out_of_the_housing_of_its_own_robot():
    """On a mast fixed to a base, or turning within its dome, it sees the wall; so it does past shapes beside it.

    A shape of its robot that it does not begin in hides what is behind; one of another robot reads 0.
    """
    links = tuple(Link(name, 1.0, inertia=(0.1, 0.0, 0.0, 0.1, 0.0, 0.1)) for name in ("base", "mast", "head", "arm"))
    joints = (
        Joint("post", "fixed", "base", "mast", xyz=(0.0, 0.0, 0.3)),
        Joint("turn", "revolute", "mast", "head"),
        Joint("swing", "revolute", "base", "arm", xyz=(0.0, 0.5, 0.3)),
    )
    shapes = tuple(Shape(name, Sphere(r)) for name, r in (("base", 0.5), ("mast", 0.1), ("arm", 0.05)))
    robot = Model("car", links, joints, shapes=shapes)
    wall = Placed(body(Box((0.2, 40.0, 40.0)), 1.0, base="fixed"), "wall", (3.0, 0.0, 0.0))
    alone, still = compile_scene(robot), {"q": np.zeros((1, 2))}
    room = compile_scene(SceneModel("room", [Placed(robot, "car", (0.0, 0.0, 0.0))], [wall]))
    for scene, head in ((alone, ""), (room, "car/")):
        for link in ("base", "mast", "head"):
            seen = ranges(scene, still, RangeSensor(f"{head}{link}", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))[0]
            assert seen[0] == (math.inf if scene is alone else pytest.approx(2.9))
            assert seen[1] == (math.inf if link == "base" else pytest.approx(0.45))
        assert ranges(scene, still, RangeSensor("world", [[1.0, 0.0, 0.0]]))[0] == 0.0


def test_a_fan_and_a_cone_are_spread_evenly():
    whole = RangeSensor.fan("world", 2.0 * math.pi, 8)
    turns = np.arctan2(whole.directions[:, 1], whole.directions[:, 0])
    np.testing.assert_allclose(np.diff(np.unwrap(turns)), math.pi / 4, rtol=1e-12)
    cone = RangeSensor.cone("world", 0.6, 400)
    assert cone.nearest
    np.testing.assert_array_equal(cone.directions[0], [1.0, 0.0, 0.0])
    angles = np.arccos(cone.directions[:, 0])
    assert angles.max() == pytest.approx(0.3, rel=1e-12)
    assert (angles < 0.3 / math.sqrt(2.0)).mean() == pytest.approx(0.5, abs=0.02)  # half of the area
    # A sonar beside a wall: the nearest echo is that of the ray that is most across, to the spread of the rays.
    found = measured(Box((0.2, 9.0, 9.0)), replace(cone, rpy=(0.0, 0.0, 0.5)))
    assert found.shape == (1,)
    assert found[0] == pytest.approx(1.9 / math.cos(0.2), rel=5e-3)


def test_a_session_observes_what_a_run_has():
    robot = load_robot("humanoid")
    scene = compile_scene(robot, gearbox="mipsd", ground=Ground())
    trunk = robot.links[0].name
    sensor = RangeSensor(trunk, [[0.3, 0.1, -1.0]], position=(0.3, 0.0, 0.0), name="down")
    session = Session(scene, n=3, observe=("q", sensor))
    for _ in range(3):
        seen = session.step(np.zeros((3, scene.tree.n)))
    assert seen["down"].shape == (3, 1)
    still = Reference([0.0], np.zeros((1, scene.tree.n)))
    run = simulate(scene, 3 * session.tick, reference=still, record=("q", "base_q"), estimate_error=False)
    np.testing.assert_array_equal(seen["down"], np.tile(ranges(scene, run, sensor)[-1], (3, 1)))
    assert np.isfinite(seen["down"]).all()


def test_wrong_sensors_are_named():
    scene, run = wall(Sphere(0.5))
    with pytest.raises(ValueError, match=r"sensor 'range' is on 'trunk'; links: arm/.*world"):
        ranges(scene, run, RangeSensor("trunk", AHEAD))
    with pytest.raises(ValueError, match=r"direction 1 has no length"):
        RangeSensor("world", [*AHEAD, [0.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match=r"expected finite numbers \(rays, 3\)"):
        RangeSensor("world", [1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="reach is -1"):
        RangeSensor("world", AHEAD, reach=-1.0)
    with pytest.raises(ValueError, match=r"angle is 7\.0"):
        RangeSensor.fan("world", 7.0, 3)
    alone = compile_scene(load_robot("arm7"))
    with pytest.raises(ValueError, match=r"channels \['q'\] were not recorded"):
        ranges(alone, {"qd": np.zeros((1, 7))}, RangeSensor("world", AHEAD))
