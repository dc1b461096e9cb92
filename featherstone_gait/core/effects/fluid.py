"""Fluids: buoyancy, drag and added mass of shapes of bodies, in a medium with a level and a current.

Of the part of a shape below the level, of volume V, center x and share s = V / (whole volume), with u the velocity of
the body at x less that of the current, w its angular velocity and the shape's axes:

    buoyancy     -density V g at x
    drag         f = -s (B u + Q N q u) at x, N = sqrt(sum q_i u_i^2), and likewise a moment that opposes w;
                 of MuJoCo's box f_i = -s (B_i + q_i |u_i|) u_i
    added mass   -s (d/dt of the fluid's momentum M u), M constant in the shape's axes

Both laws of drag are gradients of convex functions of u with the sign reversed (N^3 / 3 is a power of a norm), so that
Newton's iteration of newton.py takes them like contacts, with their slopes.  What depends on the pose is taken at that
of the bias, like gravity.  Added mass is linear in the accelerations sought, and joins the mass matrix.

MuJoCo's ellipsoids have coefficients that depend on the direction of u, and lift forces across it: those are taken at
the predicted velocity, as friction's limit is in contact.py.
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.jit import apart, inline, kernel
from ..compile.lanes import select, sqrt
from ..compile.structure import record, structure
from ..shapes.immersion import TINY, immersed
from ..tree.forest import base_index
from ..tree.layout import SF, SH, SJ, SM, TOUCH, A, R, U, V
from ..tree.rigid_body import center_velocity, point_position
from ..tree.spatial import (
    add,
    compose,
    congruence,
    cross,
    dot,
    load3,
    load9,
    rotate,
    rotate_back,
    scale,
    store3,
    sub,
    symmetric,
    vector,
)
from . import element
from .element import FK, FL, U0, UK, UN, XP
from .predicted import base_at

IMMERSED = record(
    body=int,  # row of the body
    tree=int,  # number of its tree
    contact=int,  # workspace row in which forces on the body are summed
    clears=int,  # 1 = nothing has cleared that row before
    kind=int,  # SPHERE ...
    first=int,  # of its triangles
    end=int,
    position=(float, 3),  # of the shape, body frame [m]
    E=(float, 9),  # rotation shape -> body frame
    radius=float,  # [m]
    length=float,  # [m]
    volume=float,  # [m^3]
    center=(float, 3),  # of the volume, shape's frame [m]
    floats=float,  # 1 = has buoyancy
    separate=int,  # 1 = the axes resist each for itself
    linear=(float, 3),  # B [N s/m]
    strength=float,  # Q [N s^2/m^2]
    quadratic=(float, 3),  # q
    turning_linear=(float, 3),  # the same of the moment [N m s]
    turning_strength=float,  # [N m s^2]
    turning_quadratic=(float, 3),
)

ADDED = record(
    inertial=float,  # 1 = resists accelerations, 0 = has the forces of steady motion alone, as MuJoCo has
    J=(float, 6),  # of the turning about the shape's center, its axes [kg m^2]
    H=(float, 9),  # moment by linear acceleration, row by row [kg m]
    M=(float, 6),  # [kg]
)

ELLIPSOID = record(
    semiaxes=(float, 3),  # [m]
    blunt=float,  # coefficients of MuJoCo's `fluidcoef`, times the density
    slender=float,
    angular=float,
    kutta=float,
    magnus=float,
)

MEDIUM = record(
    up=(float, 3),  # against gravity
    level=float,  # height of the surface along it [m]
    current=(float, 3),  # [m/s]
    weight=(float, 3),  # density times gravity [N/m^3]
)


@structure
class Fluid(NamedTuple):
    """A medium, and the shapes that it acts on."""

    medium: np.ndarray  # (1,) MEDIUM
    surface: bool | None  # True with a level, None where the medium is everywhere
    table: np.ndarray  # (shapes,) IMMERSED
    triangles: np.ndarray  # (all, 9) corners of polyhedra, shape's frame [m]
    added: np.ndarray | None  # (shapes,) ADDED
    ellipsoids: np.ndarray | None  # (shapes,) ELLIPSOID
    first: np.ndarray  # (1,) first row in the scratch C, after those of contact points


# Columns of the scratch `C`: a shape has a row of the force and one of the moment.  Those of element.py, and
STEADY = 22  # 3: what does not depend on the velocity sought: buoyancy, lift [N; N m]
SHARE = 25  # of the volume that is immersed
SLOPE = 27  # 6: slope of the drag, world axes [N s/m; N m s]
SIZE = 33  # Q of the step
BUOYANCY, DRAG, ADDED_MASS, PROPULSION = range(4)
WORKS = 4  # numbers of the channel `fluid_work`


@inline
def _row(fluid, k):
    """Return the row of the force on a shape; that of the moment comes next."""
    return fluid.first[0] + 2 * k


@inline
def _axes(s, W):
    return compose(load9(W, s.body, R), s.E)


# ---------------------------------------------------------------------------------------------- place


@element.place.of(Fluid)
def _place_fluid(fluid, step):
    _place(fluid, base_at(step.predicted, step), step)


@kernel
def _place(fluid, base_q, step):
    """Fill what is immersed of each shape, its velocity, and the forces that these alone give."""
    W, C, medium = step.W, step.C, fluid.medium[0]
    for k in range(len(fluid.table)):
        s = fluid.table[k]
        if s.tree == base_index(step.part):
            r, E, zero = _row(fluid, k), _axes(s, W), 0.0 * W[s.body, V]
            origin = point_position(s.body, vector(s.position), W)
            volume, center = _part_below(fluid.surface, fluid, s, E, origin, base_q)
            x = add(origin, rotate(E, center))
            share = volume / s.volume + zero
            store3(C, r, XP, x)
            C[r, SHARE], C[r + 1, SHARE] = share, share
            for row, u in ((r, center_velocity(s.body, x, W)), (r + 1, load3(W, s.body, V))):
                store3(C, row, U0, u)
                store3(C, row, UK, u)
            store3(C, r, STEADY, scale(vector(medium.weight), -s.floats * volume))
            store3(C, r + 1, STEADY, (zero, zero, zero))
            C[r, SIZE], C[r + 1, SIZE] = s.strength + zero, s.turning_strength + zero
            _place_ellipsoid(fluid.ellipsoids, fluid, k, E, C)


@inline
def _part_below(surface, fluid, s, E, origin, base_q):
    """Return volume [m^3] and center (3) in the shape's frame [m] of what is immersed."""
    if surface is None:
        zero = 0.0 * origin[0]
        return s.volume + zero, vector(s.center)
    up, level = vector(fluid.medium[0].up), fluid.medium[0].level
    at = origin
    if base_q is not None:
        at = add(at, vector(base_q))
    g = rotate_back(E, up)
    volume, moment = immersed(s, fluid.triangles, level - dot(up, at), (-g[0], -g[1], -g[2]))
    some, zero = volume > TINY * s.volume, 0.0 * volume
    inverse = select(some, 1.0 / select(some, volume, 1.0 + zero), zero)
    return select(some, volume, zero), scale(moment, inverse)


