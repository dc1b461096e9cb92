"""Closed loops of benchmarks: the IFToMM problems A02, A03 and A04, a delta robot, a parallel ankle, a four-bar.

A02, the parallelograms, has a closed form and is singular twice a turn.  A03, Andrews' squeezing mechanism, moves
within milliseconds; its angles after 30 ms are published (F. Mazzia and C. Magherini, Test Set for IVP Solvers, release
2.4, 2008), exact to 1.4e-9 rad: by that much an independent solution of the same equations leaves them, and agrees with
the one here.  A04, Bricard's mechanism, has one freedom although its equations outnumber its joints.  The library: M.
Gonzalez et al., Engineering with Computers 26 (2010), doi 10.1007/s00366-009-0139-0.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..dynamics.inverse_kinematics import close_loops
from ..model import Joint, Link, Loop, Model, Spring
from ..model.numpy_dynamics import zero_position
from ..model.shapes import Box, Shape
from ..robot_file.servos import load_servo
from ..scene.compile import compile_scene
from .case import Case, case_of, settings

UP, DOWN = (0.0, 0.0, 1.0), (0.0, -9.81, 0.0)  # axes of planar hinges, gravity [m/s^2]
FIXED, ADAPTIVE = ("rk4", "implicit_euler", "midpoint"), {"dop853": 1e-12, "extrapolation": 1e-12, "ars343": 1e-6}
SLOW, FAST = (settings(dict.fromkeys(FIXED, h) | ADAPTIVE, 100.0 * h) for h in (2e-4, 2e-5))
FLAT, BAR = 1e-9, (0.01 * 2.0 / 12.0, 1.01 / 12.0)  # moments of inertia of bars along and across [kg m^2]


def linkages() -> list[Case]:
    """Return the three problems."""
    return [parallelograms(2), squeezer(), bricard()]


def parallelograms(windows: int, duration: float = 10.0) -> Case:
    """Turn IFToMM A02: bars of 1 kg and 1 m as upright cranks and level couplers, which start at 1 m/s.

    The couplers stay level.  So the angle x of the cranks from the upright is that of one pendulum with the inertia
    I = (n + 1) / 3 + n and the moment G = g ((n + 1) / 2 + n) of n windows: x = pi + 2 am(w t - K, m) with
    w^2 = 1/4 + G/I and m w^2 = G/I.
    """
    from scipy.special import ellipj, ellipk

    bar: Any = {"mass": 1.0, "inertia": (FLAT, 0.0, 0.0, 1.0 / 12.0, 0.0, 1.0 / 12.0)}
    links, joints, loops = [Link("ground")], [], []
    for k in range(windows + 1):
        links.append(Link(f"crank{k}", center_of_mass=(0.5, 0.0, 0.0), **bar))
        joints.append(Joint(f"crank{k}", "continuous", "ground", f"crank{k}", (float(k), 0.0, 0.0), axis=UP))
    for k in range(windows):
        links.append(Link(f"coupler{k}", center_of_mass=(0.5, 0.0, 0.0), **bar))
        joints.append(Joint(f"coupler{k}", "continuous", f"crank{k}", f"coupler{k}", (1.0, 0.0, 0.0), axis=UP))
        ends = (1.0, 0.0, 0.0), (1.0, 0.0, 0.0)
        loops.append(Loop(f"pin{k}", "connect", f"coupler{k}", f"crank{k + 1}", *ends))
    model = Model(f"parallelograms{windows}", tuple(links), tuple(joints), loops=tuple(loops))
    ratio = -DOWN[1] * ((windows + 1) / 2 + windows) / ((windows + 1) / 3 + windows)
    w = math.sqrt(0.25 + ratio)
    m, signs = ratio / w**2, np.repeat([1.0, -1.0], [windows + 1, windows])

    def turning(t: np.ndarray) -> np.ndarray:
        x = math.pi + 2.0 * ellipj(w * t - ellipk(m), m)[3]
        return np.outer(0.5 * math.pi - x, signs)

    return case_of(f"IFToMM A02, {windows} parallelograms", "precision", compile_scene(model, gravity=DOWN), duration,
                   turning(np.zeros(1))[0], -signs, record_interval=0.1, exact=turning, settings=SLOW)  # fmt: skip


SQUEEZED = (15.81077119629904, -15.75637105984298, 0.04082224013073101, -0.5347301163226948, 0.5244099658805304,
            0.5347301163226948, 1.048080741042263)  # fmt: skip
OPENED = (-0.0617138900142764496, 0.0, 0.455279819163070380, 0.222668390165885885, 0.487364979543842550,
          -0.222668390165885885, 1.23054744454982119)  # fmt: skip


def squeezer() -> Case:
    """Drive IFToMM A03, seven flat bodies, by 0.033 N m at its crank for 30 ms; published angles, in Hairer's order."""
    links = [Link("ground")]
    joints, loops = [], []

    def body(number: int, mass: float, inertia: float, parent: str, at: tuple, center: tuple) -> None:
        name = f"K{number}"
        links.append(Link(name, mass, (*center, 0.0), (FLAT, 0.0, 0.0, inertia + FLAT, 0.0, inertia)))
        joints.append(Joint(name, "continuous", parent, name, (*at, 0.0), axis=UP))

    fork, plate = (-0.06934, -0.00227), (-0.03635, 0.03273)
    body(1, 0.04325, 2.194e-6, "ground", (0.0, 0.0), (0.00092, 0.0))
    body(2, 0.00365, 4.410e-7, "K1", (0.007, 0.0), (-0.0115, 0.0))
    body(3, 0.02373, 5.255e-6, "ground", plate, (0.01043, -0.01874))
    body(5, 0.07050, 1.169e-5, "ground", fork, (0.02308, 0.00916))
    body(4, 0.00706, 5.667e-7, "K5", (0.04, 0.0), (0.0, 0.01421 - 0.02))
    body(7, 0.05498, 1.912e-5, "ground", fork, (-0.00449, -0.01228))
    body(6, 0.00706, 5.667e-7, "K7", (0.0, -0.04), (0.02 - 0.01421, 0.0))
    for name, point in (("K3", (0.0, -0.035)), ("K4", (0.0, -0.02)), ("K6", (0.02, 0.0))):
        loops.append(Loop(f"to {name}", "connect", "K2", name, (-0.028, 0.0, 0.0), (*point, 0.0)))
    model = Model("squeezer", tuple(links), tuple(joints), loops=tuple(loops))
    spring = Spring("K3", "ground", (0.02, -0.018, 0.0), (0.014, 0.072, 0.0), stiffness=4530.0, length=0.07785)
    scene = compile_scene(model, gravity=(0.0, 0.0, 0.0), springs=[spring])
    places = [("K1", "K2", "K3", "K4", "K5", "K6", "K7").index(name) for name in model.joint_names]
    start = np.array(OPENED)[places]

    def published(t: np.ndarray) -> np.ndarray:
        """Return the angles at the start and after 30 ms."""
        return np.array([start, np.array(SQUEEZED)[places]])

    torque = np.zeros(7)
    torque[0] = 0.033
    return case_of("IFToMM A03, Andrews' squeezer", "precision", scene, 0.03, start, None, record_interval=0.03,
                   tau=torque, exact=published, settings=FAST)  # fmt: skip


