"""The joints as elements: what acts on each and on the rotor of its actuator, and their scratch `Z`.

Motor current and rotor are eliminated from the linear system (a scalar Schur complement a joint); the rotor's speed and
torque are the second numbers of the element.
"""

from typing import NamedTuple

import numpy as np

from ..compile.by_type import NoneType, overridable
from ..compile.jit import inline, kernel
from ..compile.lanes import select
from ..compile.optional import item_or_zero, plus_item
from ..compile.structure import structure
from ..compile.taped import constant
from ..tree.forest import joints_of
from . import element
from .actuator import actuator_force, rotor_of
from .ball_spring import plus_ball_spring
from .drag import plus_drag
from .element import FLOOR
from .friction import ROUNDING, STEEPEST, direction, friction_torque, snap_to_rest
from .gear_friction import GearFriction, gear_friction, stribeck
from .joint_spring import plus_spring
from .propeller import plus_propeller
from .stop import stop_torque

# Rows of the scratch `Z`, one column a joint.
VP = 0  # velocity for which the bias is taken
VK = 1  # velocity about which the forces are linearized
VN = 2  # velocity of the solution
TL = 3  # the linear model's torque there
RT = 4  # inertial torque at VK
WK = 5  # the same of the rotor
WN = 6
FLW = 7
RW = 8
T0 = 9  # linear model of the torque on the joint: T0 - CJ v
CJ = 10
WP = 11  # rotor speed of the linear model: WP + WS v
WS = 12
FW0 = 13  # linear model of the torque on the rotor: FW0 - FWW w + FWV v
FWW = 14
FWV = 15
TAU = 16  # what the ABA is given
DIAGONAL = 17
DA = 18  # what it returns: acceleration beyond the predicted one
STRIBECK = 19  # of gear_friction.py: what is left at VP of what falls with the speed
DRIVE = 20  # what drives a gear, where its forces were last asked for, and its friction
RUB = 21
ANGLE = 22  # rotation vectors of ball joints with springs
SCRATCH = 23


@structure
class Joints(NamedTuple):
    """The joints of a scene without rotors."""

    rotor: None


@structure
class Geared(NamedTuple):
    """The joints of a scene with rotors, whose elements have two numbers."""

    rotor: np.ndarray  # (n,) records with `inertia`


@inline
def joints(step):
    """Return the joints as a kind of elements."""
    return _joints(rotor_of(step.actuator))


@overridable
def _joints(rotor):
    return Geared(rotor)


_joints.of(NoneType)(lambda rotor: Joints(rotor))


# ---------------------------------------------------------------------------------------------- forces of a joint


@overridable
def joint_force(friction, step, i, v, w):
    """Return the torque on joint i at the speeds v, w of joint and rotor, with slopes: see effects/actuator.py.

    Returns T, F, c, cg and cr of all that acts, and dT/dw: no other than cg, unless friction knows the load.
    """
    Tf, cf = friction_torque(friction, step, i, v)
    Tf, cf = plus_drag(step.scene.drag, i, v, Tf, cf)
    Ts, cs = stop_torque(step.scene.stops, i, step.y[step.offsets.q + i], v, step.h_implicit)
    T, c = plus_springs(step, i, v, Tf + Ts, cf + cs)
    T, c = plus_propeller(step.scene.propellers, i, v, T, c)
    T, F, c, cg, cr = actuator_force(step.actuator, step, i, v, w, plus_item(T, step.tau, i), c)
    return T, F, c, cg, cr, cg


@inline
def plus_springs(step, i, v, T, c):
    """Return T plus the torque of the springs of joint i at the speed v [N m], and c plus its slope -dT/dv."""
    T, c = plus_spring(step.scene.joint_springs, step.scene.stiffening, step, i, v, T, c)
    return plus_ball_spring(step.scene.ball_springs, step.Z[ANGLE], step.h_implicit, i, v, T, c)


