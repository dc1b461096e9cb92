"""Sizes that a file asks of MuJoCo, which takes the memory and the time for them, or ends the process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

from ..markup import read_markup

MAX_FILES = 100  # that include each other
MAX_COPIES = 10_000  # of what is replicated
MAX_CELLS = 100_000_000  # of a height field or a texture
COPIES = ("replicate", "composite", "flexcomp")
CELLS = ("hfield", "texture")
CELL_COUNTS = ("nrow", "ncol", "width", "height")
ARENA = ("memory", "njmax", "nconmax", "nstack")  # of <size>, for a run's work


def check_sizes(path: Path) -> None:
    """Raise ValueError if a file, or one that it includes, is no safe XML or asks for too much."""
    for file, root in _documents(path):
        where = "" if file == path else f"{file.name}: "
        _check_copies(root, 1, where)
        for element in [element for tag in CELLS for element in root.iter(tag)]:
            _check(element, [n for name in CELL_COUNTS for n in _counts(element, name)], MAX_CELLS, where)
        for element in root.iter("size"):
            for name in set(element.attrib) - set(ARENA):
                _check(element, _counts(element, name), MAX_COPIES, where)


def _documents(path: Path) -> Iterator[tuple[Path, Element]]:
    """The file and those that it includes; MuJoCo looks for them beside the first."""
    waiting, seen = [path], {path}
    while waiting:
        file = waiting.pop()
        root = read_markup(file).root
        yield file, root
        names = [path.parent / element.get("file", "") for element in root.iter("include")]
        found = [name for name in names if name.is_file() and name not in seen]
        waiting += found
        seen.update(found)
        if len(seen) > MAX_FILES:
            raise ValueError(f"includes more than {MAX_FILES} files; put them together")


def _check_copies(element: Element, copies: int, where: str) -> None:
    if element.tag in COPIES:
        counts = _counts(element, "count")
        _check(element, [copies, *counts], MAX_COPIES, where)
        copies *= _product(counts)
    for child in element:
        _check_copies(child, copies, where)


def _check(element: Element, counts: list[int], most: int, where: str) -> None:
    if _product(counts) > most:
        raise ValueError(
            f"{where}<{element.tag}> asks for {_product(counts)} elements; at most {most}: reduce its sizes"
        )


def _counts(element: Element, name: str) -> list[int]:
    """The whole numbers above 1 of an attribute."""
    words = element.get(name, "").split()
    digits = [int(word[:30]) for word in words if word.isascii() and word.isdigit()]
    return [n for n in digits if n > 1]


def _product(counts: list[int]) -> int:
    product = 1
    for count in counts:
        product = min(product * count, 10**30)
    return product
