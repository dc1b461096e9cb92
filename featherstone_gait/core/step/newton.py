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

from ..compile.each import for_each
from ..compile.jit import apart, inline, kernel
from ..compile.lanes import any_lane, select
from ..compile.optional import any_present, if_present, only_if
from ..compile.taped import begin_external, noting, pass_external, tape_of, value_of
from ..effects import element
from ..effects.actuator import rotor_of
from ..effects.ball_spring import place_ball_springs
from ..effects.contact import Moments
from ..effects.element import AT_WORK, FRACTION, RISES, SLOPE, WRONG
from ..effects.joint import ANGLE, DA, DIAGONAL, TAU, VN, VP, ask_again, joints
from ..effects.pair import place_pairs
from ..effects.predicted import bases_at, lookahead
from ..effects.propeller import add_propellers
from ..effects.push import add_pushes
from ..tree.aba import acceleration_pass, articulated_pass
from ..tree.ball import ball_positions, last_balls, move_balls
from ..tree.forest import base_count, base_index, base_of, joint_count, joints_of
from ..tree.joint import accelerate
from ..tree.kinematics import motion_pass, move_base
from ..tree.layout import UU, Motion, U
from ..tree.residual import residual
from ..tree.spatial import load3
from .closure import joined_by, place_joined, place_loops
from .context import of_tree, with_bodies
from .island import (
    descend_points,
    each_tree,
    find_islands,
    fold_points,
    shift_points,
    solve_points,
    tree_number,
    trees_of,
)
from .row_solver import act_alone, act_together

# What a step has of each kind of elements of a tree: see effects/element.py.
KINDS = (
    "joints(step)",
    "step.scene.contact",
    "Moments(step.scene.contact.rolling)",
    "step.scene.tendons",
    "step.scene.fluid",
)
place_all, linearize_all, fold_all, solve_all, shift_all, rest_all, move_all, rates_all = (
    for_each(function, KINDS, joints=joints, Moments=Moments)
    for function in (
        element.place, element.linearize, element.fold, element.solve, element.shift, element.rest, element.move,
        element.rates,
    )
)  # fmt: skip
descend_all = for_each(element.descend, KINDS, ("wrong", "slope"), joints=joints, Moments=Moments)

MAX_PASSES = 40
BISECTIONS = 16


@inline
def solve_step(step):
    """Find the solution of the step: accelerations in its y, velocities VN, WN, UN in its scratch; W is filled.

    A lane that has converged repeats its last pass to the same bits while its neighbors go on.
    """
    predict(step.predicted, step)
    external_forces(step.scene.push, step.scene.lifts, step.scene.propellers, step, step.Z[VP])
    find_velocities(_forces(step), None, step)


@kernel
def solve_islands(pairs, step):
    """Solve the step of all trees, those together that touch.

    Trees that touch nothing of each other are iterated each for itself, as if they were alone, and without the
    workspace rows of pairs.
    """
    scene, pool, trees = step.scene, step.pool, step.scene.trees
    for k in range(len(trees)):
        predict(step.predicted, of_tree(step, trees[k]))
    external_forces(scene.push, scene.lifts, scene.propellers, step, step.Z[VP])
    place_joined(joined_by(scene.loops), scene.loops, bases_at(step.predicted, step), step)
    if any_lane(step.y[step.offsets.pair] > 0.0) or _join(scene.loops):
        place_pairs(pairs, step.predicted, step, lookahead(step.predicted, step.h_implicit))
        find_islands(pairs, step)
    else:
        _each_alone(pool, len(trees))
    alone = with_bodies(step, pairs.bodies)
    for n in range(pool.count[1]):
        if pool.first_point[n + 1] > pool.first_point[n] or _join(scene.loops):
            _solve_island(n, step)
        else:
            find_velocities(_forces(step), None, of_tree(alone, trees[pool.trees[pool.first_tree[n]]]))


@if_present(False)
def _join(loops):
    """Return whether loops join trees."""
    return loops.joined is not None


@inline
def _each_alone(pool, count):
    """Make an island of each tree where the pool holds no pair."""
    pool.count[0], pool.count[1], pool.count[2] = 0, count, 0
    for k in range(count):
        pool.island[k], pool.trees[k], pool.first_tree[k], pool.first_point[k] = k, k, k, 0
    pool.first_tree[count], pool.first_point[count] = count, 0


