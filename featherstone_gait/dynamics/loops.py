"""Gaps and Jacobians of loops; the velocities that couplings and loops leave free, and those that follow from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, texts
from ..base.brief import brief
from ..base.fixed_order import applied, product
from ..core.tree import batch
from ..core.tree.layout import Robot
from ..core.tree.rows import LOOP
from ..model import Model
from .loop_table import build_loops
from .states import as_given, as_rows, check_model, motion_of, workspace_of
from .tree import compile_tree

DEPENDENT = 1e-6  # of the largest pivot: what digits of files leave of a row that others imply


class IndependentCoordinates(NamedTuple):
    """The velocities and accelerations of a robot as functions of those of k independent coordinates.

    Attributes
    ----------
    indices : numpy.ndarray
        Which entries of qd are independent (k,), in order.
    matrix : numpy.ndarray
        G (nv, k): qd = G @ qd[indices].
    bias : numpy.ndarray
        Accelerations (nv,) at qd where the independent ones are zero: qdd = G @ qdd[indices] + bias [rad/s^2, m/s^2].
    """

    indices: np.ndarray
    matrix: np.ndarray
    bias: np.ndarray

    def __repr__(self) -> str:
        return brief(self)


def degrees_of_freedom(model: Model, q: ArrayLike) -> int:
    """Count the velocities that couplings and loops leave free in a posture.

    Loops that depend on each other, such as those of a planar four-bar in space, count once; 0 is a structure that
    cannot move.  In a singular posture, such as a stretched four-bar, the number is larger than beside it.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) [m, -, rad or m].

    Returns
    -------
    int
        Number of independent velocities, of nv at most.

    Raises
    ------
    ValueError
        For wrong shapes and values that are not finite.
    """
    return len(independent_coordinates(model, q).indices)


def independent_coordinates(
    model: Model, q: ArrayLike, qd: ArrayLike | None = None, independent: Sequence[str] = ()
) -> IndependentCoordinates:
    """Choose independent coordinates of a robot with couplings and loops, from which all others follow.

    With G, `matrix`, G' M G is the mass matrix of the motion that is left, J G the Jacobian of a link, and G' tau the
    forces on the independent coordinates, with tau of `inverse_dynamics` at qdd = G a + `bias`: forces of the loops
    have no part in it.  Dependent coordinates are the pivots of Gaussian elimination with complete pivoting (Golub and
    Van Loan, Matrix Computations, section 3.4), so that they follow with little amplification.

    Parameters
    ----------
    model : Model
        The robot.
    q : array_like
        Positions (nq,) with closed loops [m, -, rad or m].
    qd : array_like, optional
        Velocities (nv,) for `bias` [m/s, rad/s or m/s]; None: at rest.
    independent : sequence of str, optional
        Joints whose velocities are to be independent, such as those with motors.

    Returns
    -------
    IndependentCoordinates

    Raises
    ------
    ValueError
        For wrong shapes, values that are not finite, and for joints that depend on each other.

    Examples
    --------
    >>> free = independent_coordinates(model, q, independent=("crank",))
    >>> inertia = free.matrix.T @ mass_matrix(model, q) @ free.matrix
    """
    q = finite(f"{check_model(model).name}: q", q, (model.nq,))
    qd = finite(f"{model.name}: qd", np.zeros(model.nv) if qd is None else qd, (model.nv,))
    G = coupling_matrix(model).matrix
    leaders = leaders_of(model)
    wanted = {name: model.qd_index(name) for name in texts("independent", independent)}
    for name, k in wanted.items():
        if k not in leaders:
            raise ValueError(f"{model.name}: independent: joint {name!r} mimics another; name that one")
    if not model.loops or not len(leaders):
        return IndependentCoordinates(leaders, G, np.zeros(model.nv))
    measures, J = loop_measures(model, q, qd)
    dependent, follows = eliminated(product(J[0], G), -measures[0, 2], np.isin(leaders, [*wanted.values()]))
    lost = [name for name, k in wanted.items() if k in leaders[dependent]]
    if lost:
        raise ValueError(
            f"{model.name}: independent: velocities of {', '.join(map(repr, wanted))} depend on each other; "
            f"leave out {lost[0]!r}"
        )
    kept = np.delete(np.arange(len(leaders)), dependent)
    matrix = G[:, kept] + product(G[:, dependent], follows[:, kept])
    return IndependentCoordinates(leaders[kept], matrix, applied(G[:, dependent], follows[:, -1]))


def leaders_of(model: Model) -> np.ndarray:
    """Return which velocities couplings leave independent (m,), those of the columns of `coupling_matrix`."""
    return np.array([np.flatnonzero(column == 1.0)[0] for column in coupling_matrix(model).matrix.T], dtype=int)


def eliminated(A: np.ndarray, b: np.ndarray, last: np.ndarray) -> tuple[list[int], np.ndarray]:
    """Solve A x = b for as many components of x as A has independent rows; columns `last` are pivots after all others.

    Returns these components and a matrix (them, columns + 1): they are it @ [x, 1] with x the other components.
    """
    m, columns = A.shape
    A, pivots = np.concatenate([A, b[:, None]], axis=1), list[tuple[int, int]]()
    least = DEPENDENT * np.abs(A[:, :columns]).max(initial=0.0)
    for group in (~last, last):
        while group.any() and len(pivots) < m:
            left = np.abs(A[:, :columns]) * group
            left[[row for row, _ in pivots]] = 0.0
            row, column = divmod(int(left.argmax()), columns)
            if left[row, column] <= least:
                break
            A[row] /= A[row, column]
            others = np.arange(m) != row
            A[others] -= A[others, column, None] * A[row]
            pivots.append((row, column))
    rows = [row for row, _ in pivots]
    follows = -A[rows]
    follows[:, -1] *= -1.0
    return [column for _, column in pivots], follows


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
    return as_given(loop_measures(model, q)[0][:, 0], q)


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
    return as_given(loop_measures(model, q)[1], q)


def loop_measures(
    model: Model, q: ArrayLike, qd: ArrayLike | None = None, places: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Compute gap, J qd and Jdot qd (n, 3, m) of loops, and J (n, m, nv); places: other ones than the loops' own."""
    x = as_rows(check_model(model), q=q, qd=np.zeros(model.nv) if qd is None else qd)
    tree, loops, n = compile_tree(model), build_loops(model), len(x["q"])
    measures, J = np.zeros((n, 3, loops.rows)), np.zeros((n, loops.rows, tree.n))
    base_J = np.zeros((n, loops.rows, 6)) if tree.floating else None
    robot, at = Robot(tree.bodies, None, np.zeros(3)), motion_of(tree, x["q"], x["qd"])
    held = loops.held if places is None else (loops.held[0], places)
    scratch = workspace_of(tree), np.zeros((loops.rows, LOOP))
    batch.loop_rows(robot, (loops.table, held), at, *scratch, measures, base_J, J)
    return measures, J if base_J is None else np.concatenate([base_J, J], axis=2)
