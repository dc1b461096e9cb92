"""Rows beside the fold: unit forces in the factors that the ABA has left, and one system for the forces along them.

The first pass of the ABA (`articulated_pass`) has factorised the mass matrix A of a tree, with what the step has folded
into it.  A unit force at a point x of body i leaves on its way to the root

    p = -[x x d; d],   u_i = -S_i' p,   p += U_i u_i / D_i   from body to body,

and at the root p0, to which a floating base answers by dA = -IA^-1 p0: its *response*.  Of two rows r and s on one tree

    J_r A^-1 J_s' = sum over joints u_r u_s / D - p0_r' dA_s,

and with what the first pass has left in u and dA of the tree itself, the same sum is J_r a of its solution a.  Forces f
then change u by f u_r and dA of the root by f dA_r, and the second pass finds the accelerations of all bodies.

Rows stand in *blocks*: a coupling of joints, a loop, a tendon, what touches.  A block acts on one tree or on two, each
with a side of its own; if both ends are in one tree, both are in the first side.  With L = J A^-1 J', the bias b of the
rows and a lower triangle W of each block, the forces are

    f = f0 + W g,    (C + W' L W) g = g0 - W' (J a0 + b + L f0),

a0 the accelerations without them, f0 + W g0 the forces that there are without J a.  There are two laws:

- *slope*: f = f0 + W g0 - S J a with a slope S = W W' that has joined the mass matrix; C = 1.  The system is symmetric
  and positive definite whatever the slopes;
- *rigid*: J a + b = 0.  W scales the rows to a unit diagonal, and C is a small compliance, with which the system is
  solved several times, each from the forces of the last (the proximal method of multipliers): rows that depend on each
  other share their force, in any posture.

Rows that have no tree in common, or of a fixed base no joint, have no product: Cholesky's factor is kept within the
envelope (A. George, J. W. Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981, chapter 4).
"""

from typing import NamedTuple

import numpy as np

from ..compile.jit import inline, kernel
from ..compile.lanes import select, sqrt
from ..compile.optional import if_present, item
from ..compile.structure import structure
from .aba import root_inertia
from .forest import LARGEST, is_fixed, rows_of
from .joint import along
from .layout import DINV, UU, P, U
from .spatial import add, load3, scale, solve6, store3

ROOT = 0  # 6: force on the root as moment and force [N m; N]
DA = 6  # 6: acceleration that this gives the root [rad/s^2; m/s^2]; zero of the world
SIDE = 12  # numbers of a side at the root

# Columns of a block.
KIND = 0
SOURCE = 1  # its record in the table of its kind
ROW = 2  # its first row
SIZE = 3  # rows
RIGID = 4  # 1: its rows are rigid, and W is diagonal
TREE = 5  # 2: numbers of the trees, the second -1 if there is one
LOW = 7  # 2: first body of each tree whose joint it turns
HIGH = 9  # 2: last one
BLOCK = 11
COUPLED, LOOPED, TIED, TOUCHING = range(4)  # kinds: couplings of joints, loops, tendons, points between bodies

# Columns of a row's numbers.
FIRST = 0  # f0 [N or N m]
OPEN = 1  # what rigid rows are to take away: J a0 + b and L f0, or a gap
RIGHT = 2  # right side of the system
SOLUTION = 3  # g
COMPLIANCE = 4  # C of a rigid row, 0 of a slope
FORCE = 5  # f
LEAST = 6  # of a rigid row: diagonal of L below which it moves nothing but by rounding
GIVEN = 7  # of a slope: the part of f0 that W makes of this
NUMBERS = 8

MOST = 6  # rows of a block
GROUP = 3  # rows of a block that have one unit
LOOP = 14  # columns of a row of a loop: see loop.py

# Compliance of a row, by its diagonal of L, and rounds of the iteration: of a combination of rows with the eigenvalue k
# of the scaled L they leave (compliance / (compliance + k))^rounds.  In a step the rows of intermediate states, which
# are open by the square of the step, contradict each other where they depend on each other at closed ones.
EXACT, IN_STEP = (1e-8, 10), (1e-6, 4)
# Rows of a block with one unit are scaled by their own diagonal of L, but as if it were at least so much of the largest
# among them.  Where digits of a file let axes differ a little, a row across a plane moves by that little alone, and
# what it contradicts the others by would become a force larger by its inverse.
ALIKE = 1e-4
FLAT = 1e-100  # square root of a slope below which it is none
OFF = 1e300  # `LEAST` of a row that is open


