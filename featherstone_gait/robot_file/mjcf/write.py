"""Write MJCF.

Numbers are written to the last bit; MuJoCo converts angles and inertias to rounding.

MuJoCo refuses an inertia with A + B < C to the last bit, and a moving body unless it, or one fixed to it, has a mass
and moments of at least 1e-15.  So links that move as one get one inertia together where that of one is refused.
Principal moments are written, since those of a `fullinertia` depend on rounding.
"""

from __future__ import annotations

import math
import sys
from dataclasses import astuple
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ...base.fixed_order import applied, product
from ...base.rotation import rotation_from_rpy, rpy_from_rotation
from ...model import ContactPoint, Ground, Joint, Link, Model, Placement, RigidBody, inertia_matrix, rigid_bodies
from ...model.degrees import degrees_of, written_degrees
from ...model.rest_posture import START
from ...model.rigid_bodies import depth_first_joints, held_frame
from ...model.shapes import Mesh, Shape
from ..markup import comment, element
from ..urdf import TRIANGLE_TOLERANCE
from ..write_toml import mjcf_lines, rubs, touching_lines
from .fluids import immersed_geoms
from .loops import length_at_zero, loop_lines, rod_lines, site_lines
from .sensors import lost_of_sensors, measures, sensor_lines, sensor_site_lines
from .stated import STATED
from .tendons import tendon_lines, tendon_site_lines, wound
from .tree import NO_STOP, WORLD, unused
from .write_actuators import actuator_lines, is_stated, passive
from .write_geoms import (
    field_lines,
    floor_lines,
    geom_lines,
    geom_names,
    has_extent,
    mesh_lines,
    pair_lines,
    unread_meshes,
)

Inertials: TypeAlias = dict[str, list[str]]  # lines by link
Pose: TypeAlias = tuple[np.ndarray, np.ndarray]  # rotation (3, 3) and origin (3,) [m]

LEAST_INERTIA = 1e-15  # mass and moments of inertia of what moves [kg, kg m^2]
ROUNDING = 1e-13  # of the largest moment, by which moments may miss what is asked
LEAST_EFFORT = sys.float_info.min  # [N m or N]


def mjcf_text(
    model: Model, ground: Ground | None = None, fluid: bool = False, bare: bool = True
) -> tuple[str, list[str]]:
    """Write the robot as MJCF, with a floor if ground is given; return what the file lacks, too.

    fluid: whether the file has a medium that acts on it by MuJoCo's laws; bare: whether friction and priority of shapes
    stand in the <text> alone.  Raises ValueError for what MJCF cannot state, and for moving bodies with an inertia that
    no rigid body has.
    """
    _check_bodies(model)
    inertias, changed = _inertials(model)
    actuators, lacking = actuator_lines(model)
    floor, steps = floor_lines(model, ground)
    couplings = [(joint.name, joint.mimic) for joint in model.moving_joints if joint.mimic]
    sections = {
        "custom": _text_lines(model, fluid, bare),
        "asset": [*mesh_lines(model), *field_lines(ground)],
        "worldbody": [*floor, *_site_lines(model, None), *_root_lines(model, inertias, fluid)],
        "equality": [
            line
            for name, (leader, b, a) in ((name, astuple(mimic)) for name, mimic in couplings)
            for line in element("joint", {"joint1": name, "joint2": leader, "polycoef": (a, b, 0, 0, 0)})
        ]
        + loop_lines(model.loops, lambda loop: length_at_zero(model, loop)),
        "tendon": [*rod_lines(model.loops), *tendon_lines(model)],
        "contact": [*pair_lines(model, ground), *_exclude_lines(model)],
        "actuator": actuators,
        "sensor": sensor_lines(model.sensors),
        "keyframe": _key_lines(model),
    }
    lost = [*lacking, *steps, *changed, *_lost(model, ground, fluid, bare)]
    inside = [
        *(comment(remark) for remark in (*lost, *_remarks(model))),
        *element("compiler", {"angle": "radian", "eulerseq": "XYZ", "autolimits": "true"}),
        *(element("option", {"cone": "elliptic"}) if ground else []),
        *(line for tag, lines in sections.items() if lines for line in element(tag, {}, lines)),
    ]
    return "\n".join([*element("mujoco", {"model": model.name}, inside), ""]), lost


