"""A policy in MuJoCo and here: the same network, servos, floor and worlds, and what both engines say of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import instance, real, vector, whole
from ..base.files import FilePath
from ..judge import Judgment, Policy, PolicyDescription, judge, load_policy
from ..judge.doubts import Drawn, draw_worlds
from ..judge.meter import Meter
from ..judge.observation import Observer
from ..judge.run import LEAST, MOST_WORLDS, scene_of
from ..model import Model
from ..model.rest_posture import nearest_posture, standing_keyframe
from ..run.simulate import standing_state
from ..run.start import positions_in
from ..scene.compile import CompiledScene
from .in_mujoco import Floor, advance, has_fallen, machine_of, place, sample_of, sinking

STEP = 2e-4  # MuJoCo's [s]
HARD = 1e-2  # time constant of MuJoCo's floor [s]: the hardest that its steps of 5 ms allow
SAMPLE = 5e-3  # longest time between two samples [s]
DIVIDES = 1e-9  # tolerance of steps in a tick
COMPARED = ("speed", "energy_per_way")


class PolicyCheck(NamedTuple):
    """What a policy does in MuJoCo, and here.

    Attributes
    ----------
    floor : Floor
        MuJoCo's floor, in the world where nothing is drawn.
    sinking : float
        How deep the contact points of the standing robot sink in it, in both engines [m].
    verdicts : ndarray of str, shape (worlds,)
        "walks", "stands", "falls" or "unknown", in MuJoCo.
    mujoco : dict of ndarray, shape (worlds,)
        What was measured in MuJoCo, by the names of `Judgment.worlds`.
    own : Judgment
        The same worlds here.
    """

    floor: Floor
    sinking: float
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
        lines = [f"{self.own.policy} on {self.own.robot}, floor sinks {1e3 * self.sinking:.3g} mm",
                 f"{'':22}{'MuJoCo':>12}{'here':>12}{'difference':>14}"]  # fmt: skip
        for name in ("walks", "stands", "falls", "unknown"):
            counts = [int((one == name).sum()) for one in (self.verdicts, self.own.verdicts)]
            lines.append(f"{name:22}{counts[0]:12d}{counts[1]:12d}")
        for name, what in zip(COMPARED, ("speed [m/s]", "energy by way [J/m]")):
            if both.any():
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
    """Let a policy drive a robot in MuJoCo, and here on a floor of the same friction and penetration.

    Parameters
    ----------
    policy, robot, description
        As `judge` takes them; servos need a motor.
    seconds
        Time in each world [s].
    command
        Velocity ahead and to the left [m/s] and about the vertical [rad/s].
    worlds, seed, doubts
        Number of worlds, and what differs between them, as `judge` takes it but without pushes, slopes, delays and lost
        actions; None: nothing.
    floor
        MuJoCo's floor; None: one with the friction of the robot's ground and a time constant of 10 ms.  In drawn worlds
        its time constant is as the root of the penetration, its friction the drawn one.
    timestep
        MuJoCo's time step [s].  Longer than the servos' ticks it is these ticks as well.

    Returns
    -------
    PolicyCheck
        What both engines say.

    Raises
    ------
    ImportError, ValueError
        As `replay` and `judge`; ValueError for worlds that MuJoCo's floor lacks.
    """
    instance("robot", robot, (CompiledScene, Model), "give what load_robot or compile_scene returns")
    scene = scene_of(robot) if isinstance(robot, Model) else robot
    ground = scene.ground
    if ground is None:
        raise ValueError(f"{scene.model.name}: there is no ground to walk on; compile the scene with ground=Ground()")
    h = real("timestep", timestep, 1e-6, 2e-2, "give MuJoCo's step [s], 2e-4 is fine")
    count, asked = whole("worlds", worlds, 1, "1 is the robot as it is", MOST_WORLDS), vector("command", command, 3, "")
    acting, tables = load_policy(policy, scene.model, description), {} if doubts is None else doubts
    lies = Floor(HARD, ground.friction) if floor is None else floor
    drive = _Drive(acting, scene)
    depth = sinking(scene, drive.rest, lies, timestep=min(STEP, scene.timestep, 0.5 * lies.time_constant))
    own = scene.recompiled(ground=replace(ground, friction=lies.friction, penetration=depth))
    drawn = _level(draw_worlds(own, count, seed, tables))
    here = judge(acting, own, count, seconds, asked, seed, doubts=tables, again=0)
    robots = _Robots(drawn.worlds.scenes(own, range(count)), lies, depth, h)
    found = _rolled(acting, robots, drawn, here.settings["seconds"], asked)
    commanded = any(block.name == "command" for block in acting.description.observation)
    way = float(np.hypot(*asked[:2])) * seconds if commanded else float(np.median(here.worlds["way"]))
    upright = np.where(found["way"] >= LEAST * way, "walks", "stands")
    verdicts = np.where(robots.lost, "unknown", np.where(robots.fell, "falls", upright))
    return PolicyCheck(lies, depth, verdicts, found, here)


def _level(drawn: Drawn) -> Drawn:
    """Return the worlds; raise ValueError for those that differ by what the loop here lacks."""
    numbers = drawn.sensing.numbers
    lacking = {"pushes": numbers.speed, "[link] delay": numbers.delay, "[link] lost": numbers.lost}
    lacking["slope"] = float("ground.slope" in drawn.factors)
    found = [name for name, size in lacking.items() if size]
    if found:
        raise ValueError(f"doubts: {found[0]} cannot be drawn in MuJoCo here; leave it out of the file to compare")
    return drawn


class _Drive:
    """References of the servos, of the actions of a policy."""

    def __init__(self, policy: Policy, scene: CompiledScene) -> None:
        own, model = policy.description.action, scene.model
        self.columns = np.array([model.joint_names.index(name) for name in policy.description.joints], int)
        low, high = (np.array([getattr(one, end) for one in model.moving_joints]) for end in ("lower", "upper"))
        self.pose, self.action = np.array(policy.description.pose), own
        held = standing_keyframe(model)
        self.rest = model.single_positions(nearest_posture(model)) if held is None else np.array(held[7:], float)
        self.rest[self.columns] = np.clip(self.pose, low[self.columns], high[self.columns])
        free = np.full(len(self.pose), np.inf)
        low, high = (low[self.columns], high[self.columns]) if own.limits else (-free, free)
        self.low, self.high = np.maximum(low, own.lower), np.minimum(high, own.upper)

    def targets(self, actions: np.ndarray, before: np.ndarray, period: float) -> np.ndarray:
        """Return references (n, joints of the policy) of actions, where the last ones were `before`."""
        wanted = self.pose + self.action.scale * np.clip(actions, -self.action.clip, self.action.clip)
        most = self.action.max_speed * period
        return np.clip(np.clip(wanted, self.low, self.high), before - most, before + most)


class _Robots:
    """Robots in MuJoCo, a world each, with what a `Meter` asks of a session."""

    def __init__(self, scenes: Sequence[CompiledScene], floor: Floor, depth: float, h: float) -> None:
        self.scenes, self.scene, self.n = scenes, scenes[0], len(scenes)
        self.tick = max(self.scene.tick_steps * self.scene.timestep, h)
        self._steps = round(self.tick / h)
        if abs(self._steps * h - self.tick) > DIVIDES * self.tick:
            raise ValueError(f"timestep {h:g} s does not divide the controllers' period of {self.tick:g} s")
        self._machines = []
        for one in scenes:
            assert one.ground is not None
            hard = floor.time_constant * (one.ground.penetration / depth) ** 0.5
            lies = replace(floor, time_constant=max(hard, 2.0 * h), friction=one.ground.friction)
            self._machines.append(machine_of(one, lies, h))
        self.lag = int(np.ceil(self.scene.lag / self.tick - DIVIDES))
        self.time, self.fell, self.lost = np.zeros(self.n), np.zeros(self.n, bool), np.zeros(self.n, bool)
        self._soles = {point.link: k for k, point in reversed([*enumerate(self.scene.model.contacts)])}

    @property
    def active(self) -> np.ndarray:
        """Which robots have not failed (n,)."""
        return ~(self.fell | self.lost)

    @property
    def state_view(self) -> dict[str, np.ndarray]:
        """The energies (n, joints, kinds), those that MuJoCo lacks NaN."""
        return {"energy": self._seen["energy"]}

    def reset(self, angles: np.ndarray) -> dict[str, np.ndarray]:
        """Place the robots with their joints at these angles (n, joints), and return what is seen."""
        for machine, scene, row in zip(self._machines, self.scenes, angles):
            place(machine, positions_in(scene, standing_state(scene, row, True)))
        self._sent = [deque([row] * (self.lag + 1), self.lag + 1) for row in angles]
        rows = [self._look(k) for k in range(self.n)]
        self._seen = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return self._seen

    def step(self, references: np.ndarray, ticks: int) -> dict[str, np.ndarray]:
        """Advance by some ticks under references (n, joints), and return what is seen."""
        for k in np.flatnonzero(self.active).tolist():
            machine, still = self._machines[k], np.zeros(references.shape[1])
            for _ in range(ticks):
                self._sent[k].append(references[k])
                advance(machine, self._sent[k][0], still, self.tick, self._steps)
            self.time[k] += ticks * self.tick
            for name, value in self._look(k).items():
                self._seen[name][k] = value
            self.lost[k] = not np.isfinite(machine.d.qpos).all() or machine.d.warning.number.any()
            self.fell[k] = not self.lost[k] and has_fallen(self.scenes[k], machine)
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


def _rolled(
    policy: Policy, robots: _Robots, drawn: Drawn, seconds: float, command: np.ndarray
) -> dict[str, np.ndarray]:
    """Let a policy drive robots in MuJoCo as `judge` does here; return what was measured (worlds,)."""
    description, drive, n = policy.description, _Drive(policy, robots.scene), robots.n
    exact = 1.0 if np.isinf(description.rate) else 1.0 / (description.rate * robots.tick)
    every = max(1, round(exact))
    if abs(every - exact) > DIVIDES * exact:
        raise ValueError(f"{policy.name}: its rate of {description.rate:g} Hz is none of ticks of {robots.tick:g} s")
    ticks = max(k for k in range(1, every + 1) if every % k == 0 and k * robots.tick <= max(SAMPLE, robots.tick))
    offset, period = drawn.sensing.offset, every * robots.tick
    references = np.repeat(drive.rest[None], n, axis=0)
    seen = robots.reset(references - offset)
    size = float(np.hypot(*command[:2]))
    direction = command[:2] / size if size else np.array([1.0, 0.0])
    observer = Observer(description, robots.scene, drawn, period)
    meter = Meter(robots, seen, direction, ticks * robots.tick)  # type: ignore[arg-type]
    actions, targets = np.zeros((n, len(description.joints))), references[:, drive.columns]
    for step in range(max(1, round(seconds / period))):
        actions = policy.actions(observer.look(seen, step, actions, targets, command), step * period)
        references[:, drive.columns] = targets = drive.targets(actions, targets, period)
        for _ in range(every // ticks):
            moving = robots.active
            seen = robots.step(references - offset, ticks)
            meter.take(seen, moving)
        if not robots.active.any():
            break
    return meter.result()[0]
