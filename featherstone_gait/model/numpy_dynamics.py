"""Poses, center of mass and mass matrix of one posture in plain NumPy, without waiting for a compiler.

`dynamics` computes them for many postures with compiled kernels, whose last bits differ.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..base.brief import brief
from ..base.fixed_order import applied, product
from ..base.rotation import rotation_from_quaternion
from .composite import TOLERANCE, Bodies, composites, frames, mass_matrix
from .degrees import is_first, turned_frame
from .mass_checks import by_body, flaws_at, postures, resisting, rows_of
from .robot import Model, rigid_bodies


class Poses(NamedTuple):
    """Frames of all links in the world.

    Attributes
    ----------
    rotation : numpy.ndarray
        Rotations link -> world, (links, 3, 3) or (n, links, 3, 3).
    position : numpy.ndarray
        Origins of the links' frames, (links, 3) or (n, links, 3) [m].
    """

    rotation: np.ndarray
    position: np.ndarray

    def __repr__(self) -> str:
        return brief(self)


def link_poses(model: Model, q: np.ndarray) -> Poses:
    """Compute the pose of every link, in the order of `model.links`; q: (nq,)."""
    placements = rigid_bodies(model)[1]
    E, o = _frames(_turned(model, q), _positions(model, q))
    places = [placements[link.name] for link in model.links]
    at = [place.row for place in places]
    rotation = product(E[at], np.array([place.E for place in places]))
    position = o[at] + applied(E[at], np.array([place.r for place in places]))
    if model.base == "floating":
        base = rotation_from_quaternion(q[3:7])
        rotation, position = product(base, rotation), np.array(q[:3]) + applied(base, position)
    return Poses(rotation, position)


def mass_center(model: Model, q: np.ndarray) -> np.ndarray:
    """Compute the center of mass (3,) in the world [m], a fixed base included; q: (nq,)."""
    center = _composites(model.skeleton, _joints(model, q))[3][0]
    if model.base == "fixed":
        return center
    return np.array(q[:3]) + applied(rotation_from_quaternion(q[3:7]), center)


def mass_matrix_at(model: Model, q: np.ndarray, armature: np.ndarray | None) -> np.ndarray:
    """Compute the mass matrix (nv, nv) at q (nq,), its base not turned; armature: (joints,) [kg m^2 or kg] or None."""
    bodies, order, at = _turned(model, q), _coordinates(model), _positions(model, q)
    bodies = bodies._replace(armature=_rotors(model, armature))
    H = mass_matrix(bodies, at, _composites(model.skeleton, _joints(model, q)))[0]
    base = list(range(6)) if model.base == "floating" else []
    rows = base + [6 + int(row) for row in np.argsort(order, kind="stable")]
    return H[np.ix_(rows, rows)]


def regular_posture(model: Model) -> np.ndarray:
    """Return a posture q (nq,) in which the mass matrix is regular: zero, if it is."""
    q = zero_position(model)
    bodies, floating = rigid_bodies(model)[0], model.base == "floating"
    if resisting(bodies, floating):
        return q
    tried = (_positions(model, q), *_postures(model))
    at = next((at for at in tried if not flaws_at(bodies, floating, at)[0]), tried[0])
    return _with_joints(model, at)


def sampled_postures(model: Model) -> np.ndarray:
    """Return postures (k, nq): the one nearest to zero, the keyframes, and others within the limits of the joints."""
    return np.array([_with_joints(model, at) for at in _postures(model)])


def _postures(model: Model) -> Iterator[np.ndarray]:
    keyframes = (_positions(model, np.array(one)) for one in model.keyframes.values())
    return postures(rigid_bodies(model)[0], model.couplings, keyframes)


def _with_joints(model: Model, at: np.ndarray) -> np.ndarray:
    """Return q (nq,) with the joint positions (rows,) of the bodies."""
    return at_joints(model, at[1:][np.argsort(_coordinates(model), kind="stable")])


def at_joints(model: Model, joints: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return q (nq,) with the degrees at these positions (n,) [rad or m]; the base and ball joints do not turn."""
    q = zero_position(model)
    for place, joint, position in zip(model.position_slices, model.moving_joints, joints):
        if joint.type != "ball":
            q[place] = position
    return q


