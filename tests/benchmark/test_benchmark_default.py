"""The judge of what is simulated where nothing is named."""

import math
import signal
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from test_cli import SLIDER

from featherstone_gait import compile_scene, load_robot
from featherstone_gait.benchmark import case as truth
from featherstone_gait.benchmark import default, default_scenes, default_several, pair_scenes
from featherstone_gait.benchmark.case import Worker, at_most
from featherstone_gait.benchmark.robots import published
from featherstone_gait.benchmark.scenes import ball
from featherstone_gait.model.placed import Placed


class Here:
    """Calls in this process."""

    def __init__(self):
        self.calls = 0

    def call(self, function, *args):
        self.calls += 1
        return function(*args)


def endless():
    with at_most(0.2):
        while True:
            pass


@pytest.fixture(scope="module")
def wheel():
    return truth.case_of("wheel", "free bodies", compile_scene(default_scenes.wheel()), 0.5, None, [20.0])


@pytest.mark.parametrize(
    ("error", "right", "verdict"),
    [(9e-4, True, "held"), (9e-4, False, "alarm"), (2e-3, True, "silent"), (2e-3, False, "flagged")],
)
def test_a_run_is_judged_by_its_error_and_by_what_it_says(error, right, verdict):
    assert default.verdict_of(error, right, 1e-3) == verdict


@pytest.mark.parametrize(
    ("status", "reference", "right"),
    [("ok", "ok", True), ("fell", "fell", True), ("fell", "ok", False), ("ok", "fell", False),
     ("step too small", "step too small", False), ("ok", "step too small", True)],
)  # fmt: skip
def test_only_a_fall_is_right_beside_ok(status, reference, right):
    nothing = np.zeros((0, 0))
    assert default.is_right(status, truth.Truth(nothing, nothing, reference, 0, 0.0)) is right


def test_a_wheel_turns_evenly_in_its_reference_and_in_its_run(wheel, monkeypatch, tmp_path):
    monkeypatch.setattr(default, "NAMED", ())
    exact = truth.truth(wheel, Here(), tmp_path)
    assert np.allclose(exact.q[:, 0], 20.0 * wheel.every * np.arange(51), rtol=0, atol=1e-9)
    assert exact.known == 51
    row, named = default.judged(wheel, exact, Here())
    assert (row.verdict, row.status, row.until, named) == ("held", "ok", pytest.approx(0.5), [])
    assert row.error < 1e-9
    assert row.speed_error < 1e-9
    assert row.mujoco_error < 1e-9 or math.isnan(row.mujoco_time)


def test_a_reference_is_worked_out_once_and_anew_if_its_file_is_damaged(wheel, tmp_path):
    worker = Here()
    first = truth.truth(wheel, worker, tmp_path)
    assert worker.calls == 2
    truth.truth(wheel, worker, tmp_path)
    assert worker.calls == 2
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:100])
    again = truth.truth(wheel, worker, tmp_path)
    assert worker.calls == 4
    assert np.array_equal(again.q, first.q)
    assert np.array_equal(again.qd, first.qd)


def test_a_reference_depends_on_the_scene_and_not_on_the_integrator_that_is_chosen(wheel):
    other = wheel.scene.recompiled(integrator="midpoint", timestep=1e-3)
    assert truth.digest(wheel._replace(scene=other, record_interval=wheel.every)) == truth.digest(wheel)
    changed = [
        wheel._replace(duration=0.6),
        wheel._replace(state=wheel.state + 1e-9),
        wheel._replace(scene=wheel.scene.recompiled(gravity=(0.0, 0.0, -1.0))),
        wheel._replace(scene=replace(wheel.scene, model=replace(wheel.scene.model, name="other"))),
    ]
    assert len({truth.digest(case) for case in [wheel, *changed]}) == 5


