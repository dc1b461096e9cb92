"""Springs of joints: a torque that pulls a joint to its reference, -K x of x = q - q0, or -(K x + b x^2 + c x^3).

An implicit step takes the torque at its end, where the angle is q + h v, so its slope is h K.  Euler's method is more
accurate with the torque at the start of the step, which it takes as long as the spring's own period allows it.
"""

from ..compile.jit import inline
from ..compile.structure import record

JOINT_SPRING = record(
    stiffness=float,  # K [N m/rad or N/m]
    spring_reference=float,  # q0 [rad or m]
    fold=float,  # 1 = the torque is that at the end of the step, 0 = at its start
)


STIFFENING = record(
    spring_reference=float,  # q0 [rad or m]
    quadratic_stiffness=float,  # b [N m/rad^2 or N/m^2]
    cubic_stiffness=float,  # c [N m/rad^3 or N/m^3]
)


@inline
def plus_spring(springs, stiffening, step, i, v, T, c):
    """Return T plus the torque of the joint's spring at the speed v [N m], and c plus its slope -dT/dv."""
    T, c = _plus_stiffening(stiffening, step, i, v, T, c)
    if springs is None:
        return T, c
    s = springs[i]
    ahead = s.fold * step.h_implicit
    angle = step.y[step.offsets.q + i] + ahead * v
    return T + s.stiffness * (s.spring_reference - angle), c + s.stiffness * ahead


@inline
def _plus_stiffening(stiffening, step, i, v, T, c):
    """Do the same with the powers beyond the first, which are taken at the end of a step always."""
    if stiffening is None:
        return T, c
    s, h = stiffening[i], step.h_implicit
    x = step.y[step.offsets.q + i] + h * v - s.spring_reference
    slope = x * (2.0 * s.quadratic_stiffness + 3.0 * s.cubic_stiffness * x)
    return T - x * x * (s.quadratic_stiffness + s.cubic_stiffness * x), c + h * slope


def explicit_limits(stiffness):
    """Return no dampers, and the springs [N m/rad or N/m] of each joint, that limit an explicit step, by name."""
    return {}, {"joint spring": stiffness}
