"""Points against the ground: Hunt-Crossley normal force and friction with a tangential bristle.

Normal (Hunt and Crossley 1975, exponent 1):  f_n = k x (1 + d dx/dt), never pulling; x penetration.
Tangential (Azad and Featherstone 2010): a bristle z with f_t = -kt z - dt dz/dt.  While |f_t| < mu f_n the point
sticks and dz/dt is its velocity; else the force stays at mu f_n and the bristle follows it.  A loaded point that
sticks comes to rest: it does not creep.

In an implicit step both are functions of the velocity u at the end of the substep h: x moves on by -h u_n, z by h u_t.
Both are gradients of convex functions as long as mu f_n is that of the last step, which keeps the fold symmetric and
Newton's iteration safe.  Forces and velocities are in the ground's axes (normal, first, second tangent).

What touches is a point, or of a sphere or a circle the point that lies deepest (`touch.py`), against a plane with steps
or a height field (`shapes/ground.py`).  The functions that a step calls take a `Contact`, or None for a scene without
ground.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import inline, kernel
from ..compile.lanes import any_lane, select, sqrt
from ..compile.optional import if_present
from ..compile.structure import record, structure
from ..shapes.ground import fixed_axes, height_over
from ..tree.forest import base_index, points_of
from ..tree.layout import SF, SH, SJ, SM, TOUCH, R, U, V
from ..tree.rigid_body import center_velocity, point_position
from ..tree.spatial import add, cross, dot, load3, load9, rotate, store3, sub, vector
from . import element
from .element import FK, FL, U0, UK, UN, XP
from .predicted import base_at, lookahead
from .surface import add_drive_work, surface_motion
from .touch import AXES, axes_at, deepest

POINT = record(
    body=int,  # row of the body; points of a body stand together
    position=(float, 3),  # in the body's frame [m]
    stiffness=float,  # normal [N/m]
    damping=float,  # Hunt and Crossley's d [s/m]
    friction=float,  # coefficient
    tangential_stiffness=float,  # [N/m]
    tangential_damping=float,  # [N s/m]
    deepest=float,  # depth beyond which a run ends: see step/depth.py [m]
)


MOTION = record(
    velocity=(float, 3),  # of the surface at the center [m/s]
    center=(float, 3),  # [m]
    spin=(float, 3),  # its angular velocity, along the normal [rad/s]
    rate=float,  # that about the normal [rad/s]
)

ROLLER = record(
    on=int,  # 1 = the point is that of a wheel with rollers
    axis=(float, 3),  # of the wheel, body frame
    sine=float,  # of the angle from the wheel's axis to the rollers', about the normal
    cosine=float,
    free=float,  # friction across a roller's axis by that along it
)

ROLLING = record(
    friction=float,  # limit of the moment across the normal by the normal force [m]
    tangential_stiffness=float,  # [N m/rad]
    tangential_damping=float,  # [N m s/rad]
)


@structure
class Contact(NamedTuple):
    """Contact points, the ground, and the shapes about the points."""

    points: np.ndarray  # (points,) POINT
    ground: tuple  # one of the kinds in shapes/ground.py
    contact_geometry: tuple | None  # one of the kinds in touch.py; None where all are points
    motion: np.ndarray | None = None  # (1,) MOTION of a ground whose surface moves
    rollers: np.ndarray | None = None  # (points,) ROLLER
    surfaces: np.ndarray | None = None  # (points,) SURFACE of the links
    rolling: np.ndarray | None = None  # (points,) ROLLING; the last rows of C are then those of the moments


# Columns of the scratch `C`, one row a point: those of element.py, velocities and forces in the ground's axes, and
DEPTH = 3  # penetration at the start of the substep [m]
CN = 22  # slope -df_n/du_n [N s/m]
C1 = 23  # slopes -df_t/du_t, symmetric 2 x 2: 11, 12, 22
C2 = 24
C3 = 25
LIMIT = 26  # largest friction force of the step [N]
BELT = AXES + 9  # 2: velocity of the ground's surface along the tangents [m/s]
ROLL = AXES + 11  # 4: along and across the rollers' axis by the tangents, row by row, the second scaled
OWN = AXES + 15  # 2: velocity of the link's surface along the tangents [m/s]
SCRATCH = AXES + 17  # AXES, 9: of a height field normal, first and second tangent under the point


@structure
class Moments(NamedTuple):
    """The moments of contact points."""

    rolling: np.ndarray  # (points,) ROLLING


# ---------------------------------------------------------------------------------------------- place


@inline
def above_ground(contact, x):
    """Return the height of the point x over the ground, along its normal [m]."""
    return height_over(contact.ground, x)


@kernel
def place_points(contact, step, base_q, lookahead_time):
    """Fill position, penetration and predicted velocity of every point.

    Base and W are those of a time [s] after the step's start: the way of the points since then is taken back from
    the penetration, along the normal where they are now.
    """
    W, C = step.W, step.C
    plane, (first, end) = fixed_axes(contact.ground), points_of(step.part, contact.points)
    for c in range(first, end):
        point = contact.points[c]
        i = point.body
        center = point_position(i, vector(point.position), W)
        x, depth = deepest(contact.ground, contact.contact_geometry, plane, c, i, center, base_q, W, C)
        n, t, second = axes_at(plane, c, C)
        v = center_velocity(i, x, W)
        store3(C, c, XP, x)
        u = _on_surface(contact.motion, c, x, (dot(n, v), dot(t, v), dot(second, v)), (t, second), base_q, C)
        u = _with_own(contact.surfaces, c, i, x, u, (n, t, second), step)
        _place_roller(contact.rollers, c, i, (n, t, second), W, C)
        store3(C, c, U0, u)
        store3(C, c, UK, u)
        C[c, DEPTH] = depth + lookahead_time * u[0]
        _place_moment(contact.rolling, c, i, (t, second), W, C)


@inline
def _on_surface(motion, c, x, u, tangents, base_q, C):
    """Return the velocity u of a point less that of the surface, which moves in its plane."""
    if motion is None:
        return u
    m = motion[0]
    if base_q is not None:
        x = add(x, vector(base_q))
    v = add(vector(m.velocity), cross(vector(m.spin), sub(x, vector(m.center))))
    C[c, BELT], C[c, BELT + 1] = dot(tangents[0], v), dot(tangents[1], v)
    return (u[0], u[1] - C[c, BELT], u[2] - C[c, BELT + 1])


@inline
def _with_own(surfaces, c, i, x, u, frame, step):
    """Return the velocity u of a point and that of the surface of its link, which moves on it."""
    if surfaces is None:
        return u
    C, (n, t, second) = step.C, frame
    v, _ = surface_motion(surfaces[c], 0, i, x, n, step)
    C[c, OWN], C[c, OWN + 1] = dot(t, v), dot(second, v)
    return (u[0], u[1] + C[c, OWN], u[2] + C[c, OWN + 1])


@inline
def _ground_power(motion, c, f, C):
    """Return the power of the ground's force f on a point by the velocity of the ground's surface alone [W]."""
    if motion is None:
        return 0.0
    return f[1] * C[c, BELT] + f[2] * C[c, BELT + 1]


@inline
def _own_power(surfaces, c, f, h, step, work):
    """Return the power of the force f on a point by the velocity of its own surface, less, and add it to its drive."""
    if surfaces is None:
        return 0.0
    power = -(f[1] * step.C[c, OWN] + f[2] * step.C[c, OWN + 1])
    add_drive_work(surfaces[c], power, h, step, work)
    return power


@inline
def surface_power(contact, c, f, h, step, work):
    """Return the power of a point's force f by the velocities of both surfaces [W]; add h times its drive's to work."""
    return _ground_power(contact.motion, c, f, step.C) + _own_power(contact.surfaces, c, f, h, step, work)


@inline
def _place_roller(rollers, c, i, frame, W, C):
    """Fill how the velocity of a point of a wheel counts along the axis of the roller under it, and across."""
    if rollers is not None:
        (_, t, s), r, one = frame, rollers[c], 1.0 + 0.0 * W[i, R]
        C[c, ROLL], C[c, ROLL + 1], C[c, ROLL + 2], C[c, ROLL + 3] = one, 0.0 * one, 0.0 * one, one
        if r.on > 0:
            a = rotate(load9(W, i, R), vector(r.axis))
            x, y = dot(a, t), dot(a, s)
            size = sqrt(x * x + y * y)
            lies = size > 0.0
            x = select(lies, x / select(lies, size, one), one)
            y = select(lies, y / select(lies, size, one), 0.0 * one)
            p, q = r.cosine * x - r.sine * y, r.cosine * y + r.sine * x
            C[c, ROLL], C[c, ROLL + 1] = p, q
            C[c, ROLL + 2], C[c, ROLL + 3] = -r.free * q, r.free * p


@inline
def _rolled(rollers, c, u, C):
    """Return a velocity along the rollers' axis and, scaled, across it; u without rollers."""
    if rollers is None:
        return u
    return (u[0], C[c, ROLL] * u[1] + C[c, ROLL + 1] * u[2], C[c, ROLL + 2] * u[1] + C[c, ROLL + 3] * u[2])


