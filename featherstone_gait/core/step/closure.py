"""Loops in a step: accelerations that keep them closed, and what a step leaves open closed again.

The accelerations of `core/tree/loop.py` leave gaps as small as the error of a step.  `project` takes these away after
each step, by moves M^-1 J' f with J M^-1 J' f = -gap; of velocities J qd takes the place of the gap.  Any positive
definite M will do: that of the step's last accelerations is factored already, with what the step has folded into it.
Gaps and speeds are found anew after each move, until nothing is left.

Of several trees each is closed by itself, unless loops join trees: then all are closed together.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import apart, entry, inline, kernel
from ..compile.lanes import any_lane, select
from ..compile.optional import if_present, item, slice_if
from ..compile.structure import structure
from ..effects.tendon import lines_of
from ..tree.aba import articulated_pass, constrain
from ..tree.ball import ball_positions, move_balls
from ..tree.forest import (
    balls_of,
    base_count,
    base_index,
    base_of,
    is_fixed,
    joint_count,
    joints_of,
    loops_of,
    rows_of,
)
from ..tree.kinematics import base_acceleration, motion_pass, move_base, velocity_pass
from ..tree.layout import Motion
from ..tree.loop import (
    BIAS,
    GAP,
    IN_STEP,
    ON,
    PLACE,
    SPEED,
    close,
    fill_loops,
    keep_factors,
    move_by,
    release_loops,
    solve_rows,
    span_rows,
    take_place,
)

MOVES = 12  # at most
SMALL = 1e-10  # gap [m or rad], and speed of it by the fastest coordinate, of which one move leaves rounding
CLOSED = 1e-9  # what counts as closed
NOTHING = 1e-12  # gap [m or rad] so small that velocities need not wait until it is closed


@structure
class Loops(NamedTuple):
    """The loops of a scene: those of each tree, one tree after the other, then those that join trees."""

    table: np.ndarray  # (loops,) LOOP
    parts: np.ndarray  # (trees,) TREE of each
    rows: np.ndarray  # (1,) number of rows, for the size of `Closing`
    joined: bool | None = None  # True where loops join trees, None where none does


@structure
class Closing(NamedTuple):
    """Scratch arrays of loops."""

    rows: np.ndarray  # (m, SIZE)
    responses: np.ndarray  # (m, sides, bodies of the largest tree)
    roots: np.ndarray  # (m, sides, SIDE)
    matrix: np.ndarray  # (m, m + 2)
    cross: np.ndarray | None  # (3 points, m) of points between bodies and rows, None without pairs
    force: np.ndarray  # (m,) [N or N m]
    push: np.ndarray  # (m,) the same of a move
    factors: np.ndarray  # (bodies, 6) columns U of the factors in which the forces were found
    move: np.ndarray  # (n + 6,) of joints and base
    moved: np.ndarray  # (7 + 4 balls,) coordinates of base and ball joints after it
    listed: np.ndarray  # (2, m) rows of a system, and their loops

    SHARED = ("listed",)


@inline
def place_loops(loops, bases, step):
    """Fill the rows of a tree's loops at the poses and velocities of W, and of the accelerations there.

    loops None: none; bases: positions of all bases, None where none has any.
    """
    if loops is not None:
        span = loops_of(loops.parts[base_index(step.part)])
        held = held_in(loops, step.offsets, step.y)
        fill_loops(loops.table, span, held, step.scene.gravity, bases, step.W, step.closing.rows)


@inline
def close_loops(loops, contact, step):
    """Keep a tree's loops closed: call it between the two passes of the ABA, whose first had `contact`."""
    if loops is not None:
        number = base_index(step.part)
        span = loops_of(loops.parts[number])
        if span[1] > span[0]:
            _close((number, number + 1), span, loops, contact, step)


