"""Find bodies that overlap in a state, and tell of them where a run starts."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import instance
from ..base.fixed_order import applied, product, total
from ..core.effects.pair import Pairs
from ..core.shapes.distance import FIELD, Room, pair_distances
from ..scene.compile import CompiledScene
from ..scene.contact import half_thickness
from ..scene.loads import body_poses
from .start import checked_state, initial_state, positions_in
from .trajectory import Trajectory

AT_REST = 2.0  # times the depth at which bodies rest: what lies deeper is told
SHOWN = 5  # pairs in a message


class OverlapWarning(UserWarning):
    """Bodies that can touch each other overlap where a run starts."""


def overlaps(scene: CompiledScene, state: ArrayLike | Trajectory | None = None) -> list[tuple[tuple[str, str], float]]:
    """Compute how deep bodies that can touch each other overlap in a state.

    Parameters
    ----------
    scene : CompiledScene
        A scene with `pairs`.
    state : array_like or Trajectory, optional
        The state (length,), or a trajectory, whose end it is.  None: where all members stand first.

    Returns
    -------
    list of ((str, str), float)
        Each two links that overlap, the deepest first, and the way [m] that they must move to part; of cylinders it is
        at most that.  The ground and height fields are left out.

    Raises
    ------
    ValueError
        For what is no state of the scene.
    """
    instance("scene", scene, CompiledScene, "give what compile_scene returns")
    pairs, y = scene.touching.table, initial_state(scene) if state is None else checked_state(scene, state)
    if pairs is None:
        return []
    depth = _depths(scene, pairs, y)
    deepest: dict[tuple[str, str], float] = {}
    for k in np.flatnonzero(depth > 0.0):
        names = scene.pairs[k]
        deepest[names] = max(deepest.get(names, 0.0), float(depth[k]))
    return sorted(deepest.items(), key=lambda found: -found[1])


def tell_overlaps(scene: CompiledScene, y: np.ndarray) -> None:
    """Warn of bodies that overlap in the first state (length,) of a run by more than they do at rest.

    Raises ValueError where one lies so deep in another that it may be pushed out on the far side.
    """
    pairs = scene.touching.table
    if pairs is None or y[scene.layout["end_time"]] > 0:  # the run goes on
        return
    half = half_thickness(pairs.shapes)
    most = np.minimum(half[pairs.pairs.a], half[pairs.pairs.b])
    depth = _depths(scene, pairs, y, np.minimum(most, AT_REST * pairs.margin))
    lost = depth > most
    if lost.any():
        raise ValueError(
            f"{scene.model.name}: bodies overlap at the start by more than half of the smaller one: "
            f"{_listed(scene, depth, lost)}; move them apart, or leave the pair out (excluded=, or pairs= of names)"
        )
    deep = depth > AT_REST * pairs.margin
    if deep.any():
        text = f"{scene.model.name}: bodies overlap at the start, and are pushed apart: {_listed(scene, depth, deep)}"
        warnings.warn(text, OverlapWarning, stacklevel=3)


def _listed(scene: CompiledScene, depth: np.ndarray, which: np.ndarray) -> str:
    """Name some of the pairs, the deepest first."""
    rows = [k for k in np.argsort(-depth, kind="stable") if which[k]]
    found = [f"{' and '.join(map(repr, scene.pairs[k]))} by {depth[k]:.3g} m" for k in rows[:SHOWN]]
    return ", ".join([*found, *([f"{len(rows) - SHOWN} more"] if len(rows) > SHOWN else [])])


def _depths(scene: CompiledScene, pairs: Pairs, y: np.ndarray, least: ArrayLike = 0.0) -> np.ndarray:
    """Compute how deep the shapes of each pair (pairs,) overlap [m]; 0 where they are apart, or one is no solid.

    least: a depth, or one of each pair, up to which it may be 0 too [m].  Where boxes about the shapes show that no
    pair is deeper, nothing has to be compiled.
    """
    bases, table = y[slice(*scene.part("base_q"))].reshape(-1, 7), pairs.shapes.table
    joints = [positions_in(one.scene, scene.state_of(one.name, y))[one.model.base_positions :] for one in scene.members]
    rotation, position = body_poses(scene.members, scene.tree, bases, joints)
    center = position[table.link] + applied(rotation[table.link], table.r)
    both = np.stack([pairs.pairs.a, pairs.pairs.b], axis=1)
    apart = center[both[:, 0]] - center[both[:, 1]]
    reach = table.bound[both].sum(axis=1)
    solid = (table.kind[both] != FIELD).all(axis=1)
    close = (total(apart * apart) < reach * reach) & np.isfinite(reach) & solid
    boxes = _depths_of_boxes(table, rotation, both[close], apart[close])
    close[close] = boxes > np.broadcast_to(least, len(both))[close]
    near = np.flatnonzero(close)
    distance, depth = np.zeros(len(near)), np.zeros(len(both))
    if len(near):
        n = len(table)
        room = Room(np.zeros((n, 9)), np.zeros((n, 3)), np.zeros((4, 3)))
        pair_distances(pairs.shapes, room, np.ascontiguousarray(both[near]), rotation, position, distance)
    depth[near] = np.maximum(-distance, 0.0)
    return depth


def _depths_of_boxes(table: np.recarray, rotation: np.ndarray, both: np.ndarray, apart: np.ndarray) -> np.ndarray:
    """Compute how deep the boxes about the shapes of pairs (n, 2) overlap along the face normal that divides them best.

    table: of `Shapes`; apart (n, 3): from the center of the second shape of each pair to that of the first [m].
    """
    axes = product(rotation[table.link], table.E.reshape(-1, 3, 3))[both].transpose(0, 1, 3, 2)
    normals = axes.reshape(-1, 6, 3)
    half = table.extent[both][:, :, None]
    reach = [total(abs(product(normals, axes[:, k].transpose(0, 2, 1))) * half[:, k]) for k in (0, 1)]
    return (reach[0] + reach[1] - abs(applied(normals, apart))).min(axis=1)