def _text_lines(model: Model, fluid: bool, bare: bool) -> list[str]:
    """Write the <text> with what MJCF has no element for."""
    joints = [one for joint in model.joints for one in written_degrees(joint) if _moves(model, one)]
    driven = {joint.name: (model.servos[joint.name], joint.effort) for joint in joints if joint.name in model.servos}
    servos = {name for name, (servo, effort) in driven.items() if not is_stated(servo, effort)}
    names = geom_names(model)
    shapes = {
        name: shape
        for name, shape in zip(names, model.shapes)
        if name and (shape.surface or (bare and (model.contacts or rubs(shape))))
    }
    stated = () if fluid else model.immersed
    tendons = [one for one in model.tendons if wound(model, one)]
    lines = mjcf_lines(model, joints, servos, stated, tendons, tuple(names[len(model.shapes) :]), shapes)
    if bare:  # a scene writes bits of geoms
        links = {link.name for link in model.links}
        shaped = tuple(pair for pair in model.excluded if not {*pair} <= links)
        lines = [*touching_lines(shaped, model.included), *lines]
    return element("text", {"name": STATED, "data": "\n".join(lines).strip()}) if lines else []


def _lost(model: Model, ground: Ground | None, fluid: bool, bare: bool) -> list[str]:
    """Return what MuJoCo does not find in the file; `_text_lines` has it for this package where it can."""
    tracks = [one for one in model.contacts if one.surface is not None and one.circle_radius > 0]
    parts: tuple[ContactPoint | Shape, ...] = (*model.contacts, *model.shapes)
    rubbing = [one for one in parts if one.friction is not None]
    left = {
        "immersed shapes on links": [] if fluid else [one.link for one in model.immersed],
        "propellers of joints": [one.joint for one in model.propellers],
        "rollers of wheels on links": [one.link for one in model.contacts if one.roller_angle is not None],
        "surfaces that move on circles of contact on links": [one.link for one in tracks],
        "the tendons of joints and a path": [one.name for one in model.tendons if wound(model, one)],
        "the lines on the ground": ["floor"] if ground is not None and ground.lines else [],
        "meshes that MuJoCo does not find or read": unread_meshes(model),
        "shapes without extent": _flat(model),
        "the friction with a floor, since there is none, of": [] if ground or not bare else [x.link for x in rubbing],
        "what shapes beside contact points touch": [x.name or x.link for x in model.shapes if bare and model.contacts],
        "joints that are held, and welded in the file": [*model.held],
    }  # fmt: skip
    lost = [f"left out {what}: {', '.join(dict.fromkeys(names))}" for what, names in left.items() if names]
    if hinges := [loop.name for loop in model.loops if loop.kind == "hinge"]:
        lost.append("MJCF has no hinge among its loops; wrote two points of the axis of " + ", ".join(hinges))
    return [*lost, *_lost_drives(model), *lost_of_sensors(model.sensors)]


def _remarks(model: Model) -> list[str]:
    """Return how the file states what it has."""
    remarks = []
    if any(joint.effort < math.inf for joint in model.moving_joints if joint.name in model.servos):
        remarks.append("MuJoCo limits servos by the efforts of joints (actuatorfrcrange) too: this package does not")
    if idle := [joint.name for joint in model.moving_joints if joint.effort == 0]:
        remarks.append("MJCF cannot state an effort of 0; replaced by the smallest number: " + ", ".join(idle))
    if START in model.keyframes:
        remarks.append(f"MuJoCo begins with all joints at 0, not at the keyframe {START!r}: reset to it")
    if any(link.name == WORLD for link in model.links) and not _is_world(model):
        remarks.append(f"link 'world' is called {_body_name(model, WORLD)!r}")
    if model.contacts:
        remarks.append("contact points are small spheres and flat cylinders; shapes touch nothing beside them")
    return remarks


