"""Write MJCF.

Numbers are written to the last bit; MuJoCo converts angles and inertias to rounding.
"""

from __future__ import annotations

import math
import sys
from dataclasses import astuple
from typing import TypeAlias

import numpy as np

from ...base.fixed_order import applied, product
from ...base.rotation import rotation_from_rpy, rpy_from_rotation
from ...model import Ground, Joint, Model, depth_first, rigid_bodies
from ...model.rigid_bodies import held_frame
from ..markup import comment, element
from .names import unused
from .tree import NO_STOP, WORLD
from .write_actuators import actuator_lines, passive
from .write_geoms import field_lines, floor_lines, geom_lines, mesh_lines, unread_meshes
from .write_inertia import Inertials, inertials

Pose: TypeAlias = tuple[np.ndarray, np.ndarray]  # rotation (3, 3) and origin (3,) [m]

LEAST_EFFORT = sys.float_info.min  # [N m or N]


def mjcf_text(model: Model, ground: Ground | None = None) -> str:
    """Write the robot as MJCF, with a floor if ground is given.

    Raises ValueError for what MJCF cannot state, and for moving bodies with an inertia that no rigid body has.
    """
    _check_bodies(model)
    inertias, changed = inertials(model)
    actuators, lacking = actuator_lines(model)
    floor, steps = floor_lines(model, ground)
    couplings = [(joint.name, joint.mimic) for joint in model.moving_joints if joint.mimic]
    sections = {
        "asset": [*mesh_lines(model), *field_lines(ground)],
        "worldbody": [*floor, *_root_lines(model, inertias)],
        "equality": [
            line
            for name, (leader, b, a) in ((name, astuple(mimic)) for name, mimic in couplings)
            for line in element("joint", {"joint1": name, "joint2": leader, "polycoef": (a, b, 0, 0, 0)})
        ],
        "actuator": actuators,
        "keyframe": _key_lines(model),
    }
    inside = [
        *(comment(remark) for remark in (*lacking, *steps, *changed, *_remarks(model))),
        *element("compiler", {"angle": "radian", "eulerseq": "XYZ", "autolimits": "true"}),
        *(element("option", {"cone": "elliptic"}) if ground else []),
        *(line for tag, lines in sections.items() if lines for line in element(tag, {}, lines)),
    ]
    return "\n".join([*element("mujoco", {"model": model.name}, inside), ""])


def _remarks(model: Model) -> list[str]:
    remarks = []
    if any(joint.velocity < math.inf for joint in model.joints):
        remarks.append("MJCF cannot state the largest velocity of a joint")
    if model.held:
        remarks.append("joints that are held are welded: " + ", ".join(model.held))
    if idle := [joint.name for joint in model.moving_joints if joint.effort == 0]:
        remarks.append("MJCF cannot state an effort of 0; replaced by the smallest number: " + ", ".join(idle))
    if any(link.name == WORLD for link in model.links) and not _is_world(model):
        remarks.append(f"link 'world' is called {_body_name(model, WORLD)!r}")
    if unread_meshes(model):
        remarks.append("left out meshes that MuJoCo does not find or read: " + ", ".join(unread_meshes(model)))
    if model.contacts:
        remarks.append("contact points are small spheres and flat cylinders; shapes touch nothing beside them")
    return remarks


def _check_bodies(model: Model) -> None:
    """Refuse massless bodies that are no plain link between two joints."""
    folded = {link.name for link in model.links if _is_frame(model, link.name)}
    for body in rigid_bodies(model)[0][1:]:
        if body.mass == 0 and not set(body.links) <= folded:
            raise ValueError(
                f"link {body.links[0]!r} moves without mass and is no plain link between two joints, which MJCF cannot "
                "state: give it a small mass and inertia"
            )


# ---------------------------------------------------------------------------------------------- bodies


def _root_lines(model: Model, inertias: Inertials) -> list[str]:
    inside = _inside(model, model.root, inertias)
    if _is_world(model):
        return inside[model.root in inertias :]
    free = ["<freejoint/>"] if model.base == "floating" else []
    return element("body", {"name": _body_name(model, model.root)}, [*free, *inside])


