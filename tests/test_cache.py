"""The cache of compiled kernels: used by the next process, never stale, and dispensable."""

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import featherstone_gait
from featherstone_gait.core.compile import jit

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
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=package, env=clean | environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    result, hits, misses, folder = done.stdout.split()
    return result, int(hits), int(misses), Path(folder)


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
from featherstone_gait.core.effects.actuator import actuator_force, controller_of, motor_of, move_actuator, rotor_of

class Spring(NamedTuple):
    stiffness: np.ndarray
    PARTS = ()

@actuator_force.of(Spring)
def force(actuator, s, i, v, w, T, c):
    return T - FACTOR * actuator.stiffness[i] * s.y[s.o.q + i], 0.0, c, 0.0, 0.0

@move_actuator.of(Spring)
def move(actuator, s, i, v, w):
    pass

@rotor_of.of(Spring)
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


def test_without_a_place_to_write_everything_works(package, tmp_path):
    file = tmp_path / "file"
    file.write_text("no folder can be made in a file")
    blocked = {"NUMBA_CACHE_DIR": str(file / "a"), "XDG_CACHE_HOME": str(file / "b"), "TMPDIR": str(tmp_path)}
    result, hits, misses, folder = run(package, **blocked)
    assert (hits, misses) == (0, 1)
    assert folder.parent == tmp_path
    assert float.fromhex(result) != 0.0


def test_kernels_with_bounds_checks_have_a_folder_of_their_own(package, tmp_path):
    program = "from featherstone_gait.core.compile import jit; print(0, 0, 0, jit.CACHE_FOLDER)"
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    plain = run(package, program=program, **cache)
    checked = run(package, program=program, NUMBA_BOUNDSCHECK="1", **cache)
    assert plain[3] != checked[3]


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
