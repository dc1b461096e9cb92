"""The command that looks at a folder of robots."""

import csv

import pytest
from test_cli import SLIDER

from featherstone_gait import cli

NOTED = SLIDER.replace('<link name="rail"/>', '<link name="rail"><contact/></link>')
HEAVY = SLIDER.replace('mass value="2"', 'mass value="-2"')


@pytest.fixture
def folder(tmp_path):
    robots = tmp_path / "robots"
    (robots / "deep" / "er").mkdir(parents=True)
    for name, text in {"a.urdf": SLIDER, "deep/b.urdf": NOTED, "deep/er/c.urdf": HEAVY, "deep/d.urdf": "no"}.items():
        (robots / name).write_text(text)
    (robots / "e.xml").write_text("<?xml version='1.0'?><!-- <robot> --><sdf/>")
    (robots / "f.xml").write_text("<!-- a --><mujoco><worldbody><body/></worldbody></mujoco>")
    return robots


def test_a_folder_of_robots_is_told_by_a_table(folder, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert cli.main(["check-robots", str(folder), "--no-simulate", "--csv", "t.csv", "--out", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = {line.split()[0]: line.split() for line in reversed(lines) if line.strip()}
    assert rows["a.urdf"][1:] == ["yes", "0", "1", "2"]
    assert rows["deep/b.urdf"][1:] == ["yes", "1", "1", "2"]
    assert rows["deep/er/c.urdf"][1:] == ["no"]
    assert "deep/er/c.urdf: mass is -2.0 [kg]" in lines
    assert "e.xml" not in rows
    assert rows["f.xml"][1:] == ["yes", "0", "0", "0"]
    assert any(line.startswith("3 of 5 robots load, 1 of them with notes") for line in lines)
    assert "1 x mass is # [kg]" in lines
    with (folder / "t.csv").open() as file:
        comment, *table = file.read().splitlines()
    assert comment.startswith("# featherstone_gait table of robots 2")
    assert [row["loads"] for row in csv.DictReader(table)] == ["yes", "yes", "no", "no", "yes"]


def test_the_table_fits_a_narrow_terminal(folder, capsys):
    long = folder / "a_robot_of_a_long_name_in_a_folder" / "of_a_long_name.urdf"
    long.parent.mkdir()
    long.write_text(SLIDER)
    (folder / "deep" / f"wrong_{'in_many_words_' * 5}.urdf").write_text(HEAVY)
    assert cli.main(["check-robots", str(folder), "--no-simulate"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) < 80
    assert any(line.startswith("...") and "folder/of_a_long_name.urdf  yes" in line for line in lines)


def test_a_second_of_each_robot_is_simulated(folder, capsys):
    (folder / "deep" / "b.urdf").unlink()
    assert cli.main(["check-robots", str(folder), "--out", str(folder)]) == 0
    out = capsys.readouterr().out
    row = next(line.split() for line in out.splitlines() if line.startswith("a.urdf"))
    assert row[5] == "ok"
    assert 0.0 < float(row[6]) < 1e-6
    assert "simulated: ok 1" in out


def test_a_folder_that_is_not_there_gets_one_line(tmp_path, capsys):
    assert cli.main(["check-robots", str(tmp_path / "none")]) == 2
    assert "there is no such folder" in capsys.readouterr().err
