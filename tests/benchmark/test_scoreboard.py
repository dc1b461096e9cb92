"""The scoreboard: what an error costs, what is kept, what is missing, and engines that agree on where they end."""

import math
from pathlib import Path

import pytest

from featherstone_gait.base.files import read_csv
from featherstone_gait.benchmark import creep, linkages, methods, scenes, scoreboard
from featherstone_gait.benchmark.costs import Point, cheapest, cost_at, steady
from featherstone_gait.benchmark.engines import quick_mujoco
from featherstone_gait.benchmark.methods import ENGINES, Method, Result
from featherstone_gait.benchmark.scoreboard import Comparison, Line, Row, front, lines_of
from featherstone_gait.benchmark.table import TABLE
from featherstone_gait.cli.benchmark import PICTURES

STORED = Path(__file__).parents[2] / "docs" / "reproduction" / "benchmarks"


# --- costs -------------------------------------------------------------------------------------------------------


def points(errors, times, method="method"):
    return [Point("scene", method, 10.0**-k, error, time) for k, (error, time) in enumerate(zip(errors, times))]


def test_cost_is_interpolated_along_a_power_law():
    line = points([1e-2, 1e-4, 1e-6], [1.0, 10.0, 100.0])
    assert cost_at(1e-3, line) == pytest.approx(math.sqrt(10.0))
    assert cost_at(1e-4, line) == 10.0
    assert cost_at(1.0, line) == 1.0
    assert cost_at(1e-7, line) == math.inf


def test_nothing_is_interpolated_where_a_step_becomes_stable():
    assert cost_at(1e-3, points([0.4, 1e-9], [1.0, 2.0])) == 2.0


def test_a_lucky_step_counts_for_nothing():
    assert [p.error for p in steady(points([1e-9, 1e-2, 1e-3, math.nan], [1.0] * 4))] == [math.inf] * 4
    assert [p.error for p in steady(points([1e-9, 1e-2, 1e-3], [1.0] * 3))] == [1e-3, 1e-2, 1e-2]


def test_the_cheapest_method_at_an_error_and_none():
    both = points([1e-2, 1e-6], [1.0, 5.0], "a") + points([1e-3], [2.0], "b")
    assert cheapest(1e-3, both, "scene") == (2.0, "b")
    assert cheapest(1e-6, both, "scene") == (5.0, "a")
    assert cheapest(1e-9, both, "scene") == (math.inf, "none")
    assert cheapest(1e-3, both, "another scene") == (math.inf, "none")


def test_a_picture_shows_what_nothing_else_beats():
    both = points([1e-2, 1e-4], [1.0, 4.0], "a") + points([1e-3, 1e-5], [5.0, 6.0], "b")
    assert [(p.error, p.time) for p in front(both)] == [(1e-2, 1.0), (1e-4, 4.0), (1e-5, 6.0)]


# --- what is measured, kept and missing --------------------------------------------------------------------------


def toy(name, calls, error=1e-4, seconds=1.0, interrupted=False):
    """A case in which ours and MuJoCo have one setting each."""

    def once(engine):
        calls.append((name, engine))
        if interrupted:
            raise KeyboardInterrupt
        return Result(error if engine == "ours" else 10.0 * error, seconds)

    def made():
        for engine in ("ours", "MuJoCo"):
            yield Method(engine, "a method", (1e-3,), lambda _, engine=engine: lambda: once(engine))

    asked, lacks = (1e-2, 1e-4, 1e-6), {"Bullet": "cannot state it"}
    return Comparison("creep", name, "m", "simulated second", 2.0, asked, made, lacks)


@pytest.fixture
def board(monkeypatch, tmp_path):
    """Run the scoreboard with cases of the test's own."""

    def run(cases, **how):
        monkeypatch.setattr(scoreboard, "tests", lambda: iter(cases))
        return scoreboard.run(tmp_path, **how)

    monkeypatch.setattr(scoreboard, "machine", lambda: "a machine\nits versions")
    return run


