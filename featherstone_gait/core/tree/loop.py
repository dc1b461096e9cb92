"""Rigid loops: rows that hold two bodies, or a body and the world, together at points, axes and frames.

Each row is a unit force along d at the points of both ends, or a unit moment, +d on body a and -d on body b, in the
common frame.  With the velocities and the accelerations A of zero joint accelerations that `motion_pass` has left, a
row has a gap, its speed J qd and the bias Jdot qd.  The accelerations are those of

    M a = tau - c + J' f,   J a + Jdot qd = 0,

rigid rows of rows.py.

A loop may join two trees, each of which has a common frame of its own: the point on body b and what acts there are in
that of its tree.
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import inline, kernel
from ..compile.lanes import any_lane, select, sqrt
from ..compile.optional import if_present, item
from ..compile.structure import record, structure
from .forest import LARGEST, rows_of
from .joint import along
from .layout import DINV, A, P, R, V
from .rows import (
    FORCE,
    KIND,
    LEAST,
    LOOPED,
    OFF,
    OPEN,
    ROW,
    SOURCE,
    add_block,
    answer_base,
    clear_block,
    entry_of,
    make_rigid,
    push_body,
)
from .spatial import add, compose, cross, dot, load3, load9, rotate, rotate_back, scale, store3, sub

CONNECT, WELD, HINGE, DISTANCE = 0, 1, 2, 3

LOOP = record(
    kind=int,
    first=int,  # its first row
    a=int,  # row of the first body
    b=int,  # row of the second body; WORLD for the world of a floating base
    tree_a=int,  # numbers of their trees; that of both for the world
    tree_b=int,
    pa=(float, 3),  # point in the frame of body a [m]
    Ea=(float, 9),  # frame -> body a, row by row; of a hinge z is the axis
)
WORLD = -1


@structure
class Loops(NamedTuple):
    """The loops of a scene: those of each tree, one tree after the other, then those that join trees."""

    table: np.ndarray  # (loops,) LOOP
    rows: np.ndarray  # (1,) number of rows, for the size of the scratch
    joined: bool | None = None  # True where loops join trees, None where none does


# Numbers of a place, where a loop holds its second body; a run may change it (`take_place`).
POINT = 0  # 3: point in the frame of body b, or in the world [m]
FRAME = 3  # 9: frame -> body b, row by row
LENGTH = 12  # of a rod [m]
PLACE = 13

# Columns of a row.
D = 0  # 3: direction of force or moment on body a
PA = 3  # 3: point on body a [m]
PB = 6  # 3: point on body b, in the frame of its tree [m]
GAP = 9  # [m or rad]
SPEED = 10  # [m/s or rad/s]
BIAS = 11  # [m/s^2 or rad/s^2]
ON = 12  # 1 of a loop that is closed, 0 of one that is open
PULL = 13  # force or moment on body a along its direction [N or N m]

IMMOVABLE = 1e-26  # of the most that L could have on its diagonal: a row below it moves nothing but by rounding
SHORTEST = 1e-12  # distance of two points that still has a direction [m]


@kernel
def fill_loops(loop, span, held, gravity, bases, W, rows):
    """Fill the rows (m, LOOP) of the loops of a span, first and end, after `motion_pass` without accelerations.

    loop (loops,) LOOP; held: 1 of each that is closed (loops,), and their places (loops * PLACE,); gravity (3,)
    [m/s^2]; bases (7 trees,): positions of all bases, None where none has any.
    """
    (closed, places), zero = held, 0.0 * W[0, P]
    for c in range(span[0], span[1]):
        k, at = loop[c], PLACE * c
        xa, xb = _point(bases, k.tree_a, k.a, k.pa, W), _point(bases, k.tree_b, k.b, _three(places, at), W)
        x = sub(xa, _from_b(bases, k, xb))
        for t in range(row_count(k.kind)):
            rows[k.first + t, ON], rows[k.first + t, PULL] = closed[c] + zero, zero
        if k.kind == DISTANCE:
            _fill_rod(k, places[at + LENGTH], x, xa, xb, _moving(k, gravity, xa, xb, W), rows)
        else:
            turning, moving = _relative(k, gravity, xa, xb, W)
            _fill_three(k.first, xa, xb, x, moving, rows)
            if k.kind == WELD:
                _fill_three(k.first + 3, xa, xb, _turn(_axes(k.a, k.Ea, W), _frame(k, places, at, W)), turning, rows)
            elif k.kind == HINGE:
                Ra, Rb = _axes(k.a, k.Ea, W), _frame(k, places, at, W)
                _fill_axis(k.first + 3, (Ra[0], Ra[3], Ra[6]), k, Rb, xa, xb, turning, W, rows)
                _fill_axis(k.first + 4, (Ra[1], Ra[4], Ra[7]), k, Rb, xa, xb, turning, W, rows)


@inline
def _three(places, at):
    return places[at], places[at + 1], places[at + 2]


@inline
def _frame(k, places, at, W):
    at += FRAME
    return _axes(k.b, _three(places, at) + _three(places, at + 3) + _three(places, at + 6), W)


@inline
def _axes(i, E, W):
    """Return the rotation (9) of the frame E of body i, common frame."""
    zero = 0.0 * W[0, P]
    turn = (E[0] + zero, E[1] + zero, E[2] + zero, E[3] + zero, E[4] + zero, E[5] + zero, E[6] + zero, E[7] + zero,
            E[8] + zero)  # fmt: skip
    if i >= 0:
        turn = compose(load9(W, i, R), turn)
    return turn


@inline
def _point(bases, tree, i, r, W):
    """Return the point r of body i of a tree, common frame."""
    zero = 0.0 * W[0, P]
    at = (r[0] + zero, r[1] + zero, r[2] + zero)
    if i >= 0:
        at = add(load3(W, i, P), rotate(load9(W, i, R), at))
    elif bases is not None:
        at = sub(at, _three(bases, 7 * tree))
    return at


@inline
def _from_b(bases, k, x):
    """Return a point in the frame of the tree of body b in that of body a."""
    if bases is not None:
        if k.tree_a != k.tree_b:
            x = add(x, sub(_three(bases, 7 * k.tree_b), _three(bases, 7 * k.tree_a)))
    return x


@inline
def _relative(k, gravity, xa, xb, W):
    """Return velocity and acceleration of a against b: of the rotation, and of the points."""
    wa, va, alpha_a, aa = _motion(k.a, gravity, xa, W)
    wb, vb, alpha_b, ab = _motion(k.b, gravity, xb, W)
    return (sub(wa, wb), sub(alpha_a, alpha_b)), (sub(va, vb), sub(aa, ab))


@inline
def _moving(k, gravity, xa, xb, W):
    """Return velocity and acceleration of the point of a against that of b."""
    _, moving = _relative(k, gravity, xa, xb, W)
    return moving


@inline
def _motion(i, gravity, x, W):
    """Return w, v, alpha and a less gravity of body i at a point x."""
    zero = 0.0 * x[0]
    w, v, alpha = (zero, zero, zero), (zero, zero, zero), (zero, zero, zero)
    a = (zero - gravity[0], zero - gravity[1], zero - gravity[2])
    if i >= 0:
        w, alpha = load3(W, i, V), load3(W, i, A)
        v = add(load3(W, i, V + 3), cross(w, x))
        a = add(load3(W, i, A + 3), add(cross(alpha, x), cross(w, v)))
    return w, v, alpha, a


@inline
def _turning(i, W):
    """Return the angular velocity of body i."""
    zero = 0.0 * W[0, P]
    w = (zero, zero, zero)
    if i >= 0:
        w = load3(W, i, V)
    return w


@inline
def _fill_row(r, d, xa, xb, gap, speed, bias, rows):
    store3(rows, r, D, d)
    store3(rows, r, PA, xa)
    store3(rows, r, PB, xb)
    rows[r, GAP] = gap
    rows[r, SPEED] = speed
    rows[r, BIAS] = bias


@inline
def _fill_three(r, xa, xb, gap, motion, rows):
    """Fill three rows along the world's axes; motion: relative velocity and acceleration."""
    (u, a), one = motion, 1.0 + 0.0 * xa[0]
    zero = 0.0 * one
    _fill_row(r, (one, zero, zero), xa, xb, gap[0], u[0], a[0], rows)
    _fill_row(r + 1, (zero, one, zero), xa, xb, gap[1], u[1], a[1], rows)
    _fill_row(r + 2, (zero, zero, one), xa, xb, gap[2], u[2], a[2], rows)


