"""Checks of what the parts of a model say of each other: the tree, couplings, and names that must exist."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

from ..base.arguments import instance
from ..base.flaws import Flaw, FlawError, quoted
from .checks import check, check_angles, number_flaws, vector_flaws
from .links import Joint, Link, Spring


def check_tree(links: Iterable[Link], joints: Iterable[Joint]) -> None:
    """Raise FlawError, a ValueError, unless the joints make one tree of the links."""
    names, joints = [link.name for link in links], list(joints)
    flaws = [*_repeated_names("link", names), *_repeated_names("joint", [joint.name for joint in joints])]
    flaws += _joining_flaws(set(names), joints)
    if not names:
        flaws.append(Flaw("robot", "the robot has no link; at least one <link> is needed"))
    if not flaws:
        flaws += _root_flaws(names, {joint.child: joint for joint in joints})
    if flaws:
        raise FlawError(flaws)


def _repeated_names(kind: str, names: list[str]) -> Iterator[Flaw]:
    for name, count in Counter(names).items():
        if count > 1:
            text = f"{kind} name {name!r} is used more than once; give every {kind} its own name"
            yield Flaw(f"{kind} {name!r}", text)


def _joining_flaws(names: set[str], joints: list[Joint]) -> Iterator[Flaw]:
    """Find joints to links that do not exist, or to a link that has a parent joint."""
    parent_joint: dict[str, Joint] = {}
    for joint in joints:
        what = f"joint {joint.name!r}"
        for end in (joint.parent, joint.child):
            if end not in names:
                yield Flaw(what, f"{what}: there is no link {end!r}; define it, or correct the name")
        if joint.child in parent_joint:
            yield Flaw(
                what,
                f"link {joint.child!r} is the child of joints {parent_joint[joint.child].name!r} and {joint.name!r}; "
                "a link has one parent joint: cut the closed loop and close it by a Loop, or rename one of the two",
            )
        parent_joint[joint.child] = joint


def _root_flaws(names: list[str], parent_joint: dict[str, Joint]) -> Iterator[Flaw]:
    """Find links that do not lead up to one root."""
    roots = [name for name in names if name not in parent_joint]
    if len(roots) > 1:
        yield Flaw(
            f"link {roots[1]!r}",
            f"links {quoted(roots)} have no parent joint; exactly one link may be the root: "
            "connect the others to it, for instance by a fixed joint",
        )
    rooted = set(roots)
    for name in names:
        path: dict[str, None] = {}  # a set that keeps its order
        while name not in rooted and name not in path:
            path[name] = None
            name = parent_joint[name].parent
        if name in path:
            cycle = list(path)[list(path).index(name) :]  # the part of the path that comes back on itself
            text = f"links {quoted(cycle)} form a cycle of joints; a robot is a tree: remove one joint"
            yield Flaw(f"link {cycle[0]!r}", text)
        rooted.update(path)


def check_locked(joints: Iterable[Joint], locked: Mapping[str, float]) -> None:
    """Raise ValueError unless every locked joint exists, moves and is held within its limits."""
    by_name = {joint.name: joint for joint in joints}
    for name, position in locked.items():
        what, joint = f"locked joint {name!r}", _movable(by_name, name, "locked")
        check(number_flaws(what, "position", position, "finite", "rad or m", "give a finite position"))
        if joint.type != "prismatic":
            check_angles(what, "position", (position,))
        if joint.type == "ball" and (position or not all(f"{name[:-2]}{end}" in locked for end in ("rx", "ry", "rz"))):
            raise ValueError(f"{what}: it is a degree of a ball joint; lock all three of them at 0, or none")
        if not joint.lower <= position <= joint.upper:
            raise ValueError(
                f"{what}: position {position!r} is outside its limits {joint.lower!r} to {joint.upper!r}; hold it at a "
                "position between them"
            )


def check_references(joints: Iterable[Joint], references: Mapping[str, tuple[float, float]]) -> None:
    """Raise ValueError unless every range of references is that of a joint, and of two numbers in order."""
    by_name = {joint.name: joint for joint in joints}
    for name, given in references.items():
        what = f"references of joint {name!r}"
        _movable(by_name, name, "references")
        check(vector_flaws(what, "range", given, 2))
        if not given[0] <= given[1]:
            raise ValueError(f"{what}: range is {given!r} [rad or m]; give the lower end first")


def check_mimics(joints: Iterable[Joint]) -> None:
    """Raise ValueError unless the joint that each coupled joint follows exists, and no joints follow each other."""
    joints = list(joints)
    leaders = {joint.name: joint.mimic.joint if joint.mimic else None for joint in joints}
    kinds = {joint.name: joint.type for joint in joints}
    for name, leader in leaders.items():
        path = [name]
        while leader is not None:
            if leader not in leaders:
                raise ValueError(
                    f"joint {path[-1]!r}: it follows {leader!r}, and there is no such joint; joints are "
                    f"{quoted(leaders)}: correct the name in its mimic"
                )
            if kinds[leader] == "ball":
                raise ValueError(
                    f"joint {path[-1]!r}: it follows {leader!r}, a degree of a ball joint, which has no position of "
                    "its own; let it follow a joint of one degree"
                )
            if leader in path:
                circle = path[path.index(leader) :]
                raise ValueError(
                    f"joints {quoted(circle)} follow each other in a circle; one must be free: remove its mimic"
                )
            path.append(leader)
            leader = leaders[leader]


def check_can_move(joints: Iterable[Joint], held: Mapping[str, float]) -> None:
    """Raise ValueError for a joint that is neither fixed nor held, and whose limits coincide."""
    for joint in joints:
        if joint.type != "fixed" and joint.name not in held and joint.lower == joint.upper:
            raise ValueError(
                f"joint {joint.name!r}: limits lower {joint.lower!r}, upper {joint.upper!r}; lower must be below "
                "upper: use type 'fixed' for a joint that does not move, or lock it there"
            )


def check_servos(joints: Iterable[Joint], servos: Iterable[str]) -> None:
    """Raise ValueError unless every servo's joint exists and moves."""
    by_name = {joint.name: joint for joint in joints}
    for name in servos:
        if _movable(by_name, name, "servos").type == "ball":
            raise ValueError(f"servos: {name!r} is a degree of a ball joint; a servo turns one axis: use other joints")


