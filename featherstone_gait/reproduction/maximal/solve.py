"""Find the forces of the rows: by some sweeps in an order that is shuffled now and then, or directly.

The problem, as ODE's manual states it (chapter "Concepts", R. Smith): find lambda within its bounds such that
(J M^-1 J' + CFM / h) lambda = right side in each row whose force is at none of them.

Swept (projected successive over-relaxation), one row after the other is solved for its own force, taken beyond the
solution by the factor of relaxation and put back between its bounds; those of a friction row follow the normal force
that has been found so far.  Each step begins without any forces.

Directly: guess the rows at a bound, solve the linear system of the rest, mend the guess, a semi-smooth Newton iteration
on lambda = clamp(lambda - (A lambda - right) / diagonal, low, high), the bounds of friction rows among the unknowns.
Where it finds no end the rows are swept until they change no more.
"""

from __future__ import annotations

from typing import Any

from ...core.compile.jit import inline, kernel
from .bodies import kept

RELAXATION, SHUFFLE_EVERY = 1.3, 8  # of ODE's; the second in sweeps, the first of which follows a shuffle
# The generator of P. L'Ecuyer (Communications of the ACM 31, 1988, 742): two combined, of period 2.3e18.
P1, P2, A1, A2 = 2147483563, 2147483399, 40014, 40692
GUESSES, SWEEPS, TOLERANCE = 40, 20000, 1e-12
BETWEEN, AT_LOW, AT_HIGH = 0, 1, 2  # the first as rows begin


@kernel
def solve(w: Any, x: Any, rows: int) -> None:
    """Fill the forces of the rows and the bodies' accelerations S, by the engine's number of sweeps or directly."""
    e = w.engine[0]
    if e.iterations == 0:
        _solve_directly(w, x, rows)
    else:
        _accelerations(w, x, rows)
        _start_order(x, rows)
    for done in range(e.iterations):
        if done % SHUFFLE_EVERY == 0:
            _shuffle(x.order, x.random, rows)
        for k in range(rows):
            _relax_row(x, x.order[k], RELAXATION, e.single)


@inline
def _start_order(x: Any, rows: int) -> None:
    """Order the rows, friction rows last, because their bounds depend on the others."""
    k = 0
    for friction in range(2):
        for m in range(rows):
            if (x.rows[m].normal >= 0) == (friction == 1):
                x.order[k] = m
                k += 1


@inline
def _shuffle(order: Any, random: Any, rows: int) -> None:
    """Shuffle the rows, and advance random (2,)."""
    for k in range(1, rows):
        random[0] = A1 * random[0] % P1
        random[1] = A2 * random[1] % P2
        j = (random[0] - random[1]) % (P1 - 1) * (k + 1) // (P1 - 1)
        order[k], order[j] = order[j], order[k]


@inline
def _accelerations(w: Any, x: Any, rows: int) -> None:
    """Compute the accelerations S by the present forces."""
    for i in range(len(w.bodies)):
        for c in range(6):
            x.S[i, c] = 0.0
    for m in range(rows):
        row = x.rows[m]
        for c in range(6):
            x.S[row.a, c] += x.M[m, c] * row.force
            x.S[row.b, c] += x.M[m, 6 + c] * row.force


@inline
def _bounds(x: Any, row: Any) -> Any:
    """Return the bounds of the force of a row."""
    if row.normal >= 0:
        normal = max(x.rows[row.normal].force, 0.0)
        return row.low * normal, row.high * normal
    return row.low, row.high


@inline
def _missing(x: Any, m: int) -> float:
    """Return what the left side of row m misses of its right one."""
    row = x.rows[m]
    rest = row.right - row.soft * row.force
    for c in range(6):
        rest -= x.J[m, c] * x.S[row.a, c] + x.J[m, 6 + c] * x.S[row.b, c]
    return rest