@inline
def _rolled_back(rollers, c, f, C):
    """Return a force in those axes along the tangents."""
    if rollers is None:
        return f
    return (C[c, ROLL] * f[0] + C[c, ROLL + 2] * f[1], C[c, ROLL + 1] * f[0] + C[c, ROLL + 3] * f[1])


@inline
def _rolled_slope(rollers, c, k, C):
    """Return a slope (11, 12, 22) in those axes along the tangents."""
    if rollers is None:
        return k
    a, b, d, e = C[c, ROLL], C[c, ROLL + 1], C[c, ROLL + 2], C[c, ROLL + 3]
    p, q, r, s = k[0] * a + k[1] * d, k[0] * b + k[1] * e, k[1] * a + k[2] * d, k[1] * b + k[2] * e
    return (a * p + d * r, a * q + d * s, b * q + e * s)


# ---------------------------------------------------------------------------------------------- law


@inline
def normal_force(p, depth, un, h):
    """Return f_n [N] and its slope -df_n/du_n [N s/m] of the point p for the velocity un along the normal."""
    x = depth - h * un
    k = p.stiffness
    stiff = 1.0 - p.damping * un
    on = (x > 0.0) & (stiff > 0.0)
    return (
        select(on, k * x * stiff, 0.0 * x),
        select(on, k * (h * stiff + p.damping * x), 0.0 * x),
    )


