"""Kernels compiled beforehand give the same bits; if a store is not sound, or for something else, they are compiled."""

import json
import shutil
import struct
from pathlib import Path

import pytest
from test_cache import ONE, PROGRAM, run

from featherstone_gait import cli
from featherstone_gait.core.compile import jit
from featherstone_gait.core.compile.store import LEVELS, digest, levels

pytestmark = pytest.mark.skipif(not levels(), reason="this processor is of no level that has code")
ROOT = Path(__file__).parents[2]
NO_PICKLES = """
import pickle, featherstone_gait.core.tree.batch
def refuse(*_, **__):
    raise AssertionError("something is unpickled")
pickle.loads = pickle.load = pickle.Unpickler = refuse
"""
CALLED = """
import numba
from featherstone_gait.core.compile import jit
from featherstone_gait.core.tree.batch import exponential

alone = exponential(1.0)
stored = [type(made) is jit.Stored for made in exponential.overloads.values()]
within = numba.njit(lambda x: exponential(x))(1.0)
print(int(alone == exponential(1.0) == within), sum(stored), exponential.stats.cache_misses.total(), jit.CACHE_FOLDER)
"""
WITHOUT_TEXT = """
from featherstone_gait.core.compile import jit, taped_cost

assert taped_cost._sweep.py_func.__doc__ is None
tape, stats = taped_cost.Tape(4), taped_cost._sweep.stats
taped_cost._sweep(tape.numbers, tape.links, tape.first)
print("done", stats.cache_hits.total(), stats.cache_misses.total(), jit.CACHE_FOLDER)
"""
E = "0x1.5bf0a8b14576ap+1"  # exp(1) of the package

FEEDBACK = """
import hashlib
from pathlib import Path
import numba
import numpy as np
from featherstone_gait import Ground, compile_scene, load_robot, simulate
from featherstone_gait.core.compile import jit
from featherstone_gait.walking import read_walk

scene = compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3)
walk = read_walk(Path(scene.model.source).parent / "balanced_gait.npz")
given = {"reference": walk.reference(1), "controller": walk.controller(scene)}
run = simulate(scene, 0.5, **given, estimate_error=False)
square = numba.njit(lambda x: np.full(3, x) ** 2)(2.0)  # arrays of Numba live beside those of the store
print(hashlib.sha256(run.final.tobytes()).hexdigest()[:16], int(square.sum()), 0, jit.CACHE_FOLDER)
"""


