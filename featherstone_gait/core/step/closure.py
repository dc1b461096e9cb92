"""Loops in the differential equation: accelerations that keep them closed, and what a step leaves open closed again.

The accelerations of `core/tree/loop.py` leave gaps as small as the error of a step.  `project` takes these away after
each step, by the moves of least kinetic energy: with M of the posture, J M^-1 J' f = -gap and the move M^-1 J' f.
Of velocities J qd takes the place of the gap.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import inline, kernel
from ..compile.optional import slice_if
from ..compile.structure import structure
from ..tree.aba import acceleration_pass, articulated_pass, constrain
from ..tree.ball import ball_positions, move_balls
from ..tree.forest import base_of
from ..tree.kinematics import base_acceleration, motion_pass, move_base
from ..tree.layout import Motion
from ..tree.loop import BIAS, GAP, IN_STEP, SPEED, close, fill_loops

MOVES = 2  # of positions after a step: the second takes away the square of the first


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
    force: np.ndarray  # (m,)
    still: np.ndarray  # (n + 6,) zeros
    move: np.ndarray  # (n + 6,) of base and joints


@inline
def close_loops(loops, contact, step):
    """Keep loops closed: call it between the two passes of the ABA; loops None: there are none."""
    if loops is not None:
        scene, work = step.scene, step.closing
        base_q = base_of(scene.floating, None, step.y, step.offsets.base_q, 7)
        fill_loops(loops.table, scene.gravity, base_q, step.W, work.rows)
        scratch = work.responses, work.roots, work.matrix
        close(scene, loops.part[0], contact, loops.table, IN_STEP, step.W, work.rows, scratch, work.force)


@inline
def project(loops, run, y):
    """Close what a step has left open, in positions and velocities."""
    if loops is not None:
        for _ in range(MOVES):
            _project_positions(loops, run, y)
        _project_velocities(loops, run, y)


@kernel
def _project_positions(loops, run, y):
    scene, offsets, scratch = run.scene, run.offsets[0], run.work.scratch
    work, n = run.work.closing, len(scene.tree) - 1
    bq, q = base_of(scene.floating, None, y, offsets.base_q, 7), y[offsets.q : offsets.q + n]
    ball_q = ball_positions(scene.balls, y, offsets.ball_q)
    _pose(scene, bq, q, ball_q, work, scratch.W)
    fill_loops(loops.table, work.still, bq, scratch.W, work.rows)
    for r in range(len(work.rows)):
        work.rows[r, BIAS] = work.rows[r, GAP]
    _respond(loops, scene, bq, work, scratch.W)
    move = work.move[6 : 6 + n]
    for i in range(n):
        q[i] += move[i]
    move_balls(scene.balls, None, ball_q, move, 1.0, ball_q)
    _move_base(bq, work)


@kernel
def _project_velocities(loops, run, y):
    scene, offsets, scratch = run.scene, run.offsets[0], run.work.scratch
    work, n = run.work.closing, len(scene.tree) - 1
    bq, q = base_of(scene.floating, None, y, offsets.base_q, 7), y[offsets.q : offsets.q + n]
    bv, v = base_of(scene.floating, None, y, offsets.base_qd, 6), y[offsets.qd : offsets.qd + n]
    ball_q = ball_positions(scene.balls, y, offsets.ball_q)
    motion_pass(scene.tree, None, work.still, Motion(bq, bv, None, q, v, None, ball_q), scratch.W)
    fill_loops(loops.table, work.still, bq, scratch.W, work.rows)
    for r in range(len(work.rows)):
        work.rows[r, BIAS] = work.rows[r, SPEED]
    _pose(scene, bq, q, ball_q, work, scratch.W)
    _respond(loops, scene, bq, work, scratch.W)
    for i in range(n):
        v[i] += work.move[6 + i]
    _speed_base(bv, work)


@inline
def _pose(scene, bq, q, ball_q, work, W):
    """Find the poses of all bodies, at rest and without gravity."""
    n = len(scene.tree) - 1
    still = slice_if(scene.floating, work.still, n, 6)
    motion_pass(scene.tree, None, work.still, Motion(bq, still, None, q, work.still[:n], None, ball_q), W)


@inline
def _respond(loops, scene, bq, work, W):
    """Fill the move M^-1 J' f with J M^-1 J' f = -BIAS of the rows, at rest and without forces."""
    n, still = len(scene.tree) - 1, work.still
    articulated_pass(scene.tree, None, bq, None, still, scene.armature, None, None, W)
    constrain(scene.coupling, None, bq, None, scene.tree, W)
    scratch = work.responses, work.roots, work.matrix
    close(scene, loops.part[0], None, loops.table, IN_STEP, W, work.rows, scratch, work.force)
    acceleration_pass(scene.tree, None, W, work.move[6 : 6 + n])
    base_acceleration(0, slice_if(scene.floating, work.move, 0, 6), W)


@inline
def _move_base(bq, work):
    if bq is not None:
        move_base(bq, work.move, 1.0, bq)


@inline
def _speed_base(bv, work):
    if bv is not None:
        for k in range(6):
            bv[k] += work.move[k]
