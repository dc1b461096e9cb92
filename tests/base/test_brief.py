"""Public objects print short lines at the prompt, with the figures that identify them."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import featherstone_gait as fg
from featherstone_gait.base.brief import brief, in_full
from featherstone_gait.optimize import OptimizeOptions
from featherstone_gait.walking import BIOLOID_WALK, Gait, Motion, mirror_of

LONGEST = 450  # characters


@pytest.fixture(scope="module")
def humanoid():
    return fg.load_robot("humanoid")


@pytest.fixture(scope="module")
def scene(humanoid):
    return fg.compile_scene(humanoid, "mipsd", fg.Ground())


def of_models(robot: fg.Model) -> Iterator[Any]:
    """Yield a robot, its parts, and what else a scene is made of."""
    servo = next(iter(robot.servos.values()))
    corners = tuple(map(tuple, np.random.default_rng(1).normal(size=(400, 3)).tolist()))
    field = fg.HeightField(np.zeros((300, 200)), (0.01, 0.01))
    yield from (robot, *robot.links, *robot.joints, *robot.contacts, *robot.shapes)
    yield from (servo, servo.gearbox, servo.controller, fg.Supply(11.1, 0.1), fg.Mimic("knee"), field)
    yield from (fg.Ground(field=field), fg.Ground(steps=tuple((0.1 * k, 0.01) for k in range(1, 60))))
    yield fg.Loop("pin", "connect", "trunk", "left_foot", (0.1, 0.0, 0.0))
    yield from (fg.Via("trunk"), fg.Wrap("trunk", "sphere", 0.1))
    yield fg.Tendon("strap", (), [fg.Via("trunk"), fg.Via("left_foot")] * 300, stiffness=100.0)
    yield fg.Surface((0.5, 0.0, 0.0))
    yield from (fg.Fluid(), fg.Propeller("knee", 1e-5), fg.Immersed("trunk", fg.Sphere(0.1), drag=(1.0, 2.0, 3.0)))
    yield from (fg.RangeSensor.fan("trunk", 1.0, 300), fg.LineSensor("trunk", [(0.0, 0.0, 0.0)] * 300))
    yield from (fg.ForceTorqueSensor("trunk"), fg.ContactSensor("trunk", 0.1))
    yield from (fg.FloorLine([(0.01 * k, 0.0) for k in range(300)]), fg.SampledSensor("q", noise=[0.1] * 300))
    yield from (fg.Spring("trunk", "left_foot", stiffness=100.0), fg.PairContact([("trunk", "left_foot")] * 300))
    yield fg.PairFriction("robot/trunk", "robot/left_foot", 0.3, rolling_friction=1e-3)
    yield from (fg.Box((1.0, 1.0, 1.0)), fg.Sphere(0.1), fg.Capsule(0.1, 0.2), fg.Cylinder(0.1, 0.2))
    yield from (fg.Placed(robot), fg.SceneModel("many", [fg.Placed(robot, f"robot {k}") for k in range(300)]))
    yield from (fg.Hull(corners), fg.Mesh("folder/" * 40 + "trunk.stl"), fg.Shape("trunk", fg.Hull(corners)))


def of_results(scene: fg.CompiledScene) -> Iterator[Any]:
    """Yield what functions return, as large as for a humanoid; arrays that take long to compute hold zeros."""
    robot, n, m = scene.model, 76, 25
    q = np.concatenate([[0.0, 0.0, 0.3, 1.0], np.zeros(m - 3)])
    matrices = [np.zeros(shape) for shape in ((n, n), (n, m), (n, n), (n, m)) * 2]
    names = tuple(f"q left_joint_{k}" for k in range(n))
    jump = fg.Discontinuity(names[0], names, np.zeros(n), np.zeros(n))
    yield jump
    yield fg.Linearization(*matrices, names, names[:m], names, (jump,) * 40, np.zeros(n), 0.01, np.zeros(400), None)
    yield fg.Gradient(1.0, {"reference": np.zeros((n, m))}, fg.Trajectory({}, "ok", "", 1.0, q))
    yield from (fg.run_cost(lambda q: q[-1, 0]), fg.RunObjective(scene, 1.0, fg.run_cost(lambda q: q[-1, 0]), dict))
    yield fg.Trim(q, q[7:], np.zeros((8, 3)), q[7:], None, np.zeros(400), 1e-9, 0.0, "ok", "it leans " * 50)
    yield from (fg.forward_kinematics(robot, q), fg.coupling_matrix(robot), fg.energy(robot, q, np.zeros(m)))
    yield fg.IndependentCoordinates(np.arange(m), np.zeros((n, m)), np.zeros(n))
    yield fg.energy(robot, np.tile(q, (300, 1)), np.zeros((300, m)))
    yield from (fg.IKResult(q, "ok", 1e-9, 7), fg.Target("left_foot", (0.0, 0.04, 0.0), rotation=np.eye(3)))
    yield from (fg.Wrench((0.0, 0.0, 1.0)), fg.Clearance(np.zeros(500), np.zeros((500, 2), int)))
    yield fg.Push("trunk", (0.0, 10.0, 0.0), start=0.1, end=0.2)
    yield fg.Reference(np.arange(900.0), np.zeros((900, m)))
    law = fg.Distribution("uniform", 0.1)
    yield from (law, fg.Worlds(1000, servos={name: law for name in ("Kp", "resistance", "ratio")}, seed=3))
    yield from (scene, fg.Session(scene, 8), fg.Status.FELL)
    run = {name: np.zeros((50, m, 8)) for name in ("time", *scene.parts)}
    yield fg.Trajectory(run, "fell", "the trunk is low " * 30, 1.0, np.zeros(400), parts=scene.parts)
    yield fg.StateView(fg.initial_state(scene), scene.parts)
    yield fg.ContactHistory(np.zeros(900), np.zeros((900, 3)), np.zeros(900), np.zeros(900))


def of_walks(robot: fg.Model) -> Iterator[Any]:
    """Yield what gaits and their searches are made of."""
    gait = Gait(robot.joint_names, np.zeros((8, len(robot.joint_names))), 0.64, mirror_of(robot))
    yield from (gait, BIOLOID_WALK, OptimizeOptions(), Motion(robot.joint_names, np.zeros((99, 19)), *[gait.poses] * 2))


def test_every_public_class_prints_a_short_line(humanoid, scene):
    found = [*of_models(humanoid), *of_results(scene), *of_walks(humanoid)]
    public = {value for value in (getattr(fg, name) for name in fg.__all__) if isinstance(value, type)}
    assert {kind for kind in public if not issubclass(kind, Exception)} <= {type(one) for one in found}
    assert [type(one).__name__ for one in found if len(repr(one)) > LONGEST] == []
    assert [type(one).__name__ for one in found if "\n" in repr(one) and not isinstance(one, np.ndarray)] == []


def test_a_line_has_the_figures_of_a_robot_and_its_parts(humanoid):
    text = repr(humanoid)
    assert "humanoid" in text
    for figure in ("floating", "2.423 kg", "19 moving joints", "19 servos", "8 contact points"):
        assert figure in text
    assert repr(fg.Ground(friction=0.7)) == "Ground(friction=0.7, penetration=0.0005, damping_ratio=0.7)"
    assert repr(fg.Sphere(0.25)) == "Sphere(radius=0.25)"
    assert "lower=-1.71042" in repr(humanoid.joint("left_knee"))
    assert "stiffness=25" in repr(humanoid.servos["left_knee"])


def test_robots_that_differ_in_one_digit_differ_in_full(humanoid):
    joints = [replace(joint, damping=joint.damping + 1e-15) for joint in humanoid.joints[:1]]
    other = replace(humanoid, joints=(*joints, *humanoid.joints[1:]))
    assert in_full(other) != in_full(humanoid)
    assert in_full(replace(humanoid)) == in_full(humanoid)
    assert repr(other) == repr(humanoid)
    assert brief(other.joints[1]) in repr(other.joints[1])
