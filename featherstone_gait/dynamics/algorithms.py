"""Dynamics algorithms as functions of a model, for one state or many.

Coordinates are those of `model/robot.py`: for a fixed base the joints in file order; for a floating base
``q = [x y z, qw qx qy qz, joints]``, ``qd = [velocity (world axes), angular velocity (body axes), joint velocities]``
and ``tau = [force (world axes), moment (body axes), joint torques]``.  Every argument may have a leading axis
of states, ``(n, nv)``; then eight states go through the kernels at once, with the same bits as one by one.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import HUGE, floats, instance, listed, shown, vector
from ..base.brief import FEW, brief
from ..base.fixed_order import applied, product, solve, total
from ..base.portable_math import angle
from ..core.compile.elementary import SINCOS_LIMIT
from ..core.compile.lanes import WIDTH, aligned
from ..core.effects.touch import FLATNESS
from ..core.tree import batch
from ..core.tree.layout import Motion, Robot
from ..core.tree.loop import Loops as LoopTable
from ..core.tree.rows import LOOP, make_rows
from ..core.tree.wrap import ways_around
from ..model import Loop, Model, Spring, Tendon, Via, Wrap
from ..model.degrees import ball_name, is_first
from ..model.numpy_dynamics import Poses, what_is_loose
from ..model.tree_checks import check_springs
from ..scene.external import build_lifts
from ..scene.loop import build_loops
from ..scene.tree import GRAVITY, Tree, compile_tree, joint_armature, wrap_record


class Wrench(NamedTuple):
    """An external force and moment on a link, at the origin of its frame, in world axes.

    Attributes
    ----------
    force : array_like
        Force (3,) or (n, 3) [N].
    moment : array_like
        Moment (3,) or (n, 3) about the origin of the link's frame [N m].
    """

    force: ArrayLike = (0.0, 0.0, 0.0)
    moment: ArrayLike = (0.0, 0.0, 0.0)

    def __repr__(self) -> str:
        return brief(self)


Wrenches = Mapping[str, Wrench]  # by link


class Energy(np.ndarray):
    """Energies (2,) or (n, 2) [J], an array whose columns have names.

    Attributes
    ----------
    kinetic : numpy.ndarray
        Kinetic energy, () or (n,) [J].
    potential : numpy.ndarray
        Potential energy of gravity less borne weights, of joint springs and tendons, () or (n,); heights count from the
        world's origin [J].
    total : numpy.ndarray
        Sum of both, () or (n,) [J].
    """

    def __repr__(self) -> str:
        with np.printoptions(threshold=FEW, edgeitems=2):
            return super().__repr__()

    @property
    def kinetic(self) -> np.ndarray:
        """Kinetic energy [J]."""
        return np.asarray(self)[..., 0]

    @property
    def potential(self) -> np.ndarray:
        """Potential energy [J]."""
        return np.asarray(self)[..., 1]

    @property
    def total(self) -> np.ndarray:
        """Sum of kinetic and potential energy [J]."""
        return self.kinetic + self.potential


def forward_dynamics(
    model: Model,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    *,
    wrench: Wrenches | None = None,
    armature: ArrayLike | None = None,
    stiffness: ArrayLike | None = None,
    gravity: ArrayLike = GRAVITY,
) -> np.ndarray:
    """Compute the accelerations that forces cause (articulated-body algorithm, RBDA section 7.3).

    Gravity, what bears weight, springs of joints and tendons act besides the given forces; damping, friction, servos
    and stops do not.

    Coupled joints (`Joint.mimic`) accelerate by multiplier times their leaders' acceleration: the result is
    G (G' M G)^-1 G' (tau - c), with G of `coupling_matrix` and the bias forces c at the given q and qd, whether these
    agree with the couplings or not.

    Loops (`Model.loops`) accelerate so that they stay closed: J qdd + Jdot qd = 0 with J of `loop_jacobian`, whether
    they are closed and at rest at the given q and qd or not.  Loops that depend on each other are no exception.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].
    qd : array_like
        Velocities (nv,) or (n, nv) [m/s, rad/s or m/s].
    tau : array_like
        Generalized forces (nv,) or (n, nv) [N, N m]; for a floating base the first six are the force (world axes) and
        the moment (body axes) on the base.
    wrench : Mapping of str to Wrench, optional
        External forces and moments by link name, at the origin of the link's frame, in world axes.
    armature : array_like, optional
        Inertia (joints,) added to each joint, such as G^2 J of a rotor [kg m^2 or kg]; None takes the model's.
    stiffness : array_like, optional
        Stiffness (joints,) of the joints' springs [N m/rad or N/m]; None takes the model's.
    gravity : array_like, optional
        Acceleration of gravity (3,) [m/s^2].

    Returns
    -------
    numpy.ndarray
        Accelerations (nv,) or (n, nv) [m/s^2, rad/s^2].

    Raises
    ------
    ValueError
        For wrong shapes, values that are not finite, and where the mass matrix is singular.
    """
    x = _arguments(model, q=q, qd=qd, tau=tau)
    robot = _robot(model, armature, gravity)
    pull = _spring_torque(model, x["q"], stiffness)
    if pull is not None:
        x["tau"] = x["tau"] + pull
    out = _accelerations(model, _less_inertia(model, x, wrench, robot), wrench, robot)
    for row in np.flatnonzero(~np.isfinite(out).all(axis=1)):
        loose = what_is_loose(model, x["q"][row], robot.armature)
        if loose is not None:
            raise ValueError(f"{model.name}: {loose}, or ask for the accelerations in another posture")
    return _shaped(out, q, qd, tau)


def loop_forces(
    model: Model,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    *,
    wrench: Wrenches | None = None,
    armature: ArrayLike | None = None,
    stiffness: ArrayLike | None = None,
    gravity: ArrayLike = GRAVITY,
) -> np.ndarray:
    """Compute the forces with which loops stay closed.

    They act as the generalized forces J' f, with J of `loop_jacobian`.  Of loops that depend on each other the forces
    are shared between them.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].
    qd : array_like
        Velocities (nv,) or (n, nv) [m/s, rad/s or m/s].
    tau : array_like
        Generalized forces (nv,) or (n, nv) [N, N m].
    wrench, armature, stiffness, gravity : optional
        As for `forward_dynamics`.

    Returns
    -------
    numpy.ndarray
        Forces f (m,) or (n, m) on the first link of each loop, in the order of the rows of `loop_gaps` [N, N m].

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    x = _arguments(model, q=q, qd=qd, tau=tau)
    robot = _robot(model, armature, gravity)
    pull = _spring_torque(model, x["q"], stiffness)
    if pull is not None:
        x["tau"] = x["tau"] + pull
    return _shaped(_forward(model, _less_inertia(model, x, wrench, robot), wrench, robot)[1], q, qd, tau)


