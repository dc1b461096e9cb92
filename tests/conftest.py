"""How tests are shared out among workers, and workers share what they compile, which is where nearly all time goes.

A file is one worker's, so that its fixtures are made once; the tests of a file in APART are shared out one by one.
Files whose tests take longest come first, so that no worker is left alone with one at the end.  What one worker
compiles the others wait for and then read from the cache; one worker more than there are cores works meanwhile.
"""

import gc
import math
import os
import sys
from fnmatch import fnmatchcase
from pathlib import Path
from zlib import crc32

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: threads of all workers would wait awake

from featherstone_gait.core.compile import progress
from featherstone_gait.core.compile.jit import JIT

TESTS = Path(__file__).parent
ROOMS = [str(path) for path in sorted(TESTS.iterdir()) if path.is_dir() and path.name[0] not in "._"]
sys.path.extend(ROOMS)  # what tests share is in support/; processes that they start find it too
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(TESTS.parent), *ROOMS, os.environ.get("PYTHONPATH")]))

import kinds  # noqa: E402, from support/

APART = ("test_notebooks.py", "test_docs.py", "test_docs_tables.py", "test_published_robots.py")
LONGEST = """
    notebooks gear_friction integrators simulation crash optimize worlds study springs
    crosscheck firmware error_estimate ars343 cache maximal cli linearization physics_servo walking coupling
    equilibrium physics_contact session controller limits cost plan simulation_reproducibility physics_shapes
    continued preflight supply cheapest_plan
""".split()


def _file(nodeid):
    return nodeid.partition("::")[0].rpartition("/")[2]


def pytest_addoption(parser):
    parser.addoption("--share", help="K/N: run the tests of one of N shares alone, of which K counts from 0")


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config):
    """Guard what is compiled, and do not announce it: tests look at stderr."""
    kinds.guard(pytest.MonkeyPatch())
    progress.ANNOUNCED = math.inf


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect no garbage while test files are read: walking their syntax trees takes a third of that time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Tell the guard of kinds which test runs, if it is a quick one."""
    kinds.running[:] = [] if item.get_closest_marker("long") or not JIT else [item.nodeid]
    try:
        return (yield)
    finally:
        kinds.running.clear()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Mark as long what `quick` leaves out, keep one share if asked for, and put the longest tests first."""
    place = {f"test_{name}.py": k for k, name in enumerate(LONGEST)}
    for item in items:
        quick = item.get_closest_marker("quick")
        if quick and not any(fnmatchcase(item.callspec.id, case) for case in quick.args):
            item.add_marker("long")
    if share := config.getoption("share"):
        k, n = map(int, share.split("/"))
        mine = [crc32(item.nodeid.encode()) % n == k for item in items]
        config.hook.pytest_deselected(items=[item for item, one in zip(items, mine) if not one])
        items[:] = [item for item, one in zip(items, mine) if one]
    items.sort(key=lambda item: place.get(_file(item.nodeid), len(LONGEST)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    """One more than cores, of which one may wait for another's kernel."""
    return (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1) + 1


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A file to a worker, but those in APART."""
    from xdist.scheduler import LoadFileScheduling

    class Sharing(LoadFileScheduling):
        def _split_scope(self, nodeid):
            return nodeid if _file(nodeid) in APART else super()._split_scope(nodeid)

    config.option.loadscopereorder = False
    return Sharing(config, log) if config.getvalue("dist") == "loadfile" else None
