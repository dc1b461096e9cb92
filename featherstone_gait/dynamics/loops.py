"""Count the degrees of freedom of a robot with loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite
from ..base.fixed_order import applied, product, total
from ..model import Model
from .algorithms import check_model, coupling_matrix, loop_jacobian

DEPENDENT = 1e-6  # of the largest row: what digits of files leave of a row that others imply


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
    q = finite(f"{check_model(model).name}: q", q, (model.nq,))
    G = coupling_matrix(model).matrix
    return G.shape[1] - (_rank(product(loop_jacobian(model, q), G)) if model.loops and G.shape[1] else 0)


def _rank(A: np.ndarray) -> int:
    """Count independent rows, by Gram and Schmidt, the largest row first."""
    A = A.copy()
    largest = np.sqrt(total(A * A)).max(initial=0.0)
    for rank in range(min(A.shape)):
        sizes = np.sqrt(total(A * A))
        row = int(sizes.argmax())
        if sizes[row] <= DEPENDENT * largest:
            return rank
        along = A[row] / sizes[row]
        for _ in range(2):  # the second time takes away what rounding has left
            A = A - applied(A, along)[:, None] * along
    return min(A.shape)
