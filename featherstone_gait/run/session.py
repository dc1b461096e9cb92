"""Step robots from Python, so that a loop can be closed around the simulator.

    session = Session(scene, n=64, observe=("q", "qd"))
    seen = session.observe()
    for _ in range(1000):
        seen = session.step(policy(seen))
    session.reset(~session.active)

A session has the bits of one `simulate` call whose reference holds each action from its tick to the next one's.
"""

from __future__ import annotations

import copy
import hashlib
import json
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, floats, instance, listed, one_of, real, shown, truth, whole
from ..base.brief import clipped, in_full
from ..base.files import FilePath, Format, check_sound, complete, read_arrays
from ..core.effects.push import EVENT_MARGIN
from ..core.integrate.rollout import OK
from ..scene.actuator import usual_gearbox
from ..scene.channels import StateView
from ..scene.compile import CompiledScene
from ..scene.external import Push, build_pushes
from .classify import Outcome, classify
from .compiled_run import CompiledRun
from .error_estimate import FIXED_LIMIT, LIMIT, ROUNDING, SPEED_LIMIT, edges_on_steps, second_run
from .fleet import Fleet
from .lane_constants import numbers_in
from .measure import What, check_names, resolved, split, with_readings
from .observation import Log, SampledView, view_of
from .prepare import coordinates, each_once, most_ticks, prepare, steps_between_records, with_tolerance
from .program import CompiledController, open_loop, with_ticks
from .reference import Reference
from .start import check_scene, driven_lengths, initial_state
from .status import Status
from .switch import WITHIN, checked_command, drive_number, switch_loop
from .trajectory import Trajectory, of_second_run
from .worlds import Worlds

Action = Literal["reference", "voltage", "pwm", "torque"]
ACTIONS = ("reference", "voltage", "pwm", "torque")
FORMAT = Format("session", 1)
Observation = dict[str, Any]  # arrays (n, ...) by name; of sole_forces arrays by link


REMAKE = "make it with the scene and arguments of the file"
MOST_ROBOTS, MOST_THREADS = 10**6, 1024
CHANGING = ("_issued", "_ticks", "_fresh", "_any_fresh", "_inaccurate")  # of a session, by a step


