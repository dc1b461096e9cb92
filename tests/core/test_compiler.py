"""What the compiler of the kernels leaves out changes nothing that they do."""

import gc
import subprocess
import sys
from typing import NamedTuple

import numba
import numpy as np
import pytest

from featherstone_gait.core.compile import jit, progress
from featherstone_gait.core.compile.jit import ENTRY, JIT, apart, entry, inline, kernel

pytestmark = pytest.mark.skipif(
    not JIT or "pipeline_class" not in ENTRY, reason="is about what compiler.py makes"
)


class Pair(NamedTuple):
    first: np.ndarray
    second: np.ndarray


@kernel
def _part(pair, k):
    return pair.first[k:]


@inline
def _weight(k):
    return 2.0 if k == 0 else 3.0


@kernel
def _sum(x, k):
    total = 0.0
    for i in range(len(x)):
        total += _weight(k) * x[i]
    return total


@entry
def _weighed(pair, out):
    for i in range(len(out)):
        row = _part(pair, 1)
        kept = row if i > 1 else pair.second
        out[i] = _sum(kept, 0) + _sum(kept, 1)


def test_no_reference_is_counted_and_none_is_lost():
    pair, out = Pair(np.arange(4.0), np.ones(2)), np.zeros(5)
    before = [sys.getrefcount(x) for x in (*pair, out)]
    _weighed(pair, out)
    np.testing.assert_array_equal(out, [10.0, 10.0, 30.0, 30.0, 30.0])
    assert [sys.getrefcount(x) for x in (*pair, out)] == before
    (assembly,) = entry_of_its_own().inspect_asm().values()
    assert "NRT_incref" not in assembly
    assert "NRT_decref" not in assembly


def entry_of_its_own():
    """The entry, compiled here: what was read from the cache cannot be inspected."""
    compiled = numba.njit(_weighed.py_func, **ENTRY)
    compiled(Pair(np.arange(4.0), np.ones(2)), np.zeros(5))
    return compiled


def test_kernel_called_with_numbers_is_compiled_once():
    entry_of_its_own()
    assert len(_sum.signatures) == len(_weight.signatures) == 1


@apart
def _doubled(x, twice):
    return x + x if twice else x


@inline
def _first(x, out):
    if x is None:
        return _sum(out, out)  # no number: would not compile
    return _doubled(x[0], True) + _doubled(x[1], False)


def _of_what_is_there(x, out):
    out[0] = _first(x, out)


def test_what_stands_for_an_absent_argument_is_left_out_and_what_is_apart_is_not_merged():
    whole, out = numba.njit(_of_what_is_there, **ENTRY), np.zeros(1)
    whole(np.array([2.0, 3.0]), out)
    assert out[0] == 7.0
    assert len(_doubled.signatures) == 1
    (code,) = whole.inspect_llvm().values()
    assert [line for line in code.splitlines() if line.startswith("define") and "_doubled" in line]


def test_functions_of_others_call_kernels_with_all_that_these_call():
    @numba.njit
    def twice(x):
        return 2.0 * _sum(x, 1)

    assert twice(np.ones(3)) == 18.0


@entry
def _items(x, whole, flags, i, out):
    """Write and read items by constants and numbers, forwards and from the end, whole rows and by columns."""
    x[-1, i] = 5.0
    x[i, -i] += 1
    whole[-i] = i
    flags[i] = True
    row, columns = x[-2], x.T
    row[1] = whole[0]
    out[0], out[1], out[2], out[3] = x[0, 0], x[-1, -1], x[i, 2], columns[2, -1]
    out[4], out[5], out[6] = row[-1], whole[-2] / 4, flags[-1]


def test_items_are_those_of_numpy():
    made = []
    for function in (_items, _items.py_func):
        whole, flags = np.array([7, 8, 9, 10]), np.zeros(3, bool)
        x, out = np.arange(12.0).reshape(3, 4), np.zeros(7)
        function(x, whole, flags, 2, out)
        made.append(np.concatenate([x.ravel(), whole, flags, out]))
    np.testing.assert_array_equal(*made)


