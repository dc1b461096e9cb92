"""Runs that are stepped from Python, so that a loop can be closed around the simulator.

    session = Session(scene, n=64, observe=("q", "qd"))
    seen = session.observe()
    for _ in range(1000):
        seen = session.step(policy(seen))
    session.reset(~session.running)

A session has the bits of one `simulate` call whose reference holds each action from its tick to the next one's.
"""

from __future__ import annotations

import copy
import dataclasses
import json
import math
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, instance, listed, one_of, real, shown, truth, whole
from ..base.files import FilePath, Format, complete, read_arrays
from ..core.effects.push import AHEAD
from ..core.integrate.rollout import OK
from ..core.step.state import BY_NAME, RECORDABLE, shaped
from ..scene.compile import CompiledScene
from ..scene.external import Push
from . import sensors
from .channels import current_name
from .companion import FIXED_LIMIT, LIMIT, SPEED_LIMIT, WHOLE, companion
from .crowd import Crowd, Lot
from .prepared import Prepared, Start, coordinates, each_once, prepare, with_tolerance
from .program import CompiledController, open_loop
from .reference import Reference
from .start import check_scene
from .trajectory import Trajectory
from .verdict import STATUS, trajectory, verdict
from .worlds import Worlds

Action = Literal["reference", "voltage", "pwm", "torque"]
ACTIONS = ("reference", "voltage", "pwm", "torque")
FORMAT = Format("session", 1)
SENSORS: dict[str, tuple[Callable[..., Any], tuple[str, ...]]] = {
    "encoders": (sensors.encoders, ("q",)),
    "gyroscope": (sensors.gyroscope, ("base_qd",)),
    "accelerometer": (sensors.accelerometer, ("base_q", "base_qd", "base_qdd")),
    "sole_forces": (sensors.sole_forces, ("contact_force", "q", "base_q")),
    "center_of_pressure": (sensors.center_of_pressure, ("contact_force", "q", "base_q")),
    "contact_positions": (sensors.contact_positions, ("q", "base_q")),
}
Observation = dict[str, Any]  # arrays (n, ...) by name; of sole_forces arrays by link


class Settings(TypedDict, total=False):
    """What else a session is given, by name: see `Session`."""

    worlds: Worlds | None
    seed: int
    pushes: Sequence[Push]
    record: Iterable[str]
    record_interval: float | None
    noise: tuple[float, float] | None
    rtol: float | None
    atol: float | None
    estimate_error: bool
    controller: CompiledController | None
    threads: int | None
    pace: bool


DEFAULTS: Settings = {
    "worlds": None, "seed": 0, "pushes": (), "record": (), "record_interval": None, "noise": None, "rtol": None,
    "atol": None, "estimate_error": False, "controller": None, "threads": None, "pace": False,
}  # fmt: skip
CHANGING = ("_issued", "_ticks", "_fresh", "_any_fresh", "_inaccurate")  # of a session, by a step


