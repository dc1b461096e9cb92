"""The main job: from a plan to a cheaper gait and all its files."""

import csv
import json
import math
import re
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib import image
from pages import data_of

from featherstone_gait import cli, load_robot, load_servo
from featherstone_gait.crosscheck import FLOORS
from featherstone_gait.optimize import (
    OptimizeOptions,
    baselines,
    main_job,
    measure,
    optimize_gait,
    preparation,
    summary,
    walking_cost,
)
from featherstone_gait.optimize.gait_page import candidate_numbers, write_gait_page
from featherstone_gait.optimize.planning import default_states
from featherstone_gait.optimize.quality import measure_in_test_worlds
from featherstone_gait.robot_file.servos import with_servo
from featherstone_gait.search import minimize
from featherstone_gait.walking import BIOLOID_WALK, Feedback, bounds, read_angles
from featherstone_gait.walking.cost import cost_of_motion
from featherstone_gait.walking.gait_file import angles_of_goal_positions
from featherstone_gait.walking.motion import servo_of

ITERATIONS = 12


@pytest.fixture(scope="module")
def cost():
    return walking_cost(load_robot("humanoid", locked="simplified"))


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    folder = tmp_path_factory.mktemp("job")
    return folder, main_job(
        options=OptimizeOptions(
            iterations=ITERATIONS, states="stride", worlds=0, test_worlds=2, out=folder, progress=False
        )
    )


def test_the_job_finds_a_cheaper_gait_and_reports_both(job):
    _, report = job
    before, after = report["before"], report["after"]
    assert before["status"] == after["status"] == "ok"
    assert after["cost"] < before["cost"]
    for side in (before, after):
        assert side["cost"] == pytest.approx(side["energy"] / side["distance"], rel=1e-12)
        assert side["cost_of_transport"] == pytest.approx(side["cost"] / side["weight"], rel=1e-12)
        assert side["at_a_quarter_of_the_step"]["cost"] == pytest.approx(side["cost"], rel=0.05)
        assert 0.5 < side["safe"] <= 1.0


def test_the_report_is_the_json_file_and_names_every_file(job):
    folder, report = job
    assert json.loads((folder / "humanoid_gait.json").read_text("utf-8")) == report
    assert sorted(report["files"].values()) == sorted(str(path) for path in folder.iterdir())
    assert report["format"].startswith("featherstone_gait gait report 2,")
    assert report["settings"]["iterations"] == ITERATIONS
    assert report["search"]["candidates"] == ITERATIONS
    assert report["evaluations"]["begun"] == ITERATIONS + 1 + report["evaluations"]["wasted"]


def test_the_arrays_hold_the_gait_whose_cost_is_reported(job, cost):
    folder, report = job
    with np.load(folder / "humanoid_gait.npz") as data:
        assert cost(data["x"]) == (report["after"]["cost"], "ok")
        assert np.array_equal(data["first"], cost.gait.to_vector())
        assert str(data["format"]).startswith("featherstone_gait gait arrays 2,")
        assert data["costs"].shape == (ITERATIONS + 1,)
        assert data["costs"].min() == report["after"]["cost"]


def test_the_csv_can_be_simulated_and_costs_the_same(job, cost):
    folder, report = job
    start = report["settings"]["start_of_measurement"]
    path = folder / "humanoid_gait_angles.csv"
    strides = round((read_angles(path)[0][-1] - start) / cost.gait.period)
    found = cost_of_motion(cost.scene, path, start=start, strides=strides)
    assert found.cost == pytest.approx(report["after"]["cost"], rel=0.02)  # two strides more are measured


def test_the_goal_positions_are_the_angles_to_half_a_count(job, cost):
    folder, _ = job
    times, angles, names = read_angles(folder / "humanoid_gait_angles.csv", cost.gait.joint_names)
    with (folder / "humanoid_gait_goal_positions.csv").open(newline="") as file:
        rows = list(csv.reader(line for line in file if not line.startswith("#")))
    assert rows[0] == ["time_s", *names]
    counts = np.array(rows[1:], dtype=float)
    assert counts[:, 0] == pytest.approx(times)
    assert np.abs(angles_of_goal_positions(counts[:, 1:]) - angles).max() <= math.radians(0.5 * 300 / 1023) * 1.001