def _flat(model: Model) -> list[str]:
    """Return the shapes that MuJoCo refuses, for they have no extent."""
    kinds = [shape for shape in model.shapes if not isinstance(shape.geometry, Mesh) and not has_extent(shape.geometry)]
    return [f"{shape.name or type(shape.geometry).__name__} of link {shape.link}" for shape in kinds]


def _lost_drives(model: Model) -> list[str]:
    parts: list[Shape | ContactPoint] = [*model.shapes, *(one for one in model.contacts if one.circle_radius == 0)]
    moving = [(part.surface, part.surface.drive or part.link) for part in parts if part.surface]
    if not moving:
        return []
    drives = ", ".join(dict.fromkeys(name for _, name in moving))
    remarks = [
        "MJCF knows no drives and commands of surfaces: each surface has the speed of its first command, and is read "
        f"as one with a drive of its own, named like its geom; left out the drives {drives}"
    ]
    if still := ", ".join(dict.fromkeys(name for surface, name in moving if surface.command == 0)):
        remarks.append(f"left out the velocities of surfaces whose first command is 0, of the drives {still}")
    return remarks


def _check_bodies(model: Model) -> None:
    """Refuse massless bodies that are no plain link between two joints."""
    folded = {link.name for link in model.links if _is_frame(model, link.name)}
    folded |= {link.name for link in model.degrees.between}
    screws = [joint.name for joint in model.moving_joints if joint.type == "screw"]
    if screws:
        raise ValueError(
            f"joint {screws[0]!r}: MJCF knows no screw joint; write .urdf, or a slide that follows a hinge"
        )
    for body in rigid_bodies(model)[0][1:]:
        if body.mass == 0 and not set(body.links) <= folded:
            raise ValueError(
                f"link {body.links[0]!r} moves without mass and is no plain link between two joints, which MJCF cannot "
                "state: give it a small mass and inertia"
            )


# ---------------------------------------------------------------------------------------------- bodies


def _root_lines(model: Model, inertias: Inertials, fluid: bool) -> list[str]:
    inside = _inside(model, model.root, inertias, fluid)
    if _is_world(model):
        return inside[model.root in inertias :]
    free = ["<freejoint/>"] if model.base == "floating" else []
    attributes = {"name": _body_name(model, model.root), "gravcomp": _borne(model, model.root)}
    return element("body", attributes, [*free, *inside])


def _inside(model: Model, link: str, inertias: Inertials, fluid: bool) -> list[str]:
    """Write what a link's body holds besides its joints."""
    joints = [joint for joint in model.joints if joint.parent == link]
    children = [line for joint in joints for line in _child_lines(model, joint, inertias, fluid)]
    geoms = [*geom_lines(model, link), *(immersed_geoms(model, link) if fluid else [])]
    return [*inertias.get(link, []), *geoms, *_site_lines(model, link), *children]


def _site_lines(model: Model, link: str | None) -> list[str]:
    sites = [*site_lines(model.loops, link), *tendon_site_lines(model, link)]
    if link == WORLD and not _is_world(model):  # a body, and sensors of the world are not on it
        return sites
    return sites + sensor_site_lines(model.sensors, link or WORLD)


