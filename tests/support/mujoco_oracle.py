"""A second opinion on the dynamics: the same robot in MuJoCo, built from URDF text through MjSpec.

MuJoCo would fuse the root of a URDF into the world and merge fixed joints; here it keeps every body, gets a free joint
where the base floats, and knows no contact, limit, damping or friction.
"""

import math

import mujoco
import numpy as np

from featherstone_gait.dynamics.tree import GRAVITY
from featherstone_gait.model import Model

FLAGS = mujoco.mjtDisableBit
DISABLED = FLAGS.mjDSBL_CONTACT | FLAGS.mjDSBL_CONSTRAINT | FLAGS.mjDSBL_LIMIT | FLAGS.mjDSBL_FRICTIONLOSS


def mujoco_model(path):
    """Read a file; return the module mujoco, the robot and its data."""
    m = mujoco.MjModel.from_xml_path(str(path))
    return mujoco, m, mujoco.MjData(m)


def urdf_text(model: Model) -> str:
    """The robot as URDF, every number to the last bit; no limits, no damping, no friction."""
    links = "".join(_link_text(link) for link in model.links)
    joints = "".join(_joint_text(joint) for joint in model.joints)
    return f'<robot name="{model.name}">{links}{joints}</robot>'


def _text(values) -> str:
    return " ".join(repr(float(x)) for x in values)


def _link_text(link) -> str:
    if link.mass == 0:
        return f'<link name="{link.name}"/>'
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    moments = " ".join(f'{name}="{float(value)!r}"' for name, value in zip(names, link.inertia))
    return (
        f'<link name="{link.name}"><inertial><origin xyz="{_text(link.center_of_mass)}"/>'
        f'<mass value="{float(link.mass)!r}"/><inertia {moments}/></inertial></link>'
    )


def _joint_text(joint) -> str:
    kind = "continuous" if joint.type == "revolute" else joint.type
    return (
        f'<joint name="{joint.name}" type="{kind}"><parent link="{joint.parent}"/><child link="{joint.child}"/>'
        f'<origin xyz="{_text(joint.xyz)}" rpy="{_text(joint.rpy)}"/><axis xyz="{_text(joint.axis)}"/></joint>'
    )


class Oracle:
    """MuJoCo's answers in this package's order of coordinates."""

    def __init__(self, model: Model, armature=None, gravity=GRAVITY):
        self.m = _compiled(model)
        assert math.isclose(self.m.body_mass.sum(), model.mass, rel_tol=1e-12)
        assert self.m.nv == model.nv
        base = 6 if model.base == "floating" else 0
        joints = [self.m.joint(name) for name in model.joint_names]
        self.dofs = np.array([*range(base), *(joint.dofadr[0] for joint in joints)], dtype=int)
        self.positions = np.array([*range(base + bool(base)), *(joint.qposadr[0] for joint in joints)], dtype=int)
        self.m.opt.disableflags |= DISABLED
        self.m.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        self.m.opt.gravity[:] = gravity
        if armature is not None:
            self.m.dof_armature[self.dofs[base:]] = armature
        self.d = mujoco.MjData(self.m)

    def set(self, q, qd):
        self.d.qpos[self.positions] = q
        self.d.qvel[self.dofs] = qd

    def forward_dynamics(self, q, qd, tau) -> np.ndarray:
        """Accelerations (n, nv) of many states."""
        out = np.empty_like(qd)
        for k in range(len(q)):
            self.set(q[k], qd[k])
            self.d.qfrc_applied[self.dofs] = tau[k]
            mujoco.mj_forward(self.m, self.d)
            out[k] = self.d.qacc[self.dofs]
        return out

    def push(self, link, wrench):
        """Apply [moment; force] at the origin of a link's frame, world axes, from now on."""
        mujoco.mj_kinematics(self.m, self.d)
        body = self.m.body(link).id
        arm = self.d.xpos[body] - self.d.xipos[body]  # MuJoCo's acts at the center of mass
        self.d.xfrc_applied[body, :3] = wrench[3:]
        self.d.xfrc_applied[body, 3:] = wrench[:3] + np.cross(arm, wrench[3:])

    def mass_matrix(self, q) -> np.ndarray:
        self.set(q, np.zeros(self.m.nv))
        mujoco.mj_forward(self.m, self.d)
        H = np.zeros((self.m.nv, self.m.nv))
        mujoco.mj_fullM(self.m, self.d, H)
        return H[np.ix_(self.dofs, self.dofs)]

    def measures(self, q, qd):
        """Energies (2,), center of mass (3,), and momentum (6,) as angular about the center of mass, then linear."""
        self.set(q, qd)
        mujoco.mj_forward(self.m, self.d)
        mujoco.mj_subtreeVel(self.m, self.d)
        p = self.d.subtree_linvel[0] * self.m.body_mass.sum()
        momentum = np.concatenate([self.d.subtree_angmom[0], p])
        return self.d.energy[::-1].copy(), self.d.subtree_com[0].copy(), momentum


def _compiled(model: Model) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(urdf_text(model))
    spec.compiler.fusestatic = False
    for name, position in model.locked.items():
        _weld(spec, spec.joint(name), position)
    if model.base == "floating":
        spec.worldbody.first_body().add_freejoint()
    return spec.compile()


def _weld(spec, joint, position):
    """Replace a joint by what it is at that position."""
    body, axis = joint.parent, np.array(joint.axis)
    turn, moved = np.zeros(4), np.zeros(3)
    if joint.type == mujoco.mjtJoint.mjJNT_HINGE:
        mujoco.mju_axisAngle2Quat(turn, axis, position)
        mujoco.mju_mulQuat(turn, body.quat.copy(), turn.copy())
        body.quat = turn
    else:
        mujoco.mju_rotVecQuat(moved, axis * position, body.quat)
        body.pos = body.pos + moved
    spec.delete(joint)
