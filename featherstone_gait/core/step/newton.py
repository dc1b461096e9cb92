"""One linearly implicit step, its stiff part folded into the articulated-body algorithm.

The velocity at the end of the substep h' = theta h (theta = 1: Euler, 1/2: midpoint) satisfies

    M (v - v*) / h' = T(v),    v* = what the bias forces alone would give,

where T collects servo, friction, springs of joints, stops and contacts.  Each of them is the gradient of a convex
function of v with the sign reversed (a force that never rises with speed), so the solution is the minimum of a convex
function, found by a semi-smooth Newton iteration: linearize T about the iterate, solve

    (M + h' C) a = T(v_k) + C (v_k - v_p) - bias(v_p),    v = v_p + h' a,    C = -dT/dv,

which is one ABA with D_i enlarged by h' C_i and each contact's h' J' C J added to its own link's inertia.  Motor
current and rotor are eliminated before (a scalar Schur complement a joint).  Without clipping the first pass is exact.
When a pass overshoots, a line search along it restores descent: the inertial force M (v - v*)/h' is linear in v and
equals the linear model's T at each solution, so its value along the line costs nothing.

v_p is the velocity for which the bias is taken: that of the start (Euler), or extrapolated with the last step's
acceleration (midpoint), which makes the step second order with one evaluation.

Joints that follow others confine v to a subspace, and loops to one beside it (J v is given), in which the function is
as convex.  Each pass ends in it, so that forces of couplings and loops do no work along a pass: neither its slope nor
what is compared knows them.
"""

from ..compile.by_type import overridable
from ..compile.jit import inline, kernel
from ..compile.lanes import any_lane, select
from ..compile.optional import any_present, if_present, item_or_zero, only_if, plus_item, slice_if
from ..compile.taped import begin_external, constant, noting, pass_external, tape_of, value_of
from ..effects.actuator import actuator_force, rotor_of
from ..effects.ball_spring import place_ball_springs, plus_ball_spring
from ..effects.contact import (
    FLOOR,
    compare_contacts,
    contact_slope,
    fold_contacts,
    linearize_contacts,
    place_contacts,
    shift_contacts,
    shifted,
    solved_contacts,
)
from ..effects.drag import plus_drag
from ..effects.fluid import (
    compare_fluid,
    fluid_slope,
    fold_fluid,
    linearize_fluid,
    place_fluid,
    shift_fluid,
    solved_fluid,
)
from ..effects.friction import ROUNDING, STEEPEST, direction, friction_torque, snap_to_rest
from ..effects.gear_friction import GearFriction, gear_friction, stribeck
from ..effects.joint_spring import plus_spring
from ..effects.propeller import add_propellers, plus_propeller
from ..effects.push import add_pushes
from ..effects.stop import stop_torque
from ..effects.tendon import (
    compare_tendons,
    linearize_tendons,
    place_tendons,
    shift_tendons,
    solved_tendons,
    tendon_slope,
)
from ..tree.aba import acceleration_pass, articulated_pass
from ..tree.ball import ball_positions, last_balls, move_balls
from ..tree.forest import base_count, base_index, base_of, joint_count, joints_of
from ..tree.joint import accelerate
from ..tree.kinematics import motion_pass, move_base
from ..tree.layout import UU, Motion, U
from ..tree.residual import residual
from ..tree.spatial import load3
from .closure import place_loops
from .row_solver import act_alone

MAX_PASSES = 40
BISECTIONS = 16

# Rows of the scratch `Z`, one column a joint.
VP = 0  # velocity for which the bias is taken
VK = 1  # velocity about which the forces are linearized
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
STRIBECK = 19  # of gear_friction.py: what is left at VP of what falls with the speed
DRIVE = 20  # what drives a gear, where its forces were last asked for, and its friction
RUB = 21
ANGLE = 22  # rotation vectors of ball joints with springs
SCRATCH = 23


@inline
def solve_step(step):
    """Find the solution of the step: accelerations in its y, velocities VN, WN, UN in its scratch; W is filled.

    A lane that has converged repeats its last pass to the same bits while its neighbors go on.
    """
    predict(step.predicted, rotor_of(step.actuator), step)
    place_contacts(step.scene.contact, step.predicted, step)
    place_tendons_at(step)
    place_fluid(step.scene.fluid, step.predicted, step)
    external_forces(step.scene.push, step.scene.lifts, step.scene.propellers, step, step.Z[VP])
    forces = any_present(any_present(acting(step), step.tau), step.scene.contact)
    find_velocities(forces, rotor_of(step.actuator), step.scene.contact, step)