def test_the_pictures_show_something(job):
    folder, _ = job
    for name in ("convergence", "angles"):
        picture = image.imread(folder / f"humanoid_gait_{name}.png")
        assert picture.shape[0] > 400
        assert np.ptp(picture[..., :3]) > 0.9


def test_the_animation_needs_nothing_from_the_network_and_moves(job):
    folder, report = job
    page = (folder / "humanoid_gait_animation.html").read_text("utf-8")
    assert len(page) < 3e6
    assert re.findall(r"https?:|//[a-z]|<link|@import|src=", page) == []
    data = data_of(page)
    assert [run["caption"].split(":")[0] for run in data["runs"]] == ["first gait", "optimized gait"]
    run = data["runs"][0]
    first, last = (data["unit"] * frame[7 * run["root"]] for frame in (run["frames"][0], run["frames"][-1]))
    assert last - first > 10 * report["before"]["stride_length"]


def parts_of_page(page):
    """Rows of tables by the title of their section, all texts, and charts by their kind."""
    sections = data_of(page)["report"]["sections"]
    tables = {s["title"]: [row for part in s["parts"] if "rows" in part for row in part["rows"]] for s in sections}
    parts = [part for section in sections for part in section["parts"]]
    texts = [part["text"] for part in parts if "text" in part]
    return tables, texts, {part["chart"]: part for part in parts if "chart" in part}


def test_the_page_needs_nothing_from_the_network_and_says_what_the_report_says(job):
    folder, report = job
    page = (folder / "humanoid_gait_report.html").read_text("utf-8")
    assert len(page) < 3e5
    assert re.findall(r"https?:|//[a-z]|<link|@import|src=|url\(", page) == []
    assert "prefers-color-scheme: dark" in page
    assert "@media print" in page
    tables, texts, charts = parts_of_page(page)
    costs = tables["The gait found"][0]
    assert costs[1:] == [f"{report['baselines'][k]['cost']:.1f}" for k in (0, 1)] + [f"{report['after']['cost']:.1f}"]
    limits = report["plausible"]["after"]["limits"]
    asked = tables["Limits of a real robot"]
    assert [row[0]["text"] == one["what"] for row, one in zip(asked, limits)] == [True] * 6
    assert ["not met" not in row[2]["mark"] for row in asked] == [one["kept"] for one in limits]
    assert any("Not run" in text for text in texts)
    assert len(charts["search"]["best"]) == ITERATIONS + 1
    assert charts["search"]["at"] == [*range(ITERATIONS + 1)]
    links = {row[1]["link"] for row in tables["Files"]}
    assert all((folder / link).is_file() for link in links)
    assert len(links) == len(report["files"]) - 1  # the page itself


def test_the_page_names_floors_falls_and_what_is_not_known(job, tmp_path):
    _, report = job
    row = {"floor": "2ms_0.9", "soles": "boxes", "mujoco": None, "own": 31.25}
    after = report["plausible"]["after"]["limits"][0] | {"value": None, "time": None}
    changed = report | {
        "crosscheck": "in MuJoCo it walks 20 strides on 0 of 1 floors", "crosscheck_floors": [row], "elsewhere": None,
        "search": report["search"] | {"with_limits_from": 2},
        "at_equal_speed": [{"baseline": "<plan>", "cost": 80.0, "speed": 0.1, "found": None, "gain": None}],
        "plausible": report["plausible"] | {"after": {"limits": [after], "current": None}},
        "feedback": {"gains": asdict(Feedback(ankle=4.25)), "pushes": {"with": [0.75] * 8, "without": [0.5] * 8}},
    }  # fmt: skip
    write_gait_page(tmp_path / "page.html", changed, np.array([80.0, math.inf, 70.0]))
    tables, texts, charts = parts_of_page((tmp_path / "page.html").read_text("utf-8"))
    ((_, falls, walks),) = tables["In MuJoCo"]
    assert (falls["mark"], walks) == (["bad", "falls"], "31.2")
    assert any("0 of 1 floors" in text for text in texts)
    assert tables["At equal speed"][0][::2] == ["<plan>", "none in the search"]
    assert "Currents of the servos" not in tables
    assert (charts["search"]["since"], charts["search"]["costs"]) == (2, [80.0, None, 70.0])
    assert charts["search"]["at"] == [0.0, 1.0, 1.0]

    assert "0.75 N s with feedback, 0.5 without" in summary(changed | {"elsewhere": report["elsewhere"]})
    space = "\N{NO-BREAK SPACE}"
    pushes = tables["Pushes with and without feedback"]
    assert ["mean", f"0.50{space}N{space}s", f"0.75{space}N{space}s"] in pushes
    (ankle,) = (row for row in pushes if row[1] == "4.25")
    assert (ankle[0]["text"], ankle[0]["small"]) == ("ankle of the stance leg, per error ahead", "rad/m")