@structure
class Rows(NamedTuple):
    """Scratch of rows."""

    block: np.ndarray  # (blocks, BLOCK)
    system: np.ndarray  # (trees, 4) of the last system of each set of trees: first block, end, first row, count
    number: np.ndarray  # (trees,) 0, 1 ...
    first: np.ndarray  # (rows,) column of the system with which each row begins
    loops: np.ndarray | None  # (rows of loops, LOOP)
    responses: np.ndarray  # (rows, sides, bodies of the largest tree) u
    roots: np.ndarray  # (rows, sides, SIDE)
    factor: np.ndarray  # (rows, MOST) W, row by row
    numbers: np.ndarray  # (rows, NUMBERS)
    matrix: np.ndarray  # (rows, rows) of the largest system

    SHARED = ("block", "system", "number", "first")


def make_rows(blocks, rows, trees, loops, zeros):
    """Make the scratch of so many blocks and rows; zeros(shape) makes arrays of numbers.

    trees: how many there are, and the bodies of the largest; loops: rows of loops.
    """
    count, bodies = trees
    sides = min(count, 2)
    return Rows(
        block=np.zeros((blocks, BLOCK), np.int64), system=np.zeros((count, 4), np.int64), number=np.arange(count),
        first=np.zeros(rows, np.int64), loops=zeros((loops, LOOP)) if loops else None,
        responses=zeros((rows, sides, bodies)), roots=zeros((rows, sides, SIDE)), factor=zeros((rows, MOST)),
        numbers=zeros((rows, NUMBERS)), matrix=zeros((rows, rows)),
    )  # fmt: skip


# ------------------------------------------------------------------------------------------------- blocks


@inline
def add_block(rows, end, kind, source, size, trees):
    """Add a block of slopes after `end`, which is a block and a row; return the end after it."""
    (b, r), B = end, rows.block
    B[b, KIND], B[b, SOURCE], B[b, ROW], B[b, SIZE], B[b, RIGID] = kind, source, r, size, 0
    B[b, TREE], B[b, TREE + 1] = trees[0], trees[1] if trees[1] != trees[0] else -1
    return b + 1, r + size


@inline
def entry_of(b, column, rows):
    """Return a number of a block that is not negative: LLVM knows it by the mask, and indices need no check."""
    return rows.block[b, column] & LARGEST


@inline
def span_of(b, rows):
    """Return the first row of a block and the one after the last."""
    start = entry_of(b, ROW, rows)
    return start, start + (rows.block[b, SIZE] & 7)


@inline
def sides_of(trees):
    """Return how many sides a block may have."""
    if trees is None:
        return 1
    return 2


@inline
def _is_there(trees, b, side, rows):
    """Return whether a block has a side."""
    if trees is None:
        return True
    return rows.block[b, TREE + side] >= 0


@inline
def _is_common(trees, b, side, c, other, rows):
    """Return whether sides of two blocks are on one tree."""
    if trees is None:
        return True
    tree = rows.block[b, TREE + side]
    return tree >= 0 and tree == rows.block[c, TREE + other]


@inline
def place_of(scene, b, side, rows):
    """Return the root of a side's tree, and the range of joints that the side turns, counted from there."""
    root, _ = rows_of(item(scene.trees, entry_of(b, TREE + side, rows)), scene.tree)
    return root, entry_of(b, LOW + side, rows), entry_of(b, HIGH + side, rows) + 1


@kernel
def clear_block(scene, b, W, rows):
    """Set the responses of a block to those of no force, and its numbers to those of slopes that are zero."""
    (start, end), zero = span_of(b, rows), 0.0 * W[0, P]
    for side in range(sides_of(scene.trees)):
        if _is_there(scene.trees, b, side, rows):
            root, last = rows_of(item(scene.trees, entry_of(b, TREE + side, rows)), scene.tree)
            rows.block[b, LOW + side], rows.block[b, HIGH + side] = last - root, 0
            for r in range(start, end):
                for i in range(last - root):
                    rows.responses[r, side, i] = zero
                for k in range(SIDE):
                    rows.roots[r, side, k] = zero
    for r in range(start, end):
        for k in range(end - start):
            rows.factor[r, k] = zero
        for k in range(NUMBERS):
            rows.numbers[r, k] = zero


