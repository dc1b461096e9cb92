"""Mass matrix, frames and centers of mass in plain NumPy, for checks and preparations that need no compiling.

Composite rigid bodies (R. Featherstone, Rigid Body Dynamics Algorithms, 2008, section 6.2) in world axes: each joint
feels the mass, the center of mass and the inertia of all that it carries.  `core/tree/crba` is the compiled mass
matrix, and `dynamics.mass_matrix` its interface; this one serves `mass_checks` and `numpy_dynamics`.  Some results
end up in what kernels read: sums are taken in a fixed order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..base.fixed_order import applied, product, total
from ..base.rotation import cross, dot, rotation_about

TOLERANCE = 1e-13  # of what is to be above zero, relative; rounding makes some 1e-15


class Bodies(NamedTuple):
    """Rigid bodies of a tree in rows, parents before children; row 0 is the base, all others have a joint."""

    parent: list[int]
    E: np.ndarray  # (rows, 3, 3) rotation body -> parent, the joint at zero; its axis is the body's z
    r: np.ndarray  # (rows, 3) origin in the parent [m]
    prismatic: list[bool]
    pitch: np.ndarray  # (rows,) of screw joints, else 0 [m/rad]
    armature: np.ndarray  # (rows,) [kg m^2 or kg]
    mass: np.ndarray  # (rows,) [kg]
    center: np.ndarray  # (rows, 3) center of mass [m]
    inertia: np.ndarray  # (rows, 3, 3) about the center of mass [kg m^2]


def carried_mass(bodies: Bodies) -> np.ndarray:
    """Compute the mass (rows,) of each body with all that it carries [kg]."""
    mass = bodies.mass.copy()
    for k in range(len(mass) - 1, 0, -1):
        mass[bodies.parent[k]] += mass[k]
    return mass


def mass_matrix(
    bodies: Bodies, q: np.ndarray, known: tuple[np.ndarray, ...] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the matrix (rows + 5, rows + 5) of a floating tree, and the size (rows + 5,) of what coordinates move.

    q: (rows,) joint positions [rad or m], the first unused; known: `frames` and `composites` at q, if they are known.
    Coordinates are the base's velocity and angular velocity, in world axes, and the joints in the order of the rows.
    The size has the unit of the matrix's diagonal and is above zero wherever any mass or inertia is carried.
    """
    if known is None:
        E, o = frames(bodies, q)
        known = E, o, *composites(bodies, E, o)
    E, o, m, c, J = known
    n = len(bodies.parent)
    H, size = np.zeros((n + 5, n + 5)), np.zeros(n + 5)
    H[:6, :6], size[:6] = _base_block(m[0], c[0] - o[0], J[0])
    slides = np.array(bodies.prismatic)
    for k in range(1, n):
        arm = c[k] - o[k]
        axis = E[k][:, 2]
        if bodies.prismatic[k]:  # force, and moment about the joint, for a unit acceleration of it
            force, size[k + 5] = m[k] * axis, m[k]
            moment = cross(arm, force)
        else:
            force = m[k] * (cross(axis, arm) + bodies.pitch[k] * axis)
            size[k + 5] = np.abs(J[k]).sum() + m[k] * (dot(arm, arm) + bodies.pitch[k] ** 2)
            moment = applied(J[k], axis) + cross(arm, force)
        H[k + 5, :3] = force
        H[k + 5, 3:6] = moment + cross(o[k] - o[0], force)
        path = _path(bodies.parent, k)
        about = moment + cross((o[k] - o[path]).T, force).T
        along = about + bodies.pitch[path, None] * force
        H[k + 5, np.array(path) + 5] = total(E[path][:, :, 2] * np.where(slides[path, None], force, along))
        H[: k + 5, k + 5] = H[k + 5, : k + 5]
        H[k + 5, k + 5] += bodies.armature[k]
        size[k + 5] += bodies.armature[k]
    return H, size


def _path(parent: list[int], k: int) -> list[int]:
    """Return the rows from k to the base, without the base."""
    path = []
    while k > 0:
        path.append(k)
        k = parent[k]
    return path


def idle(H: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return the coordinates (k,) that alone move no inertia, to rounding."""
    return np.flatnonzero(~(np.diag(H) > TOLERANCE * size))


def loosest(H: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the least eigenvalue of the matrix scaled to a unit diagonal, and the share (n,) of each coordinate in it.

    The diagonal must be above zero.  A value up to TOLERANCE means that the matrix is not positive definite.
    """
    scale = 1.0 / np.sqrt(np.diag(H))
    values, vectors = np.linalg.eigh(H * scale * scale[:, None])
    return float(values[0]), np.abs(vectors[:, 0])


def frames(bodies: Bodies, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute rotation (rows, 3, 3) to the world and origin (rows, 3) [m] of each body; the base is at the origin."""
    E, o = bodies.E.copy(), bodies.r.copy()
    for k in range(1, len(o)):
        parent = bodies.parent[k]
        o[k] = o[parent] + applied(E[parent], bodies.r[k])
        E[k] = product(E[parent], bodies.E[k])
        if bodies.prismatic[k]:
            o[k] += E[k][:, 2] * q[k]
        else:
            o[k] += E[k][:, 2] * (bodies.pitch[k] * q[k])
            E[k] = product(E[k], rotation_about((0.0, 0.0, 1.0), math.remainder(q[k], math.tau)))
    return E, o


def composites(bodies: Bodies, E: np.ndarray, o: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute mass, center and inertia about it, in world axes, of each body with all that it carries.

    E, o: the `frames`.
    """
    m, c = bodies.mass.copy(), o + applied(E, bodies.center)
    J = product(product(E, bodies.inertia), E.transpose(0, 2, 1))
    for k in range(len(m) - 1, 0, -1):
        p = bodies.parent[k]
        together, d = m[p] + m[k], c[k] - c[p]
        if together > 0:
            J[p] += m[p] / together * m[k] * (dot(d, d) * np.eye(3) - np.outer(d, d))
            c[p] += m[k] / together * d
        J[p] += J[k]
        m[p] = together
    return m, c, J


def _base_block(m: float, arm: np.ndarray, J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the inertia (6, 6) of a body about a point `arm` before its center, and its size (6,)."""
    x, y, z = arm
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    about = J + m * (dot(arm, arm) * np.eye(3) - np.outer(arm, arm))
    whole = np.empty((6, 6))  # np.block takes ten times as long
    whole[:3, :3], whole[:3, 3:], whole[3:, :3], whole[3:, 3:] = m * np.eye(3), -m * K, m * K, about
    return whole, np.repeat([m, np.abs(about).sum()], 3)
