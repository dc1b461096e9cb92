"""Parameter studies: what is read, what is drawn from it, and a table that nothing can change or spoil."""

import contextlib
import csv
import json
import math
import os
import random
import re
import resource
import subprocess
import sys
import tempfile
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib import image

from featherstone_gait import (
    Distribution,
    Ground,
    Reference,
    Worlds,
    cli,
    compile_scene,
    initial_state,
    load_robot,
    load_servo,
    simulate,
    standing_state,
)
from featherstone_gait.model import Supply
from featherstone_gait.run.lane_constants import numbers_in
from featherstone_gait.study import measures, read_study, run_study
from featherstone_gait.study.measures import run_batch
from featherstone_gait.study.plot import _figure
from featherstone_gait.study.settings import servos_with
from featherstone_gait.walking.cost import RECORD, SAMPLE, measured
from featherstone_gait.walking.motion import read_motion

ROOT = Path(__file__).parents[2]
ARM = 'robot = "ax12_arm"\nexperiment = "hold"\nduration = 0.5\n'
GRID = ARM + "[vary]\nservo.Kp = [20.0, 61.0, 100.0]\nposture.tilt = {from = -0.1, to = 0.1, count = 5}\n"
DRAWN = ARM + '[sampling]\nmethod = "{}"\ncount = {}\nseed = {}\n'
DRAWN += '[vary]\nservo.Kp = {{from = 1.0, to = 100.0, scale = "log"}}\n'
UNITS = ARM + "[sampling]\nmethod = 'random'\ncount = 9\n[worlds]\nlinks.mass = {kind = 'uniform', scale = 0.1}\n"
UNITS += (
    "servos.Kp = {kind = 'normal', scale = 0.1, shared = true}\nreference.offset = {kind = 'uniform', scale = 0.03}\n"
)
WALK = 'robot = "humanoid"\nlocked = "simplified"\nexperiment = "walk"\nstrides = 1\nwarm_up = 1\n'
LARGE = ARM.replace("0.5", "4.0") + "[vary]\nservo.Kp = {from = 20.0, to = 80.0, count = 100}\n"
LARGE += "posture.tilt = {from = -0.2, to = 0.2, count = 40}\n"  # 4000 runs, some seconds


def written(folder, text, name="study"):
    path = folder / f"{name}.toml"
    path.write_text(text, "utf-8")
    return path


def read(folder, text, name="study"):
    return read_study(written(folder, text, name))


