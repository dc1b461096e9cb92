"""The grounds of many worlds: rough ones are drawn here, and all are looked up at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..base.fixed_order import total
from ..base.portable_math import sincos
from ..core.shapes.ground import Field, facets
from ..dynamics import contact_positions
from ..model import Ground, HeightField, Model
from ..model.rest_posture import nearest_posture, standing_keyframe
from ..scene.compile import CompiledScene
from ..scene.contact import build_field, plane_axes

MOST_NODES = 3 * 10**7  # of all worlds, which take a quarter of a gigabyte
EDGE = 0.25  # of a cell beyond the last node, from where on a field is level


def rough_fields(
    heights: np.ndarray, slope: np.ndarray, heading: np.ndarray, cell: float, reach: float, start: float,
    seed: list[int],
) -> list[HeightField]:  # fmt: skip
    """Draw a height field for each world: a plane with independent normal heights at the nodes of a square grid.

    heights (n,): standard deviation of the nodes [m].  slope, heading (n,): of the plane [rad].  cell: distance of
    nodes [m].  reach: half the width [m].  start: radius about the origin in which the plane is even [m].  A node's
    height depends on the seed, the number of the world and the node alone, not on the width.
    """
    half = max(2, int(np.ceil(reach / cell)))
    k = np.arange(-half, half + 1)
    x, y = cell * k[:, None], cell * k
    ring = np.maximum(np.abs(k[:, None]), np.abs(k)).ravel()
    outward = np.argsort(ring, kind="stable")  # so that a wider field has the same nodes in its middle
    even = np.clip((np.sqrt(x * x + y * y) - start) / cell, 0.0, 1.0)
    fields, corner = [], -half * cell
    for world, (height, tilt, along) in enumerate(zip(heights.tolist(), slope.tolist(), heading.tolist())):
        z = np.zeros(ring.size)
        z[outward] = np.random.default_rng([*seed, world]).standard_normal(ring.size)
        (s, c), (sine, cosine) = sincos(tilt), sincos(along)
        plane = s / c * (cosine * x + sine * y)
        fields.append(HeightField(plane + height * even * z.reshape(len(k), -1), (cell, cell), (corner, corner)))
    return fields


def rest(model: Model) -> np.ndarray:
    """Return the positions (nq,) of a robot that stands: of its keyframe, else as near to zero as may be."""
    q = standing_keyframe(model)
    return nearest_posture(model) if q is None else np.array(q, float)


def start_radius(scene: CompiledScene) -> float:
    """Return how far from the base the contact points of a robot that stands lie at most, seen from above [m]."""
    q = rest(scene.model)
    x = contact_positions(scene.model, q)[:, :2] - q[:2]
    return float(np.sqrt(total(x * x)).max())


class Floors:
    """Look up the grounds of worlds under points of each; the fields of all worlds have as many nodes."""

    def __init__(self, grounds: Sequence[Ground]) -> None:
        first = grounds[0]
        self._field: Field | None = None
        if first.field is None:
            axes = np.array([plane_axes(one) for one in grounds])
            self._normal, self._first = axes[:, None, 0], axes[:, None, 1]
            self._height = np.array([one.height for one in grounds])[:, None] * self._normal[..., 2]
            self._steps = first.steps
            return
        fields = [one.field for one in grounds if one.field is not None]
        nodes = np.array(first.field.heights.shape)
        self._origin = np.array([one.origin for one in fields])[:, None]
        self._spacing, self._most = np.array(first.field.spacing), nodes - 1.0 + EDGE
        self._row = 1.0 + np.arange(len(fields))[:, None] * (nodes[0] + 2.0)
        beside = [np.pad(one.heights + ground.height, 1, mode="edge") for one, ground in zip(fields, grounds)]
        self._field = build_field(HeightField(np.concatenate(beside), first.field.spacing), 0.0)

    def under(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return normals (n, k, 3) of the ground under points (n, k, 3), and their heights over it along these [m]."""
        if self._field is None:
            along, over = total(self._first * points), total(self._normal * points) - self._height
            for start, rise in self._steps:
                over = over - rise * (along > start)
            return np.broadcast_to(self._normal, points.shape), over
        u = np.clip((points[..., :2] - self._origin) / self._spacing, -EDGE, self._most)
        moved = np.ascontiguousarray(points, float).copy()
        moved[..., 0], moved[..., 1] = (u[..., 0] + self._row) * self._spacing[0], (u[..., 1] + 1.0) * self._spacing[1]
        out = np.empty((points.shape[0] * points.shape[1], 7))
        facets(self._field, moved.reshape(-1, 3), out)
        return out[:, :3].reshape(points.shape), (out[:, 6] * out[:, 2]).reshape(points.shape[:2])
