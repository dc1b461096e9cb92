"""First motions of four legs: feet that stand still on the ground, mirror images, and robots that walk."""

import warnings
from dataclasses import replace

import numpy as np
import published
import pytest

from featherstone_gait import Ground, load_robot
from featherstone_gait.dynamics import contact_positions_at
from featherstone_gait.model import ContactPoint, Joint, Link, Model
from featherstone_gait.scene.compile import compile_scene
from featherstone_gait.walking.cost import WalkingCost
from featherstone_gait.walking.cost_in_worlds import in_worlds
from featherstone_gait.walking.four_legs import Pattern, four_legged_stride, mirror_by_place
from featherstone_gait.walking.gait import fit_gait
from featherstone_gait.walking.generic_servo import with_generic_servos
from featherstone_gait.walking.kinematics import link_poses

LEG = (0.0, 0.6, -1.2)  # roll, hip, knee of a standing fore leg [rad]


def four_legs():
    """A box of 2 kg on four legs of twice 0.12 m with point feet."""
    links = [Link("trunk", 2.0, (0, 0, 0), (0.005, 0, 0, 0.02, 0, 0.02))]
    joints, contacts, rod = [], [], (1e-4, 0, 0, 1e-4, 0, 1e-5)
    for name, x, y in (("a", 0.15, 0.1), ("b", 0.15, -0.1), ("c", -0.15, 0.1), ("d", -0.15, -0.1)):
        links += [Link(f"{name}{k}", 0.1, (0, 0, -0.06 * (k > 0)), rod) for k in range(3)]
        for k, (place, axis) in enumerate([((x, y, 0), (1, 0, 0)), ((0, 0, 0), (0, 1, 0)), ((0, 0, -0.12), (0, 1, 0))]):
            parent = f"{name}{k - 1}" if k else "trunk"
            turns = dict(xyz=place, axis=axis, lower=-2.0, upper=2.0)
            joints.append(Joint(f"{name}_{k}", "revolute", parent, f"{name}{k}", **turns))
        contacts.append(ContactPoint(f"{name}2", (0.0, 0.0, -0.12)))
    return Model("table", tuple(links), tuple(joints), base="floating", contacts=tuple(contacts))


@pytest.fixture(scope="module")
def robot():
    return four_legs()


POSTURE = np.array([*LEG, *LEG, *-np.array(LEG), *-np.array(LEG)])


@pytest.mark.parametrize("footfalls", ["trot", "walk"])
def test_feet_on_the_ground_stay_there_while_the_trunk_goes_forward(robot, footfalls):
    pattern = Pattern(period=0.64, step=0.06, lift=0.02, ground=0.75, footfalls=footfalls, sway=0.01)
    stride = four_legged_stride(robot, POSTURE, pattern)
    trunk = np.zeros((len(stride.times), 3))
    trunk[:, 0] = pattern.step * stride.times / pattern.period
    trunk[:, 1] = -pattern.sway * np.sin(2.0 * np.pi * stride.times / pattern.period)
    feet = contact_positions_at(robot, link_poses(robot, stride.angles, trunk))
    ground = contact_positions_at(robot, link_poses(robot, POSTURE))[0, 0, 2]
    stands = feet[..., 2] < ground + 1e-9
    assert stands.mean() == pytest.approx(0.75, abs=1.0 / len(stride.times))
    assert feet[..., 2].max() - ground == pytest.approx(pattern.lift, rel=0.02)
    still = stands & np.roll(stands, -1, axis=0)
    still[-1] = False
    moved = np.abs(np.diff(feet, axis=0, append=feet[:1])).max(axis=2)
    assert still.sum() > 20
    assert moved[still].max() < 1e-9
    lifted = (~stands).sum(axis=1)
    assert lifted.max() == (2 if footfalls == "trot" else 1)
    left_fore, right_fore, left_hind, right_hind = (~stands).T
    if footfalls == "trot":  # the diagonal pairs together
        assert (left_fore == right_hind).all()
        assert (right_fore == left_hind).all()
    else:  # one after the other
        order = [foot.argmax() for foot in (left_hind, left_fore, right_hind, right_fore)]
        assert order == sorted(order)


