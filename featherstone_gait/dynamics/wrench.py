"""External forces on links as kernels take them: wrenches, borne weights, springs of tendons along a path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..base.arguments import floats, instance, shown
from ..base.brief import brief
from ..base.fixed_order import applied
from ..model import Model, Tendon
from .kinematics import body_poses, forward_kinematics
from .tendons import lengths_of, pieces, spring_forces
from .tree import Tree, build_lifts


class Wrench(NamedTuple):
    """An external force and moment on a link, at the origin of its frame, in world axes.

    Attributes
    ----------
    force : array_like
        Force (3,) or (n, 3) [N].
    moment : array_like
        Moment (3,) or (n, 3) about the origin of the link's frame [N m].
    """

    force: ArrayLike = (0.0, 0.0, 0.0)
    moment: ArrayLike = (0.0, 0.0, 0.0)

    def __repr__(self) -> str:
        return brief(self)


Wrenches = Mapping[str, Wrench]  # by link


def external_forces(
    model: Model, tree: Tree, q: np.ndarray, wrench: Wrenches | None, gravity: np.ndarray
) -> np.ndarray | None:
    """Compute external forces (n, bodies, 6) about the common origin; None if there are none.

    Borne weights and the springs of tendons along a path are among them.
    """
    if wrench is not None:
        instance("wrench", wrench, Mapping, "give {link: Wrench(force, moment)}")
    lifts = build_lifts(model, tree, gravity)
    sprung = [one for one in model.tendons if one.stiffness > 0 and one.path]
    if not wrench and lifts is None and not sprung:
        return None
    poses = body_poses(tree, q)
    out = np.zeros((len(q), tree.n + 1, 6))
    for lift in () if lifts is None else lifts:
        p = poses[:, lift.body, 9:] + applied(poses[:, lift.body, :9].reshape(-1, 3, 3), lift.point)
        out[:, lift.body, :3] += np.cross(p, lift.force)
        out[:, lift.body, 3:] += lift.force
    for name, value in (wrench or {}).items():
        if name not in tree.placements:
            raise ValueError(f"{model.name}: wrench: no link {name!r} to push; links: {', '.join(tree.placements)}")
        force, moment = _force_and_moment(f"{model.name}: wrench on {name}", value, len(q))
        place = tree.placements[name]
        p = poses[:, place.row, 9:] + applied(poses[:, place.row, :9].reshape(-1, 3, 3), place.r)
        out[:, place.row, :3] += moment + np.cross(p, force)
        out[:, place.row, 3:] += force
    _add_paths(model, tree, q, sprung, poses, out)
    return out


def _add_paths(
    model: Model, tree: Tree, q: np.ndarray, tendons: list[Tendon], poses: np.ndarray, out: np.ndarray
) -> None:
    """Add the springs of tendons along a path to external forces."""
    if not tendons:
        return
    at, pulls = forward_kinematics(model, q), spring_forces(tendons, lengths_of(model, q, tendons))
    for tendon, pull in zip(tendons, pulls.T):
        for one in pieces(model, at, tendon):
            for link, end, sign in ((one.link_a, one.a, -one.share), (one.link_b, one.b, one.share)):
                if link is None:
                    continue
                place, force, row = tree.placements[link], sign * pull[:, None] * one.direction, model.link_index(link)
                back = np.swapaxes(at.rotation[..., row, :, :], -1, -2)
                arm = place.r + applied(place.E, applied(back, end - at.position[..., row, :]))
                p = poses[:, place.row, 9:] + applied(poses[:, place.row, :9].reshape(-1, 3, 3), arm)
                out[:, place.row, :3] += np.cross(p, force)
                out[:, place.row, 3:] += force


def _force_and_moment(what: str, value: Any, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the parts (n, 3) of a wrench."""
    instance(what, value, Wrench, "give Wrench(force, moment)")
    parts = [floats(f"{what}: {name}", part) for name, part in zip(value._fields, value)]
    for part in parts:
        if part.shape not in ((3,), (n, 3)) or not np.isfinite(part).all():
            expected = f"Wrench(force, moment), each (3,) or ({n}, 3) finite numbers"
            raise ValueError(f"{what} must be {expected}: {shown(value)}")
    force, moment = (np.broadcast_to(part, (n, 3)) for part in parts)
    return force, moment
