"""`featherstone-gait benchmark`: how fast, and how exact."""

from __future__ import annotations

from argparse import Namespace
from importlib import import_module

from .arguments import Commands, add_command

BENCHMARKS = {  # modules of `featherstone_gait.benchmark`, and the files they write
    "speed": "speed.csv, speed_steps.csv, speed.png",
    "servo": "servo_arm.csv, servo_pd.csv, servo.png",
    "walk": "walk.csv, walk.png",
    "stress": "stress.csv, stress.png",
    "default": "default.csv, default_integrators.csv, default.png",
    "skip": "skip.csv",
    "session": "session.csv",
    "first": "first.csv",
    "attack": "attack_files.csv, attack_api.csv",
    "stability": "stability.csv, stability.png",
    "precision": "precision.csv, precision.png",
    "linearise": "linearise.csv",
    "peers": "peers.csv, peers_speed.csv, peers_lines.csv, peers.png",
}


def add(commands: Commands) -> None:
    """Register the command."""
    files = "; ".join(f"{name}: {files}" for name, files in BENCHMARKS.items())
    parser = add_command(commands, "benchmark", run, "run a benchmark", f"tables and a picture ({files})")
    parser.add_argument("name", metavar="NAME", choices=BENCHMARKS, help=" or ".join(BENCHMARKS))
    parser.add_argument("--full", action="store_true", help="repeat everything more often")


def run(args: Namespace) -> int:
    import_module(f"featherstone_gait.benchmark.{args.name}").run(args.out, full=args.full)
    return 0
