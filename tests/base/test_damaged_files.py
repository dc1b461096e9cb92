"""Files belong to one process at a time, and what is wrong with one is said with its name."""

import errno
import json
import math
import os
import signal
import subprocess
import sys
import tracemalloc
import zipfile
from concurrent.futures import Future

import numpy as np
import pytest

from featherstone_gait import Trajectory, cli
from featherstone_gait.base.files import claim, number
from featherstone_gait.benchmark import precision
from featherstone_gait.identification import read_recording
from featherstone_gait.optimize import OptimizeOptions, main_job, planning
from featherstone_gait.search import AdaptiveSimulatedAnnealing, minimize
from featherstone_gait.study import read_study, run_study
from featherstone_gait.study.run import Log
from featherstone_gait.walking import read_angles, read_motion, read_walk

SEARCH = dict(amplitude=0.3, max_iterations=30, seed=7)
STUDY = 'robot = "ax12_arm"\nexperiment = "hold"\nduration = 0.1\n[vary]\nservo.Kp = [20.0, 61.0]\n'
RUN = Trajectory({"time": np.zeros(2), "q": np.ones((2, 3))}, "ok", "", 0.5, np.zeros(3), parts={"q": (0, 3)})
HOLDER = """
import os, sys, time
from featherstone_gait.base.files import claim
file = open(sys.argv[1], "a+b", buffering=0)
claim(file, sys.argv[1])
if not hasattr(os, "fork"):
    print(0, flush=True)
elif os.fork() == 0:
    print(os.getpid(), flush=True)
time.sleep(60)
"""


def sphere(x):
    return float((x**2).sum())


# ---------------------------------------------------------------------------------------------- one process at a time


@pytest.fixture
def claimed(tmp_path):
    """A function that claims a file, as another process does."""
    files = []

    def take(path):
        files.append(path.open("a+b", buffering=0))
        claim(files[-1], path)

    yield take
    for file in files:
        file.close()


def test_a_claim_goes_with_its_process_however_that_ends(tmp_path, claimed):
    """Killed, with a child that lives on."""
    path = tmp_path / "log.jsonl"
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, str(path)], stdout=subprocess.PIPE, text=True)
    child = int(holder.stdout.readline())
    try:
        with pytest.raises(OSError, match=r"log\.jsonl: another process is at work with this file; wait until"):
            claimed(path)
        holder.kill()
        holder.wait()
        claimed(path)
    finally:
        holder.stdout.close()
        if child:
            os.kill(child, signal.SIGKILL)


@pytest.mark.long
def test_of_two_studies_in_a_folder_one_works_and_the_other_says_so(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    study = read_study(tmp_path / "study.toml")
    with Log(tmp_path / "study.jsonl", study) as log:
        before = (tmp_path / "study.jsonl").read_bytes()
        with pytest.raises(OSError, match=r"study\.jsonl: another process is at work"):
            run_study(study, tmp_path)
        assert (tmp_path / "study.jsonl").read_bytes() == before
        assert log.count == 0
    assert run_study(study, tmp_path).computed == 2


def test_a_row_is_never_taken_for_another_run(tmp_path):
    (tmp_path / "study.toml").write_text(STUDY)
    study, path = read_study(tmp_path / "study.toml"), tmp_path / "study.jsonl"
    run_study(study, tmp_path)
    header, first, second = path.read_text().splitlines(keepends=True)
    with Log(path, study) as log:
        path.write_text(header + first.replace('"run": 0', '"run": 1') + second)
        with pytest.raises(ValueError, match=r"study\.jsonl, run 0: damaged; something else .* \(found run 1\)"):
            list(log.rows())
    path.write_text(header + first.replace('"run": 0', '"run": -1') + second)
    with pytest.raises(ValueError, match=r"study\.jsonl, line 2: damaged; delete this line"):
        run_study(study, tmp_path)


def test_of_two_searches_with_a_history_one_works_and_the_other_says_so(tmp_path):
    path, whole = tmp_path / "history.jsonl", tmp_path / "whole.jsonl"
    minimize(sphere, np.ones(3), history=whole, **SEARCH)

    def other(_):
        with pytest.raises(OSError, match=r"history\.jsonl: another process is at work"):
            minimize(sphere, np.ones(3), history=path, resume=True, **SEARCH)

    minimize(sphere, np.ones(3), history=path, resume=True, callback=other, **SEARCH)
    assert path.read_bytes() == whole.read_bytes()


def test_of_two_gait_searches_in_a_folder_the_second_says_so_at_once(tmp_path, claimed, monkeypatch):
    monkeypatch.setattr(planning, "walking_cost", None)  # nothing has been computed yet
    claimed(tmp_path / "humanoid_gait_history.jsonl")
    with pytest.raises(OSError, match=r"humanoid_gait_history\.jsonl: another process is at work"):
        main_job(options=OptimizeOptions(out=tmp_path, resume=True))


# ---------------------------------------------------------------------------------------------- damaged files


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("status", "fine", "status is 'fine'; expected one of ok, fell"),
        ("status", ["ok"], "status is .*; expected one of ok, fell"),
        ("message", None, "message is None; expected a text"),
        ("end_time", "1", "end_time is '1'; expected a finite number"),
        ("end_time", True, "end_time is True; expected a finite number"),
        ("end_time", 10**400, "end_time is 1000.*; expected a finite number"),
        ("end_time", math.nan, "end_time is nan; expected a finite number"),
        ("info", [], "info is .*; expected an object"),
        ("parts", {"q": [0, 4]}, "parts is .*; expected .* the 3 numbers of the final state"),
        ("parts", {"q": [0.0, 3.0]}, "parts is .*; expected .* the 3 numbers of the final state"),
        ("parts", [], "parts is .*; expected .* the 3 numbers of the final state"),
        ("channels", {}, "'channels' is unknown; expected status, message"),
    ],
)
def test_a_trajectory_is_described_as_it_should_be(tmp_path, name, value, said):
    RUN.save(tmp_path / "run")
    path = tmp_path / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {name: value}))
    with pytest.raises(ValueError, match=rf"run\.json: {said}"):
        Trajectory.load(tmp_path / "run")


