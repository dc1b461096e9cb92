"""Tendons and springs between bodies: a force along a length that joints and points of bodies make.

The length is a sum of joint positions times coefficients, or of the distances of points that follow each other on a
path.  Along it act a spring with a dead band, a damper, stops of stop.py at the limits, a drive with the law of
pd_servo.py, and dry friction as in friction.py,

    f = -K (l - upper) above the band, -K (l - lower) below, nothing within; -C dl/dt; stops; drive; friction,

positive where it lengthens.  With J = dl/dq the torques on the joints are J' f.  An implicit step takes the force at
its end, where the length is l + h J v, with J of the state for which the bias is taken; the slope h (K h + C) joins the
mass matrix as that of a row beside the fold (core/tree/rows.py), so that no tendon limits the step.  Euler's method
takes springs at the start of the step as long as their own period allows it, like those of joints (joint_spring.py).

An inertia m along the length, such as that of a rotor that it turns, has the kinetic energy m (dl/dt)^2 / 2.  It joins
the mass matrix in the same row, m J' J beside the slope, and takes the force -m d2l/dt2 of the accelerations that the
step begins with: m Jdot qd, and m J a of those that the midpoint rule predicts.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import inline, kernel
from ..compile.lanes import select, sign_beyond, sqrt
from ..compile.optional import any_present, if_present, item, plus_item
from ..compile.structure import record, structure
from ..shapes.wrap import own_frame, way_around
from ..tree.forest import LARGEST, base_index, joint_count, rows_of, tendons_of
from ..tree.layout import A, P, R, U, V
from ..tree.rigid_body import point_position
from ..tree.rows import (
    FIRST,
    KIND,
    ROW,
    SOURCE,
    TIED,
    TREE,
    add_block,
    answer_base,
    clear_block,
    entry_of,
    push_body,
    push_joint,
)
from ..tree.spatial import (
    add,
    choose,
    compose,
    cross,
    dot,
    load3,
    load9,
    rotate,
    rotate_back,
    scale,
    store3,
    sub,
    vector,
)
from . import element
from .ball_spring import rotation_vector
from .element import FLOOR
from .friction import ROUNDING, STEEP, STEEPEST, direction_from, snapped_from, stops_at_once
from .joint import DA, VP
from .pd_servo import PD, pd_branch, pd_torque
from .predicted import balls_at, bases_at, lookahead
from .stop import stop_branch, stop_torque

TENDON = record(
    first=int,  # of its parts
    end=int,
    row=int,  # of the workspace
    offset=float,  # of the length: what joints that are held give [m or rad]
    stiffness=float,  # K [N/m or N m/rad]
    lower=float,  # dead band of the spring [m or rad]
    upper=float,
    damping=float,  # C [N s/m or N m s/rad]
    fold=float,  # 1 = the spring is taken at the end of the step, 0 = at its start
)

DRIVE = record(
    input=int,  # column of references and of torques from outside, -1 without a drive
    **{name: kind for name, (kind, _) in (PD.fields or {}).items()},
)

PART = record(
    kind=int,  # JOINT ...
    body=int,  # row of the body; WORLD for the world of a floating base
    dof=int,  # index of a joint's coordinate, of a ball joint's first; of a WRAP
    coefficient=float,  # of a joint [m/rad or -], or of the distance from the point before [-]
    point=(float, 3),  # body frame, or world [m]
)
WORLD = -1
# A path begins with a point that has no distance.  TURN: of a ball joint; BEND: a shape between two points.
JOINT, BEGIN, POINT, TURN, BEND = range(5)

# Numbers of the channel `tendon_work`: work on the robot [J].
SPRING, DAMPER, STOPS, PULL, RUB = range(5)
WORKS = 5

# Columns of a tendon's row in the workspace.
LB = 0  # length from which it moves on with the speed [m or rad]
U0 = 1  # speed for which the bias is taken [m/s or rad/s]
UK = 2  # speed about which the force is linearized
UN = 3  # speed of the solution
TL = 4  # the linear model's force there
RT = 5  # inertial force at UK
T0 = 6  # linear model of the force: T0 - CT u
CT = 7
AXIS = 8  # 3: about which the ball joint of a tendon is turned, of which it has one at most
BASE = AXIS  # 3: of a path, where the base of its tree is [m]
RISE = 11  # d2l/dt2 of the accelerations that the step begins with [m/s^2 or rad/s^2]
US = 12  # speed at the start of the step


@structure
class Tendons(NamedTuple):
    """The tendons of a scene, and after them its springs between bodies."""

    table: np.ndarray  # (tendons,) TENDON
    parts: np.ndarray  # (parts,) PART
    stops: np.ndarray | None  # (tendons,) STOP; None where no tendon has limits
    drives: np.ndarray | None = None  # (tendons,) DRIVE; None where no tendon has a drive
    wraps: np.ndarray | None = None  # (shapes,) WRAP; None where no tendon runs around any
    tied: np.ndarray | None = None  # (tendons,) 1 of those with an end in the world of a floating base; None without
    friction: np.ndarray | None = None  # (tendons,) FRICTION; None where no tendon has dry friction
    armature: np.ndarray | None = None  # (tendons,) inertia along the length [kg or kg m^2]; None without


# ---------------------------------------------------------------------------------------------- the length


@inline
def _position(tied, row, p, W):
    """Return the point of a part [m], counted from the base like all positions in W."""
    if tied is None:
        return point_position(p.body, vector(p.point), W)
    return _position_from(row, p, W)


@inline
def _position_from(row, p, W):
    zero = 0.0 * W[0, P]
    x = (p.point[0] + zero, p.point[1] + zero, p.point[2] + zero)
    if p.body == WORLD:
        x = sub(x, load3(W, row, BASE))
    else:
        x = point_position(p.body, vector(p.point), W)
    return x


@inline
def _apart(tied, row, a, b, W):
    """Return the points of two parts [m], and what `_direction` does."""
    x, y = _position(tied, row, a, W), _position(tied, row, b, W)
    length, e = _direction(x, y)
    return x, y, length, e


@inline
def _direction(x, y):
    """Return the distance of two points and the direction from one to the other, 0 where they meet."""
    d = sub(y, x)
    length = sqrt(dot(d, d))
    apart = length > 0.0
    return length, scale(d, select(apart, 1.0 / select(apart, length, 1.0 + 0.0 * length), 0.0 * length))


@inline
def _moved(tied, body, x, column, W):
    """Return the velocity of a point x of a body by the motion of bodies that stands in six columns of W."""
    if tied is None:
        return add(load3(W, body, column + 3), cross(load3(W, body, column), x))
    return _moved_or_still(body, x, column, W)


@inline
def _moved_or_still(body, x, column, W):
    v = scale(x, 0.0)
    if body != WORLD:
        v = add(load3(W, body, column + 3), cross(load3(W, body, column), x))
    return v


@inline
def _opening(tied, wraps, parts, row, k, column, W):
    """Return the distance of a point from the one before, and its rate by the motion that stands in columns of W."""
    if wraps is None:
        return _straight_opening(tied, parts, row, k, column, W)
    return _bent_opening(tied, wraps, parts, row, k, column, W)


@inline
def _straight_opening(tied, parts, row, k, column, W):
    a, b = parts[k - 1], parts[k]
    x, y, length, e = _apart(tied, row, a, b, W)
    return length, dot(e, sub(_moved(tied, b.body, y, column, W), _moved(tied, a.body, x, column, W)))


@kernel
def _bent_opening(tied, wraps, parts, row, k, column, W):
    if parts[k - 1].kind != BEND:
        return _straight_opening(tied, parts, row, k, column, W)
    x, u, v, y, e, f, length, turns = _way(tied, wraps, parts, row, k, W)
    rate = dot(f, _moved(tied, parts[k].body, y, column, W)) - dot(e, _moved(tied, parts[k - 2].body, x, column, W))
    body = parts[k - 1].body
    around = dot(e, _moved(tied, body, u, column, W)) - dot(f, _moved(tied, body, v, column, W))
    return length, rate + turns * around


@inline
def _axes(tied, body, own, W):
    """Return the rotation of a frame `own` of a body, common frame."""
    if tied is None:
        return compose(load9(W, body, R), own)
    return _axes_or_own(body, own, W)


@inline
def _axes_or_own(body, own, W):
    zero = 0.0 * W[0, P]
    E = (own[0] + zero, own[1] + zero, own[2] + zero, own[3] + zero, own[4] + zero, own[5] + zero, own[6] + zero,
         own[7] + zero, own[8] + zero)  # fmt: skip
    if body != WORLD:
        E = compose(load9(W, body, R), own)
    return E


@kernel
def _way(tied, wraps, parts, row, k, W):
    """Return the points of the way around a shape to the point k, its directions at both ends, and its length.

    Last is 1 if it turns, else 0: then it is straight, and the points between mean nothing.
    """
    bend = parts[k - 1]
    wrap = wraps[bend.dof]
    x, y = _position(tied, row, parts[k - 2], W), _position(tied, row, parts[k], W)
    c, E = _position(tied, row, bend, W), _axes(tied, bend.body, own_frame(wrap), W)
    turns, u, v, arc = way_around(wrap, rotate_back(E, sub(x, c)), rotate_back(E, sub(y, c)))
    u, v = add(c, rotate(E, u)), add(c, rotate(E, v))
    straight, g = _direction(x, y)
    first, e = _direction(x, u)
    last, f = _direction(v, y)
    one = select(turns, 1.0 + 0.0 * arc, 0.0 * arc)
    return x, u, v, y, choose(turns, e, g), choose(turns, f, g), select(turns, first + arc + last, straight), one


@inline
def _place_base(tied, c, row, bases, step):
    """Store where the base of the tree is, if the tendon c is tied to the world."""
    if tied is not None:
        if tied[c] > 0:
            at = 7 * base_index(step.part)
            store3(step.W, row, BASE, (bases[at], bases[at + 1], bases[at + 2]))


@element.place.of(Tendons)
def _place_tendons(tendons, step):
    _place_at(step.predicted, tendons, step.Z[VP], step)


@inline
def _place_at(predicted, tendons, v, step):
    """Fill lengths and speeds of a tree's tendons, whose joints have the speeds v, at the predicted state."""
    q, ahead = step.y[step.offsets.q :], lookahead(predicted, step.h_implicit)
    _place(balls_at(predicted, step), bases_at(predicted, step), tendons, step, q, v, ahead)