def test_rows_state_time_by_ours_and_what_is_missing(board, monkeypatch, tmp_path):
    monkeypatch.setattr(scoreboard, "installed", lambda module: module not in ("pydrake", "mujoco"))
    lines = board([toy("one", [])])
    rows = {row.engine: row for row in scoreboard.kept(tmp_path / "scoreboard.csv", _host())["one"]}
    assert rows["ours"].time == rows["MuJoCo"].time == 500.0  # ms by simulated second
    assert rows["MuJoCo"].time_ratio == 1.0
    assert rows["Drake"].note == "not installed: pip install drake"
    assert rows["Bullet"].note == "cannot state it"
    assert rows["Pinocchio"].note == "not tried"
    assert [(line.mujoco, line.better) for line in lines[:2]] == [(1.0, ""), (math.inf, "")]
    assert math.isinf(lines[2].ours)
    assert math.isinf(lines[2].mujoco)
    assert math.isnan(lines[0].drake)


def _host():
    return "a machine\nits versions" + "".join(
        f", {methods.WHEELS[name]} {methods.release(name)}" for name in ("Bullet", "Drake") if methods.release(name)
    )


def test_what_another_engine_does_faster_is_said():
    row = Row("creep", "one", "ours", "", "a", 1e-3, 1e-3, "m", 5.0, "simulated second", math.nan, "")
    other = row._replace(engine="MuJoCo", error=1e-5, time=2.0)
    (coarse, fine, _) = lines_of(toy("one", []), [row, other])
    assert (coarse.mujoco, coarse.better) == (0.4, "MuJoCo")
    assert (fine.mujoco, fine.better) == (0.0, "MuJoCo")  # ours never has this error
    assert scoreboard.with_ratios([row, other])[1].time_ratio == 0.0


def test_a_resumed_run_keeps_finished_cases_of_the_same_machine(board, monkeypatch):
    calls = []
    with pytest.raises(KeyboardInterrupt):
        board([toy("one", calls), toy("two", calls, interrupted=True)])
    calls.clear()
    lines = board([toy("one", calls), toy("two", calls)], resume=True)
    assert {name for name, _ in calls} == {"two"}
    assert [line.case for line in lines] == ["one"] * 3 + ["two"] * 3
    monkeypatch.setattr(scoreboard, "machine", lambda: "another machine\nits versions")
    board([toy("one", calls), toy("two", calls)], resume=True)
    assert {name for name, _ in calls} == {"one", "two"}


def test_one_part_is_measured_and_others_are_kept(board):
    calls = []
    cases = [toy("one", calls), toy("two", calls)._replace(part="first")]
    board(cases)
    calls.clear()
    assert len(board(cases, only="first")) == 6
    assert {name for name, _ in calls} == {"two"}
    with pytest.raises(ValueError, match="only='frist': expected one of creep, first"):
        board(cases, only="frist")


# --- what is stored ----------------------------------------------------------------------------------------------


def stored(name, kind):
    return [dict(zip(kind._fields, cells)) for _, cells in list(read_csv(STORED / name, TABLE))[1:]]


def test_every_engine_has_a_row_of_every_case_or_says_why_not():
    rows = stored("scoreboard.csv", Row)
    cases = [test.name for test in scoreboard.tests()]
    assert list(dict.fromkeys(row["case"] for row in rows)) == cases
    for name in cases:
        of = {engine: [row for row in rows if (row["case"], row["engine"]) == (name, engine)] for engine in ENGINES}
        assert all(rows and (rows[0]["time"] or rows[0]["note"]) for rows in of.values()), name
    assert {row["engine"] for row in rows if row["version"]} == set(ENGINES)


def test_the_stored_lines_are_those_of_the_stored_rows():
    rows = scoreboard.rows_of(STORED / "scoreboard.csv")
    lines = [line for test in scoreboard.tests() for line in lines_of(test, rows[test.name])]
    found = stored("scoreboard_lines.csv", Line)
    assert [line.better for line in lines] == [line["better"] for line in found]
    for line, of in zip(lines, found, strict=True):
        for name in ("ours", "mujoco", "pinocchio", "bullet", "drake"):
            assert getattr(line, name) == pytest.approx(float(of[name] or "nan"), rel=1e-12, nan_ok=True)


