"""Surfaces that move on their bodies: belts, turntables and tracks.

At the place x of a body the surface moves with s = c (v + w x (x - o)), of which friction sees the part along the plane
of contact; c is the command in the state.  The body takes the force f of a contact all the same, so that of the power
that goes into friction and bodies the drive of the surface gives -f.s.
"""

from ..compile.jit import inline
from ..compile.optional import if_present
from ..compile.structure import record
from ..tree.layout import R
from ..tree.rigid_body import point_position
from ..tree.spatial import add, cross, dot, load9, rotate, scale, sub, vector

SURFACE = record(
    drive=int,  # number of its drive, -1 of a surface at rest
    velocity=(float, 3),  # body frame, that of the world where the body cannot move [m/s]
    turning=(float, 3),  # [rad/s]
    center=(float, 3),  # [m]
)


@inline
def surface_motion(s, tree, body, x, n, step):
    """Return the velocity of a surface at x [m/s], and its angular velocity about the normal n [rad/s].

    tree < 0: the body is the world, in whose frame x is then.
    """
    zero = 0.0 * x[0]
    v, rate = (zero, zero, zero), zero
    if s.drive >= 0:
        command, turning = step.y[step.offsets.surface_command + s.drive], vector(s.turning)
        v, center = vector(s.velocity), vector(s.center)
        if tree >= 0:
            E = load9(step.W, body, R)
            v, turning, center = rotate(E, v), rotate(E, turning), point_position(body, center, step.W)
        v = scale(add(v, cross(turning, sub(x, center))), command)
        rate = command * dot(n, turning)
    return v, rate


@inline
def add_drive_work(s, power, h, step, work):
    """Add h times what the drive of a surface gives [W] to `work`, the state or its rates."""
    if s.drive >= 0:
        work[step.offsets.surface_work + s.drive] += h * power


@if_present()
def clear_drives(surfaces, step, dy):
    """Clear the powers of all drives."""
    for k in range(len(surfaces)):
        dy[step.offsets.surface_work + k] = 0.0 * step.y[step.offsets.surface_work + k]
