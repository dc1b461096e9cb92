"""The first gait of a search: that of the plain plan, or of the cheapest of many plans.

    cost = first_gait(compile_scene(load_robot("humanoid", locked="simplified"), "mipsd", Ground(), "midpoint", 1e-3))
    result = optimize_gait(in_worlds(cost, 8))

A plan has six numbers besides its timing (`Box`): step length and time, lift of the sole, height of the center of mass,
distance of the feet, share of double support.  `cheapest_plan` spreads plans evenly over a box of them, goes on around
the best in smaller boxes, and measures the gait of each as a search measures its candidates: in several worlds at
once.  A plan that falls in one of them has an infinite cost, as has one that the robot cannot follow: the whole stride,
not only its poses, must meet the joint limits and the no-load speeds of joints and servos.

The points are those of an additive recurrence, x_k = frac(x_0 + k a), a_i = r^-i with r^(d+1) = r + 1, which fills a
box of d dimensions evenly at any length (M. Roberts, "The unreasonable effectiveness of quasirandom sequences" (2018)).
The result depends on seed and settings alone.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from types import NoneType
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from tqdm import tqdm

from ..base.arguments import instance, listed, one_of, shown, truth, whole
from ..base.brief import brief
from ..base.progress import progress_bar
from ..dynamics.tree import GRAVITY
from ..identification.curve import torque_speed
from ..model import Model, Servo
from ..scene.compile import CompiledScene
from ..scene.contact import standing_posture
from .cost import WalkingCost
from .cost_in_worlds import CostInWorlds, variations
from .gait import TICK, Gait, GaitFit, fit_gait, mirror_of
from .generic_servo import HEIGHT, LEG
from .inverse_kinematics import nearest
from .kinematics import center_of_mass, joint_limits
from .one_leg import TORQUE_SHARE, least_servo, load_on_one_leg
from .plan import BIOLOID_WALK, Plan, WalkSettings, downward, walking_plan
from .stance import Size, default_posture, first_base, size_of, soles_of

PlanKind: TypeAlias = Literal["cheapest", "plain"]
States: TypeAlias = Literal["stride", "step"]
Searched: TypeAlias = Callable[[WalkingCost], Any]
N_POSES = 4  # the paper's four states
COUNT = (32, 16, 16, 8)  # plans over the whole box, and in each smaller one
SMALLER = (0.4, 0.2, 0.1)  # these boxes, as shares of the whole one
DRAWN = 4  # points for each plan: most of a box is out of reach of the legs
WORLDS = 8
PLAIN = (0.123, 2.225, 0.123, 0.0865, 1.219, 0.2)  # BIOLOID_WALK in the units of `Box`
LIKE_BIOLOID = 0.1  # relative difference in height up to which a robot takes the plain plan unscaled
RESERVE = 0.5  # share of the stall torque on one leg up to which all servos of the package walk a plan
FASTER = 1.0  # share of the no-load speed that references may reach
SAMPLE, PREVIEW, JERKS = 0.02, 1.2, 2.5e-8  # of the plans: T [s], preview [s] and R [s^6/m^2] of the Bioloid's
BEYOND = "the joint limits are violated between the poses"
STEPS, ACCURATE = 15, 1e-5  # number of steps; tolerance of the center of mass along its path [m]
ROUNDS, NEAR = 6, 2e-3  # iterations that place the trunk; tolerance of the soles [m and rad]
MOST_PLANS = 10**5


@dataclass(frozen=True)
class Box:
    """Ranges of the plans that are tried, relative to the robot's size.

    Lengths are in leg lengths l, from the first joint of a straight leg to its sole; times in sqrt(l / g), with g the
    strength of gravity: for robots that differ in size alone the same numbers are the same walk.  The ranges lie about
    `BIOLOID_WALK`, the first plan that is tried: slower walks mostly fall without feedback.

    Attributes
    ----------
    step_length, step_time, lift : tuple of float
        As of `WalkSettings`.
    sinking : tuple of float
        How much lower the center of mass is than with all joints at zero.
    half_width : tuple of float
        As of `WalkSettings`, relative to that of the feet with all joints at zero.
    double_support : tuple of float
        Share of a step.
    """

    step_length: tuple[float, float] = (0.1, 0.25)
    step_time: tuple[float, float] = (1.5, 2.4)
    lift: tuple[float, float] = (0.05, 0.14)
    sinking: tuple[float, float] = (0.05, 0.13)
    half_width: tuple[float, float] = (1.0, 1.35)
    double_support: tuple[float, float] = (0.1, 0.4)

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isinstance(value, tuple) and len(value) == 2 and 0.0 < value[0] <= value[1] < math.inf):
                raise ValueError(f"box: {field.name} = {shown(value)} must be two numbers > 0, the lower first")


SLOW = Box(step_time=(2.2, 3.6), lift=(0.03, 0.1), half_width=(0.8, 1.2))  # for weak servos
SLOWEST = np.array([0.0, 1.0, 0.0, 0.5, 0.0, 0.0])  # of its unit box; most others ask for twice the joint speeds
NUMBERS = (
    "numbers of a walk that is known to work: step_length, step_time, lift, com_height, half_width, double_support "
    "(on the command line --walk NAME=NUMBER,...)"
)
GENTLE = (  # in the units of `Box`: of 61 plans tried with 21 servos one of these walks with all but one that walk
    (0.163, 3.545, 0.082, 0.117, 1.139, 0.17),
    (0.131, 3.112, 0.062, 0.104, 1.152, 0.266),
    (0.118, 2.737, 0.095, 0.114, 1.042, 0.344),
    (0.1, 3.6, 0.03, 0.09, 0.8, 0.1),
)


class Trial(NamedTuple):
    """A plan that was tried."""

    walk: WalkSettings
    cost: float  # that the search minimizes [J/m]; infinite if it does not walk
    status: str  # "ok", or why it does not walk


_Tried: TypeAlias = tuple[np.ndarray, Trial]  # with its point (6,) of the unit box


@dataclass(frozen=True, eq=False)
class CheapestPlan:
    """The cheapest plan, and the plans that were tried.

    Attributes
    ----------
    plan : Plan
        The plan.
    fit : GaitFit
        The gait that was fitted to it.
    cost : WalkingCost
        The cost of the gait, with its start.
    value : float
        The cost that the search minimized [J/m].
    trials : tuple of Trial
        All plans that were tried.
    """

    plan: Plan
    fit: GaitFit
    cost: WalkingCost
    value: float
    trials: tuple[Trial, ...]

    __repr__ = brief

    @property
    def gait(self) -> Gait:
        """The gait of the plan."""
        return self.fit.gait


def first_gait(
    scene: CompiledScene,
    plan: PlanKind = "cheapest",
    states: States = "step",
    *,
    searched: Searched | None = None,
    seed: int = 0,
    progress: bool = False,
    **walk: Any,
) -> WalkingCost:
    """Plan the first gait of a biped and return its cost, for `optimize_gait` and `in_worlds`.

    Parameters
    ----------
    scene : CompiledScene
        The robot on its ground.
    plan : {"cheapest", "plain"}
        "plain" is ``BIOLOID_WALK | walk``, planned at 10 ms, and for a robot of another size the same walk by dynamic
        similarity, at 20 ms; "cheapest" is the result of `cheapest_plan`.
    states : {"step", "stride"}
        Whether the four poses are those of a stride, or of a step that the other leg mirrors.
    searched, seed, progress
        As of `cheapest_plan`.
    **walk
        Settings of `WalkSettings` that are fixed.

    Returns
    -------
    WalkingCost
        The cost, with the first gait.

    Raises
    ------
    ValueError
        For a robot that is no biped, or cannot take these steps, and for states of a step where left and right are no
        mirror images.
    """
    instance("scene", scene, CompiledScene, "give what compile_scene returns")
    one_of("plan", plan, get_args(PlanKind))
    one_of("states", states, get_args(States))
    if plan == "cheapest":
        return cheapest_plan(scene, states, searched=searched, seed=seed, progress=progress, **walk).cost
    model, g = scene.model, downward(scene.gravity)
    if abs(standing_posture(model)[0] / HEIGHT - 1.0) < LIKE_BIOLOID:
        plain = BIOLOID_WALK | {"g": g}
    else:
        plain = asdict(_walk(PLAIN, size_of(model, soles_of(model)), g, {}))
    planned = walking_plan(model, **(plain | walk))
    return WalkingCost(scene, fit_states(model, planned, states).gait, planned.start_up(1))


def cheapest_plan(
    scene: CompiledScene,
    states: States = "step",
    *,
    box: Box | None = None,
    count: Sequence[int] = COUNT,
    searched: Searched | None = None,
    seed: int = 0,
    progress: bool = False,
    **held: Any,
) -> CheapestPlan:
    """Search for the plan whose gait costs least, within joint and speed limits.

    Parameters
    ----------
    scene : CompiledScene
        The robot on its ground.
    states : {"step", "stride"}
        As of `first_gait`.
    box : Box, optional
        Ranges of the plans; by default `Box()` and, if nothing there walks, slower steps with less lift.
    count : sequence of int
        Number of plans in the whole box, besides the plain one, and in each of the smaller boxes around the best.
    searched : callable, optional
        Makes the cost that is minimized from a `WalkingCost`; by default that in eight worlds (`in_worlds`).
    seed : int
        Seed of the plans.
    progress : bool
        Whether to show a progress bar.
    **held
        Settings of `WalkSettings` that are fixed.

    Returns
    -------
    CheapestPlan
        The plan, its gait and all trials.

    Raises
    ------
    ValueError
        If no plan walks, with the most common reason and what to do; before any is tried, if a joint cannot follow the
        slowest of them without load.
    """
    instance("scene", scene, CompiledScene, "give what compile_scene returns")
    one_of("states", states, get_args(States))
    instance("box", box, (Box, NoneType), "give Box(...), or None")
    seed, progress = whole("seed", seed, 0, "any number will do"), truth("progress", progress)
    if searched is not None and not callable(searched):
        raise TypeError(f"searched is {shown(searched)}; give a function of a WalkingCost, or None")
    given = listed("count", count, "give a list of numbers of plans, the first of the whole box")
    counts = [whole("count", n, 1, "give how many plans to try", MOST_PLANS) for n in given]
    if not counts:
        raise ValueError("count is empty; give how many plans to try in the whole box")
    if len(counts) > 1 + len(SMALLER):
        raise ValueError(f"count has {len(counts)} numbers; give one, and up to {len(SMALLER)} for smaller boxes")
    points, trials = _spread(DRAWN * max(counts), len(PLAIN), seed), []
    searched = searched or _in_the_same_worlds(scene)
    if box is None:
        _Search(scene, states, SLOW, searched, held).check_speed()
    for where in (Box(), SLOW) if box is None else (box,):
        search = _Search(scene, states, where, searched, held)
        plain = box is not None or where is not SLOW
        with progress_bar(desc="plans", total=sum(counts) + plain, unit="plan", progress=progress) as bar:
            tried = search.tried(points, counts, plain, bar)
        trials += [one for _, one in tried]
        best = min((one for _, one in tried), key=lambda one: one.cost, default=None)
        if best is not None and math.isfinite(best.cost):
            plan, fit, cost = search.planned(best.walk)
            return CheapestPlan(plan, fit, cost, best.cost, tuple(trials))
    kinds = [re.sub(r"\d+(\.\d+)?", "0", trial.status) for trial in trials]  # the same, but for numbers
    most = max(dict.fromkeys(kinds), key=kinds.count)
    fixed = ", ".join(f"{name} {shown(value)}" for name, value in held.items())
    trial = trials[kinds.index(most)]
    raise ValueError(
        f"{scene.model.name}: none of {len(trials)} planned walks{f' with {fixed}' if fixed else ''} can be walked, "
        f"{kinds.count(most)} of them for this: {trial.status}; give {search.other_servos(trial)}{NUMBERS}"
    )


def check_speed(scene: CompiledScene, states: States = "step", **held: Any) -> None:
    """Raise ValueError if a joint cannot follow the slowest plan of `cheapest_plan` without load; arguments as there.

    Where that plan is out of reach nothing is checked.
    """
    _Search(scene, states, SLOW, lambda cost: cost, held).check_speed()


def gentle_plan(scene: CompiledScene, states: States = "step", **held: Any) -> CheapestPlan:
    """Find out quickly whether servos carry a robot at all: by four plans of slow steps, in eight worlds.

    They ask for little torque and speed.  Servos with which they all fall may still walk another plan.

    Parameters
    ----------
    scene, states, **held
        As of `cheapest_plan`.

    Returns
    -------
    CheapestPlan
        The cheapest of the plans that walk.

    Raises
    ------
    ValueError
        If none walks, with the torque and the speed that they take, and the least servo of the package with a reserve.
    """
    search, trials, planned = _Search(scene, states, SLOW, _in_the_same_worlds(scene), held), [], []
    measured: list[Trial] = []
    for numbers in GENTLE:
        walk = _walk(numbers, search.size, search.g, held)
        try:
            one = search.planned(walk)
        except ValueError as error:
            trials.append(Trial(walk, math.inf, str(error)))
            continue
        trials.append(search.measured(walk, *one[1:]))
        measured.append(trials[-1])
        planned.append((trials[-1].cost, *one))
    if not planned:
        raise ValueError(f"{scene.model.name}: {trials[0].status}")
    value, plan, fit, cost = min(planned, key=lambda one: one[0])
    if math.isfinite(value):
        return CheapestPlan(plan, fit, cost, value, tuple(trials))
    strong = next((trial for trial in measured if not search.other_servos(trial)), None)
    if strong is not None:
        raise ValueError(
            f"{scene.model.name}: none of {len(trials)} plans of slow steps walks, though servos have twice the torque "
            f"and speed that one takes: {strong.status}; give {NUMBERS}"
        )
    raise ValueError(_why_all_fall(search, [(one[1], one[2].gait) for one in planned]))


def _why_all_fall(search: _Search, planned: Sequence[tuple[Plan, Gait]]) -> str:
    """Say what the least demanding of some plans that all fall take of the servos, and what servo has a reserve."""
    model = search.scene.model
    loads = [load for plan, _ in planned if (load := load_on_one_leg(model, plan)) is not None]
    asked = min((search.asked(gait) for _, gait in planned), key=lambda speeds: (speeds / search.speeds).max())
    joint = int((asked / search.speeds).argmax())
    why = (
        f"{model.name}: none of {len(planned)} plans of slow steps walks with these servos: {model.joint_names[joint]} "
        f"turns at {asked[joint]:.2g} rad/s, without load it reaches {search.speeds[joint]:.2g}"
    )
    if not loads:
        return why
    load = min(loads, key=lambda load: load.share)
    return f"{why}; {load}; with twice that, {least_servo(load.largest / RESERVE, float(asked.max()))}"


def _in_the_same_worlds(scene: CompiledScene) -> Searched:
    """Do as `in_worlds`, for costs that differ in gait and start alone."""
    worlds, offsets = variations(scene, WORLDS)
    scenes = worlds.scenes(scene)
    return lambda cost: CostInWorlds(cost, scenes, offsets)


def fit_states(model: Model, plan: Plan, states: States) -> GaitFit:
    """Fit four poses of a stride, or of a step that the other leg mirrors, to a plan, clipped to the joint limits."""
    mirrored = states == "step"
    mirror = mirror_of(model) if mirrored else None
    fit = fit_gait(plan.stride(), 2 * N_POSES if mirrored else N_POSES, mirror=mirror)
    return replace(fit, gait=replace(fit.gait, poses=np.clip(fit.gait.poses, *joint_limits(model))))


def speed_limits(model: Model) -> np.ndarray:
    """Return the largest speeds of the joints (nj,) [rad/s]: their own limits and the no-load speeds of the servos."""
    powered = [servo for servo in dict.fromkeys(model.servos.values()) if servo.voltage_limit > 0.0]
    alone: dict[Servo | None, float] = {servo: torque_speed(servo).no_load_speed for servo in powered}
    joints = model.moving_joints
    return np.array([min(joint.velocity, alone.get(model.servos.get(joint.name), math.inf)) for joint in joints])


class _Search:
    """Plans at points of the unit box."""

    def __init__(
        self, scene: CompiledScene, states: States, box: Box, searched: Searched, held: dict[str, Any]
    ) -> None:
        model = scene.model
        self.scene, self.states, self.searched, self.held = scene, states, searched, held
        self.g = downward(scene.gravity)
        self.speeds = speed_limits(model)
        self.limits = joint_limits(model)
        self.low, self.high = np.array([getattr(box, field.name) for field in fields(box)]).T
        self.soles = soles_of(model)
        self.size = size_of(model, self.soles)
        if states == "step":
            mirror_of(model)  # raises what no trial is to swallow

    def walk(self, point: np.ndarray) -> WalkSettings:
        """Return the walk at a point of the unit box."""
        numbers = (self.low + point * (self.high - self.low)).tolist()
        return _walk(numbers, self.size, self.g, self.held)

    def tried(self, points: np.ndarray, counts: Sequence[int], plain: bool, bar: tqdm) -> list[_Tried]:
        """Try plans at points (n, 6) of the unit box and of smaller boxes around the best, after the plain plan."""
        first = (PLAIN - self.low) / np.where(self.high > self.low, self.high - self.low, 1.0)  # of the plain plan
        middle, tried = np.full(len(PLAIN), 0.5), [self.attempt(first)] if plain else []
        bar.update(len(tried))
        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            for n, share in zip(counts, (1.0, *SMALLER)):
                where = np.clip(middle + share * (points - 0.5), 0.0, 1.0)
                for one in pool.map(self.attempt, where[self.within_reach(where)][:n]):
                    tried.append(one)
                    bar.update()
                if not tried:  # nothing is within reach
                    break
                middle = min(tried, key=lambda one: one[1].cost)[0]
        return tried

    def within_reach(self, points: np.ndarray) -> np.ndarray:
        """Check whether the legs reach the soles (n,) at five moments of a step, without sway.

        This is a hundred times as fast as planning, and right for nine plans of ten.
        """
        n = len(points)
        walks = [self.walk(point) for point in points]
        step, lift, height, width = np.array([(w.step_length, w.lift, w.com_height, w.half_width) for w in walks]).T
        s = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
        feet = np.zeros((n, len(s), 2, 3))
        feet[..., 0, 1], feet[..., 1, 1] = width[:, None], -width[:, None]
        feet[..., 1, 0] = step[:, None] * (2.0 * s * s * (3.0 - 2.0 * s) - 1.0)
        feet[..., 1, 2] = lift[:, None] * np.sqrt(4.0 * s * (1.0 - s))
        com = np.zeros((n, len(s), 3))
        com[..., 0], com[..., 2] = step[:, None] * (s - 0.5), height[:, None]
        reached = self._reached(feet.reshape(-1, 2, 3), com.reshape(-1, 3)).reshape(n, -1)
        return np.asarray(reached.all(axis=1))

    def _reached(self, feet: np.ndarray, com: np.ndarray) -> np.ndarray:
        """Check whether the robot can stand (m,) with its soles at `feet` (m, 2, 3) and its center of mass at `com`."""
        model = self.scene.model
        angles = np.tile(default_posture(model, self.soles), (len(com), 1))
        base = first_base(model, self.soles, angles[0], com)
        for _ in range(ROUNDS):
            missed = np.zeros(len(com))
            for k, sole in enumerate(self.soles):
                angles, miss = nearest(
                    model, sole.link, feet[:, k] - base, point=sole.middle, rotation=sole.rotation,
                    joints=sole.joints, start=angles, tolerance=NEAR, iterations=8,
                )  # fmt: skip
                missed = np.maximum(missed, miss)
            base = base + com - center_of_mass(model, angles, base)
        lower, upper = self.limits
        return np.asarray((missed < NEAR) & ((angles >= lower) & (angles <= upper)).all(axis=1))

    def planned(self, walk: WalkSettings) -> tuple[Plan, GaitFit, WalkingCost]:
        plan = walking_plan(self.scene.model, followed=ACCURATE, **asdict(walk))
        fit = fit_states(self.scene.model, plan, self.states)
        return plan, fit, WalkingCost(self.scene, fit.gait, plan.start_up(1))

    def check_speed(self) -> None:
        """Raise ValueError if a joint cannot follow the plan `SLOWEST` without load; of one without a plan, do not."""
        walk, model = self.walk(SLOWEST), self.scene.model
        try:
            plan, fit, _ = self.planned(walk)
        except ValueError:
            return
        asked = self.asked(fit.gait)
        worst = int((asked / self.speeds).argmax())
        if asked[worst] <= FASTER * self.speeds[worst]:
            return
        load = load_on_one_leg(model, plan)
        enough = least_servo(load.largest / TORQUE_SHARE if load else 0.0, float(asked.max()) / FASTER)
        raise ValueError(
            f"{model.name}: the joints are too slow to walk: even a step of {1e3 * walk.step_length:.0f} mm in "
            f"{walk.step_time:.2f} s turns {model.joint_names[worst]} at {asked[worst]:.2g} rad/s, and without load it "
            f"reaches {self.speeds[worst]:.2g} rad/s; {enough}"
        )

    def other_servos(self, trial: Trial) -> str:
        """Return the beginning of a remedy: other servos, where these have no reserve for a plan; else ""."""
        try:
            plan, fit, _ = self.planned(trial.walk)
        except ValueError:  # out of reach, or beyond the limits of joints
            return ""
        load = load_on_one_leg(self.scene.model, plan)
        weak = load is not None and load.share > RESERVE
        own = np.array([joint.velocity for joint in self.scene.model.moving_joints])  # of the file, whatever the servo
        slow = bool(((self.asked(fit.gait) > RESERVE * self.speeds) & (self.speeds < own)).any())
        words = " and ".join(["stronger"] * weak + ["faster"] * slow)
        return f"{words} servos (--servo on the command line), or " if words and trial.status != BEYOND else ""

    def asked(self, gait: Gait) -> np.ndarray:
        """Return the largest speeds (nj,) [rad/s] of a gait's references."""
        return np.abs(np.diff(_references(gait), axis=0)).max(axis=0) / TICK

    def attempt(self, point: np.ndarray) -> _Tried:
        walk = self.walk(point)
        try:
            _, fit, cost = self.planned(walk)
        except ValueError as error:
            return point, Trial(walk, math.inf, str(error))
        return point, self.measured(walk, fit, cost)

    def measured(self, walk: WalkSettings, fit: GaitFit, cost: WalkingCost) -> Trial:
        """Measure a plan that the robot can follow."""
        angles, (lower, upper) = _references(fit.gait), self.limits
        if np.any((angles < lower) | (angles > upper)):
            return Trial(walk, math.inf, BEYOND)
        if np.any(np.abs(np.diff(angles, axis=0)) > FASTER * TICK * self.speeds):
            return Trial(walk, math.inf, "joints would have to turn faster than they can without load")
        return Trial(walk, *self.searched(cost)(fit.gait.to_vector()))


