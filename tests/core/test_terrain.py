"""Error control does not step over what is narrow in the ground."""

import math

import numpy as np
import pytest

from featherstone_gait import (
    ContactPoint,
    Ground,
    HeightField,
    Joint,
    Link,
    Model,
    compile_scene,
    initial_state,
    simulate,
)

LENGTH, MASS = 0.45, 0.5  # of a rod [m], [kg]


def leg(gap):
    """Hang a rod on a hinge so high that its tip passes the level ground at a distance [m]."""
    inertia = MASS * LENGTH**2 / 12.0
    rod = Link("rod", MASS, (0.0, 0.0, -0.5 * LENGTH), (inertia, 0.0, 0.0, inertia, 0.0, 1e-4))
    hinge = Joint("hip", "continuous", "base", "rod", (0.0, 0.0, LENGTH + gap), axis=(0.0, 1.0, 0.0))
    tip = ContactPoint("rod", (0.0, 0.0, -LENGTH))
    return Model("leg", (Link("base"), rod), (hinge,), "fixed", contacts=(tip,))


def ridge(width, height):
    x = np.arange(-0.3, 0.3 + 0.5 * width, width)
    heights = np.where(np.abs(x) < 0.5 * width, height, 0.0)
    return Ground(field=HeightField(np.stack([heights, heights], 1), (width, 10.0), (-0.3, -5.0)))


@pytest.mark.long
@pytest.mark.parametrize(
    "ground", [ridge(0.005, 0.02), ridge(0.01, 0.012), Ground(steps=((-0.002, 0.02), (0.002, 0.0)))]
)
def test_no_ridge_is_stepped_over(ground):
    """A leg swings at 10 to 100 rad/s past ridges 4 to 20 mm wide; most runs missed them, with status ok."""
    scene, fine = compile_scene(leg(0.01), ground=ground), compile_scene(leg(0.01), None, ground, "midpoint", 1e-6)
    for speed in (10.0, 20.0, 50.0, 100.0):
        for angle in (1.12, 1.36, 1.6, 1.84):
            start, until = ([angle], [-speed]), math.ceil(100.0 * (angle + 1.0) / speed) / 100.0
            run = simulate(scene, until, initial_state(scene, *start))
            truth = simulate(fine, until, initial_state(fine, *start), estimate_error=False)["qd"][-1, 0]
            assert not run.ok or abs(run["qd"][-1, 0] - truth) < 0.1, (speed, angle)


@pytest.mark.long
@pytest.mark.parametrize("gravity", [1.0, 9.81])
def test_no_spoke_passes_through_the_floor(gravity):
    """Three spokes turn at 1000 rad/s and dip 2 mm into the floor; up to 3 of 10 runs missed it, with status ok."""
    length, mass, c, s = 0.3, 0.3, 0.6, 0.8
    inertia = mass * length**2 / 12.0
    wheel = Link("wheel", mass, (0.0, 0.0, 0.0), (inertia, 0.0, 0.0, inertia, 0.0, inertia))
    hinge = Joint("axle", "continuous", "base", "wheel", (0.0, 0.0, length - 0.002), axis=(c, s, 0.0))
    angles = (0.0, 2.1, 4.2)
    tips = tuple(ContactPoint("wheel", (length * math.sin(a), 0.0, -length * math.cos(a))) for a in angles)
    model = Model("spokes", (Link("base"), wheel), (hinge,), "fixed", contacts=tips)
    down, ground = (0.0, 0.0, -gravity), Ground()
    scene = compile_scene(model, ground=ground, gravity=down)
    fine = compile_scene(model, None, ground, "midpoint", 5e-7, gravity=down)
    for angle in np.linspace(0.5, 3.1, 10):
        run = simulate(scene, 0.004, initial_state(scene, [angle], [-1000.0]))
        truth = simulate(fine, 0.004, initial_state(fine, [angle], [-1000.0]), estimate_error=False)["qd"][-1, 0]
        assert not run.ok or abs(run["qd"][-1, 0] - truth) < 1.0, angle
