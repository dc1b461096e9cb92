"""The algorithms again and again on the same states, for benchmarks: no call from Python, no new memory to fetch."""

from ..compile.jit import entry
from .batch import aba_lanes, aba_rows, crba_rows, rnea_lanes, rnea_rows


@entry
def repeat_aba_rows(count, *arguments):
    """`aba_rows` of the arguments, so many times."""
    for _ in range(count):
        aba_rows(*arguments)


@entry
def repeat_aba_lanes(count, *arguments):
    """`aba_lanes` of the arguments, so many times."""
    for _ in range(count):
        aba_lanes(*arguments)


@entry
def repeat_rnea_rows(count, *arguments):
    """`rnea_rows` of the arguments, so many times."""
    for _ in range(count):
        rnea_rows(*arguments)


@entry
def repeat_rnea_lanes(count, *arguments):
    """`rnea_lanes` of the arguments, so many times."""
    for _ in range(count):
        rnea_lanes(*arguments)


@entry
def repeat_crba_rows(count, *arguments):
    """`crba_rows` of the arguments, so many times."""
    for _ in range(count):
        crba_rows(*arguments)
