"""A biped of the size of a Bioloid for the walking tests: trunk and two legs of six joints, hip rotation locked.

Anchors, masses and boxes are those of the scene bioloid2.xml of the SimTwo repository (P33a/SimTwo at 659c8cd),
mirrored from the left side; arms and head are lumped into the trunk, the sole is centered 10 mm outside the ankle.
"""

from dataclasses import replace

import numpy as np

from featherstone_gait.model import ContactPoint, Joint, Link, Model

ANCHORS = {
    "hip_rotation": (-0.027, 0.030, -0.073),
    "hip_lateral": (-0.055, 0.032, -0.103),
    "hip_front": (-0.055, 0.032, -0.103),
    "knee": (-0.039, 0.030, -0.170),
    "ankle_front": (-0.027, 0.030, -0.247),
    "ankle_lateral": (-0.022, 0.030, -0.247),
}
AXES = dict(zip(ANCHORS, ((0, 0, 1), (1, 0, 0), (0, 1, 0), (0, -1, 0), (0, -1, 0), (1, 0, 0))))
LIMITS = dict(zip(ANCHORS, ((-75, 75), (-90, 90), (-75, 75), (-98, 32), (-10, 125), (-30, 100))))  # left [deg]
MASSES = dict(zip(ANCHORS, (0.143, 0.001, 0.172, 0.082, 0.143, 0.039)))  # of the links below the joints [kg]
CENTERS = {
    "hip_rotation": (-0.035, 0.033, -0.085),
    "hip_lateral": (-0.055, 0.032, -0.103),
    "hip_front": (-0.030, 0.033, -0.120),
    "knee": (-0.030, 0.033, -0.200),
    "ankle_front": (-0.035, 0.033, -0.240),
    "ankle_lateral": (-0.035, 0.040, -0.280),
}
SOLE = [(-0.035 + x, 0.040 + y, -0.2965) for x in (-0.05, 0.05) for y in (-0.03, 0.03)]


def box_inertia(mass, x, y, z):
    return (mass * (y * y + z * z) / 12, 0.0, 0.0, mass * (x * x + z * z) / 12, 0.0, mass * (x * x + y * y) / 12)


def leg(side):
    s = 1.0 if side == "left" else -1.0
    flip = np.array([1.0, s, 1.0])
    links, joints, parent, origin = [], [], "trunk", np.zeros(3)
    for name, anchor in ANCHORS.items():
        child, anchor = f"{side}_{name}_link", np.array(anchor) * flip
        low, high = np.radians(LIMITS[name])
        if s < 0 and name == "ankle_lateral":
            low, high = -high, -low
        xyz = tuple(anchor - origin)
        joints.append(Joint(f"{side}_{name}", "revolute", parent, child, xyz, axis=AXES[name], lower=low, upper=high))
        center = tuple(np.array(CENTERS[name]) * flip - anchor)
        links.append(Link(child, MASSES[name], center, box_inertia(MASSES[name], 0.06, 0.04, 0.06)))
        parent, origin = child, anchor
    contacts = tuple(ContactPoint(child, tuple(np.array(corner) * flip - anchor)) for corner in SOLE)
    return links, joints, contacts


def biped(hip_rotation_locked=True):
    """Return the biped; with free hip rotation its legs have six joints."""
    trunk = Link("trunk", 1.263, (-0.03, 0.0, 0.017), box_inertia(1.263, 0.08, 0.16, 0.14))
    parts = [leg("left"), leg("right")]
    links = (trunk, *parts[0][0], *parts[1][0])
    joints = (*parts[0][1], *parts[1][1])
    locked = {"left_hip_rotation": 0.0, "right_hip_rotation": 0.0} if hip_rotation_locked else {}
    return Model("biped", links, joints, "floating", locked, contacts=(*parts[0][2], *parts[1][2]))


def without_contacts():
    return replace(biped(), contacts=())
