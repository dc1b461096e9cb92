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
import math
import os
import sys
from collections import namedtuple
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, functions, instance, one_of, real, whole
from ..base.brief import brief
from ..base.users_function import failure_of, line_of, place_of, shapes_of
from ..core.compile import taped_cost as _taped_cost  # noqa: F401  # functions of math for taped numbers
from ..core.compile.chance import uses_chance
from ..core.compile.jit import JIT, CompilationError, carray, kernel, outside
from ..core.step import program as core
from ..core.step.state import IN_STATE
from ..model import TORQUE_LAWS, Controller, Model
from ..robot_file import scene_names
from ..robot_file.source import scene_path
from ..scene.actuator import usual_gearbox
from ..scene.compile import CompiledScene

DYNAMICS = __name__.partition(".")[0] + ".dynamics"

Writes = Literal["reference", "voltage", "torque"]
SEEN = tuple(channel.name for channel in IN_STATE if channel.kind != "run")
State = namedtuple("State", SEEN)  # type: ignore[misc]  # arrays by channel, flat; of length 0 where there is none
ARGUMENTS = ("t", "state", "reference", "command", "memory")
LENGTH, JOINTS, MEMORY, COMMANDS, STARTS = range(5)  # in the places


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
    writes : {"reference", "voltage", "torque"}
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

    def digest(self) -> bytes:
        """Return what tells it from others: settings, first memory, source, and the numbers that this uses."""
        try:
            source = inspect.getsource(self.function)
        except OSError:  # of what was typed at a prompt
            source = ""
        around = inspect.getclosurevars(self.function)
        used = sorted({**around.globals, **around.nonlocals}.items())
        numbers = [(name, np.asarray(x).tobytes()) for name, x in used if isinstance(x, (int, float, np.ndarray))]
        begins = None if self.begins is None else self.begins.tobytes()
        return repr((self.name, self.memory, self.period, self.writes, begins, source, numbers)).encode()

    def driving(self, scene: CompiledScene) -> CompiledScene:
        """Return the scene that it drives; ValueError where nothing takes what it writes."""
        if not scene.sampled and self.writes != "torque":
            raise ValueError(
                f"controller {self.name}: {scene.model.name} has no sampled servos that take what it writes: "
                f"{_sampled(scene.model)}let it write torques, @controller(writes='torque'), with gearbox=None"
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
        starts, commands = [place for name in SEEN for place in scene.part(name)], n + len(scene.surface_drives)
        places = np.array([length, n, self.memory, commands, *starts], np.int64)
        memory = zeros(self.memory)
        memory.T[...] = self.first_memory
        own = {"state": np.zeros(length), "offsets": places, "reference": np.zeros(2 * n)}
        own |= {"own_command": np.zeros(2 * commands), "own_memory": np.zeros(self.memory)}
        return core.Program(
            function=self._address(_views(*(each.copy() for each in own.values()))),
            every=self.every(scene),
            replaces=None if self.writes == "reference" else True,
            torques=True if self.writes == "torque" else None,
            command=zeros((n, 2)),
            memory=memory,
            clock=zeros(3),
            **own,
            failure=np.zeros(4),
            surfaces=scene.layout["surface_command"],
        )

    def taped(self) -> Any:
        """Return what kernels for derivatives call, compiled for taped numbers.

        It takes the time, the state, the places of its channels, reference, command and memory.
        """
        if "taped" not in self._made:
            scope: dict[str, Any] = {"State": State, "function": kernel(self.function)}
            exec(f"def call(t, y, places, reference, command, memory):\n    {_CALL}", scope)
            self._made["taped"] = kernel(scope["call"])
        return self._made["taped"]

    def _address(self, views: Sequence[Any]) -> Any:
        """Return the address of the compiled function; views: what follows the time among its arguments."""
        if "address" not in self._made:
            _refuse_chance(self.function)  # once more: by now all names that it uses exist
            try:
                self._made["kept"], self._made["address"] = outside(self.function, _wrapped)
            except CompilationError as error:
                why = failure_of(self.function, dict(zip(ARGUMENTS, (0.0, *views))), error)
                raise ValueError(
                    f"controller {why}; it does not compile: write command (joints, 2) and memory, and call what Numba "
                    "compiles"
                ) from None
        return self._made["address"]

    def check(self, program: core.Program, joints: Sequence[str], robots: Sequence[int] | np.ndarray = ()) -> None:
        """Raise ValueError if it has raised an exception, with that of the same call in Python, or written no number.

        joints: their names; robots: of a session, which is in each lane.
        """
        failed, t, where, lane = program.failure.tolist()
        if failed == 0.0:
            return
        program.failure[:] = 0.0
        when = f"at {t:.6g} s" + (f" of robot {robots[int(lane)]}" if len(robots) else "")
        if failed == core.NOT_FINITE:
            i, column = divmod(int(where), 2)
            what = "rate" if column else self.writes
            of = f"{what} of joint {joints[i]}" if i < len(joints) else f"command of surface drive {i - len(joints)}"
            raise ValueError(
                f"controller {self.name} wrote {program.own_command[int(where)]} as {of}, "
                f"command[{i}, {column}], {when}: give finite numbers, at most {core.LARGEST:g} in size"
            )
        arrays = (program.state, program.offsets, program.reference, program.own_command, program.own_memory)
        why, line, views = "an exception", None, _views(*arrays)
        cause: BaseException | None = None
        try:
            with np.errstate(divide="raise", invalid="raise"):  # Numba raises an exception for x / 0 of floats too
                self.function(t, *views)
        except Exception as error:
            why, line, cause = f"{type(error).__name__}: {error}", line_of(self.function, error), error
        raise ValueError(
            f"controller {self.name} failed {when}: {why} ({place_of(self.function, line)}); its arguments here: "
            f"{shapes_of(dict(zip(ARGUMENTS, (t, *views))))}: write within them, or ask for more memory"
        ) from cause


def controller(
    function: Callable[..., None] | None = None,
    *,
    memory: int = 0,
    period: float | None = None,
    writes: Writes = "reference",
) -> Any:
    """Compile a function into runs as their controller: ``simulate(scene, ..., controller=lean)``.

    Numba compiles the function, with bounds and divisors checked.  It is called for one robot at a time, in lanes too.
    It must give the same for the same: random numbers, clocks and what runs in Python are refused.

    Parameters
    ----------
    function
        Called at ticks as ``function(t, state, reference, command, memory)``, with the time [s]; the state's channels
        by name, as `state.q` (joints,) or `state.base_q` (7,), flat, empty where the robot has none, not to be written;
        what the servos would follow (joints, 2), position [rad or m] and rate; its command (joints, 2), what they are
        to follow, which equals `reference` until it is written; and its own numbers (memory,), zero at the start.
        After the joints' the command has a row for each of `CompiledScene.surface_drives`, whose first number is the
        command of surfaces that move, such as belts, and stands until it is written.
    memory
        How many numbers it keeps.
    period
        Time between calls [s], a whole number of controller ticks, between which its command stands.  None: each tick.
        Of torques it is the tick itself, a whole number of steps; None: 10 ms.
    writes
        "reference"; "voltage": ``command[:, 0]`` is the voltage of each motor [V], zero until it is written, past the
        servo's own law but through limits, delay and supply; "torque": it is the torque on each joint [N m or N], in
        scenes without servos.

    Returns
    -------
    CompiledController
        Or a decorator that makes one, if `function` is left out.

    Raises
    ------
    ValueError
        For a function with other arguments, and for one that draws random numbers, reads a clock or calls Python.

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
    one_of("writes", writes, get_args(Writes))
    _refuse_python(function)
    _refuse_chance(function)
    return CompiledController(function, size, period, writes)


def load_controller(name_or_path: str | os.PathLike) -> CompiledController:
    """Load the controller of a robot of the package by name, or from a Python file, which is run.

    Parameters
    ----------
    name_or_path : str or path
        A name of `scene_names()` that has one, or the path of a file that makes one controller.

    Returns
    -------
    CompiledController
        The controller, for ``simulate(scene, ..., controller=...)``.

    Raises
    ------
    ValueError
        For a scene without a controller, and a file that makes none or several.
    OSError
        If the file cannot be read.
    """
    instance("name_or_path", name_or_path, (str, os.PathLike), "give a name of scene_names(), or the path of a .py")
    path = Path(name_or_path)
    if path.suffix != ".py":
        path = scene_path(name_or_path).with_name(f"{path.name}.py")
        if not path.is_file():
            having = [name for name in scene_names() if scene_path(name).with_name(f"{name}.py").is_file()]
            known = f"expected one of {', '.join(having)}, or the path of a .py: use one of these"
            raise ValueError(f"{name_or_path}: there is no controller; {known}")
    spec = spec_from_file_location(f"{path.stem}_controller", path)
    assert spec is not None
    assert spec.loader is not None  # since it ends in .py
    module = sys.modules[spec.name] = module_from_spec(spec)  # where Numba looks for what it has cached
    spec.loader.exec_module(module)
    found = [one for one in vars(module).values() if isinstance(one, CompiledController)]
    if len(found) != 1:
        raise ValueError(f"{path}: has {len(found)} controllers; expected one: decorate one with @controller(...)")
    return found[0]


def _refuse_python(function: Callable[..., None]) -> None:
    """Raise ValueError for a function that calls the dynamics of this package, which run in Python."""
    used = inspect.getclosurevars(function)
    for named in (used.globals, used.nonlocals):
        for name, value in named.items():
            reached = [getattr(value, each, None) for each in used.unbound] if inspect.ismodule(value) else [value]
            for one in reached:
                if callable(one) and (getattr(one, "__module__", None) or "").startswith(DYNAMICS):
                    raise ValueError(
                        f"controller {function.__qualname__} calls {getattr(one, '__name__', name)}, which runs in "
                        "Python and not in a compiled run: step a Session and call it at each tick, or call it before "
                        "the run and put its numbers into memory"
                    )


def _refuse_chance(function: Callable[..., None]) -> None:
    """Raise ValueError for a function that uses what differs from call to call."""
    found = uses_chance(function)
    if found is not None:
        raise ValueError(
            f"controller {function.__qualname__} uses {found}, which differs from run to run and between lanes: work "
            "it out from time, state and memory, where a generator of your own finds room, or give noise to simulate"
        )


def _divides(h: float, period: float) -> bool:
    return round(period / h) >= 1 and abs(round(period / h) * h - period) <= 1e-9 * period


def with_ticks(scene: CompiledScene, controller: CompiledController | None) -> CompiledScene:
    """Return the scene with ticks of the period of a controller that writes torques; of others the scene itself.

    The grid of error control becomes one that divides the period.
    """
    if controller is None:
        return scene
    instance("controller", controller, CompiledController, "decorate its function with @controller(...)")
    if controller.writes != "torque":
        return scene
    name, period = scene.model.name, controller.period
    if scene.constants.actuator is not None:
        raise ValueError(
            f"controller {controller.name} writes torques, but the servos of {name} would drive the joints too: "
            "compile the scene with gearbox=None, or write 'voltage' or 'reference'"
        )
    if period is None:
        return scene
    shorter = period / math.ceil(period / scene.timestep)
    if scene.adaptive and not _divides(scene.timestep, period):
        scene = scene.recompiled(timestep=shorter)
    h = scene.timestep
    if not _divides(h, period):
        raise ValueError(
            f"controller {controller.name}: its period is {period:g} s, and torques change between steps of {h:g} s: "
            f"give compile_scene a timestep that divides it, such as {shorter:.6g}"
        )
    steps = round(period / h)
    return scene if steps == scene.tick_steps else replace(scene, tick_steps=steps)


def _sampled(model: Model) -> str:
    """Return the beginning of a remedy: how a robot's sampled servos act in a scene; "" for other servos and none."""
    laws = {servo.controller.law for servo in model.servos.values()}
    if not laws or laws & {*TORQUE_LAWS}:
        return ""
    return f"compile the scene with gearbox={usual_gearbox(model)!r}, or "


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


# Write out the views of all channels, since Numba loops over no fields.
_FIELDS = ", ".join(f"y[places[{STARTS + 2 * k}] : places[{STARTS + 2 * k + 1}]]" for k in range(len(SEEN)))
_CALL = f"function(t, State({_FIELDS}), reference, command, memory)"


def _wrapped(function: Callable[..., None]) -> Callable[..., None]:
    """Return what the kernels call, with pointers if compiled, else with arrays; it notes an exception."""
    if not JIT:

        def call(t: float, *arrays: np.ndarray) -> None:
            try:
                with np.errstate(divide="raise"):
                    function(t, *_views(*arrays[:5]))
            except Exception:
                arrays[5][core.FAILED] = core.RAISED

        return call
    lines = (
        "def wrapper(t, state, places, reference, command, memory, failure):",
        f"    places = carray(places, {STARTS + 2 * len(SEEN)})",
        f"    y, n = carray(state, places[{LENGTH}]), places[{JOINTS}]",
        f"    seen = State({_FIELDS})",
        "    try:",
        "        function(",
        f"            t, seen, carray(reference, (n, 2)), carray(command, (places[{COMMANDS}], 2)),",
        f"            carray(memory, places[{MEMORY}]),",
        "        )",
        "    except Exception:",
        f"        carray(failure, 1)[{core.FAILED}] = {core.RAISED}",
    )
    scope: dict[str, Any] = {"carray": carray, "State": State, "function": function}
    exec("\n".join(lines), scope)
    return scope["wrapper"]