class Session:
    """n robots of a scene, or of its worlds, that are stepped by controller ticks.

    Parameters
    ----------
    n : robots, of `worlds` if None, else 1
    action : what `step` is given (n, joints): "reference" for the servos [rad or m]; "voltage" of the motors [V] or
        "pwm", their duty cycles of -1 to 1, past the controller but through limits, counts, delay and supply; "torque"
        on the joints [N m or N], of scenes without servos.  None: "reference" where there are servos, else "torque"
    observe : what `observe` and `step` return: channels, and the sensors encoders, gyroscope, accelerometer,
        sole_forces, center_of_pressure and contact_positions
    worlds : the physical numbers in which robots differ; with n fewer robots than worlds there are n
    seed : of the noise: a robot's draws depend on it and on the robot's number alone
    pushes : external forces, functions of each robot's time
    record, record_interval : channels for `trajectory`, time between records [s], which divides a tick (a tick if None)
    noise : standard deviations (angle [rad], voltage [V]), added at each tick to what encoders read and to voltages
    rtol, atol : see `simulate`
    estimate_error : run a companion in coarser steps beside, as `simulate` does: `error`, and the status "inaccurate"
    controller : a function of `controller`, which makes of the actions, references, what the servos follow
    threads : one a core if None
    pace : steps take the time that they simulate, by the clock: see `behind`

    Raises ValueError for what does not fit together.
    """

    def __init__(
        self,
        scene: CompiledScene,
        n: int | None = None,
        action: Action | None = None,
        observe: Iterable[str] = ("q", "qd"),
        **settings: Unpack[Settings],
    ) -> None:
        check_scene(scene)
        if settings.keys() - DEFAULTS.keys():
            unknown = ", ".join(sorted(settings.keys() - DEFAULTS.keys()))
            raise TypeError(f"Session: {unknown} is unknown; its settings are {', '.join(DEFAULTS)}")
        chosen: Settings = {**DEFAULTS, **settings}
        worlds, noise, controller = chosen["worlds"], chosen["noise"], chosen["controller"]
        rtol, atol, record_interval, threads = (
            chosen["rtol"],
            chosen["atol"],
            chosen["record_interval"],
            chosen["threads"],
        )
        self._given: dict[str, Any] = {"scene": scene, "n": n, "action": action, "observe": tuple(_names(observe))}
        self._given |= {**chosen, "record": tuple(_names(chosen["record"], "record"))}
        self.action: Action = _action(scene, action)
        scenes, self.n = _scenes(scene, n, worlds)
        scenes = [_driven(one, self.action) for one in scenes]
        own = scenes[0] if worlds is None else _driven(scene, self.action)
        self.scene = with_tolerance(own, rtol, atol)[0]
        self.seed = whole("seed", chosen["seed"], 0, "give 0, 1, ...")
        self._deviations = _deviations(scene, noise)
        tick = self.scene.tick_steps * self.scene.timestep
        _check_sample(self.scene, record_interval)
        if controller is not None and self.action != "reference":
            raise ValueError(f"action is {action!r}, but a controller reads references: leave it out")
        how: dict[str, Any] = {"pushes": chosen["pushes"], "driven": self.action == "torque", "controller": controller}
        record = self._given["record"]

        def made_ready(one: CompiledScene) -> Prepared:
            one, r, a = with_tolerance(one, rtol, atol)
            return prepare(one, tick, record, record_interval, rtol=r, atol=a, **how)

        def coarser(one: CompiledScene) -> tuple[Prepared, float]:
            one, r, a = with_tolerance(one, rtol, atol)
            other = companion(one, record_interval or tick, r, a)
            if other is None:
                raise ValueError(f"{one.model.name}: no companion tells the error of {one.integrator}: leave it out")
            return prepare(other.scene, tick, (), tick, rtol=other.rtol, atol=other.atol, **how), other.share

        self._worlds = each_once(made_ready, scenes)
        noisy = self._deviations is not None
        threads = None if threads is None else whole("threads", threads, 1, "one a core is usual")
        self._crowds = [Crowd(self._worlds, noisy, threads)]
        self._share = 0.0
        if truth("estimate_error", chosen["estimate_error"]):
            others = each_once(coarser, scenes)
            self._share = others[0][1]
            self._crowds.append(Crowd([one for one, _ in others], noisy, threads))
        self._initial = [_initial_states(crowd.worlds) for crowd in self._crowds]
        self._views = [_View(self, name) for name in self._given["observe"]]
        self._log = _Log(self._worlds, self._given["record"])
        self._closed, self._lock = False, threading.Lock()
        self._paced, self._due = truth("pace", chosen["pace"]), math.nan
        self.behind = 0.0
        joints, tick = self.scene.tree.n, self.tick
        lags = np.array([ready.scene.lag for ready in self._worlds])
        self._lag = np.maximum(np.ceil((lags - AHEAD) / tick), 0).astype(int)  # in ticks
        self._one_lag = int(self._lag[0]) if (self._lag == self._lag[0]).all() else None
        self._issued = np.zeros((int(self._lag.max()) + 1, self.n, joints))  # commands of the last ticks
        self._ticks, self._robots = 0, np.arange(self.n)
        self._fresh = np.zeros(self.n, bool)  # who has had no command since the start
        self._any_fresh = False
        self._inaccurate = np.zeros(self.n, bool)
        self._draws = [np.random.default_rng([self.seed, robot]) for robot in range(self.n)] if noisy else []
        self.reset()

    # ------------------------------------------------------------------------------------------------ stepping

    def reset(self, mask: ArrayLike | None = None, state: Any = None) -> Observation:
        """Put the robots of a mask (n,) bool, all if None, at their start; return what they observe.

        state: None for `initial_state`, one state (length,) or `Trajectory` for all, or an array or list with one for
        each robot of the mask.  A state that a run has come to keeps its time: `reset_time` sets it to zero.  The first
        action counts as given ever since, so that no lag delays it.
        """
        with self._alone():
            who = self._mask(mask)
            firsts = self._states(who, state)
            for crowd, states in zip(self._crowds, firsts):
                for lot in crowd.lots:
                    lot.begin(who, states)
            self._fresh |= who
            self._inaccurate &= ~who
            self._any_fresh = True
            if who.all():
                self._due = math.nan
            self._log.restart(who)
            return self._observed()

    def change(self, name: str, values: ArrayLike, mask: ArrayLike | None = None) -> Observation:
        """Set a part of the state of the robots of a mask, all if None, from outside; nothing else changes, nor time.

        name: "q", "qd", "base_q" or "base_qd"; values (n, width): a blow from nowhere, or a robot put elsewhere.
        """
        with self._alone():
            who = self._mask(mask)
            one_of("name", name, coordinates(self.scene))
            first, end = self.scene.part(name)
            given = floats(name, values, f"give numbers of shape ({self.n}, {end - first})")
            if given.shape != (self.n, end - first) or not (np.abs(given[who]) <= 1e50).all():
                raise ValueError(f"{name} has the shape {given.shape}; give ({self.n}, {end - first}) finite numbers")
            for crowd in self._crowds:
                states, (at, _) = _whole(crowd), crowd.worlds[0].scene.part(name)
                states[:, at : at + end - first] = given
                for robot in np.flatnonzero(who).tolist():
                    crowd.worlds[robot].start(states[robot])
                for lot in crowd.lots:
                    lot.change(who, states, slice(at, at + end - first))
            return self._observed()

    def step(self, action: ArrayLike | None = None, ticks: int = 1) -> Observation:
        """Let all robots go on for some controller ticks under an action (n, joints); return what they observe.

        action: one for all (joints,), or one each; None keeps the last, at the start the robots' own joint positions,
        without reference zero.  The arrays that are returned are overwritten by the next step.  Robots that have failed
        stay as they are: see `running`.
        """
        with self._alone():
            ticks = 1 if ticks == 1 else whole("ticks", ticks, 1, "a step takes whole controller ticks")
            command = None if action is None else self._checked(action)
            if self._given["controller"] is None:
                self._go_on(command, ticks)
            else:
                before = self._marked()
                try:
                    self._go_on(command, ticks)
                except Exception:
                    self._back(before)
                    raise
            if self._paced:
                self._wait(ticks * self.tick)
            return self._observed()

    def _wait(self, span: float) -> None:
        """Wait until what has been simulated is over by the clock too, from the first step or the last reset on.

        behind [s]: how much later than that it was.  What is lost is not made up for by haste.
        """
        now = time.monotonic()
        due = now + span if math.isnan(self._due) else self._due + span
        self.behind = max(0.0, now - due)
        self._due = max(due, now)
        if due > now:
            time.sleep(due - now)

    def _go_on(self, command: np.ndarray | None, ticks: int) -> None:
        if self._any_fresh:
            command = self._first(command)
        elif command is None:
            command = self._issued[self._ticks % len(self._issued)].copy()
        for _ in range(ticks):
            self._tick(command)

    def _marked(self) -> dict[str, Any]:
        """What a step changes, to be undone where a controller raises an exception in it."""
        return {
            "own": {name: copy.copy(getattr(self, name)) for name in CHANGING},
            "lots": [(lot, lot.marked()) for crowd in self._crowds for lot in crowd.lots],
            "records": self._log.count,
            "draws": [draw.bit_generator.state for draw in self._draws],
        }

    def _back(self, before: dict[str, Any]) -> None:
        """Undo it."""
        self.__dict__.update(before["own"])
        for lot, marked in before["lots"]:
            lot.back(marked)
        self._log.count = before["records"]
        for draw, state in zip(self._draws, before["draws"]):
            draw.bit_generator.state = state

    def _tick(self, command: np.ndarray) -> None:
        self._ticks += 1
        depth = len(self._issued)
        self._issued[self._ticks % depth] = command
        if self._one_lag is not None:
            seen = self._issued[(self._ticks - self._one_lag) % depth]
        else:
            seen = self._issued[(self._ticks - self._lag) % depth, self._robots]
        noise, stops = self._drawn() if self._draws else self._issued, []
        for crowd in self._crowds:
            for lot in crowd.lots:
                lot.write_command(seen)
                if lot.write_noise is not None:
                    lot.write_noise(noise)
            try:
                crowd.tick()
            except KeyboardInterrupt as stop:  # once all are there: records and companions go with them
                stops.append(stop)
        if self._log.record:
            self._log.take(self._crowds[0])
        if len(self._crowds) > 1:
            self._inaccurate |= self._beyond()
        if stops:
            raise stops[0]

    def _checked(self, action: ArrayLike) -> np.ndarray:
        """The action of each robot (n, joints)."""
        values = floats("action", action)
        shape = (self.n, self.scene.tree.n)
        if values.shape != shape:
            if values.shape != shape[1:]:
                joints = ", ".join(self.scene.model.joint_names)
                raise ValueError(f"action has the shape {values.shape}; give {shape} or {shape[1:]}, of {joints}")
            values = np.broadcast_to(values, shape)
        size = float(np.abs(values).max(initial=0.0))
        if not size <= 1e50:
            robot, joint = np.argwhere(~(np.abs(values) <= 1e50))[0].tolist()
            name = self.scene.model.joint_names[joint]
            raise ValueError(f"action of robot {robot}, joint {name}, is {values[robot, joint]}; give finite numbers")
        if self.action == "pwm" and size > 1.0:
            raise ValueError(f"action has a duty cycle of {size:g}; they are from -1 to 1: divide by the supply")
        return values

    def _first(self, command: np.ndarray | None) -> np.ndarray:
        """The command of a step in which some robots begin, who have had it ever since."""
        fresh, depth = self._fresh, len(self._issued)
        if command is None:
            command = self._issued[self._ticks % depth].copy()
            if self.action == "reference":
                first, end = self.scene.part("q")
                command[fresh] = self.state[fresh, first:end]
            else:
                command[fresh] = 0.0
        self._issued[:, fresh] = command[fresh]
        for crowd in self._crowds:
            _give_first_errors(crowd, fresh, command)
        self._fresh[:] = self._any_fresh = False
        return command

    def _drawn(self) -> np.ndarray:
        """Noise of a tick (n, joints, 2)."""
        assert self._deviations is not None
        return np.array([draw.standard_normal((self.scene.tree.n, 2)) for draw in self._draws]) * self._deviations

    def _alone(self) -> _Alone:
        if self._closed:
            raise ValueError("session: it is closed; make another one")
        return _Alone(self._lock)

    # ------------------------------------------------------------------------------------------------ looking

    def observe(self) -> Observation:
        """What was chosen to be observed, now: arrays (n, ...) that the next step overwrites."""
        with self._alone():
            return self._observed()

    def _observed(self) -> Observation:
        return {view.name: view() for view in self._views}

    @property
    def tick(self) -> float:
        """Time between controller ticks [s]."""
        return self.scene.tick_steps * self.scene.timestep

    @property
    def state(self) -> np.ndarray:
        """The whole states (n, length), a copy, to be given to `reset` or `simulate`."""
        return _whole(self._crowds[0])

    @property
    def time(self) -> np.ndarray:
        """How long each robot has gone on (n,) [s]; of those that failed, until when."""
        return self._numbers("end")

    @property
    def running(self) -> np.ndarray:
        """Who has not fallen, diverged or otherwise ended (n,) bool."""
        return self._numbers("status") == OK

    @property
    def status(self) -> list[str]:
        """How it is with each robot: "ok", or as in `Trajectory`."""
        return [status for status, _ in self._verdicts()]

    @property
    def messages(self) -> list[str]:
        """What is to be said of each robot, "" of those that are well."""
        return [message for _, message in self._verdicts()]

    def _verdicts(self) -> list[tuple[str, str]]:
        found = []
        for ready, y, doubtful in zip(self._worlds, self.state, self._inaccurate.tolist()):
            status, message, _ = verdict(ready.scene, 0.0, y)
            if status == "ok" and doubtful:
                status, message = "inaccurate", f"{ready.scene.model.name}: its error is beyond what `simulate` allows"
            found.append((status, message))
        return found

    def _numbers(self, name: str) -> np.ndarray:
        out = np.empty(self.n)
        for lot in self._crowds[0].lots:
            lot.reader(getattr(lot, name), out)()
        return out

    def error(self, name: str) -> np.ndarray:
        """Estimated error (n, ...) of q, qd, base_q or base_qd, in their units; needs estimate_error=True."""
        if len(self._crowds) < 2:
            raise ValueError("session: its error is not estimated; make it with estimate_error=True")
        one_of("name", name, coordinates(self.scene))
        run, other = (_whole(crowd) for crowd in self._crowds)
        first, end = self.scene.part(name)
        begin, _ = self._crowds[1].worlds[0].scene.part(name)
        difference = np.abs(run[:, first:end] - other[:, begin : begin + end - first])
        return self._share * difference + 1e-13 * np.abs(run[:, first:end])

    def _beyond(self) -> np.ndarray:
        """Whose error is beyond what `simulate` allows (n,)."""
        wrong = np.zeros(self.n, bool)
        for name in coordinates(self.scene):
            limit = LIMIT if self._worlds[0].scene.adaptive else FIXED_LIMIT
            if name.endswith("qd"):
                first, end = self.scene.part(name)
                largest = np.abs(self.state[:, first:end]).max(axis=1, initial=1.0)
                wrong |= (self.error(name) > (limit * SPEED_LIMIT * largest)[:, None]).any(axis=1)
            else:
                wrong |= (self.error(name) > limit).any(axis=1)
        return wrong & self.running

    def trajectory(self, robot: int = 0) -> Trajectory:
        """What has been recorded of a robot since its last reset."""
        robot = whole("robot", robot, 0, f"there are {self.n}, 0 the first", self.n - 1)
        return self._log.trajectory(robot, self._crowds[0])

    # ------------------------------------------------------------------------------------------------ keeping

    def copy(self) -> Session:
        """A session of its own in the same state, whose noise goes on alike."""
        with self._alone():
            other = Session(**self._given)
            other._take(self._kept())
            other._log = self._log.copy()
            return other

    def save(self, path: FilePath) -> None:
        """Write states, last actions and noise to PATH (.npz), whole or not at all; not what was recorded."""
        with self._alone():
            kept = self._kept()
        with complete(path) as temporary, temporary.open("xb") as file:
            np.savez_compressed(file, format=str(FORMAT), **kept)

    def restore(self, path: FilePath) -> Observation:
        """Go on from what `save` wrote of a session with the same robots.

        Raises ValueError, naming the file, if it is damaged or of others.
        """
        with self._alone():
            kept, own = read_arrays(path, FORMAT), self._kept()
            for name in own.keys() | kept.keys():
                fits = name in own and name in kept and own[name].shape == kept[name].shape
                if not fits or (name == "what" and str(own[name]) != str(kept[name])):
                    now, then = (str(x.get(name, "missing"))[:200] for x in (own, kept))
                    raise ValueError(
                        f"{Path(path)}: {name} is {then if name == 'what' else 'of another shape'}; this session has "
                        f"{now if name == 'what' else 'other robots'}: make it with the same scene and arguments"
                    )
            self._take(kept)
            self._log.restart(np.ones(self.n, bool))
            return self._observed()

    def _kept(self) -> dict[str, Any]:
        """What a session of the same arguments goes on from."""
        model = self.scene.model
        what = [model.name, *model.joint_names, self.action, self.scene.integrator, f"{self.scene.timestep!r}"]
        order = (self._ticks - np.arange(len(self._issued))) % len(self._issued)
        kept: dict[str, Any] = {"what": np.array(json.dumps(what)), "issued": self._issued[order]}
        kept |= {"fresh": self._fresh.copy(), "inaccurate": self._inaccurate.copy()}
        kept |= {f"states{k}": _whole(crowd) for k, crowd in enumerate(self._crowds)}
        kept |= {f"controllers{k}": crowd.controllers() for k, crowd in enumerate(self._crowds)}
        kept |= {f"begun{k}": crowd.begun() for k, crowd in enumerate(self._crowds)}
        if self._draws:
            kept["draws"] = np.array([json.dumps(draw.bit_generator.state) for draw in self._draws], "U400")
        return kept

    def _take(self, kept: dict[str, np.ndarray]) -> None:
        everyone = np.ones(self.n, bool)
        for k, crowd in enumerate(self._crowds):
            for lot in crowd.lots:
                lot.begin(everyone, kept[f"states{k}"])
                lot.begun[...] = kept[f"begun{k}"][lot.of].reshape(lot.shape)
            crowd.keep(kept[f"controllers{k}"])
        self._ticks = 0
        self._issued[-np.arange(len(self._issued)) % len(self._issued)] = kept["issued"]
        self._fresh, self._inaccurate = kept["fresh"].copy(), kept["inaccurate"].copy()
        self._any_fresh = bool(self._fresh.any())
        for draw, state in zip(self._draws, kept["draws"].tolist() if self._draws else ()):
            draw.bit_generator.state = json.loads(state)

    def close(self) -> None:
        """End its threads; nothing can be stepped after that."""
        self._closed = True
        for crowd in self._crowds:
            crowd.close()

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
        self._log.worlds = self._worlds

    def __repr__(self) -> str:
        return f"<session: {self.n} of {self.scene.model.name}, {self.action}, ticks of {self.tick:g} s>"

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
        """The first states of the robots of a mask (n, length), of each crowd; others' rows mean nothing."""
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
            for k, crowd in enumerate(self._crowds):
                begun = one
                if k and isinstance(one, Trajectory) and one.companion is not None:
                    begun = dataclasses.replace(one, final=one.companion)
                start = Start(crowd.worlds[robot].start(begun).y, None, None, None, crowd.worlds[robot])
                crowd.worlds[robot].course(start)
                firsts[k][robot] = start.y
        return firsts


