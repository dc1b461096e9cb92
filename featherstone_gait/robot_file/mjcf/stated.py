"""Read what `save_robot` and `save_scene` have written as TOML within MJCF: what it has no element for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from ...model import Joint, Link
from ...model.placed import SEPARATOR
from ...model.shapes import Shape
from ..report import Report
from ..settings import GEOMS, Settings, read_stated
from ..toml import parsed

STATED = "featherstone_gait"  # name of the <text> of a robot; of a member of a scene with "/" and its name
OF_SCENE = "featherstone_gait_scene"  # and of that of a scene
TAKEN = (
    f"took what MJCF has no element for (servos, contact points, sensors) from the <text> {STATED!r} that this package "
    "has written; remove it to read the elements alone"
)


class Stated:
    """The <text>s of a file.

    members: whether those of the members of a scene count, and that of a robot if it is alone.
    """

    def __init__(self, path: Path, documents: Iterable[Element], members: bool = False, alone: bool = True) -> None:
        self.path = path
        texts = (text for root in documents for text in root.iterfind("custom/text"))
        found = {text.get("name", ""): text.get("data", "") for text in texts}
        self.scene = found.get(OF_SCENE, "")
        self.texts = {
            name: data
            for name, data in found.items()
            if (name == STATED and alone) or (members and name.startswith(STATED + SEPARATOR))
        }

    @property
    def is_there(self) -> bool:
        """Return whether this package has written the file, in which no shapes of a robot touch each other."""
        return bool(self.texts)

    def points(self) -> set[str]:
        """Return the geoms that stand for contact points."""
        found: set[str] = set()
        for name, text in self.texts.items():
            member = name.partition(SEPARATOR)[2]
            given = self._parsed(name, text).get(GEOMS, [])
            found |= {f"{member}{SEPARATOR}{geom}" if member else f"{geom}" for geom in given}
        return found

    def of(self, member: str, links: tuple[Link, ...], joints: tuple[Joint, ...], report: Report) -> Settings:
        """Return what is stated of a member of a scene, or, without a name, of the only robot."""
        name = f"{STATED}{SEPARATOR}{member}"
        name = name if name in self.texts else STATED
        if name not in self.texts:
            return Settings()
        report.remark(TAKEN)
        try:
            return read_stated(self._parsed(name, self.texts[name]), self.path.parent, links, joints, report)
        except ValueError as error:
            raise ValueError(f"<text name={name!r}>: {error}; or remove the <text>") from error

    def table(self) -> dict[str, Any]:
        """Return what is stated of the scene."""
        return self._parsed(OF_SCENE, self.scene)

    def _parsed(self, name: str, text: str) -> dict[str, Any]:
        try:
            return parsed(text)
        except ValueError as error:
            raise ValueError(f"<text name={name!r}> {error}, or remove the <text>") from error


def as_stated(shapes: Iterable[Shape], stated: Mapping[str, dict[str, Any]]) -> tuple[Shape, ...]:
    """Return shapes with what is stated of them by their names."""
    return tuple(replace(shape, **stated.get(shape.name, {})) for shape in shapes)
