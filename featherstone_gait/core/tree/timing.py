"""The algorithms again and again on the same states, for benchmarks: no call from Python, no new memory to fetch."""

from ..compile.jit import entry
from .batch import aba_lanes, aba_rows, crba_rows, rnea_lanes, rnea_rows


@entry
def repeat_aba_rows(count, *arguments):
    for _ in range(count):
        aba_rows(*arguments)


@entry
def repeat_aba_lanes(count, *arguments):
    for _ in range(count):
        aba_lanes(*arguments)


@entry
def repeat_rnea_rows(count, *arguments):
    for _ in range(count):
        rnea_rows(*arguments)


@entry
def repeat_rnea_lanes(count, *arguments):
    for _ in range(count):
        rnea_lanes(*arguments)


@entry
def repeat_crba_rows(count, *arguments):
    for _ in range(count):
        crba_rows(*arguments)
