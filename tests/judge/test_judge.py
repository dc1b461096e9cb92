"""Policies judged in many worlds: the humanoid with its stored gait, and with policies that fail."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from browser import found_in
from feet import steps_of

from featherstone_gait import Ground, Session, cli, compile_scene, controller, load_robot, load_servo, standing_state
from featherstone_gait.judge import Policy, PolicyDescription, compare, judge, load_policy
from featherstone_gait.judge.comparison import paired
from featherstone_gait.judge.description import Action, Block
from featherstone_gait.judge.doubts import DEFAULT, draw_worlds
from featherstone_gait.judge.page import report_of
from featherstone_gait.judge.run import Timing, _Actuator
from featherstone_gait.judge.statistics import wilson
from featherstone_gait.robot_file.servos import with_servo
from featherstone_gait.robot_file.source import robots_folder
from featherstone_gait.robot_file.toml import read_toml
from featherstone_gait.walking.feedback import read_walk

GAIT = robots_folder() / "humanoid" / "optimized_gait.npz"
WIDE = {"kind": "uniform", "scale": 0.1}
DOUBTS = {  # of a kind of scene that other quick tests compile too
    "worlds": {
        "ground": {"friction": {"kind": "uniform", "scale": 0.3}, "penetration": {"kind": "lognormal", "scale": 0.3}},
        "servos": {"Kp": WIDE, "voltage_limit": WIDE, "coulomb_friction": WIDE, "backlash": WIDE},
        "links": {"mass": {"kind": "lognormal", "scale": 0.05}},
        "reference": {"offset": {"kind": "uniform", "scale": 0.01}},
    },
    "sensing": {"gyroscope_noise": 0.02, "gyroscope_bias": 0.02, "gravity_noise": 0.01, "mounting": 0.02},
    "link": {"delay": 0.02, "lost": 0.02},
    "pushes": {"speed": 0.02, "every": 1.0},
}


@pytest.fixture(scope="module")
def scene():
    model = with_servo(load_robot("humanoid", locked="simplified"), "ax12", backlash=2e-3)
    return compile_scene(model, "mipsd", Ground(), "midpoint", 1e-3)


def leaning(scene, act):
    """A policy of 50 Hz that sees its sensors and moves all joints."""
    blocks = (Block("projected_gravity"), Block("base_ang_vel"), Block("joint_pos", history=2), Block("actions"))
    joints = scene.model.joint_names
    description = PolicyDescription(joints, (0.0,) * len(joints), 50.0, blocks, Action(scale=0.2), "leaning")
    return Policy(act, description, "leaning")


@pytest.fixture(scope="module")
def walked(scene):
    return judge(GAIT, scene, 16, 3.0, again=8, doubts=DOUBTS)


def test_a_gait_walks_and_the_record_says_for_how_many_joules(walked, scene):
    assert walked.walking >= 12
    assert walked.verdict == "undecided"  # of 16 worlds that all walk the interval begins at 0.81
    ways = walked.worlds["way"][walked.verdicts == "walks"]
    assert (ways > 0.2).all()
    middle, low, high = walked.spread("energy_per_way")
    assert 20.0 < low <= middle <= high < 100.0  # the search that found it states 33 J/m in eight worlds
    weight = scene.model.mass * 9.81
    assert walked.spread("cost_of_transport")[0] == pytest.approx(middle / weight, rel=0.1)
    assert np.allclose(walked.worlds["power"] * walked.worlds["time"], walked.worlds["energy"], rtol=1e-12)
    assert walked.agreement.worlds == 8
    assert walked.agreement.energy_per_way < 0.05


def test_a_world_has_the_same_bits_among_others_and_on_any_number_of_threads(walked, scene):
    few = judge(GAIT, scene, 8, 3.0, again=0, doubts=DOUBTS, threads=1)
    for one, other in ((few.worlds, walked.worlds), (few.joints, walked.joints), (few.factors, walked.factors)):
        for name, values in one.items():
            assert values.tobytes() == other[name][:8].tobytes(), name
    assert few.verdicts.tolist() == walked.verdicts[:8].tolist()


def heading(q):
    w, x, y, z = q[:, 3:].T
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def test_a_world_is_what_a_session_of_it_alone_does(scene):
    """The references that the policy's answers make, sent by hand to robots of the same worlds, without delays."""
    seen = []

    def act(observations):
        seen.append(observations.copy())
        return np.sin(0.3 * len(seen) + np.arange(10.0)) + 0.1 * observations[:, :1]

    doubts = {name: DOUBTS[name] for name in ("worlds", "sensing")}
    found = judge(leaning(scene, act), scene, 8, 0.4, again=0, doubts=doubts)
    drawn = draw_worlds(scene, 8, 0, doubts)
    offset = drawn.sensing.offset
    with Session(scene, observe=("q", "qd", "base_q", "base_qd"), worlds=drawn.worlds) as session:
        now = session.reset(state=[standing_state(one, -off) for one, off in zip(session.scenes, offset)])
        answers, before, way = np.zeros((8, 10)), None, np.zeros(8, complex)
        for k, observations in enumerate(seen):
            w, x, y, z = now["base_q"][:, 3:].T
            down = np.column_stack([2 * (w * y - x * z), -2 * (y * z + w * x), 2 * (x * x + y * y) - 1])
            assert np.abs(observations[:, :3] - down).max() < 0.08  # noise and mounting
            assert np.abs(observations[:, 3:6] - now["base_qd"][:, 3:]).max() < 0.25
            joints = now["q"] + offset
            assert np.array_equal(observations[:, 6:16], joints)
            assert np.array_equal(observations[:, 16:26], joints if before is None else before)
            assert np.array_equal(observations[:, 26:], answers)
            answers = np.sin(0.3 * (k + 1) + np.arange(10.0)) + 0.1 * observations[:, :1]
            before = joints
            limits = np.array([(one.lower, one.upper) for one in scene.model.moving_joints]).T
            for _ in range(2):
                first, begin = heading(now["base_q"]), now["base_q"][:, :2] @ (1, 1j)
                now = session.step(np.clip(0.2 * answers, *limits) - offset)
                middle = np.exp(0.5j * (first + heading(now["base_q"])))  # none turns past the back
                way += (now["base_q"][:, :2] @ (1, 1j) - begin) / middle
        assert len(seen) == 20
        energy = session.state_view["energy"].reshape(8, 10, -1)[:, :, 1].sum(axis=1)
        assert np.allclose(energy, found.worlds["energy"], rtol=1e-14)
        assert np.abs(found.worlds["way"] - way.real).max() < 1e-13
        assert np.abs(found.worlds["aside"] - way.imag).max() < 1e-13


