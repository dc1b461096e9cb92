"""Loops in a step: accelerations that keep them closed, and what a step leaves open closed again.

The accelerations of `core/tree/loop.py` leave gaps as small as the error of a step.  `project` takes these away after
each step, by moves M^-1 J' f with J M^-1 J' f = -gap; of velocities J qd takes the place of the gap.  Any positive
definite M will do: that of the step's last accelerations is factored already, with what the step has folded into it.
Gaps and speeds are found anew after each move, until nothing is left.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import entry, inline, kernel
from ..compile.lanes import any_lane, select
from ..compile.structure import structure
from ..effects.tendon import lines_of
from ..tree.aba import articulated_pass, constrain
from ..tree.ball import ball_positions, move_balls
from ..tree.forest import base_of
from ..tree.kinematics import base_acceleration, motion_pass, move_base, pose_pass
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
    solve_rows,
    take_place,
)
from ..tree.rank_one import release_rows

MOVES = 12  # at most
SMALL = 1e-10  # gap [m or rad], and speed of it by the fastest coordinate, of which one move leaves rounding
CLOSED = 1e-9  # what counts as closed


@structure
class Loops(NamedTuple):
    """The loops of a scene."""

    table: np.ndarray  # (loops,) LOOP
    part: np.ndarray  # (1,) TREE of the robot
    rows: np.ndarray  # (1,) number of rows, for the size of `Closing`


@structure
class Closing(NamedTuple):
    """Scratch arrays of loops."""

    rows: np.ndarray  # (m, SIZE)
    responses: np.ndarray  # (m, 1, n + 1)
    roots: np.ndarray  # (m, 1, SIDE)
    matrix: np.ndarray  # (m, m + 2)
    force: np.ndarray  # (m,) [N or N m]
    push: np.ndarray  # (m,) the same of a move
    factors: np.ndarray  # (n + 1, 6) columns U of the factors in which the forces were found
    move: np.ndarray  # (n + 6,) of joints and base
    moved: np.ndarray  # (7 + 4 balls,) coordinates of base and ball joints after it


@inline
def place_loops(loops, base_q, step):
    """Fill the rows of loops at the poses and velocities of W, and of the accelerations there; loops None: none."""
    if loops is not None:
        held = held_in(loops, step.offsets, step.y)
        fill_loops(loops.table, held, step.scene.gravity, base_q, step.W, step.closing.rows)


@inline
def close_loops(loops, contact, step):
    """Keep loops closed: call it between the two passes of the ABA, whose first had `contact`."""
    if loops is not None:
        scene, work = step.scene, step.closing
        scratch = work.responses, work.roots, work.matrix
        lines = lines_of(scene.tendons)
        close(scene, loops.part[0], contact, loops.table, lines, IN_STEP, step.W, work.rows, scratch, work.force)
        release_rows(lines, scene.tree, loops.part[0], len(work.rows), 0, step.W, work.responses, work.roots)
        keep_factors(loops.part[0], scene.tree, step.W, work.factors)
        for r in range(len(work.force)):
            step.y[step.offsets.loop_force + r] = work.force[r]


@inline
def held_in(loops, offsets, y):
    """Return which loops are closed in a state, and their places."""
    count, closed, place = len(loops.table), offsets.loop_closed, offsets.loop_place
    return y[closed : closed + count], y[place : place + PLACE * count]


@kernel
def factor_at(loops, scene, offsets, scratch, y):
    """Fill the factors in which `project` moves, at the state y; scratch: W and Closing."""
    n, (W, work) = len(scene.tree) - 1, scratch
    bq, bv = base_of(scene.floating, None, y, offsets.base_q, 7), base_of(scene.floating, None, y, offsets.base_qd, 6)
    q, v = y[offsets.q : offsets.q + n], y[offsets.qd : offsets.qd + n]
    ball_q = ball_positions(scene.balls, y, offsets.ball_q)
    motion_pass(scene.tree, None, scene.gravity, Motion(bq, bv, None, q, v, None, ball_q), W)
    for i in range(n):
        work.move[i] = 0.0 * y[offsets.status]
    articulated_pass(scene.tree, None, bq, None, work.move, scene.armature, None, None, W)
    constrain(scene.coupling, None, bq, None, scene.tree, W)
    fill_loops(loops.table, held_in(loops, offsets, y), scene.gravity, bq, W, work.rows)
    found = work.responses, work.roots, work.matrix
    close(scene, loops.part[0], None, loops.table, None, IN_STEP, W, work.rows, found, work.push)
    keep_factors(loops.part[0], scene.tree, W, work.factors)


@inline
def project(loops, scene, offsets, scratch, y):
    """Close what a step has left open in y, in the factors of its last accelerations."""
    if loops is not None:
        _project(loops, scene, offsets, (scratch.W, scratch.closing), y)


@inline
def project_euler(loops, scene, offsets, scratch, h, y):
    """Close what a step of Euler's has left open in y, in factors that are found there.

    Velocities that were moved along the loops' forces of its beginning alone would gain (h w)^2 / 2 a step where a loop
    turns at the rate w, and along those of its end alone lose as much; so the acceleration that bends the path acts for
    half of the step before they are moved along those of its end.
    """
    if loops is not None:
        _unbend(loops, scene, offsets, (scratch.W, scratch.closing), h, y)
        factor_at(loops, scene, offsets, (scratch.W, scratch.closing), y)
        _project(loops, scene, offsets, (scratch.W, scratch.closing), y)


@kernel
def _unbend(loops, scene, offsets, scratch, h, y):
    """Take half of the velocity back that the loops' bias has given in a step h."""
    n, (W, work) = len(scene.tree) - 1, scratch
    at_work = 0.0 * y[offsets.status] == 0.0
    for r in range(len(work.push)):
        work.push[r] = -0.5 * h * work.rows[r, BIAS]
    _respond(loops, scene, work, W)
    _move_joints(n, at_work, work.move, y[offsets.qd : offsets.qd + n])
    _speed_base(base_of(scene.floating, None, y, offsets.base_qd, 6), at_work, work, W)


