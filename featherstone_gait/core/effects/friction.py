"""Viscous and dry friction of a joint (Coulomb): the model M1 of gear_friction.py, which has those with more to them.

Dry friction is a budget: it takes whatever torque keeps the joint at rest, up to the budget, and opposes motion with
the whole of it.  As a function of the speed it falls from plus to minus the budget within `STUCK` on either side of
rest: a joint that it holds creeps by less than 1e-9 rad in ten minutes, and an implicit step, which solves for the
speed at its end, sees a joint that stands.  Explicit steps cannot see so steep a law, and have it as wide as `SOFT`;
a servo may state such a width of its own.

The midpoint rule solves for the speed in the middle of a step and ends beyond: held at rest there, a joint would swing
to and fro for ever.  So half of the budget opposes that speed and half the one at the end, which neither swings nor
ever drives: against the motion in the middle it acts in full, with it never.  A law as wide as `SOFT` needs neither.
"""

from ..compile.by_type import overridable
from ..compile.jit import inline
from ..compile.lanes import clamp, select, sign_beyond
from ..compile.structure import record
from .energies import ENERGIES
from .energies import FRICTION as LOSS

FRICTION = record(
    viscous_friction=float,  # [N m s/rad]
    coulomb_friction=float,  # [N m]
    steepness=float,  # of the dry part about rest, 1 / its width [s/rad or s/m]
)

STUCK = 1e-12  # [rad/s or m/s]
SOFT = 1e-3  # [rad/s or m/s] of explicit methods: a loaded joint that should stick creeps at a fraction of it
SNAP = 2.0**-14  # of a Newton pass that comes by rest: nearer to it than a line search resolves
STEEP = 10.0 / SOFT  # [s/rad]
STEEPEST = 1e8  # [N m s/rad] slope of what is not dry friction
ROUNDING = 1e-15  # of a linear model, which is the difference of large numbers where a joint sticks at some speed
DRY = "Coulomb friction"


@inline
def direction(extrapolation_ratio, f, step, i, v):
    """Return the share of the budget that opposes the speed v, from -1 to 1, and its slope [s/rad].

    extrapolation_ratio: of the step; f a record.
    """
    if extrapolation_ratio is None:
        return _side(f, v)
    return direction_from(extrapolation_ratio, f, step.y[step.offsets.qd + i], v)


@inline
def direction_from(extrapolation_ratio, f, start, v):
    """Do the same for what moved at the speed `start` at the start of the step."""
    x, slope = _side(f, v)
    if extrapolation_ratio is None:
        return x, slope
    end, slope_end = _side(f, v + extrapolation_ratio * (v - start))
    steep = f.steepness > STEEP
    both = 0.5 * (slope + (1.0 + extrapolation_ratio) * slope_end)
    return select(steep, 0.5 * (x + end), x), select(steep, both, slope)


@inline
def _side(f, v):
    x = f.steepness * v
    one = 1.0 + 0.0 * v
    return clamp(x, -one, one), select(abs(x) < 1.0, f.steepness + 0.0 * v, 0.0 * v)


@overridable
def friction_torque(friction, step, i, speed):
    """Return the torque at the speed that the step solves for [N m] and its slope -dT/d speed."""
    if friction is None:
        return 0.0, 0.0
    f = friction[i]
    x, slope = direction(step.extrapolation_ratio, f, step, i, speed)
    return -(f.viscous_friction * speed + f.coulomb_friction * x), f.viscous_friction + f.coulomb_friction * slope


@overridable
def friction_branch(friction, step, i, speed, rotor_speed):
    """Return the way in which dry friction acts in full: 1, -1, or 0 where it sticks."""
    if friction is None:
        return 0.0
    f = friction[i]
    return select(f.coulomb_friction > 0.0, sign_beyond(f.steepness * speed, 1.0), 0.0 * speed)


@overridable
def stops_at_once(friction):
    """Return whether the dry friction of a joint is steep."""
    if friction is None:
        return False
    for i in range(len(friction)):
        if friction[i].coulomb_friction > 0.0 and friction[i].steepness > STEEP:
            return True
    return False


@overridable
def snap_to_rest(friction, step, i, v, here, there):
    """Return v between `here` and `there`, the ends of a Newton pass, or the speed of rest if v is close to it."""
    if friction is None:
        return v
    f, rest = friction[i], snapped(step.extrapolation_ratio, step, i, v, here, there)
    return select((f.coulomb_friction > 0.0) & (f.steepness > STEEP), rest, v)


@inline
def snapped(extrapolation_ratio, step, i, v, here, there):
    """Return v or the speed of rest: zero in what the step solves for, or of the midpoint rule at its end."""
    if extrapolation_ratio is None:
        return snapped_from(extrapolation_ratio, 0.0, v, here, there)
    return snapped_from(extrapolation_ratio, (1.0 - step.theta) * step.y[step.offsets.qd + i], v, here, there)


@inline
def snapped_from(extrapolation_ratio, stop, v, here, there):
    """Do the same where `stop` is the speed with which the midpoint rule ends at rest."""
    near, zero = SNAP * abs(there - here), 0.0 * v
    if extrapolation_ratio is not None:
        v = select((abs(v - stop) < near) & ((here - stop) * (there - stop) < 0.0), stop + zero, v)
    return select((abs(v) < near) & (here * there < 0.0), zero, v)


@inline
def move_friction(friction, step, i, v):
    """Add the energy that friction takes in the step at the speed v; return its torque [N m]."""
    if friction is None:
        return 0.0
    T, _ = friction_torque(friction, step, i, v)
    step.y[step.offsets.energy + ENERGIES * i + LOSS] -= step.h * (T * v)
    return T


@inline
def friction_rates(friction, actuator, step, dy, i, v):
    """Set the power that friction takes in dy, to which an actuator, if there is one, may add; the torque [N m]."""
    if friction is None:
        if actuator is not None:
            dy[step.offsets.energy + ENERGIES * i + LOSS] = 0.0 * v
        return 0.0
    T, _ = friction_torque(friction, step, i, v)
    dy[step.offsets.energy + ENERGIES * i + LOSS] = -T * v
    return T


def explicit_limits(viscous, dry):
    """Return dampers [N m s/rad] and springs [N m/rad] of each joint that limit an explicit step, by name.

    viscous (n,) [N m s/rad] and dry (n,) [N m] friction, of which the latter limits it while a joint sticks.
    """
    return {"viscous friction": viscous, DRY: dry / SOFT}, {}
