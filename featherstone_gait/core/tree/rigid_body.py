"""One rigid body in the common frame: where its mass is, and the force that its motion takes (Newton-Euler)."""

from ..compile.jit import inline
from .layout import A, P, R, V
from .spatial import add, congruence, cross, load3, load9, rotate, scale, symmetric


@inline
def mass_center(b, i, W):
    """Return the center of mass [m] and the inertia about it [kg m^2], world axes."""
    E = load9(W, i, R)
    return add(rotate(E, b.c), load3(W, i, P)), congruence(E, b.J)


@inline
def point_position(i, r, W):
    """Return the position of the point r of body i's frame [m]."""
    return add(load3(W, i, P), rotate(load9(W, i, R), r))


@inline
def center_velocity(i, c, W):
    """Return the velocity of the point c (3) [m] that moves with body i [m/s]."""
    return add(load3(W, i, V + 3), cross(load3(W, i, V), c))


@inline
def inertial_force(b, i, c, Jc, W):
    """Return I a + v x* I v as moment about the origin [N m] and force [N]; c, Jc: of `mass_center`."""
    w = load3(W, i, V)
    alpha = load3(W, i, A)
    ac = add(load3(W, i, A + 3), add(cross(alpha, c), cross(w, center_velocity(i, c, W))))
    f = scale(ac, b.m)
    return add(add(symmetric(Jc, alpha), cross(w, symmetric(Jc, w))), cross(c, f)), f
