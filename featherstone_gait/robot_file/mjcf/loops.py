"""Read and write loops: equalities `connect` and `weld`, and those of the length of a tendon between two sites."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...base.fixed_order import applied, product
from ...base.flaws import quoted
from ...base.rotation import rotation_from_quaternion, rotation_from_rpy, rpy_from_rotation
from ...dynamics import forward_kinematics
from ...model import Loop, Model
from ...model.loop import LoopKind
from ...model.numpy_dynamics import zero_position
from ...model.placed import link_name
from ..markup import element
from .equalities import CONNECT, KINDS, SITE, TENDON, WELD, active, follows_mocap, lines, ties, title
from .tree import Tree, unused, vector

SITE_WRAP = 3  # mjtWrap
NAMES: dict[int, LoopKind] = {CONNECT: "connect", WELD: "weld", TENDON: "distance"}
ARM = 0.1  # between the two points of a hinge's axis [m]


class End(NamedTuple):
    """A frame on a body."""

    body: int
    rotation: np.ndarray  # (3, 3) to the body
    point: np.ndarray  # (3,) in the body [m]


def ends(m: Any, k: int) -> tuple[End, End] | None:
    """Return where an equality closes a loop; None if it is of another kind."""
    kind, data, one, two = m.eq_type[k], m.eq_data[k], int(m.eq_obj1id[k]), int(m.eq_obj2id[k])
    if kind == TENDON:
        start = m.tendon_adr[one]
        wraps = range(start, start + m.tendon_num[one])
        if two >= 0 or len(wraps) != 2 or any(m.wrap_type[w] != SITE_WRAP for w in wraps):
            return None
        a, b = (at_site(m, int(m.wrap_objid[w])) for w in wraps)
        return a, b
    if kind not in (CONNECT, WELD):
        return None
    if m.eq_objtype[k] == SITE:
        return at_site(m, one), at_site(m, two)
    if kind == CONNECT:
        return End(one, np.eye(3), data[:3]), End(two, np.eye(3), data[3:6])
    return End(one, rotation_from_quaternion(data[6:10]), data[3:6]), End(two, np.eye(3), data[:3])


def at_site(m: Any, s: int) -> End:
    """Return the frame of a site."""
    return End(int(m.site_bodyid[s]), rotation_from_quaternion(m.site_quat[s]), m.site_pos[s])


def closing(m: Any) -> dict[int, tuple[End, End]]:
    """Return the active equalities that close loops, by their number."""
    taken = {**lines(m), **ties(m)}
    found = ((k, ends(m, k)) for k in active(m) if k not in taken and not follows_mocap(m, k))
    return {k: both for k, both in found if both is not None}


def read_loops(m: Any, tree: Tree, names: list[str], top: int = 0) -> tuple[Loop, ...]:
    """Read the loops of a tree, but those that lead to another.

    names: of the equalities; top: body whose place counts as that of a fixed root.
    """
    found = []
    for k, (a, b) in closing(m).items():
        inside = [_moves(m, tree, end.body) for end in (a, b)]
        if any(inside) and not any(m.body_weldid[end.body] and not own for end, own in zip((a, b), inside)):
            found.append(_loop(m, k, names[k], placed(m, tree, a, top), placed(m, tree, b, top)))
    return tuple(found)


def joining_loops(m: Any, trees: Mapping[int, tuple[str, Tree]], names: list[str]) -> tuple[Loop, ...]:
    """Read the loops between trees; trees: name in the scene and tree by its first body; names: of the equalities."""
    found = []
    for k, both in closing(m).items():
        if all(m.body_weldid[end.body] for end in both) and len({int(m.body_rootid[end.body]) for end in both}) == 2:
            ends = []
            for end in both:
                name, tree = trees[int(m.body_rootid[end.body])]
                link, turn, at = placed(m, tree, end, 0)
                assert link is not None  # each end moves
                ends.append((link_name(name, link), turn, at))
            found.append(_loop(m, k, names[k], *ends))
    return tuple(found)


def _loop(m: Any, k: int, name: str, one: tuple[str | None, Any, Any], two: tuple[str | None, Any, Any]) -> Loop:
    """Return the loop of an equality, whose ends are link, rpy and point; at most one of the links is None."""
    if one[0] is None:
        one, two = two, one
    distance = float(m.tendon_length0[m.eq_obj1id[k]] + m.eq_data[k, 0]) if m.eq_type[k] == TENDON else 0.0
    turns = (one[1], two[1]) if m.eq_type[k] == WELD else ((0.0, 0.0, 0.0),) * 2
    (a_link, _, a_at), (b_link, _, b_at), kind = one, two, NAMES[int(m.eq_type[k])]
    assert a_link is not None  # one of the two moves
    return Loop(name, kind, a_link, b_link, a_at, b_at, turns[0], turns[1], distance=distance)


def equality_names(m: Any) -> list[str]:
    """Return unique names of the equalities."""
    given = [m.equality(k).name for k in range(m.neq)]
    return [name or unused(f"loop{k}", given) for k, name in enumerate(given)]


def _moves(m: Any, tree: Tree, b: int) -> bool:
    return tree.holds(m, b) and bool(m.body_weldid[b])


def placed(m: Any, tree: Tree, end: End, top: int) -> tuple[str | None, Any, Any]:
    """Return link, rpy and point of an end; None for the world, whose place is in the root link of a fixed base."""
    b, E, r = end
    if b and tree.holds(m, b):
        return tree.bodies[b], rpy_from_rotation(E), vector(r)
    while b:
        turn = rotation_from_quaternion(m.body_quat[b])
        E, r, b = product(turn, E), m.body_pos[b] + applied(turn, r), int(m.body_parentid[b])
    if tree.base == "floating":
        return None, rpy_from_rotation(E), vector(r)
    if top:
        back = rotation_from_quaternion(m.body_quat[top]).T
        E, r = product(back, E), applied(back, r - m.body_pos[top])
    return tree.bodies[tree.root], rpy_from_rotation(E), vector(r)


def loop_refusals(m: Any, tree: Tree) -> Iterator[str]:
    """Yield why equalities cannot close loops of this tree: they lead to another tree, or have no length."""
    for k, both in closing(m).items():
        inside = [_moves(m, tree, end.body) for end in both]
        outside = [end.body for end in both if not tree.holds(m, end.body) and m.body_weldid[end.body]]
        if any(inside) and outside:
            other = m.body(outside[0]).name or str(outside[0])
            yield (
                f"equality {title(m, k)} <{KINDS[m.eq_type[k]]}> ties the robot to body {other!r} of another tree; a "
                "loop has both ends in one robot, or in the world: remove it, or set active='false'"
            )
        elif m.eq_type[k] == TENDON and not m.tendon_length0[m.eq_obj1id[k]] + m.eq_data[k, 0] > 0:
            yield f"equality {title(m, k)} <tendon> asks for no length; a rod has one above 0: make it a <connect>"


def loop_notes(m: Any, tree: Tree) -> Iterator[str]:
    """Yield how loops differ from MuJoCo's."""
    found = [k for k, both in closing(m).items() if any(_moves(m, tree, end.body) for end in both)]
    if found:
        names = quoted([m.equality(k).name or str(k) for k in found])
        yield f"took equalities {names} as rigid loops; MuJoCo's give way (solref, solimp, torquescale)"


