"""Run a benchmark.

Writes the tables and pictures listed with its name.

Takes the minutes listed with its name, on two cores; with --full many times that.

  featherstone-gait benchmark scoreboard --out results --resume
  featherstone-gait benchmark precision --out results
"""

from __future__ import annotations

import textwrap
from argparse import Namespace
from importlib import import_module
from typing import NamedTuple

from .arguments import LINE, Commands, add_command, add_quiet, announce


class Benchmark(NamedTuple):
    """A module of `featherstone_gait.benchmark`."""

    what: str
    files: str
    minutes: float  # on two cores, compiled before


PICTURES = "multibody", "servos", "contact", "walking"
ALONE = "times are valid only while nothing else runs"
BENCHMARKS = {
    "scoreboard": Benchmark(
        "error beside time in five engines, on public problems",
        "scoreboard.csv, scoreboard_lines.csv, " + ", ".join(f"scoreboard_{part}.png" for part in PICTURES),
        30,
    ),
    "speed": Benchmark("times of algorithms and steps, beside MuJoCo's", "speed.csv, speed_steps.csv, speed.png", 3),
    "walk": Benchmark("rollouts of a walk a second, beside MuJoCo's", "walk.csv, walk.png", 3),
    "rollouts": Benchmark(
        "the same at equal error, beside MuJoCo, MJX, MotrixSim",
        "rollouts.csv, rollouts_lines.csv, rollouts_parts.csv",
        10,
    ),
    "precision": Benchmark("run time against error of every integrator", "precision.csv, precision.png", 12),
    "default": Benchmark("what `simulate` gives by default", "default.csv, default_integrators.csv, default.png", 20),
    "stability": Benchmark("the largest stable step, against linear theory", "stability.csv, stability.png", 2),
    "stress": Benchmark("whether a run that is wrong says so", "stress.csv, stress.png", 5),
    "skip": Benchmark("instructions that a missing feature saves (Linux)", "skip.csv", 3),
    "session": Benchmark("robots stepped tick by tick, beside one call", "session.csv", 2),
    "judge": Benchmark("policies judged in many worlds: speed, and where it goes", "judge.csv", 2),
    "linearize": Benchmark("columns of a linear model, beside MuJoCo's", "linearize.csv", 2),
    "gradients": Benchmark("gradients of runs, beside MuJoCo's and Pinocchio's", "gradients.csv", 5),
    "objects": Benchmark("robots that carry, tread on, are hit; beside MuJoCo", "objects.csv", 3),
    "rays": Benchmark("rays a second of range sensors, beside MuJoCo's", "rays.csv", 1),
    "first": Benchmark("CPU time to a first result", "first.csv", 10),
}


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    parser.add_argument("name", metavar="NAME", choices=BENCHMARKS, help="one of the benchmarks below")
    parser.option("--full", "more repetitions", False)
    parser.option(
        "--only", "scoreboard: measure one part, and keep the others in the folder; default: kinds", metavar="PART"
    )
    parser.option("--resume", "scoreboard: keep the cases that the table in the folder has", False)
    add_quiet(parser)
    listed = []
    for name, each in BENCHMARKS.items():
        files = textwrap.fill(each.files, LINE, initial_indent=" " * 13, subsequent_indent=" " * 13)
        listed.append(f"  {name:10} {each.what}, {each.minutes:g} min\n{files}")
    parser.epilog = "\n".join(["benchmarks:", *listed, "", parser.epilog or ""])


def run(args: Namespace) -> int:
    """Run the benchmark of that name."""
    how = {name: value for name in ("only", "resume") if (value := getattr(args, name))}
    takes = {"scoreboard": ("only", "resume"), "default": ("only",)}
    refused = [f"--{name}" for name in how if name not in takes.get(args.name, ())]
    if refused:
        args.command.error(f"{args.name} does not take {' and '.join(refused)}: scoreboard takes both, default --only")
    minutes = f"about {BENCHMARKS[args.name].minutes:g} min on two cores"
    announce(args, f"{'many times ' * args.full}{minutes}, compiling aside; {ALONE}")
    import_module(f"featherstone_gait.benchmark.{args.name}").run(args.out, full=args.full, **how)
    print("files: " + ", ".join(str(args.out / name) for name in BENCHMARKS[args.name].files.split(", ")))
    return 0
