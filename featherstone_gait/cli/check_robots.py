"""Load all robots below a folder, and simulate a second of each; from rest, without torques at the joints.

Writes a table with one row per robot, if --csv is given.

Takes a second per robot, and 5 to 20 s to compile each new kind of robot.

  featherstone-gait check-robots my_robots
  featherstone-gait check-robots . --no-simulate --csv all.csv
"""

from __future__ import annotations

import re
import textwrap
import warnings
from argparse import Namespace
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from .arguments import LINE, Commands, add_command, add_quiet
from .info import table

if TYPE_CHECKING:
    from ..model import Model

DURATION = 1.0  # [s]
PATH = 30  # characters of a file in the printed table, its last ones


class Row(NamedTuple):
    """The result for one file."""

    file: str  # below the folder
    loads: str = "no"
    notes: int = 0
    joints: int = 0
    mass: float = 0.0  # [kg]
    status: str = ""  # of the simulation
    error: float | str = ""  # of the joints' positions [rad or m]
    cause: str = ""  # of the refusal, or why nothing was simulated


def add(commands: Commands) -> None:
    """Register the command."""
    parser = add_command(commands, run, __doc__)
    what = "folder with .urdf files, or .xml files of MuJoCo or SimTwo"
    parser.add_argument("folder", type=Path, metavar="FOLDER", help=what)
    parser.option("--csv", "also write the table to this CSV file, in the output folder", metavar="FILE")
    parser.option("--no-simulate", "only load the robots", False)
    add_quiet(parser)


def run(args: Namespace) -> int:
    """Run the command; return its exit code."""
    from ..base.files import Format, write_csv
    from ..base.progress import progress_bar

    if not args.folder.is_dir():
        raise ValueError(f"{args.folder}: there is no such folder; give one that has .urdf files below it")
    paths = robot_files(args.folder)
    rows = [_row(path, args) for path in progress_bar(paths, desc="check", unit="robot")]
    print("\n".join([*_table(rows), "", *_summary(rows)]))
    if args.csv:
        write_csv(args.out / args.csv, Format("table of robots"), Row._fields, rows)
        print(f"file: {args.out / args.csv}")
    return 0


def robot_files(folder: Path) -> list[Path]:
    """Return the .urdf and .mjcf files below a folder, and the .xml files of MuJoCo or SimTwo."""
    from ..robot_file.source import SUFFIXES

    found = (path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    return sorted(path for path in found if path.suffix.lower() != ".xml" or _root_tag(path) in (b"mujoco", b"scene"))


def _root_tag(path: Path) -> bytes:
    """Return the name of the first element in an XML file."""
    text = re.sub(rb"<!--.*?-->", b"", path.read_bytes(), flags=re.DOTALL)
    tag = re.search(rb"<([A-Za-z][\w.:-]*)", text)
    return tag[1] if tag else b""


def _row(path: Path, args: Namespace) -> Row:
    from ..robot_file import RobotFileError, RobotFileWarning, load_robot

    row = Row(repr(str(path.relative_to(args.folder)))[1:-1])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RobotFileWarning)
            model = load_robot(path)
    except RobotFileError as error:
        return row._replace(cause=_cause(error.problems[0]) or error.problems[0])
    except (ImportError, OSError) as error:  # ImportError of MuJoCo, of which the message tells
        return row._replace(cause=str(error))
    row = row._replace(loads="yes", notes=len(model.notes), joints=len(model.joint_names), mass=model.mass)
    return row if args.no_simulate or model.nv == 0 else _simulated(row, model)


def _simulated(row: Row, model: Model) -> Row:
    """Simulate a second without torques, from rest at the posture nearest to zero."""
    from ..model.rest_posture import nearest_posture
    from ..run.simulate import initial_state, simulate
    from ..scene.compile import compile_scene

    try:
        scene = compile_scene(model)
        state = initial_state(scene, nearest_posture(model))
        trajectory = simulate(scene, DURATION, state, record=("q",), record_interval=0.1, estimate_error=True)
    except ValueError as error:
        return row._replace(status="refused", cause=_cause(str(error)))
    largest = float(trajectory.error["q"].max(initial=0.0)) if trajectory.error else ""
    return row._replace(status=trajectory.status, error=largest)


def _cause(problem: str) -> str:
    """Return a problem without its line, element and remedy."""
    said = re.sub(r"^(line \d+: )?((link|joint|robot|links) ('[^']*'(, )?)+)?( <\w+>)*:? ?", "", problem)
    return said.split(";")[0].strip()


def _table(rows: list[Row]) -> list[str]:
    """Format a line for each robot, and below them why some do not load or run."""
    head = ("file", "loads", "notes", "joints", "mass [kg]", "status", "error")
    causes = [_wrapped(f"{row.file}: {row.cause}") for row in rows if row.cause]
    return [*table(head, [_cells(row) for row in rows]), *([""] * bool(causes)), *causes]


def _cells(row: Row) -> tuple[str, ...]:
    file = row.file if len(row.file) <= PATH else "..." + row.file[3 - PATH :]
    if row.loads == "no":
        return (file, row.loads, *[""] * 5)
    error = "" if row.error == "" else f"{row.error:.1e}"
    return (file, row.loads, str(row.notes), str(row.joints), f"{row.mass:.5g}", row.status, error)


def _wrapped(text: str) -> str:
    return textwrap.fill(text, LINE, subsequent_indent="  ", break_on_hyphens=False)


def _summary(rows: list[Row]) -> list[str]:
    loaded = [row for row in rows if row.loads == "yes"]
    statuses = Counter(row.status for row in loaded if row.status)
    kinds = (re.sub(r"-?\d[\d.e+-]*", "#", re.sub(r"'[^']*'", "'...'", row.cause)) for row in rows if row.cause)
    causes = Counter(kinds)
    return [
        f"{len(loaded)} of {len(rows)} robots load, {sum(row.notes > 0 for row in loaded)} of them with notes",
        *(["simulated: " + ", ".join(f"{status} {n}" for status, n in statuses.most_common())] if statuses else []),
        *(f"{n} x {cause}" for cause, n in causes.most_common()),
    ]