def _child_lines(model: Model, joint: Joint, inertias: Inertials, fluid: bool) -> list[str]:
    """Write the body at the end of a joint, or of a chain of joints between massless links."""
    chain = written_degrees(joint)
    while _moves(model, chain[-1]) and _is_frame(model, chain[-1].child):
        chain += written_degrees(next(j for j in model.joints if j.parent == chain[-1].child))
    poses = _poses(model, chain)
    E, r = poses[-1]
    plain = len(chain) == 1 and not any(one.name in model.held for one in degrees_of(chain).joints)
    xyz, rpy = (joint.xyz, joint.rpy) if plain else (r, rpy_from_rotation(E))
    moving = [(j, pose) for j, pose in zip(chain, poses) if _moves(model, j)]
    joints = [line for j, pose in moving for line in _joint_lines(model, j, pose, poses[-1])]
    link = chain[-1].child
    attributes = {"name": _body_name(model, link), "pos": xyz, "euler": rpy, "gravcomp": _borne(model, link)}
    return element("body", attributes, [*joints, *_inside(model, link, inertias, fluid)])


def _moves(model: Model, joint: Joint) -> bool:
    """Return whether a joint that MJCF can state has coordinates."""
    return (f"{joint.name}.rx" if joint.type == "ball" else joint.name) in model.joint_rows


def _exclude_lines(model: Model) -> list[str]:
    """Write which bodies do not touch each other."""
    written = {link.name: _body_name(model, link.name) for link in model.links if not _is_frame(model, link.name)}
    if _is_world(model):
        written[model.root] = WORLD
    pairs = ((written[a], written[b]) for a, b in model.excluded if a in written and b in written)
    return [line for a, b in pairs for line in element("exclude", {"body1": a, "body2": b})]


def _borne(model: Model, link: str) -> float | None:
    return model.link(link).gravity_compensation or None


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
    carries |= {via.link for tendon in model.tendons for via in tendon.path if via.link is not None}
    carries |= {one.link for one in model.immersed} | {inner.link for one in model.sensors if (inner := measures(one))}
    carries |= {end for loop in model.loops for end in (loop.a, loop.b) if end is not None}
    plain = link.mass == 0 and not any(link.inertia) and name != model.root and name not in carries
    return plain and len(ends) == 2 and all(_moves(model, one) for joint in ends for one in written_degrees(joint))


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
    lowest = 0.0 if joint.type == "ball" else -NO_STOP
    effort = max(joint.effort, LEAST_EFFORT)
    attributes = {
        "name": joint.name,
        "type": {"prismatic": "slide", "ball": "ball"}.get(joint.type, "hinge"),
        "pos": anchor if anchor.any() else None,
        "axis": None if joint.type == "ball" else axis,
        "range": (max(joint.lower, lowest), min(joint.upper, NO_STOP)) if limited else None,
        "armature": armature or None,
        "damping": _damping(joint, damping) or None,
        "frictionloss": friction or None,
        "stiffness": _stiffness(joint) or None,
        "springref": joint.spring_reference if _stiffness(joint) and joint.type != "ball" else None,
        "actuatorfrcrange": (-effort, effort) if effort < math.inf else None,
    }
    return element("joint", attributes)


def _damping(joint: Joint, damping: float) -> float | tuple[float, ...]:
    if not (joint.quadratic_damping or joint.cubic_damping):
        return damping
    return damping, joint.quadratic_damping, joint.cubic_damping


def _stiffness(joint: Joint) -> float | tuple[float, ...]:
    if not joint.cubic_stiffness:
        return joint.stiffness
    return joint.stiffness, joint.quadratic_stiffness, joint.cubic_stiffness


def _key_lines(model: Model) -> list[str]:
    """Write the keyframes; MuJoCo orders joints depth first."""
    first = model.base_positions
    places = dict(zip(model.joint_names, model.position_slices))
    degrees = [j.name for j in depth_first_joints(model.root, model.degrees.joints) if j.name in places]
    order = [*range(first), *(k for name in degrees for k in range(places[name].start, places[name].stop))]
    keys = ({"name": name, "qpos": [q[k] for k in order]} for name, q in model.keyframes.items())
    return [line for key in keys for line in element("key", key)]