@inline
def make_rigid(b, softness, rows):
    """Let the rows of a block be rigid; softness: EXACT or IN_STEP."""
    rows.block[b, RIGID] = 1
    start, end = span_of(b, rows)
    for r in range(start, end):
        rows.numbers[r, COMPLIANCE] = softness[0] + 0.0 * rows.numbers[r, COMPLIANCE]


# ------------------------------------------------------------------------------------------------- responses


@kernel
def push_body(tree, root, i, m, d, at, W, rows):
    """Add what a force d (3) [N] of moment m (3) [N m] about the common origin, on body i, leaves on its way.

    at: block, row and side.
    """
    n, f = scale(m, -1.0), scale(d, -1.0)
    if i > root:
        _walk(tree, root, i, -along(tree[i], i, n, f, W), n, f, at, W, rows)
    else:
        _arrive(n, f, at, rows)


@kernel
def push_joint(tree, root, i, torque, at, W, rows):
    """Add what a torque [N m or N] on the joint of body i leaves on its way."""
    u = torque + 0.0 * W[i, DINV]
    zero = 0.0 * u
    _walk(tree, root, i, u, (zero, zero, zero), (zero, zero, zero), at, W, rows)


@inline
def _walk(tree, root, i, u, n, f, at, W, rows):
    """Add u of all joints from that of body i to the root, and the force that arrives there."""
    b, r, side = at
    low = i
    rows.block[b, HIGH + side] = max(rows.block[b, HIGH + side], i - root)
    while i > root:
        i &= LARGEST
        rows.responses[r, side, (i - root) & LARGEST] += u
        x = u * W[i, DINV]
        n, f = add(n, scale(load3(W, i, U), x)), add(f, scale(load3(W, i, U + 3), x))
        low, i = i, tree[i].parent
        if i > root:
            u = -along(tree[i], i, n, f, W)
    rows.block[b, LOW + side] = min(rows.block[b, LOW + side], low - root)
    _arrive(n, f, at, rows)


@inline
def _arrive(n, f, at, rows):
    _, r, side = at
    for k in range(3):
        rows.roots[r, side, ROOT + k] += n[k]
        rows.roots[r, side, ROOT + 3 + k] += f[k]


@inline
def answer_base(scene, b, contact, W, rows):
    """Fill what floating bases answer to the rows of a block; contact: as the first pass had it."""
    _answer(scene.floating, scene, b, contact, W, rows)


@if_present()
def _answer(floating, scene, b, contact, W, rows):
    start, end = span_of(b, rows)
    for side in range(sides_of(scene.trees)):
        if _is_there(scene.trees, b, side, rows):
            part = item(scene.trees, entry_of(b, TREE + side, rows))
            if not is_fixed(part):
                J, H, M = root_inertia(scene.tree, part, contact, W)
                for r in range(start, end):
                    own = rows.roots[r]
                    a = solve6(J, H, M, load3(own, side, ROOT), load3(own, side, ROOT + 3))
                    store3(own, side, DA, (-a[0], -a[1], -a[2]))
                    store3(own, side, DA + 3, (-a[3], -a[4], -a[5]))


@inline
def _product(floating, place, one, other, W, rows):
    """Return J_r A^-1 J_s' [1/kg] of a side (row, side) of row r and one of row s, which act on one tree."""
    (root, low, high), (r, a), (s, b), u, total = place, one, other, rows.responses, 0.0 * W[place[0], DINV]
    for i in range(low, high):
        total = total + u[r, a, i] * u[s, b, i] * W[root + i, DINV]
    return _less_base(floating, total, one, other, rows.roots)


@inline
def _less_base(floating, total, one, other, roots):
    if floating is not None:
        (r, a), (s, b) = one, other
        for k in range(6):
            total = total - roots[r, a, ROOT + k] * roots[s, b, DA + k]
    return total


@inline
def _along(floating, place, one, W, rows):
    """Return J_r a [m/s^2] of a tree's solution, without forces of rows."""
    (root, low, high), (r, a), total = place, one, 0.0 * W[place[0], DINV]
    for i in range(low, high):
        total = total + rows.responses[r, a, i] * W[root + i, UU] * W[root + i, DINV]
    return _less_root(floating, total, one, root, W, rows.roots)