@inline
def place_tendons_at(step):
    """Fill lengths and speeds of tendons at the predicted state."""
    q, ball_q = step.y[step.offsets.q :], _balls_at(step.predicted, step)
    bases, ahead = bases_at(step.predicted, step), lookahead(step.predicted, step.h_implicit)
    place_tendons(step.scene.tendons, step, q, ball_q, bases, step.Z[VP], ahead)


@inline
def _balls_at(predicted, step):
    """Return the quaternions of ball joints at the predicted state, None without ball joints."""
    if predicted is None:
        return ball_positions(step.scene.balls, step.y, step.offsets.ball_q)
    return last_balls(step.scene.balls, predicted)


@inline
def lookahead(predicted, h):
    """Return how long after the step's start the poses are those of W [s]."""
    if predicted is None:
        return 0.0
    return h


@inline
def external_forces(push, lifts, propellers, step, speeds):
    """Fill F (n + 1, 6) with pushes, lifts and thrusts, as [moment; force] about the common origin, if there are any.

    speeds (n,): of the joints, for propellers.

    It is the sum of all external forces on the bodies that are not folded into the step.
    """
    if push is not None or lifts is not None or propellers is not None:
        for i in range(len(step.F)):
            for k in range(6):
                step.F[i, k] = 0.0
    if push is not None:
        add_pushes(push, step.t, step.span, step.W, step.F)
    if lifts is not None:
        add_pushes(lifts, step.t, step.span, step.W, step.F)
    if propellers is not None:
        add_propellers(propellers, speeds, step.W, step.F)


@inline
def acting(step):
    """Return True, None where only gravity, bias forces and torques from outside act on the joints."""
    springs = any_present(step.scene.joint_springs, any_present(step.scene.stiffening, step.scene.ball_springs))
    own = any_present(step.scene.stops, any_present(springs, step.scene.tendons))
    around = any_present(step.scene.fluid, step.scene.propellers)
    losses = any_present(step.scene.friction, step.scene.drag)
    return any_present(step.actuator, any_present(losses, any_present(own, around)))


@inline
def find_velocities(forces, rotor, contact, step):
    """Iterate by Newton's method, or solve one ABA where no force depends on the velocity sought."""
    if forces is None:
        _solve_free(step.scene.armature, step.predicted, step)
        return
    _iterate(noting(step.y), rotor, contact, step)


@inline
def _iterate(noted, rotor, contact, step):
    """Iterate; for gradients, whose scratch holds a solution, take one pass from there (taped.py).

    The derivative of a solution is that of the linear system that it solves with the iterate held.
    """
    if noted is not None:
        fraction = 1.0 + 0.0 * step.Z[VP, 0]
        move_iterate(rotor, contact, step, fraction, fraction > 0.0)
        linearize(rotor, step)
        linearize_contacts(contact, step)
        prepare(step.scene.armature, step.predicted, step)
        _note_accelerations(is_coupled(step.scene), any_present(contact, step.scene.fluid), step)
        fill_solution(rotor, step)
        ask_again(step.scene.friction, rotor, step)
        return
    y, offsets, Z = step.y, step.offsets, step.Z
    active = Z[VP, 0] == Z[VP, 0]  # false for a lane that is not finite
    for k in range(MAX_PASSES):
        linearize(rotor, step)
        linearize_contacts(contact, step)
        _solve_linear(step.scene.armature, step.predicted, rotor, step)
        wrong, rising = compare(rotor, contact, step)
        y[offsets.newton_iterations] = select(active, y[offsets.newton_iterations] + 1.0, y[offsets.newton_iterations])
        active = active & wrong
        if not any_lane(active) or k == MAX_PASSES - 1:  # the forces asked for last are those at the solution
            break
        fraction = 1.0 + 0.0 * Z[VP, 0]
        if k > 0 and any_lane(active & (rising > 0.0)):
            fraction = _line_search(rotor, contact, step, rising)
        move_iterate(rotor, contact, step, fraction, active)
    y[offsets.newton_iterations + 1] = select(
        active, y[offsets.newton_iterations + 1] + 1.0, y[offsets.newton_iterations + 1]
    )


@inline
def is_coupled(scene):
    """Return True, None for one robot that nothing couples but its joints."""
    return any_present(any_present(scene.trees, scene.coupling), any_present(scene.loops, scene.tendons))


