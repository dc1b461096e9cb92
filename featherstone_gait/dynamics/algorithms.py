"""Dynamics algorithms as functions of a model, for one state or many.

Coordinates are those of `model/robot.py`: for a fixed base the joints in file order; for a floating base
``q = [x y z, qw qx qy qz, joints]``, ``qd = [velocity (world axes), angular velocity (body axes), joint velocities]``
and ``tau = [force (world axes), moment (body axes), joint torques]``.  Every argument may have a leading axis
of states, ``(n, nv)``; then eight states go through the kernels at once, with the same bits as one by one.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import vector
from ..base.brief import FEW
from ..base.fixed_order import applied, product, solve, total
from ..core.compile.lanes import WIDTH, aligned
from ..core.tree import batch
from ..core.tree.layout import Motion, Robot
from ..core.tree.loop import Loops as LoopTable
from ..core.tree.rows import make_rows
from ..model import Loop, Model, Tendon, Via
from ..model.numpy_dynamics import what_is_loose
from .kinematics import forward_kinematics, rotation_vectors
from .loop_table import build_loops
from .loops import loop_measures
from .states import as_given, as_rows, at_rest, check_model, motion_of, robot_of, split_base, workspace_of
from .tendons import lengths_of, spring_forces, tendon_energy
from .tree import GRAVITY, compile_tree
from .wrench import Wrenches, external_forces


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
    x = as_rows(model, q=q, qd=qd, tau=tau)
    robot = robot_of(model, armature, gravity)
    pull = _spring_torque(model, x["q"], stiffness)
    if pull is not None:
        x["tau"] = x["tau"] + pull
    out = _accelerations(model, _less_inertia(model, x, wrench, robot), wrench, robot)
    for row in np.flatnonzero(~np.isfinite(out).all(axis=1)):
        loose = what_is_loose(model, x["q"][row], robot.armature)
        if loose is not None:
            raise ValueError(f"{model.name}: {loose}, or ask for the accelerations in another posture")
    return as_given(out, q, qd, tau)


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
    x = as_rows(model, q=q, qd=qd, tau=tau)
    robot = robot_of(model, armature, gravity)
    pull = _spring_torque(model, x["q"], stiffness)
    if pull is not None:
        x["tau"] = x["tau"] + pull
    return as_given(_forward(model, _less_inertia(model, x, wrench, robot), wrench, robot)[1], q, qd, tau)


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
    x = as_rows(model, q=q, qd=qd, qdd=qdd)
    robot, workspace = robot_of(model, armature, gravity), compile_tree(model).workspace_shape()
    given = robot, lambda zeros: zeros((1, *workspace)), False
    out, _ = _solve(model, batch.rnea_rows, batch.rnea_lanes, x, wrench, given)
    pull = _spring_torque(model, x["q"], stiffness)
    heavy = [one for one in model.tendons if one.armature > 0]
    if heavy:
        J, bias = _tendon_motion(model, x["q"], x["qd"], heavy)
        f = [one.armature for one in heavy] * (applied(J, x["qdd"]) + bias)
        out = out + applied(np.swapaxes(J, 1, 2), f)
    return as_given(out if pull is None else out - pull, q, qd, qdd)


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
    x, tree = as_rows(model, q=q), compile_tree(model)
    H = np.zeros((len(x["q"]), model.nv, model.nv))
    batch.crba_rows(robot_of(model, armature, np.zeros(3)), at_rest(tree, x["q"]), workspace_of(tree), H)
    heavy = [one for one in model.tendons if one.armature > 0]
    if heavy:
        J, _ = _tendon_motion(model, x["q"], np.zeros((len(H), model.nv)), heavy)
        H += product(np.swapaxes(J, 1, 2) * [one.armature for one in heavy], J)
    return as_given(H, q)


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
    x, joints = as_rows(model, q=q)["q"], model.moving_joints
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
        rates = as_rows(model, q=q, qd=qd)
        speed = applied(_tendon_motion(model, rates["q"], rates["qd"], heavy)[0], rates["qd"])
        out[:, 0] += total(0.5 * np.array([one.armature for one in heavy]) * speed**2)
    for link in model.links:
        if link.gravity_compensation:
            rotation, position = forward_kinematics(model, x, link.name)
            heights = (position + applied(rotation, np.array(link.center_of_mass))) @ np.asarray(gravity)
            out[:, 1] += link.gravity_compensation * link.mass * heights
    return as_given(out, q, qd).view(Energy)


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
    return as_given(_measures(model, q, np.zeros(model.nv), None, GRAVITY)[1][:, :3], q)


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
    return as_given(_measures(model, q, qd, None, GRAVITY)[2], q, qd)


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


def _solve(
    model: Model, rows: Callable, lanes: Callable, x: dict[str, np.ndarray], wrench: Wrenches | None, kernel: Any
) -> tuple[np.ndarray, np.ndarray | None]:
    """Run a kernel over all states, in lanes if there are enough to fill them.

    kernel: the robot, a function that makes the scratch from one that makes arrays, and what is filled beside the
    columns of base and joints: an array (n, ...) or None, False where the kernel has no such argument.
    """
    (robot, scratch, more), tree, n = kernel, compile_tree(model), len(x["q"])
    given: list[Motion | np.ndarray | None] = [motion_of(tree, x["q"], x["qd"], x.get("qdd"))]
    if "tau" in x:
        given.extend(split_base(tree, x["tau"]))
    given.append(external_forces(model, tree, x["q"], wrench, robot.gravity))
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


def _measures(
    model: Model, q: ArrayLike, qd: ArrayLike, armature: ArrayLike | None, gravity: ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute energies (n, 2), center of mass (n, 6) and momentum (n, 6)."""
    x, tree = as_rows(model, q=q, qd=qd), compile_tree(model)
    n = len(x["q"])
    outs = np.zeros((n, 2)), np.zeros((n, 6)), np.zeros((n, 6))
    batch.measures_rows(robot_of(model, armature, gravity), motion_of(tree, x["q"], x["qd"]), workspace_of(tree), *outs)
    return outs
