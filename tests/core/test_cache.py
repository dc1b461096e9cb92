"""The cache of compiled kernels: used by the next process, never stale, and dispensable."""

import errno
import os
import random
import shutil
import subprocess
import sys
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import featherstone_gait
from featherstone_gait.core.compile import jit, sealed
from featherstone_gait.core.compile.sealed import SealedFiles

PROGRAM = """
from featherstone_gait.core.compile import jit
from featherstone_gait.core.tree import batch
from featherstone_gait.dynamics import forward_dynamics
from featherstone_gait.model import Joint, Link, Model

links = [Link(name, 1.0, (0.1, 0.0, 0.2), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)) for name in "ab"]
model = Model("pendulum", tuple(links), (Joint("j", "continuous", "a", "b"),))
result = forward_dynamics(model, [0.1], [0.2], [0.3])
stats = batch.aba_rows.stats
print(result[0].hex(), sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), jit.CACHE_FOLDER)
"""
ONE = """
from featherstone_gait.core.compile import jit
from featherstone_gait.core.tree.batch import exponential

result, stats = exponential(1.0), exponential.stats
print(result.hex(), stats.cache_hits.total(), stats.cache_misses.total(), jit.CACHE_FOLDER)
"""


@pytest.fixture
def package(tmp_path):
    """A copy of the package whose files may be edited."""
    copy = tmp_path / "copy"
    shutil.copytree(
        Path(featherstone_gait.__file__).parent,
        copy / "featherstone_gait",
        ignore=shutil.ignore_patterns("__pycache__", "*.nbi", "*.nbc"),
    )
    return copy


def run(package, *, program=PROGRAM, **environment):
    """Result, cache hits, cache misses and cache folder of a fresh process."""
    clean = {key: value for key, value in os.environ.items() if not key.startswith(("NUMBA_", "XDG_"))}
    clean["PYTHONDONTWRITEBYTECODE"] = "1"  # of Python's own, which would be cut short where files may not grow
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=package, env=clean | environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for line in done.stderr.splitlines():
        if not line.startswith("compiling "):
            warnings.warn(line, stacklevel=2)
    result, hits, misses, folder = done.stdout.split()
    return result, int(hits), int(misses), Path(folder)


def test_a_relative_folder_of_the_user_is_ignored(monkeypatch, tmp_path):
    """The XDG base directory specification asks to ignore relative paths."""
    monkeypatch.setenv("HOME", str(tmp_path))
    usual, own = tmp_path / ".cache", tmp_path / "own"
    for given, folder in (("here", usual), ("", usual), (str(own), own)):
        monkeypatch.setenv("XDG_CACHE_HOME", given)
        assert jit.user_cache() == str(folder / "featherstone_gait")


