"""What is saved comes back field by field, or the warning of the writer names it, and strict refuses."""

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import published
import pytest
from same_model import differences, same_places

from featherstone_gait import (
    Box,
    ContactPoint,
    ContactSensor,
    Controller,
    Fluid,
    ForceTorqueSensor,
    Ground,
    HeightField,
    Immersed,
    Joint,
    Link,
    Model,
    Placed,
    RangeSensor,
    RobotFileError,
    RobotFileWarning,
    SceneModel,
    Servo,
    Shape,
    Sphere,
    body,
    load_robot,
    load_scene,
    robot_names,
    save_robot,
    save_scene,
    scene_names,
)

mujoco = pytest.importorskip("mujoco")
PUBLISHED = [
    *(("dm_control", f"suite/{name}.xml") for name in ("acrobot", "cheetah", "fish", "humanoid", "manipulator", "dog")),
    *(("dm_control", f"suite/{name}.xml") for name in ("ball_in_cup", "hopper", "quadruped", "stacker", "swimmer")),
    ("dm_control", "suite/walker.xml"),
    ("example-robot-data", "bolt_description/robots/bolt.urdf"),
    ("example-robot-data", "panda_description/urdf/panda.urdf"),
    ("example-robot-data", "so_arm_description/urdf/so101.urdf"),
    ("example-robot-data", "solo_description/robots/solo12.urdf"),
    ("example-robot-data", "talos_data/robots/talos_reduced.urdf"),
    ("example-robot-data", "ur_description/urdf/ur5_robot.urdf"),
    *(("pybullet_data", f"{name}.urdf") for name in ("laikago/laikago", "quadruped/quadruped", "racecar/racecar")),
]
IDS = [f"{Path(name).suffix[1:]}-{Path(name).stem}" for _, name in PUBLISHED]
QUICK = ("*acrobot", "*humanoid", "*manipulator", "*swimmer", "*bolt", "*solo12", "*so101")


def quiet(load, path, **how):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RobotFileWarning)
        return load(path, **how)


