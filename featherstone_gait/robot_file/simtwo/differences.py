"""Say what of a SimTwo file is not read, or means something else here: with file, lines and element."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element

from ..markup import meant, unread
from ..report import Report

RAYS = "IR IRSharp sonar capacitive inductive ranger2d"
FLOOR = "floorline"
TOOLS = f"{RAYS} {FLOOR} imu RFID beacon pentip solenoid spraygun"  # in <sensors> and in <tools>
SOLIDS = "cuboid cylinder sphere belt propeller"  # in <solids> and in <things>
SHELLS = "cuboid cylinder sphere camera"
OBSTACLES = "cuboid cylinder sphere"
NEEDED = ("<solids>", "<things>", "<articulations>")  # on whose elements the motion depends
UNKNOWN = "it plays no part here"
LOOKS = frozenset(
    "color_rgb texture transparency mesh canvas draw draw2 desc desc2 liquid painting_target focal frame kind "
    "paint_color_rgb paint_rate paint_max_angle paint_default_on paint_occlusion".split()
)
MATTER = "sensors and solenoids feel no matter here"
WIDTH = "rays have no width"
NOISE = "readings have no noise: give SampledSensor(name, noise=...)"
REMARKS = {  # why a property, or "property attribute", is not read
    **dict.fromkeys(("metallic", "ferromagnetic", "rfidtag"), MATTER),
    "encoder": "a Session observes `encoders`, with the steps of a servo's firmware",
    **dict.fromkeys(("beam initial_width", "beam final_width"), WIDTH),
    **dict.fromkeys(("beam angle", "beam rays"), "one ray stands for the beam"),
    "friction coulomblimit": "SimTwo has not read it since 2009",
    "rotor fc": "SimTwo does not use it",
    **dict.fromkeys(
        ("surface softness", "surface bounce", "surface bounce_tresh"),
        "Ground and PairContact say how surfaces give way",
    ),
    "surface mu2": "friction is the same in all directions, but under wheels with rollers",
    "axis wrap": "references do not wrap: give the turns too",
    "noise": NOISE,
    "period": "a sensor measures when it is asked: give SampledSensor(name, rate=...)",
    "tag": "sensors see all matter",
    "track": "write its lines as Ground(lines=[FloorLine(...)])",
    "imovable": "obstacles stand still anyway",
}
DOUBTS = {  # the same where the motion depends on it
    **dict.fromkeys(("gear ke2", "gear kv2"), "springs of gears are linear here: put the slope in ke"),
    "motor simple": "motors have back-EMF here: write ki and ri that suit",
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

    def look_through(self, root: Element) -> None:
        """Add what of a file no reader has asked for."""
        found: dict[tuple[Element, str, str], list[str]] = {}
        for element, name, child in unread(root):
            if child is not None and name in LOOKS:
                self._idle[name] = None
                continue
            tag = element.tag.rstrip("2")
            key, asked = (f"{tag} {name}", element.names) if child is None else (name.rstrip("2"), element.tags)
            stated = {*element.attrib} if child is None else {one.tag for one in element}
            near = meant(name, (one for one in asked if one not in stated and name not in (f"{one}2", f"n{one}")))
            why = REMARKS.get(key, f"is {near} meant?" if near else UNKNOWN)
            part = (element, f" of <{element.tag}>") if child is None else (child, f" in <{element.tag}>")
            found.setdefault((*part, DOUBTS.get(key, why)), []).append(name if child is None else f"<{name}>")
        for (at, place, why), names in found.items():
            doubt = why in DOUBTS.values() or why.endswith("?") or place.endswith(NEEDED)
            self.add(at, f"{', '.join(names)}{place} is not read: {why}", doubt)

    def tell(self) -> None:
        """Put all into the report."""
        for (doubt, sentence), lines in self._lines.items():
            numbers = ", ".join(map(str, dict.fromkeys(lines)))
            text = f"{self.file.name}, line{'s' * (len(set(lines)) > 1)} {numbers}: {sentence}"
            (self.report.doubt if doubt else self.report.remark)(text)
        if self._idle:
            self.report.remark(f"{self.file.name}: skipped what moves nothing ({', '.join(self._idle)})")


def merge_repeated(root: Element) -> None:
    """Give the first of several properties of one name the attributes of the others, of which the last count."""
    elements = {*f"{SOLIDS} {SHELLS} {TOOLS} joint default wheel".split()}
    for element in root.iter():
        if element.tag in elements:
            first: dict[str, Element] = {}
            for child in list(element):
                if first.setdefault(child.tag, child) is not child:
                    first[child.tag].attrib.update(child.attrib)
                    element.remove(child)
