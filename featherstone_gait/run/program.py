"""Compile controllers written in Python into the run.

Example::

    @controller(memory=1, period=0.02)
    def lean(t, state, reference, command, memory):
        memory[0] += 0.02 * state.base_qd[4]
        command[2, 0] = reference[2, 0] - 0.1 * memory[0]

    simulate(scene, 2.0, controller=lean)
"""

from __future__ import annotations

import functools
import inspect
import sys
from collections import namedtuple
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from pkgutil import resolve_name
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, functions, instance, one_of, real, whole
from ..base.brief import brief
from ..core.compile.jit import JIT, CompilationError, carray, outside
from ..core.step import program as core
from ..core.step.state import IN_STATE
from ..model import Controller
from ..scene.compile import CompiledScene

Writes = Literal["reference", "voltage"]
SEEN = tuple(channel.name for channel in IN_STATE if channel.kind != "run")
State = namedtuple("State", SEEN)  # type: ignore[misc]  # arrays by channel, flat; of length 0 where there is none
ARGUMENTS = ("t", "state", "reference", "command", "memory")
LENGTH, JOINTS, MEMORY, STARTS = 0, 1, 2, 3  # in the places


@dataclass(frozen=True, eq=False)
class CompiledController:
    """A function that acts at controller ticks within a run; made by `controller`.

    Attributes
    ----------
    function : callable
        The Python function.
    memory : int
        How many numbers it keeps.
    period : float or None
        Time between calls [s]; None: a controller tick.
    writes : {"reference", "voltage"}
        What its command is.
    begins : ndarray or None
        Numbers (memory,) with which its memory begins; None: zeros.
    """

    function: Callable[..., None]
    memory: int
    period: float | None
    writes: Writes
    begins: np.ndarray | None = None
    _made: dict[str, Any] = field(default_factory=dict, repr=False)

    __repr__ = brief

    @property
    def name(self) -> str:
        """The name of the function."""
        return getattr(self.function, "__qualname__", repr(self.function))

    def __call__(self, *arguments: Any) -> None:
        """Call the function itself, in Python."""
        self.function(*arguments)

    def beginning_with(self, numbers: ArrayLike) -> CompiledController:
        """Return the controller with numbers (memory,) with which its memory begins in each run.

        One compiled function so serves any parameters, which it reads from its memory.
        """
        begins = finite("memory", numbers, (None,), "the numbers that it begins with")
        return replace(self, memory=len(begins), begins=begins)

    @property
    def first_memory(self) -> np.ndarray | float:
        """Numbers with which the memory of each run begins."""
        return 0.0 if self.begins is None else self.begins

    @property
    def kind(self) -> Hashable:
        """Key that runs which share a vector have in common."""
        return self.function, self.memory, self.period, self.writes

    def __reduce__(self) -> Any:
        module, name = self.function.__module__, self.name
        found: Any = sys.modules.get(module)
        for part in name.split("."):
            found = getattr(found, part, None)
        if getattr(found, "function", None) is not self.function:
            raise TypeError(f"controller {name}: to reach other processes it must be a name of its module {module}")
        return _found, (module, name, self.begins)

    def driving(self, scene: CompiledScene) -> CompiledScene:
        """Return the scene that it drives; ValueError where no sampled servo takes what it writes."""
        if not scene.sampled:
            raise ValueError(
                f"controller {self.name}: {scene.model.name} has no sampled servos that take what it writes: compile "
                "the scene with gearbox='mipsd', or step it with Session(..., action='torque')"
            )
        self.every(scene)
        return open_loop(scene) if self.writes == "voltage" else scene

    def every(self, scene: CompiledScene) -> int:
        """Return the number of ticks from one call to the next."""
        tick = scene.tick_steps * scene.timestep
        if self.period is None:
            return 1
        ticks = round(self.period / tick)
        if ticks < 1 or abs(ticks * tick - self.period) > 1e-9 * self.period:
            raise ValueError(
                f"controller {self.name}: its period is {self.period:g} s; servos take what it writes at ticks of "
                f"{tick:g} s: give a whole number of these, or None"
            )
        return ticks

    def bound(self, scene: CompiledScene, zeros: Callable[..., np.ndarray]) -> core.Program:
        """Return what the kernels read, with its memory as it begins."""
        n, length = scene.tree.n, scene.layout["length"]
        starts = [place for name in SEEN for place in scene.part(name)]
        places = np.array([length, n, self.memory, *starts], np.int64)
        memory = zeros(self.memory)
        memory.T[...] = self.first_memory
        return core.Program(
            function=self._address(),
            every=self.every(scene),
            replaces=True if self.writes == "voltage" else None,
            command=zeros((n, 2)),
            memory=memory,
            clock=zeros(3),
            state=np.zeros(length),
            offsets=places,
            reference=np.zeros(2 * n),
            own_command=np.zeros(2 * n),
            own_memory=np.zeros(self.memory),
            failure=np.zeros(2),
        )

    def _address(self) -> Any:
        """Return the address of the compiled function."""
        if "address" not in self._made:
            try:
                self._made["kept"], self._made["address"] = outside(self.function, _wrapped)
            except CompilationError as error:
                lines = [line for line in str(error).splitlines() if line.strip()]
                raise ValueError(
                    f"controller {self.name} does not compile: {lines[0] if lines else error}; it takes "
                    f"{', '.join(ARGUMENTS)}, writes command (joints, 2) and memory ({self.memory},), and calls what "
                    "Numba compiles: Numba's message is below"
                ) from error
        return self._made["address"]

    def check(self, program: core.Program) -> None:
        """Raise ValueError if it has raised an exception, with that of the same call in Python."""
        if program.failure[core.FAILED] == 0.0:
            return
        t, why = float(program.failure[core.WHEN]), "an exception"
        arrays = (program.state, program.offsets, program.reference, program.own_command, program.own_memory)
        cause: BaseException | None = None
        try:
            self.function(t, *_views(*arrays))
        except Exception as error:
            why, cause = f"{type(error).__name__}: {error}", error
        program.failure[:] = 0.0
        raise ValueError(
            f"controller {self.name} failed at {t:.6g} s: {why}; command is ({len(program.reference) // 2}, 2) and "
            f"memory ({self.memory},): write within them, or ask for more memory"
        ) from cause