class _Alone:
    """Held while a session works: two threads at once would make one mess of two steps."""

    def __init__(self, lock: threading.Lock) -> None:
        self._lock = lock

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise RuntimeError("session: another thread is stepping it; give each thread a session of its own")

    def __exit__(self, *_: object) -> None:
        self._lock.release()


class _View:
    """A channel or sensor of all robots, in an array that is used again."""

    def __init__(self, session: Session, name: str) -> None:
        name = current_name(name)
        if not isinstance(name, str) or name not in (*RECORDABLE, *SENSORS):
            known = ", ".join((*RECORDABLE, *SENSORS))
            raise ValueError(f"observe: there is no channel or sensor {shown(name)}; there are {known}")
        self.name, self._session = name, session
        sensor, needed = SENSORS.get(name, (None, (name,)))
        scene = session._worlds[0].scene
        if scene.model.base != "floating":
            needed = tuple(need for need in needed if sensor is None or not need.startswith("base"))
        self._scenes = list({id(ready.scene): ready.scene for ready in session._worlds}.values())
        self._sensor = sensor
        self._prepared = [prepare(one.scene, session.tick, needed) for one in session._worlds]
        self._places = [_slice(one.channels) for one in self._prepared]
        self._values = np.zeros((session.n, len(self._prepared[0].channels)))
        self._readers = [self._reader(lot) for lot in session._crowds[0].lots]
        self._plain = sensor is None and BY_NAME[name].kind != "computed"
        self._shaped = shaped(BY_NAME[name], self._values) if self._plain else None
        self._result: Any = None

    def __call__(self) -> Any:
        for read in self._readers:
            read()
        if self._shaped is not None:
            return self._shaped
        found = self._computed()
        if self._result is None:
            self._result = copy.deepcopy(found)
        elif isinstance(found, dict):
            for link, values in found.items():
                np.copyto(self._result[link], values)
        else:
            np.copyto(self._result, found)
        return self._result

    def _reader(self, lot: Lot) -> Callable[[], None]:
        places = self._places[lot.robots[0]]
        if isinstance(places, slice):
            return lot.reader(lot.y[:, places], self._values)
        return lambda: lot.reader(lot.y[:, places], self._values)()

    def _computed(self) -> Any:
        """Of each robot as of a sample of a trajectory; in worlds one after the other."""
        if len(self._scenes) == 1:
            return self._of(self._prepared[0], self._values)
        each = [self._of(ready, row[None]) for ready, row in zip(self._prepared, self._values)]
        if isinstance(each[0], dict):
            return {link: np.concatenate([one[link] for one in each]) for link in each[0]}
        return np.concatenate(each)

    def _of(self, ready: Prepared, values: np.ndarray) -> Any:
        named = ready.named(values)
        return named[self.name] if self._sensor is None else self._sensor(ready.scene, named)