@inline
def _turn(Ra, Rb):
    """Return twice the vector part of the unit quaternion that turns frame b to frame a."""
    xa, xb = (Ra[0], Ra[3], Ra[6]), (Rb[0], Rb[3], Rb[6])
    ya, yb = (Ra[1], Ra[4], Ra[7]), (Rb[1], Rb[4], Rb[7])
    za, zb = (Ra[2], Ra[5], Ra[8]), (Rb[2], Rb[5], Rb[8])
    sine = add(cross(xb, xa), add(cross(yb, ya), cross(zb, za)))  # 2 sin(angle) along the axis
    square = 1.0 + dot(xa, xb) + dot(ya, yb) + dot(za, zb)  # 4 cos^2(angle / 2)
    return scale(sine, 1.0 / sqrt(select(square > SHORTEST, square, SHORTEST)))


@inline
def _fill_axis(r, t, k, Rb, xa, xb, turning, W, rows):
    """Fill the row that keeps an axis t across the hinge's axis in body a at a right angle to that axis in body b."""
    s, (w, alpha) = (Rb[2], Rb[5], Rb[8]), turning
    d = cross(t, s)
    wa = _turning(k.a, W)
    wb = sub(wa, w)
    rate = add(cross(cross(wa, t), s), cross(t, cross(wb, s)))
    _fill_row(r, d, xa, xb, dot(t, s), dot(d, w), dot(d, alpha) + dot(rate, w), rows)