def test_worlds_that_are_looked_at_again_are_the_same_and_fill_a_page(walked, tmp_path):
    """Those that tell most, and two others: their ways are those of the judgment."""
    numbers = [*walked.shown_worlds().values(), 3, 11]
    for number, run in zip(numbers, walked.runs(numbers), strict=True):
        assert run.end_time == walked.worlds["time"][number]
        turned = np.diff(np.unwrap(heading(run["base_q"])))
        middle = np.exp(1j * (heading(run["base_q"])[:-1] + 0.5 * turned))
        way = (np.diff(run["base_q"][:, :2] @ (1, 1j)) / middle).sum()
        assert way.real == pytest.approx(walked.worlds["way"][number], abs=1e-9)
    page = walked.page(tmp_path / "page.html")
    assert page.path.stat().st_size > 1e5
    assert all(caption in page.html for caption in walked.shown_worlds())


def test_steps_are_measured_as_in_the_trajectories_of_the_worlds(walked):
    assert (walked.worlds["clearance"] > 0.01).any()
    for number, run, scene in zip((0, 5), walked.runs([0, 5]), walked.scenes([0, 5])):
        heights, slip, near = steps_of(run, scene)
        own = {name: values[number] for name, values in walked.worlds.items()}
        assert len(heights) >= 4
        found = own["clearance"], own["least_clearance"]
        assert found == pytest.approx((np.median(heights), min(heights)), abs=1e-12)
        assert own["slip"] * own["way"] == pytest.approx(slip, rel=1e-9)
        assert own["near_fall"] == pytest.approx(near, abs=1e-12)


LOOK = """
const seen = { wide: document.documentElement.scrollWidth - innerWidth };
seen.views = document.querySelectorAll("#views canvas").length;
seen.tiles = [...document.querySelectorAll(".tile b")].map(e => e.textContent);
seen.bars = document.querySelectorAll("rect.bar").length;
seen.median = document.querySelectorAll("line.median").length;
seen.texts = [...document.querySelectorAll("svg text")].map(e => e.textContent);
seen.fills = getComputedStyle(document.querySelector("rect.bar")).fill;
return seen;
"""