@inline
def friction_force(p, z, u, limit, h):
    """Return tangential force (2), slope (11, 12, 22) and whether the point slips, for a friction limit mu f_n [N].

    p the point, z (2) its bristle [m], u (3) its velocity [m/s].
    """
    kappa = h * p.tangential_stiffness + p.tangential_damping
    f1 = -p.tangential_stiffness * z[0] - kappa * u[1]
    f2 = -p.tangential_stiffness * z[1] - kappa * u[2]
    size = sqrt(f1 * f1 + f2 * f2)
    slips = size > limit
    ratio = select(slips, limit / select(slips, size, 1.0 + 0.0 * size), 1.0 + 0.0 * size)
    d1, d2 = f1 / select(slips, size, 1.0 + 0.0 * size), f2 / select(slips, size, 1.0 + 0.0 * size)
    slope = kappa * ratio
    c11 = select(slips, slope * (1.0 - d1 * d1), slope)
    c12 = select(slips, -slope * (d1 * d2), 0.0 * slope)
    c22 = select(slips, slope * (1.0 - d2 * d2), slope)
    return (f1 * ratio, f2 * ratio), (c11, c12, c22), slips


@inline
def _bristle(contact, step, c):
    z = step.y[step.offsets.tangential_deflection + 2 * c], step.y[step.offsets.tangential_deflection + 2 * c + 1]
    return _turned(contact.motion, contact.rollers, c, z, step.h_implicit)


@inline
def _turned(motion, rollers, c, z, h):
    """Return the bristle as the surface has turned it by the end of a step; that of a wheel with rollers stays."""
    if motion is None:
        return z
    return _turned_if(rollers, c, z, h * motion[0].rate)


@inline
def _turned_if(rollers, c, z, turn):
    if rollers is not None:
        if rollers[c].on > 0:
            turn = 0.0
    k = 1.0 / (1.0 + turn * turn)
    return (k * (z[0] - turn * z[1]), k * (z[1] + turn * z[0]))


