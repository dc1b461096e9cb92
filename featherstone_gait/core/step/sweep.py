"""Sweep the pairs of the pool along a step that error control has accepted: no contact lies between its ends unseen.

A step sees forces at its stages alone.  A bar that swings past a peg between two of them, or a ball that flies through
a wall, feels nothing, however small the tolerance, and a second run at another tolerance is as blind.  So the
coordinates of a step are joined by cubics of Hermite's, along which shapes are advanced conservatively: what two shapes
can come closer in a share of the step is at most that share of a bound of their way, so that most of a step is known to
be free from the gaps at its ends.  B. Mirtich, J. Canny, Impulse-based simulation of rigid bodies, Symposium on
Interactive 3D Graphics (1995).

A pair may be deeper within a step than at its ends: by their depth again, for an impact that the stages have seen, and
by little of the depth at which it rests, whose force is little of a weight for a short time.  A step from where shapes
are apart to where they touch is short after it has met them, or it may end where they part again and push no more.
"""

from ..compile.jit import apart, inline
from ..compile.lanes import sqrt
from ..compile.optional import if_present
from ..effects.pair import look_in_lane, put_pair, shape_pose, thickness
from ..shapes.separation import gap_at_least
from ..tree.ball import ball_rates, unit_balls
from ..tree.forest import joint_count, rows_of
from ..tree.kinematics import quaternion_rate, unit_quaternions
from ..tree.spatial import sub
from .pool import CHORD, PATH, in_world, pose_all, way_between

UNSEEN = 0.25  # of the resting depth: what a step may be deeper within than at its ends
THROUGH = 0.25  # of the thickness of two shapes that touch: what they may move without being looked at within
NEVER = 2.0  # a share of the step that is none
FINEST = 1.0 / 2048.0  # share of the step: what is looked at is no finer
HALVINGS = 40  # by which the beginning of a contact is found


@if_present()
def keep_start(pairs, run, y):
    """Keep the state before a step."""
    before = run.renewal.before
    for i in range(len(before)):
        before[i] = y[i]


@if_present()
def take_back(pairs, run, y):
    """Return to the state before the last step."""
    before = run.renewal.before
    for i in range(len(before)):
        y[i] = before[i]


@if_present(NEVER)
def first_contact(pairs, run, y, h):
    """Return at which share of the last step h [s] a contact begins that it has not seen; more than 1: at none."""
    if y[run.offsets[0].pair] > 0.0 and h > 0.0:
        return _first_of_all(pairs, run, y, h)
    return NEVER


@apart
def _first_of_all(pairs, run, y, h):
    room, o, first, last, c = run.renewal, run.offsets[0], NEVER, -1, 0
    _fill_rates(run, room.before, room.rates[0])
    _fill_rates(run, y, room.rates[1])
    _fill_ways(pairs, run, y, h)
    while c < len(room.kept) and y[o.pair + c] > 0.0:
        k = int(y[o.pair + c]) - 1
        if k != last:
            path = way_between(pairs.pairs[k], room.ways, PATH)
            if path > 2.0 * UNSEEN * pairs.margin:
                first = min(first, _first_of(pairs, k, run, y, h, path))
        c, last = c + 1, k
    return first


@inline
def _fill_rates(run, y, rate):
    """Fill the rates of all coordinates."""
    scene, o = run.scene, run.offsets[0]
    for i in range(joint_count(scene.trees, scene.tree)):
        rate[o.q + i] = y[o.qd + i]
    ball_rates(scene.balls, None, y[o.ball_q :], y[o.qd :], rate[o.ball_q :])
    for k in range(len(scene.trees)):
        x, v = o.base_q + 7 * k, o.base_qd + 6 * k
        for i in range(3):
            rate[x + i] = y[v + i]
        quaternion_rate(y[x : x + 7], y[v : v + 6], rate[x + 3 : x + 7])


@inline
def _fill_ways(pairs, run, y, h):
    """Fill bounds of the way of the shapes of each body in the step [m]: h times their largest speed in it."""
    scene, o, ways = run.scene, run.offsets[0], run.renewal.ways
    for k in range(len(scene.trees)):
        root, end = rows_of(scene.trees[k], scene.tree)
        at = o.base_q + 7 * k
        ways[PATH, root] = _way(run, y, h, at, 3) + (CHORD * pairs.radius[k]) * _way(run, y, h, at + 3, 4)
        for i in range(root + 1, end):
            up, j = scene.tree[i].parent, scene.tree[i].dof
            ways[PATH, i] = ways[PATH, up] + pairs.reach[j] * _way(run, y, h, o.q + j, 1)


