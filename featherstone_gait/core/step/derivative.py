"""The scene as a differential equation dy/dt = f(t, y), for the integrators that evaluate it explicitly.

Between controller ticks the parts of `y` up to the voltages obey it; torques, contact forces and accelerations are
outputs of each evaluation.
"""

from ..compile.by_type import overridable
from ..compile.jit import inline
from ..compile.optional import any_present, item_or_zero, plus_item
from ..effects.actuator import actuator_rates
from ..effects.ball_spring import place_ball_springs
from ..effects.drag import drag_rates
from ..effects.energies import ENERGIES, WORK
from ..effects.energies import FRICTION as LOSS
from ..effects.fluid import PROPULSION, WORKS, fluid_powers
from ..effects.friction import direction, friction_rates
from ..effects.gear_friction import GearFriction, gear_friction, stribeck
from ..effects.joint import ANGLE, CJ, DIAGONAL, TAU, plus_springs
from ..effects.pair import pair_rates
from ..effects.predicted import bases_at
from ..effects.propeller import add_work, plus_propeller
from ..effects.stop import stop_rates
from ..effects.surface import clear_drives
from ..tree.aba import acceleration_pass
from ..tree.ball import ball_positions, ball_rates
from ..tree.forest import base_index, base_of, joint_count, joints_of, rows_of
from ..tree.kinematics import base_acceleration, motion_pass, quaternion_rate
from ..tree.layout import Motion
from .closure import joined_by, place_joined, place_loops
from .context import of_tree
from .newton import articulate, external_forces, rates_all
from .row_solver import act_alone, act_joined


@inline
def derivative(step, dy):
    """Fill dy, zero to begin with, up to the voltages; also torque, contact force and accelerations in y."""
    _derivatives(step.scene.trees, step.scene.pairs, step, dy)


@inline
def _derivatives(trees, pairs, step, dy):
    clear_drives(step.scene.surfaces, step, dy)
    rows = any_present(any_present(step.scene.contact, step.scene.fluid), pairs)  # of forces on bodies
    if trees is None:
        _forces(step, dy)
        _rates(rows, step, dy)
    else:
        for k in range(len(trees)):
            _forces(of_tree(step, trees[k]), dy)
        if pairs is not None:
            pair_rates(pairs, step, dy)
        _rates_of_all(joined_by(step.scene.loops), trees, rows, step, dy)


@inline
def _forces(step, dy):
    """Find poses, velocities and forces of one tree, with the rates of what causes these."""
    scene, part, y, offsets = step.scene, step.part, step.y, step.offsets
    n, (first, end) = joint_count(scene.trees, scene.tree), joints_of(part, scene.tree)
    bq, bv = base_of(scene.floating, part, y, offsets.base_q, 7), base_of(scene.floating, part, y, offsets.base_qd, 6)
    q, v = y[offsets.q : offsets.q + n], y[offsets.qd : offsets.qd + n]
    ball_q = ball_positions(scene.balls, y, offsets.ball_q)
    motion_pass(scene.tree, part, scene.gravity, Motion(bq, bv, None, q, v, None, ball_q), step.W)
    place_ball_springs(scene.ball_springs, scene.balls, part, ball_q, v, 0.0, step.Z[ANGLE])
    for i in range(first, end):
        speed = v[i]
        T, Tf = _drive_and_friction(scene.friction, step, dy, i, speed)
        Tf = drag_rates(scene.drag, step, dy, i, speed, Tf)
        T = plus_item(T, step.tau, i)
        y[offsets.torque + i] = T + 0.0 * speed
        dy[offsets.energy + ENERGIES * i + WORK] = T * speed
        others = Tf + stop_rates(scene.stops, step, dy, i, speed)
        others, _ = plus_springs(step, i, speed, others, 0.0)
        others, _ = plus_propeller(scene.propellers, i, speed, others, 0.0)
        step.Z[TAU, i] = T + others
    rates_all(step, dy)


@inline
def _rates_of_all(joined, trees, contact, step, dy):
    """Find the accelerations of all trees, one after the other unless loops join some."""
    if joined is None:
        for k in range(len(trees)):
            _rates(contact, of_tree(step, trees[k]), dy)
    else:
        for k in range(len(trees)):
            _articulate(contact, of_tree(step, trees[k]))
            place_loops(step.scene.loops, bases_at(None, step), of_tree(step, trees[k]))
        place_joined(joined, step.scene.loops, bases_at(None, step), step)
        act_joined(joined, contact, step)
        for k in range(len(trees)):
            _accelerate(of_tree(step, trees[k]), dy)


@inline
def _rates(contact, step, dy):
    """Find the accelerations of one tree; contact None: no row of contacts is taken into account."""
    _articulate(contact, step)
    place_loops(step.scene.loops, bases_at(None, step), step)
    act_alone(contact, step)
    _accelerate(step, dy)


@inline
def _articulate(contact, step):
    speeds = step.y[step.offsets.qd : step.offsets.qd + joint_count(step.scene.trees, step.scene.tree)]
    external_forces(step.scene.push, step.scene.lifts, step.scene.propellers, step, speeds)
    articulate(_armature(step.scene.friction, step), contact, step)


@inline
def _accelerate(step, dy):
    """Do the second pass, and fill the rates of one tree."""
    scene, part, y, offsets = step.scene, step.part, step.y, step.offsets
    n, (first, end) = joint_count(scene.trees, scene.tree), joints_of(part, scene.tree)
    bq, bv = base_of(scene.floating, part, y, offsets.base_q, 7), base_of(scene.floating, part, y, offsets.base_qd, 6)
    v, a = y[offsets.qd : offsets.qd + n], y[offsets.qdd : offsets.qdd + n]
    acceleration_pass(scene.tree, part, step.W, a)
    fluid_powers(scene.fluid, step, dy)
    _propeller_powers(scene.propellers, step, v, dy)
    _friction_of_acceleration(scene.friction, step, dy)
    for i in range(first, end):
        dy[offsets.q + i] = v[i]
        dy[offsets.qd + i] = a[i]
    ball_rates(scene.balls, part, y[offsets.ball_q :], v, dy[offsets.ball_q :])
    _base_rates(bq, bv, step, dy)


@inline
def _propeller_powers(propellers, step, v, dy):
    if propellers is not None:
        at = step.offsets.fluid_work + WORKS * base_index(step.part) + PROPULSION
        dy[at] = 0.0 * v[0]
        add_work(propellers, v, v, 1.0, 0.0, step, dy, at)


@inline
def _base_rates(bq, bv, step, dy):
    """Set dx/dt = v, dquaternion/dt = 1/2 quaternion omega."""
    if bq is not None:
        part, (root, _), base = step.part, rows_of(step.part, step.scene.tree), base_index(step.part)
        a = base_of(True, part, step.y, step.offsets.base_qdd, 6)
        position, speed = step.offsets.base_q + 7 * base, step.offsets.base_qd + 6 * base
        base_acceleration(root, a, step.W)
        for k in range(3):
            dy[position + k] = bv[k]
        quaternion_rate(bq, bv, dy[position + 3 : position + 7])
        for k in range(6):
            dy[speed + k] = a[k]


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
    first, end = joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        share = step.Z[CJ, i] * item_or_zero(step.scene.armature, i) * step.y[step.offsets.qdd + i]
        dy[step.offsets.energy + ENERGIES * i + LOSS] -= share * step.y[step.offsets.qd + i]
