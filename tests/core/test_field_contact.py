"""Contact of shapes with height fields: against half spaces, the shapes' own supports, and MuJoCo."""

import hashlib
import math

import mujoco
import numpy as np
import pytest
from test_manifold import Placed

from featherstone_gait import Box, Capsule, Cylinder, HeightField, Hull, Sphere
from featherstone_gait.base.rotation import rotation_from_rpy
from featherstone_gait.geometry.distance import HalfSpace

QUARTER = 0.5 * math.pi
POINTS = ((0.06, 0.0, -0.05), (-0.05, 0.04, -0.06), (-0.04, -0.06, -0.03), (0.0, 0.01, 0.08), (0.03, 0.05, 0.04))
SHAPES = {
    "sphere": Sphere(0.05),
    "capsule": Capsule(0.03, 0.2),
    "box": Box((0.1, 0.15, 0.2)),
    "cylinder": Cylinder(0.05, 0.12),
    "hull": Hull(POINTS),
}
LEVEL = HeightField(np.zeros((12, 14)), (0.07, 0.05), (-0.4, -0.33))


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.3, 0.2, 1.0), (0.0, QUARTER, 0.3)])
@pytest.mark.parametrize("kind", SHAPES)
def test_a_level_field_is_a_half_space_wherever_it_lies(kind, turn):
    """Tilted in space, and across the edges of cells: as many points, the same but for rounding."""
    tilt, shapes, rotation, position = rotation_from_rpy((0.2, -0.1, 0.4)), [], [], []
    for k in range(15):
        for under in (LEVEL, HalfSpace()):
            shapes += [SHAPES[kind], under]
            rotation += [tilt @ rotation_from_rpy(turn), tilt]
            position += [tilt @ (-0.15 + 0.013 * k, 0.1 - 0.011 * k, 0.0), np.zeros(3)]
    placed, up = Placed(shapes, rotation, position), tilt[:, 2]
    for k in range(0, len(shapes), 2):
        placed.position[k] += up * (placed.support(k, -up[None])[0] - 0.002)
    found = placed.contacts(0.003)
    for one, two in zip(found[::2], found[1::2]):
        assert len(one) == len(two) > 0
        apart = np.abs(one[:, None, :7] - two[None, :, :7]).max(axis=2)
        assert apart.min(axis=0).max() < 2e-15


ROOF = HeightField(np.outer([-0.2, 0.0, -0.2], np.ones(5)), (0.4, 0.1), (-0.4, -0.2))
RIDGES = HeightField(np.outer([0.0, 0.02, 0.0, 0.02, 0.0, 0.02, 0.0], np.ones(9)), (0.04, 0.05), (-0.12, -0.2))
PEAK = HeightField(np.pad([[0.05]], 2), (0.1, 0.1), (-0.2, -0.2))


def on(field, shape, xyz, rpy=(0.0, 0.0, 0.0), margin=0.0):
    """The contact points of a shape and a field at the origin."""
    return Placed([shape, field], [rotation_from_rpy(rpy), np.eye(3)], [xyz, (0.0, 0.0, 0.0)]).contacts(margin)[0]


@pytest.mark.parametrize("slope", [-0.5, -0.01, 0.01, 0.1, 0.5, 2.5])
def test_the_force_on_a_ball_changes_steadily_over_a_ridge_and_through_a_valley(slope):
    """The sum of depths times normals moves by at most twice the way of the ball, across and along the edge."""
    field = HeightField(np.outer([0.4 * slope, 0.0, 0.4 * slope], np.ones(5)), (0.4, 0.1), (-0.4, -0.2))
    height = 0.05 * max(1.0, math.sqrt(1.0 + slope * slope) if slope > 0.0 else 1.0) - 1e-3
    sums, placed = [], Placed([Sphere(0.05), field], [np.eye(3)] * 2, np.zeros((2, 3)))
    for x in np.arange(-0.004, 0.004, 4e-6):
        placed.position[0] = (x, 7.0 * x, height)
        [points] = placed.contacts()
        sums.append((points[:, 6:7] * points[:, 3:6]).sum(axis=0))
    assert np.linalg.norm(np.diff(sums, axis=0), axis=1).max() < 1e-5
    assert np.linalg.norm(sums, axis=1).min() > 1e-5 if slope > -0.1 else True


