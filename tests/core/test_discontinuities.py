"""Where forces change to another branch of their law errors follow the tolerance; what is lossless loses nothing."""

import math
from functools import partial

import numpy as np
import pytest

from featherstone_gait import Ground, Reference, compile_scene, initial_state, load_robot, simulate
from featherstone_gait.benchmark.case import case_of, distances
from featherstone_gait.benchmark.default_scenes import spinning
from featherstone_gait.benchmark.scenes import NO_FALL, ball
from featherstone_gait.run.trajectory import positions

RTOL = 10.0 ** -np.arange(4.0, 9.5)


def thrown(servos, speed):
    """One servo, thrown into its stop: it bounces there, its teeth part, its current meets its limits."""
    return case_of("", "", compile_scene(load_robot("ax12_arm"), servos), 0.5, [3.0], [speed])


def clipped(servos):
    """A reference that it cannot follow: voltage, current and its rate are at their limits by turns."""
    t = np.linspace(0.0, 1.0, 101)
    scene = compile_scene(load_robot("ax12_arm"), servos)
    return case_of("", "", scene, 1.0, [0.0], None, reference=Reference(t, np.sin(4.0 * math.pi * t)[:, None]))


def dropped():
    """A box falls on a corner, tumbles and slides."""
    box = spinning("", 5.0, 0.5).scene.model
    scene = compile_scene(box, ground=Ground(friction=0.6), **NO_FALL)
    tilted = [0.0, 0.0, 0.2, math.cos(0.15), 0.6 * math.sin(0.15), 0.8 * math.sin(0.15), 0.0]
    return case_of("", "", scene, 0.5, tilted, [0.5, 0.2, 0.0, 0.0, 0.0, 1.0], record_interval=0.01)


CASES = [partial(thrown, "mipsd", speed) for speed in (6.0, 10.0, 30.0, 60.0)]
CASES += [partial(thrown, "rotor", 60.0), partial(clipped, "mipsd"), partial(clipped, "rotor"), dropped]


def errors(case, integrator, tolerances, best=1e-11):
    """Largest errors of positions over the records, at each tolerance [rad or m]."""
    scene = case.scene.recompiled(integrator="extrapolation", timestep=None)
    exact = positions(case.run(scene, rtol=best))
    scene = case.scene.recompiled(integrator=integrator, timestep=None)
    return np.array([distances(scene, positions(case.run(scene, rtol=rtol)), exact).max() for rtol in tolerances])


@pytest.mark.long
def test_errors_follow_the_tolerance_across_discontinuities():
    """A decade brings a factor of 6, as the median; none is large, nor larger than at the tolerance before.

    What is far below its tolerance already, by chance, may come nearer to it.
    """
    found = np.array([errors(case(), "extrapolation", RTOL) for case in CASES])
    assert np.median(found[:, :-1] / found[:, 1:]) > 6.0
    assert (found < 20.0 * RTOL).all()
    assert (found[:, 1:] < 2.0 * np.maximum(found[:, :-1], 0.1 * RTOL[:-1])).all()


@pytest.mark.long
@pytest.mark.parametrize(("case", "most"), [(CASES[2], 2e-4), (CASES[3], 1.5e-3), (CASES[5], 2e-4), (CASES[6], 2e-4)])
def test_order_3_resolves_limits_of_the_current_and_stops(case, most):
    """By default, where a current that left its limit late made errors of up to 2e-2 rad."""
    assert errors(case(), "ars343", (1e-3,), best=1e-8)[0] < most


@pytest.mark.long
def test_an_elastic_bounce_returns_to_its_height():
    """A ball dropped by 50 mm on ground of damping ratio 0."""
    scene = compile_scene(ball(), None, Ground(damping_ratio=0.0), integrator="ars343", **NO_FALL)
    start = initial_state(scene, [0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0])
    height = simulate(scene, 0.5, start, record=("base_q",), record_interval=1e-3)["base_q"][:, 2] - 0.05
    assert height[:150].min() < 0.0
    assert abs(height[150:].max() - 0.05) < 0.01 * 0.05


@pytest.mark.long
def test_elastic_bounces_keep_their_energy_to_the_tolerance():
    """Wherever in a step a contact ends, also where all columns step over the rest of it."""
    scene = compile_scene(ball(), None, Ground(damping_ratio=0.0), "extrapolation", **NO_FALL)
    for rtol, allowed in ((1e-4, 3e-3), (1e-6, 6e-5)):
        for height in np.linspace(0.03, 0.2, 18):
            start = initial_state(scene, [0.0, 0.0, 0.05 + height, 1.0, 0.0, 0.0, 0.0])
            run = simulate(scene, 0.5, start, rtol=rtol, estimate_error=False)
            z, v = run["base_q"][:, 2] - 0.05, run["base_qd"][:, 2]
            energy = 9.81 * z + 0.5 * v**2
            assert np.abs(energy[z > 0.0] / energy[0] - 1.0).max() < allowed
