"""The linearly implicit step: solve it, then move the state on, sum energies, measure chatter."""

from ..compile.by_type import overridable
from ..compile.jit import inline
from ..compile.lanes import select
from ..compile.optional import any_present, plus_item
from ..compile.taped import unless_noted
from ..effects.actuator import controller_of, move_actuator, rotor_of
from ..effects.controller import filter_speed
from ..effects.drag import move_drag
from ..effects.energies import ENERGIES, WORK
from ..effects.energies import FRICTION as LOSS
from ..effects.fluid import PROPULSION, WORKS
from ..effects.friction import move_friction
from ..effects.gear_friction import GearFriction
from ..effects.joint import DA, DRIVE, RUB, VN, VP, WN, joint_force, plus_springs, rotor_speed, with_predicted
from ..effects.pair import move_pairs
from ..effects.propeller import add_work, plus_propeller
from ..effects.stop import move_stop
from ..tree.ball import move_balls
from ..tree.forest import base_index, base_of, is_fixed, joints_of, rows_of
from ..tree.kinematics import base_acceleration, move_base
from .context import of_tree
from .newton import acting, move_all, solve_islands, solve_step

CHATTER_WINDOW = 64.0  # steps over which changes of velocity are averaged


@inline
def step_trees(step):
    """Take a linearly implicit step of all trees."""
    solve_trees(step.scene.trees, step.scene.pairs, step)
    advance_trees(step.scene.trees, step)


@inline
def solve_trees(trees, pairs, step):
    """Solve the step of each tree; trees (trees,) TREE, None for the only one; pairs None where nothing touches."""
    if trees is None:
        solve_step(step)
    elif pairs is not None:
        solve_islands(pairs, step)
    else:
        for k in range(len(trees)):
            solve_step(of_tree(step, trees[k]))


@inline
def advance_trees(trees, step):
    """Move the state of each tree over its solved step."""
    if trees is None:
        advance(step)
    else:
        move_pairs(step.scene.pairs, step)
        for k in range(len(trees)):
            advance(of_tree(step, trees[k]))


@inline
def advance(step):
    """Move the state over the step that `solve_step` has solved."""
    y, offsets, (first, end) = step.y, step.offsets, joints_of(step.part, step.scene.tree)
    move_all(step)
    _propellers_work(step.scene.propellers, step)
    for i in range(first, end):
        v = step.Z[VN, i]
        w = rotor_speed(rotor_of(step.actuator), step.Z, WN, i, v)
        _joint_energies(any_present(acting(step), step.tau), step, i, v, w)
        move_actuator(step.actuator, step, i, v, w)
    for i in range(first, end):
        a = with_predicted(step.predicted, step.Z[DA, i], y[offsets.qdd + i])
        dv = step.h * a
        _watch(unless_noted(y, acting(step)), offsets, y, i, dv)
        y[offsets.qdd + i] = a
        y[offsets.q + i] += step.h * step.Z[VN, i]
        y[offsets.qd + i] += dv
        filter_speed(controller_of(step.actuator), step, i)
    ball_q = y[offsets.ball_q :]
    move_balls(step.scene.balls, step.part, ball_q, step.Z[VN], step.h, ball_q)
    _advance_base(step.scene.floating, step)


@inline
def _propellers_work(propellers, step):
    if propellers is not None:
        at = step.offsets.fluid_work + WORKS * base_index(step.part) + PROPULSION
        add_work(propellers, step.Z[VP], step.Z[VN], step.h, step.h_implicit, step, step.y, at)


@inline
def _advance_base(floating, step):
    """Move the position with the velocity v + h_implicit a, then the velocity to its end."""
    if floating is not None:
        if is_fixed(step.part):
            return
        y, offsets, part, (root, _) = step.y, step.offsets, step.part, rows_of(step.part, step.scene.tree)
        a, v = base_of(True, part, y, offsets.base_qdd, 6), base_of(True, part, y, offsets.base_qd, 6)
        x = base_of(True, part, y, offsets.base_q, 7)
        last = (a[0], a[1], a[2], a[3], a[4], a[5])
        base_acceleration(root, a, step.W)
        for k in range(6):
            a[k] = with_predicted(step.predicted, a[k], last[k])
            v[k] += step.h_implicit * a[k]
        move_base(x, v, step.h, x)
        for k in range(6):
            v[k] += (step.h - step.h_implicit) * a[k]


@inline
def _joint_energies(forces, step, i, v, w):
    """Add energies of friction and stops and the work on the joint, at the velocities that the step used."""
    if forces is None:
        return
    T = _driving(step.scene.friction, step, i, v, w)
    step.y[step.offsets.torque + i] = T
    step.y[step.offsets.energy + ENERGIES * i + WORK] += step.h * (T * v)


@overridable
def _driving(friction, step, i, v, w):
    """Return what drives the joint [N m], and add the energies of friction and stops."""
    Tf = move_drag(step.scene.drag, step, i, v, move_friction(friction, step, i, v))
    Ts = move_stop(step.scene.stops, step, i, v)
    T, _, _, _, _, _ = joint_force(friction, step, i, v, w)
    others, _ = plus_springs(step, i, v, Tf + Ts, 0.0)
    others, _ = plus_propeller(step.scene.propellers, i, v, others, 0.0)
    return T - others


@_driving.of(GearFriction)
def _by_the_gear(friction, step, i, v, w):
    T, Tf = step.Z[DRIVE, i], step.Z[RUB, i]
    step.y[step.offsets.energy + ENERGIES * i + LOSS] -= step.h * (Tf * v)
    move_drag(step.scene.drag, step, i, v, Tf)
    move_stop(step.scene.stops, step, i, v)
    return plus_item(T, step.tau, i)


@inline
def _watch(forces, offsets, y, i, dv):
    """Average how far a change of velocity undoes the one before, less how far it continues it.

    Motion that the step resolves goes on; a step beyond the stability limit of an explicit method alternates, if there
    is a damper or a spring to make it.
    """
    if forces is None:
        return
    last = y[offsets.velocity_change + i]
    size = select(abs(dv) < abs(last), abs(dv), abs(last))
    mean = y[offsets.chatter + i]
    mean = mean + (select(dv * last < 0.0, size, -size) - mean) * (1.0 / CHATTER_WINDOW)
    y[offsets.velocity_change + i] = dv
    y[offsets.chatter + i] = mean
    y[offsets.worst_chatter + i] = select(mean > y[offsets.worst_chatter + i], mean, y[offsets.worst_chatter + i])
