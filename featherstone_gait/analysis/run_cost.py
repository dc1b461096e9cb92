"""Costs of a run with their derivatives by the recorded channels."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, functions, instance, is_real, shown
from ..base.brief import brief
from ..base.users_function import failure_of
from ..core.compile.jit import CompilationError
from ..core.compile.taped_cost import TapedFunction
from ..core.step.state import BY_NAME
from ..run.compiled_run import CompiledRun

WIDTH, OFF = 1e-6, 1e-3  # of differences that check a cost, relative to a channel's largest number; and what they allow


@dataclass(frozen=True, eq=False)
class RunCost:
    """A cost of a run that is differentiated while it is computed; made by `run_cost`.

    Attributes
    ----------
    function : callable
        The Python function.
    channels : tuple of str
        The channels that it takes, and "time" where it takes that.
    numbers : dict of ndarray
        What else it takes, see `given`.
    """

    function: Callable[..., float]
    channels: tuple[str, ...]
    numbers: Mapping[str, np.ndarray] = field(default_factory=dict)
    _made: dict[str, TapedFunction] = field(default_factory=dict, repr=False)

    __repr__ = brief

    def given(self, **numbers: ArrayLike) -> RunCost:
        """Return the cost with other arguments than channels, such as measurements: arrays by their names.

        Nothing is compiled anew for other values.
        """
        names = [*inspect.signature(self.function).parameters]
        for name in numbers:
            if name not in names or name in self.channels:
                raise ValueError(
                    f"cost {self.function.__qualname__}: there is no number {name!r} to give; it takes "
                    f"{', '.join(names)}: give one that is no channel"
                )
        given = {name: np.array(floats(name, value)) for name, value in numbers.items()}
        return RunCost(self.function, self.channels, {**self.numbers, **given}, self._made)

    def __call__(self, channels: Mapping[str, np.ndarray]) -> tuple[float, dict[str, np.ndarray]]:
        """Return the cost of recorded channels, and its derivatives by each."""
        names = [*inspect.signature(self.function).parameters]
        missing = [name for name in names if name not in self.channels and name not in self.numbers]
        if missing:
            raise ValueError(
                f"cost {self.function.__qualname__}: {', '.join(missing)} are neither channels nor given: correct the "
                f"name, or give it, cost.given({missing[0]}=...)"
            )
        if "taped" not in self._made:
            taped = [name in self.channels and name != "time" for name in names]
            self._made["taped"] = TapedFunction(self.function, taped)
        arrays = [channels[name] if name in self.channels else self.numbers[name] for name in names]
        try:
            value, derivatives = self._made["taped"].value_and_derivatives(arrays)
        except (CompilationError, IndexError) as error:
            why = failure_of(self.function, dict(zip(names, arrays)), error, one=True)
            raise ValueError(
                f"cost {why}; channels have the records first, then robots or joints: write it as loops over numbers, "
                "without operations on whole arrays, or return value and derivatives from a Python function"
            ) from None
        return value, {name: found for name, found in zip(names, derivatives) if found is not None}


def run_cost(function: Callable[..., float]) -> RunCost:
    """Compile a function of recorded channels as the cost of a run, for `gradient`.

    Numba compiles the function for numbers that note how they came about, so that its derivatives are exact.

    Parameters
    ----------
    function
        Called with the channels that its arguments name, each (records, ...) as in a `Trajectory`, "time" [s] among
        them; returns one number.  The last record is the end of the run.  Arguments with other names are numbers that
        `RunCost.given` gives.  It may use loops, branches, arithmetic, np.sum, np.mean, max, min, and the functions of
        math and NumPy of single numbers, but no operations on whole arrays.

    Returns
    -------
    RunCost

    Raises
    ------
    TypeError
        For what is no Python function.

    Examples
    --------
    >>> @run_cost
    ... def miss(q, target):
    ...     return (q[-1, 0] - target[0]) ** 2
    >>> gradient(scene, 1.0, miss.given(target=[0.5]), ["tau"], tau=[0.1])
    """
    functions(function=function)
    instance("function", getattr(function, "__code__", None), type(run_cost.__code__), "give a Python function")
    names = [*inspect.signature(function).parameters]
    return RunCost(function, tuple(name for name in names if name in BY_NAME or name == "time"))


Cost: TypeAlias = RunCost | Callable[[Mapping[str, np.ndarray]], tuple[float, Mapping[str, Any]]]


def record_of(cost: Cost, record: Any) -> Any:
    """Return the channels to record: those that a compiled cost takes, unless others are asked for."""
    if record is None and isinstance(cost, RunCost):
        return tuple(name for name in cost.channels if name != "time")
    return record


def seeds_of(
    cost: Cost, run: CompiledRun, out: np.ndarray, channels: Mapping[str, np.ndarray]
) -> tuple[float, np.ndarray]:
    """Return the cost of a run, and its derivatives by the recorded numbers (records, numbers)."""
    value, derivatives = _checked(cost, cost(channels), channels)
    seeds = np.zeros(out.shape)
    place = run.named(np.arange(out.shape[1], dtype=float)[None])  # which number stands where in a channel
    for name, found in derivatives.items():
        if BY_NAME[name].kind == "computed":
            needs = " and ".join(BY_NAME[name].needs)
            raise ValueError(f"cost: there are no gradients by the channel {name!r}; compute it from {needs}")
        at = place[name][0].astype(int).ravel()
        seeds[:, at] += found.reshape(len(seeds), -1)
    return value, seeds


def _checked(cost: Cost, answer: Any, channels: Mapping[str, np.ndarray]) -> tuple[float, dict[str, np.ndarray]]:
    """Check what a cost has returned; ValueError for what are no derivatives by channels."""
    remedy = "return the cost and a dictionary of its derivatives by channel, or decorate it with @run_cost"
    if not (isinstance(answer, tuple) and len(answer) == 2 and is_real(answer[0]) and isinstance(answer[1], Mapping)):
        raise ValueError(f"cost returned {shown(answer)}; {remedy}")
    if not np.isfinite(answer[0]):
        raise ValueError(f"cost is {answer[0]} of a run that ended well: correct it, {remedy}")
    found = {}
    for name, given in answer[1].items():
        if name not in channels or name == "time":
            raise ValueError(f"cost: there is no channel {shown(name)} among the recorded: {', '.join(channels)}")
        found[name] = np.array(floats(f"cost: derivative by {name}", given, remedy))
        if found[name].shape != channels[name].shape:
            raise ValueError(
                f"cost: its derivative by {name} has the shape {found[name].shape}; the channel has "
                f"{channels[name].shape}: {remedy}"
            )
    return float(answer[0]), found


def check_derivatives(cost: Cost, channels: Mapping[str, np.ndarray]) -> None:
    """Warn where derivatives of a cost are not those of its values, by differences along a random direction each."""
    _, derivatives = _checked(cost, cost(channels), channels)
    generator = np.random.default_rng(0)
    for name, found in derivatives.items():
        along = generator.standard_normal(found.shape) * max(np.abs(channels[name]).max(initial=0.0), 1e-3)

        def difference(width: float, name: str = name, along: np.ndarray = along) -> float:
            ends = (float(cost({**channels, name: channels[name] + way * width * along})[0]) for way in (1.0, -1.0))
            return (next(ends) - next(ends)) / (2.0 * width)

        each = [difference(width) for width in (WIDTH, 0.1 * WIDTH)]
        exact, size = float(np.sum(found * along)), float(np.sum(np.abs(found * along)))
        if all(abs(one - exact) > OFF * max(size, abs(one)) for one in each):
            warnings.warn(
                f"cost: along a random change of {name!r} it changes by {each[0]:.6g}, by its derivatives {exact:.6g}: "
                "correct these, unless the cost is not differentiable here",
                stacklevel=2,
            )
