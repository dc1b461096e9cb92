"""Contacts as rows: points of one body against a plane of another, with a pyramid of friction and bounce."""

from __future__ import annotations

from typing import Any

from ...core.compile.jit import inline, kernel
from ...core.tree.spatial import add, cross, dot, load3, load9, rotate, scale, store3, sub
from .layout import HIGH, LAMBDA, LOW, NORMAL, PLACE, SPEED, TARGET, TOUCHED, R
from .rows import along, begin_row


@kernel
def contact_rows(w: Any, x: Any, h: float, m: int) -> int:
    """Fill three rows of each touching point, from row m on; return the next row."""
    X = x.X
    for c in range(len(w.points)):
        p = w.points[c]
        E = load9(X, p.b, R)
        n, origin = rotate(E, p.normal), load3(X, p.b, PLACE)
        at = add(load3(X, p.a, PLACE), rotate(load9(X, p.a, R), p.position))
        at = sub(at, scale(n, p.radius))
        depth = p.height - dot(n, sub(at, origin))
        if depth >= 0.0:
            m = _touch(w, x, p, (c, m, at, depth, h))
    return m


@inline
def _touch(w: Any, x: Any, p: Any, touch: Any) -> int:
    """Fill the rows of a point; touch: its index, first row, position [m], depth [m], and the step [s]."""
    c, m, at, depth, h = touch
    X, V, e = x.X, x.V, w.engine[0]
    E = load9(X, p.b, R)
    ra, rb = sub(at, load3(X, p.a, PLACE)), sub(at, load3(X, p.b, PLACE))
    _linear_row(x, m, p, (rotate(E, p.normal), ra, rb), e.soft_cfm)
    _linear_row(x, m + 1, p, (rotate(E, p.first), ra, rb), e.cfm)
    _linear_row(x, m + 2, p, (rotate(E, p.second), ra, rb), e.cfm)
    V[m, LOW], V[m, TARGET] = 0.0, e.erp / h * depth
    approach = -along(x.J, x, m, SPEED)
    if approach > e.bounce_speed:
        V[m, TARGET] = max(V[m, TARGET], e.bounce * approach)
    for k in range(1, 3):
        V[m + k, LOW], V[m + k, HIGH] = -p.friction, p.friction
        x.I[m + k, NORMAL] = m
    x.I[m, TOUCHED] = c
    return m + 3


@inline
def _linear_row(x: Any, m: int, p: Any, along_what: Any, cfm: float) -> None:
    """Fill a row on the relative velocity of two points; along_what: direction, arms [m]."""
    u, ra, rb = along_what
    store3(x.J, m, 0, u)
    store3(x.J, m, 3, cross(ra, u))
    store3(x.J, m, 6, scale(u, -1.0))
    store3(x.J, m, 9, cross(u, rb))
    begin_row(x, m, p.a, p.b, 0.0, cfm)


@kernel
def contact_forces(w: Any, x: Any, first: int, rows: int, out: Any) -> None:
    """Write the forces (points, 3) of the rows from `first` on to out: normal and tangential [N]."""
    for k in range(3 * len(w.points)):
        out[k] = 0.0
    for m in range(first, rows, 3):
        place = 3 * w.points[x.I[m, TOUCHED]].place
        for k in range(3):
            out[place + k] = x.V[m + k, LAMBDA]
