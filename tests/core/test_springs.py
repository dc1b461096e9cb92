"""Springs between bodies: closed forms, what they conserve, orders, and the same bits in any width."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from company import in_company, simulated
from random_tree import random_states, random_tree

from featherstone_gait.dynamics import energy, momentum, spring_energy
from featherstone_gait.model import Joint, Link, Model, Spring
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

ROOT = Path(__file__).parents[2]
BALL = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)  # [kg m^2]
M1, M2 = 1.0, 3.0  # [kg]
REDUCED = M1 * M2 / (M1 + M2)
K, REST = 75.0, 0.4  # [N/m], [m]
STILL = (0.0, 0.0, 0.0)


def pair(zero=0.0):
    """Two balls, the second slides along the first one's x axis; so far apart where the joint is at zero [m]."""
    links = (Link("a", M1, STILL, BALL), Link("b", M2, STILL, BALL))
    joint = Joint("slide", "prismatic", "a", "b", xyz=(zero, 0.0, 0.0), axis=(1.0, 0.0, 0.0))
    return Model("pair", links, (joint,), "floating")


def pair_scene(damping=0.0, integrator=None, timestep=None):
    spring = Spring("a", "b", (0.0, 0.0, 0.1), (0.0, 0.0, 0.1), K, damping, REST)
    return compile_scene(pair(), integrator=integrator, timestep=timestep, gravity=STILL, springs=[spring])


def flying(scene, distance=0.5, spin=0.0):
    """The pair drifts and may turn about z."""
    return initial_state(scene, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, distance], [0.3, -0.2, 0.1, 0.0, 0.0, spin, 0.0])


def swing(t, damping, start=0.1):
    """Distance of the free pair: r'' = -(K (r - l0) + C r') / m of the reduced mass m, from rest."""
    w, d = math.sqrt(K / REDUCED), damping / (2.0 * REDUCED)
    f = math.sqrt(w * w - d * d)
    return REST + start * np.exp(-d * t) * (np.cos(f * t) + d / f * np.sin(f * t))


def tangle():
    """A tree of ten bodies that floats, its tips tied across to other links off their axes."""
    model = random_tree(10, 5, base="floating")
    names = [link.name for link in model.links]
    ties = [(names[-1], names[0]), (names[-2], names[3]), (names[1], names[-4])]
    rng = np.random.default_rng(5)
    springs = [Spring(a, b, *rng.normal(scale=0.1, size=(2, 3)), 20.0, 0.0, 0.1) for a, b in ties]
    q, qd, _ = (x[0] for x in random_states(model, 1, 5))
    return model, springs, q, 0.3 * qd


# --- closed forms ------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("damping", [0.0, 3.0])
@pytest.mark.parametrize("integrator", ["dop853", "extrapolation"])
def test_two_masses_swing_with_their_reduced_mass(integrator, damping):
    """sqrt(K / m) = 10 rad/s, and damped at C / 2 m; 1e-13 a step over 20 rad."""
    scene = pair_scene(damping, integrator)
    run = simulate(scene, 2.0, flying(scene), record=("q",), rtol=1e-13, record_interval=0.1)
    assert np.abs(run["q"][:, 0] - swing(run["time"], damping)).max() < 1e-11


@pytest.mark.long
def test_a_weight_hangs_where_the_spring_bears_it():
    """From the root of a fixed base: stretched by m g / K nothing accelerates; the root feels nothing."""
    links = (Link("ceiling", 0.0, STILL, (0.0,) * 6), Link("weight", M2, STILL, BALL))
    model = Model("weight", links, (Joint("slide", "prismatic", "ceiling", "weight", axis=(0.0, 0.0, 1.0)),))
    hung = {"stiffness": K, "damping": 1.0, "length": REST}
    low = -(REST + M2 * 9.81 / K)
    for spring in (Spring("ceiling", "weight", **hung), Spring("weight", "ceiling", **hung)):
        for integrator in ("dop853", "implicit_euler", "midpoint", "rk4", "extrapolation"):
            scene = compile_scene(model, integrator=integrator, springs=[spring])
            run = simulate(scene, 1.0, initial_state(scene, [low]))
            assert np.abs(run["q"] - low).max() < 1e-13


@pytest.mark.long
def test_points_that_coincide_have_no_force():
    scene = pair_scene()
    run = simulate(scene, 0.1, flying(scene, distance=0.0))
    assert run.status == "ok"
    np.testing.assert_array_equal(run["q"], 0.0)


# --- what is conserved -------------------------------------------------------------------------------------------


def conserved(run, model):
    q = np.concatenate([run["base_q"], run["q"]], axis=1)
    qd = np.concatenate([run["base_qd"], run["qd"]], axis=1)
    return q, qd, energy(model, q, qd, gravity=STILL).sum(axis=1), momentum(model, q, qd)


ALL = ("base_q", "q", "base_qd", "qd")