@pytest.mark.parametrize("collects", [True, False])
def test_garbage_is_collected_again_after_compiling(collects):
    @entry
    def add(x):
        return x + 1.0

    was = gc.isenabled()
    try:
        (gc.enable if collects else gc.disable)()
        assert add(1.0) == 2.0
        assert gc.isenabled() == collects
    finally:
        (gc.enable if was else gc.disable)()


@pytest.mark.parametrize("terminal", [False, True])
def test_what_takes_more_than_a_second_is_said_once(terminal, monkeypatch, capsys, tmp_path):
    """Before it is compiled, with an estimate; on a terminal the line counts functions."""
    monkeypatch.setattr(jit, "CACHE_FOLDER", str(tmp_path))  # an empty one: a kernel that is kept is compiled no more
    monkeypatch.setattr(progress, "PATIENCE", -1.0)
    monkeypatch.setattr(progress, "ANNOUNCED", 1.0)
    monkeypatch.setattr("sys.stderr.isatty", lambda: terminal)

    @entry
    def tell(x):
        return 3.0 * x

    monkeypatch.setattr(jit, "estimate", lambda kinds: 7.0)
    assert tell(1.0) == 3.0
    said = "compiling tell (about 7 s, once, then kept)"
    assert capsys.readouterr().err == (f"\r{said + ': 1 functions, 0 s':79}\n" if terminal else f"{said}\n")
    assert tell(2.0) == 6.0
    assert capsys.readouterr().err == ""


def test_short_work_and_quiet_commands_say_nothing(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(jit, "CACHE_FOLDER", str(tmp_path))

    @entry
    def tell(x):
        return 3.0 * x

    monkeypatch.setattr(progress, "ANNOUNCED", 1.0)
    assert tell(1.0) == 3.0
    monkeypatch.setattr(jit, "estimate", lambda kinds: 7.0)
    monkeypatch.setattr("sys.stderr.plain", True, raising=False)  # as `--quiet` sets it
    assert tell(1) == 3.0
    assert capsys.readouterr().err == ""


@kernel
def _deepest(x):
    return x[0] + 1.0


@kernel
def _deep(x):
    return 2.0 * _deepest(x)


@entry
def _partly_dead(x, out):
    if len(out) < 0:
        out[0] = _deep(x)
    out[0] += _deepest(x)


def test_what_is_called_from_dead_code_takes_nothing_with_it():
    out = np.zeros(1)
    _partly_dead(np.ones(1), out)
    assert out[0] == 2.0


IMPORT = """
import sys, numba.core.codegen
{change}
from featherstone_gait.core.compile import jit
print("pipeline_class" in jit.ENTRY, jit.CACHE_FOLDER.endswith("_plain"))
"""


def importing(monkeypatch, compiler="", change=""):
    monkeypatch.setenv("FEATHERSTONE_GAIT_COMPILER", compiler)
    program = [sys.executable, "-c", IMPORT.format(change=change)]
    return subprocess.run(program, capture_output=True, text=True)


@pytest.mark.long
def test_the_setting_chooses_the_pipeline(monkeypatch):
    assert importing(monkeypatch).stdout.split() == ["True", "False"]
    assert importing(monkeypatch, "plain").stdout.split() == ["False", "True"]
    assert "'fast': set it to 'plain'" in importing(monkeypatch, "fast").stderr


def test_a_numba_without_the_internals_compiles_by_its_own_pipeline_and_says_so_once(monkeypatch):
    done = importing(monkeypatch, change="del numba.core.codegen.JITCodeLibrary")
    assert done.stdout.split() == ["False", "True"]
    assert len(done.stderr.splitlines()) == 1
    assert "JITCodeLibrary" in done.stderr
