"""Make a biped of 25 cm with 14 XL330 servos: two legs of six joints, neck and head, as a printed robot has them.

A network of our own walks with it, `NETWORK` with the description beside it (`tests/support/little_policy.py`).

A servo weighs 18 g (ROBOTIS e-manual, XL330-M288-T) and is 20 x 34 x 26 mm; a link is a servo with its bracket, 25 g.
The trunk has a battery, a computer and the servos of hips and neck.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..model import ContactPoint, Joint, Link, Model
from ..robot_file import load_servo

NETWORK = Path(__file__).with_name("little_biped_walk.onnx")
LIMB = 0.025  # [kg] of a link of a leg
THIGH, SHIN, SOLE, HIP, HALF = 0.055, 0.055, 0.025, 0.035, 0.03  # lengths, height of ankle, of hip below the trunk [m]
FOOT = (0.08, 0.046)  # [m]
CHAIN = {  # joint of a leg: axis, place in its parent, limits [rad], center and size of the box of its link [m]
    "hip_yaw": ((0, 0, 1), (0.0, 0.0, -HIP), (-0.6, 0.6), (0.0, 0.0, 0.0), (0.02, 0.034, 0.026)),
    "hip_roll": ((1, 0, 0), (0.0, 0.0, 0.0), (-0.6, 0.6), (0.0, 0.0, 0.0), (0.034, 0.02, 0.026)),
    "hip_pitch": ((0, 1, 0), (0.0, 0.0, 0.0), (-1.6, 0.8), (0.0, 0.0, -0.5 * THIGH), (0.026, 0.02, 0.034)),
    "knee": ((0, 1, 0), (0.0, 0.0, -THIGH), (0.0, 2.2), (0.0, 0.0, -0.5 * SHIN), (0.026, 0.02, 0.034)),
    "ankle_pitch": ((0, 1, 0), (0.0, 0.0, -SHIN), (-1.4, 1.0), (0.0, 0.0, 0.0), (0.026, 0.034, 0.02)),
    "ankle_roll": ((1, 0, 0), (0.0, 0.0, 0.0), (-0.6, 0.6), (0.01, 0.0, -0.018), (*FOOT, 0.012)),
}


def box(mass: float, x: float, y: float, z: float) -> tuple[float, ...]:
    """Return xx, xy, xz, yy, yz, zz of the inertia of a box about its center."""
    return (mass * (y * y + z * z) / 12, 0.0, 0.0, mass * (x * x + z * z) / 12, 0.0, mass * (x * x + y * y) / 12)


def little_biped(servo: str = "xl330", **numbers: Any) -> Model:
    """Return the robot, with a servo of the package in all joints; numbers: of the servo that differ."""
    links = [Link("trunk", 0.23, (0.0, 0.0, 0.0), box(0.23, 0.05, 0.08, 0.07))]
    joints, points = [], []
    for side, s in (("left", 1.0), ("right", -1.0)):
        parent = "trunk"
        for name, (axis, place, (low, high), center, size) in CHAIN.items():
            child = f"{side}_{name}_link"
            if name == "hip_yaw":
                place = (0.0, s * HALF, place[2])
            joints.append(Joint(f"{side}_{name}", "revolute", parent, child, place, axis=axis, lower=low, upper=high))
            links.append(Link(child, LIMB, center, box(LIMB, *size)))
            parent = child
        corners = [(0.01 + x * FOOT[0] / 2, y * FOOT[1] / 2, -SOLE) for x in (-1, 1) for y in (-1, 1)]
        points += [ContactPoint(parent, corner) for corner in corners]
    joints.append(
        Joint("neck_pitch", "revolute", "trunk", "neck", (0.01, 0.0, 0.045), axis=(0, 1, 0), lower=-0.8, upper=0.8)
    )
    joints.append(
        Joint("head_yaw", "revolute", "neck", "head", (0.0, 0.0, 0.02), axis=(0, 0, 1), lower=-1.2, upper=1.2)
    )
    links += [Link("neck", LIMB, (0.0, 0.0, 0.01), box(LIMB, 0.02, 0.034, 0.026))]
    links += [Link("head", 0.05, (0.01, 0.0, 0.02), box(0.05, 0.05, 0.05, 0.04))]
    each = load_servo(servo, **numbers)
    servos = {joint.name: each for joint in joints}
    return Model("little_biped", tuple(links), tuple(joints), "floating", contacts=tuple(points), servos=servos)