def controller(
    function: Callable[..., None] | None = None,
    *,
    memory: int = 0,
    period: float | None = None,
    writes: Writes = "reference",
) -> Any:
    """Compile a function into runs as their controller: ``simulate(scene, ..., controller=lean)``.

    Numba compiles the function, with bounds checked.  It is called for one robot at a time, in lanes too.

    Parameters
    ----------
    function
        Called at ticks as ``function(t, state, reference, command, memory)``, with the time [s]; the state's channels
        by name, as `state.q` (joints,) or `state.base_q` (7,), flat, empty where the robot has none, not to be written;
        what the servos would follow (joints, 2), position [rad or m] and rate; what they are to follow (joints, 2),
        which equals `reference` until it is written; and its own numbers (memory,), zero at the start of a run.
    memory
        How many numbers it keeps.
    period
        Time between calls [s], a whole number of controller ticks, between which its command stands.  None: each tick.
    writes
        "reference", or "voltage": ``command[:, 0]`` is then the voltage of each motor [V], zero until it is written,
        past the servo's own law but through limits, delay and supply.

    Returns
    -------
    CompiledController
        Or a decorator that makes one, if `function` is left out.

    Raises
    ------
    ValueError
        For a function with other arguments.

    Examples
    --------
    >>> @controller(memory=1, period=0.02)
    ... def lean(t, state, reference, command, memory):
    ...     memory[0] += 0.02 * state.base_qd[4]
    ...     command[2, 0] = reference[2, 0] - 0.1 * memory[0]
    """
    if function is None:
        return functools.partial(controller, memory=memory, period=period, writes=writes)
    functions(controller=function)
    instance("controller", getattr(function, "__code__", None), type(controller.__code__), "give a Python function")
    given = [*inspect.signature(function).parameters.values()]
    plain = all(one.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD for one in given)
    if len(given) != len(ARGUMENTS) or not plain:
        names = ", ".join(map(str, given)) or "nothing"
        raise ValueError(f"controller {function.__qualname__} takes {names}; it is called with {', '.join(ARGUMENTS)}")
    size = whole("memory", memory, 0, "give how many numbers it keeps", 10**6)
    period = None if period is None else real("period", period, 1e-9, 1e9, "give seconds")
    one_of("writes", writes, ("reference", "voltage"))
    return CompiledController(function, size, period, writes)


def open_loop(scene: CompiledScene, duty: bool = False) -> CompiledScene:
    """Return the scene whose servos take their reference as voltage [V] or duty cycle: u = Kf times it, and no more."""
    servos = {}
    for name, servo in scene.model.servos.items():
        law = servo.controller
        straight = Controller(
            "state", Kf=servo.voltage_limit if duty else 1.0, period=law.period, lag=law.lag,
            pwm_steps=law.pwm_steps, duty_limit=law.duty_limit, delay=law.delay,
        )  # fmt: skip
        servos[name] = replace(servo, controller=straight)
    return scene.recompiled(scene.model.with_numbers(servos=servos))


def _found(module: str, name: str, begins: np.ndarray | None) -> Any:
    made = resolve_name(f"{module}:{name}")
    return made if begins is None else made.beginning_with(begins)


def _views(
    state: np.ndarray, places: np.ndarray, reference: np.ndarray, command: np.ndarray, memory: np.ndarray
) -> tuple[Any, ...]:
    """Return what the function takes after the time."""
    starts = places[STARTS:].tolist()
    channels = [state[first:end] for first, end in zip(starts[::2], starts[1::2])]
    return State(*channels), reference.reshape(-1, 2), command.reshape(-1, 2), memory


def _wrapped(function: Callable[..., None]) -> Callable[..., None]:
    """Return what the kernels call, with pointers if compiled, else with arrays; it notes an exception."""
    if not JIT:

        def call(t: float, *arrays: np.ndarray) -> None:
            try:
                function(t, *_views(*arrays[:5]))
            except Exception:
                arrays[5][core.FAILED] = 1.0

        return call
    # Write out the views of all channels, since Numba loops over no fields.
    fields = ", ".join(f"y[places[{STARTS + 2 * k}] : places[{STARTS + 2 * k + 1}]]" for k in range(len(SEEN)))
    lines = (
        "def wrapper(t, state, places, reference, command, memory, failure):",
        f"    places = carray(places, {STARTS + 2 * len(SEEN)})",
        f"    y, n = carray(state, places[{LENGTH}]), places[{JOINTS}]",
        f"    seen = State({fields})",
        "    try:",
        "        function(",
        "            t, seen, carray(reference, (n, 2)), carray(command, (n, 2)),",
        f"            carray(memory, places[{MEMORY}]),",
        "        )",
        "    except Exception:",
        "        carray(failure, 1)[0] = 1.0",
    )
    scope: dict[str, Any] = {"carray": carray, "State": State, "function": function}
    exec("\n".join(lines), scope)
    return scope["wrapper"]