def bricard() -> Case:
    """Release IFToMM A04, five bars of 1 kg along the edges of a cube of 1 m and hinges across, from rest."""
    x, y, z = np.eye(3)
    along = (x, -y, z, -x, y)  # the bars, in the frame of the start
    axes = (y, z, x, y, z, x)  # hinges at their beginnings, and the last one's at the end
    links, joints = [Link("ground")], []
    for k, (bar, axis) in enumerate(zip(along, axes)):
        moments = BAR[1] - (BAR[1] - BAR[0]) * np.abs(bar)
        inertia = (moments[0], 0.0, 0.0, moments[1], 0.0, moments[2])
        links.append(Link(f"bar{k + 1}", 1.0, tuple(0.5 * bar), inertia))
        at = along[k - 1] if k else np.zeros(3)
        joints.append(Joint(f"hinge{k + 1}", "continuous", links[-2].name, links[-1].name, tuple(at), axis=tuple(axis)))
    end = np.sum(along, axis=0)
    last = Loop("hinge6", "hinge", "bar5", "ground", tuple(along[-1]), tuple(end), axis=tuple(axes[-1]))
    model = Model("Bricard", tuple(links), tuple(joints), loops=(last,))
    scene = compile_scene(model, gravity=DOWN)
    return case_of("IFToMM A04, Bricard's mechanism", "precision", scene, 10.0, np.zeros(5), None, record_interval=0.1,
                   settings=SLOW,
                   best=("extrapolation", 1e-12), check=("dop853", 1e-12))  # fmt: skip


