"""Rigid loops: rows that hold two bodies, or a body and the world, together at points, axes and frames.

Each row is a unit force along d at the points of both ends, or a unit moment, +d on body a and -d on body b, in the
common frame.  With the velocities and the accelerations A of zero joint accelerations that `motion_pass` has left, a
row has a gap, its speed J qd and the bias Jdot qd.  The accelerations are those of

    M a = tau - c + J' f,   J a + Jdot qd = 0,

so L f = -(J a0 + Jdot qd) with L = J M^-1 J', by unit forces in the factors of the first pass (`rows.py`).  Rows are
scaled to a unit diagonal of L and the system is solved with a small compliance, several times, each from the forces
of the last (the proximal method of multipliers): redundant rows share their force, and a posture in which rows
depend on each other is no exception.

A loop may join two trees, each of which has a common frame of its own: the point on body b and what acts there are in
that of its tree.
"""

from ..compile.jit import inline, kernel
from ..compile.lanes import select, sqrt
from ..compile.structure import record
from .coupling import DA
from .forest import base_index, rows_of
from .joint import accelerate, along
from .layout import DINV, A, P, R, U, V
from .rank_one import release_rows, unbind
from .rows import acceleration_along, add_force, add_moment, answer_root, apply_row, clear_row, common_product
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
SIZE = 13

# Compliance of a row, by its diagonal of L, and rounds of the iteration: of a combination of rows with the eigenvalue k
# of the scaled L they leave (compliance / (compliance + k))^rounds.  In a step the rows of intermediate states, which
# are open by the square of the step, contradict each other where they depend on each other at closed ones.
EXACT, IN_STEP = (1e-8, 10), (1e-6, 4)
# Rows of the forces, or moments, of a loop are scaled by their own diagonal of L, but as if it were at least so much of
# the largest among them.  Where digits of a file let axes differ a little, a row across a plane moves by that little
# alone, and what it contradicts the others by would become a force larger by its inverse.
ALIKE = 1e-4
IMMOVABLE = 1e-26  # of the most that L could have on its diagonal: a row below it moves nothing but by rounding
SHORTEST = 1e-12  # distance of two points that still has a direction [m]


@kernel
def fill_loops(loop, span, held, gravity, bases, W, rows):
    """Fill the rows (m, SIZE) of the loops of a span, first and end; call it after `motion_pass` without accelerations.

    loop (loops,) LOOP; held: 1 of each that is closed (loops,), and their places (loops * PLACE,); gravity (3,)
    [m/s^2]; bases (7 trees,): positions of all bases, None where none has any.
    """
    (closed, places), zero = held, 0.0 * W[0, P]
    for c in range(span[0], span[1]):
        k, at = loop[c], PLACE * c
        xa, xb = _point(bases, k.tree_a, k.a, k.pa, W), _point(bases, k.tree_b, k.b, _three(places, at), W)
        x = sub(xa, _from_b(bases, k, xb))
        for t in range(row_count(k.kind)):
            rows[k.first + t, ON] = closed[c] + zero
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


# ------------------------------------------------------------------------------------------------- forces


@kernel
def close(robot, parts, span, contact, loop, lines, softness, rows, scratch, force):
    """Let forces of the loops of a span act on the solutions that the first pass and the couplings have left.

    parts: TREE of all trees; span: first loop and the one after the last; contact: as the first pass had it; lines:
    records of what rank_one.py has bound to the factors, or None; softness: EXACT or IN_STEP; rows as `fill_loops` has
    filled them; scratch: W, responses (m, sides, bodies), roots (m, sides, 12), L (m, m + 2), of all rows, and `listed`
    (2, m); force (m,) [N or N m] becomes the force or moment of each row on body a along its direction.
    """
    (W, responses, roots, L, listed), count, begin = scratch, 0, loop[span[0]].first
    for c in range(span[0], span[1]):
        count = list_rows(loop, c, count, listed)
        respond_loop(robot, parts, contact, loop[c], lines, W, rows, responses, roots)
    L = L[begin : begin + count]
    fill_system(robot.tree, parts, loop, count, listed, W, rows, (responses, roots), L, force)
    own = force[begin : begin + count]
    factor_rows(L, softness)
    solve_rows(L, softness, own)
    for r in range(count):
        apply_loop_row(robot.tree, parts, loop[listed[1, r]], begin + r, own[r], W, responses, roots)


@inline
def span_rows(loop, span):
    """Return the first row of a span of loops, and the one after the last."""
    last = loop[span[1] - 1]
    return loop[span[0]].first, last.first + row_count(last.kind)


