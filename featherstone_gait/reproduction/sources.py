"""Find the files of this package that a module is made of: itself, all that it imports, and what they import.

Results that were kept belong to the program that made them; a change of a file that it never loads does not make them
others.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.util import resolve_name
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
ROBOTS = (PACKAGE.parent / "robots", PACKAGE / "robots")  # in the repository; installed, in the package
DATA = (".toml", ".urdf")  # of robots, what runs read


def digest(*files: Path) -> str:
    """Return a digest of all files of the package that modules can load, and of the robots."""
    robots = {path for root in ROBOTS for path in root.rglob("*") if path.suffix in DATA}
    return digest_of([*robots.union(*map(reached, files))])


def digest_of(files: list[Path]) -> str:
    """Return a digest of files, independent of their order, as 16 hexadecimal digits."""
    found = hashlib.sha256()
    for path in sorted(files):
        found.update(path.read_bytes().replace(b"\r\n", b"\n"))
    return found.hexdigest()[:16]


def reached(file: Path) -> set[Path]:
    """Return a file and all files of the package that it loads, including imports inside functions."""
    found: set[Path] = set()
    left = [file]
    while left:
        path = left.pop()
        if path not in found:
            found.add(path)
            left += imported(path)
    return found


@cache
def imported(file: Path) -> tuple[Path, ...]:
    """Return the files of the package that one file imports, with the packages around them."""
    tree = ast.parse(file.read_text("utf-8"))
    return tuple(path for name in _names(tree, file) for path in _files(name))


def _names(tree: ast.AST, file: Path) -> Iterator[str]:
    """Yield the full names that a tree imports; imports for type checkers alone are not loaded."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.ImportFrom):
            package = ".".join(file.parent.relative_to(PACKAGE.parent).parts)
            module = resolve_name("." * node.level + (node.module or ""), package)
            yield from (f"{module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        else:
            yield from _names(node, file)


def _files(name: str) -> Iterator[Path]:
    """Yield the files that importing a name loads: modules and the packages around them."""
    first, *parts = name.split(".")
    for k in range(len(parts) + 1 if first == PACKAGE.name else 0):
        place = PACKAGE.joinpath(*parts[:k])
        yield from (path for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file())