@pytest.mark.long
def test_the_next_process_compiles_nothing_and_an_edited_callee_is_compiled_anew(package, tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    first = run(package, **cache)
    assert first[1:3] == (0, 1)
    files = sorted(first[3].rglob("*.nb?"))
    assert files
    assert first[3].is_relative_to(tmp_path / "cache")

    second = run(package, **cache)
    assert second == (first[0], 1, 0, first[3])
    assert sorted(first[3].rglob("*.nb?")) == files

    source = package / "featherstone_gait" / "core" / "tree" / "spatial.py"
    original = source.read_text("utf-8")
    edited = original.replace("a[0] * b[0] + a[1] * b[1] + a[2] * b[2]", "2 * a[0] * b[0] + a[1] * b[1] + a[2] * b[2]")
    assert edited != original
    source.write_text(edited, "utf-8")
    third = run(package, **cache)
    assert third[1:3] == (0, 1)
    assert third[0] != first[0]
    assert third[3] != first[3]

    source.write_text(original, "utf-8")
    assert run(package, **cache) == second


LAW = """
from typing import NamedTuple
import numpy as np
from featherstone_gait.core.effects.actuator import actuator_force, controller_of, motor_of, move_actuator

class Spring(NamedTuple):
    stiffness: np.ndarray
    PARTS = ()

@actuator_force.of(Spring)
def force(actuator, step, i, v, w, T, c):
    return T - FACTOR * actuator.stiffness[i] * step.y[step.offsets.q + i], 0.0, c, 0.0, 0.0

@move_actuator.of(Spring)
def move(actuator, step, i, v, w):
    pass

@motor_of.of(Spring)
@controller_of.of(Spring)
def none(actuator):
    return None
"""
OUTSIDE = """
from dataclasses import replace
import numpy as np
from featherstone_gait import Joint, Link, Model, compile_scene, initial_state, simulate
from featherstone_gait.core.compile import jit
from featherstone_gait.core.integrate.rollout import rollout_one

links = [Link(name, 1.0, (0.1, 0.0, 0.2), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)) for name in "ab"]
model = Model("pendulum", tuple(links), (Joint("j", "continuous", "a", "b"),))
scene = compile_scene(model, integrator="implicit_euler")
PLACE
run = simulate(scene, 0.01, initial_state(scene, [0.3]))
stats = rollout_one.stats
print(run["q"][-1, 0].hex(), sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), jit.CACHE_FOLDER)
"""
DRIVEN = "import law; scene = replace(scene, constants=scene.constants._replace(actuator=law.Spring(np.ones(1))))"


@pytest.mark.long
def test_code_for_types_from_outside_is_never_stale_and_harms_nobody(package, tmp_path):
    cache, driven = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}, OUTSIDE.replace("PLACE", DRIVEN)
    (package / "law.py").write_text(LAW.replace("FACTOR", "1.0"), "utf-8")
    weak = run(package, program=driven, **cache)
    (package / "law.py").write_text(LAW.replace("FACTOR", "9.0"), "utf-8")
    strong = run(package, program=driven, **cache)
    assert strong[0] != weak[0]
    (package / "law.py").unlink()
    free = OUTSIDE.replace("PLACE", "")
    assert run(package, program=free, **cache)[0] == run(package, program=free, **cache)[0] != weak[0]


@pytest.mark.long
def test_kernels_of_a_module_that_adds_its_sources_are_kept_and_only_they_grow_stale(package, tmp_path):
    cache, driven = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}, OUTSIDE.replace("PLACE", DRIVEN)
    law = LAW + "\nfrom featherstone_gait.core.compile.jit import add_sources\nadd_sources(__name__, __file__)\n"
    free = OUTSIDE.replace("PLACE", "")
    assert [run(package, program=free, **cache)[1:3] for _ in range(2)] == [(0, 1), (1, 0)]
    (package / "law.py").write_text(law.replace("FACTOR", "1.0"), "utf-8")
    weak = run(package, program=driven, **cache)
    assert weak[1:3] == (0, 1)
    assert run(package, program=driven, **cache) == (weak[0], 1, 0, weak[3])
    (package / "law.py").write_text(law.replace("FACTOR", "9.0"), "utf-8")
    strong = run(package, program=driven, **cache)
    assert strong[1:3] == (0, 1)
    assert strong[0] != weak[0]
    assert run(package, program=free, **cache)[1:3] == (1, 0)


def test_without_a_place_to_write_everything_works_and_says_so_once(package, tmp_path):
    file = tmp_path / "file"
    file.write_text("no folder can be made in a file")
    blocked = {"NUMBA_CACHE_DIR": str(file / "a"), "XDG_CACHE_HOME": str(file / "b"), "TMPDIR": str(tmp_path)}
    program = ONE.replace("jit.CACHE_FOLDER)", "repr(jit.CACHE_FOLDER))")
    with pytest.warns(UserWarning, match="compiled kernels cannot be kept") as said:
        result, hits, misses, folder = run(package, program=program, **blocked)
    assert len(said) == 1
    assert (hits, misses, str(folder)) == (0, 1, "''")
    assert float.fromhex(result) != 0.0
    assert sorted(tmp_path.iterdir()) == [package, file]