@inline
def _turned(ball_q, tree, p, row, W):
    """Return the angle of a ball joint [rad], and store the axis about which it is turned."""
    if ball_q is None:
        return 0.0 * W[row, LB]
    x = rotation_vector(ball_q, 4 * tree[p.body].ball)
    size = sqrt(dot(x, x))
    store3(W, row, AXIS, scale(x, 1.0 / select(size > 0.0, size, 1.0 + 0.0 * size)))
    return size


@inline
def _about(W, row, dof, rates):
    """Return the rate of a ball joint's angle."""
    return dot(load3(W, row, AXIS), (rates[dof], rates[dof + 1], rates[dof + 2]))


@kernel
def _place(ball_q, bases, tendons, step, q, v, ahead):
    """Do so; q are the positions of joints at the start, W is that of a time `ahead` later [s]."""
    W, (first, end) = step.W, tendons_of(step.part, tendons.table)
    for c in range(first, end):
        t = tendons.table[c]
        length, speed = t.offset + 0.0 * W[0, V], 0.0 * W[0, V]
        _place_base(tendons.tied, c, t.row, bases, step)
        for k in range(t.first, t.end):
            p = tendons.parts[k]
            if p.kind == JOINT:
                length, speed = length + p.coefficient * q[p.dof], speed + p.coefficient * v[p.dof]
            elif p.kind == TURN:
                turned = _turned(ball_q, step.scene.tree, p, t.row, W)
                rate = _about(W, t.row, p.dof, v)
                length = length + p.coefficient * (turned - ahead * rate)
                speed = speed + p.coefficient * rate
            elif p.kind == POINT:
                distance, rate = _opening(tendons.tied, tendons.wraps, tendons.parts, t.row, k, V, W)
                length = length + p.coefficient * (distance - ahead * rate)
                speed = speed + p.coefficient * rate
        W[t.row, LB], W[t.row, U0], W[t.row, UK] = length, speed, speed
        _place_rise(any_present(tendons.friction, tendons.armature), step.predicted, tendons, t, step)


