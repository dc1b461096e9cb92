"""Robots from files: what the robot is from URDF, what URDF cannot say from a TOML file of the same stem.

The URDF (https://wiki.ros.org/urdf/XML) gives links and joints.  The TOML gives the base, the servos, the points that
can touch the ground and named sets of locked joints::

    base = "floating"                    # or "fixed", the default
    contacts = [{link = "left_foot", position = [0.05, 0.03, -0.05]}]

    [servos]                             # for every revolute and continuous joint
    default = "ax12"                     # ax12.toml beside this file, else robots/servos/ax12.toml
    gearbox = "physical"                 # one of that file's presets
    voltage_limit = 9.6                  # any field of Servo, Controller or Gearbox overrides
    [servos.joints.neck]                 # for one joint: type, gearbox and any field
    current_limit = 0.1

    [locked.default]                     # held unless load_robot is told otherwise
    [locked.simplified]                  # load_robot(..., locked="simplified")
    left_elbow_deg = 45.0

All numbers are SI; the angles `encoder_resolution`, `backlash` and locked positions may carry `_deg`.

Reading is strict: what is not understood is refused, not guessed.  No file other than these is opened, meshes included.
"""

from __future__ import annotations

import functools
import json
import math
import os
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple
from xml.etree.ElementTree import Element, ParseError
from xml.sax.saxutils import quoteattr

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from .files import complete_together
from .model import (
    ContactPoint,
    Controller,
    Gearbox,
    Joint,
    Link,
    Model,
    Servo,
    check_contacts,
    check_locked,
    check_servos,
    check_tree,
    inertia_matrix,
    rotation_from_rpy,
)

MAX_BYTES = 10_000_000  # of one file
MAX_DEPTH = 64  # of nested XML elements
MAX_LINKS = 10_000
MAX_NUMBER = 1e30  # in a URDF, so that no product of masses and lengths overflows

_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")  # what strtod reads in the C locale
_IGNORED_LENGTH_ERROR = 1e-14  # an axis this close to unit length is kept to the last bit
_NOTED_LENGTH_ERROR = 1e-6


class RobotFileError(ValueError):
    """A robot file that cannot be used; the message names file, element, value, what is allowed and a remedy."""


class RobotFileNotFoundError(RobotFileError, FileNotFoundError):
    """A robot file that is not there."""


class _Grammar(NamedTuple):
    """What an element of the URDF may hold."""

    required: str = ""  # attributes
    optional: str = ""
    needs: str = ""  # children, exactly one of each
    reads: str = ""  # children, at most one of each (any number below <robot>)


_URDF = {
    "robot": _Grammar(required="name", optional="version", reads="link joint"),
    "link": _Grammar(required="name", optional="type", reads="inertial"),
    "inertial": _Grammar(needs="mass inertia", reads="origin"),
    "mass": _Grammar(required="value"),
    "inertia": _Grammar(required="ixx ixy ixz iyy iyz izz"),
    "origin": _Grammar(optional="xyz rpy"),
    "joint": _Grammar(required="name type", needs="parent child", reads="origin axis limit dynamics"),
    "parent": _Grammar(required="link"),
    "child": _Grammar(required="link"),
    "axis": _Grammar(required="xyz"),
    "limit": _Grammar(optional="lower upper effort velocity acceleration deceleration jerk"),
    "dynamics": _Grammar(optional="damping friction"),
}
_SKIPPED = {
    "robot": {
        "material": "colours play no part",
        "transmission": "servos and gearboxes come from the TOML file",
        "gazebo": "another simulator's settings",
        "mujoco": "another simulator's settings",
        "ros2_control": "controllers come from the TOML file",
    },
    "link": {
        "visual": "shapes play no part and meshes are never opened",
        "collision": "contact points come from the TOML file and meshes are never opened",
    },
    "joint": {
        "calibration": "encoders start calibrated",
        "safety_controller": "controllers come from the TOML file",
    },
}
_REFUSED_TYPES = {
    "planar": "replace it by two prismatic joints and a continuous one",
    "floating": "remove it together with its massless parent and load the robot with base='floating'",
}
_INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_ANGLES = ("encoder_resolution", "backlash")
_PARTS = {cls: tuple(f.name for f in fields(cls)) for cls in (Controller, Gearbox, Servo)}
_SERVO_KEYS = tuple(name for names in _PARTS.values() for name in names if name not in ("controller", "gearbox"))


