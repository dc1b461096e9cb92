"""The scene as a differential equation dy/dt = f(t, y), for the integrators that evaluate it explicitly.

Between controller ticks the parts of `y` up to the voltages obey it; torques, contact forces and accelerations are
outputs of each evaluation.
"""

from ..compile.by_type import overridable
from ..compile.jit import inline
from ..compile.optional import item_or_zero, plus_item, slice_if
from ..effects.actuator import actuator_rates
from ..effects.contact import contact_rates
from ..effects.energies import ENERGIES, WORK
from ..effects.energies import FRICTION as LOSS
from ..effects.friction import direction, friction_rates
from ..effects.gear_friction import GearFriction, gear_friction, stribeck
from ..effects.joint_spring import plus_spring
from ..effects.stop import stop_rates
from ..tree.kinematics import base_acceleration, motion_pass, quaternion_rate
from ..tree.layout import Motion
from .newton import CJ, DIAGONAL, TAU, accelerations, external_forces


@inline
def derivative(step, dy):
    """Fill dy, zero to begin with, up to the voltages; also torque, contact force and accelerations in y."""
    scene, y, offsets, n = step.scene, step.y, step.offsets, len(step.scene.tree) - 1
    bq, bv = slice_if(scene.floating, y, offsets.base_q, 7), slice_if(scene.floating, y, offsets.base_qd, 6)
    q, v, a = y[offsets.q : offsets.q + n], y[offsets.qd : offsets.qd + n], y[offsets.qdd : offsets.qdd + n]
    motion_pass(scene.tree, scene.gravity, Motion(bq, bv, None, q, v, None), step.W)
    for i in range(n):
        speed = v[i]
        T, Tf = _drive_and_friction(scene.friction, step, dy, i, speed)
        T = plus_item(T, step.tau, i)
        y[offsets.torque + i] = T + 0.0 * speed
        dy[offsets.energy + ENERGIES * i + WORK] = T * speed
        others = Tf + stop_rates(scene.stops, step, dy, i, speed)
        others, _ = plus_spring(scene.joint_springs, step, i, speed, others, 0.0)
        step.Z[TAU, i] = T + others
    contact_rates(scene.contact, step, dy)
    external_forces(scene.push, scene.springs, scene.lifts, step)
    accelerations(_armature(scene.friction, step), scene.contact, step, a)
    _friction_of_acceleration(scene.friction, step, dy)
    for i in range(n):
        dy[offsets.q + i] = v[i]
        dy[offsets.qd + i] = a[i]
    _base_rates(bq, bv, step, dy)


@inline
def _base_rates(bq, bv, step, dy):
    """Set dx/dt = v, dquaternion/dt = 1/2 quaternion omega."""
    if bq is not None:
        offsets, a = step.offsets, step.y[step.offsets.base_qdd : step.offsets.base_qdd + 6]
        base_acceleration(a, step.W)
        for k in range(3):
            dy[offsets.base_q + k] = bv[k]
        quaternion_rate(bq, bv, dy[offsets.base_q + 3 : offsets.base_q + 7])
        for k in range(6):
            dy[offsets.base_qd + k] = a[k]


@overridable
def _drive_and_friction(friction, step, dy, i, v):
    """Return torques of actuator and friction [N m], with their rates in dy."""
    Tf = friction_rates(friction, step.actuator, step, dy, i, v)
    return actuator_rates(step.actuator, step, dy, i, v), Tf


@_drive_and_friction.of(GearFriction)
def _by_load(friction, step, dy, i, v):
    """Return both, friction without its share of the acceleration, CJ A dv/dt, which lessens the armature."""
    f, A, Z = friction.table[i], item_or_zero(step.scene.armature, i), step.Z
    loss = step.offsets.energy + ENERGIES * i + LOSS
    dy[loss] = 0.0 * v
    T = actuator_rates(step.actuator, step, dy, i, v)
    b, viscous = A * step.y[step.offsets.qdd + i], f.viscous_friction * v
    x, _ = direction(step.extrapolation_ratio, f, step, i, v)
    Tf, _, _, by_b = gear_friction(f, stribeck(f, v), x, T, b + viscous)
    Z[CJ, i], Z[DIAGONAL, i] = by_b, A * (1.0 - by_b)
    Tf = Tf - (viscous + by_b * b)
    dy[loss] -= Tf * v
    return T, Tf


@overridable
def _armature(friction, step):
    """Return the inertia to be added to the joints' (n,) [kg m^2], None if there is none."""
    return step.scene.armature


_armature.of(GearFriction)(lambda friction, step: step.Z[DIAGONAL])


@overridable
def _friction_of_acceleration(friction, step, dy):
    """Add the power of friction's share of the acceleration to dy."""


@_friction_of_acceleration.of(GearFriction)
def _its_power(friction, step, dy):
    for i in range(len(friction.table)):
        share = step.Z[CJ, i] * item_or_zero(step.scene.armature, i) * step.y[step.offsets.qdd + i]
        dy[step.offsets.energy + ENERGIES * i + LOSS] -= share * step.y[step.offsets.qd + i]
