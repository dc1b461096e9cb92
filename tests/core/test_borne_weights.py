"""Weights that are borne (`Link.gravity_compensation`): a force at the center of mass in every algorithm."""

from dataclasses import replace

import numpy as np
import pytest
from random_tree import random_states, random_tree

from featherstone_gait import (
    Push,
    compile_scene,
    energy,
    forward_dynamics,
    forward_kinematics,
    inverse_dynamics,
    simulate,
)
from featherstone_gait.dynamics.tree import GRAVITY
from featherstone_gait.run.simulate import initial_state

STATE = ("base_q", "q", "base_qd", "qd")
PLAIN = {"integrator": "rk4", "timestep": 1e-3}


def borne(share, base="floating"):
    """A tree of which the share of every weight is borne."""
    tree = random_tree(6, 2, base=base)
    return replace(tree, links=[replace(link, gravity_compensation=share) for link in tree.links])


def fallen(model, integrator, **how):
    """The end of a fall of a tenth of a second."""
    scene = compile_scene(model, integrator=integrator, **how)
    q, qd, _ = (x[0] for x in random_states(model, 1, 5))
    return simulate(scene, 0.1, initial_state(scene, q, qd), estimate_error=False, record=STATE)


@pytest.mark.quick("floating")
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_a_borne_share_is_as_much_less_gravity(base):
    """And the potential energy is that of what is left; inverse dynamics asks for as much less force."""
    model, whole = borne(0.25, base), borne(0.0, base)
    q, qd, tau = random_states(model, 9, 1)
    less = 0.75 * np.array(GRAVITY)
    for compute in (forward_dynamics, inverse_dynamics):
        found, expected = compute(model, q, qd, tau), compute(whole, q, qd, tau, gravity=less)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    np.testing.assert_allclose(energy(model, q, qd), energy(whole, q, qd, gravity=less), rtol=0, atol=1e-12)


def test_a_link_may_be_borne_alone():
    """By the slope of its height: what gravity compensation of a link saves the joints is -m g times it."""
    tree = random_tree(6, 2)
    model = replace(tree, links=[*tree.links[:-1], replace(tree.links[-1], gravity_compensation=1.0)])
    (q, *_), still, link = random_states(model, 1, 3)[0], np.zeros(model.nv), model.links[-1]

    def height(q):
        rotation, position = forward_kinematics(model, q, link.name)
        return (position + rotation @ link.center_of_mass)[2]

    saved = inverse_dynamics(tree, q, still, still) - inverse_dynamics(model, q, still, still)
    slope = [(height(q + 1e-6 * e) - height(q - 1e-6 * e)) / 2e-6 for e in np.eye(model.nq)]
    np.testing.assert_allclose(saved, link.mass * 9.81 * np.array(slope), atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["implicit_euler", "midpoint", "rk4", "dop853", "ars343", "extrapolation"])
def test_what_is_borne_whole_falls_as_without_gravity(integrator):
    """To rounding in steps that are the same; error control may choose others."""
    found, free = fallen(borne(1.0), integrator), fallen(borne(0.0), integrator, gravity=(0.0, 0.0, 0.0))
    fixed = integrator in ("implicit_euler", "midpoint", "rk4")
    for name in STATE:
        np.testing.assert_allclose(found[name], free[name], rtol=0, atol=1e-10 if fixed else 1e-4)


@pytest.mark.long
def test_pushes_come_on_top():
    """A push up that bears as much again lifts the robot as it falls."""
    model = borne(1.0)
    scene = compile_scene(model, **PLAIN)
    q, qd, _ = (x[0] for x in random_states(model, 1, 5))
    start = initial_state(scene, q, 0.0 * qd)
    pushes = [Push(link.name, (0.0, 0.0, link.mass * 9.81), point=link.center_of_mass) for link in model.links]
    run = simulate(scene, 0.1, start, pushes=pushes, record=STATE)
    assert run["base_q"][-1, 2] == pytest.approx(q[2] + 0.5 * 9.81 * 0.1**2, rel=1e-9)