def test_a_foot_leaves_and_meets_the_ground_with_the_grounds_speed(robot):
    """In its first and last 2 % of the swing it moves ahead by a thousandth of its way, as the cubic does."""
    pattern = Pattern(period=8.0, step=0.06, lift=0.02)
    stride = four_legged_stride(robot, POSTURE, pattern)
    trunk = np.outer(pattern.step * stride.times / pattern.period, (1.0, 0.0, 0.0))
    foot = contact_positions_at(robot, link_poses(robot, stride.angles, trunk))[:, 0]  # in the air from 0 to 40 %
    swing = round(0.4 * len(stride.times))
    way = foot[swing, 0] - foot[0, 0]
    assert way == pytest.approx(pattern.step, rel=1e-6)
    k = swing // 50
    assert abs(foot[k, 0] - foot[0, 0]) < 2e-3 * way
    assert abs(foot[swing, 0] - foot[swing - k, 0]) < 2e-3 * way


def test_the_second_half_of_a_stride_is_the_mirror_image_of_the_first(robot):
    mirror = mirror_by_place(robot)
    for footfalls in ("trot", "walk"):
        stride = four_legged_stride(robot, POSTURE, Pattern(period=0.64, footfalls=footfalls, sway=0.01, ahead=0.01))
        half = np.roll(stride.angles, -len(stride.times) // 2, axis=0)
        assert np.abs(mirror(half) - stride.angles).max() < 1e-9
    assert mirror(mirror(POSTURE)) == pytest.approx(POSTURE)


def test_what_has_no_four_feet_or_no_mirror_image_is_refused(robot):
    with pytest.raises(ValueError, match="four feet with contact points"):
        four_legged_stride(replace(robot, contacts=robot.contacts[:3]), POSTURE)
    with pytest.raises(ValueError, match=r"cannot reach|outside its limits"):
        four_legged_stride(robot, POSTURE, Pattern(step=0.6))
    lame = replace(robot, joints=tuple(replace(j, xyz=(0, 0, -0.1)) if j.name == "a_2" else j for j in robot.joints))
    with pytest.raises(ValueError, match="table: joint 'a_2' in this posture has no partner"):
        mirror_by_place(lame)
    with pytest.raises(ValueError, match=r"period = 0.5 s must be a whole number of 0.08 s"):
        Pattern(period=0.5)
    with pytest.raises(ValueError, match=r"ground = 1\.0 must lie between"):
        Pattern(ground=1.0)


@pytest.mark.long
def test_a_published_quadruped_trots_and_walks_here_with_generic_servos():
    path = published.folder("example-robot-data") / "anymal_b_simple_description/robots/anymal.urdf"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        robot = with_generic_servos(load_robot(path, base="floating", contacts="feet"), leg=0.55)
    bend = {"HAA": 0.0, "HFE": 0.4, "KFE": -0.8}
    posture = np.array([bend[name[3:]] * (1.0 if name[1] == "F" else -1.0) for name in robot.joint_names])
    scene = compile_scene(robot, "mipsd", Ground(), "midpoint", 1e-3)
    trot = Pattern(period=0.48, step=0.12, lift=0.06)
    walk = Pattern(period=1.6, step=0.15, lift=0.06, ground=0.8, footfalls="walk", sway=0.05)
    for pattern, poses in ((trot, 8), (walk, 16)):
        fit = fit_gait(four_legged_stride(robot, posture, pattern), poses, mirror=mirror_by_place(robot, posture))
        cost = WalkingCost(scene, fit.gait, posture, blend_strides=2)
        (found,) = cost.measure([fit.gait.to_vector()])
        assert found.status == "ok"
        assert found.speed > 0.5 * pattern.step / pattern.period
        if poses == 8:
            assert in_worlds(cost, 8)(fit.gait.to_vector())[1] == "ok"
