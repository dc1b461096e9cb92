"""Wrong arguments for every public function: what comes back must be an error that names the argument, or sound.

    rows = attack_api(10_000, seed=1)

Each attack takes a function with right arguments (`right_calls`), puts something else in place of one or two of them,
from a pool of values that are hardly ever right or by spoiling the right one, and looks at what happens.  A row is a
fault: another exception than ValueError, TypeError or OSError, one that comes from inside NumPy, Numba or Python, a
message that does not name the argument, a call that takes too long, or an answer that is not finite.
"""

from __future__ import annotations

import contextlib
import io
import linecache
import math
import os
import random
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .attack_calls import Call, right_calls
from .time_limit import TooLong, time_limit

LIMIT, DEAR_LIMIT = 10.0, 40.0  # of a call, and of one that simulates, right or wrong [s]
SHARE_OF_TWO = 0.2  # attacks on two arguments at once
ALLOWED = (ValueError, TypeError, OSError, ImportError, RuntimeError)
PACKAGE = str(Path(__file__).parents[1])

POOL: tuple[Any, ...] = (
    None,
    "",
    "text",
    "1.0",
    b"x",
    0,
    -1,
    3,
    10**400,
    -(10**30),
    0.5,
    math.nan,
    math.inf,
    -math.inf,
    1e200,
    1e-320,
    1e16,
    1j,
    True,
    object(),
    object,
    len,
    [],
    {},
    (),
    {1, 2},
    {"a": 1.0},
    {None: None},
    [None],
    ["1"],
    [[1.0], [1.0, 2.0]],
    [1.0, "a"],
    [object()],
    range(3),
    np.array(1.0),
    np.zeros(0),
    np.zeros((2, 3, 4)),
    np.array(["1"]),
    np.array([True]),
    np.array([1j]),
    np.full(7, np.nan),
    np.array([1.0, None], dtype=object),
    np.float32(1.0),
    np.datetime64("2020-01-01"),
)
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
}
NEVER_RIGHT = (object, complex)  # types that no argument takes


class Row(NamedTuple):
    """A fault."""

    function: str
    arguments: str  # that were wrong
    fault: str
    message: str


def attack_api(count: int, seed: int, names: tuple[str, ...] | None = None, dear: bool = True) -> list[Row]:
    """Attack public functions `count` times; return the faults.

    names: of the functions, None is all; dear: also those that compile a simulation or take long.
    """
    rng, rows = random.Random(seed), []
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        os.chdir(folder)  # for what writes a file
        try:
            calls = [c for c in right_calls() if (names is None or c.name in names) and (dear or not c.dear)]
            for call in (c for c in calls if c.dear):
                call.function(**call.arguments)  # compiles what is not in the cache
            for k in range(count):
                rows += _attack(rng, calls[k % len(calls)])
        finally:
            os.chdir(here)
    return rows


def _attack(rng: random.Random, call: Call) -> list[Row]:
    """One call with wrong arguments."""
    wanted = 2 if rng.random() < SHARE_OF_TWO else 1
    spoiled = rng.sample(sorted(call.arguments), min(wanted, len(call.arguments)))
    arguments = dict(call.arguments)
    for name in spoiled:
        value = arguments[name]  # a function in place of another is right, whatever it raises
        arguments[name] = rng.choice(POOL) if rng.random() < 0.6 else _spoiled(rng, value)
        if callable(value) and callable(arguments[name]):
            arguments[name] = None
    fault = _judged(call, arguments, spoiled)
    shown = ", ".join(f"{name}={_shown(arguments[name])}" for name in spoiled)
    return [Row(call.name, shown, *fault)] if fault else []


def _spoiled(rng: random.Random, value: Any) -> Any:
    """Something that looks like the value."""
    try:
        a = np.array(value, dtype=float)
    except (TypeError, ValueError, RuntimeError):
        return rng.choice(([value], (value, value), {"a": value}, str(value), [value, None]))
    choices: list[Any] = [
        a[None],
        a.astype(str),
        a.astype(complex) + 1j,
        a.astype(object),
        a > 0,
        -a,
        1e30 * a,
        np.append(a, 1.0),
    ]
    choices += [_with(rng, a, bad) for bad in (np.nan, np.inf, 1e200, -1.0, 1e-300)]
    choices += [a.ravel()[:-1], a.tolist(), [str(x) for x in a.ravel()], np.float32(a), a.T, a.ravel()]
    return choices[rng.randrange(len(choices))]


def _with(rng: random.Random, a: np.ndarray, bad: float) -> Any:
    """The array with one number replaced."""
    a = np.array(a)
    if not a.ndim:
        return bad
    if a.size:
        a.flat[rng.randrange(a.size)] = bad
    return a


def _judged(call: Call, arguments: Mapping[str, Any], spoiled: list[str]) -> tuple[str, str] | None:
    """What is wrong with the outcome, and the message; None if nothing is."""
    start, limit = time.perf_counter(), DEAR_LIMIT if call.dear else LIMIT
    try:
        with time_limit(limit), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            answer = call.function(**arguments)
    except TooLong:
        return "too long", f"more than {limit:g} s"
    except ALLOWED as error:
        return _judged_error(error, spoiled)
    except BaseException as error:
        return type(error).__name__, f"{_where(error)}: {error}"[:300]
    if time.perf_counter() - start > limit:
        return "too long", f"{time.perf_counter() - start:.1f} s"
    if any(type(arguments[name]) in NEVER_RIGHT for name in spoiled):
        return "accepted", "no error"
    return None if _is_sound(answer) else ("not finite", repr(answer)[:200])


def _judged_error(error: BaseException, spoiled: list[str]) -> tuple[str, str] | None:
    frames = traceback.extract_tb(error.__traceback__)
    last = frames[-1]
    if isinstance(error, OSError) and error.filename is not None:
        return None
    line = linecache.getline(last.filename, last.lineno or 0).strip()
    text = f"{_where(error)}: {error}"[:300]
    if not last.filename.startswith(PACKAGE) or not line.startswith("raise"):
        return f"{type(error).__name__} from inside", text
    if not any(word in str(error).lower() for name in spoiled for word in _words(name)):
        return "not named", text
    return None


def _words(name: str) -> list[str]:
    """An argument as a message may call it."""
    name = name.lower()
    return [name, name.rstrip("s"), name.replace("_", " "), *OTHER_WORDS.get(name, ())]


def _where(error: BaseException) -> str:
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{Path(last.filename).name}:{last.lineno}"


def _is_sound(answer: Any) -> bool:
    """Whether an answer that came without a complaint is finite; failed runs may be as they are."""
    if getattr(answer, "status", "ok") not in ("ok", None):
        return True
    if isinstance(answer, np.ndarray) and answer.dtype.kind in "fc":
        return bool(np.isfinite(answer).all())
    if isinstance(answer, Mapping):
        return all(_is_sound(value) for value in answer.values())
    if isinstance(answer, tuple | list):
        return all(_is_sound(value) for value in answer)
    return True


def _shown(value: Any) -> str:
    text: Callable[[Any], str] = repr
    if isinstance(value, int) and abs(value) > 10**30:
        text = lambda v: f"2**{v.bit_length()}"  # noqa: E731
    return " ".join(text(value).split())[:120]
