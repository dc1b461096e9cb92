"""One linearly implicit step, its stiff part folded into the articulated-body algorithm.

The velocity at the end of the substep h' = theta h (theta = 1: Euler, 1/2: midpoint) satisfies

    M (v - v*) / h' = T(v),    v* = what the bias forces alone would give,

where T collects servo, friction, stops and contacts.  Each of them is the gradient of a convex function of v with
the sign reversed (a force that never rises with speed), so the solution is the minimum of a convex function, found by
a semi-smooth Newton iteration: linearise T about the iterate, solve

    (M + h' C) a = T(v_k) + C (v_k - v_p) - bias(v_p),    v = v_p + h' a,    C = -dT/dv,

which is one ABA with D_i enlarged by h' C_i and each contact's h' J' C J added to its own link's inertia.  Motor
current and rotor are eliminated before (a scalar Schur complement a joint).  Without clipping the first pass is exact.
When a pass overshoots, a line search along it restores descent: the inertial force M (v - v*)/h' is linear in v and
equals the linear model's T at each solution, so its value along the line costs nothing.

v_p is the velocity for which the bias is taken: that of the start (Euler), or extrapolated with the last step's
acceleration (midpoint), which makes the step second order with one evaluation.  Springs between bodies (spring.py) are
taken at that state like the bias, outside the fold: the step is then limited as an explicit one is.
"""

from .aba import acceleration_pass, articulated_pass
from .contact import DEPTH as C_DEPTH
from .contact import (
    FL,
    LIMIT,
    RHO,
    UK,
    UN,
    contact_forces,
    fold_contacts,
    friction_force,
    friction_limits,
    normal_force,
    place_points,
    solved_velocities,
)
from .gearbox import gear_torque
from .jit import inline, kernel
from .kinematics import motion_pass
from .lanes import any_lane, select, sqrt
from .layout import INERTIA, KT, PD_FOLD, PD_KD, PD_KP, PD_LIMIT, PD_OUTSIDE, ROTOR_DAMPING
from .motor import clamp, current_step
from .optional import either, part, when
from .passive import friction_torque, stop_torque
from .push import external_forces, outside
from .spatial import add, dot, load3, scale
from .spatial import sub as minus

MAX_PASSES = 40
BISECTIONS = 16
TOLERANCE = 1e-9  # of the forces, relative
FLOOR = 1e-11  # of the forces [N m, N]

# Rows of the scratch `Z`, one column a joint.
VP = 0  # velocity for which the bias is taken
VK = 1  # velocity about which the forces are linearised
VN = 2  # velocity of the solution
WK = 3  # rotor speeds, likewise
WN = 4
T0 = 5  # linear model of the torque on the joint: T0 - CJ v
CJ = 6
TL = 7  # its value at VN
WP = 8  # rotor speed of the linear model: WP + WS v
WS = 9
FW0 = 10  # linear model of the torque on the rotor: FW0 - FWW w + FWV v
FWW = 11
FWV = 12
FLW = 13  # its value at WN, VN
RT = 14  # inertial forces at VK: joint and rotor
RW = 15
TAU = 16  # what the ABA is given
DIAGONAL = 17
DA = 18  # what it returns: acceleration beyond the predicted one
SCRATCH = 19


@kernel
def solve_step(scene, points, push, o, y, t, span, predicted, tau, drive, h, sub, W, Z, C, F):
    """Find the solution of one step: accelerations in y, velocities VN, WN, UN in the scratch; W is filled.

    scene, o, y: see rollout.py; t, span: the time over which pushes are averaged [s]; predicted: scratch (nq + nv,) for
    the predicted state, None for theta = 1; tau (n,) external torques [N m] or None; drive (n, 2) references of the pd
    servo; h step, sub = theta h [s]; F (n + 1, 6) scratch for pushes and springs.
    A lane that has converged repeats its last pass to the same bits while its neighbours go on.
    """
    motion(scene, scene.gear, o, y, predicted, sub, W, Z)
    if points is not None:
        ahead = 0.0
        if predicted is not None:
            ahead = sub
        base_q = part(scene.floating, y, o.base_q, 7)
        place_points(points, scene.point_bodies, scene.ground, base_q, W, C, ahead)
        friction_limits(o, points, y, C, sub)
    external_forces(outside(scene), scene, push, scene.springs, t, span, W, F)
    _find_velocities(
        either(either(acting(scene), tau), points), scene, points, o, y, predicted, tau, drive, h, sub, W, Z, C, F
    )