@inline
def _less_root(floating, total, one, root, W, roots):
    if floating is not None:
        r, a = one
        for k in range(6):
            total = total - roots[r, a, ROOT + k] * W[root, U + k]
    return total


# ------------------------------------------------------------------------------------------------- the system


@kernel
def fill_system(scene, system, W, rows):
    """Fill `OPEN` of the rows of a system, and the lower triangle of C + W' L W within its envelope.

    system: first block, end, first row, count.  `OPEN` holds the bias before.
    """
    first, last, begin = system[0] & LARGEST, system[1] & LARGEST, system[2] & LARGEST
    for b in range(first, last):
        _fill_own(scene, b, W, rows)
    if system[3] == 1:
        _fill_one(scene, first, begin, W, rows)
        return
    for b in range(first, last):
        whole = b
        for c in range(first, b + 1):
            if c == b or _have_product(scene, b, c, rows):
                whole = min(whole, c)
                _fill_block(scene, b, c, begin, W, rows)
            elif whole < c:
                _clear_between(b, c, begin, rows)
        start, end = span_of(b, rows)
        for r in range(start, end):
            rows.first[r] = entry_of(whole, ROW, rows) - begin
    for b in range(first, last):
        if rows.block[b, RIGID] == 1:
            _scale_rigid(b, begin, rows)
        for c in range(first, b + 1):
            if entry_of(c, ROW, rows) - begin >= rows.first[entry_of(b, ROW, rows)]:
                _take_slopes(b, c, begin, rows)
        start, end = span_of(b, rows)
        for r in range(start, end):
            one = rows.numbers[r, COMPLIANCE] if rows.block[b, RIGID] == 1 else 1.0
            rows.matrix[r, r - begin] = rows.matrix[r, r - begin] + one


@inline
def _fill_one(scene, b, r, W, rows):
    """Do the same for a system of one row, without the loops over rows: a fifth of the instructions."""
    N, F, x = rows.numbers, rows.factor, 0.0 * W[0, P]
    for side in range(sides_of(scene.trees)):
        if _is_there(scene.trees, b, side, rows):
            x = x + _product(scene.floating, place_of(scene, b, side, rows), (r, side), (r, side), W, rows)
    one = 1.0 + 0.0 * x
    if rows.block[b, RIGID] == 1:
        movable, one = x > N[r, LEAST], N[r, COMPLIANCE]
        F[r, 0] = select(movable, 1.0 / sqrt(select(movable, x, 1.0 + 0.0 * x)), 0.0 * x)
    else:
        N[r, OPEN] = N[r, OPEN] + x * N[r, FIRST]
    rows.matrix[r, 0], rows.first[r] = x * F[r, 0] * F[r, 0] + one, 0


@inline
def _fill_own(scene, b, W, rows):
    """Fill `OPEN` of a block with J a0 and the bias, and split its first forces."""
    (start, end), N = span_of(b, rows), rows.numbers
    for r in range(start, end):
        N[r, RIGHT] = 0.0 * N[r, RIGHT]
    for side in range(sides_of(scene.trees)):
        if _is_there(scene.trees, b, side, rows):
            place = place_of(scene, b, side, rows)
            for r in range(start, end):
                N[r, RIGHT] = N[r, RIGHT] + _along(scene.floating, place, (r, side), W, rows)
    for r in range(start, end):
        N[r, OPEN] = N[r, RIGHT] + N[r, OPEN]
    if rows.block[b, RIGID] == 0:
        _split_first(b, rows)


@inline
def _split_first(b, rows):
    """Split the first forces of slopes to W times `GIVEN` and what no slope can make, which stays in `FIRST`.

    A stiff law has a first force that is larger than the force by many digits; in this form it takes none of these.
    """
    N, F, (start, end) = rows.numbers, rows.factor, span_of(b, rows)
    for r in range(start, end):
        left, slope = N[r, FIRST], F[r, r - start]
        for s in range(start, r):
            left = left - F[r, s - start] * N[s, GIVEN]
        some = slope > FLAT
        N[r, GIVEN] = select(some, left / select(some, slope, 1.0 + 0.0 * slope), 0.0 * left)
        N[r, FIRST] = select(some, 0.0 * left, left)


