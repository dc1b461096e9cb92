"""The gait search loses nothing: killed at any moment it resumes to the same files; a full disk is a clear error."""

import contextlib
import errno
import json
import random
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from featherstone_gait import cli
from featherstone_gait.optimize import OptimizeOptions, main_job, planning, preparation, quality, report
from featherstone_gait.search import minimize

resource = pytest.importorskip("resource")

ITERATIONS, KILLS = 60, 12
SETTINGS = dict(amplitude=0.3, max_iterations=60, seed=7)


def start(folder):
    command = [sys.executable, "-m", "featherstone_gait", "optimize", "--one-world", "--test-worlds", "0"]
    command += ["--iterations", str(ITERATIONS), "--out", str(folder)] + ["--resume"] * bool(history(folder))
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, cwd=Path(__file__).parents[2], **quiet)


def finish(process):
    _, errors = process.communicate()
    assert process.returncode == 0, errors.decode()


def killed(folder, until, moment):
    """Start the command, and `moment` [s] after `until` is true kill it; whether that came before its end."""
    process = start(folder)
    while not until() and process.poll() is None:
        time.sleep(0.001)
    time.sleep(moment)
    process.kill()
    process.communicate()
    return process.returncode < 0


def history(folder):
    path = folder / "humanoid_gait_history.jsonl"
    return path.read_bytes() if path.exists() else b""


def results(folder):
    """All files; the report without what may differ from run to run."""
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    report = json.loads(files.pop("humanoid_gait.json"))
    for varies in ("seconds", "evaluations", "files"):
        del report[varies]
    return files, report


@pytest.mark.long
def test_a_search_killed_again_and_again_ends_in_the_same_files(tmp_path):
    """Most kills come as candidates are written, some while the program starts, the last while the files are."""
    rng, torn, deaths, kept = random.Random(5), tmp_path / "torn", 0, b""
    whole = start(tmp_path / "whole")
    writing = (torn / "humanoid_gait.partial").exists
    for k in range(KILLS):
        length = len(history(torn)) + rng.randrange(1000)  # a candidate takes some 1000 bytes
        if k % 6 == 3:
            deaths += killed(torn, lambda: True, rng.random())
        elif k >= KILLS - 2:
            deaths += killed(torn, writing, 0.2 * rng.random())
        else:
            deaths += killed(torn, lambda n=length: len(history(torn)) > n or writing(), 0.02 * rng.random())
        assert history(torn).startswith(kept)  # what has been written stays
        kept = history(torn)[: history(torn).rfind(b"\n") + 1]
    assert deaths >= KILLS - 2  # the last two may come too late
    finish(start(torn))
    finish(whole)
    (files, report), (whole_files, whole_report) = results(torn), results(tmp_path / "whole")
    assert report == whole_report
    assert files.keys() == whole_files.keys()
    assert [name for name in files if files[name] != whole_files[name]] == []


@contextlib.contextmanager
def largest_file(size):
    """No file grows beyond `size` bytes: what is written then is cut there, and the next write fails."""
    _, hard = before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def sphere(x):
    return float((x**2).sum())


@pytest.mark.parametrize("size", [100, 3000, 5001])
def test_a_history_that_cannot_grow_keeps_its_whole_lines(tmp_path, size):
    path = tmp_path / "history.jsonl"
    with largest_file(size), pytest.raises(OSError, match=r"history\.jsonl cannot be written .* make room"):
        minimize(sphere, np.ones(5), history=path, **SETTINGS)
    assert size - 500 < path.stat().st_size <= size
    assert path.read_bytes()[-1:] in (b"", b"\n")
    resumed = minimize(sphere, np.ones(5), history=path, resume=True, **SETTINGS)
    whole = minimize(sphere, np.ones(5), history=tmp_path / "whole.jsonl", **SETTINGS)
    assert np.array_equal(resumed.history["x"], whole.history["x"])
    assert path.read_bytes() == (tmp_path / "whole.jsonl").read_bytes()


@pytest.mark.long
def test_a_full_disk_leaves_no_half_written_results(tmp_path, monkeypatch, capsys):
    full = OSError(errno.ENOSPC, "No space left on device")

    def half(path, *_):
        Path(path).write_text("<html>")
        raise full

    command = ["optimize", "--one-world", "--test-worlds", "0", "--iterations", "2", "--out", str(tmp_path)]
    monkeypatch.setattr(quality, "PERTURBED", 1)
    with monkeypatch.context() as disk:
        disk.setattr(report, "write_animation", half)
        assert cli.main(command) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith(f"error: {tmp_path}: the results cannot be written (No space left on device)")
    assert [path.name for path in tmp_path.iterdir()] == ["humanoid_gait_history.jsonl"]
    assert cli.main([*command, "--resume"]) == 0
    assert len(list(tmp_path.iterdir())) == 9


def test_a_folder_that_takes_no_files_is_named_before_the_search(tmp_path, monkeypatch):
    def refused(**_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(preparation.tempfile, "TemporaryFile", refused)
    monkeypatch.setattr(planning, "walking_cost", None)  # nothing has been computed yet
    with pytest.raises(OSError, match=r"no file can be written here \(Permission denied\); give another folder"):
        main_job(options=OptimizeOptions(out=tmp_path))
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"file: no file can be written here \(File exists\)"):
        main_job(options=OptimizeOptions(out=tmp_path / "file"))
