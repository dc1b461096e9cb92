"""Scenes of benchmarks: arms, a humanoid, published problems, and runs under stress.

The published problems: the free box of the Gazebo benchmark (github.com/scpeters/benchmark, 1 x 4 x 9 m, simple: no
gravity, turning about one axis; complex: thrown, turning about the middle axis, which is unstable) and, of the IFToMM
library of benchmark problems, A01, the pendulum, and A05, the stiff flyball governor (M. Gonzalez et al., A
collaborative benchmarking framework for multibody system dynamics, Engineering with Computers 26 (2010), doi
10.1007/s00366-009-0139-0).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from ..model import ContactPoint, Ground, HeightField, Joint, Link, Model, Spring
from ..robot_file import load_robot, load_servo
from ..run.reference import Reference
from ..run.simulate import reset_time, simulate, standing_state
from ..scene.actuator import GearboxKind
from ..scene.compile import compile_scene
from ..scene.external import Push
from .case import Case, case_of, settings
from .linkages import linkages

CENTER = (0.0, 0.0, 0.0)
TINY = (1e-8, 0.0, 0.0, 1e-8, 0.0, 1e-8)  # [kg m^2]
NO_FALL: dict[str, Any] = {"fall_height": -1e6, "fall_tilt": 4.0}
STIFF_SERVO: dict[str, Any] = {"Kp": 12.97, "Kd": 0.374, "torque_limit": 1.5}
FIXED = dict.fromkeys(("implicit_euler", "midpoint", "rk4"), 2e-5)
ALL = FIXED | {"dop853": 1e-13, "extrapolation": 1e-13, "ars343": 1e-6}
ADAPTIVE, STIFF_ADAPTIVE = ("dop853", "extrapolation", "ars343"), ("extrapolation", "ars343")
SMOOTH: dict[str, Any] = {"best": ("dop853", 1e-13), "check": ("extrapolation", 1e-13)}


def problems() -> list[Case]:
    """Return the problems of `precision`, in the order of its table."""
    return [
        free_arm(), stiff_arm("standard"), stiff_arm("rotor"), geared_arm(), flying(), *humanoids(), rolling_ball(),
        free_box("simple"), free_box("complex"), pendulum(), *linkages(), governor(),
    ]  # fmt: skip


def unlimited(model: Model) -> Model:
    """Return the model without stops."""
    free: dict[str, Any] = {"lower": -math.inf, "upper": math.inf}
    kinds: dict[str, Any] = {"revolute": "continuous"}
    joints = (replace(j, type=kinds.get(j.type, j.type), **(free if j.type != "fixed" else {})) for j in model.joints)
    return replace(model, joints=tuple(joints))


def box(inertia: tuple[float, float, float] = (0.0142, 0.0142, 0.0267), corners: bool = True) -> Model:
    """Make a box of 1 kg, by default 0.4 x 0.4 x 0.1 m with its lower corners as contact points."""
    xx, yy, zz = inertia
    link = Link("box", 1.0, CENTER, (xx, 0.0, 0.0, yy, 0.0, zz))
    points = [ContactPoint("box", (x, y, -0.05)) for x in (-0.2, 0.2) for y in (-0.2, 0.2)] if corners else []
    return Model("box", (link,), (), "floating", contacts=tuple(points))


def ball(radius: float = 0.05, inertia: float = 1e-3) -> Model:
    link = Link("ball", 1.0, CENTER, (inertia, 0.0, 0.0, inertia, 0.0, inertia))
    return Model("ball", (link,), (), "floating", contacts=(ContactPoint("ball", CENTER, radius=radius),))


def chain(links: int) -> Model:
    """Prolong `arm7_spatial` to any number of links, hanging: axes y, x, y, x ..."""
    arm = load_robot("arm7_spatial")
    names = [arm.links[0].name, *(f"link{k}" for k in range(1, links + 1))]
    x, y, z = arm.links[1].center_of_mass
    bodies = (replace(arm.links[1], name=name, center_of_mass=(x, y, -z)) for name in names[1:])
    length = max(abs(value) for value in arm.joints[2].xyz)
    axes = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    joints = tuple(
        Joint(f"joint{k + 1}", "continuous", parent, child, (0.0, 0.0, -length if k else 0.0), axis=axes[k % 2])
        for k, (parent, child) in enumerate(pairwise(names))
    )
    return Model(f"chain{links}", (Link(names[0]), *bodies), joints)


def pd_arm(gain: float = 1.0) -> Model:
    """Return `arm7_spatial` without stops, with continuous servos; gain multiplies their gains and torque limit."""
    arm, law = unlimited(load_robot("arm7_spatial")), {name: gain * value for name, value in STIFF_SERVO.items()}
    servo = load_servo("ax12", law="pd_clamped", viscous_friction=0.0, coulomb_friction=0.0, **law)
    return replace(arm, servos=dict.fromkeys(arm.joint_names, servo))


# ---------------------------------------------------------------------------------------------- precision


def free_arm() -> Case:
    """Release seven links at 0.5 rad a joint: chaotic, not stiff."""
    scene = compile_scene(unlimited(load_robot("arm7_spatial")))
    return case_of("arm, free", "precision", scene, 1.0, [0.5] * 7, None, record_interval=1.0, settings=settings(ALL),
                   **SMOOTH)  # fmt: skip


def stiff_arm(gearbox: GearboxKind, angle: float = 0.05, duration: float = 0.5) -> Case:
    """Release the arm at 0.05 rad on continuous servos, which are stiff without rotor inertia."""
    name = "arm, stiff servos" if gearbox == "standard" else "arm, servos with rotors"
    return case_of(name, "precision", compile_scene(pd_arm(), gearbox), duration, [angle] * 7, None,
                   reference=Reference([0.0], np.zeros((1, 7))), record_interval=duration, settings=settings(ALL, 0.1),
                   check=("dop853", 1e-13))  # fmt: skip


def geared_arm() -> Case:
    """Release the planar arm of Lima et al. 2013, with sampled motor inertia plus spring-damper (MIPSD) servos."""
    how = {"implicit_euler": 2e-5, "midpoint": 2e-5, "simtwo": 2e-5, "extrapolation": 1e-11, "ars343": 1e-6}
    return case_of("arm, geared servos", "precision", compile_scene(load_robot("arm7"), "mipsd"), 0.5, [0.01] * 7, None,
                   reference=Reference([0.0], np.zeros((1, 7))), record_interval=0.5, settings=settings(how),
                   best=("extrapolation", 1e-12), check=("extrapolation", 1e-11))  # fmt: skip


def flying() -> Case:
    """Let the humanoid tumble freely without servos."""
    model = unlimited(replace(load_robot("humanoid", locked="simplified"), servos={}))
    rng = np.random.default_rng(0)
    n = len(model.joint_names)
    q = np.concatenate([[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], 0.3 * rng.normal(size=n)])
    qd = 3.0 * rng.normal(size=n + 6)
    return case_of("humanoid, flying", "precision", compile_scene(model), 0.5, q, qd, record_interval=0.5,
                   settings=settings(ALL), **SMOOTH)  # fmt: skip


def humanoids() -> list[Case]:
    """Let the humanoid stand for half a second, and walk a stride, with the whole servo chain."""
    from ..optimize.planning import walking_cost

    cost = walking_cost(load_robot("humanoid", locked="simplified"))
    how = {"implicit_euler": 2e-5, "midpoint": 2e-5, "simtwo": 2e-5, "extrapolation": 1e-8, "ars343": 1e-4}
    common: dict[str, Any] = {"settings": settings(how), "record_interval": 0.01, "best": ("extrapolation", 1e-9),
                              "check": ("extrapolation", 1e-8)}  # fmt: skip
    scene = compile_scene(cost.scene.model, "mipsd", Ground())
    signal = cost.reference(cost.gait.to_vector(), cost.warm_up + 1)
    still = Reference([0.0], signal.values[:1])
    state = standing_state(cost.scene, signal.values[0])
    start = simulate(cost.scene, cost.mark, state, signal, record_interval=cost.mark, estimate_error=False)
    stride = Reference(signal.times - cost.mark, signal.values, "linear")
    begin = reset_time(cost.scene, start.final)
    return [
        Case("humanoid, standing", "humanoid", scene, 0.5, standing_state(scene, signal.values[0]), still, **common),
        Case("humanoid, walking a stride", "humanoid", scene, cost.gait.period, begin, stride, **common),
    ]


def rolling_ball() -> Case:
    """Roll a ball of 0.1 m over the waves of a height field of 5 cm cells for a second."""
    x = np.arange(-1.0, 1.0, 0.05)
    field = HeightField(0.02 * np.sin(4.0 * x[:, None]) * np.cos(3.0 * x[None, :]), (0.05, 0.05), (-1.0, -1.0))
    scene = compile_scene(ball(0.1, 0.4 * 0.1**2), None, Ground(friction=5.0, field=field), **NO_FALL)
    return case_of("ball rolling over waves", "precision", scene, 1.0, None, [0.3, 0.1, 0.0, -1.0, 3.0, 0.0],
                   record_interval=0.01, settings=settings(FIXED | {"extrapolation": 1e-9, "ars343": 1e-6}),
                   best=("extrapolation", 1e-10), check=("extrapolation", 1e-9))  # fmt: skip


def free_box(kind: str) -> Case:
    """Let a uniform box of 1 x 4 x 9 m fly freely for ten seconds."""
    simple = kind == "simple"
    velocity = [-0.9, 0.4, 0.1, 0.5, 0.0, 0.0] if simple else [-2.0, 2.0, 8.0, 0.1, 5.0, 0.1]

    def turning(t: np.ndarray) -> np.ndarray:
        """Turn about the first axis and drift."""
        zero = 0.0 * t
        return np.stack([-0.9 * t, 0.4 * t, 0.1 * t, np.cos(0.25 * t), np.sin(0.25 * t), zero, zero], axis=1)

    model = box((97 / 12, 82 / 12, 17 / 12), corners=False)
    scene = compile_scene(model, gravity=(0.0, 0.0, 0.0 if simple else -9.8))
    return case_of(f"free box, {kind}", "precision", scene, 10.0, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], velocity,
                   record_interval=10.0, settings=settings(ALL | dict.fromkeys(FIXED, 1e-4), 0.1),
                   exact=turning if simple else None, **SMOOTH)  # fmt: skip


def pendulum() -> Case:
    """Release IFToMM A01, 1 kg at 1 m, horizontally: sin(q / 2) = k sn(K - w t), k = sin(45 deg), elliptic sn."""
    from scipy.special import ellipj, ellipk

    point = (1e-9, 0.0, 0.0, 1e-9, 0.0, 1e-9)  # a point mass, which the model does not know [kg m^2]
    links = (Link("base"), Link("bob", 1.0, (0.0, 0.0, -1.0), point))
    model = Model("pendulum", links, (Joint("hinge", "continuous", "base", "bob", axis=(0.0, 1.0, 0.0)),))
    w, k = math.sqrt(9.81 / (1.0 + point[3])), math.sqrt(0.5)

    def swinging(t: np.ndarray) -> np.ndarray:
        return 2.0 * np.arcsin(k * ellipj(ellipk(k * k) - w * t, k * k)[0])[:, None]

    return case_of("IFToMM A01, pendulum", "precision", compile_scene(model), 10.0, [0.5 * math.pi], None,
                   record_interval=0.1, settings=settings(ALL), exact=swinging)  # fmt: skip


DENSITY, BALL = 3000.0, 5.0  # of the governor's bodies [kg/m^3], of each of its balls [kg]
ROD, CUBE = 1.0, 0.1  # length of shaft and rods, edge of the slider [m]
THICK = 0.01  # shaft and rods [m]
RISE, SPIN = math.radians(30.0), 2.0 * math.pi  # of the rods below the horizontal [rad], of the whole [rad/s]


def governor() -> Case:
    """Spin IFToMM A05, a Watt governor whose lower rods are springs with dampers; slider height and angles count.

    The shaft turns freely about the vertical and carries the slider and two hinges, a rod on each with a ball at its
    end; from each rod's middle a spring-damper leads to the slider.  All turns at 1 Hz to begin with, the slider half
    way up; then slider and rods swing up and down once in 1.025 s, the slider between 0.5 and 0.744 m.  Given are
    sizes, masses, springs, the slider's place and 30 degrees: from the horizontal, as only there the springs have
    their rest length of 0.5 m.  Hinges and springs sit 0.05 m from the axis, as wide as the slider is, and the balls
    are points: what others have read off the figure.

    The eigenvalues of springs and masses at the start are -8117 and -20.0 1/s, and with the rods against each other
    -1450 and -20.3 1/s, beside a swing of 6.1 rad/s; explicit steps end at 0.25 ms.  Error control of `dop853` holds at
    any tolerance, that of the extrapolation from 1e-4 on: of a looser one its short columns are unstable, unsaid.
    """
    bar, cube = DENSITY * ROD * THICK**2, DENSITY * CUBE**3
    long, thin = bar * (ROD**2 + THICK**2) / 12.0, bar * THICK**2 / 6.0
    mass = bar + BALL
    center = (0.5 * bar + BALL) * ROD / mass  # of a rod with its ball, from the hinge [m]
    swing = long + bar * (center - 0.5 * ROD) ** 2 + BALL * (ROD - center) ** 2
    links = (
        Link("ground"),
        Link("shaft", bar, (0.0, 0.0, 0.5 * ROD), (long, 0.0, 0.0, long, 0.0, thin)),
        Link("slider", cube, (0.0, 0.0, 0.0), tuple(cube * CUBE**2 / 6.0 * x for x in (1, 0, 0, 1, 0, 1))),
        *(Link(name, mass, (0.0, 0.0, -center), (swing, 0.0, 0.0, swing, 0.0, thin)) for name in ("right", "left")),
    )
    up, half, tilt = (0.0, 0.0, 1.0), 0.5 * CUBE, 0.5 * math.pi - RISE
    joints = [
        Joint("shaft", "continuous", "ground", "shaft", axis=up),
        Joint("slider", "prismatic", "shaft", "slider", xyz=(0.0, 0.0, 0.5), axis=up),
    ]
    springs = []
    for name, side in (("right", 1.0), ("left", -1.0)):
        place, turn, axis = (side * half, 0.0, ROD), (0.0, -side * tilt, 0.0), (0.0, -side, 0.0)
        joints.append(Joint(name, "continuous", "shaft", name, place, turn, axis))
        ends = (side * half, 0.0, 0.0), (0.0, 0.0, -0.5 * ROD)
        springs.append(Spring("slider", name, *ends, stiffness=8e5, damping=4e4, length=0.5))
    scene = compile_scene(Model("governor", links, tuple(joints)), springs=springs)
    return case_of("IFToMM A05, flyball governor", "precision", scene, 10.0, np.zeros(4), [SPIN, 0.0, 0.0, 0.0],
                   record_interval=0.1, settings=settings(ALL, 5e-4), **SMOOTH)  # fmt: skip


# ---------------------------------------------------------------------------------------------- stress


def stressed(full: bool = False) -> list[Case]:
    """Return all cases of `stress`; full: with more steps."""
    more = (2e-4, 2e-3, 2e-2) if full else ()
    return [*_chains(more), *_stiff_arms(more), *_servos(), *_boxes(), *_rods(more)]


def _stressed(
    name: str, model: Model, duration: float, steps: Sequence[float], *, adaptive: Sequence[str] = ADAPTIVE,
    fixed: Sequence[str] = tuple(FIXED), angle: float = 0.0, base: Sequence[float] = (), pushes: Sequence[Push] = (),
    **arguments: Any,
) -> Case:  # fmt: skip
    """Make a case with all joints at an angle [rad] and records that all steps meet; base: pose and velocity."""
    scene = compile_scene(model, **arguments).pushed(pushes)
    n = scene.tree.n
    tried = [*((name, step) for name in fixed for step in sorted(steps)), *((name, math.nan) for name in adaptive)]
    return case_of(name, "stress", scene, duration, [*base[:7], *[angle] * n], [*base[7:], *[0.0] * n],
                   reference=Reference([0.0], np.zeros((1, n))) if scene.gearbox else None, settings=tuple(tried),
                   record_interval=1e-4 * math.lcm(*(round(1e4 * step) for step in steps)))  # fmt: skip


def _chains(more: Sequence[float]) -> list[Case]:
    """Release seven links and a hundred, with masses, inertias and lengths at their extremes."""
    arm, steps = unlimited(load_robot("arm7_spatial")), (1e-3, 1e-2, *more)
    return [
        _stressed("tip 10 000 times as heavy", _heavier(arm, 7), 0.3, steps, angle=0.5),
        _stressed("root 10 000 times as heavy", _heavier(arm, 1), 0.3, steps, angle=0.5),
        _stressed("last link of 1e-8 kg m^2", _light_tip(arm), 0.3, steps, angle=0.5),
        _stressed("hundred links", chain(100), 0.2, steps, angle=0.05),
    ]


def _heavier(model: Model, k: int) -> Model:
    """Multiply mass and inertia of the k-th link by 10 000."""
    link = model.links[k]
    heavier = replace(link, mass=1e4 * link.mass, inertia=tuple(1e4 * value for value in link.inertia))
    return replace(model, links=(*model.links[:k], heavier, *model.links[k + 1 :]))


def _light_tip(model: Model) -> Model:
    """Give the last link 1 g and 1e-8 kg m^2."""
    return replace(model, links=(*model.links[:-1], replace(model.links[-1], mass=1e-3, inertia=TINY)))


def _stiff_arms(more: Sequence[float]) -> list[Case]:
    """Use continuous servos without rotor inertia; gains times 1 and 100; clipped or not; with a light last link."""
    light = _stressed("gains times 1, last link of 1e-8 kg m^2", _light_tip(pd_arm()), 0.3, (1e-3, 1e-2), angle=0.05,
                      gearbox="standard")  # fmt: skip
    return [
        light,
        *(
            _stressed(f"gains times {gain:g}, from {angle:g} rad", pd_arm(gain), 0.5, (1e-3, 1e-2, 5e-2, *more),
                      angle=angle, gearbox="standard")
            for gain in (1.0, 100.0) for angle in (0.05, 0.5)
        ),
    ]  # fmt: skip


def _servos() -> list[Case]:
    """Use sampled servos at the AX-12's gear ratio and at 1000, with and without backlash."""
    found = []
    for ratio, kind, backlash in ((254, "standard", 0), (1000, "standard", 0), (254, "mipsd", 0), (1000, "mipsd", 0),
                                    (254, "mipsd", 1)):  # fmt: skip
        arm, servo = unlimited(load_robot("arm7")), load_servo("ax12")
        gearbox = replace(servo.gearbox, ratio=float(ratio), backlash=math.radians(backlash))
        gain = replace(servo.controller, Kp=servo.controller.Kp * 254 / ratio)
        servo = replace(servo, gearbox=gearbox, controller=gain)
        arm = replace(arm, servos=dict.fromkeys(arm.joint_names, servo))
        name = f"{kind}, gear {ratio}" + (f", backlash {backlash} deg" if backlash else "")
        found.append(_stressed(name, arm, 0.2, (1e-3, 1e-2), fixed=("simtwo", "implicit_euler", "midpoint"),
                               adaptive=STIFF_ADAPTIVE, angle=0.02, gearbox=kind))  # fmt: skip
    return found


