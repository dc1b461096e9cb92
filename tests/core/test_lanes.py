"""Eight lanes behave as eight scalars do: every kernel here gives the bits of NumPy, compiled or not, in any width."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from featherstone_gait.core.compile.jit import entry, kernel
from featherstone_gait.core.compile.lanes import WIDTH, aligned, any_lane, as_lanes, invert, power_of_two, select, sqrt

pytestmark = pytest.mark.nojit

ROOT = Path(__file__).parents[2]
ROWS = 10


@kernel
def _arithmetic(a, b, out):
    for i in range(len(a)):
        out[0, i] = a[i] + b[i]
        out[1, i] = a[i] - b[i]
        out[2, i] = a[i] * b[i]
        out[3, i] = a[i] / b[i]
        out[4, i] = -a[i]
        out[5, i] = abs(a[i])
        out[6, i] = sqrt(b[i])
        out[7, i] = 1.0 / a[i] - 2 * b[i]


def arithmetic(a, b):
    return [a + b, a - b, a * b, a / b, -a, abs(a), np.sqrt(b), 1.0 / a - 2 * b]


@kernel
def _comparisons(a, b, out):
    for i in range(len(a)):
        out[0, i] = select(a[i] < b[i], 1.0, 0.0)
        out[1, i] = select(a[i] <= b[i], 1.0, 0.0)
        out[2, i] = select(a[i] > b[i], 1.0, 0.0)
        out[3, i] = select(a[i] >= b[i], 1.0, 0.0)
        out[4, i] = select(a[i] == b[i], 1.0, 0.0)
        out[5, i] = select(a[i] != b[i], 1.0, 0.0)
        out[6, i] = select((a[i] > 0.0) & (b[i] > 0.0), a[i], b[i])
        out[7, i] = select((a[i] > 0.0) | (b[i] > 0.0), a[i], 0)
        out[8, i] = select(invert(a[i] > 0.0), 0, b[i])
        out[9, i] = select(1 < a[i], -1, 1) * b[i]


def comparisons(a, b):
    masks = [a < b, a <= b, a > b, a >= b, a == b, a != b]
    selected = [
        np.where((a > 0) & (b > 0), a, b),
        np.where((a > 0) | (b > 0), a, 0.0),
        np.where(~(a > 0), 0.0, b),
        np.where(a > 1, -1.0, 1.0) * b,
    ]
    return [mask.astype(float) for mask in masks] + selected


@kernel
def _promotions(a, b, out):
    three = 3
    for i in range(len(a)):
        out[0, i] = 2.5
        out[1, i] = 3
        out[2, i] = three * a[i]
        out[3, i] = a[i] / three
        out[4, i] = 1 + a[i]
        out[5, i] = a[i] - 0.1
        out[6, i] = 0 - a[i]
        out[7, i] = three


def promotions(a, b):
    three = np.full_like(a, 3.0)
    return [np.full_like(a, 2.5), three, 3 * a, a / 3, 1 + a, a - 0.1, 0 - a, three]


@kernel
def _in_place(a, b, out):
    for i in range(len(a)):
        out[0, i] = a[i]
        out[0, i] += b[i]
        out[1, i] = a[i]
        out[1, i] -= b[i] * 2.0
        out[2, i] = a[i]
        out[2, i] *= b[i]
        out[3, i] = a[i]
        out[3, i] /= b[i]
        out[4, i] = a[i]
        out[4, i] += 1
        out[5, i] = a[i]
        out[5, i] *= -0.5


def in_place(a, b):
    return [a + b, a - b * 2, a * b, a / b, a + 1, a * -0.5]


@kernel
def _increment(x):
    x += 1.0
    return x


@kernel
def _values(a, b, out):
    """A loaded, bound or passed value stays what it was whatever is done to its origin."""
    for i in range(len(a)):
        out[0, i] = a[i]
        loaded = out[0, i]
        out[0, i] = b[i]
        out[1, i] = loaded
        bound = loaded
        bound += b[i]
        out[2, i] = loaded
        out[3, i] = bound
        product = a[i] * b[i]
        factor = product
        factor *= 2.0
        out[4, i] = product
        chosen = select(a[i] > 0.0, a[i], b[i])
        out[5, i] = _increment(chosen)
        out[6, i] = chosen
        root = sqrt(b[i])
        out[7, i] = _increment(root) - root


def values(a, b):
    chosen = np.where(a > 0, a, b)
    root = np.sqrt(b)
    return [b, a, a, a + b, a * b, chosen + 1.0, chosen, (root + 1.0) - root]


@kernel
def _swap(a, b):
    return b, a


@kernel
def _loops(a, b, out):
    """Accumulators that start as numbers, tuples, and a value bound anew in a loop."""
    for i in range(len(a)):
        total = 0.0
        count = 0
        largest = -1.0
        x, y = _swap(a[i], b[i])
        for _ in range(3):
            total += x
            count += 1
            largest = select(total > largest, total, largest)
            x, y = y, x
        out[0, i] = total
        out[1, i] = largest
        out[2, i] = count * total


def loops(a, b):
    sums = [0.0 + b, 0.0 + b + a, 0.0 + b + a + b]
    largest = np.full_like(a, -1.0)
    for total in sums:
        largest = np.where(total > largest, total, largest)
    return [sums[2], largest, 3 * sums[2]]


@kernel
def _scale_into(x, factor, result):
    for i in range(x.shape[0]):
        result[i] = factor * x[i]


@kernel
def _slices(a, b, out):
    n = len(a)
    row = out[0]
    row[:] = 7.0
    _scale_into(a, 2.0, out[1])
    _scale_into(a[: n // 2], 3.0, out[2, n // 2 :])
    _scale_into(b[n // 2 :], 5, out[2, : n // 2])
    first = out[3:5]
    for i in range(n):
        first[1, i] = a[i]
        first[0, i] = first[1, i] + row[i]
    _scale_into(a, 1.0, out[5])
    _scale_into(b[:], 1.0, out[6, :])
    _scale_into(b, 1.0, out[7])
    out[7, -1] = a[-1]


def slices(a, b):
    shuffled = np.concatenate((5 * b[len(b) // 2 :], 3 * a[: len(a) // 2]))
    return [np.full_like(a, 7.0), 2 * a, shuffled, a + 7.0, a, a, b, np.concatenate((b[:-1], a[-1:]))]


CONSTANTS = np.recarray(2, dtype=[("mass", float), ("count", np.int64), ("axis", float, 3), ("inertia", float, (2, 2))])
CONSTANTS[0] = (1.5, 4, (0.1, 0.2, 0.3), ((1.0, 2.0), (3.0, 4.0)))
CONSTANTS[1] = (2.5, 5, (0.4, 0.5, 0.6), ((5.0, 6.0), (7.0, 8.0)))


@kernel
def _records(constants, a, b, out):
    for i in range(len(a)):
        out[0, i] = constants[1].mass * a[i]
        out[1, i] = a[i] / constants[0].count
        body = constants[1]
        total = 0.0
        for k in range(3):
            total += body.axis[k] * b[i]
        out[2, i] = total
        out[3, i] = body.inertia[1, 0] * a[i] + body.inertia[0, 1]


def records(a, b):
    axis = CONSTANTS[1].axis
    return [2.5 * a, a / 4, 0.0 + axis[0] * b + axis[1] * b + axis[2] * b, 7.0 * a + 6.0]


@kernel
def _all(constants, a, b, out):
    _arithmetic(a, b, out[0])
    _comparisons(a, b, out[1])
    _promotions(a, b, out[2])
    _in_place(a, b, out[3])
    _values(a, b, out[4])
    _loops(a, b, out[5])
    _slices(a, b, out[6])
    _records(constants, a, b, out[7])


EXPECTED = (arithmetic, comparisons, promotions, in_place, values, loops, slices, records)


@entry
def all_scalars(constants, a, b, out):
    _all(constants, a, b, out)


@entry
def all_lanes(constants, a, b, out):
    _all(constants, as_lanes(a), as_lanes(b), as_lanes(out))


def sample():
    """Numbers and special values, each against each, shape (2, n, WIDTH); the second is nowhere below zero."""
    special = np.array([0.0, -0.0, 1.0, -1.0, 2.5, -1e300, np.inf, -np.inf, np.nan])
    pairs = np.array([(a, b) for a in special for b in special if not b < 0]).T
    numbers = np.random.default_rng(1).normal(size=(2, 6 * WIDTH - pairs.shape[1] % WIDTH))
    both = np.hstack((pairs, numbers))
    both[1] = np.where(both[1] < 0, -both[1], both[1])
    result = aligned((2, both.shape[1] // WIDTH, WIDTH))
    result[...] = both.reshape(result.shape)
    return result


def evaluate(width):
    """The sample and the results of all kernels, (2, ...) and (kernels, ROWS, ...), in scalars or in lanes."""
    pair = sample()
    if width == 1:
        pair = pair.reshape(2, -1)
    out = aligned((len(EXPECTED), ROWS, *pair.shape[1:]))
    (all_scalars if width == 1 else all_lanes)(CONSTANTS, *pair, out)
    return pair, out


def assert_same_bits(got, expected):
    """Equal numbers with equal signs, also of zeros; any NaN equals any other."""
    np.testing.assert_array_equal(got, expected)
    number = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(got)[number], np.signbit(expected)[number])


@pytest.mark.parametrize("width", [1, WIDTH])
@pytest.mark.parametrize("expected", EXPECTED, ids=lambda function: function.__name__)
def test_kernel_gives_the_bits_of_numpy(expected, width):
    pair, out = evaluate(width)
    with np.errstate(all="ignore"):
        rows = expected(*pair)
    for got, row in zip(out[EXPECTED.index(expected)], rows):
        assert_same_bits(got, row)


def digest():
    """Hash of the results of all kernels, in lanes."""
    out = evaluate(WIDTH)[1]
    return hashlib.sha256(np.where(np.isnan(out), np.nan, out).tobytes()).hexdigest()


def test_bits_are_the_same_with_the_jit_off():
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-W", "error", "-c", "import test_lanes as t; print(t.digest())"]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == digest()


@kernel
def _powers(n, out):
    for i in range(len(n)):
        out[i] = power_of_two(n[i])


@entry
def powers_scalars(n, out):
    _powers(n, out)


@entry
def powers_lanes(n, out):
    _powers(as_lanes(n), as_lanes(out))


@pytest.mark.bounds
def test_every_power_of_two_is_exact():
    n = aligned((256, WIDTH))
    n.reshape(-1)[:2046] = np.arange(-1022, 1024)
    expected = np.ldexp(1.0, n.astype(int))
    scalars, lanes = aligned(n.size), aligned(n.shape)
    powers_scalars(n.ravel(), scalars)
    powers_lanes(n, lanes)
    np.testing.assert_array_equal(scalars, expected.ravel())
    np.testing.assert_array_equal(lanes, expected)


@kernel
def _recurrence(x):
    """Newton's iteration for the root of 2, capped: it settles from a positive start and breaks from others."""
    for i in range(len(x)):
        for _ in range(20):
            x[i] = 0.5 * (x[i] + 2.0 / x[i]) + sqrt(x[i]) * 1e-3
            if any_lane(x[i] > 1e6):
                x[i] = select(x[i] > 1e6, 1e6, x[i])