@inline
def _place_ellipsoid(ellipsoids, fluid, k, E, C):
    """Fill coefficients of drag and forces of lift of MuJoCo's ellipsoids at the predicted velocity."""
    if ellipsoids is not None:
        e = ellipsoids[k]
        if e.semiaxes[0] > 0.0:
            r = _row(fluid, k)
            u = rotate_back(E, sub(load3(C, r, U0), vector(fluid.medium[0].current)))
            w = rotate_back(E, load3(C, r + 1, U0))
            C[r, SIZE], C[r + 1, SIZE], lift = _ellipsoid(e, u, w)
            store3(C, r, STEADY, add(load3(C, r, STEADY), rotate(E, lift)))


@inline
def _ellipsoid(e, u, w):
    """Return quadratic coefficients of force and moment [N s^2/m^2; N m s^2], and the lift (3) [N], shape's axes."""
    a, b, c = e.semiaxes[0], e.semiaxes[1], e.semiaxes[2]
    most, least = max(a, b, c), min(a, b, c)
    middle = a + b + c - most - least
    area, speed = math.pi * most * middle, sqrt(dot(u, u))
    p = (b * c * u[0], c * a * u[1], a * b * u[2])
    normal = (b * c * p[0], c * a * p[1], a * b * p[2])  # of the ellipsoid where the flow meets it
    squares, fourths = dot(p, p), dot(normal, normal)
    moving = squares > 0.0
    one = 1.0 + 0.0 * speed
    projected = math.pi * sqrt(select(moving, fourths / select(moving, squares, one), 0.0 * one))
    cosine = select(moving, squares / select(moving, speed * fourths, one), 0.0 * one)
    circulation = scale(cross(normal, u), e.kutta * cosine * projected)
    lift = add(cross(circulation, u), scale(cross(w, u), e.magnus * (4.0 / 3.0 * math.pi * a * b * c)))
    fifth = 8.0 / 15.0 * math.pi
    largest = fifth * middle * most * most * most * most
    turned = (
        w[0] * _turning(e, fifth * a * _fourth(max(b, c)), largest),
        w[1] * _turning(e, fifth * b * _fourth(max(a, c)), largest),
        w[2] * _turning(e, fifth * c * _fourth(max(a, b)), largest),
    )
    rate = sqrt(dot(w, w))
    turns = rate > 0.0
    about = select(turns, sqrt(dot(turned, turned)) / select(turns, rate, one), 0.0 * one)
    return e.blunt * projected + e.slender * (area - projected), about, lift


