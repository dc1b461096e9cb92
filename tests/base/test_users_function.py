"""Why users' functions fail: the reason, the place and the shapes of the arguments, in one line."""

import numpy as np
import pytest

from featherstone_gait import run_cost
from featherstone_gait.base.users_function import failure_of

TWO = {"base_q": np.zeros((5, 2, 7))}  # of two free bodies


def beyond(base_q):
    return base_q[-1, 2, 0]


def too_many(base_q):
    return base_q[-1, 0, 0, 0]


def whole_axis(base_q):
    return base_q[-1, 0]


def uncompiled(base_q):
    return base_q[-1, 0, 0] + len({}.fromkeys([str(base_q)]))


@pytest.mark.parametrize(
    ("function", "why"),
    [
        (beyond, r"index 2 is out of bounds for axis 1 with size 2"),
        (too_many, r"too many indices for array: array is 3-dimensional, but 4 were indexed"),
        (whole_axis, r"it returns an array \(7,\), where one number is needed"),
    ],
)
def test_a_cost_that_indexes_two_bodies_wrongly_is_told_the_shapes(function, why):
    """With the line of the function that does, and without what Numba tried."""
    line = function.__code__.co_firstlineno + (function is not whole_axis)
    text = rf'cost {function.__name__} \(File ".*test_users_function\.py", line {line}\): .*{why}.* base_q \(5, 2, 7\)'
    with pytest.raises(ValueError, match=text) as raised:
        run_cost(function)(TWO)
    assert raised.value.__cause__ is None
    assert raised.value.__suppress_context__
    assert len(str(raised.value).splitlines()) == 1


def test_where_python_has_no_objection_it_is_numba_that_is_quoted():
    with pytest.raises(ValueError, match=r"cost uncompiled .*base_q \(5, 2, 7\)") as raised:
        run_cost(uncompiled)(TWO)
    assert len(str(raised.value)) < 600


def test_arguments_are_shown_by_their_shapes():
    def law(t, memory):
        return memory[3] + t

    text = failure_of(law, {"t": 0.5, "memory": np.zeros(2)}, IndexError("index is out of bounds"))
    assert "index 3 is out of bounds" in text
    assert text.endswith("its arguments here: t a number, memory (2,)")