@inline
def _fill_rod(k, length, x, xa, xb, moving, rows):
    v, a = moving
    size = sqrt(dot(x, x))
    inverse = 1.0 / select(size > SHORTEST, size, SHORTEST)
    d = scale(x, inverse)
    speed = dot(d, v)
    bias = dot(d, a) + (dot(v, v) - speed * speed) * inverse
    _fill_row(k.first, d, xa, xb, size - length, speed, bias, rows)


@kernel
def take_place(loop, c, bases, W, places):
    """Let the place of loop c be that where it is now."""
    k, at = loop[c], PLACE * c
    x, Ra = _point(bases, k.tree_a, k.a, k.pa, W), _axes(k.a, k.Ea, W)
    if k.kind == DISTANCE:
        d = sub(x, _from_b(bases, k, _point(bases, k.tree_b, k.b, _three(places, at), W)))
        places[at + LENGTH] = sqrt(dot(d, d))
    elif k.b >= 0:
        Rb = load9(W, k.b, R)
        p = rotate_back(Rb, sub(x, _from_b(bases, k, load3(W, k.b, P))))
        for i in range(3):
            places[at + POINT + i] = p[i]
            e = rotate_back(Rb, (Ra[i], Ra[3 + i], Ra[6 + i]))
            for j in range(3):
                places[at + FRAME + 3 * j + i] = e[j]
    else:
        for i in range(9):
            places[at + FRAME + i] = Ra[i]
        for i in range(3):
            places[at + POINT + i] = x[i]
            if bases is not None:
                places[at + POINT + i] += bases[7 * k.tree_a + i]


@inline
def row_count(kind):
    """Return the number of rows of a kind of loop."""
    if kind == WELD:
        return 6
    if kind == HINGE:
        return 5
    if kind == DISTANCE:
        return 1
    return 3


# ------------------------------------------------------------------------------------------------- Jacobian


@kernel
def loop_jacobian(tree, loop, rows, W, base_J, J):
    """Fill J (m, n) of the joints and base_J (m, 6) of a floating base, of rows that `fill_loops` has filled."""
    for c in range(len(loop)):
        k = loop[c]
        for t in range(row_count(k.kind)):
            r = k.first + t
            d = load3(rows, r, D)
            for i in range(J.shape[1]):
                J[r, i] = 0.0
            if base_J is not None:
                for i in range(6):
                    base_J[r, i] = 0.0
            _add_end(tree, k.a, t, d, load3(rows, r, PA), r, W, base_J, J)
            _add_end(tree, k.b, t, scale(d, -1.0), load3(rows, r, PB), r, W, base_J, J)