@inline
def _fourth(x):
    return x * x * x * x


@inline
def _turning(e, own, largest):
    return e.angular * own + e.slender * (largest - own)


# ---------------------------------------------------------------------------------------------- law of drag


@inline
def _drag(separate, b, size, q, share, u):
    """Return the force (3) that opposes u, in the shape's axes, and its slope (xx, xy, xz, yy, yz, zz)."""
    if separate > 0:
        n = (size * q[0] * abs(u[0]), size * q[1] * abs(u[1]), size * q[2] * abs(u[2]))
        f = (-share * (b[0] + n[0]) * u[0], -share * (b[1] + n[1]) * u[1], -share * (b[2] + n[2]) * u[2])
        zero = 0.0 * share
        K = (share * (b[0] + 2.0 * n[0]), zero, zero, share * (b[1] + 2.0 * n[1]), zero, share * (b[2] + 2.0 * n[2]))
        return f, K
    p = (q[0] * u[0], q[1] * u[1], q[2] * u[2])
    N = sqrt(dot(p, u))
    k, part = size * N, share * size * select(N > 0.0, 1.0 / select(N > 0.0, N, 1.0 + 0.0 * N), 0.0 * N)
    f = (-share * (b[0] * u[0] + k * p[0]), -share * (b[1] * u[1] + k * p[1]), -share * (b[2] * u[2] + k * p[2]))
    K = (
        share * (b[0] + k * q[0]) + part * p[0] * p[0],
        part * p[0] * p[1],
        part * p[0] * p[2],
        share * (b[1] + k * q[1]) + part * p[1] * p[1],
        part * p[1] * p[2],
        share * (b[2] + k * q[2]) + part * p[2] * p[2],
    )
    return f, K


@inline
def _force(fluid, s, r, E, C, u):
    """Return the drag [N] at the velocity u of the shape s, world axes, and its slope."""
    at = rotate_back(E, sub(u, vector(fluid.medium[0].current)))
    f, K = _drag(s.separate, s.linear, C[r, SIZE], s.quadratic, C[r, SHARE], at)
    return rotate(E, f), congruence(E, K)


