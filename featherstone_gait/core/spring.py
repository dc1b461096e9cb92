"""Springs with dampers between two points of two bodies.

A spring pulls its points together along the line through both with the tension K (l - l0) + C dl/dt; l their distance.
Every integrator takes that force from the state for which it works out the bias forces: an explicit one that of each
stage, the linearly implicit step that of its start (Euler) or the predicted one in its middle (midpoint).  Nothing of
it is folded into the step, whose limit is then that of an explicit method: preflight.py tells it.
"""

from .jit import kernel
from .lanes import select, sqrt
from .layout import P, R, V
from .spatial import add, cross, dot, load3, load9, rotate, scale, sub

# Columns of a spring.
POINT_A = 0  # 3: body frame [m]
POINT_B = 3  # 3: body frame [m]
K = 6  # stiffness [N/m]
C = 7  # damping [N s/m]
REST = 8  # rest length [m]
SPRING_COLUMNS = 9


@kernel
def spring_bodies(springs, rows, W, F):
    """Add the springs to F (n + 1, 6), as [moment; force] about the common origin; rows (springs, 2) of the bodies.

    Positions in W count from the base.  Their differences, all that is needed here, are the same from anywhere.
    Points that coincide have no line between them, and no force.
    """
    for j in range(len(springs)):
        a, b = rows[j, 0], rows[j, 1]
        p = add(load3(W, a, P), rotate(load9(W, a, R), load3(springs, j, POINT_A)))
        q = add(load3(W, b, P), rotate(load9(W, b, R), load3(springs, j, POINT_B)))
        v = add(load3(W, a, V + 3), cross(load3(W, a, V), p))
        w = add(load3(W, b, V + 3), cross(load3(W, b, V), q))
        d = sub(q, p)
        length = sqrt(dot(d, d))
        apart = length > 0.0
        e = scale(d, select(apart, 1.0 / select(apart, length, 1.0 + 0.0 * length), 0.0 * length))
        tension = springs[j, K] * (length - springs[j, REST]) + springs[j, C] * dot(e, sub(w, v))
        f = scale(e, tension)
        n = cross(p, f)  # of both, as they pull along one line
        for k in range(3):
            F[a, k] += n[k]
            F[a, 3 + k] += f[k]
            F[b, k] -= n[k]
            F[b, 3 + k] -= f[k]