@pytest.mark.parametrize("name", ["status", "message", "end_time", "info"])
def test_nothing_is_missing_in_what_describes_a_trajectory(tmp_path, name):
    RUN.save(tmp_path / "run")
    path = tmp_path / "run.json"
    path.write_text(json.dumps({key: value for key, value in json.loads(path.read_text()).items() if key != name}))
    with pytest.raises(ValueError, match=rf"run\.json: {name} is missing; expected"):
        Trajectory.load(tmp_path / "run")


@pytest.mark.parametrize(
    "changed",
    [
        {"final": None},
        {"final": np.zeros((2, 2))},
        {"final": np.array(["a"])},
        {"channel_q": np.ones((3, 3))},
        {"channel_q": np.ones((2, 3), complex)},
        {"channel_q": np.array(1.0)},
        {"error_q": np.ones((2, 2))},
        {"error_qd": np.ones((2, 3))},
        {"other": np.ones(2)},
    ],
)
def test_the_arrays_of_a_trajectory_fit_each_other(tmp_path, changed):
    RUN.save(tmp_path / "run")
    arrays = {"final": RUN.final, "channel_time": RUN["time"], "channel_q": RUN["q"]} | changed
    np.savez(tmp_path / "run.npz", **{name: values for name, values in arrays.items() if values is not None})
    with pytest.raises(ValueError, match=r"run\.npz: the array "):
        Trajectory.load(tmp_path / "run")


@pytest.mark.parametrize(
    "text", [b"", b"{", b"[]", b"1", b"\xff\xfe{\0}\0\0", b"[" * 100_000, b'{"a": ' + b"9" * 5000 + b"}"]
)
def test_what_is_no_json_object_is_named(tmp_path, text):
    RUN.save(tmp_path / "run")
    (tmp_path / "run.json").write_bytes(text)
    with pytest.raises(ValueError, match=r"run\.json: damaged; take an undamaged copy"):
        Trajectory.load(tmp_path / "run")


@pytest.mark.parametrize("cut", [0, 1, 30, 300, -1])
def test_an_archive_that_was_cut_off_is_named(tmp_path, cut):
    RUN.save(tmp_path / "run")
    path = tmp_path / "run.npz"
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(ValueError, match=r"run\.npz: damaged, or no \.npz file"):
        Trajectory.load(tmp_path / "run")


