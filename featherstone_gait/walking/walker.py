"""Robots that are to walk, from any file: contact points, locked joints and servos.

Example::

    robot = driven(load_walker("g1.urdf", legs_only=True), "generic")
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base.arguments import texts, truth
from ..base.files import FilePath
from ..dynamics import contact_positions_at
from ..geometry.contact_choice import Choice, usual_choice
from ..model import Base, Loop, Model
from ..robot_file import load_robot, robot_names
from ..robot_file.servos import with_servo
from .generic_servo import with_generic_servos
from .inverse_kinematics import leg_length_to
from .kinematics import link_poses
from .stance import soles_of, standing

GENERIC, MARGIN = "generic", 2.0  # times as strong as an AX-12 scaled to the robot: with 1 no plan of a G1 walks


def load_walker(
    robot: FilePath,
    *,
    legs_only: bool = False,
    joints: Sequence[str] | None = None,
    base: Base | None = None,
    contacts: Choice | None = None,
    locked: Any = None,
) -> Model:
    """Load a robot with a floating base and contact points on its feet; of "humanoid" the simplified one.

    legs_only: lock all joints but those of its two legs, where they are in the keyframe in which the robot stands, or
    as near to zero as their limits allow; joints: lock all but these; base, contacts, locked: as in `load_robot`.  A
    robot of `robot_names()`, and a file that states them, keeps its own base and contacts.  Raises ValueError for
    `legs_only` and a robot without two soles, for unknown joints, and as `load_robot`.
    """
    truth("legs_only", legs_only)
    locked = "simplified" if locked is None and robot == "humanoid" else locked
    given = {"base": base, "contacts": contacts, "locked": locked}
    known = {name: value for name, value in given.items() if value is not None}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the last load warns
        found = load_robot(robot, **known)
        if robot not in robot_names():
            known = {"base": "floating"} | ({} if found.contacts else {"contacts": "feet"}) | known
            found = load_robot(robot, **known)
    moving = found.joint_names
    if legs_only:
        moving = with_tied(found, [moving[k] for sole in soles_of(found) for k in sole.joints])
    if joints is not None:
        moving = tuple(texts("joints", joints))
        if unknown := [name for name in moving if name not in found.joint_names]:
            raise ValueError(f"joints: {unknown[0]!r} is no moving joint of {found.name}; load it without holding it")
    rest = zip(found.moving_joints, standing(found)[0].tolist())
    held = {one.name: min(max(angle, one.lower), one.upper) for one, angle in rest if one.name not in moving}
    found = load_robot(robot, **known | ({"locked": {**found.locked, **held}} if held else {}))
    kept = tuple(loop for loop in found.loops if _between(found, loop))  # others tie links that are one body
    return found if kept == found.loops else replace(found, loops=kept)


def with_tied(model: Model, joints: Iterable[str]) -> tuple[str, ...]:
    """Return these joints and all that loops and couplings tie to them, in the order of the model."""
    groups = [_between(model, loop) for loop in model.loops]
    groups += [{follower, leader} for follower, leader, *_ in model.couplings]
    found, before = {*joints}, set[str]()
    while found != before:
        before = found
        found = found.union(*(group for group in groups if group & found))
    return tuple(name for name in model.joint_names if name in found)


def _between(model: Model, loop: Loop) -> set[str]:
    """Return the moving joints between the two links of a loop."""
    return {*_way(model, loop.a)} ^ {*_way(model, loop.b or model.root)}


def _way(model: Model, link: str) -> Iterator[str]:
    """Yield the moving joints between the root and a link."""
    while link != model.root:
        joint = next(one for one in model.joints if one.child == link)
        if joint.name in model.joint_names:
            yield joint.name
        link = joint.parent


def driven(model: Model, servo: FilePath) -> Model:
    """Return the robot with one servo in all joints that turn: as of `load_servo`, or "generic".

    "generic" is an AX-12 scaled to the robot's mass and legs (`with_generic_servos`), twice as strong for its weight;
    "generic:4" is four times as strong.  In a robot with loops only joints get servos that have motors in its file (an
    effort, or an own servo).
    """
    if model.loops:
        motors = {joint.name for joint in model.moving_joints if math.isfinite(joint.effort)} | {*model.servos}
        given = driven(replace(model, loops=()), servo)
        return replace(given, loops=model.loops, servos={k: v for k, v in given.servos.items() if k in motors})
    name, _, factor = str(servo).partition(":")
    if name != GENERIC or Path(servo).exists():
        return with_servo(model, servo)
    try:
        margin = float(factor) if factor else MARGIN
    except ValueError:
        raise ValueError(f"servo is {servo!r}; give generic, or how many times as strong: generic:4") from None
    return with_generic_servos(model, leg_length(model), margin=margin)


def leg_length(model: Model) -> float:
    """Return the length of a leg [m]: from joint to joint and to the lowest contact points, all joints at zero.

    Raises ValueError for a robot without contact points, or whose lowest one no joint moves.
    """
    if not model.contacts:
        raise ValueError(f"{model.name} has no contact points; load it with contacts={usual_choice(model) or 'all'!r}")
    points = contact_positions_at(model, link_poses(model, np.zeros(len(model.joint_names))))[0]
    foot = model.contacts[int(np.argmin(points[:, 2]))].link
    return leg_length_to(model, foot, points[[point.link == foot for point in model.contacts]].mean(axis=0))