def loop_gaps(model: Model, q: ArrayLike) -> np.ndarray:
    """Compute by how much loops are open.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        Gaps (m,) or (n, m), loop by loop: of points a - b along the world's axes (3) [m], of a weld also twice the
        vector part of the quaternion of its frames (3), about the angle [rad], of a hinge the cosines between its axis
        in b and two axes across it in a (2), of a distance its excess (1) [m].

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    return _shaped(loop_measures(model, q)[0][:, 0], q)


def loop_jacobian(model: Model, q: ArrayLike) -> np.ndarray:
    """Compute the Jacobian of loops: J qd is the rate of `loop_gaps`, of welds in all but their rotation.

    The rows of a weld's rotation are the angular velocity of the first link against the second in world axes, which is
    the rate of that gap where it is closed.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        J (m, nv) or (n, m, nv).

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    return _shaped(loop_measures(model, q)[1], q)


def loop_measures(
    model: Model, q: ArrayLike, qd: ArrayLike | None = None, places: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Compute gap, J qd and Jdot qd (n, 3, m) of loops, and J (n, m, nv); places: other ones than the loops' own."""
    x = _arguments(check_model(model), q=q, qd=np.zeros(model.nv) if qd is None else qd)
    tree, loops, n = compile_tree(model), build_loops(model), len(x["q"])
    measures, J = np.zeros((n, 3, loops.rows)), np.zeros((n, loops.rows, tree.n))
    base_J = np.zeros((n, loops.rows, 6)) if tree.floating else None
    robot, at = Robot(tree.bodies, None, np.zeros(3)), _motion(tree, x["q"], x["qd"])
    held = loops.held if places is None else (loops.held[0], places)
    batch.loop_rows(robot, (loops.table, held), at, _work(tree), np.zeros((loops.rows, LOOP)), measures, base_J, J)
    return measures, J if base_J is None else np.concatenate([base_J, J], axis=2)


def _accelerations(model: Model, x: dict[str, np.ndarray], wrench: Wrenches | None, robot: Robot) -> np.ndarray:
    """Compute accelerations (n, nv) without inertia of tendons."""
    return _forward(model, x, wrench, robot)[0]


def _less_inertia(
    model: Model, x: dict[str, np.ndarray], wrench: Wrenches | None, robot: Robot
) -> dict[str, np.ndarray]:
    """Return the arguments with what the inertia m of tendons takes of tau, J' f.

    f = m (J a + Jdot qd) with the accelerations a = a0 - Z f, where Z are those by unit forces.
    """
    heavy = [one for one in model.tendons if one.armature > 0]
    if not heavy:
        return x
    J, bias = _tendon_motion(model, x["q"], x["qd"], heavy)
    root = np.sqrt([one.armature for one in heavy])
    free = _accelerations(model, x, wrench, robot)
    moved = [_accelerations(model, x | {"tau": x["tau"] + J[:, k]}, wrench, robot) - free for k in range(len(heavy))]
    Z = product(J, np.stack(moved, axis=2))
    A = np.eye(len(heavy)) + root[:, None] * Z * root
    f = root[:, None] * solve(A, root[:, None] * (applied(J, free) + bias)[..., None])
    return x | {"tau": x["tau"] - applied(np.swapaxes(J, 1, 2), f[..., 0])}


def _tendon_motion(model: Model, q: np.ndarray, qd: np.ndarray, tendons: list[Tendon]) -> tuple[np.ndarray, np.ndarray]:
    """Compute how the lengths of straight tendons change: J (n, k, nv), and Jdot qd (n, k)."""
    J, bias = np.zeros((len(q), len(tendons), model.nv)), np.zeros((len(q), len(tendons)))
    rods, of = list[Loop](), list[tuple[int, float]]()
    for k, tendon in enumerate(tendons):
        for name, c in tendon.joints:
            if name not in model.held:
                J[:, k, model.qd_index(name)] += c
        for before, after in itertools.pairwise(tendon.path):
            a, b = (before, after) if before.link else (after, before)
            if isinstance(after, Via) and after.share > 0 and a.link is not None:  # not from world to world
                rods.append(Loop(f"{len(rods)}", "distance", a.link, b.link, a.point, b.point, distance=1.0))
                of.append((k, after.share))
    if rods:
        measures, rows = loop_measures(_with_rods(model, tuple(rods)), q, qd)
        for r, (k, share) in enumerate(of):
            J[:, k] += share * rows[:, r]
            bias[:, k] += share * measures[:, 2, r]
    return J, bias


@functools.lru_cache(maxsize=16)
def _with_rods(model: Model, rods: tuple[Loop, ...]) -> Model:
    return replace(model, loops=rods)


def _forward(
    model: Model, x: dict[str, np.ndarray], wrench: Wrenches | None, robot: Robot
) -> tuple[np.ndarray, np.ndarray]:
    """Compute accelerations (n, nv) of robots whose loops stay closed, and the forces (n, m) of the loops."""
    tree, n, forces, m = compile_tree(model), len(x["q"]), None, 0
    robot = robot._replace(coupling=tree.coupling, floating=True if tree.floating else None)
    if model.loops:
        loops = build_loops(model)
        m, forces = loops.rows, np.zeros((n, loops.rows))
        robot = robot._replace(loops=LoopTable(loops.table, np.array([m])), held=loops.held)
    blocks = len(model.couplings) + len(model.loops)

    def scratch(zeros: Callable) -> tuple:
        count = len(model.couplings) + m
        rows = make_rows(blocks, count, (1, tree.n + 1), m, zeros) if blocks else None
        return zeros((1, *tree.workspace_shape())), rows

    found = _solve(model, batch.aba_rows, batch.aba_lanes, x, wrench, (robot, scratch, forces))
    return found[0], np.zeros((n, 0)) if found[1] is None else found[1]


def inverse_dynamics(
    model: Model,
    q: ArrayLike,
    qd: ArrayLike,
    qdd: ArrayLike,
    *,
    wrench: Wrenches | None = None,
    armature: ArrayLike | None = None,
    stiffness: ArrayLike | None = None,
    gravity: ArrayLike = GRAVITY,
) -> np.ndarray:
    """Compute the generalized forces that a motion takes (recursive Newton-Euler algorithm, RBDA Table 5.1).

    Gravity, what bears weight, springs of joints and tendons act besides them; damping, friction, servos and stops do
    not.  Couplings of joints are ignored: with G of `coupling_matrix`, G' tau drives the independent joints.  So are
    loops: tau + J' f with J of `loop_jacobian` does the same for any forces f of the loops.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].
    qd : array_like
        Velocities (nv,) or (n, nv) [m/s, rad/s or m/s].
    qdd : array_like
        Accelerations (nv,) or (n, nv) [m/s^2, rad/s^2 or m/s^2].
    wrench : Mapping of str to Wrench, optional
        External forces and moments by link name, at the origin of the link's frame, in world axes.
    armature : array_like, optional
        Inertia (joints,) added to each joint, such as G^2 J of a rotor [kg m^2 or kg]; None takes the model's.
    stiffness : array_like, optional
        Stiffness (joints,) of the joints' springs [N m/rad or N/m]; None takes the model's.
    gravity : array_like, optional
        Acceleration of gravity (3,) [m/s^2].

    Returns
    -------
    numpy.ndarray
        Generalized forces (nv,) or (n, nv) [N, N m], in the order of `tau` in `forward_dynamics`.

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    x = _arguments(model, q=q, qd=qd, qdd=qdd)
    robot, workspace = _robot(model, armature, gravity), compile_tree(model).workspace_shape()
    given = robot, lambda zeros: zeros((1, *workspace)), False
    out, _ = _solve(model, batch.rnea_rows, batch.rnea_lanes, x, wrench, given)
    pull = _spring_torque(model, x["q"], stiffness)
    heavy = [one for one in model.tendons if one.armature > 0]
    if heavy:
        J, bias = _tendon_motion(model, x["q"], x["qd"], heavy)
        f = [one.armature for one in heavy] * (applied(J, x["qdd"]) + bias)
        out = out + applied(np.swapaxes(J, 1, 2), f)
    return _shaped(out if pull is None else out - pull, q, qd, qdd)


def mass_matrix(model: Model, q: ArrayLike, *, armature: ArrayLike | None = None) -> np.ndarray:
    """Compute the joint-space inertia matrix (composite-rigid-body algorithm, RBDA Table 6.2).

    Couplings of joints are ignored: with G of `coupling_matrix`, G' M G is the matrix of the independent joints.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].
    armature : array_like, optional
        Inertia (joints,) added to each joint [kg m^2 or kg]; None takes the model's.

    Returns
    -------
    numpy.ndarray
        Mass matrix (nv, nv) or (n, nv, nv) [kg, kg m, kg m^2].

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    x, tree = _arguments(model, q=q), compile_tree(model)
    H = np.zeros((len(x["q"]), model.nv, model.nv))
    batch.crba_rows(_robot(model, armature, np.zeros(3)), _still(tree, x["q"]), _work(tree), H)
    heavy = [one for one in model.tendons if one.armature > 0]
    if heavy:
        J, _ = _tendon_motion(model, x["q"], np.zeros((len(H), model.nv)), heavy)
        H += product(np.swapaxes(J, 1, 2) * [one.armature for one in heavy], J)
    return _shaped(H, q)


class Coupling(NamedTuple):
    """The positions and velocities of all joints as functions of those of the independent (uncoupled) ones.

    Attributes
    ----------
    matrix : numpy.ndarray
        G (nv, m): velocities qd = G @ (velocities of the base and of the independent joints, in file order).
    offset : numpy.ndarray
        Offsets (joints,): positions = rows of G of the joints @ (positions of the independent joints) + offset
        [rad or m].
    """

    matrix: np.ndarray
    offset: np.ndarray

    def __repr__(self) -> str:
        return brief(self)


def coupling_matrix(model: Model) -> Coupling:
    """Compute how the velocities of all joints follow from those of the independent ones.

    G' M G and G' c are mass matrix and bias forces of the motion that the couplings leave.  G is the identity for a
    robot without coupled joints.

    Parameters
    ----------
    model : Model
        The robot.

    Returns
    -------
    Coupling
        Matrix G (nv, m) and offset (joints,).
    """
    check_model(model)
    G, offset, followers = np.eye(model.nv), np.zeros(len(model.joint_names)), []
    for name, leader, multiplier, at_zero in model.couplings:
        row = model.qd_index(name)
        G[row], G[row, model.qd_index(leader)] = 0.0, multiplier
        offset[model.joint_rows[name]] = at_zero
        followers.append(row)
    return Coupling(np.delete(G, followers, axis=1), offset)


def energy(
    model: Model, q: ArrayLike, qd: ArrayLike, *, armature: ArrayLike | None = None, gravity: ArrayLike = GRAVITY
) -> Energy:
    """Compute kinetic and potential energy.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].
    qd : array_like
        Velocities (nv,) or (n, nv) [m/s, rad/s or m/s].
    armature : array_like, optional
        Inertia (joints,) added to each joint [kg m^2 or kg]; None takes the model's.
    gravity : array_like, optional
        Acceleration of gravity (3,) [m/s^2]; heights count from the world's origin.

    Returns
    -------
    Energy
        Array (2,) or (n, 2) [J] with the attributes `kinetic`, `potential` and `total`.

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    out = _measures(model, q, qd, armature, gravity)[0]
    x, joints = _arguments(model, q=q)["q"], model.moving_joints
    stiffness = np.array([joint.stiffness for joint in joints])
    powers = np.array([(joint.quadratic_stiffness, joint.cubic_stiffness) for joint in joints]).reshape(-1, 2)
    if stiffness.any() or powers.any():
        stretch = model.single_positions(x) - [joint.spring_reference for joint in joints]
        out[:, 1] += (0.5 * stiffness * stretch**2).sum(axis=1)
        b, c = powers.T
        if powers.any():
            out[:, 1] += total(stretch**3 * (b / 3.0 + 0.25 * c * stretch))
    for first, joint in zip(model.balls, model.ball_joints):
        if joint.stiffness:
            out[:, 1] += 0.5 * joint.stiffness * total(rotation_vectors(model, x, first) ** 2)
    if any(one.stiffness > 0 for one in model.tendons):
        out[:, 1] += total(tendon_energy(model, x))
    heavy = [one for one in model.tendons if one.armature > 0]
    if heavy:
        rates = _arguments(model, q=q, qd=qd)
        speed = applied(_tendon_motion(model, rates["q"], rates["qd"], heavy)[0], rates["qd"])
        out[:, 0] += total(0.5 * np.array([one.armature for one in heavy]) * speed**2)
    for link in model.links:
        if link.gravity_compensation:
            rotation, position = forward_kinematics(model, x, link.name)
            heights = (position + applied(rotation, np.array(link.center_of_mass))) @ np.asarray(gravity)
            out[:, 1] += link.gravity_compensation * link.mass * heights
    return _shaped(out, q, qd).view(Energy)


def center_of_mass(model: Model, q: ArrayLike) -> np.ndarray:
    """Compute the center of mass in the world, a fixed base included.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        Position (3,) or (n, 3) [m].

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    check_model(model)
    return _shaped(_measures(model, q, np.zeros(model.nv), None, GRAVITY)[1][:, :3], q)


def momentum(model: Model, q: ArrayLike, qd: ArrayLike) -> np.ndarray:
    """Compute the angular momentum about the center of mass and the linear momentum, in world axes.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].
    qd : array_like
        Velocities (nv,) or (n, nv) [m/s, rad/s or m/s].

    Returns
    -------
    numpy.ndarray
        Angular and linear momentum (6,) or (n, 6) [kg m^2/s, kg m/s].

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    return _shaped(_measures(model, q, qd, None, GRAVITY)[2], q, qd)


def forward_kinematics(model: Model, q: ArrayLike, link: str | Sequence[str] | None = None) -> Poses:
    """Compute the pose of every link, of some, or of one.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].
    link : str or sequence of str, optional
        Name of a link, or names of some; None for all links, in the order of `model.links`.

    Returns
    -------
    Poses
        Rotations (..., links, 3, 3) and positions (..., links, 3) [m]; of one link (..., 3, 3) and (..., 3).

    Raises
    ------
    ValueError
        For wrong shapes, values that are not finite and a link that does not exist.
    """
    check_model(model)
    if link is None or not isinstance(link, str):
        return _link_poses(model, q, [*(model.link_rows if link is None else (model.link(name).name for name in link))])
    rotation, position = _link_poses(model, q, [model.link(link).name])
    return Poses(rotation[..., 0, :, :], position[..., 0, :])


def _link_poses(model: Model, q: ArrayLike, links: Sequence[str]) -> Poses:
    x, tree = _arguments(model, q=q), compile_tree(model)
    poses = _poses(tree, x["q"])
    places = [tree.placements[name] for name in links]
    E = poses[:, [place.row for place in places], :9].reshape(len(poses), -1, 3, 3)
    rotation = product(E, np.array([place.E for place in places]))
    position = poses[:, [place.row for place in places], 9:] + applied(E, np.array([place.r for place in places]))
    if tree.floating:
        position = position + x["q"][:, None, :3]
    return Poses(_shaped(rotation, q), _shaped(position, q))


def spring_energy(model: Model, springs: Sequence[Spring], q: ArrayLike) -> np.ndarray:
    """Compute the energy stored in springs between links.

    Parameters
    ----------
    model : Model
        The robot.
    springs : sequence of Spring
        The springs.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        Energy of each spring (springs,) or (n, springs) [J].

    Raises
    ------
    ValueError
        For links that do not exist, wrong shapes and values that are not finite.
    """
    springs = listed("springs", springs, "give a list of Spring")
    stretch = np.linalg.norm(spring_vectors(model, springs, q), axis=-1) - [spring.length for spring in springs]
    return 0.5 * np.array([spring.stiffness for spring in springs]) * stretch**2


def spring_vectors(model: Model, springs: Sequence[Spring], q: ArrayLike) -> np.ndarray:
    """Compute the vectors from point a to point b of springs between links.

    Parameters
    ----------
    model : Model
        The robot.
    springs : sequence of Spring
        The springs.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        Vectors (springs, 3) or (n, springs, 3) in world axes [m].

    Raises
    ------
    ValueError
        For links that do not exist, wrong shapes and values that are not finite.
    """
    check_model(model)
    check_springs(model.links, springs)
    poses = forward_kinematics(model, q)
    b = _points(list(model.link_rows), poses, [(spring.b, spring.point_b) for spring in springs])
    return b - _points(list(model.link_rows), poses, [(spring.a, spring.point_a) for spring in springs])


def tendon_lengths(model: Model, q: ArrayLike) -> np.ndarray:
    """Compute the lengths of the tendons.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        Length of each tendon (tendons,) or (n, tendons) [m or rad].

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    return lengths_of(model, positions_of(model, q), model.tendons)


