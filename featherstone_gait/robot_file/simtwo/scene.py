"""Read the things and obstacles of a scene of SimTwo, and say what else is in it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from ...base.rotation import rotation_from_rpy
from ...geometry.contact_choice import with_contacts
from ...model import Model
from ...model.links import Vector
from ...model.placed import SEPARATOR, Placed
from ...model.sensor import Sensor
from ...model.shapes import Shape
from ..markup import Markup, children, read_markup
from ..report import Report, blamed_on
from ..robot import with_rollers
from .differences import OBSTACLES, SOLIDS, TOOLS, Differences, merge_repeated
from .expression import Numbers, constants_of
from .read import quaternion_from_rpy
from .sensors import WORLD, read_sensor
from .solids import angles_of, attribute, solid_of, tell_driven

LINK = "body"  # the one link of a thing


class Section(NamedTuple):
    """Solids that a scene places together."""

    element: Element  # in the scene
    file: str | None  # that has the solids; None: the scene itself
    name: str  # before those of the solids
    position: Vector  # [m]
    rpy: Vector  # [rad]


def read_solids(path: Path, markup: Markup, kind: str, strict: bool) -> tuple[list[Placed], tuple[str, ...]]:
    """Read the solids of a kind, in the scene or in the files that it names, and what is ignored.

    kind: "things", which move freely, or "obstacles", which do not.  A file that does not exist is left out, with a
    warning.  Raises RobotFileError for all that is wrong with a file.
    """
    found: list[Placed] = []
    notes: list[str] = []
    outer, scene = constants_of(markup.root, {}), Report(markup.lines, strict)
    for section in _sections(markup.root, kind, Numbers(outer), scene):
        file, body, lines = path, section.element, markup.lines
        if section.file is not None:
            file = path.parent / section.file
            if not file.is_file():
                where = f"{path.name}, line {scene.lines[section.element]}"
                scene.doubt(f"{where}: there is no file {section.file}: its {kind} are left out")
                continue
            with blamed_on(file):
                body, lines, _ = read_markup(file)
        merge_repeated(body)
        report = Report(lines, strict)
        numbers = Numbers(constants_of(body, constants_of(section.element, outer)))
        differences = Differences(file, report)
        for element in children(body, (SOLIDS if kind == "things" else OBSTACLES).split()):
            with report.blaming(element):
                name = f"{element.tag}{len(found)}"
                found.append(_placed(element, numbers, kind, section, name, differences))
        if section.file is not None:
            differences.look_through(body)
        differences.tell()
        report.raise_problems(file)
        report.warn(file, stacklevel=5)
        notes += report.notes()
    scene.raise_problems(path)
    scene.warn(path, stacklevel=5)
    return _with_own_names(found), (*scene.notes(), *notes)


def _sections(root: Element, kind: str, numbers: Numbers, report: Report) -> Iterator[Section]:
    """Yield what has solids: <things> or <obstacles>, and each <obstacle> with its place."""
    zero = (0.0, 0.0, 0.0)
    for element in root.iterfind(kind):
        yield Section(element, element.get("file"), "", zero, zero)
    for element in root.iterfind("obstacle") if kind == "obstacles" else ():
        name = attribute(element, "ID", "name", "obstacle")
        with report.blaming(element):
            position = numbers.xyz(element.find("pos"), f"obstacle {name!r} <pos>")
            rpy, body = angles_of(element, numbers, f"obstacle {name!r}"), element.find("body")
            yield Section(element, None if body is None else body.get("file"), f"{name}_", position, rpy)


def _placed(
    element: Element, numbers: Numbers, kind: str, section: Section, name: str, differences: Differences
) -> Placed:
    """Make a model of one solid, whose frame is parallel to that of its section."""
    moves = kind == "things"
    solid = solid_of(element, numbers, name, moves)
    tell_driven(element, solid, differences)
    name = (section.name + solid.link.name).replace(SEPARATOR, "_")
    link = replace(solid.link, name=LINK)
    model = Model(
        name, (link,), (), "floating" if moves else "fixed",
        shapes=(Shape(link.name, solid.geometry, rpy=solid.rpy, friction=solid.friction, surface=solid.surface),),
        immersed=tuple(replace(one, link=LINK) for one in solid.immersed if moves),
    )  # fmt: skip
    if moves:
        rollers = {} if solid.rollers is None else {LINK: replace(solid.rollers, link=LINK)}
        model = with_rollers(with_contacts(model, "all"), rollers)
    position = np.array(section.position) + rotation_from_rpy(section.rpy) @ np.array(solid.position)
    return Placed(model, name, tuple(position.tolist()), quaternion_from_rpy(section.rpy))


def _with_own_names(found: list[Placed]) -> list[Placed]:
    """Add a number to names that others before have."""
    names: set[str] = set()
    for k, placed in enumerate(found):
        name, count = placed.name, 2
        while name in names:
            name, count = f"{placed.name}_{count}", count + 1
        names.add(name)
        if name != placed.name:
            found[k] = replace(placed, name=name)
    return found


def read_rest(path: Path, root: Element, report: Report) -> tuple[Sensor, ...]:
    """Read the sensors that stand in the world; report what of a scene is neither these nor robot, thing or obstacle.

    The report is that of the scene's file.
    """
    found: list[Sensor] = []
    differences, numbers = Differences(path, report), Numbers(constants_of(root, {}))
    for element in children(root, ("sensors", "tools")):
        found += _sensors(path, element, numbers, report, [one.name for one in found])
    for element in root.iterfind("robot"):
        if any(angles_of(element, numbers, "<robot>")[:2]):
            differences.add(element, "<rot_deg> of <robot> turns about x and y too, and in SimTwo about z alone")
    differences.look_through(root)
    differences.tell()
    return tuple(found)


def _sensors(path: Path, section: Element, outer: Numbers, report: Report, taken: list[str]) -> list[Sensor]:
    """Read the sensors that stand in the world, in a file or in the scene itself; taken: names that others have."""
    file, body, lines = path, section, report.lines
    apart = section.get("file")
    if apart is not None:
        file = path.parent / apart
        if not file.is_file():
            where = f"{path.name}, line {report.lines[section]}"
            report.doubt(f"{where}: there is no file {file.name}: its {section.tag} are left out")
            return []
        with blamed_on(file):
            body, lines, _ = read_markup(file)
    merge_repeated(body)
    own = Report(lines, report.strict)
    numbers, differences = Numbers(constants_of(body, outer.constants)), Differences(file, own)
    found: list[Sensor] = []
    for element in children(body, TOOLS.split()):
        with own.blaming(element):
            sensor = read_sensor(element, numbers, {}, WORLD, differences, [*taken, *(one.name for one in found)])
            found += [] if sensor is None else [sensor]
    if apart is not None:
        differences.look_through(body)
    differences.tell()
    own.raise_problems(file)
    own.warn(file, stacklevel=6)
    for note in own.notes():
        report.remark(note)
    return found