@inline
def factor_again(step):
    """Leave the factors of a step's linear system at the solution, which the iterate becomes."""
    contact, rotor = step.scene.contact, rotor_of(step.actuator)
    move_iterate(rotor, contact, step, 1.0, True)
    linearize(rotor, step)
    linearize_contacts(contact, step)
    prepare(step.scene.armature, step.predicted, step)
    articulate(step.Z[DIAGONAL], contact, step)


@inline
def _note_accelerations(coupled, contact, step):
    """Fill DA by both passes, or about the solution that the scratch holds: by the residual (tree/residual.py)."""
    if coupled is not None:
        accelerations(step.Z[DIAGONAL], step.scene.contact, step, step.Z[DA])
    else:
        wrench = any_present(any_present(step.scene.push, step.scene.lifts), step.scene.propellers)
        _note_residual(step.scene.floating, contact, only_if(wrench, step.F), step)


@kernel
def _note_residual(floating, contact, wrench, step):
    tree, Z, W, n = step.scene.tree, step.Z, step.W, len(step.scene.tree) - 1
    moment, force = residual(tree, None, Z[TAU], Z[DIAGONAL], wrench, contact, Z[DA], W)
    count = n + count_of_base(floating)
    tape = tape_of(step.y)
    at = begin_external(tape, count)
    for i in range(1, n + 1):
        j = tree[i].dof
        Z[DA, j] = pass_external(tape, at, count, j, W[i, UU], value_of(Z[DA, j]))
    if floating is not None:
        for k in range(3):
            W[0, U + k] = pass_external(tape, at, count, n + k, moment[k], value_of(W[0, U + k]))
            W[0, U + 3 + k] = pass_external(tape, at, count, n + 3 + k, force[k], value_of(W[0, U + 3 + k]))
    for i in range(1, n + 1):
        b = tree[i]
        accelerate(b, i, load3(W, b.parent, U), load3(W, b.parent, U + 3), Z[DA, b.dof], W, W, U)


@if_present(0)
def count_of_base(floating):
    """Return how many accelerations a base has."""
    return 6


@overridable
def ask_again(friction, rotor, step):
    """Leave what is left by the forces of joints that were asked for last, at the solution."""


@ask_again.of(GearFriction)
def _ask_gears(friction, rotor, step):
    Z, (first, end) = step.Z, joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        joint_force(friction, step, i, Z[VN, i], rotor_speed(rotor, Z, WN, i, 0.0))


# ---------------------------------------------------------------------------------------------- the predicted state


@kernel
def predict(predicted, rotor, step):
    """Fill W and Z with poses, velocities and bias at the predicted state; the iteration starts there."""
    scene, part, y, offsets, Z = step.scene, step.part, step.y, step.offsets, step.Z
    n, (first, end) = joint_count(scene.trees, scene.tree), joints_of(part, scene.tree)
    bq, bv = base_of(scene.floating, part, y, offsets.base_q, 7), base_of(scene.floating, part, y, offsets.base_qd, 6)
    q, v = y[offsets.q : offsets.q + n], y[offsets.qd : offsets.qd + n]
    if predicted is None:
        ball_q = ball_positions(scene.balls, y, offsets.ball_q)
        motion_pass(scene.tree, part, scene.gravity, Motion(bq, bv, None, q, v, None, ball_q), step.W)
        for i in range(first, end):
            Z[VP, i] = v[i]
    else:
        a = y[offsets.qdd : offsets.qdd + n]
        for i in range(first, end):
            predicted[n + i] = v[i] + step.h_implicit * a[i]
            predicted[i] = q[i] + step.h_implicit * predicted[n + i]
            Z[VP, i] = predicted[n + i]
        ba, speeds = base_of(scene.floating, part, y, offsets.base_qdd, 6), 2 * n + 7 * base_count(scene.trees)
        at = base_index(part)
        _predict_base(bq, bv, ba, predicted, 2 * n + 7 * at, speeds + 6 * at, step.h_implicit)
        bq = base_of(scene.floating, part, predicted, 2 * n, 7)
        bv = base_of(scene.floating, part, predicted, speeds, 6)
        ball_q = last_balls(scene.balls, predicted)
        move_balls(scene.balls, part, y[offsets.ball_q :], predicted[n : 2 * n], step.h_implicit, ball_q)
        motion = Motion(bq, bv, ba, predicted[:n], predicted[n : 2 * n], a, ball_q)
        motion_pass(scene.tree, part, scene.gravity, motion, step.W)
    place_loops(scene.loops, bases_at(predicted, step), step)
    ahead = lookahead(predicted, step.h_implicit)
    place_ball_springs(scene.ball_springs, scene.balls, part, ball_q, Z[VP], ahead, Z[ANGLE])
    for i in range(first, end):
        Z[VK, i] = Z[VP, i]
        if rotor is not None:
            Z[WK, i] = y[offsets.rotor_speed + i]
    _begin_friction(scene.friction, step)


