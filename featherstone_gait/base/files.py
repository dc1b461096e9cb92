"""Write files whole or not at all, and read files that state their format.

A file that the package writes for itself to read states its format: its kind, a number that rises when the contents
change, and the version that wrote it.  JSON and arrays (.npz) have it as "format", CSV in a comment over the header.
A table that states none is read too, as other programs write it.
"""

from __future__ import annotations

import csv
import errno
import json
import math
import os
import re
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from .. import __version__
from ..core.compile.lock import lock

if TYPE_CHECKING:
    import numpy as np

MOST_EXPANSION = 100  # of a .npz: bytes of its arrays by bytes of the file; recorded numbers compress to a tenth
SMALL = 256 * 2**20  # bytes of arrays, up to which files may expand more
FilePath = str | os.PathLike[str]


@contextmanager
def complete(path: FilePath) -> Iterator[Path]:
    """Yield a temporary path to write to; the file takes the place of `path` if all went well.  Raises OSError."""
    with complete_together(path) as (temporary,):
        yield temporary


@contextmanager
def complete_together(*paths: FilePath) -> Iterator[list[Path]]:
    """Yield paths to write to in place of files of one folder; all of them appear, or none.  Raises OSError."""
    targets, temporary = [Path(path) for path in paths], []
    try:
        with moving_up(targets[0].parent) as folder:
            temporary.append(folder)
            yield [folder / target.name for target in targets]
    except OSError as error:
        if error.filename is not None and Path(error.filename).parent not in (targets[0].parent, *temporary):
            raise  # of another file, which was to be read, say
        named = ", ".join(map(str, targets))
        raise OSError(f"{named}: cannot be written ({error.strerror or error}); what was there is unchanged") from error


@contextmanager
def moving_up(parent: Path, name: str | None = None) -> Iterator[Path]:
    """Yield a new folder in `parent`, and move its files up when all are complete and on the disk, or none.

    name: of the new folder; what a killed process left under that name is removed.  None: a unique name.
    """
    folder = parent / name if name else Path(tempfile.mkdtemp(prefix=".partial_", dir=parent))
    try:
        if name:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
        yield folder
        paths = sorted(folder.iterdir())
        for path in paths:
            if (parent / path.name).is_dir():
                raise IsADirectoryError(errno.EISDIR, f"{parent / path.name} is a folder")
            with path.open("rb+") as file:
                os.fsync(file.fileno())
        for path in paths:
            os.replace(path, parent / path.name)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def claim(file: IO, path: FilePath) -> None:
    """Lock an open file until it is closed or the process ends; raise OSError if another process has locked it."""
    if not lock(file):
        remedy = "wait until that has ended, or take another folder"
        raise OSError(f"{path}: another process is at work with this file; {remedy}")


# ---------------------------------------------------------------------------------------------- formats


class Format(NamedTuple):
    """A kind of files, and the largest format number that this version reads; it writes that one."""

    kind: str
    number: int = 2

    def __str__(self) -> str:
        return f"featherstone_gait {self.kind} {self.number}, written by version {__version__}"

    def check(self, path: FilePath, stated: str | None) -> None:
        """Raise ValueError if a file states another kind, or a number that this version does not read."""
        if stated is None:
            return
        found = re.fullmatch(r"featherstone_gait (.+) ([0-9]{1,9}), written by version (\S+)", str(stated))
        if found is None or found[1] != self.kind:
            expected = f"expected featherstone_gait {self.kind}: give such a file"
            raise ValueError(f"{path}: its format is {str(stated)[:100]!r}; {expected}")
        if int(found[2]) > self.number:
            raise ValueError(
                f"{path}: its format is {self.kind} {found[2]}; version {__version__} of featherstone_gait reads "
                f"{self.kind} 1 to {self.number}: read it with version {found[3]}, which wrote it, or a later one"
            )


