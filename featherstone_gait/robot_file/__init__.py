"""Robots from files: what the robot is from URDF or MJCF, what these cannot say from a TOML file of the same stem.

The URDF (https://wiki.ros.org/urdf/XML) gives links and joints.  The TOML gives the base, the servos, the points that
can touch the ground and named sets of locked joints and postures::

    base = "floating"                    # or "fixed", the default
    contacts = [{link = "left_foot", position = [0.05, 0.03, -0.05]}]    # or "feet", "all", ["left_foot"]: of shapes

    [servos]                             # for every revolute and continuous joint
    default = "ax12"                     # ax12.toml beside this file, else robots/servos/ax12.toml
    gearbox = "physical"                 # one of that file's presets; without [gearboxes] it states its one gearbox
    voltage_limit = 9.6                  # any field of Servo, Controller or Gearbox overrides
    [servos.joints.neck]                 # for one joint: type, gearbox and any field
    current_limit = 0.1

    [supply]                             # the source of all servos; without it each has its own voltage_limit
    voltage = 11.1                       # [V]
    resistance = 0.15                    # [Ohm]

    [joints.neck]                        # what URDF cannot say of a joint
    armature = 1e-4                      # inertia of what turns with it [kg m^2]

    [keyframes.crouch]                   # a named posture, in `Model.keyframes`; joints not named are at 0
    base = [0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]                           # x y z and quaternion, of a floating base
    joints.left_knee = 0.8

    [locked.default]                     # locked by default
    [locked.simplified]                  # load_robot(..., locked="simplified")
    left_elbow_deg = 45.0

All numbers are SI; the angles `encoder_resolution`, `backlash`, `compliance_margin` and locked positions may carry
`_deg`.

A URDF that has one meaning is read: `Model.notes` lists what was ignored or assumed, a RobotFileWarning says so,
and ``load_robot(..., strict=True)`` refuses it.  What has no meaning is refused, all of it at once.  The TOML is read
strictly (`docs/toml_keys.md` lists its keys); only dry friction without a `stick_speed`, of a servo whose file has one,
is warned about.  Of other files only meshes are opened, where contact points or clearances of such shapes are needed.
"""

from .load import load_robot
from .report import RobotFileError, RobotFileNotFoundError, RobotFileWarning
from .save import save_robot
from .servos import gearbox_presets, load_servo
from .source import robot_names, scene_names

__all__ = [
    "RobotFileError",
    "RobotFileNotFoundError",
    "RobotFileWarning",
    "gearbox_presets",
    "load_robot",
    "load_servo",
    "robot_names",
    "save_robot",
    "scene_names",
]
