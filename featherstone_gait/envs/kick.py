"""An environment with an object: a robot kicks a ball into a goal.

    env = Kick("humanoid")                       # gymnasium.Env
    env = gymnasium.make("featherstone_gait/Kick-v0", robot="humanoid")

The scene has contact between the ball, the robot's links and the two posts; see `kick_scene`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np

from ..base.arguments import real
from ..base.rotation import rotation_from_quaternion
from ..dynamics import deepest_points, forward_kinematics
from ..geometry.body import body
from ..geometry.contact_choice import usual_choice
from ..model import Ground, Joint, Link, Model
from ..model.pair_contact import PairContact
from ..model.placed import Placed, SceneModel
from ..model.shapes import Box, Shape, Sphere
from ..run.session import Session
from ..run.simulate import initial_state
from ..scene.compile import CompiledScene, compile_scene
from ..scene.contact import standing_height
from ..scene.gearbox_kinds import GearboxKind
from .environment import EFFORT, RobotEnv, RobotVectorEnv, _Robots, actuated

__all__ = ["Kick", "KickVector", "kick_scene"]

ROBOT, BALL, POSTS = "robot", "ball", ("left_post", "right_post")
RADIUS, MASS = 0.05, 0.2  # of the ball [m, kg]
CLEAR = 0.03  # between the toes and the ball at the start [m]
GOAL, WIDTH = 1.0, 0.8  # distance of the goal from the robot's start, and between the middles of its posts [m]
POST = (0.04, 0.04, 0.3)  # [m]
FARTHEST_BALL = 100.0  # that a picture can show a ball [m]
PLACED = 0.01  # range of the ball's place at the start [m]
SCORED = 1.0  # reward for a goal


def kick_scene(robot: Any = "humanoid", gearbox: GearboxKind | None = None, mass: float = MASS) -> CompiledScene:
    """Compile the scene of `Kick`: a robot, a ball before its right foot, and two posts that do not move.

    Parameters
    ----------
    robot : str or Model
        Name or file of a robot with servos that stands on contact points, or a `Model`.
    gearbox : str, optional
        Gearbox model, as in `Stand`.
    mass : float
        Mass of the ball [kg].

    Returns
    -------
    CompiledScene
        Its members are called "robot" and "ball", its obstacles "left_post" and "right_post".

    Raises
    ------
    ValueError
        For a robot that does not stand, and a mass out of range.
    """
    model, kind = actuated(robot, gearbox)
    if model.base != "floating" or not model.contacts or not model.shapes:
        choice = usual_choice(model)
        load = f"load it with base='floating' and contacts={choice!r}"
        raise ValueError(
            f"{model.name}: what kicks has a floating base, contact points to stand on and collision shapes: "
            f"{load if choice else 'add such shapes to its file'}"
        )
    x, y = _before_the_right_foot(model)
    ball = body(Sphere(RADIUS), real("mass", mass, 1e-3, 1e3, "give the mass of the ball [kg]"), name=BALL)
    post = body(Box(POST), name="post", base="fixed")
    sides = zip(POSTS, (0.5 * WIDTH, -0.5 * WIDTH))
    posts = tuple(Placed(post, name, (GOAL, side, 0.5 * POST[2])) for name, side in sides)
    members = Placed(model, ROBOT), Placed(ball, position=(x, y))
    touching = (ROBOT, BALL), *((BALL, name) for name in POSTS)
    pairs = PairContact(touching, load=max(model.mass, ball.mass))  # they never rest on one contact together
    scene = SceneModel("kick", members, posts, Ground())
    return compile_scene(scene, kind, integrator="midpoint", timestep=1e-3, pairs=pairs)


def _before_the_right_foot(model: Model) -> tuple[float, float]:
    """Return where the ball lies before the foot that is farther to the right in the zero posture [m]."""
    q = np.array([0.0, 0.0, 0.0, 1.0, *np.zeros(model.nq - 4)])
    q[2] = standing_height(model, Ground(), q)
    points = deepest_points(model, forward_kinematics(model, q[None]), (0.0, 0.0, 1.0))[0]
    lateral: dict[str, list[np.ndarray]] = {point.link: [] for point in model.contacts}
    for contact, at in zip(model.contacts, points):
        lateral[contact.link].append(at)
    foot = np.array(min(lateral.values(), key=lambda own: float(np.mean(own, axis=0)[1])))
    return float(foot[:, 0].max() + RADIUS + CLEAR), float(foot[:, 1].mean())


class _Kickers(_Robots):
    """Robots with a ball each."""

    more = 8

    def compiled(self, robot: Any, gearbox: Any) -> tuple[CompiledScene, CompiledScene]:
        """Return the scene, and that of the robot alone."""
        scene = robot if isinstance(robot, CompiledScene) else kick_scene(robot, gearbox)
        if [member.name for member in scene.members] != [ROBOT, BALL] or not scene.pairs:
            raise ValueError(f"{scene.model.name}: kicking is for scenes of kick_scene; give one, or a robot")
        return scene, scene.member(ROBOT).scene

    def begin(self, draw: np.random.Generator) -> np.ndarray:
        """Draw the first state of an episode."""
        robot = self.alone.state_view(super().begin(draw))
        ball = np.array([*self.scene.member(BALL).placed.position[:2], 0.0, 1.0, 0.0, 0.0, 0.0])
        ball[:2] += draw.uniform(-PLACED, PLACED, 2)
        ball[2] = standing_height(self.scene.member(BALL).model, Ground(), ball)
        return initial_state(self.scene, {ROBOT: np.concatenate([robot.base_q, robot.q]), BALL: ball})

    def observation(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Return that of the robot, place of the ball from the base, its velocity, and the way to the goal."""
        ball, base = seen["base_q"][:, 1, :3], seen["base_q"][:, 0, :3]
        way = np.array([GOAL, 0.0]) - ball[:, :2]
        return np.hstack([super().observation(_of_robots(seen)), ball - base, seen["base_qd"][:, 1, :3], way])

    def reward(self, seen: dict[str, np.ndarray], actions: np.ndarray) -> np.ndarray:
        """Return what the ball's speed brings it nearer to the goal in a step, 1 for a goal, minus the effort."""
        effort = EFFORT * (np.clip(actions, -1.0, 1.0) ** 2).mean(axis=1)
        return self._speed(seen) * self.step_time + SCORED * self._scored(seen) - effort

    @property
    def step_time(self) -> float:
        """Time that an action is held [s]."""
        return self.ticks * self.scene.tick_steps * self.scene.timestep

    def _speed(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Return the velocity of the ball towards the middle of the goal [m/s]."""
        way = np.array([GOAL, 0.0]) - seen["base_q"][:, 1, :2]
        return (way * seen["base_qd"][:, 1, :2]).sum(axis=1) / np.maximum(np.hypot(*way.T), RADIUS)

    def _over(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        return seen["base_q"][:, 1, 0] > GOAL

    def _scored(self, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Return which balls are over the line between the posts."""
        return self._over(seen) & (np.abs(seen["base_q"][:, 1, 1]) < 0.5 * WIDTH)

    def ended(self, session: Session, seen: dict[str, np.ndarray]) -> np.ndarray:
        """Return whose ball is over the goal's line, and who has fallen."""
        return super().ended(session, seen) | self._over(seen)

    def info(self, session: Session, seen: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return that of the robot, the ball's place along x [m], and 1.0 for a goal."""
        ball = {"ball": seen["base_q"][:, 1, 0].copy(), "goal": self._scored(seen).astype(float)}
        return super().info(session, _of_robots(seen)) | ball

    def drawn_first(self) -> tuple[Model, np.ndarray]:
        """Return robot and ball as one model, in which the ball slides along the axes of the base, and its start."""
        model, last = replace(self.alone.model, source=""), self.alone.model.root  # its shapes, as the ball has
        links, joints = [*model.links], [*model.joints]
        ball = self.scene.member(BALL).model.links[0]
        for name, axis in (("along", (1.0, 0.0, 0.0)), ("across", (0.0, 1.0, 0.0)), (BALL, (0.0, 0.0, 1.0))):
            links.append(replace(ball, name=name) if name == BALL else Link(name))
            joints.append(
                Joint(f"{BALL}/{name}", "prismatic", last, name, axis=axis, lower=-FARTHEST_BALL, upper=FARTHEST_BALL)
            )
            last = name
        shape = Shape(last, Sphere(RADIUS))
        both = replace(model, links=tuple(links), joints=tuple(joints), shapes=(*model.shapes, shape))
        place = np.array([*self.scene.member(BALL).placed.position[:2], RADIUS]) - self.standing[:3]
        return both, np.concatenate([self.standing, place])[None]

    def drawn(self, seen: dict[str, np.ndarray], robot: int) -> np.ndarray:
        """Return the positions (nq,) to draw of a robot and its ball."""
        base, ball = seen["base_q"][robot]
        turn = rotation_from_quaternion(base[3:])
        return np.concatenate([base, seen["q"][robot], (ball[:3] - base[:3]) @ turn])


def _of_robots(seen: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return what is seen of the robots alone."""
    return seen | {name: seen[name][:, 0] for name in ("base_q", "base_qd")}


class Kick(RobotEnv):
    """Task: kick a ball into a goal 1 m ahead, between two posts; see `RobotEnv`.

    `robot` is a robot, or a scene that `kick_scene` made.  Observations are (2 n + 18,): those of `RobotEnv`, then the
    place of the ball from the base (3,) [m], its velocity (3,) [m/s] and its way to the middle of the goal (2,) [m],
    in world axes.  The reward of a step is what the ball's speed brings it nearer to the goal in the step [m], 1 more
    for a goal, minus 0.01 of the mean square of the action.  The episode ends when the ball is over the goal's line or
    the robot has fallen.  Info has also the ball's place along x [m], and "goal": 1 where it went in.
    """

    _kind = _Kickers


class KickVector(RobotVectorEnv):
    """Task of many robots: kick a ball into a goal; see `Kick` and `RobotVectorEnv`."""

    _kind = _Kickers


gymnasium.register(
    "featherstone_gait/Kick-v0", entry_point=f"{__name__}:Kick", vector_entry_point=f"{__name__}:KickVector"
)
