"""The watch on depths: a run ends where a contact is deeper than half of what is thin of its two bodies.

Stiffness is sized by what lies on a contact at the start.  What is dropped or climbs on later may press a thin body
through another: beyond the middle it would be pushed out on the far side, or sink in for good.
"""

from ..compile.by_type import overridable
from ..compile.jit import inline
from ..compile.lanes import any_lane, invert, select
from ..compile.optional import any_present
from ..effects.contact import DEPTH
from ..effects.pair import copy_where, is_moment

TOO_DEEP = 6.0  # status of such a run


@overridable
def watch_depth(work, run, y, t, dead):
    """End runs, those not dead yet, of which a contact was too deep in the step to t [s]; return which are dead."""
    return _watch(any_present(run.scene.pairs, run.scene.contact), work.scratch.pool, work.scratch.C, run, y, t, dead)


@inline
def _watch(present, pool, C, run, y, t, dead):
    if present is None:
        return dead
    new = invert(dead) & too_deep(run.scene.pairs, run.scene.contact, pool, C, dead & invert(dead))
    if any_lane(new):
        offsets = run.offsets[0]
        y[offsets.status] = select(new, TOO_DEEP + 0.0 * y[offsets.status], y[offsets.status])
        y[offsets.end_time] = select(new, t + 0.0 * y[offsets.status], y[offsets.end_time])
        copy_where(new, run.scene.pairs, offsets, y, run.good)
    return dead | new


@inline
def too_deep(pairs, contact, pool, C, none):
    """Return where a point of the last step's scratch arrays is too deep; none: the mask of no lane."""
    return _points(contact, C, _pairs(pairs, pool, none))


@inline
def _pairs(pairs, pool, deep):
    if pairs is not None:
        for i in range(pool.count[0]):
            c = pool.placed[i]
            if not is_moment(pairs.turning, pool, c):
                deep = deep | (pool.C[c, DEPTH] > pairs.pairs[pool.pair[c]].deepest)
    return deep


@inline
def _points(contact, C, deep):
    if contact is not None:
        for c in range(len(contact.points)):
            deep = deep | (C[c, DEPTH] > contact.points[c].deepest)
    return deep
