"""The scene as a differential equation dy/dt = f(t, y), for the integrators that evaluate it explicitly.

Between controller ticks the parts of `y` up to the voltages obey it; torques, contact forces and accelerations are
outputs of each evaluation.
"""

from .aba import acceleration_pass, articulated_pass
from .contact import (
    CN,
    DEPTH,
    FK,
    LIMIT,
    U0,
    bristle_rate,
    fold_contacts,
    friction_force,
    normal_force,
    place_points,
)
from .gearbox import gear_torque
from .jit import inline
from .kinematics import base_acceleration, motion_pass
from .lanes import select
from .layout import (
    CMU,
    COPPER,
    DRIVER,
    ENERGIES,
    FILTER,
    FRICTION,
    GEAR,
    IND,
    INERTIA,
    KT,
    METER,
    RES,
    ROTOR_DAMPING,
    STOPS,
    SUPPLY,
    WORK,
)
from .motor import current_rate
from .optional import part, when
from .passive import friction_torque, stop_torque
from .push import external_forces, outside
from .spatial import load3, store3
from .step import TAU, pd_torque


@inline
def derivative(scene, points, push, floating, o, y, t, span, dy, tau, drive, W, Z, C, F):
    """Fill dy[:o.voltage], zero to begin with; also torque, contact force and accelerations in y.

    Pushes are those of the time from t over `span` [s].
    """
    n = len(scene.tree) - 1
    bq, bv = part(floating, y, o.base_q, 7), part(floating, y, o.base_qd, 6)
    q, v, a = y[o.q : o.q + n], y[o.qd : o.qd + n], y[o.qdd : o.qdd + n]
    motion_pass(scene.tree, bq, bv, None, q, v, None, scene.gravity, W)
    for i in range(n):
        _joint_rates(scene, o, y, dy, tau, drive, i, Z)
    if points is not None:
        place_points(points, scene.point_bodies, scene.ground, bq, W, C, 0.0)
        _contact_rates(scene, o, y, dy, C)
        fold_contacts(scene.point_bodies, scene.tree, scene.ground, 0.0, W, C)
    external_forces(outside(scene), scene, push, scene.springs, t, span, W, F)
    articulated_pass(scene.tree, bq, None, Z[TAU], scene.armature, when(outside(scene), F), points, W)
    acceleration_pass(scene.tree, W, a)
    for i in range(n):
        dy[o.q + i] = v[i]
        dy[o.qd + i] = a[i]
    if floating is not None:
        _base_rates(o, y, dy, bq, bv, W)


@inline
def _base_rates(o, y, dy, bq, bv, W):
    """dx/dt = v, dquaternion/dt = 1/2 quaternion omega."""
    a = y[o.base_qdd : o.base_qdd + 6]
    base_acceleration(a, W)
    w, x, y_, z = bq[3], bq[4], bq[5], bq[6]
    p, q, r = 0.5 * bv[3], 0.5 * bv[4], 0.5 * bv[5]
    for k in range(3):
        dy[o.base_q + k] = bv[k]
    dy[o.base_q + 3] = -(x * p + y_ * q + z * r)
    dy[o.base_q + 4] = w * p + y_ * r - z * q
    dy[o.base_q + 5] = w * q + z * p - x * r
    dy[o.base_q + 6] = w * r + x * q - y_ * p
    for k in range(6):
        dy[o.base_qd + k] = a[k]


@inline
def _joint_rates(scene, o, y, dy, tau, drive, i, Z):
    """Torque on the joint; rates of motor, rotor, filter and of those energies that something changes."""
    v = y[o.qd + i]
    E = o.energy + ENERGIES * i
    T = _drive(scene.servo, scene.gear, scene.pd, o, y, dy, drive, i, v, E)
    if tau is not None:
        T = T + tau[i]
    y[o.torque + i] = T + 0.0 * v
    dy[E + WORK] = T * v
    Tf = _friction(scene.friction, scene.gear, dy, i, v, E)
    Z[TAU, i] = T + (Tf + _stop(scene.stops, o, y, dy, i, v, E))


