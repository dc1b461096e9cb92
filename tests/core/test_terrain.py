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