@inline
def _moment(s, r, E, C, w):
    """Return the same of the moment [N m] at the angular velocity w; r: row of the force."""
    f, K = _drag(s.separate, s.turning_linear, C[r + 1, SIZE], s.turning_quadratic, C[r, SHARE], rotate_back(E, w))
    return rotate(E, f), congruence(E, K)


# ---------------------------------------------------------------------------------------------- in the implicit step


element.linearize.of(Fluid)(lambda fluid, step: _linearize(fluid, UK, 1.0, step))
element.fold.of(Fluid)(lambda fluid, step: _fold(fluid, step, step.h_implicit))


@kernel
def _linearize(fluid, column, share, step):
    """Fill the drag at the velocities of a column, and a share of its slope."""
    W, C = step.W, step.C
    for k in range(len(fluid.table)):
        s = fluid.table[k]
        if s.tree == base_index(step.part):
            r, E = _row(fluid, k), _axes(s, W)
            for row, (f, K) in (
                (r, _force(fluid, s, r, E, C, load3(C, r, column))),
                (r + 1, _moment(s, r, E, C, load3(C, r + 1, column))),
            ):
                store3(C, row, FK, f)
                for j in range(6):
                    C[row, SLOPE + j] = share * K[j]


@inline
def _slope_of(C, r):
    return (C[r, SLOPE], C[r, SLOPE + 1], C[r, SLOPE + 2], C[r, SLOPE + 3], C[r, SLOPE + 4], C[r, SLOPE + 5])


@apart
def _fold(fluid, step, h):
    """Sum h times the slopes, added mass and the forces at the predicted velocity into the rows of the bodies."""
    W, C = step.W, step.C
    for k in range(len(fluid.table)):
        s = fluid.table[k]
        if s.tree == base_index(step.part):
            r, row = _row(fluid, k), s.contact
            if s.clears > 0:
                for j in range(TOUCH + 1):
                    W[row, j] = 0.0 * C[r, SHARE]
            W[row, TOUCH] = 1.0 + 0.0 * C[r, SHARE]
            x = load3(C, r, XP)
            f, m = _total(C, r, U0), _total(C, r + 1, U0)
            _add_force(W, row, add(m, cross(x, f)), f)
            zero = 0.0 * x[0]
            none = (zero, zero, zero)
            _add_inertia(W, row, x, _times(_slope_of(C, r + 1), h), (none, none, none), _times(_slope_of(C, r), h))
            _fold_added(fluid.added, fluid, k, step)


@inline
def _times(K, h):
    return (h * K[0], h * K[1], h * K[2], h * K[3], h * K[4], h * K[5])


@inline
def _total(C, r, column):
    """Return the linear model's force of a row at the velocity of a column, with what does not depend on it."""
    return add(load3(C, r, STEADY), _model(C, r, column))


@inline
def _model(C, r, column):
    return sub(load3(C, r, FK), symmetric(_slope_of(C, r), sub(load3(C, r, column), load3(C, r, UK))))


@inline
def _add_force(W, row, m, f):
    for j in range(3):
        W[row, SF + j] += m[j]
        W[row, SF + 3 + j] += f[j]


@inline
def _add_inertia(W, row, p, J, H, M):
    """Add [[J, H], [H', M]] about the point p to a row: H + p x M, J + p x H' + (p x H')' - p x M p x; H by columns."""
    a, b, c = cross(p, (M[0], M[1], M[2])), cross(p, (M[1], M[3], M[4])), cross(p, (M[2], M[4], M[5]))
    # p x H', of which the columns are H's rows, and (p x M) p x', of which they are its rows
    u, v, w = (H[0][0], H[1][0], H[2][0]), (H[0][1], H[1][1], H[2][1]), (H[0][2], H[1][2], H[2][2])
    x, y, z = cross(p, u), cross(p, v), cross(p, w)
    X, Y, Z = cross(p, (a[0], b[0], c[0])), cross(p, (a[1], b[1], c[1])), cross(p, (a[2], b[2], c[2]))
    for j, value in enumerate(
        (
            J[0] + X[0] + 2.0 * x[0],
            J[1] + X[1] + x[1] + y[0],
            J[2] + X[2] + x[2] + z[0],
            J[3] + Y[1] + 2.0 * y[1],
            J[4] + Y[2] + y[2] + z[1],
            J[5] + Z[2] + 2.0 * z[2],
        )
    ):
        W[row, SJ + j] += value
    for j in range(3):
        W[row, SH + 3 * j] += H[0][j] + a[j]
        W[row, SH + 3 * j + 1] += H[1][j] + b[j]
        W[row, SH + 3 * j + 2] += H[2][j] + c[j]
    for j in range(6):
        W[row, SM + j] += M[j]


