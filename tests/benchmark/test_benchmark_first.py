"""The benchmark of first results, on a program that compiles nothing of ours."""

import csv
import os
import subprocess
import sys

import pytest

from featherstone_gait.benchmark import first


def test_it_counts_a_process_of_its_own_and_writes_its_table(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(first, "PROGRAMS", {"nothing": "import time\nprint(time.process_time())"})
    rows = first.run(tmp_path / "new")
    assert [row.kind for row in rows] == ["nothing"]
    assert all(0.0 < seconds < 5.0 for row in rows for seconds in row[1:])
    with open(tmp_path / "new" / "first.csv", newline="") as file:
        table = list(csv.DictReader(line for line in file if not line.startswith("#")))
    assert [float(row["cold"]) for row in table] == [row.cold for row in rows]
    assert "nothing" in capsys.readouterr().out


def test_a_process_that_fails_says_why(tmp_path):
    with pytest.raises(RuntimeError, match="no kind of that name"):
        first.seconds("raise ValueError('no kind of that name')", str(tmp_path))


@pytest.mark.long
@pytest.mark.parametrize("kind", first.PROGRAMS)
def test_its_programs_run(kind, tmp_path):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", first.PROGRAMS[kind]], env=environment, check=True, cwd=tmp_path)