def test_a_page_fits_a_phone_and_has_the_verdict_before_the_pictures(walked, tmp_path):
    found, console = found_in(walked.page(tmp_path / "page.html").html, LOOK, tmp_path, sizes=((1200, 900), (360, 740)))
    assert console == []
    parts = [part for section in report_of(walked)["sections"] for part in section["parts"]]
    chart = next(part for part in parts if "chart" in part)
    costs = walked.worlds["energy_per_way"][walked.verdicts == "walks"]
    assert sum(chart["counts"]) == np.isfinite(costs).sum()
    assert chart["median"] == np.median(costs)
    for seen in found:
        assert seen["wide"] <= 0
        assert (seen["views"], seen["bars"], seen["median"]) == (2, len(chart["counts"]), 1)
        assert seen["tiles"][0] == walked.verdict
        assert {"J/m", "worlds"} <= {*seen["texts"]}
        assert seen["fills"] == "rgb(0, 114, 178)"  # the blue of Okabe and Ito


def test_worlds_that_ended_otherwise_than_by_a_fall_count_as_either(walked, tmp_path):
    """The interval spans both cases: that none of three unknown worlds walks, and that all do."""
    verdicts = np.array(["walks"] * 10 + ["falls"] * 3 + ["unknown"] * 3)
    found = replace(walked, verdicts=verdicts, unsound="too deep")
    assert (found.walking, found.unknown, found.share) == (10, 3, 10 / 13)
    assert found.interval == (wilson(10, 16)[0], wilson(13, 16)[1])
    assert "3 worlds, which count as either; the first: too deep" in found.table()
    everything = replace(found, verdicts=np.full(16, "unknown"))
    assert (everything.verdict, math.isnan(everything.share)) == ("undecided", True)
    assert everything.why().startswith("no verdict is known; ")
    assert not everything.shown_worlds()
    assert "too deep" in everything.page(tmp_path / "none.html").html  # which shows no robot
    few = replace(walked, verdicts=np.array(["walks"] * 3 + ["falls"] * 12 + ["stands"]))
    assert few.why().startswith("it walks in only 3 of 16 worlds, too few to compare with those in which it fails: it ")
    assert "it stands in 1, it falls in 12, after 3 s (median); " in few.why()
    assert found.why().startswith("it fails in only 3 of 16 worlds, too few to compare with the others: it falls in 3")
    assert found.shown_worlds()
    assert all(verdicts[k] != "unknown" for k in found.shown_worlds().values())


def test_two_judgments_are_compared_in_the_same_worlds(walked, scene):
    still = judge(leaning(scene, lambda x: np.zeros((len(x), 10))), scene, 16, 3.0, again=0, doubts=DOUBTS)
    assert (still.verdicts == "falls").sum() == 0  # without a command, what stands walks as far as the others
    text = compare([walked, still])
    only = int(((walked.verdicts == "walks") & (still.verdicts != "walks")).sum())
    assert f"1 in {only}" in text
    assert max(map(len, text.splitlines())) <= 79
    others = replace(still, settings=still.settings | {"seed": still.settings["seed"] + 1})
    assert "in which" not in compare([walked, others])  # of another seed no world is the same
    with pytest.raises(ValueError, match="records has 1; give two"):
        compare([walked])


def test_an_inertial_sensor_tells_what_was_a_delay_ago(scene):
    """Steps of 20 ms are two samples of 10 ms; a delay of 30 ms at most is none to two of them."""
    seen = []

    def act(observations):
        seen.append(observations.copy())
        return np.tile(np.sin(0.4 * len(seen) + np.arange(10.0)), (len(observations), 1))

    doubts = {"worlds": DOUBTS["worlds"], "sensing": {"sensor_delay": 0.03}}
    found = judge(leaning(scene, act), scene, 8, 0.4, again=0, doubts=doubts)
    late = (found.factors["delay of the sensor"] / 0.01).astype(int)
    assert {*late} == {0, 1, 2}
    looked = np.array(seen)  # (steps, worlds, numbers)
    seen.clear()  # its clock begins anew
    for world, run in enumerate(found.runs(range(8))):
        w, x, y, z = run["base_q"][:, 3:].T
        down = np.column_stack([2 * (w * y - x * z), -2 * (y * z + w * x), 2 * (x * x + y * y) - 1])
        then = np.maximum(2 * np.arange(20) - late[world], 0)
        assert np.abs(looked[:20, world, :3] - down[then]).max() < 1e-14


