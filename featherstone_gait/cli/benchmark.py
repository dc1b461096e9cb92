"""`featherstone-gait benchmark`: how fast, and how exact."""

from __future__ import annotations

from argparse import Namespace
from importlib import import_module
from typing import NamedTuple

from .arguments import Commands, add_command, announce


class Benchmark(NamedTuple):
    """A module of `featherstone_gait.benchmark`."""

    what: str
    takes: str  # on two cores, all kernels to be compiled
    files: str


BENCHMARKS = {
    "speed": Benchmark(
        "times of algorithms and steps, beside MuJoCo's", "TIME", "speed.csv, speed_steps.csv, speed.png"
    ),
    "servo": Benchmark("stiff servos: what holds at which step", "TIME", "servo_arm.csv, servo_pd.csv, servo.png"),
    "walk": Benchmark("rollouts of a walk a second, beside MuJoCo's", "TIME", "walk.csv, walk.png"),
    "precision": Benchmark("run time against error of every integrator", "TIME", "precision.csv, precision.png"),
    "peers": Benchmark(
        "the same against Pinocchio, MuJoCo and SciPy", "TIME", "peers.csv, peers_speed.csv, peers_lines.csv, peers.png"
    ),
    "default": Benchmark(
        "what `simulate` gives where nothing is named", "TIME", "default.csv, default_integrators.csv, default.png"
    ),
    "stability": Benchmark("the largest stable step, against linear theory", "TIME", "stability.csv, stability.png"),
    "stress": Benchmark("whether a run that is wrong says so", "TIME", "stress.csv, stress.png"),
    "attack": Benchmark("damaged files and wrong arguments", "TIME", "attack_files.csv, attack_api.csv"),
    "skip": Benchmark("instructions that a missing feature saves (Linux)", "TIME", "skip.csv"),
    "session": Benchmark("robots stepped tick by tick, beside one call", "TIME", "session.csv"),
    "linearise": Benchmark("columns of a linear model, beside MuJoCo's", "TIME", "linearise.csv"),
    "first": Benchmark("CPU time to a first result", "TIME", "first.csv"),
}


def add(commands: Commands) -> None:
    """Register the command."""
    examples = ("featherstone-gait benchmark speed", "featherstone-gait benchmark precision --out results")
    what = "tables and mostly a picture, named below"
    takes = "minutes, at rest: what else runs on the machine is in its figures.  Each says how long as it begins"
    parser = add_command(commands, "benchmark", run, "run a benchmark", what, examples=examples, takes=takes)
    parser.add_argument("name", metavar="NAME", choices=BENCHMARKS, help="one of those below")
    parser.add_argument("--full", action="store_true", help="repeat everything more often")
    listed = [f"  {name:10} {each.what}: {each.takes}\n             {each.files}" for name, each in BENCHMARKS.items()]
    parser.epilog = "\n".join(["benchmarks:", *listed, "", parser.epilog or ""])


def run(args: Namespace) -> int:
    announce("much longer than " * args.full + BENCHMARKS[args.name].takes)
    import_module(f"featherstone_gait.benchmark.{args.name}").run(args.out, full=args.full)
    print("files: " + ", ".join(str(args.out / name) for name in BENCHMARKS[args.name].files.split(", ")))
    return 0