@apart
def _solve_island(n, step):
    find_velocities(True, n, step)


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
def _forces(step):
    """Return True, None where no force depends on the velocity sought."""
    return any_present(any_present(acting(step), step.tau), step.scene.contact)


@inline
def find_velocities(forces, island, step):
    """Iterate by Newton's method, or solve one ABA where there are no `forces` that depend on the velocity sought.

    island : int or None
        Number of the island whose trees are solved together; None: the step's tree alone.
    """
    if forces is None:
        _solve_free(step.scene.armature, step.predicted, step)
        return
    _iterate(noting(step.y), island, step)


# ---------------------------------------------------------------------------------------------- Newton's iteration


@inline
def _iterate(noted, island, step):
    """Iterate; for gradients, whose scratch holds a solution, take one pass from there (taped.py).

    The derivative of a solution is that of the linear system that it solves with the iterate held.
    """
    _begin(island, step)
    if noted is not None:
        _move_on(island, step)
        _note(is_coupled(step.scene), island, step)
        _ask_again(island, step)
        return
    for k in range(MAX_PASSES):
        _pass(island, step)
        _descend(island, None, step)
        if not _goes_on(island, step) or k == MAX_PASSES - 1:  # the forces asked for last are those at the solution
            break
        _choose_fraction(k > 0, island, step)
        _move_on(island, step)
    _count_failures(island, step)


@each_tree
@inline
def _begin(step):
    """Set a tree to work, but in lanes that are not finite."""
    Z, N, t, zero = step.Z, step.N, base_index(step.part), 0.0 * step.y[step.offsets.newton_iterations]
    N[t, AT_WORK], N[t, FRACTION] = select(Z[VP, 0] == Z[VP, 0], 1.0 + zero, zero), 1.0 + zero


@kernel
def _pass(island, step):
    """Linearize all forces and solve; fill velocities and the linear model's forces at its solution."""
    _prepare(island, step)
    if island is None:
        articulate(step.Z[DIAGONAL], step.scene.contact, step)
        act_alone(any_present(step.scene.contact, step.scene.fluid), step)
        _finish(island, step)
    else:
        fold_points(island, step.scene.pairs, step)
        _articulate_together(island, step)
        act_together(island, step.scene.pairs, step)
        _finish(island, step)
        solve_points(island, step.scene.pairs, step)


@each_tree
@inline
def _prepare(step):
    linearize_all(step)
    fold_all(step)


@each_tree
@inline
def _articulate_together(step):
    articulate(step.Z[DIAGONAL], True, step)


@each_tree
@inline
def _finish(step):
    acceleration_pass(step.scene.tree, step.part, step.W, step.Z[DA])
    solve_all(step)


@kernel
def _descend(island, searching, step):
    """Fill where the forces at the solution are not the linear model's, and the slope of the descent there.

    searching : bool or None
        True: the slope at each tree's FRACTION of the pass, and nothing else.
    """
    if searching is None:
        _compare(island, step)
    else:
        _find_slope(island, step)
    if island is not None:
        descend_points(island, searching, step.scene.pairs, step)


@each_tree
@inline
def _compare(step):
    N, t, zero = step.N, base_index(step.part), 0.0 * step.y[step.offsets.newton_iterations]
    wrong, N[t, SLOPE] = descend_all(None, step, zero > 1.0, zero)
    N[t, WRONG] = select(wrong, 1.0 + zero, zero)


@each_tree
@inline
def _find_slope(step):
    N, t = step.N, base_index(step.part)
    zero = 0.0 * N[t, FRACTION]
    _, N[t, SLOPE] = descend_all(N[t, FRACTION], step, zero > 1.0, zero)


@inline
def _goes_on(island, step):
    """Count the pass; return whether another one follows."""
    y, N, counter, (first, end) = step.y, step.N, step.offsets.newton_iterations, trees_of(island, step)
    going, zero = False, 0.0 * y[counter]
    for i in range(first, end):
        t = tree_number(island, step, i)
        at_work = N[t, AT_WORK]
        y[counter] = select(at_work > 0.0, y[counter] + 1.0, y[counter])
        at_work = select(N[t, WRONG] > 0.0, at_work, zero)
        going = going | any_lane(at_work > 0.0)
        N[t, AT_WORK] = at_work
    return going


