"""Compare contact between bodies with MuJoCo and Bullet at equal error.

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
weight of all bodies.  MuJoCo has its stiffest contact, or its default; elastic contact as a spring without damper,
as stiff as ours.  Bullet has rigid bodies in maximal coordinates, with 10, 50 or 250 iterations.  The cost at an
error is interpolated between the neighboring settings of one method, as in `benchmark peers`.

All are timed in turn, in processor time without the preparation of a run, and compared as ratios.

    featherstone-gait benchmark contact        fifteen minutes
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from ..base.progress import progress_bar
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
from ..view.style import COLORS, look, subplots
from .engines import Lazy, mujoco, quick_mujoco
from .peers import Point, cheapest, integrators
from .table import installed, machine, print_table, save_figure, tabulate, write_table

bullet, bullet_client = Lazy("pybullet"), Lazy("pybullet_utils.bullet_client")
G = 9.81  # [m/s^2]
SAMPLES = 50  # of a run
ROUNDS, ROUNDS_FULL, ENOUGH = 3, 9, 0.3  # turns; CPU seconds after which a setting is not run again
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
    depths: Sequence[float] = (1e-3, 1e-5, 1e-7)  # to which bodies at rest sink in ours [m]

    @property
    def mass(self) -> float:
        return sum(piece.mass for piece in self.pieces)


class Method(NamedTuple):
    """Describe an engine with the settings of one of its methods."""

    name: str  # begins with that of the engine
    settings: Sequence[float]  # steps [s] or tolerances, the coarsest first
    ready: Callable[[float], Once]  # of a setting


class Row(NamedTuple):
    """Hold one line of the table."""

    test: Annotated[str, "test", "<9"]
    method: Annotated[str, "method", "<27"]
    setting: Annotated[float, "step [s], rtol", "14g"]
    error: Annotated[float, "error", "9.1e"]
    momentum: Annotated[float, "momentum", "9.1e"]  # change by the sum of all sizes; NaN where a floor takes some
    time: Annotated[float, "CPU ms/s", "10.4g"]  # by simulated second [ms]


class Line(NamedTuple):
    """Hold our cost at an error [CPU ms by simulated second], and the cost of the others by ours."""

    test: Annotated[str, "test", "<9"]
    error: Annotated[float, "at error", "9.0e"]
    ours: Annotated[float, "ours ms/s", "9.3g"]
    mujoco: Annotated[float, "MuJoCo", "9.3g"]
    bullet: Annotated[float, "Bullet", "9.3g"]
    note: Annotated[str, "", "<2"]


def run(out_dir: Path, full: bool = False) -> list[Line]:
    """Print the tables; write contact.csv, contact_lines.csv and contact.png into `out_dir`."""
    host, rows = machine(), list[Row]()
    host += "".join(f", {name} {version}" for name, version in _bullet_version())
    print(host)
    cases = trials()
    with quick_mujoco():
        for test in cases:
            rows += print_table(Row, measured(test, ROUNDS_FULL if full else ROUNDS))
            write_table(out_dir / "contact.csv", Row._fields, rows, host)
    plot(out_dir / "contact.png", rows, host)
    return tabulate(out_dir / "contact_lines.csv", Line, (line for test in cases for line in lines(test, rows)), host)


def measured(test: Trial, rounds: int, slowest: float = 8.0) -> list[Row]:
    """Find the errors of all methods, and time all settings in turn; leave out what takes longer than `slowest` [s]."""
    runs: list[tuple[Method, float, Once]] = []
    rows, spent = list[Row](), list[list[float]]()
    for method in progress_bar([*methods(test)], test.name):
        last = 0.0
        for before, setting in zip((math.inf, *method.settings), method.settings):
            if last * min(before / setting, 10.0) > slowest:
                break
            once = method.ready(setting)
            if last == 0.0 and method.name.startswith(ENGINES[0]):
                once()  # compiles
            motion, last = once()
            error = test.error(motion) if np.isfinite(motion.velocity).all() else math.nan
            rows.append(Row(test.name, method.name, setting, error, momentum(test, motion), last))
            runs.append((method, setting, once))
            spent.append([last])
    for _ in progress_bar(range(rounds - 1), f"{test.name}: times"):
        for (_, _, once), times in zip(runs, spent):
            if sum(times) < ENOUGH:
                times.append(once()[1])
    return [row._replace(time=1e3 * min(times) / test.duration) for row, times in zip(rows, spent)]


def momentum(test: Trial, motion: Motion) -> float:
    """Return by how much the momentum changes, by the sum of its sizes at the start."""
    if test.floor:
        return math.nan
    masses = np.array([piece.mass for piece in test.pieces])
    start, end = masses @ motion.velocity[0, :, :3], masses @ motion.velocity[-1, :, :3]
    return float(np.linalg.norm(end - start) / (masses @ np.linalg.norm(motion.velocity[0, :, :3], axis=1)))


def steady(rows: Sequence[Row]) -> Iterator[Point]:
    """Yield points whose error is the largest of that and all finer settings: a lucky step counts for nothing."""
    for method in dict.fromkeys(row.method for row in rows):
        worst = 0.0
        for row in reversed([row for row in rows if row.method == method]):
            worst = max(worst, row.error if row.error == row.error else math.inf)
            yield Point(row.test, method, row.setting, worst, row.time)


ENGINES = ("ours", "MuJoCo", "Bullet")


def lines(test: Trial, rows: Sequence[Row]) -> Iterator[Line]:
    """Compare the engines at each error."""
    points = list(steady([row for row in rows if row.test == test.name]))
    seen = {engine for engine in ENGINES for point in points if _is_of(engine, point.method)}
    for error in test.asked:
        found = [
            cheapest(error, points, test.name, partial(_is_of, engine)) if engine in seen else (math.inf, "none")
            for engine in ENGINES
        ]
        ours, mujocos, bullets = (cost for cost, _ in found)
        yield Line(test.name, error, ours, mujocos / ours, bullets / ours, "; ".join(name for _, name in found))


def _is_of(engine: str, method: str) -> bool:
    return method.startswith(engine)


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
    return Trial("rolling", [box, *balls], 2.5, error, asked, friction=mu, force=(x, y, z), start=start)


def bouncing() -> Trial:
    """Drop an elastic ball from 1 m; after 4.5 s it flies for the sixth time."""
    ball, height = Piece(Sphere(0.1), 1.0, (0.0, 0.0, 1.1)), 1.0

    def error(motion: Motion) -> float:
        end = motion.position[-1, 0, 2] - 0.1 + 0.5 * float((motion.velocity[-1, 0, :3] ** 2).sum()) / G
        return abs(end / height - 1.0)

    return Trial("bouncing", [ball], 4.5, error, (1e-1, 1e-2, 1e-3, 1e-4, 1e-6), impact=math.sqrt(2.0 * G * height))


def elastic(count: int = 6) -> Trial:
    """Let a ball hit a row, in which none touches the next."""
    balls = [Piece(Sphere(0.1), 1.0, (0.25 * k, 0.0, 0.0), (float(k == 0), 0.0, 0.0)) for k in range(count)]

    def error(motion: Motion) -> float:
        exact = np.zeros((count, 3))
        exact[-1, 0] = 1.0
        return float(np.linalg.norm(motion.velocity[-1, :, :3] - exact, axis=1).max())

    return Trial("elastic", balls, 0.5, error, (1e-1, 1e-2, 1e-3, 1e-4, 1e-6), impact=1.0, floor=False, gravity=0.0)


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

    name, asked, depths = f"{side}{side}{side}", (1e-2, 3e-3, 1e-3, 3e-4), (1e-2, 1e-3, 1e-4)
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
RESTS: tuple[IntegratorName, ...] = ("implicit_euler", "midpoint", "ars343")


def methods(test: Trial) -> Iterator[Method]:
    """Yield all methods of the engines that are installed."""
    if test.impact:
        for name in ("extrapolation", "dop853", "rk4", "midpoint"):
            settings: Sequence[float] = TIGHT if INTEGRATORS[name].adaptive else BOUNCING
            yield Method(f"ours {name}", settings, partial(our_run, test, name, SINKS))
    else:
        for name in RESTS[: 2 if len(test.pieces) > MANY else 3]:
            settings = LOOSE if INTEGRATORS[name].adaptive else RESTING
            for depth in test.depths:
                yield Method(f"ours {name}, {depth:.0e} m", settings, partial(our_run, test, name, depth))
    steps = BOUNCING if test.impact else RESTING
    if installed("mujoco"):
        kinds = integrators(*(("Euler", "RK4") if test.impact else ("Euler", "discrete")))
        for (name, kind), stiff in ((one, stiff) for one in kinds for stiff in (True, False)):
            if stiff or (not test.impact and name == "Euler"):
                label = f"MuJoCo {name}" + ("" if test.impact else ", stiff" if stiff else ", default")
                yield Method(label, steps, partial(mujoco_run, test, kind, stiff))
    if installed("pybullet"):
        for sweeps in SWEEPS:
            yield Method(f"Bullet {sweeps}", steps, partial(bullet_run, test, sweeps))


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


def mujoco_run(test: Trial, integrator: Any, stiff: bool, h: float) -> Once:
    """Prepare a run in MuJoCo."""
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
    text = f"<option {option}/><size memory=\"500M\"/><worldbody>{floor}{''.join(bodies)}</worldbody>"
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
        world = _world()
        numbers = _laid_in_bullet(world, test, sweeps, h)
        spent = 0.0
        found = [_seen_in_bullet(world, numbers)]
        for k in range(round(test.duration / test.every)):
            push, begin = any(test.force) and k * test.every > test.start - 1e-9, time.thread_time()
            for _ in range(every):
                if push:
                    place, _ = world.getBasePositionAndOrientation(numbers[0])
                    world.applyExternalForce(numbers[0], -1, test.force, place, bullet.WORLD_FRAME)
                world.stepSimulation()
            spent += time.thread_time() - begin
            found.append(_seen_in_bullet(world, numbers))
        return Motion(*map(np.array, zip(*found))), spent

    return once


@cache
def _world() -> Any:
    return bullet_client.BulletClient(connection_mode=bullet.DIRECT)


def _laid_in_bullet(world: Any, test: Trial, sweeps: int, h: float) -> list[int]:
    """Make the bodies; return their numbers."""
    world.resetSimulation()
    world.setGravity(0.0, 0.0, -test.gravity)
    world.setPhysicsEngineParameter(
        fixedTimeStep=h, numSolverIterations=sweeps, numSubSteps=0, solverResidualThreshold=0.0, useSplitImpulse=1,
        restitutionVelocityThreshold=0.0, enableConeFriction=1, deterministicOverlappingPairs=1,
    )  # fmt: skip
    if test.impact:  # else it takes speed from balls that come near, and adds energy where they overlap
        world.setPhysicsEngineParameter(contactBreakingThreshold=1e-4, erp=0.0, contactERP=0.0)
    own = {"restitution": float(test.impact > 0.0), "lateralFriction": math.sqrt(test.friction)}  # it takes products
    own |= {"linearDamping": 0.0, "angularDamping": 0.0, "rollingFriction": 0.0, "spinningFriction": 0.0}
    own |= {"activationState": bullet.ACTIVATION_STATE_DISABLE_SLEEPING}
    numbers = []
    for piece in test.pieces:
        shape = piece.shape
        form = {"radius": shape.radius} if isinstance(shape, Sphere) else {"halfExtents": [0.5 * x for x in shape.size]}
        kind = bullet.GEOM_SPHERE if isinstance(shape, Sphere) else bullet.GEOM_BOX
        made = world.createMultiBody(
            piece.mass, world.createCollisionShape(kind, **form), basePosition=piece.position, useMaximalCoordinates=1
        )
        world.changeDynamics(made, -1, **own)
        world.resetBaseVelocity(made, piece.velocity)
        numbers.append(made)
    if test.floor:
        plane = world.createCollisionShape(bullet.GEOM_PLANE, planeNormal=[0, 0, 1])
        world.changeDynamics(world.createMultiBody(0.0, plane, useMaximalCoordinates=1), -1, **own)
    return numbers


def _seen_in_bullet(world: Any, numbers: Sequence[int]) -> tuple[list, list]:
    places = [world.getBasePositionAndOrientation(number)[0] for number in numbers]
    return places, [[*sum(world.getBaseVelocity(number), ())] for number in numbers]


def _bullet_version() -> Iterator[tuple[str, str]]:
    if installed("pybullet"):
        from importlib.metadata import version

        yield "pybullet", version("pybullet")


# ---------------------------------------------------------------------------------------------- output


@look()
def plot(path: Path, rows: Sequence[Row], notes: str) -> None:
    """Draw time against error, a panel for each test: the best of each engine thick."""
    names = list(dict.fromkeys(row.test for row in rows))
    figure, panels = subplots(4.0 * len(names), 4.0, 1, len(names), squeeze=False)
    for panel, name in zip(panels[0], names):
        for engine, color, marker in zip(ENGINES, COLORS, "os^"):
            of = [row for row in rows if row.test == name and row.method.startswith(engine)]
            for k, method in enumerate(dict.fromkeys(row.method for row in of)):
                line = [row for row in of if row.method == method and 0.0 < row.error < 10.0]
                label = engine if k == 0 else None
                panel.loglog(
                    [row.error for row in line], [row.time for row in line], "-", color=color, marker=marker,
                    markersize=3.5, linewidth=0.9, label=label,
                )  # fmt: skip
        panel.set(title=name, xlabel="error", ylabel="CPU time per simulated second [ms]")
    panels[0][0].legend()
    figure.suptitle(notes, fontsize=7)
    save_figure(figure, path)
