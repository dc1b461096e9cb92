"""The servos that come with the package: what their files state of their manuals, and what they do in a simulation."""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from servo_wheel import driven

from featherstone_gait import RobotFileError, RobotFileWarning, cli, load_robot, load_servo
from featherstone_gait.identification.curve import torque_speed
from featherstone_gait.model import Controller, Gearbox, Servo
from featherstone_gait.robot_file.servos import servo_names, servo_sheet, with_servo

NAMES = servo_names()
SERVOS = Path(__file__).parents[2] / "robots" / "servos"
FIGURES = {"torque": "stall_torque", "current": "stall_current", "speed": "no_load_speed"}
TOLD = [name for name in NAMES if name != "ax12"]  # whose file is that of the paper


def test_these_servos_are_there():
    assert {"2xl430", "ax12", "ax12a", "mx28", "mx64", "mx106", "sts3215", "sts3250"} < set(NAMES)
    assert {"xc330", "xc430", "xl320", "xl330", "xl430", "xm430"} < set(NAMES)


@pytest.mark.parametrize("name", TOLD)
def test_a_servo_is_as_near_to_its_manual_as_its_quality_says(name):
    """Ratios at all voltages of the manual, to two digits; sources are named."""
    sheet = servo_sheet(name)
    assert sheet.product
    assert sheet.source
    assert sheet.manual_source
    stated = dict(re.findall(r"(torque|current|speed) ([\d.]+(?: to [\d.]+)?)", sheet.quality.partition(";")[0]))
    for word, figure in FIGURES.items():
        ratios = [
            getattr(torque_speed(load_servo(name), point.voltage), figure) / getattr(point, figure)
            for point in sheet.manual
        ]
        if math.isnan(ratios[0]):
            assert word not in stated
            continue
        low, _, high = stated[word].partition(" to ")
        assert (f"{min(ratios):.2f}", f"{max(ratios):.2f}") == (low, high or low)


@pytest.mark.quick("mx*", "x?[34]30", "ax12a", "2xl430", "sts3250")
@pytest.mark.parametrize("name", NAMES)
def test_a_servo_reaches_its_steady_states(name):
    """Against four loads each way, to 1e-6 of speed and current."""
    servo = load_servo(name)
    curve = torque_speed(servo, points=21)
    some = np.array([10, 13, 16, 19])
    loads, speeds = curve.torque[some], curve.speed[some]
    runs = driven(servo, servo.voltage_limit, [*-loads, *loads], [*speeds, *-speeds], duration=3.0)
    for k, run in zip([*some, *some], runs):
        assert run.status == "ok"
        assert abs(run["qd"][-1, 0]) == pytest.approx(curve.speed[k], rel=1e-6)
        assert abs(run["current"][-1, 0]) == pytest.approx(curve.current[k], rel=1e-6)


def test_the_corrected_ax12_has_the_manuals_figures_from_the_papers_motor():
    """At 12 V to 1e-3, in proportion at 10 V to 2 %; the paper's own gear lets it stall 73 % too strongly."""
    paper, corrected = load_servo("ax12"), load_servo("ax12a")
    for field in ("resistance", "inductance", "motor_constant", "voltage_limit", "viscous_friction", "controller"):
        assert getattr(corrected, field) == getattr(paper, field)
    for gear in ("ratio", "rotor_inertia", "stiffness", "damping"):
        assert getattr(corrected.gearbox, gear) == getattr(paper.gearbox, gear)
    rpm = math.pi / 30
    for voltage, tolerance in ((12.0, 1e-3), (10.0, 0.02)):
        curve = torque_speed(corrected, voltage)
        assert curve.stall_torque == pytest.approx(1.5 * voltage / 12.0, rel=tolerance)
        assert curve.stall_current == pytest.approx(1.5 * voltage / 12.0, rel=1e-12)
        assert curve.no_load_speed == pytest.approx(59 * rpm * voltage / 12.0, rel=tolerance)
    assert 254 * paper.motor_constant * 12.0 / paper.resistance == pytest.approx(1.73 * 1.5, rel=1e-3)


