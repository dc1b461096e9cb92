"""Points against the ground: Hunt-Crossley normal force and friction with a tangential bristle.

Normal (Hunt and Crossley 1975, exponent 1):  f_n = k x (1 + d dx/dt), never pulling; x penetration.
Tangential (Azad and Featherstone 2010): a bristle z with f_t = -kt z - dt dz/dt.  While |f_t| < mu f_n the point
sticks and dz/dt is its velocity; else the force stays at mu f_n and the bristle follows it.  A loaded point that
sticks comes to rest: it does not creep.

In an implicit step both are functions of the velocity u at the end of the substep h: x moves on by -h u_n, z by h u_t.
Both are gradients of convex functions as long as mu f_n is that of the last step, which keeps the fold symmetric and
Newton's iteration safe.  Forces and velocities are in the ground's axes (normal, first, second tangent).
"""

from .jit import inline, kernel
from .lanes import any_lane, select, sqrt
from .layout import (
    CD,
    CK,
    CMU,
    CTD,
    CTK,
    CX,
    GH,
    GN,
    GS,
    GT,
    SF,
    SH,
    SJ,
    SM,
    TOUCH,
    P,
    R,
    U,
    V,
)
from .spatial import add, cross, dot, load3, load9, rotate, store3, sub

# Columns of the scratch `C`, one row a point.
XP = 0  # 3: position in the common frame [m]
DEPTH = 3  # penetration at the start of the substep [m]
U0 = 4  # 3: predicted velocity, ground's axes [m/s]
UK = 7  # 3: velocity about which the forces are linearised
FK = 10  # 3: forces there [N]
CN = 13  # slope -df_n/du_n [N s/m]
C1 = 14  # slopes -df_t/du_t, symmetric 2 x 2: 11, 12, 22
C2 = 15
C3 = 16
FL = 17  # 3: forces of the linear model at the velocities that its solution gave
UN = 20  # 3: those velocities
RHO = 23  # 3: generalised inertial forces at UK (see step.py)
LIMIT = 26  # largest friction force of the step [N]
SCRATCH = 27


@kernel
def place_points(points, bodies, ground, base_q, W, C, h):
    """Fill position, penetration and predicted velocity of every point.

    base_q is that of the step's start, from which the base's travel to the time h at which W lies ahead [s] is absent:
    only the points' motion relative to the base is taken back from the penetration.
    """
    n, t, s = load3(ground, 0, GN), load3(ground, 0, GT), load3(ground, 0, GS)
    base = dot(n, load3(W, 0, V + 3))
    for c in range(len(bodies)):
        i = bodies[c]
        x = add(load3(W, i, P), rotate(load9(W, i, R), load3(points, c, CX)))
        v = add(load3(W, i, V + 3), cross(load3(W, i, V), x))
        store3(C, c, XP, x)
        u = (dot(n, v), dot(t, v), dot(s, v))
        store3(C, c, U0, u)
        store3(C, c, UK, u)
        C[c, DEPTH] = _depth(ground, base_q, x, n, t) + h * (u[0] - base)


@inline
def _depth(ground, base_q, x, n, t):
    if base_q is not None:
        x = add(x, (base_q[0], base_q[1], base_q[2]))
    return ground_height(ground, dot(t, x)) - dot(n, x)


@inline
def ground_height(ground, along):
    """Height of the ground along its normal [m] at the distance along its first tangent [m]."""
    height = ground[0, GH] + 0.0 * along
    for k in range(1, len(ground)):
        height = select(along > ground[k, 0], height + ground[k, 1], height)
    return height


@inline
def normal_force(points, c, depth, un, h):
    """f_n [N] and its slope -df_n/du_n [N s/m] for the velocity un along the normal."""
    x = depth - h * un
    k = points[c, CK]
    stiff = 1.0 - points[c, CD] * un
    on = (x > 0.0) & (stiff > 0.0)
    return (
        select(on, k * x * stiff, 0.0 * x),
        select(on, k * (h * stiff + points[c, CD] * x), 0.0 * x),
    )


@inline
def friction_force(points, c, z1, z2, u1, u2, limit, h):
    """Tangential force, its slope (11, 12, 22) and whether the point slips, for a friction limit mu f_n [N]."""
    kappa = h * points[c, CTK] + points[c, CTD]
    f1 = -points[c, CTK] * z1 - kappa * u1
    f2 = -points[c, CTK] * z2 - kappa * u2
    size = sqrt(f1 * f1 + f2 * f2)
    slips = size > limit
    ratio = select(slips, limit / select(slips, size, 1.0 + 0.0 * size), 1.0 + 0.0 * size)
    d1, d2 = f1 / select(slips, size, 1.0 + 0.0 * size), f2 / select(slips, size, 1.0 + 0.0 * size)
    slope = kappa * ratio
    c11 = select(slips, slope * (1.0 - d1 * d1), slope)
    c12 = select(slips, -slope * (d1 * d2), 0.0 * slope)
    c22 = select(slips, slope * (1.0 - d2 * d2), slope)
    return f1 * ratio, f2 * ratio, c11, c12, c22, slips


@kernel
def friction_limits(o, points, y, C, h):
    """Fill the friction limits: mu times the last step's normal force, at touch-down that at the predicted velocity."""
    for c in range(len(points)):
        first, _ = normal_force(points, c, C[c, DEPTH], C[c, U0], h)
        last = y[o.contact_force + 3 * c]
        C[c, LIMIT] = points[c, CMU] * select(last > 0.0, last, first)