@inline
def point_force(rollers, p, z, u, c, h, C):
    """Return the force on the point c of law p with the bristle z at the velocity u, in its axes [N]."""
    fn, _ = normal_force(p, C[c, DEPTH], u[0], h)
    f, _, _ = friction_force(p, z, _rolled(rollers, c, u, C), C[c, LIMIT], h)
    f = _rolled_back(rollers, c, f, C)
    return (fn, f[0], f[1])


@inline
def linearize_point(rollers, p, z, c, h, C):
    """Fill force and slopes of the point c of law p with the bristle z at the velocity UK."""
    u = load3(C, c, UK)
    fn, cn = normal_force(p, C[c, DEPTH], u[0], h)
    f, slope, _ = friction_force(p, z, _rolled(rollers, c, u, C), C[c, LIMIT], h)
    f, slope = _rolled_back(rollers, c, f, C), _rolled_slope(rollers, c, slope, C)
    store3(C, c, FK, (fn, f[0], f[1]))
    C[c, CN] = cn
    store3(C, c, C1, slope)


@inline
def model_force(e, c, C):
    """Return the linear model's force of the point c at the velocity UK + e, in its axes [N]."""
    return (
        C[c, FK] - C[c, CN] * e[0],
        C[c, FK + 1] - (C[c, C1] * e[1] + C[c, C2] * e[2]),
        C[c, FK + 2] - (C[c, C2] * e[1] + C[c, C3] * e[2]),
    )


@inline
def solve_point(frame, a, c, h, C):
    """Fill velocity UN and the model's force FL of the point c, whose acceleration exceeds the predicted one by a."""
    n, t, second = frame
    u = add(load3(C, c, U0), (h * dot(n, a), h * dot(t, a), h * dot(second, a)))
    store3(C, c, UN, u)
    store3(C, c, FL, model_force(sub(u, load3(C, c, UK)), c, C))


# ---------------------------------------------------------------------------------------------- in the implicit step


@element.place.of(Contact)
def _place(contact, step):
    """Fill where the points are at the predicted state, and the friction limits [N].

    These are mu times the last normal force, at touch-down that at the predicted velocity.
    """
    C, (first, end) = step.C, points_of(step.part, contact.points)
    base_q, ahead = base_at(step.predicted, step), lookahead(step.predicted, step.h_implicit)
    place_points(contact, step, base_q, ahead)
    for c in range(first, end):
        p = contact.points[c]
        predicted_force, _ = normal_force(p, C[c, DEPTH], C[c, U0], step.h_implicit)
        last = step.y[step.offsets.contact_force + 3 * c]
        load = select(last > 0.0, last, predicted_force)
        C[c, LIMIT] = p.friction * load
        _limit_moment(contact.rolling, c, load, C)


@element.linearize.of(Contact)
def _linearize(contact, step):
    C, (first, end) = step.C, points_of(step.part, contact.points)
    for c in range(first, end):
        linearize_point(contact.rollers, contact.points[c], _bristle(contact, step, c), c, step.h_implicit, C)
        _linearize_moment(contact.rolling, c, step)


@element.fold.of(Contact)
def _fold_contact(contact, step):
    _fold(contact, step, step.h_implicit)


@kernel
def _fold(contact, step, h):
    """Sum h J' C J and the force at the predicted velocity into the contact rows of the bodies."""
    plane, tree, W, C = fixed_axes(contact.ground), step.scene.tree, step.W, step.C
    first, end = points_of(step.part, contact.points)
    for c in range(first, end):
        i = contact.points[c].body
        k = tree[i].contact
        if c == first or i != contact.points[c - 1].body:
            for j in range(TOUCH + 1):
                W[k, j] = 0.0
        on = (C[c, FK] > 0.0) | (C[c, CN] > 0.0) | (C[c, LIMIT] > 0.0)
        if any_lane(on):
            fold_point(c, k, on, axes_at(plane, c, C), h, W, C)
            _fold_rolling(contact.rolling, c, k, axes_at(plane, c, C), h, W, C)


