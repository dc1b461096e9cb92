"""Settings of the engine, records that the kernels read, and the columns of the arrays that they overwrite.

Body 0 is the world, which has no inertia to give: its inverse mass is zero.  Vectors are in world axes unless said
otherwise, linear before angular, as in a body's twist about its center of mass.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from ...base.arguments import real, truth, whole
from ...core.compile.structure import record, structure


@dataclass(frozen=True)
class Engine:
    """Settings of the engine; the defaults are those with which SimTwo ran ODE's QuickStep in 2012.

    Attributes
    ----------
    iterations : int
        Sweeps of the projected successive over-relaxation; 0 solves the same problem directly, as ODE's dWorldStep.
    erp : float
        Share of a position error that a step corrects.
    cfm : float
        Compliance of constraints and contacts [m/(s N) or rad/(s N m)].
    bounce : float
        Coefficient of restitution.
    linear_damping, angular_damping : float
        Share of a velocity that a step removes.
    single : bool
        Round positions, velocities and constraint forces to single precision.
    per_step : bool
        Slew and filter of servos act per step as at 1 ms; False: per second.
    hardening : float
        Of a gearbox's spring, K (1 + hardening |e|) e [1/rad].
    damper_share : float
        Rotor speed that a gearbox's damper may change in a step [rad/s].
    """

    iterations: int = 10
    erp: float = 0.4
    cfm: float = 1e-5
    bounce: float = 0.6
    linear_damping: float = 1e-5
    angular_damping: float = 1e-3
    single: bool = True
    per_step: bool = True
    hardening: float = 1.0
    damper_share: float = 0.2

    def __post_init__(self) -> None:
        whole("iterations", self.iterations, 0, "it is a number of sweeps", 10**6)
        for name in ("single", "per_step"):
            truth(name, getattr(self, name))
        for name in ("erp", "bounce", "linear_damping", "angular_damping"):
            real(name, getattr(self, name), 0.0, 1.0, "it is a share")
        for name in ("cfm", "hardening", "damper_share"):
            real(name, getattr(self, name), 0.0, 1e9, "it cannot be negative")


ENGINE = record(**{field.name: float if field.type == "float" else int for field in fields(Engine)})
EXACT = Engine(
    iterations=0, cfm=1e-10, bounce=0.0, linear_damping=0.0, angular_damping=0.0, single=False, per_step=False,
    hardening=0.0, damper_share=1e9,
)  # fmt: skip
"""Rigid constraints, solved: what the equations of motion are in the limit of small steps."""

BODY = record(
    row=int,  # of the tree; of no use for the world
    mass=float,  # [kg]
    inverse_mass=float,  # [1/kg], 0 of what does not move
    center=(float, 3),  # of mass, in the frame of the tree's row [m]
    inertia=(float, 6),  # xx xy xz yy yz zz about it, the same axes [kg m^2]
    inverse_inertia=(float, 6),  # [1/(kg m^2)]
)

JOINT = record(
    universal=int,  # 1: a universal joint, 0: a hinge
    a=int,  # body
    b=int,  # body that it carries
    anchor_a=(float, 3),  # from the center of mass of a, its axes [m]
    anchor_b=(float, 3),
    first=(float, 9),  # a's axes -> those of the joint at zero, whose z is the (first) axis
    second=(float, 9),  # of a universal joint: from there to b's axes at zero, z the second axis
    axis=int,  # its row of AXIS, the index of its coordinate
    second_axis=int,  # of a universal joint
)

AXIS = record(
    lower=float,  # [rad]
    upper=float,  # [rad]
    dry=float,  # friction of joint and servo [N m]
    damping=float,  # of the joint [N m s/rad]
    viscous=float,  # friction of the servo, on the filtered speed [N m s/rad]
    filter_left=float,  # of the filtered speed's deviation after a step [-]
    slew=float,  # of the current in a step [A]
    voltage_limit=float,  # of the back-EMF [V]
    damper_limit=float,  # of the torque of a gearbox's damper, at the output [N m]
    hardening=float,  # of its spring: K (1 + hardening |e|) e [1/rad]
)

POINT = record(
    body=int,
    position=(float, 3),  # from its center of mass, its axes [m]
    axes=(float, 9),  # normal of the ground and two tangents
    height=float,  # of the ground over the origin, along the normal [m]
    friction=float,
)

# Columns of a body's row in X: its state, and what follows from it.
PLACE = 0  # 3: center of mass [m]
TURN = 3  # 4: quaternion w x y z, body -> world
SPEED = 7  # 3: [m/s]
SPIN = 10  # 3: [rad/s]
R = 13  # 9: rotation, row by row
INVERSE = 22  # 6: inverse inertia, world axes [1/(kg m^2)]
FORCE = 28  # 3: applied [N]
MOMENT = 31  # 3: applied [N m]
COLUMNS = 34

ROW = record(
    a=int,  # bodies
    b=int,
    target=float,  # of the velocity [m/s or rad/s]
    soft=float,  # CFM / h
    low=float,  # bound of the force; of a friction row in shares of the normal one
    high=float,
    force=float,  # lambda [N or N m]
    right=float,  # right side [1/s]
    divisor=float,  # diagonal of the system, with what is soft
    normal=int,  # row whose force bounds this one's, -1 if none
    state=int,  # which bound holds, in a direct solution
    shown=int,  # place of its force among those of the contacts, -1 if none
)


@structure
class World(NamedTuple):
    """Arrays that do not change during a run."""

    bodies: np.ndarray  # (nb,) BODY
    joints: np.ndarray  # (joints,) JOINT
    axes: np.ndarray  # (n,) AXIS, by coordinate
    points: np.ndarray  # (points,) POINT
    engine: np.ndarray  # (1,) fields of `Engine`


@structure
class Work(NamedTuple):
    """Arrays that every step overwrites."""

    q: np.ndarray  # (n,) angles and rates of the axes, in the state
    qd: np.ndarray
    torque: np.ndarray  # (n,) of each axis
    X: np.ndarray  # (nb, COLUMNS)
    rows: np.ndarray  # (rows,) ROW
    J: np.ndarray  # (rows, 12) Jacobian: linear, angular, of both bodies
    M: np.ndarray  # (rows, 12) inverse mass times Jacobian
    S: np.ndarray  # (nb, 6) accelerations by the constraints
    order: np.ndarray  # (rows,) of a sweep
    D: np.ndarray  # (rows, rows + 1) of the direct solution, without rows where there is none
    random: np.ndarray  # (2,) state of the generator
    unsolved: np.ndarray  # (1,) number of steps without a direct solution
    tree: np.ndarray  # workspace of the tree
