"""The mass matrix that a model is checked with is that of the kernels."""

import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from random_tree import random_tree
from scenes import gimbal

from featherstone_gait.base.flaws import FlawError
from featherstone_gait.dynamics import mass_matrix as compiled_mass_matrix
from featherstone_gait.model import Joint, Link, Model, rigid_bodies
from featherstone_gait.model.composite import TOLERANCE, idle, loosest, mass_matrix
from featherstone_gait.model.mass_checks import rows_of


@pytest.mark.bounds
@pytest.mark.nojit
@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_compiled_one(seed):
    model = random_tree(8, seed, branching=1.5, base="floating")
    armature = 0.01 * seed
    model = replace(model, joints=tuple(replace(joint, armature=armature) for joint in model.joints))
    q = np.random.default_rng(seed).uniform(-1, 1, 8)
    names = [body.frame.joint.name for body in rigid_bodies(model)[0][1:]]
    order = [*range(6), *(6 + model.joint_names.index(name) for name in names)]
    H, size = mass_matrix(rows_of(rigid_bodies(model)[0]), np.r_[0.0, q[[k - 6 for k in order[6:]]]])
    x = np.r_[0.3, -0.2, 0.5, 1.0, 0.0, 0.0, 0.0, q]  # a base that is not turned: world axes are body axes
    theirs = compiled_mass_matrix(model, x, armature=np.full(8, armature))[np.ix_(order, order)]
    assert np.abs(H - theirs).max() <= 1e-13 * np.abs(theirs).max()
    assert np.all(np.diag(H) <= size * (1 + 1e-12))


def test_what_moves_nothing_is_found_whatever_its_scale():
    rows = np.array([[1.0, 1.0], [1.0, 1.0]])
    for scale in (1e-12, 1.0, 1e12):
        H = np.diag([1.0, scale]) @ rows @ np.diag([1.0, scale])
        assert idle(H, np.diag(H)).size == 0
        assert loosest(H)[0] <= TOLERANCE
        assert loosest(H + 1e-6 * np.diag(np.diag(H)))[0] > TOLERANCE
    assert idle(np.diag([1.0, 1e-17]), np.array([1.0, 1.0])).tolist() == [1]


def chain(*links):
    """Links on hinges about x, each 1 m beyond the last along y."""
    names = ["base", *(link.name for link in links)]
    joints = [Joint(f"j{k}", "continuous", *ends, (0.0, float(k > 0), 0.0)) for k, ends in enumerate(pairwise(names))]
    return Model("chain", (Link("base", 0.0, (0, 0, 0), (0,) * 6), *links), tuple(joints))


def test_a_link_may_be_light_or_impossible_where_what_it_carries_is_not():
    heavy = Link("heavy", 1.0, (0, 0.5, 0), (0.1, 0, 0, 0.1, 0, 0.1))
    for light in (
        Link("frame", 0.0, (0, 0, 0), (0,) * 6),
        Link("rotor", 0.0, (0, 0, 0), (1e-3, 0, 0, 1e-3, 0, 1e-3)),
        Link("dummy", 1e-6, (0, 0, 0), (1e-12, 0, 0, 1e-12, 0, 1e-12)),
        Link("negative", 0.1, (0, 0, 0), (-1e-3, 0, 0, 1e-3, 0, 1e-3)),
    ):
        assert chain(light, heavy).nv == 2
    with pytest.raises(FlawError, match=r"link 'negative' moves about joint 'j1' but its inertia there is -0\.001"):
        chain(heavy, Link("negative", 0.1, (0, 0, 0), (-1e-3, 0, 0, 1e-3, 0, 1e-3)))
    with pytest.raises(FlawError, match="link 'frame' moves but has mass 0") as caught:
        chain(heavy, Link("frame", 0.0, (0, 0, 0), (0,) * 6), Link("end", 0.0, (0, 0, 0), (0,) * 6))
    assert [flaw.element for flaw in caught.value.flaws] == ["link 'frame'", "link 'end'"]
    assert pickle.loads(pickle.dumps(caught.value)).flaws == caught.value.flaws


def test_armature_stands_for_inertia():
    heavy = Link("heavy", 1.0, (0, 0.5, 0), (0.1, 0, 0, 0.1, 0, 0.1))
    robot = chain(heavy, replace(heavy, name="tip"))
    tip = Link("tip", 0.0, (0, 0, 0), (0,) * 6)
    with pytest.raises(FlawError, match="link 'tip' moves but has mass 0"):
        replace(robot, links=(*robot.links[:2], tip))
    geared = replace(robot.joints[1], armature=1e-4)
    assert replace(robot, links=(*robot.links[:2], tip), joints=(robot.joints[0], geared)).nv == 2


def test_a_robot_is_refused_only_if_it_is_singular_everywhere():
    assert gimbal().nv == 3
    assert gimbal("zyx", keyframes={"home": (0.0, 0.0, 0.0)}).nv == 3
    with pytest.raises(FlawError, match=r"'yaw'.*'pitch'.*without inertia"):
        gimbal("zzx")
    with pytest.raises(FlawError, match=r"joint 'roll' but its inertia there is -0\.001"):
        gimbal(inertia=(3e-3, 0.0, 0.0, 3e-3, 0.0, -1e-3))
