"""Convex hulls of points, thinned to a few corners.

Which corners are kept must not depend on the processor where several are as good; so no BLAS and no libm here, but for
what tells flat hulls from solid ones.
"""

from __future__ import annotations

from itertools import pairwise
from itertools import product as combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.fixed_order import total
from ..base.portable_math import sincos

MOST_CORNERS = 32  # corners
ENOUGH = 1e-4  # largest distance from a corner left out that is not worth another corner, relative to the extent
CANDIDATES = 500  # corners among which to choose
ALIKE = 1e-9  # points closer to a plane or line than this, relative to the extent, lie in it
DIGITS = 12  # of directions that are told apart
CHUNK = 1000  # points whose distances are found at once


class Corners(NamedTuple):
    """Some corners of a convex hull."""

    points: np.ndarray  # (corners, 3) [m]
    error: float  # largest distance of the hull from that of these corners [m]


def corners_of(points: ArrayLike, most: int = MOST_CORNERS) -> Corners:
    """Thin the convex hull of points (n, 3) [m] to at most `most` corners (>= 14).

    If there are more, the farthest along 14 directions are taken, then again and again the one farthest from the hull
    of those taken; the result depends on the points alone.  Raises ValueError for points that are not (n, 3) and
    finite.
    """
    x = np.array(points, dtype=float)
    if x.ndim != 2 or x.shape[1] != 3 or not len(x) or not np.isfinite(x).all():
        raise ValueError(f"points of a hull have shape {x.shape}; expected (n, 3), finite, n > 0: correct them")
    if most < 14:
        raise ValueError(f"most is {most!r}; expected >= 14 corners, one in each of as many directions")
    x = x[hull_indices(x)]
    if len(x) <= most:
        return Corners(x, 0.0)
    taken = _chosen(x, most)
    return Corners(x[taken], float(_outside(x, x[taken]).max()))


def hull_indices(x: np.ndarray) -> np.ndarray:
    """Return sorted indices of points (n, 3) that are corners of their convex hull, in their plane if they are flat."""
    from scipy.spatial import ConvexHull

    flat = flattened(x)
    if flat.shape[1] == 0:
        return np.array([0])
    if flat.shape[1] == 1:
        return np.unique([flat[:, 0].argmin(), flat[:, 0].argmax()])
    return np.sort(ConvexHull(flat).vertices)


class Sides(NamedTuple):
    """Directions of the faces and edges of a convex hull, each once."""

    normals: np.ndarray  # (faces, 3) outward
    edges: np.ndarray  # (edges, 3) either way


def sides(x: np.ndarray) -> Sides:
    """Compute faces and edges of the convex hull of points (n, 3); both sides of flat ones, the direction of a line."""
    from scipy.spatial import ConvexHull

    flat = flattened(x)
    if flat.shape[1] == 3:
        hull = ConvexHull(x)
        around = x[hull.simplices]
        edges = _either_way((around - np.roll(around, 1, axis=1)).reshape(-1, 3))
        return Sides(_once(hull.equations[:, :3]), _once(edges))
    around = x[ConvexHull(flat).vertices] if flat.shape[1] == 2 else x[hull_indices(x)]
    edges = _either_way(around - np.roll(around, 1, axis=0))
    across = np.cross(edges[:1], edges[1:2]) if flat.shape[1] == 2 else edges[:0]
    return Sides(_once(np.vstack([across, -across])), _once(edges))


def hull_triangles(x: np.ndarray) -> np.ndarray:
    """Return the triangles (n, 3) of the convex hull of points (m, 3), in an order that depends on the points alone.

    None of points that lie in a plane.
    """
    from scipy.spatial import ConvexHull

    if flattened(x).shape[1] < 3:
        return np.zeros((0, 3), int)
    return np.unique(np.sort(ConvexHull(x).simplices, axis=1), axis=0)


