"""Let bodies touch in this package, MuJoCo and Bullet.

The tests are those of SimBenchmark (D. Kang, J. Hwangbo, SimBenchmark: Physics engine benchmark for robotics
applications, 2018, leggedrobotics.github.io/SimBenchmark), with the answer of rigid bodies as the truth:

rolling     After half a second at rest, a force of 150 N pushes a box of 10 kg over a floor, diagonally, with 25 balls
            of 1 kg on it.  The box slides and the balls roll on it: closed form.  The error is that of all
            velocities, by the box's.
bouncing    A ball falls on the floor and bounces.  The error is that of its energy.
elastic     One ball meets a row of five at rest, without gravity.  The last one leaves with its velocity, all others
            rest.  The error is that of all velocities, by the first one's.
666         6 x 6 x 6 balls fall on the floor, and stay a heap for a while.  The error is the deepest overlap of two,
            in the mean of all samples; a run whose energy rises counts for nothing.
hard        A box of 1000 kg rests on one of 1 kg.  The error is how far either moves.
stack       Ten boxes rest on each other.  The error is how far any moves.

Each engine has several methods, and each method several steps or tolerances.  Ours sinks by a stated depth under the
weight of all bodies.  MuJoCo has its stiffest contact, with `noslip` iterations besides, or its default; elastic
contact as a spring without damper, as stiff as ours.  Bullet has rigid bodies in maximal coordinates, with 10, 50 or
250 iterations.  `benchmark scoreboard` runs them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from ..core.integrate import INTEGRATORS
from ..geometry.body import body
from ..model.pair_contact import PairContact
from ..model.placed import Placed, SceneModel
from ..model.shapes import Box, Sphere
from ..run.classify import to_trajectory
from ..run.prepare import prepare
from ..run.simulate import initial_state
from ..scene.compile import IntegratorName, compile_scene
from ..scene.external import Push
from .engines import integrators, mujoco
from .methods import ENGINES, Method, Result, bullet, world
from .methods import Once as Timed
from .table import installed

G = 9.81  # [m/s^2]
SINKS = 1e-3  # of a ball that hits elastically, of its radius by ten [m]
ENDED = ("diverged", "too many contacts", "too costly")
MANY = 50  # bodies, beyond which fewer methods are tried
SWEEPS = (10, 50, 250)  # iterations of Bullet
FLOOR = (200.0, 200.0, 2.0)  # [m]


class Piece(NamedTuple):
    """Describe a body that moves."""

    shape: Sphere | Box
    mass: float  # [kg]
    position: tuple[float, float, float]  # [m]
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m/s]

    @property
    def inertia(self) -> float:
        """Return the moment of inertia of a ball [kg m^2]."""
        assert isinstance(self.shape, Sphere)
        return 0.4 * self.mass * self.shape.radius**2


class Motion(NamedTuple):
    """Hold positions and velocities of all pieces at all samples."""

    position: np.ndarray  # (samples, pieces, 3) [m]
    velocity: np.ndarray  # (samples, pieces, 6) of the center [m/s] and angular [rad/s]


Once = Callable[[], tuple[Motion, float]]  # runs; returns the motion and the processor time [s]


class Trial(NamedTuple):
    """Describe a test: bodies, the forces on them, and the error against the motion of rigid bodies."""

    name: str
    pieces: Sequence[Piece]
    duration: float  # [s]
    error: Callable[[Motion], float]
    asked: Sequence[float]  # errors at which engines are compared
    impact: float = 0.0  # of elastic bodies, the largest speed at which they meet [m/s]; 0: they do not bounce
    friction: float = 0.0
    floor: bool = True
    gravity: float = G  # [m/s^2]
    force: tuple[float, float, float] = (0.0, 0.0, 0.0)  # on the first piece [N]
    start: float = 0.0  # of the force [s]
    every: float = 0.1  # between samples [s]
    depths: Sequence[float] = (1e-5, 1e-7)  # to which bodies at rest sink in ours [m]
    unit: str = "m"  # of the error

    @property
    def mass(self) -> float:
        return sum(piece.mass for piece in self.pieces)

    def momentum(self, motion: Motion) -> str:
        """State by how much the momentum changes, by the sum of its sizes at the start; a floor takes some."""
        if self.floor:
            return ""
        masses = np.array([piece.mass for piece in self.pieces])
        start, end = masses @ motion.velocity[0, :, :3], masses @ motion.velocity[-1, :, :3]
        whole = masses @ np.linalg.norm(motion.velocity[0, :, :3], axis=1)
        return f"momentum changes by {np.linalg.norm(end - start) / whole:.0e}"


# ---------------------------------------------------------------------------------------------- tests


def trials(side: int = 6) -> list[Trial]:
    """Return all tests; side: so many balls along each edge of a cube of balls."""
    return [hard(), stack(), rolling(), elastic(), bouncing(), heap(side)]


def rolling(side: int = 5) -> Trial:
    """Push a box with balls on it."""
    box, radius, mu, force = Piece(Box((20.0, 20.0, 1.0)), 10.0, (0.0, 0.0, 0.5)), 0.5, 0.4, 150.0
    start = 0.5  # [s]
    at = 2.0 * (np.arange(side) - 0.5 * (side - 1))
    balls = [Piece(Sphere(radius), 1.0, (float(x), float(y), 1.0 + radius)) for x in at for y in at]
    # A ball that rolls on what accelerates by A accelerates by 2/7 A.
    weight = (box.mass + len(balls)) * G
    ahead = (force - mu * weight) / (box.mass + 2.0 / 7.0 * len(balls))
    share = np.array([1.0] + [2.0 / 7.0] * len(balls))
    along = np.array([1.0, 1.0, 0.0]) / math.sqrt(2.0)

    def error(motion: Motion) -> float:
        times = np.maximum(0.1 * np.arange(len(motion.velocity)) - start, 0.0)
        exact = ahead * times[:, None, None] * share[:, None] * along
        return float(np.linalg.norm(motion.velocity[..., :3] - exact, axis=2).max() / (ahead * times[-1]))

    x, y, z = force * along
    asked = 1e-1, 1e-2, 1e-3, 1e-4
    return Trial("rolling", [box, *balls], 2.5, error, asked, friction=mu, force=(x, y, z), start=start,
                 unit="of velocities")  # fmt: skip


def bouncing() -> Trial:
    """Drop an elastic ball from 1 m; after 4.5 s it flies for the sixth time."""
    ball, height = Piece(Sphere(0.1), 1.0, (0.0, 0.0, 1.1)), 1.0

    def error(motion: Motion) -> float:
        end = motion.position[-1, 0, 2] - 0.1 + 0.5 * float((motion.velocity[-1, 0, :3] ** 2).sum()) / G
        return abs(end / height - 1.0)

    return Trial("bouncing", [ball], 4.5, error, (1e-1, 1e-2, 1e-3, 1e-4, 1e-6), impact=math.sqrt(2.0 * G * height),
                 unit="of energy")  # fmt: skip


def elastic(count: int = 6) -> Trial:
    """Let a ball hit a row, in which none touches the next."""
    balls = [Piece(Sphere(0.1), 1.0, (0.25 * k, 0.0, 0.0), (float(k == 0), 0.0, 0.0)) for k in range(count)]

    def error(motion: Motion) -> float:
        exact = np.zeros((count, 3))
        exact[-1, 0] = 1.0
        return float(np.linalg.norm(motion.velocity[-1, :, :3] - exact, axis=1).max())

    return Trial("elastic", balls, 0.5, error, (1e-1, 1e-2, 1e-3, 1e-4, 1e-6), impact=1.0, floor=False, gravity=0.0,
                 unit="of velocities")  # fmt: skip


def cube(side: int, spacing: float) -> np.ndarray:
    """Return the places of balls on a grid about the origin (side^3, 3) [m]."""
    at = spacing * (np.arange(side) - 0.5 * (side - 1))
    return np.stack(np.meshgrid(at, at, at, indexing="ij"), axis=-1).reshape(-1, 3)


def heap(side: int) -> Trial:
    """Drop a cube of balls that do not bounce."""
    at = cube(side, 0.21) + np.random.default_rng(0).uniform(-0.005, 0.005, (side**3, 3))
    at[:, 2] += 0.2 - at[:, 2].min()
    balls = [Piece(Sphere(0.1), 1.0, tuple(p)) for p in at.tolist()]
    one, two = np.triu_indices(len(balls), 1)

    def error(motion: Motion) -> float:
        v, w = motion.velocity[..., :3], motion.velocity[..., 3:]
        energy = 0.5 * ((v**2).sum(-1) + balls[0].inertia * (w**2).sum(-1)) + G * motion.position[..., 2]
        if energy.sum(axis=1).max() > 1.01 * energy[0].sum():
            return math.nan  # balls that fly apart do not overlap
        deepest = []
        for place in motion.position:
            gaps = np.linalg.norm(place[one] - place[two], axis=1)
            deepest.append(max(0.0, 0.2 - gaps.min(initial=1.0), 0.1 - place[:, 2].min()))
        return float(np.mean(deepest))

    name, asked, depths = f"{side}{side}{side}", (1e-2, 3e-3, 1e-3, 3e-4), (1e-2, 1e-3)
    return Trial(name, balls, 1.0, error, asked, friction=0.5, every=0.02, depths=depths)


def hard() -> Trial:
    """Put 1000 kg on 1 kg."""
    pieces = [Piece(Box((0.2, 0.2, 0.2)), mass, (0.0, 0.0, z)) for mass, z in ((1.0, 0.1), (1e3, 0.3))]
    return Trial("hard", pieces, 1.0, moved, (1e-2, 1e-3, 1e-4, 1e-5, 1e-6), friction=0.8)


def stack(count: int = 10) -> Trial:
    """Put boxes on each other."""
    boxes = [Piece(Box((0.1, 0.1, 0.1)), 1.0, (0.0, 0.0, 0.05 + 0.1 * k)) for k in range(count)]
    return Trial("stack", boxes, 2.0, moved, (1e-2, 1e-3, 1e-4, 1e-5, 1e-6), friction=0.8)


def moved(motion: Motion) -> float:
    """Return how far the piece is that has moved farthest [m]."""
    return float(np.linalg.norm(motion.position[-1] - motion.position[0], axis=1).max())


# ---------------------------------------------------------------------------------------------- methods

RESTING = (2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4)  # steps of bodies that do not bounce [s]
BOUNCING = (1e-2, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5)  # ... and of those that do
LOOSE = (1e-1, 1e-2, 1e-3, 1e-4)
TIGHT = (1e-2, 1e-3, 1e-4, 1e-6, 1e-8)
RESTS: tuple[IntegratorName, ...] = ("implicit_euler", "ars343")
BOUNCES: tuple[IntegratorName, ...] = ("extrapolation", "midpoint")


def methods(test: Trial) -> Iterator[Method]:
    """Yield all methods of the engines that are installed."""
    if test.impact:
        for name in BOUNCES:
            settings: Sequence[float] = TIGHT if INTEGRATORS[name].adaptive else BOUNCING
            yield Method("ours", name, settings, partial(_timed, test, partial(our_run, test, name, SINKS)))
    else:
        for name in RESTS[: 1 if len(test.pieces) > MANY else 2]:
            settings = LOOSE if INTEGRATORS[name].adaptive else RESTING
            for depth in test.depths:
                ready = partial(our_run, test, name, depth)
                yield Method("ours", f"{name}, sinks {depth:.0e} m", settings, partial(_timed, test, ready))
    steps = BOUNCING if test.impact else RESTING
    if installed(ENGINES["MuJoCo"]):
        solvers = ("stiff",) if test.impact else ("stiff", "stiff, noslip", "default")
        for scheme, kind in integrators(*(("Euler", "RK4") if test.impact else ("Euler", "discrete"))):
            for solver in solvers if scheme == "Euler" else ("stiff",):
                label = scheme if test.impact else f"{scheme}, {solver}"
                yield Method("MuJoCo", label, steps, partial(_timed, test, partial(mujoco_run, test, kind, solver)))
    if installed(ENGINES["Bullet"]):
        for sweeps in SWEEPS:
            ready = partial(bullet_run, test, sweeps)
            yield Method("Bullet", f"{sweeps} iterations", steps, partial(_timed, test, ready))


def _timed(test: Trial, ready: Callable[[float], Once], setting: float) -> Timed:
    """Prepare a run that finds its error."""
    run = ready(setting)

    def once() -> Result:
        motion, spent = run()
        known = bool(np.isfinite(motion.velocity).all())
        error = test.error(motion) if known else math.inf
        error = error if error == error else math.inf
        return Result(error, spent, test.momentum(motion) if error < math.inf else "fails, or gains energy")

    return once


def our_run(test: Trial, integrator: IntegratorName, depth: float, setting: float) -> Once:
    """Prepare a run in this package."""
    members = tuple(
        Placed(body(piece.shape, piece.mass, name=f"p{k}"), position=piece.position)
        for k, piece in enumerate(test.pieces)
    )
    below = (0.0, 0.0, -0.5 * FLOOR[2])
    floor = Placed(body(Box(FLOOR), name="floor", base="fixed"), position=below)
    load, ratio = test.mass, 1.0
    if test.impact:  # stiffness load g / depth: the kinetic energy of one is the spring's at this depth
        load, ratio = test.pieces[0].mass * test.impact**2 / (G * depth), 0.0
    pairs = PairContact(penetration=depth, damping_ratio=ratio, friction=test.friction, load=load)
    adaptive = INTEGRATORS[integrator].adaptive
    scene = compile_scene(
        SceneModel("contact", members, (floor,) * test.floor), None, None, integrator,
        test.every if adaptive else setting, gravity=(0.0, 0.0, -test.gravity), pairs=pairs,
    )  # fmt: skip
    state = initial_state(scene, None, {f"p{k}": [*p.velocity, 0.0, 0.0, 0.0] for k, p in enumerate(test.pieces)})
    pushes = [Push("p0/body", test.force, start=test.start)] if any(test.force) else []
    rtol = setting if adaptive else None
    ready = prepare(scene, test.duration, ("base_q", "base_qd"), test.every, pushes=pushes, rtol=rtol)
    start = ready.start(state)

    def once() -> tuple[Motion, float]:
        arguments = ready.arguments(start)
        begin = time.thread_time()
        ready.kernel(*arguments)
        spent = time.thread_time() - begin
        run = to_trajectory(ready, *arguments[1:])
        if run.status in ENDED:
            run["base_qd"][-1] = math.nan
        shape = len(run["time"]), len(test.pieces), -1
        return Motion(run["base_q"].reshape(shape)[..., :3], run["base_qd"].reshape(shape)), spent

    return once


def mujoco_run(test: Trial, integrator: Any, contact: str, h: float) -> Once:
    """Prepare a run in MuJoCo; contact: "stiff", "stiff, noslip" or "default"."""
    stiff = contact != "default"
    if test.impact:
        solver = f'solref="{-((test.impact / SINKS) ** 2)} 0" solimp="0.9999 0.9999 0.001"'
    else:
        solver = f'solref="{2.0 * h} 1" solimp="0.9999 0.9999 0.001"' if stiff else ""
    touch = f'friction="{test.friction} 0 0" condim="{3 if test.friction else 1}" {solver}'
    bodies = []
    for k, piece in enumerate(test.pieces):
        shape, place = piece.shape, " ".join(map(repr, piece.position))
        half = [shape.radius] if isinstance(shape, Sphere) else [0.5 * x for x in shape.size]
        kind, size = ("box", "sphere")[len(half) == 1], " ".join(map(repr, half))
        form = f'type="{kind}" size="{size}" mass="{piece.mass}" {touch}'
        bodies.append(f'<body name={quoteattr(f"p{k}")} pos="{place}"><freejoint/><geom {form}/></body>')
    floor = f'<geom type="plane" size="0 0 1" {touch}/>' if test.floor else ""
    option = f'timestep="{h}" gravity="0 0 {-test.gravity}" cone="elliptic" impratio="{100 if stiff else 1}"'
    option += ' noslip_iterations="10"' * contact.endswith("noslip")
    text = f'<option {option}/><size memory="500M"/><worldbody>{floor}{"".join(bodies)}</worldbody>'
    m = mujoco.MjModel.from_xml_string(f"<mujoco>{text}</mujoco>")
    m.opt.integrator = integrator
    d, every, count = mujoco.MjData(m), round(test.every / h), len(test.pieces)

    def once() -> tuple[Motion, float]:
        mujoco.mj_resetData(m, d)
        d.qvel.reshape(count, 6)[:, :3] = [piece.velocity for piece in test.pieces]
        d.xfrc_applied[1, :3] = 0.0
        found, spent = [(d.qpos.copy(), d.qvel.copy())], 0.0
        for k in range(round(test.duration / test.every)):
            d.xfrc_applied[1, :3] = np.array(test.force) * (k * test.every > test.start - 1e-9)
            begin = time.thread_time()
            mujoco.mj_step(m, d, every)
            spent += time.thread_time() - begin
            found.append((d.qpos.copy(), d.qvel.copy()))
        q, v = (np.array(each).reshape(len(found), count, -1) for each in zip(*found))
        return Motion(q[..., :3], v), spent if not d.warning.number.any() else math.nan

    return once


def bullet_run(test: Trial, sweeps: int, h: float) -> Once:
    """Prepare a run in Bullet."""
    every = round(test.every / h)

    def once() -> tuple[Motion, float]:
        space = world()
        numbers = _laid_in_bullet(space, test, sweeps, h)
        spent = 0.0
        found = [_seen_in_bullet(space, numbers)]
        for k in range(round(test.duration / test.every)):
            push, begin = any(test.force) and k * test.every > test.start - 1e-9, time.thread_time()
            for _ in range(every):
                if push:
                    place, _ = space.getBasePositionAndOrientation(numbers[0])
                    space.applyExternalForce(numbers[0], -1, test.force, place, bullet.WORLD_FRAME)
                space.stepSimulation()
            spent += time.thread_time() - begin
            found.append(_seen_in_bullet(space, numbers))
        return Motion(*map(np.array, zip(*found))), spent

    return once


def _laid_in_bullet(space: Any, test: Trial, sweeps: int, h: float) -> list[int]:
    """Make the bodies; return their numbers."""
    space.resetSimulation()
    space.setGravity(0.0, 0.0, -test.gravity)
    space.setPhysicsEngineParameter(
        fixedTimeStep=h, numSolverIterations=sweeps, numSubSteps=0, solverResidualThreshold=0.0, useSplitImpulse=1,
        restitutionVelocityThreshold=0.0, enableConeFriction=1, deterministicOverlappingPairs=1,
    )  # fmt: skip
    if test.impact:  # else it takes speed from balls that come near, and adds energy where they overlap
        space.setPhysicsEngineParameter(contactBreakingThreshold=1e-4, erp=0.0, contactERP=0.0)
    own = {"restitution": float(test.impact > 0.0), "lateralFriction": math.sqrt(test.friction)}  # it takes products
    own |= {"linearDamping": 0.0, "angularDamping": 0.0, "rollingFriction": 0.0, "spinningFriction": 0.0}
    own |= {"activationState": bullet.ACTIVATION_STATE_DISABLE_SLEEPING}
    numbers = []
    for piece in test.pieces:
        shape = piece.shape
        form = {"radius": shape.radius} if isinstance(shape, Sphere) else {"halfExtents": [0.5 * x for x in shape.size]}
        kind = bullet.GEOM_SPHERE if isinstance(shape, Sphere) else bullet.GEOM_BOX
        made = space.createMultiBody(
            piece.mass, space.createCollisionShape(kind, **form), basePosition=piece.position, useMaximalCoordinates=1
        )
        space.changeDynamics(made, -1, **own)
        space.resetBaseVelocity(made, piece.velocity)
        numbers.append(made)
    if test.floor:
        plane = space.createCollisionShape(bullet.GEOM_PLANE, planeNormal=[0, 0, 1])
        space.changeDynamics(space.createMultiBody(0.0, plane, useMaximalCoordinates=1), -1, **own)
    return numbers


def _seen_in_bullet(space: Any, numbers: Sequence[int]) -> tuple[list, list]:
    places = [space.getBasePositionAndOrientation(number)[0] for number in numbers]
    return places, [[*sum(space.getBaseVelocity(number), ())] for number in numbers]
