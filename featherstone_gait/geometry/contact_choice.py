"""From collision shapes to the points that can touch the ground, and the choice of those that shall.

The feet of a robot are its lowest links at rest: in its keyframe "stand", "standing" or "home", else in the admissible
posture nearest to zero with the base upright.  They are the links that have shapes on bodies beyond which no other body
has any, and whose lowest shape comes within `FOOT` of the robot's height to the lowest of all; and any whose shape is
as low as that, as a foot with a toe before it.  Of links that are fixed to each other the lowest counts.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from ..base.arguments import instance, listed, texts
from ..base.brief import some
from ..base.fixed_order import applied, product
from ..base.rotation import rotation_from_rpy
from ..core.effects.touch import FLATNESS
from ..dynamics import Poses, forward_kinematics
from ..model import ContactPoint, Model, depth_first
from ..model.rest_posture import nearest_posture, standing_keyframe
from ..model.shapes import Box, Capsule, Cylinder, Hull, Mesh, Shape, Sphere
from .hull import MOST_CORNERS, Corners, corners_of, hull_indices
from .mesh import mesh_corners, mesh_hull

Choice: TypeAlias = str | Sequence[str]  # "all", "feet" or names of links

COARSE = 0.01  # of a shape's size, by which its hull may reach beyond its corners without a warning
THINNED = f"took hulls and meshes as {MOST_CORNERS} of their corners"
FOOT = 0.1  # of the robot's height
LEVEL = 1e-3  # of the robot's height, within which of the lowest contact point others carry the robot too
SOLE = 0.5  # of a foot's shape: the lower part whose corners are kept
SMALL = 0.25  # of a shape's largest side: what a sole is expected to span at least, ...
NARROW = 0.1  # ... unless all feet together span more than this part of the robot's height in each direction


def with_contacts(model: Model, choice: Choice) -> Model:
    """Return the robot with contact points made from some of its collision shapes.

    Parameters
    ----------
    model : Model
        The robot; its own contact points are replaced.
    choice : str or sequence of str
        "all" shapes; "feet", without the corners of the upper halves; or the names of links.

    Returns
    -------
    Model
        The robot with these contact points; a note names feet that may have been chosen in a posture in which the robot
        does not stand, and meshes of which too few corners are left.

    Raises
    ------
    ValueError
        For a link that does not exist or has no shape, for a robot without shapes, and for meshes that cannot be read.
    ImportError
        For meshes whose reader is not installed.
    """
    instance("model", model, Model, "give what load_robot returns")
    if not model.shapes:
        raise ValueError(
            f"{model.name}: contacts={choice!r}, but no link has a collision shape: add some to its links (in URDF "
            "<collision>, in MJCF geoms that touch the floor by contype and conaffinity or by a <pair>), or type "
            f"contact points into its TOML{f' (its notes: {some(model.notes)})' if model.notes else ''}"
        )
    if isinstance(choice, str):
        if choice not in ("all", "feet"):
            raise ValueError(f"contacts is {choice!r}; expected 'all', 'feet' or a list of links: write [{choice!r}]")
        points, doubts = (
            _sole_points(model) if choice == "feet" else (contact_points(model.shapes), thinned(model.shapes))
        )
        return replace(model, contacts=_carrying(model, points), notes=(*model.notes, *doubts))
    choice = texts("contacts", choice, "expected 'all', 'feet' or a list of links")
    shaped = list(dict.fromkeys(shape.link for shape in model.shapes))
    if not choice:
        raise ValueError(f"{model.name}: contacts names no link; use some of {', '.join(shaped)}")
    for name in choice:
        if name not in model.link_rows:
            raise ValueError(f"{model.name}: contacts: there is no link {name!r}; use some of {', '.join(shaped)}")
        if name not in shaped:
            raise ValueError(
                f"{model.name}: contacts: link {name!r} has no collision shape; use some of {', '.join(shaped)}, or "
                "add one to it"
            )
    own = [shape for shape in model.shapes if shape.link in choice]
    return replace(model, contacts=_carrying(model, contact_points(own)), notes=(*model.notes, *thinned(own)))


def usual_choice(model: Model) -> str | None:
    """Return the choice for a robot without contact points that messages name; None if no shapes can be taken.

    It is "feet" for legs, which have two joints or more, wheels not counted, and feet without doubts; else "all".
    """
    hinges = {model.root: 0}
    for joint in depth_first(model):
        hinges[joint.child] = hinges[joint.parent] + (joint.type not in ("fixed", "continuous"))
    for choice in ("feet", "all"):
        try:
            found = with_contacts(model, choice)
        except (ValueError, ImportError):
            continue
        legs = found.notes == model.notes and all(hinges[point.link] > 1 for point in found.contacts)
        if legs or choice == "all":
            return choice
    return None


def contact_points(shapes: Iterable[Shape]) -> tuple[ContactPoint, ...]:
    """Compute the contact points of collision shapes.

    A sphere is one contact, a capsule the spheres at its ends, a cylinder the circles at its ends, a box its corners; a
    hull or mesh is thinned to at most 32 corners.

    Parameters
    ----------
    shapes : iterable of Shape
        Collision shapes.

    Returns
    -------
    tuple of ContactPoint
        Contact points, shape by shape.

    Raises
    ------
    ValueError
        For a mesh that cannot be read.
    ImportError
        For a mesh whose reader is not installed.
    """
    found = listed("shapes", shapes, "give a list of Shape")
    for shape in found:
        instance("shapes", shape, Shape, "give a list of Shape")
    return tuple(point for shape in found for point in _points(shape))


def corner_error(shape: Shape) -> float:
    """Return how far the hull of a shape reaches beyond its thinned corners, at most [m]; 0 except for large hulls."""
    return _thinned(shape.geometry).error if isinstance(shape.geometry, Hull | Mesh) else 0.0


def thinned(shapes: Iterable[Shape]) -> list[str]:
    """Return what to say of hulls and meshes whose thinned corners miss more than `COARSE` of their size."""
    found: dict[tuple[str, float], None] = {}
    for shape in shapes:
        off = corner_error(shape)
        if off > 0.0 and off > COARSE * float(np.ptp(local_corners(shape), axis=0).max()):
            found[shape.name or f"of link {shape.link}", off] = None
    each = ", ".join(f"{name!r} {off:.3g} m" for name, off in sorted(found, key=lambda one: (-one[1], one[0])))
    remedy = "write spheres, capsules, cylinders or boxes for what must roll or be closer"
    return [f"{THINNED}, by which the rest reaches beyond them: {each}; {remedy}"] if found else []


def _points(shape: Shape) -> list[ContactPoint]:
    """Compute the contact points of one shape."""
    match shape.geometry:
        case Sphere(radius):
            return _placed(shape, np.zeros((1, 3)), radius=radius)
        case Capsule(radius, length):
            return _placed(shape, _ends(length), radius=radius)
        case Cylinder(radius, length):
            outward = rotation_from_rpy(shape.rpy)[:, 2:].T * [[-1.0], [1.0]]
            ends = zip(_ends(length - 2.0 * FLATNESS * radius), outward.tolist())  # of discs inside of the ends
            return [
                point
                for end, axis in ends
                for point in _placed(shape, end[None], circle_radius=radius, axis=tuple(axis))
            ]
    return _placed(shape, local_corners(shape))


def local_corners(shape: Shape) -> np.ndarray:
    """Return the corners (n, 3) of a box, or at most 32 of a hull or mesh, in the shape's frame [m]."""
    return _thinned(shape.geometry).points if isinstance(shape.geometry, Hull | Mesh) else _every_corner(shape)


