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
from ..tree.aba import articulated_pass
from ..tree.ball import ball_positions, move_balls
from ..tree.constrain import factor_rigid, list_joined, list_rigid
from ..tree.forest import (
    LARGEST,
    balls_of,
    base_count,
    base_of,
    is_fixed,
    joint_count,
    joints_of,
    loops_of,
    own_loops,
    rows_of,
    system_of,
)
from ..tree.joint import accelerate
from ..tree.kinematics import base_acceleration, motion_pass, move_base, velocity_pass
from ..tree.layout import DINV, UU, Motion, P, U
from ..tree.loop import BIAS, GAP, ON, PLACE, PULL, SPEED, fill_loops, note_forces, row_count, take_place
from ..tree.rows import (
    FIRST,
    FORCE,
    GIVEN,
    IN_STEP,
    KIND,
    LOOPED,
    OPEN,
    ROW,
    SIZE,
    SOURCE,
    TREE,
    Rows,
    entry_of,
    move_root,
    place_of,
    sides_of,
    solve_system,
    span_of,
)
from ..tree.spatial import dot, load3

MOVES = 12  # at most
SMALL = 1e-10  # gap [m or rad], and speed of it by the fastest coordinate, of which one move leaves rounding
CLOSED = 1e-9  # what counts as closed
NOTHING = 1e-12  # gap [m or rad] so small that velocities need not wait until it is closed


@structure
class Closing(NamedTuple):
    """Scratch arrays of closing."""

    factors: np.ndarray  # (bodies, 6) columns U of the factors in which the forces were found
    move: np.ndarray  # (n + 6,) of joints and base
    moved: np.ndarray  # (7 + 4 balls,) coordinates of base and ball joints after it


@structure
class LoopScratch(NamedTuple):
    """Scratch arrays with which the loops of a state are closed between runs."""

    W: np.ndarray
    rows: Rows
    closing: Closing


@if_present()
def place_loops(loops, bases, step):
    """Fill the rows of a tree's loops at the poses and velocities of W, and of the accelerations there.

    bases: positions of all bases, None where none has any.
    """
    span = loops_of(step.part, loops.table)
    held = held_in(loops, step.offsets, step.y)
    fill_loops(loops.table, span, held, step.scene.gravity, bases, step.W, step.rows.loops)


@if_present()
def place_joined(joined, loops, bases, step):
    """Do the same for loops that join trees, when the bodies of all stand in W; joined None: none does."""
    held = held_in(loops, step.offsets, step.y)
    span = own_loops(step.scene.trees, loops.table), len(loops.table)
    fill_loops(loops.table, span, held, step.scene.gravity, bases, step.W, step.rows.loops)


@if_present()
def joined_by(loops):
    """Return True where loops join trees, None where none does or there are none."""
    return loops.joined


@if_present()
def held_in(loops, offsets, y):
    """Return which loops are closed in a state, and their places."""
    count, closed, place = len(loops.table), offsets.loop_closed, offsets.loop_place
    return y[closed : closed + count], y[place : place + PLACE * count]


@if_present()
def keep_forces(loops, which, system, step):
    """Store the forces of the loops of trees in the state, and the factors in which `project` moves."""
    note_forces(loops, system, step.rows)
    for k in which:
        _keep_unless(step.scene.pairs, item(step.scene.trees, k), step)
        first, end = loops_of(item(step.scene.trees, k), loops.table)
        _store(loops.table, first, end, step)
    _store(loops.table, own_loops(step.scene.trees, loops.table), len(loops.table), step)


@inline
def _keep_unless(pairs, part, step):
    """Keep the factors of a tree, but in a scene with pairs, where `project` finds its own."""
    if pairs is None:
        _keep_factors(part, step.scene.tree, step.W, step.closing.factors)


@inline
def _store(loop, first, end, step):
    for c in range(first, end):
        for r in range(loop[c].first, loop[c].first + row_count(loop[c].kind)):
            step.y[step.offsets.loop_force + r] = step.rows.loops[r, PULL]


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
    return (n, n + 1), loops_of(trees[n], loops.table)


@if_present()
def factor_at(loops, scene, offsets, work, y):
    """Fill the factors in which `project` moves, at the state y; work: W, rows and closing of a scratch."""
    for n in range(_sets(loops.joined, scene.trees)):
        which, span = _set(loops.joined, loops, scene.trees, n)
        if span[1] > span[0]:
            _move_bodies(which, scene, offsets, y, work.W)
            _fill(span, loops, scene, offsets, work, y)
            _factor(which, span, loops, scene, offsets, work, y)


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
def _fill(span, loops, scene, offsets, work, y):
    """Fill the rows of a span of loops at the state y, whose bodies stand and move in W."""
    bases = slice_if(scene.floating, y, offsets.base_q, 7 * base_count(scene.trees))
    fill_loops(loops.table, span, held_in(loops, offsets, y), scene.gravity, bases, work.W, work.rows.loops)


