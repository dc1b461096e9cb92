"""Projected successive over-relaxation: some sweeps over the rows, in an order that is shuffled now and then.

The problem, as ODE's manual states it (chapter "Concepts", R. Smith): find lambda within its bounds such that
(J M^-1 J' + CFM / h) lambda = right side in each row whose force is at none of them.  One row after the other is solved
for its own force, which is taken beyond the solution by the factor of relaxation and put back between its bounds; those
of a friction row follow the normal force that has been found so far.  Each step begins without any forces.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.compile.jit import inline, kernel
from .bodies import kept
from .layout import DIAGONAL, HIGH, LAMBDA, LOW, NORMAL, RIGHT, SOFT, A, B

# The generator of P. L'Ecuyer (Communications of the ACM 31, 1988, 742): two combined, of period 2.3e18.
P1, P2, A1, A2 = 2147483563, 2147483399, 40014, 40692


@inline
def random_below(random: np.ndarray, n: int) -> int:
    """Return a random number from 0 to n - 1, and advance random (2,)."""
    random[0] = A1 * random[0] % P1
    random[1] = A2 * random[1] % P2
    z = (random[0] - random[1]) % (P1 - 1)
    return z * n // (P1 - 1)


@inline
def _shuffle(x: Any, rows: int) -> None:
    order = x.order
    for k in range(1, rows):
        j = random_below(x.random, k + 1)
        order[k], order[j] = order[j], order[k]


@inline
def start_order(x: Any, rows: int) -> None:
    """Order the rows, friction rows last, because their bounds depend on the others."""
    k = 0
    for m in range(rows):
        if x.I[m, NORMAL] < 0:
            x.order[k] = m
            k += 1
    for m in range(rows):
        if x.I[m, NORMAL] >= 0:
            x.order[k] = m
            k += 1


@kernel
def relax(w: Any, x: Any, rows: int) -> None:
    """Fill lambda and the bodies' accelerations S by the engine's number of sweeps."""
    e = w.engine[0]
    clear(w, x)
    start_order(x, rows)
    for sweep in range(e.iterations):
        if e.shuffle_every > 0:
            if sweep % e.shuffle_every == 0:
                _shuffle(x, rows)
        for k in range(rows):
            _relax_row(x, x.order[k], e.relaxation, e.single)


@inline
def clear(w: Any, x: Any) -> None:
    """Set the accelerations to zero."""
    for i in range(len(w.bodies)):
        for k in range(6):
            x.S[i, k] = 0.0


@inline
def bounds(x: Any, m: int) -> Any:
    """Return the bounds of the force of row m."""
    V, n = x.V, x.I[m, NORMAL]
    if n >= 0:
        return V[m, LOW] * V[n, LAMBDA], V[m, HIGH] * V[n, LAMBDA]
    return V[m, LOW], V[m, HIGH]


@inline
def _relax_row(x: Any, m: int, relaxation: float, single: int) -> float:
    """Solve row m for its force; return the change."""
    V, J, M, S = x.V, x.J, x.M, x.S
    a, b, last = x.I[m, A], x.I[m, B], V[m, LAMBDA]
    rest = V[m, RIGHT] - V[m, SOFT] * last
    for c in range(6):
        rest -= J[m, c] * S[a, c] + J[m, 6 + c] * S[b, c]
    low, high = bounds(x, m)
    force = kept(min(max(last + relaxation * rest / V[m, DIAGONAL], low), high), single)
    change = force - last
    V[m, LAMBDA] = force
    for c in range(6):
        S[a, c] = kept(S[a, c] + M[m, c] * change, single)
        S[b, c] = kept(S[b, c] + M[m, 6 + c] * change, single)
    return change


@kernel
def relax_until(w: Any, x: Any, rows: int, sweeps: int, tolerance: float) -> int:
    """Sweep from the present forces, in order and without rounding; return the number of sweeps.

    Ends where no row's force changes by more than the tolerance, of the largest force.
    """
    clear(w, x)
    for m in range(rows):
        for c in range(6):
            x.S[x.I[m, A], c] += x.M[m, c] * x.V[m, LAMBDA]
            x.S[x.I[m, B], c] += x.M[m, 6 + c] * x.V[m, LAMBDA]
    for sweep in range(sweeps):
        most, largest = 0.0, 0.0
        for m in range(rows):
            most = max(most, abs(_relax_row(x, m, 1.0, 0)))
            largest = max(largest, abs(x.V[m, LAMBDA]))
        if most <= tolerance * largest:
            return sweep + 1
    return sweeps