@inline
def acting(scene):
    """None where nothing acts on the joints but gravity, bias forces and torques from outside."""
    return either(either(scene.servo, scene.pd), either(scene.friction, scene.stops))


@inline
def _find_velocities(forces, scene, points, o, y, predicted, tau, drive, h, sub, W, Z, C, F):
    """Newton's iteration; where no force depends on the velocity sought, or is there at all, one ABA."""
    if forces is None:
        _solve_free(scene, scene.armature, o, y, predicted, sub, W, Z, F)
    else:
        _iterate(scene, points, o, y, predicted, tau, drive, h, sub, W, Z, C, F)


@inline
def _iterate(scene, points, o, y, predicted, tau, drive, h, sub, W, Z, C, F):
    active = Z[VP, 0] == Z[VP, 0]  # false for a lane that is not finite
    for k in range(MAX_PASSES):
        _linearise(scene, scene.gear, points, o, y, tau, drive, h, sub, Z, C)
        _solve_linear(scene, scene.armature, scene.gear, points, o, y, predicted, sub, W, Z, C, F)
        wrong, rising = _compare(scene, scene.gear, points, o, y, tau, drive, h, sub, Z, C)
        y[o.passes] = select(active, y[o.passes] + 1.0, y[o.passes])
        active = active & wrong
        if not any_lane(active):
            break
        s = 1.0 + 0.0 * Z[VP, 0]
        if k > 0 and any_lane(active & (rising > 0.0)):
            s = _line_search(scene, o, y, tau, drive, h, sub, rising, Z, C)
        _advance(scene, scene.gear, points, s, active, Z, C)
    y[o.passes + 1] = select(active, y[o.passes + 1] + 1.0, y[o.passes + 1])


@inline
def _solve_free(scene, armature, o, y, predicted, sub, W, Z, F):
    """Accelerations and velocities of bodies on which nothing acts; Z[TAU] is zero to begin with."""
    if armature is not None:
        if predicted is not None:
            for i in range(len(scene.tree) - 1):
                Z[TAU, i] = -armature[i] * y[o.qdd + i]
    base_q = part(scene.floating, y, o.base_q, 7)
    articulated_pass(scene.tree, base_q, None, Z[TAU], armature, when(outside(scene), F), None, W)
    acceleration_pass(scene.tree, W, Z[DA])
    for i in range(len(scene.tree) - 1):
        Z[VN, i] = Z[VP, i] + sub * Z[DA, i]
    y[o.passes] = y[o.passes] + 1.0


@kernel
def motion(scene, gear, o, y, predicted, sub, W, Z):
    """Poses, velocities and bias at the predicted state; the iteration starts there."""
    n = len(scene.tree) - 1
    bq, bv = part(scene.floating, y, o.base_q, 7), part(scene.floating, y, o.base_qd, 6)
    q, v = y[o.q : o.q + n], y[o.qd : o.qd + n]
    if predicted is None:
        motion_pass(scene.tree, bq, bv, None, q, v, None, scene.gravity, W)
        for i in range(n):
            Z[VP, i] = v[i]
    else:
        a = y[o.qdd : o.qdd + n]
        for i in range(n):
            predicted[n + i] = v[i] + sub * a[i]
            predicted[i] = q[i] + sub * predicted[n + i]
            Z[VP, i] = predicted[n + i]
        ba = part(scene.floating, y, o.base_qdd, 6)
        _predict_base(bq, bv, ba, predicted, 2 * n, sub)
        bq, bv = part(scene.floating, predicted, 2 * n, 7), part(scene.floating, predicted, 2 * n + 7, 6)
        motion_pass(scene.tree, bq, bv, ba, predicted[:n], predicted[n : 2 * n], a, scene.gravity, W)
    for i in range(n):
        Z[VK, i] = Z[VP, i]
        if gear is not None:
            Z[WK, i] = y[o.rotor_speed + i]