@inline
def bases_at(predicted, step):
    """Return the positions of all bases (7 bases,) of which W holds the poses; None if none has any."""
    scene = step.scene
    if predicted is None:
        return slice_if(scene.floating, step.y, step.offsets.base_q, 7 * base_count(scene.trees))
    return slice_if(scene.floating, predicted, 2 * joint_count(scene.trees, scene.tree), 7 * base_count(scene.trees))


@overridable
def _begin_friction(friction, step):
    """Store what friction takes at the predicted speeds."""


@_begin_friction.of(GearFriction)
def _fill_stribeck(friction, step):
    first, end = joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        step.Z[STRIBECK, i] = stribeck(friction.table[i], step.Z[VP, i])


@inline
def _predict_base(bq, bv, ba, predicted, position, speed, h_implicit):
    """Fill position (7,) and velocity (6,) of a base, which start at these indices of `predicted`."""
    if bq is not None:
        for k in range(6):
            predicted[speed + k] = bv[k] + h_implicit * ba[k]
        move_base(bq, predicted[speed : speed + 6], h_implicit, predicted[position : position + 7])


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


# ---------------------------------------------------------------------------------------------- one linear system


@inline
def _solve_free(armature, predicted, step):
    """Solve for bodies on which nothing acts; Z[TAU] is zero to begin with."""
    Z, (first, end) = step.Z, joints_of(step.part, step.scene.tree)
    if armature is not None and predicted is not None:
        for i in range(first, end):
            Z[TAU, i] = -armature[i] * step.y[step.offsets.qdd + i]
    accelerations(armature, None, step, Z[DA])
    for i in range(first, end):
        Z[VN, i] = Z[VP, i] + step.h_implicit * Z[DA, i]
    step.y[step.offsets.newton_iterations] = step.y[step.offsets.newton_iterations] + 1.0


@inline
def accelerations(diagonal, contact, step, qdd):
    """Fill qdd (n,) by the two passes of the ABA that follow `motion_pass`; diagonal (n,) enlarges D."""
    articulate(diagonal, contact, step)
    act_alone(any_present(contact, step.scene.fluid), step)
    acceleration_pass(step.scene.tree, step.part, step.W, qdd)


@inline
def articulate(diagonal, contact, step):
    """Do the first of these passes; contact None leaves contact rows out of account."""
    scene, part = step.scene, step.part
    base_q = base_of(scene.floating, part, step.y, step.offsets.base_q, 7)
    wrench = only_if(any_present(any_present(scene.push, scene.lifts), scene.propellers), step.F)
    contact = any_present(contact, scene.fluid)
    articulated_pass(scene.tree, part, base_q, None, step.Z[TAU], diagonal, wrench, contact, step.W)


@kernel
def linearize(rotor, step):
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
    linearize_tendons(step.scene.tendons, step)
    linearize_fluid(step.scene.fluid, step)


@kernel
def _solve_linear(armature, predicted, rotor, step):
    """Solve the linear model by one ABA; fill velocities and the model's forces at its solution."""
    prepare(armature, predicted, step)
    accelerations(step.Z[DIAGONAL], step.scene.contact, step, step.Z[DA])
    fill_solution(rotor, step)


@inline
def prepare(armature, predicted, step):
    """Fill the torques and the diagonal that the linear model gives the ABA, and the contact rows of the bodies."""
    Z, (first, end) = step.Z, joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        Z[TAU, i] = Z[T0, i] - Z[CJ, i] * Z[VP, i]
        Z[DIAGONAL, i] = step.h_implicit * Z[CJ, i]
        if armature is not None:
            Z[DIAGONAL, i] = Z[DIAGONAL, i] + armature[i]
            if predicted is not None:
                Z[TAU, i] = Z[TAU, i] - armature[i] * step.y[step.offsets.qdd + i]
    fold_contacts(step.scene.contact, step, step.h_implicit)
    fold_fluid(step.scene.fluid, step, step.h_implicit)


