"""The command line, `featherstone-gait COMMAND`.

A command is a module with `add`, which registers it, and `run`, from its arguments to an exit code; what it needs is
imported where it is used, so that `--help` answers at once.  Exit codes: 0 done, 1 a simulation, or one of a study's,
ended with another status than "ok", or an experiment failed, 2 an argument or a file is wrong (one line says which),
130 interrupted.
"""

from __future__ import annotations

import gc
import os
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import Any, TextIO

from .. import __version__
from .arguments import LINE, Help, Parser

NAMES = "info check_robots simulate drive view optimize crosscheck judge export study servos identify benchmark "
NAMES += "warm_up reproduce"
COMMANDS = tuple(import_module(f".{name}", __name__) for name in NAMES.split())

ABOUT = "Simulate robots driven by hobby servos, and search for gaits that take less energy."
BEGIN = """where to start:
  featherstone-gait simulate humanoid      simulate a robot, plot and save the run
  featherstone-gait optimize               find a humanoid a gait (about a minute)
  featherstone-gait info my_robot.urdf     check your robot file
  featherstone-gait COMMAND --help         arguments, files written, duration

Robots that come with the package are called by name: arm7, arm7_spatial, ax12_arm, ax12_whole_arm, balancer, blimp, \
humanoid, line_follower, omni_robot, rov.

Exit codes: 0 done, 1 a simulation ended with a status other than ok or an experiment failed, 2 an argument or a file \
is wrong, 130 interrupted."""

FEWER = 500_000  # objects between two looks for garbage: imports make many that stay, a tenth of a short command's time


def main(argv: list[str] | None = None) -> int:
    """Run a command; return its exit code."""
    gc.set_threshold(FEWER)
    parser = _parser()
    args, unknown = parser.parse_known_args(argv)
    if unknown:
        (args.command or parser).unknown(unknown)
    if args.run is None:
        parser.print_help()
        return 0
    outputs = _Output("standard output", sys.stdout), _Output("errors", sys.stderr, getattr(args, "quiet", False))
    with redirect_stdout(outputs[0]), redirect_stderr(outputs[1]), _plain_warnings(args.command):
        try:
            _make_folder(args.out)
            code = args.run(args)
            sys.stdout.flush()
            return code
        except (ValueError, OSError) as error:
            print("error:", _tidy(args.command.in_options(_said(error))), file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            return 130


@contextmanager
def _plain_warnings(command: Parser) -> Iterator[None]:
    """Print warnings about a user's file without the line of this package that read it."""
    usual = warnings.formatwarning

    def plain(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> str:
        from ..robot_file import RobotFileWarning

        if issubclass(category, RobotFileWarning):
            said = command.in_options(f"warning: {message}")
            return textwrap.fill(said, LINE, break_long_words=False, break_on_hyphens=False) + "\n"
        return usual(message, category, *where, **more)

    warnings.formatwarning = plain
    try:
        yield
    finally:
        warnings.formatwarning = usual


def _tidy(text: str) -> str:
    """Put a message in one line, but for the problems of a file, which are indented lines of their own."""
    first, *problems = text.split("\n  ")
    return "\n  ".join(" ".join(part.split()) for part in (first, *problems))


def _said(error: ValueError | OSError) -> str:
    """Return the message of an error, with the file first if the system raised it."""
    if isinstance(error, FileNotFoundError) and error.filename is not None:
        return f"{os.fspath(error.filename)}: there is no such file; correct the path"
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{os.fspath(error.filename)}: {error.strerror}; check the path and its permissions"
    return str(error)


class _Output:
    """An output whose reader may go away: further text is lost, but files are still written.

    plain: whether it is no terminal for what is written, which then has no progress bars.
    """

    def __init__(self, name: str, stream: TextIO | None, plain: bool = False) -> None:
        self.name, self.stream, self.plain = name, stream or open(os.devnull, "w", encoding="utf-8"), plain

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def isatty(self) -> bool:
        return not self.plain and self.stream.isatty()

    def write(self, text: str) -> int:
        self._try(self.stream.write, text)
        return len(text)

    def flush(self) -> None:
        self._try(self.stream.flush)

    def _try(self, do: Callable, *arguments: str) -> None:
        try:
            do(*arguments)
        except OSError as error:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.stream.fileno())  # for what is printed later, at the end of the process too
            os.close(nowhere)
            if not isinstance(error, BrokenPipeError):
                raise OSError(f"{self.name} cannot be written ({error.strerror}); send it elsewhere") from error


def _make_folder(path: Path | None) -> None:
    """Make the output folder; raise ValueError if a file or a dangling link is in the way."""
    if path is None:
        return
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        file = next(each for each in (path, *path.parents) if os.path.lexists(each) and not each.is_dir())
        what = "a file, not a folder" if file.exists() else f"a link to {os.readlink(file)}, which is not there"
        raise ValueError(f"--out {path}: {file} is {what}; give another folder, or move it") from error


def _parser() -> Parser:
    parser = Parser(
        prog="featherstone-gait", description=ABOUT, epilog=BEGIN, formatter_class=Help, usage="%(prog)s COMMAND ..."
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    parser.set_defaults(run=None, command=None)
    commands = parser.add_subparsers(metavar="COMMAND, one of", title="commands", prog=parser.prog)
    for command in COMMANDS:
        command.add(commands)
    return parser