def saved(save, what, path):
    """Save it, and return what the warning says."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        save(what, path)
    assert len(caught) <= 1
    assert all(issubclass(one.category, RobotFileWarning) for one in caught)
    said = str(caught[0].message) if caught else ""
    if said:
        path.unlink()
        with pytest.raises(RobotFileError) as refused:
            save(what, path, strict=True)
        assert not path.exists()
        assert all(problem.partition(";")[0] in said for problem in refused.value.problems)
        with pytest.warns(RobotFileWarning):
            save(what, path)
    else:
        save(what, path, strict=True)
    return said


def assert_named(one, other, said):
    """Every difference is one of a part that the warning names."""
    for place, before, after in differences(one, other):
        names = [name for name in re.findall(r"\['([^']+)'\]", place) if name not in ("links", "joints", "shapes")]
        held = "held" in said and ("['joints']" in place or "['locked']" in place)  # welded, they are fixed joints
        assert held or any(name in said for name in names), (place, before, after, said)


@pytest.mark.parametrize("suffix", [".urdf", ".xml"])
@pytest.mark.parametrize("name", robot_names())
def test_packaged_robots_come_back_or_the_warning_names_what_does_not(name, suffix, tmp_path):
    model = load_robot(name)
    said = saved(save_robot, model, tmp_path / f"robot{suffix}")
    assert bool(said) == (suffix == ".xml")  # the gearbox or the controller of each is beyond MuJoCo
    again = quiet(load_robot, tmp_path / f"robot{suffix}")
    assert_named(model, again, said)
    assert again.servos == model.servos
    assert [*map(vars, again.contacts)] == [*map(vars, model.contacts)]
    assert same_places(model, again) < 1e-12


@pytest.mark.quick(*QUICK)
@pytest.mark.parametrize(("package", "name"), PUBLISHED, ids=IDS)
def test_published_robots_come_back_or_the_warning_names_what_does_not(package, name, tmp_path):
    model = quiet(load_robot, published.folder(package) / name)
    said = saved(save_robot, model, tmp_path / "robot.xml")
    again = quiet(load_robot, tmp_path / "robot.xml")
    assert_named(model, again, said)
    assert [joint.velocity for joint in again.moving_joints] == [
        next(one.velocity for one in model.moving_joints if one.name == joint.name) for joint in again.moving_joints
    ]
    assert same_places(model, again) < 1e-12


@pytest.mark.parametrize("name", scene_names())
def test_packaged_scenes_come_back_or_the_warning_names_what_does_not(name, tmp_path):
    scene = load_scene(name)
    said = saved(save_scene, scene, tmp_path / "scene.xml")
    again = quiet(load_scene, tmp_path / "scene.xml")
    assert again.gravity == (0.0, 0.0, -9.81)  # the default, which the file states
    assert {*scene.excluded} <= {*again.excluded}  # with the ground, which links with contact points do not touch
    places = [tuple(replace(at, position=(*at.position[:2], 0.0)) for at in x.members) for x in (scene, again)]
    one, other = (replace(x, gravity=None, excluded=(), members=members) for x, members in zip((scene, again), places))
    assert_named(one, other, said)


def test_what_a_comparison_of_models_finds():
    """Each field of joints, links and contact points, and what lies elsewhere."""
    model = load_robot("ax12_arm")
    first = model.joints[0]
    changed = [
        replace(model, joints=(replace(first, velocity=1.0), *model.joints[1:])),
        replace(model, joints=(replace(first, xyz=(1.0, 0.0, 0.0)), *model.joints[1:])),
        replace(model, servos={}),
        replace(model, contacts=(ContactPoint(model.root, (0.0, 0.0, 0.0)),)),
        replace(model, sensors=(ForceTorqueSensor(model.root),)),
    ]
    assert all(len([*differences(model, other)]) >= 1 for other in changed)
    assert same_places(model, changed[1]) == pytest.approx(1.0)
    assert not [*differences(model, load_robot("ax12_arm"))]


# ------------------------------------------------------------------------------------------------ what MuJoCo has


BALL = (0.004, 0.0, 0.0, 0.004, 0.0, 0.004)


def test_a_fluid_of_mujocos_laws_is_mujocos(tmp_path):
    """A box and an ellipsoid fall in water that flows; saved, they slow down as in the file that was read."""
    file = tmp_path / "water.xml"
    file.write_text("""<mujoco><option density="800" viscosity="0.01" wind="0.1 0 0"/><worldbody>
        <body name="box" pos="0 0 1"><freejoint/><geom type="box" size=".1 .2 .05" density="1500"/></body>
        <body name="egg" pos="1 0 1" euler="20 10 0"><freejoint/>
          <geom type="ellipsoid" size=".1 .2 .05" density="1500" fluidshape="ellipsoid"/></body>
        </worldbody></mujoco>""")
    scene = quiet(load_scene, file)
    assert not saved(save_scene, scene, tmp_path / "again.xml")
    assert load_scene(tmp_path / "again.xml").fluid == scene.fluid
    found = []
    for each in (file, tmp_path / "again.xml"):
        m = mujoco.MjModel.from_xml_path(str(each))
        d = mujoco.MjData(m)
        mujoco.mj_step(m, d, 200)
        found.append(d.qvel.copy())
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)


def test_a_fluid_that_lifts_is_named_and_comes_back(tmp_path):
    hull = Immersed("body", Sphere(0.1), name="float", drag=0.4)
    ball = replace(body(Sphere(0.1), 1.0, name="ball"), immersed=(hull,))
    scene = SceneModel("pond", [Placed(ball, position=(0.0, 0.0, 0.0))], fluid=Fluid(900.0, level=0.5))
    said = saved(save_scene, scene, tmp_path / "pond.xml")
    assert "fluid of density 900.0" in said
    assert "immersed shapes on links: body" in said
    again = load_scene(tmp_path / "pond.xml")
    assert again.fluid == scene.fluid
    assert again.members[0].model.immersed == (hull,)
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "pond.xml")).opt.density == 0.0


def test_a_height_field_of_an_obstacle_is_no_ground(tmp_path):
    field = HeightField(np.array([[0.0, 0.1], [0.2, 0.0]]), (1.0, 1.0), (-0.5, -0.5))
    hill = Model("hill", (Link("body"),), (), shapes=(Shape("body", field, name="field"),))
    ball = Placed(body(Sphere(0.1), 1.0, name="ball"), position=(0.0, 0.0, 1.0))
    for ground in (None, Ground(0.4, penetration=1e-3, damping_ratio=0.5)):
        scene = SceneModel("x", [ball], [Placed(hill, "hill", (0.3, 0.0, 0.1))], ground, pairs="all")
        save_scene(scene, tmp_path / "x.xml", strict=True)
        again = load_scene(tmp_path / "x.xml")
        assert again.ground == ground
        (shape,) = again.obstacles[0].model.shapes
        np.testing.assert_allclose(shape.geometry.heights, field.heights, atol=1e-7)


def test_forces_touch_and_rays_are_sensors_of_mujoco(tmp_path):
    """A ball of 1 kg, fixed to another of 1 kg that lies on the floor, 0.5 m below a ceiling."""
    low, high = (Link(name, 1.0, inertia=BALL) for name in ("low", "high"))
    weld = Joint("weld", "fixed", "low", "high", (0.0, 0.0, 0.3))
    sensors = (
        ForceTorqueSensor("high", rpy=(0.0, np.pi, 0.0)),
        ContactSensor("low"),
        RangeSensor("high", [[0.0, 0.0, 2.0]], (0.0, 0.0, 0.1), reach=3.0),
        RangeSensor("world", [[0.0, 0.0, 1.0]], (2.0, 0.0, 0.0), name="beside"),
    )
    shapes = tuple(Shape(name, Sphere(0.1)) for name in ("low", "high"))
    model = Model("balls", (low, high), (weld,), "floating", shapes=shapes, sensors=sensors)
    save_robot(model, tmp_path / "balls.xml", Ground())
    again = load_robot(tmp_path / "balls.xml")
    assert not [*differences(model, again)]
    text = (tmp_path / "balls.xml").read_text()
    roof = '<geom type="box" size="1 1 .1" pos="0 0 1.1"/></worldbody>'
    m = mujoco.MjModel.from_xml_string(text.replace("</worldbody>", roof))
    d = mujoco.MjData(m)
    d.qpos[2] = 0.1
    mujoco.mj_step(m, d, 2000)
    read = {m.sensor(k).name: d.sensordata[m.sensor_adr[k] :][: m.sensor_dim[k]] for k in range(m.nsensor)}
    np.testing.assert_allclose(read["force"], (0.0, 0.0, -9.81), atol=1e-6)
    assert read["contact"] == pytest.approx(2 * 9.81, rel=1e-6)
    assert read["range"] == pytest.approx(1.0 - 0.5, abs=1e-3)
    assert read["beside"] == -1.0
    bare = re.sub("<custom>.*</custom>", "", text, flags=re.DOTALL)
    (tmp_path / "bare.xml").write_text(bare)
    for one, other in zip(model.sensors, quiet(load_robot, tmp_path / "bare.xml").sensors):
        assert (type(one), one.link, one.name) == (type(other), other.link, other.name)
        if isinstance(one, RangeSensor):
            np.testing.assert_allclose(other.mounted, one.mounted, atol=1e-12)
            assert other.reach == one.reach


def test_a_servo_comes_back_with_the_friction_of_its_joint(tmp_path):
    links = Link("a", 1.0, inertia=BALL), Link("b", 1.0, inertia=BALL)
    joint = Joint("j", "revolute", "a", "b", lower=-1.0, upper=1.0, velocity=3.0, effort=2.0, damping=0.1, friction=0.2)
    servo = Servo(Controller("pd", Kp=2.0, Kd=0.1), viscous_friction=0.3, coulomb_friction=0.4)
    model = Model("m", links, (joint,), servos={"j": servo})
    said = saved(save_robot, model, tmp_path / "m.xml")
    assert "stand with the joint: j" in said or "servos j" in said
    again = load_robot(tmp_path / "m.xml")
    assert again.joints == model.joints
    assert again.servos == model.servos


def test_a_text_that_fits_no_robot_is_refused_with_a_remedy(tmp_path):
    save_robot(load_robot("ax12_arm"), tmp_path / "arm.xml")
    text = (tmp_path / "arm.xml").read_text()
    for old, new in (("servos.joints.", "servos.joins."), ("geoms", "geom"), ("law = ", "law == ")):
        if old in text:
            (tmp_path / "arm.xml").write_text(text.replace(old, new))
            with pytest.raises(RobotFileError, match="remove the <text>"):
                load_robot(tmp_path / "arm.xml")


def test_what_urdf_does_not_state_is_named_and_refused(tmp_path):
    field = HeightField(np.zeros((2, 2)), (1.0, 1.0))
    shapes = Shape("a", field, name="hill"), Shape("a", Box((1.0, 1.0, 1.0)), name="box", friction=0.3, priority=2)
    model = Model("m", (Link("a"),), (), shapes=shapes)
    with pytest.warns(RobotFileWarning, match="HeightField.*'hill of link a'"):
        save_robot(model, tmp_path / "m.urdf")
    assert load_robot(tmp_path / "m.urdf").shapes == shapes[1:]
    with pytest.raises(RobotFileError, match="hill"):
        save_robot(model, tmp_path / "n.urdf", strict=True)
    assert not (tmp_path / "n.urdf").exists()
    assert not (tmp_path / "n.toml").exists()