def test_a_ball_on_a_ridge_is_as_deep_as_its_distance_to_the_edge():
    [point] = on(ROOF, Sphere(0.05), (0.004, 0.03, 0.049))
    distance = math.hypot(0.004, 0.049)
    assert point[6] == pytest.approx(0.05 - distance, abs=1e-15)
    assert point[3:6] == pytest.approx(np.array([0.004, 0.0, 0.049]) / distance, abs=1e-14)


def test_a_ball_in_a_valley_touches_both_sides():
    valley = HeightField(-5.0 * ROOF.heights, ROOF.spacing, ROOF.origin)  # a tangent of 2.5
    height, depth = 0.05 * math.sqrt(1.0 + 2.5**2), 1e-4
    points = on(valley, Sphere(0.05), (0.0, 0.013, height - depth * math.sqrt(1.0 + 2.5**2)))
    assert len(points) == 2
    assert points[:, 6] == pytest.approx([depth, depth], abs=1e-12)
    assert sorted(points[:, 3] / points[:, 5]) == pytest.approx([-2.5, 2.5])


def test_a_box_on_ridges_touches_them_where_they_leave_its_sides():
    """Ridges at x = -0.08, 0, 0.08 along y; the box spans all of them, and reaches from y = -0.06 to 0.04."""
    points = on(RIDGES, Box((0.2, 0.1, 0.05)), (0.0, -0.01, 0.044))
    assert points[:, 3:7] == pytest.approx(np.tile([0.0, 0.0, 1.0, 0.001], (6, 1)), abs=1e-12)
    places = {(round(float(x), 9) + 0.0, round(float(y), 9)) for x, y in points[:, :2]}
    assert places == {(x, y) for x in (-0.08, 0.0, 0.08) for y in (-0.06, 0.04)}
    assert len(set(points[:, 7])) == 6


@pytest.mark.parametrize("kind", ["box", "cylinder", "capsule", "hull"])
def test_a_peak_reaches_into_a_shape_as_deep_as_its_support_says(kind):
    """From above, along the normal of the face or side that it meets."""
    rpy = (0.0, QUARTER, 0.0) if kind == "capsule" else (0.0, 0.0, 0.0)
    shape = Box((0.1, 0.15, 0.2)) if kind == "hull" else SHAPES[kind]
    if kind == "hull":
        shape = Hull(tuple((x, y, z) for x in (-0.05, 0.05) for y in (-0.07, 0.07) for z in (-0.1, 0.1)))
    placed = Placed([shape, shape], [rotation_from_rpy(rpy)] * 2, np.zeros((2, 3)))
    low = placed.support(0, np.array([[0.0, 0.0, -1.0]]))[0]
    points = on(PEAK, shape, (0.01, 0.012 if kind != "capsule" else 0.0, 0.05 + low - 0.002), rpy)
    assert len(points) == 1
    assert points[0, 3:7] == pytest.approx([0.0, 0.0, 1.0, 0.002], abs=1e-12)
    assert points[0, :3] == pytest.approx([0.0, 0.0, 0.049], abs=1e-12)


def test_beyond_its_border_and_far_below_it_a_field_is_not_there():
    assert len(on(LEVEL, Sphere(0.05), (0.6, 0.0, 0.0))) == 0
    assert len(on(LEVEL, Box((0.1, 0.1, 0.1)), (0.0, 0.0, 1.0))) == 0
    assert len(on(LEVEL, Box((0.1, 0.1, 0.1)), (0.0, 0.0, -1.0))) == 0


# ---------------------------------------------------------------------------------------------- MuJoCo

NODES = (9, 8)
ROUGH = HeightField(
    (0.03 * np.random.default_rng(1).random(NODES)).astype(np.float32).astype(float), (0.1, 0.12), (-0.4, -0.42)
)
GEOMS = {"sphere": 'type="sphere" size="0.05"', "capsule": 'type="capsule" size="0.03 0.1"'}


