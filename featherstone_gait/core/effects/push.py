"""Pushes: external forces on given points of links for a given time."""

from ..compile.jit import inline, kernel
from ..compile.structure import record
from ..tree.rigid_body import point_position
from ..tree.spatial import add, cross, scale, vector

EVENT_MARGIN = 1e-12  # [s]: an event that falls on a time is over there, whichever of both was rounded down

PUSH = record(
    body=int,  # row of the body
    point=(float, 3),  # where it acts, body frame [m]
    moment=(float, 3),  # world axes [N m]
    force=(float, 3),  # world axes [N]
    start=float,  # [s]
    end=float,  # [s]
)


@kernel
def add_pushes(push, t, span, W, F):
    """Add the pushes, averaged over `span` from t on [s], to F (n + 1, 6), [moment; force] about the common origin."""
    for j in range(len(push)):
        b = push[j]
        share = _share(b.start, b.end, t, span)
        if share > 0.0:
            p = point_position(b.body, vector(b.point), W)
            f = scale(vector(b.force), share)
            n = add(scale(vector(b.moment), share), cross(p, f))
            for k in range(3):
                F[b.body, k] += n[k]
                F[b.body, 3 + k] += f[k]


@inline
def _share(start, end, t, span):
    """Return the share of the time `span` from t in which a push acts, so that fixed steps lose none of it."""
    if start <= t and t + span < end:
        return 1.0
    if span > 0.0:
        return max(0.0, min(end, t + span) - max(start, t)) / span
    return 0.0


@kernel
def next_edge(push, t):
    """Return the time at which a push begins or ends next after t [s]."""
    edge = 1e300
    for j in range(len(push)):
        for when in (push[j].start, push[j].end):
            if when > t + EVENT_MARGIN:
                edge = min(edge, when)
    return edge
