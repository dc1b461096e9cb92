"""Write MJCF.

Numbers are written to the last bit; MuJoCo converts angles and inertias to rounding.
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from ...base.fixed_order import applied, product
from ...base.rotation import rotation_from_rpy, rpy_from_rotation
from ...model import Ground, Joint, Model, depth_first, rigid_bodies
from ...model.rigid_bodies import held_frame
from .element import comment, element, number, numbers
from .names import unused
from .tree import NO_STOP, WORLD
from .write_actuators import actuator_lines, passive
from .write_geoms import geom_lines, mesh_lines, unread_meshes
from .write_ground import field_lines, floor_lines
from .write_inertia import inertials

LEAST_EFFORT = sys.float_info.min  # [N m or N]


class Hinged(NamedTuple):
    """A joint of a body, in the body's frame."""

    joint: Joint
    anchor: np.ndarray  # (3,) [m]
    axis: np.ndarray  # (3,)


class Body(NamedTuple):
    """A link with the joints that lead to it, including those of massless links between two joints."""

    link: str
    xyz: tuple[float, ...]  # in the parent [m]
    rpy: tuple[float, ...]  # [rad]
    joints: list[Hinged]


def mjcf_text(model: Model, ground: Ground | None = None) -> str:
    """Write the robot as MJCF, with a floor if ground is given.

    Raises ValueError for what MJCF cannot state, and for moving bodies with an inertia that no rigid body has.
    """
    _check_bodies(model)
    inertias, changed = inertials(model)
    actuators, lacking = actuator_lines(model)
    floor, steps = floor_lines(model, ground)
    remarks = [*lacking, *steps, *changed, *_remarks(model)]
    return "\n".join(
        [
            f"<mujoco model={quoteattr(model.name)}>",
            *(f"  {comment(remark)}" for remark in remarks),
            '  <compiler angle="radian" eulerseq="XYZ" autolimits="true"/>',
            *(['  <option cone="elliptic"/>'] if ground else []),
            *_section("asset", [*mesh_lines(model), *field_lines(ground)]),
            *_section("worldbody", [*floor, *_root_lines(model, inertias)]),
            *_section("equality", _equality_lines(model)),
            *_section("actuator", actuators),
            *_section("keyframe", _key_lines(model)),
            "</mujoco>",
            "",
        ]
    )


def _section(tag: str, lines: list[str]) -> list[str]:
    return [f"  <{tag}>", *(f"    {line}" for line in lines), f"  </{tag}>"] if lines else []


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


def _root_lines(model: Model, inertias: dict[str, str]) -> list[str]:
    inside = _inside(model, model.root, inertias)
    if _is_world(model):
        return inside[model.root in inertias :]
    free = ["<freejoint/>"] if model.base == "floating" else []
    return _element_lines(f"body name={quoteattr(_body_name(model, model.root))}", [*free, *inside])


def _inside(model: Model, link: str, inertias: dict[str, str]) -> list[str]:
    """Write what a link's body holds besides its joints."""
    inertial = [inertias[link]] if link in inertias else []
    children = [line for joint in model.joints if joint.parent == link for line in _child_lines(model, joint, inertias)]
    return [*inertial, *geom_lines(model, link), *children]


def _child_lines(model: Model, joint: Joint, inertias: dict[str, str]) -> list[str]:
    body = _body(model, joint)
    inside = [*(_joint_line(model, hinged) for hinged in body.joints), *_inside(model, body.link, inertias)]
    name = quoteattr(_body_name(model, body.link))
    return _element_lines(f'body name={name} pos="{numbers(body.xyz)}" euler="{numbers(body.rpy)}"', inside)


def _element_lines(start: str, inside: list[str]) -> list[str]:
    return [f"<{start}>", *(f"  {line}" for line in inside), f"</{start.split()[0]}>"]


def _is_world(model: Model) -> bool:
    """Return whether the root link is MuJoCo's world."""
    massless = all(link.mass == 0 for link in model.links if link.name == model.root)
    return model.root == WORLD and model.base == "fixed" and massless


