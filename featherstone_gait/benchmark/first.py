"""Time a fresh process until its first result, import and compiling included, by kinds of scenes [CPU s].

`cold` starts from an empty cache.  `further` starts from a cache with the kinds of all lines above (empty for the first
line).  `cached` starts from a cache with this kind, `stored` from an empty cache and a store of compiled kernels, as a
wheel has them.  The difference of `cold` and `further` is the code that the kinds share.

    featherstone-gait benchmark first        ten minutes
"""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated, NamedTuple

from ..base.progress import progress_bar
from ..core.compile.jit import CACHE_FOLDER
from ..core.compile.store import levels
from ..core.compile.store_writer import record
from .table import machine, tabulate

TIMED = """
import time
from featherstone_gait import Ground, compile_scene, load_robot, simulate, simulate_batch
{}
print(time.process_time())
"""
COMMAND = """
import contextlib, io, time
from featherstone_gait.cli import main
with contextlib.redirect_stdout(io.StringIO()):
    assert main({}.split()) == 0
print(time.process_time())
"""
HUMANOID = 'scene = compile_scene(load_robot("humanoid"), gearbox="mipsd", ground=Ground(){})\n'
BY_DEFAULT, MIDPOINT = HUMANOID.format(""), HUMANOID.format(', integrator="midpoint"')
FED = """
from dataclasses import replace
from featherstone_gait import Supply, load_servo
from featherstone_gait.benchmark.skip import FIRMWARE
arm = load_robot("arm7")
fed = replace(arm, servos=dict.fromkeys(arm.joint_names, load_servo("ax12", **FIRMWARE)), supply=Supply(11.1, 0.3))
"""
SESSION = "from featherstone_gait import Session\nSession(scene, 8).step([[0.0] * 19] * 8)"
CONTROLLER = """
from featherstone_gait.benchmark.session import upright
simulate(scene, 0.1, controller=upright)
"""
FEEDBACK = """
from pathlib import Path
from featherstone_gait.walking import read_walk
robot = load_robot("humanoid", locked="simplified")
scene = compile_scene(robot, gearbox="mipsd", ground=Ground(), integrator="midpoint")
walk = read_walk(Path(scene.model.source).parent / "balanced_gait.npz")
simulate(scene, 0.1, reference=walk.reference(1), controller=walk.controller(scene))
"""
COMPANY = """
from featherstone_gait import Placed, Sphere, body
robot = load_robot("humanoid")
simulate(compile_scene([Placed(robot), {}], gearbox="mipsd", ground=Ground()), 0.1)
"""
TOUCHING = """
from featherstone_gait import Box, Placed, body
boxes = [Placed(body(Box((0.1, 0.1, 0.1)), 1.0), f"{{z:g}}", (0.0, 0.0, z)) for z in {}]
simulate(compile_scene(boxes, ground=Ground(), pairs={!r}), 0.1)
"""
BALL_JOINT = """
from featherstone_gait import Joint, Link, Model
links = Link("base"), Link("bob", 1.0, (0.1, 0.0, 0.0), (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3))
simulate(compile_scene(Model("pendulum", links, (Joint("shoulder", "ball", "base", "bob"),))), 0.1)
"""
LOOP = """
from featherstone_gait.benchmark.linkages import bricard
case = bricard()
simulate(case.scene, 0.1, case.state)
"""
CLOSED = """
from featherstone_gait import initial_state
from featherstone_gait.benchmark.linkages import closed, delta_robot, four_bar, parallel_ankle
"""
ANKLE = (
    CLOSED
    + """
scene = compile_scene(parallel_ankle())
simulate(scene, 0.1, initial_state(scene, closed(scene.model)))
"""
)
DRIVEN = (
    CLOSED
    + """
scene = compile_scene(four_bar(), gearbox="mipsd")
simulate(scene, 0.1, initial_state(scene, closed(scene.model, crank=1.0, coupler=-1.0, rocker=-1.5)))
"""
)
DELTA = (
    CLOSED
    + """
model = delta_robot()
scene = compile_scene(model, pairs="all"{})
simulate(scene, 0.1, initial_state(scene, {{model.name: closed(model)}}))
"""
)
LINKS = 'scene = compile_scene(load_robot("humanoid"), gearbox="mipsd", ground=Ground(), pairs="all")\n'
ABA = """
import numpy as np
from featherstone_gait import forward_dynamics
model = load_robot("humanoid")
q = np.zeros((NUMBER, model.nq))
q[:, 3] = 1.0
forward_dynamics(model, q, np.zeros((NUMBER, model.nv)), np.zeros((NUMBER, model.nv)))
"""
KINDS = {  # first results
    "forward dynamics": ABA.replace("NUMBER", "1"),
    "forward dynamics of eight at once": ABA.replace("NUMBER", "8"),
    "free arm": 'simulate(compile_scene(load_robot("arm7")), 0.1)',
    "pendulum on a ball joint": BALL_JOINT,
    "Bricard's closed loop": LOOP,
    "ankle on two rods": ANKLE,
    "four-bar with a servo": DRIVEN,
    "delta robot whose plates may touch": DELTA.format(""),
    "the same, dop853": DELTA.format(', integrator="dop853"'),
    "arm with rotors": 'simulate(compile_scene(load_robot("arm7"), gearbox="rotor"), 0.1)',
    "the same with firmware and supply": FED + 'simulate(compile_scene(fed, gearbox="rotor"), 0.1)',
    "humanoid on the ground": BY_DEFAULT + "simulate(scene, 0.1)",
    "two of them": COMPANY.format("Placed(robot, 'other', (3.0, 0.0))"),
    "one and a ball": COMPANY.format("Placed(body(Sphere(0.1), 1.0), position=(3.0, 0.0))"),
    "the same in lanes": MIDPOINT + "simulate_batch(scene, 0.1, states=[None] * 8)",
    "the same, midpoint": MIDPOINT + "simulate(scene, 0.1)",
    "the same, rtol 1e-9": BY_DEFAULT + "simulate(scene, 0.01, rtol=1e-9)",
    "a session of eight": BY_DEFAULT + SESSION,
    "a controller of the package": MIDPOINT + CONTROLLER,
    "a walk with feedback": FEEDBACK,
    "matrices of a tick": MIDPOINT + "from featherstone_gait import linearize\nlinearize(scene)",
    "two boxes": TOUCHING.format((0.05, 0.15), "none"),
    "two boxes that touch": TOUCHING.format((0.05, 0.15), "all"),
    "five boxes that touch": TOUCHING.format((0.05, 0.15, 0.25, 0.35, 0.45), "all"),
    "humanoid whose links touch": LINKS + "simulate(scene, 0.1)",
}
COMMANDS = "simulate arm7", "simulate humanoid"
PROGRAMS = {kind: TIMED.format(code) for kind, code in KINDS.items()} | {
    f"featherstone-gait {command}": COMMAND.format(repr(command)) for command in COMMANDS
}
REPEATS, REPEATS_FULL = 3, 9  # of what is cached; the least counts


