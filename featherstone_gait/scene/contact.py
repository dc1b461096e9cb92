"""Build contact points and ground."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..base.fixed_order import applied
from ..base.portable_math import sincos
from ..base.records import fill, records
from ..base.rotation import dot, rotation_from_quaternion
from ..core.effects.contact import MOTION, POINT, ROLLER, ROLLING, Contact
from ..core.effects.touch import DISC, Discs, Spheres
from ..core.shapes.distance import HALF_SPACE, Shapes
from ..core.shapes.ground import GRID, PLANE, RISE, Field, Plane, facets
from ..dynamics import deepest_points
from ..dynamics.tree import Tree
from ..geometry.contact_choice import usual_choice
from ..geometry.distance import shape_tables
from ..model import Ground, HeightField, Model
from ..model.ground import ContactPoint
from ..model.numpy_dynamics import link_poses, mass_center, zero_position
from ..model.rest_posture import standing_keyframe
from .surface import build_surfaces, drives_of

if TYPE_CHECKING:
    from .options import SceneOptions

TWO_DEPTHS = 2.0  # of resting, which are no sinking in, however thin a body is
SUNK = 0.1  # of its standing height, from where on a robot is too deep in the ground whatever presses it


def build_contact(model: Model, tree: Tree, options: SceneOptions) -> Contact | None:
    """Build contact points and ground; None without ground.

    Raises ValueError where there is gravity that does not press on it.
    """
    ground, gravity = options.ground, np.asarray(options.gravity)
    if ground is None:
        return None
    if not model.contacts:
        choice = usual_choice(model)
        take = f"load it with contacts={choice!r} to take its collision shapes, or add contacts to its TOML"
        take = take if choice else "add contacts to its TOML, or collision shapes to its file"
        raise ValueError(f"{model.name}: ground without contact points; {take}, or give ground=None")
    if gravity.any() and not dot(plane_axes(ground)[0], gravity) < 0:
        raise ValueError(
            f"{model.name}: ground under gravity {tuple(gravity.tolist())} m/s^2, which presses nothing on it: its "
            "stiffness follows from the robot's weight; give a gravity that points into the ground, gravity=(0, 0, 0), "
            "for which it follows from the weight on Earth, or ground=None"
        )
    under = _plane(ground) if ground.field is None else build_field(ground.field, ground.height)
    points = _points(model, tree, ground, options.pressing)
    return Contact(
        points, under, _curvature(model, tree), _motion(ground), _rollers(model, tree, ground), _surfaces(model, tree),
        _rolling(model, tree, points),
    )  # fmt: skip


def _motion(ground: Ground) -> np.recarray | None:
    """Build how the surface moves, None where it does not."""
    if not ground.moves:
        return None
    normal, first, second = plane_axes(ground)
    table, (x, y) = records(1, MOTION), ground.center
    table[0].velocity = ground.velocity[0] * first + ground.velocity[1] * second
    z = ground.height - float(normal[0] * x + normal[1] * y) / float(normal[2])
    table[0].center, table[0].spin, table[0].rate = (x, y, z), ground.turning * normal, ground.turning
    return table


def _rollers(model: Model, tree: Tree, ground: Ground) -> np.recarray | None:
    """Build the rollers of wheels, in the order of the points; None without."""
    contacts = [model.contacts[k] for k in by_body(model, tree)]
    if all(point.roller_angle is None for point in contacts):
        return None
    table = records(len(contacts), ROLLER)
    for row, point in zip(table, contacts):
        if point.roller_angle is not None:
            row.on, row.axis = 1, applied(tree.placements[point.link].E, np.array(point.axis))
            row.sine, row.cosine = sincos(point.roller_angle)
            along = ground.friction if point.friction is None else point.friction
            row.free = point.roller_friction / along if along > 0 else 0.0
    return table


def _surfaces(model: Model, tree: Tree) -> np.recarray | None:
    """Build the surfaces of links at their contact points, in the order of the points; None where all are at rest."""
    numbers = {name: k for k, name in enumerate(drives_of(model))}
    contacts = [model.contacts[k] for k in by_body(model, tree)]
    places = [tree.placements[point.link] for point in contacts]
    return build_surfaces([(point, place.E, place.r, numbers) for point, place in zip(contacts, places)])


def _rolling(model: Model, tree: Tree, points: np.recarray) -> np.recarray | None:
    """Build what resists rolling, None where nothing does; springs and dampers are those of friction at the radius."""
    contacts = [model.contacts[k] for k in by_body(model, tree)]
    if not any(point.rolling_friction for point in contacts):
        return None
    table, radii = records(len(contacts), ROLLING), np.array([one.radius + one.circle_radius for one in contacts])
    lever = np.where(radii > 0.0, radii, 1.0)  # of points, which have none, the moment is 0
    table.friction = [point.rolling_friction for point in contacts]
    table.tangential_stiffness = points.tangential_stiffness * lever * lever
    table.tangential_damping = points.tangential_damping * lever * lever
    return table


def _points(model: Model, tree: Tree, ground: Ground, g: float) -> np.recarray:
    """Compute stiffness and damping of the contact points from penetration and damping ratio.

    k = m g / (N penetration); for small motions about rest c = 2 zeta sqrt(k m / N), which the law of Hunt and Crossley
    has at its static depth for d = 2 zeta / sqrt(g penetration).
    """
    contacts = [model.contacts[k] for k in by_body(model, tree)]
    share = model.mass / (sum(point.load_bearing for point in contacts) or len(contacts))
    k = share * g / ground.penetration
    table, places = records(len(contacts), POINT), [tree.placements[point.link] for point in contacts]
    E, r = np.array([place.E for place in places]), np.array([place.r for place in places])
    table.position = r + applied(E, np.array([point.position for point in contacts]))
    table.body = [place.row for place in places]
    table.friction = [ground.friction if point.friction is None else point.friction for point in contacts]
    table.stiffness, table.damping = k, 2.0 * ground.damping_ratio / math.sqrt(g * ground.penetration)
    table.tangential_stiffness = k
    table.tangential_damping = 2.0 * max(ground.damping_ratio, 0.1) * math.sqrt(k * share)
    rise = max((abs(rise) for _, rise in ground.steps), default=0.0)  # a toe is that deep behind a rise's face
    table.deepest = np.maximum(_half_sizes(model, contacts), _usual_depth(model, ground)) + rise
    return table


def _usual_depth(model: Model, ground: Ground) -> float:
    """Return how deep a contact point may be however thin its link is [m].

    The ground has no far side on which a foot could come out: a point may be as deep as twice the robot's weight
    presses one point in, for a robot on the edge of a foot, or on rough ground, rests on few of its points, but not
    deeper than a share of its standing height.
    """
    if model.base == "fixed":
        return TWO_DEPTHS * ground.penetration
    points = sum(point.load_bearing for point in model.contacts) or len(model.contacts)
    on_one = min(TWO_DEPTHS * points * ground.penetration, SUNK * standing_posture(model)[0])
    return max(TWO_DEPTHS * ground.penetration, on_one)


def _half_sizes(model: Model, contacts: Sequence[ContactPoint]) -> list[float]:
    """Return how deep each contact point may be until its link is half in the ground [m].

    It is half the thickness of the link's thickest shape; of a link without, its round contact's radius, or how far
    the point is from the center of mass.
    """
    half, found = half_thickness(shape_tables(model.shapes, [0] * len(model.shapes))), list[float]()
    links = {link.name: link for link in model.links}
    for point in contacts:
        own = [float(size) for size, shape in zip(half, model.shapes) if shape.link == point.link]
        arm = np.array(point.position) - np.array(links[point.link].center_of_mass)
        found.append(max(own) if own else max(point.radius + point.circle_radius, math.sqrt(dot(arm, arm))))
    return found


def half_thickness(shapes: Shapes) -> np.ndarray:
    """Return half of the least extent of each shape along its axes (shapes,) [m]; inf of half spaces and fields."""
    return np.where(shapes.table.kind >= HALF_SPACE, math.inf, shapes.table.extent.min(axis=1, initial=math.inf))


def bearing(contact: Contact | None, loads: np.ndarray | None, trees: np.recarray | None) -> Contact | None:
    """Return contact points as stiff as what lies on their trees asks for; loads (trees,): by the tree's own mass.

    They are damped along the ground by their own mass.
    """
    if contact is None or loads is None or trees is None:
        return contact
    more = loads[np.searchsorted(trees.end, contact.points.body, side="right")]
    tables = [contact.points.copy(), *([] if contact.rolling is None else [contact.rolling.copy()])]
    tables[0].stiffness *= more
    for table in tables:
        table.tangential_stiffness *= more
        table.tangential_damping *= np.sqrt(more)
    return contact._replace(points=tables[0], rolling=tables[1] if len(tables) > 1 else None)


def by_body(model: Model, tree: Tree) -> list[int]:
    """Return the indices of the contact points, ordered by body."""
    rows = [tree.placements[point.link].row for point in model.contacts]
    return sorted(range(len(rows)), key=rows.__getitem__)


def _curvature(model: Model, tree: Tree) -> Spheres | Discs | None:
    """Build the spheres or discs of the contacts, in the order of the table; None if all are points."""
    contacts = [model.contacts[k] for k in by_body(model, tree)]
    if any(point.circle_radius for point in contacts):
        table = records(len(contacts), DISC)
        for row, point in zip(table, contacts):
            fill(row, point)
            row.axis = applied(tree.placements[point.link].E, np.array(point.axis))
        return Discs(table)
    if any(point.radius for point in contacts):
        return Spheres(np.array([point.radius for point in contacts], dtype=float))
    return None


def plane_axes(ground: Ground) -> np.ndarray:
    """Return normal, first and second tangent of a plane ground, in rows (3, 3)."""
    s, c = sincos(ground.slope)
    sine, cosine = sincos(ground.heading)
    normal = (-s * cosine + 0.0, -s * sine + 0.0, c)  # + 0.0: no negative zeros
    return np.array([normal, (c * cosine, c * sine, s), (-sine + 0.0, cosine, 0.0)])


def _plane(ground: Ground) -> Plane:
    plane, rises = records(1, PLANE), records(len(ground.steps), RISE)
    plane[0].normal, plane[0].first, plane[0].second = axes = plane_axes(ground)
    plane[0].height = ground.height * axes[0, 2]
    for row, (start, rise) in zip(rises, ground.steps):
        row.start, row.rise = start, rise
    return Plane(plane, rises)


def build_field(field: HeightField, height: float) -> Field:
    """Build the field at the ground's height, its edge repeated once so that no look-up leaves it."""
    grid, heights = records(1, GRID), np.pad(field.heights + height, 1, mode="edge")
    grid[0].origin = np.array(field.origin) - field.spacing
    grid[0].cells = 1.0 / np.array(field.spacing)
    grid[0].nodes = field.heights.shape
    grid[0].top = heights.max()
    grid[0].margin = min(field.spacing)
    return Field(grid, np.ascontiguousarray(heights).ravel())