@pytest.mark.long
def test_energy_and_momentum_of_a_tangle():
    """What the springs store and what moves add up; action is reaction, so both momenta stay."""
    model, springs, q, qd = tangle()
    scene = compile_scene(model, gravity=STILL, springs=springs)
    assert scene.integrator == "dop853"
    run = simulate(scene, 0.5, initial_state(scene, q, qd), record=ALL, rtol=1e-12)
    q, _, moving, p = conserved(run, model)
    stored = spring_energy(model, springs, q).sum(axis=1)
    assert np.ptp(stored) > 0.01 * moving[0]
    np.testing.assert_allclose(moving + stored, moving[0] + stored[0], rtol=1e-9)
    np.testing.assert_allclose(p, np.broadcast_to(p[0], p.shape), rtol=0, atol=1e-9 * np.abs(p[0]).max())


# --- steps -------------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(("factor", "sound"), [(0.97, True), (1.03, False)])
@pytest.mark.parametrize("damping", [0.0, 30.0])
def test_the_announced_limit_is_where_an_explicit_step_breaks(damping, factor, sound):
    """2 / sqrt(K / m) without damper, of a damper alone 2 m / C: rk4 is stable up to 1.39 times as much."""
    spring = Spring("a", "b", STILL, STILL, K if damping == 0.0 else 0.0, damping, REST)
    limit = 2.0 * REDUCED / damping if damping else 2.0 / math.sqrt(K / REDUCED)
    model = pair(REST)
    found = compile_scene(model, gravity=STILL, springs=[spring]).preflight
    assert found.largest_explicit_step == pytest.approx(limit, rel=1e-12)
    step = (1.39 if damping else math.sqrt(2.0)) * factor * limit
    scene = compile_scene(model, integrator="rk4", timestep=step, gravity=STILL, springs=[spring])
    start = initial_state(scene, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.0] * 6 + [1e-6])
    run = simulate(scene, 400 * step, start, estimate_error=False)
    assert (np.abs(run["q"][-1, 0]) < 1e-5) == sound


def test_a_stiff_spring_asks_for_implicit_steps():
    spring = Spring("a", "b", (0.5, 0.0, 0.0), STILL, 1e8, 1e4, 0.5)
    scene = compile_scene(pair(), gravity=STILL, springs=[spring])
    assert (scene.integrator, scene.stiff) == ("ars343", True)
    assert "(a - b: damper of a tendon)" in scene.preflight.reason


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "ars343"])
@pytest.mark.parametrize(("stiffness", "damping"), [(1e9, 0.0), (0.0, 1e9), (1e9, 1e6)])
def test_no_spring_limits_an_implicit_step(integrator, stiffness, damping):
    """At 10 ms, ten thousand times what an explicit step bears, the pair turns as a rigid body does."""
    spring = Spring("a", "b", STILL, STILL, stiffness, damping, 0.5)
    scene = compile_scene(pair(), integrator=integrator, timestep=1e-2, gravity=STILL, springs=[spring])
    run = simulate(scene, 1.0, flying(scene, 0.5), record=ALL, estimate_error=False)
    assert run.ok
    np.testing.assert_allclose(run["q"][:, 0], 0.5, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run["base_q"][-1, :3], [0.3, -0.2, 0.1], rtol=0, atol=1e-9)


def test_rk4_beyond_the_limit_says_so():
    spring = Spring("a", "b", STILL, STILL, 1e6, 0.0, REST)
    scene = in_company(replace(pair(REST), base="fixed"), "rk4", 1e-2, gravity=STILL, springs=[spring])
    assert simulated(scene, 0.02, [1e-3]).status == "not converged"


# --- refusals ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"b": "a"}, "both points are on one link"),
        ({"stiffness": -1.0}, r"spring from link 'a' to 'b': stiffness is -1.0 \[N/m\]; expected >= 0"),
        ({"damping": -1.0}, r"damping is -1.0 \[N s/m\]; expected >= 0"),
        ({"length": -0.1}, r"length is -0.1 \[m\]; expected >= 0"),
        ({"stiffness": math.inf}, "stiffness is inf"),
        ({"damping": math.nan}, "damping is nan"),
        ({"length": math.nan}, "length is nan"),
        ({"point_a": (0.0, math.nan, 0.0)}, "point_a is .*; expected 3 finite numbers"),
        ({"point_b": (0.0, 1.0)}, "point_b is .*; expected 3 finite numbers"),
    ],
)
def test_a_wrong_spring_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Spring(**({"a": "a", "b": "b"} | changes))


def test_an_unknown_link_is_refused():
    with pytest.raises(ValueError, match=r"springs: there is no link 'c'; use one of 'a', 'b'"):
        compile_scene(pair(), springs=[Spring("a", "c")])
    with pytest.raises(ValueError, match="there is no link 'c'"):
        spring_energy(pair(), [Spring("c", "b")], np.zeros(8))