@inline
def _place_rise(needed, predicted, tendons, t, step):
    """Store how a length accelerates by the accelerations of W, and its speed at the start; a limit of a ball not."""
    if needed is not None:
        W, rise = step.W, 0.0 * step.W[t.row, U0]
        for k in range(t.first, t.end):
            p = tendons.parts[k]
            if p.kind == JOINT:
                rise = rise + p.coefficient * _expected(predicted, step, p.dof)
            elif p.kind == POINT:
                rise = rise + p.coefficient * _widening(tendons.tied, tendons.wraps, tendons.parts, t.row, k, step)
        W[t.row, RISE] = rise
        W[t.row, US] = _before(predicted, W[t.row, U0], rise, step.h_implicit)


@inline
def _expected(predicted, step, dof):
    """Return the acceleration of a joint with which the step begins."""
    if predicted is None:
        return 0.0
    return step.y[step.offsets.qdd + dof]


@inline
def _before(predicted, u, rise, h):
    if predicted is None:
        return u
    return u - h * rise


@inline
def _widening(tied, wraps, parts, row, k, step):
    """Return d2/dt2 of the distance of a point from the one before; around a shape without the turning of its ends."""
    if wraps is None:
        return _straight_widening(tied, parts, row, k, step)
    return _bent_widening(tied, wraps, parts, row, k, step)


