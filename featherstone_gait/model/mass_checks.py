"""Check that a robot's mass matrix is positive definite, and if not, find the links and joints that are to blame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from ..base.flaws import Flaw, quoted
from .composite import TOLERANCE, Bodies, carried_mass, idle, loosest, mass_matrix
from .rigid_bodies import RigidBody

MAX_JOINTS = 1000  # that move; for more the matrix is too large
POSTURES = 15  # at which the matrix is checked, besides zero and the keyframes
DEFINITE_TOLERANCE = 1e-9  # smallest principal moment of inertia, relative to the largest

Couplings = Sequence[tuple[str, str, float, float]]  # `Model.couplings`


def indefinite_flaws(
    robot: str,
    bodies: list[RigidBody],
    floating: bool,
    couplings: Callable[[], Couplings],
    keyframes: Iterable[np.ndarray] = (),
) -> list[Flaw]:
    """Find what moves although it has no mass or no inertia, alone or together with others.

    The mass matrix is positive definite if every moving body alone resists every motion.  A body that does not may
    still be carried by, or carry, others that do: then the matrix itself is checked, in a few postures.  It may be
    singular in some of them, but not in all, and indefinite in none; keyframes: joint positions by body, see `rows_of`.
    """
    if resisting(bodies, floating):
        return []
    return [*_massless_flaws(bodies, floating)] or _idle_flaws(robot, bodies, floating, couplings, keyframes)


def resisting(bodies: list[RigidBody], floating: bool) -> bool:
    """Return whether every moving body alone resists every motion."""
    moving = [body for body in bodies if body.frame.joint or floating]
    if not all(body.mass > 0 for body in moving):
        return False
    moments = np.linalg.eigvalsh(np.array([body.inertia for body in moving]).reshape(-1, 3, 3))
    return bool((moments[:, 0] > DEFINITE_TOLERANCE * moments[:, 2]).all())


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


def _idle_flaws(
    robot: str,
    bodies: list[RigidBody],
    floating: bool,
    couplings: Callable[[], Couplings],
    keyframes: Iterable[np.ndarray],
) -> list[Flaw]:
    """Find what moves without inertia in all postures, or against a negative one in any."""
    taken = [*postures(bodies, couplings(), keyframes)]
    for rows in _branches(bodies, floating):
        own = _renumbered(bodies, rows)
        if resisting(own, floating):
            continue
        if len(own) > MAX_JOINTS:
            text = f"robot {robot!r} has {len(own) - 1} moving joints and bodies without inertia of their own"
            return [Flaw("robot", f"{text}; at most {MAX_JOINTS} are checked: give each body its mass and inertia")]
        found = []
        for q in taken:
            flaws, least = flaws_at(own, floating, q[rows])
            if least < -TOLERANCE:
                return flaws
            found.append(flaws)
        if all(found):
            return [flaw._replace(text=f"{flaw.text} (as in all of {len(found)} postures)") for flaw in found[0]]
    return []


def _branches(bodies: list[RigidBody], floating: bool) -> list[list[int]]:
    """Return the rows of what moves alone: all, or of a fixed root, which passes no motion on, each of its branches."""
    if floating:
        return [[*range(len(bodies))]]
    found: list[list[int]] = []
    branch = [-1]
    for k, body in enumerate(bodies[1:], 1):
        parent = body.frame.parent
        branch.append(branch[parent] if parent else len(found))
        if not parent:
            found.append([0])
        found[branch[k]].append(k)
    return found


def _renumbered(bodies: list[RigidBody], rows: list[int]) -> list[RigidBody]:
    """Return some of the bodies, with the numbers of their parents among these."""
    number = {row: k for k, row in enumerate(rows)}
    return [
        one._replace(frame=one.frame._replace(parent=number[one.frame.parent])) for one in map(bodies.__getitem__, rows)
    ]


def flaws_at(
    bodies: list[RigidBody], floating: bool, q: np.ndarray, armature: np.ndarray | None = None, least: float = TOLERANCE
) -> tuple[list[Flaw], float]:
    """Find what moves without inertia at the joint positions q (rows,), and the least eigenvalue of the mass matrix.

    That of the matrix scaled to a unit diagonal, or what is on the diagonal by its size if that is not above zero;
    armature: (rows,), in place of the joints' own; least: eigenvalue below which something is found.
    """
    first = 0 if floating else 6  # the base's six coordinates come first
    rows = rows_of(bodies)
    rows = rows if armature is None else rows._replace(armature=armature)
    H, size = (part[(slice(first, None),) * part.ndim] for part in mass_matrix(rows, q))
    alone = idle(H, size)
    if len(alone):
        shares = [float(H[row, row] / size[row]) if size[row] > 0 else 0.0 for row in alone]
        return [_idle_flaw(bodies, first + int(row), H[row, row], q) for row in alone], min(shares)
    if not len(H):
        return [], 1.0
    value, share = loosest(H)
    return [] if value > least else [_loose_flaw(bodies, first, share, value, q)], value


def rows_of(bodies: list[RigidBody]) -> Bodies:
    """Return the bodies as arrays."""
    joints = [body.frame.joint for body in bodies]
    return Bodies(
        [body.frame.parent for body in bodies],
        np.array([body.frame.E for body in bodies]),
        np.array([body.frame.r for body in bodies]),
        [joint is not None and joint.type == "prismatic" for joint in joints],
        np.array([joint.pitch if joint else 0.0 for joint in joints]),
        np.array([joint.armature if joint else 0.0 for joint in joints]),
        np.array([body.mass for body in bodies]),
        np.array([body.center for body in bodies]),
        np.array([body.inertia for body in bodies]),
    )


def by_body(bodies: list[RigidBody], rows: Mapping[str, int], joints: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the joint position (rows,) of each body, 0 for the root's; rows: `Model.joint_rows`, joints: (n,)."""
    return np.array([joints[rows[body.frame.joint.name]] if body.frame.joint else 0.0 for body in bodies])


