"""Stacks: how deep their boxes sink, that they stand still, and mass ratios of a thousand."""

import math

import numpy as np
import pytest
from touching import G, obstacle, placed, touching

from featherstone_gait.model.shapes import Box
from featherstone_gait.run.simulate import simulate
from featherstone_gait.scene.tolerances import FREE

pytestmark = pytest.mark.long

EDGE = 0.1
DOWN = (0.0, 0.0, -G)
STEPS = [("ars343", None), ("implicit_euler", 1e-3), ("midpoint", 1e-3)]


def stack(masses, integrator="ars343", timestep=None, aside=0.0, turn=0.0, **law):
    """Cubes on a floor, the lowest first; each a bit aside and turned from the one below."""
    cubes = [
        placed(Box((EDGE, EDGE, EDGE)), mass, f"cube{k}", (aside * (k % 2), 0.0, EDGE * (k + 0.5)),
               (math.cos(0.5 * k * turn), 0.0, 0.0, math.sin(0.5 * k * turn)))
        for k, mass in enumerate(masses)
    ]  # fmt: skip
    floor = obstacle(Box((2.0, 2.0, 1.0)), "floor", (0.0, 0.0, -0.5))
    return touching(cubes, [floor], integrator, timestep, DOWN, **law)


def moves(scene, duration, settled, sinking=None):
    """Return how far any cube moves after it has settled [m]; sinking: into the one below, as it has to be [m]."""
    run = simulate(scene, duration, record=("base_q",), record_interval=0.1, estimate_error=False)
    assert run.status == "ok", run.message
    q = run["base_q"]
    if sinking is not None:
        low, below = q[-1, :, 2] - 0.5 * EDGE, np.array([0.0, *(q[-1, :-1, 2] + 0.5 * EDGE)])
        np.testing.assert_allclose(below - low, sinking, rtol=1e-6)
    late = run["time"] >= settled
    return np.abs(q[late] - q[late][0]).max()


@pytest.mark.parametrize(("integrator", "timestep"), STEPS)
def test_a_stack_of_ten_boxes_sinks_in_by_the_law_and_does_not_creep(integrator, timestep):
    """In ten minutes it would creep by less than a nanometer; the lowest pair carries all ten."""
    sinking = 5e-4 * np.arange(10, 0, -1) / 10.0
    assert moves(stack([1.0] * 10, integrator, timestep), 60.0, 30.0, sinking) < 5e-11


@pytest.mark.parametrize(
    ("integrator", "timestep", "tremble"), [(*STEPS[0], 1e-3 * FREE), *((*one, 1e-11) for one in STEPS[1:])]
)
def test_a_crooked_stack_of_ten_boxes_stands_without_creeping(integrator, timestep, tremble):
    """Once it has swayed out; error control lets it tremble, by less than a thousandth of its tolerance."""
    scene = stack([1.0] * 10, integrator, timestep, aside=0.01, turn=0.1, penetration=5e-5)
    assert moves(scene, 60.0, 45.0) < tremble


def least_stiffness(count, penetration=5e-4):
    """Least eigenvalue of the stiffness of a tower over m g a, against tilting, of cubes of mass m and edge a.

    A joint resists a relative tilt by k a^2, k = m g / (4 penetration); each cube is pushed over by half its own weight
    and that of those above it.
    """
    joint = EDGE / (4.0 * penetration)
    K = joint * (np.diag([2.0] * (count - 1) + [1.0]) - np.eye(count, k=1) - np.eye(count, k=-1))
    return np.linalg.eigvalsh(K - np.diag(np.arange(count, 0, -1) - 0.5)).min()


@pytest.mark.parametrize(("count", "falls"), [(6, False), (8, True)])
def test_a_tower_buckles_where_its_contacts_are_too_soft(count, falls):
    """Made for the weight of one, eight cubes fall, six stand."""
    assert (least_stiffness(count) < 0.0) == falls
    scene = stack([1.0] * count, "implicit_euler", 1e-3, aside=1e-3, load=1.0)
    run = simulate(scene, 30.0, record=("base_q",), record_interval=0.1, estimate_error=False)
    assert (run["base_q"][-1, -1, 2] < EDGE * (count - 1)) == falls


@pytest.mark.parametrize(("integrator", "timestep"), STEPS)
@pytest.mark.parametrize("masses", [(0.1, 100.0), (100.0, 0.1)])
def test_a_box_rests_on_one_of_a_thousandth_of_its_mass_and_under_it(masses, integrator, timestep):
    """As deep as the weight of both asks for: less than a millimeter in all."""
    scene = stack(masses, integrator, timestep)
    sinking = 5e-4 * np.array([sum(masses), masses[1]]) / sum(masses)
    assert moves(scene, 10.0, 5.0, sinking) < 1e-10


def test_a_light_box_between_two_heavy_ones_is_held():
    masses = (100.0, 0.1, 100.0)
    sinking = 5e-4 * np.array([200.1, 100.1, 100.0]) / 200.1
    assert moves(stack(masses), 10.0, 5.0, sinking) < 1e-10