@inline
def _straight_widening(tied, parts, row, k, step):
    W, a, b = step.W, parts[k - 1], parts[k]
    x, y, length, e = _apart(tied, row, a, b, W)
    v = sub(_moved(tied, b.body, y, V, W), _moved(tied, a.body, x, V, W))
    d = sub(_pushed(tied, step.scene.gravity, b.body, y, W), _pushed(tied, step.scene.gravity, a.body, x, W))
    along, apart = dot(e, v), length > 0.0
    across = dot(v, v) - along * along
    return dot(e, d) + select(apart, across / select(apart, length, 1.0 + 0.0 * length), 0.0 * length)


@kernel
def _bent_widening(tied, wraps, parts, row, k, step):
    if parts[k - 1].kind != BEND:
        return _straight_widening(tied, parts, row, k, step)
    W, g = step.W, step.scene.gravity
    x, u, v, y, e, f, _, turns = _way(tied, wraps, parts, row, k, W)
    rate = dot(f, _pushed(tied, g, parts[k].body, y, W)) - dot(e, _pushed(tied, g, parts[k - 2].body, x, W))
    body = parts[k - 1].body
    around = dot(e, _pushed(tied, g, body, u, W)) - dot(f, _pushed(tied, g, body, v, W))
    return rate + turns * around


@inline
def _pushed(tied, gravity, body, x, W):
    """Return the acceleration less gravity of a point x of a body."""
    if tied is None:
        return _pushed_body(body, x, W)
    return _pushed_or_still(gravity, body, x, W)


@inline
def _pushed_or_still(gravity, body, x, W):
    zero = 0.0 * x[0]
    a = (zero - gravity[0], zero - gravity[1], zero - gravity[2])
    if body != WORLD:
        a = _pushed_body(body, x, W)
    return a


@inline
def _pushed_body(body, x, W):
    w = load3(W, body, V)
    v = add(load3(W, body, V + 3), cross(w, x))
    return add(load3(W, body, A + 3), add(cross(load3(W, body, A), x), cross(w, v)))


@inline
def list_tendons(tendons, part, end, rows):
    """Add the tendons of a tree to the blocks of a system, and return its end."""
    if tendons is not None:
        first, last = tendons_of(part, tendons.table)
        tree = base_index(part)
        for c in range(first, last):
            end = add_block(rows, end, TIED, c, 1, (tree, tree))
    return end