def tendon_energy(model: Model, q: ArrayLike) -> np.ndarray:
    """Compute the energy stored in the springs of the tendons.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        Energy of each tendon (tendons,) or (n, tendons) [J].

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    force = spring_forces(model.tendons, tendon_lengths(model, q))
    stiffness = np.array([one.stiffness for one in model.tendons])
    return 0.5 * force * force / np.where(stiffness > 0.0, stiffness, 1.0)


def positions_of(model: Model, q: ArrayLike) -> np.ndarray:
    """Return positions (nq,) or (n, nq) as an array; raise ValueError for wrong shapes and values."""
    return _shaped(_arguments(model, q=q)["q"], q)


def lengths_of(model: Model, q: np.ndarray, tendons: Iterable[Tendon]) -> np.ndarray:
    """Compute the lengths (..., k) of any tendons."""
    tendons = list(tendons)
    lengths, single = np.zeros((*q.shape[:-1], len(tendons))), model.single_positions(q)
    poses = forward_kinematics(model, q) if any(one.path for one in tendons) else None
    for k, tendon in enumerate(tendons):
        for name, c in tendon.joints:
            if name in model.ball_names:
                x = rotation_vectors(model, q, model.balls[model.ball_names.index(name)])
                lengths[..., k] += c * np.sqrt(total(x * x))
                continue
            held = name in model.held
            lengths[..., k] += c * (model.held[name] if held else single[..., model.joint_rows[name]])
        if poses is not None:
            for one in pieces(model, poses, tendon):
                lengths[..., k] += one.share * one.length
    return lengths


class Piece(NamedTuple):
    """A straight piece of a tendon between points of two links, None for the world."""

    link_a: str | None
    a: np.ndarray  # (..., 3) in the world [m]
    link_b: str | None
    b: np.ndarray
    direction: np.ndarray  # (..., 3)
    length: np.ndarray  # (...) with that of the bend after it [m]
    share: float


def pieces(model: Model, poses: Poses, tendon: Tendon) -> Iterator[Piece]:
    """Yield the straight pieces of a path; around a shape two, the first of the whole length where it does not turn."""
    for k, after in enumerate(tendon.path):
        wrap = tendon.path[k - 1] if k else None
        before = tendon.path[k - 2] if isinstance(wrap, Wrap) else wrap
        if not (isinstance(before, Via) and isinstance(after, Via) and after.share > 0):
            continue
        a, b = (_place_of(model, poses, one.link, one.point) for one in (before, after))
        distance, way = _direction(a, b)
        if not isinstance(wrap, Wrap):
            yield Piece(before.link, a, after.link, b, way, distance, after.share)
            continue
        turns, c, d, arc = _touching_points(model, poses, wrap, a, b)
        (first, e), (last, f), bent = _direction(a, c), _direction(d, b), turns[..., None]
        c, d = np.where(bent, c, b), np.where(bent, d, b)
        length = np.where(turns, first + arc + last, distance)
        yield Piece(before.link, a, wrap.link, c, np.where(bent, e, way), length, after.share)
        yield Piece(wrap.link, d, after.link, b, np.where(bent, f, way), 0.0 * length, after.share)


def _place_of(model: Model, poses: Poses, link: str | None, point: Sequence[float]) -> np.ndarray:
    if link is None:
        return np.zeros_like(poses.position[..., 0, :]) + np.array(point)
    row = model.link_index(link)
    return poses.position[..., row, :] + applied(poses.rotation[..., row, :, :], np.array(point))


def _direction(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance (...) of points and the direction (..., 3) from one to the other, 0 where they meet."""
    way = b - a
    distance = np.sqrt(total(way * way))
    return distance, way / np.where(distance > 0.0, distance, 1.0)[..., None]


