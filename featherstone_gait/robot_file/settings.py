"""Read what URDF cannot state from the TOML file beside it: base, contact points, servos, locked joints."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

from ..model import Base, ContactPoint, Immersed, Joint, Link, Loop, Propeller, Servo, Supply, Surface, Tendon
from ..model.checks import check, field_flaws
from ..model.degrees import ball_name, by_degree, degrees_of, is_first
from ..model.fluid import check_propellers
from ..model.loop import check_loops
from ..model.pair_friction import FIELDS
from ..model.sensor import SampledSensor, Sensor
from ..model.shapes import Shape
from ..model.tendon import check_tendons
from ..model.tree_checks import check_links, check_locked, check_references, links_of_pairs
from .report import Report
from .sensors import read_sensors
from .servos import read_servos
from .toml import (
    Problems,
    beside,
    check_keys,
    name_pairs_of,
    number,
    read_toml,
    real,
    record,
    surface,
    table_of,
)

OWN = {  # keys of [links.NAME] and [joints.NAME], fields of Link and Joint
    "links": ("gravity_compensation", "surface"),  # the latter of its shapes and contact points, or one of each shape
    "joints": (
        "upper",
        "armature",
        "stiffness",
        "spring_reference",
        "quadratic_stiffness",
        "cubic_stiffness",
        "quadratic_damping",
        "cubic_damping",
        "degrees",
    ),
}
OF_SHAPE = (*FIELDS, "priority", "surface")  # keys of [shapes.NAME], fields of Shape
# Of the file.
SECTIONS = (
    "base",
    "contacts",
    "servos",
    "supply",
    "locked",
    *OWN,
    "shapes",
    "keyframes",
    "references",
    "excluded",
    "included",
    "loops",
    "tendons",
    "immersed",
    "propellers",
    "sensors",
)
# Of the <text> that `save_robot` writes within MJCF:
PASSIVE = ("velocity", "damping", "friction", "armature")  # keys of [joints.NAME] beside the others
GEOMS = "geoms"  # names of those that stand for contact points
MAPS = ("locked", "servos", "shapes", "references")  # fields of `Settings` whose entries are stated one by one
UPRIGHT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)  # position [m] and quaternion of a base at the origin


class Posture(NamedTuple):
    """A named posture of a file."""

    base: tuple[float, ...]  # position [m] and quaternion w x y z of the root link in the world
    joints: Mapping[str, Any]  # of all degrees [rad or m]; by the names of ball joints quaternions w x y z

    def numbers(self, joints: tuple[Joint, ...], held: Mapping[str, float]) -> tuple[float, ...]:
        """Return the joints' part of q."""
        found: list[float] = []
        for one in degrees_of(joints).joints:
            if one.type == "fixed" or one.name in held:
                continue
            if is_first(one):
                found += self.joints[ball_name(one)]
            elif one.type != "ball":
                found.append(self.joints[one.name])
        return tuple(found)


class Settings(NamedTuple):
    """The content of the TOML file."""

    base: Base | None = None
    locked: Mapping[str, dict[str, float]] = {}  # set name -> joint name -> position
    servos: Mapping[str, Servo] = {}
    contacts: tuple[ContactPoint, ...] = ()
    parts: Mapping[str, Mapping[str, dict[str, Any]]] = {"links": {}, "joints": {}}  # of OWN, by section and name
    shapes: Mapping[str, dict[str, Any]] = {}  # name -> what of it is stated
    keyframes: Mapping[str, tuple[float, ...]] = {}  # name -> q, of those given as a list
    postures: Mapping[str, Posture] = {}  # name -> posture, of those given by joint
    supply: Supply | None = None
    choice: str | tuple[str, ...] | None = None  # of collision shapes in place of contact points
    excluded: tuple[tuple[str, str], ...] = ()  # links that do not touch each other
    loops: tuple[Loop, ...] = ()
    tendons: tuple[Tendon, ...] = ()
    immersed: tuple[Immersed, ...] = ()
    propellers: tuple[Propeller, ...] = ()
    sensors: tuple[Sensor | SampledSensor, ...] = ()
    included: tuple[tuple[str, str], ...] = ()  # neighbors that do
    references: Mapping[str, tuple[float, float]] = {}  # ranges, by joint

    def under(self, other: Settings) -> Settings:
        """Return both, of which the other one's count where both state the same."""
        whole: dict[str, Any] = {name: over or own for name, own, over in zip(self._fields, self, other)}
        maps = {name: {**getattr(self, name), **getattr(other, name)} for name in MAPS}
        parts = {
            section: {name: {**own.get(name, {}), **over.get(name, {})} for name in {**own, **over}}
            for section, own, over in ((key, self.parts[key], other.parts[key]) for key in OWN)
        }
        return Settings(**{**whole, **maps, "parts": parts})