def test_distances_are_of_turn_place_and_joints():
    scene = compile_scene(load_robot("humanoid", locked="simplified"))
    exact = np.zeros((4, scene.model.nq))
    exact[:, 3] = 1.0
    q = exact.copy()
    q[0, 3:7] *= -1.0  # the same attitude
    q[1, 3:7] = math.cos(1.5), math.sin(1.5), 0.0, 0.0
    q[2, :2] = 0.3, 0.4
    q[3, 9] = -0.2
    assert truth.distances(scene, q, exact) == pytest.approx([0.0, 3.0, 0.5, 0.2])


def test_distances_are_those_of_the_base_that_is_farthest_off():
    scene = compile_scene([Placed(load_robot("arm7"), "arm"), Placed(ball(), "ball"), Placed(ball(), "other")])
    exact = np.zeros((3, 21 + 7))
    exact[:, 3:21:7] = 1.0
    q = exact.copy()
    q[0, [7, 15]] = 0.3, 0.2
    q[1, 17:21] = math.cos(0.5), 0.0, math.sin(0.5), 0.0
    q[2, 24] = 0.1
    assert truth.distances(scene, q, exact) == pytest.approx([0.3, 1.0, 0.1])


@pytest.mark.long
def test_bodies_that_touch_are_judged_by_the_places_of_all(tmp_path):
    case = next(pair_scenes.collisions())
    row, _ = default.judged(case, truth.truth(case, Here(), tmp_path), Here())
    assert (row.verdict, row.status) == ("held", "ok")
    assert 1e-9 < row.error < 1e-3


@pytest.mark.long
def test_a_third_of_the_scenes_that_touch_are_of_others():
    for name in ("pybullet_data", "dm_control", "gymnasium"):
        pytest.importorskip(name)
    skipped = []
    kinds = [case.kind for case in pair_scenes.pair_cases(skipped)]
    assert skipped == []
    assert len(kinds) >= 60
    assert 3 * kinds.count(pair_scenes.OTHERS) >= len(kinds)


def test_errors_count_only_while_the_reference_is_known(wheel):
    q = np.zeros((51, 1))
    exact = truth.Truth(q, np.ones((51, 1)), "ok", 11, 0.0)
    late, early = q.copy(), q.copy()
    late[11], early[10] = 1.0, 0.25
    for positions, error in ((late, 0.0), (early, 0.25)):
        outcome = default.Outcome(
            positions, 1.5 * np.ones((51, 1)), "ok", 0.5, np.full(51, 0.1), np.zeros((51, 2)), 1.0
        )
        assert default.errors(wheel, exact, outcome) == pytest.approx((error, 0.5, 0.1))


def test_errors_are_held_against_those_that_the_run_states_less_those_of_the_reference(wheel):
    q, stated = np.zeros((51, 1)), np.tile([0.2, 0.5], (51, 1))
    exact = truth.Truth(q, np.zeros((51, 1)), "ok", 11, 0.01, 0.1)
    turned, turning = q.copy(), q.copy()
    turned[5], turned[20], turning[:] = 0.11, 9.0, 1.1
    outcome = default.Outcome(turned, turning, "ok", 0.5, stated[:, 0], stated, 1.0)
    assert default.held(wheel, exact, outcome) == pytest.approx({"q": 0.5, "qd": 2.0, "within": 0.5})
    assert default.held(wheel, exact, outcome._replace(stated=np.full((51, 1), math.nan))) == {}


def test_a_run_is_within_what_it_states_if_all_its_channels_are():
    row = default.Row("a", "arms", 1.0, 1.0, "ars343", 1e-3, "ok", "held", 1e-5, 1e-5, 1e-5, 1.0, 2.0, math.nan, 1.0)
    one = row._replace(q=0.5, qd=2.0, within=0.5)
    several = row._replace(bodies=2, base_q=0.1, q=0.5, base_qd=0.2, qd=0.9, within=1.0)
    doubtful = several._replace(status="inaccurate", base_q=9.0)
    text = [line.split()[3:] for line in default.coverage([one, several, doubtful, row])[1:]]
    assert text == [["1", "-", "100%", "-", "0%", "0%", "50%"], ["1", *["100%"] * 6]]