@pytest.mark.parametrize(
    "line",
    [
        b"[]",
        b"{",
        b"[" * 100_000,
        b'{"iteration": 3}',
        b'{"iteration": 3, "x": X, "f": "1", "status": "ok", "accepted": false, "miss": 1.0}',
        b'{"iteration": 3, "x": X, "f": true, "status": "ok", "accepted": false, "miss": 1.0}',
        b'{"iteration": 3, "x": X, "f": 9, "status": 7, "accepted": false, "miss": 1.0}',
        b'{"iteration": 3, "x": X, "f": 9, "status": "ok", "accepted": 7, "miss": 1.0}',
        b'{"iteration": 3, "x": X, "f": 9, "status": "\xff", "accepted": false, "miss": 1.0}',
        b'{"iteration": 3, "x": X, "f": 9, "status": "ok", "accepted": false, "miss": 1.0, "more": 1}',
    ],
)
def test_a_damaged_history_is_named_with_its_line(tmp_path, line):
    path = tmp_path / "history.jsonl"
    minimize(sphere, np.ones(3), history=path, **SEARCH)
    lines = path.read_bytes().split(b"\n")
    lines[4] = line.replace(b"X", json.dumps(json.loads(lines[4])["x"]).encode())
    path.write_bytes(b"\n".join(lines))
    with pytest.raises(ValueError, match=r"history\.jsonl, line 5: .*delete this line and all below to resume"):
        minimize(sphere, np.ones(3), history=path, resume=True, **SEARCH)
    assert path.read_bytes() == b"\n".join(lines)


def test_what_is_no_number_in_a_table():
    texts = ["1_0", "١", "0x1", "nan", "inf", "", "-", "1.2.3", "1" * 100_000 + "x"]
    assert [math.isnan(number(text)) for text in texts] == [True] * len(texts)
    assert [number(text) for text in ("-1.5e3", " .5 ", "2.", "+7", "1e999")] == [-1500.0, 0.5, 2.0, 7.0, math.inf]


@pytest.mark.parametrize("text", ["1_0", "١", "9" * 200_000, "\0", "1\0" * 20])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1"])
def test_every_table_names_the_file_in_what_is_wrong(tmp_path, text, encoding):
    heads = {read_angles: "time_s,hip", read_recording: "time [s],reference [rad],angle [rad]", precision.read: "a,b"}
    path = tmp_path / "täble.csv"
    for read, head in heads.items():
        rows = "".join(f"{0.01 * k},{text},é\n" for k in range(12))
        path.write_bytes(f"{head}\n{rows}".encode(encoding, "replace"))
        with pytest.raises(ValueError, match=r"täble\.csv"):
            read(path)


def test_every_table_may_begin_with_a_byte_order_mark(tmp_path):
    (tmp_path / "a.csv").write_text("time_s,hip\n0.0,1.0\n", "utf-8-sig")
    assert read_angles(tmp_path / "a.csv")[2] == ("hip",)
    rows = "".join(f"{0.01 * k},0.0,0.0\n" for k in range(12))
    (tmp_path / "b.csv").write_text(f"time [s],reference [rad],angle [rad]\n{rows}", "utf-8-sig")
    assert len(read_recording(tmp_path / "b.csv").time) == 12


# ---------------------------------------------------------------------------------------------- around it


def test_a_link_to_nowhere_is_named(tmp_path, capsys):
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "gone")
    for out in (link, link / "below"):
        assert cli.main(["info", "arm7", "--out", str(out)]) == 2
        said = f"--out {out}: {link} is a link to {tmp_path / 'gone'}, which is not there; give another folder"
        assert said in capsys.readouterr().err


def test_a_seed_beyond_what_the_search_takes_is_named():
    AdaptiveSimulatedAnnealing(np.ones(2), amplitude=1.0, seed=2**128 - 1).ask()
    with pytest.raises(ValueError, match=r"seed = .* must be .* below 2\*\*128"):
        AdaptiveSimulatedAnnealing(np.ones(2), amplitude=1.0, seed=2**128)


@pytest.mark.quick("True")
@pytest.mark.parametrize("buffered", [True, False])
def test_a_reader_that_goes_away_changes_neither_files_nor_exit_code(tmp_path, buffered):
    command = [sys.executable, *([] if buffered else ["-u"]), "-m", "featherstone_gait", "info", "arm7"]
    path = os.pathsep.join(sys.path)
    with subprocess.Popen(
        [*command, "--out", str(tmp_path)], env=os.environ | {"PYTHONPATH": path},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        process.stdout.close()
        errors = process.stderr.read()
    assert (process.returncode, errors) == (0, b"")
    assert (tmp_path / "arm7_info.txt").stat().st_size > 1000


@pytest.mark.long
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no device that is always full")
def test_an_output_that_is_full_is_named(tmp_path):
    path = os.pathsep.join(sys.path)
    command = [sys.executable, "-m", "featherstone_gait", "info", "arm7", "--out", str(tmp_path)]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            command, env=os.environ | {"PYTHONPATH": path}, stdout=full, stderr=subprocess.PIPE, text=True
        )
    said = "error: standard output cannot be written (No space left on device); send it elsewhere\n"
    assert (done.returncode, done.stderr) == (2, said)