def filled_with(program, folder):
    """The store of a program at all levels."""
    (folder / "program.py").write_text(program, "utf-8")
    given = ["warm-up", str(folder / "program.py"), "--only", "--quiet", "--all-levels"]
    assert cli.main([*given, "--out", str(folder / "kernels")]) == 0
    return folder / "kernels"


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A store of one kernel."""
    return filled_with(ONE, tmp_path_factory.mktemp("filled"))


def copied(store, tmp_path):
    """A copy of a store in a cache that is else empty, and the variable that names this."""
    folder = tmp_path / "cache" / Path(jit.CACHE_FOLDER).name / "kernels"
    shutil.copytree(store, folder)
    return folder, {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}


@pytest.fixture
def store(filled, tmp_path):
    return copied(filled, tmp_path)


def compiled(cache):
    """The files of compiled code in a cache of Numba."""
    return [*Path(cache["NUMBA_CACHE_DIR"]).rglob("*.nbc")]


def of_one_level(store, level):
    """The variable that names a store, of which one level is left."""
    for other in {*LEVELS} - {level}:
        shutil.rmtree(store[0] / other)
    return store[1]


@pytest.mark.parametrize("level", levels())
def test_a_first_call_has_the_same_bits_and_neither_compiles_nor_unpickles(store, level):
    cache = of_one_level(store, level)
    assert run(ROOT, program=NO_PICKLES + ONE, **cache)[:3] == (E, 0, 0)
    assert compiled(cache) == []


@pytest.mark.long
def test_a_first_run_has_the_same_bits_and_neither_compiles_nor_unpickles(tmp_path):
    filled, expected = filled_with(PROGRAM, tmp_path), run(ROOT, NUMBA_CACHE_DIR=str(tmp_path / "compiled"))[0]
    for level in levels():
        cache = of_one_level(copied(filled, tmp_path / level), level)
        assert run(ROOT, program=NO_PICKLES + PROGRAM, **cache)[:3] == (expected, 0, 0)
        assert compiled(cache) == []


def change(folder, of, how):
    """Change files of a store of that kind."""
    for path in folder.rglob(of):
        path.write_bytes(how(path.read_bytes()))


@pytest.mark.quick("[*].o")
@pytest.mark.parametrize("of", ["manifest.json", "*.o"])
def test_damaged_files_are_told_and_their_kernels_compiled(store, of):
    folder, cache = store
    change(folder, of, lambda data: data[:-9] + bytes([data[-9] ^ 1]) + data[-8:])
    with pytest.warns(UserWarning, match="damaged") as said:
        assert run(ROOT, program=ONE, **cache)[:3] == (E, 0, 1)
    assert len(said) == 1


def test_a_manifest_that_was_edited_is_damaged(store):
    folder, cache = store
    change(folder, "manifest.json", lambda data: data.replace(b"batch.exponential", b"batch.exponent_al"))
    with pytest.warns(UserWarning, match="its digest is another"):
        assert run(ROOT, program=ONE, **cache)[:3] == (E, 0, 1)


@pytest.mark.quick("numba")
@pytest.mark.parametrize("name", ["numba", "python"])
def test_a_store_for_something_else_is_not_looked_at(store, name):
    folder, cache = store

    def for_another(data):
        content = json.loads(data)["content"]
        content["for"][name] = "another"
        return json.dumps({"sha256": digest(content), "content": content}).encode()

    change(folder, "manifest.json", for_another)
    assert run(ROOT, program=ONE, **cache)[:3] == (E, 0, 1)  # without a warning
    assert len(compiled(cache)) == 1


@pytest.mark.long
def test_settings_of_numba_that_change_code_leave_it_aside(store):
    assert run(ROOT, program=ONE, NUMBA_LOOP_VECTORIZE="0", **store[1])[:3] == (E, 0, 1)


def test_an_entry_that_compiled_code_calls_is_compiled_for_it(store):
    """Code of a store has an address and no more; what was called before goes on as it was."""
    assert run(ROOT, program=CALLED, **store[1])[:3] == ("1", 1, 1)


@pytest.mark.long
def test_a_kernel_without_a_docstring_is_loaded(tmp_path):
    (tmp_path / "sweep.py").write_text(WITHOUT_TEXT, "utf-8")
    store = tmp_path / "cache" / Path(jit.CACHE_FOLDER).name / "kernels"
    assert cli.main(["warm-up", str(tmp_path / "sweep.py"), "--only", "--quiet", "--out", str(store)]) == 0
    assert run(ROOT, program=WITHOUT_TEXT, NUMBA_CACHE_DIR=str(tmp_path / "cache"))[:3] == ("done", 0, 0)


def test_the_command_goes_on_from_what_is_there_and_says_what_fails(store, tmp_path, capsys):
    folder = store[0]
    (tmp_path / "page.md").write_text(f"# A page\n\n```python\n{ONE}\n```\n", "utf-8")
    (tmp_path / "beside.py").write_text("", "utf-8")
    (tmp_path / "wrong.py").write_text("import beside\nraise ValueError('of this program')", "utf-8")
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.o")}
    programs = [str(tmp_path / name) for name in ("wrong.py", "page.md")]
    assert cli.main(["warm-up", *programs, "--only", "--all-levels", "--out", str(folder)]) == 1
    out, err = capsys.readouterr()
    assert out.count("1 kernels") == len(LEVELS)
    assert "wrong.py: ValueError: of this program" in err
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*.o")} == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nosuch.py", "--only"], "nosuch.py is no file: name a program"),
        (["."], "is no file: name a program"),
        (["--only"], "--only has no program"),
        (["--processes", "0"], "from 1 to 1024"),
    ],
)
def test_wrong_words_are_refused_before_anything_runs(words, said, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        raise SystemExit(cli.main(["warm-up", *words, "--out", str(tmp_path / "store")]))
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
    assert not any((tmp_path / "store").rglob("*"))


def test_an_interrupted_command_ends_with_130_and_keeps_what_is_done(store, monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("featherstone_gait.core.compile.store_writer.record", interrupt)
    assert cli.main(["warm-up", "--quiet", "--all-levels", "--out", str(store[0])]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert run(ROOT, program=ONE, **store[1])[:3] == (E, 0, 0)


def test_a_store_beside_the_package_is_read_and_nothing_is_written_there(filled, tmp_path):
    shutil.copytree(ROOT / "featherstone_gait", tmp_path / "featherstone_gait", ignore=shutil.ignore_patterns("*.pyc"))
    kernels = tmp_path / "featherstone_gait" / "kernels"
    shutil.copytree(filled, kernels)
    before = sorted((tmp_path / "featherstone_gait").rglob("*"))
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    assert run(tmp_path, program=ONE, **environment)[:3] == (E, 0, 0)
    assert sorted((tmp_path / "featherstone_gait").rglob("*")) == before


def defined_globals(code):
    """Return the sorted names of the global symbols that a 64-bit ELF object defines (System V ABI, chapter 4)."""
    headers, size, count = struct.unpack_from("<Q", code, 40)[0], *struct.unpack_from("<HH", code, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", code, headers + size * k) for k in range(count)]
    names = []
    for _, kind, _, _, at, length, link, _, _, each in sections:
        if kind == 2:  # the table of symbols
            strings = sections[link][4]
            for symbol in range(at, at + length, each):
                name, info, _, section = struct.unpack_from("<IBBH", code, symbol)
                if info >> 4 == 1 and section != 0:  # global, and defined in a section
                    names.append(code[strings + name : code.index(b"\0", strings + name)].decode())
    return sorted(names)


def test_code_that_is_kept_holds_no_pickle_and_no_name_of_others(filled):
    """All global symbols that it defines are named by the key."""
    for path in filled.rglob("*.o"):
        assert b"builtins" not in path.read_bytes()
        assert defined_globals(path.read_bytes()) == [f"{what}_{path.stem}" for what in ("call", "environment", "run")]


@pytest.mark.long
def test_a_controller_of_the_package_is_kept_and_gives_the_bits_of_test_hashes(tmp_path):
    (tmp_path / "feedback.py").write_text(FEEDBACK, "utf-8")
    store = tmp_path / "cache" / Path(jit.CACHE_FOLDER).name / "kernels"
    assert cli.main(["warm-up", str(tmp_path / "feedback.py"), "--only", "--quiet", "--out", str(store)]) == 0
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    assert run(ROOT, program=FEEDBACK, **cache)[:2] == ("c40d188dc5530e5e", 12)
    assert compiled(cache) == []
    assert "walking/balance.py: balance" in (store / levels()[0] / "manifest.json").read_text("utf-8")
