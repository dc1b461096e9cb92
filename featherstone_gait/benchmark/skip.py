"""Count what a feature costs a step, by a scene without the feature and one with it: absent features cost nothing.

A step's executed instructions are counted exactly (`instructions.py`), over two steps after a tenth of a second of
simulation; the cells are empty where they cannot be counted.  Beside them stands its CPU time, the least of some calls
of 1000 steps timed in turn.  All kernels are those for one robot, implicit Euler at 1 ms, unless stated otherwise;
ticks of controllers are in the time and not in the instructions.

    featherstone-gait benchmark skip        three minutes, compiling aside
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..core.compile.jit import entry
from ..core.integrate.rollout import rollout_lanes
from ..core.step.advance import advance
from ..core.step.context import Run, Step
from ..core.step.newton import solve_step
from ..core.tree.forward_dynamics import aba
from ..core.tree.layout import Motion, Robot
from ..geometry.body import body as solid
from ..model import (
    Fluid,
    Ground,
    HeightField,
    Immersed,
    Joint,
    Link,
    Loop,
    Mimic,
    Model,
    Supply,
    Surface,
    Tendon,
    Via,
    Wrap,
)
from ..model.numpy_dynamics import link_poses, zero_position
from ..model.placed import Placed, SceneModel
from ..model.shapes import Box, Cylinder, Sphere
from ..robot_file import load_robot
from ..robot_file.servos import with_servo
from ..run.prepare import prepare, with_steps
from ..run.simulate import PARTS, initial_state, simulate
from ..run.worlds import Distribution, Worlds
from ..scene.compile import CompiledScene, GearboxKind, IntegratorName, compile_scene
from ..scene.external import Push
from ..walking.feedback import read_walk
from .default_scenes import AX12_LAW
from .instructions import instructions, records
from .session import upright
from .table import in_turn, machine, tabulate

M1: dict[str, Any] = {"coulomb_friction": 0.01, "stick_speed": 0.0}  # dry friction, which holds
M4 = M1 | {"stribeck_friction": 0.0239, "stribeck_speed": 1.52, "stribeck_exponent": 1.33}  # MX-64, arXiv 2410.08650
M4 |= dict.fromkeys(("stribeck_external_load", "stribeck_motor_load"), 0.2343)
FIRMWARE = AX12_LAW | {"profile_speed": 2.0, "delay": 3e-3}
LIMP: dict[str, Any] = {"type": "continuous", "lower": -math.inf, "upper": math.inf, "damping": 0.0, "friction": 0.0}
STEP, SETTLE = 1e-3, 0.1  # of the simulation, and time before anything is counted [s]
COUNTED, TIMED = 2, 1000  # steps
TRACK = Surface((0.0, 0.0, 0.0), (0.0, 0.0, 0.1))
REPEATS, REPEATS_FULL = 5, 51
ALLOWED = 0.03  # over a bare ABA loop


class Work(NamedTuple):
    """Hold a kernel that makes some steps; prepare(steps) gives its arguments, the last of which takes its records."""

    kernel: Any  # of Numba
    prepare: Callable[[int], tuple]


class Row(NamedTuple):
    """One line of the table: what a step takes without the feature and with it."""

    saving: Annotated[str, "saving", "<51"]
    executed_without: Annotated[float, "instructions", "13.0f"]  # NaN if they cannot be counted
    executed_with: Annotated[float, "with", "8.0f"]
    more: Annotated[float, "more", "8.1%"]
    time_us_without: Annotated[float, "us", "8.2f"]  # of the processor, the least of some calls
    time_us_with: Annotated[float, "with", "8.2f"]
    note: Annotated[str, "  ", "<2"]


def run(out_dir: Path, full: bool = False) -> list[Row]:
    """Print the table; write skip.csv into `out_dir`; `full` times more calls."""
    host = machine()
    print(f"{host}\n\na step without a feature and with it")
    compared, repeats = (*parts(), *arm_rows(), *humanoid_rows()), REPEATS_FULL if full else REPEATS
    rows = tabulate(out_dir / "skip.csv", Row, (row_of(*each, repeats) for each in compared), host)
    worst = max(row.more for row in rows if row.saving.startswith("whole step"))
    verdict = "holds" if worst <= ALLOWED else "not counted" if math.isnan(worst) else "does not hold"
    print(f"a whole step takes at most {ALLOWED:.0%} more instructions than a bare loop: {worst:+.1%}, {verdict}")
    return rows


@cache
def executed(work: Work) -> float:
    """Count the instructions of a step, the mean of some that neither begin nor end a run; NaN if not counted."""
    work.kernel(*work.prepare(1))
    counts = []
    for last in (1, 2):
        arguments = work.prepare(3 * COUNTED)
        third = len(arguments[-1]) // 3
        counts.append(instructions(partial(work.kernel, *arguments), arguments[-1], last * third))
    return (counts[1] - counts[0]) / COUNTED


def row_of(saving: str, without: Work, having: Work, note: str, repeats: int) -> Row:
    """Count a step without a feature and with it, and time both in turn."""
    few, many = executed(without), executed(having)
    turns = [[partial(work.kernel, *work.prepare(TIMED)) for work in (without, having)] for _ in range(repeats)]
    short, long = (1e6 / TIMED * float(least) for least in np.min([in_turn(turn, 1)[0] for turn in turns], axis=0))
    return Row(saving, few, many, many / few - 1.0, short, long, note)


def rollout(
    model: Model | list[Placed] | SceneModel, gearbox: GearboxKind | None = None, ground: Ground | None = None, *,
    lifted: float = 0.0, integrator: IntegratorName = "implicit_euler", record: tuple[str, ...] = (),
    every: int = COUNTED, controller: Callable[[CompiledScene], Any] | None = None, pushes: Sequence[Push] = (),
    worlds: Worlds | None = None,
) -> Work:  # fmt: skip
    """Prepare a scene that goes on from its state after a tenth of a second; with worlds eight of it in lanes.

    A robot stands on the ground, or is lifted above it [m].
    """
    scene = compile_scene(model, gearbox, ground, integrator, STEP, fall_height=-1e6, fall_tilt=3.2)
    state = None if ground is None else initial_state(scene)
    if state is not None and lifted:
        state[scene.layout["base_q"] + 2] += lifted
    begin = simulate(scene, SETTLE, state, pushes=pushes, record=(), estimate_error=False).final
    act, scenes = controller and controller(scene), worlds.scenes(scene) if worlds else [scene]
    ready = [prepare(each, 1.0, record, pushes=pushes, controller=act) for each in scenes]
    if not record:
        ready[0] = replace(ready[0], channels=np.array([scene.layout["q"]], np.int64))

    def arguments(steps: int) -> tuple:
        shorter = [with_steps(each, steps, min(every, steps)) for each in ready]
        starts = [each.start(begin) for each in shorter]
        run_, y, out = shorter[0].arguments_in_lanes(starts) if worlds else shorter[0].arguments(starts[0])
        return run_, y, records(*out.shape)

    return Work(rollout_lanes if worlds else ready[0].kernel, arguments)


@entry
def aba_loop(steps: int, robot: Robot, h: float, z: np.ndarray, W: np.ndarray, out: np.ndarray) -> None:
    """Make steps of semi-implicit Euler, nothing else; rows of z: positions, velocities, torques, accelerations."""
    q, qd, tau, qdd = z[0], z[1], z[2], z[3]
    for k in range(steps + 1):
        out[k] = qd[0]
        aba(robot, Motion(None, None, None, q, qd, None, None), None, tau, None, (W, None), None, qdd)
        for i in range(len(q)):
            qd[i] += h * qdd[i]
            q[i] += h * qd[i]


@entry
def rk4_loop(steps: int, robot: Robot, h: float, z: np.ndarray, W: np.ndarray, out: np.ndarray) -> None:
    """Make Runge-Kutta steps of x = (q, qd); rows of z: x, x at the start of the step, x at its end, slope, tau."""
    x, start, end, slope, n = z[0], z[1], z[2], z[3], z.shape[1] // 2
    for k in range(steps + 1):
        out[k] = x[0]
        for i in range(2 * n):
            start[i] = end[i] = x[i]
        for weight, ahead in ((h / 6.0, 0.5 * h), (h / 3.0, 0.5 * h), (h / 3.0, h), (h / 6.0, 0.0)):
            at = Motion(None, None, None, x[:n], x[n:], None, None)
            aba(robot, at, None, z[4, :n], None, (W, None), None, slope[n:])
            for i in range(n):
                slope[i] = x[n + i]
            for i in range(2 * n):
                end[i] += weight * slope[i]
                x[i] = start[i] + ahead * slope[i]
        for i in range(2 * n):
            x[i] = end[i]


@entry
def solve_loop(steps: int, run: Run, advances: bool | None, h: float, y: np.ndarray, out: np.ndarray) -> None:
    """Solve an implicit step; unless advances is None, also advance the state: a step without ticks."""
    scene, o, s = run.scene, run.offsets[0], run.work.scratch
    for k in range(steps + 1):
        out[k] = y[0]
        room = s.W, s.Z, s.C, s.F, s.N, s.pool
        at = Step(scene, None, None, o, y, None, None, None, 0.0, h, h, h, 1.0, None, 1e-9, *room, None, s.rows, None)
        solve_step(at)
        if advances is not None:
            advance(at)


def parts() -> Iterator[tuple[str, Work, Work, str]]:
    """Yield rows from a bare loop to the whole step of the free arm, for both integrators of such a scene."""
    scene = compile_scene(free_arm(), integrator="implicit_euler", timestep=STEP)
    n, robot, W = scene.tree.n, Robot(scene.tree.bodies, None, scene.gravity), np.zeros(scene.tree.workspace_shape())
    ready = prepare(scene, STEP)
    run_, y, _ = ready.arguments(ready.start())
    euler = Work(aba_loop, lambda steps: (steps, robot, STEP, np.full((4, n), 0.1), W, records(steps + 1)))
    rk4 = Work(rk4_loop, lambda steps: (steps, robot, STEP, np.full((5, 2 * n), 0.1), W, records(steps + 1)))
    solved = Work(solve_loop, lambda steps: (steps, run_, None, STEP, y.copy(), records(steps + 1)))
    advanced = Work(solve_loop, lambda steps: (steps, run_, True, STEP, y.copy(), records(steps + 1)))
    yield "solution of a step", euler, solved, "free arm of 7 joints, by a loop of ABA"
    yield "solution, state, energies, chatter", euler, advanced, "the same"
    yield "whole step, implicit_euler", euler, rollout(free_arm()), "the same, with ticks, status and records"
    yield "whole step, rk4", rk4, rollout(free_arm(), integrator="rk4"), "by a loop of RK4 with ABA"


WATER = Fluid(1000.0, level=0.0)


@cache
def free_arm(name: str = "arm7", locked: str | None = None) -> Model:
    """Return a robot without friction, stops and servos."""
    return changed(load_robot(name, locked=locked), **LIMP)


def changed(model: Model, which: slice = slice(None), **changes: Any) -> Model:
    """Change some moving joints, and leave out the servos."""
    names = model.joint_names[which]
    joints = tuple(replace(j, **changes) if j.name in names else j for j in model.joints)
    return replace(model, joints=joints, servos={})


def first_by(arm: Model, kind: Any, stiffness: float = 0.0) -> Model:
    """Return the arm whose first joint is a ball joint, or a universal one with a hinge behind it."""
    first, *others = arm.joints
    free: dict[str, Any] = {"lower": -math.inf, "upper": math.inf, "axis": (0.0, 0.0, 1.0)}
    turning = [replace(first, type="ball", stiffness=stiffness, **free)]
    if kind == "universal":
        cross = replace(first, type=kind, child="cross", **free)
        turning = [cross, Joint("behind", "continuous", "cross", first.child, axis=(0.0, 1.0, 0.0))]
    links = (*arm.links, Link("cross")) if kind == "universal" else arm.links
    return replace(arm, links=links, joints=(*turning, *others), keyframes={})


def with_points(model: Model, **changes: Any) -> Model:
    """Return the model with changes of all of its contact points."""
    return replace(model, contacts=tuple(replace(point, **changes) for point in model.contacts))


def carried(surface: Surface | None) -> SceneModel:
    """Return a scene of a box that lies on another one of a surface, which never moves."""
    table = solid(Box((1.0, 1.0, 0.1)), base="fixed", surface=surface)
    box = Placed(solid(Box((0.1, 0.1, 0.1)), 1.0), "box", (0.2, 0.0, 0.1))
    return SceneModel("table", (box,), (Placed(table, "table"),), pairs="all")


def tied(arm: Model) -> Model:
    """Return the arm with a rod of 0.3 m from its last link to the base."""
    link = arm.links[-1].name
    x, y, z = (float(a) for a in link_poses(arm, zero_position(arm)).position[-1])
    return replace(arm, loops=(Loop("rod", "distance", link, arm.root, point_b=(x + 0.3, y, z), distance=0.3),))


def strung(model: Model, **changes: Any) -> Model:
    """Return the model with a tendon along its last ten joints, a spring with a damper."""
    pulleys = tuple((name, 0.02) for name in model.joint_names[-10:])
    return replace(model, tendons=(Tendon("tendon", pulleys, stiffness=100.0, damping=1.0, **changes),))


def roped(model: Model, *between: Wrap, start: str | None = "link10") -> Model:
    """Return the chain with a spring from a link, or the world, to its last link, around shapes in between."""
    ends = Via(start, (0.0, 0.0, 0.1)), Via(model.links[-1].name, (0.05, 0.0, 0.0))
    return replace(model, tendons=(Tendon("rope", path=(ends[0], *between, ends[1]), stiffness=100.0),))


def in_water(model: Model, fluid: Fluid | None) -> SceneModel:
    """Return a scene of the model with a cylinder on each link that moves."""
    shapes = tuple(Immersed(link.name, Cylinder(0.02, 0.1), drag=1.0) for link in model.links[1:])
    return SceneModel("water", (Placed(replace(model, immersed=shapes)),), fluid=fluid)


@cache
def chain(joints: int = 20) -> Model:
    """Return a chain of hinges whose axes take turns, bent everywhere."""
    links, found = [Link("link0")], []
    for k in range(1, joints + 1):
        place, axis = (0.1 if k > 1 else 0.0, 0.0, 0.0), tuple(float(k % 3 == axis) for axis in (0, 1, 2))
        links.append(Link(f"link{k}", 1.0, (0.05, 0.0, 0.0), (1e-3, 0.0, 0.0, 2e-3, 0.0, 2e-3)))
        bent: dict[str, Any] = {"rpy": (0.1, 0.15, -0.2), "axis": axis}
        found.append(Joint(f"joint{k}", "continuous", f"link{k - 1}", f"link{k}", place, **bent))
    return Model("chain", tuple(links), tuple(found))


def driven(**changes: Any) -> Model:
    """Return the arm with AX-12 servos without friction."""
    return with_servo(free_arm(), "ax12", **{"viscous_friction": 0.0, "coulomb_friction": 0.0} | changes)


def arm_rows() -> Iterator[tuple[str, Work, Work, str]]:
    """Yield rows: name, the work without the feature and with it, and a remark."""
    arm, last = free_arm(), slice(-1, None)
    lifted = tuple(replace(link, gravity_compensation=0.5) for link in arm.links)
    held, push = replace(arm, locked=dict.fromkeys(arm.joint_names[4:], 0.0)), Push(arm.links[-1].name, (0.1, 0.0, 0.0))
    plain, rigid, soft = rollout(arm), rollout(driven(), "standard"), rollout(driven(), "mipsd")
    first, *others = chain().links
    heavy = replace(first, mass=1.0, inertia=(1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3))
    floating = replace(chain(), links=(heavy, *others), base="floating")
    dry, loaded = (rollout(driven(**friction), "standard") for friction in (M1, M4))
    yield from (
        ("fixed joint lumped (of 7 the last)", rollout(changed(arm, last, type="fixed")), plain, ""),
        ("locked joints lumped (of 7 three)", rollout(held), plain, ""),
        ("no friction", plain, rollout(changed(arm, damping=0.01, friction=0.01)), ""),
        ("no stops", plain, rollout(changed(arm, type="revolute", lower=-3.0, upper=3.0)), "no joint at its stop"),
        ("no springs of joints", plain, rollout(changed(arm, stiffness=0.1)), "one at each joint"),
        ("no borne weights", plain, rollout(replace(arm, links=lifted)), "half of each link's"),
        ("no ball joint", rollout(first_by(arm, "universal")), rollout(first_by(arm, "ball")), "for three hinges"),
        ("no loop", rollout(arm, integrator="rk4"), rollout(tied(arm), integrator="rk4"), "a rod to the base, rk4"),
        ("no loop (chain of 20 joints)", rollout(chain(), integrator="rk4"), rollout(tied(chain()), integrator="rk4"),
         "the same"),
        ("no tendon (chain of 20 joints)", rollout(chain()), rollout(strung(chain())), "one along the last ten joints"),
        ("no friction and inertia of a tendon (chain of 20 joints)", rollout(strung(chain())),
         rollout(strung(chain(), friction=0.1, armature=0.1)), "the same tendon"),
        ("no shape around which a tendon runs (chain of 20 joints)", rollout(roped(chain())),
         rollout(roped(chain(), Wrap("link15", "sphere", 0.03))), "a sphere"),
        ("no end of a tendon in the world (floating chain)", rollout(roped(floating)),
         rollout(roped(floating, start=None)), "one of two ends"),
        ("no damping that grows", rollout(changed(arm, damping=0.01)),
         rollout(changed(arm, damping=0.01, cubic_damping=0.01)), "cubic, of 7 joints"),
        ("no spring of a ball joint", rollout(first_by(arm, "ball")), rollout(first_by(arm, "ball", 0.1)), "one"),
        ("no fluid", rollout(in_water(arm, None)), rollout(in_water(arm, WATER)), "a cylinder on each of 7 links"),
        ("no coupled joints", plain, rollout(changed(arm, last, mimic=Mimic(arm.joints[0].name))), "the last of 7"),
        ("no pushes", plain, rollout(arm, pushes=(push,)), "one push"),
        ("no recorded channel", rollout(arm, every=1), rollout(arm, record=PARTS, every=1), "one number, and all"),
        ("no servos", plain, rigid, "standard model"),
        ("no rotor", rigid, soft, "standard model and mipsd"),
        ("no friction that knows load and speed", dry, loaded, "M1 and M4 of 7 servos"),
        ("no firmware", rigid, rollout(driven(**FIRMWARE), "standard"), "all of it in 7 servos"),
        ("no short way round", rigid, rollout(driven(wrap=True), "standard"), "of 7 joints without limits"),
        ("no supply", rigid, rollout(replace(driven(), supply=Supply(11.1, 0.3)), "standard"), "one that 7 share"),
        ("no inductance", rollout(driven(inductance=0.0), "standard"), rigid, "not skipped: same kernel"),
        ("no backlash", soft, rollout(driven(backlash=0.01), "mipsd"), "not skipped: same kernel"),
    )  # fmt: skip


def humanoid_rows() -> Iterator[tuple[str, Work, Work, str]]:
    """Yield such rows."""
    body, ground = free_arm("humanoid", "simplified"), Ground()
    field = Ground(field=HeightField(np.zeros((20, 20)), (0.1, 0.1), (-1.0, -1.0)))
    flying, standing, level = (rollout(body, None, each) for each in (None, ground, field))
    small, round_ = with_points(body, radius=1e-3), with_points(body, circle_radius=1e-3)
    balls, discs = rollout(small, None, ground), rollout(round_, None, ground)
    posed, near = (rollout(body, None, ground, record=r, every=1) for r in (("base_q", "q"), ("clearance",)))
    tracks = rollout(with_points(body, surface=TRACK), None, ground)
    yield from (
        ("no floating base (humanoid)", rollout(replace(body, base="fixed")), flying, ""),
        ("no ground (humanoid)", flying, standing, f"{len(body.contacts)} points, standing"),
        ("nothing near the ground (humanoid)", rollout(body, None, ground, lifted=10.0), standing, "same kernel"),
        ("no clearance (humanoid)", posed, near, "both record poses each step; distances are for after the run"),
        ("no round contacts (humanoid)", standing, balls, "points and spheres"),
        ("no wheels (humanoid)", balls, discs, "spheres and discs"),
        ("ground at rest (humanoid)", standing, rollout(body, None, Ground(turning=0.1)), "a turntable"),
        ("surfaces at rest (humanoid)", standing, tracks, "turning soles"),
        ("no rollers (humanoid)", discs, rollout(with_points(round_, roller_angle=1.5), None, ground), "all circles"),
        (
            "no rolling resistance (humanoid)",
            balls,
            rollout(with_points(small, rolling_friction=1e-3), None, ground),
            "of all spheres",
        ),
        ("no height field (humanoid)", standing, level, "level, 400 nodes"),
        ("nothing near the height field (humanoid)", rollout(body, None, field, lifted=10.0), level, "same kernel"),
    )
    model = load_robot("humanoid", locked="simplified")
    walker = partial(rollout, model, "mipsd", ground)
    dry, loaded = (rollout(with_servo(model, "ax12", **friction), "mipsd", ground) for friction in (M1, M4))
    walk: Any = read_walk(Path(model.source).parent / "balanced_gait.npz")
    narrow = Distribution("uniform", 1e-13)  # so narrow that it does not show in the motion
    motors = ("resistance", "inductance", "motor_constant", "voltage_limit", "stiffness", "damping", "Kp")
    servos, links = dict.fromkeys(motors, narrow), dict.fromkeys(("mass", "center_of_mass", "inertia"), narrow)
    grounds = dict.fromkeys(("friction", "penetration", "damping_ratio"), narrow)
    eights = (Worlds(8), Worlds(8, servos=servos, ground=grounds), Worlds(8, links=links))
    alike, unlike, inertias = (walker(worlds=eight, record=("base_q",)) for eight in eights)
    yield from (
        ("no friction that knows load and speed (humanoid)", dry, loaded, "M1 and M4 of 10 servos, standing"),
        ("no controller of one's own (humanoid)", walker(), walker(controller=lambda _: upright), "in time alone"),
        ("no feedback from an IMU (humanoid)", walker(), walker(controller=walk.controller), "the same"),
        ("no worlds of servos and ground (humanoid)", alike, unlike, "eight lanes: a step of all"),
        ("no worlds of inertias (humanoid)", alike, inertias, "the same"),
    )
    alone, other = Placed(model, name="one"), Placed(model, name="other", position=(3.0, 0.0))
    ball, box = (Placed(solid(shape, 1.0), name="it", position=(3.0, 0.0)) for shape in (Sphere(0.1), Box((0.1,) * 3)))
    lanes = partial(walker, worlds=Worlds(8), record=("base_q",))
    one, both = rollout([alone], "mipsd", ground), rollout([alone, other], "mipsd", ground)
    yield from (
        ("no company (humanoid)", walker(), one, "a scene that may have several, of one"),
        ("no second humanoid", walker(), both, "3 m apart"),
        ("no second humanoid, eight lanes", lanes(), rollout([alone, other], "mipsd", ground, worlds=Worlds(8)), ""),
        ("no ball at rest (humanoid)", walker(), rollout([alone, ball], "mipsd", ground), "one contact point"),
        ("no box at rest (humanoid)", walker(), rollout([alone, box], "mipsd", ground), "eight contact points"),
    )
    yield from pair_rows(model, ground)


def pair_rows(model: Model, ground: Ground) -> Iterator[tuple[str, Work, Work, str]]:
    """Yield rows of contact between bodies: far, touching at one point and at five, and on a face."""
    alone = Placed(model, name="one")
    feet, sides = ("left_foot", "right_foot"), ("left", "right")
    high = ("head", *(f"{side}_{link}" for side in sides for link in ("shoulder_block", "upper_arm")))
    few = tuple((f"one/{foot}", f"one/{shoulder}") for foot in feet for shoulder in high)
    close = tuple((f"one/{side}_thigh", f"one/{side}_forearm") for side in sides)
    close = (("one/left_foot", "one/right_foot"), *close)  # closer than 1 mm while the humanoid stands
    scenes = [SceneModel("pairs", (alone,), pairs=pairs) for pairs in ("none", few, "all")]
    none, far, every, most = (
        partial(rollout, scene, "mipsd", ground) for scene in (*scenes, replace(scenes[2], excluded=close))
    )
    eight = [partial(each, worlds=Worlds(8), record=("base_q",)) for each in (none, far, most, every)]
    without, *lanes = (each() for each in eight)
    notes = f"{len(few)} pairs of links, far", "all pairs of its links but three", "all, three of them within 1 mm"
    names = "no far pairs", "no pairs of links", "no pairs of links, some near"
    rows = [*zip(names, (far, most, every), notes)]
    yield from ((f"{name} (humanoid)", none(), each(), note) for name, each, note in rows)
    yield from ((f"{name}, eight lanes", without, each, note) for name, each, note in zip(names, lanes, notes))
    below = [Placed(solid(Sphere(0.05), 1.0), f"ball {k}", (3.0 + k, 0.0, 0.05)) for k in range(5)]
    above = [Placed(ball.model, f"{ball.name} above", (*ball.position[:2], 0.1495)) for ball in below]
    for count, what in ((1, "one point"), (5, "five points")):
        members = (alone, *below[:count], *above[:count])
        meeting = tuple((one.name, two.name) for one, two in zip(below[:count], above[:count]))
        scenes = [SceneModel("balls", members, pairs=pairs) for pairs in ((), meeting)]
        apart, touching = (rollout(scene, "mipsd", ground) for scene in scenes)
        yield f"no touching at {what} (humanoid)", apart, touching, "a ball on a ball each"
    boxes = [(Placed(solid(Box((0.1, 0.1, 0.1)), 1.0), k, at) for k, at in (("a", (0.0, 0.0, 0.05)), ("b", place)))
             for place in ((0.3, 0.0, 0.05), (0.02, 0.0, 0.1498))]  # fmt: skip
    apart, touching = (rollout(SceneModel("boxes", tuple(both), pairs="all"), None, ground) for both in boxes)
    yield "no touching on a face (two boxes)", apart, touching, "a box on a box, and beside it"
    yield "surfaces at rest (a box on a box)", rollout(carried(None)), rollout(carried(TRACK)), "a turntable"
