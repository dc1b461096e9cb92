"""Say what of a SimTwo file is not read, or means something else here: with file, lines and element."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import TypeAlias
from xml.etree.ElementTree import Element

from ..report import Report

Known: TypeAlias = dict[str, frozenset[str]]  # attributes that are read, by the tag of a property


def _known(text: str) -> Known:
    """Return tags and their attributes, written as "tag: attributes; tag: ..."."""
    pairs = (entry.split(":") for entry in text.split(";"))
    return {tag.strip(): frozenset(attributes.split()) for tag, attributes in pairs}


_MOTOR = (
    "motor: ri li ki vmax imax active; rotor: j J bv; gear: ratio ke bv be; friction: bv fc; spring: k zeropos; "
    "controller: mode kp ki kd kf period active"
)
_PLACE = "ID: value; pos: x y z; rot_deg: x y z; size: x y z radius; radius: value; surface: mu; "
SOLID = _known(
    _PLACE + "mass: value I11 I12 I13 I22 I23 I33; drag: coefficient stokes roll; buoyant: mass x y z; "
    "buoyance: mass x y z; nogravity:; solid: id; thrust: coefficient"
) | {"ID": frozenset({"value", "kind"})}
SHELL = _known(_PLACE + "mass: value; solid: id")
OBSTACLE = _known(_PLACE + "imovable:; mass: value")  # which stands still anyway
_OF_AXIS = _known(f"axis: x y z; limits: Min Max; {_MOTOR}")
JOINT = (
    _OF_AXIS
    | {f"{tag}2": names for tag, names in _OF_AXIS.items()}
    | _known("ID: value; pos: x y z; connect: B1 B2 S1 S2; type: value")
)
WHEEL = _known(
    f"{_MOTOR}; ID: value; omni:; tyre: mass radius width centerdist; surface: mu mu2; axis: angle; offset: x y z"
)
SENSOR = _known("ID: value name; pos: x y z; rot_deg: x y z; beam: length angle rays; solid: id; absolute_coords:")
SPOT = SENSOR | {"beam": frozenset({"length", "final_width"})}  # of a floorline
RAYS = "IR IRSharp sonar capacitive inductive ranger2d"
FLOOR = "floorline"
TOOLS = f"{RAYS} {FLOOR} imu RFID beacon pentip solenoid spraygun"  # in <sensors> and in <tools>
SECTIONS: Mapping[str, tuple[Known, str]] = {  # properties, and the elements that have them
    "solids": (SOLID, "cuboid cylinder sphere belt propeller"),
    "shells": (SHELL, "cuboid cylinder sphere camera"),
    "articulations": (JOINT, "joint default"),
    "wheels": (WHEEL, "wheel default"),
    "sensors": (SENSOR, TOOLS),
    "tools": (SENSOR, TOOLS),
    "things": (SOLID, "cuboid cylinder sphere belt propeller"),
    "obstacles": (OBSTACLE, "cuboid cylinder sphere"),
}
LOOKS = frozenset(
    "color_rgb texture transparency mesh canvas draw draw2 desc desc2 liquid painting_target focal frame "
    "paint_color_rgb paint_rate paint_max_angle paint_default_on paint_occlusion".split()
)
PLACED = ("defines", "body", "ID", "pos", "rot_deg")  # beside solids, of an <obstacle> in a scene
MATTER = "sensors and solenoids feel no matter here"
WIDTH = "rays have no width"
NOISE = "readings have no noise: give SampledSensor(name, noise=...)"
REMARKS = {  # why a property, or "property attribute", is not read
    **dict.fromkeys(("metallic", "ferromagnetic", "rfidtag"), MATTER),
    **dict.fromkeys(("encoder", "encoder2"), "a Session observes `encoders`, with the steps of a servo's firmware"),
    **dict.fromkeys(("beam initial_width", "beam final_width"), WIDTH),
    **dict.fromkeys(("friction coulomblimit", "friction2 coulomblimit"), "SimTwo has not read it since 2009"),
    **dict.fromkeys(("rotor fc", "rotor2 fc"), "SimTwo does not use it"),
    **dict.fromkeys(
        ("surface softness", "surface bounce", "surface bounce_tresh"),
        "Ground and PairContact say how surfaces give way",
    ),
    "surface mu2": "friction is the same in all directions, but under wheels with rollers",
    "axis wrap": "references do not wrap: give the turns too",
    "noise": NOISE,
    "period": "a sensor measures when it is asked: give SampledSensor(name, rate=...)",
    "tag": "sensors see all matter",
}
DOUBTS = {  # the same where the motion depends on it
    **dict.fromkeys(
        ("gear ke2", "gear kv2", "gear2 ke2", "gear2 kv2"), "springs of gears are linear here: put the slope in ke"
    ),
    **dict.fromkeys(("motor simple", "motor2 simple"), "motors have back-EMF here: write ki and ri that suit"),
}


class Differences:
    """The differences between a file of SimTwo and what is read of it: sentences, with the lines of the file."""

    def __init__(self, file: Path, report: Report) -> None:
        self.file, self.report = file, report
        self._lines: dict[tuple[bool, str], list[int]] = {}
        self._idle: dict[str, None] = {}

    def add(self, element: Element, sentence: str, doubt: bool = False) -> None:
        """Add a sentence about an element; doubt: the motion depends on it."""
        self._lines.setdefault((doubt, sentence), []).append(self.report.lines.get(element, 0))

    def look_through(self, root: Element, kind: str = "") -> None:
        """Add what is not read of a robot's file, or of elements of one kind of section alone."""
        for section in [root] if kind else root:
            name = kind or section.tag
            if name in SECTIONS:
                self._section(section, name, PLACED if kind else ())
            elif name == "kind":
                self._idle[name] = None
            elif name != "defines":
                self.add(section, f"<{name}> is skipped, which SimTwo does not know either")
        self.look_at_constants(root)

    def look_at_constants(self, root: Element) -> None:
        """Add what of the constants in an element is not read."""
        for element in root.iterfind("defines/*"):
            if element.tag not in ("const", "arg"):
                self.add(element, f"<{element.tag}> in <defines> is skipped, which SimTwo does not know either")

    def _section(self, section: Element, name: str, more: Collection[str]) -> None:
        """Add what of a section is not read; more: tags of what may be between the elements."""
        known, elements = SECTIONS[name]
        for element in section:
            if element.tag in elements.split():
                if element.tag == FLOOR:
                    self._element(element, SPOT)
                elif known is not SENSOR or element.tag in RAYS.split():  # others are left out as a whole
                    self._element(element, known)
            elif element.tag not in more:
                unknown = f"<{element.tag}> in <{name}> is skipped, which is nothing that SimTwo knows there"
                self.add(element, unknown, doubt=name in ("solids", "things", "articulations"))

    def _element(self, element: Element, known: Known) -> None:
        for name in element.attrib:
            self.add(element, f"{name} of <{element.tag}> is not read: SimTwo does not know it either")
        for child in element:
            if child.tag in LOOKS:
                self._idle[child.tag] = None
                continue
            found: dict[tuple[bool, str], list[str]] = {}
            for what in _unread(child, known):
                why = DOUBTS.get(what) or REMARKS.get(what, "SimTwo does not know it either")
                found.setdefault((what in DOUBTS, why), []).append(what)
            for (doubt, why), names in found.items():
                attributes = ", ".join(what.removeprefix(f"{child.tag} ") for what in names)
                place = f"<{child.tag}>" if names == [child.tag] else f"{attributes} of <{child.tag}>"
                self.add(child, f"{place} in <{element.tag}> is not read: {why}", doubt)

    def tell(self) -> None:
        """Put all into the report."""
        for (doubt, sentence), lines in self._lines.items():
            numbers = ", ".join(map(str, dict.fromkeys(lines)))
            text = f"{self.file.name}, line{'s' * (len(set(lines)) > 1)} {numbers}: {sentence}"
            (self.report.doubt if doubt else self.report.remark)(text)
        if self._idle:
            self.report.remark(f"{self.file.name}: skipped what moves nothing ({', '.join(self._idle)})")


def _unread(child: Element, known: Known) -> Iterator[str]:
    """Yield a property that is not read, or those of its attributes, as "property attribute"."""
    if child.tag not in known:
        yield child.tag
        return
    for attribute in child.attrib:
        if attribute not in known[child.tag]:
            yield f"{child.tag} {attribute}"


def merge_repeated(root: Element) -> None:
    """Give the first of several properties of one name the attributes of the others, of which the last count."""
    elements = {tag for _, names in SECTIONS.values() for tag in names.split()}
    for element in root.iter():
        if element.tag in elements:
            first: dict[str, Element] = {}
            for child in element:
                first.setdefault(child.tag, child).attrib.update(child.attrib)
