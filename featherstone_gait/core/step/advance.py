"""What follows the solution of a step: the state moves on, energies are summed, chatter is watched."""

from ..compile.by_type import by_type
from ..compile.jit import inline
from ..compile.lanes import select
from ..compile.optional import any_present
from ..effects.actuator import controller_of, move_actuator, rotor_of
from ..effects.contact import move_contacts
from ..effects.controller import filter_speed
from ..effects.energies import ENERGIES, WORK
from ..effects.energies import FRICTION as LOSS
from ..effects.friction import move_friction
from ..effects.gear_friction import GearFriction
from ..effects.stop import move_stop
from ..tree.kinematics import base_acceleration, move_base
from .newton import DA, DRIVE, RUB, VN, WN, acting, joint_force, rotor_speed, with_external, with_predicted

CHATTER_WINDOW = 64.0  # steps over which changes of velocity are averaged


@inline
def advance(s):
    """Move the state over the step that `solve_step` has solved."""
    n, y, o = len(s.scene.tree) - 1, s.y, s.o
    move_contacts(s.scene.contact, s)
    for i in range(n):
        v = s.Z[VN, i]
        w = rotor_speed(rotor_of(s.actuator), s.Z, WN, i, v)
        _joint_energies(any_present(acting(s), s.tau), s, i, v, w)
        move_actuator(s.actuator, s, i, v, w)
    for i in range(n):
        a = with_predicted(s.predicted, s.Z[DA, i], y[o.qdd + i])
        dv = s.h * a
        _watch(any_present(acting(s), s.scene.springs), o, y, i, dv)
        y[o.qdd + i] = a
        y[o.q + i] += s.h * s.Z[VN, i]
        y[o.qd + i] += dv
        filter_speed(controller_of(s.actuator), s, i)
    _advance_base(s.scene.floating, s)


@inline
def _advance_base(floating, s):
    """Position with the velocity v + sub a, then the velocity to its end."""
    if floating is not None:
        y, o = s.y, s.o
        a, v, x = y[o.base_qdd : o.base_qdd + 6], y[o.base_qd : o.base_qd + 6], y[o.base_q : o.base_q + 7]
        last = (a[0], a[1], a[2], a[3], a[4], a[5])
        base_acceleration(a, s.W)
        for k in range(6):
            a[k] = with_predicted(s.predicted, a[k], last[k])
            v[k] += s.sub * a[k]
        move_base(x, v, s.h, x)
        for k in range(6):
            v[k] += (s.h - s.sub) * a[k]


@inline
def _joint_energies(forces, s, i, v, w):
    """Energies of friction and stops and the work on the joint, at the velocities that the step used."""
    if forces is None:
        return
    T = _driving(s.scene.friction, s, i, v, w)
    s.y[s.o.torque + i] = T
    s.y[s.o.energy + ENERGIES * i + WORK] += s.h * (T * v)


@by_type
def _driving(friction, s, i, v, w):
    """What drives the joint [N m]; energies of friction and stops move on."""


@_driving.otherwise
def _less_friction(friction, s, i, v, w):
    Tf = move_friction(friction, s, i, v)
    Ts = move_stop(s.scene.stops, s, i, v)
    T, _, _, _, _, _ = joint_force(s, i, v, w)
    return T - (Tf + Ts)


@_driving.of(GearFriction)
def _by_the_gear(friction, s, i, v, w):
    T, Tf = s.Z[DRIVE, i], s.Z[RUB, i]
    s.y[s.o.energy + ENERGIES * i + LOSS] -= s.h * (Tf * v)
    move_stop(s.scene.stops, s, i, v)
    return with_external(s.tau, i, T)


@inline
def _watch(forces, o, y, i, dv):
    """Running mean of how far a change of velocity undoes the one before, less how far it goes on with it.

    Motion that the step resolves goes on; a step beyond the stability limit of an explicit method alternates, if there
    is a damper or a spring to make it.
    """
    if forces is None:
        return
    last = y[o.velocity_change + i]
    size = select(abs(dv) < abs(last), abs(dv), abs(last))
    mean = y[o.chatter + i]
    mean = mean + (select(dv * last < 0.0, size, -size) - mean) * (1.0 / CHATTER_WINDOW)
    y[o.velocity_change + i] = dv
    y[o.chatter + i] = mean
    y[o.worst_chatter + i] = select(mean > y[o.worst_chatter + i], mean, y[o.worst_chatter + i])