@pytest.mark.long
def test_the_corrected_ax12_holds_by_dry_friction_with_a_gear_that_gives():
    """Without voltage it stands under 0.999 K_c, and turns under 1.001 K_c: load from outside adds no friction."""
    servo = load_servo("ax12a")
    loads = np.repeat([0.999, 1.001, -0.999, -1.001], 2) * servo.coulomb_friction
    for load, run in zip(loads, driven(servo, 1e-9, loads, kind="mipsd")):
        assert (abs(run["q"][-1, 0] - run["q"][-2, 0]) > 1e-9) == (abs(load) > servo.coulomb_friction)


ROD = """<robot name="rod"><link name="base"/><link name="rod"><inertial><mass value="1"/><origin xyz="0 0 -1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="hinge" type="continuous">
<parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint></robot>"""


@pytest.mark.parametrize("friction", ["coulomb_friction", "stribeck_friction"])
def test_dry_friction_that_a_file_lets_creep_is_warned_about_where_it_is_set(friction, tmp_path):
    with pytest.warns(RobotFileWarning, match="stick_speed"):
        servo = load_servo("ax12", **{friction: 0.3})
    assert servo.stick_speed == load_servo("ax12").stick_speed == 1e-3
    assert load_servo("ax12", **{friction: 0.3}, stick_speed=0.0).stick_speed == 0.0  # a warning is an error here
    assert load_servo("ax12a", **{friction: 0.3}).stick_speed == 0.0
    assert load_servo("ax12", **{friction: 0.0}).stick_speed == 1e-3
    (tmp_path / "rod.urdf").write_text(ROD)
    (tmp_path / "rod.toml").write_text(f'[servos]\ndefault = "ax12"\n{friction} = 0.3\n')
    with pytest.warns(RobotFileWarning, match="stick_speed"):
        model = load_robot(tmp_path / "rod.urdf")
    assert any("stick_speed" in note for note in model.notes)
    with pytest.raises(RobotFileError, match=r"hinge.*stick_speed"):
        load_robot(tmp_path / "rod.urdf", strict=True)
    with (tmp_path / "rod.toml").open("a") as file:
        file.write("stick_speed = 0.0\n")
    assert load_robot(tmp_path / "rod.urdf", strict=True).servos["hinge"].stick_speed == 0.0


@pytest.mark.long
def test_a_joint_creeps_at_the_stick_speed_by_the_share_of_the_load():
    """F_c clamp(v / v_s) = T: under half of F_c at half of the stick speed, 0.3 rad in ten minutes."""
    servo = load_servo("ax12", coulomb_friction=0.3, stick_speed=1e-3, viscous_friction=0.0, rotor_damping=0.0)
    assert servo.stick_speed == 1e-3
    (run,) = driven(servo, 1e-9, [0.15], kind="rotor")
    speed = (run["q"][-1, 0] - run["q"][-2, 0]) / (run["time"][-1] - run["time"][-2])
    assert speed == pytest.approx(0.5e-3, rel=0.2)


