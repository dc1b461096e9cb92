"""Studies on a cluster: a real scheduler and two worker processes on this machine."""

import importlib
import os
import signal
import threading
import time
from collections import Counter

import pytest

from featherstone_gait.study import read_study, run_study

STUDY = """
robot = "ax12_arm"
experiment = "hold"
duration = 10.0
[vary]
servo.Kp = {from = 20.0, to = 80.0, count = 12}
posture.tilt = {from = -0.2, to = 0.2, count = 40}
"""
ONE_THREAD = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
BATCH = 8


def distributed():
    """The library, where a test asks for it: it is slow to import."""
    return importlib.import_module("distributed")


def test_same_bytes_as_local(tmp_path):
    """On a scheduler of this process."""
    path = tmp_path / "study.toml"
    path.write_text(STUDY.replace("count = 40", "count = 4"), "utf-8")
    study = read_study(path)
    local = run_study(study, tmp_path / "local").table.read_bytes()
    with distributed().Client(processes=False, n_workers=2, threads_per_worker=1, dashboard_address=None) as client:
        there = run_study(study, tmp_path / "there", executor=client.get_executor(), batch=BATCH)
    assert there.table.read_bytes() == local


@pytest.fixture(scope="module")
def cluster():
    """Two worker processes of one thread each."""
    options = {"host": "127.0.0.1", "dashboard_address": None, "env": ONE_THREAD, "silence_logs": 50}
    with distributed().LocalCluster(n_workers=2, threads_per_worker=1, processes=True, **options) as made:
        yield made


@pytest.mark.long
def test_same_bytes_as_local_streamed_back_though_a_worker_is_killed(cluster, tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY, "utf-8")
    study = read_study(path)
    local = run_study(study, tmp_path / "local").table.read_bytes()
    with distributed().Client(cluster) as client:
        assert len(set(client.run(os.getpid).values())) == 2
        whole = run_study(study, tmp_path / "whole", executor=client.get_executor(), batch=BATCH)
        assert whole.table.read_bytes() == local

        computed = seen_by(cluster)
        log = tmp_path / "killed" / "study.jsonl"
        rows = []
        killer = threading.Thread(target=kill_one, args=(log, sorted(client.run(os.getpid).values())[0], rows))
        killer.start()
        killed = run_study(study, tmp_path / "killed", executor=client.get_executor(), batch=BATCH)
        killer.join()
        again = [count for count in (seen_by(cluster) - computed).values() if count > 1]
    assert killed.table.read_bytes() == local
    assert 0 < rows[0] < len(study)  # results had come back before the end
    assert log.read_bytes().count(b"\n") == 1 + len(study)
    # Of 60 batches: what the worker had in hand, waiting, and done but not yet fetched; not its half of the study.
    assert len(again) <= 10


@pytest.mark.long
def test_workers_have_the_integrators_that_other_packages_add(cluster, tmp_path):
    path = tmp_path / "study.toml"
    text = 'robot = "ax12_arm"\nexperiment = "hold"\nduration = 0.5\n[vary]\nservo.Kp = [20.0, 80.0]\n[scene]\n'
    path.write_text(text + "gearbox = 'standard'\nintegrator = 'simtwo'\n", "utf-8")
    with distributed().Client(cluster) as client:
        outcome = run_study(read_study(path), tmp_path / "paper", executor=client.get_executor())
    assert outcome.statuses == {"ok": 2}


def kill_one(log, pid, rows):
    """Kill a worker once some batches are back; note how many runs there were."""
    while not log.exists() or log.read_bytes().count(b"\n") <= 2 * BATCH:
        time.sleep(0.002)
    os.kill(pid, signal.SIGKILL)
    rows.append(log.read_bytes().count(b"\n") - 1)


def seen_by(cluster):
    """How often each task was handed to a worker."""
    return Counter(entry[0] for entry in cluster.scheduler.transition_log if entry[2] == "processing")