def test_steps_with_limits_reach_the_number_of_all_candidates():
    """The axis counts all candidates: 401 gaits, then a start and 16 steps of 24 candidates."""
    numbers = candidate_numbers(np.ones(401 + 17), 401, 400 + 16 * 24)
    assert numbers[[0, 400, 401, 402, -1]].tolist() == [0, 400, 400, 424, 784]


def test_gains_are_told_at_equal_speed_and_with_standing_power_too(job):
    _, report = job
    first, second = report["at_equal_speed"]
    assert first["baseline"] == "plain plan"
    assert first["found"]["speed"] == pytest.approx(report["before"]["speed"], rel=0.05)
    assert first["gain"] == pytest.approx(1.0 - first["found"]["cost"] / report["before"]["cost"])
    assert second["speed"] > first["speed"]
    standby = report["standby"]
    assert standby["watts"]["electronics of the servos that walk"] == pytest.approx(10 * 0.05 * 10.0)
    assert standby["watts"]["electronics of the locked servos"] == pytest.approx(9 * 0.05 * 10.0)
    side = report["after"]
    assert standby["after"]["motors"] == side["cost"]
    assert standby["after"]["electronics of the locked servos"] == pytest.approx(
        (side["energy"] + 9.5 * side["duration"]) / side["distance"]
    )


def test_power_below_zero_is_refused_before_the_search(capsys, tmp_path):
    assert cli.main(["optimize", "--electronics-power", "-1", "--out", str(tmp_path)]) == 2
    assert "electronics" in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == []


def test_the_servo_is_told_and_the_paper_s_by_default(job):
    _, report = job
    assert report["settings"]["servo"] == "ax12"
    assert "with_own_servos" not in report
    assert summary(report).startswith("servo ax12, poses of a stride, one floor\n")


@pytest.mark.long
def test_another_servo_is_compared_with_the_robot_s_own(job, tmp_path, capsys):
    """The corrected AX-12 spends more than twice as much on the same gait, and still walks."""
    other = main_job(
        options=OptimizeOptions(servo="ax12a", iterations=4, states="stride", worlds=0, test_worlds=0, out=tmp_path)
    )
    own = other["with_own_servos"]
    assert other["settings"]["servo"] == servo_of(tmp_path / "humanoid_gait.npz") == "ax12a"
    assert servo_of(job[0] / "humanoid_gait.npz") is None
    assert own["servo"] == "ax12"
    assert own["cost"] == job[1]["before"]["cost"]
    assert 2.0 * own["cost"] < other["before"]["cost"] < 4.0 * own["cost"]
    printed = " ".join(capsys.readouterr().out.split())  # long lines are folded
    assert "servo ax12a, " in printed
    assert f"with the robot's own, ax12: {own['cost']:.1f} J/m" in printed