@inline
def _predict_base(bq, bv, ba, predicted, start, sub):
    if bq is not None:
        for k in range(6):
            predicted[start + 7 + k] = bv[k] + sub * ba[k]
        move_base(bq, predicted[start + 7 : start + 13], sub, predicted[start : start + 7])


@inline
def move_base(bq, bv, h, out):
    """Move a free base for the time h: the rotation by Cayley's map of h omega, exact to third order; out may be bq."""
    for k in range(3):
        out[k] = bq[k] + h * bv[k]
    x, y, z = 0.5 * h * bv[3], 0.5 * h * bv[4], 0.5 * h * bv[5]
    a, b, c, d = bq[3], bq[4], bq[5], bq[6]
    w = a - b * x - c * y - d * z
    i = b + a * x + c * z - d * y
    j = c + a * y + d * x - b * z
    k = d + a * z + b * y - c * x
    r = 1.0 / sqrt(w * w + i * i + j * j + k * k)
    out[3] = w * r
    out[4] = i * r
    out[5] = j * r
    out[6] = k * r


@inline
def joint_force(scene, o, y, tau, drive, h, sub, i, v, w):
    """Torque on joint i at the velocities v, w of joint and rotor, with slopes.

    Returns T, torque on the rotor, -dT/dv apart from the gear's part, d gear torque / d (w - v), and minus the
    slope of what acts on the rotor apart from the gear.
    """
    Tf, cf = friction_torque(scene.friction, i, v)
    Ts, cs = stop_torque(scene.stops, i, y[o.q + i], v, sub)
    T, c = Tf + Ts, cf + cs
    if tau is not None:
        T = T + tau[i]
    return _drive_force(scene.servo, scene.gear, scene.pd, o, y, drive, h, sub, i, v, w, T, c)


@inline
def _drive_force(servo, gear, pd, o, y, drive, h, sub, i, v, w, T, c):
    if pd is not None:
        Td, cd = pd_torque(pd, i, y[o.q + i], v, drive[i, 0], sub)
        return T + Td, 0.0, c + cd, 0.0, 0.0
    if servo is None:
        return T, 0.0, c, 0.0, 0.0
    if gear is None:
        _, mean, slope = current_step(servo, i, y[o.current + i], y[o.voltage + i], v, h)
        return T + servo[i, KT] * mean, 0.0, c + servo[i, KT] * slope, 0.0, 0.0
    _, mean, slope = current_step(servo, i, y[o.current + i], y[o.voltage + i], w, h)
    e = y[o.rotor + i] - y[o.q + i] + sub * (w - v)
    Tg, cg, _ = gear_torque(gear, i, e, w - v, sub)
    F = servo[i, KT] * mean - gear[i, ROTOR_DAMPING] * w - Tg
    return T + Tg, F, c, cg, servo[i, KT] * slope + gear[i, ROTOR_DAMPING]


@inline
def pd_torque(pd, i, angle, v, reference, sub):
    """Kp e - Kd v, clamped whole or with the damping outside; the spring at the end of the step where it must be."""
    e = reference - angle - pd[i, PD_FOLD] * sub * v
    limit = pd[i, PD_LIMIT]
    outside = pd[i, PD_OUTSIDE] > 0.0
    spring = pd[i, PD_KP] * e
    inner = select(outside, spring, spring - pd[i, PD_KD] * v)
    held = clamp(inner, -limit, limit)
    free = held == inner
    stiff = select(free, pd[i, PD_KP] * pd[i, PD_FOLD] * sub + 0.0 * v, 0.0 * v)
    slope = stiff + select(free | outside, pd[i, PD_KD] + 0.0 * v, 0.0 * v)
    return select(outside, held - pd[i, PD_KD] * v, held), slope


