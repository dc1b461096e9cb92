"""Whether a robot's mass matrix is positive definite, and if not, which of its links and joints are to blame."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ..base.flaws import Flaw, listed
from .rigid_bodies import TOLERANCE, Bodies, carried_mass, idle, loosest, mass_matrix

if TYPE_CHECKING:
    from .robot import Model, RigidBody

MAX_JOINTS = 1000  # that move; for more the matrix is too large
POSTURES = 16  # at which the matrix is looked at


def indefinite_flaws(model: Model, bodies: list[RigidBody]) -> list[Flaw]:
    """What moves although it has no mass or no inertia, alone or together with others; empty if nothing does."""
    return [*_massless_flaws(model, bodies)] or _idle_flaws(model, bodies)


def _massless_flaws(model: Model, bodies: list[RigidBody]) -> Iterator[Flaw]:
    """Bodies that move although neither they nor anything that they carry has a mass."""
    for body, carried in zip(bodies, carried_mass(rows_of(bodies))):
        joint = body.frame.joint
        moves = joint.armature == 0 if joint else model.base == "floating"
        if moves and not carried > 0:
            text = f"{_named(body)} moves but has mass {body.mass!r} kg, with all that it carries {float(carried)!r} kg"
            yield Flaw(f"link {body.links[0]!r}", f"{text}; expected > 0: add <inertial>, or fix its joint")


def _named(body: RigidBody) -> str:
    leader, *attached = body.links
    return f"link {leader!r}" + (f" with {listed(attached)} rigidly attached" if attached else "")


def _idle_flaws(model: Model, bodies: list[RigidBody]) -> list[Flaw]:
    """What moves without inertia, in the first posture in which something does."""
    if len(bodies) > MAX_JOINTS:
        text = f"robot {model.name!r} has {len(bodies) - 1} moving joints and bodies without inertia of their own"
        return [Flaw("robot", f"{text}; at most {MAX_JOINTS} are looked at: give each body its mass and inertia")]
    rows, free = rows_of(bodies), _free_motions(model, bodies)
    for q in _postures(model, bodies):
        H, size = mass_matrix(rows, q)
        H, size = free.T @ H @ free, (free * free).T @ size
        flaws = [_idle_flaw(bodies, free[:, k], H[k, k]) for k in idle(H, size)]
        if not flaws and len(H):
            least, share = loosest(H)
            flaws = [] if least > TOLERANCE else [_loose_flaw(bodies, free @ share, least)]
        if flaws:
            return flaws
    return []


def rows_of(bodies: list[RigidBody]) -> Bodies:
    """The bodies as arrays."""
    joints = [body.frame.joint for body in bodies]
    return Bodies(
        [body.frame.parent for body in bodies],
        np.array([body.frame.E for body in bodies]),
        np.array([body.frame.r for body in bodies]),
        [joint is not None and joint.type == "prismatic" for joint in joints],
        np.array([joint.armature if joint else 0.0 for joint in joints]),
        np.array([body.mass for body in bodies]),
        np.array([body.center for body in bodies]),
        np.array([body.inertia for body in bodies]),
    )


def _free_motions(model: Model, bodies: list[RigidBody]) -> np.ndarray:
    """Columns: what a unit speed of each coordinate is in those of `composite.mass_matrix`.

    Joints that follow others have their own: the articulated-body algorithm couples what it has solved.
    """
    return np.eye(len(bodies) + 5)[:, 0 if model.base == "floating" else 6 :]


def _postures(model: Model, bodies: list[RigidBody]) -> Iterator[np.ndarray]:
    """The posture nearest to zero and some others within the joints' limits, up to half a turn either way."""
    joints = [body.frame.joint for body in bodies if body.frame.joint]
    zero = np.array([0.0, *(min(max(0.0, joint.lower), joint.upper) for joint in joints)])
    lower = np.maximum([0.0, *(joint.lower for joint in joints)], zero - math.pi)
    upper = np.minimum([0.0, *(joint.upper for joint in joints)], zero + math.pi)
    rows = {joint.name: k for k, joint in enumerate(joints, 1)}
    rng = np.random.default_rng(0)
    for k in range(POSTURES):
        q = zero if k == 0 else lower + rng.random(len(zero)) * (upper - lower)
        for follower, leader, multiplier, offset in model.couplings:
            q[rows[follower]] = multiplier * q[rows[leader]] + offset
        yield q


def _idle_flaw(bodies: list[RigidBody], motion: np.ndarray, inertia: float) -> Flaw:
    """Of a coordinate that moves no inertia."""
    body = bodies[max(0, int(np.abs(motion).argmax()) - 5)]
    how = f"about joint {body.frame.joint.name!r}" if body.frame.joint else "as the floating base"
    text = (
        f"{_named(body)} moves {how} but its inertia there is {float(inertia)!r}, with all that it carries; "
        "expected > 0: a point mass or an ideal rod on the axis needs its real, small inertia"
    )
    return Flaw(f"link {body.links[0]!r}", text)


def _loose_flaw(bodies: list[RigidBody], share: np.ndarray, least: float) -> Flaw:
    """Of coordinates that together move no inertia."""
    rows = sorted({max(0, int(k) - 5) for k in np.flatnonzero(share > 0.1 * share.max())})
    moving = [bodies[k] for k in rows]
    names = [f"joint {b.frame.joint.name!r}" if b.frame.joint else f"floating base {b.links[0]!r}" for b in moving]
    text = (
        f"link {moving[0].links[0]!r}: {', '.join(names[:10])} can move together without inertia: the least eigenvalue "
        f"of the mass matrix, scaled to a unit diagonal, is {least:.3g}; expected > 0: correct the masses and inertias "
        "there, or fix a joint"
    )
    return Flaw(f"link {moving[0].links[0]!r}", text)