@if_present()
def respond_tendons(tendons, system, contact, step):
    """Fill what unit forces along the tendons of a system leave in the factors, their first forces and slopes."""
    W, rows = step.W, step.rows
    for b in range(system[0] & LARGEST, system[1] & LARGEST):
        if rows.block[b, KIND] == TIED:
            c, r = entry_of(b, SOURCE, rows), entry_of(b, ROW, rows)
            t = tendons.table[c]
            clear_block(step.scene, b, W, rows)
            _respond(tendons, t, (b, r, 0), step)
            answer_base(step.scene, b, contact, W, rows)
            force, slope = W[t.row, T0] - W[t.row, CT] * W[t.row, U0], step.h_implicit * W[t.row, CT]
            force, slope = _with_inertia(tendons.armature, c, W, t.row, force, slope)
            rows.numbers[r, FIRST], rows.factor[r, 0] = force, sqrt(slope)


@kernel
def _respond(tendons, t, at, step):
    tree, W, rows = step.scene.tree, step.W, step.rows
    root, _ = rows_of(item(step.scene.trees, entry_of(at[0], TREE, rows)), tree)
    for k in range(t.first, t.end):
        p = tendons.parts[k]
        if p.kind == JOINT:
            push_joint(tree, root, p.body, p.coefficient, at, W, rows)
        elif p.kind == TURN:
            for j in range(3):
                push_joint(tree, root, p.body + j, p.coefficient * W[t.row, AXIS + j], at, W, rows)
        elif p.kind == POINT:
            _pull(tendons.tied, tendons.wraps, tendons.parts, k, root, t, at, step)


@inline
def _pull(tied, wraps, parts, k, root, t, at, step):
    """Add what a unit force along the way to the point k leaves."""
    if wraps is None:
        _pull_straight(tied, parts, k, root, t, at, step)
    else:
        _pull_bent(tied, wraps, parts, k, root, t, at, step)


@inline
def _pull_straight(tied, parts, k, root, t, at, step):
    a, b = parts[k - 1], parts[k]
    x, y, _, e = _apart(tied, t.row, a, b, step.W)
    f = scale(e, b.coefficient)
    _push(tied, root, b.body, cross(y, f), f, at, step)
    _push(tied, root, a.body, scale(cross(x, f), -1.0), scale(f, -1.0), at, step)


@inline
def _push(tied, root, body, m, f, at, step):
    """Add what a force f of moment m on a body leaves, unless that is the world."""
    if tied is None:
        push_body(step.scene.tree, root, body, m, f, at, step.W, step.rows)
    elif body != WORLD:
        push_body(step.scene.tree, root, body, m, f, at, step.W, step.rows)


@kernel
def _pull_bent(tied, wraps, parts, k, root, t, at, step):
    if parts[k - 1].kind != BEND:
        _pull_straight(tied, parts, k, root, t, at, step)
        return
    x, u, v, y, e, f, _, turns = _way(tied, wraps, parts, t.row, k, step.W)
    e, f = scale(e, parts[k].coefficient), scale(f, parts[k].coefficient)
    _push(tied, root, parts[k].body, cross(y, f), f, at, step)
    _push(tied, root, parts[k - 2].body, scale(cross(x, e), -1.0), scale(e, -1.0), at, step)
    m, d = scale(sub(cross(u, e), cross(v, f)), turns), scale(sub(e, f), turns)
    _push(tied, root, parts[k - 1].body, m, d, at, step)


# ---------------------------------------------------------------------------------------------- the force


@inline
def tendon_force(tendons, c, step, u):
    """Return the force [N or N m] of a tendon at the speed u, and its slope -df/du."""
    t, length = tendons.table[c], step.W[tendons.table[c].row, LB]
    spring, slope = _spring(t, length, step.h_implicit, u)
    stop, c_stop = stop_torque(tendons.stops, c, length, u, step.h_implicit)
    slope = slope + t.damping + c_stop
    f, slope = _plus_drive(tendons.drives, step, c, length, u, spring - t.damping * u + stop, slope)
    return _plus_friction(tendons.friction, step, c, t.row, u, f, slope)


