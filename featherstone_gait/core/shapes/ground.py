"""The ground: a plane that may be tilted and have steps, or a height field.

Each kind gives its axes: normal, first and second tangent; and the height of a point over it.

A height field is bilinear between the nodes of a grid, but for a strip along the lines of the grid in which its slope
goes over from one cell's to the next's: bilinear interpolation smoothed by a box of the width `BLEND` of a cell.  So
its normal is continuous, and the force along it does no work on a closed path.  Beyond the grid it goes on level.
"""

from typing import NamedTuple

import numpy as np

from ..compile.by_type import by_type
from ..compile.jit import entry, inline
from ..compile.lanes import clamp, gather, select, sqrt
from ..compile.structure import record, structure
from ..compile.taped import constant
from ..tree.spatial import dot, store3, vector

PLANE = record(
    normal=(float, 3),
    first=(float, 3),  # tangent, along which the steps lie
    second=(float, 3),  # tangent
    height=float,  # over the origin along the normal [m]
)
RISE = record(
    start=float,  # distance along the first tangent at which a step begins [m]
    rise=float,  # [m]
)
GRID = record(
    origin=(float, 2),  # x and y one cell before the first node [m]
    cells=(float, 2),  # 1 / spacing [1/m]
    nodes=(float, 2),  # along x and y
    top=float,  # no height is above it [m]
    margin=float,  # what lies higher above the top is far away [m]
)
BLEND = 0.25  # of a cell, over which its slope goes over into the next one's
_ROUND = 1.5 * 2.0**52  # added and taken away it rounds to an integer


@structure
class Plane(NamedTuple):
    """A plane with steps."""

    plane: np.ndarray  # (1,) PLANE
    steps: np.ndarray  # (steps,) RISE


@structure
class Field(NamedTuple):
    """A height field."""

    grid: np.ndarray  # (1,) GRID
    heights: np.ndarray  # (nodes + 2 along x times nodes + 2 along y,) those at the edge repeated once [m]


@by_type
def fixed_axes(ground):
    """Return normal, first and second tangent if they are the same everywhere, else None."""


@fixed_axes.of(Plane)
def _plane_axes(ground):
    plane = ground.plane[0]
    return vector(plane.normal), vector(plane.first), vector(plane.second)


fixed_axes.of(Field)(lambda ground: None)


@inline
def facet(field, x):
    """Return normal and first tangent of the field under the point x, and the height of x above it [m]."""
    h, hx, hy = surface(field, x[0], x[1])
    r = 1.0 / sqrt(1.0 + hx * hx + hy * hy)
    k = 1.0 / sqrt(1.0 + hx * hx)
    return (-hx * r, -hy * r, r), (k, 0.0 * k, hx * k), x[2] - h


@inline
def surface(field, x, y):
    """Return the height [m] of a field at x and y [m], and its slopes along them."""
    grid = field.grid[0]
    i, a, da = _stencil((x - grid.origin[0]) * grid.cells[0], grid.nodes[0])
    j, b, db = _stencil((y - grid.origin[1]) * grid.cells[1], grid.nodes[1])
    width, h, hx, hy = grid.nodes[1] + 2.0, 0.0 * x, 0.0 * x, 0.0 * x
    for k in range(3):
        row = (i + (k - 1.0)) * width + j
        low, at, high = gather(field.heights, row - 1.0), gather(field.heights, row), gather(field.heights, row + 1.0)
        along = b[0] * low + b[1] * at + b[2] * high
        h = h + a[k] * along
        hx = hx + da[k] * along
        hy = hy + a[k] * (db[0] * low + db[1] * at + db[2] * high)
    return h, hx * grid.cells[0], hy * grid.cells[1]


@inline
def _stencil(u, nodes):
    """Return the nearest node, the weights of it and its neighbors, and their derivatives by u [cells]."""
    last = nodes + 0.25
    u = select(u > 0.75, select(u < last, u, last), 0.75)  # NaN is not greater either
    i = constant((u + _ROUND) - _ROUND)
    v = u - i
    up, d_up = _ramp(v)
    down, d_down = _ramp(-v)
    return i, (down, 1.0 - up - down, up), (-d_down, d_down - d_up, d_up)


@inline
def _ramp(v):
    """Return max(v, 0) smoothed over the width BLEND, and its slope."""
    inside = clamp(v + 0.5 * BLEND, 0.0, BLEND)
    beyond = clamp(v - 0.5 * BLEND, 0.0, 1.0)
    return inside * inside * (0.5 / BLEND) + beyond, inside * (1.0 / BLEND)


@inline
def ground_height(ground, along):
    """Return the height of a plane with steps [m] at the distance along its first tangent [m]."""
    height = ground.plane[0].height + 0.0 * along
    for k in range(len(ground.steps)):
        height = select(along > ground.steps[k].start, height + ground.steps[k].rise, height)
    return height


@by_type
def height_over(ground, x):
    """Return the height of the point x over the ground, along its normal [m]."""


@height_over.of(Plane)
def _over_plane(ground, x):
    n, t, _ = fixed_axes(ground)
    return dot(n, x) - ground_height(ground, dot(t, x))


@height_over.of(Field)
def _over_field(ground, x):
    n, _, over = facet(ground, x)
    return over * n[2]


@by_type
def narrowest(ground):
    """Return the width of the narrowest that the ground has [m]: between steps, or of a cell."""


@narrowest.of(Plane)
def _between_steps(ground):
    width = 1e300
    for k in range(1, len(ground.steps)):
        width = min(width, ground.steps[k].start - ground.steps[k - 1].start)
    return width


@narrowest.of(Field)
def _of_cells(ground):
    cells = ground.grid[0].cells
    return 1.0 / max(cells[0], cells[1])


@entry
def facets(field, points, out):
    """Fill out (k, 7): normal, first tangent and height over the field of each point (k, 3)."""
    for k in range(len(points)):
        n, t, over = facet(field, (points[k, 0], points[k, 1], points[k, 2]))
        store3(out, k, 0, n)
        store3(out, k, 3, t)
        out[k, 6] = over
