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
    add_quiet(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..benchmark.first import COMMAND, PROGRAMS
    from ..core.compile.jit import CACHE_FOLDER
    from ..core.compile.store import LEVELS, Level, levels
    from ..core.compile.store_writer import record

    chosen = [*LEVELS] if args.all_levels else levels()[:1]
    if not chosen:
        raise ValueError(f"this processor is none of {', '.join(LEVELS)}: its kernels are compiled at their first use")
    if args.out is None and not CACHE_FOLDER:
        raise ValueError("there is no folder for a cache that can be written: name one by --out")
    folder = args.out or Path(CACHE_FOLDER) / "kernels"
    own = {str(path): _code(path) if path.suffix == ".md" else path for path in args.programs}
    programs = own if args.only else PROGRAMS | {"featherstone-gait optimize": COMMAND.format(repr(OPTIMIZE))} | own
    announce(args, f"{len(programs)} programs, up to a minute each; Ctrl-C keeps what is done")
    failed = 0
    for name in (bar := progress_bar(programs, desc="kernels", unit="program", leave=False)):
        bar.set_postfix_str(name[-40:])
        try:
            record(programs[name], folder, chosen)
        except RuntimeError as error:
            failed += 1
            print(f"{name}: {error}", file=sys.stderr)
    for level in chosen:
        kept = [folder / level / f"{name}.o" for name in Level(folder / level).kernels]
        print(f"{folder / level}: {len(kept)} kernels, {sum(path.stat().st_size for path in kept) / 1e6:.1f} MB")
    return 1 if failed else 0


def _code(page: Path) -> str:
    """Return the Python of a page, one program."""
    return "\n".join(CODE.findall(page.read_text("utf-8")))
