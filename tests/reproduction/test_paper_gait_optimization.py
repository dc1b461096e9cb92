"""The gait made cheaper (the paper's Figs. 14 to 16)."""

from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait import load_robot
from featherstone_gait.optimize import optimize_gait, walking_cost
from featherstone_gait.reproduction import gait_optimization
from featherstone_gait.reproduction.gait_optimization import (
    CHATTER,
    CONDITIONS,
    DEFINITIONS,
    MIPSD,
    MIPSD_NOISY,
    STANDARD,
    STANDARD_NOISY,
    GaitSearch,
    GaitSearchSettings,
    check,
    cost_of,
    measure,
    plot,
    run,
)

pytestmark = pytest.mark.long

SHORT = GaitSearchSettings(iterations=60, searches=1, noisy_searches=1, points=4)


@pytest.fixture(scope="module")
def result():
    return run(SHORT)


@pytest.fixture(scope="module")
def planned():
    return walking_cost(load_robot("humanoid", locked="simplified"))


def test_measures_are_those_of_the_cost(planned):
    x = planned.gait.to_vector()
    vectors = [x, x + 0.002, x - 0.002]
    theirs = [(m.cost, 0.5 * m.stride_length) for m in planned.measure(vectors)]
    np.testing.assert_allclose(measure(planned, vectors), theirs, rtol=1e-12)


def test_the_search_is_the_products(result, planned):
    theirs = optimize_gait(planned, iterations=SHORT.iterations, seed=0, no_progress=SHORT.iterations)
    (ours,) = result.of(MIPSD)
    np.testing.assert_array_equal(ours.x, theirs.x)
    assert ours.best[-1] == pytest.approx(theirs.fun, rel=1e-12)


def test_sixty_iterations_gain_under_both_models_and_in_chatter(result):
    """-14 to -34 % over seeds 0 and 1, steps 13 to 60 % longer; the chatter's own scatter is below 1 %."""
    for condition in (MIPSD, STANDARD, CHATTER):
        (search,) = result.of(condition)
        assert search.gain < -0.08
        assert search.longer > 0.05
        np.testing.assert_allclose(search.cost, search.best[search.at], rtol=1e-12)
        assert (np.diff(search.best) <= 0.0).all()


def test_a_gain_survives_a_finer_step(result):
    """A quarter of the step changes a cost by 1 % (order one), and that of the planned gait alike."""
    for condition in (MIPSD, STANDARD):
        own, finer = (result.gains(condition, str(condition) + which)[0] for which in ("", ", reference"))
        assert abs(own - finer) < 0.03


def test_noise_makes_the_search_believe_what_is_not_so(result):
    """The least of 60 noisy costs is about 2.3 sigma too low where the costs are alike: 34 % with the paper's noise."""
    for condition, least in ((MIPSD_NOISY, 0.03), (STANDARD_NOISY, 0.1)):
        (search,) = result.of(condition)
        assert search.best[-1] < (1.0 - least) * search.cost[-1]
        clean = result.of(MIPSD if condition.gearbox == "mipsd" else STANDARD)[0]
        assert search.cost[-1] > clean.cost[-1]


def test_noise_depends_on_the_gait_and_a_search_resumes(planned, tmp_path):
    whole = replace(SHORT, iterations=24, folder=str(tmp_path / "whole"))
    half = replace(whole, iterations=12, folder=str(tmp_path / "halves"))
    gait_optimization._search(half, planned, STANDARD_NOISY, 3)
    resumed = gait_optimization._search(replace(half, iterations=24), planned, STANDARD_NOISY, 3)
    np.testing.assert_array_equal(gait_optimization._search(whole, planned, STANDARD_NOISY, 3).best, resumed.best)
    files = [sorted((tmp_path / name).iterdir()) for name in ("whole", "halves")]
    assert [path.name for path in files[0]] == [path.name for path in files[1]]
    assert files[0][0].read_bytes().splitlines()[1:] == files[1][0].read_bytes().splitlines()[1:]


def test_conditions_differ_in_what_they_say(planned):
    assert cost_of(planned, CHATTER).scene.integrator == "simtwo"
    assert cost_of(planned, STANDARD).scene.gearbox == "standard"
    assert len({str(condition) for condition in CONDITIONS}) == len(CONDITIONS)
    chatter = cost_of(planned, CHATTER)
    x = chatter.gait.to_vector()
    assert not np.isfinite(chatter.measure([x] * 3)[0].cost)  # refused: it chatters
    assert np.isfinite(measure(chatter, [x] * 3)).all()  # taken as it is


def test_convergence_by_definition():
    best = np.array([100.0, 60.0, 52.0, 51.0, 50.4, 50.0, 50.0])
    search = GaitSearch(MIPSD, 0, best, np.array([0, 6]), best[[0, 6]], np.ones(2), np.zeros(40))
    expected = dict(zip(DEFINITIONS, (4, 2, 4, 2, 5)))
    assert {name: search.converged(name) for name in DEFINITIONS} == expected
    assert search.gain == -0.5


def test_claims_and_figures(result):
    claims = {claim.claim: claim for claim in check(result)}
    assert len(claims) == 7
    (signs,) = (claim for text, claim in claims.items() if "less energy" in text)
    assert signs.verdict == "reproduced"
    (slow,) = (claim for text, claim in claims.items() if "800 iterations" in text)
    assert slow.verdict == "undecided"  # 60 iterations are still gaining
    assert "--full" in slow.why
    for figure in plot(result).values():
        figure.draw_without_rendering()
