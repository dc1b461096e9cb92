"""The command `identify` for any servo and any recording, also those of its tutorial."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from featherstone_gait import cli
from featherstone_gait.identification import Recording, predict
from featherstone_gait.identification.bench_rollouts import pendulum
from featherstone_gait.model import Controller, Servo
from featherstone_gait.robot_file import load_servo
from featherstone_gait.robot_file.servos import servo_names

PAGE = Path(__file__).parents[2] / "docs" / "tutorials" / "servo.md"
OWN = 'law = "pd"\nKp = 2.0\nKd = 0.1\n'


def errors(folder):
    """Errors in identify_errors.csv [mrad], by recording."""
    lines = [line for line in (folder / "identify_errors.csv").read_text().splitlines() if not line.startswith("#")]
    return {row["recording"]: float(row["mean absolute error [mrad]"]) for row in csv.DictReader(lines)}


def fitted(folder):
    """Values and intervals in identify.csv, by parameter."""
    lines = [line for line in (folder / "identify.csv").read_text().splitlines() if not line.startswith("#")]
    return {row["parameter"]: [float(row[k]) for k in ("value", "low", "high")] for row in csv.DictReader(lines)}


def record(path, servo, mass, length, heads=("time [ms]", "goal_deg", "note", "position (deg)")):
    """Record a swinging weight that follows a wave; the columns have their own units."""
    time = 0.01 * np.arange(120)
    goal = 1.5 * np.sin(6.0 * time) ** 2
    (angle, _), *_ = predict(pendulum("p", servo, mass, length), [Recording("r", time, goal, 0.0 * time)])
    columns = 1e3 * time + 40.0, np.degrees(goal), ["-"] * len(time), np.degrees(angle)
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([heads, *zip(*columns)])


@pytest.mark.long
def test_a_servo_of_ones_own_is_found_again(tmp_path, monkeypatch):
    """Without a motor, as a TOML file, from a table in milliseconds and degrees."""
    monkeypatch.chdir(tmp_path)
    record(Path("swing.csv"), Servo(Controller("pd", Kp=3.0, Kd=0.15)), 0.5, 0.2)
    Path("mine.toml").write_text(OWN)
    record(Path("soft.csv"), Servo(Controller("pd", Kp=2.5, Kd=0.15)), 0.5, 0.2)
    command = (
        "identify swing.csv --servo mine.toml --mass 0.5 --length 0.2 --fit Kp Kd --predict soft.csv:Kp=2.5 --quiet"
    )
    assert cli.main(command.split()) == 0
    found = fitted(tmp_path)
    assert found["Kp"][0] == pytest.approx(3.0, rel=1e-6)
    assert found["Kd"][0] == pytest.approx(0.15, rel=1e-6)
    assert max(errors(tmp_path).values()) < 1e-3
    assert {path.name for path in tmp_path.iterdir()} == {
        "swing.csv", "soft.csv", "mine.toml", "identify.csv", "identify_errors.csv", "identify.png"
    }  # fmt: skip


@pytest.mark.parametrize(
    "more", ["", "--servo ax12", "--servo ax12 --mass 0.1 --length 0.1 --model m1", "--robot ax12_arm --mass 1.0"]
)
def test_what_is_missing_is_said(more, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    rows = [f"{0.01 * k:.2f},0.5,{0.001 * k}" for k in range(120)]
    Path("swing.csv").write_text("\n".join(["time [s],reference [rad],angle [rad]", *rows]))
    assert cli.main(["identify", "swing.csv", *more.split()]) == 2
    assert capsys.readouterr().out == ""
    assert {path.name for path in tmp_path.iterdir()} == {"swing.csv"}


@pytest.mark.long
def test_the_tutorials_recordings_are_fitted_by_its_command(tmp_path, monkeypatch):
    """Its program writes them, of a servo with parameters that it states."""
    monkeypatch.chdir(tmp_path)
    text = PAGE.read_text("utf-8")
    scope = {}
    exec(re.search(r"```python\n(.*?)^recordings = ", text, re.MULTILINE | re.DOTALL)[1], scope)
    (command,) = re.findall(r"^featherstone-gait (identify slow.csv .*)$", text, re.MULTILINE)
    assert cli.main(command.split()) == 0
    for name, (_, low, high) in fitted(tmp_path).items():
        assert 0.98 * low < scope["true"][name] < 1.02 * high


@pytest.mark.long
@pytest.mark.parametrize("name", servo_names())
def test_every_servo_of_the_package_is_fitted(name, tmp_path, monkeypatch):
    """Its motor, 10 % off, from a recording without noise, with a load of a tenth of its stall torque at most."""
    monkeypatch.chdir(tmp_path)
    servo = load_servo(name)
    stall = servo.gearbox.ratio * servo.motor_constant * servo.voltage_limit / servo.resistance
    length = min(0.3, 0.1 * stall / 9.81)
    record(Path("swing.csv"), load_servo(name, motor_constant=1.1 * servo.motor_constant), 1.0, length)
    command = f"identify swing.csv --servo {name} --mass 1.0 --length {length!r} --fit motor_constant"
    assert cli.main(command.split()) == 0
    assert fitted(tmp_path)["motor_constant"][0] == pytest.approx(1.1 * servo.motor_constant, rel=0.01)