@inline
def fold_point(c, k, on, frame, h, W, C):
    """Add one point: S = n n' cn + (tangents), K = h S about the point, moved to the origin."""
    (K0, K1, K2, K3, K4, K5), f = slopes_and_force(c, frame, h, C)
    p = load3(C, c, XP)
    x, y, z = cross(p, (K0, K1, K2)), cross(p, (K1, K3, K4)), cross(p, (K2, K4, K5))  # columns of p x K
    Jx, Jy = cross(p, (x[0], y[0], z[0])), cross(p, (x[1], y[1], z[1]))
    Jz = cross(p, (x[2], y[2], z[2]))
    m = cross(p, f)
    _put(W, k, on, SJ, (Jx[0], Jx[1], Jx[2], Jy[1], Jy[2], Jz[2]))
    _put(W, k, on, SH, (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]))
    _put(W, k, on, SM, (K0, K1, K2, K3, K4, K5))
    _put(W, k, on, SF, (m[0], m[1], m[2], f[0], f[1], f[2]))
    W[k, TOUCH] = select(on, 1.0, W[k, TOUCH])


@inline
def fold_moment(c, k, on, frame, h, W, C):
    """Add a moment and its slopes, which act on the angular velocity alone."""
    K, m = slopes_and_force(c, frame, h, C)
    _put(W, k, on, SJ, K)
    _put(W, k, on, SF, m)
    W[k, TOUCH] = select(on, 1.0, W[k, TOUCH])


@inline
def slopes_and_force(c, frame, h, C):
    """Return h times the slopes of a point (xx, xy, xz, yy, yz, zz) and its force at the predicted velocity (3)."""
    n, t, s = frame
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
    e = sub(load3(C, c, UK), load3(C, c, U0))
    fn = C[c, FK] + cn * e[0]
    f1 = C[c, FK + 1] + (c11 * e[1] + c12 * e[2])
    f2 = C[c, FK + 2] + (c12 * e[1] + c22 * e[2])
    f = (
        fn * n[0] + f1 * t[0] + f2 * s[0],
        fn * n[1] + f1 * t[1] + f2 * s[1],
        fn * n[2] + f1 * t[2] + f2 * s[2],
    )
    return (K0, K1, K2, K3, K4, K5), f


@inline
def _put(W, k, on, column, values):
    for j in range(len(values)):
        W[k, column + j] = select(on, W[k, column + j] + values[j], W[k, column + j])


@element.solve.of(Contact)
def _solve(contact, step):
    """Fill the velocities UN that the solution's dA gives the points, and the linear model's forces FL there."""
    W, C, h = step.W, step.C, step.h_implicit
    plane, (first, end) = fixed_axes(contact.ground), points_of(step.part, contact.points)
    for c in range(first, end):
        i = contact.points[c].body
        a = add(load3(W, i, U + 3), cross(load3(W, i, U), load3(C, c, XP)))
        solve_point(axes_at(plane, c, C), a, c, h, C)
        _solve_moment(contact.rolling, c, axes_at(plane, c, C), load3(W, i, U), h, C)


element.elements.of(Contact)(lambda contact, step: points_of(step.part, contact.points))


@element.force_at.of(Contact)
def _force_at(contact, c, u, step):
    z = _bristle(contact, step, c)
    return point_force(contact.rollers, contact.points[c], z, u, c, step.h_implicit, step.C)


@inline
def contact_branch(contact, step, c):
    """Return whether the ground pushes point c: 0 no, 1 it sticks, 2 it slips."""
    p, u = contact.points[c], load3(step.C, c, UN)
    fn, _ = normal_force(p, step.C[c, DEPTH], u[0], step.h_implicit)
    z, u = _bristle(contact, step, c), _rolled(contact.rollers, c, u, step.C)
    _, _, slips = friction_force(p, z, u, step.C[c, LIMIT], step.h_implicit)
    one = 1.0 + 0.0 * fn
    return select(fn > 0.0, select(slips, 2.0 * one, one), 0.0 * fn) + _moment_branch(contact.rolling, c, step, fn)


