"""Contact points of two shapes: against closed forms, brute force and MuJoCo; where they lie, and how they move."""

import functools
import hashlib
import math

import numpy as np
import pytest

from featherstone_gait import Box, Capsule, Cylinder, Hull, Shape, Sphere
from featherstone_gait.base.rotation import rotation_from_rpy
from featherstone_gait.core.tree.distance import Room, pair_distances
from featherstone_gait.core.tree.manifold import pair_contacts
from featherstone_gait.geometry.distance import HalfSpace, contact_bench, shape_tables

QUARTER = 0.5 * math.pi
MARGIN = 0.01


def ball_of(rng, n):
    """A hull of n points on a sphere."""
    x = rng.normal(size=(n, 3))
    return Hull(tuple(map(tuple, (rng.uniform(0.1, 0.2) * x / np.linalg.norm(x, axis=1)[:, None]).round(9).tolist())))


KINDS = {
    "sphere": lambda rng: Sphere(rng.uniform(0.05, 0.2)),
    "capsule": lambda rng: Capsule(rng.uniform(0.03, 0.1), rng.uniform(0.1, 0.4)),
    "box": lambda rng: Box(tuple(rng.uniform(0.1, 0.4, 3).tolist())),
    "hull": lambda rng: ball_of(rng, int(rng.integers(5, 14))),
    "cylinder": lambda rng: Cylinder(rng.uniform(0.05, 0.2), rng.uniform(0.1, 0.4)),
    "half space": lambda rng: HalfSpace(),
}
CONVEX = [kind for kind in KINDS if kind != "half space"]
PAIRS = [(a, b) for k, a in enumerate(CONVEX) for b in [*CONVEX[: k + 1], "half space"]]


class Placed:
    """Pairs of shapes, each on a link of its own, and where the links are."""

    def __init__(self, shapes, rotation, position):
        self.shapes = [x if isinstance(x, HalfSpace) else Shape("", x) for x in shapes]
        self.rotation, self.position = np.array(rotation), np.array(position, float)
        self.tables = shape_tables(self.shapes, range(len(shapes)))
        self.room = Room(np.zeros((len(shapes), 9)), np.zeros((len(shapes), 3)), np.zeros((4, 3)))
        self.pairs = np.arange(len(shapes)).reshape(-1, 2)

    def contacts(self, margin=0.0, swap=False):
        """The points of each pair."""
        pairs = np.ascontiguousarray(self.pairs[:, ::-1]) if swap else self.pairs
        out, counts = np.zeros((len(pairs), 8, 8)), np.zeros(len(pairs), np.int64)
        bench = contact_bench(self.tables)
        pair_contacts(self.tables, self.room, bench, pairs, margin, self.rotation, self.position, out, counts)
        return [points[:count] for points, count in zip(out, counts)]

    def distances(self):
        """The signed distance of each pair, by core/tree/distance.py."""
        out = np.zeros(len(self.pairs))
        pair_distances(self.tables, self.room, self.pairs, self.rotation, self.position, out)
        return out

    def support(self, k, u):
        """Heights of shape k along directions u (n, 3) [m]."""
        row = self.tables.table[k]
        local = u @ self.rotation[k]
        corners = self.tables.corners[row.first : row.first + row.corners]
        core = (local @ corners.T).max(axis=1) if len(corners) else np.abs(local) @ row.half
        return u @ self.center(k) + core + row.disc * np.hypot(local[:, 0], local[:, 1]) + row.radius

    def center(self, k):
        """Center of shape k [m]."""
        return self.position[k] + self.rotation[k] @ self.tables.table[k].r

    def gap(self, pair, n):
        """Gap of a pair along directions n (m, 3) from the second to the first [m]."""
        a, b = self.pairs[pair]
        return -self.support(a, -n) - self.support(b, n)


def turned(rng):
    """A random rotation; every third one by quarters of a turn."""
    return rotation_from_rpy(rng.uniform(-3.0, 3.0, 3) if rng.random() < 0.7 else QUARTER * rng.integers(0, 4, 3))


