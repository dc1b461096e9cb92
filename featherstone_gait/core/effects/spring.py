"""Springs with dampers between two points of two bodies.

A spring pulls its points together along the line through both with the tension K (l - l0) + C dl/dt; l their distance.
Every integrator takes that force from the state for which it works out the bias forces: an explicit one that of each
stage, the linearly implicit step that of its start (Euler) or the predicted one in its middle (midpoint).  Nothing of
it is folded into the step, whose limit is then that of an explicit method; the preflight reports it.
"""

from ..compile.jit import kernel
from ..compile.lanes import select, sqrt
from ..compile.structure import record
from ..tree.rigid_body import center_velocity, point_position
from ..tree.spatial import cross, dot, scale, sub, vector

SPRING = record(
    a=int,  # row of the body at one end
    b=int,  # and at the other
    point_a=(float, 3),  # body frame [m]
    point_b=(float, 3),  # body frame [m]
    stiffness=float,  # K [N/m]
    damping=float,  # C [N s/m]
    length=float,  # l0, at rest [m]
)


@kernel
def add_springs(springs, W, F):
    """Add the springs to F (n + 1, 6), as [moment; force] about the common origin.

    Positions in W count from the base.  Their differences, all that is needed here, are the same from anywhere.
    Points that coincide have no line between them, and no force.
    """
    for j in range(len(springs)):
        k = springs[j]
        p, q = point_position(k.a, vector(k.point_a), W), point_position(k.b, vector(k.point_b), W)
        v, w = center_velocity(k.a, p, W), center_velocity(k.b, q, W)
        d = sub(q, p)
        length = sqrt(dot(d, d))
        apart = length > 0.0
        e = scale(d, select(apart, 1.0 / select(apart, length, 1.0 + 0.0 * length), 0.0 * length))
        tension = k.stiffness * (length - k.length) + k.damping * dot(e, sub(w, v))
        f = scale(e, tension)
        n = cross(p, f)  # of both, as they pull along one line
        for c in range(3):
            F[k.a, c] += n[c]
            F[k.a, 3 + c] += f[c]
            F[k.b, c] -= n[c]
            F[k.b, 3 + c] -= f[c]


CAUSES = ("spring between bodies", "damper between bodies")


def explicit_limits(springs):
    """Return the damper [N s/m] and spring [N/m] of each that limit a step, by name."""
    return {CAUSES[1]: springs["damping"]}, {CAUSES[0]: springs["stiffness"]}
