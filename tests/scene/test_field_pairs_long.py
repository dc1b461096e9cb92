"""Bodies on height fields and stairs: against planes and boxes; their files."""

import math

import numpy as np
import pytest
from touching import G, ball, obstacle, placed, run_of, touching

from featherstone_gait import (
    Ground,
    HeightField,
    PairContact,
    Placed,
    SceneModel,
    compile_scene,
    load_scene,
    save_scene,
)
from featherstone_gait.model.shapes import Box, Sphere
from featherstone_gait.run.simulate import initial_state, simulate

pytestmark = pytest.mark.long

DOWN = (0.0, 0.0, -G)
LEVEL = HeightField(np.zeros((41, 31)), (0.05, 0.07), (-1.0, -1.05))
RADIUS = 0.05


def rolled(under, tilt, integrator, timestep=None):
    """A ball that rolls down a slope for half a second."""
    turn = (math.cos(tilt / 2), 0.0, math.sin(tilt / 2), 0.0)
    n = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
    floor = obstacle(under, "floor", tuple(-0.5 * n) if isinstance(under, Box) else (0.0, 0.0, 0.0), turn)
    far = obstacle(HeightField(np.zeros((2, 2)), (0.1, 0.1)), "field", (0.0, 0.0, 1e3))
    one = ball(RADIUS, 1.0, "ball", tuple((RADIUS - 4e-4) * n))
    scene = touching([one], [floor, far], integrator, timestep, DOWN)
    return run_of(scene, 0.5)


@pytest.mark.parametrize("integrator", ["implicit_euler", "extrapolation"])
@pytest.mark.parametrize("tilt", [0.0, 0.2])
def test_a_ball_on_a_level_field_moves_as_on_a_plane(integrator, tilt):
    """Over some cells, whose edges it does not feel; errors of rounding are those of sums in another order."""
    field, box = (rolled(under, tilt, integrator) for under in (LEVEL, Box((4.0, 4.0, 1.0))))
    for name in ("base_q", "base_qd"):
        np.testing.assert_allclose(field[name], box[name], atol=1e-9)
    assert tilt == 0.0 or abs(field["base_q"][-1, 0]) > 0.15


def test_a_box_rests_on_corrugated_ground():
    """Its weight is carried, at the depth that the stiffness asks for: six points instead of four."""
    heights = np.outer(np.tile([0.0, 0.02], 20), np.ones(21))
    field = HeightField(heights, (0.04, 0.05), (-0.8, -0.5))
    box = placed(Box((0.2, 0.1, 0.05)), 2.0, "box", (0.0, 0.0, 0.046))
    scene = touching([box], [obstacle(field, "field")], "implicit_euler", 1e-3, DOWN)
    run = run_of(scene, 1.0, record=("base_q", "base_qd", "pair_force"))
    assert abs(run["base_qd"][-1]).max() < 1e-9
    assert run["pair_force"][-1, :, 2].sum() == pytest.approx(2.0 * G, rel=1e-9)
    points = int((run["pair_force"][-1, :, 2] > 0).sum())
    assert points == 4  # ridges at x = -0.04 and 0.04 with two ends each: those at 0.12 lie outside
    assert run["base_q"][-1, 2] == pytest.approx(0.02 + 0.025 - 5e-4, abs=1e-9)


def under_ground(ground, z):
    """Where a ball without contact points comes to rest on the ground at x = 0.3."""
    model = ball(RADIUS, 1.0, "ball").model
    bare = type(model)(**{name: getattr(model, name) for name in ("name", "links", "joints", "base", "shapes")})
    far = obstacle(HeightField(np.zeros((2, 2)), (0.1, 0.1)), "field", (0.0, 0.0, 1e3))
    more = [obstacle(shape, f"far{k}", (0.0, 0.0, 1e3 + k)) for k, shape in enumerate((Sphere(0.1), Box((1.0,) * 3)))]
    scene = compile_scene(
        SceneModel("one", [Placed(bare, position=(0.3, 0.1, z))], [far, *more], ground), None, None, "implicit_euler",
        1e-3, pairs=PairContact(),
    )  # fmt: skip
    run = simulate(scene, 1.0, initial_state(scene), estimate_error=False, record=("base_q",))
    assert run.status == "ok", run.message
    return run["base_q"][-1]


def test_links_without_contact_points_touch_a_field_and_stairs():
    field = HeightField(np.full((11, 11), 0.1), (0.1, 0.1), (-0.5, -0.5))
    assert under_ground(Ground(field=field), 0.2)[2] == pytest.approx(0.1 + RADIUS - 5e-4, abs=1e-6)
    assert under_ground(Ground(steps=((0.1, 0.03), (0.2, 0.04), (0.5, 0.05))), 0.2)[2] == pytest.approx(
        0.07 + RADIUS - 5e-4, abs=1e-6
    )
    assert under_ground(Ground(steps=((0.1, -0.03), (0.2, -0.04))), 0.2)[2] == pytest.approx(
        -0.07 + RADIUS - 5e-4, abs=1e-6
    )


def test_a_field_is_written_and_read_as_an_obstacle(tmp_path):
    rng = np.random.default_rng(0)
    field = HeightField(rng.random((5, 7)).astype(np.float32).astype(float), (0.1, 0.2), (-0.2, 0.1))
    there = obstacle(field, "hill", (1.0, 2.0, 3.0), (math.cos(0.1), math.sin(0.1), 0.0, 0.0))
    scene = SceneModel("one", [ball(RADIUS, 1.0, "ball")], [there], Ground())
    save_scene(scene, tmp_path / "one.xml")
    again = load_scene(tmp_path / "one.xml")
    (shape,) = again.member("hill").model.shapes
    read = shape.geometry
    assert isinstance(read, HeightField)
    np.testing.assert_allclose(read.heights + shape.xyz[2], field.heights, atol=1e-6)
    np.testing.assert_allclose(np.array(read.origin) + shape.xyz[:2], field.origin, atol=1e-9)
    np.testing.assert_allclose(read.spacing, field.spacing, atol=1e-12)
    np.testing.assert_allclose(again.member("hill").position, (1.0, 2.0, 3.0), atol=1e-9)
