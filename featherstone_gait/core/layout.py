"""The data dictionary of the kernels: every record field and workspace column, its shape, unit and meaning.

Constants of a robot are one record per body (`BODY`), in an order where parents come first.  Row 0 is the world of a
fixed base or the floating base itself, so that no loop asks whether it is at the root.

Spatial vectors are [angular; linear], all in one common frame: world axes, origin at the robot's base.  Each body's
own frame is chosen so that its joint turns about, or slides along, z.
"""

import numpy as np

# Measured on ABA of the humanoid (float64, a robot in lanes, first compilation): records 1.72 us, 0.34 us, 4.5 s;
# a 2-D float array and one of integers 1.79 us, 0.34 us, 4.8 s; a NamedTuple of arrays 2.02 us, 0.37 us, 5.1 s
# (AMD EPYC with AVX-512; medians of three runs, which differ by 1 % in float64 and 10 % in lanes).
BODY = np.dtype(
    [
        ("parent", np.int64),  # row of the parent
        ("dof", np.int64),  # index of the joint's coordinate among the joints
        ("prismatic", np.int64),  # 1 = slides along z, 0 = turns about z
        ("leaf", np.int64),  # 1 = has no children
        ("last", np.int64),  # 1 = visited first among its siblings on the way back to the root
        ("slot", np.int64),  # workspace row in which the children's inertias and forces are summed
        ("contact", np.int64),  # workspace row in which the body's contacts are summed; 0 = has no contact points
        ("E", np.float64, (9,)),  # rotation body -> parent frame at zero, row by row
        ("r", np.float64, (3,)),  # origin of the body frame in the parent frame at zero [m]
        ("m", np.float64),  # mass [kg]
        ("c", np.float64, (3,)),  # centre of mass, body frame [m]
        ("J", np.float64, (6,)),  # inertia xx xy xz yy yz zz about the centre of mass, body frame [kg m^2]
    ],
    align=True,
)

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

# Where each part of a simulation's state starts in its flat vector `y`.  What a scene lacks has no room there.
# The parts up to `voltage` obey differential equations; the rest changes at ticks or is an output of the last step.
STATE = np.dtype(
    [
        (name, np.int64)
        for name in (
            "base_q",  # 7: position [m] and quaternion w x y z of a floating base
            "q",  # n [rad or m]
            "base_qd",  # 6: velocity (world axes) [m/s], angular velocity (body axes) [rad/s]
            "qd",  # n [rad/s or m/s]
            "current",  # n, motor currents [A]
            "rotor",  # n, rotor angles over G [rad]
            "rotor_speed",  # n, rotor speeds over G [rad/s]
            "filtered",  # n, filtered joint speeds [rad/s]
            "bristle",  # 2 a contact point: tangential deflection in the ground's axes [m]
            "energy",  # ENERGIES a joint: integrals since the start [J]
            "contact_work",  # 1: work of the ground on the robot [J]
            "voltage",  # n, held over a tick [V]
            "integral",  # n, of the controller's error [rad s or rad]
            "last_error",  # n [rad or rad/s]
            "base_qdd",  # 6, as base_qd [per s]
            "qdd",  # n [rad/s^2 or m/s^2]
            "torque",  # n, mean of the last step, at the joint [N m or N]
            "contact_force",  # 3 a contact point: normal, two tangential [N]
            "increment",  # n, last change of qd
            "chatter",  # n, running mean of alternating less lasting changes of qd [rad/s]
            "worst_chatter",  # n, its largest value so far
            "passes",  # 2: passes of Newton's iteration so far, steps in which it did not converge
            "pace",  # 6, of error control: see core/pace.py
            "status",  # 1: see STATUS in simulation.py
            "end",  # 1: time reached, of a run that failed the time of that [s]
            "length",  # of the state
        )
    ]
)

# Columns of the energies of a joint [J]; what goes in is the supply, what comes out the work on the joint.
SUPPLY = 0  # integral of V I
METER = 1  # integral of max(0, V I), the paper's meter
COPPER = 2  # R I^2
DRIVER = 3  # what current limit and slew take: V I - R I^2 - K omega I - L I dI/dt
FRICTION = 4  # viscous and Coulomb friction, at the joint and at the rotor
GEAR = 5  # damping of the gearbox
STOPS = 6  # work done on the joint stops, elastic part included
WORK = 7  # mechanical work on the joint by what drives it
ENERGIES = 8

# Columns of the servo parameters, one row a joint; torques and speeds at the output side.
KT = 0  # G K [N m/A] = [V s/rad]
RES = 1  # R [Ohm]
IND = 2  # L [H]
VMAX = 3  # [V]
IMAX = 4  # [A]
SLEW = 5  # [A/s]
KP = 6  # [V/rad] ...
KI = 7
KD = 8
KF = 9
ENCODER = 10  # [rad], 0 = exact
FILTER = 11  # time constant [s]
DECAY = 12  # exp(-h R/L), 0 without inductance: what is left of a current after a step
MEAN = 13  # (1 - DECAY) / (h R/L): its mean over the step
FADE = 14  # exp(-h / FILTER), 0 without a filter
BV = 15  # viscous friction of the servo [N m s/rad], as the 2012 integrator applies it
SERVO_COLUMNS = 16

# Columns of the gearbox parameters (spring-damper), output side.
STIFFNESS = 0  # [N m/rad]
DAMPING = 1  # [N m s/rad]
GAP = 2  # half the backlash [rad]
INERTIA = 3  # G^2 J [kg m^2]
ROTOR_DAMPING = 4  # G^2 B_vr [N m s/rad]
RATIO = 5  # G
TOOTH_D = 6  # Hunt-Crossley damping of teeth that meet across a gap [s/rad]
GEAR_COLUMNS = 7

# Columns of the continuous servo (pd).
PD_KP = 0  # [N m/rad]
PD_KD = 1  # [N m s/rad]
PD_LIMIT = 2  # [N m]
PD_OUTSIDE = 3  # 1 = the damping stays outside the limit
PD_FOLD = 4  # 1 = the spring acts at the end of the step, 0 = at its start
PD_COLUMNS = 5

# Columns of friction and joint stops.
VISCOUS = 0  # [N m s/rad]
COULOMB = 1  # [N m]
FRICTION_COLUMNS = 2
LOWER = 0  # [rad]
UPPER = 1  # [rad]
STOP_K = 2  # [N m/rad]
STOP_D = 3  # Hunt-Crossley damping [s/rad]
STOP_COLUMNS = 4

# Columns of a contact point.
CX = 0  # 3: position in the body's frame [m]
CK = 3  # normal stiffness [N/m]
CD = 4  # Hunt-Crossley damping [s/m]
CMU = 5  # coefficient of friction
CTK = 6  # tangential stiffness [N/m]
CTD = 7  # tangential damping [N s/m]
CONTACT_COLUMNS = 8

# Columns of the ground: row 0 holds normal (3), first (3) and second (3) tangent, height of the plane over the origin
# along the normal; each further row a step: where it begins along the first tangent and by how much it rises [m].
GN = 0
GT = 3
GS = 6
GH = 9
GROUND_COLUMNS = 10