@inline
def _way(run, y, h, at, count):
    """Return a bound of the way of `count` coordinates together, by their largest rates on the cubics."""
    room, whole, first, last = run.renewal, 0.0, 0.0, 0.0
    for i in range(at, at + count):
        d = y[i] - room.before[i]
        whole += d * d
        first += (h * room.rates[0, i] - d) * (h * room.rates[0, i] - d)
        last += (h * room.rates[1, i] - d) * (h * room.rates[1, i] - d)
    return sqrt(whole) + sqrt(max(first, last))


@apart
def _first_of(pairs, k, run, y, h, path):
    """Return at which share of the step pair k begins a contact that is not seen; `path` bounds its way [m]."""
    pair = pairs.pairs[k]
    a, b = pairs.shapes.table[pair.a], pairs.shapes.table[pair.b]
    start, end = _gap_at(pairs, pair, run, run.renewal.before, path), _gap_at(pairs, pair, run, y, path)
    deepest, through = max(0.0, -start, -end), THROUGH * thickness(a, b)
    if start < 0.0:
        least, spare = -(2.0 * deepest + UNSEEN * pairs.margin), 2.0 * deepest + UNSEEN * pairs.margin + through
    else:
        least, spare = -UNSEEN * pairs.margin, UNSEEN * pairs.margin
        if path <= through and end < 0.0:
            return NEVER
    s, gap = 0.0, start
    while s < 1.0:
        step, new = 1.0 - s, end
        if gap + new + 2.0 * spare < path * step:
            step = min(max(2.0 * (gap + spare) / path, FINEST), step)
            new = _gap_within(pairs, pair, run, y, h, s + step, path)
            while new >= least and gap + new + 2.0 * spare < path * step and step > FINEST:
                step *= 0.5
                new = _gap_within(pairs, pair, run, y, h, s + step, path)
        if new < least:
            begins = _beginning(pairs, pair, run, y, h, (s, s + step), least, path)
            return NEVER if start >= 0.0 and end < 0.0 and path * (1.0 - begins) <= through else begins
        s, gap = s + step, new
    return NEVER


@inline
def _beginning(pairs, pair, run, y, h, between, least, path):
    """Return the share of the step at which a pair is a little deeper than `least`, which it is at the second one."""
    clear, met = between
    for _ in range(HALVINGS):
        middle = 0.5 * (clear + met)
        gap = _gap_within(pairs, pair, run, y, h, middle, path)
        if gap >= least:
            clear = middle
        else:
            met = middle
            if gap > 4.0 * least:
                break
    return met


@apart
def _gap_within(pairs, pair, run, y, h, share, path):
    """Return the gap of a pair at a share of the step [m], `path` if it is not less."""
    room, scene, o = run.renewal, run.scene, run.offsets[0]
    within, r = room.within, 1.0 - share
    for i in range(len(within)):
        d = y[i] - room.before[i]
        bend = r * (h * room.rates[0, i] - d) - share * (h * room.rates[1, i] - d)
        within[i] = room.before[i] + share * (d + r * bend)
    unit_quaternions(scene.floating, scene.trees, o.base_q, within)
    unit_balls(scene.balls, o.ball_q, within)
    return _gap_at(pairs, pair, run, within, path)


@apart
def _gap_at(pairs, pair, run, y, enough):
    """Return the gap of a pair at the coordinates y [m], or some number from `enough` on if it is not less."""
    room, o, a, b = run.renewal, run.offsets[0], pairs.shapes.table[pair.a], pairs.shapes.table[pair.b]
    pose_all(run, y)
    Ea, ra = shape_pose(a, pair.tree_a, pair.body_a, room.frames)
    Eb, rb = shape_pose(b, pair.tree_b, pair.body_b, room.frames)
    c = sub(in_world(pair.tree_a, ra, o, y), in_world(pair.tree_b, rb, o, y))
    gap = gap_at_least(a, b, Ea, Eb, c, enough)
    if gap < enough:
        zero = 0.0 * c[0]
        put_pair(room.placing, (Ea, c), (Eb, (zero, zero, zero)), enough, True)
        gap = enough
        for m in range(look_in_lane(pairs, pair, room, 0, 1)):
            gap = min(gap, -room.manifold[m, 6])
    return gap