@kernel
def _project(loops, scene, offsets, scratch, y):
    """Move positions and velocities; count a step whose loops stay open as one that has not converged.

    In lanes what is closed in one is not moved any more.
    """
    n, zero, (W, work) = len(scene.tree) - 1, 0.0 * y[offsets.status], scratch
    bq, q = base_of(scene.floating, None, y, offsets.base_q, 7), y[offsets.q : offsets.q + n]
    bv, v = base_of(scene.floating, None, y, offsets.base_qd, 6), y[offsets.qd : offsets.qd + n]
    ball_q, held = ball_positions(scene.balls, y, offsets.ball_q), held_in(loops, offsets, y)
    at_work, gap = zero == 0.0, zero
    for k in range(MOVES):
        pose_pass(scene.tree, None, bq, ball_q, q, W)
        fill_loops(loops.table, held, scene.gravity, bq, W, work.rows)
        before, gap = gap, select(at_work, _largest(GAP, work.rows), gap)
        _find_move(GAP, loops, scene, work, W)
        _move_joints(n, at_work, work.move, q)
        _move_balls(ball_q, scene, at_work, work)
        _move_base(bq, at_work, work, W)
        at_work = at_work & (gap > SMALL) & _closes(k, gap, before)
        if not any_lane(at_work):
            break
    fast = 1.0 + zero
    for i in range(offsets.base_qd, offsets.after_coordinates):
        fast = select(abs(y[i]) > fast, abs(y[i]), fast)
    at_work, speed = zero == 0.0, zero
    for k in range(MOVES):
        motion_pass(scene.tree, None, scene.gravity, Motion(bq, bv, None, q, v, None, ball_q), W)
        fill_loops(loops.table, held, scene.gravity, bq, W, work.rows)
        before, speed = speed, select(at_work, _largest(SPEED, work.rows), speed)
        _find_move(SPEED, loops, scene, work, W)
        _move_joints(n, at_work, work.move, v)
        _speed_base(bv, at_work, work, W)
        at_work = at_work & (speed > SMALL * fast) & _closes(k, speed, before)
        if not any_lane(at_work):
            break
    missed, at = (gap > CLOSED) | (speed > CLOSED * fast), offsets.newton_iterations + 1
    y[at] = select(missed, y[at] + 1.0, y[at])


