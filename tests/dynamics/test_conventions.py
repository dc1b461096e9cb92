"""States in the coordinates of MuJoCo, Pinocchio and Drake mean the same motion."""

import numpy as np
import pytest
from random_tree import random_states, random_tree

from featherstone_gait import energy, forward_kinematics, jacobian, momentum
from featherstone_gait.dynamics.conventions import from_engine, to_engine

ENGINES = ("mujoco", "pinocchio", "drake")


def floating(seed=0):
    model = random_tree(5, seed, branching=1.5, base="floating")
    q, qd, _ = random_states(model, 3, seed)
    return model, q, qd


@pytest.mark.parametrize("engine", ENGINES)
def test_there_and_back_is_the_same_state(engine):
    model, q, qd = floating()
    back = from_engine(engine, model, *to_engine(engine, model, q, qd))
    assert np.abs(back[0] - q).max() == 0.0
    assert np.abs(back[1] - qd).max() < 1e-14 * np.abs(qd).max()
    single = to_engine(engine, model, q[1], qd[1])
    assert all((one == many[1]).all() for one, many in zip(single, to_engine(engine, model, q, qd)))


@pytest.mark.parametrize("engine", ENGINES)
def test_a_fixed_base_has_one_convention(engine):
    model = random_tree(4, 1, base="fixed")
    q, qd, _ = random_states(model, 2, 1)
    assert all((a == b).all() for a, b in zip(to_engine(engine, model, q, qd), (q, qd)))


def test_mujoco_says_the_same_of_its_own_coordinates():
    oracle = pytest.importorskip("mujoco_oracle")
    import mujoco

    model, q, qd = floating(2)
    them = oracle.Oracle(model)
    them.set(*(x[0] for x in to_engine("mujoco", model, q, qd)))
    mujoco.mj_forward(them.m, them.d)
    mujoco.mj_subtreeVel(them.m, them.d)
    assert them.d.energy[1] == pytest.approx(energy(model, q[0], qd[0]).kinetic, rel=1e-12)
    assert np.abs(them.d.subtree_linvel[0] * model.mass - momentum(model, q[0], qd[0])[3:]).max() < 1e-12


def test_pinocchio_says_the_same_of_its_own_coordinates():
    pin = pytest.importorskip("pinocchio")
    from pinocchio_oracle import pinocchio_model

    model, q, qd = floating(3)
    theirs, _ = pinocchio_model(model)
    data, joints = theirs.createData(), [theirs.joints[theirs.getJointId(name)] for name in model.joint_names]
    p, v = to_engine("pinocchio", model, q[0], qd[0])
    in_order = np.array(p), np.array(v)
    for k, joint in enumerate(joints):
        in_order[0][joint.idx_q], in_order[1][joint.idx_v] = p[7 + k], v[6 + k]
    assert pin.computeKineticEnergy(theirs, data, *in_order) == pytest.approx(energy(model, q[0], qd[0]).kinetic)
    ours = momentum(model, q[0], qd[0])
    moved = pin.computeCentroidalMomentum(theirs, data, *in_order)
    assert np.abs(np.r_[moved.angular, moved.linear] - ours).max() < 1e-12 * np.abs(ours).max()


def test_drake_states_angular_velocity_and_velocity_in_world_axes():
    """As its documentation of `QuaternionFloatingJoint` says: q is quaternion and position, v is w_FM_F and v_FM_F."""
    model, q, qd = floating(4)
    p, v = to_engine("drake", model, q, qd)
    assert (p == np.hstack([q[:, 3:7], q[:, :3], q[:, 7:]])).all()
    for k in range(len(q)):
        twist = jacobian(model, q[k], model.root) @ qd[k]  # angular velocity and velocity, world axes
        assert np.abs(v[k, :6] - twist).max() < 1e-13 * np.abs(twist).max()


def test_what_makes_no_sense_is_refused():
    model, q, qd = floating()
    with pytest.raises(ValueError, match="engine is 'bullet'"):
        to_engine("bullet", model, q, qd)
    with pytest.raises(ValueError, match="qd has the shape"):
        to_engine("drake", model, q, qd[:, 1:])
    with pytest.raises(ValueError, match="quaternion is zero"):
        to_engine("drake", model, 0.0 * q[0], qd[0])


def test_poses_and_jacobians_take_frames_by_name():
    model, q, _ = floating(5)
    name = model.links[3].name
    every, one = forward_kinematics(model, q), forward_kinematics(model, q, name)
    assert (one.rotation == every.rotation[:, 3]).all()
    assert (one.position == every.position[:, 3]).all()
    tip = model.links[-1].name
    in_world, in_link = (jacobian(model, q, tip, frame=frame) for frame in ("world", name))
    turned = np.einsum("kij,kjn->kin", one.rotation, in_link[:, 3:])
    assert np.abs(turned - in_world[:, 3:]).max() < 1e-12
    assert (jacobian(model, q, tip, frame=tip) == jacobian(model, q, tip, frame="body")).all()
    with pytest.raises(ValueError, match="has no frame 'tail'"):
        jacobian(model, q, tip, frame="tail")
