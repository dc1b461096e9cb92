"""Gymnasium environments of one robot, or of many in lanes; `pip install featherstone-gait[gym]`.

    env = Stand("humanoid")                     # gymnasium.Env
    envs = WalkVector("humanoid", num_envs=64)  # gymnasium.vector.VectorEnv
    env = gymnasium.make("featherstone_gait/Push-v0", robot="humanoid")

Any robot with a floating base that stands on its contact points will do.  An action in [-1, 1] for each joint moves the
reference of its servo about the standing posture.  Worlds are the domain randomization: robot k of a vector stays in
world k, a single robot draws a world for each episode.  An episode depends on its seed alone: robot k of a vector that
is reset with the seed s has the same bits as a single robot reset with s + k.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import finite, listed, one_of, real, vector, whole
from ..geometry.contact_choice import usual_choice
from ..model import Ground, Model
from ..robot_file import load_robot
from ..run.prepare import most_ticks
from ..run.session import MOST_ROBOTS, Session
from ..run.simulate import standing_state
from ..run.start import check_one
from ..run.worlds import Worlds
from ..scene.actuator import servo_gearbox
from ..scene.compile import CompiledScene, compile_scene
from ..scene.gearbox_kinds import GearboxKind

__all__ = [
    "Push",
    "PushVector",
    "RobotEnv",
    "RobotVectorEnv",
    "Stand",
    "StandVector",
    "Task",
    "Walk",
    "WalkVector",
]

try:
    import gymnasium
    from gymnasium import spaces
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise ImportError("environments need Gymnasium: pip install featherstone-gait[gym]") from error

if TYPE_CHECKING:
    from ..view.movie import Picture, Window

OBSERVED = ("q", "qd", "base_q", "base_qd")
SPREAD = 0.02  # range of joint positions at the start [rad or m]
TILTED = 0.5  # tilt at which standing has no reward [rad]
EFFORT = 0.01  # cost of the mean square of an action
NO_WINDOW = 'Matplotlib has no window here; give render_mode="rgb_array", or choose a backend such as "qtagg"'
KEPT = 64  # sessions of worlds that one environment keeps, of some 70 kB
RenderMode = Literal["human", "rgb_array"]
Step = tuple[Any, Any, Any, Any, dict[str, Any]]


class Task(NamedTuple):
    """The task of a robot.

    Attributes
    ----------
    speed : float
        Forward speed, along the base's first axis at the start [m/s].
    push : float
        Change of the robot's velocity by a push from a random side [m/s].
    every : float
        Mean time between pushes [s].
    """

    speed: float = 0.0
    push: float = 0.0
    every: float = 2.0


class _Robots:
    """Parts that environments of one and of many robots share; rows of arrays are robots."""

    more = 0  # numbers that are observed of other things than the robot

    def __init__(
        self,
        robot: Any,
        task: Task,
        worlds: Worlds | None,
        angles: ArrayLike | None,
        scale: float,
        ticks: int,
        duration: float,
        gearbox: GearboxKind | None,
    ) -> None:
        self.task, self.worlds = task, worlds
        self.scene, self.alone = self.compiled(robot, gearbox)
        model, n = self.alone.model, self.alone.tree.n
        self.angles = vector("angles", np.zeros(n) if angles is None else angles, n, "[rad or m], of a standing robot")
        self.scale = real("scale", scale, 0.0, 10.0, "it is what an action of 1 moves a reference by")
        self.ticks = whole("ticks", ticks, 1, "an action holds for so many controller ticks", most_ticks(self.scene))
        self.duration = real("duration", duration, 1e-3, 1e6, "give the longest episode [s]")
        self.lower = np.array([joint.lower for joint in model.moving_joints])
        self.upper = np.array([joint.upper for joint in model.moving_joints])
        self.angles = np.clip(self.angles, self.lower, self.upper)
        standing = self.alone.state_view(standing_state(self.alone, self.angles))
        self.standing = np.concatenate([standing["base_q"], standing["q"]])
        self.height = float(standing["base_q"][2])
        self.observation_space = spaces.Box(-np.inf, np.inf, (2 * n + 10 + self.more,), np.float64)
        self.action_space = spaces.Box(-1.0, 1.0, (n,), np.float64)

    def compiled(self, robot: Any, gearbox: Any) -> tuple[CompiledScene, CompiledScene]:
        """Return the scene, and that of the robot alone."""
        scene = _scene(robot, gearbox)
        return scene, scene

    @cached_property
    def picture(self) -> Picture:
        """A picture with room for a robot that stands or lies."""
        from ..view.movie import Picture

        assert self.scene.ground is not None
        model, q = self.drawn_first()
        return Picture([model], q, self.scene.ground.height)

    def drawn_first(self) -> tuple[Model, np.ndarray]:
        """Return the model to draw, and its positions (1, nq) at the start."""
        return self.alone.model, self.standing[None]

    def drawn(self, seen: dict[str, np.ndarray], robot: int) -> np.ndarray:
        """Return the positions (nq,) to draw of a robot."""
        return np.concatenate([seen["base_q"][robot], seen["q"][robot]])

    def draw(self, session: Session, robot: int = 0) -> np.ndarray:
        """Return a picture (height, width, 3) of a robot as it is now."""
        seen, status = session.observe(), session.status[robot]
        label = f"{session.time[robot]:.2f} s" + f": {status}" * (status != "ok")
        self.picture.draw(self.drawn(seen, robot), label)
        return self.picture.pixels()

    def begin(self, draw: np.random.Generator) -> np.ndarray:
        """Draw the first state of an episode."""
        angles = self.angles + draw.uniform(-SPREAD, SPREAD, self.angles.shape)
        return standing_state(self.alone, np.clip(angles, self.lower, self.upper))

    def reference(self, actions: np.ndarray) -> np.ndarray:
        """Return the reference of the servos (n, joints) for actions."""
        return np.clip(self.angles + self.scale * np.clip(actions, -1.0, 1.0), self.lower, self.upper)

    def push(self, session: Session, draws: Sequence[np.random.Generator | None]) -> None:
        """Push some of the robots, each by its own draws; None: not that robot."""
        kicks = np.zeros((session.n, 2))
        for robot, draw in enumerate(draws if self.task.push else ()):
            if draw is not None:
                chance, angle = draw.random(), draw.uniform(-np.pi, np.pi)
                if chance < self.ticks * session.tick / self.task.every:
                    kicks[robot] = self.task.push * np.array([np.cos(angle), np.sin(angle)])
        who = kicks.any(axis=1)
        if who.any():
            speeds = session.observe()["base_qd"].copy()
            speeds[:, :2] += kicks
            session.set_state("base_qd", speeds, who)

    def observation(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Return joints from standing, their speeds, gravity and rotation in base axes, base velocity and height."""
        base_q, base_qd = seen["base_q"], seen["base_qd"]
        height = base_q[:, 2:3] - self.height
        return np.hstack([seen["q"] - self.angles, seen["qd"], -_up(base_q), base_qd[:, 3:], base_qd[:, :3], height])

    def reward(self, seen: dict[str, np.ndarray], actions: np.ndarray) -> np.ndarray:
        """Return 1 for standing upright, plus 1 for walking at the desired speed, minus the cost of the action."""
        tilt, taken = _tilt(seen["base_q"]), np.clip(actions, -1.0, 1.0)
        reward = 1.0 - np.minimum(tilt / TILTED, 1.0) ** 2 - EFFORT * (taken**2).mean(axis=1)
        if self.task.speed:
            reward = reward + np.clip(seen["base_qd"][:, 0] / self.task.speed, -1.0, 1.0)
        return reward

    def ended(self, session: Session, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Return whose episode has ended, other than by its time."""
        return ~session.active

    def info(self, session: Session, seen: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return time [s], place [m] and tilt [rad] of the base."""
        return {"time": session.time, "x": seen["base_q"][:, 0].copy(), "tilt": _tilt(seen["base_q"])}


class RobotEnv(gymnasium.Env):
    """An environment of one robot; `Stand`, `Walk` and `Push` are its tasks.

    Actions are (n,), numbers from -1 to 1 for its n joints; larger ones count as -1 or 1.  Observations are
    (2 n + 10,): the joints' angles from standing [rad or m] and their speeds, the direction of gravity (3,) and the
    angular velocity [rad/s] in the base's axes, the base's velocity [m/s] and its height over that of standing [m].
    Info has time [s], place along x [m] and tilt [rad] of the base.

    Parameters
    ----------
    robot
        Name or file of a robot that stands on contact points, a `Model`, or a compiled scene with ground.
    worlds
        Domain randomization: one world is drawn for each episode.
    angles
        Joint positions in the standing posture (n,) [rad or m].  None: zero.
    scale
        Change of the servos' reference by an action of 1 [rad or m].
    ticks
        Controller ticks for which an action is held.
    duration
        Longest episode [s].
    gearbox
        Gearbox model, unless `robot` is a scene: "mipsd", "rotor" or "standard", as in `compile_scene`.  None: "mipsd"
        if all gears are elastic, else "rotor".
    render_mode
        "rgb_array": `render` returns a picture (480, 640, 3) of whole numbers from 0 to 255.  "human": each step is
        drawn in a window of Matplotlib, not faster than real time.  None: nothing is drawn.

    Raises
    ------
    ValueError
        For robots that do not stand, and for numbers out of range.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 50.0}  # noqa: RUF012
    task = Task()
    _kind = _Robots

    def __init__(
        self,
        robot: str | Model | CompiledScene = "humanoid",
        *,
        worlds: Worlds | None = None,
        angles: ArrayLike | None = None,
        scale: float = 0.3,
        ticks: int = 2,
        duration: float = 10.0,
        gearbox: GearboxKind | None = None,
        render_mode: RenderMode | None = None,
    ) -> None:
        self._robots = self._kind(robot, self.task, worlds, angles, scale, ticks, duration, gearbox)
        self.render_mode, self.metadata = _render_mode(self, render_mode)
        self._window: Window | None = None
        self._worlds = self._robots.worlds
        self.observation_space, self.action_space = self._robots.observation_space, self._robots.action_space
        self._sessions: dict[int, Session] = {}
        self._session: Session | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; return the observation (2 n + 10,) and info, as Gymnasium defines."""
        super().reset(seed=seed)
        world = 0 if self._worlds is None else int(self.np_random.integers(len(self._worlds)))
        if world not in self._sessions:
            robots = self._robots
            scene = robots.scene if self._worlds is None else self._worlds.scenes(robots.scene, [world])[0]
            self._sessions[world] = Session(scene, 1, observe=OBSERVED)
            if len(self._sessions) > KEPT:
                self._sessions.pop(next(iter(self._sessions))).close()
        self._session = self._sessions[world]
        seen = self._session.reset(state=self._robots.begin(self.np_random))
        if self.render_mode == "human":
            self.render()
        return self._robots.observation(seen)[0], self._info(seen)

    def step(self, action: Any) -> Step:
        """Step under an action (n,); return observation, reward, terminated, truncated and info, as Gymnasium defines.

        Raises ValueError before the first `reset`, and for an action of another shape or that is not finite.
        """
        if self._session is None:
            raise ValueError("step: no episode has begun; call reset first")
        robots, session = self._robots, self._session
        actions = vector("action", action, len(robots.angles), "numbers from -1 to 1")[None]
        robots.push(session, [self.np_random])
        seen = session.step(robots.reference(actions), robots.ticks)
        ended, late = bool(robots.ended(session, seen)[0]), bool(session.time[0] >= robots.duration - 1e-9)
        reward = float(robots.reward(seen, actions)[0])
        if self.render_mode == "human":
            self.render()
        return robots.observation(seen)[0], reward, ended, late and not ended, self._info(seen)

    def _info(self, seen: dict[str, np.ndarray]) -> dict[str, Any]:
        assert self._session is not None
        found = self._robots.info(self._session, seen)
        return {name: float(values[0]) for name, values in found.items()}

    def render(self) -> Any:
        """Draw the robot as `render_mode` says; return the picture (480, 640, 3) of "rgb_array", else None.

        Raises ValueError before the first `reset`.
        """
        if self.render_mode is None:
            return _no_mode(self)
        if self._session is None:
            raise ValueError("render: no episode has begun; call reset first")
        if self.render_mode == "rgb_array":
            return self._robots.draw(self._session)
        if self._window is None:
            from ..view.movie import Window

            self._window = Window(self._robots.picture.size, self.metadata["render_fps"])
            if not self._window.opened:
                gymnasium.logger.warn(f"render: {NO_WINDOW}")
        if self._window.opened:
            self._window.show(self._robots.draw(self._session))
        return None

    def close(self) -> None:
        """Close the sessions and the window."""
        if self._window is not None:
            self._window.close()
        for session in self._sessions.values():
            session.close()
        self._sessions, self._session, self._window = {}, None, None


class RobotVectorEnv(VectorEnv):
    """An environment of many robots; one whose episode has ended begins the next in the step after that.

    Actions (num_envs, n), observations (num_envs, 2 n + 10), rewards (num_envs,) and arrays in info have a row or a
    number for each robot, as in `RobotEnv`.

    Parameters
    ----------
    robot, angles, scale, ticks, duration, gearbox
        As in `RobotEnv`.
    num_envs
        Number of robots.
    worlds
        Domain randomization: robot k stays in world k.
    render_mode
        "rgb_array": `render` returns a picture of each robot.  None: nothing is drawn.

    Raises
    ------
    ValueError
        As `RobotEnv`, and for fewer worlds than robots.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"], "render_fps": 50.0, "autoreset_mode": AutoresetMode.NEXT_STEP,
    }  # fmt: skip
    task = Task()
    _kind = _Robots

    def __init__(
        self,
        robot: str | Model | CompiledScene = "humanoid",
        num_envs: int = 8,
        *,
        worlds: Worlds | None = None,
        angles: ArrayLike | None = None,
        scale: float = 0.3,
        ticks: int = 2,
        duration: float = 10.0,
        gearbox: GearboxKind | None = None,
        render_mode: RenderMode | None = None,
    ) -> None:
        self._robots = self._kind(robot, self.task, worlds, angles, scale, ticks, duration, gearbox)
        self.render_mode, self.metadata = _render_mode(self, render_mode)
        self.num_envs = whole("num_envs", num_envs, 1, "give the number of robots", MOST_ROBOTS)
        self.single_observation_space = self._robots.observation_space
        self.single_action_space = self._robots.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._worlds = self._robots.worlds
        self._session = Session(self._robots.scene, self.num_envs, observe=OBSERVED, worlds=self._worlds)
        self._draws: list[np.random.Generator] = []
        self._ended = np.zeros(self.num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode of each robot, robot k with seed + k or seed[k]; return observations and info.

        Raises ValueError for a list of seeds that is not one for each robot.
        """
        if seed is None and self._draws:
            seeds: list[int | None] = [None] * self.num_envs
        elif seed is None or isinstance(seed, (int, np.integer)):
            seeds = [None if seed is None else int(seed) + k for k in range(self.num_envs)]
        else:
            seeds = listed("seed", seed, "give a whole number, or one each of the robots")
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed has {len(seeds)} entries; there are {self.num_envs} robots: give one each")
        old: Sequence[np.random.Generator | None] = self._draws or [None] * self.num_envs
        self._draws = [
            draw if one is None and draw is not None else gymnasium.utils.seeding.np_random(one)[0]
            for one, draw in zip(seeds, old)
        ]
        seen = self._begin(np.ones(self.num_envs, bool))
        self._ended[:] = False
        return self._robots.observation(seen), self._info(seen)

    def _begin(self, who: np.ndarray) -> dict[str, np.ndarray]:
        """Begin new episodes of some robots, which stay in their worlds."""
        firsts = []
        for robot in np.flatnonzero(who).tolist():
            if self._worlds is not None:
                self._draws[robot].integers(len(self._worlds))  # the draw by which a single robot chooses its world
            firsts.append(self._robots.begin(self._draws[robot]))
        return self._session.reset(who, np.array(firsts))

    def step(self, actions: Any) -> Step:
        """Step under actions (num_envs, n), as Gymnasium defines.

        Raises ValueError before the first `reset`, and for actions of another shape or that are not finite.
        """
        if not self._draws:
            raise ValueError("step: no episode has begun; call reset first")
        robots, session, new = self._robots, self._session, self._ended.copy()
        given = finite("actions", actions, (self.num_envs, len(robots.angles)), "from -1 to 1")
        robots.push(session, [None if begins else draw for begins, draw in zip(new, self._draws)])
        seen = session.step(robots.reference(given), robots.ticks)
        if new.any():
            seen = self._begin(new)
        ended = robots.ended(session, seen) & ~new
        late = (session.time >= robots.duration - 1e-9) & ~ended & ~new
        rewards = np.where(new, 0.0, robots.reward(seen, given))
        self._ended = ended | late
        return robots.observation(seen), rewards, ended, late, self._info(seen)

    def _info(self, seen: dict[str, np.ndarray]) -> dict[str, Any]:
        return dict(self._robots.info(self._session, seen))

    def render(self) -> Any:
        """Return a picture (480, 640, 3) of each robot if `render_mode` is "rgb_array", else None.

        Raises ValueError before the first `reset`.
        """
        if self.render_mode is None:
            return _no_mode(self)
        if not self._draws:
            raise ValueError("render: no episode has begun; call reset first")
        return tuple(self._robots.draw(self._session, robot) for robot in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the session."""
        self._session.close()


class Stand(RobotEnv):
    """Task: stand upright; see `RobotEnv`."""


class Walk(RobotEnv):
    """Task: walk forwards at 0.2 m/s; see `RobotEnv`."""

    task = Task(speed=0.2)


class Push(RobotEnv):
    """Task: stand under pushes of 0.15 m/s, about every two seconds, from any side; see `RobotEnv`."""

    task = Task(push=0.15)


class StandVector(RobotVectorEnv):
    """Task of many robots: stand upright; see `RobotVectorEnv`."""


class WalkVector(RobotVectorEnv):
    """Task of many robots: walk forwards at 0.2 m/s; see `RobotVectorEnv`."""

    task = Walk.task


class PushVector(RobotVectorEnv):
    """Task of many robots: stand under pushes; see `RobotVectorEnv`."""

    task = Push.task


def _render_mode(env: Any, mode: Any) -> tuple[str | None, dict[str, Any]]:
    """Check how an environment is to be drawn; return that and its metadata, with the rate of its steps."""
    robots = env._robots
    rate = 1.0 / (robots.ticks * robots.scene.tick_steps * robots.scene.timestep)
    known = env.metadata["render_modes"]
    return None if mode is None else one_of("render_mode", mode, known), env.metadata | {"render_fps": rate}


def _no_mode(env: Any) -> None:
    """Warn as Gymnasium does that nothing is drawn."""
    name = type(env).__name__ if env.spec is None else env.spec.id
    modes = " or ".join(f'"{mode}"' for mode in env.metadata["render_modes"])
    gymnasium.logger.warn(f"render: {name} was made without a render mode and draws nothing; give render_mode={modes}")


def _scene(robot: Any, gearbox: Any) -> CompiledScene:
    """Return the scene of a robot that can stand."""
    scene = robot
    if not isinstance(robot, CompiledScene):
        scene = compile_scene(*actuated(robot, gearbox), Ground(), "midpoint", 1e-3)
    check_one(scene, "an environment")
    if scene.ground is None or not scene.tree.floating or scene.constants.actuator is None:
        raise ValueError(
            f"{scene.model.name}: environments are of robots with a floating base, on the ground, with servos: load it "
            "with base='floating', and compile its scene with ground=Ground() and servos"
        )
    return scene


def actuated(robot: Any, gearbox: Any) -> tuple[Model, Any]:
    """Return the model of a robot with servos, and the gearbox model that they take."""
    model = robot if isinstance(robot, Model) else load_robot(robot)
    if not model.servos:
        raise ValueError(
            f"{model.name}: it has no servos, which actions move; add some: walking.with_generic_servos("
            f"load_robot(FILE, base='floating', contacts={usual_choice(model) or 'all'!r}), leg=LENGTH)"
        )
    return model, servo_gearbox(model, gearbox)


def _up(base_q: np.ndarray) -> np.ndarray:
    """Return the world's vertical (n, 3) in the axes of bases at base_q (n, 7)."""
    w, x, y, z = base_q[:, 3:].T
    return np.stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)


def _tilt(base_q: np.ndarray) -> np.ndarray:
    """Return the angles (n,) [rad] between the vertical axes of bases and of the world."""
    return np.arccos(np.clip(_up(base_q)[:, 2], -1.0, 1.0))


for _name in ("Stand", "Walk", "Push"):
    gymnasium.register(
        f"featherstone_gait/{_name}-v0",
        entry_point=f"{__name__}:{_name}",
        vector_entry_point=f"{__name__}:{_name}Vector",
    )