class _Robot(NamedTuple):
    """What the URDF says."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    base: str | None
    notes: tuple[str, ...]


class _Settings(NamedTuple):
    """What the TOML says."""

    base: str | None = None
    locked: Mapping[str, dict[str, float]] = {}  # set name -> joint name -> position
    servos: Mapping[str, Servo] = {}
    contacts: tuple[ContactPoint, ...] = ()


# ---------------------------------------------------------------------------------------------- public functions


def load_robot(
    name_or_path: str | os.PathLike,
    base: Literal["fixed", "floating"] | None = None,
    locked: str | Mapping[str, float] | list[str] | tuple[str, ...] | None = None,
) -> Model:
    """Read a robot: a name of `robot_names()`, or the path of a .urdf file, with the .toml of the same stem if there.

    Parameters
    ----------
    base : None is what the TOML says, else "floating" if the URDF has a floating joint, else "fixed"
    locked : joints to hold: the name of a set in the TOML, {joint: position [rad or m]}, or joint names (held at 0);
        None is the TOML's set "default", if it has one

    Raises RobotFileError (a ValueError) if a file is wrong, RobotFileNotFoundError if it is not there.
    """
    path = _urdf_path(name_or_path)
    with _blamed_on(path):
        robot = _read_urdf(path)
    settings, toml = _Settings(), path.with_suffix(".toml")
    if toml.exists():
        with _blamed_on(toml):
            settings = _read_settings(toml, robot)
    with _blamed_on(f"{path}: load_robot(locked={locked!r})"):
        held = _chosen(locked, settings.locked)
        check_locked(robot.joints, held)
    with _blamed_on(path):
        return Model(
            name=robot.name,
            links=robot.links,
            joints=robot.joints,
            base=next(b for b in (base, settings.base, robot.base, "fixed") if b is not None),
            locked=held,
            servos=dict(settings.servos),
            contacts=settings.contacts,
            notes=robot.notes,
            source=str(path),
        )


def save_robot(model: Model, path: str | os.PathLike) -> None:
    """Write a robot as URDF and the TOML beside it, so that `load_robot(path)` gives the same numbers to the last bit.

    Locked joints become the TOML's set "default".  Both files are written in full before either takes its place.
    Raises ValueError if the path does not end in .urdf or URDF cannot state the robot.
    """
    path = Path(path)
    if path.suffix != ".urdf":
        raise ValueError(f"{path}: the file name must end in .urdf; the TOML goes beside it")
    texts = {path: _urdf_text(model), path.with_suffix(".toml"): _toml_text(model)}
    with complete_together(*texts) as temporaries:
        for temporary, text in zip(temporaries, texts.values()):
            temporary.write_text(text, encoding="utf-8", newline="\n")


def load_servo(name: str, gearbox: str = "physical", **overrides: Any) -> Servo:
    """Read a servo of `robots/servos/` with one of its gearbox presets.

    `overrides` are fields of `Servo`, `Controller` or `Gearbox` (their names do not clash), in SI units.
    Raises RobotFileError (a ValueError) on an unknown servo, preset or field and on a value out of range.
    """
    with _blamed_on(f"load_servo({name!r})"):
        own = _servo_settings(overrides, "overrides")
        return _servo({**_servo_values(_servo_path(name), gearbox), **own}, name)


def gearbox_presets(name: str) -> dict[str, Gearbox]:
    """Read the gearbox presets of a servo of `robots/servos/`, by name."""
    with _blamed_on(f"gearbox_presets({name!r})"):
        presets = _table(_read_toml(_servo_path(name)), "gearboxes", "")
    return {preset: load_servo(name, preset).gearbox for preset in presets}


def robot_names() -> tuple[str, ...]:
    """Names of the robots that come with the package."""
    return tuple(sorted(p.stem for p in _robots().glob("*/*.urdf") if p.stem == p.parent.name))


# ---------------------------------------------------------------------------------------------- files


def _robots() -> Path:
    """The folder of robots: inside the installed package, or beside it in a source tree."""
    installed = Path(__file__).parent / "robots"
    return installed if installed.is_dir() else Path(__file__).parent.parent / "robots"


def _urdf_path(name_or_path: str | os.PathLike) -> Path:
    text = os.fspath(name_or_path)
    if isinstance(name_or_path, os.PathLike) or text.endswith(".urdf") or Path(text).name != text:
        return Path(text)
    if text not in robot_names():
        raise RobotFileNotFoundError(
            f"{_robots()}: there is no robot {text!r}; expected one of {', '.join(robot_names())}: "
            "use one of these, or the path of a .urdf file"
        )
    return _robots() / text / f"{text}.urdf"


@contextmanager
def _blamed_on(file: str | Path) -> Iterator[None]:
    """Put the file's name before the message of any ValueError, unless it already has one."""
    try:
        yield
    except RobotFileError:
        raise
    except ValueError as error:
        raise RobotFileError(f"{file}: {error}") from error