@pytest.mark.long
def test_forty_scenes_are_of_several_and_each_comes_with_all_seeds():
    pytest.importorskip("mujoco")
    found = list(default_scenes.cases(only="company"))
    names = [case.name.rpartition(", seed ")[0] for case in found if len(case.scene.members) > 1]
    assert len(set(names)) >= 40
    assert {names.count(name) for name in names} == {default_several.SEEDS}
    assert len({truth.digest(case) for case in found}) == len(found)


@pytest.mark.long
def test_balls_that_lose_nothing_keep_momentum_and_energy_in_the_reference(tmp_path):
    for seed in range(2):
        cases = default_several.objects(np.random.default_rng(seed))
        case = next(case for case in cases if case.name == "two balls meet, lossless")
        exact = truth.truth(case, Here(), tmp_path)
        assert exact.known == len(exact.q)
        masses = np.array([member.model.links[0].mass for member in case.scene.members])
        before, after = (exact.qd[k].reshape(2, 6)[:, 0] for k in (0, -1))
        assert masses @ after == pytest.approx(masses @ before, abs=1e-7)
        assert after[1] - after[0] == pytest.approx(before[0] - before[1], abs=1e-6)


def test_a_group_of_scenes_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="no group of scenes 'people'; there are servos, bodies, company"):
        next(default_scenes.cases(only="people"))


@pytest.mark.long
@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="there is no clock that ends a process")
def test_a_call_that_takes_too_long_ends_alone():
    with closing(Worker()) as worker:
        assert worker.call(endless) is None
        assert worker.call(math.sqrt, 4.0) == 2.0


def test_robots_that_move_alike_count_once_and_others_are_named(tmp_path):
    for name in ("a", "b"):
        (tmp_path / f"{name}.urdf").write_text(SLIDER)
    (tmp_path / "broken.urdf").write_text("<robot")
    refused = []
    assert [name for name, _ in published([tmp_path], refused)] == [f"{tmp_path.name}/a"]
    assert len(refused) == 1
    assert "broken" in refused[0]


def test_summary_tells_shares_of_all_and_of_each_kind():
    row = default.Row("a", "arms", 1.0, 1.0, "midpoint", 1e-3, "ok", "held", 1e-5, 1e-5, 1e-5, 1.0, 2.0, math.nan, 1.0)
    rows = [row, row._replace(case="b", kind="legs", verdict="silent", error=0.5)]
    text = default.summary(rows)
    assert [line.split()[0] for line in text[1:4]] == ["arms", "legs", "all"]
    assert text[3].split()[1:7] == ["2", "100%", "50%", "0%", "50%", "0%"]
    assert text[3].split()[-3:] == ["50%", "100%", "2.00"]  # error < 10 estimate, estimate < 100 error, cost
    assert "b: 0.5" in text[-1]


def test_the_picture_has_a_point_for_each_run():
    row = default.Row("a", "arms", 1.0, 1.0, "midpoint", 1e-3, "ok", "held", 1e-5, 1e-5, 1e-5, 1.0, 2.0, math.nan, 1.0)
    left, right = default.plot([row, row._replace(verdict="silent", error=0.5)]).axes
    for axes in (left, right):
        assert sorted(y for line in axes.lines if line.get_marker() == "o" for y in line.get_ydata()) == [1e-5, 0.5]


def test_a_reference_that_takes_too_long_is_tried_again_only_if_it_may_take_longer(wheel, monkeypatch, tmp_path):
    class Impatient(Here):
        def call(self, function, *args):
            self.calls += 1

    worker = Impatient()
    tried = []
    for limit in (1.0, 1.0, 2.0):
        monkeypatch.setattr(truth, "LIMIT", limit)
        assert truth.truth(wheel, worker, tmp_path) is None
        tried.append(worker.calls)
    assert tried == [2, 2, 4]  # both methods
