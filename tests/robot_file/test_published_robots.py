"""URDFs that others publish load, and move as Pinocchio says: the robots of the packages `example-robot-data`,
`pybullet_data` and `mani_skill`, as far as they are installed.
"""

import functools
import importlib.util
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from featherstone_gait import RobotFileError, RobotFileWarning, forward_dynamics, load_robot
from featherstone_gait.base.rotation import rotation_from_rpy

pinocchio = pytest.importorskip("pinocchio")
pytestmark = pytest.mark.filterwarnings("ignore::featherstone_gait.robot_file.RobotFileWarning")

REFUSED = {  # what has no meaning, and the reason
    "alex_psyonic_hands.urdf": "which is not there",  # <mimic> of joints that have other names
    "biped2d_pybullet.urdf": "lower 1.0, upper -1.0",
    "cube_no_rotation.urdf": "lower 1.0, upper -1.0",
    "humanoid.urdf": "not well-formed XML",
    "husky.urdf": "$(optenv HUSKY_IMU_XYZ",
    "microtaur.urdf": "has 4 numbers",
    "romeo.urdf": "moves but has mass 0.0 kg",
    "romeo_laas_small.urdf": "moves but has mass 0.0 kg",
}
MASSLESS_ROOT = (  # which one joint holds
    "ability_hand_left_floating.urdf",
    "ability_hand_right_floating.urdf",
    "cartpole.urdf",
    "cube_rotate.urdf",
    "diff_ring.urdf",
    "fetch.urdf",
    "inspire_hand_left_floating.urdf",
    "inspire_hand_right_floating.urdf",
    "panda_v2_gripper.urdf",
    "pendulum5.urdf",
)
PLACEHOLDERS = (  # 1 kg m^2 for parts of 50 to 250 g, and gears of 64 g with 0.044 kg m^2
    "minitaur.urdf",
    "minitaur_fixed_all.urdf",
    "minitaur_fixed_knees.urdf",
    "minitaur_single_motor.urdf",
    "minitaur_v1.urdf",
    "pr2_gripper.urdf",
    "quadruped.urdf",
    "r2d2.urdf",
    "racecar_differential.urdf",
)
NOT_READ_BY_PINOCCHIO = (
    "bike.urdf",  # numbers separated by commas
    "follower_arm_v1.1.urdf",  # <limit> without effort
    "mobile_panda_dual_arm.urdf",  # the same
    "mobile_panda_single_arm.urdf",  # the same
    "spherical_joint_limit.urdf",  # a type that URDF does not know
)


def folders():
    """Where the packages have their robots."""
    specs = [spec for spec in map(importlib.util.find_spec, ("pybullet_data", "mani_skill")) if spec]
    packages = [Path(folder) for spec in specs for folder in spec.submodule_search_locations or ()]
    prefix = Path(pinocchio.__file__).parents[4] / "share" / "example-robot-data" / "robots"
    return packages + ([prefix] if prefix.is_dir() else [])


@functools.cache
def articulated(path):
    """Whether a file says that something moves; one that is no XML may."""
    try:
        return any(joint.get("type") != "fixed" for joint in ElementTree.parse(path).getroot().iterfind("joint"))
    except ElementTree.ParseError:
        return True


def robots(but=()):
    """The files of all robots, but those of these names."""
    files = [(folder, path) for folder in folders() for path in sorted(folder.rglob("*.urdf"))]
    return [
        pytest.param(path, id=f"{folder.name}/{path.relative_to(folder).with_suffix('')}")
        for folder, path in files
        if "random_urdfs" not in path.parts  # single objects
        and path.name not in but
        and articulated(path)
    ]


def loads(path, **how):
    """The robot, joints free that follow others, as in Pinocchio."""
    return load_robot(path, mimic="free", **how)


def states(model, count=3):
    """Positions and velocities of the joints, and forces."""
    rng = np.random.default_rng(1)
    shape = (count, len(model.joint_names))
    return rng.uniform(-0.5, 0.5, shape), rng.normal(size=shape), rng.normal(size=shape)


