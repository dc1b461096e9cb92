"""Faces, edges and vertices of convex shapes, as contact between them needs them.

Points are compared relative to the extent; no BLAS and no libm in what ends up in kernels.
"""

from __future__ import annotations

from itertools import product as combinations
from typing import NamedTuple

import numpy as np

from ..base.fixed_order import total
from .hull import ALIKE, flattened, hull_indices

BOX_LOOPS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))  # -x +x -y +y -z +z


class Polytope(NamedTuple):
    """A convex polytope, which may be flat, a segment or a point."""

    vertices: np.ndarray  # (n, 3) [m]
    planes: np.ndarray  # (faces, 4) outward unit normals and distances from the origin [m]
    loops: np.ndarray  # (faces, 2) first row in `around` and number of rows
    around: np.ndarray  # (all, 2) vertices of a face, counterclockwise from outside, and the side from each to the next
    sides: np.ndarray  # (sides, 4) vertices of the edges, the face that goes from one to the other, and back; or -1


def segment(half: float) -> Polytope:
    """Make a segment along z of this half length [m], or a point."""
    vertices = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]]) if half > 0.0 else np.zeros((1, 3))
    return _polytope(vertices, [], np.zeros((0, 3)))


def box(half: np.ndarray) -> Polytope:
    """Make a box of half edges (3,) [m]; one that is flat keeps its six faces."""
    vertices = np.array(list(combinations((-1.0, 1.0), repeat=3))) * half
    normals = np.zeros((6, 3))
    normals[range(6), [0, 0, 1, 1, 2, 2]] = [-1.0, 1.0] * 3
    return _polytope(vertices, [list(loop) for loop in BOX_LOOPS], normals)


def hull(corners: np.ndarray) -> Polytope:
    """Make the convex hull of corners (n, 3) [m]; a flat one has a face on either side."""
    from scipy.spatial import ConvexHull

    flat = flattened(corners)
    if flat.shape[1] < 2:
        return _polytope(corners[hull_indices(corners)], [], np.zeros((0, 3)))
    if flat.shape[1] == 2:
        loop = [int(i) for i in ConvexHull(flat).vertices]
        loops = [loop, loop[::-1]]
    else:
        loops = _loops(corners, ConvexHull(corners).equations)
    return _polytope(corners, loops, np.array([_newell(corners[loop]) for loop in loops]))


def _loops(x: np.ndarray, equations: np.ndarray) -> list[list[int]]:
    """Find the vertices around each face, from the planes (n, 4) of triangles; those in one plane make one face."""
    near = ALIKE * np.abs(x).max()
    heights = total(x[None] * equations[:, None, :3]) + equations[:, 3:]
    sets = {frozenset(np.flatnonzero(row > -near).tolist()): k for k, row in enumerate(heights)}
    whole = [(sorted(face), k) for face, k in sets.items() if not any(face < other for other in sets)]
    return sorted(_in_order(x, face, equations[k, :3]) for face, k in whole)


def _in_order(x: np.ndarray, face: list[int], normal: np.ndarray) -> list[int]:
    """Sort vertices counterclockwise about a normal, the first one first."""
    middle = x[face].mean(axis=0)
    first = x[face[0]] - middle
    second = np.cross(normal, first)
    angle = [np.arctan2((x[k] - middle) @ second, (x[k] - middle) @ first) % (2.0 * np.pi) for k in face[1:]]
    return [face[0], *(face[1 + k] for k in np.argsort(angle))]


def _newell(loop: np.ndarray) -> np.ndarray:
    """Compute the unit normal of a polygon (n, 3): the sum of the products of its sides, whatever its corner."""
    spokes = loop - loop[0]
    normal = total(np.cross(spokes[1:-1], spokes[2:]), axis=0)
    return normal / np.sqrt(total(normal * normal))


def _polytope(vertices: np.ndarray, loops: list[list[int]], normals: np.ndarray) -> Polytope:
    """Make a polytope of loops of vertices, whose sides get numbers; a segment has one although it has no face."""
    rings = loops or ([list(range(len(vertices)))] if len(vertices) == 2 else [])
    pairs = [sorted(pair) for loop in rings for pair in zip(loop, loop[1:] + loop[:1])]
    sides = np.unique(np.array(pairs, np.int64).reshape(-1, 2), axis=0)
    number = {tuple(pair): k for k, pair in enumerate(sides.tolist())}
    around = [(i, number[min(i, j), max(i, j)]) for loop in loops for i, j in zip(loop, loop[1:] + loop[:1])]
    goes = {edge: k for k, loop in enumerate(loops) for edge in zip(loop, loop[1:] + loop[:1])}
    beside = [(goes.get((i, j), -1), goes.get((j, i), -1)) for i, j in sides.tolist()]
    counts = np.array([len(loop) for loop in loops], np.int64)
    offsets = [float(total(vertices * normal).max()) for normal in normals]
    return Polytope(
        vertices,
        np.column_stack([normals, np.array(offsets)]) if len(normals) else np.zeros((0, 4)),
        np.column_stack([np.cumsum(counts) - counts, counts]).astype(np.int64),
        np.array(around, np.int64).reshape(-1, 2),
        np.column_stack([sides, np.array(beside, np.int64).reshape(-1, 2)]),
    )
