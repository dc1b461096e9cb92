"""Files say what they are: those of version 0.1 load as they did, those of a newer version are refused."""

import json
import math
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

from featherstone_gait import Trajectory, __version__, load_robot
from featherstone_gait.base.files import Format, read_csv, write_csv
from featherstone_gait.benchmark import precision
from featherstone_gait.identification import Recording, read_recording, write_recording
from featherstone_gait.search import minimize
from featherstone_gait.study import read_study, run_study
from featherstone_gait.walking import read_angles, read_motion, write_angles, write_goal_positions

OLD = Path(__file__).parents[1] / "files_0_1"  # written by version 0.1
RUN = Trajectory({"time": np.zeros(1)}, "ok", "", 0.5, np.zeros(3), parts={"q": (0, 2), "qd": (2, 3)})
TIMES, ANGLES = 0.04 * np.arange(4), np.array([[0.1, -0.2], [0.3, 1 / 3], [0.0, 0.25], [math.pi / 7, -1.0]])
TIME = 0.01 * np.arange(12)
RECORDING = Recording("recording", TIME, 0 * TIME + 0.5, np.sin(TIME) / 3, 0 * TIME + 1.5)
ROW = precision.Row("free arm", "rk4", 1e-3, math.nan, 1e-5 / 3, math.nan, 1e-12, 3.4, 3.5, 4000, "ok")
SEARCH = dict(amplitude=0.3, max_iterations=8, seed=7)
STUDY = 'robot = "ax12_arm"\nexperiment = "hold"\nduration = 0.1\n[vary]\nservo.Kp = [20.0, 61.0]\n'


def sphere(x):
    return float((x**2).sum())


def stated(kind, number=2):
    return f"featherstone_gait {kind} {number}, written by version {__version__}"


def newer(path):
    """Let a file say that it is of the next format, of version 9.8."""
    text = path.read_text("utf-8")
    assert text.count(f" 2, written by version {__version__}") == 1
    path.write_text(text.replace(f" 2, written by version {__version__}", " 3, written by version 9.8"), "utf-8")


def refused(path, kind):
    said = rf"{path.name}: its format is {kind} 3; version {__version__} of featherstone_gait reads {kind} 1 to 2: "
    return pytest.raises(ValueError, match=said + "read it with version 9.8, which wrote it, or a later one")


# ---------------------------------------------------------------------------------------------- version 0.1


def test_an_old_trajectory_loads():
    run = Trajectory.load(OLD / "run")
    angles = "0x1.999999999999ap-4 0x1.a70ef438e7f37p-4 0x1.07a56bb267f72p-3 0x1.59700210882bap-3 0x1.b8e79ebf87c0fp-3"
    assert run["q"][:, 0].tolist() == [*map(float.fromhex, angles.split()), float.fromhex("0x1.107c5cfc535aep-2")]
    assert {name: values.shape for name, values in run.items()} == {
        "time": (6,), "q": (6, 1), "qd": (6, 1), "torque": (6, 1), "energy": (6, 1, 8)
    }  # fmt: skip
    assert (len(run.final), run.final[0], run.final[-1]) == (33, run["q"][-1, 0], 0.05)
    assert run.error["q"][-1, 0] == float.fromhex("0x1.0d4bc3c7d3400p-10")
    assert (run.status, run.end_time, run.info["joints"]) == ("ok", 0.05, ["elbow"])
    assert run.parts is None


def test_old_angles_load():
    times, angles, names = read_angles(OLD / "angles.csv")
    assert (times.tolist(), names) == ([0.0, 0.04, 0.08, 0.12], ("hip", "knee"))
    assert np.array_equal(angles, np.radians(np.degrees(ANGLES)))


def test_an_old_recording_loads():
    recording = read_recording(OLD / "recording.csv")
    for name in ("time", "reference", "angle", "voltage"):
        assert np.array_equal(getattr(recording, name), getattr(RECORDING, name))


def test_an_old_benchmark_table_loads():
    assert repr(precision.read(OLD / "precision.csv")) == repr([ROW])


def test_an_old_search_goes_on(tmp_path):
    path = copytree(OLD, tmp_path / "old") / "history.jsonl"
    old = path.read_text()
    found = minimize(sphere, np.ones(2), history=path, resume=True, **SEARCH | {"max_iterations": 12})
    assert path.read_text().startswith(old)
    whole = minimize(sphere, np.ones(2), **SEARCH | {"max_iterations": 12})
    assert np.array_equal(found.history["x"], whole.history["x"])