@joint_force.of(GearFriction)
def _with_gear_friction(friction, step, i, v, w):
    Tm, F, c, cg, cr = actuator_force(step.actuator, step, i, v, w, 0.0 * v, 0.0 * v)
    Ts, cs = stop_torque(step.scene.stops, i, step.y[step.offsets.q + i], v, step.h_implicit)
    Tf, cf, by_m = gear_friction_torque(friction, step, i, v, Tm)
    step.Z[DRIVE, i], step.Z[RUB, i] = Tm, Tf
    Tf, cf = plus_drag(step.scene.drag, i, v, Tf, cf)
    T, ck = plus_springs(step, i, v, (Tm + Tf) + Ts, cf + cs)
    T, ck = plus_propeller(step.scene.propellers, i, v, T, ck)
    return plus_item(T, step.tau, i), F, c * (1.0 + by_m) + ck, cg, cr, cg * (1.0 + by_m)


@inline
def gear_friction_torque(friction, step, i, v, Tm):
    """Return a gear's friction [N m] under the drive Tm [N m], its slope -d/dv at fixed Tm, and the slope by Tm."""
    f = friction.table[i]
    A, B = item_or_zero(step.scene.armature, i), f.viscous_friction
    x, slope = direction(step.extrapolation_ratio, f, step, i, v)
    T, by_x, by_m, by_b = gear_friction(f, step.Z[STRIBECK, i], x, Tm, A * _acceleration(step, i, v) + B * v)
    return T - B * v, B - by_x * slope - by_b * (A / step.h_implicit + B), by_m


@inline
def _acceleration(step, i, v):
    """Return the acceleration of joint i in the step if its forces are taken at the speed v [rad/s^2]."""
    return with_predicted(step.predicted, (v - step.Z[VP, i]) / step.h_implicit, step.y[step.offsets.qdd + i])


@inline
def loads(friction, step, i, v, w):
    """Return what drives the gear of joint i and what the mechanism does to it, t_m and t_e [N m]."""
    Tm, _, _, _, _ = actuator_force(step.actuator, step, i, v, w, 0.0 * v, 0.0 * v)
    Tf, _, _ = gear_friction_torque(friction, step, i, v, Tm)
    return Tm, item_or_zero(step.scene.armature, i) * _acceleration(step, i, v) - Tm - Tf


@inline
def with_predicted(predicted, da, last):
    """Return the acceleration [rad/s^2]; the midpoint rule solves for what goes beyond the last step's."""
    if predicted is None:
        return da
    return da + last


@inline
def rotor_speed(rotor, Z, row, i, otherwise):
    """Return the rotor's speed in a row of the scratch [rad/s]; `otherwise` without rotors."""
    if rotor is None:
        return otherwise
    return Z[row, i]


# ---------------------------------------------------------------------------------------------- as elements


element.place.of(Joints, Geared)(lambda joints, step: _place(joints.rotor, step))


@inline
def _place(rotor, step):
    """Begin at the predicted speeds and those of the rotors at the start."""
    Z, (first, end) = step.Z, joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        Z[VK, i] = Z[VP, i]
        if rotor is not None:
            Z[WK, i] = step.y[step.offsets.rotor_speed + i]
    _begin_friction(step.scene.friction, step)


@overridable
def _begin_friction(friction, step):
    """Store what friction takes at the predicted speeds."""


@_begin_friction.of(GearFriction)
def _fill_stribeck(friction, step):
    first, end = joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        step.Z[STRIBECK, i] = stribeck(friction.table[i], step.Z[VP, i])


element.elements.of(Joints, Geared)(lambda joints, step: joints_of(step.part, step.scene.tree))
element.load.of(Joints)(lambda joints, i, which, step: (step.Z[VK + which, i],))
element.load.of(Geared)(lambda joints, i, which, step: (step.Z[VK + which, i], step.Z[WK + which, i]))


@element.keep.of(Joints)
def _keep(joints, i, which, x, step):
    step.Z[VK + which, i] = x[0]


@element.keep.of(Geared)
def _keep_both(joints, i, which, x, step):
    step.Z[VK + which, i], step.Z[WK + which, i] = x


@element.force_at.of(Joints)
def _torque(joints, i, u, step):
    T, _, _, _, _, _ = joint_force(step.scene.friction, step, i, u[0], 0.0)
    return (T,)


@element.force_at.of(Geared)
def _torques(joints, i, u, step):
    T, F, _, _, _, _ = joint_force(step.scene.friction, step, i, u[0], u[1])
    return T, F


