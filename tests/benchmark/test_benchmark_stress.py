"""Runs under stress: what physics says of them, and that none is silently wrong."""

import math

import numpy as np
import pytest

from featherstone_gait.benchmark import scenes, stress


@pytest.fixture(scope="module")
def cases():
    return {case.name: case for case in scenes.stressed()}


@pytest.mark.long
def test_no_run_of_a_stiff_arm_is_silently_wrong(cases):
    case = cases["gains times 1, from 0.5 rad"]
    tried = [setting for setting in case.settings if setting[0] in ("implicit_euler", "midpoint", "extrapolation")]
    case = case._replace(settings=tuple(tried))
    rows = stress.judged(case)
    assert [row.verdict for row in rows].count("silent") == 0
    assert {row.verdict for row in rows} >= {"held", "flagged"}
    assert rows[-1].error < 1e-6


@pytest.mark.long
def test_a_box_dropped_from_two_meters_meets_the_ground_at_its_own_time(cases):
    """The lowest corner, 2 m less what the tilt takes, touches after sqrt(2 h / g); until then the fall is free."""
    case = cases["box dropped from 2 m"]._replace(record_interval=1e-3)
    run = case.run(case.by("extrapolation", 1e-3), rtol=1e-8)
    z, t = run["base_q"][:, 2], run["time"]
    free = 2.05 - 0.5 * 9.81 * t * t
    touch = math.sqrt(2.0 * (2.0 - 0.01) / 9.81)  # corners hang 1 cm lower at most: 0.2 m times the tilt of 0.045 rad
    before = t < touch - 2e-3
    assert np.abs(z[before] - free[before]).max() < 1e-9
    assert z[-1] > free[-1] + 0.1


@pytest.mark.long
def test_a_box_that_starts_deep_in_the_ground_flies_no_higher_than_its_springs_can_throw_it(cases):
    """Four springs of m g / (4 x 1 mm), pressed by up to 2 cm and the tilt, hold at most k x^2 / 2 each."""
    case = cases["box sunk in by 2 cm"]
    k = 1.0 * 9.81 / (4 * case.scene.ground.penetration)
    deepest = 0.02 + 0.2 * 0.045 + 1e-3
    height = 0.03 + 4 * 0.5 * k * deepest**2 / 9.81
    for integrator in ("implicit_euler", "midpoint", "extrapolation"):
        run = case.run(case.by(integrator, 1e-3))
        assert run["base_q"][:, 2].max() < height
        assert run["base_q"][-1, 2] > 0.035  # it comes up, slowly: the ground is damped


@pytest.mark.parametrize("full", [False, True])
def test_all_steps_of_a_case_meet_at_its_records(full):
    for case in scenes.stressed(full):
        counts = np.array([case.record_interval / step for _, step in case.settings if step == step])
        np.testing.assert_allclose(counts, np.round(counts), rtol=1e-9)
        assert 2.0 * case.record_interval <= case.duration


def test_the_picture_has_a_cell_for_each_run(cases):
    row = stress.Row("case", "midpoint", 1e-3, "held", "ok", 1e-6, 1e-6, 1.0)
    figure = stress.plot([row, row._replace(integrator="dop853", step=math.nan, verdict="silent")])
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["midpoint\n1 ms", "dop853"]