@inline
def release_loops(lines, tree, parts, loop, span, W, responses, roots):
    """Take what rank_one.py has bound once more from rows, for a solution made of them."""
    for c in range(span[0], span[1]):
        k = loop[c]
        release_rows(lines, tree, parts[k.tree_a], k.first, row_count(k.kind), 0, W, responses, roots)
        if k.tree_a != k.tree_b:
            release_rows(lines, tree, parts[k.tree_b], k.first, row_count(k.kind), 1, W, responses, roots)


@inline
def list_rows(loop, c, count, listed):
    """Add the rows of loop c to a list that has `count` of them; return how many it has then.

    listed (2, m): numbers of rows, and of their loops.
    """
    for t in range(row_count(loop[c].kind)):
        listed[0, count], listed[1, count] = loop[c].first + t, c
        count += 1
    return count


@inline
def _side_b(k):
    """Return the side of a loop's rows that body b is on."""
    if k.tree_a == k.tree_b:
        return 0
    return 1


@kernel
def respond_loop(robot, parts, contact, k, lines, W, rows, responses, roots):
    """Fill the responses of the trees to unit forces along the rows of a loop."""
    tree, a, b, side, count = robot.tree, parts[k.tree_a], parts[k.tree_b], _side_b(k), row_count(k.kind)
    for t in range(count):
        r = k.first + t
        clear_row(a, tree, r, 0, responses, roots)
        if side == 1:
            clear_row(b, tree, r, 1, responses, roots)
        d = load3(rows, r, D)
        if k.a == k.b:  # what is between moves as one
            d = scale(d, 0.0)
        back = scale(d, -1.0)
        if t >= 3:
            add_moment(tree, a, k.a, d, r, 0, W, responses, roots)
            if k.b >= 0:
                add_moment(tree, b, k.b, back, r, side, W, responses, roots)
        else:
            add_force(tree, a, k.a, load3(rows, r, PA), d, r, 0, W, responses, roots)
            if k.b >= 0:
                add_force(tree, b, k.b, load3(rows, r, PB), back, r, side, W, responses, roots)
    answer_root(robot, a, contact, k.first, count, 0, W, responses, roots)
    unbind(lines, tree, a, k.first, count, 0, W, responses, roots)
    if side == 1:
        answer_root(robot, b, contact, k.first, count, 1, W, responses, roots)
        unbind(lines, tree, b, k.first, count, 1, W, responses, roots)


@kernel
def fill_system(tree, parts, loop, count, listed, W, rows, found, L, e):
    """Fill the lower triangle of L (count, at least count + 1) of listed rows and their accelerations e, of all rows.

    The next column of L takes the least diagonal of a row that does anything, the one after it the least by which rows
    are scaled; found: responses and roots.
    """
    (responses, roots), least = found, 0.0 * W[0, P]
    for r in range(count):
        at, k = listed[0, r], loop[listed[1, r]]
        for s in range(r + 1):
            L[r, s] = common_product(tree, parts, (k, at), found, (loop[listed[1, s]], listed[0, s]), found, W)
        e[at] = acceleration_along(parts[k.tree_a], tree, at, 0, W, responses, roots)
        if k.tree_a != k.tree_b:
            e[at] = e[at] + acceleration_along(parts[k.tree_b], tree, at, 1, W, responses, roots)
        e[at] = e[at] + rows[at, BIAS]
        if at == k.first:
            least = IMMOVABLE * _most(tree, parts, k, rows, W)
        L[r, len(L)] = select(rows[at, ON] > 0.0, least, 1e300 + 0.0 * least)
    for r in range(count):
        largest = L[r, r]
        for s in range(max(r - 2, 0), min(r + 3, count)):  # the rows of forces, or of moments, of a loop
            if listed[1, s] == listed[1, r] and _is_force(loop, listed, s) == _is_force(loop, listed, r):
                largest = select(L[s, s] > largest, L[s, s], largest)
        L[r, len(L) + 1] = ALIKE * largest


@inline
def _is_force(loop, listed, r):
    return listed[0, r] - loop[listed[1, r]].first < 3


@inline
def _most(tree, parts, k, rows, W):
    """Return what a unit force with the longest lever could do to a joint, as a diagonal of L [1/kg]."""
    most, far = 0.0 * rows[k.first, GAP], 0.0 * rows[k.first, GAP]
    for r in range(k.first, k.first + row_count(k.kind)):
        for at in (PA, PB):
            x = load3(rows, r, at)
            square = dot(x, x)
            far = select(square > far, square, far)
    most = _reach(tree, parts[k.tree_a], far, most, W)
    if k.tree_a != k.tree_b:
        most = _reach(tree, parts[k.tree_b], far, most, W)
    return most


@inline
def _reach(tree, part, far, most, W):
    root, end = rows_of(part, tree)
    for i in range(root + 1, end):
        p = load3(W, i, P)
        reach = W[i, DINV] * (1.0 + far + dot(p, p))
        most = select(reach > most, reach, most)
    return most