@apart
def _close(which, span, loops, contact, step):
    """Keep the loops of a span closed, of the trees `which`, first and end; their factors are those of moves."""
    scene, work, lines = step.scene, step.closing, lines_of(step.scene.tendons)
    scratch = step.W, work.responses, work.roots, work.matrix, work.listed
    close(scene, loops.parts, span, contact, loops.table, lines, IN_STEP, work.rows, scratch, work.force)
    release_loops(lines, scene.tree, loops.parts, loops.table, span, step.W, work.responses, work.roots)
    for k in range(which[0], which[1]):
        keep_factors(loops.parts[k], scene.tree, step.W, work.factors)
    first, end = span_rows(loops.table, span)
    for r in range(first, end):
        step.y[step.offsets.loop_force + r] = work.force[r]


@if_present()
def joined_by(loops):
    """Return True where loops join trees, None where none does or there are none."""
    return loops.joined


@if_present()
def close_joined(joined, loops, contact, step):
    """Keep the loops of all trees closed where some join trees; call it between the two passes of all."""
    count, number = len(loops.table), len(loops.parts)
    held, scene = held_in(loops, step.offsets, step.y), step.scene
    bases = slice_if(scene.floating, step.y, step.offsets.base_q, 7 * number)
    fill_loops(loops.table, (0, count), held, scene.gravity, bases, step.W, step.closing.rows)
    _close((0, number), (0, count), loops, contact, step)


@inline
def held_in(loops, offsets, y):
    """Return which loops are closed in a state, and their places."""
    count, closed, place = len(loops.table), offsets.loop_closed, offsets.loop_place
    return y[closed : closed + count], y[place : place + PLACE * count]


# ---------------------------------------------------------------------------------------------- sets of trees


@inline
def _sets(joined, trees):
    """Return how many sets of trees are closed by themselves."""
    if trees is None:
        return 1
    if joined is not None:
        return 1
    return len(trees)


@inline
def _set(joined, loops, trees, n):
    """Return the trees of the n-th set and their loops, each as the first and the one after the last."""
    if trees is None:
        return (0, 1), (0, len(loops.table))
    if joined is not None:
        return (0, len(trees)), (0, len(loops.table))
    return (n, n + 1), loops_of(trees[n])


@if_present()
def factor_at(loops, scene, offsets, scratch, y):
    """Fill the factors in which `project` moves, at the state y; scratch: W and Closing."""
    for n in range(_sets(loops.joined, scene.trees)):
        which, span = _set(loops.joined, loops, scene.trees, n)
        if span[1] > span[0]:
            _move_bodies(which, scene, offsets, y, scratch[0])
            _fill(span, loops, scene, offsets, scratch, y)
            _factor(which, span, loops, scene, offsets, scratch, y)


@kernel
def _move_bodies(which, scene, offsets, y, W):
    """Fill poses, velocities and accelerations of the bodies of trees at the state y."""
    n, ball_q = joint_count(scene.trees, scene.tree), ball_positions(scene.balls, y, offsets.ball_q)
    q, v = y[offsets.q : offsets.q + n], y[offsets.qd : offsets.qd + n]
    for k in range(which[0], which[1]):
        part = item(scene.trees, k)
        bq = base_of(scene.floating, part, y, offsets.base_q, 7)
        bv = base_of(scene.floating, part, y, offsets.base_qd, 6)
        motion_pass(scene.tree, part, scene.gravity, Motion(bq, bv, None, q, v, None, ball_q), W)


@inline
def _fill(span, loops, scene, offsets, scratch, y):
    """Fill the rows of a span of loops at the state y, whose bodies stand and move in W."""
    W, work = scratch
    bases = slice_if(scene.floating, y, offsets.base_q, 7 * base_count(scene.trees))
    fill_loops(loops.table, span, held_in(loops, offsets, y), scene.gravity, bases, W, work.rows)