def _inside(model: Model, link: str, inertias: Inertials) -> list[str]:
    """Write what a link's body holds besides its joints."""
    children = [line for joint in model.joints if joint.parent == link for line in _child_lines(model, joint, inertias)]
    return [*inertias.get(link, []), *geom_lines(model, link), *children]


def _child_lines(model: Model, joint: Joint, inertias: Inertials) -> list[str]:
    """Write the body at the end of a joint, or of a chain of joints between massless links."""
    chain = [joint]
    while chain[-1].name in model.joint_rows and _is_frame(model, chain[-1].child):
        chain.append(next(j for j in model.joints if j.parent == chain[-1].child))
    poses = _poses(model, chain)
    E, r = poses[-1]
    plain = len(chain) == 1 and joint.name not in model.held
    xyz, rpy = (joint.xyz, joint.rpy) if plain else (r, rpy_from_rotation(E))
    moving = [(j, pose) for j, pose in zip(chain, poses) if j.name in model.joint_rows]
    joints = [line for j, pose in moving for line in _joint_lines(model, j, pose, poses[-1])]
    link = chain[-1].child
    attributes = {"name": _body_name(model, link), "pos": xyz, "euler": rpy}
    return element("body", attributes, [*joints, *_inside(model, link, inertias)])


def _is_world(model: Model) -> bool:
    """Return whether the root link is MuJoCo's world."""
    return model.root == WORLD and model.base == "fixed" and model.link(model.root).mass == 0


def _body_name(model: Model, link: str) -> str:
    """Return the name of a link's body: its own, unless it is the name of MuJoCo's world."""
    return unused(WORLD, model.link_rows) if link == WORLD else link


def _is_frame(model: Model, name: str) -> bool:
    """Return whether a link is only a place between two joints that move."""
    link = model.link(name)
    ends = [joint for joint in model.joints if name in (joint.parent, joint.child)]
    carries = {shape.link for shape in model.shapes} | {point.link for point in model.contacts}
    plain = link.mass == 0 and not any(link.inertia) and name != model.root and name not in carries
    return plain and len(ends) == 2 and all(joint.name in model.joint_rows for joint in ends)


def _poses(model: Model, chain: list[Joint]) -> list[Pose]:
    """Compute rotation and origin of each joint's child frame in the frame of the chain, with held joints in place."""
    E, r, poses = np.eye(3), np.zeros(3), []
    for joint in chain:
        E, r = product(E, rotation_from_rpy(joint.rpy)), r + applied(E, np.array(joint.xyz))
        E, r = held_frame(joint, model.held.get(joint.name, 0.0), E, r)
        poses.append((E, r))
    return poses


def _joint_lines(model: Model, joint: Joint, at: Pose, body: Pose) -> list[str]:
    """Write a joint, whose frame and whose body's frame are given."""
    anchor, axis = np.zeros(3), np.array(joint.axis)
    if at is not body:
        back = body[0].T
        anchor, axis = applied(back, at[1] - body[1]), applied(product(back, at[0]), axis)
    damping, friction, armature = passive(model, joint)
    limited = joint.lower > -math.inf or joint.upper < math.inf
    effort = max(joint.effort, LEAST_EFFORT)
    attributes = {
        "name": joint.name,
        "type": "slide" if joint.type == "prismatic" else "hinge",
        "pos": anchor if anchor.any() else None,
        "axis": axis,
        "range": (max(joint.lower, -NO_STOP), min(joint.upper, NO_STOP)) if limited else None,
        "armature": armature or None,
        "damping": damping or None,
        "frictionloss": friction or None,
        "actuatorfrcrange": (-effort, effort) if effort < math.inf else None,
    }
    return element("joint", attributes)


def _key_lines(model: Model) -> list[str]:
    """Write the keyframes; MuJoCo orders joints depth first."""
    first = model.nq - len(model.joint_names)
    order = [*range(first), *(model.q_index(j.name) for j in depth_first(model) if j.name in model.joint_rows)]
    keys = ({"name": name, "qpos": [q[k] for k in order]} for name, q in model.keyframes.items())
    return [line for key in keys for line in element("key", key)]
