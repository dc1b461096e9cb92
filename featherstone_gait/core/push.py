"""External forces that act on given points of links for a given time."""

from .jit import kernel
from .knots import AHEAD
from .layout import P, R
from .spatial import add, cross, load3, load9, rotate

# Columns of a push.
POINT = 0  # 3: where it acts, body frame [m]
MOMENT = 3  # 3: world axes [N m]
FORCE = 6  # 3: world axes [N]
START = 9  # [s]
END = 10  # [s]
PUSH_COLUMNS = 11


@kernel
def push_bodies(push, rows, t, W, F):
    """Fill F (n + 1, 6) with the pushes that act at the time t, as [moment; force] about the common origin."""
    for i in range(len(F)):
        for k in range(6):
            F[i, k] = 0.0
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