def read_settings(path: Path, links: tuple[Link, ...], joints: tuple[Joint, ...], report: Report) -> Settings:
    """Read the TOML file of a robot of these links and joints; raise ValueError for what it does not understand."""
    return _settings(read_toml(path), path.parent, links, joints, report, OWN)


def read_stated(
    table: dict[str, Any], folder: Path, links: tuple[Link, ...], joints: tuple[Joint, ...], report: Report
) -> Settings:
    """Read the table that `save_robot` writes within MJCF; raise ValueError for what it does not understand."""
    own = {**OWN, "joints": (*OWN["joints"], *PASSIVE)}
    return _settings({key: x for key, x in table.items() if key != GEOMS}, folder, links, joints, report, own)


def _settings(
    table: dict[str, Any], folder: Path, links: tuple[Link, ...], joints: tuple[Joint, ...], report: Report,
    keys: Mapping[str, tuple[str, ...]],
) -> Settings:  # fmt: skip
    """Read a table; keys: of links and joints."""
    problems, found = Problems(), dict[str, Any]()
    own: dict[str, dict[str, Any]] = {name: {} for name in OWN}
    with problems.at(table):
        check_keys(table, SECTIONS, "top level")
    for section in SECTIONS:
        if section in table:
            with problems.at(table, section):
                if section in OWN:
                    own[section] = _own(table, section, links if section == "links" else joints, keys[section])
                else:
                    found |= _section(section, table, folder, links, joints, report)
    problems.raise_all()
    return Settings(**found, parts=own)


def _section(
    name: str,
    table: Mapping[str, Any],
    folder: Path,
    links: tuple[Link, ...],
    joints: tuple[Joint, ...],
    report: Report,
) -> dict[str, Any]:
    """Read one of `SECTIONS` except `OWN`: return fields of `Settings`."""
    if name == "base":
        if table[name] not in ("fixed", "floating"):
            raise ValueError(f"base is {table[name]!r}; expected 'fixed' or 'floating': use one of these")
        return {name: table[name]}
    if name == "contacts":
        choice = _choice(table[name])
        return {"choice": choice} if choice else {name: _contacts(table[name], links)}
    if name in ("excluded", "included"):
        pairs = name_pairs_of(table, name, 'write [["hand", "thigh"], ...]')
        check_links(name, links, links_of_pairs(links, pairs))
        return {name: pairs}
    if name == "loops":
        return {name: records_of(Loop, table[name], name, lambda found: check_loops(links, found))}
    if name == "tendons":
        single = degrees_of(joints).joints
        return {name: records_of(Tendon, table[name], name, lambda found: check_tendons(links, single, found))}
    if name == "propellers":
        return {name: records_of(Propeller, table[name], name, lambda found: check_propellers(joints, found))}
    if name == "sensors":
        return {name: read_sensors(table[name], [link.name for link in links])}
    if name == "immersed":
        shapes = records_of(Immersed, table[name], name, lambda rows: check_links(name, links, (x.link for x in rows)))
        return {name: tuple(replace(shape, geometry=beside(shape.geometry, folder)) for shape in shapes)}
    inside = table_of(table, name, "")
    if name == "servos":
        return {name: read_servos(inside, joints, folder, report)}
    if name == "supply":
        return {name: record(Supply, inside, name)}
    if name == "shapes":
        return {name: _each(inside, inside, lambda key: _of_shape(table_of(inside, key, "shapes."), f"shapes.{key}"))}
    if name == "references":
        check_references(degrees_of(joints).joints, inside)
        return {name: {key: (float(low), float(high)) for key, (low, high) in inside.items()}}
    if name == "keyframes":
        found = _each(inside, inside, lambda key: _keyframe(inside, key, joints))
        postures = {key: q for key, q in found.items() if isinstance(q, Posture)}
        return {name: {key: q for key, q in found.items() if key not in postures}, "postures": postures}
    return {name: _each(inside, inside, lambda key: _locked_set(inside, key, joints))}


