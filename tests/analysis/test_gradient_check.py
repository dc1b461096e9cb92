"""Events of runs and doubtful derivatives."""

import math

import numpy as np
import pytest
from scenes import box_on, thrown

from featherstone_gait import Ground, compile_scene, gradient, initial_state, load_robot, run_cost

pytestmark = pytest.mark.long
G = 9.81


@pytest.fixture(scope="module")
def scene():
    return box_on(Ground(friction=0.5, penetration=1e-3), "midpoint", 1e-3)


def forward(channels):
    """How far the box has come, and its derivatives."""
    by_base = np.zeros(channels["base_q"].shape)
    by_base[-1, 0] = 1.0
    return float(channels["base_q"][-1, 0]), {"base_q": by_base}


def jumping(channels):
    """The same with jumps, which no derivative sees."""
    value, derivatives = forward(channels)
    return value + 10.0 * 1e-4 * math.floor(value / 1e-4), derivatives


def test_events_are_told_when_they_happen(scene):
    """A flat box falls 5 cm for sqrt(2 h / g), and slides on its four corners until friction has stopped it."""
    state = thrown(scene, 0.05, velocity=(0.3, 0.0, 0.0))
    with pytest.warns(RuntimeWarning, match="contact made: box"):
        found = gradient(scene, 0.4, forward, ["state.base_qd"], state, record=("base_q",))
    made = [event for event in found.events if event.what == "contact made"]
    assert made[0].time == pytest.approx(math.sqrt(2.0 * 0.05 / G), abs=2e-3)
    assert len({event.where for event in made}) == 4
    kinds = [event.what for event in found.events]
    assert "contact slips" in kinds
    assert "contact sticks" in kinds
    assert [*found.events] == sorted(found.events, key=lambda event: event.time)


def test_a_run_in_the_air_has_no_events_and_no_doubts(scene):
    state = thrown(scene, 1.0, velocity=(0.3, 0.0, 0.0))
    found = gradient(scene, 0.2, forward, ["state.base_qd", "gravity"], state, record=("base_q",))
    assert found.events == ()
    check = found.check(each=True)
    assert check.agrees
    assert check.slope == pytest.approx(check.difference, rel=1e-9)
    for name in found:
        np.testing.assert_allclose(check.differences[name], found[name], atol=1e-9)
        assert not check.doubtful[name].any()


@pytest.mark.filterwarnings("ignore:cost")
def test_jumps_make_those_derivatives_doubtful_that_cross_them(scene):
    state = thrown(scene, 1.0, velocity=(0.3, 0.0, 0.0))
    found = gradient(scene, 0.2, jumping, ["state.base_qd", "gravity"], state, record=("base_q",))
    check = found.check()
    assert not check.agrees
    assert check.doubtful["state.base_qd"].tolist() == [True, *[False] * 5]
    assert check.doubtful["gravity"].tolist() == [True, False, False]
    assert check.differences["state.base_qd"][0] == pytest.approx(11.0 * 0.2, rel=0.2)


def test_a_wrong_derivative_of_a_cost_is_told(scene):
    def wrong(channels):
        value, derivatives = forward(channels)
        return 2.0 * value, derivatives

    with pytest.warns(UserWarning, match="by its derivatives"):
        gradient(scene, 0.01, wrong, ["gravity"], thrown(scene, 1.0, velocity=(0.3, 0.0, 0.0)), record=("base_q",))


def test_a_run_that_falls_has_no_gradient_and_says_so(scene):
    falling = compile_scene(scene.model, ground=scene.ground, integrator="midpoint", timestep=1e-3)
    found = gradient(falling, 0.1, forward, ["state.base_qd"], thrown(falling, 0.6, tilt=2.0), record=("base_q",))
    assert found.status == "fell"
    assert found.value == math.inf
    assert np.isnan(found["state.base_qd"]).all()
    with pytest.raises(ValueError, match="no gradient to check"):
        found.check()


@pytest.mark.parametrize("integrator", ["dop853", "extrapolation", "ars343"])
def test_integrators_that_choose_their_steps_are_refused_by_name(integrator):
    scene = compile_scene(load_robot("arm7"), None, integrator=integrator)
    with pytest.raises(ValueError, match=f"{integrator}.*midpoint"):
        gradient(scene, 0.1, forward, ["state.q"], initial_state(scene), record=("q",))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("state.qdd", "state.qdd"), ("mass", "links"), ("links.mas", "links.mas"), ("joints.damping", "on or off"),
        ("reference", "no reference is given"), ("tau", "no tau is given"), ("state.nothing", "nothing"),
    ],
)  # fmt: skip
def test_names_that_are_no_parameters_are_refused(name, words):
    scene = compile_scene(load_robot("arm7"), None, integrator="midpoint")
    with pytest.raises(ValueError, match=words):
        gradient(scene, 0.1, forward, [name], record=("q",))


def test_costs_that_do_not_fit_are_refused(scene):
    state = thrown(scene, 1.0)
    ways = {
        "returned": lambda channels: 1.0,
        "no channel": lambda channels: (1.0, {"q": 1.0}),
        "the shape": lambda channels: (1.0, {"base_q": np.zeros(3)}),
        "power": lambda channels: (1.0, {"power": np.zeros(channels["power"].shape)}),
    }
    for words, cost in ways.items():
        record = ("base_q", "power") if words == "power" else ("base_q",)
        with pytest.raises(ValueError, match=words):
            gradient(scene, 0.01, cost, ["gravity"], state, record=record)
    whole = run_cost(lambda base_q: np.sum((base_q[-1] - base_q[0]) ** 2))
    with pytest.raises(ValueError, match="loops over numbers"):
        gradient(scene, 0.01, whole, ["gravity"], state)
    with pytest.raises(ValueError, match="goal"):
        gradient(scene, 0.01, run_cost(lambda base_q, goal: base_q[-1, 0] - goal[0]), ["gravity"], state)