def _boxes() -> list[Case]:
    """Start a box of 1 kg 2 cm in the ground, drop it from 2 m, kick it, and spin it."""
    how: dict[str, Any] = {"adaptive": STIFF_ADAPTIVE, "fall_height": -1e6}
    ground: dict[str, Any] = how | {"ground": Ground(friction=0.6), "fall_tilt": math.pi}
    turn, later = (1.0, 0.02, 0.01, 0.0, *[0.0] * 6), (Push("box", CENTER, start=9.0),)
    kick = (Push("box", (200.0, 30.0, 0.0), start=0.05, end=0.06),)
    steps, spin = (1e-3, 1e-2), (0.0, 0.0, 100.0, 1.0, *[0.0] * 6, 30.0, 0.0, 40.0)
    return [
        _stressed("box sunk in by 2 cm", box(), 0.2, steps, base=(0.0, 0.0, 0.03, *turn), pushes=later, **ground),
        _stressed("box dropped from 2 m", box(), 0.8, steps, base=(0.0, 0.0, 2.05, *turn), pushes=later, **ground),
        _stressed("box kicked", box(), 0.3, steps, base=(0.0, 0.0, 0.05, *turn), pushes=kick, **ground),
        _stressed("box at 50 rad/s", box(), 1.0, steps, base=spin, ground=Ground(), gravity=(0.0, 0.0, -1e-9),
                  fall_tilt=2.0 * math.pi, **how),
    ]  # fmt: skip


