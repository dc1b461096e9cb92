"""Derivatives of runs through rows: bodies that touch, loops, tendons, fluids, and compiled controllers.

Runs solve each step to 1e-9 of its forces, which differences of runs see and derivatives do not: they agree to 3e-7.
"""

import math

import numpy as np
import pytest

from featherstone_gait import (
    Reference,
    RunObjective,
    compile_scene,
    controller,
    gradient,
    load_robot,
    load_scene,
    run_cost,
)
from featherstone_gait.geometry.body import body
from featherstone_gait.model import Joint, Link, Loop, Model, Tendon, Via
from featherstone_gait.model.placed import Placed
from featherstone_gait.model.shapes import Box, Sphere
from featherstone_gait.run import adjoint
from featherstone_gait.run.compiled_run import Vector
from featherstone_gait.run.prepare import prepare
from featherstone_gait.run.start import initial_state

pytestmark = pytest.mark.long
BIG = body(Box((0.2, 0.2, 0.1)), 3.0, name="big")
INERTIA = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)


def dropped(shape, mass, position, orientation=(1.0, 0.0, 0.0, 0.0)):
    """A body that comes down on a box, both free, askew and with a little way to go."""
    small = body(shape, mass, name="small")
    placed = [Placed(small, "small", position=position, orientation=orientation), Placed(BIG, "big")]
    scene = compile_scene(placed, pairs="all", integrator="midpoint")
    first = scene.part("base_qd")[0]
    state = initial_state(scene)
    state[first : first + 3] = (0.3, 0.1, -0.5)
    return scene, state


def chain(**parts):
    links = [Link(name, 1.0, (0.0, 0.0, -0.1), INERTIA) for name in ("base", "upper", "lower")]
    joints = [
        Joint("shoulder", "revolute", "base", "upper", axis=(0.0, 1.0, 0.0)),
        Joint("elbow", "revolute", "upper", "lower", xyz=(0.0, 0.0, -0.2), axis=(0.6, 0.8, 0.0)),
    ]
    return Model("chain", tuple(links), tuple(joints), **parts)


def tied():
    path = (Via("base", (0.1, 0.0, 0.0)), Via("upper", (0.05, 0.0, -0.1)), Via("lower", (0.03, 0.0, -0.1)))
    bands = [Tendon("band", (), path, 300.0, 2.0, 0.15), Tendon("two", [("shoulder", 1.0), ("elbow", -0.5)], (), 5.0)]
    return compile_scene(chain(tendons=bands), integrator="implicit_euler"), None


def swinging():
    """A weight that a rod holds at a distance."""
    rod = Loop("rod", "distance", "lower", "base", (0.0, 0.0, -0.2), (0.3, 0.0, 0.0), distance=0.5)
    return compile_scene(chain(loops=[rod]), integrator="rk4"), None


CASES = {
    "boxes": lambda: dropped(Box((0.06, 0.06, 0.06)), 0.5, (0.02, 0.01, 0.098), (0.98, 0.12, 0.16, 0.0)),
    "a sphere on a box": lambda: dropped(Sphere(0.05), 1.0, (0.02, 0.01, 0.101)),
    "a loop": swinging,
    "tendons": tied,
    "a fluid": lambda: (compile_scene(load_scene("rov"), integrator="midpoint"), None),
}


def slope(f, h):
    """Differentiate by central differences of fourth order."""
    wide, narrow = ((f(width) - f(-width)) / (2.0 * width) for width in (h, 0.5 * h))
    return narrow + (narrow - wide) / 3.0


def check_run(run, start, along, h):
    """Compare the adjoint with differences along a change of the state, and with tangents; return its last numbers."""
    generator = np.random.default_rng(1)
    weights = generator.standard_normal((run.samples, len(run.channels)))
    derivatives = adjoint.Adjoint(run, start)
    recorded = derivatives.run()
    found = derivatives.pull(weights)

    def result(way):
        one = Vector.of(run, [start._replace(y=start.y + way * along)], 1)
        one.step()
        return float(np.sum(weights * one.out))

    assert float(np.sum(weights * recorded)) == result(0.0)  # the same bits
    assert found @ along == pytest.approx(slope(result, h), rel=3e-7)
    tangents = generator.standard_normal((derivatives.length + len(derivatives.by_kept), 3))
    directions = np.zeros((derivatives.entries, 3))
    directions[2:] = generator.standard_normal((derivatives.entries - 2, 3))
    out, _ = derivatives.push(tangents, directions)
    there = np.einsum("rc,rcp->p", weights, out)
    back = np.concatenate([found, derivatives.by_kept]) @ tangents + derivatives.adjoints @ directions
    assert there == pytest.approx(back, rel=1e-12)
    return derivatives


