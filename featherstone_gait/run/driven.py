"""Step a session by hand, tick by tick, and keep the inputs of each tick, so that the run can be repeated.

The channel `command` has the action of a tick, with the commands of drives of surfaces after it, and `push` a force on
a link: both stand in the row of the time from which they act.  `Trajectory.info["inputs"]` has the rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from ..base.arguments import instance, one_of, shown
from ..scene.compile import CompiledScene
from ..scene.external import Push
from .measure import What
from .prepare import coordinates
from .program import CompiledController, controller
from .session import Session
from .trajectory import Trajectory

DriveAction = Literal["speed", "reference", "voltage", "pwm", "torque"]
ACTIONS = ("speed", "reference", "voltage", "pwm", "torque")
UNLIMITED = 1e12  # where a joint without limits ends [rad or m]
PUSH = ("link", "x", "y", "z", "force x", "force y", "force z")  # columns: a number, link axes [m], world axes [N]


@controller
def follow_speeds(t: float, state: Any, reference: np.ndarray, command: np.ndarray, memory: np.ndarray) -> None:
    """Read references as speeds, and let positions follow up to the limits of the joints."""
    n = (len(memory) - 1) // 3
    for i in range(n):
        at = memory[1 + i] + memory[0] * reference[i, 0]
        memory[1 + i] = min(max(at, memory[1 + n + i]), memory[1 + 2 * n + i])
        command[i, 0] = memory[1 + i]
        command[i, 1] = reference[i, 0]


class Driven:
    """One robot or scene that is stepped by hand.

    Attributes
    ----------
    session : Session
    names : list of str
        What the numbers of a command are: joints, driven tendons and drives of surfaces.
    links : list of str
        Links that can be pushed.
    """

    def __init__(
        self,
        scene: CompiledScene,
        action: DriveAction | None = None,
        controller: CompiledController | None = None,
        record: Iterable[What] = (),
        state: Any = None,
        *,
        pushable: bool = False,
        pace: bool = False,
    ) -> None:
        instance("scene", scene, CompiledScene, "give what compile_scene returns")
        if action is None:
            action = "speed" if scene.follows and controller is None else None
        else:
            one_of("action", action, ACTIONS)
        if action == "speed" and controller is not None:
            raise ValueError("action is 'speed', but a controller reads references: leave one of both out")
        if action == "speed" and not scene.follows:
            raise ValueError(f"{scene.model.name}: action is 'speed', but it has no servos: give 'torque'")
        self.links = [*scene.tree.placements]
        wanted = dict.fromkeys((*(name for name in coordinates(scene) if not name.endswith("qd")), *record))
        self._how: dict[str, Any] = {"observe": coordinates(scene), "record": [*wanted], "pace": pace}
        self._how["pushes"] = [Push(self.links[0])] if pushable else []
        law, given = controller, None if action == "speed" else action
        with Session(scene, **self._how, action=given) as plain:
            plain.reset(state=state)
            self.first = plain.state[0]
            if action == "speed":
                law = follow_speeds.beginning_with(_memory(plain))
        self.action: str = "speed" if action == "speed" else plain.action
        self.session = Session(scene, **self._how, action=given, controller=law)
        self.seen = self.session.reset(state=self.first)
        self._surfaces = [*scene.surface_drives]
        self.names = names_of(scene)
        self._at_rest = self._rest()
        self._commands: list[np.ndarray] = []
        self._pushes: list[np.ndarray] = []
        self._drives = np.full(len(self._surfaces), np.nan)  # commands that were given last
        self._pushed = False

    def warm_up(self) -> None:
        """Load the kernel by a tick that is undone, so that the first one is as fast as the others."""
        self.session.step()
        self.seen = self.session.reset(state=self.first)

    def _rest(self) -> np.ndarray:
        """Return the command under which nothing is driven: joints where they are, or zero."""
        rest = np.zeros(len(self.names))
        if self.action == "reference":
            q = self.session.state[0, slice(*self.session.scene.part("q"))]
            rest[: len(q)] = q
        return rest

    @property
    def at_rest(self) -> np.ndarray:
        """A copy of the command under which nothing is driven."""
        return self._at_rest.copy()

    def step(self, command: np.ndarray, push: np.ndarray | None = None) -> None:
        """Advance by a tick under a command, and a push of the numbers PUSH."""
        command = np.array(command, float)
        if command.shape != (len(self.names),):
            raise ValueError(f"command has the shape {command.shape}; give {len(self.names)} numbers: {self.names}")
        joints = len(self.names) - len(self._surfaces)
        for k, drive in enumerate(self._surfaces):
            if command[joints + k] != self._drives[k]:
                self.session.command_surface(drive, command[joints + k])
                self._drives[k] = command[joints + k]
        if push is not None or self._pushed:
            self.session.set_push(0, self._push(np.zeros(len(PUSH)) if push is None else push))
            self._pushed = push is not None
        self._commands.append(command)
        self._pushes.append(np.zeros(len(PUSH)) if push is None else np.array(push, float))
        self.seen = self.session.step(command[:joints])

    def _push(self, numbers: np.ndarray) -> Push:
        point, force = (tuple(float(x) for x in part) for part in (numbers[1:4], numbers[4:7]))
        return Push(self.links[int(numbers[0])], force=force, point=point)  # type: ignore[arg-type]

    def trajectory(self) -> Trajectory:
        """Return the run so far, with its inputs."""
        run = self.session.trajectory()
        rows = len(run["time"])
        channels = dict(run.channels)
        channels["command"] = _padded(self._commands, rows, len(self.names))
        if self._how["pushes"]:
            channels["push"] = _padded(self._pushes, rows, len(PUSH))
        inputs = {"action": self.action, "first": self.first.tolist(), "ticks": rows - 1, "names": self.names}
        inputs |= {"links": self.links} if self._how["pushes"] else {}
        return replace(run, channels=channels, info=run.info | {"inputs": inputs})


def replay(scene: CompiledScene, run: Trajectory, controller: CompiledController | None = None) -> Trajectory:
    """Repeat a run of `drive` from the inputs that it stores, to the same bits.

    Parameters
    ----------
    scene : CompiledScene
        The scene that was driven.
    run : Trajectory
        What `drive` has returned or stored.
    controller : CompiledController, optional
        The one that it was driven with.

    Returns
    -------
    Trajectory
        The same channels and inputs.

    Raises
    ------
    ValueError
        The run has no inputs, or they do not fit the scene.
    """
    instance("run", run, Trajectory, "give what drive returns")
    inputs = run.info.get("inputs")
    if not isinstance(inputs, dict) or "command" not in run:
        raise ValueError("run: it has no inputs to repeat; give what drive returns, or Trajectory.load(FILE)")
    instance("scene", scene, CompiledScene, "give what compile_scene returns")
    pushable = "push" in run
    for name, has in (("names", names_of(scene)), ("links", [*scene.tree.placements])):
        if name in inputs and inputs[name] != has:
            raise ValueError(f"run: its inputs are of {shown(inputs[name])}, not of {shown(has)}: give its scene")
    recorded = [name for name in run if name not in ("time", "command", "push")]
    action = None if controller is not None else inputs["action"]
    driven = Driven(scene, action, controller, recorded, np.array(inputs["first"]), pushable=pushable)
    with driven.session:
        for k in range(inputs["ticks"]):
            push = run["push"][k] if pushable else None
            driven.step(run["command"][k], push if push is not None and push.any() else None)
        return driven.trajectory()


def names_of(scene: CompiledScene) -> list[str]:
    """List what the numbers of a command are: joints, driven tendons and drives of surfaces."""
    commanded = [*scene.model.joint_names, *(one.name for one in scene.driven_tendons)][: scene.commanded]
    return [*commanded, *scene.surface_drives]


def _memory(session: Session) -> np.ndarray:
    """Return the first memory of `follow_speeds`: a tick [s], positions and limits."""
    scene = session.scene
    n = scene.commanded
    place, low, high = np.zeros(n), np.full(n, -UNLIMITED), np.full(n, UNLIMITED)
    q = session.state[0, slice(*scene.part("q"))]
    place[: len(q)] = q
    for k, joint in enumerate(scene.model.moving_joints[: len(q)]):
        if np.isfinite([joint.lower, joint.upper]).all() and joint.type in ("revolute", "prismatic"):
            low[k], high[k] = min(joint.lower, q[k]), max(joint.upper, q[k])
    return np.r_[session.tick, place, low, high]


def _padded(rows: Sequence[np.ndarray], count: int, width: int) -> np.ndarray:
    """Return rows (count, width), of which those that no tick has had are zero."""
    found = np.zeros((count, width))
    for row, values in zip(found[:-1], rows):
        row[:] = values
    return found


__all__ = ["Driven", "replay"]