class Peer:
    """Pinocchio's model, in this package's order of joints."""

    def __init__(self, path, names, *root):
        self.model = pinocchio.buildModelFromUrdf(str(path), *root)
        self.data = self.model.createData()
        self.joints = [self.model.joints[self.model.getJointId(name)] for name in names]
        self.rows = [joint.idx_v for joint in self.joints]

    def positions(self, q):
        Q = pinocchio.neutral(self.model)
        for joint, x in zip(self.joints, q):
            Q[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(x), np.sin(x)] if joint.nq == 2 else [x]
        return Q

    def spread(self, x, base=()):
        """Numbers of the joints in Pinocchio's order, those of the base before them."""
        out = np.zeros(self.model.nv)
        out[self.rows] = x
        out[: len(base)] = base
        return out


@pytest.mark.parametrize("path", robots(but={*REFUSED, *NOT_READ_BY_PINOCCHIO}))
def test_accelerations_on_a_fixed_base_are_pinocchios(path):
    model = loads(path, base="fixed")
    peer = Peer(path, model.joint_names)
    assert peer.model.nv == model.nv
    q, qd, tau = states(model)
    for k, ours in enumerate(forward_dynamics(model, q, qd, tau)):
        x = peer.positions(q[k]), peer.spread(qd[k]), peer.spread(tau[k])
        theirs = pinocchio.aba(peer.model, peer.data, *x)[peer.rows]
        assert np.abs(ours - theirs).max() <= 1e-9 * np.abs(theirs).max()


@pytest.mark.parametrize("path", robots(but={*REFUSED, *NOT_READ_BY_PINOCCHIO}))
def test_mass_and_accelerations_on_a_floating_base_are_pinocchios(path):
    if path.name in MASSLESS_ROOT:
        with pytest.raises(RobotFileError, match=r"floating base '.*' can move together without"):
            loads(path, base="floating")
        return
    model = loads(path, base="floating")
    peer = Peer(path, model.joint_names, pinocchio.JointModelFreeFlyer())
    assert pinocchio.computeTotalMass(peer.model) == pytest.approx(model.mass, rel=1e-12)
    joints, rates, forces = states(model)
    v, omega, force, moment = np.random.default_rng(2).normal(size=(4, 3))
    R = rotation_from_rpy((0.3, -0.4, 0.5))
    quaternion = pinocchio.Quaternion(R)
    w = np.array([quaternion.w, quaternion.x, quaternion.y, quaternion.z])
    for q, qd, tau in zip(joints, rates, forces):
        ours = forward_dynamics(model, np.r_[np.zeros(3), w, q], np.r_[v, omega, qd], np.r_[force, moment, tau])
        Q = peer.positions(q)
        Q[3:7] = quaternion.coeffs()
        x = Q, peer.spread(qd, [*R.T @ v, *omega]), peer.spread(tau, [*R.T @ force, *moment])
        a = pinocchio.aba(peer.model, peer.data, *x)
        linear = R @ (a[:3] + np.cross(omega, R.T @ v))  # Pinocchio's is the rate in the body's own axes
        theirs = np.r_[linear, a[3:6], a[peer.rows]]
        assert np.abs(ours - theirs).max() <= 1e-9 * np.abs(theirs).max()


@pytest.mark.parametrize("path", robots())
def test_what_is_refused_has_no_meaning(path):
    """The rest, 95 % and more of what is neither malformed nor massless, loads with all that it couples.

    One warning at most says what is in the notes.
    """
    if path.name in REFUSED:
        with pytest.raises(RobotFileError) as caught:
            load_robot(path)
        assert REFUSED[path.name] in str(caught.value)
        assert "line " in str(caught.value)
        return
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        robot = load_robot(path)
    assert all(warning.category is RobotFileWarning for warning in caught)
    assert len(caught) <= min(1, len(robot.notes))
    joints = ElementTree.fromstring(path.read_bytes().strip()).findall("joint")  # a declaration may come late
    followers = {j.get("name") for j in joints if j.find("mimic") is not None and j.get("type") != "fixed"}
    assert {coupling[0] for coupling in robot.couplings} | set(robot.locked) == followers
    leaders = {coupling[1] for coupling in robot.couplings}
    assert leaders <= set(robot.joint_names) - followers


@pytest.mark.long
@pytest.mark.parametrize("path", robots(but=REFUSED))
def test_inertias_are_doubted_where_they_are_placeholders(path):
    doubted = any("radius of gyration" in note for note in loads(path).notes)
    assert doubted == ("pybullet_data" in path.parts and path.name in PLACEHOLDERS)
