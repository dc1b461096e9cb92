"""Round bodies and uneven ground: what rolling, lying and falling must do, whatever the integrator."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes import NEVER_FALLEN, G, box, rotations

from featherstone_gait.dynamics import contact_positions, energy
from featherstone_gait.model import ContactPoint, Ground, HeightField, Link, Model, stairs
from featherstone_gait.run.sensors import sole_forces
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene
from featherstone_gait.scene.contact import ground_under, standing_height

RADIUS = 0.1
CHANNELS = ("base_q", "base_qd", "tangential_deflection", "contact_force", "contact_work")
every_integrator = pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "rk4"])


def ball():
    inertia = 0.4 * RADIUS**2
    sphere = ContactPoint("ball", (0.0, 0.0, 0.0), radius=RADIUS)
    return round_model("ball", (inertia, inertia, inertia), (sphere,))


def wheel(width=0.04):
    """A cylinder about y."""
    across = (3.0 * RADIUS**2 + width**2) / 12.0
    inside = 0.5 * width - 0.01 * RADIUS
    ends = (ContactPoint("wheel", (0.0, y, 0.0), circle_radius=RADIUS, axis=(0.0, 1.0, 0.0)) for y in (-inside, inside))
    return round_model("wheel", (across, 0.5 * RADIUS**2, across), tuple(ends))


def capsule(length=0.4):
    """About x; a rod of a kilogram in it."""
    across = length**2 / 12.0
    ends = (ContactPoint("capsule", (s * length / 2, 0.0, 0.0), radius=RADIUS) for s in (-1.0, 1.0))
    return round_model("capsule", (0.005, across, across), tuple(ends))


def round_model(name, moments, contacts):
    inertia = (moments[0], 0.0, 0.0, moments[1], 0.0, moments[2])
    return Model(name, (Link(name, 1.0, (0.0, 0.0, 0.0), inertia),), (), "floating", contacts=contacts)


def on(ground, model, integrator="midpoint", timestep=1e-3):
    return compile_scene(model, ground=ground, integrator=integrator, timestep=timestep, **NEVER_FALLEN)


def lying(scene, velocity=(0.0,) * 6, x=0.0, y=0.0, heading=0.0):
    q = np.array([x, y, 0.0, math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)])
    q[2] = standing_height(scene.model, scene.ground, q)
    return initial_state(scene, q, velocity)


def tilted_field(slope, heading, size=2.0):
    """A plane as a height field."""
    x = np.linspace(-size, size, 9)
    heights = math.tan(slope) * (math.cos(heading) * x[:, None] + math.sin(heading) * x[None, :])
    return HeightField(heights, (size / 4, size / 4), (-size, -size))


def waves(cell=0.05, height=0.02):
    x = np.arange(-1.0, 1.0, cell)
    return HeightField(height * np.sin(4.0 * x[:, None]) * np.cos(3.0 * x[None, :]), (cell, cell), (-1.0, -1.0))


# Rolling.


@pytest.mark.long
@pytest.mark.nojit
@every_integrator
@pytest.mark.parametrize(("model", "share"), [pytest.param(ball(), 5 / 7, marks=pytest.mark.bounds), (wheel(), 2 / 3)])
@pytest.mark.parametrize("heading", [0.0, 0.7])
def test_what_is_round_rolls_down_a_slope_without_slip(integrator, model, share, heading):
    slope, duration = 0.2, 0.2
    scene = on(Ground(slope=-slope, heading=heading), model, integrator)
    run = simulate(scene, duration, lying(scene, heading=heading), record=CHANNELS)
    v, w = run["base_qd"][-1, :3], run["base_qd"][-1, 3:]
    along = np.array([math.cos(slope) * math.cos(heading), math.cos(slope) * math.sin(heading), -math.sin(slope)])
    assert v @ along == pytest.approx(share * G * math.sin(slope) * duration, rel=1e-4)
    assert np.linalg.norm(w) * RADIUS == pytest.approx(np.linalg.norm(v), rel=1e-6)
    kinetic, potential = energy(model, run["base_q"][[0, -1]], run["base_qd"][[0, -1]]).T
    # But for what springs of half a millimeter hold, all that it has lost in height is in its motion.
    assert kinetic[1] == pytest.approx(potential[0] - potential[1], abs=0.1 * G * scene.ground.penetration)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint"])
def test_a_sliding_ball_begins_to_roll_at_five_sevenths_of_its_speed(integrator):
    scene = on(Ground(friction=0.3), ball(), integrator)
    run = simulate(scene, 1.0, lying(scene, (2.0, 0.0, 0.0, 0.0, 0.0, 0.0)), record=CHANNELS)
    assert run["base_qd"][-1, 0] == pytest.approx(2.0 * 5 / 7, rel=1e-4)
    assert run["base_qd"][-1, 4] * RADIUS == pytest.approx(run["base_qd"][-1, 0], rel=1e-6)


@pytest.mark.long
def test_a_ball_that_spins_upright_goes_on_spinning():
    scene = on(Ground(), ball())
    run = simulate(scene, 0.5, lying(scene, (0.0, 0.0, 0.0, 0.0, 0.0, 10.0)), record=CHANNELS)
    assert run["base_qd"][-1, 5] == pytest.approx(10.0, rel=1e-12)


# Lying.


@pytest.mark.long
def test_a_capsule_lies_on_both_ends_and_a_tilted_one_on_one():
    scene = on(Ground(), capsule())
    run = simulate(scene, 1.0, lying(scene), record=CHANNELS)
    np.testing.assert_allclose(run["contact_force"][-1, :, 0], G / 2, rtol=1e-6)
    assert run["base_q"][-1, 2] == pytest.approx(RADIUS - scene.ground.penetration, abs=1e-8)
    q = np.array([0.0, 0.0, 0.0, math.cos(0.1), 0.0, math.sin(0.1), 0.0])
    assert standing_height(scene.model, scene.ground, q) == pytest.approx(
        RADIUS + 0.2 * math.sin(0.2) - scene.ground.penetration, abs=1e-12
    )


@pytest.mark.long
def test_a_cylinder_stands_on_its_end():
    model = wheel()
    scene = on(Ground(), model)
    q = np.array([0.0, 0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])  # its axis upright
    q[2] = standing_height(model, scene.ground, q)
    assert q[2] == pytest.approx(0.02 - scene.ground.penetration, abs=1e-12)
    run = simulate(scene, 2.0, initial_state(scene, q, [0.01, 0.0, 0.0, 0.0, 0.0, 0.0]), record=CHANNELS)
    assert np.abs(run["base_q"][:, 2] - run["base_q"][-1, 2]).max() < 1e-3
    assert run["contact_force"][-1, :, 0].sum() == pytest.approx(G, rel=0.01)


@pytest.mark.nojit
def test_a_contact_is_lowest_where_the_body_is():
    """Against points strewn over the edge of a cylinder and over a ball."""
    model, rng = wheel(), np.random.default_rng(0)
    angle = np.linspace(0.0, 2.0 * math.pi, 20001)
    rim = np.stack([RADIUS * np.cos(angle), np.full_like(angle, 0.02), RADIUS * np.sin(angle)], axis=1)
    edge = np.concatenate([rim, rim * (1.0, -1.0, 1.0)])
    for _ in range(20):
        q = np.array([0.0, 0.0, 0.0, *rng.normal(size=4)])
        q[3:] /= np.linalg.norm(q[3:])
        lowest = (edge @ rotations(q[None, 3:])[0].T)[:, 2].min()
        assert contact_positions(model, q)[:, 2].min() == pytest.approx(lowest, abs=1e-2 * RADIUS)
    upright = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert contact_positions(model, upright)[:, 2].min() == pytest.approx(-RADIUS, abs=1e-12)
    assert contact_positions(ball(), q)[0, 2] == pytest.approx(-RADIUS, abs=1e-15)


# Ground.


@pytest.mark.long
@pytest.mark.nojit
@pytest.mark.parametrize("model", [ball(), wheel(), box(size=(0.2, 0.2, 0.1))])
def test_a_tilted_height_field_is_the_plane_of_that_slope(model):
    heading = 0.6
    plane = Ground(slope=-0.2, heading=heading, friction=0.5)
    field = Ground(field=tilted_field(-0.2, heading), friction=0.5)
    runs = []
    for ground in (plane, field):
        scene = on(ground, model)
        start = lying(scene, (0.3, -0.2, 0.0, 0.1, 0.0, 0.2))
        runs.append(simulate(scene, 0.1, start, record=CHANNELS)["base_q"])
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-12)


@pytest.mark.long
def test_forces_on_a_field_are_turned_into_the_world():
    scene = on(Ground(field=tilted_field(-0.2, 0.6)), box(size=(0.2, 0.2, 0.1)))
    q = [0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]
    run = simulate(scene, 3.0, initial_state(scene, q), record=("base_q", "q", "contact_force"))
    np.testing.assert_allclose(sole_forces(scene, run)["box"][-1], [0.0, 0.0, G], atol=1e-4)


@pytest.mark.nojit
def test_a_field_is_bilinear_between_its_nodes_and_is_continuous():
    rng = np.random.default_rng(1)
    field = HeightField(rng.normal(size=(5, 4)), (0.5, 0.25), (-1.0, 2.0))
    ground = Ground(field=field, height=0.3)
    u, v = 0.5, 0.4  # of a cell: beyond the smoothed strips
    for i in range(4):
        for j in range(3):
            x = np.array([[-1.0 + (i + u) * 0.5, 2.0 + (j + v) * 0.25, 0.0]])
            h = field.heights
            between = (1 - u) * (1 - v) * h[i, j] + u * (1 - v) * h[i + 1, j]
            between += (1 - u) * v * h[i, j + 1] + u * v * h[i + 1, j + 1]
            assert -ground_under(ground, x)[0, 6] == pytest.approx(between + 0.3, abs=1e-12)
    line = np.stack([np.linspace(-2.0, 2.0, 40001), np.full(40001, 2.3), np.zeros(40001)], axis=1)
    under = ground_under(ground, line)
    slope = np.gradient(-under[:, 6], line[:, 0])
    np.testing.assert_allclose(slope[1:-1], (-under[:, 0] / under[:, 2])[1:-1], atol=2e-3)
    assert np.abs(np.diff(under[:, 0])).max() < 1e-2
    assert under[0, 0] == under[-1, 0] == 0.0  # level beyond the edge


@pytest.mark.long
@pytest.mark.nojit
def test_over_a_field_the_midpoint_rule_is_of_order_two():
    """The ground is taken where the ball will be; where it was, errors would halve with the step only."""
    places = []
    for h in (4e-3, 2e-3, 2.5e-4):
        scene = on(Ground(field=waves(), friction=5.0), ball(), "midpoint", h)
        start = lying(scene, (0.3, 0.1, 0.0, -1.0, 3.0, 0.0))
        places.append(simulate(scene, 0.2, start, record=("base_q",), estimate_error=False)["base_q"][-1, :2])
    errors = [np.linalg.norm(place - places[-1]) for place in places[:2]]
    assert errors[0] < 2e-5
    assert errors[0] > 3.0 * errors[1]


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["midpoint", "extrapolation"])
def test_a_ball_that_rolls_over_a_field_keeps_its_energy(integrator):
    model = ball()
    scene = on(Ground(field=waves(), damping_ratio=0.0, friction=5.0), model, integrator, 5e-4)
    tolerance = {"rtol": 1e-7} if integrator == "extrapolation" else {}
    start = lying(scene, (0.3, 0.1, 0.0, -1.0, 3.0, 0.0))
    run = simulate(scene, 1.0, start, record=CHANNELS, **tolerance)
    kinetic, potential = energy(model, run["base_q"], run["base_qd"]).T
    points = scene.constants.contact.points[0]
    depth = run["contact_force"][:, 0, 0] / points.stiffness
    elastic = 0.5 * points.stiffness * (depth**2 + (run["tangential_deflection"][:, 0] ** 2).sum(axis=1))
    total = kinetic + potential + elastic
    assert np.abs(run["base_q"][-1, :2] - run["base_q"][0, :2]).max() > 0.1
    after = total[1:] - total[1]  # the first sample has no forces yet
    assert np.abs(after).max() < (1e-4 if integrator == "extrapolation" else 3e-3) * kinetic.max()


@pytest.mark.parametrize("heading", [0.3, math.pi / 2, -2.0])
def test_stairs_in_any_direction_carry_a_box_as_those_along_x(heading):
    """The same scene seen from a frame turned about the vertical."""
    c, s = math.cos(heading), math.sin(heading)
    runs = []
    for turn in (0.0, heading):
        ground = Ground(steps=stairs(4, 0.3, -0.05, start=0.15), heading=turn, friction=0.2)
        scene = on(ground, box(size=(0.2, 0.2, 0.1)))
        v = (2.0 * math.cos(turn), 2.0 * math.sin(turn), 0.0, 0.0, 0.0, 0.0)
        run = simulate(scene, 0.4, lying(scene, v, heading=turn), record=("base_q",))
        runs.append(run["base_q"][:, :3])
    turned = runs[0] @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(turned, runs[1], atol=1e-6)
    assert runs[0][-1, 2] < runs[0][0, 2] - 0.05  # it did go down


def test_ground_that_contradicts_itself_is_refused():
    field = HeightField(np.zeros((3, 3)), (0.1, 0.1))
    for wrong, message in (
        ({"field": field, "slope": 0.1}, "no slope, steps or heading besides"),
        ({"field": field, "steps": ((0.1, 0.1),)}, "no slope, steps or heading besides"),
        ({"field": field, "heading": 0.1}, "heading besides"),
        ({"field": np.zeros((3, 3))}, "expected a HeightField"),
        ({"heading": math.inf}, "heading"),
    ):
        with pytest.raises(ValueError, match=message):
            Ground(**wrong)
    for wrong, message in (
        ({"heights": np.zeros(3)}, "2 x 2 nodes"),
        ({"heights": [[0.0, math.nan], [0.0, 0.0]]}, "2 x 2 nodes"),
        ({"spacing": (0.1, 0.0)}, "spacing"),
        ({"origin": (0.0, math.inf)}, "origin"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(field, **wrong)
    with pytest.raises(ValueError, match="depth is 0"):
        stairs(3, 0.0, 0.1)
    with pytest.raises(ValueError, match="not of unit length"):
        ContactPoint("wheel", (0.0, 0.0, 0.0), circle_radius=0.1, axis=(0.0, 0.0, 2.0))
    with pytest.raises(ValueError, match="expected a Ground"):
        compile_scene(ball(), ground={})
    with pytest.raises(ValueError, match="fall_tilt is nan"):
        compile_scene(ball(), ground=Ground(), fall_tilt=math.nan)


@pytest.mark.long
def test_never_fallen_is_a_tilt_beyond_half_a_turn():
    scene = compile_scene(ball(), ground=Ground(), fall_height=-1e6, fall_tilt=4.0)
    assert simulate(scene, 0.5, lying(scene, (1.0, 0.0, 0.0, 0.0, 10.0, 0.0))).ok
