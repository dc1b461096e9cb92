"""The share of a disc that quadrilaterals cover, each place once: what a sensor sees of lines on a floor.

The area of a region within the disc |x| <= r is the integral of min(|x|, r)^2 / 2 over the angle along the region's
boundary.  Of the part of a segment from p to q within the disc that is p x q / 2, of a part outside r^2 / 2 times the
angle between its ends.  The boundary of the union is what of each edge no other quadrilateral covers; of edges that
coincide two that run alike count once, and two that run against each other cancel.
"""

from math import pi, sqrt

from ..compile.elementary import angle
from ..compile.jit import entry, kernel

COINCIDENT = 1e-12  # distance of edges that are one [m]


@entry
def cover(quads, discs, near, out):
    """Fill out (n,) with the covered share of each disc.

    quads (m, 4, 2): convex quadrilaterals, counterclockwise [m]; discs (n, 3): center and radius [m], of a radius of 0
    whether the center is covered; near (m,): room to work in, whole numbers.
    """
    for n in range(len(out)):
        x, y, radius = discs[n, 0], discs[n, 1], discs[n, 2]
        count = 0
        for i in range(len(quads)):
            if _reaches(quads[i], x, y, radius):
                near[count] = i
                count += 1
        if radius > 0.0:
            area = 0.0
            for a in range(count):
                for e in range(4):
                    area += _edge(quads, near, count, a, e, x, y, radius)
            out[n] = min(max(area / (pi * radius * radius), 0.0), 1.0)
        else:
            out[n] = 0.0
            for a in range(count):
                if _holds(quads[near[a]], x, y):
                    out[n] = 1.0


@kernel
def _reaches(quad, x, y, radius):
    """Return whether the box about a quadrilateral meets that about a disc."""
    left, right = min(quad[0, 0], quad[1, 0]), max(quad[0, 0], quad[1, 0])
    low, high = min(quad[0, 1], quad[1, 1]), max(quad[0, 1], quad[1, 1])
    for k in range(2, 4):
        left, right = min(left, quad[k, 0]), max(right, quad[k, 0])
        low, high = min(low, quad[k, 1]), max(high, quad[k, 1])
    return (left <= x + radius) & (right >= x - radius) & (low <= y + radius) & (high >= y - radius)


@kernel
def _holds(quad, x, y):
    """Return whether a quadrilateral has a point within it or on its edge."""
    for k in range(4):
        v, w = quad[k], quad[(k + 1) % 4]
        if (w[0] - v[0]) * (y - v[1]) - (w[1] - v[1]) * (x - v[0]) < 0.0:
            return False
    return True


@kernel
def _edge(quads, near, count, a, e, x, y, radius):
    """Return the integral over what of edge e of quadrilateral near[a] no other one covers."""
    quad = quads[near[a]]
    px, py = quad[e, 0] - x, quad[e, 1] - y
    dx, dy = quad[(e + 1) % 4, 0] - quad[e, 0], quad[(e + 1) % 4, 1] - quad[e, 1]
    if dx * dx + dy * dy == 0.0:
        return 0.0
    done, found = 0.0, 0.0
    while done < 1.0:
        end, begin = done, 1.0  # of what covers the edge from `done` on, and of what is next
        for b in range(count):
            if b != a:
                first, last = _covered(quad, e, quads[near[b]], b < a)
                if first < last:
                    if first <= done:
                        end = max(end, last)
                    else:
                        begin = min(begin, first)
        if end > done:
            done = end
        else:
            found += _sector(px + done * dx, py + done * dy, px + begin * dx, py + begin * dy, radius)
            done = begin
    return found


@kernel
def _covered(quad, e, other, earlier):
    """Return from where to where, in lengths of edge e of a quadrilateral, another one covers it.

    earlier: whether the other is the one of both whose edge counts where both run alike.
    """
    p, q = quad[e], quad[(e + 1) % 4]
    first, last = 0.0, 1.0
    for k in range(4):
        v, w = other[k], other[(k + 1) % 4]
        ux, uy = w[0] - v[0], w[1] - v[1]
        length = sqrt(ux * ux + uy * uy)
        if length > 0.0:
            at_p = (ux * (p[1] - v[1]) - uy * (p[0] - v[0])) / length  # distance within the edge of the other
            at_q = (ux * (q[1] - v[1]) - uy * (q[0] - v[0])) / length
            if abs(at_p) <= COINCIDENT and abs(at_q) <= COINCIDENT:
                if not (earlier and ux * (q[0] - p[0]) + uy * (q[1] - p[1]) > 0.0):
                    return 1.0, 0.0
            elif at_p <= COINCIDENT and at_q <= COINCIDENT:
                return 1.0, 0.0
            elif at_p < 0.0:
                first = max(first, at_p / (at_p - at_q))
            elif at_q < 0.0:
                last = min(last, at_p / (at_p - at_q))
    return first, last


@kernel
def _sector(px, py, qx, qy, radius):
    """Return the integral along the segment from p to q, seen from the center of the disc."""
    dx, dy = qx - px, qy - py
    a, b = dx * dx + dy * dy, px * dx + py * dy
    half = 0.5 * radius * radius
    square = b * b - a * (px * px + py * py - radius * radius)
    if a == 0.0:
        return 0.0
    root = sqrt(max(square, 0.0))
    enters, leaves = min(max((-b - root) / a, 0.0), 1.0), min(max((-b + root) / a, 0.0), 1.0)
    if leaves <= enters:
        return half * angle(px * qy - py * qx, px * qx + py * qy)
    ux, uy, vx, vy = px + enters * dx, py + enters * dy, px + leaves * dx, py + leaves * dy
    found = 0.5 * (ux * vy - uy * vx)
    if enters > 0.0:
        found += half * angle(px * uy - py * ux, px * ux + py * uy)
    if leaves < 1.0:
        found += half * angle(vx * qy - vy * qx, vx * qx + vy * qy)
    return found
