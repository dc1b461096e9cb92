"""The command line does what its help says, and says in one line what is wrong."""

import importlib
import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib import image

from featherstone_gait import Ground, Mimic, Trajectory, cli, compile_scene, load_robot, robot_names
from featherstone_gait.cli import simulate as simulate_command
from featherstone_gait.optimize import job as optimize
from featherstone_gait.optimize.options import OptimizeOptions
from featherstone_gait.optimize.preparation import Job
from featherstone_gait.optimize.preparation import folded as folded_text
from featherstone_gait.robot_file.servos import servo_names
from featherstone_gait.run import simulate as simulation

SLIDER = """<robot name="slider">
  <link name="rail"/>
  <link name="sled">
    <inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  </link>
  <joint name="fall" type="prismatic">
    <parent link="rail"/><child link="sled"/><axis xyz="0 0 1"/>
    <limit lower="-10" upper="10" effort="1" velocity="1"/>
  </joint>
</robot>
"""


def results(folder, robot):
    """The trajectory and the measures that `simulate` wrote; its picture is checked to be one."""
    picture = image.imread(folder / f"{robot}_simulation.png")
    assert picture.shape[:2] == (660, 1320)
    assert np.ptp(picture[..., :3]) > 0.9
    trajectory = Trajectory.load(folder / f"{robot}_simulation")
    return trajectory, trajectory.info["measures"]