@inline
def _fold_added(added, fluid, k, step):
    """Add the added mass of a shape, and the force that the bias accelerations give it."""
    if added is not None:
        W, C, s, a = step.W, step.C, fluid.table[k], added[k]
        E, origin, share = _axes(s, W), point_position(s.body, vector(s.position), W), C[_row(fluid, k), SHARE]
        J, H, M = _added_inertia(a, E, share)
        m, f = _added_force(fluid, s, J, H, M, a.inertial, origin, step, A)
        _add_force(W, s.contact, add(m, cross(origin, f)), f)
        i = a.inertial
        _add_inertia(W, s.contact, origin, _times(J, i), (scale(H[0], i), scale(H[1], i), scale(H[2], i)), _times(M, i))


@inline
def _added_inertia(a, E, share):
    """Return J, H (by columns) and M of the share of an added mass, world axes."""
    h = a.H
    # E H E': the columns of H E' turned
    columns = (
        rotate(E, rotate((h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]), (E[0], E[1], E[2]))),
        rotate(E, rotate((h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]), (E[3], E[4], E[5]))),
        rotate(E, rotate((h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]), (E[6], E[7], E[8]))),
    )
    H = (scale(columns[0], share), scale(columns[1], share), scale(columns[2], share))
    return _times(congruence(E, a.J), share), H, _times(congruence(E, a.M), share)


@inline
def _added_force(fluid, s, J, H, M, inertial, p, step, column):
    """Return moment and force of the added mass about the point p, for the accelerations in a column of W.

    These are less gravity, as `motion_pass` fills them, in A; in U they come on top of those.
    """
    W, g, c = step.W, step.scene.gravity, vector(fluid.medium[0].current)
    w, v = load3(W, s.body, V), center_velocity(s.body, p, W)
    u = sub(v, c)
    alpha, a = load3(W, s.body, A), add(load3(W, s.body, A + 3), (g[0], g[1], g[2]))
    if column == U:
        alpha, a = add(alpha, load3(W, s.body, U)), add(a, load3(W, s.body, U + 3))
    a = add(a, add(cross(alpha, p), cross(w, c)))
    L = add(symmetric(M, u), _transposed(H, w))
    N = add(symmetric(J, w), _columns(H, u))
    f = add(scale(add(symmetric(M, a), _transposed(H, alpha)), inertial), cross(w, L))
    m = add(scale(add(symmetric(J, alpha), _columns(H, a)), inertial), add(cross(w, N), cross(u, L)))
    return scale(m, -1.0), scale(f, -1.0)


@inline
def _columns(H, x):
    """Return H x."""
    return add(scale(H[0], x[0]), add(scale(H[1], x[1]), scale(H[2], x[2])))


@inline
def _transposed(H, x):
    """Return H' x."""
    return (dot(H[0], x), dot(H[1], x), dot(H[2], x))


@element.solve.of(Fluid)
def _solve(fluid, step):
    """Fill the velocities UN that the solution's dA gives the shapes, and the linear model's drag FL there."""
    W, C, h = step.W, step.C, step.h_implicit
    for k in range(len(fluid.table)):
        s = fluid.table[k]
        if s.tree == base_index(step.part):
            r, alpha = _row(fluid, k), load3(W, s.body, U)
            a = add(load3(W, s.body, U + 3), cross(alpha, load3(C, r, XP)))
            for row, rate in ((r, a), (r + 1, alpha)):
                store3(C, row, UN, add(load3(C, row, U0), scale(rate, h)))
                store3(C, row, FL, _model(C, row, UN))


