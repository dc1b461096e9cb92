"""Read what URDF cannot state from the TOML file beside it: base, contact points, servos, locked joints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ..model import Base, ContactPoint, Joint, Link, Servo, Supply
from ..model.tree_checks import check_links, check_locked
from .report import Report
from .robot import Posture
from .servos import read_servos
from .toml import check_keys, number, read_toml, real, record, table_of

OWN = {  # keys of [links.NAME] and [joints.NAME], fields of Link and Joint
    "links": ("gravity_compensation",),
    "joints": ("armature", "stiffness", "spring_reference"),
}
UPRIGHT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)  # position [m] and quaternion of a base at the origin


class Settings(NamedTuple):
    """The content of the TOML file."""

    base: Base | None = None
    locked: Mapping[str, dict[str, float]] = {}  # set name -> joint name -> position
    servos: Mapping[str, Servo] = {}
    contacts: tuple[ContactPoint, ...] = ()
    parts: Mapping[str, Mapping[str, dict[str, Any]]] = {"links": {}, "joints": {}}  # of OWN, by section and name
    keyframes: Mapping[str, tuple[float, ...]] = {}  # name -> q, of those given as a list
    postures: Mapping[str, Posture] = {}  # name -> posture, of those given by joint
    supply: Supply | None = None
    choice: str | tuple[str, ...] | None = None  # of collision shapes in place of contact points


def read_settings(path: Path, links: tuple[Link, ...], joints: tuple[Joint, ...], report: Report) -> Settings:
    """Read the TOML file of a robot of these links and joints; raise ValueError for what it does not understand."""
    table = read_toml(path)
    check_keys(table, ("base", "contacts", "servos", "supply", "locked", *OWN, "keyframes"), "top level")
    if table.get("base", "fixed") not in ("fixed", "floating"):
        raise ValueError(f"base is {table['base']!r}; expected 'fixed' or 'floating': use one of these")
    servos = read_servos(table_of(table, "servos", ""), joints, path.parent, report)
    locked = {name: _locked_set(table["locked"], name, joints) for name in table_of(table, "locked", "")}
    own = {"links": _own(table, "links", links), "joints": _own(table, "joints", joints)}
    named = table_of(table, "keyframes", "")
    postures = {name: _posture(named, name, joints) for name, q in named.items() if isinstance(q, dict)}
    keyframes = {name: _numbers(q, f"keyframes.{name}") for name, q in named.items() if name not in postures}
    contacts = table.get("contacts", [])
    choice = _choice(contacts)
    points = () if choice else _contacts(contacts, links)
    supply = record(Supply, table_of(table, "supply", ""), "supply") if "supply" in table else None
    return Settings(table.get("base"), locked, servos, points, own, keyframes, postures, supply, choice)


def _own(table: dict[str, Any], section: str, parts: tuple[Link, ...] | tuple[Joint, ...]) -> dict[str, dict[str, Any]]:
    """Read [links.NAME] or [joints.NAME]."""
    found, names = {}, {part.name for part in parts}
    for name in table_of(table, section, ""):
        if name not in names:
            what = section.removesuffix("s")
            raise ValueError(f"{section}: there is no {what} {name!r}; expected one of the URDF's: correct the name")
        own = table_of(table[section], name, f"{section}.")
        check_keys(own, OWN[section], f"{section}.{name}")
        found[name] = {key: number(own, key, f"{section}.{name}") for key in own}
    return found


def _posture(keyframes: dict[str, Any], name: str, joints: tuple[Joint, ...]) -> Posture:
    """Read [keyframes.NAME]; joints that it does not name are at zero."""
    table, what = keyframes[name], f"keyframes.{name}"
    check_keys(table, ("base", "joints"), what)
    base = _numbers(table.get("base", list(UPRIGHT)), f"{what}.base")
    if len(base) != len(UPRIGHT):
        raise ValueError(f"{what}.base has {len(base)} numbers; expected [x, y, z, qw, qx, qy, qz]: write these seven")
    stated = table_of(table, "joints", f"{what}.")
    moving = tuple(joint.name for joint in joints if joint.type != "fixed")
    check_keys(stated, moving, f"{what}.joints")
    return Posture(base, {joint: real(stated.get(joint, 0.0), f"{what}.joints.{joint}") for joint in moving})


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
    points = tuple(record(ContactPoint, row, what, what + name) for row, what, name in zip(rows, whats, names))
    check_links("contacts", links, (point.link for point in points))
    return points


def _locked_set(sets: dict[str, Any], name: str, joints: tuple[Joint, ...]) -> dict[str, float]:
    names = [joint.name for joint in joints]
    held = {}
    for key, value in table_of(sets, name, "locked.").items():
        angle = key not in names and key.endswith("_deg")
        joint = key.removesuffix("_deg") if angle else key
        if joint in held:
            raise ValueError(f"locked.{name}: joint {joint!r} is given twice; keep one of the two")
        position = real(value, f"locked.{name}: position of joint {joint!r}")
        held[joint] = math.radians(position) if angle else position
    check_locked(joints, held)
    return held
