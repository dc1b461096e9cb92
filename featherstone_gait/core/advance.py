"""What follows the solution of a step: the state moves on, energies are summed, chatter is watched."""

from .contact import LIMIT, UN, friction_force
from .gearbox import gear_torque
from .jit import inline, kernel
from .kinematics import base_acceleration
from .lanes import select
from .layout import (
    COPPER,
    CTD,
    CTK,
    DRIVER,
    ENERGIES,
    FADE,
    FRICTION,
    GEAR,
    IND,
    KT,
    METER,
    RES,
    ROTOR_DAMPING,
    STOPS,
    SUPPLY,
    WORK,
)
from .motor import current_step, square_mean
from .optional import either
from .passive import friction_torque, stop_torque
from .spatial import dot, load3
from .step import DA, VN, WN, acting, joint_force, move_base, point_force

CHATTER_WINDOW = 64.0  # steps over which changes of velocity are averaged


@kernel
def advance(scene, servo, gear, points, floating, o, y, predicted, tau, drive, h, sub, theta, W, Z, C):
    """Move the state over the step that `solve_step` has solved."""
    n = len(scene.tree) - 1
    if points is not None:
        _move_contacts(scene, o, y, h, sub, theta, C)
    for i in range(n):
        v = Z[VN, i]
        w = v
        if gear is not None:
            w = Z[WN, i]
        _joint_energies(either(acting(scene), tau), scene, gear, o, y, tau, drive, h, sub, i, v, w)
        if servo is not None:
            _move_motor(scene, gear, o, y, h, theta, i, v, w)
    for i in range(n):
        a = Z[DA, i]
        if predicted is not None:
            a = a + y[o.qdd + i]
        dv = h * a
        _watch(either(acting(scene), scene.springs), o, y, i, dv)
        y[o.qdd + i] = a
        y[o.q + i] += h * Z[VN, i]
        y[o.qd + i] += dv
        if servo is not None:
            f = y[o.filtered + i]
            y[o.filtered + i] = y[o.qd + i] + servo[i, FADE] * (f - y[o.qd + i])
    if floating is not None:
        _move_base(o, y, predicted, h, sub, W)


@inline
def _move_base(o, y, predicted, h, sub, W):
    """Position with the velocity v + sub a, then the velocity to its end."""
    a, v, x = y[o.base_qdd : o.base_qdd + 6], y[o.base_qd : o.base_qd + 6], y[o.base_q : o.base_q + 7]
    last = (a[0], a[1], a[2], a[3], a[4], a[5])
    base_acceleration(a, W)
    for k in range(6):
        if predicted is not None:
            a[k] = a[k] + last[k]
        v[k] += sub * a[k]
    move_base(x, v, h, x)
    for k in range(6):
        v[k] += (h - sub) * a[k]


@inline
def _joint_energies(forces, scene, gear, o, y, tau, drive, h, sub, i, v, w):
    """Energies of friction, stops and drive, at the velocities that the step used."""
    if forces is None:
        return
    E = o.energy + ENERGIES * i
    Tf, _ = friction_torque(scene.friction, i, v)
    Ts, _ = stop_torque(scene.stops, i, y[o.q + i], v, sub)
    T, _, _, _, _ = joint_force(scene, o, y, tau, drive, h, sub, i, v, w)
    T = T - (Tf + Ts)
    y[o.torque + i] = T
    y[E + WORK] += h * (T * v)
    y[E + FRICTION] -= h * (Tf * v)
    y[E + STOPS] -= h * (Ts * v)
    if gear is not None:
        e = y[o.rotor + i] - y[o.q + i] + sub * (w - v)
        _, _, loss = gear_torque(gear, i, e, w - v, sub)
        y[E + GEAR] += h * loss
        y[E + FRICTION] += h * (gear[i, ROTOR_DAMPING] * (w * w))


@inline
def _move_motor(scene, gear, o, y, h, theta, i, v, w):
    """Current and rotor to the end of the step, with the electrical energies; w the motor's speed."""
    servo, E = scene.servo, o.energy + ENERGIES * i
    I, V = y[o.current + i], y[o.voltage + i]
    end, mean, _ = current_step(servo, i, I, V, w, h)
    supply = h * (V * mean)
    copper = h * (servo[i, RES] * square_mean(servo, i, I, end))
    y[E + SUPPLY] += supply
    y[E + METER] += select(supply > 0.0, supply, 0.0 * supply)
    y[E + COPPER] += copper
    y[E + DRIVER] += supply - copper - h * (servo[i, KT] * w * mean) - 0.5 * servo[i, IND] * (end * end - I * I)
    y[o.current + i] = end
    if gear is not None:
        y[o.rotor + i] += h * w
        y[o.rotor_speed + i] += (w - y[o.rotor_speed + i]) * (1.0 / theta)


@inline
def _watch(forces, o, y, i, dv):
    """Running mean of how far a change of velocity undoes the one before, less how far it goes on with it.

    Motion that the step resolves goes on; a step beyond the stability limit of an explicit method alternates, if there
    is a damper or a spring to make it.
    """
    if forces is None:
        return
    last = y[o.increment + i]
    size = select(abs(dv) < abs(last), abs(dv), abs(last))
    mean = y[o.chatter + i]
    mean = mean + (select(dv * last < 0.0, size, -size) - mean) * (1.0 / CHATTER_WINDOW)
    y[o.increment + i] = dv
    y[o.chatter + i] = mean
    y[o.worst_chatter + i] = select(mean > y[o.worst_chatter + i], mean, y[o.worst_chatter + i])


@inline
def _move_contacts(scene, o, y, h, sub, theta, C):
    """Bristles and the forces that the step applied; the work of the ground."""
    for c in range(len(scene.points)):
        u = load3(C, c, UN)
        f = point_force(o, scene.points, y, C, c, u, sub)
        y[o.contact_work] += h * dot(f, u)
        z1, z2 = y[o.bristle + 2 * c], y[o.bristle + 2 * c + 1]
        _, _, _, _, _, slips = friction_force(scene.points, c, z1, z2, u[1], u[2], C[c, LIMIT], sub)
        kappa = 1.0 / (sub * scene.points[c, CTK] + scene.points[c, CTD])
        m1 = select(slips, (scene.points[c, CTD] * z1 - sub * f[1]) * kappa, z1 + sub * u[1])
        m2 = select(slips, (scene.points[c, CTD] * z2 - sub * f[2]) * kappa, z2 + sub * u[2])
        y[o.bristle + 2 * c] = z1 + (m1 - z1) * (1.0 / theta)
        y[o.bristle + 2 * c + 1] = z2 + (m2 - z2) * (1.0 / theta)
        for k in range(3):
            y[o.contact_force + 3 * c + k] = f[k]