@inline
def _largest(column, rows):
    largest = 0.0 * rows[0, column]
    for r in range(len(rows)):
        larger = (abs(rows[r, column]) > largest) & (rows[r, ON] > 0.0)
        largest = select(larger, abs(rows[r, column]), largest)
    return largest


@inline
def _closes(k, now, before):
    """Return whether the move before the k-th has brought what was open below the half."""
    if k == 0:
        return now == now
    return now < 0.5 * before


@inline
def _find_move(column, loops, scene, work, W):
    for r in range(len(work.push)):
        work.push[r] = work.rows[r, column]
    _respond(loops, scene, work, W)


@inline
def _respond(loops, scene, work, W):
    """Fill the move that changes gaps or speeds by -push."""
    solve_rows(work.matrix, IN_STEP, work.push)
    scratch = work.responses, work.roots, work.factors
    move_by(loops.part[0], scene.tree, work.push, scratch, W, work.move)


@inline
def _move_joints(n, at_work, move, x):
    for i in range(n):
        x[i] = select(at_work, x[i] + move[i], x[i])


@inline
def _move_balls(ball_q, scene, at_work, work):
    if ball_q is not None:
        moved = work.moved[7:]
        move_balls(scene.balls, None, ball_q, work.move, 1.0, moved)
        for k in range(len(ball_q)):
            ball_q[k] = select(at_work, moved[k], ball_q[k])


@inline
def _move_base(bq, at_work, work, W):
    if bq is not None:
        n = len(work.move) - 6
        base_acceleration(0, work.move[n:], W)
        move_base(bq, work.move[n:], 1.0, work.moved)
        for k in range(7):
            bq[k] = select(at_work, work.moved[k], bq[k])


@inline
def _speed_base(bv, at_work, work, W):
    if bv is not None:
        n = len(work.move) - 6
        base_acceleration(0, work.move[n:], W)
        _move_joints(6, at_work, work.move[n:], bv)


@entry
def make_loop(c, loops, scene, places, scratch, y):
    """Close loop c of a state y where it is; the impulse is plastic, and what it takes is added to `loop_loss`.

    places (1,) STATE; scratch: W and Closing.
    """
    offsets, n, (W, work) = places[0], len(scene.tree) - 1, scratch
    bq, bv = base_of(scene.floating, None, y, offsets.base_q, 7), base_of(scene.floating, None, y, offsets.base_qd, 6)
    q, v = y[offsets.q : offsets.q + n], y[offsets.qd : offsets.qd + n]
    ball_q, (closed, at) = ball_positions(scene.balls, y, offsets.ball_q), held_in(loops, offsets, y)
    motion_pass(scene.tree, None, scene.gravity, Motion(bq, bv, None, q, v, None, ball_q), W)
    take_place(loops.table, c, bq, W, at)
    closed[c] = 1.0
    factor_at(loops, scene, offsets, scratch, y)
    _find_move(SPEED, loops, scene, work, W)
    for r in range(len(work.push)):
        y[offsets.loop_loss + c] -= 0.5 * work.push[r] * work.rows[r, SPEED]
    always = y[offsets.status] == y[offsets.status]
    _move_joints(n, always, work.move, v)
    _speed_base(bv, always, work, W)
    _project(loops, scene, offsets, scratch, y)
