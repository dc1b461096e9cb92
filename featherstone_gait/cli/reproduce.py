"""Run the paper's experiments, or continue them, and compare each result with the paper.

Writes reproduction.html, .md and .csv, and the folder reproduction_files (pictures, and finished experiments to
continue from).

Takes some four minutes on two cores; after Ctrl-C the same command goes on.

  featherstone-gait reproduce servo_step arm_fall
  featherstone-gait reproduce --full --out paper
"""

from __future__ import annotations

import sys
from argparse import Namespace

from ..reproduction import EXPERIMENTS
from .arguments import Commands, add_command, add_quiet, announce


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    parser.add_argument("names", metavar="NAME", nargs="*", help=f"{', '.join(EXPERIMENTS)} (default: all)")
    parser.option("--full", "more runs and finer steps, as for docs/reproduction; takes an hour or more", False)
    parser.option("--seed", "seed of all random numbers", 0, metavar="N")
    add_quiet(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..reproduction.report import expected, reproduce

    minutes, size = max(expected(args.names, args.full), 1), "full" if args.full else "quick"
    announce(args, f"about {minutes:.0f} min at {size} size on two cores, with finished experiments kept")
    try:
        entries = reproduce(args.names, args.out, full=args.full, seed=args.seed, progress=True)
    except KeyboardInterrupt:
        print("finished experiments are kept: the same command goes on from there", file=sys.stderr)
        raise
    for entry in entries:
        print(entry.name + (f": failed: {entry.failure}" if entry.failure else ""))
        for claim in entry.claims:
            print(f"  {claim.item or 'own':10} {claim.word:23} {claim.claim}")
    print(f"files: {args.out / 'reproduction.html'}, {args.out / 'reproduction.md'}")
    return 1 if any(entry.failure for entry in entries) else 0
