"""Data of a step: constants of the scene, the course of a run, and everything of one step.

What a scene lacks is None, and costs nothing.  Numba leaves out what an *argument* that is None makes unreachable, not
what an attribute does: functions take what may be absent as their first argument, and the context after it.
"""

import math
from typing import NamedTuple

import numpy as np

from ..compile.jit import inline
from ..compile.structure import replacing, structure
from ..effects.firmware import Firmware
from .signals import Signals

NEWTON_TOLERANCE = 1e-9  # of the forces of a step of fixed length, relative


@structure
class Scene(NamedTuple):
    """The constants of a scene."""

    tree: np.ndarray  # (n + 1,) BODY
    floating: bool | None  # True or None
    gravity: np.ndarray  # (3,) [m/s^2]
    actuator: tuple | None  # one of the kinds in effects/
    decay: np.ndarray | None  # (n, DECAYS) of motors and filters over a step of fixed length
    armature: np.ndarray | None  # (n,) inertia added to each joint [kg m^2]
    friction: np.ndarray | tuple | None  # (n,) FRICTION, or GearFriction
    stops: np.ndarray | None  # (n,) STOP
    contact: tuple | None  # Contact
    push: np.ndarray | None  # (pushes,) PUSH
    coupling: np.ndarray | None = None  # (couplings,) COUPLING
    firmware: Firmware = Firmware()
    supply: np.ndarray | None = None  # (1,) SUPPLY
    joint_springs: np.ndarray | None = None  # (n,) JOINT_SPRING
    lifts: np.ndarray | None = None  # (links,) PUSH, at all times, that bear weight
    trees: np.ndarray | None = None  # (trees,) TREE of a scene of several trees
    pairs: tuple | None = None  # Pairs: shapes that may touch; a scene that has any has `trees`
    balls: np.ndarray | None = None  # (balls,) first coordinate of each ball joint
    loops: tuple | None = None  # Loops, of a scene of one robot
    stiffening: np.ndarray | None = None  # (n,) STIFFENING, of joint springs
    drag: np.ndarray | None = None  # (n,) DRAG of joints
    ball_springs: np.ndarray | None = None  # (n,) stiffness of ball joints, about each of their axes [N m/rad]
    tendons: tuple | None = None  # Tendons, with springs between bodies
    fluid: tuple | None = None  # Fluid, with the shapes in it
    propellers: tuple | None = None  # Propellers
    surfaces: np.ndarray | None = None  # (drives,) commands of surfaces at the start


@structure
class Plan(NamedTuple):
    """The course of a run in whole steps."""

    h: float  # step [s]
    theta: float  # 1: Euler, 1/2: midpoint, but for its first step
    steps: int
    per_tick: int  # steps of a controller tick
    per_sample: int  # steps between records
    lag: float  # from a reference to its effect [s]
    min_height: float  # of the center of mass over the ground, along its normal [m]; below it the robot has fallen
    min_upright: float  # cosine of the base's tilt; below it the robot has fallen
    upright: tuple[float, float, float] = (0.0, 0.0, 1.0)  # what points up in the frame of a base that is not tilted
    # Of integrators with error control, for which h is only the grid on which ticks and records lie:
    rtol: float = 0.0  # error allowed of a step, relative ...
    atol: float = 0.0  # ... and absolute [rad, m, and their rates; A]
    least_step: float = 0.0  # [s]
    second_run: bool = False  # at ten times the tolerance of a first run, whose error it estimates
    budget: float = math.inf  # steps, with those rejected, after which the run ends as too costly
    pause: float = math.inf  # evaluations after which the kernel returns, to be called again
    integrated: int = 0  # how much of the state changes between ticks
    # Of a run that goes on: its grid step k is at the time offset + (first + k) h.
    first: int = 0  # steps taken before
    offset: float = 0.0  # where what was before is off this grid [s]


@structure
class Scratch(NamedTuple):
    """Scratch arrays, which every step overwrites."""

    W: np.ndarray  # tree: see tree/layout.py
    Z: np.ndarray  # joints: see effects/joint.py
    C: np.ndarray  # contact points: see effects/element.py
    F: np.ndarray  # pushes and what bears weight (bodies, 6)
    N: np.ndarray  # Newton's iteration of each tree: see effects/element.py
    pool: tuple | None  # Pool of pairs: see effects/pair.py
    rows: tuple | None  # Rows of couplings, loops, tendons and pairs: see tree/rows.py
    closing: tuple | None  # Closing of loops: see closure.py


@structure
class Run(NamedTuple):
    """A run: what it reads, and what it overwrites besides the state."""

    scene: Scene
    offsets: np.ndarray  # (1,) STATE
    plan: Plan
    signals: Signals
    work: tuple  # the workspace of the integrator, whose type says which it is
    good: np.ndarray  # the state at the last tick that was found sound
    channels: np.ndarray  # indices into the state of what is recorded
    frames: np.ndarray | None  # rows of the tree's workspace, in which falls are looked for; None: there are none
    stop: np.ndarray  # (1,): not 0 where the run is wanted no longer; another thread sets it
    renewal: tuple | None  # Renewal of the pool of pairs: see pool.py

    # But for what is `Varying` in them: any number of the scene may be, and of the plan min_height.
    SHARED = ("scene", "offsets", "plan", "channels", "stop")


@structure
class Step(NamedTuple):
    """One step, or one evaluation of the differential equation."""

    scene: Scene
    actuator: tuple | None  # the scene's, None where the integrator applies the drive by itself
    decay: np.ndarray | None  # (n, DECAYS) over this step
    offsets: np.record  # STATE: where each part of y starts
    y: np.ndarray  # the state
    tau: np.ndarray | None  # (n,) torques from outside [N m]
    drive: np.ndarray | None  # (n, 2) reference of a continuous servo and its rate
    predicted: np.ndarray | None  # (nq + nv,) of the midpoint rule: the state in the middle of the step
    t: float  # pushes are averaged over the time from t ...
    span: float  # ... over this [s]
    h: float  # step [s]
    h_implicit: float  # theta h, at whose end forces are taken [s]; 0 of an evaluation
    theta: float
    extrapolation_ratio: float | None  # (1 - theta) / theta of the midpoint rule: how far the step ends beyond
    tolerance: float  # of Newton's iteration: of the forces, relative
    W: np.ndarray  # the arrays of Scratch
    Z: np.ndarray
    C: np.ndarray
    F: np.ndarray
    N: np.ndarray
    pool: tuple | None
    part: np.record | None  # TREE of the one of several trees that takes the step
    rows: tuple | None
    closing: tuple | None


of_tree = inline(replacing(Step, "part"))  # (step, part) -> the step as that of one of several trees
_with_scene = inline(replacing(Step, "scene"))
_with_tree = inline(replacing(Scene, "tree"))


@inline
def with_bodies(step, tree):
    """Return the step of a scene whose bodies are these."""
    return _with_scene(step, _with_tree(step.scene, tree))
