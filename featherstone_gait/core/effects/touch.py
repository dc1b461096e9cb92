"""The deepest point of a body in the ground, and the axes there: normal, first and second tangent.

What touches is a point, or the deepest point of a sphere or of a disc.

Against a plane of normal n the deepest point of a convex body is that of its support in the direction -n.  Of a sphere
of radius r about the center it lies r n below.  A disc is an ellipsoid of semi-axes R, R, e R about its axis a, widened
by r: below by

    r n + R (n - (1 - e^2) (n.a) a) / sqrt(|n - (n.a) a|^2 + e^2 (n.a)^2).

That point moves over the body as the body turns; what moves with the body there has the velocity that friction sees, so
that spheres and wheels roll, and the depth changes by that velocity along n alone, so that rolling does no work.
"""

from typing import NamedTuple

import numpy as np

from ..compile.by_type import NoneType, by_type, overridable
from ..compile.jit import inline
from ..compile.lanes import any_lane, select, sqrt
from ..compile.structure import record, structure
from ..shapes.ground import Field, Plane, facet, ground_height
from ..tree.layout import R
from ..tree.spatial import add, choose, cross, dot, load3, load9, rotate, scale, store3, sub, vector

DISC = record(
    radius=float,  # r of the sphere, or by which the disc is widened [m]
    circle_radius=float,  # R of the disc [m]
    axis=(float, 3),  # of the disc, body's frame
)
FLATNESS = 1e-2  # e: thickness of a disc by its radius
AXES = 27  # 9 columns of the contacts' scratch (see contact.py): normal, first and second tangent of a field


@structure
class Spheres(NamedTuple):
    """Spheres and points."""

    radius: np.ndarray  # (points,) [m]


@structure
class Discs(NamedTuple):
    """Discs, spheres and points."""

    disc: np.ndarray  # (points,) DISC


@by_type
def deepest_point(contact_geometry, c, i, center, n, W):
    """Return where the contact c of body i about the center [m] reaches deepest against the normal n [m]."""


deepest_point.of(NoneType)(lambda contact_geometry, c, i, center, n, W: center)
deepest_point.of(Spheres)(
    lambda contact_geometry, c, i, center, n, W: sub(center, scale(n, contact_geometry.radius[c]))
)


@deepest_point.of(Discs)
def _disc(contact_geometry, c, i, center, n, W):
    d = contact_geometry.disc[c]
    a = rotate(load9(W, i, R), vector(d.axis))
    across = dot(a, n)
    level = sub(n, scale(a, across))
    thin = FLATNESS * FLATNESS * across
    size = sqrt(dot(level, level) + thin * across)
    below = add(scale(n, d.radius), scale(add(level, scale(a, thin)), d.circle_radius / size))
    return sub(center, below)


@by_type
def reach(contact_geometry, c):
    """Return how far from its center the contact c can touch [m]."""


reach.of(NoneType)(lambda contact_geometry, c: 0.0)
reach.of(Spheres)(lambda contact_geometry, c: contact_geometry.radius[c])
reach.of(Discs)(lambda contact_geometry, c: contact_geometry.disc[c].radius + contact_geometry.disc[c].circle_radius)


@inline
def axes_at(fixed, c, C):
    """Return the axes at the contact c, which `deepest` has placed; fixed: those of `fixed_axes`."""
    if fixed is None:
        return load3(C, c, AXES), load3(C, c, AXES + 3), load3(C, c, AXES + 6)
    return fixed


@by_type
def deepest(ground, contact_geometry, fixed, c, i, center, base_q, W, C):
    """Return the deepest point of the contact c of body i, common frame [m], and its depth [m]."""


@deepest.of(Plane)
def _deepest_on_plane(ground, contact_geometry, fixed, c, i, center, base_q, W, C):
    n, t, _ = fixed
    x = deepest_point(contact_geometry, c, i, center, n, W)
    at = _in_world(base_q, x)
    return x, ground_height(ground, dot(t, at)) - dot(n, at)


@deepest.of(Field)
def _deepest_on_field(ground, contact_geometry, fixed, c, i, center, base_q, W, C):
    """Return the same on a field; far above its top, where no lane is near, no height is looked up."""
    grid, up = ground.grid[0], (0.0 * center[0], 0.0 * center[0], 1.0 + 0.0 * center[0])
    at = _in_world(base_q, center)
    depth = grid.top - (at[2] - reach(contact_geometry, c))
    x, n, t = deepest_point(contact_geometry, c, i, center, up, W), up, (up[2], up[0], up[0])
    near = depth > -grid.margin
    if any_lane(near):
        x1, depth1, n1, t1 = _on_facet(contact_geometry, ground, c, i, center, base_q, W)
        x, n, t = choose(near, x1, x), choose(near, n1, n), choose(near, t1, t)
        depth = select(near, depth1, depth)
    store3(C, c, AXES, n)
    store3(C, c, AXES + 3, t)
    store3(C, c, AXES + 6, cross(n, t))
    return x, depth


@inline
def _in_world(base_q, x):
    if base_q is not None:
        x = add(x, vector(base_q))
    return x


@overridable
def _on_facet(contact_geometry, ground, c, i, center, base_q, W):
    """Return the deepest point, its depth along the normal under it, that normal and the first tangent.

    The ground is taken as its tangent plane under the point that is deepest as seen from the center.
    """
    n, _, _ = facet(ground, _in_world(base_q, center))
    guess = deepest_point(contact_geometry, c, i, center, n, W)
    n, t, over = facet(ground, _in_world(base_q, guess))
    x = deepest_point(contact_geometry, c, i, center, n, W)
    away = (x[0] - guess[0], x[1] - guess[1], x[2] - guess[2])
    return x, -(over * n[2] + dot(n, away)), n, t


@_on_facet.of(NoneType)
def _point_on_facet(contact_geometry, ground, c, i, center, base_q, W):
    n, t, over = facet(ground, _in_world(base_q, center))
    return center, -over * n[2], n, t