@apart
def _factor(which, span, loops, scene, offsets, work, y):
    """Fill the factors of trees whose bodies stand in W, and of their loops and couplings."""
    n, W, rows = joint_count(scene.trees, scene.tree), work.W, work.rows
    for i in range(n):
        work.closing.move[i] = 0.0 * y[offsets.status]
    for k in range(which[0], which[1]):
        part = item(scene.trees, k)
        bq = base_of(scene.floating, part, y, offsets.base_q, 7)
        articulated_pass(scene.tree, part, bq, None, work.closing.move, scene.armature, None, None, W)
        _keep_factors(part, scene.tree, W, work.closing.factors)
    held, numbers = held_in(loops, offsets, y), rows.number[which[0] : which[1]]
    start = _start(loops.joined, item(scene.trees, which[0]))
    end = list_rigid(scene.coupling, loops, numbers, held, scene, start, rows)
    end = _list_joined(loops.joined, loops, scene.trees, held, end, rows)
    system = start[0], end[0], start[1], end[1] - start[1]
    factor_rigid(scene, system, IN_STEP, W, rows)
    keep_system(which[0], system, rows)


@inline
def _start(joined, part):
    if joined is not None:
        return 0, 0
    return system_of(part)


@inline
def _list_joined(joined, loops, trees, held, end, rows):
    if joined is not None:
        end = list_joined(loops, trees, held, end, rows)
    return end


@inline
def keep_system(number, system, rows):
    """Keep which blocks and rows the system of a set of trees has."""
    for k in range(4):
        rows.system[number, k] = system[k]


@inline
def _system(which, rows):
    at = rows.system[which[0]]
    return at[0], at[1], at[2], at[3]


# ---------------------------------------------------------------------------------------------- at the end of a step


@if_present()
def project(loops, scene, offsets, work, y):
    """Close what a step has left open in y, in the factors of its last accelerations."""
    for n in range(_sets(loops.joined, scene.trees)):
        which, span = _set(loops.joined, loops, scene.trees, n)
        if span[1] > span[0]:
            _factor_again(scene.pairs, which, span, loops, scene, offsets, work, y)
            _project(which, span, loops, scene, offsets, work, y)


@if_present()
def project_euler(loops, scene, offsets, work, h, y):
    """Close what a step of Euler's has left open in y, in factors that are found there.

    Velocities that were moved along the loops' forces of its beginning alone would gain (h w)^2 / 2 a step where a loop
    turns at the rate w, and along those of its end alone lose as much; so the acceleration that bends the path acts for
    half of the step before they are moved along those of its end.
    """
    for n in range(_sets(loops.joined, scene.trees)):
        which, span = _set(loops.joined, loops, scene.trees, n)
        if span[1] > span[0]:
            _factor_again(scene.pairs, which, span, loops, scene, offsets, work, y)
            _factor_again(scene.fluid, which, span, loops, scene, offsets, work, y)  # as at the end: without added mass
            _unbend(which, span, loops, scene, offsets, work, h, y)
            _move_bodies(which, scene, offsets, y, work.W)
            _fill(span, loops, scene, offsets, work, y)
            _factor(which, span, loops, scene, offsets, work, y)
            _project(which, span, loops, scene, offsets, work, y)


@if_present()
def _factor_again(other, which, span, loops, scene, offsets, work, y):
    """Fill the factors of the poses in W, where loops have been solved in others, with pairs or in a fluid."""
    _factor(which, span, loops, scene, offsets, work, y)


@kernel
def _unbend(which, span, loops, scene, offsets, work, h, y):
    """Take half of the velocity back that the loops' bias has given in a step h."""
    _take(BIAS, -0.5 * h, which, loops, work)
    _speed_up(which, span, loops, scene, offsets, work, 0.0 * y[offsets.status] == 0.0, y)