@element.elements.of(Fluid)
def _rows(fluid, step):
    return _row(fluid, 0), _row(fluid, len(fluid.table))


@inline
def _shape_of(fluid, r):
    """Return the number of the shape that has this row."""
    return (r - fluid.first[0]) >> 1


element.belongs.of(Fluid)(lambda fluid, r, step: fluid.table[_shape_of(fluid, r)].tree == base_index(step.part))


@element.force_at.of(Fluid)
def _force_at(fluid, r, u, step):
    k = _shape_of(fluid, r)
    s, E = fluid.table[k], _axes(fluid.table[k], step.W)
    if r == _row(fluid, k):
        f, _ = _force(fluid, s, r, E, step.C, u)
    else:
        f, _ = _moment(s, r - 1, E, step.C, u)
    return f


@element.move.of(Fluid)
def _move(fluid, step):
    """Store the forces of the step, and add their work to the channel `fluid_work`."""
    _linearize(fluid, UN, 0.0, step)
    _account(fluid, UN, step, step.y, step.h)


@kernel
def _account(fluid, column, step, work, h):
    """Store forces and shares in y, and add h times the powers at the velocities of a column to `work`."""
    C, y, offsets = step.C, step.y, step.offsets
    first = offsets.fluid_work + WORKS * base_index(step.part)
    for k in range(len(fluid.table)):
        s = fluid.table[k]
        if s.tree == base_index(step.part):
            r = _row(fluid, k)
            u, w, steady = load3(C, r, column), load3(C, r + 1, column), load3(C, r, STEADY)
            drag, turning = load3(C, r, FK), load3(C, r + 1, FK)
            lifted = dot(steady, u)
            work[first + BUOYANCY] += h * (s.floats * lifted)
            work[first + DRAG] += h * ((1.0 - s.floats) * lifted + dot(drag, u) + dot(turning, w))
            y[offsets.immersed_share + k] = C[r, SHARE]
            f, m = _with_added(fluid.added, fluid, k, column, step, work, first + ADDED_MASS, h)
            f, m = add(f, add(steady, drag)), add(m, turning)
            for j in range(3):
                y[offsets.fluid_force + 6 * k + j] = f[j]
                y[offsets.fluid_force + 6 * k + 3 + j] = m[j]


@inline
def _with_added(added, fluid, k, column, step, work, at, h):
    """Return force and moment of the added mass about the immersed part's center, and add its work."""
    zero = 0.0 * step.C[_row(fluid, k), SHARE]
    f, m = (zero, zero, zero), (zero, zero, zero)
    if added is not None:
        C, s, r = step.C, fluid.table[k], _row(fluid, k)
        p = point_position(s.body, vector(s.position), step.W)
        J, H, M = _added_inertia(added[k], _axes(s, step.W), C[r, SHARE])
        m, f = _added_force(fluid, s, J, H, M, added[k].inertial, p, step, U)
        m = add(m, cross(sub(p, load3(C, r, XP)), f))
        work[at] += h * (dot(f, load3(C, r, column)) + dot(m, load3(C, r + 1, column)))
    return f, m


# ---------------------------------------------------------------------------------------------- as an equation


@element.rates.of(Fluid)
def _rates(fluid, step, dy):
    """Place the shapes and fold their forces at the present state, for accelerations that are found next."""
    _place(fluid, base_at(None, step), step)
    _linearize(fluid, U0, 0.0, step)
    _fold(fluid, step, 0.0)


@inline
def fluid_powers(fluid, step, dy):
    """Store forces, and their powers in dy, when the accelerations are found."""
    if fluid is not None:
        first = step.offsets.fluid_work + WORKS * base_index(step.part)
        for k in range(WORKS - 1):
            dy[first + k] = 0.0 * step.W[0, V]
        _account(fluid, U0, step, dy, 1.0)
