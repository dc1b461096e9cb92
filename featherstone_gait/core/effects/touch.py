"""The point of a body that touches the ground: a point, or the deepest point of a sphere or of a disc.

Against a plane of normal n the deepest point of a convex body is that of its support in the direction -n.  Of a sphere
of radius r about the center it lies r n below.  A disc is an ellipsoid of semi-axes R, R, e R about its axis a, widened
by r: below by

    r n + R (n - (1 - e^2) (n.a) a) / sqrt(|n - (n.a) a|^2 + e^2 (n.a)^2).

That point moves over the body as the body turns; what moves with the body there has the velocity that friction sees, so
that spheres and wheels roll, and the depth changes by that velocity along n alone, so that rolling does no work.
"""

from typing import NamedTuple

import numpy as np

from ..compile.by_type import NoneType, by_type
from ..compile.lanes import sqrt
from ..compile.structure import record, structure
from ..tree.layout import R
from ..tree.spatial import add, dot, load9, rotate, scale, sub, vector

DISC = record(
    radius=float,  # r of the sphere, or by which the disc is widened [m]
    circle_radius=float,  # R of the disc [m]
    axis=(float, 3),  # of the disc, body's frame
)
FLATNESS = 1e-2  # e: thickness of a disc by its radius


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