@pytest.mark.long
def test_a_full_disk_is_said_once_and_stops_nothing(package, tmp_path):
    """Files may not grow: what is saved fails as on a full disk."""
    full = "import resource, signal; resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))\n" + PROGRAM
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    with pytest.warns(UserWarning, match=r"compiled kernels cannot be kept \(File too large\).*make room") as said:
        result = run(package, program=full, **cache)
    assert len(said) == 1
    assert not list(result[3].rglob("*.tmp.*"))
    assert run(package, **cache) == result
    assert run(package, **cache)[:3] == (result[0], 1, 0)


@pytest.mark.long
def test_a_damaged_file_is_compiled_anew(package, tmp_path):
    """Cut off, a bit turned, emptied, and taken from elsewhere; each time the next process finds it mended."""
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    first = run(package, **cache)
    for path in sorted(first[3].rglob("*.nb?")):
        whole = path.read_bytes()
        turned = bytearray(whole)
        turned[len(whole) // 2] ^= 4
        for damaged in (whole[:-100], bytes(turned), b""):
            path.write_bytes(damaged)
            with pytest.warns(UserWarning, match=f"{path.name}: damaged; its kernels are compiled anew"):
                assert run(package, **cache) == first
            assert run(package, **cache)[:3] == (first[0], 1, 0)


def sealed_files(folder):
    return SealedFiles(str(folder), "kernel", "stamp")


def test_a_sealed_file_is_whole_or_absent(tmp_path, monkeypatch):
    monkeypatch.setattr(sealed._log, "disabled", True)
    sealed_files(tmp_path).save("one", ["code of one"])
    chance, files = random.Random(3), {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert len(files) == 2
    for path, whole in files.items():
        for _ in range(300):
            damaged = bytearray(whole)
            for _ in range(chance.randint(1, 3)):
                damaged[chance.randrange(len(whole))] ^= 1 << chance.randrange(8)
            path.write_bytes(chance.choice([damaged, whole[: chance.randrange(len(whole))], whole + b"0"]))
            if path.read_bytes() != whole:
                assert sealed_files(tmp_path).load("one") is None
        path.write_bytes(whole)
    assert sealed_files(tmp_path).load("one") == ["code of one"]


def test_code_is_never_taken_for_another_version(tmp_path, monkeypatch):
    monkeypatch.setattr(sealed._log, "disabled", True)
    old = sealed_files(tmp_path)
    old.save("one", "code of one")
    index = tmp_path / "kernel.nbi"
    saved = index.read_bytes()
    index.write_bytes(b"lost")
    sealed_files(tmp_path).save("two", "code of two")  # takes the place of one
    index.write_bytes(saved)
    assert sealed_files(tmp_path).load("one") is None
    shutil.copy(tmp_path / "kernel.1.nbc", tmp_path / "kernel.2.nbc")
    with pytest.raises(OSError, match=r"^$"):
        sealed_files(tmp_path)._load_data("kernel.2.nbc")


def test_a_kernel_that_cannot_be_read_or_kept_is_told_and_stops_nothing(tmp_path, monkeypatch, caplog):
    def fail(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(jit, "CACHE_FOLDER", str(tmp_path))
    assert jit._load(fail, (), None) is None
    assert jit._save(fail, (), None) is None
    assert jit._save(fail, (), None) is None
    assert [f"{tmp_path}: a kernel cannot be read" in text for text in caplog.messages] == [True, False]
    assert f"{tmp_path}: compiled kernels cannot be kept (No space left on device)" in caplog.messages[1]


def test_folders_of_old_sources_are_cleared_but_the_last_three_and_those_in_use(tmp_path):
    def folder(name, age, lock="saving.lock"):
        made = tmp_path / name
        made.mkdir()
        (made / lock).touch()
        os.utime(made, (1e9, time.time() - age))
        return made

    day = 86400.0
    ours = [folder(f"{k:016x}", days * day) for k, days in enumerate([0.0, 0.1, 0.2, 0.3, 3.0, 4.0])]
    others = [folder("core_0123", 9 * day), folder("f" * 16, 9 * day, "other"), folder("e" * 16 + "_boundscheck", day)]
    jit.clear_old(str(ours[0]))
    assert sorted(tmp_path.iterdir()) == sorted([*ours[:4], *others])
    for k, path in enumerate(ours[1:4]):
        os.utime(path, (1e9, time.time() - (2 + k) * day))
    jit.clear_old(str(ours[0]))
    assert sorted(tmp_path.iterdir()) == sorted([*ours[:3], *others])
    jit.clear_old(str(others[2]))
    assert sorted(tmp_path.iterdir()) == sorted([*ours[:3], *others])


@pytest.mark.long
def test_kernels_with_bounds_checks_and_of_numbas_own_pipeline_have_folders_of_their_own(package, tmp_path):
    program = "from featherstone_gait.core.compile import jit; print(0, 0, 0, jit.CACHE_FOLDER)"
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "FEATHERSTONE_GAIT_COMPILER": ""}
    plain = run(package, program=program, **cache)
    checked = run(package, program=program, NUMBA_BOUNDSCHECK="1", **cache)
    numbas_own = run(package, program=program, **cache | {"FEATHERSTONE_GAIT_COMPILER": "plain"})
    assert len({plain[3], checked[3], numbas_own[3]}) == 3


def test_one_process_at_a_time_saves(tmp_path):
    fcntl = pytest.importorskip("fcntl")

    def taken():
        with (tmp_path / "saving.lock").open("ab") as other:
            try:
                fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
        return False

    with jit.one_process_at_a_time(tmp_path):
        assert taken()
    assert not taken()


@pytest.mark.long
def test_processes_that_compile_at_once_leave_a_sound_cache(package, tmp_path):
    """Each compiles another version of the same kernel; afterwards both versions load."""
    program = """
import sys
import numpy as np
from featherstone_gait.core.compile import jit
from featherstone_gait.core.tree import batch
from featherstone_gait.dynamics import forward_dynamics
from featherstone_gait.model import Joint, Link, Model

links = [Link(name, 1.0, (0.1, 0.0, 0.2), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)) for name in "ab"]
model = Model("pendulum", tuple(links), (Joint("j", "continuous", "a", "b"),), base=BASE)
nq, nv = (1, 1) if BASE == "fixed" else (8, 7)
result = forward_dynamics(model, np.ones(nq), np.zeros(nv), np.zeros(nv))
stats = batch.aba_rows.stats
print(float(result[-1]).hex(), sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), jit.CACHE_FOLDER)
"""
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    programs = [program.replace("BASE", repr(base)) for base in ("fixed", "floating")]
    with ThreadPoolExecutor() as pool:
        first = list(pool.map(lambda p: run(package, program=p, **cache), programs))
    assert [(hits, misses) for _, hits, misses, _ in first] == [(0, 1), (0, 1)]
    for p, (result, _, _, _) in zip(programs, first):
        assert run(package, program=p, **cache)[:3] == (result, 1, 0)


@pytest.mark.long
def test_of_processes_that_want_the_same_kernel_one_compiles_it(package, tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    with ThreadPoolExecutor() as pool:
        done = list(pool.map(lambda _: run(package, **cache), range(3)))
    assert sorted((hits, misses) for _, hits, misses, _ in done) == [(0, 1), (1, 0), (1, 0)]
    assert len({result for result, *_ in done}) == 1


def test_a_process_that_hangs_while_it_compiles_holds_up_no_other(tmp_path, monkeypatch):
    monkeypatch.setattr(jit, "PATIENCE", 0.2)
    path = tmp_path / "compiling" / "kind"
    with jit._alone(str(path)):
        begun = time.monotonic()
        with jit._alone(str(path)):
            assert 0.2 <= time.monotonic() - begun < 5.0
        with jit._alone(str(tmp_path / "compiling" / "another")):
            assert time.monotonic() - begun < 5.0


def test_where_nothing_can_be_written_nobody_waits(tmp_path):
    (tmp_path / "compiling").write_text("no folder")
    with jit._alone(str(tmp_path / "compiling" / "kind")):
        pass