def postures(
    bodies: list[RigidBody], couplings: Couplings, keyframes: Iterable[np.ndarray] = ()
) -> Iterator[np.ndarray]:
    """Yield the posture nearest to zero, the keyframes and others within the limits, up to half a turn either way."""
    joints = [body.frame.joint for body in bodies if body.frame.joint]
    zero = np.array([0.0, *(min(max(0.0, joint.lower), joint.upper) for joint in joints)])
    lower = np.maximum([0.0, *(joint.lower for joint in joints)], zero - math.pi)
    upper = np.minimum([0.0, *(joint.upper for joint in joints)], zero + math.pi)
    rows = {joint.name: k for k, joint in enumerate(joints, 1)}
    rng = np.random.default_rng(0)
    others = (lower + rng.random(len(zero)) * (upper - lower) for _ in range(POSTURES))
    for q in (zero, *(np.array(one) for one in keyframes), *others):
        for follower, leader, multiplier, offset in couplings:
            q[rows[follower]] = multiplier * q[rows[leader]] + offset
        yield q


def _positions(bodies: list[RigidBody], q: np.ndarray, rows: slice) -> str:
    """Return the joint positions of these rows for a message, cut short after ten."""
    joints = [(body.frame.joint, x) for body, x in zip(bodies[rows], q[rows]) if body.frame.joint]
    each = [f"{joint.name} at {x:.4g} {'m' if joint.type == 'prismatic' else 'rad'}" for joint, x in joints]
    return ", ".join(each[:10]) + (f" and {len(each) - 10} more" if len(each) > 10 else "")


def _idle_flaw(bodies: list[RigidBody], coordinate: int, inertia: float, q: np.ndarray) -> Flaw:
    """Describe a coordinate that moves no inertia at the joint positions q (rows,)."""
    row = max(0, coordinate - 5)
    body = bodies[row]
    how = f"about joint {body.frame.joint.name!r}" if body.frame.joint else "as the floating base"
    text = (
        f"{_named(body)} moves {how} but its inertia there is {float(inertia)!r}, with all that it carries and with "
        f"{_positions(bodies, q, slice(row, None))}; "
        "expected > 0: a point mass or an ideal rod on the axis needs its real, small inertia"
    )
    return Flaw(f"link {body.links[0]!r}", text)


def _loose_flaw(bodies: list[RigidBody], first: int, share: np.ndarray, least: float, q: np.ndarray) -> Flaw:
    """Describe coordinates that together move no inertia at q (rows,); share: of each coordinate from `first` on."""
    rows = sorted({max(0, first + int(k) - 5) for k in np.flatnonzero(share > 0.1 * share.max())})
    moving = [bodies[k] for k in rows]
    names = [f"joint {b.frame.joint.name!r}" if b.frame.joint else f"floating base {b.links[0]!r}" for b in moving]
    text = (
        f"link {moving[0].links[0]!r}: {', '.join(names[:10])} can move together without inertia with "
        f"{_positions(bodies, q, slice(rows[0], rows[-1] + 1))}: the least eigenvalue "
        f"of the mass matrix, scaled to a unit diagonal, is {least:.3g}; expected > 0: correct the masses and inertias "
        "there, or fix a joint"
    )
    return Flaw(f"link {moving[0].links[0]!r}", text)