# ---------------------------------------------------------------------------------------------- writing


def site_lines(loops: Iterable[Loop], link: str | None) -> list[str]:
    """Write the sites of loops on a link, or in the world."""
    found = []
    for loop in loops:
        sides = (("a", loop.a, loop.point_a, loop.rpy_a), ("b", loop.b, loop.point_b, loop.rpy_b))
        for side, at, point, rpy in sides:
            if at == link:
                turn = rpy if loop.kind == "weld" else None
                found += element("site", {"name": f"{loop.name}_{side}", "pos": point, "euler": turn})
                if loop.kind == "hinge":
                    along = np.array(point) + ARM * applied(rotation_from_rpy(rpy), np.array(loop.axis))
                    found += element("site", {"name": f"{loop.name}_{side}2", "pos": along})
    return found


def loop_lines(loops: Sequence[Loop], length_at_zero: Callable[[Loop], float]) -> list[str]:
    """Write the equalities of loops; length_at_zero: of a rod's points with all joints at zero [m]."""
    found, taken = [], [loop.name for loop in loops]
    for loop in loops:
        if loop.kind == "distance":
            miss = loop.distance - length_at_zero(loop)
            attributes = {"name": loop.name, "tendon1": loop.name, "polycoef": (miss, 0, 0, 0, 0)}
            found += element("tendon", attributes)
            continue
        tag = "weld" if loop.kind == "weld" else "connect"
        found += element(tag, {"name": loop.name, "site1": f"{loop.name}_a", "site2": f"{loop.name}_b"})
        if loop.kind == "hinge":
            name = unused(f"{loop.name}_axis", taken)
            found += element(tag, {"name": name, "site1": f"{loop.name}_a2", "site2": f"{loop.name}_b2"})
    return found


def rod_lines(loops: Iterable[Loop]) -> list[str]:
    """Write the tendons whose lengths loops keep."""
    rods = [loop.name for loop in loops if loop.kind == "distance"]
    sites = {name: [line for side in "ab" for line in element("site", {"site": f"{name}_{side}"})] for name in rods}
    return [line for name in rods for line in element("spatial", {"name": name}, sites[name])]


def length_at_zero(model: Model, loop: Loop) -> float:
    """Return the distance of a loop's points with all joints at zero and the base at the origin [m]."""
    poses = forward_kinematics(model, zero_position(model))
    places = []
    for link, point in ((loop.a, loop.point_a), (loop.b, loop.point_b)):
        row = None if link is None else model.link_index(link)
        at = np.array(point)
        places.append(at if row is None else poses.position[row] + applied(poses.rotation[row], at))
    return float(np.linalg.norm(places[0] - places[1]))
