"""Joints as rows of constraints: J v = target + softness, with bounds on the force.

A hinge keeps three numbers of its anchor and two of its axis, a universal joint three and the right angle between its
axes, a weld three and three.  A stop and dry friction are rows about the axis whose force is bounded.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.compile.jit import inline, kernel
from ...core.tree.spatial import add, cross, dot, load3, load6, load9, rotate, scale, store3, sub, symmetric
from .bodies import first_axis, second_axis
from .layout import (
    DIAGONAL,
    FORCE,
    HIGH,
    INVERSE,
    LAMBDA,
    LOW,
    NORMAL,
    PLACE,
    RIGHT,
    SOFT,
    SPEED,
    STATE,
    TARGET,
    UNIVERSAL,
    WELD,
    A,
    B,
    R,
)

FREE = 1e300  # a bound that is none


@kernel
def joint_rows(w: Any, x: Any, h: float) -> int:
    """Fill the rows of all joints; return their number."""
    m, erp = 0, w.engine[0].erp / h
    for k in range(len(w.joints)):
        m = _keep_anchor(w, x, w.joints[k], erp, m)
        m = _keep_axes(w, x, w.joints[k], erp, m)
    for k in range(len(w.joints)):
        j = w.joints[k]
        if j.kind != WELD:
            m = _bound_axis(w, x, j, first_axis(x.X, j), (j.axis, erp, m))
        if j.kind == UNIVERSAL:
            m = _bound_axis(w, x, j, second_axis(x.X, j), (j.axis + 1, erp, m))
    return m


@inline
def _keep_anchor(w: Any, x: Any, j: Any, erp: float, m: int) -> int:
    X, J = x.X, x.J
    ra = rotate(load9(X, j.a, R), j.anchor_a)
    rb = rotate(load9(X, j.b, R), j.anchor_b)
    off = sub(add(load3(X, j.b, PLACE), rb), add(load3(X, j.a, PLACE), ra))
    for k in range(3):
        e = (1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0, 1.0 if k == 2 else 0.0)
        store3(J, m + k, 0, scale(e, -1.0))
        store3(J, m + k, 3, cross(e, ra))
        store3(J, m + k, 6, e)
        store3(J, m + k, 9, cross(rb, e))
        begin_row(x, m + k, j.a, j.b, -erp * dot(off, e), w.engine[0].cfm)
    return m + 3


@inline
def _keep_axes(w: Any, x: Any, j: Any, erp: float, m: int) -> int:
    X, cfm = x.X, w.engine[0].cfm
    p, s = first_axis(X, j), second_axis(X, j)
    if j.kind == UNIVERSAL:
        angular_row(x, m, j, cross(s, p), -erp * dot(p, s), cfm)
        return m + 1
    if j.kind == WELD:
        off = _twisted(X, j)
        angular_row(x, m, j, (1.0, 0.0, 0.0), erp * off[0], cfm)
        angular_row(x, m + 1, j, (0.0, 1.0, 0.0), erp * off[1], cfm)
        angular_row(x, m + 2, j, (0.0, 0.0, 1.0), erp * off[2], cfm)
        return m + 3
    E, F = load9(X, j.a, R), j.first
    off = cross(s, p)
    q, r = rotate(E, (F[0], F[3], F[6])), rotate(E, (F[1], F[4], F[7]))
    angular_row(x, m, j, q, erp * dot(off, q), cfm)
    angular_row(x, m + 1, j, r, erp * dot(off, r), cfm)
    return m + 2


@inline
def _twisted(X: np.ndarray, j: Any) -> Any:
    """Return the sine of the angle about its axis that turns b to where a weld holds it."""
    E, off = load9(X, j.a, R), (0.0, 0.0, 0.0)
    for k in range(3):
        target = rotate(E, (j.first[k], j.first[3 + k], j.first[6 + k]))
        off = add(off, scale(cross((X[j.b, R + k], X[j.b, R + 3 + k], X[j.b, R + 6 + k]), target), 0.5))
    return off


@inline
def _bound_axis(w: Any, x: Any, j: Any, u: Any, at: Any) -> int:
    """Fill a row for an active stop or dry friction; at: row of AXIS, ERP / h, the next row."""
    i, erp, m = at
    axis, angle, cfm = w.axes[i], x.angles[i, 0], w.engine[0].cfm
    if angle <= axis.lower:
        angular_row(x, m, j, u, erp * (axis.lower - angle), cfm)
        x.V[m, LOW] = 0.0
        return m + 1
    if angle >= axis.upper:
        angular_row(x, m, j, u, erp * (axis.upper - angle), cfm)
        x.V[m, HIGH] = 0.0
        return m + 1
    if axis.dry > 0.0:
        angular_row(x, m, j, u, 0.0, cfm)
        x.V[m, LOW], x.V[m, HIGH] = -axis.dry, axis.dry
        return m + 1
    return m


@inline
def angular_row(x: Any, m: int, j: Any, u: Any, target: float, cfm: float) -> None:
    """Fill a row on the difference of both bodies' angular velocities along u."""
    store3(x.J, m, 0, (0.0, 0.0, 0.0))
    store3(x.J, m, 3, scale(u, -1.0))
    store3(x.J, m, 6, (0.0, 0.0, 0.0))
    store3(x.J, m, 9, u)
    begin_row(x, m, j.a, j.b, target, cfm)


@inline
def begin_row(x: Any, m: int, a: int, b: int, target: float, cfm: float) -> None:
    """Start a row without bounds between two bodies."""
    V, I = x.V, x.I
    V[m, TARGET], V[m, SOFT], V[m, LOW], V[m, HIGH], V[m, LAMBDA] = target, cfm, -FREE, FREE, 0.0
    I[m, A], I[m, B], I[m, NORMAL], I[m, STATE] = a, b, -1, 0


@inline
def along(L: np.ndarray, x: Any, m: int, k: int) -> float:
    """Return row m of L (rows, 12) times the columns k to k + 6 of its bodies in X."""
    a, b = x.I[m, A], x.I[m, B]
    total = 0.0
    for c in range(6):
        total += L[m, c] * x.X[a, k + c] + L[m, 6 + c] * x.X[b, k + c]
    return total


@kernel
def finish_rows(w: Any, x: Any, rows: int, h: float) -> None:
    """Compute the system (J M^-1 J' + CFM / h) lambda = right side for all rows."""
    V = x.V
    for m in range(rows):
        _weigh(w, x, m)
        V[m, SOFT] = V[m, SOFT] / h
        total = V[m, SOFT]
        for c in range(12):
            total += x.J[m, c] * x.M[m, c]
        V[m, DIAGONAL] = total
        V[m, RIGHT] = (V[m, TARGET] - along(x.J, x, m, SPEED)) / h - along(x.M, x, m, FORCE)


@inline
def _weigh(w: Any, x: Any, m: int) -> None:
    """Multiply the Jacobian of row m by the inverse masses."""
    for side in range(2):
        i, k = x.I[m, side], 6 * side
        store3(x.M, m, k, scale(load3(x.J, m, k), w.bodies[i].inverse_mass))
        store3(x.M, m, k + 3, symmetric(load6(x.X, i, INVERSE), load3(x.J, m, k + 3)))
