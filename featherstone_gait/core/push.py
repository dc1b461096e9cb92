"""External forces: pushes, which act on given points of links for a given time, and springs."""

from .jit import inline, kernel
from .knots import AHEAD
from .layout import P, R
from .optional import either
from .spatial import add, cross, load3, load9, rotate, scale
from .spring import spring_bodies

# Columns of a push.
POINT = 0  # 3: where it acts, body frame [m]
MOMENT = 3  # 3: world axes [N m]
FORCE = 6  # 3: world axes [N]
START = 9  # [s]
END = 10  # [s]
PUSH_COLUMNS = 11


@inline
def outside(scene):
    """None where no body feels a push or a spring."""
    return either(scene.push, scene.springs)


@inline
def external_forces(forces, scene, push, springs, t, span, W, F):
    """Fill F (n + 1, 6) with what acts, as [moment; force] about the common origin; forces: `outside`.

    t, span: the time that pushes are averaged over, from t on [s]; 0 for what acts at t.
    """
    if forces is not None:
        for i in range(len(F)):
            for k in range(6):
                F[i, k] = 0.0
    if push is not None:
        push_bodies(push, scene.push_rows, t, span, W, F)
    if springs is not None:
        spring_bodies(springs, scene.spring_rows, W, F)


@kernel
def push_bodies(push, rows, t, span, W, F):
    """Add the pushes to F."""
    for j in range(len(push)):
        i, share = rows[j], _share(push[j, START], push[j, END], t, span)
        if share > 0.0:
            p = add(load3(W, i, P), rotate(load9(W, i, R), load3(push, j, POINT)))
            f = scale(load3(push, j, FORCE), share)
            n = add(scale(load3(push, j, MOMENT), share), cross(p, f))
            for k in range(3):
                F[i, k] += n[k]
                F[i, 3 + k] += f[k]


@inline
def _share(start, end, t, span):
    """Of the time from t over `span`, how much a push acts: so that none is lost or cut short by fixed steps."""
    if start <= t and t + span < end:
        return 1.0
    if span > 0.0:
        return max(0.0, min(end, t + span) - max(start, t)) / span
    return 0.0


@kernel
def next_edge(push, t):
    """Time at which a push begins or ends next after t [s]."""
    edge = 1e300
    for j in range(len(push)):
        for k in range(START, END + 1):
            if push[j, k] > t + AHEAD:
                edge = min(edge, push[j, k])
    return edge
