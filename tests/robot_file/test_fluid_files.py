"""Fluids, propellers, rollers and moving grounds in TOML, and what MJCF says that it lacks."""

import numpy as np

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
    SceneModel,
    Sphere,
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


def test_mjcf_says_what_it_lacks(tmp_path):
    model, ground = boat(), Ground(turning=0.5)
    save_robot(model, tmp_path / "boat.xml", ground)
    text = (tmp_path / "boat.xml").read_text()
    for lost in ("immersed shapes", "propellers", "rollers of wheels", "velocity of the ground"):
        assert f"left out {lost}" in text or f"left out the {lost}" in text
    save_scene(SceneModel("pond", [Placed(model)], ground=ground, fluid=Fluid(900.0)), tmp_path / "pond.xml")
    text = (tmp_path / "pond.xml").read_text()
    assert "left out the fluid of density 900.0" in text
    assert "left out the velocity of the ground" in text