@element.move.of(Contact)
def _move(contact, step):
    """Move bristles, forces and the work of the ground to the end of the step."""
    y, offsets, C, h = step.y, step.offsets, step.C, step.h_implicit
    work, (first, end) = offsets.contact_work + base_index(step.part), points_of(step.part, contact.points)
    for c in range(first, end):
        p, u, z = contact.points[c], load3(C, c, UN), _bristle(contact, step, c)
        f = point_force(contact.rollers, p, z, u, c, h, C)
        y[work] += step.h * (dot(f, u) + surface_power(contact, c, f, step.h, step, y))
        u = _rolled(contact.rollers, c, u, C)
        along, _, slips = friction_force(p, z, u, C[c, LIMIT], h)
        kappa = 1.0 / (h * p.tangential_stiffness + p.tangential_damping)
        m1 = select(slips, (p.tangential_damping * z[0] - h * along[0]) * kappa, z[0] + h * u[1])
        m2 = select(slips, (p.tangential_damping * z[1] - h * along[1]) * kappa, z[1] + h * u[2])
        bristle = offsets.tangential_deflection + 2 * c
        y[bristle] = y[bristle] + (m1 - y[bristle]) * (1.0 / step.theta)
        y[bristle + 1] = y[bristle + 1] + (m2 - y[bristle + 1]) * (1.0 / step.theta)
        for k in range(3):
            y[offsets.contact_force + 3 * c + k] = f[k]
        _move_moment(contact.rolling, c, step, work)


# ---------------------------------------------------------------------------------------------- rolling


@inline
def _moment_row(rolling, c, C):
    """Return the row of C in which the moment of the point c stands: the columns of a point, of angles and moments."""
    return len(C) - len(rolling) + c


@inline
def _moment(rolling, c, u, h, step):
    """Return the moment of the point c at the angular velocity u, in its axes [N m], its slope, and whether it rolls.

    It is the law of friction with a bristle of its own, which holds what rests: a steady moment where it rolls.
    """
    at, row = step.offsets.rolling_deflection + 2 * c, _moment_row(rolling, c, step.C)
    limit, zero = step.C[row, LIMIT], 0.0 * u[0]
    m, slope, rolls = friction_force(rolling[c], (step.y[at], step.y[at + 1]), u, limit, h)
    some = limit > 0.0
    slope = (select(some, slope[0], zero), select(some, slope[1], zero), select(some, slope[2], zero))
    return (zero, m[0], m[1]), slope, rolls


@if_present()
def _place_moment(rolling, c, i, tangents, W, C):
    """Fill the angular velocity of the link."""
    w, row = load3(W, i, V), _moment_row(rolling, c, C)
    u = (0.0 * w[0], dot(tangents[0], w), dot(tangents[1], w))
    store3(C, row, U0, u)
    store3(C, row, UK, u)
    C[row, CN] = 0.0


@if_present()
def _limit_moment(rolling, c, load, C):
    C[_moment_row(rolling, c, C), LIMIT] = rolling[c].friction * load


@if_present()
def _linearize_moment(rolling, c, step):
    C, row = step.C, _moment_row(rolling, c, step.C)
    m, slope, _ = _moment(rolling, c, load3(C, row, UK), step.h_implicit, step)
    store3(C, row, FK, m)
    store3(C, row, C1, slope)


@if_present()
def _fold_rolling(rolling, c, k, frame, h, W, C):
    row = _moment_row(rolling, c, C)
    on = C[row, LIMIT] > 0.0
    if any_lane(on):
        fold_moment(row, k, on, frame, h, W, C)


@if_present()
def _solve_moment(rolling, c, frame, turning, h, C):
    solve_point(frame, turning, _moment_row(rolling, c, C), h, C)
    C[_moment_row(rolling, c, C), UN] = 0.0


@element.elements.of(Moments)
def _rows_of_moments(moments, step):
    first, end = points_of(step.part, moments.rolling)
    return _moment_row(moments.rolling, first, step.C), _moment_row(moments.rolling, end, step.C)


@element.force_at.of(Moments)
def _moment_at(moments, row, u, step):
    c = row - _moment_row(moments.rolling, 0, step.C)
    m, _, _ = _moment(moments.rolling, c, u, step.h_implicit, step)
    return m


@inline
def _moment_branch(rolling, c, step, fn):
    """Return 4 where the point c pushes and rolls at the limit of its moment, else 0."""
    if rolling is None:
        return 0.0
    row, zero = _moment_row(rolling, c, step.C), 0.0 * fn
    _, _, rolls = _moment(rolling, c, load3(step.C, row, UN), step.h_implicit, step)
    return select((fn > 0.0) & rolls, 4.0 + zero, zero)