@apart
def _factor(which, span, loops, scene, offsets, scratch, y):
    """Fill the factors of trees whose bodies stand in W."""
    n, (W, work) = joint_count(scene.trees, scene.tree), scratch
    for i in range(n):
        work.move[i] = 0.0 * y[offsets.status]
    for k in range(which[0], which[1]):
        part = item(scene.trees, k)
        bq = base_of(scene.floating, part, y, offsets.base_q, 7)
        articulated_pass(scene.tree, part, bq, None, work.move, scene.armature, None, None, W)
        constrain(scene.coupling, part, bq, None, scene.tree, W)
    found = W, work.responses, work.roots, work.matrix, work.listed
    close(scene, loops.parts, span, None, loops.table, None, IN_STEP, work.rows, found, work.push)
    for k in range(which[0], which[1]):
        keep_factors(loops.parts[k], scene.tree, W, work.factors)


# ---------------------------------------------------------------------------------------------- at the end of a step


@if_present()
def project(loops, scene, offsets, scratch, y):
    """Close what a step has left open in y, in the factors of its last accelerations."""
    for n in range(_sets(loops.joined, scene.trees)):
        which, span = _set(loops.joined, loops, scene.trees, n)
        if span[1] > span[0]:
            _factor_again(scene.pairs, which, span, loops, scene, offsets, (scratch.W, scratch.closing), y)
            _project(which, span, loops, scene, offsets, (scratch.W, scratch.closing), y)


@if_present()
def project_euler(loops, scene, offsets, scratch, h, y):
    """Close what a step of Euler's has left open in y, in factors that are found there.

    Velocities that were moved along the loops' forces of its beginning alone would gain (h w)^2 / 2 a step where a loop
    turns at the rate w, and along those of its end alone lose as much; so the acceleration that bends the path acts for
    half of the step before they are moved along those of its end.
    """
    work = scratch.W, scratch.closing
    for n in range(_sets(loops.joined, scene.trees)):
        which, span = _set(loops.joined, loops, scene.trees, n)
        if span[1] > span[0]:
            _factor_again(scene.pairs, which, span, loops, scene, offsets, work, y)
            _factor_again(scene.fluid, which, span, loops, scene, offsets, work, y)  # as at the end: without added mass
            _unbend(which, span, loops, scene, offsets, work, h, y)
            _move_bodies(which, scene, offsets, y, scratch.W)
            _fill(span, loops, scene, offsets, work, y)
            _factor(which, span, loops, scene, offsets, work, y)
            _project(which, span, loops, scene, offsets, work, y)


@if_present()
def _factor_again(other, which, span, loops, scene, offsets, scratch, y):
    """Fill the factors of the poses in W, where loops have been solved in others, with pairs or in a fluid."""
    _factor(which, span, loops, scene, offsets, scratch, y)


@kernel
def _unbend(which, span, loops, scene, offsets, scratch, h, y):
    """Take half of the velocity back that the loops' bias has given in a step h."""
    work, (first, end) = scratch[1], span_rows(loops.table, span)
    for r in range(first, end):
        work.push[r] = -0.5 * h * work.rows[r, BIAS]
    _solve(span, loops, work)
    _speed_up(which, span, loops, scene, offsets, scratch, 0.0 * y[offsets.status] == 0.0, y)