@element.differs.of(Joints)
def _differ(joints, i, u, f, error, step):
    return abs(error[0]) > _allowed(i, f, step) + _rounding(i, u, step)


@element.differs.of(Geared)
def _either_differs(joints, i, u, f, error, step):
    allowed = _allowed(i, f, step)
    return (abs(error[0]) > allowed + _rounding(i, u, step)) | (abs(error[1]) > allowed + FLOOR)


@inline
def _allowed(i, f, step):
    return step.tolerance * (abs(f[0]) + abs(step.Z[TL, i]))


@inline
def _rounding(i, u, step):
    slope = step.Z[CJ, i]
    return FLOOR + select(slope > STEEPEST, ROUNDING * (slope * abs(u[0])), 0.0 * u[0])


element.snap.of(Joints)(lambda joints, i, u, here, there, where, step: (_snapped(i, u, here, there, where, step),))
element.snap.of(Geared)(lambda joints, i, u, here, there, where, step: (_snapped(i, u, here, there, where, step), u[1]))


@inline
def _snapped(i, u, here, there, where, step):
    v = snap_to_rest(step.scene.friction, step, i, u[0], here[0], there[0])
    return constant(select(where, v, u[0]))


element.linearize.of(Joints, Geared)(lambda joints, step: _linearize(joints.rotor, step))
element.fold.of(Joints, Geared)(lambda joints, step: _fold(step.scene.armature, step.predicted, step))
element.solve.of(Joints, Geared)(lambda joints, step: _solve(joints.rotor, step))


@kernel
def _linearize(rotor, step):
    """Linearize the forces about VK, WK and eliminate the rotor: T = T0 - CJ v."""
    Z, (first, end) = step.Z, joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        v, w = Z[VK, i], Z[WK, i]
        T, F, c, cg, cr, ct = joint_force(step.scene.friction, step, i, v, w)
        Z[T0, i] = T + c * v
        Z[CJ, i] = c
        if rotor is not None:
            d = rotor[i].inertia / step.h_implicit + cr + cg
            p = rotor[i].inertia / step.h_implicit * step.y[step.offsets.rotor_speed + i] + F + (cr + cg) * w - cg * v
            k = cg / d
            Z[T0, i] = T + (c + ct) * v - ct * w + (ct / d) * p
            Z[CJ, i] = c + ct * (1.0 - k)
            Z[WP, i] = p / d
            Z[WS, i] = k
            Z[FW0, i] = F + (cr + cg) * w - cg * v
            Z[FWW, i] = cr + cg
            Z[FWV, i] = cg


@inline
def _fold(armature, predicted, step):
    """Fill the torques and the diagonal that the linear model gives the ABA."""
    Z, (first, end) = step.Z, joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        Z[TAU, i] = Z[T0, i] - Z[CJ, i] * Z[VP, i]
        Z[DIAGONAL, i] = step.h_implicit * Z[CJ, i]
        if armature is not None:
            Z[DIAGONAL, i] = Z[DIAGONAL, i] + armature[i]
            if predicted is not None:
                Z[TAU, i] = Z[TAU, i] - armature[i] * step.y[step.offsets.qdd + i]


@inline
def _solve(rotor, step):
    """Fill velocities and the model's forces at the solution, whose accelerations DA the ABA has found."""
    Z, (first, end) = step.Z, joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        v = Z[VP, i] + step.h_implicit * Z[DA, i]
        Z[VN, i] = v
        Z[TL, i] = Z[T0, i] - Z[CJ, i] * v
        if rotor is not None:
            w = Z[WP, i] + Z[WS, i] * v
            Z[WN, i] = w
            Z[FLW, i] = Z[FW0, i] - Z[FWW, i] * w + Z[FWV, i] * v


@overridable
def ask_again(friction, rotor, step):
    """Leave what is left by the forces of joints that were asked for last, at the solution."""


@ask_again.of(GearFriction)
def _ask_gears(friction, rotor, step):
    Z, (first, end) = step.Z, joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        joint_force(friction, step, i, Z[VN, i], rotor_speed(rotor, Z, WN, i, 0.0))