def test_workers_that_die_again_and_again_end_in_a_sentence(tmp_path):
    class KilledWorker(Exception):
        """As dask raises it."""

    class Dying:
        def submit(self, *_):
            future = Future()
            future.set_exception(KilledWorker("Attempted to run task on 4 different workers"))
            return future

    (tmp_path / "study.toml").write_text(STUDY)
    study = read_study(tmp_path / "study.toml")
    with pytest.raises(OSError, match=r"workers ended .*4 different workers.*; 0 of 2 runs are kept in .*start the"):
        run_study(study, tmp_path, executor=Dying())


def test_a_history_reaches_the_disk_from_time_to_time(tmp_path, monkeypatch):
    from featherstone_gait.base import line_file
    from featherstone_gait.search import history

    times, clock = [], iter(np.arange(0.0, 1000.0, 0.3))
    monkeypatch.setattr(history.time, "monotonic", lambda: next(clock))
    monkeypatch.setattr(line_file.os, "fsync", lambda _: times.append(0))
    minimize(sphere, np.ones(3), history=tmp_path / "history.jsonl", **SEARCH)
    assert len(times) > 5


def test_a_disk_that_is_full_only_when_it_is_waited_for_ends_a_study(tmp_path, monkeypatch):
    from featherstone_gait.base import line_file

    def fsync(_):
        raise OSError(code, os.strerror(code))

    code = errno.ENOSPC
    monkeypatch.setattr(line_file.os, "fsync", fsync)
    (tmp_path / "study.toml").write_text(STUDY)
    with Log(tmp_path / "study.jsonl", read_study(tmp_path / "study.toml")) as log:
        row = {"status": "ok", "message": ""} | dict.fromkeys(log.numbers, 0.0)
        with pytest.raises(OSError, match=r"cannot be written \(No space.*make room.* of 2 runs are kept"):
            log.append([0], [row])
        code = errno.EINVAL  # of what is no disk, such as a pipe
        log.append([1], [row])


# ---------------------------------------------------------------------------------------------- files that expand


def taken(function):
    """The ValueError that a call raises, and the memory that it took [bytes]."""
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=r"run\.npz") as error:
            function()
        return str(error.value), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", ["channel_q", "final", "second_final", "error_q", "more"])
def test_arrays_of_other_shapes_are_refused_before_they_take_memory(tmp_path, name):
    RUN.save(tmp_path / "run")
    arrays = dict(np.load(tmp_path / "run.npz"))
    np.savez_compressed(tmp_path / "run.npz", **arrays | {name: np.zeros((2000, 2000))})
    text, memory = taken(lambda: Trajectory.load(tmp_path / "run"))
    assert "array" in text
    assert memory < 4_000_000  # of 32 MB


@pytest.mark.parametrize("read", [read_motion, read_walk, Trajectory.load])
def test_a_file_that_expands_beyond_measure_is_refused_by_its_headers(tmp_path, read):
    RUN.save(tmp_path / "run")
    with zipfile.ZipFile(tmp_path / "run.npz", "w") as archive, archive.open("final.npy", "w") as entry:
        header = {"descr": "<f8", "fortran_order": False, "shape": (10**11,)}
        np.lib.format.write_array_header_1_0(entry, header)
    text, memory = taken(lambda: read(tmp_path / "run.npz"))
    assert "800000000000 bytes" in text
    assert memory < 4_000_000


@pytest.mark.parametrize("header", [b"", b"\x93NUMPY\x01\x00", b"no header at all, but text of some length"])
def test_a_wrong_header_of_an_array_is_damage(tmp_path, header):
    with zipfile.ZipFile(tmp_path / "run.npz", "w") as archive:
        archive.writestr("final.npy", header)
    (tmp_path / "run.json").write_text("{}")
    with pytest.raises(ValueError, match=r"run\.npz: damaged"):
        Trajectory.load(tmp_path / "run")
