"""Limit the sizes that a file requests of MuJoCo, which would take the memory and time for them, or end the process."""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from pathlib import Path
from xml.etree.ElementTree import Element

from ..markup import read_markup
from ..report import blamed_on

MAX_FILES = 100  # that include or attach each other
MAX_COPIES = 10_000  # of what is replicated
MAX_ELEMENTS = 50_000  # with all copies; the time that MuJoCo takes grows with the square
MAX_CELLS = 100_000_000  # of a height field or a texture
COPIES = ("replicate", "composite", "flexcomp")
CELLS = ("hfield", "texture")
CELL_COUNTS = ("nrow", "ncol", "width", "height")
ARENA = ("memory", "njmax", "nconmax", "nstack")  # of <size>, for a run's work


def check_sizes(path: Path, documents: Mapping[Path, Element]) -> None:
    """Raise ValueError if a file, or one that it includes or attaches, asks for too much."""
    for file, root in documents.items():
        where = _where(file, path)
        for element in [element for tag in CELLS for element in root.iter(tag)]:
            _check(element, [n for name in CELL_COUNTS for n in _counts(element, name)], MAX_CELLS, where)
        for element in root.iter("size"):
            for name in set(element.attrib) - set(ARENA):
                _check(element, _counts(element, name), MAX_COPIES, where)
    _check_copies(path, documents)


def _where(file: Path, first: Path) -> str:
    return "" if file == first else f"{file.name}: "


def documents_of(path: Path) -> dict[Path, Element]:
    """Parse the file, and those that it includes or attaches, recursively; raise ValueError for one that cannot be."""
    waiting, documents = [path], {}
    while waiting:
        file = waiting.pop()
        with blamed_on(file):
            documents[file] = read_markup(file).root
        named = [element for tag in ("include", "model") for element in documents[file].iter(tag)]
        found = dict.fromkeys(other for element in named for other in _files(element, file, path))
        waiting += [other for other in found if other not in documents and other not in waiting]
        if len(documents) + len(waiting) > MAX_FILES:
            raise ValueError(f"includes more than {MAX_FILES} files; put them together")
    return documents


def _files(element: Element, file: Path, first: Path) -> list[Path]:
    """Return the file that an element names: beside the file that names it, or beside the first one, as in MuJoCo."""
    name = element.get("file", "")
    return list(dict.fromkeys(found for folder in (file, first) if (found := folder.parent / name).is_file()))


def _check_copies(path: Path, documents: Mapping[Path, Element]) -> None:
    """Refuse too many elements, counting those of other files each time that they are inserted."""
    models, elements = _models(path, documents), 0
    waiting = [(path, documents[path], 1, frozenset([path]))]
    while waiting:
        file, element, copies, above = waiting.pop()
        if element.tag in COPIES:
            counts = _counts(element, "count")
            _check(element, [copies, *counts], MAX_COPIES, _where(file, path))
            copies *= _product(counts)
        elements += copies
        if elements > MAX_ELEMENTS:
            raise ValueError(f"{_where(file, path)}asks for more than {MAX_ELEMENTS} elements; make fewer copies")
        waiting += [(file, child, copies, above) for child in element]
        named = models.get(element.get("model", ""), []) if element.tag == "attach" else []
        put_in = [*named, *(_files(element, file, path) if element.tag in ("include", "model") else [])]
        waiting += [(other, documents[other], copies, above | {other}) for other in put_in if other not in above]


def _models(path: Path, documents: Mapping[Path, Element]) -> dict[str, list[Path]]:
    """Return the files of the models to attach, by the names of the element and of the model itself."""
    models: dict[str, list[Path]] = {}
    for file, root in documents.items():
        for element in root.iter("model"):
            for found in _files(element, file, path):
                for name in {element.get("name", ""), documents[found].get("model", "")}:
                    models.setdefault(name, []).append(found)
    return models


def _check(element: Element, counts: list[int], most: int, where: str) -> None:
    if _product(counts) > most:
        raise ValueError(
            f"{where}<{element.tag}> asks for {_product(counts)} elements; at most {most}: reduce its sizes"
        )


def _counts(element: Element, name: str) -> list[int]:
    """Return the whole numbers above 1 of an attribute."""
    words = element.get(name, "").split()
    digits = [int(word[:30]) for word in words if word.isascii() and word.isdigit()]
    return [n for n in digits if n > 1]


def _product(counts: list[int]) -> int:
    return reduce(lambda product, count: min(product * count, 10**30), counts, 1)
