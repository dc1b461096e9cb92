"""Check that a robot's mass matrix is positive definite, and if not, find the links and joints that are to blame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ..base.flaws import Flaw, quoted
from .composite import TOLERANCE, Bodies, carried_mass, idle, loosest, mass_matrix
from .rigid_bodies import RigidBody

MAX_JOINTS = 1000  # that move; for more the matrix is too large
POSTURES = 16  # at which the matrix is checked
DEFINITE_TOLERANCE = 1e-9  # smallest principal moment of inertia, relative to the largest

Couplings = Sequence[tuple[str, str, float, float]]  # `Model.couplings`


def indefinite_flaws(
    robot: str, bodies: list[RigidBody], floating: bool, couplings: Callable[[], Couplings]
) -> list[Flaw]:
    """Find what moves although it has no mass or no inertia, alone or together with others.

    The mass matrix is positive definite if every moving body alone resists every motion.  A body that does not may
    still be carried by, or carry, others that do: then the matrix itself is checked, in a few postures.
    """
    moving = [body for body in bodies if body.frame.joint or floating]
    if all(body.mass > 0 for body in moving):
        moments = np.linalg.eigvalsh(np.array([body.inertia for body in moving]).reshape(-1, 3, 3))
        if (moments[:, 0] > DEFINITE_TOLERANCE * moments[:, 2]).all():
            return []
    return [*_massless_flaws(bodies, floating)] or _idle_flaws(robot, bodies, floating, couplings)


def _massless_flaws(bodies: list[RigidBody], floating: bool) -> Iterator[Flaw]:
    """Find bodies that move although neither they nor anything that they carry has a mass."""
    for body, carried in zip(bodies, carried_mass(rows_of(bodies))):
        joint = body.frame.joint
        moves = joint.armature == 0 if joint else floating
        if moves and not carried > 0:
            text = f"{_named(body)} moves but has mass {body.mass!r} kg, with all that it carries {float(carried)!r} kg"
            yield Flaw(f"link {body.links[0]!r}", f"{text}; expected > 0: add <inertial>, or fix its joint")


def _named(body: RigidBody) -> str:
    leader, *attached = body.links
    return f"link {leader!r}" + (f" with {quoted(attached)} rigidly attached" if attached else "")


def _idle_flaws(robot: str, bodies: list[RigidBody], floating: bool, couplings: Callable[[], Couplings]) -> list[Flaw]:
    """Find what moves without inertia, in the first posture in which something does."""
    if len(bodies) > MAX_JOINTS:
        text = f"robot {robot!r} has {len(bodies) - 1} moving joints and bodies without inertia of their own"
        return [Flaw("robot", f"{text}; at most {MAX_JOINTS} are checked: give each body its mass and inertia")]
    first = 0 if floating else 6  # the base's six coordinates come first
    for k, q in enumerate(_postures(bodies, couplings())):
        H, size = (part[(slice(first, None),) * part.ndim] for part in mass_matrix(rows_of(bodies), q))
        flaws = [_idle_flaw(bodies, first + int(row), H[row, row]) for row in idle(H, size)]
        if not flaws and len(H):
            least, share = loosest(H)
            flaws = [] if least > TOLERANCE else [_loose_flaw(bodies, first, share, least)]
        if flaws:
            zero = "joints at zero, or the nearest that their limits allow"
            where = zero if k == 0 else f"joints at {', '.join(f'{x:.3g}' for x in q[1:])} rad or m"
            return [flaw._replace(text=f"{flaw.text} (found with the {where})") for flaw in flaws]
    return []


def rows_of(bodies: list[RigidBody]) -> Bodies:
    """Return the bodies as arrays."""
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


def _postures(bodies: list[RigidBody], couplings: Couplings) -> Iterator[np.ndarray]:
    """Yield the posture nearest to zero and others within the joints' limits, up to half a turn either way."""
    joints = [body.frame.joint for body in bodies if body.frame.joint]
    zero = np.array([0.0, *(min(max(0.0, joint.lower), joint.upper) for joint in joints)])
    lower = np.maximum([0.0, *(joint.lower for joint in joints)], zero - math.pi)
    upper = np.minimum([0.0, *(joint.upper for joint in joints)], zero + math.pi)
    rows = {joint.name: k for k, joint in enumerate(joints, 1)}
    rng = np.random.default_rng(0)
    for k in range(POSTURES):
        q = zero if k == 0 else lower + rng.random(len(zero)) * (upper - lower)
        for follower, leader, multiplier, offset in couplings:
            q[rows[follower]] = multiplier * q[rows[leader]] + offset
        yield q


def _idle_flaw(bodies: list[RigidBody], coordinate: int, inertia: float) -> Flaw:
    """Describe a coordinate that moves no inertia."""
    body = bodies[max(0, coordinate - 5)]
    how = f"about joint {body.frame.joint.name!r}" if body.frame.joint else "as the floating base"
    text = (
        f"{_named(body)} moves {how} but its inertia there is {float(inertia)!r}, with all that it carries; "
        "expected > 0: a point mass or an ideal rod on the axis needs its real, small inertia"
    )
    return Flaw(f"link {body.links[0]!r}", text)


def _loose_flaw(bodies: list[RigidBody], first: int, share: np.ndarray, least: float) -> Flaw:
    """Describe coordinates that together move no inertia; share: of each coordinate from `first` on."""
    rows = sorted({max(0, first + int(k) - 5) for k in np.flatnonzero(share > 0.1 * share.max())})
    moving = [bodies[k] for k in rows]
    names = [f"joint {b.frame.joint.name!r}" if b.frame.joint else f"floating base {b.links[0]!r}" for b in moving]
    text = (
        f"link {moving[0].links[0]!r}: {', '.join(names[:10])} can move together without inertia: the least eigenvalue "
        f"of the mass matrix, scaled to a unit diagonal, is {least:.3g}; expected > 0: correct the masses and inertias "
        "there, or fix a joint"
    )
    return Flaw(f"link {moving[0].links[0]!r}", text)