@apart
def _project(which, span, loops, scene, offsets, scratch, y):
    """Move positions and velocities; count a step whose loops stay open as one that has not converged.

    Both are moved at the poses in which the gaps are found, and again where these change the loops' directions by more
    than rounding.  In lanes what is closed in one is not moved any more.
    """
    _fill_at(which, span, loops, scene, offsets, scratch, y)
    work, always, fast = scratch[1], 0.0 * y[offsets.status] == 0.0, _fastest(which, scene, offsets, y)
    gap, speed = _largest(GAP, span, loops, work), _largest(SPEED, span, loops, work)
    _take(GAP, span, loops, work)
    _move(which, span, loops, scene, offsets, scratch, always, y)
    _take(SPEED, span, loops, work)
    _speed_up(which, span, loops, scene, offsets, scratch, always, y)
    again, at_work = (gap > NOTHING) | (speed > SMALL * fast), gap > SMALL
    for _ in range(1, MOVES):
        if not any_lane(at_work):
            break
        _fill_at(which, span, loops, scene, offsets, scratch, y)
        before, gap = gap, select(at_work, _largest(GAP, span, loops, work), gap)
        _take(GAP, span, loops, work)
        _move(which, span, loops, scene, offsets, scratch, at_work, y)
        at_work = at_work & (gap > SMALL) & (gap < 0.5 * before)
    at_work = again
    for k in range(1, MOVES):
        if not any_lane(at_work):
            break
        _fill_at(which, span, loops, scene, offsets, scratch, y)
        before, speed = speed, select(at_work, _largest(SPEED, span, loops, work), speed)
        _take(SPEED, span, loops, work)
        _speed_up(which, span, loops, scene, offsets, scratch, at_work, y)
        at_work = at_work & (speed > SMALL * fast) & ((speed < 0.5 * before) | (k == 1))
    missed, at = (gap > CLOSED) | (speed > CLOSED * fast), offsets.newton_iterations + 1
    y[at] = select(missed, y[at] + 1.0, y[at])


@apart
def _fill_at(which, span, loops, scene, offsets, scratch, y):
    """Fill gaps and speeds of a span of loops at the state y, with poses and velocities of the bodies."""
    n, ball_q = joint_count(scene.trees, scene.tree), ball_positions(scene.balls, y, offsets.ball_q)
    q, v = y[offsets.q : offsets.q + n], y[offsets.qd : offsets.qd + n]
    for k in range(which[0], which[1]):
        part = item(scene.trees, k)
        bq = base_of(scene.floating, part, y, offsets.base_q, 7)
        bv = base_of(scene.floating, part, y, offsets.base_qd, 6)
        velocity_pass(scene.tree, part, Motion(bq, bv, None, q, v, None, ball_q), scratch[0])
    _fill(span, loops, scene, offsets, scratch, y)


@inline
def _largest(column, span, loops, work):
    first, end = span_rows(loops.table, span)
    largest = 0.0 * work.rows[first, column]
    for r in range(first, end):
        size = abs(work.rows[r, column])
        largest = select((size > largest) & (work.rows[r, ON] > 0.0), size, largest)
    return largest


@inline
def _fastest(which, scene, offsets, y):
    """Return the speed of the fastest coordinate of trees, 1 at least."""
    fast = 1.0 + 0.0 * y[offsets.status]
    for k in range(which[0], which[1]):
        part = item(scene.trees, k)
        fast = _faster(base_of(scene.floating, part, y, offsets.base_qd, 6), fast)
        first, end = joints_of(part, scene.tree)
        for i in range(offsets.qd + first, offsets.qd + end):
            fast = select(abs(y[i]) > fast, abs(y[i]), fast)
    return fast


@inline
def _faster(bv, fast):
    if bv is not None:
        for i in range(6):
            fast = select(abs(bv[i]) > fast, abs(bv[i]), fast)
    return fast


@inline
def _take(column, span, loops, work):
    """Fill `push` with the forces of the move that closes what is open by a column of the rows."""
    first, end = span_rows(loops.table, span)
    for r in range(first, end):
        work.push[r] = work.rows[r, column]
    _solve(span, loops, work)


@inline
def _solve(span, loops, work):
    """Turn `push` into the forces of the move that changes gaps or speeds by -push."""
    first, end = span_rows(loops.table, span)
    solve_rows(work.matrix[first:end], IN_STEP, work.push[first:end])


@inline
def _respond(part, span, loops, scene, work, W):
    """Fill the move of a tree by the forces `push`."""
    scratch = work.responses, work.roots, work.factors
    move_by(part, scene.tree, loops.table, span, work.push, scratch, W, work.move)