def test_references_arrive_late_and_those_that_are_lost_not_at_all(scene):
    """The servos get the action sent one delay earlier; a lost one is skipped; references move at most so fast."""
    policy = leaning(scene, lambda x: x[:, :10])
    drawn = draw_worlds(scene, 4, 0, {"worlds": {"reference": {"offset": {"kind": "uniform", "scale": 0.01}}}})
    drawn = drawn._replace(delay=np.array([0.0, 0.01, 0.03, 0.05]))  # 0, 1, 3 and 5 samples
    act = _Actuator(policy, scene, drawn, Timing(2, 1, 2, 20), 0.01)
    draws = np.random.default_rng(3)
    actions, lost = 0.5 * draws.normal(size=(20, 4, 10)), draws.random((20, 4)) < 0.3
    limits = np.array([(one.lower, one.upper) for one in scene.model.moving_joints]).T
    sent, arrived = np.clip(0.2 * actions, *limits), np.zeros((21, 4, 10))
    for step in range(20):
        arrived[step] = np.where(lost[step, :, None], arrived[step - 1], sent[step])
        act.send(step, actions[step], lost[step])
        assert np.array_equal(act.targets, sent[step])  # what the policy believes
        for sample in (2 * step, 2 * step + 1):
            then = [(sample - late) // 2 if sample >= late else -1 for late in (0, 1, 3, 5)]
            expected = arrived[then, np.arange(4)] - drawn.sensing.offset
            assert np.array_equal(act.references(sample), expected)
    files = replace(scene.model, references={"left_knee": (-0.05, 0.1)})  # of the engine of the robot's file
    ranged = _Actuator(policy, replace(scene, model=files), drawn, Timing(2, 1, 2, 20), 0.01)
    ranged.send(0, np.full((4, 10), 9.0), np.zeros(4, bool))
    knee, all_the_way = scene.model.joint_names.index("left_knee"), np.minimum(limits[1], 0.2 * 9.0)
    assert np.array_equal(np.delete(ranged.targets, knee, 1), np.delete(np.tile(all_the_way, (4, 1)), knee, 1))
    assert (ranged.targets[:, knee] == 0.1).all()
    own = policy.description
    slow = replace(policy, description=replace(own, action=replace(own.action, max_speed=2.0)))
    act = _Actuator(slow, scene, drawn, Timing(2, 1, 2, 20), 0.01)
    act.send(0, np.full((4, 10), 9.0), np.zeros(4, bool))
    assert np.abs(act.targets).max() == pytest.approx(2.0 * 0.02)


def test_a_policy_that_never_walks_breaks_without_a_number(scene):
    fallen = judge(leaning(scene, lambda x: np.full((len(x), 10), 9.0)), scene, 8, 1.5, again=0, doubts=DOUBTS)
    assert (fallen.walking, fallen.verdict) == (0, "breaks")
    assert (fallen.verdicts == "falls").all()
    assert (fallen.worlds["time"] < 1.5).all()
    assert fallen.why().startswith("it walks in no world: it falls in 8, after 0.")
    assert math.isnan(fallen.spread("energy_per_way")[0])
    found = json.loads(json.dumps(fallen.as_dict(), allow_nan=False))
    assert found["median_and_quartiles"]["energy_per_way"] == [None] * 3


@controller(memory=1)
def bowing(t, state, reference, command, memory):
    memory[0] += 0.01
    for j in (1, 6):  # both hips
        command[j, 0] = reference[j, 0] + min(0.4 * memory[0], 0.3)


@pytest.mark.long
def test_a_compiled_controller_drives_all_worlds_and_is_blamed_by_its_name(scene):
    found = judge(bowing, scene, 8, 1.0, again=0, doubts={"worlds": DOUBTS["worlds"]})
    assert (found.policy, found.settings["rate"]) == ("bowing", 100.0)
    run = found.runs([2])[0]
    offset = draw_worlds(scene, 8, 0, {"worlds": DOUBTS["worlds"]}).sensing.offset[2]
    assert run["q"][-1, [1, 6]] + offset[[1, 6]] == pytest.approx(0.3, abs=0.06)  # bowed by as much as was asked


@pytest.mark.long
def test_a_gait_is_played_with_the_feedback_that_its_file_has(scene):
    """Pushed about once a second, it walks in more worlds than the same gait without."""
    path, rough = GAIT.with_name("balanced_gait.npz"), {"pushes": {"speed": 0.15, "every": 1.0}}
    walk = read_walk(path, scene.model.joint_names)
    with_it, without = (judge(one, scene, 32, 5.0, again=0, doubts=rough) for one in (path, walk.motion))
    assert with_it.walking > without.walking + 5


@pytest.mark.parametrize(
    ("act", "said"),
    [
        (lambda x: np.where(np.arange(10) == 3, np.nan, np.zeros((len(x), 1))), "left_ankle_front' in world 0 at 0 s"),
        (lambda x: np.zeros((len(x), 9)), r"answers \(8, 9\).*expected \(8, 10\)"),
    ],
)
def test_a_policy_that_answers_no_action_is_told_by_joint_world_and_time(act, said, scene):
    with pytest.raises(ValueError, match=rf"leaning: .*{said}"):
        judge(leaning(scene, act), scene, 8, 0.1, again=0, doubts=DOUBTS)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"worlds": 0}, "worlds is 0"),
        ({"seconds": math.nan}, "seconds is nan"),
        ({"command": (0.1, 0.0)}, "command must be 3"),
        ({"doubts": {"worlds": {"ground": {"frction": WIDE}}}}, "frction"),
        ({"doubts": {"sensing": {"gyro": 1.0}}}, "unknown key 'gyro'"),
        ({"doubts": {"sensing": 3}}, "sensing is 3; expected a table"),
        ({"doubts": {"link": {"lost": 2.0}}}, "link.lost is 2.0"),
        ({"doubts": {"roughness": {"height": 0.01, "cell": 1e-3}}}, "roughness.cell is 0.001 m.*give a cell of"),
        ({"doubts": {"worlds": {"servos": {"backlash": {"kind": "uniform"}}}}}, "worlds.servos.backlash"),
    ],
)
def test_what_is_out_of_range_is_refused_by_name(how, said, scene):
    with pytest.raises(ValueError, match=said):
        judge(GAIT, scene, **how)


