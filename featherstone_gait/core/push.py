"""External forces: pushes, which act on given points of links for a given time, and springs."""

from .jit import inline, kernel
from .knots import AHEAD
from .layout import P, R
from .optional import either
from .spatial import add, cross, load3, load9, rotate
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
def external_forces(forces, scene, push, springs, t, W, F):
    """Fill F (n + 1, 6) with what acts at the time t, as [moment; force] about the common origin; forces: `outside`."""
    if forces is not None:
        for i in range(len(F)):
            for k in range(6):
                F[i, k] = 0.0
    if push is not None:
        push_bodies(push, scene.push_rows, t, W, F)
    if springs is not None:
        spring_bodies(springs, scene.spring_rows, W, F)


@kernel
def push_bodies(push, rows, t, W, F):
    """Add the pushes that act at the time t to F."""
    for j in range(len(push)):
        i = rows[j]
        if push[j, START] <= t < push[j, END]:
            p = add(load3(W, i, P), rotate(load9(W, i, R), load3(push, j, POINT)))
            f = load3(push, j, FORCE)
            n = add(load3(push, j, MOMENT), cross(p, f))
            for k in range(3):
                F[i, k] += n[k]
                F[i, 3 + k] += f[k]


@kernel
def next_edge(push, t):
    """Time at which a push begins or ends next after t [s]."""
    edge = 1e300
    for j in range(len(push)):
        for k in range(START, END + 1):
            if push[j, k] > t + AHEAD:
                edge = min(edge, push[j, k])
    return edge
