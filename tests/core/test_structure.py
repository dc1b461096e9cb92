"""Structures: NamedTuples that compiled kernels pass by address, with the results that Python has."""

from typing import NamedTuple

import numpy as np
import pytest

from featherstone_gait.core.compile.jit import ENTRY, JIT, entry, inline, kernel
from featherstone_gait.core.compile.lanes import WIDTH, aligned, as_lanes
from featherstone_gait.core.compile.optional import in_lanes
from featherstone_gait.core.compile.structure import replacing, structure
from featherstone_gait.core.step.context import Scene

RECORD = np.dtype([("m", np.float64), ("k", np.int64)])


@structure
class Inner(NamedTuple):
    x: np.ndarray
    absent: np.ndarray | None
    on: bool
    weight: float

    SHARED = ("weight",)


@structure
class Outer(NamedTuple):
    inner: Inner
    record: np.record
    pair: tuple[float, int]


class Plain(NamedTuple):
    first: Inner
    second: Inner


def a_structure(x):
    return Inner(x, None, True, 0.5)


def an_outer(x):
    record = np.zeros(1, RECORD).view(np.recarray)
    record[0] = (3.0, 2)
    return Outer(a_structure(x), record[0], (0.25, 7))


_with = inline(replacing(Inner, "on", "x", "weight"))


@kernel
def _turned(a, k):
    """A structure made here and given back."""
    return _with(a, not a.on, a.x[k:], a.weight + k)


@kernel
def _swapped(p):
    return Plain(p.second, p.first)


@inline
def _value(a):
    return (a.x[0] + a.weight) if a.on else -(a.x[0] + a.weight)


@entry
def _in_a_loop(outer, out):
    for k in range(len(out)):
        a = outer.inner
        if k > 1:
            a = _turned(a, k)
        both = _swapped(Plain(a, _turned(outer.inner, 0)))
        out[k] = _value(both.first) + 10.0 * _value(both.second) + outer.record.m * outer.pair[0] * outer.pair[1]
        if a.absent is not None:
            out[k] = np.nan


@entry
def _lanes(a, out):
    b = in_lanes(a)
    _half(b, as_lanes(out))


@kernel
def _half(b, out):
    for i in range(len(b.x)):
        out[i] = b.weight * b.x[i]


@pytest.mark.bounds
@pytest.mark.nojit
def test_fields_are_those_of_python_in_loops_branches_and_results():
    outer, out = an_outer(np.arange(5.0)), np.zeros(5)
    _in_a_loop(outer, out)
    first = [-(0.0 + 0.5)] * 5  # of the turned one
    second = [0.5, 0.5, *(-(k + 0.5 + k) for k in range(2, 5))]
    np.testing.assert_array_equal(out, np.array(first) + 10.0 * np.array(second) + 3.0 * 0.25 * 7)
    np.testing.assert_array_equal(outer.inner.x, np.arange(5.0))


@pytest.mark.bounds
@pytest.mark.nojit
def test_lanes_share_what_the_class_says():
    x, out = aligned((3, WIDTH)), aligned((3, WIDTH))
    x[:] = np.arange(3 * WIDTH).reshape(3, WIDTH)
    _lanes(a_structure(x), out)
    np.testing.assert_array_equal(out, 0.5 * x)


@pytest.mark.nojit
def test_it_stays_the_named_tuple_that_it_looks_like():
    a = a_structure(np.ones(1))
    assert isinstance(a, tuple)
    assert a._fields == ("x", "absent", "on", "weight")
    assert a._replace(weight=2.0).weight == 2.0
    assert Inner.__doc__ == "Inner(x, absent, on, weight)"


@pytest.mark.skipif(not JIT, reason="is about compiled code")
def test_what_differs_in_one_field_is_another_type():
    import numba

    a = a_structure(np.ones(1))
    kinds = [numba.typeof(x) for x in (a, a._replace(absent=np.ones(1)), a._replace(weight=1), a_structure(np.ones(2)))]
    assert len(set(kinds)) == 3
    assert kinds[0] == kinds[3]
    assert hash(kinds[0]) == hash(kinds[3])
    other = structure(NamedTuple("Inner", [("x", np.ndarray), ("absent", None), ("on", bool), ("weight", float)]))
    plain = (np.void(0), (0.0, 1))
    assert numba.typeof(Outer(other(*a), *plain)) != numba.typeof(Outer(a, *plain))


@pytest.mark.skipif(not JIT, reason="is about compiled code")
def test_functions_take_an_address_and_not_the_fields():
    import numba

    own = numba.njit(_in_a_loop.py_func, **ENTRY)
    own(an_outer(np.arange(5.0)), np.zeros(5))
    (text,) = own.inspect_llvm().values()
    (head,) = (line for line in text.splitlines() if line.startswith("define") and "readonly" in line)
    assert head.count(",") < 12  # results, the structure, and what an array is made of


@pytest.mark.nojit
def test_a_copy_with_other_values_of_some_fields_is_the_same_in_all_else():
    scene = Scene(*(f"scene's {name}" for name in Scene._fields))
    copied = replacing(Scene, "tree", "balls")(scene, "others", None)
    assert type(copied) is Scene
    assert copied == scene._replace(tree="others", balls=None)
