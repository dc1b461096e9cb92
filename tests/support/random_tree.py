"""Random kinematic trees for the tests, in the spirit of autoTree (RBDA appendix A).

Body k of 1 ... nb hangs on body floor((k - 2 + ceil(branching)) / branching): branching 1 gives an unbranched chain,
2 a binary tree, 1.5 one between the two.  Joint axes, frames, boxes and joint types are drawn from the seed.
"""

import math

import numpy as np

from featherstone_gait.base.rotation import rotation_from_rpy
from featherstone_gait.model import Joint, Link, Model

DENSITY = 1000.0  # [kg/m^3]


def random_tree(nb, seed, *, branching=1.5, skew=math.pi, prismatic=0.25, base="fixed") -> Model:
    """A robot of nb moving bodies on a base link.

    branching >= 1 is the mean number of children; skew [rad] bounds the rotation from joint to joint (0 keeps all
    frames parallel and all axes along z); prismatic is the share of sliding joints.
    """
    rng = np.random.default_rng(seed)
    links = [random_box("body0", rng, skew)]
    joints = []
    for k in range(1, nb + 1):
        parent = math.floor((k - 2 + math.ceil(branching)) / branching)
        links.append(random_box(f"body{k}", rng, skew))
        joints.append(random_joint(k, parent, rng, skew, prismatic))
    return Model(f"tree{nb}_{seed}", tuple(links), tuple(joints), base)


def random_box(name, rng, skew) -> Link:
    """A solid box of 2 to 10 cm a side, turned and moved about in its link frame."""
    sides = rng.uniform(0.02, 0.10, 3)
    mass = DENSITY * sides.prod()
    R = rotation_from_rpy(rng.uniform(-skew, skew, 3))
    J = R @ np.diag(mass / 12 * (sides @ sides - sides**2)) @ R.T
    center = rng.uniform(-0.03, 0.03, 3)
    return Link(name, float(mass), numbers(center), numbers([J[0, 0], J[0, 1], J[0, 2], J[1, 1], J[1, 2], J[2, 2]]))


def random_joint(k, parent, rng, skew, prismatic) -> Joint:
    """A joint up to 10 cm from its parent's frame."""
    kind = "prismatic" if rng.random() < prismatic else rng.choice(["revolute", "continuous"])
    xyz, rpy = rng.uniform(-0.06, 0.06, 3), rng.uniform(-skew, skew, 3)
    axis = rng.normal(size=3) if skew else np.array([0.0, 0.0, 1.0])
    axis /= np.linalg.norm(axis)
    return Joint(f"joint{k}", str(kind), f"body{parent}", f"body{k}", numbers(xyz), numbers(rpy), numbers(axis))


def numbers(values) -> tuple[float, ...]:
    return tuple(float(x) for x in values)


def random_states(model, count, seed):
    """q (count, nq), qd and tau (count, nv): any pose, a few rad/s, forces of a hundredth of the weight."""
    rng = np.random.default_rng(seed)
    n = len(model.moving_joints)
    sliding = np.array([joint.type == "prismatic" for joint in model.moving_joints])
    q = np.where(sliding, rng.uniform(-0.1, 0.1, (count, n)), rng.uniform(-math.pi, math.pi, (count, n)))
    if model.base == "floating":
        turn = rng.normal(size=(count, 4))
        q = np.hstack([rng.normal(size=(count, 3)), turn / np.linalg.norm(turn, axis=1, keepdims=True), q])
    return q, rng.normal(size=(count, model.nv)) * 2.0, rng.normal(size=(count, model.nv)) * 0.01 * model.mass
