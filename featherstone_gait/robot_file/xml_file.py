"""XML files that are no URDF: MJCF, and scenes of SimTwo."""

from __future__ import annotations

import warnings
from pathlib import Path

from ..model import Base
from .errors import RobotFileWarning, refusal
from .markup import read_markup
from .mjcf.read import read_mjcf
from .robot import Robot
from .simtwo.read import read_simtwo
from .urdf import read_urdf

SUFFIXES = (".xml", ".mjcf")
SHOWN = 5  # sentences in a warning


def read_xml(path: Path, base: Base | None, strict: bool) -> Robot:
    """Read a robot by what its root element is.

    Raises ValueError; with strict also where the file states what would change the motion and is passed over, of which
    it warns otherwise.
    """
    root = read_markup(path).root
    if root.tag == "mujoco":
        robot = read_mjcf(path, base)
    elif root.tag == "scene" or root.find("solids") is not None:
        robot = read_simtwo(path, root, base)
    elif root.tag == "robot":
        robot = read_urdf(path)
    else:
        raise ValueError(
            f"root element is <{root.tag}>; expected <mujoco>, <scene> of SimTwo, or <robot> of it or of a URDF: "
            "give such a file"
        )
    if robot.doubts and strict:
        raise refusal(path, [f"{doubt}; remove it, or load with strict=False" for doubt in robot.doubts])
    if robot.doubts:
        rest = len(robot.doubts) - SHOWN
        shown = [*robot.doubts[:SHOWN], *([f"and {rest} more in Model.notes"] if rest > 0 else [])]
        text = f"{path}: {'; '.join(shown)} (load_robot(..., strict=True) refuses this)"
        warnings.warn(text, RobotFileWarning, stacklevel=4)
    return robot