def test_info_prints_every_link_and_joint_and_writes_the_same_where_it_is_asked_to(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    asked = ["info", "humanoid", "--all", "--locked", "simplified"]
    assert cli.main(asked) == 0
    printed = capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []
    assert cli.main([*asked, "--out", "here"]) == 0
    with_files = capsys.readouterr().out
    assert with_files == printed + f"\nfiles: {Path('here') / 'humanoid_info.txt'}\n"
    assert (tmp_path / "here" / "humanoid_info.txt").read_text("utf-8") == printed
    model = load_robot("humanoid", locked="simplified")
    rows = {line.split()[0]: line.split() for line in reversed(printed.splitlines()) if line}  # the first wins
    assert math.fsum(float(rows[link.name][1]) for link in model.links) == pytest.approx(model.mass, rel=1e-4)
    assert {joint.name for joint in model.joints} <= rows.keys()
    locked = {line.split()[0] for line in printed.splitlines() if " locked at " in line}
    assert sorted(locked) == sorted(model.locked)
    assert rows["chosen:"][1] == "ars343,"


@pytest.mark.parametrize("command", ["info humanoid", "info arm7_spatial --all", "servos", "servos mx64 ax12a"])
def test_what_is_printed_fits_a_terminal_of_80_columns_and_loses_nothing(command, monkeypatch, capsys, tmp_path):
    said = {}
    for columns in ("80", "400"):
        monkeypatch.setenv("COLUMNS", columns)
        assert cli.main([*command.split(), "--out", str(tmp_path)]) == 0
        said[columns] = [line for line in capsys.readouterr().out.splitlines() if str(tmp_path) not in line]
    assert max(len(line) for line in said["80"] if "/" not in line) < 80  # a path may be as long as it likes
    assert {*" ".join(said["80"]).split()} == {*" ".join(said["400"]).split()}


def test_info_says_what_simulate_would_take_for_each_kind_of_servo(capsys, monkeypatch):
    """Held against the scenes themselves."""
    monkeypatch.setenv("COLUMNS", "80")
    for robot, usual in (("ax12_arm", None), ("humanoid", "mipsd")):
        assert cli.main(["info", robot]) == 0
        _, _, shown = capsys.readouterr().out.partition("\nservos ")
        model = load_robot(robot)
        for kind in (None, "mipsd", "rotor", "standard"):
            scene = compile_scene(model, kind, Ground() if model.base == "floating" else None)
            (row,) = (line for line in shown.splitlines() if line.startswith(f"{kind or 'none'} "))
            assert row.split()[-1] == scene.integrator
            assert row.startswith(f"{kind or 'none'} *") == (kind == usual)
            step = scene.preflight.largest_explicit_step
            assert f" {1e3 * step:.3g} ms, " in row if math.isfinite(step) else " any " in row


@pytest.mark.quick("info")
@pytest.mark.parametrize("command", ["info", "simulate"])
def test_a_robot_of_ones_own_stands_on_its_feet_with_the_gears_that_it_has(command, capsys, tmp_path):
    """No contact points are typed, its knee is bent at the least, and its servo has a rigid gear."""
    inertial = '<mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
    link = f'<link name="%s"><inertial>{inertial}</inertial>'
    link += '<collision><origin xyz="0 0 %s"/><geometry><box size="%s"/></geometry></collision></link>'
    joint = '<joint name="knee" type="revolute"><parent link="trunk"/><child link="foot"/><origin xyz="0 0 -0.1"/>'
    joint += '<axis xyz="1 0 0"/><limit lower="0.01" upper="1" effort="1" velocity="1"/></joint>'
    parts = link % ("trunk", 0, "0.1 0.1 0.1"), link % ("foot", -0.1, "0.3 0.3 0.02"), joint
    (tmp_path / "hopper.urdf").write_text(f'<robot name="hopper">{"".join(parts)}</robot>', "utf-8")
    (tmp_path / "hopper.toml").write_text('base = "floating"\n[servos]\ndefault = "xl330"\n', "utf-8")
    assert cli.main([command, str(tmp_path / "hopper.urdf"), "--out", str(tmp_path)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "contacts 4 points of its feet" in said
    assert ("rotor *" if command == "info" else "gearbox rotor: ") in said
    if command == "simulate":
        assert "stands on the ground, servos hold all joints as near to zero as their limits allow" in said


def quadruped():
    """The URDF of a quadruped, which says nothing of base, contacts and servos."""
    link = '<link name="{}"><inertial><mass value="{}"/><inertia ixx="{i}" ixy="0" ixz="0" iyy="{i}" iyz="0" '
    link += 'izz="{i}"/></inertial><collision><origin xyz="0 0 {}"/><geometry><box size="{}"/></geometry>'
    link += "</collision></link>"
    joint = '<joint name="{}_hip" type="revolute"><parent link="trunk"/><child link="{}"/><origin xyz="{} {} 0"/>'
    joint += '<axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="3" velocity="6"/></joint>'
    parts = [link.format("trunk", 1.5, 0, "0.3 0.15 0.06", i=0.01)]
    for leg, x, y in (("lf", 0.14, 0.08), ("rf", 0.14, -0.08), ("lh", -0.14, 0.08), ("rh", -0.14, -0.08)):
        parts += [link.format(leg, 0.1, -0.1, "0.02 0.02 0.2", i=1e-3), joint.format(leg, leg, x, y)]
    return f'<robot name="dog">{"".join(parts)}</robot>'


@pytest.mark.quick("info", "view")
@pytest.mark.parametrize("command", ["info", "view", "simulate"])
def test_a_plain_quadruped_stands_from_the_shell(command, tmp_path, capsys):
    dog = tmp_path / "dog.urdf"
    dog.write_text(quadruped(), "utf-8")
    setup = "--base floating --contacts feet --servo xm430"
    assert cli.main([command, str(dog), *setup.split(), "--out", str(dog.parent)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "0 locked servo of all joints" in said or command != "info"
    assert "stands with 16 contact points of 4 links" in said or command != "info"
    if command == "simulate":
        trajectory = Trajectory.load(dog.parent / "dog_simulation")
        weight = 9.81 * load_robot(dog).mass
        assert trajectory["contact_force"][-1, :, 0].sum() == pytest.approx(weight, rel=1e-6)
        assert trajectory.info["servos"] == "rotor"
        assert cli.main(["view", str(dog.parent / "dog_simulation.npz"), "--out", str(dog.parent)]) == 0


def test_the_setup_of_a_robot_is_the_same_for_all_commands():
    """Besides the gearbox "none", with which nothing walks, and what the defaults are."""
    found = {}
    for command in ("info", "simulate", "drive", "view", "optimize", "crosscheck", "judge"):
        actions = {action.dest: action for action in cli._parser().parse_args([command, "x"]  # x: a robot, file or gait
            if command != "optimize" else [command]).command._actions if action.option_strings}  # fmt: skip
        for name in ("base", "contacts", "servo", "gearbox"):
            action = actions[name]
            choices = tuple(each for each in action.choices or () if each != "none")
            how = action.option_strings, action.default, choices, action.type, action.help.partition(" (default")[0]
            assert found.setdefault(name, how) == how


PRESETS = servo_names()


@pytest.mark.quick("info")
@pytest.mark.parametrize("command", ["info", "simulate"])
def test_position_actuators_of_mjcf_count_as_rigid(command, tmp_path, capsys):
    pytest.importorskip("mujoco")
    body = '<body pos="0 0 0.2"><freejoint/><geom type="box" size=".1 .1 .02" mass="1"/><body pos="0 0 -.1">'
    body += '<joint name="knee" axis="0 1 0"/><geom type="box" size=".1 .1 .01" pos="0 0 -.05" mass=".2"/></body>'
    drive = '<actuator><position joint="knee" kp="20" kv="1"/></actuator>'
    floor = '<geom type="plane" size="0 0 .01"/>'
    world = f"<worldbody>{floor}{body}</body></worldbody>"
    (tmp_path / "hopper.xml").write_text(f"<mujoco>{world}{drive}</mujoco>", "utf-8")
    assert cli.main([command, str(tmp_path / "hopper.xml"), "--out", str(tmp_path)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert ("rotor *" if command == "info" else "gearbox rotor:") in said


@pytest.mark.quick("info-mx64", "info-ax12", "servos-*")
@pytest.mark.parametrize("servo", PRESETS)
@pytest.mark.parametrize("command", ["info", "servos", "simulate"])
def test_every_servo_of_the_package_is_taken_with_the_gear_that_it_has(command, servo, tmp_path, capsys):
    if command == "servos":
        assert cli.main(["servos", servo]) == 0
        return
    assert cli.main([command, "ax12_arm", "--servo", servo, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    gear, kind = ("elastic", "mipsd") if servo in ("ax12", "ax12a") else ("rigid", "rotor")
    for part in (f"{gear} gear", f"{kind} *") if command == "info" else (f"{kind}:",):
        assert part in said


@pytest.fixture(scope="module")
def planned_once():
    """Make each plan of the humanoid once: it depends on links and joints, which all servos leave as they are."""
    module, known = importlib.import_module("featherstone_gait.walking.cheapest_plan"), {}

    def planned(model, make=module.walking_plan, **settings):
        key = repr((model.links, model.joints, sorted(settings.items())))
        if key not in known:
            try:
                known[key] = make(model, **settings)
            except ValueError as error:
                known[key] = error
        if isinstance(known[key], ValueError):
            raise known[key]
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "walking_plan", planned)
        yield


@pytest.mark.long
@pytest.mark.usefixtures("planned_once")
@pytest.mark.parametrize("servo", PRESETS)
def test_a_search_with_every_servo_of_the_package_walks_or_says_in_a_line_why_not(servo, tmp_path, capsys):
    """The weakest cannot carry the robot on one leg, which the line says."""
    sizes = "--iterations 8 --test-worlds 2 --no-baselines --quiet"
    code = cli.main(["optimize", "--servo", servo, *sizes.split(), "--out", str(tmp_path)])
    said = capsys.readouterr()
    assert (code == 0) == (tmp_path / "humanoid_gait.npz").exists()
    if code:
        assert code == 2
        assert said.err.count("\n") == 1
        assert "on one leg" in said.err


def test_a_robot_whose_servos_cannot_run_together_is_described_all_the_same(tmp_path, capsys):
    """One joint has a torque law, the other a sampled servo; a scene takes only one of the two kinds."""
    text = Path(load_robot("arm7").source).read_text("utf-8")
    (tmp_path / "mixed.urdf").write_text(text, "utf-8")
    own = '[servos.joints.joint1]\nlaw = "pd"\nKp = 10.0\nKd = 0.1\nratio = 1.0\n'
    (tmp_path / "mixed.toml").write_text('[servos.joints.joint2]\ntype = "ax12"\n' + own, "utf-8")
    assert cli.main(["info", str(tmp_path / "mixed.urdf")]) == 0
    assert "rotor is refused: arm7 mixes pd servos with sampled ones" in " ".join(capsys.readouterr().out.split())


def test_info_says_what_carries_a_robot(capsys, tmp_path):
    assert cli.main(["info", "humanoid"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "stands with 8 contact points of 2 links on ground that gives way by 0.5 mm under its weight" in said
    (tmp_path / "slider.urdf").write_text(SLIDER)
    assert cli.main(["info", str(tmp_path / "slider.urdf")]) == 0
    assert "its base is fixed; `simulate` puts no ground under it" in capsys.readouterr().out
    box = SLIDER.split("\n", 2)[2].partition("  <joint")[0]
    (tmp_path / "slider.urdf").write_text(f'<robot name="box">{box}</robot>')
    (tmp_path / "slider.toml").write_text('base = "floating"\n')
    assert cli.main(["info", str(tmp_path / "slider.urdf")]) == 0
    assert "no contact points, so `simulate` lets it fall" in capsys.readouterr().out


def test_problems_of_a_file_have_lines_of_their_own(tmp_path, capsys):
    (tmp_path / "arm.urdf").write_text('<robot name="arm"><link name="base"/></robot>')
    (tmp_path / "arm.toml").write_text("[bogus]\nx = 1\n[worse]\ny = 2\n")
    assert cli.main(["info", str(tmp_path / "arm.urdf")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(":")[0] for line in lines] == ["error", "  line 1", "  line 3"]


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("optimise", "error: there is no command 'optimise' (did you mean optimize?); `featherstone-gait --help`"),
        ("dance", "error: there is no command 'dance'; `featherstone-gait --help`"),
        ("optimize --iters 3", "error: there is no option --iters (did you mean --iterations?); `feather"),
        ("info arm7 arm8", "error: 'arm8' was not expected; `featherstone-gait info --help`"),
        ("info", "error: the following arguments are required: ROBOT; `featherstone-gait info --help`"),
        ("benchmark spead", "error: argument NAME: 'spead' is none of scoreboard, "),
        ("simulate arm7 --gearbox mips", "error: argument --gearbox: 'mips' is none of mipsd, rotor, standard, none "),
    ],
)
def test_what_is_mistyped_gets_one_line_and_what_was_meant(command, said, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(command.split())
    captured = capsys.readouterr()
    assert (stop.value.code, captured.out, captured.err.count("\n")) == (2, "", 1)
    assert captured.err.startswith(said)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("optimize --robot nowhere.urdf", "nowhere.urdf"),
        ("optimize --iterations -1", "iterations"),
        ("optimize --worlds -1", "worlds"),
        ("identify nowhere.csv --servo xl330", "nowhere.csv"),
        ("reproduce 02_amr", "02_amr"),
        ("crosscheck {robots}/humanoid/optimized_gait.npz --floors ice", "floors is 'ice'"),
        ("crosscheck {robots}/humanoid/optimized_gait.npz --soles flat", "soles is 'flat'"),
        ("view nowhere.npz", "nowhere.npz: there is no such file"),
        ("optimize --iterations 0", "iterations"),
        ("optimize --resume", "no search to resume"),
        ("optimize --servo xl430 --gearbox mipsd", "--gearbox rotor"),
        ("optimize --iterations 1000000000000", "iterations"),
        ("optimize --worlds 1000000000000", "worlds"),
        ("optimize --test-worlds 1000000000000", "test_worlds"),
        ("crosscheck {robots}/humanoid/optimized_gait.npz --strides 1000000000000", "strides"),
        ("crosscheck {robots}/humanoid/optimized_gait.npz --processes 1000000000000", "processes"),
        ("crosscheck {robots}/humanoid/optimized_gait.npz --timestep 1e-12", "timestep"),
        ("export {robots}/humanoid/optimized_gait.npz --strides 1000000000000", "strides"),
        ("simulate arm7 --duration 1e12", "duration"),
        ("simulate arm7 --duration 2e4", "records"),
    ],
)
def test_what_is_wrong_is_said_before_how_long_it_takes_and_nothing_is_written(command, said, capsys, tmp_path):
    robots = Path(load_robot("humanoid").source).parents[1]
    assert cli.main([*command.format(robots=robots).split(), "--out", str(tmp_path)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert said in captured.err
    assert [*tmp_path.iterdir()] == []


def test_the_summary_of_a_search_fits_a_terminal():
    text = "short\n" + "word " * 40 + "\n\n    kept   apart"
    folded = folded_text(text)
    assert max(map(len, folded.splitlines())) < 80
    assert folded.split() == text.split()
    assert folded.endswith("\n    kept   apart")


def test_a_search_says_how_long_it_takes_in_proportion():
    def seconds(robot="humanoid", **options):
        return sum(Job(OptimizeOptions(**options), robot, model, model, Path("x")).seconds.values())

    model = load_robot("humanoid")
    candidate = 0.0045 * 8
    assert seconds(iterations=8000) - seconds() == pytest.approx(7200 * candidate)
    assert seconds(iterations=8000, worlds=16) - seconds(worlds=16) == pytest.approx(14400 * candidate)
    assert seconds() < 60.0 < seconds(crosscheck=2)
    assert seconds() < seconds(servo="xm430") < seconds("another.urdf", plan="cheapest")


def test_a_free_swing_keeps_its_energy(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["simulate", "arm7"]) == 0
    printed = capsys.readouterr().out
    trajectory, measures = results(tmp_path, "arm7")
    assert trajectory.status == "ok"
    assert trajectory["q"][0] == pytest.approx([math.pi / 2, *[0.0] * 6])
    assert trajectory["time"][-1] == pytest.approx(1.0)
    model = load_robot("arm7")
    drop = 2 * sum(0.1 * 9.81 * (0.1 * k + 0.05) for k in range(7))  # from upright to hanging
    assert 0.25 * drop < measures["kinetic_energy_J"] < 0.5 * drop
    assert 0 < measures["energy_error_J"] < 1e-7 * measures["kinetic_energy_J"]
    assert 0 < measures["error_estimate"] < 1e-6
    assert trajectory.info["joints"] == list(model.joint_names)
    assert f"{measures['error_estimate']:.1e}" in printed
    assert "dop853, steps by their error" in printed
    assert max(map(len, printed.splitlines())) < 80


def test_a_slider_of_the_users_own_falls_freely(tmp_path):
    (tmp_path / "slider.urdf").write_text(SLIDER)
    out = tmp_path / "new" / "folder"
    assert cli.main(["simulate", str(tmp_path / "slider.urdf"), "--timestep", "1e-3", "--out", str(out)]) == 0
    trajectory, measures = results(out, "slider")
    assert trajectory["q"][:, 0] == pytest.approx(-0.5 * 9.81 * trajectory["time"] ** 2, abs=1e-12)
    assert measures["kinetic_energy_J"] == pytest.approx(0.5 * 2 * 9.81**2)


def test_a_dot_in_the_name_of_a_robot_belongs_to_its_files(tmp_path):
    (tmp_path / "slider.v2.urdf").write_text(SLIDER)
    robot, out = str(tmp_path / "slider.v2.urdf"), str(tmp_path / "out")
    assert cli.main(["info", robot, "--out", out]) == 0
    assert cli.main(["simulate", robot, "--timestep", "1e-3", "--out", out]) == 0
    names = ["slider.v2_info.txt", *(f"slider.v2_simulation.{ending}" for ending in ("json", "npz", "png"))]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == names


def test_the_humanoid_stands(tmp_path):
    assert cli.main(["simulate", "humanoid", "--duration", "1", "--out", str(tmp_path)]) == 0
    trajectory, measures = results(tmp_path, "humanoid")
    assert measures["ground_force_by_weight"] == pytest.approx(1.0, abs=0.01)
    assert measures["base_shift_m"] < 0.01
    assert measures["energy_J"]["electrical_no_regeneration"] >= measures["energy_J"]["supply"] > 0
    assert trajectory.info["servos"] == "mipsd"


def test_a_robot_that_has_fallen_at_its_start_says_so(tmp_path, monkeypatch):
    """Nothing is simulated then, so there is no simulated second to divide a time by."""
    monkeypatch.setattr(simulate_command, "_standing", lambda model, home: (upside_down(model), "on its head"))
    assert cli.main(["simulate", "humanoid", "--duration", "1", "--out", str(tmp_path)]) == 1
    trajectory, measures = results(tmp_path, "humanoid")
    assert (trajectory.status, trajectory.end_time) == ("fell", 0.0)
    assert measures["seconds_per_simulated_second"] > 0.0


def upside_down(model):
    q = np.zeros(model.nq)
    q[4] = 1.0
    return q


def test_the_start_of_a_joint_that_follows_is_told(tmp_path):
    """A follower of a joint at 57 degrees is not at zero."""
    arm = load_robot("arm7")
    first, second = arm.joints[:2]
    arm = replace(arm, joints=(first, replace(second, mimic=Mimic(first.name, 0.5, 0.0)), *arm.joints[2:]))
    text, _ = simulate_command._experiment(compile_scene(arm), None)
    assert text.endswith("all others at zero or as they follow others")
    assert not simulate_command._experiment(compile_scene(load_robot("arm7")), None)[0].endswith("others")


@pytest.mark.long
def test_a_wrong_result_is_told_by_status_and_exit_code(tmp_path, capsys):
    """The paper's standard servo model in the update order of 2012 chatters at 1 ms; implicit steps do not.

    Euler's takes 1.5 % less energy from the supply than the midpoint rule, and says so.
    """
    command = ["simulate", "arm7", "--gearbox", "standard", "--timestep", "1e-3", "--out", str(tmp_path)]
    assert cli.main([*command, "--integrator", "simtwo"]) == 1
    assert "status      chatter: " in capsys.readouterr().out
    assert json.loads((tmp_path / "arm7_simulation.json").read_text())["status"] == "chatter"
    assert cli.main([*command, "--integrator", "midpoint"]) == 0
    assert "status      ok\n" in capsys.readouterr().out
    assert cli.main([*command, "--integrator", "implicit_euler"]) == 1
    assert "on energy of joint1 is uncertain" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["info", "arm8"], "arm8"),
        (["info", "missing.urdf"], "missing.urdf"),
        (["info", "humanoid", "--locked", "arms"], "simplified"),
        (["simulate", "arm7", "--integrator", "euler"], "implicit_euler"),
        (["simulate", "arm7", "--integrator", "simtwo"], "simtwo"),
        (["simulate", "arm7", "--timestep", "-1"], "-1.0"),
        (["simulate", "arm7", "--timestep", "nan"], "nan"),
        (["simulate", "arm7", "--gearbox", "mipsd", "--timestep", "3e-3"], "0.003"),
        (["simulate", "arm7", "--duration", "0"], "0.0"),
        (["simulate", "arm7", "--duration", "inf"], "inf"),
        (["simulate", "slider.urdf", "--gearbox", "mipsd"], "[servos] in slider.toml"),
        (["info", "slider.urdf", "--gearbox", "rotor"], "omit --gearbox"),
        (["simulate", "arm7", "--out", "slider.urdf"], "slider.urdf"),
    ],
)
def test_wrong_arguments_get_one_line(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "slider.urdf").write_text(SLIDER)
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    assert said in captured.err
    assert [path.name for path in tmp_path.iterdir()] == ["slider.urdf"]


@pytest.mark.parametrize("out", ["slider.urdf", "slider.urdf/new/folder"])
@pytest.mark.parametrize("command", ["info slider.urdf", "optimize", "study study.toml", "benchmark walk", "reproduce"])
def test_a_file_is_no_folder_for_results(command, out, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "slider.urdf").write_text(SLIDER)
    assert cli.main([*command.split(), "--out", out]) == 2
    problem = "slider.urdf is a file, not a folder; give another folder, or move it"
    assert capsys.readouterr().err == f"error: --out {Path(out)}: {problem}\n"
    assert (tmp_path / "slider.urdf").read_text() == SLIDER


def test_ctrl_c_is_an_exit_code(monkeypatch, tmp_path, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(simulation, "simulate", interrupted)
    assert cli.main(["simulate", "arm7", "--out", str(tmp_path)]) == 130
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.parametrize(("message", "code"), [("max_iterations reached", 0), ("interrupted; the best so far is", 130)])
def test_a_search_that_is_interrupted_has_that_exit_code_too(message, code, monkeypatch, tmp_path):
    monkeypatch.setattr(optimize, "main_job", lambda *_, **__: {"search": {"message": message}})
    assert cli.main(["optimize", "--out", str(tmp_path)]) == code


COMMANDS = sorted(each.__name__.rpartition(".")[2].replace("_", "-") for each in cli.COMMANDS)


def help_of(command, monkeypatch, capsys, columns="80"):
    monkeypatch.setenv("COLUMNS", columns)
    with pytest.raises(SystemExit) as stop:
        cli.main([*command.split(), "--help"])
    assert stop.value.code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS)
def test_help_says_what_is_written_and_where_and_nothing_twice(command, monkeypatch, capsys):
    """No six words in a row twice, but in examples."""
    text = help_of(command, monkeypatch, capsys)
    assert "Writes " in text
    assert "--out DIR" in text
    assert max(map(len, text.splitlines())) <= 80
    words = help_of(command, monkeypatch, capsys, "200").partition("\nexamples:\n")[0].split()
    runs = [" ".join(words[k : k + 6]) for k in range(len(words) - 5)]
    assert sorted(run for run in {*runs} if runs.count(run) > 1) == []


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_examples_that_are_understood(command, monkeypatch, capsys):
    _, _, shown = help_of(command, monkeypatch, capsys).partition("\nexamples:\n")
    lines = [line.split() for line in shown.splitlines() if line.startswith("  featherstone-gait ")]
    assert lines
    for _, *arguments in lines:
        assert arguments[0] == command
        assert callable(cli._parser().parse_args(arguments).run)


def test_the_command_alone_shows_where_to_start(capsys):
    assert cli.main([]) == 0
    text = capsys.readouterr().out
    assert "where to start:" in text
    assert all(f"  {command} " in text for command in COMMANDS)
    assert ", ".join(robot_names()) in " ".join(text.split())
    examples = [line.split()[1:] for line in text.partition("where to start:\n")[2].splitlines() if line[:2] == "  "]
    assert len(examples) == 4
    assert all(name in COMMANDS for name, *_ in examples[:3])


@pytest.mark.long
def test_a_study_with_wrong_rows_is_written_and_exits_with_1(tmp_path, capsys):
    """The paper's standard servo in the update order of 2012 chatters; the implicit step does not."""
    text = """robot = "arm7"
experiment = "hold"
duration = 0.2
scene.gearbox = "standard"
scene.timestep = 0.001
[vary]
scene.integrator = ["simtwo", "implicit_euler"]
"""
    (tmp_path / "both.toml").write_text(text)
    assert cli.main(["study", str(tmp_path / "both.toml"), "--out", str(tmp_path)]) == 1
    printed = capsys.readouterr().out
    assert "status: chatter 1, ok 1\n" in printed or "status: ok 1, chatter 1\n" in printed
    assert "1 of 2 rows are not ok" in printed
    assert len((tmp_path / "both.csv").read_text().splitlines()) == 4  # format, header, rows
    (tmp_path / "one.toml").write_text(text.replace('"simtwo", ', ""))
    assert cli.main(["study", str(tmp_path / "one.toml"), "--out", str(tmp_path)]) == 0


def test_a_file_that_is_not_there_is_named(tmp_path, capsys):
    assert cli.main(["study", str(tmp_path / "none.toml"), "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith(f"error: {tmp_path / 'none.toml'}: there is no such file; ")


@pytest.mark.parametrize("arguments", [["dance"], ["benchmark", "nothing"], ["info"]])
def test_unknown_commands_are_refused(arguments):
    with pytest.raises(SystemExit) as stop:
        cli.main(arguments)
    assert stop.value.code == 2


def test_help_answers_before_anything_heavy_is_loaded():
    program = (
        "import contextlib, sys\nfrom featherstone_gait.cli import main\n"
        "with contextlib.suppress(SystemExit):\n    main(['simulate', '--help'])\n"
        "assert 'numpy' not in sys.modules and 'numba' not in sys.modules"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", program], env=environment, check=True, stdout=subprocess.DEVNULL)


@pytest.mark.parametrize("name", cli.benchmark.BENCHMARKS)
def test_a_benchmark_gets_its_folder_and_its_length(name, monkeypatch, tmp_path):
    calls = []
    module = importlib.import_module(f"featherstone_gait.benchmark.{name}")
    monkeypatch.setattr(module, "run", lambda out_dir, full=False: calls.append((out_dir, full)))
    assert cli.main(["benchmark", name, "--out", str(tmp_path)]) == 0
    assert cli.main(["benchmark", name, "--full", "--out", str(tmp_path)]) == 0
    assert calls == [(tmp_path, False), (tmp_path, True)]


def test_doubts_about_a_file_are_told_without_a_line_of_this_package(tmp_path):
    text = Path(load_robot("ax12_arm").source).read_text("utf-8")
    path = tmp_path / "arm.urdf"
    path.write_text(text.replace("<joint name=", '<joint color="red" name=', 1), "utf-8")
    command = [sys.executable, "-m", "featherstone_gait", "info", str(path)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    told = " ".join(run.stderr.split())
    assert told.startswith(f"warning: {path}: ")
    assert "unknown attribute 'color' of <joint>: ignored" in told
    assert "load_robot(args" not in told


def test_a_package_that_is_missing_is_named_in_a_line(tmp_path, monkeypatch, capsys):
    (tmp_path / "arm.xml").write_text("<mujoco><worldbody><body/></worldbody></mujoco>", "utf-8")
    monkeypatch.setitem(sys.modules, "mujoco", None)
    for command in ("info", "simulate", "view"):
        assert cli.main([command, str(tmp_path / "arm.xml"), "--out", str(tmp_path)]) == 2
        said = capsys.readouterr().err
        assert said.startswith("error: ")
        assert said.count("\n") == 1
        assert "pip install featherstone-gait[mjcf]" in said


def test_a_servo_that_is_not_there_is_told_with_those_that_are(capsys):
    assert cli.main(["servos", "ax13"]) == 2
    told = capsys.readouterr().err
    assert told.startswith("error: there is no servo 'ax13'; the package has ")
    assert "ax12," in told
    assert told.count("\n") == 1


def test_no_unit_is_parted_from_its_number():
    line = "time        18.51 ms per simulated second; ready to run after 10.31 s, plot 1.47 s"
    assert simulate_command._filled(line).splitlines() == [line[:-7].rstrip(), " " * 12 + "1.47 s"]