@inline
def _friction(friction, gear, dy, i, v, E):
    """Torque of the friction; its loss adds to what the gearbox's rotor loses."""
    if friction is None:
        return 0.0
    T, _ = friction_torque(friction, i, v)
    if gear is None:
        dy[E + FRICTION] = -T * v
    else:
        dy[E + FRICTION] = dy[E + FRICTION] - T * v
    return T


@inline
def _stop(stops, o, y, dy, i, v, E):
    if stops is None:
        return 0.0
    T, _ = stop_torque(stops, i, y[o.q + i], v, 0.0)
    dy[E + STOPS] = -T * v
    return T


@inline
def _drive(servo, gear, pd, o, y, dy, drive, i, v, E):
    if pd is not None:
        T, _ = pd_torque(pd, i, y[o.q + i], v, drive[i, 0], 0.0)
        return T
    if servo is None:
        return 0.0 * v
    dy[o.filtered + i] = _filter_rate(servo, o, y, i, v)
    if gear is None:
        return servo[i, KT] * _motor_rates(servo, o, y, dy, i, v, E)
    w = y[o.rotor_speed + i]
    T, _, loss = gear_torque(gear, i, y[o.rotor + i] - y[o.q + i], w - v, 0.0)
    F = servo[i, KT] * _motor_rates(servo, o, y, dy, i, w, E) - gear[i, ROTOR_DAMPING] * w - T
    dy[o.rotor + i] = w
    dy[o.rotor_speed + i] = F / gear[i, INERTIA]
    dy[E + GEAR] = loss
    dy[E + FRICTION] = gear[i, ROTOR_DAMPING] * (w * w)
    return T


@inline
def _filter_rate(servo, o, y, i, v):
    filtered = servo[i, FILTER] > 0.0
    return select(filtered, (v - y[o.filtered + i]) / select(filtered, servo[i, FILTER], 1.0 + 0.0 * v), 0.0 * v)


@inline
def _motor_rates(servo, o, y, dy, i, w, E):
    """Rates of current and electrical energies; the current [A]."""
    V = y[o.voltage + i]
    I, rate = current_rate(servo, i, y[o.current + i], V, w)
    dy[o.current + i] = rate
    supply, copper = V * I, servo[i, RES] * (I * I)
    dy[E + SUPPLY] = supply
    dy[E + METER] = select(supply > 0.0, supply, 0.0 * supply)
    dy[E + COPPER] = copper
    dy[E + DRIVER] = supply - copper - servo[i, KT] * w * I - servo[i, IND] * I * rate
    return I


@inline
def _contact_rates(scene, o, y, dy, C):
    """Contact forces, rates of the bristles and power of the ground."""
    points = scene.points
    dy[o.contact_work] = 0.0 * y[o.contact_work]
    for c in range(len(points)):
        u = load3(C, c, U0)
        fn, _ = normal_force(points, c, C[c, DEPTH], u[0], 0.0)
        limit = points[c, CMU] * fn
        z1, z2 = y[o.bristle + 2 * c], y[o.bristle + 2 * c + 1]
        f1, f2, _, _, _, slips = friction_force(points, c, z1, z2, u[1], u[2], limit, 0.0)
        r1, r2 = bristle_rate(points, c, z1, z2, u[1], u[2], f1, f2, slips)
        dy[o.bristle + 2 * c] = r1
        dy[o.bristle + 2 * c + 1] = r2
        dy[o.contact_work] += fn * u[0] + f1 * u[1] + f2 * u[2]
        store3(C, c, FK, (fn, f1, f2))
        for k in range(4):
            C[c, CN + k] = 0.0
        C[c, LIMIT] = limit
        for k in range(3):
            y[o.contact_force + 3 * c + k] = C[c, FK + k]
