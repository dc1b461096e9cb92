"""Repeat algorithms on the same states inside compiled loops, without calls from Python and without new memory."""

from typing import Any

from ..core.compile.jit import add_sources, entry
from ..core.tree.batch import aba_lanes, aba_rows, crba_rows, rnea_lanes, rnea_rows

add_sources(__name__, __file__)


@entry
def repeat_aba_rows(count: int, *arguments: Any) -> None:
    """`aba_rows` of the arguments, so many times."""
    for _ in range(count):
        aba_rows(*arguments)


@entry
def repeat_aba_lanes(count: int, *arguments: Any) -> None:
    """`aba_lanes` of the arguments, so many times."""
    for _ in range(count):
        aba_lanes(*arguments)


@entry
def repeat_rnea_rows(count: int, *arguments: Any) -> None:
    """`rnea_rows` of the arguments, so many times."""
    for _ in range(count):
        rnea_rows(*arguments)


@entry
def repeat_rnea_lanes(count: int, *arguments: Any) -> None:
    """`rnea_lanes` of the arguments, so many times."""
    for _ in range(count):
        rnea_lanes(*arguments)


@entry
def repeat_crba_rows(count: int, *arguments: Any) -> None:
    """`crba_rows` of the arguments, so many times."""
    for _ in range(count):
        crba_rows(*arguments)