@kernel
def _choose_fraction(searches, island, step):
    """Let the iterate move by the whole pass; if it `searches`, only as far as the descent goes."""
    N, (first, end), rising = step.N, trees_of(island, step), False
    for i in range(first, end):
        t = tree_number(island, step, i)
        rising = rising | any_lane((N[t, AT_WORK] > 0.0) & (N[t, SLOPE] > 0.0))
        N[t, FRACTION] = 1.0 + 0.0 * N[t, AT_WORK]
    if searches and rising:
        _search(island, step)


@kernel
def _search(island, step):
    """Fill the fraction of the pass at which the descent of each tree ends, by bisection, where it rises at the end."""
    N, (first, end), size = step.N, trees_of(island, step), 1.0
    for i in range(first, end):
        t = tree_number(island, step, i)
        zero = 0.0 * N[t, AT_WORK]
        N[t, RISES], N[t, FRACTION] = select(N[t, SLOPE] > 0.0, 1.0 + zero, zero), zero
    for _ in range(BISECTIONS):
        size = 0.5 * size
        for i in range(first, end):
            t = tree_number(island, step, i)
            N[t, FRACTION] = N[t, FRACTION] + size
        _descend(island, True, step)
        for i in range(first, end):
            t = tree_number(island, step, i)
            N[t, FRACTION] = select(N[t, SLOPE] > 0.0, N[t, FRACTION] - size, N[t, FRACTION])
    for i in range(first, end):
        t = tree_number(island, step, i)
        found = N[t, FRACTION] + 0.5 * size
        N[t, FRACTION] = select(N[t, RISES] > 0.0, found, 1.0 + 0.0 * found)


@kernel
def _move_on(island, step):
    """Move the iterate of each tree, in the lanes still at work."""
    _shift(island, step)
    if island is not None:
        shift_points(island, step.scene.pairs, step)


@each_tree
@inline
def _shift(step):
    shift_all(step)


@inline
def _count_failures(island, step):
    y, failures, (first, end) = step.y, step.offsets.newton_iterations + 1, trees_of(island, step)
    for i in range(first, end):
        failed = step.N[tree_number(island, step, i), AT_WORK] > 0.0
        y[failures] = select(failed, y[failures] + 1.0, y[failures])


# ---------------------------------------------------------------------------------------------- for gradients


@inline
def _note(coupled, island, step):
    """Take the pass that is differentiated: by both passes of the ABA, or by the residual (tree/residual.py)."""
    if coupled is not None:
        _pass(island, step)
    else:
        linearize_all(step)
        fold_all(step)
        contact, scene = any_present(step.scene.contact, step.scene.fluid), step.scene
        wrench = any_present(any_present(scene.push, scene.lifts), scene.propellers)
        _note_residual(scene.floating, contact, only_if(wrench, step.F), step)
        solve_all(step)


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


@each_tree
@inline
def _ask_again(step):
    ask_again(step.scene.friction, rotor_of(step.actuator), step)


@inline
def is_coupled(scene):
    """Return True, None for one robot that nothing couples but its joints."""
    return any_present(any_present(scene.trees, scene.coupling), any_present(scene.loops, scene.tendons))


@inline
def factor_again(step):
    """Leave the factors of a step's linear system at the solution, which the iterate becomes."""
    _begin(None, step)
    _move_on(None, step)
    linearize_all(step)
    fold_all(step)
    articulate(step.Z[DIAGONAL], step.scene.contact, step)


# ---------------------------------------------------------------------------------------------- the predicted state


@kernel
def predict(predicted, step):
    """Fill W and Z with poses, velocities and bias at the predicted state, and place all elements there."""
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
    place_all(step)


@inline
def _predict_base(bq, bv, ba, predicted, position, speed, h_implicit):
    """Fill position (7,) and velocity (6,) of a base, which start at these indices of `predicted`."""
    if bq is not None:
        for k in range(6):
            predicted[speed + k] = bv[k] + h_implicit * ba[k]
        move_base(bq, predicted[speed : speed + 6], h_implicit, predicted[position : position + 7])


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