def zero_position(model: Model) -> np.ndarray:
    """Return q (nq,) with all joints at zero, and quaternions that do not turn."""
    q = np.zeros(model.nq)
    if model.base == "floating":
        q[3] = 1.0
    for ball in model.balls:
        q[model.position_slices[ball].start] = 1.0
    return q


def with_quaternions(model: Model, joints: np.ndarray, ball_q: np.ndarray) -> np.ndarray:
    """Return the joints' part of q (..., nq - base) from numbers (..., n) of degrees and ball_q (..., 4 balls)."""
    if not model.balls:
        return joints
    q = np.empty((*joints.shape[:-1], model.nq - model.base_positions))
    for k, place in enumerate(model.position_slices):
        at = slice(place.start - model.base_positions, place.stop - model.base_positions)
        if at.stop == at.start + 1:
            q[..., at] = joints[..., k : k + 1]
        elif at.stop > at.start:
            ball = 4 * model.balls.index(k)
            q[..., at] = ball_q[..., ball : ball + 4]
    return q


def what_is_loose(model: Model, q: np.ndarray, armature: np.ndarray | None, least: float = TOLERANCE) -> str | None:
    """Describe what can move without inertia at q (nq,), its base left out of account; None if nothing can.

    armature: (joints,) [kg m^2 or kg] or None; least: eigenvalue of the scaled mass matrix below which something is.
    """
    bodies, floating = rigid_bodies(model)[0], model.base == "floating"
    if resisting(bodies, floating):
        return None
    at = _positions(model, q)
    flaws, _ = flaws_at(bodies, floating, at, _rotors(model, armature), least)
    return "; ".join(flaw.text for flaw in flaws) or None


def _rotors(model: Model, armature: np.ndarray | None) -> np.ndarray:
    """Return the armature of each body's joint, 0 for the root's."""
    if armature is None:
        return np.zeros(len(model.joint_names) + 1)
    return np.concatenate([[0.0], armature[_coordinates(model)]])


@functools.lru_cache(maxsize=8)
def _composites(model: Model, joints: bytes) -> tuple[np.ndarray, ...]:
    """Cache `frames` and `composites` of a posture; not to be changed."""
    q = np.concatenate([np.zeros(model.base_positions), np.frombuffer(joints)])
    bodies = _turned(model, q)
    E, o = _frames(bodies, _positions(model, q))
    return E, o, *composites(bodies, E, o)


def _frames(bodies: Bodies, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute `frames` once for robots that differ in their masses alone; not to be changed."""
    kinds = tuple(bodies.prismatic), tuple(bodies.pitch.tolist())
    return _known_frames(tuple(bodies.parent), *kinds, bodies.E.tobytes(), bodies.r.tobytes(), q.tobytes())


@functools.lru_cache(maxsize=8)
def _known_frames(
    parent: tuple[int, ...], slides: tuple[bool, ...], pitch: tuple[float, ...], E: bytes, r: bytes, q: bytes
) -> tuple[np.ndarray, np.ndarray]:
    n, none = len(parent), np.zeros(0)
    rotation, origin = np.frombuffer(E).reshape(n, 3, 3), np.frombuffer(r).reshape(n, 3)
    bodies = Bodies(list(parent), rotation, origin, list(slides), np.array(pitch), none, none, none, none)
    return frames(bodies, np.frombuffer(q))


def _coordinates(model: Model) -> list[int]:
    """Return the joint's position in `joint_names` for each body but the root's."""
    return [model.joint_rows[body.frame.joint.name] for body in rigid_bodies(model)[0] if body.frame.joint]


def _positions(model: Model, q: np.ndarray) -> np.ndarray:
    return by_body(rigid_bodies(model)[0], model.joint_rows, model.single_positions(q))


def _joints(model: Model, q: np.ndarray) -> bytes:
    return np.array(q[model.base_positions :], dtype=float).tobytes()


def _turned(model: Model, q: np.ndarray) -> Bodies:
    """Return the bodies, with the quaternions of ball joints in their frames."""
    bodies = rigid_bodies(model)[0]
    rows = rows_of(bodies)
    if model.balls:
        E = rows.E.copy()
        for k, body in enumerate(bodies):
            if body.frame.joint is not None and is_first(body.frame.joint):
                place = model.position_slices[model.joint_rows[body.frame.joint.name]]
                E[k] = turned_frame(E[k], q[place])
        rows = rows._replace(E=E)
    return rows
