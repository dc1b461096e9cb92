"""Read the things and obstacles of a scene of SimTwo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import Element

from ...model import Model
from ...model.placed import SEPARATOR, Placed
from ...model.shapes import Shape
from ..markup import Markup, read_markup
from ..report import Report, blamed_on
from .expression import Numbers, constants_of
from .read import SHAPES, attribute, solid_of

LINK = "body"  # the one link of a thing


def read_solids(path: Path, markup: Markup, kind: str, strict: bool) -> tuple[list[Placed], tuple[str, ...]]:
    """Read the solids of a kind, in the scene or in the files that it names, and what is ignored.

    kind: "things", which move freely, or "obstacles", which do not.  Raises RobotFileError for all
    that is wrong with a file.
    """
    found: list[Placed] = []
    notes: list[str] = []
    root = markup.root
    for section in root.iterfind(kind):
        file, body, lines = path, section, markup.lines
        if "file" in section.attrib:
            file = path.parent / section.attrib["file"]
            with blamed_on(file):
                body, lines, _ = read_markup(file)
        report = Report(lines, strict)
        numbers = Numbers(constants_of(body, constants_of(root, {})))
        for element in body.iter():
            if element.tag in SHAPES:
                with report.blaming(element):
                    found.append(_placed(element, numbers, kind, f"{element.tag}{len(found)}"))
        report.raise_problems(file)
        notes += report.notes()
    return found, tuple(notes)


def _placed(element: Element, numbers: Numbers, kind: str, name: str) -> Placed:
    """Make a model of one solid, whose frame is parallel to the world's."""
    solid = solid_of(element, numbers)
    name = (attribute(element, "ID", "value", "") or name).replace(SEPARATOR, "_")
    link = replace(solid.link, name=LINK)
    model = Model(
        name, (link,), (), "floating" if kind == "things" else "fixed",
        shapes=(Shape(link.name, solid.geometry, rpy=solid.rpy),),
    )  # fmt: skip
    return Placed(model, name, solid.position)
