"""Wrong arguments for every public function: each is refused by an error that names it, or the answer is finite."""

import math
import warnings
from collections.abc import Mapping

import numpy as np
import pytest
from fuzzing import REFUSALS, check_refusal, profiles, time_limit
from hypothesis import given
from hypothesis import strategies as st
from right_calls import NO_CALLS, PARTS, Call

import featherstone_gait
from featherstone_gait import search, walking
from featherstone_gait.identification import fit
from featherstone_gait.run import sensors

QUICK = 24  # examples
LIMIT, SLOW_LIMIT = 10.0, 40.0  # of a call, and of one that simulates, right or wrong [s]
NOT_NUMBERS = (None, "", "text", "1.0", b"x", 1j, True, object(), object, len, math.nan, math.inf, -math.inf)
NUMBERS = (0, -1, 3, 0.5, 10**400, -(10**30), 1e200, 1e-320, 1e16, np.float32(1.0), np.datetime64("2020-01-01"))
CONTAINERS = (
    [], {}, (), {1, 2}, {"a": 1.0}, {None: None}, [None], ["1"], [[1.0], [1.0, 2.0]], [1.0, "a"], [object()], range(3),
)  # fmt: skip
ARRAYS = (
    np.array(1.0), np.zeros(0), np.zeros((2, 3, 4)), np.array(["1"]), np.array([True]), np.array([1j]),
    np.full(7, np.nan), np.array([1.0, None], dtype=object),
)  # fmt: skip
POOL = st.sampled_from((*NOT_NUMBERS, *NUMBERS, *CONTAINERS, *ARRAYS))
OTHER_WORDS = {  # by which messages call arguments
    "name_or_path": ("robot",),
    "choice": ("contacts",),
    "name": ("servo",),
    "target": ("cannot reach", "outside its limits"),
    "path": ("file",),
    "start": ("reference", "gait"),
    "state": ("q[3:7]",),
    "q": ("joint",),
    "xyz": ("joint",),
    "trajectory": ("channel",),
    "joint_names": ("columns",),
}


def lookalikes(value):
    """Strategy of what is nearly the value."""
    try:
        a = np.array(value, dtype=float)
    except (TypeError, ValueError, RuntimeError):
        return st.sampled_from(([value], (value, value), {"a": value}, str(value), [value, None]))
    whole = [a[None], a.astype(str), a.astype(complex) + 1j, a.astype(object), a > 0, -a, 1e30 * a, np.append(a, 1.0)]
    whole += [a.ravel()[:-1], a.tolist(), [str(x) for x in a.ravel()], np.float32(a), a.T, a.ravel()]
    bad = st.sampled_from((np.nan, np.inf, 1e200, -1.0, 1e-300))
    one = st.builds(replaced, st.just(a), st.integers(0, max(a.size - 1, 0)), bad)
    return st.one_of(st.sampled_from(whole), one) if a.size else st.sampled_from(whole)


def replaced(a, k, bad):
    a = a.copy()
    a.flat[k] = bad
    return a if a.ndim else bad


@st.composite
def wrong_calls(draw, calls):
    """A call, its arguments with one or two of them spoiled, and the names of these."""
    call = draw(st.sampled_from(calls))
    spoiled = draw(st.lists(st.sampled_from(sorted(call.arguments)), min_size=1, max_size=2, unique=True))
    arguments = dict(call.arguments)
    for name in spoiled:
        value = draw(st.one_of(POOL, lookalikes(arguments[name])))
        both = callable(value) and callable(arguments[name])  # a function in place of another is right
        arguments[name] = None if both else value
    return call, arguments, spoiled


def check_call(call, arguments, spoiled):
    """Call; fail if the arguments are neither refused by name nor give a sound answer."""
    try:
        with time_limit(SLOW_LIMIT if call.slow else LIMIT):
            answer = call.function(**arguments)
    except REFUSALS as error:
        words = [
            w for n in map(str.lower, spoiled) for w in (n.rstrip("s"), n.replace("_", " "), *OTHER_WORDS.get(n, ()))
        ]
        check_refusal(error, words)
    else:
        assert not any(type(arguments[name]) in (object, complex) for name in spoiled), "no argument takes such a type"
        assert is_sound(answer), answer


def is_sound(answer):
    """Whether an answer is finite; runs that failed may be as they are."""
    if getattr(answer, "status", "ok") not in ("ok", None):
        return True
    if isinstance(answer, np.ndarray) and answer.dtype.kind in "fc":
        return bool(np.isfinite(answer).all())
    if isinstance(answer, Mapping):
        return all(map(is_sound, answer.values()))
    return not isinstance(answer, tuple | list) or all(map(is_sound, answer))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Calls that write files do so there, and nothing warns."""
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@profiles(quick=QUICK)
@pytest.mark.parametrize("part", PARTS)
def test_wrong_arguments_are_refused_by_name(part, profile):
    quick = profile.max_examples == QUICK
    calls = [call for call in PARTS[part]() if not (quick and call.slow)]
    for call in calls:
        call.function(**call.arguments)  # compiles what is not in the cache

    @profile
    @given(wrong_calls(calls))
    def check(wrong):
        check_call(*wrong)

    check()


def test_every_public_function_is_called():
    called = {call.name.removeprefix("sensors.") for part in PARTS.values() for call in part()}
    names = set(featherstone_gait.__all__) | set(walking.__all__) | set(search.__all__)
    for module in (fit, sensors):
        names |= {n for n, f in vars(module).items() if n[0] != "_" and getattr(f, "__module__", "") == module.__name__}
    assert names - called == {name for some in NO_CALLS.values() for name in some}


@pytest.mark.parametrize("part", PARTS)
def test_right_arguments_are_right(part):
    for call in PARTS[part]():
        if not call.slow:
            check_call(call, call.arguments, [])


@pytest.mark.parametrize(
    ("function", "value", "error", "message"),
    [
        (lambda x: {}[x], 1.0, KeyError, "1.0"),
        (lambda x: math.sqrt(x), 1j, AssertionError, "comes from"),
        (lambda x: np.array([math.nan]), 1.0, AssertionError, "nan"),
        (lambda x: None, 1j, AssertionError, "no argument takes"),
        (lambda x: featherstone_gait.Sphere(x), -1.0, AssertionError, "names none of"),
    ],
)
def test_faults_are_seen(function, value, error, message):
    with pytest.raises(error, match=message):
        check_call(Call("f", lambda quantity: function(quantity), {"quantity": 1.0}), {"quantity": value}, ["quantity"])


def test_a_call_that_takes_too_long_is_seen():
    def work():
        with time_limit(0.1):
            while True:
                pass

    with pytest.raises(AssertionError, match=r"more than 0\.1 s"):
        work()