def test_a_copy_of_the_default_worlds_draws_what_these_do(scene):
    """This robot has no supply: lines about it are left out as they are, and refused if changed."""
    own, usual = read_toml(DEFAULT), draw_worlds(scene, 4)
    copied = draw_worlds(scene, 4, 0, own)
    assert copied.left_out == usual.left_out
    assert {"supply.voltage", "supply.resistance"} == {*copied.left_out}
    assert all(np.array_equal(values, usual.factors[name]) for name, values in copied.factors.items())
    own["worlds"]["supply"]["voltage"]["scale"] = 0.2
    with pytest.raises(ValueError, match="supply"):
        draw_worlds(scene, 4, 0, own)


def test_a_rate_that_does_not_fit_the_servos_is_refused_with_one_that_does(scene):
    own = leaning(scene, lambda x: np.zeros((len(x), 10))).description
    odd = PolicyDescription(own.joints, own.pose, 30.0, own.observation, own.action, "odd")
    with pytest.raises(ValueError, match=r"odd: rate is 30 Hz.*give a rate of 33\.3333 Hz"):
        judge(lambda x: np.zeros((len(x), 10)), scene, 8, 0.1, description=odd)


def test_a_robot_without_ground_servos_or_the_joints_is_refused(scene):
    fixed = compile_scene(load_robot("ax12_arm"), "mipsd")
    with pytest.raises(ValueError, match="ax12_arm: a judgment needs"):
        judge(leaning(scene, len), fixed)
    with pytest.raises(ValueError, match="left_hip_lateral' is none of ax12_arm"):
        load_policy(GAIT, fixed.model)
    with pytest.raises(ValueError, match="a function needs its description"):
        load_policy(len, scene.model)