@apart
def _project(which, span, loops, scene, offsets, work, y):
    """Move positions and velocities; count a step whose loops stay open as one that has not converged.

    Both are moved at the poses in which the gaps are found, and again where these change the loops' directions by more
    than rounding.  In lanes what is closed in one is not moved any more.
    """
    _fill_at(which, span, loops, scene, offsets, work, y)
    always, fast = 0.0 * y[offsets.status] == 0.0, _fastest(which, scene, offsets, y)
    gap, speed = _largest(GAP, span, loops, work.rows.loops), _largest(SPEED, span, loops, work.rows.loops)
    _take(GAP, 1.0, which, loops, work)
    _move(which, span, loops, scene, offsets, work, always, y)
    _take(SPEED, 1.0, which, loops, work)
    _speed_up(which, span, loops, scene, offsets, work, always, y)
    again, at_work = (gap > NOTHING) | (speed > SMALL * fast), gap > SMALL
    for _ in range(1, MOVES):
        if not any_lane(at_work):
            break
        _fill_at(which, span, loops, scene, offsets, work, y)
        before, gap = gap, select(at_work, _largest(GAP, span, loops, work.rows.loops), gap)
        _take(GAP, 1.0, which, loops, work)
        _move(which, span, loops, scene, offsets, work, at_work, y)
        at_work = at_work & (gap > SMALL) & (gap < 0.5 * before)
    at_work = again
    for k in range(1, MOVES):
        if not any_lane(at_work):
            break
        _fill_at(which, span, loops, scene, offsets, work, y)
        before, speed = speed, select(at_work, _largest(SPEED, span, loops, work.rows.loops), speed)
        _take(SPEED, 1.0, which, loops, work)
        _speed_up(which, span, loops, scene, offsets, work, at_work, y)
        at_work = at_work & (speed > SMALL * fast) & ((speed < 0.5 * before) | (k == 1))
    missed, at = (gap > CLOSED) | (speed > CLOSED * fast), offsets.newton_iterations + 1
    y[at] = select(missed, y[at] + 1.0, y[at])


@apart
def _fill_at(which, span, loops, scene, offsets, work, y):
    """Fill gaps and speeds of a span of loops at the state y, with poses and velocities of the bodies."""
    n, ball_q = joint_count(scene.trees, scene.tree), ball_positions(scene.balls, y, offsets.ball_q)
    q, v = y[offsets.q : offsets.q + n], y[offsets.qd : offsets.qd + n]
    for k in range(which[0], which[1]):
        part = item(scene.trees, k)
        bq = base_of(scene.floating, part, y, offsets.base_q, 7)
        bv = base_of(scene.floating, part, y, offsets.base_qd, 6)
        velocity_pass(scene.tree, part, Motion(bq, bv, None, q, v, None, ball_q), work.W)
    _fill(span, loops, scene, offsets, work, y)


@inline
def _largest(column, span, loops, numbers):
    largest = 0.0 * numbers[loops.table[span[0]].first, column]
    for c in range(span[0], span[1]):
        k = loops.table[c]
        for r in range(k.first, k.first + row_count(k.kind)):
            size = abs(numbers[r, column])
            largest = select((size > largest) & (numbers[r, ON] > 0.0), size, largest)
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
def _take(column, share, which, loops, work):
    """Find the forces of the move that takes a share of what is open by a column of the loops' rows."""
    rows = work.rows
    system = _system(which, rows)
    for b in range(system[0] & LARGEST, system[1] & LARGEST):
        first = entry_of(b, ROW, rows)
        for t in range(entry_of(b, SIZE, rows)):
            rows.numbers[first + t, OPEN] = 0.0 * rows.numbers[first + t, OPEN]
            rows.numbers[first + t, FIRST] = 0.0 * rows.numbers[first + t, FIRST]
            rows.numbers[first + t, GIVEN] = 0.0 * rows.numbers[first + t, GIVEN]
        if rows.block[b, KIND] == LOOPED:
            at = loops.table[entry_of(b, SOURCE, rows)].first
            for t in range(entry_of(b, SIZE, rows)):
                rows.numbers[first + t, OPEN] = share * rows.loops[at + t, column]
    solve_system(system, IN_STEP[1], rows)


@kernel
def _move(which, span, loops, scene, offsets, work, at_work, y):
    """Move the positions of trees by the forces `push`."""
    for k in range(which[0], which[1]):
        part = item(scene.trees, k)
        _move_by(scene, k, _system(which, work.rows), work.closing.factors, work.W, work.rows, work.closing.move)
        _move_joints(part, scene, at_work, work.closing.move, y[offsets.q :])
        _move_balls(ball_positions(scene.balls, y, offsets.ball_q), part, scene, at_work, work.closing)
        _move_base(base_of(scene.floating, part, y, offsets.base_q, 7), part, scene, at_work, work.closing, work.W)


@kernel
def _speed_up(which, span, loops, scene, offsets, work, at_work, y):
    """Move the velocities of trees by the forces `push`."""
    for k in range(which[0], which[1]):
        part = item(scene.trees, k)
        _move_by(scene, k, _system(which, work.rows), work.closing.factors, work.W, work.rows, work.closing.move)
        _move_joints(part, scene, at_work, work.closing.move, y[offsets.qd :])
        _speed_base(base_of(scene.floating, part, y, offsets.base_qd, 6), part, scene, at_work, work.closing, work.W)


@inline
def _move_joints(part, scene, at_work, move, x):
    first, end = joints_of(part, scene.tree)
    for i in range(first, end):
        x[i] = select(at_work, x[i] + move[i], x[i])