class Row(NamedTuple):
    """One line of the table [CPU s]."""

    kind: Annotated[str, "CPU s to the first result", "<34"]
    cold: Annotated[float, "cold", "8.1f"]
    further: Annotated[float, "further", "8.1f"]
    cached: Annotated[float, "cached", "8.2f"]
    stored: Annotated[float, "stored", "8.2f"]


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Time all kinds in processes of their own, print the table, write first.csv; `full` repeats what is short."""
    host = machine()
    print(host)
    with tempfile.TemporaryDirectory() as folder:
        bar = progress_bar(PROGRAMS.items(), desc="first results", unit="kind", leave=False)
        return tabulate(out_dir / "first.csv", Row, (_row(kind, code, folder, full) for kind, code in bar), host)


def _row(kind: str, program: str, folder: str, full: bool) -> Row:
    repeats = REPEATS_FULL if full else REPEATS
    cold = seconds(program, f"{folder}/{kind}")
    cached = min(seconds(program, f"{folder}/{kind}") for _ in range(repeats))
    further, stored = seconds(program, f"{folder}/all"), math.nan
    if levels():
        made = Path(folder, kind, "stores", Path(CACHE_FOLDER).name, "kernels")
        made.mkdir(parents=True)
        record(program, made, levels()[:1])
        caches = [f"{folder}/{kind}/again{k}" for k in range(repeats)]
        stored = min(seconds(program, shutil.copytree(made.parents[1], cache)) for cache in caches)
    return Row(kind, cold, further, cached, stored)


def seconds(program: str, cache: str) -> float:
    """Run a process with its cache in that folder; return its CPU time [s]."""
    environment = os.environ | {"NUMBA_CACHE_DIR": cache, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", program]
    with tempfile.TemporaryDirectory() as room:  # for the files of commands
        run = subprocess.run(command, env=environment, cwd=room, capture_output=True, text=True)
    if run.returncode:
        raise RuntimeError(f"a process of the benchmark failed:\n{run.stderr}")
    return float(run.stdout.split()[-1])