def ground_under(ground: Ground, points: np.ndarray) -> np.ndarray:
    """Look up the ground under points (k, 3).

    Returns (k, 7): normal, first tangent, and the height of each point over the ground along z [m].
    """
    points = np.ascontiguousarray(points, dtype=float)
    out = np.empty((len(points), 7))
    if ground.field is not None:
        facets(build_field(ground.field, ground.height), points, out)
        return out
    plane = _plane(ground)
    axes = plane.plane[0]
    out[:, :3], out[:, 3:6] = axes.normal, axes.first
    for row, x in zip(out, points):
        rises = sum(step.rise for step in plane.steps if dot(axes.first, x) > step.start)
        row[6] = (dot(axes.normal, x) - axes.height - rises) / axes.normal[2]
    return out


def over_ground(ground: Ground, points: np.ndarray) -> np.ndarray:
    """Return the heights (k,) of points (k, 3) over the ground, along its normal [m]."""
    found = ground_under(ground, points)
    return found[:, 6] * found[:, 2]


def standing_height(model: Model, ground: Ground, q: np.ndarray) -> float:
    """Compute the height of the base [m] at which the lowest contact in posture q is at its static penetration."""
    if ground.field is not None:
        return _height_on_field(model, ground, q)
    clearances = []
    s, c = sincos(ground.slope)
    sine, cosine = sincos(ground.heading)
    for x in deepest_points(model, link_poses(model, q), plane_axes(ground)[0]):
        ahead = cosine * x[0] + sine * x[1] if ground.heading else x[0]
        surface = ground.height + s / c * ahead
        along = c * ahead + s * surface
        rises = sum(rise for start, rise in ground.steps if along > start)
        clearances.append(x[2] - surface - rises / c)
    return -min(clearances) - ground.penetration / c