@inline
def _plus_friction(friction, step, c, row, u, f, slope):
    if friction is None:
        return f, slope
    x, c_rub = direction_from(step.extrapolation_ratio, friction[c], step.W[row, US], u)
    return f - friction[c].coulomb_friction * x, slope + friction[c].coulomb_friction * c_rub


@inline
def _spring(t, length, h, u):
    """Return the force of a spring with its dead band, and its slope."""
    at = length + t.fold * h * u
    over, under, zero = at - t.upper, t.lower - at, 0.0 * u
    beyond = (over >= 0.0) | (under >= 0.0)
    spring = select(over >= 0.0, -t.stiffness * over, select(under >= 0.0, t.stiffness * under, zero))
    return spring, select(beyond, t.stiffness * (t.fold * h) + zero, zero)


@inline
def _plus_drive(drives, step, c, length, u, f, slope):
    """Return f and its slope plus those of a drive; length: at the start of the step."""
    if drives is None:
        return f, slope
    return _with_drive(drives[c], step, length, u, f, slope)


@inline
def _with_drive(d, step, length, u, f, slope):
    if d.input < 0:
        return f, slope
    pull, c_pull = pd_torque(d, step.drive[d.input, 0] - length, u, step.h_implicit)
    return plus_item(f + pull, step.tau, d.input), slope + c_pull


element.linearize.of(Tendons)(lambda tendons, step: _linearize(tendons, step))


@kernel
def _linearize(tendons, step):
    """Linearize the forces about UK."""
    W, (first, end) = step.W, tendons_of(step.part, tendons.table)
    for c in range(first, end):
        row = tendons.table[c].row
        f, slope = tendon_force(tendons, c, step, W[row, UK])
        W[row, T0], W[row, CT] = f + slope * W[row, UK], slope


@inline
def hold_tendons(tendons, W, solved):
    """Take the speeds of a solution from another workspace."""
    if tendons is not None:
        for c in range(len(tendons.table)):
            W[tendons.table[c].row, UN] = solved[tendons.table[c].row, UN]


@inline
def _with_inertia(armature, c, W, row, force, slope):
    if armature is None:
        return force, slope
    return force - armature[c] * W[row, RISE], slope + armature[c]


# ---------------------------------------------------------------------------------------------- Newton's iteration


element.solve.of(Tendons)(lambda tendons, step: _solve(tendons, step, step.Z[DA]))


@kernel
def _solve(tendons, step, accelerations):
    """Fill speeds and the model's forces at the solution, by accelerations (n,) of joints and dA of the bodies in W."""
    W, (first, end) = step.W, tendons_of(step.part, tendons.table)
    for c in range(first, end):
        t = tendons.table[c]
        rate = 0.0 * W[t.row, U0]
        for k in range(t.first, t.end):
            p = tendons.parts[k]
            if p.kind == JOINT:
                rate = rate + p.coefficient * accelerations[p.dof]
            elif p.kind == TURN:
                rate = rate + p.coefficient * _about(W, t.row, p.dof, accelerations)
            elif p.kind == POINT:
                _, along = _opening(tendons.tied, tendons.wraps, tendons.parts, t.row, k, U, W)
                rate = rate + p.coefficient * along
        W[t.row, UN] = W[t.row, U0] + step.h_implicit * rate
        W[t.row, TL] = W[t.row, T0] - W[t.row, CT] * W[t.row, UN]


element.elements.of(Tendons)(lambda tendons, step: tendons_of(step.part, tendons.table))
element.load.of(Tendons)(lambda tendons, c, which, step: (step.W[tendons.table[c].row, UK + which],))


@element.keep.of(Tendons)
def _keep(tendons, c, which, x, step):
    step.W[tendons.table[c].row, UK + which] = x[0]


@element.force_at.of(Tendons)
def _force_at(tendons, c, u, step):
    f, _ = tendon_force(tendons, c, step, u[0])
    return (f,)


@element.differs.of(Tendons)
def _differ(tendons, c, u, f, error, step):
    W, row = step.W, tendons.table[c].row
    least = _resolved(tendons.friction, W[row, CT], u[0])
    return abs(error[0]) > step.tolerance * (abs(f[0]) + abs(W[row, TL])) + least


