"""The elementary functions: error against mpmath, special values, equal bits in any width and with the JIT off."""

import hashlib
import math
import os
import subprocess
import sys
from pathlib import Path

import mpmath
import numpy as np
import pytest

from featherstone_gait.base import portable_math as elementary
from featherstone_gait.core.compile.elementary import NEAR, SINCOS_LIMIT, exp, log, sincos
from featherstone_gait.core.compile.jit import entry, kernel
from featherstone_gait.core.compile.lanes import WIDTH, aligned, as_lanes, select

pytestmark = pytest.mark.nojit

ROOT = Path(__file__).parents[2]
INF, NAN = math.inf, math.nan
SMALLEST = 5e-324
SIN, COS, EXP, LOG = range(4)
SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, SMALLEST, -SMALLEST, INF, -INF, NAN])


@kernel
def _all(x, out):
    for i in range(x.shape[0]):
        out[0, i], out[1, i] = sincos(x[i])
        out[2, i] = exp(x[i])
        out[3, i] = log(select((x[i] > 1e-300) & (x[i] < 1e300), x[i], 1.0 + 0.0 * out[3, i]))


@entry
def all_scalars(x, out):
    _all(x, out)


@entry
def all_lanes(x, out):
    _all(as_lanes(x), as_lanes(out))


def evaluate(x):
    """sin x, cos x, exp x and, for normal x > 0, log x, shape (4, n)."""
    x = np.ascontiguousarray(x, dtype=float)
    out = np.zeros((4, x.size))
    all_scalars(x, out)
    return out


def largest_error(function, got, *arguments):
    """Largest error of `got` against the mpmath function, in ulp of the true value."""
    with mpmath.workprec(300):
        true = [function(*map(mpmath.mpf, map(float, values))) for values in zip(*arguments)]
        return max(float(abs(float(g) - t) / math.ulp(float(t))) for g, t in zip(got, true))


