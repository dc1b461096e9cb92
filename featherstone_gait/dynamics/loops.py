"""Velocities that couplings and loops leave free, and those that follow from them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, texts
from ..base.brief import brief
from ..base.fixed_order import applied, product
from ..model import Model
from .algorithms import check_model, coupling_matrix, loop_measures

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