def _touching_points(
    model: Model, poses: Poses, wrap: Wrap, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return whether the way around a shape turns (...), its points of contact (..., 3) and its bend (...) [m]."""
    table = wrap_record(wrap, np.eye(3))
    E = table.E[0].reshape(3, 3)
    if wrap.link is not None:
        E = product(poses.rotation[..., model.link_index(wrap.link), :, :], E)
    center, back = _place_of(model, poses, wrap.link, wrap.point), np.swapaxes(E, -1, -2)
    local = [np.ascontiguousarray(applied(back, one - center).reshape(-1, 3)) for one in (a, b)]
    out = np.zeros((len(local[0]), 8))
    ways_around(table, *local, out)
    out = out.reshape(*a.shape[:-1], 8)
    c, d = (center + applied(E, out[..., k : k + 3]) for k in (1, 4))
    return out[..., 0] > 0, c, d, out[..., 7]


def spring_forces(tendons: Iterable[Tendon], lengths: np.ndarray) -> np.ndarray:
    """Return the forces of the tendons' springs (..., k) [N or N m] at lengths, positive where they lengthen."""
    tendons = list(tendons)
    lower, upper = np.array([one.slack for one in tendons]).reshape(-1, 2).T
    stiffness = np.array([one.stiffness for one in tendons])
    return stiffness * (np.maximum(lower - lengths, 0.0) - np.maximum(lengths - upper, 0.0))


def contact_positions(model: Model, q: ArrayLike) -> np.ndarray:
    """Compute where the contact points are in the world; of spheres and discs their lowest points.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) or (n, nq) [m, -, rad or m].

    Returns
    -------
    numpy.ndarray
        Positions (points, 3) or (n, points, 3) [m], in the order of `model.contacts`.

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    check_model(model)
    links = [point.link for point in model.contacts]
    links = list(dict.fromkeys(links)) or list(model.link_rows)
    return deepest_points(model, _link_poses(model, q, links), (0.0, 0.0, 1.0), links)


def contact_positions_at(model: Model, poses: Poses, links: Sequence[str] | None = None) -> np.ndarray:
    """Compute `contact_positions` for poses that are known.

    Parameters
    ----------
    model : Model
        The robot.
    poses : Poses
        Poses of links.
    links : sequence of str, optional
        Names of the links of the poses, in their order, with all that have contacts; None for all of the model.

    Returns
    -------
    numpy.ndarray
        Positions (..., points, 3) [m].
    """
    return deepest_points(model, poses, (0.0, 0.0, 1.0), links)


def deepest_points(model: Model, poses: Poses, normal: ArrayLike, links: Sequence[str] | None = None) -> np.ndarray:
    """Compute where each contact reaches deepest against a normal (`core/effects/touch.py`).

    Parameters
    ----------
    model : Model
        The robot.
    poses : Poses
        Poses of links.
    normal : array_like
        Normal (3,), or one for each point (..., points, 3).
    links : sequence of str, optional
        Names of the links of the poses, in their order; None for all of the model.

    Returns
    -------
    numpy.ndarray
        Positions (..., points, 3) in the world [m].
    """
    links = list(model.link_rows) if links is None else links
    points = _points(links, poses, [(point.link, point.position) for point in model.contacts])
    if not any(point.radius or point.circle_radius for point in model.contacts):
        return points
    rows = {name: k for k, name in enumerate(links)}
    E = poses.rotation[..., [rows[point.link] for point in model.contacts], :, :]
    a = applied(E, np.array([point.axis for point in model.contacts]))
    radius, rim = np.array([(point.radius, point.circle_radius) for point in model.contacts]).T[..., None]
    n = np.broadcast_to(np.asarray(normal, dtype=float), a.shape)
    across = (a * n).sum(axis=-1, keepdims=True)
    level = n - across * a
    thin = FLATNESS**2 * across
    size = np.sqrt((level * level).sum(axis=-1, keepdims=True) + thin * across)
    return points - radius * n - rim / size * (level + thin * a)


def _points(links: Sequence[str], poses: Poses, points: list[tuple[str, Sequence[float]]]) -> np.ndarray:
    """Compute world positions (..., points, 3) of points given by their link and their position in its frame."""
    rows = {name: k for k, name in enumerate(links)}
    at = [rows[link] for link, _ in points]
    local = np.array([position for _, position in points], dtype=float).reshape(-1, 3)
    return poses.position[..., at, :] + applied(poses.rotation[..., at, :, :], local)


def _arguments(model: Model, **arrays: ArrayLike) -> dict[str, np.ndarray]:
    """Return the arguments as rows (n, width); raise ValueError for wrong shapes and values."""
    check_model(model)
    rows = {}
    for name, value in arrays.items():
        width = model.nq if name == "q" else model.nv
        a = floats(name, value)
        if a.ndim not in (1, 2) or a.shape[-1] != width:
            raise ValueError(f"{model.name}: {name} has shape {a.shape}; it must be ({width},) or (n, {width})")
        if not (np.abs(a) <= HUGE).all():
            wrong = a[~(np.abs(a) <= HUGE)][0]
            text = "is beyond 1e50: correct it" if np.isfinite(wrong) else "is not finite"
            raise ValueError(f"{model.name}: {name} has a value that {text}: {wrong}")
        rows[name] = np.atleast_2d(a)
    n = max(len(a) for a in rows.values())
    for name, a in rows.items():
        if len(a) not in (1, n):
            raise ValueError(f"{model.name}: {name} has {len(a)} rows where another argument has {n}; give 1 or {n}")
    _check_positions(model, rows["q"])
    return {name: np.broadcast_to(a, (n, a.shape[-1])) for name, a in rows.items()}


def check_model(model: Model) -> Model:
    """Check that an argument is a model.

    Parameters
    ----------
    model : Model
        The robot.

    Returns
    -------
    Model
        The same.

    Raises
    ------
    TypeError
        For anything else.
    """
    instance("model", model, Model, "give what load_robot returns")
    return model


def _check_positions(model: Model, q: np.ndarray) -> None:
    """Raise ValueError for angles too large to be reduced exactly and quaternions without a direction."""
    if model.base == "floating":
        largest = np.abs(q[:, 3:7]).max(axis=1)
        if not ((largest > 5e-7) & (largest < 1e6)).all():
            raise ValueError(
                f"{model.name}: the base's quaternion q[3:7] is zero or beyond 1e6; [1, 0, 0, 0] is no rotation"
            )
    for place, joint in zip(model.position_slices, model.moving_joints):
        k = place.start
        if is_first(joint):
            largest = np.abs(q[:, place]).max(axis=1)
            if not ((largest > 5e-7) & (largest < 1e6)).all():
                raise ValueError(
                    f"{model.name}: the quaternion of ball joint {ball_name(joint)}, q[{k}:{k + 4}], is zero or beyond "
                    "1e6; [1, 0, 0, 0] is no rotation"
                )
        elif joint.type not in ("prismatic", "ball") and (np.abs(q[:, k]) > SINCOS_LIMIT).any():
            raise ValueError(
                f"{model.name}: q: angle of {joint.name} is {q[np.abs(q[:, k]).argmax(), k]:g} rad; "
                f"at most {SINCOS_LIMIT:.0f} rad: subtract whole turns"
            )


def _shaped(out: np.ndarray, *arguments: ArrayLike) -> np.ndarray:
    """Return one state for one state, rows for rows."""
    return out[0] if all(np.ndim(a) == 1 for a in arguments) else out


def _split(tree: Tree, a: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
    """Copy the columns of base and joints (a read-only array is another type to compile for); the base may be None."""
    k = a.shape[1] - tree.n
    return (np.array(a[:, :k], order="C") if k else None), np.array(a[:, k:], order="C")


def _robot(model: Model, armature: ArrayLike | None, gravity: ArrayLike) -> Robot:
    tree = compile_tree(model)
    added = joint_armature(model) if armature is None else vector("armature", armature, tree.n)
    return Robot(tree.bodies, added, vector("gravity", gravity, 3, "[m/s^2]"))


def _spring_torque(model: Model, q: np.ndarray, stiffness: ArrayLike | None) -> np.ndarray | None:
    """Compute the generalized forces (n, nv) of springs of joints and of tendons of joints; None without springs."""
    joints = model.moving_joints
    K = np.array([j.stiffness for j in joints]) if stiffness is None else vector("stiffness", stiffness, len(joints))
    sprung = [one for one in model.tendons if one.stiffness > 0 and one.joints]
    balls = [(first, one.stiffness) for first, one in zip(model.balls, model.ball_joints) if one.stiffness]
    nonlinear = stiffness is None and any(j.cubic_stiffness for j in joints)
    if not (K.any() or sprung or balls or nonlinear):
        return None
    force = np.zeros((len(q), model.nv))
    x = model.single_positions(q) - [j.spring_reference for j in joints]
    force[:, model.nv - len(joints) :] = -K * x
    if stiffness is None:
        square, cube = np.array([(j.quadratic_stiffness, j.cubic_stiffness) for j in joints]).reshape(-1, 2).T
        force[:, model.nv - len(joints) :] -= x * x * (square + cube * x)
    for first, k in balls:
        own = model.nv - len(joints) + first
        force[:, own : own + 3] -= k * rotation_vectors(model, q, first)
    for tendon, pull in zip(sprung, spring_forces(sprung, lengths_of(model, q, sprung)).T):
        for name, c in tendon.joints:
            if name not in model.held:
                force[:, model.qd_index(name)] += c * pull
    return force


def rotation_vectors(model: Model, q: np.ndarray, first: int) -> np.ndarray:
    """Compute the rotation vectors (..., 3) [rad] of the ball joint whose first degree this is, in the child's axes."""
    at = model.position_slices[first].start
    w, x = q[..., at], q[..., at + 1 : at + 4]
    size = np.sqrt(total(x * x))
    turned = 2.0 * np.where(w < 0.0, -1.0, 1.0) * angle(size, abs(w))
    return (turned / np.where(size > 0.0, size, 1.0))[..., None] * x


def _still(tree: Tree, q: np.ndarray) -> Motion:
    """Make states at rest."""
    return _motion(tree, q, np.zeros((len(q), tree.n + (6 if tree.floating else 0))))


def _motion(tree: Tree, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray | None = None) -> Motion:
    (base_qd, rates), first = _split(tree, qd), 7 if tree.floating else 0
    base_q, (joints, ball_q) = np.array(q[:, :first], order="C"), tree.split_positions(q[:, first:])
    base_qdd, accelerations = (None, None) if qdd is None else _split(tree, qdd)
    joints = np.array(joints, order="C")
    return Motion(base_q if first else None, base_qd, base_qdd, joints, rates, accelerations, ball_q)


def _solve(
    model: Model, rows: Callable, lanes: Callable, x: dict[str, np.ndarray], wrench: Wrenches | None, kernel: Any
) -> tuple[np.ndarray, np.ndarray | None]:
    """Run a kernel over all states, in lanes if there are enough to fill them.

    kernel: the robot, a function that makes the scratch from one that makes arrays, and what is filled beside the
    columns of base and joints: an array (n, ...) or None, False where the kernel has no such argument.
    """
    (robot, scratch, more), tree, n = kernel, compile_tree(model), len(x["q"])
    given: list[Motion | np.ndarray | None] = [_motion(tree, x["q"], x["qd"], x.get("qdd"))]
    if "tau" in x:
        given.extend(_split(tree, x["tau"]))
    given.append(_external(model, tree, x["q"], wrench, robot.gravity))
    outs = [np.zeros((n, 6)) if tree.floating else None, np.zeros((n, tree.n)), *([] if more is False else [more])]
    if n < WIDTH:
        rows(robot, *given, scratch(np.zeros), *outs)
    else:
        packed = [_to_lanes(a) for a in outs]
        lanes(robot, *(_to_lanes(a) for a in given), scratch(lambda shape: aligned((*shape, WIDTH))), *packed)
        outs = [a if a is None else np.moveaxis(a, -1, 1).reshape(-1, *a.shape[1:-1])[:n] for a in packed]
    found = np.concatenate([a for a in outs[:2] if a is not None], axis=1)
    return found, None if more is False else outs[2]


def _to_lanes(a: Motion | np.ndarray | None) -> Any:
    """Pack rows (n, ...) as aligned (ceil(n / WIDTH), ..., WIDTH); the last row fills up the last block."""
    if a is None:
        return None
    if isinstance(a, Motion):
        return Motion(*map(_to_lanes, a))
    blocks = -(-len(a) // WIDTH)
    filled = np.concatenate([a, np.repeat(a[-1:], blocks * WIDTH - len(a), axis=0)])
    out = aligned((blocks, *a.shape[1:], WIDTH))
    out[:] = np.moveaxis(filled.reshape(blocks, WIDTH, *a.shape[1:]), 1, -1)
    return out


def _external(
    model: Model, tree: Tree, q: np.ndarray, wrench: Wrenches | None, gravity: np.ndarray
) -> np.ndarray | None:
    """Compute external forces (n, bodies, 6) about the common origin; None if there are none.

    Borne weights and the springs of tendons along a path are among them.
    """
    if wrench is not None:
        instance("wrench", wrench, Mapping, "give {link: Wrench(force, moment)}")
    lifts = build_lifts(model, tree, gravity)
    sprung = [one for one in model.tendons if one.stiffness > 0 and one.path]
    if not wrench and lifts is None and not sprung:
        return None
    poses = _poses(tree, q)
    out = np.zeros((len(q), tree.n + 1, 6))
    for lift in () if lifts is None else lifts:
        p = poses[:, lift.body, 9:] + applied(poses[:, lift.body, :9].reshape(-1, 3, 3), lift.point)
        out[:, lift.body, :3] += np.cross(p, lift.force)
        out[:, lift.body, 3:] += lift.force
    for name, value in (wrench or {}).items():
        if name not in tree.placements:
            raise ValueError(f"{model.name}: wrench: no link {name!r} to push; links: {', '.join(tree.placements)}")
        force, moment = _force_and_moment(f"{model.name}: wrench on {name}", value, len(q))
        place = tree.placements[name]
        p = poses[:, place.row, 9:] + applied(poses[:, place.row, :9].reshape(-1, 3, 3), place.r)
        out[:, place.row, :3] += moment + np.cross(p, force)
        out[:, place.row, 3:] += force
    _add_paths(model, tree, q, sprung, poses, out)
    return out


def _add_paths(
    model: Model, tree: Tree, q: np.ndarray, tendons: list[Tendon], poses: np.ndarray, out: np.ndarray
) -> None:
    """Add the springs of tendons along a path to external forces."""
    if not tendons:
        return
    at, pulls = forward_kinematics(model, q), spring_forces(tendons, lengths_of(model, q, tendons))
    for tendon, pull in zip(tendons, pulls.T):
        for one in pieces(model, at, tendon):
            for link, end, sign in ((one.link_a, one.a, -one.share), (one.link_b, one.b, one.share)):
                if link is None:
                    continue
                place, force, row = tree.placements[link], sign * pull[:, None] * one.direction, model.link_index(link)
                back = np.swapaxes(at.rotation[..., row, :, :], -1, -2)
                arm = place.r + applied(place.E, applied(back, end - at.position[..., row, :]))
                p = poses[:, place.row, 9:] + applied(poses[:, place.row, :9].reshape(-1, 3, 3), arm)
                out[:, place.row, :3] += np.cross(p, force)
                out[:, place.row, 3:] += force


def _force_and_moment(what: str, value: Any, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the parts (n, 3) of a wrench."""
    instance(what, value, Wrench, "give Wrench(force, moment)")
    parts = [floats(f"{what}: {name}", part) for name, part in zip(value._fields, value)]
    for part in parts:
        if part.shape not in ((3,), (n, 3)) or not np.isfinite(part).all():
            expected = f"Wrench(force, moment), each (3,) or ({n}, 3) finite numbers"
            raise ValueError(f"{what} must be {expected}: {shown(value)}")
    force, moment = (np.broadcast_to(part, (n, 3)) for part in parts)
    return force, moment


def _poses(tree: Tree, q: np.ndarray) -> np.ndarray:
    """Compute rotation and position from the base's origin, (n, bodies, 12)."""
    out = np.zeros((len(q), tree.n + 1, 12))
    batch.poses_rows(Robot(tree.bodies, None, np.zeros(3)), _still(tree, q), _work(tree), out)
    return out


def _work(tree: Tree) -> np.ndarray:
    return np.zeros((1, *tree.workspace_shape()))


def _measures(
    model: Model, q: ArrayLike, qd: ArrayLike, armature: ArrayLike | None, gravity: ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute energies (n, 2), center of mass (n, 6) and momentum (n, 6)."""
    x, tree = _arguments(model, q=q, qd=qd), compile_tree(model)
    n = len(x["q"])
    outs = np.zeros((n, 2)), np.zeros((n, 6)), np.zeros((n, 6))
    batch.measures_rows(_robot(model, armature, gravity), _motion(tree, x["q"], x["qd"]), _work(tree), *outs)
    return outs
