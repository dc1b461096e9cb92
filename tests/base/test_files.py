"""Files appear whole or not at all, and together where they belong together."""

import csv
import errno

import numpy as np
import pytest

from featherstone_gait import load_robot, save_robot
from featherstone_gait.base.files import Format, complete, complete_together, moving_up, read_csv, write_csv
from featherstone_gait.walking import read_angles, write_angles


def contents(folder):
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_a_file_is_seen_only_when_it_is_complete(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("old")
    with complete(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert contents(tmp_path) == {"table.csv": "new"}


FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("failure", [FULL, KeyboardInterrupt(), ValueError()])
@pytest.mark.parametrize("present", [False, True])
def test_a_failure_in_the_middle_leaves_what_was_there(tmp_path, present, failure):
    if present:
        (tmp_path / "a").write_text("old")
        (tmp_path / "b").write_text("old")
    before = contents(tmp_path)
    with pytest.raises(type(failure)), complete_together(tmp_path / "a", tmp_path / "b") as (a, b):  # noqa: PT012
        a.write_text("new")
        b.write_text("half")
        raise failure
    assert contents(tmp_path) == before


def test_an_error_names_the_files_and_says_that_nothing_has_changed(tmp_path):
    said = r"a, .*b: cannot be written \(No space left on device\); what was there is unchanged"
    with pytest.raises(OSError, match=said), complete_together(tmp_path / "a", tmp_path / "b"):
        raise FULL
    with pytest.raises(OSError, match=r"nowhere.a: cannot be written \(No such file"), complete(tmp_path / "nowhere/a"):
        pass


def test_files_that_belong_together_appear_only_if_all_can(tmp_path):
    (tmp_path / "b").mkdir()
    refused = pytest.raises(OSError, match="b is a folder")
    with refused, complete_together(tmp_path / "a", tmp_path / "b") as (a, b):
        a.write_text("new")
        b.write_text("new")
    assert [path.name for path in tmp_path.iterdir()] == ["b"]


def test_what_a_killed_process_left_under_the_name_is_removed(tmp_path):
    (tmp_path / "run.partial").mkdir()
    (tmp_path / "run.partial" / "half").write_text("a")
    with moving_up(tmp_path, "run.partial") as folder:
        (folder / "whole").write_text("b")
    assert contents(tmp_path) == {"whole": "b"}


def test_two_writers_do_not_meet_and_the_last_one_wins(tmp_path):
    with complete(tmp_path / "a") as first:
        first.write_text("first")
        with complete(tmp_path / "a") as second:
            second.write_text("second")
        assert (tmp_path / "a").read_text() == "second"
    assert contents(tmp_path) == {"a": "first"}


def test_files_have_the_usual_permissions(tmp_path):
    (tmp_path / "plain").touch()
    with complete(tmp_path / "a") as temporary:
        temporary.touch()
    assert len({path.stat().st_mode for path in tmp_path.iterdir()}) == 1


def test_a_table_whose_rows_fail_leaves_the_earlier_one(tmp_path):
    def rows():
        yield [1]
        raise ValueError("the second row")

    write_csv(tmp_path / "a.csv", Format("thing"), ["x"], [[0]])
    before = contents(tmp_path)
    with pytest.raises(ValueError, match="the second row"):
        write_csv(tmp_path / "a.csv", Format("thing"), ["x"], rows())
    assert contents(tmp_path) == before


def test_a_robot_is_saved_with_both_files_or_none(tmp_path):
    (tmp_path / "robot.toml").mkdir()
    with pytest.raises(OSError, match=r"robot\.urdf, .*robot\.toml: cannot be written"):
        save_robot(load_robot("ax12_arm"), tmp_path / "robot.urdf")
    assert [path.name for path in tmp_path.iterdir()] == ["robot.toml"]


FORMULAS = ["=1+1", "@data@", "+cmd|' /C calc'!A0", "-left", " =1", "\t=1", "'=1", "''@x"]


def test_names_that_spreadsheets_would_compute_are_texts_and_read_back(tmp_path):
    path, form = tmp_path / "table.csv", Format("table")
    cells = [*FORMULAS, "-2.5", "+1e3", "-", "left_knee", "'", "a=b", ""]
    write_csv(path, form, cells, [cells, [-1.5] * len(cells)])
    with path.open(newline="") as file:
        _, *rows = csv.reader(file)
    assert all(cell.startswith("'") for row in rows[:2] for cell in row[: len(FORMULAS)])
    assert rows[1][len(FORMULAS) :] == cells[len(FORMULAS) :]
    assert rows[2] == ["-1.5"] * len(cells)
    assert [row for _, row in read_csv(path, form)] == [cells, cells, rows[2]]


def test_angles_of_joints_with_such_names_make_the_round_trip(tmp_path):
    times, angles = np.arange(3.0), np.arange(6.0).reshape(3, 2) / 10.0
    write_angles(tmp_path / "angles.csv", times, angles, ["=1+1", "@knee"])
    assert "\r\n0.0" in (tmp_path / "angles.csv").read_bytes().decode()
    assert ",=1+1" not in (tmp_path / "angles.csv").read_text()
    found, read, names = read_angles(tmp_path / "angles.csv")
    assert names == ("=1+1", "@knee")
    np.testing.assert_allclose(read, angles, atol=1e-12)
    np.testing.assert_allclose(found, times, atol=1e-12)
