"""Judge a policy: let it drive a robot in many worlds, all in the lanes of a session, and measure."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import instance, real, vector, whole
from ..base.brief import some
from ..base.files import FilePath
from ..core.compile.lanes import WIDTH
from ..model import TORQUE_LAWS, Ground, Model, Servo
from ..robot_file.servos import load_servo, servo_names
from ..run.program import with_ticks
from ..run.session import Session
from ..run.simulate import standing_state
from ..run.status import Status
from ..run.trajectory import Trajectory
from ..scene.actuator import GearboxKind, servo_gearbox
from ..scene.compile import CompiledScene, compile_scene
from .description import PolicyDescription
from .doubts import Drawn, draw_worlds
from .floors import rest
from .judgment import Agreement, Judgment
from .meter import Meter, measured_channels
from .observation import Observer, channels_of
from .policy import Policy, load_policy

SAMPLE = 5e-3  # longest time between two measurements of torques and currents [s]
MOST_WORLDS = 10**5
WALKING_SHARE = 0.1  # share of the commanded way from which on a robot walks
WHOLE = 1e-6  # tolerance of ticks in a step of the policy
STIFFER = 0.2  # share by which servos may hold more or less stiffly without a note
RECORD = ("q", "base_q", "contact_force")
HARD = 1e-4  # penetration of the floor under a robot that stands, on wood or tiles with soles of plastic or rubber [m]
SPEED, ROOM = 0.3, 1.0  # [m/s], [m]: a rough ground reaches as far as a robot of this speed gets, and this further
AGAIN = 64  # worlds that are simulated again at half the step
ELECTRICAL = "from the supply, without what flows back"
MECHANICAL = "mechanical and positive alone: these servos have no motor, so what a supply gives is not known"


def judge(
    policy: Any,
    robot: CompiledScene | Model,
    worlds: int = 200,
    seconds: float = 10.0,
    command: ArrayLike = (0.1, 0.0, 0.0),
    seed: int = 0,
    *,
    description: FilePath | PolicyDescription | None = None,
    doubts: FilePath | Mapping[str, Any] | None = None,
    again: int = AGAIN,
    least: float = WALKING_SHARE,
    threads: int | None = None,
) -> Judgment:
    """Judge a policy in many worlds: whether it walks, for how many joules, and what it breaks on.

    Parameters
    ----------
    policy
        What `load_policy` takes: an ONNX file, a gait, a function of all worlds' observations, a compiled controller.
    robot
        A compiled scene with ground and servos, or a robot, which gets a hard and level floor (a penetration of 0.1 mm
        under its weight) and midpoint steps of 1 ms.
    worlds
        Number of worlds.
    seconds
        Time in each world [s].
    command
        Velocity ahead and to the left [m/s] and about the vertical [rad/s].
    seed
        Seed of all that is drawn.
    description
        What the policy observes and drives, as `load_policy` takes it.
    doubts
        What differs between the worlds, a TOML file or its tables; None: `worlds.toml` of this package.
    again
        How many of the worlds are simulated again at half the step.
    least
        Share of the commanded way from which on an upright robot walks; less is "stands".
    threads
        None: one for each core.

    Returns
    -------
    Judgment
        The record.

    Raises
    ------
    ValueError
        For what does not fit, named, and for actions that are not finite.
    """
    begun, worked = time.perf_counter(), time.process_time()
    scene = _scene(robot)
    acting = load_policy(policy, scene.model, description)
    count = whole("worlds", worlds, 1, "200 are usual", MOST_WORLDS)
    end = real("seconds", seconds, 1e-2, 1e4, "10 is usual")
    asked = vector("command", command, 3, "[m/s, m/s, rad/s]")
    seed = whole("seed", seed, 0, "it is the seed of the draws")
    again = min(whole("again", again, 0, "0 leaves it out", MOST_WORLDS), count)
    least = real("least", least, 0.0, 1.0, "it is a share of the commanded way")
    reach = max(float(np.hypot(asked[0], asked[1])), SPEED) * end + ROOM
    drawn = draw_worlds(scene, count, seed, doubts, reach)
    found = _roll(acting, scene, drawn, end, asked, threads)
    verdicts = verdicts_of(found, acting, asked, end, least)
    agreement = None
    if again and not scene.adaptive:
        other = scene.recompiled(timestep=0.5 * scene.timestep)
        fine = _roll(acting, other, draw_worlds(other, again, seed, doubts, reach), end, asked, threads)
        agreement = _agreement(verdicts[:again], found, verdicts_of(fine, acting, asked, end, least), fine)
    settings = {
        "command": asked.tolist(), "seconds": end, "seed": seed, "least": least, "integrator": scene.integrator,
        "timestep": scene.timestep, "rate": found.rate, "energy": ELECTRICAL if scene.sampled else MECHANICAL,
    }  # fmt: skip
    took = {"all": time.perf_counter() - begun, "runs": found.seconds, "policy": found.policy_seconds}
    took["processors"] = time.process_time() - worked

    def runs(who: Sequence[int]) -> list[Trajectory]:
        full = [*who, *[who[0]] * (-len(who) % WIDTH)]  # as all: in full vectors
        return _roll(acting, scene, drawn.only(scene, full), end, asked, threads, RECORD).runs[: len(who)]

    return Judgment(
        acting.name, scene.model.name, _servo_name(scene), settings, verdicts, found.worlds, found.joints,
        scene.model.joint_names, drawn.factors, agreement, drawn.left_out, _note(acting, scene.model), found.why, took,
        scene, runs, lambda who: drawn.worlds.scenes(scene, who),
    )  # fmt: skip


def scene_of(model: Model, gearbox: GearboxKind | None = None, timestep: float = 1e-3) -> CompiledScene:
    """Return a robot on a hard and level floor, with midpoint steps [s]; gearbox None: the usual one."""
    return compile_scene(model, servo_gearbox(model, gearbox), Ground(penetration=HARD), "midpoint", timestep)


def _scene(robot: CompiledScene | Model) -> CompiledScene:
    """Return the scene to judge in; raise ValueError for what does not stand on ground by servos."""
    instance("robot", robot, (CompiledScene, Model), "give what load_robot or compile_scene returns")
    if isinstance(robot, Model):
        robot = scene_of(robot)
    model = robot.model
    if model.base != "floating" or robot.ground is None or robot.gearbox is None or robot.members:
        raise ValueError(
            f"{model.name}: a judgment needs one robot with a floating base, ground and servos; load it with "
            "base='floating', and compile it with a ground and a gearbox"
        )
    return robot


def _servo_name(scene: CompiledScene) -> str:
    """Name the servos of a scene: presets of the package, of others law and gain."""
    presets = {load_servo(name): name for name in servo_names()}
    kinds = dict.fromkeys(scene.model.servos.values())
    texts = [presets.get(one) or f"{one.controller.law} (Kp {one.controller.Kp:.4g})" for one in kinds]
    return some(dict.fromkeys(texts), 3)


def _note(policy: Policy, model: Model) -> str:
    """Say what the file keeps references to, and how much stiffer servos hold than those of the policy's training."""
    asked, limits = policy.description.stiffness, policy.description.action.limits
    narrower = []
    for name in policy.description.joints:
        joint, (low, high) = model.joint(name), model.references.get(name, (-math.inf, math.inf))
        if (low, high) != (-math.inf, math.inf) and not (limits and low <= joint.lower and joint.upper <= high):
            narrower.append(name)
    said = [f"the robot's file keeps references of {some(narrower, 3)} within its control ranges"] if narrower else []
    servos = [model.servos.get(name) for name in policy.description.joints if asked]
    ratios = [stiffness(servo) / b for servo, b in zip(servos, asked) if servo and b]
    middle = float(np.median(ratios)) if ratios else 1.0
    if abs(middle - 1.0) >= STIFFER:
        said += [f"they hold {middle:.2g} times as stiffly as those of the policy's description: another gain of them?"]
    return "; ".join(said)