def _body_name(model: Model, link: str) -> str:
    """Return the name of a link's body: its own, unless it is the name of MuJoCo's world."""
    return unused(WORLD, [other.name for other in model.links]) if link == WORLD else link


def _body(model: Model, joint: Joint) -> Body:
    """Return the body at the end of a joint, or of a chain of joints between massless links."""
    chain = [joint]
    while _moves(model, chain[-1]) and _is_frame(model, chain[-1].child):
        chain.append(next(j for j in model.joints if j.parent == chain[-1].child))
    poses = _poses(model, chain)
    E, r = poses[-1]
    hinged = [_hinged(j, pose, (E, r)) for j, pose in zip(chain, poses) if _moves(model, j)]
    if len(chain) == 1 and joint.name not in model.held:
        return Body(joint.child, joint.xyz, joint.rpy, hinged)
    return Body(chain[-1].child, tuple(r.tolist()), rpy_from_rotation(E), hinged)


def _moves(model: Model, joint: Joint) -> bool:
    return joint.type != "fixed" and joint.name not in model.held


def _is_frame(model: Model, name: str) -> bool:
    """Return whether a link is only a place between two joints that move."""
    link = next(link for link in model.links if link.name == name)
    ends = [joint for joint in model.joints if name in (joint.parent, joint.child)]
    carries = {shape.link for shape in model.shapes} | {point.link for point in model.contacts}
    plain = link.mass == 0 and not any(link.inertia) and name != model.root and name not in carries
    return plain and len(ends) == 2 and all(_moves(model, joint) for joint in ends)


def _poses(model: Model, chain: list[Joint]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Compute rotation and origin of each joint's child frame in the frame of the chain, with held joints in place."""
    E, r, poses = np.eye(3), np.zeros(3), []
    for joint in chain:
        E, r = product(E, rotation_from_rpy(joint.rpy)), r + applied(E, np.array(joint.xyz))
        E, r = held_frame(joint, model.held.get(joint.name, 0.0), E, r)
        poses.append((E, r))
    return poses


def _hinged(joint: Joint, at: tuple[np.ndarray, np.ndarray], body: tuple[np.ndarray, np.ndarray]) -> Hinged:
    """Express a joint in the frame of its body."""
    if at is body or at[0] is body[0]:
        return Hinged(joint, np.zeros(3), np.array(joint.axis))
    back = body[0].T
    return Hinged(joint, applied(back, at[1] - body[1]), applied(product(back, at[0]), np.array(joint.axis)))


def _joint_line(model: Model, hinged: Hinged) -> str:
    joint, (damping, friction, armature) = hinged.joint, passive(model, hinged.joint)
    limited = joint.lower > -math.inf or joint.upper < math.inf
    stops = (max(joint.lower, -NO_STOP), min(joint.upper, NO_STOP))
    effort = max(joint.effort, LEAST_EFFORT)
    attributes = {
        "name": joint.name,
        "type": "slide" if joint.type == "prismatic" else "hinge",
        "pos": numbers(hinged.anchor) if hinged.anchor.any() else None,
        "axis": numbers(hinged.axis),
        "range": numbers(stops) if limited else None,
        "armature": number(armature) if armature else None,
        "damping": number(damping) if damping else None,
        "frictionloss": number(friction) if friction else None,
        "actuatorfrcrange": numbers((-effort, effort)) if effort < math.inf else None,
    }
    return element("joint", attributes)


# ---------------------------------------------------------------------------------------------- couplings, postures


def _equality_lines(model: Model) -> list[str]:
    followers = [(joint.name, joint.mimic) for joint in model.moving_joints if joint.mimic]
    return [
        element("joint", {"joint1": name, "joint2": m.joint, "polycoef": numbers((m.offset, m.multiplier, 0, 0, 0))})
        for name, m in followers
    ]


def _key_lines(model: Model) -> list[str]:
    """Write the keyframes; MuJoCo orders joints depth first."""
    first = model.nq - len(model.joint_names)
    order = [*range(first), *(model.q_index(j.name) for j in depth_first(model) if j.name in model.joint_rows)]
    return [
        element("key", {"name": name, "qpos": numbers([q[k] for k in order])}) for name, q in model.keyframes.items()
    ]