# --- physics -----------------------------------------------------------------------------------------------------

CASES = {
    "A01": scenes.pendulum, "A02": lambda: linkages.parallelograms(2), "A03": linkages.squeezer,
    "A04": linkages.bricard, "A05": scenes.governor, "free arm": scenes.free_arm,
    "stiff arm": lambda: scenes.stiff_arm("standard"), "arm with rotors": lambda: scenes.stiff_arm("rotor"),
}  # fmt: skip
# Methods that reach the reference: a setting, and an error that it keeps.
ACCURATE = {
    "A01": {"RK4": (1e-2, 1e-6), "SciPy DOP853": (1e-9, 1e-8), "runge_kutta5": (1e-8, 1e-4)},
    "A02": {"RK4": (1e-3, 1e-3), "SciPy DOP853": (1e-9, 1e-4)},
    "A03": {"RK4": (2e-5, 1e-5), "SciPy DOP853": (1e-9, 1e-8)},
    "A04": {"RK4": (1e-3, 1e-6), "SciPy DOP853": (1e-9, 1e-9)},
    "A05": {"RK4": (2e-4, 1e-9), "SciPy Radau": (1e-5, 1e-5), "radau3": (1e-4, 1e-3)},
    "free arm": {"RK4": (1e-4, 1e-8), "SciPy LSODA": (1e-11, 1e-8), "runge_kutta5": (1e-8, 1e-4)},
    "stiff arm": {"RK4, position": (1e-4, 1e-9), "SciPy LSODA": (1e-11, 1e-9), "radau3": (1e-4, 1e-5)},
    "arm with rotors": {"RK4, position": (1e-3, 1e-9), "SciPy DOP853": (1e-9, 1e-9), "radau3": (1e-4, 1e-4)},
}
FIRST_ORDER = "semi-implicit Euler", "discrete, SAP", "Euler", "Euler, position"


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_engines_agree_on_where_it_ends(name):
    """Each states the same mechanism: those of high order reach the reference, the others come nearer with the step."""
    pytest.importorskip("mujoco")
    pytest.importorskip("pinocchio")
    with quick_mujoco():
        for method in methods.methods(CASES[name](), ()):
            if method.name in ACCURATE[name]:
                setting, error = ACCURATE[name][method.name]
                assert method.ready(setting)().error < error, method
            elif method.name in FIRST_ORDER and name != "free arm":
                h = 1e-4 if name in ("A03", "A05", "stiff arm") else 2e-3  # from which on explicit steps are stable
                coarse, fine = (method.ready(step)().error for step in (h, 0.5 * h))
                assert fine < 0.7 * coarse, method


def test_bullet_lacks_springs_and_rotors():
    assert methods.cannot("Bullet", scenes.governor()) == "no spring between two points"
    assert methods.cannot("Bullet", scenes.stiff_arm("rotor")) == "no rotor inertia"
    assert not methods.cannot("MuJoCo", scenes.governor())


@pytest.mark.long
@pytest.mark.parametrize("what", ["box", "joint"])
def test_friction_holds_here_and_too_little_does_not(what, monkeypatch):
    """In ten minutes; with a third of the friction the box slides at 0.95 m/s^2, and the link falls until it hangs."""
    (ours,) = (m for m in creep.methods(what) if m.name == "midpoint")
    assert ours.ready(1e-2)().error < 1e-9
    monkeypatch.setattr(creep, "FRICTION", creep.FRICTION / 3.0)
    monkeypatch.setattr(creep, "HOLDING", creep.HOLDING / 3.0)
    monkeypatch.setattr(creep, "DURATION", 3.0)
    monkeypatch.setattr(creep, "SETTLED", 0.05)
    for method in creep.methods(what):
        assert method.ready(method.settings[0])().error > 0.1, method


def test_the_command_lists_the_pictures_that_are_drawn():
    assert scoreboard.PLOTTED == PICTURES