class _Log:
    """What is recorded of all robots, one row a sample, and where in it each has begun."""

    def __init__(self, worlds: list[Prepared], record: tuple[str, ...]) -> None:
        self.worlds, self.record = worlds, record
        self._rows = np.zeros((0, len(worlds), len(worlds[0].channels)))
        self.count = 0
        self._begun = np.zeros(len(worlds), int)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"worlds": None, "_rows": self._rows[: self.count]}

    def copy(self) -> _Log:
        other = _Log(self.worlds, self.record)
        other._rows, other.count, other._begun = self._rows[: self.count].copy(), self.count, self._begun.copy()
        return other

    def restart(self, who: np.ndarray) -> None:
        """Forget what was before of these robots."""
        self._begun[who] = self.count
        oldest = int(self._begun.min())
        if oldest > self.count // 2:
            self._rows = self._rows[oldest : self.count].copy()
            self.count -= oldest
            self._begun -= oldest

    def take(self, crowd: Crowd) -> None:
        """Take the records of a tick, but for the last, with which the next begins."""
        more = self.worlds[0].samples - 1
        if self.count + more > len(self._rows):
            grown = np.zeros((2 * len(self._rows) + 64 * more, *self._rows.shape[1:]))
            grown[: self.count] = self._rows[: self.count]
            self._rows = grown
        part = self._rows[self.count : self.count + more]
        width = part.shape[2]
        for lot in crowd.lots:
            for k in range(more):
                lot.reader(lot.out[:, k, :width], part[k])()
        self.count += more

    def trajectory(self, robot: int, crowd: Crowd) -> Trajectory:
        """Of one robot."""
        ready = self.worlds[robot]
        lot = next(lot for lot in crowd.lots if robot in lot.robots)
        unit, lane = divmod(int(np.flatnonzero(lot.robots == robot)[0]), lot.width)
        y = lot.y[unit, :, lane].copy()
        out = np.concatenate([self._rows[self._begun[robot] : self.count, robot], y[None, ready.channels]])
        steps = (len(out) - 1) * ready.plan.per_sample
        if int(y[ready.scene.layout["status"]]) == OK:
            steps = int(lot.steps[unit, lane] - lot.begun[unit, lane])
        course = ready.plan._replace(
            first=int(lot.begun[unit, lane]), offset=float(lot.offset[unit, lane]), steps=steps
        )
        return trajectory(ready, y, out, course)


