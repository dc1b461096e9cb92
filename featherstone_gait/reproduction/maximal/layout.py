"""Records that the kernels read and overwrite: those of bodies, joints and contacts, and the columns of the workspace.

Body 0 is the world, which has no inertia to give: its inverse mass is zero.  Vectors are in world axes unless said
otherwise, linear before angular, as in a body's twist about its center of mass.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...core.compile.structure import structure

BODY = np.dtype(
    [
        ("row", np.int64),  # of the tree; -1 of the world of a floating robot
        ("mass", np.float64),  # [kg]
        ("inverse_mass", np.float64),  # [1/kg], 0 of what does not move
        ("center", np.float64, (3,)),  # of mass, in the frame of the tree's row [m]
        ("inertia", np.float64, (6,)),  # xx xy xz yy yz zz about it, the same axes [kg m^2]
        ("inverse_inertia", np.float64, (6,)),  # [1/(kg m^2)]
    ],
    align=True,
)

HINGE, UNIVERSAL, WELD = 0, 1, 2
JOINT = np.dtype(
    [
        ("kind", np.int64),  # one of these
        ("a", np.int64),  # body
        ("b", np.int64),  # body that it carries
        ("anchor_a", np.float64, (3,)),  # from the center of mass of a, its axes [m]
        ("anchor_b", np.float64, (3,)),
        ("first", np.float64, (9,)),  # a's axes -> those of the joint at zero, whose z is the (first) axis
        ("second", np.float64, (9,)),  # of a universal joint: from there to b's axes at zero, z the second axis
        ("phase_sine", np.float64),  # of the angle about the first axis at which the second one stands at zero
        ("phase_cosine", np.float64),
        ("axis", np.int64),  # row of AXIS, of a universal joint the first of two
    ],
    align=True,
)

AXIS = np.dtype(
    [
        ("dof", np.int64),  # index of its coordinate
        ("lower", np.float64),  # [rad]
        ("upper", np.float64),  # [rad]
        ("dry", np.float64),  # friction [N m]
        ("damping", np.float64),  # of the joint [N m s/rad]
    ],
    align=True,
)

DRIVE = np.dtype(
    [
        ("on", np.int64),  # 0: of a joint that is held by a constraint
        ("viscous", np.float64),  # of the servo, on the filtered speed [N m s/rad]
        ("filter_left", np.float64),  # of the filtered speed's deviation after a step [-]
        ("slew", np.float64),  # of the current in a step [A]
        ("voltage_limit", np.float64),  # of the back-EMF [V]
        ("damper_limit", np.float64),  # of the torque of a gearbox's damper, at the output [N m]
        ("hardening", np.float64),  # of its spring: K (1 + hardening |e|) e [1/rad]
    ],
    align=True,
)

POINT = np.dtype(
    [
        ("a", np.int64),  # body
        ("position", np.float64, (3,)),  # from its center of mass, its axes [m]
        ("radius", np.float64),  # [m]
        ("b", np.int64),  # body of the plane
        ("normal", np.float64, (3,)),  # of the plane, axes of b
        ("first", np.float64, (3,)),  # tangents
        ("second", np.float64, (3,)),
        ("height", np.float64),  # of the plane over b's center of mass, along the normal [m]
        ("friction", np.float64),
        ("place", np.int64),  # of its force in the state, from the first point's
    ],
    align=True,
)

# Columns of a body's row in X.
PLACE = 0  # 3: center of mass [m]
TURN = 3  # 4: quaternion w x y z, body -> world
SPEED = 7  # 3: [m/s]
SPIN = 10  # 3: [rad/s]
R = 13  # 9: rotation, row by row
INVERSE = 22  # 6: inverse inertia, world axes [1/(kg m^2)]
FORCE = 28  # 3: applied [N]
MOMENT = 31  # 3: applied [N m]
COLUMNS = 34

# Columns of a constraint's row in V; of its Jacobian there are twelve numbers: of a linear, angular, of b the same.
TARGET = 0  # of the velocity [m/s or rad/s]
SOFT = 1  # CFM
LOW = 2  # of the force; of a friction row in shares of the normal one
HIGH = 3
LAMBDA = 4  # force [N or N m]
RIGHT = 5  # right side [1/s]
DIAGONAL = 6  # of the system, with what is soft
NUMBERS = 7
# Columns in I.
A, B, NORMAL = 0, 1, 2  # bodies; row whose force bounds this one's, -1 if none
STATE = 3  # which bound holds, in a direct solution
TOUCHED = 4  # of the first row of a contact: which point
INTEGERS = 5


@structure
class World(NamedTuple):
    """Arrays and numbers that do not change during a run."""

    bodies: np.ndarray  # (nb,) BODY
    joints: np.ndarray  # (joints,) JOINT
    axes: np.ndarray  # (n,) AXIS
    points: np.ndarray  # (points,) POINT
    engine: np.ndarray  # (1,) fields of `Engine`
    drive: np.ndarray  # (n,) DRIVE, by coordinate


@structure
class Work(NamedTuple):
    """Arrays that every step overwrites."""

    X: np.ndarray  # (nb, COLUMNS)
    J: np.ndarray  # (rows, 12) Jacobian
    M: np.ndarray  # (rows, 12) inverse mass times Jacobian
    V: np.ndarray  # (rows, NUMBERS)
    I: np.ndarray  # (rows, INTEGERS)
    S: np.ndarray  # (nb, 6) accelerations by the constraints
    order: np.ndarray  # (rows,) of a sweep
    D: np.ndarray  # (rows, rows + 1) of the direct solution, (1, 1) where there is none
    angles: np.ndarray  # (n, 3) angle, rate and torque of each axis
    random: np.ndarray  # (2,) state of the generator
    counts: np.ndarray  # (4,) rows of the last step, steps without a direct solution, sweeps there, steps