def _read_bytes(path: Path) -> bytes:
    if path.is_dir():
        raise ValueError(f"is a directory; give the {path.suffix or '.urdf'} file in it")
    if not path.exists():
        raise RobotFileNotFoundError(f"{path}: there is no such file; correct the path")
    if not path.is_file():
        raise ValueError("is not a regular file; copy its contents into one")
    with path.open("rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise ValueError(f"is larger than {MAX_BYTES} bytes; reduce it: a robot's links and joints take far less")
    if not data.strip():
        raise ValueError("is empty; write the robot into it, or remove it")
    return data


def _read_toml(path: Path) -> dict[str, Any]:
    data = _read_bytes(path)
    try:
        return tomllib.loads(data.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ValueError(f"is not UTF-8 text: {error}; save it as UTF-8") from error
    except RecursionError as error:
        raise ValueError("nests its values too deeply; flatten it") from error
    except ValueError as error:
        raise ValueError(f"is not TOML: {error}; correct the syntax there (https://toml.io)") from error


def _read_xml(path: Path) -> Element:
    data = _read_bytes(path)
    try:
        root = fromstring(data, forbid_dtd=True)
    except DefusedXmlException as error:
        raise ValueError(f"declares a document type or entities ({error}); remove the <!DOCTYPE ...>") from error
    except ParseError as error:
        raise ValueError(f"is not well-formed XML: {error}; correct the syntax there, and give a URDF file") from error
    except (ValueError, LookupError) as error:
        raise ValueError(f"has an encoding that cannot be read: {error}; save it as UTF-8") from error
    _check_depth(root)
    _drop_default_namespace(root)
    return root


def _check_depth(root: Element) -> None:
    """Refuse deep nesting, level by level, so that no recursion ever meets it."""
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
        if not level:
            return
    raise ValueError(f"nests <{level[0].tag}> more than {MAX_DEPTH} elements deep; a URDF needs 5: flatten it")


def _drop_default_namespace(root: Element) -> None:
    """`<robot xmlns="...">` puts every tag into a namespace; strip that one and no other."""
    namespace = root.tag[: root.tag.find("}") + 1]
    if namespace:
        for element in root.iter():
            element.tag = element.tag.removeprefix(namespace)


# ---------------------------------------------------------------------------------------------- URDF


def _read_urdf(path: Path) -> _Robot:
    root = _read_xml(path)
    notes = _check_elements(root)
    links = tuple(_link(element) for element in root.iterfind("link"))
    floating = [element for element in root.iterfind("joint") if element.get("type") == "floating"]
    joints = tuple(_joint(element, notes) for element in root.iterfind("joint") if element not in floating)
    if floating:
        links = _without_world(links, joints, floating, notes)
    check_tree(links, joints)
    sentences = tuple(sentence + (f" ({count} times)" if count > 1 else "") for sentence, count in notes.items())
    return _Robot(root.get("name"), links, joints, "floating" if floating else None, sentences)


def _check_elements(root: Element) -> Counter[str]:
    """Check tags and attributes against the grammar; return a note for each kind of element that is skipped."""
    if root.tag != "robot":
        raise ValueError(f"root element is <{root.tag}>; expected <robot>: convert the file to URDF")
    if len(root.findall("link")) > MAX_LINKS:
        raise ValueError(f"has {len(root.findall('link'))} links; at most {MAX_LINKS} are read: reduce them")
    notes: Counter[str] = Counter()
    stack = [(root, _label(root, ""))]
    while stack:
        element, what = stack.pop()
        skipped = _SKIPPED.get(element.tag, {})
        notes.update(f"skipped <{child.tag}>: {skipped[child.tag]}" for child in element if child.tag in skipped)
        children = [child for child in element if child.tag not in skipped]
        _check_children(element, children, what)
        _check_attributes(element, what)
        stack.extend((child, _label(child, what)) for child in reversed(children))
    return notes


def _label(element: Element, parent: str) -> str:
    """What messages call an element: link 'shank', or link 'shank' <inertial> <mass>."""
    if element.tag in ("robot", "link", "joint"):
        return f"{element.tag} {element.get('name')!r}"
    return f"{parent} <{element.tag}>"


def _check_children(element: Element, children: list[Element], what: str) -> None:
    grammar = _URDF[element.tag]
    legal = f"{grammar.needs} {grammar.reads}".split()
    counts = Counter(child.tag for child in children)
    for tag, count in counts.items():
        if tag not in legal:
            expected = f"expected {', '.join(f'<{t}>' for t in legal) or 'none'}"
            raise ValueError(f"{what}: unknown element <{tag}>; {expected}: {_remedy(tag)}")
        if count > 1 and element.tag != "robot":
            raise ValueError(f"{what}: {count} elements <{tag}>; at most one is allowed: remove the others")
    for tag in grammar.needs.split():
        if tag not in counts:
            raise ValueError(f"{what}: element <{tag}> is missing; exactly one is required: add it")
    text = "".join([element.text or "", *(child.tail or "" for child in element)]).strip()
    if text:
        raise ValueError(f"{what}: stray text {text[:40]!r}; values stand in attributes: remove it")


def _remedy(tag: str) -> str:
    if "xacro" in tag:
        return "expand the file with xacro first"
    if tag == "mimic":
        return "coupled joints are not simulated, so remove it and lock the joint, or give it a servo of its own"
    return "correct the spelling, or remove it"


def _check_attributes(element: Element, what: str) -> None:
    grammar = _URDF[element.tag]
    required, optional = grammar.required.split(), grammar.optional.split()
    for name in required:
        if name not in element.attrib:
            raise ValueError(f"{what}: attribute {name!r} of <{element.tag}> is missing; it is required: add it")
    for name in element.attrib:
        foreign = element.tag == "robot" and name.startswith("{")  # xsi:schemaLocation and the like
        if name not in required and name not in optional and not foreign:
            raise ValueError(
                f"{what}: unknown attribute {name!r} of <{element.tag}>; expected "
                f"{', '.join(required + optional) or 'none'}: correct the spelling, or remove it"
            )


def _link(element: Element) -> Link:
    what = _label(element, "")
    inertial = element.find("inertial")
    if inertial is None:
        return Link(element.get("name"), 0.0, (0.0, 0.0, 0.0), (0.0,) * 6)
    mass = _number(inertial.find("mass"), "value", what)
    inertia = tuple(_number(inertial.find("inertia"), name, what) for name in _INERTIA)
    center, rpy = _origin(inertial, what)
    link = Link(element.get("name"), mass, center, inertia)
    return replace(link, inertia=_turned(inertia, rpy)) if any(rpy) else link


def _turned(inertia: tuple[float, ...], rpy: tuple[float, ...]) -> tuple[float, ...]:
    """The inertia in link axes, given in axes turned by rpy."""
    E = rotation_from_rpy(rpy)
    I = E @ inertia_matrix(inertia) @ E.T
    return tuple(((I + I.T) / 2)[(0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)].tolist())


def _joint(element: Element, notes: Counter[str]) -> Joint:
    what, kind = _label(element, ""), element.get("type")
    if kind in _REFUSED_TYPES:
        raise ValueError(f"{what}: type {kind!r} is not simulated; {_REFUSED_TYPES[kind]}")
    parent, child = (element.find(end).get("link") for end in ("parent", "child"))
    xyz, rpy = _origin(element, what)
    if kind == "fixed":
        return Joint(element.get("name"), kind, parent, child, xyz, rpy)
    motion = {**_limits(element, what, notes), **_dynamics(element, what)}
    return Joint(element.get("name"), kind, parent, child, xyz, rpy, _axis(element, what, notes), **motion)


def _axis(element: Element, what: str, notes: Counter[str]) -> tuple[float, ...]:
    """The axis at unit length; (1, 0, 0) if the file has none, as URDF says."""
    if element.find("axis") is None:
        return (1.0, 0.0, 0.0)
    axis = _vector(element.find("axis"), "xyz", what)
    length = math.hypot(*axis)
    if not 0 < length < math.inf:
        raise ValueError(f"{what}: axis {axis!r} has length {length!r}; expected > 0: give a direction such as 0 0 1")
    if abs(length - 1.0) <= _IGNORED_LENGTH_ERROR:
        return axis
    if abs(length - 1.0) > _NOTED_LENGTH_ERROR:
        notes[f"{what}: axis {axis!r} was scaled to unit length"] += 1
    largest = max(abs(x) for x in axis)  # first, so that the squares of tiny numbers do not vanish
    scaled = [x / largest for x in axis]
    return tuple(x / math.hypot(*scaled) for x in scaled)


def _limits(element: Element, what: str, notes: Counter[str]) -> dict[str, float]:
    limit, kind = element.find("limit"), element.get("type")
    if limit is None:
        if kind in ("revolute", "prismatic"):
            remedy = "add it, or use type 'continuous'" if kind == "revolute" else "add it"
            raise ValueError(f"{what}: type {kind!r} needs a <limit> with lower, upper, effort and velocity: {remedy}")
        return {}
    for name in [name for name in ("acceleration", "deceleration", "jerk") if name in limit.attrib]:
        notes[f"skipped {name} of <limit>: the servo limits the motion"] += 1
    values = {name: _number(limit, name, what) for name in ("effort", "velocity") if name in limit.attrib}
    if len(values) < 2:
        notes["a <limit> states no effort or no velocity: taken as unlimited"] += 1
    if kind != "continuous":
        return values | {name: _number(limit, name, what, default=0.0) for name in ("lower", "upper")}
    if "lower" in limit.attrib or "upper" in limit.attrib:
        notes["skipped lower and upper of a continuous joint, which has no stops"] += 1
    return values


def _dynamics(element: Element, what: str) -> dict[str, float]:
    dynamics = element.find("dynamics")
    if dynamics is None:
        return {}
    return {name: _number(dynamics, name, what, default=0.0) for name in ("damping", "friction")}


def _origin(element: Element, what: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    origin = element.find("origin")
    if origin is None:
        return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    return _vector(origin, "xyz", what), _vector(origin, "rpy", what)


def _vector(element: Element, attribute: str, what: str) -> tuple[float, ...]:
    """Three numbers; zeros where the attribute is left out."""
    words = element.get(attribute, "0 0 0").split()
    if len(words) != 3:
        raise ValueError(
            f"{what}: <{element.tag}> {attribute}={element.get(attribute)!r} has {len(words)} numbers; "
            "expected 3, separated by spaces: correct it"
        )
    return tuple(_parsed(word, f"{what}: <{element.tag}> {attribute}") for word in words)


def _number(element: Element, attribute: str, what: str, default: float | None = None) -> float:
    if default is not None and attribute not in element.attrib:
        return default
    return _parsed(element.get(attribute).strip(), f"{what}: <{element.tag}> {attribute}")


def _parsed(word: str, what: str) -> float:
    """A finite number as XML Schema and C write it; float() alone would take 1_0, nan and Arabic digits too."""
    value = float(word) if _NUMBER.fullmatch(word) else math.nan
    if not abs(value) <= MAX_NUMBER:
        raise ValueError(
            f"{what} is {word[:40]!r}; expected a number up to {MAX_NUMBER:g}: write it like -0.15 or 2e-3"
        )
    return value


def _without_world(
    links: tuple[Link, ...], joints: tuple[Joint, ...], floating: list[Element], notes: Counter[str]
) -> tuple[Link, ...]:
    """Drop the massless root of a floating joint; the joint's child becomes the floating base."""
    what, world = _label(floating[0], ""), floating[0].find("parent").get("link")
    others = [joint.name for joint in joints if world in (joint.parent, joint.child)]
    massless = [link.name for link in links if link.mass == 0]
    if len(floating) > 1 or others or world not in massless:
        raise ValueError(
            f"{what}: type 'floating' from link {world!r}; expected one such joint, from a massless root link that no "
            f"other joint uses: {_REFUSED_TYPES['floating']}"
        )
    notes[f"dropped link {world!r} and {what}: the base floats, and its pose is part of the state"] += 1
    return tuple(link for link in links if link.name != world)


# ---------------------------------------------------------------------------------------------- TOML


def _read_settings(path: Path, robot: _Robot) -> _Settings:
    table = _read_toml(path)
    _check_keys(table, ("base", "contacts", "servos", "locked"), "top level")
    if table.get("base", "fixed") not in ("fixed", "floating"):
        raise ValueError(f"base is {table['base']!r}; expected 'fixed' or 'floating': use one of these")
    servos = _servos(_table(table, "servos", ""), robot.joints, path.parent)
    locked = {name: _locked_set(table["locked"], name, robot.joints) for name in _table(table, "locked", "")}
    return _Settings(table.get("base"), locked, servos, _contacts(table.get("contacts", []), robot.links))


def _contacts(rows: Any, links: tuple[Link, ...]) -> tuple[ContactPoint, ...]:
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ValueError(f"contacts is {rows!r}; expected a list: write [{{link = '...', position = [x, y, z]}}, ...]")
    points = []
    for k, row in enumerate(rows):
        _check_keys(row, ("link", "position"), f"contacts[{k}]")
        link, position = _string(row, "link", f"contacts[{k}]"), row.get("position")
        what = f"contacts[{k}] on link {link!r}: position"
        if not isinstance(position, list) or len(position) != 3:
            raise ValueError(f"{what} is {position!r}; expected three numbers: write [x, y, z]")
        points.append(ContactPoint(link, tuple(_real(x, what) for x in position)))
    check_contacts(links, points)
    return tuple(points)


def _locked_set(sets: dict[str, Any], name: str, joints: tuple[Joint, ...]) -> dict[str, float]:
    names = [joint.name for joint in joints]
    held = {}
    for key, value in _table(sets, name, "locked.").items():
        angle = key not in names and key.endswith("_deg")
        joint = key.removesuffix("_deg") if angle else key
        if joint in held:
            raise ValueError(f"locked.{name}: joint {joint!r} is given twice; keep one of the two")
        position = _real(value, f"locked.{name}: position of joint {joint!r}")
        held[joint] = math.radians(position) if angle else position
    check_locked(joints, held)
    return held


def _chosen(locked: Any, sets: Mapping[str, dict[str, float]]) -> dict[str, float]:
    """The joints to hold, from the argument of `load_robot`."""
    if locked is None:
        return dict(sets.get("default", {}))
    if isinstance(locked, str):
        if locked not in sets:
            known = ", ".join(sets) or "none"
            raise ValueError(f"there is no set {locked!r}; expected one of {known}: use one, or add [locked.{locked}]")
        return dict(sets[locked])
    if isinstance(locked, Mapping):
        return {name: float(position) for name, position in locked.items()}
    return dict.fromkeys(locked, 0.0)


def _servos(section: dict[str, Any], joints: tuple[Joint, ...], folder: Path) -> dict[str, Servo]:
    """Servos by joint: [servos] for all that turn, overridden by [servos.joints.NAME]."""
    own = _table(section, "joints", "servos.")
    check_servos(joints, own)
    _servo_settings(section, "servos", also=("default", "gearbox", "joints"))
    shared = {key: value for key, value in section.items() if key not in ("default", "joints")}
    if "default" in section:
        shared["type"] = _string(section, "default", "servos")
    read = functools.cache(lambda name, gearbox: _servo_values(_servo_path(name, folder), gearbox))
    servos = {}
    for joint in joints:
        turns = "default" in section and joint.type in ("revolute", "continuous")
        if turns or joint.name in own:
            table = {**shared, **_table(own, joint.name, "servos.joints.")}
            servos[joint.name] = _joint_servo(table, read, f"servo of joint {joint.name!r}")
    return servos


def _joint_servo(table: dict[str, Any], read, what: str) -> Servo:
    """One joint's servo: the fields of its type and preset, and what overrides them."""
    values = _servo_settings(table, what, also=("type", "gearbox"))
    gearbox = _string({"gearbox": "physical", **table}, "gearbox", what)
    if "type" in table:
        values = {**read(_string(table, "type", what), gearbox), **values}
    elif "gearbox" in table:
        raise ValueError(f"{what}: gearbox {gearbox!r} is a preset of a servo type, and none is given: add type")
    return _servo(values, what)


def _servo_path(name: str, folder: Path | None = None) -> Path:
    """The servo's file: beside the robot's TOML, else among those that come with the package."""
    packaged = _robots() / "servos"
    for path in (folder or packaged, packaged):
        if Path(name).name == name and (path / f"{name}.toml").is_file():
            return path / f"{name}.toml"
    known = ", ".join(sorted(path.stem for path in packaged.glob("*.toml")))
    raise ValueError(f"there is no servo {name!r}; expected one of {known}: use one, or add {name}.toml to the robot")


def _servo_values(path: Path, gearbox: str) -> dict[str, Any]:
    """Fields of Servo, Controller and Gearbox that a servo's file states, with one of its presets."""
    with _blamed_on(path):
        table = _read_toml(path)
        presets = _table(table, "gearboxes", "")
        if gearbox not in presets:
            raise ValueError(f"there is no gearbox {gearbox!r}; expected one of {', '.join(presets)}: use one of these")
        preset = _servo_settings(_table(presets, gearbox, "gearboxes."), f"gearboxes.{gearbox}")
        table = {key: value for key, value in table.items() if key != "gearboxes"}
        return {**_servo_settings(table, "servo"), **preset}


def _servo_settings(table: Mapping[str, Any], what: str, also: tuple[str, ...] = ()) -> dict[str, Any]:
    """The table's fields as SI numbers, angles in radians; keys in `also` are left out, others refused."""
    _check_keys(table, (*also, *_SERVO_KEYS, *(f"{name}_deg" for name in _ANGLES)), what)
    values: dict[str, Any] = {}
    for key, value in table.items():
        if key in also:
            continue
        name = key if key in _SERVO_KEYS else key.removesuffix("_deg")
        if name in values:
            raise ValueError(f"{what}: {name} is given twice; keep one of {name} and {name}_deg")
        number = value if name == "law" else _real(value, f"{what}: {key}")
        values[name] = number if name == key else math.radians(number)
    return values


def _servo(values: dict[str, Any], what: str) -> Servo:
    required = [f.name for cls in _PARTS for f in fields(cls) if f.default is MISSING and f.name in _SERVO_KEYS]
    for name in required:
        if name not in values:
            raise ValueError(f"{what}: {name} is missing; it is required: add it, or name a servo type that has it")
    controller, gearbox, motor = ({name: values[name] for name in part if name in values} for part in _PARTS.values())
    try:
        return Servo(Controller(**controller), Gearbox(**gearbox), **motor)
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error


def _check_keys(table: Mapping[str, Any], known: tuple[str, ...], what: str) -> None:
    for key in table:
        if key not in known:
            raise ValueError(f"{what}: unknown key {key!r}; expected {', '.join(known)}: correct it, or remove it")


def _table(table: Mapping[str, Any], key: str, prefix: str) -> dict[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise ValueError(f"{prefix}{key} is {value!r}; expected a table: write [{prefix}{key}] and key = value lines")
    return value


def _string(table: Mapping[str, Any], key: str, what: str) -> str:
    value = table.get(key)
    if not isinstance(value, str):
        raise ValueError(f"{what}: {key} is {value!r}; expected a name: write it in quotes")
    return value


def _real(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{what} is {value!r}; expected a number: write it like 0.15 or 2e-3, without quotes")
    if abs(value) > sys.float_info.max and value != math.inf:
        raise ValueError(f"{what} is beyond {sys.float_info.max:.1e}; expected a number: correct its size")
    return float(value)


# ---------------------------------------------------------------------------------------------- writing


def _urdf_text(model: Model) -> str:
    lines = ['<?xml version="1.0" encoding="utf-8"?>', f"<robot name={quoteattr(model.name)}>"]
    for link in model.links:
        lines += _link_lines(link)
    for joint in model.joints:
        lines += _joint_lines(joint)
    return "\n".join([*lines, "</robot>", ""])


def _link_lines(link: Link) -> list[str]:
    if link.mass == 0 and not any(link.center_of_mass):
        return [f"  <link name={quoteattr(link.name)}/>"]
    inertia = " ".join(f'{name}="{float(value)!r}"' for name, value in zip(_INERTIA, link.inertia))
    return [
        f"  <link name={quoteattr(link.name)}>",
        "    <inertial>",
        f'      <origin xyz="{_numbers(link.center_of_mass)}"/>',
        f'      <mass value="{float(link.mass)!r}"/>',
        f"      <inertia {inertia}/>",
        "    </inertial>",
        "  </link>",
    ]


def _joint_lines(joint: Joint) -> list[str]:
    lines = [
        f'  <joint name={quoteattr(joint.name)} type="{joint.type}">',
        f"    <parent link={quoteattr(joint.parent)}/>",
        f"    <child link={quoteattr(joint.child)}/>",
        f'    <origin xyz="{_numbers(joint.xyz)}" rpy="{_numbers(joint.rpy)}"/>',
    ]
    if joint.type != "fixed":
        limit = " ".join(f'{name}="{value!r}"' for name, value in _stated_limits(joint).items())
        lines += [
            f'    <axis xyz="{_numbers(joint.axis)}"/>',
            f"    <limit {limit}/>",
            f'    <dynamics damping="{float(joint.damping)!r}" friction="{float(joint.friction)!r}"/>',
        ]
    return [*lines, "  </joint>"]


def _stated_limits(joint: Joint) -> dict[str, float]:
    """The limits that URDF can state: an infinite effort or velocity is left out, an infinite stop is refused."""
    limits = {name: float(getattr(joint, name)) for name in ("lower", "upper", "effort", "velocity")}
    if joint.type != "continuous" and not all(math.isfinite(limits[name]) for name in ("lower", "upper")):
        raise ValueError(
            f"joint {joint.name!r}: URDF cannot state the limits {joint.lower!r} to {joint.upper!r} of type "
            f"{joint.type!r}; give finite ones, or use type 'continuous'"
        )
    return {name: value for name, value in limits.items() if math.isfinite(value)}


def _toml_text(model: Model) -> str:
    lines = [f"base = {_quoted(model.base)}", "contacts = ["]
    for contact in model.contacts:
        position = ", ".join(_numbers(contact.position).split())
        lines.append(f"  {{link = {_quoted(contact.link)}, position = [{position}]}},")
    lines += ["]", "", "[locked.default]"]
    lines += [f"{_quoted(name)} = {float(position)!r}" for name, position in model.locked.items()]
    for name, servo in model.servos.items():
        lines += ["", f"[servos.joints.{_quoted(name)}]", f"law = {_quoted(servo.controller.law)}"]
        for part in (servo.controller, servo.gearbox, servo):
            keys = [key for key in _PARTS[type(part)] if key in _SERVO_KEYS and key != "law"]
            lines += [f"{key} = {float(getattr(part, key))!r}" for key in keys]
    return "\n".join([*lines, ""])


def _quoted(text: str) -> str:
    """A TOML basic string; printable text needs no escapes but JSON's."""
    return json.dumps(text, ensure_ascii=False)


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(repr(float(value)) for value in values)