@functools.cache
def touching(a, b, n=150, spread=0.02):
    """Pairs of two kinds whose signed distances are up to `spread` [m]; above a half space the lower points are."""
    rng = np.random.default_rng(CONVEX.index(a) * 7 + [*KINDS].index(b))
    placed = Placed(
        [KINDS[kind](rng) for _ in range(n) for kind in (a, b)],
        [turned(rng) for _ in range(2 * n)],
        rng.normal(size=(2 * n, 3)) * 0.15,
    )
    target = rng.uniform(-spread, spread, n)
    for k in range(n if b == "half space" else 0):
        up = placed.rotation[2 * k + 1, :, 2]
        low = -placed.support(2 * k, -up[None])[0] - up @ placed.position[2 * k + 1]
        placed.position[2 * k] += up * (target[k] - low)
    for _ in range(0 if b == "half space" else 30):
        off = placed.distances() - target
        ahead = placed.position[1::2] - placed.position[::2]
        placed.position[1::2] -= ahead * (off / np.linalg.norm(ahead, axis=1))[:, None]
    placed.position = placed.position.round(9)  # whatever the order in which this processor sums
    return placed


def deepest(points):
    """The row of the deepest point."""
    return points[points[:, 6].argmax()]


def sphere_of_directions(n):
    """Directions (n, 3), evenly spread."""
    z = 1.0 - (2.0 * np.arange(n) + 1.0) / n
    angle = math.pi * (3.0 - 5.0**0.5) * np.arange(n)
    return np.column_stack([np.cos(angle), np.sin(angle), z]) * np.column_stack([np.sqrt(1 - z * z)] * 2 + [np.ones(n)])


EVERY = sphere_of_directions(4000)


def better_direction(placed, pair, n):
    """The largest gap along directions everywhere, and ever closer to the best of them and to n [m]."""
    gaps = placed.gap(pair, EVERY)
    rng, best = np.random.default_rng(0), -np.inf
    for start in (EVERY[gaps.argmax()], n):
        m, width, most = start, 0.05, -np.inf
        for _ in range(25):
            near = m + width * rng.normal(size=(60, 3))
            near = np.vstack([m, near / np.linalg.norm(near, axis=1)[:, None]])
            found = placed.gap(pair, near)
            m, most, width = near[found.argmax()], found.max(), 0.5 * width
        best = max(best, most)
    return best


def over_half_space(placed, pair):
    """Gap of a shape over a half space, by its support [m]."""
    n = placed.rotation[2 * pair + 1, :, 2]
    return -placed.support(2 * pair, -n[None])[0] - n @ placed.position[2 * pair + 1]


@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_the_deepest_point_is_as_deep_as_the_shapes_and_no_direction_parts_them_sooner(kinds):
    """Directions of rims on edges are found to 1e-4 rad only."""
    placed, found = touching(*kinds), 0
    close = 1e-7 if "cylinder" in kinds else 2e-9
    distances = None if "half space" in kinds else placed.distances()
    for pair, points in enumerate(placed.contacts(MARGIN)):
        if "half space" in kinds:
            assert len(points) == 0 or -deepest(points)[6] == pytest.approx(over_half_space(placed, pair), abs=1e-12)
            assert len(points) or over_half_space(placed, pair) > MARGIN
        elif len(points):
            n, depth = deepest(points)[3:6], deepest(points)[6]
            assert n @ n == pytest.approx(1.0, abs=1e-12)
            assert depth == pytest.approx(-placed.gap(pair, n[None])[0], abs=close), pair
            assert -depth > better_direction(placed, pair, n) - close, pair
        else:
            assert distances[pair] > MARGIN - 1e-9
        found += len(points) > 0
    assert found > 50


def place(a, b, xyz=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0)):
    """Shape a there, and b at the origin."""
    return Placed([a, b], [rotation_from_rpy(rpy), np.eye(3)], [xyz, (0.0, 0.0, 0.0)])


CUBE = Box((1.0, 1.0, 1.0))


@pytest.mark.parametrize(("turn", "corners"), [(0.0, 4), (0.5 * QUARTER, 8), (0.1, 8)])
def test_a_cube_rests_on_another_with_four_points_or_turned_with_eight(turn, corners):
    [points] = place(CUBE, CUBE, (0.0, 0.0, 0.99), (0.0, 0.0, turn)).contacts()
    assert len(points) == corners
    assert points[:, 2:7] == pytest.approx(np.tile([0.495, 0.0, 0.0, 1.0, 0.01], (corners, 1)))
    assert len(set(points[:, 7])) == corners
    assert np.abs(points[:, :2]).max() == pytest.approx(0.5)


@pytest.mark.bounds
@pytest.mark.nojit
def test_contacts_have_the_same_bits_compiled_or_not():
    bits = hashlib.sha256()
    for kinds in PAIRS:
        placed = touching(*kinds, n=6)
        for margin in (0.0, MARGIN):
            bits.update(np.concatenate(placed.contacts(margin)).tobytes())
    assert bits.hexdigest()[:16] == "9346628a208deb1d"
