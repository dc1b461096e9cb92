"""Files that appear whole or not at all, and that say what they are."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def complete(path) -> Iterator[Path]:
    """A path to write to, in place of `path`, which it takes when everything went well.  Raises OSError."""
    with complete_together(path) as (temporary,):
        yield temporary


@contextmanager
def complete_together(*paths) -> Iterator[list[Path]]:
    """Paths to write to, in place of files of one folder, of which all appear or none.  Raises OSError."""
    targets = [Path(path) for path in paths]
    try:
        with moving_up(targets[0].parent) as folder:
            yield [folder / target.name for target in targets]
    except OSError as error:
        named = ", ".join(map(str, targets))
        raise OSError(f"{named}: cannot be written ({error.strerror or error}); what was there is unchanged") from error


@contextmanager
def moving_up(parent: Path, name: str | None = None) -> Iterator[Path]:
    """A new folder in `parent`, whose files move up into it when all are complete and on the disk, or none does.

    name: of the new folder; what a process that was killed left under that name is removed.  None: a unique one.
    """
    folder = parent / name if name else Path(tempfile.mkdtemp(prefix=".", dir=parent))
    try:
        if name:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
        yield folder
        paths = sorted(folder.iterdir())
        for path in paths:
            _settle(path, parent / path.name)
        for path in paths:
            os.replace(path, parent / path.name)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _settle(path: Path, target: Path) -> None:
    """Wait until a file is on the disk; raise OSError if it cannot take its place."""
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, f"{target} is a folder")
    with path.open("rb+") as file:
        os.fsync(file.fileno())