@inline
def _add_end(tree, i, t, d, x, r, W, base_J, J):
    """Add what a unit force on body i does along the coordinates, from a loop's fourth row on a unit moment."""
    zero = 0.0 * d[0]
    n, f = cross(x, d), d
    if t >= 3:
        n, f = d, (zero, zero, zero)
    if i >= 0:
        while i > 0:
            J[r, tree[i].dof] += along(tree[i], i, n, f, W)
            i = tree[i].parent
        if base_J is not None:
            n = rotate_back(load9(W, 0, R), n)
            for k in range(3):
                base_J[r, k] += f[k]
                base_J[r, 3 + k] += n[k]


# ------------------------------------------------------------------------------------------------- rows of a system


@inline
def list_loops(loop, first, last, closed, end, rows):
    """Add loops of a range to the blocks of a system, but those that are open in all lanes, and return its end."""
    for c in range(first, last):
        if any_lane(closed[c] > 0.0):
            end = add_block(rows, end, LOOPED, c, row_count(loop[c].kind), (loop[c].tree_a, loop[c].tree_b))
    return end


@kernel
def respond_loops(loop, scene, system, softness, contact, W, rows):
    """Fill what unit forces along the rows of the loops of a system leave, when `fill_loops` has filled these."""
    for b in range(system[0] & LARGEST, system[1] & LARGEST):
        if rows.block[b, KIND] == LOOPED:
            k, least = loop[entry_of(b, SOURCE, rows)], 0.0 * W[0, P]
            clear_block(scene, b, W, rows)
            make_rigid(b, softness, rows)
            _respond(scene, k, b, W, rows)
            answer_base(scene, b, contact, W, rows)
            least = IMMOVABLE * _most(scene, k, rows.loops, W)
            for t in range(row_count(k.kind)):
                r = entry_of(b, ROW, rows) + t
                rows.numbers[r, OPEN] = rows.loops[k.first + t, BIAS]
                rows.numbers[r, LEAST] = select(rows.loops[k.first + t, ON] > 0.0, least, OFF + 0.0 * least)


@inline
def _respond(scene, k, b, W, rows):
    side = 0 if k.tree_a == k.tree_b else 1
    root_a, _ = rows_of(item(scene.trees, k.tree_a), scene.tree)
    root_b, _ = rows_of(item(scene.trees, k.tree_b), scene.tree)
    for t in range(row_count(k.kind)):
        r, at = entry_of(b, ROW, rows) + t, k.first + t
        d = load3(rows.loops, at, D)
        if k.a == k.b:  # what is between moves as one
            d = scale(d, 0.0)
        back, none = scale(d, -1.0), scale(d, 0.0)
        if t >= 3:
            push_body(scene.tree, root_a, k.a, d, none, (b, r, 0), W, rows)
            if k.b >= 0:
                push_body(scene.tree, root_b, k.b, back, none, (b, r, side), W, rows)
        else:
            push_body(scene.tree, root_a, k.a, cross(load3(rows.loops, at, PA), d), d, (b, r, 0), W, rows)
            if k.b >= 0:
                m = cross(load3(rows.loops, at, PB), back)
                push_body(scene.tree, root_b, k.b, m, back, (b, r, side), W, rows)


@if_present()
def note_forces(loops, system, rows):
    """Store the forces of the loops of a system."""
    for b in range(system[0] & LARGEST, system[1] & LARGEST):
        if rows.block[b, KIND] == LOOPED:
            k = loops.table[entry_of(b, SOURCE, rows)]
            for t in range(row_count(k.kind)):
                rows.loops[k.first + t, PULL] = rows.numbers[entry_of(b, ROW, rows) + t, FORCE]


@inline
def _most(scene, k, numbers, W):
    """Return what a unit force with the longest lever could do to a joint, as a diagonal of L [1/kg]."""
    most, far = 0.0 * numbers[k.first, GAP], 0.0 * numbers[k.first, GAP]
    for r in range(k.first, k.first + row_count(k.kind)):
        for at in (PA, PB):
            x = load3(numbers, r, at)
            square = dot(x, x)
            far = select(square > far, square, far)
    most = _reach(scene, k.tree_a, far, most, W)
    if k.tree_a != k.tree_b:
        most = _reach(scene, k.tree_b, far, most, W)
    return most


@inline
def _reach(scene, number, far, most, W):
    root, end = rows_of(item(scene.trees, number), scene.tree)
    for i in range(root + 1, end):
        p = load3(W, i, P)
        reach = W[i, DINV] * (1.0 + far + dot(p, p))
        most = select(reach > most, reach, most)
    return most