def _references(gait: Gait) -> np.ndarray:
    """Return the angles (n, nj) [rad] that servos are sent in a stride."""
    return gait.angles(TICK * np.arange(round(gait.period / TICK) + 1))


def _walk(numbers: Sequence[float], size: Size, g: float, held: dict[str, Any]) -> WalkSettings:
    """Return the walk of numbers in the units of `Box` and fixed settings; strides are a whole number of ticks."""
    step, time, lift, sinking, width, double = numbers
    length, height, half_width = size
    half = 0.5 * TICK
    settings = {
        "step_length": step * length,
        "step_time": half * max(2, round(time * math.sqrt(length / g) / half)),
        "lift": lift * length,
        "com_height": height - sinking * length,
        "half_width": width * half_width,
        "double_support": double,
    }
    slower = math.sqrt(length / LEG * -GRAVITY[2] / g)  # than the Bioloid, by its size
    preview = {
        "T": SAMPLE,
        "N": round(slower * PREVIEW / SAMPLE),
        "R": float(f"{JERKS * slower**8:.2g}"),  # of rates of jerk, which go as lengths by the fourth power of time
        "n_steps": STEPS,
        "g": g,
    }
    return WalkSettings(**({name: round(x, 6) for name, x in settings.items()} | preview | held))


def _spread(count: int, dimension: int, seed: int) -> np.ndarray:
    """Return points (count, dimension) that fill the unit box evenly."""
    root = 2.0
    for _ in range(100):
        root = (1.0 + root) ** (1.0 / (dimension + 1))
    generator = np.random.Generator(np.random.PCG64(whole("seed", seed, 0, "it is the seed of the plans")))
    first = generator.random(dimension)
    return np.mod(first + np.arange(1, count + 1)[:, None] * root ** -np.arange(1.0, dimension + 1), 1.0)