def table(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def refused(folder, text, *words):
    with pytest.raises(ValueError, match=r"study\.toml: ") as caught:
        read(folder, text)
    assert [word for word in words if word not in str(caught.value)] == []


# ---------------------------------------------------------------------------------------------- reading


def test_a_grid_has_every_combination_once_and_neighbors_share_a_scene(tmp_path):
    text = ARM + "[vary]\nposture.tilt = [0.0, 0.1]\nservo.Kp = [20.0, 61.0]\nscene.timestep = [0.001, 0.002]\n"
    study = read(tmp_path, text)
    assert study.setup.names[-1] == "posture.tilt"
    points = [study.values(run) for run in range(len(study))]
    assert len(set(points)) == len(points) == 8
    assert [point[2] for point in points] == [0.0, 0.1] * 4


def test_a_range_of_a_grid_is_evenly_spaced_on_its_scale(tmp_path):
    text = ARM + '[vary]\nservo.Kp = {from = 1.0, to = 1000.0, count = 4, scale = "log"}\n'
    study = read(tmp_path, text)
    assert [study.values(run)[0] for run in range(4)] == [1.0, 10.0, 100.0, 1000.0]


def test_a_latin_hypercube_has_one_run_in_every_layer_and_log_uniform_is_uniform_in_the_logarithm(tmp_path):
    study = read(tmp_path, DRAWN.format("latin_hypercube", 100, 5))
    layers = [math.floor(50.0 * math.log10(study.values(run)[0])) for run in range(100)]
    assert sorted(layers) == list(range(100))


def test_numbers_of_gears_go_by_the_section_that_has_them(tmp_path):
    text = GRID.replace("servo.Kp = [20.0, 61.0, 100.0]", "gearbox.ratio = [254.0, 127.0]\ngearbox.backlash = [0.0]")
    study = read(tmp_path, text)
    assert study.setup.names[:2] == ("gearbox.ratio", "gearbox.backlash")
    with pytest.raises(ValueError, match=r"vary\.servo\.ratio is not a parameter"):
        read(tmp_path, text.replace("gearbox.ratio", "servo.ratio"))
    with pytest.raises(ValueError, match="ratio"):
        read(tmp_path, GRID + "[gearbox]\nratio = -1.0\n")


def test_random_runs_depend_on_the_seed_alone(tmp_path):
    drawn = [read(tmp_path, DRAWN.format("random", 50, seed)) for seed in (1, 1, 2)]
    points = [[study.values(run) for run in range(50)] for study in drawn]
    assert points[0] == points[1] != points[2]
    assert [study.setup.digest == drawn[0].setup.digest for study in drawn] == [True, True, False]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("robot = ", ["not a TOML file"]),
        (GRID.replace("ax12_arm", "arm8"), ["arm8", "ax12_arm"]),
        (GRID.replace("duration", "length"), ["length", "duration"]),
        (GRID.replace("0.5", "-0.5"), ["duration is -0.5", "give seconds"]),
        (GRID.replace("0.5", '"0.5"'), ["duration is '0.5'", "give seconds"]),
        (GRID.replace('"hold"', '"run"'), ["experiment is 'run'", "'hold'", "'walk'"]),
        (GRID.replace('"hold"', '"walk"'), ["duration", "walk"]),
        (ARM, ["vary is empty"]),
        (GRID.replace("servo.Kp", "servo.kp"), ["vary.servo.kp", "servo.Kp"]),
        (GRID.replace("servo.Kp", "motor.Kp"), ["unknown key 'motor'", "servo"]),
        (GRID.replace("servo.Kp", "links.mass"), ["links", "[worlds]", "robot"]),
        (GRID.replace("posture.tilt", "gait.period"), ["gait.period", "hold"]),
        (GRID.replace('"hold"', '"stable_step"').replace("servo.Kp", "scene.timestep"), ["timestep", "stable_step"]),
        (GRID.replace("20.0", "-20.0"), ["vary.servo.Kp = -20.0", ">= 0", "V/rad"]),
        (GRID.replace("20.0", '"20"'), ["servo.Kp is '20'", "number [V/rad]"]),
        (GRID.replace("20.0", "nan"), ["servo.Kp is nan", "number"]),
        (GRID.replace("20.0", "61.0"), ["every value once"]),
        (GRID.replace("[20.0, 61.0, 100.0]", "[]"), ["servo.Kp is []", "list"]),
        (GRID.replace("count = 5", "number = 5"), ["unknown key 'number'", "count"]),
        (GRID.replace(", count = 5", ""), ["vary.posture.tilt", "count"]),
        (GRID.replace("count = 5", "count = 1"), ["vary.posture.tilt.count is 1", "from 2 to", "give how many values"]),
        (GRID.replace("from = -0.1", "from = 0.2"), ["from 0.2 to 0.1", "rise"]),
        (GRID.replace("count = 5", 'count = 5, scale = "log"'), ["from -0.1 to 0.1", "> 0"]),
        (GRID.replace("servo.Kp", "scene.ground"), ["scene.ground is 20.0", "true, false"]),
        (GRID.replace("servo.Kp", "scene.timestep").replace("20.0", "0.0"), ["scene.timestep = 0.0", "positive"]),
        (GRID.replace("servo.Kp", "scene.integrator"), ["scene.integrator is 20.0", "simtwo"]),
        (GRID + "[servo]\nKp = 61.0\n", ["both in [servo] and in [vary]"]),
        (GRID + "[servo]\ngearbox = 'standard'\n", ["servo.type"]),
        (GRID + "[ground]\nfriction = -1.0\n", ["friction", "-1.0", ">= 0"]),
        (GRID + "[sampling]\nmethod = 'sobol'\n", ["sampling.method is 'sobol'", "latin_hypercube"]),
        (GRID + "[sampling]\ncount = 10\n", ["sampling of a grid", "'count'"]),
        (DRAWN.format("random", 0, 1), ["sampling.count is 0", "from 1 to", "give how many runs"]),
        (DRAWN.format("random", 5, -1), ["sampling.seed is -1", "from 0 to"]),
        (DRAWN.format("random", 10**12, 1), ["sampling.count", "at most"]),
        (GRID.replace("count = 5", "count = 900000000"), ["at most"]),
        (GRID + "[worlds]\nlinks.mass = {kind = 'uniform', scale = 0.1}\n", ["grid", "latin_hypercube"]),
        (UNITS.replace("links.mass", "link.mass"), ["no section 'link'", "links"]),
        (UNITS.replace("links.mass", "links.weight"), ["no number 'weight'", "mass"]),
        (UNITS.replace("links.mass", "links.trunk.mass"), ["no 'trunk'", "use one of"]),
        (UNITS.replace("links.mass", "ground.friction"), ["friction is given", "none"]),
        (UNITS.replace("scale = 0.1", "scale = -0.1"), ["worlds.links.mass", "scale is -0.1"]),
        (UNITS.replace("scale", "wide"), ["worlds.links.mass", "scale = 0.1"]),
        (UNITS.replace("{kind = 'uniform', scale = 0.1}", "0.1"), ["worlds.links.mass is 0.1", "kind"]),
        (UNITS.replace("reference.offset", "reference.delay"), ["worlds.reference.delay", "reference.offset"]),
        (UNITS[: UNITS.index("links.mass")] + "links = {}\n", ["worlds.links is {}", "kind"]),
        (UNITS + "links.mass2 = 1\n", ["worlds.links.mass2 is 1", "kind"]),
        (UNITS.replace("reference.offset", "servos.Kd"), ["worlds.servos.Kd is 0", "additive = true"]),
        (UNITS.replace("links.mass", "servos.period"), ["worlds.servos.period", "vary servo.period"]),
        (UNITS.replace("0.03", "4.0"), ["worlds.reference.offset", "0 to pi"]),
        (
            UNITS.replace("scale = 0.03", "scale = 0.03, additive = false"),
            ["reference.offset", "of kind, scale, shared"],
        ),
        (UNITS.replace("random", "saltelli").replace("9", "16777216"), ["sampling.count 16777216", "at most", "alike"]),
        (UNITS + "links.a.b.c.d.mass = {kind = 'uniform', scale = 0.1}\n", ["worlds.links.a"]),
        (WALK + "[vary]\ngait.file = ['no.npz']\n", ["gait.file is 'no.npz'", "neither in"]),
        (WALK + "[gait]\nfile = 'a.npz'\n[vary]\ngait.period = [0.5]\n", ["gait.file", "gait.period", "one of"]),
    ],
)
def test_what_is_wrong_is_said_with_file_key_value_and_remedy(tmp_path, text, words):
    refused(tmp_path, text, *words)