def _movable(by_name: dict[str, Joint], name: str, where: str) -> Joint:
    """Look up a joint; raise ValueError if there is none of that name or it is fixed."""
    if name not in by_name:
        moving = [joint.name for joint in by_name.values() if joint.type != "fixed"]
        known = quoted(moving)
        raise ValueError(f"{where}: there is no joint {name!r}; moving joints are {known}: use one of them")
    if by_name[name].type == "fixed":
        raise ValueError(f"{where}: joint {name!r} is of type 'fixed'; remove it here, or change its type in the URDF")
    return by_name[name]


def check_links(what: str, links: Iterable[Link], used: Iterable[str]) -> None:
    """Raise ValueError unless every link that is used exists."""
    names = dict.fromkeys(link.name for link in links)
    for name in used:
        if name not in names:
            raise ValueError(f"{what}: there is no link {name!r}; use one of {quoted(names)}")


def links_of_pairs(links: Iterable[Link], pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Yield the links of pairs of "link" or "link/shape"; a shape may be taken from a model, and is no flaw here."""
    names = {link.name for link in links}
    for end in (end for pair in pairs for end in pair):
        yield end if end in names else end.rpartition("/")[0] or end


def check_springs(links: Iterable[Link], springs: Iterable[Spring]) -> None:
    """Raise TypeError for what is no spring, ValueError unless every spring joins links of the robot."""
    for spring in springs:
        instance("springs", spring, Spring, "give a list of Spring(a, b)")
        check_links("springs", links, (spring.a, spring.b))