@pytest.mark.parametrize("case", CASES)
def test_adjoints_are_the_slopes_of_runs(case):
    scene, state = CASES[case]()
    bases = ("base_qd",) if scene.tree.floating else ("qd",)
    run = prepare(scene, 0.05, (("base_q",) if scene.tree.floating else ("q",)) + bases)
    start = run.start(state, None, None)
    along = np.zeros(len(start.y))
    for name in bases:
        first, end = scene.part(name)
        along[first:end] = np.random.default_rng(0).standard_normal(end - first)
    if scene.model.loops:
        return _along_a_loop(scene, run, start)
    derivatives = check_run(run, start, along, 1e-4)
    if case in ("boxes", "a sphere on a box"):
        first, end = scene.part("pair_normal_force")
        touching = derivatives.states[:, first:end].max(axis=1) > 0.0
        assert 5 < touching.sum() < len(touching) - 5  # they touch, and not at once


def _along_a_loop(scene, run, start):
    """Velocities are projected onto the loop, so that any change of them counts as its projection does."""
    first, end = scene.part("qd")
    along = np.zeros(len(start.y))
    along[first:end] = (0.7, -0.4)
    check_run(run, start, along, 1e-4)


def test_what_a_pool_of_pairs_deals_out_anew_changes_no_derivative(monkeypatch):
    scene, state = CASES["a sphere on a box"]()
    run = prepare(scene, 0.05, ("base_q",))
    whole = adjoint.Adjoint(run, run.start(state, None, None))
    assert len(whole.segments) == 1
    monkeypatch.setattr(adjoint, "MOST_STATES", 30 * whole.length)
    pieces = adjoint.Adjoint(run, run.start(state, None, None))
    seeds = np.ones((run.samples, len(run.channels)))
    assert np.array_equal(whole.run(), pieces.run())
    assert len(pieces.segments) == 5
    assert np.array_equal(whole.pull(seeds), pieces.pull(seeds))


@controller(memory=3, period=0.02)
def lean(t, state, reference, command, memory):
    memory[2] += 0.02 * state.qd[1]
    command[1, 0] = reference[1, 0] - memory[0] * state.q[0] + memory[1] * math.sin(state.q[2]) + 0.1 * memory[2]


def test_gains_of_a_compiled_controller():
    scene, gains = compile_scene(load_robot("arm7"), "mipsd", integrator="midpoint"), np.array([0.4, 0.3, 0.0])
    reference = Reference([0.0, 0.05, 0.1], 0.1 * np.random.default_rng(0).standard_normal((3, 7)), kind="cubic")

    def given(gains):
        run = prepare(scene, 0.1, ("q", "qd"), controller=lean.beginning_with(gains))
        return run, run.start(None, reference, None)

    run, start = given(gains)
    along = np.zeros(len(start.y))
    along[scene.layout["qd"] : scene.layout["qd"] + 7] = 1.0
    derivatives = check_run(run, start, along, 1e-4)
    weights = np.random.default_rng(1).standard_normal((run.samples, len(run.channels)))
    derivatives.pull(weights)
    for k, move in enumerate(np.eye(3)):

        def result(way, move=move):
            run, start = given(gains + way * move)
            one = Vector.of(run, [start], 1)
            one.step()
            return float(np.sum(weights * one.out))

        assert derivatives.by_kept[k] == pytest.approx(slope(result, 1e-3), rel=1e-7)

    @run_cost
    def cost(q):
        return q[-1, 1] ** 2 + q[-1, 3]

    objective = RunObjective(scene, 0.1, cost, _inputs_of(reference), controller=lean)
    value, by_gains = objective(gains)
    alone = gradient(scene, 0.1, cost, ["controller"], reference=reference, controller=lean.beginning_with(gains))
    assert value == alone.value
    assert by_gains == pytest.approx(alone["controller"], rel=1e-9)
    for k, move in enumerate(np.eye(3)):
        found = slope(lambda way, move=move: objective(gains + way * move)[0], 1e-3)
        assert by_gains[k] == pytest.approx(found, rel=1e-6, abs=1e-10)


def _inputs_of(reference):
    return lambda x: {"controller": x, "reference": reference}