def servo_file(folder, text):
    """The corrected AX-12 with another text of [about] and [manual]."""
    own = (SERVOS / "ax12a.toml").read_text("utf-8")
    path = folder / "own.toml"
    path.write_text(own[: own.index("[about]")] + text, "utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('[about]\nproduct = "x"\nmaker = "y"\n', ["about", "unknown key 'maker'", "product, source, quality"]),
        ('[about]\nproducts = "x"\n', ["unknown key 'products'", "product?"]),
        ("[about]\nproduct = 3\n", ["about: product is 3", "quotes"]),
        ('[manual]\nsource = "x"\nvolts = [12.0]\n', ["manual", "unknown key 'volts'", "voltage"]),
        ('[manual]\nsource = "x"\nstall_torque = [1.5]\n', ["manual: voltage is None", "[12.0, 14.8]"]),
        ("[manual]\nvoltage = [12.0]\nstall_torque = [1.5]\n", ["manual: source is None"]),
        ('[manual]\nsource = "x"\nvoltage = [12.0]\nstall_torque = [1.5, 2.0]\n', ["stall_torque has 2 numbers", "1"]),
        ('[manual]\nsource = "x"\nvoltage = [12.0]\nstall_torque = 1.5\n', ["stall_torque is 1.5", "for each voltage"]),
        ('[manual]\nsource = "x"\nvoltage = [-12.0]\n', ["voltage has -12.0", "above 0"]),
        ('[manual]\nsource = "x"\nvoltage = [nan]\n', ["voltage has nan", "above 0"]),
        ('[manual]\nsource = "x"\nvoltage = ["12"]\n', ["voltage is '12'", "number"]),
    ],
)
def test_a_wrong_manual_is_refused_by_name(text, says, tmp_path):
    path = servo_file(tmp_path, text)
    for read in (servo_sheet, load_servo):
        with pytest.raises(RobotFileError) as error:
            read(path)
        assert [part for part in ("own.toml", *says) if part not in str(error.value)] == []


def test_a_file_may_leave_all_of_it_out(tmp_path):
    path = servo_file(tmp_path, "")
    assert load_servo(path) == load_servo("ax12a")
    assert servo_sheet(path).manual == ()


def test_the_command_lists_all_servos(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    assert cli.main(["servos", "--out", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == NAMES
    assert "ROBOTIS Dynamixel MX-64" in next(line for line in lines if line.startswith("mx64"))
    assert list(tmp_path.iterdir()) == []


def test_the_command_compares_with_the_manual_and_draws(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    assert cli.main(["servos", "mx64", "ax12", "--plot", "curves.png", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    sheet, ours = servo_sheet("mx64"), torque_speed(load_servo("mx64"), 14.8)
    rows = [line.split() for line in out.splitlines()]
    k = next(k for k, row in enumerate(rows) if row[:3] == ["14.8", "V", "simulated"])
    assert [float(x) for x in rows[k][3:5]] == pytest.approx([ours.stall_torque, ours.stall_current], rel=1e-3)
    assert rows[k + 1][2:6] == ["manual", "7.3", "5.2", f"{sheet.manual[2].no_load_speed:.4g}"]
    assert float(rows[k + 2][3]) == pytest.approx(ours.stall_torque / 7.3, abs=1e-3)
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")


def test_the_command_takes_a_voltage_and_a_file(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    path = servo_file(tmp_path, "")
    assert cli.main(["servos", str(path), "--voltage", "12", "--out", str(tmp_path)]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert rows[-1][:5] == ["12", "V", "simulated", "1.5", "1.5"]
    for arguments in (["ax13"], ["ax12", "--voltage", "-1"], ["ax12", "--voltage", "nan"]):
        assert cli.main(["servos", *arguments, "--out", str(tmp_path)]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_a_servo_replaces_rotor_and_losses_of_an_actuator_without_motor():
    """What MJCF states at the joint for its position actuator is not counted beside the servo's own."""
    arm = load_robot("ax12_arm")
    stated = tuple(replace(one, armature=0.0284, damping=0.6, friction=0.05) for one in arm.joints)
    actuator = Servo(Controller("pd_clamped", Kp=17.8, torque_limit=3.35), Gearbox(1.0))
    first, *others = arm.joint_names
    of_file = replace(arm, joints=stated, servos={first: actuator})
    found = with_servo(of_file, "sts3215")
    by_name = {one.name: one for one in found.joints}
    assert by_name[first] == next(one for one in with_servo(arm, "sts3215").joints if one.name == first)
    assert [by_name[name] for name in others] == [one for one in stated if one.name in others]  # of no actuator
    assert found.notes[-1].endswith(f"actuators servos replace: {first}")
    geared = replace(of_file, servos=dict.fromkeys(arm.joint_names, load_servo("ax12a")))  # the joint's are its own
    assert with_servo(geared, "sts3215").joints == stated
