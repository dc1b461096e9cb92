"""The scatter that a solver's random order makes: what is worked out, kept and read again."""

import math
from dataclasses import replace

import numpy as np
import pytest

from featherstone_gait.optimize import walking_cost
from featherstone_gait.reproduction import solver_scatter
from featherstone_gait.reproduction.solver_scatter import QUICK, Scatter, SolverCase
from featherstone_gait.robot_file import load_robot

SMALL = replace(QUICK, runs=3, map_runs=2, steps=(2e-3,), iterations=(10,), masses=(1.0,), strides=1)


@pytest.fixture(scope="module")
def planned():
    return walking_cost(load_robot("humanoid", locked="simplified"))


def test_runs_of_one_gait_differ_by_their_seeds_alone(planned):
    energies, row = solver_scatter.walk(SMALL, planned, SolverCase(step=2e-3), 3)
    again, _ = solver_scatter.walk(SMALL, planned, SolverCase(step=2e-3), 2, seed=1)
    assert np.array_equal(energies[1:], again, equal_nan=True)
    assert row.cycle > 1e-4
    assert row.cycle == row.repeat == row.run  # of a single stride
    sound = energies[np.isfinite(energies)]
    assert row.cycle == pytest.approx(sound.std(ddof=1) / sound.mean())


@pytest.mark.long
def test_a_map_goes_on_where_it_was(planned, tmp_path):
    path = tmp_path / "map.csv"
    whole = solver_scatter.work_out(SMALL, path, planned=planned)
    text = path.read_text("utf-8")
    solver_scatter.write_map(path, whole[:1])
    assert solver_scatter.work_out(SMALL, path, planned=planned) == whole
    assert path.read_text("utf-8") == text
    assert solver_scatter.work_out(SMALL, path) == whole  # nothing is left to walk
    path.write_text("a,b\n1,2\n", "utf-8")
    with pytest.raises(ValueError, match="its columns are a, b"):
        solver_scatter.read_map(path)


def row(gearbox, cycle, step=1e-3):
    return Scatter(gearbox, step, 10, 1.0, 40, 0, 3.0, 0.2, cycle, cycle, cycle / 2)


def test_settings_are_judged_by_both_figures():
    rows = [row("standard", 0.15), row("mipsd", 0.04), row("standard", 0.15, 2e-3), row("mipsd", 0.1, 2e-3)]
    both = solver_scatter.pairs(rows)
    assert len(both) == 2
    assert [solver_scatter.distance_to_paper(pair) < math.log(1.3) for pair in both] == [True, False]
    assert solver_scatter.near(0.1462 * 1.29, 0.1462)
    assert not solver_scatter.near(0.1462 / 1.31, 0.1462)