@kernel
def _linearise(scene, gear, points, o, y, tau, drive, h, sub, Z, C):
    """Forces and slopes about VK, WK, UK; the rotor eliminated: T = T0 - CJ v."""
    for i in range(len(scene.tree) - 1):
        v, w = Z[VK, i], Z[WK, i]
        T, F, c, cg, cr = joint_force(scene, o, y, tau, drive, h, sub, i, v, w)
        Z[T0, i] = T + c * v
        Z[CJ, i] = c
        if gear is not None:
            d = gear[i, INERTIA] / sub + cr + cg
            p = gear[i, INERTIA] / sub * y[o.rotor_speed + i] + F + (cr + cg) * w - cg * v
            k = cg / d
            Z[T0, i] = T + (c + cg) * v - cg * w + k * p
            Z[CJ, i] = c + cg * (1.0 - k)
            Z[WP, i] = p / d
            Z[WS, i] = k
            Z[FW0, i] = F + (cr + cg) * w - cg * v
            Z[FWW, i] = cr + cg
            Z[FWV, i] = cg
    if points is not None:
        contact_forces(o, points, y, C, sub)


@kernel
def _solve_linear(scene, armature, gear, points, o, y, predicted, sub, W, Z, C, F):
    """One ABA of the linear model; velocities and the model's forces at its solution."""
    n = len(scene.tree) - 1
    for i in range(n):
        Z[TAU, i] = Z[T0, i] - Z[CJ, i] * Z[VP, i]
        Z[DIAGONAL, i] = sub * Z[CJ, i]
        if armature is not None:
            Z[DIAGONAL, i] = Z[DIAGONAL, i] + armature[i]
            if predicted is not None:
                Z[TAU, i] = Z[TAU, i] - armature[i] * y[o.qdd + i]
    if points is not None:
        fold_contacts(scene.point_bodies, scene.tree, scene.ground, sub, W, C)
    base_q = part(scene.floating, y, o.base_q, 7)
    articulated_pass(scene.tree, base_q, None, Z[TAU], Z[DIAGONAL], when(outside(scene), F), points, W)
    acceleration_pass(scene.tree, W, Z[DA])
    for i in range(n):
        v = Z[VP, i] + sub * Z[DA, i]
        Z[VN, i] = v
        Z[TL, i] = Z[T0, i] - Z[CJ, i] * v
        if gear is not None:
            w = Z[WP, i] + Z[WS, i] * v
            Z[WN, i] = w
            Z[FLW, i] = Z[FW0, i] - Z[FWW, i] * w + Z[FWV, i] * v
    if points is not None:
        solved_velocities(scene.point_bodies, scene.ground, sub, W, C)


@kernel
def _compare(scene, gear, points, o, y, tau, drive, h, sub, Z, C):
    """Where the forces at the solution differ from the linear model's, and the slope of the descent there."""
    slope = 0.0 * Z[VN, 0]
    wrong = slope > 1.0
    for i in range(len(scene.tree) - 1):
        v, w = Z[VN, i], _rotor(gear, Z, WN, i)
        T, F, _, _, _ = joint_force(scene, o, y, tau, drive, h, sub, i, v, w)
        wrong = wrong | (abs(T - Z[TL, i]) > TOLERANCE * (abs(T) + abs(Z[TL, i])) + FLOOR)
        slope = slope + (v - Z[VK, i]) * (Z[TL, i] - T)
        if gear is not None:
            wrong = wrong | (abs(F - Z[FLW, i]) > TOLERANCE * (abs(T) + abs(Z[TL, i])) + FLOOR)
            slope = slope + (w - Z[WK, i]) * (Z[FLW, i] - F)
    if points is not None:
        for c in range(len(points)):
            u = load3(C, c, UN)
            f = point_force(o, points, y, C, c, u, sub)
            e = minus(load3(C, c, FL), f)
            size = abs(f[0]) + abs(f[1]) + abs(f[2])
            wrong = wrong | (abs(e[0]) + abs(e[1]) + abs(e[2]) > TOLERANCE * size + FLOOR)
            slope = slope + dot(minus(u, load3(C, c, UK)), e)
    return wrong, slope


