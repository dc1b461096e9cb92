"""The model of a robot: links, joints, servos, shapes and the ground, checked when they are made."""

from .checks import LARGEST
from .fluid import Fluid, Immersed, Propeller
from .ground import ContactPoint, FloorLine, Ground, HeightField, stairs
from .links import Joint, Link, Mimic, Spring
from .loop import Loop
from .rigid_bodies import Placement, RigidBody, inertia_matrix
from .robot import Base, Model, depth_first, rigid_bodies
from .servo import FIRMWARE, SERVO_UNITS, TORQUE_LAWS, Controller, Gearbox, Law, Servo, Supply, depends_on_load_or_speed
from .surface import Surface
from .tendon import Tendon, Via, Wrap

__all__ = [
    "FIRMWARE", "LARGEST", "SERVO_UNITS", "TORQUE_LAWS", "Base", "ContactPoint", "Controller", "FloorLine", "Fluid",
    "Gearbox", "Ground", "HeightField", "Immersed", "Joint", "Law", "Link", "Loop", "Mimic", "Model", "Placement",
    "Propeller", "RigidBody", "Servo", "Spring", "Supply", "Surface", "Tendon", "Via", "Wrap",
    "depends_on_load_or_speed",
    "depth_first", "inertia_matrix", "rigid_bodies", "stairs",
]  # fmt: skip