def hull_volume(x: np.ndarray) -> float:
    """Compute the volume of the convex hull of points (n, 3) [m^3]; 0 of points that lie in a plane."""
    from scipy.spatial import ConvexHull

    return float(ConvexHull(x).volume) if flattened(x).shape[1] == 3 else 0.0


def _either_way(directions: np.ndarray) -> np.ndarray:
    """Scale directions (n, 3) to unit length with a positive first nonzero part; drop those of length 0."""
    length = np.sqrt(total(directions * directions))
    unit = (directions[length > 0.0].T / length[length > 0.0]).T.round(DIGITS)
    first = unit[np.arange(len(unit)), (unit != 0.0).argmax(axis=1)]
    return unit * np.sign(first)[:, None]


def _once(directions: np.ndarray) -> np.ndarray:
    return np.unique(directions.round(DIGITS), axis=0)


def flattened(x: np.ndarray) -> np.ndarray:
    """Express points in as many coordinates as they fill: themselves, or those in their plane or along their line."""
    centered = x - x.mean(axis=0)
    extent = np.abs(centered).max()
    if not extent > 0.0:
        return x[:, :0]
    scaled = centered / extent
    axes = np.linalg.eigh(scaled.T @ scaled)[1][:, ::-1]
    along = scaled @ axes
    fills = int((np.abs(along).max(axis=0) > ALIKE).sum())
    return x if fills == 3 else along[:, :fills]


def _chosen(x: np.ndarray, most: int) -> np.ndarray:
    """Return the indices of the corners to keep."""
    pool = np.arange(len(x)) if len(x) <= CANDIDATES else _farthest(x, _spread(CANDIDATES))
    taken = _farthest(x, np.array([d for d in combinations((-1, 0, 1), repeat=3) if sum(map(abs, d)) in (1, 3)]))
    enough = ENOUGH * np.ptp(x, axis=0).max()
    while len(taken) < most:
        distance = _outside(x[pool], x[taken])
        if distance.max() <= enough:
            break
        taken = np.append(taken, pool[distance.argmax()])
    return np.sort(taken)


def _farthest(x: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return the indices of the points farthest along each direction, each once."""
    return np.unique([int(total(x * direction).argmax()) for direction in directions])


def _spread(n: int) -> np.ndarray:
    """Spread n directions evenly over the sphere (Fibonacci lattice)."""
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    angle = np.pi * (3.0 - 5.0**0.5) * np.arange(n)
    across, (s, c) = np.sqrt(1.0 - z * z), sincos(angle)
    return np.column_stack([across * c, across * s, z])


def _outside(x: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Compute the distance of points (n, 3) from the hull of corners, inside which none of them lies [m]."""
    from scipy.spatial import ConvexHull

    flat = flattened(corners)
    hull = ConvexHull(flat)
    first, *others = hull.vertices
    fan = [(first, a, b) for a, b in pairwise(others)]  # of triangles, that fills a hull in a plane
    triangles = corners[hull.simplices if flat.shape[1] == 3 else fan]
    return np.concatenate([_to_triangles(x[k : k + CHUNK], triangles) for k in range(0, len(x), CHUNK)])


def _to_triangles(x: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Compute the distance of points (n, 3) from the nearest of triangles (m, 3, 3)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    least = np.min([_to_edges(x, p, q) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    normal = np.cross(b - a, c - a)
    area = total(normal * normal)
    covered = np.where(area > 0.0, area, np.inf)
    p = x[:, None] - a
    s = total(p * np.cross(c - a, normal)) / covered
    t = total(p * np.cross(normal, b - a)) / covered
    height = np.abs(total(p * normal)) / np.sqrt(covered)
    above = (area > 0.0) & (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
    return np.where(above, height, least).min(axis=1)


def _to_edges(x: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Compute the distances (n, m) of points from edges p to q (m, 3)."""
    d, to = q - p, x[:, None] - p
    length = total(d * d)
    t = np.clip(total(to * d) / np.where(length > 0.0, length, np.inf), 0.0, 1.0)
    off = to - t[..., None] * d
    return np.sqrt(total(off * off))
