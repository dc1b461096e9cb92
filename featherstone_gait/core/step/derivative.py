"""The scene as a differential equation dy/dt = f(t, y), for the integrators that evaluate it explicitly.

Between controller ticks the parts of `y` up to the voltages obey it; torques, contact forces and accelerations are
outputs of each evaluation.
"""

from ..compile.by_type import by_type
from ..compile.jit import inline
from ..compile.optional import item_or_zero, slice_if
from ..effects.actuator import actuator_rates
from ..effects.contact import contact_rates
from ..effects.energies import ENERGIES, WORK
from ..effects.energies import FRICTION as LOSS
from ..effects.external import external_forces
from ..effects.friction import direction, friction_rates
from ..effects.gear_friction import GearFriction, gear_friction, stribeck
from ..effects.stop import stop_rates
from ..tree.kinematics import base_acceleration, motion_pass, quaternion_rate
from ..tree.layout import Motion
from .newton import CJ, DIAGONAL, TAU, accelerations, with_external


@inline
def derivative(s, dy):
    """Fill dy, zero to begin with, up to the voltages; also torque, contact force and accelerations in y."""
    scene, y, o, n = s.scene, s.y, s.o, len(s.scene.tree) - 1
    bq, bv = slice_if(scene.floating, y, o.base_q, 7), slice_if(scene.floating, y, o.base_qd, 6)
    q, v, a = y[o.q : o.q + n], y[o.qd : o.qd + n], y[o.qdd : o.qdd + n]
    motion_pass(scene.tree, scene.gravity, Motion(bq, bv, None, q, v, None), s.W)
    for i in range(n):
        _joint_rates(s, dy, i)
    contact_rates(scene.contact, s, dy)
    external_forces(scene.push, scene.springs, s)
    accelerations(_armature(scene.friction, s), scene.contact, s, a)
    _friction_of_acceleration(scene.friction, s, dy)
    for i in range(n):
        dy[o.q + i] = v[i]
        dy[o.qd + i] = a[i]
    _base_rates(bq, bv, s, dy)


@inline
def _base_rates(bq, bv, s, dy):
    """dx/dt = v, dquaternion/dt = 1/2 quaternion omega."""
    if bq is not None:
        o, a = s.o, s.y[s.o.base_qdd : s.o.base_qdd + 6]
        base_acceleration(a, s.W)
        for k in range(3):
            dy[o.base_q + k] = bv[k]
        quaternion_rate(bq, bv, dy[o.base_q + 3 : o.base_q + 7])
        for k in range(6):
            dy[o.base_qd + k] = a[k]


@inline
def _joint_rates(s, dy, i):
    """Torque on the joint; rates of the actuator and of those energies that something changes."""
    v, E = s.y[s.o.qd + i], s.o.energy + ENERGIES * i
    T, Tf = _drive_and_friction(s.scene.friction, s, dy, i, v)
    T = with_external(s.tau, i, T)
    s.y[s.o.torque + i] = T + 0.0 * v
    dy[E + WORK] = T * v
    s.Z[TAU, i] = T + (Tf + stop_rates(s.scene.stops, s, dy, i, v))


@by_type
def _drive_and_friction(friction, s, dy, i, v):
    """Torques of actuator and friction [N m], their rates in dy."""


@_drive_and_friction.otherwise
def _each(friction, s, dy, i, v):
    Tf = friction_rates(friction, s.actuator, s, dy, i, v)
    return actuator_rates(s.actuator, s, dy, i, v), Tf


@_drive_and_friction.of(GearFriction)
def _by_load(friction, s, dy, i, v):
    """Of friction all but its share of the acceleration, CJ A dv/dt, which lessens the armature."""
    f, A, Z, loss = friction.table[i], item_or_zero(s.scene.armature, i), s.Z, s.o.energy + ENERGIES * i + LOSS
    dy[loss] = 0.0 * v
    T, b, viscous = actuator_rates(s.actuator, s, dy, i, v), A * s.y[s.o.qdd + i], f.viscous_friction * v
    x, _ = direction(f, s, i, v)
    Tf, _, _, by_b = gear_friction(f, stribeck(f, v), x, T, b + viscous)
    Z[CJ, i], Z[DIAGONAL, i] = by_b, A * (1.0 - by_b)
    Tf = Tf - (viscous + by_b * b)
    dy[loss] -= Tf * v
    return T, Tf


@by_type
def _armature(friction, s):
    """Inertia to be added to the joints' (n,) [kg m^2], None if there is none."""


@_armature.otherwise
def _its_own(friction, s):
    return s.scene.armature


@_armature.of(GearFriction)
def _lessened(friction, s):
    return s.Z[DIAGONAL]


@by_type
def _friction_of_acceleration(friction, s, dy):
    """The power of friction's share of the acceleration, in dy."""


@_friction_of_acceleration.otherwise
def _no_share(friction, s, dy):
    pass


@_friction_of_acceleration.of(GearFriction)
def _its_power(friction, s, dy):
    for i in range(len(friction.table)):
        share = s.Z[CJ, i] * item_or_zero(s.scene.armature, i) * s.y[s.o.qdd + i]
        dy[s.o.energy + ENERGIES * i + LOSS] -= share * s.y[s.o.qd + i]