def test_an_old_study_of_the_same_program_goes_on(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    study = read_study(tmp_path / "study.toml")
    table = run_study(study, tmp_path).table.read_bytes()
    log = tmp_path / "study.jsonl"
    header, *lines = log.read_text().splitlines()
    content = json.loads(header)
    assert content.pop("format") == stated("study log")
    log.write_text("\n".join([json.dumps(content), *lines, ""]))
    outcome = run_study(study, tmp_path)
    assert (outcome.computed, outcome.table.read_bytes()) == (0, table)


def test_the_log_of_an_old_study_is_not_mixed_with_the_runs_of_another_program(tmp_path):
    path = copytree(OLD, tmp_path / "old") / "study.toml"
    with pytest.raises(ValueError, match=r"vary\.servo\.ratio is not a parameter"):
        read_study(path)
    path.write_text(path.read_text("utf-8").replace("servo.ratio", "gearbox.ratio"), "utf-8")
    study = read_study(path)
    old = (tmp_path / "old" / "study.jsonl").read_bytes()
    with pytest.raises(ValueError, match=r"study\.jsonl: was begun with .*delete the file to begin anew"):
        run_study(study, tmp_path / "old")
    assert (tmp_path / "old" / "study.jsonl").read_bytes() == old


def test_an_old_gait_opens():
    names = load_robot("humanoid", locked="simplified").joint_names
    motion = read_motion(OLD / "gait.npz", names)
    with np.load(OLD / "gait.npz") as data:
        assert np.array_equal(motion.poses, data["poses"])
        walked = np.concatenate([motion.start, motion.stride])
        assert np.allclose(walked, data["angles"][: len(walked)], rtol=0, atol=1e-12)
    assert (motion.joint_names, motion.poses.shape, motion.tick) == (names, (4, 10), 0.04)


def test_an_old_robot_loads_as_the_one_that_was_saved():
    old, now = load_robot(OLD / "arm.urdf"), load_robot("ax12_arm")
    servo = replace(now.servos["elbow"], stick_speed=0.0)  # which 0.1 did not write: its friction creeped everywhere
    assert (old.links, old.joints, old.servos, old.base) == (now.links, now.joints, {"elbow": servo}, now.base)


# ---------------------------------------------------------------------------------------------- formats


def test_a_trajectory_states_its_format_and_the_parts_of_its_state(tmp_path):
    RUN.save(tmp_path / "run")
    assert json.loads((tmp_path / "run.json").read_text())["format"] == stated("trajectory")
    with np.load(tmp_path / "run.npz") as data:
        assert data["format"] == stated("trajectory")
    assert Trajectory.load(tmp_path / "run").parts == {"q": (0, 2), "qd": (2, 3)}
    newer(tmp_path / "run.json")
    with refused(tmp_path / "run.json", "trajectory"):
        Trajectory.load(tmp_path / "run")


@pytest.mark.parametrize(
    ("kind", "write", "read"),
    [
        ("joint angles", lambda path: write_angles(path, TIMES, ANGLES, ("hip", "knee")), read_angles),
        ("recording", lambda path: write_recording(path, RECORDING), read_recording),
        ("benchmark table", lambda path: precision.write(path, [ROW], "processor\nversions"), precision.read),
    ],
)
def test_a_table_states_its_format_over_its_header(tmp_path, kind, write, read):
    path = tmp_path / "table.csv"
    write(path)
    first, *rest = path.read_text("utf-8").splitlines()
    assert first == f"# {stated(kind)}"
    old = {"joint angles": "angles", "recording": "recording", "benchmark table": "precision"}[kind]
    assert rest == (OLD / f"{old}.csv").read_text("utf-8").splitlines()  # nothing else has changed
    read(path)
    newer(path)
    with refused(path, kind):
        read(path)


def test_goal_positions_are_not_taken_for_angles(tmp_path):
    write_goal_positions(tmp_path / "goals.csv", TIMES, ANGLES, ("hip", "knee"))
    with pytest.raises(ValueError, match=r"goals\.csv: its format is .*goal positions 2.*; expected .* joint angles"):
        read_angles(tmp_path / "goals.csv")


def test_a_study_states_the_format_of_its_log_and_table(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    study = read_study(tmp_path / "study.toml")
    outcome = run_study(study, tmp_path)
    assert outcome.table.read_text("utf-8").startswith(f"# {stated('study table')}\nrun,servo.Kp,status,")
    newer(tmp_path / "study.jsonl")
    with refused(tmp_path / "study.jsonl", "study log"):
        run_study(study, tmp_path)


def test_a_newer_history_is_refused(tmp_path):
    path = copytree(OLD, tmp_path / "old") / "history.jsonl"
    path.write_text(path.read_text().replace('"version": 1', '"version": 2'))
    with pytest.raises(ValueError, match=r"history\.jsonl, line 1: the history's format is 2, .* reads 1 to 1; resume"):
        minimize(sphere, np.ones(2), history=path, resume=True, **SEARCH)


def test_lines_are_counted_with_the_comments_and_a_spreadsheet_may_have_saved_the_file(tmp_path):
    path = tmp_path / "table.csv"
    write_csv(path, Format("thing"), ["a", "b"], [[1, 2.5], [3, "x\ny"]], "one\ntwo")
    assert list(read_csv(path, Format("thing"))) == [(4, ["a", "b"]), (5, ["1", "2.5"]), (7, ["3", "x\ny"])]
    saved = path.read_text("utf-8").replace(f"version {__version__}\n", f"version {__version__},,\n")
    path.write_text(saved, "utf-8-sig")
    assert next(read_csv(path, Format("thing"))) == (4, ["a", "b"])
    newer(path)
    with refused(path, "thing"):
        next(read_csv(path, Format("thing")))


@pytest.mark.parametrize("wrong", ["trajectory 2", 7, "featherstone_gait trajectory two, written by version 0.2.0"])
def test_a_format_that_is_none_is_refused(wrong):
    with pytest.raises(ValueError, match=r"run\.json: its format is .*; expected featherstone_gait trajectory"):
        Format("trajectory").check("run.json", wrong)