def stiffness(servo: Servo) -> float:
    """Return the torque of a servo by the error of its angle [N m/rad]."""
    law = servo.controller
    return law.Kp * (1.0 if law.law in TORQUE_LAWS else servo.motor_constant * servo.gearbox.ratio / servo.resistance)


class Rolled(NamedTuple):
    """Results of all worlds."""

    fell: np.ndarray  # (n,) bool
    unsound: np.ndarray  # (n,) bool, of runs that ended otherwise than by a fall
    why: str  # the message of the first of these
    worlds: dict[str, np.ndarray]
    joints: dict[str, np.ndarray]
    rate: float  # [Hz]
    seconds: float
    policy_seconds: float
    runs: list[Trajectory]


class Timing(NamedTuple):
    """How often things happen, in ticks of the session."""

    period: int  # ticks of a step of the policy
    ticks: int  # between two samples
    samples: int  # in a step of the policy
    steps: int  # of the policy, until the end


def timing_of(description: PolicyDescription, tick: float, end: float) -> Timing:
    """Return how often things happen; raise ValueError for a rate that does not fit the servos' ticks."""
    exact = 1.0 if math.isinf(description.rate) else 1.0 / (description.rate * tick)
    period = max(1, round(exact))
    if abs(period - exact) > WHOLE * exact:
        raise ValueError(
            f"{description.name}: rate is {description.rate:g} Hz, and the servos have a tick of {1e3 * tick:g} ms: a "
            f"step of the policy is {exact:.4g} of them; give a rate of {1.0 / (period * tick):.6g} Hz, or the servos "
            "another period"
        )
    longest = max(1, int(SAMPLE / tick + WHOLE))
    ticks = max(k for k in range(1, min(longest, period) + 1) if period % k == 0)
    return Timing(period, ticks, period // ticks, max(1, round(end / (period * tick))))


class _Actuator:
    """Turn actions into references of the servos (n, joints), which arrive late, or not at all."""

    def __init__(self, policy: Policy, scene: CompiledScene, drawn: Drawn, timing: Timing, tick: float) -> None:
        own, model = policy.description.action, scene.model
        names, n = policy.description.joints, len(drawn.delay)
        self.columns = np.array([model.joint_names.index(name) for name in names], int)
        low: np.ndarray = np.array([one.lower for one in model.moving_joints])[self.columns]
        high: np.ndarray = np.array([one.upper for one in model.moving_joints])[self.columns]
        free = np.full(len(names), np.inf)
        self.low, self.high = (low, high) if own.limits else (-free, free)
        self.low, self.high = np.maximum(self.low, own.lower), np.minimum(self.high, own.upper)
        least, most = np.array([model.references.get(name, (-np.inf, np.inf)) for name in names]).reshape(-1, 2).T
        self.low, self.high = np.clip((self.low, self.high), least, most)
        self.action, self.pose, self.offset = own, np.array(policy.description.pose), drawn.sensing.offset
        self.most = own.max_speed * timing.period * tick
        self.rest = posture_of(policy, scene)
        self.targets = np.broadcast_to(self.rest[self.columns], (n, len(names))).copy()
        self._timing, self._robots = timing, np.arange(n)
        self._late = np.floor(drawn.delay / (timing.ticks * tick) + WHOLE).astype(int)  # in samples
        self._kept = np.repeat(self.targets[None], int(self._late.max(initial=0)) // timing.samples + 2, axis=0)

    def send(self, step: int, actions: np.ndarray, lost: np.ndarray) -> None:
        """Send the references of a step of the policy; lost (n,) bool: those that do not arrive."""
        wanted = self.pose + self.action.scale * np.clip(actions, -self.action.clip, self.action.clip)
        wanted = np.clip(wanted, self.low, self.high)
        self.targets = np.clip(wanted, self.targets - self.most, self.targets + self.most)
        before = self._kept[(step - 1) % len(self._kept)]
        self._kept[step % len(self._kept)] = np.where(lost[:, None], before, self.targets)

    def references(self, sample: int) -> np.ndarray:
        """Return what the servos are given (n, joints) at a sample since the start, in the joints' own zeros."""
        sent = np.maximum((sample - self._late) // self._timing.samples, -1)
        found = np.broadcast_to(self.rest, (len(sent), len(self.rest))).copy()
        found[:, self.columns] = self._kept[sent % len(self._kept), self._robots]
        return found - self.offset


def posture_of(policy: Policy, scene: CompiledScene) -> np.ndarray:
    """Return the joints' angles (joints,) of a robot that stands in the pose of a policy, others as it stands."""
    model, names = scene.model, policy.description.joints
    found = model.single_positions(rest(model))
    joints = [model.joint_names.index(name) for name in names]
    limits = [model.moving_joints[k] for k in joints]
    found[joints] = np.clip(policy.description.pose, [one.lower for one in limits], [one.upper for one in limits])
    return found


def _roll(
    policy: Policy, scene: CompiledScene, drawn: Drawn, end: float, command: np.ndarray, threads: int | None = None,
    record: tuple[str, ...] = (),
) -> Rolled:  # fmt: skip
    """Let a policy drive all worlds here; record: channels of the runs that are kept."""
    begun = time.perf_counter()
    observed = dict.fromkeys((*channels_of(policy.description), *measured_channels(scene)))
    controller = policy.controller_in(scene)
    ticked = with_ticks(scene, controller)
    timing = timing_of(policy.description, ticked.tick_steps * ticked.timestep, end)
    with Session(
        scene, observe=observed, worlds=drawn.worlds, controller=controller, threads=threads, record=record
    ) as session:
        found = rolled(policy, session, drawn, timing, command)
        runs = [session.trajectory(k) for k in range(session.n)] if record else []
        return found._replace(seconds=time.perf_counter() - begun, runs=runs)


def rolled(policy: Policy, robots: Session, drawn: Drawn, timing: Timing, command: np.ndarray) -> Rolled:
    """Let a policy drive all worlds until they end or have fallen; robots: a session, or another engine's like it."""
    begun, thinking, n = time.perf_counter(), 0.0, len(drawn.delay)
    period, sample = timing.period * robots.tick, timing.ticks * robots.tick
    act = _Actuator(policy, robots.scene, drawn, timing, robots.tick)
    starts = [standing_state(one, act.rest - off, True) for one, off in zip(robots.scenes, act.offset)]
    seen = robots.reset(state=starts)
    observer = Observer(policy.description, robots.scene, drawn, period, sample)
    observer.sample(seen)
    meter = Meter(robots, seen, _direction(command), sample)
    actions = np.zeros((n, len(policy.description.joints)))
    lost = drawn.uniform("lost", timing.steps) < drawn.sensing.numbers.lost
    kicks = _kicks(drawn, timing, robots.tick)
    for step in range(timing.steps):
        if kicks is not None and kicks[:, step].any():
            speeds, who = seen["base_qd"].copy(), kicks[:, step].any(axis=1) & robots.active
            speeds[:, :2] += kicks[:, step]
            seen = robots.set_state("base_qd", speeds, who) if who.any() else seen
        now = time.perf_counter()
        actions = policy.actions(observer.look(seen, step, actions, act.targets, command), step * period)
        thinking += time.perf_counter() - now
        act.send(step, actions, lost[:, step])
        for k in range(timing.samples):
            moving = robots.active
            seen = robots.step(act.references(step * timing.samples + k), timing.ticks)
            meter.take(seen, moving)
            observer.sample(seen)
        if not robots.active.any():
            break
    worlds, joints = meter.result()
    fell = np.array(robots.status) == Status.FELL
    unsound, said = ~robots.active & ~fell, robots.messages
    why = said[int(unsound.argmax())] if unsound.any() else ""
    return Rolled(fell, unsound, why, worlds, joints, 1.0 / period, time.perf_counter() - begun, thinking, [])


def _direction(command: np.ndarray) -> np.ndarray:
    """Return the direction (2,) of the way that is commanded, ahead if there is none."""
    size = math.sqrt(command[0] ** 2 + command[1] ** 2)
    return command[:2] / size if size else np.array([1.0, 0.0])


def _kicks(drawn: Drawn, timing: Timing, tick: float) -> np.ndarray | None:
    """Draw changes of velocity (n, steps, 2) by pushes [m/s], most of them zero; None of none."""
    numbers = drawn.sensing.numbers
    if not numbers.speed:
        return None
    chance, turn = np.moveaxis(drawn.uniform("pushes", timing.steps, 2), 2, 0)
    pushed = (chance < timing.period * tick / numbers.every) & (np.arange(timing.steps) > 0)
    angle = 2.0 * np.pi * turn
    return numbers.speed * pushed[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def verdicts_of(found: Rolled, policy: Policy, command: np.ndarray, end: float, least: float) -> np.ndarray:
    """Return "walks", "stands", "falls" or "unknown" of each world, the last where the simulation is not to be trusted.

    Without a command, as of a gait, the way of the median world that does not fall is what is asked.
    """
    way, upright = found.worlds["way"], ~(found.fell | found.unsound)
    asked, did = float(np.hypot(command[0], command[1])) * end, way
    if not any(block.name == "command" for block in policy.description.observation):
        asked = float(np.median(way[upright])) if upright.any() else 0.0
    elif not asked:
        asked, did = abs(float(command[2])) * end, np.sign(command[2]) * found.worlds["turned"]
    walks = upright & (did >= least * asked)
    return np.where(walks, "walks", np.where(upright, "stands", np.where(found.fell, "falls", "unknown")))


def _agreement(verdicts: np.ndarray, found: Rolled, others: np.ndarray, fine: Rolled) -> Agreement:
    """Compare the first worlds with the same ones at half the step."""
    n = len(others)
    both = (verdicts == "walks") & (others == "walks")
    costs, finer = found.worlds["energy_per_way"][:n][both], fine.worlds["energy_per_way"][both]
    difference = float(np.median(np.abs(costs / finer - 1.0))) if both.any() else math.nan
    return Agreement(n, int((verdicts == others).sum()), difference)
