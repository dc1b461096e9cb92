"""Robots with objects, here and in MuJoCo: what MuJoCo is given, a box that is carried, balls that hit, a board."""

import numpy as np
import published
import pytest

from featherstone_gait.base.rotation import rotation_from_quaternion
from featherstone_gait.benchmark import objects as study
from featherstone_gait.dynamics import forward_kinematics

ENGINES = sorted(study.ENGINES)


def test_the_box_lies_on_both_forearms():
    task = study.carry(2.0)
    model = task.model
    standing = study.standing(task.alone, task.angles, 0.0)
    poses = forward_kinematics(model, standing[None])
    for name in task.links:
        (shape,) = (shape for shape in model.shapes if shape.link == name)
        row = [link.name for link in model.links].index(name)
        half = 0.5 * np.abs(poses.rotation[0, row]) @ np.array(shape.geometry.size)
        middle = poses.position[0, row] + poses.rotation[0, row] @ np.array(shape.xyz)
        assert middle[2] + half[2] == pytest.approx(task.place[2] - 0.5 * task.shape.size[2], abs=1e-9)
        assert abs(middle[0] - task.place[0]) < 0.5 * task.shape.size[0]
        assert abs(middle[1]) + half[1] < 0.5 * task.shape.size[1]


def test_a_ball_flies_at_the_trunk():
    """It meets the middle of the trunk's side, after the gap that is stated."""
    for origin in study.WAYS:
        task = study.hit(origin, 0.2)
        assert task.mass * np.linalg.norm(task.velocity) == pytest.approx(0.2)
        trunk = next(shape for shape in task.model.shapes if shape.link == task.model.root)
        middle = study.standing(task.alone, task.angles, 0.0)[:3] + np.array(trunk.xyz)
        way = np.array(task.velocity) / study.SPEED
        gap = way @ (middle - np.array(task.place)) - 0.5 * np.abs(way) @ np.array(trunk.geometry.size) - study.BALL
        assert gap == pytest.approx(study.APART)
        assert np.cross(middle - np.array(task.place), way) == pytest.approx(np.zeros(3), abs=1e-12)


@pytest.mark.parametrize("origin", study.WAYS)
def test_another_humanoid_comes_with_its_arms_at_the_shoulders(origin):
    """After the gap that is stated, at the height of the shoulders."""
    task = study.push(origin, 0.5)
    assert task.other.mass * np.linalg.norm(task.velocity) == pytest.approx(0.5)
    way = np.array(task.velocity) / np.linalg.norm(task.velocity)
    turn = rotation_from_quaternion(np.array(task.turn))
    assert turn[:, 0] == pytest.approx(way, abs=1e-12)
    sides = ("left",) if origin == "left" else ("left", "right")
    arms = [study._spot(task.other, f"{side}_forearm") for side in sides]
    tip = np.mean([np.array(task.place) + turn @ (at + size * [1.0, 0.0, 0.0]) for at, size in arms], axis=0)
    shoulders = [study._spot(task.model, f"{side}_shoulder_block") for side in sides]
    middle = study.standing(task.alone, task.angles, 0.0)[:3] + np.mean([at for at, _ in shoulders], axis=0)
    gap = way @ (middle - tip)
    assert gap - np.abs(way) @ shoulders[0][1] == pytest.approx(study.APART)
    assert middle - tip == pytest.approx(gap * way, abs=1e-12)


def test_another_humanoid_that_misses_glides_on_in_mujoco():
    pytest.importorskip("mujoco")
    task = study.push("behind", 0.5)
    run, other = study.in_mujoco(study.replace(task, velocity=(-0.3, 0.0, 0.0), duration=0.3))
    assert other[-1, :3] == pytest.approx(np.array(task.place) - [0.3 * run["time"][-1], 0.0, 0.0], abs=1e-9)


def test_an_object_that_misses_falls_freely_in_mujoco():
    pytest.importorskip("mujoco")
    task = study.hit("ahead", 0.2)
    away = study.replace(task, velocity=(2.0, 0.0, 0.0), duration=0.3)
    run, ball = study.in_mujoco(away)
    t = run["time"]
    expected = np.array(task.place) + np.outer(t, [2.0, 0.0, 0.0]) - np.outer(t * (t + study.STEP), [0.0, 0.0, 4.905])
    np.testing.assert_allclose(ball[:, :3], expected, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("engine", ENGINES)
def test_rubber_keeps_the_box_on_the_arms(engine):
    """It slips less than 1 mm; on bare arms it slips more than twice as much."""
    pytest.importorskip("mujoco")
    rubber, bare = (study.carried(study.carry(friction), engine) for friction in (study.RUBBER, study.FRICTION))
    assert rubber.stands
    assert bare.stands
    assert rubber.moved < 1e-3
    assert bare.moved > 2.0 * rubber.moved


@pytest.mark.long
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("make", "origin", "least"), [(study.hit, "ahead", 0.2), (study.push, "behind", 0.4)])
def test_a_light_blow_is_survived_and_a_heavy_one_is_not(make, origin, least, engine):
    """A ball, or another humanoid, pushes the walking one and is slower afterwards."""
    pytest.importorskip("mujoco")
    for momentum, stands in ((least, True), (2.0, False)):
        task = make(origin, momentum)
        run, thing = study.ENGINES[engine](task)
        assert (run.status == "ok") is stands
        assert abs(thing[-1, 0] - thing[0, 0]) < 0.9 * abs(task.velocity[0]) * run.end_time


@pytest.mark.long
@pytest.mark.parametrize("engine", ENGINES)
def test_a_quadruped_treads_on_a_board_and_goes_on(engine):
    pytest.importorskip("mujoco")
    published.folder("example-robot-data")
    task = study.plank()
    run, board = study.ENGINES[engine](task)
    assert run.status == "ok"
    assert run["base_q"][-1, 0] > task.place[0] + 0.5
    assert 1e-3 < np.linalg.norm((board[-1] - board[0])[:2]) < 0.1
    assert rotation_from_quaternion(board[-1, 3:])[2, 2] > 0.99