@inline
def _move_balls(ball_q, part, scene, at_work, closing):
    if ball_q is not None:
        moved, (first, end) = closing.moved[7:], balls_of(part, scene.balls)
        move_balls(scene.balls, part, ball_q, closing.move, 1.0, moved)
        for k in range(4 * first, 4 * end):
            ball_q[k] = select(at_work, moved[k], ball_q[k])


@inline
def _move_base(bq, part, scene, at_work, closing, W):
    if bq is not None:
        if is_fixed(part):
            return
        change, (root, _) = closing.move[len(closing.move) - 6 :], rows_of(part, scene.tree)
        base_acceleration(root, change, W)
        move_base(bq, change, 1.0, closing.moved)
        for k in range(7):
            bq[k] = select(at_work, closing.moved[k], bq[k])


@inline
def _speed_base(bv, part, scene, at_work, closing, W):
    if bv is not None:
        if is_fixed(part):
            return
        change, (root, _) = closing.move[len(closing.move) - 6 :], rows_of(part, scene.tree)
        base_acceleration(root, change, W)
        for k in range(6):
            bv[k] = select(at_work, bv[k] + change[k], bv[k])


@inline
def _keep_factors(part, tree, W, factors):
    """Copy the columns U of the bodies, which `acceleration_pass` overwrites, to factors (bodies, 6)."""
    root, end = rows_of(part, tree)
    for i in range(root + 1, end):
        for k in range(6):
            factors[i, k] = W[i, U + k]


@inline
def _is_on(trees, b, side, number, rows):
    if trees is None:
        return True
    return rows.block[b, TREE + side] == number


@kernel
def _move_by(scene, number, system, factors, W, rows, out):
    """Fill out (n,) with the move A^-1 J' f of the joints of a tree by the forces of a system.

    The move of the base is left in the columns U of the root, as `acceleration_pass` leaves an acceleration; factors:
    what `_keep_factors` has kept.
    """
    part = item(scene.trees, number)
    root, last = rows_of(part, scene.tree)
    for k in range(6):
        W[root, U + k] = 0.0 * W[root, P]
    for i in range(root + 1, last):
        W[i, UU] = 0.0 * W[i, P]
    for b in range(system[0] & LARGEST, system[1] & LARGEST):
        start, end = span_of(b, rows)
        for side in range(sides_of(scene.trees)):
            if _is_on(scene.trees, b, side, number, rows):
                _, low, high = place_of(scene, b, side, rows)
                for r in range(start, end):
                    f = rows.numbers[r, FORCE]
                    move_root(scene.floating, root, f, (r, side), W, rows.roots)
                    for i in range(low, high):
                        W[root + i, UU] += f * rows.responses[r, side, i]
    for i in range(root + 1, last):
        b, dn, df = scene.tree[i], load3(W, scene.tree[i].parent, U), load3(W, scene.tree[i].parent, U + 3)
        a = (W[i, UU] - (dot(load3(factors, i, 0), dn) + dot(load3(factors, i, 3), df))) * W[i, DINV]
        out[b.dof] = a
        accelerate(b, i, dn, df, a, W, W, U)


# ---------------------------------------------------------------------------------------------- between steps


@entry
def make_loop(c, loops, scene, places, work, y):
    """Close loop c of a state y where it is; the impulse is plastic, and what it takes is added to `loop_loss`.

    places (1,) STATE; work: a `LoopScratch`.
    """
    offsets = places[0]
    for n in range(_sets(loops.joined, scene.trees)):
        which, span = _set(loops.joined, loops, scene.trees, n)
        if span[0] <= c < span[1]:
            _move_bodies(which, scene, offsets, y, work.W)
            closed, at = held_in(loops, offsets, y)
            bases = slice_if(scene.floating, y, offsets.base_q, 7 * base_count(scene.trees))
            take_place(loops.table, c, bases, work.W, at)
            closed[c] = 1.0
            _fill(span, loops, scene, offsets, work, y)
            _factor(which, span, loops, scene, offsets, work, y)
            _take(SPEED, 1.0, which, loops, work)
            note_forces(loops, _system(which, work.rows), work.rows)
            for k in range(span[0], span[1]):
                first = loops.table[k].first
                for r in range(first, first + row_count(loops.table[k].kind)):
                    y[offsets.loop_loss + c] -= 0.5 * work.rows.loops[r, PULL] * work.rows.loops[r, SPEED]
            always = y[offsets.status] == y[offsets.status]
            _speed_up(which, span, loops, scene, offsets, work, always, y)
            _project(which, span, loops, scene, offsets, work, y)


@entry
def measure_loops(loops, scene, places, work, y):
    """Fill the rows of all loops at a state y; places (1,) STATE; work: a `LoopScratch`."""
    _move_bodies((0, base_count(scene.trees)), scene, places[0], y, work.W)
    _fill((0, len(loops.table)), loops, scene, places[0], work, y)