@inline
def _rotor(gear, Z, row, i):
    if gear is None:
        return 0.0
    return Z[row, i]


@inline
def point_force(o, points, y, C, c, u, h):
    """Force on point c at the velocity u, ground's axes [N]."""
    fn, _ = normal_force(points, c, C[c, C_DEPTH], u[0], h)
    z1, z2 = y[o.bristle + 2 * c], y[o.bristle + 2 * c + 1]
    f1, f2, _, _, _, _ = friction_force(points, c, z1, z2, u[1], u[2], C[c, LIMIT], h)
    return (fn, f1, f2)


@kernel
def _line_search(scene, o, y, tau, drive, h, sub, rising, Z, C):
    """Where along the pass the descent ends: bisection of the slope, in the lanes in which it rises at the end."""
    low = 0.0 * rising
    high = 1.0 + 0.0 * rising
    for _ in range(BISECTIONS):
        s = 0.5 * (low + high)
        up = _slope(scene, scene.gear, scene.points, o, y, tau, drive, h, sub, s, Z, C) > 0.0
        low, high = select(up, low, s), select(up, s, high)
    return select(rising > 0.0, 0.5 * (low + high), 1.0 + 0.0 * rising)


@kernel
def _slope(scene, gear, points, o, y, tau, drive, h, sub, s, Z, C):
    """Slope of the convex function at the fraction s of the pass: inertial less applied force, along the pass."""
    slope = 0.0 * s
    for i in range(len(scene.tree) - 1):
        p = Z[VN, i] - Z[VK, i]
        pw = _rotor(gear, Z, WN, i) - _rotor(gear, Z, WK, i)
        w = _rotor(gear, Z, WK, i) + s * pw
        T, F, _, _, _ = joint_force(scene, o, y, tau, drive, h, sub, i, Z[VK, i] + s * p, w)
        slope = slope + p * (Z[RT, i] + s * (Z[TL, i] - Z[RT, i]) - T)
        if gear is not None:
            slope = slope + pw * (Z[RW, i] + s * (Z[FLW, i] - Z[RW, i]) - F)
    if points is not None:
        for c in range(len(points)):
            uk, r = load3(C, c, UK), load3(C, c, RHO)
            p = minus(load3(C, c, UN), uk)
            f = point_force(o, points, y, C, c, add(uk, scale(p, s)), sub)
            inertial = add(r, scale(minus(load3(C, c, FL), r), s))
            slope = slope + dot(p, minus(inertial, f))
    return slope


@kernel
def _advance(scene, gear, points, s, active, Z, C):
    """Move the iterate by the fraction s of the pass, in the lanes still at work."""
    for i in range(len(scene.tree) - 1):
        _move(Z, VK, VN, i, s, active)
        _move(Z, RT, TL, i, s, active)
        if gear is not None:
            _move(Z, WK, WN, i, s, active)
            _move(Z, RW, FLW, i, s, active)
    if points is not None:
        for c in range(len(points)):
            for k in range(3):
                _shift(C, c, UK + k, UN + k, s, active)
                _shift(C, c, RHO + k, FL + k, s, active)


@inline
def _move(Z, at, to, i, s, active):
    Z[at, i] = select(active, select(s < 1.0, Z[at, i] + s * (Z[to, i] - Z[at, i]), Z[to, i]), Z[at, i])


@inline
def _shift(C, c, at, to, s, active):
    C[c, at] = select(active, select(s < 1.0, C[c, at] + s * (C[c, to] - C[c, at]), C[c, to]), C[c, at])
