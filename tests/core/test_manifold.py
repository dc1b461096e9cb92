"""Contact points of two shapes: against closed forms, brute force and MuJoCo; where they lie, and how they move."""

import functools
import hashlib
import math

import numpy as np
import pytest

from featherstone_gait import Box, Capsule, Cylinder, Hull, Shape, Sphere
from featherstone_gait.base.rotation import rotation_from_rpy
from featherstone_gait.core.shapes.distance import Room, pair_distances
from featherstone_gait.core.shapes.manifold import pair_contacts
from featherstone_gait.geometry.distance import HalfSpace, contact_bench, field_bench, shape_tables

QUARTER = 0.5 * math.pi
MARGIN = 0.01
RIM = 2e-4  # to which directions of rims on edges and on rims are found [rad]


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
        self.shapes = [x if isinstance(x, HalfSpace | Shape) else Shape("", x) for x in shapes]
        self.rotation, self.position = np.array(rotation), np.array(position, float)
        self.tables = shape_tables(self.shapes, range(len(shapes)))
        one = {"near": np.zeros((2, 99), np.int64), "ends": np.zeros(0), "field": field_bench(self.tables)}
        self.bench = contact_bench(self.tables)._replace(**one)  # one compiled kernel for all
        self.room = Room(np.zeros((len(shapes), 9)), np.zeros((len(shapes), 3)), np.zeros((4, 3)))
        self.pairs = np.arange(len(shapes)).reshape(-1, 2)

    def contacts(self, margin=0.0, swap=False):
        """The points of each pair."""
        pairs = np.ascontiguousarray(self.pairs[:, ::-1]) if swap else self.pairs
        out, counts = np.zeros((len(pairs), 8, 8)), np.zeros(len(pairs), np.int64)
        poses = self.rotation, self.position
        pair_contacts(self.tables, self.room, self.bench, pairs, margin, poses, out, counts)
        return [points[:count] for points, count in zip(out, counts)]

    def distances(self):
        """The signed distance of each pair, by core/shapes/distance.py."""
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
def touching(a, b, n=50, spread=0.02):
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
    """Directions of rims err by up to RIM, and gaps by its square times a radius."""
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
    assert found > 16


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


def ends_of(placed, k):
    """The two ends of a capsule's axis, or a sphere's center twice."""
    half = placed.tables.table[k].half[2] * placed.rotation[k, :, 2]
    return placed.position[k] - half, placed.position[k] + half