def mujocos(geom, xyz, rotation):
    """Depths, normals from field to geom and places of MuJoCo's contacts on the rough field."""
    low, high = ROUGH.heights.min(), ROUGH.heights.max()
    rows = " ".join(map(str, ((ROUGH.heights - low) / (high - low)).T[::-1].ravel()))
    asset = f'<hfield name="h" nrow="8" ncol="9" size="0.4 0.42 {high - low} 0.1" elevation="{rows}"/>'
    m = mujoco.MjModel.from_xml_string(
        f'<mujoco><asset>{asset}</asset><worldbody><geom type="hfield" hfield="h" pos="0 0 {low}"/>'
        f"<body><freejoint/><geom {geom}/></body></worldbody></mujoco>"
    )
    d, quat = mujoco.MjData(m), np.zeros(4)
    mujoco.mju_mat2Quat(quat, rotation.ravel())
    d.qpos[:] = [*xyz, *quat]
    mujoco.mj_forward(m, d)
    return -d.contact.dist, d.contact.frame[:, :3]


@pytest.mark.parametrize("kind", GEOMS)
def test_round_shapes_touch_a_rough_field_as_in_mujoco(kind):
    """Where both find one point of the deepest triangle alone: MuJoCo's prisms count a valley more than once."""
    rng, compared = np.random.default_rng(3), 0
    for _ in range(40):
        rotation, xy = rotation_from_rpy(rng.uniform(-3.0, 3.0, 3)), rng.uniform(-0.2, 0.2, 2)
        low, high = -0.1, 0.3
        for _ in range(40):
            z = 0.5 * (low + high)
            placed = Placed([SHAPES[kind], ROUGH], [rotation, np.eye(3)], [(*xy, z), (0.0, 0.0, 0.0)])
            points = placed.contacts()[0]
            low, high = (z, high) if len(points) and points[:, 6].max() > 1e-3 else (low, z)
        placed.position[0, 2] = low
        points = placed.contacts()[0]
        depth, normal = mujocos(GEOMS[kind], placed.position[0], rotation)
        k = (normal @ points[0, 3:6]).argmax() if len(normal) else 0
        if len(points) == 1 and len(normal) and normal[k] @ points[0, 3:6] > 0.99:  # some prisms push to the side
            assert depth[k] == pytest.approx(points[0, 6], abs=1e-6)
            assert normal[k] == pytest.approx(points[0, 3:6], abs=1e-4)
            compared += 1
    assert compared > 20


@pytest.mark.nojit
@pytest.mark.bounds
def test_points_are_the_same_bits_everywhere():
    """The hash of the points of all shapes on the rough field is the stored one, also with the JIT off."""
    rng, bits, count = np.random.default_rng(5), hashlib.sha256(), 0
    for shape in SHAPES.values():
        for _ in range(4):
            xyz = (*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.03, 0.08))
            points = on(ROUGH, shape, xyz, rng.uniform(-3.0, 3.0, 3), 0.01)
            bits.update(points.tobytes())
            count += len(points)
    assert count > 20
    assert bits.hexdigest()[:16] == "2d9217bfb6a4accf"


def test_a_box_on_a_plateau_touches_it_at_the_corners_of_what_is_common():
    """Wider than the plateau along x and off its middle along y, so that two sides are the box's."""
    plateau = HeightField(np.pad(np.full((4, 6), 0.05), 2), (0.02, 0.02), (-0.07, -0.09))  # |x| < 0.03, |y| < 0.05
    for turn in (0.0, 4 * QUARTER):
        points = on(plateau, Box((0.2, 0.1, 0.05)), (0.01, 0.045, 0.074), (0.0, 0.0, turn))
        assert points[:, 3:7] == pytest.approx(np.tile([0.0, 0.0, 1.0, 0.001], (4, 1)), abs=1e-12)
        places = {(round(float(x), 9), round(float(y), 9)) for x, y in points[:, :2]}
        assert places == {(x, y) for x in (-0.03, 0.03) for y in (-0.005, 0.05)}
