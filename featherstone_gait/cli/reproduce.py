"""Run the paper's notebooks, collect what they judge, and write the page of the paper.

Writes the outputs of the notebooks, docs/paper.md, and docs/reproduction/reproduction.html and .csv of the source tree.

Takes some four minutes on two cores.

  featherstone-gait reproduce
  featherstone-gait reproduce 02_arm
"""

from __future__ import annotations

import sys
from argparse import Namespace

from .arguments import Commands, add_command, add_quiet, announce


def add(commands: Commands) -> None:
    """Register the command."""
    where = "source tree whose notebooks run and whose pages are written (default: that of this package)"
    parser = add_command(commands, run, __doc__, where=where)
    parser.add_argument("names", metavar="NAME", nargs="*", help="notebooks, without ending (default: all)")
    add_quiet(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..reproduction import report

    source = args.out or report.SOURCE
    report.check(args.names, source)
    announce(args, "about 4 min on two cores; notebooks that ran are stored")
    try:
        rows = report.reproduce(args.names, source, progress=not args.quiet)
    except RuntimeError as error:
        print("error:", error, file=sys.stderr)
        return 1
    for row in rows:
        print(f"{row.verdict:13}{row.statement.place:14}{row.statement.says}\n{'':27}here: {row.ours}")
    print(f"{report.counts(rows)}\nfiles: {source / 'docs/paper.md'}, {source / 'docs/reproduction/reproduction.html'}")
    return 0