class Session:
    """Step the robots of a scene, or of its worlds, from Python, by controller ticks.

    Parameters
    ----------
    scene
        The robot with its servos and ground, as `compile_scene` returns it.
    n
        Number of robots.  None: one, or one for each of `worlds`.
    action
        What `step` is given (n, joints): "reference" for the servos [rad or m]; "voltage" of the motors [V] or "pwm",
        their duty cycles from -1 to 1, past the controller but through limits, counts, delay and supply; "torque" on
        the joints [N m or N], in scenes without servos.  None: "reference" where there are servos, else "torque".
    observe
        What `observe` and `step` return: channels of `simulate`, the sensors encoders, gyroscope, accelerometer,
        sole_forces, center_of_pressure and contact_positions, and sensors such as a `RangeSensor` or a `SampledSensor`,
        each under its name.
    worlds
        Physical numbers in which the robots differ, one world for each robot.
    seed
        Of the noise; the draws of a robot depend on the seed and on the robot's number alone.
    pushes
        External forces, functions of each robot's time.
    record, record_interval
        Channels and sensors for `trajectory`, and the time between their records [s], which divides a tick.  None: a
        tick.
    noise
        Standard deviations (angle [rad], voltage [V]) of what is added at each tick to encoders and voltages.
    rtol, atol
        Error allowed in a step, as in `simulate`.
    estimate_error
        Simulate a second time in coarser steps, as `simulate` does, for `error` and the status "inaccurate".
    controller
        A function made by `controller`, which turns actions, as references, into what the servos follow, or into
        torques, whose period is then the tick.
    threads
        None: one for each core.
    pace
        Let steps take as long by the clock as they simulate; see `lag`.

    Attributes
    ----------
    scene : CompiledScene
    scenes : list of CompiledScene
        Of each robot, that of its world.
    n : int
    tick : float
        Time between controller ticks [s].
    time : numpy.ndarray
        Simulated time of each robot since its start (n,) [s].
    state : numpy.ndarray
        A copy of the states (n, size), to be given to `reset` or `simulate`.
    active : numpy.ndarray
        Mask (n,) bool of the robots that have not failed.
    status, messages : list
        `Status` of each robot, and a message about it.
    lag : float
        How much later than asked for the last paced step ended [s].

    Raises
    ------
    ValueError
        If arguments do not fit the scene or each other.

    Examples
    --------
    >>> session = Session(scene, n=64, observe=("q", "qd"))
    >>> seen = session.step(np.zeros((64, 7)))
    >>> session.reset(~session.active)
    """

    _first_pushes: np.recarray | None = None  # those before any was set

    def __init__(
        self,
        scene: CompiledScene,
        n: int | None = None,
        action: Action | None = None,
        observe: Iterable[What] = ("q", "qd"),
        *,
        worlds: Worlds | None = None,
        seed: int = 0,
        pushes: Sequence[Push] = (),
        record: Iterable[What] = (),
        record_interval: float | None = None,
        noise: tuple[float, float] | None = None,
        rtol: float | None = None,
        atol: float | None = None,
        estimate_error: bool = False,
        controller: CompiledController | None = None,
        threads: int | None = None,
        pace: bool = False,
    ) -> None:
        self._given = given = {name: value for name, value in locals().items() if name != "self"}
        check_scene(scene)
        seen = check_names((resolved(scene, one) for one in _names(observe)), "observe")
        given |= {"observe": seen, "record": tuple(_names(record, "record"))}
        self.action: Action = _action(scene, action, controller)
        scenes, self.n = _scenes(scene, n, worlds)
        self._chosen = split(scenes, given["record"])

        def driven(one: CompiledScene) -> CompiledScene:
            return _driven(one, self.action, controller)

        scenes = each_once(driven, scenes)
        self.scene = with_tolerance(scenes[0] if worlds is None else driven(scene), rtol, atol)[0]
        self.scene = with_ticks(self.scene, controller)
        if self.scene.tick_steps % steps_between_records(self.scene, record_interval):
            raise ValueError(
                f"record_interval is {record_interval!r} s; it must divide a tick of {self.tick:g} s in whole steps"
            )
        if controller is not None and self.action != "reference":
            raise ValueError(f"action is {action!r}, but a controller reads references: leave it out")
        self._deviations = _deviations(scene, noise)
        seed = whole("seed", seed, 0, "give 0, 1, ...")
        self._draws = [np.random.default_rng([seed, robot]) for robot in range(0 if noise is None else self.n)]
        self._fleets, self._share = self._compiled(scenes)
        self._runs = self._fleets[0].runs
        self._initial = [_initial_states(fleet.runs) for fleet in self._fleets]
        self._views = [view_of(self._fleets[0], self.tick, one) for one in given["observe"]]
        self._sampled = [view for view in self._views if isinstance(view, SampledView)]
        self._log = Log(self._runs, self._chosen.channels or ())
        self._closed, self._lock = False, threading.Lock()
        self._paced, self._due, self.lag = truth("pace", pace), math.nan, 0.0
        lags = np.array([run.scene.lag for run in self._runs])
        self._lags = np.maximum(np.ceil((lags - EVENT_MARGIN) / self.tick), 0).astype(int)  # in ticks
        self._one_lag = int(self._lags[0]) if (self._lags == self._lags[0]).all() else None
        self._issued = np.zeros((int(self._lags.max()) + 1, self.n, self.scene.commanded))  # commands of the last ticks
        self._ticks, self._robots = 0, np.arange(self.n)
        self._fresh = np.zeros(self.n, bool)  # robots without a command since their start
        self._default, self._told = np.zeros(self.n, bool), False  # robots at a start that nobody chose
        self._any_fresh, self._inaccurate = False, np.zeros(self.n, bool)
        self.reset()

    def _compiled(self, scenes: list[CompiledScene]) -> tuple[list[Fleet], float]:
        """Return the robots and, to estimate errors, those of the second runs, and the share of their difference."""
        given, tick = self._given, self.tick
        rtol, atol, record_interval, threads = (given[name] for name in ("rtol", "atol", "record_interval", "threads"))
        how = {name: given[name] for name in ("pushes", "controller")} | {"driven": self.action == "torque"}
        threads = None if threads is None else whole("threads", threads, 1, "one a core is usual", MOST_THREADS)

        def first(one: CompiledScene) -> CompiledRun:
            one, r, a = with_tolerance(one, rtol, atol)
            return prepare(one, tick, self._chosen.channels, record_interval, rtol=r, atol=a, **how)

        def second(one: CompiledScene) -> tuple[CompiledRun, float]:
            one, r, a = with_tolerance(one, rtol, atol)
            edges = edges_on_steps(one, 0.0, given["pushes"])
            other = second_run(one, r, a, record_interval or tick, edges)
            if other is None:
                raise ValueError(f"{one.model.name}: estimate_error: {one.integrator} has no second run: leave it out")
            return prepare(other.scene, tick, (), tick, rtol=other.rtol, atol=other.atol, **how), other.share

        noisy, share = self._deviations is not None, 0.0
        fleets = [Fleet(each_once(first, scenes), noisy, threads)]
        if truth("estimate_error", given["estimate_error"]):
            others = each_once(second, scenes)
            share = others[0][1]
            fleets.append(Fleet([one for one, _ in others], noisy, threads))
        return fleets, share

    # ------------------------------------------------------------------------------------------------ stepping

    def reset(self, mask: ArrayLike | None = None, state: Any = None) -> Observation:
        """Put robots at their start; return what they observe.

        The first action counts as given ever since, so that no lag delays it.

        Parameters
        ----------
        mask
            Which robots (n,) bool; None: all.
        state
            One state (size,) or `Trajectory` for all, or an array or list with one for each robot of the mask.  The
            final state of a run keeps its time: `reset_time` sets it to zero.  None: `initial_state`.
        """
        with self._alone():
            who = self._mask(mask)
            for fleet, states in zip(self._fleets, self._states(who, state)):
                for group in fleet.groups:
                    group.begin(who, states)
            self._fresh |= who
            self._default[who] = state is None
            self._inaccurate &= ~who
            self._any_fresh = True
            if who.all():
                self._due = math.nan
            self._log.restart(who)
            self._measure(who)
            return self._observed()

    def set_state(self, name: str, values: ArrayLike, mask: ArrayLike | None = None) -> Observation:
        """Set a channel of the state from outside, without passing of time; return what is observed.

        Parameters
        ----------
        name
            "q", "qd", "base_q" or "base_qd".
        values
            Values (n, width) for all robots, of which only those of the mask are set.
        mask
            Which robots (n,) bool; None: all.
        """
        with self._alone():
            who = self._mask(mask)
            one_of("name", name, coordinates(self.scene))
            self._default &= ~who
            whole_q = name == "q" and self.scene.tree.balls is not None
            width = len(self.scene.model.position_names) if whole_q else np.ptp(self.scene.part(name))
            given = floats(name, values, f"give numbers of shape ({self.n}, {width})")
            if given.shape != (self.n, width) or not (np.abs(given[who]) <= 1e50).all():
                raise ValueError(f"{name} has the shape {given.shape}; give ({self.n}, {width}) finite numbers")
            split = self.scene.tree.split_positions(given) if whole_q else (given,)
            for fleet in self._fleets:
                states, scene = fleet.states(), fleet.runs[0].scene
                parts = [slice(*scene.part(one)) for one in (name, "ball_q")[: len(split)]]
                for part, numbers in zip(parts, split):
                    states[:, part] = numbers
                for robot in np.flatnonzero(who).tolist():
                    fleet.runs[robot].start(states[robot])
                for group in fleet.groups:
                    for part in parts:
                        group.write_state(who, states, part)
            self._measure()
            return self._observed()

    def switch_loop(
        self, name: str, closed: bool, mask: ArrayLike | None = None, within: float = WITHIN
    ) -> Observation:
        """Make or break a loop, without passing of time; return what is observed.

        Parameters
        ----------
        name
            Name of the loop.
        closed, within
            As in `switch_loop`: whether to make it or to break it, and the largest gap at which it is made [m or rad].
        mask
            Which robots (n,) bool; None: all.
        """
        with self._alone():
            who, changed = self._mask(mask), []
            for fleet in self._fleets:
                states = fleet.states()
                for robot in np.flatnonzero(who).tolist():
                    states[robot] = switch_loop(fleet.runs[robot].scene, states[robot], name, closed, within)
                changed.append(states)
            for fleet, states in zip(self._fleets, changed):
                for group in fleet.groups:
                    group.write_state(who, states, slice(None))
            self._measure()
            return self._observed()

    def command_surface(self, drive: str, command: ArrayLike, mask: ArrayLike | None = None) -> Observation:
        """Set the command of a drive of surfaces, such as belts, without passing of time; return what is observed.

        Parameters
        ----------
        drive
            Name of the drive, one of `CompiledScene.surface_drives`.
        command
            What the motion of its surfaces is multiplied by [-]; one number, or one for each robot (n,).
        mask
            Which robots (n,) bool; None: all.
        """
        with self._alone():
            who, given = self._mask(mask), floats("command", command, f"give a number, or ({self.n},) numbers")
            if given.shape not in ((), (self.n,)):
                raise ValueError(f"command has the shape {given.shape}; give one number, or ({self.n},) numbers")
            given = np.broadcast_to(given, self.n)
            for x in given[who].tolist():
                checked_command(x)
            for fleet in self._fleets:
                states, scene = fleet.states(), fleet.runs[0].scene
                at = scene.part("surface_command")[0] + drive_number(scene, drive)
                states[:, at] = given
                for group in fleet.groups:
                    group.write_state(who, states, slice(at, at + 1))
            self._look()
            return self._observed()

    def set_push(self, number: int, push: Push) -> Observation:
        """Replace one of the external forces on all robots, without passing of time; return what is observed.

        The session needs a push in its place from the beginning, of zero force for example.  Runs of `simulate` with
        pushes that begin or end on a tick agree to rounding, since a step to its end takes a share of it.

        Parameters
        ----------
        number : int
            Which of `pushes`, 0 the first.
        push : Push
            The force [N] on a link, at a point in its axes [m], that takes its place.

        Returns
        -------
        dict of ndarray
            What is observed, (n, ...) by name.

        Raises
        ------
        ValueError
            There is no push of this number, the push does not fit the scene, or the session has worlds.
        """
        with self._alone():
            tables = self._push_tables()
            count = len(tables[0]) if tables else 0
            if not count or self._given["worlds"] is not None:
                why = "robots in worlds keep theirs" if count else "it has none: make it with pushes=[Push(link)]"
                raise ValueError(f"session: no push can be set; {why}")
            number = whole("number", number, 0, f"there are {count} pushes, 0 the first", count - 1)
            found = build_pushes(self.scene.tree, [push])
            assert found is not None
            self._first_pushes = tables[0].copy() if self._first_pushes is None else self._first_pushes
            for table in tables:
                table[number] = found[0]
            self._look()
            return self._observed()

    def _push_tables(self) -> list[np.recarray]:
        """Return the records of pushes that kernels read, each once."""
        found = {id(run.scene): run.scene.constants.push for fleet in self._fleets for run in fleet.runs}
        return [table for table in found.values() if table is not None]

    def step(self, action: ArrayLike | None = None, ticks: int = 1) -> Observation:
        """Advance all robots by some controller ticks under an action; return what they observe.

        The next step overwrites the arrays that are returned.  Robots that have failed stay as they are: see `active`.

        Parameters
        ----------
        action
            One for all robots (joints,), or one for each (n, joints).  None: the last one; at the start the robots'
            own joint positions, or zero where actions are no references.
        ticks
            Number of controller ticks.
        """
        with self._alone():
            if type(ticks) is not int or ticks != 1:
                ticks = whole("ticks", ticks, 1, "a step takes whole controller ticks", most_ticks(self.scene))
            command = None if action is None else self._checked(action)
            if self._given["controller"] is None:
                self._go_on(command, ticks)
            else:
                undo = self._undo()
                try:
                    self._go_on(command, ticks)
                except Exception:
                    undo()
                    raise
            if self._paced:
                self._wait(ticks * self.tick)
            return self._observed()

    def _wait(self, span: float) -> None:
        """Wait until the simulated time is over by the clock too; lost real time is not caught up."""
        now = time.monotonic()
        due = now + span if math.isnan(self._due) else self._due + span
        self.lag = max(0.0, now - due)
        self._due = max(due, now)
        if due > now:
            time.sleep(due - now)

    def _go_on(self, command: np.ndarray | None, ticks: int) -> None:
        begin = self._fresh.copy() if self._any_fresh and len(self._log.late) else None
        if self._any_fresh:
            command = self._first(command)
        elif command is None:
            command = self._issued[self._ticks % len(self._issued)].copy()
        for k in range(ticks):
            self._tick(command, begin if k == 0 else None)

    def _undo(self) -> Callable[[], None]:
        """Return what undoes later steps, where a controller raises an exception in one."""
        own = {name: copy.copy(getattr(self, name)) for name in CHANGING}
        changing = [x for fleet in self._fleets for group in fleet.groups for x in group.changing()]
        before, records = [x.copy() for x in changing], self._log.count
        draws = [draw.bit_generator.state for draw in self._draws]
        answers = [view.kept() for view in self._sampled]

        def undo() -> None:
            self.__dict__.update(own)
            self._log.count = records
            for x, values in zip(changing, before):
                x[...] = values
            for draw, state in zip(self._draws, draws):
                draw.bit_generator.state = state
            for view, kept in zip(self._sampled, answers):
                view.restore(kept, self.time)

        return undo

    def _tick(self, command: np.ndarray, begin: np.ndarray | None = None) -> None:
        self._ticks += 1
        depth = len(self._issued)
        self._issued[self._ticks % depth] = command
        if self._one_lag is not None:
            seen = self._issued[(self._ticks - self._one_lag) % depth]
        else:
            seen = self._issued[(self._ticks - self._lags) % depth, self._robots]
        noise, stops, first = self._issued, [], None
        if self._deviations is not None:  # (n, joints, 2)
            draws = [draw.standard_normal((self.scene.tree.n, 2)) for draw in self._draws]
            noise = np.array(draws) * self._deviations
        for fleet in self._fleets:
            for group in fleet.groups:
                group.write(group.command, seen)
                if group.noise is not None:
                    group.write(group.noise, noise)
            if begin is not None and fleet is self._fleets[0]:
                first = fleet.at_start(begin)
            try:
                fleet.tick()
            except KeyboardInterrupt as stop:  # raised once records and second runs are as far
                stops.append(stop)
        if self._log.record:
            self._log.take(self._fleets[0], first)
        self._measure()
        if len(self._fleets) > 1:
            self._inaccurate |= self._beyond_limit()
        if stops:
            raise stops[0]

    def _checked(self, action: ArrayLike) -> np.ndarray:
        """Return the action of each robot (n, joints), with those of driven tendons after the joints'."""
        values = floats("action", action)
        shape = (self.n, self.scene.commanded)
        names = [*self.scene.model.joint_names, *(one.name for one in self.scene.driven_tendons)][: shape[1]]
        if values.shape != shape:
            if values.shape != shape[1:]:
                each = ", ".join(names)
                raise ValueError(f"action has the shape {values.shape}; give {shape} or {shape[1:]}, of {each}")
            values = np.broadcast_to(values, shape)
        size = float(np.abs(values).max(initial=0.0))
        if not size <= 1e50:
            robot, joint = np.argwhere(~(np.abs(values) <= 1e50))[0].tolist()
            name = names[joint]
            raise ValueError(f"action of robot {robot}, joint {name}, is {values[robot, joint]}; give numbers to 1e50")
        if self.action == "pwm" and size > 1.0:
            raise ValueError(f"action has a duty cycle of {size:g}; they are from -1 to 1: divide by the supply")
        return values

    def _held(self) -> np.ndarray:
        """Return the last command, in which robots without one hold their positions, or have no force."""
        fresh, command = self._fresh, self._issued[self._ticks % len(self._issued)].copy()
        if self.action == "reference":
            first, end = self.scene.part("q")
            command[fresh, : end - first] = self.state[fresh, first:end]
            if self.scene.commanded > end - first:
                lengths = [driven_lengths(self.scene, y) for y in self.state[fresh]]
                command[fresh, end - first :] = np.reshape(lengths, (-1, self.scene.commanded - (end - first)))
        else:
            command[fresh] = 0.0
        return command

    def _look(self) -> None:
        """Find with what forces and accelerations robots at their start begin, before the first command."""
        fleet = self._fleets[0]
        fleet.seen = None
        if not (self._any_fresh and any(len(one.late) for one in (*self._views, self._log))):
            return
        part, command, states = slice(*self.scene.part("last_error")), self._held(), fleet.states()
        _write_first_errors(fleet, self._fresh, command)
        for group in fleet.groups:
            group.write(group.command, command)
            if group.noise is not None:
                group.noise[...] = 0.0
        fleet.seen = fleet.at_start(self._fresh)
        for group in fleet.groups:
            group.write_state(self._fresh, states, part)

    def _first(self, command: np.ndarray | None) -> np.ndarray:
        """Return the command of a step in which some robots begin, who have had it ever since."""
        fresh = self._fresh
        if not self._told and (self._default & fresh).any():
            initial_state(self._runs[int((self._default & fresh).argmax())].scene)  # warns of joints beyond limits
            self._told = True
        if command is None:
            command = self._held()
        self._issued[:, fresh] = command[fresh]
        for fleet in self._fleets:
            _write_first_errors(fleet, fresh, command)
        self._fresh[:] = self._any_fresh = False
        return command

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Refuse a second thread while one works: two at once would mix up two steps."""
        if self._closed:
            raise ValueError("session: it is closed; make another one")
        if not self._lock.acquire(blocking=False):
            raise RuntimeError("session: another thread is stepping it; give each thread a session of its own")
        try:
            yield
        finally:
            self._lock.release()

    # ------------------------------------------------------------------------------------------------ looking

    def observe(self) -> Observation:
        """Return what was chosen to be observed, as arrays (n, ...) that the next step overwrites."""
        with self._alone():
            return self._observed()

    def _measure(self, begun: np.ndarray | None = None) -> None:
        """Let sampled sensors measure where they are due; begun (n,) bool: robots that are at a start."""
        self._look()
        for view in self._sampled:
            view.take(self.time, begun)

    def _observed(self) -> Observation:
        return {view.name: view() for view in self._views}

    @property
    def scenes(self) -> list[CompiledScene]:
        """The scene of each robot, of its world."""
        return [run.scene for run in self._runs]

    @property
    def tick(self) -> float:
        """Time between controller ticks [s]."""
        return self.scene.tick_steps * self.scene.timestep

    @property
    def state(self) -> np.ndarray:
        """A copy of the states (n, size), to be given to `reset` or `simulate`."""
        return self._fleets[0].states()

    @property
    def state_view(self) -> StateView:
        """The channels of `state` by name, (n, ...); change the robots by `set_state` or `reset`."""
        return self.scene.state_view(self.state)

    @property
    def time(self) -> np.ndarray:
        """Simulated time of each robot since its start (n,) [s]; it stops when a robot fails."""
        return self._fleets[0].of_each("end")

    @property
    def active(self) -> np.ndarray:
        """Mask (n,) bool of the robots that have not fallen, diverged or otherwise ended."""
        return self._fleets[0].of_each("status") == OK

    @property
    def status(self) -> list[Status]:
        """The `Status` of each robot, as in `Trajectory`."""
        return [outcome.status for outcome in self._outcomes()]

    @property
    def messages(self) -> list[str]:
        """Message about each robot, "" of those that are "ok"."""
        return [outcome.message for outcome in self._outcomes()]

    def _outcomes(self) -> Iterator[Outcome]:
        for run, y, doubtful in zip(self._runs, self.state, self._inaccurate.tolist()):
            outcome = classify(run.scene, 0.0, y)
            if outcome.status is Status.OK and doubtful:
                message = f"{run.scene.model.name}: its error is beyond what `simulate` allows"
                outcome = Outcome(Status.INACCURATE, message)
            yield outcome

    def error(self, name: str) -> np.ndarray:
        """Return the estimated error (n, ...) of q, qd, base_q or base_qd, in their units.

        Raises ValueError unless the session has ``estimate_error=True``.
        """
        if len(self._fleets) < 2:
            raise ValueError("session: its error is not estimated; make it with estimate_error=True")
        one_of("name", name, coordinates(self.scene))
        run, other = (fleet.states()[:, slice(*fleet.runs[0].scene.part(name))] for fleet in self._fleets)
        return self._share * np.abs(run - other) + ROUNDING * np.abs(run)

    def _beyond_limit(self) -> np.ndarray:
        """Return which robots (n,) have an error beyond what `simulate` allows."""
        wrong = np.zeros(self.n, bool)
        limit = LIMIT if self._runs[0].scene.adaptive else FIXED_LIMIT
        for name in coordinates(self.scene):
            bound: Any = limit
            if name.endswith("qd"):
                speeds = np.abs(self.state[:, slice(*self.scene.part(name))])
                bound = limit * SPEED_LIMIT * speeds.max(axis=1, initial=1.0, keepdims=True)
            wrong |= (self.error(name) > bound).any(axis=1)
        return wrong & self.active

    def trajectory(self, robot: int = 0) -> Trajectory:
        """Return what has been recorded of a robot since its last reset."""
        robot = whole("robot", robot, 0, f"there are {self.n}, 0 the first", self.n - 1)
        run = self._log.trajectory(robot, self._fleets[0])
        return with_readings(self._runs[robot].scene, run, self._chosen, robot) if self._chosen.sensors else run

    # ------------------------------------------------------------------------------------------------ keeping

    def copy(self) -> Session:
        """Return an independent session in the same state, whose noise goes on alike."""
        with self._alone():
            other = Session(**self._given)
            other._take(self._kept())
            other._default, other._told = self._default.copy(), self._told
            other._log = self._log.copy(other._runs)
            return other

    def save(self, path: FilePath) -> None:
        """Write states, last actions and noise to PATH (.npz), whole or not at all; not what was recorded."""
        with self._alone():
            kept = self._kept()
        with complete(path) as temporary, temporary.open("xb") as file:
            np.savez_compressed(file, format=str(FORMAT), scene=self._digest(), **kept)

    def restore(self, path: FilePath) -> Observation:
        """Go on from what `save` wrote of a session of the same scene, seed, noise, pushes, tolerances and controller.

        Raises ValueError, naming the file, if it is damaged or of another session.
        """
        with self._alone():
            own: dict[str, Any] = {"scene": np.array(self._digest()), **self._kept()}

            def check(declared: dict[str, np.ndarray]) -> None:
                for name in (own.keys() | declared.keys()) - {"pushes"}:  # which are there if any was set
                    mine, given = ((x[name].shape, x[name].dtype.kind) if name in x else None for x in (own, declared))
                    if mine != given:
                        how = "missing" if given is None else "of another shape"
                        raise ValueError(f"{Path(path)}: {name} is {how}; this session has other robots: {REMAKE}")

            kept = read_arrays(path, FORMAT, check)
            if str(kept["what"]) != str(own["what"]):
                then, now = (str(x["what"])[:200] for x in (kept, own))
                raise ValueError(f"{Path(path)}: what is {then}; this session has {now}: {REMAKE}")
            if str(kept["scene"]) != str(own["scene"]):
                raise ValueError(
                    f"{Path(path)}: it is of another scene: some number of the robot, ground, gravity, servos, seed, "
                    f"noise, pushes, tolerances or controller differs; {REMAKE}"
                )
            for name, values in kept.items():
                if values.dtype.kind == "f" and not name.startswith("answers"):  # sensors may see nothing
                    check_sound(path, name, values)
            self._take(kept)
            self._log.restart(np.ones(self.n, bool))
            return self._observed()

    def _kept(self) -> dict[str, Any]:
        """Return what a session of the same arguments goes on from."""
        model = self.scene.model
        what = [model.name, *model.joint_names, self.action, self.scene.integrator, f"{self.scene.timestep!r}"]
        order = (self._ticks - np.arange(len(self._issued))) % len(self._issued)
        kept: dict[str, Any] = {"what": np.array(json.dumps(what)), "issued": self._issued[order]}
        kept |= {"fresh": self._fresh.copy(), "inaccurate": self._inaccurate.copy()}
        for k, fleet in enumerate(self._fleets):
            own = {"states": fleet.states(), "controllers": fleet.controllers(), "begun": fleet.of_each("begun")}
            kept |= {f"{name}{k}": values for name, values in own.items()}
        if self._first_pushes is not None:
            kept["pushes"] = np.frombuffer(self._push_tables()[0].tobytes(), np.uint8)
        if self._draws:
            kept["draws"] = np.array([json.dumps(draw.bit_generator.state) for draw in self._draws], "U400")
        return kept | {f"answers{k}": view.kept() for k, view in enumerate(self._sampled)}

    def _digest(self) -> str:
        """Return a hash of all numbers that a step depends on, and of the seed."""
        given, found = self._given, hashlib.sha256()
        found.update(repr([given[name] for name in ("seed", "rtol", "atol")]).encode())
        found.update(b"" if given["controller"] is None else given["controller"].digest())
        found.update(b"" if self._deviations is None else self._deviations.tobytes())
        found.update(in_full([view.sensor for view in self._sampled]).encode() if self._sampled else b"")
        of_scene: dict[int, bytes] = {}
        for run in self._runs:
            if id(run.scene) not in of_scene:
                constants, first = run.scene.constants, self._first_pushes
                of_scene[id(run.scene)] = numbers_in(constants if first is None else constants._replace(push=first))
            found.update(of_scene[id(run.scene)])
        return found.hexdigest()

    def _take(self, kept: dict[str, np.ndarray]) -> None:
        everyone = np.ones(self.n, bool)
        for k, fleet in enumerate(self._fleets):
            for group in fleet.groups:
                group.begin(everyone, kept[f"states{k}"])
                group.begun[...] = kept[f"begun{k}"][group.of].reshape(group.shape)
            fleet.write_controllers(kept[f"controllers{k}"])
        self._ticks = 0
        self._issued[-np.arange(len(self._issued)) % len(self._issued)] = kept["issued"]
        self._fresh, self._inaccurate = kept["fresh"].copy(), kept["inaccurate"].copy()
        self._any_fresh = bool(self._fresh.any())
        for draw, state in zip(self._draws, kept["draws"].tolist() if self._draws else ()):
            draw.bit_generator.state = json.loads(state)
        for k, view in enumerate(self._sampled):
            view.restore(kept[f"answers{k}"], self.time)
        self._take_pushes(kept.get("pushes"))

    def _take_pushes(self, kept: np.ndarray | None) -> None:
        """Restore the pushes of a file, or those before any was set."""
        if kept is None and self._first_pushes is None:
            return
        tables = self._push_tables()
        first = tables[0].copy() if self._first_pushes is None else self._first_pushes
        if kept is not None and kept.size != first.nbytes:
            raise ValueError(f"session: its file has {kept.size} bytes of pushes, expected {first.nbytes}: {REMAKE}")
        for table in tables:
            table[...] = first if kept is None else np.frombuffer(kept.tobytes(), first.dtype)
        self._first_pushes = first

    def close(self) -> None:
        """End the threads; the session cannot be stepped after that."""
        self._closed = True
        for fleet in self._fleets:
            fleet.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __getstate__(self) -> dict[str, Any]:
        return {"given": self._given, "kept": self._kept(), "log": self._log, "closed": self._closed}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        Session.__init__(self, **kept["given"])
        self._take(kept["kept"])
        self._log, self._closed = kept["log"], kept["closed"]
        self._log.runs = self._runs

    def __repr__(self) -> str:
        robots = f"{self.n} of {clipped(self.scene.model.name)}"
        return f"<session: {robots}, {self.action}, ticks of {self.tick:g} s>"

    # ------------------------------------------------------------------------------------------------ states

    def _mask(self, mask: ArrayLike | None) -> np.ndarray:
        if mask is None:
            return np.ones(self.n, bool)
        found = np.asarray(mask)
        if found.dtype != bool or found.shape != (self.n,):
            kind = f"of shape {found.shape} and type {found.dtype}"
            raise ValueError(f"mask is {shown(mask)}, {kind}; give ({self.n},) of True and False")
        return found.copy()

    def _states(self, who: np.ndarray, state: Any) -> list[np.ndarray]:
        """Return the first states (n, length) of the robots of a mask, of each fleet; other rows mean nothing."""
        if state is None:
            return self._initial
        robots = np.flatnonzero(who)
        if isinstance(state, Trajectory):
            each: list[Any] = [state] * len(robots)
        elif isinstance(state, (list, tuple)) and any(isinstance(x, (Trajectory, np.ndarray)) for x in state):
            each = list(state)
        else:
            array = floats("state", state, "give what initial_state returns, or an array (robots, length) of such")
            if array.ndim not in (1, 2):
                raise ValueError(f"state has the shape {array.shape}; give (length,) or ({len(robots)}, length)")
            each = [array] * len(robots) if array.ndim == 1 else [*array]
        if len(each) != len(robots):
            raise ValueError(f"state has {len(each)} entries; the mask has {len(robots)} robots: give one each")
        firsts = [initial.copy() for initial in self._initial]
        for robot, one in zip(robots.tolist(), each):
            for k, fleet in enumerate(self._fleets):
                y = fleet.runs[robot].start(of_second_run(one) if k else one).y
                fleet.runs[robot].schedule(y)  # raises ValueError for a time that is none
                firsts[k][robot] = y
        return firsts


# ------------------------------------------------------------------------------------------------ at the start


def _names(value: Any, what: str = "observe") -> list[str]:
    if isinstance(value, str):
        raise ValueError(f"{what} is {value!r}; give a list of names, such as ({value!r},)")
    return listed(what, value, "give a list of names, such as ('q', 'qd')")


def _action(scene: CompiledScene, action: Any, controller: CompiledController | None) -> Action:
    """Return what the robots are given; ValueError for what the scene has no input for."""
    name, driven = scene.model.name, scene.follows
    if getattr(controller, "writes", None) == "torque" and action in (None, "reference"):
        return "reference"
    if action is None:
        return "reference" if driven else "torque"
    if not isinstance(action, str) or action not in ACTIONS:
        known = [one for one in ACTIONS if (one != "torque") == driven]
        one_of("action", action, known if scene.sampled else known[:1])
    if action == "torque" and driven:
        raise ValueError(
            f"{name}: action is 'torque', but its servos would drive the joints too: compile the scene with "
            "gearbox=None, or give 'voltage' or 'reference'"
        )
    if action != "torque" and not driven:
        kind = usual_gearbox(scene.model)
        remedy = f"compile the scene with gearbox={kind!r}" if kind else "give 'torque'"
        raise ValueError(f"{name}: action is {action!r}, but it has no servos: {remedy}")
    if action in ("voltage", "pwm") and not scene.sampled:
        raise ValueError(
            f"{name}: action is {action!r}, but its servos follow a torque law and have no motor: give 'reference', or "
            "use servos with a law of state or PID"
        )
    return action


def _driven(scene: CompiledScene, action: Action, controller: CompiledController | None) -> CompiledScene:
    """Return the scene whose servos take the action, with the ticks of a controller that has its own."""
    scene = open_loop(scene, action == "pwm") if action in ("voltage", "pwm") else scene
    return with_ticks(scene, controller)


def _scenes(scene: CompiledScene, n: int | None, worlds: Worlds | None) -> tuple[list[CompiledScene], int]:
    """Return the scene of each robot, and their number."""
    if worlds is None:
        n = 1 if n is None else whole("n", n, 1, "give the number of robots", MOST_ROBOTS)
        return [scene] * n, n
    instance("worlds", worlds, Worlds, "give Worlds(...)")
    n = len(worlds) if n is None else whole("n", n, 1, f"there are {len(worlds)} worlds", len(worlds))
    return worlds.scenes(scene, range(n)), n


def _deviations(scene: CompiledScene, noise: Any) -> np.ndarray | None:
    if noise is None:
        return None
    if not scene.sampled:
        raise ValueError(f"{scene.model.name}: noise acts on sampled servos; this scene has none")
    both = finite("noise", noise, (2,), "as standard deviations of angles [rad] and of voltages [V]")
    return np.array([real("noise", one, 0.0, 1e6, "it is a standard deviation") for one in both.tolist()])


def _initial_states(runs: Sequence[CompiledRun]) -> np.ndarray:
    """Return the states (n, length) at which robots begin."""
    found = each_once(lambda run: run.start(initial_state(run.scene, allow_limit_violation=True)).y, runs)
    if len({len(y) for y in found}) > 1:
        raise ValueError(
            "worlds: their states differ in length, since servos wait for other numbers of ticks: let delays not differ"
        )
    return np.array(found)


def _write_first_errors(fleet: Fleet, fresh: np.ndarray, command: np.ndarray) -> None:
    """Set the last errors of controllers that begin, as of a run with that reference."""
    if not fleet.runs[0].scene.sampled:
        return
    states = fleet.states()
    for robot in np.flatnonzero(fresh).tolist():
        states[robot] = fleet.runs[robot].start(states[robot], Reference([0.0], command[robot][None])).y
    for group in fleet.groups:
        group.write_state(fresh, states, slice(*fleet.runs[0].scene.part("last_error")))


__all__ = ["ACTIONS", "Session"]
