"""Springs of joints: a torque K (q0 - q) that pulls a joint to its reference.

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


@inline
def plus_spring(springs, step, i, v, T, c):
    """Return T plus the torque of the joint's spring at the speed v [N m], and c plus its slope -dT/dv."""
    if springs is None:
        return T, c
    s = springs[i]
    ahead = s.fold * step.h_implicit
    angle = step.y[step.offsets.q + i] + ahead * v
    return T + s.stiffness * (s.spring_reference - angle), c + s.stiffness * ahead


def explicit_limits(springs):
    """Return no dampers, and the springs [N m/rad or N/m] of each joint, that limit an explicit step, by name."""
    return {}, {"joint spring": springs["stiffness"]}
