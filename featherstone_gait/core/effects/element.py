"""Forces that depend on a speed: how each is described, and what Newton's iteration does with it, once for all kinds.

An *element* is a force f(u) of one to three numbers, which never rises with its speed u: the torque on a joint with
that on its rotor, the force at a contact point or its moment, the drag of a shape, the force of a tendon, the force
between two bodies.  So it is the slope of a convex function of u with the sign reversed (core/step/newton.py), and
the iteration keeps four values of it, each of as many numbers,

    ITERATE    the speed about which f is linearized
    SOLUTION   the speed that the solution of the linear model gives
    MODEL      the force of the linear model there
    INERTIAL   the inertial force at the iterate: that is linear in the speeds, and equals MODEL at each solution

of which everything follows: where f at the solution is not the model's, how fast the convex function falls along a
pass, from ITERATE to SOLUTION, at any fraction of it, and where the iterate goes.

A *kind* of elements is the structure of what a scene has of it (Contact, Tendons, Fluid ...), None where it has none,
which then costs nothing.  By its type it implements what differs, all else holds for all:

    place, linearize, fold, solve   the elements of a tree at the predicted state, their linear models about ITERATE,
                                    these in the linear system, SOLUTION and MODEL of its solution
    move, rates                     a step's end: states and work; all of this as a differential equation
    elements, belongs               the elements of a tree: first and end of their indices, and which of these are its
    force_at                        the law: f at a speed u
    load, keep                      where the four values stand; if not said, in a row of `C`
    differs, snap                   which difference is an error; a speed of rest that a pass comes by

step/newton.py has the list of kinds; a new effect is a structure with these functions, and a word in that list.
"""

from ..compile.by_type import by_type, overridable
from ..compile.each import componentwise
from ..compile.jit import inline, kernel
from ..compile.lanes import select
from ..compile.taped import constant
from ..tree.forest import base_index
from ..tree.spatial import load3, store3

ITERATE, SOLUTION, MODEL, INERTIAL = range(4)
FLOOR = 1e-11  # of the forces that Newton's iteration compares [N m, N]

# Columns of a row of the scratch `C`, for all kinds that have their elements there.
XP = 0  # 3: position in the common frame [m]
U0 = 4  # 3: predicted velocity
UK = 7  # 3 each: ITERATE, SOLUTION, MODEL, INERTIAL
UN = 10
FL = 13
FK = 19  # 3: forces at the iterate

# Columns of the scratch `N`, one row a tree.
AT_WORK = 0  # 1 where Newton's iteration goes on
WRONG = 1  # above 0 where a force is not that of the linear model
SLOPE = 2  # of the descent [W]
FRACTION = 3  # of the pass by which the iterate moves
RISES = 4  # 1 where the descent ends before the pass does
SHARED = 5
OF_TREES = 6


# ---------------------------------------------------------------------------------------------- what a kind implements


@overridable
def place(kind, step):
    """Fill what a tree's elements take of the predicted state, to which W belongs; it is their first ITERATE."""


@overridable
def linearize(kind, step):
    """Fill forces and slopes at ITERATE."""


@overridable
def fold(kind, step):
    """Add the linear model's slopes, and its forces at the predicted velocity, to the linear system."""


@overridable
def solve(kind, step):
    """Fill SOLUTION and MODEL by the solution of the linear system."""


@overridable
def move(kind, step):
    """Move what an effect has of the state to the end of the step, and its work."""


@overridable
def rates(kind, step, dy):
    """Place the elements at the present state, let their forces act, and fill the rates of their state and work."""


@by_type
def elements(kind, step):
    """Return the index of a tree's first element, and the one after the last."""


@overridable
def belongs(kind, c, step):
    """Return whether the element c of these is the tree's."""
    return True


@by_type
def force_at(kind, c, u, step):
    """Return the force of the element c at the speed u, both tuples."""


@overridable
def load(kind, c, which, step):
    """Return a value of the element c: ITERATE ..."""
    return load3(step.C, c, UK + 3 * which)


@overridable
def keep(kind, c, which, x, step):
    """Store a value of the element c."""
    store3(step.C, c, UK + 3 * which, x)


@overridable
def differs(kind, c, u, f, error, step):
    """Return where the force f at SOLUTION, u, differs from MODEL by more than the tolerance."""
    return _size(error) > step.tolerance * _size(f) + FLOOR


@overridable
def snap(kind, c, u, here, there, where, step):
    """Return the next ITERATE u, or a speed of rest close to it, between `here` and `there`, the ends of a pass."""
    return u


# ---------------------------------------------------------------------------------------------- what holds for all


_difference = componentwise("{0} - {1}")
_between = componentwise("{0} + {2} * ({1} - {0})")
_dot = componentwise("{0} * {1}", " + ")
_size = componentwise("abs({0})", " + ")


@inline
def shifted(x, to, fraction, active):
    """Return x moved toward `to` by the fraction of a pass, in the lanes still at work: a constant to gradients."""
    return constant(select(active, select(fraction < 1.0, x + fraction * (to - x), to), x))


_shifted = componentwise("shifted({0}, {1}, {2}, {3})", shifted=shifted)


@inline
def with_element(fraction, kind, c, step, wrong, slope):
    """Return `slope` with the element's part of the slope of the convex function at a fraction of the pass [W].

    fraction None: at the end of the pass, and `wrong` too, also where the force there is not the linear model's.
    """
    here, there = load(kind, c, ITERATE, step), load(kind, c, SOLUTION, step)
    if fraction is None:
        f = force_at(kind, c, there, step)
        error = _difference(load(kind, c, MODEL, step), f)
        return wrong | differs(kind, c, there, f, error, step), slope + _dot(_difference(there, here), error)
    f = force_at(kind, c, _between(here, there, fraction), step)
    inertial = _between(load(kind, c, INERTIAL, step), load(kind, c, MODEL, step), fraction)
    return wrong, slope + _dot(_difference(there, here), _difference(inertial, f))


@inline
def descend(kind, fraction, step, wrong, slope):
    """Do as `with_element` for the elements of a tree."""
    first, end = elements(kind, step)
    for c in range(first, end):
        if belongs(kind, c, step):
            wrong, slope = with_element(fraction, kind, c, step, wrong, slope)
    return wrong, slope


@kernel
def shift(kind, step):
    """Move the iterate of a tree's elements by FRACTION of the pass, in the lanes AT_WORK."""
    N, t, (first, end) = step.N, base_index(step.part), elements(kind, step)
    fraction, active = N[t, FRACTION], N[t, AT_WORK] > 0.0
    for c in range(first, end):
        if belongs(kind, c, step):
            shift_element(kind, c, fraction, active, step)


@kernel
def rest(kind, step):
    """Take ITERATE for SOLUTION."""
    first, end = elements(kind, step)
    for c in range(first, end):
        if belongs(kind, c, step):
            keep(kind, c, SOLUTION, load(kind, c, ITERATE, step), step)


@inline
def shift_element(kind, c, fraction, active, step):
    """Move the iterate of one element."""
    here, there = load(kind, c, ITERATE, step), load(kind, c, SOLUTION, step)
    u = _shifted(here, there, fraction, active)
    keep(kind, c, ITERATE, snap(kind, c, u, here, there, active & (fraction < 1.0), step), step)
    f = _shifted(load(kind, c, INERTIAL, step), load(kind, c, MODEL, step), fraction, active)
    keep(kind, c, INERTIAL, f, step)