def write_csv(
    path: FilePath, form: Format, columns: Sequence[str], rows: Iterable[Sequence], notes: str = "", end: str = "\r\n"
) -> None:
    """Write a table whole or not at all: format and notes as comments, the names of the columns, the rows."""
    with complete(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        file.writelines(f"# {line}\n" for line in [str(form), *notes.splitlines()])
        writer = csv.writer(file, lineterminator=end)
        writer.writerow([*map(_as_text, columns)])
        writer.writerows([*map(_as_text, row)] for row in rows)


def _as_text(cell: Any) -> Any:
    """Put ' before a text that a spreadsheet would compute, such as a joint's name "=1+1"; `read_csv` takes it off."""
    return f"'{cell}" if isinstance(cell, str) and _FORMULA.match(cell) and number(cell) != number(cell) else cell


def read_csv(path: FilePath, form: Format) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each line of a table, without the comments above it.

    The first line has the names of the columns.  Raises ValueError on what is no CSV or of an unknown format.
    """
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            comments, line = 0, file.readline()
            while line.startswith("#"):
                text = line[1:].strip(" ,\r\n")  # a spreadsheet appends commas
                if text.startswith("featherstone_gait "):
                    form.check(path, text)
                comments, line = comments + 1, file.readline()
            rows = csv.reader(chain([line] if line else [], file))
            for row in rows:
                yield comments + rows.line_num, [cell[1:] if _QUOTED.match(cell) else cell for cell in row]
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: is not UTF-8 text; save it as CSV") from error
    except csv.Error as error:
        raise ValueError(f"{path}: is not CSV ({error}); save it as CSV") from error


_FORMULA = re.compile(r"'*\s*[=+@-].|'*[\t\r]", re.DOTALL)  # what spreadsheets compute, or is quoted already
_QUOTED = re.compile(r"''*\s*[=+@-].|''*[\t\r]", re.DOTALL)
_NUMERAL = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")


def number(text: str) -> float:
    """Return the number in a cell, NaN if there is none; float() alone would accept 1_0 and Arabic digits too."""
    text = text.strip()
    return float(text) if _NUMERAL.fullmatch(text) else math.nan


# ---------------------------------------------------------------------------------------------- JSON and arrays


def read_columns(
    path: Path, form: Format, names: Sequence[str], optional: Sequence[str], least: int, others: bool = False
) -> tuple[dict[str, np.ndarray], list[int]]:
    """Read a table of numbers: its columns by name, and the line of each row.

    The columns `names` must be there; with `others` further ones may be, whose cells need not be numbers.  Raises
    ValueError, naming file, line and column, on anything else and on less than `least` rows.
    """
    import numpy as np

    lines = list(read_csv(path, form)) or [(1, [])]
    head = [name.strip() for name in lines[0][1]]
    known = (*names, *optional)
    problems = {name: "is unknown" for name in head if name not in known and not others}
    problems |= {name: "is missing" for name in names if name not in head}
    problems |= {name: "is there twice" for name in known if head.count(name) > 1}
    for name, problem in problems.items():
        leave_out = f" ({', '.join(optional)} may be left out)" if optional else ""
        raise ValueError(
            f"{path}, line {lines[0][0]}: column {name!r} {problem}; name the columns {', '.join(known)}{leave_out}, "
            "separated by commas"
        )
    rows = []
    for line, cells in lines[1:]:
        if len(cells) != len(head):
            problem = f"has {len(cells)} values, expected {len(head)}; complete or delete it"
            raise ValueError(f"{path}, line {line}: {problem}")
        rows.append([number(cell) for cell in cells])
        for name, value, cell in zip(head, rows[-1], cells):
            if name in known and not math.isfinite(value):
                problem = f"{cell[:40]!r} is not a finite number, with a decimal point; correct it, or delete the line"
                raise ValueError(f"{path}, line {line}, column {name!r}: {problem}")
    if len(rows) < least:
        raise ValueError(f"{path}: has {len(rows)} samples; give {least} or more rows below the header")
    return dict(zip(head, np.array(rows).T)), [line for line, _ in lines[1:]]


def parse_json(text: str | bytes, what: str, remedy: str) -> dict[str, Any]:
    """Parse the JSON object in a text; raise ValueError, with `what` it is and a remedy, if there is none."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{what}: damaged; {remedy} ({error})") from error
    if not isinstance(content, dict):
        raise ValueError(f"{what}: damaged; {remedy} (expected a JSON object, got {str(content)[:40]!r})")
    return content


def is_number(value: object) -> bool:
    """Return whether a value of a JSON file is a finite number."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def read_json(path: FilePath, form: Format) -> dict[str, Any]:
    """Read the object in a JSON file, without its format; raise ValueError if it is damaged or of an unknown format."""
    content = parse_json(Path(path).read_bytes(), str(path), "take an undamaged copy, or make it again")
    form.check(path, content.pop("format", None))
    return content


def read_arrays(
    path: FilePath, form: Format, check: Callable[[dict[str, np.ndarray]], object] | None = None
) -> dict[str, np.ndarray]:
    """Read the arrays of a .npz file, without its format.  Raises as `read_json`, and for what expands beyond measure.

    check: called before memory is taken for the arrays, with stand-ins of their shapes and types.
    """
    import numpy as np

    with Path(path).open("rb") as file:
        with _undamaged(path):
            declared = _declared(file)
        size, most = sum(array.nbytes for array in declared.values()), os.path.getsize(path) * MOST_EXPANSION
        if size > max(most, SMALL):
            raise ValueError(
                f"{path}: its arrays take {size} bytes, more than {MOST_EXPANSION} times those of the file; at most "
                f"{SMALL} do that: take an undamaged copy, or make it again"
            )
        with _undamaged(path), np.load(file) as data:
            stated = data["format"] if declared.pop("format", None) is not None else None
        form.check(path, stated)
        if check is not None:
            check(declared)
        file.seek(0)
        with _undamaged(path), np.load(file) as data:
            return {name: data[name] for name in declared}


def check_sound(path: FilePath, name: str, values: np.ndarray, infinite: bool = False) -> None:
    """Raise ValueError, with the row, for an array of a file that holds NaN, or infinity unless it may."""
    import numpy as np

    if not values.size:
        return
    values = values.astype(float).reshape(len(values) if values.ndim else 1, -1)
    wrong = np.argwhere(np.isnan(values) if infinite else ~np.isfinite(values))
    if len(wrong):
        row, column = wrong[0].tolist()
        raise ValueError(
            f"{path}: {name}, row {row}, number {column} is {values[row, column]}; expected "
            f"{'numbers' if infinite else 'finite numbers'}: take an undamaged copy, or make it again"
        )


@contextmanager
def _undamaged(path: FilePath) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # a damaged file can make the reader fail in any way
        why = f"damaged, or no .npz file ({type(error).__name__}: {error})"
        raise ValueError(f"{path}: {why}; take an undamaged copy, or make it again") from error


def _declared(file: IO[bytes]) -> dict[str, np.ndarray]:
    """Read what the headers of a .npz file state: arrays of these shapes and types that take no memory."""
    import numpy as np

    declared = {}
    with zipfile.ZipFile(file) as archive:
        for name in archive.namelist():
            if not name.endswith(".npy"):
                raise ValueError(f"{name[:40]!r} is no array")
            with archive.open(name) as entry:
                version = np.lib.format.read_magic(entry)
                read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                shape, _, dtype = read(entry)
            declared[name.removesuffix(".npy")] = np.broadcast_to(np.zeros((), dtype), shape)
    file.seek(0)
    return declared
