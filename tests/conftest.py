"""How tests are shared out among workers, and workers share what they compile, which is where nearly all time goes.

A file is one worker's, so that its fixtures are made once; the tests of a file in APART are shared out one by one.
Files whose tests take longest come first, so that no worker is left alone with one at the end.  What one worker
compiles the others wait for and then read from the cache; one worker more than there are cores works meanwhile.

`--share K/N` takes one of N slices of the long tests that take about as long: of neighbors, which share what they
compile.
"""

import gc
import math
import os
import sys
from collections import Counter
from fnmatch import fnmatchcase
from itertools import accumulate
from pathlib import Path

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded: threads of all workers would wait awake

from featherstone_gait.core.compile import progress
from featherstone_gait.core.compile.jit import JIT

TESTS = Path(__file__).parent
ROOMS = [str(path) for path in sorted(TESTS.iterdir()) if path.is_dir() and path.name[0] not in "._"]
sys.path.extend(ROOMS)  # what tests share is in support/; processes that they start find it too
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(TESTS.parent), *ROOMS, os.environ.get("PYTHONPATH")]))

import kinds  # noqa: E402, from support/

APART = """
    notebooks docs docs_tables published_robots adjoint examples fields_have_effect gradient_laws loops_between_robots
    loops_in_scenes loops_in_time surfaces tendons
""".split()
LONGEST = """
    notebooks gear_friction integrators simulation crash optimize worlds study springs
    crosscheck firmware error_estimate ars343 cache maximal cli linearization physics_servo walking coupling
    equilibrium physics_contact session controller limits cost plan simulation_reproducibility physics_shapes
    continued preflight supply cheapest_plan
""".split()
SECONDS = """
    fields_have_effect 900 gradient_laws 750 docs 694 loops_between_robots 370 notebooks 150 loops_in_scenes 290
    fuzz_calls 245 packaged_scenes 242 tendons 220 sweep 219 optimize 210 adjoint 208 loops_in_time 200 cli 181
    surfaces 178 cache 165 fuzz_files 164 coupling 160 benchmark_first 155 study 50 feedback 119 docs_tables 112
    loops_in_control 111 joint_springs 105 firmware 104 integrators 104 examples 100 rolling_long 97 worlds 96
    equilibrium 95 servo_bench 94 tendon_friction 90 benchmark_default 90 contacts 88 gear_friction 87
    identification 83 field_pairs_long 78 hashes_of_scenes 77 tendon_drives 75 pair_truths_long 75 interrupt 74
    controller 74 benchmark_precision 65 loop_switches 64 scene_file 63 physics_servo 62 fluids 58 loads 55 forest 55
    stacks_long 54 edges 53 simulation 50 timed_switches 49 exact_linearization 49 physics_shapes 49 supply 46
    rolling_on_ground 45 crosscheck 45 pair_bits_long 43 gradient 42 torque_controller 37 cheapest_plan 36
    gradient_doubts 36 gradient_check 35 scoreboard 33 ball_joints_long 33 kick 31 pair_orders_long 31 session 31
    store 29 walks_with_loops 29 linearization 28 continued 28 moving_surfaces 28 servo_curve 27 published_feet 27
    error_estimate 27 wrap 24 sensors 23 drag 23 size 23 grasp_long 21 ball_springs 21 remedies 21 drive 20
""".split()
SECONDS = {name: float(seconds) for name, seconds in zip(SECONDS[::2], SECONDS[1::2])}  # of a file's long tests, about


def _file(nodeid):
    return nodeid.partition("::")[0].rpartition("/")[2].removeprefix("test_").removesuffix(".py")


def _slice(items, k, n):
    """Return the tests of slice k of n."""
    long = Counter(_file(item.nodeid) for item in items if item.get_closest_marker("long"))
    each = {name: SECONDS.get(name, 0.3 * count) / count for name, count in long.items()}
    takes = [each[_file(item.nodeid)] if item.get_closest_marker("long") else 0.0 for item in items]
    share = (sum(takes) or 1.0) / n
    middles = (end - 0.5 * own for end, own in zip(accumulate(takes), takes))
    return [item for item, middle in zip(items, middles) if min(n - 1, int(middle / share)) == k]


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
    place = {name: k for k, name in enumerate(LONGEST)}
    for item in items:
        quick = item.get_closest_marker("quick")
        if quick and not any(fnmatchcase(item.callspec.id, case) for case in quick.args):
            item.add_marker("long")
    if share := config.getoption("share"):
        mine = _slice(items, *map(int, share.split("/")))
        config.hook.pytest_deselected(items=[*set(items) - set(mine)])
        items[:] = mine
    if config.option.markexpr == "long":
        place = {name: -seconds for name, seconds in SECONDS.items()}
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
