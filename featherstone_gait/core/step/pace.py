"""Step control, common to the adaptive integrators: its numbers, the scale of errors, the end of the interval."""

from ..compile.elementary import exp
from ..compile.jit import inline, kernel

# Numbers of the array `pace`.
STEP = 0  # next step to try [s]
COLUMNS = 1  # of the extrapolation table, aimed at
STEPS = 2  # taken
REJECTED = 3
EVALUATIONS = 4  # of the derivative, or linearly implicit steps
LAST = 5  # error of the step before, by the tolerance
PACE = 6  # of these a state keeps
# The interval between two events, within which pushes and signals are smooth [s].
SINCE = 6
UNTIL = 7
# Of a run that has paused: where it goes on.
GRID = 8  # grid step at which the interval began, plus 1; 0 of a run that has not paused
INSIDE = 9  # time since [s], -1 of an interval that is still to begin
EVENT = 10  # at which the smooth part of the interval ends, by that clock [s]
NEXT = 11  # record
# Of a run that does not get on: see `_gets_on` in core/integrate/adaptive.py.
ATTEMPTS = 12  # at steps, at which its progress is looked at next
MARK = 13  # time when it was looked at last [s]
SIZE = 14  # of the array


@inline
def in_time(step, length):
    """Return the step [s], or one that leaves no sliver of the remaining `length` [s]."""
    if step >= 0.999 * length:
        return length
    if step >= 0.5 * length:
        return 0.5 * length
    return step


@inline
def scaled(plan, error, before, after):
    """Return the size of an error over the tolerance [-], of a number that went from `before` to `after`."""
    return abs(error) / (plan.atol + plan.rtol * max(abs(before), abs(after)))


@inline
def meters(motor):
    """Return how many joints have an electrical energy whose error counts."""
    if motor is None:
        return 0
    return len(motor)


@kernel
def root(x, n):
    """Return x ** (1 / n) to six digits, enough for a step; x >= 0, infinite and NaN taken as 1e60."""
    if not x < 1e60:
        x = 1e60
    x = max(x, 1e-60)
    octaves = 0.0
    while x > 1.4:
        x *= 0.5
        octaves += 1.0
    while x < 0.7:
        x *= 2.0
        octaves -= 1.0
    z = (x - 1.0) / (x + 1.0)
    w = z * z
    log = 2.0 * z * (1.0 + w * (1.0 / 3.0 + w * (0.2 + w * (1.0 / 7.0 + w * (1.0 / 9.0)))))
    return exp((log + octaves * 0.6931471805599453) / n)