# ------------------------------------------------------------------------------------------------ at the start


def _names(value: Any, what: str = "observe") -> list[str]:
    if isinstance(value, str):
        raise ValueError(f"{what} is {value!r}; give a list of names, such as ({value!r},)")
    return listed(what, value, "give a list of names, such as ('q', 'qd')")


def _action(scene: CompiledScene, action: Any) -> Action:
    """What the robots are given; ValueError for what the scene has no input for."""
    name, driven = scene.model.name, scene.constants.actuator is not None
    if action is None:
        return "reference" if driven else "torque"
    one_of("action", action, ACTIONS)
    if action == "torque" and driven:
        raise ValueError(
            f"{name}: action is 'torque', but its servos would drive the joints too: compile the scene with "
            "gearbox=None, or give 'voltage' or 'reference'"
        )
    if action == "torque" and scene.method.drives:
        raise ValueError(f"{name}: {scene.integrator} takes its torques from servos alone: use implicit_euler")
    if action != "torque" and not driven:
        raise ValueError(f"{name}: action is {action!r}, but it has no servos: compile the scene with gearbox='mipsd'")
    if action in ("voltage", "pwm") and not scene.sampled:
        raise ValueError(
            f"{name}: action is {action!r}, but its servos follow a torque law and have no motor: give 'reference', or "
            "use servos with a law of state or PID"
        )
    return action