def _rods(more: Sequence[float]) -> list[Case]:
    """Run a rod into its stop at speed, hold it by friction and by springs, and kick it for less than a step."""
    links = (
        Link("base"),
        Link("rod", 1.0, (0.0, 0.0, -0.25), (0.0208, 0.0, 0.0, 0.0208, 0.0, 0.0002)),
    )
    joint = Joint("hinge", "revolute", "base", "rod", axis=(0.0, 1.0, 0.0), lower=-0.2, upper=2.0, effort=20.0)
    rod = Model("rod", links, (joint,))
    rubs = replace(rod, joints=(replace(joint, friction=10.0, lower=-math.inf, upper=math.inf),))
    sprung = replace(rod, joints=(replace(joint, stiffness=1e4, damping=1.0),))
    kick = Push("rod", (5e3, 0.0, 0.0), CENTER, (0.0, 0.0, -0.5), start=0.1003, end=0.1006)
    tie = Spring("base", "rod", (0.3, 0.0, -0.5), (0.0, 0.0, -0.5), 1e5, 10.0, 0.3)
    stiff: dict[str, Any] = {"adaptive": STIFF_ADAPTIVE}
    return [
        _stressed("rod runs into its stop", rod, 0.8, (1e-3, 1e-2, *more), angle=1.5),
        _stressed("rod on stiff friction", rubs, 0.5, (1e-3, 1e-2), angle=1.5, **stiff),
        _stressed("rod on a stiff spring", rod, 0.3, (2e-4, 1e-3), angle=0.1, springs=(tie,), **stiff),
        _stressed("rod on a stiff joint spring", sprung, 0.3, (1e-3, 1e-2), angle=0.1),
        _stressed("rod kicked for 0.3 ms", rod, 0.3, (1e-3, 1e-2), angle=0.1, pushes=(kick,)),
    ]