# ---------------------------------------------------------------------------------------------- inertias


def _inertials(model: Model) -> tuple[Inertials, list[str]]:
    """Write the inertial of each link that has one, and return how the file deviates from the model.

    Raises ValueError for moving bodies with an inertia that no rigid body has.
    """
    links = {link.name: link for link in model.links + model.degrees.between}
    bodies, placements = rigid_bodies(model)
    lines: Inertials = {}
    remarks: dict[str, list[str]] = {}
    for row, body in enumerate(bodies):
        heavy = [links[name] for name in body.links if links[name].mass or any(links[name].inertia)]
        found = _each(heavy)
        if found is None:
            found = _together(body, placements[body.links[0]])
            if found is None and (row or model.base == "floating"):
                raise ValueError(_refusal(body, heavy))
            if found is not None and len({links[name].gravity_compensation for name in body.links}) > 1:
                raise ValueError(
                    f"link {body.links[0]!r}: MJCF states one inertia for all that moves as one with it, whose links "
                    "have different gravity_compensation: give them one value"
                )
            if found is None:
                remark = "left out the inertia of what never moves, for no body has it"
            elif np.linalg.eigvalsh(body.inertia)[0] < LEAST_INERTIA:
                remark = f"moments of inertia raised to {LEAST_INERTIA} kg m^2"
            else:
                remark = "one inertia for all that moves as one with"
            remarks.setdefault(remark, []).append(" and ".join(link.name for link in heavy) or body.links[0])
        lines |= found or {}
    return lines, [f"{what}: {', '.join(names)}" for what, names in remarks.items()]


def _each(links: list[Link]) -> Inertials | None:
    """Write an inertial for every link; None if one is impossible, or none is large enough to move."""
    inertias = [inertia_matrix(link.inertia) for link in links]
    if links and max(np.linalg.eigvalsh(J)[0] for J in inertias) < LEAST_INERTIA:
        return None
    lines = {link.name: _inertial(link.mass, link.center_of_mass, J) for link, J in zip(links, inertias)}
    return lines if all(lines.values()) else None


def _together(body: RigidBody, first: Placement) -> Inertials | None:
    """Write one inertial for all links of a body, at the first of them."""
    back = first.E.T
    center = applied(back, body.center - first.r)
    line = _inertial(body.mass, center, product(product(back, body.inertia), first.E), LEAST_INERTIA)
    return {body.links[0]: line} if line else None


def _inertial(mass: float, center: ArrayLike, J: np.ndarray, least: float = 0.0) -> list[str]:
    """Write the element with moments of at least `least`; none for an inertia that no rigid body has."""
    (A, B, C), axes = np.linalg.eigh(J)
    slack = max(ROUNDING * C, LEAST_INERTIA)
    if mass < LEAST_INERTIA or A < -slack or A + B < C - slack:
        return []
    A, B = max(A, least), max(B, least)
    axes = axes * (1.0, 1.0, np.sign(np.linalg.det(axes)))
    moments = (A, B, max(min(C, A + B), least))
    attributes = {"pos": center, "euler": rpy_from_rotation(axes), "mass": mass, "diaginertia": moments}
    return element("inertial", attributes)


def _refusal(body: RigidBody, links: list[Link]) -> str:
    """Say why a body cannot be written, naming the first link that could not be written by itself."""
    name = next((link.name for link in links if _each([link]) is None), body.links[0])
    A, B, C = np.linalg.eigvalsh(body.inertia).tolist()
    return (
        f"link {name!r}: what moves as one with it has the mass {body.mass:.6g} kg and the principal moments of "
        f"inertia {A:.6g}, {B:.6g}, {C:.6g} kg m^2, which no body has and MuJoCo refuses; correct them to the last "
        f"digit, or load the robot with repair_inertia=True, which mends what is off by {TRIANGLE_TOLERANCE:g} or more"
    )