def _driven(scene: CompiledScene, action: Action) -> CompiledScene:
    """The scene whose servos take what they are given."""
    return open_loop(scene, action == "pwm") if action in ("voltage", "pwm") else scene


def _scenes(scene: CompiledScene, n: int | None, worlds: Worlds | None) -> tuple[list[CompiledScene], int]:
    """The scene of each robot."""
    if worlds is None:
        n = 1 if n is None else whole("n", n, 1, "give the number of robots", 10**6)
        return [scene] * n, n
    instance("worlds", worlds, Worlds, "give Worlds(...)")
    n = len(worlds) if n is None else whole("n", n, 1, f"there are {len(worlds)} worlds", len(worlds))
    return worlds.scenes(scene, range(n)), n


def _deviations(scene: CompiledScene, noise: Any) -> np.ndarray | None:
    if noise is None:
        return None
    if not scene.sampled:
        raise ValueError(f"{scene.model.name}: noise acts on sampled servos; this scene has none")
    both = listed("noise", noise, "give two standard deviations, of angles [rad] and of voltages [V]")
    if len(both) != 2:
        raise ValueError(f"noise is {shown(noise)}; give two standard deviations, of angles [rad] and of voltages [V]")
    return np.array([real("noise", one, 0.0, 1e6, "it is a standard deviation") for one in both])


