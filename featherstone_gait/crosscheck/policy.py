"""A policy in MuJoCo and here: the same network, servos, floor and worlds, and what both engines say of them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import instance, real, vector, whole
from ..base.files import FilePath
from ..judge import Judgment, PolicyDescription, judge, load_policy
from ..judge.doubts import draw_worlds
from ..judge.run import MOST_WORLDS, WALKING_SHARE, rolled, scene_of, timing_of, verdicts_of
from ..model import Model
from ..run.session import Session
from ..run.start import positions_in
from ..run.status import Status
from ..scene.compile import CompiledScene
from .in_mujoco import Floor, advance, has_fallen, machine_of, place, sample_of

STEP = 2e-4  # MuJoCo's [s]
HARD = 1e-2  # time constant of MuJoCo's floor [s]: the hardest that its steps of 5 ms allow
DIVIDES = 1e-9  # tolerance of steps in a tick
COMPARED = {"speed": "speed [m/s]", "energy_per_way": "energy by way [J/m]"}


class PolicyCheck(NamedTuple):
    """What a policy does in MuJoCo, and here.

    Attributes
    ----------
    floor : Floor
        MuJoCo's floor, in the world where nothing is drawn.
    verdicts : ndarray of str, shape (worlds,)
        "walks", "stands", "falls" or "unknown", in MuJoCo.
    mujoco : dict of ndarray, shape (worlds,)
        What was measured in MuJoCo, by the names of `Judgment.worlds`.
    own : Judgment
        The same worlds here.
    """

    floor: Floor
    verdicts: np.ndarray
    mujoco: dict[str, np.ndarray]
    own: Judgment

    def table(self) -> str:
        """Return what was found as text.

        Returns
        -------
        str
            A line for each verdict, and of the worlds in which it walks in both engines medians and that of the
            differences.
        """
        both = (self.verdicts == "walks") & (self.own.verdicts == "walks")
        lines = [f"{self.own.policy} on {self.own.robot}, MuJoCo's floor of {1e3 * self.floor.time_constant:g} ms",
                 f"{'':22}{'MuJoCo':>12}{'here':>12}{'difference':>14}"]  # fmt: skip
        for name in ("walks", "stands", "falls", "unknown"):
            counts = [int((one == name).sum()) for one in (self.verdicts, self.own.verdicts)]
            lines.append(f"{name:22}{counts[0]:12d}{counts[1]:12d}")
        for name, what in COMPARED.items() if both.any() else ():
            theirs, ours = self.mujoco[name][both], self.own.worlds[name][both]
            by = f"{100.0 * np.median(theirs / ours - 1.0):+.1f} %"
            lines.append(f"{what:22}{np.median(theirs):12.4g}{np.median(ours):12.4g}{by:>14}")
        return "\n".join(lines)


def crosscheck_policy(
    policy: Any,
    robot: CompiledScene | Model,
    seconds: float = 10.0,
    command: ArrayLike = (0.1, 0.0, 0.0),
    *,
    worlds: int = 1,
    seed: int = 0,
    description: FilePath | PolicyDescription | None = None,
    doubts: FilePath | Mapping[str, Any] | None = None,
    floor: Floor | None = None,
    timestep: float = STEP,
) -> PolicyCheck:
    """Let a policy drive a robot in MuJoCo, and here on the robot's ground with the friction of MuJoCo's floor.

    MuJoCo's floor is softer in motion than at rest.  One of 10 ms is about as soft under a walking robot as ground with
    a penetration of 0.1 mm, which `judge` gives a robot: `docs/five_milliseconds.md`.

    Parameters
    ----------
    policy, robot, description
        As `judge` takes them, without compiled controllers.
    seconds
        Time in each world [s].
    command
        Velocity ahead and to the left [m/s] and about the vertical [rad/s].
    worlds, seed, doubts
        Number of worlds, and what differs between them, as `judge` takes it but without roughness; None: nothing.
    floor
        MuJoCo's floor; None: one with the friction of the robot's ground and a time constant of 10 ms.  In drawn worlds
        its time constant is as the root of the penetration, its friction the drawn one.
    timestep
        MuJoCo's time step [s].  Where it is longer than the servos' ticks it is their tick there.

    Returns
    -------
    PolicyCheck
        What both engines say.

    Raises
    ------
    ImportError, ValueError
        As `replay` and `judge`; ValueError for ground that is no plane at rest.
    """
    instance("robot", robot, (CompiledScene, Model), "give what load_robot or compile_scene returns")
    scene = scene_of(robot) if isinstance(robot, Model) else robot
    acting, tables = load_policy(policy, scene.model, description), {} if doubts is None else doubts
    end, asked = real("seconds", seconds, 1e-2, 1e4, "10 is usual"), vector("command", command, 3, "[m/s, m/s, rad/s]")
    h = real("timestep", timestep, 1e-6, 2e-2, "give MuJoCo's step [s], 2e-4 is fine")
    count = whole("worlds", worlds, 1, "1 is the robot as it is", MOST_WORLDS)
    ground = scene.ground
    if ground is None:
        raise ValueError(f"{scene.model.name}: there is no ground to walk on; compile the scene with ground=Ground()")
    if acting.controller is not None:
        raise ValueError(f"{acting.name}: its compiled controller does not run in MuJoCo; give a network or a function")
    lies = Floor(HARD, ground.friction) if floor is None else floor
    own = scene.recompiled(ground=replace(ground, friction=lies.friction))
    drawn = draw_worlds(own, count, seed, tables)
    robots = _Robots([*drawn.worlds.scenes(own, range(count))], lies, ground.penetration, h)
    timing = timing_of(acting.description, robots.tick, end)
    here = judge(acting, own, count, end, asked, seed, doubts=tables, again=0)
    found = rolled(acting, cast(Session, robots), drawn, timing, asked)
    return PolicyCheck(lies, verdicts_of(found, acting, asked, end, WALKING_SHARE), found.worlds, here)


class _Robots:
    """Robots in MuJoCo, a world each, with what `rolled` asks of a `Session`."""

    def __init__(self, scenes: Sequence[CompiledScene], floor: Floor, depth: float, h: float) -> None:
        self.scenes, self.scene, self.n = scenes, scenes[0], len(scenes)
        self.tick = max(self.scene.tick_steps * self.scene.timestep, h)
        self._steps = round(self.tick / h)
        if abs(self._steps * h - self.tick) > DIVIDES * self.tick:
            raise ValueError(f"timestep {h:g} s does not divide the controllers' period of {self.tick:g} s")
        self._machines = [machine_of(one, _floor_of(one, floor, depth, h), h, held=True) for one in scenes]
        self._lag = math.ceil(self.scene.lag / self.tick - DIVIDES)
        self._soles = {point.link: k for k, point in reversed([*enumerate(self.scene.model.contacts)])}

    def reset(self, *, state: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
        """Place each robot as in its state, at rest, and return what is seen."""
        starts = [positions_in(scene, one) for scene, one in zip(self.scenes, state)]
        for machine, q in zip(self._machines, starts):
            place(machine, q)
        self._sent = [deque([one.d.qpos[one.q].copy()] * (self._lag + 1), self._lag + 1) for one in self._machines]
        self.time, self.status, self.messages = np.zeros(self.n), [Status.OK] * self.n, [""] * self.n
        rows = [self._look(k) for k in range(self.n)]
        self._seen = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return self._seen

    @property
    def active(self) -> np.ndarray:
        """Mask (n,) bool of the robots that have not failed."""
        return np.array(self.status) == Status.OK

    @property
    def state_view(self) -> dict[str, np.ndarray]:
        """The energies (n, joints, kinds), those that MuJoCo lacks NaN."""
        return {"energy": self._seen["energy"]}

    def set_state(self, name: str, values: np.ndarray, mask: np.ndarray) -> dict[str, np.ndarray]:
        """Set the bases' velocities (n, 6) of the robots of the mask; return what is seen."""
        for k in np.flatnonzero(mask).tolist():
            self._machines[k].d.qvel[:6] = self._seen[name][k] = values[k]
        return self._seen

    def step(self, action: np.ndarray, ticks: int) -> dict[str, np.ndarray]:
        """Advance by some ticks under references (n, joints), and return what is seen."""
        still = np.zeros(action.shape[1])
        for k in np.flatnonzero(self.active).tolist():
            machine = self._machines[k]
            for _ in range(ticks):
                self._sent[k].append(action[k])
                advance(machine, self._sent[k][0], still, self.tick, self._steps)
            self.time[k] += ticks * self.tick
            for name, value in self._look(k).items():
                self._seen[name][k] = value
            if not np.isfinite(machine.d.qpos).all() or machine.d.warning.number.any():
                self.status[k], self.messages[k] = Status.DIVERGED, f"diverged in MuJoCo at {self.time[k]:.3g} s"
            elif has_fallen(self.scenes[k], machine):
                self.status[k] = Status.FELL
        return self._seen

    def _look(self, k: int) -> dict[str, np.ndarray]:
        """Return the channels of a robot; forces on a link are at the first of its contact points."""
        machine, model = self._machines[k], self.scene.model
        d, force = machine.d, np.zeros((len(model.contacts), 3))
        for geoms, row in zip(d.contact.geom, d.contact.efc_address):
            link = machine.m.body(machine.m.geom_bodyid[geoms.max()]).name
            force[self._soles[link], 0] += d.efc_force[row]  # elliptic cones begin with the normal force
        more = {"voltage": machine.chain.voltage.copy(), "contact_force": force, "base_qdd": d.qacc[:6].copy()}
        return sample_of(self.scenes[k], machine) | more


def _floor_of(scene: CompiledScene, floor: Floor, depth: float, h: float) -> Floor:
    """Return MuJoCo's floor of a world, `floor` where its penetration is `depth`."""
    ground = scene.ground
    assert ground is not None
    hard = floor.time_constant * math.sqrt(ground.penetration / depth)
    return replace(floor, time_constant=max(hard, 2.0 * h), friction=ground.friction)