def _each(table: Mapping[str, Any], keys: Iterable[str], read: Callable[[str], Any]) -> dict[str, Any]:
    """Read what is under each of some keys of a table; raise Wrong with all problems."""
    problems, found = Problems(), {}
    for key in keys:
        with problems.at(table, key):
            found[key] = read(key)
    problems.raise_all()
    return found


def _of_shape(stated: dict[str, Any], what: str) -> dict[str, Any]:
    """Read [shapes.NAME]."""
    declared = {f.name: f for f in fields(Shape)}

    def read(key: str) -> Any:
        if key == "surface":
            return surface(stated, key, what)
        value = number(stated, key, what)
        check(field_flaws(what, key, value, declared[key]))
        return int(value) if key == "priority" and value.is_integer() else value

    check_keys(stated, OF_SHAPE, what)
    return _each(stated, stated, read)


def _own(
    table: dict[str, Any], section: str, parts: tuple[Link, ...] | tuple[Joint, ...], keys: tuple[str, ...]
) -> dict[str, dict[str, Any]]:
    """Read [links.NAME] or [joints.NAME]."""
    inside, names = table_of(table, section, ""), {part.name for part in parts}
    declared = {f.name: f for f in fields(Link if section == "links" else Joint)}

    def stated(own: dict[str, Any], key: str, what: str) -> Any:
        if key not in declared:
            return _surfaces(own, key, what) if isinstance(own[key], list) else surface(own, key, what)
        if key == "degrees":
            return _degrees(own, what)
        value = number(own, key, what)
        check(field_flaws(what, key, value, declared[key]))
        return value

    def read(name: str) -> dict[str, Any]:
        if name not in names:
            what = section.removesuffix("s")
            raise ValueError(f"{section}: there is no {what} {name!r}; expected one of the URDF's: correct the name")
        own, problems, found = table_of(inside, name, f"{section}."), Problems(), dict[str, Any]()
        with problems.at(own):
            check_keys(own, keys, f"{section}.{name}")
        with problems.at(own):
            known = [key for key in own if key in keys]
            found = _each(own, known, lambda key: stated(own, key, f"{section}.{name}"))
        problems.raise_all()
        return found

    return _each(inside, inside, read)


def _degrees(own: dict[str, Any], what: str) -> dict[str, dict[str, float]]:
    """Read what single degrees of a joint have, by degree and name."""
    inside = table_of(own, "degrees", f"{what}.")
    tables = ((name, table_of(inside, name, f"{what}.degrees.")) for name in inside)
    return {name: {key: number(own, key, f"{what}.degrees.{name}") for key in own} for name, own in tables}


def _surfaces(own: dict[str, Any], key: str, what: str) -> tuple[Surface | None, ...]:
    """Read how the surface of each shape of a link moves; an empty table stands for one at rest."""
    if not all(isinstance(row, dict) for row in own[key]):
        raise ValueError(f"{what}: {key} is {own[key]!r}; expected a table for each shape: write {{}} for one at rest")
    return tuple(record(Surface, row, f"{what}: {key}[{k}]") if row else None for k, row in enumerate(own[key]))


def _quaternion(values: Any, what: str) -> tuple[float, ...]:
    """Read the quaternion of a ball joint."""
    numbers = _numbers(values, what)
    if len(numbers) != 4 or not any(numbers):
        raise ValueError(f"{what} is {list(numbers)}; expected a quaternion [w, x, y, z]: [1, 0, 0, 0] is no rotation")
    return numbers


