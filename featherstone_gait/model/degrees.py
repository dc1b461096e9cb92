"""Joints of several degrees of freedom as chains of joints of one, with links without mass between them.

| joint | its degrees, from the parent to the child |
| --- | --- |
| universal | r1 about `axis`, r2 about `axis2`, which moves with the first |
| cylindrical | z along `axis`, rz about it |
| planar | x and y in the plane across `axis`, then rz about it |
| ball | rx, ry, rz: the angular velocity in the child's axes; its position is a quaternion |
| free | x, y, z along the axes of the joint's frame in the parent, then rx, ry, rz of a ball joint |

A degree is called `joint.rx`.  Damping, friction, armature and the limits of effort and velocity of a joint are those
of each of its degrees, unless `Joint.degrees` says otherwise; springs and limits of single degrees stand there alone.
A ball joint may have a spring and a limit for its angle as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..base.fixed_order import product
from ..base.rotation import rotation_from_quaternion, rotation_z_to
from .links import COMPOSITE, Joint, JointType, Link, Vector

AXES: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
STILL: Vector = (0.0, 0.0, 0.0)
SHIFT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # x to y, y to z, z to x
TO_AXIS = {AXES[0]: SHIFT, AXES[1]: SHIFT.T, AXES[2]: np.eye(3)}  # z to an axis of a ball joint


class Degrees(NamedTuple):
    """A tree whose joints have one degree of freedom each."""

    joints: tuple[Joint, ...]
    between: tuple[Link, ...]  # links without mass that only it has
    after: Mapping[str, str]  # of these, the link that each carries


def degrees_of(joints: Sequence[Joint]) -> Degrees:
    """Return the joints, those of several degrees as chains; those given if there are none."""
    if not any(joint.type in COMPOSITE for joint in joints):
        return Degrees(tuple(joints), (), {})
    single = [part for joint in joints for part in _chain(joint)]
    ends = {joint.child for joint in joints}
    between = tuple(Link(part.child) for part in single if part.child not in ends)
    names = {link.name for link in between}
    return Degrees(tuple(single), between, {part.parent: part.child for part in single if part.parent in names})


def _chain(joint: Joint) -> Iterator[Joint]:
    if joint.type not in COMPOSITE:
        yield joint
        return
    parts = list(_parts(joint))
    parent = joint.parent
    for k, (suffix, kind, axis) in enumerate(parts):
        name = f"{joint.name}.{suffix}"
        child = joint.child if k == len(parts) - 1 else name
        xyz, rpy = (joint.xyz, joint.rpy) if k == 0 else (STILL, STILL)
        own: dict[str, Any] = {"axis": axis, "axis2": None, "stiffness": 0.0, "lower": -math.inf, "upper": math.inf}
        own |= {"degrees": (), **dict(dict(joint.degrees).get(suffix, ()))}
        if kind == "continuous" and (own["lower"] > -math.inf or own["upper"] < math.inf):
            kind = "revolute"
        yield replace(joint, name=name, type=kind, parent=parent, child=child, xyz=xyz, rpy=rpy, **own)
        parent = child


def _parts(joint: Joint) -> Iterator[tuple[str, JointType, Vector]]:
    """Yield suffix, type and axis of each degree."""
    if joint.type == "universal":
        yield "r1", "continuous", joint.axis
        yield "r2", "continuous", joint.axis2 or _across(joint.axis)[0]
        return
    if joint.type == "planar":
        yield from zip(("x", "y"), ("prismatic", "prismatic"), _across(joint.axis))
    if joint.type == "cylindrical":
        yield "z", "prismatic", joint.axis
    if joint.type in ("planar", "cylindrical"):
        yield "rz", "continuous", joint.axis
        return
    if joint.type == "free":
        yield from zip("xyz", ("prismatic",) * 3, AXES)
    yield from zip(("rx", "ry", "rz"), ("ball",) * 3, AXES)


def _across(axis: Vector) -> tuple[Vector, Vector]:
    """Return two axes of a right-handed frame whose third is the one given; x and y where that is z."""
    if axis == AXES[2]:
        return AXES[0], AXES[1]
    x, y, _ = rotation_z_to(axis).T.tolist()
    return tuple(x), tuple(y)


def written_degrees(joint: Joint) -> list[Joint]:
    """Return the joint as a chain of joints of one degree and ball joints, whose degrees keep their names."""
    single = list(_chain(joint)) if joint.type in COMPOSITE else [joint]
    last = single[-1]
    if last.type != "ball":
        return single
    first = single[-3]
    whole = replace(first, name=joint.name, child=last.child, stiffness=joint.stiffness, upper=joint.upper)
    return [*single[:-3], whole]


def by_degree(held: Mapping[str, float], joints: Iterable[Joint]) -> dict[str, float]:
    """Return the held positions by degree; a joint of several degrees may be named as a whole if it is held at zero."""
    found = dict(held)
    for joint in joints:
        if joint.type in COMPOSITE and joint.name in found:
            names = [part.name for part in degrees_of((joint,)).joints]
            if found.pop(joint.name) != 0.0:
                raise ValueError(
                    f"locked joint {joint.name!r}: it has several degrees of freedom; hold it at 0, or name "
                    f"its degrees, {', '.join(names)}"
                )
            found |= dict.fromkeys(names, 0.0)
    return found


def is_first(joint: Joint) -> bool:
    """Return whether a degree is the first of a ball joint, which has its quaternion."""
    return joint.type == "ball" and joint.axis == AXES[0]


def ball_name(joint: Joint) -> str:
    """Return the name of the ball joint, or free one, of which a degree is the first."""
    return joint.name[: -len(".rx")]


def widths(joints: Sequence[Joint]) -> list[int]:
    """Return how many numbers of q each degree has: the first of a ball joint four, its others none."""
    return [4 if is_first(joint) else 0 if joint.type == "ball" else 1 for joint in joints]


def turned_frame(E: np.ndarray, quaternion: Sequence[float] | np.ndarray) -> np.ndarray:
    """Turn the frame E (3, 3) of a ball joint's first body by the joint's quaternion w x y z."""
    w, x, y, z = (float(a) for a in quaternion)
    length = math.sqrt(w * w + x * x + y * y + z * z)
    return product(E, rotation_from_quaternion((w / length, y / length, z / length, x / length)))