# ---------------------------------------------------------------------------------------------- running


def test_a_row_is_what_the_simulation_gives(tmp_path):
    """Variance, offset and energy of one run of the table, worked out by hand."""
    text = ARM.replace("ax12_arm", "arm7") + '[scene]\ngearbox = "rotor"\ntimestep = 0.002\n'
    outcome = run_study(read(tmp_path, text + "[vary]\nposture.tilt = [0.01, 0.05]\n"), tmp_path)
    scene = compile_scene(load_robot("arm7"), "rotor", timestep=0.002)
    still = Reference([0.0], np.zeros((1, 7)))
    run = simulate(scene, 0.5, initial_state(scene, np.full(7, 0.05)), still, record=("q", "energy"))
    half = np.degrees(run["q"][len(run["q"]) // 2 :])
    row = table(outcome.table)[1]
    assert (row["run"], row["posture.tilt"], row["status"], row["message"]) == ("1", "0.05", "ok", "")
    assert float(row["variance_deg2"]) == pytest.approx(half.var(axis=0).max(), rel=1e-12)
    assert float(row["offset_deg"]) == np.abs(half).max()
    assert float(row["energy_J"]) == pytest.approx(run["energy"][-1, :, 1].sum(), rel=1e-12)
    assert outcome.statuses == {"ok": 2}


def test_a_source_is_given_or_changed_and_wants_its_voltage(tmp_path):
    text = 'robot = "arm7"\nexperiment = "hold"\n[vary]\n'
    study = read(tmp_path, text + "supply.voltage = [9.0, 11.1]\n[supply]\nresistance = 0.3\n")
    for run, voltage in enumerate((9.0, 11.1)):
        given = dict(zip(study.setup.names, study.values(run)))
        model = servos_with(study.setup.model, {**study.setup.fixed, **given})
        assert model.supply == Supply(voltage, 0.3)
    with pytest.raises(ValueError, match=r"arm7 has no supply to change; add supply\.voltage"):
        read(tmp_path, text + "supply.resistance = [0.1, 0.3]\n", "lacking")
    with pytest.raises(ValueError, match=r"vary\.supply\.voltage = -1\.0: supply: voltage is -1\.0"):
        read(tmp_path, text + "supply.voltage = [-1.0, 9.0]\n", "negative")


@pytest.mark.long
def test_every_parameter_changes_the_scene_it_names(tmp_path):
    """The scene has other numbers or other parts; test_fields_have_effect.py finds that each of these has an effect."""
    text = 'robot = "humanoid"\nlocked = "simplified"\nexperiment = "hold"\nduration = 0.02\n[vary]\n'
    changes = [
        "scene.ground = [true, false]",
        'scene.gearbox = ["mipsd", "rotor"]',
        "ground.friction = [0.9, 0.0]",
        "ground.penetration = [5e-4, 1e-3]",
        "servo.Kp = [61.0, 30.0]",
        "gearbox.ratio = [254.0, 127.0]",
        "servo.voltage_limit = [10.0, 0.1]",
        "supply.voltage = [10.0, 8.0]",
        "supply.resistance = [0.0, 1.0]\n[supply]\nvoltage = 9.0",
        'servo.gearbox = ["physical", "paper_rotor_side"]\nservo.type = ["ax12"]',
    ]
    for k, change in enumerate(changes):
        study = read(tmp_path, text + change, f"study{k}")
        each = [study.setup.fixed | dict(zip(study.setup.names, study.values(run))) for run in range(len(study))]
        scenes = [measures._scene(study.setup, measures._scene_values(values)) for values in each]
        assert len({numbers_in(scene.constants) for scene in scenes}) == len(scenes) == 2, change


@pytest.mark.long
def test_runs_that_fail_or_make_no_scene_are_rows_like_others(tmp_path):
    """The humanoid tips over on a slope of 40 degrees; a step of 3 ms does not fit the controllers' 10 ms."""
    text = 'robot = "humanoid"\nlocked = "simplified"\nexperiment = "hold"\nduration = 2.0\n'
    text += "[vary]\nground.slope = [0.7, 0.0]\nscene.timestep = [0.001, 0.003]\n"
    outcome = run_study(read(tmp_path, text), tmp_path)
    rows = table(outcome.table)
    assert [row["status"] for row in rows] == ["fell", "refused", "ok", "refused"]
    assert rows[0]["variance_deg2"] == rows[1]["variance_deg2"] == ""
    assert "does not divide" in rows[1]["message"]
    assert float(rows[0]["end_s"]) < 2.0
    assert outcome.statuses == {"refused": 2, "fell": 1, "ok": 1}


@pytest.mark.long
def test_a_stable_step_comes_to_rest_and_the_next_larger_one_does_not(tmp_path):
    """Both ends of the interval, run again as `hold`: the second half of the run rests, or chatters from step to step.

    Steps of an interval divide no period, so that each run gets a period of as many of its steps.
    """
    text = ARM.replace("hold", "stable_step").replace("0.5", "2.0")
    text += "[servo]\ninductance = 0.0\nspeed_filter = 0.0\n[scene]\ngearbox = 'standard'\nintegrator = 'simtwo'\n"
    row = table(run_study(read(tmp_path, text + "[vary]\nposture.tilt = [0.05]\n"), tmp_path).table)[0]
    ends = [float(row["stable_step_s"]), float(row["unstable_step_s"])]
    assert ends[0] < ends[1] < 1.04 * ends[0]
    model, variances = load_robot("ax12_arm"), []
    for h in ends:
        period = {"period": round(0.01 / h) * h}
        servo = load_servo("ax12", inductance=0.0, speed_filter=0.0, **period)
        scene = compile_scene(
            replace(model, servos=dict.fromkeys(model.joint_names, servo)), "standard", None, "simtwo", h
        )
        run = simulate(scene, 2.0, initial_state(scene, np.full(1, 0.05)), Reference([0.0], np.zeros((1, 1))))
        variances.append(run["qd"][len(run["qd"]) // 2 :].var())
    assert variances[0] < 1e-6 < 1e-3 < variances[1]


def test_a_walk_has_the_cost_of_its_gait(tmp_path):
    text = WALK + "[gait]\nstep_length = 0.015\nperiod = 0.48\nlift = 0.015\n"
    outcome = run_study(read(tmp_path, text + "[vary]\nground.friction = [0.95, 0.0]\n"), tmp_path)
    normal, ice = table(outcome.table)
    assert normal["status"] == "ok"
    cost, energy, distance = (float(normal[name]) for name in ("cost_J_m", "energy_J", "distance_m"))
    assert cost == pytest.approx(energy / distance, rel=1e-12)
    assert (ice["status"], ice["cost_J_m"]) == ("no cost", "")
    assert ice["message"]


def test_a_unit_is_the_world_that_its_draws_make(tmp_path):
    """Each run has the bits of its scene by `Worlds`, its servo sent what its encoder's zero is off by."""
    study = read(tmp_path, UNITS)
    assert study.names == ("worlds.links.mass", "worlds.servos.Kp", "worlds.reference.offset")
    outcome = run_study(study, tmp_path)
    drawn = [study.values(run) for run in range(len(study))]
    mass, gain, offset = (np.array(each) for each in zip(*drawn))
    model = load_robot("ax12_arm")
    scene = compile_scene(model, "mipsd")
    masses = np.array([link.mass for link in model.links]) * (1.0 + 0.1 * mass)
    (servo,) = model.servos.values()
    worlds = Worlds(links={"mass": masses}, servos={"Kp": servo.controller.Kp * (1.0 + 0.1 * gain)})
    assert masses.std(axis=0).max() > 0.0
    for run, (row, own) in enumerate(zip(table(outcome.table), worlds.scenes(scene))):
        ran = simulate(
            own, 0.5, initial_state(own, [0.01]), Reference([0.0], [0.03 * offset[run]]), estimate_error=False
        )
        q = np.degrees(ran["q"][len(ran["q"]) // 2 :])
        assert float(row["offset_deg"]) == np.abs(q).max()
        assert float(row["worlds.links.mass"]) == pytest.approx(mass[run].mean(), rel=1e-12)


def test_of_normal_draws_so_many_lie_below():
    shares = np.linspace(0.0, 1.0, 1001)
    x = Distribution("normal", 1.0).at(shares)
    assert np.isfinite(x).all()
    assert x[[159, 500, 841]] == pytest.approx([-0.99858, 0.0, 0.99858], abs=1e-5)
    assert Distribution("uniform", 1.0).at(shares) == pytest.approx(2.0 * shares - 1.0)


def test_a_world_that_makes_no_scene_is_refused_alone(tmp_path):
    """Masses drawn so wide that some are negative."""
    outcome = run_study(read(tmp_path, UNITS.replace("'uniform', scale = 0.1", "'normal', scale = 0.9")), tmp_path)
    rows = table(outcome.table)
    assert {"ok", "refused"} <= {row["status"] for row in rows}
    assert all("mass" in row["message"] for row in rows if row["status"] == "refused")


def test_points_without_what_is_drawn_are_refused_alone(tmp_path):
    """Servos of a scene that has none, in a batch with some that have."""
    text = UNITS.replace("count = 9", "count = 6") + "[vary]\nscene.gearbox = ['mipsd', 'none']\n"
    rows = table(run_study(read(tmp_path, text.replace("reference.offset", "servos.resistance")), tmp_path).table)
    assert {row["status"] for row in rows if row["scene.gearbox"] == "mipsd"} == {"ok"}
    assert {row["status"] for row in rows if row["scene.gearbox"] == "none"} == {"refused"}


@pytest.mark.long
def test_gaits_with_feedback_and_without_keep_their_own_in_a_batch(tmp_path):
    text = WALK + "[scene]\nintegrator = 'midpoint'\ntimestep = 0.001\n"
    files = ["optimized_gait.npz", "balanced_gait.npz"]
    study = read(tmp_path, text + f"[vary]\ngait.file = {files}\n")
    points = [study.values(run) for run in (0, 1)]
    alone = [run_batch(study.setup, [point])[0] for point in points]
    assert run_batch(study.setup, points) == alone
    assert run_batch(study.setup, points[::-1]) == alone[::-1]
    units = "[sampling]\nmethod = 'random'\ncount = 4\n[worlds]\nreference.offset = {kind = 'uniform', scale = 0.03}\n"
    refused(tmp_path, text + "[gait]\nfile = 'balanced_gait.npz'\n" + units, "feedback", "remove reference.offset")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="signal 0 asks for a process on POSIX, and ends it on Windows")
def test_processes_of_a_pool_end_with_the_one_that_began_them(tmp_path):
    code = "import os, time\nfrom featherstone_gait.base.processes import process_pool\n"
    code += "if __name__ == '__main__':\n    pool = process_pool(1)\n"
    code += "    print(pool.submit(os.getpid).result(), flush=True)\n"
    script = tmp_path / "main.py"
    script.write_text(code + "    time.sleep(60)\n", "utf-8")
    process = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    worker = int(process.stdout.readline())
    process.kill()
    process.communicate()
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            return
        if Path(f"/proc/{worker}/stat").exists() and ") Z " in Path(f"/proc/{worker}/stat").read_text():
            return  # ended, and whoever adopted it has not asked how
        time.sleep(0.05)
    raise AssertionError("the worker is still there")


@pytest.mark.long
def test_a_gait_from_a_file_costs_what_it_costs_elsewhere_and_zeros_matter(tmp_path):
    text = WALK.replace("strides = 1", "strides = 2") + "[scene]\nintegrator = 'midpoint'\ntimestep = 0.001\n"
    given = text + "[gait]\nfile = 'optimized_gait.npz'\n[vary]\nground.friction = [0.95]\n"
    (row,) = table(run_study(read(tmp_path, given), tmp_path).table)
    model = load_robot("humanoid", locked="simplified")
    motion = read_motion(Path(model.source).parent / "optimized_gait.npz", model.joint_names)
    scene = compile_scene(model, "mipsd", Ground(friction=0.95), "midpoint", 1e-3)
    signal = motion.reference(3)
    state = standing_state(scene, signal.values[0], allow_limit_violation=True)
    run = simulate(scene, motion.begin(3), state, signal, record=RECORD, record_interval=SAMPLE, estimate_error=False)
    own = measured(scene, run, motion.begin(1), motion.begin(3), 2)
    assert (float(row["cost_J_m"]), float(row["walks"])) == (own.cost, 1.0)


@pytest.mark.parametrize("batch", [1, 3, 8, 100])
def test_the_batch_has_no_influence(tmp_path, batch):
    study = read(tmp_path, GRID)
    points = [study.values(run) for run in range(len(study))]
    alone = [run_batch(study.setup, [point])[0] for point in points]
    outcome = run_study(study, tmp_path / str(batch), batch=batch)
    assert [json.loads(line)["status"] for line in lines(outcome)[1:]] == ["ok"] * 15
    rows = {row.pop("run"): row for row in map(json.loads, lines(outcome)[1:])}
    assert [rows[run] for run in range(15)] == alone


def lines(outcome):
    return outcome.table.with_suffix(".jsonl").read_text("ascii").splitlines()


@pytest.mark.quick("*thread*")
@pytest.mark.parametrize("executor", ["1 thread", "2 threads", "2 processes"])
def test_executor_and_order_have_no_influence(tmp_path, executor):
    study = read(tmp_path, GRID)
    alone = run_study(study, tmp_path / "alone", batch=2)
    count = int(executor[0])
    with ThreadPoolExecutor(count) if "thread" in executor else ProcessPoolExecutor(count, spawned()) as pool:
        outcome = run_study(study, tmp_path / "others", executor=pool, batch=2)
    assert alone.computed == outcome.computed == len(study)
    assert outcome.table.read_bytes() == alone.table.read_bytes()


def spawned():
    """Worker processes that inherit no threads."""
    import multiprocessing

    return multiprocessing.get_context("spawn")


def test_workers_that_die_are_an_error_that_says_what_is_kept(tmp_path):
    class Dying(ThreadPoolExecutor):
        """Loses its workers after two batches."""

        left = 2

        def submit(self, *arguments):
            self.left -= 1
            if self.left < 0:
                raise BrokenProcessPool("a worker was killed")
            return super().submit(*arguments)

    study = read(tmp_path, GRID)
    with Dying(1) as pool, pytest.raises(OSError, match=r"15 runs are kept in .*study\.jsonl; start the study again"):
        run_study(study, tmp_path, executor=pool, batch=4)
    assert not (tmp_path / "study.csv").exists()
    assert run_study(study, tmp_path).statuses == {"ok": 15}


@pytest.mark.parametrize("how_often", [1, 2])
def test_a_batch_whose_result_is_lost_is_computed_once_more(tmp_path, how_often):
    class Losing(ThreadPoolExecutor):
        """Loses what comes back of the second batch, some times."""

        asked = None

        def submit(self, function, *inputs):
            future, points = super().submit(function, *inputs), inputs[-1]
            self.asked = [] if self.asked is None else [*self.asked, points]
            if self.asked and points == self.asked[0] and self.asked.count(points) <= how_often:
                future.result()
                lost = Future()
                lost.set_exception(ValueError("too many values to unpack"))
                return lost
            return future

    study = read(tmp_path, GRID)
    expected = run_study(study, tmp_path / "whole").table.read_bytes()
    with Losing(1) as pool:
        if how_often == 1:
            assert run_study(study, tmp_path / "lost", executor=pool, batch=4).table.read_bytes() == expected
        else:
            with pytest.raises(ValueError, match="too many values"):
                run_study(study, tmp_path / "lost", executor=pool, batch=4)
            assert not (tmp_path / "lost" / "study.csv").exists()


# ---------------------------------------------------------------------------------------------- going on


def test_a_log_cut_off_anywhere_leads_to_the_same_table(tmp_path):
    study = read(tmp_path, GRID)
    whole = run_study(study, tmp_path)
    log, expected = whole.table.with_suffix(".jsonl"), whole.table.read_bytes()
    data = log.read_bytes()
    for cut in [0, 1, 200, *random.Random(7).sample(range(len(data)), 5), len(data) - 1]:
        log.write_bytes(data[:cut])
        whole.table.unlink()
        outcome = run_study(study, tmp_path)
        assert outcome.table.read_bytes() == expected
        assert outcome.computed == 15 - max(0, data[:cut].count(b"\n") - 1)


def test_a_finished_study_computes_nothing(tmp_path):
    study = read(tmp_path, GRID)
    assert [run_study(study, tmp_path).computed for _ in range(2)] == [15, 0]


def test_a_log_of_other_settings_and_a_damaged_one_are_refused(tmp_path):
    run_study(read(tmp_path, GRID), tmp_path)
    with pytest.raises(ValueError, match=r"study\.jsonl: was begun with duration = 0\.5, but .* 0\.6; delete the file"):
        run_study(read(tmp_path, GRID.replace("0.5", "0.6")), tmp_path)
    log = tmp_path / "study.jsonl"
    good = log.read_text("ascii").splitlines(keepends=True)
    for bad in ("{]\n", "[]\n", '{"run": 15}\n', '{"status": "ok"}\n'):
        log.write_text("".join([*good[:3], bad, *good[4:]]), "ascii")
        with pytest.raises(ValueError, match=r"study\.jsonl, line 4: damaged; delete this line"):
            run_study(read(tmp_path, GRID), tmp_path)


@pytest.mark.long
def test_killed_at_random_moments_it_comes_to_the_same_table(tmp_path):
    """Twenty real processes end by SIGKILL, wherever they are; each goes on where the one before was."""
    path = written(tmp_path, LARGE)
    expected = run_study(read_study(path), tmp_path / "whole").table.read_bytes()
    log, kept, chance = tmp_path / "study.jsonl", [0], random.Random(11)
    for k in range(20):
        process = started(path, tmp_path)
        if k % 3:  # two of three while runs are being written
            wait_for_growth(log, process)
            time.sleep(chance.uniform(0.0, 0.06))
        else:
            time.sleep(chance.uniform(0.1, 1.2))
        assert process.poll() is None, "the study ended before it could be killed: make it larger"
        process.kill()
        process.wait()
        kept.append(log.read_bytes().count(b"\n") if log.exists() else 0)
    assert kept == sorted(kept)
    assert len(set(kept)) >= 12
    assert kept[-1] <= 4000
    assert not (tmp_path / "study.csv").exists()
    assert started(path, tmp_path).wait() == 0
    assert (tmp_path / "study.csv").read_bytes() == expected
    assert [name for name in os.listdir(tmp_path) if name.startswith(".")] == []


def started(path, folder, **options):
    """A process that runs a study with one thread, eight runs at a time."""
    program = (
        "import sys; from concurrent.futures import ThreadPoolExecutor\n"
        "from featherstone_gait.study import read_study, run_study\n"
        "run_study(read_study(sys.argv[1]), sys.argv[2], executor=ThreadPoolExecutor(1), batch=8)"
    )
    command = [sys.executable, "-c", program, path, folder]
    return subprocess.Popen(command, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}, **options)


def wait_for_growth(log, process):
    size = log.stat().st_size if log.exists() else 0
    while (not log.exists() or log.stat().st_size <= size) and process.poll() is None:
        time.sleep(0.002)


# ---------------------------------------------------------------------------------------------- files


@pytest.mark.long
def test_a_full_disk_is_a_clear_error_with_nothing_half_written(tmp_path):
    """A limit on the size of files stops the log in the middle of a line, as a full disk does."""

    def limited():
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))

    path = written(tmp_path, GRID)
    process = started(path, tmp_path, preexec_fn=limited, stderr=subprocess.PIPE, text=True)
    _, message = process.communicate()
    assert process.returncode == 1
    assert "study.jsonl cannot be written (File too large); what it holds is complete: make room" in message
    assert re.search(r"\d+ of 15 runs are kept in .*study\.jsonl; start the study again to continue", message)
    left = (tmp_path / "study.jsonl").read_bytes()
    assert left.endswith(b"\n")
    assert 1 < left.count(b"\n") < 16
    assert sorted(os.listdir(tmp_path)) == ["study.jsonl", "study.toml"]
    outcome = run_study(read_study(path), tmp_path)
    assert outcome.computed == 16 - left.count(b"\n")
    assert outcome.table.read_bytes() == run_study(read_study(path), tmp_path / "whole").table.read_bytes()


def test_a_folder_that_cannot_be_written_is_an_error_before_anything_runs(tmp_path):
    study = read(tmp_path, GRID)
    with tempfile.TemporaryDirectory() as folder, without_privileges():
        os.chmod(folder, 0o555) if os.geteuid() == os.stat(folder).st_uid else None
        with pytest.raises(PermissionError, match=r"study\.jsonl"):
            run_study(study, folder, executor=ThreadPoolExecutor(1))
        assert os.geteuid() != 0


@contextlib.contextmanager
def without_privileges():
    """Rights of an ordinary user: the superuser may write everywhere."""
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(user)


def test_what_takes_one_value_is_no_axis_of_the_picture(tmp_path):
    """So that a grid of two parameters is a map, whatever else its file states."""
    study = read(tmp_path, GRID + 'scene.gearbox = ["mipsd"]\nservo.Kd = [0.0]\n')
    figure = _figure(study, run_study(study, tmp_path).table)
    drawn, colors = figure.axes
    assert {drawn.get_xlabel(), drawn.get_ylabel()} == {"posture.tilt [rad]", "servo.Kp [V/rad]"}
    assert colors.get_ylabel().startswith("largest variance")


def test_a_table_that_cannot_be_written_leaves_the_earlier_one(tmp_path, monkeypatch):
    study = read(tmp_path, GRID)
    before = run_study(study, tmp_path).table.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match=r"study\.csv: cannot be written \(No space left on device\)"):
        run_study(study, tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["study.csv", "study.jsonl", "study.png", "study.toml"]
    assert (tmp_path / "study.csv").read_bytes() == before


def test_parquet_without_its_libraries_is_refused_before_anything_runs(tmp_path, monkeypatch):
    monkeypatch.setattr("featherstone_gait.study.table.find_spec", lambda name: None)
    with pytest.raises(ValueError, match="Parquet needs pandas and pyarrow: pip install pandas pyarrow"):
        run_study(read(tmp_path, GRID), tmp_path, parquet=True)
    assert os.listdir(tmp_path) == ["study.toml"]


@pytest.mark.parametrize(
    ("vary", "panels"),
    [
        ("servo.Kp = [20.0, 61.0]", 1),
        ('scene.gearbox = ["rotor", "none"]', 1),
        ("servo.Kp = [20.0, 61.0]\nposture.tilt = [0.0, 0.1]", 1),
        ('servo.Kp = [20.0, 61.0]\nposture.tilt = [0.0, 0.1]\nscene.gearbox = ["rotor", "none"]', 2),
        ('servo.Kp = [20.0]\nposture.tilt = [0.0, 0.1]\nscene.gearbox = ["rotor"]\nscene.timestep = [0.001]', 1),
        ("servo.Kp = [20.0, 61.0]\nservo.Ki = [0.0, 1.0]\nservo.Kf = [0.0, 0.1]\nposture.tilt = [0.0, 0.1]", 3),
    ],
)
def test_a_picture_for_any_number_of_parameters(tmp_path, vary, panels):
    outcome = run_study(read(tmp_path, ARM + "[vary]\n" + vary), tmp_path)
    picture = image.imread(outcome.picture)
    assert picture.shape[1] == {1: 910, 2: 936, 3: 1404}[panels]  # a map, two side by side, one for each parameter
    assert np.ptp(picture[..., :3]) > 0.8


@pytest.mark.long
def test_a_picture_of_drawn_runs(tmp_path):
    text = DRAWN.format("random", 20, 1) + 'scene.integrator = ["implicit_euler", "simtwo"]\n'
    assert image.imread(run_study(read(tmp_path, text), tmp_path).picture).shape[1] == 910


# ---------------------------------------------------------------------------------------------- command line


@pytest.mark.long
def test_the_command_runs_the_example_and_goes_on(tmp_path):
    text = (ROOT / "notebooks" / "stability_study.toml").read_text("utf-8")
    path = written(tmp_path, text.replace("20.0", "0.5").replace("0.001, 0.002, ", ""))
    printed = [command(path, "--out", tmp_path, "--batch", "4") for _ in range(2)]
    assert [done.returncode for done in printed] == [1, 1]  # not all rows are ok
    assert all(" of 12 rows are not ok" in done.stdout for done in printed)
    assert "12 runs, 12 of them now" in printed[0].stdout
    assert "12 runs, 0 of them now" in printed[1].stdout
    assert sorted(os.listdir(tmp_path)) == ["study.csv", "study.jsonl", "study.png", "study.toml"]
    statuses = [row["status"] for row in table(tmp_path / "study.csv")]
    assert f"ok {statuses.count('ok')}" in printed[1].stdout


def test_the_command_says_in_one_line_what_is_wrong(tmp_path, capsys):
    assert cli.main(["study", str(written(tmp_path, GRID.replace("20.0", "-20.0")))]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "study.toml: vary.servo.Kp = -20.0" in said
    assert cli.main(["study", str(tmp_path / "none.toml")]) == 2


def command(*arguments):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    line = [sys.executable, "-m", "featherstone_gait", "study", *map(str, arguments)]
    return subprocess.run(line, env=environment, capture_output=True, text=True)
