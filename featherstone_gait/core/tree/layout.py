"""The data dictionary of the algorithms on the tree: a body's record, the workspace's columns, a motion.

Constants of a robot are one record per body (`BODY`), in an order where parents come first.  Row 0 is the world of a
fixed base or the floating base itself, so that no loop asks whether it is at the root.

Spatial vectors are [angular; linear], all in one common frame: world axes, origin at the robot's base.  Each body's
own frame is chosen so that its joint turns about, or slides along, z.  A joint of several degrees of freedom has a row
for each, all but the last without mass.
"""

from typing import NamedTuple

import numpy as np

from ..compile.structure import record, structure

# Measured on ABA of the humanoid (float64, a robot in lanes, first compilation): records 1.72 us, 0.34 us, 4.5 s;
# a 2-D float array and one of integers 1.79 us, 0.34 us, 4.8 s; a NamedTuple of arrays 2.02 us, 0.37 us, 5.1 s
# (AMD EPYC with AVX-512; medians of three runs, which differ by 1 % in float64 and 10 % in lanes).
BODY = record(
    parent=int,  # row of the parent
    dof=int,  # index of the joint's coordinate among the joints
    kind=int,  # of the joint: REVOLUTE ...; read by joint.py alone
    ball=int,  # of a row of a ball joint: which of the quaternions is the joint's
    carrier=int,  # row whose velocity carries the joint's axis: the parent, of a ball joint's rows that of the first
    leaf=int,  # 1 = has no children
    last=int,  # 1 = visited first among its siblings on the way back to the root
    slot=int,  # workspace row in which the children's inertias and forces are summed
    contact=int,  # workspace row in which the body's contacts are summed; 0 = has no contact points
    E=(float, 9),  # rotation body -> parent frame at zero, row by row
    r=(float, 3),  # origin of the body frame in the parent frame at zero [m]
    pitch=float,  # of a screw joint: how far it slides [m/rad]
    m=float,  # mass [kg]
    c=(float, 3),  # center of mass, body frame [m]
    J=(float, 6),  # inertia xx xy xz yy yz zz about the center of mass, body frame [kg m^2]
)

# Kinds of joints.  A ball joint is three rows, about the child's x, y and z, of which the first has its orientation.
REVOLUTE, PRISMATIC, SCREW, BALL, BALL_AXIS = range(5)

# Columns of a body's row in the workspace `W`.
R = 0  # 9: rotation body -> world, row by row
P = 9  # 3: origin of the body frame [m]
V = 12  # 6: velocity [rad/s; m/s]
A = 18  # 6: acceleration less gravity [rad/s^2; m/s^2]; in `aba` the one at zero joint acceleration
U = 24  # 6: U = IA S [kg m^2; kg m]; the last pass of `aba` replaces it by dA, what the joint accelerations add to A
DINV = 30  # 1 / D [1/(kg m^2) or 1/kg]
UU = 31  # u [N m or N]
COLUMNS = 32

# Columns of a slot: articulated (or composite) inertia [[J, H], [H', M]] and force, summed over the children.
SJ = 0  # 6: xx xy xz yy yz zz [kg m^2]
SH = 6  # 9: row by row [kg m]
SM = 15  # 6: xx xy xz yy yz zz [kg]
SF = 21  # 6: force [N m; N]; of a contact row the force that the ground exerts
TOUCH = 27  # of a contact row: 1 where a point of the body touches


@structure
class Robot(NamedTuple):
    """The constants of a robot."""

    tree: np.ndarray  # (n + 1,) BODY
    armature: np.ndarray | None  # (n,) inertia added to each joint [kg m^2 or kg]
    gravity: np.ndarray  # (3,) [m/s^2]
    coupling: np.ndarray | None = None  # (couplings,) COUPLING
    loops: tuple | None = None  # Loops
    held: tuple | None = None  # what is `held` of `fill_loops`: all are closed
    floating: bool | None = None  # True or None
    trees: None = None

    SHARED = ("tree", "armature", "gravity", "coupling", "loops", "held")


@structure
class Motion(NamedTuple):
    """Positions, velocities and accelerations; of a fixed base those of the base are None."""

    base_q: np.ndarray | None  # (7,) position [m] and quaternion w x y z
    base_qd: np.ndarray | None  # (6,) velocity (world axes) [m/s], angular velocity (body axes) [rad/s]
    base_qdd: np.ndarray | None  # (6,) their rates; None: zero
    q: np.ndarray  # (n,) [rad or m]
    qd: np.ndarray  # (n,) [rad/s or m/s]
    qdd: np.ndarray | None  # (n,) [rad/s^2 or m/s^2]; None: zero
    ball_q: np.ndarray | None = None  # (4 balls,) quaternions w x y z child -> parent; None: no ball joints