@inline
def _have_product(scene, b, c, rows):
    """Return whether a row of one block may move one of the other."""
    found = False
    for side in range(sides_of(scene.trees)):
        for other in range(sides_of(scene.trees)):
            if _is_common(scene.trees, b, side, c, other, rows):
                low = max(rows.block[b, LOW + side], rows.block[c, LOW + other])
                high = min(rows.block[b, HIGH + side], rows.block[c, HIGH + other])
                tree = entry_of(b, TREE + side, rows)
                found = found or low <= high or _floats(scene.floating, scene.trees, tree)
    return found


@if_present(False)
def _floats(floating, trees, k):
    return not is_fixed(item(trees, k))


@kernel
def _fill_block(scene, b, c, begin, W, rows):
    """Fill the block of L of two blocks of rows; what it makes of first forces joins `OPEN` of both."""
    (start, end), (from_, to), N, L = span_of(b, rows), span_of(c, rows), rows.numbers, rows.matrix
    for r in range(start, end):
        for s in range(from_, min(to, r + 1)):
            L[r, s - begin] = 0.0 * W[0, P]
    for side in range(sides_of(scene.trees)):
        for other in range(sides_of(scene.trees)):
            if _is_common(scene.trees, b, side, c, other, rows):
                (root, low, high), (_, least, most) = place_of(scene, b, side, rows), place_of(scene, c, other, rows)
                place = root, max(low, least), min(high, most)
                for r in range(start, end):
                    for s in range(from_, min(to, r + 1)):
                        x = _product(scene.floating, place, (r, side), (s, other), W, rows)
                        L[r, s - begin] = L[r, s - begin] + x
    if rows.block[c, RIGID] == 0:
        for r in range(start, end):
            for s in range(from_, min(to, r + 1)):
                N[r, OPEN] = N[r, OPEN] + L[r, s - begin] * N[s, FIRST]
    if rows.block[b, RIGID] == 0:
        for r in range(start, end):
            for s in range(from_, min(to, r)):
                N[s, OPEN] = N[s, OPEN] + L[r, s - begin] * N[r, FIRST]
        if b == c:  # the whole block for a moment
            for r in range(start, end):
                for s in range(start, r):
                    L[s, r - begin] = L[r, s - begin]


@inline
def _clear_between(b, c, begin, rows):
    (start, end), (from_, to) = span_of(b, rows), span_of(c, rows)
    for r in range(start, end):
        for s in range(from_, to):
            rows.matrix[r, s - begin] = 0.0