def near_multiples(divisor, count, rng, limit=SINCOS_LIMIT):
    """The float64 nearest to multiples of pi/divisor, small ones and all over the range."""
    most = int(limit / math.pi * divisor)
    with mpmath.workprec(300):
        multiples = (*range(-count // 2, count // 2), *rng.integers(-most, most, count))
        return np.array([float(int(n) * mpmath.pi / divisor) for n in multiples])


SINCOS_SAMPLES = {
    "first quadrant": lambda rng: rng.uniform(-math.pi / 2, math.pi / 2, 4000),
    "edge of the reduction": lambda rng: rng.uniform(0.7, 0.87, 4000),
    "joint angles": lambda rng: rng.uniform(-20.0, 20.0, 4000),
    "whole range": lambda rng: rng.uniform(-SINCOS_LIMIT, SINCOS_LIMIT, 4000),
    "range of the short reduction": lambda rng: rng.uniform(-NEAR, NEAR, 4000),
    "where the long one begins": lambda rng: NEAR * (1.0 + rng.uniform(-1e-9, 1e-9, 1000)),
    "multiples of pi/2": lambda rng: near_multiples(2, 2000, rng),
    "multiples of pi/4": lambda rng: near_multiples(4, 2000, rng),
    "multiples of pi/2, short": lambda rng: near_multiples(2, 2000, rng, NEAR),
    "tiny": lambda rng: rng.choice([-1.0, 1.0], 1000) * np.exp(rng.uniform(-744.0, 0.0, 1000)),
    "limit": lambda rng: np.array([SINCOS_LIMIT, -SINCOS_LIMIT]),
}


@pytest.mark.bounds
@pytest.mark.parametrize("sample", SINCOS_SAMPLES)
def test_sine_and_cosine_err_by_less_than_one_ulp(sample):
    x = SINCOS_SAMPLES[sample](np.random.default_rng(1))
    out = evaluate(x)
    assert largest_error(mpmath.sin, out[SIN], x) < 1.0
    assert largest_error(mpmath.cos, out[COS], x) < 1.0


@pytest.mark.parametrize("span", [(-0.35, 0.35), (-20.0, 20.0), (-708.0, 709.7), (-745.13, -708.0)])
def test_exponential_errs_by_less_than_one_ulp(span):
    x = np.random.default_rng(2).uniform(*span, 4000)
    assert largest_error(mpmath.exp, evaluate(x)[EXP], x) < 1.0


@pytest.mark.parametrize("span", [(-690.0, 690.0), (-1.0, 1.0), (-1e-6, 1e-6)])
def test_logarithm_errs_by_less_than_one_and_a_half_ulp(span):
    x = np.exp(np.random.default_rng(3).uniform(*span, 4000))
    assert largest_error(mpmath.log, evaluate(x)[LOG], x) < 1.5


def test_sine_and_cosine_beyond_the_limit_are_nan():
    beyond = np.nextafter(SINCOS_LIMIT, INF)
    out = evaluate([beyond, -beyond, 1e300, INF, -INF, NAN])
    assert np.isnan(out[[SIN, COS]]).all()


def test_odd_functions_are_odd_and_even_ones_even_to_the_bit():
    rng = np.random.default_rng(5)
    x = np.concatenate((rng.uniform(0.0, SINCOS_LIMIT, 2000), rng.uniform(0.0, 3.0, 2000), [0.0, SINCOS_LIMIT]))
    plus, minus = evaluate(x), evaluate(-x)
    assert minus[SIN].tobytes() == (-plus[SIN]).tobytes()
    assert minus[COS].tobytes() == plus[COS].tobytes()


def test_limits_of_the_exponential():
    largest, underflow = 709.782712893384, -745.1332191019411
    x = [-INF, np.nextafter(underflow, -INF), underflow, -0.0, 0.0, largest, np.nextafter(largest, INF), INF, NAN]
    expected = [0.0, 0.0, SMALLEST, 1.0, 1.0, float(mpmath.exp(largest)), INF, INF, NAN]
    np.testing.assert_array_equal(evaluate(x)[EXP], expected)


def digest():
    """Hash of the bits of all functions over a sample with special values: one for scalars, one for lanes."""
    rng = np.random.default_rng(6)
    special = np.append(SPECIAL, np.full(2 * WIDTH - len(SPECIAL), 3 * SMALLEST))
    x = np.hstack([special, *(rng.uniform(-high, high, 50 * WIDTH) for high in (1.0, 30.0, 800.0, 2e5, 4e5, 1e9))])
    scalars = evaluate(x)
    lanes = [aligned((*lead, x.size // WIDTH, WIDTH)) for lead in ((), (4,))]
    lanes[0][...] = x.reshape(-1, WIDTH)
    all_lanes(*lanes)
    results = (np.where(np.isnan(out), NAN, out) for out in (scalars, lanes[1]))  # IEEE 754 leaves a NaN's sign open
    return " ".join(hashlib.sha256(out.tobytes()).hexdigest() for out in results)


def test_arrays_have_the_bits_of_the_kernels():
    rng = np.random.default_rng(8)
    x = np.concatenate([SPECIAL, rng.uniform(-20.0, 20.0, 991), rng.uniform(-3e5, 3e5, 1000)]).reshape(4, -1)
    for got, expected in zip(elementary.sincos(x), evaluate(x.ravel())):
        assert type(got) is np.ndarray
        assert got.tobytes() == expected.reshape(4, -1).tobytes()
    assert [float(a) for a in elementary.sincos(0.5)] == evaluate([0.5])[:2, 0].tolist()


@pytest.mark.bounds
def test_lanes_have_the_bits_of_scalars():
    scalars, lanes = digest().split()
    assert scalars == lanes


def test_bits_are_the_same_with_the_jit_off():
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-W", "error", "-c", "import test_elementary as t; print(t.digest())"]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == digest()