def _keyframe(keyframes: dict[str, Any], name: str, joints: tuple[Joint, ...]) -> Posture | tuple[float, ...]:
    """Read [keyframes.NAME], or its list of coordinates; joints that it does not name are at zero."""
    table, what, problems = keyframes[name], f"keyframes.{name}", Problems()
    if not isinstance(table, dict):
        return _numbers(table, what)
    base: tuple[float, ...] = UPRIGHT
    angles: dict[str, Any] = {}
    single = [joint for joint in degrees_of(joints).joints if joint.type != "fixed"]
    turning = [ball_name(joint) for joint in single if is_first(joint)]
    moving = (*(joint.name for joint in single if joint.type != "ball"), *turning)
    with problems.at(table):
        check_keys(table, ("base", "joints"), what)
    with problems.at(table, "base"):
        base = _numbers(table.get("base", list(UPRIGHT)), f"{what}.base")
        if len(base) != len(UPRIGHT):
            count = f"{what}.base has {len(base)} numbers"
            raise ValueError(f"{count}; expected [x, y, z, qw, qx, qy, qz]: write these seven")
    with problems.at(table, "joints"):
        stated = table_of(table, "joints", f"{what}.")
        with problems.at(stated):
            check_keys(stated, moving, f"{what}.joints")

        def position(joint: str) -> Any:
            if joint in turning:
                return _quaternion(stated.get(joint, [1.0, 0.0, 0.0, 0.0]), f"{what}.joints.{joint}")
            return real(stated.get(joint, 0.0), f"{what}.joints.{joint}")

        angles = _each(stated, moving, position)
    problems.raise_all()
    return Posture(base, angles)


def _numbers(value: Any, what: str) -> tuple[float, ...]:
    if not isinstance(value, list):
        raise ValueError(f"{what} is {value!r}; expected the coordinates q: write a list of numbers, or a table")
    return tuple(real(x, what) for x in value)


def _choice(contacts: Any) -> str | tuple[str, ...] | None:
    """Return which shapes touch the ground if the TOML file says so: "feet", "all", or names of links."""
    if isinstance(contacts, str):
        return contacts
    named = isinstance(contacts, list) and contacts and all(isinstance(name, str) for name in contacts)
    return tuple(contacts) if named else None


def _contacts(rows: Any, links: tuple[Link, ...]) -> tuple[ContactPoint, ...]:
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ValueError(
            f"contacts is {rows!r}; expected a list of points, a list of links, 'feet' or 'all': write "
            "[{link = '...', position = [x, y, z]}, ...]"
        )
    names = [f" on link {row['link']!r}" if isinstance(row.get("link"), str) else "" for row in rows]
    whats = [f"contacts[{k}]" for k in range(len(rows))]
    points, problems = [], Problems()
    for row, what, name in zip(rows, whats, names):
        with problems.at(row):
            points.append(record(ContactPoint, row, what, what + name))
        with problems.at(row, "link"):
            check_links("contacts", links, (row["link"],) if name else ())
    problems.raise_all()
    return tuple(points)


def records_of(
    kind: type, rows: Any, section: str, check_all: Callable[[list[Any]], None] = lambda found: None
) -> tuple[Any, ...]:
    """Read the tables [[loops]], [[tendons]], [[immersed]] or [[propellers]]."""
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ValueError(f"{section} is {rows!r}; expected tables: write [[{section}]] above each")
    found, problems, what = list[Any](), Problems(), section.removesuffix("s")
    for k, row in enumerate(rows):
        with problems.at(row):
            named = f"{what} {row['name']!r}" if isinstance(row.get("name"), str) else f"{section}[{k}]"
            found.append(record(kind, row, f"{section}[{k}]", named))
            check_all(found)
    problems.raise_all()
    return tuple(found)


def _locked_set(sets: dict[str, Any], name: str, joints: tuple[Joint, ...]) -> dict[str, float]:
    table, problems, single = table_of(sets, name, "locked."), Problems(), degrees_of(joints).joints
    names = [joint.name for joint in (*joints, *single)]
    turns = [joint.name for joint in single if joint.type == "ball"]  # checked together, when all is read
    held: dict[str, float] = {}
    for key, value in table.items():
        angle = key not in names and key.endswith("_deg")
        joint = key.removesuffix("_deg") if angle else key
        with problems.at(table, key):
            if joint in held:
                raise ValueError(f"locked.{name}: joint {joint!r} is given twice; keep one of the two")
            position = real(value, f"locked.{name}: position of joint {joint!r}")
            held[joint] = math.radians(position) if angle else position
            if joint not in turns:
                check_locked(single, by_degree({joint: held[joint]}, joints))
    problems.raise_all()
    return held
