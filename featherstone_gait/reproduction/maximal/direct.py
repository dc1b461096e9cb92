"""Solve the same problem directly: guess the rows at a bound, solve the linear system of the rest, mend the guess.

A semi-smooth Newton iteration on lambda = clamp(lambda - (A lambda - right) / diagonal, low, high), the bounds of
friction rows among the unknowns.  Where it finds no end the rows are swept until they change no more.
"""

from __future__ import annotations

from typing import Any

from ...core.compile.jit import inline, kernel
from .layout import DIAGONAL, HIGH, LAMBDA, LOW, NORMAL, RIGHT, SOFT, STATE, A, B
from .psor import bounds, clear, relax_until

GUESSES, SWEEPS, TOLERANCE = 40, 20000, 1e-12
BETWEEN, AT_LOW, AT_HIGH = 0, 1, 2


@kernel
def solve(w: Any, x: Any, rows: int) -> None:
    """Fill lambda and the bodies' accelerations S."""
    V, I = x.V, x.I
    for m in range(rows):
        I[m, STATE] = BETWEEN
    for _ in range(GUESSES):
        _system(x, rows)
        _eliminate(x.D, rows)
        for m in range(rows):
            V[m, LAMBDA] = x.D[m, rows]
        _accelerations(w, x, rows)
        if not _mended(x, rows):
            return
    x.counts[1] += 1
    for m in range(rows):
        low, high = bounds(x, m)
        V[m, LAMBDA] = min(max(V[m, LAMBDA], low), max(low, high))
    x.counts[2] += relax_until(w, x, rows, SWEEPS, TOLERANCE)


@inline
def _accelerations(w: Any, x: Any, rows: int) -> None:
    clear(w, x)
    for m in range(rows):
        a, b = x.I[m, A], x.I[m, B]
        for c in range(6):
            x.S[a, c] += x.M[m, c] * x.V[m, LAMBDA]
            x.S[b, c] += x.M[m, 6 + c] * x.V[m, LAMBDA]


@inline
def _mended(x: Any, rows: int) -> bool:
    """Move each row to the bound or interval of its solution; return whether one has moved."""
    V, I, changed = x.V, x.I, False
    for m in range(rows):
        rest = V[m, RIGHT] - V[m, SOFT] * V[m, LAMBDA]
        for c in range(6):
            rest -= x.J[m, c] * x.S[I[m, A], c] + x.J[m, 6 + c] * x.S[I[m, B], c]
        n, low, high = I[m, NORMAL], V[m, LOW], V[m, HIGH]
        if n >= 0:
            normal = max(V[n, LAMBDA], 0.0)
            low, high = low * normal, high * normal
        there = V[m, LAMBDA] + rest / V[m, DIAGONAL]
        state, slack = BETWEEN, 1e-12 * (abs(there) + 1e-9)
        if there < low - slack:
            state = AT_LOW
        elif there > high + slack:
            state = AT_HIGH
        elif I[m, STATE] != BETWEEN and (abs(there - low) <= slack or abs(there - high) <= slack):
            state = I[m, STATE]
        if state != I[m, STATE]:
            I[m, STATE] = state
            changed = True
    return changed


@inline
def _system(x: Any, rows: int) -> None:
    D, V, I = x.D, x.V, x.I
    for m in range(rows):
        n, state = I[m, NORMAL], I[m, STATE]
        if state == BETWEEN:
            for k in range(rows):
                D[m, k] = _coupling(x, m, k)
            D[m, m] += V[m, SOFT]
            D[m, rows] = V[m, RIGHT]
        else:
            bound = V[m, LOW] if state == AT_LOW else V[m, HIGH]
            for k in range(rows):
                D[m, k] = 0.0
            D[m, m] = 1.0
            if n >= 0:
                D[m, n] = -bound
                bound = 0.0
            D[m, rows] = bound


@inline
def _coupling(x: Any, m: int, k: int) -> float:
    """Return J M^-1 J' of two rows."""
    total = 0.0
    for s in range(2):
        for t in range(2):
            if x.I[m, s] == x.I[k, t]:
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
        if p != k:
            for c in range(k, rows + 1):
                D[k, c], D[p, c] = D[p, c], D[k, c]
        pivot = D[k, k] if abs(D[k, k]) > 1e-12 else 1e-12
        for m in range(k + 1, rows):
            f = D[m, k] / pivot
            if f != 0.0:
                for c in range(k, rows + 1):
                    D[m, c] -= f * D[k, c]
    for m in range(rows - 1, -1, -1):
        total = D[m, rows]
        for c in range(m + 1, rows):
            total -= D[m, c] * D[c, rows]
        D[m, rows] = total / (D[m, m] if abs(D[m, m]) > 1e-12 else 1e-12)