def _check_sample(scene: CompiledScene, record_interval: float | None) -> None:
    if record_interval is None:
        return
    steps = real("record_interval", record_interval, 0.0, 1e9, "give seconds") / scene.timestep
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-9 * steps or scene.tick_steps % round(steps):
        tick = scene.tick_steps * scene.timestep
        raise ValueError(
            f"record_interval is {record_interval!r} s; it must divide a tick of {tick:g} s in whole steps"
        )


def _initial_states(worlds: Sequence[Prepared]) -> np.ndarray:
    """(n, length)."""
    found = each_once(lambda ready: ready.start().y, worlds)
    if len({len(y) for y in found}) > 1:
        raise ValueError("worlds: their states have other lengths, since servos wait for other numbers of ticks: "
                         "let delays not differ")  # fmt: skip
    return np.array(found)


def _whole(crowd: Crowd) -> np.ndarray:
    out = np.empty((len(crowd.worlds), crowd.lots[0].length))
    for lot in crowd.lots:
        lot.reader(lot.y, out)()
    return out


def _slice(places: np.ndarray) -> Any:
    """A slice where they lie in a row: a view costs less than a choice."""
    if len(places) and (np.diff(places) == 1).all():
        return slice(int(places[0]), int(places[-1]) + 1)
    return places


def _give_first_errors(crowd: Crowd, fresh: np.ndarray, command: np.ndarray) -> None:
    """The last errors of controllers that begin, as of a run with that reference."""
    ready = crowd.worlds[0]
    if not ready.scene.sampled:
        return
    states, (first, end) = _whole(crowd), ready.scene.part("last_error")
    for robot in np.flatnonzero(fresh).tolist():
        world = crowd.worlds[robot]
        states[robot] = world.start(states[robot], Reference([0.0], command[robot][None])).y
    for lot in crowd.lots:
        rows = np.empty((crowd.lots[0].length, len(lot.of)))
        rows[...] = states[lot.of].T
        mine = fresh[lot.of].reshape(lot.shape)
        parts = np.moveaxis(rows.reshape(-1, *lot.shape), 0, 1)[:, first:end]
        np.copyto(lot.y[:, first:end], parts, where=mine[:, None])


__all__ = ["ACTIONS", "STATUS", "WHOLE", "Session"]
