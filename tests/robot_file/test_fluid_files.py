"""Fluids, propellers, rollers, moving grounds and surfaces in TOML, and what MJCF says that it lacks."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import (
    Box,
    ContactPoint,
    Fluid,
    Ground,
    Hull,
    Immersed,
    Joint,
    Link,
    Model,
    Placed,
    Propeller,
    RobotFileError,
    SceneModel,
    Shape,
    Sphere,
    Surface,
    body,
    load_robot,
    load_scene,
    save_robot,
    save_scene,
)


def boat():
    inertia = (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3)
    links = Link("a", 1.0, (0.0, 0.0, 0.0), inertia), Link("b", 0.3, (0.1, 0.0, 0.0), inertia)
    joint = Joint("j", "continuous", "a", "b", axis=(0.0, 1.0, 0.0))
    matrix = tuple(map(tuple, np.eye(6).tolist()))
    immersed = (
        Immersed("a", Box((0.1, 0.2, 0.3)), (0.0, 0.1, 0.0), drag=(1.0, 2.0, 3.0), added_mass=0.5),
        Immersed("b", Sphere(0.1), added_matrix=matrix, buoyant=False),
        Immersed("b", Hull(((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))),
    )
    wheel = ContactPoint("b", (0.0, 0.0, 0.0), circle_radius=0.1, roller_angle=0.7, roller_friction=0.01)
    return Model(
        "boat", links, (joint,), "floating", contacts=(wheel,), immersed=immersed,
        propellers=(Propeller("j", 1e-4, 1e-6),),
    )  # fmt: skip


def test_a_saved_robot_floats_and_rolls_as_before(tmp_path):
    model = boat()
    save_robot(model, tmp_path / "boat.urdf")
    again = load_robot(tmp_path / "boat.urdf")
    assert again.immersed == model.immersed
    assert again.propellers == model.propellers
    assert again.contacts == model.contacts


def test_a_scene_states_fluid_and_motion_of_its_ground(tmp_path):
    save_robot(boat(), tmp_path / "boat.urdf")
    text = """
        [fluid]
        level = 0.5
        current = [0.1, 0.0, 0.0]
        [ground]
        velocity = [1.0, 0.0]
        turning = 0.5
        [[robots]]
        file = "boat.urdf"
    """
    (tmp_path / "pond.toml").write_text(text)
    scene = load_scene(tmp_path / "pond.toml")
    assert scene.fluid == Fluid(level=0.5, current=(0.1, 0.0, 0.0))
    assert (scene.ground.velocity, scene.ground.turning) == ((1.0, 0.0), 0.5)


def test_surfaces_of_links_and_obstacles_stand_in_toml_and_mjcf(tmp_path):
    track, belt = Surface((-0.5, 0.0, 0.1), (0.0, 0.2, 0.0), (0.1, 0.0, 0.0), "left", 0.5), Surface((1.0, 0.0, 0.0))
    hull = Shape("a", Box((0.2, 0.2, 0.2)), (0.0, 0.1, 0.0), (0.3, 0.0, 0.5), name="hull", surface=track)
    point = ContactPoint("b", (0.0, 0.0, 0.0), 0.1, surface=belt)
    model = replace(boat(), shapes=(hull,), contacts=(point,), immersed=(), propellers=())
    save_robot(model, tmp_path / "tank.urdf")
    again = load_robot(tmp_path / "tank.urdf")
    assert again.shapes[0].surface == track
    assert again.contacts == model.contacts
    text = """
        [[robots]]
        file = "tank.urdf"
        [[obstacles]]
        name = "conveyor"
        shape = "box"
        size = [1.0, 1.0, 0.1]
        surface = {velocity = [1.0, 0.0, 0.0]}
    """
    (tmp_path / "hall.toml").write_text(text)
    scene = load_scene(tmp_path / "hall.toml")
    assert scene.obstacles[0].model.shapes[0].surface == belt
    for wrong in ("surface = 3", "surface = {speed = 1.0}", 'surface = {velocity = [1.0, "x", 0.0]}'):
        (tmp_path / "hall.toml").write_text(text.replace("surface = {velocity = [1.0, 0.0, 0.0]}", wrong))
        with pytest.raises(RobotFileError, match=r"line 8.*surface"):
            load_scene(tmp_path / "hall.toml")
    save_scene(scene, tmp_path / "hall.xml")
    pytest.importorskip("mujoco")
    read = load_scene(tmp_path / "hall.xml")
    found = {shape.surface.drive: shape for one in read.all for shape in one.model.shapes if shape.surface}
    assert [*found] == ["left", ""]
    assert read.members[0].model.contacts[-1] == point
    for name, shape in found.items():
        of = track if name == "left" else belt
        for x in ((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)):
            np.testing.assert_allclose(_at(shape.surface, x), _at(of, x), atol=1e-12)


BELT = Surface((1.0, 0.0, 0.0), drive="belt", command=0.0)


@pytest.mark.parametrize(
    ("moving", "rest"), [((BELT, BELT), True), ((BELT, None), True), ((None, Surface()), False), ((BELT, BELT), False)]
)
def test_surfaces_that_differ_on_a_link_are_saved_as_they_are(tmp_path, moving, rest):
    """Each shape and each contact point of a link keeps its own surface, or none."""
    box = Box((0.2, 0.2, 0.2))
    shapes = tuple(Shape("a", box, (0.3 * k, 0.0, 0.0), surface=one) for k, one in enumerate(moving))
    points = ContactPoint("a", (0.0, 0.0, -0.1), surface=BELT), ContactPoint("a", (0.1, 0.0, -0.1))
    links = Link("a", 1.0, inertia=(0.1, 0.0, 0.0, 0.1, 0.0, 0.1)), Link("b")
    joint = Joint("j", "fixed", "a", "b")
    model = Model("tank", links, (joint,), "floating", shapes=shapes, contacts=points[: 1 + rest])
    save_robot(model, tmp_path / "tank.urdf")
    again = load_robot(tmp_path / "tank.urdf")
    assert [shape.surface for shape in again.shapes] == list(moving)
    assert again.contacts == model.contacts


def test_lists_of_surfaces_have_one_for_each_shape(tmp_path):
    shapes = tuple(Shape("a", Box((0.2, 0.2, 0.2)), surface=one) for one in (BELT, None))
    link = Link("a", 1.0, inertia=(0.1, 0.0, 0.0, 0.1, 0.0, 0.1))
    save_robot(Model("tank", (link,), (), shapes=shapes), tmp_path / "tank.urdf")
    text = (tmp_path / "tank.toml").read_text()
    for wrong, says in (("{}, {}]", r"links\.a.*3 surfaces.*2 shapes"), ("3]", r"line \d+: links\.a: surface")):
        (tmp_path / "tank.toml").write_text(text.replace("{}]", wrong))
        with pytest.raises(RobotFileError, match=says):
            load_robot(tmp_path / "tank.urdf")


def test_mjcf_says_that_it_loses_drives_and_commands_of_surfaces(tmp_path):
    link, box = Link("a", 1.0, inertia=(0.1, 0.0, 0.0, 0.1, 0.0, 0.1)), Box((0.2, 0.2, 0.2))
    shapes = Shape("a", box, surface=BELT), Shape("a", box, (0.3, 0.0, 0.0), surface=Surface((1.0, 0.0, 0.0)))
    still = Model("tank", (link,), (), "floating", shapes=(Shape("a", box),))
    save_robot(still, tmp_path / "tank.xml")
    assert "drives" not in (tmp_path / "tank.xml").read_text()
    save_robot(replace(still, shapes=shapes), tmp_path / "tank.xml")
    hall = SceneModel("hall", [Placed(replace(still, shapes=shapes), "tank", (0.0, 0.0, 1.0))])
    save_scene(hall, tmp_path / "hall.xml")
    for file in ("tank.xml", "hall.xml"):
        text = (tmp_path / file).read_text()
        assert "left out the drives belt, a " in text
        assert "whose first command is 0, of the drives belt " in text


@pytest.mark.parametrize("geometry", [Sphere(0.1), None])
def test_what_rolls_is_slowed_down_in_mujoco_by_what_is_saved(tmp_path, geometry):
    """A solid ball and a wheel lose rho g m / (m r + I / r) of their speed in a second."""
    mujoco, rho, r = pytest.importorskip("mujoco"), 2e-3, 0.1
    rim = ContactPoint("body", (0.0, 0.0, 0.0), circle_radius=r, axis=(0.0, 1.0, 0.0), rolling_friction=rho)
    link = Link("body", 1.0, inertia=(4e-3, 0.0, 0.0, 4e-3, 0.0, 4e-3))
    wheel = Model("body", (link,), (), "floating", contacts=(rim,))
    ball, ground = wheel if geometry is None else body(geometry, 1.0, rolling_friction=rho), Ground(penetration=1e-4)
    save_robot(ball, tmp_path / "robot.xml", ground)
    save_scene(SceneModel("x", [Placed(ball, "ball", (0.0, 0.0, r))], ground=ground), tmp_path / "scene.xml")
    for file in ("robot.xml", "scene.xml"):
        m = mujoco.MjModel.from_xml_path(str(tmp_path / file))
        d, m.opt.timestep = mujoco.MjData(m), 1e-3
        d.qpos[2], d.qvel[0], d.qvel[4] = r - 1e-4, 0.5, 0.5 / r
        mujoco.mj_step(m, d, 1000)
        assert 0.5 - d.qvel[0] == pytest.approx(rho * 9.81 / (1.4 * r), rel=2e-3)
    chosen = None if geometry is None else "all"
    robot, scene = load_robot(tmp_path / "robot.xml", contacts=chosen), load_scene(tmp_path / "scene.xml")
    for again in (robot, scene.members[0].model):
        assert {point.rolling_friction for point in again.contacts} == {rho}


def _at(surface, x):
    """Return the velocity of a surface at a place."""
    return surface.command * (surface.velocity + np.cross(surface.turning, np.subtract(x, surface.center)))


def test_mjcf_says_what_it_lacks(tmp_path):
    model, ground = boat(), Ground(turning=0.5)
    save_robot(model, tmp_path / "boat.xml", ground)
    text = (tmp_path / "boat.xml").read_text()
    for lost in ("immersed shapes", "propellers", "rollers of wheels"):
        assert f"left out {lost}" in text
    save_scene(SceneModel("pond", [Placed(model)], ground=ground, fluid=Fluid(900.0)), tmp_path / "pond.xml")
    text = (tmp_path / "pond.xml").read_text()
    assert "left out the fluid of density 900.0" in text
    assert 'surfacevel="0.0 0.0 0.0 0.0 0.0 0.5"' in text
