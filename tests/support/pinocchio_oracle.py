"""The same robot in Pinocchio."""

import numpy as np

from featherstone_gait.dynamics import forward_kinematics
from featherstone_gait.dynamics.jacobians import link_index
from featherstone_gait.model import depth_first
from featherstone_gait.model.degrees import written_degrees


def pinocchio_model(model, point=(0.0, 0.0, 0.0)):
    """The robot built by Pinocchio's own calls, and its frame at a point of each link."""
    import pinocchio as pin

    theirs = pin.Model()
    ids = {model.root: 0}
    if model.base == "floating":
        ids[model.root] = theirs.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    places = {model.root: pin.SE3.Identity()}
    frames = {}
    for joint in (part for whole in depth_first(model) for part in written_degrees(whole)):
        at = places[joint.parent] * pin.SE3(pin.rpy.rpyToMatrix(*joint.rpy), np.array(joint.xyz))
        if joint.name in model.joint_names or joint.type == "ball":
            ids[joint.child] = theirs.addJoint(ids[joint.parent], _kind(joint), at, joint.name)
            at = pin.SE3.Identity()
        else:
            ids[joint.child] = ids[joint.parent]
        places[joint.child] = at
    for link in model.links:
        if link.mass > 0:
            xx, xy, xz, yy, yz, zz = link.inertia
            J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            inertia = pin.Inertia(link.mass, np.array(link.center_of_mass), J)
            theirs.appendBodyToJoint(ids[link.name], inertia, places[link.name])
        place = places[link.name] * pin.SE3(np.eye(3), np.array(point))
        frames[link.name] = theirs.addFrame(pin.Frame(link.name, ids[link.name], place, pin.FrameType.OP_FRAME))
    return theirs, frames


def _kind(joint):
    import pinocchio as pin

    axis = np.array(joint.axis)
    if joint.type == "ball":
        return pin.JointModelSpherical()
    if joint.type == "screw":
        return pin.JointModelHelicalUnaligned(axis, joint.pitch)
    return (pin.JointModelPrismaticUnaligned if joint.type == "prismatic" else pin.JointModelRevoluteUnaligned)(axis)


def coordinates(theirs, model, q):
    """Pinocchio's q, and the matrix (nv, nv) that makes its velocities of ours.

    Its base has the quaternion x y z w and a velocity in its own axes; joints may stand in another order.
    """
    p, T = np.zeros(theirs.nq), np.zeros((theirs.nv, model.nv))
    if model.base == "floating":
        p[:7] = q[[0, 1, 2, 4, 5, 6, 3]]
        T[:3, :3], T[3:6, 3:6] = forward_kinematics(model, q).rotation[link_index(model, model.root)].T, np.eye(3)
    for joint, place in zip(model.moving_joints, model.position_slices):
        column = model.qd_index(joint.name)
        if joint.type == "ball" and place.stop == place.start:
            continue
        ball = joint.type == "ball"
        theirs_of = theirs.joints[theirs.getJointId(joint.name[:-3] if ball else joint.name)]
        x, y, z, w = q[place][[1, 2, 3, 0]] if ball else (q[place.start], 0.0, 0.0, 0.0)
        p[theirs_of.idx_q : theirs_of.idx_q + theirs_of.nq] = [x, y, z, w][: theirs_of.nq]
        for k in range(theirs_of.nv):
            T[theirs_of.idx_v + k, column + k] = 1.0
    return p, T