@if_present()
def _move_moment(rolling, c, step, work):
    """Move the bristle of the moment of the point c, and its work."""
    y, row, h, law = step.y, _moment_row(rolling, c, step.C), step.h_implicit, rolling[c]
    u, at = load3(step.C, row, UN), step.offsets.rolling_deflection + 2 * c
    m, _, rolls = _moment(rolling, c, u, h, step)
    y[work] += step.h * dot(m, u)
    kt, dt = law.tangential_stiffness, law.tangential_damping
    for k in range(2):
        z = y[at + k]
        moved = select(rolls, (dt * z - h * m[1 + k]) * (1.0 / (h * kt + dt)), z + h * u[1 + k])
        y[at + k] = z + (moved - z) * (1.0 / step.theta)


@inline
def _moment_rates(rolling, c, fn, step, dy, power):
    """Fill the rates of the bristle of the moment of the point c; return the power with the moment's."""
    if rolling is None:
        return power
    C, row, law, at = step.C, _moment_row(rolling, c, step.C), rolling[c], step.offsets.rolling_deflection + 2 * c
    C[row, LIMIT] = law.friction * fn
    u = load3(C, row, U0)
    m, _, rolls = _moment(rolling, c, u, 0.0, step)
    kt, dt = law.tangential_stiffness, law.tangential_damping
    for k in range(2):
        dy[at + k] = select(rolls, -(m[1 + k] + kt * step.y[at + k]) / dt, u[1 + k])
    store3(C, row, FK, m)
    for k in range(4):
        C[row, CN + k] = 0.0
    return power + dot(m, u)


# ---------------------------------------------------------------------------------------------- as an equation


@element.rates.of(Contact)
def _contact_rates(contact, step, dy):
    """Fill contact forces [N], rates of the bristles [m/s] and power of the ground [W]; nothing is folded."""
    place_points(contact, step, base_at(None, step), 0.0)
    work, (first, end) = step.offsets.contact_work + base_index(step.part), points_of(step.part, contact.points)
    dy[work] = 0.0 * step.y[work]
    for c in range(first, end):
        _rates(contact, contact.points[c], step, dy, c)
    _fold(contact, step, 0.0)


@inline
def _rates(contact, p, step, dy, c):
    y, offsets, C, rollers = step.y, step.offsets, step.C, contact.rollers
    u = load3(C, c, U0)
    fn, _ = normal_force(p, C[c, DEPTH], u[0], 0.0)
    limit = p.friction * fn
    kt, dt, bristle = p.tangential_stiffness, p.tangential_damping, offsets.tangential_deflection + 2 * c
    z, along = (y[bristle], y[bristle + 1]), _rolled(rollers, c, u, C)
    f, _, slips = friction_force(p, z, along, limit, 0.0)
    dy[bristle] = select(slips, -(f[0] + kt * z[0]) / dt, along[1])  # what slips keeps -kt z - dt dz/dt at the force
    dy[bristle + 1] = select(slips, -(f[1] + kt * z[1]) / dt, along[2])
    _turn_bristle(contact.motion, rollers, c, z, bristle, dy)
    f = _rolled_back(rollers, c, f, C)
    power = fn * u[0] + f[0] * u[1] + f[1] * u[2]
    power = power + surface_power(contact, c, (fn, f[0], f[1]), 1.0, step, dy)
    power = _moment_rates(contact.rolling, c, fn, step, dy, power)
    dy[offsets.contact_work + base_index(step.part)] += power
    store3(C, c, FK, (fn, f[0], f[1]))
    for k in range(4):
        C[c, CN + k] = 0.0
    C[c, LIMIT] = limit
    for k in range(3):
        y[offsets.contact_force + 3 * c + k] = C[c, FK + k]


@inline
def _turn_bristle(motion, rollers, c, z, bristle, dy):
    """Let a bristle turn with the surface."""
    if motion is not None:
        _turn(rollers, c, z, motion[0].rate, bristle, dy)


@inline
def _turn(rollers, c, z, rate, bristle, dy):
    if rollers is not None:
        if rollers[c].on > 0:
            return
    dy[bristle] -= rate * z[1]
    dy[bristle + 1] += rate * z[0]


def explicit_limit(sinking, g):
    """Return the largest explicit step [s] of a mass on the ground at the depth `sinking` [m] under g [m/s^2]."""
    return 2.0 * np.sqrt(sinking / g)