def delta_robot() -> Model:
    """Make a delta robot that hangs: three motors, six rods of 0.35 m with ball joints at both ends, a plate."""
    out, reach, rod, apart, inner = 0.12, 0.15, 0.35, 0.03, 0.05  # [m]
    links, joints, held = [Link("base")], [], {}
    for k in range(3):
        c, s = math.cos(2.0 * math.pi * k / 3.0), math.sin(2.0 * math.pi * k / 3.0)
        links.append(Link(f"arm{k}", 0.1, (0.5 * reach * c, 0.5 * reach * s, 0.0), (2e-4, 0.0, 0.0, 2e-4, 0.0, 2e-4)))
        joints.append(Joint(f"motor{k}", "continuous", "base", f"arm{k}", (out * c, out * s, 0.0), axis=(-s, c, 0.0)))
        for side, w in (("left", -apart), ("right", apart)):
            name = f"{side}{k}"
            links.append(Link(name, 0.02, (0.0, 0.0, -0.5 * rod), (2e-4, 0.0, 0.0, 2e-4, 0.0, 1e-6)))
            joints.append(Joint(name, "ball", f"arm{k}", name, (reach * c - s * w, reach * s + c * w, 0.0)))
            held[name] = np.array([inner * c - s * w, inner * s + c * w, 0.0])
    first, end = held.pop("left0"), (0.0, 0.0, -rod)
    links.append(Link("plate", 0.1, tuple(-first), (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)))
    joints.append(Joint("plate", "ball", "left0", "plate", end))
    loops = [Loop(name, "connect", name, "plate", end, tuple(at - first)) for name, at in held.items()]
    plates = Shape("base", Box((0.3, 0.3, 0.02)), (0.0, 0.0, 0.1)), Shape("plate", Box((0.1, 0.1, 0.02)), tuple(-first))
    return Model("delta robot", tuple(links), tuple(joints), shapes=plates, loops=tuple(loops))


def parallel_ankle() -> Model:
    """Make a foot that two cranks turn about two axes by rods with ball joints at both ends."""
    down, back = 0.3, -0.04  # [m] of the ankle below the knee, and of rods behind it
    links = [Link("shank"), Link("cross", 0.02, inertia=(1e-5, 0.0, 0.0, 1e-5, 0.0, 1e-5))]
    links.append(Link("foot", 0.5, (0.03, 0.0, -0.04), (1e-3, 0.0, 0.0, 2e-3, 0.0, 2e-3)))
    joints = [Joint("pitch", "continuous", "shank", "cross", (0.0, 0.0, -down), axis=(0.0, 1.0, 0.0))]
    joints.append(Joint("roll", "continuous", "cross", "foot", axis=(1.0, 0.0, 0.0)))
    loops = []
    for side, y, z in (("left", 0.04, -0.1), ("right", -0.04, -0.15)):
        crank, rod, length = f"{side}_crank", f"{side}_rod", down + z + 0.02
        links.append(Link(crank, 0.05, (-0.02, 0.0, 0.0), (1e-5, 0.0, 0.0, 3e-5, 0.0, 3e-5)))
        links.append(Link(rod, 0.05, (0.0, 0.0, -0.5 * length), (2e-4, 0.0, 0.0, 2e-4, 0.0, 1e-6)))
        joints.append(Joint(crank, "continuous", "shank", crank, (0.0, y, z), axis=(0.0, 1.0, 0.0)))
        joints.append(Joint(rod, "ball", crank, rod, (back, 0.0, 0.0)))
        loops.append(Loop(side, "connect", rod, "foot", (0.0, 0.0, -length), (back, y, -0.02)))
    return Model("ankle", tuple(links), tuple(joints), loops=tuple(loops))


def four_bar() -> Model:
    """Make a crank of 0.1 m that a servo turns, a coupler of 0.25 m and a rocker of 0.2 m on a frame of 0.25 m."""
    bars = {"crank": 0.1, "coupler": 0.25, "rocker": 0.2}
    inertia, hinges = (1e-6, 0.0, 0.0, 2e-3, 0.0, 2e-3), (("crank", "frame", 0.0), ("coupler", "crank", bars["crank"]))
    links = [Link(name, 0.2, (0.5 * length, 0.0, 0.0), inertia) for name, length in bars.items()]
    joints = [
        Joint(name, "continuous", parent, name, (x, 0.0, 0.0), axis=(0.0, 1.0, 0.0))
        for name, parent, x in (*hinges, ("rocker", "frame", bars["coupler"]))
    ]
    pin = Loop("pin", "connect", "coupler", "rocker", (bars["coupler"], 0.0, 0.0), (bars["rocker"], 0.0, 0.0))
    servos = {"crank": load_servo("ax12")}
    return Model("four-bar", (Link("frame"), *links), tuple(joints), loops=(pin,), servos=servos)


def closed(model: Model, **angles: float) -> np.ndarray:
    """Return positions (nq,) near these angles of joints [rad], else zero, in which the loops of a model are closed."""
    q = zero_position(model)
    for name, angle in angles.items():
        q[model.position_slices[model.joint_names.index(name)].start] = angle
    return close_loops(model, q)