@inline
def fill_solution(rotor, step):
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
    solved_contacts(step.scene.contact, step)
    solved_tendons(step.scene.tendons, step, Z[DA])
    solved_fluid(step.scene.fluid, step)


# ---------------------------------------------------------------------------------------------- convergence


@kernel
def compare(rotor, contact, step):
    """Return where the forces at the solution differ from the linear model's, and the slope of the descent there."""
    Z, (first, end) = step.Z, joints_of(step.part, step.scene.tree)
    slope = 0.0 * Z[VN, 0]
    wrong = slope > 1.0
    for i in range(first, end):
        v, w = Z[VN, i], rotor_speed(rotor, Z, WN, i, 0.0)
        T, F, _, _, _, _ = joint_force(step.scene.friction, step, i, v, w)
        least = FLOOR + select(Z[CJ, i] > STEEPEST, ROUNDING * (Z[CJ, i] * abs(v)), 0.0 * v)
        wrong = wrong | (abs(T - Z[TL, i]) > step.tolerance * (abs(T) + abs(Z[TL, i])) + least)
        slope = slope + (v - Z[VK, i]) * (Z[TL, i] - T)
        if rotor is not None:
            wrong = wrong | (abs(F - Z[FLW, i]) > step.tolerance * (abs(T) + abs(Z[TL, i])) + FLOOR)
            slope = slope + (w - Z[WK, i]) * (Z[FLW, i] - F)
    wrong, slope = compare_tendons(step.scene.tendons, step, wrong, slope)
    wrong, slope = compare_fluid(step.scene.fluid, step, wrong, slope)
    return compare_contacts(contact, step, wrong, slope)


@kernel
def _line_search(rotor, contact, step, rising):
    """Return where the descent along the pass ends, by bisection, in the lanes in which it rises at the end."""
    low = 0.0 * rising
    high = 1.0 + 0.0 * rising
    for _ in range(BISECTIONS):
        fraction = 0.5 * (low + high)
        up = descent_slope(rotor, contact, step, fraction) > 0.0
        low, high = select(up, low, fraction), select(up, fraction, high)
    return select(rising > 0.0, 0.5 * (low + high), 1.0 + 0.0 * rising)


@kernel
def descent_slope(rotor, contact, step, fraction):
    """Return the slope of the convex function at a fraction of the pass: inertial less applied force."""
    Z, slope, (first, end) = step.Z, 0.0 * fraction, joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        p = Z[VN, i] - Z[VK, i]
        pw = rotor_speed(rotor, Z, WN, i, 0.0) - rotor_speed(rotor, Z, WK, i, 0.0)
        w = rotor_speed(rotor, Z, WK, i, 0.0) + fraction * pw
        T, F, _, _, _, _ = joint_force(step.scene.friction, step, i, Z[VK, i] + fraction * p, w)
        slope = slope + p * (Z[RT, i] + fraction * (Z[TL, i] - Z[RT, i]) - T)
        if rotor is not None:
            slope = slope + pw * (Z[RW, i] + fraction * (Z[FLW, i] - Z[RW, i]) - F)
    slope = tendon_slope(step.scene.tendons, step, fraction, slope)
    return contact_slope(contact, step, fraction, fluid_slope(step.scene.fluid, step, fraction, slope))


@kernel
def move_iterate(rotor, contact, step, fraction, active):
    """Move the iterate by a fraction of the pass, in the lanes still at work."""
    Z, (first, end) = step.Z, joints_of(step.part, step.scene.tree)
    for i in range(first, end):
        here = Z[VK, i]
        _shift(Z, VK, VN, i, fraction, active)
        v = snap_to_rest(step.scene.friction, step, i, Z[VK, i], here, Z[VN, i])
        Z[VK, i] = constant(select(active & (fraction < 1.0), v, Z[VK, i]))
        _shift(Z, RT, TL, i, fraction, active)
        if rotor is not None:
            _shift(Z, WK, WN, i, fraction, active)
            _shift(Z, RW, FLW, i, fraction, active)
    shift_contacts(contact, step, fraction, active)
    shift_tendons(step.scene.tendons, step, fraction, active)
    shift_fluid(step.scene.fluid, step, fraction, active)


@inline
def _shift(Z, at, to, i, fraction, active):
    Z[at, i] = shifted(Z[at, i], Z[to, i], fraction, active)