@kernel
def contact_forces(o, points, y, C, h):
    """Fill the forces and slopes at the velocities UK."""
    for c in range(len(points)):
        u = load3(C, c, UK)
        fn, cn = normal_force(points, c, C[c, DEPTH], u[0], h)
        z1, z2 = y[o.bristle + 2 * c], y[o.bristle + 2 * c + 1]
        f1, f2, c11, c12, c22, _ = friction_force(points, c, z1, z2, u[1], u[2], C[c, LIMIT], h)
        store3(C, c, FK, (fn, f1, f2))
        C[c, CN] = cn
        C[c, C1] = c11
        C[c, C2] = c12
        C[c, C3] = c22


@kernel
def fold_contacts(bodies, tree, ground, h, W, C):
    """Sum h J' C J and the force at the predicted velocity into the contact rows of the bodies."""
    n, t, s = load3(ground, 0, GN), load3(ground, 0, GT), load3(ground, 0, GS)
    for c in range(len(bodies)):
        k = tree[bodies[c]].contact
        if c == 0 or bodies[c] != bodies[c - 1]:
            for j in range(TOUCH + 1):
                W[k, j] = 0.0
        on = (C[c, FK] > 0.0) | (C[c, CN] > 0.0) | (C[c, LIMIT] > 0.0)
        if any_lane(on):
            _fold(c, k, on, n, t, s, h, W, C)


@inline
def _fold(c, k, on, n, t, s, h, W, C):
    """Add one point: S = n n' cn + (tangents), K = h S about the point, moved to the origin."""
    cn, c11, c12, c22 = C[c, CN], C[c, C1], C[c, C2], C[c, C3]
    a = (h * cn * n[0], h * cn * n[1], h * cn * n[2])
    b = (h * (c11 * t[0] + c12 * s[0]), h * (c11 * t[1] + c12 * s[1]), h * (c11 * t[2] + c12 * s[2]))
    d = (h * (c12 * t[0] + c22 * s[0]), h * (c12 * t[1] + c22 * s[1]), h * (c12 * t[2] + c22 * s[2]))
    K0 = a[0] * n[0] + b[0] * t[0] + d[0] * s[0]
    K1 = a[0] * n[1] + b[0] * t[1] + d[0] * s[1]
    K2 = a[0] * n[2] + b[0] * t[2] + d[0] * s[2]
    K3 = a[1] * n[1] + b[1] * t[1] + d[1] * s[1]
    K4 = a[1] * n[2] + b[1] * t[2] + d[1] * s[2]
    K5 = a[2] * n[2] + b[2] * t[2] + d[2] * s[2]
    p = load3(C, c, XP)
    x, y, z = cross(p, (K0, K1, K2)), cross(p, (K1, K3, K4)), cross(p, (K2, K4, K5))  # columns of p x K
    Jx, Jy = cross(p, (x[0], y[0], z[0])), cross(p, (x[1], y[1], z[1]))
    Jz = cross(p, (x[2], y[2], z[2]))
    e = sub(load3(C, c, UK), load3(C, c, U0))
    fn = C[c, FK] + cn * e[0]
    f1 = C[c, FK + 1] + (c11 * e[1] + c12 * e[2])
    f2 = C[c, FK + 2] + (c12 * e[1] + c22 * e[2])
    f = (
        fn * n[0] + f1 * t[0] + f2 * s[0],
        fn * n[1] + f1 * t[1] + f2 * s[1],
        fn * n[2] + f1 * t[2] + f2 * s[2],
    )
    m = cross(p, f)
    _put(W, k, on, SJ, (Jx[0], Jx[1], Jx[2], Jy[1], Jy[2], Jz[2]))
    _put(W, k, on, SH, (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]))
    _put(W, k, on, SM, (K0, K1, K2, K3, K4, K5))
    _put(W, k, on, SF, (m[0], m[1], m[2], f[0], f[1], f[2]))
    W[k, TOUCH] = select(on, 1.0, W[k, TOUCH])


@inline
def _put(W, k, on, column, values):
    for j in range(len(values)):
        W[k, column + j] = select(on, W[k, column + j] + values[j], W[k, column + j])


@kernel
def solved_velocities(bodies, ground, h, W, C):
    """Velocities UN that the solution's dA gives the points, and the linear model's forces FL there."""
    n, t, s = load3(ground, 0, GN), load3(ground, 0, GT), load3(ground, 0, GS)
    for c in range(len(bodies)):
        i = bodies[c]
        p = load3(C, c, XP)
        a = add(load3(W, i, U + 3), cross(load3(W, i, U), p))
        u = add(load3(C, c, U0), (h * dot(n, a), h * dot(t, a), h * dot(s, a)))
        store3(C, c, UN, u)
        e = sub(u, load3(C, c, UK))
        C[c, FL] = C[c, FK] - C[c, CN] * e[0]
        C[c, FL + 1] = C[c, FK + 1] - (C[c, C1] * e[1] + C[c, C2] * e[2])
        C[c, FL + 2] = C[c, FK + 2] - (C[c, C2] * e[1] + C[c, C3] * e[2])


@inline
def bristle_rate(points, c, z1, z2, u1, u2, f1, f2, slips):
    """dz/dt: the velocity of a point that sticks, else what keeps -kt z - dt dz/dt at the force."""
    kt, dt = points[c, CTK], points[c, CTD]
    r1 = select(slips, -(f1 + kt * z1) / dt, u1)
    r2 = select(slips, -(f2 + kt * z2) / dt, u2)
    return r1, r2
