"""The law of docs/theory/pairs.md, written down and integrated a second time, against runs."""

import math

import pytest
from scipy.optimize import brentq
from touching import Disc, planar, touching

from featherstone_gait import PairContact, Placed, SceneModel, Sphere, body, compile_scene, initial_state, simulate

G = 9.81  # without gravity
pytestmark = pytest.mark.long


def of_page(masses, points, penetration, damping_ratio, friction):
    """Stiffness, damping, friction, tangential stiffness and damping by the formulas of the page."""
    k = sum(masses) * G / (points * penetration)
    reduced = masses[0] * masses[1] / sum(masses)
    d_t = 2.0 * max(damping_ratio, 0.1) * math.sqrt(k * reduced / points)
    return k, 2.0 * damping_ratio / math.sqrt(G * penetration), friction, k, d_t


@pytest.mark.parametrize(("masses", "ratio"), [((1.0, 3.0), 0.3), ((2.0, 0.2), 0.02), ((1.0, 40.0), 0.7)])
@pytest.mark.parametrize("friction", [0.05, 0.9])
def test_two_balls_spin_after_a_glancing_hit_as_the_page_says(masses, ratio, friction):
    radius, depth = 0.05, 1e-3
    places, velocities = ((-0.08, 0.0), (0.06, 0.05)), ((0.6, 0.0), (-0.4, 0.0))
    both = zip("ab", masses, places)
    members = [Placed(body(Sphere(radius), m, name=n), position=(x, 0.0, z)) for n, m, (x, z) in both]
    scene = touching(members, penetration=depth, damping_ratio=ratio, friction=friction)
    start = initial_state(scene, None, {n: (*u, 0.0, 0.0, 0.0, 0.0) for n, u in zip("ab", velocities)})
    run = simulate(scene, 0.12, start, rtol=1e-10, record=("base_qd",), estimate_error=False)
    assert run.status == "ok"
    discs = (Disc(radius, m, 0.4 * m * radius**2, x, v) for m, x, v in zip(masses, places, velocities))
    y = planar(*discs, of_page(masses, 1, depth, ratio, friction), 0.12)
    for name, spin in (("a", y[4]), ("b", y[9])):
        assert abs(spin) > 0.01
        assert run[name]["base_qd"][-1, 4] == pytest.approx(spin, rel=1e-4)


def restitution(d, v):
    """Of Hunt and Crossley's law with exponent 1: ln((1 + d v) / (1 - d e v)) = d (1 + e) v, of any masses."""
    most = min(1.0, 1.0 / (d * v)) * (1.0 - 1e-12)
    return brentq(lambda e: d * (1.0 + e) * v - math.log((1.0 + d * v) / (1.0 - d * e * v)), 1e-9, most, xtol=1e-14)


def two_balls(mass):
    """A ball of 1 kg and one of another mass, 2 cm apart."""
    both = ("a", 1.0, 0.0), ("b", mass, 0.12)
    return [Placed(body(Sphere(0.05), m, name=name), position=(x, 0.0, 0.0)) for name, m, x in both]


@pytest.mark.parametrize("d", [0.05, 0.2, 1.0])
def test_two_balls_rebound_by_default_as_the_law_says(d):
    ratio, worst = 0.5 * d * math.sqrt(G * 5e-4), 0.0
    for mass in (1.0, 10.0, 100.0, 1000.0):
        options = {"pairs": PairContact(damping_ratio=ratio, friction=0.0), "gravity": (0.0, 0.0, 0.0)}
        scene = compile_scene(SceneModel("hit", two_balls(mass)), **options)
        for v in (0.05, 0.1, 0.5, 2.0, 10.0):
            start = initial_state(scene, None, {"a": (v, 0.0, 0.0, 0.0, 0.0, 0.0)})
            run = simulate(scene, 0.03 / v + 0.06, start, record=("base_qd",))
            assert run.status == "ok", run.message
            speeds = [run[name]["base_qd"][-1, 0] for name in "ab"]
            error = (speeds[1] - speeds[0]) / v - restitution(d, v)
            worst = max(worst, abs(error))
    assert worst < 1e-3


def test_a_slow_body_is_judged_by_its_own_speed():
    """At 0.05 m/s an error of 1 mm/s is 2 %, though bodies beside it are fast."""
    fast = Placed(body(Sphere(0.05), 1.0, name="fast"), position=(0.0, 9.0, 0.0))
    scene = compile_scene(
        SceneModel("hit", [*two_balls(7.0), fast]), pairs=PairContact(damping_ratio=0.01), gravity=(0, 0, 0)
    )
    start = initial_state(scene, None, {"a": (0.05, 0, 0, 0, 0, 0), "fast": (0, 5.0, 0, 0, 0, 0)})
    rough = simulate(scene, 0.7, start, rtol=1e-2, atol=1e-2, record=("base_qd",))
    fine = simulate(scene, 0.7, start, rtol=1e-9, record=("base_qd",))
    off = max(abs(rough[name]["base_qd"] - fine[name]["base_qd"]).max() for name in "ab")
    assert fine.status == "ok"
    assert off > 1e-2 * 0.05
    assert rough.status == "inaccurate"
    assert "on base_qd of a" in rough.message or "on base_qd of b" in rough.message
