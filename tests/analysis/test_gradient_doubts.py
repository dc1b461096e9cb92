"""Doubts of gradients through events, beside closed forms and differences of runs in fine steps."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scenes import box_on, pendulum, resting

from featherstone_gait import (
    Box,
    Ground,
    PairContact,
    Placed,
    RunObjective,
    SceneModel,
    Sphere,
    body,
    compile_scene,
    gradient,
    gradient_batch,
    initial_state,
    load_robot,
    run_cost,
    simulate,
)
from featherstone_gait.model import Tendon

pytestmark = pytest.mark.long
BY = ["state.base_q", "state.base_qd"]


@run_cost
def height(base_q):
    return base_q[-1, 2]


@run_cost
def far_and_high(base_q):
    return 100.0 * base_q[-1, 0] + base_q[-1, 2]


@run_cost
def angle(q):
    return q[-1, 0]


def room(timestep):
    """A ball without weight over a floor, from which it comes back as fast as it came."""
    ball, floor = body(Sphere(0.1), 1.0, name="ball"), body(Box((1, 1, 0.2)), name="floor", base="fixed")
    model = SceneModel("room", [Placed(ball)], [Placed(floor, position=(0.0, 0.0, -0.1))], gravity=(0.0, 0.0, 0.0))
    elastic = PairContact("all", penetration=1e-3, damping_ratio=0.0, friction=0.0)
    return compile_scene(model, pairs=elastic, integrator="midpoint", timestep=timestep)


def falling(scene, high=1.0, speed=-2.0):
    state = initial_state(scene)
    view = scene.state_view(state)
    view.base_q[2], view.base_qd[2] = high, speed
    return state


def quietly(*arguments, **more):
    """Return a gradient and the texts of what it warned of."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        found = gradient(*arguments, **more)
    return found, [str(one.message) for one in warned]


@pytest.mark.parametrize("timestep", [1e-3, 2.5e-4, 6.25e-5])
def test_a_gradient_through_a_bounce_is_that_of_the_bounce_or_doubtful(timestep):
    """An elastic ball that starts a higher ends as much lower: the derivative is -1, by the speed 2 -z / v - t."""
    scene = room(timestep)
    for high in (1.0, 1.0006, 1.0011):
        found, warned = quietly(scene, 1.0, height, ["state.base_q"], falling(scene, high))
        assert np.abs(np.delete(found["state.base_q"], 2)).max() < 1e-12  # a contact that no one has slid
        off = abs(found["state.base_q"][2] + 1.0)
        assert off < 0.12 or found.status == "doubtful"
        assert off > 0.06 or found.status == "ok"
        assert [found.doubts] * bool(found.doubts) == warned


def test_the_doubt_is_told_with_time_and_place_and_only_where_it_bounces():
    """The ball touches after 0.9 m at 2 m/s."""
    scene, states = room(1e-3), [falling(room(1e-3)), falling(room(1e-3), 3.0)]
    words = r"from 0\.45\d* s on, bodies touch: ball/body and floor/body.*1 of 2"
    with pytest.warns(RuntimeWarning, match=words) as warned:
        found = gradient_batch(scene, 1.0, height, BY, states)
    assert warned[0].filename == __file__
    assert [one.status for one in found] == ["doubtful", "ok"]
    assert [one.trajectory.status for one in found] == ["ok", "ok"]
    assert found[1]["state.base_q"][2] == pytest.approx(1.0, abs=1e-12)


def test_a_doubtful_part_is_seen_behind_a_larger_one():
    scene = room(1e-3)
    found, warned = quietly(scene, 1.0, far_and_high, ["state.base_q"], falling(scene))
    assert "bodies touch" in warned[0]
    assert found.check().agrees
    assert found.check(each=True).doubtful["state.base_q"].tolist() == [False, False, True, False, False, False]
    assert not found.check(each=True).agrees


def test_an_objective_warns_once():
    scene = room(1e-3)
    objective = RunObjective(scene, 1.0, height, lambda x: {"state": falling(scene, 1.0, x[0])})
    objective([-0.5])
    assert objective.last[0].status == "ok"
    with pytest.warns(RuntimeWarning, match="bodies touch"):
        objective([-2.0])
    objective([-2.1])
    assert objective.last[0].status == "doubtful"


@pytest.mark.parametrize("start", [0.5, 0.51])
@pytest.mark.parametrize("where", ["hinge", "cord"])
def test_a_gradient_through_a_stop_is_right_or_doubtful(where, start):
    """The limit is the joint's, or that of a tendon that is wound up by it."""
    cord = Tendon("cord", joints=(("hinge", 1.0),), lower=-0.2, upper=10.0)
    by_tendon = replace(pendulum(damping=0.0), tendons=(cord,))
    model = pendulum(lower=-0.2, damping=0.0) if where == "hinge" else by_tendon
    scenes = [compile_scene(model, None, integrator="midpoint", timestep=h) for h in (3e-5, 1e-3, 2.5e-4)]
    fine, ends = scenes.pop(0), []
    for step in (2e-3, -2e-3):
        run = simulate(fine, 0.6, initial_state(fine, [start + step]), record=("q",), estimate_error=False)
        ends.append(run["q"][-1, 0])
    exact = (ends[0] - ends[1]) / 4e-3
    for scene in scenes:
        found, warned = quietly(scene, 0.6, angle, ["state.q"], initial_state(scene, [start]))
        off = abs(found["state.q"][0] / exact - 1.0)
        assert off < 0.12 or f"stop reached: {where}" in warned[0]
        assert off > 0.06 or found.status == "ok"


def test_a_box_that_lies_and_slides_on_soft_ground_is_not_doubted():
    scene = box_on(Ground(friction=0.5, penetration=1e-2), "midpoint", 1e-3)
    for velocity in (0.0, 0.3):
        found, warned = quietly(scene, 0.2, height, BY, resting(scene, (velocity, 0.0, 0.0)))
        assert (found.status, warned) == ("ok", [])


def test_a_humanoid_that_stands_is_not_doubted():
    """Its gears slip and stick, which bends the cost and does not break it."""
    scene = compile_scene(load_robot("humanoid"), "mipsd", Ground(), "midpoint", 1e-3)
    found, warned = quietly(scene, 0.2, height, ["state.qd", "links.mass"])
    assert any(event.what == "joint slips" for event in found.events)
    assert (found.status, warned) == ("ok", [])