def test_a_gait_s_file_names_the_servo_and_what_is_exported_has_it(tmp_path):
    gait = tmp_path / "gait.npz"
    with np.load(Path(load_robot("humanoid").source).with_name("optimized_gait.npz")) as data:
        arrays = {name: data[name] for name in data.files if name != "servo"}
    np.savez(gait, **arrays)
    assert servo_of(gait) is None
    assert cli.main(["export", str(gait), "--mjcf", "--out", str(tmp_path)]) == 0
    own = (tmp_path / "gait.xml").read_text("utf-8")
    np.savez(gait, **arrays, servo="ax12a")
    assert servo_of(gait) == "ax12a"
    assert servo_of(tmp_path / "gait_angles.csv") is None
    assert cli.main(["export", str(gait), "--mjcf", "--out", str(tmp_path)]) == 0
    found = (tmp_path / "gait.xml").read_text("utf-8")
    assert found != own
    assert cli.main(["export", str(gait), "--mjcf", "--servo", "ax12", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "gait.xml").read_text("utf-8") == own


def test_a_servo_of_a_file_is_kept_by_its_place_and_one_that_is_gone_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert measure.servo_in_file("mine.toml") == str(tmp_path / "mine.toml")
    assert [measure.servo_in_file(name) for name in (None, "ax12a", "generic:4")] == ["", "ax12a", "generic:4"]
    with np.load(Path(load_robot("humanoid").source).with_name("optimized_gait.npz")) as data:
        arrays = {name: data[name] for name in data.files if name != "servo"}
    np.savez("gait.npz", **arrays, servo=str(tmp_path / "gone.toml"))
    assert cli.main(["export", "gait.npz", "--csv", "--strides", "2"]) == 0
    capsys.readouterr()
    assert cli.main(["export", "gait.npz", "--mjcf"]) == 2
    assert cli.main(["crosscheck", "gait.npz"]) == 2
    told = capsys.readouterr().err
    assert told.count("gait.npz was found with a servo that is not there") == 2
    assert "--servo" in told
    np.savez("gait.npz", **arrays, servo=np.array(["ax12", "ax12a"]))
    with pytest.raises(ValueError, match=r"gait\.npz: servo is array"):
        servo_of("gait.npz")


def test_a_servo_goes_into_all_joints_that_turn(tmp_path):
    robot = load_robot("humanoid")
    (tmp_path / "mine.toml").write_text('law = "pd"\nKp = 3.0\n')
    for servo in ("mx64", tmp_path / "mine.toml"):
        found = with_servo(robot, servo)
        assert set(found.servos) >= set(robot.servos)
        assert set(found.servos.values()) == {load_servo(servo)}
        assert robot.servos["left_knee"] == load_servo("ax12")


@pytest.mark.long
def test_an_interrupted_job_resumes_to_the_same_gait(job, tmp_path):
    folder, report = job
    main_job(
        options=OptimizeOptions(
            iterations=ITERATIONS // 2, states="stride", worlds=0, test_worlds=2, out=tmp_path, progress=False
        )
    )
    history = tmp_path / "humanoid_gait_history.jsonl"
    with history.open("a", encoding="utf-8") as file:
        file.write('{"iteration": 7, "x": [0.1')  # cut off while writing
    resumed = main_job(
        options=OptimizeOptions(
            iterations=ITERATIONS, states="stride", worlds=0, test_worlds=2, out=tmp_path, resume=True, progress=False
        )
    )
    assert resumed["after"] == report["after"]
    angles = "humanoid_gait_angles.csv"
    assert (tmp_path / angles).read_bytes() == (folder / angles).read_bytes()


def test_what_is_found_is_tried_in_worlds_that_no_search_has_seen(job, cost):
    _, report = job
    reported = report["elsewhere"]["after"]
    assert (reported["worlds"], reported["strides"]) == (2, 20)
    assert reported["walks"] in (0.0, 0.5, 1.0)
    again = measure_in_test_worlds(cost, [cost.gait.to_vector()], 2)[0]
    assert again == report["elsewhere"]["before"]
    assert again["cost"] == sorted(again["cost"])


def test_stored_baselines_serve_the_humanoid_s_first_gait_and_no_other(cost):
    first = walking_cost(load_robot("humanoid", locked="simplified"), states="step")
    stored = baselines.stored_baselines(first.measure([first.gait.to_vector()])[0])
    assert [*stored] == [*baselines.BASELINES, baselines.CHEAPEST]
    assert not baselines.stored_baselines(cost.measure([cost.gait.to_vector()])[0])
    for count in (200, 0):
        rows = baselines.measure_baselines(first, "plain", count, False, True, stored)
        assert [row["cost"] for row in rows] == [row["cost"] for row in stored.values()]
        worlds = [row["elsewhere"] and row["elsewhere"]["worlds"] for row in rows]
        assert worlds == [None, *[min(count, 50) or None] * 2]


@pytest.mark.long
@pytest.mark.parametrize("servo", baselines.SERVOS)
def test_stored_baselines_are_what_is_measured_today(servo):
    kept = json.loads(baselines.FILE.read_text())["servos"][servo or "own"]
    assert json.loads(json.dumps(baselines.stored_anew(servo))) == kept


def test_the_poses_are_those_of_a_step_where_the_legs_mirror_each_other():
    model = load_robot("humanoid", locked="simplified")
    assert default_states(model) == "step"
    joints = tuple(replace(j, name="knee" if j.name == "left_knee" else j.name) for j in model.joints)
    servos = {"knee" if name == "left_knee" else name: servo for name, servo in model.servos.items()}
    assert default_states(replace(model, joints=joints, servos=servos, keyframes={})) == "stride"


def test_the_time_is_estimated_from_the_first_gait_of_other_servos(tmp_path, capsys):
    """A walk with friction that knows load takes longer; that of the humanoid's own servo is known."""
    for servo, told in ((None, False), ("ax12", False), ("ax12a", True), ("generic", True)):
        preparation.prepare("humanoid", OptimizeOptions(servo=servo, out=tmp_path))
        printed = " ".join(capsys.readouterr().out.split())
        assert ("estimated from the first gait" in printed) == told
        assert bool(re.search(r"about \d+ s on two cores", printed)) == (not told)


def test_one_floor_or_several_is_not_both(capsys, tmp_path):
    assert cli.main(["optimize", "--one-world", "--worlds", "3", "--out", str(tmp_path)]) == 2
    assert "give one of them" in capsys.readouterr().err


def test_a_history_is_not_overwritten(job, capsys):
    folder, _ = job
    before = (folder / "humanoid_gait_history.jsonl").read_bytes()
    assert cli.main(["optimize", "--iterations", "1", "--out", str(folder)]) == 2
    assert "resume (--resume)" in capsys.readouterr().err
    assert (folder / "humanoid_gait_history.jsonl").read_bytes() == before


def test_a_history_in_which_the_first_gait_costs_something_else_is_not_continued(job, tmp_path, capsys):
    folder, report = job
    history = (folder / "humanoid_gait_history.jsonl").read_text("utf-8")
    cost = repr(report["before"]["cost"])
    assert history.count(cost) == 1
    (tmp_path / "humanoid_gait_history.jsonl").write_text(history.replace(cost, "12.5"), "utf-8")
    assert cli.main(["optimize", "--one-world", "--iterations", "30", "--resume", "--out", str(tmp_path)]) == 2
    assert "line 2: the first gait cost 12.5 J/m" in capsys.readouterr().err


@pytest.mark.long
def test_the_command_shows_progress_and_a_table(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)  # bars are for terminals
    options = ["--iterations", "2", "--worlds", "2", "--test-worlds", "3", "--no-baselines", "--out", str(tmp_path)]
    assert cli.main(["optimize", *options]) == 0
    shown = capsys.readouterr()
    shares = [int(share) for share in re.findall(r"(\d+)%", shown.err)]  # of the whole job
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0, 100)
    for part in ("first gait", "search", "selection", "measurement", "files", "left", "best="):
        assert part in shown.err
    assert re.search(r"^in 2 worlds: (\d+\.\d J/m|does not walk in every world)$", shown.out, re.M)
    assert re.search(r"^walks in 3 other worlds +\d+\.\d +\d+\.\d", shown.out, re.M)
    assert re.search(r"^\d+ evaluations begun, \d+ of them wasted by .*; lanes [\d.]+ % occupied", shown.out, re.M)
    words = " ".join(shown.out.split())  # it is filled to 80 columns
    assert re.search(r"crosscheck: not run; .* is not known \(optimize --crosscheck\)", words)
    for name in ("energy per distance", "cost of transport", "step length", "speed", "slip"):
        assert re.search(rf"^{name}.* \d+\.\d+ +\d+\.\d+", shown.out, re.MULTILINE)


