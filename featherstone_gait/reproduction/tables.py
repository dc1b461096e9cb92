"""Studies that run for hours: searches kept in files, tables, and their command line."""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

from ..base.files import FilePath, Format, write_csv
from .sources import digest


def search_history(folder: str, what: str, seed: int) -> dict[str, Any]:
    """Return the options of a search that is stored in a folder; what: all that the costs depend on."""
    if not folder:
        return {}
    Path(folder).mkdir(parents=True, exist_ok=True)
    key = hashlib.sha256(what.encode()).hexdigest()[:12]
    return {"history": Path(folder) / f"{key}_{seed}.jsonl", "resume": True}


def write_rows(path: FilePath, form: Format, rows: Sequence[Any], module: str) -> None:
    """Write records as CSV, with the digest of a module's sources."""
    names = [field.name for field in fields(rows[0])]
    write_csv(path, form, names, map(astuple, rows), f"sources {digest(Path(module))}")


def table_arguments(
    description: str, arguments: Sequence[str] | None, *files: str, **options: int | str
) -> argparse.Namespace:
    """Parse the command line of a study that writes a table; options: whole numbers or texts, and their defaults."""
    parser = argparse.ArgumentParser(description=f"{description}; continues where it was interrupted")
    for file in ("TABLE.csv", *files):
        parser.add_argument(file.partition(".")[0].lower(), type=Path, metavar=file)
    for name, default in options.items():
        metavar, said = ("N", "%(default)s") if isinstance(default, int) else ("TEXT", "all")
        parser.add_argument(f"--{name}", type=type(default), default=default, metavar=metavar, help=f"default: {said}")
    return parser.parse_args(arguments)