def _thinned(geometry: Hull | Mesh) -> Corners:
    return mesh_corners(geometry) if isinstance(geometry, Mesh) else _thinned_hull(geometry)


@functools.lru_cache(maxsize=256)
def _thinned_hull(hull: Hull) -> Corners:
    return corners_of(hull.points)


def _every_corner(shape: Shape) -> np.ndarray:
    """Return all corners (n, 3) of a box, hull or mesh, in the shape's frame [m]."""
    match shape.geometry:
        case Box(size):
            signs = np.array([(x, y, z) for x in (1, -1) for y in (1, -1) for z in (1, -1)])
            return 0.5 * np.array(size) * signs
        case Mesh():
            return mesh_hull(shape.geometry)
        case Hull(points):
            return np.array(points)[hull_indices(np.array(points))]
    raise ValueError(f"link {shape.link!r}: a {type(shape.geometry).__name__} has no corners; give a box or a hull")


def _ends(length: float) -> np.ndarray:
    return np.array([(0.0, 0.0, -0.5 * length), (0.0, 0.0, 0.5 * length)])


def _placed(
    shape: Shape,
    points: np.ndarray,
    radius: float = 0.0,
    circle_radius: float = 0.0,
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> list[ContactPoint]:
    """Make contact points at points (n, 3) of a shape's frame."""
    at = np.array(shape.xyz) + applied(rotation_from_rpy(shape.rpy), points)
    own: dict[str, Any] = {"friction": shape.friction, "surface": shape.surface}
    if radius > 0 or circle_radius > 0:
        own["rolling_friction"] = shape.rolling_friction or 0.0
    return [ContactPoint(shape.link, (x, y, z), radius, circle_radius, axis, **own) for x, y, z in at.tolist()]


def _carrying(model: Model, points: Sequence[ContactPoint]) -> tuple[ContactPoint, ...]:
    """Mark those points as load-bearing that are lowest at rest."""
    poses = _poses_at_rest(model)
    height = lowest_levels(model, points, poses)
    level = height.min() + LEVEL * (poses.position[:, 2].max() - height.min())
    return tuple(replace(point, load_bearing=bool(z <= level)) for point, z in zip(points, height))


def _poses_at_rest(model: Model) -> Poses:
    """Compute the poses of all links as the robot stands: a sole that is upright at zero may lie flat there."""
    q = standing_keyframe(model)
    return forward_kinematics(model, nearest_posture(model) if q is None else q)


def lowest_levels(model: Model, points: Sequence[ContactPoint], poses: Poses) -> np.ndarray:
    """Compute the height of the lowest point of each contact, (points,) or (n, points) [m].

    poses: those of all links.
    """
    at = [model.link_rows[point.link] for point in points]
    local = np.array([point.position for point in points]).reshape(-1, 3)
    axes = np.array([point.axis for point in points]).reshape(-1, 3)
    up = poses.rotation[..., at, 2, :]
    height = poses.position[..., at, 2] + (up * local).sum(axis=-1)
    across = (up * axes).sum(axis=-1) ** 2
    tilt = np.sqrt(np.maximum(0.0, 1.0 - across) + FLATNESS**2 * across)
    rims, radii = np.array([(point.circle_radius, point.radius) for point in points]).reshape(-1, 2).T
    return height - radii - rims * tilt


def _sole_points(model: Model) -> tuple[tuple[ContactPoint, ...], tuple[str, ...]]:
    """Compute the contact points of the feet, and name the feet that do not look like soles."""
    poses = _poses_at_rest(model)
    parts, lowest, height = _soles(model, poses)
    _check_nothing_below(model, poses, lowest, lowest + FOOT * height)
    if not parts:
        raise ValueError(
            f"{model.name}: contacts='feet', but no link at an end of the robot comes within {FOOT:.0%} of its height "
            "to the ground at rest: name the links that shall touch it, or give contacts='all'"
        )
    points = tuple(point for _, part in parts for point in part)
    wide = _least_width(model, points, poses) >= NARROW * height
    doubts = () if wide else tuple(filter(None, (_doubt(shape, part) for shape, part in parts)))
    return points, doubts or tuple(_larger_soles(model, points))


def _soles(model: Model, poses: Poses) -> tuple[list[tuple[Shape, list[ContactPoint]]], float, float]:
    """Compute the contact points of each shape of the feet, the height of the lowest shape, and the robot's [m]."""
    spans = [_span(model, shape, poses) for shape in model.shapes]
    lowest = min(bottom for bottom, _ in spans)
    height = max(*(top for _, top in spans), poses.position[:, 2].max()) - lowest
    reach = lowest + FOOT * height
    links = _feet(model, spans, reach, LEVEL * height)
    soles = [shape for shape, (bottom, _) in zip(model.shapes, spans) if shape.link in links and bottom <= reach]
    return [(shape, _lower_half(model, shape, poses)) for shape in soles], lowest, height


def _larger_soles(model: Model, points: Sequence[ContactPoint]) -> Iterator[str]:
    """Yield a note where feet chosen without a standing keyframe stand on far more in another keyframe."""
    others = {} if standing_keyframe(model) is not None else model.keyframes
    for name, q in others.items():
        parts, _, _ = _soles(model, forward_kinematics(model, np.array(q)))
        there = [point for _, part in parts for point in part]
        for link in dict.fromkeys(point.link for point in points):
            (_, *now), (_, *then) = _link_spans(points, link), _link_spans(there, link)
            if now[0] * now[1] < SMALL * then[0] * then[1]:
                yield (
                    f"contacts='feet': at rest link {link!r} stands on {now[0]:.2g} x {now[1]:.2g} m, in the keyframe "
                    f"{name!r} on {then[0]:.2g} x {then[1]:.2g} m: if the robot stands in that one, repeat it under "
                    "the name 'stand' ([keyframes.stand] of its TOML), or name the links that shall touch the ground"
                )
                return


def _link_spans(points: Iterable[ContactPoint], link: str) -> list[float]:
    """Compute how far the points of a link span along its axes, in ascending order (3,) [m]."""
    at = [point.position for point in points if point.link == link]
    return sorted(np.ptp(np.array(at), axis=0).tolist()) if at else [0.0, 0.0, 0.0]


def _least_width(model: Model, points: Sequence[ContactPoint], poses: Poses) -> float:
    """Compute how wide the points are in the horizontal direction in which they are least wide [m]."""
    at = [model.link_rows[point.link] for point in points]
    local = np.array([point.position for point in points])
    placed = poses.position[at, :2] + (poses.rotation[at, :2, :] * local[:, None, :]).sum(axis=-1)
    angles = np.linspace(0.0, np.pi, 36, endpoint=False)
    return float(np.ptp(placed @ np.array([np.cos(angles), np.sin(angles)]), axis=0).min())


def _doubt(shape: Shape, points: Sequence[ContactPoint]) -> str | None:
    """Return a note where a foot stands on a small part of its shape, as a sole does that is upright."""
    if isinstance(shape.geometry, Sphere | Capsule | Cylinder):
        return None
    sizes = np.sort(np.ptp(_every_corner(shape), axis=0))
    kept = applied(rotation_from_rpy(shape.rpy).T, np.array([point.position for point in points]))
    spans = np.sort(np.ptp(kept, axis=0))
    if spans[1] * spans[2] >= SMALL * sizes[1] * sizes[2]:
        return None
    return (
        f"contacts='feet': at rest link {shape.link!r} stands on {spans[1]:.2g} x {spans[2]:.2g} m of a shape of "
        f"{sizes[1]:.2g} x {sizes[2]:.2g} m, and the feet span less than a tenth of the robot's height: give a "
        "keyframe 'stand' in which it stands, or name the links or points that shall touch the ground"
    )


def _span(model: Model, shape: Shape, poses: Poses) -> tuple[float, float]:
    """Compute the heights of the lowest and the highest point of a shape [m]."""
    cornered = isinstance(shape.geometry, Box | Hull | Mesh)
    points = _placed(shape, _every_corner(shape)) if cornered else _points(shape)
    bottoms = lowest_levels(model, points, poses)
    centers = lowest_levels(model, [replace(point, radius=0.0, circle_radius=0.0) for point in points], poses)
    return float(bottoms.min()), float((2.0 * centers - bottoms).max())


def _lower_half(model: Model, shape: Shape, poses: Poses) -> list[ContactPoint]:
    """Compute the contact points of a shape; of corners those of its lower half at rest, chosen along world axes."""
    if isinstance(shape.geometry, Sphere | Capsule | Cylinder):
        return _points(shape)
    E = product(poses.rotation[model.link_rows[shape.link]], rotation_from_rpy(shape.rpy))
    corners = _every_corner(shape)
    upright = applied(E, corners)
    heights = upright[:, 2]
    lower = upright[heights <= heights.min() + SOLE * np.ptp(heights)]
    kept = corners_of(lower).points
    return _placed(shape, np.array([corners[np.abs(upright - x).max(axis=1).argmin()] for x in kept]))


def _check_nothing_below(model: Model, poses: Poses, lowest: float, reach: float) -> None:
    """Raise ValueError where links without shapes lie well below the lowest shape: the feet are among them."""
    k = int(poses.position[:, 2].argmin())
    if poses.position[k, 2] < 2.0 * lowest - reach:
        depth = lowest - poses.position[k, 2]
        raise ValueError(
            f"{model.name}: contacts='feet', but link {model.links[k].name!r} lies {depth:.3g} m below the lowest "
            "collision shape at rest and has none: give contacts='all', name the links that shall touch the ground, or "
            "type contact points"
        )


def _feet(model: Model, spans: Sequence[tuple[float, float]], reach: float, level: float) -> set[str]:
    """Find the links of the feet: the lowest links of bodies that are low and at an end, or as low as the lowest.

    spans: lowest and highest point of each shape [m]; reach: largest height of a foot's lowest point [m]; level:
    difference in height that counts as equal [m].
    """
    body, ends = _bodies(model)
    lows = [min(low for (low, _), s in zip(spans, model.shapes) if body[s.link] == body[t.link]) for t in model.shapes]
    lowest = min(lows, default=0.0)
    return {
        shape.link
        for shape, (bottom, _), low in zip(model.shapes, spans, lows)
        if bottom <= low + level
        and (low <= reach if body[shape.link] in ends else body[shape.link] > 0 and low <= lowest + level)
    }


def _bodies(model: Model) -> tuple[dict[str, int], set[int]]:
    """Group links that fixed joints connect: return the body of each link, and the outermost bodies with shapes.

    The root's body is 0.
    """
    body = {model.root: 0}
    parent = [0]
    for joint in depth_first(model):
        body[joint.child] = body[joint.parent]
        if joint.type != "fixed":
            body[joint.child] = len(parent)
            parent.append(body[joint.parent])
    shaped = {body[shape.link] for shape in model.shapes}
    carries: set[int] = set()  # bodies with shapes further out
    for k in range(len(parent) - 1, 0, -1):
        if k in shaped or k in carries:
            carries.add(parent[k])
    return body, shaped - carries
