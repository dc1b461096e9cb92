"""Error control that turns out dear ends, and says what it was and what limits its steps."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import box_on, pendulum, thrown

from featherstone_gait.model import Ground
from featherstone_gait.run import prepare as prepare_module
from featherstone_gait.run.classify import to_trajectory
from featherstone_gait.run.prepare import prepare
from featherstone_gait.run.simulate import initial_state, simulate
from featherstone_gait.scene.compile import compile_scene

pytestmark = pytest.mark.nojit


def within(scene, duration, state, budget):
    """A run that may take so many steps."""
    ready = prepare(scene, duration, rtol=1e-6)
    ready = replace(ready, plan=ready.plan._replace(budget=float(budget)))
    ((y, out),) = ready.run([ready.start(state)])
    return to_trajectory(ready, y, out)


@pytest.mark.long
@pytest.mark.bounds
@pytest.mark.parametrize("integrator", ["dop853", "extrapolation"])
def test_a_run_ends_when_its_steps_are_spent(integrator):
    scene = compile_scene(pendulum(friction=1e-3, damping=0.0), integrator=integrator)
    state = initial_state(scene, [1.0])
    free = simulate(scene, 0.5, state, rtol=1e-6)
    spent = free.info["steps"] + free.info["rejected_steps"]
    assert free.ok
    assert within(scene, 0.5, state, spent + 1).ok
    run = within(scene, 0.5, state, spent // 2)
    assert run.status == "too costly"
    assert 0.0 < run.end_time < 0.5
    assert f"pendulum: {integrator} took " in run.message
    assert "hinge limits explicit ones to" in run.message
    assert "by its Coulomb friction: raise rtol, or use implicit_euler" in run.message
    assert np.array_equal(run["q"][-1], run.final[:1])
    assert np.array_equal(run["q"][run["time"] < run.end_time][1], free["q"][1])


def test_a_run_that_goes_on_has_a_budget_of_its_own():
    scene = compile_scene(pendulum(damping=0.0), integrator="dop853")
    first = simulate(scene, 1.0, initial_state(scene, [1.0]), rtol=1e-6)
    assert within(scene, 0.05, first, first.info["steps"] // 2).ok


@pytest.mark.long
def test_the_budget_is_minutes_of_computing(monkeypatch):
    """And as many more a simulated second: an hour at a millisecond is within it."""
    plans = [prepare(compile_scene(pendulum(damping=0.0), integrator="dop853"), T).plan for T in (1.0, 3600.0)]
    assert plans[0].budget == pytest.approx(2.02e6)
    assert plans[1].budget > 3600.0 / 1e-3
    monkeypatch.setattr(prepare_module, "BUDGET", 10.0)
    monkeypatch.setattr(prepare_module, "BUDGET_RATE", 0.0)
    scene = box_on(Ground(), "extrapolation")
    run = simulate(scene, 0.5, thrown(scene, 0.01, 0.2), record=("base_q",), rtol=1e-8)
    assert run.status == "too costly"
    assert "contact limits explicit ones to" in run.message
    both = simulate(scene, 0.05, thrown(scene, 0.01, 0.2), record=("base_q",), rtol=1e-8, estimate_error=True)
    assert np.isinf(both.error["base_q"]).all()