def test_the_result_depends_on_the_seed_alone(cost):
    results = [optimize_gait(cost, iterations=8, seed=seed) for seed in (1, 1, 2)]
    assert np.array_equal(results[0].x, results[1].x)
    assert results[0].fun == results[1].fun
    assert not np.array_equal(results[0].history["x"], results[2].history["x"])


def test_lanes_that_run_ahead_find_what_one_candidate_at_a_time_finds(cost):
    """Also where candidates fall: with 10 degrees most do."""
    ahead = optimize_gait(cost, iterations=9, amplitude=math.radians(10.0))
    one = minimize(
        cost, cost.gait.to_vector(), amplitude=math.radians(10.0), max_iterations=9,
        bounds=bounds(cost.scene.model, cost.gait),
    )  # fmt: skip
    assert np.array_equal(ahead.history["x"], one.history["x"])
    assert np.array_equal(ahead.history["f"], one.history["f"])
    assert np.isinf(one.history["f"]).any()
    assert 0.0 < ahead.occupancy <= 1.0
    assert ahead.nfev == 10 + ahead.wasted


def test_every_candidate_keeps_to_the_joint_limits(cost):
    result = optimize_gait(cost, iterations=16, amplitude=1.0)
    poses = result.history["x"].reshape(17, 4, 10)
    joints = cost.scene.model.moving_joints
    assert (poses >= [joint.lower for joint in joints]).all()
    assert (poses <= [joint.upper for joint in joints]).all()