@kernel
def _move(which, span, loops, scene, offsets, scratch, at_work, y):
    """Move the positions of trees by the forces `push`."""
    W, work = scratch
    for k in range(which[0], which[1]):
        part = item(scene.trees, k)
        _respond(loops.parts[k], span, loops, scene, work, W)
        _move_joints(part, scene, at_work, work.move, y[offsets.q :])
        _move_balls(ball_positions(scene.balls, y, offsets.ball_q), part, scene, at_work, work)
        _move_base(base_of(scene.floating, part, y, offsets.base_q, 7), part, scene, at_work, work, W)


@kernel
def _speed_up(which, span, loops, scene, offsets, scratch, at_work, y):
    """Move the velocities of trees by the forces `push`."""
    W, work = scratch
    for k in range(which[0], which[1]):
        part = item(scene.trees, k)
        _respond(loops.parts[k], span, loops, scene, work, W)
        _move_joints(part, scene, at_work, work.move, y[offsets.qd :])
        _speed_base(base_of(scene.floating, part, y, offsets.base_qd, 6), part, scene, at_work, work, W)


@inline
def _move_joints(part, scene, at_work, move, x):
    first, end = joints_of(part, scene.tree)
    for i in range(first, end):
        x[i] = select(at_work, x[i] + move[i], x[i])


@inline
def _move_balls(ball_q, part, scene, at_work, work):
    if ball_q is not None:
        moved, (first, end) = work.moved[7:], balls_of(part, scene.balls)
        move_balls(scene.balls, part, ball_q, work.move, 1.0, moved)
        for k in range(4 * first, 4 * end):
            ball_q[k] = select(at_work, moved[k], ball_q[k])


@inline
def _move_base(bq, part, scene, at_work, work, W):
    if bq is not None:
        if is_fixed(part):
            return
        change, (root, _) = work.move[len(work.move) - 6 :], rows_of(part, scene.tree)
        base_acceleration(root, change, W)
        move_base(bq, change, 1.0, work.moved)
        for k in range(7):
            bq[k] = select(at_work, work.moved[k], bq[k])


@inline
def _speed_base(bv, part, scene, at_work, work, W):
    if bv is not None:
        if is_fixed(part):
            return
        change, (root, _) = work.move[len(work.move) - 6 :], rows_of(part, scene.tree)
        base_acceleration(root, change, W)
        for k in range(6):
            bv[k] = select(at_work, bv[k] + change[k], bv[k])


# ---------------------------------------------------------------------------------------------- between steps


@entry
def make_loop(c, loops, scene, places, scratch, y):
    """Close loop c of a state y where it is; the impulse is plastic, and what it takes is added to `loop_loss`.

    places (1,) STATE; scratch: W and Closing.
    """
    offsets, (W, work) = places[0], scratch
    for n in range(_sets(loops.joined, scene.trees)):
        which, span = _set(loops.joined, loops, scene.trees, n)
        if span[0] <= c < span[1]:
            _move_bodies(which, scene, offsets, y, W)
            closed, at = held_in(loops, offsets, y)
            bases = slice_if(scene.floating, y, offsets.base_q, 7 * base_count(scene.trees))
            take_place(loops.table, c, bases, W, at)
            closed[c] = 1.0
            _fill(span, loops, scene, offsets, scratch, y)
            _factor(which, span, loops, scene, offsets, scratch, y)
            _take(SPEED, span, loops, work)
            first, end = span_rows(loops.table, span)
            for r in range(first, end):
                y[offsets.loop_loss + c] -= 0.5 * work.push[r] * work.rows[r, SPEED]
            always = y[offsets.status] == y[offsets.status]
            _speed_up(which, span, loops, scene, offsets, scratch, always, y)
            _project(which, span, loops, scene, offsets, scratch, y)


@entry
def measure_loops(loops, scene, places, scratch, y):
    """Fill the rows of all loops at a state y; places (1,) STATE; scratch: W and Closing."""
    _move_bodies((0, base_count(scene.trees)), scene, places[0], y, scratch[0])
    _fill((0, len(loops.table)), loops, scene, places[0], scratch, y)