@inline
def _scale_rigid(b, begin, rows):
    """Fill W of rigid rows: the scale to a unit diagonal or less, 0 of rows that do nothing."""
    (start, end), L, zero = span_of(b, rows), rows.matrix, 0.0 * rows.numbers[entry_of(b, ROW, rows), LEAST]
    for r in range(start, end):
        group = start + GROUP * ((r - start) // GROUP)
        size = L[r, r - begin]
        largest = size
        for s in range(group, min(group + GROUP, end)):
            largest = select(L[s, s - begin] > largest, L[s, s - begin], largest)
        movable, least = size > rows.numbers[r, LEAST], ALIKE * largest
        size = select(size > least, size, least)
        rows.factor[r, r - start] = select(movable, 1.0 / sqrt(select(movable, size, 1.0 + zero)), zero)


@inline
def _take_slopes(b, c, begin, rows):
    """Turn a block of L into that of W' L W; of the usual sizes the loops are unrolled."""
    (start, end), (from_, to) = span_of(b, rows), span_of(c, rows)
    rigid = rows.block[b, RIGID] == 1, rows.block[c, RIGID] == 1
    if end - start == 3 and to - from_ == 3:
        _take_sized(rigid, (start, 3), (from_, 3), begin, rows)
    else:
        _take_sized(rigid, (start, end - start), (from_, to - from_), begin, rows)


@inline
def _take_sized(rigid, one, other, begin, rows):
    """Do so for blocks given by their first row and size."""
    (p, m), (q, n), L, F = one, other, rows.matrix, rows.factor
    at = q - begin
    if rigid[0]:
        for r in range(m):
            for s in range(n):
                L[p + r, at + s] = L[p + r, at + s] * F[p + r, r]
    else:
        for s in range(n):
            for r in range(m):
                x = F[p + r, r] * L[p + r, at + s]
                for k in range(r + 1, m):
                    x = x + F[p + k, r] * L[p + k, at + s]
                L[p + r, at + s] = x
    if rigid[1]:
        for r in range(m):
            for s in range(n):
                L[p + r, at + s] = L[p + r, at + s] * F[q + s, s]
    else:
        for r in range(m):
            for s in range(n):
                x = L[p + r, at + s] * F[q + s, s]
                for k in range(s + 1, n):
                    x = x + L[p + r, at + k] * F[q + k, s]
                L[p + r, at + s] = x


@kernel
def factor_system(system, rows):
    """Replace the matrix by Cholesky's factor within the envelope, column by column; its diagonal is kept inverted."""
    begin, count, A, first = system[2] & LARGEST, system[3] & LARGEST, rows.matrix, rows.first
    for k in range(count):
        A[begin + k, k] = 1.0 / sqrt(A[begin + k, k])
        for i in range(k + 1, count):
            if first[begin + i] <= k:
                x = A[begin + i, k] * A[begin + k, k]
                A[begin + i, k] = x
                for j in range(k + 1, i + 1):
                    if first[begin + j] <= k:
                        A[begin + i, j] = A[begin + i, j] - x * A[begin + j, k]


@kernel
def solve_system(system, rounds, rows):
    """Find the forces that take `OPEN` away, in the factor; rounds: of the iteration, 1 without rigid rows."""
    first, last, begin, count = system[0] & LARGEST, system[1] & LARGEST, system[2] & LARGEST, system[3] & LARGEST
    N, F = rows.numbers, rows.factor
    if count == 1:
        _solve_one(begin, rounds, rows)
        return
    for b in range(first, last):
        start, end = span_of(b, rows)
        for r in range(start, end):
            x = N[r, OPEN] * F[r, r - start]
            if rows.block[b, RIGID] == 0:
                for k in range(r + 1, end):
                    x = x + F[k, r - start] * N[k, OPEN]
            N[r, RIGHT], N[r, SOLUTION] = N[r, GIVEN] - x, 0.0 * x
    for _ in range(rounds):
        for r in range(begin, begin + count):
            N[r, SOLUTION] = N[r, RIGHT] + N[r, COMPLIANCE] * N[r, SOLUTION]
        _substitute(begin, count, rows)
    for b in range(first, last):
        start, end = span_of(b, rows)
        for r in range(start, end):
            x = N[r, SOLUTION] * F[r, r - start]
            if rows.block[b, RIGID] == 0:
                for s in range(start, r):
                    x = x + F[r, s - start] * N[s, SOLUTION]
            N[r, FORCE] = x + N[r, FIRST]


@inline
def _solve_one(r, rounds, rows):
    N, F, d = rows.numbers, rows.factor[r, 0], rows.matrix[r, 0]
    right, x = N[r, GIVEN] - N[r, OPEN] * F, 0.0 * d
    for _ in range(rounds):
        x = (right + N[r, COMPLIANCE] * x) * d * d
    N[r, FORCE] = x * F + N[r, FIRST]


@inline
def _substitute(begin, count, rows):
    A, first, N = rows.matrix, rows.first, rows.numbers
    for r in range(count):
        y = N[begin + r, SOLUTION]
        for k in range(first[begin + r] & LARGEST, r):
            y = y - A[begin + r, k] * N[begin + k, SOLUTION]
        N[begin + r, SOLUTION] = y * A[begin + r, r]
    for t in range(count):
        r = count - 1 - t
        y = N[begin + r, SOLUTION]
        for k in range(r + 1, count):
            if first[begin + k] <= r:
                y = y - A[begin + k, r] * N[begin + k, SOLUTION]
        N[begin + r, SOLUTION] = y * A[begin + r, r]


@kernel
def apply_forces(scene, system, W, rows):
    """Let the forces of a system act on the solutions that the first pass has left."""
    for b in range(system[0] & LARGEST, system[1] & LARGEST):
        start, end = span_of(b, rows)
        for side in range(sides_of(scene.trees)):
            if _is_there(scene.trees, b, side, rows):
                root, low, high = place_of(scene, b, side, rows)
                for r in range(start, end):
                    f = rows.numbers[r, FORCE]
                    for i in range(low, high):
                        W[root + i, UU] += f * rows.responses[r, side, i]
                    move_root(scene.floating, root, f, (r, side), W, rows.roots)


@inline
def move_root(floating, root, f, one, W, roots):
    """Add what a floating base answers to the force f of a row's side to dA of the root."""
    if floating is not None:
        r, a = one
        for k in range(6):
            W[root, U + k] += f * roots[r, a, DA + k]
