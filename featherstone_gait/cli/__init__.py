"""The command line, `featherstone-gait COMMAND`.

A command is a module with `add`, which registers it, and `run`, from its arguments to an exit code; what it needs is
imported where it is used, so that `--help` answers at once.  Exit codes: 0 done, 1 the simulation ended with another
status than "ok" or an experiment failed, 2 an argument or a file is wrong (one line says which), 130 interrupted.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .. import __version__
from . import benchmark, check_robots, info, optimize, reproduce, simulate, study

COMMANDS = (info, check_robots, simulate, optimize, study, benchmark, reproduce)


def main(argv: list[str] | None = None) -> int:
    """Run a command; return its exit code."""
    args = _parser().parse_args(argv)
    try:
        _make_folder(args.out)
        return args.run(args)
    except (ValueError, OSError) as error:
        print("error:", " ".join(str(error).split()), file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def _make_folder(path: Path) -> None:
    """Raises ValueError where a file, at the path or above it, is in the way."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        file = next(each for each in (path, *path.parents) if each.exists())
        raise ValueError(f"--out {path}: {file} is a file, not a folder; give another folder, or move it") from error


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="featherstone-gait", description="Simulate servo-driven robots.")
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for command in COMMANDS:
        command.add(commands)
    return parser
