"""Compile kernels beforehand, so that first results compile nothing.

Writes the kernels of usual commands and kinds of scenes, and of your own programs (.py, or the Python of a page, .md),
which it runs, into your cache; with --out into a folder, as a store for a wheel.

Takes ten minutes on two cores; Ctrl-C keeps what is done, and the next time goes on from there.

  featherstone-gait warm-up
  featherstone-gait warm-up my_program.py --only
"""

from __future__ import annotations

import re
import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from ..base.progress import progress_bar
from .arguments import Commands, add_command, add_quiet, announce

OPTIMIZE = "optimize --iterations 40 --test-worlds 16 --quiet"  # all of its kinds, in a short time
CODE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__, where="folder of the store (default: in your cache)")
    parser.add_argument("programs", metavar="PROGRAM", nargs="*", type=Path, help="programs whose kernels to keep too")
    parser.option("--only", "nothing but those programs", False)
    parser.option("--all-levels", "code for processors with AVX2 and with AVX-512, not for this one alone", False)
    parser.option("--processes", "programs at a time, each with half a GB", 2, metavar="N")
    add_quiet(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..base.arguments import whole
    from ..benchmark.first import COMMAND, PROGRAMS
    from ..core.compile.jit import CACHE_FOLDER
    from ..core.compile.store import LEVELS, Level, levels
    from ..robot_file import robot_names

    chosen = [*LEVELS] if args.all_levels else levels()[:1]
    if not chosen:
        raise ValueError(f"this processor is none of {', '.join(LEVELS)}: its kernels are compiled at their first use")
    if args.out is None and not CACHE_FOLDER:
        raise ValueError("there is no folder for a cache that can be written: name one by --out")
    folder = args.out or Path(CACHE_FOLDER) / "kernels"
    processes = whole("--processes", args.processes, 1, "give a number of processes", 1024)
    for path in args.programs:
        if not path.is_file():
            raise ValueError(f"{path} is no file: name a program (.py) or a page (.md)")
    if args.only and not args.programs:
        raise ValueError("--only has no program: name one (.py, .md), or leave --only out")
    programs = {str(path): _code(path) if path.suffix == ".md" else path for path in args.programs}
    if not args.only:
        commands = OPTIMIZE, *(f"simulate {name}" for name in robot_names())
        named = {f"featherstone-gait {words}": COMMAND.format(repr(words)) for words in commands}
        programs = PROGRAMS | named | programs
    announce(args, f"up to a minute for each of {len(programs)} programs; Ctrl-C keeps what is done")
    failed = _run(programs, folder, chosen, processes)
    for level in chosen:
        kept = [folder / level / f"{name}.o" for name in Level(folder / level).kernels]
        print(f"{folder / level}: {len(kept)} kernels, {sum(path.stat().st_size for path in kept) / 1e6:.1f} MB")
    return 1 if failed else 0


def _run(programs: Mapping[str, str | Path], folder: Path, levels: Sequence[str], processes: int) -> int:
    """Run programs and keep their kernels; say which fail, and return how many."""
    from ..core.compile.store_writer import record

    failed = 0
    with ThreadPoolExecutor(processes) as pool:
        runs = {pool.submit(record, program, folder, levels): name for name, program in programs.items()}
        try:
            for run in progress_bar(as_completed(runs), "kernels", len(runs), unit="program", leave=False):
                try:
                    run.result()
                except RuntimeError as error:
                    failed += 1
                    print(f"{runs[run]}: {error}", file=sys.stderr)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return failed


def _code(page: Path) -> str:
    """Return the Python of a page, one program."""
    return "\n".join(CODE.findall(page.read_text("utf-8")))