@inline
def _resolved(friction, slope, u):
    """Return the difference of forces that is rounding."""
    if friction is None:
        return FLOOR
    return FLOOR + select(slope > STEEPEST, ROUNDING * (slope * abs(u)), 0.0 * u)


@element.snap.of(Tendons)
def _snap(tendons, c, u, here, there, where, step):
    return (_snapped(tendons.friction, step, c, tendons.table[c].row, u[0], here[0], there[0], where),)


@inline
def _snapped(friction, step, c, row, u, here, there, where):
    """Return u or the speed of rest, as in friction.py."""
    if friction is None:
        return u
    f = friction[c]
    rest = snapped_from(step.extrapolation_ratio, (1.0 - step.theta) * step.W[row, US], u, here, there)
    return select(where & (f.coulomb_friction > 0.0) & (f.steepness > STEEP), rest, u)


element.move.of(Tendons)(lambda tendons, step: _store(tendons, step, UN, step.h, step.y))


@element.rates.of(Tendons)
def _rates(tendons, step, dy):
    """Store the forces at the speeds of the start, and set their powers in dy."""
    n = joint_count(step.scene.trees, step.scene.tree)
    _place_at(None, tendons, step.y[step.offsets.qd : step.offsets.qd + n], step)
    _linearize(tendons, step)
    first, end = tendons_of(step.part, tendons.table)
    for k in range(step.offsets.tendon_work + WORKS * first, step.offsets.tendon_work + WORKS * end):
        dy[k] = 0.0 * step.y[k]
    _store(tendons, step, U0, 1.0, dy)


@kernel
def _store(tendons, step, column, time, work):
    """Store the forces at the speeds in a column of the rows, and add what they do in a time [s] to `work`."""
    W, h, (first, end) = step.W, step.h_implicit, tendons_of(step.part, tendons.table)
    for c in range(first, end):
        t, at = tendons.table[c], step.offsets.tendon_work + WORKS * c
        length, u = W[t.row, LB], W[t.row, column]
        f, _ = tendon_force(tendons, c, step, u)
        step.y[step.offsets.tendon_force + c] = f
        spring, _ = _spring(t, length, h, u)
        stop, _ = stop_torque(tendons.stops, c, length, u, h)
        pull, _ = _plus_drive(tendons.drives, step, c, length, u, 0.0 * u, 0.0 * u)
        way = time * u
        work[at + SPRING] += spring * way
        work[at + DAMPER] -= t.damping * u * way
        work[at + STOPS] += stop * way
        rub, _ = _plus_friction(tendons.friction, step, c, t.row, u, 0.0 * u, 0.0 * u)
        work[at + PULL] += pull * way
        work[at + RUB] += rub * way


@inline
def tendon_branch(tendons, c, step, u):
    """Return a number for each way in which spring and stops of a tendon act at the speed u, 0 where none does."""
    t, length = tendons.table[c], step.W[tendons.table[c].row, LB]
    at, zero = length + t.fold * step.h_implicit * u, 0.0 * u
    side = select(at >= t.upper, 1.0 + zero, select(at <= t.lower, -1.0 + zero, zero))
    side = side * (1.0 if t.upper > t.lower else 0.0)
    side = side + 3.0 * stop_branch(tendons.stops, c, length, u, step.h_implicit)
    side = side + 27.0 * _rub_branch(tendons.friction, c, u)
    return _plus_drive_branch(tendons.drives, step, c, length, u, side)


@inline
def _rub_branch(friction, c, u):
    if friction is None:
        return 0.0
    f = friction[c]
    return select(f.coulomb_friction > 0.0, sign_beyond(f.steepness * u, 1.0), 0.0 * u)


@inline
def _plus_drive_branch(drives, step, c, length, u, side):
    if drives is None:
        return side
    d = drives[c]
    if d.input < 0:
        return side
    return side + 9.0 * pd_branch(d, step.drive[d.input, 0] - length, u, step.h_implicit)


@if_present(False)
def tendons_stop(tendons):
    """Return whether the dry friction of a tendon is steep."""
    return stops_at_once(tendons.friction)


CAUSES = ("damper of a tendon", "spring of a tendon")  # that limit explicit steps