@entry
def recurrence_scalars(x):
    _recurrence(x)


@entry
def recurrence_lanes(x):
    _recurrence(as_lanes(x))


@pytest.mark.bounds
@pytest.mark.parametrize("calm", range(WIDTH))
def test_calm_lane_beside_infinities_and_nan_stays_unaffected(calm):
    lanes = aligned((1, WIDTH))
    lanes[0] = [np.inf, -np.inf, np.nan, 0.0, -1.0, 1e308, 5e-324, -0.0]
    lanes[0, calm] = 1.25
    scalar = np.array([1.25])
    recurrence_scalars(scalar)
    recurrence_lanes(lanes)
    assert np.isfinite(scalar[0])
    assert lanes[0, calm] == scalar[0]


@entry
def any_positive(x, out):
    lanes = as_lanes(x)
    for i in range(len(lanes)):
        out[i] = 1.0 if any_lane(lanes[i] > 0.0) else 0.0


@pytest.mark.bounds
def test_any_lane_sees_each_single_lane():
    x = aligned((WIDTH + 1, WIDTH))
    x[:WIDTH] = np.eye(WIDTH)
    out = np.empty(WIDTH + 1)
    any_positive(x, out)
    np.testing.assert_array_equal(out, [1.0] * WIDTH + [0.0])


@pytest.mark.parametrize("shape", [8, (3, WIDTH), (2, 5, WIDTH), (7, 1, 3)])
def test_aligned_array_starts_at_a_multiple_of_64_bytes(shape):
    for _ in range(4):  # the allocator's own alignment varies from call to call
        array = aligned(shape)
        assert array.ctypes.data % 64 == 0
        assert array.flags.c_contiguous
        assert array.shape == np.empty(shape).shape
        assert not array.any()
