"""Compare two models field by field, whatever fields there are, but for what makes no difference.

Names of links that are mere places between joints, of fixed joints, and of what has none; in which order the joints to
such places have their offsets, which `same_places` compares; the frame in which corners of hulls are given.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace

import numpy as np

from featherstone_gait.base.rotation import rotation_from_rpy
from featherstone_gait.model.numpy_dynamics import link_poses, zero_position
from featherstone_gait.model.robot import Model
from featherstone_gait.model.shapes import Hull, Mesh

OF_THE_FILE = ("name", "notes", "source", "package_dirs")  # of a Model, where it came from
TOLERANCE = 1e-9  # of numbers that MuJoCo converts: shares, or [m], [rad] ...
WORLD = "world"
CORNERS = 1e-5  # of corners, of which MuJoCo keeps 24 bits [m]


def differences(one, other, at=""):
    """Yield (place, one, other) wherever two values differ by more than rounding; parts with names go by them."""
    if isinstance(one, Model):
        one, other = _plain(one), _plain(other)
    if hasattr(one, "geometry") and hasattr(other, "geometry") and _same_hull(one, other):
        place = {"geometry": None, "xyz": None, "rpy": None}
        one, other = ({f.name: getattr(x, f.name) for f in fields(x)} | place for x in (one, other))
        one["name"] = one["name"] or other["name"]
    if is_dataclass(one) and type(one) is type(other):
        for f in fields(one):
            if at or f.name not in OF_THE_FILE:
                yield from _field(one, other, f.name, f"{at}.{f.name}")
    elif isinstance(one, Mapping) and isinstance(other, Mapping):
        for key in dict.fromkeys([*one, *other]):
            yield from differences(one.get(key), other.get(key), f"{at}[{key!r}]")
    elif isinstance(one, (tuple, list)) and isinstance(other, (tuple, list)) and _named(one) and _named(other):
        yield from differences({x.name: x for x in one}, {x.name: x for x in other}, at)
    elif isinstance(one, (tuple, list)) and isinstance(other, (tuple, list)) and len(one) == len(other):
        for k, (x, y) in enumerate(zip(one, other)):
            yield from differences(x, y, f"{at}[{k}]")
    elif not _equal(one, other):
        yield at, one, other


def same_places(one, other):
    """Return the largest difference of the links' places [m], in random postures."""
    rng, worst = np.random.default_rng(1), 0.0
    first = 7 if one.base == "floating" else 0
    columns = [list(x.joint_names) for x in (one, other)]
    order = [columns[1].index(name) for name in columns[0]]
    for _ in range(3 if not any(joint.type == "ball" for joint in one.joints) else 0):
        q = zero_position(one)
        q[first:] = rng.uniform(-0.5, 0.5, len(q) - first)
        r = zero_position(other)
        r[[first + k for k in order]] = q[first:]
        rows = [link.name for link in one.links if link.mass]
        places = [[link_poses(x, y).position[x.link_index(name)] for name in rows] for x, y in ((one, q), (other, r))]
        worst = max([worst, *np.abs(np.subtract(*places)).ravel()])
    return worst


def _plain(model):
    """Return the fields of a model in which mere places between joints are called by the joint that leads there."""
    carried = {part.link for parts in (model.shapes, model.contacts, model.immersed) for part in parts}
    carried |= {via.link for tendon in model.tendons for via in tendon.path}
    plain = {link.name for link in model.links if not (link.mass or any(link.inertia))} - {*carried, model.root}
    called = {j.child: f"<{j.name}>" for j in model.joints if j.child in plain and j.type != "fixed"}
    empty = WORLD if model.root == WORLD and not model.link(WORLD).mass else None  # which the world itself is
    links = [replace(link, name=called.get(link.name, link.name)) for link in model.links if link.name != empty]
    joints = {}
    for joint in model.joints:
        ends = {"parent": called.get(joint.parent, joint.parent), "child": called.get(joint.child, joint.child)}
        stated = {f.name: getattr(joint, f.name) for f in fields(joint)} | ends
        stated["rpy"] = rotation_from_rpy(joint.rpy)
        if {joint.parent, joint.child} & called.keys():
            stated["xyz"] = stated["rpy"] = None
        if joint.parent == empty:
            continue
        if joint.type == "fixed":
            stated["name"] = stated["velocity"] = stated["effort"] = None
        joints[joint.child if joint.type == "fixed" else joint.name] = stated
    found = {f.name: getattr(model, f.name) for f in fields(model) if f.name not in OF_THE_FILE}
    pairs = sorted(map(sorted, found["excluded"]))
    parts = {name: {} for name in ("shapes", "contacts")}  # of each link in order
    for name, of_links in parts.items():
        for part in found[name]:
            of_links.setdefault(part.link, []).append(part)
    return found | {"links": links, "joints": joints, "excluded": pairs, **parts}


def _same_hull(one, other):
    if not (isinstance(one.geometry, Mesh | Hull) and isinstance(other.geometry, Hull)):
        return False
    if isinstance(one.geometry, Mesh):
        return True  # a mesh is its convex hull
    ways = np.random.default_rng(2).normal(size=(50, 3))
    corners = [
        rotation_from_rpy(x.rpy) @ np.array(x.geometry.points).T + np.array(x.xyz)[:, None] for x in (one, other)
    ]
    return np.abs(np.subtract(*[(ways @ points).max(1) for points in corners])).max() < CORNERS


def _field(one, other, name, at):
    x, y = getattr(one, name), getattr(other, name)
    if name in ("rpy", "rpy_a", "rpy_b"):
        x, y = rotation_from_rpy(x), rotation_from_rpy(y)
    if name == "name" and not x:
        return  # what has none may get one
    yield from differences(x, y, at)


def _named(parts):
    names = [getattr(part, "name", None) for part in parts]
    return all(names) and len({*names}) == len(names)


def _equal(one, other):
    if one is None or other is None or isinstance(one, (str, bool)):
        return one == other
    try:
        x, y = np.asarray(one, float), np.asarray(other, float)
    except (TypeError, ValueError):
        return one == other
    if x.shape != y.shape:
        return False
    scale = max(1.0, float(np.abs(x[np.isfinite(x)]).max(initial=0.0)))
    with np.errstate(invalid="ignore"):
        return bool(np.all((x == y) | (np.abs(x - y) <= TOLERANCE * scale)))
