"""Numbers on a tape: values to the same bits, derivatives of each operation, and a tape that is full."""

import math

import numpy as np
import pytest

from featherstone_gait.core.compile import elementary
from featherstone_gait.core.compile.jit import JIT, entry, kernel
from featherstone_gait.core.compile.lanes import clamp, gather, select, sqrt
from featherstone_gait.core.compile.taped import (
    ADJOINT,
    COLUMNS,
    ENTRY,
    Tape,
    add_adjoint,
    as_taped,
    constant,
    entry_of,
    push_on,
    sweep,
    used,
    value_of,
)

pytestmark = pytest.mark.skipif(not JIT, reason="taped numbers need compiled kernels")
TABLE = np.array([1.0, 3.0, 7.0])


@kernel
def results(x, y, table, out):
    """Fill out with a result of each operation on two numbers, of which x + 3 is above 0."""
    out[0], out[1], out[2], out[3] = x + y, x - y, x * y, x / (y + 4.0)
    s, c = elementary.sincos(x * y)
    out[4], out[5], out[6] = s, c, elementary.angle(x, y)
    out[7], out[8], out[9] = elementary.exp(x), elementary.log(x + 3.0), sqrt(x + 3.0)
    out[10], out[11], out[12] = -x, abs(x), select(x > y, x * x, y * y)
    out[13], out[14] = clamp(x, -0.5, y), gather(table, x * 0.0 + 2.0) * y
    z = 0.0 * x + 2.0
    z += x * y
    z -= 3.0 * x
    out[15], out[16], out[17] = z, constant(x) * y, 5.0 / (2.0 + x * x)


@entry
def values(x, y, table, out):
    results(x[0], y[0], table, out)


@entry
def derivatives(memory, table, numbers, links, words, seeds, out, found):
    taped, results_of = as_taped(memory), as_taped(out)
    results(taped[0], taped[1], table, results_of)
    for i in range(len(found)):
        found[i] = value_of(results_of[i])
        add_adjoint(numbers, results_of[i], seeds[i])
    sweep(numbers, links, 2, used(words))


@entry
def tangents(memory, table, numbers, links, words, directions, out, found):
    taped, results_of = as_taped(memory), as_taped(out)
    results(taped[0], taped[1], table, results_of)
    push_on(numbers, links, 4, used(words), directions)
    for i in range(len(found)):
        at = (entry_of(results_of[i]) & (2**26 - 1)) // ENTRY
        for c in range(COLUMNS):
            found[i, c] = directions[at, c]


def closed_forms(x, y):
    """Derivatives by x and y of each result."""
    c, s, r = math.cos(x * y), math.sin(x * y), x * x + y * y
    larger, q = x > y, 2.0 + x * x
    limited = (0.0, 1.0) if x > y else (0.0, 0.0) if x < -0.5 else (1.0, 0.0)
    return np.array([
        (1, 1), (1, -1), (y, x), (1 / (y + 4), -x / (y + 4) ** 2), (y * c, x * c), (-y * s, -x * s), (y / r, -x / r),
        (math.exp(x), 0), (1 / (x + 3), 0), (0.5 / math.sqrt(x + 3), 0), (-1, 0), (math.copysign(1, x), 0),
        (2 * x, 0) if larger else (0, 2 * y), limited, (0, 7), (y - 3, x), (0, x), (-10 * x / (q * q), 0),
    ])  # fmt: skip


def taped(x, y, entries=500):
    tape, memory = Tape(entries), np.zeros((2, 2))
    memory[:, 0] = x, y
    assert tape.inputs(memory) == 2
    return tape, memory


@pytest.mark.parametrize(("x", "y"), [(0.3, 0.7), (-1.2, 0.4), (0.9, -0.6), (2.0, 1.5)])
def test_adjoints_and_tangents_of_each_operation_are_its_derivatives(x, y):
    J = closed_forms(x, y)
    plain, found = np.zeros(len(J)), np.zeros(len(J))
    values(np.array([x]), np.array([y]), TABLE, plain)
    for i in range(len(J)):
        (tape, memory), seeds, out = taped(x, y), np.eye(len(J))[i], np.zeros((len(J), 2))
        derivatives(memory, TABLE, tape.numbers, tape.links, tape.words, seeds, out, found)
        assert np.array_equal(found, plain)  # to the bit
        assert tape.numbers[2:4, ADJOINT] == pytest.approx(J[i], rel=4e-16, abs=1e-16)
    tape, memory = taped(x, y)
    directions, forward = np.zeros((len(tape.numbers), COLUMNS)), np.zeros((len(J), COLUMNS))
    directions[2:4] = np.random.default_rng(0).standard_normal((2, COLUMNS))
    tangents(memory, TABLE, tape.numbers, tape.links, tape.words, directions, np.zeros((len(J), 2)), forward)
    assert forward == pytest.approx(J @ directions[2:4], rel=1e-15, abs=1e-15)


def test_what_depends_on_no_input_takes_no_entry_and_a_full_tape_loses_only_derivatives():
    plain, found = np.zeros(18), np.zeros(18)
    values(np.array([0.3]), np.array([0.7]), TABLE, plain)
    tape = Tape(500)
    memory = np.array([[0.3, 0.0], [0.7, 0.0]])  # constants
    derivatives(memory, TABLE, tape.numbers, tape.links, tape.words, np.ones(18), np.zeros((18, 2)), found)
    assert tape.first == 2
    assert np.array_equal(found, plain)
    tape, memory = taped(0.3, 0.7, entries=9)
    derivatives(memory, TABLE, tape.numbers, tape.links, tape.words, np.ones(18), np.zeros((18, 2)), found)
    assert tape.first == 9  # as many as it has: who sees that takes a larger one
    assert np.array_equal(found, plain)
