"""Rolling and torsional friction between bodies, against closed forms."""

import math

import numpy as np
import pytest
from touching import G, ball, energy_of, law_of, obstacle, placed, run_of, touching

from featherstone_gait.base.rotation import rotation_from_quaternion
from featherstone_gait.model.shapes import Box, Cylinder, Sphere

pytestmark = pytest.mark.long

RADIUS = 0.05
SIZE = Box((8.0, 8.0, 1.0))
CHANNELS = ("base_q", "base_qd", "pair_work", "pair_turning")


def on_floor(member, angle=0.0, integrator="extrapolation", timestep=None, **law):
    """A scene of a member on an obstacle whose upper side is at z = 0, under gravity as on a slope."""
    gravity = (G * math.sin(angle), 0.0, -G * math.cos(angle))
    return touching([member], [obstacle(SIZE, "floor", (0.0, 0.0, -0.5))], integrator, timestep, gravity, **law)


def rolling(speed, rolling_friction, angle=0.0, integrator="extrapolation", timestep=None, penetration=1e-5):
    """A ball that rolls without slip at a speed [m/s], at the depth of its rest."""
    scene = on_floor(
        ball(RADIUS, 1.0, "ball", (0.0, 0.0, RADIUS - penetration * math.cos(angle))), angle, integrator, timestep,
        penetration=penetration, rolling_friction=rolling_friction,
    )  # fmt: skip
    lever = RADIUS - 0.5 * penetration * math.cos(angle)
    return scene, {"ball": (speed, 0.0, 0.0, 0.0, speed / lever, 0.0)}, lever


def test_a_ball_stops_by_rolling_friction_after_the_known_way():
    """(m r^2 + J) a = -mu g m r, with r the lever of the contact: 5/7 mu g / r for a rigid ball."""
    scene, start, lever = rolling(0.3, 2e-3)
    run = run_of(scene, 0.6, start, rtol=1e-9, record=CHANNELS)
    rate = 2e-3 * G / lever / (1.0 + 0.4 * RADIUS**2 / lever**2)
    assert rate == pytest.approx(5 / 7 * 2e-3 * G / RADIUS, rel=1e-3)
    v, time = run["base_qd"][:, 0], run["time"]
    late = time > 0.1
    assert -np.polyfit(time[late], v[late], 1)[0] == pytest.approx(rate, rel=1e-5)
    scene, start, lever = rolling(0.1, 2e-3)
    run = run_of(scene, 1.0, start, rtol=1e-9, record=CHANNELS)
    assert abs(run["base_qd"][-1]).max() < 1e-6
    assert run["base_q"][-1, 0] == pytest.approx(0.1**2 / (2.0 * rate), rel=1e-3)  # and some for its bristle
    total = energy_of(scene, run)
    assert total[-1] - total[0] == pytest.approx(run["pair_work"][-1, 0], abs=1e-8)


@pytest.mark.parametrize("share", [0.95, 1.05])
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "extrapolation", "rk4"])
def test_a_ball_stays_on_a_slope_whose_tangent_is_below_that_of_its_rolling_friction(share, integrator):
    """tan(angle) = mu / r; beyond it rolls as the difference asks for."""
    angle = 0.1
    step = {"rk4": 1e-4, "extrapolation": None}.get(integrator, 1e-3)
    scene, _, lever = rolling(0.0, share * RADIUS * math.tan(angle), angle, integrator, step, 1e-4)
    run = run_of(scene, 0.6, record=CHANNELS, rtol=1e-8)
    if share > 1.0:
        assert abs(run["base_qd"][-1]).max() < 1e-6
        assert abs(run["base_q"][-1, 0]) < 1e-4
    else:
        late = run["time"] > 0.3
        rate = np.polyfit(run["time"][late], run["base_qd"][late, 0], 1)[0]
        moment = G * math.sin(angle) - share * RADIUS * math.tan(angle) * G * math.cos(angle) / lever
        assert rate == pytest.approx(moment / (1.0 + 0.4 * RADIUS**2 / lever**2), rel=1e-3)


@pytest.mark.parametrize(("shape", "points"), [(Sphere(RADIUS), 1), (Cylinder(RADIUS, 0.02), 4)])
def test_what_spins_stops_when_torsional_friction_has_used_its_angular_momentum(shape, points):
    """J w' = -mu m g, without friction across: after w J / (mu m g)."""
    height = RADIUS if points == 1 else 0.01
    scene = on_floor(
        placed(shape, 1.0, "top", (0.0, 0.0, height - 1e-5)), penetration=1e-5, friction=0.0, torsional_friction=1e-3
    )
    moment = scene.members[0].model.links[0].inertia[5]
    end = 3.0 * moment / (1e-3 * G)
    run = run_of(scene, 1.2 * end, {"top": (0.0, 0.0, 0.0, 0.0, 0.0, 3.0)}, rtol=1e-9, record=CHANNELS)
    w, time = run["base_qd"][:, 5], run["time"]
    during = (time > 0.2 * end) & (time < 0.9 * end)
    slope, start = np.polyfit(time[during], w[during], 1)
    assert -start / slope == pytest.approx(end, rel=1e-5)
    assert abs(w[-1]) < 1e-6
    total = energy_of(scene, run)
    assert total[-1] - total[0] == pytest.approx(run["pair_work"][-1, 0], abs=1e-8)


@pytest.mark.parametrize("integrator", ["implicit_euler", "extrapolation"])
def test_moments_between_two_that_move_are_opposite(integrator):
    """Two balls pressed onto each other by their speeds, one of which spins: angular momentum stays."""
    along = 2 * RADIUS - 1e-4
    members = [ball(RADIUS, 1.0, "one"), ball(RADIUS, 2.0, "two", (along, 0.0, 0.0))]
    scene = touching(members, integrator=integrator, timestep=1e-4 if integrator == "implicit_euler" else None,
                     torsional_friction=0.05, rolling_friction=0.02, penetration=1e-3, damping_ratio=1.0)  # fmt: skip
    run = run_of(scene, 0.02, {"one": (1.0, 0.0, 0.0, 2.0, 1.0, 0.0), "two": (-0.5,)}, record=CHANNELS)
    total = 0.0
    for name in ("one", "two"):
        (link,), of = next(one for one in members if one.name == name).model.links, run.of(name)
        q, qd = of["base_q"], of["base_qd"]
        turn = np.array([rotation_from_quaternion(one) for one in q[:, 3:]])
        total = total + link.mass * np.cross(q[:, :3], qd[:, :3])
        total = total + link.inertia[0] * np.einsum("nij,nj->ni", turn, qd[:, 3:])
    np.testing.assert_allclose(total[-1], total[0], atol=1e-9)
    assert abs(run.of("two")["base_qd"][-1, 3]) > 0.05
    assert law_of(scene)[2] > 0.0