def segments_apart(p, q, r, s):
    """Distance of two segments: the ends, or inside where they cross."""
    from_ends = []
    for x, a, b in ((p, r, s), (q, r, s), (r, p, q), (s, p, q)):
        t = np.clip((x - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0.0, 1.0)
        from_ends.append(np.linalg.norm(x - a - t * (b - a)))
    d, e = q - p, s - r
    if np.linalg.norm(np.cross(d, e)) > 1e-9:
        t = np.linalg.lstsq(np.column_stack([d, -e]), r - p, rcond=None)[0]
        if ((t > 0.0) & (t < 1.0)).all():
            from_ends.append(np.linalg.norm(p + t[0] * d - r - t[1] * e))
    return min(from_ends)


@pytest.mark.parametrize("kinds", [("sphere", "sphere"), ("capsule", "sphere"), ("capsule", "capsule")], ids="-".join)
def test_spheres_and_capsules_touch_at_the_closest_points_of_their_axes(kinds):
    placed = touching(*kinds, n=150)
    for pair, points in enumerate(placed.contacts(1.0)):
        radii = placed.tables.table[2 * pair : 2 * pair + 2].radius
        depth = radii.sum() - segments_apart(*ends_of(placed, 2 * pair), *ends_of(placed, 2 * pair + 1))
        assert deepest(points)[6] == pytest.approx(depth, abs=1e-12)
        for k, side in ((0, -1.0), (1, 1.0)):  # a ball about the point's projection on each axis touches it
            surface = points[0, :3] + side * 0.5 * points[0, 6] * points[0, 3:6]
            p, q = ends_of(placed, 2 * pair + k)
            assert segments_apart(surface, surface, p, q) == pytest.approx(radii[k], abs=1e-12)


def mujoco_distance(placed, pair):
    """Signed distance of a pair by MuJoCo [m]."""
    mujoco = pytest.importorskip("mujoco")
    bodies, meshes = "", ""
    for k in placed.pairs[pair]:
        match placed.shapes[k].geometry:
            case Sphere(radius):
                size = f'type="sphere" size="{radius!r}"'
            case Capsule(radius, length):
                size = f'type="capsule" size="{radius!r} {0.5 * length!r}"'
            case Box((x, y, z)):
                size = f'type="box" size="{0.5 * x!r} {0.5 * y!r} {0.5 * z!r}"'
            case Hull(points):
                text = " ".join(repr(x) for point in points for x in point)
                meshes += f'<mesh name="m{k}" vertex="{text}" inertia="convex"/>'
                size = f'type="mesh" mesh="m{k}"'
        bodies += f'<body><freejoint/><geom {size} mass="1"/></body>'
    option = '<option ccd_tolerance="1e-12" ccd_iterations="200"/>'
    text = f"<mujoco>{option}<asset>{meshes}</asset><worldbody>{bodies}</worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for i, k in enumerate(placed.pairs[pair]):
        data.geom_xpos[i], data.geom_xmat[i] = placed.position[k], placed.rotation[k].ravel()
        if isinstance(placed.shapes[k].geometry, Hull):  # MuJoCo moves a mesh to its inertia's frame
            local = np.zeros(9)
            mujoco.mju_quat2Mat(local, model.mesh_quat[model.geom_dataid[i]])
            data.geom_xpos[i] = placed.position[k] + placed.rotation[k] @ model.mesh_pos[model.geom_dataid[i]]
            data.geom_xmat[i] = (placed.rotation[k] @ local.reshape(3, 3)).ravel()
    return mujoco.mj_geomDistance(model, data, 0, 1, 10.0, np.zeros(6))


@pytest.mark.parametrize(
    "kinds", [("hull", "sphere"), ("hull", "box"), ("hull", "hull"), ("box", "capsule")], ids="-".join
)
def test_the_deepest_point_is_as_deep_as_mujoco_says(kinds):
    placed = touching(*kinds, n=60)
    off = []
    for pair, points in enumerate(placed.contacts(0.03)):
        theirs = mujoco_distance(placed, pair)
        if len(points):
            off.append(-deepest(points)[6] - theirs)
        else:
            assert theirs > 0.03 - 1e-9
    assert len(off) > 40
    assert np.abs(off).max() < (3e-8 if "hull" in kinds else 1e-9)  # MuJoCo keeps meshes in single precision


@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_what_is_farther_apart_than_is_looked_at_has_no_points(kinds):
    """Also where no face parts the shapes, and the edges that do are far apart."""
    placed = touching(*kinds, spread=0.1)
    pairs = range(len(placed.pairs))
    apart = placed.distances() if "half space" not in kinds else [over_half_space(placed, pair) for pair in pairs]
    for gap, points in zip(apart, placed.contacts(0.002)):
        assert gap < 0.002 + 1e-6 or len(points) == 0


@pytest.mark.parametrize(("gap", "margin", "count"), [(0.02, 0.002, 0), (0.02, 0.03, 1), (-0.01, 0.002, 1)])
def test_cubes_on_their_edges_touch_where_the_edges_cross(gap, margin, count):
    """No face parts them, since each edge is longer than the other cube is wide there."""
    turns = [rotation_from_rpy((math.pi / 4, 0.0, 0.0)), rotation_from_rpy((0.0, math.pi / 4, 0.0))]
    cubes = Placed([CUBE, CUBE], turns, [(0.0, 0.0, math.sqrt(2.0) + gap), (0.0, 0.0, 0.0)])
    [points] = cubes.contacts(margin)
    assert len(points) == count
    assert points[:, 6] == pytest.approx([-gap] * count, abs=1e-12)


@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_points_lie_in_both_shapes_within_their_depth(kinds):
    placed = touching(*kinds)
    found = [(k, x) for k, points in enumerate(placed.contacts(MARGIN)) for x in points]
    for side in (0, 1):
        shapes = [geometry for k, _ in found for geometry in (Sphere(0.0), placed.shapes[2 * k + side])]
        rotation = [E for k, _ in found for E in (np.eye(3), placed.rotation[2 * k + side])]
        position = [r for k, x in found for r in (x[:3], placed.position[2 * k + side])]
        dots = Placed(shapes, rotation, position)
        gaps = np.array([-points[0, 6] for points in dots.contacts(1.0)])
        depths = np.array([x[6] for _, x in found])
        assert (gaps <= 0.5 * np.abs(depths) + 1e-9).all()


def nearby(points, others, close):
    """Whether two sets of points are the same, in any order."""
    if not len(points) or not len(others):
        return len(points) == len(others)
    off = np.abs(points[:, None, :7] - others[None, :, :7]).max(axis=2)
    return len(points) == len(others) and (off.min(axis=1) < close).all() and (off.min(axis=0) < close).all()


@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_the_shapes_named_the_other_way_round_have_the_points_with_opposite_normals(kinds):
    placed = touching(*kinds)
    for points, others in zip(placed.contacts(MARGIN), placed.contacts(MARGIN, swap=True)):
        others[:, 3:6] *= -1.0
        if kinds[0] != kinds[1]:
            assert (points == others).all()
        else:
            assert nearby(points, others, RIM if "cylinder" in kinds else 1e-7)


@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_points_move_along_with_the_shapes(kinds):
    placed, rng = touching(*kinds), np.random.default_rng(1)
    before = placed.contacts(MARGIN)
    E, r = rotation_from_rpy(rng.uniform(-3.0, 3.0, 3)), rng.uniform(-1.0, 1.0, 3)
    moved = Placed(placed.shapes, E @ placed.rotation, placed.position @ E.T + r)
    for points, others in zip(before, moved.contacts(MARGIN)):
        points[:, :3] = points[:, :3] @ E.T + r
        points[:, 3:6] = points[:, 3:6] @ E.T
        assert nearby(points, others, RIM if "cylinder" in kinds else 1e-7)
        assert set(points[:, 7]) == set(others[:, 7])


def resultant(points):
    """Sum of the depths times the normals [m]."""
    return (np.maximum(points[:, 6], 0.0)[:, None] * points[:, 3:6]).sum(axis=0)


def along_path(a, b, pose, steps, margin=0.0):
    """Points of shape a at poses (position, roll pitch yaw) for 0 to 1, above shape b at the origin, in steps."""
    found = []
    placed = place(a, b)
    for xyz, rpy in (pose(t) for t in np.linspace(0.0, 1.0, steps)):
        placed.position[0], placed.rotation[0] = xyz, rotation_from_rpy(np.array(rpy))
        found += placed.contacts(margin)
    return found


LONG = Shape("", Capsule(0.05, 0.5), (0.0, 0.0, 0.0), (0.0, QUARTER, 0.0))  # along x
BAR = Box((2.0, 0.02, 0.02))
LOG = Shape("", Cylinder(0.05, 0.5), (0.0, 0.0, 0.0), (0.0, QUARTER, 0.0))
PATHS = {  # each crosses what divides two ways to touch
    "capsules turn through parallel": (LONG, LONG, lambda t: ((0.05, 0.0, 0.099), (0.0, 0.0, 0.02 * (t - 0.5)))),
    "capsules tilt through parallel": (LONG, LONG, lambda t: ((0.05, 0.0, 0.099), (0.0, 0.02 * (t - 0.5), 0.0))),
    "one capsule slides off another": (LONG, LONG, lambda t: ((0.4 + 0.2 * t, 0.0, 0.099), (0.0, 0.0, 0.0))),
    "a capsule tilts over an edge": (LONG, CUBE, lambda t: ((0.6, 0.0, 0.549), (0.0, 0.02 * (t - 0.5), 0.0))),
    "a sphere rolls over an edge": (Sphere(0.1), CUBE, lambda t: ((0.4 + 0.2 * t, 0.1, 0.599 - 0.1 * t), (0.0,) * 3)),
    "a cylinder rises on its rim": (
        Cylinder(0.1, 0.2), CUBE, lambda t: ((0.1, 0.1, 0.599), (0.0, 1e-3 * t - 5e-4, 0.0)),
    ),
    "cylinders turn through parallel": (LOG, LOG, lambda t: ((0.05, 0.0, 0.099), (0.0, 0.0, 0.02 * (t - 0.5)))),
    "cylinders tilt through parallel": (LOG, LOG, lambda t: ((0.05, 0.0, 0.099), (0.0, 0.02 * (t - 0.5), 0.0))),
    "a cylinder tilts from its side": (
        Cylinder(0.1, 0.2), HalfSpace(), lambda t: ((0.0, 0.0, 0.099), (0.0, QUARTER + 0.02 * (t - 0.5), 0.0)),
    ),
    "a cube tips onto an edge": (CUBE, CUBE, lambda t: ((0.1, 0.2, 0.999), (0.01 * (t - 0.5), 0.0, 0.3))),
    "a corner leaves over a side": (Box((0.5,) * 3), CUBE, lambda t: ((0.2 + 0.1 * t, 0.02, 0.749), (0.0, 0.0, 0.05))),
    "a bar slides off between sides": (BAR, CUBE, lambda t: ((0.0, 0.45 + 0.1 * t, 0.509), (0.0, 0.0, 0.2))),
    "a cube tips onto a corner": (CUBE, HalfSpace(), lambda t: ((0.1, 0.2, 0.499), (0.01 * t, 0.004, 0.3))),
}  # fmt: skip


@pytest.mark.parametrize("path", PATHS)
def test_the_force_of_equal_springs_does_not_jump(path):
    """The sum of depths times normals changes with the path: half the steps, half the change."""
    a, b, pose = PATHS[path]
    coarse, fine = (
        np.abs(np.diff([resultant(points) for points in along_path(a, b, pose, steps)], axis=0)).max()
        for steps in (401, 3201)
    )
    near, far = (along_path(a, b, pose, 101, margin) for margin in (0.0, 0.05))
    for points, others in zip(near, far):
        assert resultant(points) == pytest.approx(resultant(others), abs=1e-15)  # whatever the margin
    assert coarse > 0.0
    assert fine < 0.2 * coarse


def test_a_corner_that_crosses_a_side_becomes_two_points_by_and_by():
    """Two points at the place of the corner have its depth together; a tenth of the half sides apart, each has it."""

    def slide(t):
        return (0.15 + 0.1 * t, 0.02, 0.749), (0.0, 0.0, 0.5)

    path = along_path(Box((0.5, 0.5, 0.5)), CUBE, slide, 1001)
    first = next(k for k, points in enumerate(path) if len(points) == 5)
    assert [resultant(path[k])[2] for k in (first - 1, first, 1000)] == pytest.approx([4e-3, 4e-3, 5e-3], rel=0.03)


@pytest.mark.parametrize(
    "below", [HalfSpace(), Shape("", Box((4.0, 2.0, 1.0)), (0.0, 0.0, -0.5))], ids=["plane", "box"]
)
def test_a_cylinder_rolls_on_its_line_and_on_its_rim(below):
    lying = along_path(Cylinder(0.1, 0.4), below, lambda t: ((0.6 * t, 0.0, 0.0999), (QUARTER, 6.0 * t, 0.0)), 500)
    for t, points in zip(np.linspace(0.0, 1.0, 500), lying):
        assert len(points) == 2
        assert set(points[:, 7]) == set(lying[0][:, 7])
        assert points[:, 0] == pytest.approx([0.6 * t] * 2)
        assert np.sort(points[:, 1]) == pytest.approx([-0.2, 0.2])
        assert points[:, 6] == pytest.approx([1e-4] * 2)
    height = 0.2 * math.cos(0.3) + 0.1 * math.sin(0.3) - 1e-4
    shape = Shape("", Cylinder(0.1, 0.4), (0.0, 0.0, 0.0), (0.3, 0.0, 0.0))
    turning = along_path(shape, below, lambda t: ((0.0, 0.0, height), (0.0, 0.0, 6.0 * t)), 500)
    for t, points in zip(np.linspace(0.0, 1.0, 500), turning):
        [x] = points
        assert x[7] == turning[0][0, 7]
        assert x[6] == pytest.approx(1e-4)
        reach = 0.2 * math.sin(0.3) - 0.1 * math.cos(0.3)
        assert x[:2] == pytest.approx([-reach * math.sin(6.0 * t), reach * math.cos(6.0 * t)])


ROUND = [Cylinder(0.1, 0.6), Capsule(0.1, 0.6)]


@pytest.mark.parametrize("upper", ROUND, ids=["cylinder", "capsule"])
@pytest.mark.parametrize(("turn", "count"), [(0.0, 2), (0.3, 1), (QUARTER, 1)])
def test_round_sides_touch_between_the_axes(upper, turn, count):
    """Two logs: parallel ones along the common part, crossed ones below the crossing of the axes."""
    a, b = (Shape("", geometry, (0.0, 0.0, 0.0), (QUARTER, 0.0, 0.0)) for geometry in (upper, ROUND[0]))
    [points] = place(a, b, (0.03, 0.2, 0.19), (0.0, 0.0, turn)).contacts()
    assert len(points) == count
    n = np.array([0.03, 0.0, 0.19]) / math.hypot(0.03, 0.19) if turn == 0.0 else np.array([0.0, 0.0, 1.0])
    depth = 0.2 - (math.hypot(0.03, 0.19) if turn == 0.0 else 0.19)
    assert points[:, 3:6] == pytest.approx(np.tile(n, (count, 1)), abs=1e-12)
    assert points[:, 6] == pytest.approx([depth] * count, abs=1e-12)
    if turn == 0.0:
        assert np.sort(points[:, 1]) == pytest.approx([-0.1, 0.3])


def test_a_capsule_on_a_face_touches_at_two_points_which_the_sides_cut():
    [points] = place(LONG, CUBE, (0.4, 0.1, 0.549)).contacts()
    assert np.sort(points[:, 0]) == pytest.approx([0.15, 0.5])
    assert points[:, 6] == pytest.approx([1e-3, 1e-3])


def test_what_is_flat_or_of_one_point_touches_along_a_finite_normal():
    line = tuple((x, 0.0, 0.0) for x in (-0.1, 0.1))
    square = tuple((x, y, 0.0) for x in (-0.1, 0.1) for y in (-0.1, 0.1))
    thin = [
        Sphere(0.0), Capsule(0.0, 0.0), Capsule(0.0, 0.2), Capsule(0.1, 0.0), Cylinder(0.0, 0.2), Cylinder(0.1, 0.0),
        Cylinder(0.0, 0.0), Box((0.2, 0.2, 0.0)), Box((0.2, 0.0, 0.0)), Box((0.0, 0.0, 0.0)), Hull(((0.0, 0.0, 0.0),)),
        Hull(line), Hull(square), Sphere(0.1), HalfSpace(),
    ]  # fmt: skip
    rng, found = np.random.default_rng(0), 0
    every = [shape for a in thin for b in thin for shape in (a, b)]
    placed = Placed(every, [np.eye(3)] * len(every), np.zeros((len(every), 3)))
    for center in ((0.0, 0.0, 0.0), (0.0, 0.0, 0.1), (0.03, -0.05, 0.001)):
        for turn in (np.eye(3), rotation_from_rpy(rng.uniform(-3.0, 3.0, 3)), rotation_from_rpy([QUARTER, 0.0, 0.0])):
            placed.rotation[::2], placed.position[::2] = turn, center
            for points in placed.contacts(0.05):
                found += len(points)
                assert np.isfinite(points).all()
                assert np.linalg.norm(points[:, 3:6], axis=1) == pytest.approx(np.ones(len(points)))
                assert len(set(points[:, 7])) == len(points)
                assert ((points[:, 7] >= 0.0) & (points[:, 7] < 2.0**20)).all()
    assert found > 500
    for shape in (Sphere(0.1), Capsule(0.1, 0.0), Hull(((0.0, 0.0, 0.0),))):
        [[point]] = place(shape, Sphere(0.1)).contacts(0.05)
        assert point[3:6].tolist() == [0.0, 0.0, 1.0]


@pytest.mark.bounds
@pytest.mark.nojit
def test_contacts_have_the_same_bits_compiled_or_not():
    bits = hashlib.sha256()
    for kinds in PAIRS:
        placed = touching(*kinds, n=6)
        for margin in (0.0, MARGIN):
            bits.update(np.concatenate(placed.contacts(margin)).tobytes())
    assert bits.hexdigest()[:16] == "408170f76c107982"