@inline
def _relax_row(x: Any, m: int, relaxation: float, single: int) -> float:
    """Solve row m for its force; return the change."""
    M, S, row = x.M, x.S, x.rows[m]
    a, b, last, (low, high) = row.a, row.b, row.force, _bounds(x, row)
    row.force = kept(min(max(last + relaxation * _missing(x, m) / row.divisor, low), high), single)
    change = row.force - last
    for c in range(6):
        S[a, c] = kept(S[a, c] + M[m, c] * change, single)
        S[b, c] = kept(S[b, c] + M[m, 6 + c] * change, single)
    return change


@inline
def _solve_directly(w: Any, x: Any, rows: int) -> None:
    for _ in range(GUESSES):
        _system(x, rows)
        _eliminate(x.D, rows)
        for m in range(rows):
            x.rows[m].force = x.D[m, rows]
        _accelerations(w, x, rows)
        if not _mended(x, rows):
            return
    x.unsolved[0] += 1
    for m in range(rows):
        low, high = _bounds(x, x.rows[m])
        x.rows[m].force = min(max(x.rows[m].force, low), high)
    _accelerations(w, x, rows)
    for _ in range(SWEEPS):
        most, largest = 0.0, 0.0
        for m in range(rows):
            most = max(most, abs(_relax_row(x, m, 1.0, 0)))
            largest = max(largest, abs(x.rows[m].force))
        if most <= TOLERANCE * largest:
            break


@inline
def _mended(x: Any, rows: int) -> bool:
    """Move each row to the bound or interval of its solution; return whether one has moved."""
    changed = False
    for m in range(rows):
        row = x.rows[m]
        low, high = _bounds(x, row)
        there = row.force + _missing(x, m) / row.divisor
        state, slack = BETWEEN, 1e-12 * (abs(there) + 1e-9)
        if there < low - slack:
            state = AT_LOW
        elif there > high + slack:
            state = AT_HIGH
        elif row.state != BETWEEN and (abs(there - low) <= slack or abs(there - high) <= slack):
            state = row.state
        if state != row.state:
            row.state = state
            changed = True
    return changed


@inline
def _system(x: Any, rows: int) -> None:
    """Fill D with a linear equation of each row: its constraint, or the bound that it is at."""
    D = x.D
    for m in range(rows):
        row = x.rows[m]
        if row.state == BETWEEN:
            for k in range(rows):
                D[m, k] = _coupling(x, m, k)
            D[m, m] += row.soft
            D[m, rows] = row.right
        else:
            bound = row.low if row.state == AT_LOW else row.high
            for k in range(rows + 1):
                D[m, k] = 0.0
            D[m, m] = 1.0
            if row.normal >= 0:
                D[m, row.normal] = -bound
            else:
                D[m, rows] = bound


@inline
def _coupling(x: Any, m: int, k: int) -> float:
    """Return J M^-1 J' of two rows."""
    total, one, other = 0.0, x.rows[m], x.rows[k]
    for s in range(2):
        for t in range(2):
            if (one.b if s else one.a) == (other.b if t else other.a):
                for c in range(6):
                    total += x.J[m, 6 * s + c] * x.M[k, 6 * t + c]
    return total


@inline
def _eliminate(D: Any, rows: int) -> None:
    """Eliminate with partial pivoting; the solution is in the last column."""
    for k in range(rows):
        p = k
        for m in range(k + 1, rows):
            if abs(D[m, k]) > abs(D[p, k]):
                p = m
        for c in range(k, rows + 1):
            D[k, c], D[p, c] = D[p, c], D[k, c]
        if abs(D[k, k]) <= 1e-12:
            D[k, k] = 1e-12
        for m in range(k + 1, rows):
            f = D[m, k] / D[k, k]
            if f != 0.0:
                for c in range(k, rows + 1):
                    D[m, c] -= f * D[k, c]
    for m in range(rows - 1, -1, -1):
        for c in range(m + 1, rows):
            D[m, rows] -= D[m, c] * D[c, rows]
        D[m, rows] /= D[m, m]
