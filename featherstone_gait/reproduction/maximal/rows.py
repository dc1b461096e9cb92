"""Joints and contacts as rows of constraints: J v = target + softness, with bounds on the force.

A hinge keeps three numbers of its anchor and two of its axis, a universal joint three and the right angle between its
axes.  A stop and dry friction are rows about the axis whose force is bounded.  A point on the ground has three rows: a
normal force, which only pushes, and a pyramid of friction.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.compile.jit import inline, kernel
from ...core.tree.spatial import add, cross, dot, load3, load6, load9, rotate, scale, store3, sub, symmetric
from .bodies import first_axis, second_axis
from .layout import FORCE, INVERSE, PLACE, SPEED, R

FREE = 1e300  # a bound that is none
BOUNCING = 1e-3  # speed from which on a contact bounces [m/s], as in SimTwo


@kernel
def fill_rows(w: Any, x: Any, h: float) -> int:
    """Fill the system (J M^-1 J' + CFM / h) lambda = right side of joints and contacts; return the number of rows."""
    m, erp = 0, w.engine[0].erp / h
    for k in range(len(w.joints)):
        m = _hold(x, w.joints[k], erp, m)
    for k in range(len(w.joints)):
        j = w.joints[k]
        m = _bound_axis(w, x, j, j.axis, (first_axis(x.X, j), erp, m))
        if j.universal:
            m = _bound_axis(w, x, j, j.second_axis, (second_axis(x.X, j), erp, m))
    m = _contact_rows(w, x, erp, m)
    _finish_rows(w, x, m, h)
    return m


@inline
def _hold(x: Any, j: Any, erp: float, m: int) -> int:
    """Fill the rows that hold the bodies of a joint together, from row m on; return the next row."""
    X, F, E = x.X, j.first, load9(x.X, j.a, R)
    ra, rb = rotate(E, j.anchor_a), rotate(load9(X, j.b, R), j.anchor_b)
    off = sub(add(load3(X, j.b, PLACE), rb), add(load3(X, j.a, PLACE), ra))
    for k in range(3):
        u = (-1.0 if k == 0 else 0.0, -1.0 if k == 1 else 0.0, -1.0 if k == 2 else 0.0)
        _begin_row(x, m + k, (j.a, j.b), (u, cross(ra, u), cross(u, rb)), erp * dot(off, u))
    p, s = first_axis(X, j), second_axis(X, j)
    off = cross(s, p)
    if j.universal:
        _angular_row(x, m + 3, j, off, -erp * dot(p, s))
        return m + 4
    q, r = rotate(E, (F[0], F[3], F[6])), rotate(E, (F[1], F[4], F[7]))
    _angular_row(x, m + 3, j, q, erp * dot(off, q))
    _angular_row(x, m + 4, j, r, erp * dot(off, r))
    return m + 5


@inline
def _bound_axis(w: Any, x: Any, j: Any, i: int, how: Any) -> int:
    """Fill a row for an active stop or dry friction of axis i; how: its direction, ERP / h, the next row."""
    axis, angle, (u, erp, m) = w.axes[i], x.q[i], how
    low, high, off = -axis.dry, axis.dry, 0.0
    if angle <= axis.lower:
        low, high, off = 0.0, FREE, axis.lower - angle
    elif angle >= axis.upper:
        low, high, off = -FREE, 0.0, axis.upper - angle
    if low < high:
        _angular_row(x, m, j, u, erp * off)
        x.rows[m].low, x.rows[m].high = low, high
        return m + 1
    return m


@kernel
def _contact_rows(w: Any, x: Any, erp: float, m: int) -> int:
    """Fill three rows of each touching point, from row m on; return the next row.

    A contact that closes fast leaves with a share of its speed.
    """
    for c in range(len(w.points)):
        p = w.points[c]
        center = load3(x.X, p.body, PLACE)
        at = add(center, rotate(load9(x.X, p.body, R), p.position))
        depth = p.height - dot(p.axes, at)
        if depth >= 0.0:
            for k in range(3):
                u, row = (p.axes[3 * k], p.axes[3 * k + 1], p.axes[3 * k + 2]), x.rows[m + k]
                _begin_row(x, m + k, (p.body, 0), (u, cross(sub(at, center), u), cross(u, at)), 0.0)
                row.shown = 3 * c + k
                if k > 0:
                    row.low, row.high, row.normal = -p.friction, p.friction, m
            normal, approach = x.rows[m], -_along(x.J, x, m, SPEED)
            normal.low, normal.target = 0.0, erp * depth
            if approach > BOUNCING:
                normal.target = max(normal.target, w.engine[0].bounce * approach)
            m += 3
    return m


@inline
def _angular_row(x: Any, m: int, j: Any, u: Any, target: float) -> None:
    """Fill a row on the angular velocity of b less that of a, along u."""
    _begin_row(x, m, (j.a, j.b), ((0.0, 0.0, 0.0), scale(u, -1.0), u), target)


@inline
def _begin_row(x: Any, m: int, bodies: Any, parts: Any, target: float) -> None:
    """Start a row without bounds; parts: of its Jacobian, linear of a (b has its negative), angular of a, of b."""
    row, J = x.rows[m], x.J
    store3(J, m, 0, parts[0])
    store3(J, m, 3, parts[1])
    store3(J, m, 6, scale(parts[0], -1.0))
    store3(J, m, 9, parts[2])
    row.a, row.b, row.target, row.low, row.high = bodies[0], bodies[1], target, -FREE, FREE
    row.force, row.normal, row.state, row.shown = 0.0, -1, 0, -1


@inline
def _along(L: np.ndarray, x: Any, m: int, k: int) -> float:
    """Return row m of L (rows, 12) times the columns k to k + 6 of its bodies in X."""
    total, a, b = 0.0, x.rows[m].a, x.rows[m].b
    for c in range(6):
        total += L[m, c] * x.X[a, k + c] + L[m, 6 + c] * x.X[b, k + c]
    return total


@kernel
def _finish_rows(w: Any, x: Any, rows: int, h: float) -> None:
    """Weigh the Jacobian, and compute softness, diagonal and right side of all rows."""
    for m in range(rows):
        row = x.rows[m]
        for side in range(2):
            i, k = row.b if side else row.a, 6 * side
            store3(x.M, m, k, scale(load3(x.J, m, k), w.bodies[i].inverse_mass))
            store3(x.M, m, k + 3, symmetric(load6(x.X, i, INVERSE), load3(x.J, m, k + 3)))
        row.soft = total = w.engine[0].cfm / h
        for c in range(12):
            total += x.J[m, c] * x.M[m, c]
        row.divisor = total
        row.right = (row.target - _along(x.J, x, m, SPEED)) / h - _along(x.M, x, m, FORCE)


@kernel
def show_forces(x: Any, rows: int, out: Any) -> None:
    """Write the forces of all points to out: normal and tangential [N]."""
    for k in range(len(out)):
        out[k] = 0.0
    for m in range(rows):
        if x.rows[m].shown >= 0:
            out[x.rows[m].shown] = x.rows[m].force