def _height_on_field(model: Model, ground: Ground, q: np.ndarray) -> float:
    """Compute `standing_height` on a field, where normals change with the height: three steps of Newton's method."""
    q, up = np.array(q, dtype=float), np.array([0.0, 0.0, 1.0])
    for _ in range(3):
        poses = link_poses(model, q)
        normals = ground_under(ground, deepest_points(model, poses, up))[:, :3]
        under = ground_under(ground, deepest_points(model, poses, normals))
        lowest = under[:, 6].argmin()
        q[2] -= under[lowest, 6] + ground.penetration / under[lowest, 2]
    return float(q[2])


def standing_posture(model: Model) -> tuple[float, tuple[float, float, float]]:
    """Return the height of the center of mass over the lowest contact [m], and what points up in the root's frame (3,).

    The posture is the keyframe "stand", "standing" or "home", else the zero posture.  There the root's z axis points
    up, unless contacts are as high along it as the center of mass, and another axis of the root has all of them below.
    """
    return _standing(model.skeleton)


@functools.lru_cache(maxsize=8)
def _standing(model: Model) -> tuple[float, tuple[float, float, float]]:
    q = standing_keyframe(model)
    if q is not None:
        up = rotation_from_quaternion(q[3:7])[2]
        q[:7] = 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0
        return _heights_along(model, q, [up])[0][0], (float(up[0]), float(up[1]), float(up[2]))
    q = zero_position(model)
    axes = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0))
    over = _heights_along(model, q, axes)
    under = [axis for axis, (_, highest) in zip(axes, over) if highest > 0.0]
    up = axes[0] if axes[0] in under or len(under) != 1 else under[0]
    return over[axes.index(up)][0], up


def _heights_along(model: Model, q: np.ndarray, axes: Sequence[ArrayLike]) -> list[tuple[float, float]]:
    """Return how far the center of mass is over the lowest and over the highest contact along each of the axes [m]."""
    center, poses, heights = mass_center(model, q), link_poses(model, q), []
    for up in map(np.asarray, axes):
        contacts = [dot(up, x) for x in deepest_points(model, poses, up)]
        heights.append((dot(up, center) - min(contacts), dot(up, center) - max(contacts)))
    return heights


def fall_limits(model: Model, options: SceneOptions) -> tuple[float, float, tuple[float, float, float]]:
    """Compute at which height [m] and cosine of its tilt a robot has fallen, and which axis of its root points up."""
    cosine = sincos(options.fall_tilt)[1] if options.fall_tilt < math.pi else -2.0
    if model.base == "fixed" or options.ground is None:
        return -math.inf, cosine, (0.0, 0.0, 1.0)
    height, upright = standing_posture(model)
    return options.fall_height * height if options.fall_height >= 0.0 else -math.inf, cosine, upright