@inline
def apply_loop_row(tree, parts, k, r, f, W, responses, roots):
    """Let the force f of a row of loop k act on the solutions of its trees."""
    apply_row(parts[k.tree_a], tree, r, 0, f, W, responses, roots)
    if k.tree_a != k.tree_b:
        apply_row(parts[k.tree_b], tree, r, 1, f, W, responses, roots)


@inline
def factor_rows(L, softness):
    """Factor the lower triangle of L (m, m + 2 or more), scaled to a unit diagonal or less, with the compliance.

    Columns m and m + 1: of `fill_system`; the scale replaces the first, 0 of a row that does nothing.
    """
    m, (compliance, _) = len(L), softness
    for r in range(m):
        movable = L[r, r] > L[r, m]
        size = select(L[r, r] > L[r, m + 1], L[r, r], L[r, m + 1])
        L[r, m] = select(movable, 1.0 / sqrt(select(movable, size, 1.0)), 0.0)
    for r in range(m):
        for s in range(r + 1):
            L[r, s] = L[r, s] * L[r, m] * L[s, m]
        L[r, r] = L[r, r] + compliance
    _factor(L, m)


@kernel
def solve_rows(L, softness, x):
    """Solve L f = -x by the proximal iteration in the factors of `factor_rows`; f replaces x."""
    m, (compliance, rounds) = len(x), softness
    for r in range(m):
        L[r, m + 1] = -x[r] * L[r, m]  # the scaled right-hand side
        x[r] = 0.0
    for _ in range(rounds):
        for r in range(m):
            x[r] = L[r, m + 1] + compliance * x[r]
        forward(L, m, x)
        backward(L, m, x)
    for r in range(m):
        x[r] = x[r] * L[r, m]


@inline
def _factor(L, m):
    """Replace the lower triangle by its Cholesky factor, whose diagonal is kept inverted."""
    for r in range(m):
        for s in range(r + 1):
            y = L[r, s]
            for k in range(s):
                y = y - L[r, k] * L[s, k]
            if s < r:
                L[r, s] = y * L[s, s]
            else:
                L[r, r] = 1.0 / sqrt(y)


@inline
def forward(L, m, x):
    """Solve F y = x with the factor F; y replaces x."""
    for r in range(m):
        for k in range(r):
            x[r] = x[r] - L[r, k] * x[k]
        x[r] = x[r] * L[r, r]


@inline
def backward(L, m, x):
    """Solve F' y = x."""
    for t in range(m):
        r = m - 1 - t
        for k in range(r + 1, m):
            x[r] = x[r] - L[k, r] * x[k]
        x[r] = x[r] * L[r, r]


# ------------------------------------------------------------------------------------------------- moves


@inline
def keep_factors(part, tree, W, factors):
    """Copy the columns U of the bodies, which `acceleration_pass` overwrites, to factors (bodies, 6)."""
    root, end = rows_of(part, tree)
    for i in range(root + 1, end):
        for k in range(6):
            factors[i, k] = W[i, U + k]


@kernel
def move_by(part, tree, loop, span, force, scratch, W, out):
    """Fill out (n,) with the move M^-1 J' f of a tree's joints, of forces (m,) of the loops of a span.

    The move of the base is left in the columns U of the root, as `acceleration_pass` leaves an acceleration;
    scratch: responses and roots of `close`, and the factors that `keep_factors` has kept.
    """
    (responses, roots, factors), (root, end) = scratch, rows_of(part, tree)
    for k in range(6):
        total = 0.0 * W[root, P]
        for c in range(span[0], span[1]):
            side = side_of(part, loop[c])
            if side >= 0:
                for r in range(loop[c].first, loop[c].first + row_count(loop[c].kind)):
                    total = total + force[r] * roots[r, side, DA + k]
        W[root, U + k] = total
    for i in range(root + 1, end):
        b, u = tree[i], 0.0 * W[i, P]
        for c in range(span[0], span[1]):
            side = side_of(part, loop[c])
            if side >= 0:
                for r in range(loop[c].first, loop[c].first + row_count(loop[c].kind)):
                    u = u + force[r] * responses[r, side, i - root]
        dn, df = load3(W, b.parent, U), load3(W, b.parent, U + 3)
        a = (u - (dot(load3(factors, i, 0), dn) + dot(load3(factors, i, 3), df))) * W[i, DINV]
        out[b.dof] = a
        accelerate(b, i, dn, df, a, W, W, U)


@inline
def side_of(part, k):
    """Return the side of a loop's rows that is a tree's, -1 if none is."""
    if k.tree_a == base_index(part):
        return 0
    if k.tree_b == base_index(part):
        return 1
    return -1