def test_a_job_in_which_nothing_walks_says_why(tmp_path, monkeypatch):
    monkeypatch.setitem(BIOLOID_WALK, "step_time", 0.24)
    with pytest.raises(ValueError, match=r"none of 1 gaits walked; the first: humanoid fell at"):
        main_job(
            options=OptimizeOptions(
                plan="plain", iterations=1, states="stride", worlds=1, test_worlds=0, out=tmp_path, progress=False
            )
        )


@pytest.mark.long
def test_servos_too_slow_for_any_plan_end_the_job_before_a_search(tmp_path):
    """Five times the torque at a fifth of the speed."""
    servo = (Path(load_robot("humanoid").source).parents[1] / "servos" / "ax12.toml").read_text("utf-8")
    assert servo.count("motor_constant = 0.00681 ") == 1
    slow = tmp_path / "slow.toml"
    slow.write_text(servo.replace("motor_constant = 0.00681 ", "motor_constant = 0.03405 "), "utf-8")
    with pytest.raises(ValueError, match=r"joints are too slow to walk.* rad/s is xc330"):
        main_job(options=OptimizeOptions(servo=slow, out=tmp_path / "out"))
    assert [*(tmp_path / "out").iterdir()] == []


def test_a_robot_without_two_soles_is_refused(tmp_path):
    with pytest.raises(ValueError, match="ground without contact points"):
        main_job("arm7", OptimizeOptions(out=tmp_path, progress=False))


@pytest.mark.long
def test_the_first_gait_is_measured_with_own_servos_whose_gears_are_rigid(cost):
    """Though the servos of the search have elastic ones."""
    own = with_servo(cost.scene.model, "xm430")
    assert cost.scene.gearbox == "mipsd"
    found = measure.measure_with_own_servos(own, cost)
    assert found["servo"] == "xm430"
    known = replace(cost, scene=cost.scene.recompiled(own, gearbox="rotor"))
    assert found["status"] == known.measure([cost.gait.to_vector()])[0].status


@pytest.mark.long
def test_the_job_walks_its_gait_in_mujoco_if_asked(tmp_path, monkeypatch, capsys):
    """On two floors here: the twelve take minutes."""
    for name in [*FLOORS]:
        if name not in ("10ms_0.9", "20ms_0.9"):
            monkeypatch.delitem(FLOORS, name)
    report = main_job(
        options=OptimizeOptions(iterations=1, states="stride", worlds=0, test_worlds=0, out=tmp_path, crosscheck=1)
    )
    assert report["crosscheck"].startswith("in MuJoCo it walks 20 strides on 4 of 4 floors")
    assert f"crosscheck: {report['crosscheck']}" in " ".join(capsys.readouterr().out.split())
    assert sorted(report["files"].values()) == sorted(str(path) for path in tmp_path.iterdir())


@pytest.mark.long
@pytest.mark.parametrize(
    ("error", "said"), [(ValueError("no floor"), "not run: no floor"), (KeyboardInterrupt(), "interrupted; ")]
)
def test_a_crosscheck_that_fails_does_not_cost_the_search(tmp_path, monkeypatch, error, said):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(measure, "crosscheck", fail)
    few = dict(iterations=1, states="stride", worlds=0, test_worlds=0)
    report = main_job(options=OptimizeOptions(**few, out=tmp_path, progress=False, crosscheck=1))
    assert report["crosscheck"].startswith(said)
    assert (tmp_path / "humanoid_gait.npz").exists()
