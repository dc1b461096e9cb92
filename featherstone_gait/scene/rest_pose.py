"""Poses, center of mass and mass matrix of one posture in plain NumPy: what a scene asks once waits for no compiling.

`dynamics` has them for many postures, and with other last bits.
"""

from __future__ import annotations

import functools

import numpy as np

from ..base.fixed_order import applied, product
from ..base.rotation import rotation_from_quaternion
from ..dynamics import Poses
from ..model import Model
from ..model.rigid_bodies import Bodies, composites, frames, mass_matrix
from .tree import Tree, compile_tree


def rest_poses(model: Model, q: np.ndarray) -> Poses:
    """Pose of every link, in the order of `model.links`; q: (nq,)."""
    tree = compile_tree(model)
    E, o = _frames(_bodies(tree), _positions(tree, q))
    places = [tree.placements[link.name] for link in model.links]
    at = [place.row for place in places]
    rotation = product(E[at], np.array([place.E for place in places]))
    position = o[at] + applied(E[at], np.array([place.r for place in places]))
    if tree.floating:
        base = rotation_from_quaternion(q[3:7])
        rotation, position = product(base, rotation), np.array(q[:3]) + applied(base, position)
    return Poses(rotation, position)


def rest_center(model: Model, q: np.ndarray) -> np.ndarray:
    """Center of mass (3,) in the world [m], a fixed base included; q: (nq,)."""
    tree = compile_tree(model)
    center = _composites(model.skeleton, _positions(tree, q).tobytes())[3][0]
    return np.array(q[:3]) + applied(rotation_from_quaternion(q[3:7]), center) if tree.floating else center


def rest_mass_matrix(model: Model, armature: np.ndarray | None) -> np.ndarray:
    """Mass matrix (nv, nv) at zero; armature: (joints,) or None."""
    tree = compile_tree(model)
    q = np.zeros(tree.n + 1)
    H = mass_matrix(_bodies(tree, armature), q, _composites(model.skeleton, q.tobytes()))[0]
    base = list(range(6)) if tree.floating else []
    order = base + [6 + int(row) for row in np.argsort(tree.bodies["dof"][1:], kind="stable")]
    return H[np.ix_(order, order)]


@functools.lru_cache(maxsize=8)
def _composites(model: Model, q: bytes) -> tuple[np.ndarray, ...]:
    """`frames` and `composites` of a posture of the rows; not to be changed."""
    bodies = _bodies(compile_tree(model))
    E, o = _frames(bodies, np.frombuffer(q))
    return E, o, *composites(bodies, E, o)


def _frames(bodies: Bodies, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`frames`, worked out once for robots that differ in their masses alone; not to be changed."""
    places = tuple(bodies.parent), tuple(bodies.prismatic), bodies.E.tobytes(), bodies.r.tobytes()
    return _known_frames(*places, q.tobytes())


@functools.lru_cache(maxsize=8)
def _known_frames(
    parent: tuple[int, ...], slides: tuple[bool, ...], E: bytes, r: bytes, q: bytes
) -> tuple[np.ndarray, np.ndarray]:
    n, none = len(parent), np.zeros(0)
    rotation, origin = np.frombuffer(E).reshape(n, 3, 3), np.frombuffer(r).reshape(n, 3)
    bodies = Bodies(list(parent), rotation, origin, list(slides), none, none, none, none)
    return frames(bodies, np.frombuffer(q))


def _bodies(tree: Tree, armature: np.ndarray | None = None) -> Bodies:
    b = tree.bodies
    rotors = np.zeros(len(b))
    if armature is not None:
        rotors[1:] = armature[b["dof"][1:]]
    xx, xy, xz, yy, yz, zz = b["J"].T
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1)
    parents, slides = b["parent"].tolist(), (b["prismatic"] != 0).tolist()
    E = np.array(b["E"]).reshape(-1, 3, 3)
    return Bodies(parents, E, np.array(b["r"]), slides, rotors, np.array(b["m"]), np.array(b["c"]), inertia)


def _positions(tree: Tree, q: np.ndarray) -> np.ndarray:
    """Joint positions (rows,) of the rows."""
    joints = np.asarray(q, dtype=float)[-tree.n :] if tree.n else np.zeros(0)
    return np.concatenate([[0.0], joints[tree.bodies["dof"][1:]]])