@pytest.mark.long
def test_the_command_writes_a_row_for_each_world(tmp_path, monkeypatch, capsys):
    doubts = tmp_path / "few.toml"
    doubts.write_text('[worlds.ground]\nfriction = {kind = "uniform", scale = 0.3}\n', "utf-8")
    command = ["judge", str(GAIT), "--locked", "simplified", "--doubts", str(doubts), "--worlds", "8"]
    assert cli.main([*command, "--seconds", "0.5", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.partition("files:")[0].splitlines())) <= 79
    assert "8 of 8 verdicts are the same" in printed
    found = json.loads((tmp_path / "optimized_gait_judgment.json").read_text("utf-8"))
    assert (found["worlds"], found["policy"], found["half_the_step"]["worlds"]) == (8, "optimized_gait", 8)
    assert (tmp_path / "optimized_gait_judgment.html").stat().st_size > 5e4
    rows = (tmp_path / "optimized_gait_judgment.csv").read_text("utf-8").splitlines()
    assert [row.partition(",")[0] for row in rows[1:]] == ["world", *map(str, range(8))]
    twice = ["judge", str(GAIT), *command[1:], "--seconds", "0.2", "--out", str(tmp_path), "--quiet"]
    assert cli.main(twice) == 0
    assert "2 walks in 0 worlds in which 1 does not, 1 in 0" in capsys.readouterr().out
    assert {path.name for path in tmp_path.glob("*_2_judgment.*")} == {
        f"optimized_gait_2_judgment{ending}" for ending in (".json", ".csv", ".html")
    }
    assert cli.main([*command, "--command", "1,2"]) == 2
    assert "--command is '1,2'" in capsys.readouterr().err


@pytest.mark.long
def test_the_command_compares_servos_in_the_same_worlds(tmp_path, capsys):
    """A servo of the package and one of a file, of the same kind: a set of files for each, and one table."""
    doubts, weak, sheet = tmp_path / "few.toml", tmp_path / "weak.toml", robots_folder() / "servos" / "ax12.toml"
    doubts.write_text('[worlds.ground]\nfriction = {kind = "uniform", scale = 0.3}\n', "utf-8")
    weak.write_text(sheet.read_text("utf-8").replace("\nKp = 61.0", "\nKp = 30.5"), "utf-8")
    assert load_servo(weak).controller.Kp == 0.5 * load_servo("ax12").controller.Kp
    command = ["judge", str(GAIT), "--locked", "simplified", "--doubts", str(doubts), "--worlds", "8", "--quiet"]
    assert cli.main([*command, "--seconds", "0.2", "--servo", f"ax12,{weak}", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "rotor" not in printed.partition("policy")[0]
    assert "elastic (--gearbox) (weak)" in printed
    last = printed.rpartition("files:")[2]
    assert [line.split()[:2] for line in last.splitlines() if line[:1].isdigit()][:2] == [["1", "ax12"], ["2", "weak"]]
    assert "2 walks in" in last
    files = [tmp_path / f"optimized_gait_{name}_judgment.csv" for name in ("ax12", "weak")]
    rows = [list(csv.DictReader(file.read_text("utf-8").splitlines()[1:])) for file in files]
    assert [row["ground.friction"] for row in rows[0]] == [row["ground.friction"] for row in rows[1]]
    assert [row["energy"] for row in rows[0]] != [row["energy"] for row in rows[1]]
    assert all(file.with_suffix(".html").stat().st_size > 5e4 for file in files)
    assert cli.main([*command, "--servo", "ax12,ax13"]) == 2  # before anything is simulated
    assert "ax13" in capsys.readouterr().err


def test_judgments_are_compared_world_by_world(walked):
    """Of worlds in which only one walks the exact test of McNemar; of those where both walk the ratio of their J/m."""
    verdicts = np.array(["walks"] * 12 + ["falls"] * 4)
    first, dearer = replace(walked, verdicts=verdicts), dict(walked.worlds)
    dearer["energy_per_way"] = 1.25 * dearer["energy_per_way"]
    second = replace(walked, verdicts=np.array(["falls"] * 5 + ["walks"] * 8 + ["falls"] * 3), worlds=dearer)
    found = paired(first, second)
    assert (found.first, found.second, found.both) == (5, 1, 7)
    assert found.chance == 2 * (1 + 6) / 2**6
    assert found.ratio == pytest.approx((0.8, 0.8, 0.8), rel=1e-14)
    assert paired(first, first).chance == 1.0
    assert paired(first, replace(second, robot="another")) is None
    text = compare([replace(first, servo="one"), replace(second, servo="two")])
    assert [line.split()[1] for line in text.splitlines()[1:3]] == ["one", "two"]  # of one policy their servos
    assert "in 7, 2 takes 1.25 times the J/m (1.25 to 1.25)" in " ".join(text.split())
    none = compare([replace(first, verdicts=np.full(16, "falls")), second])  # nothing to divide, and no error
    assert "times the J/m" not in none
    assert max(map(len, text.splitlines())) <= 79
